"""Crank angle from the phase of the orders themselves, once their speed is nearly known; it has no phase reference.

Along a nearly right angle every order turns slowly: its phase from frame to frame, over its order, is what the angle
lacks. The orders' answers are weighted by their signal-to-noise ratio and by the square of the order, and outvoted
where a resonance turns the phase of one of them. What they differ by is the standard error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from crankorder.fft.decimation import decimate, decimation_factor
from crankorder.fft.resampling import PASS_BAND
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
