"""The motion of a shaft as a formula: its angle, speed and acceleration at any time, and the time of any angle.

Slow wobbles are summed once for a block of neighbouring times, as a power series about the middle of the block: its
error is below round-off, and the cost per sample does not grow with their number. In the compiled pass angles are
revolutions and time is seconds. The plain version, sine by sine and without blocks, is in the tests.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_right
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import pairwise

import numpy as np
from numba import njit

from crankorder.engine.compiled_slider_crank import fast_sine_cosine
from crankorder.engine.torsional_fluctuation import Lag, stops_within_cycle
from crankorder.errors import RequestError
from crankorder.quantities import Floats

TWO_PI = 2 * math.pi
BLOCK = 512
"""Most times that share a power series."""
REACH_RAD = 0.3
"""How far the fastest wobble may turn from the middle of a block: its 16th power over 16! is 2e-22."""
TERMS = 16
CLOSE_REV = 1e-9
"""A Newton step of this length is the last one: cubic convergence leaves nothing."""


@njit(nogil=True, error_model="numpy")
def _expand(centre_s, wobbles, terms):  # type: ignore[no-untyped-def]
    """Power series of the wobbles' angle about ``centre_s``, counted from time 0, into ``terms``."""
    for power in range(terms.size):
        terms[power] = 0.0
    for row in range(wobbles.shape[0]):
        frequency, swing, phase = wobbles[row, 0], wobbles[row, 1], wobbles[row, 2]
        rate = TWO_PI * frequency
        half = 0.5 * frequency * centre_s
        sine, cosine = fast_sine_cosine(half + half + phase)
        terms[0] += swing / rate * 2.0 * fast_sine_cosine(phase + half)[1] * fast_sine_cosine(half)[0]
        here, turned = swing * cosine, -swing * sine
        for power in range(1, terms.size):
            terms[power] += here / power
            scale = rate / power
            here, turned = turned * scale, -here * scale


@njit(nogil=True, error_model="numpy")
def _series(after_s, terms):  # type: ignore[no-untyped-def]
    """Angle and its three derivatives ``after_s`` from the middle of the series."""
    angle = speed = half = sixth = 0.0
    for power in range(terms.size - 1, -1, -1):
        sixth = sixth * after_s + half
        half = half * after_s + speed
        speed = speed * after_s + angle
        angle = angle * after_s + terms[power]
    return angle, speed, 2.0 * half, 6.0 * sixth


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
        rate = TWO_PI * lag[k, 0]
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


@njit(nogil=True, error_model="numpy")
def _follow(time_s, start, stop, jerk, numbers, out):  # type: ignore[no-untyped-def]
    """Turn the mean motion in ``out`` into that of the crank; returns the least of what must stay above zero."""
    _, _, _, lag, step, reference, slowest = numbers
    widest, gas_widest = np.hypot(lag[:, 1], lag[:, 2]).sum(), np.hypot(lag[:, 3], lag[:, 4]).sum()
    least = 1.0
    behind = behind_speed = behind_acceleration = 0.0
    for i in range(start, stop):
        mean, speed, acceleration = out[0, i], out[1, i], out[2, i]
        share = share_speed = share_acceleration = 0.0
        if reference > 0.0:
            if not abs(speed) > slowest:
                return 0.0
            share = (reference / speed) ** 2
            change = acceleration / speed
            share_speed = -2.0 * share * change
            share_acceleration = share * (6.0 * change * change - 2.0 * jerk[i - start] / speed)
        high = 1.001 * (widest + share * gas_widest)
        if i > start:
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


