"""Which stated parts have a line at an order: the one rule by which gears, blades and bearings name lines."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from crankorder.identify.found import AgreedOrder
from crankorder.identify.intervals import half_width
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="stated_parts"):
    most_harmonics: int
    same_sigmas: float
    by_chance_share: float


NUMBERS = _Numbers.load()


@dataclass(frozen=True)
class StatedPart:
    """A part that makes lines at the multiples of ``order``, which is known within ``order_half`` (95 %).

    ``kind`` and ``name``: "gear mesh" and "pinion"; ``shaft_order``: how often its shaft turns; ``most``: its highest
    multiple; ``elements``: what else with so many teeth may make a line that keeps step, None where nothing else.
    """

    kind: str
    name: str
    order: float
    order_half: float = 0.0
    shaft_order: float = 1.0
    most: int = NUMBERS.most_harmonics
    elements: int | None = None


@dataclass(frozen=True)
class PartsAt:
    """Parts at an order: ``near`` with the multiple that is there, nearest first; ``unparted``: see parts_at."""

    near: tuple[tuple[StatedPart, int], ...]
    unparted: tuple[StatedPart, ...]

    @property
    def words(self) -> str:
        """What the line is called: "gear mesh pinion, harmonic 2 or wheel"."""
        by_kind: dict[str, list[str]] = {}
        for part, multiple in self.near:
            words = part.name + (f", harmonic {multiple}" if multiple > 1 else "")
            by_kind.setdefault(part.kind, []).append(words)
        return " or ".join(f"{kind} {' or '.join(dict.fromkeys(names))}" for kind, names in by_kind.items())


def parts_at(parts: Iterable[StatedPart], agreed: AgreedOrder) -> PartsAt:
    """The ``parts`` of which a multiple lies where the order ``agreed`` does, within the intervals of both.

    A part names a line only where few lines that lie anywhere would hit one of its multiples as closely: where these
    lie closer together than the intervals tell apart it is one of ``unparted``.
    """
    own = max(NUMBERS.same_sigmas, half_width(agreed.degrees_of_freedom)) * agreed.order_error
    near: list[tuple[float, int, StatedPart, int]] = []
    unparted = []
    for part in parts:
        multiple = max(1, round(agreed.order / part.order))
        reach = math.hypot(multiple * part.order_half, own) + 1e-9 * agreed.order
        away = abs(agreed.order - multiple * part.order)
        if multiple > part.most or away > reach:
            continue
        if 2.0 * reach > NUMBERS.by_chance_share * part.order:
            unparted.append(part)
        else:
            near.append((away, len(near), part, multiple))
    return PartsAt(tuple((part, multiple) for *_, part, multiple in sorted(near)), tuple(unparted))
