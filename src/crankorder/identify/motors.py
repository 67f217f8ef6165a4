"""Lines of an induction motor, from its nameplate and its slip, where the frames of recordings hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crankorder.engine.motor import SHAFT, USUAL_SLIP, Motor, MotorLine, motor_lines
from crankorder.findings import Motor as MotorRecord
from crankorder.findings import MotorLine as LineRecord
from crankorder.findings import MotorSpeed
from crankorder.identify.intervals import Z95, positive_interval
from crankorder.identify.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.known_lines import Held, LineSeen, Place, Sighting, found_near, sightings, words_of
from crankorder.identify.lines.order_lock import NUMBERS as ORDER_LOCK
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="motors"):
    stands_out_ratio: float


NUMBERS = _Numbers.load()

STATED_REACH = Z95 * ORDER_LOCK.stated_speed_error
"""Share by which a stated speed may be off."""

Measured = tuple[float, float]
"""A frequency in Hz and its standard error."""


@dataclass(frozen=True, eq=False)
class MotorSeen:
    """``record`` of a motor, its ``lines`` in recordings, and why a stated speed is not that of the shaft, or None."""

    record: MotorRecord
    lines: tuple[LineSeen, ...]
    speed_doubt: str | None


def motor_seen(motor: Motor, held: Sequence[Held], *, by_shaft: bool, settings: IdentifySettings) -> MotorSeen:
    """The ``motor`` and its lines that stand in the recordings ``held``.

    The supply is measured by its own line or its double, near what is stated. The slip of a recording is 1 - n p / f
    with the speed n of its motor's shaft in Hz, p pole pairs and the supply f. A line is named where it stands above
    the noise; a sideband that stands on an order of the shaft only where the one on the other side is there too, and
    then both are said. Where poles and supply fit the speed of no recording, the record says so, and no line is named.

    Parameters
    ----------
    by_shaft : whether the speeds are the shaft's own. A speed that was only stated, or is in doubt, gives no place to
        a line that goes with the shaft; the slip is then that of the one line just below the field, and where that
        tells another speed the stated one is in doubt
    settings : how far mains wander
    """
    supplies = [_supply(motor, recording, by_shaft, settings) for recording in held]
    measured = [own for own in supplies if own is not None]
    supply = _mean(measured) if measured else None
    if supply is None and motor.supply_hz is not None:
        supply = motor.supply_hz, settings.mains_tolerance_hz / Z95
    lines = [line for line in motor_lines(motor) if (measured or line.mains == 0) and (by_shaft or line.turns == 0.0)]
    speeds: list[MotorSpeed] = []
    seen: list[LineSeen] = []
    doubts: list[tuple[float, float]] = []
    for recording, own in zip(held, supplies, strict=True):
        at = own or supply
        speed = None if at is None else _speed(motor, recording, at, by_shaft=by_shaft)
        speeds += [] if speed is None else [speed]
        if speed is not None and abs(speed.speed_rpm / recording.rpm - 1.0) > STATED_REACH:
            doubts.append((recording.rpm, speed.speed_rpm))
        if speed is None or speed.fits:
            seen += _seen_in(recording, lines, 0.0 if at is None else at[0])
    fits = not speeds or any(speed.fits for speed in speeds)
    record = MotorRecord(
        supply_hz=None if supply is None else supply[0],
        supply_hz_ci95=None if supply is None else positive_interval(supply[0], Z95 * supply[1]),
        supply_measured=bool(measured),
        poles=motor.poles,
        rotor_bars=motor.rotor_bars,
        misfit="" if fits or supply is None else _misfit(motor, speeds, supply[0]),
        speeds=tuple(speeds),
        lines=_records(seen),
    )
    return MotorSeen(record, tuple(seen), _doubt(doubts))


def _doubt(doubts: Sequence[tuple[float, float]]) -> str | None:
    """Why stated speeds are not the shaft's, from ``doubts`` (stated, told by the line) [rpm]; None where they are."""
    if not doubts:
        return None
    stated, read = (" and ".join(f"{rpm:.5g}" for rpm in dict.fromkeys(column)) for column in zip(*doubts, strict=True))
    where = f" in {len(doubts)} recordings" if len(doubts) > 1 else ""
    return f"{stated} rpm is stated, and the line just below the motor's field tells {read} rpm{where}"


def _supply(motor: Motor, held: Held, by_shaft: bool, settings: IdentifySettings) -> Measured | None:
    """Supply frequency by its double or itself; None where neither is there.

    A stated speed is often the field's, whose multiples are at the mains: they are no orders of the shaft.
    """
    for multiple in (2, 1) if motor.supply_hz is not None else ():
        reach = settings.mains_tolerance_hz * float(np.sqrt(multiple))
        middle = multiple * float(motor.supply_hz or 0.0)
        line = found_near(held, middle - reach, middle + reach, known=None if by_shaft else [])
        if line is not None:
            return line[0] / multiple, max(line[1] / multiple, 1e-6)
    return None


def _mean(supplies: Sequence[Measured]) -> Measured:
    """Mean supply frequency of recordings; its error is no less than their scatter."""
    hertz, error = np.array(supplies).T
    return float(np.average(hertz, weights=error**-2)), float(max(np.sum(error**-2) ** -0.5, hertz.std()))


