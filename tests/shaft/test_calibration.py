"""Encoders of known line errors on shafts of known motion: what is told apart, how surely, and what is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.engine.in_cycle import Lag
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_knots, time_at
from crankorder.shaft.calibration import calibrate
from crankorder.shaft.line_pattern import even_line_times, line_pattern
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.wheel import number_teeth
from crankorder.synth.encoder import encoder_signals, index_wheel, passed_pulses, wheel_of
from crankorder.synth.motion import Motion
from crankorder.synth.parts import Encoder

SETTINGS = load_settings().shaft
RATE_HZ = 50_000.0
SPEEDS_RPM = (601.3, 1203.7, 1987.1)  # none in step with the samples
MASSES, GAS = {2: 0.005}, {0.5: 0.004, 1: 0.004}
"""Shares of ω² by crank order: the masses' at every speed, the gas' at 1000 rpm. Together 1.5 % of the speed."""
ECCENTRIC = {"eccentricity_deg": 0.1, "eccentricity_phase_deg": 40.0}
ORDERS, PHASES_RAD = np.array([1.0, 2.0, 5.5, 10.0]), np.array([0.3, -1.1, 2.0, 0.7])
BOUND = 0.5 * 0.5**0.5 * (2.0 / 750_000) ** 0.5
"""Cramér–Rao bound of benchmarks/shaft_angle.py: of an amplitude over the amplitude, of a phase [rad]."""


def lag_at(speed_rpm, masses=MASSES, gas=GAS):
    """Lag of a flywheel whose energy goes with the work of masses and gas, exact at this speed."""
    n = 4096
    angle = 2.0 * np.arange(n) / n
    work = sum(share * np.cos(2 * np.pi * k * angle + k) for k, share in masses.items())
    work = work + (1000.0 / speed_rpm) ** 2 * sum(s * np.cos(2 * np.pi * k * angle + k + 1) for k, s in gas.items())
    level = 1.0
    for _ in range(30):
        level += 2.0 * (np.mean((level + 2 * work) ** -0.5) - 1.0) / np.mean((level + 2 * work) ** -1.5)
    order = np.arange(1, 65) / 2.0
    lines = np.fft.rfft((level + 2 * work) ** -0.5)[1:65] * (2.0 / n) / (2j * np.pi * order)
    return Lag(order=order, inertia=lines, gas=0 * lines)


def shape_of(masses, scale=3.0):
    """The masses' lag as an engine model without its flywheel gives it: right but for the scale."""
    order = np.array(sorted(masses), dtype=float)
    lines = np.array([-scale * masses[k] * np.exp(1j * k) / (2j * np.pi * k) for k in order])
    return Lag(order=order, inertia=lines, gas=0 * lines)


def decoded(
    encoder, speed_rpm, *, lag=None, start_rev=0.3217, duration_s=6.0, seed=1, wobbles=(), corners=None, exact=False
):
    """Motion, numbered teeth, noise of a pulse and pattern of one recording, sampled or with exact times of pulses."""
    lag = lag_at(speed_rpm) if lag is None else lag
    motion = Motion(start_rev=start_rev, corners=corners or ((0.0, speed_rpm),), wobbles=wobbles, lag=lag)
    name = f"{seed}-{speed_rpm}"
    n_samples = round(duration_s * RATE_HZ)
    if exact:
        wheel = wheel_of(encoder, seed=seed)
        passed = (passed_pulses(part, motion, encoder, duration_s=duration_s) for part in (wheel, index_wheel(wheel)))
        pulse_s, index_s = (pulses.rise_s[pulses.rise_s >= 0] for pulses in passed)
        noise_s = 0.0
    else:
        made = encoder_signals(
            motion, encoder, (), seed=seed, recording=name, stream=name, rate_hz=RATE_HZ, n_samples=n_samples
        )
        how = {"rate_hz": RATE_HZ, "kind": "square", "edge": "rising", "settings": SETTINGS}
        pulses = find_pulses(made.trace, pulses_per_rev=encoder.pulses_per_rev, **how)
        pulse_s, noise_s = pulses.time_s, pulses.noise_s
        index_s = find_pulses(made.index.astype(np.float32), pulses_per_rev=1, **how).time_s
    teeth = number_teeth(
        pulse_s,
        pulses_per_rev=encoder.pulses_per_rev,
        missing_teeth=encoder.missing_teeth,
        settings=SETTINGS,
        index_time_s=index_s,
        ratio=encoder.ratio,
        noise_s=noise_s,
    )
    return motion, teeth, noise_s, pattern_of(teeth, ratio=encoder.ratio, noise_s=noise_s)


