"""The balance sheet of an engine: one document with all that a designer wants to know.

``data_schema/balance.json`` says what each of its keys is. Text, JSON, dataset and pictures are made of it and of the
engines that :func:`crankorder.engine.balancing.systems` gives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from crankorder.engine import balancing, shafts
from crankorder.engine.balance_data import BalancedEngine, GearTolerances, GearTrain, ShaftPairParts, UnbalanceClass
from crankorder.engine.balancing import POSSIBILITIES, STRATEGIES, Possibility, Strategy
from crankorder.engine.cycle_tables import cycle_balance, roll_balance
from crankorder.engine.definition import BalanceShafts, Engine, Weight
from crankorder.engine.forces import FRAME, Amounts, newton, speed_key
from crankorder.engine.shafts import Series
from crankorder.engine.slider_crank import (
    SliderCrank,
    acceleration_harmonics,
    dead_centres,
    fastest_piston,
    plain_piston_acceleration,
)
from crankorder.errors import RequestError

Sheet = dict[str, Any]
"""A balance document or a part of it, ready for JSON."""

FULL_TURN_REV = np.arange(720) / 720
"""Crank angles of a full turn; the quarter turns, where residuals peak, are among them."""


def balance_sheet(subject: BalancedEngine, *, max_order: int = 8, speeds_rpm: Sequence[float] | None = None) -> Sheet:
    """Balance of an engine: forces, moments, counterweights, shafts, parts, and what each of them leaves.

    Axes are those of ``FRAME``: one cylinder stands along Z. Orders and speeds (rpm) are keys, as texts; a part that
    the engine has no data for is None.

    ``subject``: engine with its balance data. ``max_order``: highest order in the tables, ≥ 4. ``speeds_rpm``: crank
    speeds at which forces are given, > 0; the engine file's where left out. Raises RequestError outside these ranges.
    """
    speeds = tuple(float(speed) for speed in (subject.balance.speeds_rpm if speeds_rpm is None else speeds_rpm))
    _check(subject.engine, max_order, speeds)
    engine, data, single, ways = subject.engine, subject.balance, subject.is_single, balancing.systems(subject)
    plain = ways["none"]
    left = {name: _left(way, max_order) for name, way in ways.items()}
    force, moment = left["none"]["residual_g_mm"], left["none"]["residual_moment_g_mm2"]
    rotates = any(cylinder.rotating_unbalance_kg_m for cylinder in engine.each)
    several = [] if single else ["Masses are those of each cylinder; couples are counted from position 0."]
    return {
        "engine": engine.title or subject.name,
        "frame": asdict(FRAME),
        "lambda": engine.mechanism.crank_ratio,
        "harmonics": _harmonics(engine.mechanism, max_order),
        "masses_g": {
            "reciprocating": 1e3 * plain.reciprocating_mass_kg,
            "rotating_at_crank_radius": 1e3 * plain.rotating_unbalance_kg_m / plain.crank_radius_m,
            "rod_at_crank_pin": None if data.train is None else data.train.rod_at_crank_pin_g,
            "rod_at_piston_pin": None if data.train is None else data.train.rod_at_piston_pin_g,
        },
        "piston": _piston(engine, speeds),
        # parts of a train have no counterweights yet
        "counterweights_in_file": bool(engine.webs) or (data.train is None and rotates),
        "force_g_mm": force,
        "force_phase_deg": left["none"]["residual_phase_deg"],
        "moment_g_mm2": moment,
        "moment_phase_deg": balancing.moments_of(engine.bare, max_order, balancing.degrees_of),
        "roll_moment": roll_balance(engine, max_order=max_order, speeds=speeds),
        "leading_g_mm": _leading(plain, max_order) if single and not engine.offset_m else None,
        "force_n": {
            speed_key(speed): {axis: amounts and _newtons(amounts, speed) for axis, amounts in force.items()}
            for speed in speeds
        },
        "strategies": {name: _strategy(subject, ways, name, max_order) for name in STRATEGIES} if single else None,
        "shafts": _shafts(subject, ways, left, speeds),
        "cycle": None if engine.cycle == "rotor" else cycle_balance(engine, max_order=max_order, speeds=speeds),
        "tolerance": _tolerance(subject, max_order),
        "design": None if single else _design(subject, ways, left),
        "crankshaft": _crankshaft(subject, speeds),
        "rod_split": _rod(subject, speeds) if single else None,
        "added_mass": _added_mass(subject, max_order, speeds) if single else None,
        "offset": _offset(subject, speeds) if single else None,
        "reverse_cranks": _reverse_cranks(subject, speeds) if single else None,
        "notes": [*data.notes, *several],
    }


def _check(engine: Engine, max_order: int, speeds: Sequence[float]) -> None:
    if max_order < 4 or not speeds or not all(math.isfinite(speed) and speed > 0 for speed in speeds):
        allowed = "≥ 4, and speeds > 0"
        raise RequestError("no such balance sheet", found=f"order {max_order}, speeds {speeds} rpm", allowed=allowed)
    highest = max(engine.shafts.every_order, default=0)
    if highest > max_order:
        problem, found = "the engine has shafts beyond the highest order of the tables", f"order {highest}"
        allowed, remedy = f"up to {max_order}", f"Ask for --max-order {highest}"
        raise RequestError(problem, place="shafts", found=found, allowed=allowed, remedy=remedy)


def _left(engine: Engine, max_order: int) -> Sheet:
    """Force and moment of ``engine`` by axis and order: what a way of balancing leaves."""
    forces = balancing.forces_of(engine, max_order)
    return {
        "residual_g_mm": balancing.by_axis(forces),
        "residual_phase_deg": balancing.by_axis(forces, balancing.degrees_of),
        "residual_moment_g_mm2": balancing.moments_of(engine, max_order),
    }


def _newtons(amounts: Amounts, speed_rpm: float) -> Amounts:
    return {order: newton(amount, speed_rpm) for order, amount in amounts.items()}


def _by_speed(unbalance_g_mm: float, speeds: Sequence[float]) -> Amounts:
    """Force (N) of ``unbalance_g_mm`` at each of the ``speeds`` (rpm)."""
    return {speed_key(speed): newton(unbalance_g_mm, speed) for speed in speeds}


def _harmonics(mechanism: SliderCrank, max_order: int) -> Amounts:
    """Amplitudes of orders 2 … ``max_order`` of the piston of ``mechanism`` over crank radius and ω²: A2, A4, …"""
    share = np.abs(acceleration_harmonics(mechanism, max_order))
    return {str(k): float(share[k]) for k in range(2, max_order + 1) if share[k]}


def leading_harmonics(count: int, crank_ratio: float) -> NDArray[np.float64]:
    """First terms of the series of A2, A4, …: λ, λ³/4, 9λ⁵/128, 5λ⁷/256, …, shape (count,).

    They are what textbooks and shafts built by them use, 2 % to 15 % below the exact harmonics at λ = 0.3.

    ``count``: how many, ≥ 0. ``crank_ratio``: λ = r/l, 0 < λ < 1.
    Source: truth sheet 1 and 2.1 (table 1 of Ruckle 2014 lacks the 9 in its formula, not in its numbers).
    """
    k = np.arange(1, count + 1, dtype=np.float64)
    binomial = np.cumprod(np.where(k == 1, 0.5, (k - 1.5) / k))
    return 8 * k**2 / crank_ratio * binomial * (crank_ratio / 2) ** (2 * k)


def _leading(engine: Engine, max_order: int) -> Amounts:
    terms = leading_harmonics(max_order // 2, engine.mechanism.crank_ratio)
    higher = {str(2 * k): engine.sliding_g_mm * float(term) for k, term in enumerate(terms, start=1)}
    return {"1": engine.sliding_g_mm, **higher}


def _unbalance_class(residual_g_mm: float, classes: Sequence[UnbalanceClass]) -> str | None:
    """Name of the strictest class whose typical unbalance ``residual_g_mm`` does not exceed; None beyond all."""
    kept = [kind for kind in classes if abs(residual_g_mm) <= kind.limit_g_mm]
    return min(kept, key=lambda kind: kind.limit_g_mm).name if kept else None


def _piston(engine: Engine, speeds: Sequence[float]) -> Sheet:
    fastest_rev, per_radian = fastest_piston(engine.mechanism)
    stroke_m = dead_centres(engine.mechanism).stroke_m
    return {
        "stroke_mm": 1e3 * stroke_m,
        "fastest_deg": 360 * fastest_rev,
        "mean_m_s": {speed_key(speed): stroke_m * speed / 30 for speed in speeds},
        "fastest_m_s": {speed_key(speed): per_radian * speed * math.pi / 30 for speed in speeds},
    }


def _strategy(subject: BalancedEngine, ways: dict[str, Engine], name: Strategy, max_order: int) -> Sheet | None:
    """Counterweights and residual of one strategy; None for d where no radius on the rod is stated."""
    if name not in ways:
        return None
    plain, places, couple = ways["none"], subject.balance.places, None
    added = balancing.counterweights(plain, name, places)
    first, *higher = balancing.forces_of(ways[name], max_order)
    if places.rod_mm is not None and name == "d" and not plain.offset_m:
        course = balancing.rod_counterweight_couple(plain, added.rod_g, places.rod_mm, FULL_TURN_REV)
        couple = float(np.abs(course).max())
    return {
        "counterweight_g": added.crank_g,
        "counterweight_deg": added.crank_deg,
        "rod_counterweight_g": added.rod_g if name == "d" else None,
        "total_g": added.crank_g + added.rod_g,
        "residual_along_g_mm": abs(first.along_g_mm),
        "residual_across_g_mm": abs(first.across_g_mm),
        "rotation": first.rotation,
        "higher_orders_along_g_mm": balancing.by_axis(higher)["Z"],
        "couple_g_mm2": couple,
    }


def _shafts(subject: BalancedEngine, ways: dict[str, Engine], left: dict[str, Sheet], speeds: Sequence[float]) -> Sheet:
    """Possibilities of additional shafts, pairs that the file states by their parts, and the engine's own shafts."""
    engine, single = subject.engine, subject.is_single
    sets: Sheet = {name: _shaft_set(ways[name], left[name], name) if single else None for name in POSSIBILITIES}
    built = _built_for_ratio(ways["none"], speeds) if single and not engine.offset_m else None
    pairs = [_pair(pair, subject.balance.residual_classes, speeds) for pair in subject.balance.shaft_pairs]
    own = {"orders": list(engine.shafts.every_order), **left["own"]} if "own" in ways else None
    return {**sets, "second_order_built_for_lambda": built, "pairs": pairs or None, "own": own}


