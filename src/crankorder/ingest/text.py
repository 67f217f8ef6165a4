"""Tables of numbers with names above: text and the first sheet of XLSX workbooks.

In text comma, semicolon, tab or blanks stand between columns, decimals follow a point or a comma, comments stand above.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.ingest.child import in_child, package
from crankorder.ingest.rawfile import Contents, FloatArray, RawFile, Source, check_budget, distinct, flag, names_of
from crankorder.ingest.units import known_unit, unit_in_label
from crankorder.quantities import QualityFlag, Severity
from crankorder.scratch import empty
from crankorder.settings import IngestSettings

_HEAD_BYTES = 65_536
PIECE_BYTES, PIECE_LINES = 1 << 22, 1 << 16
"""So much of a table is read at a time."""

NUMBER = re.compile(
    r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?|[+-]?(?:nan|inf|infinity)", re.IGNORECASE
)
"""A number as text, decimals after a point."""
# an empty cell becomes NaN too, and is then looked for: pandas says the same of lines that end with a separator
_NAN_WORDS = ("", "nan", "NaN", "NAN", "Nan")
_RATE = re.compile(
    r"\b(?:sample_?freq|sampling_frequency|sample_?rate|sampling_?rate|rate_hz|fs)(?:_hz)?[\"']?\s*[:=]\s*([0-9.eE+]{1,20})\s*(k?Hz)?",
    re.IGNORECASE,
)
_SEPARATORS = "\t;, "
_MEND_CELL = "Mend the cell, or leave the recording out"


class _Layout(NamedTuple):
    encoding: str
    separator: str
    decimal_comma: bool
    names: tuple[str, ...]
    units: dict[str, str]
    n_head_lines: int
    rate_hz: float | None


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns (float64) that ``sources`` ask for, by name or number from 0, from the text table at ``path``.

    ``settings`` give the byte limit. Raises InputError with line and cell where lines are ragged or cells no number.
    """
    check_budget(path.stat().st_size, settings)
    layout = _layout_of(path)
    rates = {} if layout.rate_hz is None else dict.fromkeys(layout.names, layout.rate_hz)
    stated = Contents("text", layout.names, units=layout.units, rates_hz=rates)
    names = names_of(sources, layout.names, path)
    if not names:
        return stated.with_columns({}, ())
    positions = [layout.names.index(name) for name in names.values()]
    block = _columns_at(positions, path, layout, on_disk=path.stat().st_size > settings.in_memory_bytes)
    flags = last_line_flags(path)
    if layout.decimal_comma:
        flags.insert(0, flag(path, "decimal_comma", "info", "decimals are written after a comma"))
    return stated.with_columns(names, block, flags=flags)


def encoding_of(head: bytes) -> str:
    """UTF-8 where the whole lines of the ``head`` of a text are that, else Latin-1."""
    try:
        head[: head.rfind(b"\n") + 1 or None].decode("utf-8-sig")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _layout_of(path: Path) -> _Layout:
    with path.open("rb") as stream:
        raw = stream.read(_HEAD_BYTES)
    encoding = encoding_of(raw)
    # a multi-byte character may be cut at the end of the head
    lines = (raw if encoding == "latin-1" else raw[: raw.rfind(b"\n") + 1 or None]).decode(encoding).splitlines()
    if len(raw) == _HEAD_BYTES:
        lines = lines[:-1]
    for number, line in enumerate(lines):
        if not _is_comment(line) and (found := _separation(line)):
            separator, decimal_comma = found
            names, units = _header(lines[:number], separator, len(_fields(line, separator)))
            rate_hz = _rate_in("\n".join(filter(_is_comment, lines[:number])))
            return _Layout(encoding, separator, decimal_comma, names, units, number, rate_hz)
    shown = next((line for line in lines if not _is_comment(line)), "")
    problem = "no line of numbers in the first 64 kB: no table of samples"
    remedy = "Export the recording as columns of numbers"
    raise InputError(problem, found=repr(printable(shown, 60)), remedy=remedy)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%", "//")) or not line.strip()


