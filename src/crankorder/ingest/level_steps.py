"""A gain that changes within a recording: one channel's level steps, once and for good, while the others' do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crankorder.ingest.fault import SignalFault, runs_of
from crankorder.ingest.signal_survey import Survey, grouped
from crankorder.settings import IngestSettings

_PIECES = 64
_EDGE = 6
"""Pieces before and behind a step at least."""
_AGREE = 0.2
"""Share of the step that either level may scatter by, and that the others may move."""


def find_level_steps(surveys: Sequence[Survey], *, settings: IngestSettings) -> dict[int, SignalFault]:
    """Faults by number of the channels of ``surveys`` whose level steps (``settings``) beside all others."""
    if len(surveys) < 2:
        return {}
    group = len(surveys[0].means) // _PIECES
    if group < 4:
        return {}
    squares = np.stack([grouped(one.variances + (one.means - np.nanmean(one.means)) ** 2, group) for one in surveys])
    if not (np.isfinite(squares).all() and (squares > 0.0).all()):
        return {}
    levels = 0.5 * np.log(squares)
    found: dict[int, SignalFault] = {}
    for number, level in enumerate(levels):
        rest = np.median(np.delete(levels, number, axis=0), axis=0)
        at, step = _largest_step(level)
        if abs(step) < np.log(settings.level_ratio):
            continue
        before, after = level[: at - 1], level[at + 1 :]
        scatter = max(before.std(), after.std())
        moved = abs(float(np.median(rest[at:]) - np.median(rest[:at])))
        abrupt = abs(float(level[at + 1] - level[at - 2]))
        if scatter > _AGREE * abs(step) or moved > _AGREE * abs(step) or abrupt < 0.7 * abs(step):
            continue
        samples = at * group * surveys[number].size
        detail = (
            f"the level changes by a factor of {np.exp(step):.3g} at once, that of the others does not: gain or seat"
        )
        fault = SignalFault("level_step", "suspect", detail, runs_of((samples, surveys[number].n_samples)))
        found[number] = fault
    return found


def _largest_step(level: np.ndarray) -> tuple[int, float]:
    """First piece behind the best split of ``level`` (piece,) in two, and the step there."""
    splits = np.arange(_EDGE, len(level) - _EDGE + 1)
    total = np.cumsum(level)
    before = total[splits - 1] / splits
    after = (total[-1] - total[splits - 1]) / (len(level) - splits)
    gain = np.square(after - before) * splits * (len(level) - splits)
    best = int(np.argmax(gain))
    return int(splits[best]), float(after[best] - before[best])
