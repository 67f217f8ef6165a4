"""Crank angle and speed, on time knots and between, with the error: from numbered pulses or a signal of the speed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from numba import njit

from crankorder.errors import InputError
from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import Remark
from crankorder.shaft.smoother import (
    HIGHEST_CUT_OFF,
    LOWEST_CUT_OFF,
    Smoother,
    cut_off_of,
    noise_from_differences,
    penalty_of,
)

# By so much an angle may lie outside the knots and still be their end: its last digits, and those of a sum of speeds.
ROUNDING_REV = 1e-9
# Interpolation between knots may err by this share of the standard error, or by ROUND_OFF_REV if that is more.
KNOT_ERROR_SHARE, ROUND_OFF_REV = 0.1, 1e-10
# Teeth from which the usual standard error is taken, and pulse times whose precision is looked at.
MEDIAN_TEETH, SOME_TIMES = 4096, 256
# Pivots of the spline's equations after which they are all alike; one cubic in so many shows what a stride may be.
SETTLED_PIVOTS, LOOKED_AT = 32, 16
# Wanted angles in one knot interval that are not worth a bound on the error of a common guess.
SHORT_RUN = 12
# Cycles per pulse that no wheel carries well: motion above this share is never promised.
CARRIED_CUT_OFF = 0.05


class AngleKnots(NamedTuple):
    """Knots of crank angle, each array (knots,): time [s], angle [rev], speed [rpm], standard error of the angle [rev].

    Between knots the angle is the cubic Hermite polynomial whose slopes are the speeds. ``cut_off_order`` is the order
    (cycles per crank revolution) above which motion is smoothed away, infinite where nothing is; ``noise_s`` the
    standard deviation of one pulse time that it rests on (NaN where there are no pulses).
    """

    time_s: Floats
    angle_rev: Floats
    speed_rpm: Floats
    standard_error_rev: Floats
    cut_off_order: float
    noise_s: float


def angle_knots(
    time_s: Floats,
    tooth: Ints,
    *,
    teeth_per_rev: float,
    noise_s: float | None,
    settings: ShaftSettings,
    smooth_times: bool = True,
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
    smooth_times : False takes the pulses as they are, where they come so unevenly (at rest) that no smoothing follows

    Returns
    -------
    AngleKnots, no more of them than cubic interpolation to a tenth of the standard error needs.
    """
    start, place = float(time_s[0]), tooth - tooth[0]
    grid, weight = time_s.astype(np.float64, copy=False) - start, np.ones(time_s.size)
    if place[-1] + 1 > place.size:  # the time of a tooth without a pulse is bridged, and weighs nothing
        grid, weight = np.interp(np.arange(place[-1] + 1), place, grid), np.zeros(place[-1] + 1)
        weight[place] = 1.0
    noise = noise_from_differences(grid[place], tooth) if noise_s is None else noise_s
    noise = max(noise, _resolution_s(time_s))
    spacing = weight.size / tooth.size
    kept = min(settings.kept_order * spacing / teeth_per_rev, CARRIED_CUT_OFF)
    floor = max(LOWEST_CUT_OFF * spacing ** (5 / 6), kept)
    cut_off, smooth, leverage = np.inf, grid, np.ones(grid.size)
    if smooth_times:
        cut_off, noise = cut_off_of(grid, weight, noise_s=noise, floor=floor, margin=settings.smoothing_margin)
        smooth, leverage = _smoothed(grid, weight, cut_off, noise)
    smooth, slope = _with_slopes(smooth)
    pulse = place[:: 1 + place.size // MEDIAN_TEETH]
    usual = noise * float(np.median(np.sqrt(leverage[pulse]) / slope[pulse + 1]))
    at = _sparse(smooth, slope, max(KNOT_ERROR_SHARE * usual, ROUND_OFF_REV * teeth_per_rev), cut_off / spacing)
    rate = 1.0 / (teeth_per_rev * slope[at])
    error_s = noise * np.sqrt(leverage[np.clip(at - 1, 0, leverage.size - 1)])
    error_s[[0, -1]] *= 2.0
    order = cut_off * teeth_per_rev / spacing if cut_off <= HIGHEST_CUT_OFF else float("inf")
    angle = (tooth[0] - 1 + at) / teeth_per_rev
    return AngleKnots(smooth[at] + start, angle, rate * 60.0, error_s * rate, order, noise)


def _resolution_s(time_s: npt.NDArray[Any]) -> float:
    """Resolution [s] of ``time_s``: the spacing of float64 there; the deviation by rounding where all are float32."""
    largest = float(max(abs(time_s[0]), abs(time_s[-1])))
    some = time_s[-SOME_TIMES:]
    if np.array_equal(some.astype(np.float32), some):
        return float(np.spacing(np.float32(largest))) / math.sqrt(12.0)
    return float(np.spacing(largest))


def _smoothed(grid: Floats, weight: Floats, cut_off: float, noise_s: float) -> tuple[Floats, Floats]:
    """Smoothed times of all teeth, and their variances over that of one pulse.

    A tooth without a pulse follows a motion as rough as the smoothed times show it, not one as rough as may be: then
    the penalty is the variance of a pulse over the power density of the third differences.
    """
    spacing = float(weight.size / weight.sum())
    smoother = Smoother(weight, penalty_of(cut_off, spacing))
    smooth, leverage = smoother.smoothed(grid), smoother.leverage()
    if spacing == 1.0:
        return smooth, leverage
    rough = spacing * float(np.mean(np.diff(smooth, n=3) ** 2))
    shown = noise_s**2 / rough if rough > 0.0 else np.inf
    smoother = Smoother(weight, max(smoother.penalty, min(shown, penalty_of(LOWEST_CUT_OFF))))
    if cut_off > HIGHEST_CUT_OFF:
        return smoother.smoothed(grid), smoother.leverage()
    return smooth, np.where(weight > 0.0, leverage, smoother.leverage())


def _with_slopes(value: Floats) -> tuple[Floats, Floats]:
    """Evenly spaced values and the slopes per step of their cubic spline, both with one step more at either end.

    The end slopes of the spline are those of the cubic through the four outermost values; beyond it goes on straight. A
    slope is raised to a third of the longest neighbouring step, so that the inverse of the cubic between any two values
    grows (Fritsch and Carlson 1980, their box); one that is not above 0 becomes infinite.
    """
    n = value.size
    out, slope = np.empty(n + 2), np.empty(n + 2)
    out[1:-1] = value
    if n < 4:
        slope[1:-1] = np.gradient(value)
    else:
        ends = np.array([-11.0, 18.0, -9.0, 2.0]) / 6.0
        slope[1], slope[n] = ends @ value[:4], -ends @ value[:-5:-1]
        share = np.zeros(SETTLED_PIVOTS)
        for i in range(1, SETTLED_PIVOTS):
            share[i] = 1.0 / (4.0 - share[i - 1])
        _spline_slopes(value, share, slope)
    for end, beside, way in ((0, 1, -1.0), (n + 1, n, 1.0)):
        out[end], slope[end] = out[beside] + way * slope[beside], slope[beside]
    for end in (0, 1, n, n + 1):
        longest = np.max(np.diff(out[max(end - 1, 0) : end + 2]))
        slope[end] = max(slope[end], longest / 3.0) if slope[end] > 0.0 else np.inf
    return out, slope


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _spline_slopes(value, share, slope):  # type: ignore[no-untyped-def]
    """Fill in ``slope`` between its outermost two, limited; ``share`` holds the pivots until they settle."""
    n, last = value.size, share.size - 1
    now = slope[1]
    for i in range(1, n - 1):
        pivot = share[i if i < last else last]
        now = 3.0 * pivot * (value[i + 1] - value[i - 1]) - pivot * now
        slope[i + 1] = now
    now = slope[n]
    for i in range(n - 2, 0, -1):
        now = slope[i + 1] - share[i if i < last else last] * now
        before, after = value[i] - value[i - 1], value[i + 1] - value[i]
        least = (before if before > after else after) / 3.0
        least = now if now > least else least
        slope[i + 1] = least if now > 0.0 else np.inf


def _sparse(time_s: Floats, slope_s: Floats, allowed_teeth: float, cut_off: float) -> Ints:
    """Which knots to keep so that cubics over the others err by no more than ``allowed_teeth``."""
    last = time_s.size - 1
    stride = 1 << max(0, int(np.log2(max(1.0, 0.1 / min(cut_off, 0.5)))))
    while 8 * stride < last and _stride_fits(time_s, slope_s, 2 * stride, LOOKED_AT, allowed_teeth):
        stride *= 2
    while stride > 1 and not _stride_fits(time_s, slope_s, stride, 1, allowed_teeth):
        stride //= 2
    return np.append(np.arange(0, last, stride), last)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz"})
def _stride_fits(time, slope, stride, every, allowed):  # type: ignore[no-untyped-def]
    """Whether cubics over every ``stride``-th knot pass within ``allowed`` teeth of all, and grow.

    Of ``every`` so many of the cubics one is looked at.
    """
    last = time.size - 1
    for k in range(0, last, stride * every):
        end = k + stride if k + stride < last else last
        step, start, first, second = time[end] - time[k], time[k], 1.0 / slope[k], 1.0 / slope[end]
        rise = (end - k) / step
        if first > 3.0 * rise or second > 3.0 * rise:
            return False
        c2 = (3.0 * rise - 2.0 * first - second) / step
        c3 = (first + second - 2.0 * rise) / (step * step)
        worst = 0.0
        for i in range(1, end - k):
            x = time[k + i] - start
            off = abs(x * (first + x * (c2 + x * c3)) - i)
            worst = off if off > worst else worst
        if worst > allowed:
            return False
    return True


def knots_of(shaft: xr.Dataset) -> dict[str, Floats]:
    """Knots of the ShaftAngle ``shaft`` as arguments of :func:`angle_at` and :func:`time_at`, each (knots,)."""
    return {
        "knot_time_s": shaft.variables["time"].values,  # not shaft["time"], which gathers coordinates at a great cost
        "knot_angle_rev": shaft.variables["crank_angle"].values,
        "knot_speed_rpm": shaft.variables["speed"].values,
    }


def angle_at(time_s: npt.ArrayLike, knot_time_s: Floats, knot_angle_rev: Floats, knot_speed_rpm: Floats) -> Floats:
    """Crank angle [rev], of the shape of ``time_s``, NaN outside the knots; fastest for rising times.

    Parameters
    ----------
    time_s : (times,), s
    knot_time_s : (knots,), s, increasing
    knot_angle_rev : (knots,), rev, increasing
    knot_speed_rpm : (knots,), rpm, 0 or more: the slopes of the cubics
    """
    return _interpolated(time_s, knot_time_s, knot_angle_rev, knot_speed_rpm, inverse=False)


def time_at(
    crank_angle_rev: npt.ArrayLike, knot_time_s: Floats, knot_angle_rev: Floats, knot_speed_rpm: Floats
) -> Floats:
    """Time [s], of the shape of ``crank_angle_rev``, of crank angles: the inverse of :func:`angle_at`.

    It is NaN outside the knots; an angle outside them by rounding, as of a frame that ends with the record, counts as
    their end.

    Parameters
    ----------
    crank_angle_rev : (angles,), rev; fastest where they grow
    knot_time_s : (knots,), s, increasing
    knot_angle_rev : (knots,), rev, increasing
    knot_speed_rpm : (knots,), rpm, 0 or more: the slopes of the cubics
    """
    angle = np.asarray(crank_angle_rev, dtype=np.float64)
    known = np.clip(angle, knot_angle_rev[0], knot_angle_rev[-1])
    angle = np.where(np.abs(angle - known) <= ROUNDING_REV, known, angle)
    return _interpolated(angle, knot_angle_rev, knot_time_s, knot_speed_rpm, inverse=True)


def _interpolated(given: npt.ArrayLike, knots: Floats, value: Floats, speed_rpm: Floats, *, inverse: bool) -> Floats:
    """``value`` where ``knots`` take the ``given`` values, whose slopes are speeds; with ``inverse`` one over these."""
    wanted = np.atleast_1d(np.asarray(given, dtype=np.float64))
    out = np.empty(wanted.size)
    if wanted.size == 0:
        return out
    first, last = np.searchsorted(knots, (wanted[0], wanted[-1]))
    part = slice(max(int(first) - 1, 0), max(int(last), int(first), 1) + 1)
    done = _cubics(wanted, knots[part], value[part], speed_rpm[part] / 60.0, inverse, out)
    if done < wanted.size:
        order = np.argsort(wanted, kind="stable")
        order = order[np.isfinite(wanted[order])]
        out[:] = np.nan
        if order.size == wanted.size and np.array_equal(order, np.arange(order.size)):
            return out  # they grow, so it is the knots that are not known
        out[order] = _interpolated(wanted[order], knots, value, speed_rpm, inverse=inverse)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _cubics(wanted, knots, value, rate, inverse, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` by the cubics between knots; how many of ``wanted`` were seen: all, if they grow.

    The share of the angle is a cubic of the share of the time in an interval. Its inverse takes a guess, the cubic with
    the inverse slopes, and two steps of Newton's method where they are sure to do for a whole interval, else one angle
    after the other.
    """
    end = 0
    while end < wanted.size and wanted[end] < knots[0]:
        out[end] = np.nan
        end += 1
    for k in range(knots.size - 1):
        first, low, high = end, knots[k], knots[k + 1]
        while end < wanted.size and low <= wanted[end] <= high:
            end += 1
        if first == end:
            continue
        run, reached = wanted[first:end], out[first:end]
        base, rise, share = value[k], value[k + 1] - value[k], 1.0 / (high - low)
        scale = rise * share if inverse else (high - low) / rise
        c1, c4 = rate[k] * scale, rate[k + 1] * scale
        c2, c3 = 3.0 - 2.0 * c1 - c4, c1 + c4 - 2.0
        g1, g2, g3 = 1.0 / c1, 3.0 - 2.0 / c1 - 1.0 / c4, 1.0 / c1 + 1.0 / c4 - 2.0
        if not inverse:
            for i in range(run.size):
                x = (run[i] - low) * share
                y = x * (c1 + x * (c2 + x * c3))
                y = y if y > 0.0 else 0.0
                reached[i] = base + rise * (y if y < 1.0 else 1.0)
        elif run.size < SHORT_RUN or not _newton_is_sure(c1, c2, c3):
            for i in range(run.size):
                reached[i] = base + rise * _share_of_step((run[i] - low) * share, c1, c2, c3)
        else:
            for i in range(run.size):
                y = (run[i] - low) * share
                x = y * (g1 + y * (g2 + y * g3))
                each = 1.0 / (c1 + x * (2.0 * c2 + 3.0 * x * c3))
                x -= (x * (c1 + x * (c2 + x * c3)) - y) * each
                x -= (x * (c1 + x * (c2 + x * c3)) - y) * each
                x = x if x > 0.0 else 0.0
                reached[i] = base + rise * (x if x < 1.0 else 1.0)
    while end < wanted.size and wanted[end] > knots[-1]:
        out[end] = np.nan
        end += 1
    return end


@njit(inline="always")
def _newton_is_sure(c1, c2, c3):  # type: ignore[no-untyped-def]
    """Whether two steps of Newton's method, the second with the slope of the first, end at round-off from the guess.

    The cubic Hermite guess errs by no more than the largest fourth derivative of the inverse over 384.
    """
    bend, twist = 2.0 * abs(c2) + 6.0 * abs(c3), 6.0 * abs(c3)
    swing = abs(c1 - 1.0) + bend
    calm = (1.0 - swing) * (1.0 - swing)
    guess = bend * (10.0 * (1.0 + swing) * twist + 15.0 * bend * bend) / (384.0 * calm * calm * calm * (1.0 - swing))
    return swing < 0.3 and bend * bend * guess * guess * guess < 1e-17


@njit(inline="always")
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
    x = x if x > low else low
    return x if x < high else high


POINTS = 33
"""Angles that are read in a stretch: rounded pulses average out over them."""

PLACES = np.linspace(-1.0, 1.0, POINTS)
PARABOLA = np.linalg.pinv(np.stack([np.ones(POINTS), PLACES, PLACES * PLACES], axis=1))
"""Matrix (3, points) from values at ``PLACES`` (points,) of a stretch to the parabola through them."""

GRID_S, STRETCH_S, STRETCH_REV, LONGEST_S = 0.05, 0.2, 4.0, 2.0
"""Step of the speeds along a recording, and the stretch that each is read over: at least so long, and so many
revolutions (two engine cycles: uneven running averages out), at most so long."""

CHANGE_S = 0.5
"""Time over which the rate of change of the speed is smoothed."""

RUNNING_SHARE, SLOWEST_RPM = 0.03, 20.0
"""Share of the highest speed, and speed, below which a shaft counts as standing."""


class SpeedCourse(NamedTuple):
    """Speed of a recording [rpm] at ``time_s``, its rate of change [rpm/s], whether the shaft turns; each (times,)."""

    time_s: Floats
    speed_rpm: Floats
    rate_rpm_per_s: Floats
    runs: Bools

    def parts(self) -> list[tuple[float, float]]:
        """Begin and end [s] of each stretch of time in which the shaft turns."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.runs, [False]])))
        return [(float(self.time_s[a]), float(self.time_s[b - 1])) for a, b in edges.reshape(-1, 2) if b - a > 1]


def smoothed_speed(shaft: xr.Dataset, time_s: Floats, stretch_s: Floats | float) -> Floats:
    """Speed [rpm] at ``time_s`` (times,): slope of the parabola through the angle over ``stretch_s`` around each.

    ``shaft`` is a ShaftAngle by time. The stretch (times,) is cut at the ends of the record, where the slope of the
    parabola is still that at ``time_s``. A single pulse has little influence on it, unlike on the slope between two
    knots.
    """
    known = shaft.variables["time"].values
    time_s = np.asarray(time_s, dtype=np.float64)
    half = 0.5 * np.broadcast_to(np.asarray(stretch_s, dtype=np.float64), time_s.shape)
    low, high = np.maximum(time_s - half, known[0]), np.minimum(time_s + half, known[-1])
    centre, reach = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-12)
    at = np.clip(centre[:, None] + reach[:, None] * PLACES, known[0], known[-1])
    angle = angle_at(at.ravel(), **knots_of(shaft)).reshape(at.shape)
    angle -= angle[:, POINTS // 2, None]
    _, slope, bend = (angle @ PARABOLA.T).T
    return np.asarray(60.0 * (slope + 2.0 * bend * (time_s - centre) / reach) / reach)


def speed_at_angle(shaft: xr.Dataset, angle_rev: Floats, stretch_rev: Floats | float) -> Floats:
    """Speed [rpm] (angles,) at ``angle_rev`` (angles,) of the ShaftAngle ``shaft``, over ``stretch_rev`` around each.

    ``stretch_rev``, one or (angles,), is in revolutions; the speed is that of :func:`smoothed_speed` over the time that
    it takes.
    """
    knots = knots_of(shaft)
    first, last = knots["knot_angle_rev"][[0, -1]]
    half = 0.5 * np.asarray(stretch_rev, dtype=np.float64)
    begin, middle, end = (time_at(np.clip(angle_rev + side * half, first, last), **knots) for side in (-1.0, 0.0, 1.0))
    return smoothed_speed(shaft, middle, end - begin)


def speed_course(shaft: xr.Dataset) -> SpeedCourse:
    """SpeedCourse of the ShaftAngle ``shaft`` by time, in steps of 0.05 s (fewer than that where it is shorter)."""
    first, last = shaft.variables["time"].values[[0, -1]]
    count = max(4, math.floor((last - first) / GRID_S) + 1)
    at = np.linspace(first, last, count)
    rough = np.maximum(smoothed_speed(shaft, at, STRETCH_S), 1e-9)
    speed = smoothed_speed(shaft, at, np.clip(60.0 * STRETCH_REV / rough, STRETCH_S, LONGEST_S))
    step = float(at[1] - at[0])
    change = np.abs(np.gradient(speed, step))
    length = 2 * max(1, round(0.5 * CHANGE_S / step)) + 1
    window = np.hanning(length + 2)[1:-1]
    padded = np.pad(change, length // 2, mode="edge")
    rate = np.convolve(padded, window / window.sum(), mode="valid")
    runs = speed > max(SLOWEST_RPM, RUNNING_SHARE * float(speed.max()))
    return SpeedCourse(at, np.maximum(speed, 1e-9), rate, runs)


NOISE_SIGMAS = 6.0
"""A sample so many standard deviations of the noise below 0 is no standing shaft."""


def integrated_speed(
    speed_rpm: Floats, *, rate_hz: float, settings: ShaftSettings, start_s: float = 0.0
) -> tuple[AngleKnots, list[Remark]]:
    """Knots of crank angle, 0 at the first sample, from the integral of a speed signal, and remarks.

    The integral itself is not smoothed, so the angle has no bias; the speed at a knot is the mean between its
    neighbours, half of ``speed_lowpass_rev`` away on either side.

    Parameters
    ----------
    speed_rpm : (samples,), rpm, crank speed; samples that are not finite are bridged and flagged
    rate_hz : samples per second
    settings : ``speed_lowpass_rev`` is the length over which speed is smoothed, revolutions
    start_s : time of the first sample, s

    Raises
    ------
    InputError where the shaft does not turn through two such lengths or more than half of the samples are not finite.
    """
    flags, speed = list[Remark](), np.asarray(speed_rpm, dtype=np.float64)
    finite = np.isfinite(speed)
    n_bad = int(speed.size - finite.sum())
    if 2 * n_bad >= speed.size:
        found = f"{n_bad} of {speed.size} samples"
        raise InputError("the speed signal is not finite", found=found, allowed="fewer than half")
    if n_bad:
        flags.append(("speed_gap", "suspect", f"{n_bad} of {speed.size} speed samples are not finite and were bridged"))
        at = np.arange(speed.size)
        speed = np.interp(at, at[finite], speed[finite])
    bend = np.diff(speed, n=2)
    noise_rpm = float(np.sqrt(np.mean(bend**2) / 6.0)) if bend.size else 0.0
    backward = speed < -NOISE_SIGMAS * noise_rpm
    if backward.any():
        detail = f"{backward.sum()} of {speed.size} speed samples are below 0, taken as 0"
        flags.append(("speed_negative", "suspect", detail))
        speed = np.where(backward, 0.0, speed)
    revs_per_s = speed / 60.0
    # of a shaft that stands, noise adds up to nothing only as long as neither side of it is cut off
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (revs_per_s[1:] + revs_per_s[:-1])) / rate_hz))
    step = 0.5 * settings.speed_lowpass_rev
    rising = np.maximum.accumulate(angle)
    at = np.unique(np.append(np.searchsorted(rising, np.arange(0.0, rising[-1], step)), speed.size - 1))
    at = at[np.append(True, np.diff(rising[at]) > 0.0)]
    if at.size < 5:
        problem = "the shaft does not turn far enough to follow its speed"
        remedy = "Check the unit and source of the speed signal in run.toml"
        allowed = f"{5 * step:g} revolutions or more"
        raise InputError(problem, found=f"{angle[-1]:.3g} revolutions", allowed=allowed, remedy=remedy)
    time_s = at / rate_hz
    rate = np.gradient(rising[at], time_s)
    error = noise_rpm / 60.0 * np.sqrt(np.maximum(at, 1)) / rate_hz
    knots = AngleKnots(time_s + start_s, rising[at], rate * 60.0, error, 0.5 / settings.speed_lowpass_rev, np.nan)
    return knots, flags
