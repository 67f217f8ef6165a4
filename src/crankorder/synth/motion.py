"""The motion of a shaft as a formula: its angle, speed and acceleration at any time, and the time of any angle.

Slow wobbles are summed once for neighbouring times, as a power series about a knot among them: its error is below
round-off, and the cost per sample does not grow with their number. The plain version, sine by sine, is in the tests.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_right
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from itertools import pairwise

import numpy as np
from numba import njit

from crankorder.engine.compiled_slider_crank import fast_sine_cosine
from crankorder.engine.torsional_fluctuation import Lag, stops_within_cycle
from crankorder.errors import RequestError
from crankorder.quantities import Floats

REACH_RAD = 0.3
"""How far the fastest wobble may turn from the middle of its power series: its 16th power over 16! is 2e-22."""
TERMS = 16
CLOSE_REV = 1e-9
"""A Newton step of this length is the last one: cubic convergence leaves nothing."""


@njit(nogil=True, error_model="numpy")
def _lag_sums(angle_rev, share, lag, step):  # type: ignore[no-untyped-def]
    """Lag at a crank angle and its three derivatives; of its gas part alone, for a share of 1, value and two more.

    ``lag``: rows of order, inertia and gas part (real, imaginary). ``step`` > 0: the orders are its multiples 1, 2, …
    """
    lags = slope = bend = twist = gas = gas_slope = gas_bend = 0.0
    turn_sine, turn_cosine = fast_sine_cosine(step * angle_rev)
    real, imaginary = 1.0, 0.0
    for k in range(lag.shape[0]):
        if step > 0.0:
            raised = real * turn_cosine - imaginary * turn_sine
            imaginary = real * turn_sine + imaginary * turn_cosine
            real = raised
        else:
            imaginary, real = fast_sine_cosine(lag[k, 0] * angle_rev)
        rate = 2.0 * math.pi * lag[k, 0]
        gas_here = lag[k, 3] * real - lag[k, 4] * imaginary
        gas_turned = -rate * (lag[k, 3] * imaginary + lag[k, 4] * real)
        here = lag[k, 1] * real - lag[k, 2] * imaginary + share * gas_here
        turned = -rate * (lag[k, 1] * imaginary + lag[k, 2] * real) + share * gas_turned
        lags += here
        slope += turned
        bend -= rate * rate * here
        twist -= rate * rate * turned
        gas += gas_here
        gas_slope += gas_turned
        gas_bend -= rate * rate * gas_here
    return lags, slope, bend, twist, gas, gas_slope, gas_bend


@njit(cache=True, nogil=True, error_model="numpy")
def fill_lag(angle_rev, lag, step, out):  # type: ignore[no-untyped-def]
    """Inertia part of the lag and its gas part for a share of 1 at ``angle_rev`` (n,), into ``out`` (2, n).

    ``lag`` and ``step``: as of :func:`follow_lag`.
    """
    for i in range(angle_rev.size):
        out[0, i], _, _, _, out[1, i], _, _ = _lag_sums(angle_rev[i], 0.0, lag, step)


@njit(nogil=True, error_model="numpy")
def _behind(mean, share, behind, high, lag, step):  # type: ignore[no-untyped-def]
    """Crank less mean angle from a guess and a bound; there the rise of mean with crank angle, its slope, gas parts."""
    low, move = -high, 0.0
    for _ in range(100):
        lags, slope, bend, twist, gas, gas_slope, gas_bend = _lag_sums(mean + behind, share, lag, step)
        miss, slope = behind + lags, 1.0 + slope
        if miss > 0.0:
            high = behind
        else:
            low = behind
        move = -miss / (slope - 0.5 * miss * bend / slope)
        if not low < behind + move < high and abs(move) > CLOSE_REV:
            move = 0.5 * (low + high) - behind
        behind += move
        if abs(move) <= CLOSE_REV:
            break
    slope += move * (bend + 0.5 * move * twist)
    return behind, slope, bend + move * twist, gas + move * gas_slope, gas_slope + move * gas_bend


@njit(cache=True, nogil=True, error_model="numpy")
def follow_lag(time_s, jerk, lag, step, reference, slowest, out):  # type: ignore[no-untyped-def]
    """Turn the mean angle, speed and acceleration (rev, s) in ``out``, float64 (3, n), into those of the crank.

    Returns the least over all times of the rise of mean with crank angle and of crank over mean speed: where it is not
    above zero the shaft stops within the cycle.

    ``time_s``: float64 (n,), quickest where neighbours are close. ``jerk``: (n,) rate of the mean acceleration.
    ``lag``: (k, 5) of order, inertia and gas part (rev, real and imaginary). ``step``: what the orders are multiples
    1, 2, … of, 0 for any. ``reference``: mean speed (rev/s) of the gas part, 0 without gas. ``slowest``: mean speed
    (rev/s) at which the gas stops the shaft.
    """
    widest, gas_widest = np.hypot(lag[:, 1], lag[:, 2]).sum(), np.hypot(lag[:, 3], lag[:, 4]).sum()
    least = 1.0
    behind = behind_speed = behind_acceleration = 0.0
    for i in range(time_s.size):
        mean, speed, acceleration = out[0, i], out[1, i], out[2, i]
        share = share_speed = share_acceleration = 0.0
        if reference > 0.0:
            if not abs(speed) > slowest:
                return 0.0
            share = (reference / speed) ** 2
            change = acceleration / speed
            share_speed = -2.0 * share * change
            share_acceleration = share * (6.0 * change * change - 2.0 * jerk[i] / speed)
        high = 1.001 * (widest + share * gas_widest)
        if i > 0:
            passed = time_s[i] - time_s[i - 1]
            behind += passed * (behind_speed + 0.5 * passed * behind_acceleration)
        if not abs(behind) < high:
            behind = 0.0
        behind, slope, bend, gas, gas_slope = _behind(mean, share, behind, high, lag, step)
        crank_speed = (speed - gas * share_speed) / slope
        driven = acceleration - gas * share_acceleration - 2.0 * gas_slope * share_speed * crank_speed
        crank_acceleration = (driven - bend * crank_speed * crank_speed) / slope
        least = slope if slope < least else least
        if reference > 0.0 and crank_speed / speed < least:
            least = crank_speed / speed
        behind_speed, behind_acceleration = crank_speed - speed, crank_acceleration - acceleration
        out[0, i], out[1, i], out[2, i] = mean + behind, crank_speed, crank_acceleration
    return least


Corner = tuple[float, float]

MOST_WOBBLES = 256
"""Lines that a wander is made of at most: with random phases their sum is as good as Gaussian."""
LEAST_SWING = 1e-100
"""Speed (rev/s) that counts as none: far below it numbers lose their digits."""
ROUND_OFF = 2.3e-16
"""Relative size of steps of Newton's method, and of half of what they still miss, at which they end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A shaft's motion: a speed that runs straight from corner to corner, slow wobbles on it, and a lag in the cycle.

    ``start_rev``: crank angle at t = 0. ``corners``: time (s, ascending) and mean speed (rpm, negative backwards) of
    each, one at least; before the first and after the last the speed stays. ``wobbles``: frequency (Hz, > 0), amplitude
    (rpm) and phase (degrees) of each, amplitude · cos(2π frequency t + phase). ``lag``: in-cycle motion. Angles are
    revolutions, positive forwards.

    Raises RequestError for corners out of sequence, and where the lag would stop the shaft within the cycle.
    """

    start_rev: float
    corners: tuple[Corner, ...]
    wobbles: tuple[tuple[float, float, float], ...] = ()
    lag: Lag | None = None
    _points: tuple[Corner, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = [time for time, _ in self.corners]
        every = [self.start_rev, *times, *(rpm for _, rpm in self.corners), *(part for w in self.wobbles for part in w)]
        if not times or any(after <= before for before, after in pairwise(times)) or not np.isfinite(every).all():
            raise RequestError("no such speed profile", place="corners", allowed="finite, at ascending times")
        object.__setattr__(self, "_points", _without_straight(self.corners))
        if self._lag is not None:
            rpm = [rpm for _, rpm in self.corners]
            self._lag.check(0.0 if min(rpm) <= 0 <= max(rpm) else min(map(abs, rpm)))

    @property
    def corner_s(self) -> tuple[float, ...]:
        """Times (s, ascending) at which the slope of the profile changes: there the acceleration jumps."""
        return tuple(time for time, _ in self._points[1:-1])

    @cached_property
    def mean_start_rev(self) -> float:
        """Mean angle (rev) at time 0: what the angle would be there without the lag."""
        lag = self._lag
        return self.start_rev + (0.0 if lag is None else float(lag.at(self.start_rev, self._mean_rpm(0.0))))

    def at(self, time_s: Floats, *, piece: int | None = None) -> tuple[Floats, Floats, Floats]:
        """Crank angle (rev), speed (rpm) and angular acceleration (rpm/s) at each time, arrays (n,).

        ``time_s``: (n,), any values, also before 0; quickest in sequence. ``piece``: k takes the formula that holds
        between ``corner_s[k - 1]`` and ``corner_s[k]`` for all of them, extended beyond its ends; None takes for each
        time the formula that holds there (at a corner the one that follows).

        All three are exact to round-off: angles to a few units in the last place of the revolutions from t = 0. Raises
        RequestError where the shaft would stop within the cycle.
        """
        times = np.ascontiguousarray(time_s, dtype=np.float64)
        motion = self._mean(times, piece)
        out = motion[:3]
        if self._lag is not None and not follow_lag(times, motion[3], *self._numbers, out) > 0:
            slowest_rpm = 60 * np.abs(self._mean(times, piece)[1]).min()
            raise stops_within_cycle(float(slowest_rpm), self._lag.slowest_rpm)
        return out[0], 60 * out[1], 60 * out[2]

    def begun_earlier(self, seconds: float) -> Motion:
        """The same motion on a clock that starts ``seconds`` before this one's zero, or after it where negative."""
        if seconds == 0:
            return self
        corners = tuple((time_s + seconds, rpm) for time_s, rpm in self.corners)
        wobbles = tuple((hz, rpm, phase - 360 * hz * seconds) for hz, rpm, phase in self.wobbles)
        return replace(self, start_rev=float(self.at(np.array([-seconds]))[0][0]), corners=corners, wobbles=wobbles)

    def stretches(self, duration_s: float) -> tuple[tuple[float, float], ...]:
        """First and last time (s) of each part of 0 … ``duration_s`` in which the shaft turns one way, in sequence.

        The speed changes sign between two of them; where it stays at zero there is none. ``duration_s``: > 0.
        """
        cuts = [0.0, *(time for time in self.corner_s if 0 < time < duration_s), duration_s]
        edges = sorted({*cuts, *(time for time in self._zero_speed_s(cuts) if 0 < time < duration_s)})
        middles = np.array([0.5 * (start + stop) for start, stop in pairwise(edges)])
        stretches: list[tuple[float, float]] = []
        way = 0.0
        for (start, stop), speed in zip(pairwise(edges), self._mean(middles)[1], strict=True):
            if stretches and np.sign(speed) == way and stretches[-1][1] == start:
                stretches[-1] = (stretches[-1][0], stop)
            elif speed != 0:
                stretches.append((start, stop))
                way = np.sign(speed)
        return tuple(stretches)

    def time_at(self, angle_rev: Floats, stretch: tuple[float, float]) -> Floats:
        """Times (s), shape (n,), at which the shaft passes each angle in a stretch, exact to round-off.

        ``angle_rev``: crank angles (n,), revolutions, within the stretch; quickest in sequence. ``stretch``: first and
        last time, of :meth:`stretches` or within one. An angle outside counts as the nearer end.
        """
        angles = np.ascontiguousarray(angle_rev, dtype=np.float64)
        if not angles.size:
            return np.empty(0)
        knots = self._knots(*stretch)
        passed = self.at(knots)[0]
        way = 1.0 if passed[-1] >= passed[0] else -1.0
        angles = np.clip(angles, passed.min(), passed.max())
        part = np.searchsorted(np.maximum.accumulate(way * passed), way * angles, side="right") - 1
        part = np.clip(part, 0, knots.size - 2)
        target, gas_rev = self._mean_of_crank(angles)
        low, high = knots[part], knots[part + 1]
        times = 0.5 * (low + high)
        left = np.arange(angles.size)
        for _ in range(100):
            time = times[left]
            mean, speed, acceleration, _ = self._mean(time)
            with np.errstate(divide="ignore", invalid="ignore"):  # at a standstill halves of the bracket go on
                gas = gas_rev[left] * (self._numbers[2] / speed) ** 2
                miss = way * (mean - gas - target[left])
                new = time - way * miss / (speed + 2 * gas * acceleration / speed)
            low[left], high[left] = np.where(miss > 0, (low[left], time), (time, high[left]))
            inside = (low[left] <= new) & (new <= high[left])
            new = np.where(inside, new, 0.5 * (low[left] + high[left]))
            new = np.where(np.abs(miss) <= 2 * ROUND_OFF * (1 + np.abs(target[left])), time, new)
            times[left] = new
            left = left[np.abs(new - time) > ROUND_OFF * np.abs(new)]
            if not left.size:
                break
        return times

    def _mean_of_crank(self, angle_rev: Floats) -> tuple[Floats, Floats]:
        """Mean angle (rev) of crank angles (n,) without the gas part of the lag, and that part for a share of 1."""
        table, step, _, _ = self._numbers
        parts = np.zeros((2, angle_rev.size))
        if len(table):
            fill_lag(angle_rev, table, step, parts)
        return angle_rev + parts[0], parts[1]

    @cached_property
    def _lag(self) -> Lag | None:
        lag = self.lag
        return None if lag is None or not (lag.has_gas or np.any(lag.inertia)) else lag

    @cached_property
    def _wobbles(self) -> Floats:
        """Frequency (Hz), amplitude (rev/s) and phase (rev), shape (w, 3): one for each frequency that matters."""
        summed: dict[float, complex] = {}
        for frequency, rpm, phase_deg in self.wobbles:
            if rpm:
                phase_rad = math.radians(math.remainder(phase_deg, 360))
                summed[frequency] = summed.get(frequency, 0j) + rpm / 60 * cmath.exp(1j * phase_rad)
        least = max(1e-16 * sum(abs(rpm) / 60 for _, rpm, _ in self.wobbles), LEAST_SWING)
        rows = [(hz, abs(swing), cmath.phase(swing) / (2 * math.pi)) for hz, swing in summed.items()]
        return np.array([row for row in rows if row[1] > least], dtype=np.float64).reshape(-1, 3)

    @cached_property
    def _numbers(self) -> tuple[Floats, float, float, float]:
        """What :func:`follow_lag` needs of the lag, in the sequence in which it takes it."""
        lag = self._lag
        if lag is None:
            return np.zeros((0, 5)), 0.0, 0.0, 0.0
        columns = (lag.order, lag.inertia.real, lag.inertia.imag, lag.gas.real, lag.gas.imag)
        reference, slowest = (lag.reference_rpm / 60, lag.slowest_rpm / 60) if lag.has_gas else (0.0, 0.0)
        return *_filled(np.stack(columns, axis=1), lag.step), reference, slowest

    @cached_property
    def _formulas(self) -> Floats:
        """Time, mean angle, speed and acceleration (rev, s) at a place of each piece, shape (piece, 4)."""
        return _pieces(self._points, self.mean_start_rev)

    def _mean(self, time_s: Floats, piece: int | None = None) -> Floats:
        """Angle, speed, acceleration and its rate (rev, s) without the lag, shape (4, n)."""
        number = np.searchsorted(self.corner_s, time_s, side="right") if piece is None else np.full(time_s.shape, piece)
        start_s, angle, speed, rate = self._formulas[number].T
        after = time_s - start_s
        straight = [angle + after * (speed + 0.5 * rate * after), speed + rate * after, rate, np.zeros_like(rate)]
        return np.array(straight) + self._wobble(time_s) if len(self._wobbles) else np.array(straight)

    def _wobble(self, time_s: Floats) -> Floats:
        """Angle of the wobbles from time 0 and its three derivatives, shape (4, n): power series about even knots."""
        frequency, swing, phase = self._wobbles.T
        number = np.rint(time_s * (math.pi * frequency.max() / REACH_RAD))
        first = np.flatnonzero(np.diff(number, prepend=np.inf))
        knot_s = number[first, None] * (REACH_RAD / (math.pi * frequency.max()))
        series = np.repeat(np.arange(first.size), np.diff(first, append=time_s.size))
        after = time_s - knot_s[series, 0]
        rate, half = 2 * np.pi * frequency, np.pi * frequency * knot_s
        terms = [(2 * swing / rate * np.cos(2 * np.pi * phase + half) * np.sin(half)).sum(axis=1)]
        turned = swing * np.exp(2j * (np.pi * phase + half))
        for power in range(1, TERMS):
            terms.append(turned.real.sum(axis=1) / power)
            turned *= 1j * rate / power
        angle, speed, bend, twist = np.zeros((4, time_s.size))
        for term in reversed(terms):
            twist = twist * after + bend
            bend = bend * after + speed
            speed = speed * after + angle
            angle = angle * after + term[series]
        return np.array([angle, speed, 2 * bend, 6 * twist])

    def _mean_rpm(self, time_s: float) -> float:
        rpm = float(np.interp(time_s, *np.transpose(self.corners)))
        return rpm + sum(a * math.cos(2 * math.pi * (f * time_s + p / 360)) for f, a, p in self.wobbles)

    def _knots(self, start_s: float, stop_s: float) -> Floats:
        """Times that part a stretch at its corners and, where there are wobbles, as often as a power series needs."""
        cuts = [start_s, *(time for time in self.corner_s if start_s < time < stop_s), stop_s]
        top_hz = self._wobbles[:, 0].max() if len(self._wobbles) else 0.0
        parts = [math.ceil((after - before) * math.pi * top_hz / REACH_RAD) + 1 for before, after in pairwise(cuts)]
        grids = [np.linspace(*ends, n, endpoint=False) for ends, n in zip(pairwise(cuts), parts, strict=True)]
        return np.concatenate([*grids, [stop_s]])

    def _zero_speed_s(self, cuts: list[float]) -> Floats:
        """Times at which the mean speed is or crosses zero: between two of its turning points it does so once."""
        knots = self._knots(cuts[0], cuts[-1])
        turning = self._roots(2, knots) if len(self._wobbles) else knots[:0]
        return self._roots(1, np.sort(np.concatenate([knots, turning])))

    def _roots(self, row: int, grid_s: Floats) -> Floats:
        """Times at which the mean speed (``row`` 1) or acceleration (2) is zero at or changes sign between points."""
        value = self._mean(grid_s)[row]
        change = value[:-1] * value[1:] < 0
        low, high, rising = grid_s[:-1][change], grid_s[1:][change], value[1:][change] > 0
        for _ in range(80):
            middle = 0.5 * (low + high)
            passed = (self._mean(middle)[row] > 0) == rising
            low, high = np.where(passed, low, middle), np.where(passed, middle, high)
        return np.concatenate([grid_s[value == 0], 0.5 * (low + high)])


