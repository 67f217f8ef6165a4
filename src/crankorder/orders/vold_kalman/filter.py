"""Envelopes of orders by the second-generation Vold-Kalman filter: one or several jointly, of one or more shafts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.special import binom

from crankorder.errors import InputError, RequestError
from crankorder.orders.vold_kalman.banded import cos_sin, factorise, inverse_band, solve
from crankorder.orders.vold_kalman.bandwidth import (
    SPLINE_CORRELATION,
    local_level,
    noise_bandwidth_share,
    structural_weight,
)
from crankorder.orders.vold_kalman.system import KNOTS_PER_BANDWIDTH, LEAST_CONSTANT, EnvelopeSystem, Solution
from crankorder.quantities import Bools, Complexes, Floats, Ints

BLOCK = 65_536
"""Samples solved for at a time, beside the margins that are thrown away."""

MARGIN_BANDWIDTHS = 48.0
"""Margin of a block, in reciprocal bandwidths: what the equations say of one sample has faded to 1e-16 there."""

HEAVIEST = 1e12
"""Largest eigenvalue 4^poles r² of the structure beyond which refinement does not restore the digits that are lost."""

REFINEMENTS = 2
"""Steps of iterative refinement."""


MOST_POLES = 4

FEWEST_SAMPLES = 64

LEAST_SPACING = (6, 6, 6, 3)
"""Samples between knots, by poles, below which the equations are solved at every sample."""

WIDEST_RATIO = 200.0
"""Of the bandwidths of joint orders: beyond, the narrowest loses too many digits on the knots of the widest."""

MOST_MAGNIFICATION = 1e3
"""Noise power of an order, over that of the same order alone, beyond which it counts as not distinguishable."""

Method = Literal["auto", "knots", "samples"]


def closest(
    phase_rev: Floats, bandwidth_hz: Floats, *, rate_hz: float, names: Sequence[str] | None = None
) -> tuple[str, float]:
    """Name of the two components that are closest for their bandwidth, and their median distance in Hz.

    ``phase_rev`` (orders, samples) at ``rate_hz``, ``bandwidth_hz`` (orders, points), ``names`` (orders,) for people,
    "component 0" and so on without. A component is also held against its own and the others' images at minus the
    frequency, and at the sample rate.
    """
    frequency = np.diff(phase_rev, axis=1) * rate_hz
    width = np.median(bandwidth_hz, axis=1)
    called = [f"component {k}" for k in range(len(frequency))] if names is None else list(names)
    pairs = []
    for i in range(len(frequency)):
        for j in range(i, len(frequency)):
            wide = float(width[i] * width[j]) ** 0.5
            if i != j:
                apart = _distance(frequency[i] - frequency[j], rate_hz)
                both = f"components {i} and {j}" if names is None else f"{called[i]} and {called[j]}"
                pairs.append((apart / wide, both, apart))
            apart = _distance(frequency[i] + frequency[j], rate_hz)
            image = "its own image" if i == j else f"the image of {called[j]}"
            pairs.append((apart / wide, f"{called[i]} and {image} at minus the frequency", apart))
    return min(pairs)[1:]


def _distance(difference_hz: Floats, rate_hz: float) -> float:
    return float(np.median(np.abs(difference_hz - rate_hz * np.round(difference_hz / rate_hz))))


def envelopes_at_samples(
    signals: Floats, phase_rev: Floats, usable: Bools, *, weight: Floats, poles: int, margin: int
) -> tuple[Floats, Floats]:
    """Envelopes of all orders jointly, and their variance, in blocks with ``margin`` samples on both sides.

    ``signals`` (channels, samples) finite, ``phase_rev`` (orders, samples), ``usable`` (samples,), ``weight`` (orders,
    samples) the structural weight r², ``poles`` of the filter. Envelopes (channels + 1, samples, rows) are those of
    cosines and sines, the last channel for a signal of ones; the variance (samples, rows) is per unit of white noise
    variance. Raises RequestError where a block is not definite.
    """
    n_samples, rows = signals.shape[1], 2 * len(phase_rev)
    values = np.empty((len(signals) + 1, n_samples, rows))
    variance = np.empty((n_samples, rows))
    for begin in range(0, n_samples, BLOCK):
        end = min(n_samples, begin + BLOCK)
        low, high = max(0, begin - margin), min(n_samples, end + margin)
        near, inside = slice(low, high), slice(begin - low, end - low)
        waves = np.empty((rows, high - low))
        for k, phase in enumerate(phase_rev):
            cos_sin(phase[near], waves[k], waves[len(phase_rev) + k])
        waves *= usable[near]
        envelopes, diagonal = _solved(signals[:, near], waves, weight[:, near], poles)
        values[:, begin:end], variance[begin:end] = envelopes[:, inside], diagonal[inside]
    return values, variance


def _solved(signals: Floats, waves: Floats, weight: Floats, poles: int) -> tuple[Floats, Floats]:
    rows, n = waves.shape
    steps = (-1.0) ** np.arange(poles + 1) * binom(poles, np.arange(poles + 1))
    band = np.zeros((n * rows, rows * poles + 1))
    _assemble(waves, weight, steps, band)
    if factorise(band) >= 0:
        raise RequestError("the normal equations are not definite", remedy="two of the orders move together")
    # the solver works in place, which takes contiguous arrays
    wanted = np.ascontiguousarray(np.concatenate([signals, np.ones((1, n))])[:, :, None] * waves.T)
    found = wanted.copy()
    solve(band, found.reshape(len(found), -1))
    for _ in range(REFINEMENTS):
        step = np.ascontiguousarray(wanted - np.einsum("nr,cn->cnr", waves.T, np.einsum("cnr,rn->cn", found, waves)))
        rough = np.diff(found, poles, axis=1)
        for row in range(rows):
            pulled = weight[row % len(weight), poles:] * rough[:, :, row]
            for lag, factor in enumerate(steps):
                step[:, poles - lag : n - lag, row] -= factor * pulled
        solve(band, step.reshape(len(step), -1))
        found += step
    return found, inverse_band(band)[:, -1].reshape(n, rows)


def with_offset(values: Floats, signals: Floats, phase_rev: Floats, usable: Bools) -> tuple[Complexes, Floats, Floats]:
    """Amplitudes (channels, orders, samples), residual (channels, samples) and constant part (channels,).

    ``values`` are envelopes of ``envelopes_at_samples``; ``signals``, ``phase_rev`` and ``usable`` as given to
    it. The constant is fitted jointly: what of the ones the orders do not explain.
    """
    k = len(phase_rev)
    turn = np.exp(2j * np.pi * (phase_rev - np.floor(phase_rev)))
    envelopes = values[:, :, :k] - 1j * values[:, :, k:]
    lines = np.einsum("cnk,kn->cn", envelopes, turn).real
    unexplained = usable.sum() - float(lines[-1][usable].sum())
    offset = np.zeros(len(signals))
    if unexplained > LEAST_CONSTANT * usable.sum():
        offset = (signals - lines[:-1])[:, usable].sum(axis=1) / unexplained
    amplitude = (envelopes[:-1] - offset[:, None, None] * envelopes[-1:]).transpose(0, 2, 1)
    residual = signals - np.einsum("ckn,kn->cn", amplitude, turn).real
    return np.ascontiguousarray(amplitude), residual, offset


def _errors_beside(
    sums: Complexes, weight: Floats, others: Floats, spread: Floats, place: NDArray[Any], **reading: Any
) -> Floats:
    """Standard errors (channels, places) of one order from the noise that residual ``sums`` hold beside it.

    ``spread`` (places, rows) is the variance of cosine and sine per unit of white noise at each ``place``; ``sums``,
    ``weight``, ``others`` and the ``reading`` are those of :func:`local_level`.
    """
    at, level = local_level(sums, weight, others, **reading)
    return np.array([np.sqrt(np.interp(place, at, row) * (0.5 * (spread[:, 0] + spread[:, 1]))) for row in level])


def sample_errors(
    remaining: Floats, phase_rev: Floats, usable: Bools, variance: Floats, samples_per_bandwidth: Floats, poles: int
) -> Floats:
    """Standard errors (channels, orders, samples) from the local residual spectrum beside each order.

    ``remaining`` (channels, samples) residual without constant, ``phase_rev`` (orders, samples), ``usable`` (samples,),
    ``variance`` (samples, rows) per unit of white noise, ``samples_per_bandwidth`` (orders,), ``poles`` of the filter.
    """
    weight, at = usable.astype(np.float64), np.arange(len(usable))
    reading = {"poles": poles, "correlation": np.ones(1)}
    errors = np.empty((len(remaining), *phase_rev.shape))
    for k, phase in enumerate(phase_rev):
        others = np.gradient(np.delete(phase_rev, k, axis=0) - phase, axis=1)
        turned = np.where(usable, remaining, 0.0) * np.exp(-2j * np.pi * (phase - np.floor(phase)))
        reading["sums_per_bandwidth"] = float(samples_per_bandwidth[k])
        errors[:, k] = _errors_beside(turned, weight, others, variance[:, k :: len(phase_rev)], at, **reading)
    return errors


@njit(cache=True, nogil=True)
def _assemble(waves, weight, steps, band):  # type: ignore[no-untyped-def]
    """Fill ``band`` with the data's weight and the structural equation of every sample that has enough before it."""
    rows, n = waves.shape
    width, poles = band.shape[1] - 1, steps.shape[0] - 1
    for i in range(n):
        for row in range(rows):
            for other in range(row + 1):
                band[i * rows + row, width - row + other] += waves[row, i] * waves[other, i]
            if i >= poles:
                r2 = weight[row % weight.shape[0], i]
                for a in range(poles + 1):
                    for b in range(a, poles + 1):
                        band[(i - a) * rows + row, width - (b - a) * rows] += r2 * steps[a] * steps[b]


