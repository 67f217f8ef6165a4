"""Balance shafts and geared reverse cranks: what they must carry, what they and their faults leave, tables of parts.

What errors of masses, pins and shaft timing leave of a balanced engine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from crankorder.engine.definition import BalanceShafts, Engine, SingleShaft, Weight
from crankorder.engine.forces import Z, crankcase_forces
from crankorder.engine.machine_parts import NOT_EMPTY, EngineData, NonNegative, Positive
from crankorder.engine.slider_crank import Complex, acceleration_harmonics, even_harmonics, plain_piston_acceleration
from crankorder.errors import RequestError, plain_number
from crankorder.records import Record, said

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


Parts = NDArray[np.complex128]
"""Direct and reverse part by sample and order 1, 2, …: shape (2, sample, order)."""

ONE_RADIAN_PER_S_RPM = 30 / math.pi
QUANTILES = {"2.5 %": 0.025, "median": 0.5, "95 %": 0.95, "97.5 %": 0.975}
NO_FORCE_G_MM, NO_COUPLE_G_MM2 = 1e-6, 1e-3
"""What is smaller is rounding: at 10,000 rpm a millionth of a newton, and of a newton metre."""


class BalanceTolerances(EngineData):
    """Errors of a series of engines, each even between plus and minus what is stated.

    ``reciprocating_g``: of each cylinder. ``rotating_g_mm``: unbalance added to each throw, any direction, up to this.
    ``pin_deg``: of each crank pin. ``shaft_percent``: of each weight of a balance shaft. ``gear_deg``: of each shaft's
    own angle. ``mistiming_deg``: one case beside the series, all shafts late by it.
    """

    reciprocating_g: NonNegative = 0.0
    rotating_g_mm: NonNegative = 0.0
    pin_deg: NonNegative = 0.0
    shaft_percent: NonNegative = 0.0
    gear_deg: NonNegative = 0.0
    mistiming_deg: float | None = None
    samples: Annotated[int, Field(ge=100, le=20_000)] = 2000
    seed: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of a series of engines, by sample and cylinder, weight of a shaft or shaft."""

    mass_g: NDArray[np.float64]
    throw_g_mm: Complex
    pin_rad: NDArray[np.float64]
    weight_share: NDArray[np.float64]
    gear_rad: NDArray[np.float64]


def with_single_shafts(engine: Engine, max_order: int) -> Engine:
    """The ``engine`` with each of its pairs as two single shafts that make the same force, orders to ``max_order``."""
    shafts = engine.shafts
    bare = engine.model_copy(update={"shafts": BalanceShafts()})
    paired = engine.model_copy(update={"shafts": shafts.model_copy(update={"single": ()})})
    force_g_mm = 1e6 * (
        crankcase_forces(paired, ONE_RADIAN_PER_S_RPM, max_order=max_order)[Z]
        - crankcase_forces(bare, ONE_RADIAN_PER_S_RPM, max_order=max_order)[Z]
    )
    orders = sorted({*shafts.orders, *(pair.order for pair in shafts.pairs)})
    single = [
        SingleShaft(
            speed_ratio=sense * k,
            weights=(
                Weight(
                    unbalance_g_mm=float(abs(force_g_mm[k])) / (2 * k**2),
                    angle_deg=sense * math.degrees(float(np.angle(force_g_mm[k]))),
                    position_m=shafts.position_m,
                ),
            ),
        )
        for k in orders
        for sense in (1, -1)
    ]
    return engine.model_copy(update={"shafts": BalanceShafts(single=(*single, *shafts.single))})


Spread = dict[str, dict[str, float]]
"""Quantiles of a series by order."""


class Mistiming(Record):
    """What remains where all balance shafts are late by one angle."""

    deg: float = said("the angle, degrees")
    orders: tuple[str, ...] = said("orders of the shafts")
    force_g_mm: dict[str, float] = said("force by order, g·mm over ω²")
    couple_g_mm2: dict[str, float] = said("couple by order, g·mm² over ω²")


