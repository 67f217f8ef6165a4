"""Data for balancing an engine (table ``[balance]`` of its TOML file), and what each cause of it leaves unbalanced."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, ValidationInfo, computed_field, field_validator

from crankorder.engine.balancing import CounterweightPlaces, CrankTrain, ReducedMasses, phasor, unbalance_force_n
from crankorder.engine.crankshaft import CrankshaftBalance, CrankshaftData, crankshaft_balance
from crankorder.engine.definition import Engine, with_gas_file
from crankorder.engine.forces import crankcase_forces
from crankorder.engine.gas import firing_intervals_deg
from crankorder.engine.machine_parts import ASCENDING, NOT_EMPTY, EngineData, Positive
from crankorder.engine.shafts import (
    BalanceTolerances,
    GearTolerances,
    GearTrain,
    Series,
    ShaftPairParts,
    gear_speed_ratios,
    residual_along,
    tolerance_study,
    weight_moments,
    weighted_wheels,
    wheels_couple,
    wheels_force,
)
from crankorder.engine.slider_crank import SliderCrank, acceleration_harmonics
from crankorder.errors import CrankorderError, ManyErrors, RequestError
from crankorder.records import Record, said
from crankorder.settings import toml_table, validation_fault

DesignOrder = Annotated[int, Field(ge=1, le=12)]

Amounts = dict[str, float]
"""Amplitudes by order, or forces by crank speed (rpm): orders and speeds as texts."""


class RodSplit(EngineData):
    """Masses (g) of the big and the small end of a rod, as one method divides them."""

    big_end_g: Positive
    small_end_g: Positive

    @computed_field  # type: ignore[prop-decorator]
    @property
    def total_g(self) -> float:
        """Mass of the whole rod."""
        return self.big_end_g + self.small_end_g

    @computed_field  # type: ignore[prop-decorator]
    @property
    def centroid_fraction(self) -> float:
        """Place of the centre of gravity that the two masses imply: distance from the big end over rod length."""
        return self.small_end_g / self.total_g


class RodOnPin(EngineData):
    """A rod weighed whole and balanced on a pin or blade: mass (g), and its centre of gravity from the big end (mm)."""

    mass_g: Positive
    centre_from_big_end_mm: Positive
    rod_length_mm: Positive

    @field_validator("rod_length_mm")
    @classmethod
    def _centre_is_between(cls, value: float, info: ValidationInfo) -> float:
        centre = info.data.get("centre_from_big_end_mm")
        if centre is not None and centre >= value:
            raise ValueError("centre_from_big_end_mm must lie between the ends of the rod")
        return value


class RodSplits(EngineData):
    """The same rod divided by a cut through its centre of gravity in a drawing, by a scale at its pins, and on a pin.

    ``on_pin``: balanced on a pin or blade, where that was done; ``weighed_whole_g``: the whole rod on the scale.
    """

    cut: RodSplit
    scale: RodSplit
    on_pin: RodOnPin | None = None
    weighed_whole_g: Annotated[float, Field(gt=0)] | None = None

    @property
    def by_method(self) -> dict[str, RodSplit]:
        """Each division by its name: ``"cut"``, ``"scale"`` and, where it was done, ``"on pin"``."""
        splits = {"cut": self.cut, "scale": self.scale}
        if self.on_pin is not None:
            fraction = self.on_pin.centre_from_big_end_mm / self.on_pin.rod_length_mm
            small_g = self.on_pin.mass_g * fraction
            splits["on pin"] = RodSplit(big_end_g=self.on_pin.mass_g - small_g, small_end_g=small_g)
        return splits


class UnbalanceClass(EngineData):
    """A class of engines by the residual unbalance (g·mm) that they typically have."""

    name: Annotated[str, Field(min_length=1)]
    limit_g_mm: Positive


def leading_harmonics(count: int, crank_ratio: float) -> NDArray[np.float64]:
    """First terms of the series of A2, A4, …: λ, λ³/4, 9λ⁵/128, 5λ⁷/256, …, shape (count,).

    They are what textbooks and shafts built by them use, 2 % to 15 % below the exact harmonics at λ = 0.3.

    ``count``: how many, ≥ 0. ``crank_ratio``: λ = r/l, 0 < λ < 1.
    Source: truth sheet 1 and 2.1 (table 1 of Ruckle 2014 lacks the 9 in its formula, not in its numbers).
    """
    k = np.arange(1, count + 1, dtype=np.float64)
    binomial = np.cumprod(np.where(k == 1, 0.5, (k - 1.5) / k))
    return 8 * k**2 / crank_ratio * binomial * (crank_ratio / 2) ** (2 * k)


def unbalance_class(residual_g_mm: float, classes: Sequence[UnbalanceClass]) -> str | None:
    """Name of the strictest class whose typical unbalance ``residual_g_mm`` does not exceed; None beyond all.

    ``classes``: in any sequence.
    """
    kept = [kind for kind in classes if abs(residual_g_mm) <= kind.limit_g_mm]
    return min(kept, key=lambda kind: kind.limit_g_mm).name if kept else None


TABLE = "balance"
"""Name of the table of an engine file that this module reads."""

AGREEMENT = 1e-9
"""Largest relative difference of a number that an engine file states in two places."""


class BalanceData(EngineData):
    """What an engine file may say about balance beyond masses and lengths; every part may be missing.

    ``added_mass_g`` sits on the piston and is known to no shaft. ``offset_mm`` is the offset of the cylinder to be
    studied, whether or not the engine itself has it. ``notes`` say what the numbers are and which were assumed.
    For several cylinders webs and shafts are worked out for ``design_orders``, with weights in the two planes of
    ``design_planes_m`` along the crankshaft; the first and the last cylinder's where left out.
    """

    notes: tuple[str, ...] = Field(default=(), strict=False)
    speeds_rpm: Annotated[tuple[Positive, ...], NOT_EMPTY] = Field(default=(1000.0, 2000.0), strict=False)
    train: CrankTrain | None = None
    places: CounterweightPlaces = CounterweightPlaces()
    rod_split: RodSplits | None = None
    crankshaft: CrankshaftData | None = None
    shaft_pairs: tuple[ShaftPairParts, ...] = Field(default=(), strict=False)
    added_mass_g: Positive | None = None
    offset_mm: Annotated[float, Field(gt=0)] | None = None
    residual_classes: tuple[UnbalanceClass, ...] = Field(default=(), strict=False)
    gears: GearTrain | None = None
    design_orders: tuple[DesignOrder, ...] = Field(default=(1, 2), strict=False)
    design_planes_m: Annotated[tuple[float, float] | None, ASCENDING] = Field(default=None, strict=False)
    tolerances: BalanceTolerances | None = None


@dataclass(frozen=True, kw_only=True)
class BalancedEngine:
    """An engine with its data for balancing, under the name that it was asked for by."""

    name: str
    engine: Engine
    balance: BalanceData


def load_balanced_engine(name: str, *, beside: Path | None = None) -> BalancedEngine:
    """Engine and balance data from a shipped file of ``pipeline/engines`` or a user's TOML file.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which that path is tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault of its content.
    """
    stated, source = toml_table(name, "engines", beside=beside)
    table, of_gas = with_gas_file(stated, name, beside)
    if "kind" in table and "kind" not in Engine.model_fields:
        problem = "not a crank engine with balance data"
        remedy = "Name an engine with crank radius, rod length and masses"
        raise RequestError(problem, file=source, place="kind", found=table["kind"], remedy=remedy)
    return balanced_engine(table, name=Path(name).stem, source=source, faults=of_gas)


def balanced_engine(
    table: Mapping[str, object], *, name: str, source: str, faults: Sequence[CrankorderError] = ()
) -> BalancedEngine:
    """Engine and balance data from the content of an engine file.

    ``table``: content, as TOML gives it. ``name``: of the engine. ``source``: what errors call the file. ``faults``:
    found before, told with those of the content. Raises ManyErrors that lists every fault.
    """
    faults = list(faults)
    engine = balance = None
    try:
        engine = Engine.model_validate({key: value for key, value in table.items() if key != TABLE})
    except ValidationError as error:
        faults += [validation_fault(fault, source) for fault in error.errors()]
    try:
        balance = BalanceData.model_validate(table.get(TABLE, {}))
    except ValidationError as error:
        placed = [{**fault, "loc": (TABLE, *fault["loc"])} for fault in error.errors()]
        faults += [validation_fault(fault, source) for fault in placed]
    if engine is not None and balance is not None:
        faults += _disagreements(engine, balance, source)
    if engine is not None:
        faults += _unanswered(engine, source)
    if faults or engine is None or balance is None:
        raise ManyErrors(faults)
    return BalancedEngine(name=name, engine=engine, balance=balance)


def _unanswered(engine: Engine, source: str) -> list[CrankorderError]:
    """Faults of cylinders with gas that do not say when they fire, and of shafts against orders without a force."""
    questions: list[Callable[[], object]] = []
    if engine.gas is not None:
        questions.append(partial(firing_intervals_deg, engine))
    if engine.shafts.orders or engine.shafts.pairs:
        questions.append(partial(crankcase_forces, engine, 1.0, max_order=engine.shafts.every_order[-1]))
    faults: list[CrankorderError] = []
    for question in questions:
        try:
            question()
        except RequestError as error:
            problem, place, found, remedy = error.problem, error.place, error.found, error.remedy
            faults.append(RequestError(problem, file=source, place=place, found=found, remedy=remedy))
    return faults


def reduced_masses(subject: BalancedEngine) -> ReducedMasses:
    """What rotates and what slides in the engine of ``subject``, before any counterweight or shaft of a study."""
    engine, train = subject.engine, subject.balance.train
    if train is not None:
        return ReducedMasses(
            mechanism=engine.mechanism, rotating_g=train.rotating_g, reciprocating_g=train.reciprocating_g
        )
    rotating_g = engine.rotating_unbalance_kg_m / engine.crank_radius_m * 1e3
    return ReducedMasses(
        mechanism=engine.mechanism,
        rotating_g=rotating_g * phasor(engine.rotating_unbalance_deg),
        reciprocating_g=engine.reciprocating_mass_kg * 1e3,
    )


def _disagreements(engine: Engine, balance: BalanceData, source: str) -> list[CrankorderError]:
    """Faults where the parts of the crank train do not add up to the masses and lengths of the engine."""
    train = balance.train
    if train is None:
        return []
    of_parts = {
        "crank_radius_m": train.crank_radius_mm * 1e-3,
        "rod_length_m": train.rod_length_mm * 1e-3,
        "reciprocating_mass_kg": train.reciprocating_g * 1e-3,
        "rotating_unbalance_kg_m": train.rotating_g * train.crank_radius_mm * 1e-6,
    }
    faults: list[CrankorderError] = []
    for key, there in of_parts.items():
        here = getattr(engine, key)
        if abs(here - there) > AGREEMENT * max(abs(here), abs(there)):
            problem, allowed = "does not agree with the parts of the crank train", f"{there:.9g}, from {TABLE}.train"
            faults.append(RequestError(problem, file=source, place=key, found=f"{here:.9g}", allowed=allowed))
    return faults


FULL_TURN_REV = np.arange(720) / 720
"""Crank angles of a full turn; the quarter turns, where residuals peak, are among them."""


def speed_key(speed_rpm: float) -> str:
    """``speed_rpm`` as tables and sentences name it: every digit that a user can have meant, no zeros at the end."""
    return f"{speed_rpm:.15g}"


def newton(unbalance_g_mm: float, speed_rpm: float) -> float:
    """Force (N) of ``unbalance_g_mm``, an amplitude over ω², at ``speed_rpm`` of the crank."""
    return float(unbalance_force_n(unbalance_g_mm, speed_rpm))


def newton_by_speed(unbalance_g_mm: float, speeds: Sequence[float]) -> Amounts:
    """Force (N) of ``unbalance_g_mm`` at each of the ``speeds`` (rpm)."""
    return {speed_key(speed): newton(unbalance_g_mm, speed) for speed in speeds}


def harmonic_shares(mechanism: SliderCrank, max_order: int) -> Amounts:
    """Amplitudes of orders 2 … ``max_order`` of the piston of ``mechanism`` over crank radius and ω²: A2, A4, …"""
    share = np.abs(acceleration_harmonics(mechanism, max_order))
    return {str(k): float(share[k]) for k in range(2, max_order + 1) if share[k]}


def crankshaft_of(subject: BalancedEngine, speeds: Sequence[float]) -> CrankshaftBalance | None:
    """Balance of the crankshaft of ``subject`` at ``speeds`` (rpm), with the rod's big end as cut and as weighed."""
    data, splits = subject.balance.crankshaft, subject.balance.rod_split
    if data is None:
        return None
    big_ends = {} if splits is None else {name: split.big_end_g for name, split in splits.by_method.items()}
    return crankshaft_balance(data, {speed_key(speed): speed for speed in speeds}, big_ends_g=big_ends)


