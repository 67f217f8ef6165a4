"""Elastic hinges of a crank mechanism: what each must give, what to choose so that it works, and the sheet of both.

The hinge between crank and rod keeps the piston off its cylinder wall; the hinge between strut and crank keeps the
crank speed constant. All forms are finite at every angle: the gas force has poles at the dead centres, its moment
about the crank pin has not. Derivatives come from accelerations (½ dI/dφ = Σ m a·v), not from the printed expressions:
those are wrong and divide by zero at 90°. Source: Zotov, Sviridov, Tokarev (document 003), figures 4 to 7 and equations
(11) to (13); truth sheet 4.2 to 4.5 for the forms and the corrections.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.hinged_crank import (
    CrankTorque,
    GuideData,
    HingedCrank,
    HingedCrankData,
    HingedEngine,
    PinHinge,
    branch_quadrature,
    hinge_moment,
    mean_gas_moment,
    mean_rod_cosine,
    point_acceleration,
    point_velocity,
    potential_torque,
    rod_motion,
    side_force,
    side_force_without_hinge,
    torque_extrema,
    torque_harmonics,
    withheld_moment,
)
from crankorder.engine.slider_crank import Angles
from crankorder.errors import RequestError

Sheet = dict[str, Any]
"""A balance document or a part of it, ready for JSON."""


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
    both = (designed_speed_rpm, speed_rpm)
    designed, needed = (_spring_moment(crank_angle_rev, crank, torque, joint=joint, speed_rpm=rpm) for rpm in both)
    strength = float(weight @ designed**2)
    if strength == 0:
        raise RequestError("guides without a moment cannot be scaled to another speed", found=designed_speed_rpm)
    ratio = float(weight @ (designed * needed)) / strength
    residual_rms = float(np.sqrt(weight @ (needed - ratio * designed) ** 2))
    tables = [hinge_table(crank, torque, joint=joint, speed_rpm=rpm, n_steps=_SWING_STEPS) for rpm in both]
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


# The sheet.


TABLE_STEPS = 36
"""Rows of a hinge's characteristic in the sheet: every 10° of its own angle."""

ROUND_OFF = 1e-12
"""A force or work below this share of its terms is what is left of terms that cancel, and set to zero."""

CRANK_ENGINE_PARTS = ("lambda", "harmonics", "force_g_mm", "strategies", "shafts", "crankshaft")
"""What every balance document names and an engine with elastic hinges does not have; each mechanism has its own λ."""

GUIDE_STEPS = 20 * TABLE_STEPS
"""Rows from which guides are cut: half a degree."""

_ANGLES = np.arange(1440) / 1440
JOINTS: tuple[Joint, ...] = get_args(Joint)
KINDS: tuple[PinHinge, ...] = get_args(PinHinge)
T = TypeVar("T")


def hinge_sheet(engine: HingedEngine, *, max_order: int, speeds_rpm: Sequence[float] | None = None) -> Sheet:
    """Torque, hinge moments, side forces and solutions of an engine with elastic hinges, as a balance document.

    ``engine``: torque curve and mechanisms. ``max_order``: highest harmonic of the torque, ≥ 1. ``speeds_rpm``: crank
    speeds, > 0; those of each mechanism where left out. Raises RequestError where a mechanism has no speed.
    """
    slender = any(data.rod_inertia_kg_m2 is None for data in engine.mechanisms)
    orders, curve = np.arange(1, max_order + 1), engine.curve
    amplitudes = np.abs(torque_harmonics(orders, curve))
    return {
        "engine": engine.title,
        "kind": engine.kind,
        **dict.fromkeys(CRANK_ENGINE_PARTS),
        "torque": {
            "mean_nm": curve.mean_nm,
            "work_per_rev_j": curve.work_per_rev_j,
            "extrema": [
                {"crank_angle_deg": float(360 * angle), "torque_nm": float(extremum)}
                for angle, extremum in zip(*torque_extrema(curve), strict=True)
            ],
            "harmonics_nm": {str(order): float(value) for order, value in zip(orders, amplitudes, strict=True)},
        },
        "mechanisms": [_mechanism(data, curve, speeds_rpm) for data in engine.mechanisms],
        "notes": ["Rods without a stated moment of inertia are taken as uniform and slender."] if slender else [],
    }


