"""What an encoder column looks like: its kind, its better edge, and the wheel that its pulses tell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crankorder.errors import CrankorderError
from crankorder.ingest.formats import read_file
from crankorder.ingest.rawfile import RawFile
from crankorder.settings import load_settings
from crankorder.shaft.pattern import known_names
from crankorder.shaft.pattern_search import FoundPattern, find_pattern
from crankorder.shaft.pulses import FloatArray, find_pulses

# Samples that are enough to see a wheel.
MOST_SAMPLES = 4_000_000
# A trace with this share of its samples at its two levels is a square wave; a sine has 0.51.
SQUARE_SHARE = 0.75


@dataclass(frozen=True)
class EncoderGuess:
    """Kind and edge of an encoder as its values look, and the wheel that was found, if any."""

    kind: str
    edge: str
    found: FoundPattern | None


def encoder_guess(
    path: Path, source: str, *, index: str | None, time: str | None, rate_hz: float | None
) -> EncoderGuess | None:
    """What the encoder of a recording seems to be, or None where it cannot be read as one.

    Parameters
    ----------
    path : the recording
    source : its encoder column
    index : its column of a once-per-revolution mark, or None
    time : its column of times, or None
    rate_hz : samples per second that the file states, or None
    """
    settings = load_settings()
    try:
        sources = [name for name in (source, index, time) if name is not None]
        raw = read_file(path, sources=list(sources), settings=settings.ingest)
        pulses = _edges(raw, source, time, rate_hz)
        marks = _edges(raw, index, time, rate_hz)[2] if index is not None else {}
    except (CrankorderError, OSError, ValueError):
        return None
    kind, first, by_edge = pulses
    mark_s = next(iter(marks.values()), None)
    found = {edge: find_pattern(time_s, index_time_s=mark_s) for edge, time_s in by_edge.items()}
    best = max(found, key=lambda edge: (_likely(found[edge]), edge == first))
    return EncoderGuess(kind, best, found[best])


def _likely(found: FoundPattern | None) -> tuple[int, float]:
    """How good a finding is: a wheel that is known before one that is not, then the share of revolutions."""
    if found is None:
        return 0, 0.0
    known = found.pattern.even is not None or found.pattern.name in known_names()
    return 2 if known else 1, found.agreement


def _edges(
    raw: RawFile, source: str, time: str | None, rate_hz: float | None
) -> tuple[str, str, dict[str, FloatArray]]:
    """Kind of a column, the edge to prefer, and the pulse times of each edge."""
    values = raw.columns[source][:MOST_SAMPLES].astype(np.float64)
    if values.size > 3 and np.isfinite(values).all() and (np.diff(values) >= 0.0).all() and np.ptp(values) > 0.0:
        return "pulse_times", "rising", {"rising": values}
    times = None if time is None else raw.columns[time][:MOST_SAMPLES].astype(np.float64)
    if times is not None and not _uniform(times):
        high = values > 0.5 * (values.min() + values.max())
        turns = {"rising": high[1:] & ~high[:-1], "falling": ~high[1:] & high[:-1]}
        return "edge_list", "rising", {edge: times[1:][turned] for edge, turned in turns.items()}
    rate = rate_hz if times is None else float((times.size - 1) / np.ptp(times))
    kind = "square" if _is_square(values) else "analogue"
    shaft = load_settings().shaft
    by_edge = {
        edge: find_pulses(
            values,
            rate_hz=rate or 1.0,
            kind="square" if kind == "square" else "analogue",
            edge="rising" if edge == "rising" else "falling",
            pulses_per_rev=1,
            settings=shaft,
        ).time_s
        for edge in ("rising", "falling")
    }
    return kind, "rising", by_edge


def _uniform(times: FloatArray) -> bool:
    step = np.diff(times)
    return times.size > 2 and bool(np.ptp(step) < 0.5 * np.median(step))


def _is_square(values: npt.NDArray[Any]) -> bool:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    near = 0.15 * (high - low)
    return float(np.mean((values < low + near) | (values > high - near))) >= SQUARE_SHARE
