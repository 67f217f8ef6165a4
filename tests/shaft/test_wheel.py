"""Repair of the pulse train: what is lost is found, counted and put right, and what cannot be is refused."""

import re

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.quantities import check_dataset, flags_of
from crankorder.shaft.angle import angle_at, integrated_speed, knots_of
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.uneven_wheel import wheel_of
from crankorder.shaft.wheel import number_teeth
from made.recordings import sampled
from made.shipped import SHAFT

TORSION = {2.0: 0.03}


def decoded(recording_of, trace, index=None, *, rate_hz=50_000.0, **attrs):
    attrs.setdefault("pulses_per_rev", 360)
    options = {"rate_hz": rate_hz, "kind": "square", "edge": "rising", "settings": SHAFT}
    pulses = find_pulses(trace, pulses_per_rev=attrs["pulses_per_rev"], **options)
    marks = None if index is None else find_pulses(index, pulses_per_rev=1, **options).time_s
    recording = recording_of(pulses.time_s, index_time_s=marks, pulse_noise_s=pulses.noise_s, **attrs)
    return shaft_angle(recording, settings=SHAFT)


def order_error(estimated_rev, true_rev, order):
    """What an order reads, over what it is, when analysed by an estimated instead of the true angle."""
    known = np.isfinite(estimated_rev)
    return complex(np.mean(np.exp(2j * np.pi * order * (true_rev[known] - estimated_rev[known]))))


def angle_of(angle, time_s):
    return angle_at(time_s, **knots_of(angle))


def detail_of(angle, flag):
    details = [item["detail"] for item in flags_of(angle) if item["flag"] == flag]
    assert len(details) == 1, flags_of(angle)
    return details[0]


def test_a_clean_train_has_no_repairs_and_its_index_is_angle_zero(known_shaft, recording_of):
    shaft = known_shaft(1000.0, irregularity=TORSION)
    angle = decoded(recording_of, shaft.square(360), shaft.index(360), index_to_tdc_deg=0.0)
    assert {item["severity"] for item in flags_of(angle)} <= {"info"}
    assert angle.attrs["phase_reference"] == "tdc"
    error = order_error(angle_of(angle, shaft.time_s), shaft.angle_rev(), 10.0)
    assert abs(np.degrees(np.angle(error))) < 0.1
    assert abs(error) == pytest.approx(1.0, abs=1e-4)


def test_d1_the_lost_pulse_is_located(known_shaft, recording_of):
    pulse_s = known_shaft(1000.0).pulse_time_s(60)
    faulty = shaft_angle(recording_of(np.delete(pulse_s, 777), pulses_per_rev=60), settings=SHAFT)
    (when,) = re.findall(r"at ([0-9.]+) s", detail_of(faulty, "encoder_missing_pulse"))
    assert float(when) == pytest.approx(pulse_s[777], abs=1e-4)


def test_d2_a_damaged_line_is_named_by_its_angle_and_its_orders_are_right(known_shaft, recording_of):
    shaft = known_shaft(1000.0, irregularity=TORSION)
    trace = shaft.square(360, lost=lambda k: k % 360 == 90)
    angle = decoded(recording_of, trace, shaft.index(360))
    assert "90.00 degrees after the index" in detail_of(angle, "encoder_damaged_line")
    assert detail_of(angle, "encoder_missing_pulse").startswith("50 lost")
    estimated = angle_of(angle, shaft.time_s)
    whole = round(np.nanmean(estimated - shaft.angle_rev()))
    error = order_error(estimated - whole, shaft.angle_rev(), 5.5)
    assert abs(abs(error) - 1.0) < 1e-4
    assert abs(np.degrees(np.angle(error))) < 0.1


def test_d5_without_an_index_orders_are_right_and_the_phase_is_flagged(known_shaft, recording_of):
    shaft = known_shaft(1000.0)
    angle = decoded(recording_of, shaft.square(360))
    assert angle.attrs["phase_reference"] == "none"
    assert "no reference" in detail_of(angle, "no_index")
    estimated = angle_of(angle, shaft.time_s)
    assert abs(order_error(estimated, shaft.angle_rev(), 10.0)) == pytest.approx(1.0, abs=1e-4)


def test_d9_a_wrong_number_of_pulses_is_refused_with_both_numbers(known_shaft, recording_of):
    for configured, real in [(720, 360), (360, 720), (60, 64)]:
        shaft = known_shaft(700.0)
        with pytest.raises(InputError, match=f"{real} pulses per index measured, {configured} configured") as error:
            decoded(recording_of, shaft.square(real), shaft.index(real), pulses_per_rev=configured)
        assert error.value.file == "made"


