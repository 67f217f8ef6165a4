"""Whether an order is an exact multiple of the cycle's frequency, and what such orders prove of a stated speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import xarray as xr
from scipy.special import exp1

from crankorder.findings import Lock
from crankorder.identify.found import Doubt
from crankorder.identify.intervals import half_width
from crankorder.quantities import flags_of
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "order_lock")


def nearest_multiple(order: float, *, revs_per_cycle: int) -> float:
    """The multiple of 1 / ``revs_per_cycle`` next to ``order`` and above zero."""
    return max(1, round(order * revs_per_cycle)) / revs_per_cycle


def is_half_order(order: float, order_error: float) -> bool:
    """Whether ``order`` is, within four times its standard ``order_error`` or 0.1 %, an odd multiple of one half."""
    odd = np.floor(order) + 0.5
    return bool(abs(order - odd) <= max(4.0 * order_error, NUMBERS.least_slip * order))


def lock_of(
    order: float, order_error: float, degrees_of_freedom: float, *, revs_per_cycle: int, by_phase: bool
) -> Lock:
    """Whether ``order`` is an exact multiple of 1 / ``revs_per_cycle``: "locked", "slips" or "undecided".

    It slips where the 99.9 % interval leaves the multiple out, and that of the half revolution too: a rotor that
    rubs or is loose has exact half orders, though its cycle is one revolution. It is locked where that interval
    holds the multiple and no order that differs from it by ``least_slip`` or more. ``order_error`` is the standard
    error with its ``degrees_of_freedom``; only what was measured ``by_phase``, by the turn of the phase over a
    recording, can prove a lock.
    """
    multiple = nearest_multiple(order, revs_per_cycle=revs_per_cycle)
    half, distance = sure_half_width(order_error, degrees_of_freedom), abs(order - multiple)
    if distance > half:
        return "slips" if abs(order - nearest_multiple(order, revs_per_cycle=2)) > half else "undecided"
    return "locked" if by_phase and distance + half < NUMBERS.least_slip * multiple else "undecided"


def sure_half_width(order_error: float, degrees_of_freedom: float) -> float:
    """Half width of the 99.9 % interval of an order whose standard ``order_error`` has these ``degrees_of_freedom``."""
    return half_width(degrees_of_freedom, level=NUMBERS.sure_level) * order_error


def revs_to_decide(order: float, *, relative_error: float, span_rev: float, revs_per_frame: float) -> float:
    """Revolutions of one recording after which ``order`` is known to be an exact multiple, or not.

    The phase of a line whose amplitude errs by ``relative_error`` over ``span_rev`` tells its order with a standard
    error of relative_error sqrt(12) / (2 pi span) (Rife and Boorstyn 1974); it falls with the length to the power
    3/2. The 99.9 % interval must become half as wide as ``least_slip`` of the order, and two frames of
    ``revs_per_frame`` are needed anyway.
    """
    error = relative_error * np.sqrt(12.0) / (2.0 * np.pi * span_rev)
    wanted = 0.5 * NUMBERS.least_slip * order / half_width(np.inf, level=NUMBERS.sure_level)
    return float(max(span_rev * (error / wanted) ** (2.0 / 3.0), NUMBERS.fewest_frames * revs_per_frame))


NO_PULSES = Doubt("no pulses", "no encoder pulses: the number is as good as the speed from which the crank angle comes")
"""Of an order whose speed was stated or read from something else than a shaft's pulses."""

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
    two or more stand on multiples, none of them as far off as ``least_slip``, together so exactly that the slip of
    another shaft and an error of the speed would hardly make it up by chance.

    Parameters
    ----------
    numbers : of each order, told by its phase: the number, its standard error without that of the speed, its freedom
    revs_per_cycle : 1 or 2
    """
    off, half = [], []
    for order, error, degrees_of_freedom in numbers:
        multiple = nearest_multiple(order, revs_per_cycle=revs_per_cycle)
        share, reach = (order - multiple) / multiple, sure_half_width(error, degrees_of_freedom) / multiple
        if abs(share) <= reach and abs(share) + reach < NUMBERS.least_slip:
            off.append(share)
            half.append(max(reach, 1e-12))
    if len(off) < NUMBERS.fewest_orders:
        return False
    weight = 1.0 / np.square(half)
    together = 1.0 / np.sqrt(weight.sum())
    mean = abs(float(np.average(off, weights=weight)))
    if mean > together:
        return False
    by_chance = NUMBERS.other_shaft_chance ** len(off) * min(1.0, 2.0 * (mean + together) * _density())
    return bool(by_chance < (1.0 - NUMBERS.sure_level) * NUMBERS.right_speed_share)


def _density() -> float:
    """Density, at no error at all, of what a slip and an error of the speed make together."""
    slips = (
        0.5
        * exp1(0.5 * (NUMBERS.least_slip / NUMBERS.stated_speed_error) ** 2)
        / np.log(NUMBERS.largest_slip / NUMBERS.least_slip)
    )
    return float(slips / (np.sqrt(2.0 * np.pi) * NUMBERS.stated_speed_error))
