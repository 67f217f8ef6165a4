"""Weights of every interpolation kernel, as one kind of table: cubics in the fraction of a sample, piece by piece."""

from __future__ import annotations

from functools import lru_cache
from math import comb, factorial

import numpy as np
from numpy.typing import NDArray

from crankorder.fft.kernel_design import band_fit
from crankorder.fft.kernel_vectors import LANES

Weights = NDArray[np.float64]

MOST_TAPS = 512
"""Longest least-squares kernel that is offered: content up to 0.98 of the Nyquist frequency within 1e-7."""

ROUNDING_FLOOR = 1e-13
"""Error below which a finer table gains nothing: positions are rounded more coarsely than that."""

_NODES = 0.5 + 0.5 * np.array([-1.0, 1.0 - np.sqrt(2.0), np.sqrt(2.0) - 1.0, 1.0])
"""Where a cubic meets the weights inside its piece: the ends, so that pieces join, and two that level its error."""

CUBIC_ERROR = (3.0 - 2.0 * np.sqrt(2.0)) / 384.0
"""Largest error of such a cubic over fourth derivative times piece width to the fourth."""

FAMILIES = {"lagrange": (4, 6), "bspline": (3, 5)}
"""Families of fixed length: points of Lagrange's polynomial, degrees of the spline."""

SPLINE_POLES = {
    3: (-0.2679491924311227,),
    5: (-0.4305753470999738, -0.04309628820326465),
}
"""Poles of the filters that turn samples into coefficients of a spline (Unser 1999, table 2 of its appendix)."""


def family_and_number(name: str) -> tuple[str, int]:
    """Family and number of the kernel called ``name``: ("sinc", 16) of sinc-16; ("", 0) where there is none such."""
    family, _, text = name.partition("-")
    number = int(text) if text.isascii() and text.isdecimal() and len(text) < 5 else 0
    known = number in FAMILIES.get(family, ())
    if family in ("sinc", "kaiser"):
        known = number % 2 == 0 and 4 <= number <= MOST_TAPS
    return (family, number) if known else ("", 0)


def taps_of(family: str, number: int) -> int:
    """Samples that a value of the kernel ``number`` of ``family`` is made from."""
    return number + 1 if family == "bspline" else number


