"""Balance shafts and geared reverse cranks: what they must carry, what they and their faults leave, tables of parts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from crankorder.engine.balancing import (
    OrderForce,
    ReducedMasses,
    Strategy,
    balanced,
    force_by_order,
    phasor,
    polar_diagram,
    sum_by_order,
)
from crankorder.engine.machine_parts import NOT_EMPTY, EngineData, NonNegative, Positive
from crankorder.engine.slider_crank import even_harmonics, plain_piston_acceleration
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


def opposing_pair(x_g_mm: complex, *, order: float) -> tuple[Shaft, Shaft]:
    """Two counter-rotating shafts that cancel a force along the cylinder, its quadrature part included.

    ``x_g_mm``: complex amplitude over ω². ``order``: of that force, > 0. Source: Task 5, equations (5.27) to (5.29).
    """
    unbalance = abs(x_g_mm) / (2 * order**2)  # the squared speed ratio makes it force
    lead = _lead_deg(x_g_mm)
    return (
        Shaft(speed_ratio=float(order), unbalance_g_mm=unbalance, phase_deg=180.0 + lead),
        Shaft(speed_ratio=-float(order), unbalance_g_mm=unbalance, phase_deg=180.0 - lead),
    )


def _lead_deg(force_g_mm: complex) -> float:
    return math.degrees(math.atan2(force_g_mm.imag, force_g_mm.real))


def shaft_layout(masses: ReducedMasses, possibility: Possibility, *, max_order: int) -> ShaftLayout:
    """Shafts of one of the possibilities, and the force by order that remains with them.

    ``masses``: engine before balancing. ``possibility``: "1" a pair at crank speed, "2" a pair at twice crank speed,
    "3" both (on strategy b); "4" one shaft against the crank, "4+2" with the second pair (on strategy c).
    ``max_order``: highest order of the residual, ≥ 2.
    Source: Task 5, equations (5.27) to (5.29).
    """
    strategy = BASIS[possibility]
    left = force_by_order(balanced(masses, strategy), max_order=max_order)
    by_order = {force.order: force for force in left}
    shafts: tuple[Shaft, ...] = ()
    # an order without force needs no shaft
    if possibility in ("1", "3") and 1 in by_order:
        shafts += opposing_pair(by_order[1].x_g_mm, order=1)
    if possibility in ("4", "4+2") and 1 in by_order:
        size = by_order[1].reverse_g_mm
        shafts += (Shaft(speed_ratio=-1.0, unbalance_g_mm=abs(size), phase_deg=180.0 + _lead_deg(size)),)
    if possibility in ("2", "3", "4+2") and 2 in by_order:
        shafts += opposing_pair(by_order[2].x_g_mm, order=2)
    residual = sum_by_order([*left, *(shaft.force for shaft in shafts)])
    return ShaftLayout(strategy=strategy, shafts=shafts, residual=residual)


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


def pair_rounding_g_mm(parts: Sequence[ShaftPart]) -> float:
    """Most that rounding of the stated numbers to 0.1 g and 0.1 mm can change the unbalance of a pair (g·mm).

    ``parts``: of one of the two shafts.
    """
    return 2 * sum(part.design_mass_g * 0.1 / 2 + abs(part.centroid_mm) * 0.1 / 2 for part in parts)


Series = Literal["exact", "leading"]


class Gear(EngineData):
    """A gear of the train: its teeth, the gear that drives it or shares its shaft, and the place of its axis (mm).

    ``x_mm`` lies along the cylinder, ``y_mm`` across it, both from the crankshaft. ``weight_radius_mm`` is the radius
    of the weight that it carries; a gear without it only transmits.
    """

    name: Annotated[str, Field(min_length=1)]
    teeth: Annotated[int, Field(ge=1)]
    driven_by: str | None = None
    fixed_to: str | None = None
    x_mm: float = 0.0
    y_mm: float = 0.0
    weight_radius_mm: Positive | None = None


class GearTolerances(EngineData):
    """Standard deviations of what may be wrong with the gears, and how many engines to try with which seed.

    ``mesh_deg``: angle of a driven gear in each mesh. ``position_mm``: each coordinate of the axis of a wheel with
    weight. ``weight_fraction``: its unbalance over the right one.
    """

    mesh_deg: NonNegative
    position_mm: NonNegative
    weight_fraction: NonNegative
    samples: Annotated[int, Field(ge=1)]
    seed: Annotated[int, Field(ge=0)]


class GearTrain(EngineData):
    """Gears in the sequence in which motion reaches them; the first sits on the crankshaft."""

    gears: Annotated[tuple[Gear, ...], NOT_EMPTY] = Field(strict=False)
    tolerances: GearTolerances | None = None

    @model_validator(mode="after")
    def _motion_reaches_every_gear(self) -> Self:
        known: set[str] = set()
        for gear in self.gears:
            sources = [name for name in (gear.driven_by, gear.fixed_to) if name is not None]
            if known and (len(sources) != 1 or sources[0] not in known):
                raise ValueError(f"gear {gear.name} needs one of driven_by and fixed_to, naming a gear before it")
            if not known and sources:
                raise ValueError(f"gear {gear.name} comes first: it sits on the crankshaft and nothing drives it")
            if gear.name in known:
                raise ValueError(f"gear {gear.name} is named twice")
            known.add(gear.name)
        return self


@dataclass(frozen=True, kw_only=True)
class ToleranceStudy:
    """Residuals of sampled engines with faulty gears, over ω²; each array has shape (samples, orders).

    ``along_g_mm`` and ``across_g_mm``: amplitudes along and across the cylinder. ``couple_g_mm2``: about the
    crankshaft.
    """

    orders: tuple[float, ...]
    along_g_mm: NDArray[np.float64]
    across_g_mm: NDArray[np.float64]
    couple_g_mm2: NDArray[np.float64]


def gear_speed_ratios(train: GearTrain) -> dict[str, float]:
    """Speed of each gear of ``train`` over crank speed, negative where it turns against the crank.

    Source: document 002 (figure 8 by its text): B, D and G are reverse, E and H direct, G and H at twice crank speed.
    """
    ratios: dict[str, Fraction] = {}
    teeth = {gear.name: gear.teeth for gear in train.gears}
    for gear in train.gears:
        if gear.driven_by is not None:
            ratios[gear.name] = -ratios[gear.driven_by] * Fraction(teeth[gear.driven_by], gear.teeth)
        else:
            ratios[gear.name] = Fraction(1) if gear.fixed_to is None else ratios[gear.fixed_to]
    return {name: float(ratio) for name, ratio in ratios.items()}


def weight_moments(masses: ReducedMasses, *, second: Series = "exact") -> dict[float, float]:
    """Weight times radius (g·mm) that both wheels of a pair carry together, by order: the conditions of balance.

    W r1 = R r for the first order, W2 r2 = R r A2/4 for the second; each wheel has half.

    ``masses``: engine; its rotating part is taken as balanced on the crank. ``second``: "exact" with A2, "leading" with
    r/l in its place. Source: document 002, equations (iv) and (vii); (v) must read (W/2) r1 (truth sheet 3).
    """
    primary = masses.reciprocating_g * masses.crank_radius_mm
    ratio = masses.mechanism.crank_ratio
    harmonic = float(even_harmonics(1, ratio)[0]) if second == "exact" else ratio
    return {1.0: primary, 2.0: primary * harmonic / 4}


def weighted_wheels(train: GearTrain, masses: ReducedMasses, *, second: Series = "exact") -> dict[str, Shaft]:
    """Wheels with weights, as shafts that turn, by name of the gear.

    ``train``: gears; those with a weight radius at crank speed and at twice crank speed share the moment of their
    order. ``masses``: engine. ``second``: as in :func:`weight_moments`. Raises RequestError where the wheels with
    weights are not one direct and one reverse at each of these speeds: the forces across would not cancel.
    """
    ratios = gear_speed_ratios(train)
    carriers = [gear for gear in train.gears if gear.weight_radius_mm is not None]
    moments = weight_moments(masses, second=second)
    turning = sorted(ratios[gear.name] for gear in carriers)
    if turning not in ([-1.0, 1.0], [-2.0, 2.0], [-2.0, -1.0, 1.0, 2.0]):
        found = ", ".join(f"{ratio:g}" for ratio in turning) or "none"
        allowed = "speeds of +1 and −1, +2 and −2 over crank speed, or both"
        raise RequestError("the wheels with weights do not go in pairs", place="gears", found=found, allowed=allowed)
    wheels = {}
    for gear in carriers:
        ratio = ratios[gear.name]
        unbalance = moments[abs(ratio)] / 2
        wheels[gear.name] = Shaft(speed_ratio=ratio, unbalance_g_mm=unbalance, x_mm=gear.x_mm, y_mm=gear.y_mm)
    return wheels


def wheels_force(wheels: Mapping[str, Shaft], crank_angle_rev: ArrayLike) -> NDArray[np.complex128]:
    """Force over ω² (g·mm) of all ``wheels``: real part along the cylinder, imaginary part across.

    ``crank_angle_rev``: revolutions, any shape; the result has that shape.
    """
    return polar_diagram([wheel.force for wheel in wheels.values()], crank_angle_rev)


def wheels_couple(wheels: Mapping[str, Shaft]) -> dict[float, complex]:
    """Complex amplitude over ω² (g·mm²), by order, of the couple of ``wheels`` about the crankshaft.

    It vanishes where the wheels of each pair straddle the cylinder axis symmetrically.
    """
    couples: dict[float, complex] = {}
    for wheel in wheels.values():
        couples[wheel.force.order] = couples.get(wheel.force.order, 0j) + wheel.couple_g_mm2
    return couples


def residual_along(
    masses: ReducedMasses, wheels: Mapping[str, Shaft], crank_angle_rev: ArrayLike
) -> NDArray[np.float64]:
    """Exact force over ω² (g·mm) along the cylinder that remains with ``wheels``.

    ``masses``: engine, its rotating part balanced on the crank. ``crank_angle_rev``: revolutions, any shape; the result
    has that shape. With wheels for the first and second order it begins with the fourth, and is largest at 90°.
    """
    sliding = masses.reciprocating_g * 1e3 * plain_piston_acceleration(crank_angle_rev, masses.mechanism)
    return sliding + wheels_force(wheels, crank_angle_rev).real


def gear_errors_deg(
    train: GearTrain, mesh_errors_deg: Mapping[str, float | NDArray[np.float64]]
) -> dict[str, ArrayLike]:
    """Angle (degrees, in the sense of the crank) by which each gear stands wrong, as errors travel through the train.

    ``train``: gears. ``mesh_errors_deg``: by name of the driven gear, scalars or arrays of one shape; a missing one is
    zero. One tooth off in a mesh is 360° over the teeth of the driven gear.
    """
    teeth = {gear.name: gear.teeth for gear in train.gears}
    errors: dict[str, ArrayLike] = {}
    for gear in train.gears:
        if gear.driven_by is not None:
            passed_on = -np.asarray(errors[gear.driven_by]) * teeth[gear.driven_by] / gear.teeth
            errors[gear.name] = passed_on + mesh_errors_deg.get(gear.name, 0.0)
        else:
            errors[gear.name] = 0.0 if gear.fixed_to is None else errors[gear.fixed_to]
    return errors


def tolerance_study(train: GearTrain, masses: ReducedMasses, tolerances: GearTolerances) -> ToleranceStudy:
    """What misaligned, mis-timed and mis-weighted wheels leave of orders 1 and 2, engine by sampled engine.

    ``train``: gears. ``masses``: engine. ``tolerances``: standard deviations of normal errors, independent of one
    another; number of samples and seed. The same seed gives the same numbers.
    """
    chance = np.random.default_rng(tolerances.seed)
    size = tolerances.samples
    meshes = {
        gear.name: tolerances.mesh_deg * chance.standard_normal(size)
        for gear in train.gears
        if gear.driven_by is not None
    }
    errors = gear_errors_deg(train, meshes)
    wheels = weighted_wheels(train, masses)
    orders = tuple(sorted({abs(wheel.speed_ratio) for wheel in wheels.values()}))
    direct, reverse, couple = (np.zeros((size, len(orders)), dtype=np.complex128) for _ in range(3))
    for name, wheel in wheels.items():
        column = orders.index(abs(wheel.speed_ratio))
        turned = np.exp(1j * np.radians(np.asarray(errors[name])))
        faulty = turned * (1 + tolerances.weight_fraction * chance.standard_normal(size))
        shift = tolerances.position_mm * (chance.standard_normal(size) + 1j * chance.standard_normal(size))
        arm = complex(wheel.x_mm, wheel.y_mm) + shift
        right = wheel.force
        direct[:, column] += right.direct_g_mm * (faulty - 1)
        reverse[:, column] += right.reverse_g_mm * (faulty - 1)
        couple[:, column] += -1j * arm.conj() * right.direct_g_mm * faulty
        couple[:, column] += 1j * arm * (right.reverse_g_mm * faulty).conj()
    along_g_mm = np.abs(direct + reverse.conj())
    across_g_mm = np.abs(direct - reverse.conj())
    return ToleranceStudy(orders=orders, along_g_mm=along_g_mm, across_g_mm=across_g_mm, couple_g_mm2=np.abs(couple))
