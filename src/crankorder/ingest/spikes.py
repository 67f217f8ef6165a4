"""Spikes of the wiring: one to three samples far outside what their neighbours predict, after which nothing rings."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import numpy.typing as npt

from crankorder.ingest.fault import Runs, SignalFault
from crankorder.ingest.rawfile import FloatArray
from crankorder.ingest.signal_survey import Floats, Survey, grouped
from crankorder.settings import IngestSettings

_AHEAD, _OUT = 2, 12
"""Samples about the middle that a spike may take, and how far its neighbours reach: in so many a strike still rings."""
_DEGREE = 3
_PEAKED = 9.0
"""Fourth power of the bends over their squared mean square from which a block is looked at: 3 is Gaussian noise."""
_BLOCK = 128
"""Samples of a block: in fewer a spike does not stand out, in more it is diluted."""
_OF_STEP = 20.0
"""A spike is so many rounding steps at least."""
_MOST_LOOKED_AT = 20_000
_PULSES = 5
"""So many of one height, or one distance apart, are the pulses of a pickup."""


def find_spikes(
    signal: FloatArray, survey: Survey, *, settings: IngestSettings, may_pulse: bool
) -> tuple[SignalFault, Runs, Floats] | None:
    """The spikes of ``signal`` (sample,), their samples and, one after the other, what these would be without them.

    ``survey`` and ``settings`` say where to look and what stands out. A polynomial through 20 neighbours predicts
    the middle; the spike stands ``spike_ratio`` times further off it than any neighbour does, and above the root mean
    square of the signal. A strike or a knock rings through the neighbours.
    With ``may_pulse`` spikes that all look alike are taken for the signal itself.
    """
    places = _candidates(signal, survey)
    if not places.size:
        return None
    level = math.sqrt(float(np.nanmedian(survey.variances)) + float(np.nanvar(survey.means)))
    places, deviations, predicted = _standing_out(signal, places, level, settings)
    if not places.size or (may_pulse and _look_like_pulses(places, deviations)):
        return None
    offsets = np.arange(-_AHEAD, _AHEAD + 1)
    hit = np.abs(deviations) > 0.25 * np.abs(deviations).max(axis=1, keepdims=True)
    samples, first = np.unique((places[:, None] + offsets)[hit], return_index=True)
    values = predicted[hit][first]
    edges = np.flatnonzero(np.diff(samples) > 1)
    runs = Runs(samples[np.append(0, edges + 1)], samples[np.append(edges, samples.size - 1)] + 1)
    height = float(np.abs(deviations).max())
    detail = (
        f"{runs.starts.size} spike{'s' * (runs.starts.size > 1)} of one to three samples, up to {height:.4g} "
        f"({height / level:.3g} times the root mean square), after which nothing rings"
    )
    return SignalFault("spikes", "suspect", detail, runs), runs, values


def _candidates(signal: FloatArray, survey: Survey) -> npt.NDArray[np.int64]:
    """Samples that bend most in blocks with few large bends among small ones, each the largest of its neighbours."""
    group = max(_BLOCK // survey.size, 1)
    squares, fourths = grouped(survey.bend_squares, group), grouped(survey.bend_fourths, group)
    with np.errstate(invalid="ignore", over="ignore"):
        chosen = np.flatnonzero(fourths > _PEAKED * np.square(squares))
    if not chosen.size or signal.size < 2 * _OUT + 1:
        return np.empty(0, dtype=np.int64)
    if chosen.size > _MOST_LOOKED_AT // 4:
        sharpest = np.argsort(squares[chosen])[-_MOST_LOOKED_AT // 4 :]
        chosen = np.sort(chosen[sharpest])
    within = chosen[:, None] * (group * survey.size) + np.arange(group * survey.size)
    within = np.clip(within, _OUT, signal.size - _OUT - 1)
    bend = np.abs(signal[within] - 0.5 * (signal[within - 1] + signal[within + 1]))
    largest = 2.5 * np.sqrt(squares[chosen])[:, None]
    row, column = np.nonzero(bend > largest)
    places = np.unique(within[row, column])
    if places.size > _MOST_LOOKED_AT:
        return np.empty(0, dtype=np.int64)  # so many are the signal
    return np.asarray(places, dtype=np.int64)


@cache
def _prediction() -> tuple[Floats, Floats]:
    """Matrices from the neighbours (20) to what they predict for the middle (5), and to what they lie off the fit."""
    beside = np.concatenate([np.arange(-_OUT, -_AHEAD), np.arange(_AHEAD + 1, _OUT + 1)])
    middle = np.arange(-_AHEAD, _AHEAD + 1)
    inverse = np.linalg.pinv(np.vander(beside / _OUT, _DEGREE + 1))
    fitted = np.vander(beside / _OUT, _DEGREE + 1) @ inverse
    return np.vander(middle / _OUT, _DEGREE + 1) @ inverse, np.eye(beside.size) - fitted


def _standing_out(
    signal: FloatArray, places: npt.NDArray[np.int64], level: float, settings: IngestSettings
) -> tuple[npt.NDArray[np.int64], Floats, Floats]:
    """Those of ``places`` at which there is a spike: its deviations (place, 5) and what the neighbours predict."""
    to_middle, to_rest = _prediction()
    window = signal[places[:, None] + np.arange(-_OUT, _OUT + 1)].astype(np.float64)
    base = window[:, :1]
    middle = (window - base)[:, _OUT - _AHEAD : _OUT + _AHEAD + 1]
    beside = np.delete(window - base, np.s_[_OUT - _AHEAD : _OUT + _AHEAD + 1], axis=1)
    predicted, rest = beside @ to_middle.T, np.abs(beside @ to_rest.T).max(axis=1)
    deviations = middle - predicted
    steps = np.abs(np.diff(window, axis=1))
    rounding = np.where(steps > 0.0, steps, np.inf).min(axis=1)
    height = np.abs(deviations).max(axis=1)
    with np.errstate(invalid="ignore"):
        found = (height > settings.spike_ratio * rest) & (height > settings.spike_level * level)
        # a step of the rounding is no spike, but a lone spike among equal samples has no other step than its own
        found &= (height > _OF_STEP * rounding) | (np.count_nonzero(steps > 0.0, axis=1) <= 4) & (rest == 0.0)
    if np.count_nonzero(found) > 1:  # the same spike seen from two of its samples counts once
        found[1:] &= ~(found[:-1] & (np.diff(places) <= _AHEAD))
    return places[found], deviations[found], (predicted + base)[found]


def _look_like_pulses(places: npt.NDArray[np.int64], deviations: Floats) -> bool:
    if places.size < _PULSES:
        return False
    heights = np.take_along_axis(deviations, np.abs(deviations).argmax(axis=1)[:, None], axis=1)
    apart = np.diff(places)
    return bool(np.std(heights) < 0.2 * abs(float(np.mean(heights))) or np.std(apart) < 0.3 * float(np.mean(apart)))
