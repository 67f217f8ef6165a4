"""Polar diagrams of the force that an engine's balance leaves: how large, where to, and which way round."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from crankorder.engine.balance_data import speed_key
from crankorder.engine.balancing import unbalance_force_n
from crankorder.report.balance.dataset import SYSTEMS, order_sum
from crankorder.report.balance.look import COUNTERWEIGHTS, MEANING, NO_FORCE, SHAFT_SETS, axis_names, system_color
from crankorder.report.notation import number_text
from crankorder.report.style import (
    FAINT,
    GRID,
    LINES,
    NORMAL,
    SMALL,
    axes_at,
    drawable,
    house_style,
    new_figure,
    title_lines,
    write,
)
from crankorder.settings import ReportSettings

Curve = NDArray[np.complex128]

TURNS = {
    "with crank": "turns with the crank",
    "against crank": "turns against the crank",
    "line": "swings to and fro",
    "none": "",
}
"""How a force moves, under its diagram."""

_LEFT, _RIGHT, _TOP, _BOTTOM, _HEAD = 0.55, 0.25, 0.7, 0.3, 0.84  # inches
_WIDEST = 4.4
_HEADED = "-|>,head_width=0.28,head_length=0.55"


def polar_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Figure:
    """Curve that the force draws during a revolution at the highest speed, for each way of balancing, to one scale.

    Up is along the cylinder, right is across it, to the side that the crank turns to; the crank turns clockwise.
    ``balance`` as :func:`crankorder.report.balance.dataset.balance_dataset` makes it; ``title`` of the engine;
    ``settings`` of the report.
    """
    with house_style():
        speed = float(balance["speed"].values.max())
        panels = _panels(balance, speed)
        columns = max(len(row) for row in panels)
        step = (settings.width_in - _LEFT - _RIGHT) / columns
        side = min(step - 0.16, _WIDEST)
        figure = new_figure(settings.width_in, _TOP + _BOTTOM + len(panels) * (side + _HEAD))
        limit = 1.15 * max(
            float(np.abs(curve).max()) for row in panels for _, _, curve, _, _, unit in row if unit == "N"
        )
        for number, row in enumerate(panels):
            bottom = _BOTTOM + (len(panels) - 1 - number) * (side + _HEAD)
            for place, (head, meaning, curve, color, turns, unit) in enumerate(row):
                left = _LEFT + place * step
                axes = axes_at(figure, left + (step - side) / 2, bottom, side, side)
                scale = limit if unit == "N" else 1.15 * float(np.abs(curve).max())
                _draw(axes, curve, color, scale or 1.0)
                for height, text, look in (
                    (0.5, head, {"fontweight": "bold", "fontsize": NORMAL}),
                    (0.35, meaning, {"fontsize": SMALL + 0.5}),
                    (0.21, _largest(curve, unit, limit), {"fontsize": SMALL + 0.5}),
                    (0.07, turns, {"fontsize": SMALL + 0.5, "color": FAINT}),
                ):
                    write(figure, left + step / 2, bottom + side + height, text, ha="center", **look)
                if number == place == 0:
                    _crank_sense(axes, side)
        up, right = axis_names(balance)
        said = f"Up {up}, right {right}; dots mark top dead centre. {speed_key(speed)} rpm; "
        said += f"the frame is ±{number_text(limit)} N."
        title_lines(figure, _LEFT, f"{drawable(title, settings.max_name_characters)} · polar diagrams", said)
        return figure


Panel = tuple[str, str, Curve, str, str, str]


def _panels(balance: xr.Dataset, speed: float) -> list[list[Panel]]:
    """Rows of (head, what it means, curve, colour, how it turns, unit): counterweights, shafts; or force and moment."""
    per_omega = float(unbalance_force_n(1.0, speed))
    curves = per_omega * (balance["curve"].sel(axis="x").values + 1j * balance["curve"].sel(axis="y").values)
    names = [str(name) for name in balance["system"].values]

    def panel(name: str) -> Panel:
        at = names.index(name)
        turns = TURNS[str(balance["rotation"].values[at])]
        head, meaning = (SYSTEMS[name], MEANING[name]) if len(names) > 1 else ("force", "")
        return (head, meaning, curves[at], system_color(name), turns, "N")

    rows = [[panel(name) for name in kinds if name in names] for kinds in (COUNTERWEIGHTS, SHAFT_SETS[1:])]
    if "moment" in balance:
        about = 1e-3 * per_omega * order_sum(balance["moment"].values, balance["crank_angle"].values)
        moment = about[0] + 1j * about[1]
        most = float(np.abs(moment).max())
        text = f"its axis; the frame is ±{number_text(1.15 * most)} N·m" if most else ""
        rows[0].append(("rocking moment", "", moment, LINES[1], text, "N·m"))
    return [row for row in rows if row]


def _largest(curve: Curve, unit: str, limit: float) -> str:
    most = float(np.abs(curve).max())
    if most <= NO_FORCE * limit:
        return "no force" if unit == "N" else "no moment"
    return f"up to {number_text(most)} {unit}"


def _draw(axes: Axes, curve: Curve, color: str, limit: float) -> None:
    """One diagram: cross hairs, curve, dot at top dead centre, arrows in the sense of rotation."""
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-limit, limit)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(GRID)
    axes.axhline(0, color=GRID, linewidth=0.8)
    axes.axvline(0, color=GRID, linewidth=0.8)
    axes.plot(curve.imag, curve.real, color=color, gid="polar")
    axes.plot(curve.imag[:1], curve.real[:1], color=color, marker="o", markersize=4.5, gid="top-dead-centre")
    steps = len(curve) - 1
    if not _encloses(curve) or np.abs(curve).max() < 0.06 * limit:
        return
    for start in (steps // 8, 5 * steps // 8):
        ahead = start + max(1, steps // 72)
        arrow = axes.annotate(
            "",
            xy=(curve.imag[ahead], curve.real[ahead]),
            xytext=(curve.imag[start], curve.real[start]),
            arrowprops={"arrowstyle": _HEADED, "color": color, "shrinkA": 0, "shrinkB": 0},
        )
        arrow.set_gid("sense")


def _crank_sense(axes: Axes, side: float) -> None:
    """A small arrow in the corner of ``axes``, ``side`` inches wide: the way that the crank turns, to compare with."""
    look = {"arrowstyle": "-|>,head_width=0.22,head_length=0.4", "connectionstyle": "arc3,rad=-0.9", "color": FAINT}
    first, last, height = 0.12 / side, 0.42 / side, 1 - 0.28 / side
    axes.annotate("", xy=(last, height), xytext=(first, height), xycoords="axes fraction", arrowprops=look)
    axes.text((first + last) / 2, height, "crank", transform=axes.transAxes, ha="center", va="top",
              fontsize=SMALL - 1, color=FAINT)  # fmt: skip


def _encloses(curve: Curve) -> bool:
    """Whether a curve has a sense of rotation: more area than a line drawn there and back."""
    area = 0.5 * abs(float(np.sum((curve[:-1].conj() * curve[1:]).imag)))
    return area > 0.12 * float(np.abs(curve).max()) ** 2
