"""Campbell map: the power spectra of all frames of a test, averaged at like speed."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.quantities import Floats, Ints, Variables, channel_coords, described, flags_of, remark, with_flags
from crankorder.settings import MethodNumbers
from crankorder.shaft.speeds import speed_groups

NUMBERS = MethodNumbers("4-campbell-map.toml", "map")

HANN_CORRELATION = 1.95
"""Factor by which neighbouring bins of a Hann window count the same noise twice: 1 + 2 (4/9 + 1/36), rounded up."""


def leading_frames(frames: list[xr.Dataset]) -> list[Ints] | None:
    """Number of leading frames that hold a start transient, by bin (bins,), for each of ``frames``; None without any.

    When machines are switched on or loads are set the modes decay freely, and their line in a frame is no resonance
    excited by noise. It begins with the recording, so the power of the first frames over the later ones tells
    it from noise (all recordings with like bins together), frame by frame until one is like the later ones.

    ``frames`` are the FrequencyFrames (channel, frame, frequency) of the recordings of a test; those of structures that
    do not turn are left as they are, as a struck structure shows nothing else.
    """
    leading: list[Ints] = [np.zeros(item.sizes["frequency"], dtype=np.int64) for item in frames]
    alike: dict[tuple[int, int], list[int]] = {}
    for number, item in enumerate(frames):
        later = _apart(item) + NUMBERS.fewest_later
        if item.sizes["frame"] >= later and np.isfinite(item["speed"].values).any():
            finest = round(NUMBERS.same_bins_parts * math.log(float(item.attrs["resolution_hz"])))
            alike.setdefault((item.sizes["frequency"], finest), []).append(number)
    for numbers in alike.values():
        count = _count_leading([frames[number] for number in numbers])
        for number in numbers:
            later = _apart(frames[number]) + NUMBERS.fewest_later
            leading[number] = np.minimum(count, frames[number].sizes["frame"] - later + 1)
    return leading if any(count.any() for count in leading) else None


def _apart(item: xr.Dataset) -> int:
    """Frames from one to the next that overlaps it by half at most, and so shares next to none of its noise."""
    return max(1, math.ceil(0.5 / max(1.0 - float(item.attrs["overlap"]), 1e-3) - 0.01))


def _count_leading(items: list[xr.Dataset]) -> Ints:
    """How many frames (bins,) of recordings with like bins take no part, where a recording has so many."""
    leading = np.zeros(items[0].sizes["frequency"], dtype=np.int64)
    on = np.ones(len(leading), dtype=bool)
    powers = [(item["power"].values, _apart(item)) for item in items]
    for frame in range(max(power.shape[1] for power, _ in powers)):
        if (chance := _chance(powers, frame)) is None:
            break
        seen = on & (chance < (NUMBERS.next_chance if frame else NUMBERS.start_chance))
        if frame == 0:
            seen = np.convolve(seen, np.ones(2 * NUMBERS.beside_bins + 1), mode="same") > 0.5
        if not seen.any():
            break
        leading[seen] = frame + 1
        on = seen
    return leading


def _chance(powers: list[tuple[NDArray[np.floating], int]], frame: int) -> Floats | None:
    """Chance (bins,) of noise so strong in the frames of number ``frame`` over later ones; None where too few are.

    ``powers``: power (channel, frame, bin) of each recording, and the frames from one to the next that is apart.
    The share u = P_0 / (P_0 + P_1 + … + P_n) of a frame in itself and n others has a beta distribution with the mean
    1 / (n + 1) behind noise, whatever its level: its mean over recordings and the bins beside is all but normal.
    """
    from scipy.special import ndtr

    total, variance, half = np.zeros(1), 0.0, NUMBERS.beside_bins
    for power, apart in powers:
        beyond = power[:, frame + apart : frame + apart + NUMBERS.later_frames : apart]
        n = beyond.shape[1]
        if n < NUMBERS.fewest_later or not np.isfinite(beyond[:, :, 0]).all() or np.isnan(power[:, frame]).any():
            continue
        mean = np.maximum(beyond.mean(axis=1, dtype=np.float64), np.finfo(np.float64).tiny)
        ratio = power[:, frame] / mean
        ratio = ratio / _level(ratio) * (n * (2.0 ** (1.0 / n) - 1.0))  # behind noise its median is 1
        share, at = ratio / (ratio + n) - 1.0 / (n + 1.0), np.arange(power.shape[2])
        total = total + sum(share[:, np.clip(at + k, 0, at[-1])] for k in range(-half, half + 1))
        variance += n / ((n + 1.0) ** 2 * (n + 2.0)) * (2 * half + 1) * HANN_CORRELATION
    return np.asarray(ndtr(-total / np.sqrt(variance)).min(axis=0)) if variance else None


def _level(ratio: Floats) -> Floats:
    """Running median of ``ratio`` (C, B), from every eighth bin."""
    half = min(NUMBERS.level_bins, ratio.shape[1] | 1) // 2
    padded = np.pad(ratio, ((0, 0), (half, half)), mode="reflect" if ratio.shape[1] > half else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=1)
    at = np.arange(0, ratio.shape[1], 8)
    middle = np.maximum(np.sort(windows[:, at], axis=-1)[..., half], 1e-12)  # a fifth of the time of np.median
    return np.stack([np.interp(np.arange(ratio.shape[1]), at, row) for row in middle])


def campbell_map(frames: list[xr.Dataset], *, speed_bin_rpm: float) -> xr.Dataset:
    """CampbellMap (channel, speed, frequency) of a test from the FrequencyFrames of its recordings.

    Of all ``frames``, those whose speeds differ by less than ``speed_bin_rpm`` are averaged by energy. ``amplitude``
    is the peak (or RMS, as the frames ask) of a tone wherever it lies between two bins, so that an order line does not
    fade at every other speed; ``psd`` is the one-sided power spectral density. A frame that a gap touches is left out
    of the channel concerned (then ``n_frames_used`` counts the others); a channel without any is NaN at that speed.
    Where recordings seem to begin with a transient, ``settled_psd`` is the density without the frames that hold it, at
    ``settled_frequency``, and ``settled_share`` the share of the frames that it is of.
    """
    frames = [item for item in frames if item.sizes["frame"]] or frames[:1]
    first = frames[0]
    grid_hz = _grid_hz(frames)
    n_shown = [math.floor(float(item.attrs["highest_hz"]) / grid_hz * (1 + 1e-9)) + 1 for item in frames]
    frequency = np.arange(min(n_shown), dtype=np.float64) * grid_hz
    speed = np.concatenate([item["speed"].values for item in frames])
    groups = speed_groups(speed, width_rpm=speed_bin_rpm)
    mean_rpm = np.array([speed[group].mean() for group in groups])
    tone, density, counts, scale = _group_means(frames, groups, frequency)
    dims = ("channel", "speed", "frequency")
    rms = first.attrs["amplitude_scaling"] == "rms"
    name = "root mean square" if rms else "peak amplitude"
    lengths = np.array([len(group) for group in groups], dtype=np.int64)
    with np.errstate(over="ignore"):
        psd = density / scale / scale
    variables: Variables = {
        "amplitude": described(dims, np.sqrt(tone * (0.5 if rms else 1.0)) / scale, "see unit", f"{name} of a tone"),
        "psd": described(dims, psd, "see unit, squared per Hz", "power spectral density"),
        **_settled(frames, groups, frequency, density, counts, scale),
        "n_frames": described(("speed",), lengths, "1", "frames averaged"),
    }
    if np.any(counts != lengths):
        variables["n_frames_used"] = described(dims[:2], counts, "1", "frames averaged that no gap touches")
    axes = {
        "frequency": ("frequency", frequency, first["frequency"].attrs),
        "speed": described(("speed",), mean_rpm, "min-1", "speed"),
    }
    result = xr.Dataset(variables, coords={**channel_coords(first), **axes})  # at once: each that is added merges anew
    result.attrs = {
        "window": first.attrs["window"],
        "enbw_hz": max(_enbw_hz(item) for item in frames),
        "resolution_hz": grid_hz,
        "amplitude_scaling": "rms" if rms else "peak",
        "speed_bin_rpm": speed_bin_rpm,
        "overlap": min(float(item.attrs["overlap"]) for item in frames),
        "sweep_hz_per_order": max(float(item.attrs["sweep_hz_per_order"]) for item in frames),
    }
    flags = [flag for item in frames for flag in flags_of(item)]
    if min(n_shown) < max(n_shown):
        name = str(frames[n_shown.index(min(n_shown))].attrs["recording"])
        detail = f"its sample rate ends the map of the whole test at {(min(n_shown) - 1) * grid_hz:g} Hz"
        flags.append(remark(name, "map_cut", detail))
    return with_flags(result, flags)


def _grid_hz(frames: list[xr.Dataset]) -> float:
    """Step of the map's frequencies: that of the bins of all ``frames`` where they share it near the one asked for.

    Lines between bins of another step are drawn out by interpolation, which would move them.
    """
    asked, own = float(frames[0].attrs["grid_hz"]), {float(item.attrs["resolution_hz"]) for item in frames}
    step = own.pop()
    return asked if own or abs(step / asked - 1.0) > NUMBERS.own_grid_share else step


def _enbw_hz(frames: xr.Dataset) -> float:
    return float(frames.attrs["enbw_bins"]) * float(frames.attrs["resolution_hz"])


def _groups_and_scales(frames: list[xr.Dataset], groups: list[Ints]) -> tuple[list[Ints], list[Floats], Floats]:
    """Group of each frame, and the scale (channel,), of each recording; the least scale of each channel."""
    ends = np.cumsum([item.sizes["frame"] for item in frames])
    group_of = np.empty(ends[-1], dtype=np.int64)
    for number, group in enumerate(groups):
        group_of[group] = number
    scales = [item["scale"].values if "scale" in item else np.ones(item.sizes["channel"]) for item in frames]
    return np.split(group_of, ends[:-1]), scales, np.min(scales, axis=0)


def _group_means(
    frames: list[xr.Dataset], groups: list[Ints], frequency: Floats
) -> tuple[Floats, Floats, Ints, Floats]:
    """Mean tone power and density (channel, group, frequency), frames used (channel, group), scale (channel, 1, 1).

    The signals were taken times ``scale``, a power of two, which keeps their squares in range.
    """
    n_channels = frames[0].sizes["channel"]
    tone = np.zeros((n_channels, len(groups), len(frequency)))
    density, counts = np.zeros_like(tone), np.zeros(tone.shape[:2], dtype=np.int64)
    group_of, scales, common = _groups_and_scales(frames, groups)
    for item, scale, own in zip(frames, scales, group_of, strict=True):
        mine, local = np.unique(own, return_inverse=True)
        sums = np.zeros((n_channels, len(mine), item.sizes["frequency"]))
        used = np.zeros(sums.shape[:2], dtype=np.int64)
        power = item["power"].values
        for channel, frame in np.argwhere(~np.isnan(power[..., 0])):
            sums[channel, local[frame]] += power[channel, frame]
            used[channel, local[frame]] += 1
        sums *= ((common / scale) ** 2)[:, None, None]
        tone[:, mine] += _tone_on_grid(item, sums, frequency)
        density[:, mine] += _density_on_grid(item, sums, frequency)
        counts[:, mine] += used
    with np.errstate(invalid="ignore"):
        return tone / counts[..., None], density / counts[..., None], counts, common[:, None, None]


def _settled(
    frames: list[xr.Dataset], groups: list[Ints], frequency: Floats, density: Floats, counts: Ints, unit: Floats
) -> Variables:
    """What is left, at the bins where recordings begin with a transient, without it: density, share of the frames.

    Both (channel, group, bin), from the mean ``density`` (channel, group, frequency) of all ``counts`` (channel, group)
    frames, whose signals were taken times ``unit``. Nothing where no recording begins with a transient.
    """
    leading = leading_frames(frames)
    if leading is None:
        return {}
    group_of, scales, common = _groups_and_scales(frames, groups)
    left, share = density * counts[..., None], np.ones(density.shape) * counts[..., None]
    for item, scale, count, own in zip(frames, scales, leading, group_of, strict=True):
        power = item["power"].values[:, : count.max(initial=0)].astype(np.float64)
        used = np.isfinite(power[..., :1]) & (count > np.arange(power.shape[1])[:, None])
        taken = _density_on_grid(item, np.where(used, power * ((common / scale) ** 2)[:, None, None], 0.0), frequency)
        known = _on_grid(item, used.astype(np.float64), frequency)
        for number, into in enumerate(own[: power.shape[1]]):
            left[:, into] -= taken[:, number]
            share[:, into] -= known[:, number]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        held = share / counts[..., None]
        made = np.where(share > NUMBERS.least_left_share, np.maximum(left, 0.0) / share, np.nan) / unit / unit
    bins = np.flatnonzero((held < 1.0 - 1e-9).any(axis=(0, 1)))
    held = np.where(share > NUMBERS.least_left_share, held, 0.0)
    dims, at = ("channel", "speed", "settled_frequency"), "frequency at which recordings begin with a transient"
    words = "see unit, squared per Hz", "power spectral density without start transients"
    return {
        "settled_frequency": described(dims[2:], frequency[bins], "Hz", at),
        "settled_psd": described(dims, made[..., bins], *words),
        "settled_share": described(dims, held[..., bins], "1", "share of the frames that it is of"),
    }


def _without_image(item: xr.Dataset) -> list[int]:
    """Bins of the spectrum that have no mirror image: the first, and the one at half of the rate."""
    n_bins = item.sizes["frequency"]
    at_half = round(float(item.attrs["rate_hz"]) / float(item.attrs["resolution_hz"])) == 2 * (n_bins - 1)
    return [0, n_bins - 1] if at_half and n_bins > 1 else [0]


def _tone_on_grid(item: xr.Dataset, power: Floats, frequency: Floats) -> Floats:
    """Power of a tone near each of ``frequency``: that of the bins nearest to it, with their neighbours' shares.

    A bin half-way to the next frequency counts for both, so that no tone falls between; the peak amplitude of a
    constant is the constant.
    """
    spacing, resolution = int(item.attrs["tone_spacing_bins"]), float(item.attrs["resolution_hz"])
    total = power * float(item.attrs["tone_weight"])
    if spacing and (weight := float(item.attrs["tone_neighbour_weight"])):
        mirrored = np.concatenate([power[..., spacing:0:-1], power, power[..., -2 : -spacing - 2 : -1]], axis=2)
        total += weight * (mirrored[..., : -2 * spacing] + mirrored[..., 2 * spacing :])
    total[..., _without_image(item)] *= 0.25
    near = 0.5 * ((float(frequency[1]) if len(frequency) > 1 else resolution) + resolution) * (1 - 1e-9)
    low = np.maximum(np.ceil((frequency - near) / resolution).astype(np.int64), 0)
    high = np.minimum(np.floor((frequency + near) / resolution).astype(np.int64), power.shape[2] - 1)
    made = total[..., low]
    for step in range(1, int((high - low).max(initial=0)) + 1):
        np.maximum(made, total[..., np.minimum(low + step, high)], out=made)
    return np.asarray(made)


def _density_on_grid(item: xr.Dataset, power: Floats, frequency: Floats) -> Floats:
    """One-sided power spectral density at each of ``frequency``, linear between the bins."""
    density = power / (2.0 * _enbw_hz(item))
    density[..., _without_image(item)] *= 0.5
    return _on_grid(item, density, frequency)


def _on_grid(item: xr.Dataset, density: Floats, frequency: Floats) -> Floats:
    """``density`` (channel, group, bin) at each of ``frequency``, linear between the bins."""
    n_bins = item.sizes["frequency"]
    at = np.minimum(frequency / float(item.attrs["resolution_hz"]), n_bins - 1.0)
    low = np.minimum(np.floor(at + 1e-9).astype(np.int64), max(0, n_bins - 2))
    share = at - low
    return np.asarray(density[..., low] * (1.0 - share) + density[..., np.minimum(low + 1, n_bins - 1)] * share)
