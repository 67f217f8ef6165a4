"""Envelopes of orders by the second-generation Vold-Kalman filter: one or several jointly, of one or more shafts.

The envelopes are splines; the normal equations and the band of their inverse are compiled. A band is stored by rows,
the diagonal last: ``band[i, width - k]`` is the entry (i, i - k).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.quantities import Bools, Complexes, Floats, Ints

LEAST_SPACING = 2.0
"""Samples between knots at least, however wide the band: below, the equations are no longer definite."""

NARROWEST = 0.02
"""Least bandwidth times length of the record: below 0.1 an envelope is a straight line to working precision."""

WIDEST_RATIO = 200.0
"""Of the bandwidths of joint orders: beyond, the narrowest loses too many digits on the knots of the widest."""

MOST_MAGNIFICATION = 1e3
"""Noise power of an order, over that of the same order alone, beyond which it counts as not distinguishable."""

DEGREE = 5
"""Of the envelopes between knots: two poles leave two smooth derivatives, and two more."""

SPLINES = DEGREE + 1
"""Splines that are not zero in an interval."""

FEWEST_INTERVALS = 16
"""However narrow the band: the envelope may still bend in a record that is shorter than the filter's response."""

PASSES = 3
"""Solutions of the equations, each of what the one before it has left: two are enough unless orders are close."""

LEAST_CONSTANT = 1e-6
"""Share of a constant that the orders must leave unexplained for it to be told from them."""


POLES = 2
"""Of the filter: 24 dB per octave beyond the band."""

HALF_POWER = math.sqrt(2.0) - 1.0
"""What the structural equation weighs against the data where the gain is 1/sqrt(2)."""

FARTHEST_LAG = 16.0
"""Reciprocal bandwidths from which on noise counts as uncorrelated."""

FRAME_BANDWIDTHS = 4.0
"""Length of a frame, in reciprocal bandwidths: short enough to follow a resonance that is passed."""

FLANK = (1.0, 4.8)
"""Offsets from the order, in bandwidths, between which the noise is read, on both sides: outside of the band."""

LEAST_BINS = (2, 6)
"""First bin and number of bins of a flank where the record is short against the filter's response."""

WIDEST = 0.3
"""Highest offset read, as a share of the rate of the sums."""

LOWER = 0.75
"""Share of the bins, from below, whose mean tells the level: a line that nobody tracked is above."""

FEWEST_BINS = 6
"""Bins that tell a level, wherever the most is left."""

LEAST_LEFT = 0.3
"""Share of the noise's power that the filters must leave in a bin, beside so many: what is taken is known less well."""

INDEPENDENT = 0.55
"""Degrees of freedom, as a share of twice the bins: neighbours share a Hann window, and a quarter is left out."""

LEVEL_DOF = 4.0 * INDEPENDENT * (FLANK[1] - FLANK[0]) * FRAME_BANDWIDTHS
"""Degrees of freedom of the level of one frame."""

SPLINE_CORRELATION = np.array([15724248, 9738114, 2203488, 152637, 2036, 1]) / 15724248.0
"""Correlation of white noise between quintic splines that are 0 … 5 knots apart: splines of degree 11 at the knots."""


NOISE_BANDWIDTH = HALF_POWER ** (-0.5 / POLES) * (1.0 - 0.5 / POLES) / float(np.sinc(0.5 / POLES))
"""Noise bandwidth ∫|gain|² df over all offsets, as a share of the half-power bandwidth, far below the rate.

With gain 1/(1 + g x^(2n)), x = 1 at the half-power point, the integral is g^(-1/2n) · (1 - 1/2n) · (π/2n)/sin(π/2n)."""


