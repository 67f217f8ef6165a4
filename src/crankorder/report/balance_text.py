"""The balance of an engine, or of one with elastic hinges, as plain text: tables, then what remains in sentences.

Tables and paragraphs of plain text for a terminal are aligned, and never wider than a page of it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from crankorder.engine.forces import newton
from crankorder.errors import printable
from crankorder.plot.reading import number_text
from crankorder.report.balance_sentences import plain_state, single_causes

WIDTH = 100
"""Columns of the widest line."""

DIGITS = 5
"""Significant digits of a number in a table: what a scale or a drawing can give."""

MISSING = "–"
_GAP, _INDENT, _LONGEST_CELL = "  ", "  ", 44

Cell = float | str | None


def paragraph(text: str, *, bullet: str = "") -> list[str]:
    """Lines of ``text``, folded at the width of the page; from the second on they stand under the ``bullet``'s text."""
    return textwrap.wrap(
        printable(text, 4000), WIDTH, initial_indent=bullet, subsequent_indent=" " * len(bullet), break_on_hyphens=False
    )


def text_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[Cell]], *, kept: int = 1) -> list[str]:
    """Lines of a table, none where it has no rows: title, heads, rows; the points of numbers lie in one column.

    Parameters
    ----------
    title : title above the table
    heads : heads of the columns, units included
    rows : rows of numbers, texts and None, which is shown as a dash; rows and columns of None alone are left out
    kept : number of first columns that name a row; where the table is wider than the page they are repeated, and the
        other columns stand below one another
    """
    filled = [list(row) for row in rows if any(cell is not None for cell in row[kept:])]
    if not filled:
        return []
    used = [n for n in range(len(heads)) if n < kept or any(row[n] is not None for row in filled)]
    columns = [_column(heads[n], [row[n] for row in filled]) for n in used]
    names, values = columns[:kept], columns[kept:]
    lines = paragraph(title)
    room = WIDTH - len(_INDENT) - sum(len(column[0]) + len(_GAP) for column in names)
    for block in _blocks(values, room):
        lines += [(_INDENT + _GAP.join(cells)).rstrip() for cells in zip(*names, *block, strict=True)]
    return [*lines, ""]


def _column(head: str, cells: Sequence[Cell]) -> list[str]:
    """Head and cells of a column, all of one width: texts from the left, numbers by their points."""
    texts = [MISSING if cell is None else _cell_text(cell) for cell in cells]
    if all(isinstance(cell, str) for cell in cells):
        width = max(len(head), *map(len, texts))
        return [text.ljust(width) for text in (head, *texts)]
    pairs = list(zip(texts, cells, strict=True))
    most = max(_after_point(text) for text, cell in pairs if not isinstance(cell, str))
    lined = [text if isinstance(cell, str) else text + " " * (most - _after_point(text)) for text, cell in pairs]
    width = max(len(head), *map(len, lined))
    return [text.rjust(width) for text in (head, *lined)]


def _cell_text(cell: float | str) -> str:
    return printable(cell, _LONGEST_CELL) if isinstance(cell, str) else short_number(float(cell))


def short_number(value: float, *, digits: int = DIGITS) -> str:
    """``value``, in any unit, to at most ``digits`` significant digits, without trailing zeros behind the point."""
    text = number_text(value, digits=digits)
    return text if "." not in text or "e" in text else text.rstrip("0").rstrip(".")


def _after_point(text: str) -> int:
    """Characters from the point on."""
    return len(text) - text.index(".") if "." in text else 0


def _blocks(columns: Sequence[list[str]], room: int) -> list[list[list[str]]]:
    """Columns in groups that each fit into ``room`` characters, in order."""
    blocks: list[list[list[str]]] = []
    used = room + 1
    for column in columns:
        width = len(column[0]) + len(_GAP)
        if used + width > room + len(_GAP) or not blocks:
            blocks.append([])
            used = 0
        blocks[-1].append(column)
        used += width
    return blocks


