"""Orthonormal bases of the columns that each channel is fitted with, and what lies beyond them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complexfloating]


def orthonormal(columns: Complex) -> tuple[Complex, Complex]:
    """QR of each channel's ``columns`` (C, K, terms): bases (C, K, terms) and triangles (C, terms, terms).

    As :func:`numpy.linalg.qr` does it, whose stacking takes longer than the factors of matrices as small as these. What
    is below the diagonal of a triangle counts for nothing.
    """
    from scipy.linalg import lapack

    count, rows, terms = columns.shape
    if rows < terms:
        basis, triangle = np.linalg.qr(columns)
        return np.asarray(basis, dtype=np.complex128), np.asarray(triangle, dtype=np.complex128)
    turned = np.empty((count, terms, rows), dtype=np.complex128)
    triangle = np.empty((count, terms, terms), dtype=np.complex128)
    for number, one in enumerate(columns):
        reflected, factor, _, _ = lapack.zgeqrf(one)
        triangle[number] = reflected[:terms]
        turned[number] = lapack.zungqr(reflected, factor, overwrite_a=True)[0].T
    return np.swapaxes(turned, 1, 2), triangle


def beyond(basis: Complex, values: Complex) -> Complex:
    """``values`` (C, K, M) less what lies along ``basis`` (C, K, terms)."""
    return np.asarray(values - basis @ (np.swapaxes(basis, 1, 2).conj() @ values))


def beyond_law(values: Complex, bent: Complex, *, power: bool) -> Complex:
    """``values`` (C, K, M) less what a step of a law common to the channels makes up for.

    ``bent`` (C, K, degree) are the derivatives by its numbers. These are complex, and real behind squares (``power``),
    of which the real parts alone count.
    """
    flat, moved = values.reshape(-1, values.shape[2]), bent.reshape(-1, bent.shape[2])
    if power:
        flat, moved = flat.real + 0j, moved.real + 0j
    unit = np.linalg.qr(moved / np.maximum(np.linalg.norm(moved, axis=0), 1e-300))[0]
    return np.asarray(beyond(unit[None], flat[None])[0].reshape(values.shape))
