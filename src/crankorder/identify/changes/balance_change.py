"""The change of mass that the closed balance tells: by the ratio of an order in two tests, else by a difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from crankorder.findings import Balance, Findings
from crankorder.identify.changes.mass_change import Unbalance
from crankorder.identify.intervals import Z95, error_of, half_width
from crankorder.records import known

ONE_FACTOR = 13.8
"""99.9 % point of χ² with two degrees of freedom: beyond it two factors are not one."""

_QUANTITIES = (
    "residual_reciprocating_g", "residual_second_order_g", "residual_rotating_gmm", "forward_gmm", "reverse_gmm",
    "along_g", "across_g",
)  # fmt: skip
_ORDERS_OF = {"along_g": (1.0,), "residual_second_order_g": (2.0,), "residual_reciprocating_g": (1.0, 2.0)}
"""Orders whose ratio is that of a mass along the cylinder."""


@dataclass(frozen=True)
class Factor:
    """Mass after over mass before: its value, standard error and the orders that agree on it."""

    value: float
    error: float
    orders: tuple[float, ...]


class _Stated(NamedTuple):
    value: float
    error: float


def balance_changes(base: Findings, new: Findings, unbalances: Sequence[Unbalance]) -> list[dict[str, Any]]:
    """Records of how the masses of the closed balance changed, the surest way of telling each.

    ``base`` and ``new`` are the findings of both tests; ``unbalances`` what became of orders 1 and 2 in the channels
    that a change of unbalance explains. Seen through one path the ratio of an order is that of the masses behind it: a
    balance closed in one test alone tells both, and the error of its path counts for the change only, not for the mass.
    Quantities without such a ratio are subtracted where both tests closed the balance.
    """
    sides = [_closed(found.balance) for found in (base, new)]
    records = []
    for key in _QUANTITIES:
        known = [side.get(key) for side in sides]
        factor = factor_of(unbalances, _ORDERS_OF.get(key, ()))
        record = _by_factor(known, factor) if factor is not None else _by_difference(known)
        if record is not None:
            records.append({"quantity": key, **record})
    return records


def _closed(balance: Balance | None) -> dict[str, _Stated]:
    """Masses of a closed balance with their standard errors."""
    made: dict[str, _Stated] = {}
    for key in _QUANTITIES if balance is not None else ():
        value, ends = getattr(balance, key), known(getattr(balance, f"{key}_ci95"))
        if value is not None and ends is not None:
            made[key] = _Stated(float(value), error_of(float(value), ends))
    return made


def factor_of(unbalances: Sequence[Unbalance], orders: Sequence[float]) -> Factor | None:
    """The one real factor of ``orders`` that all their ``unbalances`` agree on; None where they do not, or lack one."""
    if not orders or not set(orders) <= {one.order for one in unbalances}:
        return None
    mine = [one for one in unbalances if one.order in orders]
    best = [min((one for one in mine if one.order == order), key=lambda one: one.factor_error) for order in orders]
    weight = np.array([1.0 / max(one.factor_error, 1e-12) ** 2 for one in best])
    mean = complex(np.sum(weight * np.array([one.factor for one in best])) / weight.sum())
    error = float(weight.sum() ** -0.5)
    apart = [abs(one.factor - mean) ** 2 / (one.factor_error**2 + error**2) for one in mine]
    if max(apart) > ONE_FACTOR or mean.imag**2 > ONE_FACTOR * error**2 or mean.real <= 0:
        return None
    least = min(one.freedom for one in best)
    return Factor(mean.real, error * half_width(least) / Z95, tuple(orders))


def _by_factor(known: Sequence[_Stated | None], factor: Factor) -> dict[str, Any] | None:
    """Both masses and their change, from those that are known and their ratio."""
    f = factor.value
    before = [(_Stated(one.value / by, one.error / by), by) for one, by in zip(known, (1.0, f), strict=True) if one]
    if not before or not all(one.error > 0 for one, _ in before):
        return None
    weight = np.array([one.error**-2.0 for one, _ in before])
    share = weight / weight.sum()
    mass = float(sum(w * one.value for w, (one, _) in zip(share, before, strict=True)))
    error = float(weight.sum() ** -0.5)
    if any(abs(one.value - mass) > 3.0 * np.hypot(one.error, error) for one, _ in before):
        return _by_difference(known)
    # of what was closed in the second test, the mass before falls as the factor rises
    by_ratio = sum(w * one.value / f for w, (one, by) in zip(share, before, strict=True) if by != 1.0)
    slope = mass - (f - 1.0) * by_ratio
    half = Z95 * float(np.hypot((f - 1.0) * error, slope * factor.error))
    change = (f - 1.0) * mass
    return {
        "base": mass,
        "new": f * mass,
        "change": change,
        "change_ci95": [change - half, change + half],
        "changed": abs(change) > half,
        "by_ratio_of_orders": list(factor.orders),
    }


def _by_difference(known: Sequence[_Stated | None]) -> dict[str, Any] | None:
    one, two = known
    if one is None or two is None:
        return None
    half, change = Z95 * float(np.hypot(one.error, two.error)), two.value - one.value
    return {
        "base": one.value,
        "new": two.value,
        "change": change,
        "change_ci95": [change - half, change + half],
        "changed": abs(change) > half,
        "by_ratio_of_orders": [],
    }
