"""Teeth that sit wrongly, learned from one recording, told from the torsional fluctuation of the shaft itself.

Motion of a shaft falls with its order: torque falls, and a flywheel turns by 1/order² of it. Teeth that are cut wrongly
by chance err alike at all harmonics of the wheel. So the high harmonics tell how large the teeth's errors are, and an
order that is no larger than these is theirs; one that stands out is motion, with the teeth's error as its doubt.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from crankorder.quantities import Attribute, Bools, Complexes, Floats, Ints
from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import Remark
from crankorder.shaft.wheel import NumberedTeeth

# Crank order up to which masses and gas turn the shaft noticeably; the share of the wheel's lines that is "high" too.
HIGHEST_MOTION, HIGH_SHARE = 6.0, 0.125
# Lines of a wheel whose high harmonics are enough to be called white.
FEWEST_LINES = 20
# Mean power of the high harmonics over the variance of their own errors.
SURE_POWER = 10.0
# The upper half of the high harmonics has at least this share of the power of the lower: motion falls by more.
LEAST_FLATNESS = 0.15
# Chance that a low harmonic of the teeth counts as motion, and that any of the high ones does.
CHANCE_LOW, CHANCE_HIGH = 0.0025, 0.01

PRINTED = 8
"""Harmonics by which a wheel is known again."""

ALIKE = 0.4
"""Share of the power of two patterns that their product has at least where they are one: half where they are equal."""

TOOTH_LEVEL, TOOTH_KEPT, TOOTH_PRINT = "tooth_level_rev", "tooth_low_kept", "tooth_print_rev"
"""Attributes of a ShaftAngle: root of the mean square amplitude [rev] of the crank angle that teeth give to each order
of the encoder, whether those of low orders are left in it, real and imaginary parts [rev] of some, from angle 0."""

TOOTH_ORDER, TOOTH_DOUBT = "tooth_order", "tooth_doubt_rev"
"""Attributes of a ShaftAngle: crank order at whose multiples the teeth err, 0 where they are not known to, and the
amplitude [rev] there up to which motion may be theirs."""


class ToothErrors(NamedTuple):
    """Errors of a wheel's teeth: ``line_error_rev`` (lines,), true place less ideal place, in encoder revolutions.

    Line 0 is tooth number 0. ``rms_share`` is their root mean square over the pitch; ``level_rev`` the root of the mean
    square amplitude [rev] of a harmonic of them, below which motion and teeth are not told apart; ``kept`` harmonics
    stay in the angle, ``motion`` are those of them that stand out, of more than ``least_motion_rev`` where low.
    ``standard_error_rev`` is the error [rev] left in the angle, ``n_revs`` the number of revolutions looked at,
    ``print_rev`` (harmonics,) the amplitudes [rev] of some harmonics, from the ``first_printed`` one on, by which a
    wheel is recognised.
    """

    line_error_rev: Floats
    rms_share: float
    level_rev: float
    kept: tuple[int, ...]
    motion: tuple[int, ...]
    least_motion_rev: float
    standard_error_rev: float
    n_revs: int
    print_rev: Complexes
    first_printed: int


def tooth_errors(
    teeth: NumberedTeeth, *, ratio: float, revs_per_cycle: int, noise_s: float, settings: ShaftSettings
) -> ToothErrors | None:
    """Errors of the teeth of one recording; None where it shows none, or where motion may look the same.

    Parameters
    ----------
    teeth : numbered pulses of one run
    ratio : encoder revolutions per crank revolution
    revs_per_cycle : crank revolutions per engine cycle
    noise_s : standard deviation of one pulse time, s; 0 where it is not stated
    settings : ``least_tooth_error``, the share of the pitch from which errors are taken out
    """
    lines = teeth.teeth_per_rev
    if lines < FEWEST_LINES:
        return None
    repeating = functools.partial(
        line_pattern, teeth.time_s, teeth.tooth, teeth_per_encoder_rev=lines, ratio=ratio, noise_s=noise_s
    )
    pattern = repeating(revs_per_cycle=revs_per_cycle) or repeating(revs_per_cycle=1)
    if pattern is None:
        return None
    return _errors_in(pattern, ratio, settings.least_tooth_error, engine=revs_per_cycle > 1)


def without_tooth_errors(teeth: NumberedTeeth, errors: ToothErrors) -> NumberedTeeth:
    """``teeth`` at the times at which they would have come without their ``errors``, as long as these times rise.

    Tooth numbers keep their meaning: angle 0 is the ideal place of line 0, by the mean of all lines.
    """
    time_s, tooth, lines = teeth.time_s, teeth.tooth, errors.line_error_rev.size
    # over a part of a revolution that averages the noise of pulses, and in which the speed hardly changes
    reach = max(1, round(lines / 48 * time_s.size / (tooth[-1] - tooth[0] + 1)))
    at = np.arange(time_s.size)
    before, after = np.maximum(at - reach, 0), np.minimum(at + reach, at.size - 1)
    moved = time_s
    for _ in range(SPEED_ROUNDS):
        tooth_s = (moved[after] - moved[before]) / (tooth[after] - tooth[before])
        moved = time_s - errors.line_error_rev[tooth % lines] * lines * tooth_s
    return teeth._replace(time_s=moved) if (np.diff(moved) > 0.0).all() else teeth


def tooth_remark(errors: ToothErrors, lines: int, ratio: float) -> Remark:
    """Remark on the ``errors`` of a wheel with so many ``lines``; ``ratio``: encoder per crank revolutions."""
    doubt = 2.0 * math.pi * errors.least_motion_rev
    moved = ", ".join(f"{harmonic * ratio:g}" for harmonic in errors.motion)
    stays = f"; order {moved} stands out of them: motion of the shaft" if moved else ""
    if len(errors.kept) > len(errors.motion):
        stays += f"; up to order {HIGHEST_MOTION:g} the angle stays as shown, for a shaft may swing there"
    low = max(1, int(HIGHEST_MOTION / ratio))
    detail = (
        f"the {lines} teeth of the wheel stand off by {errors.rms_share:.2g} of their pitch "
        f"({360.0 * errors.rms_share / lines:.2g}° rms), the same in each of {errors.n_revs} revolutions and alike at "
        f"all harmonics, as no shaft turns: taken out of the angle{stays}. Of the speed within the revolution a swing "
        f"of less than {100.0 * doubt:.2g} % at order {ratio:g}, {100.0 * doubt * low:.2g} % at order "
        f"{ratio * low:g}, may be either"
    )
    return ("encoder_tooth_errors", "info", detail)


def stated_teeth(errors: ToothErrors | None, *, ratio: float, tdc_rev: float) -> dict[str, Attribute]:
    """Attributes of a ShaftAngle that say how much of its motion may come from the ``errors`` of the teeth.

    ``ratio`` is encoder revolutions per crank revolution, ``tdc_rev`` the crank angle [rev] of top dead centre from
    tooth 0.
    """
    if errors is None:
        return {TOOTH_LEVEL: 0.0, TOOTH_ORDER: 0.0, TOOTH_DOUBT: 0.0}
    first = errors.first_printed
    turn = np.exp(2j * np.pi * ratio * tdc_rev * np.arange(first, first + errors.print_rev.size))
    printed = (errors.print_rev * turn).view(np.float64).tolist()
    low = int(bool(errors.kept))
    known = {TOOTH_LEVEL: errors.level_rev / ratio, TOOTH_DOUBT: errors.least_motion_rev / ratio}
    return known | {TOOTH_ORDER: ratio, TOOTH_KEPT: low, TOOTH_PRINT: printed}


def same_wheel(stated: Sequence[Mapping[str, Attribute]]) -> bool:
    """Whether the teeth whose attributes are ``stated`` err alike, as far as they are known to err."""
    prints = [np.asarray(attributes[TOOTH_PRINT]) for attributes in stated if TOOTH_PRINT in attributes]
    if any(own.shape != prints[0].shape for own in prints):
        return False
    return all(float(own @ prints[0]) > ALIKE * float(own @ own + prints[0] @ prints[0]) for own in prints[1:])


def _errors_in(pattern: LinePattern, ratio: float, least_share: float, *, engine: bool) -> ToothErrors | None:
    """The errors of the teeth in ``pattern``; None where its high harmonics are not those of teeth.

    The shaft of an ``engine`` swings at low orders, seen or not.
    """
    lines = pattern.lines
    power = np.abs(pattern.harmonic_rev) ** 2
    harmonic = np.arange(power.size)
    low = (harmonic >= 1) & (harmonic * ratio <= HIGHEST_MOTION)
    # the last harmonic of an even number of lines has no phase, and is spread in another way
    high = (harmonic > max(HIGHEST_MOTION / ratio, HIGH_SHARE * lines)) & (2 * harmonic < lines)
    level = _white_level(power, pattern.harmonic_variance, low, high)
    rms = math.sqrt(0.25 * lines * level)
    if not rms * lines > least_share:
        return None
    count = int(high.sum())
    limits = (_limit(CHANCE_LOW, count), _limit(CHANCE_HIGH / count, count))
    stands = (harmonic >= 1) & (power > np.where(low, *limits) * level)
    # no tooth makes the orders between those of the encoder
    order = np.arange(pattern.cycle_rev.size)
    between = (order % pattern.period_revs > 0) & (order * ratio / pattern.period_revs <= HIGHEST_MOTION)
    swings = engine or (stands & low).any() or (np.abs(pattern.cycle_rev[between]) ** 2 > level).any()
    # where a shaft swings at one low order it may at all of them: sidebands tell how much of these is the teeth's
    kept = stands | (low & bool(swings))
    own = np.where(kept | (harmonic == 0), 0.0, pattern.harmonic_rev)
    left = float(np.sum(kept)) * level + float(np.sum(power[low & ~kept]))
    left += float(np.sum(pattern.harmonic_variance[1:]))
    return ToothErrors(
        line_error_rev=np.fft.irfft(own * (lines / 2.0), lines),
        rms_share=rms * lines,
        level_rev=math.sqrt(level),
        kept=tuple(np.flatnonzero(kept).tolist()),
        motion=tuple(np.flatnonzero(stands).tolist()),
        least_motion_rev=math.sqrt(limits[0] * level),
        standard_error_rev=math.sqrt(0.5 * left),
        n_revs=pattern.n_revs,
        print_rev=pattern.harmonic_rev[high][:PRINTED],
        first_printed=int(np.argmax(high)),
    )


def _limit(chance: float, count: int) -> float:
    """Power over the level that one more harmonic exceeds by ``chance``, the level being the median of ``count``."""
    # a median tells the mean of an exponential distribution as well as the mean of half as many would
    known = 0.5 * count
    return float(known * (chance ** (-1.0 / known) - 1.0))


def _white_level(power: Floats, variance: Floats, low: Bools, high: Bools) -> float:
    """Mean ``power`` (harmonics,) [rev²] of the teeth's errors by their ``high`` ones; 0 where these are not white."""
    own, noise = power[high], variance[high]
    if own.size < 4:
        return 0.0
    level = float(np.median(own)) / math.log(2.0)
    half = own.size // 2
    first, second = (float(np.exp(np.mean(np.log(np.maximum(part, 1e-300))))) for part in (own[:half], own[half:]))
    # the strongest motion by speed goes on with 1/order² of it, as torque does behind a flywheel: 1/order³ of the angle
    order = np.arange(power.size)
    motion = float(np.max(power[low] * order[low] ** 6.0, initial=0.0))
    beyond = float(np.median(own * order[high] ** 6.0))
    white = second > LEAST_FLATNESS * first and beyond > motion
    return level if white and level > SURE_POWER * float(np.median(noise)) else 0.0


