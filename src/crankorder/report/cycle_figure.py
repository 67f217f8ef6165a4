"""The average engine cycle of every channel against crank angle, at a few speeds."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from crankorder.channel_units import unit_text
from crankorder.findings import Findings
from crankorder.orders.intervals import t_quantile
from crankorder.plot.palette import FAINT, INK, LINES, NORMAL, SMALL, drawable, shortened
from crankorder.plot.reading import number_text
from crankorder.plot.style import axes_at, head_of_test, house_style, new_figure, note, quiet_frame, write
from crankorder.quantities import Floats
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _TOP, _RIGHT, _GUTTER, _ROW_GAP = 1.15, 0.66, 1.28, 0.25, 0.72, 0.17  # inches
_LEAST_ROW = 1.0  # a row of panels is never lower than this
_SPEEDS = 3  # columns that leave a waveform of forty turns legible
_MOST_SPREAD = 3.0  # mean and spread wider than this, in half ranges of the mean: the spread is a number only
_TIGHT = 0.5  # room beside the mean on an axis without the spread, in half ranges of the mean
_FLAT = 1e-12  # what varies by less than this share of its size is a straight line

_MARKS = {"tdc": "TDC", "index": "index mark", "pulse": "pulse"}
_FROM = {"tdc": "from top dead centre", "index": "from the index mark", "pulse": "from the pulse"}


def cycle_figure(cycles: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Figure:
    """Mean cycle of every channel (rows) at the slowest, the middle and the fastest speed (columns), with its spread.

    Every panel has its own scale, for forces grow with the square of speed; it follows the mean, and a spread that
    would make a line of it is given as a number only. Dead centres are marked. ``cycles`` a CycleAverage; ``findings``
    of the same test; ``settings`` of the report.
    """
    with house_style():
        cycles = cycles.sortby("speed")
        held = np.flatnonzero(cycles["n_cycles"].transpose("channel", "speed").values.max(axis=0, initial=0))
        shown = [int(row) for row in (held if len(held) <= _SPEEDS else held[[0, len(held) // 2, -1]])]
        rows, columns = cycles.sizes["channel"], max(len(shown), 1)
        height = max((settings.height_in - _BOTTOM - _TOP - (rows - 1) * _ROW_GAP) / rows, _LEAST_ROW)
        figure = new_figure(settings.width_in, _TOP + _BOTTOM + rows * height + (rows - 1) * _ROW_GAP)
        width = (settings.width_in - _LEFT - _RIGHT - (columns - 1) * _GUTTER) / columns
        for column in range(columns):
            left = _LEFT + column * (width + _GUTTER)
            for row in range(rows):
                bottom = _BOTTOM + (rows - 1 - row) * (height + _ROW_GAP)
                axes = axes_at(figure, left, bottom, width, height)
                _angle_axis(axes, cycles, last=row == rows - 1)
                if shown:
                    _draw(axes, cycles.isel(channel=row, speed=shown[column]), LINES[column], height)
                else:
                    note(axes, "no whole cycle")
                if column == 0:
                    _name_row(figure, cycles.isel(channel=row), bottom + height / 2, height, settings)
            top = _BOTTOM + rows * height + (rows - 1) * _ROW_GAP
            _mark_names(figure, cycles, left, top, width)
            if shown:
                cycle = cycles.isel(speed=shown[column])
                write(figure, left, top + 0.24, _heading(cycle), fontsize=NORMAL + 1, fontweight="bold",
                      color=LINES[column])  # fmt: skip
        reference = str(cycles.attrs.get("phase_reference", "none"))
        label = f"Crank angle {_FROM.get(reference, 'from where the recording begins')}, °"
        write(figure, _LEFT + (settings.width_in - _LEFT - _RIGHT) / 2, 0.2, label, ha="center")
        subtitle = _subtitle(cycles, len(shown))
        head_of_test(figure, _LEFT, findings, "average cycle", subtitle, longest=settings.max_name_characters)
        return figure


def _subtitle(cycles: xr.Dataset, shown: int) -> str:
    total = cycles.sizes["speed"]
    some = f"{shown} of {total} speeds. " if shown < total else ""
    order = float(cycles.attrs["max_order"])
    unknown = int(cycles.attrs["revs_per_cycle"]) > 1 and not int(cycles.attrs["cycle_known"])
    turn = "Which turn fires is not known. " if unknown else ""
    bands = "Mean, 95 % interval (dark), standard deviation (light where it fits, and number)"
    return f"{some}{turn}{bands}; orders up to {order:g}."


def _heading(cycle: xr.Dataset) -> str:
    """Column title: speed and number of averaged cycles."""
    speed = cycle.speed
    count = cycle.n_cycles.values
    least, most = int(count.min()), int(count.max())
    cycles = f"{least}…{most} cycles" if least < most else f"{most} cycle{'s' if most != 1 else ''}"
    return f"{f'{speed:.0f} rpm' if math.isfinite(speed) else 'unknown speed'} · {cycles}"


def _angle_axis(axes: Axes, cycles: xr.Dataset, *, last: bool) -> None:
    """Angles of one cycle, with a line at every revolution."""
    revs = int(cycles.attrs["revs_per_cycle"])
    quiet_frame(axes)
    axes.set_xlim(0, 360 * revs)
    step = 180 if revs > 1 else 90
    axes.xaxis.set_major_locator(FixedLocator(list(range(0, 360 * revs + 1, step * max(1, revs // 2)))))
    axes.tick_params(labelbottom=last)
    for turn in range(revs + 1):
        axes.axvline(360 * turn, color=FAINT, linewidth=0.9, gid="mark", zorder=0.9)


def _mark_names(figure: Figure, cycles: xr.Dataset, left: float, top: float, width: float) -> None:
    """Names of the dead centres above a column."""
    revs = int(cycles.attrs["revs_per_cycle"])
    reference = str(cycles.attrs.get("phase_reference", "none"))
    if reference not in _MARKS:
        return
    plain = _MARKS[reference]
    first = f"firing {plain}" if reference == "tdc" and revs > 1 and int(cycles.attrs["cycle_known"]) else plain
    for turn in range(revs + 1):
        place = left + width * turn / revs
        align = "left" if turn == 0 else "right" if turn == revs else "center"
        name = first if turn in (0, revs) else plain
        write(figure, place, top + 0.06, name, ha=align, fontsize=SMALL, color=FAINT)


def _name_row(figure: Figure, channel: xr.Dataset, middle: float, height: float, settings: ReportSettings) -> None:
    """Name and unit of a channel, upright at the left of its row."""
    name = shortened(drawable(str(channel["channel"].item()), settings.max_name_characters), NORMAL + 1, height)
    unit = shortened(drawable(unit_text(str(channel["unit"].item())), 24), NORMAL, height)
    for place, text, look in ((0.34, name, {"fontweight": "bold"}), (0.54, unit, {"color": INK})):
        write(figure, place, middle, text, rotation=90, ha="center", va="center", **look)


def _draw(axes: Axes, cycle: xr.Dataset, color: str, height_in: float) -> None:
    """Mean and spread of one channel at one speed; the cycle is closed at its end."""
    angle = np.append(cycle.cycle_angle.values, 360.0 * int(cycle.attrs["revs_per_cycle"]))
    mean = _closed(cycle["mean"].values)
    if not np.isfinite(mean).all():
        axes.set_yticks([])
        note(axes, "no whole cycle")
        return
    deviation, error = (_closed(cycle[name].values) for name in ("standard_deviation", "standard_error"))
    fits = _value_axis(axes, mean, np.nan_to_num(deviation), height_in)
    interval = error * t_quantile(np.array(max(int(cycle.n_cycles) - 1, 1)))
    for reach, alpha, gid in ((deviation, 0.16, "deviation"), (interval, 0.38, "interval")):
        if np.isfinite(reach).all() and (fits or gid != "deviation"):
            axes.fill_between(angle, mean - reach, mean + reach, color=color, alpha=alpha, linewidth=0, gid=gid)
    axes.plot(angle, mean, color=color, linewidth=1.1, gid="mean")
    usual = float(np.sqrt(np.mean((deviation / _size(deviation)) ** 2))) * _size(deviation)
    if math.isfinite(usual):
        ground = {"facecolor": "white", "edgecolor": "none", "pad": 1.2, "alpha": 0.85}
        text, look = f"± {number_text(usual, digits=2)}", {"ha": "right", "va": "top"}
        note(axes, text, (0.995, 0.97), fontsize=SMALL, color=INK, bbox=ground, **look)


def _value_axis(axes: Axes, mean: Floats, deviation: Floats, height_in: float) -> bool:
    """Whether the spread fits on the axis beside the mean, whose limits are set; else it is not drawn."""
    least, most = float(mean.min()), float(mean.max())
    half = max(0.5 * (most - least), _FLAT * max(abs(least), abs(most)), 1e-300)
    low, high = float((mean - deviation).min()), float((mean + deviation).max())
    fits = high - low <= 2.0 * _MOST_SPREAD * half
    if not fits:
        low, high = least - _TIGHT * half, most + _TIGHT * half
    margin = max(0.05 * (high - low), half * 0.05)
    axes.set_ylim(low - margin, high + margin)
    axes.yaxis.set_major_locator(MaxNLocator(int(np.clip(2.2 * height_in, 2, 6))))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}".replace("-", "−")))
    return fits


def _size(values: Floats) -> float:
    """Largest of ``values``, 1 where all are 0: what to divide by before squaring."""
    largest = float(values.max())
    return largest if largest > 0.0 else 1.0


def _closed(values: Floats) -> Floats:
    return np.append(values, values[0])
