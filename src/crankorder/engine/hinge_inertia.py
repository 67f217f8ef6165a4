"""The elastic hinge between strut and crank: reduced inertia, and the moment that keeps the crank speed constant.

Derivatives come from accelerations (½ dI/dφ = Σ m a·v), not from the printed expressions of document 003: those are
wrong and divide by zero at 90° (truth sheet 4.5).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.crank_torque import CrankTorque, potential_torque
from crankorder.engine.elastic_hinge import PinHinge, hinge_moment, mean_gas_moment, mean_rod_cosine, withheld_moment
from crankorder.engine.hinged_crank import HingedCrank, point_acceleration, point_velocity, rod_motion

Angles = NDArray[np.float64]


def reduced_inertia(crank_angle_rev: ArrayLike, crank: HingedCrank) -> Angles:
    """Moment of inertia I (kg·m²) of the whole mechanism reduced to the crank: twice its energy per squared speed.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths, weights, inertias. Returns the shape of the angles.
    Source: I_giv of document 003, with its P2 and P4 terms corrected (truth sheet 4.5).
    """
    motion = rod_motion(crank_angle_rev, crank)
    counterweight = crank.crank_counterweight_n / crank.gravity_m_s2 * crank.crank_counterweight_radius_m**2
    total = crank.crank_inertia_kg_m2 + counterweight + crank.rod_inertia_kg_m2 * motion.swing**2
    for mass, distance in crank.rod_points:
        along, across = point_velocity(distance, motion, crank)
        total = total + mass * (along**2 + across**2)
    return np.asarray(total)


def half_inertia_slope(crank_angle_rev: ArrayLike, crank: HingedCrank) -> Angles:
    """½ dI/dφ (kg·m² per radian): times squared crank speed, the torque that constant speed asks for.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths, weights, inertias. Returns the shape of the angles.
    Source: truth sheet 4.5.
    """
    motion = rod_motion(crank_angle_rev, crank)
    total = crank.rod_inertia_kg_m2 * motion.swing * motion.swing_rate
    for mass, distance in crank.rod_points:
        along, across = point_velocity(distance, motion, crank)
        along_rate, across_rate = point_acceleration(distance, motion, crank)
        total = total + mass * (along * along_rate + across * across_rate)
    return np.asarray(total)


def weight_moment(crank: HingedCrank) -> float:
    """Amplitude (N·m) of the torque that the weights ask of the crank: times cos φ, zero where equation (12) holds.

    ``crank``: lengths and weights. Source: truth sheet 4.5 (the sign of the l0 λ term as in the document's Q).
    """
    rod_share = crank.rod_centre_to_piston_m * crank.mechanism.crank_ratio
    counterweight_height = crank.crank_radius_m + crank.rod_counterweight_radius_m * crank.mechanism.crank_ratio
    return (
        crank.crank_weight_n * crank.crank_centre_radius_m
        - crank.crank_counterweight_n * crank.crank_counterweight_radius_m
        + crank.rod_weight_n * rod_share
        + crank.rod_counterweight_n * counterweight_height
    )


def strut_hinge_moment(
    crank_angle_rev: ArrayLike, crank: HingedCrank, torque: CrankTorque, *, speed_rpm: float, pin_hinge: PinHinge
) -> Angles:
    """Moment M1 (N·m) of the hinge between strut and crank that keeps the crank speed constant.

    M1 = ½ω² dI/dφ − M_pot + weights · cos φ + (hinge moment at the pin) · d(φ+ψ)/dφ.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths, weights, inertias. ``torque``: of the crank.
    ``speed_rpm``: constant crank speed. ``pin_hinge``: what the hinge at the crank pin gives, see
    :data:`crankorder.engine.elastic_hinge.PinHinge`. Returns the shape of the angles.
    Source: equation (10) of document 003 as corrected in truth sheet 4.5.
    """
    motion = rod_motion(crank_angle_rev, crank)
    omega_squared = (speed_rpm * np.pi / 30) ** 2
    pin = hinge_moment(crank_angle_rev, crank, torque, speed_rpm=speed_rpm, pin_hinge=pin_hinge)
    moment = omega_squared * half_inertia_slope(crank_angle_rev, crank)
    moment += weight_moment(crank) * motion.cosine + pin * motion.hinge_rate
    moment -= potential_torque(crank_angle_rev, torque)
    return moment


def strut_hinge_work(crank: HingedCrank, torque: CrankTorque, *, pin_hinge: PinHinge) -> float:
    """Work ∮ M1 dφ (J) that the hinge between strut and crank gives in a revolution: a spring can give none.

    ``crank``: lengths and weights. ``torque``: of the crank. ``pin_hinge``: zero for "potential", −2π⟨T⟩ for
    "printed", 2πG⟨cos ψ⟩ for "full"; at any speed. Source: truth sheet 4.4.
    """
    if pin_hinge == "potential":
        return 0.0
    if pin_hinge == "printed":
        return -2 * np.pi * mean_gas_moment(crank, torque)
    return 2 * np.pi * crank.static_moment_nm * mean_rod_cosine(crank)


def pin_hinge_work(crank: HingedCrank, torque: CrankTorque, *, pin_hinge: PinHinge) -> float:
    """Work ∮ M dα (J) of the hinge at the crank pin over its own angle α = φ + ψ in a revolution.

    ``crank``: lengths and weights. ``torque``: of the crank. ``pin_hinge``: zero for "potential" only.
    Source: truth sheet 4.4.
    """
    if pin_hinge == "potential":
        return 0.0
    static = crank.static_moment_nm * mean_rod_cosine(crank)
    return 2 * np.pi * (static - withheld_moment(crank, torque, pin_hinge=pin_hinge))


def shaking_force(crank_angle_rev: ArrayLike, crank: HingedCrank) -> tuple[Angles, Angles]:
    """Force (x, y) of all moving masses upon the crankcase per squared crank speed (kg·m).

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. Each result has the shape of the
    angles. Zero at every angle where equation (13) holds, see
    :func:`crankorder.engine.hinge_solutions.balanced_crank`.
    """
    motion = rod_motion(crank_angle_rev, crank)
    turning = crank.crank_weight_n * crank.crank_centre_radius_m
    turning -= crank.crank_counterweight_n * crank.crank_counterweight_radius_m
    along, across = (turning / crank.gravity_m_s2 * part for part in (motion.cosine, motion.sine))
    for mass, distance in crank.rod_points:
        along_rate, across_rate = point_acceleration(distance, motion, crank)
        along, across = along - mass * along_rate, across - mass * across_rate
    return along, across
