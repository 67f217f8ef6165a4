"""A picture as a list of what is drawn, in inches from its lower left corner; matplotlib draws it when it is asked for.

The layout is settled here, before a renderer is there: labels are spread by the widths of their texts, and tests read
what lies where.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from crankorder.findings import Findings
from crankorder.plot.palette import CAP_HEIGHT, FAINT, INK, LARGE, NORMAL, shortened, text_width_in
from crankorder.quantities import Floats, Ints

Box = tuple[float, float, float, float]
"""Left, bottom, width and height in inches."""

_BASELINE = {"baseline": 0.0, "centre": CAP_HEIGHT / 2, "top": CAP_HEIGHT}
_ALONG = {"left": 0.0, "centre": 0.5, "right": 1.0}
_DESCENT = 0.236  # of DejaVu Sans, in sizes of the type


@dataclass(frozen=True)
class Stroke:
    """A line in inches, broken at NaN; ``values`` are what it stands for, in the units of its axes."""

    points: Floats
    color: str
    width: float
    dashes: tuple[float, float] = (0.0, 0.0)
    alpha: float = 1.0
    within: Box | None = None
    square: bool = False
    name: str = ""
    values: tuple[Floats, Floats] | None = None


@dataclass(frozen=True)
class Area:
    """The area between two curves over the same places along, in inches; nothing where one is NaN."""

    along: Floats
    low: Floats
    high: Floats
    color: str
    alpha: float = 1.0
    within: Box | None = None
    name: str = ""


@dataclass(frozen=True)
class Rings:
    """Circles around points in inches; radius and line in points of type, full discs where ``width`` is 0."""

    points: Floats
    radius: float
    color: str
    width: float = 0.0
    alpha: float = 1.0
    within: Box | None = None
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
        """Where its baseline begins."""
        back = _ALONG[self.along] * text_width_in(self.text, self.size, bold=self.bold) if self.along != "left" else 0.0
        drop = _BASELINE[self.across] * self.size / 72
        return (self.x + drop, self.y - back) if self.upward else (self.x - back, self.y - drop)

    @property
    def box(self) -> Box:
        """Room that it takes."""
        (x, y), em = self.start, self.size / 72
        width, height = text_width_in(self.text, self.size, bold=self.bold), (CAP_HEIGHT + _DESCENT) * em
        return (x - CAP_HEIGHT * em, y, height, width) if self.upward else (x, y - _DESCENT * em, width, height)


@dataclass(frozen=True)
class Field:
    """Colours (rows from the top, columns, 3) over a box in inches; as many pixels as the box has, or repeated."""

    rgb: NDArray[np.uint8]
    box: Box


@dataclass
class Drawing:
    """A picture of ``width_in`` by ``height_in`` inches; what is added later lies on top."""

    width_in: float
    height_in: float
    parts: list[Stroke | Area | Rings | Words | Field] = field(default_factory=list)

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
    room = drawing.width_in - left_in - 0.2
    heading = shortened(title, LARGE, room, bold=True)
    drawing.add(Words(left_in, drawing.height_in - 0.34, heading, LARGE, bold=True))
    if sentence:
        said = shortened(sentence, NORMAL, room)
        drawing.add(Words(left_in, drawing.height_in - 0.56, said, NORMAL, FAINT, name="subtitle"))


def quality_text(findings: Findings) -> str:
    """How many suspect or bad data the ``findings`` carry, in words; empty without any."""
    doubtful = sum(flag.severity in ("suspect", "bad") for flag in findings.quality)
    return f"{doubtful} quality remark{'s' if doubtful > 1 else ''}: see the report" if doubtful else ""


def whole(places: Floats) -> Ints:
    """Whole pixels of ``places`` in pixels, a half upwards, as matplotlib snaps lines to them."""
    return np.asarray(np.floor(places + 0.5), dtype=np.int64)


def pixels_of(box: Box, dpi: float) -> tuple[int, int]:
    """Rows and columns that a :class:`Field` over ``box`` has at ``dpi``."""
    left, right, bottom, top = whole(dpi * np.array([box[0], box[0] + box[2], box[1], box[1] + box[3]]))
    return int(top - bottom), int(right - left)
