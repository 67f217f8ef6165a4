"""What makes a line: engine kinematics, a bearing, the gas cycle, mains, another line, or nothing known."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from crankorder.cause import Cause, CauseKind, alike_speeds, of_mains, of_order
from crankorder.findings import BearingFinding, Lock
from crankorder.identify.found import AgreedOrder, AgreedOrders, ModalFit, Mode, OrderLine, Tone
from crankorder.identify.lines.growth import NO_MOTION, largest, order_one
from crankorder.identify.lines.known_lines import LineSeen, named_by
from crankorder.identify.lines.line_evidence import ShownAlias
from crankorder.identify.lines.line_phasors import nearest_multiple
from crankorder.identify.lines.mains import mains_orders, multiple_on, multiples_near, supply_told
from crankorder.identify.machine_model import (
    MachineModel,
    PartsAt,
    StatedPart,
    cycle_forces,
    gas_half_orders,
    parts_at,
)
from crankorder.identify.modes.tones import NUMBERS as TONES
from crankorder.identify.sidebands import (
    BY_ITSELF,
    LineCauses,
    StruckRace,
    explain_families,
    race_cause,
    sideband_of,
    sidebands,
    spacings_of,
    struck_races,
)
from crankorder.orders.intervals import half_width
from crankorder.orders.joint_lines import NUMBERS as JOINT_LINES
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "explain")

OF_NUMBER: tuple[CauseKind, ...] = (
    "unbalance",
    "unbalance, bent shaft or misalignment",
    "shaft harmonic",
    "half order of the four-stroke cycle",
)
"""Causes of a line that is an order of the shaft for no other reason than that it is one."""

_PROOF: dict[Lock, str] = {
    "locked": "locked to the shaft",
    "undecided": "may be locked to the shaft",
    "slips": "not locked to the shaft",
}


class Causes(NamedTuple):
    """One cause for every line: ``orders`` by channel and AgreedOrder.order, ``modes`` and ``tones`` as in ModalFit."""

    orders: LineCauses
    modes: tuple[Cause, ...]
    tones: tuple[Cause, ...]


@dataclass(frozen=True)
class Beside:
    """What else was found of a test.

    Channels ``in_cylinder`` measure the pressure in one; ``folds``: what folds (``shown_aliases``); ``known`` lines
    of the motor and of the mains that the frames hold where they were expected; ``of_swing``: lines that swings of the
    angle may make; ``longest_rev``: revolutions of the longest recording at one speed, in which two lines that beat
    less often look like one; ``rows``: lines by channel and order with the amplitudes of their tracks.
    """

    in_cylinder: Collection[str] = ()
    folds: Sequence[ShownAlias] = ()
    known: Sequence[LineSeen] = ()
    of_swing: LineCauses = field(default_factory=dict)
    longest_rev: float = np.inf
    rows: Mapping[tuple[str, float], OrderLine] = field(default_factory=dict)


@dataclass(frozen=True)
class _Test:
    """What the rules know of a test: its ``orders``, the machine, and what was found of it before.

    ``races`` that are struck, ``folds`` that show, ``modes``; ``of_cycle`` by order the
    multiple of the cycle's order that it is or may be, or None.
    """

    orders: AgreedOrders
    machine: MachineModel
    races: list[StruckRace]
    folds: Sequence[ShownAlias]
    modes: Sequence[Mode]
    of_cycle: dict[float, float | None]


class _Line(NamedTuple):
    """What the rules know of one line: ``of_cycle`` is the multiple of the cycle's order that it is or may be, or None.

    ``at`` are the stated parts there; ``in_cylinder``: whether its channel is the pressure in a cylinder.
    """

    agreed: AgreedOrder
    line: OrderLine
    at: PartsAt
    of_cycle: float | None
    quantity: str
    in_cylinder: bool

    @property
    def proof(self) -> str:
        """What is known of its lock, in words."""
        return _PROOF[self.agreed.lock]


def explained(
    orders: AgreedOrders,
    modal: ModalFit,
    bearings: Sequence[BearingFinding],
    *,
    sources: MachineModel,
    quantity: dict[str, str],
    settings: IdentifySettings,
    beside: Beside | None = None,
) -> Causes:
    """One cause for every order line in every channel, and for every mode and tone.

    The first of the :data:`RULES` that the evidence supports; then what lines of the motor and the mains, swings of the
    angle and other lines say of it. What is left is unexplained. A line that slips is no multiple of the cycle, one
    that is locked is no race of a bearing.

    Parameters
    ----------
    orders : the orders of the test as the order map shows them
    modal : its modes and tones
    bearings : findings of ``bearing_records``: ``name``, ``line``, ``order``, ``order_ci95``, ``lock`` count
    sources : what is known of the machine
    quantity : quantity of each channel by its name, such as "acceleration" or "sound pressure"
    settings : mains frequencies and how far they wander
    beside : what else was found of the test
    """
    causes, beside = LineCauses(), beside or Beside()
    races = struck_races(bearings, sources, [(agreed.order, agreed.order_error) for agreed in orders])
    of_cycle = {agreed.order: multiple_of_cycle(agreed, sources.revs_per_cycle) for agreed in orders}
    test = _Test(orders, sources, races, beside.folds, modal.modes, of_cycle)
    for agreed in orders:
        at = _stated_parts(agreed, bearings, test)
        for line in agreed.lines:
            key = line.channel, agreed.order
            pressure = line.channel in beside.in_cylinder
            known_of = _Line(agreed, beside.rows.get(key, line), at, of_cycle[agreed.order], quantity[key[0]], pressure)
            by_rules = (cause for rule in RULES if (cause := rule(known_of, test)) is not None)
            causes[key] = next(by_rules, None) or _unexplained(known_of, test)
    swung = beside.of_swing.items()
    causes |= {key: cause for key, cause in swung if causes[key].is_just(*BY_ITSELF, *OF_NUMBER)}
    causes |= _electric(causes, test, modal.tones, beside, settings)
    spacings, modes_hz = spacings_of(sources, bearings), [mode.frequency_hz for mode in modal.modes]
    causes |= explain_families(orders, causes, of_cycle, spacings=spacings, modes_hz=modes_hz, of_swing=beside.of_swing)
    rpm = _one_speed(orders)
    modes = tuple(_of_mode(mode, races, rpm) for mode in modal.modes)
    return Causes(causes, modes, tuple(_explained_tones(modal.tones, test, rpm, beside.known, settings)))


def _electric(
    causes: LineCauses, test: _Test, tones: Sequence[Tone], beside: Beside, settings: IdentifySettings
) -> LineCauses:
    """Those of ``causes`` that change where a line is one of the mains or the motor, or may be: both if they coincide.

    A line is or may be a multiple of the cycle also where no recording parts it from one beside it.
    """
    of_cycle, per_rev = dict(test.of_cycle), test.machine.revs_per_cycle
    for agreed in test.orders if np.isfinite(beside.longest_rev) else ():
        nearest = nearest_multiple(agreed.order, revs_per_cycle=per_rev)
        near = abs(agreed.order - nearest) * beside.longest_rev < JOINT_LINES.apart_cycles
        if near and of_cycle[agreed.order] is None and agreed.lock == "undecided":
            of_cycle[agreed.order] = nearest
    mains = [tone for tone in tones if tone.kind == "mains"]
    exact = [order for order, multiple in of_cycle.items() if multiple is not None]
    # what errors of the angle may make beside a strong order has a cause that nothing tells from mains
    lines = tuple(agreed for agreed in test.orders if not agreed.of_angle)
    electric, sure = mains_orders(lines, tones=mains, exact=exact, settings=settings), set[float]()
    for agreed in test.orders:
        seen = named_by(beside.known, agreed)
        in_doubt = agreed.order in electric and "another tone" in electric[agreed.order].kinds
        if seen is not None and not in_doubt:
            where = f"{seen.hertz:.6g} Hz at {seen.held.rpm:.5g} rpm"
            electric[agreed.order] = seen.cause(f"{where}, where it was expected")
            sure |= {agreed.order} if seen.alone else set()
    changed = LineCauses()
    for (channel, order), cause in causes.items():
        maker, multiple, is_sure = electric.get(order), of_cycle[order], order in sure
        if maker is None:
            continue
        if not cause.known or (is_sure and cause.is_just(*OF_NUMBER)):
            either = is_sure or multiple is None
            changed[channel, order] = maker if either else maker.either(of_order(f"order {multiple:g}"))
        elif multiple is None or cause.is_just(*OF_NUMBER) or is_sure:
            changed[channel, order] = replace(cause.either(maker), evidence=f"{maker.evidence}; {cause.evidence}")
    return changed


def multiple_of_cycle(agreed: AgreedOrder, revs_per_cycle: int) -> float | None:
    """Multiple of the order of the cycle (1 / ``revs_per_cycle``) that ``agreed`` is or may be; None where it is none.

    A line that slips is none; one that is undecided is, if its 95 % interval holds it and would not hold one of four
    lines that lie anywhere. What errors of the crank angle may have made is none.
    """
    nearest, apart = nearest_multiple(agreed.order, revs_per_cycle=revs_per_cycle), 1.0 / revs_per_cycle
    if agreed.lock == "locked" and abs(agreed.order - nearest) < 0.25 * apart:
        return nearest
    half = half_width(agreed.degrees_of_freedom) * agreed.order_error + 1e-9
    is_none = agreed.lock == "slips" or agreed.of_angle or half > NUMBERS.vague_spacings * apart
    return None if is_none or abs(agreed.order - nearest) > half else nearest


def _gas_in_pressure(of: _Line, test: _Test) -> Cause | None:
    """The gas cycle in the pressure of a cylinder itself; a rotor has none, whatever its pressures are."""
    if not of.in_cylinder or of.of_cycle is None or not test.machine.has_pistons:
        return None
    cycle = "four-stroke cycle" if test.machine.revs_per_cycle == 2 else "cycle"
    return Cause("gas cycle", f"order {of.of_cycle:g}, a multiple of the {cycle}, in the pressure itself; {of.proof}")


def _gas_or_masses(of: _Line, test: _Test) -> Cause | None:
    """Which of a firing engine's gas and masses makes a line, or that either may."""
    engine = test.machine.engine
    if engine is None or not test.machine.firing or of.of_cycle is None:
        return None
    (force,) = cycle_forces(engine, [(of.of_cycle, largest(of.line).speed_rpm)])
    if force is None:
        return None
    evidence = f"{force.words}; {of.proof}"
    if force.maker == "masses":
        return Cause("engine kinematics", evidence)
    gas = Cause("gas cycle", evidence)
    return gas if force.maker == "gas" else gas.either(Cause("engine kinematics"))


