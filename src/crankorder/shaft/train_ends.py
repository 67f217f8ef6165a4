"""The ends of a pulse train on an uneven wheel, where no second gap tells whether the count is right.

Before the first gap and behind the last one a lost or a false pulse looks, to a way through the whole train, like a
short change of speed by as much. Where the speed is steady otherwise, it was none: the count is put right there.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.repair import CLEAN_CHANGE, REPAIR_COST, FollowedWheel, IntArray, followed_wheel
from crankorder.shaft.uneven import Wheel

# An interval is compared with the median of so many on each side.
BESIDE = 3
# It hides a lost pulse where its speed is off by so many times what is usual in the train, and by this at least.
UNUSUAL_TIMES, LEAST_CHANGE = 5.0, 0.15
# The ends are looked at for so many turns of the wheel.
END_REVS = 3
# What it holds is a whole number of teeth within this.
WHOLE_TEETH = 0.3
# A train begins where an interval and all but one of so many that follow are alike, within this change of the
# logarithm; at the latest after so many intervals.
LIKE_NEXT, LIKE_CHANGE, LATEST_START = 6, 0.2, 3
# A train is followed from there only where that costs less by this.
CLEARLY_CHEAPER = 0.5


def followed_from_steady(time_s: FloatArray, wheel: Wheel) -> tuple[FollowedWheel, IntArray, IntArray]:
    """The uneven ``wheel`` laid on the train of pulses, the pulses that were kept, and their numbers on its grid.

    The first interval sets the speed by which all others are judged. Where it hides a lost pulse, it is a bad start:
    then the train is followed from the first steady pulse too, and the pulses before are counted back from there. So is
    one that starts from rest, whose first intervals shrink too fast to follow, from where they shrink gently. The way
    that costs less is taken. ``time_s``: (pulses,), s.
    """
    ways = []
    for first in {0, *((_first_steady(time_s), _first_gentle(time_s)) if wheel.mostly_even else ())}:
        followed = followed_wheel(time_s[first:], (wheel.places + wheel.offsets) / wheel.grid, repeats=wheel.repeats)
        turn, place = np.divmod(followed.count, wheel.places.size)
        kept, tooth = followed.kept + first, turn * wheel.grid + wheel.places[place]
        cost = followed.misfit * kept.size
        if first:
            kept, tooth = _with_first_pulses(time_s, first, kept, tooth, wheel)
            head = tooth[: np.searchsorted(kept, first) + 1]
            n_lost = np.count_nonzero(np.isin(np.arange(head[0], head[-1]) % wheel.grid, wheel.places)) - head.size + 1
            cost += REPAIR_COST * (n_lost + first + 1 - head.size) + CLEARLY_CHEAPER
        ways.append((cost, first, followed, kept, tooth))
    return min(ways, key=lambda way: way[:2])[2:]


def _first_steady(time_s: FloatArray) -> int:
    """Number of the first pulse from which nearly all intervals are alike for a while; 0 where none is near."""
    step = np.diff(time_s[: LATEST_START + LIKE_NEXT + 2])
    for start in range(min(LATEST_START + 1, step.size - LIKE_NEXT)):
        near = step[start : start + 1 + LIKE_NEXT]
        like = np.abs(near - np.median(near)) < LIKE_CHANGE * np.median(near)
        if like[0] and like.sum() >= LIKE_NEXT:
            return start
    return 0


def _first_gentle(time_s: FloatArray) -> int:
    """Number of the first pulse from which a few intervals change gently from one to the next; 0 where none is near."""
    step = np.maximum(np.diff(time_s[: LATEST_START + LIKE_NEXT + 2]), 1e-12)
    gentle = np.abs(np.diff(np.log(step))) < CLEAN_CHANGE
    for start in range(min(LATEST_START + 1, gentle.size - BESIDE + 1)):
        if gentle[start : start + BESIDE].all():
            return start
    return 0


def _with_first_pulses(
    time_s: FloatArray, first: int, kept: IntArray, tooth: IntArray, wheel: Wheel
) -> tuple[IntArray, IntArray]:
    """``kept`` and ``tooth`` with those of the ``first`` pulses that stand on a tooth, counted back."""
    at, number = int(kept[0]), int(tooth[0])
    step_s = float(np.median(np.diff(time_s[kept[: LIKE_NEXT + 1]]) / np.diff(tooth[: LIKE_NEXT + 1])))
    places = set(wheel.places.tolist())
    for pulse in range(first - 1, -1, -1):
        teeth = (time_s[at] - time_s[pulse]) / step_s
        whole = round(teeth)
        if whole >= 1 and abs(teeth - whole) < WHOLE_TEETH and (number - whole) % wheel.grid in places:
            at, number = pulse, number - whole
            kept, tooth = np.append(at, kept), np.append(number, tooth)
    return kept, tooth


def ends_put_right(time_s: FloatArray, kept: IntArray, tooth: IntArray, wheel: Wheel) -> tuple[IntArray, IntArray]:
    """Pulses that are kept and their numbers, put right before the first gap and behind the last one.

    ``time_s``: (pulses,), s. ``kept``: which of them are true. ``tooth``: (kept,), their numbers on the grid of
    ``wheel``, growing.
    """
    true_s = time_s[kept]
    if not wheel.mostly_even or tooth.size < 2 * BESIDE + 2 or not (np.diff(true_s) > 0.0).all():
        return kept, tooth
    for first in (True, False):
        true, right = _put_right(true_s, tooth, wheel, first=first)
        if np.isin(right[true] % wheel.grid, wheel.places).all() and (np.diff(right[true]) > 0).all():
            return kept[true], right[true]
    return kept, tooth


def _put_right(
    true_s: FloatArray, tooth: IntArray, wheel: Wheel, *, first: bool
) -> tuple[npt.NDArray[np.bool_], IntArray]:
    """Which pulses are true, and the numbers of all; ``first``: of two neighbours that may be false, the first is."""
    end = min(tooth.size, END_REVS * wheel.places.size)
    right, true = tooth.copy(), np.ones(tooth.size, dtype=np.bool_)
    more, false, gaps = _miscounted(true_s[:end], tooth[:end], wheel, first=first)
    if gaps.size:
        right[: end - 1] -= np.cumsum(np.where(np.arange(end - 1) <= gaps[0], more, 0)[::-1])[::-1]
        true[false[false <= gaps[0]]] = False
    more, false, gaps = _miscounted(true_s[-end:], tooth[-end:], wheel, first=first)
    if gaps.size:
        right[tooth.size - end + 1 :] += np.cumsum(np.where(np.arange(end - 1) >= gaps[-1], more, 0))
        true[tooth.size - end + false[false > gaps[-1]]] = False
    return true, right


def _miscounted(
    time_s: FloatArray, tooth: IntArray, wheel: Wheel, *, first: bool
) -> tuple[IntArray, IntArray, IntArray]:
    """Teeth (intervals,) that each interval holds beyond those counted, false pulses, and which intervals are gaps.

    What a false pulse (by its number) has split counts for the interval behind it.
    """
    counted = np.diff(tooth)
    slow = np.log(np.diff(time_s) / counted)
    padded = np.pad(slow, BESIDE, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1)
    change = slow - np.nanmedian(np.delete(windows, BESIDE, axis=1), axis=1)
    held = counted * np.exp(change)
    unusual = np.abs(change) > max(LEAST_CHANGE, UNUSUAL_TIMES * float(np.quantile(np.abs(change), 0.9)))
    whole = np.round(held).astype(np.int64)
    more = np.where(unusual & (whole > counted) & (np.abs(held - whole) < WHOLE_TEETH), whole - counted, 0)
    both, both_counted = held[:-1] + held[1:], counted[:-1] + counted[1:]
    whole = np.round(both).astype(np.int64)
    split = (unusual[:-1] | unusual[1:]) & (whole >= 1) & (whole < both_counted) & (np.abs(both - whole) < WHOLE_TEETH)
    false = 1 + np.flatnonzero(split)
    false = false[np.diff(false, prepend=-1) > 1 if first else np.diff(false, append=tooth.size + 1) > 1]
    more[false - 1], more[false] = 0, (whole - both_counted)[false - 1]
    usual = wheel.spans[np.searchsorted(wheel.places, tooth[:-1] % wheel.grid)]
    return more, false, np.flatnonzero((counted == usual) & (counted > 1) & ~unusual)
