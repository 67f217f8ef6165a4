"""Harmonics of a struck race and their sidebands: lines of the vibration that go with a bearing's damage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crankorder.findings import BearingFinding
from crankorder.identify.intervals import Z95
from crankorder.identify.sources import Sources

MOST_HARMONICS, MOST_TURNS = 10, 4
"""Harmonics of a race that are followed, and turns of the shaft to each side of one."""

SIGMAS = 3.0
"""Standard errors within which a line is where the race puts it."""

LEAST_ERROR, MOST_ERROR = 5e-4, 4e-3
"""Standard error in orders that a place has at least, for strikes wander, and beyond which a line is not looked for."""

SURE_ERROR, SURE_HARMONICS, SURE_TURNS = 2e-3, 5, 2
"""Where a place is known no better than that, only so many harmonics and turns: more would lie anywhere."""

STATED_ERROR = 1e-3
"""Standard error of a stated order of the shaft, as a share, before the lines themselves tell it."""

ANCHORS = 4
"""Lines of the lowest harmonics and fewest turns by which the order of the race and the shaft's are made finer."""

STRUCK = ("BPFO", "BPFI", "BSF")


@dataclass(frozen=True)
class StruckRace:
    """Lines at whole multiples of ``order`` and whole multiples of the ``shaft``'s order beside: with errors."""

    name: str
    title: str
    order: float
    order_error: float
    shaft: float
    shaft_error: float

    def nearest(self, order: float, error: float) -> tuple[int, int, float] | None:
        """Harmonic and turns of the shaft at ``order`` and how far that is; None where, with its ``error``, none is."""
        best = None
        for harmonic in range(1, MOST_HARMONICS + 1):
            turns = round((order - harmonic * self.order) / self.shaft)
            own = math.hypot(harmonic * self.order_error, turns * self.shaft_error)
            known = max(math.hypot(own, error), LEAST_ERROR)
            few = harmonic <= SURE_HARMONICS and abs(turns) <= SURE_TURNS
            if abs(turns) > MOST_TURNS or (known > SURE_ERROR and not few):
                continue
            away = abs(order - harmonic * self.order - turns * self.shaft)
            near = away <= SIGMAS * min(known, MOST_ERROR)
            if near and (best is None or harmonic + abs(turns) < best[0] + abs(best[1])):
                best = harmonic, turns, away
        return best

    def words(self, harmonic: int, turns: int) -> str:
        """What the line of that ``harmonic``, so many ``turns`` of the shaft beside, is called."""
        text = f"bearing {self.name} {self.title}" + (f", harmonic {harmonic}" if harmonic > 1 else "")
        return text + (f" {'+' if turns > 0 else '-'} {abs(turns)} x shaft" if turns else "")


def struck_races(
    bearings: Sequence[BearingFinding], sources: Sources, lines: Sequence[tuple[float, float]]
) -> list[StruckRace]:
    """Races and rolling elements that ``bearings`` (their findings) show, as fine as ``lines`` (order, error) tell.

    The line of the vibration is the finer one; the shaft's own order is what the record of the envelope read from the
    sidebands, or the one that ``sources`` state.
    """
    made: dict[tuple[str, str], StruckRace] = {}
    ratio = {bearing.name: bearing.shaft_ratio for bearing in sources.bearings}
    for record in sorted(bearings, key=lambda one: one.seen_in != "envelope"):
        key = record.name, record.line
        if record.line not in STRUCK or record.lock == "locked":
            continue
        error = record.order_half / Z95
        old, shaft = made.get(key), record.shaft_order
        if old is None:
            title = "2 x BSF" if record.line == "BSF" else record.line
            stated = float(ratio.get(record.name, 1.0))
            made[key] = StruckRace(key[0], title, record.order, error, shaft or stated, STATED_ERROR * stated)
        elif error < old.order_error and abs(record.order - old.order) <= SIGMAS * math.hypot(error, old.order_error):
            made[key] = replace(old, order=record.order, order_error=error)
    return [_refined(race, lines) for race in made.values()]


def harmonic_words(races: Sequence[StruckRace], order: float, error: float, *, few: bool = False) -> str:
    """What a line at ``order`` with its standard ``error`` is called by the ``races`` that put one there; empty: none.

    ``few``: only of the lowest harmonics and turns, where something else is as likely.
    """
    told = []
    for race in races:
        found = race.nearest(order, error)
        if found is not None and not (few and (found[0] > SURE_HARMONICS or abs(found[1]) > SURE_TURNS)):
            told.append((found[0] + abs(found[1]), race.words(found[0], found[1])))
    return min(told)[1] if told else ""


def _refined(race: StruckRace, lines: Sequence[tuple[float, float]]) -> StruckRace:
    """``race`` with its order and that of the shaft fitted to the lines of ``lines`` that are surely its own."""
    hits = [
        (harmonic, turns, order, max(error, LEAST_ERROR))
        for order, error in lines
        if (found := race.nearest(order, error)) is not None
        for harmonic, turns, _ in [found]
    ]
    hits.sort(key=lambda hit: hit[0] + abs(hit[1]))
    hits = hits[:ANCHORS]
    if len(hits) < ANCHORS:
        return race
    harmonic, turns, order, error = (np.array(column, dtype=float) for column in zip(*hits, strict=True))
    design = np.column_stack([harmonic, turns]) / error[:, None]
    if np.linalg.matrix_rank(design) < 2:
        return race
    inverse = np.linalg.inv(design.T @ design)
    fitted = inverse @ design.T @ (order / error)
    return replace(
        race,
        order=float(fitted[0]),
        order_error=math.sqrt(inverse[0, 0]),
        shaft=float(fitted[1]),
        shaft_error=math.sqrt(inverse[1, 1]),
    )
