"""Residual unbalance through paths that the manifest states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.engine.definition import Engine
from crankorder.engine.forces import DIRECTIONS, Z
from crankorder.engine.transfer_paths import StatedPath
from crankorder.findings import Balance
from crankorder.identify.balance.record import Split, rotor_record, split_record
from crankorder.identify.balance.shaker_forces import force_per_kg
from crankorder.identify.balance.transfer_path import Complex, MeasuredOrders, Real, accelerance_of, measured_orders
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-balance.toml", table="stated_paths"):
    largest_misfit_share: float


NUMBERS = _Numbers.load()

ROTOR_RADIUS_M = 1e-3
"""Radius at which the mass of a rotor's unbalance is counted: 1 kg there is 1000 g·mm."""


@dataclass(frozen=True, eq=False)
class _Forces:
    mass_kg: Complex
    covariance: Real
    freedom: float
    missed: float
    rows: int


def by_stated_paths(
    order_map: xr.Dataset, lines: Sequence[float], *, engine: Engine | None, paths: tuple[StatedPath, ...]
) -> Balance | str:
    """Residual unbalance by the stated ``paths``; or, in words, why there are none.

    ``order_map``: the OrderMap. ``lines``: orders at which lines stand. ``engine``: None or one without pistons is a
    rotor. Forces of each stated direction are fitted to all channels and speeds at which the paths hold; intervals hold
    noise and the paths' uncertainty. What no path is stated for is taken as not reaching a channel.
    """
    measured = measured_orders(order_map, (1, 2), lines=lines)
    strangers = sorted({path.channel for path in paths} - set(measured.channels))
    if strangers:
        return f"no channel of acceleration is called {', '.join(strangers)}, for which a path is stated"
    if 1 not in measured.orders:
        return "the order map has no bin at order 1"
    directions = tuple(d for d in ("X", "Z") if any(path.direction == d for path in paths))
    if not directions:
        return "a path along the shaft tells no unbalance: state one of direction X or Z"
    pistons = engine is not None and engine.cycle != "rotor" and engine.largest_piston_kg > 0
    radius_m = engine.crank_radius_m if engine is not None and pistons else ROTOR_RADIUS_M
    parts = [(1, directions)]
    if pistons and engine is not None and 2 in engine.shafts.every_order and 2 in measured.orders and "Z" in directions:
        parts.append((2, ("Z",)))
    found = []
    for order, axes in parts:
        forces = _forces(measured, order, axes, paths, radius_m)
        if isinstance(forces, str):
            return forces
        found.append(forces)
    split = _split(found, parts, engine if pistons else None)
    record = split_record(split, engine=engine) if pistons and engine is not None else rotor_record(split)
    used = sorted({path.channel for path in paths})
    evidence = (
        f"stated paths of {', '.join(used)} at {found[0].rows} speeds in their range; they miss "
        f"{100 * found[0].missed:.0f} % of order 1; paths that are not stated are taken as none"
    )
    orders = tuple(order for order, _ in parts)
    return replace(record, source="stated path", orders_used=orders, evidence=evidence)


