"""Lines of the mains and of the motor on them: multiples of one frequency that wanders, and the slip beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from crankorder.cause import Cause, alike_speeds, mains_words, of_mains
from crankorder.engine.machine_parts import SHAFT, USUAL_SLIP, Motor, MotorLine, motor_lines
from crankorder.findings import Motor as MotorRecord
from crankorder.findings import MotorLine as LineRecord
from crankorder.findings import MotorSpeed
from crankorder.identify.found import AgreedOrder, AgreedOrders, ModalFit, Mode, Tone
from crankorder.identify.lines.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.lines.known_lines import LineSeen, found_near, named_by, sightings
from crankorder.identify.lines.line_evidence import UNPROVEN
from crankorder.identify.lines.line_phasors import LOCK_NUMBERS as ORDER_LOCK
from crankorder.orders.intervals import Z95, positive_interval, size_interval
from crankorder.orders.joint_lines import NUMBERS as JOINT_LINES
from crankorder.orders.joint_lines import HeldFrames, Place
from crankorder.quantities import Bools, Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "mains")


def nearest_multiple(
    frequency_hz: Floats | float, mains_hz: float, *, settings: IdentifySettings
) -> tuple[Floats, Floats]:
    """The multiple of ``mains_hz`` next to each ``frequency_hz`` (any shape, Hz), and how far (Hz) it may lie from it.

    Those that may stand alone wander by as many times what the supply does as they are multiples of it; a higher one by
    no more than its root allows, as lines that lie anywhere would else be near one. ``settings``: what the supply does.
    """
    multiple = np.maximum(1.0, np.rint(np.asarray(frequency_hz, dtype=np.float64) / mains_hz))
    wander = np.maximum(np.sqrt(multiple), np.minimum(multiple, NUMBERS.alone_multiples))
    return multiple, settings.mains_tolerance_hz * wander


def multiples_near(frequency_hz: float, error_hz: float, *, settings: IdentifySettings) -> list[tuple[int, float]]:
    """Multiple and mains frequency in Hz, of each mains, that a line at ``frequency_hz`` may be.

    ``error_hz``: its standard error; ``settings``: the mains frequencies and how far they wander.
    """
    nearest = [(mains, *nearest_multiple(frequency_hz, mains, settings=settings)) for mains in settings.mains_hz]
    return [
        (int(multiple), mains)
        for mains, multiple, reach in nearest
        if abs(frequency_hz - float(multiple) * mains) <= float(reach) + 2.0 * error_hz
    ]


def multiple_on(frequency_hz: float, error_hz: float, *, settings: IdentifySettings) -> tuple[int, float] | None:
    """The first of the ``multiples_near`` so low that a line may be mains by itself; None: none may.

    ``frequency_hz``, ``error_hz`` and ``settings`` as there.
    """
    near = multiples_near(frequency_hz, error_hz, settings=settings)
    return next((place for place in near if place[0] <= NUMBERS.alone_multiples), None)


def supply_told(places_hz: Sequence[tuple[float, float]], *, settings: IdentifySettings) -> float | None:
    """Nominal frequency in Hz of the supply of a test whose mains stand at ``places_hz`` (frequency and error, Hz).

    That of which alone some of them are multiples; of two that of which the first or the second multiple is there. None
    where none or both are told. ``settings``: the mains frequencies and how far they wander.
    """
    near = [multiples_near(hertz, error, settings=settings) for hertz, error in places_hz]
    certain = [of_line[0] for of_line in near if len(of_line) == 1]
    supplies = {mains for _, mains in certain}
    if len(supplies) > 1:
        supplies = {mains for multiple, mains in certain if multiple <= NUMBERS.alone_multiples}
    return supplies.pop() if len(supplies) == 1 else None


class _Fixed(NamedTuple):
    """Lines of one speed: frequencies and errors in Hz, speeds in rpm, whether each may be an ``exact`` order."""

    hertz: Floats
    error_hz: Floats
    speeds_rpm: list[set[float]]
    exact: Bools


def mains_orders(
    orders: AgreedOrders, *, tones: Sequence[Tone] = (), exact: Sequence[float] = (), settings: IdentifySettings
) -> dict[float, Cause]:
    """Causes of those of ``orders`` that are or may be multiples of a mains frequency, by order.

    Only of lines seen at speeds too alike to tell an order from a fixed frequency. The mains frequency and its double
    stand alone; further multiples only beside one of these, on the same grid, or where more of them are there than
    chance would bring. Where one line is surely mains, those that may be orders of the shaft must lie on its grid. Two
    lines at one multiple of a supply, or lines of two supplies, may each be another tone as well; where the
    recordings are too short to tell a line from a resonance that noise excites it may be a natural frequency.

    Parameters
    ----------
    tones : mains that were found as tones
    exact : orders that are multiples of the cycle's for all that is known: they may be mains as well
    settings : the mains frequencies and how far they wander
    """
    places = {agreed.order: place for agreed in orders if (place := _fixed_hz(agreed)) is not None}
    if not places:
        return {}
    names, fixed = list(places), [agreed for agreed in orders if agreed.order in places]
    hertz, error_hz = np.array(list(places.values())).T
    speeds = [set(agreed.speed_rpm.tolist()) for agreed in fixed]
    lines = _Fixed(hertz, error_hz, speeds, np.array([order in exact for order in names]))
    tones_hz = [tone.frequency_hz for tone in tones]
    hits = {hertz: hit for hertz in settings.mains_hz if (hit := _hits(lines, hertz, tones_hz, settings)).any()}
    sure = [hertz for hertz, hit in hits.items() if (hit & ~lines.exact).any()]
    grids = [hertz for hertz in sure if np.unique(np.rint(lines.hertz / hertz)[hits[hertz] & ~lines.exact]).size > 1]
    if len(grids) == 1:  # a plant has one supply: that of which several multiples stand on one grid
        sure, hits = grids, {hertz: hits[hertz] for hertz in grids}
    unproven = {agreed.order for agreed in orders if all(line.evidence == UNPROVEN for line in agreed.lines)}
    causes: dict[float, Cause] = {}
    for hertz, hit in hits.items():
        multiple, _ = nearest_multiple(lines.hertz, hertz, settings=settings)
        rivals = _rivals(lines, hit & ~lines.exact, hertz, tones)
        for at in np.flatnonzero(hit).tolist():
            number = int(multiple[at])
            text = f"{lines.hertz[at]:.6g} Hz, {number} x {hertz:g} Hz within what mains wander by"
            cause = of_mains(number if len(sure) < 2 else 1, f"{text}; at one speed mains look like orders")
            if len(sure) > 1 or rivals[at]:
                cause = cause.either(Cause("another tone"))
            if names[at] in unproven:
                cause = cause.either(Cause("a natural frequency"))
            causes.setdefault(names[at], cause)
    return causes


def _hits(lines: _Fixed, mains: float, tones_hz: Sequence[float], settings: IdentifySettings) -> Bools:
    """Which ``lines`` are or may be multiples of ``mains``."""
    multiple, reach = nearest_multiple(lines.hertz, mains, settings=settings)
    # a line that is known less well than a supply wanders may be anything
    hits = (np.abs(lines.hertz - multiple * mains) <= reach + 2.0 * lines.error_hz) & (lines.error_hz <= reach)
    low = hits & (multiple <= NUMBERS.alone_multiples)
    supply_hz = lines.hertz / multiple
    others, wander = nearest_multiple(np.asarray(tones_hz, dtype=np.float64), mains, settings=settings)
    beside = (np.asarray(tones_hz) / others)[np.abs(np.asarray(tones_hz) - others * mains) <= wander]
    free = low & ~lines.exact
    if free.any() or len(beside):
        # a line of one speed is known better than a tone, which speeds that change smear
        base = float(np.median(supply_hz[free] if free.any() else beside))
        room = np.maximum(KNOWN_LINES.same_hz, NUMBERS.same_sigmas * lines.error_hz)
        return np.asarray(hits & (np.abs(lines.hertz - multiple * base) <= room))
    several = hits & ~lines.exact
    if several.any():
        base = float(np.median(supply_hz[several]))
        several &= np.abs(lines.hertz - multiple * base) <= KNOWN_LINES.same_hz
        by_chance = float(np.sum(np.minimum(1.0, 2.0 * reach / mains)[~lines.exact]))
        if np.unique(multiple[several]).size >= max(NUMBERS.fewest_multiples, NUMBERS.over_chance_ratio * by_chance):
            return np.asarray(several | low)
    return np.asarray(low)


def _rivals(lines: _Fixed, claim: Bools, mains: float, tones: Sequence[Tone]) -> Bools:
    """Which of the ``lines`` that ``claim`` a multiple of ``mains`` have another line, or tone, of one speed beside."""
    hertz = np.concatenate([lines.hertz, [tone.frequency_hz for tone in tones]])
    error = np.concatenate([lines.error_hz, [tone.frequency_error_hz for tone in tones]])
    claims = np.concatenate([claim, np.ones(len(tones), dtype=bool)])
    speeds = [*lines.speeds_rpm, *(set[float]() for _ in tones)]
    together = np.array([[not a or not b or bool(a & b) for b in speeds] for a in speeds])
    multiple = np.rint(hertz / mains)
    reach = np.maximum(NUMBERS.same_sigmas * np.hypot(error[:, None], error), NUMBERS.least_apart_hz)
    beside = (multiple[:, None] == multiple) & (np.abs(hertz[:, None] - hertz) > reach)
    return np.asarray((together & beside & claims[:, None] & claims).any(axis=1)[: len(lines.hertz)])


def _fixed_hz(agreed: AgreedOrder) -> tuple[float, float] | None:
    """Frequency and error of a line that may as well be fixed; None where several speeds say otherwise."""
    speed = agreed.speed_rpm
    if not alike_speeds(speed):
        return None
    rpm = float(speed.mean())
    error = float(np.hypot(agreed.line_error * rpm, agreed.order * np.ptp(speed) / 4.0))
    return agreed.order * rpm / 60.0, error / 60.0


def mains_seen(held: Sequence[HeldFrames], *, settings: IdentifySettings) -> Iterator[LineSeen]:
    """Mains and twice mains, where several recordings of ``held`` at different speeds show one and the same frequency.

    ``settings``: the mains frequencies and how far they wander.
    """
    for mains in settings.mains_hz:
        base = None
        for multiple in range(1, NUMBERS.most_multiples + 1):
            middle = multiple * mains
            reach = float(nearest_multiple(middle, mains, settings=settings)[1])
            if multiple > NUMBERS.alone_multiples:
                if base is None:
                    break
                middle, reach = multiple * base, KNOWN_LINES.same_hz
            places = _one_frequency(held, middle - reach, middle + reach, multiple * KNOWN_LINES.same_hz)
            line = MotorLine(mains_words(multiple), multiple, 0.0)
            if places:
                base = float(np.median([hertz for _, hertz in places])) / multiple
            yield from (
                LineSeen(line, recording, hertz, sighting)
                for recording, hertz in places
                if (sighting := sightings(recording, [Place(hertz)])[0]) is not None
            )


def _one_frequency(
    held: Sequence[HeldFrames], low_hz: float, high_hz: float, same_hz: float
) -> list[tuple[HeldFrames, float]]:
    """Recordings, with the frequency, that show a line at one and the same one, where orders of the shaft move.

    None where as many others, or more, would show the least of these and do not: a supply is there at every speed.
    """
    lines = [(recording, found_near(recording, low_hz, high_hz)) for recording in held]
    places = [(recording, line[0]) for recording, line in lines if line is not None]
    middle = float(np.median([hertz for _, hertz in places])) if places else 0.0
    places = [(recording, hertz) for recording, hertz in places if abs(hertz - middle) <= same_hz]
    seen = [(recording.order_of(Place(middle)), recording.span_rev) for recording, _ in places]
    moves = any(abs(a - b) * min(span, other) > NUMBERS.moved_cycles for (a, span), (b, other) in combinations(seen, 2))
    if len(places) < NUMBERS.least_speeds or not moves:
        return []
    sighted = [sightings(recording, [Place(hertz)])[0] for recording, hertz in places]
    shown = [sighting for sighting in sighted if sighting is not None]
    if not shown:
        return places
    least = np.min([sighting.amplitude - Z95 * sighting.error for sighting in shown], axis=0)
    place, absent = Place(middle), 0
    for recording in (recording for recording, line in lines if line is None):
        there = None if recording.is_half(recording.order_of(place)) else sightings(recording, [place])[0]
        absent += there is not None and bool(np.any(there.amplitude + JOINT_LINES.seen_sigmas * there.error < least))
    return places if absent < len(places) else []


def without_ringing(known: Sequence[LineSeen], modes: Sequence[Mode]) -> tuple[LineSeen, ...]:
    """``known`` lines without those of the mains that are but how one of the ``modes`` rings, each recording its way.

    A supply has one frequency; what noise rings in a mode peaks anywhere within the mode's width.
    """
    rung = set[int]()
    for multiple, group in _by_multiple(known).items():
        hertz = np.array([seen.hertz for seen in group])
        for mode in (mode for mode in modes if not mode.undecided):
            half, away = mode.damping_ratio * mode.frequency_hz, abs(float(np.median(hertz)) - mode.frequency_hz)
            near = away <= NUMBERS.rings_within * half + mode.frequency_half_hz
            rung |= {multiple} if near and hertz.std() > NUMBERS.rings_share * half else set()
    return tuple(seen for seen in known if seen.line.turns != 0.0 or seen.line.mains not in rung)


def _by_multiple(known: Iterable[LineSeen]) -> dict[int, list[LineSeen]]:
    """Those of the ``known`` lines that stay where they are, by their multiple of the mains."""
    fixed: dict[int, list[LineSeen]] = {}
    for seen in known:
        if seen.line.turns == 0.0:
            fixed.setdefault(seen.line.mains, []).append(seen)
    return fixed


def with_mains_tones(modal: ModalFit, known: Sequence[LineSeen], orders: Sequence[AgreedOrder]) -> ModalFit:
    """``modal`` with the mains among the ``known`` lines as tones, where no tone of it and none of the ``orders`` is.

    A tone there that may be an order at the speeds of the test is none: where the shaft's orders moved it has stayed.
    """
    tones = list(modal.tones)
    named = [line for agreed in orders if (line := named_by(known, agreed)) is not None]
    held_by_orders = {seen.line.mains for seen in named if not seen.line.turns}
    for mains, group in _by_multiple(seen for seen in known if seen.alone).items():
        hertz = float(np.median([seen.hertz for seen in group]))
        reaches = [max(KNOWN_LINES.same_hz, Z95 * tone.frequency_error_hz) for tone in tones]
        near = [abs(tone.frequency_hz - hertz) <= reach for tone, reach in zip(tones, reaches, strict=True)]
        words = f"{len(group)} recordings hold it at {mains} times one mains frequency"
        if len(group) >= NUMBERS.least_speeds:
            tones = [
                replace(tone, kind="mains", evidence=words) if beside and "order" in tone.kind else tone
                for tone, beside in zip(tones, near, strict=True)
            ]
        if not any(near) and mains not in held_by_orders:
            tones.append(_as_tone(hertz, group, words))
    return replace(modal, tones=tuple(sorted(tones, key=lambda tone: tone.frequency_hz)))


def _as_tone(hertz: float, group: Sequence[LineSeen], words: str) -> Tone:
    """A tone at ``hertz``, as large as the recordings of ``group`` hold it together, in the channels that show it.

    Of its amplitude their own errors count, and their scatter.
    """
    seconds = min(float(np.ptp(seen.held.time_s)) for seen in group)
    wander = max(float(np.std([seen.hertz for seen in group])), 0.05 / max(seconds, 1.0))
    size, error = (np.array([getattr(seen.sighting, key) for seen in group]) for key in ("amplitude", "error"))
    mean, own = np.sqrt(np.mean(size**2, axis=0)), np.sqrt(np.mean(error**2, axis=0) / len(size))
    error = np.hypot(own, size.std(axis=0) / np.sqrt(max(len(size) - 1, 1)))
    columns = zip(group[0].held.channels, mean.tolist(), error.tolist(), own.tolist(), strict=True)
    shown = {name: (amplitude, whole) for name, amplitude, whole, own_error in columns if amplitude > Z95 * own_error}
    return Tone(hertz, wander, "mains", shown, words)


MOTOR_NUMBERS = MethodNumbers("5-identify-explain.toml", "motors")

STATED_REACH = Z95 * ORDER_LOCK.stated_speed_error
"""Share by which a stated speed may be off."""


class Measured(NamedTuple):
    """A frequency in Hz and its standard error."""

    hertz: float
    error_hz: float


class MotorSeen(NamedTuple):
    """``record`` of a motor, its ``lines`` in recordings, and why a stated speed is not that of the shaft, or None."""

    record: MotorRecord
    lines: tuple[LineSeen, ...]
    speed_doubt: str | None


def motor_seen(motor: Motor, held: Sequence[HeldFrames], *, by_shaft: bool, settings: IdentifySettings) -> MotorSeen:
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
    supply: Measured | None = None
    if measured:  # the error of the mean is no less than the scatter of recordings
        hertz, error = np.array(measured).T
        scatter = float(max(np.sum(error**-2) ** -0.5, hertz.std()))
        supply = Measured(float(np.average(hertz, weights=error**-2)), scatter)
    elif motor.supply_hz is not None:
        supply = Measured(motor.supply_hz, settings.mains_tolerance_hz / Z95)
    lines = [line for line in motor_lines(motor) if (measured or line.mains == 0) and (by_shaft or line.turns == 0.0)]
    speeds: list[MotorSpeed] = []
    seen: list[LineSeen] = []
    doubts: list[tuple[float, float]] = []
    for recording, own in zip(held, supplies, strict=True):
        at = own or supply
        speed = None if at is None else _speed(motor, recording, at, by_shaft=by_shaft)
        if speed is not None:
            speeds.append(speed)
            if abs(speed.speed_rpm / recording.rpm - 1.0) > STATED_REACH:
                doubts.append((recording.rpm, speed.speed_rpm))
        if speed is None or speed.fits:
            seen += _seen_in(recording, lines, 0.0 if at is None else at.hertz)
    fits = not speeds or any(speed.fits for speed in speeds)
    record = MotorRecord(
        supply_hz=None if supply is None else supply.hertz,
        supply_hz_ci95=None if supply is None else positive_interval(supply.hertz, Z95 * supply.error_hz),
        supply_measured=bool(measured),
        poles=motor.poles,
        rotor_bars=motor.rotor_bars,
        misfit="" if fits or supply is None else _misfit(motor, speeds, supply.hertz),
        speeds=tuple(speeds),
        lines=tuple(_records(seen)),
    )
    if not doubts:
        return MotorSeen(record, tuple(seen), None)
    stated, read = (" and ".join(f"{rpm:.5g}" for rpm in dict.fromkeys(column)) for column in zip(*doubts, strict=True))
    where = f" in {len(doubts)} recordings" if len(doubts) > 1 else ""
    doubt = f"{stated} rpm is stated, and the line just below the motor's field tells {read} rpm{where}"
    return MotorSeen(record, tuple(seen), doubt)


def _supply(motor: Motor, held: HeldFrames, by_shaft: bool, settings: IdentifySettings) -> Measured | None:
    """Supply frequency by its double or itself; None where neither is there.

    A stated speed is often the field's, whose multiples are at the mains: they are no orders of the shaft.
    """
    for multiple in (2, 1) if motor.supply_hz is not None else ():
        middle = multiple * float(motor.supply_hz or 0.0)
        reach = float(nearest_multiple(middle, middle / multiple, settings=settings)[1])
        line = found_near(held, middle - reach, middle + reach, known=None if by_shaft else [])
        if line is not None:
            hertz, error = line
            return Measured(hertz / multiple, max(error / multiple, 1e-6))
    return None


def _speed(motor: Motor, held: HeldFrames, supply: Measured, *, by_shaft: bool) -> MotorSpeed | None:
    """What the motor does in one recording; None without poles, or where nothing tells its speed."""
    if motor.poles is None:
        return None
    stated = Measured(held.rpm * motor.shaft_ratio / 60.0, 0.0)
    shaft = stated if by_shaft else _line_below_field(motor, held, supply.hertz)
    if shaft is None:
        return None
    synchronous_rpm = motor.synchronous_rpm(supply.hertz)
    slip = 1.0 - 60.0 * shaft.hertz / synchronous_rpm
    half = Z95 * float(np.hypot(supply.error_hz / supply.hertz, shaft.error_hz / shaft.hertz))
    return MotorSpeed(
        speed_rpm=60.0 * shaft.hertz / motor.shaft_ratio,
        synchronous_rpm=synchronous_rpm,
        slip=slip,
        slip_ci95=(slip - half, slip + half),
        pole_pass_hz=2.0 * slip * supply.hertz,
        fits=slip + half >= 0.0 and slip - half <= USUAL_SLIP,
    )


def _line_below_field(motor: Motor, held: HeldFrames, supply_hz: float) -> Measured | None:
    """The line between the slowest rotor and its field that is the motor's shaft; None: none, or several.

    That at the stated speed is, where there is one, whatever another machine adds; else the only one.
    """
    field_hz = motor.synchronous_rpm(supply_hz) / 60.0
    slowest_hz, stated_hz = (1.0 - USUAL_SLIP) * field_hz, held.rpm * motor.shaft_ratio / 60.0
    low, high = max(slowest_hz, stated_hz * (1.0 - STATED_REACH)), min(field_hz, stated_hz * (1.0 + STATED_REACH))
    places = mains = [Place(supply_hz)]

    def line_within(begin_hz: float, end_hz: float) -> Measured | None:
        line = found_near(held, begin_hz, end_hz, known=places) if begin_hz < end_hz else None
        return None if line is None else Measured(*line)

    line = line_within(slowest_hz, field_hz)
    if line is None or low <= line.hertz <= high:
        return line
    places = [*mains, Place(line.hertz)]
    if (stated := line_within(low, high)) is not None:
        return stated
    if (other := line_within(slowest_hz, field_hz)) is not None:
        pair = sightings(held, [Place(line.hertz), Place(other.hertz), *mains])[:2]
        first, second = (0.0 if sighting is None else float(sighting.amplitude.max()) for sighting in pair)
        if second * MOTOR_NUMBERS.stands_out_ratio > first:
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


def _seen_in(held: HeldFrames, lines: Sequence[MotorLine], supply_hz: float) -> Iterator[LineSeen]:
    """Those of the ``lines`` that stand in the recording ``held``, with what else may stand there."""
    places = [Place(line.mains * supply_hz, line.turns) for line in lines]
    at_places = sightings(held, places)
    orders, shown = np.array([held.order_of(place) for place in places]), dict[int, LineSeen]()
    for number, (line, sighting) in enumerate(zip(lines, at_places, strict=True)):
        if sighting is None or not sighting.seen:
            continue
        # other lines, and the order of the shaft, so near that the recording does not part them
        near = np.abs(orders - orders[number]) * held.span_rev < JOINT_LINES.apart_cycles
        others = [(k, lines[k]) for k in np.flatnonzero(near).tolist() if k != number and at_places[k] is not None]
        also, whole = tuple(other for _, other in others if other.of != line.name), float(round(orders[number]))
        beside = whole >= 1.0 and abs(orders[number] - whole) * held.span_rev < JOINT_LINES.apart_cycles
        on_order = whole if beside and (line.mains != 0 or line.of != "") else None
        shown[number] = LineSeen(line, held, line.hertz_at(supply_hz, held.rpm), sighting, also, on_order)
    carriers = {seen.line.name for seen in shown.values()} | {SHAFT}
    for number, seen in shown.items():
        if seen.line.of and seen.line.of not in carriers:
            continue
        partner = [k for k in shown if k != number and seen.line.of and lines[k].name == seen.line.name]
        if seen.alone or not seen.line.of or any(shown[k].alone for k in partner):
            yield seen


def _records(lines: Sequence[LineSeen]) -> Iterator[LineRecord]:
    """One record per line and channel, of the recording in which it is largest."""
    shown: dict[tuple[str, int, float, str], list[tuple[float, float, LineSeen]]] = {}
    for seen in lines:
        sizes = zip(seen.held.channels, seen.sighting.amplitude.tolist(), seen.sighting.error.tolist(), strict=True)
        for channel, size, error in sizes:
            if size >= Z95 * error:
                key = seen.line.name, seen.line.mains, seen.line.turns, channel
                shown.setdefault(key, []).append((size, error, seen))
    for (*_, channel), group in shown.items():
        size, error, largest = max(group, key=lambda sized: sized[0])
        yield LineRecord(
            name=largest.name,
            side=largest.line.side,
            channel=channel,
            frequency_hz=largest.hertz,
            order=largest.sighting.order,
            speed_rpm=largest.held.rpm,
            amplitude=size,
            amplitude_ci95=size_interval(size, Z95 * error),
            others=largest.others,
            n_recordings=len(group),
        )
