"""Frames of like speed, and the ordinary coherence between channels over them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.windows import hann
from crankorder.orders.common_frames import common_frames
from crankorder.quantities import QualityFlag
from crankorder.shaft.speed_groups import speed_groups

SHAPE_SAMPLES = 1024
"""Samples on which the shape of the window is evaluated where only its overlap matters."""

LEAST_FRAMES = 2.0
"""Independent frames below which a coherence says nothing: that of one frame is 1 whatever the signals."""

GRID, TERMS = 257, 400
"""Coherences for which the expected estimate is tabulated, and terms of its series: right to 1e-5."""


@dataclass(frozen=True)
class LikeSpeedFrames:
    """Frames of a test in groups of like speed.

    ``spectrum`` (channels, frames, orders) complex, ``owner`` (frames,) the number of the recording, ``groups`` indices
    of frames, slowest first, ``speed_rpm`` their mean speeds, ``n_power`` and ``n_complex`` (groups,) the independent
    power and complex spectra that the overlapping frames of each are worth, ``used`` the OrderFrames taken,
    ``remarks`` on what was left out.
    """

    spectrum: NDArray[np.complex128]
    owner: NDArray[np.int64]
    groups: list[NDArray[np.int64]]
    speed_rpm: NDArray[np.float64]
    n_power: NDArray[np.float64]
    n_complex: NDArray[np.float64]
    used: list[xr.Dataset]
    remarks: list[QualityFlag]


def like_speed_frames(frames: list[xr.Dataset], *, speed_bin_rpm: float) -> LikeSpeedFrames:
    """Groups of like speed, within ``speed_bin_rpm``, of all ``frames`` (OrderFrames) that are as long as most.

    Frames of unknown speed stay with their recording, for nothing says that two ran alike.
    """
    used, remarks = common_frames(frames)
    speed = np.concatenate([item["speed"].values for item in used])
    owner = np.concatenate([np.full(item.sizes["frame"], k) for k, item in enumerate(used)])
    groups = speed_groups(speed, width_rpm=speed_bin_rpm)
    if groups and np.isnan(speed[groups[-1][0]]):
        unknown = groups.pop()
        groups += [unknown[owner[unknown] == name] for name in np.unique(owner[unknown])]
    window = hann(SHAPE_SAMPLES)
    hop = max(1, round(SHAPE_SAMPLES * (1.0 - float(used[0].attrs["overlap"]))))
    worth = [[window.independent_frames(hop, len(group), power=power) for group in groups] for power in (True, False)]
    return LikeSpeedFrames(
        spectrum=np.concatenate([item["spectrum"].values for item in used], axis=1),
        owner=owner,
        groups=groups,
        speed_rpm=np.array([speed[group].mean() for group in groups]),
        n_power=np.array(worth[0]),
        n_complex=np.array(worth[1]),
        used=used,
        remarks=remarks,
    )


def place_of(name: str, names: list[str]) -> int:
    """Position of the channel ``name`` in ``names``. Raises RequestError where it is none of them."""
    if name not in names:
        raise RequestError("no such channel to refer to", found=name, allowed=", ".join(names))
    return names.index(name)


def coherence_level(n_frames: NDArray[np.float64], *, probability: float = 0.95) -> NDArray[np.float64]:
    """Estimated coherence that independent signals stay below with ``probability``, before its bias is taken off.

    ``n_frames`` independent ones, any shape; NaN below two. Source: Carter 1973, from Goodman's distribution: of
    independent Gaussian signals it exceeds x with the probability (1 - x)^(n_frames - 1).
    """
    n = np.asarray(n_frames, dtype=np.float64)
    enough = n >= LEAST_FRAMES
    return np.where(enough, -np.expm1(np.log1p(-probability) / np.where(enough, n - 1.0, 1.0)), np.nan)


def expected_coherence(coherence: NDArray[np.float64], *, n_frames: float) -> NDArray[np.float64]:
    """Mean of the estimated magnitude-squared coherence from few frames: 1 / n_frames where the true one is 0.

    ``coherence`` the true one, 0…1, any shape; ``n_frames`` independent frames, at least 2. Source: Carter, Knapp and
    Nuttall 1973, 1 / n + (n - 1) / (n + 1) x 2F1(1, 1; n + 2; x).
    """
    true = np.asarray(coherence, dtype=np.float64)
    index = np.arange(1.0, TERMS)
    terms = np.concatenate([[1.0], np.cumprod(index / (n_frames + 1.0 + index))])
    series = np.polynomial.polynomial.polyval(true, terms)
    return np.asarray(1.0 / n_frames + (n_frames - 1.0) / (n_frames + 1.0) * true * series)


def unbiased_coherence(estimate: NDArray[np.float64], *, n_frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coherence whose expected estimate is the one found: 0…1, and 0 where chance explains it; NaN below two frames.

    ``estimate`` magnitude-squared, any shape; ``n_frames`` independent frames, broadcast against it.
    """
    found, n = np.broadcast_arrays(np.asarray(estimate, dtype=np.float64), np.asarray(n_frames, dtype=np.float64))
    made = np.full(found.shape, np.nan)
    for each in np.unique(n[n >= LEAST_FRAMES]):
        here = n == each
        made[here] = np.interp(found[here], *_expected_table(float(each)))
    return np.where(np.isnan(found), np.nan, made)


@lru_cache(maxsize=256)
def _expected_table(n_frames: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Expected estimates from ``n_frames`` and the true coherences that they belong to, both growing."""
    true = np.linspace(0.0, 1.0, GRID)
    expected = expected_coherence(true, n_frames=n_frames)
    expected[-1] = 1.0
    return expected, true
