"""OrderFrames of lines and noise made by crank angle: what identification of orders is tried on, cheaply."""

import json
from collections.abc import Iterable, Sequence

import numpy as np
import xarray as xr

from crankorder.identify.found import AgreedOrder
from crankorder.identify.lines.agreed_orders import orders_agreed
from crankorder.identify.lines.known_lines import Held, held_recordings
from crankorder.identify.lines.line_phasors import recordings_of
from crankorder.identify.lines.order_lines import order_lines
from crankorder.orders.map import order_map
from crankorder.orders.spectra import spectra_by_angle
from crankorder.settings import load_settings
from made import recordings

PER_REV, REVS, HOP, START_REV = 48, 16, 8, 3.25
SETTINGS = load_settings()


def frames_of(
    signals: Sequence[np.ndarray], *, speed_rpm: float | np.ndarray = 1500.0, pulses: bool = True
) -> xr.Dataset:
    """OrderFrames, orders 0 to 20, of ``signals`` (samples,) of each channel, PER_REV samples per revolution."""
    values = np.stack(signals)
    count = (values.shape[1] // PER_REV - REVS) // HOP + 1
    begin = START_REV + HOP * np.arange(count, dtype=np.float64)
    spectrum = spectra_by_angle(values, None, PER_REV, REVS, HOP, begin, 20 * REVS + 1)
    flag = {"recording": "made", "flag": "no_index", "severity": "suspect", "detail": "no encoder pulses: made so"}
    quality = json.dumps([] if pulses else [flag])
    return recordings.frames_of(spectrum, speed_rpm=speed_rpm, revs=REVS, start_rev=START_REV, quality=quality)


def angle_of(revs: int) -> np.ndarray:
    """Crank angle [rev] of the samples of ``revs`` revolutions."""
    return START_REV + np.arange(revs * PER_REV) / PER_REV


def wave(angle_rev: np.ndarray, order: float, amplitude: float, phase_rad: float = 0.0) -> np.ndarray:
    """A line of ``order`` at ``angle_rev``."""
    return amplitude * np.cos(2 * np.pi * order * angle_rev + phase_rad)


def waves(rng: np.random.Generator, angle_rev: np.ndarray, lines: Iterable[tuple[float, float]]) -> np.ndarray:
    """Sum of ``lines`` (order, amplitude) of drawn phases at ``angle_rev``."""
    return sum(wave(angle_rev, order, size, rng.uniform(0.0, 6.0)) for order, size in lines) + np.zeros(len(angle_rev))


def rung(noise: np.ndarray, order: float, damping: float) -> np.ndarray:
    """``noise`` (samples,) and the same through the acceleration response of a mode at ``order``."""
    at = np.fft.rfftfreq(len(noise), 1 / PER_REV)
    response = -(at**2) / (order**2 - at**2 + 2j * damping * order * at)
    return np.fft.irfft(np.fft.rfft(noise) * (1.0 + response), len(noise))


def held_at(
    rng: np.random.Generator, rpm: float, lines: Iterable[tuple[float, float]], *, noise: float = 0.3
) -> list[Held]:
    """A recording of 20 s at ``rpm`` with ``lines`` (Hz, amplitude) of drawn phases in noise of that size."""
    angle = angle_of(round(20.0 * rpm / 60.0))
    orders = [(60.0 * hertz / rpm, size) for hertz, size in lines]
    frames = frames_of([noise * rng.standard_normal(len(angle)) + waves(rng, angle, orders)], speed_rpm=rpm)
    return held_recordings(recordings_of([frames]), frames["order"].values, ["A"])


def agreed_in(frames: Sequence[xr.Dataset], *, followed: Sequence[xr.Dataset] = ()) -> tuple[AgreedOrder, ...]:
    """Orders that the channels and recordings of ``frames`` agree on; ``followed``: OrderTracks of their sweeps."""
    made = order_map(frames, settings=SETTINGS.orders)
    lines = order_lines(made, settings=SETTINGS.identify, orders=SETTINGS.orders, frames=frames)
    return orders_agreed(lines, frames=frames, order_map=made, settings=SETTINGS.identify, followed=followed)
