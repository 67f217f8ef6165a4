"""Seed streams and levels of the random parts."""

import numpy as np
import pytest
import xarray as xr
from scipy.signal import welch

from crankorder.batch.accuracy import Twin, _floor
from crankorder.synth.analogue import low_pass
from crankorder.synth.noise import (
    density_through_points,
    folded_density,
    padded_length,
    put_coloured_noise,
    seed_stream,
    shaped_noise,
    white_noise,
    white_spectrum,
)
from crankorder.synth.parts import ColouredNoise

RATE_HZ = 8000.0


def density_of(signal: np.ndarray) -> np.ndarray:
    """One-sided amplitude density of frames of 800 samples without overlap: bins of 10 Hz."""
    power = np.abs(np.fft.rfft(signal.reshape(-1, 800))) ** 2
    return np.sqrt(2 * power.mean(axis=0) / (RATE_HZ * 800))


def test_streams_depend_on_every_name_and_on_nothing_else() -> None:
    draws = {
        names: seed_stream(3, *names).random() for names in [("a", "r1"), ("a", "r2"), ("b", "r1"), ("a",), ("r1", "a")]
    }
    assert len(set(draws.values())) == len(draws)
    assert seed_stream(3, "a", "r1").random() == draws["a", "r1"]
    assert seed_stream(4, "a", "r1").random() != draws["a", "r1"]


def test_white_noise_has_the_density_that_was_asked_for() -> None:
    noise = white_noise(seed_stream(1, "x"), 0.25, rate_hz=RATE_HZ, n_samples=1_600_000)
    assert density_of(noise)[1:-1] == pytest.approx(0.25, rel=0.1)
    assert noise.std() == pytest.approx(0.25 * np.sqrt(RATE_HZ / 2), rel=0.003)


def test_noise_behind_a_response_has_its_density() -> None:
    n_samples = 1_600_000
    n_padded = padded_length(n_samples, 4000)
    white = [white_spectrum(seed_stream(2, axis), 2.0, rate_hz=RATE_HZ, n_samples=n_padded) for axis in "XY"]
    frequency = np.arange(n_padded // 2 + 1) * RATE_HZ / n_padded
    response = np.zeros((2, 2, frequency.size), dtype=np.complex64)
    response[0, 0], response[0, 1] = 3j, 1 / (1 + 1j * frequency / 500)
    noise = np.zeros((2, n_samples), dtype=np.float32)
    put_coloured_noise(noise, white, [response])
    bins = np.arange(401) * 10.0
    exact = 2 * np.sqrt(9 + 1 / (1 + (bins / 500) ** 2))
    assert density_of(noise[0])[2:-2] == pytest.approx(exact[2:-2], rel=0.1)
    assert not noise[1].any()


@pytest.mark.slow
def test_shaped_noise_has_the_density_of_its_bins_and_no_mean() -> None:
    n_samples = 1_600_000
    n_padded = padded_length(n_samples, 4000)
    frequency = np.arange(n_padded // 2 + 1) * RATE_HZ / n_padded
    density = 0.3 * (1 + np.sin(frequency / 300.0) ** 2)
    noise = shaped_noise(seed_stream(4, "x"), density, rate_hz=RATE_HZ, n_samples=n_samples)
    assert noise.dtype == np.float32
    bins = np.arange(401) * 10.0
    assert density_of(noise)[2:-2] == pytest.approx(0.3 * (1 + np.sin(bins / 300.0) ** 2)[2:-2], rel=0.1)
    assert abs(noise.mean()) < 0.01 * noise.std()


def test_shaped_noise_with_too_few_bins_is_refused() -> None:
    with pytest.raises(ValueError, match="51 bins make 100 samples"):
        shaped_noise(seed_stream(4, "x"), np.ones(51), rate_hz=RATE_HZ, n_samples=101)


def test_a_density_through_points_is_straight_on_log_scales_and_level_outside() -> None:
    part = ColouredNoise(channels=("Y",), frequency_hz=(1.0, 100.0, 1000.0), m_s2_per_root_hz=(1.0, 0.1, 0.4))
    frequency = np.array([0.0, 0.3, 1.0, 10.0, 25.0, 100.0, np.sqrt(1e5), 1000.0, 5e4])
    exact = [1.0, 1.0, 1.0, 10**-0.5, 0.2, 0.1, 0.2, 0.4, 0.4]
    assert density_through_points(part, frequency) == pytest.approx(exact, rel=1e-12)


def test_images_of_a_shaped_density_add_by_power_above_and_below_the_points() -> None:
    part = ColouredNoise(channels=("Y",), frequency_hz=(50.0, 3e3, 9e4), m_s2_per_root_hz=(2.0, 0.1, 3.0))
    frequency = np.linspace(0.0, RATE_HZ / 2, 17)
    for order in (2, 5):
        folded = folded_density(lambda f: density_through_points(part, f), low_pass(order, 3500.0), RATE_HZ, frequency)
        images = np.abs(frequency[:, None] + RATE_HZ * np.arange(-4000, 4001))
        gain = 1 / (1 + (images / 3500.0) ** (2 * order))
        brute = np.sum(density_through_points(part, images) ** 2 * gain, axis=1)
        assert folded == pytest.approx(np.sqrt(brute), rel=1e-9)


# The synthetic twin of a test: its floor has no line of its own where the test's orders stood.


def test_the_floor_under_an_order_is_that_beside_it() -> None:
    rate, rpm, order = 2048.0, 1300.0, 3.57
    frequency = np.arange(0.0, 800.0, 0.5)
    line = order * rpm / 60.0
    density = 1e-4 * (1.0 + 1e4 * np.exp(-0.5 * ((frequency - line) / 0.4) ** 2))  # a line as Hann's window shows it
    campbell = xr.Dataset(
        {"psd": (("channel", "speed", "frequency"), density[None, None])},
        coords={"speed": [rpm], "frequency": frequency},
    )
    tracks = xr.Dataset(coords={"order": [order]})
    twin = Twin(tracks, campbell, xr.Dataset(), xr.Dataset(), rate, 1, 0.0)
    (signal,) = _floor(twin, rpm, int(400 * rate), np.random.default_rng(1))
    at, found = welch(signal, rate, nperseg=4096)
    under = found[np.abs(at - line) < 1.5].mean()
    beside = found[(np.abs(at - line) > 10.0) & (np.abs(at - line) < 60.0)].mean()
    assert 0.9 < under / beside < 1.1  # it was up to four times as much
