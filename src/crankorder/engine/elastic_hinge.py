"""The elastic hinge between crank and rod: the moment that keeps the piston off its cylinder wall.

All forms are finite at every angle: the gas force itself has poles at the dead centres, its moment about the crank pin
has not. Source: Zotov, Sviridov, Tokarev (document 003); truth sheet 4.2 to 4.4 for the forms and the corrections.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.crank_torque import CrankTorque, potential_torque
from crankorder.engine.hinged_crank import HingedCrank, Kinematics, RodMotion, point_acceleration, rod_motion

Angles = NDArray[np.float64]

PinHinge = Literal["full", "potential", "printed"]
"""What the hinge at the crank pin gives. ``"full"``: all of M12, so that no side force is left; only where G = 0 can a
spring do that. ``"potential"``: M12 less the constant that makes its work over the hinge angle φ + ψ zero.
``"printed"``: equation (6), less the mean over φ; its work over the hinge's own angle is not zero."""

# A panel as wide as twice its distance from a singularity converges by (1 + √2)² a point: this many reach 1e-16
_POINTS_BESIDE_SINGULARITY = 22


def gas_moment(crank_angle_rev: ArrayLike, crank: HingedCrank, torque: CrankTorque) -> Angles:
    """Moment T (N·m) of the potential gas force about the crank pin: F R sin φ, finite at every angle.

    F itself, equation (3), has poles at both dead centres and is never formed: T = M_pot / (1 + dψ/dφ).

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths. ``torque``: of the crank.
    Returns the shape of the angles. Source: truth sheet 4.2.
    """
    motion = rod_motion(crank_angle_rev, crank)
    moment: Angles = potential_torque(crank_angle_rev, torque) / motion.hinge_rate
    return moment


def inertia_moment(motion: RodMotion, crank: HingedCrank) -> Angles:
    """J (kg·m²): moment about the crank pin of all inertia of rod, piston and counterweight, per squared crank speed.

    ``motion``: of the rod. ``crank``: lengths and weights. Odd in the crank angle, so its mean is zero.
    Source: truth sheet 4.3 (the inertia terms of equation (4)).
    """
    total = -crank.rod_inertia_kg_m2 * motion.swing_rate
    rod_sine = crank.mechanism.crank_ratio * motion.sine
    for mass, distance in crank.rod_points:
        along, across = point_acceleration(distance, motion, crank)
        total = total + mass * distance * (rod_sine * along + motion.rod_cosine * across)
    return total


def hinge_moment(
    crank_angle_rev: ArrayLike,
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    speed_rpm: float,
    pin_hinge: PinHinge = "full",
    kinematics: Kinematics = "exact",
) -> Angles:
    """Moment (N·m) of the hinge at the crank pin upon the rod; "full" is M12, which leaves no side force at all.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``speed_rpm``: constant crank speed. ``pin_hinge``: see :data:`PinHinge`. ``kinematics``: "exact", or "truncated"
    to compare with the document. Returns the shape of the angles.
    Source: document 003, equations (4) and (6); truth sheet 4.3 and 4.4.
    """
    motion = rod_motion(crank_angle_rev, crank, kinematics=kinematics)
    omega_squared = (speed_rpm * np.pi / 30) ** 2
    moment = crank.static_moment_nm * motion.rod_cosine + gas_moment(crank_angle_rev, crank, torque)
    moment += omega_squared * inertia_moment(motion, crank)
    moment -= withheld_moment(crank, torque, pin_hinge=pin_hinge, kinematics=kinematics)
    return moment


def withheld_moment(
    crank: HingedCrank, torque: CrankTorque, *, pin_hinge: PinHinge, kinematics: Kinematics = "exact"
) -> float:
    """Constant (N·m) that the hinge at the crank pin leaves out of M12; no crank speed changes it.

    ``crank``: lengths and weights. ``torque``: of the crank. ``pin_hinge``: 0 for "full", G⟨cos ψ⟩ for "potential",
    G⟨cos ψ⟩ + ⟨T⟩ for "printed". ``kinematics``: of ⟨cos ψ⟩. Source: truth sheet 4.3 and 4.4.
    """
    if pin_hinge == "full":
        return 0.0
    static = crank.static_moment_nm * mean_rod_cosine(crank, kinematics=kinematics)
    return static if pin_hinge == "potential" else static + mean_gas_moment(crank, torque)


