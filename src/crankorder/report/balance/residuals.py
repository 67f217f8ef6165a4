"""What single causes leave unbalanced, as rows of one table: rod, added mass, offset, shafts, gears."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from crankorder.engine.polar import unbalance_force_n
from crankorder.report.text_table import Cell, short_number

Row = list[Cell]


def residual_rows(sheet: Mapping[str, Any], speeds: Sequence[str]) -> list[Row]:
    """Rows of cause, axis, order, amount over ω² (g·mm), force (N) at each of the ``speeds``, class of unbalance.

    ``sheet``: a balance sheet; causes that it has no data for make no row. ``speeds``: crank speeds (rpm) as its texts.
    """
    rows: list[Row] = []
    for cause, axis, order, amount, grade in (*_of_shafts(sheet), *_of_masses(sheet), *_of_geometry(sheet)):
        newtons = (float(unbalance_force_n(amount, float(speed))) for speed in speeds)
        rows.append([cause, axis, order, amount, *newtons, grade])
    return rows


Cause = tuple[str, str, str, float, str | None]


def _of_shafts(sheet: Mapping[str, Any]) -> Iterator[Cause]:
    built = sheet["shafts"]["second_order_built_for_lambda"]
    if built is not None:
        yield "second-order pair built for λ, not A2", "along", "2", built["residual_x_g_mm"], None


def _of_masses(sheet: Mapping[str, Any]) -> Iterator[Cause]:
    rod, added = sheet["rod_split"], sheet["added_mass"]
    if rod is not None:
        for axis, text in (("x", "along"), ("y", "across")):
            for order, amount in rod[f"residual_{axis}_g_mm"].items():
                yield "rod as weighed, balanced as cut", text, order, amount, None
    if added is not None:
        cause = f"{short_number(added['mass_g'])} g that no shaft knows"
        for order, amount in list(added["residual_x_g_mm"].items())[:3]:
            yield cause, "along", order, amount, added["class"] if order == "1" else None


def _of_geometry(sheet: Mapping[str, Any]) -> Iterator[Cause]:
    offset, cranks = sheet["offset"], sheet["reverse_cranks"]
    if offset is not None:
        cause = f"offset of {short_number(offset['offset_mm'])} mm, shafts timed to crank"
        yield cause, "along", "1", offset["quadrature_x_g_mm"], None
    if cranks is not None:
        for key, text in (("exact", "exact"), ("leading", "built for λ")):
            yield f"direct and reverse cranks, {text}", "along", "all", cranks["residual_x_g_mm"][key], None