class SeriesResiduals(Record):
    """Force and couple that a series of engines within tolerances leaves, and what one mistiming leaves."""

    of: str = said("shafts that were studied: own, a design, or none", default="none")
    samples: int = said("engines drawn")
    seed: int = said("of the random numbers")
    force_g_mm: Spread = said("quantiles of the force by order, g·mm over ω²")
    couple_g_mm2: Spread = said("quantiles of the couple by order, g·mm² over ω²")
    mistiming: Mistiming | None = said("of all shafts, where the file states one")


def series_residuals(
    engine: Engine, tolerances: BalanceTolerances, *, max_order: int, of: str = "none"
) -> SeriesResiduals:
    """Force and couple that a series of engines leaves by order, and one stated mistiming.

    ``engine``: balanced, by its webs and shafts. ``tolerances``: of the series. ``max_order``: highest order, ≥ 1 and
    not below any shaft's. ``of``: name of the shafts.
    The residual of an order is the most of a turn: the large half axis of its ellipse.
    """
    studied = with_single_shafts(engine, max_order)
    force, couple = _series_left(studied, _draw(studied, tolerances), max_order)
    late = None
    if tolerances.mistiming_deg is not None and studied.shafts.single:
        exact = _draw(studied, BalanceTolerances(samples=100))
        late_errors = replace(exact, gear_rad=np.full_like(exact.gear_rad, -np.radians(tolerances.mistiming_deg)))
        of_force, of_couple = (
            {str(k): float(size) for k, size in enumerate(_most(parts)[0], start=1)}
            for parts in _series_left(studied, late_errors, max_order)
        )
        turning = sorted({abs(shaft.speed_ratio) for shaft in studied.shafts.single})
        late = Mistiming(
            deg=tolerances.mistiming_deg, orders=tuple(map(str, turning)), force_g_mm=of_force, couple_g_mm2=of_couple
        )
    sizes = {"force_g_mm": _quantiles(force), "couple_g_mm2": _quantiles(couple)}
    return SeriesResiduals(of=of, samples=tolerances.samples, seed=tolerances.seed, **sizes, mistiming=late)


def _draw(engine: Engine, tolerances: BalanceTolerances) -> Errors:
    draw = np.random.default_rng(tolerances.seed)
    n, cylinders, single = tolerances.samples, len(engine.cylinders), engine.shafts.single
    weights = sum(len(shaft.weights) for shaft in single)
    mass = draw.uniform(-1, 1, (n, cylinders))
    throw = np.sqrt(draw.uniform(0, 1, (n, cylinders))) * np.exp(2j * np.pi * draw.uniform(0, 1, (n, cylinders)))
    return Errors(
        mass_g=tolerances.reciprocating_g * mass,
        throw_g_mm=tolerances.rotating_g_mm * throw,
        pin_rad=np.radians(tolerances.pin_deg) * draw.uniform(-1, 1, (n, cylinders)),
        weight_share=tolerances.shaft_percent / 100 * draw.uniform(-1, 1, (n, weights)),
        gear_rad=np.radians(tolerances.gear_deg) * draw.uniform(-1, 1, (n, len(single))),
    )


def _series_left(engine: Engine, errors: Errors, max_order: int) -> tuple[Parts, Parts]:
    """Force (g·mm) and couple (g·mm²) over ω² of every sample."""
    parts = np.zeros((2, 2, errors.mass_g.shape[0], max_order), dtype=np.complex128)  # force and couple
    for n, (single, cylinder) in enumerate(zip(engine.each, engine.cylinders, strict=True)):
        bank = math.radians(cylinder.bank_deg)
        turned = np.radians(cylinder.crank_deg) + errors.pin_rad[:, n]
        mass_g = 1e3 * single.reciprocating_mass_kg + errors.mass_g[:, n]
        harmonics = acceleration_harmonics(single.mechanism, max_order)[1:]
        # powers by products: much faster than as many exponentials
        turns = np.broadcast_to(np.exp(1j * (turned - bank))[:, None], (turned.size, max_order))
        line = 0.5e3 * single.crank_radius_m * mass_g[:, None] * harmonics * np.cumprod(turns, axis=1)
        tilt = np.exp(1j * bank)
        _add(parts, line * tilt, line.conj() * tilt, cylinder.position_m, slice(None))
        rest = 1e6 * single.rotating_unbalance_kg_m * np.exp(1j * np.radians(single.rotating_unbalance_deg))
        _add(parts, (rest + errors.throw_g_mm[:, n]) * np.exp(1j * turned), 0.0, cylinder.position_m, 0)
    for web in engine.webs:
        _add(parts, np.asarray(web.unbalance_g_mm * np.exp(1j * np.radians(web.angle_deg))), 0.0, web.position_m, 0)
    counted = 0
    for number, shaft in enumerate(engine.shafts.single):
        ahead, k = math.copysign(1, shaft.speed_ratio), abs(shaft.speed_ratio)
        for weight in shaft.weights:
            amount = k**2 * weight.unbalance_g_mm * (1 + errors.weight_share[:, counted])
            angle = math.radians(weight.angle_deg) + ahead * errors.gear_rad[:, number]
            force = amount * np.exp(1j * angle)
            direct, reverse = (force, 0.0) if ahead > 0 else (0.0, force)
            _add(parts, direct, reverse, weight.position_m, k - 1)
            counted += 1
    return parts[0], parts[1]


