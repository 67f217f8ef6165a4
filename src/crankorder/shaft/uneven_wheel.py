"""Uneven toothed wheels: found behind a train of pulses, laid on an even grid, and counted right at the train's ends.

A wheel whose teeth are uneven repeats its intervals with each revolution: the number of its teeth is the shortest
period of the intervals, each taken relative to its neighbours so that the speed does not matter. Its gaps are whole
multiples of the intervals beside them; other wheels are compared with those known by name. Even teeth look alike: their
number per revolution takes an index to tell.

Before the first gap and behind the last one a lost or a false pulse looks, to a way through the whole train, like a
short change of speed by as much. Where the speed is steady otherwise, it was none: the count is put right there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from crankorder.quantities import Bools, Floats, Ints
from crankorder.shaft.pattern import ToothPattern, grid_of, known_names, pattern_of
from crankorder.shaft.pulses import Remark
from crankorder.shaft.repair import REPAIR_COST, STANDSTILL_RPM, FollowedWheel, followed_wheel, running_parts

# Pulses that are looked at, where the train is fastest; most teeth that are looked for; fewest revolutions seen.
BLOCK_PULSES, MOST_TEETH, FEWEST_REVS = 3000, 400, 3
# Intervals repeat where they differ, in the square of their logarithm, by less than this share of chance.
REPEAT_SHARE = 0.35
# Teeth are uneven where an interval is this much longer or shorter than the usual one beside it.
UNEVEN_RATIO = 1.3
# A gap is a whole number of teeth within this; a wheel is one known by name within this scatter of its log intervals.
WHOLE_SHARE, NAMED_SCATTER = 0.4, 0.2
# Neighbours on each side that an interval is compared with; a wheel of so few teeth has none of its own to compare.
NEIGHBOURS, FEW_TEETH = 2, 6
# Scatter of the intervals below this share of their log is jitter where it hides the gaps.
JITTER = 0.35


class FoundPattern(NamedTuple):
    """The wheel that was found, over how many revolutions, and the share of these that show it without a fault.

    ``by_index`` says whether an index told the revolution; without it the wheel may show its pattern several times.
    """

    pattern: ToothPattern
    revs: int
    agreement: float
    by_index: bool

    @property
    def told(self) -> str:
        """The finding and its confidence in words."""
        teeth = len(self.pattern.angles_deg)
        seen = f"{self.pattern.name} ({teeth} pulses), seen in {self.agreement:.0%} of {self.revs} revolutions"
        return seen if self.by_index else f"{seen}, if it is not the same several times per revolution"


def find_pattern(time_s: Floats, *, index_time_s: Floats | None = None) -> FoundPattern | None:
    """The wheel that gives the pulses at ``time_s``, or None where they do not tell.

    Parameters
    ----------
    time_s : (pulses,), s, increasing
    index_time_s : (marks,), s, times of a once-per-revolution mark: the number of pulses between two marks is taken
    """
    if time_s.size < 3 or not np.all(np.diff(time_s) > 0.0):
        return None
    # the block of pulses with the shortest intervals: there the speed is steadiest
    starts = range(0, max(1, time_s.size - BLOCK_PULSES + 1), BLOCK_PULSES // 2)
    first = min(starts, key=lambda at: float(np.median(np.diff(time_s[at : at + BLOCK_PULSES]))))
    block = time_s[first : first + BLOCK_PULSES]
    between = np.empty(0, dtype=np.int64)
    if index_time_s is not None and index_time_s.size >= 3:
        marks = index_time_s[(index_time_s > time_s[0]) & (index_time_s < time_s[-1])]
        between = np.diff(np.searchsorted(time_s, marks))
    values, counts = np.unique(between, return_counts=True)
    per_index = int(values[np.argmax(counts)]) if counts.size and 2 * counts.max() > counts.sum() else 0
    teeth = _repeating(block)
    turns = teeth and float(np.ptp(block)) * STANDSTILL_RPM / 60.0 < (block.size - 1) / teeth
    pattern = _pattern(block, teeth) if turns else None
    if pattern is None:
        alike = float(np.mean(np.abs(between - per_index) <= 1)) if per_index else 0.0
        return FoundPattern(pattern_of(f"{per_index}"), between.size, alike, True) if per_index else None
    if per_index > teeth and per_index % teeth == 0:
        times = per_index // teeth
        angles = tuple((angle + 360.0 * turn) / times for turn in range(times) for angle in pattern.angles_deg)
        pattern = ToothPattern(f"{pattern.name}, {times} times", angles)
    places = np.array(pattern.angles_deg) / 360.0
    widest = float(np.diff(places, append=1.0).max() * places.size)
    (part, *_), _ = running_parts(time_s, pulses_per_rev=places.size, gap=widest)
    wheel = followed_wheel(time_s[part], places, repeats=pattern.repeats)
    turn = wheel.count // places.size
    holes = np.flatnonzero((np.diff(wheel.count) != 1) | (np.diff(wheel.kept) != 1))
    revs = int(turn[-1] - turn[0]) + 1
    agreement = 1.0 - np.unique(turn[holes]).size / revs
    by_index = per_index == places.size
    return FoundPattern(pattern, revs, agreement, by_index) if agreement >= 0.5 else None


def _repeating(time_s: Floats) -> int:
    """Shortest period, in pulses, of the intervals relative to their neighbours; 0 where there is none."""
    step = np.log(np.diff(time_s))
    if step.size < 2 * NEIGHBOURS + 4:
        return 0
    windows = np.lib.stride_tricks.sliding_window_view(step, 2 * NEIGHBOURS + 1)
    beside = step[NEIGHBOURS:-NEIGHBOURS] - np.median(windows, axis=1)
    for teeth in range(1, min(MOST_TEETH, step.size // FEWEST_REVS) + 1):
        mean = np.log((time_s[teeth:] - time_s[:-teeth]) / teeth)
        over_rev = step[teeth // 2 : teeth // 2 + mean.size] - mean
        gaps = np.sign(beside) * np.maximum(np.abs(beside) - JITTER, 0.0)
        if any(_repeats(value, teeth) for value in (beside, over_rev, gaps)):
            return teeth
    return 0


def _repeats(value: Floats, teeth: int) -> bool:
    spread = 2.0 * float(np.mean(np.minimum((value - np.median(value)) ** 2, 1.0)))
    change = np.minimum((value[teeth:] - value[:-teeth]) ** 2, 1.0)
    uneven = np.log(UNEVEN_RATIO) ** 2 / teeth
    return bool(np.mean(change) < REPEAT_SHARE * spread) and spread > uneven


def _pattern(time_s: Floats, teeth: int) -> ToothPattern | None:
    """The wheel of ``teeth`` teeth in the mean revolution of the train, from the tooth behind its widest gap."""
    step = np.diff(time_s)
    # the longest stretch of intervals in which each is like the one a revolution later
    odd = np.flatnonzero(np.abs(np.log(step[teeth:] / step[:-teeth])) > np.log(UNEVEN_RATIO))
    edges = np.concatenate(([-1], odd, [step.size - teeth]))
    longest = int(np.argmax(np.diff(edges)))
    step = step[edges[longest] + 1 : edges[longest + 1] + teeth]
    revs = step.size // teeth
    if revs == 0:
        return None
    cycle = step[: revs * teeth].reshape(revs, teeth)
    share = np.median(cycle / cycle.sum(axis=1, keepdims=True), axis=0)
    share /= share.sum()
    pitches = share / _usual(share)
    if not max(pitches.max(), 1.0 / pitches.min()) > UNEVEN_RATIO:
        return None
    share = np.roll(share, -1 - int(np.argmax(pitches)))
    named = min((_named_scatter(share, name), name) for name in known_names())
    whole = _whole_teeth(share)
    if whole is not None and _scatter(share, whole / whole.sum()) <= named[0] + 1e-9:
        return _of_whole(whole)
    if named[0] < NAMED_SCATTER:
        return pattern_of(named[1])
    angles = 360.0 * np.concatenate(([0.0], np.cumsum(share)[:-1]))
    return ToothPattern("unnamed", tuple(float(angle) for angle in np.round(angles, 1)))


def _usual(share: Floats) -> Floats:
    """Usual length of the intervals around each one; the shortest of all on a wheel of few teeth."""
    if share.size <= FEW_TEETH:
        return np.full(share.size, share.min())
    around = NEIGHBOURS + 1
    padded = np.concatenate([share[-around:], share, share[:around]])
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1), axis=1))


def _whole_teeth(share: Floats) -> Floats | None:
    """Tooth pitches in each interval, where each is a whole number of the intervals beside it; else None."""
    pitches = share / _usual(share)
    whole = np.maximum(np.round(pitches), 1.0)
    near = np.abs(pitches - whole) <= WHOLE_SHARE * np.sqrt(whole)
    return whole if near.all() and np.mean(whole == 1.0) >= 0.5 and whole.max() > 1.0 else None


def _of_whole(whole: Floats) -> ToothPattern:
    total = int(whole.sum())
    places = np.concatenate(([0.0], np.cumsum(whole)[:-1]))
    angles = tuple(float(place) * 360.0 / total for place in places)
    if (whole > 1.0).sum() == 1:
        return ToothPattern(f"{total}-{int(whole.max()) - 1}", angles)
    for name in known_names():
        if _named_scatter(whole / total, name) < 1e-6:
            return pattern_of(name)
    gaps = "-".join(str(int(pitch) - 1) for pitch in whole if pitch > 1.0)
    return ToothPattern(f"{total}-{gaps} (unnamed)", angles)


def _scatter(share: Floats, other: Floats) -> float:
    return float(np.sqrt(np.mean(np.log(share / other) ** 2)))


def _named_scatter(share: Floats, name: str) -> float:
    """Scatter of the log intervals about those of a named wheel, at its best rotation; infinite for another count."""
    known = pattern_of(name)
    spans = np.diff(known.angles_deg, append=360.0) / 360.0
    own = known.repeats * spans[: spans.size // known.repeats]
    if share.size != own.size:
        return float("inf")
    return min(_scatter(share, np.roll(own, at)) for at in range(own.size))


# A gap that is longer than a tooth by less than this share of what is missing there is none.
ABSENT_SHARE = 0.25
# A tooth beside a gap that sits this share of a tooth off the line of its neighbours says nothing of the angle.
DISPLACED_SHARE = 0.05
# … where the others stand that many times better: teeth that all sit wrongly say as much there as elsewhere.
DISPLACED_RATIO = 4.0


class Wheel(NamedTuple):
    """Teeth on an even grid of ``grid`` steps per revolution.

    ``places`` (teeth,) are the steps at which they stand, rising, ``offsets`` (teeth,), or (1,) for all alike, their
    distance from these in steps. ``repeats`` is how often the pattern repeats per revolution, ``name`` what it is
    called.
    """

    grid: int
    places: Ints
    offsets: Floats
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
    def spans(self) -> Ints:
        """Steps (teeth,) from each tooth to the next, the last to the first of the next revolution."""
        return np.diff(self.places, append=self.grid)

    @property
    def widest_gap(self) -> float:
        """Widest distance of two teeth over the mean one."""
        return float(self.spans.max() * self.places.size / self.grid)

    def angle_of(self, tooth: Ints) -> Floats:
        """Places (any shape), in steps of the grid, of the teeth numbered ``tooth`` on it, with their offsets."""
        offset = np.zeros(self.grid)
        offset[self.places] = self.offsets
        return np.asarray(tooth + offset[tooth % self.grid])


def wheel_of(pulses_per_rev: int, missing_teeth: int = 0, *, tooth_angles_deg: Sequence[float] | None = None) -> Wheel:
    """The wheel of ``pulses_per_rev`` even teeth less ``missing_teeth`` in a gap, or the one of ``tooth_angles_deg``.

    ``pulses_per_rev`` is 1 or more; ``tooth_angles_deg`` [deg] are 0 and rising, the pulses of one encoder revolution.
    """
    if tooth_angles_deg is None:
        name = f"{pulses_per_rev}-{missing_teeth}" if missing_teeth else f"{pulses_per_rev}"
        return Wheel(pulses_per_rev, np.arange(pulses_per_rev - missing_teeth), np.zeros(1), 1, name)
    pattern = ToothPattern("measured", tuple(tooth_angles_deg))
    if pattern.even is not None:
        return wheel_of(*pattern.even)
    grid, places, offsets = grid_of(pattern.angles_deg)
    name = next((name for name in known_names() if pattern_of(name).angles_deg == pattern.angles_deg), pattern.name)
    return Wheel(grid, np.array(places), np.array(offsets), pattern.repeats, name)


def gap_is_absent(time_s: Floats, kept: Ints, tooth: Ints, wheel: Wheel) -> bool:
    """Whether the longest interval in one of the gaps of the wheel is mostly no longer than a tooth.

    ``time_s`` (pulses,) are pulse times [s], ``kept`` (kept,) the indices of the true ones, ``tooth`` (kept,) their
    numbers on the grid of ``wheel``.
    """
    number, span = np.searchsorted(wheel.places, tooth % wheel.grid), wheel.spans
    gaps = 2 + np.flatnonzero((span[number[2:-3]] > 1) & (np.diff(tooth)[2:-2] == span[number[2:-3]]))
    if gaps.size < 2 or span.min() > 1:
        return False
    longest = np.maximum.reduceat(np.diff(time_s), kept[:-1])[gaps]
    tooth_s = np.diff(time_s[kept]) / span[number[:-1]]
    length = longest / (0.5 * (tooth_s[gaps - 2] + tooth_s[gaps + 2]))
    share = (length - 1.0) / (span[number[gaps]] - 1)
    each = [share[number[gaps] == gap] for gap in np.unique(number[gaps])]
    return any(own.size > 1 and np.median(own) < ABSENT_SHARE for own in each)


def displaced_teeth(time_s: Floats, tooth: Ints, wheel: Wheel, flags: list[Remark]) -> Bools:
    """Which pulses (pulses,) belong to a tooth beside a gap that deviates from the next three (a pickup errs there).

    ``time_s`` (pulses,) are pulse times [s], ``tooth`` (pulses,) their numbers on the grid of ``wheel``; the remark is
    appended to ``flags``.
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


