"""What a file holds, as it holds it: columns in the file's own units, before the manifest gives them meaning."""

from __future__ import annotations

import difflib
import fnmatch
import mmap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError, UnsafeInputError, printable
from crankorder.quantities import QualityFlag, Severity
from crankorder.scratch import empty, empty_like
from crankorder.settings import IngestSettings

FloatArray = npt.NDArray[np.floating[Any]]
Source = str | int
Key = TypeVar("Key", bound=Source)
Value = TypeVar("Value")


_LOOKED_AT, _SIZES = 8192, 16
"""Samples that are looked at, and how many different whole numbers are no levels of a switch."""

FIRST_DATE = np.datetime64("1980-01-01")
"""Before this nothing was recorded digitally: such a date is the zero of a clock that was never set."""

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file, or of its superblock behind a user block."""


@dataclass(frozen=True, slots=True)
class Described:
    """A column as its file describes it: number of samples, unit, rate in Hz, time in s of its first sample.

    None, or no unit, where the file does not say.
    """

    n_samples: int | None = None
    unit: str = ""
    rate_hz: float | None = None
    start_s: float | None = None


@dataclass(frozen=True, slots=True)
class Contents:
    """Names, sizes and units of what a file holds, read without its samples.

    ``samples`` and ``units`` go by name; ``samples`` lacks a name whose length only a full read would tell; of a single
    number it says 1. ``rates_hz`` and ``starts_s`` are those of :class:`RawFile`, by name. ``rate_uncertainty`` is
    relative: what the decimals of a stated time step leave open.
    ``speed_rpm`` is a speed of the shaft that the file states beside its columns.
    """

    format: str
    names: tuple[str, ...]
    samples: Mapping[str, int] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    starts_s: Mapping[str, float] = field(default_factory=dict)
    rate_uncertainty: float = 0.0
    speed_rpm: float | None = None

    @classmethod
    def of(cls, kind: str, columns: Mapping[str, Described], *, rate_uncertainty: float = 0.0) -> Contents:
        """Contents of a file of the format ``kind`` with ``columns`` by name; ``rate_uncertainty`` is relative."""

        def told(field: str) -> dict[str, Any]:
            values = {name: getattr(column, field) for name, column in columns.items()}
            return {name: value for name, value in values.items() if value not in (None, "")}

        samples, units, rates, starts = told("n_samples"), told("unit"), told("rate_hz"), told("start_s")
        return cls(kind, tuple(columns), samples, units, rates, starts, rate_uncertainty)

    def with_columns(self, names: Mapping[Source, str], columns: Iterable[FloatArray], **further: Any) -> RawFile:
        """RawFile of the ``columns`` (samples,) that were asked for, with unit, rate and start of each from here.

        ``names`` has their names by source, in the same sequence; ``further`` are other fields of the RawFile, such as
        ``flags``, of which equal ones are kept once.
        """
        flags = further.pop("flags", [])
        return RawFile(
            columns=dict(zip(names, columns, strict=True)),
            contents=self,
            units=_by_source(names, self.units),
            rates_hz=_by_source(names, self.rates_hz),
            starts_s=_by_source(names, self.starts_s),
            rate_uncertainty=self.rate_uncertainty,
            flags=[remark for number, remark in enumerate(flags) if remark not in flags[:number]],
            **further,
        )


def _by_source(names: Mapping[Source, str], values: Mapping[str, Value]) -> dict[Source, Value]:
    return {source: values[name] for source, name in names.items() if name in values}


@dataclass(frozen=True, slots=True)
class RawFile:
    """Columns of one file, each under the source by which it was asked for, and how the file says they were sampled.

    ``columns`` (samples,) are float32 or float64 in the file's unit, which ``units`` states where the file does.
    Columns asked for one after the other may be neighbouring rows of one block, so that they can be stacked without a
    copy. ``rates_hz`` are the samples per second of each, where the file states them; ``starts_s`` the time of the
    first sample of each on the clock of the file, 0 where it states none. ``rate_uncertainty`` is that of
    :class:`Contents`. ``contents`` says what else the file holds; it is empty of arrays from a notebook.
    """

    columns: Mapping[Source, FloatArray]
    units: Mapping[Source, str] = field(default_factory=dict)
    rates_hz: Mapping[Source, float] = field(default_factory=dict)
    starts_s: Mapping[Source, float] = field(default_factory=dict)
    rate_uncertainty: float = 0.0
    attrs: Mapping[str, float] = field(default_factory=dict)
    flags: list[QualityFlag] = field(default_factory=list)
    contents: Contents = field(default_factory=lambda: Contents("", ()))


def flag(path: Path, name: str, severity: Severity, detail: str) -> QualityFlag:
    """Quality flag ``name`` of the recording at ``path`` with its ``severity`` and ``detail``."""
    return QualityFlag(recording=path.name, flag=name, severity=severity, detail=detail)


def listed(words: Sequence[str], most: int, *, counted: bool = False) -> str:
    """The first ``most`` of ``words``, and that there are more: how many where they are ``counted``."""
    more = f" and {len(words) - most} more" if counted else ", …"
    return ", ".join(words[:most]) + (more if len(words) > most else "")


def named(source: Source, names: Sequence[str], path: Path) -> str:
    """Name among ``names`` of the column that ``source`` asks for: the name itself, its position from 0, or a pattern.

    A pattern (``"*_DE_time"``) must fit one name alone: the files of a test may each call their columns otherwise.
    Raises InputError "channel a4 not in file; has a1, a2, a3" for the file at ``path``.
    """
    if isinstance(source, str):
        for candidate in (source, source.strip().strip("/")):
            if candidate in names:
                return candidate
    if (isinstance(source, int) or source.isdecimal()) and int(source) < len(names):
        return names[int(source)]
    fitting = [name for name in names if isinstance(source, str) and fnmatch.fnmatchcase(name, source[:200])]
    if len(fitting) == 1:
        return fitting[0]
    shown = listed([printable(name, 60) for name in names], 20, counted=True)
    close = difflib.get_close_matches(str(source), names, n=1)
    problem = f"channel {printable(source, 60)} not in file; has {shown or 'nothing that holds samples'}"
    remedy = f"Did you mean {printable(close[0], 60)!r}?" if close else "Mend the source in the manifest"
    raise InputError(problem, file=path, remedy=remedy)


def names_of(sources: Sequence[Source], names: Sequence[str], path: Path) -> dict[Source, str]:
    """Names among ``names`` of the columns that ``sources`` ask for, by source.

    ``path`` is the file in errors; raises what :func:`named` raises.
    """
    return {source: named(source, names, path) for source in sources}


def distinct(names: Sequence[str]) -> tuple[str, ...]:
    """``names`` of columns, with a number behind each that comes again: "acc", "acc (2)"."""
    given: list[str] = []
    for name in names:
        numbered = (f"{name} ({number})" for number in count(2))
        given.append(next(own for own in chain([name], numbered) if own not in given))
    return tuple(given)


def by_distinct_name(pairs: Sequence[tuple[str, Value]]) -> dict[str, Value]:
    """The values of ``pairs`` (name, value) by :func:`distinct` name, in their order."""
    return dict(zip(distinct([name for name, _ in pairs]), (value for _, value in pairs), strict=True))


def starts_by_date(
    dates: Mapping[Key, np.datetime64], offsets_s: Mapping[Key, float], path: Path
) -> tuple[dict[Key, float], list[QualityFlag]]:
    """Starts in s on one clock of columns with ``dates`` and ``offsets_s`` from them; flags where a clock was not set.

    The clock begins at the earliest date; without one the offset counts from there. A date before 1980 beside a real
    one is no date, which a flag of the file at ``path`` says.
    """
    real = {source: date for source, date in dates.items() if date >= FIRST_DATE}
    unset = [source for source in dates if source not in real] if real else []
    dates = real or dates
    first = min(dates.values(), default=np.datetime64(0, "ns"))
    lags = {source: float((date - first) / np.timedelta64(1, "ns")) * 1e-9 for source, date in dates.items()}
    starts = {source: lags.get(source, 0.0) + offsets_s.get(source, 0.0) for source in {**dates, **offsets_s}}
    detail = f"no date of start was set for {', '.join(map(str, unset))}: taken to start with the first of the others"
    return starts, [flag(path, "start_unknown", "suspect", detail)] if unset else []


def line_at(data: mmap.mmap, place: int, *, most_bytes: int) -> tuple[bytes, int]:
    """The line of ``data`` at ``place`` without its end, cut to ``most_bytes``, and where the next one begins."""
    end = data.find(b"\n", place)
    end = len(data) if end < 0 else end
    return data[place : min(end, place + most_bytes)].rstrip(b"\r"), end + 1


def part_of(n_samples: int, rows: slice | None) -> slice:
    """The samples of a column of ``n_samples`` that ``rows`` ask for: all where None."""
    first, last, _ = (rows or slice(None)).indices(n_samples)
    return slice(first, max(first, last))


def float_type_for(dtype: np.dtype[Any]) -> type[np.floating[Any]]:
    """The smaller of float32 and float64 that holds every number of ``dtype`` (integers or floats)."""
    small = dtype.itemsize <= 2 or (dtype.kind == "f" and dtype.itemsize == 4)
    return np.float32 if small else np.float64


def rows_for(kinds: Sequence[tuple[int, type[np.floating[Any]]]], *, in_memory_bytes: int) -> list[FloatArray]:
    """Row (samples,) to be filled for each of ``kinds``, pairs of a number of samples and a type.

    Rows of one kind are neighbours in one block. All lie on disk where together they exceed ``in_memory_bytes``. Raises
    EnvironmentFailure where the disk has no room for them.
    """
    on_disk = sum(n_samples * np.dtype(dtype).itemsize for n_samples, dtype in kinds) > in_memory_bytes
    room = {kind: iter(empty((kinds.count(kind), kind[0]), kind[1], on_disk=on_disk)) for kind in dict.fromkeys(kinds)}
    return [next(room[kind]) for kind in kinds]


def looks_counted(values: FloatArray) -> bool:
    """Whether ``values`` (samples,) are whole numbers of many sizes, as a converter counts; looks at some of them."""
    some = values[:: max(1, values.size // _LOOKED_AT)][:_LOOKED_AT]
    some = some[np.isfinite(some)]
    return bool((some == np.rint(some)).all()) and np.unique(some).size >= _SIZES


def check_budget(n_bytes: int, settings: IngestSettings) -> None:
    """Refuse a file that claims ``n_bytes``, more than ``settings`` allow, before anything is allocated for it.

    Raises UnsafeInputError with both numbers.
    """
    if n_bytes > settings.max_bytes:
        allowed = f"{settings.max_bytes} bytes (ingest.max_bytes)"
        remedy = "Check the file, or raise ingest.max_bytes in a recipe"
        raise UnsafeInputError(f"claims {n_bytes} bytes of samples", allowed=allowed, remedy=remedy)


def stacked(rows: Sequence[FloatArray]) -> FloatArray:
    """``rows``, each (samples,), as one array (channels, samples); no copy where they are neighbours in one block."""
    base = rows[0].base
    if isinstance(base, np.ndarray) and base.ndim == 2 and base.flags.writeable and base.flags.c_contiguous:
        start = (rows[0].ctypes.data - base.ctypes.data) // max(base.strides[0], 1)
        block: FloatArray = base[start : start + len(rows)]
        own = (row.base is base and row.ctypes.data == at.ctypes.data for row, at in zip(rows, block, strict=False))
        if block.shape == (len(rows), rows[0].size) and all(own):
            return block
    return np.stack(rows, out=empty_like(rows[0], (len(rows), rows[0].size), np.result_type(*rows)))
