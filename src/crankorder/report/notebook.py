"""Results as a notebook shows them: a headline, then tables folded away; and a table of the tests of a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from crankorder.findings import Findings
from crankorder.plot.axes import findings_of
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


class Sheet(dict[str, object]):
    """A document as its JSON file holds it, which a notebook shows by its sentences."""

    def _repr_html_(self) -> str:
        title = self.get("engine") or f"{self.get('base', '')} → {self.get('new', '')}"
        return _sheet(str(title), self.get("headline") or self.get("sentences"), [], [*self])


def tests_table(tests: Mapping[str, Findings | None]) -> xr.Dataset:
    """Table of tests, each variable (test,), from ``tests``: their findings by folder, None where a test has none.

    ``folder`` is that of the test in the results; speeds are in rpm; ``strongest_order`` is that of the channels with
    the ``unit`` of the first one, with its peak ``amplitude`` and its ``cause``; ``natural_frequencies`` and
    ``bearing_lines`` are counts; ``avoid_rpm`` is the worst speed to avoid. Unknown values are NaN or empty.
    """
    rows = [{"folder": folder, **_row_of(findings)} for folder, findings in tests.items()]
    table = xr.Dataset(attrs={"title": "Tests of this folder"})
    for name in rows[0] if rows else ():
        units = {"units": "min-1"} if name.endswith("_rpm") else {}
        table[name] = ("test", np.array([row[name] for row in rows]), units)
    return table


def _row_of(known: Findings | None) -> dict[str, str | float]:
    findings = findings_of(known, "tests")
    unit = next((channel.unit for channel in findings.channels), "")
    top = max((line for line in findings.orders if line.unit == unit), key=lambda line: line.amplitude, default=None)
    (low, high), avoided = findings.speed_range_rpm, findings.speeds_to_avoid or ()
    return {
        "name": findings.test,
        "speed_low_rpm": np.nan if low is None else low,
        "speed_high_rpm": np.nan if high is None else high,
        "strongest_order": top.order if top else np.nan,
        "amplitude": top.amplitude if top else np.nan,
        "unit": top.unit if top else "",
        "cause": (top.explained_by if top else "") or "",
        "orders": len({round(line.order, 3) for line in findings.orders}),
        "natural_frequencies": sum(mode.explained_by == "mode" for mode in findings.modes),
        "bearing_lines": len(findings.bearings),
        "avoid_rpm": avoided[0].rpm if avoided else np.nan,
        "headline": headline(findings)[0] if known else "",
    }


def _sheet(title: str, sentences: object, tables: Sequence[tuple[bool, Table]], keys: Sequence[str] = ()) -> str:
    """HTML of a ``title``, ``sentences``, ``tables``, each with whether it stands open, and the ``keys`` of more."""
    from crankorder.report.page import TEMPLATES  # loads jinja, which nothing needs but a notebook that shows results

    stated = [str(text) for text in sentences] if isinstance(sentences, list | tuple) else []
    page = TEMPLATES.get_template("notebook.html")
    return page.render(title=title, sentences=stated, tables=tables, keys=keys)
