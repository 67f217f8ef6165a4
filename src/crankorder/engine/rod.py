"""The connecting rod as two masses, cut in a drawing or weighed at its pins, and the couple that two masses miss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationInfo, computed_field, field_validator

from crankorder.engine.definition import Engine, EngineData, Positive
from crankorder.engine.slider_crank import rod_angle


@dataclass(frozen=True, kw_only=True)
class TwoMasses:
    """A rod as a mass at the big end, one at the small end, and the moment of inertia that these two miss.

    ``missing_inertia_kg_m2`` is J − m a b, a and b the distances of the centre of gravity from the ends: negative for
    most rods, whose mass lies between their ends.
    """

    big_end_kg: float
    small_end_kg: float
    missing_inertia_kg_m2: float


def two_masses(engine: Engine) -> TwoMasses:
    """The rod of ``engine`` in two masses with the same centre of gravity: exact for forces, whatever its inertia.

    Without a rod in the data all is zero (its shares are then only in the engine's sums); without its inertia nothing
    is missing. Source: truth sheet sections 1 and 2.7.
    """
    rod = engine.rod
    if rod is None:
        return TwoMasses(big_end_kg=0.0, small_end_kg=0.0, missing_inertia_kg_m2=0.0)
    small = rod.mass_kg * rod.centre_from_big_end_m / engine.rod_length_m
    of_two = small * engine.rod_length_m * (engine.rod_length_m - rod.centre_from_big_end_m)
    missing = 0.0 if rod.inertia_kg_m2 is None else rod.inertia_kg_m2 - of_two
    return TwoMasses(big_end_kg=rod.mass_kg - small, small_end_kg=small, missing_inertia_kg_m2=missing)


def rod_couple(engine: Engine, crank_angle_rev: ArrayLike, speed_rpm: float) -> NDArray[np.float64]:
    """Couple (N·m) on a rod, in the crank's sense, that its true inertia needs beyond that of its two masses.

    ``engine``: with ``rod``. ``crank_angle_rev``: of its own crank, any shape. ``speed_rpm``: steady. Returns the shape
    of the angles. Source: truth sheet 2.7, (J − m a b) times the rod's angular acceleration −ψ'' ω².
    """
    omega = speed_rpm * np.pi / 30
    _, _, second = rod_angle(crank_angle_rev, engine.mechanism)
    return -two_masses(engine).missing_inertia_kg_m2 * omega**2 * second


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
        made = {"cut": self.cut, "scale": self.scale}
        if self.on_pin is not None:
            fraction = self.on_pin.centre_from_big_end_mm / self.on_pin.rod_length_mm
            small_g = self.on_pin.mass_g * fraction
            made["on pin"] = RodSplit(big_end_g=self.on_pin.mass_g - small_g, small_end_g=small_g)
        return made


def two_mass_inertia_g_mm2(split: RodSplit, rod_length_mm: float) -> float:
    """Moment of inertia (g·mm²) about the centre of gravity that two masses at the pins have.

    ``split``: the masses. ``rod_length_mm``: distance of the pins. The rod's own differs from it; the difference makes
    a couple and no force. Source: truth sheet 2.7.
    """
    return split.big_end_g * split.small_end_g / split.total_g * rod_length_mm**2