@dataclass(frozen=True)
class VoldKalmanTracks:
    """Tracks of all channels: the line of an order is Re(amplitude · exp(2πi phase_rev)).

    ``amplitude`` (channels, orders, samples), peak; ``residual`` (channels, samples), signal less all tracks, NaN where
    not usable; ``offset`` (channels,) the constant part, which stays in the residual; ``error_place`` (places,) samples
    at which ``error`` (channels, orders, places) is the standard error of the real and of the imaginary part, thus of
    the amplitude too (of the phase in rad: over the amplitude); ``condition`` the largest noise power of an order over
    that of the order alone; ``method``: "knots" or "samples"; ``notes`` for people.
    """

    amplitude: Complexes
    residual: Floats
    offset: Floats
    error_place: Floats
    error: Floats
    condition: float
    method: str
    notes: tuple[str, ...]

    @property
    def standard_error(self) -> Floats:
        """Standard error (channels, orders, samples) at every sample, linear between ``error_place``."""
        return self.error_at(np.arange(self.residual.shape[1]))

    def error_at(self, place: Ints) -> Floats:
        """Standard error (channels, orders, places) at the samples ``place``, linear between ``error_place``."""
        rows = [np.interp(place, self.error_place, row) for row in self.error.reshape(-1, len(self.error_place))]
        return np.array(rows).reshape(*self.error.shape[:2], len(place))


