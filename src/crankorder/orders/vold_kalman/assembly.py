"""From moments between knots to banded normal equations of spline coefficients and back, compiled.

Coefficient (spline, row) has number spline · rows + row; rows are the cosines of all orders, then their sines.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.orders.vold_kalman.knots import DEGREE

SPLINES = DEGREE + 1
"""Splines in an interval, and powers of u of each: a constant, so that the loops are unrolled."""


def spline_products(pieces: NDArray[np.float64]) -> NDArray[np.float64]:
    """Products of two splines in powers of u, (runs, powers, pairs): pairs (a, b) with b up to a, in rows of a.

    ``pieces`` (runs, splines, powers) are the splines.
    """
    a, b = np.tril_indices(SPLINES)
    found = np.zeros((len(pieces), 2 * SPLINES - 1, len(a)))
    for q in range(SPLINES):
        for r in range(SPLINES):
            found[:, q + r] += pieces[:, a, q] * pieces[:, b, r]
    return found


@njit(cache=True, nogil=True, fastmath={"contract"})
def assemble_gram(gram, products, kind, band):  # type: ignore[no-untyped-def]
    """Add to ``band`` the data's weight ``gram`` (intervals, pairs of rows, powers) on ``products`` [``kind``]."""
    n_rows, width = band.shape[1] // SPLINES, band.shape[1] - 1
    local = np.empty(products.shape[2])
    for i in range(gram.shape[0]):
        pair = 0
        for row in range(n_rows):
            for other in range(row + 1):
                local[:] = 0.0
                for m in range(2 * SPLINES - 1):
                    moment, line = gram[i, pair, m], products[kind[i], m]
                    for ab in range(local.shape[0]):
                        local[ab] += moment * line[ab]
                pair += 1
                ab = 0
                for a in range(SPLINES):
                    for b in range(a + 1):
                        back = (a - b) * n_rows
                        band[(i + a) * n_rows + row, width - back - row + other] += local[ab]
                        if a > b and row != other:
                            band[(i + a) * n_rows + other, width - back + row - other] += local[ab]
                        ab += 1


@njit(cache=True, nogil=True)
def assemble_roughness(stiffness, kind, weight, band):  # type: ignore[no-untyped-def]
    """Add to ``band`` the forms ``stiffness`` [``kind``] (splines, splines) times ``weight`` (intervals, orders)."""
    n_orders = weight.shape[1]
    n_rows, width = 2 * n_orders, band.shape[1] - 1
    for i in range(kind.shape[0]):
        local = stiffness[kind[i]]
        for a in range(SPLINES):
            for b in range(a + 1):
                for row in range(n_rows):
                    band[(i + a) * n_rows + row, width - (a - b) * n_rows] += local[a, b] * weight[i, row % n_orders]


@njit(cache=True, nogil=True)
def apply_roughness(forms, kind, weight, slopes, values, result):  # type: ignore[no-untyped-def]
    """Add to ``result`` (columns, splines, rows) the structural equation applied to ``values`` of the same shape.

    ``slopes`` (poles, splines) turn differences of coefficients into those of the derivative; in turn, so that those of
    a constant vanish exactly. ``forms`` [``kind``] act on them, times ``weight`` (intervals, orders).
    """
    poles, n = slopes.shape[0], values.shape[1]
    near = forms.shape[1]
    for column in range(values.shape[0]):
        for row in range(values.shape[2]):
            steep = values[column, :, row].copy()
            for k in range(poles):
                for j in range(n - 1 - k):
                    steep[j] = (steep[j + 1] - steep[j]) * slopes[k, j]
            rough = np.zeros(n)
            for i in range(kind.shape[0]):
                local, r2 = forms[kind[i]], weight[i, row % weight.shape[1]]
                for a in range(near):
                    total = 0.0
                    for b in range(near):
                        total += local[a, b] * steep[i + b]
                    rough[i + a] += r2 * total
            for k in range(poles - 1, -1, -1):
                above = 0.0
                for j in range(n - 1 - k):
                    scaled = rough[j] * slopes[k, j]
                    rough[j] = above - scaled
                    above = scaled
                rough[n - 1 - k] = above
            for j in range(n):
                result[column, j, row] += rough[j]


@njit(cache=True, nogil=True)
def gather(data, pieces, kind, values):  # type: ignore[no-untyped-def]
    """Add to ``values`` (channels, splines, rows) the moments ``data`` (intervals, channels, rows, powers).

    ``pieces`` [``kind``] are the splines of each interval.
    """
    for i in range(data.shape[0]):
        piece = pieces[kind[i]]
        for c in range(data.shape[1]):
            for a in range(SPLINES):
                for row in range(data.shape[2]):
                    total = 0.0
                    for q in range(SPLINES):
                        total += piece[a, q] * data[i, c, row, q]
                    values[c, i + a, row] += total


@njit(cache=True, nogil=True)
def scatter(values, pieces, kind, found):  # type: ignore[no-untyped-def]
    """Fill ``found`` (intervals, channels, rows, powers) with the envelopes in u of coefficients ``values``.

    ``pieces`` [``kind``] are the splines of each interval.
    """
    for i in range(found.shape[0]):
        piece = pieces[kind[i]]
        for c in range(found.shape[1]):
            for row in range(found.shape[2]):
                for q in range(SPLINES):
                    total = 0.0
                    for a in range(SPLINES):
                        total += piece[a, q] * values[c, i + a, row]
                    found[i, c, row, q] = total


@njit(cache=True, nogil=True)
def variance_at_middles(inverse, pieces, kind, n_rows):  # type: ignore[no-untyped-def]
    """Variance (intervals, rows) of each envelope in the middle of each interval, from the ``inverse`` band.

    ``pieces`` [``kind``] are the splines, ``n_rows`` the number of rows.
    """
    width = inverse.shape[1] - 1
    found = np.zeros((kind.shape[0], n_rows))
    for i in range(kind.shape[0]):
        middle = pieces[kind[i], :, 0]
        for row in range(n_rows):
            for a in range(middle.shape[0]):
                at = (i + a) * n_rows + row
                found[i, row] += middle[a] * middle[a] * inverse[at, width]
                for b in range(a):
                    found[i, row] += 2.0 * middle[a] * middle[b] * inverse[at, width - (a - b) * n_rows]
    return found
