"""Whether an order is an exact multiple of the cycle's frequency, and how long a recording must be to tell."""

from __future__ import annotations

import numpy as np

from crankorder.identify.found import Lock
from crankorder.identify.intervals import half_width

SURE = 0.999
"""Level of the interval by which a multiple is excluded or proven: a test has many lines."""

LEAST_SLIP = 0.001
"""What slips, slips by this share of its order or more: bearings do by 0.1 to 2 %, belts by more."""

FEWEST_FRAMES = 2
"""Frames from which on the phase tells anything."""


def nearest_multiple(order: float, *, revs_per_cycle: int) -> float:
    """The multiple of 1 / ``revs_per_cycle`` next to ``order`` and above zero."""
    return max(1, round(order * revs_per_cycle)) / revs_per_cycle


def is_half_order(order: float, order_error: float) -> bool:
    """Whether ``order`` is, within four times its standard ``order_error`` or 0.1 %, an odd multiple of one half."""
    odd = np.floor(order) + 0.5
    return bool(abs(order - odd) <= max(4.0 * order_error, LEAST_SLIP * order))


def lock_of(order: float, order_error: float, freedom: float, *, revs_per_cycle: int, by_phase: bool) -> Lock:
    """Whether ``order`` is an exact multiple of 1 / ``revs_per_cycle``: "locked", "slips" or "undecided".

    It slips where the 99.9 % interval leaves the multiple out, and that of the half revolution too: a rotor that
    rubs or is loose has exact half orders, though its cycle is one revolution. It is locked where that interval
    holds the multiple and no order that differs from it by LEAST_SLIP or more. ``order_error`` is the standard
    error with ``freedom`` degrees of freedom; only what was measured ``by_phase``, by the turn of the phase over a
    recording, can prove a lock.
    """
    multiple = nearest_multiple(order, revs_per_cycle=revs_per_cycle)
    half, distance = sure_half_width(order_error, freedom), abs(order - multiple)
    if distance > half:
        of_two = nearest_multiple(order, revs_per_cycle=2)
        return "slips" if abs(order - of_two) > half else "undecided"
    return "locked" if by_phase and distance + half < LEAST_SLIP * multiple else "undecided"


def sure_half_width(order_error: float, freedom: float) -> float:
    """Half width of the 99.9 % interval of an order with the standard ``order_error`` of ``freedom`` degrees."""
    return half_width(freedom, level=SURE) * order_error


def revs_to_decide(order: float, *, relative_error: float, span_rev: float, revs_per_frame: float) -> float:
    """Revolutions of one recording after which ``order`` is known to be an exact multiple, or not.

    The phase of a line whose amplitude errs by ``relative_error`` over ``span_rev`` tells its order with a standard
    error of relative_error sqrt(12) / (2 pi span) (Rife and Boorstyn 1974); it falls with the length to the power
    3/2. The 99.9 % interval must become half as wide as LEAST_SLIP of the order, and two frames of
    ``revs_per_frame`` are needed anyway.
    """
    error = relative_error * np.sqrt(12.0) / (2.0 * np.pi * span_rev)
    wanted = 0.5 * LEAST_SLIP * order / half_width(np.inf, level=SURE)
    return float(max(span_rev * (error / wanted) ** (2.0 / 3.0), FEWEST_FRAMES * revs_per_frame))
