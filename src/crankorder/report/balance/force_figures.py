"""Pictures of an engine's forces: as they turn, against crank angle, and order by order, for each way of balancing."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crankorder.engine.forces import speed_key, unbalance_force_n
from crankorder.plot.drawing import Box
from crankorder.plot.painter import axes_at, house_style, log_axis, new_figure, note, quiet_frame, title_lines, write
from crankorder.plot.palette import FAINT, GRID, INK, LINES, NORMAL, SMALL, drawable, text_width_in
from crankorder.plot.reading import listed, number_text, order_text
from crankorder.quantities import Complexes, Floats
from crankorder.report.balance.dataset import PLAIN, SYSTEMS, order_sum
from crankorder.settings import ReportSettings

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.95, 0.35, 0.85, 0.62  # inches
_GAP_X, _GAP_Y = 0.95, 0.62

COUNTERWEIGHTS = ("none", "a", "b", "c", "d")
DESIGNS = ("webs", *(f"order {order}" for order in range(1, 13)))
"""Crank webs and shafts for several cylinders."""
SHAFT_SETS = ("none", "1", "2", "3", "4", "4+2", *DESIGNS, "own")
MEANING = {
    "none": "no counterweight, no shaft",
    "a": "order 1 along cancelled",
    "b": "order 1 across cancelled",
    "c": "equal along and across",
    "d": "counterweight on the rod too",
    "1": "pair at crank speed",
    "2": "pair at twice crank speed",
    "3": "both pairs",
    "4": "one, against the crank",
    "4+2": "one, and pair at twice speed",
    "webs": "weights on the crank",
    **{f"order {order}": "webs and shafts" for order in range(1, 13)},
    "own": "as the engine file has them",
}
"""What strategies of counterweights and possibilities of additional shafts are."""

MOMENT_TEXT = {"about_x": "about Z", "about_y": "about X", "about_crankshaft": "about Y, the crankshaft"}

NO_FORCE = 1e-9
"""A curve below this share of the largest is drawn as nothing."""

_KEY_SIZE = 8.0
_BOLD = 1.13  # text_width_in measures the regular weight


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
        line = f"Force on the crankcase at {speed_key(speed)} rpm: {_in_words(balance, speed)}"
        title_lines(figure, _LEFT, f"{drawable(title, settings.max_name_characters)} · force against crank angle", line)
        return figure


def _force_row(figure: Figure, row: list[Box], curves: xr.DataArray, text: str, balance: xr.Dataset) -> None:
    """Two panels of force against crank angle, along and across, with one scale; equal curves share a label."""
    groups, (along, _) = alike(curves), row
    limit = 1.08 * float(np.abs(curves.values).max()) or 1.0
    angle = 360 * curves["crank_angle"].values
    for axis, name, box in zip("xy", axis_names(balance), row, strict=True):
        axes = angle_axes(figure, box, f"{text} · {name}", "N", limit=limit)
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
            names = f"nothing: {called(zero, balance)}" if len(groups) > 1 else "nothing"
            note(axes, names, (0.99, 0.03), ha="right", va="bottom", fontsize=SMALL)
    if curves.sizes["system"] > 1:
        color_key(figure, along, [(called(members, balance), system_color(members[0])) for members in groups])


def _moment_row(figure: Figure, row: list[Box], balance: xr.Dataset, speed: float) -> None:
    """Moments of several cylinders against crank angle: rocking moments left, roll moment right."""
    per_omega = 1e-3 * float(unbalance_force_n(1.0, speed))
    values = per_omega * order_sum(balance["moment"].values, balance["crank_angle"].values)
    limit = 1.08 * float(np.abs(values).max()) or 1.0
    angle = 360 * balance["crank_angle"].values
    heads = ("Rocking moments of the inertia forces", "Roll moment of the masses on the engine block")
    for head, box, members in zip(heads, row, ((0, 1), (2,)), strict=True):
        axes = angle_axes(figure, box, head, "N·m", limit=limit)
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
    """Text with the peak force without balancing and the smallest residual with counterweights and with shafts."""
    most = np.abs(balance["curve"].sel(axis="x").values + 1j * balance["curve"].sel(axis="y").values).max(axis=1)
    newtons = unbalance_force_n(most, speed)
    names = [str(name) for name in balance["system"].values]
    if not newtons[0]:
        return "none"
    plain = "without balancing" if head_of("none", balance) == SYSTEMS["none"] else head_of("none", balance)
    line = f"up to {number_text(float(newtons[0]))} N" + (f" {plain}" if len(names) > 1 else "")
    for kinds in (COUNTERWEIGHTS[1:4], SHAFT_SETS[1:]):
        left = {name: float(newtons[names.index(name)]) for name in kinds if name in names}
        if left:
            best = min(left, key=lambda name: left[name])
            line += f", {number_text(left[best])} N with {SYSTEMS[best]}"
    return line


def _grid(settings: ReportSettings, rows: int) -> list[list[Box]]:
    """Boxes (left, bottom, width, height in inches) of ``rows`` rows of two panels, from the top."""
    width = (settings.width_in - _LEFT - _RIGHT - _GAP_X) / 2
    height = (settings.height_in - _TOP - _BOTTOM - (rows - 1) * (_GAP_Y + 0.35) - 0.35) / rows
    bottoms = [_BOTTOM + (rows - 1 - row) * (height + _GAP_Y + 0.35) for row in range(rows)]
    return [[(_LEFT + column * (width + _GAP_X), bottom, width, height) for column in (0, 1)] for bottom in bottoms]


_BARS_LEFT, _BARS_RIGHT, _BARS_TOP, _BARS_BOTTOM, _BARS_GAP = 0.95, 1.0, 1.25, 0.6, 0.62  # inches
_WIDEST_BAR = 0.22  # bar, in orders


Group = tuple[str, str, float, list[Floats], list[str]]


def order_bars_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Figure:
    """Amplitude of the force by order along and across the cylinder, and moments of several cylinders, as bars.

    Newtons (or N·m) at the highest speed at the left, the amount over squared crank speed at the right, both
    logarithmic. ``balance`` as :func:`crankorder.report.balance.dataset.balance_dataset` makes it; ``title`` of the
    engine; ``settings`` of the report.
    """
    with house_style():
        tall_in = settings.height_in * (1.35 if "moment_by_system" in balance else 1.0)
        figure = new_figure(settings.width_in, tall_in)
        speed = float(balance["speed"].values.max())
        per_omega = float(unbalance_force_n(1.0, speed))
        force = balance["force"]
        systems = [names for names in alike(force) if np.abs(force.sel(system=names[0]).values).max() > 0]
        tall = _tall_orders(balance, settings)
        last = max([4.0, *tall[: settings.max_labelled_orders]])
        rocking = alike(balance["moment_by_system"]) if "moment_by_system" in balance else []
        groups = _groups(balance.sel(order=slice(None, last)), systems, rocking, per_omega)
        orders = balance["order"].sel(order=slice(None, last)).values
        inner = tall_in - _BARS_TOP - _BARS_BOTTOM - (len(groups) - 1) * _BARS_GAP
        height, width = inner / len(groups), settings.width_in - _BARS_LEFT - _BARS_RIGHT
        for number, (name, unit, most, values, hues) in enumerate(groups):
            bottom = _BARS_BOTTOM + (len(groups) - 1 - number) * (height + _BARS_GAP)
            axes = axes_at(figure, _BARS_LEFT, bottom, width, height)
            kind, floor = "force" if unit == "N" else "moment", most * _share(settings)
            _bars(axes, orders, values, hues, kind=kind, most=most, floor=floor)
            axes.set_title(name, fontsize=9)
            axes.set(xlim=(0.4, last + 0.6), ylabel=unit)
            factor, right = (per_omega, "g·mm") if unit == "N" else (1e-3 * per_omega, "g·mm²")
            _second_scale(axes, factor, right)
            if number == 2:
                keyed = [(called(names, balance), system_color(names[0])) for names in rocking]
                color_key(figure, (_BARS_LEFT + 2.6, bottom, width - 2.6, height), keyed)
            if number == len(groups) - 1:
                axes.set_xlabel("order, cycles per crank revolution")
        entries = [(called(system, balance), system_color(system[0])) for system in systems]
        if len(entries) > 1:
            color_key(figure, (_BARS_LEFT, tall_in - _BARS_TOP + 0.2, width, 0.1), entries)
        line = f"Amplitude at {speed_key(speed)} rpm. "
        line += f"Bars below {100 * _share(settings):.1g} % of the largest are left out."
        line += f" So are orders above {last:g}." if tall and tall[-1] > last else ""
        idle = [str(name) for name in balance["system"].values if not any(name in names for names in systems)]
        line += f" No force: {called(idle, balance)}." if idle else ""
        title_lines(figure, _BARS_LEFT, f"{drawable(title, settings.max_name_characters)} · force by order", line)
        return figure


def _tall_orders(balance: xr.Dataset, settings: ReportSettings) -> list[float]:
    """Orders at which a force or a moment is large enough to be drawn, ascending."""
    high = np.zeros(balance.sizes["order"], dtype=bool)
    for name in ("force", "moment_by_system"):
        if name in balance:
            amplitude = np.abs(balance[name].transpose(..., "order").values).reshape(-1, len(high))
            high |= (amplitude > _share(settings) * amplitude.max()).any(axis=0)
    return [float(order) for order in balance["order"].values[high]]


def _groups(balance: xr.Dataset, systems: list[list[str]], moments: list[list[str]], per_omega: float) -> list[Group]:
    """Panels: name, unit, largest amplitude of the unit, amplitudes (order) of each bar beside another, colours."""
    shown = systems or [["none"]]
    forces = [np.abs(balance["force"].sel(system=names[0]).values) * per_omega for names in shown]
    colors = [system_color(names[0]) for names in shown]
    largest = max(float(force.max()) for force in forces)
    groups: list[Group] = [
        (name[0].upper() + name[1:], "N", largest, [force[row] for force in forces], colors)
        for row, name in enumerate(axis_names(balance))
    ]
    if "moment_by_system" in balance:
        amplitudes = [balance["moment_by_system"].sel(system=names[0]).values for names in moments]
        hues = [system_color(names[0]) for names in moments]
        about_z, about_x, roll = 1e-3 * per_omega * np.stack(amplitudes, axis=1)
        # the couple along Z and X as what turns with the crank and against it: the largest of the turn is their sum
        rocking = (np.abs(about_x + 1j * about_z) + np.abs(about_x - 1j * about_z)) / 2
        most = float(max(rocking.max(), np.abs(roll).max()))
        groups.append(("Rocking couple, the most of a turn", "N·m", most, list(rocking), hues))
        groups.append(("Roll moment of the masses", "N·m", most, list(np.abs(roll)), hues))
    return groups


def _bars(
    axes: Axes, orders: Floats, values: list[Floats], colors: list[str], *, kind: str, most: float, floor: float
) -> None:
    """Bars of every order side by side, the largest with its value above; ``kind``: force or moment."""
    quiet_frame(axes)
    axes.grid(False, axis="x")
    high = np.max(values, axis=0)
    shown = [float(order) for order, value in zip(orders, high, strict=True) if value > floor > 0]
    axes.set_xticks(shown, [order_text(order) for order in shown])
    log_axis(axes, floor if most else 1e-3, 4 * most if most else 1.0, most_ticks=7)
    if not shown:
        note(axes, f"no {kind} of any order")
        return
    width = min(0.84 / len(values), _WIDEST_BAR)
    for number, (column, color) in enumerate(zip(values, colors, strict=True)):
        tall = column > floor
        places = orders[tall] + (number - (len(values) - 1) / 2) * width
        axes.bar(places, column[tall], 0.9 * width, color=color, gid=f"bars-{number}")
    for order, value, tallest in zip(orders, high, np.argmax(values, axis=0), strict=True):
        if value > floor:
            place = order + (tallest - (len(values) - 1) / 2) * width
            axes.text(place, value * 1.1, number_text(float(value)), ha="center", va="bottom", fontsize=SMALL)


def _second_scale(axes: Axes, per_omega: float, unit: str) -> None:
    """Second y axis at the right of ``axes``: the same scale divided by squared crank speed."""
    low, high = axes.get_ylim()
    right = axes.twinx()
    log_axis(right, low / per_omega, high / per_omega, most_ticks=7)
    right.spines[["top", "left", "bottom"]].set_visible(False)
    right.tick_params(length=3)
    right.set_ylabel(f"over ω², {unit}")


def _share(settings: ReportSettings) -> float:
    """Smallest amplitude drawn, as a share of the largest."""
    return float(10 ** (-settings.dynamic_range_db / 20))


TURNS = {
    "with crank": "turns with the crank",
    "against crank": "turns against the crank",
    "line": "swings to and fro",
    "none": "",
}
"""How a force moves, under its diagram."""

_POLAR_LEFT, _POLAR_RIGHT, _POLAR_TOP, _POLAR_BOTTOM, _POLAR_HEAD = 0.75, 0.25, 0.7, 0.3, 0.84  # inches
_WIDEST_POLAR = 4.4
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
        step = (settings.width_in - _POLAR_LEFT - _POLAR_RIGHT) / columns
        side = min(step - 0.16, _WIDEST_POLAR)
        figure = new_figure(settings.width_in, _POLAR_TOP + _POLAR_BOTTOM + len(panels) * (side + _POLAR_HEAD))
        forces = (curve for _, row in panels for _, _, curve, _, _, unit in row if unit == "N")
        limit = frame_around(max(float(np.abs(curve).max()) for curve in forces))
        for number, (of_row, row) in enumerate(panels):
            bottom = _POLAR_BOTTOM + (len(panels) - 1 - number) * (side + _POLAR_HEAD)
            write(figure, 0.42, bottom + side / 2, of_row, rotation=90, ha="center", va="center", fontsize=NORMAL,
                  fontweight="bold")  # fmt: skip
            for place, (head, meaning, curve, color, turns, unit) in enumerate(row):
                left = _POLAR_LEFT + place * step
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
        line = f"Up {up}, right {right}; dots mark top dead centre. {speed_key(speed)} rpm; "
        line += f"the frame is ±{number_text(limit)} N."
        title_lines(figure, _POLAR_LEFT, f"{drawable(title, settings.max_name_characters)} · polar diagrams", line)
        return figure


Panel = tuple[str, str, Complexes, str, str, str]


def _panels(balance: xr.Dataset, speed: float) -> list[tuple[str, list[Panel]]]:
    """Rows of panels with their titles: counterweights by first and by all harmonics, shafts; or force and moment.

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
    """Polar diagram of one force: curve, dot at top dead centre, arrows in the sense of rotation."""
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
    """Arrow in the corner of ``axes``, ``side`` inches wide, in the sense of rotation of the crank."""
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
            axes = angle_axes(figure, box, axis_names(balance)["xy".index(axis)], "N", limit=limit, step=45, pad=18)
            if not forces.any():
                note(axes, "no force of any order")
                continue
            _harmonics(axes, balance, axis, per_omega)
            entries = [(name, color) for name, (_, color) in _PARTS.items()]
            color_key(figure, box, [*entries, ("all orders", FAINT)])
        state = f"{speed_key(speed)} rpm, {head_of('none', balance)}"
        line = f"Force of the moving masses at {state}; {_at_dead_centres(forces)}"
        title_lines(figure, 0.95, f"{drawable(title, settings.max_name_characters)} · primary and secondary", line)
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
    """Sentence on the ratio of secondary to primary force at the dead centres, in per cent."""
    first, second = (complex(forces.sel(axis="x", order=order).values) for order in (1.0, 2.0))
    if not first or not second:
        return "no secondary force." if first else "no primary force."
    share = 100 * (second.real / first.real) if first.real else 0.0
    return f"the secondary one adds {share:.3g} % at top dead centre and takes as much off at the bottom."