def _add(parts: Complex, direct: Complex | float, reverse: Complex | float, position_m: float, at: int | slice) -> None:
    for row, lever in ((0, 1.0), (1, 1e3 * position_m)):
        parts[row, 0, :, at] += lever * direct
        parts[row, 1, :, at] += lever * reverse


def _most(parts: Parts) -> NDArray[np.float64]:
    """Largest of a turn, (sample, order)."""
    return np.asarray(np.abs(parts[0]) + np.abs(parts[1]))


def _quantiles(parts: Parts) -> Spread:
    return {
        str(k): {name: float(np.quantile(sizes, share)) for name, share in QUANTILES.items()}
        for k, sizes in enumerate(_most(parts).T, start=1)
    }


def tolerance_sentences(study: SeriesResiduals, speed_rpm: float) -> list[str]:
    """What a series leaves, and what one mistiming adds.

    ``study``: of the tolerances. ``speed_rpm``: at which couples are named, > 0.
    """
    spread, rocking = study.force_g_mm, study.couple_g_mm2
    largest, worst = (max(left, key=lambda order: left[order]["95 %"]) for left in (spread, rocking))
    widest = max(spread, key=lambda order: spread[order]["97.5 %"] - spread[order]["2.5 %"])
    of_largest = "their largest and the one that errors spread most" if largest == widest else "their largest"
    drawn = f"Of {study.samples} engines drawn within the tolerances"
    if spread[largest]["95 %"] <= NO_FORCE_G_MM:
        sentences = [f"{drawn} 95 % leave no force."]
    else:
        sentences = [f"{drawn} 95 % leave less than {_span(spread[largest])} of order {largest}, {of_largest}."]
    if largest != widest and spread[widest]["95 %"] > NO_FORCE_G_MM:
        sentences.append(f"Errors spread order {widest} most: 95 % leave less than {_span(spread[widest])} of it.")
    newton_metres = 1e-9 * (speed_rpm / ONE_RADIAN_PER_S_RPM) ** 2
    if rocking[worst]["95 %"] > NO_COUPLE_G_MM2:
        couples = f"{plain_number(newton_metres * rocking[worst]['95 %'])} N·m of order {worst} at {speed_rpm:g} rpm"
        sentences.append(f"95 % rock with a couple of less than {couples}, their largest.")
    late = study.mistiming
    if late is None:
        return sentences
    size, order = max((late.force_g_mm[order], order) for order in late.orders)
    couple, rocked = max((late.couple_g_mm2[order], order) for order in late.orders)
    left = [f"{plain_number(size)} g·mm of order {order}"] if size > NO_FORCE_G_MM else []
    if couple > NO_COUPLE_G_MM2:
        left.append(f"a couple of {plain_number(newton_metres * couple)} N·m of order {rocked} at {speed_rpm:g} rpm")
    return [*sentences, f"All shafts late by {late.deg:g}° leave {' and '.join(left) or 'nothing of their orders'}."]


def _span(quantiles: Mapping[str, float]) -> str:
    least, most = plain_number(quantiles["2.5 %"]), plain_number(quantiles["97.5 %"])
    return f"{plain_number(quantiles['95 %'])} g·mm (the middle 95 % between {least} and {most} g·mm)"
