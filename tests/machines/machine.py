"""A rotating machine and its test: modes, orders, forces, speeds, sensors. Knows nothing of the program.

Signals are complex envelopes on ``exp(2 pi i order angle)``, the angle in revolutions from top dead centre. A mode is a
pole ``s``; a force ``F`` drives its state, ``z' = s z + F``, and a channel shows the acceleration
``Im(shape s^2 z) / omega_d + Re(shape) F``: for a real shape that is the second derivative of the mode's displacement.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Mode:
    """One natural mode: its pole, and how strongly each channel, order and broadband source takes part in it."""

    frequency_hz: float
    damping_ratio: float
    shape: tuple[complex, ...]
    """By channel, 1/kg."""
    drive: tuple[complex, ...]
    """By order: share of its force that acts on the mode; its angle is a delay between the places of the force."""
    broadband: tuple[float, ...]
    """By broadband source: share of its force that acts on the mode."""

    @property
    def pole(self) -> complex:
        """Pole in the upper half plane, rad/s."""
        natural = 2.0 * np.pi * self.frequency_hz
        return complex(-self.damping_ratio * natural, natural * np.sqrt(1.0 - self.damping_ratio**2))

    def acceleration_per_force(self, frequency_hz: Any) -> ComplexArray:
        """Steady acceleration per unit of modal force, (channel, frequency), at ``frequency_hz`` (frequency,)."""
        s, jw = self.pole, 2j * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        shape = np.asarray(self.shape)[:, None]
        swing = shape * s**2 / (jw - s) - np.conj(shape * s**2) / (jw - np.conj(s))
        return np.asarray(swing / (2j * s.imag) + shape.real)


@dataclass(frozen=True)
class Order:
    """A force that turns ``order`` times per revolution: ``(constant + growth (rpm / 1000)^exponent)`` newtons."""

    order: float
    constant: float
    growth: float
    exponent: float
    phase_deg: float
    phase_deg_per_krpm: float
    direct: tuple[complex, ...]
    """By channel, 1/kg: acceleration per force of all that is no mode of this machine's list."""

    def force(self, rpm: Any) -> ComplexArray:
        """Complex force, N, at ``rpm`` (any shape, not negative)."""
        thousands = np.asarray(rpm, dtype=float) / 1000.0
        size = self.constant + self.growth * thousands**self.exponent
        return np.asarray(size * np.exp(1j * np.radians(self.phase_deg + self.phase_deg_per_krpm * thousands)))


@dataclass(frozen=True)
class Tone:
    """A line of the mains or another machine: constant frequency, m/s² by channel."""

    frequency_hz: float
    amplitude: tuple[float, ...]
    phase: tuple[float, ...]


@dataclass(frozen=True)
class Swing:
    """Sinusoidal swing of the crank angle within the cycle, as by the gas torque of a flywheel engine.

    ``order`` times per revolution, ``size_rev`` at the speed ``rpm``; the torque stays, so that the size falls with the
    square of the speed.
    """

    order: float
    size_rev: float
    rpm: float
    phase: float = 0.0


@dataclass(frozen=True)
class Profile:
    """Speed of one recording: straight lines between knots, a slow wander on top, and a swing within the cycle."""

    time_s: tuple[float, ...]
    rpm: tuple[float, ...]
    start_rev: float
    wander_rpm: float = 0.0
    wander_hz: float = 0.3
    wander_phase: float = 0.0
    swing: Swing | None = None

    @property
    def duration_s(self) -> float:
        """Length of the recording, s."""
        return self.time_s[-1]

    def speed(self, time_s: FloatArray) -> FloatArray:
        """Speed, rpm, at ``time_s`` (any shape), without the swing within the cycle."""
        wander = self.wander_rpm * np.sin(2.0 * np.pi * self.wander_hz * time_s + self.wander_phase)
        return np.asarray(np.interp(time_s, self.time_s, self.rpm) + wander)

    def angle(self, time_s: FloatArray) -> FloatArray:
        """Crank angle, revolutions from top dead centre, at ``time_s`` (any shape): the exact integral of the speed.

        The swing within the cycle stands on top of it.
        """
        mean = self.mean_angle(time_s)
        if self.swing is None:
            return mean
        size = self.swing.size_rev * (self.swing.rpm / self.speed(time_s)) ** 2
        return np.asarray(mean + size * np.sin(2.0 * np.pi * self.swing.order * mean + self.swing.phase))

    def mean_angle(self, time_s: FloatArray) -> FloatArray:
        """Crank angle, revolutions, at ``time_s`` (any shape) without the swing within the cycle."""
        knot, rpm = np.asarray(self.time_s), np.asarray(self.rpm)
        slope = np.diff(rpm) / np.diff(knot)
        before = np.concatenate(([0.0], np.cumsum(0.5 * (rpm[1:] + rpm[:-1]) * np.diff(knot))))
        piece = np.clip(np.searchsorted(knot, time_s, side="right") - 1, 0, slope.size - 1)
        since = time_s - knot[piece]
        straight = before[piece] + rpm[piece] * since + 0.5 * slope[piece] * since**2
        turn = 2.0 * np.pi * self.wander_hz
        wander = self.wander_rpm / turn * (np.cos(self.wander_phase) - np.cos(turn * time_s + self.wander_phase))
        return np.asarray(self.start_rev + (straight + wander) / 60.0)


