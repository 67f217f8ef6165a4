"""The effects that a scene may name, one class each; what a scene leaves out costs nothing."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from crankorder.synth.parts import Axis, ByAxis, ByChannel, Name, NonNegative, Part, Positive

Cause = Annotated[str, Field(min_length=1, max_length=60)]
BearingLineName = Literal["N*fs", "BPFO", "BPFI", "BSF", "FTF"]


class Wobble(Part):
    """A slow sine of the speed, about its mean."""

    frequency_hz: Positive
    amplitude_rpm: NonNegative
    phase_deg: float = 0.0


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
    frequency_hz: tuple[Positive, ...] = Field(min_length=1, strict=False)
    m_s2_per_root_hz: tuple[Positive, ...] = Field(strict=False)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.frequency_hz) != len(self.m_s2_per_root_hz):
            raise ValueError("m_s2_per_root_hz must have one value for each frequency")
        if any(after <= before for before, after in pairwise(self.frequency_hz)):
            raise ValueError("frequency_hz must ascend")
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
        if self.bits is not None and self.full_scale is None:
            raise ValueError("bits need full_scale")
        if self.stored_as == "int16" and self.full_scale is None:
            raise ValueError("int16 needs full_scale")
        if self.stored_as == "int16" and self.bits is not None and self.bits > 16:
            raise ValueError("int16 holds no more than 16 bits")
        return self


class Encoder(Part):
    """Shaft encoder, sampled with the channels as a square wave or an analogue pickup, or as counted pulse times.

    ``pulses_per_rev``: of the full wheel; the last ``missing_teeth`` of them are left out, so that tooth 1 follows the
    gap. ``tooth_angles_deg``: any pattern instead, rising from 0. ``ratio``: encoder revolutions per crank revolution.
    ``eccentricity_deg``: amplitude of the once-per-revolution error of angle; above 45° lines would change places.
    ``line_error_deg``: standard deviation of where the lines are. ``jitter_s``: of each edge. ``counter_hz``: clock of
    the counter; without it times are exact. ``noise_v``: of an analogue pickup, rms; ``high_v``: high level, or its
    peak at ``pickup_rpm``.
    """

    pulses_per_rev: Annotated[int, Field(ge=1, le=100_000)]
    missing_teeth: Annotated[int, Field(ge=0)] = 0
    tooth_angles_deg: tuple[Annotated[float, Field(ge=0, lt=360)], ...] | None = Field(default=None, strict=False)
    ratio: Positive = 1.0
    index: bool = True
    index_to_tdc_deg: float = 0.0
    eccentricity_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    eccentricity_phase_deg: float = 0.0
    line_error_deg: NonNegative = 0.0
    jitter_s: NonNegative = 0.0
    delivered_as: Literal["square", "analogue", "pulse_times"] = "square"
    counter_hz: Positive | None = None
    high_v: Positive = 5.0
    noise_v: NonNegative = 0.0
    pickup_rpm: Positive = 1000.0

    @model_validator(mode="after")
    def _wheel_is_whole(self) -> Self:
        if self.missing_teeth >= self.pulses_per_rev:
            raise ValueError("more teeth are missing than the wheel has")
        angles = self.tooth_angles_deg
        if angles is not None and (not angles or any(after <= before for before, after in pairwise(angles))):
            raise ValueError("tooth_angles_deg must ascend")
        if angles is not None and self.missing_teeth:
            raise ValueError("give either missing_teeth or tooth_angles_deg")
        return self
