"""A picture as a list of what is drawn, in inches from its lower left corner; matplotlib draws it when it is asked for.

The layout is settled here, before a renderer is there: labels are spread by the widths of their texts, and tests read
what lies where.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from crankorder.findings import Findings
from crankorder.plot.palette import CAP_HEIGHT, FAINT, INK, LARGE, MAINS, NORMAL, SMALL, shortened, text_width_in
from crankorder.settings import PictureFormat

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

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

    def artists(self, figure: Figure) -> Iterator[Artist]:
        """The line for ``figure``; a ``square`` one (upright or level) lies on whole pixels."""
        from matplotlib.lines import Line2D

        from crankorder.plot.whole_pixels import PixelLine

        yield (PixelLine if self.square else Line2D)(
            self.points[:, 0], self.points[:, 1], color=self.color, alpha=self.alpha, linewidth=self.width,
            linestyle=(0.0, self.dashes) if self.dashes[0] else "-", dash_capstyle="butt",
            snap=self.square, solid_capstyle="butt" if self.square else "round", solid_joinstyle="round",
            **_placed(figure, self.within),
        )  # fmt: skip


@dataclass(frozen=True)
class Area:
    """The area between two curves over the same places along, in inches; nothing where one is NaN."""

    along: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    color: str
    alpha: float = 1.0
    within: Box | None = None
    name: str = ""

    def artists(self, figure: Figure) -> Iterator[Artist]:
        """One patch for ``figure`` for each run of places where both curves are known."""
        from matplotlib.patches import Polygon

        known = np.isfinite(self.along) & np.isfinite(self.low) & np.isfinite(self.high)
        low, high = (np.column_stack([self.along, edge]) for edge in (self.low, self.high))
        for run in np.split(np.flatnonzero(known), np.flatnonzero(np.diff(np.flatnonzero(known)) > 1) + 1):
            if len(run) > 1:
                outline = np.concatenate([low[run], high[run][::-1]])
                yield Polygon(
                    outline, closed=True, facecolor=self.color, edgecolor="none", alpha=self.alpha,
                    **_placed(figure, self.within),
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

    def artists(self, figure: Figure) -> Iterator[Artist]:
        """The circles for ``figure``."""
        from matplotlib.lines import Line2D

        yield Line2D(
            self.points[:, 0], self.points[:, 1], linestyle="none", marker="o", markersize=2 * self.radius,
            markeredgewidth=self.width, markeredgecolor=self.color, alpha=self.alpha,
            markerfacecolor="none" if self.width else self.color, **_placed(figure, self.within),
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

    def artists(self, figure: Figure) -> Iterator[Artist]:
        """The text for ``figure``, by its baseline."""
        from matplotlib.text import Text

        drop = _BASELINE[self.across] * self.size / 72
        yield Text(
            self.x + drop * self.upward, self.y - drop * (not self.upward), self.text, color=self.color,
            fontsize=self.size, fontweight="bold" if self.bold else "normal",
            horizontalalignment="center" if self.along == "centre" else self.along, verticalalignment="baseline",
            rotation=90.0 if self.upward else 0.0, rotation_mode="anchor", parse_math=False, **_placed(figure, None),
        )  # fmt: skip


@dataclass(frozen=True)
class Field:
    """Colours (rows from the top, columns, 3) over a box in inches; as many pixels as the box has, or repeated."""

    rgb: NDArray[np.uint8]
    box: Box

    def artists(self, figure: Figure) -> Iterator[Artist]:
        """The image for ``figure``, from whole pixel to whole pixel."""
        from crankorder.plot.whole_pixels import PixelImage

        yield PixelImage(self.rgb, self.box)


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

    def figure(self) -> Figure:
        """The picture as a figure of matplotlib."""
        from crankorder.plot.style import new_figure

        figure = new_figure(self.width_in, self.height_in)
        for number, part in enumerate(self.parts):
            for artist in part.artists(figure):
                artist.set_zorder(number)
                figure.add_artist(artist)
        return figure


def _placed(figure: Figure, within: Box | None) -> dict[str, Any]:
    """Properties of an artist of ``figure`` whose places are inches, cut off beyond ``within``."""
    from matplotlib.transforms import Bbox, TransformedBbox

    inches = figure.dpi_scale_trans
    clip = None if within is None else TransformedBbox(Bbox.from_bounds(*within), inches)
    return {"transform": inches, "clip_box": clip, "clip_on": clip is not None}


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


def quality_note(drawing: Drawing, findings: Findings) -> None:
    """Note at the foot of ``drawing`` when the ``findings`` carry suspect or bad data."""
    text = quality_text(findings)
    if text:
        drawing.add(Words(drawing.width_in - 0.2, 0.14, text, SMALL + 0.5, MAINS, along="right"))


def whole(places: NDArray[np.float64]) -> NDArray[np.int64]:
    """Whole pixels of ``places`` in pixels, a half upwards, as matplotlib snaps lines to them."""
    return np.asarray(np.floor(places + 0.5), dtype=np.int64)


def pixels_of(box: Box, dpi: float) -> tuple[int, int]:
    """Rows and columns that a :class:`Field` over ``box`` has at ``dpi``."""
    left, right, bottom, top = whole(dpi * np.array([box[0], box[0] + box[2], box[1], box[1] + box[3]]))
    return int(top - bottom), int(right - left)


def picture_bytes(figure: Drawing | Figure, *, dpi: int, kind: PictureFormat = "png") -> bytes:
    """Bytes of a picture, the same for the same figure (no date, fixed software name).

    ``figure`` of the house or of matplotlib; ``dpi`` pixels per inch; ``kind`` of file.
    """
    from crankorder.plot.style import house_style

    buffer = BytesIO()
    with house_style():
        drawn = figure.figure() if isinstance(figure, Drawing) else figure
        if kind == "png":
            drawn.savefig(
                buffer, format="png", dpi=dpi, metadata={"Software": "crankorder"}, pil_kwargs={"compress_level": 4}
            )
        else:
            dated = "Date" if kind == "svg" else "CreationDate"
            drawn.savefig(buffer, format=kind, dpi=dpi, metadata={"Creator": "crankorder", dated: None})
    return buffer.getvalue()
