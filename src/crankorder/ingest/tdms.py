"""TDMS files (National Instruments), read by nptdms in a process of its own."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
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
from crankorder.quantities import QualityFlag
from crankorder.settings import IngestSettings

_UNITS = ("unit_string", "NI_UnitDescription", "Unit", "unit", "units")
_REALS = "iufb"
_MOST_PER_BYTE = 8
"""Bytes of samples that a byte of the file may become: its integers are widened, nothing is compressed."""

_LEAD_IN, _OPEN = 28, 2**64 - 1
"""Bytes before each segment, and the length of one that its writer never closed."""

_MIN_PRESENT = 0.9
"""Share of the stated bytes below which a cut recording is refused; above it, it is used and flagged."""


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for from the TDMS file at ``path``, scaled as it says: ``"group/channel"``.

    A source is such a name, or a number from 0; the name of a channel alone does where the file has one group.
    ``settings`` give the byte limit. Raises InputError for damage or a missing name, EnvironmentFailure where nptdms is
    missing, UnsafeInputError where the parser goes beyond its limits.
    """
    parser = _parser()
    most = min(settings.max_bytes, _MOST_PER_BYTE * path.stat().st_size)
    stated, columns, cut, undated = in_child(lambda: _read(parser, path, sources, settings), path, n_bytes=most)
    names = names_of(sources, stated.names, path)
    if cut is not None and cut.share < _MIN_PRESENT:
        raise InputError(f"truncated: {cut.words}", found=printable(cut.said) or None, remedy="Copy it again")
    said = "" if cut is None or not cut.said else f" ({printable(cut.said)})"
    flags = [] if cut is None else [flag(path, "missing_data", "suspect", f"truncated: {cut.words}{said}")]
    return stated.with_columns(names, [columns[name] for name in names.values()], flags=flags + undated)


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names, lengths, units and rates of the channels of real numbers in the TDMS file at ``path``.

    ``settings`` are those of :func:`read`, whose errors it raises.
    """
    parser = _parser()

    def look() -> Contents:
        with parser.open(path, raw_timestamps=True) as file:
            return _contents(channels := _channels(file), channels, path)[0]

    return in_child(look, path, n_bytes=0)


def _parser() -> Any:
    return package("nptdms", "TDMS files", "Run: pip install 'crankorder[tdms]'").TdmsFile


def _channels(file: Any) -> Mapping[str, Any]:
    """Channels of real numbers by name; the group is part of it where there are several."""
    groups = file.groups()
    channels = [
        (channel.name if len(groups) == 1 else f"{group.name}/{channel.name}", channel)
        for group in groups
        for channel in group.channels()
        if channel.data_type is not None and np.dtype(channel.dtype).kind in _REALS
    ]
    return by_distinct_name(channels)


def _contents(channels: Mapping[str, Any], dated: Collection[str], path: Path) -> tuple[Contents, list[QualityFlag]]:
    """What the properties of the ``channels`` say, and flags of dates of the ``dated`` that were not set."""
    dates = {name: channels[name].properties.get("wf_start_time") for name in dated}
    stamps = {name: date.as_datetime64("ns") for name, date in dates.items() if hasattr(date, "as_datetime64")}
    offsets = {name: channel.properties.get("wf_start_offset") for name, channel in channels.items()}
    numbers = {name: float(offset) for name, offset in offsets.items() if _is_number(offset)}
    starts, flags = starts_by_date(stamps, numbers, path)
    columns: dict[str, Described] = {}
    for name, channel in channels.items():
        unit = str(next((channel.properties[key] for key in _UNITS if key in channel.properties), ""))
        step = channel.properties.get("wf_increment")
        rate_hz = float(f"{1.0 / float(step):.12g}") if _is_number(step) and step > 0 else None
        columns[name] = Described(len(channel), unit, rate_hz, starts.get(name))
    return Contents.of("TDMS", columns), flags


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and bool(np.isfinite(value))


@dataclass(frozen=True)
class _Cut:
    """A file that lacks its end: which ``share`` of its bytes is there, that in ``words``, and what nptdms ``said``."""

    share: float
    words: str
    said: str


def _read(
    parser: Any, path: Path, sources: Sequence[Source], settings: IngestSettings
) -> tuple[Contents, dict[str, FloatArray], _Cut | None, list[QualityFlag]]:
    """What the file holds, columns by name, what it lacks of its end, and flags of dates that were not set."""
    with _heard() as said, parser.open(path, raw_timestamps=True) as file:
        channels = _channels(file)
        names = dict.fromkeys(names_of(sources, tuple(channels), path).values())
        contents, undated = _contents(channels, names, path)
        check_budget(sum(8 * contents.samples[name] for name in names), settings)
        columns: dict[str, FloatArray] = {}
        for name in names:
            values = np.asarray(channels[name][:])
            columns[name] = values.astype(float_type_for(values.dtype), copy=False)
        stated = _stated_samples(file, {name: channels[name] for name in names})
        cut = _cut(path, columns, stated, " ".join(said.getvalue().split()))
        if cut is not None and len(set(stated.values())) == 1:
            shortest = min(map(len, columns.values()))
            columns = {name: values[:shortest] for name, values in columns.items()}
        return contents, columns, cut, undated


def _stated_samples(file: Any, channels: Mapping[str, Any]) -> dict[str, int]:
    """Samples of each of the ``channels`` with those that the last chunk of ``file`` states and lacks."""
    stated = {name: len(channel) for name, channel in channels.items()}
    for name, channel in channels.items():
        status = (file.file_status.channel_statuses or {}).get(channel.path)
        stated[name] += 0 if status is None else max(0, status.expected_length - status.read_length)
    return stated


def _cut(path: Path, columns: Mapping[str, FloatArray], stated: dict[str, int], said: str) -> _Cut | None:
    """What ``path`` lacks of its end, None where it is whole; ``columns`` of ``stated`` lengths are in it."""
    size, end = path.stat().st_size, _stated_bytes(path)
    if end == size:
        return None
    there, all_of_it = min(map(len, columns.values()), default=0), max(stated.values(), default=0)
    samples = f"{there} samples are there" + (f" of {all_of_it} or more" if all_of_it > there else "")
    if end is None:
        return _Cut(1.0, f"its last segment was not written to its end: {samples}, and more may be lost", said)
    return _Cut(size / end, f"{size} of {end} bytes: {samples}", said)


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