def _kinematics(of: _Line, test: _Test) -> Cause | None:
    machine, cycle = test.machine, of.of_cycle
    if cycle is None or not any(abs(cycle - known) < 1e-6 for known in machine.engine_orders):
        return None
    masses = f"the engine's moving masses make order {cycle:g}"
    gas = "the engine fires" if machine.firing else ""
    if not gas and machine.revs_per_cycle == 2 and len(half := gas_half_orders(o.order for o in test.orders)) > 1:
        gas = f"half orders ({', '.join(half)}) show gas torque"
    if gas:
        unstated = "nothing that was stated tells how much of this order it makes"
        return Cause("gas cycle", f"{masses}; {gas}, and {unstated}; {of.proof}").either(Cause("engine kinematics"))
    return Cause("engine kinematics", f"{masses}; {of.proof}")


def _stated_parts(agreed: AgreedOrder, bearings: Sequence[BearingFinding], test: _Test) -> PartsAt:
    """The stated gears, and the lines of bearings by their records, that have a multiple where ``agreed`` lies.

    Of a bearing only the line itself may be a multiple of the cycle's order: some multiple of a rolling line is near
    one by chance.
    """
    elements = {bearing.name: bearing.rolling_elements for bearing in test.machine.bearings}
    parts, locked = [*test.machine.gears], agreed.lock == "locked"
    for record in bearings:
        if locked and record.line != "N*fs":
            continue  # what rolls slips: a locked line is no race's and no ball's
        part = StatedPart("bearing", f"{record.name} {record.line}", record.order, record.order_half)
        alone = test.of_cycle[agreed.order] is not None or record.seen_in == "envelope"
        like = elements.get(record.name) if locked else None
        parts.append(replace(part, most=1 if alone else part.most, elements=like))
    return parts_at(parts, agreed)


