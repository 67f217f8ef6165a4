"""Teeth that sit wrongly, learned from one recording, told from the torsional fluctuation of the shaft itself.

Motion of a shaft falls with its order: torque falls, and a flywheel turns by 1/order² of it. Teeth that are cut wrongly
by chance err alike at all harmonics of the wheel. So the high harmonics tell how large the teeth's errors are, and an
order that is no larger than these is theirs; one that stands out is motion, with the teeth's error as its doubt.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.errors import printable
from crankorder.findings import SpeedSwing as SpeedSwingFinding
from crankorder.quantities import Attribute, Bools, Complexes, Floats
from crankorder.settings import ShaftSettings
from crankorder.shaft.line_pattern import LinePattern, even_line_times, first_order, line_pattern
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


@dataclass(frozen=True, eq=False)
class ToothErrors:
    """Errors of a wheel's teeth: ``line_error_rev`` (line,) true place less where it should be, in encoder revolutions.

    Line 0 is tooth number 0. ``rms_share`` is their size over the pitch; ``level_rev`` the root of the mean square
    amplitude [rev] of a harmonic of them, below which motion and teeth are not told apart; ``kept`` (harmonics) stay in
    the angle, ``motion`` (harmonics) are those of them that stand out, of more than ``least_motion_rev`` where low;
    ``standard_error_rev`` is what is left in the angle, ``print_rev`` amplitudes [rev] of some harmonics, from the
    ``first_printed`` one on, by which a wheel is known again.
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
    errors = _errors_in(pattern, ratio, settings.least_tooth_error, engine=revs_per_cycle > 1)
    if errors is None:
        return None
    # what teeth and motion make together is known once the teeth are
    added = first_order(pattern, errors.line_error_rev)
    return _errors_in(added, ratio, settings.least_tooth_error, engine=revs_per_cycle > 1) or errors


def without_tooth_errors(teeth: NumberedTeeth, errors: ToothErrors) -> NumberedTeeth:
    """``teeth`` at the times at which they would have come without their ``errors``."""
    times = even_line_times(teeth.time_s, teeth.tooth, errors.line_error_rev)
    return replace(teeth, time_s=times) if bool((np.diff(times) > 0.0).all()) else teeth


def tooth_remark(errors: ToothErrors, lines: int, ratio: float) -> Remark:
    """What the ``errors`` of a wheel of so many ``lines`` say; ``ratio``: encoder revolutions per crank revolution."""
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
    """Attributes of a ShaftAngle that say what of its motion may be the ``errors`` of the teeth.

    ``ratio``: encoder revolutions per crank revolution. ``tdc_rev``: crank angle [rev] of top dead centre from tooth 0.
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
    # where a shaft swings at one low order it may at all of them: sidebands tell how much of these is the teeth's
    kept = stands | (low & (engine or bool((stands & low).any()) or _swings_between(pattern, ratio, level)))
    own = np.where(kept | (harmonic == 0), 0.0, pattern.harmonic_rev)
    error: Floats = np.fft.irfft(own * (lines / 2.0), lines)
    left = float(np.sum(kept)) * level + float(np.sum(power[low & ~kept]))
    left += float(np.sum(pattern.harmonic_variance[1:]))
    return ToothErrors(
        line_error_rev=error,
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


def _swings_between(pattern: LinePattern, ratio: float, level: float) -> bool:
    """Whether the shaft swings at orders between those of the encoder, which no tooth makes, as much as teeth do."""
    revs = pattern.period_revs
    order = np.arange(pattern.cycle_rev.size)
    between = (order % revs > 0) & (order * ratio / revs <= HIGHEST_MOTION)
    return bool((np.abs(pattern.cycle_rev[between]) ** 2 > level).any())


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


HIGHEST = 12.0
"""Order up to which the swing is told: gas and inertia of a few cylinders lie below."""

KNOTS_PER_PERIOD = 2.5
"""An order is told where angle and speed are known so many times a period of it, or more often."""

SURE = 5.0
"""Standard errors of the mean cycle that a swing must exceed: a test has many orders and recordings."""

LEAST_SHARE = 0.0005
"""Of the mean speed: a smaller swing is not worth mention, and within what encoders err."""

BETWEEN = 8
"""Places at which the speed is taken from one knot to the next."""

FEWEST_CYCLES = 2
"""Whole cycles of a recording from which on its swing is told."""


@dataclass(frozen=True)
class SpeedSwing:
    """Peak amplitudes (rpm) of a speed at ``orders``, about its mean ``speed_rpm``, over ``cycles`` whole cycles.

    ``amplitude_rpm`` (orders,) is the root of the mean square over the cycles, what differs from cycle to cycle
    included; ``steady_rpm`` (orders,) is that of the mean cycle; ``doubt_rpm`` (orders,) is what the teeth of the wheel
    may make of it.
    """

    speed_rpm: float
    cycles: int
    orders: Floats
    amplitude_rpm: Floats
    steady_rpm: Floats
    doubt_rpm: Floats

    @property
    def told(self) -> Bools:
        """Which ``orders`` swing for certain: far more than the cycles scatter or teeth make, and worth mention."""
        scatter = np.sqrt(np.maximum(self.amplitude_rpm**2 - self.steady_rpm**2, 0.0) / self.cycles)
        sure = (self.steady_rpm > SURE * scatter) & (self.steady_rpm > self.doubt_rpm)
        return sure & (self.steady_rpm > LEAST_SHARE * self.speed_rpm)


MOST_VALUES = 1 << 18
"""Speeds within cycles that are told at a time: the memory does not grow with the recording."""

WHOLE = 1e-6
"""An order of the encoder this close to a whole number is one."""


def speed_swing(shaft: xr.Dataset) -> SpeedSwing | None:
    """Swing of the speed of ``shaft`` (ShaftAngle) at the multiples of its cycle's order; None where not known."""
    known = swing_of_cycles(shaft)
    if known is None:
        return None
    orders, means, lines = known
    mean = float(means.mean())
    size, steady = np.sqrt((np.abs(lines) ** 2).mean(axis=0)), np.abs(lines.mean(axis=0))
    return SpeedSwing(mean, len(means), orders, size, steady, doubt_rpm=_of_teeth(shaft, orders) * mean)


