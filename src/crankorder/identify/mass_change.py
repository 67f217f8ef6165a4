"""The change of mass between two tests: one factor of unbalance, and what it tells of masses, closed or stated."""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import fdtri

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
from crankorder.identify.order_changes import Line, OrderChange, chance_of, like_speeds, welch
from crankorder.orders.intervals import Z95, error_of, half_width, interval, one_phase_reference, size_interval
from crankorder.quantities import Complexes, Floats, Ints
from crankorder.records import known
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-changes.toml", "mass_change")

_STEPS = 500

ONE_CHANNEL = np.ones((1, 1, 1), dtype=np.complex128)
"""Correlation of the errors of one channel, at any number of speeds."""

ONE_FACTOR = 13.8
"""99.9 % point of χ² with two degrees of freedom: beyond it two factors are not one."""

_QUANTITIES = (
    "residual_reciprocating_g", "residual_second_order_g", "residual_rotating_gmm", "forward_gmm", "reverse_gmm",
    "along_g", "across_g",
)  # fmt: skip
_ORDERS_OF = {"along_g": (1.0,), "residual_second_order_g": (2.0,), "residual_reciprocating_g": (1.0, 2.0)}
"""Orders whose ratio is that of a mass along the cylinder."""


class Estimate(NamedTuple):
    """A number with its standard error."""

    value: float
    error: float


class MassFactor(NamedTuple):
    """Unbalance of an ``order`` after over that before, complex, with the standard error of each part and its freedom.

    It does not depend on the path from the unbalance to the sensor, because both tests have the same. ``chance``: of a
    worse fit of one factor at all speeds; where that is too small, ``missed`` is the share of the response that the
    factor does not explain.
    """

    order: float
    value: complex
    error: float
    freedom: float
    chance: float = 1.0
    missed: float = 0.0

    @property
    def multiple(self) -> tuple[complex, float]:
        """Unbalance before as a multiple of what was added, and the standard error of each part."""
        multiple = 1.0 / (self.value - 1.0)
        return multiple, float(np.hypot(abs(multiple) ** 2 * self.error, abs(multiple) * self.missed))


def mass_factor(
    change: OrderChange, *, correlation: Complexes = ONE_CHANNEL, own_share: Floats | float = 1.0
) -> MassFactor:
    """The factor of unbalance that explains ``change`` at all its speeds and channels, of which one or more are seen.

    It is the maximum-likelihood slope of a line through the origin with errors in both phasors (Fuller 1987,
    Measurement Error Models, sec. 1.3). Its error holds for weights that were estimated from the data (Meier 1953,
    Biometrics 9, 59); it is widened by the misfit where no one factor fits, or where the order alone tells the errors.

    Parameters
    ----------
    change : of one order locked to the shaft; lines (speeds,) of a channel or (channels, speeds); NaN is not seen
    correlation : (speeds, channels, channels), of the channels' errors
    own_share : (channels, speeds), 0 to 1: share of the errors that was estimated from the order's own scatter
    """
    (y, z), (y_error, z_error), freedoms = (
        np.atleast_2d(getattr(change.base, name), getattr(change.new, name))
        for name in ("vector", "vector_error", "freedom")
    )
    seen = np.isfinite(y) & np.isfinite(z) & (y_error >= 0) & (z_error > 0)
    y, z, y_power, z_power = y[seen], z[seen], y_error[seen] ** 2, z_error[seen] ** 2
    factor, true = complex(np.nan), y
    for _ in range(_STEPS):
        last, factor = factor, complex(np.sum(true.conj() * z / z_power) / np.sum(np.abs(true) ** 2 / z_power))
        total = z_power + abs(factor) ** 2 * y_power
        true = (y * z_power + np.conj(factor) * z * y_power) / total
        if abs(factor - last) <= 1e-12 * abs(factor):
            break
    _, freedom = welch(abs(factor) * y_error, freedoms[0], z_error, freedoms[1])
    pull = np.zeros(seen.shape, dtype=np.complex128)
    pull[seen] = true / np.sqrt(total)
    information = np.abs(pull) ** 2
    share = information / information.sum()
    wider = 1.0 + 4.0 * float(np.nansum(share * (1.0 - share) * np.square(own_share) / freedom))
    scatter = np.einsum("cs,scd,ds->", pull.conj(), correlation, pull).real
    misfit, n = float(np.sum(np.abs(z - factor * y) ** 2 / total)), len(y)
    mean_square = misfit / max(1, 2 * n - 2)
    # channels are counted as telling the same
    of_speed = np.array([freedom[row, k].mean() for k, row in enumerate(seen.T) if row.any()])
    chance = chance_of(mean_square, max(2.0 * len(of_speed) - 2.0, 2.0), of_speed)
    variance, missed = wider * float(scatter) / float(information.sum()) ** 2, 0.0
    # errors that the bins beside tell too are known well enough without the residuals
    if chance < NUMBERS.fit_chance or np.min(own_share) == 1.0:
        variance *= max(1.0, mean_square)
    if chance < NUMBERS.fit_chance:
        response = float(np.sum(np.abs(factor * y) ** 2 / total))
        missed = float(np.sqrt(max(misfit - 2 * n, 0.0) / max(response, 1e-300)))
    return MassFactor(change.order, factor, float(np.sqrt(variance)), float(of_speed.sum()), chance, missed)


