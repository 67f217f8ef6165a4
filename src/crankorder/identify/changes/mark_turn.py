"""Whether the mark from which phases count sat at another angle in the second test: all orders turn in proportion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from crankorder.identify.changes.order_changes import OrderChange
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="mark_turn"):
    least_orders: int
    clear_sigmas: float
    chance: float


NUMBERS = _Numbers.load()


@dataclass(frozen=True)
class MarkTurn:
    """Angle in revolutions by which the mark sat later in the second test, and its standard error."""

    turn_rev: float
    error_rev: float


def mark_turn(changes: Sequence[OrderChange]) -> MarkTurn | None:
    """Turn of the mark that the phases of all orders agree on; None where they do not, or there is none.

    ``changes`` as of :func:`crankorder.identify.changes.order_changes.order_changes`. A mark that sits t revolutions
    later turns the phase of order k by 2 pi k t. Weighted least squares about the best place of a search.
    """
    turned, order, error, freedom = [], [], [], []
    for one in changes:
        lines = one.base, one.new
        kept = np.all([np.abs(line.vector) > NUMBERS.clear_sigmas * line.vector_error for line in lines], axis=0)
        shares = [line.vector_error[kept] / np.abs(line.vector[kept]) for line in lines]
        turned += np.angle(one.new.vector[kept] / one.base.vector[kept]).tolist()
        error += np.hypot(shares[0], shares[1]).tolist()
        order += [one.order] * int(np.count_nonzero(kept))
        freedom += np.minimum(one.base.freedom, one.new.freedom)[kept].tolist()
    if len(set(order)) < NUMBERS.least_orders:
        return None
    k, phase, sd = np.array(order), np.array(turned), np.maximum(np.array(error), 1e-9)
    weight = np.minimum(sd**-2, 100.0 * float(np.median(sd**-2)))
    trial = np.arange(-0.5, 0.5, 0.02 / max(float(k.max()), 1.0))
    agree = np.cos(phase - 2 * np.pi * k * trial[:, None]) @ weight
    best = float(trial[int(np.argmax(agree))])
    rest = np.angle(np.exp(1j * (phase - 2 * np.pi * k * best)))
    information = float(np.sum((2 * np.pi * k / sd) ** 2))
    turn = best + float(np.sum(2 * np.pi * k * rest / sd**2)) / information
    rest = np.angle(np.exp(1j * (phase - 2 * np.pi * k * turn)))
    spare, total = len(k) - 1, float(np.sum(freedom))
    fair = float(np.mean(np.maximum(np.array(freedom) - 2.0, 0.5) / np.array(freedom)))
    fits = fdtrc(spare, total, fair * float(np.sum((rest / sd) ** 2)) / spare)
    stands_out = fdtrc(1.0, total, turn**2 * information)
    if fits < NUMBERS.chance or stands_out > NUMBERS.chance:
        return None
    return MarkTurn(turn, information**-0.5)
