"""Order frames: whole engine cycles of a recording, resampled by crank angle and transformed."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import InputError
from crankorder.fft.resampling import PASS_BAND, margin, values_at
from crankorder.fft.transforms import FrameTransform, frame_starts
from crankorder.fft.windows import hann
from crankorder.quantities import QualityFlag, channel_coords, flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import angle_at, knots_of, time_at


def order_frames(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """OrderFrames of one recording: complex spectra (channel, frame, order), phases from top dead centre.

    ``band`` is the BandRecording, by time or by crank angle; ``shaft`` its ShaftAngle. A frame holds
    ``settings.revs_per_frame`` rounded down to whole cycles, fewer (flagged) where the recording is shorter. Orders
    that the sample rate cannot carry at a frame's speed are NaN.
    Raises InputError where not even one cycle was recorded.
    """
    cycle = int(shaft.attrs["revs_per_cycle"])
    signals, angles = _by_angle(band, shaft, settings.max_order)
    samples_per_rev = round(1.0 / (angles[1] - angles[0])) if len(angles) > 1 else 0
    held = len(angles) // samples_per_rev if samples_per_rev else 0
    revs = min(settings.revs_per_frame, held) // cycle * cycle
    if revs == 0:
        raise InputError(
            "the recording holds less than one engine cycle",
            file=band.attrs["recording"],
            found=f"{held} whole revolutions",
            allowed=f"at least {cycle}",
        )
    window = hann(revs * samples_per_rev)
    hop = max(1, round(revs * (1.0 - settings.overlap))) * samples_per_rev
    starts = frame_starts(len(angles), len(window.values), hop)
    transform = FrameTransform(window, n_bins=math.floor(settings.max_order * revs) + 1)
    spectrum = transform.spectra(signals, starts)
    order = np.arange(spectrum.shape[2]) / revs
    start_angle = angles[starts]
    spectrum *= np.exp(-2j * np.pi * np.outer(start_angle, order))[None]
    speed = _mean_speed(shaft, start_angle, start_angle + revs)
    _blank_beyond_rate(spectrum, order, speed, band)
    frames = _dataset(band, shaft, spectrum, order, speed, start_angle)
    frames.attrs |= {
        "window": window.name,
        "enbw_bins": window.enbw_bins,
        "revs_per_frame": revs,
        "overlap": 1.0 - hop / len(window.values),
    }
    return with_flags(frames, [*flags_of(shaft), *_flags(band, revs, settings, cycle)])


def _by_angle(band: xr.Dataset, shaft: xr.Dataset, max_order: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signals (channels, samples) and their uniform crank angles (samples,) in rev, beginning at a whole revolution."""
    signals = band["signal"].values
    if band.attrs["domain"] == "crank_angle":
        samples_per_rev = int(band.attrs["samples_per_rev"])
        first = float(shaft["crank_angle"].values[0])
        skip = math.ceil((math.ceil(first - 1e-9) - first) * samples_per_rev - 1e-6)
        angles = first + (skip + np.arange(signals.shape[1] - skip)) / samples_per_rev
        return np.asarray(signals[:, skip:], dtype=np.float64), angles
    rate, start = float(band.attrs["rate_hz"]), float(band.attrs.get("start_s", 0.0))
    knots = knots_of(shaft)
    inside = np.array([start + margin() / rate, start + (signals.shape[1] - 1 - margin()) / rate])
    inside = np.clip(inside, knots["knot_time_s"][0], knots["knot_time_s"][-1])
    first_rev, last_rev = angle_at(inside, **knots)
    begin, count = math.ceil(first_rev), math.floor(last_rev) - math.ceil(first_rev)
    if count < 1:
        return signals[:, :0], np.empty(0)
    slowest_hz = 1.0 / max(1e-9, float(np.diff(time_at(begin + np.arange(count + 1.0), **knots)).max()))
    samples_per_rev = _samples_per_rev(rate, slowest_hz, max_order)
    angles = begin + np.arange(count * samples_per_rev) / samples_per_rev
    return values_at(signals, (time_at(angles, **knots) - start) * rate), angles


def _samples_per_rev(rate_hz: float, slowest_hz: float, max_order: float) -> int:
    """Samples per revolution such that nothing in the record folds onto an order shown, and fast to transform.

    The resampling kernel lets pass what lies below PASS_BAND of the rate, and fades out its image by 1 - PASS_BAND.
    """
    least = math.ceil(max((1.0 - PASS_BAND) * rate_hz / slowest_hz + max_order, 2.0 * max_order)) + 2
    while not _is_smooth(least):
        least += 1
    return least


def _is_smooth(number: int) -> bool:
    for prime in (2, 3, 5):
        while number % prime == 0:
            number //= prime
    return number == 1


def _mean_speed(shaft: xr.Dataset, begin: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean speed in rpm between crank angles: revolutions over elapsed time."""
    if shaft.attrs.get("domain", "time") == "crank_angle":
        return np.full(len(begin), float(shaft["speed"].values.mean()))
    elapsed = time_at(end, **knots_of(shaft)) - time_at(begin, **knots_of(shaft))
    return np.asarray(60.0 * (end - begin) / elapsed)


def _blank_beyond_rate(
    spectrum: NDArray[np.complex128], order: NDArray[np.float64], speed: NDArray[np.float64], band: xr.Dataset
) -> None:
    """Set to NaN the orders that the sample rate of ``band`` does not carry at the speed of each frame."""
    if band.attrs["domain"] == "crank_angle":
        highest = np.full(len(speed), 0.5 * float(band.attrs["samples_per_rev"]))
    else:
        highest = PASS_BAND * float(band.attrs["rate_hz"]) * 60.0 / speed
    for frame, limit in enumerate(highest):
        spectrum[:, frame, order > limit] = np.nan


def _dataset(
    band: xr.Dataset,
    shaft: xr.Dataset,
    spectrum: NDArray[np.complex128],
    order: NDArray[np.float64],
    speed: NDArray[np.float64],
    start_angle: NDArray[np.float64],
) -> xr.Dataset:
    frames = xr.Dataset(
        {
            "spectrum": (
                ("channel", "frame", "order"),
                spectrum,
                {"units": "see unit", "long_name": "complex peak amplitude by order"},
            )
        },
        coords={
            **channel_coords(band),
            "order": ("order", order, {"units": "1", "long_name": "order", "order_reference": "crankshaft"}),
            "speed": ("frame", speed, {"units": "min-1", "long_name": "mean speed of the frame"}),
            "crank_angle": ("frame", start_angle, {"units": "rev", "long_name": "crank angle at the start"}),
        },
    )
    kept = ("recording", "history", "quality", "samples_per_rev")
    frames.attrs = {key: band.attrs[key] for key in kept if key in band.attrs}
    frames.attrs |= {
        "amplitude_scaling": "peak",
        "phase_reference": shaft.attrs["phase_reference"],
        "cycle_known": shaft.attrs["cycle_known"],
        "revs_per_cycle": shaft.attrs["revs_per_cycle"],
    }
    return frames


def _flags(band: xr.Dataset, revs: int, settings: OrderSettings, cycle: int) -> list[QualityFlag]:
    if revs >= settings.revs_per_frame // cycle * cycle:
        return []
    return [
        {
            "recording": band.attrs["recording"],
            "flag": "short_recording",
            "severity": "info",
            "detail": f"frames of {revs} instead of {settings.revs_per_frame} revolutions",
        }
    ]
