"""What matplotlib draws anew for the limits that its axes have, however they are zoomed or resized.

Labels beyond an edge that never overlap, each tied to its place by a leader; maps of whole pixels, in which nothing
thin is blurred or dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox, IdentityTransform

from crankorder.plot.cells import pooled
from crankorder.plot.labels import spread
from crankorder.plot.palette import FAINT, NOT_MEASURED, SMALL, level_colours
from crankorder.quantities import Floats

TIER_PT = 20.0
"""Height of one row of labels above the axes with its leaders, in points."""

_FAN_PT, _STEM_PT, _GAP_PT, _LINE_PT = 8.0, 2.0, 4.0, 10.0
_OUT_PT = 10.0  # from the right edge to a label


@dataclass(frozen=True)
class EdgeLabel:
    """A text that belongs to the place (x, y), in data; the order of ``rank`` says which stay where room is short."""

    place: tuple[float, float]
    text: str
    color: str
    bold: bool = False
    rank: float = 0.0


Find = Callable[[Axes], Sequence[Sequence[EdgeLabel]]]
"""Rows of labels, the nearest to the axes first, for the limits that the axes have when they are drawn."""


class EdgeLabels(Artist):
    """Labels along one ``side`` of the axes, with a caption where there are any; :attr:`texts` are those last laid."""

    def __init__(self, axes: Axes, find: Find, *, side: Literal["top", "right"], caption: str = "") -> None:
        super().__init__()
        self._home, self._find, self._side, self._caption = axes, find, side, caption
        self.texts: list[Text] = []
        self._leaders: list[Line2D] = []
        self.set_zorder(5)
        axes.add_artist(self)
        self.set_clip_on(False)

    def lay_out(self, renderer: Any) -> None:
        """Make :attr:`texts` and their leaders anew, for the limits and the size that the axes now have.

        ``renderer`` measures the texts.
        """
        self.texts, self._leaders = [], []
        self._px = float(renderer.points_to_pixels(1.0))
        rows = [list(row) for row in self._find(self._home)]
        if self._side == "top":
            self._lay_above(renderer, rows)
        else:
            self._lay_beside(renderer, [label for row in rows for label in row])

    def draw(self, renderer: Any) -> None:
        """Lay out and draw on ``renderer``."""
        if not self.get_visible():
            return
        self.lay_out(renderer)
        for artist in (*self._leaders, *self.texts):
            artist.draw(renderer)
        self.stale = False

    def get_window_extent(self, renderer: Any = None) -> Bbox:
        """Box of all texts in pixels of ``renderer``; that of the axes where there are none."""
        renderer = renderer or self.get_figure().canvas.get_renderer()  # type: ignore[union-attr]
        self.lay_out(renderer)
        boxes = [text.get_window_extent(renderer) for text in self.texts]
        return Bbox.union(boxes) if boxes else Bbox(self._home.bbox.get_points())

    def get_tightbbox(self, renderer: Any = None) -> Bbox:
        """Box of all texts in pixels of ``renderer``, for layouts that make room."""
        return self.get_window_extent(renderer)

    def _pixels(self, label: EdgeLabel) -> tuple[float, float]:
        x, y = self._home.transData.transform(label.place)
        return float(x), float(y)

    def _text(self, x: float, y: float, text: str, color: str, **look: Any) -> Text:
        made = Text(x, y, text, color=color, fontsize=SMALL, parse_math=False, transform=IdentityTransform(), **look)
        made.set_figure(self._home.get_figure())  # type: ignore[arg-type]
        return made

    def _leader(self, points: Sequence[tuple[float, float]], color: str, *, alpha: float = 0.85) -> None:
        x, y = zip(*points, strict=True)
        made = Line2D(x, y, color=color, linewidth=0.7, alpha=alpha, transform=IdentityTransform())
        made.set_figure(self._home.get_figure())  # type: ignore[arg-type]
        self._leaders.append(made)

    def _fitted(self, labels: Sequence[EdgeLabel], rooms: Sequence[float], length: float) -> list[int]:
        """Numbers of the labels that fit side by side into ``length`` pixels: the lowest in rank give way."""
        kept = sorted(range(len(labels)), key=lambda number: -labels[number].rank)
        while len(kept) > 1 and sum(rooms[number] for number in kept) > length:
            kept.pop()
        return sorted(kept)

    def _lay_above(self, renderer: Any, rows: list[list[EdgeLabel]]) -> None:
        px, box = self._px, self._home.bbox
        level = float(box.y1)
        waiting: list[list[tuple[float, EdgeLabel, Text, float]]] = []
        for row in rows:
            row = sorted(row, key=lambda label: self._pixels(label)[0])
            texts = [self._text(0, 0, one.text, one.color, weight="bold" if one.bold else "normal", ha="center")
                     for one in row]  # fmt: skip
            rooms = [float(text.get_window_extent(renderer).width) + _GAP_PT * px for text in texts]
            kept = self._fitted(row, rooms, 0.9 * box.width)
            waiting.append([(self._pixels(row[n])[0], row[n], texts[n], rooms[n]) for n in kept])
        at = {(r, n): item[0] for r, row_ in enumerate(waiting) for n, item in enumerate(row_)}
        for r, items in enumerate(waiting):
            if not items:
                continue
            through = sorted((key for key in at if key[0] >= r), key=lambda key: at[key])
            rooms = [items[key[1]][3] if key[0] == r else _GAP_PT * px for key in through]
            places = spread([at[key] for key in through], rooms, low=box.x0 - 8 * px, high=box.x1 + 8 * px)
            for key, place in zip(through, places, strict=True):
                _, label, text, _ = waiting[key[0]][key[1]]
                points = [(at[key], level), (at[key], level + _STEM_PT * px), (float(place), level + _FAN_PT * px)]
                if key[0] == r:
                    text.set_position((float(place), level + (_FAN_PT + 2) * px))
                    self.texts.append(text)
                else:
                    points.append((float(place), level + TIER_PT * px))
                self._leader(points, label.color)
                at[key] = float(place)
            if r == 0 and self._caption:
                place_x = min(float(box.x0), float(places[0]) - rooms[0] / 2) - 5 * px
                y = level + (_FAN_PT + 2) * px
                self.texts.append(self._text(place_x, y, self._caption, FAINT, ha="right"))
            level += TIER_PT * px

    def _lay_beside(self, renderer: Any, labels: list[EdgeLabel]) -> None:
        px, box = self._px, self._home.bbox
        kept = self._fitted(labels, [_LINE_PT * px] * len(labels), float(box.height) + 0.1 * px)
        labels = sorted((labels[number] for number in kept), key=lambda label: self._pixels(label)[1])
        heights = [min(max(self._pixels(label)[1], float(box.y0)), float(box.y1)) for label in labels]
        rooms = [_LINE_PT * px] * len(labels)
        places = spread(heights, rooms, low=float(box.y0) - 5 * px, high=float(box.y1) + 5 * px)
        edge, top = float(box.x1), float(box.y0)
        for label, height, place in zip(labels, heights, places, strict=True):
            start = min(self._pixels(label)[0], edge)
            if start < edge - px:
                self._leader([(start, height), (edge, height)], label.color, alpha=0.3)
            bend = [(edge, height), (edge + 2 * px, height), (edge + (_OUT_PT - 2) * px, float(place))]
            self._leader(bend, label.color)
            weight = "bold" if label.bold else "normal"
            look = {"ha": "left", "va": "center_baseline", "weight": weight}
            self.texts.append(self._text(edge + _OUT_PT * px, float(place), label.text, label.color, **look))
            top = max(top, float(place) + 0.5 * _LINE_PT * px)
        if labels and self._caption:
            self.texts.append(self._text(edge + 2 * px, top + 2 * px, self._caption, FAINT, ha="left", va="bottom"))


def label_ends(
    axes: Axes,
    lines: Sequence[tuple[Floats, Floats, str, str, float]],
    *,
    caption: str = "",
) -> None:
    """Name ``lines`` (x, y, text, colour, rank) where they leave ``axes`` at the right, ``caption`` above the names."""

    def at_the_ends(axes: Axes) -> list[list[EdgeLabel]]:
        left, right = sorted(axes.get_xlim())
        labels = []
        for x, y, text, color, rank in lines:
            inside = np.flatnonzero((x >= left) & (x <= right) & np.isfinite(y) & (y > 0))
            if len(inside):
                place = float(x[inside[-1]]), float(y[inside[-1]])
                labels.append(EdgeLabel(place, text, color, rank=rank))
        return [labels]

    EdgeLabels(axes, at_the_ends, side="right", caption=caption)


def label_orders(axes: Axes, marks: Sequence[tuple[float, str, float]], color: str) -> None:
    """Name ``marks`` (order, text, rank) above ``axes`` in ``color``, where each cannot meet another."""

    def above(axes: Axes) -> list[list[EdgeLabel]]:
        (left, right), high = sorted(axes.get_xlim()), max(axes.get_ylim())
        inside = [mark for mark in marks if left <= mark[0] <= right]
        return [[EdgeLabel((order, high), text, color, rank=rank) for order, text, rank in inside]]

    EdgeLabels(axes, above, side="top", caption="order")


class LevelImage(AxesImage):
    """Levels over cells of any width. However far one zooms in or out, no thin line is lost and no cell is blurred."""

    def __init__(
        self,
        axes: Axes,
        level: Floats,
        edges: tuple[Floats, Floats],
        limits: tuple[float, float],
    ) -> None:
        x, y = edges
        colours = ListedColormap(level_colours() / 255).with_extremes(bad=NOT_MEASURED)
        super().__init__(axes, cmap=colours, norm=Normalize(*limits), extent=(x[0], x[-1], y[0], y[-1]))
        self._level = np.where(np.isnan(level), -np.inf, level)
        self._x, self._y = x, y
        self.set_data(np.ma.masked_invalid(level))
        self.set_clip_path(axes.patch)
        axes.add_image(self)

    def _check_unsampled_image(self) -> bool:
        return False

    def make_image(self, renderer: Any, magnification: float = 1.0, unsampled: bool = False) -> tuple[Any, ...]:
        """Pixels (rows, columns, 4) for ``renderer`` at ``magnification``, their corner, and no transform.

        ``unsampled`` is not for cells of unlike widths.
        """
        corners = np.asarray(self.axes.bbox.extents) * magnification
        left, bottom, right, top = (corners + 0.5).astype(int) / magnification
        columns, rows = round((right - left) * magnification), round((top - bottom) * magnification)
        if columns < 1 or rows < 1:
            return None, left, bottom, IdentityTransform()
        back = self.axes.transData.inverted()
        across = np.linspace(left, right, columns + 1)
        upward = np.linspace(bottom, top, rows + 1)
        x = back.transform(np.column_stack([across, np.full(columns + 1, bottom)]))[:, 0]
        y = back.transform(np.column_stack([np.full(rows + 1, left), upward]))[:, 1]
        shown = pooled(pooled(self._level, self._x, x, axis=1), self._y, y, axis=0)
        return self.to_rgba(np.ma.masked_invalid(shown), bytes=True), left, bottom, IdentityTransform()

    def get_cursor_data(self, event: Any) -> float | None:
        """Level in dB under the mouse at ``event``; None outside."""
        row = int(np.searchsorted(self._y, event.ydata)) - 1
        column = int(np.searchsorted(self._x, event.xdata)) - 1
        inside = 0 <= row < self._level.shape[0] and 0 <= column < self._level.shape[1]
        return float(self._level[row, column]) if inside and np.isfinite(self._level[row, column]) else None
