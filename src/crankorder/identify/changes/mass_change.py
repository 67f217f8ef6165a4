"""The change of mass that explains what changed: one factor of unbalance, its law with speed, grams, closed balance."""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc, fdtri

from crankorder.comparison import BalanceChange, MassRecord, MassResponse, UnbalanceRecord
from crankorder.engine.machine_parts import AddedMass
from crankorder.findings import Balance, Findings
from crankorder.identify.changes.order_changes import OrderChange, welch
from crankorder.identify.intervals import Z95, error_of, half_width, interval
from crankorder.quantities import Complexes, Floats
from crankorder.records import Ends, finite, known
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-changes.toml", "mass_change")

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
    def half(self) -> float:
        """Half width of the 95 % interval of the factor's size."""
        return half_width(self.freedom) * self.factor_error

    @property
    def explains(self) -> bool:
        """Whether one factor fits at all speeds and is not 1 within its 95 % interval."""
        fits = np.isnan(self.factor_fits) or self.factor_fits >= NUMBERS.fit_chance
        radius = float(np.sqrt(2.0 * fdtri(2.0, self.freedom, 0.95))) * self.factor_error
        return bool(fits and abs(self.factor - 1.0) > radius)


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


def size_interval(value: complex, half: float) -> Ends:
    """95 % interval of the size of a phasor ``value``, from 0, where ``half`` is its half width."""
    return max(abs(value) - half, 0.0), abs(value) + half


def unbalance_record(unbalance: Unbalance, *, changed: bool) -> UnbalanceRecord:
    """Record of an ``unbalance`` whose order ``changed`` or not."""
    factor, law, half = unbalance.factor, unbalance.square_law, unbalance.half
    turned, known_angle = _degrees(factor), half < abs(factor)
    half_angle = float(np.degrees(np.arcsin(half / abs(factor)))) if known_angle else 180.0
    return UnbalanceRecord(
        channel=unbalance.channel, order=unbalance.order, unit=unbalance.unit, changed=changed,
        explains=changed and unbalance.explains, factor=abs(factor), factor_ci95=size_interval(factor, half),
        turned_deg=turned if known_angle else None,
        turned_deg_ci95=(turned - half_angle, turned + half_angle) if known_angle else None,
        one_factor_p=finite(unbalance.factor_fits), square_law_amplitude=abs(law),
        square_law_amplitude_ci95=size_interval(law, half_width(unbalance.freedom) * unbalance.square_law_error),
        square_law_phase_deg=_degrees(law), square_law_p=finite(unbalance.square_law_fits),
        reference_rpm=unbalance.reference_rpm, n_speeds=len(unbalance.speed_rpm),
    )  # fmt: skip


def _degrees(value: complex) -> float:
    return float(np.degrees(cmath.phase(value)))


def mass_record(change: OrderChange, unbalance: Unbalance, masses: Sequence[AddedMass]) -> MassRecord | None:
    """Unbalance before and after ``masses`` were added, by their influence on the order; angles from where they sit.

    Parameters
    ----------
    change : the order's change
    unbalance : what became of it, from :func:`unbalance_change`
    masses : masses put on; told in grams at their radius where all sit at one, in g·mm where they do not

    With U before and U + added after, seen through one path, factor = 1 + added / U (influence coefficients: Goodman
    1964, Trans. ASME B 86, 273). None where the factor cannot be told from 1, where the masses add up to none, and of
    masses on the crank and on a piston together.
    """
    at_one_radius = len({mass.radius_mm for mass in masses}) == 1
    arms = [1.0 if at_one_radius else mass.radius_mm or 0.0 for mass in masses]
    turned = (cmath.rect(arm * mass.mass_g, np.radians(mass.angle_deg)) for arm, mass in zip(arms, masses, strict=True))
    added, apart = sum(turned, 0j), unbalance.factor - 1.0
    on_one_part = len({mass.on for mass in masses}) == 1
    if not on_one_part or not added or abs(apart) <= NUMBERS.clear_sigmas * unbalance.factor_error:
        return None
    before = added / apart
    after = unbalance.factor * before
    half = abs(added) * unbalance.half / abs(apart) ** 2
    error, _ = welch(change.base.vector_error, change.base.freedom, change.new.vector_error, change.new.freedom)
    responses = zip(change.base_rpm, change.vector_change / added, Z95 * error / abs(added), strict=True)
    return MassRecord(
        channel=change.channel, unit="g" if at_one_radius else "g·mm", response_unit=change.unit, added=abs(added),
        before=abs(before), before_ci95=size_interval(before, half),
        before_angle_deg=_degrees(before) if half < abs(before) else None,
        after=abs(after), after_ci95=size_interval(after, half),
        after_angle_deg=_degrees(after) if half < abs(after) else None,
        response_per_unit=tuple(
            MassResponse(speed_rpm=finite(rpm), response=finite(abs(value)), response_ci95=size_interval(value, reach))
            for rpm, value, reach in responses
        ),
    )  # fmt: skip


