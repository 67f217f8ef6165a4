"""Structures that white noise and the orders of a shaft drive: digital filters in the time domain, drawn by seed."""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import lfilter

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.settings import load_settings
from made.recordings import run_up, steady

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

    def poles(self) -> NDArray[np.complex128]:
        """Poles of the filters in the z-plane (modes,)."""
        w = 2.0 * np.pi * self.natural_hz
        return np.exp((-self.damping + 1j * np.sqrt(1.0 - self.damping**2)) * w / RATE_HZ)

    def filters(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Accelerance (modes, frequencies) of each mode, one at its largest, about."""
        z = np.exp(2j * np.pi * np.asarray(frequency_hz) / RATE_HZ)
        p = self.poles()[:, None]
        scale = self._scale()[:, None]
        return scale * (1.0 - 1.0 / z) ** 2 / (1.0 - 2.0 * p.real / z + np.abs(p) ** 2 / z**2)

    def _scale(self) -> Array:
        p = self.poles()
        z = np.exp(2j * np.pi * self.natural_hz / RATE_HZ)
        return 1.0 / np.abs((1.0 - 1.0 / z) ** 2 / (1.0 - 2.0 * p.real / z + np.abs(p) ** 2 / z**2))

    def spectra(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Cross spectral matrix (frequencies, channels, channels), one-sided, at unit gain."""
        h = np.einsum("mc,mf,mw->wcf", self.shape, self.drive, self.filters(frequency_hz))
        s = h @ h.conj().swapaxes(1, 2)
        s += np.diag(self.noise**2)
        return 2.0 * s / RATE_HZ

    def noise_of(self, n_samples: int, gain: float, random: np.random.Generator, orders: Array | None = None) -> Array:
        """Samples (channels, ``n_samples``) of noise, and of forces ``orders`` (modes, samples) on the modes."""
        lead = round(WARM_UP_S * RATE_HZ)
        force = random.standard_normal((self.drive.shape[1], n_samples + lead))
        made = self.noise[:, None] * random.standard_normal((len(self.noise), n_samples))
        for j, (p, k) in enumerate(zip(self.poles(), self._scale(), strict=True)):
            drive = gain * (self.drive[j] @ force)
            if orders is not None:
                drive[lead:] += orders[j]
            moved = lfilter([k, -2.0 * k, k], [1.0, -2.0 * p.real, abs(p) ** 2], drive)[lead:]
            made += np.outer(self.shape[j], moved)
        return made

    def swept(self, angle_rev: Array, speed_rpm: Array, random: np.random.Generator) -> Array:
        """Samples (channels, time) of a recording whose shaft is at ``angle_rev`` and ``speed_rpm`` at each."""
        growth = (speed_rpm / 2000.0) ** 2
        turns = np.exp(2j * np.pi * np.outer(self.order, angle_rev)) * growth
        turns[np.outer(self.order, speed_rpm / 60.0) > 0.45 * RATE_HZ] = 0.0
        made = self.noise_of(len(angle_rev), 1.0, random, (self.order_force[:, 1:].T @ turns).real)
        made += (self.order_force[:, 0] @ turns).real
        time = np.arange(len(angle_rev)) / RATE_HZ
        for hz, size in self.tones:
            made += size * np.cos(2.0 * np.pi * (hz * time + random.random()))
        return made

    def signals(self, rpm: float, gain: float, random: np.random.Generator) -> Array:
        """Samples (channels, time) of a recording at ``rpm``."""
        n = round(self.duration_s * RATE_HZ)
        made = self.noise_of(n, gain, random)
        time = np.arange(n) / RATE_HZ
        for order, part in zip(self.order, self.order_force, strict=True):
            hz = order * rpm / 60.0
            if hz < 0.45 * RATE_HZ:
                at = part[0] + (self.shape.T * part[1:]) @ self.filters(np.array([hz]))[:, 0]
                turned = np.exp(2j * np.pi * (hz * time - 0.3 * order))
                made += (at[:, None] * turned).real * (rpm / 2000.0) ** 2
        for hz, size in self.tones:
            moved = hz + self.wander_hz * random.standard_normal()
            made += size * np.cos(2.0 * np.pi * (moved * time + random.random()))
        return made


def recorded(made: Structure, seed: int) -> xr.Dataset:
    """CampbellMap of ``made`` by the program's own frames, with noise of ``seed``."""
    random = np.random.default_rng([seed, 7])
    settings = load_settings()
    frames = []
    for rpm, gain in zip(made.speed_rpm, made.gain, strict=True):
        values = made.signals(float(rpm), float(gain), random)
        names = [lambda t, a, row=row: row for row in values]
        band, shaft = steady(names, speed_rpm=float(rpm), duration_s=made.duration_s, rate_hz=RATE_HZ)
        frames.append(frequency_frames(band, shaft, settings=settings.campbell))
    return campbell_map(frames, speed_bin_rpm=settings.orders.speed_bin_rpm)


def swept_up(made: Structure, seed: int, *, seconds: float) -> xr.Dataset:
    """CampbellMap of a run-up of ``made`` from its slowest to its fastest speed in ``seconds``."""
    random = np.random.default_rng([seed, 8])
    settings = load_settings()
    low, high = float(made.speed_rpm[0]), float(made.speed_rpm[-1])
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    speed = low + (high - low) * time / seconds
    angle = (low * time + 0.5 * (high - low) * time**2 / seconds) / 60.0
    names = [lambda t, a, row=row: row for row in made.swept(angle, speed, random)]
    band, shaft = run_up(names, from_rpm=low, to_rpm=high, duration_s=seconds, rate_hz=RATE_HZ)
    return campbell_map(
        [frequency_frames(band, shaft, settings=settings.campbell)], speed_bin_rpm=settings.orders.speed_bin_rpm
    )


def drawn(
    seed: int, *, n_speeds: int, n_modes: int | None = None, lowest_hz: float = 25.0, highest_hz: float = 450.0,
    damping: tuple[float, float] = (0.002, 0.1), orders: str = "some",
) -> Structure:  # fmt: skip
    """Random structure of ``seed``: modes no nearer than six times the mean of their half widths.

    ``orders``: "none", "some" or, as an engine's, "all" half orders up to 12.
    """
    random = np.random.default_rng([seed, n_speeds, 11])
    count = int(random.integers(1, 9)) if n_modes is None else n_modes
    while True:
        f = np.sort(np.exp(random.uniform(np.log(lowest_hz), np.log(highest_hz), count)))
        zeta = np.exp(random.uniform(*np.log(damping), count))
        half = zeta * f
        if np.all(np.diff(f) > np.maximum(3.0 * (half[1:] + half[:-1]), 3.0)):
            break
    n_channels = int(random.integers(1, 4))
    shape = random.uniform(0.3, 1.0, (count, n_channels)) * random.choice([-1.0, 1.0], (count, n_channels))
    drive = random.standard_normal((count, 3))
    drive *= (random.uniform(0.5, 1.5, count) / np.linalg.norm(drive, axis=1))[:, None]
    order = 0.5 * np.arange(1, 25) if orders != "none" else np.zeros(0)
    if orders == "some":
        order = np.sort(random.choice(order, int(random.integers(3, 8)), replace=False))
    parts = random.standard_normal((2, len(order), 1 + count))
    forces = (parts[0] + 1j * parts[1]) * np.exp(random.uniform(-1.0, 2.0, (len(order), 1)))
    low, high = random.uniform(600.0, 1000.0), random.uniform(1800.0, 3500.0)
    return Structure(
        natural_hz=f, damping=zeta, shape=shape, drive=drive,
        noise=np.exp(random.uniform(np.log(0.1), np.log(0.4), n_channels)), speed_rpm=np.linspace(low, high, n_speeds),
        duration_s=float(random.uniform(5.0, 15.0)), order=order, order_force=forces,
        gain=np.linspace(1.0, random.uniform(1.0, 1.5), n_speeds),
    )  # fmt: skip


def with_pair(made: Structure, apart: float) -> Structure:
    """``made`` with a copy of its first mode ``apart`` half widths above it, of another shape."""
    f, zeta = made.natural_hz[0], made.damping[0]
    return replace(
        made,
        natural_hz=np.insert(made.natural_hz, 1, f * (1.0 + apart * zeta)),
        damping=np.insert(made.damping, 1, zeta),
        shape=np.insert(made.shape, 1, made.shape[0] * np.resize([1.0, -0.8, 0.6], made.shape.shape[1]), axis=0),
        drive=np.insert(made.drive, 1, np.roll(made.drive[0], 1), axis=0),
        order_force=np.insert(made.order_force, 2, made.order_force[:, 1], axis=1),
    )
