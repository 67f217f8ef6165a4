"""The balance sheet of an engine: one document with the tables that a designer wants, and sentences on what remains."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, TypeVar

import numpy as np

from crankorder.engine.balance_data import (
    FULL_TURN_REV,
    AddedMass,
    Amounts,
    BalancedEngine,
    OffsetBalance,
    ReverseCranks,
    RodBalance,
    added_mass,
    crankshaft_of,
    harmonic_shares,
    leading_harmonics,
    newton,
    newton_by_speed,
    offset_balance,
    reduced_masses,
    reverse_cranks,
    rod_balance,
    speed_key,
    unbalance_class,
)
from crankorder.engine.balancing import (
    CounterweightPlaces,
    OrderForce,
    ReducedMasses,
    Rotation,
    Strategy,
    balanced,
    counterweights,
    force_by_order,
    rod_counterweight_couple,
)
from crankorder.engine.crankshaft import CrankshaftBalance
from crankorder.engine.cycle_tables import CycleBalance, cycle_balance, cycle_sentences
from crankorder.engine.definition import BalanceShafts, Engine
from crankorder.engine.shaft_design import (
    ByAxis,
    DesignBalance,
    Residual,
    by_axis,
    degrees_of,
    design_balance,
    design_sentences,
    listed,
    moment_sentences,
    tolerance_of,
    whole_force,
    whole_moments,
)
from crankorder.engine.shafts import (
    Possibility,
    SeriesResiduals,
    ShaftPairParts,
    pair_rounding_g_mm,
    parts_unbalance_g_mm,
    shaft_layout,
    tolerance_sentences,
)
from crankorder.engine.slider_crank import acceleration_harmonics, dead_centres, fastest_piston
from crankorder.errors import RequestError, plain_number
from crankorder.records import Record, said

NEARLY_STATIC = 0.01
"""Static unbalance below this share of a crankshaft's largest counterweight is named as balance."""


_NO_FORCE = "no force"
CYLINDER = {"x": "along the cylinder", "y": "across the cylinder"}
FRAME = {"x": "along Z", "y": "along X"}
"""Words for the two directions, for one cylinder and for several; Z points from the crankshaft to the middle bank."""

STRATEGIES: tuple[Strategy, ...] = ("a", "b", "c", "d")
POSSIBILITIES: tuple[Possibility, ...] = ("1", "2", "3", "4", "4+2")
Reading = Literal["literal", "physical"]
T = TypeVar("T")


class Piston(Record):
    """Stroke of a piston and its speeds."""

    stroke_mm: float = said("distance of the dead centres, mm")
    fastest_deg: float = said("crank angle at which a piston goes down fastest, degrees")
    mean_m_s: Amounts = said("mean speed by crank speed, m/s")
    fastest_m_s: Amounts = said("highest speed by crank speed, m/s")


class StrategyBalance(Record):
    """Counterweights of a strategy, and the force that they leave."""

    counterweight_g: float = said("mass added on the crank, opposite to its pin; below zero: taken off, g")
    counterweight_deg: float = said("angle of its place on from there, in the sense of the crank, degrees")
    rod_counterweight_g: float | None = said("mass added on the rod beyond the crank pin, g")
    total_g: float = said("mass added in all, g")
    residual_x_g_mm: float = said("force of order 1 along the cylinder, g·mm over ω²")
    residual_y_g_mm: float = said("force of order 1 across the cylinder, g·mm over ω²")
    rotation: Rotation = said("which way the force of order 1 turns")
    higher_orders_x_g_mm: Amounts | None = said("force of the higher orders along the cylinder, g·mm over ω²")
    couple_g_mm2: float | None = said("largest couple that a counterweight on the rod leaves, g·mm² over ω²")


class AdditionalShaft(Record):
    """A shaft with an unbalance."""

    speed_ratio: float = said("speed over crank speed; negative: against the crank")
    unbalance_g_mm: float = said("mass times radius, g·mm")
    phase_deg: float = said("heavy side at top dead centre, from the cylinder axis in the sense of the crank, degrees")
    mass_at_crank_radius_g: float = said("mass that it needs at the crank radius, g")


