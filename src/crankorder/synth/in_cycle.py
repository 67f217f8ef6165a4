"""How unevenly a shaft turns within its cycle, from shares of its speed by order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crankorder.engine.in_cycle import Lag, lag_of_speed
from crankorder.errors import RequestError
from crankorder.synth.effects import SpeedOrder

LEAST_STEP, MOST_STEPS = 0.01, 10_000
"""Finest step that the orders of a speed may share, and how many: a line of a force becomes one at every step."""


def lag_by_order(parts: Sequence[SpeedOrder]) -> Lag:
    """Lag of a shaft whose speed is Ω · (1 + Σ percent/100 · cos(2π order crank_angle + phase)), at any mean speed.

    Ω is the mean of the speed over the crank angle; the mean over time is a little lower, and the mean speed of the
    motion is this one. An analysis of the speed by crank angle finds these orders and no others: the lag has their
    multiples and combinations too, down to round-off.

    ``parts``: order, percent and phase of each, at least one. Raises RequestError for orders that no cycle of up to
    100 revolutions holds or above 10 000 cycles, and where the speed falls below a tenth of its mean.
    """
    zero = np.zeros(len(parts), dtype=np.complex128)
    order = np.array([part.order for part in parts])
    step = Lag(order=np.unique(order), inertia=zero[: np.unique(order).size], gas=zero[: np.unique(order).size]).step
    if step < LEAST_STEP or order.max() > MOST_STEPS * step:
        allowed = f"up to {MOST_STEPS} multiples of one step of at least {LEAST_STEP:g}"
        raise RequestError("orders of the in-cycle speed have no common cycle", place="by_order", allowed=allowed)
    line = np.rint(order / step).astype(int)
    speed = np.zeros(line.max() + 1, dtype=np.complex128)
    share = np.array([part.percent / 100 for part in parts])
    np.add.at(speed, line, share * np.exp(2j * np.pi * np.array([part.phase_deg for part in parts]) / 360))
    return lag_of_speed(speed, step=step)
