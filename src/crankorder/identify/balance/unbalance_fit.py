"""Unbalance left, in grams and g·mm, from measured orders 1 and 2 by the engine model or stated paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import xarray as xr

from crankorder.engine.definition import Engine
from crankorder.engine.forces import DIRECTIONS, Z
from crankorder.engine.machine_parts import AddedMass, StatedPath
from crankorder.findings import Balance
from crankorder.identify.balance.known_forces import NUMBERS as ORDER_SHAKER
from crankorder.identify.balance.known_forces import (
    KnownForces,
    KnownForcesFit,
    force_per_kg,
    known_forces,
    modes_with_room,
    quiet_fit,
    rows_needed,
)
from crankorder.identify.balance.transfer_path import MeasuredOrders, accelerance_of, measured_orders
from crankorder.identify.found import AgreedOrders, ModalFit
from crankorder.identify.machine_model import MachineModel, gas_half_orders
from crankorder.identify.modes.surface_fit import side_by_side
from crankorder.orders.intervals import half_width
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-balance.toml", "closure")

TRIAL_MASS = "a second test with a known added mass ([[added_masses]]) tells the path instead"


class _Refused(Exception):
    """Why there is no fit of the unbalance."""


def unbalance_fit(
    order_map: xr.Dataset,
    orders: AgreedOrders,
    modal: ModalFit,
    *,
    sources: MachineModel,
    followed: Sequence[xr.Dataset] = (),
) -> tuple[Balance | None, str]:
    """Record ``balance`` of the findings, or None with the reason in words.

    The path from force to acceleration is the one that ``sources`` state; where they state none, the one that the
    engine's own higher orders show, whose forces are known: they act along the cylinder at the same frequencies as
    orders 1 and 2 do at higher speeds, and one joint fit with the natural frequencies of ``modal`` gives the masses
    that make orders 1 and 2. Masses that the test has on purpose are part of the residual. ``order_map``: the OrderMap,
    with phases from top dead centre. ``orders``: what was found in it. ``followed``: orders as they were followed
    through sweeps (RecordingTracks), which stand for the map's. Intervals hold for noise, natural frequencies and
    dampings, and the misfit of the path.
    Source: forces by :func:`crankorder.engine.forces.crankcase_forces`; forward and reverse parts as in direct and
    reverse cranks (seed 002; Thomson and Dahleh 1998).
    """
    engine = sources.engine
    try:
        _check_phases(order_map, engine)
        if sources.paths:
            lines = [order.order for order in orders]
            record = _by_stated_paths(order_map, lines, engine=engine, paths=sources.paths)
        elif engine is None:
            raise _Refused(f"no engine is named, so no force is known, and no path is stated; {TRIAL_MASS}")
        else:
            record = _by_engine_orders(order_map, orders, modal, engine, followed)
    except _Refused as refusal:
        return None, str(refusal)
    if sources.added:
        record = replace(record, evidence=f"{record.evidence}; {added_words(sources.added)}")
    return record, ""


def _check_phases(order_map: xr.Dataset, engine: Engine | None) -> None:
    if not np.isfinite(order_map["speed"].values).any():
        raise _Refused("no shaft turned, or its speed is not known, so there is no order that a mass could make")
    reference = str(order_map.attrs.get("phase_reference", "none"))
    if reference in ("none", "mixed") or not np.isfinite(order_map["phase"].values).any():
        raise _Refused(
            "the orders have no phase: the recordings have no mark of the shaft in common; record an index pulse once "
            "a revolution"
        )
    if engine is not None and engine.cycle != "rotor" and reference != "tdc":
        raise _Refused(
            "phases do not count from top dead centre, so force and response cannot be compared: state "
            "index_to_tdc_deg of the encoder"
        )


def _by_engine_orders(
    order_map: xr.Dataset, orders: AgreedOrders, modal: ModalFit, engine: Engine, followed: Sequence[xr.Dataset]
) -> Balance:
    if engine.cycle == "rotor" or engine.largest_piston_kg == 0:
        raise _Refused(f"a rotor has no order of known force, and no path is stated; {TRIAL_MASS}")
    if not modal.modes:
        raise _Refused(f"no natural frequency was found, without which the path is not known; {TRIAL_MASS}")
    _check_firing(orders, engine)
    whole = [(order.order, round(order.order)) for order in orders if order.lock != "slips" and order.lines]
    seen = {number for order, number in whole if number > 0 and abs(order - number) < NUMBERS.order_match}
    bins = [float(value) for value in order_map["order"].values if value <= 12]
    shaker = known_forces(engine, seen=seen, highest=int(max(bins, default=0)))
    if isinstance(shaker, str):
        raise _Refused(f"{shaker}; {TRIAL_MASS}")
    measured = measured_orders(order_map, shaker.orders, lines=[order.order for order in orders], followed=followed)
    if not measured.channels:
        raise _Refused("no channel measures acceleration in m/s2 or g")
    if measured.orders != shaker.orders:
        raise _Refused("the order map has no bins at whole orders")
    _check_scale(measured, shaker)
    fit = _fitted(measured, shaker, modal)
    _check_fit(fit, shaker)
    return _record(fit, shaker, engine, _check_orders_agree(measured, shaker, modal, fit), measured)


def _check_firing(orders: AgreedOrders, engine: Engine) -> None:
    half = gas_half_orders(order.order for order in orders)
    rocks = "rocks the crankcase at every order of the known forces"
    if engine.gas is not None:
        rocks = f"the engine has gas: its torque {rocks}, through a path that is not known"
        raise _Refused(f"{rocks}. Motor it without compression, with an engine file without gas; or {TRIAL_MASS}")
    if engine.revs_per_cycle == 2 and len(half) > 1:
        rocks = f"half orders ({', '.join(half)}) show gas torque, which {rocks} too"
        raise _Refused(f"{rocks}. Motor it without compression; or {TRIAL_MASS}")


def _check_scale(measured: MeasuredOrders, shaker: KnownForces) -> None:
    """Refuse amplitudes that no machine could have under these forces."""
    rows = _of_known_force(measured, shaker)
    force = np.abs(shaker.forces.known[[a != "RY" for a in shaker.forces.axes]]).max(axis=0)[measured.place_of_row]
    force = force * (measured.rpm_of_row * np.pi / 30) ** 2
    strong = rows & (force >= 0.5 * force[rows].max(initial=0.0)) & (force > 0)
    if not strong.any():
        raise _Refused("the orders of known force were not measured")
    largest = np.abs(measured.amplitude[:, strong]).max(axis=0) / force[strong]
    mass_kg = 1.0 / max(float(np.median(largest)), 1e-300)
    if not NUMBERS.lightest_kg <= mass_kg <= NUMBERS.heaviest_kg:
        times, word = (mass_kg / 1e3, "small") if mass_kg > NUMBERS.heaviest_kg else (10.0 / mass_kg, "large")
        raise _Refused(
            f"the amplitudes are about {times:.0e} times too {word} for this engine: its known forces would act on a "
            f"mass of {mass_kg:.2g} kg. Check sensitivity and unit of the channels"
        )


def _fitted(measured: MeasuredOrders, shaker: KnownForces, modal: ModalFit) -> KnownForcesFit:
    """Fit along the forces alone, or with the rolling moment where the data ask for it."""
    plain = shaker.forces.alone
    rows, top_hz = int(_of_known_force(measured, shaker).sum()), float(measured.frequency_hz.max())
    n_modes = modes_with_room(modal, axes=len(plain.axes), top_hz=top_hz, rows=rows)
    if n_modes is None:
        raise _Refused(
            f"too few speeds: the orders of known force were measured {rows} times, which is not enough for a path of "
            f"{sum(mode.frequency_hz < top_hz for mode in modal.modes)} modes; {TRIAL_MASS}"
        )
    fit = quiet_fit(measured, plain, modal, n_modes=n_modes)
    fewer = modes_with_room(modal, axes=len(plain.axes) + 1, top_hz=top_hz, rows=rows)
    if "RY" not in shaker.forces.axes or fewer is None or (fewer < n_modes and fit.is_sound):
        return fit.widened()
    if _rolls(measured.without(measured.order_of_row == 1), shaker, modal, n_modes=fewer):
        return quiet_fit(measured, shaker.forces, modal, n_modes=fewer).widened()
    if _rolls(measured, shaker, modal, n_modes=fewer):
        raise _Refused(
            "order 1 does not go through the path of the other orders: something acts across the cylinder or along the "
            f"shaft too, such as a rotating unbalance, and that path is not known; {TRIAL_MASS}"
        )
    return fit.widened()


def _rolls(measured: MeasuredOrders, shaker: KnownForces, modal: ModalFit, *, n_modes: int) -> bool:
    """Whether the rolling moment's path explains more of ``measured`` than chance would."""
    without = quiet_fit(measured, shaker.forces.alone, modal, n_modes=n_modes)
    gain, more = without.gain_by(quiet_fit(measured, shaker.forces, modal, n_modes=n_modes))
    return bool(gain > 1 + NUMBERS.rolls_sigmas * np.sqrt(2 * len(measured.channels) / more))


