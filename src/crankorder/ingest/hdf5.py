"""HDF5 and NetCDF-4 files: read-only, without locks, without following anything that leads out of the file."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from crankorder.errors import CrankorderError, InputError, UnsafeInputError, printable
from crankorder.ingest.rawfile import (
    HDF5_SIGNATURE,
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
from crankorder.quantities import QualityFlag
from crankorder.scratch import blocks, is_on_disk
from crankorder.settings import IngestSettings

_MAX_DEPTH = 32
PIECE_BYTES = 1 << 22
"""Bytes of a column read at a time where it goes to disk; whole chunks, and at least one."""

# deflate, shuffle, fletcher32, szip, nbit, scaleoffset, lzf: all others would load code from a plugin folder
_FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 4: "szip", 5: "nbit", 6: "scaleoffset", 32000: "lzf"}
# as loggers write them, in whatever case and with whatever between the words
_RATE_NAMES = (
    "rate_hz", "sample_rate_hz", "sample_rate", "sampling_rate", "sampling_rate_hz", "sampling_frequency",
    "sampling_frequency_hz", "sample_frequency", "sample_freq", "samp_freq", "fs", "fs_hz",
)  # fmt: skip
_STEP_NAMES = (
    "wf_increment", "dt", "dt_s", "delta_t", "increment_s", "time_step", "sample_interval", "sampling_interval",
)  # fmt: skip
_SPEED_NAMES = ("speed_rpm", "rpm", "shaft_speed_rpm", "nominal_rpm", "engine_speed_rpm")
_UNIT_NAMES = ("units", "unit", "unit_string")
_START_NAMES = ("start_s", "wf_start_offset")
_CLOCK_NAMES = ("t0", "t0_s", "start_time", "start_time_s", "start_offset_s", "time_offset_s")
_DATE_NAMES = ("wf_start_time", "start_time")
_TIME_NAMES = (_START_NAMES, _CLOCK_NAMES, _DATE_NAMES)
_PACKING_NAMES = ("_FillValue", "missing_value", "scale_factor", "add_offset")
_TEXT_NUMBER = re.compile(r"([+-]?[0-9.]{1,30}(?:[eE][+-]?[0-9]{1,3})?)\s*([kMmµu]?)(?:Hz|S/s|s|sec)?")
_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "m": 1e-3, "µ": 1e-6, "u": 1e-6}
_SAME_RATE = 1e-4  # a time step is often written with few decimals


def _plain(name: str) -> str:
    """``name`` of an attribute without case and without what stands between its words."""
    return re.sub("[^a-z0-9]", "", name.lower())


# each name that is asked for as it is known without case
_PLAIN = {
    name: _plain(name)
    for names in (_RATE_NAMES, _STEP_NAMES, _SPEED_NAMES, _UNIT_NAMES, *_TIME_NAMES, _PACKING_NAMES)
    for name in names
}
_ASKED = frozenset(_PLAIN.values())
_ALONE = frozenset(_plain(name) for names in (_RATE_NAMES, _STEP_NAMES, _SPEED_NAMES) for name in names)
# an exception of h5py on a damaged file may be any of these
_H5PY_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError, IndexError)


_Value = str | bytes | float | np.generic | NDArray[np.generic]
"""Value of an attribute as h5py gives it."""


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
        stated, attributes, undated = _stated(file, wanted, used, path)
        if not names:
            speeds = (attributes.number(dataset, _SPEED_NAMES) for dataset in used)
            return replace(stated, speed_rpm=next((rpm for rpm in speeds if rpm), None)).with_columns({}, ())
        check_budget(sum(dataset.size * max(4, dataset.dtype.itemsize) for dataset in used.values()), settings)
        values = _read_columns([columns[name] for name in names.values()], used, attributes, settings, rows)
        others = set(stated.rates_hz.values())
        doubts = [attributes.doubts(at.dataset, stated.rates_hz.get(name), others) for name, at in wanted.items()]
        flags = [flag(path, name, "suspect", detail) for name, detail in dict.fromkeys(chain(*doubts))]
        return stated.with_columns(names, values, flags=flags + undated)


def _stated(
    file: Any, columns: Mapping[str, _Column], opened: Mapping[str, Any], path: Path
) -> tuple[Contents, _Attributes, list[QualityFlag]]:
    """What the attributes of ``file`` say of ``columns``, these attributes, and flags of unset clocks.

    ``opened`` are the datasets of the columns by place, which are checked first.
    """
    for dataset in opened.values():
        _check_dataset(dataset)
    attributes = _Attributes(file, opened)
    starts, undated = starts_by_date(*attributes.starts({name: at.dataset for name, at in columns.items()}), path)
    described = {
        name: Described(
            at.n_samples, attributes.text(at.dataset, _UNIT_NAMES), attributes.rate_hz(at.dataset), starts.get(name)
        )
        for name, at in columns.items()
    }
    return Contents.of("HDF5", described), attributes, undated


def _known(numbers: Mapping[Any, float | None]) -> dict[Any, float]:
    return {name: number for name, number in numbers.items() if number is not None}


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    _check_superblock(path)
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except CrankorderError:
        raise
    except _H5PY_ERRORS as error:
        raise InputError(
            "is a damaged HDF5 file", found=str(error).split("\n")[0], remedy="Copy it again from where it was recorded"
        ) from None


def _check_superblock(path: Path) -> None:
    """Say in plain words that a file is cut short or was never closed, before the HDF5 library says it in its own."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(8192)
    base = next((start for start in (0, 512, 1024, 2048, 4096) if head[start : start + 8] == HDF5_SIGNATURE), 0)
    block = head[base : base + 96]
    version = block[8] if len(block) > 8 else 0
    offset = {0: 40, 1: 44}.get(version, 28)
    wide = block[13 if version < 2 else 9 : 14 if version < 2 else 10] in (b"\x08", b"")
    if len(block) < offset + 8:
        raise InputError(f"truncated: only {size} bytes are left of an HDF5 file", remedy="Copy it again")
    end = struct.unpack_from("<Q", block, offset)[0] if wide else 0
    if version >= 3 and block[11] & 0b101:
        raise InputError(
            "was not closed by its writer",
            remedy="Copy it after the recording has ended, or, at your own risk, run `h5clear --status` on a copy",
        )
    if wide and size < end < 2**62:
        raise InputError(
            f"truncated: {size} of {end} bytes",
            remedy="Copy it again; if the original is as short, its writer was stopped before closing it",
        )


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
                raise UnsafeInputError(
                    "links to another file, which is never followed",
                    place=f"{group.name.rstrip('/')}/{key}",
                    remedy="Write the samples into the file itself",
                )
            if link != h5py.h5l.TYPE_HARD:
                continue
            child = group[key]
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
    for number in range(create.get_nfilters()):
        code = create.get_filter(number)[0]
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
    columns: list[_Column],
    used: Mapping[str, Any],
    attributes: _Attributes,
    settings: IngestSettings,
    rows: slice | None,
) -> list[FloatArray]:
    """Samples of ``columns``; equal lengths and types share one block, so that stacking them costs no copy."""
    parts = [part_of(column.n_samples, rows) for column in columns]
    types = [float_type_for(used[column.dataset].dtype) for column in columns]
    kinds = [(part.stop - part.start, kind) for part, kind in zip(parts, types, strict=True)]
    room = rows_for(kinds, in_memory_bytes=settings.in_memory_bytes)
    for name, dataset in used.items():
        asked = [(column, row) for column, row in zip(columns, room, strict=True) if column.dataset == name]
        first = part_of(asked[0][0].n_samples, rows).start
        try:
            _read_into([(column.index, row) for column, row in asked], dataset, first)
        except _H5PY_ERRORS as error:
            raise InputError(
                "damaged: the checksum or the compression of the samples is wrong",
                place=dataset.name,
                found=str(error).split("\n")[0],
                remedy="Copy the file again",
            ) from None
        for column, row in asked:
            n_columns = 1 if column.index is None else min(dataset.shape)
            _unpack(row, name, column.index or 0, n_columns, attributes)
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


