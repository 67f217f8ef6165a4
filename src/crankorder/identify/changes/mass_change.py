"""The change of mass that explains what changed: one factor of unbalance, its law with speed, grams, closed balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import fdtrc, fdtri

from crankorder.findings import Balance, Findings
from crankorder.identify.changes.order_changes import OrderChange, welch
from crankorder.identify.intervals import Z95, error_of, half_width
from crankorder.quantities import Complexes, Floats
from crankorder.records import known
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="mass_change"):
    fit_chance: float
    clear_sigmas: float


NUMBERS = _Numbers.load()

_STEPS = 500

ONE_FACTOR = 13.8
"""99.9 % point of χ² with two degrees of freedom: beyond it two factors are not one."""

_QUANTITIES = (
    "residual_reciprocating_g", "residual_second_order_g", "residual_rotating_gmm", "forward_gmm", "reverse_gmm",
    "along_g", "across_g",
)  # fmt: skip
_ORDERS_OF = {"along_g": (1.0,), "residual_second_order_g": (2.0,), "residual_reciprocating_g": (1.0, 2.0)}
"""Orders whose ratio is that of a mass along the cylinder."""


@dataclass(frozen=True, eq=False)
class Unbalance:
    """What became of an order's unbalance between two tests, in one channel.

    ``factor`` (complex) is the unbalance after over that before, whatever path leads from it to the sensor, because the
    path is the same in both tests; ``factor_error`` is the standard error of each of its parts with ``freedom``.
    ``factor_fits`` is the chance of a worse fit of one factor at all speeds, NaN for one speed. ``square_law`` is the
    change of the phasor at ``reference_rpm`` if it grows with the square of speed at one phase (a rigid path),
    ``square_law_error`` its standard error, ``square_law_fits`` as for the factor.
    """

    channel: str
    order: float
    unit: str
    speed_rpm: Floats
    factor: complex
    factor_error: float
    freedom: float
    factor_fits: float
    reference_rpm: float
    square_law: complex
    square_law_error: float
    square_law_fits: float

    @property
    def size_ci95(self) -> tuple[float, float]:
        """95 % interval of the factor's size, from 0."""
        half = half_width(self.freedom) * self.factor_error
        return max(abs(self.factor) - half, 0.0), abs(self.factor) + half

    @property
    def turned_deg_ci95(self) -> float:
        """Half width of the 95 % interval of the factor's angle, degrees; 180 where it is unknown."""
        half = half_width(self.freedom) * self.factor_error
        return float(np.degrees(np.arcsin(half / abs(self.factor)))) if half < abs(self.factor) else 180.0

    @property
    def explains(self) -> bool:
        """Whether one factor fits at all speeds and is not 1 within its 95 % interval."""
        told = np.isnan(self.factor_fits) or self.factor_fits >= NUMBERS.fit_chance
        radius = float(np.sqrt(2.0 * fdtri(2.0, self.freedom, 0.95))) * self.factor_error
        return bool(told and abs(self.factor - 1.0) > radius)


def unbalance_change(change: OrderChange) -> Unbalance | None:
    """What became of the unbalance that ``change``, of an order locked to the shaft, shows.

    None where fewer than one speed has phases in both tests, or the first test does not show the order clearly.
    The factor is the maximum-likelihood slope of a line through the origin with errors in both phasors
    (Fuller 1987, Measurement Error Models, sec. 1.3).
    """
    before, after = change.base.vector, change.new.vector
    kept = np.isfinite(before) & np.isfinite(after) & (change.base.vector_error > 0) & (change.new.vector_error > 0)
    if not kept.any():
        return None
    before, after = before[kept], after[kept]
    error, error2 = change.base.vector_error[kept], change.new.vector_error[kept]
    if not np.sum(np.abs(before) ** 2 / error**2) > 2.0 * NUMBERS.clear_sigmas**2 * len(before):
        return None
    both, each_freedom = welch(error, change.base.freedom[kept], error2, change.new.freedom[kept])
    factor, misfit, variance = _slope(before, after, error, error2)
    speed = change.base_rpm[kept]
    reference = float(np.nanmax(speed)) if np.isfinite(speed).any() else 1.0
    square = (speed / reference) ** 2
    square = np.where(np.isfinite(square), square, 1.0)
    information = float(np.sum(square**2 / both**2))
    law = complex(np.sum(square * (after - before) / both**2) / information)
    law_misfit = float(np.sum(np.abs(after - before - law * square) ** 2 / both**2))
    freedom = float(np.sum(each_freedom))
    spare = 2.0 * (len(before) - 1)
    scatter = [max(1.0, chi2 / spare) if spare else 1.0 for chi2 in (misfit, law_misfit)]
    # an estimated variance makes a square over it larger on average, by freedom / (freedom − 2)
    fair = float(np.mean(np.maximum(each_freedom - 2.0, 0.5) / each_freedom))
    fits = [float(fdtrc(spare, freedom, fair * chi2 / spare)) if spare else np.nan for chi2 in (misfit, law_misfit)]
    return Unbalance(
        change.channel, change.order, change.unit, speed,
        complex(factor), float(np.sqrt(variance * scatter[0])), freedom, fits[0],
        reference, complex(law), float(np.sqrt(1.0 / information * scatter[1])), fits[1],
    )  # fmt: skip


