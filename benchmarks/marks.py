"""Marks of speed and memory, and what was reached: the table that `make bench` and `make bench-all` print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from campaign_page import FINDINGS, FIRST, FULL, MAPS, ROTA, SCIPY
from published import table

MANY, SMALL, WIDE, NARROW, FIXED, LONG, SHORT = "many", "small", "wide", "narrow", "fixed", "long", "short"
"""What a row of `large.py` is for: many recordings; 10,000 small ones; 12 of 24 channels, of 3, two of 3; run-ups."""


@dataclass(frozen=True)
class Mark:
    """A number that a user can count on: ``reached`` at ``least`` or at ``most``, in ``unit``."""

    what: str
    reached: float
    least: float | None = None
    most: float | None = None
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether it is reached."""
        return (self.least is None or self.reached >= self.least) and (self.most is None or self.reached <= self.most)

    @property
    def row(self) -> list[str]:
        """Cells of its row."""
        limit = f"≥ {self.least:g}" if self.most is None else f"≤ {self.most:g}"
        return [self.what, f"{self.reached:.3g}", f"{limit} {self.unit}".rstrip(), "holds" if self.holds else "missed"]


def of_campaign(found: dict[str, Any]) -> list[Mark]:
    """Marks of the reference campaign, from what `campaign.py` publishes."""
    rows, arrays = found["rows"], found["arrays_s"]
    peers = ((MAPS, 2.6, 4.0), (FINDINGS, 1.4, 2.2), (FULL, 1.8, None))
    marks = []
    for name, processor, wall in peers:
        marks.append(Mark(f"{name}: plain scipy's processor seconds over its", over(rows, name), least=processor))
        if wall is not None:
            marks.append(Mark(f"{name}: plain scipy's seconds over its", over(rows, name, key="seconds"), least=wall))
    marks.append(Mark("maps of arrays, warm: scipy's processor seconds over its", arrays[1] / arrays[0], least=5.0))
    more = rows[FIRST]["processor_seconds"] - rows[FINDINGS]["processor_seconds"]
    marks.append(Mark("first run beyond a warm one, processor", more, most=3.0, unit="s"))
    if ROTA in rows:
        marks.append(Mark(f"{MAPS}: {ROTA}'s seconds over its", over(rows, MAPS, ROTA, key="seconds"), least=25.0))
    return [*marks, Mark("make demo, wall", found["demo_s"], most=15.0, unit="s")]


def of_large(rows: dict[str, Any]) -> list[Mark]:
    """Marks of many, wide and long recordings, from the ``rows`` of `large.py` by what they are for."""
    many, plain = rows[MANY]["programs"], rows[MANY]["programs"][SCIPY]["processor_seconds"]
    default, maps = many["default"], many["maps"]
    own = {name: rows[name]["programs"]["default"]["processor_seconds"] for name in (WIDE, NARROW, LONG, SHORT)}
    start = rows[FIXED]["programs"]["maps"]["processor_seconds"]
    together = max(default["together_mb"], maps["together_mb"])
    return [
        Mark("350 recordings, maps: scipy's processor seconds over its", plain / maps["processor_seconds"], least=3.5),
        Mark("the same, default", plain / default["processor_seconds"], least=1.6),
        Mark("the same, memory of all processes", together, most=800.0, unit="MB"),
        Mark(
            "default of 24 channels over 3, without the cost of a start (maps of two recordings)",
            (own[WIDE] - start) / (own[NARROW] - start),
            most=9.0,
        ),
        Mark("run-up of 600 s over 60 s, processor", own[LONG] / own[SHORT], most=7.0),
        Mark(
            "run-up of 600 s, memory of all processes",
            rows[LONG]["programs"]["default"]["together_mb"],
            most=700.0,
            unit="MB",
        ),
        Mark(
            "10,000 recordings, memory of any process",
            rows[SMALL]["programs"]["default"]["largest_mb"],
            most=1000.0,
            unit="MB",
        ),
    ]


def over(rows: dict[str, Any], name: str, peer: str = SCIPY, *, key: str = "processor_seconds") -> float:
    """Seconds of ``peer`` over those of the row ``name``."""
    return float(rows[peer][key] / rows[name][key])


def marks_table(marks: list[Mark]) -> str:
    """Markdown: each mark, the number reached, the limit, and whether it holds."""
    return table(["mark", "reached", "must", ""], [mark.row for mark in marks])