def _of_known_force(measured: MeasuredOrders, shaker: KnownForces) -> Bools:
    return np.isin(measured.order_of_row, shaker.known_orders) & (measured.error < np.inf).any(axis=0)


def _check_fit(fit: KnownForcesFit, shaker: KnownForces) -> None:
    if fit.misfit < ORDER_SHAKER.largest_misfit_share:
        return
    worst = max(fit.by_order, key=lambda k: fit.by_order[k])
    cause = (
        "something acts that the engine model does not have, such as meshing gears"
        if worst in shaker.known_orders
        else "something acts across the cylinder or along the shaft, such as a rotating unbalance"
    )
    raise _Refused(
        f"orders {_listed(shaker.orders)} do not go through one path: it misses more than "
        f"{100 * ORDER_SHAKER.largest_misfit_share:.0f} % of the response, most at order {worst}: "
        f"{cause}, or a natural frequency is missing; {TRIAL_MASS}"
    )


def _check_orders_agree(measured: MeasuredOrders, shaker: KnownForces, modal: ModalFit, fit: KnownForcesFit) -> str:
    """Words on how the orders of known force agree; refuse where they do not, or where one alone is not checked."""
    if len(shaker.known_orders) < 2 * len(fit.axes):  # none can be spared
        return _check_single(shaker, fit)
    checked = []
    for order in shaker.known_orders:
        rest = measured.without(measured.order_of_row == order)
        n_modes = len(fit.natural_hz)
        if _of_known_force(rest, shaker).sum() < rows_needed(n_modes, axes=len(fit.axes)):
            continue
        alone = quiet_fit(rest, shaker.forces.on(fit.axes), modal, n_modes=n_modes).widened()
        for number, (sought, _) in enumerate(shaker.sought):
            part = slice(2 * number, 2 * number + 2)
            without, with_it = (1e3 * abs(of.mass_kg[number]) for of in (alone, fit))
            apart = abs(alone.mass_kg[number] - fit.mass_kg[number])
            variance, stated = (np.trace(of.covariance[part, part]) for of in (alone, fit))
            if variance > 2 * (NUMBERS.weak_share * abs(fit.mass_kg[number])) ** 2:
                continue
            slack = np.sqrt(max((variance - stated) / 2, 0.02 * variance / 2))
            if apart > max(NUMBERS.disagree_sigmas * slack, NUMBERS.harmless_sigmas * np.sqrt(stated / 2)):
                raise _Refused(
                    f"the orders of known force contradict one another: without order {order} the mass behind order "
                    f"{sought} is {without:.3g} g, with it {with_it:.3g} g; another source makes one of them, such "
                    f"as meshing gears; {TRIAL_MASS}"
                )
            checked.append(order)
    return f"orders {_listed(shaker.known_orders)} agree" if checked else _check_single(shaker, fit)