def axis_names(balance: xr.Dataset) -> tuple[str, str]:
    """What the axes x and y of ``balance`` are called: one cylinder has its own directions, several have Z and X."""
    return ("along Z", "along X") if "moment" in balance else ("along the cylinder", "across the cylinder")


def system_color(name: str) -> str:
    """Colour of the system ``name`` in every picture; the plain engine is ink, and no two of one engine are alike."""
    if name in ("none", "own"):
        return INK if name == "none" else LINES[-1]
    family = DESIGNS if name in DESIGNS else [system for system in SYSTEMS if system not in ("none", "own", *DESIGNS)]
    return LINES[family.index(name) % (len(LINES) - 1)]


def frame_around(largest: float) -> float:
    """Half the side of a frame around a curve that reaches ``largest``: a round number above it, 1 where that is 0."""
    if largest == 0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(largest))
    return next(step * decade for step in (1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12) if step * decade > 1.05 * largest)


def cross_hairs(axes: Axes, limit: float) -> None:
    """Scale ±``limit`` and a horizontal and vertical zero line for the ``axes`` of a polar diagram, without ticks."""
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_color(GRID)
    axes.axhline(0, color=GRID, linewidth=0.8)
    axes.axvline(0, color=GRID, linewidth=0.8)


def angle_axes(
    figure: Figure, box: Box, title: str, unit: str, *, limit: float, step: int = 90, pad: float = 16
) -> Axes:
    """Axes over ``box`` of ``figure`` for values of ±``limit`` in a ``unit`` against the crank angle of one turn.

    ``title`` stands ``pad`` points above; a tick every ``step`` degrees.
    """
    axes = axes_at(figure, *box)
    quiet_frame(axes)
    label = "crank angle from top dead centre, °"
    axes.set(xlim=(0, 360), ylim=(-limit, limit), xticks=range(0, 361, step), xlabel=label, ylabel=unit)
    axes.set_title(title, fontsize=9, color=INK, pad=pad)
    axes.axhline(0, color=FAINT, linewidth=0.8)
    return axes


