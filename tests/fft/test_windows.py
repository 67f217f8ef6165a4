"""Laws of the windows and their scalings, and the figures that their authors give."""

import itertools

import numpy as np
import pytest

from crankorder.fft.windows import (
    NAMES,
    blackman_harris,
    flat_top,
    hann,
    kaiser,
    power_of_two,
    rectangular,
    window_named,
)


def test_windows_have_the_figures_of_their_authors():
    # Heinzel et al. 2002, section D.3.4 (HFT144D); Harris 1978, table 1
    for window, enbw_bins, scalloping_db, side_lobe_db, first_bin in (
        (flat_top(1024), 4.5386, 0.0021, -144.1, 7),
        (blackman_harris(1024), 2.0, 0.83, -92.0, 4),
        (hann(1024), 1.5, 1.42, -31.5, 2),
        (rectangular(1024), 1.0, 3.92, -13.2, 1),
    ):
        assert window.enbw_bins == pytest.approx(enbw_bins, abs=6e-3 if enbw_bins == 2.0 else 6e-5)
        worst_db = 20 * np.log10(window.response(np.array([0.5]))[0])
        assert -worst_db == pytest.approx(scalloping_db, abs=6e-3 if scalloping_db > 0.01 else 6e-5)
        lobes = window.response(np.arange(first_bin, 60.0, 0.02))
        assert 20 * np.log10(lobes.max()) == pytest.approx(side_lobe_db, abs=0.15)


def test_a_kaiser_window_has_the_side_lobes_and_the_bandwidth_of_its_parameter():
    # main lobe ends at sqrt(pi^2 + beta^2) / pi; side lobes follow as 20 log10(0.217 beta / sinh beta) (Kaiser 1980)
    lobes = kaiser(2048, 14.0).response(np.arange((1.0 + (14.0 / np.pi) ** 2) ** 0.5, 40.0, 0.02))
    assert 20 * np.log10(lobes.max()) == pytest.approx(20 * np.log10(0.217234 * 14.0 / np.sinh(14.0)), abs=0.1)
    bandwidths = [kaiser(1024, alpha * np.pi).enbw_bins for alpha in (2.0, 2.5, 3.0, 3.5)]
    assert bandwidths == pytest.approx([1.50, 1.65, 1.80, 1.93], abs=6e-3)  # Harris 1978, table 1


def test_a_window_is_periodic_and_finds_an_amplitude():
    for name, n_samples in itertools.product(NAMES, [999, 1000]):
        window = window_named(name, n_samples)
        assert window.name == name
        np.testing.assert_allclose(window.values[1:], window.values[1:][::-1], atol=1e-12, err_msg=name)
        wave = 0.7 * np.cos(2 * np.pi * 100 * np.arange(n_samples) / n_samples + 1.0)
        magnitude = np.abs(np.fft.rfft(wave * window.values)[100])
        assert magnitude * window.tone_scale == pytest.approx(0.7, rel=1e-6), name


@pytest.mark.cases(2)
@pytest.mark.parametrize(
    ("name", "largest_db"), [("hann", 0.0075), ("flat-top", 0.0022), ("blackman-harris", 0.005), ("kaiser", 0.005)]
)
def test_the_weights_make_a_tone_read_right_wherever_it_lies(name, largest_db):
    window = window_named(name, 512)
    own, side = window.tone_weights
    assert (side == 0.0) == (name == "flat-top")
    error = []
    for offset in np.linspace(-0.5, 0.5, 101):
        wave = np.exp(2j * np.pi * (100 + offset) * np.arange(512) / 512)
        power = np.abs(np.fft.fft(wave * window.values) / window.values.sum()) ** 2
        error.append(10 * np.log10(own * power[100] + side * (power[99] + power[101])))
    assert np.abs(error).max() < largest_db


def test_another_name_is_refused():
    with pytest.raises(ValueError, match="no window is called 'hamming'"):
        window_named("hamming", 10)


def test_half_overlapping_hann_frames_correlate_by_one_sixth():
    # sum w(t) w(t + N/2) / sum w^2 of a Hann window is exactly 1/6, so two frames give 1 + 2 (1 - 1/2) / 6
    assert hann(4096).independent_frames(2048, 2, power=False) == pytest.approx(2 / (1 + 1 / 6), rel=1e-6)
    assert hann(512).independent_frames(512, 10, power=True) == 10.0


@pytest.mark.slow
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


def test_each_channel_comes_to_between_a_half_and_one_and_back_to_the_bit():
    for kind in (float, complex):
        for size in (1e-300, 1.0, 3.0, 1e300):
            values = size * np.array([[0.1, -0.9, np.nan], [0.3, 0.2, 0.7]]).astype(kind)
            scale = power_of_two(values)
            assert scale.shape == (2, 1)
            largest = np.nanmax(np.abs(values / scale), axis=1)
            assert ((largest >= 0.5) & (largest < 1.0)).all()
            np.testing.assert_array_equal(values / scale * scale, values)
        np.testing.assert_array_equal(power_of_two(np.array([[0.0, 0.0], [np.nan, np.nan]])), [[2.0], [2.0]])
