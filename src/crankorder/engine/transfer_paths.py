"""Stated paths from force to acceleration, and masses that were added on purpose: data that make amplitudes forces."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Direction = Literal["X", "Y", "Z"]


class _Stated(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class PathMode(_Stated):
    """One mode of a stated path: its natural frequency, damping ratio and residue (1/kg) in h = −x²/(1 − x² + 2iζx)."""

    frequency_hz: Positive = Field(description="Natural frequency.", examples=[60.0])
    damping_ratio: Annotated[float, Field(gt=0, lt=1)] = Field(description="Damping ratio.", examples=[0.02])
    residue_per_kg: float = Field(description="Real part of the residue, in 1/kg.", examples=[0.003])
    residue_imag_per_kg: float = Field(
        default=0.0, description="Imaginary part of the residue, in 1/kg.", examples=[0.0001]
    )


class StatedPath(_Stated):
    """``[[transfer_paths]]``: acceleration of a channel per force (accelerance, 1/kg) on the crankcase at the crank.

    ``channel`` is the channel's name; ``direction`` that of the force: X across the crankshaft, Y along it, Z along the
    cylinder. One of three forms: ``apparent_mass_kg``, a rigid body; ``modes`` with ``rigid_per_kg``; or ``table``, a
    CSV file beside the manifest with the columns frequency_hz, real, imag (1/kg), whose rows are ``points`` once it is
    read. It holds within ``frequency_range_hz`` (needed but for a table), to ``uncertainty_percent`` (95 %).
    """

    channel: Annotated[str, Field(min_length=1)] = Field(
        description="Name of a channel of acceleration.", examples=["Z"]
    )
    direction: Direction = Field(
        description="Direction of the force on the crankcase: X across, Y along the crankshaft, Z along the cylinder.",
        examples=["Z"],
    )
    apparent_mass_kg: Positive | None = Field(
        default=None, description="Force per acceleration of a rigid body; one of three forms.", examples=[330.0]
    )
    table: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="CSV file beside the manifest, columns frequency_hz, real, imag (1/kg); one of three forms.",
        examples=["path_z.csv"],
    )
    points: tuple[tuple[float, float, float], ...] = Field(
        default=(), strict=False, description="Rows of that table once it is read; never stated."
    )
    modes: tuple[PathMode, ...] = Field(
        default=(),
        strict=False,
        description="Modes of the path; one of three forms.",
        examples=[[{"frequency_hz": 60.0, "damping_ratio": 0.02, "residue_per_kg": 0.003}]],
    )
    rigid_per_kg: float = Field(default=0.0, description="What is added to the modes, in 1/kg.", examples=[0.002])
    frequency_range_hz: tuple[NonNegative, Positive] | None = Field(
        default=None, strict=False, description="Where the path holds; needed but for a table.", examples=[[5.0, 40.0]]
    )
    uncertainty_percent: NonNegative = Field(
        default=0.0, description="Half width of the 95 % interval of the path, in % of it.", examples=[3.0]
    )

    @model_validator(mode="after")
    def _one_form(self) -> StatedPath:
        tabled = self.table is not None or bool(self.points)
        forms = [self.apparent_mass_kg is not None, tabled, bool(self.modes)]
        if sum(forms) != 1:
            raise ValueError("a path is one of apparent_mass_kg, table or modes")
        if self.rigid_per_kg and not self.modes:
            raise ValueError("rigid_per_kg goes with modes; a rigid body alone is apparent_mass_kg")
        if not tabled and self.frequency_range_hz is None:
            raise ValueError("frequency_range_hz must say where the path holds, such as [5.0, 50.0]")
        if self.frequency_range_hz is not None and self.frequency_range_hz[0] >= self.frequency_range_hz[1]:
            raise ValueError("frequency_range_hz must ascend")
        if any(after[0] <= before[0] for before, after in pairwise(self.points)) or len(self.points) == 1:
            raise ValueError("a table needs two or more rows with ascending frequency_hz")
        return self

    @property
    def holds_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency (Hz) at which the path may be used."""
        low, high = self.frequency_range_hz or (0.0, float("inf"))
        if self.points:
            return max(low, self.points[0][0]), min(high, self.points[-1][0])
        return low, high


class AddedMass(_Stated):
    """``[[added_masses]]``: a known mass that this test has and the test that it is compared with has not.

    ``on``: "crank", what turns with the shaft at ``radius_mm`` and ``angle_deg`` (from where the crank pin of cylinder
    0 points, in the sense of rotation), or "piston", what goes up and down with the piston of the cylinder numbered
    ``cylinder``. ``mass_g`` is below 0 where mass was taken away.
    """

    mass_g: float = Field(description="Mass in g; below 0 where some was taken away; not 0.", examples=[100.0])
    on: Literal["crank", "piston"] = Field(
        default="crank", description="What carries it: the turning crank or the piston.", examples=["piston"]
    )
    radius_mm: Positive | None = Field(
        default=None, description="Distance from the shaft's axis; needed on the crank.", examples=[60.0]
    )
    angle_deg: float = Field(
        default=0.0,
        description="From where the crank pin of cylinder 0 points, in the sense of rotation.",
        examples=[180.0],
    )
    cylinder: Annotated[int, Field(ge=0)] = Field(
        default=0, description="Number of the cylinder whose piston carries it, from 0.", examples=[0]
    )

    @model_validator(mode="after")
    def _has_a_radius(self) -> AddedMass:
        if self.mass_g == 0:
            raise ValueError("a mass of 0 g tells nothing")
        if self.on == "crank" and self.radius_mm is None:
            raise ValueError("a mass on the crank needs radius_mm")
        if self.on == "piston" and (self.radius_mm is not None or self.angle_deg):
            raise ValueError("a mass on the piston has neither radius_mm nor angle_deg")
        return self