@njit(cache=True, nogil=True, error_model="numpy")
def fill_motion(time_s, piece, numbers, jerk, terms, out):  # type: ignore[no-untyped-def]
    """Angle (rev), speed (rpm) and acceleration (rpm/s) of the crank, written into ``out``, float64 (3, n).

    Returns the least over all times of the rise of mean with crank angle and of crank over mean speed: where it is not
    above zero the shaft stops within the cycle.

    ``time_s``: float64 (n,), quickest where neighbours are close. ``piece``: whose formula, or -1 for each its own.
    ``numbers``: the seven that follow. corner_s: ascending (c,). pieces: (c + 1, 4) of time, angle, speed and
    acceleration there. wobbles: (w, 3) of frequency (Hz), amplitude (rev/s) and phase (rev). lag: (k, 5) of order,
    inertia and gas part (rev, real and imaginary). step: what the orders are multiples 1, 2, … of, 0 for any.
    reference: mean speed (rev/s) of the gas part, 0 without gas. slowest: mean speed (rev/s) at which the gas stops the
    shaft. ``jerk``: room for (``BLOCK``,) numbers. ``terms``: room for (``TERMS``,). ``out``: float64 (3, n).
    """
    corner_s, pieces, wobbles, lag, _, _, _ = numbers
    top_hz, least, start = wobbles[:, 0].max() if wobbles.shape[0] else 0.0, 1.0, 0
    while start < time_s.size:
        low = high = time_s[start]
        stop = start + 1
        while stop < time_s.size and stop - start < jerk.size:
            new_low = time_s[stop] if time_s[stop] < low else low
            new_high = time_s[stop] if time_s[stop] > high else high
            if (new_high - new_low) * (math.pi * top_hz) > REACH_RAD:
                break
            low, high = new_low, new_high
            stop += 1
        first = np.searchsorted(corner_s, low, side="right") if piece < 0 else piece
        last = np.searchsorted(corner_s, high, side="right") if piece < 0 else piece
        for i in range(start, stop):
            k = first if first == last else np.searchsorted(corner_s, time_s[i], side="right")
            after, rate = time_s[i] - pieces[k, 0], pieces[k, 3]
            out[0, i] = pieces[k, 1] + after * (pieces[k, 2] + 0.5 * rate * after)
            out[1, i] = pieces[k, 2] + rate * after
            out[2, i] = rate
            jerk[i - start] = 0.0
        if wobbles.shape[0]:
            centre = 0.5 * (low + high)
            _expand(centre, wobbles, terms)
            for i in range(start, stop):
                angle, speed, acceleration, third = _series(time_s[i] - centre, terms)
                out[0, i] += angle
                out[1, i] += speed
                out[2, i] += acceleration
                jerk[i - start] = third
        if lag.shape[0]:
            here = _follow(time_s, start, stop, jerk, numbers, out)
            least = here if here < least else least
        for i in range(start, stop):
            out[1, i] *= 60.0
            out[2, i] *= 60.0
        start = stop
    return least


@njit(nogil=True, error_model="numpy")
def _passed(time_s, piece, terms, centre_s, reference, gas):  # type: ignore[no-untyped-def]
    """Mean angle less the gas part of the lag at one crank angle, and its rate."""
    after = time_s - piece[0]
    angle, speed, acceleration, _ = _series(time_s - centre_s, terms)
    angle += piece[1] + after * (piece[2] + 0.5 * piece[3] * after)
    speed += piece[2] + piece[3] * after
    acceleration += piece[3]
    if reference > 0.0:
        share = gas * (reference / speed) ** 2
        angle -= share
        speed += 2.0 * share * acceleration / speed
    return angle, speed


@njit(cache=True, nogil=True, error_model="numpy")
def fill_times(angle_rev, knot_s, knot_rev, forwards, numbers, terms, out):  # type: ignore[no-untyped-def]
    """Times at which the crank passes angles in a stretch in which it turns one way, written into ``out``.

    ``angle_rev``: float64 (n,), in the sequence in which they are passed. ``knot_s``: times (m,) that part the stretch
    at its corners, no further apart than a power series reaches. ``knot_rev``: crank angles there. ``forwards``: 1 or
    -1. ``numbers``: as of :func:`fill_motion`. ``terms``:
    zeros (``TERMS``,). ``out``: float64 (n,).
    """
    corner_s, pieces, wobbles, lag, step, reference, _ = numbers
    knot, centre = -1, 0.0
    low_speed = high_speed = 0.0
    piece = pieces[0]
    for i in range(angle_rev.size):
        lags, _, _, _, gas, _, _ = _lag_sums(angle_rev[i], 0.0, lag, step)
        target = angle_rev[i] + lags
        at = knot if knot > 0 else 0
        while at < knot_s.size - 2 and forwards * knot_rev[at + 1] <= forwards * angle_rev[i]:
            at += 1
        low, high = knot_s[at], knot_s[at + 1]
        if at != knot:
            knot, centre = at, 0.5 * (low + high)
            piece = pieces[np.searchsorted(corner_s, centre, side="right")]
            if wobbles.shape[0]:
                _expand(centre, wobbles, terms)
            low_speed = _passed(low, piece, terms, centre, 0.0, 0.0)[1]
            high_speed = _passed(high, piece, terms, centre, 0.0, 0.0)[1]
        # as if the acceleration were even between the knots, which without wobbles it is
        left = target - _passed(low, piece, terms, centre, reference, gas)[0]
        squared = low_speed**2 + 2.0 * left * (high_speed - low_speed) / (high - low)
        time = low + 2.0 * left / (low_speed + forwards * math.sqrt(squared if squared > 0.0 else 0.0))
        if not low <= time <= high:
            time = 0.5 * (low + high) if left * forwards > 0.0 else low
        for _ in range(100):
            angle, speed = _passed(time, piece, terms, centre, reference, gas)
            miss = angle - target
            if miss * forwards > 0.0:
                high = time
            else:
                low = time
            # at round-off a further step would be noise, and a long one where the shaft hardly moves
            if abs(miss) <= 1.2e-16 * (abs(target) + abs(piece[1])) or high - low <= 2.3e-16 * abs(time):
                break
            new = time - miss / speed
            if not low <= new <= high:
                new = 0.5 * (low + high)
            moved = abs(new - time)
            time = new
            if moved <= 2.3e-16 * abs(time):
                break
        out[i] = time


