"""What makes a line: engine kinematics, a bearing, the gas cycle, mains, another line, or nothing known."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from crankorder.findings import BearingFinding
from crankorder.identify.causes.aliasing import ShownAlias
from crankorder.identify.causes.angle_swings import Words
from crankorder.identify.causes.cycle_forces import CycleForce, cycle_forces, gas_half_orders
from crankorder.identify.causes.sidebands import (
    BY_ITSELF,
    StruckRace,
    explain_families,
    harmonic_words,
    sidebands,
    struck_races,
)
from crankorder.identify.found import AgreedOrder, ModalFit, Mode, OrderLine, Tone
from crankorder.identify.intervals import half_width
from crankorder.identify.lines.growth import is_motion, largest, order_one
from crankorder.identify.lines.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.lines.known_lines import LineSeen, named_by, words_of
from crankorder.identify.lines.mains import OR_ANOTHER, mains_orders, multiple_on, multiples_near, supply_told
from crankorder.identify.machine_model import MachineModel, PartsAt, StatedPart, parts_at
from crankorder.identify.modes.tones import NEAR_BINS
from crankorder.identify.modes.tones import NUMBERS as TONES
from crankorder.identify.said import LIKE_UNBALANCE, MAY_BE_ALL, OR_OWN, mains_words
from crankorder.identify.said import NUMBERS as SAID
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="explain"):
    same_sigmas: float
    vague_spacings: float
    grid_tones: int
    grid_share: float
    low_mains_hz: float


NUMBERS = _Numbers.load()

NOT_KNOWN = ("unexplained", "tone", "undecided", OR_OWN)
"""Words for lines whose cause is not known."""

ForcesOfCycle = dict[tuple[str, float], CycleForce]
"""What gas and masses make of a line, by channel and AgreedOrder.order."""

EITHER = "gas cycle or engine kinematics"
"""What makes an order that gas and masses of an engine both do, as far as is known."""


@dataclass(frozen=True)
class Cause:
    """What makes a line, in words that stay the same (``text``), and what says so (``evidence``)."""

    text: str
    evidence: str

    @property
    def known(self) -> bool:
        """Whether the words name a cause."""
        return self.text not in NOT_KNOWN


@dataclass(frozen=True)
class Causes:
    """One cause for every line: ``orders`` by channel and AgreedOrder.order, ``modes`` and ``tones`` as in ModalFit."""

    orders: dict[tuple[str, float], Cause]
    modes: tuple[Cause, ...]
    tones: tuple[Cause, ...]


def explained(
    orders: tuple[AgreedOrder, ...],
    modal: ModalFit,
    bearings: Sequence[BearingFinding],
    *,
    sources: MachineModel,
    quantity: dict[str, str],
    settings: IdentifySettings,
    in_cylinder: Collection[str] = (),
    folds: Sequence[ShownAlias] = (),
    known: Sequence[LineSeen] = (),
    of_swing: Words | None = None,
    longest_rev: float = np.inf,
    rows: Mapping[tuple[str, float], OrderLine] | None = None,
) -> Causes:
    """One cause for every order line in every channel, and for every mode and tone.

    The first that the evidence supports, in this order: the gas cycle in the pressure of a cylinder; in a firing
    engine gas or engine kinematics, whichever its model makes far more of; engine kinematics; a gear that was
    stated; unbalance; the gas cycle of a firing engine; a bearing (by the records of the bearings, within their
    intervals); a fold of something else in data sampled by crank angle; a half order of the cycle; a mesh of teeth
    by its sidebands; a shaft harmonic; a harmonic or sideband of another line; a second shaft. What is left is
    "unexplained". A line that slips is no multiple of the cycle, one that is locked is no race of a bearing.

    Parameters
    ----------
    orders : the orders of the test as the order map shows them
    modal : its modes and tones
    bearings : findings of ``bearing_records``: ``name``, ``line``, ``order``, ``order_ci95``, ``lock`` count
    sources : what is known of the machine
    quantity : quantity of each channel by its name, such as "acceleration" or "sound pressure"
    in_cylinder : channels that measure the pressure in a cylinder, where the machine is a piston engine
    settings : mains frequencies and how far they wander
    folds : what was found to fold (:func:`crankorder.identify.causes.aliasing.shown_folds`)
    known : lines of the motor and of the mains that the frames hold where they were expected
    of_swing : lines that swings of the angle may make (:func:`crankorder.identify.causes.angle_swings.swing_sidebands`)
    longest_rev : revolutions of the longest recording at one speed: two lines that beat less often in it look like one
    rows : lines by channel and order with the amplitudes of their tracks, which tell how they grow
    """
    causes: dict[tuple[str, float], Cause] = {}
    races = struck_races(bearings, sources, [(agreed.order, agreed.order_error) for agreed in orders])
    first = partial(_first_cause, orders=orders, races=races, sources=sources, folds=folds)
    first = partial(first, forces=_forces_of_cycle(orders, sources), modes=modal.modes)
    for agreed in orders:
        at = _stated_parts(agreed, bearings, sources)
        for line in agreed.lines:
            name = line.channel
            line = (rows or {}).get((name, agreed.order), line)
            cause = first(agreed, line, at=at, quantity=quantity[name], in_cylinder=name in in_cylinder)
            causes[line.channel, agreed.order] = cause or Cause("unexplained", _why_not(agreed, at, sources))
    for key, (text, evidence) in (of_swing or {}).items():
        if causes[key].text in (*BY_ITSELF, *OF_NUMBER):
            causes[key] = Cause(text, evidence)
    causes |= _electric(orders, causes, modal, known, sources, settings, longest_rev)
    families = explain_families(
        orders,
        {key: cause.text for key, cause in causes.items()},
        {agreed.order: multiple_of_cycle(agreed, sources.revs_per_cycle) for agreed in orders},
        spacings=_spacings(sources, bearings),
        modes_hz=[mode.frequency_hz for mode in modal.modes],
        of_swing=of_swing or {},
    )
    causes |= {key: Cause(text, evidence) for key, (text, evidence) in families.items()}
    modes = tuple(
        Cause("undecided", mode.undecided) if mode.undecided else Cause("mode", mode.evidence) for mode in modal.modes
    )
    rpm = _one_speed(orders)
    modes = tuple(_of_race(mode, cause, races, rpm) for mode, cause in zip(modal.modes, modes, strict=True))
    return Causes(causes, modes, _explained_tones(modal.tones, races, sources.gears, rpm, known, settings))


HALF_ORDER = "half order of the four-stroke cycle"

OF_NUMBER = ("unbalance", LIKE_UNBALANCE, "shaft harmonic", HALF_ORDER)
"""What a line is called that is an order of the shaft for no other reason than that it is one."""


def _electric(
    orders: tuple[AgreedOrder, ...],
    causes: dict[tuple[str, float], Cause],
    modal: ModalFit,
    known: Sequence[LineSeen],
    sources: MachineModel,
    settings: IdentifySettings,
    longest_rev: float,
) -> dict[tuple[str, float], Cause]:
    """Causes of the lines of the mains and of the motor; with what else each may be, where the data do not tell."""
    of_cycle = {agreed.order: _unparted(agreed, sources.revs_per_cycle, longest_rev) for agreed in orders}
    tones = [tone for tone in modal.tones if tone.kind == "mains"]
    exact = [order for order, multiple in of_cycle.items() if multiple is not None]
    # what errors of the angle may make beside a strong order has a cause that nothing tells from mains
    lines = tuple(agreed for agreed in orders if not agreed.of_angle)
    of_mains = mains_orders(lines, tones=tones, exact=exact, settings=settings)
    told = {order: Cause(*words) for order, words in of_mains.items()}
    sure: set[float] = set()
    for agreed in orders:
        item = named_by(known, agreed)
        in_doubt = agreed.order in told and OR_ANOTHER in told[agreed.order].text
        if item is not None and not in_doubt:
            text = " or ".join([words_of(item), *(other for other in item.also if not other.startswith("order "))])
            told[agreed.order] = Cause(text, f"{item.hertz:.6g} Hz at {item.held.rpm:.5g} rpm, where it was expected")
            if not item.also:
                sure.add(agreed.order)
    made: dict[tuple[str, float], Cause] = {}
    for key, cause in causes.items():
        if key[1] in told:
            other = None if key[1] in sure else of_cycle[key[1]]
            made[key] = _with_electric(cause, told[key[1]], other, key[1] in sure)
    return made


def _with_electric(cause: Cause, electric: Cause, of_cycle: float | None, sure: bool) -> Cause:
    """What a line is called that by itself is a ``cause`` and may be ``electric``; both where they coincide."""
    evidence = f"{electric.evidence}; {cause.evidence}"
    if not cause.known or (sure and cause.text in OF_NUMBER):
        text = electric.text if of_cycle is None else f"{electric.text} or order {of_cycle:g}"
        return Cause(text, electric.evidence)
    if of_cycle is None or cause.text in OF_NUMBER or sure:
        return Cause(f"{cause.text} or {electric.text}", evidence)
    return cause


def _unparted(agreed: AgreedOrder, revs_per_cycle: int, longest_rev: float) -> float | None:
    """:func:`multiple_of_cycle`, or that beside which ``agreed`` may be two lines that no recording parts."""
    multiple = multiple_of_cycle(agreed, revs_per_cycle)
    if multiple is not None or agreed.lock != "undecided" or not np.isfinite(longest_rev):
        return multiple
    nearest = max(1, round(agreed.order * revs_per_cycle)) / revs_per_cycle
    return nearest if abs(agreed.order - nearest) * longest_rev < KNOWN_LINES.apart_cycles else None


def multiple_of_cycle(agreed: AgreedOrder, revs_per_cycle: int) -> float | None:
    """Multiple of the order of the cycle (1 / ``revs_per_cycle``) that ``agreed`` is or may be; None where it is none.

    A line that slips is none; one that is undecided is, if its 95 % interval holds it and it lies no farther from it
    than one line of four that lie anywhere. What errors of the crank angle may have made is none.
    """
    nearest = max(1, round(agreed.order * revs_per_cycle)) / revs_per_cycle
    if agreed.lock == "locked" and abs(agreed.order - nearest) < 0.25 / revs_per_cycle:
        return nearest
    half = half_width(agreed.degrees_of_freedom) * agreed.order_error
    reach = min(half + 1e-9, NUMBERS.vague_spacings / revs_per_cycle)
    if agreed.lock == "slips" or agreed.of_angle or abs(agreed.order - nearest) > reach:
        return None
    return nearest


def _first_cause(
    agreed: AgreedOrder,
    line: OrderLine,
    orders: tuple[AgreedOrder, ...],
    at: PartsAt,
    races: list[StruckRace],
    sources: MachineModel,
    quantity: str,
    in_cylinder: bool,
    folds: Sequence[ShownAlias],
    forces: ForcesOfCycle,
    modes: Sequence[Mode],
) -> Cause | None:
    """The first cause that the evidence supports for one line by itself."""
    of_cycle = multiple_of_cycle(agreed, sources.revs_per_cycle)
    proof = {
        "locked": "locked to the shaft",
        "undecided": "may be locked to the shaft",
        "slips": "not locked to the shaft",
    }[agreed.lock]
    return (
        _gas_in_pressure(of_cycle, in_cylinder, sources, proof)
        or _gas_or_masses(forces.get((line.channel, agreed.order)), proof)
        or _kinematics(of_cycle, orders, sources, proof)
        or _stated(at, "gear mesh", proof)
        or _first_order(of_cycle, line, sources, quantity, modes, proof)
        or _combustion(of_cycle, sources, proof)
        or _stated(at, "bearing", proof)
        or _race_harmonic(agreed, of_cycle, races)
        or _fold(line, folds)
        or _half_order(of_cycle, orders, sources, proof)
        or _shaft_harmonic(of_cycle, sources, proof)
    )


def _gas_in_pressure(of_cycle: float | None, in_cylinder: bool, sources: MachineModel, proof: str) -> Cause | None:
    """The gas cycle in the pressure of a cylinder itself; a rotor has none, whatever its pressures are."""
    if not in_cylinder or of_cycle is None or not sources.has_pistons:
        return None
    cycle = "four-stroke cycle" if sources.revs_per_cycle == 2 else "cycle"
    return Cause("gas cycle", f"order {of_cycle:g}, a multiple of the {cycle}, in the pressure itself; {proof}")


def _forces_of_cycle(orders: tuple[AgreedOrder, ...], sources: MachineModel) -> ForcesOfCycle:
    """Gas and inertia by channel and order, at the speed where each line is largest; empty without gas or engine."""
    if sources.engine is None or not sources.firing:
        return {}
    of_cycle = [(multiple_of_cycle(agreed, sources.revs_per_cycle), agreed) for agreed in orders]
    lines = [(number, agreed.order, line) for number, agreed in of_cycle if number is not None for line in agreed.lines]
    made = cycle_forces(sources.engine, [(number, largest(line).speed_rpm) for number, _, line in lines])
    return {
        (line.channel, order): force for (_, order, line), force in zip(lines, made, strict=True) if force is not None
    }


def _gas_or_masses(force: CycleForce | None, proof: str) -> Cause | None:
    """Which of a firing engine's gas and masses makes a line, or that either may."""
    if force is None:
        return None
    text = {"gas": "gas cycle", "masses": "engine kinematics", "both": EITHER}[force.maker]
    return Cause(text, f"{force.words}; {proof}")


