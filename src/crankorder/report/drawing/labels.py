"""Labels at the edges of a diagram that never overlap, each tied to its place by a leader."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crankorder.plot.spreading import spread
from crankorder.report.drawing.drawn import Drawing, Words
from crankorder.report.drawing.palette import SMALL
from crankorder.report.drawing.typeface import text_width_in

GAP_IN = 0.05
LINE_HEIGHT_IN = 0.125


@dataclass(frozen=True)
class EdgeLabel:
    """A text that belongs to a place on an edge: ``target_in`` inches along it; ``""`` keeps room for a leader only."""

    target_in: float
    text: str
    color: str
    key: int = 0
    bold: bool = False


def label_width_in(label: EdgeLabel, size: float) -> float:
    """Room in inches that ``label`` needs at ``size`` points."""
    return text_width_in(label.text, size, bold=label.bold) + GAP_IN


def fitted(labels: Sequence[EdgeLabel], length_in: float, *, size: float = SMALL) -> list[EdgeLabel]:
    """Those of ``labels`` that fit side by side into ``length_in`` inches at ``size`` points.

    First the unit is left out of the texts, then labels one by one where they stand closest together.
    """
    kept = sorted(labels, key=lambda label: label.target_in)

    def needed() -> float:
        return sum(label_width_in(label, size) for label in kept)

    if needed() > length_in:
        kept = [replace(label, text=label.text.removesuffix(" Hz")) for label in kept]
    while len(kept) > 1 and needed() > length_in:
        closest = int(np.argmin(np.diff([label.target_in for label in kept])))
        del kept[closest + 1]
    return kept


def _leader(drawing: Drawing, points_in: Sequence[tuple[float, float]], color: str) -> None:
    drawing.line(points_in, color=color, width=0.7, alpha=0.85)


def label_top(
    drawing: Drawing,
    box_in: tuple[float, float, float, float],
    tiers: Sequence[Sequence[EdgeLabel]],
    *,
    size: float = SMALL,
) -> list[float]:
    """Heights in inches of the labels above a diagram: one per tier that is not empty, then the top of all.

    Leaders of the upper tiers pass between the labels of the lower ones.

    ``drawing`` to draw on; ``box_in`` left, bottom, width and height of the diagram in inches; ``tiers`` labels from
    the lowest tier up, targets in inches from the drawing's left; ``size`` of the text in points.
    """
    left, bottom, width, height = box_in
    level, lines = bottom + height, []
    waiting = [[label for label in tier if label.text] for tier in tiers]
    at = {(row, number): label.target_in for row, tier in enumerate(waiting) for number, label in enumerate(tier)}
    for row, tier in enumerate(waiting):
        if not tier:
            continue
        through = [key for key in at if key[0] >= row]
        through.sort(key=lambda key: at[key])
        widths = [label_width_in(waiting[key[0]][key[1]], size) if key[0] == row else GAP_IN for key in through]
        places = spread([at[key] for key in through], widths, low=left - 0.15, high=left + width + 0.15)
        fan, text_at = level + 0.11, level + 0.11 + LINE_HEIGHT_IN
        for key, place in zip(through, places, strict=True):
            label = waiting[key[0]][key[1]]
            points = [(at[key], level), (at[key], level + 0.03), (float(place), fan)]
            if key[0] == row:
                drawing.add(
                    Words(float(place), fan + 0.025, label.text, size, label.color, label.bold, "centre",
                          name=f"label-{label.key}")
                )  # fmt: skip
            else:
                points.append((float(place), text_at))
            _leader(drawing, points, label.color)
            at[key] = float(place)
        level = text_at
        lines.append(fan + 0.025)
    return [*lines, level]


def label_right(
    drawing: Drawing, box_in: tuple[float, float, float, float], labels: Sequence[EdgeLabel], *, size: float = SMALL
) -> None:
    """Labels right of a diagram, each with a leader from its place on the right edge.

    ``drawing`` to draw on; ``box_in`` left, bottom, width, height of the diagram in inches; ``labels`` with targets in
    inches from the drawing's bottom; ``size`` of the text in points.
    """
    left, bottom, width, height = box_in
    ordered = sorted(labels, key=lambda label: label.target_in)
    room = [LINE_HEIGHT_IN * size / SMALL] * len(ordered)
    places = spread([label.target_in for label in ordered], room, low=bottom - 0.05, high=bottom + height + 0.05)
    edge = left + width
    for label, place in zip(ordered, places, strict=True):
        bend = (edge + 0.03, label.target_in)
        _leader(drawing, [(edge, label.target_in), bend, (edge + 0.12, float(place))], label.color)
        drawing.add(
            Words(edge + 0.15, float(place), label.text, size, label.color, label.bold, "left", "centre",
                  name=f"label-{label.key}")
        )  # fmt: skip