def _slope(before: Complexes, after: Complexes, error: Floats, error2: Floats) -> tuple[complex, float, float]:
    """Factor, chi-square of its misfit, and variance of each of its parts."""
    factor = complex(np.sum(before.conj() * after / error2**2) / np.sum(np.abs(before) ** 2 / error2**2))
    true = before
    for _ in range(_STEPS):
        weight = 1.0 / error**2 + abs(factor) ** 2 / error2**2
        true = (before / error**2 + np.conj(factor) * after / error2**2) / weight
        better = complex(np.sum(true.conj() * after / error2**2) / np.sum(np.abs(true) ** 2 / error2**2))
        done = abs(better - factor) <= 1e-12 * abs(better)
        factor = better
        if done:
            break
    total = error2**2 + abs(factor) ** 2 * error**2
    misfit = float(np.sum(np.abs(after - factor * before) ** 2 / total))
    return factor, misfit, float(1.0 / np.sum(np.abs(true) ** 2 / total))


@dataclass(frozen=True)
class Weighed:
    """Unbalance before and after a known change of mass, in the units of that mass; angles from where it was put.

    Standard error ``error`` of each part of both; ``per_unit`` the response to one unit of mass at each speed.
    """

    added: complex
    before: complex
    after: complex
    error: float
    freedom: float
    speed_rpm: Floats
    per_unit: Complexes
    per_unit_error: Floats


def weighed(change: OrderChange, unbalance: Unbalance, added: complex) -> Weighed | None:
    """Unbalance before and after in grams, from a known ``added`` mass, by its influence on the order.

    Parameters
    ----------
    change : the order's change
    unbalance : what became of it, from :func:`unbalance_change`
    added : mass put on (g, or g·mm) times exp(i angle); not 0

    With U before and U + added after, seen through one path, factor = 1 + added / U (influence coefficients: Goodman
    1964, Trans. ASME B 86, 273). None where the factor cannot be told from 1.
    """
    apart = unbalance.factor - 1.0
    if abs(apart) <= NUMBERS.clear_sigmas * unbalance.factor_error:
        return None
    before = added / apart
    error, _ = welch(change.base.vector_error, change.base.freedom, change.new.vector_error, change.new.freedom)
    return Weighed(
        added=added,
        before=before,
        after=unbalance.factor * before,
        error=abs(added) * unbalance.factor_error / abs(apart) ** 2,
        freedom=unbalance.freedom,
        speed_rpm=change.base_rpm,
        per_unit=change.vector_change / added,
        per_unit_error=error / abs(added),
    )


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
    return Factor(mean.real, error * half_width(min(one.freedom for one in best)) / Z95, tuple(orders))


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
    return _change_record(mass, f * mass, (f - 1.0) * mass, half, list(factor.orders))


def _by_difference(known: Sequence[_Stated | None]) -> dict[str, Any] | None:
    one, two = known
    if one is None or two is None:
        return None
    half = Z95 * float(np.hypot(one.error, two.error))
    return _change_record(one.value, two.value, two.value - one.value, half, [])


def _change_record(base: float, new: float, change: float, half: float, orders: list[float]) -> dict[str, Any]:
    """A mass (g or g·mm) before and after, its ``change`` and the half width of that one's 95 % interval."""
    return {
        "base": base,
        "new": new,
        "change": change,
        "change_ci95": [change - half, change + half],
        "changed": abs(change) > half,
        "by_ratio_of_orders": orders,
    }
