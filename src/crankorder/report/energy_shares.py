"""Shares of the vibration energy per channel, as a table and as bars."""

from __future__ import annotations

from crankorder.channel_units import unit_text
from crankorder.findings import EnergyShares, Findings
from crankorder.report.notation import (
    frequency_text,
    is_number,
    named,
    number_text,
    percent_text,
)
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


def energy_table(findings: Findings, limit: int) -> Table:
    """Share of each part of the energy of ``findings``, one row and one bar per channel; empty where not known.

    Names are cut at ``limit`` characters.
    """
    energy = findings.energy
    records = [one for one in energy.channels if _known(one)] if energy is not None else []
    columns = [*PARTS, *([ABOVE] if any(is_number(one.above_band) for one in records) else [])]
    rows = []
    for record in records:
        total, unit = record.total, _square_unit(record.unit or "")
        mean_square = f"{number_text(float(total))} {unit}".strip() if is_number(total) else "–"
        shares = [_share_text(getattr(record, key)) for key, _ in columns]
        shares.insert(len(PARTS), mean_square)
        rows.append([named(record.channel, limit=limit), *shares])
    titles = [title for _, title in columns]
    titles.insert(len(PARTS), "Mean square of the band")
    end = None if energy is None else energy.band_hz
    title = "Where the energy is" + (f", up to {frequency_text(float(end))} Hz" if is_number(end) else "")
    heads = "|".join(["Channel", *(f"{title}#" for title in titles)])
    return table_of(title, heads, rows, empty="", bars=[_bar(record, limit) for record in records])


def _square_unit(unit: str) -> str:
    """Typographic form of a squared unit: ``"(m/s²)²"`` for ``"(m/s2)²"``, ``"V²"`` for ``"(V)²"``."""
    if not (unit.startswith("(") and unit.endswith((")²", ")2"))):
        return unit_text(unit)
    inner = unit_text(unit[1:-2])
    return f"({inner})²" if not inner.isalnum() else f"{inner}²"


def _share_text(share: float | None) -> str:
    return percent_text(share) if is_number(share) else "–"


def _known(record: EnergyShares) -> bool:
    return any(is_number(getattr(record, key)) for key, _ in PARTS)


def _bar(record: EnergyShares, limit: int) -> Bar:
    """Parts of a bar of length 100; shares that add up to more than all are scaled down to it."""
    shares = {key: max(getattr(record, key) or 0.0, 0.0) for key, _ in PARTS}
    scale = 100 / max(1.0, sum(shares.values()))
    parts, start = [], 0.0
    for key, _ in PARTS:
        width = scale * shares[key]
        if width > 0:
            parts.append({"kind": key.replace("_", "-"), "start": f"{start:.2f}", "width": f"{width:.2f}"})
        start += width
    return {"name": named(record.channel, limit=limit), "parts": parts}
