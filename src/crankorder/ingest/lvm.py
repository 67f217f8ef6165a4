"""LabVIEW measurement files (.lvm): text columns below a header, in one segment or several.

Format: National Instruments, "Specification for the LabVIEW Measurement File (.lvm)" (2013).
"""

from __future__ import annotations

import csv
import mmap
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.ingest.rawfile import (
    Contents,
    Described,
    FloatArray,
    RawFile,
    Source,
    check_budget,
    flag,
    line_at,
    names_of,
    rows_for,
    starts_by_date,
)
from crankorder.ingest.sampling import read_time_column
from crankorder.ingest.text import PIECE_LINES, encoding_of, last_line_flags, parsed
from crankorder.quantities import QualityFlag
from crankorder.settings import IngestSettings

_TIME = "X_Value"
_END_OF_HEADER = re.compile(rb"(?m)^\*\*\*End_of_Header\*\*\*[^\n]*(?:\n|\Z)")
_BLANK = re.compile(rb"(?m)^[ \t;,\r]*$")
_DELIMITER = re.compile(r" *(?:[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)? *|[^\t;,]*)([\t;,])")
"""First delimiter of a line, after a cell that may be a number with a decimal comma."""
_MOST_HEAD_BYTES = 1 << 20
_MOST_SEGMENTS = 1000
_MOST_COLUMNS = 1000
_FEW_LINES = 4096
"""Lines of times from which the contents of a file are told; reading it uses all."""


class _Segment(NamedTuple):
    """One block of columns: names, cells of the header by their first, the first byte and number of lines of values.

    ``first`` is the first line of values.
    """

    names: tuple[str, ...]
    header: dict[str, list[str]]
    begin: int
    n_lines: int
    first: str

    def said(self, key: str, place: int) -> str:
        cells = self.header.get(key, [])
        return cells[place] if place < len(cells) else ""

    def channel_from(self, place: int) -> int:
        """Place of the first channel at ``place`` or behind it, that of the first of all where none is."""
        channels = [index for index, name in enumerate(self.names) if name != _TIME]
        return next((index for index in channels if index >= place), next(iter(channels), 0))

    @property
    def separator(self) -> str:
        return _separator(self.first) if len(self.names) > 1 else "\t"


class _Column(NamedTuple):
    segment: _Segment
    place: int
    is_time: bool

    @property
    def unit(self) -> str:
        return "s" if self.is_time else self.segment.said("Y_Unit_Label", self.place)


class _Layout(NamedTuple):
    encoding: str
    decimal_comma: bool
    columns: dict[str, _Column]

    def times_of(self, column: _Column) -> _Column | None:
        """Column of times of a channel: the nearest before it in its segment; None where the header tells the time."""
        mine = [other for other in self.columns.values() if other.is_time and other.segment is column.segment]
        if column.segment.said("X_Dimension", column.place) not in ("Time", ""):
            return None
        before = [other for other in mine if other.place <= column.place]
        return max(before, key=lambda other: other.place, default=None)


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Columns (float64) that ``sources`` ask for, by name or number from 0, from the LabVIEW file at ``path``.

    Channels are numbered before the columns of times (``X_Value``). With several segments a name is the number of the
    segment and that of the channel: ``"0/Voltage"``. The rate is that of the column of times, else of the header
    (``Delta_X``, to its last decimal); a header that contradicts the column is told in ``attrs["header_rate_hz"]``.
    ``settings`` give the byte limit. Raises InputError where a cell is no number, or the times are not even.
    """
    check_budget(path.stat().st_size, settings)
    layout = _layout(path)
    names = names_of(sources, tuple(layout.columns), path)
    wanted = {name: layout.columns[name] for name in names.values()} or layout.columns
    times = [time for column in wanted.values() if (time := layout.times_of(column)) is not None]
    asked = [*wanted.values(), *times] if names else times
    read: dict[tuple[int, int], FloatArray] = {}
    for segment in {column.segment.begin: column.segment for column in asked}.values():
        places = sorted({column.place for column in asked if column.segment is segment})
        rows = _read(path, layout, segment, places, settings, most=segment.n_lines if names else _FEW_LINES)
        read |= {(segment.begin, place): row for place, row in zip(places, rows, strict=True)}
    contents, attrs, flags = _timing(layout, wanted, read, path, settings)
    if not names:
        return contents.with_columns({}, ())
    flags += last_line_flags(path)
    for column in wanted.values():
        declared, n_lines = column.segment.said("Samples", column.place), column.segment.n_lines
        if declared.isdecimal() and len(declared) <= 18 and int(declared) > n_lines:
            detail = f"the header promises {int(declared)} samples, {n_lines} are there"
            flags.append(flag(path, "missing_data", "suspect", detail))
            break
    columns = [read[wanted[name].segment.begin, wanted[name].place] for name in names.values()]
    return contents.with_columns(names, columns, attrs=attrs, flags=flags)


def _layout(path: Path) -> _Layout:
    """Headers of the file and where its segments stand; the lines of values are only counted."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        encoding = encoding_of(data[: 1 << 16])
        head, segments = _segments(data, encoding)
    if not segments:
        raise InputError("holds no segment of measured values", remedy="Copy it again, or record again")
    stated = head.get("Decimal_Separator", ["", ""])[1:2]
    # an old writer states none, and its times of day say nothing about its values
    has_commas = "," in segments[0].first and "." not in segments[0].first
    comma = segments[0].separator != "," and (stated == [","] or (stated == [""] and has_commas))
    with_times = head.get("X_Columns", ["", "One"])[1:2] != ["No"]
    return _Layout(encoding, comma, _columns(segments, with_times=with_times))


