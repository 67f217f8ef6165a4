"""Random parts of a recording, each from a seed stream of its own."""

from __future__ import annotations

import math
import zlib

import numpy as np
from numpy.typing import NDArray


def seed_stream(seed: int, *names: str) -> np.random.Generator:
    """Random generator that depends on ``seed`` and on all ``names`` (effect, recording, channel …), on nothing else.

    Switching an effect on or leaving a recording out therefore changes no other effect and no other recording.
    """
    keys = [zlib.crc32(name.encode("utf-8")) for name in names]
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=keys)))


def white_spectrum(
    stream: np.random.Generator, density: float, *, rate_hz: float, n_samples: int
) -> NDArray[np.complex64]:
    """Half spectrum (as of ``rfft``) of Gaussian white noise whose inverse has the one-sided density, bin 0 left empty.

    ``stream``: where the randomness comes from. ``density``: unit/√Hz, ≥ 0. ``rate_hz``: samples per second.
    ``n_samples``: length of the inverse transform, even. Returns shape (n_samples // 2 + 1,).
    """
    n_bins = n_samples // 2 + 1
    pairs = stream.standard_normal(2 * n_bins, dtype=np.float32)
    pairs *= np.float32(density * math.sqrt(rate_hz * n_samples) / 2)
    spectrum: NDArray[np.complex64] = pairs.view(np.complex64)
    spectrum[0] = 0
    spectrum[-1] = 0
    return spectrum


def white_noise(stream: np.random.Generator, density: float, *, rate_hz: float, n_samples: int) -> NDArray[np.float32]:
    """Gaussian white noise of the one-sided density ``density`` (unit/√Hz), shape (n_samples,).

    ``stream``: where the randomness comes from. ``rate_hz``: samples per second, up to half of which the noise is
    white. ``n_samples``: ≥ 1.
    """
    noise = stream.standard_normal(n_samples, dtype=np.float32)
    noise *= np.float32(density * math.sqrt(rate_hz / 2))
    return noise


def padded_length(n_samples: int, tail_samples: int) -> int:
    """Even, quickly transformed length of at least ``n_samples + tail_samples``.

    Noise made by an inverse transform repeats with its length; ``n_samples`` cut from a length with a tail as long as
    the modes ring has a beginning that knows nothing of its end. ``tail_samples``: ≥ 0.
    """
    from scipy.fft import next_fast_len

    return 2 * int(next_fast_len((n_samples + tail_samples + 1) // 2, real=True))


def coloured_noise(
    spectra: list[NDArray[np.complex64] | None], response: NDArray[np.complex64], *, n_padded: int, n_samples: int
) -> NDArray[np.float32]:
    """What white forces become behind a response, shape (channel, n_samples).

    ``spectra``: per direction the half spectrum of a force, or None where there is none. ``response``: shape
    (channel, direction, bin). ``n_padded``: length that the spectra stand for. ``n_samples``: how many are kept.
    """
    from scipy.fft import irfft

    noise = np.zeros((response.shape[0], n_samples), dtype=np.float32)
    for channel, row in enumerate(response):
        total: NDArray[np.complex64] | None = None
        for gain, spectrum in zip(row, spectra, strict=True):
            if spectrum is not None:
                total = gain * spectrum if total is None else total + gain * spectrum
        if total is not None:
            noise[channel] = irfft(total, n=n_padded, overwrite_x=True)[:n_samples]
    return noise
