"""Labels at the edges of a diagram that never overlap, each tied to its place; its head, keys, and marks of lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crankorder.findings import Findings, ModeFinding
from crankorder.plot import palette
from crankorder.plot.drawing import SOLID, Box, Dashes, Drawing, Panel, Rings, Stroke, Words, title_lines
from crankorder.plot.reading import frequency_text, is_tone, is_undecided
from crankorder.quantities import Floats

GAP_IN = 0.05
LINE_HEIGHT_IN = 0.125
_KEY_SIZE = palette.SMALL + 0.5
_SAMPLE_IN, _GAP_IN, _BETWEEN_IN = 0.3, 0.08, 0.24
_UP_IN, _DOWN_IN = 0.15, 0.06  # of the first and the second of two rows


@dataclass(frozen=True)
class EdgeLabel:
    """A text that belongs to a place on an edge: ``target_in`` inches along it; ``""`` keeps room for a leader only."""

    target_in: float
    text: str
    color: str
    key: int = 0
    bold: bool = False


def label_width_in(label: EdgeLabel) -> float:
    """Room in inches that ``label`` needs."""
    return palette.text_width_in(label.text, palette.SMALL, bold=label.bold) + GAP_IN


def fitted(labels: Sequence[EdgeLabel], length_in: float) -> list[EdgeLabel]:
    """Those of ``labels`` that fit side by side into ``length_in`` inches.

    First the unit is left out of the texts, then labels one by one where they stand closest together.
    """
    kept = sorted(labels, key=lambda label: label.target_in)
    if sum(map(label_width_in, kept)) > length_in:
        kept = [replace(label, text=label.text.removesuffix(" Hz")) for label in kept]
    while len(kept) > 1 and sum(map(label_width_in, kept)) > length_in:
        del kept[np.argmin(np.diff([label.target_in for label in kept])) + 1]
    return kept


def _words(label: EdgeLabel, x: float, y: float, **placed: Any) -> Words:
    return Words(x, y, label.text, palette.SMALL, label.color, label.bold, name=f"label-{label.key}", **placed)


def _leader(drawing: Drawing, points_in: Sequence[tuple[float, float]], color: str) -> None:
    drawing.add(Stroke(np.array(points_in, dtype=float), color, 0.7, alpha=0.85))


def label_top(drawing: Drawing, box_in: Box, tiers: Sequence[Sequence[EdgeLabel]]) -> list[float]:
    """Heights in inches of the labels above a diagram: one per tier that is not empty, then the top of all.

    Leaders of the upper tiers pass between the labels of the lower ones.

    They are drawn on ``drawing``; ``box_in`` is left, bottom, width and height of the diagram in inches; ``tiers`` are
    the labels from the lowest tier up, with targets in inches from the left of the drawing.
    """
    left, bottom, width, height = box_in
    level, lines = bottom + height, []
    waiting = [(row, label.target_in, label) for row, tier in enumerate(tiers) for label in tier if label.text]
    for row in sorted({row for row, *_ in waiting}):
        waiting = sorted((each for each in waiting if each[0] >= row), key=lambda each: each[1])
        widths = [label_width_in(label) if tier == row else GAP_IN for tier, _, label in waiting]
        targets = [target for _, target, _ in waiting]
        places = spread(targets, widths, low=left - 0.15, high=left + width + 0.15).tolist()
        fan, text_at = level + 0.11, level + 0.11 + LINE_HEIGHT_IN
        for (tier, target, label), place in zip(waiting, places, strict=True):
            points = [(target, level), (target, level + 0.03), (place, fan)]
            if tier == row:
                drawing.add(_words(label, place, fan + 0.025, along="centre"))
            else:
                points.append((place, text_at))
            _leader(drawing, points, label.color)
        waiting = [(tier, place, label) for (tier, _, label), place in zip(waiting, places, strict=True)]
        level = text_at
        lines.append(fan + 0.025)
    return [*lines, level]


def label_right(drawing: Drawing, box_in: Box, labels: Sequence[EdgeLabel]) -> None:
    """Draw labels right of a diagram, each with a leader from its place on the right edge.

    They are drawn on ``drawing``; ``box_in`` is left, bottom, width, height of the diagram in inches; ``labels`` have
    targets in inches from the bottom of the drawing.
    """
    left, bottom, width, height = box_in
    ordered, edge = sorted(labels, key=lambda label: label.target_in), left + width
    targets, heights = [label.target_in for label in ordered], [LINE_HEIGHT_IN] * len(ordered)
    places = spread(targets, heights, low=bottom - 0.05, high=bottom + height + 0.05).tolist()
    for label, target, place in zip(ordered, targets, places, strict=True):
        _leader(drawing, [(edge, target), (edge + 0.03, target), (edge + 0.12, place)], label.color)
        drawing.add(_words(label, edge + 0.15, place, across="centre"))


def spread(targets: Sequence[float], widths: Sequence[float], *, low: float, high: float) -> Floats:
    """Centres (labels,) nearest to their targets (least squares) without overlap, in the same sequence.

    ``targets`` (labels,) are the wanted centres, rising, ``widths`` (labels,) the room that each needs, ``low`` and
    ``high`` the ends of the edge, all in one unit. Where there is not enough room, all get equal shares of the edge.
    Source: isotonic regression by pooling adjacent violators (Ayer et al. 1955).
    """
    width = np.asarray(widths, dtype=float)
    offset = np.cumsum(width) - width / 2
    if width.sum() >= high - low:
        return np.asarray(low + offset * (high - low) / max(float(width.sum()), 1e-12))
    blocks: list[tuple[float, int]] = []
    for value in np.asarray(targets, dtype=float) - offset:
        mean, count = float(value), 1
        while blocks and blocks[-1][0] > mean:
            before, n = blocks.pop()
            mean, count = (before * n + mean * count) / (n + count), n + count
        blocks.append((mean, count))
    starts = np.repeat([mean for mean, _ in blocks], [count for _, count in blocks]) if blocks else np.empty(0)
    return np.asarray(np.clip(starts, low, high - width.sum()) + offset)


def head_of_test(
    drawing: Drawing, left_in: float, findings: Findings, what: str, sentence: str, *, longest: int
) -> None:
    """Write the title of ``drawing``: the test of ``findings`` and ``what`` is shown, with a ``sentence`` below.

    It begins at ``left_in`` inches; the name of the test is cut at ``longest`` characters. The number of doubts in the
    findings stands at the foot.
    """
    test = palette.drawable(findings.test, longest)
    name = palette.shortened(test, palette.LARGE, 0.62 * drawing.width_in, bold=True)
    title_lines(drawing, left_in, f"{name} · {what}", sentence)
    if doubtful := sum(flag.severity in ("suspect", "bad") for flag in findings.quality):
        doubts = f"{doubtful} quality remark{'s' * (doubtful > 1)}: see the report"
        drawing.add(Words(drawing.width_in - 0.2, 0.14, doubts, palette.SMALL + 0.5, palette.MAINS, along="right"))


@dataclass(frozen=True)
class Key:
    """A meaning and the line (or ``ring``) that has it."""

    text: str
    color: str
    dashes: Dashes = SOLID
    ring: bool = False
    width: float = 1.2


def draw_keys(
    drawing: Drawing, left_in: float, keys: list[Key], *, room_in: float = np.inf, base_in: float = 0.16, most: int = 2
) -> None:
    """Draw ``keys`` side by side at the foot of ``drawing``, from ``left_in`` inches; in ``most`` rows if need be.

    ``room_in`` is the width in inches that a row may take, ``base_in`` the height in inches of the first baseline.
    """
    rows: list[list[tuple[Key, float]]] = [[]]
    used = 0.0
    for key in keys:
        width = _SAMPLE_IN + _GAP_IN + palette.text_width_in(key.text, _KEY_SIZE) + _BETWEEN_IN
        if rows[-1] and used + width - _BETWEEN_IN > room_in and len(rows) < most:
            rows, used = [*rows, []], 0.0
        rows[-1].append((key, left_in + used))
        used += width
    for number, row in enumerate(rows):
        down = number and _DOWN_IN + (number - 1) * (_UP_IN + _DOWN_IN)
        base = base_in - down if number or len(rows) == 1 else base_in + _UP_IN
        middle = base + palette.CAP_HEIGHT / 2 * _KEY_SIZE / 72
        for key, x in row:
            if key.ring:
                drawing.add(Rings(np.array([[x + _SAMPLE_IN / 2, middle]]), 4.0, key.color, width=1.4))
            else:
                ends = np.array([[x, middle], [x + _SAMPLE_IN, middle]])
                drawing.add(Stroke(ends, key.color, key.width, key.dashes, square=True))
            drawing.add(Words(x + _SAMPLE_IN + _GAP_IN, base, key.text, _KEY_SIZE, palette.INK))


Mark = tuple[float, str, str]
"""Place along the axis, text and colour of what is named above a diagram."""


def edge_labels(panel: Panel, marks: Sequence[Mark]) -> list[EdgeLabel]:
    """Labels of those of ``marks`` that lie within ``panel``."""
    return [
        EdgeLabel(float(panel.at(place, panel.y[0])[0, 0]), text, color, number)
        for number, (place, text, color) in enumerate(marks)
        if panel.x[0] <= place <= panel.x[1]
    ]


def label_column(panel: Panel, marks: list[Mark], caption: str, above: Sequence[Mark] = ()) -> None:
    """Write ``marks`` (place, text, colour) over the first ``panel`` of a column, and those ``above`` over them.

    ``caption`` stands before them and says what the marks are.
    """
    tiers = [edge_labels(panel, tier) for tier in (marks, above)]
    lines = label_top(panel.drawing, panel.box, [fitted(labels, panel.box[2]) for labels in tiers])
    if tiers[0] and caption:
        panel.drawing.add(Words(panel.box[0] - 0.25, lines[0], caption, palette.SMALL, palette.LINES[1], along="right"))


def mode_style(mode: ModeFinding) -> tuple[str, str, str, Dashes]:
    """Kind, colour, colour over a map and dashes of the line of a ``mode``: tone, doubt or natural frequency."""
    if is_tone(mode):
        return "tone", palette.MAINS, palette.MAINS_ON_MAP, palette.TONE_DASHES
    kind, dashes = ("doubt", palette.DOUBT_DASHES) if is_undecided(mode) else ("mode", palette.MODE_DASHES)
    return kind, palette.MODE, palette.MODE_ON_MAP, dashes


def mode_text(mode: ModeFinding) -> str:
    """Label of a ``mode``: its frequency, with a question mark where it is not decided."""
    return f"{frequency_text(mode.frequency_hz)}{'?' * is_undecided(mode)} Hz"


def mode_marks(modes: list[ModeFinding]) -> list[Mark]:
    """Frequency, label and colour of each of ``modes``, for the edge of a diagram."""
    return [(mode.frequency_hz, mode_text(mode), mode_style(mode)[1]) for mode in modes]


def mode_keys(modes: list[ModeFinding]) -> list[Key]:
    """Legend of the dashed and dotted lines of ``modes``: natural frequencies, doubts, tones."""
    kinds = {mode_style(mode)[0] for mode in modes}
    tones = {"mains" if mode.kinds == ("mains",) else "fixed tone" for mode in modes if is_tone(mode)}
    keys = [Key("natural frequency", palette.MODE, palette.MODE_DASHES)] * ("mode" in kinds)
    keys += [Key("not decided", palette.MODE, palette.DOUBT_DASHES)] * ("doubt" in kinds)
    return keys + [Key(" or ".join(sorted(tones, reverse=True)), palette.MAINS, palette.TONE_DASHES)] * bool(tones)
