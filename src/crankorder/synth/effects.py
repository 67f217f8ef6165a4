"""The parts that a scene is made of: sampling, speeds, sensors, and one class per effect."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
ChannelName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_+. -]{1,40}$")]
DatasetName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,39}$")]
Direction = Literal["X", "Y", "Z"]
ByChannel = dict[str, float]
ByDirection = dict[Direction, float]


class Part(BaseModel):
    """Base of every part of a scene file: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class TimeSampling(Part):
    """Samples at a fixed rate."""

    domain: Literal["time"]
    rate_hz: Positive
    duration_s: Positive


class CrankAngleSampling(Part):
    """Samples at fixed crank angles, the first at top dead centre."""

    domain: Literal["crank_angle"]
    samples_per_rev: Annotated[int, Field(ge=4)]
    revs: Annotated[int, Field(ge=1)]


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
        steps = min(int((last - first) / step + 1e-9), 10_000)
        return tuple(first + step * k for k in range(steps + 1))


class Quick(Part):
    """What a first look has less of."""

    speeds: Speeds | None = None
    duration_s: Positive | None = None
    revs: Annotated[int, Field(ge=1)] | None = None


class Channel(Part):
    """An accelerometer: its name, its dataset in the files, and its direction."""

    name: ChannelName
    source: DatasetName
    direction: Annotated[str, Field(pattern=r"^[+-]?[XYZ]$")]


class Mode(Part):
    """A mode between forces (``drive``, per direction) and sensors (``sensor_per_kg``, per channel)."""

    frequency_hz: Positive
    damping_ratio: Annotated[float, Field(gt=0, lt=1)]
    sensor_per_kg: ByChannel
    drive: ByDirection


class EngineForces(Part):
    """Forces of the engine's moving masses, to the order that the tolerance (relative to the peak) needs."""

    tolerance: Annotated[float, Field(ge=1e-16, le=1)]


class InjectedOrder(Part):
    """A force at an order that the crank mechanism does not make; it grows with a power of speed."""

    order: Positive
    direction: Direction
    force_n: NonNegative
    at_speed_rpm: Positive
    speed_exponent: float = 2.0
    phase_deg: float = 0.0
    cause: Annotated[str, Field(max_length=60)] = "injected"


class BearingLine(Part):
    """A line of one of the engine's bearings: the same response at every speed, its phase by chance per recording."""

    bearing: str
    line: Literal["N*fs", "BPFO", "BPFI", "BSF", "FTF"]
    amplitude_m_s2: ByChannel


class Broadband(Part):
    """White forces on the structure, rolled off above ``corner_hz`` like a two-pole Butterworth filter."""

    force_n_per_root_hz: ByDirection
    corner_hz: Positive


class SensorNoise(Part):
    """White noise of each sensor."""

    m_s2_per_root_hz: ByChannel


class Encoder(Part):
    """Square wave with an index once per revolution, sampled with the channels."""

    pulses_per_rev: Annotated[int, Field(ge=1, le=100_000)]
    high_v: Positive = 5.0
