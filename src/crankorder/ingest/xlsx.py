"""XLSX workbooks: the first sheet as a table, whose names stand above its first row of numbers."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.errors import InputError
from crankorder.ingest.child import in_child, package
from crankorder.ingest.rawfile import Contents, RawFile, Source, check_budget, names_of
from crankorder.ingest.text import names_and_units
from crankorder.settings import IngestSettings

_BANNER_ROWS = 50
_UNPACKED = 10  # bytes of numbers for each byte of a workbook, as a rule at most

Row = list[Any]


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns (float64) that ``sources`` ask for, by name or number from 0, from the first sheet of ``path``.

    ``settings`` give the byte limit. Raises InputError naming row and cell for a cell that is no number, and
    EnvironmentFailure where the package python-calamine is missing, UnsafeInputError where it goes beyond its limits.
    """
    parser = _parser()

    def parse() -> RawFile:
        rows = _rows(parser, path, settings)
        names, units, first, n_above = _header(rows)
        wanted = names_of(sources, names, path)
        positions = [names.index(name) for name in wanted.values()]
        cells = [[row[position] for position in positions] for row in chain([] if first is None else [first], rows)]
        while cells and all(cell == "" for cell in cells[-1]):
            cells.pop()  # formatted but empty rows below the data
        for number, values in enumerate(cells, start=n_above + 1):
            for position, cell in zip(positions, values, strict=True):
                if not _is_number(cell):
                    problem, found = ("an empty cell", "") if cell == "" else ("not a number", repr(cell))
                    place = f"row {number}, column {position} ({names[position]})"
                    raise InputError(
                        problem, place=place, found=found, remedy="Mend the cell, or leave the recording out"
                    )
        block = np.ascontiguousarray(np.array(cells, dtype=np.float64).reshape(-1, len(positions)).T)
        return Contents("XLSX", names, units=units).with_columns(wanted, block)

    return in_child(parse, path, n_bytes=_UNPACKED * path.stat().st_size)


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names and units of the columns of the first sheet of the workbook at ``path``.

    ``settings`` give the byte limit. Raises what :func:`read` raises.
    """
    parser = _parser()

    def look() -> Contents:
        names, units, _, _ = _header(_rows(parser, path, settings))
        return Contents(format="XLSX", names=names, units=units)

    return in_child(look, path, n_bytes=_UNPACKED * path.stat().st_size)


def _parser() -> Any:
    module = package("python_calamine", "XLSX", "Install it with: pip install crankorder[xlsx]")
    return module.CalamineWorkbook


def _rows(parser: Any, path: Path, settings: IngestSettings) -> Iterator[Row]:
    """Values of the rows of the first sheet, "" for an empty cell.

    What the archive claims to hold is checked against ``settings`` before it is unpacked; a claim of rows beyond the
    last that a sheet can have takes more memory than the process has.
    """
    with zipfile.ZipFile(path) as archive:
        check_budget(sum(item.file_size for item in archive.infolist()), settings)
    sheet = parser.from_path(path).get_sheet_by_index(0)
    if sheet.start is None:
        return
    for row in sheet.iter_rows():
        yield [""] * sheet.start[1] + row


def _header(
    rows: Iterator[Row],
) -> tuple[tuple[str, ...], dict[str, str], Row | None, int]:
    """Names and units of the columns, the first row of numbers, and how many rows stand above it.

    Titles and notes above the names are passed over. ``rows`` are taken up to the first of numbers, None where there is
    none in the first rows: then their first one holds the names.
    """
    above: list[list[str]] = []
    first: Row | None = None
    for row in islice(rows, _BANNER_ROWS):
        cells = _filled(row)
        if len(cells) and all(map(_is_number, cells)):
            first = row
            break
        above.append([str(cell).strip() for cell in cells])
    width = max((len(row) for row in above[:1]), default=0) if first is None else len(_filled(first))
    named_rows = [row for row in (above[:1] if first is None else above) if len(row) == width]
    if not width or (above and not named_rows):
        remedy = "Put the names of the columns into the row above the numbers"
        raise InputError("no row names the columns", place=f"rows 1 to {len(above) or 1}", remedy=remedy)
    names, units = names_and_units(named_rows, width)
    return names, units, first, len(above)


def _filled(row: Row) -> Row:
    """Cells of ``row`` up to the last that is not empty."""
    n_cells = max((place + 1 for place, cell in enumerate(row) if cell != ""), default=0)
    return row[:n_cells]


def _is_number(cell: object) -> bool:
    return isinstance(cell, (int, float)) and not isinstance(cell, bool)
