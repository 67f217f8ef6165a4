"""Speed of the shaft as the slope of its angle over a stretch of time, and how it changes along a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.shaft.angle import angle_at, knots_of, time_at

POINTS = 33
"""Angles that are read in a stretch: rounded pulses average out over them."""

GRID_S, STRETCH_S, STRETCH_REV, LONGEST_S = 0.05, 0.2, 4.0, 2.0
"""Step of the speeds along a recording, and the stretch that each is read over: at least so long, and so many
revolutions (two engine cycles: uneven running averages out), at most so long."""

CHANGE_S = 0.5
"""Time over which the rate of change of the speed is smoothed."""

RUNNING_SHARE, SLOWEST_RPM = 0.03, 20.0
"""Share of the highest speed, and speed, below which a shaft counts as standing."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpeedCourse:
    """Speed [rpm] of a recording at ``time_s``, its rate of change [rpm/s], and whether the shaft turns (times,)."""

    time_s: Array
    speed_rpm: Array
    rate_rpm_per_s: Array
    runs: NDArray[np.bool_]

    def parts(self) -> list[tuple[float, float]]:
        """Begin and end [s] of each stretch of time in which the shaft turns."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.runs, [False]])))
        return [(float(self.time_s[a]), float(self.time_s[b - 1])) for a, b in edges.reshape(-1, 2) if b - a > 1]


def smoothed_speed(shaft: xr.Dataset, time_s: Array, stretch_s: Array | float) -> Array:
    """Speed [rpm] at ``time_s`` (times,): slope of the parabola through the angle over ``stretch_s`` around each.

    ``shaft`` is a ShaftAngle by time. The stretch (times,) is cut at the ends of the record, where the slope of the
    parabola is still that at ``time_s``. No single pulse says much of it, unlike of the slope between two knots.
    """
    known = shaft["time"].values
    time_s = np.asarray(time_s, dtype=np.float64)
    half = 0.5 * np.broadcast_to(np.asarray(stretch_s, dtype=np.float64), time_s.shape)
    low, high = np.maximum(time_s - half, known[0]), np.minimum(time_s + half, known[-1])
    u = np.linspace(-1.0, 1.0, POINTS)
    centre, reach = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-12)
    at = np.clip(centre[:, None] + reach[:, None] * u, known[0], known[-1])
    angle = angle_at(at.ravel(), **knots_of(shaft)).reshape(at.shape)
    angle -= angle[:, POINTS // 2, None]
    fit = np.linalg.pinv(np.stack([np.ones(POINTS), u, u * u], axis=1))
    _, slope, bend = (angle @ fit.T).T
    return np.asarray(60.0 * (slope + 2.0 * bend * (time_s - centre) / reach) / reach)


def speed_at_angle(shaft: xr.Dataset, angle_rev: Array, stretch_rev: Array | float) -> Array:
    """Speed [rpm] at ``angle_rev`` (angles,) of ``shaft``, over the time that ``stretch_rev`` around each takes."""
    knots = knots_of(shaft)
    first, last = knots["knot_angle_rev"][[0, -1]]
    half = 0.5 * np.asarray(stretch_rev, dtype=np.float64)
    begin, middle, end = (time_at(np.clip(angle_rev + side * half, first, last), **knots) for side in (-1.0, 0.0, 1.0))
    return smoothed_speed(shaft, middle, end - begin)


def speed_course(shaft: xr.Dataset) -> SpeedCourse:
    """SpeedCourse of the ShaftAngle ``shaft`` by time, in steps of 0.05 s (fewer than that where it is shorter)."""
    first, last = shaft["time"].values[[0, -1]]
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