def _usual_off(time_s: Floats, tooth: Ints, wheel: Wheel) -> float:
    """How far [tooth] the teeth away from gaps usually stand off the line of the next three."""
    off = np.diff(time_s, n=3) / np.maximum(time_s[3:] - time_s[:-3], np.finfo(np.float64).tiny) * 3.0
    together, place = tooth[3:] - tooth[:-3] == 3, tooth[:-3] % wheel.grid
    # the outermost teeth of every row are those in question
    first, last = (wheel.places[np.roll(wheel.spans, shift) > 1] for shift in (1, 0))
    asked = np.concatenate([first, (last - 3) % wheel.grid])
    usual = [np.median(off[together & (place == at)]) for at in np.setdiff1d(place[together], asked)]
    return float(np.median(np.abs(usual))) if usual else 0.0


def times_on_grid(time_s: Floats, tooth: Ints, wheel: Wheel) -> Floats:
    """Times [s] (pulses,) at which even teeth would pass, by the cubic through the four nearest true ones.

    ``time_s`` (pulses,) are pulse times [s], ``tooth`` (pulses,) their numbers on the grid of ``wheel``.
    """
    if tooth.size < 4 or not wheel.offsets.any():
        return time_s
    angle = wheel.angle_of(tooth)
    first = np.clip(np.arange(angle.size) - 1, 0, angle.size - 4)
    moved = np.zeros(angle.size)
    for k in range(4):
        weight = np.ones(angle.size)
        for other in range(4):
            if other != k:
                weight *= (tooth - angle[first + other]) / (angle[first + k] - angle[first + other])
        moved += weight * time_s[first + k]
    return moved


