"""The sheet of an engine with elastic hinges: torque, what each mechanism asks of its hinges, remedies."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, get_args

import numpy as np

from crankorder.engine.elastic_hinge import (
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
Sheet = dict[str, Any]
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
        "air_spring": [
            spring
            for joint in JOINTS
            for speed in speeds[1:]  # the guides are cut for the first
            if (
                spring := _solution(
                    air_spring, crank, curve, joint=joint, designed_speed_rpm=speeds[0], speed_rpm=speed
                )
            )
        ],
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
        "stiffness_n_per_m": guides.stiffness_n_per_m,
        "steepest_deg": guides.steepest_deg,
        "undercut": guides.undercut,
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
