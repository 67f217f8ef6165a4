"""Crank angle and speed on time knots from numbered pulses, and between the knots, with the standard error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr
from numba import njit

from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.smoother import (
    HIGHEST_CUT_OFF,
    LOWEST_CUT_OFF,
    cut_off_of,
    leverage,
    noise_from_differences,
    penalty_of,
    smoothed,
)
from crankorder.shaft.wheel import IntArray

# Interpolation between knots may err by this share of the standard error, or by ROUND_OFF_REV if that is more.
KNOT_ERROR_SHARE, ROUND_OFF_REV = 0.1, 1e-10
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
    time_s : (pulses,), s, increasing
    tooth : (pulses,), tooth numbers, increasing; holes are teeth without a pulse
    teeth_per_rev : teeth per crank revolution (of the full wheel, times encoder revolutions per crank revolution)
    noise_s : standard deviation of one pulse time, s; None where unknown: it is then taken from the fourth differences
    settings : ``kept_order`` is never smoothed away where the wheel carries it (more keeps more noise);
        ``smoothing_margin`` multiplies the cut-off that the noise asks for (bias falls with its sixth power)

    Returns
    -------
    AngleKnots, no more of them than cubic interpolation to a tenth of the standard error needs.
    """
    start = time_s[0]
    grid, weight = _on_grid(time_s - start, tooth)
    noise = noise_from_differences(grid[weight > 0]) if noise_s is None else noise_s
    noise = max(noise, float(np.spacing(max(abs(start), grid[-1]))))
    floor = max(LOWEST_CUT_OFF, min(settings.kept_order / teeth_per_rev, CARRIED_CUT_OFF))
    cut_off, noise = cut_off_of(grid, weight, noise_s=noise, floor=floor, margin=settings.smoothing_margin)
    smooth = smoothed(grid, weight, penalty_of(cut_off))
    slope = _spline_slopes(smooth)
    error_s = noise * np.sqrt(leverage(weight, penalty_of(cut_off)))
    # one tooth more at either end, along the tangent
    smooth = np.concatenate(([smooth[0] - slope[0]], smooth, [smooth[-1] + slope[-1]]))
    slope = np.concatenate((slope[:1], slope, slope[-1:]))
    error_s = np.concatenate((2.0 * error_s[:1], error_s, 2.0 * error_s[-1:]))
    angle = np.arange(tooth[0] - 1, tooth[-1] + 2) / teeth_per_rev
    rate = _monotone(smooth, angle, 1.0 / (teeth_per_rev * slope))
    standard_error = error_s * rate
    at = _sparse(smooth, angle, rate, max(KNOT_ERROR_SHARE * float(np.median(standard_error)), ROUND_OFF_REV), cut_off)
    order = cut_off * teeth_per_rev if cut_off <= HIGHEST_CUT_OFF else float("inf")
    return AngleKnots(smooth[at] + start, angle[at], rate[at] * 60.0, standard_error[at], order, noise)


def _on_grid(time_s: FloatArray, tooth: IntArray) -> tuple[FloatArray, FloatArray]:
    """Pulse times on the even grid of teeth, and weights: 0 where a tooth has no pulse (its time is bridged)."""
    place = tooth - tooth[0]
    weight = np.zeros(place[-1] + 1)
    weight[place] = 1.0
    if weight.size == time_s.size:
        return time_s, weight
    return np.interp(np.arange(weight.size), place, time_s), weight


@njit(cache=True, nogil=True)
def _spline_slopes(value):  # type: ignore[no-untyped-def]
    """Slopes per step of the cubic spline through evenly spaced values; end slopes from the four outermost values."""
    n = value.size
    slope, share = np.empty(n), np.empty(n)
    if n < 4:
        for i in range(n):
            low, high = max(i - 1, 0), min(i + 1, n - 1)
            slope[i] = (value[high] - value[low]) / (high - low)
        return slope
    slope[0] = (-11.0 * value[0] + 18.0 * value[1] - 9.0 * value[2] + 2.0 * value[3]) / 6.0
    end = (11.0 * value[n - 1] - 18.0 * value[n - 2] + 9.0 * value[n - 3] - 2.0 * value[n - 4]) / 6.0
    share[0] = 0.0
    for i in range(1, n - 1):
        pivot = 4.0 - share[i - 1]
        share[i] = 1.0 / pivot
        slope[i] = (3.0 * (value[i + 1] - value[i - 1]) - slope[i - 1]) / pivot
    slope[n - 1] = end
    for i in range(n - 2, 0, -1):
        slope[i] -= share[i] * slope[i + 1]
    return slope


