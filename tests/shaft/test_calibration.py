"""Encoders of known line errors on shafts of known motion: what is told apart, how surely, and what is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.engine.in_cycle import Lag, lag_from_torque
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_knots, time_at
from crankorder.shaft.calibration import calibrate, mass_lag
from crankorder.shaft.line_pattern import even_line_times, line_pattern
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.wheel import number_teeth
from crankorder.synth.crank import crank_motion
from crankorder.synth.encoder import encoder_signals
from crankorder.synth.load import load_scene
from crankorder.synth.motion import Motion
from crankorder.synth.parts import Encoder, InCycleSpeed, SpeedOrder
from crankorder.synth.wheel import wheel_of

SETTINGS = load_settings().shaft
RATE_HZ = 50_000.0
SPEEDS_RPM = (600.0, 1200.0, 2000.0)
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


def decoded(encoder, speed_rpm, *, lag=None, start_rev=0.3217, duration_s=6.0, seed=1, wobbles=(), corners=None):
    """Motion, numbered teeth, noise of a pulse and pattern of one recording."""
    lag = lag_at(speed_rpm) if lag is None else lag
    motion = Motion(start_rev=start_rev, corners=corners or ((0.0, speed_rpm),), wobbles=wobbles, lag=lag)
    name = f"{seed}-{speed_rpm}"
    n_samples = round(duration_s * RATE_HZ)
    made = encoder_signals(
        motion, encoder, (), seed=seed, recording=name, stream=name, rate_hz=RATE_HZ, n_samples=n_samples
    )
    pulse_s, index_s, noise_s = made.pulse_s, made.index_s, 0.0
    if made.trace is not None:
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


def calibrated(encoder, speeds_rpm=SPEEDS_RPM, *, engine_lag=None, **recorded):
    patterns = [decoded(encoder, speed, **recorded)[3] for speed in speeds_rpm]
    return calibrate(patterns, ratio=encoder.ratio, engine_lag=engine_lag, index_to_tdc_deg=encoder.index_to_tdc_deg)


def true_errors_deg(encoder, seed=1):
    wheel = wheel_of(encoder, seed=seed)
    return 360.0 * (wheel.rise - wheel.nominal)


def first_order_deg(errors_deg):
    """Size, and phase of what is shown less what is true, of the encoder's order 1 in all line errors together."""
    first = np.fft.rfft(errors_deg)[1] * (2.0 / errors_deg.size)
    return abs(first), np.degrees(np.angle(first)) - 90.0


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


def flags(calibration):
    return {flag for flag, _, _ in calibration.remarks}


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


@pytest.mark.parametrize("speeds_rpm", [SPEEDS_RPM, (601.3, 1203.7, 1987.1)])
def test_an_eccentric_encoder_costs_half_a_bound_at_most_once_calibrated(speeds_rpm):
    starts = (0.3217, 0.8123)
    errors = [extra_errors(Encoder(pulses_per_rev=360, **ECCENTRIC), speeds_rpm, start) for start in starts]
    before, after = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (before.max(axis=1) > 2.4).all()
    assert after.max() < 0.5
    # speeds in step with the samples are the hard ones
    assert speeds_rpm == SPEEDS_RPM or after.max() < 0.05


@pytest.mark.parametrize("speeds_rpm", [SPEEDS_RPM, (601.3, 1203.7, 1987.1)])
def test_a_perfect_encoder_is_left_as_it_is(speeds_rpm):
    _, after = extra_errors(Encoder(pulses_per_rev=360), speeds_rpm, 0.3217)
    assert np.abs(after).max() < 0.1


