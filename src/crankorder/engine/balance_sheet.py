"""The balance sheet of an engine: one document with the tables that a designer wants, and sentences on what remains."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from crankorder.engine.balance_data import (
    FULL_TURN_REV,
    BalancedEngine,
    added_mass_table,
    crankshaft_of,
    harmonic_shares,
    leading_harmonics,
    newton,
    newton_by_speed,
    offset_table,
    reduced_masses,
    reverse_crank_table,
    rod_split_table,
    speed_key,
    unbalance_class,
)
from crankorder.engine.balancing import (
    CounterweightPlaces,
    OrderForce,
    ReducedMasses,
    Strategy,
    balanced,
    counterweights,
    equivalent_masses,
    force_by_order,
    rod_counterweight_couple,
)
from crankorder.engine.cycle_tables import cycle_sentences, cycle_table
from crankorder.engine.definition import BalanceShafts, Engine
from crankorder.engine.engine_tables import (
    by_axis,
    degrees_of,
    design_sentences,
    design_table,
    moment_phases,
    moment_sentences,
    tolerance_of,
    whole_force,
    whole_moments,
)
from crankorder.engine.harmonics import acceleration_harmonics
from crankorder.engine.shafts import (
    Possibility,
    ShaftPairParts,
    pair_rounding_g_mm,
    pair_scenarios,
    parts_unbalance_g_mm,
    shaft_layout,
)
from crankorder.engine.slider_crank import dead_centres, fastest_piston
from crankorder.engine.tolerance_study import tolerance_sentences
from crankorder.errors import RequestError, plain_number

NEARLY_STATIC = 0.01
"""Static unbalance below this share of a crankshaft's largest counterweight is named as balance."""


_NO_FORCE = "no force"
CYLINDER = {"x": "along the cylinder", "y": "across the cylinder"}
FRAME = {"x": "along Z", "y": "along X"}
"""Words for the two directions, for one cylinder and for several; Z points from the crankshaft to the middle bank."""


def balance_sentences(sheet: dict[str, Any], *, speed_rpm: float) -> list[str]:
    """Sentences that say what remains unbalanced, the plain engine first.

    ``sheet``: tables as :func:`crankorder.engine.balance_sheet.balance_sheet` makes them. ``speed_rpm``: crank speed at
    which forces are named.
    """
    where = CYLINDER if sheet["strategies"] else FRAME
    state = plain_state(sheet)
    made = _amounts(sheet["force_g_mm"], speed_rpm, where=where)
    shakes = "no force shakes the engine" if made == _NO_FORCE else f"the engine shakes with {made}"
    said = [f"{state[0].upper()}{state[1:]} {shakes}."]
    said += moment_sentences(sheet["moment_g_mm2"], speed_rpm)
    key, piston = speed_key(speed_rpm), sheet["piston"]
    mean, fastest = (plain_number(piston[name][key]) for name in ("mean_m_s", "fastest_m_s"))
    said.append(
        f"At {key} rpm a piston moves at {mean} m/s in the mean and {fastest} m/s at most, at "
        f"{piston['fastest_deg']:.4g}° after its dead centre."
    )
    parts: tuple[tuple[Any, Callable[[Any, float], list[str]]], ...] = (
        (sheet["cycle"], cycle_sentences),
        (sheet["strategies"], _of_strategies),
        (sheet["shafts"], partial(_of_shafts, where=where)),
        (sheet["design"], design_sentences),
        (sheet["tolerance"], tolerance_sentences),
        (sheet["shafts"]["pairs"], _of_pairs),
        (sheet["crankshaft"], _of_crankshaft),
        (sheet["rod_split"], _of_rod_split),
        (sheet["added_mass"], _of_added_mass),
        (sheet["offset"], _of_offset),
        (sheet["reverse_cranks"], _of_reverse_cranks),
    )
    for table, sentences in parts:
        if table is not None:
            said += sentences(table, speed_rpm)
    return said