@njit(cache=True, nogil=True)
def _monotone(time_s, angle_rev, rate):  # type: ignore[no-untyped-def]
    """``rate`` [rev/s] limited so that the cubic between any two knots grows (Fritsch and Carlson 1980, their box)."""
    n = rate.size
    out = np.empty(n)
    before = np.inf
    for i in range(n):
        after = (angle_rev[i + 1] - angle_rev[i]) / (time_s[i + 1] - time_s[i]) if i + 1 < n else np.inf
        out[i] = min(max(rate[i], 0.0), 3.0 * min(before, after))
        before = after
    return out


def _sparse(
    time_s: FloatArray, angle_rev: FloatArray, rate: FloatArray, allowed_rev: float, cut_off: float
) -> IntArray:
    """Which knots to keep so that cubics over the others err by no more than ``allowed_rev``."""
    last = time_s.size - 1
    stride = 1 << max(0, int(np.log2(max(1.0, 0.1 / min(cut_off, 0.5)))))
    while stride > 1 and not _stride_fits(time_s, angle_rev, rate, stride, allowed_rev):
        stride //= 2
    while 8 * stride < last and _stride_fits(time_s, angle_rev, rate, 2 * stride, allowed_rev):
        stride *= 2
    return np.unique(np.append(np.arange(0, last, stride), last))


@njit(cache=True, nogil=True)
def _stride_fits(time, angle, rate, stride, allowed):  # type: ignore[no-untyped-def]
    """Whether the cubics over every ``stride``-th knot pass within ``allowed`` of all, and grow."""
    last = time.size - 1
    for k in range(0, last, stride):
        end = min(k + stride, last)
        step = time[end] - time[k]
        rise = (angle[end] - angle[k]) / step
        if max(rate[k], rate[end]) > 3.0 * rise:
            return False
        c2 = (3.0 * rise - 2.0 * rate[k] - rate[end]) / step
        c3 = (rate[k] + rate[end] - 2.0 * rise) / (step * step)
        for i in range(k + 1, end):
            x = time[i] - time[k]
            if abs(angle[k] + x * (rate[k] + x * (c2 + x * c3)) - angle[i]) > allowed:
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
def _hermite(wanted, time, angle, rate):  # type: ignore[no-untyped-def]
    out = np.empty(wanted.size)
    k, current = 0, -1
    c0 = c1 = c2 = c3 = start = 0.0
    for i in range(wanted.size):
        t = wanted[i]
        if not (time[0] <= t <= time[-1]):
            out[i] = np.nan
            continue
        k = _interval(time, t, k)
        if k != current:
            current, start = k, time[k]
            step = time[k + 1] - start
            rise = (angle[k + 1] - angle[k]) / step
            c0, c1 = angle[k], rate[k]
            c2 = (3.0 * rise - 2.0 * rate[k] - rate[k + 1]) / step
            c3 = (rate[k] + rate[k + 1] - 2.0 * rise) / (step * step)
        x = t - start
        out[i] = min(max(c0 + x * (c1 + x * (c2 + x * c3)), c0), angle[k + 1])
    return out


@njit(cache=True, nogil=True)
def _hermite_inverse(wanted, time, angle, rate):  # type: ignore[no-untyped-def]
    """Newton's method kept within the interval by bisection; the first guess is one step of fixed point."""
    out = np.empty(wanted.size)
    k, current = 0, -1
    c1 = c2 = c3 = step = rise = bend = 0.0
    for i in range(wanted.size):
        a = wanted[i]
        if not (angle[0] <= a <= angle[-1]):
            out[i] = np.nan
            continue
        k = _interval(angle, a, k)
        if k != current:
            current = k
            step, rise = time[k + 1] - time[k], angle[k + 1] - angle[k]
            # on the unit interval: share of the rise as a cubic of the share of the step
            c1 = rate[k] * step / rise
            c2 = 3.0 - 2.0 * c1 - rate[k + 1] * step / rise
            c3 = c1 + rate[k + 1] * step / rise - 2.0
            bend = abs(c2) + 3.0 * abs(c3)
            bend = 2.0 * bend if bend < 0.2 else 10.0
        y = (a - angle[k]) / rise
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
        out[i] = time[k] + min(max(x, low), high) * step
    return out
