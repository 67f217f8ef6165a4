"""Elastic hinges of a crank mechanism: the moments that they must give, and what to choose so that they work.

The hinge between crank and rod keeps the piston off its cylinder wall; the hinge between strut and crank keeps the
crank speed constant. All forms are finite at every angle: the gas force has poles at the dead centres, its moment
about the crank pin has not. Derivatives come from accelerations (½ dI/dφ = Σ m a·v), not from the printed expressions:
those are wrong and divide by zero at 90°. Source: Zotov, Sviridov, Tokarev (document 003), figures 4 to 7 and equations
(11) to (13); truth sheet 4.2 to 4.5 for the forms and the corrections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.hinged_crank import (
    CrankTorque,
    GuideData,
    HingedCrank,
    RodMotion,
    point_acceleration,
    point_velocity,
    potential_torque,
    rod_motion,
)
from crankorder.engine.slider_crank import Angles
from crankorder.errors import RequestError

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
    return potential_torque(crank_angle_rev, torque) / motion.hinge_rate


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
) -> Angles:
    """Moment (N·m) of the hinge at the crank pin upon the rod; "full" is M12, which leaves no side force at all.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``speed_rpm``: constant crank speed. ``pin_hinge``: see :data:`PinHinge`. Returns the shape of the angles.
    Source: document 003, equations (4) and (6); truth sheet 4.3 and 4.4.
    """
    motion = rod_motion(crank_angle_rev, crank)
    omega_squared = (speed_rpm * np.pi / 30) ** 2
    moment = crank.static_moment_nm * motion.rod_cosine + gas_moment(crank_angle_rev, crank, torque)
    moment += omega_squared * inertia_moment(motion, crank)
    moment -= withheld_moment(crank, torque, pin_hinge=pin_hinge)
    return moment


def withheld_moment(crank: HingedCrank, torque: CrankTorque, *, pin_hinge: PinHinge) -> float:
    """Constant (N·m) that the hinge at the crank pin leaves out of M12; no crank speed changes it.

    ``crank``: lengths and weights. ``torque``: of the crank. ``pin_hinge``: 0 for "full", G⟨cos ψ⟩ for "potential",
    G⟨cos ψ⟩ + ⟨T⟩ for "printed". Source: truth sheet 4.3 and 4.4.
    """
    if pin_hinge == "full":
        return 0.0
    static = crank.static_moment_nm * mean_rod_cosine(crank)
    return static if pin_hinge == "potential" else static + mean_gas_moment(crank, torque)


def side_force_without_hinge(
    crank_angle_rev: ArrayLike, crank: HingedCrank, torque: CrankTorque, *, speed_rpm: float
) -> Angles:
    """Side force R430 (N) of the cylinder upon the piston where the crank pin has no hinge: M12 / (L cos ψ).

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``speed_rpm``: constant crank speed. Returns the shape of the angles. Source: document 003, equation (5).
    """
    moment = hinge_moment(crank_angle_rev, crank, torque, speed_rpm=speed_rpm)
    return moment / (crank.rod_length_m * rod_motion(crank_angle_rev, crank).rod_cosine)


def side_force(crank_angle_rev: ArrayLike, crank: HingedCrank, torque: CrankTorque, *, pin_hinge: PinHinge) -> Angles:
    """Side force R43 (N) of the cylinder upon the piston that a hinge at the crank pin leaves, at any crank speed.

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. ``torque``: of the crank.
    ``pin_hinge``: see :data:`PinHinge`. Returns the shape of the angles.
    Source: document 003, equation (7); truth sheet 4.4.
    """
    withheld = withheld_moment(crank, torque, pin_hinge=pin_hinge)
    return withheld / (crank.rod_length_m * rod_motion(crank_angle_rev, crank).rod_cosine)


def mean_rod_cosine(crank: HingedCrank, *, truncated: bool = False) -> float:
    """Mean of cos ψ over the crank angle: 2E(λ²)/π, or 1 − λ²/4 where ``truncated`` as document 003 has it.

    ``crank``: lengths. Source: truth sheet 4.3.
    """
    from scipy.special import ellipe

    squared = crank.mechanism.crank_ratio**2
    return 1 - squared / 4 if truncated else float(2 / np.pi * ellipe(squared))


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
    half_slope = crank.rod_inertia_kg_m2 * motion.swing * motion.swing_rate  # ½ dI/dφ
    for mass, distance in crank.rod_points:
        along, across = point_velocity(distance, motion, crank)
        along_rate, across_rate = point_acceleration(distance, motion, crank)
        half_slope = half_slope + mass * (along * along_rate + across * across_rate)
    moment = np.asarray(omega_squared * half_slope)
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
    static = crank.static_moment_nm * mean_rod_cosine(crank)
    return 2 * np.pi * (static - withheld_moment(crank, torque, pin_hinge=pin_hinge))


def shaking_force(crank_angle_rev: ArrayLike, crank: HingedCrank) -> tuple[Angles, Angles]:
    """Force (x, y) of all moving masses upon the crankcase per squared crank speed (kg·m).

    ``crank_angle_rev``: revolutions, any shape. ``crank``: lengths and weights. Each result has the shape of the
    angles. Zero at every angle where equation (13) holds, see
    :func:`crankorder.engine.elastic_hinge.balanced_crank`.
    """
    motion = rod_motion(crank_angle_rev, crank)
    turning = crank.crank_weight_n * crank.crank_centre_radius_m
    turning -= crank.crank_counterweight_n * crank.crank_counterweight_radius_m
    along, across = (turning / crank.gravity_m_s2 * part for part in (motion.cosine, motion.sine))
    for mass, distance in crank.rod_points:
        along_rate, across_rate = point_acceleration(distance, motion, crank)
        along, across = along - mass * along_rate, across - mass * across_rate
    return along, across


Joint = Literal["pin", "strut"]
"""``"pin"``: the hinge between crank and rod, angle φ + ψ. ``"strut"``: between strut and crank, angle φ."""

Weight = Literal["rod_weight_n", "piston_weight_n", "rod_counterweight_n"]

_POINTS_PER_STEP = 8  # Gauss–Legendre points between two angles of a table
_SWING_STEPS = 1440  # a quarter of a degree: the largest and smallest energy are read off the rows, to about 1e-5


def weight_without_side_force(
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    weight: Weight,
    pin_hinge: Literal["potential", "printed"],
    truncated: bool = False,
) -> float:
    """Weight (N) with which the hinge at the crank pin leaves no side force, at every angle and every speed.

    ``crank``: lengths and the other weights. ``torque``: of the crank. ``weight``: the one sought. ``pin_hinge``:
    "potential" asks for G = 0, which is P4 of equation (13); "printed" asks for G⟨cos ψ⟩ = −⟨T⟩, figure 4.
    ``truncated``: take the document's own ⟨cos ψ⟩. Raises RequestError where no weight does it.
    """
    arms = {
        "rod_weight_n": crank.pin_to_rod_centre_m,
        "piston_weight_n": crank.rod_length_m,
        "rod_counterweight_n": -crank.rod_counterweight_radius_m,
    }
    static_nm = 0.0
    if pin_hinge == "printed":
        static_nm = -mean_gas_moment(crank, torque) / mean_rod_cosine(crank, truncated=truncated)
    others_nm = sum(getattr(crank, name) * arm for name, arm in arms.items() if name != weight)
    weight_n = (static_nm - others_nm) / arms[weight] if arms[weight] else np.nan
    if not weight_n >= 0:
        problem = f"no {weight} of zero or more leaves the piston without side force"
        remedy = "Give it an arm, or change another weight"
        raise RequestError(problem, found=f"arm {arms[weight]} m, moment {static_nm - others_nm} N·m", remedy=remedy)
    return float(weight_n)


def vertical_counterweight(crank: HingedCrank) -> float:
    """Weight P5 (N) of the crank counterweight that balances the mechanism across the cylinder axis, equation (12).

    ``crank``: lengths and the other weights. Raises RequestError where the counterweight has no radius.
    """
    ratio = crank.mechanism.crank_ratio
    moment = crank.crank_weight_n * crank.crank_centre_radius_m
    moment += crank.rod_weight_n * crank.rod_centre_to_piston_m * ratio
    moment += crank.rod_counterweight_n * (crank.rod_length_m + crank.rod_counterweight_radius_m) * ratio
    return _over_radius(moment, crank.crank_counterweight_radius_m, "crank_counterweight_radius_m")


def balanced_crank(crank: HingedCrank) -> HingedCrank:
    """The same mechanism with counterweights P4 and P5 that cancel every force of its moving masses, equation (13).

    P4 brings the centre of mass of rod, piston and counterweight to the crank pin, P5 that of everything to the
    crankshaft. ``crank``: lengths and the other weights. Raises RequestError where a counterweight has no radius.
    """
    moment = crank.piston_weight_n * crank.rod_length_m + crank.rod_weight_n * crank.pin_to_rod_centre_m
    on_rod = _over_radius(moment, crank.rod_counterweight_radius_m, "rod_counterweight_radius_m")
    turning = (crank.rod_weight_n + crank.piston_weight_n + on_rod) * crank.crank_radius_m
    turning += crank.crank_weight_n * crank.crank_centre_radius_m
    on_crank = _over_radius(turning, crank.crank_counterweight_radius_m, "crank_counterweight_radius_m")
    return crank.model_copy(update={"rod_counterweight_n": on_rod, "crank_counterweight_n": on_crank})


def crank_angle_of_hinge(hinge_angle_rev: ArrayLike, crank: HingedCrank) -> Angles:
    """Crank angle (revolutions) at which the hinge at the crank pin has turned through an angle α = φ + ψ.

    ``hinge_angle_rev``: revolutions, any shape. ``crank``: lengths. Returns the shape of the angles; both angles meet
    at each dead centre. Closed form: tan φ = sin α / (λ + cos α), taken by quadrant.
    """
    turns = np.asarray(hinge_angle_rev, dtype=np.float64)
    whole = np.rint(turns)
    angle = 2 * np.pi * (turns - whole)
    # λ + cos α, from 1 − λ, keeps its digits beside the lower dead centre
    reach = 2 * np.cos(angle / 2) ** 2 - crank.mechanism.margin
    return whole + np.arctan2(np.sin(angle), reach) / (2 * np.pi)


@dataclass(frozen=True, kw_only=True)
class HingeTable:
    """Characteristic of a hinge over one turn of its own angle: what its guides have to be cut for."""

    hinge_angle_rev: Angles
    """Angle of the hinge (revolutions), 0 to 1 in even steps, both ends included."""
    crank_angle_rev: Angles
    """Crank angle there (revolutions)."""
    moment_nm: Angles
    """Moment of the hinge (N·m)."""
    work_j: Angles
    """Work that the hinge has given since angle zero (J); the last value is zero where a spring can be made so."""


def hinge_table(
    crank: HingedCrank, torque: CrankTorque, *, joint: Joint, speed_rpm: float, n_steps: int = 360
) -> HingeTable:
    """Moment and work of a hinge against its own angle, the one at the crank pin being a spring ("potential").

    ``crank``: lengths, weights, inertias. ``torque``: of the crank. ``joint``: "pin" or "strut". ``speed_rpm``: the
    constant crank speed that the hinge is for. ``n_steps``: even steps of the hinge angle, ≥ 2, an even number so that
    the kink at the lower dead centre falls on a row; more steps cost time, the work is exact to round-off from about 30
    on at λ = ½.
    """

    def crank_angle(hinge_angle_rev: Angles) -> Angles:
        return hinge_angle_rev if joint == "strut" else crank_angle_of_hinge(hinge_angle_rev, crank)

    def moment(hinge_angle_rev: Angles) -> Angles:
        return _spring_moment(crank_angle(hinge_angle_rev), crank, torque, joint=joint, speed_rpm=speed_rpm)

    rows = np.arange(n_steps + 1) / n_steps
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS_PER_STEP)
    between = (rows[:-1, None] + rows[1:, None]) / 2 + nodes / (2 * n_steps)
    steps = moment(between) @ weights * (np.pi / n_steps)
    work_j = np.concatenate(([0.0], np.cumsum(steps)))
    return HingeTable(hinge_angle_rev=rows, crank_angle_rev=crank_angle(rows), moment_nm=moment(rows), work_j=work_j)


@dataclass(frozen=True, kw_only=True)
class Guides:
    """Guides of a hinge that give its moment by a spring between them; rows over one turn of the hinge angle."""

    hinge_angle_rev: Angles
    """Angle of the hinge (revolutions), 0 to 1, both ends included."""
    stiffness_n_per_m: float
    """Of the spring."""
    length_m: Angles
    """Length of the spring."""
    outer_m: NDArray[np.complex128]
    """Surface of the outer guide, x + iy from the hinge's axis: the path of the roller, moved by its radius."""
    inner_m: NDArray[np.complex128]
    """Surface of the inner guide."""
    steepest_deg: float
    """Largest angle between the force on a roller and the spring: above some 45° the rollers jam."""
    undercut: bool
    """Whether a guide is curved more sharply than its roller, so that it cannot be cut."""


