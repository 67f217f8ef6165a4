"""The teeth of a wheel as they stand on an even grid, and what follows from their being uneven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crankorder.shaft.pattern import ToothPattern, grid_of, known_names, pattern_of
from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.repair import IntArray

# A gap that is longer than a tooth by less than this share of what is missing there is none.
ABSENT_SHARE = 0.25
# A tooth beside a gap that sits this share of a tooth off the line of its neighbours says nothing of the angle.
DISPLACED_SHARE = 0.05
# … where the others stand that many times better: teeth that all sit wrongly say as much there as elsewhere.
DISPLACED_RATIO = 4.0


@dataclass(frozen=True)
class Wheel:
    """Teeth as they stand on an even grid: steps of the grid per revolution, step and offset of each tooth."""

    grid: int
    places: IntArray
    offsets: FloatArray
    repeats: int
    name: str

    @property
    def even(self) -> bool:
        """Whether all teeth are alike."""
        return self.places.size == self.grid and not self.offsets.any()

    @property
    def mostly_even(self) -> bool:
        """Whether it has many teeth, all of an even wheel but for some gaps: then most intervals are alike."""
        return self.places.size >= 8 and float(np.median(self.spans)) == 1.0 and not self.offsets.any()

    @property
    def spans(self) -> IntArray:
        """Steps from each tooth to the next."""
        return np.diff(self.places, append=self.grid)


def wheel_of(pulses_per_rev: int, missing_teeth: int, tooth_angles_deg: Sequence[float] | None) -> Wheel:
    """The wheel of ``pulses_per_rev`` even teeth less ``missing_teeth``, or the one of ``tooth_angles_deg``."""
    if tooth_angles_deg is None:
        name = f"{pulses_per_rev}-{missing_teeth}" if missing_teeth else f"{pulses_per_rev}"
        return Wheel(pulses_per_rev, np.arange(pulses_per_rev - missing_teeth), np.zeros(1), 1, name)
    grid, places, offsets = grid_of(tooth_angles_deg)
    pattern = ToothPattern("measured", tuple(tooth_angles_deg))
    if pattern.even is not None:
        return wheel_of(*pattern.even, None)
    name = next((name for name in known_names() if pattern_of(name).angles_deg == pattern.angles_deg), pattern.name)
    return Wheel(grid, np.array(places), np.array(offsets), pattern.repeats, name)


def gap_is_absent(time_s: FloatArray, kept: IntArray, tooth: IntArray, wheel: Wheel) -> bool:
    """Whether the longest interval in a gap of the wheel is mostly no longer than a tooth.

    ``time_s``: (pulses,), s. ``kept``: which of them are true. ``tooth``: their numbers on the grid of ``wheel``.
    """
    number, span = np.searchsorted(wheel.places, tooth % wheel.grid), wheel.spans
    gaps = 2 + np.flatnonzero((span[number[2:-3]] > 1) & (np.diff(tooth)[2:-2] == span[number[2:-3]]))
    if gaps.size < 3 or span.min() > 1:
        return False
    longest = np.maximum.reduceat(np.diff(time_s), kept[:-1])[gaps]
    tooth_s = np.diff(time_s[kept]) / span[number[:-1]]
    length = longest / (0.5 * (tooth_s[gaps - 2] + tooth_s[gaps + 2]))
    return bool(np.median((length - 1.0) / (span[number[gaps]] - 1)) < ABSENT_SHARE)


def displaced_teeth(time_s: FloatArray, tooth: IntArray, wheel: Wheel, flags: list[Remark]) -> npt.NDArray[np.bool_]:
    """Which pulses are of a tooth beside a gap that stands off the line of the next three (a pickup bends there).

    ``time_s``: (pulses,), s. ``tooth``: (pulses,), their numbers on the grid of ``wheel``. ``flags``: takes the remark.
    """
    displaced = np.zeros(tooth.size, dtype=np.bool_)
    spans = wheel.spans
    if not wheel.mostly_even or spans.max() == 1:
        return displaced
    off, place = {}, tooth % wheel.grid
    least = max(DISPLACED_SHARE, DISPLACED_RATIO * _usual_off(time_s, tooth, wheel))
    for number in range(spans.size):
        ahead = spans.take(range(number, number + 3), mode="wrap")
        behind = spans.take(range(number - 4, number), mode="wrap")
        if behind[-1] > 1 and (ahead == 1).all():
            way = 1
        elif ahead[0] > 1 and (behind[1:] == 1).all():
            way = -1
        else:
            continue
        at = own = np.flatnonzero(place == wheel.places[number])
        at = at[(at + 3 * way >= 0) & (at + 3 * way < tooth.size)]
        at = at[tooth[at + 3 * way] == tooth[at] + 3 * way]
        if at.size == 0:
            continue
        near, next_near, far = (time_s[at + k * way] for k in (1, 2, 3))
        off[number] = float(np.median((time_s[at] - 3.0 * near + 3.0 * next_near - far) / np.abs(next_near - near)))
        if abs(off[number]) > least:
            displaced[own] = True
    if displaced.any():
        detail = ", ".join(f"tooth {number + 1} by {share:+.2f} tooth" for number, share in off.items())
        flags.append(("encoder_teeth_displaced", "info", f"edges beside the gap are displaced and left out: {detail}"))
    return displaced


def _usual_off(time_s: FloatArray, tooth: IntArray, wheel: Wheel) -> float:
    """How far [tooth] the teeth away from gaps usually stand off the line of the next three."""
    off = np.diff(time_s, n=3) / np.maximum(time_s[3:] - time_s[:-3], np.finfo(np.float64).tiny) * 3.0
    together, place = tooth[3:] - tooth[:-3] == 3, tooth[:-3] % wheel.grid
    # the outermost teeth of every row are those in question
    first, last = (wheel.places[np.roll(wheel.spans, shift) > 1] for shift in (1, 0))
    asked = np.concatenate([first, (last - 3) % wheel.grid])
    usual = [np.median(off[together & (place == at)]) for at in np.setdiff1d(place[together], asked)]
    return float(np.median(np.abs(usual))) if usual else 0.0


def times_on_grid(time_s: FloatArray, tooth: IntArray, wheel: Wheel) -> FloatArray:
    """Times at which the even teeth would pass, by the cubic through the four nearest true ones.

    ``time_s``: (pulses,), s. ``tooth``: (pulses,), their numbers on the grid of ``wheel``.
    """
    if tooth.size < 4 or not wheel.offsets.any():
        return time_s
    offset = np.zeros(wheel.grid)
    offset[wheel.places] = wheel.offsets
    angle = tooth + offset[tooth % wheel.grid]
    first = np.clip(np.arange(angle.size) - 1, 0, angle.size - 4)
    moved = np.zeros(angle.size)
    for k in range(4):
        weight = np.ones(angle.size)
        for other in range(4):
            if other != k:
                weight *= (tooth - angle[first + other]) / (angle[first + k] - angle[first + other])
        moved += weight * time_s[first + k]
    return moved