class RodBalance(Record):
    """The rod in two masses, as cut and as weighed, and what remains where it was balanced as cut."""

    methods: dict[str, RodSplit] = said("masses of both ends (g) by method")
    weighed_whole_g: float | None = said("mass of the whole rod on the scale, g")
    cut_centroid_fraction: float = said("centre of gravity as cut, from the big end over rod length")
    scale_centroid_fraction: float = said("centre of gravity as weighed, from the big end over rod length")
    centroid_shift_mm: float = said("distance of both, mm")
    two_mass_inertia_kg_m2: float = said("moment of inertia of the two masses as weighed, kg·m²")
    rotating_deficit_g: float = said("mass that the crankshaft's counterweights lack, g")
    reciprocating_excess_g: float = said("mass that the shafts have too much, g")
    residual_x_g_mm: Amounts = said("force that remains along the cylinder by order, g·mm over ω²")
    residual_y_g_mm: Amounts = said("force that remains across the cylinder by order, g·mm over ω²")
    residual_x_second_n: Amounts = said("force of order 2 along the cylinder by speed, N")
    residual_y_first_n: Amounts = said("force of order 1 across the cylinder by speed, N")


def rod_balance(subject: BalancedEngine, speeds: Sequence[float]) -> RodBalance | None:
    """Residual of a crankshaft and shafts built for the rod of ``subject`` as cut, which acts as weighed.

    ``speeds``: at which forces are given, rpm. Source: truth sheet 2.7, on Ruckle 2014, section 3.3.1. A cut through
    the centre of gravity keeps the mass of the rod but, put at the pins, moves its centre of gravity.
    """
    splits, mechanism = subject.balance.rod_split, subject.engine.mechanism
    if splits is None:
        return None
    cut, scale = splits.cut, splits.scale
    radius_mm, length_mm = mechanism.crank_radius_m * 1e3, mechanism.rod_length_m * 1e3
    deficit, excess = scale.big_end_g - cut.big_end_g, cut.small_end_g - scale.small_end_g
    across, second = deficit * radius_mm, excess * radius_mm * abs(acceleration_harmonics(mechanism, 2)[2])
    return RodBalance(
        methods=splits.by_method,
        weighed_whole_g=splits.weighed_whole_g,
        cut_centroid_fraction=cut.centroid_fraction,
        scale_centroid_fraction=scale.centroid_fraction,
        centroid_shift_mm=(cut.centroid_fraction - scale.centroid_fraction) * mechanism.rod_length_m * 1e3,
        # of two masses about their centre of gravity; the rod's own differs, which makes a couple and no force
        two_mass_inertia_kg_m2=scale.big_end_g * scale.small_end_g / scale.total_g * length_mm**2 * 1e-9,
        rotating_deficit_g=deficit,
        reciprocating_excess_g=excess,
        residual_x_g_mm={"1": (deficit - excess) * radius_mm, "2": second},
        residual_y_g_mm={"1": across},
        residual_x_second_n=newton_by_speed(second, speeds),
        residual_y_first_n=newton_by_speed(across, speeds),
    )


