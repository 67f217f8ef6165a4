"""Bandwidth of a Vold-Kalman filter: the weight of its structural equation, the noise it passes, the place of knots."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from crankorder.quantities import Bools, Complexes, Floats, Ints

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

DEGREE = 5
"""Of the envelopes between knots. Those of a filter of n poles have 2n - 2 smooth derivatives."""

FEWEST_INTERVALS = 16
"""However narrow the band: the envelope may still bend in a record that is shorter than the filter's response."""

SPLINE_CORRELATION = np.array([15724248, 9738114, 2203488, 152637, 2036, 1]) / 15724248.0
"""Correlation of white noise between quintic splines that are 0 … 5 knots apart: splines of degree 11 at the knots."""


def structural_weight(bandwidth_hz: Floats, *, rate_hz: float, poles: int) -> Floats:
    """Weight r² of the squared structural equation (∇ to the power ``poles``) whose half-power bandwidth is exact.

    ``bandwidth_hz`` (any shape), from half-power point to half-power point, 0 < bandwidth < ``rate_hz``. A real line
    gives its cosine and sine envelope half a unit of data weight per sample each, thus the gain at f off the line is
    1/(1 + 2 r² (2 sin(π f/rate))^(2 poles)), and r² = (√2 - 1)/2 / (2 sin(π bandwidth/(2 rate)))^(2 poles). The sine
    of half the angle stands for the differences of cosines in the textbook's form, which cancel where r² passes 1e8.
    Source: Tuma 2005, "Setting the passband width in the Vold-Kalman order tracking filter" (his r² is twice ours,
    being for the complex form).
    """
    step = 2.0 * np.sin(0.5 * np.pi * np.asarray(bandwidth_hz) / rate_hz)
    return np.asarray(0.5 * HALF_POWER / step ** (2 * poles))


def noise_bandwidth_share(poles: int) -> float:
    """Noise bandwidth ∫|gain|² df over all offsets, as a share of the half-power bandwidth, far below the rate.

    ``poles`` is that of the filter. With gain 1/(1 + g x^(2n)), x = 1 at the half-power point, the integral is
    g^(-1/2n) · (1 - 1/2n) · (π/2n)/sin(π/2n).
    """
    power = 2.0 * poles
    shape = (1.0 - 1.0 / power) * (math.pi / power) / math.sin(math.pi / power)
    return float(HALF_POWER ** (-1.0 / power) * shape)


def impulse_response(lag_bandwidths: Floats, poles: int) -> Floats:
    """What the filter gives ``lag_bandwidths`` (any shape) reciprocal bandwidths after an impulse, far below the rate.

    The cosine transform of the gain, as of ``poles``; its integral over the lag is one.
    """
    grid, table = _response_table(poles)
    return np.asarray(np.interp(np.abs(lag_bandwidths), grid, table, right=0.0))


def taken_in_truth(share: Floats, widest: Floats, poles: int) -> Floats:
    """How many times what a second filter takes of the peak of a mode that a sweep passes the first one has taken.

    ``share`` (any shape): what the second takes of what the first has left. The spectrum of the envelope that a mode
    leaves falls exponentially from the order, as the transform of 1 / (1 + i t / τ) does, so that one share belongs to
    one width of it; of a spectrum much wider than the band of the filter of ``poles`` the share tends to a bound, and
    what was taken to everything.
    ``widest`` (as ``share``) is the largest width, over which the spectrum falls by e, in half bandwidths.
    """
    widths, shares, times = _taken_table(poles)
    most = np.interp(widest, widths, shares)
    return np.asarray(np.interp(np.minimum(share, most), shares, times))


@functools.cache
def _taken_table(poles: int) -> tuple[Floats, Floats, Floats]:
    """Widths, rising, shares that a second filter takes, and what the first has taken of the peak over that."""
    width = np.geomspace(0.1, 30.0, 61)
    x = np.linspace(0.0, 600.0, 60001)
    gain = 1.0 / (1.0 + HALF_POWER * x ** (2 * poles))
    spectrum = np.exp(-x / width[:, None])
    once, twice = spectrum @ gain, spectrum @ gain**2
    share = 1.0 - twice / once
    return width, share, (spectrum.sum(axis=1) / once - 1.0) / share


@functools.cache
def _response_table(poles: int) -> tuple[Floats, Floats]:
    """Lags in reciprocal bandwidths, and the response there."""
    x = np.linspace(0.0, 40.0, 8001)
    gain = 1.0 / (1.0 + HALF_POWER * x ** (2 * poles))
    gain[0] *= 0.5
    grid = np.linspace(0.0, FARTHEST_LAG, 1025)
    return grid, np.asarray(np.cos(np.pi * np.outer(grid, x)) @ gain) * float(x[1])


