"""Banded symmetric positive definite systems: normal equations of splines and the band of the inverse, compiled.

A band is stored by rows, the diagonal last: ``band[i, width - k]`` is the entry (i, i - k).
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def normal_equations(signals, waves, pieces, starts, band, sides):  # type: ignore[no-untyped-def]
    """Fill ``band`` (unknowns, width + 1) and ``sides`` (channels, unknowns), of unknown (spline · rows + row).

    ``signals`` (channels, samples) are met by ``waves`` (rows, samples) times splines. In the intervals from
    ``starts`` (intervals + 1,) on these are ``pieces`` (intervals, splines, powers) of u in (-1, 1); each interval
    begins one spline later.
    """
    rows, size = waves.shape[0], band.shape[1]
    for i in range(starts.shape[0] - 1):
        first, last, at = starts[i], starts[i + 1], i * rows
        powers, met = np.ones((pieces.shape[2], last - first)), np.empty((size, last - first))
        for q in range(1, len(powers)):
            for j in range(last - first):
                powers[q, j] = powers[q - 1, j] * ((2.0 * j + 1.0) / (last - first) - 1.0)
        splines = pieces[i] @ powers
        for m in range(size):
            met[m] = splines[m // rows] * waves[m % rows, first:last]
        product = met @ met.T
        for m in range(size):
            band[at + m, size - 1 - m :] += product[m, : m + 1]
        sides[:, at : at + size] += np.ascontiguousarray(signals[:, first:last]) @ met.T


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def inverse_band(factor):  # type: ignore[no-untyped-def]
    """Entries of the inverse within the band, stored as its Cholesky ``factor`` (n, width + 1) is.

    Source: Takahashi, Fagan and Chin 1973; as in Hutchinson and de Hoog 1985 for smoothing splines.
    """
    n, width = factor.shape[0], factor.shape[1] - 1
    inverse = np.zeros_like(factor)
    below, entry = np.empty(width), np.empty(width)
    for i in range(n - 1, -1, -1):
        count = min(width, n - 1 - i)
        for k in range(count):
            below[k] = factor[i + 1 + k, width - 1 - k] / factor[i, width]
            entry[k] = 0.0
        for k in range(count):
            row, mine, total = inverse[i + 1 + k, width - k :], below[k], 0.0
            for m in range(k):
                total += below[m] * row[m]
                entry[m] -= mine * row[m]
            entry[k] -= total + mine * row[k]
        total = 1.0 / (factor[i, width] * factor[i, width])
        for k in range(count):
            inverse[i + 1 + k, width - 1 - k] = entry[k]
            total -= below[k] * entry[k]
        inverse[i, width] = total
    return inverse
