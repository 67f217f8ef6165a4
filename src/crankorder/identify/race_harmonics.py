"""Harmonics of a struck race and their sidebands: lines of the vibration that go with a bearing's damage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crankorder.findings import BearingFinding
from crankorder.identify.intervals import Z95
from crankorder.identify.sources import Sources
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="race_harmonics"):
    most_harmonics: int
    most_turns: int
    same_sigmas: float
    least_error: float
    most_error: float
    sure_error: float
    sure_harmonics: int
    sure_turns: int
    stated_error_share: float
    anchors: int


NUMBERS = _Numbers.load()

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
        for harmonic in range(1, NUMBERS.most_harmonics + 1):
            turns = round((order - harmonic * self.order) / self.shaft)
            own = math.hypot(harmonic * self.order_error, turns * self.shaft_error)
            known = max(math.hypot(own, error), NUMBERS.least_error * self.shaft)
            few = harmonic <= NUMBERS.sure_harmonics and abs(turns) <= NUMBERS.sure_turns
            if abs(turns) > NUMBERS.most_turns or (known > NUMBERS.sure_error * self.shaft and not few):
                continue
            away = abs(order - harmonic * self.order - turns * self.shaft)
            near = away <= NUMBERS.same_sigmas * min(known, NUMBERS.most_error * self.shaft)
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
            made[key] = StruckRace(
                key[0], title, record.order, error, shaft or stated, NUMBERS.stated_error_share * stated
            )
        elif error < old.order_error and abs(record.order - old.order) <= NUMBERS.same_sigmas * math.hypot(
            error, old.order_error
        ):
            made[key] = replace(old, order=record.order, order_error=error)
    return [_refined(race, lines) for race in made.values()]


def harmonic_words(races: Sequence[StruckRace], order: float, error: float, *, few: bool = False) -> str:
    """What a line at ``order`` with its standard ``error`` is called by the ``races`` that put one there; empty: none.

    ``few``: only of the lowest harmonics and turns, where something else is as likely.
    """
    told = []
    for race in races:
        found = race.nearest(order, error)
        if found is not None and not (
            few and (found[0] > NUMBERS.sure_harmonics or abs(found[1]) > NUMBERS.sure_turns)
        ):
            told.append((found[0] + abs(found[1]), race.words(found[0], found[1])))
    return min(told)[1] if told else ""


def _refined(race: StruckRace, lines: Sequence[tuple[float, float]]) -> StruckRace:
    """``race`` with its order and that of the shaft fitted to the lines of ``lines`` that are surely its own."""
    hits = [
        (harmonic, turns, order, max(error, NUMBERS.least_error * race.shaft))
        for order, error in lines
        if (found := race.nearest(order, error)) is not None
        for harmonic, turns, _ in [found]
    ]
    hits.sort(key=lambda hit: hit[0] + abs(hit[1]))
    hits = hits[: NUMBERS.anchors]
    if len(hits) < NUMBERS.anchors:
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
