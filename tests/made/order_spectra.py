"""Signals given by crank angle, many draws at once as channels: order frames made without the program's, and tracks."""

import numpy as np
import xarray as xr

from crankorder.orders.followed import followed_tracks, with_followed
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


def filtered(signals: np.ndarray, orders: tuple[float, ...], *, bandwidth: float) -> xr.Dataset:
    """OrderTracks (channel, order) of ``signals`` (draws, samples) by Vold–Kalman, ``bandwidth`` in orders."""
    frames, n = angle_frames(signals), signals.shape[1]
    band = frames[["unit", "quantity"]].assign(signal=(("channel", "crank_angle"), signals, {"units": "see unit"}))
    band.attrs = {"recording": "made", "domain": "crank_angle", "samples_per_rev": SAMPLES_PER_REV}
    shaft = xr.Dataset(
        {"crank_angle": ("time", [0.0, n / SAMPLES_PER_REV]), "speed": ("time", [1200.0, 1200.0])},
        attrs={"domain": "crank_angle", "phase_reference": "tdc", "cycle_known": 1, "revs_per_cycle": 2},
    )
    settings = load_settings().orders.model_copy(
        update={"track_method": "vold_kalman", "track_orders": orders, "track_bandwidth": bandwidth}
    )
    tracks = order_tracks(order_map([frames], settings=settings), orders, settings=settings)
    return (
        with_followed(tracks, [followed_tracks(band, shaft, settings=settings)]).isel(speed=0).sel(order=list(orders))
    )