def unbalance_change(change: OrderChange) -> tuple[UnbalanceRecord, MassFactor] | None:
    """What became of the unbalance that ``change``, of an order locked to the shaft, shows, and its factor.

    None where fewer than one speed has phases in both tests, or the first test does not show the order clearly.
    The square law is the change of the phasor at the fastest speed where it grows with the square of speed at one
    phase, as on a rigid path.
    """
    base, new = change.base, change.new
    kept = np.isfinite(change.vector_change) & (base.vector_error > 0) & (new.vector_error > 0)
    clear = np.mean(np.abs(base.vector[kept] / base.vector_error[kept]) ** 2) if kept.any() else 0.0
    if not clear > 2.0 * NUMBERS.clear_sigmas**2:
        return None
    speed = change.base_rpm[kept]
    reference = float(np.nanmax(speed)) if np.isfinite(speed).any() else 1.0
    square = np.nan_to_num((change.base_rpm / reference) ** 2, nan=1.0)
    both, freedom = welch(base.vector_error, base.freedom, new.vector_error, new.freedom)
    grown = replace(new, vector=change.vector_change, vector_error=both, freedom=freedom)
    exact = replace(base, vector=square.astype(np.complex128), vector_error=np.zeros(len(square)))
    factor, law = mass_factor(change), mass_factor(replace(change, base=exact, new=grown))
    radius = float(np.sqrt(2.0 * fdtri(2.0, factor.freedom, 0.95))) * factor.error
    half, law_half = (each.error * half_width(each.freedom) for each in (factor, law))
    size, turned = abs(factor.value), float(np.angle(factor.value, deg=True))
    half_angle = float(np.degrees(np.arcsin(half / size))) if half < size else None
    record = UnbalanceRecord(
        channel=change.channel, order=change.order, unit=change.unit, changed=change.changed,
        explains=bool(change.changed and factor.chance >= NUMBERS.fit_chance and abs(factor.value - 1.0) > radius),
        factor=size, factor_ci95=size_interval(factor.value, half),
        turned_deg=None if half_angle is None else turned,
        turned_deg_ci95=None if half_angle is None else (turned - half_angle, turned + half_angle),
        one_factor_p=factor.chance if len(speed) > 1 else None, square_law_amplitude=abs(law.value),
        square_law_amplitude_ci95=size_interval(law.value, law_half),
        square_law_phase_deg=float(np.angle(law.value, deg=True)),
        square_law_p=law.chance if len(speed) > 1 else None, reference_rpm=reference, n_speeds=len(speed),
    )  # fmt: skip
    return record, factor


