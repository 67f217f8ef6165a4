"""Orders of a test at one speed where more lines stand within a bin than steadiness and beat part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import OrderLine
from crankorder.identify.intervals import Z95
from crankorder.identify.known_lines import LOBE_BINS, Held, held_recordings
from crankorder.identify.lines.line_phasors import Recording
from crankorder.identify.lines.order_lines import NEIGHBOUR_BINS, NEIGHBOUR_ORDERS, ONE_SPEED
from crankorder.identify.lines.several_lines import STANDS_OVER, SolvedLine, leave_noise, several_lines
from crankorder.identify.mains import ALONE

LEVEL_BINS = 16
"""Bins on both sides of one whose median is the level that it stands over."""

FREEDOM = 40.0
"""Degrees of freedom of an error that some 24 places beside a line tell."""

SIGMAS = 3.0
"""Standard errors within which two lines lie at one distance, or are of one size …"""

ALIKE = 0.3
"""… or shares of the larger: what changes the size changes the angle a little, which takes from one side."""

SOLVED = "lines within a quarter order, solved together"
"""Words, after their number, of lines that were told apart so."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CloseLines:
    """Lines ``solved`` between the orders ``low`` and ``high`` of a recording of ``span_rev`` revolutions."""

    low: float
    high: float
    span_rev: float
    solved: tuple[SolvedLine, ...]

    def holds(self, order: float) -> bool:
        """Whether ``order`` is one of this neighbourhood."""
        return self.low <= order <= self.high


def close_lines(
    recordings: Sequence[Recording],
    order_map: xr.Dataset,
    *,
    told: Callable[[float, float], Sequence[float]],
    mains_hz: Sequence[float],
) -> list[CloseLines]:
    """Neighbourhoods of the mains in the OrderMap ``order_map`` of one speed that hold more lines than were told there.

    Where the mains or their double meet an order of a motor, sidebands stand about both; elsewhere a line beside
    another is told by its beat, and what swells in a third way is a line that changes. ``recordings`` are those of the
    test, of which the longest is looked at; ``told`` gives the orders that were told between two; ``mains_hz``: the
    frequencies of supplies.
    """
    if order_map.sizes["speed"] != 1 or order_map.attrs.get("window", "hann") != "hann":
        return []
    names = [str(name) for name in order_map["channel"].values]
    axis = np.asarray(order_map["order"].values, dtype=np.float64)
    held = max(held_recordings(recordings, axis, names), key=lambda one: one.span_rev, default=None)
    if held is None:
        return []
    reach = min(NEIGHBOUR_ORDERS, NEIGHBOUR_BINS * float(axis[1] - axis[0]))
    found = []
    of_mains = [60.0 * number * hertz / held.rpm for hertz in mains_hz for number in range(1, ALONE + 1)]
    for peak in _peaks(order_map, reach):
        low, high = float(axis[peak]) - reach, float(axis[peak]) + reach
        if not any(low <= order <= high for order in of_mains):
            continue
        orders = told(low, high)
        if leave_noise(held, low, high, orders):
            continue
        inside = _solved(held, low, high)
        if len(inside) > max(len(orders), 1) and not _is_modulated(inside):
            found.append(CloseLines(low, high, held.span_rev, tuple(inside)))
    return found


def _solved(held: Held, low: float, high: float) -> list[SolvedLine]:
    """Lines of ``held`` from ``low`` to ``high``; those beyond that reach into it take part."""
    beyond = LOBE_BINS / held.revs
    if low - beyond <= 0.0 or high + beyond >= held.axis[-1]:
        return []
    return [one for one in several_lines(held, low, high, beyond=beyond) if low <= one.order <= high]


def _is_modulated(lines: Sequence[SolvedLine]) -> bool:
    """Whether ``lines`` are pairs about the strongest, as one line makes them whose size or angle changes."""
    strongest = max(lines, key=lambda one: one.sigmas)
    rest = [one for one in lines if one is not strongest]
    for one in rest:
        away = one.order - strongest.order
        mirrored = [
            other
            for other in rest
            if abs(other.order - strongest.order + away) < SIGMAS * np.hypot(one.error, other.error)
            and _are_alike(one, other)
        ]
        if not mirrored:
            return False
    return True


def _are_alike(one: SolvedLine, other: SolvedLine) -> bool:
    """Whether both are of one size in all channels, as far as their errors and a changing speed tell."""
    room = SIGMAS * np.hypot(one.amplitude_error, other.amplitude_error)
    return bool(
        (np.abs(one.amplitude - other.amplitude) <= room + ALIKE * np.maximum(one.amplitude, other.amplitude)).all()
    )


def _peaks(order_map: xr.Dataset, reach: float) -> list[int]:
    """Bins that stand far over the level about them in a channel and are the largest within ``reach`` orders."""
    power = np.square(np.nan_to_num(order_map["amplitude"].values[:, 0].astype(np.float64)))
    bins = max(1, round(reach / float(order_map["order"].values[1] - order_map["order"].values[0])))
    wide = np.pad(power, ((0, 0), (LEVEL_BINS, LEVEL_BINS)), mode="reflect")
    level = np.median(np.lib.stride_tricks.sliding_window_view(wide, 2 * LEVEL_BINS + 1, axis=1), axis=2)
    over = (power / np.maximum(level, 1e-300)).max(axis=0)
    padded = np.pad(over, bins, constant_values=-1.0)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * bins + 1).max(axis=1)
    return [int(at) for at in np.flatnonzero((over >= highest) & (over > STANDS_OVER))]


def lines_at(close: CloseLines, one: SolvedLine, order_map: xr.Dataset) -> list[OrderLine]:
    """The line ``one`` of ``close`` in each channel of ``order_map`` that shows it."""
    made = []
    for number, name in enumerate(order_map["channel"].values):
        size, error = float(one.amplitude[number]), float(one.amplitude_error[number])
        if size <= Z95 * error:
            continue
        made.append(
            OrderLine(
                channel=str(name),
                order=one.order,
                order_error=one.error,
                seen=np.array([0]),
                speed_rpm=np.asarray(order_map["speed"].values, dtype=np.float64),
                amplitude=np.array([size]),
                amplitude_error=np.array([error]),
                degrees_of_freedom=np.array([FREEDOM]),
                phase_deg=np.array([np.nan]),
                evidence="steady, not locked",
                level_over_floor_db=float(20.0 * np.log10(size / max(error, 1e-300))),
                reservation=ONE_SPEED,
            )
        )
    return made