def alike(curves: xr.DataArray) -> list[list[str]]:
    """Names of the systems whose ``curves`` (system, …) are the same, together, in their order."""
    limit = NO_FORCE * float(np.abs(curves.values).max())
    groups: list[list[str]] = []
    for name in map(str, curves["system"].values):
        values = curves.sel(system=name).values
        same = [group for group in groups if np.abs(values - curves.sel(system=group[0]).values).max() <= limit]
        if same:
            same[0].append(name)
        else:
            groups.append([name])
    return groups


def head_of(name: str, balance: xr.Dataset) -> str:
    """Label of the balancing system ``name`` of ``balance``."""
    return str(balance.attrs[PLAIN]) if name == "none" else SYSTEMS[name]


def meaning_of(name: str, balance: xr.Dataset) -> str:
    """Short description of the balancing system ``name`` of ``balance``."""
    stated = name == "none" and balance.attrs[PLAIN] != SYSTEMS["none"]
    return "counterweights of its file, no shaft" if stated else MEANING[name]


def called(names: list[str], balance: xr.Dataset) -> str:
    """``names`` of systems of ``balance``, what they have in common said once: ``"shafts 1 and 4"``."""
    kinds: dict[str, list[str]] = {}
    for name in sorted(names, key=list(SYSTEMS).index):
        kind, _, mark = head_of(name, balance).rpartition(" ")
        kinds.setdefault(kind, []).append(mark)
    return ", ".join(f"{kind} {listed(marks)}" for kind, marks in kinds.items())


def color_key(figure: Figure, box: Box, entries: list[tuple[str, str]]) -> None:
    """Names in their colours in one line above a panel, from its left edge, smaller where the line is full.

    ``figure`` to draw on; ``box`` of the panel in inches (left, bottom, width, height); ``entries`` text and colour.
    """
    left, bottom, width, height = box
    widths = [text_width_in(text, _KEY_SIZE) * _BOLD + 0.16 for text, _ in entries]
    shrink = min(1.0, width / max(sum(widths), 1e-9))
    look = {"fontsize": _KEY_SIZE * shrink, "fontweight": "bold", "va": "bottom"}
    for (text, color), wide in zip(entries, widths, strict=True):
        write(figure, left, bottom + height + 0.06, text, color=color, **look)
        left += wide * shrink