def closing(head: str, sentences: Iterable[str], notes: Collection[str]) -> list[str]:
    """Lines with ``sentences`` under ``head``, then ``notes`` where there are any."""
    lines = [head]
    for sentence in sentences:
        lines += paragraph(sentence, bullet="  * ")
    if notes:
        lines += ["", "Notes"]
    for note in notes:
        lines += paragraph(note, bullet="  * ")
    return lines


Row = Sequence[Cell]
Part = Mapping[str, Any]
"""A balance sheet or a part of it."""
SHOWN_SHARE = 1e-9
"""Orders that stay below this share of the largest on every axis are not shown; the document has them."""
_SHOWN_TORQUE = 1e-3  # of the largest order; the document has the others
_MOST_ORDERS = 24  # rows of a table by order
_MASSES = {
    "reciprocating": "reciprocating",
    "rod_at_piston_pin": "… of which rod, at the piston pin",
    "rotating_at_crank_radius": "rotating, at the crank radius",
    "rod_at_crank_pin": "… of which rod, at the crank pin",
}
_MOMENTS = {"about_x": "about Z", "about_y": "about X", "about_crankshaft": "about Y"}


def table_of(title: str, columns: Mapping[str, str], parts: Iterable[Part], *, kept: int = 1) -> list[str]:
    """Lines of a table with a row for each of the ``parts`` of a sheet.

    ``columns`` are the key of the values of each column by its head; "a.b" is the key b of the part a. ``title`` and
    ``kept`` are those of :func:`text_table`.
    """
    return text_table(title, list(columns), [_cells(part, columns.values()) for part in parts], kept=kept)


def _cells(part: Part, keys: Iterable[str]) -> list[Cell]:
    cells: list[Cell] = []
    for key in keys:
        value: Any = part
        for name in key.split("."):
            value = None if value is None else value.get(name)
        cells.append(str(value) if isinstance(value, str) else value)
    return cells


def balance_text(sheet: Part) -> str:
    """Tables and sentences of a balance ``sheet``, no line wider than a terminal's page.

    Parts without data are left out.
    """
    lines = [printable(sheet["engine"], WIDTH), f"Crank ratio λ = {_crank_ratio(sheet['lambda'])}", ""]
    lines += text_table("Masses", ["", "g"], [(text, sheet["masses_g"][key]) for key, text in _MASSES.items()])
    for tables in (
        _forces, _moments, _strategies, _shafts, _cycle, _designs, _shaft_residuals, _pairs, _crankshaft, _rod, _gears,
        _single_causes, _gear_errors,
    ):  # fmt: skip
        lines += tables(sheet)
    lines += closing("What remains unbalanced", sheet["sentences"], sheet["notes"])
    return "\n".join(lines) + "\n"


def _crank_ratio(ratio: float) -> str:
    """Crank ratio λ to seven digits; as 1 − difference where these would round to 1."""
    text = short_number(ratio, digits=7)
    return f"1 − {1 - ratio:.3g}" if text == "1" and ratio < 1 else text


def shown_orders(tables: Iterable[Mapping[str, float] | None]) -> list[str]:
    """Orders that stand out in any of the ``tables`` (amount by order, or None), ascending; the largest if too many."""
    given = [table for table in tables if table]
    largest = {order: max(abs(table.get(order, 0.0)) for table in given) for table in given for order in table}
    limit = SHOWN_SHARE * max(largest.values(), default=0.0)
    kept = sorted((order for order in largest if largest[order] > limit), key=lambda order: -largest[order])
    return sorted(kept[:_MOST_ORDERS], key=float)


def _forces(sheet: Part) -> list[str]:
    force, leading, speeds = sheet["force_g_mm"], sheet["leading_g_mm"] or {}, sheet["force_n"]
    heads = ["order", "axis", "A_k", "g·mm", "leading g·mm", *(f"N at {speed} rpm" for speed in speeds)]
    rows: list[Row] = []
    for axis, name in _axes_of(sheet).items():
        amounts, own = force[axis] or {}, axis == "x"
        for order in (order for order in shown_orders(force.values()) if order in amounts):
            of_piston = [sheet["harmonics"].get(order), leading.get(order)] if own else [None, None]
            at_speeds = [newton(amounts[order], float(speed)) for speed in speeds]
            rows.append([order, name, of_piston[0], amounts[order], of_piston[1], *at_speeds])
    title = f"Force by order {plain_state(sheet)} (amplitude; g·mm: over ω²; leading: slider alone, first term)"
    return text_table(title, heads, rows, kept=2) or [f"Force by order {plain_state(sheet)}: none", ""]


