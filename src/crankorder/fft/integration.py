"""Integrals and derivatives of signals in a band, by multiplying their spectra: no phase, edges stated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from crankorder.quantities import Complexes, Floats

_BLOCK = 1 << 22
"""Samples that are transformed at once."""

_RING_PERIODS = 8.0
"""Periods of the high-pass over which its answer to a step has died away to a thousandth."""


def band_gain(frequency_hz: Floats, low_hz: float, high_hz: float, *, half_octaves: float) -> Floats:
    """Amplitude gain (n,), at rising ``frequency_hz``, of a band from ``low_hz`` to ``high_hz`` (may be infinite).

    Half of the power passes at either end; from ``half_octaves`` inside it all passes, from as far outside it nothing
    (a quarter of a sine over the logarithm of frequency), so that bands that meet share the power between them.
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
    """Gain (n,) at each of ``frequency_hz`` of differentiating ``times`` times; negative integrates, 0 at 0 Hz."""
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
    half_octaves : half the width of the edge of the high-pass

    The spectrum is divided by (j ω)^``times``. At its ends the signal is faded in and out over ``faded_samples``, so
    that the lines in it do not leak into the low frequencies, which an integral magnifies; what was faded is NaN.
    """
    n, margin = len(signal), math.ceil(_RING_PERIODS * rate_hz / highpass_hz)
    made = np.empty_like(signal)
    for begin in range(0, n, _BLOCK):
        end = min(n, begin + _BLOCK)
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
    """Samples at each end over which a signal is faded: a period of ``highpass_hz`` at ``rate_hz``.

    Of a short recording an eighth of its ``n_samples``.
    """
    return min(math.ceil(rate_hz / highpass_hz), n_samples // 8)


def faded(n_samples: int, first: int, last: int) -> Floats:
    """Weights (``n_samples``,) that rise by a squared sine over the ``first`` samples and fall over the ``last``."""
    made = np.ones(n_samples)
    for ends, at in ((first, slice(0, first)), (last, slice(n_samples - last, n_samples))):
        rise = np.sin(0.5 * np.pi * (np.arange(ends) + 0.5) / max(ends, 1)) ** 2
        made[at] *= rise if at.start == 0 else rise[::-1]
    return made


def bridged(signal: NDArray[Any]) -> Floats:
    """``signal`` (n,) in double precision without its mean, with straight lines where it is NaN; 0 where it all is."""
    made = np.array(signal, dtype=np.float64)
    missing = np.isnan(made)
    if missing.any():
        there = np.flatnonzero(~missing)
        made = np.interp(np.arange(len(made)), there, made[there]) if len(there) else np.zeros(len(made))
    return np.asarray(made - made.mean()) if len(made) else made
