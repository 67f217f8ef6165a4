"""Tables of a whole engine for its balance sheet: force and moments by order, webs and shafts, and their sentences."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from crankorder.engine.balance_data import BalancedEngine, newton, speed_key
from crankorder.engine.balancing import OrderForce
from crankorder.engine.definition import Engine, Weight
from crankorder.engine.forces import DIRECTIONS, crankcase_moments
from crankorder.engine.shaft_design import (
    NOTHING,
    ONE_RADIAN_PER_S_RPM,
    Design,
    designs,
    order_motions,
    primary_shares,
    reach_g_mm2,
    roll_height_m,
    throw_counterweights,
)
from crankorder.engine.tolerance_study import tolerance_table
from crankorder.errors import plain_number

Amounts = dict[str, float]
"""Amplitude over ω² by order, orders as texts."""

MOMENT_AXES = {"about_x": "Z", "about_y": "X", "about_crankshaft": "Y"}
"""Axes that moments are named for in a balance sheet, and the engine's direction that each of them is."""
ALIGNED_SHARE = 1e-9
"""A moment below this share of the largest is not told of in a sentence."""


def whole_force(engine: Engine, max_order: int) -> tuple[OrderForce, ...]:
    """Force of the whole ``engine`` over ω² of orders 1 … ``max_order``, without those that cancel."""
    forces = (motion.force for motion in order_motions(engine, max_order))
    return tuple(force for force in forces if force.rotation != "none")


def by_axis(forces: Iterable[OrderForce], number: Callable[[complex], float] = abs) -> dict[str, Amounts | None]:
    """Amplitudes (g·mm over ω²) of ``forces`` by axis and order; None for an axis that has none.

    ``number``: what is told of each complex amplitude. With :func:`degrees_of` it is the phase: order k is
    amplitude · cos(k φ + phase), φ the crank angle.
    """
    every = tuple(forces)
    along = {f"{force.order:g}": number(force.x_g_mm) for force in every if force.x_g_mm}
    across = {f"{force.order:g}": number(force.y_g_mm) for force in every if force.y_g_mm}
    return {"x": along or None, "y": across or None}


def whole_moments(engine: Engine, max_order: int) -> dict[str, Amounts | None]:
    """Moments (g·mm² over ω²) of ``engine`` by order 1 … ``max_order`` about Z, X and the crankshaft.

    None for an axis about which there is none.
    """
    moments = crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e9
    least = NOTHING * reach_g_mm2(engine, max_order)
    tables: dict[str, Amounts | None] = {}
    for name, axis in MOMENT_AXES.items():
        sizes = [float(abs(moment)) for moment in moments[DIRECTIONS.index(axis)]]
        tables[name] = {str(k): sizes[k] for k in range(1, max_order + 1) if sizes[k] > least[k]} or None
    return tables


def moment_phases(engine: Engine, max_order: int) -> dict[str, Amounts | None]:
    """Phases (degrees) of the moments of ``engine`` that :func:`whole_moments` lists up to ``max_order``."""
    moments = crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order)
    return {
        name: orders
        and {order: degrees_of(complex(moments[DIRECTIONS.index(MOMENT_AXES[name])][int(order)])) for order in orders}
        for name, orders in whole_moments(engine, max_order).items()
    }


def degrees_of(amplitude: complex) -> float:
    """Phase of ``amplitude`` in degrees, above −180 and up to 180."""
    found = math.degrees(cmath.phase(amplitude))
    return 180.0 if found == -180.0 else found + 0.0


def design_table(subject: BalancedEngine, max_order: int) -> dict[str, Any]:
    """Crank webs and shafts for the engine of ``subject`` without its own shafts, and what each design leaves.

    ``max_order``: highest order of what is left.
    """
    engine = subject.engine
    layouts: dict[str, Any] = {}
    for design in designs_for(subject):
        left = design.on(engine)
        layouts[design.name] = {
            "webs": [_weight(weight) for weight in design.webs],
            "shafts": [
                {"speed_ratio": shaft.speed_ratio, "weights": [_weight(weight) for weight in shaft.weights]}
                for shaft in design.shafts
            ],
            "residual_g_mm": by_axis(whole_force(left, max_order)),
            "residual_moment_g_mm2": whole_moments(left, max_order),
        }
    height = roll_height_m(engine, 2)
    return {
        "planes_mm": [1e3 * place for place in _planes_m(subject)],
        "primary_share": asdict(primary_shares(engine)),
        "throw_counterweights": [_weight(weight) for weight in throw_counterweights(engine)],
        "roll_height_mm": None if height is None else 1e3 * height,
        "layouts": layouts,
    }


def designs_for(subject: BalancedEngine) -> tuple[Design, ...]:
    """Crank webs and shafts for the orders and planes that the engine file of ``subject`` asks for."""
    orders = sorted(set(subject.balance.design_orders))
    return designs(subject.engine, orders=orders, planes_m=_planes_m(subject), max_order=max([1, *orders]))


