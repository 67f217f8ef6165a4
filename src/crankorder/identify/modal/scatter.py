"""By how much a force varies beyond the errors of its amplitudes, told from what a fit leaves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

LEAST_SCATTER = 1e-3
"""Relative scatter of an order's amplitude that force and tracking are granted at least."""

ENOUGH_FREEDOM = 40
"""Real numbers beyond the unknowns from which residuals tell that the stated errors are too large."""

LEAST_NOISE = 0.02
"""Share of the stated errors that is believed at least."""

CUTS = 16
"""Parts into which a range is cut at once: as many as four halvings make."""

FRACTIONS = np.arange(CUTS + 1) / CUTS
"""Where those cuts lie, as shares of the range."""

Array = NDArray[np.float64]


def scatter_of(squared: Array, error: Array, size: Array, freedom: int) -> tuple[float, float]:
    """Scatter s and share n of the errors for which Σ ``squared`` / (n² ``error`` + s² ``size``) is ``freedom``.

    n is one as long as s is more than the least.
    """
    known = np.isfinite(error)
    squared, error, size = squared[known], error[known], size[known]

    def above(scatter: Array, noise: Array) -> NDArray[np.bool_]:
        sizes = np.square(noise)[:, None] * error + np.square(scatter)[:, None] * size
        return np.asarray(np.sum(squared / sizes, axis=1) > freedom)

    least, whole = np.array([LEAST_SCATTER]), np.ones(1)
    if above(least, whole)[0]:
        return _halved(lambda scatter: above(scatter, whole), LEAST_SCATTER, 1e3), 1.0
    if freedom < ENOUGH_FREEDOM:
        return LEAST_SCATTER, 1.0
    return LEAST_SCATTER, _halved(lambda noise: above(least, noise), LEAST_NOISE, 1.0)


def _halved(is_below: Callable[[Array], NDArray[np.bool_]], low: float, high: float) -> float:
    """Where ``is_below`` turns false between ``low`` and ``high``, by halving the logarithm twenty times.

    Four halvings are one: all places that they could ask at are asked at once.
    """
    first, last = float(np.log(low)), float(np.log(high))
    for _ in range(5):
        cuts = first + (last - first) * FRACTIONS
        part = int(np.count_nonzero(is_below(np.exp(cuts[1:-1]))))
        first, last = float(cuts[part]), float(cuts[part + 1])
    return float(np.exp(0.5 * (first + last)))
