"""The band-limited recording: precision kept, error stated, gaps marked as far as the filters reach."""

import numpy as np
import pytest
import xarray as xr

from crankorder.fft.decimation import (
    band_limited,
    decimation_error,
    decimation_factor,
    decimation_reach,
    decimation_stages,
)
from made.recordings import line, steady

RATE_HZ = 20_000.0


def recording(dtype: type = np.float64) -> xr.Dataset:
    signals = [line(3.0, 1.0), line(1.0, 0.1)]
    made = steady(signals, speed_rpm=1200.0, duration_s=4.0, rate_hz=RATE_HZ)[0]
    made["signal"] = made["signal"].astype(dtype) + dtype(7.0)
    return made


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_precision_is_kept_and_the_predicted_error_stated(dtype):
    factor = decimation_factor(RATE_HZ, 500.0, grid_hz=0.5)
    for tolerance in (1e-3, 1e-6):
        band = band_limited(recording(dtype), band_hz=500.0, grid_hz=0.5, tolerance=tolerance)
        assert band["signal"].dtype == dtype
        assert band.attrs["rate_hz"] == RATE_HZ / factor
        assert band.attrs["decimation_error"] == decimation_error(RATE_HZ, 500.0, factor, tolerance) <= tolerance
        assert "usable" not in band
        at = band.attrs["start_s"] + np.arange(band.sizes["time"]) / band.attrs["rate_hz"]
        expected = np.cos(2 * np.pi * 3.0 * (-0.3 + 20.0 * at))
        assert np.abs(band["signal"].values[0] - expected).max() < tolerance + (1e-6 if dtype == np.float32 else 0.0)


def test_a_gap_is_bridged_and_marked_as_far_as_the_filters_reach():
    holed = recording()
    holed["signal"][0, 30_000:30_005] = np.nan
    band, plain = (band_limited(item, band_hz=500.0, grid_hz=0.5) for item in (holed, recording()))
    factor = decimation_factor(RATE_HZ, 500.0, grid_hz=0.5)
    reach = decimation_reach(decimation_stages(RATE_HZ, 500.0, factor))
    at = np.round((band.attrs["start_s"] + np.arange(band.sizes["time"]) / band.attrs["rate_hz"]) * RATE_HZ)
    usable = band["usable"].values
    np.testing.assert_array_equal(usable[0], (at + reach < 30_000) | (at - reach > 30_004))
    assert usable[1].all() and np.isfinite(band["signal"].values).all()
    difference = np.abs(band["signal"].values - plain["signal"].values)
    difference -= difference[:, :1]  # the means differ by the samples left out
    assert np.abs(difference[usable]).max() < 1e-12
    assert np.abs(difference[0][~usable[0]]).max() > 1e-6  # and it had to be marked


def test_what_was_not_usable_stays_so_when_the_band_is_limited_again():
    holed = recording()
    holed["signal"][1, 30_000] = np.nan
    once = band_limited(holed, band_hz=2000.0, grid_hz=0.5)
    twice = band_limited(once, band_hz=300.0, grid_hz=0.5)
    assert twice.attrs["rate_hz"] < once.attrs["rate_hz"]
    lost = np.flatnonzero(~twice["usable"].values[1])
    at = twice.attrs["start_s"] + lost / twice.attrs["rate_hz"]
    assert at.min() < 30_000 / RATE_HZ < at.max()
    assert twice["usable"].values[0].all()
    assert twice.attrs["decimation_error"] > once.attrs["decimation_error"]


def test_a_recording_by_crank_angle_loses_only_its_mean():
    made = xr.Dataset(
        {"signal": (("channel", "crank_angle"), np.array([[1.0, 2.0, np.nan, 3.0]]))},
        coords={"channel": ["A"]},
        attrs={"domain": "crank_angle", "samples_per_rev": 4},
    )
    band = band_limited(made, band_hz=500.0, grid_hz=0.5)
    assert band["signal"].values.tolist() == [[-1.0, 0.0, 0.0, 1.0]]
    assert band["usable"].values.tolist() == [[True, True, False, True]]
