"""Bandwidth of a Vold-Kalman filter: the weight of its structural equation, the noise it passes, the place of knots."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from crankorder.quantities import Bools, Complexes, Floats, Ints

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
    """What the filter gives ``lag_bandwidths`` (any shape) reciprocal bandwidths after an impulse, far below the rate.

    The cosine transform of the gain; its integral over the lag is one.
    """
    grid, table = _response_table()
    return np.asarray(np.interp(np.abs(lag_bandwidths), grid, table, right=0.0))


def taken_in_truth(share: Floats, widest: Floats) -> Floats:
    """How many times what a second filter takes of the peak of a mode that a sweep passes the first one has taken.

    ``share`` (any shape): what the second takes of what the first has left. The spectrum of the envelope that a mode
    leaves falls exponentially from the order, as the transform of 1 / (1 + i t / τ) does, so that one share belongs to
    one width of it; of a spectrum much wider than the band of the filter the share tends to a bound, and what was taken
    to everything.
    ``widest`` (as ``share``) is the largest width, over which the spectrum falls by e, in half bandwidths.
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

    ``sums`` (channels, places) of the residual turned back by the order's phase, whose mean square is ``weight``
    (places,) times that variance; ``others`` (other orders, places) their distance from this order in cycles per
    place; ``sums_per_bandwidth`` of them in the time 1/bandwidth. Returns the middle of each frame in
    places (frames,) and the variance (channels, frames), enlarged as Student's distribution asks for so few bins.
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
    """What Student's t asks for at 95 % over a normal distribution, by degrees of freedom ``dof`` (any shape)."""
    return np.asarray(1.0 + 1.21 / dof)


def _expected(kept: Ints, count: Ints) -> Floats:
    """Mean of exponential powers over the mean of the ``kept`` lowest of ``count`` of them (Rényi 1953)."""
    from scipy.special import digamma

    left = np.maximum(count - kept, 0)
    return np.asarray(1.0 / (1.0 - left / kept * (digamma(np.maximum(count, 1) + 1) - digamma(left + 1))))