def vold_kalman(
    signals: ArrayLike,
    phase_rev: ArrayLike,
    *,
    rate_hz: float,
    bandwidth_hz: ArrayLike,
    poles: int = 2,
    usable: ArrayLike | None = None,
    method: Method = "auto",
    names: Sequence[str] | None = None,
    knots_per_bandwidth: int | None = None,
) -> VoldKalmanTracks:
    """VoldKalmanTracks: complex envelopes of all orders at every sample, the residual, and standard errors.

    ``signals`` (channels, samples), float32 or float64; what is not finite is not usable. ``phase_rev`` (orders,
    samples), revolutions of each component: order times crank angle, of any shaft. ``rate_hz`` of the samples.
    ``bandwidth_hz`` (orders,) or (orders, samples), or one for all: from half-power point to half-power point, narrower
    for less noise and better separation, wider for faster changes. ``poles`` 1 to 4: slope beyond the band, 12 dB per
    octave each. ``usable`` (samples,) or (channels, samples), False where the signal counts nothing; the envelopes go
    on there as smoothly as they can. ``method``: "samples" solves at every sample; "knots" for quintic envelopes
    between knots, 16 (one pole: 64) in a reciprocal bandwidth, right at any bandwidth; "auto" takes knots wherever
    they are six samples apart. ``names`` (orders,): what an error calls them, "order 2" for one.
    ``knots_per_bandwidth`` in place of 16 (64): with 8 the envelopes are right to 1e-5, at a third of the cost.

    Data are met in their real form, a cos + b sin, so that the image at minus the frequency does not leak, and a
    constant is fitted with the orders. Raises RequestError where arguments do not fit or orders cannot be told apart
    within bandwidth and length, InputError where too few samples are usable.
    Source: Vold and Leuridan 1993; Tuma 2005; the restriction to splines as in Hutchinson and de Hoog 1985.
    """
    values, phase, bandwidth = _checked(signals, phase_rev, bandwidth_hz, rate_hz=rate_hz, poles=poles)
    mask = _mask(values, usable)
    density = knots_per_bandwidth or KNOTS_PER_BANDWIDTH[poles - 1]
    spacing = rate_hz / (density * float(bandwidth.max()))
    used = method if method != "auto" else ("knots" if spacing >= LEAST_SPACING[poles - 1] else "samples")
    _check_ratio(bandwidth, rate_hz=rate_hz, poles=poles, method=used)
    groups: dict[bytes, list[int]] = {}
    for channel, row in enumerate(mask):
        groups.setdefault(b"" if row.all() else row.tobytes(), []).append(channel)
    parts = []
    for chosen in groups.values():
        group = values if len(chosen) == len(values) else values[chosen]
        try:
            given = (group, phase, bandwidth, mask[chosen[0]], rate_hz, poles)
            parts.append(_by_knots(*given, density) if used == "knots" else _by_samples(*given))
        except _TooCloseError as error:
            raise _indistinguishable(phase, bandwidth, rate_hz, error.magnification, names) from error
    if len(parts) == 1:
        return parts[0]
    # tracks of all channels from those of groups with equal gaps
    order = np.argsort([channel for group in groups.values() for channel in group])
    worst = max(parts, key=lambda part: part.condition)
    of_channels: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("amplitude", "residual", "offset", "error")
    }
    return replace(worst, **of_channels, notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)))


