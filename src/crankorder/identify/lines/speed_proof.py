"""Whether the orders of a test prove a speed that no pulses tell: several of them stand on multiples exactly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import xarray as xr
from scipy.special import exp1

from crankorder.identify.lines.order_lock import LEAST_SLIP, SURE, nearest_multiple, sure_half_width
from crankorder.quantities import flags_of

NO_PULSES = "no encoder pulses: the number is as good as the speed from which the crank angle comes"
"""Reservation of an order whose speed was stated or read from something else than a shaft's pulses."""

STATED_SPEED_ERROR = 0.002
"""Standard error, as a share, of a speed that no pulses tell: a plate's or a motor's whose load is not known, or that
of a tachometer's output."""

PROVEN_SPEED_ERROR = 0.05 * LEAST_SLIP
"""Standard error, as a share, of such a speed that orders have proved: it is read, not counted."""

RIGHT_SPEED = 0.5
"""Share of such speeds, at least, that are right all the same."""

OTHER_SHAFT = 0.3
"""Chance, at most, with which a line near a multiple of the stated shaft is that of another shaft …"""

LARGEST_SLIP = 0.05
"""… that slips by LEAST_SLIP to this share, each power of it alike."""

FEWEST_ORDERS = 2
"""Orders on multiples without which a speed is not proven."""

SpeedSource = Literal["pulses", "stated", "vibration"]


def speed_source(items: Sequence[xr.Dataset]) -> SpeedSource:
    """What the crank angle of ``items`` (frames, maps or tracks) comes from; one without a word on it has pulses.

    "vibration" where any comes from the very orders that are looked at, "stated" where any comes from a speed that was
    stated or recorded as a signal.
    """
    said = [flag["detail"] for item in items for flag in flags_of(item) if flag["flag"] == "no_index"]
    if any("taken from the vibration" in detail for detail in said):
        return "vibration"
    return "stated" if any("no encoder pulses" in detail for detail in said) else "pulses"


def proves_speed(numbers: Sequence[tuple[float, float, float]], *, revs_per_cycle: int) -> bool:
    """Whether orders prove that the speed is right by which they were told.

    A speed that is off moves all of them away from multiples of 1 / ``revs_per_cycle`` by one share. It is proven where
    two or more stand on multiples, none of them as far off as LEAST_SLIP, together so exactly that the slip of another
    shaft and an error of the speed would hardly make it up by chance.

    Parameters
    ----------
    numbers : of each order, told by its phase: the number, its standard error without that of the speed, its freedom
    revs_per_cycle : 1 or 2
    """
    off, half = [], []
    for order, error, freedom in numbers:
        multiple = nearest_multiple(order, revs_per_cycle=revs_per_cycle)
        share, reach = (order - multiple) / multiple, sure_half_width(error, freedom) / multiple
        if abs(share) <= reach and abs(share) + reach < LEAST_SLIP:
            off.append(share)
            half.append(max(reach, 1e-12))
    if len(off) < FEWEST_ORDERS:
        return False
    weight = 1.0 / np.square(half)
    together = 1.0 / np.sqrt(weight.sum())
    mean = abs(float(np.average(off, weights=weight)))
    if mean > together:
        return False
    by_chance = OTHER_SHAFT ** len(off) * min(1.0, 2.0 * (mean + together) * _density())
    return bool(by_chance < (1.0 - SURE) * RIGHT_SPEED)


def _density() -> float:
    """Density, at no error at all, of what a slip and an error of the speed make together."""
    slips = 0.5 * exp1(0.5 * (LEAST_SLIP / STATED_SPEED_ERROR) ** 2) / np.log(LARGEST_SLIP / LEAST_SLIP)
    return float(slips / (np.sqrt(2.0 * np.pi) * STATED_SPEED_ERROR))