def _fields(line: str, separator: str) -> list[str]:
    fields = line.split() if separator == " " else line.split(separator)
    if separator != " " and len(fields) > 1 and not fields[-1].strip():
        fields = fields[:-1]
    return [field.strip().strip('"').strip() for field in fields]


def _separation(line: str) -> tuple[str, bool] | None:
    """Separator of a line of numbers, and whether its decimals stand after a comma; None for other lines."""
    for separator in _SEPARATORS:
        fields = _fields(line, separator)
        if all(map(NUMBER.fullmatch, fields)):
            return separator, False
        # "1,2" alone is two columns by comma; with another separator in the line it is a decimal comma
        may_be_decimal = separator != "," and len(fields) > 1
        if may_be_decimal and all(NUMBER.fullmatch(field.replace(",", ".", 1)) for field in fields):
            return separator, True
    return None


def _header(lines: list[str], separator: str, n_columns: int) -> tuple[tuple[str, ...], dict[str, str]]:
    """Names of the columns, and their units, from the lines above the first numbers."""
    lines = [line for line in lines if not _is_comment(line)]
    rows = [_fields(line, separator) for line in lines]
    words = [[field.strip().strip('"') for field in re.split(r"[,;\t]", line)] for line in lines]
    fitting = [row for row in rows if len(row) == n_columns] or [row for row in words if len(row) == n_columns]
    return names_and_units(fitting, n_columns)


def names_and_units(rows: list[list[str]], n_columns: int) -> tuple[tuple[str, ...], dict[str, str]]:
    """Names of ``n_columns`` columns, and their units by name, from the ``rows`` of so many cells above the numbers.

    The last row holds the names, or their units below them; without rows the columns are called by their numbers.
    """
    if not rows:
        return tuple(str(number) for number in range(n_columns)), {}
    stated = [cell.strip("[]()") for cell in rows[-1]]
    if len(rows) > 1 and any(rows[-1]) and all(not unit or known_unit(unit) for unit in stated):
        rows.pop()
    else:
        stated = [unit_in_label(name) for name in rows[-1]]
    names = distinct([name or str(number) for number, name in enumerate(rows[-1])])
    return names, {name: unit for name, unit in zip(names, stated, strict=True) if unit}


def _rate_in(comments: str) -> float | None:
    match = _RATE.search(comments)
    try:
        rate_hz = float(match[1]) if match else 0.0
    except ValueError:
        return None
    rate_hz *= 1e3 if match and (match[2] or "").lower() == "khz" else 1.0
    return rate_hz if 0 < rate_hz < 1e12 else None


def _columns_at(positions: list[int], path: Path, layout: _Layout, *, on_disk: bool) -> FloatArray:
    """Columns (column, sample) at ``positions`` of the table, which is parsed in pieces."""
    feeds, returns, last = 0, 0, b""
    with path.open("rb") as stream:
        while piece := stream.read(PIECE_BYTES):
            feeds, returns, last = feeds + piece.count(b"\n"), returns + piece.count(b"\r"), piece[-1:]
    n_lines = max(feeds, returns) + (last not in b"\r\n") - layout.n_head_lines
    block = empty((len(positions), n_lines), np.float64, on_disk=on_disk)
    n, may_be_short = 0, False
    for table in _pieces(path, layout):
        # pandas fills short lines with NaN without a word
        may_be_short |= bool(np.isnan(table).any())
        block[:, n : n + len(table)] = table[:, positions].T
        n += len(table)
    if may_be_short:
        _find_bad_cell(path, layout)
    return block[:, :n]


def _pieces(path: Path, layout: _Layout) -> Iterator[FloatArray]:
    """Tables (sample, column) of ``PIECE_LINES`` each."""
    import pandas as pd

    try:
        for frame in parsed(
            path, layout.separator, decimal_comma=layout.decimal_comma, encoding=layout.encoding,
            skiprows=layout.n_head_lines, skip_blank_lines=True, chunksize=PIECE_LINES,
        ):  # fmt: skip
            if len(frame.columns) == len(layout.names) + 1 and frame.iloc[:, -1].isna().all():
                frame = frame.iloc[:, :-1]  # every line ends with a separator
            table: FloatArray = np.asarray(frame.to_numpy(), dtype=np.float64)
            if table.shape[1] != len(layout.names):
                _find_bad_cell(path, layout)
            yield table
    except (ValueError, OverflowError, pd.errors.ParserError) as error:
        if isinstance(error, InputError):
            raise
        _find_bad_cell(path, layout)
        raise InputError("not a table of numbers", found=error) from None


