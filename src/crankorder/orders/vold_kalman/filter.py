"""Envelopes of orders by the second-generation Vold-Kalman filter: one or several jointly, of one or more shafts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.orders.vold_kalman.bandwidth import NOISE_BANDWIDTH, POLES, local_level, structural_weight
from crankorder.orders.vold_kalman.system import DEGREE, EnvelopeSystem, middles, place_knots
from crankorder.quantities import Bools, Complexes, Floats, Ints

LEAST_SPACING = 2.0
"""Samples between knots at least, however wide the band: below, the equations are no longer definite."""

NARROWEST = 0.02
"""Least bandwidth times length of the record: below 0.1 an envelope is a straight line to working precision."""

WIDEST_RATIO = 200.0
"""Of the bandwidths of joint orders: beyond, the narrowest loses too many digits on the knots of the widest."""

MOST_MAGNIFICATION = 1e3
"""Noise power of an order, over that of the same order alone, beyond which it counts as not distinguishable."""


def closest(phase_rev: Floats, bandwidth_hz: Floats, *, rate_hz: float, names: Sequence[str]) -> tuple[str, float]:
    """Name of the two components that are closest for their bandwidth, and their median distance in Hz.

    ``phase_rev`` (orders, samples) at ``rate_hz``, ``bandwidth_hz`` (orders, points), ``names`` (orders,) for people.
    A component is also held against its own and the others' images at minus the frequency, and at the sample rate.
    """
    frequency, width = np.diff(phase_rev, axis=1) * rate_hz, np.sqrt(np.median(bandwidth_hz, axis=1))
    pairs = []
    for j, second in enumerate(names):
        for i, first in enumerate(names[: j + 1]):
            image = "its own image" if i == j else f"the image of {second}"
            for sign, other in ((-1.0, second), (1.0, f"{image} at minus the frequency")):
                apart = frequency[i] + sign * frequency[j]
                apart_hz = float(np.median(np.abs(apart - rate_hz * np.round(apart / rate_hz))))
                if i != j or sign > 0:
                    pairs.append((apart_hz / (width[i] * width[j]), f"{first} and {other}", apart_hz))
    return min(pairs)[1:]


def vold_kalman(
    signals: NDArray[np.floating],
    phase_rev: Floats,
    place: Ints,
    *,
    usable: Bools,
    rate_hz: float,
    bandwidth_hz: Floats,
    names: Sequence[str],
    knots_per_bandwidth: int = 16,
) -> tuple[Complexes, Floats]:
    """Complex amplitudes (channels, orders, places) of all orders and their standard errors, at the samples ``place``.

    ``signals`` (channels, samples) at ``rate_hz`` count where they are ``usable``, of the same shape; envelopes go on
    elsewhere as smoothly as they can. ``phase_rev`` (orders, samples), finite: revolutions of each component, order
    times crank angle, of any shaft. ``bandwidth_hz`` (orders, points), two points or more, even across the record with
    the first at its beginning and the last at its end: from half-power point to half-power point, narrower for less
    noise and better separation, wider for faster changes. ``names`` (orders,): what an error calls them.
    ``knots_per_bandwidth``: envelopes are quintic between 16 knots in a reciprocal bandwidth, inside the band right to
    1e-9, or 8, right to 1e-5; what lies further from the order than half so many bandwidths is rejected altogether.

    The line of an order is Re(amplitude · exp(2πi phase_rev)); the standard error is that of the real and of the
    imaginary part, thus of the amplitude too (of the phase in rad: over the amplitude).
    Data are met in their real form, a cos + b sin, so that the image at minus the frequency does not leak, and a
    constant is fitted with the orders. Raises RequestError where bandwidths differ too much or orders cannot be told
    apart within bandwidth and length.
    Source: Vold and Leuridan 1993; Tuma 2005; the restriction to splines as in Hutchinson and de Hoog 1985.
    """
    if float((bandwidth_hz.max(axis=0) / bandwidth_hz.min(axis=0)).max()) > WIDEST_RATIO:
        raise RequestError(
            "the bandwidths of orders tracked jointly differ too much",
            found=f"{bandwidth_hz.min():g} and {bandwidth_hz.max():g} Hz",
            allowed=f"up to 1 : {WIDEST_RATIO:g}",
            remedy="track the narrow and the wide ones apart",
        )
    n_samples = signals.shape[1]
    width = np.maximum(bandwidth_hz, NARROWEST * rate_hz / n_samples)
    spacing = np.maximum(rate_hz / (knots_per_bandwidth * width.max(axis=0)), LEAST_SPACING)
    starts = place_knots(spacing, n_samples)
    points = np.linspace(-0.5, n_samples - 0.5, width.shape[1])
    width = np.array([np.interp(middles(starts), points, of_order) for of_order in width]) / rate_hz
    shape = (len(signals), len(phase_rev), len(place))
    amplitude, error = np.empty(shape, dtype=np.complex128), np.empty(shape)
    for mask in {row.tobytes(): row for row in usable}.values():
        chosen = (usable == mask).all(axis=1)
        values = np.where(mask, signals[chosen], 0.0)
        # powers of two that bring signals near one: squares then neither overflow nor vanish
        scale = np.ldexp(1.0, np.clip(-np.frexp(np.abs(values).max(axis=1))[1], -1000, 1000))[:, None, None]
        system = EnvelopeSystem(values * scale[:, 0], phase_rev, mask, starts, structural_weight(width).T)
        try:
            values, offset, variance = system.solve()
            magnification = _magnification(variance, width, mask, starts)
        except np.linalg.LinAlgError:
            magnification = np.inf
        if not magnification < MOST_MAGNIFICATION:
            pair, distance_hz = closest(phase_rev, bandwidth_hz, rate_hz=rate_hz, names=names)
            raise RequestError(
                f"{pair} cannot be told apart",
                found=f"{distance_hz:.4g} Hz apart, bandwidth {bandwidth_hz.max():g} Hz, {n_samples / rate_hz:g} s; "
                f"noise power times {magnification:.2g}",
                allowed=f"a noise power up to {MOST_MAGNIFICATION:g} times that of each order alone",
                remedy=f"ask for a bandwidth below {max(distance_hz, 1e-300):.2g} Hz, take a longer recording, "
                "or fewer orders",
            )
        amplitude[chosen] = system.amplitude_at(values, place) / scale
        errors = standard_errors(*system.residual_sums(values, offset), variance, width, phase_rev, starts) / scale
        error[chosen] = [[np.interp(place, middles(starts), row) for row in of_channel] for of_channel in errors]
    return amplitude, error


def standard_errors(
    sums: Complexes, weight: Floats, variance: Floats, width: Floats, phase_rev: Floats, starts: Ints
) -> Floats:
    """Standard errors (channels, orders, intervals) in the middle of each interval, of real and imaginary part.

    The noise is that of the local residual spectrum beside each order, from ``sums`` (channels, orders, splines) of the
    residual and their ``weight``; what the filter lets through of it is the ``variance`` (orders, intervals) of the
    solution. ``width`` (orders, intervals) is the bandwidth per sample rate, ``phase_rev`` (orders, samples) and
    ``starts`` are those of the equations.
    """
    place = np.arange(variance.shape[1]) + 0.5 * DEGREE
    # cycles per spline
    turns = np.diff(np.column_stack([phase_rev[:, starts[:-1]], 2.0 * phase_rev[:, -1] - phase_rev[:, -2]]), axis=1)
    turns = np.pad(turns, ((0, 0), (DEGREE - DEGREE // 2, DEGREE // 2)), mode="edge")
    errors = np.empty((len(sums), *variance.shape))
    for k, spread in enumerate(variance):
        per_bandwidth = float(np.median(1.0 / (np.diff(starts) * width[k])))
        others = np.delete(turns - turns[k], k, axis=0)
        at, level = local_level(sums[:, k], weight[k], others, sums_per_bandwidth=per_bandwidth)
        errors[:, k] = [np.sqrt(np.interp(place, at, row) * spread) for row in level]
    return errors


def _magnification(variance: Floats, width: Floats, usable: Bools, starts: Ints) -> float:
    """Largest noise power of an order over that of the order alone, median over the usable places.

    ``variance`` and ``width`` (orders, intervals) as of ``standard_errors``, ``usable`` (samples,).
    """
    share = np.add.reduceat(usable, starts[:-1], dtype=np.int64) / np.diff(starts)
    alone = 2.0 * NOISE_BANDWIDTH * width + 2.0 * POLES / len(usable)
    return float(np.median((variance / alone)[:, share > min(0.5, 0.5 * share.max())], axis=1).max())
