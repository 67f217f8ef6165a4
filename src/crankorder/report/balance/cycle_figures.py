"""Pictures of an engine's cycle: turning moment and its orders, and the loads of pins, walls and main bearings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crankorder.engine.balance_data import speed_key
from crankorder.engine.cycle_tables import OrderTorque, TurningMoment, cycle_curves
from crankorder.engine.definition import Engine
from crankorder.plot.palette import FAINT, INK, LINES, SMALL, drawable
from crankorder.plot.reading import number_text
from crankorder.plot.style import axes_at, house_style, new_figure, quiet_frame, title_lines, write
from crankorder.quantities import Floats
from crankorder.report.balance.look import Box, color_key, cross_hairs, frame_around
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


def torque_figure(
    cycle: xr.Dataset, turning: Mapping[str, TurningMoment], *, title: str, settings: ReportSettings
) -> Figure:
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
        if moment.power_w is not None:
            axes.axhline(moment.mean_n_m, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        _order_bars(axes_at(figure, _LEFT, _BOTTOM, width, height), moment.by_order, with_gas=with_gas)
        ends = f"{number_text(moment.least_n_m)} to {number_text(moment.peak_n_m)} N·m"
        mean = "" if moment.power_w is None else f"; mean {number_text(moment.mean_n_m)} N·m (dashed)"
        swing = moment.speed_fluctuation
        swings = "" if swing is None else f"; the speed swings by {number_text(100 * swing)} %"
        line = f"Torque on the crank at {speed_key(speed)} rpm, {ends}{mean}{swings}."
        title_lines(figure, _LEFT, f"{drawable(title, settings.max_name_characters)} · turning moment", line)
        return figure


def _order_bars(axes: Axes, by_order: Mapping[str, OrderTorque], *, with_gas: bool) -> None:
    quiet_frame(axes)
    axes.grid(False, axis="x")
    sizes = {order: torque.largest_n_m for order, torque in by_order.items()}
    largest = max(sizes.values(), default=0.0)
    orders = [order for order in by_order if sizes[order] > _SHOWN_SHARE * largest][:_MOST_ORDERS]
    places = np.arange(len(orders))
    kinds = [("gas_n_m", LINES[1]), ("inertia_n_m", LINES[0])] if with_gas else [("inertia_n_m", LINES[0])]
    for number, (key, color) in enumerate(kinds):
        values = [getattr(by_order[order], key) for order in orders]
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
        polar = _polar_loads(shown)
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


def _polar_loads(shown: xr.Dataset) -> list[_PolarLoad]:
    """Polar load curves [N]: first crank pin, then every main bearing."""
    pin = shown["crank_pin_load"].isel(cylinder=0).values
    loads = [_PolarLoad("crank pin of cylinder 0", pin[0], pin[1], "up: along the cylinder, right: across")]
    if "main_bearing_load" in shown:
        for place, (x, z) in zip(shown["bearing"].values, shown["main_bearing_load"].values, strict=True):
            at = f"{1e3 * float(place):.4g}".replace("-", "−")
            loads.append(_PolarLoad(f"main bearing at {at} mm", z, x, "up: Z, right: X"))
    return loads


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
