"""Measured encoder traces decode to what their sources and the data's own README say."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pulses import find_pulses

SETTINGS = load_settings().shaft
COASTING = ["ENGINEOFF.txt", "ENGINEOFF2.txt", "E0FULLOAD4EngineOff.txt"]


def genset_pulses(trace):
    return find_pulses(trace, rate_hz=100_000.0, kind="analogue", edge="rising", pulses_per_rev=60, settings=SETTINGS)


def genset_angle(trace, recording_of):
    found = genset_pulses(trace)
    recording = recording_of(
        found.time_s, pulses_per_rev=60, missing_teeth=2, revs_per_cycle=2, pulse_noise_s=found.noise_s
    )
    return shaft_angle(recording, settings=SETTINGS)


def knots_of(angle):
    return angle["time"].values, angle["crank_angle"].values, angle["speed"].values


def revolution_speed_rpm(angle):
    """Mean speed of each whole revolution, rpm."""
    time_s, angle_rev, _ = knots_of(angle)
    whole = np.arange(np.ceil(angle_rev[0]), np.floor(angle_rev[-1]) + 1)
    at = np.interp(whole, angle_rev, time_s)
    return 60.0 / np.diff(at)


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", COASTING)
def test_a_coasting_genset_slows_down_without_a_repair(genset_pickup, recording_of, name):
    angle = genset_angle(genset_pickup(name), recording_of)
    speed = revolution_speed_rpm(angle)
    assert speed[-2:].mean() < 0.95 * speed[:2].mean()
    assert not {"encoder_missing_pulse", "encoder_double_pulse"} & {item["flag"] for item in flags_of(angle)}


@pytest.mark.slow
def test_in_cycle_motion_of_the_genset_is_kept(genset_pickup, recording_of):
    found = genset_pulses(genset_pickup("E0FULLOAD1.txt"))
    angle = genset_angle(genset_pickup("E0FULLOAD1.txt"), recording_of)
    reached = angle_at(found.time_s, *knots_of(angle)) * 60.0
    whole = reached - np.round(reached)
    beside_gap = np.isin(np.round(reached) % 60, (0, 57))
    assert np.abs(whole[~beside_gap]).max() < 0.05


def rotor_files(data: Path) -> list[Path]:
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
        revs = np.ptp(angle_at(found.time_s[[0, -1]], *knots_of(angle)))
        sample_rev = 1.0 / 952.0 / np.diff(found.time_s).min()
        assert revs == pytest.approx(found.time_s.size - 1, abs=sample_rev), path
        assert not {"encoder_missing_pulse", "encoder_double_pulse"} & {item["flag"] for item in flags_of(angle)}


@pytest.mark.slow
def test_every_rotor_group_file_decodes_to_the_speed_of_its_pulses(shared_data, recording_of):
    paths = [path for path in rotor_files(shared_data) if "groups" in str(path)]
    assert len(paths) == 18
    for path in paths:
        angle, found = rotor_angle(path, recording_of)
        speed = angle["speed"].values
        interval_rpm = 60.0 / np.diff(found.time_s)
        mean_rpm = 60.0 * (found.time_s.size - 1) / np.ptp(found.time_s)
        assert 1800 < mean_rpm < 3600
        assert np.median(speed) == pytest.approx(mean_rpm, rel=0.02), path
        inner = speed[2:-2] if speed.size > 8 else speed
        assert 0.97 * interval_rpm.min() < inner.min() < inner.max() < 1.03 * interval_rpm.max(), path