def plain_state(sheet: Mapping[str, Any]) -> str:
    """What the plain engine of a ``sheet`` is called: a rotating unbalance that its file states has counterweights."""
    if not sheet["counterweights_in_file"]:
        return "with no balancing"
    return "as built" if sheet["shafts"]["own"] is None else "without its shafts"


def _one(amount_g_mm: float, speed_rpm: float) -> str:
    force = plain_number(newton(abs(amount_g_mm), speed_rpm))
    return f"{abs(amount_g_mm):.5g} g·mm ({force} N at {speed_key(speed_rpm)} rpm)"


def _amounts(
    axes: dict[str, dict[str, float] | None], speed_rpm: float, most: int = 2, where: dict[str, str] = CYLINDER
) -> str:
    """The first ``most`` orders in each direction, as one phrase."""
    phrases = []
    for axis, direction in where.items():
        orders = list((axes[axis] or {}).items())[:most]
        phrases += [f"{_one(amount, speed_rpm)} of order {order} {direction}" for order, amount in orders]
    return " and ".join([", ".join(phrases[:-1]), phrases[-1]]) if len(phrases) > 1 else (phrases or [_NO_FORCE])[0]


def _of_strategies(strategies: dict[str, Any], speed_rpm: float) -> list[str]:
    said = []
    turning = {"with crank": ", turning with the crank", "against crank": ", turning against the crank"}
    for name, found in strategies.items():
        if found is None:
            continue
        if name == "d":
            couple, adds = "", "takes off" if found["total_g"] < 0 else "adds"
            if found["couple_g_mm2"] is not None:
                newton_metres = 1e-3 * newton(found["couple_g_mm2"], speed_rpm)
                couple = f" of up to {plain_number(newton_metres)} N·m"
            said.append(
                f"Strategy d {adds} {abs(found['total_g']):.5g} g and leaves no force of any order; a couple{couple} "
                f"at {speed_key(speed_rpm)} rpm remains."
            )
            continue
        first = {axis: {"1": size} if (size := found[f"residual_{axis}_g_mm"]) else None for axis in "xy"}
        higher = "" if not found["higher_orders_x_g_mm"] else ", and every higher order along the cylinder"
        said.append(
            f"Strategy {name} ({_on_crank(found)}) leaves {_amounts(first, speed_rpm)}"
            f"{turning.get(found['rotation'], '')}{higher}."
        )
    return said


def _on_crank(strategy: dict[str, Any]) -> str:
    """The counterweight of a strategy in words, its angle where it does not stand opposite to the pin."""
    grams, angle_deg = strategy["counterweight_g"], strategy["counterweight_deg"]
    if grams < 0:
        return f"{-grams:.5g} g off the crank opposite to its pin"
    return f"{grams:.5g} g on the crank" + (f", {angle_deg:.5g}° on from opposite to its pin" if angle_deg else "")


def _of_shafts(shafts: dict[str, Any], speed_rpm: float, where: dict[str, str]) -> list[str]:
    said = []
    for name in ("1", "2", "3", "4", "4+2"):
        layout = shafts.get(name)
        if layout is not None:
            left = _amounts(layout["residual_g_mm"], speed_rpm, most=1)
            said.append(f"Shafts of possibility {name} on strategy {layout['strategy']} leave {left} first of all.")
    built = shafts["second_order_built_for_lambda"]
    if built is not None:
        said.append(
            "A second-order pair built for the crank ratio instead of A2 leaves "
            f"{_one(built['residual_x_g_mm'], speed_rpm)}."
        )
    own = shafts["own"]
    if own is not None:
        orders = " and ".join(str(order) for order in own["orders"])
        left = _amounts(own["residual_g_mm"], speed_rpm, most=4, where=where)
        said.append(f"With its own shafts for order {orders} the engine still shakes with {left}.")
        said += moment_sentences(own["residual_moment_g_mm2"], speed_rpm, state="With them")
    return said