def wander_wobbles(
    std_rpm: float, corner_hz: float, stream: np.random.Generator, duration_s: float
) -> tuple[tuple[float, float, float], ...]:
    """Random wobbles (Hz, rpm, degrees) that together make a speed wander with an even spectrum up to a corner.

    Each has a cell of the spectrum to itself, its frequency anywhere in it, so that the sum does not repeat; phases are
    by chance and amplitudes equal. ``std_rpm``: standard deviation of the sum, ≥ 0. ``corner_hz``: top of the spectrum,
    > 0. ``stream``: where the randomness comes from. ``duration_s``: of the recording, > 0: two wobbles for each
    resolved line, 16 at least and 256 at most.
    Source: S. O. Rice, Mathematical analysis of random noise, 1944, equation 1.7-1 with jittered frequencies.
    """
    if not std_rpm:
        return ()
    count = min(max(math.ceil(2 * corner_hz * duration_s), 16), MOST_WOBBLES)
    # 1 − u is above zero: no wobble stands still
    frequency_hz = (np.arange(count) + 1 - stream.random(count)) * (corner_hz / count)
    phase_deg = 360 * stream.random(count)
    amplitude_rpm = std_rpm * math.sqrt(2 / count)
    return tuple((float(f), amplitude_rpm, float(phase)) for f, phase in zip(frequency_hz, phase_deg, strict=True))


