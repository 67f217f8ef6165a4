"""Balance of the crankshaft to itself: its parts from a file, static and dynamic sums, rocking couple, two planes.

Counterweights are sections by mass and centre of gravity, or fans by radius, thickness and fan angle; slugs of a
heavier metal sit in them. Source: Ruckle 2014, section 3.1.1, table 2 and figure 12.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from crankorder.engine.forces import newton
from crankorder.engine.machine_parts import NOT_EMPTY, EngineData, NonNegative, Positive


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
        return CrankshaftSection(
            name=self.name, mass_kg=self.mass_kg, x_mm=centre.real, y_mm=centre.imag, z_mm=self.z_mm
        )

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
        return {
            (weight if isinstance(weight, str) else weight.name): (
                by_name[weight] if isinstance(weight, str) else weight.z_mm
            )
            for weight in self.counterweights
        }

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


def crankshaft_sums(sections: Sequence[CrankshaftSection]) -> tuple[complex, complex]:
    """Static (kg·mm) and dynamic (kg·mm²) sum of a crankshaft, each as x + iy; the second about the datum.

    ``sections``: its parts, the bob weight on the pin among them. Both sums must vanish for a shaft in balance; the
    dynamic one depends on the datum unless the static one vanishes. Source: Ruckle 2014, equations (5) to (8), table 2.
    """
    arms = [section.mass_kg * complex(section.x_mm, section.y_mm) for section in sections]
    return sum(arms, 0j), sum((arm * section.z_mm for arm, section in zip(arms, sections, strict=True)), 0j)


def two_plane_correction(sums: tuple[complex, complex], planes_mm: tuple[float, float]) -> tuple[complex, complex]:
    """Unbalance (kg·mm, x + iy) to add in each of two planes so that both sums vanish.

    ``sums``: static and dynamic. ``planes_mm``: places of the planes along the axis, from the datum of the sums; not
    the same.
    """
    (static, dynamic), (first, second) = sums, planes_mm
    in_second = (first * static - dynamic) / (second - first)
    return -static - in_second, in_second


def _axes(amount: complex) -> dict[str, float]:
    return {"x": amount.real, "y": amount.imag}


def _sums(sections: Sequence[CrankshaftSection]) -> dict[str, dict[str, float]]:
    static, dynamic = crankshaft_sums(sections)
    return {"static_kg_mm": _axes(static), "dynamic_kg_mm2": _axes(dynamic)}


def crankshaft_balance(
    data: CrankshaftData, speeds: Mapping[str, float], *, big_ends_g: Mapping[str, float]
) -> dict[str, Any]:
    """Balance of the crankshaft ``data`` by itself, as the balance sheet has it.

    ``speeds``: crank speeds (rpm) by the text that names each. ``big_ends_g``: masses of the rod's big end (g) by the
    method that gave each; every one is put in the place of the bob weight, if there is one.
    Source: Ruckle 2014, table 2.
    """
    static, dynamic = sums = crankshaft_sums(data.parts)
    towards, wanted = -static.imag, data.overbalance_kg_mm
    (first, first_mm), *_, (last, last_mm) = data.places.items()
    at_first, at_last = two_plane_correction(sums, (first_mm, last_mm))
    return {
        "sections": [part.model_dump() | _sums([part]) for part in data.parts],
        **_sums(data.parts),
        "couple_Nm_at_rpm": {key: newton(abs(dynamic), speed_rpm) for key, speed_rpm in speeds.items()},
        "planes": [_plane(data, first, at_first), _plane(data, last, at_last)],
        "overbalance_kg_mm": None if wanted is None else list(wanted),
        "overbalanced_by_kg_mm": towards,
        "overbalance_met": None if wanted is None else wanted[0] <= towards <= wanted[1],
        "bob_weights": _bob_weights(data, big_ends_g),
    }


def _plane(data: CrankshaftData, name: str, added: complex) -> dict[str, Any]:
    """The first or the last counterweight: its unbalance, slugs included, and the one that balances the crankshaft."""
    has, _ = crankshaft_sums([part for part in data.parts if part.name in (name, f"Slug in {name}")])
    fan, sizes = data.fans.get(name), None
    if fan is not None:
        slugs = has - crankshaft_sums([fan.section])[0]
        names = ("mass_kg", "centroid_mm", "unbalance_kg_mm", "sensitivity")
        sizes = {key: getattr(fan, key) for key in names} | {"resized": fan.resized(abs(has + added - slugs))}
    amounts = {"has_kg_mm": has, "correction_kg_mm": added, "needs_kg_mm": has + added}
    by_axis = {key: _axes(amount) for key, amount in amounts.items()}
    return {"name": name, "z_mm": data.places[name], **by_axis, "fan": sizes}


def _bob_weights(data: CrankshaftData, big_ends_g: Mapping[str, float]) -> list[dict[str, Any]] | None:
    """Sums of the crankshaft by mass of the rod's big end in the place of its bob weight, the stated one first."""
    if data.bob_weight is None:
        return None
    bob = next(part for part in data.parts if part.name == data.bob_weight)
    others = [part for part in data.parts if part is not bob]
    masses_kg = {"stated": bob.mass_kg, **{method: 1e-3 * grams for method, grams in big_ends_g.items()}}
    return [
        {"method": method, "mass_kg": mass_kg, **_sums([*others, bob.model_copy(update={"mass_kg": mass_kg})])}
        for method, mass_kg in masses_kg.items()
    ]
