"""A picture as a list of what is drawn, in inches from its lower left corner; matplotlib draws it when it is asked for.

A panel is axes with limits, ticks and labels at a place of it, and what is drawn against them.

The layout is settled here, before a renderer is there: labels are spread by the widths of their texts, and tests read
what lies where.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from crankorder.plot.palette import CAP_HEIGHT, FAINT, GRID, INK, LARGE, LAYOUT_DPI, NORMAL, shortened, text_width_in
from crankorder.quantities import Floats, Ints

Box = tuple[float, float, float, float]
"""Left, bottom, width and height in inches."""

Dashes = tuple[float, float]
"""Lengths of a dash and of a gap, in widths of the line."""

SOLID: Dashes = (0.0, 0.0)

ORDER = "Order (cycles per crank revolution)"
"""Label of an axis of orders."""

_BASELINE = {"baseline": 0.0, "centre": CAP_HEIGHT / 2, "top": CAP_HEIGHT}
_ALONG = {"left": 0.0, "centre": 0.5, "right": 1.0}
_DESCENT = 0.236  # of DejaVu Sans, in sizes of the type

TICK_SIZE = 8.5
_TICK_IN, _PAD_IN = 3 / 72, 0.05
_LINE_IN = 0.165
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_FEW_DECADES = 2.0  # a logarithmic axis of less has ticks at 2 and 5 too


@dataclass(frozen=True)
class Stroke:
    """A line through ``points`` (points, 2), x and y in inches, broken at NaN; ``width`` in points of type.

    ``values`` are the x and the y (points,) that it stands for, in the units of its axes.
    """

    points: Floats
    color: str
    width: float
    dashes: Dashes = SOLID
    alpha: float = 1.0
    within: Box | None = None
    square: bool = False
    name: str = ""
    values: tuple[Floats, Floats] | None = None


@dataclass(frozen=True)
class Area:
    """The area within outlines ``points`` (points, 2), x and y in inches; rows of NaN separate outlines."""

    points: Floats
    color: str
    alpha: float = 1.0
    within: Box | None = None
    name: str = ""


@dataclass(frozen=True)
class Rings:
    """Circles around ``points`` (circles, 2), x and y in inches; full discs where ``width`` is 0.

    ``radius`` and ``width`` are in points of type. ``values`` are the x and the y (circles,) that the circles stand
    for, in the units of their axes.
    """

    points: Floats
    radius: float
    color: str
    width: float = 0.0
    alpha: float = 1.0
    name: str = ""
    values: tuple[Floats, Floats] | None = None


@dataclass(frozen=True)
class Words:
    """A line of text, taken literally, whose point (``x``, ``y``) is named by ``along`` and ``across``."""

    x: float
    y: float
    text: str
    size: float = NORMAL
    color: str = INK
    bold: bool = False
    along: Literal["left", "centre", "right"] = "left"
    across: Literal["baseline", "centre", "top"] = "baseline"
    upward: bool = False
    name: str = ""

    @property
    def start(self) -> tuple[float, float]:
        """Start of its baseline, in inches."""
        back = _ALONG[self.along] * text_width_in(self.text, self.size, bold=self.bold) if self.along != "left" else 0.0
        drop = _BASELINE[self.across] * self.size / 72
        return (self.x + drop, self.y - back) if self.upward else (self.x - back, self.y - drop)

    @property
    def box(self) -> Box:
        """Bounding box, in inches."""
        (x, y), em = self.start, self.size / 72
        width, height = text_width_in(self.text, self.size, bold=self.bold), (CAP_HEIGHT + _DESCENT) * em
        return (x - CAP_HEIGHT * em, y, height, width) if self.upward else (x, y - _DESCENT * em, width, height)


@dataclass(frozen=True)
class Field:
    """Colours ``rgb`` (rows from the top, columns, 3), 0 to 255, over a ``box`` in inches.

    There are as many pixels as the box has, or each is repeated.
    """

    rgb: NDArray[np.uint8]
    box: Box


@dataclass
class Drawing:
    """A picture of ``width_in`` by ``height_in`` inches; what is added later lies on top.

    Its maps have ``dpi`` pixels per inch.
    """

    width_in: float
    height_in: float
    parts: list[Stroke | Area | Rings | Words | Field] = field(default_factory=list)
    dpi: float = LAYOUT_DPI

    def add(self, part: Stroke | Area | Rings | Words | Field) -> None:
        """Lay ``part`` on top."""
        self.parts.append(part)

    @property
    def words(self) -> list[Words]:
        """All texts."""
        return [part for part in self.parts if isinstance(part, Words)]

    def strokes(self, prefix: str) -> list[Stroke]:
        """Lines whose names begin with ``prefix``."""
        return [part for part in self.parts if isinstance(part, Stroke) and part.name.startswith(prefix)]


def title_lines(drawing: Drawing, left_in: float, title: str, sentence: str) -> None:
    """Bold ``title`` and a ``sentence`` under it, from ``left_in`` inches at the top of ``drawing``, cut to fit."""
    room, top = drawing.width_in - left_in - 0.2, drawing.height_in
    drawing.add(Words(left_in, top - 0.34, shortened(title, LARGE, room, bold=True), LARGE, bold=True))
    if sentence:
        subtitle = shortened(sentence, NORMAL, room)
        drawing.add(Words(left_in, top - 0.56, subtitle, NORMAL, FAINT, name="subtitle"))


def whole(places: Floats) -> Ints:
    """``places`` (any shape) rounded to whole pixels, a half upwards, as matplotlib snaps lines."""
    return np.asarray(np.floor(places + 0.5), dtype=np.int64)


def pixels_of(box: Box, dpi: float) -> tuple[int, int]:
    """Rows and columns that a :class:`Field` over ``box`` [inches] has at ``dpi`` pixels per inch."""
    left, bottom, width, height = box
    left, right, low, high = whole(dpi * np.array([left, left + width, bottom, bottom + height]))
    return int(high - low), int(right - left)


@dataclass(frozen=True)
class Panel:
    """Axes over ``box`` of ``drawing`` from ``x`` (low, high) and ``y`` (low, high), the latter logarithmic or not.

    ``inches`` is the transform from values to inches where axes of matplotlib stand there, on any scale; else None.
    """

    drawing: Drawing
    box: Box
    x: tuple[float, float]
    y: tuple[float, float]
    log_y: bool = False
    inches: Any = None

    def at(self, x: Floats | float, y: Floats | float) -> Floats:
        """Places (points, 2) in inches of values ``x``, ``y`` (points,); values ≤ 0 of a logarithmic axis give NaN."""
        values = np.stack(np.broadcast_arrays(x, y), axis=-1).reshape(-1, 2).astype(float)
        if self.inches is not None:
            return np.asarray(self.inches.transform(values))
        ends = np.array([self.x, self.y])
        if self.log_y:
            values[:, 1], ends[1] = np.log(np.where(values[:, 1] > 0, values[:, 1], np.nan)), np.log(ends[1])
        left, bottom, width, height = self.box
        return np.asarray((left, bottom) + (values - ends[:, 0]) / (ends[:, 1] - ends[:, 0]) * (width, height))

    def height_at(self, y: float) -> float:
        """Height of the value ``y`` in inches from the bottom of the drawing."""
        return float(self.at(self.x[0], y)[0, 1])

    def curve(self, x: Floats, y: Floats, *, color: str, width: float = 1.3, **look: Any) -> None:
        """Draw a line through ``x`` and ``y``, both (points,) in the units of the axes.

        ``color`` is its colour, ``width`` is in points of type, ``look`` are further fields of :class:`Stroke`.
        """
        values = (np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        self.drawing.add(Stroke(self.at(x, y), color, width, within=self.box, values=values, **look))

    def upright(self, x: float, *, color: str, width: float = 0.8, **look: Any) -> None:
        """Draw a line over the whole height at ``x`` in ``color``; ``width`` in points, ``look`` as for a curve."""
        self.curve(np.array([x, x]), np.array(self.y), color=color, width=width, square=True, **look)

    def band(self, x: Floats, low: Floats, high: Floats, *, color: str, alpha: float, name: str = "band") -> None:
        """Fill the area over ``x`` from ``low`` to ``high``, each (points,) in the units of the axes.

        ``color`` has the opacity ``alpha``, 0 to 1; ``name`` is what the area is called.
        """
        bottom = self.y[0] if self.log_y else -np.inf
        under, over = (self.at(x, np.where(np.isfinite(end), np.maximum(end, bottom), np.nan)) for end in (low, high))
        known = np.flatnonzero(np.isfinite(under + over).all(axis=1))
        outlines = [np.full((1, 2), np.nan)]
        for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
            if len(run) > 1:
                outlines += [under[run], over[run][::-1], outlines[0]]
        self.drawing.add(Area(np.concatenate(outlines[1:] or outlines), color, alpha, self.box, name))

    def rings(self, x: Floats, y: Floats, *, color: str, radius: float, **look: Any) -> None:
        """Draw discs at ``x``, ``y`` in ``color``, whole where they touch the panel; circles where they have a width.

        ``x`` and ``y`` are (discs,) in the units of the axes, ``radius`` is in points of type, ``look`` are further
        fields of :class:`Rings`.
        """
        places, (left, bottom, wide, high), by = self.at(x, y), self.box, radius / 72
        near = (np.abs(places - (left + wide / 2, bottom + high / 2)) <= (wide / 2 + by, high / 2 + by)).all(axis=1)
        values = (np.asarray(x, dtype=float)[near], np.asarray(y, dtype=float)[near])
        self.drawing.add(Rings(places[near], radius, color, values=values, **look))

    def pixel_edges(self) -> tuple[Floats, Floats]:
        """Edges (columns + 1,) and (rows + 1,), in the units of x and y, of the pixels of a map over the panel."""
        rows, columns = pixels_of(self.box, self.drawing.dpi)
        if self.inches is None:
            return np.linspace(*self.x, columns + 1), np.linspace(*self.y, rows + 1)
        (left, bottom, width, height), back = self.box, self.inches.inverted()
        x = np.column_stack([np.linspace(left, left + width, columns + 1), np.full(columns + 1, bottom)])
        y = np.column_stack([np.full(rows + 1, left), np.linspace(bottom, bottom + height, rows + 1)])
        return back.transform(x)[:, 0], back.transform(y)[:, 1]

    def note(self, text: str, *, at_in: float | None = None) -> None:
        """``text`` on a white ground in the middle of the panel, or at the height ``at_in`` inches in the drawing."""
        (left, bottom, width, height), half = self.box, text_width_in(text, NORMAL) / 2 + 0.05
        x, y = left + width / 2, bottom + height / 2 if at_in is None else at_in
        self.drawing.add(Stroke(np.array([[x - half, y], [x + half, y]]), "#ffffff", 14.0))
        self.drawing.add(Words(x, y, text, NORMAL, FAINT, along="centre", across="centre"))

    def frame(self, *, whole: bool = False) -> None:
        """Left and bottom edges, or all four where ``whole``."""
        left, bottom, width, height = self.box
        right, top = left + width, bottom + height
        self._edge((left, top), (left, bottom), (right, bottom), *([(right, top), (left, top)] if whole else []))

    def _edge(self, *corners: tuple[float, float], color: str = FAINT, width: float = 0.8) -> None:
        self.drawing.add(Stroke(np.array(corners), color, width, square=True))

    def x_axis(
        self,
        label: str = "",
        *,
        most: int = 8,
        places: Floats | None = None,
        whole: bool = False,
        named: bool = True,
        grid: bool = True,
    ) -> None:
        """Draw ticks below at ``places`` (ticks,), or at most ``most`` round ones, ``whole`` numbers or not.

        ``places`` are in the unit of the axis, which ``label`` names; ticks are ``named`` or bare, with a ``grid`` or
        without.
        """
        left, bottom, width, height = self.box
        places = linear_ticks(*self.x, most=most, whole=whole) if places is None else places
        for (x, _), text in zip(self.at(places, np.full(len(places), self.y[1])), linear_texts(places), strict=True):
            if grid:
                self._edge((x, bottom), (x, bottom + height), color=GRID, width=0.6)
            self._edge((x, bottom), (x, bottom - _TICK_IN))
            if named:
                low = bottom - _TICK_IN - _PAD_IN
                self.drawing.add(Words(x, low, text, TICK_SIZE, along="centre", across="top", name="tick"))
        if label:
            self.drawing.add(Words(left + width / 2, bottom - 0.36, label, NORMAL, along="centre", name="x label"))

    def y_axis(
        self,
        label: str = "",
        *,
        most: int = 7,
        places: Sequence[float] | None = None,
        grid: bool = True,
        right: bool = False,
        at_in: float | None = None,
    ) -> None:
        """Draw ticks beside the panel at ``places`` or at most ``most`` round ones, with a ``grid``, and ``label``.

        ``places`` are in the unit of the axis; ``right`` puts them on that side; ``at_in`` is the distance [inches] of
        the last line of ``label`` from the panel, where it does not stand next to the texts of the ticks.
        """
        left, bottom, width, height = self.box
        ticks = log_ticks if self.log_y else linear_ticks
        marks = ticks(*self.y, most=most) if places is None else np.asarray(places, dtype=float)
        texts = [decade_text(float(mark)) for mark in marks] if self.log_y else linear_texts(marks)
        edge, out = (left + width, 1) if right else (left, -1)
        for (_, y), text in zip(self.at(np.full(len(marks), self.x[1]), marks), texts, strict=True):
            if grid:
                self._edge((left, y), (left + width, y), color=GRID, width=0.6)
            self._edge((edge, y), (edge + out * _TICK_IN, y))
            x = edge + out * (_TICK_IN + _PAD_IN)
            words = Words(x, y, text, TICK_SIZE, along="left" if right else "right", across="centre", name="tick")
            self.drawing.add(words)
        widest = max((text_width_in(text, TICK_SIZE) for text in texts), default=0.0)
        gap = at_in if at_in is not None else _TICK_IN + 2 * _PAD_IN + widest + 0.03
        for number, line in enumerate(lines := label.split("\n") if label else []):
            x = edge + gap + 0.12 + number * _LINE_IN if right else edge - gap - (len(lines) - 1 - number) * _LINE_IN
            self.drawing.add(Words(x, bottom + height / 2, line, NORMAL, along="centre", upward=True, name="y label"))


def linear_ticks(low: float, high: float, *, most: int, whole: bool = False) -> Floats:
    """Round places (ticks,) from ``low`` to ``high``, in their unit, at most ``most`` + 1; integers where ``whole``."""
    raw = max((high - low) / max(most, 1), 1.0 if whole else 1e-300)
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(s for s in _STEPS if s * size >= raw * (1 - 1e-9) and not (whole and (s * size) % 1)) * size
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.asarray(np.arange(first, last + 1) * step, dtype=np.float64)


def linear_texts(places: Floats) -> list[str]:
    """Texts of evenly spaced ``places`` (ticks,): decimals that tell them apart, powers of ten far off 1."""
    if not len(places):
        return []
    step = float(places[1] - places[0]) if len(places) > 1 else abs(float(places[0])) or 1.0
    largest = float(np.abs(places).max())
    if step >= 1e5 or largest < 1e-4:
        return [f"{value:.3g}".replace("-", "−") for value in places]
    decimals = next((n for n in range(8) if abs(step * 10**n - round(step * 10**n)) < 1e-6), 8)
    return [f"{value:.{decimals}f}".replace("-", "−") if value else f"{0:.{decimals}f}" for value in places]


def log_ticks(low: float, high: float, *, most: int) -> Floats:
    """Decades (ticks,) from ``low`` to ``high``, above 0 and in their unit; 2 and 5 between where they are few.

    At most ``most`` decades are given.
    """
    decades = np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    stride = max(1, math.ceil(math.log10(high / low) / most))
    places = np.outer(10.0 ** decades[decades % stride == 0], log_steps(low, high)).ravel()
    return places[(places >= low * (1 - 1e-9)) & (places <= high * (1 + 1e-9))]


def log_steps(low: float, high: float) -> tuple[float, ...]:
    """Multiples of a decade that have ticks on a logarithmic axis from ``low`` to ``high``, above 0 and in one unit."""
    return (1.0, 2.0, 5.0) if math.log10(high / low) < _FEW_DECADES else (1.0,)


def log_limits(values: Floats, decades: float, *, room: float) -> tuple[float, float] | None:
    """Ends of a logarithmic axis for the positive ones of ``values`` (any shape), in their unit; None without any.

    The upper end is a factor ``room`` above the largest, the lower one at most ``decades`` below it.
    """
    positive = values[np.isfinite(values) & (values > 0)]
    if not len(positive):
        return None
    top, quiet = float(positive.max()), float(np.quantile(positive, 0.01))
    return max(quiet / 2, top * 10**-decades), min(room * top, 1e307)


def decade_text(value: float) -> str:
    """Tick text of a logarithmic axis: plain from 0.001 to 5000, else as 2·10⁻⁵; ``value`` > 0, in any unit."""
    exponent = int(np.floor(np.log10(value) + 1e-9))
    if -3 <= exponent <= 3:
        return f"{value:g}"
    mantissa = f"{value / 10.0**exponent:.0f}·"
    return ("" if mantissa == "1·" else mantissa) + "10" + str(exponent).translate(_RAISED)
