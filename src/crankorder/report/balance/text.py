"""The balance of an engine, or of one with elastic hinges, as plain text: tables, then what remains in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from crankorder.engine.balance_sheet import plain_state
from crankorder.engine.balancing import unbalance_force_n
from crankorder.errors import printable
from crankorder.report.text_table import WIDTH, Cell, closing, short_number, text_table

Row = list[Cell]


def residual_rows(sheet: Mapping[str, Any], speeds: Sequence[str]) -> list[Row]:
    """Rows of cause, axis, order, amount over ω² (g·mm), force (N) at each of the ``speeds``, class of unbalance.

    ``sheet``: a balance sheet; causes that it has no data for make no row. ``speeds``: crank speeds (rpm) as its texts.
    """
    rows: list[Row] = []
    for cause, axis, order, amount, grade in _single_causes(sheet):
        newtons = (_newton(amount, speed) for speed in speeds)
        rows.append([cause, axis, order, amount, *newtons, grade])
    return rows


Cause = tuple[str, str, str, float, str | None]


def _single_causes(sheet: Mapping[str, Any]) -> Iterator[Cause]:
    built, rod, added = sheet["shafts"]["second_order_built_for_lambda"], sheet["rod_split"], sheet["added_mass"]
    offset, cranks = sheet["offset"], sheet["reverse_cranks"]
    if built is not None:
        yield "second-order pair built for λ, not A2", "along", "2", built["residual_x_g_mm"], None
    if rod is not None:
        for axis, text in (("x", "along"), ("y", "across")):
            for order, amount in rod[f"residual_{axis}_g_mm"].items():
                yield "rod as weighed, balanced as cut", text, order, amount, None
    if added is not None:
        cause = f"{short_number(added['mass_g'])} g that no shaft knows"
        for order, amount in list(added["residual_x_g_mm"].items())[:3]:
            yield cause, "along", order, amount, added["class"] if order == "1" else None
    if offset is not None:
        cause = f"offset of {short_number(offset['offset_mm'])} mm, shafts timed to crank"
        yield cause, "along", "1", offset["quadrature_x_g_mm"], None
    if cranks is not None:
        for key, text in (("exact", "exact"), ("leading", "built for λ")):
            yield f"direct and reverse cranks, {text}", "along", "all", cranks["residual_x_g_mm"][key], None


Sheet = Mapping[str, Any]
Axes = Mapping[str, Mapping[str, float] | None]

SHOWN_SHARE = 1e-9
"""Orders that stay below this share of the largest on every axis are not shown; the document has them."""

ROTATION_TEXT = {"with crank": "with crank", "against crank": "against crank", "line": "to and fro", "none": "no force"}
"""What the way that a force turns is called."""

_SHOWN_TORQUE = 1e-3  # of the largest order; the document has the others
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
    for table in (
        _masses,
        _forces,
        _moments,
        _strategies,
        _shafts,
        _turning,
        _loads,
        _designs,
        _shaft_residuals,
        _pairs,
        _crankshaft,
        _rod,
        _gears,
    ):
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
    return (("x", "along"), ("y", "across")) if sheet["strategies"] is not None else (("x", "Z"), ("y", "X"))


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
    title = "Moments by order (Z: cylinders or middle of their banks, Y: crankshaft, X: across both)"
    return text_table(title, heads, rows, kept=2)


def _newton(amount: float, speed: str) -> float:
    return float(unbalance_force_n(amount, float(speed)))


def _strategies(sheet: Sheet) -> list[str]:
    found = {name: one for name, one in (sheet["strategies"] or {}).items() if one is not None}
    if not found:
        return []
    speed = max(sheet["force_n"], key=float)
    unbalanced = {f"residual_{axis}_g_mm": (sheet["force_g_mm"][axis] or {}).get("1", 0.0) for axis in "xy"}
    higher = {order: amount for order, amount in (sheet["force_g_mm"]["x"] or {}).items() if order != "1"}
    columns = [{**unbalanced, "higher_orders_x_g_mm": higher}, *found.values()]
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


def _layouts(sheet: Sheet) -> dict[str, Any]:
    return {name: one for name, one in sheet["shafts"].items() if isinstance(one, Mapping) and "shafts" in one}


def _shafts(sheet: Sheet) -> list[str]:
    heads = ["possibility", "on strategy", "speed / crank", "g·mm each", "g at crank radius"]
    keys = ("speed_ratio", "unbalance_g_mm", "mass_at_crank_radius_g", "phase_deg")
    rows = [
        [name, layout["strategy"], *(shaft[key] for key in keys)]
        for name, layout in _layouts(sheet).items()
        for shaft in layout["shafts"]
    ]
    title = "Additional shafts (speed < 0: against the crank; heavy side: at top dead centre, from the cylinder)"
    return text_table(title, [*heads, "heavy side °"], rows, kept=2)


def _turning(sheet: Sheet) -> list[str]:
    """Torque of gas and masses on the crank side by side, at every speed."""
    if sheet["cycle"] is None:
        return []
    rows: list[Sequence[Cell]] = []
    for speed, turning in sheet["cycle"]["turning"].items():
        largest = max((max(one["gas_n_m"], one["inertia_n_m"]) for one in turning["by_order"].values()), default=0.0)
        rows += [
            [speed, order, one["gas_n_m"], one["inertia_n_m"], one["dominates"], one["alike_at_rpm"]]
            for order, one in turning["by_order"].items()
            if max(one["gas_n_m"], one["inertia_n_m"]) > _SHOWN_TORQUE * largest
        ]
    if sheet["cycle"]["gas"] is None:
        return text_table("Torque of the masses on the crank", ["rpm", "order", "N·m"], [[*r[:2], r[3]] for r in rows])
    heads = ["rpm", "order", "gas N·m", "masses N·m", "larger", "alike at rpm"]
    return text_table("Torque of gas and masses on the crank by order", heads, rows, kept=2)


def _loads(sheet: Sheet) -> list[str]:
    """Peak and mean of what walls, pins and main bearings carry, at the highest speed."""
    loads = (sheet["cycle"] or {}).get("loads")
    if loads is None:
        return []
    speed = max(loads, key=float)
    rows: list[Sequence[Cell]] = [
        [f"cylinder {one['cylinder']}, {text}", one[key]["peak_n"], one[key]["peak_deg"], one[key]["mean_n"]]
        for one in loads[speed]["cylinders"]
        for key, text in (("wall", "wall"), ("piston_pin", "piston pin"), ("crank_pin", "crank pin"))
    ]
    rows += [
        [f"main bearing at {short_number(one['position_mm'])} mm", one["peak_n"], one["peak_deg"], one["mean_n"]]
        for one in loads[speed]["main_bearings"] or []
    ]
    return text_table(f"Loads at {speed} rpm", ["", "peak N", "at crank °", "mean N"], rows)


def _designs(sheet: Sheet) -> list[str]:
    """Crank webs and shafts of several cylinders: what each carries, and what is left of force and couples."""
    design = sheet["design"]
    if design is None:
        return []
    rows: list[Sequence[Cell]] = []
    for name, layout in design["layouts"].items():
        carriers = [("crank", layout["webs"])] if name == "webs" or not rows else []
        carriers += [(f"shaft {one['speed_ratio']:+d}", one["weights"]) for one in layout["shafts"]]
        rows += [
            [name, carrier, *(weight[key] for key in ("position_mm", "unbalance_g_mm", "angle_deg"))]
            for carrier, weights in carriers
            for weight in weights
        ]
    heads = ["design", "on", "at mm", "g·mm", "heavy side °"]
    title = "Webs and shafts for force and couple (speed × crank, < 0 against it; heavy side: at crank angle 0 from Z)"
    lines = text_table(title, heads, rows, kept=2)
    throws = [
        [str(number), *weight.values()]
        for number, weight in enumerate(design["throw_counterweights"])
        if weight["unbalance_g_mm"] > 0
    ]
    title = "Or a counterweight at each throw, for all of order 1 that turns with the crank"
    lines += text_table(title, ["cylinder", "g·mm", "heavy side °", "at mm"], throws, kept=1)
    left = {"none": sheet["moment_g_mm2"]}
    left |= {name: layout["residual_moment_g_mm2"] for name, layout in design["layouts"].items()}
    if sheet["shafts"]["own"] is not None:
        left["own"] = sheet["shafts"]["own"]["residual_moment_g_mm2"]
    rows = [
        [order, text, *((moments[key] or {}).get(order, 0.0) for moments in left.values())]
        for key, text in _MOMENTS.items()
        for order in shown_orders(moments[key] for moments in left.values())
    ]
    return lines + text_table("Moments that remain, g·mm²", ["order", "axis", *left], rows, kept=2)


def _shaft_residuals(sheet: Sheet) -> list[str]:
    left: dict[str, Axes] = {"none": sheet["force_g_mm"]}
    left |= {name: layout["residual_g_mm"] for name, layout in _layouts(sheet).items()}
    left |= {name: layout["residual_g_mm"] for name, layout in (sheet["design"] or {"layouts": {}})["layouts"].items()}
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
    of_reading = ("pair_unbalance_g_mm", "pair_force_g_mm", "overbalance", "residual_x_g_mm", "class")
    read = [
        [str(pair["order"]), readings[name], *(one[key] for key in of_reading)]
        for pair in pairs
        for name, one in (pair["scenarios"] or {}).items()
    ]
    heads = ["order", "printed is", "unbalance", "force", "force / needed", "remains", "class"]
    return lines + text_table("Printed pair read both ways, g·mm (remains < 0: too much)", heads, read, kept=2)


def _crankshaft(sheet: Sheet) -> list[str]:
    table = sheet["crankshaft"]
    if table is None:
        return []
    rows = [
        [row["name"], *(row[key] for key in ("mass_kg", "x_mm", "y_mm")), *_products(row)] for row in table["sections"]
    ]
    rows.append(["sum", None, None, None, *_products({**table, "z_mm": None})])
    heads = ["part", "Wr kg", "X mm", "Y mm", "Wr X", "Wr Y", "Z mm", "CX", "CY"]
    title = "Crankshaft: static (Wr X, Wr Y: kg·mm) and dynamic (CX, CY: kg·mm²) balance of its parts"
    lines = text_table(title, heads, rows)
    couples = [(f"at {speed} rpm", amount) for speed, amount in table["couple_Nm_at_rpm"].items()]
    lines += text_table("Rocking couple that turns with the crankshaft", ["", "N·m"], couples)
    heads = ["plane", "z mm"] + [f"{text} {axis}" for text in ("has", "add", "needs") for axis in "xy"]
    planes = [
        [plane["name"], plane["z_mm"]]
        + [plane[f"{key}_kg_mm"][axis] for key in ("has", "correction", "needs") for axis in "xy"]
        for plane in table["planes"]
    ]
    lines += text_table("Two-plane correction, kg·mm", heads, planes)
    fans = [
        [name, *(fan[key] for key in ("mass_kg", "centroid_mm", "unbalance_kg_mm")), *fan["resized"].values()]
        for name, fan in ((plane["name"], plane["fan"]) for plane in table["planes"])
        if fan is not None
    ]
    heads = ["counterweight", "kg", "centroid mm", "kg·mm", "or radius mm", "or thickness mm", "or fan °"]
    lines += text_table("Fans, and the one size that would meet both sums", heads, fans)
    bobs = [
        [bob["method"], bob["mass_kg"], *(bob[key]["y"] for key in ("static_kg_mm", "dynamic_kg_mm2"))]
        for bob in table["bob_weights"] or []
    ]
    heads = ["rod's big end", "kg", "static y, kg·mm", "dynamic y, kg·mm²"]
    title = "The crankshaft with another mass in the place of its bob weight"
    return lines + text_table(title, heads, bobs[1:] and bobs)


def _products(row: Mapping[str, Any]) -> list[Cell]:
    static, dynamic = row["static_kg_mm"], row["dynamic_kg_mm2"]
    return [static["x"], static["y"], row["z_mm"], dynamic["x"], dynamic["y"]]


def _rod(sheet: Sheet) -> list[str]:
    table = sheet["rod_split"]
    if table is None:
        return []
    keys = ("big_end_g", "small_end_g", "total_g", "centroid_fraction")
    rows: list[list[Cell]] = [[name, *(one[key] for key in keys)] for name, one in table["methods"].items()]
    rows.append(["weighed whole", None, None, table["weighed_whole_g"], None])
    heads = ["by", "big end g", "small end g", "total g", "centre / length"]
    return text_table("The rod in two masses", heads, rows)


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


_WEIGHTS = {
    "rod_weight_n": "rod weight",
    "piston_weight_n": "piston weight",
    "rod_counterweight_n": "rod counterweight",
}


def hinge_text(sheet: Mapping[str, Any]) -> str:
    """Tables and sentences of a hinge sheet, no line wider than a terminal's page.

    ``sheet`` as :func:`crankorder.engine.hinge_sheet.hinge_sheet` makes it; solutions that do not exist are left out.
    """
    torque = sheet["torque"]
    lines = [printable(sheet["engine"], WIDTH), ""]
    rows = [("mean, N·m", torque["mean_nm"]), ("work per revolution, J", torque["work_per_rev_j"])]
    lines += text_table("Crank torque", ["", ""], rows)
    extrema = [(one["crank_angle_deg"], one["torque_nm"]) for one in torque["extrema"]]
    lines += text_table("Extrema of the crank torque", ["crank angle °", "N·m"], extrema, kept=0)
    lines += text_table("Crank torque by order", ["order", "N·m"], torque["harmonics_nm"].items())
    lines += _side_forces(sheet["mechanisms"]) + _hinge_moments(sheet["mechanisms"]) + _solutions(sheet["mechanisms"])
    for one in sheet["mechanisms"]:
        lines += _characteristic(one)
    lines += _air_springs(sheet["mechanisms"]) + _guides(sheet["mechanisms"])
    return "\n".join([*lines, *closing("What remains", sheet)]) + "\n"


def _side_forces(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    rows: list[list[Cell]] = [
        [one["name"], float(speed), without, *(one["side_force_n"][kind] for kind in ("full", "potential", "printed"))]
        for one in mechanisms
        for speed, without in one["side_force_without_hinge_n"].items()
    ]
    heads = ["mechanism", "rpm", "no hinge", "full M12", "potential", "printed (6)"]
    return text_table("Largest side force on the piston (R430 without hinge, R43 with it), N", heads, rows)


def _hinge_moments(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = ("lambda", "static_moment_nm", "weight_moment_nm", "mean_gas_moment_nm")
    rows: list[list[Cell]] = [
        [one["name"], *(one[key] for key in keys), *(1e3 * one["shaking_force_kg_m"][axis] for axis in "xy")]
        for one in mechanisms
    ]
    heads = ["mechanism", "λ", "G, N·m", "weights, N·m", "gas mean, N·m", "shakes x, kg·mm", "y, kg·mm"]
    lines = text_table("Moments and shaking force over ω²", heads, rows)
    works: list[list[Cell]] = [
        [one["name"], *(one["work_j"][kind][joint] for kind in ("full", "printed") for joint in ("pin", "strut"))]
        for one in mechanisms
    ]
    heads = ["mechanism", "full, pin", "full, strut", "printed, pin", "printed, strut"]
    return lines + text_table("Work of the hinges per revolution, J (a spring needs zero: potential)", heads, works)


def _solutions(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    rows: list[list[Cell]] = []
    for one in mechanisms:
        found = one["solutions"]
        for weight, text in _WEIGHTS.items():
            kinds = found["weight_without_side_force"][weight]
            weights = (kinds[kind] for kind in ("potential", "printed", "printed_truncated"))
            rows.append([one["name"], f"{text}, no side force", *weights])
        rows.append([one["name"], "crank counterweight, eq. (12)", found["crank_counterweight_n"], None, None])
        for key, text in (("rod_counterweight_n", "rod"), ("crank_counterweight_n", "crank")):
            amount = None if found["balanced"] is None else found["balanced"][key]
            rows.append([one["name"], f"{text} counterweight, eq. (13)", amount, None, None])
    heads = ["mechanism", "what to choose", "N", "N, printed (6)", "… cos ψ truncated"]
    return text_table("Solutions", heads, rows, kept=2)


def _characteristic(one: Mapping[str, Any]) -> list[str]:
    pin, strut = one["characteristic"]["pin"], one["characteristic"]["strut"]
    columns = [pin[key] for key in ("hinge_angle_deg", "crank_angle_deg", "moment_nm", "work_j")]
    columns += [strut["moment_nm"], strut["work_j"]]
    heads = ["hinge angle °", "pin: crank °", "N·m", "work J", "strut: N·m", "work J"]
    title = f"Hinge characteristics of {one['name']} at {pin['speed_rpm']:.5g} rpm"
    return text_table(title, heads, zip(*columns, strict=True), kept=0)


def _air_springs(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = ("joint", "designed_speed_rpm", "speed_rpm", "pressure_ratio", "residual_share", "speed_fluctuation")
    rows = [[one["name"], *(change[key] for key in keys)] for one in mechanisms for change in one["air_spring"]]
    heads = ["mechanism", "hinge", "cut for rpm", "at rpm", "pressure ratio", "share left", "unevenness"]
    return text_table("Air spring at another speed", heads, rows, kept=2)


def _guides(mechanisms: Sequence[Mapping[str, Any]]) -> list[str]:
    rows: list[list[Cell]] = []
    for one in mechanisms:
        for joint, guides in one["guides"].items():
            if guides is not None:
                sizes = (
                    1e-3 * guides["stiffness_n_per_m"],
                    1e3 * min(guides["length_m"]),
                    1e3 * max(guides["length_m"]),
                )
                cut = "no: sharper than the roller" if guides["undercut"] else "yes"
                rows.append([f"{one['name']}, {joint}", guides["speed_rpm"], *sizes, guides["steepest_deg"], cut])
    heads = ["hinge", "rpm", "spring N/mm", "shortest mm", "longest mm", "steepest °", "can be cut"]
    return text_table("Springs and guides of the hinges", heads, rows)
