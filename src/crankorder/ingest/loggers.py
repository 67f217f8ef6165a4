"""Files of loggers, read by packages of others in a process of its own: TDMS, MDF4 and IDE."""

from __future__ import annotations

import contextlib
import html
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.errors import InputError, printable
from crankorder.ingest.child import in_child, package
from crankorder.ingest.rawfile import (
    Contents,
    Described,
    FloatArray,
    RawFile,
    Source,
    by_distinct_name,
    check_budget,
    flag,
    float_type_for,
    names_of,
    starts_by_date,
)
from crankorder.ingest.sampling import TimeColumn, read_time_column
from crankorder.quantities import Floats, QualityFlag
from crankorder.settings import IngestSettings

_REALS = "iufb"
_MOST_PER_BYTE = 8
"""Bytes of samples that a byte of a TDMS or IDE file may become: integers are widened, nothing is compressed."""

_UNITS = ("unit_string", "NI_UnitDescription", "Unit", "unit", "units")
"""Properties of a TDMS channel that state its unit."""
_LEAD_IN, _OPEN = 28, 2**64 - 1
"""Bytes before each segment of a TDMS file, and the length of one that its writer never closed."""
_MIN_PRESENT = 0.9
"""Share of the stated bytes below which a cut TDMS file is refused; above it, it is used and flagged."""

_MASTERS = {1: ("time", "s"), 2: ("angle", "deg"), 4: ("index", "1")}
"""Name and unit of the stamps of an MDF4 group, by their kind."""
_MDF_JITTER = 0.25
"""Of a step, by which a stamp of an MDF4 group may lie off an even grid."""

_US = 1e-6
_IDE_JITTER = 8.0
"""Samples that an IDE stamp may lie off an even grid: a sensor's clock wanders so much against the recorder's."""
_ROUGH = 0.5
"""Samples off an even grid from which on lines are smeared."""


