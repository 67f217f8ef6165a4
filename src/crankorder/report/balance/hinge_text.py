"""The sheet of an engine with elastic hinges as plain text: tables, then what remains in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from crankorder.errors import printable
from crankorder.report.text_table import WIDTH, Cell, closing, text_table

_WEIGHTS = {
    "rod_weight_n": "rod weight",
    "piston_weight_n": "piston weight",
    "rod_counterweight_n": "rod counterweight",
}


def hinge_text(sheet: Mapping[str, Any]) -> str:
    """Tables and sentences of a hinge sheet, no line wider than a terminal's page.

    ``sheet`` as :func:`crankorder.engine.hinge_sheet.hinge_sheet` makes it; solutions that do not exist are left out.
    """
    torque = sheet["torque"]
    lines = [printable(sheet["engine"], WIDTH), ""]
    rows: list[Sequence[Cell]] = [
        ("mean, N·m", torque["mean_nm"]),
        ("work per revolution, J", torque["work_per_rev_j"]),
    ]
    lines += text_table("Crank torque", ["", ""], rows)
    extrema = [(one["crank_angle_deg"], one["torque_nm"]) for one in torque["extrema"]]
    lines += text_table("Extrema of the crank torque", ["crank angle °", "N·m"], extrema, kept=0)
    lines += text_table("Crank torque by order", ["order", "N·m"], torque["harmonics_nm"].items())
    lines += _side_forces(sheet["mechanisms"]) + _moments(sheet["mechanisms"]) + _solutions(sheet["mechanisms"])
    for one in sheet["mechanisms"]:
        lines += _characteristic(one)
    lines += _air_springs(sheet["mechanisms"])
    return "\n".join([*lines, *closing("What remains", sheet)]) + "\n"


def _side_forces(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    rows: list[list[Cell]] = [
        [one["name"], float(speed), without, *(one["side_force_n"][kind] for kind in ("full", "potential", "printed"))]
        for one in mechanisms
        for speed, without in one["side_force_without_hinge_n"].items()
    ]
    heads = ["mechanism", "rpm", "no hinge", "full M12", "potential", "printed (6)"]
    return text_table("Largest side force on the piston (R430 without hinge, R43 with it), N", heads, rows)


def _moments(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = ("lambda", "static_moment_nm", "weight_moment_nm", "mean_gas_moment_nm")
    rows: list[list[Cell]] = [
        [one["name"], *(one[key] for key in keys), *(1e3 * one["shaking_force_kg_m"][axis] for axis in "xy")]
        for one in mechanisms
    ]
    heads = ["mechanism", "λ", "G, N·m", "weights, N·m", "gas mean, N·m", "shakes x, kg·mm", "y, kg·mm"]
    lines = text_table("Moments and shaking force over ω²", heads, rows)
    works: list[list[Cell]] = [
        [one["name"], *(one["work_j"][kind][joint] for kind in ("full", "printed") for joint in ("pin", "strut"))]
        for one in mechanisms
    ]
    heads = ["mechanism", "full, pin", "full, strut", "printed, pin", "printed, strut"]
    return lines + text_table("Work of the hinges per revolution, J (a spring needs zero: potential)", heads, works)


def _solutions(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    rows: list[list[Cell]] = []
    for one in mechanisms:
        found = one["solutions"]
        for weight, text in _WEIGHTS.items():
            kinds = found["weight_without_side_force"][weight]
            rows.append([one["name"], f"{text}, no side force", kinds["potential"], kinds["printed"]])
        rows.append([one["name"], "crank counterweight, eq. (12)", found["crank_counterweight_n"], None])
        for key, text in (("rod_counterweight_n", "rod"), ("crank_counterweight_n", "crank")):
            amount = None if found["balanced"] is None else found["balanced"][key]
            rows.append([one["name"], f"{text} counterweight, eq. (13)", amount, None])
    heads = ["mechanism", "what to choose", "N", "N, printed (6)"]
    return text_table("Solutions", heads, rows, kept=2)


def _characteristic(one: Mapping[str, Any]) -> list[str]:
    pin, strut = one["characteristic"]["pin"], one["characteristic"]["strut"]
    columns = [
        pin["hinge_angle_deg"], pin["crank_angle_deg"], pin["moment_nm"], pin["work_j"], strut["moment_nm"],
        strut["work_j"],
    ]  # fmt: skip
    heads = ["hinge angle °", "pin: crank °", "N·m", "work J", "strut: N·m", "work J"]
    title = f"Hinge characteristics of {one['name']} at {pin['speed_rpm']:.5g} rpm"
    return text_table(title, heads, zip(*columns, strict=True), kept=0)


def _air_springs(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = ("joint", "designed_speed_rpm", "speed_rpm", "pressure_ratio", "residual_share", "speed_fluctuation")
    rows = [[one["name"], *(change[key] for key in keys)] for one in mechanisms for change in one["air_spring"]]
    heads = ["mechanism", "hinge", "cut for rpm", "at rpm", "pressure ratio", "share left", "unevenness"]
    return text_table("Air spring at another speed", heads, rows, kept=2)
