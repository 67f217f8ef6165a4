"""Strikes of a damaged rolling bearing, each of which rings a resonance."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.synth.analogue import POLES_APART, AnalogueFilter

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

SHORTEST_STEP = 0.05
"""Of the period between strikes, left by jitter at least (4.75 σ at the most jitter): strikes do not swap places."""
NEGLIGIBLE = 1e-30
"""Of the largest entry: what a ringing has fallen to this far is over."""
CHECK_EVERY = 64
"""Samples between looks at whether a ringing is over."""


def slipping_line(order: float, *, slip_percent: float) -> float:
    """Order of a bearing line whose rolling elements slip: order · (1 − slip).

    ``order``: of pure rolling, > 0. ``slip_percent``: how much slower than that, < 100; negative is faster.
    """
    return order * (1 - slip_percent / 100)


def strike_angles(
    order: float,
    *,
    slip_percent: float,
    jitter_percent: float,
    start_rev: float,
    end_rev: float,
    stream: np.random.Generator,
) -> Real:
    """Crank angles (rev) at which a damaged place strikes, ascending, from ``start_rev`` to ``end_rev``, shape (k,).

    Angles, not times: the same under any motion. The periods between strikes vary independently and so add up to a
    random walk, as rolling elements do that slip; lines in the spectrum widen with their order. An earlier
    ``start_rev`` or a later ``end_rev`` adds strikes and changes none.

    ``order``: strikes per crank revolution in pure rolling, > 0. ``slip_percent``: how much fewer, −100 … 100 both
    excluded. ``jitter_percent``: standard deviation of a period, 0 … 20. ``stream``: of the chance, with children that
    it spawns; the first strike after crank angle 0 comes anywhere within a period. Raises RequestError outside these
    ranges.
    Source: Antoni and Randall (2003), Journal of Vibration and Acoustics 125, p. 282: random slips that add up, as
    against jitter about a fixed place.
    """
    if not (order > 0 and abs(slip_percent) < 100 and 0 <= jitter_percent <= 20 and math.isfinite(end_rev - start_rev)):
        raise RequestError(
            "no such strikes",
            found=f"order {order:g}, slip {slip_percent:g} %, jitter {jitter_percent:g} %, {start_rev:g} … {end_rev:g}",
            allowed="order > 0, slip −100 … 100 %, jitter 0 … 20 %, finite angles",
        )
    period_rev = 1 / slipping_line(order, slip_percent=slip_percent)
    first, start, end = stream.random(), start_rev / period_rev, end_rev / period_rev
    ahead, back = stream.spawn(2)
    later = first + _walk(ahead, jitter_percent, end - first)
    earlier = first - _walk(back, jitter_percent, first - start)[:0:-1]
    place = np.concatenate([earlier, later])
    strikes: Real = period_rev * place[(place >= start) & (place <= end)]
    return strikes


def _walk(stream: np.random.Generator, jitter_percent: float, distance: float) -> Real:
    """Distances from one strike to those after it, itself first, as far as ``distance``; all in periods."""
    walk, count = np.zeros(1), max(int(distance), 0) + 2
    while True:
        fresh = count - walk.size
        excess = 0.01 * jitter_percent * stream.standard_normal(fresh) if jitter_percent else np.zeros(fresh)
        steps = np.maximum(excess, SHORTEST_STEP - 1)
        # from the last value on, as one sum would: how many are drawn at a time changes no bit
        walk = np.concatenate([walk, np.cumsum(np.concatenate([walk[-1:], steps]))[1:]])
        place: Real = np.arange(walk.size) + walk
        if place[-1] > distance:
            return place[: max(int(np.searchsorted(place, distance, side="right")), 1)]
        count = walk.size + int(distance - place[-1]) + 2


def modulation(
    line: Literal["BPFO", "BPFI", "BSF", "FTF"],
    strike_rev: Real,
    *,
    load_zone: float,
    shaft_ratio: float,
    cage_order: float,
    phase_rev: float = 0.0,
) -> Real:
    """Size of each strike relative to the average one, as the load zone makes it, shape (k,).

    1 + load_zone · cos: over the angle of the shaft where the damage turns with the inner ring (BPFI), over that of the
    cage where it is on a rolling element (BSF). A damaged outer ring or cage is always struck where it is: 1. Over many
    strikes the mean is 1.

    ``line``: what is damaged. ``strike_rev``: crank angles, shape (k,). ``load_zone``: share that comes and goes,
    0 … 1. ``shaft_ratio``: shaft revolutions per crank revolution. ``cage_order``: cage revolutions per crank
    revolution, with its slip. ``phase_rev``: where in the cosine the crank angle 0 is, in its revolutions.
    Source: McFadden and Smith (1984), Journal of Sound and Vibration 96, p. 69, with one harmonic for the load.
    """
    order = {"BPFI": shaft_ratio, "BSF": cage_order}.get(line, 0.0)
    angle_rev = np.mod(order * strike_rev + phase_rev, 1.0)
    share = load_zone if order else 0.0
    relative: Real = 1 + share * np.cos(2 * np.pi * angle_rev)
    return relative


def ringing(
    strike_s: Real,
    size: Real,
    *,
    resonance_hz: float,
    damping_ratio: float,
    rate_hz: float,
    n_samples: int,
    filter: AnalogueFilter | None = None,
) -> Real:
    """Sum of the ringings that strikes set off, sampled where it is, also between the samples struck, (n_samples,).

    One ringing is exp(−ζ ωn τ) sin(ωd τ) since its strike, scaled so that its largest value is the strike's size. What
    a sampler sees of it is exact, and so is what folds from above half the rate. A filter changes that largest value.

    ``strike_s``: times from the first sample, in any sequence, shape (k,); strikes before the record (negative) still
    ring in it, see :func:`ringing_s`. ``size``: of each, shape (k,), any unit. ``resonance_hz``: natural frequency
    ωn / 2π, > 0. ``damping_ratio``: ζ, between 0 and 1. ``rate_hz``: samples per second. ``n_samples``: ≥ 0.
    ``filter``: between the sensor and the sampler. Raises RequestError where the resonance is a pole of it.
    """
    signal = np.zeros(n_samples)
    strike_sample = np.asarray(strike_s, dtype=np.float64) * rate_hz
    rings = np.flatnonzero(strike_sample <= n_samples - 1)
    rings = rings[np.argsort(strike_sample[rings], kind="stable")]
    strike_sample, struck = strike_sample[rings], np.asarray(size, dtype=np.float64)[rings]
    entry_sample = np.maximum(np.ceil(strike_sample), 0.0)
    pole, weight = _poles(resonance_hz, damping_ratio, filter)
    for one, by in zip(pole / rate_hz, weight, strict=True):
        entry = by * struck * np.exp(one * (entry_sample - strike_sample))
        _add_decaying(signal, entry_sample.astype(np.int64), entry, complex(np.exp(one)))
    return signal


def ringing_s(
    resonance_hz: float, damping_ratio: float, *, share: float = 1e-16, filter: AnalogueFilter | None = None
) -> float:
    """Time (s) after which a strike rings with less than ``share`` of its size: how far back strikes still count.

    ``resonance_hz``, ``damping_ratio``, ``filter``: as for :func:`ringing`. ``share``: between 0 and 1.
    """
    pole, weight = _poles(resonance_hz, damping_ratio, filter)
    times = np.log(np.maximum(np.abs(weight) * pole.size / share, 1.0)) / -pole.real
    return float(times.max())


def _poles(resonance_hz: float, damping_ratio: float, filter: AnalogueFilter | None) -> tuple[Complex, Complex]:
    """Poles and weights such that Re Σ weight · exp(pole τ) is one ringing of size 1; of a pair of poles the upper.

    By partial fractions: what stands in series adds up. Source: any text on the Laplace transform.
    """
    if not (resonance_hz > 0 and 0 < damping_ratio < 1):
        raise RequestError(
            "no such resonance", found=f"{resonance_hz:g} Hz, ζ {damping_ratio:g}", allowed="> 0 Hz, 0 < ζ < 1"
        )
    undamped = math.sqrt((1 - damping_ratio) * (1 + damping_ratio))
    pole = 2 * math.pi * resonance_hz * complex(-damping_ratio, undamped)
    largest = undamped * math.exp(-damping_ratio / undamped * math.acos(damping_ratio))
    if filter is None:
        return np.array([pole]), np.array([-1j / largest])
    behind = filter.pole_per_s
    if np.any(np.abs(behind - pole) < POLES_APART * abs(pole)):
        raise RequestError(
            "the resonance of an impact is a pole of the acquisition's filter",
            found=f"{resonance_hz:g} Hz, ζ {damping_ratio:g}",
            remedy="Shift one of them a little",
        )
    # times 1 for a real pole, times 2 for the upper of a pair, whose lower one adds the conjugate
    beside = np.where(np.abs(behind.imag) <= 1e-12 * np.abs(behind), 1.0, np.where(behind.imag > 0, 2.0, 0.0))
    through = pole.imag / ((behind - pole) * (behind - pole.conjugate())) / largest
    kept = beside > 0
    weights = np.concatenate([-1j / largest * filter.at(np.array([pole])), (beside * filter.residue * through)[kept]])
    return np.concatenate([np.array([pole]), behind[kept]]), weights


@njit(cache=True, nogil=True, error_model="numpy")
def _add_decaying(signal, entry_sample, entry, step):  # type: ignore[no-untyped-def]
    """Add Re Σ entry · step^(n − entry_sample) to ``signal``; entries in sequence of their samples."""
    over = 0.0
    for k in range(entry.size):
        over = max(over, abs(entry[k].real) + abs(entry[k].imag))
    over *= NEGLIGIBLE
    state = 0j
    n = k = 0
    while n < signal.size:
        if n % CHECK_EVERY == 0 and abs(state.real) + abs(state.imag) <= over:
            state = 0j
            # to the next strike at once; without this, numbers too small for the processor would slow it down
            n = entry_sample[k] if k < entry.size else signal.size
            if n == signal.size:
                break
        while k < entry.size and entry_sample[k] == n:
            state += entry[k]
            k += 1
        signal[n] += state.real
        state *= step
        n += 1
