"""Decimation keeps the band, the time and nothing else."""

import numpy as np
import pytest
import xarray as xr

from crankorder.fft.decimation import (
    SINGLE_SUMS,
    band_limited,
    channel_offsets,
    decimate,
    decimation_error,
    decimation_factor,
    decimation_reach,
    decimation_stages,
)
from made.recordings import line, steady

RATE_HZ, BAND_HZ = 50_000.0, 667.0
FACTOR = decimation_factor(RATE_HZ, BAND_HZ)
ASKED = {"rate_hz": RATE_HZ, "band_hz": BAND_HZ, "factor": FACTOR}


def tone(frequency_hz, n_samples=100_000, rate_hz=RATE_HZ):
    return np.cos(2 * np.pi * frequency_hz * np.arange(n_samples) / rate_hz + 0.3)


@pytest.mark.parametrize(("band_hz", "factor", "tolerance"), [(667.0, 28, 1e-2), (300.0, 60, 1e-6), (9000.0, 2, 1e-9)])
def test_the_predicted_error_is_the_largest_that_tones_show(band_hz, factor, tolerance):
    predicted = decimation_error(RATE_HZ, band_hz, factor, tolerance)
    asked = {"rate_hz": RATE_HZ, "band_hz": band_hz, "factor": factor, "tolerance": tolerance, "offset": np.zeros(1)}
    band = np.linspace(0.02, 1.0, 30) * band_hz
    folding = [k * RATE_HZ / factor + band_hz * x for k in range(1, factor // 2 + 1) for x in (-1.0, -0.93, 0.95)]
    made = []
    for frequency in [*band, *(f for f in folding if f < RATE_HZ / 2)]:
        low, rate_hz, start_s = decimate(tone(frequency, 20_000)[None], **asked)
        time_s = start_s + np.arange(low.shape[1]) / rate_hz
        expected = np.cos(2 * np.pi * frequency * time_s + 0.3) if frequency <= band_hz else 0.0
        made.append(float(np.abs(low[0] - expected).max()))
    assert 0.3 * predicted < max(made) <= predicted * (1 + 1e-3) + 1e-14
    assert predicted <= tolerance


@pytest.mark.parametrize(("factor", "dtype"), [(3, np.float64), (7, np.float32), (28, np.float64)])
def test_a_part_needs_no_more_than_the_samples_within_its_reach(factor, dtype):
    signals = np.random.default_rng(3).standard_normal((2, 100_000)).astype(dtype)
    asked = ASKED | {"factor": factor, "offset": channel_offsets(signals)[0]}
    whole, _, start_s = decimate(signals, **asked)
    reach = decimation_reach(decimation_stages(RATE_HZ, BAND_HZ, factor))
    first, low = round(start_s * RATE_HZ / factor), 500 * factor
    part, _, from_s = decimate(signals[:, low : low + 2 * reach + 700 * factor], **asked)
    begin = 500 + round(from_s * RATE_HZ / factor) - first
    error = np.abs(part - whole[:, begin : begin + part.shape[1]]).max()
    assert error <= (1e-12 if dtype == np.float64 else 2e-7) * np.abs(whole).max()


def test_single_precision_adds_no_more_than_stated():
    single = np.random.default_rng(4).standard_normal((1, 100_000)).astype(np.float32)
    for tolerance, largest in ((1e-6, 2e-7), (0.99 * SINGLE_SUMS, 6.1e-8)):
        double, *_ = decimate(single.astype(np.float64), **ASKED, tolerance=tolerance)
        made, *_ = decimate(single, **ASKED, tolerance=tolerance)
        assert made.dtype == np.float32
        assert np.abs(made - double).max() < largest * np.abs(single).max()


def test_the_smallest_and_the_largest_amplitudes_survive_and_a_constant_far_above_does_not_leak():
    plain, *_ = decimate(tone(100.0)[None], **ASKED)
    for size in (1e-300, 1e300):
        np.testing.assert_allclose(decimate(size * tone(100.0)[None], **ASKED)[0] / size, plain, atol=1e-13)
    for dtype, most in ((np.float32, 3e-7), (np.float64, 1e-8)):
        # a signal that float32 holds exactly on top of the constant
        wave = (np.round(tone(100.0) * 16) / 16).astype(dtype)
        leaked = decimate((wave + dtype(1e6))[None], **ASKED)[0] - decimate(wave[None], **ASKED)[0]
        assert abs(float(np.mean(leaked, dtype=np.float64))) < 1e-12 * 1e6
        assert np.abs(leaked).max() < most


def test_the_kept_rate_carries_the_band_with_room_for_the_kernel_and_its_bins_fall_on_the_grid():
    for rate_hz in (952.0, 2048.0, 2560.0, 5000.0, 44_100.0, 50_000.0, 65_536.0, 71_429.0, 100_000.0):
        for band_hz in (50.0, 120.0, 333.0, 403.0, 667.0, 950.0, 5000.0):
            factor = decimation_factor(rate_hz, band_hz)
            assert factor == 1 or rate_hz / factor >= 2.5 * band_hz, (rate_hz, band_hz)
            steps = rate_hz / decimation_factor(rate_hz, band_hz, grid_hz=0.5) / 0.5
            assert rate_hz == 71_429.0 or steps == pytest.approx(round(steps), abs=1e-9), (rate_hz, band_hz)


def test_nothing_is_decimated_without_need():
    signals = tone(100.0)[None].astype(np.float32) + np.float32(5.0)
    made, rate_hz, start_s = decimate(signals, rate_hz=RATE_HZ, band_hz=24_000.0, factor=1)
    assert (rate_hz, start_s, made.dtype) == (RATE_HZ, 0.0, np.float32)
    assert decimation_error(RATE_HZ, 24_000.0, 1) == 0.0
    np.testing.assert_allclose(made, signals - signals.mean(dtype=np.float64), atol=1e-6)


def test_a_record_shorter_than_the_filter_gives_no_sample():
    low, *_ = decimate(np.ones((1, 20)), rate_hz=RATE_HZ, band_hz=100.0, factor=decimation_factor(RATE_HZ, 100.0))
    assert low.shape == (1, 0)


# The band-limited recording: precision kept, error stated, gaps marked as far as the filters reach.


BAND_RATE_HZ = 20_000.0


def recording(dtype=np.float64):
    signals = [line(3.0, 1.0), line(1.0, 0.1)]
    made = steady(signals, speed_rpm=1200.0, duration_s=4.0, rate_hz=BAND_RATE_HZ)[0]
    made["signal"] = made["signal"].astype(dtype) + dtype(7.0)
    return made


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, 1e-3), (np.float64, 1e-6)])
def test_precision_is_kept_and_the_predicted_error_stated(dtype, tolerance):
    factor = decimation_factor(BAND_RATE_HZ, 500.0, grid_hz=0.5)
    band = band_limited(recording(dtype), band_hz=500.0, grid_hz=0.5, tolerance=tolerance)
    assert band["signal"].dtype == dtype
    assert band.attrs["rate_hz"] == BAND_RATE_HZ / factor
    assert band.attrs["decimation_error"] == decimation_error(BAND_RATE_HZ, 500.0, factor, tolerance) <= tolerance
    assert "usable" not in band
    at = band.attrs["start_s"] + np.arange(band.sizes["time"]) / band.attrs["rate_hz"]
    expected = np.cos(2 * np.pi * 3.0 * (-0.3 + 20.0 * at))
    assert np.abs(band["signal"].values[0] - expected).max() < tolerance + (1e-6 if dtype == np.float32 else 0.0)


def test_a_gap_is_bridged_and_marked_as_far_as_the_filters_reach():
    holed = recording()
    holed["signal"][0, 30_000:30_005] = np.nan
    band, plain = (band_limited(item, band_hz=500.0, grid_hz=0.5) for item in (holed, recording()))
    factor = decimation_factor(BAND_RATE_HZ, 500.0, grid_hz=0.5)
    reach = decimation_reach(decimation_stages(BAND_RATE_HZ, 500.0, factor))
    at = np.round((band.attrs["start_s"] + np.arange(band.sizes["time"]) / band.attrs["rate_hz"]) * BAND_RATE_HZ)
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
    assert at.min() < 30_000 / BAND_RATE_HZ < at.max()
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