def _check_single(shaker: KnownForces, fit: KnownForcesFit) -> str:
    """None of the orders of known force can be spared: their phase alone checks them, by masses in step with them."""
    limit = NUMBERS.single_angle_rad if len(shaker.known_orders) == 1 else NUMBERS.several_angle_rad
    for number, (sought, _) in enumerate(shaker.sought):
        mass = fit.mass_kg[number]
        error = float(np.sqrt(fit.covariance[2 * number + 1, 2 * number + 1]))
        if error < limit * abs(mass) and abs(mass.imag) < NUMBERS.in_step_sigmas * error:
            return f"they are in step with order {sought} to {np.degrees(error / abs(mass)):.1f}°"
    is_one = limit == NUMBERS.single_angle_rad
    raise _Refused(
        f"of known force and above the floor {'is order' if is_one else 'are orders'} "
        f"{_listed(shaker.known_orders)} alone, and nothing shows that the pistons alone make "
        f"{'it' if is_one else 'them, for the rolling moment acts too, or what acts across'}; "
        f"{TRIAL_MASS}"
    )


def _listed(orders: tuple[int, ...]) -> str:
    return ", ".join(str(order) for order in orders)


def _record(fit: KnownForcesFit, shaker: KnownForces, engine: Engine, remark: str, measured: MeasuredOrders) -> Balance:
    split = Split(fit.mass_kg, fit.covariance, fit.freedom, shaker.sought, shaker.per_kg)
    record = split_record(split, engine=engine)
    middle = np.median(measured.frequency_hz[np.isin(measured.order_of_row, shaker.known_orders)])
    axis = fit.axes.index("Z") if "Z" in fit.axes else 0
    mass_kg = 1 / float(np.abs(fit.path(np.array([middle]))[:, axis]).max())
    odd = ", ".join(f"{rpm:.0f}" for rpm in fit.quiet.odd_speeds_rpm)
    odd = f"; left out as not belonging: {odd} rpm" if odd else ""
    rolling = "; the masses' rolling moment acts too and was fitted" * ("RY" in fit.axes)
    misfit = f"; the path misses {100 * fit.misfit:.0f} % of the response, which the intervals hold" * bool(fit.misfit)
    evidence = (
        f"the engine's own orders {_listed(shaker.known_orders)}, of known force, tell the path (apparent mass "
        f"{mass_kg:.3g} kg at {middle:.0f} Hz): {remark}; mean square misfit {fit.quiet.chi_square:.2f} of what the "
        f"errors allow{misfit}{rolling}{odd}"
        + "; order 1 is taken to act along the cylinder alone, which the fit does not contradict"
        * (fit.axes[0] == "Z")
    )
    return replace(record, source="engine orders", orders_used=tuple(sorted(shaker.orders)), evidence=evidence)


