"""Findings of a test as types: what a test says, each estimate with its 95 % interval, its evidence and its cause.

Every estimate ``x`` has ``x_ci95``; None stands for not known. Units stand in the names. The schema
``data_schema/findings.json`` is made from these types, and the file ``findings.json`` is their ``as_dict``.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import ClassVar, Literal

from crankorder.cause import CauseKind, DoubtKind, Explained
from crankorder.level_findings import Energy as Energy
from crankorder.level_findings import EnergyShares as EnergyShares
from crankorder.level_findings import Level as Level
from crankorder.level_findings import LimitVerdict as LimitVerdict
from crankorder.level_findings import ThirdOctave as ThirdOctave
from crankorder.level_findings import VibrationLevel as VibrationLevel
from crankorder.records import ABSENT, Document, Ends, Interval, Record, said

SCHEMA_VERSION = 1
"""Of ``findings.json``."""

CAUSES = "kinds of all that may make it, the likeliest first"

Lock = Literal["locked", "slips", "undecided"]
"""Whether an order is an exact multiple of the cycle's: its phase stays, runs away, or cannot be told."""

Verdict = Literal["excited", "not excited", "not decided", "not measured", "outside the tested range", "undecided mode"]
"""What is said of the meeting of an order with a natural frequency."""


class Channel(Record):
    """A channel that was analysed."""

    name: str = said("name")
    unit: str = said("unit of the analysed signal, such as m/s2")
    quantity: str | None = said("acceleration, sound_pressure, …", default=ABSENT)


class OrderFinding(Explained, Record):
    """An order line in one channel."""

    channel: str = said("name of the channel")
    order: float = said("cycles per crank revolution; all channels agree on it", above=0)
    order_ci95: Interval | None = said(default=None)
    tracked_order: float | None = said("where its amplitudes were read, and its track stands", default=None)
    lock: Lock | None = said("whether it is an exact multiple of the cycle's frequency", default=None)
    revs_to_decide: float | None = said(
        "revolutions of one recording after which lock could be told, where it is undecided", default=None
    )
    half_order: bool = said("an odd multiple of one half", default=False)
    amplitude: float = said("largest peak amplitude over speed, in unit", least=0)
    amplitude_ci95: Interval | None = said(
        "95 % interval of amplitude (holds for the largest of all speeds): low, high"
    )
    phase_deg: float | None = said("phase from top dead centre at that speed", default=None)
    phase_deg_ci95: Interval | None = said(default=None)
    unit: str = said("unit of amplitude")
    speed_rpm_at_max: float | None = said("speed of the largest amplitude")
    speed_exponent: float | None = said(
        "power of speed with which the amplitude grows: 2 for an unbalance, 0 for a steady source", default=None
    )
    speed_exponent_ci95: Interval | None = said(default=None)
    speed_law: str | None = said(
        '"grows with speed^n", "falls with speed^n", "keeps its size", "meets a mode", "follows no power law"',
        default=None,
    )
    meets_hz: float | None = said("natural frequency that shapes it", default=None)
    meets_hz_ci95: Interval | None = said(default=ABSENT)
    speed_range_rpm: Interval = said("slowest and fastest speed at which the line was seen")
    n_speeds: int | None = said("speeds at which it was seen", default=ABSENT, least=0)
    evidence: str = said("why it is taken for an order", default="")
    level_over_floor_db: float | None = said("level over the local noise floor", default=None)
    explained_by: str | None = said('what makes the line, or "unexplained"')
    causes: tuple[CauseKind, ...] = said(CAUSES, default=())
    doubts: tuple[DoubtKind, ...] = said("what speaks against the line or its cause", default=())
    amplitude_held: float | None = said(
        "largest peak amplitude that the order would reach if the speed were held there, by the modal fit of its "
        "sweeps; null where none fits",
        default=None,
        least=0,
    )
    amplitude_held_ci95: Interval | None = said(default=None)
    speed_rpm_at_held: float | None = said("speed of amplitude_held", default=None)

    @property
    def size(self) -> float:
        """Peak amplitude, to be held against that of other lines."""
        return self.amplitude


