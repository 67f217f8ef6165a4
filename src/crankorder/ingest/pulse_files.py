"""Files of pulse times beside recordings, told from files of samples by their rows and names: for a draft."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crankorder.ingest.rawfile import Contents
from crankorder.ingest.roles import SPEED_NAME, Column, columns_of, values_of
from crankorder.ingest.units import unit_of
from crankorder.quantities import Floats
from crankorder.settings import load_settings


@dataclass(frozen=True, slots=True)
class PulseFiles:
    """Patterns of the recordings and of the files of their pulses, the recordings, and what tells a pulse."""

    recordings: str
    pulses: str
    group: list[tuple[Contents, Path]]
    source: str | int
    pulses_hz: float


def pulse_files(files: Sequence[tuple[Contents, Path]]) -> PulseFiles | None:
    """The recordings and pulse files that ``files`` (contents, path) are in pairs, None where they are not.

    Files of each kind have the same columns, and names that differ from the other kind's by a constant piece.
    """
    kinds: dict[tuple[str, ...], list[tuple[Contents, Path]]] = {}
    for contents, path in files:
        kinds.setdefault((contents.format, *contents.names), []).append((contents, path))
    for samples, events in itertools.permutations(kinds.values(), 2):
        patterns = _patterns([path.name for _, path in samples], [path.name for _, path in events])
        if patterns is None or (len(files) > 2 and "{run}" not in patterns[0]):
            continue
        column = _pulse_column(samples[0], events[0])
        if column is not None:
            return PulseFiles(*patterns, samples, *column)
    return None


def _patterns(*kinds: list[str]) -> tuple[str, str] | None:
    """Pattern of the names of each of two ``kinds`` of files, with the part that both share as ``{run}``."""
    ends: list[tuple[str, str]] = []
    cores: list[list[str]] = []
    for names in kinds:
        stems = [Path(name).stem for name in names]
        head = _common_head(stems)
        tail = _common_head([stem[len(head) :][::-1] for stem in stems])[::-1]
        ends.append((head, tail))
        cores.append(sorted(stem[len(head) : len(stem) - len(tail)] for stem in stems))
    if cores[0] != cores[1]:
        return None
    # what stands the same in both beside the part that changes belongs to it
    left = _common_head([head[::-1] for head, _ in ends])[::-1].lstrip("_-. ")
    right = _common_head([tail for _, tail in ends]).rstrip("_-. ")
    part = "{run}" if left or right or cores[0] != [""] else ""
    first, second = (
        f"{head[: len(head) - len(left)]}{part}{tail[len(right) :]}{Path(names[0]).suffix}"
        for (head, tail), names in zip(ends, kinds, strict=True)
    )
    return first, second


def _common_head(names: list[str]) -> str:
    return os.path.commonprefix(names)  # noqa: RUF071 - of names, not of paths


def _pulse_column(samples: tuple[Contents, Path], events: tuple[Contents, Path]) -> tuple[str | int, float] | None:
    """Source of the times of pulses in the file of ``events``, and pulses per second; None where it holds no pulses."""
    settings = load_settings().ingest
    recorded, listed = (columns_of(path, contents, settings=settings) for contents, path in (samples, events))
    time = listed.of("time") or (listed.of("encoder") if len(listed.all) == 1 else None)
    clock, signals = recorded.of("time"), recorded.channels()
    if time is None or not signals or (clock is None and not samples[0].rates_hz):
        return None
    values = values_of(events[1], [column.name for column in listed.all], events[0], settings)
    times = values.get(time.name, np.empty(0)) * _seconds(time)
    n_samples, begin_s, end_s = samples[0].samples.get(signals[0].name, 0), -np.inf, np.inf
    if clock is not None:
        stamps = values_of(samples[1], [clock.name], samples[0], settings).get(clock.name, np.zeros(1)) * _seconds(
            clock
        )
        n_samples, begin_s, end_s = stamps.size, stamps[0], stamps[-1]
    if not 2 < times.size < n_samples or not (np.diff(times) > 0.0).all() or times[-1] < begin_s or times[0] > end_s:
        return None
    others = [column for column in listed.all if column is not time]
    if not all(column.name in values and _tells_pulses(column, values[column.name], times) for column in others):
        return None
    return time.source, float((times.size - 1) / np.ptp(times))


def _seconds(column: Column) -> float:
    return column.unit.factor if column.unit is not None and column.unit.quantity == "time" else 1.0


def _tells_pulses(column: Column, values: Floats, times: Floats) -> bool:
    """Whether a ``column`` beside ``times`` in s only counts pulses, or tells their period or speed."""
    step, later = np.diff(times), values[1:]
    if (values == np.rint(values)).all() and (np.diff(values) >= 0.0).all():
        return True
    if SPEED_NAME.search(column.label):
        rev_per_s = later * (column.unit or unit_of("rpm")).factor
        per_rev = max(1.0, float(np.rint(np.median(1.0 / np.maximum(rev_per_s * step, 1e-9)))))
        return bool(np.allclose(rev_per_s * step * per_rev, 1.0, rtol=0.1))
    return bool(np.allclose(later * _seconds(column), step, rtol=0.1))
