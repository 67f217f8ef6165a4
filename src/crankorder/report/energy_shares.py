"""Shares of the vibration energy per channel, as a table and as bars."""

from __future__ import annotations

from typing import Any

from crankorder.report.notation import frequency_text, is_number, named, number_text, percent_text, unit_text
from crankorder.report.rows import Bar, Table, table_of

PARTS = (
    ("orders", "Orders"),
    ("tones", "Tones"),
    ("modes_and_floor", "Natural frequencies and floor"),
    ("unexplained", "Unexplained"),
)
"""Key in the findings and title of each part of the band, in the order of bar and table: together all of it."""

ABOVE = ("above_band", "Above the band, of all recorded")
"""Key and title of the share that no part of the band holds."""


def energy_table(findings: dict[str, Any], limit: int) -> Table:
    """Share of each part of the energy of ``findings``, one row and one bar per channel; empty where not known.

    Names are cut at ``limit`` characters.
    """
    energy = findings.get("energy")
    energy = energy if isinstance(energy, dict) else {}
    records = [one for one in energy.get("channels") or [] if _known(one)]
    columns = [*PARTS, *([ABOVE] if any(is_number(one.get(ABOVE[0])) for one in records) else [])]
    rows = []
    for record in records:
        total, unit = record.get("total"), _square_unit(str(record.get("unit") or ""))
        mean_square = f"{number_text(float(total))} {unit}".strip() if is_number(total) else "–"
        shares = [percent_text(float(record[key])) if is_number(record.get(key)) else "–" for key, _ in columns]
        shares.insert(len(PARTS), mean_square)
        rows.append([named(record.get("channel", ""), limit=limit), *shares])
    titles = [title for _, title in columns]
    titles.insert(len(PARTS), "Mean square of the band")
    end = energy.get("band_hz")
    title = "Where the energy is" + (f", up to {frequency_text(float(end))} Hz" if is_number(end) else "")
    heads = "|".join(["Channel", *(f"{title}#" for title in titles)])
    return table_of(title, heads, rows, empty="", bars=[_bar(record, limit) for record in records])


def _square_unit(unit: str) -> str:
    """Typographic form of a squared unit: ``"(m/s²)²"`` for ``"(m/s2)²"``, ``"V²"`` for ``"(V)²"``."""
    if not (unit.startswith("(") and unit.endswith((")²", ")2"))):
        return unit_text(unit)
    inner = unit_text(unit[1:-2])
    return f"({inner})²" if not inner.isalnum() else f"{inner}²"


def _known(record: object) -> bool:
    return isinstance(record, dict) and any(is_number(record.get(key)) for key, _ in PARTS)


def _bar(record: dict[str, Any], limit: int) -> Bar:
    """Parts of a bar of length 100; shares that add up to more than all are scaled down to it."""
    shares = {key: max(float(record[key]), 0.0) if is_number(record.get(key)) else 0.0 for key, _ in PARTS}
    scale = 100 / max(1.0, sum(shares.values()))
    parts, start = [], 0.0
    for key, _ in PARTS:
        width = scale * shares[key]
        if width > 0:
            parts.append({"kind": key.replace("_", "-"), "start": f"{start:.2f}", "width": f"{width:.2f}"})
        start += width
    return {"name": named(record.get("channel", ""), limit=limit), "parts": parts}
