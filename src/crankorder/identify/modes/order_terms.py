"""What an order's response is made of: its force, a smooth part, its scatter, and the modes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "order_terms")


def smooth_shapes(speed_rpm: Floats, span_rpm: tuple[float, float], degree: int) -> Floats:
    """Legendre polynomials (K, degree + 1) of ln ``speed_rpm`` (K,), which runs from -1 to 1 over ``span_rpm``.

    ``degree``: the highest, 0 or more.
    """
    low, high = np.log(span_rpm[0]), np.log(span_rpm[1])
    x = 2.0 * (np.log(speed_rpm) - low) / max(float(high - low), 1e-12) - 1.0
    return np.asarray(np.polynomial.legendre.legvander(x, degree))


@dataclass(frozen=True)
class Force:
    """How the force of an order grows with the speed.

    (speed / ``reference_rpm``) to the power ``exponent`` times the exponential of Σ ``law``[k] P_k+1(x), P_k the
    Legendre polynomials of x, the logarithm of the speed, which runs from -1 to 1 over ``span_rpm``.
    """

    reference_rpm: float
    span_rpm: tuple[float, float]
    exponent: float = 2.0
    law: tuple[complex, ...] = ()

    def shapes(self, speed_rpm: Floats, degree: int) -> Floats:
        """The polynomials (K, ``degree`` + 1) at ``speed_rpm`` (K,)."""
        return smooth_shapes(speed_rpm, self.span_rpm, degree)

    def at(self, speed_rpm: Floats, shapes: Floats | None = None) -> Complexes:
        """Force (K,) at ``speed_rpm`` (K,); ``shapes`` (K, law + 1 or more): the polynomials there, where known."""
        grown: Complexes = np.asarray((speed_rpm / self.reference_rpm) ** self.exponent, dtype=np.complex128)
        if self.law:
            shapes = self.shapes(speed_rpm, len(self.law)) if shapes is None else shapes
            grown *= np.exp(shapes[:, 1 : len(self.law) + 1] @ np.array(self.law))
        return grown


def resonance(frequency_hz: Floats, natural_hz: Floats, damping_ratio: Floats) -> Complexes:
    """Acceleration −x² / (1 − x² + 2iζx), x = f / f_j, of modes of unit residue, shape (…, mode).

    ``frequency_hz``: f, any shape (…). ``natural_hz`` and ``damping_ratio``: f_j (Hz) and ζ_j, (mode,).
    """
    x = np.asarray(frequency_hz)[..., None] / natural_hz
    return np.asarray(-(x**2) / (1 - x**2 + 2j * damping_ratio * x), dtype=np.complex128)


def resonance_slopes(frequency_hz: Floats, natural_hz: Floats, damping: Floats) -> tuple[Complexes, Complexes]:
    """Derivatives of h_j (K, M) = −x² / (1 − x² + 2iζx), x = f / f_j, by ln f_j and by ln ζ_j.

    ``frequency_hz``: in Hz; ``natural_hz``: of the modes in Hz; ``damping``: their ratios.
    """
    x = frequency_hz[:, None] / natural_hz
    over = 1.0 / (1.0 - x**2 + 2j * damping * x)
    by_x = -2.0 * x * over + x**2 * (-2.0 * x + 2j * damping) * over**2
    return np.asarray(-x * by_x, dtype=np.complex128), np.asarray(2j * damping * x**3 * over**2, dtype=np.complex128)


def of_squares(columns: Complexes, ratio: Floats) -> Complexes:
    """Real part and imaginary part over ``ratio`` (K, 2 M) of ``columns`` (K, M), in turn.

    They span the square of any response with real residues, beside a constant.
    """
    both = np.empty((len(columns), 2 * columns.shape[1]), dtype=np.complex128)
    both[:, ::2], both[:, 1::2] = columns.real, columns.imag / ratio
    return both


def qr_by_channel(columns: Complexes) -> tuple[Complexes, Complexes]:
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
    for number, channel in enumerate(columns):
        reflected, factor, _, _ = lapack.zgeqrf(channel)
        triangle[number] = reflected[:terms]
        turned[number] = lapack.zungqr(reflected, factor, overwrite_a=True)[0].T
    return np.swapaxes(turned, 1, 2), triangle


def beyond(basis: Complexes, values: Complexes) -> Complexes:
    """``values`` (C, K, M) less what lies along ``basis`` (C, K, terms)."""
    return np.asarray(values - basis @ (np.swapaxes(basis, 1, 2).conj() @ values))


def beyond_law(values: Complexes, bent: Complexes, *, power: bool) -> Complexes:
    """``values`` (C, K, M) less what a step of a law common to the channels makes up for.

    ``bent`` (C, K, degree) are the derivatives by its numbers. These are complex, and real behind squares (``power``),
    of which the real parts alone count.
    """
    flat, moved = values.reshape(-1, values.shape[2]), bent.reshape(-1, bent.shape[2])
    if power:
        flat, moved = flat.real.astype(np.complex128), moved.real.astype(np.complex128)
    unit = np.linalg.qr(moved / np.maximum(np.linalg.norm(moved, axis=0), 1e-300))[0]
    return np.asarray(beyond(unit[None], flat[None])[0].reshape(values.shape))


CUTS = 16
"""Parts into which a range is cut at once: as many as four halvings make."""

FRACTIONS = np.arange(CUTS + 1) / CUTS
"""Where those cuts lie, as shares of the range."""


def scatter_of(squared: Floats, error: Floats, size: Floats, degrees_of_freedom: int) -> tuple[float, float]:
    """Scatter s and share n of the errors for which Σ ``squared`` / (n² ``error`` + s² ``size``) is as expected.

    That is the ``degrees_of_freedom``. n is one as long as s is more than the least.
    """
    known = np.isfinite(error)
    squared, error, size = squared[known], error[known], size[known]

    def above(scatter: Floats, noise: Floats) -> Bools:
        sizes = np.square(noise)[:, None] * error + np.square(scatter)[:, None] * size
        return np.asarray(np.sum(squared / sizes, axis=1) > degrees_of_freedom)

    least, whole = np.array([NUMBERS.least_scatter]), np.ones(1)
    if above(least, whole)[0]:
        return _halved(lambda scatter: above(scatter, whole), NUMBERS.least_scatter, 1e3), 1.0
    if degrees_of_freedom < NUMBERS.enough_degrees_of_freedom:
        return NUMBERS.least_scatter, 1.0
    return NUMBERS.least_scatter, _halved(lambda noise: above(least, noise), NUMBERS.least_noise_share, 1.0)


def _halved(is_below: Callable[[Floats], Bools], low: float, high: float) -> float:
    """Where ``is_below`` turns false between ``low`` and ``high``, by halving the logarithm twenty times.

    Four halvings are one: all places that they could ask at are asked at once.
    """
    first, last = float(np.log(low)), float(np.log(high))
    for _ in range(5):
        cuts = first + (last - first) * FRACTIONS
        part = int(np.count_nonzero(is_below(np.exp(cuts[1:-1]))))
        first, last = float(cuts[part]), float(cuts[part + 1])
    return float(np.exp(0.5 * (first + last)))
