"""Pulse times from a sampled encoder trace, with the noise of one pulse time.

A square trace is cut half-way between its two levels. A magnetic pickup that swings to both sides alike is cut at zero
(there the flux through the coil is at its extreme, whatever the speed), with a hysteresis that follows the local pulse
height, for that grows with speed. A pickup clipped on one side rests on a flat baseline, and the tooth behind a gap may
rise from it by a tenth of its neighbours' height: such a trace is cut a small share of the local height off it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from numba import njit

from crankorder.errors import InputError
from crankorder.quantities import Severity
from crankorder.settings import ShaftSettings

FloatArray = npt.NDArray[np.float64]
Remark = tuple[str, Severity, str]

# Standard deviation, in samples, of a linearly interpolated crossing of a band-limited edge: 7.1e-3 degrees at 0.24
# degrees per sample, measured at 4.2 samples per pulse.
INTERPOLATED_EDGE_SAMPLES = 0.03
# Standard deviation of an edge known only to lie between two samples: uniform over one sample.
QUANTISED_EDGE_SAMPLES = 12.0**-0.5
# An edge whose two samples both lie within this share of the height of their levels carries no sub-sample position.
SETTLED_SHARE = 0.1
# A trace rests on an extreme when REST_SHARE of its samples lies within REST_WIDTH of the height of it; a sine: 0.16.
REST_SHARE, REST_WIDTH = 0.25, 0.06
# The cut of a pickup stays so many standard deviations of its noise off the baseline.
NOISE_MULTIPLE = 6.0
# A pulse of a pickup is sure so far from the cut, as shares of the height of the largest pulses: between standstill
# that is not quite still, and a noise that cannot be told from fast pulses.
MIN_SURE_SHARE, MAX_SURE_SHARE = 0.0025, 0.02
# Samples, or a 64th of the trace if that is more, that show the height of the first pulses.
FIRST_BLOCK = 512
# A square wave whose levels scatter by more than this share of their distance may be noise.
OVERLAP_SHARE = 0.3
# Samples that are enough to find the two levels of a trace.
LEVEL_SAMPLES = 1 << 17


@dataclass(frozen=True)
class Pulses:
    """Pulse times [s] from the start of the trace, the standard deviation of one of them [s], and remarks on them.

    ``flags`` holds (flag, severity, detail): severity is "info", "suspect" or "bad".
    """

    time_s: FloatArray
    noise_s: float
    flags: list[Remark] = field(default_factory=list)


def find_pulses(
    trace: npt.NDArray[Any],
    *,
    rate_hz: float,
    kind: Literal["square", "analogue"],
    edge: Literal["rising", "falling"],
    pulses_per_rev: int,
    settings: ShaftSettings,
) -> Pulses:
    """Times of the pulses of a sampled encoder trace, with the standard deviation of one of them.

    Parameters
    ----------
    trace : (samples,), volts or counts of any level; float32 and float64 are taken as they are, others are converted
    rate_hz : samples per second
    kind : "square" for a two-level trace, "analogue" for a magnetic pickup
    edge : the edge that marks a pulse; wheels with missing teeth decode well on one edge only
    pulses_per_rev : pulses of the full wheel per revolution, 1 or more; named in the error where there are none
    settings : ``hysteresis_fraction`` guards against noise (more) or loses small teeth (less); ``envelope_teeth`` is
        how fast the pulse height is followed

    Returns
    -------
    Pulses, whose noise is 1/sqrt(12) sample where edges fall between two settled samples, and the noise of a linear
    interpolation where the samples carry the edge; the share of either kind is measured and reported.

    Raises
    ------
    InputError where the trace is constant, not finite, or holds no pulse.
    """
    samples = np.ascontiguousarray(trace, dtype=trace.dtype if trace.dtype in (np.float32, np.float64) else np.float64)
    if samples.ndim != 1 or samples.size < 2:
        raise InputError("the encoder trace has no samples", found=samples.shape, allowed="one axis, 2 samples or more")
    sign = 1.0 if edge == "rising" else -1.0
    some = _some(samples)
    levels = _levels(some)
    low, high = sorted(sign * level for level in levels)
    if not levels[1] > levels[0]:
        raise _no_pulses(edge, pulses_per_rev, "a constant" if np.isfinite(low) else "no finite sample")
    if kind == "square":
        half = 0.5 * settings.hysteresis_fraction * (high - low)
        fired, n_missing = _fired(samples, sign, 0.5 * (low + high) - half, 0.5 * (low + high) + half)
        level = np.array([0.5 * (low + high)])
    else:
        low, high, rest, share, sure = _pickup_levels(sign * some, settings.pickup_level_fraction)
        fired, level, n_missing = _fired_pickup(
            samples, sign, low, high, rest, share, settings.hysteresis_fraction, sure, settings.envelope_teeth
        )
    position, settled, variance = _crossings(samples, sign, fired, level, low, high)
    if position.size == 0:
        raise _no_pulses(edge, pulses_per_rev, f"levels {levels[0]:g} and {levels[1]:g}")
    noise_samples = float(np.sqrt(variance))
    how = "quantised" if 2 * settled > position.size else "interpolated"
    detail = f"{settled} of {position.size} edges lie between settled samples: pulse noise {noise_samples:.3g} samples"
    flags: list[Remark] = [(f"encoder_edge_{how}", "info", detail)]
    spread = _spread(some, *levels) if kind == "square" else 0.0
    if spread > OVERLAP_SHARE:
        detail = f"not a square wave: its two levels scatter by {spread:.2f} of their distance"
        flags.append(("encoder_unclear", "suspect", detail))
    if n_missing:
        flags.append(("encoder_gap", "suspect", f"{n_missing} of {samples.size} encoder samples are not a number"))
    return Pulses(time_s=position / rate_hz, noise_s=noise_samples / rate_hz, flags=flags)


def _no_pulses(edge: str, pulses_per_rev: int, found: str) -> InputError:
    return InputError(
        f"no {edge} encoder edge found",
        place="encoder",
        found=found,
        allowed=f"{pulses_per_rev} pulses per revolution",
        remedy="Check the encoder's cable, and its source, kind and edge in run.toml",
    )


def _spread(some: npt.NDArray[Any], low: float, high: float) -> float:
    """Scatter of a trace about the nearer of its two levels, over their distance; 0.24 for a sine, 0.38 for noise."""
    finite = some[:: 1 + some.size // 20_000]
    finite = finite[np.isfinite(finite)]
    return float(np.std(np.abs(finite - 0.5 * (low + high)))) / (high - low)


def _levels(trace: npt.NDArray[Any]) -> tuple[float, float]:
    """Lower and upper level: means below and above the middle of the range, taken twice to shed spikes."""
    low, high = float(trace.min()), float(trace.max())
    if not np.isfinite(high - low):
        trace = trace[np.isfinite(trace)]
        if trace.size == 0:
            return np.inf, -np.inf
        low, high = float(trace.min()), float(trace.max())
    for _ in range(2):
        middle = 0.5 * (low + high)
        below, above, n_above = _sums(trace, middle)
        if not 0 < n_above < trace.size:
            break
        low, high = below / (trace.size - n_above), above / n_above
        if 0.5 * (low + high) == middle:
            break
    return low, high


@njit(cache=True, nogil=True)
def _sums(trace, middle):  # type: ignore[no-untyped-def]
    """Sum of the samples up to ``middle``, sum of those above, and how many these are."""
    n_above, b0, b1, b2, b3, a0, a1, a2, a3 = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    whole = trace.size // 4 * 4
    for i in range(0, whole, 4):
        v0, v1, v2, v3 = trace[i], trace[i + 1], trace[i + 2], trace[i + 3]
        h0, h1, h2, h3 = v0 > middle, v1 > middle, v2 > middle, v3 > middle
        n_above += h0 + h1 + h2 + h3
        a0, a1, a2, a3 = (
            a0 + (v0 if h0 else 0.0),
            a1 + (v1 if h1 else 0.0),
            a2 + (v2 if h2 else 0.0),
            a3 + (v3 if h3 else 0.0),
        )
        b0, b1, b2, b3 = (
            b0 + (0.0 if h0 else v0),
            b1 + (0.0 if h1 else v1),
            b2 + (0.0 if h2 else v2),
            b3 + (0.0 if h3 else v3),
        )
    for i in range(whole, trace.size):
        if trace[i] > middle:
            a0, n_above = a0 + trace[i], n_above + 1
        else:
            b0 += trace[i]
    return (b0 + b1) + (b2 + b3), (a0 + a1) + (a2 + a3), n_above


@njit(cache=True, nogil=True)
def _fired(trace, sign, arm, fire):  # type: ignore[no-untyped-def]
    """First samples of ``sign * trace`` above ``fire`` since it was below ``arm``, and the count of NaN.

    64 samples at a time, one bit each. A sample above ``fire`` sets the state, one below ``arm`` clears it, any other
    hands it on: so does the carry in the sum of the bits that do not clear and those that set.
    """
    at = np.empty(trace.size // 2 + 2, dtype=np.int64)
    one, carry = np.uint64(1), np.uint64(1)
    n, missing = 0, 0
    for first in range(0, trace.size, 64):
        part = trace[first : first + 64]
        sets, clears = np.uint64(0), np.uint64(0)
        for j in range(part.size):
            value = sign * part[j]
            sets |= np.uint64(value > fire) << np.uint64(j)
            clears |= np.uint64(value < arm) << np.uint64(j)
            missing += value != value
        partial = ~clears + sets
        total = partial + carry
        fires = sets & ~(total ^ ~clears ^ sets)
        carry = np.uint64((partial < sets) | (total < partial))
        while fires:
            lowest = fires & (~fires + one)
            at[n] = first + _bits(lowest - one)
            n += 1
            fires ^= lowest
    return at[:n], missing


@njit(cache=True, nogil=True)
def _bits(word):  # type: ignore[no-untyped-def]
    """How many bits of ``word`` are set (Warren 2013, figure 5-2)."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


