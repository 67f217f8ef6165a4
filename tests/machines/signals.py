"""Exact signals of a drawn machine: Gauss quadrature of the convolution over each sample, and coloured noise by FFT."""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfftfreq
from scipy.signal import lfilter
from scipy.signal.windows import kaiser
from scipy.special import jv

from machines.machine import ComplexArray, FloatArray, Machine, Mode, Profile

NODES = 5
"""Gauss nodes per sample: below 1e-9 of the amplitude while a force turns less than 2 rad per sample."""
SIDEBANDS = 24
"""Pairs of sidebands of a swing of the shaft: their sizes fall below 1e-8 while it turns a line by less than 7 rad."""
KAISER_BETA, SWEPT_WINDOW_REV = 24.0, 24.0
"""Window over which a line is read by crank angle: side lobes below 1e-9; its length in a sweep."""
MORE_SIDES = 8
"""Pairs of sidebands of an order that are looked for as lines of their own beyond the radians by which it swings."""
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
        self.start = _steady_start(order.order, profile)

    def through(self, mode: Mode) -> ComplexArray:
        """Complex envelope, m/s², (channel, sample), that this order has by way of ``mode``."""
        s, drive = mode.pole, mode.drive[self.number]
        rate, part = self.start
        first = self.envelope[0] * part
        up = convolved(s, self.force, (first / (rate - s)).sum(), self.step_s)
        down = convolved(np.conj(s), self.force, (first / (rate - np.conj(s))).sum(), self.step_s)
        shape = np.asarray(mode.shape)[:, None]
        swing = (shape * s**2 * up - np.conj(shape * s**2) * down) / (2j * s.imag) * np.conj(self.carrier)
        return np.asarray(drive * (swing + shape.real * self.envelope))


def _steady_start(order: float, profile: Profile) -> tuple[ComplexArray, ComplexArray]:
    """Lines of a unit force of ``order`` in the steady running that a recording starts in: s, rad/s, and size.

    One line, and with a swing within the cycle its sidebands (Jacobi-Anger: Bessel functions of the first kind).
    """
    start = np.zeros(1)
    turn, speed_hz = float(profile.mean_angle(start)[0]), float(profile.speed(start)[0]) / 60.0
    side, depth, swing_order, phase = np.zeros(1), 0.0, 0.0, 0.0
    if profile.swing is not None:
        side, swing_order = np.arange(-SIDEBANDS, SIDEBANDS + 1.0), profile.swing.order
        depth = _swing_rad(order, profile, 60.0 * speed_hz)
        phase = 2.0 * np.pi * swing_order * turn + profile.swing.phase
    size = jv(side, depth) * np.exp(1j * (2.0 * np.pi * order * turn + side * phase))
    return 2j * np.pi * speed_hz * (order + side * swing_order), np.asarray(size)


def _swing_rad(order: float, profile: Profile, rpm: float) -> float:
    """Largest phase by which the swing of ``profile`` turns a line of ``order`` at ``rpm``."""
    return 2.0 * np.pi * order * profile.swing.size_rev * (profile.swing.rpm / rpm) ** 2 if profile.swing else 0.0


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


@dataclass(frozen=True)
class SwungSignal:
    """Signal of all orders (channel, sample), m/s², over the ``angle`` (sample,), revolutions, of a swinging shaft.

    ``numbers``: the orders and their sidebands, which the modes make lines of. A line is the mean of the signal turned
    back by its order, over windows of ``reach_rev`` revolutions on either side.
    """

    signal: FloatArray
    angle: FloatArray
    numbers: tuple[float, ...]
    reach_rev: float

    @property
    def centres(self) -> FloatArray:
        """Angles in the middle of the windows, which overlap by half."""
        first, last = self.angle[0] + self.reach_rev, self.angle[-1] - self.reach_rev
        return np.arange(first, last + 1e-9, self.reach_rev)

    def amplitude(self, order: float) -> FloatArray:
        """Largest amplitude (channel,) of the line at ``order``."""
        lines = [line_at(self.signal, self.angle, order, float(centre), self.reach_rev) for centre in self.centres]
        return np.asarray(2.0 * np.max(np.abs(lines), axis=0))