def _of_pairs(pairs: list[dict[str, Any]], speed_rpm: float) -> list[str]:
    said = []
    for pair in pairs:
        if pair["scenarios"] is None:
            continue
        literal, physical = pair["scenarios"]["literal"], pair["scenarios"]["physical"]
        if pair["order"] == 1:
            left = _one(literal["residual_x_g_mm"], speed_rpm)
            said.append(f"The pair of order 1 as printed leaves {left}, less than its rounding can tell.")
            continue
        sense = "too much" if literal["residual_x_g_mm"] < 0 else "too little"
        said.append(
            f"The pair of order {pair['order']} with the printed unbalance makes {literal['overbalance']:.3f} times "
            f"the force needed, {_one(literal['residual_x_g_mm'], speed_rpm)} {sense}; with that over "
            f"{pair['order'] ** 2} it leaves {_one(physical['residual_x_g_mm'], speed_rpm)}."
        )
    return said


def _of_crankshaft(table: dict[str, Any], speed_rpm: float) -> list[str]:
    static = abs(complex(table["static_kg_mm"]["x"], table["static_kg_mm"]["y"]))
    dynamic = abs(complex(table["dynamic_kg_mm2"]["x"], table["dynamic_kg_mm2"]["y"]))
    largest = max(abs(complex(plane["has_kg_mm"]["x"], plane["has_kg_mm"]["y"])) for plane in table["planes"])
    state = "is in static balance within" if static < NEARLY_STATIC * largest else "has a static unbalance of"
    couple = table["couple_Nm_at_rpm"][speed_key(speed_rpm)]
    corrections = [(plane["name"], plane["correction_kg_mm"]) for plane in table["planes"]]
    needs = " and ".join(f"{plain_number(abs(complex(by['x'], by['y'])))} kg·mm in {name}" for name, by in corrections)
    said = [
        f"The crankshaft {state} {static * 1e3:.3g} g·mm; a rocking couple of {dynamic:.5g} kg·mm² "
        f"({plain_number(couple)} N·m at {speed_key(speed_rpm)} rpm) turns with it, which corrections of {needs} would "
        "end."
    ]
    if table["overbalance_met"] is not None:
        least, most = table["overbalance_kg_mm"]
        by = table["overbalanced_by_kg_mm"]
        said.append(
            f"Its counterweights have {plain_number(abs(by))} kg·mm too {'much' if by >= 0 else 'little'}; "
            f"{least:g} to {most:g} too much are wanted for the balancing machine: "
            f"{'met' if table['overbalance_met'] else 'not met'}."
        )
    return said


def _of_rod_split(table: dict[str, Any], speed_rpm: float) -> list[str]:
    return [
        f"Balanced for the rod as cut, the rod as weighed leaves {_one(table['residual_y_g_mm']['1'], speed_rpm)} of "
        f"order 1 across the cylinder, {_one(table['residual_x_g_mm']['1'], speed_rpm)} along it, and "
        f"{_one(table['residual_x_g_mm']['2'], speed_rpm)} of order 2 too much."
    ]


def _of_added_mass(table: dict[str, Any], speed_rpm: float) -> list[str]:
    left = {"x": table["residual_x_g_mm"], "y": None}
    grade = table["class"]
    beyond = "beyond every class of engines named" if grade is None else f"within the class {grade}"
    return [f"The {table['mass_g']:g} g that no shaft knows leave {_amounts(left, speed_rpm)}, {beyond}."]


def _of_offset(table: dict[str, Any], speed_rpm: float) -> list[str]:
    couple = table["couple_Nm_at_rpm"][speed_key(speed_rpm)]
    return [
        f"An offset of {table['offset_mm']:g} mm leaves {_one(table['quadrature_x_g_mm'], speed_rpm)} of order 1 "
        f"beside shafts for the whole reciprocating mass timed to the crank; {abs(table['rephasing_deg']):.2f}° of "
        f"re-phasing end it, but not the couples of {couple['1']:.3g} and {couple['2']:.3g} N·m of orders 1 and 2."
    ]


