"""What the audit expects a reference to do to each order is what it does, cause by cause."""

import numpy as np
import pytest
import xarray as xr

from crankorder.shaft.angle import angle_knots, knots_of, time_at
from crankorder.shaft.audit import (
    Modulation,
    lag_rev,
    pulse_noise,
    reference_audit,
    reference_of,
    seen_motion,
    unseen_motion,
)
from crankorder.shaft.decode import shaft_angle
from crankorder.synth.motion import Motion
from made.shipped import SHAFT

RATE_HZ, REVS, POINTS = 50_000.0, 16, 512
ORDERS = (1.0, 5.5, 10.0, 40.0)


def decoded(pulse_s, pulses_per_rev, *, noise_s, edge_step_s=0.0):
    """ShaftAngle of pulses that are complete, with what the audit asks of its attributes."""
    knots = angle_knots(pulse_s, np.arange(pulse_s.size), teeth_per_rev=pulses_per_rev, noise_s=noise_s, settings=SHAFT)
    columns = (knots.time_s, knots.angle_rev, knots.speed_rpm, knots.standard_error_rev)
    values = zip(("time", "crank_angle", "speed", "standard_error"), columns, ("s", "rev", "min-1", "rev"), strict=True)
    attrs = {
        "recording": "made", "phase_reference": "none", "cycle_known": 0, "revs_per_cycle": 2,
        "n_pulses": pulse_s.size, "teeth_per_rev": float(pulses_per_rev), "cut_off_order": knots.cut_off_order,
        "edge_step_s": edge_step_s,
    }  # fmt: skip
    return xr.Dataset({name: ("knot", value, {"units": unit}) for name, value, unit in values}, attrs=attrs)


def rounded(pulse_s):
    """Times of edges that lie between two samples, taken half-way."""
    return (np.ceil(pulse_s * RATE_HZ) - 0.5) / RATE_HZ