class ShaftSet(Record):
    """A possibility of additional shafts, and what it leaves."""

    strategy: Strategy = said("counterweights that it builds on")
    shafts: tuple[AdditionalShaft, ...] = said("the shafts")
    left: Residual = said("what remains", spread=True)


class BuiltForRatio(Record):
    """What a second-order pair built for λ instead of A2 leaves."""

    residual_x_g_mm: float = said("force along the cylinder, g·mm over ω²")
    force_n: Amounts = said("that force by speed, N")


class PairReading(Record):
    """A printed number of a shaft pair read one way."""

    pair_unbalance_g_mm: float = said("unbalance of both shafts together, g·mm")
    pair_force_g_mm: float = said("force of the pair, g·mm over ω²")
    residual_x_g_mm: float = said("force needed less that of the pair; below zero: too much, g·mm over ω²")
    overbalance: float = said("force of the pair over the force needed")
    residual_n: Amounts = said("force that remains by speed, N")
    grade: str | None = said("strictest class of unbalance that it keeps to", key="class")


class ShaftPair(Record):
    """A counter-rotating pair from its parts, and as printed."""

    order: int = said("speed over crank speed")
    one_shaft_design_g_mm: float = said("unbalance of one shaft by design, g·mm")
    one_shaft_measured_g_mm: float = said("unbalance of one shaft as weighed, g·mm")
    pair_design_g_mm: float = said("unbalance of both by design, g·mm")
    pair_measured_g_mm: float = said("unbalance of both as weighed, g·mm")
    pair_rounding_g_mm: float = said("most that rounding of the stated numbers changes, g·mm")
    printed_pair_g_mm: float | None = said("printed number of the pair, g·mm")
    printed_needed_g_mm: float | None = said("printed force that it is for, g·mm over ω²")
    scenarios: dict[Reading, PairReading] | None = said("the printed number read as unbalance and as force")


class OwnShafts(Record):
    """Shafts that the engine has, and what they leave."""

    orders: tuple[int, ...] = said("their orders")
    left: Residual = said("what remains", spread=True)


class ShaftBalance(Record):
    """Balance shafts: possibilities of additional ones, and what the engine file says of shafts."""

    sets: dict[Possibility, ShaftSet | None] = said("possibilities; null for several cylinders", spread=True)
    built_for_ratio: BuiltForRatio | None = said("a pair built for λ", key="second_order_built_for_lambda")
    pairs: tuple[ShaftPair, ...] | None = said("shaft pairs from their parts")
    own: OwnShafts | None = said("shafts that the engine has")


class BalanceSheet(Record):
    """Balance of an engine: force and moment by order, counterweights, shafts, and what they leave.

    x lies along the cylinder, y across it (several cylinders: along Z and X). Orders and speeds (rpm) are keys, as
    texts; a part that the engine has no data for is None.
    """

    engine: str = said("title of the engine")
    crank_ratio: float = said("crank radius over rod length", key="lambda")
    harmonics: Amounts = said("A2, A4, …: amplitude of the piston's acceleration by order over r ω²")
    masses_g: dict[str, float | None] = said("masses that stand for crank, rod and piston, g")
    piston: Piston = said("of the engine's common lengths")
    counterweights_in_file: bool = said("whether the engine file states webs or an unbalance that turns")
    force_g_mm: ByAxis = said("force without shafts by axis and order, g·mm over ω²")
    force_phase_deg: ByAxis = said("its phase, degrees")
    moment_g_mm2: ByAxis = said("moment without shafts by axis and order, g·mm² over ω²")
    moment_phase_deg: ByAxis = said("its phase, degrees")
    leading_g_mm: Amounts | None = said("force of the leading term of each harmonic by order, g·mm over ω²")
    force_n: dict[str, ByAxis] = said("force without shafts by speed, axis and order, N")
    strategies: dict[Strategy, StrategyBalance | None] | None = said("counterweights; null for several cylinders")
    shafts: ShaftBalance = said("balance shafts")
    cycle: CycleBalance | None = said("firing, torque and loads over the cycle")
    tolerance: SeriesResiduals | None = said("what errors of a series leave")
    design: DesignBalance | None = said("crank webs and shafts for several cylinders")
    crankshaft: CrankshaftBalance | None = said("balance of the crankshaft by itself")
    rod_split: RodBalance | None = said("the rod as cut and as weighed")
    added_mass: AddedMass | None = said("a mass on the piston that no shaft knows")
    offset: OffsetBalance | None = said("offset of the cylinder")
    reverse_cranks: ReverseCranks | None = said("direct and reverse cranks")
    notes: tuple[str, ...] = said("what the numbers are and which were assumed")
    sentences: tuple[str, ...] = said("what remains unbalanced")

    @property
    def plain_state(self) -> str:
        """What the engine without shafts is called: a rotating unbalance that its file states has counterweights."""
        if not self.counterweights_in_file:
            return "with no balancing"
        return "as built" if self.shafts.own is None else "without its shafts"


