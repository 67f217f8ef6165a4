"""Crank angle and speed on time knots from numbered pulses, and between the knots, with the standard error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from numba import njit

from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.smoother import (
    HIGHEST_CUT_OFF,
    LOWEST_CUT_OFF,
    Smoother,
    cut_off_of,
    noise_from_differences,
    penalty_of,
)
from crankorder.shaft.wheel import IntArray

# Interpolation between knots may err by this share of the standard error, or by ROUND_OFF_REV if that is more.
KNOT_ERROR_SHARE, ROUND_OFF_REV = 0.1, 1e-10
# Teeth from which the usual standard error is taken, and pulse times whose precision is looked at.
MEDIAN_TEETH, SOME_TIMES = 4096, 256
# Pivots of the spline's equations after which they are all alike; one cubic in so many shows what a stride may be.
SETTLED_PIVOTS, LOOKED_AT = 32, 16
# Wanted angles in one knot interval that are not worth a bound on the error of a common guess.
SHORT_RUN = 12
# Cycles per tooth that no wheel carries well: motion above this share is never promised.
CARRIED_CUT_OFF = 0.05


@dataclass(frozen=True)
class AngleKnots:
    """Knots (knots,) of crank angle: time [s], angle [rev], speed [rpm], standard error of the angle [rev].

    Between knots the angle is the cubic Hermite polynomial whose slopes are the speeds. ``cut_off_order`` is the order
    (cycles per crank revolution) above which motion is smoothed away, infinite where nothing is; ``noise_s`` the
    standard deviation of one pulse time that it rests on (NaN where there are no pulses).
    """

    time_s: FloatArray
    angle_rev: FloatArray
    speed_rpm: FloatArray
    standard_error_rev: FloatArray
    cut_off_order: float
    noise_s: float


def angle_knots(
    time_s: FloatArray,
    tooth: IntArray,
    *,
    teeth_per_rev: float,
    noise_s: float | None,
    settings: ShaftSettings,
) -> AngleKnots:
    """Knots of the smoothed crank angle, 0 at tooth 0, from one tooth before the first pulse to one after the last.

    Parameters
    ----------
    time_s : (pulses,), s, increasing; the spacing of its numbers, float32 or float64, is the least noise of a pulse
    tooth : (pulses,), tooth numbers, increasing; holes are teeth without a pulse
    teeth_per_rev : teeth per crank revolution (of the full wheel, times encoder revolutions per crank revolution)
    noise_s : standard deviation of one pulse time, s; None where unknown: it is then taken from the fourth differences
    settings : ``kept_order`` is never smoothed away where the wheel carries it (more keeps more noise);
        ``smoothing_margin`` multiplies the cut-off that the noise asks for (bias falls with its sixth power)

    Returns
    -------
    AngleKnots, no more of them than cubic interpolation to a tenth of the standard error needs.
    """
    start, resolution_s = float(time_s[0]), _resolution_s(time_s)
    grid, weight = _on_grid(time_s.astype(np.float64, copy=False) - start, tooth)
    noise = max(noise_from_differences(grid[weight > 0]) if noise_s is None else noise_s, resolution_s)
    floor = max(LOWEST_CUT_OFF, min(settings.kept_order / teeth_per_rev, CARRIED_CUT_OFF))
    cut_off, noise = cut_off_of(grid, weight, noise_s=noise, floor=floor, margin=settings.smoothing_margin)
    smoother = Smoother(weight, penalty_of(cut_off))
    smooth, slope = _with_slopes(smoother.smoothed(grid))
    leverage = smoother.leverage()
    step = 1 + leverage.size // MEDIAN_TEETH
    usual = noise * float(np.median(np.sqrt(leverage[::step]) / slope[1:-1:step]))
    at = _sparse(smooth, slope, max(KNOT_ERROR_SHARE * usual, ROUND_OFF_REV * teeth_per_rev), cut_off)
    rate = 1.0 / (teeth_per_rev * slope[at])
    error_s = noise * np.sqrt(leverage[np.clip(at - 1, 0, leverage.size - 1)])
    error_s[[0, -1]] *= 2.0
    order = cut_off * teeth_per_rev if cut_off <= HIGHEST_CUT_OFF else float("inf")
    angle = (tooth[0] - 1 + at) / teeth_per_rev
    return AngleKnots(smooth[at] + start, angle, rate * 60.0, error_s * rate, order, noise)


def _resolution_s(time_s: npt.NDArray[Any]) -> float:
    """How finely ``time_s`` can be told: the spacing of float64 there, of float32 where all are float32 numbers."""
    largest = float(max(abs(time_s[0]), abs(time_s[-1])))
    some = time_s[-SOME_TIMES:]
    if np.array_equal(some.astype(np.float32), some):
        return float(np.spacing(np.float32(largest))) / math.sqrt(12.0)
    return float(np.spacing(largest))


def _on_grid(time_s: FloatArray, tooth: IntArray) -> tuple[FloatArray, FloatArray]:
    """Pulse times on the even grid of teeth, and weights: 0 where a tooth has no pulse (its time is bridged)."""
    n = int(tooth[-1] - tooth[0]) + 1
    if n == time_s.size:
        return time_s, np.ones(n)
    place = tooth - tooth[0]
    weight = np.zeros(n)
    weight[place] = 1.0
    return np.interp(np.arange(n), place, time_s), weight


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _with_slopes(value):  # type: ignore[no-untyped-def]
    """Evenly spaced values and the slopes per step of their cubic spline, both with one step more at either end.

    The end slopes of the spline are those of the cubic through the four outermost values; beyond it goes on straight. A
    slope is raised to a third of the longest neighbouring step, so that the inverse of the cubic between any two values
    grows (Fritsch and Carlson 1980, their box); one that is not above 0 becomes infinite.
    """
    n = value.size
    out, slope, share = np.empty(n + 2), np.empty(n + 2), np.empty(min(n, SETTLED_PIVOTS))
    if n < 4:
        for i in range(n):
            low, high = max(i - 1, 0), min(i + 1, n - 1)
            slope[i + 1] = (value[high] - value[low]) / (high - low)
    else:
        slope[1] = (-11.0 * value[0] + 18.0 * value[1] - 9.0 * value[2] + 2.0 * value[3]) / 6.0
        slope[n] = (11.0 * value[n - 1] - 18.0 * value[n - 2] + 9.0 * value[n - 3] - 2.0 * value[n - 4]) / 6.0
        before, after, share[0], last = slope[1], slope[n], 0.0, share.size - 1
        for i in range(1, share.size):
            share[i] = 1.0 / (4.0 - share[i - 1])
        for i in range(1, n - 1):
            slope[i + 1] = 3.0 * share[min(i, last)] * (value[i + 1] - value[i - 1])
        for i in range(1, n - 1):
            before = slope[i + 1] - share[min(i, last)] * before
            slope[i + 1] = before
        for i in range(n - 2, 0, -1):
            after = slope[i + 1] - share[min(i, last)] * after
            slope[i + 1] = after
    out[0], out[n + 1] = value[0] - slope[1], value[n - 1] + slope[n]
    for i in range(n):
        out[i + 1] = value[i]
    slope[0], slope[n + 1] = slope[1], slope[n]
    step = slope[0]
    for i in range(n + 2):
        previous = step
        step = out[min(i + 1, n + 1)] - out[min(i, n)]
        slope[i] = max(slope[i], max(step, previous) / 3.0) if slope[i] > 0.0 else np.inf
    return out, slope


def _sparse(time_s: FloatArray, slope_s: FloatArray, allowed_teeth: float, cut_off: float) -> IntArray:
    """Which knots to keep so that cubics over the others err by no more than ``allowed_teeth``."""
    last = time_s.size - 1
    stride = 1 << max(0, int(np.log2(max(1.0, 0.1 / min(cut_off, 0.5)))))
    while 8 * stride < last and _stride_fits(time_s, slope_s, 2 * stride, LOOKED_AT, allowed_teeth):
        stride *= 2
    while stride > 1 and not _stride_fits(time_s, slope_s, stride, 1, allowed_teeth):
        stride //= 2
    return np.append(np.arange(0, last, stride), last)


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})
def _stride_fits(time, slope, stride, every, allowed):  # type: ignore[no-untyped-def]
    """Whether cubics over every ``stride``-th knot pass within ``allowed`` teeth of all, and grow.

    Of ``every`` so many of the cubics one is looked at.
    """
    last = time.size - 1
    for k in range(0, last, stride * every):
        end = min(k + stride, last)
        step, start, first, second = time[end] - time[k], time[k], 1.0 / slope[k], 1.0 / slope[end]
        rise = (end - k) / step
        if max(first, second) > 3.0 * rise:
            return False
        c2 = (3.0 * rise - 2.0 * first - second) / step
        c3 = (first + second - 2.0 * rise) / (step * step)
        worst = 0.0
        for i in range(1, end - k):
            x = time[k + i] - start
            worst = max(worst, abs(x * (first + x * (c2 + x * c3)) - i))
        if worst > allowed:
            return False
    return True


def knots_of(shaft: xr.Dataset) -> dict[str, FloatArray]:
    """Arguments of :func:`angle_at` and :func:`time_at` from the ShaftAngle ``shaft``."""
    return {
        "knot_time_s": shaft["time"].values,
        "knot_angle_rev": shaft["crank_angle"].values,
        "knot_speed_rpm": shaft["speed"].values,
    }


def angle_at(
    time_s: npt.ArrayLike, knot_time_s: FloatArray, knot_angle_rev: FloatArray, knot_speed_rpm: FloatArray
) -> FloatArray:
    """Crank angle [rev] at given times, NaN outside the knots; fastest for times that grow.

    Parameters
    ----------
    time_s : (times,), s
    knot_time_s : (knots,), s, increasing
    knot_angle_rev : (knots,), rev, increasing
    knot_speed_rpm : (knots,), rpm, 0 or more: the slopes of the cubics
    """
    wanted = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
    result: FloatArray = _hermite(wanted, knot_time_s, knot_angle_rev, knot_speed_rpm / 60.0)
    return result


def time_at(
    crank_angle_rev: npt.ArrayLike, knot_time_s: FloatArray, knot_angle_rev: FloatArray, knot_speed_rpm: FloatArray
) -> FloatArray:
    """Time [s] at which given crank angles are passed: the exact inverse of :func:`angle_at`, NaN outside the knots.

    Parameters
    ----------
    crank_angle_rev : (angles,), rev; fastest where they grow
    knot_time_s : (knots,), s, increasing
    knot_angle_rev : (knots,), rev, increasing
    knot_speed_rpm : (knots,), rpm, 0 or more: the slopes of the cubics
    """
    wanted = np.atleast_1d(np.asarray(crank_angle_rev, dtype=np.float64))
    result: FloatArray = _hermite_inverse(wanted, knot_time_s, knot_angle_rev, knot_speed_rpm / 60.0)
    return result


@njit(cache=True, nogil=True)
def _interval(knots, wanted, k):  # type: ignore[no-untyped-def]
    """Number of the knot interval that holds ``wanted``, sought from ``k`` upwards, then by bisection."""
    if knots[k] < wanted:
        for near in range(k, min(k + 4, knots.size - 1)):
            if wanted <= knots[near + 1]:
                return near
    low, high = 0, knots.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] < wanted:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def _run_end(knots, wanted, i, k):  # type: ignore[no-untyped-def]
    """End of the run of ``wanted`` from ``i`` on that lies in knot interval ``k``, as that of ``i`` does."""
    low, high = knots[k], knots[k + 1]
    i += 1
    while i < wanted.size and low < wanted[i] <= high:
        i += 1
    return i


@njit(cache=True, nogil=True, error_model="numpy")
def _hermite(wanted, time, angle, rate):  # type: ignore[no-untyped-def]
    out = np.empty(wanted.size)
    k, end = 0, 0
    while end < wanted.size:
        first = end
        t = wanted[first]
        if not (time[0] <= t <= time[-1]):
            out[first] = np.nan
            end += 1
            continue
        k = _interval(time, t, k)
        end = _run_end(time, wanted, first, k)
        start, step = time[k], time[k + 1] - time[k]
        rise = (angle[k + 1] - angle[k]) / step
        c0, c1, top = angle[k], rate[k], angle[k + 1]
        c2 = (3.0 * rise - 2.0 * rate[k] - rate[k + 1]) / step
        c3 = (rate[k] + rate[k + 1] - 2.0 * rise) / (step * step)
        run, reached = wanted[first:end], out[first:end]
        for i in range(run.size):
            x = run[i] - start
            value = c0 + x * (c1 + x * (c2 + x * c3))
            value = value if value > c0 else c0
            reached[i] = value if value < top else top
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _hermite_inverse(wanted, time, angle, rate):  # type: ignore[no-untyped-def]
    """A guess and two steps of Newton's method where they are sure to do for a whole interval, else one by one."""
    out = np.empty(wanted.size)
    k, end = 0, 0
    while end < wanted.size:
        first = end
        if not (angle[0] <= wanted[first] <= angle[-1]):
            out[first] = np.nan
            end += 1
            continue
        k = _interval(angle, wanted[first], k)
        end = _run_end(angle, wanted, first, k)
        start, step, base, rise = time[k], time[k + 1] - time[k], angle[k], angle[k + 1] - angle[k]
        # on the unit interval: share of the rise as a cubic of the share of the step
        c1, at_end = rate[k] * step / rise, rate[k + 1] * step / rise
        c2, c3 = 3.0 - 2.0 * c1 - at_end, c1 + at_end - 2.0
        share = 1.0 / rise
        if end - first < SHORT_RUN or not _newton_is_sure(c1, c2, c3):
            for i in range(first, end):
                out[i] = start + step * _share_of_step((wanted[i] - base) * share, c1, c2, c3)
            continue
        # the guess is the cubic whose slopes are those of the inverse
        g1, g2, g3 = 1.0 / c1, 3.0 - 2.0 / c1 - 1.0 / at_end, 1.0 / c1 + 1.0 / at_end - 2.0
        run, reached = wanted[first:end], out[first:end]
        for i in range(run.size):
            y = (run[i] - base) * share
            x = y * (g1 + y * (g2 + y * g3))
            each = 1.0 / (c1 + x * (2.0 * c2 + 3.0 * x * c3))
            x -= (x * (c1 + x * (c2 + x * c3)) - y) * each
            x -= (x * (c1 + x * (c2 + x * c3)) - y) * each
            x = x if x > 0.0 else 0.0
            x = x if x < 1.0 else 1.0
            reached[i] = start + step * x
    return out