def _checked(
    signals: ArrayLike, phase_rev: ArrayLike, bandwidth_hz: ArrayLike, *, rate_hz: float, poles: int
) -> tuple[NDArray[np.floating], Floats, Floats]:
    """Arguments as arrays: signals (channels, samples), phases (orders, samples), bandwidths (orders, points)."""
    values = np.asarray(signals)
    if values.dtype not in (np.float32, np.float64):
        values = values.astype(np.float64)
    phase = np.ascontiguousarray(phase_rev, dtype=np.float64)
    if values.ndim != 2 or phase.ndim != 2 or values.shape[1] != phase.shape[1] or not len(phase) or not len(values):
        raise RequestError(
            "signals and phases do not fit",
            found=f"signals {values.shape}, phase_rev {phase.shape}",
            allowed="(channels, samples) and (orders, samples)",
        )
    if poles not in range(1, MOST_POLES + 1):
        raise RequestError("no such filter", place="poles", found=poles, allowed=f"1 to {MOST_POLES}")
    if values.shape[1] < FEWEST_SAMPLES:
        raise InputError("too short for a Vold-Kalman filter", found=f"{values.shape[1]} samples", allowed="64 or more")
    if not np.isfinite(phase.sum()):
        raise InputError("the phase of an order is not finite", remedy="leave out the samples without crank angle")
    band = np.atleast_1d(np.asarray(bandwidth_hz, dtype=np.float64))
    band = np.broadcast_to(band, (len(phase),)) if band.size == 1 else band
    band = np.repeat(band[:, None], 2, axis=1) if band.ndim == 1 else band
    if band.ndim != 2 or len(band) != len(phase) or band.shape[1] < 2:
        raise RequestError("bandwidths do not fit the orders", found=band.shape, allowed=f"({len(phase)},)")
    if not (np.isfinite(band).all() and band.min() > 0.0 and band.max() < 0.5 * rate_hz):
        found = f"{band.min():g} to {band.max():g} Hz"
        raise RequestError("no such bandwidth", found=found, allowed=f"above 0, below {0.5 * rate_hz:g} Hz")
    return np.ascontiguousarray(values), phase, np.ascontiguousarray(band)


