"""Pictures of an engine with elastic hinges: its torque, side forces, what the hinges must give, and their guides."""

from __future__ import annotations

from typing import get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from crankorder.engine.elastic_hinge import (
    Guides,
    Joint,
    hinge_guides,
    hinge_moment,
    hinge_table,
    side_force,
    side_force_without_hinge,
)
from crankorder.engine.hinge_sheet import GUIDE_STEPS
from crankorder.engine.hinged_crank import (
    CrankTorque,
    GuideData,
    HingedCrankData,
    HingedEngine,
    crank_torque,
    potential_torque,
    torque_extrema,
)
from crankorder.plot.palette import FAINT, GRID, INK, LINES, NORMAL, SMALL, drawable
from crankorder.plot.reading import number_text
from crankorder.plot.style import axes_at, house_style, new_figure, quiet_frame, title_lines, write
from crankorder.report.balance.look import color_key
from crankorder.settings import ReportSettings

_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP_X, _GAP_Y = 0.95, 0.35, 1.1, 0.62, 0.95, 0.97  # inches
_ANGLES = np.arange(721) / 720
_ROWS, _TALLER = 3, 1.38  # the page is that much higher than others
_PANELS = (
    ("Crank torque, and its part without work", "N·m", "crank angle, °"),
    ("Side force without a hinge, R430 (5)", "N", "crank angle, °"),
    ("Side force that a hinge leaves, R43 (7)", "N", "crank angle, °"),
    ("Moment between crank and rod, M12 (4); dashed (6)", "N·m", "crank angle, °"),
    ("Hinge at the crank pin (a spring)", "N·m", "hinge angle, °"),
    ("Hinge between strut and crank (a spring)", "N·m", "crank angle, °"),
)
_LEFT_BY = {"printed": "after equation (6)", "potential": "of a spring, without work"}


def hinge_figure(
    engine: HingedEngine, mechanism: HingedCrankData, speeds_rpm: tuple[float, ...], *, settings: ReportSettings
) -> Figure:
    """Crank torque, side force without and with hinge, M12, and the moments of both hinges, for one mechanism.

    ``engine``: whose torque drives it. ``mechanism``: one of the engine's. ``speeds_rpm``: crank speeds, > 0, a line
    each. ``settings``: of the report.
    """
    with house_style():
        full = settings.height_in * _TALLER
        figure = new_figure(settings.width_in, full)
        width = (settings.width_in - _LEFT - _RIGHT - _GAP_X) / 2
        height = (full - _TOP - _BOTTOM - (_ROWS - 1) * _GAP_Y) / _ROWS
        boxes = [
            (_LEFT + column * (width + _GAP_X), _BOTTOM + row * (height + _GAP_Y), width, height)
            for row in range(_ROWS - 1, -1, -1)
            for column in (0, 1)
        ]
        panels = [axes_at(figure, *box) for box in boxes]
        _torque(panels[0], engine.curve)
        peaks = []
        for (kind, text), color in zip(_LEFT_BY.items(), (LINES[1], INK), strict=True):
            force = side_force(_ANGLES, mechanism.crank, engine.curve, pin_hinge=kind)  # type: ignore[arg-type]
            panels[2].plot(360 * _ANGLES, force, color=color, gid=f"side-force-{kind}")
            peaks.append((f"{text}: up to {number_text(float(np.abs(force).max()))} N", color))
        panels[2].margins(y=0.15)
        color_key(figure, boxes[2], peaks)
        for number, speed in enumerate(speeds_rpm):
            _at_speed(panels, engine, mechanism, speed, number)
        for axes, (title, unit, angle) in zip(panels, _PANELS, strict=True):
            quiet_frame(axes)
            axes.set_title(title, fontsize=9, pad=18)
            axes.set(xlim=(0, 360), xticks=range(0, 361, 90), xlabel=angle, ylabel=unit)
            axes.axhline(0, color=FAINT, linewidth=0.8, zorder=1)
        named = [(f"{speed:.0f} rpm", LINES[number % len(LINES)]) for number, speed in enumerate(speeds_rpm)]
        for place in (1, 3, 4, 5):
            color_key(figure, boxes[place], named)
        color_key(figure, boxes[0], [("whole", INK), ("without its mean", LINES[0])])
        name = drawable(mechanism.name, settings.max_name_characters)
        subtitle = f"{drawable(engine.title, 2 * settings.max_name_characters)}. At a constant crank speed."
        title_lines(figure, _LEFT, f"{name} · elastic hinges", subtitle)
        return figure


def _at_speed(panels: list[Axes], engine: HingedEngine, mechanism: HingedCrankData, speed: float, number: int) -> None:
    """The curves of one ``speed`` (rpm) in the panels of side force, M12 and both hinges."""
    color, crank, curve = LINES[number % len(LINES)], mechanism.crank, engine.curve
    force = side_force_without_hinge(_ANGLES, crank, curve, speed_rpm=speed)
    panels[1].plot(360 * _ANGLES, force, color=color, gid=f"side-force-{number}")
    moment = hinge_moment(_ANGLES, crank, curve, speed_rpm=speed, pin_hinge="full")
    panels[3].plot(360 * _ANGLES, moment, color=color, gid=f"m12-full-{number}")
    moment = hinge_moment(_ANGLES, crank, curve, speed_rpm=speed, pin_hinge="printed")
    panels[3].plot(360 * _ANGLES, moment, color=color, gid=f"m12-printed-{number}", linestyle=(0, (3, 2)),
                   linewidth=2.2, alpha=0.6)  # fmt: skip
    for axes, joint in zip(panels[4:], get_args(Joint), strict=True):
        table = hinge_table(crank, curve, joint=joint, speed_rpm=speed)
        axes.plot(360 * table.hinge_angle_rev, table.moment_nm, color=color, gid=f"{joint}-{number}")


