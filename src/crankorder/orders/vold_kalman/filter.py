"""Envelopes of orders by the second-generation Vold-Kalman filter: one or several jointly, of one or more shafts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import InputError, RequestError
from crankorder.orders.vold_kalman.bandwidth import local_level, noise_bandwidth_share
from crankorder.orders.vold_kalman.system import EnvelopeSystem, Solution
from crankorder.quantities import Bools, Complexes, Floats, Ints

MOST_POLES = 4

FEWEST_SAMPLES = 64

WIDEST_RATIO = 200.0
"""Of the bandwidths of joint orders: beyond, the narrowest loses too many digits on the knots of the widest."""

MOST_MAGNIFICATION = 1e3
"""Noise power of an order, over that of the same order alone, beyond which it counts as not distinguishable."""


def closest(phase_rev: Floats, bandwidth_hz: Floats, *, rate_hz: float, names: Sequence[str]) -> tuple[str, float]:
    """Name of the two components that are closest for their bandwidth, and their median distance in Hz.

    ``phase_rev`` (orders, samples) at ``rate_hz``, ``bandwidth_hz`` (orders, points), ``names`` (orders,) for people.
    A component is also held against its own and the others' images at minus the frequency, and at the sample rate.
    """
    frequency = np.diff(phase_rev, axis=1) * rate_hz
    width = np.median(bandwidth_hz, axis=1)
    pairs = []
    for i in range(len(frequency)):
        for j in range(i, len(frequency)):
            wide = float(width[i] * width[j]) ** 0.5
            if i != j:
                apart = _distance(frequency[i] - frequency[j], rate_hz)
                pairs.append((apart / wide, f"{names[i]} and {names[j]}", apart))
            apart = _distance(frequency[i] + frequency[j], rate_hz)
            image = "its own image" if i == j else f"the image of {names[j]}"
            pairs.append((apart / wide, f"{names[i]} and {image} at minus the frequency", apart))
    return min(pairs)[1:]


def _distance(difference_hz: Floats, rate_hz: float) -> float:
    return float(np.median(np.abs(difference_hz - rate_hz * np.round(difference_hz / rate_hz))))


@dataclass(frozen=True)
class VoldKalmanTracks:
    """Tracks of all channels: the line of an order is Re(amplitude · exp(2πi phase_rev)).

    ``amplitude`` (channels, orders, samples), peak; ``residual`` (channels, samples), signal less all tracks, NaN where
    not usable; ``offset`` (channels,) the constant part, which stays in the residual; ``error_place`` (places,) samples
    at which ``error`` (channels, orders, places) is the standard error of the real and of the imaginary part, thus of
    the amplitude too (of the phase in rad: over the amplitude).
    """

    amplitude: Complexes
    residual: Floats
    offset: Floats
    error_place: Floats
    error: Floats

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
    names: Sequence[str] | None = None,
    knots_per_bandwidth: int | None = None,
) -> VoldKalmanTracks:
    """VoldKalmanTracks: complex envelopes of all orders at every sample, the residual, and standard errors.

    ``signals`` (channels, samples), float32 or float64; what is not finite is not usable. ``phase_rev`` (orders,
    samples), revolutions of each component: order times crank angle, of any shaft. ``rate_hz`` of the samples.
    ``bandwidth_hz`` (orders,) or (orders, samples), or one for all: from half-power point to half-power point, narrower
    for less noise and better separation, wider for faster changes. ``poles`` 1 to 4: slope beyond the band, 12 dB per
    octave each. ``usable`` (samples,) or (channels, samples), False where the signal counts nothing; the envelopes go
    on there as smoothly as they can. ``names`` (orders,): what an error calls them, "order 2" for one.
    ``knots_per_bandwidth``: envelopes are quintic between 16 knots (one pole: 64) in a reciprocal bandwidth, right at
    any bandwidth; with 8 in place of these they are right to 1e-5, at a third of the cost.

    Data are met in their real form, a cos + b sin, so that the image at minus the frequency does not leak, and a
    constant is fitted with the orders. Raises RequestError where arguments do not fit or orders cannot be told apart
    within bandwidth and length, InputError where too few samples are usable.
    Source: Vold and Leuridan 1993; Tuma 2005; the restriction to splines as in Hutchinson and de Hoog 1985.
    """
    values, phase, bandwidth = _checked(signals, phase_rev, bandwidth_hz, rate_hz=rate_hz, poles=poles)
    mask = _mask(values, usable)
    called = [f"component {k}" for k in range(len(phase))] if names is None else names
    groups: dict[bytes, list[int]] = {}
    for channel, row in enumerate(mask):
        groups.setdefault(b"" if row.all() else row.tobytes(), []).append(channel)
    parts = []
    for chosen in groups.values():
        group = values if len(chosen) == len(values) else values[chosen]
        system = EnvelopeSystem(
            group, phase, mask[chosen[0]], bandwidth_hz=bandwidth, rate_hz=rate_hz, poles=poles,
            knots_per_bandwidth=knots_per_bandwidth,
        )  # fmt: skip
        parts.append(_solved(system, bandwidth, rate_hz=rate_hz, names=called))
    if len(parts) == 1:
        return parts[0]
    # tracks of all channels from those of groups with equal gaps
    order = np.argsort([channel for group in groups.values() for channel in group])
    of_channels = {
        name: np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("amplitude", "residual", "offset", "error")
    }
    return replace(parts[0], **of_channels)


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
    if float((band.max(axis=0) / band.min(axis=0)).max()) > WIDEST_RATIO:
        raise RequestError(
            "the bandwidths of orders tracked jointly differ too much",
            found=f"{band.min():g} and {band.max():g} Hz",
            allowed=f"up to 1 : {WIDEST_RATIO:g}",
            remedy="track the narrow and the wide ones apart",
        )
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


def _solved(system: EnvelopeSystem, bandwidth: Floats, *, rate_hz: float, names: Sequence[str]) -> VoldKalmanTracks:
    """VoldKalmanTracks of the ``system``; RequestError where its orders cannot be told apart."""
    try:
        solution = system.solve()
        magnification = _magnification(system, solution.variance, bandwidth, rate_hz)
    except np.linalg.LinAlgError:
        magnification = np.inf
    if magnification > MOST_MAGNIFICATION:
        pair, distance_hz = closest(system.phase_rev, bandwidth, rate_hz=rate_hz, names=names)
        seconds = len(system.usable) / rate_hz
        raise RequestError(
            f"{pair} cannot be told apart",
            found=f"{distance_hz:.4g} Hz apart, bandwidth {bandwidth.max():g} Hz, {seconds:g} s; noise power times "
            f"{magnification:.2g}",
            allowed=f"a noise power up to {MOST_MAGNIFICATION:g} times that of each order alone",
            remedy=f"ask for a bandwidth below {max(distance_hz, 1e-300):.2g} Hz, take a longer recording, or fewer "
            "orders",
        )
    amplitude, residual = system.read(solution)
    offset = solution.offset / system.scale
    return VoldKalmanTracks(amplitude, residual, offset, system.knots.middles, standard_errors(system, solution))


def standard_errors(system: EnvelopeSystem, solution: Solution) -> Floats:
    """Standard errors (channels, orders, intervals) in the middle of each interval, of real and imaginary part.

    ``system`` must have read all of its record with ``solution``. The noise is that of the local residual spectrum
    beside each order; what the filter lets through of it is the variance of the solution.
    """
    sums, weight = system.residual_sums()
    place = np.arange(system.knots.intervals) + 0.5 * (weight.shape[1] - system.knots.intervals)
    errors = np.empty((len(sums), len(weight), system.knots.intervals))
    for k, per_bandwidth in enumerate(system.sums_per_bandwidth):
        spread = 0.5 * (solution.variance[:, k] + solution.variance[:, len(weight) + k])
        at, level = local_level(
            sums[:, k], weight[k], system.distances(k), sums_per_bandwidth=per_bandwidth, poles=system.poles
        )
        errors[:, k] = [np.sqrt(np.interp(place, at, row) * spread) for row in level]
    return errors / system.scale[:, None, None]


def _magnification(system: EnvelopeSystem, variance: Floats, bandwidth: Floats, rate_hz: float) -> float:
    """Largest noise power of an order over that of the order alone, median over the usable places."""
    n_samples, starts = len(system.usable), system.knots.starts
    share = np.add.reduceat(system.usable, starts[:-1], dtype=np.int64) / np.diff(starts)
    seen = share > 0.5 if np.any(share > 0.5) else share > 0.0
    points = np.linspace(0.0, n_samples, bandwidth.shape[1])
    magnified = []
    for k, of_order in enumerate(bandwidth):
        width = np.interp(system.knots.middles, points, of_order)
        alone = 2.0 * noise_bandwidth_share(system.poles) * width / rate_hz + 2.0 * system.poles / n_samples
        both = 0.5 * (variance[:, k] + variance[:, len(bandwidth) + k])
        magnified.append(float(np.median((both / alone)[seen])))
    return max(magnified)
