"""Harmonics of piston and rod acceleration, by order, and how many of them a tolerance needs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.slider_crank import SliderCrank, piston_acceleration
from crankorder.errors import RequestError

Complex = NDArray[np.complex128]

ROUND_OFF = 1e-17
"""A harmonic this far below the crank radius no longer changes a sum in double precision."""
LONGEST_RUN_UP = 100_000
"""Steps of the backward recurrence above the highest harmonic, at most; fewer do where 1 − λ > 5e-9."""
SMALLEST_DECAY = 5e-4
"""Decay per order below which harmonics are refused: a million of them would still not be enough."""


def even_harmonics(count: int, crank_ratio: float) -> NDArray[np.float64]:
    """A2, A4, … A_2count of an engine without offset, each with full relative precision, shape (count,).

    −ẍ/(rω²) = cos φ + A2 cos 2φ − A4 cos 4φ + A6 cos 6φ − …

    ``count``: how many, ≥ 0. ``crank_ratio``: λ = r/l, 0 < λ < 1. Raises RequestError outside these ranges.
    Where 1 − λ < 5e-9 order 2000 keeps nine digits.
    Source: truth sheet section 0: A_2k = (4k²/λ)(1+κ')|binom(½,k)| q^k ₂F₁(−½, k−½; k+1; q²), q = (λ/(1+κ'))², for
    the first; the others by the recurrence of the Fourier coefficients of √(1 − λ² sin²φ), run backward (J. C. P.
    Miller, 1952): the series loses its digits at high orders of a short rod.
    """
    if not 0 < crank_ratio < 1 or count < 0:
        raise RequestError(
            "no such harmonics", found=f"count {count}, crank ratio {crank_ratio}", allowed="count ≥ 0, 0 < λ < 1"
        )
    return _even_harmonics(count, crank_ratio, 1 - crank_ratio)


def _even_harmonics(count: int, crank_ratio: float, margin: float) -> NDArray[np.float64]:
    """The same where 1 − λ is known better than λ tells it: from the lengths."""
    from scipy.special import hyp2f1

    kappa = math.sqrt(margin * (1 + crank_ratio))
    decay = 2 * math.log1p((margin + kappa) / crank_ratio)  # −log q
    k = np.arange(1, count + 1, dtype=np.float64)
    steps = np.concatenate([[1.0], 1 - _coefficient_shortfalls(count, decay)])[:count]
    first = 2 / crank_ratio * (1 + kappa) * float(hyp2f1(-0.5, 0.5, 2, math.exp(-2 * decay)))
    return first * k**2 * np.cumprod(steps) * np.exp(-decay * k)


def _coefficient_shortfalls(count: int, decay: float) -> NDArray[np.float64]:
    """d_k = 1 − |c_k / c_k−1| / q for k = 2 … ``count``, c_k the coefficient of cos 2kφ in √(1 − λ² sin²φ).

    From 2kβ c_k + (k − 3/2) c_k−1 + (k + 3/2) c_k+1 = 0, 2β = q + 1/q: no terms that cancel, and
    what is wrong with the start, c_k ∝ K₁(−k log q)/k for large k, fades as q^2k.
    """
    from scipy.special import k1e

    squared, rest = math.exp(-2 * decay), -math.expm1(-2 * decay)
    start = count + min(math.ceil(20 / decay) + 1, LONGEST_RUN_UP)
    short = 1 - (start - 1) / start * float(k1e(decay * start) / k1e(decay * (start - 1)))
    found = np.empty(max(count - 1, 0))
    for k in range(start, 1, -1):
        carried = (k + 1.5) * squared * short
        short = (1.5 * rest + carried) / (k - 1.5 * squared + carried)
        if k <= count:
            found[k - 2] = short
    return found


def acceleration_harmonics(mechanism: SliderCrank, max_order: int) -> Complex:
    """Complex harmonics of −ẍ/(rω²) by order 0 … ``max_order``, shape (max_order + 1,).

    Term k of the acceleration is Re(c_k exp(2πi k rev)). An offset brings odd orders above 1 and a quadrature part of
    the first: odd orders are 1 (first order only) minus i times a sine part, even orders are real.

    ``mechanism``: lengths in metres. Without offset the harmonics come from a recurrence, with offset from
    Fourier sums along paths beside the real crank angle: each keeps its relative precision, however small it is.
    ``max_order``: ≥ 1. Raises RequestError below it, and with offset where the rod is so short that the harmonics do
    not fall off.
    """
    if max_order < 1:
        raise RequestError("no such order", found=max_order, allowed="≥ 1")
    harmonics = np.zeros(max_order + 1, dtype=np.complex128)
    if mechanism.offset_m == 0:
        even = _even_harmonics(max_order // 2, mechanism.crank_ratio, mechanism.margin)
        harmonics[2::2] = even * np.where(np.arange(even.size) % 2, -1, 1)
    else:
        harmonics[2::2] = _fourier(_swing_shared, mechanism, max_order)[2::2].real
        harmonics[1::2] = 1j * _fourier(_swing_by_offset, mechanism, max_order)[1::2].imag
    harmonics[1] += 1
    return harmonics


def rod_acceleration_harmonics(mechanism: SliderCrank, max_order: int) -> Complex:
    """Complex harmonics of the rod's angular acceleration over ω², counted in the crank's sense, (max_order + 1,).

    This is −ψ''; without offset it has sine parts of odd orders only. It drives the couple that two masses in place of
    the rod miss.

    ``mechanism``: lengths in metres. ``max_order``: ≥ 1. Relative precision as of the largest neighbour (with a tiny
    offset the even orders lose digits). Raises RequestError below the first order or where they do not fall off.
    Source: truth sheet 2.7, λκ'² sin φ / cos³ψ; with offset −λ (κ'² s + ε (λ (1 + s²) − ε s)) / cos³ψ, s = sin φ.
    """
    if max_order < 1:
        raise RequestError("no such order", found=max_order, allowed="≥ 1")
    harmonics = np.zeros(max_order + 1, dtype=np.complex128)
    every = _fourier(_rod_acceleration, mechanism, max_order)
    harmonics[1::2] = 1j * every[1::2].imag
    if mechanism.offset_m != 0:
        harmonics[2::2] = every[2::2].real
    return harmonics


def orders_for(tolerance: float, mechanism: SliderCrank) -> int:
    """Highest order that a sum of harmonics needs so that its error stays below ``tolerance`` of the peak acceleration.

    ``tolerance``: relative to the peak of the exact acceleration, 1e-16 … 1; smaller costs more orders.
    ``mechanism``: lengths in metres. The error of a truncated sum is bounded by the sum of what was left out (without
    offset this bound is reached at 90°). Raises RequestError for a tolerance outside the range and where the harmonics
    do not fall off or have no finite sum.
    """
    if not 1e-16 <= tolerance <= 1:
        raise RequestError("no such tolerance", found=tolerance, allowed="1e-16 … 1")
    last = last_order_above_round_off(mechanism)
    size = np.abs(acceleration_harmonics(mechanism, last + 2))
    left_out = np.cumsum(size[::-1])[::-1][1:]
    if not np.isfinite(left_out).all():  # no comparison with them means anything
        raise RequestError("the harmonics of this crank have no finite sum", found=f"λ = {mechanism.crank_ratio:.17g}")
    enough = np.flatnonzero(left_out < tolerance * peak_acceleration(mechanism))
    highest = int(enough[0]) if enough.size else last
    return max(1, int(np.flatnonzero(size[: highest + 1])[-1]) if highest else 1)


def peak_acceleration(mechanism: SliderCrank) -> float:
    """Largest −ẍ/(rω²) of a turn, either sign; ``mechanism``: lengths in metres.

    Without offset it is 1 + λ or λ/κ', whichever is more; with offset it is the largest of 4097 angles.
    """
    if mechanism.offset_m == 0:
        ratio = mechanism.crank_ratio
        return max(1 + ratio, ratio / math.sqrt(mechanism.margin * (1 + ratio)))
    turn = piston_acceleration(np.linspace(0, 1, 4097), mechanism)
    return float(np.abs(turn).max() / mechanism.crank_radius_m)


def last_order_above_round_off(mechanism: SliderCrank) -> int:
    """Order above which the harmonics of ``mechanism`` drown in round-off: they fall as √k exp(−k · decay)."""
    return 2 * math.ceil((6 - math.log(ROUND_OFF)) / (2 * _decay(mechanism))) + 2


def _decay(mechanism: SliderCrank) -> float:
    """Distance of the nearest branch point, cos ψ = 0, from the real crank angles: arcosh((1 − |ε|)/λ)."""
    above_one = mechanism.slack / mechanism.crank_ratio
    decay = math.log1p(above_one + math.sqrt(above_one * (above_one + 2)))
    if decay < SMALLEST_DECAY:
        raise RequestError(
            "the rod is so short that the harmonics do not fall off",
            found=f"1 − λ − |ε| = {mechanism.slack:.3g}",
            allowed="above 1e-7; use the exact acceleration instead",
        )
    return decay


def _fourier(motion: Callable[[Complex, Complex, SliderCrank], Complex], mechanism: SliderCrank, top: int) -> Complex:
    """Harmonics 0 … ``top`` of ``motion``, given by sine and cosine of the crank angle.

    On the path φ − iy a harmonic is exp(ky) larger: as large as the others, instead of far below their round-off. Each
    octave of orders has its own path, two orders' decay short of the branch point.
    """
    decay = _decay(mechanism)
    harmonics = np.zeros(top + 1, dtype=np.complex128)
    low, high = 0, 8
    while low <= top:
        short = min(decay, 2 / high)
        n_angles = 1 << math.ceil(math.log2(40 / short + 2 * high))
        path = 2 * np.pi * np.arange(n_angles) / n_angles - 1j * (decay - short)
        values = motion(np.sin(path), np.cos(path), mechanism)
        orders = np.arange(low, min(high, top + 1))
        harmonics[orders] = 2 / n_angles * np.fft.fft(values)[orders] * np.exp(-(decay - short) * orders)
        low, high = high, 2 * high
    return harmonics


def _inverse_rod_cosines(sine: Complex, mechanism: SliderCrank) -> tuple[Complex, Complex]:
    """1 / cos ψ with the offset as it is and on the other side."""
    across, offset = mechanism.crank_ratio * sine, mechanism.offset_ratio
    return _inverse_rod_cosine(across - offset), _inverse_rod_cosine(across + offset)


def _inverse_rod_cosine(rod_sine: Complex) -> Complex:
    # the root of the product would take the wrong branch beside the branch points
    inverse: Complex = np.reciprocal(np.sqrt(1 - rod_sine) * np.sqrt(1 + rod_sine), dtype=np.complex128)
    return inverse


def _swing_shared(sine: Complex, cosine: Complex, mechanism: SliderCrank) -> Complex:
    """Part of −ẍ/(rω²) − cos φ that both sides of the offset share: the even orders."""
    ratio, offset = mechanism.crank_ratio, mechanism.offset_ratio
    this, other = _inverse_rod_cosines(sine, mechanism)
    rising = (ratio * sine - offset) * this + (ratio * sine + offset) * other
    return 0.5 * (ratio * cosine**2 * (this**3 + other**3) - sine * rising)


def _swing_by_offset(sine: Complex, cosine: Complex, mechanism: SliderCrank) -> Complex:
    """Part that changes sign with the offset, as a product with it: the odd orders, exact for the smallest offset."""
    ratio, offset = mechanism.crank_ratio, mechanism.offset_ratio
    this, other = _inverse_rod_cosines(sine, mechanism)
    gap = -4 * ratio * offset * sine * (this * other) ** 2 / (this + other)  # this - other
    cubes = gap * (this**2 + this * other + other**2)
    return 0.5 * (ratio * (cosine**2 * cubes - sine**2 * gap) + offset * sine * (this + other))


def _rod_acceleration(sine: Complex, _cosine: Complex, mechanism: SliderCrank) -> Complex:
    ratio, offset = mechanism.crank_ratio, mechanism.offset_ratio
    this, _ = _inverse_rod_cosines(sine, mechanism)
    kappa_squared = mechanism.margin * (1 + ratio)
    return ratio * (kappa_squared * sine + offset * (ratio * (1 + sine**2) - offset * sine)) * this**3