def _kinematics(cycle: float | None, orders: Sequence[AgreedOrder], sources: MachineModel, proof: str) -> Cause | None:
    if cycle is None or not any(abs(cycle - known) < 1e-6 for known in sources.engine_orders):
        return None
    made = f"the engine's moving masses make order {cycle:g}"
    gas = "the engine fires" if sources.firing else ""
    if not gas and sources.revs_per_cycle == 2 and len(half := gas_half_orders(one.order for one in orders)) > 1:
        gas = f"half orders ({', '.join(half)}) show gas torque"
    if gas:
        return Cause(
            EITHER, f"{made}; {gas}, and nothing that was stated tells how much of this order it makes; {proof}"
        )
    return Cause("engine kinematics", f"{made}; {proof}")


def _stated_parts(agreed: AgreedOrder, bearings: Sequence[BearingFinding], sources: MachineModel) -> PartsAt:
    """The stated gears, and the lines of bearings by their records, that have a multiple where ``agreed`` lies.

    Of a bearing only the line itself may be a multiple of the cycle's order: some multiple of a rolling line is near
    one by chance.
    """
    of_cycle = multiple_of_cycle(agreed, sources.revs_per_cycle)
    elements = {bearing.name: bearing.rolling_elements for bearing in sources.bearings}
    parts = [*sources.gears]
    for record in bearings:
        locked_line = record.line == "N*fs"
        if agreed.lock == "locked" and not locked_line:
            continue  # what rolls slips: a locked line is no race's and no ball's
        part = StatedPart("bearing", f"{record.name} {record.line}", record.order, record.order_half)
        alone = of_cycle is not None or record.seen_in == "envelope"
        like = elements.get(record.name) if agreed.lock == "locked" else None
        parts.append(replace(part, most=1 if alone else part.most, elements=like))
    return parts_at(parts, agreed)