def _stated(at: PartsAt, kind: CauseKind, proof: str) -> Cause | None:
    """The parts ``at`` a line, if one is of the ``kind``."""
    if not any(part.kind == kind for part, _ in at.near):
        return None
    like = sorted({part.elements for part, _ in at.near if part.elements is not None})
    gears = [part for part, _ in at.near if part.kind == "gear mesh"]
    stated = [f"the manifest states {gear.name} at order {gear.order:g}" for gear in gears]
    cause = at.cause("; ".join([*(stated or ["within the interval of the bearing's line"]), proof]))
    names = " or ".join(f"{'an' if str(n).startswith(('8', '11', '18')) else 'a'} {n}-fold" for n in like)
    return cause.either(Cause("part of a shaft", parameters={"names": names})) if like else cause


def _first_order(of: _Line, test: _Test) -> Cause | None:
    """What order 1 is by how it grows; a harmonic of the shaft, or unexplained, where that is not as unbalance does."""
    if of.of_cycle != 1.0 or any(word in of.quantity for word in NO_MOTION):
        return None
    cause = order_one(of.line, of.quantity, test.modes)
    if cause.kind != "unexplained":
        return replace(cause, evidence=f"order 1, {of.proof}; {cause.evidence}")
    if test.machine.firing:
        return None
    kind: CauseKind = "unexplained" if test.machine.engine_orders else "shaft harmonic"
    return replace(cause, kind=kind, evidence=f"order 1, {of.proof}, but {cause.evidence}")


