"""Rotors whose natural frequencies move with the speed, made sample by sample: Campbell maps of known truth."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import lfilter, welch

from made.floors import campbell_map_of

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Moving:
    """A resonance at ``hz`` + ``slope`` × rev/s of ``damping``, by its ``gain`` in each channel."""

    hz: float
    slope: float
    damping: float
    gain: tuple[float, ...] = (1.0, 0.6)

    def at(self, rpm: float | Array) -> float | Array:
        """Natural frequency in Hz at ``rpm``."""
        return self.hz + self.slope * rpm / 60.0


@dataclass(frozen=True, kw_only=True)
class Rotor:
    """Modes under white forces of their own at steady speeds, over noise; ``growth``: force as speed to that power."""

    modes: tuple[Moving, ...]
    speed_rpm: tuple[float, ...] = tuple(np.linspace(1000.0, 4000.0, 16))
    duration_s: float = 15.0
    rate_hz: float = 512.0
    noise: float = 0.02
    growth: float = 0.0
    resolution_hz: float = 0.5


def _filtered(force: Array, hz: float, damping: float, rate_hz: float) -> Array:
    """Velocity of an oscillator of unit half-power height under ``force``, its impulse response sampled."""
    sigma, turn = damping * 2.0 * np.pi * hz / rate_hz, 2.0 * np.pi * hz * np.sqrt(1.0 - damping**2) / rate_hz
    keep = np.exp(-sigma)
    made: Array = lfilter(
        [2.0 * sigma, -2.0 * sigma * keep * np.cos(turn)], [1.0, -2.0 * keep * np.cos(turn), keep**2], force
    )
    return made


def signals(rotor: Rotor, rpm: float, random: np.random.Generator) -> Array:
    """Signals (channels, samples) at the steady speed ``rpm``."""
    n_samples = round(rotor.duration_s * rotor.rate_hz)
    n_channels = len(rotor.modes[0].gain) if rotor.modes else 2
    made = rotor.noise * random.standard_normal((n_channels, n_samples))
    lead = round(2.0 * rotor.rate_hz)
    for mode in rotor.modes:
        force = random.standard_normal(n_samples + lead) * (rpm / 2000.0) ** rotor.growth
        moved = _filtered(force, float(mode.at(rpm)), mode.damping, rotor.rate_hz)[lead:]
        made += np.array(mode.gain)[:, None] * moved
    return made


def whirling_campbell(rotor: Rotor, seed: int) -> xr.Dataset:
    """CampbellMap of ``rotor`` behind the noise of ``seed``."""
    random = np.random.default_rng(seed)
    n_frame = round(rotor.rate_hz / rotor.resolution_hz)
    n_bins = round(0.45 * rotor.rate_hz / rotor.resolution_hz)
    psd = []
    n_frames = 0
    for rpm in rotor.speed_rpm:
        made = signals(rotor, rpm, random)
        n_frames = (made.shape[1] - n_frame) // (n_frame // 2) + 1
        psd.append(welch(made, rotor.rate_hz, "hann", n_frame, detrend=False)[1][:, :n_bins])
    return campbell_map_of(np.stack(psd, axis=1), n_frames, rotor.speed_rpm, rotor.resolution_hz)
