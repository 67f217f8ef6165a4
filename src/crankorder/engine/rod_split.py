"""Connecting rod as two masses: cut in a drawing at its centre of gravity, or weighed at its pins; what both imply."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from crankorder.engine.definition import EngineData, Positive
from crankorder.engine.harmonics import acceleration_harmonics
from crankorder.engine.slider_crank import SliderCrank


class RodSplit(EngineData):
    """Masses (g) of the big and the small end of a rod, as one method divides them."""

    big_end_g: Positive
    small_end_g: Positive

    @property
    def total_g(self) -> float:
        """Mass of the whole rod."""
        return self.big_end_g + self.small_end_g

    @property
    def centroid_fraction(self) -> float:
        """Place of the centre of gravity that the two masses imply: distance from the big end over rod length."""
        return self.small_end_g / self.total_g


class RodSplits(EngineData):
    """The same rod divided twice: by a cut through its centre of gravity in a drawing, and by a scale at its pins."""

    cut: RodSplit
    scale: RodSplit
    weighed_whole_g: Annotated[float, Field(gt=0)] | None = None


@dataclass(frozen=True, kw_only=True)
class CutConsequences:
    """What remains unbalanced if crankshaft and shafts are built for the cut while the rod acts as weighed (g, g·mm).

    ``rotating_deficit_g``: what the crankshaft's counterweights lack. ``reciprocating_excess_g``: what the shafts have
    too much. ``x_first_g_mm``: along the cylinder, where both nearly cancel; ``y_first_g_mm``: across it;
    ``x_second_g_mm``: second order, overbalanced.
    """

    centroid_shift_mm: float
    rotating_deficit_g: float
    reciprocating_excess_g: float
    x_first_g_mm: float
    y_first_g_mm: float
    x_second_g_mm: float


def split_by_scale(*, rod_mass_g: float, centroid_fraction: float) -> RodSplit:
    """The split that a scale under each pin shows; it keeps mass and centre of gravity, so every force is right.

    ``rod_mass_g``: whole rod, > 0. ``centroid_fraction``: distance of the centre of gravity from the big end over rod
    length, 0 … 1.
    """
    small = rod_mass_g * centroid_fraction
    return RodSplit(big_end_g=rod_mass_g - small, small_end_g=small)


def two_mass_inertia_g_mm2(split: RodSplit, rod_length_mm: float) -> float:
    """Moment of inertia (g·mm²) about the centre of gravity that two masses at the pins have.

    ``split``: the masses. ``rod_length_mm``: distance of the pins. The rod's own differs from it; the difference makes
    a couple and no force. Source: truth sheet 2.7.
    """
    return split.big_end_g * split.small_end_g / split.total_g * rod_length_mm**2


def cut_consequences(splits: RodSplits, mechanism: SliderCrank) -> CutConsequences:
    """What a crankshaft and balance shafts built for the cut leave, the rod acting as the scale shows it.

    ``splits``: both divisions of the rod. ``mechanism``: lengths in metres.
    Source: truth sheet 2.7, on Ruckle 2014, section 3.3.1. A cut through the centre of gravity keeps the
    mass of the rod but, put at the pins, moves its centre of gravity.
    """
    radius_mm = mechanism.crank_radius_m * 1e3
    deficit = splits.scale.big_end_g - splits.cut.big_end_g
    excess = splits.cut.small_end_g - splits.scale.small_end_g
    second = abs(acceleration_harmonics(mechanism, 2)[2])
    return CutConsequences(
        centroid_shift_mm=(splits.cut.centroid_fraction - splits.scale.centroid_fraction)
        * mechanism.rod_length_m
        * 1e3,
        rotating_deficit_g=deficit,
        reciprocating_excess_g=excess,
        x_first_g_mm=(deficit - excess) * radius_mm,
        y_first_g_mm=deficit * radius_mm,
        x_second_g_mm=excess * radius_mm * second,
    )