# An interval is compared with the median of so many on each side.
BESIDE = 3
# It hides a lost pulse where its speed is off by so many times what is usual in the train, and by this at least.
UNUSUAL_TIMES, LEAST_CHANGE = 5.0, 0.15
# The ends are looked at for so many turns of the wheel.
END_REVS = 3
# What it holds is a whole number of teeth within this.
WHOLE_TEETH = 0.3
# A train is followed from each of so many pulses behind the first too, and counted back by so many teeth at most.
LATEST_START, MOST_BACK = 3, 4
# A train is followed from there only where that costs less by this.
CLEARLY_CHEAPER = 0.5


def followed_from_steady(time_s: Floats, wheel: Wheel) -> FollowedWheel:
    """Assignment of the uneven ``wheel`` to the pulses at ``time_s`` (pulses,) [s]; ``count`` are grid numbers.

    The first interval sets the speed by which all others are judged. It is a bad start where it hides a lost pulse, or
    where the shaft starts from rest so that the next intervals shrink too fast to follow: the train is therefore
    followed from each of the next few pulses too, and the pulses before are counted back from there. The assignment of
    least cost is taken.
    """

    def way(first: int) -> tuple[float, FollowedWheel]:
        followed = followed_wheel(time_s[first:], (wheel.places + wheel.offsets) / wheel.grid, repeats=wheel.repeats)
        turn, place = np.divmod(followed.count, wheel.places.size)
        kept, tooth = followed.kept + first, turn * wheel.grid + wheel.places[place]
        cost = followed.misfit * kept.size
        if first:
            kept, tooth = _with_first_pulses(time_s, first, kept, tooth, wheel)
            head = tooth[: np.searchsorted(kept, first) + 1]
            n_lost = np.count_nonzero(np.isin(np.arange(head[0], head[-1]) % wheel.grid, wheel.places)) - head.size + 1
            cost += REPAIR_COST * (n_lost + first + 1 - head.size) + CLEARLY_CHEAPER
        return cost, replace(followed, kept=kept, count=tooth)

    # one beside the best at a time: each holds numbers of all pulses
    return min(map(way, range(max(0, min(LATEST_START, time_s.size - 8)) + 1)), key=lambda each: each[0])[1]


