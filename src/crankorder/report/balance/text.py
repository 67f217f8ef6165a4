"""The balance of an engine, or of one with elastic hinges, as plain text: tables, then what remains in sentences.

Tables and paragraphs of plain text for a terminal are aligned, and never wider than a page of it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from crankorder.engine.balance_data import Amounts, newton
from crankorder.engine.balance_sheet import BalanceSheet, OwnShafts, ShaftSet
from crankorder.engine.crankshaft import CrankshaftSums
from crankorder.engine.hinge_sheet import HingeSheet, Mechanism
from crankorder.engine.shaft_design import ByAxis, DesignLayout
from crankorder.errors import printable
from crankorder.plot.reading import number_text

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
    """Lines of a table, none where it has no rows: title, heads, rows; numbers stand with their points in one column.

    ``title`` over the table. ``heads`` of the columns, units in them. ``rows`` of numbers, texts and None, which is
    shown as a dash; rows and columns of None alone are left out. ``kept`` first columns that name a row: where the
    table is wider than the page they are repeated, with the other columns below one another.
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
    """``value`` to at most ``digits`` significant digits, without the zeros that end it."""
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
Cause = tuple[str, str, str, float, str | None]


def _single_causes(sheet: BalanceSheet) -> Iterator[Cause]:
    """Cause, axis, order, amount over ω² (g·mm) and class of unbalance; causes without data make no row."""
    if sheet.shafts.built_for_ratio is not None:
        amount = sheet.shafts.built_for_ratio.residual_x_g_mm
        yield "second-order pair built for λ, not A2", "along", "2", amount, None
    if sheet.rod_split is not None:
        for text, left in (("along", sheet.rod_split.residual_x_g_mm), ("across", sheet.rod_split.residual_y_g_mm)):
            for order, amount in left.items():
                yield "rod as weighed, balanced as cut", text, order, amount, None
    if sheet.added_mass is not None:
        cause = f"{short_number(sheet.added_mass.mass_g)} g that no shaft knows"
        for order, amount in list(sheet.added_mass.residual_x_g_mm.items())[:3]:
            yield cause, "along", order, amount, sheet.added_mass.grade if order == "1" else None
    if sheet.offset is not None:
        cause = f"offset of {short_number(sheet.offset.offset_mm)} mm, shafts timed to crank"
        yield cause, "along", "1", sheet.offset.quadrature_x_g_mm, None
    if sheet.reverse_cranks is not None:
        amounts = sheet.reverse_cranks.residual_x_g_mm
        yield "direct and reverse cranks, exact", "along", "all", amounts["exact"], None
        yield "direct and reverse cranks, built for λ", "along", "all", amounts["leading"], None


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


def balance_text(sheet: BalanceSheet) -> str:
    """Tables and sentences of a balance ``sheet``, no line wider than a terminal's page.

    Parts that it has no data for are left out.
    """
    lines = [printable(sheet.engine, WIDTH), f"Crank ratio λ = {_crank_ratio(sheet.crank_ratio)}", ""]
    lines += text_table("Masses", ["", "g"], [(text, sheet.masses_g[key]) for key, text in _MASSES.items()])
    for table in (
        _forces, _moments, _strategies, _shafts, _turning, _loads, _designs, _shaft_residuals, _pairs, _crankshaft,
        _rod, _gears,
    ):  # fmt: skip
        lines += table(sheet)
    speeds = list(sheet.force_n)
    heads = ["What remains", "axis", "order", "g·mm", *(f"N at {speed} rpm" for speed in speeds), "class"]
    rows: list[Row] = [
        [cause, axis, order, amount, *(newton(amount, float(speed)) for speed in speeds), grade]
        for cause, axis, order, amount, grade in _single_causes(sheet)
    ]
    lines += text_table("Residuals of single causes", heads, rows, kept=3)
    lines += _gear_errors(sheet) + closing("What remains unbalanced", sheet.sentences, sheet.notes)
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


