"""Every wheel decodes from its pulses, wherever they start, and is found by itself; clean trains are never repaired."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crankorder.errors import InputError, RequestError
from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, knots_of
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pattern import known_names, pattern_of
from crankorder.shaft.repair import running_parts
from crankorder.shaft.speeds import speed_swing
from crankorder.shaft.tooth_errors import same_wheel, stated_teeth, tooth_errors
from crankorder.shaft.uneven_wheel import find_pattern, wheel_of
from crankorder.shaft.wheel import number_teeth
from crankorder.synth.lines import lag_by_order
from crankorder.synth.motion import Motion
from crankorder.synth.parts import SpeedOrder
from made.shipped import SHAFT

WHEELS = [*known_names(), "60-2", "36-1", "36-2", "24-2", "12-3", "4-1"]
UNIQUE = [name for name in WHEELS if pattern_of(name).repeats == 1]
REPAIRS = {"encoder_missing_pulse", "encoder_double_pulse", "encoder_glitch", "encoder_damaged_line", "encoder_slip"}


def angle_function(*, start_rpm=900.0, end_rpm=900.0, irregularity=0.05, duration_s=4.0):
    """Crank angle [rev] against time on a fine grid: a linear run-up with irregularity of orders 0.5 and 2."""
    time_s = np.linspace(0.0, duration_s, 400_001)
    mean = (start_rpm * time_s + 0.5 * (end_rpm - start_rpm) * time_s**2 / duration_s) / 60.0
    swing = sum(
        share * irregularity / (2 * np.pi * order) * np.sin(2 * np.pi * order * mean + order)
        for order, share in ((0.5, 0.4), (2.0, 0.6))
    )
    return time_s, mean + swing


def pulses_of(name, *, start_rev=0.37, **motion):
    """Times of the pulses of a wheel that starts ``start_rev`` past tooth 1, and the true angle of each."""
    time_s, angle = angle_function(**motion)
    angle = angle + start_rev
    return passed(pattern_of(name).angles_deg if isinstance(name, str) else name, time_s, angle)


def passed(angles_deg, time_s, angle):
    """Times at which teeth at ``angles_deg`` pass a shaft at ``angle`` [rev], and the true angle of each."""
    wanted = (np.arange(int(angle[-1]) + 2)[:, None] + np.array(angles_deg) / 360.0).ravel()
    wanted = wanted[(wanted > angle[0]) & (wanted < angle[-1])]
    return np.interp(wanted, angle, time_s), wanted


def numbered(name, pulse_s, **options):
    angles = pattern_of(name).angles_deg if isinstance(name, str) else name
    return number_teeth(pulse_s, wheel_of(1, tooth_angles_deg=angles), settings=SHAFT, **options)


def assert_true_angles(teeth, true_time_s, true_rev, repeats=1, atol=1e-9):
    """Each kept pulse has the tooth of its true angle, up to whole turns (or the part that the wheel repeats in)."""
    mark = teeth.index_tooth if np.isfinite(teeth.index_tooth) else 0.0
    angle = (teeth.tooth - mark) / teeth.teeth_per_rev
    away = (angle - np.interp(teeth.time_s, true_time_s, true_rev)) * repeats
    np.testing.assert_allclose(away, np.round(away[0]), atol=atol)


def test_lost_and_false_pulses_of_every_wheel_are_repaired_and_counted():
    for name in UNIQUE:
        pulse_s, true_rev = pulses_of(name, irregularity=0.03)
        random = np.random.default_rng(7)
        lost = random.choice(np.arange(40, pulse_s.size - 40, 17), size=3, replace=False)
        at = lost[0] - 20
        false = pulse_s[at] + 0.4 * (pulse_s[at + 1] - pulse_s[at])
        teeth = numbered(name, np.sort(np.append(np.delete(pulse_s, lost), false)))
        flags = {flag: detail for flag, _, detail in teeth.flags}
        assert flags["encoder_missing_pulse"].startswith("3 lost pulses")
        assert flags["encoder_double_pulse"] == f"1 false pulses removed, at {false:.6g} s"
        assert teeth.n_repaired == 4
        assert_true_angles(teeth, pulse_s, true_rev)


def test_angles_off_every_grid_are_kept_exactly():
    angles = (0.0, 31.07, 60.003, 88.9, 121.31, 149.5, 181.77, 240.29, 270.011, 301.3, 329.87)
    pulse_s, true_rev = pulses_of(angles, irregularity=0.002)
    teeth = numbered(angles, pulse_s)
    assert teeth.n_repaired == 0 and true_rev.size == teeth.tooth.size
    assert_true_angles(teeth, pulse_s, true_rev, atol=3e-6)


def test_a_wheel_that_repeats_takes_its_phase_from_the_index(recording_of):
    pulse_s, true_rev = pulses_of("miata-nb")
    index_s = np.interp(np.arange(1.0, true_rev[-1]), true_rev, pulse_s)
    angles = list(pattern_of("miata-nb").angles_deg)
    alone = shaft_angle(recording_of(pulse_s, tooth_angles_deg=angles), settings=SHAFT)
    assert alone.attrs["phase_reference"] == "none"
    both = shaft_angle(recording_of(pulse_s, tooth_angles_deg=angles, index_time_s=index_s), settings=SHAFT)
    assert both.attrs["phase_reference"] == "index"
    reached = angle_at(index_s[1:-1], **knots_of(both))
    np.testing.assert_allclose(reached, np.round(reached), atol=2e-3)


def test_another_wheel_is_refused_and_named():
    for configured, real in [("60-2", "36-2"), ("36-2-1", "36-2-2-2"), ("60-2", "58")]:
        pulse_s, _ = pulses_of(real)
        with pytest.raises(InputError) as error:
            numbered(configured, pulse_s)
        assert f"a {configured} wheel" in error.value.allowed
        assert real == "58" or f"a wheel {real} " in str(error.value.found)


@pytest.mark.parametrize("name", WHEELS)
def test_every_wheel_is_found_by_itself(name):
    pulse_s, _ = pulses_of(name, start_rpm=300.0, end_rpm=3600.0)
    found = find_pattern(pulse_s)
    once = {"44-2-2": "22-2", "66-2-2-2": "22-2"}  # as they look where nothing tells a revolution
    assert found.pattern.name == once.get(name, name)
    assert found.agreement == 1.0


def test_a_wheel_with_faults_is_found_with_less_confidence():
    pulse_s, _ = pulses_of("60-2", irregularity=0.02)
    found = find_pattern(np.delete(pulse_s, np.arange(100, pulse_s.size, 400)))
    assert found.pattern.name == "60-2"
    assert 0.6 < found.agreement < 0.95


def test_an_index_tells_how_often_a_wheel_repeats():
    pulse_s, true_rev = pulses_of("44-2-2")
    index_s = np.interp(np.arange(1.0, true_rev[-1]), true_rev, pulse_s)
    found = find_pattern(pulse_s, index_time_s=index_s)
    np.testing.assert_allclose(found.pattern.angles_deg, pattern_of("44-2-2").angles_deg)


def test_even_teeth_are_counted_by_the_index_and_not_told_without(recording_of):
    for teeth in [1, 60, 360]:
        pulse_s, true_rev = pulses_of(f"{teeth}")
        assert find_pattern(pulse_s) is None
        index_s = np.interp(np.arange(1.0, true_rev[-1]) + 0.3 / teeth, true_rev, pulse_s)
        found = find_pattern(pulse_s, index_time_s=index_s)
        assert found.pattern.even == (teeth, 0)
        unstated = recording_of(pulse_s)
        del unstated.attrs["pulses_per_rev"], unstated.attrs["missing_teeth"]
        with pytest.raises(InputError, match="nothing states the pulses per revolution"):
            shaft_angle(unstated, settings=SHAFT)


def test_a_recording_that_states_no_wheel_is_decoded_by_the_one_found_and_says_so(recording_of):
    pulse_s, true_rev = pulses_of("36-2-1")
    unstated = recording_of(pulse_s, pulse_noise_s=1e-8)
    del unstated.attrs["pulses_per_rev"], unstated.attrs["missing_teeth"]
    angle = shaft_angle(unstated, settings=SHAFT)
    (flag,) = [flag for flag in flags_of(angle) if flag["flag"] == "encoder_pattern_found"]
    assert flag["severity"] == "suspect"
    assert "36-2-1 (33 pulses), seen in 100% of" in flag["detail"]
    reached = angle_at(pulse_s, **knots_of(angle))
    np.testing.assert_allclose((reached - true_rev)[8:-8], np.round((reached - true_rev)[8]), atol=1e-3)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    name=st.sampled_from([*WHEELS, "60", "12", "1"]), start_rev=st.floats(0.0, 1.0), start_rpm=st.floats(150.0, 6000.0),
    ratio=st.floats(0.3, 3.0), irregularity=st.floats(0.0, 0.08), jitter=st.floats(0.0, 0.02),
    seed=st.integers(0, 2**31),
)  # fmt: skip
def test_every_wheel_is_laid_on_its_pulses_without_a_repair(
    name, start_rev, start_rpm, ratio, irregularity, jitter, seed
):
    """Jitter is a share of the shortest tooth; the speed changes threefold at most, over 60 revolutions or more."""
    duration_s = 60.0 / (start_rpm * (1.0 + ratio) / 120.0)
    pulse_s, true_rev = pulses_of(
        name, start_rev=start_rev, start_rpm=start_rpm, end_rpm=start_rpm * ratio, irregularity=irregularity,
        duration_s=duration_s,
    )  # fmt: skip
    noise = np.random.default_rng(seed).uniform(-1.0, 1.0, pulse_s.size)
    jittered = pulse_s + jitter * np.diff(pulse_s).min() * noise
    teeth = numbered(name, jittered)
    assert teeth.n_repaired == 0
    assert not REPAIRS & {flag for flag, _, _ in teeth.flags}
    assert teeth.time_s.size >= 0.85 * pulse_s.size  # teeth that only tell the phase are left out
    assert_true_angles(teeth, jittered, true_rev, pattern_of(name).repeats, atol=1e-7)
    assert np.isfinite(teeth.index_tooth) == (name in [*UNIQUE, "1"])


def test_a_start_from_standstill_and_a_stop_are_left_out_and_located():
    pulse_s, _ = pulses_of("60-2", start_rpm=60.0, end_rpm=1200.0)
    stopped = np.concatenate([pulse_s - pulse_s[0] + 5.0, [12.0, 12.06, 12.1]])
    train = np.concatenate([[0.0, 0.01], stopped])
    (part, *_), flags = running_parts(train, pulses_per_rev=58.0, gap=3.0)
    assert (part.start, part.stop) == (2, 2 + pulse_s.size)
    told = {flag: detail for flag, _, detail in flags}
    assert "from 0.01 to 5 s" in told["standstill"]
    assert "to 12 s" in told["standstill"]
    assert told["direction_unknown"].startswith("5 pulses of less than a revolution beside a standstill")


def test_a_kick_back_after_a_stop_takes_no_part(recording_of):
    """The crank stops against compression and turns back by a third of a revolution: one track sees only pulses."""
    time_s = np.linspace(0.0, 3.5, 700_001)
    speed = np.where(time_s < 3.0, 10.0 * (1.0 - time_s / 3.0), -2.6 * np.sin((time_s - 3.0) / 0.5 * np.pi))
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))))
    crossed = np.flatnonzero(np.diff(np.floor(angle * 60)) != 0)
    pulse_s = time_s[crossed]
    shaft = shaft_angle(recording_of(pulse_s, pulses_per_rev=60, pulse_noise_s=1e-6), settings=SHAFT)
    flags = {flag["flag"]: flag["detail"] for flag in flags_of(shaft)}
    assert "direction_unknown" in flags
    assert flags["standstill"].count("from") == 1
    assert shaft["time"].values[-1] < 3.0
    ends = np.interp(shaft["time"].values[[1, -2]], time_s, angle)
    assert np.diff(shaft["crank_angle"].values[[1, -2]]) == pytest.approx(np.diff(ends), abs=0.02)


def test_pulses_lost_for_long_at_steady_speed_are_filled_in_and_no_standstill():
    pulse_s, true_rev = pulses_of("360", irregularity=0.0)
    few = np.delete(pulse_s, np.arange(5000, 5200))
    teeth = number_teeth(few, wheel_of(360), settings=SHAFT)
    assert "standstill" not in {flag for flag, _, _ in teeth.flags}
    assert teeth.n_repaired == 200
    true = np.round(360 * np.interp(teeth.time_s, pulse_s, true_rev)).astype(int)
    np.testing.assert_array_equal(teeth.tooth - teeth.tooth[0], true - true[0])


def test_a_hole_at_changing_speed_splits_the_train_and_says_so():
    pulse_s, _ = pulses_of("60", start_rpm=600.0, end_rpm=3000.0)
    hole = pulse_s[(pulse_s < 1.0) | (pulse_s > 1.6)]
    teeth = number_teeth(hole, wheel_of(60), settings=SHAFT)
    told = {flag: detail for flag, _, detail in teeth.flags}
    assert "no pulses from 0.9" in told["encoder_gap"]
    assert "encoder_part_unused" in told
    assert teeth.time_s[0] > 1.6


def test_an_unknown_wheel_is_refused():
    for name in ["36-2-l", "3-3", "gm", "", "60-2-", "-2", "$60-2"]:
        with pytest.raises(RequestError, match="unknown wheel"):
            pattern_of(name)


def cranking(name, seed, *, revs=4.3):
    """Pulses of a wheel turned by a starter against compression from rest, and their true angles."""
    random = np.random.default_rng(seed)
    rpm, ripple, order = random.uniform(150.0, 250.0), random.uniform(0.2, 0.3), random.choice([0.5, 1.0, 1.5, 2.0])
    start_rev, phase = random.uniform(0.0, 1.0), random.uniform(0.0, 2.0 * np.pi)
    angle = start_rev + np.linspace(0.0, revs, 40_001)
    speed = rpm / 60.0 * (1.0 + ripple * np.cos(2.0 * np.pi * order * angle + phase))
    speed *= np.sqrt(np.clip((angle - start_rev + 0.004) / 0.3, 0.0, 1.0)) if seed % 2 else 1.0
    time_s = np.concatenate(([0.0], np.cumsum(np.diff(angle) / (0.5 * (speed[1:] + speed[:-1])))))
    return passed(pattern_of(name).angles_deg, time_s, angle)


@pytest.mark.parametrize("name", ["12+1", "60-2", "36-2-2-2"])
def test_a_stated_wheel_is_read_in_a_few_turns_of_cranking(name):
    for seed in range(8):
        pulse_s, true_rev = cranking(name, seed, revs=2.3 + 0.4 * (seed % 3))
        teeth = numbered(name, pulse_s)
        assert teeth.n_repaired <= seed % 2  # the first interval out of rest may be any number of teeth
        angle = (teeth.tooth - teeth.index_tooth) / teeth.teeth_per_rev
        away = (angle - np.interp(teeth.time_s, pulse_s, true_rev))[2 * (seed % 2) :]
        np.testing.assert_allclose(away, np.round(away[0]), atol=0.2 / teeth.teeth_per_rev)


@pytest.mark.parametrize(("real", "stated"), [("60-2", "60-3"), ("36-2", "36-1"), ("36-2-1", "36-2-2")])
def test_a_wheel_that_each_turn_contradicts_at_a_gap_is_refused(real, stated):
    for seed in range(0, 8, 2):
        with pytest.raises(InputError):
            numbered(stated, cranking(real, seed)[0])


# Teeth that sit wrongly are the wheel's: taken out of the angle, while the shaft's own swing stays.


MANY = ((0.5, 0.02), (1, 0.03), (2, 0.04), (4, 0.01))


def pulse_times(wheel, errors, *, swing=(), rpm=1000.0, turns=60.0, seed=0):
    """Times [s] of pulses of teeth that are off by ``errors`` [pitch]; ``swing``: (order, share of the speed)."""
    lines, missing = wheel
    time_s = np.linspace(0.0, turns * 60.0 / rpm, 400_001)
    mean = time_s * rpm / 60.0 + 0.31
    angle = mean + sum(share / (2 * np.pi * k) * np.sin(2 * np.pi * k * mean + seed + k) for k, share in swing)
    number = np.arange(np.ceil(angle[0] * lines) + 2, np.floor(angle[-1] * lines) - 2)
    line = np.mod(number, lines).astype(int)
    return np.interp((number + errors[line]) / lines, angle, time_s)[line < lines - missing]


def drawn(wheel, share, seed):
    return share * np.random.default_rng([seed, wheel[0]]).standard_normal(wheel[0])


def found_in(times, wheel, *, revs_per_cycle=1):
    teeth = number_teeth(times, wheel_of(*wheel), settings=SHAFT)
    return tooth_errors(teeth, ratio=1.0, revs_per_cycle=revs_per_cycle, noise_s=0.0, settings=SHAFT)


def decoded(recording_of, times, wheel, by=SHAFT):
    given = {"pulses_per_rev": wheel[0], "missing_teeth": wheel[1], "revs_per_cycle": 1}
    return shaft_angle(recording_of(times, **given), settings=by)


@pytest.mark.parametrize(("wheel", "share"), [((60, 0), 0.05), ((24, 1), 0.12), ((360, 0), 0.12)])
def test_teeth_that_sit_wrongly_make_no_swing(recording_of, wheel, share):
    shaft = decoded(recording_of, pulse_times(wheel, drawn(wheel, share, 3)), wheel)
    flags = {flag["flag"] for flag in flags_of(shaft)}
    assert "encoder_tooth_errors" in flags
    swing = speed_swing(shaft)
    assert not swing.told.any()
    assert np.sqrt(np.sum(swing.steady_rpm[swing.orders > 6.0] ** 2)) < 0.003 * swing.speed_rpm


@pytest.mark.parametrize(("wheel", "swing"), [((60, 2), MANY), ((24, 1), ((2, 0.1),)), ((360, 0), MANY)])
def test_the_swing_of_a_shaft_is_no_error_of_its_wheel(wheel, swing):
    times = pulse_times(wheel, np.zeros(wheel[0]), swing=swing)
    assert found_in(times, wheel, revs_per_cycle=2) is None


def test_a_swing_stands_out_of_wrong_teeth_with_what_they_may_make_of_it(recording_of):
    wheel, seed = (60, 0), 0
    times = pulse_times(wheel, drawn(wheel, 0.08, seed), swing=((2, 0.1),), seed=seed)
    shaft = decoded(recording_of, times, wheel)
    swing = speed_swing(shaft)
    at = int(np.flatnonzero(swing.orders == 2.0)[0])
    assert swing.told[at]
    assert abs(swing.steady_rpm[at] / swing.speed_rpm - 0.1) < swing.doubt_rpm[at] / swing.speed_rpm < 0.05


def test_few_revolutions_that_swing_more_than_a_shaft_can_are_doubted(recording_of):
    wheel = (60, 2)
    shaft = decoded(recording_of, pulse_times(wheel, drawn(wheel, 0.12, 3), turns=5.0), wheel)
    details = [flag["detail"] for flag in flags_of(shaft) if flag["flag"] == "encoder_tooth_errors_likely"]
    assert len(details) == 1 and "more than a shaft can" in details[0]


def test_a_wheel_is_known_again_and_another_is_not():
    wheel, stated = (60, 2), []
    for seed, rpm in ((1, 800.0), (1, 1900.0), (2, 1900.0)):
        errors = found_in(pulse_times(wheel, drawn(wheel, 0.1, seed), rpm=rpm), wheel)
        stated.append(stated_teeth(errors, ratio=1.0, tdc_rev=0.0))
    assert same_wheel(stated[:2])
    assert not same_wheel(stated)


@pytest.mark.parametrize("wheel", [(60, 0), (360, 0)])
def test_small_errors_of_teeth_are_learned_where_the_encoder_is_in_doubt(recording_of, wheel):
    times = pulse_times(wheel, drawn(wheel, 0.004, 5))
    doubting = load_settings("calibrated-encoder").shaft
    error = {}
    for name, by in (("default", SHAFT), ("doubting", doubting)):
        shaft = decoded(recording_of, times, wheel, by)
        error[name] = np.std(shaft["crank_angle"].values - shaft["time"].values * 1000.0 / 60.0)
    assert error["doubting"] < 0.6 * error["default"]


# Swing of the speed within the cycle, against the motion that was put in and a real engine.


def swinging(lines, *, rpm=1500.0, per_rev=30, seconds=3.0, slope=0.0, noise_rpm=0.0):
    """ShaftAngle with a speed of ``rpm`` + ``slope`` t and ``lines`` (order: peak in rpm) by the angle."""
    rng = np.random.default_rng(4)
    shares = [(order, 100.0 * size / rpm, rng.uniform(0.0, 360.0)) for order, size in lines.items()]
    parts = tuple(SpeedOrder(order=order, percent=share, phase_deg=at) for order, share, at in shares)
    motion = Motion(
        start_rev=0.0,
        corners=((0.0, rpm), (seconds, rpm + slope * seconds)),
        lag=lag_by_order(parts) if parts else None,
    )
    time = np.linspace(0.0, seconds, int(seconds * rpm / 60 * per_rev))
    angle, speed, _ = motion.at(time)
    noise = noise_rpm * rng.standard_normal(time.size)
    columns = {"time": ("knot", time), "crank_angle": ("knot", angle), "speed": ("knot", speed + noise)}
    return xr.Dataset(columns, attrs={"n_pulses": 1000, "revs_per_cycle": 2})


@pytest.mark.parametrize("rpm", [700.0, 3600.0])
def test_orders_and_amplitudes_are_those_that_were_put_in(rpm):
    lines = {0.5: 0.003 * rpm, 1.0: 0.02 * rpm, 2.0: 0.01 * rpm, 3.5: 0.005 * rpm}
    swing = speed_swing(swinging(lines, rpm=rpm, seconds=60.0 / rpm * 40))
    assert swing is not None and swing.speed_rpm == pytest.approx(rpm, rel=5e-3)
    for order, size in lines.items():
        at = swing.orders.tolist().index(order)
        assert swing.told[at]
        # a speed of ripple r by time has second harmonics of r squared by angle, and the mean over the angle
        assert swing.amplitude_rpm[at] == pytest.approx(size, rel=0.02, abs=2e-4 * rpm)


def test_a_run_up_and_noise_of_the_edges_are_no_swing():
    for shaft in (swinging({}, slope=200.0), swinging({}, noise_rpm=15.0, seconds=6.0)):
        swing = speed_swing(shaft)
        assert swing is not None and not swing.told.any()


def test_nothing_is_said_without_pulses_or_cycles_or_knots():
    shaft = swinging({0.5: 20.0}, seconds=1.0)
    shaft.attrs["n_pulses"] = 0
    assert speed_swing(shaft) is None
    assert speed_swing(swinging({0.5: 20.0}, seconds=0.1)) is None
    sparse = speed_swing(swinging({0.5: 20.0}, per_rev=1))
    assert sparse is None or sparse.orders.max() < 0.5
    reversed_ = swinging({}, seconds=1.0)
    reversed_["crank_angle"] = -reversed_["crank_angle"]
    assert speed_swing(reversed_) is None
