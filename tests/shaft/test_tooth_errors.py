"""Teeth that sit wrongly are the wheel's: taken out of the angle, while the shaft's own swing stays."""

import numpy as np
import pytest
import xarray as xr

from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.line_pattern import line_pattern
from crankorder.shaft.tooth_errors import same_wheel, speed_swing, stated_teeth, tooth_errors
from crankorder.shaft.wheel import number_teeth

SETTINGS = load_settings().shaft
WHEELS = [(60, 0), (36, 0), (24, 1), (60, 2), (360, 0)]


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
    teeth = number_teeth(times, pulses_per_rev=wheel[0], missing_teeth=wheel[1], settings=SETTINGS)
    return tooth_errors(teeth, ratio=1.0, revs_per_cycle=revs_per_cycle, noise_s=0.0, settings=SETTINGS)


def decoded(recording_of, times, wheel, **attrs):
    given = {"pulses_per_rev": wheel[0], "missing_teeth": wheel[1], "revs_per_cycle": 1} | attrs
    return shaft_angle(recording_of(times, **given), settings=SETTINGS)


@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("share", [0.05, 0.12])
def test_teeth_that_sit_wrongly_make_no_swing(recording_of, wheel, share):
    shaft = decoded(recording_of, pulse_times(wheel, drawn(wheel, share, 3)), wheel)
    flags = {flag["flag"] for flag in flags_of(shaft)}
    assert "encoder_tooth_errors" in flags
    swing = speed_swing(shaft)
    assert not swing.told.any()
    assert np.sqrt(np.sum(swing.steady_rpm[swing.orders > 6.0] ** 2)) < 0.003 * swing.speed_rpm


@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("swing", [((0.5, 0.02), (1, 0.03), (2, 0.04), (4, 0.01)), ((2, 0.1),)])
def test_the_swing_of_a_shaft_is_no_error_of_its_wheel(wheel, swing):
    times = pulse_times(wheel, np.zeros(wheel[0]), swing=swing)
    assert found_in(times, wheel, revs_per_cycle=2) is None


@pytest.mark.cases(2)
@pytest.mark.parametrize("seed", range(4))
def test_a_swing_stands_out_of_wrong_teeth_with_what_they_may_make_of_it(recording_of, seed):
    wheel = (60, 0)
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


@pytest.mark.slow
def test_a_wheel_is_known_again_and_another_is_not():
    wheel, stated = (60, 2), []
    for seed, rpm in ((1, 800.0), (1, 1900.0), (2, 1900.0)):
        errors = found_in(pulse_times(wheel, drawn(wheel, 0.1, seed), rpm=rpm), wheel)
        assert errors is not None
        stated.append(stated_teeth(errors, ratio=1.0, tdc_rev=0.0))
    assert same_wheel(stated[:2])
    assert not same_wheel(stated)


@pytest.mark.parametrize("wheel", [(60, 0), (360, 0)])
def test_small_errors_of_teeth_are_learned_where_the_encoder_is_in_doubt(recording_of, wheel):
    times = pulse_times(wheel, drawn(wheel, 0.004, 5))
    doubting = load_settings("calibrated-encoder").shaft
    error = {}
    for name, settings in (("default", SETTINGS), ("doubting", doubting)):
        recording = recording_of(times, pulses_per_rev=wheel[0], missing_teeth=0, revs_per_cycle=1)
        shaft = shaft_angle(recording, settings=settings)
        error[name] = np.std(shaft["crank_angle"].values - shaft["time"].values * 1000.0 / 60.0)
    assert error["doubting"] < 0.6 * error["default"]


