"""A table of the page: its head, its rows of text, and what is folded away under it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

_SHOWN = 40  # rows of a table that a page shows at once …
_FOLDED = 400  # … and that it holds folded away; the files hold all


class Column(TypedDict):
    """Head of a column and whether it holds numbers."""

    title: str
    number: bool


class Bar(TypedDict):
    """Stacked bar of length 100: its ``name`` and its parts with their ``kind``, ``start`` and ``width``."""

    name: str
    parts: list[dict[str, str]]


class Table(TypedDict):
    """One table of the page; ``more`` is folded away under it, ``beside`` stands open under it, ``bars`` above it."""

    title: str
    note: str
    empty: str
    columns: list[Column]
    rows: list[list[str]]
    more: Table | None
    beside: Table | None
    bars: list[Bar]


def table_of(
    title: str,
    heads: str,
    rows: list[list[str]],
    *,
    empty: str,
    note: str = "",
    more: Table | None = None,
    beside: Table | None = None,
    bars: Sequence[Bar] = (),
) -> Table:
    """Table ``title`` with ``heads`` separated by ``|``; a head that ends in ``#`` is a column of numbers.

    ``rows`` of text, of which a page holds the first 400; ``empty`` stands in their place where there are none;
    ``note`` stands above; ``more`` is folded away; ``beside`` follows; ``bars`` show shares.
    """
    columns = [
        Column(title=head.strip().removesuffix("#"), number=head.strip().endswith("#")) for head in heads.split("|")
    ]
    if len(rows) > _FOLDED:
        note = f"{note} The first {_FOLDED} of {len(rows)}; findings.json holds all.".strip()
    return Table(
        title=title, note=note, empty=empty, columns=columns, rows=rows[:_FOLDED], more=more, beside=beside,
        bars=list(bars),
    )  # fmt: skip


def folded(title: str, heads: str, rows: list[list[str]], *, empty: str, note: str = "") -> Table:
    """Table of the first rows where there are many, all of them folded away under it.

    ``title``, ``heads``, ``rows``, ``empty`` and ``note`` as for :func:`table_of`; what matters most comes first.
    """
    if len(rows) <= _SHOWN:
        return table_of(title, heads, rows, empty=empty, note=note)
    everything = table_of(f"All {len(rows)} rows", heads, rows, empty="")
    said = f"{note} The {_SHOWN} strongest of {len(rows)}; the others are folded away below.".strip()
    return table_of(title, heads, rows[:_SHOWN], empty=empty, note=said, more=everything)
