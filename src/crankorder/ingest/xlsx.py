"""XLSX workbooks: the first sheet as a table with names in its first row."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.errors import CrankorderError, EnvironmentFailure, InputError
from crankorder.ingest.rawfile import Contents, RawFile, Source, check_budget, named
from crankorder.ingest.units import unit_in_label
from crankorder.settings import IngestSettings


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns (float64) that ``sources`` ask for, by name or number from 0, from the first sheet of ``path``.

    ``settings`` give the byte limit. Raises InputError naming row and cell for a cell that is no number, and
    EnvironmentFailure where the package openpyxl is missing.
    """
    with _first_sheet(path, settings) as sheet:
        rows = sheet.iter_rows(values_only=True)
        names = _names(next(rows, ()), path)
        positions = [names.index(named(source, names, path)) for source in sources]
        cells = [tuple(row[position] if position < len(row) else None for position in positions) for row in rows]
    while cells and all(cell is None for cell in cells[-1]):
        cells.pop()  # formatted but empty rows below the data
    block = np.empty((len(positions), len(cells)))
    for number, row in enumerate(cells):
        for index, cell in enumerate(row):
            if isinstance(cell, bool) or not isinstance(cell, (int, float)):
                raise InputError(
                    "an empty cell" if cell is None else "not a number",
                    file=path,
                    place=f"row {number + 2}, column {positions[index]} ({names[positions[index]]})",
                    found="" if cell is None else repr(cell),
                    remedy="Mend the cell, or leave the recording out",
                )
        block[:, number] = row
    units = {source: unit_in_label(names[position]) for source, position in zip(sources, positions, strict=True)}
    return RawFile(
        columns=dict(zip(sources, block, strict=True)), units={source: unit for source, unit in units.items() if unit}
    )


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names and units of the columns of the first sheet of the workbook at ``path``; reads its first row only.

    ``settings`` give the byte limit. Raises what :func:`read` raises.
    """
    with _first_sheet(path, settings) as sheet:
        names = _names(next(sheet.iter_rows(values_only=True), ()), path)
    return Contents(format="XLSX", names=names, units={name: unit for name in names if (unit := unit_in_label(name))})


@contextmanager
def _first_sheet(path: Path, settings: IngestSettings) -> Iterator[Any]:
    try:
        import openpyxl
    except ImportError:
        raise EnvironmentFailure(
            "reading XLSX needs the package openpyxl", file=path, remedy="Install it with: pip install crankorder[xlsx]"
        ) from None
    try:
        with zipfile.ZipFile(path) as archive:
            check_budget(sum(item.file_size for item in archive.infolist()), path, max_bytes=settings.max_bytes)
        book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
        try:
            if not book.worksheets:
                raise InputError("the workbook has no sheet with cells", file=path)
            yield book.worksheets[0]
        finally:
            book.close()
    except (CrankorderError, MemoryError):
        raise
    except Exception as error:  # openpyxl lets through whatever zip, XML and its own parsers raise
        raise InputError(
            "is a damaged XLSX workbook", file=path, found=error, remedy="Copy it again, or save it as text"
        ) from None


def _names(row: Sequence[object], path: Path) -> tuple[str, ...]:
    names = ["" if cell is None else str(cell).strip() for cell in row]
    while names and not names[-1]:
        names.pop()
    if not names:
        raise InputError(
            "the first row is empty", file=path, place="row 1", remedy="Put the names of the columns there"
        )
    named_all = tuple(name or str(number) for number, name in enumerate(names))
    if len(set(named_all)) < len(named_all):
        twice = next(name for name in named_all if named_all.count(name) > 1)
        raise InputError("two columns have the same name", file=path, place="row 1", found=repr(twice))
    return named_all