def _shaft_set(engine: Engine, left: Sheet, name: Possibility) -> Sheet:
    weights = [
        {
            "speed_ratio": shaft.speed_ratio,
            "unbalance_g_mm": weight.unbalance_g_mm,
            "phase_deg": weight.angle_deg,
            "mass_at_crank_radius_g": 1e-3 * weight.unbalance_g_mm / engine.crank_radius_m,
        }
        for shaft in engine.shafts.single
        for weight in shaft.weights
    ]
    return {"strategy": balancing.SHAFTS[name][0], "shafts": weights, **left}


def _built_for_ratio(engine: Engine, speeds: Sequence[float]) -> Sheet:
    """What a second-order pair built for λ instead of A2 leaves."""
    harmonic = abs(acceleration_harmonics(engine.mechanism, 2)[2])
    shortfall = float(engine.sliding_g_mm * (harmonic - engine.mechanism.crank_ratio))
    return {"residual_along_g_mm": shortfall, "force_n": _by_speed(shortfall, speeds)}


def _pair(pair: ShaftPairParts, classes: Sequence[UnbalanceClass], speeds: Sequence[float]) -> Sheet:
    """A counter-rotating pair from its parts and as printed.

    Source: Ruckle 2014, table 3. The text there cites equations (7) and (8), which are for couples.
    """
    design = sum(part.centroid_mm * part.design_mass_g for part in pair.parts)
    measured = sum(part.centroid_mm * (part.measured_mass_g or part.design_mass_g) for part in pair.parts)
    stated, needed = pair.printed_pair_g_mm, pair.printed_needed_g_mm

    def reading(unbalance_g_mm: float, force_g_mm: float, needed_g_mm: float) -> Sheet:
        left = needed_g_mm - force_g_mm
        return {
            "pair_unbalance_g_mm": unbalance_g_mm,
            "pair_force_g_mm": force_g_mm,
            "residual_along_g_mm": left,
            "overbalance": force_g_mm / needed_g_mm,
            "residual_n": _by_speed(left, speeds),
            "class": _unbalance_class(left, classes),
        }

    readings = None
    if stated is not None and needed is not None:
        # a pair that turns order times as fast makes order² times the force, so the number can only equal the needed
        # force if order² is already in it: truth sheet 2.4 (the factor of four of table 3); Task 5, equation (5.28)
        square = pair.order**2
        readings = {
            "literal": reading(stated, square * stated, needed),
            "physical": reading(stated / square, stated, needed),
        }
    return {
        "order": pair.order,
        "one_shaft_design_g_mm": design,
        "one_shaft_measured_g_mm": measured,
        "pair_design_g_mm": 2 * design,
        "pair_measured_g_mm": 2 * measured,
        # numbers are stated to 0.1 g and 0.1 mm
        "pair_rounding_g_mm": sum(0.1 * (part.design_mass_g + abs(part.centroid_mm)) for part in pair.parts),
        "printed_pair_g_mm": stated,
        "printed_needed_g_mm": needed,
        "scenarios": readings,
    }


