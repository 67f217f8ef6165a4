"""Trigger wheels of running engines decode to the speeds that an engine control unit's own tests state for them.

The stated speeds are those of rusEFI's unit tests on the same traces: means over the last quarter or half turn before
the named edge, as that program takes them.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.quantities import flags_of
from crankorder.shaft.angle import angle_at, knots_of, time_at
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pattern import pattern_of
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.uneven_wheel import find_pattern
from made.shipped import SETTINGS, SHAFT


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


def wheel_attrs(name):
    wheel = pattern_of(name)
    if wheel.even is not None:
        return dict(zip(("pulses_per_rev", "missing_teeth"), wheel.even, strict=True))
    return {"tooth_angles_deg": list(wheel.angles_deg)}


def decoded(recording_of, times, cam=None, **attrs):
    made = recording_of(times, encoder_kind="edge_list", revs_per_cycle=2, **attrs)
    if cam is not None:
        made["cam_time"] = ("cycle", cam, {"units": "s"})
    return shaft_angle(made, settings=SHAFT)


def mean_rpm(angle, until_s, revs):
    end = angle_at(until_s, **knots_of(angle))[0]
    return 60.0 * revs / (until_s - time_at(end - revs, **knots_of(angle))[0])


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


def test_real_wheels_are_found_by_themselves(trace):
    rows = [
        ("4b11-running.csv", "rising", "36-2-1"), ("4b11-running-doubled-edge.csv", "falling", "36-2-1"),
        ("nb2-cranking-good.csv", "rising", "miata-nb"), ("nick_1.csv", "falling", "60-2"),
        ("noisy-trigger-1.csv", "rising", "36-2"), ("noisy-trigger-2.csv", "falling", "36-2"),
    ]  # fmt: skip
    for name, edge, wheel in rows:
        found = find_pattern(edge_times(trace(name), 1, edge))
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
    folder = shared_data / "crank_triggers"
    stated = load_manifest(folder, Path(__file__).parents[1] / "real" / f"{manifest}.toml")
    found = recordings_of(folder, stated)
    assert not found.faults
    assert len(found.paths) == len(speeds_rpm)
    for path, speed_rpm in zip(found.paths, speeds_rpm, strict=True):
        recording = read_recording(path, stated, settings=SETTINGS.ingest, shaft=SHAFT)
        angle = shaft_angle(recording, settings=SHAFT)
        until_s = recording["pulse_time"].values[-1] + recording.attrs.get("start_s", 0.0)
        assert mean_rpm(angle, until_s, 1.0) == pytest.approx(speed_rpm, rel=0.01)
        assert (angle.attrs["phase_reference"], angle.attrs["cycle_known"]) == (reference, cycle_known)


# Measured encoder traces decode to what their sources and the data's own README say.


def test_every_rotor_coast_down_gives_a_smoothly_falling_speed(shared_data, recording_of):
    paths = sorted((shared_data / "rotorbalancer").glob("*stepped*/*.csv"))
    assert len(paths) == 60
    for path in paths[::4]:
        infrared = pd.read_csv(path, comment="#")["ir"].to_numpy()
        found = find_pulses(infrared, rate_hz=952.0, kind="square", edge="rising", pulses_per_rev=1, settings=SHAFT)
        recording = recording_of(found.time_s, pulses_per_rev=1, pulse_noise_s=found.noise_s, rate_hz=952.0)
        angle = shaft_angle(recording, settings=SHAFT)
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
