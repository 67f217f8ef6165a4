"""Order map: the order spectra of all frames of a test, averaged at like speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.orders.floor import floor_bins, local_floor
from crankorder.quantities import QualityFlag, flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.speed_groups import speed_groups

RESIDUAL_FRAMES = 4
"""From so many frames on their scatter tells the noise; with fewer it is taken from quiet bins beside the line."""

RESIDUAL_OFFSETS = (-3, -2, 2, 3)
"""Bins beside a line that hold noise only: the main lobe of a Hann window ends at two."""


def order_map(frames: list[xr.Dataset], *, settings: OrderSettings) -> xr.Dataset:
    """OrderMap of a test from the OrderFrames of its recordings.

    ``frames`` need not be equally many; recordings whose frames are shorter than the longest of the test are left out
    and flagged "bad". Frames within ``settings.speed_bin_rpm`` are averaged twice: by energy (``amplitude``, which
    also sees lines that slip against the shaft) and coherently (``coherent_amplitude`` and ``phase``). Across
    recordings the coherent average is taken only where both have a phase reference (and, for half orders, a known
    cycle); else the recordings' coherent powers are averaged and the phase is NaN.
    """
    longest = max(int(item.attrs["revs_per_frame"]) for item in frames)
    used = [item for item in frames if int(item.attrs["revs_per_frame"]) == longest]
    dropped = [item for item in frames if int(item.attrs["revs_per_frame"]) < longest]
    order = used[0]["order"].values
    speed = np.concatenate([item["speed"].values for item in used])
    owner = np.concatenate([np.full(item.sizes["frame"], k) for k, item in enumerate(used)])
    spectrum = np.concatenate([item["spectrum"].values for item in used], axis=1)
    groups = speed_groups(speed, width_rpm=settings.speed_bin_rpm)
    comparable = _comparable(used, order)
    parts = [_average(spectrum[:, group], owner[group], comparable) for group in groups]
    energy, coherent, kurtosis = (np.stack([part[k] for part in parts], axis=1) for k in (0, 1, 2))
    n_coherent = np.stack([part[3] for part in parts])[None]
    factor = max(float(item.attrs["mean_variance_factor"]) for item in used)
    line_step = 1.0 / int(used[0].attrs["revs_per_cycle"])
    bins = floor_bins(order, line_step=line_step, guard_bins=settings.guard_bins, n_bins=settings.floor_bins)
    floor = local_floor(np.abs(coherent) ** 2, bins, n_averages=n_coherent)
    count = np.array([len(group) for group in groups], dtype=np.int64)
    residual = _residual_power(energy, coherent, count, factor)
    enough = (count[None, :, None] >= RESIDUAL_FRAMES) & (n_coherent == 1) & np.isfinite(residual)
    floor = np.where(enough, residual, floor)
    result = _dataset(used[0], order, np.array([np.mean(speed[group]) for group in groups]), settings)
    dims = ("channel", "speed", "order")
    _put(result, "amplitude", dims, np.sqrt(energy), "peak amplitude, energy average")
    _put(result, "coherent_amplitude", dims, np.abs(coherent), "peak amplitude, coherent average")
    phase = np.where(n_coherent == 1, np.degrees(np.angle(coherent)), np.nan)
    _put(result, "phase", dims, phase, "phase from top dead centre", "degree")
    _put(result, "standard_error", dims, np.sqrt(floor / 2.0), "standard error of coherent_amplitude")
    _put(result, "spectral_kurtosis", dims, kurtosis, "spectral kurtosis", "1")
    _put(result, "n_frames", ("speed",), count, "frames averaged", "1")
    result.attrs["mean_variance_factor"] = factor
    return with_flags(result, [flag for item in frames for flag in flags_of(item)] + _dropped_flags(dropped, longest))


def _residual_power(
    energy: NDArray[np.float64], coherent: NDArray[np.complex128], count: NDArray[np.int64], factor: float
) -> NDArray[np.float64]:
    """Noise power (channels, speeds, orders) of a ``coherent`` average of ``count`` (speeds,) frames.

    The median of the bin's own scatter about the average and of the ``energy`` two and three bins beside it, where a
    Hann window shows nothing of a line: local, so that a resonance near the line does not count. ``factor`` is what
    overlap costs.
    """
    frames = count[None, :, None].astype(np.float64)
    own = (energy - np.abs(coherent) ** 2) * frames / np.maximum(frames - factor, 0.5)
    reach = max(RESIDUAL_OFFSETS)
    padded = np.pad(energy, ((0, 0), (0, 0), (reach, reach)), mode="reflect")
    n_bins = energy.shape[-1]
    beside = [padded[..., reach + k : reach + k + n_bins] for k in RESIDUAL_OFFSETS]
    middle = np.median(np.stack([own, *beside]), axis=0) / (1.0 - 1.0 / (9.0 * frames)) ** 3
    return np.asarray(np.maximum(middle, 0.0) * factor / frames)


def _comparable(used: list[xr.Dataset], order: NDArray[np.float64]) -> NDArray[np.bool_]:
    """For each order, whether phases of different recordings may be averaged."""
    referenced = all(item.attrs["phase_reference"] != "none" for item in used)
    cycle_known = all(int(item.attrs["cycle_known"]) for item in used)
    whole = np.abs(order - np.round(order)) < 1e-9
    return np.full(len(order), referenced) & (whole | cycle_known)


def _average(
    spectrum: NDArray[np.complex128], owner: NDArray[np.int64], comparable: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
    """Mean energy, coherent mean and kurtosis (channels, orders) of ``spectrum`` (channels, frames, orders) of a group.

    The fourth result (orders,) is the number of recordings whose coherent powers had to be averaged without phase.
    """
    power = np.abs(spectrum) ** 2
    energy = _mean(power, axis=1)
    kurtosis = _spectral_kurtosis(power, energy)
    whole = _mean(spectrum, axis=1)
    names = np.unique(owner)
    n_coherent = np.where(comparable, 1.0, float(len(names)))
    if len(names) > 1 and not comparable.all():
        means = np.stack([_mean(spectrum[:, owner == name], axis=1) for name in names])
        weights = np.array([np.count_nonzero(owner == name) for name in names], dtype=float)
        squared = np.tensordot(weights / weights.sum(), np.abs(means) ** 2, axes=1)
        whole = np.where(comparable, whole, np.sqrt(squared))
    return energy, whole, kurtosis, n_coherent


def _spectral_kurtosis(power: NDArray[np.float64], energy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spectral kurtosis (channels, orders) of ``power`` (channels, frames, orders) with the mean ``energy``.

    Unbiased for Gaussian noise at any number of frames (Antoni 2006; Vrabie et al. 2003); NaN for one frame.
    """
    n_frames = power.shape[1]
    if n_frames < 2:
        return np.full(energy.shape, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = _mean(power**2, axis=1) / energy**2
    return np.asarray((n_frames + 1) / (n_frames - 1) * ratio - 2.0 * n_frames / (n_frames - 1))


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
    named = {name: first[name] for name in ("channel", "unit", "quantity", "direction") if name in first.variables}
    result = xr.Dataset(
        coords={
            **named,
            "order": ("order", order, {"units": "1", "long_name": "order", "order_reference": "crankshaft"}),
            "speed": ("speed", speed, {"units": "min-1", "long_name": "speed"}),
        }
    )
    kept = ("window", "enbw_bins", "revs_per_frame", "overlap", "amplitude_scaling", "cycle_known", "revs_per_cycle")
    result.attrs = {key: first.attrs[key] for key in kept}
    result.attrs |= {"phase_reference": first.attrs["phase_reference"], "speed_bin_rpm": settings.speed_bin_rpm}
    return result


def _dropped_flags(dropped: list[xr.Dataset], longest: int) -> list[QualityFlag]:
    return [
        {
            "recording": item.attrs["recording"],
            "flag": "too_short_for_the_test",
            "severity": "bad",
            "detail": f"frames of {item.attrs['revs_per_frame']} revolutions where the others have {longest}: left out",
        }
        for item in dropped
    ]