def _tolerance(subject: BalancedEngine, max_order: int) -> Sheet | None:
    """Study of the tolerances that the file states: of its own shafts, else of the last design."""
    tolerances, engine = subject.balance.tolerances, subject.engine
    if tolerances is None:
        return None
    own = engine.shafts.every_order
    designed = {} if own or len(engine.cylinders) == 1 else balancing.designs_for(subject)
    name, studied = list({"own" if own else "none": engine, **designed}.items())[-1]
    highest = max([max_order, *studied.shafts.every_order])
    return {"of": name, **shafts.series_residuals(studied, tolerances, max_order=highest)}


def _design(subject: BalancedEngine, ways: dict[str, Engine], left: dict[str, Sheet]) -> Sheet:
    """Crank webs and shafts of every design for several cylinders, and what it leaves."""
    engine, height = subject.engine, balancing.roll_height_m(subject.engine)
    layouts = {
        name: {
            "webs": _placed(way.webs[len(engine.webs) :]),
            "shafts": [
                {"speed_ratio": shaft.speed_ratio, "weights": _placed(shaft.weights)} for shaft in way.shafts.single
            ],
            **left[name],
        }
        for name, way in ways.items()
        if name not in ("none", "own")
    }
    return {
        "planes_mm": [1e3 * place for place in subject.planes_m],
        "primary_share": balancing.primary_shares(engine),
        "throw_counterweights": _placed(balancing.throw_counterweights(engine)),
        "roll_height_mm": None if height is None else 1e3 * height,
        "layouts": layouts,
    }


