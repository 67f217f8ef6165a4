"""The faults that a scene may name: of the encoder, of the signals, and of what the labels say."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from crankorder.synth.parts import NonNegative, Part, Positive

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


class LostIndex(EncoderFault):
    """Index marks that did not come: ``count`` of them at random, or all where none is stated."""

    kind: Literal["lost_index"]
    count: Count | None = None


class ExtraIndex(EncoderFault):
    """False index marks at random times."""

    kind: Literal["extra_index"]
    count: Count


class IndexSlip(EncoderFault):
    """From ``at_s`` on the index comes ``pulses`` lines later (negative: earlier)."""

    kind: Literal["index_slip"]
    at_s: NonNegative
    pulses: int


class EncoderDropout(EncoderFault):
    """No edge at all from ``at_s`` for ``duration_s``: the level stays."""

    kind: Literal["encoder_dropout"]
    at_s: NonNegative
    duration_s: Positive


AnyEncoderFault = Annotated[
    LostPulses | DamagedLine | DoublePulses | LostIndex | ExtraIndex | IndexSlip | EncoderDropout,
    Field(discriminator="kind"),
]


class SignalFault(Part):
    """Base: ``channels`` and ``recordings`` (names without suffix) that have it; all where none is named."""

    channels: tuple[str, ...] = Field(default=(), strict=False)
    recordings: tuple[str, ...] = Field(default=(), strict=False)


class Clipping(SignalFault):
    """Cut off at a share of the largest value; ``one_sided``: at the top only."""

    kind: Literal["clipping"]
    of_peak: Annotated[float, Field(gt=0, lt=1)]
    one_sided: bool = False


class IepeOverload(SignalFault):
    """A step of ``times_peak`` at ``at_s`` that decays with ``decay_s``."""

    kind: Literal["iepe_overload"]
    at_s: NonNegative
    times_peak: Positive = 25.0
    decay_s: Positive = 0.5


class NotANumber(SignalFault):
    """NaN from ``at_s`` for ``duration_s`` (one sample where that is 0), or the number ``instead`` of a logger."""

    kind: Literal["not_a_number"]
    at_s: NonNegative
    duration_s: NonNegative = 0.0
    instead: float | None = None


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

    ``rate_factor``: on the sampling rate. ``pulses_per_rev``: of the encoder. ``swapped``: two channels. ``units``: of
    a channel, in place of m/s2. ``speed_factor``: on stated speeds of crank-angle data.
    """

    rate_factor: Positive = 1.0
    pulses_per_rev: Annotated[int, Field(ge=1)] | None = None
    swapped: tuple[str, str] | None = Field(default=None, strict=False)
    units: dict[str, Literal["g", "mm/s2", "m/s2"]] = Field(default_factory=dict)
    speed_factor: Positive = 1.0
