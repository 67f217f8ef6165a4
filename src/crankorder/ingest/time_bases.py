"""Time bases: rate and start of each column of a file, and how columns of several become one recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from crankorder.errors import InputError
from crankorder.ingest.rawfile import FloatArray, Source, flag
from crankorder.quantities import QualityFlag
from crankorder.settings import IngestSettings


class TimeBase(NamedTuple):
    """Samples per second of a column, the time of its first sample on the clock of the file, and their number."""

    rate_hz: float
    start_s: float
    n_samples: int

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return self.start_s + (self.n_samples - 1) / self.rate_hz

    def is_like(self, other: TimeBase, settings: IngestSettings) -> bool:
        """Whether rate and start are those of ``other``, as exactly as ``settings`` ask of the times of samples."""
        off = abs(self.start_s - other.start_s) * self.rate_hz
        return _same(self.rate_hz, other.rate_hz, settings.rate_tolerance) and off <= settings.time_jitter_samples


def _same(rate_hz: float, other_hz: float, tolerance: float) -> bool:
    return abs(rate_hz - other_hz) <= tolerance * other_hz


def lowest_rate(rates_hz: Sequence[float], tolerance: float) -> float | None:
    """The lowest of ``rates_hz``, of those within ``tolerance`` (relative) of it the first; None of none."""
    return next((rate for rate in rates_hz if rate <= min(rates_hz) * (1.0 + tolerance)), None)


def bases_of(
    sampled: Mapping[str, Any], columns: Mapping[Any, int], rates_hz: Mapping[Any, float],
    starts_s: Mapping[Any, float], *, rate_hz: float, file_hz: float | None, tolerance: float,
) -> dict[str, TimeBase]:  # fmt: skip
    """Time base of each of the ``sampled`` columns, by what each is for (role to column).

    ``columns`` holds the samples of each, ``rates_hz`` and ``starts_s`` what the file states. A rate that is not
    stated, or within ``tolerance`` (relative) of the file's ``file_hz``, is that of the recording, ``rate_hz``.
    """

    def rate_of(column: Any) -> float:
        stated = rates_hz.get(column)
        return rate_hz if stated is None or _same(stated, file_hz or stated, tolerance) else stated

    return {
        role: TimeBase(rate_of(column), starts_s.get(column, 0.0), columns[column])
        for role, column in sampled.items()
        if column in columns
    }


def base_faults(bases: Mapping[str, TimeBase], path: Path, *, settings: IngestSettings) -> Iterator[InputError]:
    """Why columns on ``bases`` (role to base) of the file at ``path`` were not recorded together, one error each.

    Lengths that differ on one base, and times that do not overlap. ``settings`` say when two bases are one.
    """
    kinds: dict[str, TimeBase] = {}
    for role, base in bases.items():
        like = next((name for name, other in kinds.items() if base.is_like(other, settings)), None)
        first = kinds.setdefault(like or role, base)
        if base.n_samples != first.n_samples:
            yield InputError(
                f"lengths differ: {like} has {first.n_samples} samples, {role} has {base.n_samples}",
                file=path,
                remedy="Export all channels over the same time at one rate",
            )
    latest = max(kinds, key=lambda role: kinds[role].start_s, default="")
    for role, base in kinds.items():
        if role != latest and base.end_s < kinds[latest].start_s:
            yield InputError(
                f"{role} and {latest} were not recorded at the same time",
                file=path,
                found=f"{role} {_span(base)}, {latest} {_span(kinds[latest])}",
                remedy="Mend the start times in the file, or leave one of them out",
            )


def _span(base: TimeBase) -> str:
    return f"from {base.start_s:.9g} to {base.end_s:.9g} s"


def start_flags(bases: Mapping[str, TimeBase], path: Path, *, settings: IngestSettings) -> list[QualityFlag]:
    """Flag that says which of the ``bases`` (role to base) begin later than the first of all, where any does."""
    first = min(bases, key=lambda role: bases[role].start_s, default="")
    late = {
        role: base.start_s - bases[first].start_s
        for role, base in bases.items()
        if (base.start_s - bases[first].start_s) * base.rate_hz > settings.time_jitter_samples
    }
    if not late:
        return []
    told = ", ".join(f"{role} by {lag_s:.9g} s" for role, lag_s in list(late.items())[:5])
    detail = f"later than {first} start {told}{', …' if len(late) > 5 else ''}, as the file says: so they are taken"
    return [flag(path, "start_times", "info", detail)]


def on_one_base(
    columns: dict[Source, FloatArray],
    bases: Mapping[Source, TimeBase],
    encoder: TimeBase | None,
    path: Path,
    *,
    rate_hz: float,
    settings: IngestSettings,
) -> tuple[TimeBase, list[QualityFlag]]:
    """Bring the channels, those ``columns`` that ``bases`` name, to one base in place; that base, and flags.

    It has the rate ``rate_hz``, the lowest of the channels, and spans the time over which they and the ``encoder``
    (base of its trace or speed signal, which keeps it) were recorded. What differs by whole samples is cut, other
    channels are resampled within their band; on one base all stay as they are. Raises InputError where less than three
    samples are common to all.
    """
    grid = next(base for base in bases.values() if _same(base.rate_hz, rate_hz, settings.rate_tolerance))
    if all(base.is_like(grid, settings) for base in (*bases.values(), encoder or grid)):
        return grid, []
    from crankorder.fft.rate_change import RateChange  # heavy: of a file on one base it is not wanted

    slack = settings.time_jitter_samples

    def place(time_s: float, base: TimeBase) -> float:
        """Sample of ``base`` at ``time_s``, whole where it is within the slack."""
        at = (time_s - base.start_s) * base.rate_hz
        return round(at) if abs(at - round(at)) <= slack else at

    resampled = {
        source: RateChange.by(base.rate_hz / rate_hz)
        for source, base in bases.items()
        if not _same(base.rate_hz, rate_hz, settings.rate_tolerance) or place(base.start_s, grid) % 1.0
    }
    spans = [
        (base.start_s + (reach := resampled[source].reach / base.rate_hz if source in resampled else 0.0),
         base.end_s - reach)
        for source, base in bases.items()
    ]  # fmt: skip
    if encoder is not None:
        step_s = 1.0 / min(encoder.rate_hz, rate_hz)
        spans.append((encoder.start_s - step_s, encoder.end_s + step_s))
    first = math.ceil(place(max(begin for begin, _ in spans), grid))
    last = math.floor(place(min(end for _, end in spans), grid))
    if last - first < 2:
        raise InputError(
            f"{max(0, last - first + 1)} samples are common to all channels",
            file=path,
            found="; ".join(f"{source} {_span(base)}" for source, base in list(bases.items())[:5]),
            allowed="3 samples or more",
            remedy="Mend the start times in the file, or leave out what was recorded at another time",
        )
    made = TimeBase(grid.rate_hz, grid.start_s + first / grid.rate_hz, last - first + 1)
    for source, base in bases.items():
        begin = place(made.start_s, base)
        if source in resampled:
            columns[source] = resampled[source].of(columns[source], begin, made.n_samples)
        else:
            columns[source] = columns[source][round(begin) : round(begin) + made.n_samples]
    return made, _join_flags(bases, list(resampled), made, path)


def _join_flags(
    bases: Mapping[Source, TimeBase], resampled: Sequence[Source], made: TimeBase, path: Path
) -> list[QualityFlag]:
    """What was lost when columns on ``bases`` came to the base ``made``, of which some were ``resampled``."""
    from crankorder.fft.rate_change import PASS

    flags: list[QualityFlag] = []
    longest_s = max(base.n_samples / base.rate_hz for base in bases.values())
    if longest_s * made.rate_hz - made.n_samples > 0.05 * made.n_samples:
        detail = (
            f"{made.n_samples / made.rate_hz:.6g} s of {longest_s:.6g} s were recorded by all: the rest is left out"
        )
        flags.append(flag(path, "recording_cut", "suspect", detail))
    if resampled:
        rates = ", ".join(f"{source} from {bases[source].rate_hz:.9g} Hz" for source in resampled[:5])
        detail = (
            f"resampled to the {made.rate_hz:.9g} Hz and the times of the slowest channel: {rates}"
            f"{', …' if len(resampled) > 5 else ''}; what lies above {PASS * made.rate_hz:.6g} Hz is lost"
        )
        flags.append(flag(path, "channels_resampled", "suspect", detail))
    return flags
