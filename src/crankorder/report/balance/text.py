"""The balance of an engine as plain text: the tables that a designer wants, then what remains in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from crankorder.engine.balance_sentences import plain_state
from crankorder.errors import printable
from crankorder.report.balance.residuals import residual_rows
from crankorder.report.text_table import WIDTH, Cell, closing, short_number, text_table

Sheet = Mapping[str, Any]
Axes = Mapping[str, Mapping[str, float] | None]

SHOWN_SHARE = 1e-9
"""Orders that stay below this share of the largest on every axis are not shown; the document has them."""

ROTATION_TEXT = {"with crank": "with crank", "against crank": "against crank", "line": "to and fro", "none": "no force"}
"""What the way that a force turns is called."""

_MOST_ORDERS = 24  # rows of a table by order
_MASSES = {
    "reciprocating": "reciprocating",
    "rod_at_piston_pin": "… of which rod, at the piston pin",
    "rotating_at_crank_radius": "rotating, at the crank radius",
    "rod_at_crank_pin": "… of which rod, at the crank pin",
}
_MOMENTS = {"about_x": "about Z", "about_y": "about X", "about_crankshaft": "about Y"}


def balance_text(sheet: Sheet) -> str:
    """Tables and sentences of a balance sheet, no line wider than a terminal's page.

    ``sheet`` as :func:`crankorder.engine.balance_sheet.balance_sheet` makes it. Parts that it has no data for are left
    out.
    """
    lines = [printable(sheet["engine"], WIDTH), f"Crank ratio λ = {_crank_ratio(sheet['lambda'])}", ""]
    for table in (_masses, _forces, _moments, _strategies, _shafts, _shaft_residuals, _pairs, _crankshaft, _gears):
        lines += table(sheet)
    speeds = list(sheet["force_n"])
    heads = ["What remains", "axis", "order", "g·mm", *(f"N at {speed} rpm" for speed in speeds), "class"]
    lines += text_table("Residuals of single causes", heads, residual_rows(sheet, speeds), kept=3)
    lines += _tolerances(sheet)
    return "\n".join([*lines, *closing("What remains unbalanced", sheet)]) + "\n"


def _crank_ratio(ratio: float) -> str:
    """λ to seven digits; what it lacks to one where those would say that the crank cannot turn."""
    text = short_number(ratio, digits=7)
    return f"1 − {1 - ratio:.3g}" if text == "1" and ratio < 1 else text


def shown_orders(tables: Iterable[Mapping[str, float] | None]) -> list[str]:
    """Orders that stand out in any of the ``tables`` (amount by order, or None), ascending; the largest if too many."""
    given = [table for table in tables if table]
    largest = {order: max(abs(table.get(order, 0.0)) for table in given) for table in given for order in table}
    limit = SHOWN_SHARE * max(largest.values(), default=0.0)
    kept = sorted((order for order in largest if largest[order] > limit), key=lambda order: -largest[order])
    return sorted(kept[:_MOST_ORDERS], key=float)


def _masses(sheet: Sheet) -> list[str]:
    rows = [(text, sheet["masses_g"].get(key)) for key, text in _MASSES.items()]
    return text_table("Masses", ["", "g"], rows)


def _forces(sheet: Sheet) -> list[str]:
    force, leading = sheet["force_g_mm"], sheet["leading_g_mm"] or {}
    orders = shown_orders([force["x"], force["y"]])
    heads = ["order", "axis", "A_k", "g·mm", "leading g·mm", *(f"N at {speed} rpm" for speed in sheet["force_n"])]
    rows: list[Sequence[Cell]] = []
    for axis, name in _axes_of(sheet):
        amounts = force[axis] or {}
        for order in (order for order in orders if order in amounts):
            at_speeds = [newtons[axis][order] for newtons in sheet["force_n"].values()]
            own = axis == "x"
            share = sheet["harmonics"].get(order) if own else None
            rows.append([order, name, share, amounts[order], leading.get(order) if own else None, *at_speeds])
    state = plain_state(sheet)
    title = f"Force by order {state} (amplitude; g·mm: over ω²; leading: slider alone, first term)"
    return text_table(title, heads, rows, kept=2) or [f"Force by order {state}: none", ""]


def _axes_of(sheet: Sheet) -> tuple[tuple[str, str], ...]:
    """Keys of the two axes and what they are called: one cylinder has a direction of its own, several have Z and X."""
    return (("x", "along"), ("y", "across")) if sheet["moment_g_mm2"] is None else (("x", "Z"), ("y", "X"))


def _moments(sheet: Sheet) -> list[str]:
    moments = sheet["moment_g_mm2"] or {}
    orders = shown_orders(moments.values())
    speeds = list(sheet["force_n"])
    heads = ["order", "axis", "g·mm²", *(f"N·m at {speed} rpm" for speed in speeds)]
    rows: list[Sequence[Cell]] = [
        [order, text, amounts[order], *(1e-3 * _newton(amounts[order], speed) for speed in speeds)]
        for key, text in _MOMENTS.items()
        for amounts in (moments.get(key) or {},)
        for order in orders
        if order in amounts
    ]
    return text_table(
        "Moments by order (Z: cylinders or middle of their banks, Y: crankshaft, X: across both)", heads, rows, kept=2
    )


def _newton(amount: float, speed: str) -> float:
    from crankorder.engine.polar import unbalance_force_n

    return float(unbalance_force_n(amount, float(speed)))


def _strategies(sheet: Sheet) -> list[str]:
    found = {name: one for name, one in (sheet["strategies"] or {}).items() if one is not None}
    if not found:
        return []
    speed = max(sheet["force_n"], key=float)
    unbalanced = {f"residual_{axis}_g_mm": (sheet["force_g_mm"][axis] or {}).get("1", 0.0) for axis in "xy"}
    columns = [{**unbalanced, "higher_orders_x_g_mm": _higher(sheet)}, *found.values()]
    heads = ["", "none", *found]
    rows: list[list[Cell]] = []
    for key, text in (
        ("counterweight_g", "counterweight on the crank, g"),
        ("counterweight_deg", "… on from opposite to the pin, °"),
        ("rod_counterweight_g", "counterweight on the rod, g"),
        ("total_g", "counterweights in all, g"),
        ("residual_x_g_mm", "order 1 along, g·mm"),
        ("residual_y_g_mm", "order 1 across, g·mm"),
    ):
        if key != "counterweight_deg" or any(column.get(key) for column in columns):
            rows.append([text, *(column.get(key) for column in columns)])
    for key, text in (("residual_x_g_mm", "along"), ("residual_y_g_mm", "across")):
        rows.append([f"order 1 {text}, N at {speed} rpm", *(_newton(column[key], speed) for column in columns)])
    for order in shown_orders(column["higher_orders_x_g_mm"] for column in columns)[:4]:
        amounts = [(column["higher_orders_x_g_mm"] or {}).get(order, 0.0) for column in columns]
        rows.append([f"order {order} along, g·mm", *amounts])
    couples = [column.get("couple_g_mm2") for column in columns]
    moments = [None if couple is None else 1e-3 * _newton(couple, speed) for couple in couples]
    rows.append([f"couple at most, N·m at {speed} rpm", *moments])
    rows.append(["order 1 turns", None, *(ROTATION_TEXT[column["rotation"]] for column in found.values())])
    return text_table("Strategies side by side", heads, rows)


def _higher(sheet: Sheet) -> dict[str, float]:
    return {order: amount for order, amount in (sheet["force_g_mm"]["x"] or {}).items() if order != "1"}


def _layouts(sheet: Sheet) -> dict[str, Any]:
    return {name: one for name, one in sheet["shafts"].items() if isinstance(one, Mapping) and "shafts" in one}


def _shafts(sheet: Sheet) -> list[str]:
    heads = ["possibility", "on strategy", "speed / crank", "g·mm each", "g at crank radius", "g at its radius"]
    rows = [
        [
            name,
            layout["strategy"],
            shaft["speed_ratio"],
            shaft["unbalance_g_mm"],
            shaft["mass_at_crank_radius_g"],
            shaft["mass_g"],
            shaft["phase_deg"],
        ]
        for name, layout in _layouts(sheet).items()
        for shaft in layout["shafts"]
    ]
    title = "Additional shafts (speed < 0: against the crank; heavy side: at top dead centre, from the cylinder)"
    return text_table(title, [*heads, "heavy side °"], rows, kept=2)


def _shaft_residuals(sheet: Sheet) -> list[str]:
    left: dict[str, Axes] = {"none": sheet["force_g_mm"]}
    left |= {name: layout["residual_g_mm"] for name, layout in _layouts(sheet).items()}
    if sheet["shafts"].get("own") is not None:
        left["own"] = sheet["shafts"]["own"]["residual_g_mm"]
    if len(left) == 1:
        return []
    rows: list[Sequence[Cell]] = []
    for axis, text in _axes_of(sheet):
        for order in shown_orders(axes[axis] for axes in left.values()):
            rows.append([order, text, *((axes[axis] or {}).get(order, 0.0) for axes in left.values())])
    own = " (own: the shafts that the engine has)" if "own" in left else ""
    return text_table(f"Force that remains with shafts, g·mm{own}", ["order", "axis", *left], rows, kept=2)


def _pairs(sheet: Sheet) -> list[str]:
    pairs = sheet["shafts"].get("pairs") or []
    heads = ["order", "one, design", "one, weighed", "pair, design", "pair, weighed", "± rounding", "pair, printed"]
    keys = ("one_shaft_design", "one_shaft_measured", "pair_design", "pair_measured", "pair_rounding", "printed_pair")
    rows = [[str(pair["order"]), *(pair[f"{key}_g_mm"] for key in keys), pair["printed_needed_g_mm"]] for pair in pairs]
    lines = text_table("Shaft pairs from their parts, g·mm", [*heads, "needed"], rows)
    readings = {"literal": "its unbalance", "physical": "its force"}
    read = [
        [
            str(pair["order"]),
            readings[name],
            one["pair_unbalance_g_mm"],
            one["pair_force_g_mm"],
            one["overbalance"],
            one["residual_x_g_mm"],
            one["class"],
        ]
        for pair in pairs
        for name, one in (pair["scenarios"] or {}).items()
    ]
    heads = ["order", "printed is", "unbalance", "force", "force / needed", "remains", "class"]
    return lines + text_table("Printed pair read both ways, g·mm (remains < 0: too much)", heads, read, kept=2)


def _crankshaft(sheet: Sheet) -> list[str]:
    table = sheet["crankshaft"]
    if table is None:
        return []
    sums = [
        ("static, kg·mm", table["static_kg_mm"]["x"], table["static_kg_mm"]["y"]),
        ("dynamic, kg·mm²", table["dynamic_kg_mm2"]["x"], table["dynamic_kg_mm2"]["y"]),
    ]
    lines = text_table("Crankshaft: sums over its sections", ["", "x", "y"], sums)
    couples = [(f"at {speed} rpm", amount) for speed, amount in table["couple_Nm_at_rpm"].items()]
    lines += text_table("Rocking couple that turns with the crankshaft", ["", "N·m"], couples)
    heads = ["plane", "z mm"] + [f"{text} {axis}" for text in ("has", "add", "needs") for axis in "xy"]
    planes = [
        [plane["name"], plane["z_mm"]]
        + [plane[f"{key}_kg_mm"][axis] for key in ("has", "correction", "needs") for axis in "xy"]
        for plane in table["planes"]
    ]
    return lines + text_table("Two-plane correction, kg·mm", heads, planes)


def _gears(sheet: Sheet) -> list[str]:
    table = sheet["reverse_cranks"]
    if table is None:
        return []
    rows = [(name, ratio, table["weights_g"].get(name)) for name, ratio in table["speed_ratios"].items()]
    lines = text_table("Direct and reverse cranks: gears", ["gear", "speed / crank", "weight g"], rows)
    moments = table["pair_moments_g_mm"]
    rows = [(order, moments["exact"][order], moments["leading"].get(order)) for order in moments["exact"]]
    return lines + text_table("Moments of the pairs of weights, g·mm", ["order", "exact", "leading term"], rows)


def _tolerances(sheet: Sheet) -> list[str]:
    table = (sheet["reverse_cranks"] or {}).get("tolerances")
    if table is None:
        return []
    names = {"along_g_mm": "along, g·mm", "across_g_mm": "across, g·mm", "couple_g_mm2": "couple, g·mm²"}
    rows = [
        [text, order, shares["median"], shares["95 %"]]
        for key, text in names.items()
        for order, shares in table[key].items()
    ]
    title = f"What sampled gear errors leave ({table['errors']['samples']} trains)"
    return text_table(title, ["", "order", "median", "95 % below"], rows, kept=2)
