"""Forces of orders over the speeds, and the responses of modes to them with their slopes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


def smooth_shapes(speed_rpm: Array, span_rpm: tuple[float, float], degree: int) -> Array:
    """Legendre polynomials (K, degree + 1) of ln ``speed_rpm`` (K,), which runs from -1 to 1 over ``span_rpm``.

    ``degree``: the highest, 0 or more.
    """
    low, high = np.log(span_rpm[0]), np.log(span_rpm[1])
    x = 2.0 * (np.log(speed_rpm) - low) / max(float(high - low), 1e-12) - 1.0
    return np.asarray(np.polynomial.legendre.legvander(x, degree))


def force(
    speed_rpm: Array, span_rpm: tuple[float, float], reference_rpm: float, exponent: float, law: tuple[complex, ...]
) -> Complex:
    """Force (K,) at ``speed_rpm`` (K,) by the law of a block: 1 at ``reference_rpm`` where ``law`` is empty.

    ``span_rpm``, ``exponent`` and ``law`` are those of :class:`Block`.
    """
    return grown_by(speed_rpm / reference_rpm, smooth_shapes(speed_rpm, span_rpm, len(law)), exponent, law)


def grown_by(ratio: Array, shapes: Array, exponent: float, law: tuple[complex, ...]) -> Complex:
    """Force (K,) by ``exponent`` and ``law`` at speeds ``ratio`` (K,) times that of reference.

    ``shapes`` (K, law + 1): the polynomials of these speeds.
    """
    grown: Complex = np.asarray(ratio**exponent, dtype=np.complex128)
    if law:
        grown *= np.exp(shapes[:, 1:] @ np.array(law))
    return grown


def resonance_slopes(frequency_hz: Array, natural_hz: Array, damping: Array) -> tuple[Complex, Complex]:
    """Derivatives of h_j (K, M) = −x² / (1 − x² + 2iζx), x = f / f_j, by ln f_j and by ln ζ_j.

    ``frequency_hz``: in Hz; ``natural_hz``: of the modes in Hz; ``damping``: their ratios.
    """
    x = frequency_hz[:, None] / natural_hz
    over = 1.0 / (1.0 - x**2 + 2j * damping * x)
    by_x = -2.0 * x * over + x**2 * (-2.0 * x + 2j * damping) * over**2
    return np.asarray(-x * by_x, dtype=np.complex128), np.asarray(2j * damping * x**3 * over**2, dtype=np.complex128)


def of_squares(columns: Complex, ratio: Array) -> Complex:
    """Real part and imaginary part over ``ratio`` (K, 2 M) of ``columns`` (K, M), in turn.

    They span the square of any response with real residues, beside a constant.
    """
    made = np.empty((len(columns), 2 * columns.shape[1]), dtype=np.complex128)
    made[:, ::2], made[:, 1::2] = columns.real, columns.imag / ratio
    return made
