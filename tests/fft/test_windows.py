"""Laws of the window and its scalings."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.fft.windows import hann


def test_a_hann_window_has_the_noise_bandwidth_of_harris_1978():
    assert hann(1000).enbw_bins == pytest.approx(1.5, rel=1e-12)


def test_half_overlapping_hann_frames_correlate_by_one_sixth():
    # sum w(t) w(t + N/2) / sum w^2 of a Hann window is exactly 1/6, so two frames give 1 + 2 (1 - 1/2) / 6
    assert hann(4096).independent_frames(2048, 2, power=False) == pytest.approx(2 / (1 + 1 / 6), rel=1e-6)


def test_frames_that_do_not_overlap_are_independent():
    assert hann(512).independent_frames(512, 10, power=True) == 10.0


@pytest.mark.parametrize(("power", "hop"), [(False, 32), (True, 32), (False, 16), (True, 16)])
def test_overlapping_frames_are_worth_what_averaged_noise_shows(power, hop):
    rng = np.random.default_rng(7)
    window, n_frames = hann(64), 6
    noise = rng.standard_normal((8000, hop * (n_frames - 1) + 64))
    tone = np.exp(-2j * np.pi * 9 * np.arange(noise.shape[1]) / 64)
    spectra = np.stack([(noise * tone)[:, k * hop : k * hop + 64] @ window.values for k in range(n_frames)], axis=1)
    values = np.abs(spectra) ** 2 if power else spectra
    measured = np.var(values[:, 0]) / np.var(values.mean(axis=1))
    assert window.independent_frames(hop, n_frames, power=power) == pytest.approx(measured, rel=0.06)
