"""What every scene has: sampling, speeds, sensors and the structure between forces and sensors."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from crankorder.engine.forces import DIRECTIONS

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_+. -]{1,40}$")]
DatasetName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,39}$")]
Axis = Literal["X", "Y", "Z", "RX", "RY", "RZ"]
ByChannel = dict[str, float]
ByAxis = dict[Axis, float]

AXES: tuple[Axis, ...] = (*DIRECTIONS, "RX", "RY", "RZ")
"""What acts on the crankcase: forces along X, Y, Z (N), then moments about them (N·m)."""


class Part(BaseModel):
    """Base of every part of a scene file: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class TimeSampling(Part):
    """Samples at a fixed rate."""

    domain: Literal["time"]
    rate_hz: Positive
    duration_s: Positive


class CrankAngleSampling(Part):
    """Samples at fixed crank angles, the first at top dead centre.

    ``folds``: lines above half the samples per revolution are wanted, to fold as they do without a filter.
    """

    domain: Literal["crank_angle"]
    samples_per_rev: Annotated[int, Field(ge=4)]
    revs: Annotated[int, Field(ge=1)]
    folds: bool = False


class Speeds(Part):
    """Constant speeds, one recording each: a list, or first, last and step."""

    list_rpm: tuple[Positive, ...] | None = Field(default=None, strict=False)
    first_rpm: Positive | None = None
    last_rpm: Positive | None = None
    step_rpm: Positive | None = None

    @model_validator(mode="after")
    def _one_way_of_saying_it(self) -> Self:
        steps = (self.first_rpm, self.last_rpm, self.step_rpm)
        if (self.list_rpm is None) == (None in steps) or (self.list_rpm is not None and any(steps)):
            raise ValueError("give either list_rpm or first_rpm, last_rpm and step_rpm")
        if not 1 <= len(self.rpm) <= 10_000:
            raise ValueError("there must be 1 to 10 000 speeds")
        return self

    @property
    def rpm(self) -> tuple[float, ...]:
        """Every speed, in the sequence of the recordings."""
        if self.list_rpm is not None:
            return self.list_rpm
        first, last, step = self.first_rpm or 0.0, self.last_rpm or 0.0, self.step_rpm or 1.0
        if last < first:
            return ()
        steps = int(min((last - first) / step + 1e-9, 10_000))
        return tuple(first + step * k for k in range(steps + 1))


class SpeedProfile(Part):
    """One recording whose speed runs straight from corner to corner: run-up, coast-down, standstill, reversal.

    ``rpm``: speed at each corner; negative is backwards. Either ``time_s``, the time of each corner from the first
    sample, or ``rpm_per_s``, the rate of change between them, with ``hold_s`` at each. Before the first and after the
    last corner the speed stays; corners are taken to the nearest sample.
    """

    rpm: tuple[float, ...] = Field(min_length=2, strict=False)
    time_s: tuple[NonNegative, ...] | None = Field(default=None, strict=False)
    rpm_per_s: Positive | None = None
    hold_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _one_way_of_saying_it(self) -> Self:
        if (self.time_s is None) == (self.rpm_per_s is None):
            raise ValueError("give either time_s or rpm_per_s")
        if self.time_s is not None and len(self.time_s) != len(self.rpm):
            raise ValueError("time_s must have one time for each of rpm")
        if self.time_s is not None and any(after <= before for before, after in pairwise(self.time_s)):
            raise ValueError("time_s must ascend")
        if self.rpm_per_s is not None and any(after == before for before, after in pairwise(self.rpm)):
            raise ValueError("with rpm_per_s every speed must differ from the one before")
        return self

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Time (s) and speed (rpm) of every corner, times ascending."""
        if self.time_s is not None:
            return tuple(zip(self.time_s, self.rpm, strict=True))
        assert self.rpm_per_s is not None  # checked above
        corners, now = [], 0.0
        for number, rpm in enumerate(self.rpm):
            now += abs(rpm - self.rpm[number - 1]) / self.rpm_per_s if number else 0.0
            corners.append((now, rpm))
            if self.hold_s:
                now += self.hold_s
                corners.append((now, rpm))
        return tuple(corners)


class Quick(Part):
    """What a first look has less of."""

    speeds: Speeds | None = None
    speed_profile: SpeedProfile | None = None
    duration_s: Positive | None = None
    revs: Annotated[int, Field(ge=1)] | None = None
    repeats: Annotated[int, Field(ge=1)] | None = None


class Channel(Part):
    """An accelerometer: its name, its dataset in the files, and its direction."""

    name: Name
    source: DatasetName
    direction: Annotated[str, Field(pattern=r"^[+-]?[XYZ]$")]


class Mode(Part):
    """A mode between forces and moments (``drive``, by axis) and sensors (``sensor_per_kg``, by channel).

    ``sensor_phase_deg`` turns the residue of a channel: 0 for a real mode, anything for a complex one. The residue of a
    moment is per N·m: its drive is in 1/m.
    """

    frequency_hz: Positive
    damping_ratio: Annotated[float, Field(gt=0, lt=1)]
    sensor_per_kg: ByChannel
    sensor_phase_deg: ByChannel = Field(default_factory=dict)
    drive: ByAxis


class OtherShaft(Part):
    """A shaft beside the crankshaft: at a ``ratio`` to it, or with a speed of its own.

    ``rpm`` is a constant speed, or the speeds at the corners ``time_s`` as in a speed profile.
    """

    name: Name
    ratio: Positive | None = None
    rpm: tuple[Positive, ...] | None = Field(default=None, min_length=1, strict=False)
    time_s: tuple[NonNegative, ...] | None = Field(default=None, strict=False)

    @model_validator(mode="after")
    def _one_way_of_saying_it(self) -> Self:
        if (self.ratio is None) == (self.rpm is None):
            raise ValueError("give either ratio or rpm")
        if self.rpm is not None and len(self.rpm) > 1:
            if self.time_s is None or len(self.time_s) != len(self.rpm):
                raise ValueError("time_s must have one time for each of rpm")
            if any(after <= before for before, after in pairwise(self.time_s)):
                raise ValueError("time_s must ascend")
        elif self.time_s is not None:
            raise ValueError("time_s goes with two or more of rpm")
        return self
