"""Teeth that sit wrongly, learned from one recording: the same in each revolution, and white over the wheel's harmonics.

Motion of a shaft falls with its order: torque falls, and a flywheel turns by 1/order² of it. Teeth that are cut wrongly
by chance err alike at all harmonics of the wheel. So the high harmonics tell how large the teeth's errors are, and an
order that is no larger than these is theirs; one that stands out is motion, with the teeth's error as its doubt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from crankorder.settings import ShaftSettings
from crankorder.shaft.line_pattern import LinePattern, even_line_times, first_order, line_pattern
from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.wheel import NumberedTeeth

# Crank order up to which masses and gas turn the shaft noticeably; the share of the wheel's lines that is "high" too.
HIGHEST_MOTION, HIGH_SHARE = 6.0, 0.125
# Lines of a wheel whose high harmonics are enough to be called white.
FEWEST_LINES = 20
# Mean power of the high harmonics over the variance of their own errors.
SURE_POWER = 10.0
# The upper half of the high harmonics has at least this share of the power of the lower: motion falls by more.
LEAST_FLATNESS = 0.15
# Power over that of the teeth at which a low order is motion: by chance one in 400; and chance of any of the high ones.
STANDS_OUT, CHANCE = 6.0, 0.01
# Root of the power below which the amplitude of a harmonic of white errors is with a chance of 95 %, in roots of means.
REACH_95 = math.sqrt(-math.log(0.05))

UNKNOWN_REV = "tooth_doubt_rev"
"""Attribute of a ShaftAngle: amplitude [rev] of the crank angle that teeth may give to any order of the encoder."""


@dataclass(frozen=True, eq=False)
class ToothErrors:
    """Errors of a wheel's teeth: ``line_error_rev`` (line,) true place less where it should be, in encoder revolutions.

    Line 0 is tooth number 0. ``rms_share`` is their size over the pitch; ``level_rev`` the root of the mean square
    amplitude [rev] of a harmonic of them, below which motion and teeth are not told apart; ``kept`` (harmonics) are
    those that stand out and stay as motion, ``standard_error_rev`` what is left in the angle.
    """

    line_error_rev: FloatArray
    rms_share: float
    level_rev: float
    kept: tuple[int, ...]
    standard_error_rev: float
    n_revs: int


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
    pattern = _pattern(teeth, ratio, revs_per_cycle, noise_s)
    if not pattern.n_revs:
        return None
    found = _told(pattern, ratio, settings.least_tooth_error)
    if found is None:
        return None
    # what teeth and motion make together is known once the teeth are
    again = _told(first_order(pattern, found.line_error_rev), ratio, settings.least_tooth_error)
    return again or found


def without_tooth_errors(teeth: NumberedTeeth, errors: ToothErrors) -> NumberedTeeth:
    """``teeth`` at the times at which they would have come without their ``errors``."""
    times = even_line_times(teeth.time_s, teeth.tooth, errors.line_error_rev, index_tooth=0.0)
    return replace(teeth, time_s=times) if bool((np.diff(times) > 0.0).all()) else teeth


def tooth_remark(errors: ToothErrors, lines: int, ratio: float) -> Remark:
    """What the ``errors`` of a wheel of so many ``lines`` say; ``ratio``: encoder revolutions per crank revolution."""
    doubt = 2.0 * math.pi * errors.level_rev * REACH_95
    kept = ", ".join(f"{harmonic * ratio:g}" for harmonic in errors.kept)
    stays = f"; orders {kept} stand out of them and stay as motion of the shaft" if kept else ""
    low = max(1, int(HIGHEST_MOTION / ratio))
    detail = (
        f"the {lines} teeth of the wheel stand off by {errors.rms_share:.2g} of their pitch "
        f"({360.0 * errors.rms_share / lines:.2g}° rms), the same in each of {errors.n_revs} revolutions and alike at all "
        f"harmonics, as no shaft turns: taken out of the angle{stays}. Of the speed within the revolution a swing of "
        f"less than {100.0 * doubt:.2g} % at order {ratio:g}, {100.0 * doubt * low:.2g} % at order {ratio * low:g}, may "
        f"be either"
    )
    return ("encoder_tooth_errors", "info", detail)


def _pattern(teeth: NumberedTeeth, ratio: float, revs_per_cycle: int, noise_s: float) -> LinePattern:
    """Pattern over whole engine cycles, or over revolutions where there are too few of these."""
    lines, made = teeth.teeth_per_rev, None
    for cycle in (revs_per_cycle, 1):
        made = line_pattern(
            teeth.time_s,
            teeth.tooth,
            teeth_per_encoder_rev=lines,
            index_tooth=0.0,
            index_period=float(lines),
            ratio=ratio,
            revs_per_cycle=cycle,
            noise_s=noise_s,
        )
        if made.n_revs:
            break
    assert made is not None
    return made


def _told(pattern: LinePattern, ratio: float, least_share: float) -> ToothErrors | None:
    """The errors of the teeth in ``pattern``; None where its high harmonics are not those of teeth."""
    lines = pattern.deviation_rev.size
    power = np.abs(pattern.harmonic_rev) ** 2
    harmonic = np.arange(power.size)
    low = (harmonic >= 1) & (harmonic * ratio <= HIGHEST_MOTION)
    high = harmonic > max(HIGHEST_MOTION / ratio, HIGH_SHARE * lines)
    level = _white_level(power, pattern.harmonic_variance, low, high)
    rms = math.sqrt(0.25 * lines * level)
    if not rms * lines > least_share:
        return None
    limit = np.where(low, STANDS_OUT, math.log(power.size / CHANCE)) * level
    stands = (harmonic >= 1) & (power > limit)
    own = np.where(stands | (harmonic == 0), 0.0, pattern.harmonic_rev)
    error: FloatArray = np.fft.irfft(own * (lines / 2.0), lines)
    left = float(np.sum(stands)) * level + float(np.sum(0.5 * power[low & ~stands]))
    left += float(np.sum(pattern.harmonic_variance[1:]))
    kept = tuple(np.flatnonzero(stands).tolist())
    return ToothErrors(error, rms * lines, math.sqrt(level), kept, math.sqrt(0.5 * left), pattern.n_revs)


def _white_level(
    power: FloatArray, variance: FloatArray, low: npt.NDArray[np.bool_], high: npt.NDArray[np.bool_]
) -> float:
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
