"""The sampling of a recording: time bases of its columns, and the one rate that file, times and manifest state."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crankorder.errors import InputError
from crankorder.fft.resampling import TAPS, shifted
from crankorder.ingest.rawfile import Contents, FloatArray, Key, RawFile, Source, flag, listed
from crankorder.ingest.units import known_unit, unit_in_label
from crankorder.quantities import Floats, Ints, QualityFlag
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

SOME_TIMES = 1 << 20
"""Times that are enough to tell the usual step."""


LISTED = 5
"""Gaps that are named one by one."""

BREAKS = (0.5, 0.2, 0.05, 0.01)
"""Samples by which a step from row to row is off that parts two stretches: no smaller than they need be even."""

FEWEST_ROWS = 4 * TAPS
"""Rows of a stretch, in the mean, that are worth shifting: the kernel takes half its length off either end."""


@dataclass(frozen=True, slots=True)
class TimeColumn:
    """What a column of times says: samples per second, its relative uncertainty, and the first time.

    ``n_rows`` rows count, those without zeros at the end; ``places`` (rows,) are their places on the uniform grid, None
    where no row is missing. ``starts`` (stretches,) is the first place of each stretch between gaps, ``offsets``
    (stretches,) by how many samples it lies behind its places; one stretch without offset where all lie on the grid.
    """

    rate_hz: float
    rate_uncertainty: float
    start_s: float
    flags: list[QualityFlag]
    n_rows: int
    places: Ints | None = None
    starts: Ints = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    offsets: Floats = field(default_factory=lambda: np.zeros(1))

    def on_grid(self, column: FloatArray) -> FloatArray:
        """``column`` (rows,) on the uniform grid (places,), NaN where rows are missing.

        A stretch off the grid takes its nearest places.
        """
        kept = column[: self.n_rows]
        if self.places is None:
            return kept
        gridded = np.full(int(self.places[-1]) + 1, np.nan, dtype=column.dtype)
        gridded[self.places] = kept
        return gridded

    def align(self, signal: FloatArray) -> None:
        """Shift each stretch of ``signal`` (places,), as on_grid lays it, onto the grid in place; NaN at its ends."""
        for first, end, offset in zip(self.starts, [*self.starts[1:], signal.size], self.offsets, strict=True):
            if offset:
                signal[first:end] = shifted(signal[first:end], float(offset))

    def places_in_time(self, place: Floats) -> Floats:
        """Places (events,) in time, in samples, of what lies at ``place`` (events,) of a trace laid by on_grid."""
        return np.asarray(place + self.offsets[np.searchsorted(self.starts, place, side="right") - 1])


def seconds_of(raw: RawFile, source: Source) -> FloatArray:
    """Column ``source`` (samples,) of ``raw`` in s, by the unit that the file or the name states, else as it is."""
    unit = known_unit(raw.units.get(source) or unit_in_label(str(source)))
    factor = unit.factor if unit is not None and unit.quantity == "time" else 1.0
    column = raw.columns[source]
    return column if factor == 1.0 else column * factor


def read_time_column(
    times: FloatArray, path: Path, *, settings: IngestSettings, rounding: Floats | None = None
) -> TimeColumn:
    """Rate and start of a column of ``times`` (samples,) in s, which must be uniform except for gaps.

    ``rounding`` (samples,) in s, where known, is the uncertainty that the digits of each time leave: times that are
    even within it are uniform, even where they repeat. ``path`` names the recording in errors; ``settings`` say how far
    a time may lie off the uniform grid, and how much may be missing. Raises InputError naming the sample where times
    repeat, go back or wander, or too many are missing.
    """
    n_rows = rows_before_zeros(times)
    flags, times = zeros_flags(times, n_rows, path), times[:n_rows]
    written = 0.0
    if rounding is not None and (even := _even_within(times, rounding[:n_rows])) is not None:
        written = float(np.abs(times - even).max() / (even[1] - even[0]))
        times = even
    _refuse_disorder(times, path)
    first, step_s, exact, jitter = _even_stretches(times, BREAKS[0])
    places = None
    if first.size > 1:  # were all gaps whole samples
        moved = np.zeros(times.size, dtype=np.int64)
        moved[first[1:]] = np.round((times[first[1:]] - times[first[1:] - 1]) / step_s).astype(np.int64) - 1
        places = np.arange(times.size) + np.cumsum(np.maximum(moved, 0))
    starts, offsets = np.zeros(1, dtype=np.int64), np.zeros(1)
    last = times.size - 1 if places is None else int(places[-1])
    grid_s = (float(times[-1]) - float(times[0])) / last
    off_grid = _jitter(times, grid_s, places)
    if off_grid <= settings.max_time_jitter_samples:
        step_s, jitter = grid_s, off_grid
    else:
        for least in BREAKS[1:]:
            if jitter > settings.max_time_jitter_samples:
                first, step_s, exact, jitter = _even_stretches(times, least)
        if jitter > settings.max_time_jitter_samples or first.size * FEWEST_ROWS > times.size:
            raise _uneven(first, step_s, jitter if first.size == 1 else off_grid, path, settings)
        starts = np.round(exact).astype(np.int64)
        offsets = exact - starts
        offsets[np.abs(offsets) < settings.time_jitter_samples] = 0.0
        places = np.arange(times.size) + np.repeat(starts - first, np.diff(first, append=times.size))
        last = times.size // first.size
    if first.size > 1:
        flags.append(_gaps(times, first, step_s, path, settings, moved=bool(offsets.any())))
    jitter = max(jitter, written)
    if jitter > settings.time_jitter_samples:
        detail = f"times lie off a uniform grid by up to {jitter:.2g} samples (rounded?); a uniform grid is used"
        flags.append(flag(path, "time_jitter", "info", detail))
    # each end is known to within its own jitter, and a rounding error of the arithmetic
    uncertainty = 2.0 * max(jitter, 1e-9) / last
    # twelve digits: 100 kHz in a decimal column is 100 kHz, not 100000.00000000001
    rate_hz = float(f"{1.0 / step_s:.12g}")
    return TimeColumn(rate_hz, uncertainty, float(times[0]), flags, n_rows, places, starts, offsets)


def _even_within(times: FloatArray, rounding: Floats) -> Floats | None:
    """The even times that ``times`` (sample,) are within their ``rounding``; None where they are uneven."""
    if times.size < 3 or not np.isfinite(times).all() or not rounding.min() > 0.0:
        return None
    numbers = np.arange(times.size)
    step_s, start_s = np.polyfit(numbers, times, 1, w=1.0 / rounding)
    even = np.asarray(start_s + step_s * numbers)
    # a fit to rounded times is off by a part of their rounding
    return even if step_s > 0.0 and (np.abs(times - even) <= 1.5 * rounding).all() else None


def _double(times: FloatArray, part: slice) -> Floats:
    return times[part].astype(np.float64, copy=False)


def _steps(times: FloatArray) -> Iterator[tuple[int, Floats]]:
    """First sample and steps of each block of ``times``."""
    for part in blocks(times.size - 1):
        yield part.start, np.diff(_double(times, slice(part.start, part.stop + 1)))


def rows_before_zeros(times: FloatArray) -> int:
    """Number of ``times`` (rows,) before the zeros at the end that some loggers write when they stop."""
    if times.size < 3 or times[-1] != 0.0 or not times[times.size // 2] > 0.0:
        return times.size
    return int(np.flatnonzero(times)[-1]) + 1


def zeros_flags(times: FloatArray, n_rows: int, path: Path) -> list[QualityFlag]:
    """Flag that the ``times`` (rows,) of the recording at ``path`` behind ``n_rows`` are zeros and left out, if any."""
    detail = f"{times.size - n_rows} rows at the end whose time is 0 are left out"
    return [flag(path, "rows_of_zeros", "info", detail)] if n_rows < times.size else []


def _refuse_disorder(times: FloatArray, path: Path) -> None:
    if times.size < 3:
        raise InputError(f"too short: {times.size} samples", file=path, allowed="3 samples or more")
    for part in blocks(times.size):
        finite = np.isfinite(times[part])
        if not finite.all():
            raise InputError("a time is missing", file=path, place=f"sample {part.start + int(np.argmin(finite))}")
    for first, steps in _steps(times):
        if steps.min() <= 0:
            place = first + int(np.argmax(steps <= 0)) + 1
            found = f"{times[place]:.9g} s after {times[place - 1]:.9g} s"
            remedy = "Mend time_source, or leave the recording out"
            raise InputError("time does not grow", file=path, place=f"sample {place}", found=found, remedy=remedy)


def _even_stretches(times: FloatArray, least: float) -> tuple[Ints, float, Floats, float]:
    """Stretches of ``times`` between steps that are off by more than ``least`` of a sample.

    The first row of each; the step [s] within them; the place of each on a grid of that step that begins with the
    first, by the mean of its rows; and the largest jitter within one of them in samples.
    """
    usual_s = float(np.median(np.diff(_double(times, slice(SOME_TIMES)))))
    odd = [at + np.flatnonzero(np.abs(steps - usual_s) > least * usual_s) for at, steps in _steps(times)]
    after = np.concatenate(odd)
    first = np.append(0, after + 1)
    # between the gaps steps that were rounded add up to the true one
    within_s = float(times[-1]) - float(times[0]) - float(np.sum(times[after + 1] - times[after], dtype=np.float64))
    if first.size == times.size:
        return first, usual_s, np.zeros(1), np.inf
    step_s = within_s / (times.size - first.size)
    if first.size == 1:
        return first, step_s, np.zeros(1), _jitter(times, step_s, None)
    rows = np.diff(first, append=times.size)
    rest = (_double(times, slice(None)) - times[0]) / step_s - np.arange(times.size)
    mean = np.add.reduceat(rest, first) / rows
    jitter = float(np.abs(rest - np.repeat(mean, rows)).max())
    return first, step_s, mean - mean[0] + first, jitter


def _jitter(times: FloatArray, step_s: float, places: Ints | None) -> float:
    """Samples by which one of ``times`` lies off the grid of ``step_s`` that begins with the first, at most."""
    jitter = 0.0
    for part in blocks(times.size):
        place = np.arange(part.start, part.stop) if places is None else places[part]
        jitter = max(jitter, float(np.abs((_double(times, part) - float(times[0])) / step_s - place).max()))
    return jitter


def _uneven(first: Ints, step_s: float, off: float, path: Path, settings: IngestSettings) -> InputError:
    """The error of times that are ``off`` a uniform grid, and uneven between the gaps before the rows ``first``."""
    problem = f"the time column is not uniform: off by {off:.3g} samples, and not even between gaps"
    found = f"steps of {step_s:.6g} s in the mean"
    if first.size > 1:
        found = f"{first.size - 1} steps unlike {step_s:.6g} s, the first after sample {first[1] - 1}"
    allowed = f"{settings.max_time_jitter_samples:g} samples (ingest.max_time_jitter_samples)"
    remedy = (
        "Interpolate the signals at even times. Only where a converter took them at an even rate and the times "
        "are those of its reader, drop time_source and state [sampling] rate_hz"
    )
    return InputError(problem, file=path, found=found, allowed=allowed, remedy=remedy)


def _gaps(
    times: FloatArray, first: Ints, step_s: float, path: Path, settings: IngestSettings, *, moved: bool
) -> QualityFlag:
    """The flag of the gaps before the rows ``first`` of ``times``; ``moved``: stretches were shifted onto the grid.

    Raises InputError where more samples are missing than ``settings`` allow.
    """
    after = first[1:] - 1
    wide = np.asarray(times[first[1:]] - times[after], dtype=np.float64)
    lost = wide / step_s - 1.0
    total = round(float(lost.sum()), 1 if moved else None)
    longest = int(np.argmax(lost))
    where = f"after sample {after[longest]} ({times[after[longest]]:.9g} s)"
    found = f"a step of {wide.max():.6g} s among steps of {step_s:.6g} s"
    if total > settings.max_missing_fraction * (times.size + total):
        remedy = "Split the recording there"
        raise InputError(f"{total} samples are missing", file=path, place=where, found=found, remedy=remedy)
    detail = f"{total} samples are missing in one gap {where}: {found}"
    if after.size > 1:
        each = [f"{samples:.4g} after {row}" for samples, row in zip(lost, after, strict=True)]
        gaps = f"in {after.size} gaps, the longest {where}: {found} ({listed(each, LISTED, counted=True)})"
        detail = f"{total} samples are missing {gaps}"
    if moved:
        detail += "; what lies between gaps is moved by parts of a sample onto one grid, at its true times"
    return flag(path, "time_gap", "suspect", f"{detail}; what touches a gap is left out")


def agreed_rate(rates: Mapping[str, tuple[float | None, float]], path: Path, *, settings: IngestSettings) -> float:
    """Samples per second on which all ``rates`` (by who states it: Hz or None, relative uncertainty) agree.

    ``path`` names the recording in errors; ``settings`` give the tolerance, to which the uncertainties are added.
    Raises InputError where two of them disagree, and where none is stated.
    """
    stated = [(name, rate_hz, doubt) for name, (rate_hz, doubt) in rates.items() if rate_hz is not None]
    if not stated:
        remedy = "State [sampling] rate_hz, or time_source where a column holds the time, in the manifest"
        raise InputError("the sampling rate is not known", file=path, remedy=remedy)
    first, first_hz, first_doubt = stated[0]
    for name, rate_hz, doubt in stated[1:]:
        if abs(rate_hz - first_hz) > (settings.rate_tolerance + doubt + first_doubt) * first_hz:
            problem = f"the sampling rate is {rate_hz:.12g} Hz in the {name}, {first_hz:.12g} Hz in the {first}"
            raise InputError(problem, file=path, remedy="Find out which is right, and mend the other")
    return min(stated, key=lambda rate: rate[2])[1]  # of those that are sure alike the first


ENCODER = "the encoder"
"""Role of the trace or the speed signal that tells the angle."""
_MOST_DOUBT = 1e-4
"""By which two rates of one file may differ because their steps are rounded: what is one is rounded alike."""
_FEWEST = 3
_MOST_CUT = 0.05
"""Of a recording, which is left out without a word where its channels start at different times."""


class TimeBase(NamedTuple):
    """Samples per second of a column, the time [s] of its first sample on the clock of the file, their number."""

    rate_hz: float
    start_s: float
    n_samples: int

    @property
    def end_s(self) -> float:
        """Time [s] of the last sample."""
        return self.start_s + (self.n_samples - 1) / self.rate_hz

    def place(self, time_s: float, settings: IngestSettings) -> float:
        """Sample number at ``time_s`` [s], with fractions; whole within the jitter that ``settings`` allow a time."""
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

    bases, common_hz = {}, file_hz or 1.0
    for role, column in sampled.items():
        if column in samples:
            own_hz = stated.get(column, common_hz)
            same = abs(own_hz - common_hz) <= tolerance * common_hz
            bases[role] = TimeBase(common_hz if same else own_hz, starts.get(column, 0.0), samples[column])
    return bases, file_hz


def length_faults(bases: Mapping[str, TimeBase], path: Path) -> Iterator[InputError]:
    """Faults of columns of the file at ``path`` whose ``bases``, by role, differ only in length."""
    first: dict[tuple[float, float], str] = {}
    for role, base in bases.items():
        other = first.setdefault((base.rate_hz, base.start_s), role)
        if bases[other].n_samples != base.n_samples:
            problem = f"lengths differ: {other} has {bases[other].n_samples} samples, {role} has {base.n_samples}"
            yield InputError(problem, file=path, remedy="Export all channels over the same time at one rate")


def on_one_base(
    columns: dict[str, FloatArray], bases: Mapping[str, TimeBase], path: Path, *, settings: IngestSettings
) -> tuple[TimeBase, list[QualityFlag]]:
    """Bring the channels ``columns``, (samples,) by role, to one time base, in place; returns that base, and flags.

    The base has the lowest rate of the channels and spans the time in which they and the encoder were recorded (with
    one step beyond the ends of the encoder). Channels that differ by whole samples are cut, others are resampled within
    their band; channels on one base stay as they are. ``bases`` by role are those of the channels and of the encoder,
    which keeps its own. ``path`` is named in flags and errors; ``settings`` say when a place is whole. Raises
    InputError where columns on one base differ in length, or fewer than three samples are common to all.
    """
    for fault in length_faults(bases, path):
        raise fault
    shortest = min((base.n_samples for base in bases.values()), default=_FEWEST)
    if shortest < _FEWEST:
        problem, allowed = f"too short: {shortest} samples" if shortest else "no samples", f"{_FEWEST} samples or more"
        raise InputError(problem, file=path, allowed=allowed, remedy="Leave the recording out")
    if not columns:
        return bases.get(ENCODER, TimeBase(1.0, 0.0, 0)), []
    lowest_hz = min(bases[role].rate_hz for role in columns)
    grid = next(bases[role] for role in columns if bases[role].rate_hz == lowest_hz)
    told = {role: base for role, base in bases.items() if role in columns or role == ENCODER}
    flags = list(_start_flags(bases, path, settings))
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
        found = ", ".join(spans[:5] if len(spans) < 6 else [*spans[:4], spans[-1]])
        remedy = "Mend the start times in the file, or leave out what was recorded at another time"
        problem = "channels and encoder were not recorded at the same time"
        raise InputError(problem, file=path, found=found, remedy=remedy)
    base = TimeBase(lowest_hz, grid.start_s + first / lowest_hz, n_samples)
    for role, row in columns.items():
        place = bases[role].place(base.start_s, settings)
        whole = slice(round(place), round(place) + n_samples)
        columns[role] = resampled(row, place, step[role], n_samples) if role in moved else row[whole]
    return base, [*flags, *_loss_flags(bases, moved, base, path)]


def _start_flags(bases: Mapping[str, TimeBase], path: Path, settings: IngestSettings) -> Iterator[QualityFlag]:
    """Flag that says which of the ``bases`` begin later than the first of all, where any does."""
    first = min(bases, key=lambda role: bases[role].start_s)
    late = [role for role, base in bases.items() if base.place(bases[first].start_s, settings)]
    if late:
        lags = listed([f"{role} by {bases[role].start_s - bases[first].start_s:.9g} s" for role in late], 5)
        yield flag(path, "start_times", "info", f"later than {first} start {lags}, as the file says: so they are taken")


def _loss_flags(bases: Mapping[str, TimeBase], moved: list[str], base: TimeBase, path: Path) -> Iterator[QualityFlag]:
    """What was lost when channels on ``bases`` came to ``base``, of which some were ``moved`` between samples."""
    from crankorder.fft.resampling import PASS

    seconds, longest_s = base.n_samples / base.rate_hz, max(own.n_samples / own.rate_hz for own in bases.values())
    if longest_s - seconds > _MOST_CUT * longest_s:
        detail = f"{seconds:.6g} s of {longest_s:.6g} s were recorded by all channels: the rest is left out"
        yield flag(path, "recording_cut", "suspect", detail)
    if moved:
        rates = listed([f"{role} of {bases[role].rate_hz:.9g} Hz" for role in moved], 5)
        lost = f"what lies above {PASS * base.rate_hz:.6g} Hz is lost"
        detail = f"{rates}: resampled to {base.rate_hz:.9g} Hz and the times of another channel; {lost}"
        slower = any(bases[role].rate_hz != base.rate_hz for role in moved)
        yield flag(path, "channels_resampled", "suspect" if slower else "info", detail)