class AddedMass(Record):
    """Force along the cylinder of a mass on the piston that no shaft was built for."""

    mass_g: float = said("the mass, g")
    residual_x_g_mm: Amounts = said("force by order, g·mm over ω²")
    residual_n: dict[str, Amounts] = said("force by speed and order, N")
    grade: str | None = said("strictest class of unbalance that order 1 keeps to", key="class")


def added_mass(subject: BalancedEngine, max_order: int, speeds: Sequence[float]) -> AddedMass | None:
    """Forces by order 1 … ``max_order`` of the mass added to the piston of ``subject``, at ``speeds`` (rpm)."""
    grams, mechanism = subject.balance.added_mass_g, subject.engine.mechanism
    if grams is None:
        return None
    share = np.abs(acceleration_harmonics(mechanism, max_order))
    amounts = {str(k): float(grams * mechanism.crank_radius_m * 1e3 * share[k]) for k in np.flatnonzero(share)}
    return AddedMass(
        mass_g=grams,
        residual_x_g_mm=amounts,
        residual_n={
            speed_key(speed): {order: newton(amount, speed) for order, amount in amounts.items()} for speed in speeds
        },
        grade=unbalance_class(amounts["1"], subject.balance.residual_classes),
    )


class OffsetBalance(Record):
    """Effects of an offset of the cylinder on its first orders, and what shafts timed to the crank leave."""

    offset_mm: float = said("distance of the cylinder axis from the crankshaft, mm")
    harmonics: Amounts = said("amplitude of the piston's acceleration by order over r ω²")
    amplitude_ratio: float = said("order 1 with the offset over that without")
    rephasing_deg: float = said("lag of the shafts behind the crank that cancels order 1, degrees")
    third_over_fourth: float = said("order 3 over order 4")
    quadrature_x_g_mm: float = said("order 1 that shafts timed to the crank leave, g·mm over ω²")
    quadrature_n: Amounts = said("that force by speed, N")
    couple_n_m: dict[str, Amounts] = said("couple of force and shafts by speed and order, N·m", key="couple_Nm_at_rpm")