def swung_signal(machine: Machine, profile: Profile, envelopes: list[ComplexArray]) -> SwungSignal | None:
    """The signal of the orders of ``machine`` in the recording of ``profile``; None where the shaft does not swing.

    ``envelopes``: (channel, sample) of each order, m/s².
    """
    if profile.swing is None:
        return None
    angle = profile.angle(sample_times(machine, profile))
    signal, numbers = np.zeros((len(machine.channels), angle.size)), set()
    for order, envelope in zip(machine.orders, envelopes, strict=True):
        signal += (envelope * np.exp(2j * np.pi * order.order * angle)).real
        sides = MORE_SIDES + int(_swing_rad(order.order, profile, min(profile.rpm)))
        numbers |= {round(abs(order.order + side * profile.swing.order), 9) for side in range(-sides, sides + 1)}
    held = profile.rpm[0] == profile.rpm[-1]
    reach_rev = 0.5 * float(angle[-1] - angle[0]) if held else 0.5 * SWEPT_WINDOW_REV
    return SwungSignal(signal, angle, tuple(sorted(numbers - {0.0})), reach_rev)


def as_read_by_angle(
    machine: Machine, profile: Profile, envelopes: list[ComplexArray], swung: SwungSignal | None
) -> list[ComplexArray]:
    """Envelopes of the orders in a recording of ``machine`` as an analysis by crank angle reads them, m/s².

    Where the shaft swings within the cycle, the modes make sidebands of every order, which are orders too. At a held
    speed an envelope becomes its mean over the recording, in a sweep over each cycle, sidebands of the other orders
    included. ``envelopes``: (channel, sample) of each order in the recording of ``profile``; ``swung``: their signal.
    """
    if swung is None:
        return envelopes
    angle = swung.angle
    carriers = [np.exp(2j * np.pi * order.order * angle) for order in machine.orders]
    if profile.rpm[0] != profile.rpm[-1]:
        return [
            _cycle_mean(envelope, angle) + _sidebands_of_others(machine, number, envelopes, carriers, angle)
            for number, envelope in enumerate(envelopes)
        ]
    # a close neighbour is another order: of the others only what the swing makes of them counts
    window = float(swung.centres[0]), swung.reach_rev
    means = [line_at(envelope, angle, 0.0, *window)[:, None] for envelope in envelopes]
    rest = swung.signal - sum((mean * carrier).real for mean, carrier in zip(means, carriers, strict=True))
    read = [
        mean + 2.0 * line_at(rest, angle, order.order, *window)[:, None]
        for mean, order in zip(means, machine.orders, strict=True)
    ]
    return [np.repeat(mean, angle.size, axis=1) for mean in read]


def line_at(
    signal: FloatArray | ComplexArray, angle: FloatArray, order: float, centre: float, reach_rev: float
) -> ComplexArray:
    """Mean (channel,) of ``signal`` (channel, sample) turned back by ``order``, within ``reach_rev`` of ``centre``.

    ``angle``: of each sample, revolutions. Kaiser's window, over the angle.
    """
    first, last = np.searchsorted(angle, [centre - reach_rev, centre + reach_rev])
    own = angle[first:last]
    weight = np.interp(own - centre, np.linspace(-reach_rev, reach_rev, 4001), kaiser(4001, KAISER_BETA))
    weight *= np.gradient(own)
    return np.asarray(signal[:, first:last] @ (weight * np.exp(-2j * np.pi * order * own)) / weight.sum())


def _sidebands_of_others(
    machine: Machine, number: int, envelopes: list[ComplexArray], carriers: list[ComplexArray], angle: FloatArray
) -> ComplexArray:
    """What the swing adds to the order ``number`` from the other locked ones, (channel, sample).

    The mean over two cycles, weighted to their middle: over one, an order that grows leaves a part of itself.
    """
    if not machine.is_locked(machine.orders[number]):
        return np.zeros_like(envelopes[number])
    others = np.zeros_like(envelopes[number])
    for place, order in enumerate(machine.orders):
        line = envelopes[place] * carriers[place]
        if place == number:
            others += np.conj(line) * np.conj(carriers[number])
        elif machine.is_locked(order):
            others += 2.0 * line.real * np.conj(carriers[number])
    # at the ends, where no two whole cycles are left, as beside them
    first, last = np.searchsorted(angle, [angle[0] + 2.0, angle[-1] - 2.0])
    nearest = np.clip(np.arange(angle.size), first, last)
    return np.asarray(_cycle_mean(_cycle_mean(others, angle), angle)[:, nearest])


def _cycle_mean(envelope: ComplexArray, angle: FloatArray) -> ComplexArray:
    """Mean of ``envelope`` (channel, sample) over the two revolutions about each ``angle`` (sample,), fewer at ends."""
    total = np.concatenate((np.zeros((len(envelope), 1)), np.cumsum(envelope[:, 1:] * np.diff(angle), axis=1)), axis=1)
    half = np.minimum(1.0, np.minimum(angle - angle[0], angle[-1] - angle) + 1e-3)
    low, high = np.maximum(angle - half, angle[0]), np.minimum(angle + half, angle[-1])
    return np.stack([(np.interp(high, angle, row) - np.interp(low, angle, row)) / (high - low) for row in total])