def _with_first_pulses(time_s: Floats, first: int, kept: Ints, tooth: Ints, wheel: Wheel) -> tuple[Ints, Ints]:
    """``kept`` and ``tooth`` with those of the ``first`` pulses that stand on a tooth, counted back."""
    for pulse in range(first - 1, -1, -1):
        place = wheel.angle_of(tooth[:5:2])
        speed = np.diff(place) / np.diff(time_s[kept[:5:2]])
        ahead = tooth[0] - np.arange(1, wheel.grid)
        ahead = ahead[np.isin(ahead % wheel.grid, wheel.places)][:MOST_BACK]
        turned = place[0] - wheel.angle_of(ahead)
        # as evenly accelerated, but not from less than half the speed
        slope = 2.0 * np.diff(speed**2) / (place[2] - place[0])
        square = np.maximum(speed[0] ** 2 - 0.5 * slope * (place[1] - place[0] + turned), 0.25 * speed[0] ** 2)
        off = np.log((time_s[kept[0]] - time_s[pulse]) * np.sqrt(square) / turned)
        # out of rest the next tooth takes longer than that
        best = int(np.argmin(np.abs(off) + 2.0 * WHOLE_TEETH * (np.arange(off.size) > 0)))
        if -WHOLE_TEETH < off[best] < 2.0 * WHOLE_TEETH:
            kept, tooth = np.append(pulse, kept), np.append(ahead[best], tooth)
    return kept, tooth


