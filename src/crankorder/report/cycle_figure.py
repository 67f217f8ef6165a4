"""Grids of a test's channels: the average engine cycle at a few speeds, and the operating shapes at one.

A shape is a phasor for every order and channel, with its numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from crankorder.channel_units import unit_text
from crankorder.findings import Findings
from crankorder.orders.intervals import t_quantile
from crankorder.plot.painter import axes_at, head_of_test, house_style, new_figure, note, quiet_frame, write
from crankorder.plot.palette import FAINT, GRID, INK, LINES, NORMAL, SMALL, drawable, shortened, text_width_in
from crankorder.plot.reading import nominal_order, number_text, order_text
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


_NAMES_IN, _HEAD_IN, _FOOT_IN, _EDGE_IN, _HEADER = 1.3, 0.98, 0.42, 0.2, 0.44  # inches
_CHANNELS = 12  # side by side; more are continued below
_ORDERS = 8  # rows, the strongest
_WIDE = 1.75  # a cell from this width on has its numbers beside the phasor, with their intervals
_ROW_WIDE, _ROW_NARROW = 0.82, 0.98
_NAME_SIZE, _BOLD = 9.0, 1.13  # text_width_in measures the regular weight
_RADIUS_WIDE, _RADIUS_NARROW = 0.33, 0.29
_NO_PHASE = 90.0  # half an interval of phase from which a direction says nothing
_SHORT = {"tdc": "TDC", "index": "index", "pulse": "pulse"}


@dataclass(frozen=True)
class _Cell:
    """One order of one channel at the speed shown."""

    amplitude: float
    low: float
    high: float
    phase_deg: float
    half_phase_deg: float

    @property
    def clear(self) -> bool:
        """Whether amplitude and phase are told from nothing (an unknown interval counts as clear)."""
        return self.amplitude > 0.0 and not self.low <= 0.0 and not self.half_phase_deg >= _NO_PHASE


def shapes_figure(shapes: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Figure:
    """Phasors of all channels (columns) at the strongest orders (rows), with amplitude, phase and 95 % intervals.

    They are those of the speed with the largest amplitude of all. A hand's length is the amplitude beside the largest
    of its row in the same unit, its direction the phase, 0° to the right and growing anticlockwise; the pale field is
    the 95 % interval. ``shapes`` an OperatingShapes; ``findings`` of the same test; ``settings`` of the report.
    """
    with house_style():
        at_speed = shapes.isel(speed=_loudest_speed(shapes))
        amplitude = np.nan_to_num(at_speed.amplitude.transpose("channel", "order").values)
        low = at_speed.amplitude_ci95.transpose("channel", "order", "bound").values[..., 0]
        swing = np.ptp(at_speed.phase_ci95.transpose("channel", "order", "bound").values, axis=-1)
        clear = np.where((low <= 0.0) | (swing >= 2.0 * _NO_PHASE), 0.0, amplitude)
        largest = clear.max(axis=1, initial=0.0)
        share = (clear / np.where(largest > 0.0, largest, 1.0)[:, None]).max(axis=0, initial=0.0)
        kept = [int(place) for place in np.argsort(-share, kind="stable") if share[place] > 0.0][:_ORDERS]
        orders = sorted(kept, key=lambda place: float(at_speed.order.values[place]))
        channels = range(at_speed.sizes["channel"])
        blocks = [channels[first : first + _CHANNELS] for first in range(0, len(channels), _CHANNELS)]
        cell_width = min((settings.width_in - _NAMES_IN - _EDGE_IN) / min(max(len(channels), 1), _CHANNELS), 3.3)
        height = _ROW_WIDE if cell_width >= _WIDE else _ROW_NARROW
        block_height = _HEADER + max(len(orders), 1) * height
        figure = new_figure(settings.width_in, _HEAD_IN + _FOOT_IN + len(blocks) * block_height)
        width, full = figure.get_size_inches()
        canvas = axes_at(figure, 0, 0, width, full)
        canvas.set(xlim=(0, width), ylim=(0, full))
        canvas.axis("off")
        mixed = len(set(at_speed.phase_from.values)) > 1
        for number, block in enumerate(blocks):
            top = full - _HEAD_IN - number * block_height
            lefts = [_NAMES_IN + column * cell_width for column in range(len(block))]
            for left, channel in zip(lefts, block, strict=True):
                _name_column(figure, at_speed.isel(channel=channel), left, top, cell_width, settings)
            for row, order in enumerate(orders):
                middle, of_order = top - _HEADER - (row + 0.5) * height, at_speed.isel(order=order)
                ends = [0.25, _NAMES_IN + len(block) * cell_width]
                canvas.plot(ends, [middle + height / 2] * 2, color=GRID, linewidth=0.8)
                _name_order(figure, of_order, middle, mixed=mixed)
                for left, channel in zip(lefts, block, strict=True):
                    longest, place = _longest(of_order, str(at_speed.unit.values[channel])), (left, middle, cell_width)
                    _draw_cell(figure, canvas, _cell(of_order.isel(channel=channel)), longest, place)
        what = "operating shapes" + (f" at {at_speed.speed:.0f} rpm" if math.isfinite(at_speed.speed) else "")
        subtitle = _shapes_subtitle(shapes, len(orders))
        head_of_test(figure, 0.25, findings, what, subtitle, longest=settings.max_name_characters)
        return figure


def _loudest_speed(shapes: xr.Dataset) -> int:
    """Row of the speed at which the channels together come nearest to their largest amplitudes."""
    amplitude = np.nan_to_num(shapes["amplitude"].transpose("channel", "order", "speed").values)
    largest = amplitude.max(axis=(1, 2), initial=0.0)
    share = amplitude / np.where(largest > 0.0, largest, 1.0)[:, None, None]
    return int(np.argmax(share.max(axis=1, initial=0.0).sum(axis=0)))


def _shapes_subtitle(shapes: xr.Dataset, shown: int) -> str:
    if not shown:
        return "No order stands clear of the noise at this speed."
    total = shapes.sizes["order"]
    some = f"The {shown} strongest of {total} orders. " if shown < total else ""
    origins = {str(text) for text in shapes["phase_from"].values}
    origin = next(iter(origins)) if len(origins) == 1 else ""
    zero = _FROM.get(origin, f"from {drawable(origin, 24)}" if origin else "from what is named at the left")
    return f"{some}Peak amplitude and phase {zero}; a hand's length compares its row; pale: 95 % interval."


def _name_column(
    figure: Figure, channel: xr.Dataset, left: float, top: float, width: float, settings: ReportSettings
) -> None:
    name = drawable(str(channel["channel"].item()), settings.max_name_characters)
    direction = str(channel["direction"].item()) if "direction" in channel.coords else ""
    unit = drawable(unit_text(str(channel["unit"].item())), 24)
    # where a channel is called by its direction that is said once
    about = f"{drawable(direction, 12)} · {unit}" if direction and direction.strip("+") != name else unit
    middle, lines = left + width / 2, _two_lines(name, width - 0.08)
    for above, text in zip((0.14, 0.0)[-len(lines) :], lines, strict=True):
        write(figure, middle, top - 0.15 + above, text, fontsize=_NAME_SIZE, fontweight="bold", ha="center")
    write(figure, middle, top - 0.32, shortened(about, SMALL, width - 0.06), fontsize=SMALL, color=FAINT, ha="center")


def _two_lines(name: str, width_in: float) -> list[str]:
    """``name`` in one line, or in two where it is wider than ``width_in``; what must go, goes from its middle."""
    size = _NAME_SIZE * _BOLD
    if text_width_in(name, size) <= width_in:
        return [name]
    breaks = [place for place, char in enumerate(name) if char in " _-./" and 0 < place < len(name) - 1]
    fitting = [place for place in breaks if text_width_in(name[: place + 1].strip(), size) <= width_in]
    first = fitting[-1] + 1 if fitting else len(shortened(name, size, width_in)) - 1
    tail = name[first:].strip()
    while len(tail) > 2 and text_width_in(tail, size) > width_in:
        tail = "…" + tail.lstrip("…")[max(1, len(tail) // 12) :]
    return [name[:first].strip(), tail]


def _name_order(figure: Figure, order: xr.Dataset, middle: float, *, mixed: bool) -> None:
    """Order of a row and, where rows differ in that, what its phases are from."""
    write(figure, 0.25, middle + 0.03, f"order {order_text(nominal_order(order.order))}", fontweight="bold")
    origin = str(order.phase_from.item())
    if mixed:
        text = shortened(f"from {_SHORT.get(origin, drawable(origin, 24))}", SMALL, _NAMES_IN - 0.3)
        write(figure, 0.25, middle - 0.12, text, fontsize=SMALL, color=FAINT)


def _cell(at_speed: xr.Dataset) -> _Cell:
    low, high = (float(value) for value in at_speed.amplitude_ci95.values)
    first, last = (float(value) for value in at_speed.phase_ci95.values)
    return _Cell(at_speed.amplitude, low, high, at_speed.phase, 0.5 * (last - first))


def _longest(order: xr.Dataset, unit: str) -> float:
    """Largest amplitude at an order among the channels of a unit."""
    alike = np.flatnonzero(order.unit.values == unit)
    return float(np.nanmax(np.nan_to_num(order.amplitude.values[alike]), initial=0.0))


def _draw_cell(figure: Figure, canvas: Axes, cell: _Cell, longest: float, place: tuple[float, float, float]) -> None:
    """Phasor and numbers of one cell; ``place`` its left, the height of its middle, and its width, in inches."""
    left, middle, width = place
    wide = width >= _WIDE
    radius = _RADIUS_WIDE if wide else _RADIUS_NARROW
    x, y = (left + 0.1 + radius, middle) if wide else (left + width / 2, middle + 0.16)
    color = LINES[0] if cell.clear else FAINT
    canvas.add_patch(Circle((x, y), radius, facecolor="none", edgecolor=FAINT, linewidth=0.6, alpha=0.7))
    canvas.plot([x, x + radius], [y, y], color=GRID, linewidth=0.8, zorder=0.9)
    if math.isfinite(cell.amplitude) and longest > 0.0:
        _draw_hand(canvas, cell, (x, y), radius / longest, radius, color)
    ink = INK if cell.clear else FAINT
    for text, up, below in zip(_numbers(cell, with_intervals=wide), (0.035, -0.13), (0.14, 0.27), strict=True):
        if wide:
            write(figure, x + radius + 0.1, y + up, text, fontsize=NORMAL, color=ink)
        else:
            text = shortened(text, SMALL, width - 0.02)
            write(figure, x, y - radius - below, text, ha="center", fontsize=SMALL, color=ink)


def _draw_hand(canvas: Axes, cell: _Cell, centre: tuple[float, float], scale: float, radius: float, color: str) -> None:
    """Hand of a phasor from ``centre``, ``scale`` inches per unit, and its interval within ``radius``."""
    x, y = centre
    if math.isfinite(cell.half_phase_deg) and math.isfinite(cell.high):
        outer = min(cell.high * scale, 1.12 * radius)
        half = min(max(cell.half_phase_deg, 0.5), 179.9)
        wedge = Wedge(
            centre, outer, cell.phase_deg - half, cell.phase_deg + half, width=max(outer - cell.low * scale, 0.01)
        )
        wedge.set(facecolor=color, alpha=0.25, linewidth=0)
        canvas.add_patch(wedge)
    turn = math.radians(cell.phase_deg)
    length = cell.amplitude * scale
    end = (x + length * math.cos(turn), y + length * math.sin(turn))
    canvas.plot([x, end[0]], [y, end[1]], color=color, linewidth=1.8, solid_capstyle="round", gid="hand")
    canvas.plot([end[0]], [end[1]], marker="o", markersize=3.2, color=color)


def _numbers(cell: _Cell, *, with_intervals: bool) -> tuple[str, str]:
    """Amplitude and phase as text; the phase only where the amplitude is told from zero."""
    if not math.isfinite(cell.amplitude):
        return "–", ""
    amplitude = number_text(cell.amplitude)
    if not cell.clear:
        return (f"< {number_text(cell.high, digits=2)}" if math.isfinite(cell.high) else "–"), "–"
    phase = f"{(cell.phase_deg + 180.0) % 360.0 - 180.0:.0f}°".replace("-", "−").replace("−0°", "0°")
    if with_intervals and math.isfinite(cell.high):
        amplitude = _with_interval(cell.amplitude, max(cell.high - cell.amplitude, cell.amplitude - cell.low))
        half = cell.half_phase_deg
        phase += f" ± {half:.0f}°" if half >= 9.95 else f" ± {half:.1f}°" if half >= 0.05 else ""
    return amplitude, phase


def _with_interval(value: float, half: float) -> str:
    """``value`` ± ``half``, both to the second digit of the interval."""
    if not half > 0.0:
        return number_text(value)
    decimals = 1 - math.floor(math.log10(half))
    if 0 <= decimals <= 6 and value < 1e6:
        return f"{value:.{decimals}f} ± {half:.{decimals}f}"
    return f"{number_text(value)} ± {number_text(half, digits=2)}"
