"""Order map: the order spectra of all frames of a test, averaged at like speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.windows import hann
from crankorder.orders.floor import floor_bins, local_floor
from crankorder.quantities import QualityFlag, channel_coords, flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.speed_groups import speed_groups

RESIDUAL_FRAMES = 1.8
"""From so many frames on their scatter tells the noise; with fewer it is taken from quiet bins beside the line."""

SHAPE_SAMPLES = 1024
"""Samples on which the shape of the window is evaluated where only its overlap matters."""

RESIDUAL_OFFSETS = (-3, -2, 2, 3)
"""Bins beside a line that hold noise only: the main lobe of a Hann window ends at two."""


def order_map(frames: list[xr.Dataset], *, settings: OrderSettings) -> xr.Dataset:
    """OrderMap of a test from the OrderFrames of its recordings.

    ``frames`` need not be equally many; recordings whose frames are not as long as those of most others are left out
    and flagged "bad". Frames within ``settings.speed_bin_rpm`` are averaged twice: by energy (``amplitude``, which
    also sees lines that slip against the shaft) and coherently (``coherent_amplitude`` and ``phase``). Across
    recordings the coherent average is taken only where both have a phase reference (and, for half orders, a known
    cycle); else the recordings' coherent powers are averaged and the phase is NaN.
    """
    common = _common_length(frames)
    used = [item for item in frames if int(item.attrs["revs_per_frame"]) == common]
    order = used[0]["order"].values
    speed = np.concatenate([item["speed"].values for item in used])
    owner = np.concatenate([np.full(item.sizes["frame"], k) for k, item in enumerate(used)])
    spectrum = np.concatenate([item["spectrum"].values for item in used], axis=1)
    groups = _groups(speed, owner, settings)
    comparable = _comparable(used, order)
    count = np.array([len(group) for group in groups], dtype=np.int64)
    independent, independent_phase = _independent(count, float(used[0].attrs["overlap"]))
    parts = [
        _average(spectrum[:, group], owner[group], comparable, n_independent)
        for group, n_independent in zip(groups, independent, strict=True)
    ]
    energy = np.stack([part[0] for part in parts], axis=1)
    coherent = np.stack([part[1] for part in parts], axis=1)
    kurtosis = np.stack([part[2] for part in parts], axis=1)
    apart = np.stack([part[3] for part in parts])[None]
    memory = np.stack([part[4] for part in parts], axis=1)
    kept = count[:, None] * (1.0 - memory) / (1.0 + memory)
    n_coherent = np.maximum(1.0, np.minimum(kept, independent_phase[None, :, None])) / apart
    line_step = 1.0 / int(used[0].attrs["revs_per_cycle"])
    bins = floor_bins(order, line_step=line_step, guard_bins=settings.guard_bins, n_bins=settings.floor_bins)
    floor = local_floor(np.abs(coherent) ** 2, bins, n_averages=apart)
    residual = _residual_power(energy, coherent, n_coherent)
    enough = (independent_phase[None, :, None] >= RESIDUAL_FRAMES) & (apart == 1) & np.isfinite(residual)
    floor = np.where(enough, residual, floor)
    result = _dataset(used[0], order, np.array([np.mean(speed[group]) for group in groups]), settings)
    dims = ("channel", "speed", "order")
    _put(result, "amplitude", dims, np.sqrt(energy), "peak amplitude, energy average")
    _put(result, "coherent_amplitude", dims, np.abs(coherent), "peak amplitude, coherent average")
    referenced = all(item.attrs["phase_reference"] != "none" for item in used)
    phase = np.where((apart == 1) & referenced, np.degrees(np.angle(coherent)), np.nan)
    _put(result, "phase", dims, phase, "phase from top dead centre", "degree")
    _put(result, "standard_error", dims, np.sqrt(floor / 2.0), "standard error of coherent_amplitude")
    _put(result, "spectral_kurtosis", dims, kurtosis, "spectral kurtosis", "1")
    _put(result, "n_frames", ("speed",), count, "frames averaged", "1")
    _put(result, "n_independent", ("speed",), independent, "independent power spectra", "1")
    _put(result, "n_coherent", dims, n_coherent, "independent complex spectra", "1")
    return with_flags(result, [flag for item in frames for flag in flags_of(item)] + _dropped_flags(frames, common))


def _common_length(frames: list[xr.Dataset]) -> int:
    """Revolutions per frame that most recordings have; the longer where two are equally many."""
    lengths = [int(item.attrs["revs_per_frame"]) for item in frames]
    return max(set(lengths), key=lambda length: (lengths.count(length), length))


def _groups(speed: NDArray[np.float64], owner: NDArray[np.int64], settings: OrderSettings) -> list[NDArray[np.int64]]:
    """Frames of like speed; those of unknown speed by recording, for nothing says that two ran alike."""
    known = speed_groups(speed, width_rpm=settings.speed_bin_rpm)
    unknown = known.pop() if known and np.isnan(speed[known[-1][0]]) else np.empty(0, dtype=np.int64)
    return [*known, *(unknown[owner[unknown] == name] for name in np.unique(owner[unknown]))]


def _independent(count: NDArray[np.int64], overlap: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Independent power and complex spectra that ``count`` (speeds,) frames with ``overlap`` are worth."""
    window = hann(SHAPE_SAMPLES)
    hop = max(1, round(SHAPE_SAMPLES * (1.0 - overlap)))
    worth = [[window.independent_frames(hop, int(n), power=power) for n in count] for power in (True, False)]
    return np.array(worth[0]), np.array(worth[1])


