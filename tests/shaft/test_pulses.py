"""Pulses from sampled traces: counts, positions and their stated noise."""

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.settings import load_settings
from crankorder.shaft.pulses import find_pulses


def pulses(trace, *, kind="square", edge="rising", rate_hz=50_000.0, pulses_per_rev=360):
    return find_pulses(
        trace, rate_hz=rate_hz, kind=kind, edge=edge, pulses_per_rev=pulses_per_rev, settings=load_settings().shaft
    )


def test_every_edge_of_a_sampled_square_wave_is_found_within_half_a_sample(known_shaft):
    shaft = known_shaft(2000.3)
    found = pulses(shaft.square(360))
    exact = shaft.pulse_time_s(360)
    exact = exact[(exact > 0) & (exact <= shaft.time_s[-1])]
    assert found.time_s.size == exact.size
    error = (found.time_s - exact) * 50_000.0
    assert np.abs(error).max() <= 0.5 + 1e-9
    assert found.noise_s * 50_000.0 == pytest.approx(error.std(), rel=0.05)
    assert abs(error.mean()) < 0.03
    assert found.flags[0][0] == "encoder_edge_quantised"


def test_the_levels_and_the_type_of_a_square_wave_do_not_matter(known_shaft):
    trace = known_shaft(1000.0).square(360)
    wanted = pulses(trace).time_s
    for low, high in [(0.0, 5.0), (-4.2, 4.1), (0.0, 1.0), (1000.0, 30_000.0)]:
        np.testing.assert_array_equal(pulses(low + (high - low) * trace).time_s, wanted)
    for kind in (np.float64, np.int16, np.uint8, np.bool_):
        np.testing.assert_array_equal(pulses(trace.astype(kind)).time_s, wanted)


def test_noise_on_a_square_wave_makes_no_false_pulse(known_shaft):
    shaft = known_shaft(400.0)
    noisy = 5.0 * shaft.square(60) + 0.08 * np.random.default_rng(1).standard_normal(shaft.time_s.size)
    assert pulses(noisy, pulses_per_rev=60).time_s.size == pulses(shaft.square(60)).time_s.size


def test_samples_on_the_edges_carry_its_position(known_shaft):
    shaft = known_shaft(500.0)
    soft = np.clip(0.5 + 8.0 * np.sin(2 * np.pi * 60 * shaft.angle_rev()), 0.0, 1.0)
    found = pulses(soft)
    exact = shaft.pulse_time_s(60)
    nearest = exact[np.searchsorted(exact, found.time_s - 1e-4)]
    error = (found.time_s - nearest) * 50_000.0
    assert error.std() < 0.02
    assert found.noise_s * 50_000.0 < 0.1
    assert found.flags[0][0] == "encoder_edge_interpolated"


def test_a_pickup_whose_height_grows_with_speed_keeps_every_tooth():
    time_s = np.arange(200_000) / 50_000.0
    speed_hz = 3.0 + 12.0 * time_s
    angle = np.cumsum(speed_hz) / 50_000.0
    trace = 0.1 * speed_hz * np.sin(2 * np.pi * 36 * angle)
    found = pulses(trace, kind="analogue", pulses_per_rev=36)
    whole = np.flatnonzero(np.diff(np.floor(36 * angle)) > 0)
    assert 0 <= whole.size - found.time_s.size <= 2
    np.testing.assert_allclose(found.time_s[-100:] * 50_000.0, whole[-100:] + 0.5, atol=0.6)


def test_noise_of_a_standing_wheel_gives_no_pulses():
    time_s = np.arange(100_000) / 50_000.0
    turning = time_s < 1.0
    trace = np.where(turning, np.sin(2 * np.pi * 600 * time_s), 0.0)
    trace = trace + 0.002 * np.random.default_rng(2).standard_normal(time_s.size)
    found = pulses(trace, kind="analogue", pulses_per_rev=36)
    assert found.time_s[-1] < 1.01
    assert found.time_s.size == pytest.approx(600, abs=1)


