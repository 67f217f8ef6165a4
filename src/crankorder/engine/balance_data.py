"""Data for balancing an engine: the table ``[balance]`` of its TOML file beside what every engine file holds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, model_validator

from crankorder.engine.balancing import CounterweightPlaces, CrankTrain, ReducedMasses, equivalent_masses
from crankorder.engine.crankshaft import CrankshaftSection
from crankorder.engine.definition import NOT_EMPTY, Engine, EngineData, NonNegative, Positive
from crankorder.engine.polar import phasor
from crankorder.engine.residuals import UnbalanceClass
from crankorder.engine.reverse_cranks import GearTrain
from crankorder.engine.rod_split import RodSplits
from crankorder.engine.shafts import ShaftPairParts
from crankorder.errors import CrankorderError, ManyErrors, RequestError
from crankorder.settings import toml_table, validation_fault

TABLE = "balance"
"""Name of the table of an engine file that this module reads."""

AGREEMENT = 1e-9
"""Largest relative difference of a number that an engine file states in two places."""


class CrankshaftData(EngineData):
    """Sections of a crankshaft, the two counterweights' names, and the overbalance left for the balancing machine."""

    sections: Annotated[tuple[CrankshaftSection, ...], NOT_EMPTY] = Field(strict=False)
    counterweights: tuple[str, str] = Field(strict=False)
    overbalance_kg_mm: tuple[NonNegative, NonNegative] | None = Field(default=None, strict=False)

    @model_validator(mode="after")
    def _counterweights_are_sections(self) -> Self:
        names = [section.name for section in self.sections]
        missing = [name for name in self.counterweights if names.count(name) != 1]
        if missing:
            raise ValueError(f"counterweights must each name one section; not so: {', '.join(missing)}")
        if self.planes_mm[0] == self.planes_mm[1]:
            raise ValueError("the two counterweights must not lie in one plane")
        return self

    @property
    def planes_mm(self) -> tuple[float, float]:
        """Places of the two counterweights along the crankshaft."""
        places = {section.name: section.z_mm for section in self.sections}
        first, second = self.counterweights
        return places[first], places[second]


class BalanceData(EngineData):
    """What an engine file may say about balance beyond masses and lengths; every part may be missing.

    ``added_mass_g`` sits on the piston and is known to no shaft. ``offset_mm`` is the offset of the cylinder to be
    studied, whether or not the engine itself has it. ``notes`` say what the numbers are and which were assumed.
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
    table, source = toml_table(name, "engines", beside=beside)
    if "kind" in table and "kind" not in Engine.model_fields:
        raise RequestError(
            "not a crank engine with balance data",
            file=source,
            place="kind",
            found=table["kind"],
            remedy="Name an engine with crank radius, rod length and masses",
        )
    return balanced_engine(table, name=Path(name).stem, source=source)


def balanced_engine(table: dict[str, Any], *, name: str, source: str) -> BalancedEngine:
    """Engine and balance data from the content of an engine file.

    ``table``: content, as TOML gives it. ``name``: of the engine. ``source``: what errors call the file.
    Raises ManyErrors that lists every fault.
    """
    faults: list[CrankorderError] = []
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
    if faults or engine is None or balance is None:
        raise ManyErrors(faults)
    return BalancedEngine(name=name, engine=engine, balance=balance)


def reduced_masses(subject: BalancedEngine) -> ReducedMasses:
    """What rotates and what slides in the engine of ``subject``, before any counterweight or shaft of a study."""
    engine, train = subject.engine, subject.balance.train
    if train is not None:
        parts = equivalent_masses(train)
        return ReducedMasses(
            mechanism=engine.mechanism, rotating_g=parts.rotating_g, reciprocating_g=parts.reciprocating_g
        )
    rotating_g = engine.rotating_unbalance_kg_m / engine.crank_radius_m * 1e3
    return ReducedMasses(
        mechanism=engine.mechanism,
        rotating_g=rotating_g * phasor(engine.rotating_unbalance_deg),
        reciprocating_g=engine.reciprocating_mass_kg * 1e3,
    )


def _disagreements(engine: Engine, balance: BalanceData, source: str) -> list[CrankorderError]:
    """Faults where the parts of the crank train do not add up to the masses and lengths of the engine."""
    if balance.train is None:
        return []
    parts = equivalent_masses(balance.train)
    stated = {
        "crank_radius_m": (engine.crank_radius_m, balance.train.crank_radius_mm * 1e-3),
        "rod_length_m": (engine.rod_length_m, balance.train.rod_length_mm * 1e-3),
        "reciprocating_mass_kg": (engine.reciprocating_mass_kg, parts.reciprocating_g * 1e-3),
        "rotating_unbalance_kg_m": (
            engine.rotating_unbalance_kg_m,
            parts.rotating_g * balance.train.crank_radius_mm * 1e-6,
        ),
    }
    return [
        RequestError(
            "does not agree with the parts of the crank train",
            file=source,
            place=key,
            found=f"{here:.9g}",
            allowed=f"{there:.9g}, from {TABLE}.train",
        )
        for key, (here, there) in stated.items()
        if abs(here - there) > AGREEMENT * max(abs(here), abs(there))
    ]
