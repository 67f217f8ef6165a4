"""The engine as data: lengths, masses, balance shafts and bearings, read from a TOML file."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from crankorder.engine.bearings import Bearing
from crankorder.engine.slider_crank import SliderCrank
from crankorder.errors import ManyErrors
from crankorder.settings import toml_table, validation_fault

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class EngineData(BaseModel):
    """Base of everything that an engine file may hold: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class BalanceShafts(EngineData):
    """Pairs of counter-rotating shafts: which orders of the reciprocating force they cancel and the mass they leave.

    ``timed_to = "force"``: each pair stands against the whole force of its order, the quadrature part that an offset
    makes included. ``"crank"``: the pair is timed to the crank and leaves that part.
    """

    orders: tuple[Annotated[int, Field(ge=1)], ...] = Field(strict=False)
    unbalanced_mass_kg: float = 0.0
    timed_to: Literal["force", "crank"] = "force"


class Engine(EngineData):
    """A single-cylinder engine as the model needs it; lengths in m, masses in kg, angles in degrees of crank."""

    title: str = ""
    cycle: Literal["four-stroke", "two-stroke", "rotor"] = "four-stroke"
    crank_radius_m: Positive
    rod_length_m: Positive
    offset_m: float = 0.0
    reciprocating_mass_kg: NonNegative
    rotating_unbalance_kg_m: NonNegative = 0.0
    rotating_unbalance_deg: float = 0.0
    shafts: BalanceShafts = BalanceShafts(orders=())
    bearings: tuple[Bearing, ...] = Field(default=(), strict=False)

    @model_validator(mode="after")
    def _rod_reaches(self) -> Self:
        if self.rod_length_m <= self.crank_radius_m + abs(self.offset_m):
            raise ValueError("rod_length_m must exceed crank_radius_m and offset_m together: the crank could not turn")
        return self

    @cached_property
    def mechanism(self) -> SliderCrank:
        """Lengths of the crank mechanism alone."""
        return SliderCrank(crank_radius_m=self.crank_radius_m, rod_length_m=self.rod_length_m, offset_m=self.offset_m)


def load_engine(name: str, beside: Path | None = None) -> Engine:
    """Engine from a shipped file of ``pipeline/engines`` or a user's TOML file.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which that path is tried first.
    Raises RequestError where there is no such file, ManyErrors with every fault of its content.
    """
    table, source = toml_table(name, "engines", beside=beside)
    try:
        return Engine.model_validate(table)
    except ValidationError as error:
        raise ManyErrors([validation_fault(fault, source) for fault in error.errors()]) from None
