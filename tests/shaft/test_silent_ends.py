"""Pulses that stop or start late are flagged; a machine that stands still at an end is said to be that or lost."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.shaft.standstill import silent_ends

RATE_HZ, LENGTH_S = 2048.0, 20.0


def remarks(rpm_of, *, first_s: float = 0.0, last_s: float = LENGTH_S, teeth: int = 60):
    """Remarks on a machine of speed ``rpm_of`` (time) whose encoder is silent but from ``first_s`` to ``last_s``."""
    time_s = np.arange(round(LENGTH_S * RATE_HZ)) / RATE_HZ
    rpm = rpm_of(time_s)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rpm[1:] + rpm[:-1]) / 60.0 / RATE_HZ)])
    growing = np.concatenate([[True], np.diff(turned) > 0.0])
    tooth = np.arange(0.25, turned[-1] * teeth) / teeth
    pulse_s = np.interp(tooth, turned[growing], time_s[growing])
    pulse_s = pulse_s[(pulse_s >= first_s) & (pulse_s <= last_s)]
    noise = np.random.default_rng(1).standard_normal((2, time_s.size))
    signal = 0.01 * noise + (rpm / 1000.0) ** 2 * np.cos(2 * np.pi * 2.0 * turned)
    recording = xr.Dataset(
        {"signal": (("channel", "time"), signal), "pulse_time": ("pulse", pulse_s)},
        attrs={"domain": "time", "rate_hz": RATE_HZ},
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


def test_an_encoder_that_dies_is_suspect_and_the_lost_time_is_told() -> None:
    for teeth in [1, 60]:
        for rpm_of in [steady, run_up]:
            ((name, severity, detail),) = remarks(rpm_of, last_s=6.0, teeth=teeth)
            assert (name, severity) == ("no_pulses", "suspect")
            assert "to the end at 20 s" in detail and "encoder lost while the machine ran" in detail and "14" in detail


def test_an_encoder_that_starts_late_is_suspect() -> None:
    ((name, severity, detail),) = remarks(steady, first_s=5.0)
    assert (name, severity) == ("no_pulses", "suspect") and detail.startswith("no pulses from 0 s to 5")


def test_a_machine_that_comes_to_rest_is_no_fault_of_the_encoder_for_certain() -> None:
    for made in (remarks(to_rest), remarks(to_rest, teeth=1)):
        assert all(severity == "info" and "standstill or encoder lost" in detail for _, severity, detail in made)


def test_a_machine_that_starts_from_rest_is_no_fault_of_the_encoder_for_certain() -> None:
    made = remarks(lambda time_s: to_rest(LENGTH_S - time_s))
    assert all(severity == "info" and "standstill or encoder lost" in detail for _, severity, detail in made)


def test_whole_pulse_trains_raise_nothing() -> None:
    for teeth in [1, 60]:
        for rpm_of in [steady, run_up]:
            assert remarks(rpm_of, teeth=teeth) == []
