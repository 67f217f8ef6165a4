"""Findings of a test: every line with its number, its 95 % interval, its evidence and its cause."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import xarray as xr

from crankorder.cause import ELECTRIC, alike_speeds, electric
from crankorder.engine.machine_parts import Motor
from crankorder.findings import SCHEMA_VERSION, Balance, Channel, Findings, OpenBand, quality_of
from crankorder.findings import Motor as MotorRecord
from crankorder.identify.balance.unbalance_fit import UnbalanceFit, unbalance_fit
from crankorder.identify.bearings.records import bearing_records
from crankorder.identify.causes.aliasing import alias_flags, shown_aliases
from crankorder.identify.causes.angle_swings import swing_sidebands
from crankorder.identify.causes.explain import Causes, explained, with_neighbours_named
from crankorder.identify.energy import energy_shares
from crankorder.identify.found import NO_FITS, AgreedOrder, Doubt, ModalFit, SpeedVerdicts, SweepFits, Unsearched
from crankorder.identify.levels import graded, level_records, limit_verdicts, third_octave_records, vibration_records
from crankorder.identify.lines.agreed_orders import orders_agreed, unless_sidebands
from crankorder.identify.lines.followed_orders import (
    fixed_lines,
    numbered_as_followed,
    slow_flags,
    with_followed,
    with_track_rows,
)
from crankorder.identify.lines.growth import if_unbalance
from crankorder.identify.lines.known_lines import LineSeen, held_of, without_known
from crankorder.identify.lines.line_phasors import speed_source
from crankorder.identify.lines.mains import mains_seen, motor_seen, without_ringing
from crankorder.identify.lines.order_lines import order_lines
from crankorder.identify.machine_model import MachineModel
from crankorder.identify.modes.alike_speeds import with_tones_settled
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.identify.modes.order_blocks import with_locks_through_modes
from crankorder.identify.records import line_records, mode_records, order_records
from crankorder.identify.speeds.crossings import crossings
from crankorder.identify.speeds.speeds_to_avoid import as_avoided, speeds_to_avoid
from crankorder.orders.track_rows import TrackReader
from crankorder.quantities import QualityFlag, flags_of, is_cylinder_pressure
from crankorder.settings import Settings

DOUBTS = ("speed_tie", "speed_doubtful")
"""Flags of recordings whose speed was read from the vibration and may be another."""

SEARCHES = {"floor": "the floor", "orders": "orders over the speeds", "sweeps": "the signals of sweeps"}
"""What a search looks at, as it is said."""

IN_DOUBT = "the speed is in doubt"


@dataclass(frozen=True, eq=False)
class Measured:
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
    quantity, unit = _by_channel(order_map, "quantity"), _by_channel(order_map, "unit")
    flags = [*flags_of(order_map)]
    flags += [flag for flag in flags_of(campbell) if flag not in flags]
    lines = _lines(measured, speed_doubt(flags), sources.motor, settings)
    modal, in_map, orders, doubt = lines.modal, lines.in_map, lines.orders, lines.doubt
    bearings = bearing_records(orders, envelope, bearings=sources.bearings, revs_per_cycle=turns, settings=asked)
    folds = shown_aliases(order_map, settings=settings)
    explain = partial(explained, in_map, modal, bearings, sources=sources, settings=asked, folds=folds)
    explain = partial(explain, known=lines.known, longest_rev=lines.longest_rev, quantity=quantity)
    in_cylinder = [name for name in unit if is_cylinder_pressure(quantity[name], unit[name])]
    rows = {(line.channel, agreed.order): line for agreed in orders for line in agreed.lines}
    causes = explain(in_cylinder=in_cylinder, of_swing=swing_sidebands(orders, frames), rows=rows)
    modal = with_neighbours_named(modal, in_map, causes)

    tested = _tested_rpm(order_map, campbell)
    moving, stated = going_with_speed(orders, causes), [gear.order for gear in sources.gears]
    met = crossings(moving, modal, speed_rpm=tested, settings=asked, stated=stated)
    speeds = speeds_to_avoid(met, moving, modal, speed_rpm=tested, unit=unit, settings=asked)
    meetings = as_avoided(met, speeds.avoid)
    speeds = speeds if doubt is None else without_free(speeds)

    fit = partial(unbalance_fit, order_map, orders, modal, followed=followed)
    balance, reason = _balance(fit, order_map, sources, causes)
    energy, unexplained = energy_shares(campbell, order_map, in_map, modal, causes, settings=asked)
    of_channels = level_records(measured.levels)
    above = {level.channel: level.share_above for level in of_channels}
    shares = tuple(replace(share, above_band=above.get(share.channel)) for share in energy.channels)
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
        lines=line_records(records, modal, causes, channels=list(unit)),
        unexplained_energy_fraction=unexplained,
        energy=replace(energy, channels=shares),
        levels=of_channels,
        vibration_levels=() if vibration is None else vibration_records(vibration),
        third_octaves=() if vibration is None else third_octave_records(vibration),
        limits=() if vibration is None else limit_verdicts(vibration, balance, sources),
        balance=balance,
        balance_reason=None if balance is not None else reason,
        looked_for=("orders", "modes", "bearings", *(("envelope",) if has_spectra else ())),
        false_alarm_probability=asked.false_alarm_probability,
        quality=quality_of(flags),
    )


def _balance(
    fit: Callable[..., UnbalanceFit], order_map: xr.Dataset, sources: MachineModel, causes: Causes
) -> tuple[Balance | None, str]:
    """The residual unbalance by what ``fit`` makes of engine and paths, or why it is not known."""
    balance, reason = fit(engine=sources.engine, paths=sources.paths, added=sources.added)
    if balance is not None:
        balance, reason = if_unbalance(balance, causes.orders.values())
    return graded(balance, sources, float(np.nanmax(order_map["speed"].values, initial=0.0))), reason


@dataclass(frozen=True)
class _Lines:
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
    seen = (seen_motor.lines if seen_motor else ()) or mains_seen(held, settings=asked)
    in_channels = order_lines(order_map, settings=asked, orders=settings.orders, frames=frames)
    agreed = orders_agreed(in_channels, frames=frames, order_map=order_map, settings=asked, followed=followed)
    numbered = with_followed(numbered_as_followed(agreed, followed), followed, order_map)
    in_map = unless_sidebands(numbered, order_map, frames)
    fitted = modal_fit(measured.campbell, order_map, in_map, settings=asked, followed=followed, swept=measured.swept)
    known = without_ringing(seen, fitted.modes)
    in_map, modal = with_locks_through_modes(in_map, without_known(fitted, known), followed, order_map)
    parted = held if speed_source([*frames, order_map]) == "pulses" else ()
    in_map, modal = with_tones_settled(in_map, modal, held, known, order_map, parted=parted, settings=asked)
    in_map = in_map if doubt is None else undecided_orders(in_map)
    reader = TrackReader(order_map, frames=frames, followed=followed, fixed=fixed_lines(modal.tones))
    orders = with_track_rows(in_map, reader, settings=settings.orders)
    longest = max((recording.span_rev for recording in held), default=np.inf)
    record = None if seen_motor is None else seen_motor.record
    return _Lines(in_map, orders, modal, known, record, doubt, longest)


def _by_channel(order_map: xr.Dataset, name: str) -> dict[str, str]:
    """Coordinate ``name`` of the channels, by channel."""
    return dict(zip(order_map["channel"].values.tolist(), order_map[name].values.tolist(), strict=True))


def _tested_rpm(order_map: xr.Dataset, campbell: xr.Dataset) -> tuple[float, float]:
    """Slowest and fastest speed of the test; NaN where none is known."""
    speed = np.concatenate([order_map["speed"].values, campbell["speed"].values])
    known = speed[np.isfinite(speed)]
    return (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)


def going_with_speed(orders: Sequence[AgreedOrder], causes: Causes) -> tuple[AgreedOrder, ...]:
    """Those of ``orders``, explained by ``causes``, that move with the speed: only these can meet something elsewhere.

    Not those of the mains and of a motor's field; nor, seen at one speed alone, those that no cause and no lock binds
    to the shaft: there nothing tells an order from a line that stays.
    """
    return tuple(agreed for agreed in orders if not _stays(agreed, causes))


def _stays(agreed: AgreedOrder, causes: Causes) -> bool:
    """Whether a line stays where it is when the speed moves, or nothing tells that it would not."""
    makers = [causes.orders[line.channel, agreed.order] for line in agreed.lines]
    if any(electric(cause.kinds) for cause in makers):
        return True
    at_one_speed = alike_speeds(np.concatenate([line.speed_rpm for line in agreed.lines]))
    unbound = all(not cause.known or not {"sideband", *ELECTRIC}.isdisjoint(cause.kinds) for cause in makers)
    return at_one_speed and agreed.lock != "locked" and unbound


def speed_doubt(flags: Iterable[QualityFlag]) -> str | None:
    """Why the speed of a test is in doubt, by the ``flags`` of its recordings; None where none says so."""
    doubts = [flag for flag in flags if flag["flag"] in DOUBTS]
    if not doubts:
        return None
    names = list(dict.fromkeys(flag["recording"] for flag in doubts))
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{doubts[0]['detail']} ({names[0]}{more})"


def _search_flags(left: Sequence[Unsearched]) -> list[QualityFlag]:
    """That natural frequencies may be missing where searches have ``left`` some."""
    flags: list[QualityFlag] = []
    for by, words in SEARCHES.items():
        ends = [(band.low_hz, band.high_hz) for band in left if band.by == by]
        if ends:
            low, high = min(low for low, _ in ends), max(high for _, high in ends)
            detail = (
                f"the search for natural frequencies by {words} stopped at its bound: between {low:.4g} and {high:.4g} "
                "Hz some may be missing; fewer recordings in one test, or shorter ones, bring it to its end"
            )
            flags.append({"recording": "all", "flag": "search_stopped", "severity": "suspect", "detail": detail})
    return flags


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