def _unpack(row: FloatArray, place: str, index: int, n_columns: int, attributes: _Attributes) -> None:
    """Undo the packing conventions of NetCDF: fill value, scale and offset of one of the columns of a dataset."""
    fill = attributes.number(place, ("_FillValue", "missing_value"), inherited=False)
    if fill is not None:
        for part in blocks(row.size):
            row[part][row[part] == row.dtype.type(fill)] = np.nan
    for name, applied in (("scale_factor", np.multiply), ("add_offset", np.add)):
        if (number := attributes.packing(place, name, index, n_columns)) is not None:
            applied(row, number, out=row)


class _Attributes:
    """What the attributes of a file's objects say, by the place of these; those of each object are read once."""

    def __init__(self, file: Any, opened: Mapping[str, Any]) -> None:
        """Of the objects of ``file``, some of which are ``opened`` already, by place."""
        self._file, self._opened = file, opened
        self._of: dict[str, tuple[dict[str, _Value], dict[str, float]]] = {}

    def rate_hz(self, place: str) -> float | None:
        """Samples per second that the attributes at ``place``, of a group above it or of the file state."""
        stated = _as_rates(self._numbers(place, (*_RATE_NAMES, *_STEP_NAMES)))
        value = next(iter(stated.values()), None)
        if value is not None and any(abs(other - value) > _SAME_RATE * abs(value) for other in stated.values()):
            found = ", ".join(f"{name}: {other:.9g} Hz" for name, other in stated.items())
            remedy = "Find out which is right, and remove the other"
            raise InputError("two sampling rates are stated", place=place, found=found, remedy=remedy)
        if value is not None and not (value > 0 and np.isfinite(value)):
            raise InputError("the sampling rate must be above 0", place=place, found=value)
        return value

    def packing(self, place: str, name: str, index: int, n_columns: int) -> float | None:
        """The number that the attribute ``name`` at ``place`` states for column ``index``, None without it.

        It may be written as text, or one for each column. Raises InputError where it is neither: the scale of the
        samples is then not known.
        """
        value = self._at(place)[0].get(_PLAIN[name])
        if value is None:
            return None
        with suppress(TypeError, ValueError, UnicodeDecodeError):
            numbers = np.atleast_1d(_number_in(value))
            if numbers.ndim == 1 and numbers.size in (1, n_columns) and np.isfinite(numbers).all():
                return float(numbers[index if numbers.size > 1 else 0])
        problem, found = f"its {name} is not a number", printable(repr(value), 60)
        remedy = "Mend the attribute, or export the samples as floats in their unit"
        raise InputError(problem, place=place, found=found, remedy=remedy)

    def doubts(self, place: str, rate_hz: float | None, others_hz: Collection[float]) -> Iterator[tuple[str, str]]:
        """Flags and details of what the attributes about ``place``, whose rate is ``rate_hz``, contradict or hide.

        A rate stated above it may be that of other datasets, ``others_hz``.
        """
        for name in ("scale_factor", "add_offset"):
            value = self._at(place)[0].get(_PLAIN[name])
            if value is not None and (isinstance(value, (bytes, str)) or np.size(value) > 1):
                kind = "text" if isinstance(value, (bytes, str)) else f"{np.size(value)} numbers, one for each column"
                yield "scale_unusual", f"{place}: its {name} is {kind}; taken as such"
        for above in (place.rpartition("/")[0] or "/", "/"):
            for name, other in _as_rates(self._numbers_at(above, (*_RATE_NAMES, *_STEP_NAMES))).items():
                if rate_hz and other not in others_hz and abs(other - rate_hz) > _SAME_RATE * rate_hz:
                    yield (
                        "header_rate_disagrees",
                        f"{place} states {rate_hz:.9g} Hz, {name} of {above} {other:.9g} Hz; the first is taken",
                    )

    def number(self, place: str, names: Sequence[str], *, inherited: bool = True) -> float | None:
        """First of the attributes ``names`` that is one number, at ``place``, else of its group, else of the file."""
        return next(iter(self._numbers(place, names, inherited=inherited).values()), None)

    def starts(self, places: Mapping[Any, str]) -> tuple[dict[Any, np.datetime64], dict[Any, float]]:
        """Dates of start, and times in s, that the attributes at each of ``places`` or of what is above it state."""
        dates: dict[Any, np.datetime64] = {}
        for key, place in places.items():
            with suppress(ValueError):
                dates[key] = np.datetime64(self.text(place, _DATE_NAMES).strip().rstrip("Z"), "ns")
        times = _known({key: self.number(place, _START_NAMES) for key, place in places.items()})
        # may count from anywhere, unlike a list of pulse times beside them
        clock = _known({key: self.number(place, _CLOCK_NAMES, inherited=False) for key, place in places.items()})
        late = {key: time_s - min(clock.values()) for key, time_s in clock.items()}
        times |= {key: times.get(key, 0.0) + late_s for key, late_s in late.items()}
        return {key: date for key, date in dates.items() if not np.isnat(date)}, times

    def _numbers(self, place: str, names: Sequence[str], *, inherited: bool = True) -> dict[str, float]:
        """All of these attributes by name, of the first place that has any."""
        places = [place, place.rpartition("/")[0] or "/", "/"] if inherited else [place]
        return next((found for place in places if (found := self._numbers_at(place, names))), {})

    def _numbers_at(self, place: str, names: Sequence[str]) -> dict[str, float]:
        numbers = self._at(place)[1]
        return {name: numbers[_PLAIN[name]] for name in names if _PLAIN[name] in numbers} if numbers else {}

    def text(self, place: str, names: Sequence[str]) -> str:
        """First of the attributes ``names`` at ``place`` that is text, else ""."""
        attrs = self._at(place)[0]
        for name in names:
            value = attrs.get(_PLAIN[name])
            if isinstance(value, np.ndarray) and value.size == 1:
                value = value.reshape(-1)[0]
            if isinstance(value, bytes):
                value = value.decode("utf-8", "replace")
            if isinstance(value, str):
                return re.sub(r"\0.*", "", value)
        return ""

    def _at(self, place: str) -> tuple[dict[str, _Value], dict[str, float]]:
        """Attributes of the object at ``place``, and those of them that are one number."""
        if place not in self._of:
            attrs = _readable(self._opened[place] if place in self._opened else self._file[place])
            numbers = {name: number for name, value in attrs.items() if (number := _number_of(value)) is not None}
            self._of[place] = attrs, numbers
        return self._of[place]