def test_an_index_mark_lost_or_extra_is_flagged_and_does_no_harm(known_shaft, recording_of):
    shaft = known_shaft(900.0)
    pulse_s, index_s = shaft.pulse_time_s(60), shaft.pulse_time_s(1)
    for flag, marks, where in (
        ("index_lost", np.delete(index_s, 11), index_s[10]),
        *(("index_extra", np.sort(np.append(index_s, at + 1e-5)), at) for at in (pulse_s[1007], index_s[20])),
    ):
        angle = shaft_angle(
            recording_of(pulse_s, index_time_s=marks, pulses_per_rev=60, pulse_noise_s=1e-7), settings=SHAFT
        )
        assert detail_of(angle, flag).startswith("1 ")
        (when,) = re.findall(r"at ([0-9.]+) s", detail_of(angle, flag))
        assert float(when) == pytest.approx(where, abs=2e-5)
        difference = angle_of(angle, index_s[1:-1])
        np.testing.assert_allclose(difference, np.round(difference), atol=1e-6)


def wheel_with_gap(shaft, pulses_per_rev, missing):
    """Times of the pulses of a wheel that lacks its last teeth, and the number of each, counted on."""
    pulse_s = shaft.pulse_time_s(pulses_per_rev)
    tooth = np.round(shaft.angle_rev(pulse_s) * pulses_per_rev).astype(int)
    on_wheel = tooth % pulses_per_rev < pulses_per_rev - missing
    return pulse_s[on_wheel], tooth[on_wheel]


def test_too_many_repairs_are_refused(known_shaft):
    pulse_s = known_shaft(1000.0).pulse_time_s(60)
    few = pulse_s[np.random.default_rng(3).random(pulse_s.size) > 0.1]
    with pytest.raises(InputError, match="the count is not certain"):
        number_teeth(few, wheel_of(60), settings=SHAFT)


def test_times_that_cannot_be_pulses_are_refused():
    for times in [[0.0, 1.0], [0.0, 2.0, 1.0, 3.0], [0.0, 1.0, np.nan, 3.0], []]:
        with pytest.raises(InputError):
            number_teeth(np.array(times, dtype=np.float64), wheel_of(1), settings=SHAFT)


def test_a_burst_of_interference_is_removed_and_told_from_ringing(known_shaft):
    pulse_s = known_shaft(1000.0).pulse_time_s(60)
    burst = pulse_s[900] + np.array([0.1, 0.3, 0.32, 0.5, 0.7]) * (pulse_s[901] - pulse_s[900])
    teeth = number_teeth(np.sort(np.append(pulse_s, burst)), wheel_of(60), settings=SHAFT)
    np.testing.assert_array_equal(teeth.time_s, pulse_s)
    flags = {flag: detail for flag, _, detail in teeth.flags}
    assert flags["encoder_double_pulse"].startswith("5 false pulses")
    assert flags["encoder_glitch"].startswith("1 bursts") and f"{burst[0]:.6g}" in flags["encoder_glitch"]


def test_a_count_that_slips_for_good_is_put_right_at_the_index_and_located(known_shaft):
    shaft = known_shaft(900.0, irregularity={})
    pulse_s, index_s = shaft.pulse_time_s(60), shaft.pulse_time_s(1)
    # one pulse too few, and the others spread so that no interval looks wrong: only the index shows it
    spread = np.concatenate([pulse_s[:1500], np.linspace(pulse_s[1500], pulse_s[1512], 12), pulse_s[1513:]])
    teeth = number_teeth(spread, wheel_of(60), index_time_s=index_s, settings=SHAFT)
    detail = {flag: detail for flag, _, detail in teeth.flags}["encoder_slip"]
    assert detail.startswith("pulse count put right at 1 index marks")
    (when,) = re.findall(r"at ([0-9.]+) s", detail)
    assert float(when) == pytest.approx(index_s[index_s > pulse_s[1500]][0], abs=1e-5)
    true = np.round((shaft.angle_rev(teeth.time_s) - teeth.index_tooth / 60) * 60).astype(int)
    off = (true - (teeth.tooth - round(teeth.index_tooth))) % 60
    assert set(off[teeth.time_s < pulse_s[1500]]) == set(off[teeth.time_s > index_s[index_s > pulse_s[1512]][0]])
    assert (np.diff(teeth.tooth) > 0).all()