def side_force_without_hinge(
    crank_angle_rev: ArrayLike,
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    speed_rpm: float,
    kinematics: Kinematics = "exact",
) -> Angles:
    """Side force R430 (N) of the cylinder upon the piston where the crank pin has no hinge: M12 / (L cos ψ).

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``speed_rpm``: constant crank speed. ``kinematics``: "exact" or "truncated". Returns the shape of the angles.
    Source: document 003, equation (5).
    """
    moment = hinge_moment(crank_angle_rev, crank, torque, speed_rpm=speed_rpm, kinematics=kinematics)
    rod_cosine = rod_motion(crank_angle_rev, crank, kinematics=kinematics).rod_cosine
    force: Angles = moment / (crank.rod_length_m * rod_cosine)
    return force


def side_force(
    crank_angle_rev: ArrayLike,
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    pin_hinge: PinHinge,
    kinematics: Kinematics = "exact",
) -> Angles:
    """Side force R43 (N) of the cylinder upon the piston that a hinge at the crank pin leaves, at any crank speed.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``pin_hinge``: see :data:`PinHinge`. ``kinematics``: "exact" or "truncated". Returns the shape of the angles.
    Source: document 003, equation (7); truth sheet 4.4.
    """
    rod_cosine = rod_motion(crank_angle_rev, crank, kinematics=kinematics).rod_cosine
    withheld = withheld_moment(crank, torque, pin_hinge=pin_hinge, kinematics=kinematics)
    force: Angles = withheld / (crank.rod_length_m * rod_cosine)
    return force


def mean_rod_cosine(crank: HingedCrank, *, kinematics: Kinematics = "exact") -> float:
    """Mean of cos ψ over the crank angle: 2E(λ²)/π, or 1 − λ²/4 truncated.

    ``crank``: lengths. ``kinematics``: "exact" or "truncated". Source: truth sheet 4.3.
    """
    from scipy.special import ellipe

    squared = crank.mechanism.crank_ratio**2
    return 1 - squared / 4 if kinematics == "truncated" else float(2 / np.pi * ellipe(squared))


def mean_gas_moment(crank: HingedCrank, torque: CrankTorque) -> float:
    """Mean ⟨T⟩ (N·m) of the moment of the potential gas force about the crank pin over the crank angle.

    ``crank``: lengths, of which λ alone matters. ``torque``: of the crank. Source: truth sheet 4.3.
    """
    crank_angle_rev, weight_rev = branch_quadrature(crank, torque)
    return float(weight_rev @ gas_moment(crank_angle_rev, crank, torque))


def branch_quadrature(crank: HingedCrank, torque: CrankTorque) -> tuple[Angles, Angles]:
    """Crank angles and weights (both in revolutions) whose sum is a mean over the revolution, to round-off.

    Gauss–Legendre points between the kinks of the torque. The rod makes the integrand singular at complex angles beside
    90° and 270°, the nearer the shorter it is: towards these the panels shrink in steps, so that their number grows but
    slowly and each needs the same few points. ``crank``: lengths. ``torque``: of the crank.
    """
    shortness = crank.mechanism.margin / crank.mechanism.crank_ratio
    reach_rev = math.log1p(shortness + math.sqrt(shortness * (shortness + 2))) / (2 * np.pi)
    steps = reach_rev * 3.0 ** np.arange(math.ceil(max(0.0, math.log(0.5 / reach_rev, 3))))
    graded = np.concatenate([flat + sign * steps for flat in (0.25, 0.75) for sign in (-1, 1)])
    angles, weights = [], []
    for branch in torque.branches:
        first, last = branch.middle_rev - branch.half_width_rev, branch.middle_rev + branch.half_width_rev
        edges = np.unique([first, *graded[(graded > first) & (graded < last)], last])
        nodes, shares = _gauss_legendre(_POINTS_BESIDE_SINGULARITY + 2 * len(branch.angle_deg))
        half = np.diff(edges)[:, None] / 2
        angles.append((edges[:-1, None] + half * (1 + nodes)).ravel())
        weights.append((half * shares).ravel())
    return np.concatenate(angles), np.concatenate(weights)


@lru_cache(maxsize=16)
def _gauss_legendre(count: int) -> tuple[Angles, Angles]:
    return np.polynomial.legendre.leggauss(count)