def pattern_of(teeth, *, ratio=1.0, noise_s=0.0, **changed):
    given = {"index_tooth": teeth.index_tooth, "index_period": teeth.index_period} | changed
    return line_pattern(
        teeth.time_s,
        teeth.tooth,
        teeth_per_encoder_rev=teeth.teeth_per_rev,
        ratio=ratio,
        revs_per_cycle=2,
        noise_s=noise_s,
        **given,
    )


def true_errors_deg(encoder, seed=1):
    wheel = wheel_of(encoder, seed=seed)
    return 360.0 * (wheel.rise - wheel.nominal)


def order_errors(motion, teeth, time_s, noise_s):
    """Errors of ORDERS in bounds, amplitude then phase, of a record without noise that this angle is used for."""
    knots = angle_knots(time_s, teeth.tooth, teeth_per_rev=teeth.teeth_per_rev, noise_s=noise_s, settings=SETTINGS)
    angle = knots.angle_rev - teeth.index_tooth / teeth.teeth_per_rev
    first = np.ceil(angle[0] + 0.2)
    revs = (angle[-1] - 0.2 - first) // 2 * 2
    wanted = first + np.arange(200_000) * (revs / 200_000)
    true = motion.at(time_at(wanted, knots.time_s, angle, knots.speed_rpm))[0]
    true -= np.round(np.median(true - wanted))
    signal = sum(np.cos(2 * np.pi * k * true + phase) for k, phase in zip(ORDERS, PHASES_RAD, strict=True))
    pairs = zip(ORDERS, PHASES_RAD, strict=True)
    read = np.array([2 * np.mean(signal * np.exp(-1j * (2 * np.pi * k * wanted + p))) for k, p in pairs]) - 1.0
    return np.concatenate([read.real, read.imag]) / BOUND


def extra_errors(encoder, speeds_rpm, start_rev):
    """Errors of ORDERS, over those with the true line errors taken out, as decoded and after calibration."""
    made = [decoded(encoder, speed, start_rev=start_rev, duration_s=4.0) for speed in speeds_rpm]
    found = calibrate([pattern for *_, pattern in made], engine_lag=shape_of(MASSES), index_to_tdc_deg=0.0)
    known = (true_errors_deg(encoder) / 360.0, np.zeros(encoder.pulses_per_rev), found.line_error_rev)
    errors = []
    for motion, teeth, noise_s, _ in made:
        even_s = [even_line_times(teeth.time_s, teeth.tooth, part, index_tooth=teeth.index_tooth) for part in known]
        errors.append([order_errors(motion, teeth, time_s, noise_s) for time_s in even_s])
    exact, raw, after = np.moveaxis(np.array(errors), 1, 0)
    return raw - exact, after - exact


def test_an_eccentric_encoder_costs_a_part_of_a_bound_at_most_once_calibrated():
    before, after = np.abs(extra_errors(Encoder(pulses_per_rev=360, **ECCENTRIC), SPEEDS_RPM, 0.3217))
    assert (before.max(axis=1) > 2.4).all()
    assert after.max() < 0.05


@pytest.mark.slow
def test_a_perfect_encoder_is_left_as_it_is():
    _, after = extra_errors(Encoder(pulses_per_rev=360), SPEEDS_RPM, 0.3217)
    assert np.abs(after).max() < 0.1


def test_drift_of_the_speed_leaves_no_pattern_and_touches_no_order():
    encoder = Encoder(pulses_per_rev=60)
    none = Lag(order=np.empty(0), inertia=np.empty(0, dtype=complex), gas=np.empty(0, dtype=complex))
    _, _, _, ramp = decoded(encoder, 1000.0, lag=none, corners=((0.0, 1000.0), (6.0, 1300.0)), exact=True)
    assert np.abs(ramp.deviation_rev).max() < 1e-8
    eccentric = Encoder(pulses_per_rev=60, **ECCENTRIC)
    _, _, _, wobbling = decoded(eccentric, 1000.0, lag=none, wobbles=((0.4, 10.0, 70.0),), exact=True)
    expected = true_errors_deg(eccentric) / 360.0
    np.testing.assert_allclose(wobbling.deviation_rev, expected - expected.mean(), atol=1e-7)