def _placed(weights: Sequence[Weight]) -> list[Sheet]:
    return [
        {"unbalance_g_mm": weight.unbalance_g_mm, "angle_deg": weight.angle_deg, "position_mm": 1e3 * weight.position_m}
        for weight in weights
    ]


def _crankshaft(subject: BalancedEngine, speeds: Sequence[float]) -> Sheet | None:
    """Balance of the crankshaft at ``speeds`` (rpm), with the rod's big end as cut and as weighed."""
    data, splits = subject.balance.crankshaft, subject.balance.rod_split
    if data is None:
        return None
    big_ends = {} if splits is None else {name: split.big_end_g for name, split in splits.by_method.items()}
    return shafts.crankshaft_balance(data, {speed_key(speed): speed for speed in speeds}, big_ends_g=big_ends)


def _rod(subject: BalancedEngine, speeds: Sequence[float]) -> Sheet | None:
    """Residual of a crankshaft and shafts built for the rod as cut, which acts as weighed.

    Source: truth sheet 2.7, on Ruckle 2014, section 3.3.1. A cut through the centre of gravity keeps the mass of the
    rod but, put at the pins, moves its centre of gravity.
    """
    splits, engine = subject.balance.rod_split, subject.engine
    if splits is None:
        return None
    cut, scale = splits.cut, splits.scale
    radius_mm, length_mm = engine.crank_radius_m * 1e3, engine.rod_length_m * 1e3
    deficit, excess = scale.big_end_g - cut.big_end_g, cut.small_end_g - scale.small_end_g
    across = deficit * radius_mm
    second = excess * radius_mm * float(abs(acceleration_harmonics(engine.mechanism, 2)[2]))
    return {
        "methods": {name: split.model_dump() for name, split in splits.by_method.items()},
        "weighed_whole_g": splits.weighed_whole_g,
        "cut_centroid_fraction": cut.centroid_fraction,
        "scale_centroid_fraction": scale.centroid_fraction,
        "centroid_shift_mm": (cut.centroid_fraction - scale.centroid_fraction) * length_mm,
        # of two masses about their centre of gravity; the rod's own differs, which makes a couple and no force
        "two_mass_inertia_kg_m2": scale.big_end_g * scale.small_end_g / scale.total_g * length_mm**2 * 1e-9,
        "rotating_deficit_g": deficit,
        "reciprocating_excess_g": excess,
        "residual_along_g_mm": {"1": (deficit - excess) * radius_mm, "2": second},
        "residual_across_g_mm": {"1": across},
        "residual_along_second_n": _by_speed(second, speeds),
        "residual_across_first_n": _by_speed(across, speeds),
    }


def _added_mass(subject: BalancedEngine, max_order: int, speeds: Sequence[float]) -> Sheet | None:
    """Force along the cylinder of a mass on the piston that no shaft was built for."""
    grams, engine = subject.balance.added_mass_g, subject.engine
    if grams is None:
        return None
    first = grams * engine.crank_radius_m * 1e3
    amounts = {"1": first * abs(complex(acceleration_harmonics(engine.mechanism, 1)[1]))}
    amounts |= {order: first * share for order, share in _harmonics(engine.mechanism, max_order).items()}
    return {
        "mass_g": grams,
        "residual_along_g_mm": amounts,
        "residual_n": {speed_key(speed): _newtons(amounts, speed) for speed in speeds},
        "class": _unbalance_class(amounts["1"], subject.balance.residual_classes),
    }


