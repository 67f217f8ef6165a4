"""Speeds of frames by time, how far they change within a frame, and how long a frame may be for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.shaft.angle import angle_at, knots_of

RUNNING_SHARE = 0.9
"""Share of the frames whose speed changes less than the one that sets the length: a start or stop sets nothing."""


@dataclass(frozen=True)
class FrameSpeeds:
    """Mean speed and change of speed from begin to end of each frame (frames,), in rpm."""

    mean_rpm: NDArray[np.float64]
    change_rpm: NDArray[np.float64]


def frame_speeds(
    band: xr.Dataset, shaft: xr.Dataset, starts: NDArray[np.int64], length: int, rate_hz: float
) -> FrameSpeeds:
    """FrameSpeeds of the frames of ``length`` samples at ``rate_hz`` that begin at samples ``starts`` of ``band``.

    The mean is the revolutions that the ``shaft`` made over the time they took; the change is twice the difference of
    the means of both halves, which uneven running within a cycle does not reach.
    """
    if band.attrs["domain"] == "crank_angle":
        return FrameSpeeds(np.full(len(starts), float(band.attrs.get("speed_rpm", math.nan))), np.zeros(len(starts)))
    begin = float(band.attrs.get("start_s", 0.0)) + starts / rate_hz
    return _speeds(shaft, begin, length / rate_hz)


def _speeds(shaft: xr.Dataset, begin_s: NDArray[np.float64], length_s: float) -> FrameSpeeds:
    knots = knots_of(shaft)
    span = (float(shaft["time"].values[0]), float(shaft["time"].values[-1]))
    first, middle, last = (np.clip(begin_s + share * length_s, *span) for share in (0.0, 0.5, 1.0))
    angles = [angle_at(times, **knots) for times in (first, middle, last)]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = 60.0 * (angles[2] - angles[0]) / (last - first)
        halves = 60.0 * (angles[2] - angles[1]) / (last - middle) - 60.0 * (angles[1] - angles[0]) / (middle - first)
    return FrameSpeeds(np.asarray(mean), np.nan_to_num(2.0 * halves, posinf=0.0, neginf=0.0))


def sweep_limit_s(band: xr.Dataset, shaft: xr.Dataset, length_s: float, *, enbw_bins: float, order: float) -> float:
    """Length in s of a frame in which ``order`` sweeps just over the noise bandwidth; infinite at constant speed.

    Longer frames would smear the line of ``order``, shorter ones would widen it: T = sqrt(B / s) with the noise
    bandwidth B in bins (``enbw_bins``) and the sweep s of the order in Hz/s. The sweep is that of the ``shaft`` of
    ``band`` over frames of ``length_s``, of which the tenth that sweeps most is left out.
    """
    if band.attrs["domain"] == "crank_angle" or not length_s > 0.0:
        return math.inf
    first, last = float(shaft["time"].values[0]), float(shaft["time"].values[-1])
    begin = np.arange(first, max(first + 1e-12, last - length_s * (1 - 1e-9)), 0.5 * length_s)
    change_hz = np.abs(_speeds(shaft, begin, min(length_s, last - first)).change_rpm) / 60.0
    sweep = order * float(np.quantile(change_hz, RUNNING_SHARE)) / length_s
    return math.sqrt(enbw_bins / sweep) if sweep > 0.0 else math.inf