def _mechanism(data: HingedCrankData, curve: CrankTorque, speeds_rpm: Sequence[float] | None) -> Sheet:
    """What the hinges of one mechanism must give, and what to choose."""
    crank = data.crank
    speeds = tuple(speeds_rpm or data.speeds_rpm)
    if not speeds or not all(math.isfinite(speed) and speed > 0 for speed in speeds):
        remedy = "Give one with --speed"
        raise RequestError("a mechanism needs a speed", place=data.name, found=speeds, allowed="> 0", remedy=remedy)
    shaking = [_largest(force) for force in shaking_force(_ANGLES, crank)]
    if max(shaking) < ROUND_OFF * sum(mass * crank.rod_length_m for mass, _ in crank.rod_points):
        shaking = [0.0, 0.0]
    by_key = {str(round(speed, 6)): speed for speed in speeds}
    works = {"pin": pin_hinge_work, "strut": strut_hinge_work}
    cut_for = {"designed_speed_rpm": speeds[0]}  # the guides
    others = product(JOINTS, speeds[1:])
    springs = [_solution(air_spring, crank, curve, joint=joint, speed_rpm=rpm, **cut_for) for joint, rpm in others]
    stated = zip(JOINTS, (data.pin_guides, data.strut_guides), strict=True)
    return {
        "name": data.name,
        "lambda": crank.mechanism.crank_ratio,
        "static_moment_nm": crank.static_moment_nm,
        "weight_moment_nm": weight_moment(crank),
        "mean_gas_moment_nm": mean_gas_moment(crank, curve),
        "shaking_force_kg_m": dict(zip("xy", shaking, strict=True)),
        "side_force_without_hinge_n": {
            key: _largest(side_force_without_hinge(_ANGLES, crank, curve, speed_rpm=speed))
            for key, speed in by_key.items()
        },
        "curves": {key: _curves(crank, curve, speed) for key, speed in by_key.items()},
        "side_force_n": {kind: _largest(side_force(_ANGLES, crank, curve, pin_hinge=kind)) for kind in KINDS},
        "work_j": {
            kind: {joint: work(crank, curve, pin_hinge=kind) for joint, work in works.items()} for kind in KINDS
        },
        "solutions": _solutions(crank, curve),
        "characteristic": {joint: _characteristic(crank, curve, joint, max(speeds)) for joint in JOINTS},
        "air_spring": [spring for spring in springs if spring is not None],
        "guides": {
            joint: None if guides is None else _guides(crank, curve, joint, max(speeds), guides)
            for joint, guides in stated
        },
    }


def _curves(crank: HingedCrank, curve: CrankTorque, speed_rpm: float) -> dict[str, list[float]]:
    """Figure 3: M12 by (4), by (6) and of a spring, R430 and R43 by (7), every 10° of crank angle."""
    angles = np.arange(TABLE_STEPS + 1) / TABLE_STEPS
    moments = {kind: hinge_moment(angles, crank, curve, speed_rpm=speed_rpm, pin_hinge=kind) for kind in KINDS}
    return {
        "crank_angle_deg": (360 * angles).tolist(),
        **{f"m12_{kind}_nm": moment.tolist() for kind, moment in moments.items()},
        "r430_n": side_force_without_hinge(angles, crank, curve, speed_rpm=speed_rpm).tolist(),
        "r43_printed_n": side_force(angles, crank, curve, pin_hinge="printed").tolist(),
    }


def _guides(crank: HingedCrank, curve: CrankTorque, joint: Joint, speed_rpm: float, data: GuideData) -> Sheet:
    """Spring and guides of a hinge over its own angle."""
    guides = hinge_guides(hinge_table(crank, curve, joint=joint, speed_rpm=speed_rpm, n_steps=GUIDE_STEPS), data)
    rows = slice(None, None, GUIDE_STEPS // TABLE_STEPS)
    sheet = {
        "speed_rpm": speed_rpm,
        **{key: getattr(guides, key) for key in ("stiffness_n_per_m", "steepest_deg", "undercut")},
        "hinge_angle_deg": (360 * guides.hinge_angle_rev[rows]).tolist(),
        "length_m": guides.length_m[rows].tolist(),
    }
    for side, surface in (("outer", guides.outer_m), ("inner", guides.inner_m)):
        sheet |= {f"{side}_x_m": surface.real[rows].tolist(), f"{side}_y_m": surface.imag[rows].tolist()}
    return sheet


def _largest(values: Angles) -> float:
    return float(np.abs(values).max())


def _solutions(crank: HingedCrank, curve: CrankTorque) -> Sheet:
    """Weights without side force by kind of hinge, the counterweight of equation (12), those of equation (13)."""
    kinds: dict[str, dict[str, Any]] = {
        "potential": {"pin_hinge": "potential"},
        "printed": {"pin_hinge": "printed"},
        "printed_truncated": {"pin_hinge": "printed", "truncated": True},
    }
    both = _solution(balanced_crank, crank)
    names = ("rod_counterweight_n", "crank_counterweight_n")
    return {
        "weight_without_side_force": {
            weight: {
                kind: _solution(weight_without_side_force, crank, curve, weight=weight, **options)
                for kind, options in kinds.items()
            }
            for weight in get_args(Weight)
        },
        "crank_counterweight_n": _solution(vertical_counterweight, crank),
        "balanced": None if both is None else {name: getattr(both, name) for name in names},
    }


def _solution(solve: Callable[..., T], *arguments: object, **options: object) -> T | None:
    """What ``solve`` returns, None where there is no solution."""
    try:
        return solve(*arguments, **options)
    except RequestError:
        return None


def _characteristic(crank: HingedCrank, curve: CrankTorque, joint: Joint, speed_rpm: float) -> Sheet:
    """Moment and work of a hinge over its own angle."""
    table = hinge_table(crank, curve, joint=joint, speed_rpm=speed_rpm, n_steps=TABLE_STEPS)
    dust = ROUND_OFF * np.abs(table.work_j).max()
    return {
        "speed_rpm": speed_rpm,
        "hinge_angle_deg": (360 * table.hinge_angle_rev).tolist(),
        "crank_angle_deg": (360 * table.crank_angle_rev).tolist(),
        "moment_nm": table.moment_nm.tolist(),
        "work_j": np.where(np.abs(table.work_j) > dust, table.work_j, 0.0).tolist(),
    }