def parsed(source: Path | BinaryIO, separator: str, *, decimal_comma: bool, encoding: str, **options: Any) -> Any:
    """Table of numbers (float64) that pandas reads from ``source``, or pieces of it where ``options`` have a chunksize.

    Cells are parted by ``separator`` (a blank: any white space), decimals follow a comma where ``decimal_comma``, the
    text is in ``encoding``; ``options`` go to ``pandas.read_csv``. Raises what pandas raises where a cell is no number.
    """
    import pandas as pd

    return pd.read_csv(
        source,
        engine="c",
        sep=r"\s+" if separator == " " else separator,
        decimal="," if decimal_comma else ".",
        header=None,
        dtype=np.float64,
        encoding=encoding,
        keep_default_na=False,
        na_values=list(_NAN_WORDS),
        **options,
    )


def _find_bad_cell(path: Path, layout: _Layout) -> None:
    """Raise InputError naming the first line and cell that is not as the first line; slow, for errors only."""
    n_columns = len(layout.names)
    with path.open(encoding=layout.encoding, errors="replace", newline=None) as stream:
        for number, line in enumerate(stream, start=1):
            if number <= layout.n_head_lines or not line.strip():
                continue
            fields = _fields(line.rstrip("\n"), layout.separator)
            if len(fields) != n_columns:
                last = "" if line.endswith("\n") else "; the file seems to be truncated"
                problem = f"{len(fields)} cells where the lines above have {n_columns}{last}"
                found, remedy = repr(printable(line.strip(), 60)), "Mend the line, or copy the file again"
                raise InputError(problem, place=f"line {number}", found=found, remedy=remedy)
            for position, cell in enumerate(fields):
                plain = cell.replace(",", ".", 1) if layout.decimal_comma else cell
                if not NUMBER.fullmatch(plain):
                    problem = "not a number" if cell else "an empty cell"
                    place = f"line {number}, column {position} ({printable(layout.names[position], 40)})"
                    raise InputError(problem, place=place, found=repr(printable(cell, 40)), remedy=_MEND_CELL)


def last_line_flags(path: Path) -> list[QualityFlag]:
    """Flag where the last line of the text at ``path`` has no end: a copy that was cut there still parses."""
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - 4096))
        lines = stream.read().split(b"\n")
    if not lines[-1].strip():
        return []
    # a copy that was cut inside the last number still parses
    shortest = min((len(line) for line in lines[-20:-1] if line.strip()), default=0)
    severity: Severity = "suspect" if len(lines[-1].rstrip()) < shortest - 1 else "info"
    return [flag(path, "last_line_open", severity, "the last line has no end: it may be truncated")]


_BANNER_ROWS = 50
_TEXT_PART = re.compile(r"(?i)(?!.*worksheets/).*\.(xml|rels)")
_MOST_TEXT = 50_000_000
"""Bytes of each part of a workbook that is no sheet: a sheet of numbers has names and units, and no other text."""
_NO_VALUE = "an empty cell, or one with an error such as #N/A"
_UNPACKED = 10
"""Bytes of numbers for each byte of a workbook, as a rule at most."""

Row = list[Any]


