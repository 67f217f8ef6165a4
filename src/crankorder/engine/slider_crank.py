"""Exact motion of a slider-crank with piston or pin offset, free of cancellation, and its harmonics by order.

Crank angle is counted from the dead centre of the crank (crank along the cylinder axis, piston up). With an offset the
piston stands highest a little beside it. All derivatives are by crank angle in radians: times speed in rad/s (squared)
they are velocities (accelerations).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError

Angles = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROUND_OFF = 1e-17
"""A harmonic this far below the crank radius no longer changes a sum in double precision."""
LONGEST_RUN_UP = 100_000
"""Steps of the backward recurrence above the highest harmonic, at most; fewer do where 1 − λ > 5e-9."""
SMALLEST_DECAY = 5e-4
"""Decay per order below which harmonics are refused: a million of them would still not be enough."""


@dataclass(frozen=True, kw_only=True)
class SliderCrank:
    """Lengths of a crank mechanism: crank radius, rod length, offset of the cylinder axis from the crankshaft (m)."""

    crank_radius_m: float
    rod_length_m: float
    offset_m: float = 0.0

    def __post_init__(self) -> None:
        lengths = (self.crank_radius_m, self.rod_length_m, self.offset_m)
        if not (np.isfinite(lengths).all() and self.crank_radius_m > 0 and self.slack > 0):
            problem = "a crank needs a positive radius and a rod longer than radius and offset together"
            raise RequestError(problem, found=f"radius {lengths[0]} m, rod {lengths[1]} m, offset {lengths[2]} m")

    @property
    def crank_ratio(self) -> float:
        """λ: crank radius over rod length."""
        return self.crank_radius_m / self.rod_length_m

    @property
    def offset_ratio(self) -> float:
        """ε: offset over rod length."""
        return self.offset_m / self.rod_length_m

    @property
    def slack(self) -> float:
        """1 − λ − |ε|, from the lengths: nothing cancels where the rod is hardly longer than the crank."""
        return (self.rod_length_m - self.crank_radius_m - abs(self.offset_m)) / self.rod_length_m

    @property
    def margin(self) -> float:
        """1 − λ, from the lengths."""
        return self.slack + abs(self.offset_ratio)


@dataclass(frozen=True, kw_only=True)
class DeadCentres:
    """Crank angles at which the piston turns (revolutions), and the way between them (m)."""

    top_rev: float
    bottom_rev: float
    stroke_m: float


def dead_centres(mechanism: SliderCrank) -> DeadCentres:
    """Where the piston stands highest and lowest, and its stroke: with offset more than two crank radii.

    ``mechanism``: lengths in metres. Source: crank and rod in one line, sin φ = e/(l + r) and −sin φ = e/(l − r).
    """
    radius, rod, offset = mechanism.crank_radius_m, mechanism.rod_length_m, mechanism.offset_m
    longest, shortest = rod + radius, mechanism.margin * rod
    high = math.sqrt((longest - offset) * (longest + offset))
    low = math.sqrt((shortest - offset) * (shortest + offset))
    top, bottom = (math.asin(offset / length) / (2 * math.pi) for length in (longest, shortest))
    return DeadCentres(top_rev=top, bottom_rev=0.5 + bottom, stroke_m=4 * radius * rod / (high + low))


def sine_cosine(crank_angle_rev: ArrayLike) -> tuple[Angles, Angles]:
    """Sine and cosine of ``crank_angle_rev`` (revolutions), exact to their own size beside every quarter turn.

    The angle is taken from the nearest quarter turn. Each result has the shape of the angles.
    """
    revolutions = np.asarray(crank_angle_rev, dtype=np.float64)
    quarter = np.rint(4 * revolutions)
    angle = 2 * np.pi * (revolutions - quarter / 4)
    sine, cosine = np.sin(angle), np.cos(angle)
    turn = np.mod(quarter, 4)
    swapped = np.mod(turn, 2) == 1
    sign_sine = np.where(turn >= 2, -1.0, 1.0)
    sign_cosine = np.where((turn == 1) | (turn == 2), -1.0, 1.0)
    return sign_sine * np.where(swapped, cosine, sine), sign_cosine * np.where(swapped, sine, cosine)


def piston_drop(crank_angle_rev: ArrayLike, mechanism: SliderCrank) -> Angles:
    """Way of the piston down from its place at crank angle zero (m), exact near the dead centre too.

    ``crank_angle_rev``: revolutions, any shape. ``mechanism``: lengths in metres. Returns the shape of the angles.
    Source: truth sheet section 0, with the offset carried through.
    """
    sine, cosine = sine_cosine(crank_angle_rev)
    _, rod_cosine = rod_direction(sine, cosine, mechanism)
    rod_cosine_top = np.sqrt((1 - mechanism.offset_ratio) * (1 + mechanism.offset_ratio))
    lean = mechanism.crank_ratio * sine - 2 * mechanism.offset_ratio
    versine = np.where(cosine > 0, sine**2 / (1 + np.abs(cosine)), 1 - cosine)
    drop: Angles = mechanism.crank_radius_m * (versine + sine * lean / (rod_cosine_top + rod_cosine))
    return drop


def piston_velocity(crank_angle_rev: ArrayLike, mechanism: SliderCrank) -> Angles:
    """Velocity of the piston away from the crankshaft per unit of crank speed (m/rad).

    ``crank_angle_rev``: revolutions, any shape. ``mechanism``: lengths in metres. Returns the shape of the angles.
    Source: −x'/r = sin φ + cos φ tan ψ; below the middle, where the two cancel, 1 + λ cos φ / cos ψ is rewritten as
    (cos²ψ − λ² cos²φ) / (cos ψ (cos ψ − λ cos φ)), truth sheet section 0, with the offset carried through.
    """
    ratio, offset = mechanism.crank_ratio, mechanism.offset_ratio
    sine, cosine = sine_cosine(crank_angle_rev)
    rod_sine, rod_cosine = rod_direction(sine, cosine, mechanism)
    flat, lean, size = _flat_rod(sine, mechanism)
    # cos² ψ - λ² cos² φ = 1 - (λ - e)² - 2 λ e (1 - |sin φ|), e the offset counted towards the side of the crank
    rest = flat - 2 * ratio * lean * cosine**2 / (1 + size)
    lower = sine * rest / (rod_cosine * (rod_cosine + ratio * np.abs(cosine))) - offset * cosine / rod_cosine
    return -mechanism.crank_radius_m * np.where(cosine < 0, lower, sine + cosine * rod_sine / rod_cosine)


def piston_acceleration(crank_angle_rev: ArrayLike, mechanism: SliderCrank) -> Angles:
    """Acceleration of the piston towards the crankshaft per squared crank speed (m/rad²): −ẍ/ω².

    ``crank_angle_rev``: revolutions, any shape. ``mechanism``: lengths in metres. Returns the shape of the angles.
    Mass times this times ω² is the inertia force on the crankcase along the cylinder, away from the crankshaft.
    Source: truth sheet section 0; with offset sin ψ = λ sin φ − ε.
    """
    from crankorder.engine.compiled_slider_crank import fill_acceleration

    # one kind of array keeps one compiled form: a read-only one would be compiled anew
    revolutions = np.require(crank_angle_rev, dtype=np.float64, requirements=("C", "W"))
    acceleration: Angles = np.empty(revolutions.size)
    ratio, offset, margin = mechanism.crank_ratio, mechanism.offset_ratio, mechanism.margin
    fill_acceleration(revolutions.ravel(), mechanism.crank_radius_m, ratio, offset, margin, acceleration)
    return acceleration.reshape(revolutions.shape)


def plain_piston_acceleration(crank_angle_rev: ArrayLike, mechanism: SliderCrank) -> Angles:
    """The same as :func:`piston_acceleration` in plain NumPy: slower, and the test of the compiled one.

    ``crank_angle_rev``: revolutions, any shape. ``mechanism``: lengths in metres. Returns the shape of the angles.
    """
    sine, cosine = sine_cosine(crank_angle_rev)
    rod_sine, rod_cosine = rod_direction(sine, cosine, mechanism)
    swing = (mechanism.crank_ratio * cosine**2 - sine * rod_sine * rod_cosine**2) / rod_cosine**3
    return mechanism.crank_radius_m * (cosine + swing)


def fastest_piston(mechanism: SliderCrank) -> tuple[float, float]:
    """Crank angle (revolutions) at which the piston goes down fastest, and its speed there over that of the crank (m).

    ``mechanism``: lengths in metres. Found between the dead centres, where the acceleration turns.
    """
    turns = dead_centres(mechanism)
    low, high = turns.top_rev, turns.bottom_rev
    for _ in range(60):  # halves: to the last digit
        middle = (low + high) / 2
        low, high = (middle, high) if plain_piston_acceleration(middle, mechanism) > 0 else (low, middle)
    return low, abs(float(piston_velocity(low, mechanism)))


def rod_angle(crank_angle_rev: ArrayLike, mechanism: SliderCrank) -> tuple[Angles, Angles, Angles]:
    """Rod angle from the cylinder axis (rad) with its first and second derivative by crank angle.

    ``crank_angle_rev``: revolutions, any shape. ``mechanism``: lengths in metres. Each result has the shape of the
    angles. The rod turns against the crank: its angular acceleration in the crank's sense is −ψ'' ω².
    Source: truth sheet section 0; with offset ψ'' = −λ (|s| (1 − (λ − e)²) + λ e (1 − |s|)²) sign(s) / cos³ψ, where
    s = sin φ and e = ε sign(s): nothing cancels where the rod lies flat.
    """
    ratio = mechanism.crank_ratio
    sine, cosine = sine_cosine(crank_angle_rev)
    rod_sine, rod_cosine = rod_direction(sine, cosine, mechanism)
    flat, lean, size = _flat_rod(sine, mechanism)
    short = cosine**2 / (1 + size)
    second = -ratio * np.where(sine < 0, -1.0, 1.0) * (size * flat + ratio * lean * short**2) / rod_cosine**3
    return np.arctan2(rod_sine, rod_cosine), ratio * cosine / rod_cosine, second


def rod_direction(sine: Angles, cosine: Angles, mechanism: SliderCrank) -> tuple[Angles, Angles]:
    """Sine and cosine of the rod angle from the cylinder axis, exact to their own size where the rod lies flat.

    ``sine``, ``cosine``: of the crank angle, any shape. ``mechanism``: lengths in metres. Each result has that shape;
    the cosine is above zero. Source: sin ψ = λ sin φ − ε; the cosine by the factors of 1 − sin²ψ.
    """
    ratio, offset = mechanism.crank_ratio, mechanism.offset_ratio
    side = np.where(sine < 0, -1.0, 1.0)
    rod_sine = ratio * sine - offset
    # 1 - side * rod_sine = (1 - λ + side ε) + λ (1 - |sin φ|), and 1 - |sin φ| = cos² φ / (1 + |sin φ|)
    margin = mechanism.slack + (abs(offset) + side * offset)
    near = margin + ratio * cosine**2 / (1 + np.abs(sine))
    return rod_sine, np.sqrt(near * (1 + side * rod_sine))


def _flat_rod(sine: Angles, mechanism: SliderCrank) -> tuple[Angles, Angles, Angles]:
    """cos²ψ at 90° on the side of the crank, the offset counted towards that side over the rod length, and |sin φ|."""
    lean = np.where(sine < 0, -mechanism.offset_ratio, mechanism.offset_ratio)
    return (mechanism.margin + lean) * (1 + mechanism.crank_ratio - lean), lean, np.abs(sine)


# The series by order: harmonics of piston and rod acceleration, and how many of them a tolerance needs.


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
        allowed = "count ≥ 0, 0 < λ < 1"
        raise RequestError("no such harmonics", found=f"count {count}, crank ratio {crank_ratio}", allowed=allowed)
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
    shortfalls = np.empty(max(count - 1, 0))
    for k in range(start, 1, -1):
        carried = (k + 1.5) * squared * short
        short = (1.5 * rest + carried) / (k - 1.5 * squared + carried)
        if k <= count:
            shortfalls[k - 2] = short
    return shortfalls


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
        problem = "the rod is so short that the harmonics do not fall off"
        allowed = "above 1e-7; use the exact acceleration instead"
        raise RequestError(problem, found=f"1 − λ − |ε| = {mechanism.slack:.3g}", allowed=allowed)
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
    # the root of the product would take the wrong branch beside the branch points
    cosines = [np.sqrt(1 - rod_sine) * np.sqrt(1 + rod_sine) for rod_sine in (across - offset, across + offset)]
    return np.reciprocal(cosines[0], dtype=np.complex128), np.reciprocal(cosines[1], dtype=np.complex128)


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
