"""The planned transform against other programs', its laws in both precisions, and the scaling of a tone."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.fft

from crankorder.fft.transforms import FrameTransform, frame_starts, whole_frames
from crankorder.fft.windows import hann, rectangular

PRECISIONS = [(np.float32, 1e-6), (np.float64, 1e-14)]


def test_the_planned_transform_equals_numpys():
    signals = np.random.default_rng(1).standard_normal((2, 400))
    for length, n_fft in ((64, None), (63, None), (50, 128), (2, None)):
        window = hann(length)
        starts = frame_starts(400, length, 37)
        planned = FrameTransform(window, n_fft=n_fft).spectra(signals, starts)
        for frame, start in enumerate(starts):
            expected = np.fft.rfft(signals[:, start : start + length] * window.values, n_fft) * window.tone_scale
            np.testing.assert_allclose(planned[:, frame], expected, atol=1e-13)


@pytest.mark.parametrize(("dtype", "largest"), PRECISIONS)
@pytest.mark.parametrize("length", [1024, 4000, 40_000])
@pytest.mark.parametrize("n_frames", [1, 5, 131])
def test_pyfftw_equals_scipy_in_both_precisions_whatever_the_batch(n_frames, length, dtype, largest):
    signals = np.random.default_rng(1).standard_normal((2, length + 130 * 7)).astype(dtype)
    starts = np.arange(n_frames, dtype=np.int64)[::-1] * 7
    transform = FrameTransform(rectangular(length), n_bins=300)
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


def test_powers_of_two_keep_squares_of_extreme_amplitudes():
    signals = np.random.default_rng(7).standard_normal((2, 600))
    transform, starts = FrameTransform(hann(256)), frame_starts(600, 256, 128)
    plain = transform.power(signals, starts)
    for size in (1e-300, 1e300):
        scale = 2.0 ** -np.floor(np.log2(size))
        made = transform.power(signals * size, starts, scales=np.full(2, scale))
        np.testing.assert_allclose(made, plain * (size * scale) ** 2, rtol=1e-12)


def test_threads_get_the_same_bytes_as_one():
    signals = np.random.default_rng(3).standard_normal((3, 5000))
    starts = frame_starts(5000, 256, 100)

    def spectra(_: int) -> bytes:
        return FrameTransform(hann(256)).spectra(signals, starts).tobytes()

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(spectra, range(16)))) == 1


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
