"""Frames of all recordings of a test by number, so that those of like speed can be taken together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray


@dataclass(frozen=True)
class Frames:
    """Frames to average: ``spectrum`` (channels, frames, orders), and for each the recording, its begin and speed."""

    spectrum: NDArray[np.complex128]
    owner: NDArray[np.int64]
    begin_rev: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]

    def of(self, which: NDArray[np.bool_]) -> Frames:
        """Those of the frames that ``which`` picks."""
        return Frames(self.spectrum[:, which], self.owner[which], self.begin_rev[which], self.speed_rpm[which])


@dataclass(frozen=True)
class AllFrames:
    """Frames of all recordings, whose spectra are joined only where a group needs those of several.

    ``spectra`` (channels, frames, orders) of each recording; ``owner``, ``begin_rev``, ``speed_rpm`` of all frames;
    ``exponent`` (channels,) of the power of two that is taken out of each channel.
    """

    spectra: list[NDArray[np.complexfloating]]
    owner: NDArray[np.int64]
    begin_rev: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]
    exponent: NDArray[np.int64]

    def of(self, which: NDArray[np.int64]) -> Frames:
        """Those of the frames that ``which`` (numbers that grow) picks; a view where they are neighbours."""
        owner, first = self.owner[which], np.searchsorted(self.owner, np.arange(len(self.spectra)))
        parts = []
        for name in np.unique(owner):
            rows = which[owner == name] - first[name]
            near = rows[-1] - rows[0] == len(rows) - 1
            parts.append(self.spectra[name][:, slice(int(rows[0]), int(rows[-1]) + 1) if near else rows])
        joined = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        spectrum = np.asarray(joined, dtype=np.complex128)
        if self.exponent.any():
            half = self.exponent // 2  # the power of two itself may not be a number
            factors = np.ldexp(1.0, -half), np.ldexp(1.0, half - self.exponent)
            spectrum = spectrum * factors[0][:, None, None] * factors[1][:, None, None]
        return Frames(spectrum, owner, self.begin_rev[which], self.speed_rpm[which])


def all_frames(used: Sequence[xr.Dataset]) -> AllFrames:
    """Frames of all recordings, ``used`` as OrderFrames of equal length.

    Only where squares would leave the range of numbers is a power of two taken out.
    """
    largest = np.max([_largest(item["spectrum"].values) for item in used], axis=0)
    exponent = np.where(np.isfinite(largest) & (largest > 0.0), np.frexp(largest)[1], 0)
    return AllFrames(
        [item["spectrum"].values for item in used],
        np.concatenate([np.full(item.sizes["frame"], k) for k, item in enumerate(used)]),
        np.concatenate([item["crank_angle"].values for item in used]),
        np.concatenate([item["speed"].values for item in used]),
        np.where(np.abs(exponent) > 64, exponent, 0),
    )


def _largest(spectrum: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Largest real or imaginary part of each channel, NaN left out."""
    parts = np.ascontiguousarray(spectrum).reshape(len(spectrum), -1)
    parts = parts.view(parts.real.dtype)
    return np.asarray(np.fmax(np.fmax.reduce(parts, axis=1), -np.fmin.reduce(parts, axis=1)), dtype=np.float64)
