"""Angle over ten hours, at time stamps of 1e9 s, from float32, and the fast kernels against plain ones."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, angle_knots, time_at
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.smoother import Smoother, penalty_of

SETTINGS = load_settings().shaft


def knots_of(time_s, *, teeth_per_rev=360, noise_s=None, tooth=None):
    tooth = np.arange(time_s.size) if tooth is None else tooth
    return angle_knots(time_s, tooth, teeth_per_rev=teeth_per_rev, noise_s=noise_s, settings=SETTINGS)


def columns(knots):
    return knots.time_s, knots.angle_rev, knots.speed_rpm


def test_ten_hours_at_6000_rpm_do_not_drift():
    revs = 3_600_000
    exact = np.arange(revs + 1) / 100.0
    # a counter of 10 MHz, and a speed that swings by 1 % every 997 revolutions
    wander = 1e-4 / (2 * np.pi) * 997 * 0.01 * np.sin(2 * np.pi * np.arange(revs + 1) / 997)
    time_s = np.round((exact + wander) * 1e7) / 1e7
    knots = knots_of(time_s, teeth_per_rev=1)
    asked = np.linspace(0.0, revs, 200_001)
    passed = asked / 100.0 + 1e-4 / (2 * np.pi) * 997 * 0.01 * np.sin(2 * np.pi * asked / 997)
    error = angle_at(passed, *columns(knots)) - asked
    inside = np.isfinite(error)
    assert inside.mean() > 0.9999
    drift = np.polyfit(asked[inside] / revs, error[inside], 1)[0] / revs
    assert abs(drift) < 1e-12
    # a count is 1e-5 revolutions
    assert np.abs(error[inside]).max() < 2e-5


@pytest.mark.slow
def test_ten_hours_of_angles_are_found_back_in_time():
    revs = 3_600_000
    knots = knots_of(np.arange(revs + 1) / 100.0, teeth_per_rev=1, noise_s=1e-9)
    asked = np.linspace(1.0, revs - 1.0, 100_001)
    # half a spacing of float64 each: the time wanted, the pulses at both ends of an interval, its two knots, its
    # length, and the time found
    limit_s = 3.5 * np.spacing(36_000.0)
    np.testing.assert_allclose(time_at(asked, *columns(knots)), asked / 100.0, rtol=0, atol=limit_s)
    np.testing.assert_allclose(angle_at(time_at(asked, *columns(knots)), *columns(knots)), asked, rtol=0, atol=2e-9)


def test_time_stamps_of_a_billion_seconds_lose_no_more_than_their_own_precision(known_shaft):
    shaft = known_shaft(1234.5)
    start_s = 1e9
    stamps = shaft.pulse_time_s(360) + start_s
    spacing_s = np.spacing(start_s)
    near, far = knots_of(stamps - start_s, noise_s=spacing_s), knots_of(stamps, noise_s=spacing_s)
    np.testing.assert_allclose(far.time_s - start_s, near.time_s, rtol=0, atol=0.51 * spacing_s)
    np.testing.assert_array_equal(far.angle_rev, near.angle_rev)
    np.testing.assert_array_equal(far.speed_rpm, near.speed_rpm)
    reached = angle_at(shaft.time_s + start_s, *columns(far)) - shaft.angle_rev()
    reached = reached[np.isfinite(reached)]
    # the stamp of a sample and that of a knot are each rounded
    assert np.ptp(reached) < 3.0 * spacing_s * 1234.5 / 60.0


@pytest.mark.cases(1)
@pytest.mark.parametrize("duration_s", [30.0, 3.0])
def test_float32_pulse_times_state_their_limit(known_shaft, duration_s):
    shaft = known_shaft(1234.5, duration_s=duration_s)
    exact = shaft.pulse_time_s(360)
    single = exact.astype(np.float32)
    spacing_s = float(np.spacing(single[-1]))
    knots = knots_of(single, noise_s=1e-12)
    assert knots.noise_s == pytest.approx(spacing_s / np.sqrt(12.0))
    error = angle_at(exact, *columns(knots)) * 360.0 - np.arange(exact.size)
    stated = 360.0 * float(np.median(knots.standard_error_rev))
    assert np.nanstd(error) < 1.25 * stated
    assert stated < 0.51 * spacing_s * 360.0 * 1234.5 / 60.0
    # the same numbers in float64 say the same, and times that never were float32 are not taken for it
    np.testing.assert_array_equal(knots_of(single.astype(float), noise_s=1e-12).time_s, knots.time_s)
    assert knots_of(exact, noise_s=1e-12).noise_s < 1e-11


def plain_fired(trace, arm, fire):
    armed, fired = False, []
    for i, value in enumerate(trace):
        if armed and value > fire:
            armed = False
            fired.append(i)
        elif value < arm:
            armed = True
    return np.array(fired)


def test_bits_in_words_find_the_edges_that_one_sample_after_the_other_finds():
    for size in [2, 63, 64, 65, 127, 128, 1000]:
        for edge in ["rising", "falling"]:
            rng = np.random.default_rng(size)
            sign = 1.0 if edge == "rising" else -1.0
            for smooth in (1, 3, 20):
                trace = np.convolve(rng.standard_normal(size + 40), np.ones(smooth), "same")[:size]
                trace[rng.integers(0, size, size // 30)] = np.nan
                trace[:2] = -sign * 50.0, sign * 50.0
                low, high = -50.0, 50.0
                trace[-1] = sign * 50.0
                found = find_pulses(trace, rate_hz=1.0, kind="square", edge=edge, pulses_per_rev=1, settings=SETTINGS)
                finite = trace[np.isfinite(trace)]
                for _ in range(2):
                    middle = 0.5 * (low + high)
                    low, high = finite[finite <= middle].mean(), finite[finite > middle].mean()
                half, middle = 0.5 * SETTINGS.hysteresis_fraction * (high - low), 0.5 * sign * (low + high)
                fired = plain_fired(sign * trace, middle - half, middle + half)
                back = [next(j for j in range(i, -1, -1) if not sign * trace[j] > middle) for i in fired]
                crossed = [j for j in back if sign * trace[j] <= middle]
                wanted = [j + (middle - sign * trace[j]) / (sign * (trace[j + 1] - trace[j])) for j in crossed]
                np.testing.assert_allclose(found.time_s, wanted, rtol=0, atol=1e-9)


def test_angle_and_time_between_knots_are_those_of_the_cubics_of_scipy():
    for uneven in [0.0, 0.02, 0.4]:
        for per_knot in [1, 5, 200]:
            rng = np.random.default_rng(8)
            time_s = np.arange(60) * 0.01
            angle = 0.3 + 20.0 * time_s + uneven * 0.02 * np.sin(40.0 * time_s)
            rate = 20.0 + uneven * 0.8 * np.cos(40.0 * time_s)
            cubic = CubicHermiteSpline(time_s, angle, rate)
            wanted = np.sort(rng.uniform(0.0, 0.59, 60 * per_knot))
            np.testing.assert_allclose(angle_at(wanted, time_s, angle, 60.0 * rate), cubic(wanted), rtol=0, atol=3e-14)
            np.testing.assert_allclose(time_at(cubic(wanted), time_s, angle, 60.0 * rate), wanted, rtol=0, atol=1e-15)


@pytest.mark.cases(1)
@pytest.mark.parametrize(("cut_off", "holes"), [(0.011, 2), (0.011, 0), (0.05, 3), (0.3, 20)])
def test_settled_factors_give_the_solution_of_all_equations(cut_off, holes):
    rng = np.random.default_rng(3)
    n = 1500
    weight = np.ones(n)
    weight[rng.integers(10, n - 10, holes)] = 0.0
    value, penalty = np.sin(np.arange(n) / 70.0) + 0.05 * rng.standard_normal(n), penalty_of(cut_off)
    third = np.diff(np.eye(n), n=3, axis=0)
    system = np.diag(weight) + penalty * third.T @ third
    found = Smoother(weight, penalty).smoothed(value)
    direct = value - np.linalg.solve(system, penalty * third.T @ (third @ value))
    np.testing.assert_allclose(found, direct, rtol=0, atol=2e-6)
    np.testing.assert_allclose(Smoother(weight, penalty).leverage(), np.diag(np.linalg.inv(system)), rtol=1e-4)
    assert len(Smoother(weight, penalty).table) < 0.7 * n


def test_a_shaft_that_is_not_smoothed_follows_the_spline_through_its_pulses(known_shaft):
    shaft = known_shaft(900.0, duration_s=1.0, irregularity={0.5: 0.02, 3.0: 0.02})
    time_s = shaft.pulse_time_s(90)
    knots = knots_of(time_s, teeth_per_rev=90, noise_s=1e-13)
    assert knots.cut_off_order == np.inf
    spline = CubicSpline(np.arange(time_s.size) / 90.0, time_s)
    inner = slice(20, -20)
    at = spline(knots.angle_rev)
    np.testing.assert_allclose(knots.time_s[inner], at[inner], rtol=0, atol=1e-12)
    speed = 60.0 / spline(knots.angle_rev, 1)
    np.testing.assert_allclose(knots.speed_rpm[inner], speed[inner], rtol=1e-9)