def read_tdms(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for from the TDMS file at ``path``, scaled as it says: ``"group/channel"``.

    A source is such a name, or a number from 0; the name of a channel alone does where the file has one group.
    ``settings`` give the byte limit. Raises InputError for damage or a missing name, EnvironmentFailure where nptdms is
    missing, UnsafeInputError where the parser goes beyond its limits.
    """
    parser = package("nptdms", "TDMS files", "Run: pip install 'crankorder[tdms]'").TdmsFile
    most = min(settings.max_bytes, _MOST_PER_BYTE * path.stat().st_size)
    stated, columns, flags = in_child(lambda: _tdms(parser, path, sources, settings), path, n_bytes=most)
    names = names_of(sources, stated.names, path)
    return stated.with_columns(names, [columns[name] for name in names.values()], flags=flags)


def _tdms_channels(file: Any) -> Mapping[str, Any]:
    """Channels of real numbers by name; the group is part of it where there are several."""
    groups = file.groups()
    channels = [
        (channel.name if len(groups) == 1 else f"{group.name}/{channel.name}", channel)
        for group in groups
        for channel in group.channels()
        if channel.data_type is not None and np.dtype(channel.dtype).kind in _REALS
    ]
    return by_distinct_name(channels)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and bool(np.isfinite(value))


def _tdms(
    parser: Any, path: Path, sources: Sequence[Source], settings: IngestSettings
) -> tuple[Contents, dict[str, FloatArray], list[QualityFlag]]:
    """What the file holds, columns by name, and flags of what it lacks of its end and of dates that were not set."""
    with _heard() as said, parser.open(path, raw_timestamps=True) as file:
        channels = _tdms_channels(file)
        names = dict.fromkeys(names_of(sources, tuple(channels), path).values())
        dates = {name: channels[name].properties.get("wf_start_time") for name in names or channels}
        stamps = {name: date.as_datetime64("ns") for name, date in dates.items() if hasattr(date, "as_datetime64")}
        offsets = {name: channel.properties.get("wf_start_offset") for name, channel in channels.items()}
        numbers = {name: float(offset) for name, offset in offsets.items() if _is_number(offset)}
        starts, undated = starts_by_date(stamps, numbers, path)
        described: dict[str, Described] = {}
        for name, channel in channels.items():
            unit = str(next((channel.properties[key] for key in _UNITS if key in channel.properties), ""))
            step = channel.properties.get("wf_increment")
            rate_hz = float(f"{1.0 / float(step):.12g}") if _is_number(step) and step > 0 else None
            described[name] = Described(len(channel), unit, rate_hz, starts.get(name))
        contents = Contents.of("TDMS", described)
        if not names:
            return contents, {}, []
        check_budget(sum(8 * contents.samples[name] for name in names), settings)
        read = {name: np.asarray(channels[name][:]) for name in names}
        columns = {name: values.astype(float_type_for(values.dtype), copy=False) for name, values in read.items()}
        stated = {name: len(channels[name]) for name in names}
        for name in names:  # with those that the last chunk states and lacks
            status = (file.file_status.channel_statuses or {}).get(channels[name].path)
            stated[name] += 0 if status is None else max(0, status.expected_length - status.read_length)
        cut = _cut(path, columns, stated, printable(" ".join(said.getvalue().split())))
        if cut and len(set(stated.values())) == 1:
            shortest = min(map(len, columns.values()))
            columns = {name: values[:shortest] for name, values in columns.items()}
        return contents, columns, cut + undated


def _cut(path: Path, columns: Mapping[str, FloatArray], stated: dict[str, int], said: str) -> list[QualityFlag]:
    """Flag of what ``path`` lacks of its end, none where it is whole; ``columns`` of ``stated`` lengths are in it.

    ``said`` is what nptdms told of it. Raises InputError where too much is lacking.
    """
    size, end = path.stat().st_size, _stated_bytes(path)
    if end == size:
        return []
    there, all_of_it = min(map(len, columns.values())), max(stated.values())
    samples = f"{there} samples are there" + (f" of {all_of_it} or more" if all_of_it > there else "")
    lacks = f"truncated: {size} of {end} bytes: {samples}"
    if end is None:
        lacks = f"truncated: its last segment was not written to its end: {samples}, and more may be lost"
    elif size < _MIN_PRESENT * end:
        raise InputError(lacks, found=said or None, remedy="Copy it again")
    return [flag(path, "missing_data", "suspect", f"{lacks} ({said})" if said else lacks)]


def _stated_bytes(path: Path) -> int | None:
    """Bytes that the segments of ``path`` say it has; None where the last was never closed, or lacks its lead-in."""
    size, place = path.stat().st_size, 0
    with path.open("rb") as file:
        while place < size:
            file.seek(place)
            lead_in = file.read(_LEAD_IN)
            length = int.from_bytes(lead_in[12:20], "big" if lead_in[4:5] and lead_in[4] & 64 else "little")
            if len(lead_in) < _LEAD_IN or length == _OPEN:
                return None
            place += _LEAD_IN + length
    return place


@contextlib.contextmanager
def _heard() -> Iterator[io.StringIO]:
    """What nptdms logs meanwhile, as text; nothing of it goes to the terminal."""
    from nptdms.log import log_manager

    said, handler = io.StringIO(), log_manager.console_handler
    before, handler.stream = handler.stream, said
    try:
        yield said
    finally:
        handler.stream = before


@dataclass(frozen=True, slots=True)
class _Place(Described):
    """What a channel is and where it lies: its group, and its number there (-1: the master)."""

    group: int = 0
    number: int = -1


def read_mdf(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for, by name or number from 0, from the MDF4 file at ``path``, converted.

    The stamps of a group are a column too: ``"time"`` in s or ``"angle"`` in degrees; names that come again have a
    number behind them. The rate is that of even stamps. ``settings`` give the byte limit. Invalid samples are NaN.
    Raises InputError for damage or a missing name, EnvironmentFailure where asammdf is missing, UnsafeInputError where
    the parser goes beyond its limits.
    """
    parser = package("asammdf", "MDF4 files", "Run: pip install 'crankorder[mdf]'").MDF
    places = in_child(lambda: _places(parser, path), path, n_bytes=path.stat().st_size)
    stated, names = Contents.of("MDF4", places), names_of(sources, tuple(places), path)
    if not names:
        return stated.with_columns({}, ())
    n_bytes = sum(8 * (places[name].n_samples or 0) for name in names.values())
    check_budget(n_bytes, settings)
    wanted = {name: places[name] for name in names.values()}
    columns = in_child(lambda: _mdf(parser, path, wanted), path, n_bytes=n_bytes)
    return stated.with_columns(names, [columns[name] for name in names.values()])


def _places(parser: Any, path: Path) -> dict[str, _Place]:
    places: list[tuple[str, _Place]] = []
    with parser(str(path)) as file:
        for group, members in enumerate(file.groups):
            n_samples = int(members.channel_group.cycles_nr)
            master = file.masters_db.get(group)
            if not n_samples:
                continue
            kind = int(members.channels[master].sync_type) if master is not None else 0
            rate_hz, start_s = None, 0.0
            if kind in _MASTERS:
                name, unit = _MASTERS[kind]
                if kind == 1:
                    stamps = np.asarray(file.get_master(group), dtype=np.float64)
                    rate_hz = _even_rate(stamps)
                    start_s = float(stamps[0]) if rate_hz is not None else 0.0
                places.append((name, _Place(n_samples, unit, None, start_s, group)))
            for number, channel in enumerate(members.channels):
                first = None if number == master else _samples(file, channel.name, group, number, most=1)
                if first is not None:
                    unit = str(channel.unit or "")
                    places.append((str(channel.name), _Place(n_samples, unit, rate_hz, start_s, group, number)))
    return by_distinct_name(places)


def _even_rate(stamps: Floats) -> float | None:
    """Samples per second of even ``stamps``, None where they are not."""
    if stamps.size < 3 or not np.isfinite(stamps).all() or not stamps[-1] > stamps[0]:
        return None
    step = (stamps[-1] - stamps[0]) / (stamps.size - 1)
    off = np.abs(stamps - stamps[0] - step * np.arange(stamps.size)).max()
    return float(f"{1.0 / step:.12g}") if off < _MDF_JITTER * step else None


def _samples(file: Any, name: str, group: int, number: int, *, most: int | None = None) -> FloatArray | None:
    """Samples of a channel, NaN where the file calls them invalid; None where they are no real numbers."""
    signal = file.get(name, group=group, index=number, ignore_invalidation_bits=True, record_count=most, raw=False)
    values = np.asarray(signal.samples)
    if values.ndim != 1 or values.dtype.kind not in _REALS:
        return None
    samples: FloatArray = values.astype(float_type_for(values.dtype))
    invalid = getattr(signal, "invalidation_bits", None)
    if invalid is not None and np.size(invalid) == samples.size:
        samples[np.asarray(invalid, dtype=bool)] = np.nan
    return samples


def _mdf(parser: Any, path: Path, wanted: dict[str, _Place]) -> dict[str, FloatArray]:
    """Columns by name."""
    columns: dict[str, FloatArray] = {}
    with parser(str(path)) as file:
        for name, place in wanted.items():
            channels = file.groups[place.group].channels
            if place.number >= 0:
                column = _samples(file, channels[place.number].name, place.group, place.number)
                assert column is not None  # its first sample was a real number
            else:
                stated = str(channels[file.masters_db[place.group]].unit).strip().lower()
                column = np.asarray(file.get_master(place.group), dtype=np.float64)
                if place.unit == "deg" and stated in ("rad", "radian", "radians", ""):
                    column = np.rad2deg(column)
            columns[name] = column
    return columns


def read_ide(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for, by name or number from 0, from the IDE file at ``path``, calibrated.

    The stamps of a sensor's blocks give its rate; blocks that are missing are NaN. ``settings`` give the byte limit.
    Raises InputError for damage or a missing name, EnvironmentFailure where idelib is missing, UnsafeInputError where
    the parser goes beyond its limits.
    """
    parser = package("idelib", "IDE files", "Run: pip install 'crankorder[ide]'").importFile
    most = min(settings.max_bytes, _MOST_PER_BYTE * path.stat().st_size)
    stated, columns, stamps, of_sensor = in_child(lambda: _ide(parser, path, sources, settings), path, n_bytes=most)
    lenient = settings.model_copy(update={"max_time_jitter_samples": _IDE_JITTER})
    sensors = [read_time_column(times, path, settings=lenient) for times in stamps]
    timed = {name: sensors[place] for name, place in of_sensor.items()}
    columns = {name: timed[name].on_grid(column) if name in timed else column for name, column in columns.items()}
    names = names_of(sources, stated.names, path)
    return replace(
        stated.with_columns(names, [columns[name] for name in names.values()]),
        rates_hz={source: timed[name].rate_hz for source, name in names.items() if name in timed},
        starts_s={source: timed[name].start_s for source, name in names.items() if name in timed},
        rate_uncertainty=max((times.rate_uncertainty for times in sensors), default=0.0),
        flags=[remark for times in sensors for remark in _graded(times)],
    )


def _graded(times: TimeColumn) -> list[QualityFlag]:
    """Flags of ``times``; stamps that wander further than lines bear are suspect."""
    off = 0.5 * times.rate_uncertainty * (times.n_rows - 1)
    wander = f"the sensor's clock wanders against the recorder's by up to {off:.2g} samples; a uniform grid is used"
    for remark in times.flags:
        if remark["flag"] == "time_jitter" and off > _ROUGH:
            remark["severity"], remark["detail"] = "suspect", wander
    return times.flags


def _ide(
    parser: Any, path: Path, sources: Sequence[Source], settings: IngestSettings
) -> tuple[Contents, dict[str, FloatArray], list[Floats], dict[str, int]]:
    """What the file holds, columns by name, stamps of each sensor in s, sensor of each column (of a number none)."""
    described: dict[str, Described] = {}
    columns: dict[str, FloatArray] = {}
    stamps: list[Floats] = []
    of_sensor: dict[str, int] = {}
    with parser(str(path), quiet=True) as file:
        if len(file.sessions) > 1:
            remedy = "Export each to a file of its own"
            raise InputError(f"holds {len(file.sessions)} sessions", file=file.filename, remedy=remedy)
        parts = [part for channel in file.channels.values() for part in channel.subchannels]
        sessions = [(str(part.displayName or part.name), part.getSession()) for part in parts]
        channels = by_distinct_name([(name, values) for name, values in sessions if len(values)])
        doubt = 0.0
        for name, values in channels.items():
            unit = html.unescape(str(values.units[1])) if values.units else ""
            first, last = values.getInterval()
            described[name] = Described(len(values), unit)
            if len(values) > 2 and last > first:
                rate_hz = float(f"{(len(values) - 1) / (_US * (last - first)):.12g}")
                described[name] = Described(len(values), unit, rate_hz, _US * first)
                doubt = max(doubt, 2.0 * _IDE_JITTER / len(values))
        chosen = dict.fromkeys(names_of(sources, tuple(channels), path).values())
        check_budget(sum(8 * len(channels[name]) for name in chosen), settings)
        for name in chosen:
            times, values = channels[name].arraySlice()
            columns[name] = np.array(values, dtype=np.float64)
            if values.size >= 3:
                times_s = _US * np.array(times, dtype=np.float64)
                alike = (place for place, other in enumerate(stamps) if np.array_equal(other, times_s))
                of_sensor[name] = next(alike, len(stamps))
                stamps += [times_s] if of_sensor[name] == len(stamps) else []
    return Contents.of("IDE", described, rate_uncertainty=doubt), columns, stamps, of_sensor
