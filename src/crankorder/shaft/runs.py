"""Runs of one recording with a standstill between them, laid on one angle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from crankorder.shaft.angle import AngleKnots, angle_at
from crankorder.shaft.pulses import FloatArray

STEP_SHARE = 1e-3
"""Share of a knot interval over which the speed at a pulse is differenced."""


@dataclass(frozen=True)
class ShaftRun:
    """Knots of one run between standstills, the times of its first and last pulse, and how its angle is known.

    ``first`` and ``last`` number these pulses among all of the recording; ``period_rev`` are the turns after which its
    mark comes again, 0 where it has none.
    """

    knots: AngleKnots
    ends_s: tuple[float, float]
    first: int
    last: int
    period_rev: float


def joined(runs: list[ShaftRun], teeth_per_rev: float) -> AngleKnots:
    """Knots of all ``runs`` in turn, on the angle of the first.

    Between two of them the shaft turns by the pulses between, of which ``teeth_per_rev`` make a revolution, to the
    nearest angle at which the mark, where there is one, stands right; it slows down evenly, stands and speeds up.
    """
    made = _within(runs[0].knots, -np.inf, runs[0].ends_s[1]) if len(runs) > 1 else runs[0].knots
    for before, run in pairwise(runs):
        last = run is runs[-1]
        own = _within(run.knots, run.ends_s[0], np.inf if last else run.ends_s[1])
        turned = (run.first - before.last) / teeth_per_rev
        shift = made.angle_rev[-1] + turned - own.angle_rev[0]
        period = run.period_rev
        if period > 0.0:
            shift = period * np.round(shift / period)
        laid = _shifted(own, float(shift))
        # a tooth too many counted at rest would let the angle go back
        behind = laid.angle_rev > made.angle_rev[-1]
        laid = _of(laid, [column[behind] for column in _columns(laid)])
        made = _stopped_between(made, laid)
    return made


def _shifted(knots: AngleKnots, shift_rev: float) -> AngleKnots:
    return replace(knots, angle_rev=knots.angle_rev + shift_rev)


def _within(knots: AngleKnots, first_s: float, last_s: float) -> AngleKnots:
    """``knots`` that end at ``first_s`` and ``last_s`` where these lie inside: no tooth is counted on beyond."""
    inside = (knots.time_s > first_s) & (knots.time_s < last_s)
    kept = [column[inside] for column in _columns(knots)]
    for at_s, front in ((first_s, True), (last_s, False)):
        if not knots.time_s[0] <= at_s <= knots.time_s[-1]:
            continue
        known = (knots.time_s, knots.angle_rev, knots.speed_rpm)
        step = STEP_SHARE * float(np.diff(knots.time_s).min())
        near = np.clip([at_s - step, at_s + step], knots.time_s[0], knots.time_s[-1])
        turned = angle_at(near, *known)
        here = [at_s, angle_at([at_s], *known)[0], 60.0 * np.diff(turned)[0] / np.diff(near)[0]]
        here.append(np.interp(at_s, knots.time_s, knots.standard_error_rev))
        kept = [np.insert(column, 0 if front else len(column), value) for column, value in zip(kept, here, strict=True)]
    return _of(knots, kept)


def _stopped_between(one: AngleKnots, two: AngleKnots) -> AngleKnots:
    """Knots of both and two in the hole between, where the shaft has slowed down and where it starts."""
    hole_s, turned = two.time_s[0] - one.time_s[-1], two.angle_rev[0] - one.angle_rev[-1]
    fast = np.array([one.speed_rpm[-1], two.speed_rpm[0]]) / 60.0
    slowing = min(hole_s / 3.0, turned / max(float(fast.sum()), 1e-12))
    slow = (turned - 0.5 * slowing * float(fast.sum())) / (hole_s - slowing)
    covered = 0.5 * (fast + slow) * slowing
    error = np.full(2, max(one.standard_error_rev[-1], two.standard_error_rev[0], turned / np.sqrt(12.0)))
    between = [
        np.array([one.time_s[-1] + slowing, two.time_s[0] - slowing]),
        np.array([one.angle_rev[-1] + covered[0], two.angle_rev[0] - covered[1]]),
        np.full(2, 60.0 * slow),
        error,
    ]
    columns = [np.concatenate(parts) for parts in zip(_columns(one), between, _columns(two), strict=True)]
    both = replace(one, cut_off_order=min(one.cut_off_order, two.cut_off_order), noise_s=max(one.noise_s, two.noise_s))
    return _of(both, columns)


def _columns(knots: AngleKnots) -> list[FloatArray]:
    return [knots.time_s, knots.angle_rev, knots.speed_rpm, knots.standard_error_rev]


def _of(knots: AngleKnots, columns: list[FloatArray]) -> AngleKnots:
    time_s, angle_rev, speed_rpm, error_rev = columns
    return replace(knots, time_s=time_s, angle_rev=angle_rev, speed_rpm=speed_rpm, standard_error_rev=error_rev)