# Teeth that are enough: a hundred-thousandth of a revolution per pulse is then known to a hundred-millionth.
MOST_TEETH = 1 << 20
# Fewest periods of the in-cycle motion whose scatter tells the error of their mean, and most groups of them.
FEWEST_PERIODS, MOST_BATCHES = 4, 16
# Encoder revolutions after which crank and cycle must be back where they were; if they need more, they count as never.
LONGEST_PERIOD_REVS = 16
# Pulse times in which the tick of a counter is looked for; changes of interval that it takes, and how whole they are.
SOME_TIMES, FEWEST_STEPS, COUNT_SLACK = 1024, 32, 0.05
# Lines whose places between samples are looked at, and harmonics of the sawtooth by which sampling rounds.
SOME_LINES, SAWTOOTH_HARMONICS = 32, 4
# Rounding that is the same in every period is not spread evenly over the orders: those that matter may get more.
GATHERED = 1.5
# Encoder orders up to which motion between those of the teeth is sought; least part of an order that the means leave.
LOW_ORDERS, LEAST_GAIN = 24, 0.005
# Times that the speed at a line is taken: at first the errors of the lines beside it are in it.
SPEED_ROUNDS = 2


class LinePattern(NamedTuple):
    """Mean deviation [rev] of each of the ``lines`` of one recording from its place line / lines in even rotation.

    Line 0 is tooth number 0; lines that the wheel does not have are filled in from their neighbours. ``harmonic_rev``
    (orders,) are the complex amplitudes of the places by order of the encoder, ``harmonic_variance`` (orders,) the mean
    squares of their errors [rev²]. ``cycle_rev`` (low orders,) are the complex amplitudes of the orders 0, 1/k, 2/k …
    of the k = ``period_revs`` encoder revolutions in which the motion repeats. ``n_revs`` encoder revolutions were
    looked at.
    """

    lines: int
    harmonic_rev: Complexes
    harmonic_variance: Floats
    cycle_rev: Complexes
    period_revs: int
    n_revs: int