def _speed(motor: Motor, held: Held, supply: Measured, *, by_shaft: bool) -> MotorSpeed | None:
    """What the motor does in one recording; None without poles, or where nothing tells its speed."""
    if motor.poles is None:
        return None
    shaft = (held.rpm * motor.shaft_ratio / 60.0, 0.0) if by_shaft else _line_below_field(motor, held, supply[0])
    if shaft is None:
        return None
    synchronous_rpm = motor.synchronous_rpm(supply[0])
    slip = 1.0 - 60.0 * shaft[0] / synchronous_rpm
    half = Z95 * float(np.hypot(supply[1] / supply[0], shaft[1] / shaft[0]))
    return MotorSpeed(
        speed_rpm=60.0 * shaft[0] / motor.shaft_ratio,
        synchronous_rpm=synchronous_rpm,
        slip=slip,
        slip_ci95=(slip - half, slip + half),
        pole_pass_hz=2.0 * slip * supply[0],
        fits=slip + half >= 0.0 and slip - half <= USUAL_SLIP,
    )


def _line_below_field(motor: Motor, held: Held, supply_hz: float) -> Measured | None:
    """The line between the slowest rotor and its field that is the motor's shaft; None: none, or several.

    That at the stated speed is, where there is one, whatever another machine adds; else the only one.
    """
    field_hz = motor.synchronous_rpm(supply_hz) / 60.0
    slowest_hz, stated_hz = (1.0 - USUAL_SLIP) * field_hz, held.rpm * motor.shaft_ratio / 60.0
    near = max(slowest_hz, stated_hz * (1.0 - STATED_REACH)), min(field_hz, stated_hz * (1.0 + STATED_REACH))
    mains: list[Place] = [(supply_hz, 0.0)]
    line = found_near(held, slowest_hz, field_hz, known=mains)
    if line is None or near[0] <= line[0] <= near[1]:
        return line
    known = [*mains, (line[0], 0.0)]
    stated = found_near(held, *near, known=known) if near[0] < near[1] else None
    if stated is not None:
        return stated
    other = found_near(held, slowest_hz, field_hz, known=known)
    if other is not None:
        pair = sightings(held, [(line[0], 0.0), (other[0], 0.0), *mains])[:2]
        first, second = (0.0 if sighting is None else float(sighting.amplitude.max()) for sighting in pair)
        if second * NUMBERS.stands_out_ratio > first:
            return None
    return line


def _misfit(motor: Motor, speeds: Sequence[MotorSpeed], supply_hz: float) -> str:
    """Why no line of the ``motor`` is named: at none of its ``speeds`` can it be one that drives."""
    worst = max(speeds, key=lambda speed: abs(speed.slip))
    turns = worst.speed_rpm * motor.shaft_ratio
    way = "faster than" if worst.slip < 0.0 else f"{100.0 * worst.slip:.3g} % below"
    return (
        f"the motor would turn at {turns:.4g} rpm, {way} the {worst.synchronous_rpm:.4g} rpm of {motor.poles} poles at "
        f"{supply_hz:.4g} Hz: the poles, shaft_ratio or supply_hz do not fit, or it is driven"
    )


def _seen_in(held: Held, lines: Sequence[MotorLine], supply_hz: float) -> list[LineSeen]:
    """Those of the ``lines`` that stand in the recording ``held``, with what else may stand there."""
    places: list[Place] = [(line.mains * supply_hz, line.turns) for line in lines]
    at_places = sightings(held, places)
    shown = {
        number: LineSeen(
            line, held, line.hertz_at(supply_hz, held.rpm), sighting, _also(held, number, lines, places, at_places)
        )
        for number, (line, sighting) in enumerate(zip(lines, at_places, strict=True))
        if sighting is not None and sighting.seen
    }
    carriers = {seen.line.name for seen in shown.values()} | {SHAFT}
    kept = []
    for number, seen in shown.items():
        if seen.line.of and seen.line.of not in carriers:
            continue
        partner = [k for k in shown if k != number and seen.line.of and lines[k].name == seen.line.name]
        if seen.also and seen.line.of and not any(not shown[k].also for k in partner):
            continue
        kept.append(seen)
    return kept


def _also(
    held: Held,
    number: int,
    lines: Sequence[MotorLine],
    places: Sequence[Place],
    at_places: Sequence[Sighting | None],
) -> tuple[str, ...]:
    """What else stands so near to line ``number`` that the recording does not tell them apart."""
    order = held.order_of(places[number])
    names = [
        line.name
        for other, line in enumerate(lines)
        if other != number
        and line.of != lines[number].name
        and at_places[other] is not None
        and abs(held.order_of(places[other]) - order) * held.span_rev < KNOWN_LINES.apart_cycles
    ]
    whole = round(order)
    fixed = lines[number].mains != 0 or lines[number].of != ""
    if fixed and whole >= 1 and abs(order - whole) * held.span_rev < KNOWN_LINES.apart_cycles:
        names.append(f"order {whole}")
    return tuple(dict.fromkeys(names))


def _records(lines: Sequence[LineSeen]) -> tuple[LineRecord, ...]:
    """One record per line and channel, of the recording in which it is largest."""
    records: dict[tuple[str, int, float, str], LineRecord] = {}
    for seen in lines:
        sizes = zip(seen.held.channels, seen.sighting.amplitude.tolist(), seen.sighting.error.tolist(), strict=True)
        for channel, size, error in sizes:
            if size < Z95 * error:
                continue
            key = seen.line.name, seen.line.mains, seen.line.turns, channel
            record = LineRecord(
                name=words_of(seen),
                side=seen.line.side,
                channel=channel,
                frequency_hz=seen.hertz,
                order=seen.sighting.order,
                speed_rpm=seen.held.rpm,
                amplitude=size,
                amplitude_ci95=(max(0.0, size - Z95 * error), size + Z95 * error),
                others=tuple(seen.also),
                n_recordings=1,
            )
            old = records.get(key)
            largest = record if old is None or size > old.amplitude else old
            records[key] = replace(largest, n_recordings=1 + (0 if old is None else old.n_recordings))
    return tuple(records.values())
