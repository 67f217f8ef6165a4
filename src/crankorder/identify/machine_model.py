"""What is known of the machine before anything is measured, and where its parts may make lines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from crankorder.cause import Cause, CauseKind
from crankorder.engine.definition import Engine
from crankorder.engine.forces import crankcase_forces, crankcase_moments, gas_torque_by_order
from crankorder.engine.machine_parts import AddedMass, Bearing, Motor, StatedPath, bearing_orders
from crankorder.errors import RequestError
from crankorder.findings import OrderFinding, Quality
from crankorder.identify.found import AgreedOrder
from crankorder.orders.intervals import half_width
from crankorder.settings import MethodNumbers


class Limit(NamedTuple):
    """A limit of the manifest: ``value_si`` in SI units; a balance grade has no band."""

    quantity: str
    low_hz: float
    high_hz: float
    value_si: float
    source: str
    channels: tuple[str, ...]


@dataclass(frozen=True)
class MachineModel:
    """What is known of the machine: its cycle, the orders that its kinematics make, its bearings, gears and masses.

    ``firing``: whether gas is burnt in it, so that every multiple of the cycle may be the gas cycle; ``gears``: stated
    meshes of teeth or passings of blades; ``engine``: masses and lengths, None where no engine is
    named; ``paths``: stated paths from force to acceleration; ``added``: masses that this test has on purpose;
    ``motor``: a stated induction motor; ``two_stroke``: whether it is a piston engine that fires each revolution;
    ``limits`` of the manifest; mass of the rotor and its speed in service.
    """

    revs_per_cycle: int
    engine_orders: tuple[float, ...] = ()
    bearings: tuple[Bearing, ...] = ()
    firing: bool = False
    gears: tuple[StatedPart, ...] = ()
    engine: Engine | None = None
    paths: tuple[StatedPath, ...] = ()
    added: tuple[AddedMass, ...] = ()
    motor: Motor | None = None
    two_stroke: bool = False
    limits: tuple[Limit, ...] = ()
    rotor_kg: float | None = None
    service_rpm: float | None = None

    @property
    def has_pistons(self) -> bool:
        """Whether it is a piston engine, of four or of two strokes."""
        return self.revs_per_cycle == 2 or self.two_stroke or self.engine is not None

    @cached_property
    def known_bearing_orders(self) -> dict[tuple[str, str], float]:
        """Orders of the lines of its bearings, by name and line."""
        return {(b.name, line): order for b in self.bearings for line, order in bearing_orders(b).items()}


NUMBERS = MethodNumbers("5-identify-explain.toml", "stated_parts")


@dataclass(frozen=True)
class StatedPart:
    """A part that makes lines at the multiples of ``order``, which is known within ``order_half`` (95 %).

    ``kind`` and ``name``: "gear mesh" and "pinion"; ``shaft_order``: how often its shaft turns; ``most``: its highest
    multiple; ``elements``: what else with so many teeth may make a line that keeps step, None where nothing else.
    """

    kind: CauseKind
    name: str
    order: float
    order_half: float = 0.0
    shaft_order: float = 1.0
    most: int = NUMBERS.most_harmonics
    elements: int | None = None


class PartsAt(NamedTuple):
    """Parts at an order: ``near`` with the multiple that is there, nearest first; ``unparted``: see parts_at."""

    near: tuple[tuple[StatedPart, int], ...]
    unparted: tuple[StatedPart, ...]

    def cause(self, evidence: str) -> Cause:
        """What makes the line, with the ``evidence`` for it: "gear mesh pinion, harmonic 2 or wheel"."""
        by_kind: dict[CauseKind, list[str]] = {}
        for part, multiple in self.near:
            name = part.name + (f", harmonic {multiple}" if multiple > 1 else "")
            by_kind.setdefault(part.kind, []).append(name)
        first, *others = [
            Cause(kind, evidence, {"names": " or ".join(dict.fromkeys(names))}) for kind, names in by_kind.items()
        ]
        return first.either(*others)


def parts_at(parts: Iterable[StatedPart], agreed: AgreedOrder) -> PartsAt:
    """The ``parts`` of which a multiple lies where the order ``agreed`` does, within the intervals of both.

    A part names a line only where few lines that lie anywhere would hit one of its multiples as closely: where these
    lie closer together than the intervals tell apart it is one of ``unparted``.
    """
    own = max(NUMBERS.same_sigmas, half_width(agreed.degrees_of_freedom)) * agreed.order_error
    near, unparted = list[tuple[float, StatedPart, int]](), list[StatedPart]()
    for part in parts:
        multiple = max(1, round(agreed.order / part.order))
        reach = math.hypot(multiple * part.order_half, own) + 1e-9 * agreed.order
        away = abs(agreed.order - multiple * part.order)
        if multiple > part.most or away > reach:
            continue
        if 2.0 * reach > NUMBERS.by_chance_share * part.order:
            unparted.append(part)
        else:
            near.append((away, part, multiple))
    near.sort(key=lambda placed: placed[0])
    return PartsAt(tuple((part, multiple) for _, part, multiple in near), tuple(unparted))


FORCE_NUMBERS = MethodNumbers("5-identify-explain.toml", "cycle_forces")

Maker = Literal["gas", "masses", "both"]

GAS_ORDERS = (0.5, 1.5, 2.5, 3.5)
"""Two or more of these half orders tell of gas in a four-stroke engine: nothing else makes its cycle felt so."""


class CycleForce(NamedTuple):
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
        if self.gas > FORCE_NUMBERS.dominates_ratio * self.masses:
            return "gas"
        return "masses" if self.masses > FORCE_NUMBERS.dominates_ratio * self.gas else "both"

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
    lever, forces = engine.crank_radius_m + engine.rod_length_m, list[CycleForce]()
    for order, rpm in orders:
        at, force, torque = round(order), 0.0, 0.0
        if abs(order - at) < 1e-6:
            force = float(np.abs(crankcase_forces(engine, rpm, max_order=highest))[:, at].max())
            torque = float(np.abs(crankcase_moments(engine, rpm, max_order=highest))[1, at])
        peak = float(np.abs(gas[round(order * engine.revs_per_cycle)]))
        forces.append(CycleForce(order, rpm, peak, torque, force, lever))
    return tuple(forces)


def gas_half_orders(orders: Iterable[float]) -> tuple[str, ...]:
    """Those of ``orders`` that are one of ``GAS_ORDERS``, in words."""
    reach = FORCE_NUMBERS.gas_reach_orders
    return tuple(f"{order:.1f}" for order in orders if any(abs(order - known) < reach for known in GAS_ORDERS))


def cycle_doubts(
    orders: Iterable[OrderFinding], *, two_stroke: bool, engine: Engine | None = None, max_order: float = np.inf
) -> list[Quality]:
    """A flag where the ``orders`` found do not fit the stated cycle: several half orders of a ``two_stroke`` engine.

    They must be locked to the shaft. Fewer half orders than a four-stroke engine could make say nothing, and neither
    does their lack, unless the ``engine`` has gas that makes half orders up to ``max_order`` as large as whole ones.
    """
    locked = sorted({record.order for record in orders if record.lock == "locked"})
    half = gas_half_orders(locked) if two_stroke else _missing_half_orders(engine, locked, max_order)
    if len(half) < 2:
        return []
    detail = f"the model's gas makes half orders ({', '.join(half)}) as large as whole ones, and none is seen: if it "
    detail += 'is a two-stroke engine, state cycle = "two-stroke"; if it was motored, its gas makes no orders here'
    if two_stroke:
        detail = f"half orders ({', '.join(half)}) are locked to the shaft, and a two-stroke engine's gas makes none: "
        detail += 'if it is a four-stroke engine, state cycle = "four-stroke"; else something rubs or is loose'
    return [Quality(recording="all", flag="cycle_doubted", severity="suspect", detail=detail)]


def _missing_half_orders(engine: Engine | None, locked: Sequence[float], max_order: float) -> tuple[str, ...]:
    """Half orders that the gas of a four-stroke ``engine`` makes as large as it makes those that are ``locked``.

    None where one half order of any size is locked, or fewer than two whole ones that the gas makes.
    """
    if engine is None or engine.gas is None or engine.revs_per_cycle != 2:
        return ()
    reach = FORCE_NUMBERS.gas_reach_orders
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
    return tuple(f"{order:g}" for order in expected)