def _some(samples: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Enough samples to find the levels of a trace: blocks, for a stride could keep step with the pulses."""
    if samples.size <= LEVEL_SAMPLES:
        return samples
    return samples[: samples.size // 64 * 64].reshape(64, -1)[:, : LEVEL_SAMPLES // 64].ravel()


def _pickup_levels(some: npt.NDArray[Any], share: float) -> tuple[float, float, int, float, float]:
    """Extremes of a pickup trace, where it rests (-1 low, 1 high, 0 neither), where to cut it, and how far from noise.

    The cut is a share of the height; the least distance from it that makes a pulse sure is in the trace's unit.
    """
    finite = some[np.isfinite(some)]
    ordered = np.sort(finite[:: max(1, finite.size >> 13)])
    low, high = float(ordered[ordered.size // 50]), float(ordered[-1 - ordered.size // 50])
    height, width = high - low, REST_WIDTH * (high - low)
    rows = finite[: finite.size // 8 * 8].reshape(-1, 8)
    bend = np.sort(np.sqrt(np.mean(np.diff(rows, n=2, axis=1) ** 2, axis=1) / 6.0))
    noise = NOISE_MULTIPLE * float(bend[bend.size // 4]) if bend.size else 0.0
    sure = min(MAX_SURE_SHARE * height, max(MIN_SURE_SHARE * height, noise))
    at_low, at_high = float(np.mean(ordered < low + width)), float(np.mean(ordered > high - width))
    if max(at_low, at_high) < REST_SHARE or max(at_low, at_high) < 1.5 * min(at_low, at_high):
        return low, high, 0, 0.5, sure
    return low, high, (-1 if at_low > at_high else 1), min(0.5, max(share, noise / height)), sure


@njit(cache=True, nogil=True)
def _fired_pickup(trace, sign, full_low, full_high, rest, share, hysteresis, sure, envelope_teeth):  # type: ignore[no-untyped-def]
    """Samples at which each pulse of ``sign * trace`` is sure, the level at which to cut it, and the count of NaN."""
    at, level_at = np.empty(trace.size // 2 + 2, dtype=np.int64), np.empty(trace.size // 2 + 2)
    n, missing, armed, last = 0, 0, False, 0.0
    block = min(trace.size, max(FIRST_BLOCK, trace.size // 64))
    interval = block / 8.0
    low, high = full_high, full_low
    for i in range(block):
        low, high = min(low, max(sign * trace[i], full_low)), max(high, min(sign * trace[i], full_high))
    peak = trough = level = low
    for i in range(trace.size):
        value = sign * trace[i]
        missing += value != value
        height = max(high - low, 0.0)
        if rest == 0:
            level = 0.0 if low < 0.0 < high and min(-low, high) > 0.25 * height else 0.5 * (low + high)
            band = max(sure, 0.5 * hysteresis * height)
        else:
            off = max(2.0 * sure, share * height)
            level = low + off if rest < 0 else high - off
            band = max(sure, hysteresis * share * height)
        if armed:
            trough = min(trough, value)
            if value > level + band:
                at[n], level_at[n] = i, level
                n += 1
                low = _followed(low, trough, envelope_teeth)
                armed, peak, interval, last = False, value, i - last, float(i)
        else:
            peak = max(peak, value)
            if value < level - band:
                if n > 0:
                    high = _followed(high, peak, envelope_teeth)
                armed, trough = True, value
        if i - last > 2.0 * envelope_teeth * interval:
            # the wheel slows or its pulses fade: look for pulses of half the height
            shrink, last = 0.25 * (high - low), float(i)
            low, high = (low if rest < 0 else low + shrink), (high if rest > 0 else high - shrink)
    return at[:n].copy(), level_at[:n].copy(), missing


@njit(cache=True, nogil=True)
def _followed(level, seen, envelope_teeth):  # type: ignore[no-untyped-def]
    """Level of the extremes after one more tooth, followed over ``envelope_teeth`` teeth."""
    return level + (seen - level) / envelope_teeth


@njit(cache=True, nogil=True, error_model="numpy")
def _crossings(trace, sign, fired, level, low, high):  # type: ignore[no-untyped-def]
    """Positions [samples] of the crossings before ``fired``, how many lie between settled samples, their variance.

    ``level`` holds the cut of each, or one for all.
    """
    position, n, settled = np.empty(fired.size), 0, 0
    bottom, top = low + SETTLED_SHARE * (high - low), high - SETTLED_SHARE * (high - low)
    for k in range(fired.size):
        i, cut = fired[k], level[min(k, level.size - 1)]
        while i > 0 and sign * trace[i - 1] > cut:
            i -= 1
        before, after = sign * trace[max(i - 1, 0)], sign * trace[i]
        position[n] = i - 1 + (cut - before) / (after - before)
        crossed = i > 0 and before <= cut
        n += crossed
        settled += crossed & (before < bottom) & (after > top)
    variance = settled * QUANTISED_EDGE_SAMPLES**2 + (n - settled) * INTERPOLATED_EDGE_SAMPLES**2
    return position[:n], settled, variance / max(n, 1)