def offset_balance(subject: BalancedEngine, speeds: Sequence[float]) -> OffsetBalance | None:
    """Effects of the offset that ``subject`` asks to be studied, or else of its own, at ``speeds`` (rpm).

    Source: truth sheet 2.6; what of order 1 is out of step with the crank remains beside shafts timed to the crank.
    """
    engine = subject.engine
    offset_mm = subject.balance.offset_mm or abs(engine.offset_m) * 1e3
    if not offset_mm:
        return None
    straight = SliderCrank(crank_radius_m=engine.crank_radius_m, rod_length_m=engine.rod_length_m)
    mechanism = replace(straight, offset_m=offset_mm * 1e-3)
    _, in_first, _, in_third, in_fourth = map(complex, acceleration_harmonics(mechanism, 4))
    masses = reduced_masses(subject)
    first = masses.crank_radius_mm * masses.reciprocating_g
    quadrature = first * -in_first.imag
    lines = {"1": first, "2": float(first * abs(acceleration_harmonics(straight, 2)[2]))}
    return OffsetBalance(
        offset_mm=offset_mm,
        harmonics=harmonic_shares(mechanism, 8),
        amplitude_ratio=abs(in_first),
        rephasing_deg=math.degrees(math.atan2(-in_first.imag, in_first.real)),
        third_over_fourth=abs(in_third) / abs(in_fourth),
        quadrature_x_g_mm=quadrature,
        quadrature_n=newton_by_speed(quadrature, speeds),
        # of a force along the cylinder and the shafts that cancel it: Ruckle 2014, section 3.1.2; truth sheet 2.6
        couple_n_m={
            speed_key(speed): {order: newton(amount, speed) * (1e-3 * offset_mm) for order, amount in lines.items()}
            for speed in speeds
        },
    )


