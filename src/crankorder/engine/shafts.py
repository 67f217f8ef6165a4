"""Balance shafts at any multiple of crank speed: what they must carry, what they leave, and their tables of parts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from crankorder.engine.balancing import ReducedMasses, Strategy, balanced, force_by_order
from crankorder.engine.definition import NOT_EMPTY, EngineData, Positive
from crankorder.engine.polar import OrderForce, phasor, sum_by_order
from crankorder.errors import RequestError

Possibility = Literal["1", "2", "3", "4", "4+2"]

BASIS: dict[Possibility, Strategy] = {"1": "b", "2": "b", "3": "b", "4": "c", "4+2": "c"}
"""Counterweight strategy that each possibility of additional shafts builds on."""


@dataclass(frozen=True, kw_only=True)
class Shaft:
    """A shaft with an unbalance: speed over crank speed (negative: against the crank) and where its heavy side points.

    ``phase_deg`` is the direction of the heavy side at top dead centre, from the cylinder axis in the sense of the
    crank. ``x_mm`` and ``y_mm`` place the shaft's axis along and across the cylinder, from the crankshaft.
    """

    speed_ratio: float
    unbalance_g_mm: float
    phase_deg: float = 180.0
    x_mm: float = 0.0
    y_mm: float = 0.0

    @property
    def force(self) -> OrderForce:
        """Force over the square of crank speed: the speed ratio enters squared."""
        size = self.speed_ratio**2 * self.unbalance_g_mm * phasor(self.phase_deg)
        if self.speed_ratio > 0:
            return OrderForce(order=self.speed_ratio, direct_g_mm=size)
        return OrderForce(order=-self.speed_ratio, reverse_g_mm=size)

    @property
    def couple_g_mm2(self) -> complex:
        """Complex amplitude over ω² of the couple about the crankshaft, at the shaft's order."""
        force, arm = self.force, complex(self.x_mm, self.y_mm)
        return -1j * arm.conjugate() * force.direct_g_mm + 1j * arm * force.reverse_g_mm.conjugate()


@dataclass(frozen=True, kw_only=True)
class ShaftLayout:
    """A possibility of additional shafts: the counterweights it builds on, its shafts, and the force that remains."""

    strategy: Strategy
    shafts: tuple[Shaft, ...]
    residual: tuple[OrderForce, ...]


class ShaftPart(EngineData):
    """A part of a balance shaft: mass by design and as weighed (g), centre of gravity from the shaft's axis (mm)."""

    name: Annotated[str, Field(min_length=1)]
    design_mass_g: Positive
    measured_mass_g: Positive | None = None
    centroid_mm: float


class ShaftPairParts(EngineData):
    """A counter-rotating pair: order, the parts of one of its two shafts, and what a document prints for the pair."""

    order: Annotated[int, Field(ge=1)]
    parts: Annotated[tuple[ShaftPart, ...], NOT_EMPTY] = Field(strict=False)
    printed_pair_g_mm: Positive | None = None
    printed_needed_g_mm: Positive | None = None


@dataclass(frozen=True, kw_only=True)
class PairScenario:
    """A pair of stated unbalance against the force it was built for, both over ω² (g·mm).

    ``residual_g_mm`` is positive where force remains and negative where the pair does too much.
    """

    pair_unbalance_g_mm: float
    pair_force_g_mm: float
    needed_force_g_mm: float

    @property
    def residual_g_mm(self) -> float:
        """Force that remains, with sign."""
        return self.needed_force_g_mm - self.pair_force_g_mm

    @property
    def overbalance(self) -> float:
        """Force of the pair over the force needed; 1 is balance."""
        return self.pair_force_g_mm / self.needed_force_g_mm


def shaft_unbalance_g_mm(force_g_mm: float, *, order: float, shafts: int = 2) -> float:
    """Unbalance (g·mm) of each of the shafts that together make a force over ω² at an order.

    ``force_g_mm``: peak force along the cylinder over the square of crank speed. ``order``: shaft speed over crank
    speed; it divides squared. ``shafts``: how many share it. Source: Task 5, equations (5.27) to (5.29).
    """
    return abs(force_g_mm) / (shafts * order**2)


def opposing_pair(x_g_mm: complex, *, order: float) -> tuple[Shaft, Shaft]:
    """Two counter-rotating shafts that cancel a force along the cylinder, its quadrature part included.

    ``x_g_mm``: complex amplitude over ω². ``order``: of that force, > 0.
    """
    unbalance = shaft_unbalance_g_mm(abs(x_g_mm), order=order)
    lead = _lead_deg(x_g_mm)
    return (
        Shaft(speed_ratio=float(order), unbalance_g_mm=unbalance, phase_deg=180.0 + lead),
        Shaft(speed_ratio=-float(order), unbalance_g_mm=unbalance, phase_deg=180.0 - lead),
    )


