"""The change of mass between two tests: one factor of unbalance, and what it tells of masses, closed or stated."""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import fdtrc, fdtri

from crankorder.comparison import BalanceChange, UnbalanceRecord
from crankorder.engine.definition import Engine
from crankorder.engine.forces import Z
from crankorder.engine.machine_parts import AddedMass
from crankorder.findings import Balance, Findings, Influence, TrialBalance
from crankorder.identify.balance.known_forces import force_per_kg
from crankorder.identify.balance.transfer_path import PER_M_S2, MeasuredOrders, measured_orders
from crankorder.identify.balance.unbalance_fit import (
    AGREE_CHI_SQUARE,
    NO_ANGLE,
    added_words,
    size_and_angle,
    with_interval,
)
from crankorder.identify.order_changes import OrderChange, like_speeds, welch
from crankorder.orders.intervals import LOCATED, Z95, error_of, half_width, interval, size_interval
from crankorder.quantities import Complexes, Floats
from crankorder.records import finite, known
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


class Factor(NamedTuple):
    """Unbalance of an ``order`` after over that before, complex, with the standard error of each part and its freedom.

    It does not depend on the path from the unbalance to the sensor, because both tests have the same.
    """

    order: float
    value: complex
    error: float
    freedom: float


def unbalance_change(change: OrderChange) -> tuple[UnbalanceRecord, Factor] | None:
    """What became of the unbalance that ``change``, of an order locked to the shaft, shows, and its factor.

    None where fewer than one speed has phases in both tests, or the first test does not show the order clearly.
    The factor is the maximum-likelihood slope of a line through the origin with errors in both phasors
    (Fuller 1987, Measurement Error Models, sec. 1.3). The square law is the change of the phasor at the fastest speed
    where it grows with the square of speed at one phase, as on a rigid path.
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
    square = np.nan_to_num((speed / reference) ** 2, nan=1.0)
    information = float(np.sum(square**2 / both**2))
    law = complex(np.sum(square * (after - before) / both**2) / information)
    law_misfit = float(np.sum(np.abs(after - before - law * square) ** 2 / both**2))
    freedom, spare = float(np.sum(each_freedom)), 2.0 * (len(before) - 1)
    (scatter, fits), (law_scatter, law_fits) = (
        (max(1.0, chi2 / spare), finite(_chance_of(chi2 / spare, spare, each_freedom))) if spare else (1.0, None)
        for chi2 in (misfit, law_misfit)
    )
    factor_error, law_error = np.sqrt(variance * scatter), np.sqrt(law_scatter / information)
    radius = float(np.sqrt(2.0 * fdtri(2.0, freedom, 0.95))) * factor_error
    explains = (fits is None or fits >= NUMBERS.fit_chance) and abs(factor - 1.0) > radius
    half, turned = half_width(freedom) * factor_error, float(np.angle(factor, deg=True))
    half_angle = float(np.degrees(np.arcsin(half / abs(factor)))) if half < abs(factor) else None
    record = UnbalanceRecord(
        channel=change.channel, order=change.order, unit=change.unit, changed=change.changed,
        explains=bool(change.changed and explains), factor=abs(factor), factor_ci95=size_interval(factor, half),
        turned_deg=None if half_angle is None else turned,
        turned_deg_ci95=None if half_angle is None else (turned - half_angle, turned + half_angle),
        one_factor_p=fits, square_law_amplitude=abs(law),
        square_law_amplitude_ci95=size_interval(law, half_width(freedom) * law_error),
        square_law_phase_deg=float(np.angle(law, deg=True)), square_law_p=law_fits, reference_rpm=reference,
        n_speeds=len(speed),
    )  # fmt: skip
    return record, Factor(change.order, factor, float(factor_error), freedom)


def _chance_of(mean_square: float, spare: float, freedom: Floats) -> float:
    """Chance of a larger mean square of ``spare`` residuals over variances, each estimated with its ``freedom``."""
    # an estimated variance makes a square over it larger on average, by freedom / (freedom − 2)
    fair = float(np.mean(np.maximum(freedom - 2.0, 0.5) / freedom))
    return float(fdtrc(spare, float(np.sum(freedom)), fair * mean_square))


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


class Estimate(NamedTuple):
    """A number with its standard error."""

    value: float
    error: float


def balance_changes(base: Findings, new: Findings, factors: Sequence[Factor]) -> tuple[BalanceChange, ...]:
    """How the masses of the closed balance changed, the surest way of telling each.

    ``base`` and ``new`` are the findings of both tests; ``factors`` those of orders 1 and 2 in the channels
    that a change of unbalance explains. Seen through one path the ratio of an order is that of the masses behind it: a
    balance closed in one test alone tells both, and the error of its path counts for the change only, not for the mass.
    Quantities without such a ratio are subtracted where both tests closed the balance.
    """
    changes = []
    for quantity in _QUANTITIES:
        before, after = masses = [_closed(findings.balance, quantity) for findings in (base, new)]
        orders = _ORDERS_OF.get(quantity, ())
        factor = factor_of(factors, orders)
        told = _by_factor(masses, factor) if factor else None
        orders = orders if told else ()
        if not told and before and after:
            told = before.value, after.value, float(np.hypot(before.error, after.error))
        if told:
            one, other, error = told
            low, high = interval(other - one, error)
            changes.append(BalanceChange(
                quantity=quantity, base=one, new=other, change=other - one, change_ci95=(low, high),
                changed=not low <= 0.0 <= high, by_ratio_of_orders=orders,
            ))  # fmt: skip
    return tuple(changes)


def _closed(balance: Balance | None, quantity: str) -> Estimate | None:
    """A mass of a closed balance."""
    value, ends = getattr(balance, quantity, None), known(getattr(balance, f"{quantity}_ci95", None))
    return None if value is None or ends is None else Estimate(float(value), error_of(float(value), ends))


def factor_of(factors: Sequence[Factor], orders: Sequence[float]) -> Estimate | None:
    """Mass after over mass before, the one real factor of ``orders`` that all their ``factors`` agree on.

    None where they do not, or lack one of the orders.
    """
    if not orders or not set(orders) <= {factor.order for factor in factors}:
        return None
    own = [factor for factor in factors if factor.order in orders]
    best = [min((f for f in own if f.order == order), key=lambda f: f.error) for order in orders]
    weight = np.array([1.0 / max(factor.error, 1e-12) ** 2 for factor in best])
    mean = complex(np.sum(weight * np.array([factor.value for factor in best])) / weight.sum())
    error = float(weight.sum() ** -0.5)
    apart = [abs(factor.value - mean) ** 2 / (factor.error**2 + error**2) for factor in own]
    if max(apart) > ONE_FACTOR or mean.imag**2 > ONE_FACTOR * error**2 or mean.real <= 0:
        return None
    return Estimate(mean.real, error * half_width(min(factor.freedom for factor in best)) / Z95)


def _by_factor(masses: Sequence[Estimate | None], factor: Estimate) -> tuple[float, float, float] | None:
    """Both masses and the error of their change, from those that are known and their ratio; None where these differ."""
    f = factor.value
    before = [(Estimate(m.value / by, m.error / by), by) for m, by in zip(masses, (1.0, f), strict=True) if m]
    if not before or not all(mass.error > 0 for mass, _ in before):
        return None
    weight = np.array([mass.error**-2.0 for mass, _ in before])
    share = weight / weight.sum()
    mean = float(sum(w * mass.value for w, (mass, _) in zip(share, before, strict=True)))
    error = float(weight.sum() ** -0.5)
    if any(abs(mass.value - mean) > 3.0 * np.hypot(mass.error, error) for mass, _ in before):
        return None
    # of what was closed in the second test, the mass before falls as the factor rises
    by_ratio = sum(w * mass.value / f for w, (mass, by) in zip(share, before, strict=True) if by != 1.0)
    slope = mean - (f - 1.0) * by_ratio
    return mean, f * mean, float(np.hypot((f - 1.0) * error, slope * factor.error))


TRIAL_NUMBERS = MethodNumbers("5-identify-balance.toml", "trial_mass")

VIBRATION = ("accel", "veloc", "displace", "vibration", "force")
"""Quantities in which an unbalance shows."""


def trial_mass(
    base_map: xr.Dataset, new_map: xr.Dataset, *, added: tuple[AddedMass, ...], engine: Engine | None
) -> tuple[TrialBalance | None, str]:
    """Record ``balance`` of the test ``base_map`` by what the masses ``added`` changed in ``new_map``; or None and why.

    Both are OrderMaps of the same machine with the same channels. All of ``added`` stands on the crank (the residual is
    then told as rotating unbalance in its plane, from where angles of ``added`` count) or all on the piston of the one
    cylinder of ``engine`` (as grams along it, orders 1 and 2). What is sought is the complex multiple of the added mass
    that explains the base at every channel and speed at once; both tests' noise counts. Where no one multiple explains
    it, the residual does not act where the added mass does.
    Source: influence coefficients (Goodman 1964), here by total least squares over channels and speeds.
    """
    kinds = {mass.on for mass in added}
    references = {str(order_map.attrs.get("phase_reference", "none")) for order_map in (base_map, new_map)}
    arms = [1.0 if mass.radius_mm is None else mass.radius_mm for mass in added]  # g·mm on the crank, g on a piston
    total = complex(sum(cmath.rect(a * m.mass_g, np.radians(m.angle_deg)) for a, m in zip(arms, added, strict=True)))
    one_cylinder = engine is not None and len(engine.cylinders) == 1 and engine.largest_piston_kg > 0
    for refused, reason in (
        (len(kinds) > 1, "masses were added on the crank and on a piston at once: their effects cannot be told apart"),
        (len(references) > 1 or not references <= set(LOCATED),
         "the two tests have no mark of the shaft in common, so their phases cannot be compared"),
        ("piston" in kinds and not one_cylinder,
         "a mass on a piston tells a residual of an engine of one cylinder alone"),
        (abs(total) < 1e-9, "the added masses cancel one another"),
    ):  # fmt: skip
        if refused:
            return None, reason
    ratio = _multiple(base_map, new_map, 1)
    if isinstance(ratio, str):
        return None, ratio
    seen = np.isfinite(ratio.base.error)
    over_noise = float(np.median(np.abs(ratio.change[seen]) / ratio.base.error[seen]))
    record = TrialBalance(
        source="trial mass",
        orders_used=(1,),
        crank_radius_mm=None if engine is None or engine.largest_piston_kg == 0 else 1e3 * engine.crank_radius_m,
        radius_mm=added[0].radius_mm if len({mass.radius_mm for mass in added}) == 1 else None,
        influence=tuple(
            Influence(
                channel=ratio.base.channels[c],
                speed_rpm=float(ratio.base.rpm_of_row[s]),
                response_per_unit=float(abs(ratio.change[c, s] / total)),
                phase_deg=float(np.angle(ratio.change[c, s] / total, deg=True)),
            )
            for c, s in np.argwhere(seen)
        ),
        evidence=f"{added_words(added).partition(': ')[2]} changed order 1 by {over_noise:.0f} times its error at "
        f"{np.count_nonzero(seen.any(axis=0))} speeds; one residual explains all channels and speeds but for "
        f"{100 * ratio.missed:.0f} %",
    )
    if kinds == {"piston"} and engine is not None:
        return _of_piston(record, ratio, total.real, engine, _multiple(base_map, new_map, 2)), ""
    return _of_crank(record, ratio, total), ""


class _Multiple(NamedTuple):
    """Complex multiple of the added mass that the base has, the covariance (2, 2) of its parts, and their freedom.

    It rests on the ``change`` (channel, speed) from the ``base``, of which it ``missed`` a share.
    """

    value: complex
    covariance: Floats
    freedom: float
    missed: float
    base: MeasuredOrders
    change: Complexes


def _in_any_unit(order_map: xr.Dataset) -> xr.Dataset:
    """``order_map`` with its own unit taken for m/s² where none of its vibration channels has one of acceleration.

    A multiple of the added mass needs no scale: converter counts or a velocity serve as well.
    """
    quantity = [str(name).casefold() for name in order_map["quantity"].values.tolist()]
    unit = [str(name) for name in order_map["unit"].values.tolist()]
    if any("accel" in what and name in PER_M_S2 for what, name in zip(quantity, unit, strict=True)):
        return order_map
    kept = [c for c, what in enumerate(quantity) if any(word in what for word in VIBRATION)]
    taken = order_map.isel(channel=kept)
    unit_of, quantity_of = ["m/s2"] * len(kept), ["acceleration"] * len(kept)
    return taken.assign_coords(unit=("channel", unit_of), quantity=("channel", quantity_of))


def _multiple(base_map: xr.Dataset, new_map: xr.Dataset, order: int) -> _Multiple | str:
    maps = [_in_any_unit(order_map) for order_map in (base_map, new_map)]
    if not all(order_map.sizes["channel"] and order_map.sizes["speed"] for order_map in maps):
        return "the tests have no vibration channel, or no speed"
    base, new = (measured_orders(order_map, (order,)) for order_map in maps)
    if order not in base.orders or order not in new.orders:
        return f"the order maps have no bin at order {order}"
    if not base.channels or base.channels != new.channels:
        return "the two tests do not have the same accelerometers"
    share = TRIAL_NUMBERS.same_speed_share
    here, there = like_speeds(np.log(base.rpm_of_row), np.log(new.rpm_of_row), within_rpm=share)
    if not here.size:
        return "the two tests have no speed in common"
    after, error = np.zeros_like(base.amplitude), np.full(base.error.shape, np.inf)
    after[:, here], error[:, here] = new.amplitude[:, there], new.steady_error[:, there]
    return _solved(replace(base, error=np.where(np.isfinite(error), base.error, np.inf)), after, error)


def _solved(base: MeasuredOrders, after: Complexes, error: Floats) -> _Multiple | str:
    """Multiple u = 1 / (factor − 1), by the factor of unbalance that explains all channels and speeds at once."""
    usable = np.isfinite(base.error)
    y, z = base.amplitude[usable], after[usable]
    y_error, z_error = base.steady_error[usable], error[usable]
    if not usable.any() or (np.abs(z - y) ** 2).sum() < 9 * 2 * (y_error**2 + z_error**2).sum():
        return "the added mass changed nothing that stands clear of the noise: use a heavier one"
    factor, misfit, _ = _slope(y, z, y_error, z_error)
    value, n = 1.0 / (factor - 1.0), int(np.count_nonzero(usable))
    variance = (abs(1 + value) * y_error) ** 2 + (abs(value) * z_error) ** 2
    chi_square = misfit / max(1, 2 * n - 2)
    freedom = np.array([base.freedom[of_speed, k].mean() for k, of_speed in enumerate(usable.T) if of_speed.any()])
    # channels are counted as telling the same
    sound = _chance_of(chi_square, max(2.0 * len(freedom) - 2.0, 2.0), freedom) >= NUMBERS.fit_chance
    size = (np.abs(y * (1 + value)) ** 2 / variance).sum()
    missed = float(np.sqrt(0.0 if sound else (misfit - 2 * n) / max(float(size), 1e-300)))
    if missed > TRIAL_NUMBERS.largest_misfit_share:
        return (
            f"the residual does not act where the mass was added: no multiple of it explains order {base.orders[0]}, "
            f"{100 * missed:.0f} % stay; add one elsewhere (on the piston, in another plane)"
        )
    left = (y * (1 + value) - value * z) / np.sqrt(variance)
    grows = y_error**2 + (y_error**2 + z_error**2) * value  # half the slopes of the variance by both parts of the value
    parts = ((1.0, grows.real), (1j, grows.imag))
    slopes = np.stack([turn * (y - z) / np.sqrt(variance) - left * part / variance for turn, part in parts])
    slope = np.zeros((2, *base.error.shape), dtype=np.complex128)
    slope[:, usable] = slopes
    bread = np.linalg.pinv((slopes.conj() @ slopes.T).real)
    filling = np.einsum("pcr,rcd,qdr->pq", slope.conj(), base.correlation, slope).real
    each = np.square(np.abs(slopes)).sum(axis=0)
    share, unsure = each / each.sum(), base.own_share[usable] ** 2 / base.freedom[usable]
    # for weights that were estimated from the data: Meier (1953), Biometrics 9, 59
    wider = 1.0 + 4.0 * float(np.sum(share * (1.0 - share) * unsure))
    covariance = wider * (1.0 if sound else chi_square) * bread @ filling @ bread
    covariance += missed**2 * abs(value) ** 2 * np.eye(2)
    of_all = len(freedom) * float(base.freedom[usable].mean())
    return _Multiple(value, covariance, of_all, missed, base, after - base.amplitude)


def _of_crank(record: TrialBalance, ratio: _Multiple, total: complex) -> TrialBalance:
    turn = np.array([[total.real, -total.imag], [total.imag, total.real]])
    covariance = turn @ ratio.covariance @ turn.T
    for name, angle, more in (("rotating", "angle_deg", 0.0), ("after", "angle_after_deg", 1.0)):
        size, value = f"residual_{name}_gmm", (ratio.value + more) * total
        record = size_and_angle(record, size, angle, value, covariance, freedom=ratio.freedom)
    pistons = "a mass on the crank tells nothing about masses that go up and down: add one on the piston"
    undecided = dict.fromkeys(("residual_reciprocating_g", "residual_second_order_g", "along_g"), pistons)
    undecided["reverse_gmm"] = "a mass on the crank turns forwards: all is taken to turn with the shaft"
    if record.angle_deg is None:
        undecided["angle_deg"] = NO_ANGLE
    return replace(record, not_decided=undecided)


def _of_piston(
    record: TrialBalance, ratio: _Multiple, mass_g: float, engine: Engine, second: _Multiple | str
) -> TrialBalance:
    per_g = abs(force_per_kg(engine.pistons_alone, 1, Z, along_only=True))
    half = np.abs(mass_g) * half_width(ratio.freedom) * np.sqrt(np.diag(ratio.covariance))
    record = with_interval(record, "along_g", per_g * mass_g * ratio.value.real, per_g * float(half[0]))
    record = with_interval(record, "along_after_g", per_g * mass_g * (ratio.value.real + 1.0), per_g * float(half[0]))
    record = with_interval(record, "along_quadrature_g", per_g * mass_g * ratio.value.imag, per_g * float(half[1]))
    turning = "a mass on the piston acts along the cylinder alone: add one on the crank"
    undecided = dict.fromkeys(("residual_rotating_gmm", "across_g", "reverse_gmm"), turning)
    alike = "rotating and reciprocating mass act alike along the cylinder at order 1"
    undecided["residual_reciprocating_g"] = f"{alike}, and no residual of the second order tells them apart"
    if isinstance(second, str):
        return replace(record, not_decided=undecided | {"residual_second_order_g": second})
    wide = abs(mass_g) * half_width(second.freedom) * float(np.sqrt(second.covariance[0, 0]))
    record = with_interval(record, "residual_second_order_g", mass_g * second.value.real, wide)
    apart = np.array([(ratio.value - second.value).real, (ratio.value - second.value).imag])
    if apart @ np.linalg.pinv(ratio.covariance + second.covariance) @ apart <= AGREE_CHI_SQUARE:
        record = with_interval(record, "residual_reciprocating_g", mass_g * ratio.value.real, float(half[0]))
        del undecided["residual_reciprocating_g"]
    return replace(record, orders_used=(1, 2), not_decided=undecided)