PATH_NUMBERS = MethodNumbers("5-identify-balance.toml", "stated_paths")

ROTOR_RADIUS_M = 1e-3
"""Radius at which the mass of a rotor's unbalance is counted: 1 kg there is 1000 g·mm."""


def _by_stated_paths(
    order_map: xr.Dataset, lines: Sequence[float], *, engine: Engine | None, paths: tuple[StatedPath, ...]
) -> Balance:
    """Residual unbalance by the stated ``paths``.

    ``order_map``: the OrderMap. ``lines``: orders at which lines stand. ``engine``: None or one without pistons is a
    rotor. Forces of each stated direction are fitted to all channels and speeds at which the paths hold; intervals hold
    noise and the paths' uncertainty. What no path is stated for is taken as not reaching a channel.
    """
    measured = measured_orders(order_map, (1, 2), lines=lines)
    strangers = sorted({path.channel for path in paths} - set(measured.channels))
    if strangers:
        raise _Refused(f"no channel of acceleration is called {', '.join(strangers)}, for which a path is stated")
    if 1 not in measured.orders:
        raise _Refused("the order map has no bin at order 1")
    directions = tuple(d for d in ("X", "Z") if any(path.direction == d for path in paths))
    if not directions:
        raise _Refused("a path along the shaft tells no unbalance: state one of direction X or Z")
    pistons = engine is not None and engine.cycle != "rotor" and engine.largest_piston_kg > 0
    radius_m = engine.crank_radius_m if engine is not None and pistons else ROTOR_RADIUS_M
    parts = [(1, directions)]
    if pistons and engine is not None and 2 in engine.shafts.every_order and 2 in measured.orders and "Z" in directions:
        parts.append((2, ("Z",)))
    fits = [_forces(measured, order, axes, paths, radius_m) for order, axes in parts]
    split, (_, missed, speeds) = _split_by_paths([fit[0] for fit in fits], engine if pistons else None), fits[0]
    record = split_record(split, engine=engine) if pistons and engine is not None else rotor_record(split)
    used = sorted({path.channel for path in paths})
    evidence = (
        f"stated paths of {', '.join(used)} at {speeds} speeds in their range; they miss "
        f"{100 * missed:.0f} % of order 1; paths that are not stated are taken as none"
    )
    orders = tuple(order for order, _ in parts)
    return replace(record, source="stated path", orders_used=orders, evidence=evidence)