def _mask(values: NDArray[np.floating], usable: ArrayLike | None) -> Bools:
    """Which samples count (channels, samples): those named and finite."""
    mask: Bools = np.isfinite(values)
    if usable is not None:
        named = np.asarray(usable, dtype=bool)
        if named.shape not in (values.shape, values.shape[1:]):
            raise RequestError("usable does not fit the signals", found=named.shape, allowed=str(values.shape))
        mask &= named
    if mask.sum(axis=1).min() < FEWEST_SAMPLES:
        found = f"{mask.sum(axis=1).min()} usable samples in one channel"
        raise InputError("too short for a Vold-Kalman filter", found=found, allowed="64 or more")
    return mask


def _check_ratio(bandwidth: Floats, *, rate_hz: float, poles: int, method: str) -> None:
    widest, narrowest = float(bandwidth.max()), float(bandwidth.min())
    if method == "samples":
        heaviest = float(structural_weight(np.array(narrowest), rate_hz=rate_hz, poles=poles)) * 4.0**poles
        if heaviest > HEAVIEST:
            raise RequestError(
                "the bandwidth is too narrow to solve at every sample",
                found=f"4^poles r² = {heaviest:.1e} for {narrowest:g} Hz",
                allowed=f"up to {HEAVIEST:g}",
                remedy="track this order apart from the wide ones" if widest > 2 * narrowest else "use method 'knots'",
            )
    elif float((bandwidth.max(axis=0) / bandwidth.min(axis=0)).max()) > WIDEST_RATIO:
        raise RequestError(
            "the bandwidths of orders tracked jointly differ too much",
            found=f"{narrowest:g} and {widest:g} Hz",
            allowed=f"up to 1 : {WIDEST_RATIO:g}",
            remedy="track the narrow and the wide ones apart",
        )


def _scales(values: NDArray[np.floating], mask: Bools) -> Floats:
    """Powers of two (channels,) that bring signals near one: squares then neither overflow nor vanish."""
    whole = bool(mask.all())
    known = [row if whole else row[mask] for row in values]
    largest = np.array([max(float(row.max()), -float(row.min())) for row in known])
    return np.asarray(np.ldexp(1.0, np.clip(-np.frexp(largest)[1], -1000, 1000)))


def _by_knots(
    values: NDArray[np.floating], phase: Floats, bandwidth: Floats, mask: Bools, rate_hz: float, poles: int, knots: int
) -> VoldKalmanTracks:
    """VoldKalmanTracks by so many ``knots`` in a reciprocal bandwidth."""
    system = EnvelopeSystem(
        n_samples=values.shape[1],
        n_channels=len(values),
        bandwidth_hz=bandwidth,
        rate_hz=rate_hz,
        poles=poles,
        scale=_scales(values, mask),
        knots_per_bandwidth=knots,
    )
    system.add(values, phase, mask, begin=0)
    try:
        solution = system.solve()
    except RequestError as not_definite:
        raise _TooCloseError(np.inf) from not_definite
    middle = system.knots.middles
    usable_share = np.add.reduceat(mask, system.knots.starts[:-1], dtype=np.int64) / np.diff(system.knots.starts)
    magnification = _magnification(solution.variance, usable_share, middle, bandwidth, len(mask), rate_hz, poles)
    if magnification > MOST_MAGNIFICATION:
        raise _TooCloseError(magnification)
    amplitude, residual = system.read(solution, values, phase, mask, begin=0)
    error = standard_errors(system, solution)
    notes = [f"quintic envelopes on {system.knots.intervals} intervals; constant part fitted with the orders"]
    if magnification > 2.0:
        notes.append(f"orders are close: noise power up to {magnification:.3g} times that of each alone")
    offset = solution.offset / system.scale
    return VoldKalmanTracks(amplitude, residual, offset, middle, error, magnification, "knots", tuple(notes))


