"""Structures that white noise and the orders of a shaft drive: digital filters in the time domain, drawn by seed."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import lfilter

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.settings import load_settings
from made.recordings import steady

Array = NDArray[np.float64]

RATE_HZ = 1280.0
WARM_UP_S = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """Modes that independent white forces drive, and how they are recorded.

    ``natural_hz``, ``damping`` (modes,); ``shape`` (modes, channels) and ``drive`` (modes, forces) make the residues;
    ``noise`` (channels,) is the sensors' standard deviation; ``order_force`` (orders, 1 + modes): what order
    ``order`` (orders,) adds to each channel directly and drives each mode with; ``gain`` (speeds,) of the forces.
    ``tones``: (frequency, amplitude); ``wander_hz``: how far (standard deviation) tones wander between recordings.
    """

    natural_hz: Array
    damping: Array
    shape: Array
    drive: Array
    noise: Array
    speed_rpm: Array
    duration_s: float
    order: Array
    order_force: Array
    gain: Array
    tones: tuple[tuple[float, float], ...] = ()
    wander_hz: float = 0.0

    def signals(self, angle_rev: Array, speed_rpm: Array, random: np.random.Generator, gain: float = 1.0) -> Array:
        """Samples (channels, time) of a shaft at ``angle_rev`` and ``speed_rpm``, less the warm-up that both have."""
        lead = round(WARM_UP_S * RATE_HZ)
        n_samples = len(angle_rev) - lead
        turns = np.exp(2j * np.pi * np.outer(self.order, angle_rev)) * (speed_rpm / 2000.0) ** 2
        turns[np.outer(self.order, speed_rpm / 60.0) > 0.45 * RATE_HZ] = 0.0
        force = gain * self.drive @ random.standard_normal((self.drive.shape[1], len(angle_rev)))
        force += (self.order_force[:, 1:].T @ turns).real
        made = self.noise[:, None] * random.standard_normal((len(self.noise), n_samples))
        made += (self.order_force[:, 0] @ turns[:, lead:]).real
        for own, shape, natural_hz, zeta in zip(force, self.shape, self.natural_hz, self.damping, strict=True):
            pole = np.exp((-zeta + 1j * np.sqrt(1.0 - zeta**2)) * 2.0 * np.pi * natural_hz / RATE_HZ)
            back, z = np.array([1.0, -2.0 * pole.real, abs(pole) ** 2]), np.exp(2j * np.pi * natural_hz / RATE_HZ)
            scale = abs(np.polyval(back[::-1], 1.0 / z) / (1.0 - 1.0 / z) ** 2)  # one at its largest, about
            made += np.outer(shape, lfilter(scale * np.array([1.0, -2.0, 1.0]), back, own)[lead:])
        time = np.arange(n_samples) / RATE_HZ
        for hz, size in self.tones:
            wandered = hz + self.wander_hz * random.standard_normal()
            made += size * np.cos(2.0 * np.pi * (wandered * time + random.random()))
        return made


def recorded(made: Structure, seed: int) -> xr.Dataset:
    """CampbellMap of ``made`` at its speeds by the program's own frames, with noise of ``seed``."""
    random, settings = np.random.default_rng([seed, 7]), load_settings()
    time, frames = np.arange(-round(WARM_UP_S * RATE_HZ), round(made.duration_s * RATE_HZ)) / RATE_HZ, []
    for rpm, gain in zip(made.speed_rpm.tolist(), made.gain.tolist(), strict=True):
        rows = made.signals(rpm / 60.0 * time - 0.3, np.full(len(time), rpm), random, gain)
        signals = [lambda t, a, row=row: row for row in rows]
        recording = steady(signals, speed_rpm=rpm, duration_s=made.duration_s, rate_hz=RATE_HZ)
        frames.append(frequency_frames(*recording, settings=settings.campbell))
    return campbell_map(frames, speed_bin_rpm=settings.orders.speed_bin_rpm)


def drawn(
    seed: int, *, n_speeds: int, n_modes: int, lowest_hz: float = 25.0, highest_hz: float = 450.0,
    damping: tuple[float, float] = (0.002, 0.1),
) -> Structure:  # fmt: skip
    """Random structure of ``seed``: modes no nearer than six times the mean of their half widths, 3 to 7 orders."""
    random = np.random.default_rng([seed, n_speeds, 11])
    while True:
        f = np.sort(np.exp(random.uniform(np.log(lowest_hz), np.log(highest_hz), n_modes)))
        zeta = np.exp(random.uniform(*np.log(damping), n_modes))
        half = zeta * f
        if np.all(np.diff(f) > np.maximum(3.0 * (half[1:] + half[:-1]), 3.0)):
            break
    n_channels = int(random.integers(1, 4))
    shape = random.uniform(0.3, 1.0, (n_modes, n_channels)) * random.choice([-1.0, 1.0], (n_modes, n_channels))
    drive = random.standard_normal((n_modes, 3))
    drive *= (random.uniform(0.5, 1.5, n_modes) / np.linalg.norm(drive, axis=1))[:, None]
    order = np.sort(random.choice(0.5 * np.arange(1, 25), int(random.integers(3, 8)), replace=False))
    parts = random.standard_normal((2, len(order), 1 + n_modes))
    forces = (parts[0] + 1j * parts[1]) * np.exp(random.uniform(-1.0, 2.0, (len(order), 1)))
    low, high = random.uniform(600.0, 1000.0), random.uniform(1800.0, 3500.0)
    return Structure(
        natural_hz=f, damping=zeta, shape=shape, drive=drive,
        noise=np.exp(random.uniform(np.log(0.1), np.log(0.4), n_channels)), speed_rpm=np.linspace(low, high, n_speeds),
        duration_s=float(random.uniform(5.0, 15.0)), order=order, order_force=forces,
        gain=np.linspace(1.0, random.uniform(1.0, 1.5), n_speeds),
    )  # fmt: skip