def _forces(
    measured: MeasuredOrders, order: int, axes: tuple[str, ...], paths: tuple[StatedPath, ...], radius_m: float
) -> tuple[Split, float, int]:
    """Masses of one ``order``, the share of it that the ``paths`` miss, and the speeds that told."""
    at = measured.order_of_row == order
    f, omega = measured.frequency_hz[at], measured.rpm_of_row[at] * np.pi / 30
    stated = [path for path in paths if path.direction in axes]
    design = np.zeros((len(stated), len(measured.channels), f.size, len(axes)), dtype=np.complex128)
    for number, path in enumerate(stated):
        place = measured.channels.index(path.channel)
        design[number, place, :, axes.index(path.direction)] = accelerance_of(path, f) * radius_m * omega**2
    whole = design.sum(axis=0)
    error = measured.error[:, at]
    usable = np.isfinite(whole).all(axis=2) & whole.any(axis=2) & np.isfinite(error)
    if np.count_nonzero(usable) < len(axes):
        raise _Refused(f"no speed brings order {order} into the frequency range in which the stated paths hold")
    weight = np.where(usable, 1 / np.where(usable, measured.steady_error[:, at], 1.0), 0.0)
    columns = (np.where(usable[:, :, None], whole, 0) * weight[:, :, None]).reshape(-1, len(axes))
    target = (measured.amplitude[:, at] * weight).ravel()
    inverse = np.linalg.pinv(columns)
    if np.linalg.matrix_rank(columns, tol=1e-3 * float(np.linalg.norm(columns, 2))) < len(axes):
        raise _Refused("the stated paths do not tell forces along and across apart: the channels see both alike")
    mass = inverse @ target
    left = np.abs(target - columns @ mass) ** 2
    own = np.where(usable, error, 0.0) * weight
    free = max(1.0, float(np.count_nonzero(usable) - len(axes)))
    chi_square = float(left.sum() / max(2 * (own**2).mean() * own.size / np.count_nonzero(usable) * free, 1e-300))
    missed = float(np.sqrt(max(0.0, left.sum() - 2 * (own**2).sum()) / max((np.abs(target) ** 2).sum(), 1e-300)))
    doubt = max((path.uncertainty_percent for path in stated), default=0.0) / 100
    if missed > PATH_NUMBERS.largest_misfit_share + doubt:
        raise _Refused(
            f"the stated paths miss {100 * missed:.0f} % of order {order}: they are not those of this machine, or "
            "something else makes that order"
        )
    covariance = np.zeros((2 * len(mass), 2 * len(mass)))
    for path, part in zip(stated, design, strict=True):  # one that errs by a share, in any phase, shifts the masses
        seen = (np.nan_to_num(part) * weight[:, :, None]).reshape(-1, len(axes))
        shift = path.uncertainty_percent / 196 * (inverse @ seen @ mass)
        for turned in (shift, 1j * shift):
            parts = np.stack([turned.real, turned.imag], axis=1).ravel()
            covariance += np.outer(parts, parts)
    covariance = max(1.0, chi_square) * _noise(inverse, own, measured.correlation[at]) + covariance
    speeds = int(np.count_nonzero(usable.any(axis=0)))
    sought, per_kg = tuple((order, axis) for axis in axes), np.ones(len(axes), dtype=np.complex128)
    return Split(mass, covariance, max(1.0, 2.0 * (speeds - len(axes))), sought, per_kg), missed, speeds


