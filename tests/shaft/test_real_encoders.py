"""Measured encoder traces decode to what their sources and the data's own README say."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, integrated_speed
from crankorder.shaft.decode import shaft_angle
from crankorder.shaft.pulses import find_pulses

SETTINGS = load_settings().shaft
LOADED = ["full_load.txt", "E0FULLOAD1.txt", "E0FULLOAD2.txt", "E0HALFLOAD1.txt", "E0NOLOAD1.txt", "E10FULLLOAD1.txt"]
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
@pytest.mark.parametrize("name", LOADED)
def test_a_loaded_genset_alternates_every_other_revolution(genset_pickup, recording_of, name):
    angle = genset_angle(genset_pickup(name), recording_of)
    speed = revolution_speed_rpm(angle)
    assert 2870 < speed.mean() < 3190
    alternation = (speed[1:] - speed[:-1]) * (-1.0) ** np.arange(speed.size - 1)
    assert abs(alternation.mean()) > 5 * alternation.std(ddof=1) / np.sqrt(alternation.size)
    raised = {item["flag"] for item in flags_of(angle)}
    assert not raised & {"encoder_missing_pulse", "encoder_double_pulse", "encoder_slip"}
    assert {"encoder_teeth_displaced", "cycle_phase_unknown"} <= raised


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


@pytest.fixture(scope="module")
def auth(shared_data):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.load_workbook(shared_data / "auth_360ppr" / "1200rpm_87Nm.xlsx", read_only=True, data_only=True)
    rows = [row for row in book.worksheets[0].iter_rows(min_row=2, values_only=True) if row[0] is not None]
    table = np.array(rows, dtype=np.float64)
    rate_hz = (len(table) - 1) / np.ptp(table[:, 0])
    pulses, marks = (
        find_pulses(table[:, column], rate_hz=rate_hz, kind="square", edge=edge, pulses_per_rev=360, settings=SETTINGS)
        for column, edge in ((2, "falling"), (3, "rising"))
    )
    return pulses, marks


def test_auth_has_360_pulses_between_top_dead_centres(auth, recording_of):
    pulses, marks = auth
    assert marks.time_s.size == 4
    place = np.interp(marks.time_s, pulses.time_s, np.arange(pulses.time_s.size))
    np.testing.assert_allclose(np.diff(place), 360, atol=0.15)
    angle = shaft_angle(
        recording_of(
            pulses.time_s,
            index_time_s=marks.time_s,
            revs_per_cycle=2,
            pulse_noise_s=pulses.noise_s,
            index_to_tdc_deg=0.0,
        ),
        settings=SETTINGS,
    )
    at_marks = angle_at(marks.time_s, *knots_of(angle))
    np.testing.assert_allclose(at_marks, np.round(at_marks), atol=0.3 / 360)
    speed = 60.0 * 3 / (marks.time_s[-1] - marks.time_s[0])
    assert 1199 < speed < 1201
    raised = {item["flag"] for item in flags_of(angle)}
    assert not raised & {"encoder_missing_pulse", "encoder_double_pulse", "index_lost", "index_extra"}


def test_auth_speed_orders_two_and_four_lead(auth, recording_of):
    pulses, _ = auth
    angle = shaft_angle(recording_of(pulses.time_s, revs_per_cycle=2, pulse_noise_s=pulses.noise_s), settings=SETTINGS)
    time_s, angle_rev, _ = knots_of(angle)
    even = np.linspace(pulses.time_s[0], pulses.time_s[-1], 4001)
    position = angle_at(even, time_s, angle_rev, angle["speed"].values)
    orders = np.arange(1, 13)
    waves = [wave(2 * np.pi * order * position) for order in orders for wave in (np.cos, np.sin)]
    fit, *_ = np.linalg.lstsq(np.column_stack([np.ones(even.size), even, *waves]), position, rcond=None)
    swing = 60.0 * fit[1] * 2 * np.pi * orders * np.hypot(fit[2::2], fit[3::2])
    assert set(orders[np.argsort(swing)[-2:]]) == {2, 4}
    assert swing[1] == pytest.approx(10.8, rel=0.03)
    assert swing[3] == pytest.approx(15.1, rel=0.04)
    assert 1199 < 60.0 * fit[1] < 1200.5


def test_a_measured_speed_track_covers_its_run_up(shared_data):
    with wave.open(str(shared_data / "ansys_accel" / "accel_with_rpm.wav")) as file:
        rate_hz, frames = file.getframerate(), file.readframes(file.getnframes())
    speed = np.frombuffer(frames, dtype="<i2")[1::2] / 32768.0 * 4821.43
    knots, flags = integrated_speed(speed, rate_hz=rate_hz, settings=SETTINGS)
    assert not flags
    assert knots.angle_rev[-1] == pytest.approx(speed.mean() / 60.0 * (speed.size - 1) / rate_hz, rel=1e-5)
    assert (np.diff(knots.angle_rev) > 0).all()
    assert 960 < knots.speed_rpm.min() < 980
    assert knots.speed_rpm.max() == pytest.approx(4821, abs=10)
