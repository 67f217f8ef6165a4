"""Coherence and cross-spectra against Goodman's distribution and known phases."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.orders.coherence import coherence_level, cross_spectra, expected_coherence, unbiased_coherence
from made.frames import frames_of


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


def test_channels_that_move_together_have_coherence_one_and_their_phase_whatever_the_origin():
    rng = np.random.default_rng(2)
    drive = circular(rng, 12, 5)
    spectrum = np.stack([drive, 2.0 * np.exp(0.7j) * drive, circular(rng, 12, 5)])
    turned = spectrum * np.exp(2j * np.pi * rng.uniform(size=(1, 12, 1)))
    for values in (spectrum, turned):
        made = cross_spectra([frames_of(values, overlap=0.0)], speed_bin_rpm=25.0)
        one = made.sel(channel="B", reference="A")
        np.testing.assert_allclose(one["coherence"].values, 1.0, atol=1e-9)
        np.testing.assert_allclose(np.angle(one["cross_spectrum"].values), 0.7, atol=1e-12)
        expected = 2 * np.exp(0.7j) * (np.abs(drive) ** 2).mean(axis=0)
        np.testing.assert_allclose(one["cross_spectrum"].values[0], expected)
        np.testing.assert_allclose(made.sel(channel="C", reference="C")["coherence"].values, 1.0)
        assert made.sel(channel="C", reference="A")["coherence"].values.mean() < 0.4
    assert made["n_independent"].item() == pytest.approx(12.0)


def test_cross_spectra_are_hermitian():
    made = cross_spectra([frames_of(circular(np.random.default_rng(3), 3, 9, 4))], speed_bin_rpm=25.0)
    cross = made["cross_spectrum"].values
    np.testing.assert_allclose(cross, cross.swapaxes(0, 1).conj(), atol=1e-15)
    np.testing.assert_allclose(made["coherence"].values, made["coherence"].values.swapaxes(0, 1), atol=1e-12)


def test_frames_with_a_gap_in_either_channel_take_no_part():
    spectrum = circular(np.random.default_rng(4), 2, 10, 3)
    gap = spectrum.copy()
    gap[0, 4] = np.nan
    without = np.delete(spectrum, 4, axis=1)
    options = {"speed_bin_rpm": 25.0, "references": ["A"]}
    found, expected = (cross_spectra([frames_of(each, overlap=0.0)], **options) for each in (gap, without))
    for name in ("cross_spectrum", "coherence"):
        np.testing.assert_allclose(found[name].values, expected[name].values, rtol=1e-9, atol=1e-12)


def test_channels_whose_squares_are_no_numbers_still_have_a_coherence():
    spectrum = circular(np.random.default_rng(5), 2, 10, 3)
    plain = cross_spectra([frames_of(spectrum)], speed_bin_rpm=25.0)["coherence"].values
    scaled = spectrum * np.array([1e-300, 1e300])[:, None, None]
    made = cross_spectra([frames_of(scaled)], speed_bin_rpm=25.0)["coherence"].values
    np.testing.assert_allclose(made, plain, rtol=1e-9)


def test_one_frame_has_no_coherence_and_an_unknown_reference_is_refused():
    frames = frames_of(circular(np.random.default_rng(6), 2, 1, 3))
    assert np.isnan(cross_spectra([frames], speed_bin_rpm=25.0)["coherence"].values).all()
    with pytest.raises(RequestError, match="A, B"):
        cross_spectra([frames], speed_bin_rpm=25.0, references=["Q"])
