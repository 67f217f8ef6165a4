"""Bands of the frequency axis that are fitted one by one: modes far apart see of each other but a smooth background."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.floor import Floor
from crankorder.identify.modal.search import peaks
from crankorder.identify.modal.surface_fit import NO_POLES, Poles

LONGEST_BINS = 1120
"""Bins of a floor that is fitted as one."""

BAND_BINS = 640
"""Bins of a band, about, where there are more."""

MOST_PEAKS = 14
"""Peaks of a floor that is fitted as one."""

BAND_PEAKS = 6
"""Peaks of a band, about, where there are more."""

SHARED_BINS = 40
"""Bins on each side that a band shares with the next: what stands there is fitted in both and belongs to one."""

BAND_SHARE = 0.15
"""Width of a band as a share of its frequency at least: some widths of a well damped mode."""

SHARED_SHARE = 0.01
"""Share of its frequency that a band shares with the next at least."""

SLACK = 0.25
"""Share of a band's width by which a cut may move away from peaks."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Band:
    """``floor`` of a band with what it shares with the next ones; poles from ``low_hz`` to ``high_hz`` belong to it.

    ``first`` and ``last`` are the bins of the whole floor that are its own, the last one excluded.
    """

    floor: Floor
    low_hz: float
    high_hz: float
    first: int
    last: int

    def owns(self, poles: Poles) -> NDArray[np.bool_]:
        """Which of ``poles`` (M,) belong to this band."""
        return np.asarray((poles.frequency_hz >= self.low_hz) & (poles.frequency_hz < self.high_hz))

    def holds(self, poles: Poles) -> NDArray[np.bool_]:
        """Which of ``poles`` (M,) lie in it or in what it shares."""
        at, step = poles.frequency_hz, self.floor.step_hz
        return np.asarray((at > self.floor.frequency_hz[0] - step) & (at < self.floor.frequency_hz[-1] + step))


def bands_of(floor: Floor) -> tuple[Band, ...]:
    """Bands of ``floor``, cut away from its peaks; one where it is short and has few."""
    n_bins = len(floor.frequency_hz)
    seen = _peaks_by_part(floor)
    if n_bins <= LONGEST_BINS and len(seen) <= MOST_PEAKS:
        return (Band(floor, -math.inf, math.inf, 0, n_bins),)
    load = 1.0 / np.maximum(BAND_BINS, BAND_SHARE * floor.frequency_hz / floor.step_hz)
    np.add.at(load, np.searchsorted(floor.frequency_hz, seen.frequency_hz).clip(0, n_bins - 1), 1.0 / BAND_PEAKS)
    load = np.cumsum(load)
    n_bands = max(1, math.ceil(load[-1] - 1e-9))
    cuts = [0, *(_quiet_cut(floor, seen, load, k / n_bands, n_bands) for k in range(1, n_bands)), n_bins]
    cuts = sorted(set(cuts))
    return tuple(_band(floor, first, last) for first, last in pairwise(cuts))


def _band(floor: Floor, first: int, last: int) -> Band:
    n_bins = len(floor.frequency_hz)
    below, above = (
        max(SHARED_BINS, round(SHARED_SHARE * float(floor.frequency_hz[end]) / floor.step_hz))
        for end in (first, last - 1)
    )
    at = slice(max(0, first - below), min(n_bins, last + above))
    part = replace(
        floor,
        frequency_hz=floor.frequency_hz[at],
        psd=floor.psd[:, at],
        averages=floor.averages[:, at],
        cells=floor.cells[:, :, at],
        whole=floor.whole[:, at],
        strong=tuple(t for t in floor.strong if floor.frequency_hz[at][0] <= t[0] <= floor.frequency_hz[at][-1]),
    )
    low = floor.frequency_hz[first] - 0.5 * floor.step_hz if first else -math.inf
    high = floor.frequency_hz[last] - 0.5 * floor.step_hz if last < n_bins else math.inf
    return Band(part, float(low), float(high), first, last)


def _peaks_by_part(floor: Floor) -> Poles:
    """Peaks of ``floor``, looked for part by part, which takes a time that grows as the floor does."""
    made = NO_POLES
    for first in range(0, len(floor.frequency_hz), BAND_BINS):
        part = _band(floor, first, min(first + BAND_BINS, len(floor.frequency_hz)))
        if len(part.floor.frequency_hz) >= 2 * SHARED_BINS:
            here = peaks(part.floor)
            made = made.joined(here.chosen(part.owns(here)))
    return made


def _quiet_cut(floor: Floor, seen: Poles, load: Array, share: float, n_bands: int) -> int:
    """Bin near that at ``share`` of the ``load`` which lies the most widths away from any peak."""
    low, high = np.searchsorted(load, load[-1] * (share + SLACK / n_bands * np.array([-1.0, 1.0])))
    bins = np.arange(max(int(low), 1), min(max(int(high), int(low) + 1), len(load) - 1) + 1)
    if not len(seen):
        return int(bins[len(bins) // 2])
    width = seen.damping * seen.frequency_hz + 3.0 * floor.seen.bin_hz
    away = (np.abs(floor.frequency_hz[bins, None] - seen.frequency_hz) / width).min(axis=1)
    return int(bins[np.argmax(np.minimum(away, 10.0) - 1e-3 * np.abs(bins - bins.mean()) / len(bins))])
