"""Findings on levels: how much each channel vibrates, in which band, at which speed; limits; where the energy lies."""

from __future__ import annotations

from typing import Literal

from crankorder.records import ABSENT, Interval, Record, said


class Level(Record):
    """Overall level of a channel over the test, and what lies above the band that orders and map look at."""

    channel: str = said("name of the channel")
    unit: str = said("its unit")
    rms_max: float | None = said("root mean square of the loudest recording, without the mean")
    band_hz: float | None = said(
        "frequency at which the band looked at ends, at the fastest speed; null where frequencies are not known"
    )
    share_above: float | None = said("share of the mean square above that band, of all recordings together")
    amplitude_above: float | None = said(
        "peak amplitude of the strongest line above it, about; null where there is none"
    )
    frequency_hz_above: float | None = said("its frequency")
    band_hz_there: float | None = said("frequency at which the band looked at ended at the speed of that line")
    order_above: float | None = said("its order; null where no speed is known")
    speed_rpm_above: float | None = said("the speed where it was seen")


class VibrationLevel(Record):
    """Overall level of a channel in a stated band at a speed."""

    channel: str = said("name of the channel")
    quantity: str = said("what the level is of: velocity where it was integrated from an acceleration")
    unit: str = said("unit of rms and peaks")
    band_hz: Interval = said("band of the level: low, high")
    reached_hz: float = said("where the band ends as the slowest rate allows")
    speed_rpm: float | None = said("mean speed; null where it is not known")
    rms: float = said("root mean square in the band", least=0)
    rms_ci95: Interval | None = said(default=None)
    peak: float | None = said("mean of the peaks of short pieces of the recordings", default=None, least=0)
    peak_ci95: Interval | None = said(default=None)
    largest_peak: float | None = said("largest peak", default=None, least=0)
    crest_factor: float | None = said("mean of peak over root mean square of such pieces", default=None, least=0)
    crest_factor_ci95: Interval | None = said(default=None)
    largest: bool = said("whether it is the largest of its channel and band over all speeds", default=False)


class ThirdOctave(Record):
    """Level of a channel in a one-third octave, at the speed at which the channel is loudest."""

    channel: str = said("name of the channel")
    unit: str = said("its unit")
    speed_rpm: float | None = said("mean speed; null where it is not known")
    nominal_hz: float = said("mid-band frequency by which it is called (IEC 61260-1)", above=0)
    rms: float = said("root mean square in it", least=0)
    rms_ci95: Interval | None = said(default=None)


class LimitVerdict(Record):
    """What a limit of the manifest comes to in a channel, or for the residual unbalance."""

    quantity: str = said("what is limited")
    band_hz: Interval | None = said("band of the level; null of a balance grade", default=None)
    value: float = said("the limit, in unit", above=0)
    unit: str = said("its unit")
    source: str = said("where the limit is written, by the manifest")
    channel: str | None = said("name of the channel; null of a balance grade", default=None)
    verdict: Literal["within", "above", "not decided"] = said(
        "above where the level is surely larger at one speed, within where it surely is at none"
    )
    level: float | None = said("the largest level, in unit", default=None)
    level_ci95: Interval | None = said(
        "95 % interval; in its upper end what lies at the ends of the band counts whole, in its lower one not at all",
        default=None,
    )
    speed_rpm: float | None = said("speed of the largest level", default=None)
    evidence: str = said("why, in words", default="")


class EnergyShares(Record):
    """Where the energy of a channel lies."""

    channel: str = said("name of the channel")
    unit: str | None = said("unit of total, such as (m/s2)2", default=ABSENT)
    orders: float | None = said("share of the explained orders", least=0, most=1)
    tones: float | None = said("share of mains and other tones", least=0, most=1)
    unexplained_lines: float | None = said("part of unexplained in lines without a known cause", default=None)
    unexplained_cells: float | None = said(
        "part of unexplained that stands over the fitted floor between the lines, or as a sharp line that nobody named "
        "over the floor beside it",
        default=None,
    )
    unexplained: float | None = said("share of what nothing explains", least=0, most=1)
    modes_and_floor: float | None = said(
        "share of what lies between the lines: natural frequencies and noise floor", least=0, most=1
    )
    total: float | None = said("mean square of the analysed band, in unit", default=None)
    above_band: float | None = said(
        "share of all that was recorded that lies above the band, and in none of the other parts",
        default=None,
        least=0,
        most=1,
    )


class Energy(Record):
    """Where the energy of each channel in the band looked at lies."""

    cells_judged: bool | None = said(
        "whether a fitted surface was there by which cells between the lines could be judged", default=ABSENT
    )
    band_hz: float | None = said(
        "frequency up to which the parts add up to one, at the fastest speed; null where frequencies are not known",
        default=None,
    )
    channels: tuple[EnergyShares, ...] = said("one record per channel")