class ModeFinding(Explained, Record):
    """A line that stays where it is, or moves with the speed by a whirl's law: a natural frequency, mains, a tone."""

    frequency_hz: float = said("frequency", above=0)
    frequency_hz_ci95: Interval | None = said()
    reference_rpm: float | None = said("of a whirl: speed at which it has frequency_hz", default=ABSENT)
    speed_slope: float | None = said(
        "of a whirl: Hz by which it moves per revolution per second, in orders; positive forward", default=ABSENT
    )
    speed_slope_ci95: Interval | None = said(default=ABSENT)
    damping_ratio: float | None = said("damping ratio; null where there is none", default=None)
    damping_ratio_ci95: Interval | None = said(default=None)
    channels: tuple[str, ...] = said("channels in which it was seen")
    channel: str | None = said("of a tone: channel in which it stands clearest", default=ABSENT)
    amplitude: float | None = said("of a tone: peak amplitude in that channel", default=ABSENT, least=0)
    amplitude_ci95: Interval | None = said(default=ABSENT)
    evidence: str = said("why it is taken for what it is")
    prominence_db: float | None = said("level over the floor beside it", default=ABSENT)
    reached_by_orders: tuple[float, ...] | None = said(
        "orders that sweep through it in the tested range", default=ABSENT
    )
    undecided: str | None = said(
        "why it may be something else than a natural frequency; empty where it is decided", default=ABSENT
    )
    explained_by: str = said(
        '"mode" for a natural frequency, "whirl" for one that moves with the speed, "undecided", else "mains", '
        '"twice mains", "3 x mains", "tone", "order", or what else is known'
    )
    causes: tuple[CauseKind, ...] = said(CAUSES, default=())
    lines_there_hz: tuple[float, ...] = said("of one that is undecided: known lines that may be all of it", default=())


class CrossingFinding(Record):
    """Meeting of an order with a natural frequency."""

    order: float = said("cycles per crank revolution", above=0)
    mode_hz: float = said("natural frequency", above=0)
    mode_hz_ci95: Interval | None = said(default=None)
    rpm: float = said("speed of the crossing", above=0)
    rpm_ci95: Interval | None = said(default=None)
    in_range: bool = said("inside the tested speeds")
    amplification_predicted: float | None = said(
        "response with the mode over response without it, from the fit", default=None
    )
    predicted_from: Literal["fit", "damping"] | None = said("what predicts the amplification", default=ABSENT)
    remark: str | None = said("what makes the natural frequency doubtful", default=None)
    channel: str | None = said("channel, where the crossing is judged per channel", default=ABSENT)
    channels: tuple[str, ...] = said("channels in which it is excited", default=())
    amplification: float | None = said(
        "amplitude over the trend beside the crossing, or over that without the mode by the fit where its interval "
        "lies above that of the trend; null where it was not measured",
        default=None,
    )
    amplification_ci95: Interval | None = said(
        "95 % interval of amplification: low, high; high is null where it has no bound", default=None
    )
    evidence: str = said("why it is taken as excited or not", default="")
    verdict: Verdict | None = said("what the evidence amounts to", default=ABSENT)
    chance: float | None = said(
        "chance that the order looks so without the mode; null where nothing was measured", default=None
    )
    excited: bool = said("the order rises there")


class AvoidedSpeed(Record):
    """A speed not to dwell at: where orders meet natural frequencies, the costliest first."""

    rank: int = said("1 is the worst", least=1)
    rpm: float = said("speed of the crossing", above=0)
    rpm_range: Interval | None = said("range to stay out of: low, high")
    orders: tuple[float, ...] = said("orders of all crossings in the range, the worst first", default=())
    modes_hz: tuple[float, ...] = said("natural frequencies that orders meets, in the same sequence", default=())
    channel: str = said("channel in which it is worst")
    amplitude: float | None = said("largest peak amplitude there of order alone; null where it is not known")
    amplitude_ci95: Interval | None = said(default=None)
    by_fit: bool = said("amplitude is not as recorded but what the modal fit says of a held speed", default=False)
    unit: str | None = said("unit of amplitude", default=ABSENT)
    amplification: float | None = said(
        "amplitude over that without the mode by the fit, or over the trend beside, in channel; null where not known"
    )
    cost: float | None = said(
        "by which it is ranked: its peak as a share of the largest amplitude of any order in a channel of that unit",
        default=ABSENT,
    )
    reason: str = said("why, in words")
    amplification_ci95: Interval | None = said(
        "95 % interval of amplification: low, high; high is null where it has no bound", default=None
    )
    at_least: bool = said("amplitude is the largest that was measured, the peak may be larger", default=False)
    order: float = said("cycles per crank revolution", above=0)
    mode_hz: float = said("natural frequency", above=0)