def _noise(inverse: Complexes, own: Floats, correlation: Complexes) -> Floats:
    """Covariance of real and imaginary parts in turn that errors ``own`` (channel, row) over their weights make."""
    swayed = (inverse * own.ravel()).reshape(len(inverse), *own.shape)
    covariance = np.einsum("acr,rcd,bdr->ab", swayed, correlation, swayed.conj())
    size = len(covariance)
    parts = np.zeros((2 * size, 2 * size))
    # E z zᴴ is twice the covariance, and z is circular
    parts[0::2, 0::2] = parts[1::2, 1::2] = covariance.real
    parts[1::2, 0::2], parts[0::2, 1::2] = covariance.imag, -covariance.imag
    return parts


def _split_by_paths(parts: list[Split], engine: Engine | None) -> Split:
    """All masses of ``parts`` together: on the pistons where forces act along them alone, else at the crank radius."""
    sought = tuple(place for part in parts for place in part.sought)
    per_kg = np.concatenate([part.per_kg for part in parts])
    if engine is not None:
        along_only = (1, "X") not in sought
        for number, (order, axis) in enumerate(sought):
            alone = along_only or (order == 2 and axis == DIRECTIONS[Z])
            per_kg[number] = force_per_kg(engine.pistons_alone, order, DIRECTIONS.index(axis), along_only=alone)
    turn = side_by_side([np.array([[s.real, -s.imag], [s.imag, s.real]]) for s in 1 / per_kg])
    covariance = turn @ side_by_side([part.covariance for part in parts]) @ turn.T
    masses = np.concatenate([part.mass_kg for part in parts]) / per_kg
    return Split(masses, covariance, min(part.freedom for part in parts), sought, per_kg)


RECORD_NUMBERS = MethodNumbers("5-identify-balance.toml", "record")

AGREE_CHI_SQUARE = 5.991
"""95 % point of χ² with two degrees of freedom: one complex difference."""
NO_ACROSS = (
    "the path of forces across the cylinder is not identified: no order of known force acts there; state it "
    "([[transfer_paths]], direction X) or run a test with a known added mass"
)

NO_ANGLE = "the unbalance may be none: its angle means nothing"


Place = tuple[int, str]
"""Order and axis of a force."""


class Split(NamedTuple):
    """Complex masses (kg at the crank radius) behind orders 1 and 2, with what they multiply.

    ``mass_kg`` (mass,); ``covariance`` (2 mass, 2 mass) of real and imaginary parts in turn, with ``freedom``;
    ``sought``: (order, axis) of each; the force of a mass is mass · ``per_kg`` · r ω².
    """

    mass_kg: Complexes
    covariance: Floats
    freedom: float
    sought: tuple[Place, ...]
    per_kg: Complexes

    def combined(self, shares: Mapping[Place, complex]) -> tuple[complex, Floats]:
        """The complex sum of each mass times the share of its place in ``shares``, and the covariance (2, 2) of it."""
        share = np.array([shares.get(place, 0.0) for place in self.sought], dtype=np.complex128)
        turn = np.array([[[s.real, -s.imag], [s.imag, s.real]] for s in share]).transpose(1, 0, 2).reshape(2, -1)
        return complex(share @ self.mass_kg), turn @ self.covariance @ turn.T

    def per_kg_at(self, place: Place) -> complex:
        """What the mass at ``place`` multiplies."""
        return complex(self.per_kg[self.sought.index(place)])


ALONG, ACROSS, SECOND = (1, "Z"), (1, "X"), (2, "Z")
"""Places of the forces of order 1 along and across the cylinder, and of order 2 along it."""

B = TypeVar("B", bound=Balance)


def with_interval(balance: B, key: str, value: float, half: float) -> B:
    """``balance`` with its field ``key`` at ``value`` ± ``half``."""
    fields: Any = {key: value, f"{key}_ci95": (value - half, value + half)}
    return replace(balance, **fields)


