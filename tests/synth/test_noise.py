"""Seed streams and levels of the random parts."""

import numpy as np
import pytest

from crankorder.synth.noise import coloured_noise, padded_length, seed_stream, white_noise, white_spectrum

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
    response = np.zeros((2, 3, frequency.size), dtype=np.complex64)
    response[0, 0], response[0, 1] = 3j, 1 / (1 + 1j * frequency / 500)
    noise = coloured_noise([white[0], white[1], None], response, n_padded=n_padded, n_samples=n_samples)
    bins = np.arange(401) * 10.0
    exact = 2 * np.sqrt(9 + 1 / (1 + (bins / 500) ** 2))
    assert density_of(noise[0])[2:-2] == pytest.approx(exact[2:-2], rel=0.1)
    assert not noise[1].any()


def test_the_end_of_a_noise_record_knows_nothing_of_its_beginning() -> None:
    assert padded_length(750_000, 40_000) >= 790_000
    assert padded_length(7, 0) % 2 == 0
