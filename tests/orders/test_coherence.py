"""Coherence against Goodman's distribution."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.shapes import coherence_level, expected_coherence, unbiased_coherence


def circular(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


@pytest.mark.parametrize("n_frames", [2, 3, 8, 40])
@pytest.mark.parametrize("true", [0.0, 0.3, 0.9])
def test_the_expected_estimate_is_the_mean_over_many_draws(true, n_frames):
    rng = np.random.default_rng(1)
    common, own = circular(rng, n_frames, 40_000), circular(rng, n_frames, 40_000)
    other = np.sqrt(true) * common + np.sqrt(1 - true) * own
    power = (np.abs(common) ** 2).sum(axis=0) * (np.abs(other) ** 2).sum(axis=0)
    estimate = np.abs((other * common.conj()).sum(axis=0)) ** 2 / power
    assert estimate.mean() == pytest.approx(expected_coherence(np.array(true), n_frames=n_frames).item(), abs=0.005)
    if true == 0.0:
        passing = np.mean(estimate > coherence_level(np.array(float(n_frames))))
        assert passing == pytest.approx(0.05, abs=0.005)  # 40,000 draws know it to 0.1 %


def test_taking_off_the_bias_is_the_inverse_of_expecting_it():
    true = np.linspace(0.0, 1.0, 41)
    for n_frames in (2.0, 5.5, 30.0):
        expected = expected_coherence(true, n_frames=n_frames)
        expected[-1] = 1.0
        np.testing.assert_allclose(unbiased_coherence(expected, n_frames=np.array(n_frames)), true, atol=2e-3)
    assert unbiased_coherence(np.array(0.1), n_frames=np.array(5.0)) == 0.0
    assert np.isnan(unbiased_coherence(np.array(1.0), n_frames=np.array(1.0)))
    assert np.isnan(coherence_level(np.array(1.5)))