def _without_straight(corners: tuple[Corner, ...]) -> tuple[Corner, ...]:
    """Corners that turn, between a point before the first and one after the last."""
    first, last = corners[0], corners[-1]
    kept = [(first[0] - 1.0, first[1])]
    for (time, rpm), (after_s, after) in pairwise([*corners, (last[0] + 1.0, last[1])]):
        before_s, before = kept[-1]
        straight = before + (after - before) * ((time - before_s) / (after_s - before_s))
        if abs(rpm - straight) > 8 * np.finfo(float).eps * max(abs(before), abs(rpm), abs(after)):
            kept.append((time, rpm))
    return (*kept, (last[0] + 1.0, last[1]))


def _pieces(points: tuple[Corner, ...], start_rev: float) -> Floats:
    """Time, mean angle, speed and acceleration (rev, s) at a place of each piece: t = 0 or its corner nearest to it."""
    origin = bisect_right([time for time, _ in points[1:-1]], 0.0)
    slopes = [(after - before) / (stop - start) for (start, before), (stop, after) in pairwise(points)]
    rpm_at_0 = points[origin][1] + slopes[origin] * (0.0 - points[origin][0])
    rows: list[tuple[float, float, float]] = [(0.0, start_rev, rpm_at_0)] * len(slopes)
    for way, corners in ((1, points[origin + 1 : -1]), (-1, points[origin:0:-1])):
        turned, (time, rpm) = Fraction(0), (0.0, rpm_at_0)
        for number, (next_s, next_rpm) in enumerate(corners, start=1):
            turned += (Fraction(next_s) - Fraction(time)) * (Fraction(rpm) + Fraction(next_rpm)) / 120
            time, rpm = next_s, next_rpm
            rows[origin + way * number] = (time, start_rev + float(turned), rpm)
    numbers = [(time, angle, rpm / 60, slope / 60) for (time, angle, rpm), slope in zip(rows, slopes, strict=True)]
    return np.array(numbers, dtype=np.float64)


def _filled(table: Floats, step: float) -> tuple[Floats, float]:
    """Rows of a lag with those of zero between them, so that each order is the next multiple of ``step``, if few."""
    places = np.rint(table[:, 0] / step).astype(int) - 1 if step else np.zeros(0, dtype=int)
    if not step or places[-1] + 1 > 4 * len(table) + 8:
        return table, 0.0
    filled = np.zeros((places[-1] + 1, 5))
    filled[places] = table
    filled[:, 0] = step * np.arange(1, places[-1] + 2)
    return filled, step
