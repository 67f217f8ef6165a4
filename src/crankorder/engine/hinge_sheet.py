"""The sheet of an engine with elastic hinges: torque, what each mechanism asks of its hinges, remedies."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, get_args

import numpy as np

from crankorder.engine.elastic_hinge import (
    Joint,
    PinHinge,
    Weight,
    air_spring_pressure,
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
from crankorder.errors import RequestError

TABLE_STEPS = 36
"""Rows of a hinge's characteristic in the sheet: every 10° of its own angle."""

ROUND_OFF = 1e-12
"""A force or work below this share of its terms is what is left of terms that cancel, and set to zero."""

CRANK_ENGINE_PARTS = ("lambda", "harmonics", "force_g_mm", "strategies", "shafts", "crankshaft")
"""What every balance document names and an engine with elastic hinges does not have; each mechanism has its own λ."""

_ANGLES = np.arange(1440) / 1440


def hinge_sheet(engine: HingedEngine, *, max_order: int, speeds_rpm: Sequence[float] | None = None) -> dict[str, Any]:
    """Torque, hinge moments, side forces and solutions as one document of plain numbers, lists and texts.

    A solution that does not exist is None, and so are the parts of a crank engine. ``engine``: torque curve and
    mechanisms. ``max_order``: highest harmonic of the torque, ≥ 1. ``speeds_rpm``: crank speeds, > 0; those of each
    mechanism where left out.
    Raises RequestError where a mechanism has no speed.
    """
    mechanisms = [_mechanism(one, engine.curve, speeds_rpm) for one in engine.mechanisms]
    slender = any(one.rod_inertia_kg_m2 is None for one in engine.mechanisms)
    return {
        "engine": engine.title,
        "kind": engine.kind,
        **dict.fromkeys(CRANK_ENGINE_PARTS),
        "torque": _torque(engine.curve, max_order),
        "mechanisms": mechanisms,
        "notes": ["Rods without a stated moment of inertia are taken as uniform and slender."] if slender else [],
        "sentences": [_sentence(one) for one in mechanisms],
    }


def _torque(curve: CrankTorque, max_order: int) -> dict[str, Any]:
    angles, torques = torque_extrema(curve)
    orders = np.arange(1, max_order + 1)
    amplitudes = np.abs(torque_harmonics(orders, curve))
    return {
        "mean_nm": curve.mean_nm,
        "work_per_rev_j": curve.work_per_rev_j,
        "extrema": [
            {"crank_angle_deg": float(360 * angle), "torque_nm": float(torque)}
            for angle, torque in zip(angles, torques, strict=True)
        ],
        "harmonics_nm": {str(order): float(value) for order, value in zip(orders, amplitudes, strict=True)},
    }


def _mechanism(data: HingedCrankData, curve: CrankTorque, speeds_rpm: Sequence[float] | None) -> dict[str, Any]:
    crank = data.crank
    speeds = tuple(speeds_rpm or data.speeds_rpm)
    if not speeds or not all(math.isfinite(speed) and speed > 0 for speed in speeds):
        raise RequestError(
            "a mechanism needs a speed", place=data.name, found=speeds, allowed="> 0", remedy="Give one with --speed"
        )
    along, across = (_largest(force) for force in shaking_force(_ANGLES, crank))
    balanced = max(along, across) < ROUND_OFF * sum(mass * crank.rod_length_m for mass, _ in crank.rod_points)
    kinds: tuple[PinHinge, ...] = get_args(PinHinge)
    return {
        "name": data.name,
        "lambda": crank.mechanism.crank_ratio,
        "static_moment_nm": crank.static_moment_nm,
        "weight_moment_nm": weight_moment(crank),
        "mean_gas_moment_nm": mean_gas_moment(crank, curve),
        "shaking_force_kg_m": {"x": 0.0, "y": 0.0} if balanced else {"x": along, "y": across},
        "side_force_without_hinge_n": {
            str(round(speed, 6)): _largest(side_force_without_hinge(_ANGLES, crank, curve, speed_rpm=speed))
            for speed in speeds
        },
        "curves": {str(round(speed, 6)): _curves(crank, curve, speed) for speed in speeds},
        "side_force_n": {kind: _largest(side_force(_ANGLES, crank, curve, pin_hinge=kind)) for kind in kinds},
        "work_j": {
            kind: {
                "pin": pin_hinge_work(crank, curve, pin_hinge=kind),
                "strut": strut_hinge_work(crank, curve, pin_hinge=kind),
            }
            for kind in kinds
        },
        "solutions": _solutions(crank, curve),
        "characteristic": {joint: _characteristic(crank, curve, joint, max(speeds)) for joint in get_args(Joint)},
        "air_spring": _air_spring(crank, curve, speeds),
        "guides": {
            joint: _guides(crank, curve, joint, max(speeds), guides)
            for joint, guides in zip(get_args(Joint), (data.pin_guides, data.strut_guides), strict=True)
        },
    }


