"""HDF5 and NetCDF-4 files: read-only, without locks, without following anything that leads out of the file."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from crankorder.errors import CrankorderError, InputError, UnsafeInputError, printable
from crankorder.ingest.rawfile import (
    Contents,
    Described,
    FloatArray,
    RawFile,
    Source,
    check_budget,
    flag,
    float_type_for,
    names_of,
    part_of,
    rows_for,
    starts_by_date,
)
from crankorder.quantities import Floats
from crankorder.scratch import blocks, is_on_disk
from crankorder.settings import IngestSettings

_MAX_DEPTH = 32
_LEAST_BYTES = 96
"""Of an HDF5 file: its superblock."""
PIECE_BYTES = 1 << 22
"""Bytes of a column read at a time where it goes to disk; whole chunks, and at least one."""

# deflate, shuffle, fletcher32, szip, nbit, scaleoffset, lzf: all others would load code from a plugin folder
_FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 4: "szip", 5: "nbit", 6: "scaleoffset", 32000: "lzf"}
# an exception of h5py on a damaged file may be any of these
_H5PY_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError, IndexError)


def _plain(name: str) -> str:
    """``name`` of an attribute without case and what stands between its words: loggers write these as they like."""
    return re.sub("[^a-z0-9]", "", name.lower())


# plain names of attributes
_RATES = (
    "ratehz", "sampleratehz", "samplerate", "samplingrate", "samplingratehz", "samplingfrequency",
    "samplingfrequencyhz", "samplefrequency", "samplefreq", "sampfreq", "fs", "fshz",
)  # fmt: skip
_STEPS = ("wfincrement", "dt", "dts", "deltat", "increments", "timestep", "sampleinterval", "samplinginterval")
_SPEEDS = ("speedrpm", "rpm", "shaftspeedrpm", "nominalrpm", "enginespeedrpm")
_UNITS = ("units", "unit", "unitstring")
_STARTS = ("starts", "wfstartoffset")
_CLOCKS = ("t0", "t0s", "starttime", "starttimes", "startoffsets", "timeoffsets")
_DATES = ("wfstarttime", "starttime")
_FILLS, _SCALE, _OFFSET = ("fillvalue", "missingvalue"), "scalefactor", "addoffset"
_ALONE = frozenset((*_RATES, *_STEPS, *_SPEEDS))
_ASKED = _ALONE | {*_UNITS, *_STARTS, *_CLOCKS, *_DATES, *_FILLS, _SCALE, _OFFSET}
_TEXT_NUMBER = re.compile(
    r"([+-]?(?:[0-9]{1,30}\.?[0-9]{0,30}|\.[0-9]{1,30})(?:[eE][+-]?[0-9]{1,3})?)\s*([kMmµu]?)(?:Hz|S/s|s|sec)?"
)
_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "m": 1e-3, "µ": 1e-6, "u": 1e-6}
_SAME_RATE = 1e-4  # a time step is often written with few decimals


@dataclass(frozen=True, slots=True)
class _Column:
    dataset: str
    opened: Any
    index: int | None  # of the shorter axis of a 2-D dataset
    n_samples: int


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings, rows: slice | None = None) -> RawFile:
    """Columns that ``sources`` ask for from the HDF5 file at ``path``: 1-D datasets, or ``"name[0]"`` of a 2-D one.

    A source is a dataset path or a position in the sorted list of them; ``settings`` give the byte and object limits;
    ``rows``: of the samples of each, None for all.
    Raises InputError for damage or a missing name, UnsafeInputError for links out of the file and impossible sizes.
    """
    with _opened(path) as file:
        columns = _columns_of(file, settings)
        names = names_of(sources, list(columns), path)
        wanted = {name: columns[name] for name in names.values()} or columns
        used = {column.dataset: column.opened for column in wanted.values()}
        for dataset in used.values():
            _check_dataset(dataset)
        attributes = _Attributes(file, used)
        places = {name: column.dataset for name, column in wanted.items()}
        starts, undated = starts_by_date(*attributes.starts(places), path)
        told = {name: (attributes.text(place, _UNITS), attributes.rate_hz(place)) for name, place in places.items()}
        described = {name: Described(at.n_samples, *told[name], starts.get(name)) for name, at in wanted.items()}
        stated = Contents.of("HDF5", described)
        if not names:
            speeds = (attributes.number(dataset, _SPEEDS) for dataset in used)
            return replace(stated, speed_rpm=next((rpm for rpm in speeds if rpm), None)).with_columns({}, ())
        check_budget(sum(dataset.size * max(4, dataset.dtype.itemsize) for dataset in used.values()), settings)
        values = _read_columns([columns[name] for name in names.values()], attributes, settings, rows)
        others = set(stated.rates_hz.values())
        doubts = [attributes.doubts(at.dataset, stated.rates_hz.get(name), others) for name, at in wanted.items()]
        flags = [flag(path, name, "suspect", detail) for name, detail in dict.fromkeys(chain(*doubts))]
        return stated.with_columns(names, values, flags=flags + undated)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except CrankorderError:
        raise
    except _H5PY_ERRORS as error:
        raise _damage(str(error).split("\n")[0], path.stat().st_size) from None


def _damage(said: str, size: int) -> InputError:
    """What the HDF5 library ``said`` of a file of ``size`` bytes, in plain words."""
    cut = re.search(r"eof = (\d+), .*stored_eof = (\d+)", said)
    if cut or size < _LEAST_BYTES:
        problem = f"truncated: {cut[1]} of {cut[2]} bytes" if cut else f"truncated: only {size} bytes are left"
        remedy = "Copy it again; if the original is as short, its writer was stopped before closing it"
        return InputError(problem, remedy=remedy)
    if "already open for write" in said:
        remedy = "Copy it after the recording has ended, or, at your own risk, run `h5clear --status` on a copy"
        return InputError("was not closed by its writer", remedy=remedy)
    return InputError("is a damaged HDF5 file", found=said, remedy="Copy it again from where it was recorded")


def _columns_of(file: Any, settings: IngestSettings) -> dict[str, _Column]:
    """Numeric columns of ``file`` by name, walked without following links; the walk is bounded in depth and number."""
    columns: dict[str, _Column] = {}
    seen: set[int] = set()
    stack: list[tuple[Any, int]] = [(file["/"], 0)]
    n_objects = 0
    while stack:
        group, depth = stack.pop()
        address = h5py.h5o.get_info(group.id).addr
        if address in seen:
            continue
        seen.add(address)
        if depth > _MAX_DEPTH:
            raise UnsafeInputError(f"groups are nested deeper than {_MAX_DEPTH}", place=group.name)
        for key in group:
            n_objects += 1
            if n_objects > settings.max_objects:
                raise UnsafeInputError(f"holds more than {settings.max_objects} objects")
            link = group.id.links.get_info(key.encode("utf-8", "surrogateescape")).type
            if link == h5py.h5l.TYPE_EXTERNAL:
                place, remedy = f"{group.name.rstrip('/')}/{key}", "Write the samples into the file itself"
                raise UnsafeInputError("links to another file, which is never followed", place=place, remedy=remedy)
            child = group[key] if link == h5py.h5l.TYPE_HARD else None
            if isinstance(child, h5py.Group):
                stack.append((child, depth + 1))
            elif isinstance(child, h5py.Dataset):
                columns.update(_columns_in(child, settings))
    return dict(sorted(columns.items()))


def _columns_in(dataset: Any, settings: IngestSettings) -> dict[str, _Column]:
    place, shape = dataset.name, dataset.shape
    name = place.lstrip("/")
    if dataset.dtype.kind not in "iufb" or shape is None or len(shape) not in (1, 2):
        return {}
    if len(shape) == 1:
        return {name: _Column(place, dataset, None, int(shape[0]))}
    n_columns, n_samples = sorted(int(length) for length in shape)
    if n_columns == 1:
        return {name: _Column(place, dataset, 0, n_samples)}
    if n_columns > min(settings.max_objects, 1000):
        return {}
    return {f"{name}[{index}]": _Column(place, dataset, index, n_samples) for index in range(n_columns)}


def _check_dataset(dataset: Any) -> None:
    """Refuse storage outside the file, virtual datasets, filters that need a plugin, and unwritten blocks."""
    place, create = dataset.name, dataset.id.get_create_plist()
    if create.get_external_count() or dataset.is_virtual:
        own = "keeps its samples in another file, which is never opened"
        problem = own if create.get_external_count() else "is put together from other files, which are never opened"
        raise UnsafeInputError(problem, place=place, remedy="Write them into the file itself")
    for code in (create.get_filter(number)[0] for number in range(create.get_nfilters())):
        if code not in _FILTERS:
            problem, allowed = f"needs filter {code}, which is not built in", ", ".join(_FILTERS.values())
            remedy = "Save the file again with gzip or without compression"
            raise InputError(problem, place=place, allowed=allowed, remedy=remedy)
    # HDF5 would read samples that were promised and never written as zeros
    if dataset.size and not dataset.chunks and not dataset.id.get_storage_size():
        raise InputError("no sample was ever written", place=place, remedy="Export the recording again")
    if dataset.chunks and dataset.size:
        expected = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
        if expected <= 10**9 and (written := dataset.id.get_num_chunks()) != expected:
            problem = f"missing data: {written} of {expected} blocks were written"
            raise InputError(problem, place=place, remedy="Export the recording again")


def _read_columns(
    columns: list[_Column], attributes: _Attributes, settings: IngestSettings, rows: slice | None
) -> list[FloatArray]:
    """Samples of ``columns``; equal lengths and types share one block, so that stacking them costs no copy."""
    parts = [part_of(column.n_samples, rows) for column in columns]
    types = [float_type_for(column.opened.dtype) for column in columns]
    kinds = [(part.stop - part.start, kind) for part, kind in zip(parts, types, strict=True)]
    room = rows_for(kinds, in_memory_bytes=settings.in_memory_bytes)
    for name, dataset in {column.dataset: column.opened for column in columns}.items():
        asked = [(column, row) for column, row in zip(columns, room, strict=True) if column.dataset == name]
        first = part_of(asked[0][0].n_samples, rows).start
        try:
            _read_into([(column.index, row) for column, row in asked], dataset, first)
        except _H5PY_ERRORS as error:
            problem = "damaged: the checksum or the compression of the samples is wrong"
            found = str(error).split("\n")[0]
            raise InputError(problem, place=dataset.name, found=found, remedy="Copy the file again") from None
        for column, row in asked:  # the packing conventions of NetCDF are undone: fill value, scale and offset
            fill = attributes.number(name, _FILLS, inherited=False)
            for part in blocks(row.size if fill is not None else 0):
                row[part][row[part] == row.dtype.type(fill)] = np.nan
            for packing, applied in ((_SCALE, np.multiply), (_OFFSET, np.add)):
                if (number := attributes.packing(column, packing)) is not None:
                    applied(row, number, out=row)
    return room


def _read_into(rows: list[tuple[int | None, FloatArray]], dataset: Any, first: int) -> None:
    """Fill ``rows``, each a column of ``dataset`` (None: it has no columns) from sample ``first`` on.

    In pieces where they lie on disk.
    """
    index, row = rows[0]
    if not row.size:
        return
    if len(rows) == 1 and index is None and dataset.dtype == row.dtype and not is_on_disk(row):
        dataset.read_direct(row, np.s_[first : first + row.size])
        return
    axis = 0 if index is None else int(np.argmax(dataset.shape))
    chunk = dataset.chunks[axis] if dataset.chunks else 1
    size = chunk * max(1, PIECE_BYTES // (chunk * row.itemsize)) if is_on_disk(row) else row.size
    for part in blocks(row.size, size=size):
        # a column of an interleaved table costs as much as the whole table: read that once
        there = slice(first + part.start, first + part.stop)
        piece = dataset[there] if axis == 0 else dataset[:, there]
        for index, row in rows:
            row[part] = piece if index is None else piece[:, index] if axis == 0 else piece[index]


class _Attributes:
    """What the attributes of a file's objects say, by the place of these; those of each object are read once."""

    def __init__(self, file: Any, opened: Mapping[str, Any]) -> None:
        """Of the objects of ``file``, some of which are ``opened`` already, by place."""
        self._file, self._opened = file, opened
        self._of: dict[str, dict[str, tuple[str, Any]]] = {}

    def rate_hz(self, place: str) -> float | None:
        """Samples per second that the attributes at ``place``, of a group above it or of the file state."""
        stated = next((rates for at in (place, *_above(place)) if (rates := self._rates_at(at))), {})
        value = next(iter(stated.values()), None)
        if value is not None and any(abs(other - value) > _SAME_RATE * abs(value) for other in stated.values()):
            found = ", ".join(f"{name}: {other:.9g} Hz" for name, other in stated.items())
            remedy = "Find out which is right, and remove the other"
            raise InputError("two sampling rates are stated", place=place, found=found, remedy=remedy)
        if value is not None and not (value > 0 and np.isfinite(value)):
            raise InputError("the sampling rate must be above 0", place=place, found=value)
        return value

    def packing(self, column: _Column, name: str) -> float | None:
        """The number that the attribute ``name`` of a dataset states for its ``column``, None without it.

        It may be written as text, or one for each column. Raises InputError where it is neither: the scale of the
        samples is then not known.
        """
        if name not in self._at(column.dataset):
            return None
        own, value = self._at(column.dataset)[name]
        numbers, n_columns = _numbers_in(value), 1 if column.index is None else min(column.opened.shape)
        if numbers.size in (1, n_columns) and np.isfinite(numbers).all():
            return float(numbers[column.index or 0 if numbers.size > 1 else 0])
        problem, found = f"its {own} is not a number", printable(repr(value), 60)
        remedy = "Mend the attribute, or export the samples as floats in their unit"
        raise InputError(problem, place=column.dataset, found=found, remedy=remedy)

    def doubts(self, place: str, rate_hz: float | None, others_hz: Collection[float]) -> Iterator[tuple[str, str]]:
        """Flags and details of what the attributes about ``place``, whose rate is ``rate_hz``, contradict or hide.

        A rate stated above it may be that of other datasets, ``others_hz``.
        """
        for name, value in (self._at(place)[name] for name in (_SCALE, _OFFSET) if name in self._at(place)):
            if _text_in(value) or np.size(value) > 1:
                kind = "text" if _text_in(value) else f"{np.size(value)} numbers, one for each column"
                yield "scale_unusual", f"{place}: its {name} is {kind}; taken as such"
        for above in _above(place):
            for name, other in self._rates_at(above).items():
                if rate_hz and other not in others_hz and abs(other - rate_hz) > _SAME_RATE * rate_hz:
                    detail = f"{place} states {rate_hz:.9g} Hz, {name} of {above} {other:.9g} Hz; the first is taken"
                    yield "header_rate_disagrees", detail

    def number(self, place: str, names: Sequence[str], *, inherited: bool = True) -> float | None:
        """First of the attributes ``names`` that is one number, at ``place``, else of its group, else of the file."""
        places = (place, *_above(place)) if inherited else (place,)
        values = (self._at(at)[name][1] for at in places for name in names if name in self._at(at))
        return next((float(numbers[0]) for value in values if (numbers := _numbers_in(value)).size == 1), None)

    def text(self, place: str, names: Sequence[str]) -> str:
        """First of the attributes ``names`` at ``place`` that is text, else ""."""
        texts = (_text_in(self._at(place)[name][1]) for name in names if name in self._at(place))
        return next((text for text in texts if text), "")

    def starts(self, places: Mapping[Any, str]) -> tuple[dict[Any, np.datetime64], dict[Any, float]]:
        """Dates of start, and times in s, that the attributes at each of ``places`` or of what is above it state."""
        dates: dict[Any, np.datetime64] = {}
        for key, place in places.items():
            with suppress(ValueError):
                dates[key] = np.datetime64(self.text(place, _DATES).strip().rstrip("Z"), "ns")
        clocks = {key: self.number(at, _CLOCKS, inherited=False) for key, at in places.items()}
        # a clock may count from anywhere, unlike a list of pulse times beside them
        first_s = min((clock for clock in clocks.values() if clock is not None), default=0.0)
        times: dict[Any, float] = {}
        for key, place in places.items():
            start, clock = self.number(place, _STARTS), clocks[key]
            if start is not None or clock is not None:
                times[key] = (start or 0.0) + (first_s if clock is None else clock) - first_s
        return {key: date for key, date in dates.items() if not np.isnat(date)}, times

    def _rates_at(self, place: str) -> dict[str, float]:
        """Samples per second that rates and time steps stated at ``place`` mean, by their names."""
        rates: dict[str, float] = {}
        for plain in (*_RATES, *_STEPS):
            name, value = self._at(place).get(plain, ("", ""))
            if (numbers := _numbers_in(value)).size == 1:
                number = float(numbers[0])
                rates[name] = number if plain in _RATES else 1.0 / number if number else 0.0
        return rates

    def _at(self, place: str) -> dict[str, tuple[str, Any]]:
        """Name and value of each attribute of the object at ``place``, by its plain name."""
        if place not in self._of:
            self._of[place] = _read_attributes(self._opened[place] if place in self._opened else self._file[place])
        return self._of[place]


