"""MDF4 measurement files (ASAM), by time or by crank angle, read by asammdf in a process of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crankorder.ingest.child import in_child, package
from crankorder.ingest.rawfile import (
    Contents,
    Described,
    FloatArray,
    RawFile,
    Source,
    by_distinct_name,
    check_budget,
    names_of,
)
from crankorder.quantities import Floats
from crankorder.settings import IngestSettings

_MASTERS = {1: ("time", "s"), 2: ("angle", "deg"), 4: ("index", "1")}
_JITTER = 0.25  # of a step, by which a stamp may lie off an even grid
_REALS = "iufb"


@dataclass(frozen=True, slots=True)
class _Place(Described):
    """What a channel is and where it lies: its group, and its number there (-1: the master)."""

    group: int = 0
    number: int = -1


def read(path: Path, *, sources: Sequence[Source], settings: IngestSettings) -> RawFile:
    """Channels that ``sources`` ask for, by name or number from 0, from the MDF4 file at ``path``, converted.

    The stamps of a group are a column too: ``"time"`` in s or ``"angle"`` in degrees; names that come again have a
    number behind them. The rate is that of even stamps. ``settings`` give the byte limit. Invalid samples are NaN.
    Raises InputError for damage or a missing name, EnvironmentFailure where asammdf is missing, UnsafeInputError where
    the parser goes beyond its limits.
    """
    parser = _parser()
    places = in_child(lambda: _places(parser, path), path, n_bytes=path.stat().st_size)
    names = names_of(sources, tuple(places), path)
    n_bytes = sum(8 * (places[name].n_samples or 0) for name in names.values())
    check_budget(n_bytes, settings)
    wanted = {name: places[name] for name in names.values()}
    columns = in_child(lambda: _read(parser, path, wanted), path, n_bytes=n_bytes)
    return Contents.of("MDF4", places).with_columns(names, [columns[name] for name in names.values()])


def contents(path: Path, *, settings: IngestSettings) -> Contents:
    """Names, lengths, units and rates of the channels of real numbers in the MDF4 file at ``path``.

    ``settings`` are those of :func:`read`, whose errors it raises.
    """
    parser = _parser()
    return Contents.of("MDF4", in_child(lambda: _places(parser, path), path, n_bytes=path.stat().st_size))


def _parser() -> Any:
    return package("asammdf", "MDF4 files", "Run: pip install 'crankorder[mdf]'").MDF


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
                    rate_hz = _rate(stamps)
                    start_s = float(stamps[0]) if rate_hz is not None else 0.0
                places.append((name, _Place(n_samples, unit, None, start_s, group)))
            for number, channel in enumerate(members.channels):
                first = None if number == master else _samples(file, channel.name, group, number, most=1)
                if first is not None:
                    unit = str(channel.unit or "")
                    places.append((str(channel.name), _Place(n_samples, unit, rate_hz, start_s, group, number)))
    return by_distinct_name(places)


def _rate(stamps: Floats) -> float | None:
    """Samples per second of even ``stamps``, None where they are not."""
    if stamps.size < 3 or not np.isfinite(stamps).all() or not stamps[-1] > stamps[0]:
        return None
    step = (stamps[-1] - stamps[0]) / (stamps.size - 1)
    off = np.abs(stamps - stamps[0] - step * np.arange(stamps.size)).max()
    return float(f"{1.0 / step:.12g}") if off < _JITTER * step else None


def _samples(file: Any, name: str, group: int, number: int, *, most: int | None = None) -> FloatArray | None:
    """Samples of a channel, NaN where the file calls them invalid; None where they are no real numbers."""
    signal = file.get(name, group=group, index=number, ignore_invalidation_bits=True, record_count=most, raw=False)
    values = np.asarray(signal.samples)
    if values.ndim != 1 or values.dtype.kind not in _REALS:
        return None
    small = values.dtype.itemsize <= 2 or values.dtype == np.float32
    samples: FloatArray = values.astype(np.float32 if small else np.float64)
    invalid = getattr(signal, "invalidation_bits", None)
    if invalid is not None and np.size(invalid) == samples.size:
        samples[np.asarray(invalid, dtype=bool)] = np.nan
    return samples


def _read(parser: Any, path: Path, wanted: dict[str, _Place]) -> dict[str, FloatArray]:
    """Columns by name."""
    columns: dict[str, FloatArray] = {}
    with parser(str(path)) as file:
        names = list(file.groups)
        for name, place in wanted.items():
            channels = names[place.group].channels
            if place.number >= 0:
                column = _samples(file, channels[place.number].name, place.group, place.number)
                assert column is not None  # its first sample was a real number
                columns[name] = column
                continue
            master = channels[file.masters_db[place.group]]
            stamps = np.asarray(file.get_master(place.group), dtype=np.float64)
            radians = place.unit == "deg" and str(master.unit).strip().lower() in ("rad", "radian", "radians", "")
            columns[name] = np.rad2deg(stamps) if radians else stamps
    return columns
