"""IDE recordings (enDAQ, Slam Stick), read by idelib in a process of its own."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.errors import InputError
from crankorder.ingest.child import in_child, package
from crankorder.ingest.rawfile import Contents, Described, RawFile, Source, by_distinct_name, check_budget, named
from crankorder.ingest.sampling import TimeColumn, read_time_column
from crankorder.quantities import QualityFlag
from crankorder.settings import IngestSettings

_US = 1e-6
_JITTER = 8.0
"""Samples that a stamp may lie off an even grid: a sensor's own clock wanders so much against that of the recorder."""
_MOST_PER_BYTE = 8
"""Bytes of samples that a byte of the file may become: nothing in it is compressed."""
_ROUGH = 0.5
"""Samples off an even grid from which on lines are smeared."""


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for, by name or number from 0, from the IDE file at ``path``, calibrated.

    The stamps of a sensor's blocks give its rate; blocks that are missing are NaN. ``settings`` give the byte limit.
    Raises InputError for damage or a missing name, EnvironmentFailure where idelib is missing, UnsafeInputError where
    the parser goes beyond its limits.
    """
    parser = _parser()
    most = min(settings.max_bytes, _MOST_PER_BYTE * path.stat().st_size)
    columns, units, stamps, of_sensor = in_child(lambda: _read(parser, path, sources, settings), path, n_bytes=most)
    lenient = settings.model_copy(update={"max_time_jitter_samples": _JITTER})
    sensors = [read_time_column(times, path, settings=lenient) for times in stamps]
    timed = {source: sensors[place] for source, place in of_sensor.items()}
    return RawFile(
        columns={key: timed[key].on_grid(column) if key in timed else column for key, column in columns.items()},
        units=units,
        rates_hz={source: times.rate_hz for source, times in timed.items()},
        starts_s={source: times.start_s for source, times in timed.items()},
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


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names, lengths, units and rates of the channels of the IDE file at ``path``.

    ``settings`` are those of :func:`read`, whose errors it raises.
    """
    parser = _parser()
    return in_child(lambda: _contents(parser, path), path, n_bytes=path.stat().st_size)


def _parser() -> Any:
    return package("idelib", "IDE files", "Run: pip install 'crankorder[ide]'").importFile


def _channels(file: Any) -> Mapping[str, Any]:
    """Values over time, by name, of the channels that hold any, of the first session."""
    if len(file.sessions) > 1:
        raise InputError(
            f"holds {len(file.sessions)} sessions", file=file.filename, remedy="Export each to a file of its own"
        )
    parts = [part for channel in file.channels.values() for part in channel.subchannels]
    sessions = [(str(part.displayName or part.name), part.getSession()) for part in parts]
    return by_distinct_name([(name, values) for name, values in sessions if len(values)])


def _contents(parser: Any, path: Path) -> Contents:
    with parser(str(path), quiet=True) as file:
        channels = _channels(file)
        columns: dict[str, Described] = {}
        doubt = 0.0
        for name, values in channels.items():
            first, last = values.getInterval()
            columns[name] = Described(len(values), _unit(values))
            if len(values) > 2 and last > first:
                rate_hz = float(f"{(len(values) - 1) / (_US * (last - first)):.12g}")
                columns[name] = Described(len(values), _unit(values), rate_hz, _US * first)
                doubt = max(doubt, 2.0 * _JITTER / len(values))
        return Contents.of("IDE", columns, rate_uncertainty=doubt)


def _unit(values: Any) -> str:
    return html.unescape(str(values.units[1])) if values.units else ""


def _read(
    parser: Any, path: Path, sources: Sequence[Source], settings: IngestSettings
) -> tuple[dict[Source, Any], dict[Source, str], list[Any], dict[Source, int]]:
    """Columns and units by source, stamps of each sensor in s, sensor of each column (of a number none)."""
    columns: dict[Source, Any] = {}
    stamps: list[Any] = []
    of_sensor: dict[Source, int] = {}
    with parser(str(path), quiet=True) as file:
        channels = _channels(file)
        chosen = {source: channels[named(source, tuple(channels), path)] for source in sources}
        check_budget(sum(8 * len(values) for values in chosen.values()), settings)
        for source, channel in chosen.items():
            times, values = channel.arraySlice()
            columns[source] = np.array(values, dtype=np.float64)
            if values.size < 3:
                continue
            times_s = _US * np.array(times, dtype=np.float64)
            alike = (place for place, other in enumerate(stamps) if np.array_equal(other, times_s))
            of_sensor[source] = next(alike, len(stamps))
            stamps += [times_s] if of_sensor[source] == len(stamps) else []
        units = {source: unit for source, values in chosen.items() if (unit := _unit(values))}
    return columns, units, stamps, of_sensor