def _stated(at: PartsAt, kind: str, proof: str) -> Cause | None:
    """The parts ``at`` a line, if one is of the ``kind``."""
    if not any(part.kind == kind for part, _ in at.near):
        return None
    like = sorted({part.elements for part, _ in at.near if part.elements is not None})
    alike = f" or {' or '.join(f'{_article(n)} {n}-fold' for n in like)} part of that shaft" if like else ""
    gears = [part for part, _ in at.near if part.kind == "gear mesh"]
    stated = [f"the manifest states {gear.name} at order {gear.order:g}" for gear in gears]
    evidence = [*(stated or ["within the interval of the bearing's line"]), proof]
    return Cause(at.words + alike, "; ".join(evidence))


def _first_order(
    of_cycle: float | None, line: OrderLine, sources: MachineModel, quantity: str, modes: Sequence[Mode], proof: str
) -> Cause | None:
    """What order 1 is by how it grows; a harmonic of the shaft, or unexplained, where that is not as unbalance does."""
    if of_cycle != 1.0 or not is_motion(quantity):
        return None
    text, why = order_one(line, quantity, modes)
    if text is not None:
        return Cause(text, f"order 1, {proof}; {why}")
    if sources.firing:
        return None
    return Cause("unexplained" if sources.engine_orders else "shaft harmonic", f"order 1, {proof}, but {why}")