def _torque(axes: Axes, curve: CrankTorque) -> None:
    axes.plot(360 * _ANGLES, crank_torque(_ANGLES, curve), color=INK, gid="torque")
    axes.plot(360 * _ANGLES, potential_torque(_ANGLES, curve), color=LINES[0], linewidth=0.9, gid="torque-potential")
    axes.axhline(curve.mean_nm, color=LINES[1], linewidth=0.9)
    mean = f"mean {number_text(curve.mean_nm)} N·m"
    axes.text(356, curve.mean_nm, mean, fontsize=SMALL, color=LINES[1], ha="right", va="bottom")
    angles, torques = torque_extrema(curve)
    axes.plot(360 * angles, torques, linestyle="", marker="o", markersize=3, color=INK)
    for angle, torque in zip(angles, torques, strict=True):
        shift = 5 if torque > curve.mean_nm else -9
        axes.annotate(number_text(float(torque)), (360 * angle, torque), xytext=(0, shift), textcoords="offset points",
                      ha="center", va="bottom" if shift > 0 else "top", fontsize=SMALL)  # fmt: skip
    axes.margins(y=0.18)


def guide_figure(
    engine: HingedEngine, mechanism: HingedCrankData, speed_rpm: float, *, settings: ReportSettings
) -> Figure:
    """Guides of the hinges of a mechanism that has them, to scale, with spring and rollers (document 003, figure 7).

    ``engine``: whose torque drives it. ``mechanism``: one of the engine's, with guides. ``speed_rpm``: crank speed that
    they are for, > 0. ``settings``: of the report.
    """
    stated = zip(get_args(Joint), (mechanism.pin_guides, mechanism.strut_guides), strict=True)
    given = [(joint, data) for joint, data in stated if data is not None]
    with house_style():
        step = (settings.width_in - 0.6) / 2
        side = step - 0.5
        figure = new_figure(settings.width_in, side + 1.75)
        for number, (joint, data) in enumerate(given):
            table = hinge_table(mechanism.crank, engine.curve, joint=joint, speed_rpm=speed_rpm, n_steps=GUIDE_STEPS)
            guides = hinge_guides(table, data)
            left = 0.3 + number * step
            _draw_guides(axes_at(figure, left, 0.2, side, side), guides, data)
            place = "at the crank pin" if joint == "pin" else "between strut and crank"
            write(figure, left + side / 2, side + 0.62, f"Hinge {place}", ha="center", fontsize=NORMAL,
                  fontweight="bold")  # fmt: skip
            cut = "sharper than the roller: it cannot be cut" if guides.undercut else "the roller reaches every point"
            text = f"spring {number_text(1e-3 * guides.stiffness_n_per_m)} N/mm, steepest {guides.steepest_deg:.0f}°; "
            write(figure, left + side / 2, side + 0.42, text + cut, ha="center", fontsize=SMALL + 0.5)
        name = drawable(mechanism.name, settings.max_name_characters)
        subtitle = f"For {speed_rpm:.0f} rpm. Shaded: the guides, to scale; "
        subtitle += "the spring between them is shown at four angles."
        title_lines(figure, 0.3, f"{name} · guides of the elastic hinges", subtitle)
        return figure


def _draw_guides(axes: Axes, guides: Guides, data: GuideData) -> None:
    """Both guides shaded, the rollers' paths faint, and the spring at four angles."""
    limit = 1.14 * float(np.abs(guides.outer_m).max())
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
    axes.set_axis_off()
    turn = np.exp(2j * np.pi * guides.hinge_angle_rev)
    for outline in (np.concatenate([limit / 1.01 * turn, guides.outer_m[::-1]]), guides.inner_m):
        axes.fill(outline.real, outline.imag, color=GRID, linewidth=0)
    for surface in (guides.outer_m, guides.inner_m):
        axes.plot(surface.real, surface.imag, color=INK, gid="guide")
    paths = [(data.middle_radius_m + sign * guides.length_m / 2) * turn for sign in (1, -1)]
    for path in paths:
        axes.plot(path.real, path.imag, color=FAINT, linewidth=0.7, linestyle=(0, (4, 3)))
    quarter = len(turn) // 4
    for row in (number * quarter + quarter // 3 for number in range(4)):
        ends = [path[row] for path in paths]
        _spring(axes, *ends)
        for end in ends:
            roller = Circle((end.real, end.imag), data.roller_radius_m, facecolor="white", edgecolor=LINES[1], zorder=4)
            axes.add_patch(roller)
    axes.plot(0, 0, marker="+", color=INK, markersize=8)
    for angle_deg in range(0, 360, 30):
        at = 0.93 * limit * np.exp(1j * np.radians(angle_deg))
        axes.text(at.real, at.imag, f"{angle_deg}°", ha="center", va="center", fontsize=SMALL, color=FAINT)


def _spring(axes: Axes, outer: complex, inner: complex) -> None:
    """Zigzag line of a spring from ``inner`` to ``outer``."""
    share = np.linspace(0, 1, 25)
    across = 1j * (outer - inner) / abs(outer - inner) * 0.011
    sway = np.where((share > 0.1) & (share < 0.9), np.where(np.arange(25) % 2, 1, -1), 0)
    line = inner + share * (outer - inner) + sway * across
    axes.plot(line.real, line.imag, color=LINES[1], linewidth=1.0, zorder=3)