def opposing_shaft(force: OrderForce) -> Shaft:
    """One shaft that cancels the part of ``force`` that turns against the crank."""
    size = force.reverse_g_mm
    return Shaft(
        speed_ratio=-float(force.order),
        unbalance_g_mm=abs(size) / force.order**2,
        phase_deg=180.0 + _lead_deg(size),
    )


def _lead_deg(force_g_mm: complex) -> float:
    return math.degrees(math.atan2(force_g_mm.imag, force_g_mm.real))


def shaft_layout(masses: ReducedMasses, possibility: Possibility, *, max_order: int) -> ShaftLayout:
    """Shafts of one of the possibilities, and the force by order that remains with them.

    ``masses``: engine before balancing. ``possibility``: "1" a pair at crank speed, "2" a pair at twice crank speed,
    "3" both (on strategy b); "4" one shaft against the crank, "4+2" with the second pair (on strategy c).
    ``max_order``: highest order of the residual, ≥ 2. Raises RequestError below.
    Source: Task 5, equations (5.27) to (5.29).
    """
    if max_order < 2:
        raise RequestError("too few orders", found=max_order, allowed="≥ 2")
    strategy = BASIS[possibility]
    left = force_by_order(balanced(masses, strategy), max_order=max_order)
    by_order = {force.order: force for force in left}
    shafts: tuple[Shaft, ...] = ()
    # an order without force needs no shaft
    if possibility in ("1", "3") and 1 in by_order:
        shafts += opposing_pair(by_order[1].x_g_mm, order=1)
    if possibility in ("4", "4+2") and 1 in by_order:
        shafts += (opposing_shaft(by_order[1]),)
    if possibility in ("2", "3", "4+2") and 2 in by_order:
        shafts += opposing_pair(by_order[2].x_g_mm, order=2)
    return ShaftLayout(strategy=strategy, shafts=shafts, residual=with_shafts(left, shafts))


def with_shafts(forces: Iterable[OrderForce], shafts: Iterable[Shaft]) -> tuple[OrderForce, ...]:
    """Force by order that remains when shafts act beside what the engine makes.

    ``forces``: of the engine. ``shafts``: any number, at any multiple of crank speed.
    """
    return sum_by_order([*forces, *(shaft.force for shaft in shafts)])


def parts_unbalance_g_mm(parts: Sequence[ShaftPart], *, masses: Literal["design", "measured"]) -> float:
    """Unbalance (g·mm) of one shaft: the signed sum of mass times centre of gravity.

    ``parts``: of that shaft. ``masses``: "design", or "measured" (a part that was not weighed keeps its design mass).
    Source: Ruckle 2014, table 3. The text there cites equations (7) and (8), which are for couples.
    """
    return sum(
        part.centroid_mm
        * (part.measured_mass_g if masses == "measured" and part.measured_mass_g is not None else part.design_mass_g)
        for part in parts
    )


def pair_rounding_g_mm(parts: Sequence[ShaftPart], *, mass_step_g: float = 0.1, length_step_mm: float = 0.1) -> float:
    """Most that rounding of the stated numbers can change the unbalance of a pair (g·mm).

    ``parts``: of one of the two shafts. ``mass_step_g`` and ``length_step_mm``: last printed digit of each.
    """
    one = sum(part.design_mass_g * length_step_mm / 2 + abs(part.centroid_mm) * mass_step_g / 2 for part in parts)
    return 2 * one


def pair_scenarios(
    *, pair_unbalance_g_mm: float, needed_force_g_mm: float, order: float
) -> dict[Literal["literal", "physical"], PairScenario]:
    """A pair's stated number read both ways: as its unbalance ("literal") and as its force ("physical").

    ``pair_unbalance_g_mm``: the number that a document states for both shafts together. ``needed_force_g_mm``: force
    over ω² that the pair was built for. ``order``: shaft speed over crank speed. A pair that turns ``order`` times as
    fast makes order² times the force, so the number can only equal the needed force if order² is already in it.
    Source: truth sheet 2.4 (the factor of four of table 3); Task 5, equation (5.28).
    """
    stated = pair_unbalance_g_mm
    return {
        "literal": PairScenario(
            pair_unbalance_g_mm=stated, pair_force_g_mm=order**2 * stated, needed_force_g_mm=needed_force_g_mm
        ),
        "physical": PairScenario(
            pair_unbalance_g_mm=stated / order**2, pair_force_g_mm=stated, needed_force_g_mm=needed_force_g_mm
        ),
    }