def _segments(data: mmap.mmap, encoding: str) -> tuple[dict[str, list[str]], list[_Segment]]:
    """The header of the file, and its segments that hold values."""
    head: dict[str, list[str]] = {}
    segments: list[_Segment] = []
    place, is_head = 0, True
    while data[place : place + _MOST_HEAD_BYTES].strip(b" \t;,\r\n"):
        end = _END_OF_HEADER.search(data, place, place + _MOST_HEAD_BYTES)
        if end is None:
            raise InputError("truncated: a header has no end", place=f"byte {place}", remedy="Copy it again")
        lines = data[place : end.start()].decode(encoding, "replace").splitlines()
        rows = [[cell.strip() for cell in line.split(_separator(line))] for line in lines]
        header, place = {row[0]: row for row in rows if row[0]}, end.end()
        if is_head:
            head, is_head = header, False
            continue
        text, begin = _line(data, place, encoding)
        names = tuple(cell.strip() for cell in text.split(_separator(text)))
        if not text.strip() or len(names) > _MOST_COLUMNS:
            raise InputError("no names of columns below a header", place=f"byte {place}")
        blank = _BLANK.search(data, begin)
        place = len(data) if blank is None else blank.start()
        n_lines = sum(data[at : min(at + (1 << 22), place)].count(b"\n") for at in range(begin, place, 1 << 22))
        n_lines += place > begin and data[place - 1] != ord("\n")
        if n_lines:
            segments.append(_Segment(names, header, begin, n_lines, _line(data, begin, encoding)[0]))
        if len(segments) > _MOST_SEGMENTS:
            raise UnsafeInputError(f"holds more than {_MOST_SEGMENTS} segments")
    return head, segments


def _line(data: mmap.mmap, place: int, encoding: str) -> tuple[str, int]:
    """The line at ``place`` without its end, and where the next begins."""
    line, after = line_at(data, place, most_bytes=_MOST_HEAD_BYTES)
    return line.decode(encoding, "replace"), after


def _separator(line: str) -> str:
    """What parts the cells of ``line``: tab, semicolon or comma; the headers and the values of a file may differ."""
    first = _DELIMITER.match(line)
    return first[1] if first else "\t"


def _columns(segments: list[_Segment], *, with_times: bool) -> dict[str, _Column]:
    """Columns by name: channels first, then times; the column of comments and channels without samples left out."""
    channels: dict[str, _Column] = {}
    times: dict[str, _Column] = {}
    for number, segment in enumerate(segments):
        prefix = f"{number}/" if len(segments) > 1 else ""
        for place, name in enumerate(segment.names):
            is_time = name == _TIME
            is_comment = place == len(segment.names) - 1 and name in ("Comment", "")
            if (is_time and not with_times) or is_comment or segment.said("Samples", place) == "0":
                continue
            known, full, again = (times if is_time else channels), f"{prefix}{name or place}", 0
            while full in known:
                again += 1
                full = f"{prefix}{name} {again}"
            known[full] = _Column(segment, place, is_time)
    return channels | times