@pytest.mark.parametrize(
    ("encoder", "wobbles"),
    [
        pytest.param(
            {"pulses_per_rev": 60, "delivered_as": "pulse_times", "jitter_s": 2e-6}, (), marks=pytest.mark.accuracy
        ),
        ({"pulses_per_rev": 60, "delivered_as": "pulse_times", "jitter_s": 2e-6}, ((0.7, 4.0, 30.0), (1.9, 3.0, 0.0))),
        pytest.param(
            {"pulses_per_rev": 60, "delivered_as": "pulse_times", "jitter_s": 2e-6, "ratio": 0.5},
            (),
            marks=pytest.mark.accuracy,
        ),
        ({"pulses_per_rev": 120, "delivered_as": "pulse_times", "counter_hz": 1e6}, ()),
    ],
    ids=["jitter", "wobbling speed", "camshaft", "counter"],
)
def test_the_intervals_hold_the_eccentricity_in_95_of_100_draws(encoder, wobbles):
    rng = np.random.default_rng(3)
    size_held, phase_held, lines = [], [], []
    for seed in range(100):
        phase = float(rng.uniform(-180.0, 180.0))
        turned = Encoder(**encoder, eccentricity_deg=0.1, eccentricity_phase_deg=phase, line_error_deg=0.004)
        speeds = np.array(SPEEDS_RPM) * rng.uniform(0.98, 1.02, 3)
        found = calibrated(
            turned,
            speeds,
            engine_lag=shape_of(MASSES),
            seed=seed,
            start_rev=float(rng.uniform(0.0, 2.0)),
            duration_s=1.5,
            wobbles=wobbles,
        )
        true = true_errors_deg(turned, seed)
        size, phase = first_order_deg(true)
        low, high = found.eccentricity_ci95_deg
        size_held.append(low <= size <= high)
        low, high = found.eccentricity_phase_ci95_deg
        phase_held.append((phase - low) % 360.0 <= high - low)
        rest = true - true.mean() - 360.0 * found.line_error_rev
        lines.append(np.mean(rest**2) / (360.0 * found.standard_error_rev[0]) ** 2)
    assert np.mean(size_held) >= 0.89
    assert np.mean(phase_held) >= 0.89
    # the standard error is that of the lines, neither too proud nor of no use
    assert 0.5 < np.mean(lines) < 1.3


def test_one_speed_is_refused_and_so_are_speeds_too_near_and_too_short_recordings():
    encoder = Encoder(pulses_per_rev=360, **ECCENTRIC)
    shape = shape_of(MASSES)
    for speeds, reason in [((1200.0,), "only one recording"), ((1200.0, 1250.0, 1300.0), "1.2 times the lowest")]:
        found = calibrated(encoder, speeds, engine_lag=shape, duration_s=2.0)
        ((flag, severity, detail),) = found.remarks
        assert (flag, severity) == ("encoder_calibration_not_possible", "suspect")
        assert reason in detail
        assert not found.separated
        assert not found.line_error_rev.any()
        assert np.isnan(found.eccentricity_deg)
    short = calibrated(encoder, engine_lag=shape, duration_s=0.2)
    assert "too few" in short.remarks[0][2]
    assert "no recording" in calibrate([]).remarks[0][2]


def test_speeds_whose_noise_hides_the_difference_are_refused():
    encoder = Encoder(pulses_per_rev=60, **ECCENTRIC, delivered_as="pulse_times", jitter_s=2e-5)
    gas = {0.5: 0.01, 1: 0.02}
    patterns = [decoded(encoder, speed, lag=lag_at(speed, gas=gas), duration_s=1.0)[3] for speed in (1000.0, 1004.0)]
    found = calibrate(patterns, engine_lag=shape_of(MASSES), index_to_tdc_deg=0.0, least_speed_ratio=1.001)
    assert flags(found) == {"encoder_calibration_not_possible"}
    assert "further apart" in found.remarks[0][2]


def test_without_an_index_there_is_no_telling_which_line_is_which():
    _, teeth, _, _ = decoded(Encoder(pulses_per_rev=60, delivered_as="pulse_times"), 1000.0, duration_s=2.0)
    for changed in ({"index_tooth": float("nan")}, {"index_period": 30.0}):
        found = calibrate([pattern_of(teeth, **changed)] * 3)
        assert flags(found) == {"encoder_calibration_not_possible"}
        assert "no index" in found.remarks[0][2]