def read_xlsx(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns (float64) that ``sources`` ask for, by name or number from 0, from the first sheet of ``path``.

    ``settings`` give the byte limit. Raises InputError naming row and cell for a cell that is no number, and
    EnvironmentFailure where the package python-calamine is missing, UnsafeInputError where it goes beyond its limits.
    """
    module = package("python_calamine", "XLSX", "Install it with: pip install crankorder[xlsx]")

    def parse() -> RawFile:
        rows = _rows(module.CalamineWorkbook, path, settings)
        names, units, first, n_above = _sheet_header(rows)
        stated, wanted = Contents("XLSX", names, units=units), names_of(sources, names, path)
        if not wanted:
            return stated.with_columns({}, ())
        positions = [names.index(name) for name in wanted.values()]
        cells = [[row[position] for position in positions] for row in chain([] if first is None else [first], rows)]
        while cells and all(cell == "" for cell in cells[-1]):
            cells.pop()  # formatted but empty rows below the data
        for number, values in enumerate(cells, start=n_above + 1):
            for position, cell in zip(positions, values, strict=True):
                if not _is_number(cell):
                    problem, found = (_NO_VALUE, "") if cell == "" else ("not a number", repr(cell))
                    place = f"row {number}, column {position} ({names[position]})"
                    raise InputError(problem, place=place, found=found, allowed="a number", remedy=_MEND_CELL)
        block = np.ascontiguousarray(np.array(cells, dtype=np.float64).reshape(-1, len(positions)).T)
        return stated.with_columns(wanted, block)

    return in_child(parse, path, n_bytes=_UNPACKED * path.stat().st_size)


def _rows(parser: Any, path: Path, settings: IngestSettings) -> Iterator[Row]:
    """Values of the rows of the first sheet, "" for an empty cell.

    What the archive claims to hold is checked against ``settings`` before it is unpacked, and the parts that hold text
    for all sheets, which the parser keeps in memory, against a limit of their own; a claim of rows beyond the last that
    a sheet can have takes more memory than the process has.
    """
    with zipfile.ZipFile(path) as archive:
        check_budget(sum(item.file_size for item in archive.infolist()), settings)
        for part in (item for item in archive.infolist() if _TEXT_PART.fullmatch(item.filename)):
            if part.file_size > _MOST_TEXT:
                problem, found = "too much text for a sheet of numbers", f"{part.file_size} bytes"
                allowed, remedy = f"{_MOST_TEXT} bytes", "Save the sheet of the numbers alone in a workbook of its own"
                raise UnsafeInputError(problem, place=part.filename, found=found, allowed=allowed, remedy=remedy)
            with archive.open(part) as stream:
                while stream.read(_HEAD_BYTES):  # raises where the part is longer than it claims
                    pass
    sheet = parser.from_path(path).get_sheet_by_index(0)
    if sheet.start is None:
        return
    for row in sheet.iter_rows():
        yield [""] * sheet.start[1] + row


def _sheet_header(rows: Iterator[Row]) -> tuple[tuple[str, ...], dict[str, str], Row | None, int]:
    """Names and units of the columns, the first row of numbers, and how many rows stand above it.

    Titles and notes above the names are passed over. ``rows`` are taken up to the first of numbers, None where there is
    none in the first rows: then their first one holds the names.
    """
    above: list[list[str]] = []
    first: Row | None = None
    for row in islice(rows, _BANNER_ROWS):
        cells = _filled(row)
        if cells and all(map(_is_number, cells)):
            first = row
            break
        above.append([str(cell).strip() for cell in cells])
    width = max((len(row) for row in above[:1]), default=0) if first is None else len(_filled(first))
    named_rows = [row for row in (above[:1] if first is None else above) if len(row) == width]
    if not width or (above and not named_rows):
        found = f"rows of {', '.join(str(len(row)) for row in above[:5])} cells above the first that is all numbers"
        remedy = f"Put the names into the row above the numbers; where the first of these has {_NO_VALUE}, mend it"
        place, allowed = f"rows 1 to {len(above) or 1}", f"a row of {width} names"
        raise InputError("no row names the columns", place=place, found=found, allowed=allowed, remedy=remedy)
    names, units = names_and_units(named_rows, width)
    return names, units, first, len(above)


def _filled(row: Row) -> Row:
    """Cells of ``row`` up to the last that is not empty."""
    return row[: max((place + 1 for place, cell in enumerate(row) if cell != ""), default=0)]


def _is_number(cell: object) -> bool:
    return isinstance(cell, (int, float)) and not isinstance(cell, bool)
