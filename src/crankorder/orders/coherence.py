"""Cross-spectra and ordinary coherence between channels, from the order frames at like speed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.windows import hann, power_of_two
from crankorder.orders.common_frames import common_frames
from crankorder.quantities import QualityFlag, channel_coords
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


def cross_spectra(frames: list[xr.Dataset], *, speed_bin_rpm: float, references: list[str] | None = None) -> xr.Dataset:
    """Cross-spectra (channel, reference, speed, order) between channels, with their coherence.

    Parameters
    ----------
    frames : OrderFrames of the recordings of a test
    speed_bin_rpm : width of a group of like speed, rpm
    references : names of the channels to refer to; None for all

    Returns
    -------
    Dataset of ``cross_spectrum``, the mean over frames of channel times conjugate reference, peak amplitudes: its phase
    is that of the channel before the reference, whatever the origin of crank angle; ``coherence``, the unbiased
    magnitude-squared one; ``coherence_level`` (speed), which independent channels pass in 5 % of all cases, before the
    bias is taken off; ``n_frames`` and ``n_independent`` (speed). Frames with a gap in either channel take no part.

    Raises RequestError for a reference that is no channel. Source: Bendat and Piersol 2010, chapter 6 and section 9.2.
    """
    grouped = like_speed_frames(frames, speed_bin_rpm=speed_bin_rpm)
    names = [str(name) for name in grouped.used[0]["channel"].values]
    wanted = names if references is None else references
    at = [place_of(name, names) for name in wanted]
    parts = [_pairs(grouped.spectrum[:, group], at) for group in grouped.groups]
    cross = np.stack([part[0] for part in parts], axis=2)
    share = np.stack([part[2] for part in parts], axis=2)
    independent = grouped.n_power[None, None, :, None] * share
    coherence = unbiased_coherence(np.stack([part[1] for part in parts], axis=2), n_frames=independent)
    same = np.arange(len(names))[:, None] == np.array(at)[None, :]
    coherence[same] = np.where(np.isnan(coherence[same]), np.nan, 1.0)
    made = xr.Dataset(
        coords={
            **channel_coords(grouped.used[0]),
            "reference": ("reference", list(wanted), {"units": "1", "long_name": "channel referred to"}),
            "order": grouped.used[0]["order"],
            "speed": ("speed", grouped.speed_rpm, {"units": "min-1", "long_name": "speed"}),
        }
    )
    dims = ("channel", "reference", "speed", "order")
    made["cross_spectrum"] = (dims, cross, {"units": "see unit", "long_name": "mean channel times conjugate reference"})
    made["coherence"] = (dims, coherence, {"units": "1", "long_name": "magnitude-squared coherence, unbiased"})
    level = coherence_level(grouped.n_power)
    made["coherence_level"] = ("speed", level, {"units": "1", "long_name": "95 % level of independent channels"})
    count = np.array([len(group) for group in grouped.groups], dtype=np.int64)
    made["n_frames"] = ("speed", count, {"units": "1", "long_name": "frames"})
    made["n_independent"] = ("speed", grouped.n_power, {"units": "1", "long_name": "independent frames"})
    return made


def place_of(name: str, names: list[str]) -> int:
    """Position of the channel ``name`` in ``names``. Raises RequestError where it is none of them."""
    if name not in names:
        raise RequestError("no such channel to refer to", found=name, allowed=", ".join(names))
    return names.index(name)


def _pairs(
    spectrum: NDArray[np.complex128], at: list[int]
) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
    """Cross-spectrum, coherence as estimated, share of frames used (channels, references, orders) of a group."""
    scale = power_of_two(spectrum)
    values = spectrum / scale
    known = ~np.isnan(values)
    values = np.where(known, values, 0.0)
    seen, power = known.astype(np.float64), np.abs(values) ** 2
    count = np.einsum("cfo,rfo->cro", seen, seen[at])
    cross = np.einsum("cfo,rfo->cro", values, values[at].conj())
    both = np.einsum("cfo,rfo->cro", power, seen[at]) * np.einsum("cfo,rfo->cro", seen, power[at])
    estimate = np.divide(np.abs(cross) ** 2, both, out=np.full(both.shape, np.nan), where=both > 0.0)
    with np.errstate(over="ignore"):  # a product of two amplitudes of 1e300 is infinite
        mean = cross / np.maximum(count, 1.0) * scale * scale[at][:, 0][None]
    mean[count == 0] = np.nan
    return mean, estimate, count / spectrum.shape[1]


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
