"""The balance sheet of an engine: one document with the tables that a designer wants and what remains unbalanced."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from crankorder.engine.balance_data import BalancedEngine, reduced_masses
from crankorder.engine.balance_sentences import balance_sentences
from crankorder.engine.balancing import (
    CounterweightPlaces,
    ReducedMasses,
    Strategy,
    balanced,
    counterweights,
    equivalent_masses,
    force_by_order,
    rod_counterweight_couple,
)
from crankorder.engine.definition import BalanceShafts, Engine
from crankorder.engine.forces import DIRECTIONS, crankcase_forces, crankcase_moments
from crankorder.engine.harmonics import acceleration_harmonics
from crankorder.engine.polar import OrderForce
from crankorder.engine.residual_tables import (
    FULL_TURN_REV,
    added_mass_table,
    crankshaft_table,
    harmonic_shares,
    newton,
    newton_by_speed,
    offset_table,
    reverse_crank_table,
    rod_split_table,
    speed_key,
)
from crankorder.engine.residuals import leading_harmonics, unbalance_class
from crankorder.engine.shafts import (
    Possibility,
    ShaftPairParts,
    pair_rounding_g_mm,
    pair_scenarios,
    parts_unbalance_g_mm,
    shaft_layout,
)
from crankorder.errors import RequestError

STRATEGIES: tuple[Strategy, ...] = ("a", "b", "c", "d")
POSSIBILITIES: tuple[Possibility, ...] = ("1", "2", "3", "4", "4+2")
ONE_RADIAN_PER_S_RPM = 30 / math.pi
DUST = 1e-15
"""A sum over cylinders below this share of its terms is round-off of what cancels."""


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
    if max_order < 4 or not speeds or not all(math.isfinite(speed) and speed > 0 for speed in speeds):
        raise RequestError(
            "no such balance sheet", found=f"order {max_order}, speeds {speeds} rpm", allowed="≥ 4, and speeds > 0"
        )
    engine, data = subject.engine, subject.balance
    single = len(engine.cylinders) == 1
    masses = reduced_masses(subject)
    made = force_by_order(masses, max_order=max_order)
    if not single:
        made = _engine_force(engine.model_copy(update={"shafts": BalanceShafts()}), max_order)
    one = masses if single else None
    sheet: dict[str, Any] = {
        "engine": engine.title or subject.name,
        "lambda": masses.mechanism.crank_ratio,
        "harmonics": harmonic_shares(masses.mechanism, max_order),
        "masses_g": _masses(subject, masses),
        "force_g_mm": _axes(made),
        "moment_g_mm2": None if single else _moments(engine, max_order),
        "leading_g_mm": None if one is None or engine.offset_m else _leading(masses, max_order),
        "force_n": {speed_key(speed): _forces_n(made, speed) for speed in speeds},
        "strategies": None
        if one is None
        else {name: _strategy(one, name, data.places, max_order) for name in STRATEGIES},
        "shafts": _shafts(subject, one, max_order, speeds),
        "crankshaft": crankshaft_table(subject, speeds),
        "rod_split": None if one is None else rod_split_table(subject, speeds),
        "added_mass": None if one is None else added_mass_table(subject, max_order, speeds),
        "offset": None if one is None else offset_table(subject, speeds),
        "reverse_cranks": None if one is None else reverse_crank_table(subject, speeds),
        "notes": list(data.notes),
    }
    if not single:
        sheet["notes"].append(
            "Masses are those of each cylinder; strategies and shafts are worked out for engines of one cylinder."
        )
    sheet["sentences"] = balance_sentences(sheet, speed_rpm=max(speeds))
    return sheet


def _engine_force(engine: Engine, max_order: int) -> tuple[OrderForce, ...]:
    """Force of the whole engine over ω², by order."""
    forces = crankcase_forces(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e6
    along, across = forces[DIRECTIONS.index("Z")], forces[DIRECTIONS.index("X")]
    largest = _terms_g_mm(engine)
    made = [
        OrderForce.of_axes(order=k, x_g_mm=_dusted(along[k], largest), y_g_mm=_dusted(across[k], largest))
        for k in range(1, max_order + 1)
    ]
    return tuple(force for force in made if force.rotation != "none")


def _moments(engine: Engine, max_order: int) -> dict[str, dict[str, float] | None]:
    """Moments of several cylinders over ω², by order, about the axes along and across them and the crankshaft's."""
    moments = np.abs(crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order)) * 1e9
    named = {"about_x": "Z", "about_y": "X", "about_crankshaft": "Y"}
    reach_mm = 1e3 * (engine.rod_length_m + max(abs(cylinder.position_m) for cylinder in engine.cylinders))
    dust = DUST * _terms_g_mm(engine) * reach_mm
    found = {
        name: {str(k): float(amount) for k, amount in enumerate(moments[DIRECTIONS.index(axis)]) if k and amount > dust}
        for name, axis in named.items()
    }
    return {name: orders or None for name, orders in found.items()}


def _terms_g_mm(engine: Engine) -> float:
    """Size of what is summed over the cylinders: the whole first order."""
    one = engine.reciprocating_mass_kg * engine.crank_radius_m + engine.rotating_unbalance_kg_m
    return 1e6 * len(engine.cylinders) * one


def _dusted(value: Any, largest: float) -> complex:
    """``value``, or zero where it is round-off of the sum over cylinders."""
    return complex(value) if abs(value) > DUST * largest else 0j


def _axes(forces: Iterable[OrderForce]) -> dict[str, dict[str, float] | None]:
    every = tuple(forces)
    along = {f"{force.order:g}": abs(force.x_g_mm) for force in every if force.x_g_mm}
    across = {f"{force.order:g}": abs(force.y_g_mm) for force in every if force.y_g_mm}
    return {"x": along or None, "y": across or None}


def _forces_n(forces: Iterable[OrderForce], speed_rpm: float) -> dict[str, dict[str, float] | None]:
    return {
        axis: None if orders is None else {order: newton(amount, speed_rpm) for order, amount in orders.items()}
        for axis, orders in _axes(forces).items()
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
        "higher_orders_x_g_mm": _axes(higher)["x"],
        "couple_g_mm2": couple,
    }


def _shafts(
    subject: BalancedEngine, masses: ReducedMasses | None, max_order: int, speeds: Sequence[float]
) -> dict[str, Any]:
    engine, data = subject.engine, subject.balance
    own = None
    if engine.shafts.every_order:
        left = _engine_force(engine, max_order)
        own = {"orders": list(engine.shafts.every_order), "residual_g_mm": _axes(left)}
    layouts: dict[str, Any] = {
        name: None if masses is None else _layout(masses, name, data.places, max_order) for name in POSSIBILITIES
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


def _layout(masses: ReducedMasses, name: Possibility, places: CounterweightPlaces, max_order: int) -> dict[str, Any]:
    layout = shaft_layout(masses, name, max_order=max_order)
    radius = {1: places.first_order_shaft_mm, 2: places.second_order_shaft_mm}
    shafts = []
    for shaft in layout.shafts:
        at = radius[round(abs(shaft.speed_ratio))]
        shafts.append(
            {
                "speed_ratio": shaft.speed_ratio,
                "unbalance_g_mm": shaft.unbalance_g_mm,
                "phase_deg": shaft.phase_deg,
                "mass_at_crank_radius_g": shaft.unbalance_g_mm / masses.crank_radius_mm,
                "mass_g": None if at is None else shaft.unbalance_g_mm / at,
            }
        )
    remains = [force for force in layout.residual if force.rotation != "none"]
    return {"strategy": layout.strategy, "shafts": shafts, "residual_g_mm": _axes(remains)}


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
