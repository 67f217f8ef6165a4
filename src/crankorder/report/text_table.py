"""Tables and paragraphs of plain text for a terminal: aligned, and never wider than a page of it."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterable, Sequence

from crankorder.errors import printable
from crankorder.plot.reading import number_text

WIDTH = 100
"""Columns of the widest line."""

DIGITS = 5
"""Significant digits of a number in a table: what a scale or a drawing can give."""

MISSING = "–"
_GAP, _INDENT, _LONGEST_CELL = "  ", "  ", 44

Cell = float | str | None


def paragraph(text: str, *, bullet: str = "") -> list[str]:
    """Lines of ``text``, folded at the width of the page; from the second on they stand under the ``bullet``'s text."""
    return textwrap.wrap(
        printable(text, 4000), WIDTH, initial_indent=bullet, subsequent_indent=" " * len(bullet), break_on_hyphens=False
    )


def text_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[Cell]], *, kept: int = 1) -> list[str]:
    """Lines of a table, none where it has no rows: title, heads, rows; numbers stand with their points in one column.

    ``title`` over the table. ``heads`` of the columns, units in them. ``rows`` of numbers, texts and None, which is
    shown as a dash; rows and columns of None alone are left out. ``kept`` first columns that name a row: where the
    table is wider than the page they are repeated, with the other columns below one another.
    """
    filled = [list(row) for row in rows if any(cell is not None for cell in row[kept:])]
    if not filled:
        return []
    used = [n for n in range(len(heads)) if n < kept or any(row[n] is not None for row in filled)]
    columns = [_column(heads[n], [row[n] for row in filled]) for n in used]
    names, values = columns[:kept], columns[kept:]
    lines = paragraph(title)
    room = WIDTH - len(_INDENT) - sum(len(column[0]) + len(_GAP) for column in names)
    for block in _blocks(values, room):
        lines += [(_INDENT + _GAP.join(cells)).rstrip() for cells in zip(*names, *block, strict=True)]
    return [*lines, ""]


def _column(head: str, cells: Sequence[Cell]) -> list[str]:
    """Head and cells of a column, all of one width: texts from the left, numbers by their points."""
    texts = [MISSING if cell is None else _cell_text(cell) for cell in cells]
    if all(isinstance(cell, str) for cell in cells):
        width = max(len(head), *map(len, texts))
        return [text.ljust(width) for text in (head, *texts)]
    pairs = list(zip(texts, cells, strict=True))
    most = max(_after_point(text) for text, cell in pairs if not isinstance(cell, str))
    lined = [text if isinstance(cell, str) else text + " " * (most - _after_point(text)) for text, cell in pairs]
    width = max(len(head), *map(len, lined))
    return [text.rjust(width) for text in (head, *lined)]


def _cell_text(cell: float | str) -> str:
    return printable(cell, _LONGEST_CELL) if isinstance(cell, str) else short_number(float(cell))


def short_number(value: float, *, digits: int = DIGITS) -> str:
    """``value`` to at most ``digits`` significant digits, without the zeros that end it."""
    text = number_text(value, digits=digits)
    return text if "." not in text or "e" in text else text.rstrip("0").rstrip(".")


def _after_point(text: str) -> int:
    """Characters from the point on."""
    return len(text) - text.index(".") if "." in text else 0


def _blocks(columns: Sequence[list[str]], room: int) -> list[list[list[str]]]:
    """Columns in groups that each fit into ``room`` characters, in order."""
    blocks: list[list[list[str]]] = []
    used = room + 1
    for column in columns:
        width = len(column[0]) + len(_GAP)
        if used + width > room + len(_GAP) or not blocks:
            blocks.append([])
            used = 0
        blocks[-1].append(column)
        used += width
    return blocks


def closing(head: str, sentences: Iterable[str], notes: Collection[str]) -> list[str]:
    """Lines with ``sentences`` under ``head``, then ``notes`` where there are any."""
    lines = [head]
    for sentence in sentences:
        lines += paragraph(sentence, bullet="  * ")
    if notes:
        lines += ["", "Notes"]
    for note in notes:
        lines += paragraph(note, bullet="  * ")
    return lines