def _above(place: str) -> tuple[str, str]:
    """Places of the group of the object at ``place`` and of the whole file."""
    return place.rpartition("/")[0] or "/", "/"


def _text_in(value: Any) -> str:
    """The text that an attribute's ``value`` is, empty where it is none."""
    texts = np.asarray(value).reshape(-1)
    text = texts[0] if texts.size == 1 and texts.dtype.kind in "SUO" else ""
    text = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    return re.sub(r"\0.*", "", text) if isinstance(text, str) else ""


def _numbers_in(value: Any) -> Floats:
    """The numbers that an attribute's ``value`` is, or says as text in Hz or s ("51.2 kHz"); empty of other text."""
    numbers = np.asarray(value).reshape(-1)
    if numbers.dtype.kind in "iuf":
        return numbers.astype(np.float64)
    match = _TEXT_NUMBER.fullmatch(_text_in(value).strip())
    return np.array([float(match[1]) * _PREFIXES[match[2] or ""]] if match else [], dtype=np.float64)


def _read_attributes(place: h5py.Group | h5py.Dataset) -> dict[str, tuple[str, Any]]:
    """Name and value by plain name of the attributes at ``place`` that can be read and are asked for.

    Others may be large. Single numbers that lie in a group as datasets of their own count too, as MATLAB and scripts
    write them; nothing is loaded or followed to read these.
    """
    found: dict[str, tuple[str, Any]] = {}
    with suppress(*_H5PY_ERRORS):
        for name in [name for name in place if _plain(name) in _ALONE] if isinstance(place, h5py.Group) else []:
            dataset = place[name] if isinstance(place.get(name, getlink=True), h5py.HardLink) else None
            if not isinstance(dataset, h5py.Dataset) or dataset.size != 1 or dataset.dtype.kind not in "iuf":
                continue
            create = dataset.id.get_create_plist()
            if not (create.get_external_count() or create.get_nfilters() or dataset.is_virtual):
                found[_plain(name)] = name, dataset[()]
    with suppress(*_H5PY_ERRORS):
        for name in [name for name in place.attrs if _plain(name) in _ASKED]:
            with suppress(*_H5PY_ERRORS):
                found[_plain(name)] = name, place.attrs[name]
    return found
