"""XLSX workbooks: the first sheet as a table, whose names stand above its first row of numbers."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.errors import CrankorderError, InputError, UnsafeInputError
from crankorder.ingest.child import in_child, package
from crankorder.ingest.rawfile import Contents, RawFile, Source, check_budget, names_of
from crankorder.ingest.text import names_and_units
from crankorder.settings import IngestSettings

_BANNER_ROWS = 50
_MOST_ROWS = 1_048_576
"""Rows of a sheet, by the standard of the format (ECMA-376)."""
_UNPACKED = 10  # bytes of numbers for each byte of a workbook, as a rule at most


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns (float64) that ``sources`` ask for, by name or number from 0, from the first sheet of ``path``.

    ``settings`` give the byte limit. Raises InputError naming row and cell for a cell that is no number, and
    EnvironmentFailure where the package openpyxl is missing, UnsafeInputError where it goes beyond its limits.
    """
    openpyxl, n_bytes = _parser(), _UNPACKED * path.stat().st_size
    return in_child(lambda: _read(openpyxl, path, sources, settings), path, n_bytes=n_bytes)


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names and units of the columns of the first sheet of the workbook at ``path``; reads what stands above it only.

    ``settings`` give the byte limit. Raises what :func:`read` raises.
    """
    openpyxl = _parser()

    def look() -> Contents:
        with _first_sheet(openpyxl, path, settings) as sheet:
            names, units, _, _ = _header(_rows(sheet))
        return Contents(format="XLSX", names=names, units=units)

    return in_child(look, path, n_bytes=path.stat().st_size)


def _parser() -> Any:
    return package("openpyxl", "XLSX", "Install it with: pip install crankorder[xlsx]")


def _read(openpyxl: Any, path: Path, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    with _first_sheet(openpyxl, path, settings) as sheet:
        rows = _rows(sheet)
        names, units, first, n_above = _header(rows)
        wanted = names_of(sources, names, path)
        positions = [names.index(name) for name in wanted.values()]
        below = chain([] if first is None else [first], rows)
        cells: list[tuple[Any, ...]] = [
            tuple(row[position] if position < len(row) else None for position in positions) for row in below
        ]
    while cells and all(cell is None for cell in cells[-1]):
        cells.pop()  # formatted but empty rows below the data
    block = np.empty((len(positions), len(cells)))
    for number, values in enumerate(cells):
        for index, cell in enumerate(values):
            if isinstance(cell, bool) or not isinstance(cell, (int, float)):
                problem, found = ("an empty cell", "") if cell is None else ("not a number", repr(cell))
                place = f"row {number + n_above + 1}, column {positions[index]} ({names[positions[index]]})"
                remedy = "Mend the cell, or leave the recording out"
                raise InputError(problem, place=place, found=found, remedy=remedy)
        block[:, number] = values
    return Contents("XLSX", names, units=units).with_columns(wanted, block)


def _rows(sheet: Any) -> Iterator[tuple[object, ...]]:
    """Values of the rows of ``sheet``; refused where it claims more than a sheet can have: they would be filled."""
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > _MOST_ROWS:
            raise UnsafeInputError("claims a row beyond the last that a sheet can have", allowed=f"{_MOST_ROWS} rows")
        yield row


@contextmanager
def _first_sheet(openpyxl: Any, path: Path, settings: IngestSettings) -> Iterator[Any]:
    try:
        with zipfile.ZipFile(path) as archive:
            check_budget(sum(item.file_size for item in archive.infolist()), settings)
        book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
        try:
            if not book.worksheets:
                raise InputError("the workbook has no sheet with cells")
            yield book.worksheets[0]
        finally:
            book.close()
    except (CrankorderError, MemoryError):
        raise
    except Exception as error:  # openpyxl lets through whatever zip, XML and its own parsers raise
        raise InputError(
            "is a damaged XLSX workbook", found=error, remedy="Copy it again, or save it as text"
        ) from None


def _header(
    rows: Iterator[tuple[object, ...]],
) -> tuple[tuple[str, ...], dict[str, str], tuple[object, ...] | None, int]:
    """Names and units of the columns, the first row of numbers, and how many rows stand above it.

    Titles and notes above the names are passed over. ``rows`` are taken up to the first of numbers, None where there is
    none in the first rows: then their first one holds the names.
    """
    above: list[list[str]] = []
    first: tuple[object, ...] | None = None
    for row in islice(rows, _BANNER_ROWS):
        cells = _filled(row)
        if len(cells) and all(isinstance(cell, (int, float)) and not isinstance(cell, bool) for cell in cells):
            first = row
            break
        above.append(["" if cell is None else str(cell).strip() for cell in cells])
    width = max((len(row) for row in above[:1]), default=0) if first is None else len(_filled(first))
    named_rows = [row for row in (above[:1] if first is None else above) if len(row) == width]
    if not width or (above and not named_rows):
        remedy = "Put the names of the columns into the row above the numbers"
        raise InputError("no row names the columns", place=f"rows 1 to {len(above) or 1}", remedy=remedy)
    names, units = names_and_units(named_rows, width)
    return names, units, first, len(above)


def _filled(row: tuple[object, ...]) -> list[object]:
    """Cells of ``row`` up to the last that is not empty."""
    cells = list(row)
    while cells and (cells[-1] is None or cells[-1] == ""):
        cells.pop()
    return cells
