"""Local noise beside an order, from what a Vold-Kalman filter leaves."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from crankorder.orders.vold_kalman.bandwidth import HALF_POWER

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
INDEPENDENT = 0.55
"""Degrees of freedom, as a share of twice the bins: neighbours share a Hann window, and a quarter is left out."""

_Array = NDArray[np.float64]


def local_level(
    sums: NDArray[np.complex128],
    weight: _Array,
    others: _Array,
    *,
    sums_per_bandwidth: float,
    poles: int,
    correlation: _Array,
) -> tuple[_Array, _Array]:
    """Variance of the white noise that would be as strong as the residual beside one order, by frame.

    ``sums`` (channels, places) of the residual turned back by the order's phase, whose mean square is ``weight``
    (places,) times that variance; ``others`` (other orders, places) their distance from this order in cycles per
    place; ``sums_per_bandwidth`` of them in the time 1/bandwidth; ``poles`` of the filter, whose gain is missing from
    the residual; ``correlation`` (lags,) of neighbouring sums in white noise, one at lag 0. Returns the middle of each
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
    power = np.abs(spectrum) ** 2 / _shape(bins / length, sums_per_bandwidth, poles, correlation)
    free = _free_of_others(bins / length, others, starts, length, 1.0 / sums_per_bandwidth)
    usable = held > 0.5 * held.max()
    level = _level(power[:, usable], free[usable]) / held[usable]
    return starts[usable] + 0.5 * (length - 1), level


def _flanks(length: int, sums_per_bandwidth: float) -> NDArray[np.int64]:
    """Bins of a transform of ``length`` that are beside the order, those below it negative."""
    first = max(LEAST_BINS[0], math.ceil(FLANK[0] * length / sums_per_bandwidth))
    last = max(first + LEAST_BINS[1], int(FLANK[1] * length / sums_per_bandwidth))
    last = max(LEAST_BINS[0], min(last, int(WIDEST * length)))
    one = np.arange(min(first, last), last + 1)
    return np.concatenate([-one, one])


def _shape(offset: _Array, sums_per_bandwidth: float, poles: int, correlation: _Array) -> _Array:
    """Power of white noise in the sums at each offset [cycles per place], where the filter has taken its share."""
    gain = 1.0 / (1.0 + HALF_POWER * (2.0 * offset * sums_per_bandwidth) ** (2 * poles))
    lags = np.arange(1, len(correlation))
    spread = correlation[0] + 2.0 * np.cos(2.0 * np.pi * np.outer(offset, lags)) @ correlation[1:]
    return np.asarray(spread * (1.0 - gain) ** 2)


def _free_of_others(
    offset: _Array, others: _Array, starts: NDArray[np.int64], length: int, bandwidth: float
) -> NDArray[np.bool_]:
    """Which bins (frames, bins) hold no other tracked order, whose filter has taken the noise there."""
    free = np.ones((len(starts), len(offset)), dtype=bool)
    for other in others:
        framed = sliding_window_view(other, length)[starts]
        low, high = framed.min(axis=1)[:, None] - bandwidth, framed.max(axis=1)[:, None] + bandwidth
        free &= (offset < low) | (offset > high)
    free[free.sum(axis=1) < FEWEST_BINS] = True
    return free


def _level(power: _Array, free: NDArray[np.bool_]) -> _Array:
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


def student_factor(dof: NDArray[np.float64]) -> NDArray[np.float64]:
    """What Student's t asks for at 95 % over a normal distribution, by degrees of freedom ``dof`` (any shape)."""
    return np.asarray(1.0 + 1.21 / dof)


def level_dof(bandwidths: float) -> float:
    """Degrees of freedom of the level of one frame, in a record ``bandwidths`` reciprocal bandwidths long."""
    flank = min(FRAME_BANDWIDTHS, bandwidths)
    return 4.0 * INDEPENDENT * max(1.0 + LEAST_BINS[1], (FLANK[1] - FLANK[0]) * flank)


def _expected(kept: NDArray[np.int64], count: NDArray[np.int64]) -> _Array:
    """Mean of exponential powers over the mean of the ``kept`` lowest of ``count`` of them."""
    share = np.minimum(kept / np.maximum(count, 1), 1.0 - 1e-9)
    left = 1.0 - share
    return np.asarray(share / (1.0 - left * (1.0 - np.log(left))))