def test_without_the_engine_the_orders_of_masses_stay_as_they_are_and_the_rest_is_put_right():
    encoder = Encoder(pulses_per_rev=360, **ECCENTRIC, line_error_deg=0.02)
    found = calibrated(encoder, (611.3, 1203.7, 1987.1))
    assert flags(found) == {"encoder_calibrated", "encoder_calibration_partial"}
    assert found.unknown_orders == (1, 2, 3, 4, 5, 6)
    assert np.isnan(found.eccentricity_deg)
    true, kept = (np.fft.rfft(errors) for errors in (true_errors_deg(encoder), 360.0 * found.line_error_rev))
    assert np.abs(kept[:7]).max() < 1e-12
    assert np.sum(np.abs((true - kept)[7:]) ** 2) < 0.1 * np.sum(np.abs(true[7:]) ** 2)


def test_an_engine_without_first_order_or_without_masses_at_all_leaves_the_eccentricity_told():
    encoder = Encoder(pulses_per_rev=360, **ECCENTRIC)
    none = Lag(order=np.empty(0), inertia=np.empty(0, dtype=complex), gas=np.empty(0, dtype=complex))
    rotor = calibrate(
        [decoded(encoder, speed, lag=lag_at(speed, masses={}))[3] for speed in (611.3, 1203.7, 1987.1)],
        engine_lag=none,
    )
    assert rotor.unknown_orders == ()
    assert rotor.eccentricity_deg == pytest.approx(0.1, abs=0.002)
    # dead centre unknown: the phase of the masses' second order is too, the first order is the encoder's alone
    patterns = [decoded(encoder, speed)[3] for speed in (611.3, 1203.7, 1987.1)]
    found = calibrate(patterns, engine_lag=shape_of(MASSES))
    assert found.unknown_orders == (2,)
    assert found.eccentricity_deg == pytest.approx(0.1, abs=0.002)
    assert found.eccentricity_phase_deg == pytest.approx(40.0, abs=1.0)


@pytest.mark.parametrize("missing_teeth", [0, 2])
def test_motion_of_masses_at_order_one_is_not_taken_for_eccentricity(missing_teeth):
    masses = {1: 0.004, 2: 0.008, 3: 0.003}
    encoder = Encoder(
        pulses_per_rev=60,
        missing_teeth=missing_teeth,
        **ECCENTRIC,
        delivered_as="pulse_times",
        jitter_s=1e-6,
        index_to_tdc_deg=72.5,
    )
    patterns = [decoded(encoder, speed, lag=lag_at(speed, masses=masses))[3] for speed in SPEEDS_RPM]
    found = calibrate(patterns, engine_lag=shape_of(masses), index_to_tdc_deg=72.5)
    assert found.lag_scale == pytest.approx(1 / 3, rel=0.003)
    assert found.eccentricity_deg == pytest.approx(0.1, abs=0.001)
    assert found.eccentricity_phase_deg == pytest.approx(40.0, abs=0.6)
    # a lag that has the orders but not their phases is no model of this engine: better nothing than that
    wrong = calibrate(patterns, engine_lag=shape_of(masses), index_to_tdc_deg=20.0)
    assert set(wrong.unknown_orders) >= {1, 2, 3}
    assert "encoder_calibration_partial" in flags(wrong)