def test_an_index_without_a_place_gives_no_phase_and_says_so(known_shaft, recording_of):
    for missing in [0, 2]:
        for marks in ["none", "anywhere"]:
            shaft = known_shaft(900.0)
            pulse_s, _ = wheel_with_gap(shaft, 60, missing)
            index_s = np.sort(np.random.default_rng(4).uniform(0.0, 3.0, 40)) if marks == "anywhere" else np.empty(0)
            angle = shaft_angle(
                recording_of(
                    pulse_s, index_time_s=index_s, pulses_per_rev=60, missing_teeth=missing, pulse_noise_s=1e-7,
                    index_to_tdc_deg=10.0,
                ),
                settings=SHAFT,
            )  # fmt: skip
            assert angle.attrs["phase_reference"] == "none"
            assert "no reference" in detail_of(angle, "no_index")
            reached = angle_of(angle, pulse_s[[0, -1]])
            assert np.diff(reached) == pytest.approx(np.diff(shaft.angle_rev(pulse_s[[0, -1]])), abs=1e-4)


def _from_rest(rpm_per_s, rev, teeth, rate_hz):
    """Times at which ``teeth`` per revolution pass over ``rev`` revolutions of even acceleration, as sampled."""
    angle = np.arange(0.3 / teeth, rev, 1.0 / teeth)
    return np.ceil(np.sqrt(2.0 * angle * 60.0 / rpm_per_s) * rate_hz) / rate_hz


def test_a_wheel_that_starts_from_rest_is_counted_to_its_first_tooth():
    for rpm_per_s in [150.0, 440.0, 900.0]:
        time_s = _from_rest(rpm_per_s, 20.0, 60, 8192.0)
        found = number_teeth(time_s, wheel_of(60), settings=SHAFT)
        assert found.n_repaired == 0 and (np.diff(found.tooth) == 1).all()


def test_a_jittering_encoder_is_counted_to_its_last_pulse():
    rng = np.random.default_rng(20)
    number = np.arange(200_000)
    time_s = np.sort((number + 0.17 * rng.standard_normal(number.size)) / 18_000.0)
    teeth = number_teeth(time_s, wheel_of(720), settings=SHAFT)
    assert teeth.n_repaired == 0
    assert teeth.tooth[-1] - teeth.tooth[0] == number[-1]


# A pulse lost anywhere on a wheel with a gap, its first and last turn included, leaves every number right.


@pytest.mark.parametrize(
    ("teeth", "missing", "irregularity", "start_rev"), [(60, 2, {}, 0.3217), (36, 1, {0.5: 0.02, 2.0: 0.03}, 0.93)]
)
def test_a_pulse_lost_in_the_first_or_last_turn_leaves_every_number_right_and_is_flagged(
    known_shaft, teeth, missing, irregularity, start_rev
):
    shaft = known_shaft(1500.0, start_rev=start_rev, irregularity=irregularity, duration_s=0.13)
    pulse_s, true = wheel_with_gap(shaft, teeth, missing)
    turn, last = teeth - missing, pulse_s.size - 1
    for lost in sorted({*range(1, turn, 2), *range(turn, last - turn, 7), *range(last - turn, last, 2), 2, last - 1}):
        left_s = np.delete(pulse_s, lost)
        found = number_teeth(left_s, wheel_of(teeth, missing), settings=SHAFT)
        kept = np.searchsorted(left_s, found.time_s)
        assert set((found.tooth - np.delete(true, lost)[kept]) % teeth) == {0}, lost
        assert {"encoder_missing_pulse", "encoder_double_pulse"} & {flag for flag, _, _ in found.flags}, lost
        assert 1 <= found.n_repaired <= 3


@pytest.mark.parametrize(("teeth", "missing", "share"), [(60, 0, 0.55), (60, 2, 0.1), (24, 2, 0.95)])
def test_a_false_pulse_anywhere_and_in_a_gap_is_removed_and_leaves_every_number_right(
    known_shaft, teeth, missing, share
):
    shaft = known_shaft(1500.0, duration_s=0.17)
    pulse_s, true = wheel_with_gap(shaft, teeth, missing)
    for before in range(2, pulse_s.size - 3, 5):
        false_s = pulse_s[before] + share * (pulse_s[before + 1] - pulse_s[before])
        train_s = np.sort(np.append(pulse_s, false_s))
        found = number_teeth(train_s, wheel_of(teeth, missing), settings=SHAFT)
        np.testing.assert_array_equal(found.time_s, pulse_s, err_msg=f"after pulse {before}")
        assert len(set((found.tooth - true) % teeth)) == 1, before
        assert missing == 0 or set((found.tooth - true) % teeth) == {0}, before
        assert [detail for flag, _, detail in found.flags if flag == "encoder_double_pulse"] == [
            f"1 false pulses removed, at {false_s:.6g} s"
        ]


