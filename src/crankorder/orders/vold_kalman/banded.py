"""Banded symmetric positive definite systems: factor, solution and the band of the inverse, compiled.

A band is stored by rows, the diagonal last: ``band[i, width - k]`` is the entry (i, i - k).
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def factorise(band):  # type: ignore[no-untyped-def]
    """Replace ``band`` (n, width + 1) by its Cholesky factor; the row at which it is not definite, else -1."""
    n, width = band.shape[0], band.shape[1] - 1
    for i in range(n):
        first = max(0, i - width)
        row = band[i]
        for j in range(first, i):
            other = band[j]
            shared = max(first, j - width)
            count = j - shared
            mine, theirs = row[width - i + shared :], other[width - j + shared :]
            total = 0.0
            for k in range(count):
                total += mine[k] * theirs[k]
            row[width - i + j] = (row[width - i + j] - total) / other[width]
        total = 0.0
        for k in range(width - i + first, width):
            total += row[k] * row[k]
        pivot = row[width] - total
        if not pivot > 1e-15 * row[width]:
            return i
        row[width] = np.sqrt(pivot)
    return -1


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def solve(factor, values):  # type: ignore[no-untyped-def]
    """Replace each of ``values`` (right-hand sides, n) by the solution with ``factor`` of ``factorise``."""
    n, width = factor.shape[0], factor.shape[1] - 1
    for c in range(values.shape[0]):
        x = values[c]
        for i in range(n):
            first = max(0, i - width)
            row, known = factor[i, width - i + first :], x[first:]
            total = 0.0
            for k in range(i - first):
                total += row[k] * known[k]
            x[i] = (x[i] - total) / factor[i, width]
        for i in range(n - 1, -1, -1):
            first = max(0, i - width)
            row, above = factor[i, width - i + first :], x[first:]
            x[i] /= factor[i, width]
            for k in range(i - first):
                above[k] -= row[k] * x[i]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def product(band, values, result):  # type: ignore[no-untyped-def]
    """Add to ``result`` (columns, n) the symmetric ``band`` times ``values`` (columns, n)."""
    n, width = band.shape[0], band.shape[1] - 1
    for c in range(values.shape[0]):
        x, out = values[c], result[c]
        for i in range(n):
            first = max(0, i - width)
            row, known, above = band[i, width - i + first :], x[first:], out[first:]
            total, here = band[i, width] * x[i], x[i]
            for k in range(i - first):
                total += row[k] * known[k]
                above[k] += row[k] * here
            out[i] += total


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def inverse_band(factor):  # type: ignore[no-untyped-def]
    """Entries of the inverse within the band, stored as ``factor`` of ``factorise`` is.

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
