"""Evidence of combs of orders in the vibration: of each speed at each instant, and of each fundamental along an angle.

The speeds are split into octaves, and each octave has frames of its own, a few revolutions long, from a signal that is
decimated to what its orders need. Within a frame the speed may change: time is warped for each of a few slews so that
every order of a shaft with that slew is one line (Weruaga and Kepesi 2007, the fan-chirp transform). A bin's power over
the local floor gives the odds that a line is there; the odds saturate, so that no line counts for more than another.

Simple ratios of a run of speeds are compared along its angle, in order spectra of frames of one length.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from crankorder.fft.decimation import decimate, decimation_factor
from crankorder.fft.resampling import PASS_BAND, margin, values_at
from crankorder.fft.transforms import FrameTransform, frame_starts
from crankorder.fft.windows import hann
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import AngleKnots, time_at

# Frames follow each other by this share of their length; spectra are padded so many times.
HOP_SHARE, PADDING = 0.375, 2
# Knots are so far apart, as a share of the frames of the highest octave.
KNOT_SHARE = 0.5
# A frame is not warped by more than this (slew times length): its ends would be read from far beside it.
MOST_WARP = 0.6
# A slew or a speed beside the true one moves the highest order by no more than these many bins.
SLEW_BINS, SPEED_BINS = 2.0, 0.4
# A line is a peak: it stands above the power so many bins (of unpadded spectra) beside it, where its own is 3 % of it.
PEAK_BINS = 1.5
# Bins that hold a line by chance (other shafts, fixed tones): it caps the odds of one line at its inverse.
STRAY_SHARE = 0.06
# Power over floor up to which lines of every size are as likely.
HIGHEST_LINE = 1e4
# The most knots of a recording: a longer one has them farther apart.
MOST_KNOTS = 20_000
# Warped frames that are held at once.
FRAMES_AT_ONCE = 256


class SpeedEvidence(NamedTuple):
    """``log_odds`` (knots, speeds) of a comb of orders against none, at ``time_s`` (knots,) and ``speed_hz`` (speeds,).

    The height of a line counts over the noise next to it. ``frames_per_knot`` is the number of independent frames that
    a knot is worth. The speeds [Hz] are even in the logarithm, the times in s.
    """

    time_s: Floats
    speed_hz: Floats
    log_odds: Floats
    frames_per_knot: float

    @property
    def step(self) -> float:
        """Step of the speeds in the logarithm."""
        return float(np.log(self.speed_hz[1] / self.speed_hz[0]))


def tooth_odds(
    signals: Floats,
    rate_hz: float,
    *,
    range_hz: tuple[float, float],
    order: Floats,
    weight: Floats,
    settings: ShaftSettings,
) -> SpeedEvidence:
    """SpeedEvidence (knots, speeds) for every speed of a grid on common time knots.

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    range_hz : lowest and highest speed, revolutions per second
    order : (orders,), increasing, cycles per revolution
    weight : (orders,), 0…1, probability that the order shows
    settings : ``vibration_revs`` per frame, ``vibration_slew_per_s``
    """
    low, high = range_hz
    n_octaves = max(1, math.ceil(math.log2(high / low) - 1e-9))
    ratio = (high / low) ** (1.0 / n_octaves)
    revs = settings.vibration_revs
    step = SPEED_BINS / (revs * ratio * order[-1])
    n_each = max(2, math.ceil(math.log(ratio) / step))
    speed = low * np.exp(np.arange(n_octaves * n_each + 1) * (math.log(ratio) / n_each))
    duration = signals.shape[1] / rate_hz
    hop = max(KNOT_SHARE * revs * ratio / high, duration / MOST_KNOTS)
    time_s = (np.arange(max(1, int(duration / hop))) + 0.5) * (duration / max(1, int(duration / hop)))
    log_odds = np.empty((time_s.size, speed.size), dtype=np.float32)
    for octave in range(n_octaves):
        states = slice(octave * n_each, (octave + 1) * n_each + (octave == n_octaves - 1))
        frames = _Frames(signals, rate_hz, length_s=revs / speed[states.start], top_hz=speed[states][-1] * order[-1])
        at_frames = _log_odds(frames, speed[states], order, weight, settings.vibration_slew_per_s)
        log_odds[:, states] = _between(time_s, frames.time_s, at_frames.T).T
    spacing = duration / time_s.size
    worth = min(1.0, 1.5 * spacing / (revs / math.sqrt(low * high)))
    return SpeedEvidence(time_s, speed, log_odds, worth)


def _between(time_s: Floats, frame_s: Floats, values: Floats) -> Floats:
    """``values`` (…, frames) at ``time_s``, linear between the frames' times ``frame_s``, constant beyond them."""
    if frame_s.size == 1:
        return np.repeat(values, time_s.size, axis=-1)
    k = np.clip(np.searchsorted(frame_s, time_s) - 1, 0, frame_s.size - 2)
    share = np.clip((time_s - frame_s[k]) / (frame_s[k + 1] - frame_s[k]), 0.0, 1.0)
    return np.asarray((1.0 - share) * values[..., k] + share * values[..., k + 1])


