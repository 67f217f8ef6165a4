"""ShaftAngle of every kind of recording: dims, units, references and refusals."""

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.quantities import check_dataset, flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, integrated_speed
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pulses import find_pulses
from made.recordings import sampled

SETTINGS = load_settings().shaft


def decode(recording):
    angle = shaft_angle(recording, settings=SETTINGS)
    check_dataset(angle, "shaft_angle")
    return angle


def test_a_constant_speed_makes_a_straight_line_over_the_record(recording_of):
    angle = decode(recording_of(None, encoder_kind="constant", speed_rpm=1500.0, rate_hz=1000.0, start_s=2.0))
    np.testing.assert_allclose(angle["time"], [2.0, 7.001])
    np.testing.assert_allclose(np.diff(angle["crank_angle"]), 5.001 * 25.0)
    assert angle.attrs["phase_reference"] == "none"
    assert "no_index" in {item["flag"] for item in flags_of(angle)}


def test_a_recording_by_crank_angle_has_two_knots(recording_of):
    for speed_rpm, elapsed_s in [(1200.0, 5000 / 360 / 20.0), (np.nan, np.nan)]:
        angle = decode(
            recording_of(
                None, domain="crank_angle", encoder_kind="none", samples_per_rev=360, start_deg=-90.0,
                speed_rpm=speed_rpm,
            )
        )  # fmt: skip
        np.testing.assert_allclose(angle["crank_angle"], [-0.25, -0.25 + 5000 / 360])
        np.testing.assert_allclose(angle["time"].values[1] - angle["time"].values[0], elapsed_s)


def test_a_recording_without_what_its_encoder_needs_is_refused_by_name(recording_of):
    for kind in ["none", "speed", "square", "analogue", "pulse_times", "edge_list", "constant"]:
        with pytest.raises(InputError) as error:
            decode(recording_of(None, encoder_kind=kind))
        assert error.value.file == "made"
        assert "run.toml" in error.value.remedy


def test_a_start_time_moves_the_knots_and_nothing_else(known_shaft, recording_of):
    pulse_s = known_shaft(900.0).pulse_time_s(60)
    plain, moved = (
        decode(recording_of(pulse_s, pulses_per_rev=60, pulse_noise_s=1e-6, start_s=start)) for start in (0.0, 1e6)
    )
    np.testing.assert_allclose(moved["time"] - 1e6, plain["time"], atol=2e-10)
    np.testing.assert_array_equal(moved["crank_angle"], plain["crank_angle"])
    np.testing.assert_array_equal(moved["standard_error"], plain["standard_error"])


def test_one_pulse_per_revolution_is_its_own_index(known_shaft, recording_of):
    pulse_s = known_shaft(900.0, irregularity={}).pulse_time_s(1)
    angle = decode(recording_of(pulse_s, pulses_per_rev=1, pulse_noise_s=1e-7))
    at_pulse = angle_at(pulse_s, angle["time"].values, angle["crank_angle"].values, angle["speed"].values)
    np.testing.assert_allclose(at_pulse, np.arange(pulse_s.size), atol=1e-6)
    assert angle.attrs["phase_reference"] == "pulse"
    assert angle.attrs["cycle_known"] == 1


def test_an_encoder_on_another_shaft_is_counted_in_crank_revolutions(known_shaft, recording_of):
    for ratio in [0.5, 2.0]:
        shaft = known_shaft(900.0)
        pulse_s = shaft.pulse_time_s(round(60 * ratio))
        angle = decode(recording_of(pulse_s, pulses_per_rev=60, ratio=ratio, pulse_noise_s=1e-7))
        reached = angle_at(pulse_s[[0, -1]], angle["time"].values, angle["crank_angle"].values, angle["speed"].values)
        np.testing.assert_allclose(np.diff(reached), np.diff(shaft.angle_rev(pulse_s[[0, -1]])), atol=1e-5)


def test_pulse_times_without_a_stated_noise_are_smoothed_by_what_they_show(known_shaft, recording_of):
    shaft = known_shaft(900.0, irregularity={}, duration_s=6.0)
    exact = shaft.pulse_time_s(60)
    jitter = 1e-5 * np.random.default_rng(6).standard_normal(exact.size)
    angle = decode(recording_of(exact + jitter, pulses_per_rev=60, pulse_noise_s=0.0))
    knots = angle["time"].values, angle["crank_angle"].values, angle["speed"].values
    error = angle_at(exact, *knots) - shaft.angle_rev(exact)
    assert np.std(error) < 0.5 * 1e-5 * 15.0
    assert np.median(angle["standard_error"]) == pytest.approx(np.std(error), rel=0.4)


