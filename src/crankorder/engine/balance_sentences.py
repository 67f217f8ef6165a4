"""Sentences that say what remains unbalanced, from the tables of a balance sheet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crankorder.engine.polar import unbalance_force_n
from crankorder.engine.residual_tables import speed_key

NEARLY_STATIC = 0.01
"""Static unbalance below this share of a crankshaft's largest counterweight is named as balance."""


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
    said = [f"{state[0].upper()}{state[1:]} the engine shakes with "]
    said[0] += f"{_amounts(sheet['force_g_mm'], speed_rpm, where=where)}."
    said += _of_moments(sheet["moment_g_mm2"] or {}, speed_rpm)
    said += _of_strategies(sheet["strategies"] or {}, speed_rpm)
    said += _of_shafts(sheet["shafts"], speed_rpm, where)
    said += _of_pairs(sheet["shafts"]["pairs"] or [], speed_rpm)
    said += _of_crankshaft(sheet["crankshaft"], speed_rpm)
    said += _of_rod_split(sheet["rod_split"], speed_rpm)
    said += _of_added_mass(sheet["added_mass"], speed_rpm)
    said += _of_offset(sheet["offset"], speed_rpm)
    said += _of_reverse_cranks(sheet["reverse_cranks"], speed_rpm)
    return said


def plain_state(sheet: Mapping[str, Any]) -> str:
    """What the plain engine of a ``sheet`` is called: a rotating unbalance that its file states has counterweights."""
    masses = sheet["masses_g"]
    if masses["rod_at_crank_pin"] is not None or not masses["rotating_at_crank_radius"]:
        return "with no balancing"
    return "as built" if sheet["shafts"]["own"] is None else "without its shafts"


def _one(amount_g_mm: float, speed_rpm: float) -> str:
    force = float(unbalance_force_n(abs(amount_g_mm), speed_rpm))
    return f"{abs(amount_g_mm):.5g} g·mm ({force:.4g} N at {speed_key(speed_rpm)} rpm)"


def _amounts(
    axes: dict[str, dict[str, float] | None], speed_rpm: float, most: int = 2, where: dict[str, str] = CYLINDER
) -> str:
    """The first ``most`` orders in each direction, as one phrase."""
    phrases = []
    for axis, direction in where.items():
        orders = list((axes[axis] or {}).items())[:most]
        phrases += [f"{_one(amount, speed_rpm)} of order {order} {direction}" for order, amount in orders]
    return " and ".join([", ".join(phrases[:-1]), phrases[-1]]) if len(phrases) > 1 else (phrases or ["no force"])[0]


def _of_moments(moments: dict[str, dict[str, float] | None], speed_rpm: float) -> list[str]:
    said = []
    for name, axis in (("about_y", "X"), ("about_x", "Z")):
        orders = moments.get(name) or {}
        for order, amount in list(orders.items())[:2]:
            moment = 1e-3 * float(unbalance_force_n(amount, speed_rpm))
            said.append(
                f"A rocking moment of {moment:.4g} N·m at {speed_key(speed_rpm)} rpm of order {order} about {axis} "
                "remains."
            )
    return said


def _of_strategies(strategies: dict[str, Any], speed_rpm: float) -> list[str]:
    said = []
    turning = {"with crank": ", turning with the crank", "against crank": ", turning against the crank"}
    for name, found in strategies.items():
        if found is None:
            continue
        if name == "d":
            couple, adds = "", "takes off" if found["total_g"] < 0 else "adds"
            if found["couple_g_mm2"] is not None:
                couple = f" of up to {1e-3 * float(unbalance_force_n(found['couple_g_mm2'], speed_rpm)):.4g} N·m"
            said.append(
                f"Strategy d {adds} {abs(found['total_g']):.5g} g and leaves no force of any order; a couple{couple} "
                f"at {speed_key(speed_rpm)} rpm remains."
            )
            continue
        first = {
            axis: {"1": found[f"residual_{axis}_g_mm"]} if found[f"residual_{axis}_g_mm"] else None for axis in "xy"
        }
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


