"""Crank angle from the vibration: evidence for each speed at each instant, then the phase of the orders themselves.

The speeds are split into octaves, and each octave has frames of its own, a few revolutions long, from a signal that is
decimated to what its orders need. Within a frame the speed may change: time is warped for each of a few slews so that
every order of a shaft with that slew is one line (Weruaga and Kepesi 2007, the fan-chirp transform). A bin's power over
the local floor gives the odds that a line is there; the odds saturate, so that no line counts for more than another.

Along a nearly right angle every order turns slowly: its phase from frame to frame, over its order, is what the angle
lacks. The orders' answers are weighted by their signal-to-noise ratio and by the square of the order, and outvoted
where a resonance turns the phase of one of them. What they differ by is the standard error. There is no
phase reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from crankorder.fft.decimation import decimate, decimation_factor
from crankorder.fft.resampling import PASS_BAND, margin, values_at
from crankorder.fft.transforms import FrameTransform, frame_starts
from crankorder.fft.windows import hann
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import angle_at, time_at
from crankorder.shaft.pulses import FloatArray

# Frames of so many revolutions, and knots so many to a frame.
FRAME_REVS, KNOTS_PER_FRAME = 8.0, 4
# The angle is corrected so often, and smoothed or not: at first the error still blurs the lines.
ROUNDS = (False, True, True, True)
# A structure may turn the phase of an order by so much from knot to knot, rad: no order is trusted to less.
STRUCTURE_RAD = 0.1
# The nearly right speed errs by this share.
COARSE_ERROR = 0.02
# Power over noise is a mean of so many frames on either side; a line of so much is faint.
SNR_REACH, FAINT = 3, 4.0
# Penalties tried on the third differences of the times, strongest first; blocks of knots, none of which may be missed
# by more than this mean square of its noise.
SMOOTHING = tuple(10.0**k for k in np.arange(7.0, -1.5, -0.5))
BLOCK_KNOTS, ALLOWED_MISS = 48, 1.25
# Noise is measured so far beside an order, where no half order lies.
BESIDE_ORDER = 0.25


@dataclass(frozen=True)
class TrackedAngle:
    """Knots (knots,) of an angle that follows the orders: time [s], angle [rev], speed [Hz] and their standard errors.

    The angle is 0 at the first sample, and its error is that of the angle between a knot and the middle of all.
    """

    time_s: FloatArray
    angle_rev: FloatArray
    speed_hz: FloatArray
    angle_error_rev: FloatArray
    speed_error_hz: FloatArray

    def times(self, ratio: float) -> TrackedAngle:
        """The same for a shaft that turns ``ratio`` times as fast."""
        scaled = (self.angle_rev, self.speed_hz, self.angle_error_rev, self.speed_error_hz)
        return TrackedAngle(self.time_s, *(ratio * each for each in scaled))


def tracked_angle(
    signals: FloatArray, rate_hz: float, *, time_s: FloatArray, speed_hz: FloatArray, order: FloatArray
) -> TrackedAngle:
    """Angle that keeps the phases of the orders still, from a speed that is right to some parts in a thousand.

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    time_s : (knots,), s, increasing, within the recording
    speed_hz : (knots,), revolutions per second, > 0
    order : (orders,), orders that may show
    """
    band = min(1.2 * float(order[-1] * speed_hz.max()), PASS_BAND * rate_hz)
    reduced, rate, start_s = decimate(signals, rate_hz=rate_hz, band_hz=band, factor=decimation_factor(rate_hz, band))
    end_s = signals.shape[1] / rate_hz
    tracked = _integrated(time_s, speed_hz, end_s)
    sample_s = start_s + np.arange(reduced.shape[1]) / rate
    for smooth in ROUNDS:
        tracked = _corrected(tracked, reduced.astype(np.float64, copy=False), sample_s, order, smooth=smooth)
    return tracked


def _integrated(time_s: FloatArray, speed_hz: FloatArray, end_s: float) -> TrackedAngle:
    """The angle from 0 to ``end_s`` of a speed that is linear between knots and constant beyond them."""
    time_s = np.concatenate(([0.0], time_s, [end_s]))
    speed = np.concatenate((speed_hz[:1], speed_hz, speed_hz[-1:]))
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))))
    keep = np.append(True, np.diff(time_s) > 0.0)
    time_s, angle, speed = time_s[keep], angle[keep], speed[keep]
    error = COARSE_ERROR * speed
    return TrackedAngle(time_s, angle, speed, np.abs(angle - 0.5 * angle[-1]) * COARSE_ERROR, error)


def _corrected(
    tracked: TrackedAngle, signals: FloatArray, sample_s: FloatArray, order: FloatArray, *, smooth: bool
) -> TrackedAngle:
    """``tracked`` with knots where its frames are, and the angle that the orders' phases ask for."""
    total = float(tracked.angle_rev[-1])
    revs = min(FRAME_REVS, 0.25 * total)
    count = max(3, int((total - revs) * KNOTS_PER_FRAME / revs) + 1)
    centre = np.linspace(0.5 * revs, total - 0.5 * revs, count)
    hop = float(centre[1] - centre[0])
    at = (tracked.time_s, tracked.angle_rev, 60.0 * tracked.speed_hz)
    angle = angle_at(sample_s, *at)
    beside = np.concatenate((order, order - BESIDE_ORDER, order + BESIDE_ORDER))
    lines = np.empty((signals.shape[0], count, beside.size), dtype=np.complex128)
    _demodulate(signals, angle, centre, revs, beside, lines)
    n = order.size
    noise = _running_median(np.mean([abs(lines[..., n : 2 * n]) ** 2, abs(lines[..., 2 * n :]) ** 2], axis=0))
    turn, weight, snr = _turns(lines[..., :n], noise)
    change, scatter = _outvoted(turn, weight, order, hop)
    correction = np.concatenate(([0.0], np.cumsum(change)))
    correction -= correction[count // 2]
    noise_rev = np.sqrt(0.5 / np.maximum(np.sum(snr * (2.0 * np.pi * order) ** 2, axis=1), 1e-9))
    time_s = time_at(centre, *at)
    if not smooth:
        return _with_ends(time_s, centre + correction, tracked, scatter, noise_rev, order)
    # all but nothing is left to correct, so that the same change may be made to the time at which an angle is passed
    speed = np.interp(centre, tracked.angle_rev, tracked.speed_hz)
    passed_s, kept = _smoothed(time_s - np.clip(correction, -0.1, 0.1) / speed, noise_rev / speed)
    within = passed_s[0] > 0.0 and passed_s[-1] < tracked.time_s[-1] and bool((np.diff(passed_s) > 0.0).all())
    if not within:
        return _with_ends(time_s, centre + correction, tracked, scatter, noise_rev, order)
    return _with_ends(passed_s, centre, tracked, scatter, noise_rev * math.sqrt(kept), order, kept=kept)


def _smoothed(time_s: FloatArray, noise_s: FloatArray) -> tuple[FloatArray, float]:
    """Times (knots,) of even angles, as smooth as their noise allows, and the share of the noise power that is left.

    Penalised least squares on third differences (Whittaker 1923), the strongest that misses no block of knots by more
    than its noise explains (Morozov 1966).
    """
    from scipy.linalg import solveh_banded

    n = time_s.size
    if n < 8:
        return time_s, 1.0
    weight = (np.median(noise_s) / np.maximum(noise_s, 1e-3 * np.median(noise_s))) ** 2
    penalty = np.zeros((4, n))
    for row, kernel in enumerate(_THIRD):
        for i, value in enumerate(kernel):
            penalty[3 - row, row + i : n - 3 + i + row] += value
    blocks = np.arange(0, n, BLOCK_KNOTS)
    for power in SMOOTHING:
        banded = power * penalty
        banded[3] += weight
        smooth: FloatArray = solveh_banded(banded, weight * (time_s - time_s[0])) + time_s[0]
        missed = np.add.reduceat(((smooth - time_s) / noise_s) ** 2, blocks) / np.diff(np.append(blocks, n))
        if missed.max() <= ALLOWED_MISS:
            cut_off = power ** (-1.0 / 6.0) / (2.0 * math.pi)
            return smooth, min(1.0, 2.0 * cut_off * KNOTS_PER_FRAME / 1.5)
    return time_s, 1.0


# Products of the third difference (-1, 3, -3, 1) with itself at each lag, by where they stand.
_THIRD = ((1.0, 9.0, 9.0, 1.0), (-3.0, -9.0, -3.0), (3.0, 3.0), (-1.0,))


@njit(cache=True, nogil=True)
def _demodulate(signals, angle, centre, revs, order, out):  # type: ignore[no-untyped-def]
    """Amplitudes ``out`` (channels, frames, orders) of the lines of ``signals`` along ``angle``, by Hann windows."""
    n_channels = signals.shape[0]
    first = 0
    for m in range(centre.size):
        low, high = centre[m] - 0.5 * revs, centre[m] + 0.5 * revs
        while first < angle.size and not angle[first] > low:
            first += 1
        out[:, m] = 0.0
        total, i = 0.0, first
        while i < angle.size and angle[i] < high:
            place = angle[i] - centre[m]
            window = 0.5 + 0.5 * np.cos(2.0 * np.pi * place / revs)
            total += window
            for k in range(order.size):
                phase = -2.0 * np.pi * order[k] * place
                turned = complex(window * np.cos(phase), window * np.sin(phase))
                for c in range(n_channels):
                    out[c, m, k] += signals[c, i] * turned
            i += 1
        for k in range(order.size):
            whole = order[k] * centre[m]
            phase = -2.0 * np.pi * (whole - np.floor(whole))
            turned = complex(np.cos(phase), np.sin(phase)) * (2.0 / max(total, 1e-9))
            for c in range(n_channels):
                out[c, m, k] *= turned


def _running_median(power: FloatArray) -> FloatArray:
    """Median of ``power`` (channels, frames, orders) over the 15 frames around each, as a mean of noise."""
    reach = min(7, power.shape[1] // 2)
    padded = np.pad(power, ((0, 0), (reach, reach), (0, 0)), mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=1), axis=-1)
    # the mean of two exponential powers has its median at 0.84 of its mean
    floor: FloatArray = np.maximum(median / 0.84, 1e-12 * power.max() + 1e-300)
    return floor


def _running_mean(values: FloatArray, *, reach: int) -> FloatArray:
    """Mean of ``values`` (frames, orders) over ``reach`` frames on either side of each."""
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    mean: FloatArray = np.mean(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0), axis=-1)
    return mean