class _Frames:
    """Spectra of overlapping frames of one length, with any slew, from a signal decimated to its band."""

    def __init__(self, signals: Floats, rate_hz: float, *, length_s: float, top_hz: float) -> None:
        from scipy.fft import next_fast_len

        band = min(top_hz * (1.0 + 0.5 * MOST_WARP), PASS_BAND * rate_hz)
        reduced, self.rate_hz, start_s = decimate(
            signals, rate_hz=rate_hz, band_hz=band, factor=decimation_factor(rate_hz, band)
        )
        self.band_hz = min(band, PASS_BAND * self.rate_hz)
        self.length_s = length_s
        self.n_frame = max(16, round(length_s * self.rate_hz))
        self._margin = self.n_frame + margin() + 2
        self._padded = np.pad(reduced, ((0, 0), (self._margin, self._margin)))
        hop = max(1, round(HOP_SHARE * self.n_frame))
        self._centre = self._margin + np.arange(hop // 2, reduced.shape[1], hop, dtype=np.int64)
        self.time_s = (self._centre - self._margin) / self.rate_hz + start_s
        n_fft = int(next_fast_len(PADDING * self.n_frame, real=True))
        self._transform = FrameTransform(hann(self.n_frame), n_fft=n_fft)
        self.bin_hz = self.rate_hz / n_fft
        self.peak_bins = max(1, round(PEAK_BINS * n_fft / self.n_frame))

    def power(self, slew_per_s: float, which: slice) -> Floats:
        """Power (channels, frames, bins) of the frames ``which``, warped so that orders with that slew stand still."""
        centre = self._centre[which]
        ticks = np.arange(self.n_frame) - self.n_frame // 2
        if slew_per_s == 0.0:
            starts, source = centre - self.n_frame // 2, self._padded
        else:
            # from angle over speed at the centre, u = t + slew t^2 / 2, to time
            bend = slew_per_s / self.rate_hz
            offset = 2.0 * ticks / (1.0 + np.sqrt(1.0 + 2.0 * bend * ticks))
            source = values_at(self._padded, (centre[:, None] + offset).ravel())
            starts = frame_starts(source.shape[1], self.n_frame, self.n_frame)
        spectra = self._transform.spectra(source, starts)
        return np.asarray(spectra.real**2 + spectra.imag**2)


def _log_odds(frames: _Frames, speed_hz: Floats, order: Floats, weight: Floats, slew_per_s: float) -> Floats:
    """Log odds (frames, speeds) over the noise beside, the best of the slews.

    They are those of combs of ``order`` (orders,) that show with probability ``weight`` (orders,).
    """
    count = frames.time_s.size
    parts = [slice(first, min(first + FRAMES_AT_ONCE, count)) for first in range(0, count, FRAMES_AT_ONCE)]
    most = min(slew_per_s, MOST_WARP / frames.length_s)
    step = 2.0 * SLEW_BINS / (order[-1] * frames.length_s**2 * float(np.sqrt(speed_hz[0] * speed_hz[-1])))
    spacing = float(np.min(np.diff(order))) if order.size > 1 else 1.0
    block = max(1, round(1.5 * speed_hz[0] * spacing / frames.bin_hz))
    floor = _floor_beside(np.concatenate([frames.power(0.0, part) for part in parts], axis=1), block)
    log_odds = np.full((count, speed_hz.size), -np.inf)
    place = order * speed_hz[:, None] / frames.bin_hz
    place = np.where(order * speed_hz[:, None] <= frames.band_hz, place, -1.0)
    all_count = np.zeros(floor.shape[-1])
    for slew in np.linspace(-most, most, 2 * math.ceil(most / step) + 1):
        for part in parts:
            power = frames.power(float(slew), part)
            best_combs(power, floor[:, part], frames.peak_bins, all_count, place, weight, ODDS, log_odds[part])
    return log_odds


def _floor_beside(power: Floats, block: int) -> Floats:
    """Noise power (channels, frames, bins) beside each bin of ``power``."""
    n_blocks = max(1, power.shape[-1] // block)
    whole = power[..., : n_blocks * block].reshape(*power.shape[:2], n_blocks, -1)
    median = np.median(whole, axis=-1) / math.log(2.0)
    median = np.maximum(median, 1e-12 * power.max(axis=(1, 2), keepdims=True) + 1e-300)
    at = (np.arange(power.shape[-1]) + 0.5) / block - 0.5
    return np.asarray(np.exp(_between(at, np.arange(n_blocks, dtype=np.float64), np.log(median))))


def _odds_table() -> Floats:
    """Odds of a line against noise and stray lines for power over floor from 0 on, ODDS_STEPS to one.

    Lines are as likely at every size: their power, one plus line over noise, is log-uniform up to HIGHEST_LINE.
    """
    over_floor = np.maximum((np.arange(16 * ODDS_STEPS) + 0.5) / ODDS_STEPS, 1e-9)
    line = -np.expm1(-over_floor) / (over_floor * math.log(HIGHEST_LINE))
    return np.asarray(line / ((1.0 - STRAY_SHARE) * np.exp(-over_floor) + STRAY_SHARE * line))


ODDS_STEPS = 64
ODDS = _odds_table()


@njit(cache=True, nogil=True)
def best_combs(power, floor, peak_bins, neutral, place, weight, table, best):  # type: ignore[no-untyped-def]
    """Raise ``best`` (frames, speeds) to the log odds of the combs whose teeth are at bins ``place`` (speeds, orders).

    ``power`` and ``floor`` are (channels, frames, bins). A bin counts by its power over its floor, or over the power
    ``peak_bins`` beside it where that is larger; ``neutral`` (bins,) is 1 where a bin does not count. ``table``
    (steps,) holds the odds of a line for each power over floor, ``weight`` (orders,) the probability that an order
    shows. Channels have a part of their noise in common: together they count as the root of their number. Teeth outside
    the bins do not count.
    """
    n_channels, n_frames, n_bins = power.shape
    share_of_channel = 1.0 / np.sqrt(n_channels)
    odds = np.ones((n_channels, n_bins))
    steps = table.size / 16.0
    for i in range(n_frames):
        for c in range(n_channels):
            for b in range(n_bins):
                noise = floor[c, i, b]
                if b >= peak_bins:
                    noise = max(noise, power[c, i, b - peak_bins])
                if b + peak_bins < n_bins:
                    noise = max(noise, power[c, i, b + peak_bins])
                at = min(steps * power[c, i, b] / noise, table.size - 1.0)
                odds[c, b] = 1.0 if neutral[b] > 0.0 else table[int(at)]
        for j in range(place.shape[0]):
            product = 1.0
            for k in range(place.shape[1]):
                at = place[j, k]
                if at < 0.0 or at >= n_bins - 1:
                    continue
                low = int(at)
                share = at - low
                for c in range(n_channels):
                    here = (1.0 - share) * odds[c, low] + share * odds[c, low + 1]
                    product *= 1.0 - weight[k] + weight[k] * here
            total = np.log(product) * share_of_channel
            if total > best[i, j]:
                best[i, j] = total


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


def family_evidence(
    signals: Floats, rate_hz: float, knots: AngleKnots, *, ratio: Floats, order: Floats, weight: Floats
) -> tuple[Floats, Floats, Floats]:
    """Log odds (ratios,) of the fundamentals at ``ratio`` times the speed of ``knots``, from the same order spectra.

    Beside them the times [s] (frames,) of these spectra, and the log odds of single frames (frames, ratios).

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    knots : angle that is known except for its ratio
    ratio : (ratios,), fundamentals over the speed of ``knots``, above 0
    order : (orders,), orders of each fundamental
    weight : (orders,), 0…1, probability that the order shows
    """
    from scipy.special import gammaincc

    slow, fast = np.quantile(knots.speed_rpm, [0.1, 0.9])
    steady = bool(fast < STEADY * slow)
    revs = min(FAMILY_REVS[steady], 0.5 * float(knots.angle_rev[-1]))
    time_s, times = _order_power(signals, rate_hz, knots, revs)
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
    return total, time_s, of_frames


def _order_power(signals: Floats, rate_hz: float, knots: AngleKnots, revs: float) -> tuple[Floats, Floats]:
    """Times [s] of frames of ``revs`` revolutions, and their power over the noise beside it (channels, frames, bins).

    A bin is half of a line's resolution; the power is NaN outside the band.
    """
    from scipy.ndimage import median_filter

    total = float(knots.angle_rev[-1])
    count = int(min(FAMILY_FRAMES, max(1, (total - revs) / (0.5 * revs))))
    centre = np.linspace(0.5 * revs, total - 0.5 * revs, count + 2)[1:-1] if count > 1 else np.array([0.5 * total])
    bins = np.arange(int(FAMILY_ORDER * 2.0 * revs))
    spectra, inside = order_spectra(signals, rate_hz, knots, centre, revs=revs, bins=bins)
    power, reach = np.abs(spectra) ** 2, min(round(2.0 * revs), bins.size - 1)
    # the median within the reach of each bin, as a mean of noise
    median = median_filter(power, (1, 1, 2 * reach + 1), mode="mirror") / math.log(2.0)
    floor = np.maximum(median, 1e-12 * power.max(axis=(0, 2), keepdims=True) + 1e-300)
    times = np.where(inside, power / floor, np.nan)
    return time_at(centre, knots.time_s, knots.angle_rev, knots.speed_rpm), times


def order_spectra(
    signals: Floats, rate_hz: float, knots: AngleKnots, centre: Floats, *, revs: float, bins: Ints
) -> tuple[Complexes, Bools]:
    """Spectra (channels, frames, bins) by Hann frames evenly sampled in angle, and the bins (frames, bins) in the band.

    Phases count from the start of the frame.

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    knots : knots of the angle
    centre : (frames,), rev, middle of each frame
    revs : revolutions of a frame
    bins : (bins,), numbers of the bins, each 1 / (2 revs) orders wide
    """
    order = bins / (2.0 * revs)
    band = min(1.5 * float(order.max() * knots.speed_rpm.max()) / 60.0, PASS_BAND * rate_hz)
    reduced, rate, start_s = decimate(signals, rate_hz=rate_hz, band_hz=band, factor=decimation_factor(rate_hz, band))
    padded = np.pad(reduced, ((0, 0), (margin() + 2, margin() + 2)))
    speed_hz = np.interp(centre, knots.angle_rev, knots.speed_rpm) / 60.0
    spectra = np.empty((signals.shape[0], centre.size, bins.size), dtype=np.complex128)
    for i, (middle, speed) in enumerate(zip(centre, speed_hz, strict=True)):
        n = max(2 * int(bins.max()) + 2, math.ceil(1.3 * rate / speed * revs))
        angle = middle + revs * (np.arange(n) / n - 0.5)
        place = (time_at(angle, knots.time_s, knots.angle_rev, knots.speed_rpm) - start_s) * rate
        place = np.clip(place, 0.0, reduced.shape[1] - 1.0)
        framed = values_at(padded, place + margin() + 2) * hann(n).values
        spectra[:, i] = np.fft.rfft(framed, n=2 * n, axis=1)[:, bins]
    return spectra, order * speed_hz[:, None] <= min(band, PASS_BAND * rate)
