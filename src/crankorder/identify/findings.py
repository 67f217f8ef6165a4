"""Findings of a test: every line with its number, its 95 % interval, its evidence and its cause."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.cause import ELECTRIC, Cause, alike_speeds, electric
from crankorder.engine.machine_parts import Motor
from crankorder.findings import (
    SCHEMA_VERSION,
    Channel,
    CrossingFinding,
    Energy,
    Findings,
    Level,
    LineFinding,
    ModeFinding,
    OpenBand,
    OrderFinding,
    quality_of,
)
from crankorder.findings import Motor as MotorRecord
from crankorder.identify.balance.unbalance_fit import unbalance_fit
from crankorder.identify.bearing_records import bearing_records
from crankorder.identify.crossings import crossings
from crankorder.identify.energy import energy_shares
from crankorder.identify.explain import Beside, Causes, explained, with_neighbours_named
from crankorder.identify.found import (
    NO_FITS,
    AgreedOrder,
    AgreedOrders,
    Doubt,
    Evidence,
    ModalFit,
    Mode,
    OrderLine,
    SpeedVerdicts,
    SweepFits,
    Tone,
    Unsearched,
    Whirl,
)
from crankorder.identify.levels import graded, level_records, limit_verdicts, third_octave_records, vibration_records
from crankorder.identify.lines.agreed_orders import orders_agreed, unless_sidebands
from crankorder.identify.lines.followed_orders import (
    fixed_lines,
    numbered_as_followed,
    slow_flags,
    with_followed,
    with_track_rows,
)
from crankorder.identify.lines.growth import growth, if_unbalance, reported, visible_range_rpm
from crankorder.identify.lines.known_lines import LineSeen, held_of
from crankorder.identify.lines.line_evidence import alias_flags, shown_aliases
from crankorder.identify.lines.line_phasors import is_half_order, speed_source
from crankorder.identify.lines.mains import mains_seen, motor_seen, without_ringing
from crankorder.identify.lines.order_lines import order_lines
from crankorder.identify.machine_model import MachineModel
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.identify.modes.order_blocks import with_locks_through_modes
from crankorder.identify.modes.responses import held_peak
from crankorder.identify.modes.tones import with_tones_settled
from crankorder.identify.sidebands import swing_sidebands
from crankorder.identify.speeds_to_avoid import as_avoided, speeds_to_avoid
from crankorder.orders.intervals import Z95, half_width, interval, positive_interval, size_interval
from crankorder.orders.track_rows import TrackReader
from crankorder.quantities import Floats, QualityFlag, flags_of, is_cylinder_pressure
from crankorder.records import Ends
from crankorder.settings import MethodNumbers, Settings

DOUBTS = ("speed_tie", "speed_doubtful", "speeds_not_as_named")
"""Flags of recordings whose speed was read from the vibration, or is not that of any name, and may be another."""

SEARCHES = {"floor": "the floor", "orders": "orders over the speeds", "sweeps": "the signals of sweeps"}
"""What a search looks at, as it is said."""

IN_DOUBT = "the speed is in doubt"


class Measured(NamedTuple):
    """What the stages before made of a test, to be explained.

    ``order_map`` (OrderMap) and ``campbell`` (CampbellMap) are its maps, without speeds where none is known; ``frames``
    the OrderFrames of its recordings, ``envelope`` its EnvelopeMap (None where none was made); ``followed`` the
    RecordingTracks of the recordings (without variables where the speed does not sweep) with the rows of ``swept``,
    what the signals of sweeps tell of modes; ``levels`` are their RecordingLevels, ``vibration`` the VibrationLevels of
    the test.
    """

    order_map: xr.Dataset
    campbell: xr.Dataset
    frames: Sequence[xr.Dataset]
    envelope: xr.Dataset | None = None
    followed: Sequence[xr.Dataset] = ()
    swept: SweepFits = NO_FITS
    levels: Sequence[xr.Dataset] = ()
    vibration: xr.Dataset | None = None


def find(measured: Measured, *, test: str, sources: MachineModel, settings: Settings) -> Findings:
    """Findings of the test named ``test``, as it was ``measured``.

    ``sources`` says what the machine is made of; ``settings`` are those of all stages.
    """
    order_map, campbell, frames, envelope = measured.order_map, measured.campbell, measured.frames, measured.envelope
    vibration, followed = measured.vibration, measured.followed
    asked, turns = settings.identify, sources.revs_per_cycle
    names = order_map["channel"].values.tolist()
    quantity, unit = (dict(zip(names, order_map[of].values.tolist(), strict=True)) for of in ("quantity", "unit"))
    flags = [*flags_of(order_map), *(flag for flag in flags_of(campbell) if flag not in flags_of(order_map))]
    lines = _lines(measured, speed_doubt(flags), sources.motor, settings)
    modal, in_map, orders, doubt = lines.modal, lines.in_map, lines.orders, lines.doubt
    bearings = bearing_records(orders, envelope, bearings=sources.bearings, revs_per_cycle=turns, settings=asked)
    folds = shown_aliases(order_map, settings=settings)
    in_cylinder = [name for name in unit if is_cylinder_pressure(quantity[name], unit[name])]
    rows = {(line.channel, agreed.order): line for agreed in orders for line in agreed.lines}
    beside = Beside(in_cylinder, folds, lines.known, swing_sidebands(orders, frames), lines.longest_rev, rows)
    causes = explained(in_map, modal, bearings, sources=sources, quantity=quantity, settings=asked, beside=beside)
    modal = with_neighbours_named(modal, in_map, causes)

    tested = _tested_rpm(order_map["speed"].values, campbell["speed"].values)
    rate = max((float(tracks.attrs.get("sweep_rpm_per_s", 0.0)) for tracks in followed), default=0.0)
    moving, stated = going_with_speed(orders, causes), [gear.order for gear in sources.gears]
    met = crossings(moving, modal, speed_rpm=tested, settings=asked, stated=stated)
    speeds = speeds_to_avoid(met, moving, modal, speed_rpm=tested, unit=unit, settings=asked, sweep_rpm_per_s=rate)
    meetings = tuple(as_avoided(met, speeds.avoid))
    speeds = speeds if doubt is None else without_free(speeds)

    balance, reason = unbalance_fit(order_map, orders, modal, sources=sources, followed=followed)
    if balance is not None:
        balance, reason = if_unbalance(balance, causes.orders.values())
    balance = graded(balance, sources, float(np.nanmax(order_map["speed"].values, initial=0.0)))
    energy, unexplained = energy_shares(campbell, order_map, in_map, modal, causes, settings=asked)
    levels = level_records(measured.levels)
    records = order_records(orders, causes, meetings, modal, unit=unit)
    flags += alias_flags(order_map, settings=settings, folds=folds)
    flags += [*slow_flags(order_map, in_map, frames, settings=settings), *_search_flags(modal.left)]
    has_spectra = envelope is not None and envelope.sizes["order"] > 1 and envelope.sizes["speed"] > 0
    return Findings(
        schema_version=SCHEMA_VERSION,
        test=test,
        channels=tuple(Channel(name=name, unit=unit[name], quantity=quantity[name]) for name in unit),
        speed_range_rpm=tested,
        speed_doubt=doubt,
        orders=records,
        modes=mode_records(modal, causes, meetings),
        crossings=meetings,
        speeds_to_avoid=speeds.avoid,
        free_bands=speeds.free,
        open_bands=speeds.open,
        bearings=bearings,
        motor=lines.motor,
        lines=tuple(line_records(records, modal, causes, channels=list(unit))),
        unexplained_energy_fraction=unexplained,
        energy=_with_share_above(energy, levels),
        levels=levels,
        vibration_levels=() if vibration is None else vibration_records(vibration),
        third_octaves=() if vibration is None else third_octave_records(vibration),
        limits=() if vibration is None else limit_verdicts(vibration, balance, sources),
        balance=balance,
        balance_reason=None if balance is not None else reason,
        looked_for=("orders", "modes", *("bearings",) * bool(sources.bearings), *("envelope",) * has_spectra),
        false_alarm_probability=asked.false_alarm_probability,
        quality=quality_of(flags),
    )


def _tested_rpm(*speeds_rpm: Floats) -> tuple[float, float]:
    """Lowest and highest known speed [rpm] of the axes ``speeds_rpm``, NaN where none is known."""
    speed = np.concatenate(speeds_rpm)
    known = speed[np.isfinite(speed)]
    return (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)


def _with_share_above(energy: Energy, levels: Sequence[Level]) -> Energy:
    """``energy`` with the share above the band of each channel, which its ``levels`` tell."""
    above = {level.channel: level.share_above for level in levels}
    channels = tuple(replace(share, above_band=above.get(share.channel)) for share in energy.channels)
    return replace(energy, channels=channels)


class _Lines(NamedTuple):
    """Orders as the map shows them (``in_map``) and with the amplitudes of their tracks; modes and tones.

    ``known`` lines of the motor and the mains; the ``motor``; why the speed is in ``doubt``, or None; revolutions of
    the longest recording at one speed.
    """

    in_map: tuple[AgreedOrder, ...]
    orders: tuple[AgreedOrder, ...]
    modal: ModalFit
    known: tuple[LineSeen, ...]
    motor: MotorRecord | None
    doubt: str | None
    longest_rev: float


def _lines(measured: Measured, doubt: str | None, motor: Motor | None, settings: Settings) -> _Lines:
    """Lines of a test: which stand, the modes that they cross, their locks, and what stays at its frequency.

    With a ``doubt`` about the speed no order is locked or slips.
    """
    order_map, frames, followed = measured.order_map, measured.frames, measured.followed
    asked, held = settings.identify, held_of(frames, order_map)
    by_shaft = doubt is None and speed_source([order_map]) != "stated"
    seen_motor = None if motor is None else motor_seen(motor, held, by_shaft=by_shaft, settings=asked)
    doubt = doubt or (seen_motor.speed_doubt if seen_motor else None)
    seen = (seen_motor.lines if seen_motor else ()) or tuple(mains_seen(held, settings=asked))
    in_channels = order_lines(order_map, settings=asked, orders=settings.orders, frames=frames)
    agreed = orders_agreed(in_channels, frames=frames, order_map=order_map, settings=asked, followed=followed)
    numbered = with_followed(numbered_as_followed(agreed, followed), followed, order_map)
    in_map = tuple(unless_sidebands(numbered, order_map, frames))
    fitted = modal_fit(measured.campbell, order_map, in_map, settings=asked, followed=followed, swept=measured.swept)
    known = without_ringing(seen, fitted.modes)
    in_map, modal = with_locks_through_modes(in_map, fitted, followed, order_map)
    modal = with_tones_settled(in_map, modal, held, known, settings=asked)
    in_map = in_map if doubt is None else undecided_orders(in_map)
    reader = TrackReader(order_map, frames=frames, followed=followed, fixed=fixed_lines(modal.tones))
    orders = tuple(with_track_rows(in_map, reader, settings=settings.orders))
    longest = max((recording.span_rev for recording in held), default=np.inf)
    record = None if seen_motor is None else seen_motor.record
    return _Lines(in_map, orders, modal, known, record, doubt, longest)


def going_with_speed(orders: Sequence[AgreedOrder], causes: Causes) -> tuple[AgreedOrder, ...]:
    """Those of ``orders``, explained by ``causes``, that move with the speed: only these can meet something elsewhere.

    Not those of the mains and of a motor's field; nor, seen at one speed alone, those that no cause and no lock binds
    to the shaft: there nothing tells an order from a line that stays.
    """
    moving = []
    for agreed in orders:
        makers = [causes.orders[line.channel, agreed.order] for line in agreed.lines]
        bound = any(cause.known and {"sideband", *ELECTRIC}.isdisjoint(cause.kinds) for cause in makers)
        told = bound or agreed.lock == "locked" or not alike_speeds(agreed.speed_rpm)
        if told and not any(electric(cause.kinds) for cause in makers):
            moving.append(agreed)
    return tuple(moving)


def speed_doubt(flags: Iterable[QualityFlag]) -> str | None:
    """Why the speed of a test is in doubt, by the ``flags`` of its recordings; None where none says so."""
    doubts = [flag for flag in flags if flag["flag"] in DOUBTS]
    if not doubts:
        return None
    names = list(dict.fromkeys(flag["recording"] for flag in doubts))
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{doubts[0]['detail']} ({names[0]}{more})"


def _search_flags(left: Sequence[Unsearched]) -> Iterator[QualityFlag]:
    """That natural frequencies may be missing where searches have ``left`` some."""
    for by, words in SEARCHES.items():
        ends = [(band.low_hz, band.high_hz) for band in left if band.by == by]
        if ends:
            low, high = min(low for low, _ in ends), max(high for _, high in ends)
            detail = (
                f"the search for natural frequencies by {words} stopped at its bound: between {low:.4g} and {high:.4g} "
                "Hz some may be missing; fewer recordings in one test, or shorter ones, bring it to its end"
            )
            yield {"recording": "all", "flag": "search_stopped", "severity": "suspect", "detail": detail}


def undecided_orders(orders: tuple[AgreedOrder, ...]) -> tuple[AgreedOrder, ...]:
    """``orders`` of which none is said to be locked or to slip, for the speed that they count by is in doubt."""
    return tuple(
        replace(agreed, lock="undecided", needed_revs=None, doubts=(*agreed.doubts, Doubt("speed in doubt", IN_DOUBT)))
        for agreed in orders
    )


def without_free(verdicts: SpeedVerdicts) -> SpeedVerdicts:
    """``verdicts`` in which no speed is free: what was is open, for another speed may have been meant."""
    opened = [OpenBand(low_rpm=band.low_rpm, high_rpm=band.high_rpm, remark=IN_DOUBT) for band in verdicts.free]
    merged = sorted((*verdicts.open, *opened), key=lambda band: band.low_rpm)
    return replace(verdicts, free=(), open=tuple(merged))


NUMBERS = MethodNumbers("5-identify-explain.toml", "records")

_NOT_LOCKED: dict[Evidence, str] = {
    "locked to the shaft": "its phase agrees from frame to frame",
    "steady, not locked": "steady from frame to frame",
}
"""What a channel shows of a line, in words that leave its lock to the verdict on all channels together."""


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
    held = held_peak(modal, agreed.order, line.channel, seen=best)
    half = None if line.phase_ci95_deg is None else float(line.phase_ci95_deg[best.at])
    if half is None:
        spread = float(np.degrees(line.amplitude_error[best.at] / line.amplitude[best.at]))
        half = half_width(float(line.degrees_of_freedom[best.at])) * spread
    doubts = (*agreed.doubts, *line.doubts)
    kinds = [doubt.kind for doubt in doubts] + ([] if cause.doubt is None else [cause.doubt])
    proven = agreed.lock == "locked" and line.evidence == "locked to the shaft"
    said = (
        line.evidence if proven else _NOT_LOCKED.get(line.evidence, line.evidence),
        f"{line.level_over_floor_db:.1f} dB over the local floor",
        *(doubt.words for doubt in doubts),
        line.remark,
    )
    met_hz = _met_hz(agreed.order, line.channel, best.speed_rpm, meetings)
    no_law = law is not None and law.law == "follows no power law"
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
        phase_deg_ci95=None if np.isnan(phase) else (phase - half, phase + half),
        unit=unit,
        speed_rpm_at_max=best.speed_rpm,
        speed_rpm_at_held=None if held is None else held.rpm,
        speed_exponent=None if law is None else law.exponent,
        speed_exponent_ci95=None if law is None else law.ci95,
        # where the line follows no law, the mode that it meets is why
        speed_law=None if law is None else "meets a mode" if no_law and met_hz is not None else law.law,
        meets_hz=met_hz,
        speed_range_rpm=visible_range_rpm(line),
        n_speeds=len(np.unique(line.seen)),
        evidence=_once(*said, cause.evidence),
        level_over_floor_db=line.level_over_floor_db,
        explained_by=cause.text,
        causes=cause.kinds,
        doubts=tuple(dict.fromkeys(kinds)),
    )


def _once(*said: str) -> str:
    """Everything that is ``said``, part by part, each but once."""
    parts = [part for text in said for part in text.split("; ")]
    return "; ".join(dict.fromkeys(part for part in parts if part))


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
    kept = ("frequency_hz", "damping_ratio", "channels", "evidence", "prominence_db", "undecided", "lines_there_hz")
    return ModeFinding(
        **{key: getattr(mode, key) for key in kept},
        frequency_hz_ci95=mode.frequency_ends,
        damping_ratio_ci95=mode.damping_ends,
        reached_by_orders=tuple(sorted({*mode.reached_by, *excites})),
        explained_by=cause.text,
        causes=cause.kinds,
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
        frequency_hz_ci95=tone.frequency_ends,
        damping_ratio=None,
        damping_ratio_ci95=None,
        channels=tuple(tone.amplitude),
        channel=channel,
        amplitude=amplitude,
        amplitude_ci95=size_interval(amplitude, Z95 * error),
        evidence=_once(tone.evidence, cause.evidence),
        explained_by=cause.text,
        causes=cause.kinds,
    )


def line_records(
    orders: Sequence[OrderFinding], modal: ModalFit, causes: Causes, *, channels: list[str]
) -> Iterator[LineFinding]:
    """Every line above the false-alarm level: records of ``orders`` first, then the tones and modes of ``modal``.

    ``causes`` explain them; ``channels`` are the names of all, in the sequence of the map.
    """
    kept = ("channel", "order", "order_ci95", "explained_by", "causes", "amplitude", "amplitude_ci95")
    yield from (LineFinding(**{key: getattr(record, key) for key in kept}) for record in orders)
    fixed: list[Tone | Mode] = [*modal.tones, *modal.modes]
    for line, cause in zip(fixed, (*causes.tones, *causes.modes), strict=True):
        for channel in line.amplitude if isinstance(line, Tone) else line.channels:
            size, ends = _size_of(line, channel, channels.index(channel), modal)
            yield LineFinding(
                channel=channel,
                frequency_hz=line.frequency_hz,
                frequency_hz_ci95=line.frequency_ends,
                explained_by=cause.text,
                causes=cause.kinds,
                amplitude=size,
                amplitude_ci95=ends,
            )


def _size_of(line: Tone | Mode, channel: str, number: int, modal: ModalFit) -> tuple[float | None, Ends | None]:
    """Amplitude of a tone in a ``channel`` (of that ``number`` in the map) with its interval.

    Of a mode it is that of a tone as strong as the floor within its half-power width, without interval.
    """
    if isinstance(line, Tone):
        size, error = line.amplitude[channel]
        return size, size_interval(size, Z95 * error)
    mode, half = line, line.damping_ratio * line.frequency_hz
    near = np.abs(modal.frequency_hz - mode.frequency_hz) <= max(half, 1e-9)
    psd = modal.floor_psd[number, near] if modal.floor_psd.size else np.zeros(0)
    seen = psd[np.isfinite(psd)]
    return float(np.sqrt(2.0)) * float(np.sqrt(seen.mean() * 2.0 * half)) if seen.size else None, None