def _forces(sheet: BalanceSheet) -> list[str]:
    force, leading = sheet.force_g_mm, sheet.leading_g_mm or {}
    orders = shown_orders(force.values())
    heads = ["order", "axis", "A_k", "g·mm", "leading g·mm", *(f"N at {speed} rpm" for speed in sheet.force_n)]
    rows: list[Row] = []
    for axis, name in _axes_of(sheet):
        amounts, own = force[axis] or {}, axis == "x"
        for order in (order for order in orders if order in amounts):
            at_speeds = [newton(amounts[order], float(speed)) for speed in sheet.force_n]
            share = sheet.harmonics.get(order) if own else None
            rows.append([order, name, share, amounts[order], leading.get(order) if own else None, *at_speeds])
    title = f"Force by order {sheet.plain_state} (amplitude; g·mm: over ω²; leading: slider alone, first term)"
    return text_table(title, heads, rows, kept=2) or [f"Force by order {sheet.plain_state}: none", ""]


def _axes_of(sheet: BalanceSheet) -> tuple[tuple[str, str], ...]:
    """Keys of the two axes and what they are called: one cylinder has a direction of its own, several have Z and X."""
    return (("x", "along"), ("y", "across")) if sheet.strategies is not None else (("x", "Z"), ("y", "X"))


def _moments(sheet: BalanceSheet) -> list[str]:
    moments, speeds = sheet.moment_g_mm2, list(sheet.force_n)
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


def _strategies(sheet: BalanceSheet) -> list[str]:
    strategies = {name: strategy for name, strategy in (sheet.strategies or {}).items() if strategy is not None}
    if not strategies:
        return []
    speed, every = max(sheet.force_n, key=float), strategies.values()
    plain = {axis: sheet.force_g_mm[axis] or {} for axis in "xy"}
    along = [plain["x"].get("1", 0.0), *(strategy.residual_x_g_mm for strategy in every)]
    across = [plain["y"].get("1", 0.0), *(strategy.residual_y_g_mm for strategy in every)]
    higher = [
        {order: amount for order, amount in plain["x"].items() if order != "1"},
        *(strategy.higher_orders_x_g_mm or {} for strategy in every),
    ]
    couples = [strategy.couple_g_mm2 and 1e-3 * newton(strategy.couple_g_mm2, float(speed)) for strategy in every]
    rows: list[Row] = [
        ["counterweight on the crank, g", None, *(strategy.counterweight_g for strategy in every)],
        ["… on from opposite to the pin, °", None, *(strategy.counterweight_deg for strategy in every)],
        ["counterweight on the rod, g", None, *(strategy.rod_counterweight_g for strategy in every)],
        ["counterweights in all, g", None, *(strategy.total_g for strategy in every)],
        ["order 1 along, g·mm", *along],
        ["order 1 across, g·mm", *across],
        [f"order 1 along, N at {speed} rpm", *(newton(amount, float(speed)) for amount in along)],
        [f"order 1 across, N at {speed} rpm", *(newton(amount, float(speed)) for amount in across)],
    ]
    rows += [[f"order {order} along, g·mm", *_at(order, higher)] for order in shown_orders(higher)[:4]]
    rows.append([f"couple at most, N·m at {speed} rpm", None, *couples])
    rows.append(["order 1 turns", None, *(ROTATION_TEXT[strategy.rotation] for strategy in every)])
    if not any(strategy.counterweight_deg for strategy in every):
        del rows[1]
    return text_table("Strategies side by side", ["", "none", *strategies], rows)


def _own(sheet: BalanceSheet) -> dict[str, OwnShafts]:
    return {} if sheet.shafts.own is None else {"own": sheet.shafts.own}


def _sets(sheet: BalanceSheet) -> dict[str, ShaftSet]:
    return {name: shafts for name, shafts in sheet.shafts.sets.items() if shafts is not None}


def _shafts(sheet: BalanceSheet) -> list[str]:
    heads = ["possibility", "on strategy", "speed / crank", "g·mm each", "g at crank radius", "heavy side °"]
    rows: list[Row] = [
        [name, shafts.strategy, shaft.speed_ratio, shaft.unbalance_g_mm, shaft.mass_at_crank_radius_g, shaft.phase_deg]
        for name, shafts in _sets(sheet).items()
        for shaft in shafts.shafts
    ]
    title = "Additional shafts (speed < 0: against the crank; heavy side: at top dead centre, from the cylinder)"
    return text_table(title, heads, rows, kept=2)