class FreeBand(Record):
    """Speeds in which the data exclude an amplification."""

    low_rpm: float = said("slowest speed")
    high_rpm: float = said("fastest speed")
    remark: str | None = said("what the data exclude there", default=None)


class OpenBand(Record):
    """Speeds that are neither free nor to be avoided."""

    low_rpm: float = said("slowest speed")
    high_rpm: float = said("fastest speed")
    remark: str = said("why nothing can be said, or which order is amplified")
    amplified: bool = said("whether a mode is seen to amplify an order there", default=False)


class BearingFinding(Record):
    """A bearing line in the vibration or in its envelope."""

    name: str = said("name of the bearing")
    line: str = said("BPFO, BPFI, BSF, FTF or N*fs")
    order: float = said("order found")
    order_ci95: Interval | None = said(default=None)
    order_expected: float = said("order from the geometry")
    slip_percent: float | None = said(
        "by how much slower than in pure rolling: one less order found over order expected; negative where faster",
        default=None,
    )
    slip_percent_ci95: Interval | None = said(default=None)
    seen_in: Literal["vibration", "envelope"] | None = said('"vibration" or its "envelope"', default=None)
    amplitude: float | None = said("peak amplitude in the unit of its channel, at speed_rpm or where is_mean over all")
    amplitude_ci95: Interval | None = said(default=None)
    is_mean: bool = said("amplitude is the mean over all speeds of a line that keeps its size", default=False)
    channel: str | None = said("channel in which it is strongest", default=ABSENT)
    unit: str | None = said("unit of amplitude", default=ABSENT)
    speed_rpm: float | None = said("speed at which it is strongest", default=None)
    band_hz: Interval | None = said("band of the envelope: low, high", default=None)
    harmonics: int | None = said("multiples of the line over the false-alarm level", default=None, least=0)
    sidebands: float | None = said("spacing of sidebands in orders; null where there are none", default=None)
    lock: Lock | None = said("whether it is an exact multiple of the cycle's frequency", default=None)
    shaft_order: float | None = said(
        "order at which its shaft turns by the spacing of the sidebands, where the speed is nominal; null where it is "
        "not read",
        default=None,
    )
    verdict: str = said("what it means, in words")
    damage: bool = said("whether it is called damage of that part", default=False)
    re_run: bool = said("whether running the same test again tells more", default=False)
    evidence: str = said("why it is taken for this line", default="")

    @property
    def size(self) -> float:
        """Peak amplitude; 0 where it is not known."""
        return self.amplitude or 0.0

    @property
    def order_half(self) -> float:
        """Half width of the 95 % interval of the order; infinite where it is not known."""
        low, high = self.order_ci95 or (None, None)
        return math.inf if low is None or high is None else max(high - self.order, self.order - low)

    def omitted(self) -> Collection[str]:
        """Only an envelope tells how fast a shaft turns."""
        return () if self.seen_in == "envelope" else ("shaft_order",)


class MotorSpeed(Record):
    """The motor in a recording at a held speed."""

    speed_rpm: float = said(
        "speed of the crank; where that is only stated or in doubt, by the line just below the field"
    )
    synchronous_rpm: float = said("speed of the field, of the motor's shaft")
    slip: float = said("how far the rotor lags behind the field, as a share")
    slip_ci95: Ends = said("95 % interval of the slip")
    pole_pass_hz: float = said("2 x slip x supply frequency")
    fits: bool = said("whether a motor that drives may slip so")