def size_and_angle(
    balance: B, size_key: str, angle_key: str, value: complex, covariance: Floats, *, freedom: float
) -> B:
    """``balance`` with a complex unbalance ``value``, ``covariance`` (2, 2) of its parts, and its ``freedom``.

    ``size_key`` and ``angle_key`` name its fields; without the latter its angle is not kept. The interval of the size
    starts at 0 where the unbalance may be none; the angle (degrees) is then None.
    """
    size, t = abs(value), half_width(freedom)
    inwards = np.array([value.real, value.imag]) / size if size else np.array([1.0, 0.0])
    along = float(np.sqrt(inwards @ covariance @ inwards))
    aside = np.array([-inwards[1], inwards[0]])
    across = float(np.sqrt(aside @ covariance @ aside))
    joint = np.sqrt(AGREE_CHI_SQUARE) * max(along, across)
    half_deg = float(np.degrees(np.arcsin(min(1.0, t * across / size)))) if size else 180.0
    low = size - t * along if size > joint else 0.0
    fields: Any = {size_key: size, f"{size_key}_ci95": (max(0.0, low), size + t * along)}
    if angle_key and size > joint and half_deg < RECORD_NUMBERS.vague_deg:
        angle = float(np.degrees(np.angle(value)))
        fields |= {angle_key: angle, f"{angle_key}_ci95": (angle - half_deg, angle + half_deg)}
    return replace(balance, **fields)


def split_record(split: Split, *, engine: Engine) -> Balance:
    """Residual masses from a ``split``, for ``engine``; what it does not tell, with reasons.

    ``along_g`` and ``along_quadrature_g``: force of the first order along the cylinder over r ω², in step with the
    piston's own and a quarter turn ahead of it, in grams at the crank radius; likewise ``residual_second_order_g`` over
    the force that a gram on the piston makes at order 2. Below 0 where shafts take away more than there is.
    """
    record = Balance(crank_radius_mm=1e3 * engine.crank_radius_m)
    undecided: dict[str, str] = {}
    if ALONG in split.sought:
        per_kg = abs(split.per_kg_at(ALONG))
        record = _with_grams(record, "along_g", split, {ALONG: per_kg})
        record = _with_grams(record, "along_quadrature_g", split, {ALONG: -1j * per_kg})
    tell = _both_ways if {ALONG, ACROSS} <= set(split.sought) else _one_way
    record = tell(record, split, engine, undecided)
    if SECOND in split.sought:
        record = _with_grams(record, "residual_second_order_g", split, {SECOND: 1.0})
    elif 2 in engine.shafts.every_order:
        undecided["residual_second_order_g"] = "the path at order 2 is not identified"
    else:
        whole = "no shafts take the second order away: the whole reciprocating mass makes it"
        undecided["residual_second_order_g"] = whole
    return replace(record, not_decided=undecided)


def _with_grams(record: Balance, key: str, split: Split, shares: Mapping[Place, complex]) -> Balance:
    """``record`` with its field ``key`` at the real part in grams of what ``split`` holds in these ``shares``."""
    mass_kg, covariance = split.combined(shares)
    half = 1e3 * half_width(split.freedom) * float(np.sqrt(covariance[0, 0]))
    return with_interval(record, key, 1e3 * mass_kg.real, half)


def _one_way(record: Balance, split: Split, engine: Engine, undecided: dict[str, str]) -> Balance:
    """Forces along the cylinder alone: both orders tell the reciprocating mass where they ask for the same one."""
    across = ("across_g", "forward_gmm", "reverse_gmm", "residual_rotating_gmm", "angle_deg")
    undecided |= dict.fromkeys(across, NO_ACROSS)
    alike = "rotating and reciprocating mass act alike along the cylinder at order 1"
    if not {ALONG, SECOND} <= set(split.sought):
        undecided["residual_reciprocating_g"] = f"{alike}, and no residual of the second order tells them apart"
        return record
    if len(engine.cylinders) > 1:
        undecided["residual_reciprocating_g"] = f"{alike}, and of several cylinders none is known to be the one"
        return record
    # the one mass that both tell best (generalised least squares); their difference has two degrees of freedom
    first, second = split.sought.index(ALONG), split.sought.index(SECOND)
    both, picked = split.mass_kg[[first, second]], [2 * first, 2 * first + 1, 2 * second, 2 * second + 1]
    values, design = both.view(np.float64), np.concatenate([np.eye(2), np.eye(2)])
    weight = np.linalg.pinv(split.covariance[np.ix_(picked, picked)])
    covariance = np.linalg.pinv(design.T @ weight @ design)
    common = covariance @ design.T @ weight @ values
    left = values - design @ common
    if left @ weight @ left > AGREE_CHI_SQUARE:
        asked = " and ".join(f"{1e3 * size:.3g}" for size in np.abs(both))
        undecided["residual_reciprocating_g"] = (
            f"orders 1 and 2 ask for different masses, {asked} g: rotating unbalance, or shafts that miss one of the "
            "orders"
        )
        return record
    half = 1e3 * half_width(split.freedom) * float(np.sqrt(covariance[0, 0]))
    return with_interval(record, "residual_reciprocating_g", 1e3 * float(common[0]), half)