def structural_weight(width: Floats) -> Floats:
    """Weight r² of the squared structural equation (∇ to the power :data:`POLES`) whose half-power bandwidth is exact.

    ``width`` (any shape), from half-power point to half-power point, per sample rate, between 0 and 1. A real line
    gives its cosine and sine envelope half a unit of data weight per sample each, thus the gain at f off the line is
    1/(1 + 2 r² (2 sin(π f/rate))^(2 POLES)), and r² = (√2 - 1)/2 / (2 sin(π width/2))^(2 POLES). The sine of half the
    angle stands for the differences of cosines in the textbook's form, which cancel where r² passes 1e8.
    Source: Tuma 2005, "Setting the passband width in the Vold-Kalman order tracking filter" (his r² is twice ours,
    being for the complex form).
    """
    return np.asarray(0.5 * HALF_POWER / (2.0 * np.sin(0.5 * np.pi * width)) ** (2 * POLES))


def impulse_response(lag_bandwidths: Floats) -> Floats:
    """Response of the filter ``lag_bandwidths`` (any shape) reciprocal bandwidths after an impulse, far below the rate.

    The cosine transform of the gain; its integral over the lag is one.
    """
    grid, table = _response_table()
    return np.asarray(np.interp(np.abs(lag_bandwidths), grid, table, right=0.0))


def taken_in_truth(share: Floats, widest: Floats) -> Floats:
    """Loss of a mode's peak in the filter over the loss in a second pass of it, as a sweep passes the mode.

    ``share`` (any shape) is the share that the second pass takes of what the first has left. The spectrum of the
    envelope of a mode falls exponentially from the order, as the transform of 1 / (1 + i t / τ) does, so that one share
    belongs to one width of it. For a spectrum much wider than the band of the filter the share tends to a bound, and
    the loss to everything. ``widest`` (shape of ``share``) is the largest width, over which the spectrum falls by e, in
    half bandwidths.
    """
    widths, shares, times = _taken_table()
    most = np.interp(widest, widths, shares)
    return np.asarray(np.interp(np.minimum(share, most), shares, times))


@functools.cache
def _taken_table() -> tuple[Floats, Floats, Floats]:
    """Widths, rising, shares that a second filter takes, and what the first has taken of the peak over that."""
    width = np.geomspace(0.1, 30.0, 61)
    x = np.linspace(0.0, 600.0, 60001)
    gain = 1.0 / (1.0 + HALF_POWER * x ** (2 * POLES))
    spectrum = np.exp(-x / width[:, None])
    once, twice = spectrum @ gain, spectrum @ gain**2
    share = 1.0 - twice / once
    return width, share, (spectrum.sum(axis=1) / once - 1.0) / share


@functools.cache
def _response_table() -> tuple[Floats, Floats]:
    """Lags in reciprocal bandwidths, and the response there."""
    x = np.linspace(0.0, 40.0, 8001)
    gain = 1.0 / (1.0 + HALF_POWER * x ** (2 * POLES))
    gain[0] *= 0.5
    grid = np.linspace(0.0, FARTHEST_LAG, 1025)
    return grid, np.asarray(np.cos(np.pi * np.outer(grid, x)) @ gain) * float(x[1])


