"""Trigger wheels of running engines decode to the speeds that an engine control unit's own tests state for them.

The stated speeds are those of rusEFI's unit tests on the same traces: means over the last quarter or half turn before
the named edge, as that program takes them.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from crankorder.errors import InputError
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, knots_of, time_at
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pattern import pattern_of
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.uneven_wheel import find_pattern

SETTINGS = load_settings().shaft
COUNT_FAULTS = {"encoder_missing_pulse", "encoder_double_pulse", "encoder_slip", "encoder_gap"}


@pytest.fixture(scope="module")
def trace(shared_data):
    def read(name):
        header = 0 if name.startswith("noisy") else 1
        return np.loadtxt(shared_data / "crank_triggers" / name, delimiter=",", skiprows=header)

    return read


def edge_times(table, column, edge):
    high = table[:, column] > 0.5
    turned = high[1:] & ~high[:-1] if edge == "rising" else ~high[1:] & high[:-1]
    return table[1:, 0][turned]


def analogue_pulses(values, edge, *, rate_hz=10_000.0):
    return find_pulses(values, rate_hz=rate_hz, kind="analogue", edge=edge, pulses_per_rev=60, settings=SETTINGS)


def wheel_attrs(name):
    wheel = pattern_of(name)
    if wheel.even is not None:
        return dict(zip(("pulses_per_rev", "missing_teeth"), wheel.even, strict=True))
    return {"tooth_angles_deg": list(wheel.angles_deg)}


def decoded(recording_of, times, cam=None, **attrs):
    made = recording_of(times, encoder_kind="edge_list", revs_per_cycle=2, **attrs)
    if cam is not None:
        made["cam_time"] = ("cycle", cam, {"units": "s"})
    return shaft_angle(made, settings=SETTINGS)


def mean_rpm(angle, until_s, revs):
    end = angle_at(until_s, **knots_of(angle))[0]
    return 60.0 * revs / (until_s - time_at(end - revs, **knots_of(angle))[0])


def names(angle):
    return {flag["flag"] for flag in flags_of(angle)}


def test_the_stated_speed_is_reached(trace, recording_of):
    rows = [
        ("gm_24x_cranking.csv", "gm-24x", "rising", 23, 0.25, 77.0, 0.005),
        ("gm_24x_cranking.csv", "gm-24x", "rising", 134, 0.25, 139.0, 0.01),
        ("nb2-cranking-good.csv", "miata-nb", "rising", 977, 0.5, 876.0, 0.001),
        ("nick_1.csv", "60-2", "falling", 5196, 0.25, 1695.0, 0.002),
        ("cas_nissan_24_plus_1.csv", "12", "rising", 40, 0.25, 915.08, 0.002),
    ]
    for name, wheel, edge, row, revs, expected_rpm, tolerance in rows:
        table = trace(name)
        times = edge_times(table, 1, edge)
        angle = decoded(recording_of, times, **wheel_attrs(wheel))
        assert mean_rpm(angle, min(table[row - 1, 0], times[-1]), revs) == pytest.approx(expected_rpm, rel=tolerance)


def test_the_4b11_wheel_reads_the_same_from_both_edges_and_as_stated_with_the_bent_tooth(trace, recording_of):
    """1436.23 rpm are taken over the nine teeth that end at the tooth behind the gap, which stands 0.14 tooth off."""
    table = trace("4b11-running.csv")
    rising, falling = (edge_times(table, 1, edge) for edge in ("rising", "falling"))
    angles = [decoded(recording_of, times, **wheel_attrs("36-2-1")) for times in (rising, falling)]
    for angle in angles:
        assert not COUNT_FAULTS & names(angle)
    behind_gap = int(np.argmax(np.diff(rising) > 2.5 * np.median(np.diff(rising)))) + 1
    assert 60.0 * 9 / 36 / (rising[behind_gap] - rising[behind_gap - 7]) == pytest.approx(1436.23, rel=1e-4)
    both = [mean_rpm(angle, 5.5, 1.0) for angle in angles]
    assert both[0] == pytest.approx(both[1], rel=2e-4)
    assert "encoder_teeth_displaced" in names(angles[0])
    assert 1370 < angles[1]["speed"].min() < angles[1]["speed"].max() < 1460


def test_a_doubled_edge_is_removed_and_located(trace, recording_of):
    clean, doubled = (
        decoded(recording_of, edge_times(trace(name), 1, "rising"), **wheel_attrs("36-2-1"))
        for name in ("4b11-running.csv", "4b11-running-doubled-edge.csv")
    )
    (flag,) = [flag for flag in flags_of(doubled) if flag["flag"] == "encoder_double_pulse"]
    assert flag["detail"] == "1 false pulses removed, at 5.39378 s"
    assert doubled.attrs["n_pulses"] == clean.attrs["n_pulses"]
    time_s = np.linspace(5.23, 6.49, 5000)
    away = angle_at(time_s, **knots_of(doubled)) - angle_at(time_s, **knots_of(clean))
    np.testing.assert_allclose(away, np.round(away[0]), atol=2e-4)


def test_the_cam_of_the_4b11_tells_its_cycle_in_spite_of_doubled_marks(trace, recording_of):
    table = trace("4b11-running.csv")
    cam = edge_times(table, 2, "rising")
    angle = decoded(recording_of, edge_times(table, 1, "falling"), cam, **wheel_attrs("36-2-1"))
    assert angle.attrs["cycle_known"] == 1
    at_cam = angle_at(cam, **knots_of(angle)) % 2.0
    usual = np.median(at_cam)
    assert np.mean(np.abs(at_cam - usual) < 0.01) > 0.85
    (flag,) = [flag for flag in flags_of(angle) if flag["flag"] == "cam_extra"]
    assert flag["detail"].startswith("2 cam marks")


def test_a_cam_encoder_of_24_and_one_slots_reads_by_either_shaft(trace, recording_of):
    for attrs in [{"pulses_per_rev": 12}, {"pulses_per_rev": 24, "ratio": 0.5}]:
        table = trace("cas_nissan_24_plus_1.csv")
        times, marks = edge_times(table, 1, "rising"), edge_times(table, 2, "rising")
        on_cam = "ratio" in attrs
        angle = decoded(recording_of, times, None if on_cam else marks, index_time_s=marks if on_cam else None, **attrs)
        assert angle.attrs["cycle_known"] == 1
        at_marks = angle_at(marks, **knots_of(angle))
        np.testing.assert_allclose(np.diff(at_marks), 2.0, atol=0.01)


def long_steps(times):
    """Numbers of the pulses before intervals twice as long as those beside them."""
    step = np.diff(times)
    beside = np.median(np.lib.stride_tricks.sliding_window_view(step, 9), axis=1)
    return 4 + np.flatnonzero(step[4:-4] > 2.0 * beside)


@pytest.mark.cases(2)
@pytest.mark.parametrize("edge", ["rising", "falling"])
@pytest.mark.parametrize("name", ["noisy-trigger-1.csv", "noisy-trigger-2.csv"])
def test_a_noisy_36_2_wheel_keeps_34_teeth_in_every_revolution(trace, recording_of, name, edge):
    times = edge_times(trace(name), 1, edge)
    angle = decoded(recording_of, times, pulses_per_rev=36, missing_teeth=2)
    assert "encoder_missing_pulse" not in names(angle)
    gaps = long_steps(times)
    gaps = gaps[times[gaps] > 0.5]  # after the start
    places, counts = np.unique(gaps % 34, return_counts=True)
    assert counts.max() > 0.8 * counts.sum()  # the others are near stalls against compression
    reached = angle_at(times[gaps[gaps % 34 == places[np.argmax(counts)]]], **knots_of(angle))
    np.testing.assert_allclose(np.diff(reached), np.round(np.diff(reached)), atol=0.02)
    assert reached[-1] - reached[0] == pytest.approx((gaps[-1] - gaps[0]) / 34, abs=0.05)


def test_a_start_from_standstill_is_left_out_and_what_follows_ends_at_1695_rpm(trace, recording_of):
    times = edge_times(trace("nick_1.csv"), 1, "falling")
    angle = decoded(recording_of, times, pulses_per_rev=60, missing_teeth=2)
    told = {flag["flag"]: flag["detail"] for flag in flags_of(angle)}
    assert "from 1.55337 to 2.76262 s" in told["standstill"]
    assert "direction_unknown" in told
    assert "6 false pulses removed, at 2.76262" in told["encoder_double_pulse"]
    assert angle["time"].values[0] > 2.7


@pytest.mark.slow
def test_a_trace_whose_converter_overflows_is_refused_by_the_count(trace, recording_of):
    found = analogue_pulses(trace("trigger_adc_real2.csv")[:, 1], "falling")
    with pytest.raises(InputError, match="false of 2800: the count is not certain"):
        decoded(recording_of, found.time_s, pulses_per_rev=60, missing_teeth=2)


def test_real_wheels_are_found_by_themselves(trace):
    rows = [
        ("4b11-running.csv", "rising", "36-2-1"), ("4b11-running-doubled-edge.csv", "falling", "36-2-1"),
        ("nb2-cranking-good.csv", "rising", "miata-nb"), ("nick_1.csv", "falling", "60-2"),
        ("noisy-trigger-1.csv", "rising", "36-2"), ("noisy-trigger-2.csv", "falling", "36-2"),
    ]  # fmt: skip
    for name, edge, wheel in rows:
        found = find_pattern(edge_times(trace(name), 1, edge))
        assert found is not None
        assert found.pattern.name == wheel
        assert found.agreement > 0.9


@pytest.mark.cases(2)
@pytest.mark.parametrize(
    ("manifest", "speeds_rpm", "reference", "cycle_known"),
    [
        ("trigger_36_2_1", [1412.0, 1412.0], "index", 1), ("trigger_60_2", [1691.0], "index", 0),
        ("trigger_gm_24x", [138.0], "index", 0), ("trigger_miata_nb", [904.5], "none", 0),
        ("trigger_24_plus_1", [1056.0], "index", 1), ("trigger_36_2", [317.0, 221.7], "index", 0),
        ("trigger_adc", [322.0], "index", 1),
    ],
)  # fmt: skip
def test_every_trace_reads_by_its_manifest(shared_data, manifest, speeds_rpm, reference, cycle_known):
    """Mean speed of the last crank revolution; the stated figures of shorter spans are checked above."""
    limits, folder = load_settings(), shared_data / "crank_triggers"
    stated = load_manifest(folder, Path(__file__).parents[1] / "real" / f"{manifest}.toml")
    found = recordings_of(folder, stated)
    assert not found.faults
    assert len(found.paths) == len(speeds_rpm)
    for path, speed_rpm in zip(found.paths, speeds_rpm, strict=True):
        recording = read_recording(path, stated, settings=limits.ingest, shaft=limits.shaft)
        angle = shaft_angle(recording, settings=limits.shaft)
        until_s = recording["pulse_time"].values[-1] + recording.attrs.get("start_s", 0.0)
        assert mean_rpm(angle, until_s, 1.0) == pytest.approx(speed_rpm, rel=0.01)
        assert (angle.attrs["phase_reference"], angle.attrs["cycle_known"]) == (reference, cycle_known)


# Measured encoder traces decode to what their sources and the data's own README say.


def genset_pulses(trace):
    return find_pulses(trace, rate_hz=100_000.0, kind="analogue", edge="rising", pulses_per_rev=60, settings=SETTINGS)


def genset_angle(trace, recording_of):
    found = genset_pulses(trace)
    recording = recording_of(
        found.time_s, pulses_per_rev=60, missing_teeth=2, revs_per_cycle=2, pulse_noise_s=found.noise_s
    )
    return shaft_angle(recording, settings=SETTINGS)


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", ["ENGINEOFF.txt", "ENGINEOFF2.txt", "E0FULLOAD4EngineOff.txt"])
def test_a_coasting_genset_slows_down_without_a_repair(genset_pickup, recording_of, name):
    angle = genset_angle(genset_pickup(name), recording_of)
    time_s, angle_rev = angle["time"].values, angle["crank_angle"].values
    whole = np.arange(np.ceil(angle_rev[0]), np.floor(angle_rev[-1]) + 1)
    speed = 60.0 / np.diff(np.interp(whole, angle_rev, time_s))  # mean of each whole revolution
    assert speed[-2:].mean() < 0.95 * speed[:2].mean()
    assert not {"encoder_missing_pulse", "encoder_double_pulse"} & {item["flag"] for item in flags_of(angle)}


def rotor_files(data):
    return sorted((data / "rotorbalancer").glob("*/*.csv"))


def rotor_angle(path, recording_of):
    infrared = pd.read_csv(path, comment="#")["ir"].to_numpy()
    found = find_pulses(infrared, rate_hz=952.0, kind="square", edge="rising", pulses_per_rev=1, settings=SETTINGS)
    recording = recording_of(found.time_s, pulses_per_rev=1, pulse_noise_s=found.noise_s, rate_hz=952.0)
    return shaft_angle(recording, settings=SETTINGS), found


def test_every_rotor_coast_down_gives_a_smoothly_falling_speed(shared_data, recording_of):
    paths = [path for path in rotor_files(shared_data) if "stepped" in str(path)]
    assert len(paths) == 60
    for path in paths:
        angle, found = rotor_angle(path, recording_of)
        inside = slice(2, -2)
        speed = angle["speed"].values[inside]
        interval_rpm = 60.0 / np.diff(found.time_s)
        assert speed[0] == pytest.approx(interval_rpm[:4].mean(), rel=0.04), path
        assert speed[-1] == pytest.approx(interval_rpm[-4:].mean(), rel=0.04), path
        assert (np.diff(speed) < 0).all(), path
        revs = np.ptp(angle_at(found.time_s[[0, -1]], **knots_of(angle)))
        sample_rev = 1.0 / 952.0 / np.diff(found.time_s).min()
        assert revs == pytest.approx(found.time_s.size - 1, abs=sample_rev), path
        assert not {"encoder_missing_pulse", "encoder_double_pulse"} & {item["flag"] for item in flags_of(angle)}
