"""Planned spectra of frames: many frames at a time, in the precision of the signals."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.fft.plans import Plan, fft_library, forward
from crankorder.fft.windows import Window
from crankorder.quantities import Bools, Floats, Ints

BATCH_BYTES = 262_144
"""Size of the frames transformed at a time: they and their spectra stay in the second-level cache."""

MOST_FRAMES = 64
"""Frames transformed at a time at most: more gain nothing."""

MOST_PLANS = 24
"""Plans that a thread keeps; the one not used for longest goes first."""

_planner = threading.Lock()
_of_thread = threading.local()


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _fill(signals, starts, window, scales, first, frames):  # type: ignore[no-untyped-def]
    """Windowed ``frames`` (frame, sample) from number ``first`` on, counted channel by channel."""
    for row in range(frames.shape[0]):
        channel = (first + row) // starts.size
        piece = signals[channel, starts[first + row - channel * starts.size] :]
        into, scale = frames[row], scales[channel]
        for k in range(window.size):
            into[k] = (piece[k] * scale) * window[k]


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _squares(parts, out):  # type: ignore[no-untyped-def]
    """Squared magnitudes ``out`` (frame, bin) of spectra given as ``parts`` (frame, real and imaginary in turn)."""
    for row in range(out.shape[0]):
        part, into = parts[row], out[row]
        for k in range(out.shape[1]):
            into[k] = part[2 * k] * part[2 * k] + part[2 * k + 1] * part[2 * k + 1]


class FrameTransform:
    """Spectra, in peak amplitude of a tone, of windowed frames of real signals in float32 or float64.

    Plans are made by estimate, never by measurement, so that the same input gives the same bytes; each thread
    keeps its own plans because a plan holds its buffers.
    """

    def __init__(self, window: Window, *, n_fft: int | None = None, n_bins: int | None = None) -> None:
        """Plan for frames of ``len(window.values)`` samples, zero-padded to ``n_fft``, of which ``n_bins`` are kept."""
        self.window = window
        self.n_frame = len(window.values)
        self._scaled_window = window.values * window.tone_scale
        self.n_fft = max(n_fft or self.n_frame, self.n_frame)
        self.n_bins = min(n_bins or self.n_fft // 2 + 1, self.n_fft // 2 + 1)

    def spectra(self, signals: NDArray[np.floating], starts: Ints) -> NDArray[np.complexfloating]:
        """Spectra (channels, frames, n_bins) of the frames that begin at ``starts`` (frames,).

        ``signals`` is (channels, samples) and holds every frame whole; phases are those at each frame's first sample.
        float32 signals give complex64, all others complex128.
        """
        signals = _real(signals)
        kind = np.complex64 if signals.dtype == np.float32 else np.complex128
        rows = np.empty((len(signals) * len(starts), self.n_bins), dtype=kind)
        for first, count, spectrum in self._batches(signals, starts, np.ones(len(signals))):
            rows[first : first + count] = spectrum[:count, : self.n_bins]
        return rows.reshape(len(signals), len(starts), self.n_bins)

    def power(
        self, signals: NDArray[np.floating], starts: Ints, *, scales: Floats | None = None
    ) -> NDArray[np.floating]:
        """Squared peak amplitudes (channels, frames, n_bins) of the frames that begin at ``starts`` (frames,).

        ``signals`` is (channels, samples), each channel taken times its ``scales`` (channels,) first: powers of two
        keep the squares of very large and very small amplitudes in range. float32 signals give float32.
        """
        signals = _real(signals)
        rows = np.empty((len(signals) * len(starts), self.n_bins), dtype=signals.dtype)
        scales = np.ones(len(signals)) if scales is None else scales
        for first, count, spectrum in self._batches(signals, starts, scales):
            _squares(spectrum.view(rows.dtype), rows[first : first + count])
        return rows.reshape(len(signals), len(starts), self.n_bins)

    def _batches(self, signals: NDArray[np.floating], starts: Ints, scales: Floats) -> Any:
        """First number, count and spectra of one batch of frames after the other, counted channel by channel."""
        if len(starts) and (starts.min() < 0 or starts.max() + self.n_frame > signals.shape[1]):
            raise ValueError(f"frames must lie within the {signals.shape[1]} samples")
        total = len(signals) * len(starts)
        plan = self._plan(total, signals.dtype)
        frames, spectra = plan.input_array, plan.output_array
        frames[:, self.n_frame :] = 0.0
        window = self._scaled_window.astype(signals.dtype)
        starts, scales = np.ascontiguousarray(starts, dtype=np.int64), scales.astype(signals.dtype)
        for first in range(0, total, len(frames)):
            count = min(len(frames), total - first)
            _fill(signals, starts, window, scales, first, frames[:count])
            plan.execute()
            yield first, count, spectra

    def _plan(self, n_frames: int, dtype: np.dtype[Any]) -> Plan:
        """Plan of this thread for as many frames at a time as fit the cache, and no more than ``n_frames`` need."""
        fit = max(1, min(MOST_FRAMES, BATCH_BYTES // (dtype.itemsize * self.n_fft)))
        batch = min(1 << (fit.bit_length() - 1), 1 << max(0, n_frames - 1).bit_length())
        plans: OrderedDict[Any, Plan] = _of_thread.__dict__.setdefault("plans", OrderedDict())
        key = (self.n_fft, batch, dtype.char, fft_library())
        if key not in plans:
            with _planner:
                plans[key] = forward((batch, self.n_fft), dtype)
            if len(plans) > MOST_PLANS:
                plans.popitem(last=False)
        plans.move_to_end(key)
        return plans[key]


def _real(signals: NDArray[np.floating]) -> NDArray[np.floating]:
    """``signals`` as contiguous float32 or float64."""
    return np.ascontiguousarray(signals, dtype=np.float32 if signals.dtype == np.float32 else np.float64)


def frame_starts(n_samples: int, n_frame: int, hop: int) -> Ints:
    """First samples of the whole frames of ``n_frame`` samples, ``hop`` apart, that fit into ``n_samples``."""
    if n_samples < n_frame:
        return np.empty(0, dtype=np.int64)
    return np.arange(0, n_samples - n_frame + 1, max(1, hop), dtype=np.int64)


def counted(mask: Bools, begin: ArrayLike, end: ArrayLike) -> Ints:
    """How many samples (channels, spans) of ``mask`` (channels, samples) are set from ``begin`` to before ``end``.

    ``begin`` and ``end`` (spans,) are cut at the ends of the record.
    """
    spans = np.clip(np.array([begin, end], dtype=np.int64), 0, mask.shape[1])
    # one channel's places at a time: a record may be large
    counts = [np.diff(np.searchsorted(np.flatnonzero(row), spans), axis=0)[0] for row in mask]
    return np.array(counts, dtype=np.int64).reshape(len(mask), spans.shape[1])


def whole_frames(usable: Bools, starts: Ints, n_frame: int) -> Bools:
    """Whether all samples of each frame can be used (channels, frames): the frames of ``n_frame`` from ``starts`` on.

    ``usable`` (channels, samples) says which samples can.
    """
    return np.asarray(counted(~usable, starts, starts + n_frame) == 0)
