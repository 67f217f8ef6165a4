"""What each interpolation kernel errs and costs, and which one is the cheapest that errs no more than is allowed."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from crankorder.fft.kernel_design import band_fit
from crankorder.fft.kernel_tables import (
    family_and_number,
    kaiser_error,
    padded_taps,
    pieces_of,
    response_error,
    spline_response,
    taps_of,
)
from crankorder.fft.kernel_vectors import LANES

ROUNDING = {True: 4e-16, False: 2.4e-7}
"""Largest error by rounding over the largest sample, of a kernel of few taps (double or not). Measured."""

ROUNDING_PER_ROOT_TAP = {True: 1e-16, False: 3e-8}
"""What it grows by with the square root of the number of taps."""

COST = {True: (3.2, 0.14), False: (3.2, 0.07)}
"""Time of a value in ns: of any kernel, and more for each tap (double or not). Three channels, measured."""

SPLINE_COST = {3: 4.0, 5: 5.0}
"""Time in ns that the filter before a spline of this degree adds to each value."""

BETWEEN = 1.02
"""What the worst error may be larger than that at the places and frequencies where it is looked for."""

FEWEST_SHARE = 0.5
"""Least-squares kernels need more than this share of the length that Kaiser (1974) gives for a windowed sinc."""


def rounding(taps: int, double: bool) -> float:
    """Error by rounding of a sum of ``taps`` samples, ``double`` or single, over the largest of them."""
    return ROUNDING[double] + ROUNDING_PER_ROOT_TAP[double] * float(taps**0.5)


@lru_cache(maxsize=256)
def error_at(family: str, number: int, pass_band: float, content: float, double: bool) -> float:
    """Largest relative error, for tones up to ``content``, of the kernel ``number`` of ``family`` for ``pass_band``.

    Both are shares of the sample rate. It is the worst complex error over frequencies and places, of the table as it
    is read, and the rounding of sums in double precision if ``double``, else in single.
    """
    pieces = pieces_of(family, number, pass_band)
    n_pieces, _, taps = pieces.shape
    # half a sample tells all; a long kernel affords fewer pieces; in each, the places where a cubic errs most
    chosen = np.unique(np.linspace(0, (n_pieces - 1) // 2, max(8, 1024 // taps)).astype(int))
    inside = np.array([0.0, 0.117, 0.5, 0.883]) if n_pieces > 1 else np.arange(33) / 64
    weights = np.einsum("up,cpt->cut", np.vander(inside, 4), pieces[chosen]).reshape(-1, taps)
    fraction = ((chosen[:, None] + inside) / n_pieces).ravel()
    frequency = content * np.cos(np.linspace(0.0, 0.5 * np.pi, max(24, min(taps, 160)), endpoint=False))
    worst = float(response_error(family, number, weights, fraction, frequency).max())
    # the coefficients of a spline are larger than its values
    gain = 1.0 / float(spline_response(number, np.array([content]))[0]) if family == "bspline" else 1.0
    return BETWEEN * worst + gain * rounding(taps, double)


def cost_of(name: str, double: bool) -> float:
    """Time of a value in ns of the kernel called ``name``, to be compared with others: measured on one machine.

    ``double`` is the precision in which it runs.
    """
    family, number = family_and_number(name)
    fixed, per_tap = COST[double]
    filtering = SPLINE_COST[number] if family == "bspline" else 0.0
    return fixed + per_tap * padded_taps(taps_of(family, number)) + filtering


def cheapest(names: tuple[str, ...], tolerance: float, content: float, double: bool) -> tuple[str, float]:
    """Name of the cheapest of ``names`` that errs no more than ``tolerance``, and its error.

    "" and the least error of all where there is none. ``content`` is the share of the sample rate up to which the
    error holds, ``double`` the precision.
    """
    finest = rounding(LANES, double)
    if tolerance <= finest:
        return "", cheapest(names, 2.0 * finest, content, double)[1]
    best, least = "", np.inf
    kaiser = (-20.0 * np.log10(tolerance) - 7.95) / (4.57 * np.pi * (1.0 - 2.0 * content))
    # of two that cost the same, the one that is fitted to the band errs less
    for name in sorted(names, key=lambda name: (cost_of(name, double), not name.startswith("sinc"))):
        family, number = family_and_number(name)
        if family in ("sinc", "kaiser"):
            if number < FEWEST_SHARE * kaiser and name != names[-1]:
                continue
            # what has not been tabled is quick to judge
            fitted = band_fit(number, content).error if family == "sinc" else 0.5 * kaiser_error(number, content)
            hoped = fitted + rounding(number, double)
            best, least = min((least, best), (hoped, name))[::-1]
            if hoped > tolerance:
                continue
        if (error := error_at(family, number, content, content, double)) <= tolerance:
            return name, error
    return "", error_at(*family_and_number(best), content, content, double)
