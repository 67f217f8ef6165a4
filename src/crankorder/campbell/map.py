"""Campbell map: the power spectra of all frames of a test, averaged at like speed."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.quantities import QualityFlag, channel_coords, flags_of, with_flags
from crankorder.shaft.speed_groups import speed_groups


def campbell_map(frames: list[xr.Dataset], *, speed_bin_rpm: float) -> xr.Dataset:
    """CampbellMap of a test from the FrequencyFrames of its recordings.

    Of all ``frames``, those whose speeds differ by less than ``speed_bin_rpm`` are averaged by energy. ``amplitude``
    is the peak of a tone wherever it lies between two bins (the energy of three bins of a Hann window), so that an
    order line does not fade at every other speed; ``psd`` is the one-sided power spectral density.
    """
    frames = [item for item in frames if item.sizes["frame"]] or frames[:1]
    n_bins = min(item.sizes["frequency"] for item in frames)
    power = np.concatenate([item["power"].values[..., :n_bins] for item in frames], axis=1)
    tone = np.concatenate([_tone_power(item)[..., :n_bins] for item in frames], axis=1)
    speed = np.concatenate([item["speed"].values for item in frames])
    enbw_hz = np.concatenate(
        [np.full(item.sizes["frame"], item.attrs["enbw_bins"] * item.attrs["resolution_hz"]) for item in frames]
    )
    groups = speed_groups(speed, width_rpm=speed_bin_rpm)
    density = power / (2.0 * enbw_hz[None, :, None])
    first = frames[0]
    result = xr.Dataset(
        coords={
            **channel_coords(first),
            "frequency": first["frequency"][:n_bins],
            "speed": (
                "speed",
                np.array([speed[group].mean() for group in groups]),
                {"units": "min-1", "long_name": "speed"},
            ),
        }
    )
    dims = ("channel", "speed", "frequency")
    amplitude = np.sqrt(_group_means(tone, groups))
    result["amplitude"] = (dims, amplitude, {"units": "see unit", "long_name": "peak amplitude of a tone"})
    psd = _group_means(density, groups)
    result["psd"] = (dims, psd, {"units": "see unit, squared per Hz", "long_name": "power spectral density"})
    counts = np.array([len(group) for group in groups], dtype=np.int64)
    result["n_frames"] = (("speed",), counts, {"units": "1", "long_name": "frames averaged"})
    result.attrs = {
        "window": first.attrs["window"],
        "enbw_hz": max(item.attrs["enbw_bins"] * item.attrs["resolution_hz"] for item in frames),
        "resolution_hz": first.attrs["resolution_hz"],
        "amplitude_scaling": "peak",
        "speed_bin_rpm": speed_bin_rpm,
    }
    flags = [flag for item in frames for flag in flags_of(item)]
    return with_flags(result, flags + _cut_flags(frames, n_bins))


def _cut_flags(frames: list[xr.Dataset], n_bins: int) -> list[QualityFlag]:
    """Remark on the recording whose sample rate ends the map, where others reach further."""
    lowest = min(frames, key=lambda item: int(item.sizes["frequency"]))
    if all(item.sizes["frequency"] == n_bins for item in frames):
        return []
    ends = float(lowest["frequency"].values[-1])
    return [
        {
            "recording": str(lowest.attrs["recording"]),
            "flag": "map_cut",
            "severity": "info",
            "detail": f"its sample rate ends the map of the whole test at {ends:g} Hz",
        }
    ]


def _group_means(values: NDArray[np.float64], groups: list[NDArray[np.int64]]) -> NDArray[np.float64]:
    """Means (channels, groups, bins) of ``values`` (channels, frames, bins) over the frames of each group."""
    if not groups:
        return values[:, :0]
    return np.stack([values[:, group].mean(axis=1) for group in groups], axis=1)


def _tone_power(frames: xr.Dataset) -> NDArray[np.float64]:
    """Power of a tone near each bin: the energy of three bins over the noise bandwidth of the window.

    For a Hann window this is true to 0.1 dB wherever the tone lies (0.25 dB after interpolation onto the frequencies
    of the test); a zero-padded spectrum needs no such sum.
    """
    power = frames["power"].values
    if int(frames.attrs["zero_padded"]):
        return np.asarray(power)
    total = power.copy()
    total[..., 1:] += power[..., :-1]
    total[..., :-1] += power[..., 1:]
    return np.asarray(total / float(frames.attrs["enbw_bins"]))