def test_a_speed_signal_integrates_to_its_angle(recording_of):
    time_s = np.arange(200_000) / 20_000.0
    speed = 900.0 + 200.0 * time_s + 30.0 * np.sin(2 * np.pi * 3.0 * time_s)
    exact = (900.0 * time_s + 100.0 * time_s**2 + 30.0 / (6 * np.pi) * (1 - np.cos(6 * np.pi * time_s))) / 60.0
    quantised = np.round(speed * 8.0) / 8.0
    knots, flags = integrated_speed(quantised, rate_hz=20_000.0, settings=SETTINGS)
    error = angle_at(time_s, knots.time_s, knots.angle_rev, knots.speed_rpm) - exact
    assert np.nanmax(np.abs(error)) < 2e-4
    assert not flags
    np.testing.assert_allclose(knots.speed_rpm[5:-5], np.interp(knots.time_s[5:-5], time_s, speed), rtol=2e-3)


def test_gaps_in_a_speed_signal_are_bridged_and_flagged():
    speed = np.full(10_000, 1200.0)
    speed[3000:3010] = np.nan
    knots, flags = integrated_speed(speed, rate_hz=1000.0, settings=SETTINGS)
    assert knots.angle_rev[-1] == pytest.approx(9.999 * 20.0)
    assert flags[0][:2] == ("speed_gap", "suspect")
    for bad in (np.full(100, np.nan), np.zeros(1000)):
        with pytest.raises(InputError):
            integrated_speed(bad, rate_hz=1000.0, settings=SETTINGS)


def test_an_encoder_with_too_few_samples_per_tooth_is_bad_and_says_when():
    time_s = np.arange(30_000) / 6000.0
    revs = (10.0 * time_s + 5.0 * time_s**2) % 1.0  # 600 to 3600 rpm: 60 teeth a revolution reach 3600 teeth a second
    trace = (np.floor(revs * 120) % 2).astype(np.float32)
    pulses = find_pulses(trace, rate_hz=6000.0, kind="square", edge="rising", pulses_per_rev=60, settings=SETTINGS)
    attrs = {"encoder_kind": "square", "pulses_per_rev": 60, "pulse_noise_s": pulses.noise_s, "revs_per_cycle": 1}
    recording = sampled(np.zeros((1, 30_000)), rate_hz=6000.0, **attrs)
    recording["pulse_time"] = ("pulse", pulses.time_s, {"units": "s"})
    try:
        flags = flags_of(shaft_angle(recording, settings=SETTINGS))
    except InputError:
        return  # refused outright is as good
    assert "encoder_undersampled" in {flag["flag"] for flag in flags if flag["severity"] == "bad"}


# Crank angle from a speed signal: noise about standstill turns no shaft.


RATE_HZ = 2000.0


def _stopped(noise_rpm: float) -> tuple[np.ndarray, float]:
    """A speed that falls from 900 rpm to 0, stays for 2 s and rises again, and the revolutions it makes."""
    time = np.arange(0.0, 6.0, 1.0 / RATE_HZ)
    speed = np.interp(time, [0.0, 2.0, 4.0, 6.0], [900.0, 0.0, 0.0, 900.0])
    noise = noise_rpm * np.random.default_rng(5).standard_normal(len(time))
    return speed + noise, float(speed.sum() / RATE_HZ / 60.0)


def test_the_noise_of_a_shaft_that_stands_does_not_add_up() -> None:
    speed, revs = _stopped(5.0)
    knots, flags = integrated_speed(speed, rate_hz=RATE_HZ, settings=SETTINGS)
    # cut off at 0 it would have added 0.067 rev
    assert abs(knots.angle_rev[-1] - revs) < 0.02
    assert flags == [] and (np.diff(knots.angle_rev) > 0.0).all() and (np.diff(knots.time_s) > 0.0).all()


def test_a_shaft_that_turns_back_is_flagged_and_taken_to_stand() -> None:
    speed, revs = _stopped(0.5)
    speed[5000:6000] = -100.0
    knots, flags = integrated_speed(speed, rate_hz=RATE_HZ, settings=SETTINGS)
    assert [name for name, _, _ in flags] == ["speed_negative"]
    assert abs(knots.angle_rev[-1] - revs) < 0.05


# A mark on the camshaft tells which top dead centre fires, by the majority of the cycles.


CAM_REV = 0.8  # the mark comes so long after every other crank revolution is complete


def trains(known_shaft, *, start_rev=0.3217):
    """Pulses, index and cam marks of a shaft: the cam mark comes CAM_REV after every even revolution."""
    shaft = known_shaft(900.0, start_rev=start_rev, duration_s=4.0)
    pulse_s, index_s = shaft.pulse_time_s(60), shaft.pulse_time_s(1)
    time_s = shaft.time_s
    cam_s = np.interp(np.arange(CAM_REV, shaft.angle_rev()[-1], 2.0), shaft.angle_rev(), time_s)
    return shaft, pulse_s, index_s, cam_s[cam_s > 0.0]


def decoded(recording_of, pulse_s, cam_s, **attrs):
    made = recording_of(pulse_s, pulses_per_rev=60, revs_per_cycle=2, pulse_noise_s=1e-7, **attrs)
    made["cam_time"] = ("cycle", cam_s, {"units": "s"})
    return shaft_angle(made, settings=SETTINGS)


