"""Grids of a test's channels: the average engine cycle at a few speeds, and the operating shapes at one.

A shape is a phasor for every order and channel, with its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import xarray as xr

from crankorder.channel_units import unit_text
from crankorder.findings import Findings
from crankorder.orders.intervals import t_quantile
from crankorder.plot.axes import whole_picture
from crankorder.plot.drawing import Area, Drawing, Panel, Rings, Stroke, Words
from crankorder.plot.labels import head_of_test
from crankorder.plot.palette import FAINT, GRID, INK, LINES, NORMAL, SMALL, WHITE, drawable, shortened, text_width_in
from crankorder.plot.reading import nominal_order, number_text, order_text
from crankorder.plot.spectra_figure import column_boxes
from crankorder.quantities import Floats
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEFT, _RIGHT, _GUTTER = 1.15, 0.25, 0.72  # inches
_NAME_AT = 0.62  # of the name of a channel from its panels, in inches
_SPEEDS = 3  # columns that leave a waveform of forty turns legible
_MOST_SPREAD = 3.0  # mean and spread wider than this, in half ranges of the mean: the spread is a number only
_TIGHT = 0.5  # room beside the mean on an axis without the spread, in half ranges of the mean
_FLAT = 1e-12  # what varies by less than this share of its size is a straight line

_MARKS = {"tdc": "TDC", "index": "index mark", "pulse": "pulse"}
_FROM = {"tdc": "from top dead centre", "index": "from the index mark", "pulse": "from the pulse"}


def cycle_figure(cycles: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Mean cycle of every channel (rows) at the slowest, the middle and the fastest speed (columns), with its spread.

    Every panel has its own scale, for forces grow with the square of speed; it follows the mean, and a spread that
    would make a line of it is given as a number only. Dead centres are marked. ``cycles`` is a CycleAverage (channel,
    speed, cycle_angle), ``findings`` are those of the same test, ``settings`` those of the report.
    """
    cycles = cycles.sortby("speed")
    held = np.flatnonzero(cycles["n_cycles"].transpose("channel", "speed").values.max(axis=0, initial=0))
    shown = held if len(held) <= _SPEEDS else held[[0, len(held) // 2, -1]]
    columns = max(len(shown), 1)
    width = (settings.width_in - _LEFT - _RIGHT - (columns - 1) * _GUTTER) / columns
    lefts = [_LEFT + column * (width + _GUTTER) for column in range(columns)]
    drawing, boxes = column_boxes(cycles.sizes["channel"], width, settings, lefts=lefts)
    for column, left in enumerate(lefts):
        at_speed, color = cycles.isel(speed=int(shown[column]) if len(shown) else 0), LINES[column]
        for row, box in enumerate(boxes[column]):
            cycle, label, last = at_speed.isel(channel=row), "", row == len(boxes[column]) - 1
            if column == 0:
                name = shortened(drawable(cycle["channel"].item(), settings.max_name_characters), NORMAL, box[3])
                unit = shortened(drawable(unit_text(str(cycle["unit"].item())), 24), NORMAL, box[3])
                label = f"{name}\n{unit}"
            _draw_cycle(Panel(drawing, box, *_axis_ends(cycle)), cycle, color, label, last=last)
        top = boxes[column][0][1] + boxes[column][0][3]
        _name_marks(drawing, cycles, left, top, width)
        if len(shown):
            drawing.add(Words(left, top + 0.24, _heading(at_speed), NORMAL + 1, color, bold=True))
    origin = _FROM.get(str(cycles.attrs.get("phase_reference", "none")), "from where the recording begins")
    middle = _LEFT + (settings.width_in - _LEFT - _RIGHT) / 2
    drawing.add(Words(middle, 0.2, f"Crank angle {origin}, °", along="centre"))
    subtitle = _subtitle(cycles, len(shown))
    head_of_test(drawing, _LEFT, findings, "average cycle", subtitle, longest=settings.max_name_characters)
    return drawing


def cycle(cycle_average: xr.Dataset, findings: Findings | Mapping[str, object] | None = None) -> Figure:
    """Mean engine cycle of every channel at up to three speeds, with its spread; returns the figure.

    ``cycle_average`` is the branch of that name of results by the recipe ``waveforms``, ``findings`` are those of the
    test, which give its name. Raises RequestError for another dataset or no findings.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     folders = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     figure = co.plot.cycle(co.run(folders, out=work + "/out", recipe="waveforms")["cycle_average"])
    """
    return whole_picture(cycle_figure, cycle_average, findings, "cycle_average", "cycle")


def shapes(operating_shapes: xr.Dataset, findings: Findings | Mapping[str, object] | None = None) -> Figure:
    """Amplitude and phase of the strongest orders over the channels, as phasors; returns the figure.

    ``operating_shapes`` is the branch of that name of results by the recipe ``waveforms``, ``findings`` are those of
    the test, which give its name. Raises RequestError for another dataset or no findings.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     folders = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     figure = co.plot.shapes(co.run(folders, out=work + "/out", recipe="waveforms")["operating_shapes"])
    """
    return whole_picture(shapes_figure, operating_shapes, findings, "operating_shapes", "shapes")


def _subtitle(cycles: xr.Dataset, shown: int) -> str:
    total = cycles.sizes["speed"]
    some = f"{shown} of {total} speeds. " if shown < total else ""
    unknown = int(cycles.attrs["revs_per_cycle"]) > 1 and not int(cycles.attrs["cycle_known"])
    turn = "Which turn fires is not known. " if unknown else ""
    bands = "Mean, 95 % interval (dark), standard deviation (light where it fits, and number)"
    return f"{some}{turn}{bands}; orders up to {float(cycles.attrs['max_order']):g}."


def _heading(cycle: xr.Dataset) -> str:
    """Column title: speed and number of averaged cycles."""
    speed, least, most = cycle.speed, int(cycle.n_cycles.min()), int(cycle.n_cycles.max())
    cycles = f"{least}…{most} cycles" if least < most else f"{most} cycle{'s' if most != 1 else ''}"
    return f"{f'{speed:.0f} rpm' if math.isfinite(speed) else 'unknown speed'} · {cycles}"


def _name_marks(drawing: Drawing, cycles: xr.Dataset, left: float, top: float, width: float) -> None:
    """Write the names of the dead centres above a column."""
    revs, reference = int(cycles.attrs["revs_per_cycle"]), str(cycles.attrs.get("phase_reference", "none"))
    plain = _MARKS.get(reference, "")
    fires = reference == "tdc" and revs > 1 and int(cycles.attrs["cycle_known"])
    for turn in range(revs + 1) if plain else ():
        name = f"firing {plain}" if fires and turn in (0, revs) else plain
        place = left + width * turn / revs
        along: Literal["left", "centre", "right"] = "left" if turn == 0 else "right" if turn == revs else "centre"
        drawing.add(Words(place, top + 0.06, name, SMALL, FAINT, along=along))


def _spread(cycle: xr.Dataset) -> tuple[Floats, Floats, Floats, bool]:
    """Mean, standard deviation and standard error of one cycle, closed at its end; whether the deviation is drawn."""
    names = ("mean", "standard_deviation", "standard_error")
    mean, deviation, error = (np.append(values, values[0]) for values in (cycle[name].values for name in names))
    known = np.nan_to_num(deviation)
    fits = float((mean + known).max() - (mean - known).min()) <= 2.0 * _MOST_SPREAD * _half_range(mean)
    return mean, deviation, error, fits


def _half_range(mean: Floats) -> float:
    return max(0.5 * float(np.ptp(mean)), _FLAT * float(np.abs(mean).max()), 1e-300)


def _axis_ends(cycle: xr.Dataset) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ends of the axes of one cycle: its angles [degree], and its mean with the spread where that is drawn."""
    angles = 0.0, 360.0 * int(cycle.attrs["revs_per_cycle"])
    mean, deviation, _, fits = _spread(cycle)
    if not np.isfinite(mean).all():
        return angles, (0.0, 1.0)
    half = _half_range(mean)
    reach = np.nan_to_num(deviation) if fits else _TIGHT * half
    low, high = float((mean - reach).min()), float((mean + reach).max())
    margin = 0.05 * max(high - low, half)
    return angles, (low - margin, high + margin)


def _draw_cycle(panel: Panel, cycle: xr.Dataset, color: str, label: str, *, last: bool) -> None:
    """Mean and spread of one channel at one speed over the angles of a cycle, with a line at every revolution."""
    mean, deviation, error, fits = _spread(cycle)
    measured, revs = bool(np.isfinite(mean).all()), int(cycle.attrs["revs_per_cycle"])
    step = (180 if revs > 1 else 90) * max(1, revs // 2)
    panel.x_axis(places=np.arange(0.0, 360.0 * revs + 1, step), named=last)
    ticks = int(np.clip(3.0 * panel.box[3], 4, 8))
    panel.y_axis(label, most=ticks, places=None if measured else [], at_in=_NAME_AT)
    panel.frame()
    for turn in range(revs + 1):
        panel.upright(360.0 * turn, color=FAINT, width=0.9, name="mark")
    if not measured:
        panel.note("no whole cycle")
        return
    angle = np.append(cycle.cycle_angle.values, 360.0 * revs)
    interval = error * t_quantile(np.array(max(int(cycle.n_cycles) - 1, 1)))
    for reach, alpha, name in ((deviation, 0.16, "deviation"), (interval, 0.38, "interval")):
        if np.isfinite(reach).all() and (fits or name == "interval"):
            panel.band(angle, mean - reach, mean + reach, color=color, alpha=alpha, name=name)
    panel.curve(angle, mean, color=color, width=1.1, name="mean")
    size = float(deviation.max()) or 1.0  # 1e-300 squared is nothing
    if math.isfinite(size):
        text = f"± {number_text(size * float(np.sqrt(np.mean((deviation / size) ** 2))), digits=2)}"
        right, top = panel.box[0] + panel.box[2] - 0.02, panel.box[1] + panel.box[3] - 0.1
        ground = np.array([[right - text_width_in(text, SMALL), top], [right, top]])
        panel.drawing.add(Stroke(ground, WHITE, 11.0, alpha=0.85))
        panel.drawing.add(Words(right, top, text, SMALL, along="right", across="centre"))


_NAMES_IN, _HEAD_IN, _FOOT_IN, _EDGE_IN, _HEADER = 1.3, 0.98, 0.42, 0.2, 0.44  # inches
_CHANNELS = 12  # side by side; more are continued below
_ORDERS = 8  # rows, the strongest
_WIDE = 1.75  # a cell from this width on has its numbers beside the phasor, with their intervals
_ROW_WIDE, _ROW_NARROW = 0.82, 0.98
_RADIUS_WIDE, _RADIUS_NARROW = 0.33, 0.29
_NO_PHASE = 90.0  # half an interval of phase from which a direction says nothing
_SHORT = {"tdc": "TDC", "index": "index", "pulse": "pulse"}


class _Cell(NamedTuple):
    """One order of one channel at the speed shown; ``clear``: told from nothing."""

    amplitude: float
    low: float
    high: float
    phase: float
    half_phase: float
    clear: bool


def shapes_figure(shapes: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Phasors of all channels (columns) at the strongest orders (rows), with amplitude, phase and 95 % intervals.

    They are those of the speed with the largest amplitude of all. A hand's length is the amplitude beside the largest
    of its row in the same unit, its direction the phase, 0° to the right and growing anticlockwise; the pale field is
    the 95 % interval. ``shapes`` are OperatingShapes (channel, speed, order), ``findings`` those of the same test,
    ``settings`` those of the report.
    """
    at_speed = _with_ends(shapes.isel(speed=_loudest_speed(shapes)))
    orders, channels = _strongest_orders(at_speed), range(at_speed.sizes["channel"])
    blocks = [channels[first : first + _CHANNELS] for first in range(0, len(channels), _CHANNELS)]
    cell_width = min((settings.width_in - _NAMES_IN - _EDGE_IN) / min(max(len(channels), 1), _CHANNELS), 3.3)
    height = _ROW_WIDE if cell_width >= _WIDE else _ROW_NARROW
    block_height = _HEADER + max(len(orders), 1) * height
    drawing = Drawing(settings.width_in, _HEAD_IN + _FOOT_IN + len(blocks) * block_height)
    mixed = len(set(at_speed.phase_from.values)) > 1
    for number, block in enumerate(blocks):
        top = drawing.height_in - _HEAD_IN - number * block_height
        lefts = [_NAMES_IN + column * cell_width for column in range(len(block))]
        for left, channel in zip(lefts, block, strict=True):
            of_channel = at_speed.isel(channel=channel)
            _name_column(drawing, of_channel, left, top, cell_width, settings.max_name_characters)
        for row, order in enumerate(orders):
            middle, of_order = top - _HEADER - (row + 0.5) * height, at_speed.isel(order=order)
            edge = middle + height / 2
            drawing.add(Stroke(np.array([[0.25, edge], [_NAMES_IN + len(block) * cell_width, edge]]), GRID, 0.8))
            _name_order(drawing, of_order, middle, mixed=mixed)
            for left, channel in zip(lefts, block, strict=True):
                alike = of_order.amplitude.values[of_order.unit.values == of_order.unit.values[channel]]
                longest = float(np.nan_to_num(alike).max(initial=0.0))
                cell = _Cell(*(of_order[name].values[channel].item() for name in _Cell._fields))
                _draw_cell(drawing, cell, longest, (left, middle, cell_width))
    what = "operating shapes" + (f" at {at_speed.speed:.0f} rpm" if math.isfinite(at_speed.speed) else "")
    subtitle = _shapes_subtitle(shapes, len(orders))
    head_of_test(drawing, 0.25, findings, what, subtitle, longest=settings.max_name_characters)
    return drawing


def _with_ends(shapes: xr.Dataset) -> xr.Dataset:
    """``shapes`` with the ends of their intervals, and whether amplitude and phase are told from nothing.

    An unknown interval counts as clear.
    """
    (low, high), (first, last) = (shapes[name].transpose("bound", ...) for name in ("amplitude_ci95", "phase_ci95"))
    half = 0.5 * (last - first)
    clear = (shapes.amplitude > 0.0) & ~(low <= 0.0) & ~(half >= _NO_PHASE)
    return shapes.assign(low=low, high=high, half_phase=half, clear=clear)


def _strongest_orders(at_speed: xr.Dataset) -> list[int]:
    """Numbers of the orders that stand clear, the largest relative to their channel, in ascending order."""
    clear = at_speed.amplitude.where(at_speed.clear, 0.0).transpose("channel", "order").values
    largest = clear.max(axis=1, initial=0.0)
    share = (clear / np.where(largest > 0.0, largest, 1.0)[:, None]).max(axis=0, initial=0.0)
    kept = [int(place) for place in np.argsort(-share, kind="stable") if share[place] > 0.0][:_ORDERS]
    return sorted(kept, key=lambda place: float(at_speed.order.values[place]))


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


def _name_column(drawing: Drawing, channel: xr.Dataset, left: float, top: float, width: float, limit: int) -> None:
    name = drawable(str(channel["channel"].item()), limit)
    direction = str(channel["direction"].item()) if "direction" in channel.coords else ""
    unit = drawable(unit_text(str(channel["unit"].item())), 24)
    # where a channel is called by its direction that is said once
    about = f"{drawable(direction, 12)} · {unit}" if direction and direction.strip("+") != name else unit
    middle, lines = left + width / 2, _two_lines(name, width - 0.08)
    for above, text in zip((0.14, 0.0)[-len(lines) :], lines, strict=True):
        drawing.add(Words(middle, top - 0.15 + above, text, bold=True, along="centre"))
    drawing.add(Words(middle, top - 0.32, shortened(about, SMALL, width - 0.06), SMALL, FAINT, along="centre"))


def _two_lines(name: str, width_in: float) -> list[str]:
    """``name`` in one line, or in two where it is wider than ``width_in``; what must go, goes from its middle."""

    def fits(text: str) -> bool:
        return text_width_in(text, NORMAL, bold=True) <= width_in

    if fits(name):
        return [name]
    breaks = [place for place, char in enumerate(name) if char in " _-./" and 0 < place < len(name) - 1]
    fitting = [place for place in breaks if fits(name[: place + 1].strip())]
    first = fitting[-1] + 1 if fitting else len(shortened(name, NORMAL, width_in, bold=True)) - 1
    tail = name[first:].strip()
    while len(tail) > 2 and not fits(tail):
        tail = "…" + tail.lstrip("…")[max(1, len(tail) // 12) :]
    return [name[:first].strip(), tail]


def _name_order(drawing: Drawing, order: xr.Dataset, middle: float, *, mixed: bool) -> None:
    """Order of a row and, where rows differ in that, what its phases are from."""
    drawing.add(Words(0.25, middle + 0.03, f"order {order_text(nominal_order(order.order))}", bold=True))
    origin = str(order.phase_from.item())
    if mixed:
        text = shortened(f"from {_SHORT.get(origin, drawable(origin, 24))}", SMALL, _NAMES_IN - 0.3)
        drawing.add(Words(0.25, middle - 0.12, text, SMALL, FAINT))


def _draw_cell(drawing: Drawing, cell: _Cell, longest: float, place: tuple[float, float, float]) -> None:
    """Phasor and numbers of one cell; ``place`` its left, the height of its middle, and its width, in inches."""
    left, middle, width = place
    wide = width >= _WIDE
    radius = _RADIUS_WIDE if wide else _RADIUS_NARROW
    x, y = (left + 0.1 + radius, middle) if wide else (left + width / 2, middle + 0.16)
    drawing.add(Rings(np.array([[x, y]]), 72 * radius, FAINT, width=0.6, alpha=0.7))
    drawing.add(Stroke(np.array([[x, y], [x + radius, y]]), GRID, 0.8))
    if math.isfinite(cell.amplitude) and longest > 0.0:
        _draw_hand(drawing, cell, np.array([x, y]), radius / longest, radius)
    ink = INK if cell.clear else FAINT
    for text, up, below in zip(_numbers(cell, with_intervals=wide), (0.035, -0.13), (0.14, 0.27), strict=True):
        if wide:
            drawing.add(Words(x + radius + 0.1, y + up, text, NORMAL, ink))
        else:
            text = shortened(text, SMALL, width - 0.02)
            drawing.add(Words(x, y - radius - below, text, SMALL, ink, along="centre"))


def _draw_hand(drawing: Drawing, cell: _Cell, centre: Floats, scale: float, radius: float) -> None:
    """Hand of a phasor from ``centre``, ``scale`` inches per unit, and its interval within ``radius``."""
    color = LINES[0] if cell.clear else FAINT

    def arc(length: float, degrees: Floats) -> Floats:
        turn = np.radians(degrees)
        return np.asarray(centre + length * np.column_stack([np.cos(turn), np.sin(turn)]))

    if math.isfinite(cell.half_phase) and math.isfinite(cell.high):
        half, outer = min(max(cell.half_phase, 0.5), 179.9), min(cell.high * scale, 1.12 * radius)
        angles = cell.phase + np.linspace(-half, half, 60)
        inner = min(max(cell.low * scale, 0.0), outer - 0.01)
        drawing.add(Area(np.concatenate([arc(outer, angles), arc(inner, angles[::-1])]), color, 0.25))
    end = arc(cell.amplitude * scale, np.array([cell.phase]))
    drawing.add(Stroke(np.concatenate([centre[None], end]), color, 1.8, name="hand"))
    drawing.add(Rings(end, 1.6, color))


def _numbers(cell: _Cell, *, with_intervals: bool) -> tuple[str, str]:
    """Amplitude and phase as text; the phase only where the amplitude is told from zero."""
    if not math.isfinite(cell.amplitude):
        return "–", ""
    amplitude = number_text(cell.amplitude)
    if not cell.clear:
        return (f"< {number_text(cell.high, digits=2)}" if math.isfinite(cell.high) else "–"), "–"
    phase = f"{(cell.phase + 180.0) % 360.0 - 180.0:.0f}°".replace("-", "−").replace("−0°", "0°")
    if with_intervals and math.isfinite(cell.high):
        amplitude = _with_interval(cell.amplitude, max(cell.high - cell.amplitude, cell.amplitude - cell.low))
        half = cell.half_phase
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
