"""Orders that stand out in one recording whose speed sweeps: those worth following through it."""

from __future__ import annotations

import xarray as xr

from crankorder.identify.lines.order_lines import order_lines
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
    averaged. Lines that frames cannot tell from a multiple of the cycle's frequency, or from a stronger line, are one
    with that; of more than twenty the strongest are taken.
    """
    if not frames["spectrum"].notnull().any():
        return []
    lines = order_lines(
        order_map([frames], settings=settings.orders),
        settings=settings.identify,
        orders=settings.orders,
        frames=[frames],
    )
    step, cycle = 1.0 / float(frames.attrs["revs_per_frame"]), int(frames.attrs["revs_per_cycle"])
    kept: list[float] = []
    for line in sorted(lines, key=lambda line: -line.level_over_floor_db):
        multiple = round(line.order * cycle) / cycle
        order = multiple if abs(line.order - multiple) < SAME_BINS * step else line.order
        if order > 0.0 and all(abs(order - other) > step for other in kept):
            kept.append(order)
    return sorted(kept[:MOST_FOLLOWED])
