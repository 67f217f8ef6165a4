"""Panels of the pictures of a balance: curves against an angle, bars by order, and polar diagrams."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from crankorder.plot.drawing import SOLID, TICK_SIZE, Area, Box, Dashes, Drawing, Panel, Words, title_lines
from crankorder.plot.palette import FAINT, GRID, INK, NORMAL, SMALL, drawable, text_width_in
from crankorder.plot.reading import number_text
from crankorder.quantities import Complexes, Floats
from crankorder.report.balance_dataset import NO_FORCE
from crankorder.settings import ReportSettings

LEFT, RIGHT = 0.95, 0.35
"""Inches beside the panels."""
_TOP, _BOTTOM, _GAP_X, _GAP_Y = 1.2, 0.62, 0.95, 0.97  # inches
_KEY_SIZE = 8.0
_ROOM = 0.12  # above and below the curves, as a share of their range


class Curve(NamedTuple):
    """A line of ``values`` (angles,) over the angles of a panel, in its unit; ``width`` in points.

    ``text`` names it in the key of the panel, where it is not empty.
    """

    values: Floats
    color: str
    text: str = ""
    name: str = ""
    width: float = 1.3
    alpha: float = 1.0
    dashes: Dashes = SOLID


def boxes_of(
    drawing: Drawing, rows: int, columns: int, *, right: float = RIGHT, gap: float = _GAP_Y
) -> list[list[Box]]:
    """Boxes [inches] of panels in ``rows`` from the top and ``columns``, with ``gap`` inches between rows.

    They leave ``right`` inches of the ``drawing`` free.
    """
    width = (drawing.width_in - LEFT - right - (columns - 1) * _GAP_X) / columns
    height = (drawing.height_in - _TOP - _BOTTOM - (rows - 1) * gap) / rows
    bottoms = [_BOTTOM + (rows - 1 - row) * (height + gap) for row in range(rows)]
    return [[(LEFT + n * (width + _GAP_X), bottom, width, height) for n in range(columns)] for bottom in bottoms]


def color_key(drawing: Drawing, box: Box, entries: Sequence[tuple[str, str]]) -> None:
    """Write ``entries`` (text, colour) in one line above the ``box`` of a ``drawing``, smaller where they are many."""
    left, bottom, width, height = box
    widths = [text_width_in(text, _KEY_SIZE, bold=True) + 0.16 for text, _ in entries]
    shrink = min(1.0, width / max(sum(widths), 1e-9))
    for (text, color), wide in zip(entries, widths, strict=True):
        drawing.add(Words(left, bottom + height + 0.06, text, shrink * _KEY_SIZE, color, bold=True))
        left += wide * shrink


class Chart(NamedTuple):
    """``curves`` in one ``unit`` against an angle, which ``label`` names."""

    title: str
    unit: str
    curves: Sequence[Curve]
    label: str = "crank angle, °"


def draw_chart(drawing: Drawing, box: Box, chart: Chart, angle_deg: Floats, *, limit: float = 0.0) -> Panel:
    """Panel with the curves of ``chart`` over whole turns; curves of zeros are only named.

    The panel lies on ``drawing`` in ``box``; ``angle_deg`` (angles,) are the crank angles [deg] of the values, from 0.
    The scale is ±``limit`` in the unit of the chart, or as the curves need where that is 0.
    """
    title, unit, curves, label = chart
    values = np.array([np.zeros(len(angle_deg)), *(curve.values for curve in curves)])
    low, high = (-limit, limit) if limit else (float(values.min()), float(values.max()))
    room = 0.0 if limit else _ROOM * (high - low) or 1.0
    turns = round(float(angle_deg[-1]) / 360)
    panel = Panel(drawing, box, (0.0, 360.0 * turns), (low - room, high + room))
    panel.x_axis(label, places=np.arange(0.0, panel.x[1] + 1, 90.0))
    panel.y_axis(unit)
    panel.frame()
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.8)
    key, nothing, largest = [], [], max(limit, high, -low)
    for values, color, text, name, width, alpha, dashes in curves:
        if np.abs(values).max() > NO_FORCE * largest:
            panel.curve(angle_deg, values, color=color, width=width, name=name, alpha=alpha, dashes=dashes)
            key += [(text, color)] if text else []
        else:
            nothing.append(text)
    if nothing:
        key.append((f"nothing: {', '.join(filter(None, nothing))}".removesuffix(": "), FAINT))
    color_key(drawing, box, key)
    drawing.add(Words(box[0], box[1] + box[3] + (0.27 if key else 0.1), title))
    return panel


def draw_bars(
    panel: Panel, orders: Mapping[float, str], heights: Sequence[Floats], colors: Sequence[str], least: float
) -> None:
    """Draw bars in ``colors`` on ``panel`` around the places of ``orders``, whose texts name them.

    ``heights`` are (places,) for each colour, in the unit of the panel; places without a bar above ``least`` are left
    out. Sizes stand above the bars of a place, or above the tallest one only where they are wider than bars.
    """
    drawing, (left, bottom, width, _) = panel.drawing, panel.box
    pitch, unit_in = min(0.84 / len(heights), 0.42), width / (panel.x[1] - panel.x[0])
    shown = [(at, sizes) for at, sizes in zip(orders, np.transpose(heights), strict=True) if sizes.max() > least]
    panel.x_axis(places=np.array([at for at, _ in shown]), named=False, grid=False)
    panel.frame()
    for at, sizes in shown:
        x = left + (at - panel.x[0]) * unit_in
        drawing.add(Words(x, bottom - 0.09, orders[at], TICK_SIZE, along="centre", across="top", name="tick"))
        texts = [number_text(float(size)) for size in sizes]
        fit = all(text_width_in(text, SMALL) < pitch * unit_in for text in texts)
        for number, (size, text, color) in enumerate(zip(sizes, texts, colors, strict=True)):
            if size > least:
                middle, low = at + (number - (len(heights) - 1) / 2) * pitch, np.full(2, panel.y[0])
                ends = middle + 0.45 * pitch * np.array([-1.0, 1.0])
                panel.band(ends, low, np.full(2, size), color=color, alpha=1.0, name=f"bars-{number}")
                if fit or number == np.argmax(sizes):
                    x, y = panel.at(middle, float(size))[0]
                    drawing.add(Words(x, y + 0.04, text, SMALL, along="centre", name="size"))


class Polar(NamedTuple):
    """A closed ``curve`` (points,), real part upwards and imaginary part to the right, in a frame of ±``limit``.

    Both have one unit; ``captions`` are the lines of text above the frame.
    """

    curve: Complexes
    color: str
    limit: float
    captions: Sequence[str]


def polar_grid(
    rows: Sequence[Sequence[Polar]], settings: ReportSettings, *, widest: float, above: float = 0.7
) -> tuple[Drawing, list[list[Box]]]:
    """Drawing with polar diagrams in ``rows``, and their boxes.

    ``settings`` are those of the report. A diagram is ``widest`` inches wide at most; ``above`` inches of the drawing
    stay free at its top.
    """
    step = (settings.width_in - LEFT - 0.05) / max(map(len, rows))
    side, head = min(step - 0.2, widest), 0.84
    drawing = Drawing(settings.width_in, above + 0.3 + len(rows) * (side + head))
    boxes: list[list[Box]] = []
    for number, row in enumerate(rows, start=1):
        bottom = 0.3 + (len(rows) - number) * (side + head)
        boxes.append([(LEFT + place * step, bottom, side, side) for place in range(len(row))])
        for polar, box in zip(row, boxes[-1], strict=True):
            _polar(drawing, box, polar)
    return drawing, boxes


def _polar(drawing: Drawing, box: Box, polar: Polar) -> None:
    """Polar diagram: curve, dot at crank angle 0, arrows in the sense of rotation, captions above, the first bold."""
    curve, color, limit, captions = polar
    left, bottom, side, _ = box
    for line, text in enumerate(captions):
        below, size = len(captions) - 1 - line, SMALL + 0.5 if line else NORMAL
        ink, y = INK if below or not line else FAINT, bottom + side + 0.07 + 0.14 * below
        drawing.add(Words(left + side / 2, y, text, size, ink, bold=not line, along="centre"))
    panel = Panel(drawing, box, (-limit, limit), (-limit, limit))
    panel.upright(0.0, color=GRID)
    panel.curve(np.array(panel.x), np.zeros(2), color=GRID, width=0.8)
    panel.frame(whole=True)
    panel.curve(curve.imag, curve.real, color=color, name="polar")
    panel.rings(curve.imag[:1], curve.real[:1], color=color, radius=2.2, name="top-dead-centre")
    largest = float(np.abs(curve).max())
    area = 0.5 * abs(float(np.sum((curve[:-1].conj() * curve[1:]).imag)))
    # more than a line drawn there and back, so that it has a sense of rotation
    if area > 0.12 * largest**2 and largest >= 0.06 * limit:
        places, steps = panel.at(curve.imag, curve.real), len(curve) - 1
        for start in (steps // 8, 5 * steps // 8):
            arrow_head(drawing, places[start], places[start + max(1, steps // 72)], color)


def arrow_head(drawing: Drawing, tail: Floats, tip: Floats, color: str) -> None:
    """Head of an arrow in ``color`` on the ``drawing`` from ``tail`` (2,) at ``tip`` (2,), both x and y in inches."""
    along = 0.11 * (tip - tail) / max(float(np.hypot(*(tip - tail))), 1e-12)
    across = 0.4 * along[::-1] * (-1.0, 1.0)
    drawing.add(Area(np.array([tip, tip - along + across, tip - along - across]), color, name="sense"))


def headed(drawing: Drawing, name: str, what: str, sentence: str, settings: ReportSettings) -> Drawing:
    """The ``drawing`` with a title, the ``name`` of the engine and ``what`` is shown, and a ``sentence`` below it.

    ``settings`` are those of the report.
    """
    title_lines(drawing, LEFT, f"{drawable(name, settings.max_name_characters)} · {what}", sentence)
    return drawing


def frame_around(largest: float) -> float:
    """Half the side of a frame around a curve of up to ``largest``, 0 or more, in one unit: a round number above it.

    It is 1 where ``largest`` is 0.
    """
    if largest == 0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(largest))
    return next(step * decade for step in (1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12) if step * decade > 1.05 * largest)
