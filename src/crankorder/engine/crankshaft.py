"""Balance of the crankshaft to itself: static and dynamic sums, rocking couple, two planes, counterweights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from crankorder.engine.definition import EngineData, NonNegative
from crankorder.errors import RequestError


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


@dataclass(frozen=True, kw_only=True)
class CrankshaftSums:
    """Unbalance of the whole shaft (kg·mm) and its moment about the datum (kg·mm²), each as x + iy."""

    static_kg_mm: complex
    dynamic_kg_mm2: complex


@dataclass(frozen=True, kw_only=True)
class FanCounterweight:
    """A counterweight shaped as a fan: outer and inner radius, thickness (mm), full fan angle (deg), density."""

    radius_mm: float
    thickness_mm: float
    fan_angle_deg: float
    density_kg_m3: float
    inner_radius_mm: float = 0.0

    def __post_init__(self) -> None:
        sizes = (self.radius_mm, self.thickness_mm, self.density_kg_m3)
        if not (
            all(math.isfinite(size) and size > 0 for size in sizes)
            and 0 < self.fan_angle_deg < 360
            and 0 <= self.inner_radius_mm < self.radius_mm
        ):
            raise RequestError(
                "no such counterweight",
                found=f"radii {self.inner_radius_mm} to {self.radius_mm} mm, thickness {self.thickness_mm} mm, "
                f"fan {self.fan_angle_deg}°, density {self.density_kg_m3} kg/m³",
                allowed="positive sizes, a fan angle below 360°, an inner radius below the outer",
            )

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


def crankshaft_sums(sections: Sequence[CrankshaftSection]) -> CrankshaftSums:
    """Static and dynamic sums of a crankshaft.

    ``sections``: its parts, the bob weight on the pin among them. Both sums must vanish for a shaft in balance; the
    dynamic one depends on the datum unless the static one vanishes. Source: Ruckle 2014, equations (5) to (8), table 2.
    """
    arms = [section.mass_kg * complex(section.x_mm, section.y_mm) for section in sections]
    return CrankshaftSums(
        static_kg_mm=sum(arms, 0j),
        dynamic_kg_mm2=sum((arm * section.z_mm for arm, section in zip(arms, sections, strict=True)), 0j),
    )


def about_datum(sums: CrankshaftSums, datum_mm: float) -> CrankshaftSums:
    """The sums counted from another datum.

    ``sums``: from the first datum. ``datum_mm``: place of the new one along the axis, from the first.
    """
    moved = sums.dynamic_kg_mm2 - datum_mm * sums.static_kg_mm
    return CrankshaftSums(static_kg_mm=sums.static_kg_mm, dynamic_kg_mm2=moved)


def couple_n_m(dynamic_kg_mm2: complex, speed_rpm: ArrayLike) -> NDArray[np.float64]:
    """Rocking couple (N·m) that turns with the shaft.

    ``dynamic_kg_mm2``: dynamic sum, x + iy. ``speed_rpm``: scalar or any shape; the result has that shape.
    """
    omega = np.asarray(speed_rpm, dtype=np.float64) * (np.pi / 30)
    couple: NDArray[np.float64] = 1e-6 * abs(dynamic_kg_mm2) * omega**2
    return couple


def two_plane_correction(sums: CrankshaftSums, planes_mm: tuple[float, float]) -> tuple[complex, complex]:
    """Unbalance (kg·mm, x + iy) to add in each of two planes so that both sums vanish.

    ``sums``: static and dynamic. ``planes_mm``: places of the planes along the axis, from the datum of the sums.
    Raises RequestError where the planes coincide.
    """
    first, second = planes_mm
    if first == second:
        raise RequestError("two planes are needed", found=f"both at {first} mm")
    in_second = (first * sums.static_kg_mm - sums.dynamic_kg_mm2) / (second - first)
    return -sums.static_kg_mm - in_second, in_second


def slug_unbalance_kg_mm(
    *, diameter_mm: float, length_mm: float, radius_mm: float, slug_density_kg_m3: float, crank_density_kg_m3: float
) -> float:
    """Unbalance (kg·mm) that a heavy slug adds to the counterweight that it is pressed into.

    ``diameter_mm``, ``length_mm``: of the round slug, > 0. ``radius_mm``: of its centre from the crankshaft's axis.
    ``slug_density_kg_m3``, ``crank_density_kg_m3``: the slug takes the place of crank metal, so the difference counts.
    Source: Ruckle 2014, section 3.1.1.
    """
    volume_mm3 = math.pi / 4 * diameter_mm**2 * length_mm
    return 1e-9 * volume_mm3 * (slug_density_kg_m3 - crank_density_kg_m3) * radius_mm