def balance_sentences(sheet: BalanceSheet, *, speed_rpm: float) -> tuple[str, ...]:
    """What remains unbalanced in sentences, the plain engine first.

    ``sheet``: of the engine. ``speed_rpm``: crank speed at which forces are named.
    """
    where = CYLINDER if sheet.strategies else FRAME
    state, force = sheet.plain_state, _amounts(sheet.force_g_mm, speed_rpm, where=where)
    shakes = "no force shakes the engine" if force == _NO_FORCE else f"the engine shakes with {force}"
    key, piston, shafts = speed_key(speed_rpm), sheet.piston, sheet.shafts
    mean, fastest = (plain_number(speeds[key]) for speeds in (piston.mean_m_s, piston.fastest_m_s))

    def of(part: T | None, sentences: Callable[[T, float], list[str]]) -> list[str]:
        return [] if part is None else sentences(part, speed_rpm)

    return (
        f"{state[0].upper()}{state[1:]} {shakes}.",
        *moment_sentences(sheet.moment_g_mm2, speed_rpm),
        f"At {key} rpm a piston moves at {mean} m/s in the mean and {fastest} m/s at most, at "
        f"{piston.fastest_deg:.4g}° after its dead centre.",
        *of(sheet.cycle, cycle_sentences),
        *of(sheet.strategies, _of_strategies),
        *of(shafts, partial(_of_shafts, where=where)),
        *of(sheet.design, design_sentences),
        *of(sheet.tolerance, tolerance_sentences),
        *of(shafts.pairs, _of_pairs),
        *of(sheet.crankshaft, _of_crankshaft),
        *of(sheet.rod_split, _of_rod_split),
        *of(sheet.added_mass, _of_added_mass),
        *of(sheet.offset, _of_offset),
        *of(sheet.reverse_cranks, _of_reverse_cranks),
    )


def _amount(amount_g_mm: float, speed_rpm: float) -> str:
    force = plain_number(newton(abs(amount_g_mm), speed_rpm))
    return f"{abs(amount_g_mm):.5g} g·mm ({force} N at {speed_key(speed_rpm)} rpm)"


def _amounts(axes: ByAxis, speed_rpm: float, most: int = 2, where: dict[str, str] = CYLINDER) -> str:
    """The first ``most`` orders in each direction, as one phrase."""
    phrases = []
    for axis, direction in where.items():
        orders = list((axes[axis] or {}).items())[:most]
        phrases += [f"{_amount(amount, speed_rpm)} of order {order} {direction}" for order, amount in orders]
    return listed(phrases) or _NO_FORCE


def _of_strategies(strategies: dict[Strategy, StrategyBalance | None], speed_rpm: float) -> list[str]:
    sentences = []
    turning = {"with crank": ", turning with the crank", "against crank": ", turning against the crank"}
    for name, balance in strategies.items():
        if balance is None:
            continue
        if name == "d":
            couple, adds = "", "takes off" if balance.total_g < 0 else "adds"
            if balance.couple_g_mm2 is not None:
                couple = f" of up to {plain_number(1e-3 * newton(balance.couple_g_mm2, speed_rpm))} N·m"
            sentences.append(
                f"Strategy d {adds} {abs(balance.total_g):.5g} g and leaves no force of any order; a couple{couple} "
                f"at {speed_key(speed_rpm)} rpm remains."
            )
            continue
        sizes = {"x": balance.residual_x_g_mm, "y": balance.residual_y_g_mm}
        first = _amounts({axis: {"1": size} if size else None for axis, size in sizes.items()}, speed_rpm)
        higher = ", and every higher order along the cylinder" if balance.higher_orders_x_g_mm else ""
        turns = turning.get(balance.rotation, "")
        sentences.append(f"Strategy {name} ({_on_crank(balance)}) leaves {first}{turns}{higher}.")
    return sentences