def padded_taps(taps: int) -> int:
    """``taps`` filled up with zeros at both ends to whole vectors of LANES."""
    return -(-taps // LANES) * LANES


def sample_offsets(taps: int) -> NDArray[np.int64]:
    """Places (``taps``,) of the samples relative to the one at or before the position."""
    return np.arange(taps) - (taps // 2 - 1)


def lagrange_weights(points: int, fraction: Weights) -> Weights:
    """Weights (fractions, ``points``) of the polynomial through the nearest points, at ``fraction`` (0…1) of a step."""
    places = sample_offsets(points).astype(np.float64)
    columns = []
    for place in places:
        others = places[places != place]
        columns.append(np.prod((fraction[:, None] - others) / (place - others), axis=1))
    return np.stack(columns, axis=1)


def spline_weights(degree: int, fraction: Weights) -> Weights:
    """B-splines of odd ``degree`` (fractions, degree + 1) about ``fraction`` (0…1) of a step (Unser 1999, eq. 8)."""
    distance = np.abs(fraction[:, None] - sample_offsets(degree + 1))
    reach = 0.5 * (degree + 1)
    # from the outer end, where few terms are left and none cancel
    terms = [(-1) ** k * comb(degree + 1, k) * np.maximum(reach - k - distance, 0.0) ** degree for k in range(degree)]
    return np.asarray(np.sum(terms, axis=0) / factorial(degree))


def kaiser_error(taps: int, pass_band: float) -> float:
    """Error that Kaiser (1974) expects of a windowed sinc of ``taps`` for content up to ``pass_band`` of the rate."""
    return float(10.0 ** (-0.05 * (4.57 * np.pi * (1.0 - 2.0 * pass_band) * (taps - 1) + 7.95)))


def windowed_weights(taps: int, pass_band: float, fraction: Weights) -> Weights:
    """Weights (fractions, ``taps``) of a sinc under a Kaiser window, which passes up to ``pass_band`` of the rate.

    It errs a little more there than weights fitted to the band, at each ``fraction`` (0…1) of a step alone, but it is
    smooth: of what lies above the band it leaves one image, next to the Nyquist frequency, and no others.
    """
    decibel = max(-20.0 * np.log10(kaiser_error(taps, pass_band)), 22.0)
    beta = 0.1102 * (decibel - 8.7) if decibel > 50.0 else 0.5842 * (decibel - 21.0) ** 0.4 + 0.07886 * (decibel - 21.0)
    distance = sample_offsets(taps) - fraction[:, None]
    bell = np.i0(beta * np.sqrt(np.clip(1.0 - (2.0 * distance / taps) ** 2, 0.0, None)))
    weights = np.where(distance == np.round(distance), distance == 0.0, np.sinc(distance) * bell)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def cubic_pieces(weights: Weights) -> Weights:
    """Coefficients (pieces, 4, taps), highest power first, of cubics through ``weights`` (pieces, 4 nodes, taps)."""
    inverse = np.linalg.inv(np.vander(_NODES, 4))
    coefficients = np.einsum("dn,pnt->pdt", inverse, weights)
    # the cubic begins exactly on its first row: what is exact there stays so
    coefficients[:, 3] = weights[:, 0]
    return np.asarray(coefficients)


def kernel_weights(family: str, number: int, pass_band: float, fraction: Weights) -> Weights:
    """Weights (fractions, taps) of the kernel ``number`` of ``family`` at ``fraction`` (0…1) of a step, before tabling.

    ``pass_band`` shapes the windowed (kaiser) and the least-squares family (sinc) alone.
    """
    if family == "lagrange":
        return lagrange_weights(number, fraction)
    if family == "bspline":
        return spline_weights(number, fraction)
    if family == "kaiser":
        return windowed_weights(number, pass_band, fraction)
    return band_fit(number, pass_band).weights(fraction)


def spline_response(degree: int, frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """Value over coefficient (frequencies,), on the samples, of a tone of ``frequency`` in a spline of ``degree``."""
    places = sample_offsets(degree + 1)
    row = spline_weights(degree, np.zeros(1))[0]
    return np.asarray(np.cos(2.0 * np.pi * frequency[:, None] * places) @ row)


def response_error(
    family: str, number: int, weights: Weights, fraction: Weights, frequency: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Error of the value of a unit tone (frequencies, fractions), complex magnitude.

    ``weights`` (fractions, taps) belong to ``fraction`` (fractions,) of a step and to the kernel ``number`` of
    ``family``; ``frequency`` (frequencies,) is in shares of the sample rate.
    """
    turn = 2j * np.pi * frequency[:, None]
    response = np.exp(turn * sample_offsets(weights.shape[1])) @ weights.T
    if family == "bspline":
        response /= spline_response(number, frequency)[:, None]
    return np.asarray(np.abs(response * np.exp(-turn * fraction) - 1.0))


@lru_cache(maxsize=32)
def pieces_of(family: str, number: int, pass_band: float) -> Weights:
    """Cubics (pieces, 4, taps) of the kernel ``number`` of ``family`` for content up to ``pass_band`` of the rate.

    There are as many pieces as keep the error between their nodes below a quarter of the kernel's own.
    """
    n_pieces = 1 if number < 5 and family in FAMILIES else 128
    if family not in FAMILIES:
        own = kaiser_error(number, pass_band) if family == "kaiser" else band_fit(number, pass_band).error
        allowed = max(4.0 * ROUNDING_FLOOR, own) / 4.0
        least = 2.0 * np.pi * (0.5 if family == "kaiser" else pass_band) * (CUBIC_ERROR / allowed) ** 0.25
        n_pieces = max(8, 2 * int(np.ceil(0.5 * least)))
    n_made = -(-n_pieces // 2)
    fraction = (np.arange(n_made)[:, None] + _NODES) / n_pieces
    weights = kernel_weights(family, number, pass_band, fraction.ravel()).reshape(n_made, 4, -1)
    if n_pieces > 1:
        weights = np.concatenate([weights, weights[::-1, ::-1, ::-1]])
    return cubic_pieces(weights)


@lru_cache(maxsize=32)
def low_pass_shape(pass_band: float, error: float) -> tuple[float, Weights]:
    """Reach in steps, and cubics (pieces, 4) over 0…reach, of the even low-pass that is stretched against folding.

    A Kaiser-windowed sinc (Kaiser 1974) that passes what lies below ``pass_band`` of the rate and stops what lies
    above 1 - ``pass_band``, each within ``error``.
    """
    decibel = 18.0 - 20.0 * np.log10(min(max(error, 1e-13), 1e-2))
    beta = 0.1102 * (decibel - 8.7)
    reach = max(2.0, 0.5 + 0.5 * (decibel - 7.95) / (2.285 * 2.0 * np.pi * (1.0 - 2.0 * pass_band)))
    per_step = np.ceil((2.0 * np.pi**4 * CUBIC_ERROR * 2.0 * reach / max(error, 1e-13)) ** 0.25)
    n_pieces = int(np.ceil(per_step * reach))
    distance = reach * (np.arange(n_pieces)[:, None] + _NODES) / n_pieces
    bell = np.i0(beta * np.sqrt(np.clip(1.0 - (distance / reach) ** 2, 0.0, None))) / np.i0(beta)
    return float(reach), np.ascontiguousarray(cubic_pieces((np.sinc(distance) * bell)[:, :, None])[:, :, 0])


def spline_gain(poles: tuple[float, ...]) -> float:
    """Gain that makes the filter of ``poles``, run both ways, pass a constant."""
    return float(np.prod([(1.0 - pole) ** 2 for pole in poles]))


@lru_cache(maxsize=32)
def table_of(family: str, number: int, pass_band: float, double: bool) -> NDArray[np.floating]:
    """Pieces of :func:`pieces_of` in the order in which they are read: piece, vector of taps, power, lane; flat.

    ``family``, ``number`` and ``pass_band`` name the kernel; ``double`` asks for float64 numbers, else float32.
    """
    pieces = _rounded(pieces_of(family, number, pass_band), np.float64 if double else np.float32)
    taps = pieces.shape[2]
    width = padded_taps(taps)
    before = (width - taps) // 2
    padded = np.pad(pieces, ((0, 0), (0, 0), (before, width - taps - before)))
    vectors = padded.reshape(len(pieces), 4, width // LANES, LANES).transpose(0, 2, 1, 3)
    flat = np.ascontiguousarray(vectors).ravel()
    return flat if double else flat.astype(np.float32)


def _rounded(pieces: Weights, dtype: type[np.floating]) -> Weights:
    """``pieces`` in numbers of ``dtype`` that sum exactly to 1 and 0, 0, 0: a constant must not suffer."""
    rounded = pieces.astype(dtype).astype(np.longdouble)
    lost = np.array([0.0, 0.0, 0.0, 1.0])[:, None] - rounded.sum(axis=2, keepdims=True)
    middle = pieces.shape[2] // 2
    near = slice(max(0, middle - 4), middle + 4)
    # into a small number near the middle, which is fine enough to take it up
    place = near.start + np.abs(rounded[:, :, near]).argmin(axis=2)[:, :, None]
    np.put_along_axis(rounded, place, np.take_along_axis(rounded, place, axis=2) + lost, axis=2)
    return rounded.astype(np.float64)
