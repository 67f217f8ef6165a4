"""What is known of the machine before anything is measured, and where its parts may make lines."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from crankorder.cause import Cause, CauseKind
from crankorder.engine.definition import Engine
from crankorder.engine.machine_parts import AddedMass, Bearing, Motor, StatedPath, bearing_orders
from crankorder.identify.found import AgreedOrder
from crankorder.identify.intervals import half_width
from crankorder.settings import MethodNumbers


@dataclass(frozen=True)
class Limit:
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
    known_bearing_orders: dict[tuple[str, str], float] = field(init=False)

    @property
    def has_pistons(self) -> bool:
        """Whether it is a piston engine, of four or of two strokes."""
        return self.revs_per_cycle == 2 or self.two_stroke or self.engine is not None

    def __post_init__(self) -> None:
        orders = {(b.name, line): order for b in self.bearings for line, order in bearing_orders(b).items()}
        object.__setattr__(self, "known_bearing_orders", orders)


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


@dataclass(frozen=True)
class PartsAt:
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
    near: list[tuple[float, int, StatedPart, int]] = []
    unparted = []
    for part in parts:
        multiple = max(1, round(agreed.order / part.order))
        reach = math.hypot(multiple * part.order_half, own) + 1e-9 * agreed.order
        away = abs(agreed.order - multiple * part.order)
        if multiple > part.most or away > reach:
            continue
        if 2.0 * reach > NUMBERS.by_chance_share * part.order:
            unparted.append(part)
        else:
            near.append((away, len(near), part, multiple))
    return PartsAt(tuple((part, multiple) for *_, part, multiple in sorted(near)), tuple(unparted))
