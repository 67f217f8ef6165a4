"""A picture as a list of what is drawn, in inches from its lower left corner; its pixels come last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from crankorder.findings import Findings
from crankorder.report.drawing.canvas import Canvas, Clip
from crankorder.report.drawing.palette import FAINT, INK, LARGE, MAINS, NORMAL, SMALL, rgb_of
from crankorder.report.drawing.typeface import CAP_HEIGHT, LAYOUT_DPI, shortened, text_width_in

Box = tuple[float, float, float, float]
"""Left, bottom, width and height in inches."""

_BASELINE = {"baseline": 0.0, "centre": CAP_HEIGHT / 2, "top": CAP_HEIGHT}
_ALONG = {"left": 0.0, "centre": 0.5, "right": 1.0}
_DESCENT = 0.236  # of DejaVu Sans, in sizes of the type


@dataclass(frozen=True)
class Stroke:
    """A line in inches, broken at NaN; ``values`` are what it stands for, in the units of its axes."""

    points: NDArray[np.float64]
    color: str
    width: float
    dashes: tuple[float, float] = (0.0, 0.0)
    alpha: float = 1.0
    within: Box | None = None
    square: bool = False
    name: str = ""
    values: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def draw(self, canvas: Canvas, dpi: float) -> None:
        """Draw it on ``canvas`` at ``dpi``; a ``square`` one (upright or level) on whole pixels."""
        width = self.width * dpi / 72
        places = _pixels(self.points, canvas, dpi)
        clip = _clip(self.within, canvas, dpi)
        if self.square:
            width = max(1.0, float(np.rint(width)))
            if not self.dashes[0]:
                canvas.rectangle(_around(places, int(width)), rgb=rgb_of(self.color), alpha=self.alpha, clip=clip)
                return
            places = np.floor(places) + 0.5 if width % 2 else np.rint(places)
        if self.dashes[0]:
            places = _dashed(places, self.dashes[0] * width, self.dashes[1] * width)
        canvas.stroke(places, width=width, rgb=rgb_of(self.color), alpha=self.alpha, clip=clip)


@dataclass(frozen=True)
class Area:
    """The area between two curves over the same places along, in inches."""

    along: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    color: str
    alpha: float = 1.0
    within: Box | None = None
    name: str = ""

    def draw(self, canvas: Canvas, dpi: float) -> None:
        """Draw it on ``canvas`` at ``dpi`` pixels per inch."""
        rows = canvas.pixels.shape[0]
        canvas.area(
            self.along * dpi, rows - self.high * dpi, rows - self.low * dpi,
            rgb=rgb_of(self.color), alpha=self.alpha, clip=_clip(self.within, canvas, dpi),
        )  # fmt: skip


@dataclass(frozen=True)
class Rings:
    """Circles around points in inches; radius and line in points of type, full discs where ``width`` is 0."""

    points: NDArray[np.float64]
    radius: float
    color: str
    width: float = 0.0
    alpha: float = 1.0
    within: Box | None = None
    name: str = ""
    values: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def draw(self, canvas: Canvas, dpi: float) -> None:
        """Draw them on ``canvas`` at ``dpi`` pixels per inch."""
        canvas.rings(
            _pixels(self.points, canvas, dpi), radius=self.radius * dpi / 72, width=self.width * dpi / 72,
            rgb=rgb_of(self.color), alpha=self.alpha, clip=_clip(self.within, canvas, dpi),
        )  # fmt: skip


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
    def box(self) -> Box:
        """Room that it takes."""
        width, em = text_width_in(self.text, self.size, bold=self.bold), self.size / 72
        start, base = -_ALONG[self.along] * width, -_BASELINE[self.across] * em
        if self.upward:
            return self.x - base - CAP_HEIGHT * em, self.y + start, (CAP_HEIGHT + _DESCENT) * em, width
        return self.x + start, self.y + base - _DESCENT * em, width, (CAP_HEIGHT + _DESCENT) * em

    def draw(self, canvas: Canvas, dpi: float) -> None:
        """Write it on ``canvas`` at ``dpi`` pixels per inch."""
        size = self.size * dpi / 72
        start = -_ALONG[self.along] * text_width_in(self.text, self.size * dpi / LAYOUT_DPI, bold=self.bold)
        start *= LAYOUT_DPI  # pixels
        drop = _BASELINE[self.across] * size
        x, y = self.x * dpi, canvas.pixels.shape[0] - self.y * dpi
        x, y = (x + drop, y - start) if self.upward else (x + start, y + drop)
        canvas.text(self.text, x, y, size_px=size, rgb=rgb_of(self.color), bold=self.bold, upward=self.upward)


@dataclass(frozen=True)
class Field:
    """Colours (rows from the top, columns, 3) over a box in inches; as many pixels as the box has, or repeated."""

    rgb: NDArray[np.uint8]
    box: Box

    def draw(self, canvas: Canvas, dpi: float) -> None:
        """Set its pixels on ``canvas`` at ``dpi`` pixels per inch."""
        left, top, right, bottom = _edges(self.box, canvas, dpi)
        rows, columns = bottom - top, right - left
        block = self.rgb
        if block.shape[:2] != (rows, columns):
            take = [np.arange(n) * have // n for n, have in zip((rows, columns), block.shape[:2], strict=True)]
            block = block[take[0][:, None], take[1][None, :]]
        canvas.image(block, left, top)


@dataclass
class Drawing:
    """A picture of ``width_in`` by ``height_in`` inches; what is added later lies on top."""

    width_in: float
    height_in: float
    parts: list[Stroke | Area | Rings | Words | Field] = field(default_factory=list)

    def add(self, part: Stroke | Area | Rings | Words | Field) -> None:
        """Lay ``part`` on top."""
        self.parts.append(part)

    def line(self, points: Sequence[tuple[float, float]], *, color: str, width: float, alpha: float = 1.0) -> None:
        """Lay a line through ``points`` on top: ``color``, ``width`` in points, opacity ``alpha``."""
        self.add(Stroke(np.array(points, dtype=float), color, width, alpha=alpha))

    @property
    def words(self) -> list[Words]:
        """All texts."""
        return [part for part in self.parts if isinstance(part, Words)]

    def strokes(self, prefix: str) -> list[Stroke]:
        """Lines whose names begin with ``prefix``."""
        return [part for part in self.parts if isinstance(part, Stroke) and part.name.startswith(prefix)]

    def png(self, *, dpi: int) -> bytes:
        """PNG at ``dpi`` pixels per inch, the same bytes for the same picture."""
        canvas = Canvas(round(self.width_in * dpi), round(self.height_in * dpi))
        for part in self.parts:
            part.draw(canvas, dpi)
        return canvas.png(dpi=dpi)


def title_lines(drawing: Drawing, left_in: float, title: str, sentence: str) -> None:
    """Bold ``title`` and a ``sentence`` under it, from ``left_in`` inches at the top of ``drawing``, cut to fit."""
    room = drawing.width_in - left_in - 0.2
    heading = shortened(title, LARGE, room, bold=True)
    drawing.add(Words(left_in, drawing.height_in - 0.34, heading, LARGE, bold=True))
    if sentence:
        drawing.add(
            Words(left_in, drawing.height_in - 0.56, shortened(sentence, NORMAL, room), NORMAL, FAINT, name="subtitle")
        )


def quality_note(drawing: Drawing, findings: Findings) -> None:
    """Note at the foot of ``drawing`` when the ``findings`` carry suspect or bad data."""
    doubtful = sum(flag.severity in ("suspect", "bad") for flag in findings.quality)
    if doubtful:
        text = f"{doubtful} quality remark{'s' if doubtful > 1 else ''}: see the report"
        drawing.add(Words(drawing.width_in - 0.2, 0.14, text, SMALL + 0.5, MAINS, along="right"))


def pixels_of(box: Box, drawing: Drawing, dpi: int) -> tuple[int, int]:
    """Rows and columns that a :class:`Field` over ``box`` of ``drawing`` has at ``dpi``."""
    height = round(drawing.height_in * dpi)
    top, bottom = height - round((box[1] + box[3]) * dpi), height - round(box[1] * dpi)
    return bottom - top, round((box[0] + box[2]) * dpi) - round(box[0] * dpi)


def _edges(box: Box, canvas: Canvas, dpi: float) -> Clip:
    height = canvas.pixels.shape[0]
    left, bottom, right, top = box[0], box[1], box[0] + box[2], box[1] + box[3]
    return round(left * dpi), height - round(top * dpi), round(right * dpi), height - round(bottom * dpi)


def _around(places: NDArray[np.float64], width: int) -> Clip:
    """Whole pixels of an upright or level line between two ``places``, ``width`` pixels thick."""
    (x0, y0), (x1, y1) = np.minimum(*places), np.maximum(*places)
    half = width // 2
    if x1 - x0 < y1 - y0:
        left = int(np.floor(x0)) - half
        return left, int(np.floor(y0)), left + width, int(np.floor(y1)) + 1
    top = int(np.floor(y0)) - half
    return int(np.floor(x0)), top, int(np.floor(x1)) + 1, top + width


def _clip(within: Box | None, canvas: Canvas, dpi: float) -> Clip | None:
    return None if within is None else _edges(within, canvas, dpi)


def _pixels(points: NDArray[np.float64], canvas: Canvas, dpi: float) -> NDArray[np.float64]:
    places = np.asarray(points, dtype=float) * dpi
    places[:, 1] = canvas.pixels.shape[0] - places[:, 1]
    return np.asarray(places)


def _dashed(points: NDArray[np.float64], on: float, off: float) -> NDArray[np.float64]:
    """A line of ``points`` cut into dashes ``on`` long with gaps of ``off``, as one line broken at NaN."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    starts = np.arange(0.0, along[-1], on + off)
    ends = np.minimum(starts + on, along[-1])
    places = np.stack([starts, ends, np.full_like(starts, np.nan)], axis=1).ravel()
    kept = np.concatenate([[True], steps > 0])
    return np.stack([np.interp(places, along[kept], points[kept, axis]) for axis in (0, 1)], axis=1)
