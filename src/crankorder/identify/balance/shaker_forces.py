"""Which of an engine's orders are of known force, and what a gram of residual mass makes at the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.definition import Engine
from crankorder.engine.forces import DIRECTIONS, X, Y, Z, crankcase_forces, crankcase_moments
from crankorder.identify.balance.order_shaker import OrderForces
from crankorder.identify.balance.transfer_path import Complex, Real
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-balance.toml", table="shaker_forces"):
    known_share: float
    rocking_share: float


NUMBERS = _Numbers.load()

NONE_LEFT = 1e-9
"""Of one cylinder's force: what is left of several is rounding."""


@dataclass(frozen=True, eq=False)
class EngineShaker:
    """Orders of known force and orders whose masses are sought, with their forces by row.

    ``orders``: sought first, then known. ``sought``: (order, axis) of each mass sought; 1 kg of it makes the force
    ``per_kg`` (mass,) · r ω².
    """

    orders: tuple[int, ...]
    known_orders: tuple[int, ...]
    sought: tuple[tuple[int, str], ...]
    per_kg: Complex
    forces: OrderForces
    known_rows: NDArray[np.bool_]

    @property
    def sought_orders(self) -> tuple[int, ...]:
        """Order of each mass sought."""
        return tuple(order for order, _ in self.sought)


def engine_shaker(engine: Engine, speed_rpm: Real, *, seen: set[int], highest: int) -> EngineShaker | str:
    """Forces of ``engine`` at ``speed_rpm`` (speed,) by row; or, in words, why no order of it is of known force.

    ``seen``: orders above the floor. ``highest``: last order of the map. An order is of known force where pistons make
    it, no balance shaft takes it away, and it is not the first: what of that is left depends on counterweights.
    """
    if highest < 2:
        return "the order map ends below order 2"
    bare = engine.pistons_alone
    forces = crankcase_forces(bare, speed_rpm, max_order=highest)
    moments = crankcase_moments(bare, speed_rpm, max_order=highest)
    size = np.abs(forces).max(axis=(0, 1))
    one = float(np.abs(crankcase_forces(_alone(bare), speed_rpm, max_order=1)).max())
    candidates = [k for k in range(2, highest + 1) if k not in engine.shafts.every_order and size[k] > NONE_LEFT * one]
    made = [k for k in candidates if size[k] >= NUMBERS.known_share * max(size[candidates])]
    if not made:
        return "the pistons make no order that shafts do not take away, so no force is known"
    known = tuple(k for k in made if k in seen)
    if not known:
        names = ", ".join(map(str, made[:4]))
        return f"the orders of known force ({names}) do not stand above the floor, so the path is not identified"
    if _rocks(engine, forces, moments, known):
        return (
            f"orders {known} rock the crankcase too, for the cylinders stand side by side, and that path is not known"
        )
    return _assembled(bare, engine, speed_rpm, forces, moments, known)


def _alone(engine: Engine) -> Engine:
    return engine.model_copy(update={"cylinders": engine.cylinders[:1]})


def _rocks(engine: Engine, forces: Complex, moments: Complex, known: tuple[int, ...]) -> bool:
    span = max(c.position_m for c in engine.cylinders) - min(c.position_m for c in engine.cylinders)
    rocking = np.abs(moments[:, [X, Z]][:, :, list(known)]).max(axis=(0, 1))
    return bool(
        span > 0 and (rocking > NUMBERS.rocking_share * span * np.abs(forces[:, :, list(known)]).max(axis=(0, 1))).any()
    )


def _assembled(
    bare: Engine, engine: Engine, speed_rpm: Real, forces: Complex, moments: Complex, known: tuple[int, ...]
) -> EngineShaker:
    axes = [d for d in (X, Z) if np.abs(forces[:, d][:, list(known)]).max() > NONE_LEFT * np.abs(forces).max()]
    sought = [(1, d) for d in axes] + [(2, d) for d in axes if 2 in engine.shafts.every_order and d == Z]
    orders = (*sorted({order for order, _ in sought}), *known)
    n_speeds = len(forces)
    rows = {k: slice(i * n_speeds, (i + 1) * n_speeds) for i, k in enumerate(orders)}
    n_rows = n_speeds * len(orders)
    acting = np.zeros((len(axes) + 1, n_rows), dtype=np.complex128)
    unit = np.zeros((len(sought), len(axes) + 1, n_rows), dtype=np.complex128)
    for k in orders:
        acting[-1, rows[k]] = moments[:, Y, k]
        if k in known:
            acting[:-1, rows[k]] = forces[:, axes, k].T
    omega_squared_r = (speed_rpm * np.pi / 30) ** 2 * bare.crank_radius_m
    per_kg = np.array([force_per_kg(bare, k, d, along_only=axes == [Z]) for k, d in sought])
    for m, (k, d) in enumerate(sought):
        unit[m, axes.index(d), rows[k]] = per_kg[m] * omega_squared_r
    names = tuple(DIRECTIONS[d] for d in axes)
    moves = bool(np.abs(acting[-1]).max() > 0)
    forces_by_row = OrderForces(axes=(*names, "RY"), known=acting, unit=unit)
    known_rows = np.zeros(n_rows, dtype=bool)
    for k in known:
        known_rows[rows[k]] = True
    return EngineShaker(
        orders=orders,
        known_orders=known,
        sought=tuple((k, DIRECTIONS[d]) for k, d in sought),
        per_kg=per_kg,
        forces=forces_by_row if moves else forces_by_row.on(names),
        known_rows=known_rows,
    )


def force_per_kg(bare: Engine, order: int, axis: int, *, along_only: bool) -> complex:
    """Force over r ω² of 1 kg: on every piston of ``bare``, or at the crank radius where that makes none.

    ``bare``: engine without shafts. ``order``: 1 or more. ``axis``: direction, 0 X, 1 Y, 2 Z. ``along_only``: forces
    act along Z alone; else 1 kg is one at the crank radius.
    """
    at_rpm = 1000.0
    scale = bare.reciprocating_mass_kg * bare.crank_radius_m * (at_rpm * np.pi / 30) ** 2
    made = complex(crankcase_forces(bare, at_rpm, max_order=order)[axis, order]) / scale
    return made if along_only and abs(made) > NONE_LEFT else 1.0 + 0.0j
