"""Records of ``findings.json``: what was found, as numbers with 95 % intervals and words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np

from crankorder.cause import Cause
from crankorder.findings import (
    AvoidedSpeed,
    CrossingFinding,
    FreeBand,
    LineFinding,
    Lock,
    ModeFinding,
    OpenBand,
    OrderFinding,
)
from crankorder.identify.causes.explain import Causes
from crankorder.identify.found import (
    AgreedOrder,
    Crossing,
    Evidence,
    ModalFit,
    Mode,
    OrderLine,
    SpeedBand,
    SpeedVerdicts,
    Tone,
    Whirl,
)
from crankorder.identify.intervals import Z95, half_width, interval, positive_interval
from crankorder.identify.lines.growth import Growth, growth, reported, visible_range_rpm
from crankorder.identify.lines.line_phasors import is_half_order
from crankorder.identify.modes.responses import held_peak
from crankorder.records import Ends
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "records")

_NOT_LOCKED: dict[Evidence, str] = {
    "locked to the shaft": "its phase agrees from frame to frame",
    "steady, not locked": "steady from frame to frame",
}
"""What a channel shows of a line, in words that leave its lock to the verdict on all channels together."""


def _evidence(shown: Evidence, lock: Lock) -> str:
    """What a channel shows of a line, beside the verdict ``lock`` on all channels."""
    return shown if lock == "locked" and shown == "locked to the shaft" else _NOT_LOCKED.get(shown, shown)


def order_records(
    orders: tuple[AgreedOrder, ...],
    causes: Causes,
    meetings: Sequence[CrossingFinding],
    modal: ModalFit,
    *,
    unit: Mapping[str, str],
) -> tuple[OrderFinding, ...]:
    """Records of ``orders``, one per order and channel, by channel in the sequence of ``unit``, then by order.

    ``causes`` explain them; ``meetings`` are the records of the crossings; ``modal`` says what they would reach at
    held speeds; ``unit`` is that of each channel.
    """
    records = [
        _order_record(agreed, line, causes.orders[line.channel, agreed.order], meetings, unit[line.channel])
        for agreed in orders
        for line in agreed.lines
    ]
    place = {name: number for number, name in enumerate(unit)}
    records.sort(key=lambda record: (place[record.channel], record.order))
    return tuple(_held(record, modal) for record in records)


def _order_record(
    agreed: AgreedOrder, line: OrderLine, cause: Cause, meetings: Sequence[CrossingFinding], unit: str
) -> OrderFinding:
    law = growth(line)
    best = reported(line, law)
    phase = float(line.phase_deg[best.at])
    doubts = (*agreed.doubts, *line.doubts)
    kinds = [doubt.kind for doubt in doubts] + ([] if cause.doubt is None else [cause.doubt])
    said = (
        _evidence(line.evidence, agreed.lock),
        f"{line.level_over_floor_db:.1f} dB over the local floor",
        *(doubt.words for doubt in doubts),
        line.remark,
    )
    met_hz = _met_hz(agreed.order, line.channel, best.speed_rpm, meetings)
    return OrderFinding(
        channel=line.channel,
        order=agreed.order,
        order_ci95=positive_interval(agreed.order, half_width(agreed.degrees_of_freedom) * agreed.order_error),
        tracked_order=agreed.tracked,
        lock=agreed.lock,
        revs_to_decide=agreed.needed_revs,
        half_order=agreed.lock != "slips" and is_half_order(agreed.order, agreed.order_error),
        amplitude=best.amplitude,
        amplitude_ci95=(max(0.0, best.low), best.high),
        phase_deg=None if np.isnan(phase) else phase,
        phase_deg_ci95=None if np.isnan(phase) else _phase_ends(line, best.at),
        unit=unit,
        speed_rpm_at_max=best.speed_rpm,
        speed_exponent=None if law is None else law.exponent,
        speed_exponent_ci95=None if law is None else law.ci95,
        speed_law=None if law is None else _law(law, met_hz),
        meets_hz=met_hz,
        speed_range_rpm=visible_range_rpm(line),
        n_speeds=len(np.unique(line.seen)),
        evidence=_once(*said, cause.evidence),
        level_over_floor_db=line.level_over_floor_db,
        explained_by=cause.text,
        causes=cause.kinds,
        doubts=tuple(dict.fromkeys(kinds)),
    )


def _held(record: OrderFinding, modal: ModalFit) -> OrderFinding:
    """``record`` with the amplitude that its order would reach in a sweep if the speed were held, where it is known."""
    largest_rpm = record.speed_rpm_at_max
    peak = None if largest_rpm is None else held_peak(modal, record.order, record.channel, largest_rpm=largest_rpm)
    if peak is None:
        return record
    return replace(record, amplitude_held=peak.amplitude, amplitude_held_ci95=peak.ends, speed_rpm_at_held=peak.rpm)


def _phase_ends(line: OrderLine, at: int) -> Ends:
    """95 % interval [deg] of the phase of ``line`` at the speed seen number ``at``: a turn where unknown."""
    phase = float(line.phase_deg[at])
    if line.phase_ci95_deg is None:
        spread = float(np.degrees(line.amplitude_error[at] / line.amplitude[at]))
        return interval(phase, spread, freedom=float(line.degrees_of_freedom[at]))
    half = float(line.phase_ci95_deg[at])
    return phase - half, phase + half


def _once(*said: str) -> str:
    """Everything that is ``said``, part by part, each but once."""
    parts = [part for text in said for part in text.split("; ")]
    return "; ".join(dict.fromkeys(part for part in parts if part))


def _law(law: Growth, met_hz: float | None) -> str:
    """The law that the line follows; where it follows none, the mode that it meets is why."""
    return "meets a mode" if met_hz is not None and law.law == "follows no power law" else law.law


def _met_hz(order: float, channel: str, at_rpm: float, meetings: Sequence[CrossingFinding]) -> float | None:
    """Natural frequency (Hz) whose excited crossing makes an order largest at ``at_rpm``; else None."""
    met = [
        record
        for record in meetings
        if record.excited
        and record.order == order
        and channel in record.channels
        and abs(record.rpm - at_rpm) <= NUMBERS.met_share * at_rpm
    ]
    best = min(met, key=lambda record: abs(record.rpm - at_rpm), default=None)
    return None if best is None else best.mode_hz


def mode_records(modal: ModalFit, causes: Causes, meetings: Sequence[CrossingFinding]) -> tuple[ModeFinding, ...]:
    """Records of all modes, whirls and tones of ``modal``, lowest first, with their ``causes``.

    ``meetings`` are the records of the crossings: whatever excites a mode reaches it.
    """
    records = [_mode_record(mode, cause, meetings) for mode, cause in zip(modal.modes, causes.modes, strict=True)]
    records += [_whirl_record(whirl) for whirl in modal.whirls]
    records += [_tone_record(tone, cause) for tone, cause in zip(modal.tones, causes.tones, strict=True)]
    return tuple(sorted(records, key=lambda record: record.frequency_hz))


def _mode_record(mode: Mode, cause: Cause, meetings: Sequence[CrossingFinding]) -> ModeFinding:
    excites = {one.order for one in meetings if one.excited and one.mode_hz == mode.frequency_hz}
    return ModeFinding(
        frequency_hz=mode.frequency_hz,
        frequency_hz_ci95=mode.frequency_ends,
        damping_ratio=mode.damping_ratio,
        damping_ratio_ci95=mode.damping_ends,
        channels=mode.channels,
        evidence=mode.evidence,
        prominence_db=mode.prominence_db,
        reached_by_orders=tuple(sorted({*mode.reached_by, *excites})),
        undecided=mode.undecided,
        explained_by=cause.text,
        causes=cause.kinds,
        lines_there_hz=mode.lines_there_hz,
    )


def _whirl_record(whirl: Whirl) -> ModeFinding:
    return ModeFinding(
        frequency_hz=whirl.frequency_hz,
        frequency_hz_ci95=positive_interval(whirl.frequency_hz, Z95 * whirl.frequency_error_hz),
        reference_rpm=whirl.reference_rpm,
        speed_slope=whirl.slope,
        speed_slope_ci95=interval(whirl.slope, whirl.slope_error),
        damping_ratio=whirl.damping_ratio if whirl.damping_told else None,
        damping_ratio_ci95=positive_interval(whirl.damping_ratio, Z95 * whirl.damping_error),
        channels=whirl.channels,
        evidence=whirl.evidence,
        prominence_db=whirl.prominence_db,
        undecided="",
        explained_by="whirl",
        causes=("whirl",),
    )


def _tone_record(tone: Tone, cause: Cause) -> ModeFinding:
    # channels may have different units: that in which it stands clearest
    channel, (amplitude, error) = max(tone.amplitude.items(), key=lambda item: item[1][0] / max(item[1][1], 1e-300))
    return ModeFinding(
        frequency_hz=tone.frequency_hz,
        frequency_hz_ci95=positive_interval(tone.frequency_hz, Z95 * tone.frequency_error_hz),
        damping_ratio=None,
        damping_ratio_ci95=None,
        channels=tuple(tone.amplitude),
        channel=channel,
        amplitude=amplitude,
        amplitude_ci95=(max(0.0, amplitude - Z95 * error), amplitude + Z95 * error),
        evidence=_once(tone.evidence, cause.evidence),
        explained_by=cause.text,
        causes=cause.kinds,
    )


def line_records(
    orders: Sequence[OrderFinding], modal: ModalFit, causes: Causes, *, channels: list[str]
) -> tuple[LineFinding, ...]:
    """Every line above the false-alarm level: records of ``orders`` first, then the tones and modes of ``modal``.

    ``causes`` explain them; ``channels`` are the names of all, in the sequence of the map.
    """
    kept = ("channel", "order", "order_ci95", "explained_by", "causes", "amplitude", "amplitude_ci95")
    records = [LineFinding(**{key: getattr(record, key) for key in kept}) for record in orders]
    for tone, cause in zip(modal.tones, causes.tones, strict=True):
        for channel, (amplitude, error) in tone.amplitude.items():
            records.append(
                LineFinding(
                    channel=channel,
                    frequency_hz=tone.frequency_hz,
                    frequency_hz_ci95=positive_interval(tone.frequency_hz, Z95 * tone.frequency_error_hz),
                    explained_by=cause.text,
                    causes=cause.kinds,
                    amplitude=amplitude,
                    amplitude_ci95=(max(0.0, amplitude - Z95 * error), amplitude + Z95 * error),
                )
            )
    return (*records, *_modes_as_lines(modal, causes, channels))


def _modes_as_lines(modal: ModalFit, causes: Causes, channels: list[str]) -> list[LineFinding]:
    """Peak of a tone as strong as the floor within the half-power width of each mode, by channel that shows it."""
    records = []
    for mode, cause in zip(modal.modes, causes.modes, strict=True):
        half = mode.damping_ratio * mode.frequency_hz
        near = np.abs(modal.frequency_hz - mode.frequency_hz) <= max(half, 1e-9)
        for channel in mode.channels:
            psd = modal.floor_psd[channels.index(channel), near] if modal.floor_psd.size else np.zeros(0)
            known = psd[np.isfinite(psd)]
            rms = float(np.sqrt(known.mean() * 2.0 * half)) if known.size else None
            records.append(
                LineFinding(
                    channel=channel,
                    frequency_hz=mode.frequency_hz,
                    frequency_hz_ci95=mode.frequency_ends,
                    explained_by=cause.text,
                    causes=cause.kinds,
                    amplitude=None if rms is None else float(np.sqrt(2.0)) * rms,
                )
            )
    return records


def crossing_records(found: Sequence[Crossing]) -> tuple[CrossingFinding, ...]:
    """Findings of the crossings ``found``."""
    told = [one.name for one in fields(Crossing) if one.name != "whirl"]
    return tuple(
        CrossingFinding(**{name: getattr(item, name) for name in told}, excited=item.excited) for item in found
    )


def avoided_records(verdicts: SpeedVerdicts) -> tuple[AvoidedSpeed, ...]:
    """Findings of the speeds of ``verdicts`` that are to be avoided, the worst first."""
    return tuple(
        AvoidedSpeed(
            rank=rank,
            order=item.orders[0],
            mode_hz=item.modes_hz[0],
            **{one.name: getattr(item, one.name) for one in fields(item)},
        )
        for rank, item in enumerate(verdicts.avoid, start=1)
    )


def free_records(bands: Sequence[SpeedBand]) -> tuple[FreeBand, ...]:
    """Findings of ``bands`` of speed that are free."""
    return tuple(FreeBand(low_rpm=one.low_rpm, high_rpm=one.high_rpm, remark=one.remark) for one in bands)


def open_records(bands: Sequence[SpeedBand]) -> tuple[OpenBand, ...]:
    """Findings of ``bands`` of speed that are neither free nor to be avoided."""
    return tuple(
        OpenBand(low_rpm=one.low_rpm, high_rpm=one.high_rpm, remark=one.remark, amplified=one.amplified)
        for one in bands
    )