@njit(cache=True, nogil=True)
def _newton_is_sure(c1, c2, c3):  # type: ignore[no-untyped-def]
    """Whether two steps of Newton's method, the second with the slope of the first, end at round-off from the guess.

    The cubic Hermite guess errs by no more than the largest fourth derivative of the inverse over 384.
    """
    bend, twist = 2.0 * abs(c2) + 6.0 * abs(c3), 6.0 * abs(c3)
    swing = abs(c1 - 1.0) + bend
    if swing > 0.3:
        return False
    guess = (10.0 * (1.0 + swing) * bend * twist + 15.0 * bend**3) / (384.0 * (1.0 - swing) ** 7)
    return bend * bend * guess**3 < 1e-17


@njit(cache=True, nogil=True)
def _share_of_step(y, c1, c2, c3):  # type: ignore[no-untyped-def]
    """Where the cubic reaches ``y``: Newton's method from a fixed-point step, kept in the interval by bisection."""
    bend = abs(c2) + 3.0 * abs(c3)
    bend = 2.0 * bend if bend < 0.2 else 10.0
    low, high = 0.0, 1.0
    x = 2.0 * y - y * (c1 + y * (c2 + y * c3))
    for _ in range(60):
        if not (low <= x <= high):
            x = 0.5 * (low + high)
        miss = x * (c1 + x * (c2 + x * c3)) - y
        if miss > 0.0:
            high = x
        else:
            low = x
        slope = c1 + x * (2.0 * c2 + 3.0 * x * c3)
        change = miss / slope if slope > 0.0 else 1.0
        # the next step of Newton's method would change x by bend * change^2
        if miss == 0.0 or bend * change * change < 1e-15 or high - low < 1e-16:
            x = x if slope == 0.0 else x - change
            break
        x -= change
    return min(max(x, low), high)