def _combustion(of_cycle: float | None, sources: MachineModel, proof: str) -> Cause | None:
    if not sources.firing or of_cycle is None:
        return None
    return Cause(
        "gas cycle", f"the engine fires, which makes every multiple of order {1 / sources.revs_per_cycle:g}; {proof}"
    )


RACE_EVIDENCE = "where the strikes that were found have a harmonic, or one with turns of the shaft beside it"
"""Why a line is a struck race's: strikes have many harmonics, and come and go with the load as the shaft turns."""


def _race_harmonic(agreed: AgreedOrder, of_cycle: float | None, races: list[StruckRace]) -> Cause | None:
    """Harmonic of a struck race or a sideband of one, which a line on a multiple of the cycle's order is not."""
    if of_cycle is not None or agreed.lock == "locked":
        return None
    text = harmonic_words(races, agreed.order, agreed.order_error)
    return Cause(text, RACE_EVIDENCE) if text else None


def _one_speed(orders: Sequence[AgreedOrder]) -> float | None:
    """Speed in rpm of a test at one speed, where a tone may as well be a line that goes with it; else None."""
    speed = np.array([rpm for agreed in orders for line in agreed.lines for rpm in line.speed_rpm])
    alike = len(speed) > 0 and bool(np.isfinite(speed).all()) and speed.max() <= SAID.alike_speeds_ratio * speed.min()
    return float(speed.mean()) if alike else None