def _residual_power(
    energy: NDArray[np.float64], coherent: NDArray[np.complex128], n: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Noise power (channels, speeds, orders) of a ``coherent`` average of ``n`` independent frames.

    The median of the bin's own scatter about the average and of the ``energy`` two and three bins beside it, where a
    Hann window shows nothing of a line: local, so that a resonance near the line does not count. A resonance on the
    line, narrower than that, shows in the bin's own scatter alone, which goes first where it is larger.
    """
    own = (energy - np.abs(coherent) ** 2) * n / np.maximum(n - 1.0, 0.5)
    reach = max(RESIDUAL_OFFSETS)
    padded = np.pad(energy, ((0, 0), (0, 0), (reach, reach)), mode="reflect")
    n_bins = energy.shape[-1]
    beside = [padded[..., reach + k : reach + k + n_bins] for k in RESIDUAL_OFFSETS]
    middle = np.median(np.stack([own, *beside]), axis=0) / (1.0 - 1.0 / (9.0 * n)) ** 3
    return np.asarray(np.maximum(np.maximum(middle, own), 0.0) / n)


def _comparable(used: list[xr.Dataset], order: NDArray[np.float64]) -> NDArray[np.bool_]:
    """For each order, whether phases of different recordings may be averaged."""
    referenced = all(item.attrs["phase_reference"] != "none" for item in used)
    cycle_known = all(int(item.attrs["cycle_known"]) for item in used)
    whole = np.abs(order - np.round(order)) < 1e-9
    return np.full(len(order), referenced) & (whole | cycle_known)


def _average(
    spectrum: NDArray[np.complex128], owner: NDArray[np.int64], comparable: NDArray[np.bool_], n_independent: float
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mean energy, coherent mean and kurtosis (channels, orders) of ``spectrum`` (channels, frames, orders) of a group.

    The fourth result (orders,) is the number of recordings whose coherent powers had to be averaged without phase, the
    fifth (channels, orders) the memory of the frames.
    """
    power = np.abs(spectrum) ** 2
    energy = _mean(power, axis=1)
    kurtosis = _spectral_kurtosis(power, energy, n_independent)
    whole = _mean(spectrum, axis=1)
    names = np.unique(owner)
    n_coherent = np.where(comparable, 1.0, float(len(names)))
    if len(names) > 1 and not comparable.all():
        means = np.stack([_mean(spectrum[:, owner == name], axis=1) for name in names])
        weights = np.array([np.count_nonzero(owner == name) for name in names], dtype=float)
        squared = np.tensordot(weights / weights.sum(), np.abs(means) ** 2, axes=1)
        whole = np.where(comparable, whole, np.sqrt(squared))
    return energy, whole, kurtosis, n_coherent, _memory(spectrum, owner, power)


def _memory(
    spectrum: NDArray[np.complex128], owner: NDArray[np.int64], power: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Correlation (channels, orders), 0 to 1, of each frame's scatter about the mean with the next frame's.

    Frames correlate by their overlap and, where noise excites a resonance, by its decay: so many fewer of them are
    independent, (1 - r) / (1 + r) of all for a first-order memory r. Its square is relieved of what chance adds, 1/n.
    """
    n_frames = spectrum.shape[1]
    if n_frames < 3:
        return np.zeros(power[:, 0].shape)
    scatter = spectrum - _mean(spectrum, axis=1)[:, None]
    next_to = owner[1:] == owner[:-1]
    product = np.nan_to_num(scatter[:, 1:] * scatter[:, :-1].conj())[:, next_to].sum(axis=1)
    total = np.nan_to_num(np.abs(scatter) ** 2).sum(axis=1)
    squared = np.abs(product) ** 2 / np.maximum(total**2, np.finfo(np.float64).tiny) - 1.0 / n_frames
    return np.asarray(np.sqrt(np.clip(squared, 0.0, 1.0)))


def _spectral_kurtosis(power: NDArray[np.float64], energy: NDArray[np.float64], n: float) -> NDArray[np.float64]:
    """Spectral kurtosis (channels, orders) of ``power`` (channels, frames, orders) with the mean ``energy``.

    Unbiased for Gaussian noise whose frames are worth ``n`` independent ones (Antoni 2006; Vrabie et al. 2003); NaN
    for less than two.
    """
    if n < 2.0:
        return np.full(energy.shape, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = _mean(power**2, axis=1) / energy**2
    return np.asarray(((n + 1.0) * ratio - 2.0 * n) / (n - 1.0))


def _mean(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Mean without NaN; NaN where all are (without numpy's warning)."""
    missing = np.isnan(values)
    if not missing.any():
        return np.asarray(values.mean(axis=axis))
    count = np.count_nonzero(~missing, axis=axis)
    total = np.where(missing, 0.0, values).sum(axis=axis)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _put(
    target: xr.Dataset, name: str, dims: tuple[str, ...], values: NDArray[Any], long_name: str, units: str = "see unit"
) -> None:
    target[name] = (dims, values, {"units": units, "long_name": long_name})


def _dataset(
    first: xr.Dataset, order: NDArray[np.float64], speed: NDArray[np.float64], settings: OrderSettings
) -> xr.Dataset:
    result = xr.Dataset(
        coords={
            **channel_coords(first),
            "order": ("order", order, {"units": "1", "long_name": "order", "order_reference": "crankshaft"}),
            "speed": ("speed", speed, {"units": "min-1", "long_name": "speed"}),
        }
    )
    kept = ("window", "enbw_bins", "revs_per_frame", "overlap", "amplitude_scaling", "cycle_known", "revs_per_cycle")
    result.attrs = {key: first.attrs[key] for key in (*kept, "samples_per_rev") if key in first.attrs}
    result.attrs |= {"phase_reference": first.attrs["phase_reference"], "speed_bin_rpm": settings.speed_bin_rpm}
    return result


def _dropped_flags(frames: list[xr.Dataset], common: int) -> list[QualityFlag]:
    return [
        {
            "recording": item.attrs["recording"],
            "flag": "frame_length_differs",
            "severity": "bad",
            "detail": f"frames of {item.attrs['revs_per_frame']} revolutions where most others have {common}: left out",
        }
        for item in frames
        if int(item.attrs["revs_per_frame"]) != common
    ]
