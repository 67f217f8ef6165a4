"""Forces as they turn: polar diagrams of what a balance leaves, and primary and secondary force against crank angle."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crankorder.engine.balance_data import speed_key
from crankorder.engine.balancing import unbalance_force_n
from crankorder.plot.palette import FAINT, INK, LINES, NORMAL, SMALL, drawable
from crankorder.plot.style import NOTE, axes_at, house_style, new_figure, quiet_frame, title_lines, write
from crankorder.quantities import Complexes
from crankorder.report.balance.dataset import order_sum
from crankorder.report.balance.look import (
    COUNTERWEIGHTS,
    NO_FORCE,
    SHAFT_SETS,
    axis_names,
    color_key,
    cross_hairs,
    frame_around,
    head_of,
    meaning_of,
    system_color,
)
from crankorder.report.notation import number_text
from crankorder.settings import ReportSettings

TURNS = {
    "with crank": "turns with the crank",
    "against crank": "turns against the crank",
    "line": "swings to and fro",
    "none": "",
}
"""How a force moves, under its diagram."""

_LEFT, _RIGHT, _TOP, _BOTTOM, _HEAD = 0.75, 0.25, 0.7, 0.3, 0.84  # inches
_WIDEST = 4.4
_HEADED = "-|>,head_width=0.28,head_length=0.55"


def polar_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Figure:
    """Curve that the force draws during a revolution at the highest speed, for each way of balancing, to one scale.

    Counterweights come twice: by the first harmonic alone, whose curves are ellipses, and by all harmonics together.
    Up is along the cylinder, right is across it, to the side that the crank turns to; the crank turns clockwise.
    ``balance`` as :func:`crankorder.report.balance.dataset.balance_dataset` makes it; ``title`` of the engine;
    ``settings`` of the report.
    """
    with house_style():
        speed = float(balance["speed"].values.max())
        panels = _panels(balance, speed)
        columns = max(len(row) for _, row in panels)
        step = (settings.width_in - _LEFT - _RIGHT) / columns
        side = min(step - 0.16, _WIDEST)
        figure = new_figure(settings.width_in, _TOP + _BOTTOM + len(panels) * (side + _HEAD))
        forces = (curve for _, row in panels for _, _, curve, _, _, unit in row if unit == "N")
        limit = frame_around(max(float(np.abs(curve).max()) for curve in forces))
        for number, (of_row, row) in enumerate(panels):
            bottom = _BOTTOM + (len(panels) - 1 - number) * (side + _HEAD)
            write(figure, 0.42, bottom + side / 2, of_row, rotation=90, ha="center", va="center", fontsize=NORMAL,
                  fontweight="bold")  # fmt: skip
            for place, (head, meaning, curve, color, turns, unit) in enumerate(row):
                left = _LEFT + place * step
                axes = axes_at(figure, left + (step - side) / 2, bottom, side, side)
                scale = limit if unit == "N" else frame_around(float(np.abs(curve).max()))
                _draw(axes, curve, color, scale)
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


Panel = tuple[str, str, Complexes, str, str, str]


def _panels(balance: xr.Dataset, speed: float) -> list[tuple[str, list[Panel]]]:
    """Rows with what each is of: counterweights by the first and by all harmonics, shafts; or force and moment.

    A panel: head, what it means, curve, colour, how it turns, unit.
    """
    per_omega = float(unbalance_force_n(1.0, speed))
    curves = per_omega * (balance["curve"].sel(axis="x").values + 1j * balance["curve"].sel(axis="y").values)
    along, across = order_sum(balance["force"].sel(order=[1.0]).values, balance["crank_angle"].values).swapaxes(0, 1)
    first = per_omega * (along + 1j * across)
    names = [str(name) for name in balance["system"].values]

    def panel(name: str, drawn: Complexes) -> Panel:
        at = names.index(name)
        turns = TURNS[str(balance["rotation"].values[at])]
        head, meaning = (head_of(name, balance), meaning_of(name, balance)) if len(names) > 1 else ("force", "")
        return (head, meaning, drawn[at], system_color(name), turns, "N")

    kinds = [name for name in COUNTERWEIGHTS if name in names]
    rows = [("first harmonic alone", [panel(name, first) for name in kinds])] if first.any() else []
    rows.append(("all harmonics", [panel(name, curves) for name in kinds]))
    rows.append(("shafts, all harmonics", [panel(name, curves) for name in SHAFT_SETS[1:] if name in names]))
    if "moment" in balance:
        about = 1e-3 * per_omega * order_sum(balance["moment"].values, balance["crank_angle"].values)
        moment = about[0] + 1j * about[1]
        most = float(np.abs(moment).max())
        text = f"its axis; the frame is ±{number_text(frame_around(most))} N·m" if most else ""
        rows[-2][1].append(("rocking moment", "", moment, LINES[1], text, "N·m"))
    return [row for row in rows if row[1]]


def _largest(curve: Complexes, unit: str, limit: float) -> str:
    most = float(np.abs(curve).max())
    if most <= NO_FORCE * limit:
        return "no force" if unit == "N" else "no moment"
    return f"up to {number_text(most)} {unit}"


def _draw(axes: Axes, curve: Complexes, color: str, limit: float) -> None:
    """One diagram: cross hairs, curve, dot at top dead centre, arrows in the sense of rotation."""
    cross_hairs(axes, limit)
    axes.plot(curve.imag, curve.real, color=color, gid="polar")
    axes.plot(curve.imag[:1], curve.real[:1], color=color, marker="o", markersize=4.5, gid="top-dead-centre")
    steps = len(curve) - 1
    largest = float(np.abs(curve).max())
    area = 0.5 * abs(float(np.sum((curve[:-1].conj() * curve[1:]).imag)))
    encloses = area > 0.12 * largest**2  # more than a line drawn there and back, so that it has a sense of rotation
    if not encloses or largest < 0.06 * limit:
        return
    for start in (steps // 8, 5 * steps // 8):
        ahead = start + max(1, steps // 72)
        tail, head = ((curve.imag[place], curve.real[place]) for place in (start, ahead))
        look = {"arrowstyle": _HEADED, "color": color, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", xy=head, xytext=tail, arrowprops=look).set_gid("sense")


def _crank_sense(axes: Axes, side: float) -> None:
    """A small arrow in the corner of ``axes``, ``side`` inches wide: the way that the crank turns, to compare with."""
    look = {"arrowstyle": "-|>,head_width=0.22,head_length=0.4", "connectionstyle": "arc3,rad=-0.9", "color": FAINT}
    first, last, height = 0.12 / side, 0.42 / side, 1 - 0.28 / side
    axes.annotate("", xy=(last, height), xytext=(first, height), xycoords="axes fraction", arrowprops=look)
    axes.text((first + last) / 2, height, "crank", transform=axes.transAxes, ha="center", va="top",
              fontsize=SMALL - 1, color=FAINT)  # fmt: skip


_PARTS = {"primary": ((1.0,), LINES[0]), "secondary": ((2.0,), LINES[1]), "both": ((1.0, 2.0), INK)}
"""Orders of each curve and its colour."""


def harmonics_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Figure:
    """Primary force, secondary force and their sum against crank angle at the highest speed, without any balancing.

    Faint behind them all orders together. Positive away from the crankshaft: the piston pulls on its rod.
    ``balance`` as :func:`crankorder.report.balance.dataset.balance_dataset` makes it; ``title`` of the engine;
    ``settings`` of the report. Source: Ruckle 2014, figure 7 (after Foale 2007).
    """
    with house_style():
        speed = float(balance["speed"].values.max())
        per_omega = float(unbalance_force_n(1.0, speed))
        forces = balance["force"].sel(system="none")
        shown = [axis for axis in "xy" if np.abs(forces.sel(axis=axis).values).max() > 0] or ["x"]
        figure = new_figure(settings.width_in, settings.height_in * 0.72)
        width = (settings.width_in - 1.3 - (len(shown) - 1) * 0.95) / len(shown)
        height = settings.height_in * 0.72 - 1.85
        limit = 1.12 * per_omega * float(np.abs(balance["curve"].sel(system="none").values).max()) or 1.0
        for number, axis in enumerate(shown):
            box = (0.95 + number * (width + 0.95), 0.62, width, height)
            axes = axes_at(figure, *box)
            quiet_frame(axes)
            label = "crank angle from top dead centre, °"
            axes.set(xlim=(0, 360), xticks=range(0, 361, 45), xlabel=label, ylabel="N", ylim=(-limit, limit))
            axes.axhline(0, color=FAINT, linewidth=0.8)
            axes.set_title(axis_names(balance)["xy".index(axis)], fontsize=9, color=INK, pad=18)
            if not forces.any():
                axes.text(0.5, 0.5, "no force of any order", transform=axes.transAxes, **NOTE)
                continue
            _harmonics(axes, balance, axis, per_omega)
            entries = [(name, color) for name, (_, color) in _PARTS.items()]
            color_key(figure, box, [*entries, ("all orders", FAINT)])
        state = f"{speed_key(speed)} rpm, {head_of('none', balance)}"
        said = f"Force of the moving masses at {state}; {_at_dead_centres(forces)}"
        title_lines(figure, 0.95, f"{drawable(title, settings.max_name_characters)} · primary and secondary", said)
        return figure


def _harmonics(axes: Axes, balance: xr.Dataset, axis: str, per_omega: float) -> None:
    angles = balance["crank_angle"].values
    every = per_omega * balance["curve"].sel(system="none", axis=axis).values
    axes.plot(360 * angles, every, color=FAINT, linewidth=5.5, alpha=0.4, zorder=1.8, gid=f"all-{axis}")
    amplitudes = balance["force"].sel(system="none", axis=axis)
    for name, (orders, color) in _PARTS.items():
        chosen = np.where(np.isin(balance["order"].values, orders), amplitudes.values, 0)
        axes.plot(360 * angles, per_omega * order_sum(chosen, angles), color=color, gid=f"{name}-{axis}",
                  linewidth=3.0 if name == "both" else 1.3, zorder=1.9 if name == "both" else 2)  # fmt: skip


def _at_dead_centres(forces: xr.DataArray) -> str:
    """How much the secondary force adds to the primary one along the cylinder, and takes off."""
    first, second = (complex(forces.sel(axis="x", order=order).values) for order in (1.0, 2.0))
    if not first or not second:
        return "no secondary force." if first else "no primary force."
    share = 100 * (second.real / first.real) if first.real else 0.0
    return f"the secondary one adds {share:.3g} % at top dead centre and takes as much off at the bottom."
