"""What is known of the machine before anything is measured."""

from __future__ import annotations

from dataclasses import dataclass, field

from crankorder.engine.bearings import Bearing, bearing_orders
from crankorder.engine.definition import Engine
from crankorder.engine.motor import Motor
from crankorder.engine.transfer_paths import AddedMass, StatedPath
from crankorder.identify.stated_parts import StatedPart


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
class Sources:
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