def line_pattern(
    time_s: Floats,
    tooth: Ints,
    *,
    teeth_per_encoder_rev: int,
    ratio: float = 1.0,
    revs_per_cycle: int = 1,
    noise_s: float = 0.0,
) -> LinePattern | None:
    """Mean deviation of each line over all revolutions of a recording; None where these are too few: below six periods.

    Drift and slow wobble of the speed are taken out by twice subtracting the mean over one revolution: a speed that
    changes up to quadratically with angle leaves nothing, and no order of the encoder is touched.

    Parameters
    ----------
    time_s : (pulses,), s, increasing
    tooth : (pulses,), tooth numbers, increasing; holes are teeth without a pulse
    teeth_per_encoder_rev : teeth of the even wheel (or grid) per revolution of the encoder
    ratio : encoder revolutions per crank revolution
    revs_per_cycle : crank revolutions after which the in-cycle motion repeats, 1 or 2
    noise_s : standard deviation of one pulse time by sampling, s; what of it does not average out, because the shaft
        keeps step with the samples, is counted as error of every line; 0 where it is not known
    """
    lines = teeth_per_encoder_rev
    stop = int(np.searchsorted(tooth, tooth[0] + MOST_TEETH))
    time_s, tooth = time_s[:stop], tooth[:stop]
    # encoder revolutions in which the engine makes whole cycles; 1 where there is no such small number
    cycles = np.arange(1, LONGEST_PERIOD_REVS + 1) / (ratio * revs_per_cycle)
    whole = np.flatnonzero(np.abs(cycles - np.rint(cycles)) < 1e-9)
    period = lines * (int(whole[0]) + 1 if whole.size else 1)
    place = tooth - tooth[0]
    tooth_s = float((time_s[-1] - time_s[0]) / place[-1])
    rest = (time_s - time_s[0]) - tooth_s * place
    if place[-1] + 1 > place.size:
        rest = np.interp(np.arange(place[-1] + 1), place, rest)
    deviation, first, rev_s = _deviation(rest, tooth_s, lines, period)
    n_periods = deviation.size // period
    if n_periods < FEWEST_PERIODS:
        return None
    used = n_periods * period
    by_period = (deviation[:used] / rev_s[:used]).reshape(n_periods, period)
    shift = (int(tooth[0]) + first) % lines
    present = np.zeros(rest.size, dtype=np.bool_)
    present[place] = True
    _fill(by_period, present[first : first + used])
    mean_rev_s = math.sqrt(float(np.mean(rev_s[:used] ** 2)))
    smooth_s = rest[first : first + used] - deviation[:used] + tooth_s * np.arange(used)
    steps = max(noise_s, _tick_s(time_s) / math.sqrt(12.0))
    fixed = _fixed_noise(smooth_s.reshape(n_periods, period), by_period, steps, mean_rev_s)
    return _averaged(by_period, shift, lines, fixed)


