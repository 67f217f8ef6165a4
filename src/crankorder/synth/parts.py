"""What a scene is made of: sampling, speeds, sensors, structure, and each effect and fault that it may name."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from crankorder.engine.forces import DIRECTIONS
from crankorder.engine.machine_parts import ASCENDING, NonNegative, Positive

TRACE, INDEX = "encoder", "index"
"""Datasets of the encoder in a file."""

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

    ``rpm``: speed at each corner; negative is backwards. ``time_s``: of each corner, from the first sample. Before the
    first and after the last corner the speed stays; corners are taken to the nearest sample.
    """

    rpm: tuple[float, ...] = Field(min_length=2, strict=False)
    time_s: Annotated[tuple[NonNegative, ...], ASCENDING] = Field(strict=False)

    @model_validator(mode="after")
    def _each_has_its_time(self) -> Self:
        if len(self.time_s) != len(self.rpm):
            raise ValueError("time_s must have one time for each of rpm")
        return self

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Time (s) and speed (rpm) of every corner, times ascending."""
        return tuple(zip(self.time_s, self.rpm, strict=True))


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
    time_s: Annotated[tuple[NonNegative, ...] | None, ASCENDING] = Field(default=None, strict=False)

    @model_validator(mode="after")
    def _one_way_of_saying_it(self) -> Self:
        if (self.ratio is None) == (self.rpm is None):
            raise ValueError("give either ratio or rpm")
        if self.rpm is not None and len(self.rpm) > 1:
            if len(self.time_s or ()) != len(self.rpm):
                raise ValueError("time_s must have one time for each of rpm")
        elif self.time_s is not None:
            raise ValueError("time_s goes with two or more of rpm")
        return self


Cause = Annotated[str, Field(min_length=1, max_length=60)]
BearingLineName = Literal["N*fs", "BPFO", "BPFI", "BSF", "FTF"]


class Wander(Part):
    """Random slow changes of the speed: ``std_rpm`` in all, evenly from 0 to ``corner_hz``."""

    std_rpm: NonNegative
    corner_hz: Positive


class SpeedOrder(Part):
    """A share of the speed that comes and goes with the crank angle."""

    order: Positive
    percent: Annotated[float, Field(ge=0, lt=50)]
    phase_deg: float = 0.0


class InCycleSpeed(Part):
    """Speed within the cycle: given by order, or from the torque of masses (and gas) on a flywheel.

    With neither key the flywheel is the engine's.
    """

    by_order: tuple[SpeedOrder, ...] = Field(default=(), strict=False)
    flywheel_inertia_kg_m2: Positive | None = None

    @model_validator(mode="after")
    def _one_way_of_saying_it(self) -> Self:
        if self.by_order and self.flywheel_inertia_kg_m2 is not None:
            raise ValueError("give either by_order or flywheel_inertia_kg_m2")
        if sum(part.percent for part in self.by_order) >= 90:
            raise ValueError("by_order adds up to a shaft that nearly stands still within the cycle")
        return self


class EngineForces(Part):
    """Forces of the engine's moving masses, to the order that the tolerance (relative to the peak) needs.

    ``moments``: with their rocking and rolling moments.
    """

    tolerance: Annotated[float, Field(ge=1e-16, le=1)]
    moments: bool = False


class GasTorque(Part):
    """Reaction of the crankcase to the gas torque of the engine's ``[gas]``, about the crankshaft.

    ``scatter_percent``: standard deviation of the torque from cycle to cycle.
    """

    highest_order: Annotated[float, Field(ge=0.5, le=1000)]
    scatter_percent: Annotated[float, Field(ge=0, le=50)] = 0.0


class InjectedOrder(Part):
    """A force at an order that the crank mechanism does not make; it grows with a power of speed.

    ``shaft``: another shaft that the order belongs to. ``direction`` RX, RY, RZ: ``force_n`` is a moment in N·m.
    """

    order: Positive
    direction: Axis
    force_n: NonNegative
    at_speed_rpm: Positive
    speed_exponent: Annotated[float, Field(ge=-10, le=10)] = 2.0
    phase_deg: float = 0.0
    shaft: Name | None = None
    cause: Cause = "injected"


class BearingLine(Part):
    """A line of one of the engine's bearings: the same response at every speed, its phase by chance per recording.

    ``slip_percent``: how much slower than pure rolling. ``growth``: factor of the amplitude from one repeat of the test
    to the next. Amplitudes are as recorded.
    """

    bearing: str
    line: BearingLineName
    amplitude_m_s2: ByChannel
    slip_percent: Annotated[float, Field(ge=-20, le=20)] = 0.0
    growth: Positive = 1.0


class BearingImpacts(Part):
    """Strikes of a damaged bearing that ring a resonance.

    ``peak_m_s2``: of the ringing after an average strike. ``slip_percent``: how much slower than pure rolling;
    ``jitter_percent``: standard deviation of a period between strikes, which add up. ``load_zone``: share of the
    amplitude that comes and goes with the shaft (BPFI) or the cage (BSF). ``growth`` as for a line.
    """

    bearing: str
    line: Literal["BPFO", "BPFI", "BSF", "FTF"]
    peak_m_s2: ByChannel
    resonance_hz: Positive
    damping_ratio: Annotated[float, Field(gt=0, lt=1)]
    slip_percent: Annotated[float, Field(ge=-20, le=20)] = 1.0
    jitter_percent: Annotated[float, Field(ge=0, le=20)] = 0.0
    load_zone: Annotated[float, Field(ge=0, le=1)] = 0.0
    growth: Positive = 1.0


class Tone(Part):
    """A tone that does not follow the shaft, such as mains or a dynamometer, with its harmonics; phases by chance.

    ``harmonics``: amplitude of each whole multiple relative to ``amplitude_m_s2``, the tone itself first. Amplitudes
    are as recorded.
    """

    cause: Cause
    frequency_hz: Positive
    amplitude_m_s2: ByChannel
    harmonics: tuple[NonNegative, ...] = Field(default=(1.0,), min_length=1, strict=False)


class Broadband(Part):
    """White forces on the structure, rolled off above ``corner_hz`` like a two-pole Butterworth filter."""

    force_n_per_root_hz: ByAxis
    corner_hz: Positive


class SensorNoise(Part):
    """White noise of each sensor."""

    m_s2_per_root_hz: ByChannel


class ColouredNoise(Part):
    """Noise of sensors whose density runs straight, on log scales, from point to point; level outside of them."""

    channels: tuple[str, ...] = Field(min_length=1, strict=False)
    frequency_hz: Annotated[tuple[Positive, ...], ASCENDING] = Field(min_length=1, strict=False)
    m_s2_per_root_hz: tuple[Positive, ...] = Field(strict=False)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.frequency_hz) != len(self.m_s2_per_root_hz):
            raise ValueError("m_s2_per_root_hz must have one value for each frequency")
        return self


class Acquisition(Part):
    """What stands between the sensors and the file.

    ``sensitivity_mv_per_g``: the file holds volts. ``full_scale``: the largest value either way, in the unit of the
    file; ``bits`` of the converter over it. ``low_pass_hz`` and ``low_pass_order``: Butterworth filter before sampling;
    ``ac_coupling_hz``: first-order high-pass. Filters act on what the structure and the noise make; amplitudes that a
    scene gives as recorded stay. ``clock_error_ppm``: how much faster than its label the clock runs. ``delay_s``: of a
    channel.
    """

    sensitivity_mv_per_g: Positive | None = None
    full_scale: Positive | None = None
    bits: Annotated[int, Field(ge=4, le=32)] | None = None
    low_pass_hz: Positive | None = None
    low_pass_order: Annotated[int, Field(ge=1, le=12)] = 4
    ac_coupling_hz: Positive | None = None
    clock_error_ppm: Annotated[float, Field(gt=-1e5, lt=1e5)] = 0.0
    delay_s: ByChannel = Field(default_factory=dict)
    stored_as: Literal["float32", "float64", "int16"] = "float32"

    @model_validator(mode="after")
    def _converter_is_whole(self) -> Self:
        if self.full_scale is None and (self.bits is not None or self.stored_as == "int16"):
            raise ValueError(f"{'int16 needs' if self.bits is None else 'bits need'} full_scale")
        if self.stored_as == "int16" and self.bits is not None and self.bits > 16:
            raise ValueError("int16 holds no more than 16 bits")
        return self


class Encoder(Part):
    """Shaft encoder, sampled with the channels as a square wave.

    ``pulses_per_rev``: of the full wheel; the last ``missing_teeth`` of them are left out, so that tooth 1 follows the
    gap. ``ratio``: encoder revolutions per crank revolution. ``eccentricity_deg``: amplitude of the once-per-revolution
    error of angle; above 45° lines would change places. ``line_error_deg``: standard deviation of where the lines are.
    ``high_v``: high level.
    """

    pulses_per_rev: Annotated[int, Field(ge=1, le=100_000)]
    missing_teeth: Annotated[int, Field(ge=0)] = 0
    ratio: Positive = 1.0
    index: bool = True
    index_to_tdc_deg: float = 0.0
    eccentricity_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    eccentricity_phase_deg: float = 0.0
    line_error_deg: NonNegative = 0.0
    high_v: Positive = 5.0

    @model_validator(mode="after")
    def _wheel_is_whole(self) -> Self:
        if self.missing_teeth >= self.pulses_per_rev:
            raise ValueError("more teeth are missing than the wheel has")
        return self


Count = Annotated[int, Field(ge=1)]


class EncoderFault(Part):
    """Base: ``recordings`` are names without suffix; all where none is named."""

    recordings: tuple[str, ...] = Field(default=(), strict=False)


class LostPulses(EncoderFault):
    """Pulses that did not come, at random places."""

    kind: Literal["lost_pulses"]
    count: Count


class DamagedLine(EncoderFault):
    """Lines of the wheel (numbered from 0) that never give a pulse."""

    kind: Literal["damaged_line"]
    lines: tuple[Annotated[int, Field(ge=0)], ...] = Field(min_length=1, strict=False)


class DoublePulses(EncoderFault):
    """False pulses, ``delay_s`` after true ones at random places."""

    kind: Literal["double_pulses"]
    count: Count
    delay_s: Positive = 2e-4


AnyEncoderFault = Annotated[LostPulses | DamagedLine | DoublePulses, Field(discriminator="kind")]


class SignalFault(Part):
    """Base: ``channels`` and ``recordings`` (names without suffix) that have it; all where none is named."""

    channels: tuple[str, ...] = Field(default=(), strict=False)
    recordings: tuple[str, ...] = Field(default=(), strict=False)


class Clipping(SignalFault):
    """Cut off at a share of the largest value."""

    kind: Literal["clipping"]
    of_peak: Annotated[float, Field(gt=0, lt=1)]


class IepeOverload(SignalFault):
    """A step of ``times_peak`` at ``at_s`` that decays with ``decay_s``."""

    kind: Literal["iepe_overload"]
    at_s: NonNegative
    times_peak: Positive = 25.0
    decay_s: Positive = 0.5


class NotANumber(SignalFault):
    """NaN from ``at_s`` for ``duration_s`` (one sample where that is 0)."""

    kind: Literal["not_a_number"]
    at_s: NonNegative
    duration_s: NonNegative = 0.0


class Spikes(SignalFault):
    """Single samples of ``times_peak`` with either sign, at random places."""

    kind: Literal["spikes"]
    count: Count
    times_peak: Positive = 10.0


class Drift(SignalFault):
    """A constant ``offset_m_s2`` and a straight rise by ``drift_m_s2`` over the recording."""

    kind: Literal["drift"]
    offset_m_s2: float = 0.0
    drift_m_s2: float = 0.0


class DroppedSamples(SignalFault):
    """``count`` samples left out at ``at_s``: what follows comes early, and the last value fills the end."""

    kind: Literal["dropped_samples"]
    at_s: NonNegative
    count: Count


class Dropout(SignalFault):
    """Zero from ``at_s`` for ``duration_s``."""

    kind: Literal["dropout"]
    at_s: NonNegative
    duration_s: Positive


AnySignalFault = Annotated[
    Clipping | IepeOverload | NotANumber | Spikes | Drift | DroppedSamples | Dropout, Field(discriminator="kind")
]


class WrongLabels(Part):
    """What manifest and files say wrongly; the samples are right.

    ``pulses_per_rev``: of the encoder. ``swapped``: two channels.
    """

    pulses_per_rev: Annotated[int, Field(ge=1)] | None = None
    swapped: tuple[str, str] | None = Field(default=None, strict=False)
