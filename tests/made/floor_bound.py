"""Cramér-Rao bound of natural frequencies and damping in averaged power spectra: Whittle's likelihood, by numbers."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from made.structures import Structure

Array = NDArray[np.float64]


def whittle_bound(made: Structure, *, top_hz: float = 500.0, frame_s: float | None = None) -> Array:
    """Standard errors (2, modes) of ln f and ln ζ that no unbiased estimate from the power spectra goes below.

    Unknown are the poles, two residues per pole and channel, and the noise of every channel. Power spectra of two
    channels at one frequency share |S_cd|². Where ``frame_s`` is given, spectra are those of Hann frames so long.
    Frequencies that an order covers at a speed tell nothing there.
    """
    step = 0.05
    at = np.arange(3.0, top_hz, step)
    time = _seconds(made, at)
    matrix = np.abs(made.spectra(at)) ** 2
    slopes = np.concatenate([_pole_slopes(made, at), _residue_slopes(made, at)])
    if frame_s is None:
        weight = np.linalg.pinv(matrix, hermitian=True)
        fisher = step * np.einsum("pwc,w,wcd,qwd->pq", slopes, time, weight, slopes, optimize=True)
    else:
        fisher = _windowed(slopes, matrix, time, at, frame_s)
    scale = np.sqrt(np.diag(fisher))
    scale[scale == 0.0] = 1.0
    covariance = np.linalg.pinv(fisher / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
    n = len(made.natural_hz)
    return np.sqrt(np.diag(covariance)[: 2 * n]).reshape(2, n)


def _seconds(made: Structure, at: Array) -> Array:
    """Seconds recorded (W,) at speeds where no order's main lobe lies at the frequency."""
    total = np.zeros(len(at))
    for rpm in made.speed_rpm:
        free = np.ones(len(at), dtype=bool)
        for order in made.order:
            free &= np.abs(at - order * rpm / 60.0) > 1.25
        total += made.duration_s * free
    return total


def _pole_slopes(made: Structure, at: Array) -> Array:
    """Derivatives (2 modes, W, C) of the power spectra by ln f and ln ζ."""
    slopes = []
    for name in ("natural_hz", "damping"):
        for k in range(len(made.natural_hz)):
            ends = []
            for sign in (1.0, -1.0):
                value = getattr(made, name).copy()
                value[k] *= 1.0 + sign * 1e-5
                ends.append(_powers(replace(made, **{name: value}), at))
            slopes.append((ends[0] - ends[1]) / 2e-5)
    return np.array(slopes)


def _powers(made: Structure, at: Array) -> Array:
    return np.einsum("wcc->wc", made.spectra(at)).real


def _residue_slopes(made: Structure, at: Array) -> Array:
    """Derivatives (P, W, C) by what the poles' parts and the noise of each channel are."""
    n_channels = len(made.noise)
    p = made.poles()[:, None]
    z = np.exp(2j * np.pi * at / 1280.0)
    part = 1.0 / (z - p) + 0.0
    slopes = []
    for channel in range(n_channels):
        for row in (*part.real, *part.imag, np.ones(len(at)), at / at[-1], (at / at[-1]) ** 2):
            one = np.zeros((len(at), n_channels))
            one[:, channel] = row
            slopes.append(one)
    return np.array(slopes)


def _windowed(slopes: Array, matrix: Array, time: Array, at: Array, frame_s: float) -> Array:
    """Fisher information of Hann spectra at every half bin, whose neighbours share what the window sees."""
    bins = np.arange(4.0, at[-1] - 3.0, 0.5 / frame_s)
    lag = np.arange(0.0, 1.0, 1e-3)
    # autocorrelation of the Hann window (length 1): its transform is the power response
    shape = np.sin(np.pi * np.arange(2048) / 2048) ** 2
    full = np.correlate(shape, shape, mode="full")[2047:]
    auto = np.interp(lag, np.arange(2048) / 2048, full / full[0])
    offset = np.arange(0.0, 5.0, 0.01)
    curve = 2.0 * frame_s * 1e-3 * (np.cos(2.0 * np.pi * np.outer(offset, lag)) @ auto - 0.5)
    kernel = np.interp(np.abs(at - bins[:, None]) * frame_s, offset, curve, right=0.0)
    step = at[1] - at[0]
    n_channels = matrix.shape[1]
    seen = step * np.einsum("bw,pwc->pbc", kernel, slopes, optimize=True).reshape(len(slopes), -1)
    covariance = np.empty((len(bins), n_channels, len(bins), n_channels))
    used = np.maximum(time, 1e-3 * time.max())
    for c in range(n_channels):
        for d in range(n_channels):
            covariance[:, c, :, d] = step * (kernel * (matrix[:, c, d] / used)) @ kernel.T
    covariance = covariance.reshape(seen.shape[1], -1)
    size = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(size, size) + 1e-6 * np.eye(len(size))
    seen = seen / size
    return np.asarray(seen @ np.linalg.solve(scaled, seen.T))