def _as_rates(stated: dict[str, float]) -> dict[str, float]:
    """Samples per second that rates and time steps ``stated`` mean, by name."""
    return {name: value if name in _RATE_NAMES else 1.0 / value if value else 0.0 for name, value in stated.items()}


def _number_of(value: Any) -> float | None:
    """The one number that an attribute's ``value`` is, or says as text; None where it is none."""
    if value is None or np.size(value) != 1:
        return None
    with suppress(TypeError, ValueError, UnicodeDecodeError):
        return float(np.asarray(_number_in(value), dtype=np.float64).reshape(()))
    return None


def _number_in(value: Any) -> Any:
    """``value`` of an attribute as numbers, where it is text those that it says in Hz or s: "51.2 kHz"."""
    if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "SUO":
        value = value.reshape(-1)[0]
    if isinstance(value, bytes):
        value = value.decode("utf-8")
    if not isinstance(value, str):
        if np.asarray(value).dtype.kind not in "iuf":
            raise TypeError("no number")
        return np.asarray(value, dtype=np.float64)
    match = _TEXT_NUMBER.fullmatch(value.strip(" \0"))
    if match is None:
        raise ValueError("no number")
    return float(match[1]) * _PREFIXES[match[2] or ""]


def _readable(place: h5py.Group | h5py.Dataset) -> dict[str, _Value]:
    """Attributes at ``place`` that can be read, of those that are asked for here: others may be large."""
    attributes: dict[str, _Value] = {}
    try:
        names = {name: plain for name in place.attrs if (plain := _plain(name)) in _ASKED}
    except _H5PY_ERRORS:
        return attributes
    for name, plain in names.items():
        with suppress(*_H5PY_ERRORS):
            attributes[plain] = place.attrs[name]
    return {**_numbers_beside(place), **attributes} if isinstance(place, h5py.Group) else attributes


def _numbers_beside(group: h5py.Group) -> dict[str, float]:
    """Single numbers of such names that lie in ``group`` as datasets of their own, as MATLAB and scripts write them."""
    numbers: dict[str, float] = {}
    with suppress(*_H5PY_ERRORS):
        for name in [name for name in group if _plain(name) in _ALONE]:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            dataset = group[name]
            if not isinstance(dataset, h5py.Dataset) or dataset.size != 1 or dataset.dtype.kind not in "iuf":
                continue
            create = dataset.id.get_create_plist()  # nothing is loaded or followed to read the value
            if not (create.get_external_count() or create.get_nfilters() or dataset.is_virtual):
                numbers[_plain(name)] = float(np.asarray(dataset[()]).reshape(-1)[0])
    return numbers
