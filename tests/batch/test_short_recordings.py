"""A recording that lost its end is told by the others of its test."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.batch.short_recordings import short_recordings
from crankorder.quantities import ShaftAngle
from crankorder.stages import RecordingResult


def lasting(*lengths_s: float) -> list[RecordingResult]:
    return [
        RecordingResult(
            ShaftAngle(xr.Dataset({"time": ("knot", np.linspace(0.1, 0.1 + length, 50))}, attrs={"recording": f"{k}"})),
            {},
        )
        for k, length in enumerate(lengths_s)
    ]


def test_a2_a_recording_that_is_shorter_than_all_others_is_told() -> None:
    [flag] = short_recordings(lasting(5.0, 5.02, 4.99, 3.1, 5.0, 5.0))
    assert (flag["recording"], flag["flag"], flag["severity"]) == ("3", "shorter_than_others", "info")
    assert "3.1 s" in flag["detail"] and "5 s" in flag["detail"]


def test_lengths_that_differ_anyway_say_nothing() -> None:
    for lengths in ((5.0, 5.0, 3.0), (5.0, 7.0, 3.0, 9.0), (5.0, 5.05, 4.95, 4.9), (0.0,) * 5, ()):
        assert short_recordings(lasting(*lengths)) == [], lengths
