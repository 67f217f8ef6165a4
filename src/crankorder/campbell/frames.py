"""Frequency frames: pieces of a recording by time, each with its speed."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.transforms import FrameTransform, frame_starts
from crankorder.fft.windows import hann
from crankorder.quantities import channel_coords
from crankorder.settings import CampbellSettings
from crankorder.shaft.angle import angle_at, knots_of


def frequency_frames(band: xr.Dataset, shaft: xr.Dataset, *, settings: CampbellSettings) -> xr.Dataset:
    """FrequencyFrames of one recording: power (channel, frame, frequency) and the speed of each frame.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle. A recording by crank angle is taken as one at constant
    speed; without a speed it has no frequencies and gives no frame. A recording shorter than
    1 / ``settings.resolution_hz`` is padded with zeros onto the same frequencies.
    """
    rate = _rate_hz(band)
    signals = np.asarray(band["signal"].values, dtype=np.float64)
    if math.isnan(rate):
        signals, rate = signals[:, :0], 2.0 * settings.max_frequency_hz
    n_fft = round(rate / settings.resolution_hz)
    window = hann(min(n_fft, max(2, signals.shape[1])))
    hop = max(1, round(len(window.values) * (1.0 - settings.overlap)))
    starts = frame_starts(signals.shape[1], len(window.values), hop)
    resolution = rate / n_fft
    highest = min(settings.max_frequency_hz, (n_fft // 2) * resolution)  # nothing is known beyond
    n_shown = math.floor(highest / settings.resolution_hz * (1 + 1e-9)) + 1
    frequency = np.arange(n_shown, dtype=np.float64) * settings.resolution_hz
    n_bins = math.ceil(frequency[-1] / resolution * (1 - 1e-9)) + 1
    spectra = FrameTransform(window, n_fft=n_fft, n_bins=n_bins).spectra(signals, starts)
    power = spectra.real**2 + spectra.imag**2
    speed = _frame_speed(band, shaft, starts, len(window.values), rate)
    if not math.isclose(resolution, settings.resolution_hz, rel_tol=1e-9):
        power = _on_grid(power, np.arange(power.shape[2], dtype=np.float64) * resolution, frequency)
    frames = _dataset(band, power, frequency, speed)
    frames.attrs = {key: band.attrs[key] for key in ("recording", "history", "quality") if key in band.attrs}
    frames.attrs |= {
        "window": window.name,
        "enbw_bins": window.enbw_bins * n_fft / len(window.values),
        "resolution_hz": settings.resolution_hz,
        "overlap": 1.0 - hop / len(window.values),
        "zero_padded": int(n_fft > len(window.values)),
    }
    return frames


def _dataset(
    band: xr.Dataset, power: NDArray[np.float64], frequency: NDArray[np.float64], speed: NDArray[np.float64]
) -> xr.Dataset:
    return xr.Dataset(
        {
            "power": (
                ("channel", "frame", "frequency"),
                power,
                {"units": "see unit, squared", "long_name": "tone power"},
            )
        },
        coords={
            **channel_coords(band),
            "frequency": ("frequency", frequency, {"units": "Hz", "long_name": "frequency"}),
            "speed": ("frame", speed, {"units": "min-1", "long_name": "mean speed of the frame"}),
        },
    )


def _rate_hz(band: xr.Dataset) -> float:
    if band.attrs["domain"] == "crank_angle":
        return float(band.attrs["samples_per_rev"]) * float(band.attrs.get("speed_rpm", math.nan)) / 60.0
    return float(band.attrs["rate_hz"])


def _frame_speed(
    band: xr.Dataset, shaft: xr.Dataset, starts: NDArray[np.int64], length: int, rate_hz: float
) -> NDArray[np.float64]:
    """Mean speed in rpm of each frame: revolutions that the shaft made over the time they took."""
    if band.attrs["domain"] == "crank_angle":
        return np.full(len(starts), float(band.attrs["speed_rpm"]))
    knots = knots_of(shaft)
    begin = float(band.attrs.get("start_s", 0.0)) + starts / rate_hz
    span = (float(shaft["time"].values[0]), float(shaft["time"].values[-1]))
    first, last = np.clip(begin, *span), np.clip(begin + length / rate_hz, *span)
    return np.asarray(60.0 * (angle_at(last, **knots) - angle_at(first, **knots)) / (last - first))


def _on_grid(
    power: NDArray[np.float64], have_hz: NDArray[np.float64], want_hz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Power interpolated linearly from frequencies ``have_hz`` onto ``want_hz``: the same bins for every recording."""
    flat = power.reshape(-1, power.shape[2])
    return np.stack([np.interp(want_hz, have_hz, row) for row in flat]).reshape(*power.shape[:2], len(want_hz))