def hinge_guides(table: HingeTable, data: GuideData) -> Guides:
    """Guides whose spring makes the moment of a hinge: document 003, figure 7.

    What the hinge gives, the spring loses: ½ k c² = ½ k c₀² + (greatest work − work), c its compression, c₀ the least.
    Its two ends share the change of length evenly. The surfaces are the parallel curves of the rollers' paths.

    ``table``: moment and work against the hinge's own angle, in many steps. ``data``: spring and rollers. Raises
    RequestError where the hinge gives work in a turn, which no spring can.
    """
    swing = float(np.ptp(table.work_j))
    if swing == 0 or abs(table.work_j[-1]) > 1e-6 * swing:
        problem = "a spring in guides gives no work in a turn, and some moment within it"
        raise RequestError(problem, found=f"{table.work_j[-1]} J a turn")
    least, most = data.least_compression_m, data.most_compression_m
    stiffness = 2 * swing / ((most - least) * (most + least))
    compression = np.sqrt(least**2 + 2 / stiffness * (table.work_j.max() - table.work_j))
    length = data.free_length_m - compression
    rate = table.moment_nm / (stiffness * compression)  # dℓ/dα: moment = force · dℓ/dα
    turn = np.exp(2j * np.pi * table.hinge_angle_rev)
    surfaces, steepest, undercut = [], 0.0, False
    for side in (1, -1):
        radius, slope = data.middle_radius_m + side * length / 2, side * rate / 2
        normal = (radius - 1j * slope) / np.hypot(radius, slope)
        heading = np.unwrap(np.angle(normal * turn))
        bend = np.gradient(heading, 2 * np.pi * table.hinge_angle_rev) / np.hypot(radius, slope)
        surfaces.append((radius + side * data.roller_radius_m * normal) * turn)
        steepest = max(steepest, float(np.abs(np.arctan2(slope, radius)).max()))
        undercut |= bool((1 + side * data.roller_radius_m * bend <= 0).any())
    return Guides(
        hinge_angle_rev=table.hinge_angle_rev,
        stiffness_n_per_m=stiffness,
        length_m=length,
        outer_m=surfaces[0],
        inner_m=surfaces[1],
        steepest_deg=math.degrees(steepest),
        undercut=undercut,
    )


