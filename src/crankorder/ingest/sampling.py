"""The one sampling rate of a recording, from what the file, its time column and the manifest say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crankorder.errors import InputError
from crankorder.ingest.rawfile import FloatArray, flag
from crankorder.quantities import Floats, Ints, QualityFlag
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

SOME_TIMES = 1 << 20
"""Times that are enough to tell the usual step."""


@dataclass(frozen=True, slots=True)
class TimeColumn:
    """What a column of times says: samples per second, its relative uncertainty, and the first time.

    ``n_rows``: rows that count, without zeros at the end; ``places``: of each of them on the uniform grid, where rows
    are missing in between.
    """

    rate_hz: float
    rate_uncertainty: float
    start_s: float
    flags: list[QualityFlag]
    n_rows: int
    places: Ints | None = None

    def on_grid(self, column: FloatArray) -> FloatArray:
        """``column`` (row,) on the uniform grid, NaN where rows are missing."""
        kept = column[: self.n_rows]
        if self.places is None:
            return kept
        made = np.full(int(self.places[-1]) + 1, np.nan, dtype=column.dtype)
        made[self.places] = kept
        return made


def read_time_column(times: FloatArray, path: Path, *, settings: IngestSettings) -> TimeColumn:
    """Rate and start of a column of ``times`` in seconds, shape (sample,), which must be uniform but for gaps.

    ``path`` names the recording in errors; ``settings`` say how far a time may lie off the uniform grid, and how much
    may be missing. Raises InputError naming the sample where times repeat, go back or wander, or too many are missing.
    """
    n_rows = rows_before_zeros(times)
    flags: list[QualityFlag] = []
    if n_rows < times.size:
        flags.append(zeros_flag(times.size - n_rows, path))
        times = times[:n_rows]
    _refuse_disorder(times, path)
    places = _places(times, path, settings, flags)
    start = float(times[0])
    span_s = float(times[-1]) - start
    last = times.size - 1 if places is None else int(places[-1])
    step_s = span_s / last
    jitter = max(
        float(np.abs((_double(times, part) - start) / step_s - _numbers(places, part)).max())
        for part in blocks(times.size)
    )
    if jitter > settings.max_time_jitter_samples:
        raise InputError(
            f"the time column is not uniform: off by {jitter:.3g} samples",
            file=path,
            allowed=f"{settings.max_time_jitter_samples:g} samples (ingest.max_time_jitter_samples)",
            remedy="Resample the recording, or drop time_source and state [sampling] rate_hz",
        )
    if jitter > settings.time_jitter_samples:
        detail = f"times lie off a uniform grid by up to {jitter:.2g} samples (rounded?); a uniform grid is used"
        flags.append(flag(path, "time_jitter", "info", detail))
    # each end is known to within its own jitter, and a rounding error of the arithmetic
    uncertainty = 2.0 * max(jitter, 1e-9) / last
    # twelve digits: 100 kHz in a decimal column is 100 kHz, not 100000.00000000001
    return TimeColumn(float(f"{1.0 / step_s:.12g}"), uncertainty, start, flags, n_rows, places)


def _double(times: FloatArray, part: slice) -> Floats:
    return times[part].astype(np.float64, copy=False)


def _steps(times: FloatArray) -> Iterator[tuple[int, Floats]]:
    """First sample and steps of each block of ``times``."""
    for part in blocks(times.size - 1):
        yield part.start, np.diff(_double(times, slice(part.start, part.stop + 1)))


def _numbers(places: Ints | None, part: slice) -> Ints:
    return np.arange(part.start, part.stop) if places is None else places[part]


def rows_before_zeros(times: FloatArray) -> int:
    """Rows of ``times`` (row,) before those zeros at the end that some loggers write when they stop."""
    if times.size < 3 or times[-1] != 0.0 or not times[times.size // 2] > 0.0:
        return times.size
    return int(np.flatnonzero(times)[-1]) + 1


def zeros_flag(n_rows: int, path: Path) -> QualityFlag:
    """Flag that the last ``n_rows`` of the recording at ``path`` are zeros and left out."""
    return flag(path, "rows_of_zeros", "info", f"{n_rows} rows at the end whose time is 0 are left out")


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
            raise InputError(
                "time does not grow",
                file=path,
                place=f"sample {place}",
                found=f"{times[place]:.9g} s after {times[place - 1]:.9g} s",
                remedy="Mend time_source, or leave the recording out",
            )


def _places(times: FloatArray, path: Path, settings: IngestSettings, flags: list[QualityFlag]) -> Ints | None:
    """Place of each of ``times`` on the uniform grid where some are missing, which joins the ``flags``; else None.

    Raises InputError where more are missing than ``settings`` allow.
    """
    usual_s = float(np.median(np.diff(_double(times, slice(SOME_TIMES)))))
    after = np.concatenate([first + np.flatnonzero(steps > 1.5 * usual_s) for first, steps in _steps(times)])
    if not after.size:
        return None
    wide = np.asarray(times[after + 1] - times[after], dtype=np.float64)
    # between the gaps steps that were rounded add up to the true one
    step_s = (float(times[-1]) - float(times[0]) - wide.sum()) / (times.size - 1 - after.size)
    lost = np.round(wide / step_s).astype(np.int64) - 1
    place = int(after[np.argmax(lost)])
    where = f"after sample {place} ({times[place]:.9g} s)"
    found = f"a step of {wide.max():.6g} s among steps of {step_s:.6g} s"
    total = int(lost.sum())
    if total > settings.max_missing_fraction * (times.size + total):
        raise InputError(
            f"{total} samples are missing", file=path, place=where, found=found, remedy="Split the recording there"
        )
    gaps = f"in {after.size} gaps, the longest" if after.size > 1 else "in one gap"
    detail = f"{total} samples are missing {gaps} {where}: {found}; what touches a gap is left out"
    flags.append(flag(path, "time_gap", "suspect", detail))
    moved = np.zeros(times.size, dtype=np.int64)
    moved[after + 1] = lost
    return np.arange(times.size) + np.cumsum(moved)


def agreed_rate(
    *,
    file_hz: float | None,
    times: TimeColumn | None,
    manifest_hz: float | None,
    path: Path,
    settings: IngestSettings,
    file_uncertainty: float = 0.0,
) -> float:
    """Samples per second on which the file's statement ``file_hz``, its column ``times`` and ``manifest_hz`` agree.

    ``path`` names the recording in errors; ``settings`` give the tolerance, to which ``file_uncertainty`` (relative) of
    a rounded statement adds.
    Raises InputError where two of them disagree, so that never one silently wins, and where there is none.
    """
    stated: list[tuple[str, float, float]] = []
    if manifest_hz is not None:
        stated.append(("manifest", manifest_hz, 0.0))
    if file_hz is not None:
        stated.append(("file", file_hz, file_uncertainty))
    if times is not None:
        stated.append(("time column", times.rate_hz, times.rate_uncertainty))
    if not stated:
        raise InputError(
            "the sampling rate is not known",
            file=path,
            remedy="State [sampling] rate_hz, or time_source where a column holds the time, in the manifest",
        )
    first = stated[0]
    for name, rate_hz, uncertainty in stated[1:]:
        if abs(rate_hz - first[1]) > (settings.rate_tolerance + uncertainty + first[2]) * first[1]:
            raise InputError(
                f"the sampling rate is {rate_hz:.12g} Hz in the {name}, {first[1]:.12g} Hz in the {first[0]}",
                file=path,
                remedy="Find out which is right, and mend the other",
            )
    return min(stated, key=lambda item: item[2])[1]  # of those that are sure alike the first
