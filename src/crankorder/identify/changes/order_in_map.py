"""One order in one channel of an OrderMap: amplitude, phasor and their errors at some speeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.intervals import half_widths


@dataclass(frozen=True, eq=False)
class Line:
    """One order in one channel at some speeds: amplitude, its standard error and freedom, and its phasor (NaN: none).

    ``vector_error`` is the standard error of each part of the phasor, ``noise`` what of it adds to its length.
    """

    amplitude: NDArray[np.float64]
    error: NDArray[np.float64]
    freedom: NDArray[np.float64]
    vector: NDArray[np.complex128]
    vector_error: NDArray[np.float64]
    noise: NDArray[np.float64] | float = 0.0

    @property
    def size(self) -> NDArray[np.float64]:
        """Amplitude without what noise adds to the length of a phasor, which is ``noise``² / (2 amplitude)."""
        return np.asarray(np.sqrt(np.maximum(self.amplitude**2 - np.square(self.noise), 0.25 * self.amplitude**2)))


def line_of(
    order_map: xr.Dataset, channel: str, order: float, at: NDArray[np.int64], *, locked: bool, phases: bool
) -> Line:
    """Amplitude and phasor of an order in one channel, at some speeds.

    Parameters
    ----------
    order_map : OrderMap
    channel : name of the channel
    order : cycles per revolution; the nearest bin is read, and of a slipping line those beside it too
    at : positions of the speeds
    locked : True reads the coherent average; False the energy, whose error is that of the frames' own scatter
    phases : whether to give the phasor
    """
    number = order_map["channel"].values.tolist().index(channel)
    axis = order_map["order"].values
    peak = int(np.argmin(np.abs(axis - order)))

    def values(name: str, bins: Any = peak) -> NDArray[np.float64]:
        table = order_map[name].transpose("channel", "speed", "order").values[number][at]
        return np.asarray(table[:, bins], dtype=np.float64)

    nothing = np.full(len(at), np.nan)
    if not locked or not np.isfinite(values("coherent_amplitude")).any():
        return _by_energy(order_map, values, peak, at)
    amplitude, error = values("coherent_amplitude"), values("standard_error")
    freedom = np.maximum(np.nan_to_num(values("degrees_of_freedom"), nan=1.0), 1.0)
    if not phases:
        return Line(amplitude, error, freedom, nothing.astype(np.complex128), nothing, error)
    half = np.radians(values("phase_ci95"))
    across = np.where(half < np.pi / 2, amplitude * half / half_widths(freedom), 0.0)
    vector = np.asarray(amplitude * np.exp(1j * np.radians(values("phase"))), dtype=np.complex128)
    return Line(amplitude, error, freedom, vector, np.maximum(error, np.nan_to_num(across)), error)


def _by_energy(order_map: xr.Dataset, values: Any, peak: int, at: NDArray[np.int64]) -> Line:
    """Amplitude from the energy of the bin and its neighbours, so that a line between two bins loses nothing."""
    bins = slice(max(peak - 1, 0), peak + 2)
    lost = float(order_map.attrs.get("enbw_bins", 1.5))
    amplitude = np.sqrt(np.sum(values("amplitude", bins) ** 2, axis=1) / lost)
    frames = np.maximum(order_map["n_independent"].values[at].astype(np.float64), 1.0)
    # variance of a frame's energy over its square; noise has 1, a steady line 0; never trusted below one in frames
    spread = np.clip(np.nan_to_num(values("spectral_kurtosis"), nan=0.0) + 1.0, 1.0 / frames, None)
    error = 0.5 * amplitude * np.sqrt(spread / frames)
    nothing = np.full(len(at), np.nan)
    noise = _noise_beside(values, peak, order_map.sizes["order"]) * np.sqrt(bins.stop - bins.start) / np.sqrt(lost)
    return Line(amplitude, error, np.maximum(frames - 1.0, 1.0), nothing.astype(np.complex128), nothing, noise)


def _noise_beside(values: Any, peak: int, n_bins: int) -> NDArray[np.float64]:
    """Amplitude (speeds,) of the noise in a bin, from those on both sides of the line; 0 where there are none."""
    beside = [k for k in (*range(peak - 6, peak - 2), *range(peak + 3, peak + 7)) if 0 < k < n_bins]
    if not beside:
        return np.zeros(len(values("amplitude", slice(peak, peak + 1))))
    return np.asarray(np.nan_to_num(np.nanmedian(values("amplitude", beside), axis=1)))