def local_level(sums: Complexes, weight: Floats, others: Floats, *, sums_per_bandwidth: float) -> tuple[Floats, Floats]:
    """Variance of the white noise that would be as strong as the residual beside one order, by frame.

    Parameters
    ----------
    sums : (channels, places), sums of the residual turned back by the phase of the order
    weight : (places,), mean square of ``sums`` over the variance
    others : (other orders, places), their distance from this order, cycles per place
    sums_per_bandwidth : number of places in the time 1 / bandwidth

    Returns
    -------
    The middle of each frame (frames,), in places, and the variance (channels, frames), enlarged by Student's
    distribution for so few bins.
    """
    known = weight > 1e-3 * weight.max()
    turned = np.where(known, sums / np.sqrt(np.where(known, weight, 1.0)), 0.0)
    length = min(sums.shape[1], max(16, round(FRAME_BANDWIDTHS * sums_per_bandwidth)))
    starts = np.arange(0, sums.shape[1] - length + 1, max(1, length // 2))
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    held = sliding_window_view(known * 1.0, length)[starts] @ window**2
    bins = _flanks(length, sums_per_bandwidth)
    spectrum = np.fft.fft(sliding_window_view(turned, length, axis=1)[:, starts] * window, axis=2)[:, :, bins]
    left = _left_by_filters(bins / length, others, starts, length, sums_per_bandwidth)
    # power of white noise in the sums at each offset [cycles per place]
    lags = np.arange(1, len(SPLINE_CORRELATION))
    white = 1.0 + 2.0 * np.cos(2.0 * np.pi * np.outer(bins / length, lags)) @ SPLINE_CORRELATION[1:]
    power = np.abs(spectrum) ** 2 / (white * left)
    free = left >= np.minimum(LEAST_LEFT, np.sort(left, axis=1)[:, -min(FEWEST_BINS, len(bins)), None])
    usable = held > 0.5 * held.max()
    level = _level(power[:, usable], free[usable]) / held[usable]
    return starts[usable] + 0.5 * (length - 1), level


def _flanks(length: int, sums_per_bandwidth: float) -> Ints:
    """Bins of a transform of ``length`` that are beside the order, those below it negative."""
    first = max(LEAST_BINS[0], math.ceil(FLANK[0] * length / sums_per_bandwidth))
    last = max(first + LEAST_BINS[1], int(FLANK[1] * length / sums_per_bandwidth))
    last = max(LEAST_BINS[0], min(last, int(WIDEST * length)))
    above = np.arange(min(first, last), last + 1)
    return np.concatenate([-above, above])


def _left_by_filters(offset: Floats, others: Floats, starts: Ints, length: int, sums_per_bandwidth: float) -> Floats:
    """Share (frames, bins) of the noise's power at each offset that the filters of all orders leave in the residual.

    A filter takes s / (1 + s) of what stands alone before it, s = 1 / (g x^(2n)); several take it together, and leave
    1 / (1 + sum of s). That is so at the begin, the middle and the end of a frame, and in the mean of these.
    """
    found = np.zeros((len(starts), len(offset)))
    for at in (0, length // 2, length - 1):
        apart = offset - np.concatenate([np.zeros((1, len(starts))), others[:, starts + at]])[..., None]
        raised = HALF_POWER * (2.0 * np.abs(apart) * sums_per_bandwidth) ** (2 * POLES)
        found += np.square(1.0 / (1.0 + np.sum(1.0 / np.maximum(raised, 1e-12), axis=0))) / 3.0
    return found


def _level(power: Floats, free: Bools) -> Floats:
    """Mean power (channels, frames) of the free bins, from the lower ones of each side: noise may slope."""
    total = np.zeros(power.shape[:2])
    for side in np.split(np.arange(power.shape[2]), 2):
        ordered = np.sort(np.where(free[:, side], power[:, :, side], np.inf), axis=2)
        count = free[:, side].sum(axis=1)
        kept = np.maximum(1, np.floor(LOWER * count)).astype(int)
        lower = np.where(np.arange(len(side)) < np.where(count > 0, kept, 0)[:, None], ordered, 0.0)
        total += lower.sum(axis=2) / kept * _expected(kept, count) * count
    count = free.sum(axis=1)
    return np.asarray(total / count * student_factor(2.0 * INDEPENDENT * count) ** 2)


def student_factor(dof: Floats) -> Floats:
    """Quantile of Student's t over that of the normal distribution at 95 %, of the shape of ``dof``.

    ``dof`` (any shape) are degrees of freedom, above 0; it is the approximation 1 + 1.21 / dof.
    """
    return np.asarray(1.0 + 1.21 / dof)


def _expected(kept: Ints, count: Ints) -> Floats:
    """Mean of exponential powers over the mean of the ``kept`` lowest of ``count`` of them (Rényi 1953)."""
    from scipy.special import digamma

    left = np.maximum(count - kept, 0)
    return np.asarray(1.0 / (1.0 - left / kept * (digamma(np.maximum(count, 1) + 1) - digamma(left + 1))))


def closest(phase_rev: Floats, bandwidth_hz: Floats, *, rate_hz: float, names: Sequence[str]) -> tuple[str, float]:
    """Name of the two components that are closest for their bandwidth, and their median distance in Hz.

    A component is also compared with its own and the others' images at minus the frequency, and at the sample rate.

    Parameters
    ----------
    phase_rev : (orders, samples), rev, phase of each component
    bandwidth_hz : (orders, points), Hz
    rate_hz : samples per second
    names : (orders,), names of the components
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

    The line of an order is Re(amplitude · exp(2πi phase_rev)); the standard error is that of the real and of the
    imaginary part, thus of the amplitude too (of the phase in rad: divided by the amplitude). The data are fitted in
    real form, a cos + b sin, so that the image at minus the frequency does not leak, and a constant is fitted with the
    orders.

    Parameters
    ----------
    signals : (channels, samples)
    phase_rev : (orders, samples), finite, revolutions of each component: order times crank angle, of any shaft
    place : (places,), samples at which amplitudes are wanted
    usable : (channels, samples), samples that count; elsewhere envelopes continue as smoothly as possible
    rate_hz : samples per second
    bandwidth_hz : (orders, points), Hz, above 0, between half-power points; two points or more, even across the record
        from its beginning to its end. Narrower gives less noise and better separation, wider follows faster changes
    names : (orders,), names of the orders in errors
    knots_per_bandwidth : knots in a reciprocal bandwidth, between which envelopes are quintic: 16, exact to 1e-9 inside
        the band, or 8, exact to 1e-5; content further from the order than half so many bandwidths is rejected

    Raises RequestError where bandwidths differ too much or orders cannot be told apart within bandwidth and length.
    Source: Vold and Leuridan 1993; Tuma 2005; the restriction to splines as in Hutchinson and de Hoog 1985.
    """
    if float((bandwidth_hz.max(axis=0) / bandwidth_hz.min(axis=0)).max()) > WIDEST_RATIO:
        problem = "the bandwidths of orders tracked jointly differ too much"
        found = f"{bandwidth_hz.min():g} and {bandwidth_hz.max():g} Hz"
        allowed, remedy = f"up to 1 : {WIDEST_RATIO:g}", "track the narrow and the wide ones apart"
        raise RequestError(problem, found=found, allowed=allowed, remedy=remedy)
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
            found = f"{distance_hz:.4g} Hz apart, bandwidth {bandwidth_hz.max():g} Hz, {n_samples / rate_hz:g} s"
            found = f"{found}; noise power times {magnification:.2g}"
            allowed = f"a noise power up to {MOST_MAGNIFICATION:g} times that of each order alone"
            below = f"ask for a bandwidth below {max(distance_hz, 1e-300):.2g} Hz"
            remedy = f"{below}, take a longer recording, or fewer orders"
            raise RequestError(f"{pair} cannot be told apart", found=found, allowed=allowed, remedy=remedy)
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


def place_knots(spacing: Floats, n_samples: int) -> Ints:
    """First samples (intervals + 1,) of intervals whose length follows ``spacing`` [samples] (points,), and the end.

    The points are even across the ``n_samples`` of the record. Knots stand half a sample before these.
    """
    rate = 1.0 / spacing
    count = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])
    total = float(count[-1]) * n_samples / (len(rate) - 1)
    intervals = min(max(round(total), FEWEST_INTERVALS), n_samples)
    place = np.interp(np.arange(intervals + 1) / intervals, count / count[-1], np.linspace(0.0, n_samples, len(count)))
    return np.unique(np.round(place).astype(np.int64))


def middles(starts: Ints) -> Floats:
    """Middle [samples] (intervals,) of each interval between ``starts`` (intervals + 1,) of ``place_knots``."""
    return np.asarray(0.5 * (starts[1:] + starts[:-1] - 1.0))


def _knots(starts: Ints, degree: int) -> Floats:
    """Knots [samples] with the ends repeated, so that the first and last spline of ``degree`` are one at the ends."""
    return np.pad(starts - 0.5, degree, mode="edge")


def splines_at(starts: Ints, place: Floats | Ints, *, degree: int = DEGREE, derivative: int = 0) -> Floats:
    """Values (places, degree + 1) of the splines that are not zero at each ``place`` (places,) [samples].

    ``starts`` as of ``place_knots``, ``derivative`` of the splines, per sample.
    """
    from scipy.interpolate import BSpline  # with much that maps alone need not wait for

    # neighbours share no column: each of these is one spline at any place
    column = np.arange(len(starts) + degree - 1) % (degree + 1)
    values = BSpline(_knots(starts, degree), np.eye(degree + 1)[column], degree)(place, derivative)
    return np.take_along_axis(values, column[_near(starts, place, degree)], axis=1)


def _near(starts: Ints, place: Floats | Ints, degree: int = DEGREE) -> Ints:
    """Numbers (places, degree + 1) of the splines that are not zero at each ``place`` (places,) [samples]."""
    return np.searchsorted(starts - 0.5, place, side="right")[:, None] - 1 + np.arange(degree + 1)


def _pieces(starts: Ints) -> Floats:
    """Powers of u in (-1, 1) (intervals, splines, powers) of the splines in each interval of ``starts``."""
    node = np.cos(np.pi / SPLINES * (np.arange(SPLINES) + 0.5))
    place = middles(starts)[:, None] + 0.5 * np.diff(starts)[:, None] * node
    values = splines_at(starts, place.ravel()).reshape(-1, SPLINES, SPLINES)
    return np.ascontiguousarray(np.linalg.solve(np.vander(node, increasing=True), values).swapaxes(1, 2))


def roughness(starts: Ints, degree: int, derivative: int) -> Floats:
    """Quadratic forms (intervals, splines, splines) of the structural equation: of a ``derivative`` of the splines.

    ``starts`` as of ``place_knots``; splines of ``degree``. The sum of the squared difference becomes the integral of
    the squared derivative, less POLES/12 times that of the next one (what makes a difference over one sample smaller
    than the derivative), over all places where the difference fits into the record. In the first and last interval,
    which it does not fill, the integral could become negative and is left as it is.
    """
    intervals, nodes = np.arange(len(starts) - 1), DEGREE - POLES + 1
    low, high = starts[:-1] - 0.5, starts[1:] - 0.5
    low[0], high[-1] = min(low[0] + 0.5 * POLES, high[0]), max(high[-1] - 0.5 * POLES, low[-1])
    node, share = np.polynomial.legendre.leggauss(nodes)
    place = 0.5 * ((low + high)[:, None] + (high - low)[:, None] * node)
    part = 0.5 * (high - low)[:, None] * share
    inner = (intervals > 0) & (intervals < intervals[-1])
    form = np.zeros((len(intervals), degree + 1, degree + 1))
    for more, factor in ((0, part), (1, part * inner[:, None] * (-POLES / 12.0))):
        values = splines_at(starts, place.ravel(), degree=degree, derivative=derivative + more)
        values = values.reshape(len(intervals), nodes, -1)
        form += np.einsum("in,ina,inb->iab", factor, values, values)
    return form


class EnvelopeSystem:
    """Vold-Kalman equations of one record; an unknown is number (spline · rows + row), rows cosines and sines."""

    def __init__(self, signals: Floats, phase_rev: Floats, usable: Bools, starts: Ints, weight: Floats) -> None:
        """The equations of ``signals`` (channels, samples), finite, where they are ``usable`` (samples,).

        ``phase_rev`` (orders, samples), ``starts`` as of ``place_knots``; ``weight`` (intervals, orders) of the
        structural equation. The solution counts all channels and, as the last one, a signal of ones.
        """
        turned = 2.0 * np.pi * (phase_rev - np.floor(phase_rev))
        waves = np.concatenate([np.cos(turned), np.sin(turned)]) * usable
        known = np.vstack([signals, np.ones(len(usable))]) * usable
        self.starts, self.rows, self.weight = starts, len(waves), np.tile(weight, 2)
        self.totals = known.sum(axis=1)
        # lower band by rows, the diagonal last: its transpose is LAPACK's upper band
        self.data = np.zeros(((len(starts) - 1 + DEGREE) * self.rows, SPLINES * self.rows))
        self.wanted = np.zeros((len(known), len(self.data)))
        normal_equations(known, waves, _pieces(starts), starts, self.data, self.wanted)

    def _pairs(self, band: Floats) -> Iterator[tuple[int, int, Floats]]:
        """Splines a and b <= a of an interval, and the entries (intervals, rows) of ``band`` for these in each."""
        blocks, intervals = band.reshape(-1, self.rows, band.shape[1]), len(self.weight)
        for a, b in zip(*np.tril_indices(SPLINES), strict=True):
            yield int(a), int(b), blocks[a : a + intervals, :, -1 - (a - b) * self.rows]

    def solve(self) -> tuple[Floats, Floats, Floats]:
        """Coefficients (channels, unknowns), constant part (channels,) and variance (orders, intervals) of envelopes.

        The variance is that in the middle of intervals, of white noise of variance one. Raises LinAlgError where orders
        cannot be told apart to working precision.
        """
        from scipy.linalg import cho_solve_banded, cholesky_banded  # with much that maps alone need not wait for

        rough = np.zeros_like(self.data)
        stiffness = roughness(self.starts, DEGREE, POLES)
        for a, b, entries in self._pairs(rough):
            entries += stiffness[:, a, b, None] * self.weight
        factor, heavier = (cholesky_banded((self.data + k * rough).T, check_finite=False) for k in (1.0, 2.0))
        forms = roughness(self.starts, DEGREE - POLES, 0)
        values = np.zeros_like(self.wanted)
        for _ in range(PASSES):
            left = self.wanted - self.applied(values) - self._structure(values, forms)
            values += cho_solve_banded((factor, False), left.T, check_finite=False).T
        # constant part of each channel, jointly with the orders
        offset, n_usable = np.zeros(len(values) - 1), self.totals[-1]
        left = n_usable - float(values[-1] @ self.wanted[-1])
        if left > LEAST_CONSTANT * n_usable:
            offset = (self.totals[:-1] - values[:-1] @ self.wanted[-1]) / left
        variance, less = self._inverse_at_middles(factor), self._inverse_at_middles(heavier)
        # of data noise: what of the inverse does not fall as the structural equation gains weight; far from ends and
        # gaps that is the noise bandwidth of the filter over that of its square root, and where orders are not seen the
        # rest of it is what envelopes may do there
        variance *= np.maximum(1.0 + np.log2(less / variance), 1.0 - 0.5 / POLES)
        variance = variance.reshape(len(variance), 2, -1).mean(axis=1).T
        return values[:-1] - values[-1] * offset[:, None], offset, variance

    def applied(self, values: Floats) -> Floats:
        """The data's weight times ``values`` (channels, unknowns)."""
        from scipy.linalg.blas import dsbmv

        return np.array([dsbmv(self.data.shape[1] - 1, 1.0, self.data.T, row) for row in values])

    def residual_sums(self, values: Floats, offset: Floats) -> tuple[Complexes, Floats]:
        """What the residual holds about each order, by spline: sums (channels, orders, splines) and their weights.

        ``values`` and ``offset`` as of ``solve``. The sums are of residual · spline · exp(-2πi phase); for white noise
        of variance s² their mean square is s² times the weight (orders, splines).
        """
        left = self.wanted[:-1] - self.applied(values) - offset[:, None] * self.wanted[-1]
        cosine, sine = np.split(left.reshape(len(left), -1, self.rows).transpose(0, 2, 1), 2, axis=1)
        weight = self.data[:, -1].reshape(-1, 2, self.rows // 2).sum(axis=1)
        return cosine - 1j * sine, weight.T

    def _structure(self, values: Floats, forms: Floats) -> Floats:
        """The structural equation applied to ``values`` (channels, unknowns).

        ``forms`` act on the coefficients of derivatives, which come by differences: those of a constant vanish exactly.
        """
        knots, intervals = _knots(self.starts, DEGREE)[:, None], len(self.weight)
        slopes = [(DEGREE - k) / (knots[SPLINES : len(knots) - k - 1] - knots[k + 1 : -SPLINES]) for k in range(POLES)]
        steep = values.reshape(len(values), -1, self.rows)
        for slope in slopes:
            steep = np.diff(steep, axis=1) * slope
        rough = np.zeros_like(steep)
        for a, b in np.ndindex(forms.shape[1:]):
            rough[:, a : a + intervals] += forms[:, a, b, None] * self.weight * steep[:, b : b + intervals]
        for slope in slopes[::-1]:
            rough = -np.diff(rough * slope, axis=1, prepend=0.0, append=0.0)
        return rough.reshape(values.shape)

    def _inverse_at_middles(self, factor: Floats) -> Floats:
        """Inverse (intervals, rows) for the envelopes in the middle of each interval, from LAPACK's ``factor``."""
        middle = splines_at(self.starts, middles(self.starts))
        inverse = np.zeros_like(self.weight)
        for a, b, entries in self._pairs(inverse_band(factor.T)):
            inverse += (1.0 + (a != b)) * (middle[:, a] * middle[:, b])[:, None] * entries
        return inverse

    def amplitude_at(self, values: Floats, place: Ints) -> Complexes:
        """Complex amplitudes (channels, orders, places) of ``values`` (channels, unknowns) at the samples ``place``."""
        of_places = values.reshape(len(values), -1, self.rows)[:, _near(self.starts, place)]
        cosine, sine = np.split(np.einsum("pa,cpar->crp", splines_at(self.starts, place), of_places), 2, axis=1)
        return np.asarray(cosine - 1j * sine)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def normal_equations(signals, waves, pieces, starts, band, sides):  # type: ignore[no-untyped-def]
    """Fill ``band`` (unknowns, width + 1) and ``sides`` (channels, unknowns), of unknown (spline · rows + row).

    ``signals`` (channels, samples) are met by ``waves`` (rows, samples) times splines. In the intervals from
    ``starts`` (intervals + 1,) on these are ``pieces`` (intervals, splines, powers) of u in (-1, 1); each interval
    begins one spline later.
    """
    rows, size = waves.shape[0], band.shape[1]
    for i in range(starts.shape[0] - 1):
        first, last, at = starts[i], starts[i + 1], i * rows
        powers, met = np.ones((pieces.shape[2], last - first)), np.empty((size, last - first))
        for q in range(1, len(powers)):
            for j in range(last - first):
                powers[q, j] = powers[q - 1, j] * ((2.0 * j + 1.0) / (last - first) - 1.0)
        splines = pieces[i] @ powers
        for m in range(size):
            met[m] = splines[m // rows] * waves[m % rows, first:last]
        product = met @ met.T
        for m in range(size):
            band[at + m, size - 1 - m :] += product[m, : m + 1]
        sides[:, at : at + size] += np.ascontiguousarray(signals[:, first:last]) @ met.T


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def inverse_band(factor):  # type: ignore[no-untyped-def]
    """Entries of the inverse within the band, stored as its Cholesky ``factor`` (n, width + 1) is.

    Source: Takahashi, Fagan and Chin 1973; as in Hutchinson and de Hoog 1985 for smoothing splines.
    """
    n, width = factor.shape[0], factor.shape[1] - 1
    inverse = np.zeros_like(factor)
    below, entry = np.empty(width), np.empty(width)
    for i in range(n - 1, -1, -1):
        count = min(width, n - 1 - i)
        for k in range(count):
            below[k] = factor[i + 1 + k, width - 1 - k] / factor[i, width]
            entry[k] = 0.0
        for k in range(count):
            row, mine, total = inverse[i + 1 + k, width - k :], below[k], 0.0
            for m in range(k):
                total += below[m] * row[m]
                entry[m] -= mine * row[m]
            entry[k] -= total + mine * row[k]
        total = 1.0 / (factor[i, width] * factor[i, width])
        for k in range(count):
            inverse[i + 1 + k, width - 1 - k] = entry[k]
            total -= below[k] * entry[k]
        inverse[i, width] = total
    return inverse
