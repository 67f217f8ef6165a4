"""The Vold-Kalman filter where others lose it: close and crossing orders, gaps, long records, far amplitudes."""

import numpy as np
import pytest

from made.recordings import envelopes

RATE_HZ = 5000.0


def lines(amplitude, phase_rev):
    """Sum of lines of constant ``amplitude`` (orders,) along ``phase_rev`` (orders, samples)."""
    turn = np.exp(2j * np.pi * (phase_rev - np.floor(phase_rev)))
    return np.real(amplitude[:, None] * turn).sum(axis=0)


@pytest.mark.slow
def test_two_shafts_within_half_a_percent_cross_and_stay_apart():
    """Around the crossing the data do not tell the two apart, and the standard error says so: it allows for envelopes
    that change unseen meanwhile, while those of this test do not."""
    time_s = np.arange(200_000) / RATE_HZ
    speed = 60.0 + 0.5 * time_s
    first = 60.0 * time_s + 0.25 * time_s**2
    slip = np.cumsum(0.005 * speed * (time_s - 20.0) / 20.0) / RATE_HZ
    phase, truth = np.stack([first, first + slip]), np.array([1.0 + 0.0j, 0.6j])
    clean, _ = envelopes([lines(truth, phase)], phase, rate_hz=RATE_HZ, bandwidth_hz=0.1)
    assert np.abs(clean[0] - truth[:, None]).max() < 1e-10
    noise = 0.2 * np.random.default_rng(1).normal(size=(24, len(time_s)))
    amplitude, error = envelopes(lines(truth, phase) + noise, phase, rate_hz=RATE_HZ, bandwidth_hz=0.1)
    wrong = np.sqrt(np.mean(np.abs(amplitude - truth[:, None]) ** 2, axis=0) / 2.0)
    stated = error.mean(axis=0)
    apart = np.array([30_000, 40_000, 160_000, 170_000])
    assert wrong[:, apart] == pytest.approx(stated[:, apart], rel=0.35)
    assert np.all(stated[:, 100_000] > 1.5 * stated[:, 40_000])
    assert np.all(wrong[:, 100_000] < stated[:, 100_000])


@pytest.mark.slow
def test_a_minute_of_ramps_at_10_krpm_per_second_is_followed():
    rate_hz = 20_000.0
    time_s = np.arange(1_200_000) / rate_hz
    speed_hz = 5.0 + 10_000.0 / 60.0 * np.abs(time_s % 2.0 - 1.0)
    phase = np.cumsum(speed_hz)[None] / rate_hz * np.array([[2.0], [3.0]])
    truth = np.array([1.0 - 0.3j, 0.4 + 0.2j])
    amplitude, _ = envelopes([lines(truth, phase)], phase, rate_hz=rate_hz, bandwidth_hz=4.0)
    assert np.abs(amplitude[0] - truth[:, None]).max() < 1e-10


@pytest.mark.parametrize("bandwidth_hz", [1.0, 80.0])
def test_far_amplitudes_survive_and_a_constant_a_million_times_the_signal_does_not_leak(bandwidth_hz):
    time_s, truth = np.arange(20_000) / RATE_HZ, np.array([0.3 - 1.1j])
    phase = (80.0 * time_s + 3.0 * time_s**2)[None]
    amplitude, _ = envelopes([lines(truth, phase) + 1e6], phase, rate_hz=RATE_HZ, bandwidth_hz=bandwidth_hz)
    assert np.abs(amplitude - truth).max() < 1e-7
    signal = lines(truth, phase) + 0.1 * np.random.default_rng(2).normal(size=len(time_s))
    plain, plain_error = envelopes([signal], phase, rate_hz=RATE_HZ, bandwidth_hz=bandwidth_hz)
    for size in (1e-300, 1e300):
        amplitude, error = envelopes([signal * size], phase, rate_hz=RATE_HZ, bandwidth_hz=bandwidth_hz)
        assert np.abs(amplitude / size - plain).max() < 1e-12
        assert error / size == pytest.approx(plain_error, rel=1e-10)
    amplitude, error = envelopes([0.0 * signal], phase, rate_hz=RATE_HZ, bandwidth_hz=bandwidth_hz)
    assert not amplitude.any() and not error.any()


@pytest.mark.parametrize(("bandwidth_hz", "times"), [(1.0, 1.5), (80.0, 100.0)])
def test_a_gap_is_bridged_and_its_standard_error_grows(bandwidth_hz, times):
    time_s = np.arange(60_000) / RATE_HZ
    phase, truth = (80.0 * time_s + time_s**2)[None], np.array([1.0 + 1.0j])
    signal = np.stack([lines(truth, phase)] * 2) + 1e-3 * np.random.default_rng(3).normal(size=(2, len(time_s)))
    signal[0, 30_000:35_000] = np.nan
    settings = {"rate_hz": RATE_HZ, "bandwidth_hz": bandwidth_hz, "usable": np.isfinite(signal)}
    amplitude, error = envelopes(signal, phase, **settings)
    assert np.isfinite(amplitude).all() and np.isfinite(error).all()
    assert np.abs(amplitude[1] - truth[:, None]).max() < 2e-3
    assert np.abs(amplitude[0, 0, :29_000] - truth).max() < 2e-3
    assert error[0, 0, 32_500] > times * error[0, 0, 20_000]
    assert error[1, 0, 32_500] < 1.5 * error[1, 0, 20_000]


def test_a_line_that_nobody_tracks_is_no_noise():
    time_s = np.arange(60_000) / RATE_HZ
    phase = (80.0 * time_s)[None]
    noise = 0.1 * np.random.default_rng(4).normal(size=(1, len(time_s)))
    _, alone = envelopes(noise, phase, rate_hz=RATE_HZ, bandwidth_hz=1.0)
    _, beside = envelopes(noise + np.cos(2 * np.pi * 82.5 * time_s), phase, rate_hz=RATE_HZ, bandwidth_hz=1.0)
    assert beside.mean() < 1.6 * alone.mean()
