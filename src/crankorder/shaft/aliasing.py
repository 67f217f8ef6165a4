"""What is aliased where in a recording sampled by crank angle, and which of its lines are aliases of something else.

Sampled samples_per_rev times a revolution, whatever lies above half of that order shows at |order - n samples_per_rev|,
unless a filter stopped it. A line of fixed frequency f is at order 60 f / speed, so its alias runs through the orders
with speed far faster than any true line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from crankorder.quantities import Bools, Floats, Ints

# A fold is taken for found where chance would make so few of it in a test.
FALSE_ALIASES = 0.01
# An order is a line of the shaft where it shows at this share of the speeds.
ORDER_SHARE = 0.6
# Frequencies without a name that are looked at closely: those on which most lines agree.
MOST_PROPOSED = 400


class AliasedLine(NamedTuple):
    """Where a line of ``frequency_hz`` shows: at ``shown_order`` (speeds,) at each of ``speed_rpm`` (speeds,).

    ``folds`` (speeds,) says whether it is folded there.
    """

    frequency_hz: float
    speed_rpm: Floats
    shown_order: Floats
    folds: Bools

    def __str__(self) -> str:
        """The line and where it shows, in words."""
        at = zip(self.shown_order[self.folds], self.speed_rpm[self.folds], strict=True)
        orders = ", ".join(f"{order:.4g} ({speed:g} rpm)" for order, speed in at)
        return f"{self.frequency_hz:g} Hz shows at order {orders}"


class Alias(NamedTuple):
    """Found lines that are folds of a fixed ``frequency_hz``.

    ``points`` (folds,) are the indices of these lines among the found ones, ``false_aliases`` how many such frequencies
    chance alone would show, ``evidence`` says why in words.
    """

    frequency_hz: float
    points: Ints
    false_aliases: float
    evidence: str


def aliased_order(order: npt.ArrayLike, samples_per_rev: float) -> Floats:
    """Orders at which lines at ``order`` (any shape) show when sampled ``samples_per_rev`` times a revolution."""
    true = np.asarray(order, dtype=np.float64)
    return np.asarray(np.abs(true - samples_per_rev * np.rint(true / samples_per_rev)))


def aliased_lines(
    samples_per_rev: float,
    speeds_rpm: Sequence[float] | Floats,
    *,
    frequencies_hz: Sequence[float],
    shown_to_order: float = math.inf,
) -> list[AliasedLine]:
    """Lines that fold at one speed or more to an order that is looked at, with their place at every speed.

    Parameters
    ----------
    samples_per_rev : samples per crank revolution, above 0
    speeds_rpm : (speeds,), rpm, above 0
    frequencies_hz : fixed frequencies, Hz: mains and its harmonics, natural frequencies, switched supplies
    shown_to_order : highest order that is looked at; a fold beyond it disturbs nobody
    """
    speed = np.asarray(speeds_rpm, dtype=np.float64)

    def line_of(frequency_hz: float) -> AliasedLine:
        true = 60.0 * frequency_hz / speed
        shown = aliased_order(true, samples_per_rev)
        return AliasedLine(frequency_hz, speed, shown, (true > 0.5 * samples_per_rev) & (shown <= shown_to_order))

    return [line for line in map(line_of, frequencies_hz) if line.folds.any()]


def find_aliases(
    speed_rpm: Floats,
    order: Floats,
    *,
    samples_per_rev: float,
    order_error: float,
    shown_to_order: float,
    highest_hz: float,
    frequencies_hz: Sequence[float] = (),
) -> list[Alias]:
    """Which found lines are folds of fixed frequencies, the lowest first.

    A frequency is believed where chance would put so many lines on its track in fewer than one test of a hundred,
    counted over all frequencies tried; a line takes part in one fold. A line that stays at its order is a line of the
    shaft.

    Parameters
    ----------
    speed_rpm : (points,), rpm, above 0, speed at which each line was found
    order : (points,), its order there, 0 to ``shown_to_order``; lines of the shaft among them
    samples_per_rev : samples per crank revolution
    order_error : how well an order is known, above 0; more finds more and proves less
    shown_to_order : highest order in which lines were sought, up to samples_per_rev / 2
    highest_hz : highest frequency that the sensors let pass, up to which unnamed frequencies are sought
    frequencies_hz : frequencies that the test is known to have; looked for first, as few they prove more
    """
    track = _Track(speed_rpm, order, samples_per_rev, order_error, min(shown_to_order, 0.5 * samples_per_rev))
    free = ~_staying(speed_rpm, order, order_error)
    folds = []
    for f in frequencies_hz:
        if (fold := track.fold(f, free, tried=len(frequencies_hz))) is not None:
            folds.append(fold)
            free[fold.points] = False
    folds += _unnamed(track, free, highest_hz)
    return sorted(folds, key=lambda fold: fold.frequency_hz)


class _Track(NamedTuple):
    """The lines of a test and what a fixed frequency would look like among them."""

    speed_rpm: Floats
    order: Floats
    samples_per_rev: float
    order_error: float
    shown_to_order: float

    def fold(self, frequency_hz: float, free: Bools, *, tried: int) -> Alias | None:
        """The Alias of ``frequency_hz`` among the ``free`` points where it is sure after ``tried`` frequencies."""
        speeds = np.unique(self.speed_rpm)
        true = 60.0 * frequency_hz / speeds
        shown = aliased_order(true, self.samples_per_rev)
        looked = (shown < self.shown_to_order) & (true > 0.5 * self.samples_per_rev)
        hits, log_chance = [], 0.0
        by_chance = min(1.0, 2.0 * self.order_error / self.shown_to_order)
        for speed, place in zip(speeds[looked], shown[looked], strict=True):
            at = np.flatnonzero(free & (self.speed_rpm == speed))
            chance = 1.0 - (1.0 - by_chance) ** at.size
            near = at[np.abs(self.order[at] - place) <= self.order_error]
            if near.size:
                hits.append(int(near[np.argmin(np.abs(self.order[near] - place))]))
                log_chance += math.log(chance)
        n_looked = int(looked.sum())
        if len(hits) < 2 or 2 * len(hits) < n_looked:
            return None
        false_aliases = tried * math.comb(n_looked, len(hits)) * math.exp(log_chance)
        if false_aliases > FALSE_ALIASES:
            return None
        points = np.array(hits)
        at_speeds = ", ".join(f"{self.order[k]:.4g} ({self.speed_rpm[k]:g} rpm)" for k in hits[:4])
        more = f" and {len(hits) - 4} more" if len(hits) > 4 else ""
        evidence = (
            f"lines at order {at_speeds}{more} are one of {frequency_hz:.6g} Hz folded at {self.samples_per_rev:g} "
            f"samples per revolution: at {len(hits)} of {n_looked} speeds where it would show, "
            f"{false_aliases:.1g} by chance"
        )
        return Alias(frequency_hz, points, false_aliases, evidence)

    def refined_hz(self, frequency_hz: float, points: Ints) -> float:
        """Frequency that fits the ``points`` of a fold near ``frequency_hz`` best."""
        true = 60.0 * frequency_hz / self.speed_rpm[points]
        turns = np.rint(true / self.samples_per_rev)
        sign = np.where(true >= turns * self.samples_per_rev, 1.0, -1.0)
        each = (turns * self.samples_per_rev + sign * self.order[points]) * self.speed_rpm[points] / 60.0
        width = self.speed_rpm[points] / 60.0 * self.order_error
        return float(np.average(each, weights=width**-2.0))


def _unnamed(track: _Track, free: Bools, highest_hz: float) -> list[Alias]:
    """Folds of frequencies that nobody named, among the ``free`` points; the least likely by chance is taken first."""
    folds: list[Alias] = []
    lowest_hz = 0.5 * track.samples_per_rev * float(track.speed_rpm.min(initial=np.inf)) / 60.0
    while np.unique(track.speed_rpm[free]).size >= 2 and highest_hz > lowest_hz:
        step_hz = 2.0 * track.order_error * float(track.speed_rpm.min()) / 60.0
        tried = math.ceil(max(1.0, (highest_hz - lowest_hz) / step_hz))
        proposed = _proposed(track, free, lowest_hz, highest_hz)
        sure = [fold for f in proposed if (fold := track.fold(float(f), free, tried=tried)) is not None]
        if not sure:
            break
        best = min(sure, key=lambda fold: fold.false_aliases)
        exact = track.refined_hz(best.frequency_hz, best.points)
        # where speeds are in simple ratios, several frequencies fold alike at all of them
        near_hz = 1e-3 * best.frequency_hz
        same = [fold.frequency_hz for fold in sure if np.array_equal(fold.points, best.points)]
        alike = [hertz for hertz in same if abs(hertz - exact) > near_hz]
        best = track.fold(exact, free, tried=tried) or best
        if alike:
            best = best._replace(evidence=f"{best.evidence}; {min(alike):.5g} Hz would fold alike")
        folds.append(best)
        free[best.points] = False
    return folds


def _proposed(track: _Track, free: Bools, lowest_hz: float, highest_hz: float) -> Floats:
    """Frequencies on which most free lines agree, whatever of their folds they are: those worth a closer look."""
    turn_hz, order = track.speed_rpm[free] / 60.0, track.order[free]
    turns = np.arange(1, int(highest_hz / (track.samples_per_rev * turn_hz.min())) + 2)[:, None]
    every = np.concatenate([(turns * track.samples_per_rev + sign * order) * turn_hz for sign in (1.0, -1.0)]).ravel()
    every = np.sort(every[(every >= lowest_hz) & (every <= highest_hz)])
    width = 1.5 * float(turn_hz.max()) * track.order_error
    last = np.searchsorted(every, every + width, side="right")
    votes = last - np.arange(every.size)
    best = np.sort(np.argsort(-votes, kind="stable")[:MOST_PROPOSED])
    total = np.append(0.0, np.cumsum(every))
    return np.asarray((total[last[best]] - total[best]) / votes[best])[votes[best] > 1]


def _staying(speed_rpm: Floats, order: Floats, order_error: float) -> Bools:
    """Which points (points,) stay at one order over most speeds: lines of the shaft."""
    seen_at = [np.unique(speed_rpm[np.abs(order - at) <= order_error]).size for at in order.tolist()]
    return np.array(seen_at, dtype=np.float64) > max(1.0, ORDER_SHARE * np.unique(speed_rpm).size)
