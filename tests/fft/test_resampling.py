"""Values between samples: error against analytic tones, and the kernel's laws."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.fft.resampling import margin, values_at


@pytest.mark.parametrize(("share_of_rate", "largest"), [(0.05, 1e-6), (0.2, 1e-6), (0.4, 2e-6)])
def test_tones_up_to_the_pass_band_are_reproduced(share_of_rate, largest):
    n = np.arange(4000)
    signals = np.stack([np.cos(2 * np.pi * share_of_rate * n + 0.7), np.sin(2 * np.pi * share_of_rate * n)])
    positions = np.random.default_rng(5).uniform(margin(), 4000 - margin() - 1, 3000)
    values = values_at(signals, positions)
    expected = np.stack(
        [np.cos(2 * np.pi * share_of_rate * positions + 0.7), np.sin(2 * np.pi * share_of_rate * positions)]
    )
    assert np.abs(values - expected).max() < largest


def test_a_constant_stays_a_constant():
    values = values_at(np.full((1, 200), 3.0), np.linspace(50, 150, 777))
    np.testing.assert_allclose(values, 3.0, rtol=1e-14)


def test_on_the_samples_the_samples_come_back():
    signals = np.random.default_rng(6).standard_normal((2, 300))
    np.testing.assert_allclose(values_at(signals, np.arange(60.0, 200.0)), signals[:, 60:200], atol=1e-12)


@pytest.mark.parametrize("position", [3.0, 296.0, -1.0])
def test_positions_without_neighbours_are_refused(position):
    with pytest.raises(ValueError, match="positions must lie in"):
        values_at(np.zeros((1, 300)), np.array([position]))