class MotorLine(Record):
    """A line of the motor or of its supply."""

    name: str = said("what it is")
    side: str = said('"below" or "above" what it is a sideband of; empty where it is none')
    channel: str = said("channel")
    frequency_hz: float = said("frequency in that recording")
    order: float = said("cycles per crank revolution in that recording")
    speed_rpm: float = said("speed of that recording")
    amplitude: float = said("peak amplitude in the unit of its channel")
    amplitude_ci95: Ends = said("95 % interval of the amplitude")
    others: tuple[str, ...] = said("what else stands there and cannot be told from it", key="or")
    n_recordings: int = said("recordings that show it")


class Motor(Record):
    """The induction motor that the manifest states."""

    supply_hz: float | None = said("supply frequency; null where none is stated")
    supply_hz_ci95: Ends | None = said(
        "95 % interval of the supply frequency, or how far one that is only stated may be off"
    )
    supply_measured: bool = said("whether its own line, or that at its double, measures it")
    poles: int | None = said("poles, not pairs")
    rotor_bars: int | None = said("bars of the rotor")
    misfit: str = said("why no line of the motor is named, where speed, poles and supply do not fit; else empty")
    speeds: tuple[MotorSpeed, ...] = said("the motor in each recording at a held speed that tells its slip")
    lines: tuple[MotorLine, ...] = said(
        "lines of the motor and of its supply, each as the recording has it in which it is largest"
    )


class LineFinding(Explained, Record):
    """A line above the false-alarm level, by order or by frequency."""

    ALSO: ClassVar[Document] = {"anyOf": [{"required": ["frequency_hz"]}, {"required": ["order"]}]}

    channel: str = said("name of the channel")
    order: float | None = said("order of a line that moves with speed", default=ABSENT)
    order_ci95: Interval | None = said(default=ABSENT)
    frequency_hz: float | None = said("frequency of a line that stays", default=ABSENT)
    frequency_hz_ci95: Interval | None = said(default=ABSENT)
    explained_by: str | None = said('what makes it, or "unexplained"')
    causes: tuple[CauseKind, ...] = said(CAUSES, default=())
    amplitude: float | None = said("peak amplitude in the unit of its channel")
    amplitude_ci95: Interval | None = said(default=ABSENT)

    @property
    def size(self) -> float:
        """Peak amplitude; 0 where it is not known."""
        return self.amplitude or 0.0


class Balance(Record):
    """Residual unbalance: what balances an engine or a rotor not, split by direction and sense of rotation."""

    source: str = said('"engine orders", "stated path" or "trial mass"', default="")
    orders_used: tuple[int, ...] = said("orders from which it was worked out", default=())
    residual_reciprocating_g: float | None = said("unbalanced reciprocating mass", default=None)
    residual_second_order_g: float | None = said("unbalanced reciprocating mass by the second order", default=None)
    residual_rotating_gmm: float | None = said("rotating unbalance", default=None)
    angle_deg: float | None = said("angle of the rotating unbalance from the crank", default=None)
    forward_gmm: float | None = said("unbalance that turns with the crank", default=None)
    forward_angle_deg: float | None = said("angle of the forward part from the crank", default=None)
    reverse_gmm: float | None = said("unbalance that turns against the crank", default=None)
    reverse_angle_deg: float | None = said("angle of the reverse part from the crank", default=None)
    along_g: float | None = said("residual along the cylinder, at the crank radius", default=None)
    along_quadrature_g: float | None = said(
        "residual along the cylinder a quarter turn ahead of the piston's own, at the crank radius", default=None
    )
    across_g: float | None = said("residual across the cylinder, at the crank radius", default=None)
    residual_reciprocating_g_ci95: Interval | None = said(default=None)
    residual_second_order_g_ci95: Interval | None = said(default=None)
    residual_rotating_gmm_ci95: Interval | None = said(default=None)
    angle_deg_ci95: Interval | None = said(default=None)
    forward_gmm_ci95: Interval | None = said(default=None)
    forward_angle_deg_ci95: Interval | None = said(default=None)
    reverse_gmm_ci95: Interval | None = said(default=None)
    reverse_angle_deg_ci95: Interval | None = said(default=None)
    along_g_ci95: Interval | None = said(default=None)
    along_quadrature_g_ci95: Interval | None = said(default=None)
    across_g_ci95: Interval | None = said(default=None)
    crank_radius_mm: float | None = said("crank radius", default=None)
    grade_mm_s: float | None = said(
        "balance grade G (ISO 21940-11): rotating unbalance over the mass of the rotor, times the angular speed",
        default=ABSENT,
    )
    grade_mm_s_ci95: Interval | None = said(default=ABSENT)
    grade_speed_rpm: float | None = said("speed of the grade: in service, else the fastest tested", default=ABSENT)
    not_decided: dict[str, str] | None = said("reason by key of what could not be decided", default=None)
    evidence: str = said("what the numbers rest on", default="")
    if_unbalance: bool = said(
        "whether the numbers hold only if order 1 is unbalance, which nothing tells from a bent shaft or misalignment",
        default=False,
    )