def _article(number: int) -> str:
    return "an" if str(number).startswith(("8", "11", "18")) else "a"


def _fold(line: OrderLine, folds: Sequence[ShownAlias]) -> Cause | None:
    for shown in folds:
        if shown.is_line(line):
            unit = "Hz" if shown.fold.kind == "frequency" else ""
            name = f"{shown.fold.value:.6g} {unit}".strip() if unit else f"order {shown.fold.value:.6g}"
            text = f"fold of {name}" if shown.fold.sure else f"fold of {name} or a line of its own"
            return Cause(text, shown.fold.evidence)
    return None


def _half_order(cycle: float | None, orders: Sequence[AgreedOrder], sources: MachineModel, proof: str) -> Cause | None:
    """Half orders of a four-stroke machine; of a motored engine only where there is more than one."""
    if cycle is None or sources.revs_per_cycle != 2 or cycle == round(cycle):
        return None
    multiples = [multiple_of_cycle(agreed, 2) for agreed in orders]
    family = sorted({m for m in multiples if m is not None and m != round(m)})
    if sources.engine_orders and len(family) < 2:
        return None
    listed = ", ".join(f"{m:g}" for m in family[:6])
    return Cause(HALF_ORDER, f"{proof}; half orders found: {listed}")


def _shaft_harmonic(of_cycle: float | None, sources: MachineModel, proof: str) -> Cause | None:
    if of_cycle is None or of_cycle != round(of_cycle) or sources.engine_orders:
        return None
    return Cause("shaft harmonic", f"whole order, {proof}")


def _why_not(agreed: AgreedOrder, at: PartsAt, sources: MachineModel) -> str:
    if at.unparted:
        names = " and ".join(part.name for part in at.unparted)
        return f"the multiples of {names} lie closer together than the line's interval and what is stated tell apart"
    of_cycle = multiple_of_cycle(agreed, sources.revs_per_cycle)
    if of_cycle is None and agreed.lock == "slips":
        return "not locked to the shaft, and nothing that was stated makes this order"
    if of_cycle is None:
        return "no multiple of the cycle as far as can be told, and nothing that was stated makes this order"
    if sources.engine_orders and of_cycle == round(of_cycle):
        return f"turns with the shaft, but the engine's kinematics make no order {of_cycle:g} worth mention"
    return "turns with the cycle, and nothing that was stated makes this order"


def _spacings(sources: MachineModel, bearings: Sequence[BearingFinding]) -> dict[str, float]:
    """What may modulate a line, as names and orders: the shafts, the cycle, the cages."""
    spacings = {"shaft": 1.0} | ({"half-speed shaft": 0.5} if sources.revs_per_cycle == 2 else {})
    for bearing in sources.bearings:
        if bearing.shaft_ratio not in spacings.values():
            spacings[bearing.name] = bearing.shaft_ratio
    cages = [(record.name, record.order) for record in bearings if record.line == "FTF"]
    expected = [(name, order) for (name, line), order in sources.known_bearing_orders.items() if line == "FTF"]
    for gear in sources.gears:
        if gear.shaft_order not in spacings.values():
            spacings[gear.name] = gear.shaft_order
    return spacings | {f"cage of {name}": order for name, order in [*expected, *cages]}