# ShaftAngle of every kind of recording: dims, units, references and refusals.


def decode(recording):
    angle = shaft_angle(recording, settings=SHAFT)
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
    np.testing.assert_allclose(angle_of(angle, pulse_s), np.arange(pulse_s.size), atol=1e-6)
    assert angle.attrs["phase_reference"] == "pulse"
    assert angle.attrs["cycle_known"] == 1


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
    knots, flags = integrated_speed(quantised, rate_hz=20_000.0, settings=SHAFT)
    error = angle_at(time_s, knots.time_s, knots.angle_rev, knots.speed_rpm) - exact
    assert np.nanmax(np.abs(error)) < 2e-4
    assert not flags
    np.testing.assert_allclose(knots.speed_rpm[5:-5], np.interp(knots.time_s[5:-5], time_s, speed), rtol=2e-3)


def test_gaps_in_a_speed_signal_are_bridged_and_flagged():
    speed = np.full(10_000, 1200.0)
    speed[3000:3010] = np.nan
    knots, flags = integrated_speed(speed, rate_hz=1000.0, settings=SHAFT)
    assert knots.angle_rev[-1] == pytest.approx(9.999 * 20.0)
    assert flags[0][:2] == ("speed_gap", "suspect")
    for bad in (np.full(100, np.nan), np.zeros(1000)):
        with pytest.raises(InputError):
            integrated_speed(bad, rate_hz=1000.0, settings=SHAFT)


def test_an_encoder_with_too_few_samples_per_tooth_is_bad_and_says_when():
    time_s = np.arange(30_000) / 6000.0
    revs = (10.0 * time_s + 5.0 * time_s**2) % 1.0  # 600 to 3600 rpm: 60 teeth a revolution reach 3600 teeth a second
    trace = (np.floor(revs * 120) % 2).astype(np.float32)
    pulses = find_pulses(trace, rate_hz=6000.0, kind="square", edge="rising", pulses_per_rev=60, settings=SHAFT)
    attrs = {"encoder_kind": "square", "pulses_per_rev": 60, "pulse_noise_s": pulses.noise_s, "revs_per_cycle": 1}
    recording = sampled(np.zeros((1, 30_000)), rate_hz=6000.0, **attrs)
    recording["pulse_time"] = ("pulse", pulses.time_s, {"units": "s"})
    flags = flags_of(shaft_angle(recording, settings=SHAFT))
    assert [flag["flag"] for flag in flags if flag["severity"] == "bad"] == ["encoder_undersampled"]


# Crank angle from a speed signal: noise about standstill turns no shaft.


RATE_HZ = 2000.0


def _stopped(noise_rpm):
    """A speed that falls from 900 rpm to 0, stays for 2 s and rises again, and the revolutions it makes."""
    time = np.arange(0.0, 6.0, 1.0 / RATE_HZ)
    speed = np.interp(time, [0.0, 2.0, 4.0, 6.0], [900.0, 0.0, 0.0, 900.0])
    noise = noise_rpm * np.random.default_rng(5).standard_normal(len(time))
    return speed + noise, float(speed.sum() / RATE_HZ / 60.0)


def test_the_noise_of_a_shaft_that_stands_does_not_add_up():
    speed, revs = _stopped(5.0)
    knots, flags = integrated_speed(speed, rate_hz=RATE_HZ, settings=SHAFT)
    # cut off at 0 it would have added 0.067 rev
    assert abs(knots.angle_rev[-1] - revs) < 0.02
    assert flags == [] and (np.diff(knots.angle_rev) > 0.0).all() and (np.diff(knots.time_s) > 0.0).all()


def test_a_shaft_that_turns_back_is_flagged_and_taken_to_stand():
    speed, revs = _stopped(0.5)
    speed[5000:6000] = -100.0
    knots, flags = integrated_speed(speed, rate_hz=RATE_HZ, settings=SHAFT)
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


