"""Time bases: rate and start of each column of a file, and how channels of several become one recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from crankorder.errors import InputError
from crankorder.ingest.rawfile import Contents, FloatArray, Key, RawFile, flag, listed
from crankorder.quantities import QualityFlag
from crankorder.settings import IngestSettings

ENCODER = "the encoder"
"""Role of the trace or the speed signal that tells the angle."""
_MOST_DOUBT = 1e-4
"""By which two rates of one file may differ because their steps are rounded: what is one is rounded alike."""
_FEWEST = 3
_MOST_CUT = 0.05
"""Of a recording, which is left out without a word where its channels start at different times."""


class TimeBase(NamedTuple):
    """Samples per second of a column, the time of its first sample on the clock of the file, and their number."""

    rate_hz: float
    start_s: float
    n_samples: int

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return self.start_s + (self.n_samples - 1) / self.rate_hz

    def place(self, time_s: float, settings: IngestSettings) -> float:
        """Sample at ``time_s``, whole where it is so within the jitter that ``settings`` allow a time."""
        at = (time_s - self.start_s) * self.rate_hz
        return round(at) if abs(at - round(at)) <= settings.time_jitter_samples else at


def bases_of(
    sampled: Mapping[str, Key], samples: Mapping[Key, int], told: RawFile | Contents, channels: int, *, tolerance: float
) -> tuple[dict[str, TimeBase], float | None]:
    """Base of each of the ``sampled`` columns by its role, and the lowest rate in Hz of the first ``channels`` of them.

    ``samples`` is the length of each, ``told`` what the file says. Rates within ``tolerance`` (relative), which that of
    rounded steps may widen a little, are one. A column of no stated rate has that of the channels, these that of the
    others; 1 Hz where no column states one.
    """
    tolerance += min(2.0 * told.rate_uncertainty, _MOST_DOUBT)
    stated: Mapping[Key, float] = told.rates_hz  # type: ignore[assignment]
    starts: Mapping[Key, float] = told.starts_s  # type: ignore[assignment]
    rates = [stated[column] for column in list(sampled.values())[:channels] if column in stated]
    rates = rates or [stated[column] for column in sampled.values() if column in stated]
    file_hz = next((rate for rate in rates if rate <= min(rates) * (1.0 + tolerance)), None)

    def base_of(column: Key) -> TimeBase:
        common_hz = file_hz or 1.0
        own_hz = stated.get(column, common_hz)
        same = abs(own_hz - common_hz) <= tolerance * common_hz
        return TimeBase(common_hz if same else own_hz, starts.get(column, 0.0), samples[column])

    return {role: base_of(column) for role, column in sampled.items() if column in samples}, file_hz


def length_faults(bases: Mapping[str, TimeBase], path: Path) -> list[InputError]:
    """Faults of columns of the file at ``path`` whose ``bases``, by role, are one but for their lengths."""
    first: dict[tuple[float, float], str] = {}
    faults: list[InputError] = []
    for role, base in bases.items():
        other = first.setdefault((base.rate_hz, base.start_s), role)
        if bases[other].n_samples != base.n_samples:
            problem = f"lengths differ: {other} has {bases[other].n_samples} samples, {role} has {base.n_samples}"
            faults.append(InputError(problem, file=path, remedy="Export all channels over the same time at one rate"))
    return faults


def on_one_base(
    columns: dict[str, FloatArray], bases: Mapping[str, TimeBase], path: Path, *, settings: IngestSettings
) -> tuple[TimeBase, list[QualityFlag]]:
    """Bring the channels ``columns`` (role to samples) to one base, in place; that base, and flags.

    ``bases`` by role are theirs and that of the encoder, which keeps its own. The base has the lowest rate of the
    channels and spans the time in which they and the encoder were recorded, which holds for one of its steps beyond its
    ends. What differs by whole samples is cut, other channels are resampled within their band; on one base all stay as
    they are. ``path`` is the file of flags and errors; ``settings`` say when a place is whole. Raises InputError where
    columns on one base differ in length, or less than three samples are common to all.
    """
    for fault in length_faults(bases, path):
        raise fault
    shortest = min((base.n_samples for base in bases.values()), default=_FEWEST)
    if shortest < _FEWEST:
        raise InputError(
            "no samples" if shortest == 0 else f"too short: {shortest} samples",
            file=path,
            allowed=f"{_FEWEST} samples or more",
            remedy="Leave the recording out",
        )
    if not columns:
        return bases.get(ENCODER, TimeBase(1.0, 0.0, 0)), []
    lowest_hz = min(bases[role].rate_hz for role in columns)
    grid = next(bases[role] for role in columns if bases[role].rate_hz == lowest_hz)
    told = {role: base for role, base in bases.items() if role in columns or role == ENCODER}
    flags = _start_flags(bases, path, settings)
    if all(base == grid for base in told.values()):
        return grid, flags
    from crankorder.fft.resampling import reach_of, resampled  # heavy: of one base it is not wanted

    step = {role: bases[role].rate_hz / lowest_hz for role in columns}
    moved = [role for role in columns if step[role] != 1.0 or grid.place(bases[role].start_s, settings) % 1.0]
    reach_s = {role: reach_of(step[role]) / bases[role].rate_hz for role in moved}
    if ENCODER in told:
        reach_s[ENCODER] = -1.0 / min(told[ENCODER].rate_hz, lowest_hz)
    begin_s = max(base.start_s + reach_s.get(role, 0.0) for role, base in told.items())
    end_s = min(base.end_s - reach_s.get(role, 0.0) for role, base in told.items())
    first = math.ceil(grid.place(begin_s, settings))
    n_samples = math.floor(grid.place(end_s, settings)) - first + 1
    if n_samples < _FEWEST:
        spans = [f"{role} from {base.start_s:.9g} to {base.end_s:.9g} s" for role, base in told.items()]
        raise InputError(
            "channels and encoder were not recorded at the same time",
            file=path,
            found=", ".join(spans[:5] if len(spans) < 6 else [*spans[:4], spans[-1]]),
            remedy="Mend the start times in the file, or leave out what was recorded at another time",
        )
    base = TimeBase(lowest_hz, grid.start_s + first / lowest_hz, n_samples)
    for role, row in columns.items():
        place = bases[role].place(base.start_s, settings)
        whole = slice(round(place), round(place) + n_samples)
        columns[role] = resampled(row, place, step[role], n_samples) if role in moved else row[whole]
    return base, flags + _loss_flags(bases, moved, base, path)


def _start_flags(bases: Mapping[str, TimeBase], path: Path, settings: IngestSettings) -> list[QualityFlag]:
    """Flag that says which of the ``bases`` begin later than the first of all, where any does."""
    first = min(bases, key=lambda role: bases[role].start_s)
    late = [role for role, base in bases.items() if base.place(bases[first].start_s, settings)]
    if not late:
        return []
    lags = listed([f"{role} by {bases[role].start_s - bases[first].start_s:.9g} s" for role in late], 5)
    detail = f"later than {first} start {lags}, as the file says: so they are taken"
    return [flag(path, "start_times", "info", detail)]


def _loss_flags(bases: Mapping[str, TimeBase], moved: list[str], base: TimeBase, path: Path) -> list[QualityFlag]:
    """What was lost when channels on ``bases`` came to ``base``, of which some were ``moved`` between samples."""
    from crankorder.fft.resampling import PASS

    flags: list[QualityFlag] = []
    seconds, longest_s = (max(one.n_samples / one.rate_hz for one in some) for some in ([base], bases.values()))
    if longest_s - seconds > _MOST_CUT * longest_s:
        detail = f"{seconds:.6g} s of {longest_s:.6g} s were recorded by all channels: the rest is left out"
        flags.append(flag(path, "recording_cut", "suspect", detail))
    if moved:
        rates = listed([f"{role} of {bases[role].rate_hz:.9g} Hz" for role in moved], 5)
        detail = (
            f"{rates}: resampled to {base.rate_hz:.9g} Hz and the times of another channel; "
            f"what lies above {PASS * base.rate_hz:.6g} Hz is lost"
        )
        slower = any(bases[role].rate_hz != base.rate_hz for role in moved)
        flags.append(flag(path, "channels_resampled", "suspect" if slower else "info", detail))
    return flags
