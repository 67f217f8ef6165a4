"""Signals given by crank angle, many draws at once as channels: order frames made without the program's, and tracks."""

import numpy as np
import xarray as xr

from crankorder.orders.map import order_map
from crankorder.orders.track_rows import order_tracks
from crankorder.settings import load_settings
from made.recordings import frames_of

SAMPLES_PER_REV, REVS = 32, 16
HIGHEST = 8


def lines(n_samples: int, given: list[tuple[float, float, float]]) -> np.ndarray:
    """Sum of lines (order, amplitude, phase [rad])."""
    angle = np.arange(n_samples) / SAMPLES_PER_REV
    return sum(a * np.cos(2 * np.pi * order * angle + phase) for order, a, phase in given)


def coloured(rng: np.random.Generator, draws: int, *, revs: int, colour: str) -> np.ndarray:
    """Noise (draws, samples): "white" of variance 1, "pink", or with a "resonance" at order 5.1 damped by 2 %."""
    n = revs * SAMPLES_PER_REV
    if colour == "white":
        return rng.standard_normal((draws, n))
    white = rng.standard_normal((draws, 2 * n))
    order = np.fft.rfftfreq(2 * n, 1 / SAMPLES_PER_REV)
    if colour == "pink":
        response = 1.0 / np.sqrt(np.maximum(order, 0.2))
    else:
        response = 0.05 + 0.3 * order**2 / (5.1**2 - order**2 + 2j * 0.02 * 5.1 * order)
    return np.fft.irfft(np.fft.rfft(white) * response, 2 * n)[:, :n]


def angle_frames(signals: np.ndarray, *, speed: np.ndarray | float = 1200.0, name: str = "made") -> xr.Dataset:
    """OrderFrames of ``signals`` (draws, samples) in Hann frames of 16 revolutions, half overlapping."""
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(REVS * SAMPLES_PER_REV) / (REVS * SAMPLES_PER_REV))
    begin = np.arange(0, signals.shape[1] // SAMPLES_PER_REV - REVS + 1, REVS // 2)
    pieces = [signals[:, k * SAMPLES_PER_REV : (k + REVS) * SAMPLES_PER_REV] * window for k in begin]
    spectra = np.stack([np.fft.rfft(piece)[:, : HIGHEST * REVS + 1] * 2 / window.sum() for piece in pieces], axis=1)
    return frames_of(spectra, speed_rpm=speed, revs=REVS, recording=name)


def tracked(signals: np.ndarray, orders: tuple[float, ...]) -> xr.Dataset:
    """OrderTracks (channel, order) of ``signals`` (draws, samples), all in one recording at one speed."""
    frames, settings = [angle_frames(signals)], load_settings().orders
    tracks = order_tracks(order_map(frames, settings=settings), list(orders), settings=settings, frames=frames)
    return tracks.isel(speed=0)