def _deviation(rest_s: Floats, tooth_s: float, lines: int, period: int) -> tuple[Floats, int, Floats]:
    """What is left [s] of twice subtracting the mean over a revolution, the tooth of its first value, revolution times.

    ``rest_s``: (teeth,), times less those of even rotation at ``tooth_s``. The revolution time [s] of each value is the
    mean over the ``period`` around it.
    """
    half = lines // 2
    once = rest_s[half : rest_s.size - half] - _revolution_mean(rest_s, lines)
    twice = once[half : once.size - half] - _revolution_mean(once, lines)
    before = (period + 1) // 2
    skip = max(0, before - 2 * half)
    at = 2 * half + skip
    n = max(0, min(twice.size - skip, rest_s.size - at - (period - before)))
    long = rest_s[at + period - before : at + period - before + n] - rest_s[at - before : at - before + n]
    return twice[skip : skip + n], at, (long + period * tooth_s) * (lines / period)


def _tick_s(time_s: Floats) -> float:
    """Tick [s] of the clock that all ``time_s`` are counts of; 0 where none is seen."""
    step = np.abs(np.diff(time_s[:SOME_TIMES], n=2))
    resolution = 4.0 * float(np.spacing(np.abs(time_s[:SOME_TIMES]).max()))
    step = step[step > resolution]
    if step.size < FEWEST_STEPS:
        return 0.0
    tick = float(step.min())
    counts = step / tick
    return tick if np.abs(counts - np.rint(counts)).max() < COUNT_SLACK else 0.0