def test_samples_that_are_not_a_number_are_counted_and_passed_over(known_shaft):
    trace = known_shaft(300.0).square(60)
    wanted = pulses(trace).time_s
    trace[100:110] = np.nan
    found = pulses(trace)
    assert ("encoder_gap", "suspect", f"10 of {trace.size} encoder samples are not a number") in found.flags
    assert abs(found.time_s.size - wanted.size) <= 1


def test_noise_taken_for_a_square_wave_is_called_unclear(known_shaft):
    noise = np.random.default_rng(7).standard_normal(20_000)
    assert "encoder_unclear" in {flag for flag, _, _ in pulses(noise).flags}
    shaft = known_shaft(700.0)
    for trace in (shaft.square(60), np.sin(2 * np.pi * 60 * shaft.angle_rev())):
        assert "encoder_unclear" not in {flag for flag, _, _ in pulses(trace).flags}


def test_a_trace_without_pulses_is_refused_with_a_remedy():
    for trace in [np.zeros(1000), np.full(1000, 4.9), np.full(1000, np.nan), np.zeros(0)]:
        with pytest.raises(InputError) as error:
            pulses(trace)
        assert "encoder" in str(error.value)


@pytest.mark.parametrize("name", ["E0FULLOAD4EngineOff.txt", "E10FULLLOAD1.txt"])
def test_a_real_pickup_gives_58_teeth_between_gaps_running_and_coasting(shared_data, name):
    (path,) = (shared_data / "tue_genset").rglob(name)
    trace = np.loadtxt(path, usecols=2 if "Training Set" in str(path) else 1)
    found = pulses(trace, kind="analogue", rate_hz=100_000.0, pulses_per_rev=60)
    interval = np.diff(found.time_s)
    gap = np.flatnonzero(interval[1:-1] > 2.2 * np.median(interval)) + 1
    local = np.flatnonzero(interval[1:-1] > 2.2 * np.minimum(interval[:-2], np.roll(interval, -3)[:-2])) + 1
    behind = np.intersect1d(gap, local) if "OFF" in name.upper() else gap
    assert behind.size >= 7
    assert set(np.diff(behind)) == {58}


def test_a_mark_of_two_levels_is_read_as_a_square_wave_beside_a_pickup(known_shaft):
    shaft = known_shaft(300.0, duration_s=6.0)
    trace = 5.0 * (shaft.angle_rev() % 1.0 < 1 / 360) + 0.02 * np.random.default_rng(9).standard_normal(
        shaft.time_s.size
    )
    found = pulses(trace, kind="analogue", pulses_per_rev=1)
    np.testing.assert_array_equal(found.time_s, pulses(trace, pulses_per_rev=1).time_s)
    exact = shaft.pulse_time_s(1)
    np.testing.assert_allclose(found.time_s, exact[exact > 0], atol=1.0 / 50_000.0)


def test_a_narrow_mark_of_a_pickup_is_found_once_per_revolution_and_always_alike(known_shaft):
    for shape in ["bump", "bipolar"]:
        for duty in [0.05, 0.01, 0.002]:
            shaft = known_shaft(300.0, duration_s=6.0)
            place = ((shaft.angle_rev() + 0.5) % 1.0 - 0.5) / (0.5 * duty)
            wave = np.exp(-0.5 * place**2) * (place if shape == "bipolar" else 1.0)
            trace = wave + 0.003 * np.random.default_rng(3).standard_normal(place.size)
            found = pulses(trace, kind="analogue", pulses_per_rev=1)
            assert found.time_s.size == pytest.approx(np.sum(np.diff(np.floor(shaft.angle_rev())) > 0), abs=1)
            where = (shaft.angle_rev(found.time_s) + 0.5) % 1.0 - 0.5
            assert np.std(where) < 0.1 * duty
            assert abs(np.mean(where)) < 1.5 * duty


def test_rare_marks_of_a_long_trace_are_seen_wherever_they_are():
    trace = np.zeros(1_000_000, dtype=np.float32)
    trace[20_000::111_111] = 1.0
    found = pulses(trace, pulses_per_rev=1)
    np.testing.assert_allclose(found.time_s * 50_000.0, np.arange(20_000, 1_000_000, 111_111) - 0.5)