def _read(
    path: Path, layout: _Layout, segment: _Segment, places: list[int], settings: IngestSettings, *, most: int
) -> list[FloatArray]:
    """Values of the columns at ``places`` in ``most`` lines, in pieces; empty cells at their ends are no samples."""
    n_lines = min(most, segment.n_lines)
    rows = rows_for([(n_lines, np.float64)] * len(places), in_memory_bytes=settings.in_memory_bytes)
    done = 0
    try:
        with path.open("rb") as stream:
            stream.seek(segment.begin)
            for frame in parsed(
                stream, segment.separator, decimal_comma=layout.decimal_comma, encoding=layout.encoding,
                encoding_errors="replace", nrows=n_lines, chunksize=PIECE_LINES, index_col=False,
                names=range(segment.first.count(segment.separator) + 1), usecols=places, quoting=csv.QUOTE_NONE,
                skip_blank_lines=False,
            ):  # fmt: skip
                for place, row in zip(places, rows, strict=True):
                    row[done : done + len(frame)] = frame[place].to_numpy()
                done += len(frame)
    except (ValueError, OverflowError) as error:
        cell = printable(str(error).split("\n")[0], 80)
        line = f"line {done + 1} of the values or below"
        raise InputError("a cell is no number", place=line, found=cell, remedy="Mend the cell") from None
    if not any(np.isnan(row[-1:]).any() for row in rows):
        return rows
    return [row[: np.flatnonzero(np.append(True, ~np.isnan(row)))[-1]] for row in rows]


def _timing(
    layout: _Layout, columns: Mapping[str, _Column], read: Mapping[tuple[int, int], FloatArray], path: Path,
    settings: IngestSettings,
) -> tuple[Contents, dict[str, float], list[QualityFlag]]:  # fmt: skip
    """Units, rates and starts of ``columns`` by name, attributes of the file, flags.

    ``read`` holds the values of their columns of times, by the first byte of the segment and the place in it.
    """
    kinds: dict[tuple[object, ...], tuple[float | None, dict[str, float], list[QualityFlag]]] = {}
    rates: dict[str, float | None] = {}
    starts: dict[str, float] = {}
    dates: dict[str, np.datetime64] = {}
    for name, column in columns.items():
        segment, time = column.segment, layout.times_of(column)
        begin = 0 if time is None else time.place
        first, own = segment.channel_from(begin), segment.channel_from(column.place)
        kind = (segment.begin, None if time is None else begin, segment.said("Delta_X", own))
        if kind not in kinds:
            kinds[kind] = _rate(segment, own, None if time is None else read[segment.begin, begin], path, settings)
        rates[name], attrs, _ = kinds[kind]
        first_s, own_s = (_number(segment.said("X0", place)) or 0.0 for place in (first, own))
        starts[name] = own_s if time is None else attrs["start_s"] + own_s - first_s
        date, of_day = segment.said("Date", own).replace("/", "-"), segment.said("Time", own).replace(",", ".")
        with suppress(ValueError):
            dates[name] = np.datetime64(f"{date}T{of_day[:18]}", "ns")
    starts, flags = starts_by_date({name: date for name, date in dates.items() if not np.isnat(date)}, starts, path)
    flags += [remark for _, _, remarks in kinds.values() for remark in remarks]
    attrs = next(iter(kinds.values()))[1]
    described = {name: Described(None, at.unit, rates[name], starts.get(name)) for name, at in columns.items()}
    return Contents.of("LVM", described, rate_uncertainty=attrs["rate_uncertainty"]), attrs, flags


def _rate(
    segment: _Segment, place: int, times: FloatArray | None, path: Path, settings: IngestSettings
) -> tuple[float | None, dict[str, float], list[QualityFlag]]:
    """Rate in Hz, by the column of times where there is one, else by the header; its attributes; flags."""
    text = segment.said("Delta_X", place) or segment.said("Delta_X", segment.channel_from(0))
    step_s = _number(text)
    doubt = 0.0
    if step_s:  # of the last decimal half is rounded away, or more is cut
        mantissa, _, exponent = text.replace(",", ".", 1).upper().partition("E")
        doubt = 0.6 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])) / step_s
    header_hz = 1.0 / step_s if step_s and step_s > 0.0 else None
    if times is None or times.size < 3:
        return header_hz, {"rate_uncertainty": doubt, "start_s": 0.0}, []
    column = read_time_column(times, path, settings=settings)
    attrs = {"rate_uncertainty": column.rate_uncertainty, "start_s": column.start_s}
    tolerance = doubt + column.rate_uncertainty + settings.rate_tolerance
    if header_hz is not None and abs(header_hz / column.rate_hz - 1.0) > tolerance:
        attrs["header_rate_hz"] = header_hz
    elif header_hz is not None and doubt < column.rate_uncertainty:
        return header_hz, attrs | {"rate_uncertainty": doubt}, column.flags
    return column.rate_hz, attrs, column.flags


def _number(text: str) -> float | None:
    """The number that a cell of a header writes, with a decimal point or comma, or None."""
    try:
        value = float(text.replace(",", ".", 1))
    except ValueError:
        return None
    return value if np.isfinite(value) else None