def balance_changes(base: Findings, new: Findings, factors: Sequence[MassFactor]) -> tuple[BalanceChange, ...]:
    """How the masses of the closed balance changed, the surest way of telling each.

    ``base`` and ``new`` are the findings of both tests; ``factors`` those of orders 1 and 2 in the channels
    that a change of unbalance explains. Seen through one path the ratio of an order is that of the masses behind it: a
    balance closed in one test alone tells both, and the error of its path counts for the change only, not for the mass.
    Quantities without such a ratio are subtracted where both tests closed the balance.
    """
    changes = []
    for quantity in _QUANTITIES:
        first, second = (_closed(findings.balance, quantity) for findings in (base, new))
        factor = factor_of(factors, _ORDERS_OF.get(quantity, ()))
        masses = _by_factor((first, second), factor) if factor else None
        orders = _ORDERS_OF[quantity] if masses else ()
        if not masses and first and second:
            masses = first.value, second.value, float(np.hypot(first.error, second.error))
        if masses:
            before, after, error = masses
            low, high = interval(after - before, error)
            changes.append(BalanceChange(
                quantity=quantity, base=before, new=after, change=after - before, change_ci95=(low, high),
                changed=not low <= 0.0 <= high, by_ratio_of_orders=orders,
            ))  # fmt: skip
    return tuple(changes)


def _closed(balance: Balance | None, quantity: str) -> Estimate | None:
    """A mass of a closed balance."""
    value, ends = getattr(balance, quantity, None), known(getattr(balance, f"{quantity}_ci95", None))
    return None if value is None or ends is None else Estimate(float(value), error_of(float(value), ends))


def factor_of(factors: Sequence[MassFactor], orders: Sequence[float]) -> Estimate | None:
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


def _by_factor(closed: Sequence[Estimate | None], factor: Estimate) -> tuple[float, float, float] | None:
    """Both masses and the error of their change, from the surest that was ``closed`` and their ratio ``factor``.

    None where none was closed, or both were and differ from the ratio.
    """
    f = factor.value
    # the mass before, and how fast its change grows with the factor, over that mass
    ways = zip(closed, (1.0, f), (1.0, 1.0 / f), strict=True)
    before = [(Estimate(mass.value / by, mass.error / by), slope) for mass, by, slope in ways if mass]
    if not before or not all(mass.error > 0 for mass, _ in before):
        return None
    (value, error), slope = min(before, key=lambda way: way[0].error)
    if any(abs(mass.value - value) > 3.0 * np.hypot(mass.error, error) for mass, _ in before):
        return None
    return value, f * value, float(np.hypot((f - 1.0) * error, slope * value * factor.error))


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
    arms = [1.0 if mass.radius_mm is None else mass.radius_mm for mass in added]  # g·mm on the crank, g on a piston
    total = complex(sum(cmath.rect(a * m.mass_g, np.radians(m.angle_deg)) for a, m in zip(arms, added, strict=True)))
    one_cylinder = engine is not None and len(engine.cylinders) == 1 and engine.largest_piston_kg > 0
    for refused, reason in (
        (len(kinds) > 1, "masses were added on the crank and on a piston at once: their effects cannot be told apart"),
        (not one_phase_reference((base_map, new_map)),
         "the two tests have no mark of the shaft in common, so their phases cannot be compared"),
        ("piston" in kinds and not one_cylinder,
         "a mass on a piston tells a residual of an engine of one cylinder alone"),
        (abs(total) < 1e-9, "the added masses cancel one another"),
    ):  # fmt: skip
        if refused:
            return None, reason
    first = _stated_change(base_map, new_map, 1)
    if isinstance(first, str):
        return None, first
    factor, change, channels = first
    seen = np.isfinite(change.vector_change)
    over_noise = float(np.median(np.abs(change.vector_change[seen]) / change.base.error[seen]))
    per_unit = change.vector_change / total
    influence = (
        Influence(
            channel=channels[c], speed_rpm=float(change.base_rpm[s]), response_per_unit=float(abs(per_unit[c, s])),
            phase_deg=float(np.angle(per_unit[c, s], deg=True)),
        )
        for c, s in np.argwhere(seen)
    )  # fmt: skip
    record = TrialBalance(
        source="trial mass", orders_used=(1,), influence=tuple(influence),
        crank_radius_mm=None if engine is None or engine.largest_piston_kg == 0 else 1e3 * engine.crank_radius_m,
        radius_mm=added[0].radius_mm if len({mass.radius_mm for mass in added}) == 1 else None,
        evidence=f"{added_words(added).partition(': ')[2]} changed order 1 by {over_noise:.0f} times its error at "
        f"{np.count_nonzero(seen.any(axis=0))} speeds; one residual explains all channels and speeds but for "
        f"{100 * factor.missed:.0f} %",
    )  # fmt: skip
    if kinds == {"piston"} and engine is not None:
        return _of_piston(record, factor, total.real, engine, _stated_change(base_map, new_map, 2)), ""
    return _of_crank(record, factor, total), ""


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


