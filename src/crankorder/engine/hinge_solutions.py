"""What to choose so that the hinges work: weights, counterweights, the table of a hinge, the pressure of an air spring.

Source: Zotov, Sviridov, Tokarev (document 003), figures 4 to 7 and equations (11) to (13); truth sheet 4.3 to 4.5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.engine.crank_torque import CrankTorque
from crankorder.engine.elastic_hinge import (
    PinHinge,
    branch_quadrature,
    hinge_moment,
    mean_gas_moment,
    mean_rod_cosine,
)
from crankorder.engine.hinge_inertia import reduced_inertia, strut_hinge_moment
from crankorder.engine.hinged_crank import HingedCrank, Kinematics, rod_motion
from crankorder.errors import RequestError

Angles = NDArray[np.float64]

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
    kinematics: Kinematics = "exact",
) -> float:
    """Weight (N) with which the hinge at the crank pin leaves no side force, at every angle and every speed.

    ``crank``: lengths and the other weights. ``torque``: of the crank. ``weight``: the one to find. ``pin_hinge``:
    "potential" asks for G = 0, which is P4 of equation (13); "printed" asks for G⟨cos ψ⟩ = −⟨T⟩, figure 4.
    ``kinematics``: "truncated" gives the document's own numbers. Raises RequestError where no weight does it.
    """
    arms = {
        "rod_weight_n": crank.pin_to_rod_centre_m,
        "piston_weight_n": crank.rod_length_m,
        "rod_counterweight_n": -crank.rod_counterweight_radius_m,
    }
    wanted = 0.0
    if pin_hinge == "printed":
        wanted = -mean_gas_moment(crank, torque) / mean_rod_cosine(crank, kinematics=kinematics)
    others = sum(getattr(crank, name) * arm for name, arm in arms.items() if name != weight)
    found = (wanted - others) / arms[weight] if arms[weight] else np.nan
    if not found >= 0:
        raise RequestError(
            f"no {weight} of zero or more leaves the piston without side force",
            found=f"arm {arms[weight]} m, moment {wanted - others} N·m",
            remedy="Give it an arm, or change another weight",
        )
    return float(found)


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
    return replace(crank, rod_counterweight_n=on_rod, crank_counterweight_n=on_crank)


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
    result: Angles = whole + np.arctan2(np.sin(angle), reach) / (2 * np.pi)
    return result


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
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    joint: Joint,
    speed_rpm: float,
    pin_hinge: PinHinge = "potential",
    n_steps: int = 360,
) -> HingeTable:
    """Moment and work of a hinge against its own angle.

    ``crank``: lengths, weights, inertias. ``torque``: of the crank. ``joint``: "pin" or "strut". ``speed_rpm``: the
    constant crank speed that the hinge is for. ``pin_hinge``: what the hinge at the crank pin gives. ``n_steps``: even
    steps of the hinge angle, ≥ 2, an even number so that the kink at the lower dead centre falls on a row; more steps
    cost time, the work is exact to round-off from about 30 on at λ = ½.
    Raises RequestError for another number of steps.
    """
    if n_steps < 2 or n_steps % 2:
        raise RequestError("a hinge table needs an even number of steps", found=n_steps, allowed="2, 4, 6 …")

    def crank_angle(hinge_angle_rev: Angles) -> Angles:
        return hinge_angle_rev if joint == "strut" else crank_angle_of_hinge(hinge_angle_rev, crank)

    def moment(hinge_angle_rev: Angles) -> Angles:
        turned = crank_angle(hinge_angle_rev)
        return _moment(turned, crank, torque, joint=joint, speed_rpm=speed_rpm, pin_hinge=pin_hinge)

    rows = np.arange(n_steps + 1) / n_steps
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS_PER_STEP)
    between = (rows[:-1, None] + rows[1:, None]) / 2 + nodes / (2 * n_steps)
    steps = moment(between) @ weights * (np.pi / n_steps)
    return HingeTable(
        hinge_angle_rev=rows,
        crank_angle_rev=crank_angle(rows),
        moment_nm=moment(rows),
        work_j=np.concatenate(([0.0], np.cumsum(steps))),
    )


@dataclass(frozen=True, kw_only=True)
class PressureChange:
    """What an air spring needs, and still lacks, when the crank runs at another speed than its guides are for."""

    pressure_ratio: float
    """Charge pressure over that of the design speed: the best in the least squares over the hinge angle."""
    residual_rms_nm: float
    """What the moment of the hinge still differs from the one needed (N·m, rms over the hinge angle)."""
    residual_share: float
    """That difference over the rms of the moment needed."""
    energy_swing_j: float
    """Largest less smallest energy (J) that the difference gives the crank within a revolution."""
    speed_fluctuation: float
    """Coefficient of unevenness of the crank speed that this swing makes, (fastest − slowest) / mean."""


def air_spring_pressure(
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    joint: Joint,
    designed_speed_rpm: float,
    speed_rpm: float,
    pin_hinge: PinHinge = "potential",
) -> PressureChange:
    """Pressure ratio that an air spring in the same guides needs at another speed, and what it leaves undone.

    The moment of an air spring is its charge pressure times a curve of the guides: one ratio scales it at all angles.
    The moment needed is a part that no speed changes, and one that grows with its square. The ratio is exact only where
    the first part vanishes: then it is the squared ratio of the speeds.

    ``crank``: lengths, weights, inertias. ``torque``: of the crank, the same at both speeds. ``joint``: "pin" or
    "strut". ``designed_speed_rpm``: that the guides are cut for. ``speed_rpm``: the other one, > 0. ``pin_hinge``: what
    the hinge at the crank pin gives. Raises RequestError where the guides give no moment, or the speed is not positive.
    """
    if not speed_rpm > 0:
        raise RequestError("the other speed must be positive", found=speed_rpm)
    crank_angle_rev, weight = branch_quadrature(crank, torque)
    if joint == "pin":
        weight = weight * rod_motion(crank_angle_rev, crank).hinge_rate
    designed, needed = (
        _moment(crank_angle_rev, crank, torque, joint=joint, speed_rpm=speed, pin_hinge=pin_hinge)
        for speed in (designed_speed_rpm, speed_rpm)
    )
    strength = float(weight @ designed**2)
    if strength == 0:
        raise RequestError("guides without a moment cannot be scaled to another speed", found=designed_speed_rpm)
    ratio = float(weight @ (designed * needed)) / strength
    residual_rms = float(np.sqrt(weight @ (needed - ratio * designed) ** 2))
    tables = [
        hinge_table(crank, torque, joint=joint, speed_rpm=speed, pin_hinge=pin_hinge, n_steps=_SWING_STEPS)
        for speed in (designed_speed_rpm, speed_rpm)
    ]
    swing = float(np.ptp(tables[1].work_j - ratio * tables[0].work_j))
    energy = float(np.mean(reduced_inertia(tables[0].crank_angle_rev[:-1], crank))) * (speed_rpm * np.pi / 30) ** 2
    needed_rms = float(np.sqrt(weight @ needed**2))
    return PressureChange(
        pressure_ratio=ratio,
        residual_rms_nm=residual_rms,
        residual_share=residual_rms / needed_rms if needed_rms else 0.0,
        energy_swing_j=swing,
        speed_fluctuation=swing / energy,
    )


def _moment(
    crank_angle_rev: Angles,
    crank: HingedCrank,
    torque: CrankTorque,
    *,
    joint: Joint,
    speed_rpm: float,
    pin_hinge: PinHinge,
) -> Angles:
    needed = hinge_moment if joint == "pin" else strut_hinge_moment
    return needed(crank_angle_rev, crank, torque, speed_rpm=speed_rpm, pin_hinge=pin_hinge)


def _over_radius(moment_nm: float, radius_m: float, name: str) -> float:
    if radius_m == 0:
        raise RequestError(f"{name} is zero: a counterweight without a radius balances nothing", found=radius_m)
    return moment_nm / radius_m