def assert_cycles(angle, shaft, pulse_s, late_rev, atol=1e-5):
    """The decoded angle is the true one less ``late_rev``, up to whole cycles."""
    away = (angle_of(angle, pulse_s) - shaft.angle_rev(pulse_s) + late_rev) / 2.0
    np.testing.assert_allclose(away, np.round(away), atol=atol)


def decoded_with_cam(recording_of, pulse_s, cam_s, **attrs):
    made = recording_of(pulse_s, pulses_per_rev=60, revs_per_cycle=2, pulse_noise_s=1e-7, **attrs)
    made["cam_time"] = ("cycle", cam_s, {"units": "s"})
    return shaft_angle(made, settings=SHAFT)


def names(angle):
    return {flag["flag"] for flag in flags_of(angle)}


def test_the_cam_tells_the_firing_dead_centre_wherever_the_record_starts(known_shaft, recording_of):
    for start_rev in [0.0, 0.9, 1.95]:
        shaft, pulse_s, index_s, cam_s = trains(known_shaft, start_rev=start_rev)
        to_tdc = 360.0 * (2.0 - CAM_REV) + 30.0
        angle = decoded_with_cam(
            recording_of, pulse_s, cam_s, index_time_s=index_s, index_to_tdc_deg=30.0, cam_to_tdc_deg=to_tdc
        )
        assert angle.attrs["cycle_known"] == 1
        assert angle.attrs["phase_reference"] == "tdc"
        assert "cycle_phase_unknown" not in names(angle)
        assert_cycles(angle, shaft, pulse_s, 30.0 / 360.0)
        assert -2.0 < angle_of(angle, pulse_s[:1])[0] <= 1e-6


def test_a_cam_alone_gives_dead_centre_and_cycle(known_shaft, recording_of):
    shaft, pulse_s, _, cam_s = trains(known_shaft)
    angle = decoded_with_cam(recording_of, pulse_s, cam_s, cam_to_tdc_deg=360.0 * (2.0 - CAM_REV))
    assert (angle.attrs["cycle_known"], angle.attrs["phase_reference"]) == (1, "tdc")
    assert_cycles(angle, shaft, pulse_s, 0.0, atol=1e-4)


def test_cam_faults_are_counted_and_located_and_do_no_harm(known_shaft, recording_of):
    shaft, pulse_s, index_s, cam_s = trains(known_shaft)
    for flag, marks, where in (
        ("cam_lost", np.delete(cam_s, 5), cam_s[4]),
        *(("cam_extra", np.sort(np.append(cam_s, cam_s[5] + late)), cam_s[5] + late) for late in (0.05, 1e-4)),
    ):
        angle = decoded_with_cam(recording_of, pulse_s, marks, index_time_s=index_s)
        assert angle.attrs["cycle_known"] == 1
        assert "cycle_from_cam" in names(angle)  # without its angle the cycle starts at the next dead centre
        detail = detail_of(angle, flag)
        assert detail.startswith("1 cam marks") and f"at {where:.6g} s" in detail
        assert_cycles(angle, shaft, pulse_s, 1.0)


def test_a_mark_that_comes_every_revolution_tells_no_cycle(known_shaft, recording_of):
    _, pulse_s, index_s, _ = trains(known_shaft)
    angle = decoded_with_cam(recording_of, pulse_s, index_s + 0.01, index_time_s=index_s)
    assert angle.attrs["cycle_known"] == 0
    assert {"cam_unclear", "cycle_phase_unknown"} <= names(angle)


def test_a_cam_angle_that_misses_every_dead_centre_is_flagged(known_shaft, recording_of):
    _, pulse_s, index_s, cam_s = trains(known_shaft)
    angle = decoded_with_cam(
        recording_of, pulse_s, cam_s, index_time_s=index_s, cam_to_tdc_deg=360.0 * (2.0 - CAM_REV) + 90.0
    )
    assert "+90 degrees" in detail_of(angle, "cam_off")


def test_an_encoder_on_the_camshaft_knows_the_cycle_by_its_own_mark(known_shaft, recording_of):
    shaft, pulse_s, _, cam_s = trains(known_shaft)
    made = recording_of(
        pulse_s, index_time_s=cam_s, pulses_per_rev=120, ratio=0.5, revs_per_cycle=2, pulse_noise_s=1e-7
    )
    angle = shaft_angle(made, settings=SHAFT)
    assert angle.attrs["cycle_known"] == 1
    assert_cycles(angle, shaft, pulse_s, CAM_REV, atol=1e-4)
