"""Interpolation weights of given length that err least over a given band."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Weights = NDArray[np.float64]

LAWSON_ROUNDS = 3
"""Rounds of reweighting. The first takes a fifth off the worst error, the fourth would take a hundredth."""

COARSE = np.linspace(0.0, 0.5, 9)[1:]
"""Fractions of a step that stand for all where only the size of the error is wanted."""


class _LeastSquares:
    """The least-squares inverse of ``matrix``, its rows weighted; directions that rounding has eaten are left out."""

    def __init__(self, matrix: Weights, weight: Weights) -> None:
        self._weight = weight[:, None]
        left, values, right = np.linalg.svd(self._weight * matrix, full_matrices=False)
        kept = values > 1e-15 * values[0]
        self._left, self._values, self._right = left[:, kept].T, values[kept, None], right[kept].T

    def __call__(self, wanted: Weights) -> Weights:
        # one factor after the other: their product would lose what the small singular values carry
        return np.asarray(self._right @ (self._left @ (self._weight * wanted) / self._values))


class BandFit:
    """Weights of a kernel of even length whose worst error up to a pass band is nearly the least possible.

    At each fraction of a step the response to tones is fitted to the tones themselves by least squares over Chebyshev
    points of the band, the even and the odd part of the weights apart. Rounds of reweighting (Lawson 1961) bring the
    least mean error towards the least worst error. The weights sum to 1 at every fraction, and on a sample they are
    that sample. (The aim: Laakso, Välimäki, Karjalainen, Laine 1996, "Splitting the unit delay".)
    """

    def __init__(self, taps: int, pass_band: float) -> None:
        """Fit for an even number of ``taps`` and content up to ``pass_band`` (share of the sample rate, below 0.5)."""
        half = self._half = taps // 2
        n_points = taps + 16
        # from the edge of the band, which counts most, down to near zero, where the sum of 1 holds the response
        self._turn = 2.0 * np.pi * pass_band * np.cos(np.linspace(0.0, 0.5 * np.pi, n_points, endpoint=False))[:, None]
        angle = self._turn * (np.arange(half) + 0.5)
        self._even, self._odd = 2.0 * np.cos(angle), 2.0 * np.sin(angle)
        # even weights: equal ones, and a combination of vectors that sum to zero
        self._equal = np.full((half, 1), 0.5 / half)
        self._free = np.linalg.qr(np.ones((half, 1)), mode="complete")[0][:, 1:]
        emphasis = np.ones(n_points)
        self._solve(emphasis)
        for _ in range(LAWSON_ROUNDS):
            emphasis *= self._misfit(COARSE).max(axis=1) + 1e-30
            emphasis /= emphasis.mean()
            self._solve(emphasis)
        self.error = float(self._misfit(COARSE).max())

    def _solve(self, emphasis: Weights) -> None:
        root = np.sqrt(emphasis)
        self._even_of = _LeastSquares(self._even @ self._free, root)
        self._odd_of = _LeastSquares(self._odd, root)

    def _parts(self, fraction: Weights) -> tuple[Weights, Weights]:
        angle = self._turn * (fraction - 0.5)
        even = self._equal + self._free @ self._even_of(np.cos(angle) - self._even @ self._equal)
        return even, self._odd_of(np.sin(angle))

    def _misfit(self, fraction: Weights) -> Weights:
        """Error (band points, fractions) of the response."""
        even, odd = self._parts(fraction)
        angle = self._turn * (fraction - 0.5)
        return np.hypot(self._even @ even - np.cos(angle), self._odd @ odd - np.sin(angle))

    def weights(self, fraction: Weights) -> Weights:
        """Weights (fractions, taps) at each ``fraction`` (fractions,), 0…1, of a step."""
        even, odd = self._parts(fraction)
        weights = np.concatenate([(even - odd)[::-1], even + odd]).T
        places = np.arange(1 - self._half, 1 + self._half)
        for sample in (0, 1):
            weights[fraction == sample] = places == sample
        return np.asarray(weights)


@lru_cache(maxsize=64)
def band_fit(taps: int, pass_band: float) -> BandFit:
    """The BandFit of ``taps`` for content up to ``pass_band`` of the sample rate; made once."""
    return BandFit(taps, pass_band)
