"""The sheet of an engine with elastic hinges: torque, what each mechanism asks of its hinges, remedies."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar, get_args

import numpy as np

from crankorder.engine.elastic_hinge import (
    AirSpring,
    Joint,
    PinHinge,
    Weight,
    air_spring,
    balanced_crank,
    hinge_guides,
    hinge_moment,
    hinge_table,
    mean_gas_moment,
    pin_hinge_work,
    shaking_force,
    side_force,
    side_force_without_hinge,
    strut_hinge_work,
    vertical_counterweight,
    weight_moment,
    weight_without_side_force,
)
from crankorder.engine.hinged_crank import (
    CrankTorque,
    GuideData,
    HingedCrank,
    HingedCrankData,
    HingedEngine,
    torque_extrema,
    torque_harmonics,
)
from crankorder.engine.slider_crank import Angles
from crankorder.errors import RequestError
from crankorder.records import Record, said

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
T = TypeVar("T")


class TorqueExtremum(Record):
    """A crank angle at which the torque is stationary."""

    crank_angle_deg: float = said("crank angle, degrees")
    torque_nm: float = said("torque there, N·m")


class TorqueSummary(Record):
    """Torque on the crank."""

    mean_nm: float = said("mean, N·m")
    work_per_rev_j: float = said("work per revolution, J")
    extrema: tuple[TorqueExtremum, ...] = said("largest and smallest torques")
    harmonics_nm: dict[str, float] = said("amplitude by order, N·m")


class Solutions(Record):
    """Weights that solve one problem of a mechanism each; null where there is no solution."""

    weight_without_side_force: dict[Weight, dict[str, float | None]] = said("weight by kind of hinge, N")
    crank_counterweight_n: float | None = said("counterweight of equation (12), N")
    balanced: dict[str, float] | None = said("counterweights of equation (13), N")


class Characteristic(Record):
    """Moment and work of a hinge over its own angle."""

    speed_rpm: float = said("crank speed, rpm")
    hinge_angle_deg: Angles = said("angle of the hinge, degrees")
    crank_angle_deg: Angles = said("crank angle there, degrees")
    moment_nm: Angles = said("moment of the hinge, N·m")
    work_j: Angles = said("work that the hinge has given since angle zero, J")


class GuideShape(Record):
    """Spring and guides of a hinge over its own angle."""

    speed_rpm: float = said("crank speed, rpm")
    stiffness_n_per_m: float = said("stiffness of the spring, N/m")
    steepest_deg: float = said("largest angle between the force on a roller and the spring, degrees")
    undercut: bool = said("whether a guide is curved more sharply than its roller")
    hinge_angle_deg: Angles = said("angle of the hinge, degrees")
    length_m: Angles = said("length of the spring, m")
    surfaces: dict[str, Angles] = said("places of both guides from the axis of the hinge, m", spread=True)


class Mechanism(Record):
    """A crank mechanism with elastic hinges: what they must give, and what to choose."""

    name: str = said("name")
    crank_ratio: float = said("crank radius over rod length", key="lambda")
    static_moment_nm: float = said("static moment G, N·m")
    weight_moment_nm: float = said("moment of the weights, N·m")
    mean_gas_moment_nm: float = said("mean moment of the gas about the crank pin, N·m")
    shaking_force_kg_m: dict[str, float] = said("largest force by direction, kg·m over ω²")
    side_force_without_hinge_n: dict[str, float] = said("largest side force on the piston by speed, N")
    curves: dict[str, dict[str, Angles]] = said("hinge moments (N·m) and side forces (N) by speed and name")
    side_force_n: dict[PinHinge, float] = said("largest side force that each kind of hinge leaves, N")
    work_j: dict[PinHinge, dict[Joint, float]] = said("work per revolution by kind of hinge and joint, J")
    solutions: Solutions = said("weights to choose")
    characteristic: dict[Joint, Characteristic] = said("moment over the hinge's angle, at the highest speed")
    air_spring: tuple[AirSpring, ...] = said("air springs at other speeds")
    guides: dict[Joint, GuideShape | None] = said("guides of each hinge that the file states them for")


class HingeSheet(Record):
    """Torque, hinge moments, side forces and solutions of an engine with elastic hinges."""

    engine: str = said("title of the engine")
    kind: str = said("elastic-hinge")
    crank_engine: dict[str, None] = said("parts of a crank engine, which it does not have", spread=True)
    torque: TorqueSummary = said("torque on the crank")
    mechanisms: tuple[Mechanism, ...] = said("mechanisms that this torque drives")
    notes: tuple[str, ...] = said("what was assumed")
    sentences: tuple[str, ...] = said("what remains")


def hinge_sheet(engine: HingedEngine, *, max_order: int, speeds_rpm: Sequence[float] | None = None) -> HingeSheet:
    """Torque, hinge moments, side forces and solutions of an engine with elastic hinges.

    ``engine``: torque curve and mechanisms. ``max_order``: highest harmonic of the torque, ≥ 1. ``speeds_rpm``: crank
    speeds, > 0; those of each mechanism where left out. Raises RequestError where a mechanism has no speed.
    """
    mechanisms = tuple(_mechanism(data, engine.curve, speeds_rpm) for data in engine.mechanisms)
    slender = any(data.rod_inertia_kg_m2 is None for data in engine.mechanisms)
    orders, curve = np.arange(1, max_order + 1), engine.curve
    amplitudes = np.abs(torque_harmonics(orders, curve))
    torque = TorqueSummary(
        mean_nm=curve.mean_nm,
        work_per_rev_j=curve.work_per_rev_j,
        extrema=tuple(
            TorqueExtremum(crank_angle_deg=float(360 * angle), torque_nm=float(extremum))
            for angle, extremum in zip(*torque_extrema(curve), strict=True)
        ),
        harmonics_nm={str(order): float(value) for order, value in zip(orders, amplitudes, strict=True)},
    )
    return HingeSheet(
        engine=engine.title,
        kind=engine.kind,
        crank_engine=dict.fromkeys(CRANK_ENGINE_PARTS),
        torque=torque,
        mechanisms=mechanisms,
        notes=("Rods without a stated moment of inertia are taken as uniform and slender.",) if slender else (),
        sentences=tuple(map(_sentence, mechanisms)),
    )


def _mechanism(data: HingedCrankData, curve: CrankTorque, speeds_rpm: Sequence[float] | None) -> Mechanism:
    crank = data.crank
    speeds = tuple(speeds_rpm or data.speeds_rpm)
    if not speeds or not all(math.isfinite(speed) and speed > 0 for speed in speeds):
        remedy = "Give one with --speed"
        raise RequestError("a mechanism needs a speed", place=data.name, found=speeds, allowed="> 0", remedy=remedy)
    along, across = (_largest(force) for force in shaking_force(_ANGLES, crank))
    balanced = max(along, across) < ROUND_OFF * sum(mass * crank.rod_length_m for mass, _ in crank.rod_points)
    kinds: tuple[PinHinge, ...] = get_args(PinHinge)
    by_key = {str(round(speed, 6)): speed for speed in speeds}
    without_hinge = {key: side_force_without_hinge(_ANGLES, crank, curve, speed_rpm=by_key[key]) for key in by_key}
    works: dict[Joint, Callable[..., float]] = {"pin": pin_hinge_work, "strut": strut_hinge_work}
    scaled = partial(air_spring, crank, curve, designed_speed_rpm=speeds[0])  # that the guides are cut for
    return Mechanism(
        name=data.name,
        crank_ratio=crank.mechanism.crank_ratio,
        static_moment_nm=crank.static_moment_nm,
        weight_moment_nm=weight_moment(crank),
        mean_gas_moment_nm=mean_gas_moment(crank, curve),
        shaking_force_kg_m={"x": 0.0, "y": 0.0} if balanced else {"x": along, "y": across},
        side_force_without_hinge_n={key: _largest(force) for key, force in without_hinge.items()},
        curves={key: _curves(crank, curve, speed) for key, speed in by_key.items()},
        side_force_n={kind: _largest(side_force(_ANGLES, crank, curve, pin_hinge=kind)) for kind in kinds},
        work_j={kind: {joint: work(crank, curve, pin_hinge=kind) for joint, work in works.items()} for kind in kinds},
        solutions=_solutions(crank, curve),
        characteristic={joint: _characteristic(crank, curve, joint, max(speeds)) for joint in JOINTS},
        air_spring=tuple(
            spring
            for joint in JOINTS
            for speed in speeds[1:]
            if (spring := _solution(partial(scaled, joint=joint, speed_rpm=speed))) is not None
        ),
        guides={
            joint: None if guides is None else _guides(crank, curve, joint, max(speeds), guides)
            for joint, guides in zip(JOINTS, (data.pin_guides, data.strut_guides), strict=True)
        },
    )


def _curves(crank: HingedCrank, curve: CrankTorque, speed_rpm: float) -> dict[str, Angles]:
    """Figure 3: M12 by (4), by (6) and of a spring, R430 and R43 by (7), every 10° of crank angle."""
    angles = np.arange(TABLE_STEPS + 1) / TABLE_STEPS
    return {
        "crank_angle_deg": 360 * angles,
        **{
            f"m12_{kind}_nm": hinge_moment(angles, crank, curve, speed_rpm=speed_rpm, pin_hinge=kind)
            for kind in get_args(PinHinge)
        },
        "r430_n": side_force_without_hinge(angles, crank, curve, speed_rpm=speed_rpm),
        "r43_printed_n": side_force(angles, crank, curve, pin_hinge="printed"),
    }


def _guides(crank: HingedCrank, curve: CrankTorque, joint: Joint, speed_rpm: float, data: GuideData) -> GuideShape:
    guides = hinge_guides(hinge_table(crank, curve, joint=joint, speed_rpm=speed_rpm, n_steps=GUIDE_STEPS), data)
    rows = slice(None, None, GUIDE_STEPS // TABLE_STEPS)
    return GuideShape(
        speed_rpm=speed_rpm,
        stiffness_n_per_m=guides.stiffness_n_per_m,
        steepest_deg=guides.steepest_deg,
        undercut=guides.undercut,
        hinge_angle_deg=360 * guides.hinge_angle_rev[rows],
        length_m=guides.length_m[rows],
        surfaces={
            f"{side}_{axis}_m": part[rows]
            for side, surface in (("outer", guides.outer_m), ("inner", guides.inner_m))
            for axis, part in (("x", surface.real), ("y", surface.imag))
        },
    )


def _largest(values: Angles) -> float:
    return float(np.abs(values).max())


def _solutions(crank: HingedCrank, curve: CrankTorque) -> Solutions:
    """Weights without side force by kind of hinge, the counterweight of equation (12), those of equation (13)."""
    weights: dict[Weight, dict[str, float | None]] = {}
    for weight in get_args(Weight):
        solve = partial(weight_without_side_force, crank, curve, weight=weight)
        weights[weight] = {
            "potential": _solution(partial(solve, pin_hinge="potential")),
            "printed": _solution(partial(solve, pin_hinge="printed")),
            "printed_truncated": _solution(partial(solve, pin_hinge="printed", truncated=True)),
        }
    both = _solution(partial(balanced_crank, crank))
    names = ("rod_counterweight_n", "crank_counterweight_n")
    on_crank = _solution(partial(vertical_counterweight, crank))
    balanced = None if both is None else {name: getattr(both, name) for name in names}
    return Solutions(weight_without_side_force=weights, crank_counterweight_n=on_crank, balanced=balanced)


def _solution(solve: Callable[[], T]) -> T | None:
    """What ``solve`` returns, None where there is no solution."""
    try:
        return solve()
    except RequestError:
        return None


def _characteristic(crank: HingedCrank, curve: CrankTorque, joint: Joint, speed_rpm: float) -> Characteristic:
    table = hinge_table(crank, curve, joint=joint, speed_rpm=speed_rpm, n_steps=TABLE_STEPS)
    dust = ROUND_OFF * np.abs(table.work_j).max()
    return Characteristic(
        speed_rpm=speed_rpm,
        hinge_angle_deg=360 * table.hinge_angle_rev,
        crank_angle_deg=360 * table.crank_angle_rev,
        moment_nm=table.moment_nm,
        work_j=np.where(np.abs(table.work_j) > dust, table.work_j, 0.0),
    )


def _sentence(mechanism: Mechanism) -> str:
    without = mechanism.side_force_without_hinge_n
    speed = max(without, key=float)
    left, printed = mechanism.side_force_n["potential"], mechanism.side_force_n["printed"]
    text = (
        f"{mechanism.name}: without a hinge the piston is pressed against its wall with up to {without[speed]:.4g} N "
        f"at {float(speed):.4g} rpm; a hinge that can be a spring leaves {left:.4g} N at every speed"
    )
    return f"{text} (one after equation (6), whose work is not zero, {printed:.4g} N)."
