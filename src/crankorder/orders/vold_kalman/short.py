"""Vold-Kalman equations of a record shorter than the filter's response, where the structure outweighs all data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError

_Array = NDArray[np.float64]


def integration(slopes: _Array, n_splines: int) -> _Array:
    """Coefficients (splines, splines) of splines from the first coefficient of each derivative and all of the last.

    ``slopes`` (poles, splines) as of ``difference_slopes``, ``n_splines`` the number of coefficients. In these unknowns
    the structural equation acts on the last derivative alone, so that no weight, however large, hides the data.
    """
    unknown = np.eye(n_splines)
    found = unknown[len(slopes) :]
    for k in range(len(slopes) - 1, -1, -1):
        steps = np.cumsum(found / slopes[k, : len(found), None], axis=0)
        found = np.concatenate([unknown[k : k + 1], unknown[k] + steps])
    return found


def solve_short(
    data_band: _Array, forms: _Array, weight: _Array, slopes: _Array, wanted: _Array
) -> tuple[_Array, _Array]:
    """Coefficients (columns, splines, rows) and their covariance (n, n) from white data noise of unit variance.

    ``data_band`` (n, width + 1) the data's weight, ``forms`` (intervals, splines, splines) and ``weight`` (intervals,
    orders) the structural equation on last derivatives, ``slopes`` as of ``difference_slopes``, ``wanted`` (columns,
    splines, rows) the right-hand sides. Raises RequestError where the equations are not definite.
    """
    n_splines, rows = wanted.shape[1:]
    turn = np.kron(integration(slopes, n_splines), np.eye(rows))
    data = _dense(data_band)
    matrix = turn.T @ data @ turn
    poles, near = len(slopes), forms.shape[1]
    for i in range(len(forms)):
        for row in range(rows):
            at = (poles + i + np.arange(near)) * rows + row
            matrix[np.ix_(at, at)] += weight[i, row % weight.shape[1]] * forms[i]
    scale = 1.0 / np.sqrt(np.diag(matrix))
    try:
        factor = np.linalg.cholesky(matrix * np.outer(scale, scale))
    except np.linalg.LinAlgError as error:
        raise RequestError("the normal equations are not definite", remedy="two of the orders move together") from error
    inverse = np.linalg.solve(factor, np.diag(scale))
    sides = turn.T @ wanted.reshape(len(wanted), -1).T
    found = inverse.T @ (inverse @ sides)
    found += inverse.T @ (inverse @ (sides - matrix @ found))
    back = turn @ inverse.T
    spread = back.T @ data @ back
    return (turn @ found).T.reshape(wanted.shape), back @ spread @ back.T


def _dense(band: _Array) -> _Array:
    n, width = len(band), band.shape[1] - 1
    found = np.zeros((n, n))
    for k in range(min(width, n - 1) + 1):
        found[np.arange(k, n), np.arange(n - k)] = band[k:, width - k]
    return found + np.tril(found, -1).T
