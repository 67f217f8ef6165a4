"""Pictures of an engine's cycle: turning moment and its orders, the loads of pins, walls and main bearings.

Of an engine with elastic hinges: its torque, side forces, what the hinges must give, and their guides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from crankorder.engine.cycle_tables import cycle_curves
from crankorder.engine.definition import Engine
from crankorder.engine.elastic_hinge import GUIDE_STEPS, Guides, Joint, hinge_guides, hinge_table
from crankorder.engine.forces import speed_key
from crankorder.engine.hinged_crank import (
    CrankTorque,
    GuideData,
    HingedCrankData,
    HingedEngine,
    crank_torque,
    hinge_moment,
    potential_torque,
    side_force,
    side_force_without_hinge,
    torque_extrema,
)
from crankorder.plot.drawing import Box
from crankorder.plot.painter import axes_at, house_style, new_figure, quiet_frame, title_lines, write
from crankorder.plot.palette import FAINT, GRID, INK, LINES, NORMAL, SMALL, drawable
from crankorder.plot.reading import number_text
from crankorder.quantities import Floats
from crankorder.report.balance.force_figures import color_key, cross_hairs, frame_around
from crankorder.settings import ReportSettings

_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP = 0.95, 0.35, 1.1, 0.62, 0.95  # inches
_CURVES = 2.6  # inches, height of the loads against crank angle
_MOST_COLUMNS = 3
_SUM = "together"
_SHOWN_SHARE = 1e-3
_LABELLED_SHARE = 0.01  # of the tallest bar: beside another bar a lower one has no room for its number
_FEWEST_ORDERS, _MOST_ORDERS = 6, 12  # that the axis has room for


def cycle_dataset(engine: Engine, speeds_rpm: Sequence[float]) -> xr.Dataset:
    """Torques of gas and masses, and loads, of ``engine`` over its cycle at each of ``speeds_rpm``.

    Dims speed, crank_angle (degrees), cylinder, bearing, and direction: "along" and "across" the cylinder for pins, "x"
    and "z" of the engine for main bearings.
    """
    by_speed = cycle_curves(engine, speeds_rpm)
    first, turn = by_speed[0], ("speed", "crank_angle")
    variables: dict[str, tuple[tuple[str, ...], Floats, dict[str, str]]] = {
        "gas_torque": (turn, np.stack([curves.gas_n_m for curves in by_speed]), {"units": "N m"}),
        "inertia_torque": (turn, np.stack([curves.inertia_n_m for curves in by_speed]), {"units": "N m"}),
    }
    coords: dict[str, tuple[str, object, dict[str, str]] | list[str]] = {
        "speed": ("speed", np.asarray(speeds_rpm, dtype=np.float64), {"units": "min-1"}),
        "crank_angle": ("crank_angle", 360 * first.crank_angle_rev, {"units": "degree"}),
    }
    if first.loads:
        by_cylinder = ("speed", "cylinder", "crank_angle")
        thrust = np.stack([[load.side_thrust_n for load in curves.loads] for curves in by_speed])
        variables["wall_load"] = (by_cylinder, thrust, {"units": "N", "long_name": "piston on its wall"})
        across = ("speed", "cylinder", "direction", "crank_angle")
        for name, pin in (("piston_pin_load", "piston_pin_n"), ("crank_pin_load", "crank_pin_n")):
            values = np.stack([[getattr(load, pin) for load in curves.loads] for curves in by_speed])
            variables[name] = (across, values, {"units": "N", "long_name": "rod on pin"})
        coords["direction"] = ["along", "across"]
    if first.bearings_n is not None:
        values = np.stack([curves.bearings_n[:, [0, 2]] for curves in by_speed if curves.bearings_n is not None])
        about = {"units": "N", "long_name": "crankshaft on main bearing"}
        variables["main_bearing_load"] = (("speed", "bearing", "axis", "crank_angle"), values, about)
        coords["axis"] = ["x", "z"]
        coords["bearing"] = ("bearing", np.asarray(engine.main_bearings_m), {"units": "m"})
    return xr.Dataset(variables, coords=coords)


def torque_figure(cycle: xr.Dataset, turning: Mapping[str, Any], *, title: str, settings: ReportSettings) -> Figure:
    """Turning moment of gas and masses against crank angle at the highest speed, and both by order beside one another.

    ``cycle`` as :func:`cycle_dataset` makes it; ``turning`` by speed, of the balance sheet; ``title`` of the engine;
    ``settings`` of the report.
    """
    with house_style():
        figure = new_figure(settings.width_in, settings.height_in)
        speed = float(cycle["speed"].values.max())
        moment = turning[speed_key(speed)]
        height = (settings.height_in - _TOP - _BOTTOM - _GAP) / 2
        width = settings.width_in - _LEFT - _RIGHT
        shown = cycle.sel(speed=speed)
        gas, masses = shown["gas_torque"].values, shown["inertia_torque"].values
        curves = [("masses", LINES[0], masses)]
        if with_gas := bool(np.any(gas)):
            curves = [("gas", LINES[1], gas), *curves, (_SUM, INK, gas + masses)]
        box = (_LEFT, _BOTTOM + height + _GAP, width, height)
        axes = _cycle_curves(figure, box, shown, curves, "N·m", width=1.3)
        if moment["power_w"] is not None:
            axes.axhline(moment["mean_n_m"], color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        _order_bars(axes_at(figure, _LEFT, _BOTTOM, width, height), moment["by_order"], with_gas=with_gas)
        ends = f"{number_text(moment['least_n_m'])} to {number_text(moment['peak_n_m'])} N·m"
        mean = "" if moment["power_w"] is None else f"; mean {number_text(moment['mean_n_m'])} N·m (dashed)"
        swing = moment["speed_fluctuation"]
        swings = "" if swing is None else f"; the speed swings by {number_text(100 * swing)} %"
        line = f"Torque on the crank at {speed_key(speed)} rpm, {ends}{mean}{swings}."
        title_lines(figure, _LEFT, f"{drawable(title, settings.max_name_characters)} · turning moment", line)
        return figure


def _order_bars(axes: Axes, by_order: Mapping[str, Any], *, with_gas: bool) -> None:
    quiet_frame(axes)
    axes.grid(False, axis="x")
    sizes = {order: max(torque["gas_n_m"], torque["inertia_n_m"]) for order, torque in by_order.items()}
    largest = max(sizes.values(), default=0.0)
    orders = [order for order in by_order if sizes[order] > _SHOWN_SHARE * largest][:_MOST_ORDERS]
    places = np.arange(len(orders))
    kinds = [("gas_n_m", LINES[1]), ("inertia_n_m", LINES[0])] if with_gas else [("inertia_n_m", LINES[0])]
    for number, (key, color) in enumerate(kinds):
        values = [by_order[order][key] for order in orders]
        beside = places + (number - (len(kinds) - 1) / 2) * 0.36
        axes.bar(beside, values, 0.33, color=color, gid=f"bars-{key}")
        for place, value in zip(beside, values, strict=True):
            if value > (_LABELLED_SHARE if with_gas else _SHOWN_SHARE) * largest:
                axes.text(place, value, number_text(value), ha="center", va="bottom", fontsize=SMALL)
    axes.set(ylim=(0, 1.15 * largest or 1.0), xlim=(-0.6, max(len(orders), _FEWEST_ORDERS) - 0.4))
    axes.set_xticks(places, orders)
    axes.set(xlabel="order, cycles per crank revolution", ylabel="N·m, amplitude")


def loads_figure(cycle: xr.Dataset, *, title: str, settings: ReportSettings) -> Figure:
    """Loads at the highest speed: the first cylinder's against crank angle, and every main bearing's as polar diagrams.

    ``cycle`` as :func:`cycle_dataset` makes it, with loads; ``title`` of the engine; ``settings`` of the report.
    """
    with house_style():
        speed = float(cycle["speed"].values.max())
        shown = cycle.sel(speed=speed)
        # polar load curves [N]: first crank pin, then every main bearing
        pin = shown["crank_pin_load"].isel(cylinder=0).values
        polar = [_PolarLoad("crank pin of cylinder 0", pin[0], pin[1], "up: along the cylinder, right: across")]
        if "main_bearing_load" in shown:
            for place, (x, z) in zip(shown["bearing"].values, shown["main_bearing_load"].values, strict=True):
                at = f"{1e3 * float(place):.4g}".replace("-", "−")
                polar.append(_PolarLoad(f"main bearing at {at} mm", z, x, "up: Z, right: X"))
        columns = min(_MOST_COLUMNS, len(polar))
        width = settings.width_in - _LEFT - _RIGHT
        step = width / columns
        side = min(step - 0.3, 3.2)
        row, rows = side + 0.75, -(-len(polar) // columns)
        figure = new_figure(settings.width_in, _TOP + _CURVES + _GAP + rows * row + 0.2)
        base = float(figure.get_size_inches()[1]) - _TOP - _CURVES
        first = shown.isel(cylinder=0)
        pins = [
            ("crank pin", np.hypot(*first["crank_pin_load"].values)),
            ("piston pin", np.hypot(*first["piston_pin_load"].values)),
            ("wall, in the crank's way", first["wall_load"].values),
        ]
        if np.allclose(pins[0][1], pins[1][1], rtol=1e-6):  # the file gives the rod no mass of its own
            pins = [("crank pin and piston pin alike", pins[0][1]), pins[2]]
        curves = [(name, color, values) for (name, values), color in zip(pins, LINES, strict=False)]
        _cycle_curves(figure, (_LEFT, base, width, _CURVES), shown, curves, "N, cylinder 0", width=1.4)
        bearings = frame_around(max((load.peak_n for load in polar[1:]), default=0.0))
        frames = [frame_around(polar[0].peak_n)] + [bearings] * (len(polar) - 1)
        for number, (load, frame) in enumerate(zip(polar, frames, strict=True)):
            corner = (_LEFT + number % columns * step, base - _GAP - (number // columns + 1) * row + 0.45)
            _polar(figure, (*corner, side, side), load, frame, LINES[number % len(LINES)])
        line = f"At {speed_key(speed)} rpm; dots mark crank angle 0; frames are ±{number_text(frames[0])} N for the pin"
        line += "." if len(frames) == 1 else f", ±{number_text(bearings)} N for the main bearings."
        title_lines(figure, _LEFT, f"{drawable(title, settings.max_name_characters)} · loads", line)
        return figure


@dataclass(frozen=True)
class _PolarLoad:
    """One closed curve of a load over the cycle, N: its part ``up`` and to the ``right``, and how those are called."""

    name: str
    up: Floats
    right: Floats
    ways: str

    @property
    def peak_n(self) -> float:
        return float(np.hypot(self.up, self.right).max())


def _polar(figure: Figure, box: Box, load: _PolarLoad, frame: float, color: str) -> None:
    axes = axes_at(figure, *box)
    cross_hairs(axes, frame)
    axes.plot([*load.right, load.right[0]], [*load.up, load.up[0]], color=color, linewidth=1.4)
    axes.plot(load.right[0], load.up[0], "o", color=color, markersize=4)
    left, bottom, side, _ = box
    middle, top = left + side / 2, bottom + side
    write(figure, middle, top + 0.2, load.name, ha="center", fontsize=SMALL + 0.5, fontweight="bold")
    text = f"up to {number_text(load.peak_n)} N; {load.ways}"
    write(figure, middle, top + 0.06, text, ha="center", fontsize=SMALL, color=FAINT)


def _cycle_curves(
    figure: Figure, box: Box, shown: xr.Dataset, curves: list[tuple[str, str, Floats]], unit: str, *, width: float
) -> Axes:
    """Axes over ``box`` with ``curves`` (name, colour, values) in a ``unit`` against the crank angle of a cycle."""
    axes = axes_at(figure, *box)
    quiet_frame(axes)
    for name, color, values in curves:
        # a sum lies below the others: where it is alike with one of them both are seen
        line_width, above = (3.0, 1.9) if name == _SUM else (width, 2.0)
        axes.plot(shown["crank_angle"].values, values, color=color, linewidth=line_width, zorder=above)
    axes.axhline(0, color=FAINT, linewidth=0.8)
    last = 360 * round(shown.sizes["crank_angle"] / 720)
    axes.set(xlim=(0, last), xticks=range(0, last + 1, 90), xlabel="crank angle, °", ylabel=unit)
    color_key(figure, box, [(name, color) for name, color, _ in curves])
    return axes


_GAP_Y = 0.97  # inches, between the rows of panels of a hinge
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
        width = (settings.width_in - _LEFT - _RIGHT - _GAP) / 2
        height = (full - _TOP - _BOTTOM - (_ROWS - 1) * _GAP_Y) / _ROWS
        boxes = [
            (
                _LEFT + column * (width + _GAP),
                _BOTTOM + row * (height + _GAP_Y),
                width,
                height,
            )
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
    _, without_hinge, _, at_pin, *hinges = panels
    force = side_force_without_hinge(_ANGLES, crank, curve, speed_rpm=speed)
    without_hinge.plot(360 * _ANGLES, force, color=color, gid=f"side-force-{number}")
    moment = hinge_moment(_ANGLES, crank, curve, speed_rpm=speed, pin_hinge="full")
    at_pin.plot(360 * _ANGLES, moment, color=color, gid=f"m12-full-{number}")
    moment = hinge_moment(_ANGLES, crank, curve, speed_rpm=speed, pin_hinge="printed")
    at_pin.plot(360 * _ANGLES, moment, color=color, gid=f"m12-printed-{number}", linestyle=(0, (3, 2)),
                   linewidth=2.2, alpha=0.6)  # fmt: skip
    for axes, joint in zip(hinges, get_args(Joint), strict=True):
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
