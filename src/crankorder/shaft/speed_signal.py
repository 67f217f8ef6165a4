"""Crank angle from a speed that comes as a signal; it has no phase reference."""

from __future__ import annotations

import numpy as np

from crankorder.errors import InputError
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import AngleKnots
from crankorder.shaft.pulses import FloatArray, Remark

NOISE_SIGMAS = 6.0
"""A sample so many standard deviations of the noise below 0 is no standing shaft."""


def integrated_speed(
    speed_rpm: FloatArray, *, rate_hz: float, settings: ShaftSettings, start_s: float = 0.0
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
    flags: list[Remark] = []
    speed = np.asarray(speed_rpm, dtype=np.float64)
    finite = np.isfinite(speed)
    n_bad = int(speed.size - finite.sum())
    if 2 * n_bad >= speed.size:
        raise InputError(
            "the speed signal is not finite", found=f"{n_bad} of {speed.size} samples", allowed="fewer than half"
        )
    if n_bad:
        flags.append(("speed_gap", "suspect", f"{n_bad} of {speed.size} speed samples are not finite and were bridged"))
        at = np.arange(speed.size)
        speed = np.interp(at, at[finite], speed[finite])
    noise_rpm = _noise(speed)
    backward = speed < -NOISE_SIGMAS * noise_rpm
    n_backward = int(backward.sum())
    if n_backward:
        flags.append(
            ("speed_negative", "suspect", f"{n_backward} of {speed.size} speed samples are below 0, taken as 0")
        )
        speed = np.where(backward, 0.0, speed)
    revs_per_s = speed / 60.0
    # of a shaft that stands, noise adds up to nothing only as long as neither side of it is cut off
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (revs_per_s[1:] + revs_per_s[:-1])) / rate_hz))
    step = 0.5 * settings.speed_lowpass_rev
    rising = np.maximum.accumulate(angle)
    at = np.unique(np.append(np.searchsorted(rising, np.arange(0.0, rising[-1], step)), speed.size - 1))
    at = at[np.append(True, np.diff(rising[at]) > 0.0)]
    if at.size < 5:
        raise InputError(
            "the shaft does not turn far enough to follow its speed",
            found=f"{angle[-1]:.3g} revolutions",
            allowed=f"{5 * step:g} revolutions or more",
            remedy="Check the unit and source of the speed signal in run.toml",
        )
    time_s = at / rate_hz
    rate = np.gradient(rising[at], time_s)
    error = noise_rpm / 60.0 * np.sqrt(np.maximum(at, 1)) / rate_hz
    knots = AngleKnots(time_s + start_s, rising[at], rate * 60.0, error, 0.5 / settings.speed_lowpass_rev, np.nan)
    return knots, flags


def _noise(speed_rpm: FloatArray) -> float:
    """Standard deviation [rpm] of white noise in ``speed_rpm`` (samples,), by how it bends from sample to sample."""
    bend = np.diff(speed_rpm, n=2)
    return float(np.sqrt(np.mean(bend**2) / 6.0)) if bend.size else 0.0
