"""Residual unbalance from two tests that differ by a known mass: influence coefficients, at each speed and channel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from crankorder.engine.definition import Engine
from crankorder.engine.forces import Z
from crankorder.engine.machine_parts import AddedMass
from crankorder.findings import Influence, TrialBalance
from crankorder.identify.balance.known_forces import force_per_kg
from crankorder.identify.balance.record import AGREE_CHI_SQUARE, NO_ANGLE, added_words, size_and_angle, with_interval
from crankorder.identify.balance.transfer_path import PER_M_S2, MeasuredOrders, measured_orders
from crankorder.identify.intervals import half_width
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-balance.toml", "trial_mass")

SCATTER = 2.1
"""Three times 0.7: mean square errors scatter by that over the root of the number of speeds, channels being alike."""
VIBRATION = ("accel", "veloc", "displace", "vibration", "force")
"""Quantities in which an unbalance shows."""
STEADY_REFERENCES = ("tdc", "index", "pulse")


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
    if not added:
        return None, "no mass was added: state it under [[added_masses]] of the test that has it"
    if len(kinds) > 1:
        return None, "masses were added on the crank and on a piston at once: their effects cannot be told apart"
    references = {str(order_map.attrs.get("phase_reference", "none")) for order_map in (base_map, new_map)}
    if len(references) > 1 or not references <= set(STEADY_REFERENCES):
        return None, "the two tests have no mark of the shaft in common, so their phases cannot be compared"
    on_piston = kinds == {"piston"}
    if on_piston and (engine is None or len(engine.cylinders) != 1 or engine.largest_piston_kg == 0):
        return None, "a mass on a piston tells a residual of an engine of one cylinder alone"
    total: complex = sum((_unbalance(mass) for mass in added), 0j)
    if abs(total) < 1e-9:
        return None, "the added masses cancel one another"
    ratio = _multiple(base_map, new_map, 1)
    if isinstance(ratio, str):
        return None, ratio
    radii = {mass.radius_mm for mass in added}
    words = added_words(added).partition(": ")[2]
    evidence = (
        f"{words} changed order 1 by {ratio.change_over_noise:.0f} times its error at {ratio.n_speeds} speeds; one "
        f"residual explains all channels and speeds but for {100 * ratio.missed:.0f} %"
    )
    record = TrialBalance(
        source="trial mass",
        orders_used=(1,),
        crank_radius_mm=None if engine is None or engine.largest_piston_kg == 0 else 1e3 * engine.crank_radius_m,
        radius_mm=next(iter(radii)) if len(radii) == 1 else None,
        influence=ratio.influence_per(total),
        evidence=evidence,
    )
    if on_piston and engine is not None:
        return _of_piston(record, ratio, total.real, engine, _multiple(base_map, new_map, 2)), ""
    return _of_crank(record, ratio, total), ""


def _unbalance(mass: AddedMass) -> complex:
    """Unbalance (g·mm) of a mass on the crank, or the mass (g) on a piston."""
    if mass.radius_mm is None:
        return complex(mass.mass_g)
    return complex(mass.mass_g * mass.radius_mm * np.exp(1j * np.radians(mass.angle_deg)))


class _Multiple:
    """Complex multiple of the added mass that the base has, with its covariance (2, 2), and the changes it rests on."""

    def __init__(
        self, value: complex, covariance: Floats, base: MeasuredOrders, change: Complexes, missed: float
    ) -> None:
        self.value, self.covariance, self.missed = value, covariance, missed
        self.base, self.change = base, change
        self.usable: Bools = np.isfinite(base.error)
        self.n_speeds = int(np.count_nonzero(self.usable.any(axis=0)))
        self.freedom = self.n_speeds * float(np.mean(base.freedom[self.usable])) if self.usable.any() else 1.0
        ratio = np.abs(change[self.usable]) / base.error[self.usable]
        self.change_over_noise = float(np.median(ratio)) if ratio.size else 0.0

    def influence_per(self, total: complex) -> tuple[Influence, ...]:
        """Change of amplitude (m/s², else the channel's unit) per unit of the added mass, by channel and speed."""
        return tuple(
            Influence(
                channel=name,
                speed_rpm=float(rpm),
                response_per_unit=float(abs(self.change[c, s] / total)),
                phase_deg=float(np.degrees(np.angle(self.change[c, s] / total))),
            )
            for c, name in enumerate(self.base.channels)
            for s, rpm in enumerate(self.base.rpm_of_row)
            if self.usable[c, s]
        )


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
    nearest = np.abs(base.rpm_of_row[:, None] - new.rpm_of_row).argmin(axis=1)
    here = np.flatnonzero(np.abs(new.rpm_of_row[nearest] / base.rpm_of_row - 1) <= NUMBERS.same_speed_share)
    if not here.size:
        return "the two tests have no speed in common"
    unpaired = np.ones(base.rpm_of_row.size, dtype=bool)
    unpaired[here] = False
    base = base.without(unpaired)
    after, error = np.zeros_like(base.amplitude), np.full(base.error.shape, np.inf)
    after[:, here], error[:, here] = new.amplitude[:, nearest[here]], new.steady_error[:, nearest[here]]
    return _solved(base.without(~np.isfinite(error).all(axis=0)), after, error)


def _solved(base: MeasuredOrders, after: Complexes, error: Floats) -> _Multiple | str:
    """Least sum of |base (1 + u) − u after|² over its variance, by the complex multiple u."""
    from scipy.optimize import least_squares

    usable = np.isfinite(base.error) & np.isfinite(error)
    y, z = base.amplitude[usable], after[usable]
    y_error, z_error = base.steady_error[usable], error[usable]
    change = after - base.amplitude

    def left(p: Floats) -> Complexes:
        u = complex(p[0], p[1])
        distance: Complexes = (y * (1 + u) - u * z) / np.sqrt((abs(1 + u) * y_error) ** 2 + (abs(u) * z_error) ** 2)
        return distance

    if (np.abs(change[usable]) ** 2).sum() < 9 * 2 * (y_error**2 + z_error**2).sum():
        return "the added mass changed nothing that stands clear of the noise: use a heavier one"
    weight = 1 / (y_error**2 + z_error**2)
    first = (weight * (z - y).conj() * y).sum() / (weight * np.abs(z - y) ** 2).sum()
    fit = least_squares(lambda p: np.concatenate([left(p).real, left(p).imag]), [first.real, first.imag])
    value, n = complex(*fit.x), int(np.count_nonzero(usable))
    chi_square = 2 * float(fit.cost) / max(1, 2 * n - 2)
    sound = chi_square < 1 + SCATTER / np.sqrt(np.count_nonzero(usable.any(axis=0)))
    size = (np.abs(y * (1 + value)) ** 2 / ((abs(1 + value) * y_error) ** 2 + (abs(value) * z_error) ** 2)).sum()
    missed = float(np.sqrt(0.0 if sound else (2 * fit.cost - 2 * n) / max(float(size), 1e-300)))
    if missed > NUMBERS.largest_misfit_share:
        return (
            f"the residual does not act where the mass was added: no multiple of it explains order {base.orders[0]}, "
            f"{100 * missed:.0f} % stay; add one elsewhere (on the piston, in another plane)"
        )
    slope = np.zeros((2, *base.error.shape), dtype=np.complex128)
    for part in range(2):
        slope[part][usable] = fit.jac[:n, part] + 1j * fit.jac[n:, part]
    bread = np.linalg.pinv(fit.jac.T @ fit.jac)
    filling = np.einsum("pcr,rcd,qdr->pq", slope.conj(), base.correlation, slope).real
    each = (np.abs(fit.jac[:n]) ** 2 + np.abs(fit.jac[n:]) ** 2).sum(axis=1)
    share, unsure = each / each.sum(), base.own_share[usable] ** 2 / base.freedom[usable]
    # for weights that were estimated from the data: Meier (1953), Biometrics 9, 59
    wider = 1.0 + 4.0 * float(np.sum(share * (1.0 - share) * unsure))
    covariance = wider * (1.0 if sound else chi_square) * bread @ filling @ bread
    covariance += missed**2 * abs(value) ** 2 * np.eye(2)
    return _Multiple(value, covariance, base, change, missed)


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