def _on_crank(strategy: StrategyBalance) -> str:
    """The counterweight of a strategy in words, its angle where it does not stand opposite to the pin."""
    grams, angle_deg = strategy.counterweight_g, strategy.counterweight_deg
    if grams < 0:
        return f"{-grams:.5g} g off the crank opposite to its pin"
    return f"{grams:.5g} g on the crank" + (f", {angle_deg:.5g}° on from opposite to its pin" if angle_deg else "")


def _of_shafts(shafts: ShaftBalance, speed_rpm: float, where: dict[str, str]) -> list[str]:
    sentences = []
    for name, layout in shafts.sets.items():
        if layout is not None:
            left = _amounts(layout.left.force_g_mm, speed_rpm, most=1)
            sentences.append(f"Shafts of possibility {name} on strategy {layout.strategy} leave {left} first of all.")
    if shafts.built_for_ratio is not None:
        left = _amount(shafts.built_for_ratio.residual_x_g_mm, speed_rpm)
        sentences.append(f"A second-order pair built for the crank ratio instead of A2 leaves {left}.")
    if shafts.own is not None:
        orders = " and ".join(map(str, shafts.own.orders))
        left = _amounts(shafts.own.left.force_g_mm, speed_rpm, most=4, where=where)
        sentences.append(f"With its own shafts for order {orders} the engine still shakes with {left}.")
        sentences += moment_sentences(shafts.own.left.moment_g_mm2 or {}, speed_rpm, state="With them")
    return sentences


def _of_pairs(pairs: tuple[ShaftPair, ...], speed_rpm: float) -> list[str]:
    sentences = []
    for pair in pairs:
        if pair.scenarios is None:
            continue
        literal, physical = pair.scenarios["literal"], pair.scenarios["physical"]
        left = _amount(literal.residual_x_g_mm, speed_rpm)
        if pair.order == 1:
            sentences.append(f"The pair of order 1 as printed leaves {left}, less than its rounding can tell.")
            continue
        sense = "too much" if literal.residual_x_g_mm < 0 else "too little"
        sentences.append(
            f"The pair of order {pair.order} with the printed unbalance makes {literal.overbalance:.3f} times "
            f"the force needed, {left} {sense}; with that over "
            f"{pair.order**2} it leaves {_amount(physical.residual_x_g_mm, speed_rpm)}."
        )
    return sentences


def _of_crankshaft(crankshaft: CrankshaftBalance, speed_rpm: float) -> list[str]:
    static, dynamic = abs(crankshaft.sums.static_kg_mm), abs(crankshaft.sums.dynamic_kg_mm2)
    largest = max(abs(plane.has_kg_mm) for plane in crankshaft.planes)
    state = "is in static balance within" if static < NEARLY_STATIC * largest else "has a static unbalance of"
    key = speed_key(speed_rpm)
    needs = [f"{plain_number(abs(plane.correction_kg_mm))} kg·mm in {plane.name}" for plane in crankshaft.planes]
    sentences = [
        f"The crankshaft {state} {static * 1e3:.3g} g·mm; a rocking couple of {dynamic:.5g} kg·mm² "
        f"({plain_number(crankshaft.couple_n_m[key])} N·m at {key} rpm) turns with it, which corrections of "
        f"{' and '.join(needs)} would end."
    ]
    if crankshaft.overbalance_kg_mm is not None:
        (least, most), by = crankshaft.overbalance_kg_mm, crankshaft.overbalanced_by_kg_mm
        sentences.append(
            f"Its counterweights have {plain_number(abs(by))} kg·mm too {'much' if by >= 0 else 'little'}; "
            f"{least:g} to {most:g} too much are wanted for the balancing machine: "
            f"{'met' if crankshaft.overbalance_met else 'not met'}."
        )
    return sentences