def speed_swings(
    shafts: Iterable[xr.Dataset], *, of_encoder: Collection[float], encoder_deg: Mapping[float, float]
) -> tuple[SpeedSwingFinding, ...]:
    """Swing of the speed of each of ``shafts`` within its cycle, by order, the largest first; only what is certain.

    At the orders ``of_encoder`` the encoder itself swings: that is no motion of the shaft. An encoder could show those
    that are no larger than ``encoder_deg`` at its order.
    """
    records = []
    for shaft in shafts:
        swing = speed_swing(shaft)
        if swing is None:
            continue
        sure = swing.told & ~np.isin(swing.orders, list(of_encoder))
        for place in sorted(np.flatnonzero(sure).tolist(), key=lambda at: -swing.amplitude_rpm[at]):
            order, amplitude_rpm = float(swing.orders[place]), float(swing.amplitude_rpm[place])
            off_deg = np.degrees(amplitude_rpm / swing.speed_rpm / order)
            records.append(
                SpeedSwingFinding(
                    recording=printable(shaft.attrs["recording"]),
                    speed_rpm=swing.speed_rpm,
                    order=order,
                    amplitude_rpm=amplitude_rpm,
                    may_be_encoder=bool(off_deg <= encoder_deg.get(order, -np.inf)),
                    steady_rpm=float(swing.steady_rpm[place]),
                )
            )
    return tuple(records)


