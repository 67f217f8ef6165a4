"""Lines of the orders of a test, read row by row where their tracks are: one number for both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.identify.intervals import half_widths, interval
from crankorder.identify.said import UNRESOLVED
from crankorder.orders.track_rows import OrderRows, TrackReader, all_tracked, track_order
from crankorder.settings import OrderSettings

Floats = NDArray[np.float64]


def with_track_rows(
    orders: Sequence[AgreedOrder], reader: TrackReader, *, settings: OrderSettings
) -> tuple[AgreedOrder, ...]:
    """``orders`` whose lines hold the amplitudes, phases and intervals of the rows of their tracks, as ``reader`` has
    them for all orders of the test and those that ``settings`` ask for.

    At held speeds these are the rows at which a line was seen; of a sweep, those that surely hold something of it.
    Where the scatter within or between recordings makes a line's own interval wider, that stays.
    """
    cycle = int(reader.order_map.attrs["revs_per_cycle"])
    numbers = [track_number(one, revs_per_cycle=cycle) for one in orders]
    tracked = all_tracked(numbers, settings)
    names = reader.order_map["channel"].values.tolist()
    made = []
    for agreed, number in zip(orders, numbers, strict=True):
        rows = reader.rows(number, [other for other in tracked if other != number])
        worth = reader.worth(number)
        lines = tuple(_read(line, rows, names.index(line.channel), worth, reader) for line in agreed.lines)
        made.append(replace(agreed, lines=lines))
    return tuple(made)


def track_number(agreed: AgreedOrder, *, revs_per_cycle: int) -> float:
    """The number at which the track of ``agreed`` stands (``revs_per_cycle`` 1 or 2: what it may be locked to)."""
    ends = interval(agreed.order, agreed.order_error, freedom=agreed.degrees_of_freedom)
    return track_order(agreed.order, ends, agreed.lock, revs_per_cycle=revs_per_cycle)


def _read(line: OrderLine, rows: OrderRows, channel: int, worth: Floats, reader: TrackReader) -> OrderLine:
    """``line`` of the ``channel`` with what its ``rows`` hold; as it was where they hold nothing, or it is none."""
    if line.reservation == UNRESOLVED:
        return line
    amplitude, error = rows.amplitude[channel], rows.standard_error[channel]
    known = np.isfinite(amplitude) & np.isfinite(error) & (amplitude > 0.0)
    held = len(reader.map_rpm)
    chosen = known & (rows.amplitude_low[channel] > 0.0)
    chosen[:held] = known[:held] & np.isin(np.arange(held), line.seen)
    at = np.flatnonzero(chosen)
    if not len(at):
        return line
    ends = np.stack([rows.amplitude_low[channel, at], rows.amplitude_high[channel, at]], axis=1)
    made = replace(
        line,
        seen=reader.nearest_row_of_map(at),
        speed_rpm=reader.speed_rpm[at],
        amplitude=amplitude[at],
        amplitude_error=error[at],
        degrees_of_freedom=rows.degrees_of_freedom[channel, at].astype(np.float64),
        phase_deg=rows.phase[channel, at],
        ends=ends,
        phase_ci95_deg=rows.phase_ci95[channel, at],
        worth=worth[at],
    )
    return _as_wide(made, line, at < held)


def _as_wide(made: OrderLine, line: OrderLine, is_held: NDArray[np.bool_]) -> OrderLine:
    """``made`` with the intervals of ``line``, as shares of the amplitude, at held speeds at which these are wider."""
    place = {int(row): number for number, row in enumerate(line.seen)}
    error, freedom = made.amplitude_error.copy(), made.degrees_of_freedom.copy()
    ends = np.zeros((0, 2)) if made.ends is None else made.ends.copy()
    own_reach = half_widths(line.degrees_of_freedom) * line.amplitude_error
    own = np.stack([np.maximum(line.amplitude - own_reach, 0.0), line.amplitude + own_reach], axis=1)
    own = own if line.ends is None else line.ends
    reach = half_widths(freedom) * error
    for number in np.flatnonzero(is_held).tolist():
        before = place[int(made.seen[number])]
        size = float(line.amplitude[before])
        if not size > 0.0 or not np.isfinite(line.amplitude_error[before]):
            continue
        scale = float(made.amplitude[number]) / size
        ends[number, 0] = min(ends[number, 0], scale * float(own[before, 0]))
        ends[number, 1] = max(ends[number, 1], scale * float(own[before, 1]))
        if scale * own_reach[before] > reach[number]:
            error[number], freedom[number] = scale * line.amplitude_error[before], line.degrees_of_freedom[before]
    return replace(made, amplitude_error=error, degrees_of_freedom=freedom, ends=ends)
