"""Decimation keeps the band, the time and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.fft.decimation import RIPPLE_DB, decimate, decimation_factor, decimation_stages

RATE_HZ, BAND_HZ = 50_000.0, 667.0


def tone(frequency_hz: float, n_samples: int = 100_000, rate_hz: float = RATE_HZ) -> np.ndarray:
    return np.cos(2 * np.pi * frequency_hz * np.arange(n_samples) / rate_hz + 0.3)


# whole periods in the record, so that taking the mean away takes nothing of the tone
@pytest.mark.parametrize("frequency_hz", [0.5, 20.0, 333.5, 600.0, 666.5])
def test_a_tone_in_the_band_keeps_amplitude_and_time_within_the_stated_ripple(frequency_hz):
    factor = decimation_factor(RATE_HZ, BAND_HZ)
    low, rate_hz, start_s = decimate(tone(frequency_hz)[None], rate_hz=RATE_HZ, band_hz=BAND_HZ, factor=factor)
    expected = np.cos(2 * np.pi * frequency_hz * (start_s + np.arange(low.shape[1]) / rate_hz) + 0.3)
    stages = len(decimation_stages(RATE_HZ, BAND_HZ, factor))
    assert np.abs(low[0] - expected).max() < stages * 10 ** (-RIPPLE_DB / 20)


@pytest.mark.parametrize("offset_hz", [0.0, 100.0, -300.0, 600.0])
@pytest.mark.parametrize("multiple", [1, 2, 5])
def test_what_would_fold_into_the_band_is_stopped(offset_hz, multiple):
    factor = decimation_factor(RATE_HZ, BAND_HZ)
    frequency_hz = multiple * RATE_HZ / factor + offset_hz
    low, *_ = decimate(tone(frequency_hz)[None], rate_hz=RATE_HZ, band_hz=BAND_HZ, factor=factor)
    assert np.abs(low).max() < 5 * 10 ** (-RIPPLE_DB / 20) + 2e-5  # 2e-5: the mean of a tone of broken periods


def test_single_and_double_precision_agree():
    signals = np.random.default_rng(4).standard_normal((2, 30_000))
    factor = decimation_factor(RATE_HZ, BAND_HZ)
    double, *_ = decimate(signals, rate_hz=RATE_HZ, band_hz=BAND_HZ, factor=factor)
    single, *_ = decimate(signals.astype(np.float32), rate_hz=RATE_HZ, band_hz=BAND_HZ, factor=factor)
    assert np.abs(single - double).max() < 2e-6 * np.abs(double).max()


def test_a_large_offset_does_not_spoil_single_precision():
    wave = tone(100.0).astype(np.float32)
    factor = decimation_factor(RATE_HZ, BAND_HZ)
    plain, *_ = decimate(wave[None], rate_hz=RATE_HZ, band_hz=BAND_HZ, factor=factor)
    raised, *_ = decimate((wave + np.float32(100.0))[None], rate_hz=RATE_HZ, band_hz=BAND_HZ, factor=factor)
    assert np.abs(raised - plain).max() < 2e-5  # float32 resolves 100 to 8e-6


@pytest.mark.parametrize("rate_hz", [952.0, 44_100.0, 50_000.0, 51_200.0, 71_429.0, 100_000.0])
def test_the_kept_rate_carries_the_band_with_room_for_the_resampling_kernel(rate_hz):
    for band_hz in (50.0, 333.0, 667.0, 5000.0):
        factor = decimation_factor(rate_hz, band_hz)
        assert factor == 1 or rate_hz / factor >= 2.5 * band_hz


def test_a_record_shorter_than_the_filter_gives_no_sample():
    low, *_ = decimate(np.ones((1, 20)), rate_hz=RATE_HZ, band_hz=100.0, factor=decimation_factor(RATE_HZ, 100.0))
    assert low.shape == (1, 0)