class Influence(Record):
    """What a unit of the added mass does to a channel at a speed."""

    channel: str = said("name of the channel")
    speed_rpm: float = said("speed")
    response_per_unit: float = said("change of amplitude per unit of the added mass")
    phase_deg: float = said("its phase")


class TrialBalance(Balance):
    """Residual unbalance as a known mass tells it that was added between two tests: before, and with it."""

    residual_after_gmm: float | None = said("rotating unbalance with the mass", default=ABSENT)
    residual_after_gmm_ci95: Interval | None = said(default=ABSENT)
    angle_after_deg: float | None = said("its angle", default=None)
    angle_after_deg_ci95: Interval | None = said(default=None)
    along_after_g: float | None = said("residual along the cylinder with the mass", default=ABSENT)
    along_after_g_ci95: Interval | None = said(default=ABSENT)
    radius_mm: float | None = said(
        "radius at which the mass was added; null of masses at several, and on a piston", default=None
    )
    influence: tuple[Influence, ...] = said("what a unit of the mass does, by channel and speed", default=())

    def omitted(self) -> Collection[str]:
        """A mass on a piston tells no angle."""
        return () if self.residual_after_gmm is not None else ("angle_after_deg", "angle_after_deg_ci95")


class Quality(Record):
    """A remark on a recording."""

    recording: str = said("name of the recording")
    flag: str = said("what, one word")
    severity: Literal["info", "suspect", "bad"] = said("bad data take no part in averages")
    detail: str = said("where or how much")
    channel: str | None = said("optional: channel that a fault of the record concerns", default=ABSENT)
    begin: float | None = said("optional: where the fault begins, in s, by crank angle in rev", default=ABSENT)
    end: float | None = said("optional: where the fault ends, in s, by crank angle in rev", default=ABSENT)
    left_out: Literal["stretch", "channel"] | None = said(
        "optional: what of the channel was left out of all averages, so that the rest could stay", default=ABSENT
    )


class SpeedSwing(Record):
    """Swing of the shaft's own speed at one order, in one recording."""

    recording: str = said("file name")
    speed_rpm: float = said("mean speed")
    order: float = said("order of the swing, a multiple of the cycle's")
    amplitude_rpm: float = said("peak amplitude, the root of the mean square over the cycles")
    may_be_encoder: bool = said("whether an encoder off its centre or oval could show as much", default=False)
    steady_rpm: float = said("peak amplitude of the mean cycle")