def achieved(shaft_dataset, true, pulses_per_rev):
    """Loss and largest sideband of lines at ORDERS, in frames by the decoded angle."""
    knots = knots_of(shaft_dataset)
    first = np.ceil(knots["knot_angle_rev"][0] + 2)
    frames = int((knots["knot_angle_rev"][-1] - 2 - first) // REVS)
    angle = first + np.arange(frames * REVS * POINTS) / POINTS
    error = true.angle_rev(time_at(angle, **knots)) - angle
    error -= np.round(np.median(error) * pulses_per_rev) / pulses_per_rev  # teeth are not numbered from any mark
    result = {"loss": [], "sideband": []}
    for order in ORDERS:
        lines = np.exp(2j * np.pi * order * error).reshape(frames, -1)
        spectrum = np.fft.fft(lines, axis=1) / lines.shape[1]
        result["loss"].append(1 - np.abs(spectrum[:, 0]).mean())
        result["sideband"].append(np.abs(spectrum[:, 1:]).mean(axis=0).max())
    return {name: np.array(values) for name, values in result.items()}


def audit_of(shaft_dataset):
    return reference_audit(shaft_dataset, orders=ORDERS, revs_per_frame=REVS, settings=SHAFT)


def expected_of(*causes):
    """What lines at ORDERS are expected to suffer from ``causes``, as :func:`achieved` gives it."""
    order = np.array(ORDERS)
    return {
        "loss": 1.0 - np.prod([1.0 - cause.loss(order) for cause in causes], axis=0),
        "sideband": np.max([cause.sideband(order) for cause in causes], axis=0),
    }


def assert_within_factor(expected, found, factor):
    ratio = expected / found
    assert np.all((ratio > 1 / factor) & (ratio < factor)), ratio


def test_a_swinging_error_does_to_a_line_what_bessel_functions_say():
    turns = np.arange(4096) / 4096
    error = 0.01 * np.sin(2 * np.pi * 3 * turns)
    cause = Modulation("test", tone_order=np.array([3.0]), tone_rev=np.array([0.01]))
    for order in (1.0, 10.0, 25.0):
        spectrum = np.abs(np.fft.fft(np.exp(2j * np.pi * order * error))) / 4096
        assert cause.loss(np.array([order]))[0] == pytest.approx(1 - spectrum[0], rel=1e-9)
        assert cause.sideband(np.array([order]))[0] == pytest.approx(spectrum[3], rel=1e-9)


def test_random_jitter_costs_what_is_expected(known_shaft):
    true = known_shaft(1500.0, irregularity={}, duration_s=30.0)
    pulse_s = true.pulse_time_s(60)
    pulse_s = pulse_s + 2e-4 * np.random.default_rng(3).standard_normal(pulse_s.size)
    dataset = decoded(pulse_s, 60, noise_s=2e-4)
    found = achieved(dataset, true, 60)
    expected = expected_of(audit_of(dataset).causes[0])
    assert_within_factor(expected["loss"], found["loss"], 1.6)


# between the pulses, and between the knots
@pytest.mark.cases(5)
@pytest.mark.parametrize(
    ("pulses_per_rev", "order", "irregularity"),
    [(1, 2.0, 0.001), (2, 1.5, 0.01), (60, 40.0, 0.03), (6, 1.0, 0.01), (360, 100.0, 0.03)],
)
def test_motion_that_the_pulses_or_the_knots_do_not_show_costs_what_is_expected(
    known_shaft, pulses_per_rev, order, irregularity
):
    true = known_shaft(1000.0, irregularity={order: irregularity}, duration_s=6.0)
    dataset = decoded(true.pulse_time_s(pulses_per_rev), pulses_per_rev, noise_s=0.0)
    found, reference = achieved(dataset, true, pulses_per_rev), reference_of(dataset, revs_per_frame=REVS)
    motion = unseen_motion(reference, {order: lag_rev(order, irregularity)})
    expected = expected_of(pulse_noise(reference, revs_per_frame=REVS), motion)
    between_pulses = 2.0 * order >= pulses_per_rev
    assert_within_factor(expected["loss"], found["loss"], 1.1 if between_pulses else 2.0)
    assert_within_factor(expected["sideband"], found["sideband"], 1.25 if between_pulses else 2.0)


def test_motion_that_the_pulses_show_is_measured(known_shaft):
    true = known_shaft(1213.7, irregularity={0.5: 0.004, 2.0: 0.01, 6.0: 0.005})
    dataset = decoded(rounded(true.pulse_time_s(60)), 60, noise_s=12**-0.5 / RATE_HZ)
    seen = seen_motion(dataset, reference_of(dataset, revs_per_frame=REVS))
    for order, share in true.irregularity.items():
        assert seen[order] == pytest.approx(share / (2 * np.pi * order), rel=0.02)


def test_a_run_up_is_no_motion_within_the_cycle():
    motion = Motion(start_rev=0.0, corners=((0.0, 400.0), (9.0, 880.0)))
    (stretch,) = motion.stretches(9.0)
    pulse_s = motion.time_at(np.arange(1.0, 95.0 * 60) / 60, stretch)
    dataset = decoded(pulse_s, 60, noise_s=0.0)
    seen = seen_motion(dataset, reference_of(dataset, revs_per_frame=REVS))
    assert all(order * size * 2 * np.pi < 1e-5 for order, size in seen.items())
    assert audit_of(dataset).highest_carried_order > 1000


def test_one_pulse_per_revolution_carries_few_orders_and_says_so(known_shaft):
    dataset = decoded(known_shaft(1000.0).pulse_time_s(1), 1, noise_s=0.0)
    audit = audit_of(dataset)
    # J1(k · 1 % / 1) = 5 % at k = 10.0
    assert audit.highest_carried_order == pytest.approx(10.0, rel=0.02)
    ((flag, severity, detail),) = audit.remarks
    assert (flag, severity) == ("reference_limits_orders", "info")
    assert "if 1 % of the speed swings at order 1" in detail
    # 1 - J0(40 · 1 % / 1) = (40 · 1 %)² / 4
    assert "no motion at order 1 and above shows, 1 % of which would cost order 40 4 %" in detail
    below = reference_audit(dataset, orders=(1.0, 5.5), revs_per_frame=REVS, settings=SHAFT)
    assert below.remarks == ()


def test_an_angle_without_an_error_of_its_own_is_not_vouched_for(recording_of):
    rows = [
        ({"encoder_kind": "constant", "speed_rpm": 1500.0}, ["reference_unproven"]),
        ({"encoder_kind": "none", "domain": "crank_angle", "samples_per_rev": 360, "speed_rpm": 900.0}, []),
    ]
    for attrs, flags in rows:
        dataset = shaft_angle(recording_of(None, **attrs), settings=SHAFT)
        audit = audit_of(dataset)
        assert np.isnan(audit.highest_carried_order)
        assert [flag for flag, _, _ in audit.remarks] == flags