def _combustion(of: _Line, test: _Test) -> Cause | None:
    if not test.machine.firing or of.of_cycle is None:
        return None
    cycle = 1 / test.machine.revs_per_cycle
    return Cause("gas cycle", f"the engine fires, which makes every multiple of order {cycle:g}; {of.proof}")


def _race_harmonic(of: _Line, test: _Test) -> Cause | None:
    """Harmonic of a struck race or a sideband of one, which a line on a multiple of the cycle's order is not."""
    if of.of_cycle is not None or of.agreed.lock == "locked":
        return None
    return race_cause(test.races, of.agreed.order, of.agreed.order_error)


def _fold(of: _Line, test: _Test) -> Cause | None:
    fold = next((shown.fold for shown in test.folds if shown.is_line(of.line)), None)
    return None if fold is None else Cause("fold", fold.evidence, {"frequency_hz": fold.frequency_hz})


def _half_order(of: _Line, test: _Test) -> Cause | None:
    """Half orders of a four-stroke machine; of a motored engine only where there is more than one."""
    cycle = of.of_cycle
    if cycle is None or test.machine.revs_per_cycle != 2 or cycle == round(cycle):
        return None
    family = sorted({m for m in test.of_cycle.values() if m is not None and m != round(m)})
    if test.machine.engine_orders and len(family) < 2:
        return None
    listed = ", ".join(f"{m:g}" for m in family[:6])
    return Cause("half order of the four-stroke cycle", f"{of.proof}; half orders found: {listed}")


def _shaft_harmonic(of: _Line, test: _Test) -> Cause | None:
    if of.of_cycle is None or of.of_cycle != round(of.of_cycle) or test.machine.engine_orders:
        return None
    return Cause("shaft harmonic", f"whole order, {of.proof}")


RULES: tuple[Callable[[_Line, _Test], Cause | None], ...] = (
    _gas_in_pressure,
    _gas_or_masses,
    _kinematics,
    lambda of, _: _stated(of.at, "gear mesh", of.proof),
    _first_order,
    _combustion,
    lambda of, _: _stated(of.at, "bearing", of.proof),
    _race_harmonic,
    _fold,
    _half_order,
    _shaft_harmonic,
)
"""What a line may be by itself, in the order in which it is tried; None where the evidence does not support it."""


