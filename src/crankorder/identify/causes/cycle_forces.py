"""Whether the gas or the moving masses of a firing engine make an order, by the forces that its model predicts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from crankorder.engine.definition import Engine
from crankorder.engine.forces import crankcase_forces, crankcase_moments
from crankorder.engine.gas import gas_torque_by_order
from crankorder.errors import RequestError
from crankorder.findings import OrderFinding, Quality
from crankorder.quantities import Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "cycle_forces")

Maker = Literal["gas", "masses", "both"]

GAS_ORDERS = (0.5, 1.5, 2.5, 3.5)
"""Two or more of these half orders tell of gas in a four-stroke engine: nothing else makes its cycle felt so."""


@dataclass(frozen=True)
class CycleForce:
    """Peaks of one ``order`` at ``speed_rpm``: of the ``gas`` torque, the masses' ``torque`` (N·m) and ``force`` (N).

    ``lever_m`` is the length on which the force counts as a moment: that of crank and rod, as high as an engine stands
    above its crankshaft.
    """

    order: float
    speed_rpm: float
    gas: float
    torque: float
    force: float
    lever_m: float

    @property
    def masses(self) -> float:
        """Torque of the masses and their force on the lever together (N·m)."""
        return self.torque + self.force * self.lever_m

    @property
    def maker(self) -> Maker:
        """Which of the two makes the order, where one is more than ``dominates_ratio`` times the other."""
        if self.gas > NUMBERS.dominates_ratio * self.masses:
            return "gas"
        return "masses" if self.masses > NUMBERS.dominates_ratio * self.gas else "both"

    @property
    def words(self) -> str:
        """Both, as numbers."""
        return (
            f"at {self.speed_rpm:.0f} rpm and order {self.order:g} the model's gas makes {self.gas:.3g} N·m, "
            f"its masses {self.torque:.3g} N·m and {self.force:.3g} N (on {1e3 * self.lever_m:.0f} mm "
            f"{self.force * self.lever_m:.3g} N·m)"
        )


def cycle_forces(engine: Engine, orders: Sequence[tuple[float, float]]) -> tuple[CycleForce | None, ...]:
    """What gas and masses of ``engine`` make at each of ``orders``: pairs of an order and a speed [rpm].

    None for all where its model tells no gas torque: without gas, or without the firing angles of several cylinders.
    The torques act about the crankshaft, the force is the larger of those across and along the cylinder.
    Source: gas torque T = −F x', inertia by r × F (truth sheet 2.6, 2.7 and 4.2).
    """
    if engine.gas is None or not orders:
        return (None,) * len(orders)
    highest = max(1, int(np.ceil(max(order for order, _ in orders))))
    try:
        _, gas = gas_torque_by_order(engine, highest)
    except RequestError:
        return (None,) * len(orders)
    lever = engine.crank_radius_m + engine.rod_length_m
    return tuple(_at(engine, order, rpm, np.abs(gas), highest, lever) for order, rpm in orders)


def _at(engine: Engine, order: float, rpm: float, gas: Floats, highest: int, lever: float) -> CycleForce:
    place, at = round(order * engine.revs_per_cycle), round(order)
    whole = abs(order - at) < 1e-6
    force = np.abs(crankcase_forces(engine, rpm, max_order=highest))[:, at].max() if whole else 0.0
    torque = np.abs(crankcase_moments(engine, rpm, max_order=highest))[1, at] if whole else 0.0
    return CycleForce(order, rpm, float(gas[place]), float(torque), float(force), lever)


def gas_half_orders(orders: Iterable[float]) -> tuple[str, ...]:
    """Those of ``orders`` that are one of ``GAS_ORDERS``, in words."""
    return tuple(
        f"{order:.1f}" for order in orders if any(abs(order - known) < NUMBERS.gas_reach_orders for known in GAS_ORDERS)
    )


def cycle_doubts(
    orders: Iterable[OrderFinding], *, two_stroke: bool, engine: Engine | None = None, max_order: float = np.inf
) -> list[Quality]:
    """A flag where the ``orders`` found do not fit the stated cycle: several half orders of a ``two_stroke`` engine.

    They must be locked to the shaft. Fewer half orders than a four-stroke engine could make say nothing, and neither
    does their lack, unless the ``engine`` has gas that makes half orders up to ``max_order`` as large as whole ones.
    """
    locked = sorted({record.order for record in orders if record.lock == "locked"})
    if two_stroke:
        half = gas_half_orders(locked)
        doubted = len(half) > 1
        detail = (
            f"half orders ({', '.join(half)}) are locked to the shaft, and a two-stroke engine's gas makes none: "
            'if it is a four-stroke engine, state cycle = "four-stroke"; else something rubs or is loose'
        )
    else:
        missing = _missing_half_orders(engine, locked, max_order)
        doubted = bool(missing)
        detail = (
            f"the model's gas makes half orders ({', '.join(missing)}) as large as whole ones, and none is seen: if it "
            'is a two-stroke engine, state cycle = "two-stroke"; if it was motored, its gas makes no orders here'
        )
    return [Quality(recording="all", flag="cycle_doubted", severity="suspect", detail=detail)] if doubted else []


def _missing_half_orders(engine: Engine | None, locked: Sequence[float], max_order: float) -> tuple[str, ...]:
    """Half orders that the gas of a four-stroke ``engine`` makes as large as it makes those that are ``locked``.

    None where one half order of any size is locked, or fewer than two whole ones that the gas makes.
    """
    if engine is None or engine.gas is None or engine.revs_per_cycle != 2:
        return ()
    reach = NUMBERS.gas_reach_orders
    if any(abs(order % 1.0 - 0.5) < reach for order in locked):
        return ()
    highest = int(np.ceil(min(max_order, max(GAS_ORDERS) + 0.5)))
    try:
        gas = np.abs(gas_torque_by_order(engine, highest)[1])
    except RequestError:
        return ()
    seen = [gas[2 * round(order)] for order in locked if abs(order - round(order)) < reach and 1 <= order <= highest]
    if len(seen) < 2:
        return ()
    expected = [order for order in GAS_ORDERS if order <= max_order and gas[round(2 * order)] >= min(seen)]
    return tuple(f"{order:g}" for order in expected) if len(expected) > 1 else ()