def _revolution_mean(value: Floats, lines: int) -> Floats:
    """Mean over the revolution around each value, the first and last ``lines // 2`` of them left out."""
    if value.size <= lines:
        return np.empty(max(0, value.size - 2 * (lines // 2)))
    total = np.concatenate([np.zeros(1), np.cumsum(value)])
    over = (total[lines:] - total[:-lines]) / lines
    return np.asarray(over if lines % 2 else 0.5 * (over[:-1] + over[1:]))


def _fill(by_period: Floats, present: Bools) -> None:
    """Give teeth without a pulse, in ``by_period`` (period, tooth), the mean of their line in its place."""
    if present.all():
        return
    there = present.reshape(by_period.shape)
    count = there.sum(axis=0)
    mean = np.where(there, by_period, 0.0).sum(axis=0) / np.maximum(count, 1)
    column = np.arange(mean.size)
    known = count > 0
    mean = np.interp(column, column[known], mean[known], period=mean.size)
    by_period[~there] = np.broadcast_to(mean, by_period.shape)[~there]


def _fixed_noise(smooth_s: Floats, by_period: Floats, noise_s: float, rev_s: float) -> float:
    """Variance [rev²] of a line by sampling that is the same in every period, so that no mean takes it away.

    Sampling rounds a time by a sawtooth of its place between two samples; harmonic k of it averages out as far as the
    places of the line, from period to period, do. ``smooth_s``: (period, tooth), s, times without the pattern.
    ``by_period``: as long, rev, deviations. ``noise_s``: standard deviation of the rounding; ``rev_s``: a revolution.
    """
    if not noise_s > 0.0:
        return 0.0
    n_periods, period = smooth_s.shape
    some = smooth_s[:, :: max(1, period // SOME_LINES)]
    turn = np.exp(2j * np.pi / (noise_s * math.sqrt(12.0)) * some)
    harmonic, shares = np.ones_like(turn), 1.0 / np.arange(1, SAWTOOTH_HARMONICS + 1) ** 2
    kept = 0.0
    for share in shares / shares.sum():
        harmonic *= turn
        together = float(np.mean(np.abs(harmonic.mean(axis=0)) ** 2))
        kept += float(share) * max(0.0, together - 1.0 / n_periods) / (1.0 - 1.0 / n_periods)
    # jitter, and in-cycle motion that is not the same each time, show as scatter: so much is not fixed
    steps = np.diff(by_period, axis=1)
    seen = float(steps.var(axis=0, ddof=1).mean()) / 2.0
    rounding = (noise_s / rev_s) ** 2
    return GATHERED * max(0.0, min(kept * rounding, rounding - seen))


def _averaged(by_period: Floats, shift: int, lines: int, fixed: float) -> LinePattern:
    """The pattern of deviations [rev] ``by_period`` (period, tooth of the period), whose first tooth is line ``shift``.

    Errors by order come from the scatter between groups of periods: slow motion, which falls on low orders, shows
    there as it should. ``fixed`` [rev²] is the variance of a line that does not show as scatter.
    """
    n_batches = n_periods = by_period.shape[0]
    if n_periods > MOST_BATCHES:  # equal groups that leave the fewest periods over
        n_batches = min(range(MOST_BATCHES, MOST_BATCHES // 2 - 1, -1), key=lambda count: n_periods % count)
    size = n_periods // n_batches
    revs = by_period.shape[1] // lines
    batch = by_period[: n_batches * size].reshape(n_batches, size * revs, lines).mean(axis=1)
    batch = np.roll(batch, shift, axis=1)
    batch -= batch.mean(axis=1, keepdims=True)
    harmonic = np.fft.rfft(batch, axis=1) * (2.0 / lines)
    mean = harmonic.mean(axis=0)
    scatter = np.sum(np.abs(harmonic - mean) ** 2, axis=0) / (n_batches * (n_batches - 1))
    # few groups tell the scatter of one order roughly, of many well: its squares are as chi-squared (Wilson, Hilferty
    # 1931), and a mean over its estimated error as Student's t, whose variance is larger
    freedom = 2.0 * (n_batches - 1)
    usual = float(np.median(scatter[1:])) / (1.0 - 2.0 / (9.0 * freedom)) ** 3
    variance = np.maximum(scatter, usual) * (freedom / (freedom - 2.0)) + 4.0 * fixed / lines
    n_revs = n_batches * size * revs
    cycle = _cycle_amplitudes(np.roll(by_period.mean(axis=0), shift), lines)
    return LinePattern(lines, mean, variance, cycle, revs, n_revs)


def _cycle_amplitudes(value: Floats, lines: int) -> Complexes:
    """Complex amplitudes of the low orders of ``value`` (tooth of the period,), as before the means were subtracted."""
    revs = value.size // lines
    spectrum = np.fft.rfft(value)[: min(LOW_ORDERS, lines // 4) * revs + 1] * (2.0 / value.size)
    angle = np.pi * np.arange(1, spectrum.size) / revs
    mean = np.sin(angle) / (lines * np.sin(angle / lines)) * (1.0 if lines % 2 else np.cos(angle / lines))
    gain = (1.0 - mean) ** 2
    spectrum[0] = 0.0
    spectrum[1:] = np.where(gain > LEAST_GAIN, spectrum[1:] / np.maximum(gain, LEAST_GAIN), 0.0)
    return spectrum
