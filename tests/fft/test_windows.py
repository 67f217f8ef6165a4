"""Laws of the window and its scalings."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.fft.windows import hann


def test_a_hann_window_has_the_noise_bandwidth_of_harris_1978():
    assert hann(1000).enbw_bins == pytest.approx(1.5, rel=1e-12)


def test_half_overlapping_hann_frames_correlate_by_one_sixth():
    # sum w(t) w(t + N/2) / sum w^2 of a Hann window is exactly 1/6, so two frames give 1 + 2 (1 - 1/2) / 6
    assert hann(4096).overlap_variance(2048, 2) == pytest.approx(1.0 + 1.0 / 6.0, rel=1e-6)


def test_frames_that_do_not_overlap_are_independent():
    assert hann(512).overlap_variance(512, 10) == 1.0


def test_overlap_variance_is_that_of_averaged_noise_spectra():
    rng = np.random.default_rng(7)
    window, hop, n_frames = hann(64), 32, 6
    noise = rng.standard_normal((4000, hop * (n_frames - 1) + 64))
    tone = np.exp(-2j * np.pi * 9 * np.arange(noise.shape[1]) / 64)
    spectra = np.stack([(noise * tone)[:, k * hop : k * hop + 64] @ window.values for k in range(n_frames)], axis=1)
    measured = np.var(spectra.mean(axis=1)) / (np.var(spectra[:, 0]) / n_frames)
    assert measured == pytest.approx(window.overlap_variance(hop, n_frames), rel=0.08)