@dataclass(frozen=True)
class Encoder:
    """How the file tells the shaft: ``trace`` (sampled square wave), ``times`` (pulse times) or ``speed``."""

    name: str
    form: str
    pulses_per_rev: int = 0
    missing_teeth: int = 0
    index: bool = False
    index_to_tdc_deg: float = 0.0
    clock_hz: float = 0.0
    """Pulse times are multiples of its period."""
    pitch_error_rev: float = 0.0
    """Standard deviation of the places of the teeth; the first stands where it should."""

    def teeth_rev(self, seed: int) -> FloatArray:
        """Places of all teeth of the wheel that ``seed`` gives, revolutions, (pulse,)."""
        error = self.pitch_error_rev * np.random.default_rng([seed, 11]).standard_normal(self.pulses_per_rev)
        error[:1] = 0.0
        return np.asarray(np.arange(self.pulses_per_rev) / max(1, self.pulses_per_rev) + error)


@dataclass(frozen=True)
class Machine:
    """One machine and its test: all that the recordings follow from, with ``seed`` and class."""

    class_name: str
    seed: int
    rate_hz: float
    channels: tuple[str, ...]
    modes: tuple[Mode, ...]
    orders: tuple[Order, ...]
    tones: tuple[Tone, ...]
    profiles: tuple[Profile, ...]
    encoder: Encoder
    noise_density: tuple[float, ...]
    """Sensor noise by channel, m/s² per root hertz (one-sided)."""
    force_density: tuple[float, ...]
    """Broadband force by source, N per root hertz (one-sided); empty where orders alone excite."""
    mains_hz: float
    steady: bool
    """Whether every recording keeps one speed."""
    ring: tuple[float, ...] = ()
    """Acceleration, m/s², with which each mode still rings when a recording starts; empty: not at all."""
    gear_teeth: int = 0
    """Teeth of a stated wheel on the shaft, whose mesh is one of the orders; 0: none."""

    @cached_property
    def tested_rpm(self) -> tuple[float, ...]:
        """Mean speed of each steady recording; the lowest and highest speed of sweeps."""
        if self.steady:
            return tuple(sorted(float(np.mean(profile.rpm)) for profile in self.profiles))
        ends = [rpm for profile in self.profiles for rpm in profile.rpm]
        return min(ends), max(ends)

    def is_locked(self, order: Order) -> bool:
        """Whether ``order`` is an exact multiple of the cycle of two revolutions."""
        return float(2.0 * order.order).is_integer()

    def steady_response(self, number: int, rpm: Any, without: int | None = None) -> ComplexArray:
        """Steady complex amplitude, m/s², (channel, speed), of order ``number`` at ``rpm``, ``without`` one mode."""
        order = self.orders[number]
        speed = np.atleast_1d(np.asarray(rpm, dtype=float))
        total = np.repeat(np.asarray(order.direct, dtype=complex)[:, None], speed.size, axis=1)
        for place, mode in enumerate(self.modes):
            if place != without:
                total = total + mode.drive[number] * mode.acceleration_per_force(order.order * speed / 60.0)
        return np.asarray(total * order.force(speed))

    def floor_psd(self, frequency_hz: Any) -> ComplexArray:
        """One-sided cross-spectral density, (m/s²)²/Hz, (frequency, channel, channel), of all that is broadband."""
        frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        total = np.zeros((frequency.size, len(self.channels), len(self.channels)), dtype=complex)
        total += np.diag(np.square(self.noise_density))
        for source, density in enumerate(self.force_density):
            path = sum(mode.broadband[source] * mode.acceleration_per_force(frequency) for mode in self.modes)
            total += density**2 * np.einsum("cf,df->fcd", path, np.conj(path))
        return total