def _of_rod_split(rod: RodBalance, speed_rpm: float) -> list[str]:
    return [
        f"Balanced for the rod as cut, the rod as weighed leaves {_amount(rod.residual_y_g_mm['1'], speed_rpm)} of "
        f"order 1 across the cylinder, {_amount(rod.residual_x_g_mm['1'], speed_rpm)} along it, and "
        f"{_amount(rod.residual_x_g_mm['2'], speed_rpm)} of order 2 too much."
    ]


def _of_added_mass(added: AddedMass, speed_rpm: float) -> list[str]:
    left = _amounts({"x": added.residual_x_g_mm, "y": None}, speed_rpm)
    beyond = "beyond every class of engines named" if added.grade is None else f"within the class {added.grade}"
    return [f"The {added.mass_g:g} g that no shaft knows leave {left}, {beyond}."]


def _of_offset(offset: OffsetBalance, speed_rpm: float) -> list[str]:
    couple = offset.couple_n_m[speed_key(speed_rpm)]
    return [
        f"An offset of {offset.offset_mm:g} mm leaves {_amount(offset.quadrature_x_g_mm, speed_rpm)} of order 1 "
        f"beside shafts for the whole reciprocating mass timed to the crank; {abs(offset.rephasing_deg):.2f}° of "
        f"re-phasing end it, but not the couples of {couple['1']:.3g} and {couple['2']:.3g} N·m of orders 1 and 2."
    ]


def _of_reverse_cranks(cranks: ReverseCranks, speed_rpm: float) -> list[str]:
    exact, leading = (_amount(cranks.residual_x_g_mm[series], speed_rpm) for series in ("exact", "leading"))
    sentences = [
        "Direct and reverse cranks leave nothing across the cylinder at any angle, and along it "
        f"{exact} at most ({leading} if built for the crank ratio)."
    ]
    if cranks.couple_g_mm2 > 0:
        couple = plain_number(1e-3 * newton(cranks.couple_g_mm2, speed_rpm))
        sentences.append(
            f"Their wheels stand unevenly and leave a couple of {couple} N·m at {speed_key(speed_rpm)} rpm."
        )
    if cranks.tolerances is not None:
        along, across = (
            _amount(sampled["1"]["95 %"], speed_rpm)
            for sampled in (cranks.tolerances.along_g_mm, cranks.tolerances.across_g_mm)
        )
        sentences.append(
            f"Of sampled gear trains 95 % leave less than {along} of order 1 along the cylinder and {across} across it."
        )
    return sentences