Corner = tuple[float, float]

MOST_WOBBLES = 256
"""Lines that a wander is made of at most: with random phases their sum is as good as Gaussian."""
LEAST_SWING = 1e-100
"""Speed (rev/s) that counts as none: far below it numbers lose their digits."""
MOST_SPANS = 1 << 17
"""Parts of a recording in which turning points are looked for one by one; if more seem to have one, signs decide."""


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
        if any(frequency <= 0 for frequency, _, _ in self.wobbles):
            raise RequestError("no such wobble", place="wobbles", allowed="frequencies above 0 Hz")
        object.__setattr__(self, "_points", _without_straight(self.corners))
        if self._lag is not None:
            rpm = [rpm for _, rpm in self.corners]
            self._lag.check(0.0 if min(rpm) <= 0 <= max(rpm) else min(map(abs, rpm)))

    @property
    def corner_s(self) -> tuple[float, ...]:
        """Times (s, ascending) at which the slope of the profile changes: there the acceleration jumps."""
        return tuple(time for time, _ in self._points[1:-1])

    @property
    def is_steady(self) -> bool:
        """Whether the speed is the same at all times."""
        return not self.corner_s and not len(self._wobbles) and self._lag is None

    def mean_rev(self, time_s: float) -> float:
        """Mean angle (rev) at ``time_s``: what the angle would be there without the lag."""
        if self.is_steady:
            return self.start_rev + self.corners[0][1] / 60 * time_s
        return float(self._mean(np.array([time_s], dtype=np.float64))[0, 0])

    def at(self, time_s: Floats, *, piece: int | None = None) -> tuple[Floats, Floats, Floats]:
        """Crank angle (rev), speed (rpm) and angular acceleration (rpm/s) at each time, arrays (n,).

        ``time_s``: (n,), any values, also before 0; quickest in sequence. ``piece``: k takes the formula that holds
        between ``corner_s[k - 1]`` and ``corner_s[k]`` for all of them, extended beyond its ends; None takes for each
        time the formula that holds there (at a corner the one that follows).

        All three are exact to round-off: angles to a few units in the last place of the revolutions from t = 0. Raises
        RequestError where the shaft would stop within the cycle.
        """
        times = np.ascontiguousarray(time_s, dtype=np.float64)
        if piece is not None and not 0 <= piece <= len(self.corner_s):
            raise RequestError("no such piece of the motion", found=piece, allowed=f"0 … {len(self.corner_s)}")
        out = np.empty((3, times.size))
        least: float = fill_motion(
            times, -1 if piece is None else piece, self._numbers, np.empty(BLOCK), np.empty(TERMS), out
        )
        if not least > 0:
            slowest_rpm = np.abs(self._mean(times, -1 if piece is None else piece)[1]).min()
            raise stops_within_cycle(float(slowest_rpm), lag.slowest_rpm if (lag := self.lag) else 0.0)
        return out[0], out[1], out[2]

    def stretches(self, duration_s: float) -> tuple[tuple[float, float], ...]:
        """First and last time (s) of each part of 0 … ``duration_s`` in which the shaft turns one way, in sequence.

        The speed changes sign between two of them; where it stays at zero there is none. ``duration_s``: > 0.
        """
        cuts = [0.0, *(time for time in self.corner_s if 0 < time < duration_s), duration_s]
        edges = sorted({*cuts, *(time for time in self._zero_speed_s(cuts) if 0 < time < duration_s)})
        middles = np.array([0.5 * (start + stop) for start, stop in pairwise(edges)])
        stretches: list[tuple[float, float]] = []
        way = 0.0
        for (start, stop), rpm in zip(pairwise(edges), self._mean(middles)[1], strict=True):
            if stretches and np.sign(rpm) == way and stretches[-1][1] == start:
                stretches[-1] = (stretches[-1][0], stop)
            elif rpm != 0:
                stretches.append((start, stop))
                way = np.sign(rpm)
        return tuple(stretches)

    def time_at(self, angle_rev: Floats, stretch: tuple[float, float]) -> Floats:
        """Times (s), shape (n,), at which the shaft passes each angle in a stretch, exact to round-off.

        ``angle_rev``: crank angles (n,), revolutions, within the stretch; quickest in sequence. ``stretch``: first and
        last time, of :meth:`stretches` or within one. Raises RequestError for an angle outside.
        """
        angles = np.ascontiguousarray(angle_rev, dtype=np.float64)
        if not angles.size:
            return np.empty(0)
        knots = self._knots(*stretch)
        passed = self.at(knots)[0]
        way = 1.0 if passed[-1] >= passed[0] else -1.0
        first, last = way * passed[0], way * passed[-1]
        slack = 1e-11 * max(1.0, abs(first), abs(last))
        low, high = float((way * angles).min()), float((way * angles).max())
        if not (first - slack <= low and high <= last + slack):
            problem = "the shaft does not pass this angle in the stretch"
            allowed = f"{passed[0]:.17g} … {passed[-1]:.17g} rev"
            raise RequestError(problem, found=f"{way * (low if low < first else high):.17g} rev", allowed=allowed)
        sequence = None if np.all(way * np.diff(angles) >= 0) else np.argsort(way * angles, kind="stable")
        sorted_rev = np.clip(angles if sequence is None else angles[sequence], passed.min(), passed.max())
        times = np.empty(angles.size)
        knot_rev = way * np.maximum.accumulate(way * passed)
        fill_times(sorted_rev, knots, knot_rev, way, self._numbers, np.zeros(TERMS), times)
        if sequence is not None:
            times[sequence] = times.copy()
        return times

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
    def _numbers(self) -> tuple[Floats, Floats, Floats, Floats, float, float, float]:
        """What the compiled passes need, in the sequence in which they take it."""
        lag, table, step = self._lag, np.zeros((0, 5)), 0.0
        if lag is not None:
            columns = (lag.order, lag.inertia.real, lag.inertia.imag, lag.gas.real, lag.gas.imag)
            table, step = _filled(np.stack(columns, axis=1), lag.step)
        gas = lag is not None and lag.has_gas
        reference, slowest = (lag.reference_rpm / 60, lag.slowest_rpm / 60) if gas and lag is not None else (0.0, 0.0)
        start = self.start_rev if lag is None else self.start_rev + float(lag.at(self.start_rev, self._mean_rpm(0.0)))
        pieces = _pieces(self._points, start)
        return np.array(self.corner_s, dtype=np.float64), pieces, self._wobbles, table, step, reference, slowest

    def _mean(self, time_s: Floats, piece: int = -1) -> Floats:
        """Angle, speed and acceleration without the lag, shape (3, n)."""
        out = np.empty((3, time_s.size))
        no_lag = np.zeros((0, 5)), 0.0, 0.0, 0.0
        fill_motion(time_s, piece, (*self._numbers[:3], *no_lag), np.empty(BLOCK), np.empty(TERMS), out)
        return out

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

    def _zero_speed_s(self, cuts: list[float]) -> list[float]:
        """Times at which the mean speed is or crosses zero; between two of ``cuts`` its slope has no jump."""
        if not len(self._wobbles):
            crossings = []
            for (start, before), (stop, after) in pairwise([(time, self._mean_rpm(time)) for time in cuts]):
                if before * after < 0:
                    crossings.append(start + before / (before - after) * (stop - start))
            return crossings
        slope = 2 * np.pi * np.abs(self._wobbles[:, 0] * self._wobbles[:, 1]) * 60
        straight = [abs(after - before) / (stop - start) for (start, before), (stop, after) in pairwise(self._points)]
        steepest = float(slope.sum()) + max(straight)
        bent = float((2 * np.pi * self._wobbles[:, 0] * slope).sum())
        low, high = np.array(cuts[:-1]), np.array(cuts[1:])
        crossings = []
        for _ in range(200):
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            _, rpm, rate = self._mean(middle)
            near = (np.abs(rpm) <= steepest * half) & (half > 1e-15 * (1 + np.abs(middle)))
            one_way = (np.abs(rate) > bent * half) | (low.size > MOST_SPANS)
            crossings += self._crossings(low[near & one_way], high[near & one_way])
            low, middle, high = low[near & ~one_way], middle[near & ~one_way], high[near & ~one_way]
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
            if not low.size:
                break
        return crossings

    def _crossings(self, low: Floats, high: Floats) -> list[float]:
        """Where the mean speed, which rises or falls throughout from each ``low`` to ``high``, is zero."""
        below, above = self._mean(low)[1], self._mean(high)[1]
        change = below * above <= 0
        low, high, rising = low[change], high[change], (above > below)[change]
        for _ in range(80):
            middle = 0.5 * (low + high)
            passed = (self._mean(middle)[1] > 0) == rising
            low, high = np.where(passed, low, middle), np.where(passed, middle, high)
        return [float(time) for time in 0.5 * (low + high)]


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
    if slopes[origin] == 0:
        rpm_at_0 = points[origin][1]
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