def _curves(crank: HingedCrank, curve: CrankTorque, speed_rpm: float) -> dict[str, list[float]]:
    """Figure 3: M12 by (4), by (6) and of a spring, R430 and R43 by (7), every 10° of crank angle."""
    angles = np.arange(TABLE_STEPS + 1) / TABLE_STEPS
    return {
        "crank_angle_deg": (360 * angles).tolist(),
        **{
            f"m12_{kind}_nm": hinge_moment(angles, crank, curve, speed_rpm=speed_rpm, pin_hinge=kind).tolist()
            for kind in get_args(PinHinge)
        },
        "r430_n": side_force_without_hinge(angles, crank, curve, speed_rpm=speed_rpm).tolist(),
        "r43_printed_n": side_force(angles, crank, curve, pin_hinge="printed").tolist(),
    }


GUIDE_STEPS = 20 * TABLE_STEPS
"""Rows from which guides are cut: half a degree."""


def _guides(
    crank: HingedCrank, curve: CrankTorque, joint: Joint, speed_rpm: float, data: GuideData | None
) -> dict[str, Any] | None:
    if data is None:
        return None
    found = hinge_guides(hinge_table(crank, curve, joint=joint, speed_rpm=speed_rpm, n_steps=GUIDE_STEPS), data)
    rows = slice(None, None, GUIDE_STEPS // TABLE_STEPS)
    return {
        "speed_rpm": speed_rpm,
        "stiffness_n_per_m": found.stiffness_n_per_m,
        "steepest_deg": found.steepest_deg,
        "undercut": found.undercut,
        "hinge_angle_deg": (360 * found.hinge_angle_rev[rows]).tolist(),
        "length_m": found.length_m[rows].tolist(),
        **{
            f"{side}_{axis}_m": part[rows].tolist()
            for side, surface in (("outer", found.outer_m), ("inner", found.inner_m))
            for axis, part in (("x", surface.real), ("y", surface.imag))
        },
    }


def _largest(values: Any) -> float:
    return float(np.abs(values).max())


def _solutions(crank: HingedCrank, curve: CrankTorque) -> dict[str, Any]:
    """Weights without side force by kind of hinge, the counterweight of equation (12), those of equation (13)."""
    weights: dict[str, dict[str, Any]] = {weight: {} for weight in get_args(Weight)}
    for weight, by_hinge in weights.items():
        solve = partial(_found, weight_without_side_force, crank, curve, weight=weight)
        by_hinge["potential"] = solve(pin_hinge="potential")
        by_hinge["printed"] = solve(pin_hinge="printed")
        by_hinge["printed_truncated"] = solve(pin_hinge="printed", kinematics="truncated")
    both = _found(balanced_crank, crank)
    return {
        "weight_without_side_force": weights,
        "crank_counterweight_n": _found(vertical_counterweight, crank),
        "balanced": both
        and {
            "rod_counterweight_n": both.rod_counterweight_n,
            "crank_counterweight_n": both.crank_counterweight_n,
        },
    }


def _found(solve: Callable[..., Any], *data: Any, **choices: Any) -> Any:
    """What ``solve`` finds of ``data``, None where there is no solution."""
    try:
        return solve(*data, **choices)
    except RequestError:
        return None


def _characteristic(crank: HingedCrank, curve: CrankTorque, joint: Joint, speed_rpm: float) -> dict[str, Any]:
    table = hinge_table(crank, curve, joint=joint, speed_rpm=speed_rpm, n_steps=TABLE_STEPS)
    dust = ROUND_OFF * np.abs(table.work_j).max()
    return {
        "speed_rpm": speed_rpm,
        "hinge_angle_deg": (360 * table.hinge_angle_rev).tolist(),
        "crank_angle_deg": (360 * table.crank_angle_rev).tolist(),
        "moment_nm": table.moment_nm.tolist(),
        "work_j": np.where(np.abs(table.work_j) > dust, table.work_j, 0.0).tolist(),
    }


def _air_spring(crank: HingedCrank, curve: CrankTorque, speeds: Sequence[float]) -> list[dict[str, Any]]:
    """Pressure ratios between the first speed, that the guides are cut for, and each other."""
    made = []
    for joint in get_args(Joint):
        for speed in speeds[1:]:
            run = {"joint": joint, "designed_speed_rpm": speeds[0], "speed_rpm": speed}
            change = _found(air_spring_pressure, crank, curve, **run)
            if change is not None:
                results = ("pressure_ratio", "residual_share", "speed_fluctuation")
                made.append({**run, **{name: getattr(change, name) for name in results}})
    return made


def _sentence(one: dict[str, Any]) -> str:
    speed, without = max(one["side_force_without_hinge_n"].items(), key=lambda item: float(item[0]))
    left, printed = one["side_force_n"]["potential"], one["side_force_n"]["printed"]
    text = (
        f"{one['name']}: without a hinge the piston is pressed against its wall with up to {without:.4g} N at "
        f"{float(speed):.4g} rpm; a hinge that can be a spring leaves {left:.4g} N at every speed"
    )
    return f"{text} (one after equation (6), whose work is not zero, {printed:.4g} N)."
