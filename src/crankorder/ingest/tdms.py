"""TDMS files (National Instruments), read by nptdms in a process of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.errors import EnvironmentFailure
from crankorder.ingest.child import in_child
from crankorder.ingest.rawfile import (
    Contents,
    RawFile,
    Source,
    check_budget,
    common_rate,
    distinct,
    flag,
    float_type_for,
    named,
)
from crankorder.settings import IngestSettings

_UNITS = ("unit_string", "NI_UnitDescription", "Unit", "unit", "units")
_REALS = "iufb"
_MOST_PER_BYTE = 8
"""Bytes of samples that a byte of the file may become: its integers are widened, nothing is compressed."""


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for from the TDMS file at ``path``, scaled as it says: ``"group/channel"``.

    A source is such a name, or a number from 0; the name of a channel alone does where the file has one group.
    ``settings`` give the byte limit. Raises InputError for damage or a missing name, EnvironmentFailure where nptdms is
    missing, UnsafeInputError where the parser goes beyond its limits.
    """
    parser = _parser(path)
    most = min(settings.max_bytes, _MOST_PER_BYTE * path.stat().st_size)
    told, columns, incomplete, start_s = in_child(lambda: _read(parser, path, sources, settings), path, n_bytes=most)
    names = {source: named(source, told.names, path) for source in sources}
    flags = [flag(path, "missing_data", "suspect", "the last segment was not written to its end")] if incomplete else []
    rates = {name: told.rates_hz[name] for name in names.values() if name in told.rates_hz}
    return RawFile(
        columns={source: columns[name] for source, name in names.items()},
        units={source: told.units[name] for source, name in names.items() if name in told.units},
        rate_hz=common_rate(rates, path, tolerance=settings.rate_tolerance),
        attrs={"start_s": start_s},
        flags=flags,
    )


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names, lengths, units and rates of the channels of real numbers in the TDMS file at ``path``.

    ``settings`` are those of :func:`read`, whose errors it raises.
    """
    parser = _parser(path)
    found: Contents = in_child(lambda: _contents(parser, path), path, n_bytes=0)
    return found


def _parser(path: Path) -> Any:
    """nptdms, loaded here so that no child needs to."""
    try:
        import nptdms
    except ModuleNotFoundError:
        raise EnvironmentFailure(
            "reading TDMS files needs the package nptdms", file=path, remedy="Run: pip install 'crankorder[tdms]'"
        ) from None
    return nptdms.TdmsFile


def _channels(file: Any) -> dict[str, Any]:
    """Channels of real numbers by name; the group is part of it where there are several."""
    groups = file.groups()
    found = [
        (channel.name if len(groups) == 1 else f"{group.name}/{channel.name}", channel)
        for group in groups
        for channel in group.channels()
        if channel.data_type is not None and np.dtype(channel.dtype).kind in _REALS
    ]
    return dict(zip(distinct([name for name, _ in found]), (channel for _, channel in found), strict=True))


def _contents(parser: Any, path: Path) -> Contents:
    with parser.open(path) as file:
        return _told(_channels(file))


def _told(channels: dict[str, Any]) -> Contents:
    steps = {name: channel.properties.get("wf_increment") for name, channel in channels.items()}
    units = {
        name: str(next((channel.properties[key] for key in _UNITS if key in channel.properties), ""))
        for name, channel in channels.items()
    }
    return Contents(
        format="TDMS",
        names=tuple(channels),
        samples={name: len(channel) for name, channel in channels.items()},
        units={name: unit for name, unit in units.items() if unit},
        rates_hz={name: float(f"{1.0 / float(step):.12g}") for name, step in steps.items() if _is_step(step)},
    )


def _is_step(step: Any) -> bool:
    return isinstance(step, (int, float)) and bool(np.isfinite(step)) and step > 0


def _read(
    parser: Any, path: Path, sources: Sequence[Source], settings: IngestSettings
) -> tuple[Contents, dict[str, Any], bool, float]:
    """What the file holds, columns by name, whether its last segment is cut short, and the first time."""
    with parser.open(path) as file:
        channels = _channels(file)
        told = _told(channels)
        names = list(dict.fromkeys(named(source, told.names, path) for source in sources))
        check_budget(sum(8 * told.samples[name] for name in names), path, max_bytes=settings.max_bytes)
        columns = {}
        for name in names:
            values = np.asarray(channels[name][:])
            columns[name] = values.astype(float_type_for(values.dtype), copy=False)
        offset = channels[names[0]].properties.get("wf_start_offset", 0.0) if names else 0.0
        start_s = float(offset) if isinstance(offset, (int, float)) and np.isfinite(offset) else 0.0
        return told, columns, bool(getattr(file.file_status, "incomplete_final_segment", False)), start_s
