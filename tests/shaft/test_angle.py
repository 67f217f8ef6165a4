"""Smoothed angle against shafts whose angle is known, and the interpolation between knots."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.quantities import flags_of
from crankorder.shaft.angle import angle_at, angle_knots, time_at
from crankorder.shaft.pattern import pattern_of
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.uneven_wheel import wheel_of
from crankorder.shaft.wheel import number_teeth
from made.recordings import write_hdf5, write_manifest
from made.shipped import SETTINGS, SHAFT


def knots_of(time_s, *, teeth_per_rev=360, noise_s=None, tooth=None):
    tooth = np.arange(time_s.size) if tooth is None else tooth
    return angle_knots(time_s, tooth, teeth_per_rev=teeth_per_rev, noise_s=noise_s, settings=SHAFT)


def columns(knots):
    return knots.time_s, knots.angle_rev, knots.speed_rpm


def evaluated(knots, time_s):
    return angle_at(time_s, *columns(knots))


def from_square(shaft, pulses_per_rev=360):
    """Knots and the error of the angle [rev] from the sampled square wave of a shaft, the zero of the count aside."""
    found = find_pulses(
        shaft.square(pulses_per_rev), rate_hz=shaft.rate_hz, kind="square", edge="rising",
        pulses_per_rev=pulses_per_rev, settings=SHAFT,
    )  # fmt: skip
    knots = knots_of(found.time_s, teeth_per_rev=pulses_per_rev, noise_s=found.noise_s)
    error = evaluated(knots, shaft.time_s) - shaft.angle_rev()
    error = error[np.isfinite(error)]
    return knots, error - np.round(np.mean(error) * pulses_per_rev) / pulses_per_rev, found.noise_s


# a speed that keeps no step with the sampling; those that do are in the next test
def test_quantised_edges_average_out_and_the_standard_error_says_how_far(known_shaft):
    knots, error, noise_s = from_square(known_shaft(1711.0, duration_s=6.0))
    edge_noise = noise_s * 1711.0 / 60.0
    stated = float(np.median(knots.standard_error_rev))
    assert error.std() < 0.45 * edge_noise
    assert error.std() < 1.25 * stated
    assert abs(error.mean()) < 0.02 * edge_noise
    assert stated < 0.5 * edge_noise


def test_edges_in_step_with_the_sampling_err_by_less_than_one_edge(known_shaft):
    for speed_rpm in [1000.0, 1041.6, 2000.0]:
        _, error, noise_s = from_square(known_shaft(speed_rpm, duration_s=6.0))
        assert error.std() < 0.5 * noise_s * speed_rpm / 60.0
        assert np.abs(error).max() < 1.0 / 50_000.0 * speed_rpm / 60.0


def test_in_cycle_irregularity_survives_smoothing(known_shaft):
    shaft = known_shaft(1234.5, duration_s=6.0, irregularity={0.5: 0.01, 2.0: 0.015, 6.0: 0.004, 12.0: 0.002})
    _, error, _ = from_square(shaft)
    steady = shaft.speed_rpm / 60.0 * shaft.time_s[: error.size]
    for order, share in shaft.irregularity.items():
        swing = share / (2 * np.pi * order)
        left = 2 * abs(np.mean(error * np.exp(-2j * np.pi * order * steady)))
        assert left < (0.01 if order < 10 else 0.05) * swing


def test_the_standard_error_is_that_of_many_draws():
    rng = np.random.default_rng(4)
    noise_s, exact = 1e-5, np.arange(400) / 6000.0
    draws = [knots_of(exact + noise_s * rng.standard_normal(exact.size), noise_s=noise_s) for _ in range(200)]
    assert len({knots.cut_off_order for knots in draws}) == 1
    stride = round(float(np.diff(draws[0].time_s[1:3])[0] * 6000.0))
    at = np.array([1, 2, 10, len(draws[0].time_s) // 2])
    time_s = (at * stride - 1) / 6000.0
    error = np.array([evaluated(knots, time_s) - time_s * 6000.0 / 360.0 for knots in draws])
    # the posterior variance counts what is smoothed away as well: a little more than the scatter
    ratio = draws[0].standard_error_rev[at] / error.std(axis=0)
    assert (ratio > 0.9).all()
    assert (ratio < 1.35).all()
    np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=4 * error.std(axis=0).max() / np.sqrt(200))


def test_jitter_beyond_the_stated_noise_is_told_from_motion():
    rng = np.random.default_rng(5)
    exact = np.arange(600) / 40.0
    jitter = knots_of(exact + 1e-3 * rng.standard_normal(600), teeth_per_rev=1, noise_s=3e-4)
    assert jitter.noise_s == pytest.approx(1e-3, rel=0.1)
    assert np.ptp(jitter.speed_rpm) < 0.05 * 2400.0
    alternating = knots_of(exact + 1e-3 * (-1.0) ** np.arange(600), teeth_per_rev=1, noise_s=3e-4)
    assert alternating.noise_s == pytest.approx(3e-4)
    np.testing.assert_allclose(evaluated(alternating, exact[10:590:2] + 1e-3), np.arange(10, 590, 2), atol=1e-3)


def test_holes_in_the_teeth_widen_the_standard_error_and_keep_the_angle(known_shaft):
    shaft = known_shaft(1234.5)
    time_s = shaft.pulse_time_s(60)
    keep = np.delete(np.arange(time_s.size), range(1000, 1004))
    knots = knots_of(time_s[keep], tooth=keep, teeth_per_rev=60, noise_s=1e-9)
    inside = (knots.time_s > time_s[999]) & (knots.time_s < time_s[1004])
    assert knots.standard_error_rev[inside].max() > 2 * np.median(knots.standard_error_rev)
    between = shaft.time_s[(shaft.time_s > time_s[0]) & (shaft.time_s < time_s[-1])]
    error = evaluated(knots, between) - shaft.angle_rev(between)
    np.testing.assert_allclose(error, np.mean(error), atol=3e-6)


@given(
    st.lists(st.floats(0.01, 10.0), min_size=2, max_size=20),
    st.lists(st.floats(0.01, 10.0), min_size=20, max_size=20),
    st.lists(st.floats(0.0, 3.0), min_size=21, max_size=21),
)
def test_angle_and_time_are_inverse_and_grow_between_any_knots(steps, rises, slopes):
    steps, rises = np.array(steps), np.array(rises[: len(steps)])
    time_s, angle = np.cumsum(np.append(0.0, steps)), np.cumsum(np.append(-2.0, rises))
    secant = rises / steps
    limit = np.minimum(np.append(secant, np.inf), np.append(np.inf, secant))
    speed = 60.0 * np.array(slopes[: limit.size]) * limit
    wanted = np.linspace(time_s[0], time_s[-1], 301)
    reached = angle_at(wanted, time_s, angle, speed)
    assert (np.diff(reached) >= -1e-12).all()
    back = angle_at(time_at(reached, time_s, angle, speed), time_s, angle, speed)
    np.testing.assert_allclose(back, reached, atol=1e-11)
    np.testing.assert_array_equal(angle_at(wanted[::-1], time_s, angle, speed)[::-1], reached)


def test_outside_the_knots_there_is_no_angle_and_the_outermost_are_known():
    knots = (np.array([0.0, 1.0]), np.array([0.0, 2.0]), np.array([120.0, 120.0]))
    np.testing.assert_array_equal(np.isnan(angle_at([-0.1, 0.0, 0.5, 1.0, 1.1, np.nan], *knots)), [1, 0, 0, 0, 1, 1])
    np.testing.assert_array_equal(np.isnan(time_at([-0.1, 0.0, 2.0, 2.1], *knots)), [1, 0, 0, 1])
    assert time_at(0.5, *knots)[0] == pytest.approx(0.25)


def test_knots_reach_one_tooth_beyond_the_pulses_and_no_further(known_shaft):
    time_s = known_shaft(1000.0, irregularity={}).pulse_time_s(60)
    knots = knots_of(time_s, teeth_per_rev=60, noise_s=1e-9)
    assert time_s[0] - knots.time_s[0] == pytest.approx(1e-3, rel=1e-3)
    assert knots.time_s[-1] - time_s[-1] == pytest.approx(1e-3, rel=1e-3)


# Angle on wheels whose teeth are few and uneven: no worse than a spline through the pulses, with an honest error.


REVS_PER_S = 15.0


def swinging_angle(time_s):
    """Crank angle [rev] at 900 rpm, uneven by 1 % in orders 0.5 and 1.5."""
    steady = 0.37 + REVS_PER_S * time_s
    return steady + sum(0.005 / (2 * np.pi * k) * np.sin(2 * np.pi * k * steady + k) for k in (0.5, 1.5))


def pulses_of(name, duration_s=4.0):
    places = np.array(pattern_of(name).angles_deg) / 360.0
    last = swinging_angle(duration_s)
    wanted = (np.arange(int(last) + 1)[:, None] + places).ravel()
    wanted = wanted[(wanted > swinging_angle(0.0)) & (wanted < last)]
    time_s = (wanted - 0.37) / REVS_PER_S
    for _ in range(50):
        time_s -= (swinging_angle(time_s) - wanted) / REVS_PER_S
    return time_s, wanted


def knots_and_error(name, noise_s, at):
    """Knots, the error of the angle at ``at``, and that of the cubic spline through the same pulses."""
    exact, place = pulses_of(name)
    pulse_s = exact + noise_s * np.random.default_rng(3).standard_normal(exact.size)
    angles = pattern_of(name).angles_deg
    teeth = number_teeth(pulse_s, wheel_of(1, tooth_angles_deg=angles), settings=SHAFT)
    knots = angle_knots(
        teeth.time_s, teeth.tooth, teeth_per_rev=teeth.teeth_per_rev, noise_s=max(noise_s, 1e-9), settings=SHAFT
    )
    turned = pattern_of(name).repeats
    error = angle_at(at, knots.time_s, knots.angle_rev, knots.speed_rpm) - swinging_angle(at)
    error -= np.round(np.median(error) * teeth.teeth_per_rev * turned) / (teeth.teeth_per_rev * turned)
    return knots, error, CubicSpline(pulse_s, place)(at) - swinging_angle(at)


@pytest.mark.parametrize(("name", "noise_s"), [("12+1", 0.0), ("gm-24x", 1e-6), ("subaru-6", 1e-5)])
def test_between_the_teeth_of_any_wheel_the_angle_is_as_good_as_a_spline_and_its_error_is_stated(name, noise_s):
    at = np.linspace(0.5, 3.5, 30_011)
    knots, error, splined = knots_and_error(name, noise_s, at)
    assert np.std(error) < 1.02 * np.std(splined)
    stated = np.interp(at, knots.time_s, knots.standard_error_rev)
    assert np.quantile(np.abs(error) / stated, 0.95) < 2.3
    # stated for the teeth that have a pulse, and for the others by how the shaft moves, not by how it might
    assert knots.standard_error_rev.min() < 1.01 * max(noise_s, 1e-9) * REVS_PER_S * 1.01
    assert np.median(stated) < 2.0 * noise_s * REVS_PER_S + 1e-4


# A shaft that turns backwards is told by the second track of its encoder, and by nothing else.


RATE_HZ, LINES = 20_000.0, 60
ENCODER = {"kind": "square", "source": "a", "second_track": "b", "pulses_per_rev": 60}


def flags(folder, turns, *, edge="rising", second=None):
    """Flags on the direction of a shaft at ``turns`` (sample,), A leading B by a quarter of a line forwards."""
    write_manifest(folder, "*.h5", channels={"Z": {"source": "z"}}, encoder=ENCODER | {"edge": edge})
    first, behind = (((turns * LINES - late) % 1.0 < 0.5).astype(np.float32) for late in (0.0, 0.25))
    noise = np.random.default_rng(1).standard_normal(turns.size)
    columns = {"z": noise, "a": first, "b": behind if second is None else second}
    write_hdf5(folder / "a.h5", columns, rate_hz=RATE_HZ)
    read = read_recording(folder / "a.h5", load_manifest(folder), settings=SETTINGS.ingest, shaft=SETTINGS.shaft)
    return {one["flag"]: one["detail"] for one in flags_of(read) if "direction" in one["flag"] or "back" in one["flag"]}


TIME_S = np.arange(int(2.0 * RATE_HZ)) / RATE_HZ


@pytest.mark.parametrize("edge", ["rising", "falling"])
def test_d8_a_shaft_that_turns_backwards_is_told_and_one_that_turns_forwards_is_not(tmp_path, edge):
    assert flags(tmp_path / "forwards", 20.0 * TIME_S + 0.003, edge=edge) == {}
    told = flags(tmp_path / "backwards", -20.0 * TIME_S + 0.003, edge=edge)
    assert list(told) == ["turns_backwards"] and "100.0%" in told["turns_backwards"]


def test_d8_a_shaft_that_turns_round_is_told_with_its_place(tmp_path):
    there_and_back = np.where(TIME_S < 1.5, 20.0 * TIME_S, 60.0 - 20.0 * TIME_S) + 0.003
    told = flags(tmp_path / "round", there_and_back)
    assert list(told) == ["direction_changes"]
    assert "25.0%" in told["direction_changes"] and "at pulse 1800" in told["direction_changes"]


def test_d8_a_dead_second_track_says_nothing(tmp_path):
    assert list(flags(tmp_path / "dead", 20.0 * TIME_S + 0.003, second=np.ones(TIME_S.size))) == ["direction_unknown"]


def test_a_second_track_goes_with_a_sampled_one(tmp_path):
    write_manifest(tmp_path, channels={"Z": {"source": "z"}}, encoder=ENCODER | {"kind": "pulse_times"})
    with pytest.raises(Exception, match="a second track is a sampled trace"):
        load_manifest(tmp_path)


# Angle over ten hours, at time stamps of 1e9 s, from float32, and the fast kernels against plain ones.


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


def test_float32_pulse_times_state_their_limit(known_shaft):
    shaft = known_shaft(1234.5, duration_s=30.0)
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