def angle_of(angle, time_s):
    return angle_at(time_s, angle["time"].values, angle["crank_angle"].values, angle["speed"].values)


def names(angle):
    return {flag["flag"] for flag in flags_of(angle)}


def test_the_cam_tells_the_firing_dead_centre_wherever_the_record_starts(known_shaft, recording_of):
    for start_rev in [0.0, 0.3217, 0.9, 1.4, 1.95]:
        shaft, pulse_s, index_s, cam_s = trains(known_shaft, start_rev=start_rev)
        to_tdc = 360.0 * (2.0 - CAM_REV) + 30.0
        angle = decoded(
            recording_of, pulse_s, cam_s, index_time_s=index_s, index_to_tdc_deg=30.0, cam_to_tdc_deg=to_tdc
        )
        assert angle.attrs["cycle_known"] == 1
        assert angle.attrs["phase_reference"] == "tdc"
        assert "cycle_phase_unknown" not in names(angle)
        away = (angle_of(angle, pulse_s) - (shaft.angle_rev(pulse_s) - 30.0 / 360.0)) / 2.0
        np.testing.assert_allclose(away, np.round(away), atol=1e-5)
        assert -2.0 < angle_of(angle, pulse_s[:1])[0] <= 1e-6


def test_a_cam_alone_gives_dead_centre_and_cycle(known_shaft, recording_of):
    shaft, pulse_s, _, cam_s = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, cam_s, cam_to_tdc_deg=360.0 * (2.0 - CAM_REV))
    assert (angle.attrs["cycle_known"], angle.attrs["phase_reference"]) == (1, "tdc")
    away = (angle_of(angle, pulse_s) - shaft.angle_rev(pulse_s)) / 2.0
    np.testing.assert_allclose(away, np.round(away), atol=1e-4)


def test_without_its_angle_the_cycle_starts_at_the_next_dead_centre_and_says_so(known_shaft, recording_of):
    shaft, pulse_s, index_s, cam_s = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, cam_s, index_time_s=index_s)
    assert angle.attrs["cycle_known"] == 1
    assert "cycle_from_cam" in names(angle)
    away = (angle_of(angle, pulse_s) - (shaft.angle_rev(pulse_s) - 1.0)) / 2.0
    np.testing.assert_allclose(away, np.round(away), atol=1e-5)


def test_cam_faults_are_counted_and_located_and_do_no_harm(known_shaft, recording_of):
    for fault in ["lost", "extra", "doubled"]:
        shaft, pulse_s, index_s, cam_s = trains(known_shaft)
        marks = {
            "lost": np.delete(cam_s, 5),
            "extra": np.sort(np.append(cam_s, cam_s[5] + 0.05)),
            "doubled": np.sort(np.append(cam_s, cam_s[5] + 1e-4)),
        }[fault]
        angle = decoded(recording_of, pulse_s, marks, index_time_s=index_s)
        (flag,) = [flag for flag in flags_of(angle) if flag["flag"] == ("cam_lost" if fault == "lost" else "cam_extra")]
        assert flag["detail"].startswith("1 cam marks")
        where = {"lost": cam_s[4], "extra": cam_s[5] + 0.05, "doubled": cam_s[5] + 1e-4}[fault]
        assert f"at {where:.6g} s" in flag["detail"]
        away = (angle_of(angle, pulse_s) - (shaft.angle_rev(pulse_s) - 1.0)) / 2.0
        np.testing.assert_allclose(away, np.round(away), atol=1e-5)


def test_a_mark_that_comes_every_revolution_tells_no_cycle(known_shaft, recording_of):
    _, pulse_s, index_s, _ = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, index_s + 0.01, index_time_s=index_s)
    assert angle.attrs["cycle_known"] == 0
    assert {"cam_unclear", "cycle_phase_unknown"} <= names(angle)


def test_a_cam_angle_that_misses_every_dead_centre_is_flagged(known_shaft, recording_of):
    _, pulse_s, index_s, cam_s = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, cam_s, index_time_s=index_s, cam_to_tdc_deg=360.0 * (2.0 - CAM_REV) + 90.0)
    (flag,) = [flag for flag in flags_of(angle) if flag["flag"] == "cam_off"]
    assert "+90 degrees" in flag["detail"]


def test_an_encoder_on_the_camshaft_knows_the_cycle_by_its_own_mark(known_shaft, recording_of):
    shaft, pulse_s, _, cam_s = trains(known_shaft)
    made = recording_of(
        pulse_s, index_time_s=cam_s, pulses_per_rev=120, ratio=0.5, revs_per_cycle=2, pulse_noise_s=1e-7
    )
    angle = shaft_angle(made, settings=SETTINGS)
    assert angle.attrs["cycle_known"] == 1
    away = (angle_of(angle, pulse_s) - shaft.angle_rev(pulse_s) + CAM_REV) / 2.0
    np.testing.assert_allclose(away, np.round(away), atol=1e-4)
