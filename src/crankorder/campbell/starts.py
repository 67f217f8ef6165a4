"""What still rings when a recording begins: leading frames far stronger than later ones at a frequency."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import NDArray

START_CHANCE = 5e-3
"""Chance that noise alone makes the first frames so strong at a bin that they take no part in the floor there.

A mode that rings too weakly to be sure of already looks far narrower than it is; a bin that loses a frame loses little.
"""

NEXT_CHANCE = 0.02
"""Chance of the same in the frame after one that takes no part."""

LATER_FRAMES = 24
"""Frames that one is compared with at most: what came later belongs to other speeds in a sweep."""

FEWEST_LATER = 1
"""Frames that it is compared with at least."""

LEVEL_BINS = 61
"""Bins around one over which a change of the whole level is taken off: what runs up or down is no transient."""

BESIDE = 1
"""Bins on each side that share what is seen."""

SAME_BINS = 200.0
"""Bins whose widths differ by less than one part in so many are alike."""

SHARED = 1.95
"""Factor by which neighbouring bins count the same noise twice."""

Array = NDArray[np.float64]


def leading_frames(frames: list[xr.Dataset]) -> list[NDArray[np.int64]] | None:
    """How many leading frames hold a start transient, by bin (bins,) of each of ``frames``; None where none does.

    Machines are switched on, loads are set: what rings then is the free decay of the modes, whose line in a frame is no
    resonance behind noise. It begins with the recording, so the power of the first frames over the later ones tells
    it from noise (all recordings with like bins together), frame by frame until one is like the later ones.

    ``frames``: FrequencyFrames of the recordings of a test; those of what does not turn are left as they are, for a
    struck structure shows nothing else.
    """
    made = [np.zeros(item.sizes["frequency"], dtype=np.int64) for item in frames]
    alike: dict[tuple[int, int], list[int]] = {}
    for number, item in enumerate(frames):
        later = _apart(item) + FEWEST_LATER
        if item.sizes["frame"] >= later and np.isfinite(item["speed"].values).any():
            finest = round(SAME_BINS * math.log(float(item.attrs["resolution_hz"])))
            alike.setdefault((item.sizes["frequency"], finest), []).append(number)
    for numbers in alike.values():
        _count_leading([frames[number] for number in numbers], [made[number] for number in numbers])
    return made if any(count.any() for count in made) else None


def _apart(item: xr.Dataset) -> int:
    """Frames from one to the next that overlaps it by half at most, and so shares next to none of its noise."""
    return max(1, math.ceil(0.5 / max(1.0 - float(item.attrs["overlap"]), 1e-3) - 0.01))


def _count_leading(items: list[xr.Dataset], leading: list[NDArray[np.int64]]) -> None:
    """Write into ``leading``, of recordings with like bins, how many frames take no part."""
    on = np.ones(items[0].sizes["frequency"], dtype=bool)
    for frame in range(max(item.sizes["frame"] for item in items)):
        chance = _chance(items, frame)
        if chance is None:
            break
        seen = on & (chance < (NEXT_CHANCE if frame else START_CHANCE))
        if frame == 0:
            seen = np.convolve(seen, np.ones(2 * BESIDE + 1), mode="same") > 0.5
        if not seen.any():
            break
        for item, count in zip(items, leading, strict=True):
            if item.sizes["frame"] >= frame + _apart(item) + FEWEST_LATER:
                count[seen] = frame + 1
        on = seen


def _chance(items: list[xr.Dataset], frame: int) -> Array | None:
    """Chance (bins,) of noise so strong in the frames of number ``frame`` over later ones; None where too few are.

    The share u = P_0 / (P_0 + P_1 + … + P_n) of a frame in itself and n others has a beta distribution with the mean
    1 / (n + 1) behind noise, whatever its level: its mean over recordings and the bins beside is all but normal.
    """
    from scipy.special import ndtr

    total: Array | float = 0.0
    variance = 0.0
    for item in items:
        power, apart = item["power"].values, _apart(item)
        beyond = power[:, frame + apart : frame + apart + LATER_FRAMES : apart]
        n = beyond.shape[1]
        if n < FEWEST_LATER or not np.isfinite(beyond[:, :, 0]).all() or np.isnan(power[:, frame]).any():
            continue
        mean = np.maximum(beyond.mean(axis=1, dtype=np.float64), np.finfo(np.float64).tiny)
        ratio = power[:, frame] / mean
        ratio = ratio / _level(ratio) * _middle_ratio(n)
        total = total + _beside(ratio / (ratio + n) - 1.0 / (n + 1.0))
        variance += n / ((n + 1.0) ** 2 * (n + 2.0)) * (2 * BESIDE + 1) * SHARED
    if not variance:
        return None
    return np.asarray(ndtr(-np.asarray(total) / np.sqrt(variance)).min(axis=0))


def _middle_ratio(n: int) -> float:
    """Median of the ratio of a frame to the mean of ``n`` others, behind noise."""
    return float(n * (2.0 ** (1.0 / n) - 1.0))


def _beside(power: Array) -> Array:
    """Sum of ``power`` (C, B) over some bins."""
    padded = np.pad(power, ((0, 0), (BESIDE, BESIDE)), mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1, axis=1).sum(axis=-1))


def _level(ratio: Array) -> Array:
    """Running median of ``ratio`` (C, B), from every eighth bin."""
    half = min(LEVEL_BINS, ratio.shape[1] | 1) // 2
    padded = np.pad(ratio, ((0, 0), (half, half)), mode="reflect" if ratio.shape[1] > half else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=1)
    at = np.arange(0, ratio.shape[1], 8)
    middle = np.maximum(np.median(windows[:, at], axis=-1), 1e-12)
    return np.stack([np.interp(np.arange(ratio.shape[1]), at, row) for row in middle])
