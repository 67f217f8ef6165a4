"""From measured speeds to the cells and pixels of a map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEAST_RANGE_DB = 20.0  # a colour scale spans at least this, so that noise alone looks like noise


def level_of(values: Any, reference: float) -> Any:
    """Level [dB] of amplitudes ``values`` over ``reference``; 1e-300 and 1e300 survive."""
    wide = np.asarray(values, dtype=np.float64)  # 1e-300 is zero in 32 bits
    return 20 * (np.log10(np.maximum(wide, 1e-300)) - np.log10(reference))


def level_limits(amplitude: NDArray[Any], reference: float, *, range_db: float) -> tuple[float, float]:
    """Ends of a colour scale [dB]: the strongest line; the quietest twentieth of the map or the greatest range.

    ``amplitude`` of a map, ``reference`` of its level in the same unit; ``range_db`` the greatest range.
    """
    values = amplitude[amplitude > 0]
    if not len(values):
        return 0.0, range_db
    twentieth = np.partition(values, len(values) // 20)[len(values) // 20]
    ends = 5 * np.array([np.floor(level_of(twentieth, reference) / 5), np.ceil(level_of(values.max(), reference) / 5)])
    low = max(float(ends[0]), float(ends[1]) - range_db)
    return min(low, float(ends[1]) - _LEAST_RANGE_DB), float(ends[1])


def gaps_between(cells: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Ranges [rpm] between neighbouring ``cells`` (shape (speed, 2)) that no cell covers."""
    return [
        (float(low), float(high))
        for low, high in zip(cells[:-1, 1], cells[1:, 0], strict=True)
        if high - low > 1e-9 * max(abs(float(high)), 1.0)
    ]


def cells_with_gaps(values: NDArray[Any], cells: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Rows of a map and their edges, with a row of -1 (no amplitude is negative) for every gap.

    ``values`` shape (speed, frequency), ≥ 0; ``cells`` shape (speed, 2) from :func:`crankorder.plot.cells.speed_cells`.
    """
    starts = {high for _, high in gaps_between(cells)}
    rows, edges = [values[:1]], [cells[0, 0], cells[0, 1]]
    for number in range(1, len(cells)):
        if float(cells[number, 0]) in starts:
            rows.append(np.full_like(values[:1], -1))
            edges.append(cells[number, 0])
        rows.append(values[number : number + 1])
        edges.append(cells[number, 1])
    return np.concatenate(rows), np.array(edges)


def pixel_maximum(
    values: NDArray[Any], edges: NDArray[np.float64], ends: tuple[float, float], *, n: int, axis: int
) -> NDArray[Any]:
    """Largest value under each of ``n`` equal pixels: thin lines survive, pixels narrower than a cell repeat it.

    ``values`` of cells with ascending ``edges`` (one more than cells) along ``axis``; ``ends`` first and last place.
    """
    places = np.linspace(ends[0], ends[1], n, endpoint=False)
    first = np.clip(np.searchsorted(edges, places, side="right") - 1, 0, values.shape[axis] - 1)
    last = int(np.clip(np.searchsorted(edges, ends[1], side="left"), first[-1] + 1, values.shape[axis]))
    kept = np.take(values, np.arange(last), axis=axis)
    return np.asarray(np.maximum.reduceat(kept, first, axis=axis))
