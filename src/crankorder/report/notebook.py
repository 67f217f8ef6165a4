"""Results as a notebook shows them: a headline, then tables folded away; and a table of the tests of a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
import xarray as xr

from crankorder.findings import Findings, OrderFinding
from crankorder.report.sentences.story import headline
from crankorder.report.tables import Table, tables_of

_LIMIT = 60  # characters of a text that stems from a file
_OPEN = ("avoid", "orders")  # what is looked at first stands open


class Diagnosis(Findings):
    """Findings that a notebook shows as a page in small: what matters most, then every table."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        tables = tables_of(self, limit=_LIMIT)
        return _sheet(self.test, headline(self), [(anchor in _OPEN, table) for anchor, table in tables])


class Sheet(dict[str, Any]):
    """A document as its JSON file holds it, which a notebook shows by its sentences."""

    def _repr_html_(self) -> str:
        title = self.get("engine") or f"{self.get('base', '')} → {self.get('new', '')}"
        told: Sequence[str] = self.get("headline") or self.get("sentences") or ()
        keys = ", ".join(f"<code>{escape(str(key))}</code>" for key in self)
        return f"{_sheet(str(title), told, [])}<p><small>{keys}</small></p>"


def tests_table(found: Mapping[str, Findings | None]) -> xr.Dataset:
    """Table of tests, a row (dimension ``test``) each, from the findings of each by folder; None where it has none.

    ``found``: findings by folder. ``folder`` is that of the test in the results; speeds are in rpm; of
    ``strongest_order`` in the channels of the first one's ``unit`` there is the peak ``amplitude`` and the ``cause``;
    ``natural_frequencies`` and ``bearing_lines`` are counted; ``avoid_rpm`` is the worst speed to avoid; what is not
    known is NaN or empty.
    """
    rows = [_row_of(folder, findings) for folder, findings in found.items()]
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}
    units = {"speed_low_rpm": "min-1", "speed_high_rpm": "min-1", "avoid_rpm": "min-1"}
    return xr.Dataset(
        {name: ("test", values, {"units": units[name]} if name in units else {}) for name, values in columns.items()},
        attrs={"title": "Tests of this folder"},
    )


def _row_of(folder: str, findings: Findings | None) -> dict[str, object]:
    orders: Sequence[OrderFinding] = findings.orders if findings else ()
    unit = findings.channels[0].unit if findings and findings.channels else ""
    top = max((line for line in orders if line.unit == unit), key=lambda line: line.amplitude, default=None)
    low, high = findings.speed_range_rpm if findings else (None, None)
    worst = next(iter((findings and findings.speeds_to_avoid) or ()), None)
    return {
        "folder": folder,
        "name": findings.test if findings else "",
        "speed_low_rpm": _number(low),
        "speed_high_rpm": _number(high),
        "strongest_order": _number(top.order if top else None),
        "amplitude": _number(top.amplitude if top else None),
        "unit": top.unit if top else "",
        "cause": (top.explained_by if top else "") or "",
        "orders": len({round(line.order, 3) for line in orders}),
        "natural_frequencies": sum(mode.explained_by == "mode" for mode in (findings.modes if findings else ())),
        "bearing_lines": len(findings.bearings) if findings else 0,
        "avoid_rpm": _number(worst.rpm if worst else None),
        "headline": " ".join(headline(findings)[:1]) if findings else "",
    }


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _sheet(title: str, sentences: Sequence[str], tables: Sequence[tuple[bool, Table]]) -> str:
    """HTML of a ``title``, its ``sentences`` and ``tables``, each with whether it stands open."""
    said = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    folded = "".join(
        f"<details{' open' if is_open else ''}><summary>{escape(table['title'])} ({len(table['rows'])})</summary>"
        f"{_table(table)}</details>"
        for is_open, table in tables
    )
    return f"<div><strong>{escape(title)}</strong><ul>{said}</ul>{folded}</div>"


def _table(table: Table) -> str:
    if not table["rows"]:
        return f"<p>{escape(table['empty'])}</p>"
    head = "".join(f"<th>{escape(column['title'])}</th>" for column in table["columns"])
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table["rows"])
    note = f"<p>{escape(table['note'])}</p>" if table["note"] else ""
    scroll = "max-height:24em;overflow:auto"
    return f'{note}<div style="{scroll}"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