def local_level(
    sums: Complexes, weight: Floats, others: Floats, *, sums_per_bandwidth: float, poles: int
) -> tuple[Floats, Floats]:
    """Variance of the white noise that would be as strong as the residual beside one order, by frame.

    ``sums`` (channels, places) of the residual turned back by the order's phase, whose mean square is ``weight``
    (places,) times that variance; ``others`` (other orders, places) their distance from this order in cycles per
    place; ``sums_per_bandwidth`` of them in the time 1/bandwidth; ``poles`` of the filter, whose gain is missing from
    the residual. Returns the middle of each
    frame in places (frames,) and the variance (channels, frames), enlarged as Student's distribution asks for so few
    bins.
    """
    known = weight > 1e-3 * weight.max()
    turned = np.where(known, sums / np.sqrt(np.where(known, weight, 1.0)), 0.0)
    length = min(sums.shape[1], max(16, round(FRAME_BANDWIDTHS * sums_per_bandwidth)))
    starts = np.arange(0, sums.shape[1] - length + 1, max(1, length // 2))
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    held = sliding_window_view(known * 1.0, length)[starts] @ window**2
    bins = _flanks(length, sums_per_bandwidth)
    spectrum = np.fft.fft(sliding_window_view(turned, length, axis=1)[:, starts] * window, axis=2)[:, :, bins]
    left = _left_by_filters(bins / length, others, starts, length, sums_per_bandwidth, poles)
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


def _left_by_filters(
    offset: Floats, others: Floats, starts: Ints, length: int, sums_per_bandwidth: float, poles: int
) -> Floats:
    """Share (frames, bins) of the noise's power at each offset that the filters of all orders leave in the residual.

    A filter takes s / (1 + s) of what stands alone before it, s = 1 / (g x^(2n)); several take it together, and leave
    1 / (1 + sum of s). That is so at the begin, the middle and the end of a frame, and in the mean of these.
    """
    found = np.zeros((len(starts), len(offset)))
    for at in (0, length // 2, length - 1):
        apart = offset - np.concatenate([np.zeros((1, len(starts))), others[:, starts + at]])[..., None]
        raised = HALF_POWER * (2.0 * np.abs(apart) * sums_per_bandwidth) ** (2 * poles)
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
    """What Student's t asks for at 95 % over a normal distribution, by degrees of freedom ``dof`` (any shape)."""
    return np.asarray(1.0 + 1.21 / dof)


def _expected(kept: Ints, count: Ints) -> Floats:
    """Mean of exponential powers over the mean of the ``kept`` lowest of ``count`` of them (Rényi 1953)."""
    from scipy.special import digamma

    left = np.maximum(count - kept, 0)
    return np.asarray(1.0 / (1.0 - left / kept * (digamma(np.maximum(count, 1) + 1) - digamma(left + 1))))


@dataclass(frozen=True)
class Knots:
    """Knots half a sample before the samples ``starts`` (intervals + 1,), the last one after the end."""

    starts: Ints

    @property
    def middles(self) -> Floats:
        """Middle of each interval [samples]."""
        return np.asarray(0.5 * (self.starts[1:] + self.starts[:-1] - 1.0), dtype=np.float64)

    @property
    def intervals(self) -> int:
        """Number of intervals between knots."""
        return len(self.starts) - 1

    @cached_property
    def extended(self) -> Floats:
        """Knots [samples] with the ends repeated, so that the first and last spline are one at the ends."""
        inner = self.starts - 0.5
        return np.concatenate([np.full(DEGREE, inner[0]), inner, np.full(DEGREE, inner[-1])])

    @cached_property
    def runs(self) -> Ints:
        """First interval of each run of intervals (runs,) between whose neighbours nothing changes."""
        lengths = np.diff(self.starts)
        changed = np.flatnonzero(np.diff(lengths)) + 1
        changed = np.concatenate([[0], changed, [self.intervals]])
        return np.unique(np.clip(changed[:, None] + np.arange(-DEGREE, DEGREE + 1), 0, self.intervals - 1))


def place_knots(spacing: Floats, n_samples: int, *, fewest: int = FEWEST_INTERVALS) -> Knots:
    """Knots across ``n_samples`` whose distance follows ``spacing`` [samples] (points,), even across the record.

    At least ``fewest`` intervals, none shorter than a sample. Where the spacing does not change, all intervals hold
    equally many samples, or the last ones one more.
    """
    spacing = np.asarray(spacing, dtype=np.float64)
    if np.all(spacing == spacing[0]):
        step = max(1, min(int(spacing[0]), n_samples // fewest))
        intervals = n_samples // step
        lengths = np.full(intervals + 1, n_samples // intervals)
        lengths[0] = 0
        lengths[intervals + 1 - n_samples % intervals :] += 1
        return Knots(np.cumsum(lengths))
    rate = 1.0 / spacing
    count = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])
    total = float(count[-1]) * n_samples / (len(rate) - 1)
    intervals = min(max(round(total), fewest), n_samples)
    place = np.interp(np.arange(intervals + 1) / intervals, count / count[-1], np.linspace(0.0, n_samples, len(count)))
    return Knots(np.unique(np.round(place).astype(np.int64)))


def spline_pieces(knots: Floats, at: Ints, degree: int) -> Floats:
    """Powers of u in (-1, 1) (intervals, degree + 1 splines, degree + 1 powers) of B-splines in the intervals ``at``.

    ``knots`` hold ``degree`` repeated ends before and after the intervals. Source: de Boor 1972, recursion.
    """
    left, right = knots[degree + at], knots[degree + 1 + at]
    middle, half = 0.5 * (left + right), 0.5 * (right - left)
    found = np.zeros((len(at), degree + 1, degree + 1))
    found[:, degree, 0] = 1.0
    for k in range(1, degree + 1):
        new = np.zeros_like(found)
        for place in range(degree - k, degree + 1):
            # spline number at + place of degree k rises over the first and falls over the second support
            j = at + place
            for source, zero, one in ((place, knots[j], knots[j + k]), (place + 1, knots[j + k + 1], knots[j + 1])):
                if source > degree:
                    continue
                span = np.where(one == zero, 1.0, one - zero)
                constant = np.where(one == zero, 0.0, (middle - zero) / span)
                slope = np.where(one == zero, 0.0, half / span)
                new[:, place] += constant[:, None] * found[:, source]
                new[:, place, 1:] += slope[:, None] * found[:, source, :-1]
        found = new
    return found


def difference_slopes(knots: Knots, poles: int) -> Floats:
    """Factors (poles, splines) that turn differences of coefficients on ``knots`` into those of derivatives [1/sample].

    Row k, for the step from derivative k to k + 1 of ``poles``, holds one factor less than the row before it.
    """
    found = np.zeros((poles, knots.intervals + DEGREE))
    for k in range(poles):
        inner = knots.extended[k + 1 : len(knots.extended) - k - 1]
        span = inner[DEGREE - k :] - inner[: len(inner) - DEGREE + k]
        found[k, : len(span)] = (DEGREE - k) / span
    return found


def local_differences(knots: Knots, at: Ints, poles: int) -> Floats:
    """Matrices (intervals, splines - poles, splines) that take coefficients on ``knots`` to those of a derivative.

    ``at`` are the intervals, ``poles`` the order of the derivative.
    """
    found = np.broadcast_to(np.eye(DEGREE + 1), (len(at), DEGREE + 1, DEGREE + 1))
    for k, slopes in enumerate(difference_slopes(knots, poles)):
        found = (found[:, 1:] - found[:, :-1]) * slopes[at[:, None] + np.arange(DEGREE - k)][:, :, None]
    return found


def roughness(knots: Knots, at: Ints, poles: int) -> Floats:
    """Quadratic forms (intervals, splines, splines) of the structural equation in the intervals ``at`` of ``knots``.

    They act on the coefficients of the derivative of order ``poles``. The sum of the squared difference becomes the
    integral of the squared derivative, less poles/12 times that of the next one (what makes a difference over one
    sample smaller than the derivative), over all places where the difference fits into the record. In the
    first and last interval, which it does not fill, the integral could become negative and is left as it is.
    """
    degree = DEGREE - poles
    pieces = spline_pieces(knots.extended[poles : len(knots.extended) - poles], at, degree)
    half = 0.5 * np.diff(knots.starts)[at]
    low = np.where(at == 0, np.minimum(0.5 * poles / half, 1.0) - 1.0, -1.0)
    high = np.where(at == knots.intervals - 1, 1.0 - np.minimum(0.5 * poles / half, 1.0), 1.0)
    shrink = np.where((at == 0) | (at == knots.intervals - 1), 0.0, poles / 12.0)
    slope = pieces[:, :, 1:] * np.arange(1, degree + 1) / half[:, None, None]
    found = np.zeros((len(at), degree + 1, degree + 1))
    for node, share in zip(*np.polynomial.legendre.leggauss(degree + 1), strict=True):
        u = (0.5 * (low + high) + 0.5 * (high - low) * node)[:, None] ** np.arange(degree + 1)
        part = (half * 0.5 * (high - low) * share)[:, None, None]
        value = np.einsum("isp,ip->is", pieces, u)
        steep = np.einsum("isp,ip->is", slope, u[:, :degree])
        found += part * value[:, :, None] * value[:, None, :]
        found -= part * shrink[:, None, None] * steep[:, :, None] * steep[:, None, :]
    return found
