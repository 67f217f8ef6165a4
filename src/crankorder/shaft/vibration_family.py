"""Which fundamental explains the lines that a tracked angle shows: its speed, or a simple multiple or part of it.

All fundamentals are judged by the same order spectra, along the same angle and with frames of the same length, where
frames of the search for the speed are longer for lower speeds and so show more lines of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from crankorder.fft.decimation import decimate, decimation_factor
from crankorder.fft.resampling import PASS_BAND, margin, values_at
from crankorder.fft.windows import hann
from crankorder.shaft.angle import time_at
from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.vibration_angle import TrackedAngle
from crankorder.shaft.vibration_comb import ODDS, best_combs

# Revolutions of a frame in which harmonic families are compared, while the speed changes and where it is steady within
# this ratio; the most frames, and the highest order looked at.
FAMILY_REVS, STEADY, FAMILY_FRAMES, FAMILY_ORDER = (24.0, 48.0), 1.1, 64, 16.0
# Power over noise that one frame can add there, that a fixed tone which an order passes makes it no line; and to the
# shape of a line.
FAMILY_CAP, FAMILY_SHAPE = 6.0, 1000.0
# Log odds of single frames count as so many of them, beside those of the mean of all; then a third, for all see
# the same lines.
FRAMES_WORTH = 3
# A line of the mean spectrum is so many times the power beside it: natural frequencies are broader, but change of speed
# spreads them out of it anyhow.
PROMINENCE = (1.0, 2.0)


@dataclass(frozen=True)
class FamilyEvidence:
    """Log odds (ratios,) of each fundamental against none, and of single frames (frames, ratios) at ``time_s``."""

    log_odds: FloatArray
    time_s: FloatArray
    of_frames: FloatArray


def family_evidence(
    signals: FloatArray,
    rate_hz: float,
    tracked: TrackedAngle,
    *,
    ratio: FloatArray,
    order: FloatArray,
    weight: FloatArray,
) -> FamilyEvidence:
    """Log odds of the fundamentals at ``ratio`` times the tracked speed, all from the same order spectra.

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    tracked : the angle that is sure but for its ratio
    ratio : (ratios,)
    order : (orders,), orders of each fundamental
    weight : (orders,), 0…1, probability that the order shows
    """
    from scipy.special import gammaincc

    slow, fast = np.quantile(tracked.speed_hz, [0.1, 0.9])
    steady = bool(fast < STEADY * slow)
    revs = min(FAMILY_REVS[steady], 0.5 * float(tracked.angle_rev[-1]))
    time_s, times = _order_power(signals, rate_hz, tracked, revs)
    seen = np.count_nonzero(np.isfinite(times[0]), axis=0)
    place = ratio[:, None] * order * 2.0 * revs
    of_frames = np.full((times.shape[1], ratio.size), -np.inf)
    for frame, best in zip(np.moveaxis(times, 1, 0), of_frames, strict=True):
        unseen = np.isnan(frame[0]).astype(np.float64)
        power = np.nan_to_num(frame)[:, None, :]
        best_combs(power, np.ones_like(power), 3, unseen, place, weight, ODDS, best[None])
    # as unlikely in a mean of so many frames as this power in one
    over = np.nansum(np.minimum(times, FAMILY_CAP), axis=1)
    single = -np.log(np.maximum(gammaincc(np.maximum(seen, 1.0), over), 1e-300))
    shape = np.nansum(np.minimum(times, FAMILY_SHAPE), axis=1)
    beside = np.maximum(np.roll(shape, 3, axis=1), np.roll(shape, -3, axis=1))
    peaks = np.where(PROMINENCE[steady] * beside > shape, 0.0, single)[:, None, :]
    of_mean = np.full((1, ratio.size), -np.inf)
    best_combs(peaks, np.ones_like(peaks), seen.size, (seen == 0).astype(np.float64), place, weight, ODDS, of_mean)
    total = (1.0 / 3.0) * (of_mean[0] + min(FRAMES_WORTH, times.shape[1]) * np.mean(of_frames, axis=0))
    return FamilyEvidence(total, time_s, of_frames)


def _order_power(
    signals: FloatArray, rate_hz: float, tracked: TrackedAngle, revs: float
) -> tuple[FloatArray, FloatArray]:
    """Times [s] of frames of ``revs`` revolutions, and their power over the noise beside it (channels, frames, bins).

    A bin is half of a line's resolution; the power is NaN outside the band.
    """
    total = float(tracked.angle_rev[-1])
    count = int(min(FAMILY_FRAMES, max(1, (total - revs) / (0.5 * revs))))
    centre = np.linspace(0.5 * revs, total - 0.5 * revs, count + 2)[1:-1] if count > 1 else np.array([0.5 * total])
    band = min(1.5 * FAMILY_ORDER * float(tracked.speed_hz.max()), PASS_BAND * rate_hz)
    reduced, rate, start_s = decimate(signals, rate_hz=rate_hz, band_hz=band, factor=decimation_factor(rate_hz, band))
    padded = np.pad(reduced, ((0, 0), (margin() + 2, margin() + 2)))
    at = (tracked.time_s, tracked.angle_rev, 60.0 * tracked.speed_hz)
    bins = int(FAMILY_ORDER * 2.0 * revs)
    times = np.empty((signals.shape[0], count, bins))
    for i, (middle, speed) in enumerate(
        zip(centre, np.interp(centre, tracked.angle_rev, tracked.speed_hz), strict=True)
    ):
        n = max(2 * bins, math.ceil(1.3 * rate / speed * revs))
        place = (time_at(middle + revs * (np.arange(n) / n - 0.5), *at) - start_s) * rate
        place = np.clip(place, 0.0, reduced.shape[1] - 1.0)
        framed = values_at(padded, place + margin() + 2) * hann(n).values
        power = np.abs(np.fft.rfft(framed, n=2 * n, axis=1)[:, :bins]) ** 2
        inside = np.arange(bins) / (2.0 * revs) * speed <= min(band, PASS_BAND * rate)
        times[:, i] = np.where(inside, power / _median_beside(power, round(2.0 * revs)), np.nan)
    return time_at(centre, *at), times


def _median_beside(power: FloatArray, reach: int) -> FloatArray:
    """Median of ``power`` (channels, bins) within ``reach`` bins of each, as a mean of noise."""
    reach = min(reach, power.shape[1] - 1)
    padded = np.pad(power, ((0, 0), (reach, reach)), mode="reflect")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=1), axis=-1) / math.log(2.0)
    floor: FloatArray = np.maximum(median, 1e-12 * power.max() + 1e-300)
    return floor