def _axes_of(sheet: Part) -> dict[str, str]:
    """Keys of the two axes and what they are called: one cylinder has a direction of its own, several have Z and X."""
    return {"x": "along", "y": "across"} if sheet["strategies"] is not None else {"x": "Z", "y": "X"}


def _moments(sheet: Part) -> list[str]:
    moments, speeds = sheet["moment_g_mm2"], list(sheet["force_n"])
    heads = ["order", "axis", "g·mm²", *(f"N·m at {speed} rpm" for speed in speeds)]
    rows: list[Row] = [
        [order, text, amounts[order], *(1e-3 * newton(amounts[order], float(speed)) for speed in speeds)]
        for key, text in _MOMENTS.items()
        for amounts in (moments[key] or {},)
        for order in shown_orders(moments.values())
        if order in amounts
    ]
    title = "Moments by order (Z: cylinders or middle of their banks, Y: crankshaft, X: across both)"
    return text_table(title, heads, rows, kept=2)


def _strategies(sheet: Part) -> list[str]:
    strategies = {name: strategy for name, strategy in (sheet["strategies"] or {}).items() if strategy is not None}
    if not strategies:
        return []
    speed = max(sheet["force_n"], key=float)

    def row(text: str, key: str, plain: Cell = None) -> list[Cell]:
        return [text, plain, *(strategy[key] for strategy in strategies.values())]

    def in_newton(row: Row, scale: float = 1.0) -> list[Cell]:
        return [size if size is None else scale * newton(float(size), float(speed)) for size in row[1:]]

    plain = {axis: sheet["force_g_mm"][axis] or {} for axis in "xy"}
    along = row("order 1 along, g·mm", "residual_x_g_mm", plain["x"].get("1", 0.0))
    across = row("order 1 across, g·mm", "residual_y_g_mm", plain["y"].get("1", 0.0))
    higher = [{order: amount for order, amount in plain["x"].items() if order != "1"}]
    higher += [strategy["higher_orders_x_g_mm"] or {} for strategy in strategies.values()]
    turned = any(strategy["counterweight_deg"] for strategy in strategies.values())
    by_order: list[Row] = [[f"order {order} along, g·mm", *_at(order, higher)] for order in shown_orders(higher)[:4]]
    rows: list[Row] = [
        row("counterweight on the crank, g", "counterweight_g"),
        *([row("… on from opposite to the pin, °", "counterweight_deg")] if turned else []),
        row("counterweight on the rod, g", "rod_counterweight_g"),
        row("counterweights in all, g", "total_g"),
        along,
        across,
        [f"order 1 along, N at {speed} rpm", *in_newton(along)],
        [f"order 1 across, N at {speed} rpm", *in_newton(across)],
        *by_order,
        [f"couple at most, N·m at {speed} rpm", *in_newton(row("", "couple_g_mm2"), 1e-3)],
    ]
    turns = [strategy["rotation"].replace("line", "to and fro") for strategy in strategies.values()]
    rows.append(["order 1 turns", None, *("no force" if turn == "none" else turn for turn in turns)])
    return text_table("Strategies side by side", ["", "none", *strategies], rows)


def _at(order: str, amounts: Sequence[Mapping[str, float]]) -> list[float]:
    return [by_order.get(order, 0.0) for by_order in amounts]


def _sets(sheet: Part) -> dict[str, Part]:
    """Possibilities of additional shafts."""
    return {name: layout for name, layout in sheet["shafts"].items() if layout and "strategy" in layout}


