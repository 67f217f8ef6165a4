"""The one sampling rate of a recording, from what the file, its time column and the manifest say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crankorder.errors import InputError
from crankorder.ingest.rawfile import FloatArray, flag
from crankorder.quantities import Floats, QualityFlag
from crankorder.scratch import blocks
from crankorder.settings import IngestSettings

SOME_TIMES = 1 << 20
"""Times that are enough to tell the usual step."""


@dataclass(frozen=True, slots=True)
class TimeColumn:
    """What a column of times says: samples per second, its relative uncertainty, and the first time."""

    rate_hz: float
    rate_uncertainty: float
    start_s: float
    flags: list[QualityFlag]


def read_time_column(times: FloatArray, path: Path, *, settings: IngestSettings) -> TimeColumn:
    """Rate and start of a column of ``times`` in seconds, shape (sample,), which must be uniform.

    ``path`` names the recording in errors; ``settings`` say how far a time may lie off the uniform grid.
    Raises InputError naming the sample where times repeat, go back, leave a gap or wander.
    """
    _refuse_gaps(times, path)
    start = float(times[0])
    span_s = float(times[-1]) - start
    step_s = span_s / (times.size - 1)
    jitter = max(
        float(np.abs((_double(times, part) - start) / step_s - np.arange(part.start, part.stop)).max())
        for part in blocks(times.size)
    )
    if jitter > settings.max_time_jitter_samples:
        raise InputError(
            f"the time column is not uniform: off by {jitter:.3g} samples",
            file=path,
            allowed=f"{settings.max_time_jitter_samples:g} samples (ingest.max_time_jitter_samples)",
            remedy="Resample the recording, or drop time_source and state [sampling] rate_hz",
        )
    flags = []
    if jitter > settings.time_jitter_samples:
        detail = f"times lie off a uniform grid by up to {jitter:.2g} samples (rounded?); a uniform grid is used"
        flags.append(flag(path, "time_jitter", "info", detail))
    # each end is known to within its own jitter, and a rounding error of the arithmetic
    uncertainty = 2.0 * max(jitter, 1e-9) / (times.size - 1)
    # twelve digits: 100 kHz in a decimal column is 100 kHz, not 100000.00000000001
    return TimeColumn(float(f"{1.0 / step_s:.12g}"), uncertainty, start, flags)


def _double(times: FloatArray, part: slice) -> Floats:
    return times[part].astype(np.float64, copy=False)


def _steps(times: FloatArray) -> Iterator[tuple[int, Floats]]:
    """First sample and steps of each block of ``times``."""
    for part in blocks(times.size - 1):
        yield part.start, np.diff(_double(times, slice(part.start, part.stop + 1)))


def _refuse_gaps(times: FloatArray, path: Path) -> None:
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
    step_s = float(np.median(np.diff(_double(times, slice(SOME_TIMES)))))
    for first, steps in _steps(times):
        if steps.max() > 1.5 * step_s:
            place = first + int(np.argmax(steps > 1.5 * step_s))
            lost = round(steps[place - first] / step_s) - 1
            raise InputError(
                f"{lost} samples are missing",
                file=path,
                place=f"after sample {place} ({times[place]:.9g} s)",
                found=f"a step of {steps[place - first]:.6g} s among steps of {step_s:.6g} s",
                remedy="Split the recording there, or record it again",
            )


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