def _forces(
    measured: MeasuredOrders, order: int, axes: tuple[str, ...], paths: tuple[StatedPath, ...], radius_m: float
) -> _Forces | str:
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
        return f"no speed brings order {order} into the frequency range in which the stated paths hold"
    weight = np.where(usable, 1 / np.where(usable, measured.steady_error[:, at], 1.0), 0.0)
    columns = (np.where(usable[:, :, None], whole, 0) * weight[:, :, None]).reshape(-1, len(axes))
    target = (measured.amplitude[:, at] * weight).ravel()
    inverse = np.linalg.pinv(columns)
    if np.linalg.matrix_rank(columns, tol=1e-3 * float(np.linalg.norm(columns, 2))) < len(axes):
        return "the stated paths do not tell forces along and across apart: the channels see both alike"
    mass = inverse @ target
    left = np.abs(target - columns @ mass) ** 2
    own = np.where(usable, error, 0.0) * weight
    free = max(1.0, float(np.count_nonzero(usable) - len(axes)))
    chi_square = float(left.sum() / max(2 * (own**2).mean() * own.size / np.count_nonzero(usable) * free, 1e-300))
    missed = float(np.sqrt(max(0.0, left.sum() - 2 * (own**2).sum()) / max((np.abs(target) ** 2).sum(), 1e-300)))
    doubt = max((path.uncertainty_percent for path in stated), default=0.0) / 100
    if missed > NUMBERS.largest_misfit_share + doubt:
        return (
            f"the stated paths miss {100 * missed:.0f} % of order {order}: they are not those of this machine, or "
            "something else makes that order"
        )
    doubts = [
        path.uncertainty_percent
        / 196
        * (inverse @ (np.nan_to_num(part) * weight[:, :, None]).reshape(-1, len(axes)) @ mass)
        for path, part in zip(stated, design, strict=True)
    ]
    noise = max(1.0, chi_square) * _noise(inverse, own, measured.correlation[at])
    covariance = noise + _of_doubts(doubts)
    speeds = int(np.count_nonzero(usable.any(axis=0)))
    return _Forces(mass, covariance, max(1.0, 2.0 * (speeds - len(axes))), missed, speeds)


def _noise(inverse: Complex, own: Real, correlation: Complex) -> Real:
    """Covariance of real and imaginary parts in turn that errors ``own`` (channel, row) over their weights make."""
    swayed = (inverse * own.ravel()).reshape(len(inverse), *own.shape)
    return _by_parts(np.einsum("acr,rcd,bdr->ab", swayed, correlation, swayed.conj()))


def _of_doubts(doubts: Sequence[Complex]) -> Real:
    """Covariance that paths wrong by a complex share make: each shifts the masses (mass,) by so much, in any phase."""
    total = np.zeros((2 * len(doubts[0]), 2 * len(doubts[0])))
    for shift in doubts:
        for turned in (shift, 1j * shift):
            parts = np.stack([turned.real, turned.imag], axis=1).ravel()
            total += np.outer(parts, parts)
    return total


def _by_parts(covariance: Complex) -> Real:
    """Covariance of real and imaginary parts in turn, where E z zᴴ is twice ``covariance`` and z is circular."""
    size = len(covariance)
    parts = np.zeros((2 * size, 2 * size))
    parts[0::2, 0::2] = parts[1::2, 1::2] = covariance.real
    parts[1::2, 0::2], parts[0::2, 1::2] = covariance.imag, -covariance.imag
    return parts


def _split(found: list[_Forces], parts: list[tuple[int, tuple[str, ...]]], engine: Engine | None) -> Split:
    """All masses together: on the pistons where forces act along them alone, else at the crank radius."""
    sought = tuple((order, axis) for order, axes in parts for axis in axes)
    per_kg = np.ones(len(sought), dtype=np.complex128)
    if engine is not None:
        bare = engine.pistons_alone
        along_only = (1, "X") not in sought
        for number, (order, axis) in enumerate(sought):
            per_kg[number] = force_per_kg(
                bare, order, DIRECTIONS.index(axis), along_only=along_only or (order == 2 and axis == DIRECTIONS[Z])
            )
    size = 2 * len(sought)
    covariance, start = np.zeros((size, size)), 0
    for forces in found:
        end = start + len(forces.covariance)
        covariance[start:end, start:end] = forces.covariance
        start = end
    split = Split(
        mass_kg=np.concatenate([forces.mass_kg for forces in found]),
        covariance=covariance,
        freedom=min(forces.freedom for forces in found),
        sought=sought,
        per_kg=np.ones_like(per_kg),
    )
    scaled = [split.combined(np.where(np.arange(len(sought)) == n, 1 / per_kg, 0)) for n in range(len(sought))]
    turn = np.zeros((size, size))
    for n, share in enumerate(1 / per_kg):
        turn[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] = [[share.real, -share.imag], [share.imag, share.real]]
    return Split(
        mass_kg=np.array([value for value, _ in scaled]),
        covariance=turn @ covariance @ turn.T,
        freedom=split.freedom,
        sought=sought,
        per_kg=per_kg,
    )