def _unexplained(of: _Line, test: _Test) -> Cause:
    agreed, machine = of.agreed, test.machine
    if of.at.unparted:
        names = " and ".join(part.name for part in of.at.unparted)
        why = f"the multiples of {names} lie closer together than the line's interval and what is stated tell apart"
    elif of.of_cycle is None and agreed.lock == "slips":
        why = "not locked to the shaft, and nothing that was stated makes this order"
    elif of.of_cycle is None:
        why = "no multiple of the cycle as far as can be told, and nothing that was stated makes this order"
    elif machine.engine_orders and of.of_cycle == round(of.of_cycle):
        why = f"turns with the shaft, but the engine's kinematics make no order {of.of_cycle:g} worth mention"
    else:
        why = "turns with the cycle, and nothing that was stated makes this order"
    return Cause("unexplained", why)


def _one_speed(orders: Sequence[AgreedOrder]) -> float | None:
    """Speed in rpm of a test at one speed, where a tone may as well be a line that goes with it; else None."""
    speed = np.array([rpm for agreed in orders for rpm in agreed.speed_rpm])
    return float(speed.mean()) if alike_speeds(speed) else None


def _explained_tones(
    tones: tuple[Tone, ...], test: _Test, rpm: float | None, known: Sequence[LineSeen], settings: IdentifySettings
) -> Iterator[Cause]:
    """Mains, gears, orders that no speed tells from tones, harmonics of races, sidebands; the rest are tones.

    ``rpm``: of a ``test`` at one speed, else None; ``known``: lines of the motor; ``settings``: the mains frequencies.
    """
    sizes = [max((amplitude for amplitude, _ in tone.amplitude.values()), default=0.0) for tone in tones]
    places = [tone.frequency_hz for tone in tones]
    mains = {f"mains {tone.frequency_hz:.4g} Hz": tone.frequency_hz for tone in tones if tone.kind == "mains"}
    errors = [tone.frequency_error_hz for tone in tones]
    sides, highest = [not on for on in _on_one_grid(places, errors)], max(places, default=1.0)
    of = {band.at: band for band in sidebands(places, errors, sizes, spacings=mains, highest=highest, sides=sides)}
    supply = supply_told([(tone.frequency_hz, 0.0) for tone in tones if tone.kind == "mains"], settings=settings)
    for number, tone in enumerate(tones):
        band = of.get(number)
        is_mains = tone.kind == "mains"
        may_be_race = tone.kind == "tone" or (is_mains and tone.frequency_hz >= NUMBERS.low_mains_hz)
        cause = _race_at(tone, test.races, rpm, few=is_mains) if may_be_race else None
        if cause is None and tone.kind == "tone" and band is not None:
            evidence = f"one of a pair about a stronger tone; chance {band.chance:.1g}"
            cause = sideband_of(places[band.carrier], band.spacing, evidence, unit=" Hz")
        if cause is None:
            cause = _tone_cause(tone, known, supply, settings)
            if rpm is not None and cause.is_just("tone", "order"):
                # the stated mesh of which it is a multiple at that speed, as well as this is held
                order, error = (hertz * 60.0 / rpm for hertz in (tone.frequency_hz, tone.frequency_error_hz))
                error += TONES.speed_spread_share * order / NUMBERS.same_sigmas
                at = parts_at(test.machine.gears, AgreedOrder(order, error, np.inf, "undecided", None, ()))
                cause = _stated(at, "gear mesh", tone.evidence) or cause
        yield cause


def _tone_cause(tone: Tone, known: Sequence[LineSeen], supply_hz: float | None, settings: IdentifySettings) -> Cause:
    """What makes a tone: which multiple of the supply, or the line of the motor that is there at some speed."""
    reach = NUMBERS.same_sigmas * tone.frequency_error_hz
    if tone.kind == "mains":
        near = multiples_near(tone.frequency_hz, tone.frequency_error_hz, settings=settings)
        on = [multiple for multiple, mains in near if supply_hz in (None, mains)]
        return of_mains(on[0] if len(on) == 1 else 1, tone.evidence)
    if tone.kind == "mains or order":
        alone = multiple_on(tone.frequency_hz, tone.frequency_error_hz, settings=settings)
        return of_mains(alone[0] if alone else 1, tone.evidence).either(of_order())
    for seen in known:
        if seen.line.turns and abs(seen.hertz - tone.frequency_hz) <= reach:
            return replace(seen.cause(tone.evidence), others=())
    return replace(of_order(), evidence=tone.evidence) if tone.kind == "order" else Cause("tone", tone.evidence)