class GearErrors(Record):
    """Median and 95 % bound of what sampled gear errors leave, by order."""

    errors: GearTolerances = said("standard deviations of the errors, number of samples and seed")
    along_g_mm: dict[str, Amounts] = said("force along the cylinder, g·mm over ω²")
    across_g_mm: dict[str, Amounts] = said("force across the cylinder, g·mm over ω²")
    couple_g_mm2: dict[str, Amounts] = said("couple about the crankshaft, g·mm² over ω²")


class ReverseCranks(Record):
    """Weights of direct and reverse cranks by gear, and what they leave; both with A2 and with λ in its place."""

    speed_ratios: Amounts = said("speed of each gear over crank speed, below zero against the crank")
    pair_moments_g_mm: dict[Series, Amounts] = said("weight times radius of the pairs by order, g·mm")
    weights_g: Amounts = said("weight of each gear that carries one, g")
    couple_g_mm2: float = said("couple about the crankshaft, g·mm² over ω²")
    transverse_g_mm: float = said("largest force across the cylinder, g·mm over ω²")
    residual_x_g_mm: dict[Series, float] = said("largest force along the cylinder, g·mm over ω²")
    residual_x_n: dict[Series, Amounts] = said("that force by speed, N")
    tolerances: GearErrors | None = said("what errors of the gears leave")


