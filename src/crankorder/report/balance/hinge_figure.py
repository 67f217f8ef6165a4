"""Picture of an engine with elastic hinges: its torque, the side force without hinge, and what the hinges must give."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crankorder.engine.elastic_hinge import hinge_table, side_force_without_hinge
from crankorder.engine.hinged_crank import CrankTorque, HingedCrankData, HingedEngine, crank_torque, torque_extrema
from crankorder.report.balance.look import color_key
from crankorder.report.notation import number_text
from crankorder.report.style import (
    FAINT,
    INK,
    LINES,
    SMALL,
    axes_at,
    drawable,
    house_style,
    new_figure,
    quiet_frame,
    title_lines,
)
from crankorder.settings import ReportSettings

_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP_X, _GAP_Y = 0.95, 0.35, 1.1, 0.62, 0.95, 0.97  # inches
_ANGLES = np.arange(721) / 720


def hinge_figure(
    engine: HingedEngine, mechanism: HingedCrankData, speeds_rpm: tuple[float, ...], *, settings: ReportSettings
) -> Figure:
    """Crank torque, side force without hinge, and the moments of both hinges against their angle, for one mechanism.

    ``engine``: whose torque drives it. ``mechanism``: one of the engine's. ``speeds_rpm``: crank speeds, > 0, a line
    each. ``settings``: of the report.
    """
    with house_style():
        figure = new_figure(settings.width_in, settings.height_in)
        width = (settings.width_in - _LEFT - _RIGHT - _GAP_X) / 2
        height = (settings.height_in - _TOP - _BOTTOM - _GAP_Y) / 2
        boxes = [
            (_LEFT + column * (width + _GAP_X), _BOTTOM + row * (height + _GAP_Y), width, height)
            for row in (1, 0)
            for column in (0, 1)
        ]
        torque, side, pin, strut = (axes_at(figure, *box) for box in boxes)
        _torque(torque, engine.curve)
        for number, speed in enumerate(speeds_rpm):
            color = LINES[number % len(LINES)]
            force = side_force_without_hinge(_ANGLES, mechanism.crank, engine.curve, speed_rpm=speed)
            side.plot(360 * _ANGLES, force, color=color, gid=f"side-force-{number}")
            for axes, joint in ((pin, "pin"), (strut, "strut")):
                table = hinge_table(mechanism.crank, engine.curve, joint=joint, speed_rpm=speed)  # type: ignore[arg-type]
                axes.plot(360 * table.hinge_angle_rev, table.moment_nm, color=color, gid=f"{joint}-{number}")
        _frame(torque, "Crank torque", "N·m", "crank angle, °")
        _frame(side, "Side force on the piston without a hinge", "N", "crank angle, °")
        _frame(pin, "Hinge at the crank pin (a spring)", "N·m", "hinge angle, °")
        _frame(strut, "Hinge between strut and crank", "N·m", "crank angle, °")
        named = [(f"{speed:.0f} rpm", LINES[number % len(LINES)]) for number, speed in enumerate(speeds_rpm)]
        for box in boxes[1:]:
            color_key(figure, box, named)
        name = drawable(mechanism.name, settings.max_name_characters)
        said = (
            f"{drawable(engine.title, 2 * settings.max_name_characters)}. Moments that keep the crank speed constant."
        )
        title_lines(figure, _LEFT, f"{name} · elastic hinges", said)
        return figure


def _torque(axes: Axes, curve: CrankTorque) -> None:
    axes.plot(360 * _ANGLES, crank_torque(_ANGLES, curve), color=INK, gid="torque")
    axes.axhline(curve.mean_nm, color=LINES[1], linewidth=0.9)
    look: dict[str, Any] = {"fontsize": SMALL, "color": LINES[1], "ha": "right", "va": "bottom"}
    axes.text(356, curve.mean_nm, f"mean {number_text(curve.mean_nm)} N·m", **look)
    angles, torques = torque_extrema(curve)
    axes.plot(360 * angles, torques, linestyle="", marker="o", markersize=3, color=INK)
    for angle, torque in zip(angles, torques, strict=True):
        shift = 5 if torque > curve.mean_nm else -5
        axes.annotate(number_text(float(torque)), (360 * angle, torque), xytext=(0, shift), textcoords="offset points",
                      ha="center", va="bottom" if shift > 0 else "top", fontsize=SMALL)  # fmt: skip
    axes.margins(y=0.14)


def _frame(axes: Axes, title: str, unit: str, angle: str) -> None:
    quiet_frame(axes)
    axes.set_title(title, fontsize=9, pad=18 if title != "Crank torque" else 6)
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 90))
    axes.set_xlabel(angle)
    axes.set_ylabel(unit)
    axes.axhline(0, color=FAINT, linewidth=0.8, zorder=1)
