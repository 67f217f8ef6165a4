"""The local floor of an order spectrum: the noise next to a line, not an assumed white one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def floor_bins(order: NDArray[np.float64], *, line_step: float, guard_bins: int, n_bins: int) -> NDArray[np.int64]:
    """Indices (orders, n_bins) of the bins next to each bin of ``order`` (orders,) that hold noise only.

    Bins within ``guard_bins`` of a multiple of ``line_step`` (1/2 for a four-stroke engine, where half orders live)
    may hold lines and are left out, unless that would leave fewer than ``n_bins``.
    """
    resolution = order[1] - order[0]
    distance = np.abs(order / line_step - np.round(order / line_step)) * line_step / resolution
    quiet = np.flatnonzero((distance > guard_bins + 0.5) & (order >= line_step))
    if len(quiet) < n_bins:
        quiet = np.flatnonzero(order > 1.5 * resolution)
    n_bins = min(n_bins, len(quiet))
    first = np.clip(np.searchsorted(quiet, np.arange(len(order))) - n_bins // 2, 0, len(quiet) - n_bins)
    return np.asarray(quiet[first[:, None] + np.arange(n_bins)])


def local_floor(
    power: NDArray[np.float64], bins: NDArray[np.int64], *, n_averages: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Expected noise power (…, orders) at each bin of ``power`` (…, orders), from the median of its ``bins``.

    ``n_averages`` (broadcast against ``power``) is the number of independent spectra in each power: their mean is
    gamma distributed, whose median is below its mean by about 1 - 1/(9 n) cubed (Wilson and Hilferty 1931).
    NaN bins are left out.
    """
    neighbours = power[..., bins]
    with np.errstate(invalid="ignore"):
        median = _nanmedian(neighbours)
    return np.asarray(median / (1.0 - 1.0 / (9.0 * n_averages)) ** 3)


def _nanmedian(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median along the last axis without NaN; NaN where all are. Faster than numpy's, which warns besides."""
    count = np.count_nonzero(~np.isnan(values), axis=-1)
    ordered = np.sort(values, axis=-1)
    low = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[-1] - 1)[..., None], axis=-1)[..., 0]
    return np.asarray(0.5 * (low + high))