def swing_of_cycles(shaft: xr.Dataset) -> tuple[Floats, Floats, Complexes] | None:
    """Orders, mean speed [rpm] (cycles,) and complex amplitude [rpm] (cycles, orders) in each whole cycle of ``shaft``.

    None without pulses, in fewer than FEWEST_CYCLES, and where a standstill or a reversal leaves no angle that grows.
    Phases are from angle 0. The trend over each cycle is taken out, so that a run-up is no swing. Orders reach to
    HIGHEST, to those that the knots resolve, and to the cut-off of the smoother where it says one.
    """
    time, angle, speed = (shaft.variables[name].values for name in ("time", "crank_angle", "speed"))
    known = np.isfinite(time) & np.isfinite(angle) & np.isfinite(speed)
    if not known.all():
        time, angle, speed = time[known], angle[known], speed[known]
    revs = int(shaft.attrs.get("revs_per_cycle", 1))
    if float(shaft.attrs.get("n_pulses", 0)) <= 0 or len(angle) < 3 or not (np.diff(angle) > 0.0).all():
        return None
    cut_off = float(shaft.attrs.get("cut_off_order", np.inf))
    cycles = int((angle[-1] - angle[0]) / revs + 1e-9)
    per_rev = (len(angle) - 1) / (angle[-1] - angle[0])
    highest = min(HIGHEST, per_rev / KNOTS_PER_PERIOD, cut_off if cut_off > 0.0 else np.inf)
    orders = np.arange(1, int(highest * revs + 1e-9) + 1) / revs
    if cycles < FEWEST_CYCLES or not orders.size:
        return None
    steps = int(np.ceil(2.0 * max(per_rev, 2.0 * HIGHEST) * revs))
    place = (np.arange(steps) + 0.5) / steps * revs
    turn = 2.0 / steps * np.exp(-2j * np.pi * np.outer(angle[0] + place, orders))
    means, lines = np.empty(cycles), np.empty((cycles, len(orders)), dtype=np.complex128)
    for part in np.array_split(np.arange(cycles), 1 + cycles * steps // MOST_VALUES):
        begin = angle[0] + revs * part
        near = slice(*(np.searchsorted(angle, [begin[0], begin[-1] + revs]) + np.array([-1, 1])).clip(0))
        value = np.interp(begin[:, None] + place, *_between(time[near], angle[near], speed[near]))
        means[part] = value.mean(axis=1)
        lines[part] = (value - means[part, None]) @ turn
    # from cycle to cycle: a slope fitted within one would take the swing at its own order along
    return orders, means, lines - np.gradient(means)[:, None] * ((place / revs - 0.5) @ turn)


def swing_remarks(shaft: xr.Dataset, settings: ShaftSettings) -> list[Remark]:
    """Remark where the speed of ``shaft`` swings at high orders by more than ``settings`` say a shaft can."""
    swing = speed_swing(shaft)
    if swing is None:
        return []
    high = swing.told & (swing.orders > HIGHEST_MOTION)
    share = 100.0 * swing.steady_rpm / swing.speed_rpm
    beyond = float(np.sqrt(np.sum(np.square(share[high]))))
    if not beyond > settings.largest_swing_percent:
        return []
    total, low = (float(np.sqrt(np.sum(np.square(share[kept])))) for kept in (swing.told, swing.told & ~high))
    detail = (
        f"the speed within the revolution swings by {total:.2g} %, of that {beyond:.2g} % above order "
        f"{HIGHEST_MOTION:g}: more than a shaft can; teeth of the wheel that sit wrongly? What the shaft swings is "
        f"between 0 and {low:.2g} %; orders beside strong ones may be made by it. Record more revolutions to tell"
    )
    return [("encoder_tooth_errors_likely", "suspect", detail)]


def _of_teeth(shaft: xr.Dataset, orders: Floats) -> Floats:
    """Share of the speed that the teeth of the wheel of ``shaft`` may make swing at each of ``orders``, at most."""
    doubt, every = float(shaft.attrs.get(TOOTH_DOUBT, 0.0)), float(shaft.attrs.get(TOOTH_ORDER, 0.0))
    if not every > 0.0:
        return np.zeros(len(orders))
    of_wheel = np.abs(orders / every - np.round(orders / every)) < WHOLE
    return np.where(of_wheel, 2.0 * np.pi * orders * doubt, 0.0)


def _between(time: Floats, angle: Floats, speed: Floats) -> tuple[Floats, Floats]:
    """Angle (rev) and speed (rpm) also between the knots, by the cubics that the angle follows there."""
    step, turned, hertz = np.diff(time)[:, None], np.diff(angle)[:, None], speed / 60.0
    at, first, last = np.arange(BETWEEN) / BETWEEN, hertz[:-1, None], hertz[1:, None]
    moved = turned * (3 * at**2 - 2 * at**3) + step * (first * at * (1 - at) ** 2 - last * at**2 * (1 - at))
    rate = turned / step * 6 * at * (1 - at) + first * (1 - at) * (1 - 3 * at) - last * at * (2 - 3 * at)
    return np.append((angle[:-1, None] + moved).ravel(), angle[-1]), np.append(60.0 * rate.ravel(), speed[-1])