def air_spring(
    crank: HingedCrank, torque: CrankTorque, *, joint: Joint, designed_speed_rpm: float, speed_rpm: float
) -> dict[str, Any]:
    """Pressure ratio that an air spring in the same guides needs at another speed, and what it leaves undone.

    As the balance document has it: ``residual_share`` is the moment that it lacks over the moment needed, rms, and
    ``speed_fluctuation`` what this makes of the crank speed, (fastest − slowest) / mean.

    The moment of an air spring is its charge pressure times a curve of the guides: one ratio scales it at all angles.
    The moment needed is a part that no speed changes, and one that grows with its square. The ratio is the best in
    the least squares over the hinge angle, and exact only where the first part vanishes: then it is the squared ratio
    of the speeds.

    ``crank``: lengths, weights, inertias. ``torque``: of the crank, the same at both speeds. ``joint``: "pin" or
    "strut". ``designed_speed_rpm``: that the guides are cut for. ``speed_rpm``: the other one, > 0. Raises RequestError
    where the guides give no moment.
    """
    crank_angle_rev, weight = branch_quadrature(crank, torque)
    if joint == "pin":
        weight = weight * rod_motion(crank_angle_rev, crank).hinge_rate
    designed, needed = (
        _spring_moment(crank_angle_rev, crank, torque, joint=joint, speed_rpm=speed)
        for speed in (designed_speed_rpm, speed_rpm)
    )
    strength = float(weight @ designed**2)
    if strength == 0:
        raise RequestError("guides without a moment cannot be scaled to another speed", found=designed_speed_rpm)
    ratio = float(weight @ (designed * needed)) / strength
    residual_rms = float(np.sqrt(weight @ (needed - ratio * designed) ** 2))
    tables = [
        hinge_table(crank, torque, joint=joint, speed_rpm=speed, n_steps=_SWING_STEPS)
        for speed in (designed_speed_rpm, speed_rpm)
    ]
    swing = float(np.ptp(tables[1].work_j - ratio * tables[0].work_j))
    energy = float(np.mean(reduced_inertia(tables[0].crank_angle_rev[:-1], crank))) * (speed_rpm * np.pi / 30) ** 2
    needed_rms = float(np.sqrt(weight @ needed**2))
    return {
        "joint": joint,
        "designed_speed_rpm": designed_speed_rpm,
        "speed_rpm": speed_rpm,
        "pressure_ratio": ratio,
        "residual_share": residual_rms / needed_rms if needed_rms else 0.0,
        "speed_fluctuation": swing / energy,
    }


def _spring_moment(
    crank_angle_rev: Angles, crank: HingedCrank, torque: CrankTorque, *, joint: Joint, speed_rpm: float
) -> Angles:
    moment = hinge_moment if joint == "pin" else strut_hinge_moment
    return moment(crank_angle_rev, crank, torque, speed_rpm=speed_rpm, pin_hinge="potential")


def _over_radius(moment_nm: float, radius_m: float, name: str) -> float:
    if radius_m == 0:
        raise RequestError(f"{name} is zero: a counterweight without a radius balances nothing", found=radius_m)
    return moment_nm / radius_m