def test_drift_of_the_speed_leaves_no_pattern_and_touches_no_order():
    lines, time_s = 60, np.linspace(0.0, 6.0, 1_000_001)
    error = 1e-3 * np.sin(2 * np.pi * np.arange(lines) / lines + 0.7)
    ramp = 1000.0 / 60.0 * time_s + 0.5 * 300.0 / 6.0 / 60.0 * time_s**2
    wobble = 1000.0 / 60.0 * time_s - 10.0 / 60.0 / (2 * np.pi * 0.4) * np.cos(2 * np.pi * 0.4 * time_s + 1.2)
    for angle, error_rev, atol in ((ramp, 0.0 * error, 1e-8), (wobble, error, 1e-7)):
        tooth = np.arange(np.ceil(angle[0] * lines) + 1, np.floor(angle[-1] * lines) - 1).astype(int)
        pulse_s = np.interp(tooth / lines + error_rev[tooth % lines], angle, time_s)
        pattern = line_pattern(pulse_s, tooth, teeth_per_encoder_rev=lines)
        expected = np.fft.rfft(error_rev) * (2.0 / lines)
        np.testing.assert_allclose(pattern.harmonic_rev, expected, rtol=0.0, atol=atol)


# Swing of the speed within the cycle, against the motion that was put in and a real engine.


def swinging(
    lines: dict[float, float],
    *,
    rpm: float = 1500.0,
    per_rev: int = 30,
    seconds: float = 3.0,
    slope: float = 0.0,
    revs_per_cycle: int = 2,
    noise_rpm: float = 0.0,
) -> xr.Dataset:
    """ShaftAngle with a speed of ``rpm`` + ``slope`` t and ``lines`` (order: peak in rpm) by the angle, integrated."""
    rng = np.random.default_rng(4)
    phases = {order: rng.uniform(0, 2 * np.pi) for order in lines}

    def speed(time: float, angle: np.ndarray) -> np.ndarray:
        swing = sum(size * np.cos(2 * np.pi * k * angle + phases[k]) for k, size in lines.items())
        return rpm + slope * time + swing

    count = int(seconds * rpm / 60 * per_rev)
    time, angle = np.linspace(0.0, seconds, count), np.zeros(count)
    for n in range(1, count):
        at, step = time[n - 1], (time[n] - time[n - 1]) / 8
        value = angle[n - 1]
        for _ in range(8):
            middle = value + 0.5 * step * speed(at, value) / 60
            value = value + step * speed(at + 0.5 * step, middle) / 60
            at += step
        angle[n] = value
    known = np.array([float(speed(t, a)) for t, a in zip(time, angle, strict=True)])
    return xr.Dataset(
        {
            "time": ("knot", time),
            "crank_angle": ("knot", angle),
            "speed": ("knot", known + noise_rpm * rng.standard_normal(count)),
        },
        attrs={"n_pulses": 1000, "revs_per_cycle": revs_per_cycle},
    )


@pytest.mark.cases(2)
@pytest.mark.parametrize("seed", range(4))
def test_orders_and_amplitudes_are_those_that_were_put_in(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rpm = rng.uniform(600, 4000)
    lines = {order: rpm * rng.uniform(0.002, 0.02) for order in (0.5, 1.0, 2.0, 3.5)}
    swing = speed_swing(swinging(lines, rpm=rpm, seconds=60.0 / rpm * 40))
    assert swing is not None and swing.speed_rpm == pytest.approx(rpm, rel=5e-3)
    for order, size in lines.items():
        at = swing.orders.tolist().index(order)
        assert swing.told[at]
        # a speed of ripple r by time has second harmonics of r squared by angle, and the mean over the angle
        assert swing.amplitude_rpm[at] == pytest.approx(size, rel=0.02, abs=2e-4 * rpm)


def test_a_run_up_without_swing_has_none() -> None:
    swing = speed_swing(swinging({}, slope=200.0))
    assert swing is not None and not swing.told.any()


def test_noise_of_the_edges_is_no_swing() -> None:
    swing = speed_swing(swinging({}, noise_rpm=15.0, seconds=6.0))
    assert swing is not None and not swing.told.any()


def test_nothing_is_said_without_pulses_or_cycles_or_knots() -> None:
    shaft = swinging({0.5: 20.0}, seconds=1.0)
    shaft.attrs["n_pulses"] = 0
    assert speed_swing(shaft) is None
    assert speed_swing(swinging({0.5: 20.0}, seconds=0.1)) is None
    sparse = speed_swing(swinging({0.5: 20.0}, per_rev=1))
    assert sparse is None or sparse.orders.max() < 0.5
    reversed_ = swinging({}, seconds=1.0)
    reversed_["crank_angle"] = -reversed_["crank_angle"]
    assert speed_swing(reversed_) is None