_Stated = tuple[MassFactor, OrderChange, tuple[str, ...]]
"""Factor of an order at all channels and speeds, its change (channels, speeds), and the names of the channels."""


def _stated_change(base_map: xr.Dataset, new_map: xr.Dataset, order: int) -> _Stated | str:
    """What the stated mass changed at ``order``, or why that tells nothing."""
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
    lines = _line(base, here), _line(new, there)
    change = OrderChange(base.rpm_of_row[here], new.rpm_of_row[there], lines[0], lines[1], order=order)
    power = np.abs(change.vector_change) ** 2
    noise = np.where(np.isnan(power), 0.0, lines[0].vector_error ** 2 + lines[1].vector_error ** 2)
    if np.isnan(power).all() or np.nansum(power) < 9 * 2 * noise.sum():
        return "the added mass changed nothing that stands clear of the noise: use a heavier one"
    factor = mass_factor(change, correlation=base.correlation[here], own_share=base.own_share[:, here])
    if factor.missed > TRIAL_NUMBERS.largest_misfit_share:
        return (
            f"the residual does not act where the mass was added: no multiple of it explains order {order}, "
            f"{100 * factor.missed:.0f} % stay; add one elsewhere (on the piston, in another plane)"
        )
    return factor, change, base.channels


def _line(measured: MeasuredOrders, rows: Ints) -> Line:
    """Lines (channels, speeds) of the one order that was ``measured``, at some of its rows."""
    amplitude, error = measured.amplitude[:, rows], measured.error[:, rows]
    vector = np.where(np.isfinite(error), amplitude, np.nan)
    return Line(np.abs(amplitude), error, measured.freedom[:, rows], vector, measured.steady_error[:, rows])


def _of_crank(record: TrialBalance, factor: MassFactor, total: complex) -> TrialBalance:
    multiple, error = factor.multiple
    covariance = (abs(total) * error) ** 2 * np.eye(2)
    for name, angle, value in (("rotating", "angle_deg", multiple), ("after", "angle_after_deg", multiple + 1.0)):
        key = f"residual_{name}_gmm"
        record = size_and_angle(record, key, angle, value * total, covariance, freedom=factor.freedom)
    pistons = "a mass on the crank tells nothing about masses that go up and down: add one on the piston"
    undecided = dict.fromkeys(("residual_reciprocating_g", "residual_second_order_g", "along_g"), pistons)
    undecided["reverse_gmm"] = "a mass on the crank turns forwards: all is taken to turn with the shaft"
    if record.angle_deg is None:
        undecided["angle_deg"] = NO_ANGLE
    return replace(record, not_decided=undecided)


def _of_piston(
    record: TrialBalance, factor: MassFactor, mass_g: float, engine: Engine, second: _Stated | str
) -> TrialBalance:
    per_g = abs(force_per_kg(engine.pistons_alone, 1, Z, along_only=True))
    multiple, error = factor.multiple
    half = abs(mass_g) * half_width(factor.freedom) * error
    along = (("along_g", multiple.real), ("along_after_g", multiple.real + 1.0), ("along_quadrature_g", multiple.imag))
    for key, value in along:
        record = with_interval(record, key, per_g * mass_g * value, per_g * half)
    turning = "a mass on the piston acts along the cylinder alone: add one on the crank"
    undecided = dict.fromkeys(("residual_rotating_gmm", "across_g", "reverse_gmm"), turning)
    alike = "rotating and reciprocating mass act alike along the cylinder at order 1"
    undecided["residual_reciprocating_g"] = f"{alike}, and no residual of the second order tells them apart"
    if isinstance(second, str):
        return replace(record, not_decided=undecided | {"residual_second_order_g": second})
    multiple2, error2 = second[0].multiple
    half2 = abs(mass_g) * half_width(second[0].freedom) * error2
    record = with_interval(record, "residual_second_order_g", mass_g * multiple2.real, half2)
    if abs(multiple - multiple2) ** 2 <= AGREE_CHI_SQUARE * (error**2 + error2**2):
        record = with_interval(record, "residual_reciprocating_g", mass_g * multiple.real, half)
        del undecided["residual_reciprocating_g"]
    return replace(record, orders_used=(1, 2), not_decided=undecided)
