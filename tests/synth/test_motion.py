"""A shaft's motion is one smooth formula: its rates are its derivatives, and every angle has its time."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crankorder.engine.torsional_fluctuation import Lag
from crankorder.errors import RequestError
from crankorder.synth.motion import Motion, wander_wobbles

EPS = np.finfo(float).eps
PROFILE = ((0.5, 900.0), (2.0, 1500.0), (3.0, 1500.0), (4.5, -600.0), (6.0, -600.0))
FORWARDS = ((0.5, 900.0), (2.0, 1500.0), (3.0, 1500.0), (4.5, 700.0))
WOBBLES = ((0.7, 40.0, 30.0), (3.1, 12.0, -100.0), (11.0, 2.0, 200.0))


def _lag(*, gas=True, orders=(0.5, 1.0, 1.5, 2.0, 4.0, 6.0)):
    order = np.array(orders)
    inertia = 4e-3 / order**2 * np.exp(1j * order)
    return Lag(order=order, inertia=inertia, gas=gas * 2e-3 / order * np.exp(2j * order**2), reference_rpm=1000.0)


def _mean(motion, time_s):
    """Mean angle from t = 0 and its three derivatives, rev and s: sine by sine, in extended precision."""
    time = np.asarray(time_s, dtype=np.longdouble)
    corner_s, corner_rpm = np.array(motion.corners, dtype=np.longdouble).T
    knots = np.concatenate([[min(time.min(), 0) - 1], corner_s, [max(time.max(), corner_s[-1]) + 1]])
    rpm = np.concatenate([corner_rpm[:1], corner_rpm, corner_rpm[-1:]])
    slope = np.diff(rpm) / np.diff(knots)
    turned = np.concatenate([[0], np.cumsum((rpm[1:] + rpm[:-1]) / 120 * np.diff(knots))])

    def profile(t):
        k = np.searchsorted(knots, t, side="right") - 1
        after = t - knots[k]
        return turned[k] + after * (rpm[k] + slope[k] * after / 2) / 60, (rpm[k] + slope[k] * after) / 60, slope[k] / 60

    angle, speed, acceleration = profile(time)
    angle, jerk = angle - profile(np.zeros(1, dtype=np.longdouble))[0], np.zeros_like(time)
    two_pi = 8 * np.arctan(np.longdouble(1))
    for frequency, amplitude, phase in motion.wobbles:
        rate, swing, start = two_pi * np.longdouble(frequency), np.longdouble(amplitude) / 60, two_pi * phase / 360
        angle = angle + swing / rate * (np.sin(rate * time + start) - np.sin(start))
        speed = speed + swing * np.cos(rate * time + start)
        acceleration = acceleration - swing * rate * np.sin(rate * time + start)
        jerk = jerk - swing * rate**2 * np.cos(rate * time + start)
    return angle, speed, acceleration, jerk


def _lag_terms(lag, angle, speed):
    """The lag and what the laws below need of its derivatives, by the definition."""
    turn = 2j * np.pi * lag.order[:, None]
    phasor = np.exp(turn * angle)
    share = (lag.reference_rpm / 60 / speed) ** 2
    both, gas = lag.inertia[:, None] + lag.gas[:, None] * share, lag.gas[:, None]
    return {
        "share": share, "value": (both * phasor).sum(axis=0).real, "by_angle": (turn * both * phasor).sum(axis=0).real,
        "by_angle_twice": (turn**2 * both * phasor).sum(axis=0).real, "by_share": (gas * phasor).sum(axis=0).real,
        "by_both": (turn * gas * phasor).sum(axis=0).real,
    }  # fmt: skip


def test_without_lag_the_motion_is_the_integral_of_profile_and_wobbles_and_a_day_of_turning_loses_no_digits():
    motion = Motion(start_rev=0.37, corners=PROFILE, wobbles=WOBBLES)
    time = np.linspace(-2, 9, 20_001)
    for values, expected, unit in zip(motion.at(time), _mean(motion, time), (1, 60, 60), strict=False):
        known = (expected * unit).astype(float) + (0.37 if unit == 1 else 0)
        np.testing.assert_allclose(values, known, atol=3e-12)
    late = np.array([99_999.9])
    assert float(motion.at(late)[0][0]) == pytest.approx(float(_mean(motion, late)[0][0]) + 0.37, rel=4 * EPS)


@pytest.mark.parametrize(
    ("orders", "gas"), [((0.5, 1.0, 1.5, 2.0, 4.0), True), ((1.0, 2.0, 5.3), False), ((0.9, 2**0.5, np.pi), True)]
)
def test_mean_angle_is_crank_angle_plus_lag_and_so_are_their_rates(orders, gas):
    motion = Motion(start_rev=0.37, corners=FORWARDS, wobbles=WOBBLES, lag=_lag(gas=gas, orders=orders))
    time = np.linspace(-2, 9, 5001)
    angle, speed, acceleration = (part / unit for part, unit in zip(motion.at(time), (1, 60, 60), strict=True))
    mean, rate, bend, third = (part.astype(float) for part in _mean(motion, time))
    lag = _lag_terms(motion.lag, angle, rate)
    share_rate = -2 * lag["share"] * bend / rate
    share_bend = lag["share"] * (6 * (bend / rate) ** 2 - 2 * third / rate)
    np.testing.assert_allclose(angle + lag["value"], mean + motion.mean_start_rev, atol=1e-13)
    np.testing.assert_allclose(speed * (1 + lag["by_angle"]) + lag["by_share"] * share_rate, rate, rtol=1e-13)
    second = acceleration * (1 + lag["by_angle"]) + lag["by_angle_twice"] * speed**2
    second += 2 * lag["by_both"] * share_rate * speed + lag["by_share"] * share_bend
    np.testing.assert_allclose(second, bend, atol=1e-12 * np.abs(acceleration).max())
    assert motion.at(np.zeros(1))[0][0] == pytest.approx(0.37, abs=2 * EPS)


speeds = st.floats(-3000, 3000).map(lambda rpm: round(rpm, 1))


@given(
    rpm=st.lists(speeds, min_size=2, max_size=5),
    spans=st.lists(st.floats(0.2, 3.0), min_size=5, max_size=5),
    wobbles=st.lists(st.tuples(st.floats(0.1, 20.0), st.floats(0.0, 300.0), st.floats(-180, 180)), max_size=3),
    lagging=st.booleans(),
)
@settings(max_examples=10, deadline=None)
def test_every_angle_of_a_stretch_has_its_time(rpm, spans, wobbles, lagging):
    corners = tuple(zip(np.cumsum(spans)[: len(rpm)].tolist(), rpm, strict=True))
    lag = _lag(gas=False) if lagging else None
    motion = Motion(start_rev=0.4, corners=corners, wobbles=tuple(wobbles), lag=lag)
    stretches = motion.stretches(10.0)
    for (_, stop), (start, _) in pairwise(stretches):
        assert stop <= start
    for start, stop in stretches:
        time = np.linspace(start, stop, 100)
        angle, speed, _ = motion.at(time)
        way = np.sign(angle[-1] - angle[0])
        inside = slice(1, -1)
        assert np.all(speed[inside] * way >= -1e-9)
        back = motion.time_at(angle, (start, stop))
        again = motion.at(back)[0]
        # a time has no more digits than its float: as much as the parts of the motion turn in its last place
        size = 1 + np.abs(angle).max() + stop * (max(map(abs, rpm)) + sum(part[1] for part in wobbles)) / 60
        np.testing.assert_allclose(again, angle, rtol=0, atol=8 * EPS * size)
        quick = np.abs(speed) > 1
        np.testing.assert_allclose((back - time)[quick] * speed[quick] / 60, 0, atol=8 * EPS * size)


def test_stretches_end_where_the_shaft_turns_round_and_leave_standstills_out():
    corners = ((1.0, 600.0), (2.0, 0.0), (3.0, 0.0), (4.0, -600.0), (6.0, 600.0))
    motion = Motion(start_rev=0.0, corners=corners)
    assert motion.stretches(8.0) == ((0.0, 2.0), (3.0, 5.0), (5.0, 8.0))
    assert motion.stretches(1.5) == ((0.0, 1.5),)
    assert Motion(start_rev=0.0, corners=((0.0, 0.0),)).stretches(5.0) == ()


def test_wobbles_that_cancel_or_nearly_do_end_the_search_for_turns():
    against = ((3.0, 50.0, 10.0), (3.0, 50.0, 190.0))
    assert Motion(start_rev=0.0, corners=((0.0, 0.0),), wobbles=against).stretches(5.0) == ()
    beating = Motion(start_rev=0.0, corners=((0.0, 0.0),), wobbles=((3.0, 50.0, 10.0), (3.0 + 1e-9, 50.0, 190.0)))
    stretches = beating.stretches(0.9)
    assert len(stretches) == 6  # speed ∝ t · sin(2π 3 t + 10°): it turns where the sine is zero
    np.testing.assert_allclose(stretches[0][1], 170 / 360 / 3, atol=1e-6)


def test_a_shaft_that_would_stop_within_the_cycle_is_refused():
    lag = Lag(order=np.array([2.0]), inertia=np.array([0.0j]), gas=np.array([0.02 + 0j]), reference_rpm=1000.0)
    slowest = 1000 * np.sqrt(4 * np.pi * 0.02)
    assert lag.slowest_rpm == pytest.approx(slowest, rel=1e-2)
    Motion(start_rev=0.0, corners=((0.0, 1.05 * slowest),), lag=lag)
    for corners in (((0.0, 0.95 * slowest),), ((0.0, -2000.0), (1.0, 2000.0)), ((0.0, 2000.0), (1.0, 0.0))):
        with pytest.raises(RequestError, match="stop within the cycle"):
            Motion(start_rev=0.0, corners=corners, lag=lag)
    slowed = Motion(start_rev=0.0, corners=((0.0, 1000.0),), wobbles=((1.0, 900.0, 180.0),), lag=lag)
    with pytest.raises(RequestError, match="stop within the cycle"):
        slowed.at(np.linspace(0, 1, 50))
    always = Lag(order=np.array([2.0]), inertia=np.array([0.09 + 0j]), gas=np.zeros(1, dtype=complex))
    with pytest.raises(RequestError, match="no speed"):
        Motion(start_rev=0.0, corners=((0.0, 1000.0),), lag=always)


def test_a_motion_that_is_none_is_refused():
    endless = ((1.0, float("inf"), 0.0),)
    for corners, wobbles in (
        ((), ()),
        (((1.0, 5.0), (1.0, 6.0)), ()),
        (((0.0, float("nan")),), ()),
        (((0.0, 9.0),), endless),
    ):
        with pytest.raises(RequestError):
            Motion(start_rev=0.0, corners=corners, wobbles=wobbles)


def test_wander_has_its_deviation_and_stays_below_its_corner():
    wobbles = wander_wobbles(7.0, 2.0, np.random.default_rng(4), 30.0)
    assert len(wobbles) == 120
    frequency, strip = np.array([part[0] for part in wobbles]), np.arange(120)
    assert 0 < frequency.min() < frequency.max() <= 2.0
    assert np.all((frequency * 60 >= strip * (1 - 1e-12)) & (frequency * 60 <= (strip + 1) * (1 + 1e-12)))
    motion = Motion(start_rev=0.0, corners=((0.0, 1000.0),), wobbles=wobbles)
    speed = motion.at(np.linspace(0, 3000, 12_001))[1]
    assert speed.std() == pytest.approx(7.0, rel=0.02)
    assert wander_wobbles(0.0, 2.0, np.random.default_rng(4), 30.0) == ()
    assert len(wander_wobbles(1.0, 2.0, np.random.default_rng(4), 1e5)) == 256
    assert wobbles == wander_wobbles(7.0, 2.0, np.random.default_rng(4), 30.0)