def _of_reverse_cranks(table: dict[str, Any], speed_rpm: float) -> list[str]:
    said = [
        f"Direct and reverse cranks leave nothing across the cylinder at any angle, and along it "
        f"{_one(table['residual_x_g_mm']['exact'], speed_rpm)} at most "
        f"({_one(table['residual_x_g_mm']['leading'], speed_rpm)} if built for the crank ratio)."
    ]
    if table["couple_g_mm2"] > 0:
        couple = 1e-3 * newton(table["couple_g_mm2"], speed_rpm)
        said.append(
            f"Their wheels stand unevenly and leave a couple of {plain_number(couple)} N·m at "
            f"{speed_key(speed_rpm)} rpm."
        )
    if table["tolerances"] is not None:
        across = table["tolerances"]["across_g_mm"]["1"]["95 %"]
        along = table["tolerances"]["along_g_mm"]["1"]["95 %"]
        said.append(
            f"Of sampled gear trains 95 % leave less than {_one(along, speed_rpm)} of order 1 along the cylinder and "
            f"{_one(across, speed_rpm)} across it."
        )
    return said


STRATEGIES: tuple[Strategy, ...] = ("a", "b", "c", "d")
POSSIBILITIES: tuple[Possibility, ...] = ("1", "2", "3", "4", "4+2")


def balance_sheet(
    subject: BalancedEngine, *, max_order: int = 8, speeds_rpm: Sequence[float] | None = None
) -> dict[str, Any]:
    """Balance of an engine as one document of plain numbers, lists and texts, ready for JSON.

    x lies along the cylinder, y across it. Amounts in g·mm are amplitudes over ω²; a part that the engine has no data
    for is None. ``sentences`` say what remains unbalanced.

    ``subject``: engine with its balance data. ``max_order``: highest order in the tables, ≥ 4. ``speeds_rpm``: crank
    speeds at which forces are given, > 0; the engine file's where left out. Raises RequestError outside these ranges.
    """
    speeds = tuple(float(speed) for speed in (subject.balance.speeds_rpm if speeds_rpm is None else speeds_rpm))
    _check(subject, max_order, speeds)
    engine, data = subject.engine, subject.balance
    single = len(engine.cylinders) == 1 and not engine.webs
    masses = reduced_masses(subject)
    bare = engine.model_copy(update={"shafts": BalanceShafts()})
    made = force_by_order(masses, max_order=max_order) if single else whole_force(bare, max_order)
    one = masses if single else None
    rotates = any(cylinder.rotating_unbalance_kg_m for cylinder in engine.each)
    sheet: dict[str, Any] = {
        "engine": engine.title or subject.name,
        "lambda": masses.mechanism.crank_ratio,
        "harmonics": harmonic_shares(masses.mechanism, max_order),
        "masses_g": _masses(subject, masses),
        "piston": _piston(engine, speeds),
        # parts of a train have no counterweights yet
        "counterweights_in_file": bool(engine.webs) or (data.train is None and rotates),
        "force_g_mm": by_axis(made),
        "force_phase_deg": by_axis(made, degrees_of),
        "moment_g_mm2": whole_moments(bare, max_order),
        "moment_phase_deg": moment_phases(bare, max_order),
        "leading_g_mm": None if one is None or engine.offset_m else _leading(masses, max_order),
        "force_n": {speed_key(speed): _forces_n(made, speed) for speed in speeds},
        "strategies": None
        if one is None
        else {name: _strategy(one, name, data.places, max_order) for name in STRATEGIES},
        "shafts": _shafts(subject, one, max_order, speeds),
        "cycle": None if engine.cycle == "rotor" else cycle_table(engine, max_order=max_order, speeds=speeds),
        "tolerance": tolerance_of(subject, max_order),
        "design": None if single else design_table(subject, max_order),
        "crankshaft": crankshaft_of(subject, speeds),
        "rod_split": None if one is None else rod_split_table(subject, speeds),
        "added_mass": None if one is None else added_mass_table(subject, max_order, speeds),
        "offset": None if one is None else offset_table(subject, speeds),
        "reverse_cranks": None if one is None else reverse_crank_table(subject, speeds),
        "notes": list(data.notes),
    }
    if not single:
        sheet["notes"].append("Masses are those of each cylinder; couples are counted from position 0.")
    sheet["sentences"] = balance_sentences(sheet, speed_rpm=max(speeds))
    return sheet