class Estimate(NamedTuple):
    """A number with its standard error."""

    value: float
    error: float


def balance_changes(base: Findings, new: Findings, unbalances: Sequence[Unbalance]) -> tuple[BalanceChange, ...]:
    """How the masses of the closed balance changed, the surest way of telling each.

    ``base`` and ``new`` are the findings of both tests; ``unbalances`` what became of orders 1 and 2 in the channels
    that a change of unbalance explains. Seen through one path the ratio of an order is that of the masses behind it: a
    balance closed in one test alone tells both, and the error of its path counts for the change only, not for the mass.
    Quantities without such a ratio are subtracted where both tests closed the balance.
    """
    changes = []
    for quantity in _QUANTITIES:
        masses = [_closed(findings.balance, quantity) for findings in (base, new)]
        factor = factor_of(unbalances, _ORDERS_OF.get(quantity, ()))
        changes.append(_by_factor(quantity, masses, factor) if factor else _by_difference(quantity, masses))
    return tuple(change for change in changes if change is not None)


def _closed(balance: Balance | None, quantity: str) -> Estimate | None:
    """A mass of a closed balance."""
    value, ends = getattr(balance, quantity, None), known(getattr(balance, f"{quantity}_ci95", None))
    return None if value is None or ends is None else Estimate(float(value), error_of(float(value), ends))


def factor_of(unbalances: Sequence[Unbalance], orders: Sequence[float]) -> Estimate | None:
    """Mass after over mass before, the one real factor of ``orders`` that all their ``unbalances`` agree on.

    None where they do not, or lack one of the orders.
    """
    if not orders or not set(orders) <= {unbalance.order for unbalance in unbalances}:
        return None
    own = [unbalance for unbalance in unbalances if unbalance.order in orders]
    best = [min((u for u in own if u.order == order), key=lambda u: u.factor_error) for order in orders]
    weight = np.array([1.0 / max(unbalance.factor_error, 1e-12) ** 2 for unbalance in best])
    mean = complex(np.sum(weight * np.array([unbalance.factor for unbalance in best])) / weight.sum())
    error = float(weight.sum() ** -0.5)
    apart = [abs(unbalance.factor - mean) ** 2 / (unbalance.factor_error**2 + error**2) for unbalance in own]
    if max(apart) > ONE_FACTOR or mean.imag**2 > ONE_FACTOR * error**2 or mean.real <= 0:
        return None
    return Estimate(mean.real, error * half_width(min(unbalance.freedom for unbalance in best)) / Z95)


def _by_factor(quantity: str, masses: Sequence[Estimate | None], factor: Estimate) -> BalanceChange | None:
    """Both masses and their change, from those that are known and their ratio."""
    f = factor.value
    before = [(Estimate(m.value / by, m.error / by), by) for m, by in zip(masses, (1.0, f), strict=True) if m]
    if not before or not all(mass.error > 0 for mass, _ in before):
        return None
    weight = np.array([mass.error**-2.0 for mass, _ in before])
    share = weight / weight.sum()
    mean = float(sum(w * mass.value for w, (mass, _) in zip(share, before, strict=True)))
    error = float(weight.sum() ** -0.5)
    if any(abs(mass.value - mean) > 3.0 * np.hypot(mass.error, error) for mass, _ in before):
        return _by_difference(quantity, masses)
    # of what was closed in the second test, the mass before falls as the factor rises
    by_ratio = sum(w * mass.value / f for w, (mass, by) in zip(share, before, strict=True) if by != 1.0)
    slope = mean - (f - 1.0) * by_ratio
    change = Estimate((f - 1.0) * mean, float(np.hypot((f - 1.0) * error, slope * factor.error)))
    return _balance_change(quantity, mean, f * mean, change, _ORDERS_OF[quantity])


def _by_difference(quantity: str, masses: Sequence[Estimate | None]) -> BalanceChange | None:
    base, new = masses
    if base is None or new is None:
        return None
    change = Estimate(new.value - base.value, float(np.hypot(base.error, new.error)))
    return _balance_change(quantity, base.value, new.value, change)


def _balance_change(
    quantity: str, base: float, new: float, change: Estimate, orders: tuple[float, ...] = ()
) -> BalanceChange:
    """Record of a mass (g or g·mm) before and after, and its change."""
    low, high = interval(change.value, change.error)
    return BalanceChange(
        quantity=quantity, base=base, new=new, change=change.value, change_ci95=(low, high),
        changed=not low <= 0.0 <= high, by_ratio_of_orders=orders,
    )  # fmt: skip
