"""Exact signals of a drawn machine: Gauss quadrature of the convolution over each sample, and coloured noise by FFT."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfftfreq
from scipy.signal import lfilter

from machines.machine import ComplexArray, FloatArray, Machine, Mode, Profile

NODES = 5
"""Gauss nodes per sample: below 1e-9 of the amplitude while a force turns less than 2 rad per sample."""
MEMORY = 12.0
"""Decay times of the slowest mode that noise runs longer than the recording: its ends do not know each other."""


def sample_times(machine: Machine, profile: Profile) -> FloatArray:
    """Times, s, of the samples of the recording of ``profile`` by ``machine``."""
    return np.arange(round(profile.duration_s * machine.rate_hz)) / machine.rate_hz


def convolved(pole: complex, force: ComplexArray, start: complex, step_s: float) -> ComplexArray:
    """State of ``z' = pole z + force`` at each sample, from ``start`` on.

    ``force``: (node, sample - 1), at the Gauss nodes of each interval of ``step_s``.
    """
    node, weight = np.polynomial.legendre.leggauss(force.shape[0])
    spread = 0.5 * step_s * weight * np.exp(pole * step_s * 0.5 * (1.0 - node))
    gained = np.concatenate(([start], spread @ force))
    return np.asarray(lfilter([1.0], [1.0, -np.exp(pole * step_s)], gained))


class OrderDrive:
    """The force of one order over one recording, at the samples and at the Gauss nodes between them."""

    def __init__(self, machine: Machine, profile: Profile, number: int) -> None:
        self.number, self.step_s = number, 1.0 / machine.rate_hz
        order, time_s = machine.orders[number], sample_times(machine, profile)
        node = np.polynomial.legendre.leggauss(NODES)[0]
        between = time_s[:-1] + 0.5 * self.step_s * (1.0 + node[:, None])
        self.carrier = np.exp(2j * np.pi * order.order * profile.angle(time_s))
        self.envelope = order.force(np.maximum(profile.speed(time_s), 0.0))
        size = order.force(np.maximum(profile.speed(between), 0.0))
        self.force = size * np.exp(2j * np.pi * order.order * profile.angle(between))
        self.start_hz = float(order.order * profile.speed(time_s[:1])[0] / 60.0)

    def through(self, mode: Mode) -> ComplexArray:
        """Complex envelope, m/s², (channel, sample), that this order has by way of ``mode``."""
        s, drive = mode.pole, mode.drive[self.number]
        first = self.envelope[0] * self.carrier[0]
        up = convolved(s, self.force, first / (2j * np.pi * self.start_hz - s), self.step_s)
        down = convolved(np.conj(s), self.force, first / (2j * np.pi * self.start_hz - np.conj(s)), self.step_s)
        shape = np.asarray(mode.shape)[:, None]
        swing = (shape * s**2 * up - np.conj(shape * s**2) * down) / (2j * s.imag) * np.conj(self.carrier)
        return np.asarray(drive * (swing + shape.real * self.envelope))


def order_envelope(machine: Machine, profile: Profile, number: int) -> tuple[ComplexArray, ComplexArray]:
    """Complex envelope (channel, sample), m/s², of order ``number`` of ``machine`` in the recording of ``profile``.

    Also its carrier, (sample,): the signal is the real part of their product. The recording starts in steady running.
    """
    drive = OrderDrive(machine, profile, number)
    total = np.asarray(machine.orders[number].direct)[:, None] * drive.envelope
    for mode in machine.modes:
        if mode.drive[number]:
            total = total + drive.through(mode)
    return total, drive.carrier


def broadband(machine: Machine, n_samples: int, rng: np.random.Generator) -> FloatArray:
    """Broadband part, m/s², (channel, sample), of ``n_samples``: forces through the modes and the sensors' own noise.

    Drawn in the frequency domain, where the response is exact; of a longer period than the recording.
    """
    slowest = min((-mode.pole.real for mode in machine.modes), default=np.inf)
    extra = min(MEMORY / slowest, 30.0) if machine.force_density else 0.0
    length = next_fast_len(n_samples + round(extra * machine.rate_hz), real=True)
    frequency = rfftfreq(length, 1.0 / machine.rate_hz)
    # a bin of a one-sided density G has E|X|^2 = G rate length / 2
    scale = np.sqrt(machine.rate_hz * length / 4.0)

    def white() -> ComplexArray:
        return np.asarray(scale * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size)))

    spectrum = np.stack([density * white() for density in machine.noise_density])
    for source, density in enumerate(machine.force_density):
        force = density * white()
        for mode in machine.modes:
            spectrum += mode.broadband[source] * mode.acceleration_per_force(frequency) * force
    return np.asarray(irfft(spectrum, length)[:, :n_samples])


def ringing(machine: Machine, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """What still rings of the modes of ``machine`` at ``time_s``, m/s², (channel, sample); ``rng`` gives the phases."""
    total = np.zeros((len(machine.channels), time_s.size))
    for mode, size in zip(machine.modes, machine.ring, strict=False):
        shape = np.asarray(mode.shape) / np.abs(mode.shape).max()
        decay = size * np.exp(mode.pole * time_s + 2j * np.pi * rng.random())
        total += (shape[:, None] * decay).real
    return total


def recorded(machine: Machine, profile: Profile, rng: np.random.Generator) -> tuple[FloatArray, list[ComplexArray]]:
    """Samples (channel, sample), m/s², of one recording of ``machine``, and the envelope of each order in it.

    ``profile``: the speed of the recording. ``rng``: of the noise.
    """
    time_s = sample_times(machine, profile)
    samples = broadband(machine, time_s.size, rng)
    envelopes = []
    for number in range(len(machine.orders)):
        envelope, carrier = order_envelope(machine, profile, number)
        samples += (envelope * carrier).real
        envelopes.append(envelope)
    samples += ringing(machine, time_s, rng)
    for tone in machine.tones:
        phase = 2.0 * np.pi * tone.frequency_hz * time_s + np.asarray(tone.phase)[:, None]
        samples += np.asarray(tone.amplitude)[:, None] * np.cos(phase)
    return samples, envelopes
