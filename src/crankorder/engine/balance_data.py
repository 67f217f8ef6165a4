"""Data for balancing an engine: table ``[balance]`` of its TOML file."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationInfo, computed_field, field_validator, model_validator

from crankorder.engine.definition import Engine, engine_table, validated
from crankorder.engine.forces import crankcase_forces, firing_intervals_deg
from crankorder.engine.machine_parts import ASCENDING, NOT_EMPTY, EngineData, NonNegative, Positive
from crankorder.errors import CrankorderError, ManyErrors, RequestError, located

DesignOrder = Annotated[int, Field(ge=1, le=12)]


class CrankTrain(EngineData):
    """Crank, connecting rod and piston as parts: masses in g, lengths and centres of gravity in mm.

    ``crank_centroid_mm`` is counted from the crankshaft's axis, ``rod_centroid_mm`` from the crank pin. The two masses
    that replace the rod keep its centre of gravity, so forces on the frame are exact whatever its moment of inertia;
    the couple is not. Source: Task 5, equation (5.1).
    """

    crank_mass_g: NonNegative
    crank_centroid_mm: float
    crank_radius_mm: Positive
    rod_mass_g: NonNegative
    rod_centroid_mm: float
    rod_length_mm: Positive
    piston_mass_g: NonNegative

    @property
    def rod_at_piston_pin_g(self) -> float:
        """Part of the rod that goes to and fro with the piston."""
        return self.rod_mass_g * self.rod_centroid_mm / self.rod_length_mm

    @property
    def rod_at_crank_pin_g(self) -> float:
        """Part of the rod that turns with the crank."""
        return self.rod_mass_g - self.rod_at_piston_pin_g

    @property
    def rotating_g(self) -> float:
        """All that rotates, at the crank radius (Q1)."""
        return self.rod_at_crank_pin_g + self.crank_mass_g * self.crank_centroid_mm / self.crank_radius_mm

    @property
    def reciprocating_g(self) -> float:
        """All that goes to and fro (Q3)."""
        return self.rod_at_piston_pin_g + self.piston_mass_g


class CounterweightPlaces(EngineData):
    """Radii (mm) at which masses can be added: on the crank, and on the rod beyond the crank pin."""

    crank_mm: Positive | None = None
    rod_mm: Positive | None = None


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


class CrankshaftSection(EngineData):
    """A section of the crankshaft: mass (kg) and centre of gravity (mm).

    Across the axis in the directions x and y, y towards the crank pin, and along the axis (z) from the datum in the
    middle of the first main bearing.
    """

    name: Annotated[str, Field(min_length=1)]
    mass_kg: NonNegative
    x_mm: float
    y_mm: float
    z_mm: float


class FanCounterweight(EngineData):
    """A counterweight shaped as a fan, opposite to the crank pin: outer and inner radius, thickness, full fan angle.

    ``z_mm``: place of its middle along the axis. ``angle_deg``: how far its middle stands on from opposite to the pin,
    in the sense of rotation.
    """

    name: Annotated[str, Field(min_length=1)] = "fan"
    shape: Literal["fan"] = "fan"
    radius_mm: Positive
    inner_radius_mm: NonNegative = 0.0
    thickness_mm: Positive
    fan_angle_deg: Annotated[float, Field(gt=0, lt=360)]
    density_kg_m3: Positive
    z_mm: float = 0.0
    angle_deg: float = 0.0

    @field_validator("inner_radius_mm")
    @classmethod
    def _below_the_outer(cls, value: float, info: ValidationInfo) -> float:
        outer = info.data.get("radius_mm")
        if outer is not None and value >= outer:
            raise ValueError("the inner radius of a fan must be below its radius_mm")
        return value

    @property
    def mass_kg(self) -> float:
        """Mass."""
        ring = (self.radius_mm - self.inner_radius_mm) * (self.radius_mm + self.inner_radius_mm)
        volume_mm3 = math.radians(self.fan_angle_deg) / 2 * ring * self.thickness_mm
        return 1e-9 * self.density_kg_m3 * volume_mm3

    @property
    def centroid_mm(self) -> float:
        """Distance of the centre of gravity from the axis."""
        outer, inner = self.radius_mm, self.inner_radius_mm
        reach = (outer * outer + outer * inner + inner * inner) / (outer + inner)
        return 2 / 3 * reach * float(np.sinc(self.fan_angle_deg / 360))

    @property
    def unbalance_kg_mm(self) -> float:
        """Mass times distance of the centre of gravity."""
        return self.mass_kg * self.centroid_mm

    @property
    def sensitivity(self) -> dict[Literal["radius", "thickness", "fan_angle"], float]:
        """Per cent of unbalance that one per cent more of each size adds: what is most worth changing."""
        half = math.radians(self.fan_angle_deg) / 2
        share = (self.inner_radius_mm / self.radius_mm) ** 3
        return {"radius": 3 / (1 - share), "thickness": 1.0, "fan_angle": half / math.tan(half)}

    @property
    def section(self) -> CrankshaftSection:
        """The counterweight as a section of its crankshaft."""
        centre = -1j * self.centroid_mm * cmath.exp(-1j * math.radians(self.angle_deg))
        place = {"x_mm": centre.real, "y_mm": centre.imag, "z_mm": self.z_mm}
        return CrankshaftSection(name=self.name, mass_kg=self.mass_kg, **place)

    def resized(self, unbalance_kg_mm: float) -> dict[str, float | None]:
        """The radius (mm), the thickness (mm) or the fan angle (degrees) that alone gives another unbalance.

        ``unbalance_kg_mm``: wanted, > 0. None for a fan angle where half a turn of fan is too little. The unbalance is
        ⅔ density · thickness · (radius³ − inner radius³) · sin(fan angle / 2).
        """
        more = unbalance_kg_mm / self.unbalance_kg_mm
        inner = self.inner_radius_mm**3
        sine = more * math.sin(math.radians(self.fan_angle_deg) / 2)
        wider = 2 * math.degrees(math.asin(sine)) if sine <= 1 else None
        if wider is not None and self.fan_angle_deg > 180:
            wider = 360 - wider
        return {
            "radius_mm": (inner + more * (self.radius_mm**3 - inner)) ** (1 / 3),
            "thickness_mm": more * self.thickness_mm,
            "fan_angle_deg": wider,
        }


class Slug(EngineData):
    """A round slug of heavier metal in the counterweight ``into``: its centre ``radius_mm`` from the axis.

    It takes the place of crank metal, ``crank_density_kg_m3``; left out where ``into`` is a fan, which states its own.
    """

    into: Annotated[str, Field(min_length=1)]
    diameter_mm: Positive
    length_mm: Positive
    radius_mm: Positive
    density_kg_m3: Positive
    crank_density_kg_m3: Positive | None = None


Counterweight = Annotated[
    Annotated[str, Tag("section")] | Annotated[FanCounterweight, Tag("fan")],
    Discriminator(lambda value: "section" if isinstance(value, str) else "fan"),
]
"""A counterweight of a file: the name of one of the sections, or a table of its shape."""


class CrankshaftData(EngineData):
    """Sections of a crankshaft, its counterweights in order along it, slugs, and the overbalance left for machining.

    ``counterweights``: names of sections, or fans; corrections are made in the first and the last.
    ``overbalance_kg_mm``: least and most that the counterweights are to have too much, for the balancing machine to
    take away. ``bob_weight``: the section that stands for the big end of the rod, so that what the rod really has can
    be put in its place.
    """

    sections: Annotated[tuple[CrankshaftSection, ...], NOT_EMPTY] = Field(strict=False)
    counterweights: tuple[Counterweight, ...] = Field(strict=False)
    slugs: tuple[Slug, ...] = Field(default=(), strict=False)
    overbalance_kg_mm: tuple[NonNegative, NonNegative] | None = Field(default=None, strict=False)
    bob_weight: str | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        names = [section.name for section in self.sections] + [fan.name for fan in self.fans.values()]
        wanted = [name for name in self.counterweights if isinstance(name, str)]
        wanted += [self.bob_weight] if self.bob_weight is not None else []
        missing = [name for name in wanted if names.count(name) != 1]
        if missing:
            raise ValueError(f"counterweights and bob weight must each name one section; not so: {', '.join(missing)}")
        twice = sorted({fan for fan in self.fans if names.count(fan) > 1})
        if twice:
            raise ValueError(f"more than one section is called {', '.join(twice)}")
        if len(self.counterweights) < 2:
            raise ValueError("a crankshaft needs two counterweights or more, to be corrected in two planes")
        places = self.places
        if any(after <= before for before, after in pairwise(places.values())):
            shown = ", ".join(f"{name} {place:g} mm" for name, place in places.items())
            raise ValueError(f"counterweights must ascend along the axis, no two in one plane: {shown}")
        for slug in self.slugs:
            if slug.into not in places:
                raise ValueError(f"a slug must sit in one of the counterweights; not so: {slug.into}")
            if slug.crank_density_kg_m3 is None and slug.into not in self.fans:
                raise ValueError(
                    f"the slug in {slug.into} needs crank_density_kg_m3, of the metal whose place it takes"
                )
            fan = self.fans.get(slug.into)
            if fan is None and not any(part.name == slug.into and (part.x_mm or part.y_mm) for part in self.sections):
                raise ValueError(f"{slug.into} has its centre of gravity in the axis: a slug in it has no direction")
            if fan is not None and slug.length_mm > fan.thickness_mm:
                raise ValueError(f"the slug in {slug.into} is longer than the counterweight is thick")
            if fan is not None and slug.radius_mm + slug.diameter_mm / 2 > fan.radius_mm:
                raise ValueError(f"the slug in {slug.into} stands out of the counterweight's radius")
        return self

    @cached_property
    def fans(self) -> dict[str, FanCounterweight]:
        """The counterweights that are given by their shape, by name."""
        return {fan.name: fan for fan in self.counterweights if isinstance(fan, FanCounterweight)}

    @property
    def places(self) -> dict[str, float]:
        """Place of each counterweight along the crankshaft (mm), by name; it is corrected in the first and the last."""
        by_name = {section.name: section.z_mm for section in self.sections}
        placed = [(one, by_name[one]) if isinstance(one, str) else (one.name, one.z_mm) for one in self.counterweights]
        return dict(placed)

    @cached_property
    def parts(self) -> tuple[CrankshaftSection, ...]:
        """Every part of the crankshaft: the sections, the fans, and what each slug adds to its counterweight."""
        fans = [fan.section for fan in self.fans.values()]
        holders = {part.name: part for part in (*self.sections, *fans)}
        return (*self.sections, *fans, *(_slug_section(slug, holders[slug.into], self.fans) for slug in self.slugs))


def _slug_section(slug: Slug, holder: CrankshaftSection, fans: Mapping[str, FanCounterweight]) -> CrankshaftSection:
    """What ``slug`` adds, as a section: the mass that it has more than the metal whose place it takes."""
    crank_density = slug.crank_density_kg_m3 or fans[slug.into].density_kg_m3
    volume_mm3 = math.pi / 4 * slug.diameter_mm**2 * slug.length_mm
    added = 1e-9 * volume_mm3 * (slug.density_kg_m3 - crank_density) * slug.radius_mm
    out = complex(holder.x_mm, holder.y_mm)
    centre = math.copysign(slug.radius_mm, added) * out / abs(out)
    name = f"Slug in {slug.into}"
    mass_kg = abs(added) / slug.radius_mm
    return CrankshaftSection(name=name, mass_kg=mass_kg, x_mm=centre.real, y_mm=centre.imag, z_mm=holder.z_mm)


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
    samples: Annotated[int, Field(ge=1, le=20_000)]
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

    @property
    def is_single(self) -> bool:
        """Whether it has one cylinder and no webs, so that counterweights and shafts go by strategies."""
        return len(self.engine.cylinders) == 1 and not self.engine.webs

    @property
    def planes_m(self) -> tuple[float, float]:
        """Planes of the weights of a design along the crankshaft: those of the file, or first and last cylinder."""
        places = [cylinder.position_m for cylinder in self.engine.cylinders]
        return self.balance.design_planes_m or (min(places), max(places))


def load_balanced_engine(name: str, *, beside: Path | None = None) -> BalancedEngine:
    """Engine and balance data from a shipped file of ``pipeline/engines`` or a user's TOML file.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which that path is tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault of its content.
    """
    table, source, faults = engine_table(name, beside)
    return balanced_engine(table, name=Path(name).stem, source=source, faults=faults)


def balanced_engine(
    table: Mapping[str, object], *, name: str, source: str, faults: Sequence[CrankorderError] = ()
) -> BalancedEngine:
    """Engine and balance data from the content of an engine file.

    ``table``: content, as TOML gives it. ``name``: of the engine. ``source``: what errors call the file. ``faults``:
    found before, told with those of the content. Raises ManyErrors that lists every fault.
    """
    faults = list(faults)
    engine = validated(Engine, {key: value for key, value in table.items() if key != TABLE}, source, faults)
    balance = validated(BalanceData, table.get(TABLE, {}), source, faults, (TABLE,))
    if engine is not None and balance is not None and balance.train is not None:
        faults += _disagreements(engine, balance.train, source)
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
            with located(source):
                question()
        except RequestError as error:
            faults.append(error)
    return faults


def _disagreements(engine: Engine, train: CrankTrain, source: str) -> list[CrankorderError]:
    """Faults where the parts of the crank train do not add up to the masses and lengths of the engine."""
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
