"""Planned spectra of frames: a plan owns its window, its buffers and its axis."""

from __future__ import annotations

import threading
from functools import cached_property

import numpy as np
import pyfftw
from numpy.typing import NDArray

from crankorder.fft.windows import Window

_planner = threading.Lock()
_of_thread = threading.local()


class FrameTransform:
    """Complex spectra, in peak amplitude of a tone, of windowed frames of real signals.

    FFTW plans are made by estimate, never by measurement, so that the same input gives the same bytes; each thread
    keeps its own plan because a plan holds its buffers.
    """

    def __init__(self, window: Window, *, n_fft: int | None = None, n_bins: int | None = None) -> None:
        """Plan for frames of ``len(window.values)`` samples, zero-padded to ``n_fft``, of which ``n_bins`` are kept."""
        self.window = window
        self.n_frame = len(window.values)
        self.n_fft = max(n_fft or self.n_frame, self.n_frame)
        self.n_bins = min(n_bins or self.n_fft // 2 + 1, self.n_fft // 2 + 1)

    @cached_property
    def _scaled_window(self) -> NDArray[np.float64]:
        return self.window.values * self.window.tone_scale

    def _plan(self) -> pyfftw.FFTW:
        plans: dict[int, pyfftw.FFTW] = _of_thread.__dict__.setdefault("plans", {})
        if self.n_fft not in plans:
            source = pyfftw.zeros_aligned(self.n_fft, dtype="float64")
            target = pyfftw.empty_aligned(self.n_fft // 2 + 1, dtype="complex128")
            with _planner:
                plans[self.n_fft] = pyfftw.FFTW(source, target, flags=("FFTW_ESTIMATE",))
        return plans[self.n_fft]

    def spectra(self, signals: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.complex128]:
        """Spectra (channels, frames, n_bins) of the frames that begin at ``starts`` (frames,).

        ``signals`` is (channels, samples) and holds every frame whole; phases are those at each frame's first sample.
        """
        plan = self._plan()
        source, target = plan.input_array, plan.output_array
        source[self.n_frame :] = 0.0
        spectra = np.empty((len(signals), len(starts), self.n_bins), dtype=np.complex128)
        for channel, signal in enumerate(signals):
            for frame, start in enumerate(starts):
                np.multiply(signal[start : start + self.n_frame], self._scaled_window, out=source[: self.n_frame])
                plan.execute()
                spectra[channel, frame] = target[: self.n_bins]
        return spectra


def frame_starts(n_samples: int, n_frame: int, hop: int) -> NDArray[np.int64]:
    """First samples of the whole frames of ``n_frame`` samples, ``hop`` apart, that fit into ``n_samples``."""
    if n_samples < n_frame:
        return np.empty(0, dtype=np.int64)
    return np.arange(0, n_samples - n_frame + 1, max(1, hop), dtype=np.int64)
