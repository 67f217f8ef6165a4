"""A test that stops and starts again: both runs stand on one angle."""

from itertools import product

import numpy as np
import pytest
import xarray as xr

from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, angle_knots
from crankorder.shaft.decode import ShaftRun, joined, shaft_angle
from crankorder.shaft.repair import running_parts, silent_ends
from made.command import analysed
from made.recordings import write_hdf5, write_manifest


def test_the_angle_goes_on_rightly_after_a_standstill():
    for teeth, still_s in [(60, 0.5), (360, 1.5), (120, 0.8)]:
        rate, top_s = 5.0, 3.0  # rev/s^2 down to rest and up again
        turned = 0.5 * rate * top_s**2
        tooth = np.arange(int(2 * turned * teeth) + 1)
        angle = (tooth + 0.3) / teeth
        angle, tooth = angle[angle < 2 * turned], tooth[angle < 2 * turned]
        down = top_s - np.sqrt(2.0 * np.maximum(turned - angle, 0.0) / rate)
        up = top_s + still_s + np.sqrt(2.0 * np.maximum(angle - turned, 0.0) / rate)
        time_s = np.where(angle < turned, down, up)
        parts, flags = running_parts(time_s, pulses_per_rev=teeth, joined=True)
        assert len(parts) == 2
        assert "standstill" in {flag for flag, _, _ in flags}
        settings = load_settings().shaft
        runs = []
        for part in parts:
            own = time_s[part]
            knots = angle_knots(own, np.arange(own.size), teeth_per_rev=teeth, noise_s=None, settings=settings)
            runs.append(ShaftRun(knots, (float(own[0]), float(own[-1])), part.start, part.stop - 1, 0.0))
        both = joined(runs, float(teeth))
        assert (np.diff(both.time_s) > 0.0).all()
        assert (np.diff(both.angle_rev) > 0.0).all()
        found = angle_at(time_s, both.time_s, both.angle_rev, both.speed_rpm)
        fast = np.abs(angle - turned) > 1.0
        assert np.abs(found - tooth / teeth)[fast].max() < 0.3 / teeth


def test_a_stop_after_a_few_pulses_of_one_per_revolution_is_one():
    # four pulses slow down into the stop, thirteen speed up out of it, no interval as long as a standing shaft's
    step = [0.139, 0.181, 0.375, 0.903, 0.184, 0.141, 0.118, 0.104, 0.094, 0.087, 0.081, 0.076, 0.072, 0.068, 0.065]
    time_s = np.cumsum([0.05, *step, 0.062])
    parts, flags = running_parts(time_s, pulses_per_rev=1, joined=True)
    assert [(part.start, part.stop) for part in parts] == [(4, 17)]
    assert {name for name, _, _ in flags} == {"standstill", "encoder_part_unused"}


RATE_HZ = 4000


def course(*legs):
    """Speed [rpm] and angle [rev] of samples whose speed ``legs`` join straight: seconds, speed at the end."""
    ends_s, speeds = np.cumsum([seconds for seconds, _ in legs]), [speed for _, speed in legs]
    speed = np.interp(np.arange(int(ends_s[-1] * RATE_HZ)) / RATE_HZ, ends_s, speeds)
    return speed, np.cumsum(speed) / 60.0 / RATE_HZ


def written(folder, kind, speed, angle):
    """A folder with 2 and 1 of orders 1 and 4 while the shaft turns, noise, and a shaft told by ``kind``."""
    turns = 2.0 * np.cos(2 * np.pi * angle) + np.cos(8 * np.pi * angle)
    random = np.random.default_rng(1)
    encoder = {"speed": {"source": "speed"}, "pulse_times": {"source": "pulses", "pulses_per_rev": 60}}[kind]
    rising = np.flatnonzero(np.diff(angle, prepend=-1.0) > 0.0)
    tooth = np.arange(1, int(angle[-1] * 60)) / 60.0
    columns = {
        "a": turns * (speed > 0.0) + 0.05 * random.standard_normal(speed.size),
        "speed": speed + 0.5 * random.standard_normal(speed.size),
        "pulses": np.interp(tooth, angle[rising], rising / RATE_HZ),
    }
    write_manifest(folder, "*.h5", name="t", channels={"A": {"source": "a"}}, encoder=encoder | {"kind": kind})
    write_hdf5(folder / "a.h5", columns, unit={"speed": "rpm"}, rate_hz=RATE_HZ)
    return folder


@pytest.mark.parametrize("kind", ["speed", "pulse_times"])
def test_a_stop_between_two_runs_leaves_the_amplitudes_right(tmp_path, kind):
    told = course((0.0, 1500.0), (3.0, 1600.0), (1.0, 0.0), (3.0, 0.0), (1.0, 1500.0), (3.0, 1700.0))
    found = analysed(written(tmp_path / "in", kind, *told), tmp_path / "out", "--no-pictures")
    assert "standstill" in {one["flag"] for one in found["quality"]}
    amplitudes = {round(one["order"], 2): one["amplitude"] for one in found["orders"]}
    off = {"speed": 0.04, "pulse_times": 0.02}[kind]  # a speed is smoothed, and blurs where it stops
    assert amplitudes == {1.0: pytest.approx(2.0, rel=off), 4.0: pytest.approx(1.0, rel=off)}


