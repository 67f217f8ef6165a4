"""Records of ``findings.json``: what was found, as numbers with 95 % intervals and words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from crankorder.cause import Cause
from crankorder.findings import CrossingFinding, LineFinding, Lock, ModeFinding, OrderFinding
from crankorder.identify.causes.explain import Causes
from crankorder.identify.found import AgreedOrder, AgreedOrders, Evidence, ModalFit, Mode, OrderLine, Tone, Whirl
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
    orders: AgreedOrders,
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
        _order_record(agreed, line, causes.orders[line.channel, agreed.order], meetings, unit[line.channel], modal)
        for agreed in orders
        for line in agreed.lines
    ]
    place = {name: number for number, name in enumerate(unit)}
    return tuple(sorted(records, key=lambda record: (place[record.channel], record.order)))


def _order_record(
    agreed: AgreedOrder, line: OrderLine, cause: Cause, meetings: Sequence[CrossingFinding], unit: str, modal: ModalFit
) -> OrderFinding:
    law = growth(line)
    best = reported(line, law)
    phase = float(line.phase_deg[best.at])
    held = held_peak(modal, agreed.order, line.channel, largest_rpm=best.speed_rpm)
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
        amplitude_held=None if held is None else held.amplitude,
        amplitude_held_ci95=None if held is None else held.ends,
        phase_deg=None if np.isnan(phase) else phase,
        phase_deg_ci95=None if np.isnan(phase) else _phase_ends(line, best.at),
        unit=unit,
        speed_rpm_at_max=best.speed_rpm,
        speed_rpm_at_held=None if held is None else held.rpm,
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
    excites = {met.order for met in meetings if met.excited and met.mode_hz == mode.frequency_hz}
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
    channel, (amplitude, error) = max(tone.amplitude.items(), key=lambda pair: pair[1][0] / max(pair[1][1], 1e-300))
    return ModeFinding(
        frequency_hz=tone.frequency_hz,
        frequency_hz_ci95=_tone_ends(tone),
        damping_ratio=None,
        damping_ratio_ci95=None,
        channels=tuple(tone.amplitude),
        channel=channel,
        amplitude=amplitude,
        amplitude_ci95=_size_ends(amplitude, error),
        evidence=_once(tone.evidence, cause.evidence),
        explained_by=cause.text,
        causes=cause.kinds,
    )


def _tone_ends(tone: Tone) -> Ends:
    """95 % interval of the frequency of ``tone``."""
    return positive_interval(tone.frequency_hz, Z95 * tone.frequency_error_hz)


def _size_ends(size: float, error: float) -> Ends:
    """95 % interval of an amplitude of that ``size`` with its standard ``error``."""
    return max(0.0, size - Z95 * error), size + Z95 * error


def line_records(
    orders: Sequence[OrderFinding], modal: ModalFit, causes: Causes, *, channels: list[str]
) -> tuple[LineFinding, ...]:
    """Every line above the false-alarm level: records of ``orders`` first, then the tones and modes of ``modal``.

    ``causes`` explain them; ``channels`` are the names of all, in the sequence of the map.
    """
    kept = ("channel", "order", "order_ci95", "explained_by", "causes", "amplitude", "amplitude_ci95")
    records = [LineFinding(**{key: getattr(record, key) for key in kept}) for record in orders]
    for tone, cause in zip(modal.tones, causes.tones, strict=True):
        sizes = {channel: (size, _size_ends(size, error)) for channel, (size, error) in tone.amplitude.items()}
        records += _lines_at(tone.frequency_hz, _tone_ends(tone), cause, sizes)
    for mode, cause in zip(modal.modes, causes.modes, strict=True):
        levels = {channel: (_level_of(mode, channels.index(channel), modal), None) for channel in mode.channels}
        records += _lines_at(mode.frequency_hz, mode.frequency_ends, cause, levels)
    return tuple(records)


def _lines_at(
    hertz: float, ends: Ends, cause: Cause, sizes: Mapping[str, tuple[float | None, Ends | None]]
) -> list[LineFinding]:
    """Lines at a frequency with its interval ``ends`` and its ``cause``: amplitude and interval of it by channel."""
    return [
        LineFinding(
            channel=channel,
            frequency_hz=hertz,
            frequency_hz_ci95=ends,
            explained_by=cause.text,
            causes=cause.kinds,
            amplitude=amplitude,
            amplitude_ci95=amplitude_ends,
        )
        for channel, (amplitude, amplitude_ends) in sizes.items()
    ]


def _level_of(mode: Mode, channel: int, modal: ModalFit) -> float | None:
    """Peak of a tone as strong as the floor of a ``channel`` (its number) within the half-power width of ``mode``."""
    half = mode.damping_ratio * mode.frequency_hz
    near = np.abs(modal.frequency_hz - mode.frequency_hz) <= max(half, 1e-9)
    psd = modal.floor_psd[channel, near] if modal.floor_psd.size else np.zeros(0)
    seen = psd[np.isfinite(psd)]
    return float(np.sqrt(2.0)) * float(np.sqrt(seen.mean() * 2.0 * half)) if seen.size else None