def _race_at(line: Tone | Mode, races: list[StruckRace], rpm: float | None, *, few: bool) -> Cause | None:
    """The one of ``races`` that puts a line where ``line`` stands at the only speed ``rpm`` of a test."""
    if rpm is None:
        return None
    return race_cause(races, line.frequency_hz * 60.0 / rpm, line.frequency_error_hz * 60.0 / rpm, few=few)


def _of_mode(mode: Mode, races: list[StruckRace], rpm: float | None) -> Cause:
    """Cause of a ``mode``; where it may be none, the line that one of ``races`` has there at the only speed ``rpm``.

    Strikes that wander make harmonics as wide as a natural frequency of little damping.
    """
    if not mode.undecided:
        return Cause("mode", mode.evidence)
    return _race_at(mode, races, rpm, few=True) or Cause("undecided", mode.undecided)


def _on_one_grid(places_hz: list[float], errors_hz: list[float]) -> list[bool]:
    """Which tones are multiples of one spacing, where most are: products of a few, which lie alike far from any."""
    places, least = np.asarray(places_hz), max(NUMBERS.grid_tones, 0.5 * len(places_hz))
    if len(places) < NUMBERS.grid_tones:
        return [False] * len(places)
    step = np.unique(np.diff(np.sort(places)))[:, None]
    near = NUMBERS.grid_share * step
    reach = np.minimum(NUMBERS.same_sigmas * np.asarray(errors_hz) + near, 2.0 * near)
    on = np.abs(places - step * np.round(places / step)) <= reach
    best = on[np.argmax(on.sum(axis=1))]
    return [bool(is_on and best.sum() >= least) for is_on in best]


NEIGHBOUR_NUMBERS = MethodNumbers("5-identify-explain.toml", "one_cause")

_CALLED: dict[CauseKind, str] = {"tone": "a fixed tone", "order": "an order or a tone"}
_AT_ONE_SPEED: dict[CauseKind, str] = {"tone": "a line without width", "order": "an order or a tone"}


def with_neighbours_named(modal: ModalFit, orders: Sequence[AgreedOrder], causes: Causes) -> ModalFit:
    """``modal`` in which a natural frequency that is not decided names the known lines that stand where it would.

    Tones, and of a test at one speed the ``orders``, as ``causes`` explain them.
    """
    rpm = _one_speed(orders)
    called = _AT_ONE_SPEED if rpm is not None else _CALLED
    lines = [
        (tone.frequency_hz, called.get(cause.kind, cause.text))
        for tone, cause in zip(modal.tones, causes.tones, strict=True)
    ]
    if rpm is not None:
        of_orders = [(of.order * rpm / 60.0, causes.orders[of.lines[0].channel, of.order]) for of in orders]
        lines += [(hertz, cause.text) for hertz, cause in of_orders if cause.known]
    return replace(modal, modes=tuple(_with_lines_there(mode, lines) for mode in modal.modes))


def _with_lines_there(mode: Mode, lines: Sequence[tuple[float, str]]) -> Mode:
    """``mode``, if undecided with those of ``lines`` (Hz, cause) named that lie in its interval, and may be all."""
    low, high = mode.frequency_ends
    half = min(0.5 * (high - low), NEIGHBOUR_NUMBERS.near_share * mode.frequency_hz)
    away = sorted((abs(hertz - mode.frequency_hz), hertz, text) for hertz, text in lines)
    near = [line for line in away if line[0] <= max(NEIGHBOUR_NUMBERS.too_near_hz, half)]
    if not near or not mode.undecided:
        return mode
    named = near[: NEIGHBOUR_NUMBERS.most_named]
    lines_there = " and ".join(f"{text} at {hertz:.5g} Hz" for _, hertz, text in named)
    undecided = f"{mode.undecided}; {lines_there} stands there, and may be all of it"
    return replace(mode, undecided=undecided, lines_there_hz=tuple(hertz for _, hertz, _ in named))