def balance_sheet(
    subject: BalancedEngine, *, max_order: int = 8, speeds_rpm: Sequence[float] | None = None
) -> BalanceSheet:
    """Balance of an engine.

    ``subject``: engine with its balance data. ``max_order``: highest order in the tables, ≥ 4. ``speeds_rpm``: crank
    speeds at which forces are given, > 0; the engine file's where left out. Raises RequestError outside these ranges.
    """
    speeds = tuple(float(speed) for speed in (subject.balance.speeds_rpm if speeds_rpm is None else speeds_rpm))
    _check(subject, max_order, speeds)
    engine, data = subject.engine, subject.balance
    masses, bare = reduced_masses(subject), engine.model_copy(update={"shafts": BalanceShafts()})
    single = masses if len(engine.cylinders) == 1 and not engine.webs else None
    force = force_by_order(masses, max_order=max_order) if single else whole_force(bare, max_order)
    rotates = any(cylinder.rotating_unbalance_kg_m for cylinder in engine.each)
    several = () if single else ("Masses are those of each cylinder; couples are counted from position 0.",)
    sheet = BalanceSheet(
        engine=engine.title or subject.name,
        crank_ratio=masses.mechanism.crank_ratio,
        harmonics=harmonic_shares(masses.mechanism, max_order),
        masses_g={
            "reciprocating": masses.reciprocating_g,
            "rotating_at_crank_radius": abs(masses.rotating_g),
            "rod_at_crank_pin": None if data.train is None else data.train.rod_at_crank_pin_g,
            "rod_at_piston_pin": None if data.train is None else data.train.rod_at_piston_pin_g,
        },
        piston=_piston(engine, speeds),
        # parts of a train have no counterweights yet
        counterweights_in_file=bool(engine.webs) or (data.train is None and rotates),
        force_g_mm=by_axis(force),
        force_phase_deg=by_axis(force, degrees_of),
        moment_g_mm2=whole_moments(bare, max_order),
        moment_phase_deg=whole_moments(bare, max_order, degrees_of),
        leading_g_mm=_leading(masses, max_order) if single and not engine.offset_m else None,
        force_n={speed_key(speed): by_axis(force, partial(_newton, speed_rpm=speed)) for speed in speeds},
        strategies={name: _strategy(single, name, data.places, max_order) for name in STRATEGIES} if single else None,
        shafts=_shafts(subject, single, max_order, speeds),
        cycle=None if engine.cycle == "rotor" else cycle_balance(engine, max_order=max_order, speeds=speeds),
        tolerance=tolerance_of(subject, max_order),
        design=None if single else design_balance(subject, max_order),
        crankshaft=crankshaft_of(subject, speeds),
        rod_split=rod_balance(subject, speeds) if single else None,
        added_mass=added_mass(subject, max_order, speeds) if single else None,
        offset=offset_balance(subject, speeds) if single else None,
        reverse_cranks=reverse_cranks(subject, speeds) if single else None,
        notes=(*data.notes, *several),
        sentences=(),
    )
    return replace(sheet, sentences=balance_sentences(sheet, speed_rpm=max(speeds)))


def _newton(amplitude_g_mm: complex, speed_rpm: float) -> float:
    return newton(abs(amplitude_g_mm), speed_rpm)


def _check(subject: BalancedEngine, max_order: int, speeds: Sequence[float]) -> None:
    if max_order < 4 or not speeds or not all(math.isfinite(speed) and speed > 0 for speed in speeds):
        allowed = "≥ 4, and speeds > 0"
        raise RequestError("no such balance sheet", found=f"order {max_order}, speeds {speeds} rpm", allowed=allowed)
    engine = subject.engine
    if engine.shafts.every_order and engine.shafts.every_order[-1] > max_order:
        problem = "the engine has shafts beyond the highest order of the tables"
        found = f"order {engine.shafts.every_order[-1]}"
        remedy = f"Ask for --max-order {engine.shafts.every_order[-1]}"
        raise RequestError(problem, place="shafts", found=found, allowed=f"up to {max_order}", remedy=remedy)


