"""The planned transform against numpy's, and the scaling of a tone."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from crankorder.fft.transforms import FrameTransform, frame_starts
from crankorder.fft.windows import hann


@pytest.mark.parametrize(("length", "n_fft"), [(64, None), (63, None), (50, 128), (1, None)])
def test_the_planned_transform_equals_numpys(length, n_fft):
    signals = np.random.default_rng(1).standard_normal((2, 400))
    window = hann(length) if length > 1 else hann(2)
    starts = frame_starts(400, len(window.values), 37)
    planned = FrameTransform(window, n_fft=n_fft).spectra(signals, starts)
    for frame, start in enumerate(starts):
        piece = signals[:, start : start + len(window.values)] * window.values
        expected = np.fft.rfft(piece, n_fft) * window.tone_scale
        np.testing.assert_allclose(planned[:, frame], expected, atol=1e-13)


def test_a_tone_on_a_bin_reads_its_peak_amplitude_and_phase():
    t = np.arange(1000) / 1000
    signal = 0.37 * np.cos(2 * np.pi * 40 * t - 0.9)[None]
    value = FrameTransform(hann(1000)).spectra(signal, np.array([0]))[0, 0, 40]
    assert abs(value) == pytest.approx(0.37, rel=1e-12)
    assert np.angle(value) == pytest.approx(-0.9, abs=1e-12)


def test_parseval_holds_for_every_frame():
    signals = np.random.default_rng(2).standard_normal((1, 512))
    transform = FrameTransform(hann(512))
    spectrum = transform.spectra(signals, np.array([0]))[0, 0] / transform.window.tone_scale
    twice = np.concatenate([[1.0], np.full(255, 2.0), [1.0]])
    energy = np.sum((signals[0] * transform.window.values) ** 2)
    assert np.sum(twice * np.abs(spectrum) ** 2) / 512 == pytest.approx(energy, rel=1e-12)


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


def test_frames_that_do_not_fit_are_left_out():
    assert frame_starts(99, 100, 10).tolist() == []
    assert frame_starts(100, 100, 10).tolist() == [0]
    assert frame_starts(125, 100, 10).tolist() == [0, 10, 20]
