"""Frames of a test that can be averaged together: of one length, on one axis of orders."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from crankorder.fft.windows import hann
from crankorder.quantities import QualityFlag, with_flags

LEAST_WINDOW = 0.1
"""Sum of the windows at an angle below which the signal is not regained there: its noise would be ten times as high."""

CUT_OVERLAP = 0.5
"""Share of a shorter frame, cut from longer ones, that the next one repeats."""

Array = NDArray[np.float64]


def common_frames(frames: Sequence[xr.Dataset]) -> tuple[list[xr.Dataset], list[QualityFlag]]:
    """Those of ``frames`` (OrderFrames) of one length, on the orders that all hold, and what was left out.

    The length is that of most, the longer one where two are as common; where a recording's own sweep asked for shorter
    frames it is the shortest of these, and longer frames whose length is a multiple are cut into such
    (:func:`reframed`), which is "info". Those of any other length are left out, which is "bad". Recordings by
    crank angle of fewer samples per revolution end at a lower order: the others are cut there, and the remark is
    "info".
    """
    lengths = [int(item.attrs["revs_per_frame"]) for item in frames]
    swept = [
        length for item, length in zip(frames, lengths, strict=True) if item.attrs.get("frame_length_by") == "sweep"
    ]
    common = min(swept) if swept else max(set(lengths), key=lambda length: (lengths.count(length), length))
    used, flags = [], []
    for item, length in zip(frames, lengths, strict=True):
        cut = reframed(item, common) if swept and length > common and length % common == 0 else None
        if length == common or cut is not None:
            used.append(item if cut is None else cut)
        if length != common:
            flags.append(_length_flag(item, common) if cut is None else _cut_length_flag(item, common))
    fewest = min(item.sizes["order"] for item in used)
    flags += [_cut_flag(item, fewest) for item in used if item.sizes["order"] > fewest]
    return [item if item.sizes["order"] == fewest else item.isel(order=slice(fewest)) for item in used], flags


def reframed(item: xr.Dataset, revs: int) -> xr.Dataset | None:
    """OrderFrames of ``revs`` revolutions made of those of another length, ``item``; None where none fit.

    Hann windows that overlap add up to a smooth sum, so the overlapping frames, transformed back, give the signal by
    crank angle again up to the highest order, and other frames of it are what they would have been at first; but for
    the two ends of a record, where a window alone is near 0.
    """
    length = int(item.attrs["revs_per_frame"])
    begin = item["crank_angle"].values
    n_orders = (item.sizes["order"] - 1) * revs // length + 1
    if item.attrs["window"] != "hann" or not len(begin):
        return None
    per_rev = 2 * math.ceil((item.sizes["order"] - 1) / length) + 4
    hop = max(1, round(revs * (1.0 - CUT_OVERLAP)))
    spectra, starts, speeds = [], [], []
    for run in np.split(np.arange(len(begin)), np.flatnonzero(np.diff(begin) >= length) + 1):
        signal, weight, top = _regained(item["spectrum"].values[:, run], begin[run], length, per_rev)
        made, first = _cut(signal, weight, revs, hop, per_rev, n_orders)
        made[np.broadcast_to(np.arange(n_orders) / revs > _lowest(top, first, revs, per_rev)[:, None], made.shape)] = (
            np.nan
        )
        angle = begin[run[0]] + first / per_rev
        turn = np.exp(-2j * np.pi * (np.outer(angle, np.arange(n_orders) / revs) % 1.0))
        spectra.append(made * turn)
        starts.append(angle)
        speeds.append(_speeds_at(angle + 0.5 * revs, begin[run] + 0.5 * length, item["speed"].values[run]))
    place = np.concatenate(starts)
    return (
        None if not len(place) else _dataset(item, np.concatenate(spectra, axis=1), place, np.concatenate(speeds), revs)
    )


def _regained(
    spectrum: NDArray[np.complex128], begin_rev: Array, length: int, per_rev: int
) -> tuple[Array, Array, Array]:
    """Signals (channels, samples) ``per_rev`` times in a revolution from the first frame on, the windows' sum, limits.

    ``spectrum`` (channels, frames, orders) of frames of ``length`` revolutions from ``begin_rev`` (frames,) on. NaN are
    frames of a channel that a gap touches; the limits (samples,) are the orders up to which a frame there is known.
    """
    n = length * per_rev
    axis = np.arange(spectrum.shape[2]) / length
    known = np.isfinite(spectrum.real)
    whole = known[:, :, 0]
    turned = np.where(known, spectrum, 0.0) * np.exp(2j * np.pi * (np.outer(begin_rev, axis) % 1.0))
    window = hann(n).values
    bins = np.zeros((*spectrum.shape[:2], n // 2 + 1), dtype=np.complex128)
    bins[..., : spectrum.shape[2]] = turned * (0.5 * window.sum())
    pieces = np.fft.irfft(bins, n, axis=2)
    pieces[~whole] = np.nan
    limit = np.where(known.any(axis=0), axis, 0.0).max(axis=1)
    place = np.round((begin_rev - begin_rev[0]) * per_rev).astype(int)
    signal, weight = np.zeros((len(spectrum), place[-1] + n)), np.zeros(place[-1] + n)
    top = np.full(place[-1] + n, np.inf)
    for frame, first in enumerate(place):
        part = slice(first, first + n)
        signal[:, part] += pieces[:, frame]
        weight[part] += window
        top[part] = np.minimum(top[part], limit[frame])
    return signal / np.maximum(weight, LEAST_WINDOW), weight, top


def _cut(
    signal: Array, weight: Array, revs: int, hop: int, per_rev: int, n_orders: int
) -> tuple[NDArray[np.complex128], NDArray[np.int64]]:
    """Spectra (channels, frames, ``n_orders``) of frames of ``revs`` every ``hop`` revolutions, and where they begin.

    Only where ``weight`` (samples,) allows; phases count from the begin of each frame.
    """
    n = revs * per_rev
    seen = np.flatnonzero(weight >= LEAST_WINDOW)
    start = math.ceil(seen[0] / per_rev) * per_rev
    first = np.arange(start, seen[-1] + 2 - n, hop * per_rev)
    if not len(first):
        return np.empty((len(signal), 0, n_orders), dtype=np.complex128), first
    window = hann(n).values
    pieces = sliding_window_view(signal, n, axis=1)[:, first] * window
    return np.asarray(np.fft.rfft(pieces, axis=2)[..., :n_orders] * (2.0 / window.sum())), first


def _lowest(top: Array, first: NDArray[np.int64], revs: int, per_rev: int) -> Array:
    """Lowest of the limits ``top`` (samples,) within each frame of ``revs`` that begins at the samples ``first``."""
    return np.array([top[begin : begin + revs * per_rev].min() for begin in first]) + 1e-9


def _speeds_at(middle_rev: Array, known_rev: Array, speed_rpm: Array) -> Array:
    """Speeds at ``middle_rev`` from those of longer frames at ``known_rev``; beyond the ends they go on as there."""
    if len(known_rev) < 2:
        return np.full(len(middle_rev), speed_rpm[0])
    at = np.clip(np.searchsorted(known_rev, middle_rev), 1, len(known_rev) - 1)
    slope = (speed_rpm[at] - speed_rpm[at - 1]) / (known_rev[at] - known_rev[at - 1])
    return np.asarray(speed_rpm[at - 1] + slope * (middle_rev - known_rev[at - 1]))


def _dataset(
    item: xr.Dataset, spectrum: NDArray[np.complex128], begin_rev: Array, speed_rpm: Array, revs: int
) -> xr.Dataset:
    order = np.arange(spectrum.shape[2]) / revs
    made = xr.Dataset(
        {"spectrum": (("channel", "frame", "order"), spectrum, item["spectrum"].attrs)},
        coords={name: item[name] for name in item.coords if item[name].dims == ("channel",)}
        | {
            "order": ("order", order, item["order"].attrs),
            "speed": ("frame", speed_rpm, item["speed"].attrs),
            "crank_angle": ("frame", begin_rev, item["crank_angle"].attrs),
        },
        attrs=item.attrs | {"revs_per_frame": revs, "overlap": CUT_OVERLAP},
    )
    return with_flags(made, [])


def _length_flag(item: xr.Dataset, common: int) -> QualityFlag:
    return {
        "recording": item.attrs["recording"],
        "flag": "frame_length_differs",
        "severity": "bad",
        "detail": f"frames of {item.attrs['revs_per_frame']} revolutions where most others have {common}: left out",
    }


def _cut_length_flag(item: xr.Dataset, common: int) -> QualityFlag:
    return {
        "recording": item.attrs["recording"],
        "flag": "frames_cut",
        "severity": "info",
        "detail": f"frames of {item.attrs['revs_per_frame']} revolutions are cut into {common}, as the fastest "
        "sweep of the test asks for",
    }


def _cut_flag(item: xr.Dataset, fewest: int) -> QualityFlag:
    order = item["order"].values
    return {
        "recording": item.attrs["recording"],
        "flag": "orders_cut",
        "severity": "info",
        "detail": f"orders from {order[fewest]:g} to {order[-1]:g} left out: another recording of the test ends there",
    }
