"""Bars of an engine's forces order by order, before and after each way of balancing."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crankorder.engine.balance_data import speed_key
from crankorder.engine.balancing import unbalance_force_n
from crankorder.plot.axes import log_axis
from crankorder.plot.palette import SMALL, drawable
from crankorder.plot.style import NOTE, axes_at, house_style, new_figure, quiet_frame, title_lines
from crankorder.quantities import Floats
from crankorder.report.balance.look import alike, axis_names, called, color_key, system_color
from crankorder.report.notation import number_text, order_text
from crankorder.settings import ReportSettings

_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP = 0.95, 1.0, 1.25, 0.6, 0.62  # inches
_WIDEST = 0.22  # bar, in orders


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
        inner = tall_in - _TOP - _BOTTOM - (len(groups) - 1) * _GAP
        height, width = inner / len(groups), settings.width_in - _LEFT - _RIGHT
        for number, (name, unit, most, values, hues) in enumerate(groups):
            bottom = _BOTTOM + (len(groups) - 1 - number) * (height + _GAP)
            axes = axes_at(figure, _LEFT, bottom, width, height)
            _bars(axes, orders, values, hues, kind="force" if unit == "N" else "moment", most=most, settings=settings)
            axes.set_title(name, fontsize=9)
            axes.set(xlim=(0.4, last + 0.6), ylabel=unit)
            factor, right = (per_omega, "g·mm") if unit == "N" else (1e-3 * per_omega, "g·mm²")
            _second_scale(axes, factor, right)
            if number == 2:
                keyed = [(called(names, balance), system_color(names[0])) for names in rocking]
                color_key(figure, (_LEFT + 2.6, bottom, width - 2.6, height), keyed)
            if number == len(groups) - 1:
                axes.set_xlabel("order, cycles per crank revolution")
        entries = [(called(system, balance), system_color(system[0])) for system in systems]
        if len(entries) > 1:
            color_key(figure, (_LEFT, tall_in - _TOP + 0.2, width, 0.1), entries)
        said = f"Amplitude at {speed_key(speed)} rpm. "
        said += f"Bars below {100 * _share(settings):.1g} % of the largest are left out."
        said += f" So are orders above {last:g}." if tall and tall[-1] > last else ""
        idle = [str(name) for name in balance["system"].values if not any(name in names for names in systems)]
        said += f" No force: {called(idle, balance)}." if idle else ""
        title_lines(figure, _LEFT, f"{drawable(title, settings.max_name_characters)} · force by order", said)
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
        systems_of = [balance["moment_by_system"].sel(system=names[0]).values for names in moments]
        hues = [system_color(names[0]) for names in moments]
        about_z, about_x, roll = (1e-3 * per_omega * np.array([one[row] for one in systems_of]) for row in range(3))
        # the couple along Z and X as what turns with the crank and against it: the largest of the turn is their sum
        rocking = (np.abs(about_x + 1j * about_z) + np.abs(about_x - 1j * about_z)) / 2
        most = float(max(rocking.max(), np.abs(roll).max()))
        groups.append(("Rocking couple, the most of a turn", "N·m", most, list(rocking), hues))
        groups.append(("Roll moment of the masses", "N·m", most, list(np.abs(roll)), hues))
    return groups


def _bars(
    axes: Axes,
    orders: Floats,
    values: list[Floats],
    colors: list[str],
    *,
    kind: str,
    most: float,
    settings: ReportSettings,
) -> None:
    """Bars of every order side by side, the largest with its value above; ``kind``: force or moment."""
    quiet_frame(axes)
    axes.grid(False, axis="x")
    floor = most * _share(settings)
    high = np.max(values, axis=0)
    shown = [float(order) for order, value in zip(orders, high, strict=True) if value > floor > 0]
    axes.set_xticks(shown, [order_text(order) for order in shown])
    log_axis(axes, floor if most else 1e-3, 4 * most if most else 1.0, most_ticks=7)
    if not shown:
        axes.text(0.5, 0.5, f"no {kind} of any order", transform=axes.transAxes, **NOTE)
        return
    width = min(0.84 / len(values), _WIDEST)
    for number, (column, color) in enumerate(zip(values, colors, strict=True)):
        tall = column > floor
        places = orders[tall] + (number - (len(values) - 1) / 2) * width
        axes.bar(places, column[tall], 0.9 * width, color=color, gid=f"bars-{number}")
    for order, value, tallest in zip(orders, high, np.argmax(values, axis=0), strict=True):
        if value > floor:
            place = order + (tallest - (len(values) - 1) / 2) * width
            axes.text(place, value * 1.1, number_text(float(value)), ha="center", va="bottom", fontsize=SMALL)


def _second_scale(axes: Axes, per_omega: float, unit: str) -> None:
    """The same scale in amounts over squared crank speed at the right of ``axes``."""
    low, high = axes.get_ylim()
    right = axes.twinx()
    log_axis(right, low / per_omega, high / per_omega, most_ticks=7)
    right.spines[["top", "left", "bottom"]].set_visible(False)
    right.tick_params(length=3)
    right.set_ylabel(f"over ω², {unit}")


def _share(settings: ReportSettings) -> float:
    """Smallest amplitude drawn, as a share of the largest."""
    return float(10 ** (-settings.dynamic_range_db / 20))