def reverse_cranks(subject: BalancedEngine, speeds: Sequence[float]) -> ReverseCranks | None:
    """Weights of the direct and reverse cranks of ``subject``, and what they leave at ``speeds`` (rpm)."""
    masses, train = reduced_masses(subject), subject.balance.gears
    if train is None:
        return None
    both: tuple[Series, ...] = ("leading", "exact")
    by_series = {series: weighted_wheels(train, masses, second=series) for series in both}
    residual = {
        series: float(np.abs(residual_along(masses, weights, FULL_TURN_REV)).max())
        for series, weights in by_series.items()
    }
    wheels = by_series["exact"]
    radius = {gear.name: gear.weight_radius_mm or math.inf for gear in train.gears}
    moments = {series: weight_moments(masses, second=series) for series in both}
    return ReverseCranks(
        speed_ratios=gear_speed_ratios(train),
        pair_moments_g_mm={name: {f"{k:g}": size for k, size in pair.items()} for name, pair in moments.items()},
        weights_g={name: wheel.unbalance_g_mm / radius[name] for name, wheel in wheels.items()},
        couple_g_mm2=float(sum(abs(couple) for couple in wheels_couple(wheels).values())),
        transverse_g_mm=float(np.abs(wheels_force(wheels, FULL_TURN_REV).imag).max()),
        residual_x_g_mm=residual,
        residual_x_n={series: newton_by_speed(amount, speeds) for series, amount in residual.items()},
        tolerances=None if train.tolerances is None else _gear_errors(train, masses, train.tolerances),
    )


def _gear_errors(train: GearTrain, masses: ReducedMasses, tolerances: GearTolerances) -> GearErrors:
    study = tolerance_study(train, masses, tolerances)

    def quantiles(sampled: NDArray[np.float64]) -> dict[str, Amounts]:
        both = zip(study.orders, *np.quantile(sampled, [0.5, 0.95], axis=0), strict=True)
        return {f"{order:g}": {"median": float(middle), "95 %": float(high)} for order, middle, high in both}

    return GearErrors(
        errors=tolerances,
        along_g_mm=quantiles(study.along_g_mm),
        across_g_mm=quantiles(study.across_g_mm),
        couple_g_mm2=quantiles(study.couple_g_mm2),
    )
