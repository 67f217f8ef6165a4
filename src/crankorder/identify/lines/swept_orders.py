"""Orders that stand out in one recording whose speed sweeps: those worth following through it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.identify.found import OrderLine
from crankorder.identify.lines.lengths import longer_frames
from crankorder.identify.lines.order_lines import order_lines
from crankorder.identify.lines.swept_company import company_of, settled
from crankorder.identify.said import UNRESOLVED
from crankorder.orders.like_speed import reframed
from crankorder.orders.map import order_map
from crankorder.settings import Settings

MOST_FOLLOWED = 20
"""Orders that are followed jointly; the strongest, for the cost grows faster than their number."""

SAME_BINS = 0.5
"""A line within so many bins of a multiple of the cycle's frequency is taken to be it: in a sweep a bin tells
no better, and the two together could not be told apart."""


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
    lengths = _lengthened(frames)
    for item in lengths:
        step = 1.0 / float(item.attrs["revs_per_frame"])
        for line in sorted(_lines(item, settings), key=lambda line: -line.level_over_floor_db):
            order = _on_multiple(line.order, cycle, step)
            if order > 0.0 and all(abs(order - other) > step for other, _ in kept):
                kept.append((order, line.level_over_floor_db))
    for item in lengths:
        for order, level in list(kept):
            others = [other for other, _ in kept]
            company = company_of(order, item, others)
            if company > 0.0 and all(abs(company - other) > 0.5 * abs(company - order) for other in others):
                numbers = settled((order, company), item, [other for other in others if other != order])
                if numbers is None:
                    continue
                step = 1.0 / float(item.attrs["revs_per_frame"])
                placed = [_on_multiple(number, cycle, step) for number in numbers]
                kept.remove((order, level))
                kept += [(number, level) for number in (placed if placed[0] != placed[1] else numbers)]
    strongest = sorted(kept, key=lambda one: -one[1])[:MOST_FOLLOWED]
    return sorted(order for order, _ in strongest)


def _on_multiple(order: float, cycle: int, step: float) -> float:
    """``order``, or the multiple of 1 / ``cycle`` that bins of ``step`` orders do not tell from it."""
    multiple = round(order * cycle) / cycle
    return multiple if abs(order - multiple) < SAME_BINS * step else order


def _lines(frames: xr.Dataset, settings: Settings) -> list[OrderLine]:
    found = order_map([frames], settings=settings.orders)
    lines = order_lines(found, settings=settings.identify, orders=settings.orders, frames=[frames])
    return [line for line in lines if UNRESOLVED not in line.reservation]  # no number to follow


def _lengthened(frames: xr.Dataset) -> list[xr.Dataset]:
    """``frames`` and those of twice, four times … their length that the recording holds, the longest first."""
    begin, length = frames["crank_angle"].values, int(frames.attrs["revs_per_frame"])
    held = float(np.ptp(begin)) + length
    items = [frames]
    for revs in longer_frames(length, held)[1:]:
        item = reframed(frames, round(revs))
        items += [] if item is None or not item.sizes["frame"] else [item]
    return items[::-1]