def _explained_tones(
    tones: tuple[Tone, ...],
    races: list[StruckRace],
    gears: Sequence[StatedPart],
    rpm: float | None,
    known: Sequence[LineSeen],
    settings: IdentifySettings,
) -> tuple[Cause, ...]:
    """Mains, ``gears``, orders that no speed tells from tones, harmonics of ``races``, sidebands; the rest are tones.

    ``rpm``: of a test at one speed, else None; ``known``: lines of the motor; ``settings``: the mains frequencies.
    """
    sizes = [max((amplitude for amplitude, _ in tone.amplitude.values()), default=0.0) for tone in tones]
    places = [tone.frequency_hz for tone in tones]
    mains = {f"mains {tone.frequency_hz:.4g} Hz": tone.frequency_hz for tone in tones if tone.kind == "mains"}
    errors = [tone.frequency_error_hz for tone in tones]
    bands = sidebands(
        places,
        errors,
        sizes,
        spacings=mains,
        highest=max(places, default=1.0),
        sides=[not on for on in _on_one_grid(places, errors)],
    )
    of = {band.at: band for band in bands}
    supply = supply_told([(one.frequency_hz, 0.0) for one in tones if one.kind == "mains"], settings=settings)
    causes = []
    for number, tone in enumerate(tones):
        band = of.get(number)
        race = _race_of_tone(tone, races, rpm)
        if race:
            causes.append(Cause(race, RACE_EVIDENCE))
        elif tone.kind == "tone" and band is not None:
            text = f"sideband of {places[band.carrier]:.4g} Hz spaced by {band.spacing:.4g} Hz"
            causes.append(Cause(text, f"one of a pair about a stronger tone; chance {band.chance:.1g}"))
        else:
            words = _tone_words(tone, known, supply, settings)
            gear = None if rpm is None or words not in ("tone", "order") else _gear_of_tone(tone, gears, rpm)
            causes.append(gear or Cause(words, tone.evidence))
    return tuple(causes)


def _gear_of_tone(tone: Tone, gears: Sequence[StatedPart], rpm: float) -> Cause | None:
    """The stated mesh of which a ``tone`` is a multiple at the only speed ``rpm`` of a test, as well as it is held."""
    order, error = (hertz * 60.0 / rpm for hertz in (tone.frequency_hz, tone.frequency_error_hz))
    error += TONES.speed_spread_share * order / NUMBERS.same_sigmas
    at = parts_at(gears, AgreedOrder(order, error, np.inf, "undecided", None, ()))
    return _stated(at, "gear mesh", tone.evidence)


def _tone_words(tone: Tone, known: Sequence[LineSeen], supply_hz: float | None, settings: IdentifySettings) -> str:
    """What a tone is called: which multiple of the supply, or the line of the motor that is there at some speed."""
    reach = NUMBERS.same_sigmas * tone.frequency_error_hz
    of_motor = [item for item in known if item.line.turns and abs(item.hertz - tone.frequency_hz) <= reach]
    if tone.kind == "mains":
        near = multiples_near(tone.frequency_hz, tone.frequency_error_hz, settings=settings)
        on = [multiple for multiple, mains in near if supply_hz in (None, mains)]
        return mains_words(on[0]) if len(on) == 1 else "mains"
    if tone.kind == "mains or order":
        alone = multiple_on(tone.frequency_hz, tone.frequency_error_hz, settings=settings)
        return f"{mains_words(alone[0] if alone else 1)} or order"
    return words_of(of_motor[0]) if of_motor else tone.kind


def _race_of_tone(tone: Tone, races: list[StruckRace], rpm: float | None) -> str:
    """What a ``tone`` is called that at the only speed ``rpm`` of a test lies where one of ``races`` puts a line."""
    mains = tone.kind == "mains"
    if rpm is None or tone.kind not in ("tone", "mains") or (mains and tone.frequency_hz < NUMBERS.low_mains_hz):
        return ""
    return harmonic_words(races, tone.frequency_hz * 60.0 / rpm, tone.frequency_error_hz * 60.0 / rpm, few=mains)


