"""Pictures of an engine's balance: the force as it turns, against crank angle, and order by order."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crankorder.engine.balance_data import speed_key
from crankorder.engine.balancing import unbalance_force_n
from crankorder.plot.palette import FAINT, INK, LINES, SMALL, drawable
from crankorder.plot.style import NOTE, axes_at, house_style, new_figure, quiet_frame, title_lines
from crankorder.report.balance.dataset import SYSTEMS, order_sum
from crankorder.report.balance.look import (
    COUNTERWEIGHTS,
    MOMENT_TEXT,
    NO_FORCE,
    SHAFT_SETS,
    Box,
    alike,
    axis_names,
    called,
    color_key,
    head_of,
    system_color,
)
from crankorder.report.notation import number_text
from crankorder.settings import ReportSettings

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.95, 0.35, 0.85, 0.62  # inches
_GAP_X, _GAP_Y = 0.95, 0.62


def force_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Figure:
    """Force along and across the cylinder against crank angle at the highest speed, before and after each balance.

    ``balance`` as :func:`crankorder.report.balance.dataset.balance_dataset` makes it; ``title`` of the engine;
    ``settings`` of the report.
    """
    with house_style():
        figure = new_figure(settings.width_in, settings.height_in)
        speed = float(balance["speed"].values.max())
        rows = [("Counterweights", COUNTERWEIGHTS), ("Shafts", SHAFT_SETS)]
        names = [str(name) for name in balance["system"].values]
        present = [(text, [name for name in kinds if name in names]) for text, kinds in rows]
        used = [(text, kinds) for text, kinds in present if len(kinds) > 1] or [("Force", ["none"])]
        boxes = _grid(settings, len(used) + ("moment" in balance))
        newtons = balance["curve"] * float(unbalance_force_n(1.0, speed))
        for (text, kinds), row in zip(used, boxes, strict=False):
            _force_row(figure, row, newtons.sel(system=kinds), text, balance)
        if "moment" in balance:
            _moment_row(figure, boxes[-1], balance, speed)
        said = f"Force on the crankcase at {speed_key(speed)} rpm: {_in_words(balance, speed)}"
        title_lines(figure, _LEFT, f"{drawable(title, settings.max_name_characters)} · force against crank angle", said)
        return figure


def _force_row(figure: Figure, row: list[Box], curves: xr.DataArray, text: str, balance: xr.Dataset) -> None:
    """Two panels, along and across, with one scale; what draws the same line is named once."""
    groups = alike(curves)
    limit = 1.08 * float(np.abs(curves.values).max()) or 1.0
    angle = 360 * curves["crank_angle"].values
    for axis, name, box in zip("xy", axis_names(balance), row, strict=True):
        axes = _angle_axes(figure, box, limit, f"{text} · {name}", "N")
        zero = []
        for number, members in enumerate(groups):
            values = curves.sel(system=members[0], axis=axis).values
            if np.abs(values).max() <= NO_FORCE * limit:
                zero += members
                continue
            width = 2.2 if members[0] == "none" else 1.4
            axes.plot(angle, values, color=system_color(members[0]), linewidth=width, gid=f"force-{axis}-{members[0]}",
                      zorder=2 + number)  # fmt: skip
        if zero:
            look = {**NOTE, "ha": "right", "va": "bottom", "fontsize": SMALL}
            said = f"nothing: {called(zero, balance)}" if len(groups) > 1 else "nothing"
            axes.text(0.99, 0.03, said, transform=axes.transAxes, **look)
    if curves.sizes["system"] > 1:
        color_key(figure, row[0], [(called(members, balance), system_color(members[0])) for members in groups])


def _angle_axes(figure: Figure, box: Box, limit: float, title: str, unit: str) -> Axes:
    axes = axes_at(figure, *box)
    quiet_frame(axes)
    label = "crank angle from top dead centre, °"
    axes.set(xlim=(0, 360), ylim=(-limit, limit), xticks=range(0, 361, 90), xlabel=label, ylabel=unit)
    axes.set_title(title, fontsize=9, color=INK, pad=16)
    axes.axhline(0, color=FAINT, linewidth=0.8)
    return axes


def _moment_row(figure: Figure, row: list[Box], balance: xr.Dataset, speed: float) -> None:
    """Moments of several cylinders against crank angle: those that rock it left, that about the crankshaft right."""
    per_omega = 1e-3 * float(unbalance_force_n(1.0, speed))
    values = per_omega * order_sum(balance["moment"].values, balance["crank_angle"].values)
    limit = 1.08 * float(np.abs(values).max()) or 1.0
    angle = 360 * balance["crank_angle"].values
    heads = ("Rocking moments of the inertia forces", "Roll moment of the masses on the engine block")
    for head, box, members in zip(heads, row, ((0, 1), (2,)), strict=True):
        axes = _angle_axes(figure, box, limit, head, "N·m")
        entries = []
        for number in members:
            name = str(balance["moment_axis"].values[number])
            if np.abs(values[number]).max() <= NO_FORCE * limit:
                entries.append((f"nothing {MOMENT_TEXT[name]}", FAINT))
                continue
            axes.plot(angle, values[number], color=LINES[number], gid=f"moment-{name}")
            entries.append((MOMENT_TEXT[name], LINES[number]))
        color_key(figure, box, entries)


def _in_words(balance: xr.Dataset, speed: float) -> str:
    """The largest force without balancing and the smallest that counterweights and shafts leave."""
    most = np.abs(balance["curve"].sel(axis="x").values + 1j * balance["curve"].sel(axis="y").values).max(axis=1)
    newtons = unbalance_force_n(most, speed)
    names = [str(name) for name in balance["system"].values]
    if not newtons[0]:
        return "none"
    plain = "without balancing" if head_of("none", balance) == SYSTEMS["none"] else head_of("none", balance)
    said = f"up to {number_text(float(newtons[0]))} N" + (f" {plain}" if len(names) > 1 else "")
    for kinds in (COUNTERWEIGHTS[1:4], SHAFT_SETS[1:]):
        left = {name: float(newtons[names.index(name)]) for name in kinds if name in names}
        if left:
            best = min(left, key=lambda name: left[name])
            said += f", {number_text(left[best])} N with {SYSTEMS[best]}"
    return said


def _grid(settings: ReportSettings, rows: int) -> list[list[Box]]:
    """Boxes (left, bottom, width, height in inches) of ``rows`` rows of two panels, from the top."""
    width = (settings.width_in - _LEFT - _RIGHT - _GAP_X) / 2
    height = (settings.height_in - _TOP - _BOTTOM - (rows - 1) * (_GAP_Y + 0.35) - 0.35) / rows
    bottoms = [_BOTTOM + (rows - 1 - row) * (height + _GAP_Y + 0.35) for row in range(rows)]
    return [[(_LEFT + column * (width + _GAP_X), bottom, width, height) for column in (0, 1)] for bottom in bottoms]
