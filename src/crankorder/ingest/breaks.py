"""Buffers of an analyser that were written one behind the other, turns between them lost: found, and laid apart.

The shaft and the channels must both tell it: one turn is too short or too long among others that are alike, by no whole
turn as a lost or false pulse would have it, and at one sample of it the channels change from what they did a turn
before to what they do a turn later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from crankorder.ingest.rawfile import FloatArray
from crankorder.quantities import Floats, Ints

BESIDE = 4
"""Turns on either side that tell how long one should be."""

ODD_SIGMAS, ODD_SAMPLES = 8.0, 2.5
"""A turn is odd beyond so many standard deviations of its neighbours, and so many samples: edges are rounded to one."""

MOST_ODD = 2
"""Odd turns in a row: the level may jump at a break too, and look like a pulse."""

LEAST_GAIN, MOST_LEFT, NOISE_LEFT = 2.0, 0.05, 0.1
"""A break explains, in half of the channels, so many times what differs between other turns; it leaves no more than
this share of that, and what chance does. A shaft that speeds up or slows down leaves a fifth."""

EDGE_SAMPLES = 1.5
"""A pulse so near to a break is none of the wheel's."""

LISTED = 5
"""Breaks that are named one by one."""


@dataclass(frozen=True, slots=True)
class Break:
    """The first ``sample`` behind a break, samples of the ``turn`` (or two) across it and of a ``usual`` one."""

    sample: int
    turn: float
    usual: float

    @property
    def missing(self) -> int:
        """Samples that make the turn across the break whole."""
        return round(-self.turn % self.usual)


def find_breaks(turns: Floats, channels: Sequence[FloatArray]) -> list[Break]:
    """Breaks of a recording, in order.

    Parameters
    ----------
    turns : (marks,), samples, where a mark of the shaft passes once per turn
    channels : signals (sample,) each, in any unit; missing samples are NaN
    """
    step = np.diff(turns)
    if step.size <= 2 * BESIDE:
        return []
    usual = median_filter(step, 2 * BESIDE + 1, mode="reflect")
    off = np.abs(step - usual)
    slack = max(ODD_SAMPLES, ODD_SIGMAS * 1.4826 * float(np.median(off)))
    odd = np.flatnonzero(off > slack)
    breaks: list[Break] = []
    for group in np.split(odd, np.flatnonzero(np.diff(odd) > 1) + 1) if odd.size else []:
        first, last = int(group[0]), int(group[-1]) + 1
        if not 0 < first < last < step.size:
            continue
        before, after = float(step[first - 1]), float(step[last])
        length, turn = float(turns[last] - turns[first]), 0.5 * (before + after)
        rest = length % turn
        # two turns and more are no break of a shaft that runs on: it stood still
        if group.size > MOST_ODD or length >= 2.0 * turn or min(rest, turn - rest) <= slack:
            continue
        sample = _jump(channels, round(turns[first]), round(turns[last]), round(before), round(after))
        if sample:
            breaks.append(Break(sample, length, turn))
    return breaks


def _jump(channels: Sequence[FloatArray], first: int, last: int, ahead: int, behind: int) -> int:
    """The sample, after ``first`` up to ``last``, at which all ``channels`` jump in phase; 0 where they do not.

    The turns before and after are ``ahead`` and ``behind`` samples long.
    """
    low, high, turn = first - ahead, last + behind, 0.5 * (ahead + behind)
    if low < ahead or high + behind > channels[0].size:
        return 0
    costs, jumps = [], np.zeros(high - low)
    for channel in channels:
        here, *others = (channel[low + lag : high + lag].astype(np.float64) for lag in (0, -ahead, behind))
        before, after = (np.nan_to_num(here - other) ** 2 for other in others)
        noise = 0.5 * float(before[:ahead].mean() + after[-behind:].mean())
        if noise > 0.0:
            # by the place of a break: what is before it is like the turn before, what is behind like the turn after
            cost = np.append(0.0, np.cumsum(before)) + after.sum() - np.append(0.0, np.cumsum(after))
            costs.append(cost / noise)
            jumps[1:] += np.nan_to_num(np.diff(here)) ** 2 / noise
    if not costs:
        return 0
    total = np.sum(costs, axis=0)[ahead:-behind]
    likely = np.flatnonzero(total < total.min() + jumps.max())
    best = ahead + int(likely[np.argmax(jumps[ahead + likely])])
    gain = np.array([min(cost[0], cost[-1]) - cost[best] for cost in costs]) / turn
    left = np.array([cost[best] - (high - low) for cost in costs]) / turn
    if np.sort(gain)[(gain.size - 1) // 2] < LEAST_GAIN or left.sum() > MOST_LEFT * gain.sum() + NOISE_LEFT:
        return 0
    return low + best


def laid_apart(breaks: Sequence[Break], n_samples: int) -> tuple[Ints, int]:
    """New place of each of ``n_samples``, so that each turn across one of the ``breaks`` is whole, and their number."""
    moved = np.zeros(n_samples, dtype=np.int64)
    moved[[one.sample for one in breaks]] = [one.missing for one in breaks]
    places = np.arange(n_samples) + np.cumsum(moved)
    return places, int(places[-1]) + 1


def told(breaks: Sequence[Break], rate_hz: float) -> str:
    """Words for the ``breaks``: where each is, and what the turn across it lacks."""
    listed = [
        f"sample {one.sample} ({one.sample / rate_hz:.6g} s: {one.turn:.0f} samples where a turn has {one.usual:.0f})"
        for one in breaks
    ]
    more = f" and {len(listed) - LISTED} more" if len(listed) > LISTED else ""
    return ", ".join(listed[:LISTED]) + more