def _shafts(sheet: Part) -> list[str]:
    columns = {
        "possibility": "name", "on strategy": "strategy", "speed / crank": "speed_ratio",
        "g·mm each": "unbalance_g_mm", "g at crank radius": "mass_at_crank_radius_g", "heavy side °": "phase_deg",
    }  # fmt: skip
    title = "Additional shafts (speed < 0: against the crank; heavy side: at top dead centre, from the cylinder)"
    sets = _sets(sheet).items()
    return table_of(title, columns, ({**s, **shaft, "name": name} for name, s in sets for shaft in s["shafts"]), kept=2)


def _cycle(sheet: Part) -> list[str]:
    """Gas and inertia torque on the crank by order at every speed; loads of walls, pins and bearings at the highest."""
    cycle = sheet["cycle"]
    if cycle is None:
        return []
    torques: list[Part] = []
    for speed, turning in cycle["turning"].items():
        larger = {order: max(row["gas_n_m"], row["inertia_n_m"]) for order, row in turning["by_order"].items()}
        shown = [order for order in larger if larger[order] > _SHOWN_TORQUE * max(larger.values())]
        torques += [{"rpm": speed, "order": order, **turning["by_order"][order]} for order in shown]
    columns = {"rpm": "rpm", "order": "order", "gas N·m": "gas_n_m", "masses N·m": "inertia_n_m"}
    columns |= {"larger": "dominates", "alike at rpm": "alike_at_rpm"}
    title = "Torque of gas and masses on the crank by order"
    if cycle["gas"] is None:
        title, columns = "Torque of the masses on the crank", {"rpm": "rpm", "order": "order", "N·m": "inertia_n_m"}
    lines = table_of(title, columns, torques, kept=1 + (cycle["gas"] is not None))
    if cycle["loads"] is None:
        return lines
    speed = max(cycle["loads"], key=float)
    loads = cycle["loads"][speed]
    carried = [
        {"name": f"cylinder {cylinder['cylinder']}, {text}", **cylinder[text.replace(" ", "_")]}
        for cylinder in loads["cylinders"]
        for text in ("wall", "piston pin", "crank pin")
    ]
    for bearing in loads["main_bearings"] or ():
        carried.append({"name": f"main bearing at {short_number(bearing['position_mm'])} mm", **bearing})
    columns = {"": "name", "peak N": "peak_n", "at crank °": "peak_deg", "mean N": "mean_n"}
    return lines + table_of(f"Loads at {speed} rpm", columns, carried)


def _designs(sheet: Part) -> list[str]:
    """Crank webs and shafts of several cylinders: what each carries, and what is left of force and couples."""
    design = sheet["design"]
    if design is None:
        return []
    placed: list[Part] = []
    for name, layout in design["layouts"].items():
        carriers = [("crank", layout["webs"])] if name == "webs" or not placed else []
        carriers += [(f"shaft {shaft['speed_ratio']:+d}", shaft["weights"]) for shaft in layout["shafts"]]
        placed += [{"design": name, "on": on, **weight} for on, weights in carriers for weight in weights]
    columns = {"at mm": "position_mm", "g·mm": "unbalance_g_mm", "heavy side °": "angle_deg"}
    title = "Webs and shafts for force and couple (speed × crank, < 0 against it; heavy side: at crank angle 0 from Z)"
    lines = table_of(title, {"design": "design", "on": "on", **columns}, placed, kept=2)
    throws = [{**weight, "cylinder": str(n)} for n, weight in enumerate(design["throw_counterweights"])]
    title = "Or a counterweight at each throw, for all of order 1 that turns with the crank"
    columns = {"g·mm": "unbalance_g_mm", "heavy side °": "angle_deg", "at mm": "position_mm"}
    lines += table_of(title, {"cylinder": "cylinder", **columns}, [w for w in throws if w["unbalance_g_mm"] > 0])
    left = {"none": sheet["moment_g_mm2"], **_left(sheet, design["layouts"], "residual_moment_g_mm2")}
    rows = [row for key, text in _MOMENTS.items() for row in _by_order(left, key, text)]
    return lines + text_table("Moments that remain, g·mm²", ["order", "axis", *left], rows, kept=2)


def _left(sheet: Part, layouts: Mapping[str, Part], key: str) -> dict[str, Part]:
    """What the ``layouts`` and the engine's own shafts leave, by name."""
    own = sheet["shafts"]["own"]
    return {name: layout[key] for name, layout in layouts.items()} | ({} if own is None else {"own": own[key]})