def standard_errors(system: EnvelopeSystem, solution: Solution) -> Floats:
    """Standard errors (channels, orders, intervals) in the middle of each interval, of real and imaginary part.

    ``system`` must have read all of its record with ``solution``. The noise is that of the local residual spectrum
    beside each order; what the filter lets through of it is the variance of the solution.
    """
    sums, weight = system.residual_sums()
    place = np.arange(system.knots.intervals) + 0.5 * (weight.shape[1] - system.knots.intervals)
    reading = {"poles": system.poles, "correlation": SPLINE_CORRELATION}
    errors = np.empty((len(sums), system.n_orders, system.knots.intervals))
    for k in range(system.n_orders):
        reading["sums_per_bandwidth"] = system.sums_per_bandwidth[k]
        spread = solution.variance[:, k :: system.n_orders]
        errors[:, k] = _errors_beside(sums[:, k], weight[k], system.distances(k), spread, place, **reading)
    return errors / system.scale[:, None, None]


def _by_samples(
    values: NDArray[np.floating], phase: Floats, bandwidth: Floats, mask: Bools, rate_hz: float, poles: int
) -> VoldKalmanTracks:
    n_samples = values.shape[1]
    scale = _scales(values, mask)
    signals = np.where(mask, values, 0.0) * scale[:, None]
    at, points = np.arange(n_samples, dtype=np.float64), np.linspace(0.0, n_samples - 1.0, bandwidth.shape[1])
    widths = np.array([np.interp(at, points, of_order) for of_order in bandwidth])
    weight = structural_weight(widths, rate_hz=rate_hz, poles=poles)
    margin = int(np.ceil(MARGIN_BANDWIDTHS * rate_hz / bandwidth.min()))
    try:
        values, variance = envelopes_at_samples(signals, phase, mask, weight=weight, poles=poles, margin=margin)
    except RequestError as not_definite:
        raise _TooCloseError(np.inf) from not_definite
    variance *= 1.0 - 0.5 / poles
    magnification = _magnification(variance, mask.astype(np.float64), at, bandwidth, n_samples, rate_hz, poles)
    if magnification > MOST_MAGNIFICATION:
        raise _TooCloseError(magnification)
    amplitude, remaining, offset = with_offset(values, signals, phase, mask)
    per_bandwidth = rate_hz / np.median(bandwidth, axis=1)
    errors = sample_errors(remaining - offset[:, None], phase, mask, variance, per_bandwidth, poles)
    errors /= scale[:, None, None]
    amplitude /= scale[:, None, None]
    residual = np.where(mask, remaining, np.nan) / scale[:, None]
    notes = ("envelopes at every sample; constant part fitted with the orders",)
    return VoldKalmanTracks(amplitude, residual, offset / scale, at, errors, magnification, "samples", notes)


def _magnification(
    variance: Floats, usable_share: Floats, place: Floats, bandwidth: Floats, n_samples: int, rate_hz: float, poles: int
) -> float:
    """Largest noise power of an order over that of the order alone, median over the usable places."""
    points = np.linspace(0.0, n_samples, bandwidth.shape[1])
    seen = usable_share > 0.5 if np.any(usable_share > 0.5) else usable_share > 0.0
    magnified = []
    for k, of_order in enumerate(bandwidth):
        width = np.interp(place, points, of_order)
        alone = 2.0 * noise_bandwidth_share(poles) * width / rate_hz + 2.0 * poles / n_samples
        both = 0.5 * (variance[:, k] + variance[:, len(bandwidth) + k])
        magnified.append(float(np.median((both / alone)[seen])))
    return float(np.max(magnified))


class _TooCloseError(Exception):
    """Orders cannot be told apart: their noise power is ``magnification`` times that of each alone."""

    def __init__(self, magnification: float) -> None:
        self.magnification = magnification


def _indistinguishable(
    phase: Floats, bandwidth: Floats, rate_hz: float, magnification: float, names: Sequence[str] | None
) -> RequestError:
    pair, distance_hz = closest(phase, bandwidth, rate_hz=rate_hz, names=names)
    seconds = phase.shape[1] / rate_hz
    return RequestError(
        f"{pair} cannot be told apart",
        found=f"{distance_hz:.4g} Hz apart, bandwidth {bandwidth.max():g} Hz, {seconds:g} s; noise power times "
        f"{magnification:.2g}",
        allowed=f"a noise power up to {MOST_MAGNIFICATION:g} times that of each order alone",
        remedy=f"ask for a bandwidth below {max(distance_hz, 1e-300):.2g} Hz, take a longer recording, or fewer orders",
    )