def _both_ways(record: Balance, split: Split, engine: Engine, undecided: dict[str, str]) -> Balance:
    """Forces along and across: forward and reverse, and for cylinders along Z rotating and reciprocating."""
    z, x, g_mm = split.per_kg_at(ALONG), split.per_kg_at(ACROSS), 1e6 * engine.crank_radius_m
    record = _with_size(record, "across_g", "", split, {ACROSS: 1e3 * x})
    for name, turn in (("forward", 0.5j), ("reverse", -0.5j)):
        shares = {ALONG: 0.5 * g_mm * z, ACROSS: turn * g_mm * x}
        record = _with_size(record, f"{name}_gmm", f"{name}_angle_deg", split, shares)
    if any(cylinder.bank_deg for cylinder in engine.cylinders):
        for key in ("residual_rotating_gmm", "residual_reciprocating_g", "angle_deg"):
            undecided[key] = "pistons of leaning cylinders act across too: forward and reverse parts tell all there is"
    else:
        record = _with_size(record, "residual_rotating_gmm", "angle_deg", split, {ACROSS: 1j * g_mm * x})
        piston = np.conj(z) / abs(z) ** 2
        shares = {ALONG: piston * z, ACROSS: -1j * piston * x}
        record = _with_grams(record, "residual_reciprocating_g", split, shares)
        value, covariance = split.combined(shares)
        if abs(value.imag) > half_width(split.freedom) * float(np.sqrt(covariance[1, 1])):
            undecided["reverse_angle_deg"] = "part of the reverse force is out of step with the piston: mistimed shafts"
    for part, way in (("residual_rotating", ""), ("forward", "forward_"), ("reverse", "reverse_")):
        if getattr(record, f"{part}_gmm") is not None and getattr(record, f"{way}angle_deg") is None:
            undecided[f"{way}angle_deg"] = NO_ANGLE
    return record


def _with_size(
    record: Balance, size_key: str, angle_key: str, split: Split, shares: Mapping[Place, complex]
) -> Balance:
    """``record`` with the size and the angle of what ``split`` holds in these ``shares``."""
    return size_and_angle(record, size_key, angle_key, *split.combined(shares), freedom=split.freedom)


def added_words(added: Sequence[AddedMass]) -> str:
    """Words that say which ``added`` masses are part of the residual."""
    each = [
        f"{mass.mass_g:g} g on the {mass.on}"
        + (f" at {mass.radius_mm:g} mm, {mass.angle_deg:g}°" if mass.on == "crank" else f" of cylinder {mass.cylinder}")
        for mass in added
    ]
    return f"the residual includes what was added on purpose: {', '.join(each)}"


def rotor_record(split: Split) -> Balance:
    """Residual masses of a rotor from a ``split`` whose masses (kg) stand at 1 mm: unbalance in one plane."""
    record = Balance()
    of_pistons = ("residual_reciprocating_g", "residual_second_order_g", "along_g")
    undecided = dict.fromkeys(of_pistons, "a rotor has no pistons")
    both = {ALONG, ACROSS} <= set(split.sought)
    part = 0.5 if both else 1.0
    shares = {ALONG: 1e3 * part, ACROSS: 1e3j * part}
    record = _with_size(record, "residual_rotating_gmm", "angle_deg", split, shares)
    if both:
        record = _with_size(record, "reverse_gmm", "reverse_angle_deg", split, shares | {ACROSS: -shares[ACROSS]})
    else:
        undecided["reverse_gmm"] = "one direction alone tells no sense of rotation: all is taken to turn with the shaft"
    if record.angle_deg is None:
        undecided["angle_deg"] = NO_ANGLE
    return replace(record, not_decided=undecided)