def _by_order(left: Mapping[str, Part], axis: str, text: str) -> list[Row]:
    """A row for each order with the amounts on an ``axis``, called ``text``, that each system has ``left``."""
    amounts = [axes[axis] or {} for axes in left.values()]
    return [[order, text, *_at(order, amounts)] for order in shown_orders(amounts)]


def _shaft_residuals(sheet: Part) -> list[str]:
    layouts = _sets(sheet) | (sheet["design"] or {"layouts": {}})["layouts"]
    left = {"none": sheet["force_g_mm"], **_left(sheet, layouts, "residual_g_mm")}
    if len(left) == 1:
        return []
    rows = [row for axis, text in _axes_of(sheet).items() for row in _by_order(left, axis, text)]
    own = " (own: the shafts that the engine has)" if "own" in left else ""
    return text_table(f"Force that remains with shafts, g·mm{own}", ["order", "axis", *left], rows, kept=2)


def _pairs(sheet: Part) -> list[str]:
    pairs = [{**pair, "order": str(pair["order"])} for pair in sheet["shafts"]["pairs"] or ()]
    columns = {
        "order": "order", "one, design": "one_shaft_design_g_mm", "one, weighed": "one_shaft_measured_g_mm",
        "pair, design": "pair_design_g_mm", "pair, weighed": "pair_measured_g_mm", "± rounding": "pair_rounding_g_mm",
        "pair, printed": "printed_pair_g_mm", "needed": "printed_needed_g_mm",
    }  # fmt: skip
    lines = table_of("Shaft pairs from their parts, g·mm", columns, pairs)
    texts = {"literal": "its unbalance", "physical": "its force"}
    readings = [
        {"order": pair["order"], "printed is": texts[name], **reading}
        for pair in pairs
        for name, reading in (pair["scenarios"] or {}).items()
    ]
    columns = {
        "order": "order", "printed is": "printed is", "unbalance": "pair_unbalance_g_mm", "force": "pair_force_g_mm",
        "force / needed": "overbalance", "remains": "residual_x_g_mm", "class": "class",
    }  # fmt: skip
    return lines + table_of("Printed pair read both ways, g·mm (remains < 0: too much)", columns, readings, kept=2)


def _crankshaft(sheet: Part) -> list[str]:
    crankshaft = sheet["crankshaft"]
    if crankshaft is None:
        return []
    columns = {
        "part": "name", "Wr kg": "mass_kg", "X mm": "x_mm", "Y mm": "y_mm", "Wr X": "static_kg_mm.x",
        "Wr Y": "static_kg_mm.y", "Z mm": "z_mm", "CX": "dynamic_kg_mm2.x", "CY": "dynamic_kg_mm2.y",
    }  # fmt: skip
    title = "Crankshaft: static (Wr X, Wr Y: kg·mm) and dynamic (CX, CY: kg·mm²) balance of its parts"
    lines = table_of(title, columns, [*crankshaft["sections"], {**crankshaft, "name": "sum"}])
    couples = [(f"at {speed} rpm", amount) for speed, amount in crankshaft["couple_Nm_at_rpm"].items()]
    lines += text_table("Rocking couple that turns with the crankshaft", ["", "N·m"], couples)
    columns = {"plane": "name", "z mm": "z_mm"}
    for text, key in (("has", "has_kg_mm"), ("add", "correction_kg_mm"), ("needs", "needs_kg_mm")):
        columns |= {f"{text} {axis}": f"{key}.{axis}" for axis in "xy"}
    lines += table_of("Two-plane correction, kg·mm", columns, crankshaft["planes"])
    columns = {
        "counterweight": "name", "kg": "fan.mass_kg", "centroid mm": "fan.centroid_mm", "kg·mm": "fan.unbalance_kg_mm",
        "or radius mm": "fan.resized.radius_mm", "or thickness mm": "fan.resized.thickness_mm",
        "or fan °": "fan.resized.fan_angle_deg",
    }  # fmt: skip
    lines += table_of("Fans, and the one size that would meet both sums", columns, crankshaft["planes"])
    columns = {"rod's big end": "method", "kg": "mass_kg"}
    columns |= {"static y, kg·mm": "static_kg_mm.y", "dynamic y, kg·mm²": "dynamic_kg_mm2.y"}
    bobs = crankshaft["bob_weights"] or []
    title = "The crankshaft with another mass in the place of its bob weight"
    return lines + table_of(title, columns, bobs if len(bobs) > 1 else [])


