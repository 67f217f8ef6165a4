"""An engine with elastic hinges as data: its torque curve and its mechanisms, read from a TOML file."""

from __future__ import annotations

import math
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, ValidationInfo, field_validator

from crankorder.engine.crank_torque import CrankTorque, TorqueBranch
from crankorder.engine.definition import EngineData, NonNegative, Positive
from crankorder.engine.hinged_crank import HingedCrank, slender_rod_inertia
from crankorder.engine.slider_crank import SliderCrank
from crankorder.errors import ManyErrors
from crankorder.settings import toml_table, validation_fault


class TorqueBranchData(EngineData):
    """Nodes of one branch of the torque curve: crank angles in degrees, torques in N·m."""

    angle_deg: tuple[float, ...] = Field(strict=False)
    torque_nm: tuple[float, ...] = Field(strict=False)

    # As in definition.py: one check a field, on what comes before it.

    @field_validator("angle_deg")
    @classmethod
    def _rises(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) < 2 or any(after <= before for before, after in pairwise(value)):
            raise ValueError("a branch of a torque curve needs two or more rising angles")
        return value

    @field_validator("torque_nm")
    @classmethod
    def _as_many_as_angles(cls, value: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        angles = info.data.get("angle_deg")
        if angles is not None and len(value) != len(angles):
            raise ValueError(f"must have one torque for each of the {len(angles)} crank angles")
        return value

    @cached_property
    def branch(self) -> TorqueBranch:
        """The branch as the model needs it."""
        return TorqueBranch(angle_deg=self.angle_deg, torque_nm=self.torque_nm)


class HingedCrankData(EngineData):
    """One mechanism of a file; its fields are those of :class:`crankorder.engine.hinged_crank.HingedCrank`.

    Where ``rod_inertia_kg_m2`` is left out the rod is taken as uniform and slender. ``speeds_rad_s``: crank speeds that
    it is meant to run at.
    """

    name: Annotated[str, Field(min_length=1)]
    crank_radius_m: Positive
    pin_to_rod_centre_m: NonNegative
    rod_centre_to_piston_m: NonNegative
    rod_weight_n: NonNegative
    piston_weight_n: NonNegative
    rod_inertia_kg_m2: NonNegative | None = None
    rod_counterweight_n: NonNegative = 0.0
    rod_counterweight_radius_m: NonNegative = 0.0
    crank_weight_n: NonNegative = 0.0
    crank_centre_radius_m: NonNegative = 0.0
    crank_inertia_kg_m2: NonNegative = 0.0
    crank_counterweight_n: NonNegative = 0.0
    crank_counterweight_radius_m: NonNegative = 0.0
    gravity_m_s2: Positive = 9.81
    speeds_rad_s: tuple[Positive, ...] = Field(default=(), strict=False)

    @field_validator("rod_centre_to_piston_m")
    @classmethod
    def _rod_reaches(cls, value: float, info: ValidationInfo) -> float:
        radius_m, to_centre_m = info.data.get("crank_radius_m"), info.data.get("pin_to_rod_centre_m")
        if radius_m is not None and to_centre_m is not None:
            SliderCrank(crank_radius_m=radius_m, rod_length_m=to_centre_m + value)
        return value

    @cached_property
    def crank(self) -> HingedCrank:
        """The mechanism as the model needs it."""
        values = self.model_dump(exclude={"name", "speeds_rad_s"})
        if self.rod_inertia_kg_m2 is None:
            length_m = self.pin_to_rod_centre_m + self.rod_centre_to_piston_m
            inertia = slender_rod_inertia(self.rod_weight_n, length_m, gravity_m_s2=self.gravity_m_s2)
            values["rod_inertia_kg_m2"] = inertia
        return HingedCrank(**values)

    @property
    def speeds_rpm(self) -> tuple[float, ...]:
        """Crank speeds in revolutions per minute."""
        return tuple(speed * 30 / math.pi for speed in self.speeds_rad_s)


class HingedEngine(EngineData):
    """A torque curve and the mechanisms that it drives."""

    kind: Literal["elastic-hinge"]
    title: str = ""
    torque: tuple[TorqueBranchData, ...] = Field(strict=False)
    mechanisms: tuple[HingedCrankData, ...] = Field(strict=False)

    @field_validator("torque")
    @classmethod
    def _closes(cls, value: tuple[TorqueBranchData, ...]) -> tuple[TorqueBranchData, ...]:
        CrankTorque(branches=tuple(branch.branch for branch in value))
        return value

    @field_validator("mechanisms")
    @classmethod
    def _names_differ(cls, value: tuple[HingedCrankData, ...]) -> tuple[HingedCrankData, ...]:
        names = [mechanism.name for mechanism in value]
        if not names:
            raise ValueError("an engine with elastic hinges needs at least one [[mechanisms]]")
        if len(set(names)) < len(names):
            raise ValueError(f"two mechanisms bear one name: {', '.join(names)}")
        return value

    @cached_property
    def curve(self) -> CrankTorque:
        """The torque curve as the model needs it."""
        return CrankTorque(branches=tuple(branch.branch for branch in self.torque))

    @cached_property
    def cranks(self) -> dict[str, HingedCrank]:
        """The mechanisms as the model needs them, by name."""
        return {mechanism.name: mechanism.crank for mechanism in self.mechanisms}


def load_hinged_engine(name: str, beside: Path | None = None) -> HingedEngine:
    """Torque curve and mechanisms from a shipped file of ``pipeline/engines`` or a user's TOML file.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which that path is tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault of its content.
    """
    table, source = toml_table(name, "engines", beside=beside)
    try:
        return HingedEngine.model_validate(table)
    except ValidationError as error:
        raise ManyErrors([validation_fault(fault, source) for fault in error.errors()]) from None
