"""Pulse times from a sampled encoder trace or position, with the noise of one pulse time.

A trace of two levels is cut half-way between them, whatever it is said to be. A magnetic pickup that swings to both
sides alike is cut at zero (there the flux through the coil is at its extreme, whatever the speed), with a hysteresis
that follows the local pulse height, for that grows with speed. A pickup clipped on one side rests on a flat baseline,
and the tooth behind a gap may rise from it by a tenth of its neighbours' height: such a trace is cut a small share of
the local height off it.

A position (an angle or count that starts anew after so many units, or grows or falls without end) is laid on one angle
that grows, and its pulses lie where that passes whole multiples of a step, between samples by straight lines. So its
angle is that of pulses, with the repair, smoothing and errors of pulses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from crankorder.errors import InputError
from crankorder.quantities import Bools, Floats, Ints, Severity
from crankorder.settings import ShaftSettings

Remark = tuple[str, Severity, str]

# Standard deviation, in samples, of a linearly interpolated crossing of a band-limited edge: 7.1e-3 degrees at 0.24
# degrees per sample, measured at 4.2 samples per pulse.
INTERPOLATED_EDGE_SAMPLES = 0.03
# Standard deviation of an edge known only to lie between two samples: uniform over one sample.
QUANTISED_EDGE_SAMPLES = 12.0**-0.5
# An edge whose two samples both lie within this share of the height of their levels carries no sub-sample position.
SETTLED_SHARE = 0.1
# A trace rests on an extreme when REST_SHARE of its samples lies within REST_WIDTH of the height of it; a sine: 0.16.
REST_SHARE, REST_WIDTH = 0.25, 0.06
# The cut of a pickup stays so many standard deviations of its noise off the baseline.
NOISE_MULTIPLE = 6.0
# A pulse of a pickup is sure so far from the cut, as shares of the height of the largest pulses: between standstill
# that is not quite still, and a noise that cannot be told from fast pulses.
MIN_SURE_SHARE, MAX_SURE_SHARE = 0.0025, 0.02
# Samples, or a 64th of the trace if that is more, that show the height of the first pulses.
FIRST_BLOCK = 512
# A square wave whose levels scatter by more than this share of their distance may be noise.
OVERLAP_SHARE = 0.3
# Blocks of a trace with one pulse per revolution whose extremes tell how high it is.
MARK_BLOCKS = 16
# Pulses for which there is room at first.
FIRST_PULSES = 1 << 16
# Samples that are enough to find the two levels of a trace.
LEVEL_SAMPLES = 1 << 17
# A trace has two levels where this share of the samples on either side of the middle lies within LEVEL_WIDTH of the
# height of its level; of a sine, 0.2 do.
LEVEL_SHARE, LEVEL_WIDTH = 0.8, 0.1


class NoPulsesError(InputError):
    """The trace holds no pulse: it is constant, not finite, or never crosses its own middle."""


class Pulses(NamedTuple):
    """Pulses of a trace: ``time_s`` (pulses,) from its start, the standard deviation ``noise_s`` of one, and remarks.

    ``flags`` holds (flag, severity, detail): severity is "info", "suspect" or "bad".
    """

    time_s: Floats
    noise_s: float
    flags: list[Remark]


def find_pulses(
    trace: npt.NDArray[Any],
    *,
    rate_hz: float,
    kind: Literal["square", "analogue"],
    edge: Literal["rising", "falling"],
    pulses_per_rev: int,
    settings: ShaftSettings,
) -> Pulses:
    """Times of the pulses of a sampled encoder trace, with the standard deviation of one of them.

    Parameters
    ----------
    trace : (samples,), volts or counts of any level; float32 and float64 are taken as they are, others are converted
    rate_hz : samples per second
    kind : "square" for a two-level trace, "analogue" for a magnetic pickup; a pickup's trace that rests on two levels
        all the same, as an index beside it may, is taken for square
    edge : the edge that marks a pulse; wheels with missing teeth decode well on one edge only
    pulses_per_rev : pulses of the full wheel per revolution, 1 or more; named in the error where there are none
    settings : ``hysteresis_fraction`` guards against noise (more) or loses small teeth (less); ``envelope_teeth`` is
        how fast the pulse height is followed

    Returns
    -------
    Pulses, whose noise is 1/sqrt(12) sample where edges fall between two settled samples, and the noise of a linear
    interpolation where the samples carry the edge; the share of either kind is measured and reported.

    Raises
    ------
    InputError where the trace has no samples; NoPulsesError where it is constant, not finite, or holds no pulse.
    """
    samples = np.ascontiguousarray(trace, dtype=trace.dtype if trace.dtype in (np.float32, np.float64) else np.float64)
    if samples.ndim != 1 or samples.size < 2:
        raise InputError("the encoder trace has no samples", found=samples.shape, allowed="one axis, 2 samples or more")
    sign = 1.0 if edge == "rising" else -1.0
    some, lowest = samples, float(samples.min())
    if samples.size > LEVEL_SAMPLES:  # blocks of it: a stride could keep step with the pulses
        some = samples[: samples.size // 64 * 64].reshape(64, -1)[:, : LEVEL_SAMPLES // 64].ravel()
    levels = _levels(some, lowest, float(samples.max()))
    low, high = sorted(sign * level for level in levels)
    if not levels[1] > levels[0]:
        raise _no_pulses(edge, pulses_per_rev, "a constant" if np.isfinite(low) else "no finite sample")
    square = kind == "square" or _is_two_level(some, *levels)
    if square:
        half = 0.5 * settings.hysteresis_fraction * (high - low)
        at, level = _fired_square(samples, sign, 0.5 * (low + high), half)
    else:
        extremes = sorted(sign * level for level in _mark_levels(samples)) if pulses_per_rev == 1 else None
        low, high, rest, share, sure = _pickup_levels(sign * some, settings.pickup_level_fraction, extremes)
        at, level = _fired_pickup(
            samples, sign, low, high, rest, share, settings.hysteresis_fraction, sure, settings.envelope_teeth
        )
    settled_at = (low + SETTLED_SHARE * (high - low), high - SETTLED_SHARE * (high - low))
    position = np.empty(at.size)
    n, settled = _cross(samples, sign, at, level, *settled_at, position)
    position = position[:n]
    if n == 0:
        raise _no_pulses(edge, pulses_per_rev, f"levels {levels[0]:g} and {levels[1]:g}")
    variance = settled * QUANTISED_EDGE_SAMPLES**2 + (n - settled) * INTERPOLATED_EDGE_SAMPLES**2
    noise_samples = math.sqrt(variance / n)
    how = "quantised" if 2 * settled > n else "interpolated"
    detail = f"{settled} of {n} edges lie between settled samples: pulse noise {noise_samples:.3g} samples"
    flags: list[Remark] = [(f"encoder_edge_{how}", "info", detail)]
    if square and (spread := _spread(some, *levels)) > OVERLAP_SHARE:
        detail = f"not a square wave: its two levels scatter by {spread:.2f} of their distance"
        flags.append(("encoder_unclear", "suspect", detail))
    if math.isnan(lowest):
        n_missing = np.count_nonzero(np.isnan(samples))
        flags.append(("encoder_gap", "suspect", f"{n_missing} of {samples.size} encoder samples are not a number"))
    position /= rate_hz
    return Pulses(time_s=position, noise_s=noise_samples / rate_hz, flags=flags)


def _no_pulses(edge: str, pulses_per_rev: int, found: str) -> NoPulsesError:
    problem, allowed = f"no {edge} encoder edge found", f"{pulses_per_rev} pulses per revolution"
    remedy = "Check the encoder's cable, and its source, kind and edge in run.toml"
    return NoPulsesError(problem, place="encoder", found=found, allowed=allowed, remedy=remedy)


def _spread(some: npt.NDArray[Any], low: float, high: float) -> float:
    """Scatter of a trace about the nearer of its two levels, over their distance; 0.24 for a sine, 0.38 for noise."""
    finite = some[:: 1 + some.size // 20_000]
    finite = finite[np.isfinite(finite)]
    return float(np.std(np.abs(finite - 0.5 * (low + high)))) / (high - low)


def _is_two_level(some: npt.NDArray[Any], low: float, high: float) -> bool:
    """Whether the samples on both sides of the middle rest on a level."""
    finite, width = some[np.isfinite(some)], LEVEL_WIDTH * (high - low)
    above = finite > 0.5 * (low + high)
    sides = ((finite[above], high), (finite[~above], low))
    return all(np.count_nonzero(np.abs(side - level) < width) >= LEVEL_SHARE * side.size for side, level in sides)


def _levels(trace: npt.NDArray[Any], low: float, high: float) -> tuple[float, float]:
    """Lower and upper level: means below and above the middle of the range, taken twice to shed spikes.

    ``low`` and ``high`` are the extremes of all samples, of which ``trace`` holds enough.
    """
    if not np.isfinite(high - low):
        trace = trace[np.isfinite(trace)]
        if trace.size == 0:
            return np.inf, -np.inf
        low, high = float(trace.min()), float(trace.max())
    if ((trace == low) | (trace == high)).all():
        return low, high
    for _ in range(2):
        above = trace > 0.5 * (low + high)
        if above.any() and not above.all():
            low, high = (float(np.mean(side, dtype=np.float64)) for side in (trace[~above], trace[above]))
    return low, high


@njit(cache=True, nogil=True)
def _fired_square(trace, sign, middle, half):  # type: ignore[no-untyped-def]
    """First samples of ``sign * trace`` ``half`` above the ``middle`` since half below, and the middle for each."""
    at, n, i, low, high = np.empty(FIRST_PULSES, dtype=np.int64), 0, 0, middle - half, middle + half
    while True:
        while i < trace.size and not sign * trace[i] < low:
            i += 1
        while i < trace.size and not sign * trace[i] > high:
            i += 1
        if i == trace.size:
            return at[:n].copy(), np.full(n, middle)
        if n == at.size:
            at = np.concatenate((at, at))  # as much room again
        at[n] = i
        n += 1


def _mark_levels(samples: npt.NDArray[Any]) -> list[float]:
    """Extremes that three quarters of the blocks do not pass: a mark fills too little of its turn for quantiles."""
    blocks = samples[: samples.size // MARK_BLOCKS * MARK_BLOCKS].reshape(MARK_BLOCKS, -1)
    if blocks.size == 0:
        blocks = samples[None]
    lows, highs = np.sort(np.fmin.reduce(blocks, axis=1)), np.sort(np.fmax.reduce(blocks, axis=1))
    return [float(lows[lows.size // 4]), float(highs[-1 - highs.size // 4])]


def _pickup_levels(
    some: npt.NDArray[Any], share: float, extremes: list[float] | None
) -> tuple[float, float, int, float, float]:
    """Extremes of a pickup trace, where it rests (-1 low, 1 high, 0 neither), where to cut it, and how far from noise.

    The cut is a share of the height; the least distance from it that makes a pulse sure is in the trace's unit. The
    ``extremes`` are quantiles where they are not given.
    """
    finite = some[np.isfinite(some)]
    ordered = np.sort(finite[:: max(1, finite.size >> 13)])
    low, high = extremes or (float(ordered[ordered.size // 50]), float(ordered[-1 - ordered.size // 50]))
    height, width = high - low, REST_WIDTH * (high - low)
    rows = finite[: finite.size // 8 * 8].reshape(-1, 8)
    bend = np.sort(np.sqrt(np.mean(np.diff(rows, n=2, axis=1) ** 2, axis=1) / 6.0))
    noise = NOISE_MULTIPLE * float(bend[bend.size // 4]) if bend.size else 0.0
    sure = min(MAX_SURE_SHARE * height, max(MIN_SURE_SHARE * height, noise))
    at_low, at_high = float(np.mean(ordered < low + width)), float(np.mean(ordered > high - width))
    if max(at_low, at_high) < REST_SHARE or max(at_low, at_high) < 1.5 * min(at_low, at_high):
        return low, high, 0, 0.5, sure
    return low, high, (-1 if at_low > at_high else 1), min(0.5, max(share, noise / height)), sure


@njit(cache=True, nogil=True)
def _fired_pickup(trace, sign, full_low, full_high, rest, share, hysteresis, sure, envelope_teeth):  # type: ignore[no-untyped-def]
    """Samples at which each pulse of ``sign * trace`` is sure, and the level at which to cut it."""
    at, level_at = np.empty(FIRST_PULSES, dtype=np.int64), np.empty(FIRST_PULSES)
    n, armed, last = 0, False, 0.0
    block = min(trace.size, max(FIRST_BLOCK, trace.size // 64))
    interval = block / 8.0
    low, high = full_high, full_low
    for i in range(block):
        low, high = min(low, max(sign * trace[i], full_low)), max(high, min(sign * trace[i], full_high))
    peak = trough = level = low
    for i in range(trace.size):
        value = sign * trace[i]
        height = max(high - low, 0.0)
        if rest == 0:
            level = 0.0 if low < 0.0 < high and min(-low, high) > 0.25 * height else 0.5 * (low + high)
            band = max(sure, 0.5 * hysteresis * height)
        else:
            off = max(2.0 * sure, share * height)
            level = low + off if rest < 0 else high - off
            band = max(sure, hysteresis * share * height)
        if armed:
            trough = min(trough, value)
            if value > level + band:
                if n == at.size:
                    at, level_at = np.concatenate((at, at)), np.concatenate((level_at, level_at))  # as much room again
                at[n], level_at[n] = i, level
                n += 1
                low += (trough - low) / envelope_teeth
                armed, peak, interval, last = False, value, i - last, float(i)
        else:
            peak = max(peak, value)
            if value < level - band:
                if n > 0:
                    high += (peak - high) / envelope_teeth
                armed, trough = True, value
        if i - last > 2.0 * envelope_teeth * interval:
            # the wheel slows or its pulses fade: look for pulses of half the height
            shrink, last = 0.25 * (high - low), float(i)
            low, high = (low if rest < 0 else low + shrink), (high if rest > 0 else high - shrink)
    return at[:n].copy(), level_at[:n].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _cross(trace, sign, fired, level, bottom, top, position):  # type: ignore[no-untyped-def]
    """Fill ``position`` [samples] with the crossings of ``level`` before ``fired``.

    Returns how many there are, and how many of them lie between samples below ``bottom`` and above ``top``.
    """
    n, settled = 0, 0
    for k in range(fired.size):
        i, cut = fired[k], level[k]
        while i > 0 and sign * trace[i - 1] > cut:
            i -= 1
        if i > 0 and sign * trace[i - 1] <= cut:
            before, after = sign * trace[i - 1], sign * trace[i]
            position[n] = i - 1 + (cut - before) / (after - before)
            n += 1
            settled += before < bottom and after > top
    return n, settled


def listed_times(time_s: Floats) -> str:
    """Words for the times ``time_s`` (events,) [s]: the first five, and how many more there are."""
    listed = ", ".join(f"{value:.6g}" for value in time_s[:5])
    return f"at {listed} s" + (f" and {time_s.size - 5} more" if time_s.size > 5 else "")


FEWEST_SAMPLES_PER_TOOTH = 2.5
"""A tooth and its gap need a sample each, and the fastest teeth of a turn are shorter than the mean."""

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


class Position(NamedTuple):
    """``pulses`` made of a position, ``pulses_per_rev`` of them, and the times at which it passes whole turns.

    ``turn_s`` (turns,) are these times [s], ``cycle_s`` (cycles,) those [s] at which an angle of two turns starts anew,
    None where it does not. ``is_mark`` says whether the zero of the position is a place on the shaft, and not where a
    counter happened to start.
    """

    pulses: Pulses
    pulses_per_rev: int
    turn_s: Floats
    cycle_s: Floats | None
    is_mark: bool


def position_pulses(
    position: npt.NDArray[np.floating], *, rate_hz: float, units_per_rev: Sequence[float], counted: bool
) -> Position:
    """Pulses of the sampled position of a shaft that turns either way.

    Parameters
    ----------
    position : (samples,), angle or count, which starts anew after any number, or grows or falls without end; NaN where
        unknown
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
    return np.asarray(0.5 * (highest + np.minimum.accumulate(turns[::-1])[::-1]))


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
    """Units after which ``values`` (samples,) start anew, 0 for never, and whether all steps but the jumps are alike.

    None where they do not go in one direction, as a position does.
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
        slack, share = (SAME_COUNTS, LOST_COUNTS) if counted else (0.0, SAME_TURN)
        near = [wrap for wrap in wraps if abs(jump - wrap) <= slack + share * wrap]
        if jump == 0.0 or (near and (turns <= 2 or len(units_per_rev) == 1)):
            return unit, near[0] if near else 0.0
    place, remedy, allowed = "encoder.source", "Mend its unit", "360 deg, 6.2832 rad, 1 rev, and multiples"
    if counted:
        place, remedy = "encoder.pulses_per_rev", "State the counts of a turn, four for each line of most encoders"
        allowed = "pulses_per_rev, where an index sets the count to 0, or 65536 and other widths of counters"
    found = " or ".join(f"{unit:g} per revolution" for unit in units_per_rev)
    problem = f"the position starts anew after {jump:.5g}, which is no whole turn"
    raise InputError(problem, place=place, found=found, allowed=allowed, remedy=remedy)


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
