"""Orders of a sweep that its frames know roughly, by the numbers under which they were followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder
from crankorder.identify.intervals import half_width
from crankorder.identify.lines.order_lock import sure_half_width

SAME_ORDER = 1e-3
"""Share of an order within which a followed one is taken for it anyway."""


def numbered_as_followed(orders: Sequence[AgreedOrder], followed: Sequence[xr.Dataset]) -> tuple[AgreedOrder, ...]:
    """``orders`` of which an undecided one has the number under which it was followed, where its interval holds that.

    A fast sweep turns the phase of a line by its modes in so few revolutions that its number is known to a percent
    only; the tracks of ``followed`` (RecordingTracks) stand at a multiple of the cycle's then, or at what long frames
    tell. A number that another of the orders has already is left to that; errors grow by what a number moves.
    """
    tracks: list[NDArray[np.float64]] = [item["order"].values for item in followed if item.attrs.get("swept", 0)]
    if not tracks:
        return tuple(orders)
    numbers = np.unique(np.concatenate(tracks))
    taken = [number for number in numbers if any(abs(one.order - number) <= SAME_ORDER * number for one in orders)]
    made = []
    for one in orders:
        number = float(numbers[np.abs(numbers - one.order).argmin()]) if len(numbers) else np.inf
        off = abs(number - one.order)
        within = SAME_ORDER * number < off <= sure_half_width(one.order_error, one.degrees_of_freedom)
        if one.lock == "undecided" and within and number not in taken:
            taken.append(number)
            error = max(one.order_error, off / half_width(one.degrees_of_freedom))
            one = replace(one, order=number, order_error=error)
        made.append(one)
    return tuple(sorted(made, key=lambda item: item.order))