def _turning(sheet: BalanceSheet) -> list[str]:
    """Table of gas and inertia torque on the crank by order, at every speed."""
    if sheet.cycle is None:
        return []
    rows: list[Row] = []
    for speed, turning in sheet.cycle.turning.items():
        largest = max((torque.largest_n_m for torque in turning.by_order.values()), default=0.0)
        rows += [
            [speed, order, torque.gas_n_m, torque.inertia_n_m, torque.dominates, torque.alike_at_rpm]
            for order, torque in turning.by_order.items()
            if torque.largest_n_m > _SHOWN_TORQUE * largest
        ]
    if sheet.cycle.gas is None:
        masses = [[*row[:2], row[3]] for row in rows]
        return text_table("Torque of the masses on the crank", ["rpm", "order", "N·m"], masses)
    heads = ["rpm", "order", "gas N·m", "masses N·m", "larger", "alike at rpm"]
    return text_table("Torque of gas and masses on the crank by order", heads, rows, kept=2)


def _loads(sheet: BalanceSheet) -> list[str]:
    """Table of peak and mean loads of cylinder walls, pins and main bearings at the highest speed."""
    if sheet.cycle is None or sheet.cycle.loads is None:
        return []
    speed = max(sheet.cycle.loads, key=float)
    loads, pins = sheet.cycle.loads[speed], ("wall", "piston pin", "crank pin")
    carried = [
        (f"cylinder {cylinder.cylinder}, {text}", load)
        for cylinder in loads.cylinders
        for text, load in zip(pins, (cylinder.wall, cylinder.piston_pin, cylinder.crank_pin), strict=True)
    ]
    bearings = loads.main_bearings or ()
    carried += [(f"main bearing at {short_number(bearing.position_mm)} mm", bearing.load) for bearing in bearings]
    rows = [(text, load.peak_n, load.peak_deg, load.mean_n) for text, load in carried]
    return text_table(f"Loads at {speed} rpm", ["", "peak N", "at crank °", "mean N"], rows)


def _designs(sheet: BalanceSheet) -> list[str]:
    """Crank webs and shafts of several cylinders: what each carries, and what is left of force and couples."""
    design = sheet.design
    if design is None:
        return []
    rows: list[Row] = []
    for name, layout in design.layouts.items():
        carriers = [("crank", layout.webs)] if name == "webs" or not rows else []
        carriers += [(f"shaft {shaft.speed_ratio:+d}", shaft.weights) for shaft in layout.shafts]
        rows += [
            [name, carrier, weight.position_mm, weight.unbalance_g_mm, weight.angle_deg]
            for carrier, weights in carriers
            for weight in weights
        ]
    heads = ["design", "on", "at mm", "g·mm", "heavy side °"]
    title = "Webs and shafts for force and couple (speed × crank, < 0 against it; heavy side: at crank angle 0 from Z)"
    lines = text_table(title, heads, rows, kept=2)
    throws: list[Row] = [
        [str(number), weight.unbalance_g_mm, weight.angle_deg, weight.position_mm]
        for number, weight in enumerate(design.throw_counterweights)
        if weight.unbalance_g_mm > 0
    ]
    title = "Or a counterweight at each throw, for all of order 1 that turns with the crank"
    lines += text_table(title, ["cylinder", "g·mm", "heavy side °", "at mm"], throws, kept=1)
    systems: dict[str, DesignLayout | OwnShafts] = {**design.layouts, **_own(sheet)}
    left = {"none": sheet.moment_g_mm2, **{name: system.left.moment_g_mm2 or {} for name, system in systems.items()}}
    rows = [row for key, text in _MOMENTS.items() for row in _by_order(left, key, text)]
    return lines + text_table("Moments that remain, g·mm²", ["order", "axis", *left], rows, kept=2)


def _by_order(left: Mapping[str, ByAxis], axis: str, text: str) -> list[Row]:
    """A row for each order with the amounts on an ``axis``, called ``text``, that each system has ``left``."""
    amounts: list[Amounts] = [axes[axis] or {} for axes in left.values()]
    return [[order, text, *_at(order, amounts)] for order in shown_orders(amounts)]


