"""Lines of an induction motor, and strays of the mains at several speeds, where the frames hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import xarray as xr

from crankorder.engine.motor import USUAL_SLIP, Motor, MotorLine, motor_lines
from crankorder.identify.found import AgreedOrder, ModalFit, Mode, Tone
from crankorder.identify.intervals import Z95, half_width
from crankorder.identify.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.known_lines import Held, Place, Sighting, found_near, held_recordings, sightings
from crankorder.identify.lines.line_phasors import recordings_of
from crankorder.identify.lines.order_lock import NUMBERS as ORDER_LOCK
from crankorder.identify.lines.order_lock import speed_source
from crankorder.identify.mains import NUMBERS as MAINS
from crankorder.identify.mains import mains_words
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="motors"):
    same_hz: float
    least_speeds: int
    most_multiples: int
    moved_cycles: float
    same_speed_share: float
    same_place_orders: float
    most_share: float
    rings_within: float
    rings_share: float


NUMBERS = _Numbers.load()


@dataclass(frozen=True)
class MotorSpeed:
    """What the motor does in one recording: crank and synchronous speed (of the motor's shaft) in rpm, its slip.

    ``slip`` with the half width of its 95 % interval is a share; ``pole_pass_hz`` is 2 x slip x supply.
    """

    speed_rpm: float
    synchronous_rpm: float
    slip: float
    slip_half: float
    pole_pass_hz: float

    @property
    def fits(self) -> bool:
        """Whether a motor that drives may slip so."""
        return self.slip + self.slip_half >= 0.0 and self.slip - self.slip_half <= USUAL_SLIP


@dataclass(frozen=True, eq=False)
class LineSeen:
    """A known line in one recording: its order, frequency and amplitudes; ``also``: what else may stand there."""

    line: MotorLine
    held: Held
    hertz: float
    sighting: Sighting
    also: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class MotorFound:
    """A stated ``motor`` as the recordings show it: supply in Hz with its half width, measured or as stated.

    ``speeds`` are those of the recordings; ``misfit`` says, where it is not empty, why no line is named,
    ``speed_doubt`` why the slip is not known, ``bars_doubt`` why the stated rotor bars may be wrong. ``least`` are
    lines that are not there: name, channel, and the amplitude from which they would have been seen.
    """

    motor: Motor
    supply_hz: float | None
    supply_half_hz: float
    measured: bool
    speeds: tuple[MotorSpeed, ...]
    seen: tuple[LineSeen, ...]
    misfit: str = ""
    speed_doubt: str = ""
    bars_doubt: str = ""
    least: tuple[tuple[str, str, float], ...] = ()


def held_of(frames: Sequence[xr.Dataset], order_map: xr.Dataset) -> list[Held]:
    """The recordings of ``frames`` (their OrderFrames) at held speeds, with the orders of ``order_map``."""
    if order_map.attrs.get("window", "hann") != "hann":
        return []
    names = [str(name) for name in order_map["channel"].values]
    return held_recordings(recordings_of(frames), np.asarray(order_map["order"].values, dtype=np.float64), names)


def mains_seen(held: Sequence[Held], *, settings: IdentifySettings) -> tuple[LineSeen, ...]:
    """Mains and twice mains, where several recordings of ``held`` at different speeds show one and the same frequency.

    ``settings``: the mains frequencies and how far they wander.
    """
    made: list[LineSeen] = []
    for mains in settings.mains_hz:
        base = None
        for multiple in range(1, NUMBERS.most_multiples + 1):
            middle, reach = multiple * mains, settings.mains_tolerance_hz * float(np.sqrt(multiple))
            if multiple > MAINS.alone_multiples:
                if base is None:
                    break
                middle, reach = multiple * base, NUMBERS.same_hz
            found = _one_frequency(held, middle - reach, middle + reach, multiple * NUMBERS.same_hz)
            line = MotorLine(mains_words(multiple), multiple, 0.0)
            if found:
                base = float(np.median([hertz for _, hertz in found])) / multiple
            made += [
                LineSeen(line, one, hertz, sighting)
                for one, hertz in found
                if (sighting := sightings(one, [(hertz, 0.0)])[0]) is not None
            ]
    return tuple(made)


def _one_frequency(held: Sequence[Held], low_hz: float, high_hz: float, same_hz: float) -> list[tuple[Held, float]]:
    """Recordings, with the frequency, that show a line at one and the same one, where orders of the shaft move."""
    found = [(one, near[0]) for one in held if (near := found_near(one, low_hz, high_hz, [])) is not None]
    middle = float(np.median([hertz for _, hertz in found])) if found else 0.0
    found = [(one, hertz) for one, hertz in found if abs(hertz - middle) <= same_hz]
    moves = any(_moves(a[0], b[0], middle) for a, b in combinations(found, 2))
    return found if len(found) >= NUMBERS.least_speeds and moves else []


def _moves(one: Held, other: Held, hertz: float) -> bool:
    """Whether an order that is at ``hertz`` in ``one`` is somewhere else in the ``other``."""
    apart = abs(one.order_of((hertz, 0.0)) - other.order_of((hertz, 0.0)))
    return apart * min(one.span_rev, other.span_rev) > NUMBERS.moved_cycles


def motor_found(motor: Motor, held: Sequence[Held], order_map: xr.Dataset, *, settings: IdentifySettings) -> MotorFound:
    """``motor`` as the recordings ``held`` of the test of ``order_map`` show it.

    The supply is measured by its own line and its double, near what is stated; the slip of each recording follows from
    it and from the speed. Lines are named where they stand above the noise; a sideband that stands on an order of the
    shaft only where the one on the other side is there too, and then both are said.
    ``settings``: how far mains wander.
    """
    stated = speed_source([order_map]) == "stated"
    supplies = [_supply(motor, one, settings) for one in held]
    told = [item for item in supplies if item is not None]
    supply = float(np.average([f for f, _ in told], weights=[e**-2 for _, e in told])) if told else motor.supply_hz
    half = settings.mains_tolerance_hz
    if told:
        half = Z95 * max(float(np.sqrt(1.0 / np.sum([e**-2 for _, e in told]))), float(np.std([f for f, _ in told])))
    made = MotorFound(motor, supply, half if supply is not None else 0.0, bool(told), (), ())
    if supply is None or motor.poles is None:
        return replace(made, seen=_all_seen(motor, held, [supply or 0.0] * len(held), stated, bool(told)))
    own = [item[0] if item is not None else supply for item in supplies]
    speeds = tuple(
        _speed(motor, one, f, half if one_told is None else Z95 * one_told[1], stated)
        for one, f, one_told in zip(held, own, supplies, strict=True)
    )
    good = [number for number, speed in enumerate(speeds) if speed.fits]
    if speeds and not good:
        return replace(made, speeds=speeds, misfit=_misfit(motor, speeds, supply, stated=stated))
    chosen, with_f = [held[k] for k in good], [own[k] for k in good]
    seen = _all_seen(motor, chosen, with_f, stated, bool(told))
    least = () if stated or not told else _least(motor, chosen, with_f, seen)
    return replace(made, speeds=speeds, seen=seen, least=least)


def _least(
    motor: Motor, held: Sequence[Held], supplies: Sequence[float], seen: Sequence[LineSeen]
) -> tuple[tuple[str, str, float], ...]:
    """Pole-pass sidebands that no recording shows: name, channel, and what they would have been seen from.

    Only where every recording parts them from what they stand beside and from the orders of the shaft.
    """
    shown = {item.line.name for item in seen}
    limits: dict[tuple[str, str], list[float]] = {}
    for one, supply in zip(held, supplies, strict=True):
        lines = motor_lines(motor)
        places: list[Place] = [(line.mains * supply, line.turns) for line in lines]
        found = sightings(one, places)
        for number, (line, sighting) in enumerate(zip(lines, found, strict=True)):
            if not line.name.startswith("pole-pass") or line.name in shown or sighting is None:
                continue
            if _also(one, number, lines, places, found):
                continue
            for channel, error in zip(one.channels, sighting.error, strict=True):
                limits.setdefault((line.name, channel), []).append(KNOWN_LINES.seen_sigmas * float(error))
    return tuple((name, channel, max(values)) for (name, channel), values in limits.items())


def _supply(motor: Motor, held: Held, settings: IdentifySettings) -> tuple[float, float] | None:
    """Supply frequency in Hz and its error by its double or itself; None where neither is there."""
    if motor.supply_hz is None:
        return None
    for multiple in (2, 1):
        reach = settings.mains_tolerance_hz * np.sqrt(multiple)
        middle = multiple * motor.supply_hz
        found = found_near(held, middle - reach, middle + reach, [])
        if found is not None:
            return found[0] / multiple, max(found[1] / multiple, 1e-6)
    return None


def _speed(motor: Motor, held: Held, supply_hz: float, supply_half_hz: float, stated: bool) -> MotorSpeed:
    synchronous = motor.synchronous_rpm(supply_hz)
    slip = 1.0 - held.rpm * motor.shaft_ratio / synchronous
    unsure = Z95 * ORDER_LOCK.stated_speed_error if stated else 0.0
    slip_half = float(np.hypot(supply_half_hz / supply_hz, unsure))
    return MotorSpeed(held.rpm, synchronous, slip, slip_half, 2.0 * slip * supply_hz)


def _misfit(motor: Motor, speeds: tuple[MotorSpeed, ...], supply_hz: float, *, stated: bool) -> str:
    worst = max(speeds, key=lambda one: abs(one.slip))
    turns = worst.speed_rpm * motor.shaft_ratio
    way = "faster than" if worst.slip < 0.0 else f"{100.0 * worst.slip:.3g} % below"
    or_stated = ", the stated speed is wrong" if stated else ""
    return (
        f"the motor would turn at {turns:.4g} rpm, {way} the {worst.synchronous_rpm:.4g} rpm of {motor.poles} poles at "
        f"{supply_hz:.4g} Hz: the poles, shaft_ratio or supply_hz do not fit{or_stated}, or it is driven"
    )


def _all_seen(
    motor: Motor, held: Sequence[Held], supplies: Sequence[float], stated: bool, measured: bool
) -> tuple[LineSeen, ...]:
    lines = [line for line in motor_lines(motor) if measured or line.mains == 0]
    if stated:  # the true speed is some tenths of a percent off: only what needs none of it has a place
        lines = [line for line in lines if line.turns == 0.0]
    made: list[LineSeen] = []
    for one, supply in zip(held, supplies, strict=True):
        made += _seen_in(one, lines, supply)
    return tuple(made)


def _seen_in(held: Held, lines: Sequence[MotorLine], supply_hz: float) -> list[LineSeen]:
    places: list[Place] = [(line.mains * supply_hz, line.turns) for line in lines]
    found = sightings(held, places)
    shown = {
        number: LineSeen(
            line, held, line.hertz_at(supply_hz, held.rpm), sighting, _also(held, number, lines, places, found)
        )
        for number, (line, sighting) in enumerate(zip(lines, found, strict=True))
        if sighting is not None and sighting.seen
    }
    carriers = {item.line.name for item in shown.values()} | {"order 1 of the motor"}
    kept = []
    for number, item in shown.items():
        if item.line.of and item.line.of not in carriers:
            continue
        partner = [k for k in shown if k != number and item.line.of and lines[k].name == item.line.name]
        if item.also and item.line.of and not any(not shown[k].also for k in partner):
            continue
        kept.append(item)
    return kept


def _also(
    held: Held,
    number: int,
    lines: Sequence[MotorLine],
    places: Sequence[Place],
    found: Sequence[Sighting | None],
) -> tuple[str, ...]:
    """What else stands so near to line ``number`` that the recording does not tell them apart."""
    order = held.order_of(places[number])
    names = [
        line.name
        for other, line in enumerate(lines)
        if other != number
        and line.of != lines[number].name
        and found[other] is not None
        and abs(held.order_of(places[other]) - order) * held.span_rev < KNOWN_LINES.apart_cycles
    ]
    whole = round(order)
    fixed = lines[number].mains != 0 or lines[number].of != ""
    if fixed and whole >= 1 and abs(order - whole) * held.span_rev < KNOWN_LINES.apart_cycles:
        names.append(f"order {whole}")
    return tuple(dict.fromkeys(names))


def named_by(seen: Sequence[LineSeen], agreed: AgreedOrder) -> LineSeen | None:
    """The one of ``seen`` that the order ``agreed`` is: at its order, in a recording at its speeds.

    Of several, which only lines of a large error have, the one whose amplitudes at the speeds are most like its own.
    """
    unlike: dict[tuple[str, int, float], list[tuple[float, LineSeen]]] = {}
    for item in seen:
        size = _size_at(agreed, item.held.rpm)
        if size is None or not _is_at(item, agreed) or not _goes_with(item, agreed):
            continue
        away = abs(float(np.log(max(float(item.sighting.amplitude.max()), 1e-300) / max(size, 1e-300))))
        unlike.setdefault((item.line.name, item.line.mains, item.line.turns), []).append((away, item))
    if not unlike:
        return None
    best = min(unlike.values(), key=lambda found: float(np.mean([away for away, _ in found])))
    return max((item for _, item in best), key=lambda item: float(item.sighting.amplitude.max()))


def _size_at(agreed: AgreedOrder, rpm: float) -> float | None:
    """Largest amplitude of an order at the speed ``rpm``; None where it was not seen there."""
    at = [
        float(size)
        for line in agreed.lines
        for speed, size in zip(line.speed_rpm, line.amplitude, strict=True)
        if abs(speed - rpm) <= NUMBERS.same_speed_share * rpm
    ]
    return max(at, default=None)


def _is_at(item: LineSeen, agreed: AgreedOrder) -> bool:
    if agreed.lock == "locked":
        return _stands_on(item, agreed.order)
    reach = half_width(agreed.degrees_of_freedom) * agreed.order_error
    return abs(item.sighting.order - agreed.order) <= max(reach, KNOWN_LINES.apart_cycles / item.held.span_rev)


def _goes_with(item: LineSeen, agreed: AgreedOrder) -> bool:
    """Whether ``item`` stands at the order at most of the speeds at which that was seen: what is fixed leaves it."""
    fixed_hz = item.hertz - item.line.turns * item.held.rpm / 60.0
    speeds = np.unique(np.concatenate([line.speed_rpm for line in agreed.lines]))
    at = item.line.turns + 60.0 * fixed_hz / speeds
    return bool(np.mean(np.abs(at - agreed.order) < NUMBERS.same_place_orders) >= NUMBERS.most_share)


def _stands_on(item: LineSeen, order: float) -> bool:
    """Whether a locked ``order`` is that of ``item``: a whole one of the rotor, or where both are said."""
    exact = item.line.mains == 0 and not item.line.of
    return (exact or bool(item.also)) and abs(
        item.sighting.order - order
    ) * item.held.span_rev < KNOWN_LINES.apart_cycles


def without_known(modal: ModalFit, known: Sequence[LineSeen]) -> ModalFit:
    """``modal`` without modes that are undecided and stand where one of the ``known`` lines does: these explain them.

    Only where no order's response was fitted through the modes: there each of them takes part in what is said.
    """
    if modal.responses or not known:
        return modal
    kept = [
        number
        for number, mode in enumerate(modal.modes)
        if not mode.undecided or not any(_within(mode.frequency_ends, item.hertz) for item in known)
    ]
    at = np.array([[2 * number, 2 * number + 1] for number in kept], dtype=np.int64).ravel()
    covariance = modal.covariance[np.ix_(at, at)] if len(kept) < len(modal.modes) else modal.covariance
    return replace(modal, modes=tuple(modal.modes[number] for number in kept), covariance=covariance)


def without_ringing(known: Sequence[LineSeen], modes: Sequence[Mode]) -> tuple[LineSeen, ...]:
    """``known`` lines without those of the mains that are but how one of the ``modes`` rings, each recording its way.

    A supply has one frequency; what noise rings in a mode peaks anywhere within the mode's width.
    """
    fixed: dict[int, list[LineSeen]] = {}
    for item in known:
        if item.line.turns == 0.0:
            fixed.setdefault(item.line.mains, []).append(item)
    rung = {multiple for multiple, items in fixed.items() if any(_rings(mode, items) for mode in modes)}
    return tuple(item for item in known if item.line.turns != 0.0 or item.line.mains not in rung)


def _rings(mode: Mode, items: Sequence[LineSeen]) -> bool:
    """Whether the frequencies of ``items`` scatter about that of the ``mode`` as its ringing would."""
    hertz, half = np.array([item.hertz for item in items]), mode.damping_ratio * mode.frequency_hz
    away = abs(float(np.median(hertz)) - mode.frequency_hz)
    near = away <= NUMBERS.rings_within * half + mode.frequency_half_hz
    return bool(not mode.undecided and near and hertz.std() > NUMBERS.rings_share * half)


def with_mains_tones(modal: ModalFit, known: Sequence[LineSeen], orders: Sequence[AgreedOrder]) -> ModalFit:
    """``modal`` with the mains among the ``known`` lines as tones, where no tone of it and none of the ``orders`` is.

    A tone there that may be an order at the speeds of the test is none: where the shaft's orders moved it has stayed.
    """
    tones = list(modal.tones)
    fixed: dict[int, list[LineSeen]] = {}
    for item in known:
        if item.line.turns == 0.0 and not item.also:
            fixed.setdefault(item.line.mains, []).append(item)
    held_by_orders = {named.line.mains for one in orders if (named := named_by(known, one)) and not named.line.turns}
    for mains, items in fixed.items():
        hertz = float(np.median([item.hertz for item in items]))
        near = [
            number
            for number, tone in enumerate(tones)
            if abs(tone.frequency_hz - hertz) <= max(NUMBERS.same_hz, Z95 * tone.frequency_error_hz)
        ]
        words = f"{len(items)} recordings hold it at {mains} times one mains frequency"
        for number in near:
            if tones[number].kind == "order" and len(items) >= NUMBERS.least_speeds:
                tones[number] = replace(tones[number], kind="mains", evidence=words)
        if not near and mains not in held_by_orders:
            tones.append(_as_tone(hertz, items, words))
    return replace(modal, tones=tuple(sorted(tones, key=lambda tone: tone.frequency_hz)))


def _as_tone(hertz: float, items: Sequence[LineSeen], words: str) -> Tone:
    """A tone at ``hertz``, as large as the recordings of ``items`` hold it together."""
    size = np.array([item.sighting.amplitude for item in items])
    error = np.array([item.sighting.error for item in items])
    mean, own = np.sqrt(np.mean(size**2, axis=0)), np.sqrt(np.mean(error**2, axis=0) / len(items))
    spread = size.std(axis=0) / np.sqrt(max(len(items) - 1, 1))
    seconds = min(float(np.ptp(item.held.time_s)) for item in items)
    wander = max(float(np.std([item.hertz for item in items])), 0.05 / max(seconds, 1.0))
    amplitude = {
        name: (float(mean[k]), float(np.hypot(own[k], spread[k])))
        for k, name in enumerate(items[0].held.channels)
        if mean[k] > Z95 * own[k]
    }
    return Tone(hertz, wander, "mains", amplitude, words)


def _within(ends: tuple[float, float], hertz: float) -> bool:
    return ends[0] - NUMBERS.same_hz <= hertz <= ends[1] + NUMBERS.same_hz


def words_of(item: LineSeen) -> str:
    """What the line ``item`` is called."""
    name = item.line.name
    return name if item.line.turns == 0.0 and not item.line.of else f"motor, {name}"
