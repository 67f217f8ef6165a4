"""Where the lines of rolling bearings are looked for: their orders in pure rolling and the slip that is allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crankorder.engine.machine_parts import Bearing, bearing_orders
from crankorder.orders.envelope_combs import Comb
from crankorder.quantities import Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-bearings.toml", "places")

SHOWN_AT = {"BSF": 2.0}
"""Multiple of a line at which its damage shows, where not once: a rolling element strikes both races in a turn."""


@dataclass(frozen=True)
class Place:
    """One line of one bearing: its order in pure rolling as it shows, and from which to which order it is looked for.

    ``shaft_order`` and ``cage_order`` (None where the cage's is not known) are what its sidebands are apart by.
    """

    name: str
    line: str
    expected: float
    low: float
    high: float
    elements: int | None
    shaft_order: float
    cage_order: float | None

    @property
    def title(self) -> str:
        """What the line is called in a sentence: "2 x BSF" where the damage shows at twice the line."""
        times = SHOWN_AT.get(self.line, 1.0)
        return self.line if times == 1.0 else f"{times:g} x {self.line}"

    def slip_percent(self, order: float) -> float:
        """How much slower than in pure rolling ``order`` is, in percent."""
        return 100.0 * (1.0 - order / self.expected)

    def cage_at(self, order: Floats) -> Floats | None:
        """Order of the cage where the line is at ``order``; None where the bearing's data do not tell.

        The outer race is struck as often as elements pass, the inner one and an element as often as the shaft turns
        against the cage.
        """
        if self.line == "FTF":
            return order
        if self.cage_order is None:
            return None
        if self.line == "BPFO":
            return np.asarray(self.cage_order * order / self.expected)
        return np.asarray(self.shaft_order - (self.shaft_order - self.cage_order) * order / self.expected)

    @property
    def comb(self) -> Comb:
        """The train of strikes that damage at this place makes."""
        return Comb(self.low, self.high, self.spacing or 0.0)

    @property
    def spacing(self) -> float | None:
        """How far apart in orders the sidebands are that damage at this place makes by coming and going with the load.

        Source: P. D. McFadden and J. D. Smith (1984), Journal of Sound and Vibration 96, p. 69.
        """
        return {"BPFI": self.shaft_order, "BSF": self.cage_order}.get(self.line)


def bearing_places(bearings: tuple[Bearing, ...], *, slip_percent: tuple[float, float]) -> list[Place]:
    """Every line of ``bearings`` that their data tell, from the least to the most slip of ``slip_percent``."""
    made = []
    least, most = slip_percent
    for bearing in bearings:
        orders = bearing_orders(bearing)
        for line, order in orders.items():
            expected = order * SHOWN_AT.get(line, 1.0)
            made.append(
                Place(
                    name=bearing.name,
                    line=line,
                    expected=expected,
                    low=expected * (1.0 - most / 100.0),
                    high=expected * (1.0 - least / 100.0),
                    elements=bearing.rolling_elements or round(orders["N*fs"] / bearing.shaft_ratio)
                    if "N*fs" in orders
                    else None,
                    shaft_order=bearing.shaft_ratio,
                    cage_order=orders.get("FTF"),
                )
            )
    return made


def bearing_combs(bearings: tuple[Bearing, ...], *, slip_percent: tuple[float, float]) -> tuple[Comb, ...]:
    """Trains of strikes of ``bearings``, each once, at any slip of ``slip_percent``; N*fs keeps step and is none."""
    places = bearing_places(bearings, slip_percent=slip_percent)
    return tuple(dict.fromkeys(place.comb for place in places if place.line != "N*fs"))


def made_by(order: float, stronger: Place, stronger_order: float, *, within: float) -> str:
    """How the line ``stronger`` (found at ``stronger_order``) makes one at ``order`` too; empty where it does not.

    Its multiples and their sidebands by turns of the shaft and of the cage come as near as ``within``: "2 x BPFO - 1 x
    shaft". A modulated train of strikes has all of them.
    """
    cages = (0,) if stronger.cage_order is None else (0, -1, 1)
    for times in range(1, NUMBERS.multiples + 1):
        for turns in sorted(range(-NUMBERS.sideband_turns, NUMBERS.sideband_turns + 1), key=abs):
            for cage in cages:
                if turns and cage:
                    continue
                at = times * stronger_order + turns * stronger.shaft_order + cage * (stronger.cage_order or 0.0)
                if abs(at - order) <= within:
                    shown = times * SHOWN_AT.get(stronger.line, 1.0)
                    parts = [f"{shown:g} x {stronger.line}" if shown > 1.0 else stronger.line]
                    parts += [_turns(turns, "shaft")] if turns else []
                    parts += [_turns(cage, "cage")] if cage else []
                    return " ".join(parts)
    return ""


def _turns(count: int, of: str) -> str:
    return f"{'+' if count > 0 else '-'} {abs(count)} x {of}"