def test_gas_that_is_not_the_same_in_all_recordings_is_told_and_widens_the_interval():
    encoder = Encoder(pulses_per_rev=60, **ECCENTRIC, delivered_as="pulse_times", jitter_s=1e-6)
    speeds = (600.0, 900.0, 1200.0, 2000.0)
    other = {k: 2.0 * share for k, share in GAS.items()}
    patterns = [decoded(encoder, speed, lag=lag_at(speed, gas=other if speed == 900.0 else GAS))[3] for speed in speeds]
    found = calibrate(patterns, engine_lag=shape_of(MASSES), index_to_tdc_deg=0.0)
    steady = calibrated(encoder, speeds, engine_lag=shape_of(MASSES))
    assert "encoder_calibration_misfit" in flags(found) - flags(steady)
    low, high = found.eccentricity_ci95_deg
    assert low < 0.1 < high
    assert high - low > 20.0 * np.ptp(steady.eccentricity_ci95_deg)


def test_an_engine_whose_speed_swings_by_a_tenth_gives_encoder_and_flywheel():
    engine = load_scene("thesis-second-firing").engine
    encoder = Encoder(pulses_per_rev=360, **ECCENTRIC)
    patterns = []
    for speed in (610.0, 1211.0, 1987.0):
        lag = lag_from_torque(engine, flywheel_inertia_kg_m2=0.3, speed_rpm=speed, highest_order=20, with_gas=True)
        patterns.append(decoded(encoder, speed, lag=lag, duration_s=4.0)[3])
    found = calibrate(patterns, engine_lag=mass_lag(engine, flywheel_inertia_kg_m2=0.6), index_to_tdc_deg=0.0)
    assert 2 * np.pi * np.abs(patterns[0].cycle_rev * np.arange(patterns[0].cycle_rev.size) / 2).max() > 0.08
    assert found.eccentricity_deg == pytest.approx(0.1, abs=0.002)
    assert found.lag_scale == pytest.approx(2.0, rel=0.005)


def test_drift_of_the_speed_leaves_no_pattern_and_touches_no_order():
    encoder = Encoder(pulses_per_rev=60, delivered_as="pulse_times")
    none = Lag(order=np.empty(0), inertia=np.empty(0, dtype=complex), gas=np.empty(0, dtype=complex))
    _, _, _, ramp = decoded(encoder, 1000.0, lag=none, corners=((0.0, 1000.0), (6.0, 1300.0)))
    assert np.abs(ramp.deviation_rev).max() < 1e-8
    eccentric = Encoder(pulses_per_rev=60, delivered_as="pulse_times", **ECCENTRIC)
    _, _, _, wobbling = decoded(eccentric, 1000.0, lag=none, wobbles=((0.4, 10.0, 70.0),))
    expected = true_errors_deg(eccentric) / 360.0
    np.testing.assert_allclose(wobbling.deviation_rev, expected - expected.mean(), atol=1e-7)


def test_the_eccentric_scene_is_told_but_not_where_its_motion_is_that_of_no_engine():
    # the same at all speeds, at orders 1 and 2 but not at order 3, where the masses would be too
    scene = load_scene("hard-eccentric-encoder")
    swings = (SpeedOrder(order=1.0, percent=0.3, phase_deg=60.0), SpeedOrder(order=2.0, percent=0.8))
    of_none = scene.model_copy(update={"in_cycle_speed": InCycleSpeed(by_order=swings)})
    for used, told in ((scene, True), (of_none, False)):
        patterns = [
            decoded(used.encoder, run.speed_rpm, lag=crank_motion(used, run).lag, seed=used.seed)[3]
            for run in used.runs
        ]
        found = calibrate(patterns, engine_lag=mass_lag(used.engine), index_to_tdc_deg=used.encoder.index_to_tdc_deg)
        size, phase = first_order_deg(true_errors_deg(used.encoder, used.seed))
        assert ("encoder_calibration_partial" in flags(found)) is not told
        assert (1 in found.unknown_orders) is not told
        if told:
            low, high = found.eccentricity_ci95_deg
            assert low < size < high
            assert high - low < 0.03
            assert found.eccentricity_phase_deg == pytest.approx(phase, abs=6.0)
        else:
            assert np.abs(np.fft.rfft(found.line_error_rev)[:7]).max() < 1e-12