def _turns(lines: np.ndarray, noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn [rad] of each order from frame to frame (steps, orders), its weight 1/variance, and its power over noise."""
    power = np.sum(np.abs(lines) ** 2 / noise - 1.0, axis=0)
    product = np.sum(lines[:, 1:] * np.conj(lines[:, :-1]) / np.sqrt(noise[:, 1:] * noise[:, :-1]), axis=0)
    snr = np.maximum(_running_mean(power, reach=SNR_REACH), 0.0)
    pair = np.maximum(np.minimum(snr[1:], snr[:-1]), 1e-9)
    # an order near its noise tells next to nothing, however high it is
    weight = (pair / (pair + FAINT)) ** 4 / (STRUCTURE_RAD**2 + 1.0 / pair)
    return np.angle(product), weight, snr


def _outvoted(turn: FloatArray, weight: FloatArray, order: FloatArray, hop: float) -> tuple[FloatArray, FloatArray]:
    """Change of angle [rev] per step that most orders agree on; by how much each turns besides, and its vote."""
    gain = 2.0 * np.pi * order
    prior = 1.0 / (COARSE_ERROR * hop) ** 2
    vote = weight
    change = np.zeros(turn.shape[0])
    for _ in range(4):
        rest = np.angle(np.exp(1j * (turn - change[:, None] * gain)))
        far = rest**2 * weight
        vote = weight / (1.0 + far / 4.0)
        change = change + (np.sum(vote * gain * rest, axis=1) - prior * change) / (
            np.sum(vote * gain**2, axis=1) + prior
        )
    rest = np.angle(np.exp(1j * (turn - change[:, None] * gain)))
    return np.clip(change, -0.2 * hop, 0.2 * hop), np.stack([rest, vote])


def _with_ends(
    time_s: FloatArray,
    angle: FloatArray,
    before: TrackedAngle,
    scatter: FloatArray,
    noise_rev: FloatArray,
    order: FloatArray,
    *,
    kept: float = 1.0,
) -> TrackedAngle:
    """Knots continued to the ends of ``before``, with slopes and errors: noise, and what the orders differ by."""
    rest, vote = scatter
    gain = 2.0 * np.pi * order
    information = np.sum(vote * gain**2, axis=1)
    # what each order alone would add to the angle, about the middle
    own = np.cumsum(rest / gain, axis=0)
    own = np.vstack((np.zeros(order.size), own)) - own[own.shape[0] // 2]
    trust = np.vstack((vote[:1], vote)) * gain**2
    share = trust / np.maximum(trust.sum(axis=1, keepdims=True), 1e-300)
    voters = 1.0 / np.maximum(np.sum(share**2, axis=1), 1e-9)
    spread = np.sum(share * own**2, axis=1) / np.maximum(voters - 1.0, 0.5)
    angle_error = np.sqrt(spread + noise_rev**2)
    step_s = np.diff(time_s)
    per_step = np.sqrt(1.0 / (information + 1.0 / (COARSE_ERROR * np.diff(angle)) ** 2)) / step_s
    # the noise of a slope goes with the third power of the band that is kept
    per_step *= kept**1.5
    speed_error = np.append(per_step[:1], np.maximum(per_step, np.append(per_step[1:], per_step[-1])))
    some = min(KNOTS_PER_FRAME, angle.size - 1)
    first = _beyond(before, time_s[[0, some]], angle[[0, some]], before.time_s[0])
    last = _beyond(before, time_s[[-1, -1 - some]], angle[[-1, -1 - some]], before.time_s[-1])
    time_s = np.concatenate((first[0], time_s, last[0]))
    angle = np.concatenate((angle[0] + first[1], angle, angle[-1] + last[1]))
    ends = [np.full(first[0].size, 1.0), np.full(last[0].size, 1.0)]
    angle_error = np.concatenate((3.0 * ends[0] * angle_error[0], angle_error, 3.0 * ends[1] * angle_error[-1]))
    speed_error = np.concatenate((3.0 * ends[0] * speed_error[0], speed_error, 3.0 * ends[1] * speed_error[-1]))
    slope = _slopes(time_s, angle)
    return TrackedAngle(time_s, angle - angle[0], slope, angle_error, speed_error)


def _beyond(before: TrackedAngle, time_s: FloatArray, angle: FloatArray, end_s: float) -> tuple[FloatArray, FloatArray]:
    """Time ``end_s`` (1,) and its angle from the outermost knot, or neither (0,) where that knot is there.

    ``time_s``, ``angle``: (2,), the outermost knot and one further in. Speed changes as it did ``before``.
    """
    if abs(end_s - time_s[0]) < 1e-9:
        return np.empty(0), np.empty(0)
    known = angle_at(np.append(end_s, time_s), before.time_s, before.angle_rev, 60.0 * before.speed_hz)
    faster = (angle[1] - angle[0]) / (known[2] - known[1])
    return np.array([end_s]), np.array([faster * (known[0] - known[1])])


def _slopes(time_s: FloatArray, angle: FloatArray) -> FloatArray:
    """Slopes of the cubic spline through the knots, kept so that the angle grows."""
    from scipy.interpolate import CubicSpline

    slope: FloatArray = CubicSpline(time_s, angle)(time_s, 1)
    rise = np.diff(angle) / np.diff(time_s)
    largest = 3.0 * np.minimum(np.append(rise[:1], rise), np.append(rise, rise[-1:]))
    return np.clip(slope, 0.01 * largest, largest)


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


@dataclass(frozen=True)
class SpeedEvidence:
    """Log odds (knots, speeds) of a comb of orders against none, for knots ``time_s`` and speeds ``speed_hz``.

    ``every`` counts lines over the noise next to them; ``moving`` only what stands above the usual power at the same
    frequency too, so that tones and natural frequencies drop out, and so do the orders of a steady shaft.
    ``frames_per_knot`` is the number of independent frames that a knot is worth. The speeds are even in the logarithm.
    """

    time_s: FloatArray
    speed_hz: FloatArray
    every: FloatArray
    moving: FloatArray
    frames_per_knot: float


def comb_evidence(
    signals: FloatArray,
    rate_hz: float,
    *,
    range_hz: tuple[float, float],
    order: FloatArray,
    weight: FloatArray,
    settings: ShaftSettings,
    fixed_hz: Sequence[float] = (),
) -> SpeedEvidence:
    """Evidence of every speed of a grid on common time knots.

    Parameters
    ----------
    signals : (channels, samples)
    rate_hz : samples per second
    range_hz : lowest and highest speed, revolutions per second
    order : (orders,), increasing, cycles per revolution
    weight : (orders,), 0…1, probability that the order shows
    settings : ``vibration_revs`` per frame, ``vibration_slew_per_s``
    fixed_hz : tones that belong to no order and are not looked at, Hz
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
    every, moving = (np.empty((time_s.size, speed.size), dtype=np.float32) for _ in range(2))
    log_odds = _LogOdds(order, weight, fixed_hz)
    for octave in range(n_octaves):
        states = slice(octave * n_each, (octave + 1) * n_each + (octave == n_octaves - 1))
        frames = _Frames(signals, rate_hz, length_s=revs / speed[states.start], top_hz=speed[states][-1] * order[-1])
        at_frames = log_odds.of_frames(frames, speed[states], settings.vibration_slew_per_s)
        for target, values in zip((every, moving), at_frames, strict=True):
            target[:, states] = _between(time_s, frames.time_s, values)
    spacing = duration / time_s.size
    worth = min(1.0, 1.5 * spacing / (revs / math.sqrt(low * high)))
    return SpeedEvidence(time_s, speed, every, moving, worth)


def _between(time_s: FloatArray, frame_s: FloatArray, values: FloatArray) -> FloatArray:
    """``values`` (frames, …) at ``time_s``, linear between the frames' times ``frame_s``, constant beyond them."""
    if frame_s.size == 1:
        return np.repeat(values, time_s.size, axis=0)
    k = np.clip(np.searchsorted(frame_s, time_s) - 1, 0, frame_s.size - 2)
    share = np.clip((time_s - frame_s[k]) / (frame_s[k + 1] - frame_s[k]), 0.0, 1.0)[:, None]
    between: FloatArray = (1.0 - share) * values[k] + share * values[k + 1]
    return between


class _Frames:
    """Spectra of overlapping frames of one length, with any slew, from a signal decimated to its band."""

    def __init__(self, signals: FloatArray, rate_hz: float, *, length_s: float, top_hz: float) -> None:
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
        self._transform = FrameTransform(hann(self.n_frame), n_fft=_even_size(PADDING * self.n_frame))
        self.bin_hz = self.rate_hz / self._transform.n_fft
        self.peak_bins = max(1, round(PEAK_BINS * self._transform.n_fft / self.n_frame))

    def power(self, slew_per_s: float, which: slice) -> FloatArray:
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
        power: FloatArray = spectra.real**2 + spectra.imag**2
        return power


def _even_size(n: int) -> int:
    """The smallest number from ``n`` on whose factors are small."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(n, real=True))


@dataclass(frozen=True)
class _LogOdds:
    """Log odds of combs of ``order`` that show with probability ``weight``."""

    order: FloatArray
    weight: FloatArray
    fixed_hz: Sequence[float]

    def of_frames(self, frames: _Frames, speed_hz: FloatArray, slew_per_s: float) -> tuple[FloatArray, FloatArray]:
        """Log odds (frames, speeds) over the noise beside, and over the usual power too; the best of the slews."""
        count = frames.time_s.size
        most = min(slew_per_s, MOST_WARP / frames.length_s)
        step = 2.0 * SLEW_BINS / (self.order[-1] * frames.length_s**2 * float(np.sqrt(speed_hz[0] * speed_hz[-1])))
        n_slews = math.ceil(most / step)
        slews = np.linspace(-most, most, 2 * n_slews + 1)
        block = max(1, round(1.5 * speed_hz[0] * self._spacing() / frames.bin_hz))
        floor, usual = self._floors(frames, block)
        above = np.maximum(floor, usual)
        every, moving = (np.full((count, speed_hz.size), -np.inf) for _ in range(2))
        place = self.order * speed_hz[:, None] / frames.bin_hz
        place = np.where(self.order * speed_hz[:, None] <= frames.band_hz, place, -1.0)
        for slew in slews:
            neutral = self._neutral(frames, slew, floor.shape[-1])
            for first in range(0, count, FRAMES_AT_ONCE):
                some = slice(first, min(first + FRAMES_AT_ONCE, count))
                power = frames.power(float(slew), some)
                for noise, best in ((floor[:, some], every), (above[:, some], moving)):
                    best_combs(power, noise, frames.peak_bins, neutral, place, self.weight, ODDS, best[some])
        return every, moving

    def _spacing(self) -> float:
        """Usual distance of the orders: their smallest, 1 where there is but one."""
        return float(np.min(np.diff(self.order))) if self.order.size > 1 else 1.0

    def _floors(self, frames: _Frames, block: int) -> tuple[FloatArray, FloatArray]:
        """Noise power (channels, frames, bins) beside each bin, and the usual power (channels, 1, bins)."""
        parts = [
            frames.power(0.0, slice(first, first + FRAMES_AT_ONCE))
            for first in range(0, frames.time_s.size, FRAMES_AT_ONCE)
        ]
        power = np.concatenate(parts, axis=1)
        usual = np.median(power, axis=1, keepdims=True) / math.log(2.0)
        n_blocks = max(1, power.shape[-1] // block)
        whole = power[..., : n_blocks * block].reshape(*power.shape[:2], n_blocks, -1)
        median = np.median(whole, axis=-1) / math.log(2.0)
        median = np.maximum(median, 1e-12 * power.max(axis=(1, 2), keepdims=True) + 1e-300)
        at = (np.arange(power.shape[-1]) + 0.5) / block - 0.5
        k = np.clip(at.astype(np.int64), 0, max(0, n_blocks - 2))
        share = np.clip(at - k, 0.0, 1.0)
        log_median = np.log(median)
        after = np.minimum(k + 1, n_blocks - 1)
        return np.exp((1.0 - share) * log_median[..., k] + share * log_median[..., after]), usual

    def _neutral(self, frames: _Frames, slew_per_s: float, n_bins: int) -> FloatArray:
        """1.0 for bins (bins,) that a fixed tone may reach, else 0.0."""
        frequency = np.arange(n_bins) * frames.bin_hz
        neutral = np.zeros(n_bins)
        for tone in self.fixed_hz:
            reach = 2.0 / frames.length_s + 0.5 * tone * abs(slew_per_s) * frames.length_s
            neutral[np.abs(frequency - tone) <= reach] = 1.0
        return neutral


def _odds_table() -> FloatArray:
    """Odds of a line against noise and stray lines for power over floor from 0 on, ODDS_STEPS to one.

    Lines are as likely at every size: their power, one plus line over noise, is log-uniform up to HIGHEST_LINE.
    """
    over_floor = np.maximum((np.arange(16 * ODDS_STEPS) + 0.5) / ODDS_STEPS, 1e-9)
    line = -np.expm1(-over_floor) / (over_floor * math.log(HIGHEST_LINE))
    odds: FloatArray = line / ((1.0 - STRAY_SHARE) * np.exp(-over_floor) + STRAY_SHARE * line)
    return odds


ODDS_STEPS = 64
ODDS = _odds_table()


@njit(cache=True, nogil=True)
def best_combs(power, floor, peak_bins, neutral, place, weight, table, best):  # type: ignore[no-untyped-def]
    """Raise ``best`` (frames, speeds) to the log odds of the combs whose teeth are at bins ``place`` (speeds, orders).

    ``power``, ``floor``: (channels, frames, bins). A bin counts over its floor or over the power ``peak_bins`` beside
    it, what is more; ``neutral`` (bins,) is 1 where it does not count; ``table``: the odds of a line for each power
    over floor; ``weight``: (orders,). Channels hear the same noise in part: together they count as the root of their
    number. Teeth outside the bins tell nothing.
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
