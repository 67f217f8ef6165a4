"""Lines of envelope spectra beside their floor: what stands out, and in which band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FLOOR_ORDERS = 1.0
"""Width in orders of the pieces of a spectrum whose medians are the floor: wide against any line and its skirts."""

FLOOR_WORTH = 0.4
"""Independent powers per cell of resolution that a floor of medians is worth: of a Hann window two thirds are, and a
median is worth 0.6 of their mean."""

CYCLE_CELLS = 1.5
"""Cells beside a multiple of the cycle's order where no strikes can be told from what the engine itself does."""

LOCKED_BINS = 2.0
"""Cells of resolution beside a multiple of the cycle's order that take no part in the choice of the band."""

MAINS_HZ, MAINS_SHARE, MAINS_CELLS = (50.0, 60.0), 0.002, 1.5
"""Multiples of the mains beat with each other in every band that holds two of them, as strikes at such a rate would:
frequencies, by how much these wander as a share, and cells of resolution beside in which nothing is told."""

LOWEST_ORDER = 0.25
"""Order below which nothing is chosen by: slow changes of load and speed are there."""

CLEAR_RATIO, WIDER_SHARE = 100.0, 0.5
"""Power ratio from which a line is clear, and share of it that a wider band must show to be taken instead."""


def best_band(height: NDArray[np.float64]) -> int:
    """Band in whose envelope most stands out, by the ``height`` (bands,) of it; bands come widest first.

    Of a line that stands out clearly a wider band is taken that shows it half as well: it holds more of the resonance,
    and the amplitude then depends less on which band the noise lets win.
    """
    best = int(np.argmax(height))
    if height[best] < CLEAR_RATIO:
        return best
    return int(np.flatnonzero(height >= WIDER_SHARE * height[best])[0])


def free_orders(order: NDArray[np.float64], revs: int, revs_per_cycle: int) -> NDArray[np.bool_]:
    """Which ``order`` (orders,) is no multiple of the cycle's: what strikes there is not the engine itself.

    ``revs`` of a frame, whose inverse is the resolution; ``revs_per_cycle`` of the engine, one or two.
    """
    beside = np.abs(order * revs_per_cycle - np.round(order * revs_per_cycle)) / revs_per_cycle
    return np.asarray((beside > LOCKED_BINS / revs) & (order > LOWEST_ORDER))


def off_mains(order: NDArray[np.float64], *, speed_hz: float, cell: float) -> NDArray[np.bool_]:
    """Which ``order`` (orders,) is, at ``speed_hz``, none at which multiples of the mains beat; ``cell`` in orders."""
    made = np.ones(len(order), dtype=np.bool_)
    for mains_hz in MAINS_HZ:
        spacing = mains_hz / speed_hz
        beside = np.abs(order - spacing * np.maximum(np.round(order / spacing), 1.0))
        made &= beside > MAINS_CELLS * cell + MAINS_SHARE * order
    return made


def free_of_others(
    order: NDArray[np.float64], *, revs_per_cycle: int, speed_hz: float, cell: float
) -> NDArray[np.bool_]:
    """At which ``order`` (orders,) strikes can be told from what is locked to the engine's cycle and from mains.

    ``revs_per_cycle`` of the engine, one or two; ``speed_hz``: turns a second; ``cell``: resolution in orders.
    """
    beside = np.abs(order * revs_per_cycle - np.round(order * revs_per_cycle)) / revs_per_cycle
    return (beside > CYCLE_CELLS * cell) & off_mains(order, speed_hz=speed_hz, cell=cell)


def floor_worth(step: float, cell: float) -> float:
    """Independent bins that the floor of a spectrum is worth, with bins ``step`` apart and a resolution of ``cell``."""
    return max(round(FLOOR_ORDERS / step), 8) * FLOOR_WORTH * step / cell


def middles(pieces: NDArray[np.floating]) -> NDArray[np.floating]:
    """Medians of the last axis of ``pieces``; of such short ones, many at a time, a sort is the fastest way."""
    ordered = np.sort(pieces, axis=-1)
    half = ordered.shape[-1] // 2
    made: NDArray[np.floating] = ordered[..., half]
    return made if ordered.shape[-1] % 2 else (ordered[..., half - 1] + made) / 2


def line_floor(power: NDArray[np.float64], order: NDArray[np.float64], n_independent: float) -> NDArray[np.float64]:
    """Local mean power of the noise (bands, orders): medians of pieces one order wide, joined by straight lines.

    ``power`` (bands, orders) at each ``order``, of which the spacing is even, is the mean of ``n_independent`` spectra.
    """
    from scipy.special import gammaincinv

    width = max(round(FLOOR_ORDERS / float(order[1])), 8)
    count = max(power.shape[1] // width, 1)
    pieces = power[:, : count * width].reshape(len(power), count, -1)
    shape = max(n_independent, 1.0)
    middle = middles(pieces) * shape / float(gammaincinv(shape, 0.5))
    at = (np.arange(count) + 0.5) * pieces.shape[2]
    bins = np.arange(power.shape[1])
    made: NDArray[np.float64] = np.stack([np.interp(bins, at, row) for row in middle])
    return made
