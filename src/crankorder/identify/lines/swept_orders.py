"""Orders that stand out in one recording whose speed sweeps: those worth following through it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from crankorder.identify.found import UNRESOLVED, OrderLine
from crankorder.identify.lines.cfar import LOWEST_BINS
from crankorder.identify.lines.order_lines import order_lines
from crankorder.orders.like_speed import reframed
from crankorder.orders.map import order_map
from crankorder.orders.track_rows import hann_lobe
from crankorder.quantities import Complexes, Floats
from crankorder.scratch import give_back
from crankorder.settings import MethodNumbers, Settings

NUMBERS = MethodNumbers("5-identify-lines.toml", "swept_orders")


def longer_frames(revs: float, span_rev: float) -> list[float]:
    """Lengths [rev] from ``revs`` on, each twice the one before, that a recording of ``span_rev`` holds."""
    made = [revs]
    while 2.0 * made[-1] <= NUMBERS.longest_revs and span_rev >= NUMBERS.fewest_lengths * 2.0 * made[-1]:
        made.append(2.0 * made[-1])
    return made


def longest_frame(revs: float, span_rev: float) -> float:
    """The last of :func:`longer_frames`, of ``revs`` and ``span_rev``."""
    return longer_frames(revs, span_rev)[-1]


SETTLING_STEPS = 3
"""Rounds in which numbers of close lines settle: each leaves a tenth of what the one before left."""

TRIALS_PER_TURN = 4
"""Frequencies that are tried in the width in which their phase runs apart by a turn from frame to frame."""

LARGEST_MOVE = 0.5
"""Share of the distance of two lines by which a number moves at most."""

WIDTH_BINS = 0.01
"""Step by which the shape of a line that swells or bends is differenced."""


def company_of(order: float, frames: xr.Dataset, others: Sequence[float] = ()) -> float:
    """Order of a line close to ``order`` in the OrderFrames ``frames`` of a sweep; NaN where there is none.

    Each frame is solved for the line, whose amplitude may run as a parabola, those of ``others`` (orders) in reach, and
    one more at every distance in turn; it is there where it lowers what the median frame leaves of the bins in reach by
    more than ``least_gain``.
    """
    revs = float(frames.attrs["revs_per_frame"])
    place = order * revs
    used = _bins_about(place, frames)
    turned = _turned(frames, used)
    seen = turned.reshape(-1, len(used))
    seen = seen[np.isfinite(seen).all(axis=1) & (seen != 0.0).any(axis=1)]
    if len(seen) < NUMBERS.fewest_frames or len(used) < NUMBERS.reach_bins:
        return float("nan")
    near = [other * revs for other in others if 0.0 < abs(other * revs - place) < 2.0 * NUMBERS.reach_bins]
    known = [_changing_lobe(used - place), *(_changing_lobe(used - other)[:2] for other in near)]
    base = np.linalg.qr(np.concatenate(known).T)[0]
    left = seen - (seen @ base) @ base.T
    energy = np.maximum((np.abs(left) ** 2).sum(axis=1), np.finfo(float).tiny)
    beside: Floats = np.arange(NUMBERS.nearest_bins, NUMBERS.reach_bins - 1.0, NUMBERS.step_bins)
    apart = np.concatenate([-beside[::-1], beside])
    lobes = hann_lobe(used - place - apart[:, None])
    lobes -= (lobes @ base) @ base.T
    lobes /= np.linalg.norm(lobes, axis=1, keepdims=True)
    share = np.median(1.0 - np.abs(left @ lobes.T) ** 2 / energy[:, None], axis=0)
    best = int(share.argmin())
    return order + float(apart[best]) / revs if share[best] * NUMBERS.least_gain < 1.0 else float("nan")


def settled(orders: Sequence[float], frames: xr.Dataset, others: Sequence[float] = ()) -> list[float] | None:
    """Numbers of the close lines ``orders`` by how their phases run over the OrderFrames ``frames`` of a sweep.

    Each frame is solved for all of them and those of ``others`` (orders) in reach; what most steps from frame to frame
    turn a line by is how far it is off. None where one moves by more than LARGEST_MOVE of their distance, or keeps a
    frequency rather than an order: then they are no two lines that keep their numbers, but one and what it rings.
    """
    revs = float(frames.attrs["revs_per_frame"])
    middle, apart = float(np.mean(orders)), float(np.diff(sorted(orders)).min())
    used = _bins_about(middle * revs, frames)
    centre: Floats = frames["crank_angle"].values + 0.5 * revs
    turned = _turned(frames, used)
    near = [
        _changing_lobe(used - other * revs)[:2]
        for other in others
        if abs(other - middle) * revs < 2.0 * NUMBERS.reach_bins
    ]
    numbers: Floats = np.array(orders, dtype=np.float64)
    for _ in range(SETTLING_STEPS):
        lobes = np.concatenate([hann_lobe(used - numbers[:, None] * revs), *near])
        phasors = turned @ np.linalg.pinv(lobes)[:, : len(numbers)]
        steady = phasors * np.exp(-2j * np.pi * (np.outer(centre, numbers) % 1.0))
        steps = np.nansum(steady[:, 1:] * steady[:, :-1].conj(), axis=0)
        unit = steps / np.maximum(np.abs(steps), np.finfo(float).tiny)
        mean = np.exp(1j * np.angle(unit.sum(axis=0)))  # about which the median turn [rev] is taken
        turn = (np.angle(mean) + np.median(np.angle(unit / mean), axis=0)) / (2.0 * np.pi)
        numbers = numbers + turn / float(np.median(np.diff(centre)))
    moved = np.abs(numbers - np.asarray(orders)).max()
    rings = any(_keeps_frequency(step, number, frames) for step, number in zip(steps.T, numbers, strict=True))
    return None if rings or moved > LARGEST_MOVE * apart else numbers.tolist()


def _keeps_frequency(steps: Complexes, order: float, frames: xr.Dataset) -> bool:
    """Whether ``steps`` (frames - 1,) from frame to frame turn as those of one frequency near ``order``, rather than as
    those of one order: a lightly damped mode rings on at its own."""
    speed = frames["speed"].values
    minutes = np.diff(frames["crank_angle"].values) / (0.5 * (speed[1:] + speed[:-1]))
    unit = steps / np.maximum(np.abs(steps), np.finfo(float).tiny)
    trials = 2 + int(TRIALS_PER_TURN * order * float(np.ptp(speed) * np.median(minutes)))
    turns = np.outer(order * np.linspace(speed.min(), speed.max(), trials), minutes)
    return bool(np.abs(np.exp(-2j * np.pi * turns) @ unit).max() >= np.abs(unit.sum()))


def _bins_about(place: float, frames: xr.Dataset) -> Floats:
    """Numbers of the bins in reach of ``place`` (in bins)."""
    first, last = round(place) - NUMBERS.reach_bins, round(place) + NUMBERS.reach_bins + 1
    return np.arange(max(1, first), min(frames.sizes["order"], last), dtype=np.float64)


def _turned(frames: xr.Dataset, used: Floats) -> Complexes:
    """Spectra (channels, frames, bins) in the bins ``used``, phases counted from the middle of each frame."""
    revs = float(frames.attrs["revs_per_frame"])
    centre = frames["crank_angle"].values + 0.5 * revs
    turn = np.exp(2j * np.pi * (np.outer(centre, used) / revs % 1.0))
    return np.asarray(frames["spectrum"].values[:, :, used.astype(int)] * turn)


def _changing_lobe(off_bins: Floats) -> Floats:
    """Lobe (3, bins) of a line that is steady, that grows, and that bends."""
    before, here, after = (hann_lobe(off_bins + side * WIDTH_BINS) for side in (-1.0, 0.0, 1.0))
    return np.array([here, after - before, before + after - 2.0 * here])


def swept_orders(frames: xr.Dataset, *, settings: Settings) -> list[float]:
    """Orders (cycles per crank revolution, rising) that stand out in the OrderFrames ``frames`` of one recording.

    In any channel, locked or not; ``settings`` of identify say what stands out, those of orders how frames are
    averaged. They are looked for in frames of several lengths, for the sweep asks for short ones, which blur lines
    that are close; a line so close that it does not stand out by itself is found by what the other one leaves. Lines
    that frames cannot tell from a multiple of the cycle's frequency, or from one seen in longer frames, or from a
    stronger one, are one with that; of more than twenty the strongest are taken.
    """
    if not frames["spectrum"].notnull().any():
        return []
    cycle = int(frames.attrs["revs_per_cycle"])
    kept: list[tuple[float, float]] = []
    for item in _lengthened(frames):
        step = 1.0 / float(item.attrs["revs_per_frame"])
        for line in sorted(_lines(item, settings), key=lambda line: -line.level_over_floor_db):
            order = _on_multiple(line.order, cycle, step)
            if order > 0.0 and all(abs(order - other) > step for other, _ in kept):
                kept.append((order, line.level_over_floor_db))
        del item  # before the next is made
    for item in _lengthened(frames):
        step = 1.0 / float(item.attrs["revs_per_frame"])
        lowest = LOWEST_BINS * step  # below it is the mean
        for order, level in list(kept):
            others = [other for other, _ in kept]
            company = company_of(order, item, others)
            if company > lowest and all(abs(company - other) > 0.5 * abs(company - order) for other in others):
                numbers = settled((order, company), item, [other for other in others if other != order])
                if numbers is None or min(numbers) < lowest:
                    continue
                placed = [_on_multiple(number, cycle, step) for number in numbers]
                kept.remove((order, level))
                kept += [(number, level) for number in (placed if placed[0] != placed[1] else numbers)]
        del item
    strongest = sorted(kept, key=lambda one: -one[1])[: NUMBERS.most_followed]
    return sorted(order for order, _ in strongest)


def _on_multiple(order: float, cycle: int, step: float) -> float:
    """``order``, or the multiple of 1 / ``cycle`` that bins of ``step`` orders do not tell from it."""
    multiple = round(order * cycle) / cycle
    return multiple if abs(order - multiple) < NUMBERS.same_bins * step else order


def _lines(frames: xr.Dataset, settings: Settings) -> list[OrderLine]:
    found = order_map([frames], settings=settings.orders)
    lines = order_lines(found, settings=settings.identify, orders=settings.orders, frames=[frames])
    return [line for line in lines if UNRESOLVED not in line.doubts]  # no number to follow


def _lengthened(frames: xr.Dataset) -> Iterator[xr.Dataset]:
    """``frames`` and those of twice, four times … their length that the recording holds, the longest first.

    Each is made when it is asked for: those of a long recording fill the memory.
    """
    begin, length = frames["crank_angle"].values, int(frames.attrs["revs_per_frame"])
    held = float(np.ptp(begin)) + length
    for revs in longer_frames(length, held)[:0:-1]:
        item = reframed(frames, round(revs))
        if item is not None and item.sizes["frame"]:
            yield item
        del item
        give_back()
    yield frames