def _offset(subject: BalancedEngine, speeds: Sequence[float]) -> Sheet | None:
    """Effects of the offset that the file asks to be studied, or else of its own, on the first orders.

    Source: truth sheet 2.6; what of order 1 is out of step with the crank remains beside shafts timed to the crank.
    """
    engine = subject.engine
    offset_mm = subject.balance.offset_mm or abs(engine.offset_m) * 1e3
    if not offset_mm:
        return None
    straight = replace(engine.mechanism, offset_m=0.0)
    mechanism = replace(straight, offset_m=offset_mm * 1e-3)
    _, in_first, _, in_third, in_fourth = map(complex, acceleration_harmonics(mechanism, 4))
    first = engine.sliding_g_mm
    quadrature = first * -in_first.imag
    lines = {"1": first, "2": float(first * abs(acceleration_harmonics(straight, 2)[2]))}
    return {
        "offset_mm": offset_mm,
        "harmonics": _harmonics(mechanism, 8),
        "amplitude_ratio": abs(in_first),
        "rephasing_deg": math.degrees(math.atan2(-in_first.imag, in_first.real)),
        "third_over_fourth": abs(in_third) / abs(in_fourth),
        "quadrature_along_g_mm": quadrature,
        "quadrature_n": _by_speed(quadrature, speeds),
        # of a force along the cylinder and the shafts that cancel it: Ruckle 2014, section 3.1.2; truth sheet 2.6
        "couple_Nm_at_rpm": {
            speed_key(speed): {order: 1e-3 * offset_mm * force for order, force in _newtons(lines, speed).items()}
            for speed in speeds
        },
    }


def _reverse_cranks(subject: BalancedEngine, speeds: Sequence[float]) -> Sheet | None:
    """Weights of direct and reverse cranks by gear, and what they leave; built for A2 ("exact") and for λ ("leading").

    The residual along the cylinder is exact, not of some orders: with wheels for the first and second order it begins
    with the fourth, and is largest at 90°.
    """
    train, engine = subject.balance.gears, subject.engine
    if train is None:
        return None
    sliding = 1e3 * engine.reciprocating_mass_kg * 1e3 * plain_piston_acceleration(FULL_TURN_REV, engine.mechanism)
    moments, residual, across = {}, {}, 0.0
    radius_m, length_m = engine.crank_radius_m, engine.rod_length_m
    no_piston = Engine(crank_radius_m=radius_m, rod_length_m=length_m, reciprocating_mass_kg=0.0)
    for series in get_args(Series)[::-1]:
        moments[series] = {str(k): size for k, size in shafts.weight_moments(engine, second=series).items()}
        wheels = shafts.weighted_wheels(train, engine, second=series)
        turning = no_piston.model_copy(update={"shafts": BalanceShafts(single=tuple(wheels.values()))})
        force = balancing.polar_diagram(balancing.forces_of(turning, 2), FULL_TURN_REV)
        residual[series], across = float(np.abs(sliding + force.real).max()), float(np.abs(force.imag).max())
    radius = {gear.name: gear.weight_radius_mm or math.inf for gear in train.gears}
    couple = balancing.moments_of(turning, 2)["Y"] or {}
    return {
        "speed_ratios": shafts.gear_speed_ratios(train),
        "pair_moments_g_mm": moments,
        "weights_g": {name: wheel.weights[0].unbalance_g_mm / radius[name] for name, wheel in wheels.items()},
        "couple_g_mm2": sum(couple.values(), 0.0),
        "transverse_g_mm": across,
        "residual_along_g_mm": residual,
        "residual_along_n": {series: _by_speed(amount, speeds) for series, amount in residual.items()},
        "tolerances": None if train.tolerances is None else _gear_errors(train, engine, train.tolerances),
    }


def _gear_errors(train: GearTrain, engine: Engine, tolerances: GearTolerances) -> Sheet:
    """Median and 95 % bound of what sampled gear errors leave, by order."""
    errors: Sheet = {"errors": tolerances.model_dump()}
    for what, by_order in shafts.tolerance_study(train, engine, tolerances).items():
        both = {order: np.quantile(sizes, [0.5, 0.95]).tolist() for order, sizes in by_order.items()}
        errors[what] = {order: {"median": middle, "95 %": high} for order, (middle, high) in both.items()}
    return errors