def test_a_slow_stop_whose_rows_hold_no_order_at_one_speed_is_analysed(tmp_path):
    told = course((0.0, 162.0), (1.0, 162.0), (3.0, 0.0), (0.05, 0.0))
    found = analysed(written(tmp_path / "in", "pulse_times", *told), tmp_path / "out", "--no-pictures")
    assert found["orders"]


def test_a_speed_that_stands_is_left_out_of_the_angle(recording_of):
    speed, angle = course((0.0, 0.0), (3.0, 0.0), (0.05, 600.0), (0.5, 600.0), (0.05, 0.0), (2.0, 0.0))
    recording = recording_of(np.empty(0), encoder_kind="speed", rate_hz=float(RATE_HZ)).drop_vars("signal")
    recording["speed_signal"] = ("time", speed)
    shaft = shaft_angle(recording, settings=load_settings().shaft)
    assert "standstill" in {flag["flag"] for flag in flags_of(shaft)}
    assert shaft["time"].values[0] >= 3.0
    assert shaft["time"].values[-1] < 3.7
    assert np.ptp(shaft["crank_angle"].values) == pytest.approx(angle[-1], abs=0.3)


def test_a_hole_of_more_than_a_few_pulses_at_one_speed_is_not_filled():
    time_s = np.concatenate([np.arange(0.0, 3.0, 0.04), np.arange(6.0, 9.5, 0.04)])
    parts, flags = running_parts(time_s, pulses_per_rev=1, joined=True)
    assert [(part.start, part.stop) for part in parts] == [(75, time_s.size)]
    assert "encoder_gap" in {name for name, _, _ in flags}


# Pulses that stop or start late are flagged; a machine that stands still at an end is said to be that or lost.


RATE_HZ_SILENT, LENGTH_S = 2048.0, 20.0


def remarks(rpm_of, *, first_s=0.0, last_s=LENGTH_S, teeth=60):
    """Remarks on a machine of speed ``rpm_of`` (time) whose encoder is silent but from ``first_s`` to ``last_s``."""
    time_s = np.arange(round(LENGTH_S * RATE_HZ_SILENT)) / RATE_HZ_SILENT
    rpm = rpm_of(time_s)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rpm[1:] + rpm[:-1]) / 60.0 / RATE_HZ_SILENT)])
    growing = np.concatenate([[True], np.diff(turned) > 0.0])
    tooth = np.arange(0.25, turned[-1] * teeth) / teeth
    pulse_s = np.interp(tooth, turned[growing], time_s[growing])
    pulse_s = pulse_s[(pulse_s >= first_s) & (pulse_s <= last_s)]
    noise = np.random.default_rng(1).standard_normal((2, time_s.size))
    signal = 0.01 * noise + (rpm / 1000.0) ** 2 * np.cos(2 * np.pi * 2.0 * turned)
    recording = xr.Dataset(
        {"signal": (("channel", "time"), signal), "pulse_time": ("pulse", pulse_s)},
        attrs={"domain": "time", "rate_hz": RATE_HZ_SILENT},
    )
    known = (time_s >= pulse_s[0]) & (time_s <= pulse_s[-1])
    shaft = xr.Dataset({"speed": ("knot", rpm[known][::16])}, coords={"time": ("knot", time_s[known][::16])})
    return silent_ends(recording, shaft)


def steady(time_s):
    return 1500.0 * (1.0 + 0.001 * np.sin(0.7 * time_s))


def run_up(time_s):
    return 800.0 + 90.0 * time_s


def to_rest(time_s):
    return np.maximum(1800.0 - 150.0 * time_s, 0.0)


def test_an_encoder_that_dies_or_starts_late_is_suspect_and_the_lost_time_is_told():
    for teeth, rpm_of in product([1, 60], [steady, run_up]):
        ((name, severity, detail),) = remarks(rpm_of, last_s=6.0, teeth=teeth)
        assert (name, severity) == ("no_pulses", "suspect")
        assert "to the end at 20 s" in detail and "encoder lost while the machine ran" in detail and "14" in detail
        assert remarks(rpm_of, teeth=teeth) == []
    ((name, severity, detail),) = remarks(steady, first_s=5.0)
    assert (name, severity) == ("no_pulses", "suspect") and detail.startswith("no pulses from 0 s to 5")


def test_a_machine_that_comes_to_rest_or_starts_from_it_is_no_fault_of_the_encoder_for_certain():
    from_rest = remarks(lambda time_s: to_rest(LENGTH_S - time_s))
    for made in (remarks(to_rest), remarks(to_rest, teeth=1), from_rest):
        assert all(severity == "info" and "standstill or encoder lost" in detail for _, severity, detail in made)