def _leading(masses: ReducedMasses, max_order: int) -> Amounts:
    first = masses.crank_radius_mm * masses.reciprocating_g
    terms = leading_harmonics(max_order // 2, masses.mechanism.crank_ratio)
    return {"1": first} | {str(2 * k): first * float(term) for k, term in enumerate(terms, start=1)}


def _piston(engine: Engine, speeds: Sequence[float]) -> Piston:
    fastest_rev, per_radian = fastest_piston(engine.mechanism)
    stroke_m = dead_centres(engine.mechanism).stroke_m
    mean_m_s = {speed_key(speed): stroke_m * speed / 30 for speed in speeds}
    fastest_m_s = {speed_key(speed): per_radian * speed * math.pi / 30 for speed in speeds}
    return Piston(stroke_mm=1e3 * stroke_m, fastest_deg=360 * fastest_rev, mean_m_s=mean_m_s, fastest_m_s=fastest_m_s)


def _strategy(
    masses: ReducedMasses, name: Strategy, places: CounterweightPlaces, max_order: int
) -> StrategyBalance | None:
    """Counterweights and residual of one strategy; None for d where no radius on the rod is stated."""
    if name == "d" and places.rod_mm is None:
        return None
    added = counterweights(masses, name, places)
    first, *higher = force_by_order(balanced(masses, name), max_order=max_order)
    couple = None
    if name == "d" and not masses.mechanism.offset_m:
        couple = float(np.abs(rod_counterweight_couple(masses, added, places, FULL_TURN_REV)).max())
    return StrategyBalance(
        counterweight_g=added.crank_g,
        counterweight_deg=added.crank_deg,
        rod_counterweight_g=added.rod_g if name == "d" else None,
        total_g=added.total_g,
        residual_x_g_mm=abs(first.x_g_mm),
        residual_y_g_mm=abs(first.y_g_mm),
        rotation=first.rotation,
        higher_orders_x_g_mm=by_axis(higher)["x"],
        couple_g_mm2=couple,
    )


def _shafts(
    subject: BalancedEngine, masses: ReducedMasses | None, max_order: int, speeds: Sequence[float]
) -> ShaftBalance:
    engine, data = subject.engine, subject.balance
    own = built_for_ratio = None
    if engine.shafts.every_order:
        left = replace(_residual(whole_force(engine, max_order)), moment_g_mm2=whole_moments(engine, max_order))
        own = OwnShafts(orders=engine.shafts.every_order, left=left)
    if masses is not None and not engine.offset_m:
        first = masses.crank_radius_mm * masses.reciprocating_g
        harmonic = abs(acceleration_harmonics(masses.mechanism, 2)[2])
        shortfall = float(first * (harmonic - masses.mechanism.crank_ratio))
        built_for_ratio = BuiltForRatio(residual_x_g_mm=shortfall, force_n=newton_by_speed(shortfall, speeds))
    sets = {name: None if masses is None else _shaft_set(masses, name, max_order) for name in POSSIBILITIES}
    pairs = tuple(_pair(pair, subject, speeds) for pair in data.shaft_pairs) or None
    return ShaftBalance(sets=sets, built_for_ratio=built_for_ratio, pairs=pairs, own=own)


def _residual(forces: Iterable[OrderForce]) -> Residual:
    every = tuple(forces)
    return Residual(force_g_mm=by_axis(every), phase_deg=by_axis(every, degrees_of))


def _shaft_set(masses: ReducedMasses, name: Possibility, max_order: int) -> ShaftSet:
    layout = shaft_layout(masses, name, max_order=max_order)
    shafts = tuple(
        AdditionalShaft(
            speed_ratio=shaft.speed_ratio,
            unbalance_g_mm=shaft.unbalance_g_mm,
            phase_deg=shaft.phase_deg,
            mass_at_crank_radius_g=shaft.unbalance_g_mm / masses.crank_radius_mm,
        )
        for shaft in layout.shafts
    )
    left = _residual(force for force in layout.residual if force.rotation != "none")
    return ShaftSet(strategy=layout.strategy, shafts=shafts, left=left)


def _pair(pair: ShaftPairParts, subject: BalancedEngine, speeds: Sequence[float]) -> ShaftPair:
    design, measured = (parts_unbalance_g_mm(pair.parts, masses=kind) for kind in ("design", "measured"))
    stated, needed = pair.printed_pair_g_mm, pair.printed_needed_g_mm

    def reading(unbalance_g_mm: float, force_g_mm: float, needed_g_mm: float) -> PairReading:
        left = needed_g_mm - force_g_mm
        return PairReading(
            pair_unbalance_g_mm=unbalance_g_mm,
            pair_force_g_mm=force_g_mm,
            residual_x_g_mm=left,
            overbalance=force_g_mm / needed_g_mm,
            residual_n=newton_by_speed(left, speeds),
            grade=unbalance_class(left, subject.balance.residual_classes),
        )

    readings: dict[Reading, PairReading] | None = None
    if stated is not None and needed is not None:
        # a pair that turns order times as fast makes order² times the force, so the number can only equal the needed
        # force if order² is already in it: truth sheet 2.4 (the factor of four of table 3); Task 5, equation (5.28)
        square = pair.order**2
        readings = {
            "literal": reading(stated, square * stated, needed),
            "physical": reading(stated / square, stated, needed),
        }
    return ShaftPair(
        order=pair.order,
        one_shaft_design_g_mm=design,
        one_shaft_measured_g_mm=measured,
        pair_design_g_mm=2 * design,
        pair_measured_g_mm=2 * measured,
        pair_rounding_g_mm=pair_rounding_g_mm(pair.parts),
        printed_pair_g_mm=stated,
        printed_needed_g_mm=needed,
        scenarios=readings,
    )
