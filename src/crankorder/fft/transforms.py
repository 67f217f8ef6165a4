"""Planned spectra of frames, in the precision of the signals; integrals and derivatives of signals by their spectra."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from crankorder.fft.plans import Plan, fft_library, forward
from crankorder.fft.windows import Window
from crankorder.quantities import Bools, Complexes, Floats, Ints

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
    """First samples (frames,) of whole frames of ``n_frame`` samples, ``hop`` apart, that fit into ``n_samples``."""
    if n_samples < n_frame:
        return np.empty(0, dtype=np.int64)
    return np.arange(0, n_samples - n_frame + 1, max(1, hop), dtype=np.int64)


def counted(mask: Bools, begin: ArrayLike, end: ArrayLike) -> Ints:
    """Number (channels, spans) of samples of ``mask`` (channels, samples) set from ``begin`` to before ``end``.

    ``begin`` and ``end`` (spans,) are cut at the ends of the record.
    """
    spans = np.clip(np.array([begin, end], dtype=np.int64), 0, mask.shape[1])
    # one channel's places at a time: a record may be large
    counts = [np.diff(np.searchsorted(np.flatnonzero(row), spans), axis=0)[0] for row in mask]
    return np.array(counts, dtype=np.int64).reshape(len(mask), spans.shape[1])


def whole_frames(usable: Bools, starts: Ints, n_frame: int) -> Bools:
    """Whether (channels, frames) all samples of each frame of ``n_frame`` samples can be used.

    ``starts`` (frames,) are their first samples, ``usable`` (channels, samples) says which samples can.
    """
    return np.asarray(counted(~usable, starts, starts + n_frame) == 0)


_TOGETHER = 1 << 22
"""Samples that are transformed at once."""

_RING_PERIODS = 8.0
"""Periods of the high-pass over which its answer to a step has died away to a thousandth."""


def band_gain(frequency_hz: Floats, low_hz: float, high_hz: float, *, half_octaves: float) -> Floats:
    """Amplitude gain (bins,), 0 to 1, at rising ``frequency_hz`` (bins,), of a band from ``low_hz`` to ``high_hz``.

    ``high_hz`` may be infinite. Half of the power passes at either end; from ``half_octaves`` inside it all passes,
    from as far outside it nothing (a quarter of a sine over the logarithm of frequency), so that bands that meet share
    the power between them.
    """
    made = np.ones(len(frequency_hz))
    for end_hz, sign in ((low_hz, 1.0), (high_hz, -1.0)):
        if math.isfinite(end_hz) and end_hz > 0.0:
            first, last = np.searchsorted(frequency_hz, [end_hz * 2.0**-half_octaves, end_hz * 2.0**half_octaves])
            octave = np.log2(frequency_hz[first:last] / end_hz)
            made[first:last] *= np.sin(0.25 * np.pi * (1.0 + sign * octave / half_octaves))
            made[: first if sign > 0 else 0] = 0.0
            made[last if sign < 0 else len(made) :] = 0.0
    return made


def derivative_gain(frequency_hz: Floats, times: int) -> Complexes:
    """Gain (bins,) at ``frequency_hz`` (bins,) of differentiating ``times`` times; negative integrates, 0 at 0 Hz."""
    turning = 2j * np.pi * frequency_hz
    gain = np.zeros(len(turning), dtype=np.complex128)
    np.power(turning, times, where=turning != 0.0, out=gain)
    return gain


def integrated(
    signal: NDArray[Any], rate_hz: float, *, times: int, highpass_hz: float, half_octaves: float
) -> NDArray[Any]:
    """``signal`` integrated ``times`` times, without what lies below ``highpass_hz``, of the same type.

    Parameters
    ----------
    signal : (samples,), evenly spaced; NaN stays NaN, and is bridged by a straight line for its neighbours
    rate_hz : samples per second
    times : 1 from acceleration to velocity, 2 to displacement
    highpass_hz : half of the power passes there; below all drift of the integral is taken out
    half_octaves : half the width of the edge of the high-pass, octaves

    The spectrum is divided by (j ω)^``times``. At its ends the signal is faded in and out over ``faded_samples``, so
    that the lines in it do not leak into the low frequencies, which an integral magnifies; what was faded is NaN.
    """
    n, margin = len(signal), math.ceil(_RING_PERIODS * rate_hz / highpass_hz)
    made = np.empty_like(signal)
    for begin in range(0, n, _TOGETHER):
        end = min(n, begin + _TOGETHER)
        first, last = max(0, begin - margin), min(n, end + margin)
        lost = faded_samples(last - first, rate_hz, highpass_hz)
        fade = faded(last - first, lost, lost)
        part = bridged(signal[first:last])
        part = (part - (fade @ part) / fade.sum()) * fade
        count = fft.next_fast_len(len(part) + margin, real=True)
        frequency = np.arange(count // 2 + 1) * (rate_hz / count)
        gain = band_gain(frequency, highpass_hz, math.inf, half_octaves=half_octaves)
        spectrum = fft.rfft(part, count) * (gain * derivative_gain(frequency, -times))
        made[begin:end] = fft.irfft(spectrum, count)[begin - first : end - first]
    made[np.isnan(signal)] = np.nan
    lost = faded_samples(n, rate_hz, highpass_hz)
    made[:lost] = np.nan
    made[n - lost :] = np.nan
    return made


def faded_samples(n_samples: int, rate_hz: float, highpass_hz: float) -> int:
    """Samples at each end over which a signal is faded: a period of ``highpass_hz`` at ``rate_hz`` samples per second.

    In a short recording it is an eighth of its ``n_samples``.
    """
    return min(math.ceil(rate_hz / highpass_hz), n_samples // 8)


def faded(n_samples: int, first: int, last: int) -> Floats:
    """Weights (samples,), 0 to 1, that rise by a squared sine over the ``first`` samples and fall over the ``last``.

    There are ``n_samples`` of them.
    """
    made = np.ones(n_samples)
    for ends, at in ((first, slice(0, first)), (last, slice(n_samples - last, n_samples))):
        rise = np.sin(0.5 * np.pi * (np.arange(ends) + 0.5) / max(ends, 1)) ** 2
        made[at] *= rise if at.start == 0 else rise[::-1]
    return made


def bridged(signal: NDArray[Any]) -> Floats:
    """``signal`` (samples,) in double precision without its mean, straight lines in place of NaN; 0 if all is NaN."""
    made = np.array(signal, dtype=np.float64)
    missing = np.isnan(made)
    if missing.any():
        there = np.flatnonzero(~missing)
        made = np.interp(np.arange(len(made)), there, made[there]) if len(there) else np.zeros(len(made))
    return np.asarray(made - made.mean()) if len(made) else made
