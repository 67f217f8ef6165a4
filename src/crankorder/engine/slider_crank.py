"""Exact motion of a slider-crank with piston or pin offset, free of cancellation however short the rod.

Crank angle is counted from the dead centre of the crank (crank along the cylinder axis, piston up). With an offset the
piston stands highest a little beside it. All derivatives are by crank angle in radians: times speed in rad/s (squared)
they are velocities (accelerations).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError

Angles = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SliderCrank:
    """Lengths of a crank mechanism: crank radius, rod length, offset of the cylinder axis from the crankshaft (m)."""

    crank_radius_m: float
    rod_length_m: float
    offset_m: float = 0.0

    def __post_init__(self) -> None:
        lengths = (self.crank_radius_m, self.rod_length_m, self.offset_m)
        if not (np.isfinite(lengths).all() and self.crank_radius_m > 0 and self.slack > 0):
            raise RequestError(
                "a crank needs a positive radius and a rod longer than radius and offset together",
                found=f"radius {lengths[0]} m, rod {lengths[1]} m, offset {lengths[2]} m",
            )

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
    turn = 2 * math.pi
    return DeadCentres(
        top_rev=math.asin(offset / longest) / turn,
        bottom_rev=0.5 + math.asin(offset / shortest) / turn,
        stroke_m=4 * radius * rod / (high + low),
    )


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
    _, rod_cosine = _rod_direction(sine, cosine, mechanism)
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
    rod_sine, rod_cosine = _rod_direction(sine, cosine, mechanism)
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
    rod_sine, rod_cosine = _rod_direction(sine, cosine, mechanism)
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
    rod_sine, rod_cosine = _rod_direction(sine, cosine, mechanism)
    flat, lean, size = _flat_rod(sine, mechanism)
    short = cosine**2 / (1 + size)
    second = -ratio * np.where(sine < 0, -1.0, 1.0) * (size * flat + ratio * lean * short**2) / rod_cosine**3
    return np.arctan2(rod_sine, rod_cosine), ratio * cosine / rod_cosine, second


def rod_direction(crank_angle_rev: ArrayLike, mechanism: SliderCrank) -> tuple[Angles, Angles]:
    """Sine and cosine of the rod angle from the cylinder axis, exact to their own size where the rod lies flat.

    ``crank_angle_rev``: revolutions, any shape. ``mechanism``: lengths in metres. Each result has the shape of the
    angles; the cosine is above zero. Source: sin ψ = λ sin φ − ε; the cosine by the factors of 1 − sin²ψ.
    """
    return _rod_direction(*sine_cosine(crank_angle_rev), mechanism)


def _rod_direction(sine: Angles, cosine: Angles, mechanism: SliderCrank) -> tuple[Angles, Angles]:
    """Sine and cosine of the rod angle; 1 ∓ λ sin φ is rewritten to keep its digits where the rod lies flat."""
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
