"""Buffers of an analyser that were written one behind the other, turns between them lost: found, and laid apart.

The shaft and the channels must both tell it: one turn is too short or too long among others that are alike, by no whole
turn as a lost or false pulse would have it, and at one sample of it the channels change from what they did a turn
before to what they do a turn later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from crankorder.ingest.rawfile import FloatArray, flag
from crankorder.ingest.shaft_signals import Gathered
from crankorder.quantities import Floats, QualityFlag

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
    around = np.lib.stride_tricks.sliding_window_view(np.pad(step, BESIDE, mode="symmetric"), 2 * BESIDE + 1)
    usual = np.median(around, axis=1)
    off = np.abs(step - usual)
    slack = max(ODD_SAMPLES, ODD_SIGMAS * 1.4826 * float(np.median(off)))
    odd = np.flatnonzero(off > slack)
    breaks: list[Break] = []
    for group in np.split(odd, np.flatnonzero(np.diff(odd) > 1) + 1) if odd.size else []:
        first, last = int(group[0]), int(group[-1]) + 1
        if not 1 < first < last < step.size - 1:
            continue
        # two turns: half orders repeat after no less
        before, after = float(turns[first] - turns[first - 2]), float(turns[last + 2] - turns[last])
        length, turn = float(turns[last] - turns[first]), 0.25 * (before + after)
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

    Two turns before and after it are ``ahead`` and ``behind`` samples long.
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
            # by the place of a break: what is before it repeats the turns before, what is behind those after
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


def _told(breaks: Sequence[Break], rate_hz: float) -> str:
    """Words for the ``breaks``: where each is, and what the turn across it lacks."""
    listed = [
        f"sample {one.sample} ({one.sample / rate_hz:.6g} s: {one.turn:.0f} samples where a turn has {one.usual:.0f})"
        for one in breaks
    ]
    more = f" and {len(listed) - LISTED} more" if len(listed) > LISTED else ""
    return ", ".join(listed[:LISTED]) + more


def laid_apart(recording: Gathered, channels: dict[str, FloatArray], path: Path, flags: list[QualityFlag]) -> None:
    """Lay buffers that were written one behind the other apart, in ``channels`` and the pulses of ``recording``.

    Where the pulses do not tell a turn the angle is lost across a break: the longest stretch is kept alone.
    ``channels`` (name to samples) are those of the file at ``path``; ``flags`` take what was found.
    """
    attrs, rate_hz = recording.attrs, float(recording.attrs["rate_hz"])
    teeth = len(attrs.get("tooth_angles_deg", [])) or attrs.get("pulses_per_rev", 0) - attrs.get("missing_teeth", 0)
    marked = "index_time" in recording.variables and recording.values("index_time").size > 1
    turns = recording.values("index_time") if marked else recording.values("pulse_time")[:: teeth or None]
    breaks = find_breaks(turns * rate_hz, list(channels.values())) if marked or teeth else []
    if not breaks:
        return
    n_samples = next(iter(channels.values())).size
    lost = np.zeros(n_samples, dtype=np.int64)
    lost[[one.sample for one in breaks]] = [one.missing for one in breaks]
    places = np.arange(n_samples) + np.cumsum(lost)
    total = int(places[-1]) + 1
    first, end = 0, total
    said = f"samples are missing before {_told(breaks, rate_hz)}: the channels jump there too, as between two buffers"
    if marked or teeth == 1:
        said += f"; {total - n_samples} samples are put in to make these turns whole; what touches them is left out"
    else:
        ends = np.array([0, *(one.sample for one in breaks), n_samples])
        first = int(ends[np.argmax(np.diff(ends))])
        end, places = first + int(np.diff(ends).max()), np.arange(n_samples)
        said += f"; the pulses do not tell the angle across: samples {first} to {end - 1} are used alone"
    flags.append(flag(path, "buffers_joined", "suspect", said))
    for name, column in channels.items():
        gridded = np.full(max(total, end), np.nan, dtype=column.dtype)
        gridded[places] = column
        channels[name] = gridded[first:end]
    at = np.array([one.sample for one in breaks])
    moved = places - np.arange(n_samples) - first
    for name in ("pulse_time", "index_time", "cam_time"):
        if name in recording.variables:
            place = recording.values(name) * rate_hz
            place = place[(np.abs(place[:, None] - at) > EDGE_SAMPLES).all(axis=1)]
            place = place + moved[np.clip(np.ceil(place).astype(int), 0, n_samples - 1)]
            inside = (place >= 0) & (place <= end - first - 1)
            known = recording.variables[name]
            recording.variables[name] = xr.Variable(known.dims, place[inside] / rate_hz, known.attrs)
    gaps = np.append(np.round(np.array(attrs.get("gap_starts_s", [])) * rate_hz).astype(int), at - 1)
    recording.attrs["gap_starts_s"] = sorted(((gaps + moved[gaps]) / rate_hz).tolist())