def _rod(sheet: Part) -> list[str]:
    rod = sheet["rod_split"]
    if rod is None:
        return []
    methods = [{**split, "name": name} for name, split in rod["methods"].items()]
    columns = {
        "by": "name", "big end g": "big_end_g", "small end g": "small_end_g", "total g": "total_g",
        "centre / length": "centroid_fraction",
    }  # fmt: skip
    whole = {"name": "weighed whole", "total_g": rod["weighed_whole_g"]}
    return table_of("The rod in two masses", columns, [*methods, whole])


def _gears(sheet: Part) -> list[str]:
    cranks = sheet["reverse_cranks"]
    if cranks is None:
        return []
    gears = [(name, ratio, cranks["weights_g"].get(name)) for name, ratio in cranks["speed_ratios"].items()]
    lines = text_table("Direct and reverse cranks: gears", ["gear", "speed / crank", "weight g"], gears)
    exact, leading = cranks["pair_moments_g_mm"]["exact"], cranks["pair_moments_g_mm"]["leading"]
    moments = [(order, amount, leading[order]) for order, amount in exact.items()]
    return lines + text_table("Moments of the pairs of weights, g·mm", ["order", "exact", "leading term"], moments)


def _single_causes(sheet: Part) -> list[str]:
    """Force over ω² and at every speed that each single cause leaves, with its class of unbalance."""

    speeds = list(sheet["force_n"])
    heads = ["What remains", "axis", "order", "g·mm", *(f"N at {speed} rpm" for speed in speeds), "class"]
    rows = [
        [cause, axis, order, amount, *(newton(amount, float(speed)) for speed in speeds), grade]
        for cause, axis, order, amount, grade in single_causes(sheet)
    ]
    return text_table("Residuals of single causes", heads, rows, kept=3)


def _gear_errors(sheet: Part) -> list[str]:
    sampled = None if sheet["reverse_cranks"] is None else sheet["reverse_cranks"]["tolerances"]
    if sampled is None:
        return []
    texts = {"along_g_mm": "along, g·mm", "across_g_mm": "across, g·mm", "couple_g_mm2": "couple, g·mm²"}
    rows: list[Row] = [
        [text, order, shares["median"], shares["95 %"]]
        for key, text in texts.items()
        for order, shares in sampled[key].items()
    ]
    title = f"What sampled gear errors leave ({sampled['errors']['samples']} trains)"
    return text_table(title, ["", "order", "median", "95 % below"], rows, kept=2)


def hinge_text(sheet: Part) -> str:
    """Tables and sentences of a hinge ``sheet``, no line wider than a terminal's page.

    Solutions that do not exist are left out.
    """
    torque, mechanisms = sheet["torque"], sheet["mechanisms"]
    lines = [printable(sheet["engine"], WIDTH), ""]
    rows: list[Row] = [("mean, N·m", torque["mean_nm"]), ("work per revolution, J", torque["work_per_rev_j"])]
    lines += text_table("Crank torque", ["", ""], rows)
    columns = {"crank angle °": "crank_angle_deg", "N·m": "torque_nm"}
    lines += table_of("Extrema of the crank torque", columns, torque["extrema"], kept=0)
    lines += text_table("Crank torque by order", ["order", "N·m"], torque["harmonics_nm"].items())
    rows = [
        [mechanism["name"], float(speed), without, *mechanism["side_force_n"].values()]
        for mechanism in mechanisms
        for speed, without in mechanism["side_force_without_hinge_n"].items()
    ]
    heads = ["mechanism", "rpm", "no hinge", "full M12", "potential", "printed (6)"]
    lines += text_table("Largest side force on the piston (R430 without hinge, R43 with it), N", heads, rows)
    lines += _hinge_moments(mechanisms) + _solutions(mechanisms)
    for mechanism in mechanisms:
        pin, strut = mechanism["characteristic"]["pin"], mechanism["characteristic"]["strut"]
        curves = [pin[key] for key in ("hinge_angle_deg", "crank_angle_deg", "moment_nm", "work_j")]
        curves += [strut["moment_nm"], strut["work_j"]]
        heads = ["hinge angle °", "pin: crank °", "N·m", "work J", "strut: N·m", "work J"]
        title = f"Hinge characteristics of {mechanism['name']} at {pin['speed_rpm']:.5g} rpm"
        lines += text_table(title, heads, zip(*curves, strict=True), kept=0)
    lines += _air_springs_and_guides(mechanisms)
    return "\n".join([*lines, *closing("What remains", sheet["sentences"], sheet["notes"])]) + "\n"


