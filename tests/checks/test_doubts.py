"""What recordings beside each other tell to doubt."""

import numpy as np
import pytest

from crankorder.checks.doubts import scaled_speeds, short_recordings
from crankorder.identify.findings import speed_doubt


def lasting(*lengths_s):
    return {f"{number}": length for number, length in enumerate(lengths_s)}


def test_a2_a_recording_that_is_shorter_than_all_others_is_told():
    [flag] = short_recordings(lasting(5.0, 5.02, 4.99, 3.1, 5.0, 5.0))
    assert (flag["recording"], flag["flag"], flag["severity"]) == ("3", "shorter_than_others", "info")
    assert "3.1 s" in flag["detail"] and "5 s" in flag["detail"]


def test_lengths_that_differ_anyway_say_nothing():
    for lengths in ((5.0, 5.0, 3.0), (5.0, 7.0, 3.0, 9.0), (5.0, 5.05, 4.95, 4.9), (0.0,) * 5, ()):
        assert short_recordings(lasting(*lengths)) == [], lengths


def test_one_factor_between_all_speeds_and_their_names_is_a_doubt_about_the_test_and_one_odd_name_is_none():
    for seed in range(50):
        rng = np.random.default_rng(seed)
        named_rpm = np.sort(rng.choice(np.arange(300, 6001, 50), rng.integers(2, 12), replace=False))
        off = rng.choice([60 / 50, 50 / 60, 0.5, 2.0, 1.0 / rng.uniform(1.15, 3.0), rng.uniform(1.15, 3.0)])
        for factor, odd in ((off, 1.0), (1.0, 1.0), (1.0, off), (rng.uniform(0.92, 1.08), 1.0)):
            found_rpm = named_rpm * factor * rng.uniform(0.996, 1.004, named_rpm.size)
            found_rpm[0] *= odd
            ends = {f"run {at} rpm.h5": (rpm, 1.004 * rpm) for at, rpm in zip(named_rpm, found_rpm, strict=True)}
            flags = scaled_speeds(ends | {"n77.h5": (990.0, 1000.0), "sweep 900 rpm.h5": (300.0, 900.0)})
            assert [flag["recording"] for flag in flags] == (list(ends) if factor == off else []), (seed, factor, odd)
            said = [float(flag["detail"].split(" turn at ")[1].split()[0]) for flag in flags if speed_doubt([flag])]
            assert said == [pytest.approx(off, rel=0.01)] * len(flags)
            assert scaled_speeds(dict(list(ends.items())[:1])) == []
