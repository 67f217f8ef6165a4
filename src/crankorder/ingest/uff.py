"""Universal files (UFF): time histories of data sets 58, as text or binary (58b).

Layout after the University of Cincinnati Structural Dynamics Research Lab, Universal File Format, data set 58.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.ingest.rawfile import (
    Contents,
    Described,
    FloatArray,
    RawFile,
    Source,
    by_distinct_name,
    check_budget,
    flag,
    line_at,
    names_of,
)
from crankorder.ingest.sampling import TimeColumn, read_time_column
from crankorder.ingest.text import NUMBER
from crankorder.ingest.units import known_unit
from crankorder.quantities import Floats
from crankorder.settings import IngestSettings

_DELIMITER = re.compile(rb"(?m)^[ \t]{0,8}-1[ \t]*\r?$\n?")
_END = re.compile(rb"\s{0,12}-1[ \t]*\r?(?:\n|\Z)")
_HEADER_LINES = 11
_MOST_LINE_BYTES = 400
_GENERAL, _TIME_RESPONSE, _TIME = 0, 1, 17
_FEW_BYTES = 1 << 17
"""Bytes of pairs from whose times the rate of a file is told; reading it uses all."""
# ordinate data type: numpy's letter and width in bytes
_REAL = {2: "f4", 4: "f8"}
_DIRECTION = {1: "+X", 2: "+Y", 3: "+Z", 4: "+RX", 5: "+RY", 6: "+RZ"}
_FUNCTIONS = {
    0: "general", 2: "auto spectrum", 3: "cross spectrum", 4: "frequency response", 5: "transmissibility",
    6: "coherence", 7: "auto correlation", 8: "cross correlation", 9: "power spectral density",
}  # fmt: skip


class _History(NamedTuple):
    """One time history: its name, unit, points as the header promises them, sampling, and where its samples lie.

    ``even`` is what the header says of the times, None where each sample has its own, in units of ``time_s``;
    ``is_open`` says whether the end of its data set is missing.
    """

    name: str
    unit: str
    n_points: int
    n_present: int
    even: TimeColumn | None
    time_s: float
    point: np.dtype[Any]
    binary: bool
    first: int
    last: int
    is_open: bool


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Time histories that ``sources`` ask for, by name or number from 0, from the universal file at ``path``.

    A history is called by the point and direction of its response, else by its first line of text. ``settings`` give
    the byte and object limits. Raises InputError for damage, a missing name, or a file without time histories.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        histories = _histories(data, settings)
        names = names_of(sources, tuple(histories), path)
        check_budget(sum(histories[name].n_points * 8 for name in names.values()), settings)
        if not names:
            first = {
                name: history.even or _sampled(data, history, path, settings, most_bytes=_FEW_BYTES)[1]
                for name, history in histories.items()
            }
            return _contents(histories, first).with_columns({}, ())
        sampled = {name: _sampled(data, histories[name], path, settings) for name in names.values()}
    columns = {name: column for name, (column, _) in sampled.items()}
    times = {name: time for name, (_, time) in sampled.items()}
    promised = {name: histories[name].n_points for name in columns}
    short = [name for name, column in columns.items() if column.size < promised[name]][:1]
    lacks = [f"the header promises {promised[name]} samples, {columns[name].size} are there" for name in short]
    flags = [flag(path, "missing_data", "suspect", f"{name}: {lack}") for name, lack in zip(short, lacks, strict=True)]
    if not lacks and any(history.is_open for history in histories.values()):
        flags.append(flag(path, "missing_data", "suspect", "the last data set has no end: further ones may be lost"))
    flags += [remark for time in times.values() for remark in time.flags]
    return _contents(histories, times).with_columns(names, [columns[name] for name in names.values()], flags=flags)


def _contents(histories: Mapping[str, _History], times: Mapping[str, TimeColumn]) -> Contents:
    columns: dict[str, Described] = {}
    for name, history in histories.items():
        time, n_samples = times.get(name), history.n_present if history.binary else None
        stated = (None, None) if time is None else (time.rate_hz, time.start_s)
        columns[name] = Described(n_samples, history.unit, *stated)
    doubt = max((time.rate_uncertainty for time in times.values()), default=0.0)
    return Contents.of("UFF", columns, rate_uncertainty=doubt)


def _histories(data: mmap.mmap, settings: IngestSettings) -> dict[str, _History]:
    """Time histories by name, in the order of the file."""
    histories: list[_History] = []
    others: dict[str, None] = {}
    place, count = 0, 0
    while (begin := _DELIMITER.search(data, place)) is not None:
        count += 1
        if count > settings.max_objects:
            raise UnsafeInputError(f"more than {settings.max_objects} data sets", remedy="Split the file")
        line, place = line_at(data, begin.end(), most_bytes=_MOST_LINE_BYTES)
        if re.match(rb"\s*58b?\b", line) is not None:
            history, place = _history(data, line, place)
        else:
            history, end = f"data set {printable(line.decode('latin-1').strip(), 12)}", _DELIMITER.search(data, place)
            place = end.end() if end is not None else len(data)
        if isinstance(history, _History):
            histories.append(history)
        else:
            others[history] = None
    if not histories:
        problem = "holds no time histories (data set 58, function type 1, or 0 by time)"
        found = ", ".join(list(others)[:5]) or "no data set"
        raise InputError(problem, found=found, remedy="Export the time signals")
    return by_distinct_name([(history.name, history) for history in histories])


def _history(data: mmap.mmap, kind: bytes, place: int) -> tuple[_History | str, int]:
    """The data set 58 whose header begins at ``place``, or what it is where it is no time history; and its end."""
    where = f"data set 58 at byte {place}"
    text: list[str] = []
    for _ in range(_HEADER_LINES):
        line, place = line_at(data, place, most_bytes=_MOST_LINE_BYTES)
        text.append(_text(line))
    try:
        function, (form, n_points, spacing) = int(text[5][:5]), (int(cell) for cell in text[6].split()[:3])
        start_s, step = float(text[6].split()[3]), text[6].split()[4]
        abscissa = int(text[7][:10])
    except (ValueError, IndexError):
        problem, allowed = "cut or damaged: the header of a data set is wrong", f"{_HEADER_LINES} lines"
        found = f"{sum(map(bool, text))} lines" if place >= len(data) else repr(text[6].strip())
        raise InputError(problem, place=where, found=found, allowed=allowed, remedy="Copy it again") from None
    binary = b"b" in kind
    n_bytes, order = _binary_layout(kind, where) if binary else (0, "<")
    last = min(place + n_bytes, len(data))
    if not binary:
        end = _DELIMITER.search(data, place)
        last = end.start() if end is not None else len(data)
    behind = _END.match(data, last)
    after = behind.end() if behind is not None else last
    problem = _unfit(form, n_points, spacing, step)
    general = function == _GENERAL and abscissa == _TIME and not problem
    if not general and (function != _TIME_RESPONSE or abscissa not in (0, _TIME)):
        return f"function type {function} ({_FUNCTIONS.get(function, 'other')})", after
    if problem:
        raise InputError(problem, place=where, remedy="Export real samples at even steps of time")
    unit = known_unit(_stated(text[7][46:]))
    time_s = unit.factor if unit is not None and unit.quantity == "time" else 1.0
    even = (
        TimeColumn(1.0 / (float(step) * time_s), _last_digit(step), start_s * time_s, [], n_points) if spacing else None
    )
    wide = "f8" if n_bytes >= 16 * n_points else "f4"  # the standard's times are single, some writers' double
    value = np.dtype(order + _REAL[form])
    point = value if even is not None else np.dtype([("time", order + wide), ("value", value)])
    present = (last - place) // point.itemsize if binary else n_points
    made = _History(
        name=_name(text), unit=_stated(text[8][46:]), n_points=n_points, n_present=min(present, n_points), even=even,
        time_s=time_s, point=point, binary=binary, first=place, last=last,
        is_open=behind is None,
    )  # fmt: skip
    return made, after


def _text(line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def _binary_layout(kind: bytes, where: str) -> tuple[int, str]:
    """Bytes of the samples and their order, from the first line of a data set 58b."""
    cells = kind.split()
    try:
        order, floats, n_lines, n_bytes = (int(cell) for cell in cells[1:5])
    except ValueError:
        raise InputError("damaged: the header of a binary data set is wrong", place=where) from None
    if order not in (1, 2) or floats != 2 or n_lines != _HEADER_LINES or n_bytes < 0:
        problem, found = "a binary data set of a kind that is not read", printable(kind.decode("latin-1"))
        allowed = "byte order 1 or 2, IEEE 754 numbers (2), 11 lines of text"
        raise InputError(problem, place=where, found=found, allowed=allowed)
    return n_bytes, "<" if order == 1 else ">"


def _unfit(form: int, n_points: int, spacing: int, step: str) -> str:
    """Why samples of this form cannot be a recording, empty where they can."""
    if form not in _REAL:
        return f"samples of type {form} are complex or unknown"
    if n_points < 0:
        return f"{n_points} samples"
    with suppress(ValueError):
        if spacing == 0 or (spacing == 1 and 0.0 < float(step) < np.inf):
            return ""
    return "samples at uneven steps of time"


def _last_digit(step: str) -> float:
    """Relative size of half a unit in the last place of a number as text."""
    mantissa = re.match(r"[+-]?([0-9]*)\.?([0-9]*)", step.strip())
    digits = (mantissa[1] + mantissa[2]).lstrip("0") if mantissa else ""
    # 5.00000E-05 is 50 µs, not a rounded step
    return 0.0 if len(digits.rstrip("0")) <= 3 else 0.5 / float(digits)


def _name(text: list[str]) -> str:
    """What a history is called: the point and direction of its response, else its entity, else the first line."""
    cells = text[5]
    entity = _stated(cells[30:41])
    try:
        node, direction = int(cells[41:51]), int(cells[51:55])
    except ValueError:
        node, direction = 0, 0
    sense = _DIRECTION.get(abs(direction), "")
    way = sense.replace("+", "-") if direction < 0 else sense
    point = f"{node}{way}"
    if node and way and entity != point:
        return f"{entity}:{point}" if entity else point
    return entity or _stated(re.sub(r"\s*:.*$", "", text[0].strip())) or "1"


def _stated(cell: str) -> str:
    """What a cell of a header says; empty where it says NONE."""
    return "" if cell.strip().upper() == "NONE" else cell.strip()


def _sampled(
    data: mmap.mmap, history: _History, path: Path, settings: IngestSettings, *, most_bytes: int | None = None
) -> tuple[FloatArray, TimeColumn]:
    """Samples of ``history``, those that are there in its first ``most_bytes``, and their times."""
    point, last = history.point, history.last
    block = data[history.first : last if most_bytes is None else min(last, history.first + most_bytes)]
    kept = slice(history.n_points if history.even is not None or history.binary else 2 * history.n_points)
    if history.binary:
        points = np.frombuffer(block, point, len(block) // point.itemsize)[kept]
    else:
        block = block if most_bytes is None else block[: block.rfind(b"\n") + 1]
        points = _numbers(re.sub(rb"[DdEe]?[-+]?\s*\Z", b"", block), history)[kept]
        points = points[: -1 if points.size < kept.stop else None]  # a number that is cut still reads as one
    if history.even is not None:
        return np.asarray(points, dtype=point.newbyteorder("=")), history.even
    if history.binary:
        times, samples = points["time"].astype(np.float64), points["value"]
        rounding = np.spacing(points["time"]) / 2.0
    else:
        times, samples = points[0 : points.size // 2 * 2 : 2], points[1::2]
        n_digits = len(re.sub(rb"^[^1-9]*|[EeDd].*|\.", b"", block.split(None, 3)[2]))  # of the second time
        rounding = 0.5 * 10.0 ** (np.floor(np.log10(np.maximum(np.abs(times), times[1]))) + 1 - n_digits)
    samples = samples.astype(point["value"].newbyteorder("="))
    column = read_time_column(times * history.time_s, path, settings=settings, rounding=rounding * history.time_s)
    samples = column.on_grid(samples)
    column.align(samples)
    return samples, column


def _numbers(block: bytes, history: _History) -> Floats:
    """Numbers of a ``block`` of lines in columns of even width, or between blanks as where pairs mix two widths."""
    lines = [line.rstrip() for line in block.replace(b"D", b"E").replace(b"d", b"e").splitlines()]
    width = 13 if history.point.itemsize == 4 else 20
    full = max((len(line) for line in lines), default=0)
    full += -full % width
    parted = any(len(line.split()) > 1 and len(line.split()) != -(-len(line) // width) for line in lines[:3])
    try:
        if parted or history.even is None:
            return np.array(b" ".join(lines).split(), dtype=np.float64)
        table = np.frombuffer(b"".join(line.ljust(full, b"\0") for line in lines), dtype=f"S{width}")
        return np.asarray(table[table != b""].astype(np.float64))
    except ValueError:
        cells = (cell.decode("latin-1") for line in lines for cell in line.split())
        found = next((repr(cell) for cell in cells if not NUMBER.fullmatch(cell)), "two numbers in one")
        place, allowed = f"data set 58 at byte {history.first}", f"numbers in columns of {width} characters"
        raise InputError("not a number", place=place, found=found, allowed=allowed, remedy="Export it again") from None