def _at(order: str, amounts: Sequence[Amounts]) -> list[float]:
    return [by_order.get(order, 0.0) for by_order in amounts]


def _shaft_residuals(sheet: BalanceSheet) -> list[str]:
    designs = sheet.design.layouts if sheet.design is not None else {}
    systems: dict[str, ShaftSet | DesignLayout | OwnShafts] = {**_sets(sheet), **designs, **_own(sheet)}
    left = {"none": sheet.force_g_mm, **{name: system.left.force_g_mm for name, system in systems.items()}}
    if len(left) == 1:
        return []
    rows = [row for axis, text in _axes_of(sheet) for row in _by_order(left, axis, text)]
    own = " (own: the shafts that the engine has)" if "own" in left else ""
    return text_table(f"Force that remains with shafts, g·mm{own}", ["order", "axis", *left], rows, kept=2)


def _pairs(sheet: BalanceSheet) -> list[str]:
    pairs = sheet.shafts.pairs or ()
    heads = ["order", "one, design", "one, weighed", "pair, design", "pair, weighed", "± rounding", "pair, printed"]
    rows: list[Row] = [
        [str(pair.order), pair.one_shaft_design_g_mm, pair.one_shaft_measured_g_mm, pair.pair_design_g_mm,
         pair.pair_measured_g_mm, pair.pair_rounding_g_mm, pair.printed_pair_g_mm, pair.printed_needed_g_mm]
        for pair in pairs
    ]  # fmt: skip
    lines = text_table("Shaft pairs from their parts, g·mm", [*heads, "needed"], rows)
    readings = {"literal": "its unbalance", "physical": "its force"}
    read: list[Row] = [
        [str(pair.order), readings[name], reading.pair_unbalance_g_mm, reading.pair_force_g_mm, reading.overbalance,
         reading.residual_x_g_mm, reading.grade]
        for pair in pairs
        for name, reading in (pair.scenarios or {}).items()
    ]  # fmt: skip
    heads = ["order", "printed is", "unbalance", "force", "force / needed", "remains", "class"]
    return lines + text_table("Printed pair read both ways, g·mm (remains < 0: too much)", heads, read, kept=2)


def _crankshaft(sheet: BalanceSheet) -> list[str]:
    crankshaft = sheet.crankshaft
    if crankshaft is None:
        return []
    rows: list[Row] = [
        [row.part.name, row.part.mass_kg, row.part.x_mm, row.part.y_mm, *_products(row.sums, row.part.z_mm)]
        for row in crankshaft.sections
    ]
    rows.append(["sum", None, None, None, *_products(crankshaft.sums, None)])
    heads = ["part", "Wr kg", "X mm", "Y mm", "Wr X", "Wr Y", "Z mm", "CX", "CY"]
    title = "Crankshaft: static (Wr X, Wr Y: kg·mm) and dynamic (CX, CY: kg·mm²) balance of its parts"
    lines = text_table(title, heads, rows)
    couples = [(f"at {speed} rpm", amount) for speed, amount in crankshaft.couple_n_m.items()]
    lines += text_table("Rocking couple that turns with the crankshaft", ["", "N·m"], couples)
    heads = ["plane", "z mm"] + [f"{text} {axis}" for text in ("has", "add", "needs") for axis in "xy"]
    rows = []
    for plane in crankshaft.planes:
        amounts = (plane.has_kg_mm, plane.correction_kg_mm, plane.needs_kg_mm)
        rows.append([plane.name, plane.z_mm, *(part for amount in amounts for part in (amount.real, amount.imag))])
    lines += text_table("Two-plane correction, kg·mm", heads, rows)
    fans: list[Row] = [
        [plane.name, plane.fan.mass_kg, plane.fan.centroid_mm, plane.fan.unbalance_kg_mm, *plane.fan.resized.values()]
        for plane in crankshaft.planes
        if plane.fan is not None
    ]
    heads = ["counterweight", "kg", "centroid mm", "kg·mm", "or radius mm", "or thickness mm", "or fan °"]
    lines += text_table("Fans, and the one size that would meet both sums", heads, fans)
    bobs: list[Row] = [
        [bob.method, bob.mass_kg, bob.sums.static_kg_mm.imag, bob.sums.dynamic_kg_mm2.imag]
        for bob in crankshaft.bob_weights or ()
    ]
    heads = ["rod's big end", "kg", "static y, kg·mm", "dynamic y, kg·mm²"]
    title = "The crankshaft with another mass in the place of its bob weight"
    return lines + text_table(title, heads, bobs[1:] and bobs)


