"""TDMS files (National Instruments), read by nptdms in a process of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.errors import EnvironmentFailure
from crankorder.ingest.child import in_child
from crankorder.ingest.rawfile import Contents, RawFile, Source, check_budget, common_rate, distinct, flag, named
from crankorder.settings import IngestSettings

_UNITS = ("unit_string", "NI_UnitDescription", "Unit", "unit", "units")
_REALS = "iufb"


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for from the TDMS file at ``path``, scaled as it says: ``"group/channel"``.

    A source is such a name, or a number from 0; the name of a channel alone does where the file has one group.
    ``settings`` give the byte limit. Raises InputError for damage or a missing name, EnvironmentFailure where nptdms is
    missing, UnsafeInputError where the parser goes beyond its limits.
    """
    told = contents(path, settings=settings)
    names = [named(source, told.names, path) for source in sources]
    n_bytes = sum(8 * told.samples[name] for name in names)
    check_budget(n_bytes, path, max_bytes=settings.max_bytes)
    parser = _parser(path)
    columns, incomplete, start_s = in_child(lambda: _read(parser, path, names), path, n_bytes=n_bytes)
    flags = [flag(path, "missing_data", "suspect", "the last segment was not written to its end")] if incomplete else []
    rates = {name: told.rates_hz[name] for name in names if name in told.rates_hz}
    return RawFile(
        columns={source: columns[name] for source, name in zip(sources, names, strict=True)},
        units={source: told.units[name] for source, name in zip(sources, names, strict=True) if name in told.units},
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
        channels = _channels(file)
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


def _read(parser: Any, path: Path, names: Sequence[str]) -> tuple[dict[str, Any], bool, float]:
    with parser.open(path) as file:
        channels = _channels(file)
        columns = {}
        for name in dict.fromkeys(names):
            values = np.asarray(channels[name][:])
            small = values.dtype.itemsize <= 2 or values.dtype == np.float32
            columns[name] = values.astype(np.float32 if small else np.float64)
        offset = channels[names[0]].properties.get("wf_start_offset", 0.0) if names else 0.0
        start_s = float(offset) if isinstance(offset, (int, float)) and np.isfinite(offset) else 0.0
        return columns, bool(getattr(file.file_status, "incomplete_final_segment", False)), start_s
