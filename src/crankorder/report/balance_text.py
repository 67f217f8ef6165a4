"""The balance of an engine, or of one with elastic hinges, as plain text: tables, then what remains in sentences.

Tables and paragraphs of plain text for a terminal are aligned, and never wider than a page of it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, chain
from typing import Any

from crankorder.engine.forces import AXES, DIRECTIONS, AxisName, newton
from crankorder.errors import printable
from crankorder.plot.reading import number_text
from crankorder.report.balance_sentences import (
    NONE_SHARE,
    larger_parts,
    layouts_of,
    plain_state,
    shaft_sets,
    single_causes,
    told_orders,
)

WIDTH = 100
"""Columns of the widest line."""

SCREEN = 40
"""Lines of a text without its tables."""

DIGITS = 5
"""Significant digits of a number in a table: what a scale or a drawing can give."""

MISSING = "–"
_GAP, _INDENT, _LONGEST_CELL = "  ", "  ", 44

Cell = float | str | None
Row = Sequence[Cell]
Part = Mapping[str, Any]
"""A balance sheet or a part of it."""


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
    filled = [[*map(str, row[:kept]), *row[kept:]] for row in rows if any(cell is not None for cell in row[kept:])]
    if not filled:
        return []
    used = [n for n in range(len(heads)) if n < kept or any(row[n] is not None for row in filled)]
    columns = [_column(heads[n], [row[n] for row in filled]) for n in used]
    names, lines = columns[:kept], paragraph(title)
    blocks: list[list[list[str]]] = [names]
    for column in columns[kept:]:
        if len(blocks[-1]) > kept and sum(len(_GAP + cells[0]) for cells in [*blocks[-1], column]) > WIDTH:
            blocks.append(names)
        blocks[-1] = [*blocks[-1], column]
    for block in blocks:
        lines += [(_INDENT + _GAP.join(cells)).rstrip() for cells in zip(*block, strict=True)]
    return [*lines, ""]


def _column(head: str, cells: Sequence[Cell]) -> list[str]:
    """Head and cells of a column, all of one width: texts from the left, numbers by their points."""
    texts = [head, *(MISSING if cell is None else _cell_text(cell) for cell in cells)]
    numbers = [n for n, cell in enumerate(cells, start=1) if not isinstance(cell, str)]
    after_point = {n: len(texts[n]) - len(texts[n].partition(".")[0]) for n in numbers}
    for n in numbers:
        texts[n] += " " * (max(after_point.values()) - after_point[n])
    width = max(map(len, texts))
    return [text.rjust(width) if numbers else text.ljust(width) for text in texts]


def _cell_text(cell: float | str) -> str:
    return printable(cell, _LONGEST_CELL) if isinstance(cell, str) else short_number(float(cell))


def short_number(value: float, *, digits: int = DIGITS) -> str:
    """``value``, in any unit, to at most ``digits`` significant digits, without trailing zeros behind the point."""
    text = number_text(value, digits=digits)
    return text if "." not in text or "e" in text else text.rstrip("0").rstrip(".")


def page(head: Sequence[str], tables: Sequence[str], title: str, sheet: Part, *, whole: bool) -> str:
    """Text of a ``sheet``: ``head``, ``tables``, and its sentences and notes under ``title``.

    All of these where ``whole``; where not, as many as one screen holds.
    """
    told = [*sheet["sentences"], *(f"Note: {note}" for note in sheet["notes"])]
    items = [paragraph(text, bullet="  * ") for text in told]
    fit = sum(whole or end <= SCREEN - len(head) - 4 for end in accumulate(map(len, items)))
    rest = "Every table" if fit == len(items) else f"{len(items) - fit} more sentences or notes, and every table"
    more = [] if whole else ["", f"{rest}: --all"]
    return "\n".join([*head, "", *tables, title, *chain(*items[:fit]), *more]) + "\n"


_MOST_ORDERS = 24  # rows of a table by order
_ABOUT = {"N": "", "N·m": "about "}
_MASSES = {
    "reciprocating": "reciprocating",
    "rod_at_piston_pin": "… of which rod, at the piston pin",
    "rotating_at_crank_radius": "rotating, at the crank radius",
    "rod_at_crank_pin": "… of which rod, at the crank pin",
}


def table_of(title: str, columns: str, parts: Iterable[Part], *, kept: int = 1) -> list[str]:
    """Lines of a table with a row for each of the ``parts`` of a sheet.

    ``columns``: "head=key" of each, parted by "|", a key alone where it is the head too; "a.b" is the key b of the part
    a. ``title`` and ``kept`` as in :func:`text_table`.
    """
    heads, keys = zip(*((column.split("=") * 2)[:2] for column in columns.split("|")), strict=True)

    def cell(part: Any, key: str) -> Any:
        first, _, rest = key.partition(".")
        return None if part is None else cell(part.get(first), rest) if rest else part.get(first)

    return text_table(title, heads, [[cell(part, key) for key in keys] for part in parts], kept=kept)


def told_once(rows: Iterable[Part], *joined: str) -> list[dict[str, Any]]:
    """``rows`` of a table, those that are alike but for the keys ``joined`` as one row, with all values of these."""
    alike: dict[tuple[str, ...], dict[str, Any]] = {}
    for row in rows:
        kept = alike.setdefault(
            tuple(_cell_text(row[key]) for key in row if key not in joined), {**row, **{key: {} for key in joined}}
        )
        for key in joined:
            kept[key][_cell_text(row[key])] = None
    return [{**kept, **{key: ", ".join(kept[key]) for key in joined}} for kept in alike.values()]


def balance_text(sheet: Part, *, whole: bool = False) -> str:
    """Sentences of a balance ``sheet`` on one screen, no line wider than a page; ``whole``: all its tables too."""
    axes = "; ".join(f"{axis} {sheet['frame'][axis]}" for axis in DIRECTIONS)
    head = [printable(sheet["engine"], WIDTH), f"Crank ratio λ = {_crank_ratio(sheet['lambda'])}"]
    head += paragraph(f"Axes: {axes}; {sheet['frame']['rotation']}.")
    return page(head, _tables(sheet) if whole else (), "What remains unbalanced", sheet, whole=whole)


def _tables(sheet: Part) -> list[str]:
    """Lines of every table of a balance ``sheet``; parts without data are left out."""
    pairs = sheet["shafts"]["pairs"] or ()
    sets, layouts = shaft_sets(sheet["shafts"]), layouts_of(sheet)
    forces = f"Force by order {plain_state(sheet)}"
    title = f"{forces} (amplitude; g·mm: over ω²; leading: slider alone, first term)"
    lines = text_table("Masses", ["", "g"], [(text, sheet["masses_g"][key]) for key, text in _MASSES.items()])
    lines += _by_speed(sheet, title, "force_g_mm", AXES, ("g·mm", "N")) or [f"{forces}: none", ""]
    title = f"Moments of the masses by order {plain_state(sheet)} (amplitude; g·mm²: over ω²)"
    lines += _by_speed(sheet, title, "moment_g_mm2", DIRECTIONS, ("g·mm²", "N·m"))
    if sheet["roll_moment"]["mean_n_m"] is not None:
        lines += _parted("Roll moment on the block about Y", sheet["roll_moment"]["by_speed"], has_gas=True)
    lines += _strategies(sheet)
    shafts = [
        {**shaft, "name": name, "strategy": one["strategy"]} for name, one in sets.items() for shaft in one["shafts"]
    ]
    lines += table_of(
        "Additional shafts (speed < 0: against the crank; heavy side: at top dead centre, from the cylinder)",
        "possibility=name|on strategy=strategy|speed / crank=speed_ratio|g·mm each=unbalance_g_mm"
        "|g at crank radius=mass_at_crank_radius_g|heavy side °=phase_deg",
        told_once(told_once(shafts, "name"), "speed_ratio"),
        kept=2,
    )
    lines += _cycle(sheet["cycle"]) + _designs(sheet)
    own = " (own: the shafts that the engine has)" if "own" in layouts else ""
    if layouts:
        lines += _remaining(sheet, f"Force that remains with shafts, g·mm{own}", "force_g_mm", AXES)
    lines += table_of(
        "Shaft pairs from their parts, g·mm",
        "order|one, design=one_shaft_design_g_mm|one, weighed=one_shaft_measured_g_mm|pair, design=pair_design_g_mm"
        "|pair, weighed=pair_measured_g_mm|± rounding=pair_rounding_g_mm|pair, printed=printed_pair_g_mm"
        "|needed=printed_needed_g_mm",
        pairs,
    )
    texts = {"literal": "its unbalance", "physical": "its force"}
    lines += table_of(
        "Printed pair read both ways, g·mm (remains < 0: too much)",
        "order|printed is|unbalance=pair_unbalance_g_mm|force=pair_force_g_mm|force / needed=overbalance"
        "|remains=residual_along_g_mm|class",
        [
            {"order": pair["order"], "printed is": texts[name], **reading}
            for pair in pairs
            for name, reading in (pair["scenarios"] or {}).items()
        ],
        kept=2,
    )
    return lines + _crankshaft(sheet) + _gears(sheet)


def _crank_ratio(ratio: float) -> str:
    """Crank ratio λ to seven digits; as 1 − difference where these would round to 1."""
    text = short_number(ratio, digits=7)
    return f"1 − {1 - ratio:.3g}" if text == "1" and ratio < 1 else text


def shown_orders(tables: Iterable[Mapping[str, float] | None]) -> list[str]:
    """Orders that are more than nothing in the ``tables`` (amount by order, or None), ascending; the largest ones."""
    given = [table for table in tables if table]
    largest = {order: max(abs(table.get(order, 0.0)) for table in given) for table in given for order in table}
    return told_orders(largest, _MOST_ORDERS)


def or_none(sizes: Iterable[float], most: float) -> list[Cell]:
    """Amplitudes ``sizes`` of a table, "none" where they are nothing beside ``most``, its largest."""
    return ["none" if size <= NONE_SHARE * most else size for size in sizes]


def shown_rows(
    columns: Mapping[AxisName, Sequence[Mapping[str, float] | None]],
) -> Iterator[tuple[str, str, list[Cell]]]:
    """Axis, order and amplitudes of each row of a table: what is nothing beside its largest is "none", or no row.

    ``columns`` are the amplitudes by order of each column, by axis.
    """
    every = [sizes for tables in columns.values() for table in tables for sizes in (table or {}).values()]
    most = max(every, default=0.0)
    for axis, tables in columns.items():
        for order in shown_orders(tables):
            sizes = _at(order, tables)
            if max(sizes) > NONE_SHARE * most:
                yield axis, order, or_none(sizes, most)


def _by_speed(sheet: Part, title: str, key: str, axes: Sequence[AxisName], units: tuple[str, str]) -> list[str]:
    """Amounts by axis and order that stand at ``key``, over ω² and at every speed, beside what the piston is."""
    (over_omega, unit), scale, speeds = units, 1e-3 if units[1] == "N·m" else 1.0, sheet["force_n"]
    heads = ["order", "axis", "A_k", over_omega, f"leading {over_omega}", *(f"{unit} at {key} rpm" for key in speeds)]
    rows: list[Row] = []
    for axis, order, _ in shown_rows({axis: [sheet[key][axis]] for axis in axes}):
        along, amount = key == "force_g_mm" and axis == "Z", sheet[key][axis][order]
        piston, leading = (sheet["harmonics"], sheet["leading_g_mm"] or {}) if along else ({}, {})
        at_speeds = [scale * newton(amount, float(speed)) for speed in speeds]
        rows.append([order, f"{_ABOUT[unit]}{axis}", piston.get(order), amount, leading.get(order), *at_speeds])
    return text_table(title, heads, rows, kept=2)


def _parted(title: str, by_speed: Part, has_gas: bool) -> list[str]:
    """Parts of a moment by order at every speed, and which of them dominates."""
    rows = [
        {"rpm": speed, "order": order, **by_order[order]}
        for speed, by_order in by_speed.items()
        for order in shown_orders([larger_parts(by_order)])
    ]
    of_gas = "|gas N·m=gas_n_m|together N·m=sum_n_m|phase °=sum_phase_deg|larger=dominates|alike at rpm=alike_at_rpm"
    columns = f"rpm|order|masses N·m=inertia_n_m{of_gas * has_gas}"
    return table_of(f"{title} by order (amplitude)", columns, rows, kept=2)


def _strategies(sheet: Part) -> list[str]:
    if sheet["strategies"] is None:
        return []
    along, across = (sheet["force_g_mm"][axis] or {} for axis in AXES)
    plain = {"residual_along_g_mm": along.get("1", 0.0), "residual_across_g_mm": across.get("1", 0.0)}
    kept = {name: strategy for name, strategy in sheet["strategies"].items() if strategy is not None}
    columns, speed = [plain, *kept.values()], max(sheet["force_n"], key=float)
    higher = [{order: along[order] for order in along if order != "1"}]
    higher += [strategy["higher_orders_along_g_mm"] or {} for strategy in kept.values()]

    most = max(plain.values())

    def row(text: str, key: str) -> list[Cell]:
        return [text, *(column.get(key) for column in columns)]

    def left(text: str, sizes: Sequence[float], unit: str = "g·mm") -> list[Cell]:
        over = 1.0 if unit == "g·mm" else newton(1.0, float(speed))
        return [f"{text}, {unit}", *or_none([over * size for size in sizes], over * most)]

    first = {name: [column[f"residual_{name}_g_mm"] for column in columns] for name in ("along", "across")}
    couples = [column.get("couple_g_mm2") for column in columns]
    at_speed = [None if couple is None else 1e-3 * newton(couple, float(speed)) for couple in couples]
    turned = row("… on from opposite to the pin, °", "counterweight_deg")
    turns = {"line": "to and fro", "none": "no force"}
    rows: list[Row] = [
        row("counterweight on the crank, g", "counterweight_g"),
        *([turned] if any(turned[1:]) else []),
        row("counterweight on the rod, g", "rod_counterweight_g"),
        row("counterweights in all, g", "total_g"),
        *(left(f"order 1 {name}", sizes) for name, sizes in first.items()),
        *(left(f"order 1 {name}", sizes, f"N at {speed} rpm") for name, sizes in first.items()),
        *(left(f"order {order} along", _at(order, higher)) for order in shown_orders([{"1": most}, *higher])[1:5]),
        [f"couple at most, N·m at {speed} rpm", *at_speed],
        ["order 1 turns", None, *(turns.get(strategy["rotation"], strategy["rotation"]) for strategy in kept.values())],
    ]
    return text_table("Strategies side by side", ["", "none", *kept], rows)


def _at(order: str, amounts: Sequence[Mapping[str, float] | None]) -> list[float]:
    return [(by_order or {}).get(order, 0.0) for by_order in amounts]


def _cycle(cycle: Part | None) -> list[str]:
    """Gas and inertia torque on the crank by order at every speed; loads of walls, pins and bearings at the highest."""
    if cycle is None:
        return []
    turning = {speed: row["by_order"] for speed, row in cycle["turning"].items()}
    lines = _parted("Torque on the crank", turning, cycle["gas"] is not None)
    if cycle["loads"] is None:
        return lines
    speed = max(cycle["loads"], key=float)
    loads = cycle["loads"][speed]
    carried = told_once(
        (
            {"on": text, "of": str(cylinder["cylinder"]), **cylinder[text.replace(" ", "_")]}
            for text in ("wall", "piston pin", "crank pin")
            for cylinder in loads["cylinders"]
        ),
        "of",
        "peak_deg",
    )
    for bearing in loads["main_bearings"] or ():
        carried.append({**bearing, "on": "main bearing", "of": f"at {short_number(bearing['position_mm'])} mm"})
    columns = "on|of cylinder=of|peak N=peak_n|mean N=mean_n|peak at crank °=peak_deg"
    return lines + table_of(f"Loads at {speed} rpm", columns, carried, kept=2)


def _designs(sheet: Part) -> list[str]:
    """Crank webs and shafts of several cylinders: what each carries, and what is left of force and couples."""
    design = sheet["design"]
    if design is None:
        return []
    webs = design["layouts"].get("webs", {"webs": ()})["webs"]
    placed = [{"design": "webs", "on": "crank", **weight} for weight in webs]
    placed += [
        {"design": name, "on": f"shaft {shaft['speed_ratio']:+d}", **weight}
        for name, layout in design["layouts"].items()
        for shaft in layout["shafts"]
        for weight in shaft["weights"]
    ]
    title = "Webs and shafts for force and couple (speed × crank, < 0 against it; heavy side: at crank angle 0 from Z)"
    lines = table_of(title, "design|on|at mm=position_mm|g·mm=unbalance_g_mm|heavy side °=angle_deg", placed, kept=2)
    throws = [{**weight, "cylinder": n} for n, weight in enumerate(design["throw_counterweights"])]
    title = "Or a counterweight at each throw, for all of order 1 that turns with the crank"
    columns = "cylinder|g·mm=unbalance_g_mm|heavy side °=angle_deg|at mm=position_mm"
    lines += table_of(title, columns, [throw for throw in throws if throw["unbalance_g_mm"] > 0])
    return lines + _remaining(sheet, "Moments of the masses that remain, g·mm²", "moment_g_mm2", DIRECTIONS)


def _remaining(sheet: Part, title: str, key: str, axes: Sequence[AxisName]) -> list[str]:
    """A row for each axis and order with the amounts at ``key`` that the plain engine and each layout leave."""
    remains, about = f"residual_{key.removeprefix('force_')}", _ABOUT["N" if key == "force_g_mm" else "N·m"]
    left = {"none": sheet[key], **{name: layout[remains] for name, layout in layouts_of(sheet).items()}}
    columns = {axis: [by_axis[axis] for by_axis in left.values()] for axis in axes}
    rows: list[Row] = [[order, f"{about}{axis}", *sizes] for axis, order, sizes in shown_rows(columns)]
    return text_table(title, ["order", "axis", *left], rows, kept=2)


def _crankshaft(sheet: Part) -> list[str]:
    """Parts, couple and corrections of a crankshaft, and the masses of a rod."""
    crankshaft, rod, lines = sheet["crankshaft"], sheet["rod_split"], list[str]()
    if crankshaft is not None:
        lines += table_of(
            "Crankshaft: static (Wr X, Wr Y: kg·mm) and dynamic (CX, CY: kg·mm²) balance of its parts",
            "part=name|Wr kg=mass_kg|X mm=x_mm|Y mm=y_mm|Wr X=static_kg_mm.x|Wr Y=static_kg_mm.y|Z mm=z_mm"
            "|CX=dynamic_kg_mm2.x|CY=dynamic_kg_mm2.y",
            [*crankshaft["sections"], {**crankshaft, "name": "sum"}],
        )
        couples = [(f"at {speed} rpm", amount) for speed, amount in crankshaft["couple_Nm_at_rpm"].items()]
        lines += text_table("Rocking couple that turns with the crankshaft", ["", "N·m"], couples)
        lines += table_of(
            "Two-plane correction, kg·mm",
            "plane=name|z mm=z_mm|has x=has_kg_mm.x|has y=has_kg_mm.y|add x=correction_kg_mm.x|add y=correction_kg_mm.y"
            "|needs x=needs_kg_mm.x|needs y=needs_kg_mm.y",
            crankshaft["planes"],
        )
        lines += table_of(
            "Fans, and the one size that would meet both sums",
            "counterweight=name|kg=fan.mass_kg|centroid mm=fan.centroid_mm|kg·mm=fan.unbalance_kg_mm"
            "|or radius mm=fan.resized.radius_mm|or thickness mm=fan.resized.thickness_mm"
            "|or fan °=fan.resized.fan_angle_deg",
            crankshaft["planes"],
        )
        bobs = crankshaft["bob_weights"] or []
        lines += table_of(
            "The crankshaft with another mass in the place of its bob weight",
            "rod's big end=method|kg=mass_kg|static y, kg·mm=static_kg_mm.y|dynamic y, kg·mm²=dynamic_kg_mm2.y",
            bobs if len(bobs) > 1 else [],
        )
    if rod is not None:
        methods = [{**split, "name": name} for name, split in rod["methods"].items()]
        methods.append({"name": "weighed whole", "total_g": rod["weighed_whole_g"]})
        columns = (
            "by=name|big end g=big_end_g|small end g=small_end_g|total g=total_g|centre / length=centroid_fraction"
        )
        lines += table_of("The rod in two masses", columns, methods)
    return lines


def _gears(sheet: Part) -> list[str]:
    """Gears of direct and reverse cranks; what single causes leave, at every speed, with its class; errors of gears."""
    cranks, lines, speeds = sheet["reverse_cranks"], list[str](), list(sheet["force_n"])
    if cranks is not None:
        gears = [(name, ratio, cranks["weights_g"].get(name)) for name, ratio in cranks["speed_ratios"].items()]
        lines += text_table("Direct and reverse cranks: gears", ["gear", "speed / crank", "weight g"], gears)
        exact, leading = cranks["pair_moments_g_mm"]["exact"], cranks["pair_moments_g_mm"]["leading"]
        moments = [(order, amount, leading[order]) for order, amount in exact.items()]
        lines += text_table("Moments of the pairs of weights, g·mm", ["order", "exact", "leading term"], moments)
    heads = ["What remains", "axis", "order", "g·mm", *(f"N at {speed} rpm" for speed in speeds), "class"]
    rows: list[Row] = [
        [*cause, amount, *(newton(amount, float(speed)) for speed in speeds), grade]
        for *cause, amount, grade in single_causes(sheet)
    ]
    lines += text_table("Residuals of single causes", heads, rows, kept=3)
    sampled = None if cranks is None else cranks["tolerances"]
    if sampled is None:
        return lines
    texts = {"along_g_mm": "along, g·mm", "across_g_mm": "across, g·mm", "couple_g_mm2": "couple, g·mm²"}
    rows = [
        [text, order, shares["median"], shares["95 %"]]
        for key, text in texts.items()
        for order, shares in sampled[key].items()
    ]
    title = f"What sampled gear errors leave ({sampled['errors']['samples']} trains)"
    return lines + text_table(title, ["", "order", "median", "95 % below"], rows, kept=2)


def hinge_text(sheet: Part, *, whole: bool = False) -> str:
    """Sentences of a hinge ``sheet`` on one screen, no line wider than a page; ``whole``: all its tables too."""
    tables = _hinge_tables(sheet) if whole else ()
    return page([printable(sheet["engine"], WIDTH)], tables, "What remains", sheet, whole=whole)


def _hinge_tables(sheet: Part) -> list[str]:
    """Lines of every table of a hinge ``sheet``; solutions that do not exist are left out."""
    torque, mechanisms, lines = sheet["torque"], sheet["mechanisms"], list[str]()
    rows: list[Row] = [("mean, N·m", torque["mean_nm"]), ("work per revolution, J", torque["work_per_rev_j"])]
    lines += text_table("Crank torque", ["", ""], rows)
    lines += table_of(
        "Extrema of the crank torque", "crank angle °=crank_angle_deg|N·m=torque_nm", torque["extrema"], kept=0
    )
    lines += text_table("Crank torque by order", ["order", "N·m"], torque["harmonics_nm"].items())
    lines += table_of(
        "Largest side force on the piston (R430 without hinge, R43 with it), N",
        "mechanism=name|rpm|no hinge=without|full M12=side_force_n.full|potential=side_force_n.potential"
        "|printed (6)=side_force_n.printed",
        [
            {**mechanism, "rpm": float(speed), "without": without}
            for mechanism in mechanisms
            for speed, without in mechanism["side_force_without_hinge_n"].items()
        ],
    )
    lines += table_of(
        "Moments and shaking force over ω²",
        "mechanism=name|λ=lambda|G, N·m=static_moment_nm|weights, N·m=weight_moment_nm|gas mean, N·m=mean_gas_moment_nm"
        "|shakes x, kg·mm=x|y, kg·mm=y",
        [{**one, **{axis: 1e3 * one["shaking_force_kg_m"][axis] for axis in "xy"}} for one in mechanisms],
    )
    lines += table_of(
        "Work of the hinges per revolution, J (a spring needs zero: potential)",
        "mechanism=name|full, pin=work_j.full.pin|full, strut=work_j.full.strut|printed, pin=work_j.printed.pin"
        "|printed, strut=work_j.printed.strut",
        mechanisms,
    )
    lines += _solutions(mechanisms)
    for mechanism in mechanisms:
        pin, strut = mechanism["characteristic"]["pin"], mechanism["characteristic"]["strut"]
        curves = [pin[key] for key in ("hinge_angle_deg", "crank_angle_deg", "moment_nm", "work_j")]
        heads = ["hinge angle °", "pin: crank °", "N·m", "work J", "strut: N·m", "work J"]
        title = f"Hinge characteristics of {mechanism['name']} at {pin['speed_rpm']:.5g} rpm"
        rows = list(zip(*curves, strut["moment_nm"], strut["work_j"], strict=True))
        lines += text_table(title, heads, rows, kept=0)
    lines += table_of(
        "Air spring at another speed",
        "mechanism=name|hinge=joint|cut for rpm=designed_speed_rpm|at rpm=speed_rpm|pressure ratio=pressure_ratio"
        "|share left=residual_share|unevenness=speed_fluctuation",
        [{**spring, "name": mechanism["name"]} for mechanism in mechanisms for spring in mechanism["air_spring"]],
        kept=2,
    )
    rows = [
        [f"{mechanism['name']}, {joint}", guides["speed_rpm"], 1e-3 * guides["stiffness_n_per_m"],
         1e3 * min(guides["length_m"]), 1e3 * max(guides["length_m"]), guides["steepest_deg"],
         "no: sharper than the roller" if guides["undercut"] else "yes"]
        for mechanism in mechanisms
        for joint, guides in mechanism["guides"].items()
        if guides is not None
    ]  # fmt: skip
    heads = ["hinge", "rpm", "spring N/mm", "shortest mm", "longest mm", "steepest °", "can be cut"]
    return lines + text_table("Springs and guides of the hinges", heads, rows)


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