def _products(sums: CrankshaftSums, z_mm: float | None) -> Row:
    static, dynamic = sums.static_kg_mm, sums.dynamic_kg_mm2
    return [static.real, static.imag, z_mm, dynamic.real, dynamic.imag]


def _rod(sheet: BalanceSheet) -> list[str]:
    if sheet.rod_split is None:
        return []
    rows: list[Row] = [
        [name, split.big_end_g, split.small_end_g, split.total_g, split.centroid_fraction]
        for name, split in sheet.rod_split.methods.items()
    ]
    rows.append(["weighed whole", None, None, sheet.rod_split.weighed_whole_g, None])
    heads = ["by", "big end g", "small end g", "total g", "centre / length"]
    return text_table("The rod in two masses", heads, rows)


def _gears(sheet: BalanceSheet) -> list[str]:
    cranks = sheet.reverse_cranks
    if cranks is None:
        return []
    gears = [(name, ratio, cranks.weights_g.get(name)) for name, ratio in cranks.speed_ratios.items()]
    lines = text_table("Direct and reverse cranks: gears", ["gear", "speed / crank", "weight g"], gears)
    exact, leading = cranks.pair_moments_g_mm["exact"], cranks.pair_moments_g_mm["leading"]
    moments = [(order, amount, leading.get(order)) for order, amount in exact.items()]
    return lines + text_table("Moments of the pairs of weights, g·mm", ["order", "exact", "leading term"], moments)


def _gear_errors(sheet: BalanceSheet) -> list[str]:
    sampled = None if sheet.reverse_cranks is None else sheet.reverse_cranks.tolerances
    if sampled is None:
        return []
    rows: list[Row] = [
        [text, order, shares["median"], shares["95 %"]]
        for text, by_order in (
            ("along, g·mm", sampled.along_g_mm),
            ("across, g·mm", sampled.across_g_mm),
            ("couple, g·mm²", sampled.couple_g_mm2),
        )
        for order, shares in by_order.items()
    ]
    title = f"What sampled gear errors leave ({sampled.errors.samples} trains)"
    return text_table(title, ["", "order", "median", "95 % below"], rows, kept=2)


def hinge_text(sheet: HingeSheet) -> str:
    """Tables and sentences of a hinge ``sheet``, no line wider than a terminal's page.

    Solutions that do not exist are left out.
    """
    torque, mechanisms = sheet.torque, sheet.mechanisms
    lines = [printable(sheet.engine, WIDTH), ""]
    rows = [("mean, N·m", torque.mean_nm), ("work per revolution, J", torque.work_per_rev_j)]
    lines += text_table("Crank torque", ["", ""], rows)
    extrema = [(extremum.crank_angle_deg, extremum.torque_nm) for extremum in torque.extrema]
    lines += text_table("Extrema of the crank torque", ["crank angle °", "N·m"], extrema, kept=0)
    lines += text_table("Crank torque by order", ["order", "N·m"], torque.harmonics_nm.items())
    lines += _side_forces(mechanisms) + _hinge_moments(mechanisms) + _solutions(mechanisms)
    for mechanism in mechanisms:
        lines += _characteristic(mechanism)
    lines += _air_springs(mechanisms) + _guides(mechanisms) + closing("What remains", sheet.sentences, sheet.notes)
    return "\n".join(lines) + "\n"


def _side_forces(mechanisms: Sequence[Mechanism]) -> list[str]:
    rows: list[Row] = [
        [mechanism.name, float(speed), without, *(left[kind] for kind in ("full", "potential", "printed"))]
        for mechanism in mechanisms
        for left in (mechanism.side_force_n,)
        for speed, without in mechanism.side_force_without_hinge_n.items()
    ]
    heads = ["mechanism", "rpm", "no hinge", "full M12", "potential", "printed (6)"]
    return text_table("Largest side force on the piston (R430 without hinge, R43 with it), N", heads, rows)