def _hinge_moments(mechanisms: Sequence[Part]) -> list[str]:
    rows: list[Row] = [
        [*_cells(mechanism, ("name", "lambda", "static_moment_nm", "weight_moment_nm", "mean_gas_moment_nm")),
         *(1e3 * mechanism["shaking_force_kg_m"][axis] for axis in "xy")]
        for mechanism in mechanisms
    ]  # fmt: skip
    heads = ["mechanism", "λ", "G, N·m", "weights, N·m", "gas mean, N·m", "shakes x, kg·mm", "y, kg·mm"]
    lines = text_table("Moments and shaking force over ω²", heads, rows)
    columns = {"mechanism": "name"} | {
        f"{kind}, {joint}": f"work_j.{kind}.{joint}" for kind in ("full", "printed") for joint in ("pin", "strut")
    }
    return lines + table_of(
        "Work of the hinges per revolution, J (a spring needs zero: potential)", columns, mechanisms
    )


def _solutions(mechanisms: Sequence[Part]) -> list[str]:
    rows: list[Row] = []
    for mechanism in mechanisms:
        name, solutions = mechanism["name"], mechanism["solutions"]
        for weight, by_hinge in solutions["weight_without_side_force"].items():
            text = weight.removesuffix("_n").replace("_", " ")
            rows.append([name, f"{text}, no side force", *by_hinge.values()])
        rows.append([name, "crank counterweight, eq. (12)", solutions["crank_counterweight_n"], None, None])
        for part in ("rod", "crank"):
            amount = (solutions["balanced"] or {}).get(f"{part}_counterweight_n")
            rows.append([name, f"{part} counterweight, eq. (13)", amount, None, None])
    heads = ["mechanism", "what to choose", "N", "N, printed (6)", "… cos ψ truncated"]
    return text_table("Solutions", heads, rows, kept=2)


def _air_springs_and_guides(mechanisms: Sequence[Part]) -> list[str]:
    springs = [{**spring, "name": mechanism["name"]} for mechanism in mechanisms for spring in mechanism["air_spring"]]
    columns = {
        "mechanism": "name", "hinge": "joint", "cut for rpm": "designed_speed_rpm", "at rpm": "speed_rpm",
        "pressure ratio": "pressure_ratio", "share left": "residual_share", "unevenness": "speed_fluctuation",
    }  # fmt: skip
    lines = table_of("Air spring at another speed", columns, springs, kept=2)
    rows: list[Row] = [
        [f"{mechanism['name']}, {joint}", guides["speed_rpm"], 1e-3 * guides["stiffness_n_per_m"],
         1e3 * min(guides["length_m"]), 1e3 * max(guides["length_m"]), guides["steepest_deg"],
         "no: sharper than the roller" if guides["undercut"] else "yes"]
        for mechanism in mechanisms
        for joint, guides in mechanism["guides"].items()
        if guides is not None
    ]  # fmt: skip
    heads = ["hinge", "rpm", "spring N/mm", "shortest mm", "longest mm", "steepest °", "can be cut"]
    return lines + text_table("Springs and guides of the hinges", heads, rows)
