"""The toothed wheel behind a train of pulses, where nobody says what it is.

A wheel whose teeth are uneven repeats its intervals with each revolution: the number of its teeth is the shortest
period of the intervals, each taken relative to its neighbours so that the speed does not matter. Its gaps are whole
multiples of the intervals beside them; other wheels are compared with those known by name. Even teeth look alike: their
number per revolution takes an index to tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crankorder.shaft.pattern import ToothPattern, known_names, pattern_of
from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.repair import followed_wheel, running_part

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


@dataclass(frozen=True)
class FoundPattern:
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


def find_pattern(time_s: FloatArray, *, index_time_s: FloatArray | None = None) -> FoundPattern | None:
    """The wheel that gives the pulses at ``time_s``, or None where they do not tell.

    Parameters
    ----------
    time_s : (pulses,), s, increasing
    index_time_s : (marks,), s, times of a once-per-revolution mark: the number of pulses between two marks is taken
    """
    if time_s.size < 3 or not np.all(np.diff(time_s) > 0.0):
        return None
    block = _fastest(time_s)
    per_index = _pulses_per_index(time_s, index_time_s)
    teeth = _repeating(block)
    pattern = _pattern(block, teeth) if teeth else None
    if pattern is not None and per_index and per_index % teeth == 0:
        pattern = _repeated(pattern, per_index // teeth)
    elif pattern is None and per_index:
        return FoundPattern(pattern_of(f"{per_index}"), *_index_agreement(time_s, index_time_s, per_index), True)
    if pattern is None:
        return None
    places = np.array(pattern.angles_deg) / 360.0
    part, _ = running_part(time_s, pulses_per_rev=places.size, gap=float(_spans(places).max() * places.size))
    wheel = followed_wheel(time_s[part], places, repeats=pattern.repeats)
    turn = wheel.count // places.size
    holes = np.flatnonzero((np.diff(wheel.count) != 1) | (np.diff(wheel.kept) != 1))
    revs = int(turn[-1] - turn[0]) + 1
    agreement = 1.0 - np.unique(turn[holes]).size / revs
    by_index = per_index == places.size
    return FoundPattern(pattern, revs, agreement, by_index) if agreement >= 0.5 else None


def _fastest(time_s: FloatArray) -> FloatArray:
    """The block of pulses with the shortest intervals: there the speed is steadiest."""
    starts = range(0, max(1, time_s.size - BLOCK_PULSES + 1), BLOCK_PULSES // 2)
    first = min(starts, key=lambda at: float(np.median(np.diff(time_s[at : at + BLOCK_PULSES]))))
    return time_s[first : first + BLOCK_PULSES]


def _pulses_per_index(time_s: FloatArray, index_time_s: FloatArray | None) -> int:
    if index_time_s is None or index_time_s.size < 3:
        return 0
    between = np.diff(np.searchsorted(time_s, index_time_s[(index_time_s > time_s[0]) & (index_time_s < time_s[-1])]))
    values, counts = np.unique(between, return_counts=True)
    if not counts.size or 2 * counts.max() <= counts.sum():
        return 0
    return int(values[np.argmax(counts)])


def _index_agreement(time_s: FloatArray, index_time_s: FloatArray | None, per_index: int) -> tuple[int, float]:
    assert index_time_s is not None  # it told per_index
    between = np.diff(np.searchsorted(time_s, index_time_s[(index_time_s > time_s[0]) & (index_time_s < time_s[-1])]))
    return between.size, float(np.mean(np.abs(between - per_index) <= 1))


def _repeating(time_s: FloatArray) -> int:
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


def _repeats(value: FloatArray, teeth: int) -> bool:
    spread = 2.0 * float(np.mean(np.minimum((value - np.median(value)) ** 2, 1.0)))
    change = np.minimum((value[teeth:] - value[:-teeth]) ** 2, 1.0)
    uneven = np.log(UNEVEN_RATIO) ** 2 / teeth
    return bool(np.mean(change) < REPEAT_SHARE * spread) and spread > uneven


def _pattern(time_s: FloatArray, teeth: int) -> ToothPattern | None:
    """The wheel of ``teeth`` teeth in the mean revolution of the train, from the tooth behind its widest gap."""
    step = _undisturbed(np.diff(time_s), teeth)
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


def _undisturbed(step: FloatArray, teeth: int) -> FloatArray:
    """The longest stretch of intervals in which each is like the one a revolution later."""
    odd = np.flatnonzero(np.abs(np.log(step[teeth:] / step[:-teeth])) > np.log(UNEVEN_RATIO))
    edges = np.concatenate(([-1], odd, [step.size - teeth]))
    longest = int(np.argmax(np.diff(edges)))
    return step[edges[longest] + 1 : edges[longest + 1] + teeth]


def _usual(share: FloatArray) -> FloatArray:
    """Usual length of the intervals around each one; the shortest of all on a wheel of few teeth."""
    if share.size <= FEW_TEETH:
        return np.full(share.size, share.min())
    around = NEIGHBOURS + 1
    padded = np.concatenate([share[-around:], share, share[:around]])
    usual: FloatArray = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1), axis=1)
    return usual


def _whole_teeth(share: FloatArray) -> FloatArray | None:
    """Tooth pitches in each interval, where each is a whole number of the intervals beside it; else None."""
    pitches = share / _usual(share)
    whole = np.maximum(np.round(pitches), 1.0)
    near = np.abs(pitches - whole) <= WHOLE_SHARE * np.sqrt(whole)
    return whole if near.all() and np.mean(whole == 1.0) >= 0.5 and whole.max() > 1.0 else None


def _of_whole(whole: FloatArray) -> ToothPattern:
    total = int(whole.sum())
    places = np.concatenate(([0.0], np.cumsum(whole)[:-1]))
    angles = tuple(float(place) * 360.0 / total for place in places)
    if (whole > 1.0).sum() == 1:
        return ToothPattern(f"{total}-{int(whole.max()) - 1}", angles)
    for name in known_names():
        known = pattern_of(name)
        spans = _spans(np.array(known.angles_deg))
        if spans.size == whole.size and _rotation_scatter(whole / total, spans / 360.0) < 1e-6:
            return known
    gaps = "-".join(str(int(pitch) - 1) for pitch in whole if pitch > 1.0)
    return ToothPattern(f"{total}-{gaps} (unnamed)", angles)


def _spans(places: FloatArray) -> FloatArray:
    """Distance from each tooth to the next; ``places`` in degrees or in revolutions, by what they reach."""
    turn = 360.0 if places[-1] > 1.0 else 1.0
    spans: FloatArray = np.diff(places, append=places[0] + turn)
    return spans


def _scatter(share: FloatArray, other: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.log(share / other) ** 2)))


def _rotation_scatter(share: FloatArray, other: FloatArray) -> float:
    return min(_scatter(share, np.roll(other, at)) for at in range(other.size))


def _named_scatter(share: FloatArray, name: str) -> float:
    """Scatter of the log intervals about those of a named wheel, at its best rotation; infinite for another count."""
    known = pattern_of(name)
    spans = _spans(np.array(known.angles_deg)) / 360.0
    part = spans.size // known.repeats
    if share.size != part:
        return float("inf")
    return _rotation_scatter(share, spans[:part] * known.repeats)


def _repeated(pattern: ToothPattern, times: int) -> ToothPattern:
    """The wheel that shows ``pattern`` so many times per revolution."""
    if times == 1:
        return pattern
    angles = tuple((angle + 360.0 * turn) / times for turn in range(times) for angle in pattern.angles_deg)
    return ToothPattern(f"{pattern.name}, {times} times", angles)