def _of_crankshaft(table: dict[str, Any] | None, speed_rpm: float) -> list[str]:
    if table is None:
        return []
    static = abs(complex(table["static_kg_mm"]["x"], table["static_kg_mm"]["y"]))
    dynamic = abs(complex(table["dynamic_kg_mm2"]["x"], table["dynamic_kg_mm2"]["y"]))
    largest = max(abs(complex(plane["has_kg_mm"]["x"], plane["has_kg_mm"]["y"])) for plane in table["planes"])
    state = "is in static balance within" if static < NEARLY_STATIC * largest else "has a static unbalance of"
    couple = table["couple_Nm_at_rpm"][speed_key(speed_rpm)]
    needs = " and ".join(
        f"{abs(complex(plane['correction_kg_mm']['x'], plane['correction_kg_mm']['y'])):.4g} kg·mm in {plane['name']}"
        for plane in table["planes"]
    )
    return [
        f"The crankshaft {state} {static * 1e3:.3g} g·mm; a rocking couple of {dynamic:.5g} kg·mm² "
        f"({couple:.4g} N·m at {speed_key(speed_rpm)} rpm) turns with it, which corrections of {needs} would end."
    ]


def _of_rod_split(table: dict[str, Any] | None, speed_rpm: float) -> list[str]:
    if table is None:
        return []
    return [
        f"Balanced for the rod as cut, the rod as weighed leaves {_one(table['residual_y_g_mm']['1'], speed_rpm)} of "
        f"order 1 across the cylinder, {_one(table['residual_x_g_mm']['1'], speed_rpm)} along it, and "
        f"{_one(table['residual_x_g_mm']['2'], speed_rpm)} of order 2 too much."
    ]


def _of_added_mass(table: dict[str, Any] | None, speed_rpm: float) -> list[str]:
    if table is None:
        return []
    left = {"x": table["residual_x_g_mm"], "y": None}
    grade = table["class"]
    beyond = "beyond every class of engines named" if grade is None else f"within the class {grade}"
    return [f"The {table['mass_g']:g} g that no shaft knows leave {_amounts(left, speed_rpm)}, {beyond}."]


def _of_offset(table: dict[str, Any] | None, speed_rpm: float) -> list[str]:
    if table is None:
        return []
    couple = table["couple_Nm_at_rpm"][speed_key(speed_rpm)]
    return [
        f"An offset of {table['offset_mm']:g} mm leaves {_one(table['quadrature_x_g_mm'], speed_rpm)} of order 1 "
        f"beside shafts for the whole reciprocating mass timed to the crank; {abs(table['rephasing_deg']):.2f}° of "
        f"re-phasing end it, but not the couples of {couple['1']:.3g} and {couple['2']:.3g} N·m of orders 1 and 2."
    ]


def _of_reverse_cranks(table: dict[str, Any] | None, speed_rpm: float) -> list[str]:
    if table is None:
        return []
    said = [
        f"Direct and reverse cranks leave nothing across the cylinder at any angle, and along it "
        f"{_one(table['residual_x_g_mm']['exact'], speed_rpm)} at most "
        f"({_one(table['residual_x_g_mm']['leading'], speed_rpm)} if built for the crank ratio)."
    ]
    if table["couple_g_mm2"] > 0:
        couple = 1e-3 * float(unbalance_force_n(table["couple_g_mm2"], speed_rpm))
        said.append(
            f"Their wheels stand unevenly and leave a couple of {couple:.4g} N·m at {speed_key(speed_rpm)} rpm."
        )
    if table["tolerances"] is not None:
        across = table["tolerances"]["across_g_mm"]["1"]["95 %"]
        along = table["tolerances"]["along_g_mm"]["1"]["95 %"]
        said.append(
            f"Of sampled gear trains 95 % leave less than {_one(along, speed_rpm)} of order 1 along the cylinder and "
            f"{_one(across, speed_rpm)} across it."
        )
    return said