class Findings(Record):
    """What a test says."""

    ALSO: ClassVar[Document] = {
        "if": {"properties": {"balance": {"type": "null"}}},
        "then": {"required": ["balance_reason"]},
    }

    schema_version: int = said("version of this schema", least=1)
    test: str = said("name of the test")
    not_asked_for: str | None = said(
        "why there are no findings, where the recipe asks for none; else absent", default=ABSENT
    )
    channels: tuple[Channel, ...] = said("channels analysed")
    speed_range_rpm: Interval = said("slowest and fastest tested speed", default=(None, None))
    speed_doubt: str | None = said(
        "why the speed is in doubt, where it may be another: of the vibration, stated, or not as named; else null",
        default=None,
    )
    orders: tuple[OrderFinding, ...] = said("order lines found, one per channel and order")
    modes: tuple[ModeFinding, ...] = said(
        "natural frequencies, those that move with the speed (whirl) too, mains, other tones"
    )
    crossings: tuple[CrossingFinding, ...] = said("speeds at which an order meets a natural frequency")
    speeds_to_avoid: tuple[AvoidedSpeed, ...] | None = said("speeds to avoid, the worst first", default=ABSENT)
    free_bands: tuple[FreeBand, ...] = said(
        "speed ranges in which the data exclude that any order found is amplified by more than a stated factor",
        default=(),
    )
    open_bands: tuple[OpenBand, ...] | None = said(
        "speed ranges that are neither free nor to be avoided: what the data leave open there", default=ABSENT
    )
    bearings: tuple[BearingFinding, ...] = said("bearing lines found")
    motor: Motor | None = said(
        "the induction motor that the manifest states; absent where none is stated", default=ABSENT
    )
    lines: tuple[LineFinding, ...] = said("every line above the false-alarm level, by order or by frequency")
    unexplained_energy_fraction: float | None = said(
        "share without a known cause: of the energy that is not broadband where energy is given, else of the lines",
        least=0,
        most=1,
    )
    energy: Energy | None = said(
        "where the energy of each channel in the band looked at lies, as shares that add up to one", default=None
    )
    levels: tuple[Level, ...] = said(
        "overall level of each channel over the test, and what lies above the band that orders and map look at; empty "
        "where it was not asked for",
        default=(),
    )
    vibration_levels: tuple[VibrationLevel, ...] = said(
        "overall levels by channel, band and speed; results.nc holds all speeds of a sweep", default=()
    )
    third_octaves: tuple[ThirdOctave, ...] = said(
        "one-third octaves at the speed of each channel's largest level", default=()
    )
    limits: tuple[LimitVerdict, ...] = said("what the limits of the manifest come to", default=())
    balance: Balance | None = said("residual unbalance, or null with balance_reason")
    balance_reason: str | None = said("why there is no balance", default=ABSENT)
    looked_for: tuple[str, ...] = said(
        'what was sought: "orders", "modes", "bearings", "envelope"; an all-clear names no more than this', default=()
    )
    false_alarm_probability: float | None = said("chance of one false line in a test", default=ABSENT, above=0, below=1)
    quality: tuple[Quality, ...] = said("remarks on recordings")
    speed_swing: tuple[SpeedSwing, ...] = said(
        "swing of the shaft's own speed within its cycle, by recording, the largest order first; only what is certain",
        default=(),
    )

    def omitted(self) -> Collection[str]:
        """What nobody asked for is absent, rather than empty."""
        return _NOT_SOUGHT if self.not_asked_for else ()


_OF_LEVELS = ("levels", "vibration_levels", "third_octaves", "limits", "energy")
_NOT_SOUGHT = (*_OF_LEVELS, "speed_doubt", "free_bands", "looked_for")


def quality_of(flags: Iterable[Mapping[str, object]]) -> tuple[Quality, ...]:
    """Remarks from the ``flags`` that datasets carry in their attributes."""
    return tuple(Quality.from_dict(flag) for flag in flags)


def nothing_sought(
    test: str,
    *,
    reason: str,
    channels: tuple[Channel, ...] = (),
    speed_range_rpm: Interval = (None, None),
    quality: tuple[Quality, ...] = (),
) -> Findings:
    """Findings of the ``test`` of that name with nothing in them but why: the ``reason`` that nobody asked for any.

    ``channels``, ``speed_range_rpm`` and ``quality`` are those of its recordings.
    """
    return Findings(
        schema_version=SCHEMA_VERSION, test=test, not_asked_for=reason, channels=channels,
        speed_range_rpm=speed_range_rpm, unexplained_energy_fraction=None, balance=None, balance_reason=reason,
        quality=quality, orders=(), modes=(), crossings=(), bearings=(), lines=(),
    )  # fmt: skip
