"""Harmonics of the piston acceleration, by order, and how many of them a tolerance needs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.slider_crank import SliderCrank, piston_acceleration
from crankorder.errors import RequestError

ROUND_OFF = 1e-17
"""A harmonic this far below the crank radius no longer changes a sum in double precision."""


def even_harmonics(count: int, crank_ratio: float) -> NDArray[np.float64]:
    """A2, A4, … A_2count of an engine without offset, each with full relative precision, shape (count,).

    −ẍ/(rω²) = cos φ + A2 cos 2φ − A4 cos 4φ + A6 cos 6φ − …

    ``count``: how many, ≥ 0. ``crank_ratio``: λ = r/l, 0 < λ < 1. Raises RequestError outside these ranges.
    Source: truth sheet section 0: A_2k = (4k²/λ)(1+κ')|binom(½,k)| q^k ₂F₁(−½, k−½; k+1; q²), q = (λ/(1+κ'))².
    """
    from scipy.special import hyp2f1

    if not 0 < crank_ratio < 1 or count < 0:
        raise RequestError(
            "no such harmonics", found=f"count {count}, crank ratio {crank_ratio}", allowed="count ≥ 0, 0 < λ < 1"
        )
    k = np.arange(1, count + 1, dtype=np.float64)
    kappa = math.sqrt((1 - crank_ratio) * (1 + crank_ratio))
    q = (crank_ratio / (1 + kappa)) ** 2
    binomial = np.cumprod(np.where(k == 1, 0.5, (k - 1.5) / k))
    series: NDArray[np.float64] = hyp2f1(-0.5, k - 0.5, k + 1, q * q)
    return 4 * k**2 / crank_ratio * (1 + kappa) * binomial * q**k * series


def acceleration_harmonics(mechanism: SliderCrank, max_order: int) -> NDArray[np.complex128]:
    """Complex harmonics of −ẍ/(rω²) by order 0 … ``max_order``, shape (max_order + 1,).

    Term k of the acceleration is Re(c_k exp(2πi k rev)).

    ``mechanism``: lengths in metres. Without offset they come from the hypergeometric form (odd orders above 1 are
    exactly zero); with offset from the Fourier transform of the exact acceleration on enough angles (absolute error
    near 1e-16). ``max_order``: ≥ 1. Raises RequestError below it.
    """
    if max_order < 1:
        raise RequestError("no such order", found=max_order, allowed="≥ 1")
    if mechanism.offset_m == 0:
        harmonics = np.zeros(max_order + 1, dtype=np.complex128)
        harmonics[1] = 1
        even = even_harmonics(max_order // 2, mechanism.crank_ratio)
        harmonics[2::2] = even * np.where(np.arange(even.size) % 2, -1, 1)
        return harmonics
    n_angles = max(64, 1 << (2 * max(max_order, _last_order_above_round_off(mechanism))).bit_length())
    acceleration = piston_acceleration(np.arange(n_angles) / n_angles, mechanism) / mechanism.crank_radius_m
    harmonics = 2 / n_angles * np.fft.rfft(acceleration)[: max_order + 1]
    harmonics[0] = 0  # an acceleration that repeats has no mean
    return harmonics


def orders_for(tolerance: float, mechanism: SliderCrank) -> int:
    """Highest order that a sum of harmonics needs so that its error stays below ``tolerance`` of the peak acceleration.

    ``tolerance``: relative to the peak of the exact acceleration, 1e-16 … 1; smaller costs more orders.
    ``mechanism``: lengths in metres. The error of a truncated sum is bounded by the sum of what was left out (without
    offset this bound is reached at 90°). Raises RequestError for a tolerance outside the range.
    """
    if not 1e-16 <= tolerance <= 1:
        raise RequestError("no such tolerance", found=tolerance, allowed="1e-16 … 1")
    last = _last_order_above_round_off(mechanism)
    size = np.abs(acceleration_harmonics(mechanism, last + 2))
    left_out = np.cumsum(size[::-1])[::-1][1:]
    peak = np.abs(_peak_candidates(mechanism)).max()
    enough = np.flatnonzero(left_out < tolerance * peak)
    highest = int(enough[0]) if enough.size else last
    return max(1, int(np.flatnonzero(size[: highest + 1])[-1]) if highest else 1)


def _last_order_above_round_off(mechanism: SliderCrank) -> int:
    """Order above which harmonics drown in round-off: they fall like √k q^k per even order, q from the steepest rod."""
    steepest = mechanism.crank_ratio + abs(mechanism.offset_ratio)
    kappa = math.sqrt(mechanism.slack * (1 + steepest))
    log_q = 2 * math.log(steepest / (1 + kappa))
    if log_q > -1e-3:
        raise RequestError(
            "the rod is so short that the harmonics do not fall off",
            found=f"1 − λ − |ε| = {mechanism.slack:.3g}",
            allowed="above 1e-7; use the exact acceleration instead",
        )
    return 2 * math.ceil((math.log(ROUND_OFF) - 6) / log_q) + 2


def _peak_candidates(mechanism: SliderCrank) -> NDArray[np.float64]:
    angles: ArrayLike = np.concatenate([np.linspace(0, 1, 4097), [0.25, 0.5, 0.75]])
    return piston_acceleration(angles, mechanism) / mechanism.crank_radius_m
