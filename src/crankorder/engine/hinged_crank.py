"""A single-cylinder crank mechanism with elastic hinges and counterweights on rod and crank: its data and its motion.

The cylinder axis is x, from the crankshaft to the top dead centre; weights act along −y; the crank turns from x to y.
Rod, piston and the counterweight of the rod lie on one line through the crank pin A.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.slider_crank import SliderCrank, sine_cosine
from crankorder.errors import RequestError

Angles = NDArray[np.float64]

Kinematics = Literal["exact", "truncated"]
"""``"truncated"`` is cos ψ ≈ 1 − λ²/4 + λ²/4 cos 2φ, as document 003 has it: only for comparing with its numbers."""


@dataclass(frozen=True, kw_only=True)
class HingedCrank:
    """Lengths (m), weights (N) and inertias (kg·m²) of document 003, figure 1; its symbols stand behind each field."""

    crank_radius_m: float  # r1 + r2
    pin_to_rod_centre_m: float  # l1, crank pin to the rod's centre of mass
    rod_centre_to_piston_m: float  # l2
    rod_weight_n: float  # P2
    piston_weight_n: float  # P3
    rod_inertia_kg_m2: float  # I_C2, about the rod's own centre of mass
    rod_counterweight_n: float = 0.0  # P4
    rod_counterweight_radius_m: float = 0.0  # l0, from the crank pin away from the piston
    crank_weight_n: float = 0.0  # P1
    crank_centre_radius_m: float = 0.0  # r1
    crank_inertia_kg_m2: float = 0.0  # I_0, of the crank about the crankshaft
    crank_counterweight_n: float = 0.0  # P5
    crank_counterweight_radius_m: float = 0.0  # r0, opposite the crank pin
    gravity_m_s2: float = 9.81

    def __post_init__(self) -> None:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        wrong = {name: value for name, value in values.items() if not (math.isfinite(value) and value >= 0)}
        if wrong or self.gravity_m_s2 == 0:
            found = ", ".join(f"{name} {value}" for name, value in (wrong or {"gravity_m_s2": 0}).items())
            raise RequestError("lengths, weights and inertias must be zero or more and gravity more", found=found)
        _ = self.mechanism

    @property
    def rod_length_m(self) -> float:
        """Rod length L = l1 + l2 (m)."""
        return self.pin_to_rod_centre_m + self.rod_centre_to_piston_m

    @cached_property
    def mechanism(self) -> SliderCrank:
        """The lengths of the crank mechanism alone."""
        return SliderCrank(crank_radius_m=self.crank_radius_m, rod_length_m=self.rod_length_m)

    @property
    def rod_points(self) -> tuple[tuple[float, float], ...]:
        """Mass (kg) and distance from the crank pin towards the piston (m) of piston, rod and rod counterweight."""
        return (
            (self.piston_weight_n / self.gravity_m_s2, self.rod_length_m),
            (self.rod_weight_n / self.gravity_m_s2, self.pin_to_rod_centre_m),
            (self.rod_counterweight_n / self.gravity_m_s2, -self.rod_counterweight_radius_m),
        )

    @property
    def static_moment_nm(self) -> float:
        """G = P3 L + P2 l1 − P4 l0 (N·m): zero where piston, rod and counterweight balance about the crank pin."""
        return (
            self.piston_weight_n * self.rod_length_m
            + self.rod_weight_n * self.pin_to_rod_centre_m
            - self.rod_counterweight_n * self.rod_counterweight_radius_m
        )


def slender_rod_inertia(weight_n: float, length_m: float, *, gravity_m_s2: float = 9.81) -> float:
    """Moment of inertia (kg·m²) of a uniform slender rod about its middle, m L² / 12.

    Document 003 prints no inertia of its rods; the truth sheet takes this one.
    ``weight_n``: N. ``length_m``: m. ``gravity_m_s2``: that the weight was made with.
    """
    return weight_n / gravity_m_s2 * length_m**2 / 12


@dataclass(frozen=True, kw_only=True)
class RodMotion:
    """Motion of crank and rod at crank angle φ, each of the shape of the angles; derivatives are by φ in radians."""

    sine: Angles
    """sin φ."""
    cosine: Angles
    """cos φ."""
    rod_cosine: Angles
    """cos ψ."""
    swing: Angles
    """u = dψ/dφ."""
    swing_rate: Angles
    """d²ψ/dφ²."""
    hinge_rate: Angles
    """1 + u = d(φ + ψ)/dφ, without cancellation."""
    bend: Angles
    """D = −(cos ψ)'' / λ²."""


def rod_motion(crank_angle_rev: ArrayLike, crank: HingedCrank, *, kinematics: Kinematics = "exact") -> RodMotion:
    """Motion of the rod at each crank angle, without cancellation however short the rod is.

    ``crank_angle_rev``: revolutions from top dead centre, any shape. ``crank``: its lengths. ``kinematics``: "exact",
    or "truncated" as document 003 has it. Source: truth sheet section 0; below equation (4) of the document.
    """
    ratio = crank.mechanism.crank_ratio
    kappa_squared = crank.mechanism.margin * (1 + ratio)
    sine, cosine = sine_cosine(crank_angle_rev)
    if kinematics == "truncated":
        rod_cosine = 1 - ratio**2 / 2 * sine**2
        swing = ratio * cosine / rod_cosine
        swing_rate = -ratio * sine * (1 - swing**2) / rod_cosine
        bend = cosine**2 - sine**2
        hinge_rate = 1 + swing
    else:
        rod_cosine = np.hypot(cosine, np.sqrt(kappa_squared) * sine)
        swing = ratio * cosine / rod_cosine
        swing_rate = -ratio * kappa_squared * sine / rod_cosine**3
        level = np.sqrt(kappa_squared) * sine**2
        bend = (cosine**2 - level) * (cosine**2 + level) / rod_cosine**3
        upper = np.abs(cosine)
        folded = kappa_squared / (rod_cosine * (rod_cosine + ratio * upper))
        hinge_rate = np.where(cosine < 0, folded, 1 + ratio * upper / rod_cosine)
    return RodMotion(
        sine=sine,
        cosine=cosine,
        rod_cosine=rod_cosine,
        swing=swing,
        swing_rate=swing_rate,
        hinge_rate=hinge_rate,
        bend=bend,
    )


def point_velocity(distance_m: float, motion: RodMotion, crank: HingedCrank) -> tuple[Angles, Angles]:
    """Velocity (x', y') per unit of crank speed (m/rad) of a point of the rod's line.

    ``distance_m``: from the crank pin towards the piston, negative beyond the pin. ``motion``: of the rod. ``crank``:
    its lengths. Source: truth sheet section 0.
    """
    share = distance_m / crank.rod_length_m
    lever = crank.crank_radius_m * ((1 - share) + share * motion.hinge_rate)
    return -lever * motion.sine, crank.crank_radius_m * (1 - share) * motion.cosine


def point_acceleration(distance_m: float, motion: RodMotion, crank: HingedCrank) -> tuple[Angles, Angles]:
    """Acceleration (x'', y'') per squared crank speed (m/rad²) of a point of the rod's line.

    ``distance_m``: from the crank pin towards the piston, negative beyond the pin. ``motion``: of the rod. ``crank``:
    its lengths. Source: truth sheet section 0; below equation (4) of document 003.
    """
    share = distance_m / crank.rod_length_m
    along = motion.cosine + share * crank.mechanism.crank_ratio * motion.bend
    return -crank.crank_radius_m * along, -crank.crank_radius_m * (1 - share) * motion.sine
