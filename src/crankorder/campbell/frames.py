"""Frequency frames: pieces of a recording by time, each with its speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.decimation import band_limited, decimation_factor
from crankorder.fft.transforms import FrameTransform, frame_starts, whole_frames
from crankorder.fft.windows import Window, power_of_two, window_named
from crankorder.quantities import Floats, Ints, QualityFlag, channel_coords, described, remark, unindexed, with_flags
from crankorder.settings import CampbellSettings, MethodNumbers
from crankorder.shaft.angle import angle_at, knots_of

NUMBERS = MethodNumbers("4-campbell-map.toml", "frames")


def sample_rate_hz(recording: xr.Dataset) -> float:
    """Samples per second of a ``recording`` (channel, time or crank_angle); NaN where it is not known.

    One by crank angle has the rate of its constant speed, where that is stated.
    """
    if recording.attrs["domain"] == "crank_angle":
        return float(recording.attrs["samples_per_rev"]) * float(recording.attrs.get("speed_rpm", math.nan)) / 60.0
    return float(recording.attrs.get("rate_hz", math.nan))


def frame_speeds(
    band: xr.Dataset, shaft: xr.Dataset, starts: Ints, length: int, rate_hz: float
) -> tuple[Floats, Floats]:
    """Mean speed (frames,) and its change from begin to end (frames,), both in rpm, of frames of ``band``.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle. Frames have ``length`` samples at ``rate_hz`` and begin at
    the samples ``starts`` (frames,). The mean is revolutions over time; the change is twice the difference of the means
    of both halves, which uneven running within a cycle does not affect.
    """
    if band.attrs["domain"] == "crank_angle":
        return np.full(len(starts), float(band.attrs.get("speed_rpm", math.nan))), np.zeros(len(starts))
    begin = float(band.attrs.get("start_s", 0.0)) + starts / rate_hz
    return _speeds(shaft, begin, length / rate_hz)


def piece_speeds(recording: xr.Dataset, shaft: xr.Dataset, starts: Ints, length: int, rate_hz: float) -> Floats:
    """Mean speed [rpm] (pieces,) of pieces of a recording; NaN where it is not known, or the shaft does not turn on.

    ``recording`` is a Recording, ``shaft`` its ShaftAngle; ``starts`` (pieces,) are the first samples, at ``rate_hz``,
    of the pieces, each ``length`` samples long. The mean is that of :func:`frame_speeds`.
    """
    rpm = np.full(len(starts), np.nan)
    by_angle = recording.attrs["domain"] == "crank_angle"
    if len(starts) and shaft.attrs.get("has_shaft", 1) and (by_angle or shaft["time"].size):
        rpm, _ = frame_speeds(recording, shaft, starts, length, rate_hz)
    return np.where(rpm > 0.0, rpm, np.nan)


def _speeds(shaft: xr.Dataset, begin_s: Floats, length_s: float) -> tuple[Floats, Floats]:
    knots = knots_of(shaft)
    span = (float(shaft["time"].values[0]), float(shaft["time"].values[-1]))
    first, middle, last = (np.clip(begin_s + share * length_s, *span) for share in (0.0, 0.5, 1.0))
    angles = [angle_at(times, **knots) for times in (first, middle, last)]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = 60.0 * (angles[2] - angles[0]) / (last - first)
        halves = 60.0 * (angles[2] - angles[1]) / (last - middle) - 60.0 * (angles[1] - angles[0]) / (middle - first)
    return np.asarray(mean), np.nan_to_num(2.0 * halves, posinf=0.0, neginf=0.0)


def sweep_limit_s(band: xr.Dataset, shaft: xr.Dataset, length_s: float, *, enbw_bins: float, order: float) -> float:
    """Length in s of a frame in which ``order`` just sweeps over the noise bandwidth; infinite at constant speed.

    Longer frames would smear the line of ``order``, shorter ones would widen it: T = sqrt(B / s) with the noise
    bandwidth B in bins (``enbw_bins``) and the sweep s of the order in Hz/s. The sweep is that of the ShaftAngle
    ``shaft`` (time) of the BandRecording ``band`` over frames of ``length_s``; the tenth that sweeps most is left out.
    """
    if band.attrs["domain"] == "crank_angle" or not length_s > 0.0:
        return math.inf
    first, last = float(shaft["time"].values[0]), float(shaft["time"].values[-1])
    begin = np.arange(first, max(first + 1e-12, last - length_s * (1 - 1e-9)), 0.5 * length_s)
    change_hz = np.abs(_speeds(shaft, begin, min(length_s, last - first))[1]) / 60.0
    sweep = order * float(np.quantile(change_hz, NUMBERS.running_share)) / length_s
    return math.sqrt(enbw_bins / sweep) if sweep > 0.0 else math.inf


@dataclass(frozen=True)
class FramePlan:
    """Window, transform length and hop, in samples, of the frames of a recording.

    ``spacing`` bins of the transform make one bin of the unpadded window; it is 0 where the whole record is one frame.
    ``tone_weights`` are those of :attr:`~crankorder.fft.windows.Window.tone_weights`.
    """

    window: Window
    n_fft: int
    hop: int
    spacing: int
    tone_weights: tuple[float, float]


def frequency_frames(band: xr.Dataset, shaft: xr.Dataset, *, settings: CampbellSettings) -> xr.Dataset:
    """FrequencyFrames of one recording: power (channel, frame, frequency) and the speed of each frame.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle. A recording by crank angle is taken as one at constant
    speed; without a speed it has no frequencies and gives no frame. One of a structure that does not turn has frames of
    unknown speed (NaN). A recording shorter than
    1 / ``settings.resolution_hz`` is padded with zeros; where the speed sweeps, frames are a whole number of times
    shorter and padded to the length that the resolution asks for. Frames that touch an unusable sample are NaN in
    that channel. Float32 signals give float32 power.
    """
    shown_hz, grid_hz = settings.max_frequency_hz, settings.resolution_hz
    by_time = band.attrs["domain"] == "time"
    if by_time and decimation_factor(float(band.attrs["rate_hz"]), shown_hz, grid_hz=grid_hz) > 1:
        band = band_limited(band, band_hz=shown_hz, grid_hz=grid_hz)  # orders needed more of it than is shown
    rate, signals = sample_rate_hz(band), band["signal"].values
    if math.isnan(rate):
        signals, rate = signals[:, :0], 2.0 * settings.max_frequency_hz
    plan = frame_plan(band, shaft, n_samples=signals.shape[1], rate_hz=rate, settings=settings)
    length = len(plan.window.values)
    starts = frame_starts(signals.shape[1], length, plan.hop)
    resolution = rate / plan.n_fft
    # nothing is known beyond half of the rate
    highest_hz = min(settings.max_frequency_hz, (plan.n_fft // 2) * resolution)
    n_bins = math.ceil(highest_hz / resolution * (1 - 1e-9)) + 1 + plan.spacing
    scales = _scales(signals)
    power = FrameTransform(plan.window, n_fft=plan.n_fft, n_bins=n_bins).power(signals, starts, scales=scales)
    if "usable" in band:
        power[~whole_frames(band["usable"].values, starts, length)] = np.nan
    speed_rpm, change_rpm = frame_speeds(band, shaft, starts, length, rate)
    if not shaft.attrs.get("has_shaft", 1):
        speed_rpm, change_rpm = np.full(len(starts), np.nan), np.zeros(len(starts))
    variables = {
        "power": described(("channel", "frame", "frequency"), power, "see unit, squared", "tone power"),
        "speed_change": described("frame", change_rpm, "min-1", "change of speed within the frame"),
    }
    if np.any(scales != 1.0):
        variables["scale"] = described("channel", scales, "1", "power is that of the signal times this")
    frequency = np.arange(power.shape[2], dtype=np.float64) * resolution
    coords = unindexed(
        **channel_coords(band),
        frequency=described("frequency", frequency, "Hz", "frequency"),
        speed=described("frame", speed_rpm, "min-1", "mean speed of the frame"),
    )
    frames = xr.Dataset(variables, coords=coords)
    frames.attrs = {key: band.attrs[key] for key in ("recording", "history", "quality") if key in band.attrs}
    frames.attrs |= {
        "window": plan.window.name,
        "enbw_bins": plan.window.enbw_bins * plan.n_fft / length,
        "resolution_hz": resolution,
        "grid_hz": settings.resolution_hz,
        "highest_hz": highest_hz,
        "rate_hz": rate,
        "overlap": 1.0 - plan.hop / length,
        "amplitude_scaling": settings.amplitude_scaling,
        "tone_weight": plan.tone_weights[0],
        "tone_neighbour_weight": plan.tone_weights[1],
        "tone_spacing_bins": plan.spacing,
        "sweep_hz_per_order": float(np.nanmax(np.abs(change_rpm), initial=0.0)) / 60.0,
    }
    return with_flags(frames, _sweep_flags(frames, settings))


def frame_plan(
    band: xr.Dataset, shaft: xr.Dataset, *, n_samples: int, rate_hz: float, settings: CampbellSettings
) -> FramePlan:
    """FramePlan for the BandRecording ``band`` (channel, time or crank_angle) of ``n_samples`` at ``rate_hz``.

    ``shaft`` is its ShaftAngle, ``settings`` are those of the Campbell map.

    Frames are as long as ``settings.resolution_hz`` asks for, or the whole record, or, where the order
    ``settings.sweep_order`` would sweep further than the noise bandwidth, a whole number of times shorter.
    """
    whole = round(rate_hz / settings.resolution_hz)
    held = max(2, n_samples)
    enbw_bins, asked_s = _window(settings, 64).enbw_bins, min(whole, held) / rate_hz
    limit_s = sweep_limit_s(band, shaft, asked_s, enbw_bins=enbw_bins, order=settings.sweep_order)
    # a quarter more than the limit is nearer to it than the next whole number of times
    times = max(1, math.ceil(whole / (limit_s * rate_hz) - 0.25)) if math.isfinite(limit_s) else 1
    times = next((n for n in range(times, int(1.25 * times) + 1) if whole % n == 0), times)
    if held < whole // times:
        window = _window(settings, held)
        times = -(-NUMBERS.padding * held // whole)
        weights = (window.response(np.array([0.0, 0.5 * held / (times * whole)])).prod() ** -1.0, 0.0)
        return FramePlan(window, times * whole, held, 0, weights)
    length = max(2, whole // times)
    window = _window(settings, length)
    hop = max(1, round(length * (1.0 - settings.overlap)))
    # the weights are a matter of the window's shape, so a short one serves all lengths
    return FramePlan(window, length * times, hop, times, _window(settings, 1024).tone_weights)


def _window(settings: CampbellSettings, n_samples: int) -> Window:
    return window_named(settings.window, n_samples, kaiser_beta=settings.kaiser_beta)


def _scales(signals: NDArray[np.floating]) -> Floats:
    """Power of two per channel that brings samples whose squares leave the range of their type near 1; else 1."""
    fit, limit = (1e8, 2.0**120) if signals.dtype == np.float32 else (1e100, 2.0**1000)
    largest = power_of_two(signals).ravel()
    fits = (1.0 / fit <= largest) & (largest <= fit)
    return np.where(fits, 1.0, 1.0 / np.clip(largest, 1.0 / limit, limit))


def _sweep_flags(frames: xr.Dataset, settings: CampbellSettings) -> list[QualityFlag]:
    """Remark where even short frames smear a line over twice the noise bandwidth."""
    swept_hz = settings.sweep_order * float(frames.attrs["sweep_hz_per_order"])
    enbw_hz = float(frames.attrs["enbw_bins"]) * float(frames.attrs["resolution_hz"])
    if swept_hz <= 2.0 * enbw_hz:
        return []
    swept = f"order {settings.sweep_order:g} sweeps over {swept_hz:.3g} Hz"
    detail = f"within a frame the speed changes so far that {swept}, more than the noise bandwidth of {enbw_hz:.3g} Hz"
    return [remark(frames.attrs["recording"], "swept_lines", f"{detail}: its line reads low")]
