"""The moving shaft at many times in one compiled pass: times in, angle, speed and acceleration out, and back again.

Slow wobbles are summed once for a block of neighbouring times, as a power series about the middle of the block: its
error is below round-off, and the cost per sample does not grow with their number. Inside, angles are revolutions and
time is seconds. The plain version, sine by sine and without blocks, is in the tests.
"""

from __future__ import annotations

import math

from numba import njit

from crankorder.engine.fast_acceleration import fast_sine_cosine

TWO_PI = 2 * math.pi
BLOCK = 512
"""Most times that share a power series."""
REACH_RAD = 0.3
"""How far the fastest wobble may turn from the middle of a block: its 16th power over 16! is 2e-22."""
TERMS = 16
CLOSE_REV = 1e-9
"""A Newton step of this length is the last one: cubic convergence leaves nothing."""


@njit(nogil=True, error_model="numpy")
def _piece_at(time_s, corner_s):  # type: ignore[no-untyped-def]
    low, high = 0, corner_s.size
    while low < high:
        middle = (low + high) // 2
        if corner_s[middle] <= time_s:
            low = middle + 1
        else:
            high = middle
    return low


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
def _follow(time_s, start, stop, jerk, lag, step, reference, slowest, out):  # type: ignore[no-untyped-def]
    """Turn the mean motion in ``out`` into that of the crank; returns the least of what must stay above zero."""
    widest = gas_widest = 0.0
    for k in range(lag.shape[0]):
        widest += math.hypot(lag[k, 1], lag[k, 2])
        gas_widest += math.hypot(lag[k, 3], lag[k, 4])
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
def fill_motion(  # type: ignore[no-untyped-def]
    time_s, piece, corner_s, pieces, wobbles, lag, step, reference, slowest, jerk, terms, out
):
    """Angle (rev), speed (rpm) and acceleration (rpm/s) of the crank, written into ``out``, float64 (3, n).

    Returns the least over all times of the rise of mean with crank angle and of crank over mean speed: where it is not
    above zero the shaft stops within the cycle.

    ``time_s``: float64 (n,), quickest where neighbours are close. ``piece``: whose formula, or -1 for each its own.
    ``corner_s``: ascending (c,). ``pieces``: (c + 1, 4) of time, angle, speed and acceleration there. ``wobbles``:
    (w, 3) of frequency (Hz), amplitude (rev/s) and phase (rev). ``lag``: (k, 5) of order, inertia and gas part (rev,
    real and imaginary). ``step``: what the orders are multiples 1, 2, … of, 0 for any. ``reference``: mean speed
    (rev/s) of the gas part, 0 without gas. ``slowest``: mean speed (rev/s) at which the gas stops the shaft. ``jerk``:
    room for (``BLOCK``,) numbers. ``terms``: room for (``TERMS``,).
    """
    top_hz, least, start = 0.0, 1.0, 0
    for row in range(wobbles.shape[0]):
        top_hz = wobbles[row, 0] if wobbles[row, 0] > top_hz else top_hz
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
        first = _piece_at(low, corner_s) if piece < 0 else piece
        last = _piece_at(high, corner_s) if piece < 0 else piece
        for i in range(start, stop):
            k = first if first == last else _piece_at(time_s[i], corner_s)
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
            here = _follow(time_s, start, stop, jerk, lag, step, reference, slowest, out)
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
def fill_times(  # type: ignore[no-untyped-def]
    angle_rev, knot_s, knot_rev, forwards, corner_s, pieces, wobbles, lag, step, reference, terms, out
):
    """Times at which the crank passes angles in a stretch in which it turns one way, written into ``out``.

    ``angle_rev``: float64 (n,), in the sequence in which they are passed. ``knot_s``: times (m,) that part the stretch
    at its corners, no further apart than a power series reaches. ``knot_rev``: crank angles there. ``forwards``: 1 or
    -1. ``corner_s``, ``pieces``, ``wobbles``, ``lag``, ``step``, ``reference``: as of :func:`fill_motion`. ``terms``:
    zeros (``TERMS``,). ``out``: float64 (n,).
    """
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
            piece = pieces[_piece_at(centre, corner_s)]
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
