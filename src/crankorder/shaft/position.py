"""Pulse times from a sampled position: angles or counts that start anew after so many, or grow or fall without end.

A position is laid on one angle that grows, and its pulses lie where that passes whole multiples of a step, between
samples by straight lines. So its angle is that of pulses, with the repair, smoothing and errors of pulses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError
from crankorder.quantities import Bools, Floats, Ints
from crankorder.shaft.pulses import QUANTISED_EDGE_SAMPLES, Pulses, Remark
from crankorder.shaft.repair import listed_times
from crankorder.shaft.wheel import FEWEST_SAMPLES_PER_TOOTH

# Steps from sample to sample whose median is the usual one there.
USUAL_STEPS = 9
# A step is abrupt that differs from the usual one by more than so many typical steps and typical differences.
ABRUPT_STEPS, ABRUPT_DIFFERENCES = 1.5, 6.0
# Jumps of an angle are as uncertain as the step there, a share of a turn; those of a count by counts, and few lost.
SAME_TURN, SAME_COUNTS, LOST_COUNTS = 0.06, 1.5, 0.01
# A jump that misses a whole wrap by more than this share of it is a counter set to 0 elsewhere, not counts lost.
MISSED_WRAP = 0.125
# More counts than so many stated turns are what a counter holds: four turns may be the four counts of each line.
MANY_TURNS = 4.5
# Bits of the counters of data acquisition cards.
COUNTER_BITS = (16, 24, 32)
# Pulses so many times the uncertainty of one apart are counted surely.
SURE_STEPS = 4.0
# A shaft that goes back by more revolutions than this does not only tremble between two counts.
BACKWARDS_REV = 0.05
# A position goes so much of its way onwards, though it may tremble between two counts.
ONWARDS = 0.5
# Samples that are enough to tell the quantum of an angle.
QUANTUM_SAMPLES = 1 << 17


@dataclass(frozen=True)
class Position:
    """``pulses`` of a position, ``pulses_per_rev`` of them, and the times [s] at which it passes whole turns.

    ``cycle_s`` are those at which an angle of two turns starts anew, None where it does not; ``is_mark``: whether the
    zero of the position is a place on the shaft, and not where a counter happened to start.
    """

    pulses: Pulses
    pulses_per_rev: int
    turn_s: Floats
    cycle_s: Floats | None
    is_mark: bool


def position_pulses(
    position: npt.NDArray[np.floating], *, rate_hz: float, units_per_rev: Sequence[float], counted: bool
) -> Position:
    """Pulses of a sampled ``position`` (sample,), NaN where unknown, of a shaft that turns either way.

    Parameters
    ----------
    position : angle or count, which starts anew after any number, or grows or falls without end
    rate_hz : samples per second
    units_per_rev : units of the position in a revolution; of several the first that the wraps agree with
    counted : whether the position is a count, a whole number below the true one, which may be a counter's of few bits

    Raises
    ------
    InputError where the position turns too little, starts anew after what is neither a turn nor a counter's width, or
    goes to and fro.
    """
    at, value, step, expected = _followed(position)
    sign, jump = _motion(at, step, expected)
    flags: list[Remark] = []
    wrong = np.setdiff1d(np.flatnonzero(np.isfinite(position)), at)
    if wrong.size:
        detail = f"{wrong.size} wrong positions left out, {listed_times(wrong / rate_hz)}"
        flags.append(("encoder_glitch", "suspect", detail))
    unit, wrap = _wrap(jump, float(np.ptp(value)) + 1.0, units_per_rev, counted)
    if len(units_per_rev) > 1 and wrap == 0.0:
        detail = f"the file states no unit of the angle, which starts nowhere anew: taken as {unit:g} per revolution"
        flags.append(("angle_without_unit", "suspect", detail))
    quantum = 1.0 / unit if counted else _quantum(value / unit)
    if wrap > 0.0:
        step = step - wrap * np.round((step - expected) / wrap)
        elsewhere = (np.abs(step - expected) > MISSED_WRAP * wrap) & (np.diff(at) <= 2)
        step = np.where(elsewhere, expected, step)
    turns = np.cumsum(np.append(value[0], step)) / unit
    is_mark = not counted or wrap == unit
    if wrap > 0.0 and is_mark:
        whole = wrap / unit
        turns -= np.median((turns - value / unit + 0.5 * whole) % whole - 0.5 * whole)
    turns = _onwards(sign * (turns + 0.5 * quantum), quantum, flags)
    mark = np.arange(math.ceil(turns[0]), math.floor(turns[-1]) + 1)
    if mark.size < 2:
        raise InputError("the position turns too little", found=f"{np.ptp(turns):.3g} revolutions", allowed="2 or more")
    turn_at = np.interp(mark, turns, at)
    fastest = float(np.diff(turn_at).min())
    if wrap > 0.0 and fastest * wrap / unit < FEWEST_SAMPLES_PER_TOOTH:
        detail = f"only {fastest * wrap / unit:.1f} samples until the position starts anew: sample faster"
        flags.append(("encoder_undersampled", "bad", detail))
    per_rev = _pulses_per_rev(fastest, quantum)
    passed = np.arange(math.ceil(turns[0] * per_rev), math.floor(turns[-1] * per_rev) + 1) / per_rev
    pulse_at = np.interp(passed, turns, at)
    counts = 1.0 / (quantum * per_rev * np.diff(pulse_at)) if quantum else np.inf
    noise = QUANTISED_EDGE_SAMPLES * float(np.sqrt(np.mean(1.0 / np.maximum(counts, 1.0) ** 2)))
    cycle_s = turn_at[(sign * mark) % 2 == 0] / rate_hz if is_mark and wrap == 2.0 * unit else None
    return Position(Pulses(pulse_at / rate_hz, noise / rate_hz, flags), per_rev, turn_at / rate_hz, cycle_s, is_mark)


def _onwards(turns: Floats, quantum: float, flags: list[Remark]) -> Floats:
    """``turns`` (sample,) that never fall: half-way between the first and the last time that each is passed.

    ``quantum`` [rev] is the step in which they come; a shaft that turns back joins the ``flags``, or is refused.
    """
    highest = np.maximum.accumulate(turns)
    back = float(np.max(highest - turns))
    if back > 1.0:
        raise InputError("the shaft turns both ways", found=f"{back:.3g} revolutions back", remedy="Leave it out")
    if back > max(BACKWARDS_REV, 2.0 * quantum):
        flags.append(("direction_changes", "suspect", f"the position goes back by {back:.3g} revolutions"))
    onwards: Floats = 0.5 * (highest + np.minimum.accumulate(turns[::-1])[::-1])
    return onwards


def _followed(position: npt.NDArray[np.floating]) -> tuple[Ints, Floats, Floats, Floats]:
    """Samples that are right, their positions, the step from each to the next, and the usual step there."""
    at = np.flatnonzero(np.isfinite(position))
    for left in (2, 1, 0):  # a wrong sample beside a wrap shows once others are gone
        value = position[at].astype(np.float64)
        step, gap = np.diff(value), np.diff(at)
        if not step.any():
            raise InputError("the position does not change", found=f"{at.size} samples", remedy="Mend encoder.source")
        from scipy.ndimage import median_filter  # loads slowly, and few encoders ask for it

        expected = gap * median_filter(step / gap, USUAL_STEPS)
        abrupt = np.pad(_is_abrupt(step, expected), 1, constant_values=True)
        wrong = np.flatnonzero(abrupt[1:] & abrupt[:-1])
        if not wrong.size or not left:
            break
        at = np.delete(at, wrong[np.diff(wrong, prepend=-2) > 1])
    return at, value, step, expected


def _motion(at: Ints, step: Floats, expected: Floats) -> tuple[float, float]:
    """Which way a position followed at samples ``at`` goes, 1 or -1, and by how much it jumps back; 0 for never."""
    abrupt = _is_abrupt(step, expected)
    sign = 1.0 if np.sum(step[~abrupt]) > 0.0 else -1.0
    least = np.min(np.abs(step[step != 0.0]))  # of a coarse count no step is usual, but it does not wrap without one
    jumps = (np.maximum(sign * expected, least) - sign * step)[abrupt & (np.diff(at) <= 2)]
    return sign, float(np.median(jumps[jumps > 0.0])) if (jumps > 0.0).any() else 0.0


def wrap_seen(values: npt.NDArray[np.floating]) -> tuple[float, bool] | None:
    """Units after which ``values`` (sample,) start anew, 0 for never, and whether all steps but the jumps are alike.

    None where they do not go one way, as a position does.
    """
    try:
        at, value, step, expected = _followed(values)
    except InputError:
        return None
    sign, jump = _motion(at, step, expected)
    steps = sign * step[~_is_abrupt(step, expected)]
    if np.sum(steps) < ONWARDS * np.sum(np.abs(steps)) or 2 * steps.size < step.size:
        return None
    return max(float(round(jump)), float(np.ptp(value)) + 1.0) if jump else 0.0, bool(np.ptp(steps) == 0.0)


def _is_abrupt(step: Floats, expected: Floats) -> Bools:
    off = np.abs(step - expected)
    typical = float(np.median(np.abs(step[step != 0.0])))
    return np.asarray(off > ABRUPT_STEPS * typical + ABRUPT_DIFFERENCES * float(np.median(off)))


def _wrap(jump: float, span: float, units_per_rev: Sequence[float], counted: bool) -> tuple[float, float]:
    """Units per revolution, and units after which the position starts anew, as its usual ``jump`` says; 0 for never.

    ``span``: from the lowest count to one above the highest.
    """
    for unit in units_per_rev:
        turns = round(jump / unit)
        wraps = [unit, *(2.0**bits for bits in COUNTER_BITS)] if counted else [turns * unit]
        wraps += [max(float(round(jump)), span)] if counted and jump > MANY_TURNS * unit else []
        near = [
            wrap
            for wrap in wraps
            if abs(jump - wrap) <= (SAME_COUNTS + LOST_COUNTS * wrap if counted else SAME_TURN * wrap)
        ]
        if jump == 0.0 or (near and (turns <= 2 or len(units_per_rev) == 1)):
            return unit, near[0] if near else 0.0
    raise InputError(
        f"the position starts anew after {jump:.5g}, which is no whole turn",
        place="encoder.pulses_per_rev" if counted else "encoder.source",
        found=" or ".join(f"{unit:g} per revolution" for unit in units_per_rev),
        allowed="pulses_per_rev, where an index sets the count to 0, or 65536 and other widths of counters"
        if counted
        else "360 deg, 6.2832 rad, 1 rev, and multiples",
        remedy="State the counts of a turn, four for each line of most encoders" if counted else "Mend its unit",
    )


def _quantum(turns: Floats) -> float:
    """Step [rev] of an angle that comes in steps: the gap that covers half of the circle; 0 where it has no steps."""
    some = np.sort(turns[:: 1 + turns.size // QUANTUM_SAMPLES] % 1.0)
    gaps = np.sort(np.diff(some, append=some[0] + 1.0))
    usual = gaps[np.searchsorted(np.cumsum(gaps), 0.5)]
    steps = float(np.sum(np.round(gaps / usual)))
    return 1.0 / steps if 2.0 * steps < some.size else 0.0


def _pulses_per_rev(samples_per_rev: float, quantum: float) -> int:
    """Pulses per revolution that the fewest samples of one, and the steps of the position [rev], carry surely.

    Best each of as many whole steps: pulses between the steps of a coarse position are out of place in each turn.
    """
    if not quantum:
        return max(1, int(samples_per_rev))
    steps = round(1.0 / quantum)
    most = min(steps, samples_per_rev, max(steps, samples_per_rev) / SURE_STEPS)
    whole = max(number for number in range(1, max(1, int(most)) + 1) if steps % number == 0)
    return whole if 2 * whole > most else int(most)
