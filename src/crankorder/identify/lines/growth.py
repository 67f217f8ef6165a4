"""How an order line grows with speed or changes while it is measured, how large it becomes, and where it is seen.

Of order 1 it says whether it grows as an unbalance does.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import gammaincc, stdtr

from crankorder.cause import Cause
from crankorder.findings import Balance
from crankorder.identify.found import Mode, OrderLine
from crankorder.orders.intervals import ENDLESS_FREEDOM, Z95, excess_scatter, half_width, known_freedom, root
from crankorder.quantities import Bools, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "growth")
ORDER_ONE_NUMBERS = MethodNumbers("5-identify-explain.toml", "order_one")

UNBALANCE_EXPONENT = {"displacement": 0.0, "velocity": 1.0}
"""Least exponent of speed with which an unbalance shows far above a resonance, where its mass moves by its own
eccentricity at any speed; 2 in acceleration, and in all other quantities that of the force."""

NO_MOTION = ("pressure", "voltage", "current", "temperature")
"""In these quantities order 1 is no motion, and no sign of an unbalance."""


def remark_on(amplitude: Floats, error: Floats, degrees_of_freedom: Floats, ends: Floats) -> str:
    """What is said of a line whose amplitude changes at the speed at which it is largest; empty where it is steady.

    Parameters
    ----------
    amplitude : (speeds,), means over the recordings
    error : (speeds,), their standard errors
    degrees_of_freedom : (speeds,), degrees of freedom of these
    ends : (speeds, 2), of the 95 % intervals over all values that were held
    """
    at = int(np.argmax(amplitude))
    low, high = (float(end) for end in ends[at])
    reach = float(half_width(float(degrees_of_freedom[at])) * error[at])
    sides = float(amplitude[at]) - low, high - float(amplitude[at])
    if not np.isfinite([high, reach]).all() or max(sides) <= NUMBERS.changing_ratio * reach or min(sides) <= 0.0:
        return ""
    if sides[1] > (1.0 + NUMBERS.changing_ratio) * sides[0]:  # the factor by which recordings differ
        return ""
    said = f"{low:.3g}", f"{high:.3g}"
    return "" if said[0] == said[1] else f"its amplitude changes within the recording, {' to '.join(said)}"


SpeedLaw = Literal["grows with speed^n", "falls with speed^n", "keeps its size", "follows no power law"]

TUNING = 4.685
"""Standard deviations beyond which a speed is left out at first (Tukey's biweight, Huber and Ronchetti 2009, 4.8)."""

ROUNDS = 3
"""Times that a law is told by the speeds that do not deviate from it."""

LOW_SHARE = 1.8
"""Of the chance outside the interval so many halves lie below it: little is left above, where one error is added."""


class Growth(NamedTuple):
    """Amplitude ~ speed**``exponent`` with its standard error and ``degrees_of_freedom``.

    ``law`` names what the amplitude does; ``fit_chance`` is the chance of residuals as large if the law held at the
    speeds that do not deviate; ``scatter`` the share of the amplitude by which these leave the law beyond their
    errors; ``deviating_rpm`` the speeds that deviate, as at a resonance. ``level`` is its amplitude at ``middle_rpm``.
    """

    exponent: float
    exponent_error: float
    degrees_of_freedom: float
    law: SpeedLaw
    fit_chance: float
    scatter: float
    deviating_rpm: tuple[float, ...]
    level: float
    middle_rpm: float

    def at(self, best: Largest) -> Largest:
        """``best`` with the law's amplitude at its speed where all speeds follow the law.

        The largest of many rows is too large by what their errors make of the choice; a law is told by all of them.
        """
        lawful = self.level * (best.speed_rpm / self.middle_rpm) ** self.exponent
        follows = not self.deviating_rpm and self.fit_chance >= NUMBERS.follows_chance
        return replace(best, amplitude=lawful) if follows and best.low <= lawful <= best.high else best

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of the exponent."""
        half = half_width(self.degrees_of_freedom) * self.exponent_error
        return self.exponent - half, self.exponent + half


@dataclass(frozen=True)
class Largest:
    """Largest amplitude of a line, at ``speed_rpm``, with the ends ``low`` and ``high`` of its 95 % interval.

    ``at`` is its place among the speeds seen.
    """

    at: int
    speed_rpm: float
    amplitude: float
    low: float
    high: float


MOST_PAIRED = 1024
"""Speeds whose slopes are told in pairs, at most."""


@functools.lru_cache(maxsize=256)
def growth(line: OrderLine) -> Growth | None:
    """How the amplitude of ``line`` grows with speed; None for fewer than four speeds, or all nearly alike.

    Weighted regression of log amplitude on log speed: a speed counts by its own error and by the scatter that all of
    them show beyond that, and not where it deviates from the others, so that speeds near a resonance do not make the
    law. Amplitude "keeps its size" only where the exponent is 0 within its interval and a constant fits.
    """
    known = (line.amplitude > 0.0) & np.isfinite(line.amplitude_error) & np.isfinite(line.speed_rpm)
    speed, amplitude = line.speed_rpm[known], line.amplitude[known]
    if len(speed) < NUMBERS.fewest_speeds or not speed.max() >= NUMBERS.least_range * speed.min():
        return None
    middle_rpm = float(np.exp(np.log(speed).mean()))
    x, y = np.log(speed / middle_rpm), np.log(amplitude)
    shared = 1.0 if line.n_independent is None else 1.0 / np.sqrt(line.n_independent[known])
    # errors are themselves known with these degrees of freedom only
    held = np.clip(np.nan_to_num(line.degrees_of_freedom[known], nan=1.0, posinf=ENDLESS_FREEDOM), 1.0, ENDLESS_FREEDOM)
    widened = np.where(held > 2.5, np.sqrt(held / np.maximum(held - 2.0, 0.5)), 2.5)
    error = np.hypot(shared * line.amplitude_error[known] / amplitude * widened, NUMBERS.law_tolerance)
    follows = _near_most(x, y, error)
    for _ in range(ROUNDS):
        enough = np.count_nonzero(follows) >= NUMBERS.fewest_speeds and np.ptp(x[follows]) > 0.0
        kept = follows if enough else np.ones(len(x), dtype=np.bool_)
        told = power_law(x[kept], y[kept], error[kept])
        residual = np.abs(y - told.level - told.exponent * (x - told.mean))
        follows = residual <= NUMBERS.deviating_sigmas * np.hypot(error, told.scatter)
    exponent, exponent_error, excess = told.exponent, float(np.sqrt(told.exponent_variance)), told.scatter
    degrees_of_freedom = _degrees_of_freedom(error[kept], excess, line.degrees_of_freedom[known][kept])
    few_deviate = bool(np.count_nonzero(~kept) <= NUMBERS.largest_deviating_share * len(x))
    fits, half = few_deviate and told.chance >= NUMBERS.fit_chance, half_width(degrees_of_freedom) * exponent_error
    law: SpeedLaw = "follows no power law"
    if abs(exponent) <= half or abs(exponent) + half <= NUMBERS.least_exponent:
        if fits and abs(exponent) < NUMBERS.steady_exponent and half < NUMBERS.steady_precision:
            law = "keeps its size"
    elif fits or (few_deviate and excess < NUMBERS.law_scatter):
        law = "grows with speed^n" if exponent > 0.0 else "falls with speed^n"
    away, level = tuple(speed[~kept].tolist()), float(np.exp(told.level - exponent * told.mean))
    return Growth(exponent, exponent_error, degrees_of_freedom, law, told.chance, excess, away, level, middle_rpm)


def _degrees_of_freedom(error: Floats, excess: float, degrees_of_freedom: Floats) -> float:
    """Degrees of freedom of an error made of the speeds' own (``degrees_of_freedom``) and of the ``excess`` scatter.

    Welch and Satterthwaite: the former is known with all of theirs, the latter with those of the residuals.
    """
    own = float(np.exp(np.mean(np.log(error**2))))
    known = np.where(np.isfinite(degrees_of_freedom), degrees_of_freedom, ENDLESS_FREEDOM)
    held = float(np.clip(np.sum(known), 1.0, ENDLESS_FREEDOM))
    return (own + excess**2) ** 2 / (own**2 / held + excess**4 / max(len(error) - 2.0, 1.0))


def _near_most(x: Floats, y: Floats, error: Floats) -> Bools:
    """Which speeds lie near the line through most: the median of pairwise slopes (Theil 1950; Sen 1968).

    Of many speeds one in so many is paired, from the slowest to the fastest.
    """
    some = np.sort(np.argsort(x, kind="stable")[:: 1 + len(x) // MOST_PAIRED])
    dx, dy = x[some, None] - x[some], y[some, None] - y[some]
    apart = np.abs(dx) > 0.25 * np.ptp(x[some])
    left = y - float(np.median(dy[apart] / dx[apart])) * x
    residual = np.abs(left - np.median(left))
    scatter = max(0.0, float(np.median(residual)) / 0.6745 - float(np.median(error)))
    return np.asarray(residual < TUNING * np.hypot(error, scatter))


def _excess(residual: Floats, error: Floats) -> float:
    """Scatter beyond the errors (speeds,) such that the residuals are as large as expected."""

    def misfit(scatter: float) -> float:
        return float(np.sum(residual**2 / (error**2 + scatter**2)))

    most = float(np.sqrt(np.sum(residual**2))) + 1e-12
    return excess_scatter(misfit, max(len(residual) - 2, 1), most=most, within=1e-9)


class PowerLaw(NamedTuple):
    """log amplitude = ``level`` + ``exponent`` · (log speed - ``mean``), from speeds that scatter about it.

    ``level_variance`` and ``exponent_variance`` are apart; ``scatter`` is the standard deviation of the logarithm
    beyond the amplitudes' own errors, ``scale`` by how much all variances are to be widened for ``freedom`` degrees of
    freedom; ``chance`` is that of a worse fit without the scatter.
    """

    mean: float
    level: float
    exponent: float
    level_variance: float
    exponent_variance: float
    scatter: float
    scale: float
    freedom: int
    chance: float

    def excess(self, x: Floats, y: Floats, error: Floats) -> tuple[Floats, Floats]:
        """Logarithm ``y`` of amplitudes over the law at ``x``, and its standard error: (speeds,) each.

        ``x`` is the logarithm of speed, ``error`` that of ``y``; they took no part in the law.
        """
        of_law = self.level_variance + (x - self.mean) ** 2 * self.exponent_variance
        excess = y - self.level - self.exponent * (x - self.mean)
        return excess, np.sqrt(self.scale * (of_law + error**2 + self.scatter**2))


def power_law(x: Floats, y: Floats, error: Floats) -> PowerLaw:
    """Power law of log amplitudes ``y`` with their ``error`` against log speeds ``x``: (speeds,) each.

    Three speeds or more, not all alike. They are weighted by their errors and by a scatter common to all (Paule and
    Mandel 1982); variances widened by ``scale`` are those of the residuals, so that Student's t holds (Knapp and
    Hartung 2003).
    """
    excess, chance = 0.0, 1.0
    for step in range(5):
        weight = 1.0 / (error**2 + excess**2)
        mean, level = (float(np.average(values, weights=weight)) for values in (x, y))
        away = x - mean
        slope = float(weight @ (away * y) / (weight @ away**2))
        residual = y - level - slope * away
        cost = float(residual**2 @ weight)
        if step == 0:
            chance = float(gammaincc(0.5 * (len(x) - 2), 0.5 * cost))
        if step < 4:
            excess = _excess(residual, error)
    variances = float(1.0 / weight.sum()), float(1.0 / (weight @ away**2))
    freedom = len(x) - 2
    return PowerLaw(mean, level, slope, *variances, excess, max(cost / freedom, 1e-12), freedom, chance)


@functools.lru_cache(maxsize=256)
def largest(line: OrderLine) -> Largest:
    """Largest amplitude of ``line`` over its speeds with a 95 % interval that allows for its having been chosen.

    It is the largest of its track's rows. What was chosen so is too large on average: given the choice it is
    distributed as if cut off below at what the next one reaches that shares no error with it. The interval holds all
    true amplitudes that this makes no surprise of, within a wider one that holds for all speeds at once (hybrid
    interval of Andrews, Kitagawa and McCloskey 2024, Quarterly Journal of Economics 139), and what lies one standard
    error above.
    """
    error = np.where(np.isfinite(line.amplitude_error), line.amplitude_error, np.inf)
    known = np.where(np.isfinite(error), line.amplitude, -np.inf)
    at = int(np.argmax(known)) if np.isfinite(known).any() else line.strongest
    seen, sigma = float(line.amplitude[at]), float(error[at])
    speed = float(line.speed_rpm[at])
    if sigma == 0.0 or not np.isfinite(sigma):
        return Largest(at, speed, seen, seen if sigma == 0.0 else 0.0, seen if sigma == 0.0 else np.inf)
    degrees_of_freedom = known_freedom(float(line.degrees_of_freedom[at]))
    others, count = np.delete(known, at), float(len(known))
    if line.n_independent is not None:  # rows within a whole independent one of another share errors with it
        place = np.cumsum(line.n_independent) - 0.5 * line.n_independent
        others = known[np.abs(place - place[at]) > 1.0 - 1e-9]
        count = max(1.0, float(line.n_independent.sum()))
    cut = (float(np.max(others)) - seen) / sigma if len(others) else -np.inf
    wide = half_width(degrees_of_freedom, level=1.0 - NUMBERS.simultaneous_chance / count)
    share = 0.5 * (0.05 - NUMBERS.simultaneous_chance) / (1.0 - NUMBERS.simultaneous_chance)
    parts = (LOW_SHARE * share, 1.0 - (2.0 - LOW_SHARE) * share) if len(others) else (0.025, 0.975)
    below, above = (_truncated_quantile(cut, wide, degrees_of_freedom, part) for part in parts)
    # where two speeds are alike the upper end falls on the lower one: no amplitude is told better than to its error
    low, high = max(0.0, seen + sigma * below), max(seen + sigma * above, seen + sigma)
    if line.ends is None:
        return Largest(at, speed, seen, low, high)
    alone = [float(end) for end in line.ends[at]]
    usual = half_width(degrees_of_freedom)
    if 0.0 < alone[0] < seen and seen < alone[1] < np.inf:
        # the choice stretches the interval of that speed alone; a factor, so that what is seen stays above 0
        held = max(seen - alone[0], alone[1] - seen) > NUMBERS.changing_ratio * (sigma * usual)
        # what was held within the recordings is no error: the choice stretches only that of the noise
        by_noise = max(alone[0], seen / (1.0 + usual * sigma / seen)) if held else alone[0]
        low = seen * float((by_noise / seen) ** (-below / usual)) if below < 0.0 else seen
        low = min(low, alone[0]) if held else low
        high = max(high, alone[1]) if len(others) == 0 or held else high
    return Largest(at, speed, seen, low, high)


def _truncated_quantile(cut: float, wide: float, degrees_of_freedom: float, share: float) -> float:
    """True less seen amplitude, in errors, at which a ``share`` of what is above ``cut`` is above what was seen."""

    def above(true: float) -> float:
        """Chance of more than what was seen, given that it is above the cut, less the share wanted."""
        uncut = float(stdtr(degrees_of_freedom, true - cut)) if np.isfinite(cut) else 1.0
        return float(stdtr(degrees_of_freedom, true)) / max(uncut, 1e-300) - share

    if above(-wide) >= 0.0:
        return -wide
    return wide if above(wide) <= 0.0 else root(above, -wide, wide, within=1e-6)


def reported(line: OrderLine, law: Growth | None) -> Largest:
    """The amplitude that is told of ``line``, wherever it is told: the largest, by its ``law`` where that holds."""
    return largest(line) if law is None else law.at(largest(line))


def reported_within(line: OrderLine, low_rpm: float, high_rpm: float) -> Largest | None:
    """The largest amplitude of ``line`` from ``low_rpm`` to ``high_rpm``; None where it is not seen there.

    Where it is the largest of all speeds it is what is told of the line everywhere.
    """
    there = np.flatnonzero((line.speed_rpm >= low_rpm) & (line.speed_rpm <= high_rpm))
    if not len(there):
        return None
    if largest(line).at in there:
        return reported(line, growth(line))
    at = int(there[np.argmax(line.amplitude[there])])
    low, high = (0.0, np.inf) if line.ends is None else map(float, line.ends[at])
    return Largest(at, float(line.speed_rpm[at]), float(line.amplitude[at]), low, high)


def mean_level(line: OrderLine) -> Largest:
    """Mean amplitude of ``line`` over the speeds seen, each by its error and the scatter beyond, with its interval.

    Two speeds or more must have an error; place and speed are those of the largest.
    """
    shared = 1.0 if line.n_independent is None else 1.0 / np.sqrt(line.n_independent)
    amplitude, error = line.amplitude, np.hypot(shared * line.amplitude_error, NUMBERS.law_tolerance * line.amplitude)
    known = np.isfinite(error)
    amplitude, error = amplitude[known], error[known]
    mean = float(np.average(amplitude, weights=1.0 / error**2))
    for _ in range(3):
        excess = _excess(amplitude - mean, error)
        weight = 1.0 / (error**2 + excess**2)
        mean = float(np.average(amplitude, weights=weight))
    degrees_of_freedom = _degrees_of_freedom(error, excess, line.degrees_of_freedom[known])
    half = half_width(degrees_of_freedom) / float(np.sqrt(weight.sum()))
    return replace(largest(line), amplitude=mean, low=max(0.0, mean - half), high=mean + half)


def visible_range_rpm(line: OrderLine) -> tuple[float, float]:
    """Lowest and highest speed at which ``line`` stands above the false-alarm level."""
    return float(line.speed_rpm.min()), float(line.speed_rpm.max())


def order_one(line: OrderLine, quantity: str, modes: Sequence[Mode]) -> Cause:
    """What the growth of order 1, the ``line``, says of it in that ``quantity``, and why.

    Unbalance where it grows as one does; an unbalance, a bent shaft or a misalignment where nothing tells these apart;
    unexplained where it surely grows more slowly, which a natural frequency of ``modes`` does not explain.
    """
    grown, least = growth(line), UNBALANCE_EXPONENT.get(quantity, 2.0)
    like = functools.partial(Cause, "unbalance, bent shaft or misalignment")
    if grown is None:
        return like(f"too few speeds to tell how it grows{_between_few(line, least, modes)}", doubt="few speeds")
    low, high = grown.ci95
    if len(grown.deviating_rpm) > NUMBERS.largest_deviating_share * np.count_nonzero(line.amplitude > 0.0):
        return like("no power of the speed describes how it grows", doubt="unclear growth")
    grows = f"goes with speed to the {grown.exponent:.2f} ({low:.2f} to {high:.2f})"
    would = f"which alone would with {least:g} or more"
    followed = np.setdiff1d(line.speed_rpm[np.isfinite(line.speed_rpm)], np.asarray(grown.deviating_rpm))
    lowest = least + _least_slope(followed, modes)
    if high < lowest - ORDER_ONE_NUMBERS.slower_exponent:
        slower = f"{grows}: it does not grow as unbalance does, {would}"
        return Cause("unexplained", slower, doubt="slower than unbalance")
    if high < lowest - ORDER_ONE_NUMBERS.little_slower_exponent:
        slower = f"{grows}, more slowly than unbalance, {would}, far from natural frequencies"
        return like(slower, doubt="unclear growth")
    if grown.law == "follows no power law":
        return like(f"{grows}, and no power of the speed describes it", doubt="unclear growth")
    return Cause("unbalance", grows)


def if_unbalance(balance: Balance, causes: Collection[Cause]) -> tuple[Balance | None, str]:
    """The ``balance`` as far as order 1 may be unbalance; None and why where it surely is none.

    ``causes``: those of every line of the test.
    """
    slower = [cause.evidence for cause in causes if cause.doubt == "slower than unbalance"]
    like = any(cause.is_just("unbalance, bent shaft or misalignment") for cause in causes)
    if slower and not like and not any(cause.is_just("unbalance") for cause in causes):
        return None, f"order 1 is no unbalance, or not alone: {slower[0]}"
    if slower or like:
        condition = "if order 1 is unbalance, which nothing tells from a bent shaft or misalignment"
        return replace(balance, evidence=f"{balance.evidence}; {condition}", if_unbalance=True), ""
    return balance, ""


def _least_slope(rpm: Floats, modes: Sequence[Mode]) -> float:
    """Least exponent of speed over ``rpm``, 0 or less, by which an unbalance moves a mass borne by one of ``modes``."""
    slopes = [0.0]
    for mode in modes if len(rpm) > 1 else ():
        ratio = rpm / 60.0 / mode.frequency_hz
        moves = ratio**2 / np.abs(1.0 - ratio**2 + 2j * mode.damping_ratio * ratio)
        slopes.append(float(np.polyfit(np.log(rpm), np.log(moves), 1)[0]))
    return min(slopes)


def _between_few(line: OrderLine, least: float, modes: Sequence[Mode]) -> str:
    """That even two or three speeds contradict an unbalance, within the intervals at the slowest and the fastest."""
    known = (line.amplitude > 0.0) & np.isfinite(line.amplitude_error) & np.isfinite(line.speed_rpm)
    rpm, amplitude, error = line.speed_rpm[known], line.amplitude[known], line.amplitude_error[known]
    if len(rpm) < 2 or rpm.max() < NUMBERS.least_range * rpm.min():
        return ""
    slow, fast = int(np.argmin(rpm)), int(np.argmax(rpm))
    error = Z95 * error
    if amplitude[slow] <= error[slow]:
        return ""
    high = np.log((amplitude[fast] + error[fast]) / (amplitude[slow] - error[slow])) / np.log(rpm[fast] / rpm[slow])
    if high >= least + _least_slope(rpm[[slow, fast]], modes) - ORDER_ONE_NUMBERS.slower_exponent:
        return ""
    speeds = f"from {rpm[slow]:.0f} to {rpm[fast]:.0f} rpm"
    return f"; {speeds} it does not grow as unbalance does, unless a natural frequency is near one"
