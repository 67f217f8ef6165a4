"""The shaft's true speed where only a nominal one was stated: read off the spacing of a bearing line's sidebands."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.bearings.envelope_lines import EnvelopeLine, Spectra, parabola, place_error
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-bearings.toml", table="shaft_speed"):
    carriers: int
    most_off_share: float
    least_ratio: float
    most_spread_sigmas: float


NUMBERS = _Numbers.load()

Array = NDArray[np.float64]


class ShaftSpeed(NamedTuple):
    """The shaft's speed as a multiple of the stated one, with its standard error, and pairs of sidebands that tell."""

    factor: float
    error: float
    pairs: int


def shaft_speed(spectra: Spectra, line: EnvelopeLine) -> ShaftSpeed | None:
    """Speed of the shaft beside the stated one by the sidebands of ``line`` in ``spectra``; None where none tell.

    The sidebands of each of its first harmonics stand one turn of the bearing's shaft to both sides: half of their
    distance is free of the error of the line itself. All pairs have to agree.
    """
    ratio, cell = spectra.ratio[line.channel, line.speed], float(spectra.cell[line.speed])
    found = [
        pair
        for times in range(1, NUMBERS.carriers + 1)
        if (pair := _pair(ratio, float(spectra.order[1]), cell, times * line.order, line.place.shaft_order)) is not None
    ]
    if not found:
        return None
    spacing, error = np.array(found).T
    weight = error**-2.0
    mean = float((weight * spacing).sum() / weight.sum())
    if np.abs(spacing - mean).max() > NUMBERS.most_spread_sigmas * float(error.max()):
        return None
    nominal = line.place.shaft_order
    return ShaftSpeed(mean / nominal, float(weight.sum() ** -0.5) / nominal, len(found))


def _pair(ratio: Array, step: float, cell: float, carrier: float, spacing: float) -> tuple[float, float] | None:
    """Distance of a ``carrier`` to its sidebands about ``spacing`` away, with its error; None without a pair."""
    sides = [_peak(ratio, step, carrier + side * spacing, NUMBERS.most_off_share * spacing + cell) for side in (-1, 1)]
    low, high = sides
    if low is None or high is None:
        return None
    # the pair is one of sidebands only where the carrier is in its middle
    if abs(0.5 * (low[0] + high[0]) - carrier) > cell:
        return None
    error = 0.5 * math.hypot(place_error(low[1], cell), place_error(high[1], cell))
    return 0.5 * (high[0] - low[0]), error


def _peak(ratio: Array, step: float, near: float, reach: float) -> tuple[float, float] | None:
    """Order and power ratio of the highest peak within ``reach`` of ``near``; None where none is high enough."""
    first, last = max(math.ceil((near - reach) / step), 1), math.floor((near + reach) / step)
    if last >= len(ratio) - 1 or last < first:
        return None
    at = first + int(np.argmax(ratio[first : last + 1]))
    if ratio[at] < NUMBERS.least_ratio or ratio[at] < max(ratio[at - 1], ratio[at + 1]):
        return None
    return (at + parabola(ratio, at)) * step, float(ratio[at])
