"""Laws of the windows and their scalings, and the figures that their authors give."""

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.fft

from crankorder.fft.transforms import FrameTransform, frame_starts, whole_frames
from crankorder.fft.windows import TERMS, hann, window_named


def test_windows_have_the_figures_of_their_authors():
    # Heinzel et al. 2002, section D.3.4 (HFT144D); Harris 1978, table 1
    for name, enbw_bins, scalloping_db, side_lobe_db, first_bin in (
        ("flat-top", 4.5386, 0.0021, -144.1, 7),
        ("blackman-harris", 2.0, 0.83, -92.0, 4),
        ("hann", 1.5, 1.42, -31.5, 2),
        ("rectangular", 1.0, 3.92, -13.2, 1),
    ):
        window = window_named(name, 1024)
        assert window.enbw_bins == pytest.approx(enbw_bins, abs=6e-3 if enbw_bins == 2.0 else 6e-5)
        worst_db = 20 * np.log10(window.response(np.array([0.5]))[0])
        assert -worst_db == pytest.approx(scalloping_db, abs=6e-3 if scalloping_db > 0.01 else 6e-5)
        lobes = window.response(np.arange(first_bin, 20.0, 0.02))
        assert 20 * np.log10(lobes.max()) == pytest.approx(side_lobe_db, abs=0.15)


def test_a_kaiser_window_has_the_side_lobes_and_the_bandwidth_of_its_parameter():
    # main lobe ends at sqrt(pi^2 + beta^2) / pi; side lobes follow as 20 log10(0.217 beta / sinh beta) (Kaiser 1980)
    lobes = window_named("kaiser", 2048).response(np.arange((1.0 + (14.0 / np.pi) ** 2) ** 0.5, 40.0, 0.02))
    assert 20 * np.log10(lobes.max()) == pytest.approx(20 * np.log10(0.217234 * 14.0 / np.sinh(14.0)), abs=0.1)
    bandwidths = [window_named("kaiser", 1024, kaiser_beta=alpha * np.pi).enbw_bins for alpha in (2.0, 2.5, 3.0, 3.5)]
    assert bandwidths == pytest.approx([1.50, 1.65, 1.80, 1.93], abs=6e-3)  # Harris 1978, table 1


def test_a_window_is_periodic_and_finds_an_amplitude():
    for name, n_samples in itertools.product([*TERMS, "kaiser"], [999, 1000]):
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
    assert hann(4096).independent_frames(2048, 2, power=True) == pytest.approx(2 / (1 + 1 / 36), rel=1e-6)
    assert hann(512).independent_frames(512, 10, power=True) == 10.0


# The planned transform against other programs', its laws in both precisions, and the scaling of a tone.


@pytest.mark.parametrize(
    ("dtype", "largest", "length", "n_frames"),
    [(np.float32, 1e-6, 1024, 131), (np.float64, 1e-14, 4000, 5), (np.float64, 1e-14, 40_000, 1)],
)
def test_pyfftw_equals_scipy_in_both_precisions_whatever_the_batch(dtype, largest, length, n_frames):
    signals = np.random.default_rng(1).standard_normal((2, length + 130 * 7)).astype(dtype)
    starts = np.arange(n_frames, dtype=np.int64)[::-1] * 7
    transform = FrameTransform(window_named("rectangular", length), n_bins=300)
    planned = transform.spectra(signals, starts)
    pieces = np.stack([signals[:, start : start + length] for start in starts[:: max(1, n_frames // 3)]], axis=1)
    expected = scipy.fft.rfft(pieces.astype(np.float64))[..., :300] * transform.window.tone_scale
    assert planned.dtype == (np.complex64 if dtype == np.float32 else np.complex128)
    difference = planned[:, :: max(1, n_frames // 3)] - expected
    assert np.abs(difference).max() < largest * np.abs(expected).max()
    power = transform.power(signals, starts)
    assert power.dtype == dtype
    np.testing.assert_allclose(power, np.abs(planned.astype(np.complex128)) ** 2, rtol=10 * largest, atol=1e-12)


def test_channels_do_not_touch_each_other():
    signals = np.random.default_rng(6).standard_normal((3, 5000))
    transform, starts = FrameTransform(hann(256)), frame_starts(5000, 256, 128)
    together = transform.spectra(signals, starts)
    holed = signals.copy()
    holed[1, 2000] = np.nan
    power = transform.power(holed, starts)
    touched = (starts <= 2000) & (starts + 256 > 2000)
    np.testing.assert_array_equal(np.isnan(power).all(axis=2), np.array([[False], [True], [False]]) & touched)
    np.testing.assert_array_equal(transform.spectra(signals[[2, 0, 1]], starts), together[[2, 0, 1]])


def test_threads_get_the_same_bytes_as_one():
    signals, starts = np.random.default_rng(3).standard_normal((3, 5000)), frame_starts(5000, 256, 100)
    with ThreadPoolExecutor(4) as pool:
        made = list(pool.map(lambda _: FrameTransform(hann(256)).spectra(signals, starts).tobytes(), range(16)))
    assert len(set(made)) == 1


def test_a_padded_plan_forgets_the_frames_of_a_longer_one():
    signals = np.ones((1, 300))
    FrameTransform(hann(128)).spectra(signals, np.array([0]))
    short = FrameTransform(hann(50), n_fft=128)
    expected = np.fft.rfft(hann(50).values * short.window.tone_scale, 128)
    np.testing.assert_allclose(short.spectra(signals, np.array([3]))[0, 0], expected, atol=1e-13)


def test_frames_that_do_not_fit_are_left_out_or_refused():
    assert frame_starts(99, 100, 10).tolist() == []
    assert frame_starts(100, 100, 10).tolist() == [0]
    assert frame_starts(125, 100, 10).tolist() == [0, 10, 20]
    assert FrameTransform(hann(100)).spectra(np.zeros((2, 50)), np.empty(0, dtype=np.int64)).shape == (2, 0, 51)
    for start in (-1, 201):
        with pytest.raises(ValueError, match="frames must lie within the 300 samples"):
            FrameTransform(hann(100)).spectra(np.zeros((1, 300)), np.array([start]))


def test_a_frame_is_whole_where_every_sample_of_it_is_usable():
    usable = np.ones((2, 50), dtype=np.bool_)
    usable[1, [20, 29]] = False
    starts = np.array([0, 10, 11, 20, 29, 30])
    assert whole_frames(usable, starts, 10).tolist() == [[True] * 6, [True, True, False, False, False, True]]
