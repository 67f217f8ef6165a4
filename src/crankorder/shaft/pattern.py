"""Toothed wheels by name and by the angles of their teeth; imports nothing heavy, for a manifest is checked with it.

Angles are those of the pulses of one encoder revolution, from tooth 1 at 0 degrees. Source of the wheels that carry a
name of the trade: the trigger definitions of rusEFI (github.com/rusefi/rusefi, firmware/controllers/trigger/decoders:
trigger_mitsubishi, trigger_subaru, trigger_nissan, trigger_rover, trigger_renix, trigger_honda, trigger_gm,
trigger_mazda), of which only the angles are taken. The 4B11, GM 24x and Miata wheels agree with measured traces.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import NamedTuple

from crankorder.errors import RequestError

# A list of angles lies on an even grid of teeth where none is off it by more than rounding.
GRID_TOLERANCE_DEG = 0.002
# Pulses nearer to each other than this are no two teeth.
NEAREST_TEETH_DEG = 0.1
# Finest even grid that is looked for: half a degree.
FINEST_GRID = 720

# Wheels with several gaps: teeth in a row, missing teeth, teeth in a row, … around the wheel; tooth 1 starts the list.
_GAPPED: dict[str, tuple[int, ...]] = {
    "36-2-1": (17, 1, 16, 2),  # Mitsubishi 4B11; tooth 1 follows the double gap
    "36-2-2": (10, 2, 22, 2),  # Nissan HR
    "36-2-2-2": (13, 2, 16, 2, 1, 2),  # Subaru H4, Nissan, Mazda
    "36-2-2-2-ez30": (19, 2, 10, 2, 1, 2),  # Subaru H6
    "36-1-1-1-1": (13, 1, 2, 1, 14, 1, 3, 1),  # Rover K
    "44-2-2": (20, 2, 20, 2),  # Renix, four cylinders; the same after each half turn
    "66-2-2-2": (20, 2, 20, 2, 20, 2),  # Renix, six cylinders; the same after each third
}
# Which of the 24 rising edges of the GM 24x wheel come early after their (even) falling edge, first edge first.
_GM_EARLY = tuple(0x0A33BE >> k & 1 for k in range(24))


def _gm_24x(early_deg: float) -> tuple[float, ...]:
    rise = [15.0 * k + (early_deg if early else 15.0 - early_deg) for k, early in enumerate(_GM_EARLY)]
    return tuple(angle - rise[0] for angle in rise)


_ANGLES_DEG: dict[str, tuple[float, ...]] = {
    "12+1": (0.0, 10.0, *(30.0 * k for k in range(1, 12))),  # Honda K: an extra tooth a third of the way to tooth 2
    "gm-24x": _gm_24x(5.0),  # rising edges; the falling ones are 24 even teeth. Tooth 1 is 10 degrees after TDC 1
    "gm-24x-3": _gm_24x(3.0),  # the same code with edges 3 and 12 degrees late
    "gm-7x": (0.0, 60.0, 120.0, 180.0, 240.0, 300.0, 350.0),
    "miata-nb": (0.0, 70.0, 180.0, 250.0),  # the same after each half turn
    "subaru-6": (0.0, 32.0, 87.0, 180.0, 212.0, 267.0),  # crank of the 7/6 pair; the same after each half turn
}
_EVEN = re.compile(r"(\d{1,6})(?:-(\d{1,6}))?")


class ToothPattern(NamedTuple):
    """Teeth of one encoder revolution: their angles [deg] from tooth 1, by the name of the wheel."""

    name: str
    angles_deg: tuple[float, ...]

    @property
    def even(self) -> tuple[int, int] | None:
        """Teeth of the full wheel and teeth missing in one gap behind the last tooth; None for any other wheel."""
        grid, places, offsets = grid_of(self.angles_deg)
        if any(offsets) or places != tuple(range(len(places))):
            return None
        return grid, grid - len(places)

    @property
    def repeats(self) -> int:
        """How often per revolution the wheel looks the same: only for 1 does it tell the angle by itself."""
        grid, places, offsets = grid_of(self.angles_deg)
        if any(offsets):
            return 1
        for count in range(len(places), 1, -1):
            step = grid // count
            if grid % count == 0 and {(place + step) % grid for place in places} == set(places):
                return count
        return 1


def known_names() -> list[str]:
    """Names of the wheels of the table, beside which any N-k and any even N is known."""
    return sorted([*_GAPPED, *_ANGLES_DEG])


def pattern_of(name: str) -> ToothPattern:
    """The wheel called ``name``: one of :func:`known_names`, ``"60-2"`` (any N-k with one gap) or ``"60"`` (even).

    Raises RequestError for an unknown name, with the nearest known one.
    """
    key = name.strip().casefold().replace("−", "-").replace("–", "-")
    if key in _GAPPED:
        return ToothPattern(key, _of_runs(_GAPPED[key]))
    if key in _ANGLES_DEG:
        return ToothPattern(key, _ANGLES_DEG[key])
    match = _EVEN.fullmatch(key)
    if match is not None and 0 <= int(match[2] or 0) < int(match[1]) <= 100_000:
        teeth, missing = int(match[1]), int(match[2] or 0)
        return ToothPattern(key, tuple(360.0 * k / teeth for k in range(teeth - missing)))
    close, allowed = difflib.get_close_matches(key, known_names(), n=1), ", ".join(["N", "N-k", *known_names()])
    remedy = f"Did you mean {close[0]!r}?" if close else "State tooth_angles_deg, the angle of each pulse"
    raise RequestError("unknown wheel", place="encoder.pattern", found=repr(name), allowed=allowed, remedy=remedy)


def _of_runs(runs: Sequence[int]) -> tuple[float, ...]:
    total, starts = sum(runs), [0, *accumulate(runs)]
    places = [start + k for start, count in list(zip(starts, runs, strict=False))[::2] for k in range(count)]
    return tuple(360.0 * place / total for place in places)


def angles_fault(angles_deg: Sequence[float]) -> str:
    """Fault of the tooth angles ``angles_deg`` (teeth,) [deg] of one revolution in words, or an empty text."""
    if len(angles_deg) < 1 or angles_deg[0] != 0.0:
        return "tooth angles start at 0, tooth 1"
    if not angles_deg[-1] < 360.0:
        return "tooth angles end below 360, where tooth 1 comes again"
    if any(not later >= earlier + NEAREST_TEETH_DEG for earlier, later in pairwise([*angles_deg, 360.0])):
        return f"tooth angles must rise, by {NEAREST_TEETH_DEG:g} degrees or more"
    return ""


def grid_of(angles_deg: Sequence[float]) -> tuple[int, tuple[int, ...], tuple[float, ...]]:
    """Even grid for teeth at ``angles_deg`` (teeth,) [deg]: its steps per revolution, step and offset of each tooth.

    Offsets are in steps and all 0 where the angles lie on a grid of FINEST_GRID steps or fewer; else the teeth of a
    hand-made wheel take the nearest steps of the grid that fits them best, one tooth to a step.
    """
    best: tuple[float, int, tuple[int, ...], tuple[float, ...]] | None = None
    for grid in range(len(angles_deg), max(FINEST_GRID, len(angles_deg)) + 1):
        exact = [angle * grid / 360.0 for angle in angles_deg]
        places = tuple(round(value) for value in exact)
        if len(set(places)) < len(places) or places[-1] >= grid:
            continue
        offsets = tuple(value - place for value, place in zip(exact, places, strict=True))
        worst = max(map(abs, offsets))
        if worst * 360.0 <= GRID_TOLERANCE_DEG * grid:
            return grid, places, (0.0,) * len(places)
        if grid <= 4 * len(angles_deg) and (best is None or worst < best[0]):
            best = worst, grid, places, offsets
    if best is None:  # two teeth nearer to each other than a quarter of the mean distance
        nearest = min(later - earlier for earlier, later in pairwise([*angles_deg, 360.0]))
        grid = math.ceil(360.0 / nearest)
        exact = [angle * grid / 360.0 for angle in angles_deg]
        places = tuple(math.floor(value) for value in exact)
        return grid, places, tuple(value - place for value, place in zip(exact, places, strict=True))
    return best[1], best[2], best[3]