def _hinge_moments(mechanisms: Sequence[Mechanism]) -> list[str]:
    rows: list[Row] = [
        [mechanism.name, mechanism.crank_ratio, mechanism.static_moment_nm, mechanism.weight_moment_nm,
         mechanism.mean_gas_moment_nm, *(1e3 * mechanism.shaking_force_kg_m[axis] for axis in "xy")]
        for mechanism in mechanisms
    ]  # fmt: skip
    heads = ["mechanism", "λ", "G, N·m", "weights, N·m", "gas mean, N·m", "shakes x, kg·mm", "y, kg·mm"]
    lines = text_table("Moments and shaking force over ω²", heads, rows)
    works: list[Row] = [
        [mechanism.name, *mechanism.work_j["full"].values(), *mechanism.work_j["printed"].values()]
        for mechanism in mechanisms
    ]
    heads = ["mechanism", "full, pin", "full, strut", "printed, pin", "printed, strut"]
    return lines + text_table("Work of the hinges per revolution, J (a spring needs zero: potential)", heads, works)


def _solutions(mechanisms: Sequence[Mechanism]) -> list[str]:
    rows: list[Row] = []
    for mechanism in mechanisms:
        name, solutions = mechanism.name, mechanism.solutions
        for weight, by_hinge in solutions.weight_without_side_force.items():
            text = weight.removesuffix("_n").replace("_", " ")
            rows.append([name, f"{text}, no side force", *by_hinge.values()])
        rows.append([name, "crank counterweight, eq. (12)", solutions.crank_counterweight_n, None, None])
        for part in ("rod", "crank"):
            amount = (solutions.balanced or {}).get(f"{part}_counterweight_n")
            rows.append([name, f"{part} counterweight, eq. (13)", amount, None, None])
    heads = ["mechanism", "what to choose", "N", "N, printed (6)", "… cos ψ truncated"]
    return text_table("Solutions", heads, rows, kept=2)


def _characteristic(mechanism: Mechanism) -> list[str]:
    pin, strut = mechanism.characteristic["pin"], mechanism.characteristic["strut"]
    columns = [pin.hinge_angle_deg, pin.crank_angle_deg, pin.moment_nm, pin.work_j, strut.moment_nm, strut.work_j]
    heads = ["hinge angle °", "pin: crank °", "N·m", "work J", "strut: N·m", "work J"]
    title = f"Hinge characteristics of {mechanism.name} at {pin.speed_rpm:.5g} rpm"
    return text_table(title, heads, zip(*columns, strict=True), kept=0)


def _air_springs(mechanisms: Sequence[Mechanism]) -> list[str]:
    rows: list[Row] = [
        [mechanism.name, spring.joint, spring.designed_speed_rpm, spring.speed_rpm, spring.pressure_ratio,
         spring.residual_share, spring.speed_fluctuation]
        for mechanism in mechanisms
        for spring in mechanism.air_spring
    ]  # fmt: skip
    heads = ["mechanism", "hinge", "cut for rpm", "at rpm", "pressure ratio", "share left", "unevenness"]
    return text_table("Air spring at another speed", heads, rows, kept=2)


def _guides(mechanisms: Sequence[Mechanism]) -> list[str]:
    rows: list[Row] = []
    for mechanism in mechanisms:
        for joint, guides in mechanism.guides.items():
            if guides is not None:
                spring = (1e-3 * guides.stiffness_n_per_m, 1e3 * guides.length_m.min(), 1e3 * guides.length_m.max())
                cut = "no: sharper than the roller" if guides.undercut else "yes"
                rows.append([f"{mechanism.name}, {joint}", guides.speed_rpm, *spring, guides.steepest_deg, cut])
    heads = ["hinge", "rpm", "spring N/mm", "shortest mm", "longest mm", "steepest °", "can be cut"]
    return text_table("Springs and guides of the hinges", heads, rows)