def _of_race(mode: Mode, cause: Cause, races: list[StruckRace], rpm: float | None) -> Cause:
    """``cause`` of a ``mode``, or, where it may be none, the line that one of ``races`` has there at the only speed.

    Strikes that wander make harmonics as wide as a natural frequency of little damping.
    """
    if not mode.undecided or rpm is None:
        return cause
    turns = 60.0 / rpm
    words = harmonic_words(races, mode.frequency_hz * turns, mode.frequency_error_hz * turns, few=True)
    return Cause(words, RACE_EVIDENCE) if words else cause


def _on_one_grid(places_hz: list[float], errors_hz: list[float]) -> list[bool]:
    """Which tones are multiples of one spacing, where most are: products of a few, which lie alike far from any."""
    places, nothing = np.asarray(places_hz), [False] * len(places_hz)
    if len(places) < NUMBERS.grid_tones:
        return nothing
    best = np.zeros(len(places), dtype=bool)
    for step in np.unique(np.diff(np.sort(places))):
        near = NUMBERS.grid_share * step
        reach = np.minimum(NUMBERS.same_sigmas * np.asarray(errors_hz) + near, 2.0 * near)
        on = np.abs(places - step * np.round(places / step)) <= reach
        best = on if np.count_nonzero(on) > np.count_nonzero(best) else best
    return best.tolist() if np.count_nonzero(best) >= max(NUMBERS.grid_tones, 0.5 * len(places)) else nothing


class _NeighbourNumbers(MethodNumbers, file="5-identify-explain.toml", table="one_cause"):
    too_near_hz: float
    near_share: float
    most_named: int


NEIGHBOUR_NUMBERS = _NeighbourNumbers.load()

_CALLED = {"tone": "a fixed tone", "order": "an order or a tone"}
_AT_ONE_SPEED = {"tone": "a line without width", "order": "an order or a tone"}


def without_doubles(modal: ModalFit) -> ModalFit:
    """``modal`` without tones that may be orders and stand on the flank of a stronger tone.

    Lines closer than the main lobe of the window are one in the map; such a one is what the fit of the stronger left.
    """
    if len(modal.frequency_hz) < 2:
        return modal
    reach = NEAR_BINS * float(modal.frequency_hz[1] - modal.frequency_hz[0])
    sizes = [max(size for size, _ in tone.amplitude.values()) for tone in modal.tones]
    kept = tuple(
        tone
        for tone, size in zip(modal.tones, sizes, strict=True)
        if "order" not in tone.kind
        or not any(
            abs(tone.frequency_hz - other.frequency_hz) < reach and size < more
            for other, more in zip(modal.tones, sizes, strict=True)
        )
    )
    return replace(modal, tones=kept)


def with_neighbours_named(modal: ModalFit, orders: Sequence[AgreedOrder], causes: Causes) -> ModalFit:
    """``modal`` in which a natural frequency that is not decided names the known lines that stand where it would.

    Tones, and of a test at one speed the ``orders``, as ``causes`` explain them.
    """
    rpm = _one_speed(orders)
    called = _AT_ONE_SPEED if rpm is not None else _CALLED
    lines = [
        (tone.frequency_hz, called.get(cause.text, cause.text))
        for tone, cause in zip(modal.tones, causes.tones, strict=True)
    ]
    if rpm is not None:
        found = [(one.order * rpm / 60.0, causes.orders[one.lines[0].channel, one.order].text) for one in orders]
        lines += [(hertz, text) for hertz, text in found if text not in NOT_KNOWN]
    modes = tuple(_beside(mode, lines) if mode.undecided else mode for mode in modal.modes)
    return replace(modal, modes=modes)


def _beside(mode: Mode, lines: Sequence[tuple[float, str]]) -> Mode:
    low, high = mode.frequency_ends
    reach = max(
        NEIGHBOUR_NUMBERS.too_near_hz, min(0.5 * (high - low), NEIGHBOUR_NUMBERS.near_share * mode.frequency_hz)
    )
    near = sorted(
        (abs(hertz - mode.frequency_hz), hertz, text)
        for hertz, text in lines
        if abs(hertz - mode.frequency_hz) <= reach
    )
    if not near:
        return mode
    said = " and ".join(f"{text} at {hertz:.5g} Hz" for _, hertz, text in near[: NEIGHBOUR_NUMBERS.most_named])
    return replace(mode, undecided=f"{mode.undecided}; {said} {MAY_BE_ALL}")
