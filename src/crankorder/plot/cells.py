"""From measured speeds to the cells of a map, and from cells to pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.quantities import Bools, Floats

_REACH_STEPS = 2.0  # speeds more than twice so many typical steps apart leave a gap in the tested range …
_REACH_SHARE = 0.03  # … and more than twice this share of it
_LEAST_RANGE_DB = 20.0  # a colour scale spans at least this, so that noise alone looks like noise


def speed_cells(speeds_rpm: Floats) -> Floats:
    """Lower and upper edge [rpm] of each speed's cell, shape (speed, 2): half-way to its neighbours.

    ``speeds_rpm`` ascending, at least one; a single speed gets a cell of 5 %. The first and the last of several end at
    themselves: nothing was measured beyond. In a wide gap of the tested range a cell reaches as far as on its other
    side: what lies between was not measured.
    """
    speeds = np.asarray(speeds_rpm, dtype=float)
    steps = np.diff(speeds)
    if not len(steps) or not steps.any():
        half = max(0.025 * abs(float(speeds[0])), 1.0)
        return np.tile([speeds[0] - half, speeds[0] + half], (len(speeds), 1))
    reach = max(_REACH_STEPS * float(np.median(steps)), _REACH_SHARE * float(speeds[-1] - speeds[0]))
    usual = float(np.median(steps)) / 2
    halves = np.where(steps / 2 > reach, np.nan, steps / 2)  # NaN: a gap
    down, up = np.concatenate([[np.nan], halves]), np.concatenate([halves, [np.nan]])
    down, up = (
        np.where(np.isnan(half), np.where(np.isnan(other), usual, other), half)
        for half, other in ((down, up), (up, down))
    )
    low, high = float(speeds[0]), float(speeds[-1])
    return np.asarray(np.clip(np.stack([speeds - down, speeds + up], axis=1), low, high))


def gaps_before(cells: Floats) -> Bools:
    """True for each of ``cells`` (speed, 2) [rpm] before which a range lies that no cell covers."""
    apart = cells[1:, 0] - cells[:-1, 1] > 1e-9 * np.maximum(np.abs(cells[1:, 0]), 1.0)
    return np.concatenate([[False], apart])


def gaps_between(cells: Floats) -> list[tuple[float, float]]:
    """Ranges [rpm] between neighbouring ``cells`` (speed, 2) that no cell covers."""
    return [(float(cells[at - 1, 1]), float(cells[at, 0])) for at in np.flatnonzero(gaps_before(cells))]


def with_gaps(values: NDArray[Any], cells: Floats, *, empty: float = np.nan) -> tuple[NDArray[Any], Floats]:
    """Rows of a map and their edges, with a row of ``empty`` for every gap.

    ``values`` shape (speed, bins); ``cells`` shape (speed, 2) [rpm] from :func:`speed_cells`.
    """
    gap = np.flatnonzero(gaps_before(cells))
    rows = np.insert(values, gap, empty, axis=0)
    return rows, np.concatenate([cells[:1, 0], np.sort(np.concatenate([cells[:, 1], cells[gap, 0]]))])


def bin_edges(centres: Floats) -> Floats:
    """Edges of bins around ascending ``centres``, one more than these; the first and last bin are symmetric."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])


def pooled(values: NDArray[Any], edges: Floats, pixels: Floats, *, axis: int) -> NDArray[Any]:
    """Largest value under each pixel: thin lines survive, pixels narrower than a cell repeat it, outside is -inf.

    A cell belongs to the pixels that begin in it, else to the one that it lies in, so that no line grows wider.

    ``values`` (none of them NaN) of cells with ascending ``edges`` along ``axis``; ``pixels`` are the edges of the
    pixels in the same unit, ascending or descending.
    """
    if pixels[0] > pixels[-1]:
        return np.flip(pooled(values, edges, pixels[::-1], axis=axis), axis)
    n = values.shape[axis]
    first = np.searchsorted(edges, pixels[:-1], side="right") - 1
    stop = np.searchsorted(edges, pixels[1:], side="left")
    begin = np.clip(first, 0, n - 1)
    last = int(np.clip(stop[-1], begin[-1] + 1, n))
    taken = np.maximum.reduceat(np.take(values, np.arange(last), axis=axis), begin, axis=axis)
    outside = (stop <= 0) | (first >= n)
    if not outside.any():
        return np.asarray(taken)
    shape = [-1 if number == axis else 1 for number in range(values.ndim)]
    return np.where(outside.reshape(shape), -np.inf, taken)


def level_of(values: Any, reference: float) -> Any:
    """Level [dB] of amplitudes ``values`` over ``reference``; 1e-300 and 1e300 survive."""
    wide = np.asarray(values, dtype=np.float64)  # 1e-300 is zero in 32 bits
    return 20 * (np.log10(np.maximum(wide, 1e-300)) - np.log10(reference))


def level_limits(
    amplitude: NDArray[Any], reference: float, *, range_db: float, narrow: bool = False
) -> tuple[float, float]:
    """Ends of a colour scale [dB]: the strongest line; the quietest twentieth of the map or the greatest range.

    ``amplitude`` of a map, ``reference`` of its level in the same unit; ``range_db`` the greatest range, which may be
    less than 20 dB where ``narrow``.
    """
    values = amplitude[amplitude > 0]
    if not len(values):
        return 0.0, range_db
    twentieth = np.partition(values, len(values) // 20)[len(values) // 20]
    ends = 5 * np.array([np.floor(level_of(twentieth, reference) / 5), np.ceil(level_of(values.max(), reference) / 5)])
    low = max(float(ends[0]), float(ends[1]) - range_db)
    least_db = min(_LEAST_RANGE_DB, range_db) if narrow else _LEAST_RANGE_DB
    return min(low, float(ends[1]) - least_db), float(ends[1])