def tolerance_of(subject: BalancedEngine, max_order: int) -> dict[str, Any] | None:
    """Study of the tolerances that the file of ``subject`` states: of its own shafts, else of the last design.

    None where it states none. ``max_order``: of the tables.
    """
    tolerances, engine = subject.balance.tolerances, subject.engine
    if tolerances is None:
        return None
    made = () if engine.shafts.every_order or len(engine.cylinders) == 1 else designs_for(subject)
    studied = made[-1].on(engine) if made else engine
    table = tolerance_table(studied, tolerances, max_order=max([max_order, *studied.shafts.every_order]))
    return {"of": made[-1].name if made else "own" if engine.shafts.every_order else "none", **table}


def _planes_m(subject: BalancedEngine) -> tuple[float, float]:
    places = [cylinder.position_m for cylinder in subject.engine.cylinders]
    return subject.balance.design_planes_m or (min(places), max(places))


def _weight(weight: Weight) -> dict[str, float]:
    return {
        "unbalance_g_mm": weight.unbalance_g_mm,
        "angle_deg": weight.angle_deg,
        "position_mm": 1e3 * weight.position_m,
    }


def moment_sentences(moments: Mapping[str, Amounts | None], speed_rpm: float, *, state: str = "") -> list[str]:
    """What couples and roll moment are left, by order, with their size at ``speed_rpm``.

    ``moments``: by axis and order, as :func:`whole_moments` gives them. ``state``: words that come first.
    """
    largest = max((size for orders in moments.values() for size in (orders or {}).values()), default=0.0)
    said = []
    for name, what in (
        ("about_y", "a rocking couple about X"),
        ("about_x", "a rocking couple about Z"),
        ("about_crankshaft", "a roll moment of the masses about the crankshaft"),
    ):
        told = [(order, size) for order, size in (moments.get(name) or {}).items() if size > ALIGNED_SHARE * largest]
        top = sorted(sorted(told, key=lambda one: -one[1])[:3], key=lambda one: float(one[0]))
        if top:
            couples = [(order, plain_number(1e-3 * newton(size, speed_rpm))) for order, size in top]
            sizes = listed([f"{couple} N·m of order {order}" for order, couple in couples])
            text = f"{state + ' ' if state else ''}{what} remains: {sizes} at {speed_key(speed_rpm)} rpm."
            said.append(text[0].upper() + text[1:])
    return said


def design_sentences(design: Mapping[str, Any], speed_rpm: float) -> list[str]:
    """What crank webs can take of an engine of several cylinders, what shafts it needs, and what these leave.

    ``design``: as :func:`design_table` makes it. ``speed_rpm``: at which sizes are named.
    """
    said = []
    for kind, share in design["primary_share"].items():
        if share is not None:
            said.append(f"Crank webs can take {plain_number(100 * share)} % of the primary {kind} of the pistons.")
    for name, layout in design["layouts"].items():
        left = _left(layout, speed_rpm)
        if name == "webs":
            said.append(f"Counterweights on the crank webs alone leave {left}.")
            continue
        ratios = [f"{shaft['speed_ratio']:+d}".replace("-", "−") for shaft in layout["shafts"]]
        shafts = listed([f"at {ratio} times crank speed" for ratio in ratios])
        webs = "with those counterweights " if layout["webs"] else ""
        number = "one shaft" if len(layout["shafts"]) == 1 else "shafts"
        text = f"{webs}{number} {shafts} leave{'s' if number == 'one shaft' else ''} {left}."
        said.append(text[0].upper() + text[1:])
    height = design["roll_height_mm"]
    if height is not None and abs(height) > 1e-9:
        where = "above" if height > 0 else "below"
        said.append(
            f"Where the second-order shaft that turns with the crank sits {plain_number(abs(height))} mm {where} the "
            "other, the pair takes the second-order roll moment of the masses too."
        )
    return said


def _left(layout: Mapping[str, Any], speed_rpm: float) -> str:
    """The largest force and the largest couple that a layout leaves, in words."""
    parts, at = [], f"at {speed_key(speed_rpm)} rpm"
    for key, scale, unit, names, nothing in (
        ("residual_g_mm", 1.0, "N", {"x": "along Z", "y": "along X"}, "no force"),
        ("residual_moment_g_mm2", 1e-3, "N·m", {"about_y": "about X", "about_x": "about Z"}, "no rocking couple"),
    ):
        every = [
            (size, order, text) for axis, text in names.items() for order, size in (layout[key][axis] or {}).items()
        ]
        if every:
            size, order, text = max(every)
            amount = plain_number(scale * newton(size, speed_rpm))
            parts.append(f"at most {amount} {unit} of order {order} {text} {at}")
        else:
            parts.append(nothing)
    if parts == ["no force", "no rocking couple"]:
        return "neither force nor rocking couple"
    return " and ".join([parts[0].removesuffix(f" {at}") if parts[1].endswith(at) else parts[0], parts[1]])


def listed(words: Sequence[str]) -> str:
    """``words`` as one phrase: "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