def _check(subject: BalancedEngine, max_order: int, speeds: Sequence[float]) -> None:
    if max_order < 4 or not speeds or not all(math.isfinite(speed) and speed > 0 for speed in speeds):
        raise RequestError(
            "no such balance sheet", found=f"order {max_order}, speeds {speeds} rpm", allowed="≥ 4, and speeds > 0"
        )
    engine = subject.engine
    if engine.shafts.every_order and engine.shafts.every_order[-1] > max_order:
        raise RequestError(
            "the engine has shafts beyond the highest order of the tables",
            place="shafts",
            found=f"order {engine.shafts.every_order[-1]}",
            allowed=f"up to {max_order}",
            remedy=f"Ask for --max-order {engine.shafts.every_order[-1]}",
        )


def _forces_n(forces: Iterable[OrderForce], speed_rpm: float) -> dict[str, dict[str, float] | None]:
    return {
        axis: None if orders is None else {order: newton(amount, speed_rpm) for order, amount in orders.items()}
        for axis, orders in by_axis(forces).items()
    }


def _leading(masses: ReducedMasses, max_order: int) -> dict[str, float]:
    first = masses.crank_radius_mm * masses.reciprocating_g
    terms = leading_harmonics(max_order // 2, masses.mechanism.crank_ratio)
    return {"1": first} | {str(2 * k): first * float(term) for k, term in enumerate(terms, start=1)}


def _masses(subject: BalancedEngine, masses: ReducedMasses) -> dict[str, float | None]:
    train = subject.balance.train
    parts = None if train is None else equivalent_masses(train)
    return {
        "reciprocating": masses.reciprocating_g,
        "rotating_at_crank_radius": abs(masses.rotating_g),
        "rod_at_crank_pin": None if parts is None else parts.rod_at_crank_pin_g,
        "rod_at_piston_pin": None if parts is None else parts.rod_at_piston_pin_g,
    }


def _piston(engine: Engine, speeds: Sequence[float]) -> dict[str, Any]:
    """Stroke, where a piston goes down fastest, and its speeds in m/s."""
    fastest_rev, per_radian = fastest_piston(engine.mechanism)
    stroke_m = dead_centres(engine.mechanism).stroke_m
    return {
        "stroke_mm": 1e3 * stroke_m,
        "fastest_deg": 360 * fastest_rev,
        "mean_m_s": {speed_key(speed): stroke_m * speed / 30 for speed in speeds},
        "fastest_m_s": {speed_key(speed): per_radian * speed * math.pi / 30 for speed in speeds},
    }


def _strategy(
    masses: ReducedMasses, name: Strategy, places: CounterweightPlaces, max_order: int
) -> dict[str, Any] | None:
    """Counterweights and residual of one strategy; None for d where no radius on the rod is stated."""
    if name == "d" and places.rod_mm is None:
        return None
    added = counterweights(masses, name, places)
    first, *higher = force_by_order(balanced(masses, name), max_order=max_order)
    couple = None
    if name == "d" and not masses.mechanism.offset_m:
        couple = float(np.abs(rod_counterweight_couple(masses, added, places, FULL_TURN_REV)).max())
    return {
        "counterweight_g": added.crank_g,
        "counterweight_deg": added.crank_deg,
        "rod_counterweight_g": added.rod_g if name == "d" else None,
        "total_g": added.total_g,
        "residual_x_g_mm": abs(first.x_g_mm),
        "residual_y_g_mm": abs(first.y_g_mm),
        "rotation": first.rotation,
        "higher_orders_x_g_mm": by_axis(higher)["x"],
        "couple_g_mm2": couple,
    }


def _shafts(
    subject: BalancedEngine, masses: ReducedMasses | None, max_order: int, speeds: Sequence[float]
) -> dict[str, Any]:
    engine, data = subject.engine, subject.balance
    own = None
    if engine.shafts.every_order:
        left = whole_force(engine, max_order)
        own = {
            "orders": list(engine.shafts.every_order),
            "residual_g_mm": by_axis(left),
            "residual_phase_deg": by_axis(left, degrees_of),
            "residual_moment_g_mm2": whole_moments(engine, max_order),
        }
    layouts: dict[str, Any] = {
        name: None if masses is None else _layout(masses, name, max_order) for name in POSSIBILITIES
    }
    built_for_leading = None
    if masses is not None and not engine.offset_m:
        first = masses.crank_radius_mm * masses.reciprocating_g
        harmonic = abs(acceleration_harmonics(masses.mechanism, 2)[2])
        shortfall = float(first * (harmonic - masses.mechanism.crank_ratio))
        built_for_leading = {"residual_x_g_mm": shortfall, "force_n": newton_by_speed(shortfall, speeds)}
    return {
        **layouts,
        "second_order_built_for_lambda": built_for_leading,
        "pairs": [_pair(pair, subject, speeds) for pair in data.shaft_pairs] or None,
        "own": own,
    }


def _layout(masses: ReducedMasses, name: Possibility, max_order: int) -> dict[str, Any]:
    layout = shaft_layout(masses, name, max_order=max_order)
    shafts = [
        {
            "speed_ratio": shaft.speed_ratio,
            "unbalance_g_mm": shaft.unbalance_g_mm,
            "phase_deg": shaft.phase_deg,
            "mass_at_crank_radius_g": shaft.unbalance_g_mm / masses.crank_radius_mm,
        }
        for shaft in layout.shafts
    ]
    remains = [force for force in layout.residual if force.rotation != "none"]
    left = {"residual_g_mm": by_axis(remains), "residual_phase_deg": by_axis(remains, degrees_of)}
    return {"strategy": layout.strategy, "shafts": shafts, **left}


def _pair(pair: ShaftPairParts, subject: BalancedEngine, speeds: Sequence[float]) -> dict[str, Any]:
    design, measured = (parts_unbalance_g_mm(pair.parts, masses=kind) for kind in ("design", "measured"))
    scenarios = None
    if pair.printed_pair_g_mm is not None and pair.printed_needed_g_mm is not None:
        read = pair_scenarios(
            pair_unbalance_g_mm=pair.printed_pair_g_mm, needed_force_g_mm=pair.printed_needed_g_mm, order=pair.order
        )
        scenarios = {
            name: {
                "pair_unbalance_g_mm": scenario.pair_unbalance_g_mm,
                "pair_force_g_mm": scenario.pair_force_g_mm,
                "residual_x_g_mm": scenario.residual_g_mm,
                "overbalance": scenario.overbalance,
                "residual_n": newton_by_speed(scenario.residual_g_mm, speeds),
                "class": unbalance_class(scenario.residual_g_mm, subject.balance.residual_classes),
            }
            for name, scenario in read.items()
        }
    return {
        "order": pair.order,
        "one_shaft_design_g_mm": design,
        "one_shaft_measured_g_mm": measured,
        "pair_design_g_mm": 2 * design,
        "pair_measured_g_mm": 2 * measured,
        "pair_rounding_g_mm": pair_rounding_g_mm(pair.parts),
        "printed_pair_g_mm": pair.printed_pair_g_mm,
        "printed_needed_g_mm": pair.printed_needed_g_mm,
        "scenarios": scenarios,
    }