def ends_put_right(time_s: Floats, kept: Ints, tooth: Ints, wheel: Wheel) -> tuple[Ints, Ints]:
    """Indices (kept,) of pulses to keep and their numbers (kept,), corrected before the first gap and behind the last.

    ``time_s`` (pulses,) are pulse times [s], ``kept`` (kept,) the indices of the true ones, ``tooth`` (kept,) their
    rising numbers on the grid of ``wheel``.
    """
    true_s = time_s[kept]
    if not wheel.mostly_even or tooth.size < 2 * BESIDE + 2 or not (np.diff(true_s) > 0.0).all():
        return kept, tooth
    for first in (True, False):
        true, right = _put_right(true_s, tooth, wheel, first=first)
        if np.isin(right[true] % wheel.grid, wheel.places).all() and (np.diff(right[true]) > 0).all():
            return kept[true], right[true]
    return kept, tooth


def _put_right(true_s: Floats, tooth: Ints, wheel: Wheel, *, first: bool) -> tuple[Bools, Ints]:
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


def _miscounted(time_s: Floats, tooth: Ints, wheel: Wheel, *, first: bool) -> tuple[Ints, Ints, Ints]:
    """Teeth (intervals,) that each interval holds beyond those counted, false pulses, and which intervals are gaps.

    What a false pulse (by its number) has split counts for the interval behind it.
    """
    counted = np.diff(tooth)
    slow = np.log(np.diff(time_s) / counted)
    padded = np.pad(slow, BESIDE, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * BESIDE + 1)
    change = slow - np.nanmedian(np.delete(windows, BESIDE, axis=1), axis=1)
    # a shaft that starts or stops changes its speed from tooth to tooth: at the ends nothing beside shows the trend
    for end, near, far in ((0, 1, 2), (-1, -2, -3)):
        change[end] = min(change[end], slow[end] - 2.0 * slow[near] + slow[far], key=abs)
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
