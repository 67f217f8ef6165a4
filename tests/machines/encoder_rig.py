"""Records of machines behind drawn encoders, eccentric, oval, uneven and jittering, beside what they may be taken for.

An encoder whose disc is set off shows the angle x + e(x), e = eccentricity * sin(2 pi x + phase) of the true angle x
(and twice a turn where its bore is oval). What is told for true beside it: a shaft that really swings within the turn,
and a mesh of teeth whose wheel is set off and so has sidebands of its own. Nothing here is taken from the program.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

KINDS = ("healthy", "swing", "gear")
CLOCK_HZ = 1e7
"""Pulse times are counts of this clock."""
INVERSIONS = 40
"""Steps of the iteration x = wanted - e(x), each at least twenty times as near as the last."""


@dataclass(frozen=True)
class Encoder:
    """An encoder of so many ``pulses``: what it shows over the true angle, sizes in degrees, phases in radians."""

    pulses: int
    eccentricity: float = 0.0
    eccentricity_phase: float = 0.0
    ovality: float = 0.0
    ovality_phase: float = 0.0
    jitter: float = 0.0
    line_error: float = 0.0

    def error_rev(self, angle: Floats) -> Floats:
        """What is shown less the true ``angle`` [rev], without the lines' own errors."""
        turn = 2.0 * np.pi * angle
        once = self.eccentricity * np.sin(turn + self.eccentricity_phase)
        return np.asarray((once + self.ovality * np.sin(2.0 * turn + self.ovality_phase)) / 360.0)


@dataclass(frozen=True)
class EncoderRig:
    """A machine of one ``seed``: ``orders`` (order, complex amplitude by channel at 1000 rpm, exponent of speed).

    ``modes`` (Hz, damping ratio, gain by channel), none where the shaft swings, for they would make lines of that;
    ``speeds_rpm`` of steady recordings, or the ends of a run-up where ``sweep_s`` is over 0. ``swing`` (order, degrees
    at the slowest speed, phase): a true one, which falls with speed². ``mesh`` (teeth, amplitude and phase modulation):
    of a gear whose wheel is set off.
    """

    seed: int
    kind: str
    rate_hz: float
    duration_s: float
    speeds_rpm: tuple[float, ...]
    sweep_s: float
    channels: int
    orders: tuple[tuple[float, tuple[complex, ...], float], ...]
    modes: tuple[tuple[float, float, tuple[float, ...]], ...]
    swing: tuple[int, float, float] | None
    mesh: tuple[int, float, float] | None
    noise: float
    encoder: Encoder

    def lines(self) -> dict[float, Complex]:
        """True complex amplitude (channel,) of every line at 1000 rpm before the modes, by order."""
        made = {order: np.asarray(size, dtype=complex) for order, size, _ in self.orders}
        if self.mesh is not None:
            teeth, swell, turned = self.mesh
            for side in (-1.0, 1.0):
                made[teeth + side] = made[float(teeth)] * 0.5 * (swell + 1j * turned)
        return made

    def exponent(self, order: float) -> float:
        """Power of the speed with which the line at ``order`` grows; sidebands grow as their mesh does."""
        known = {number: power for number, _, power in self.orders}
        return known[order] if order in known else known[float(self.mesh[0])] if self.mesh else 0.0

    def response(self, frequency_hz: Floats) -> Complex:
        """Signal over force (channel, frequency): 1 beside the modes."""
        total = np.ones((self.channels, len(frequency_hz)), dtype=complex)
        for natural, damping, gain in self.modes:
            ratio = frequency_hz / natural
            total += np.asarray(gain)[:, None] * ratio**2 / (1.0 - ratio**2 + 2j * damping * ratio)
        return total

    def amplitude(self, order: float, rpm: float) -> Complex:
        """True complex amplitude (channel,) of the line at ``order`` in steady running at ``rpm``."""
        size = self.lines()[order] * (rpm / 1000.0) ** self.exponent(order)
        return np.asarray(size * self.response(np.array([order * rpm / 60.0]))[:, 0])


def draw_rig(seed: int, kind: str | None = None) -> EncoderRig:
    """A rig of that ``seed``; its ``kind`` is drawn where it is not given."""
    chance = np.random.default_rng([seed, 5514])
    kind_drawn, eccentric = str(chance.choice(KINDS)), float(chance.uniform(0.0, 0.5) * (chance.random() < 0.7))
    kind = kind or kind_drawn
    sweep = float(chance.uniform(15.0, 30.0)) if chance.random() < 0.25 and kind == "healthy" else 0.0
    channels = int(chance.integers(1, 4))
    slow = float(chance.uniform(500.0, 1000.0))
    count = int(chance.integers(3, 9))
    speeds = tuple(float(s) for s in np.linspace(slow, slow * chance.uniform(2.0, 3.5), count))
    numbers = _numbers(chance, kind)
    orders = tuple((n, _sizes(chance, channels, 1.0 / n**0.3), float(chance.uniform(0.0, 2.0))) for n in numbers)
    mesh = None
    if kind == "gear":
        teeth = int(chance.integers(9, 19))
        orders = (*orders, (float(teeth), _sizes(chance, channels, 1.0), float(chance.uniform(0.0, 1.5))))
        mesh = (teeth, float(chance.uniform(0.05, 0.4)), float(chance.uniform(0.05, 0.4)))
    swing = None
    if kind == "swing":
        swing = (int(chance.integers(1, 5)), float(chance.uniform(0.1, 1.5)), float(chance.uniform(0.0, 6.28)))
    free = () if sweep or kind == "swing" else range(int(chance.integers(0, 4)))
    modes = tuple(_mode(chance, channels) for _ in free)
    pulses = int(chance.choice([1, 2, 36, 60, 120, 360, 720], p=[0.05, 0.05, 0.15, 0.2, 0.2, 0.2, 0.15]))
    encoder = Encoder(
        pulses, eccentric, float(chance.uniform(0.0, 2.0 * np.pi)),
        float(chance.uniform(0.0, 0.15) * (chance.random() < 0.3)), float(chance.uniform(0.0, 2.0 * np.pi)),
        float(chance.uniform(0.0, 0.1) * (chance.random() < 0.5)),
        float(chance.uniform(0.0, 0.02) * (chance.random() < 0.4)),
    )  # fmt: skip
    return EncoderRig(
        seed=seed, kind=kind, rate_hz=4096.0 if speeds[-1] < 2000.0 else 6400.0,
        duration_s=sweep or float(chance.uniform(6.0, 15.0)), speeds_rpm=(speeds[0], speeds[-1]) if sweep else speeds,
        sweep_s=sweep, channels=channels, orders=tuple(sorted(orders, key=lambda one: one[0])), modes=modes,
        swing=swing, mesh=mesh, noise=float(10.0 ** chance.uniform(-2.5, -0.7)), encoder=encoder,
    )  # fmt: skip


def _numbers(chance: np.random.Generator, kind: str) -> list[float]:
    """Orders of a machine: a few, or a comb; those of a gear's shaft are low, beside the mesh stand only its own."""
    if kind == "gear":
        return [float(n) for n in range(1, 1 + int(chance.integers(1, 5)))]
    if chance.random() < 0.5:
        return [float(n) for n in range(1, 1 + int(chance.integers(3, 13)))]
    every = chance.permutation(np.arange(2, 37))[: int(chance.integers(2, 9))]
    return sorted(0.5 * float(n) for n in every)


def _sizes(chance: np.random.Generator, channels: int, about: float) -> tuple[complex, ...]:
    size = about * chance.lognormal(0.0, 0.8) * chance.lognormal(0.0, 0.4, channels)
    return tuple(complex(one) for one in size * np.exp(2j * np.pi * chance.random(channels)))


def _mode(chance: np.random.Generator, channels: int) -> tuple[float, float, tuple[float, ...]]:
    gain = chance.normal(0.0, 0.5, channels)
    return float(chance.uniform(60.0, 500.0)), float(chance.uniform(0.01, 0.06)), tuple(float(one) for one in gain)


def quiet(rig: EncoderRig) -> EncoderRig:
    """``rig`` with an encoder that shows the angle as it is."""
    return replace(rig, encoder=Encoder(rig.encoder.pulses))


def write_rig(rig: EncoderRig, folder: Path) -> None:
    """Write the test of ``rig`` into the new ``folder``: HDF5 recordings and ``run.toml``."""
    folder.mkdir()
    chance = np.random.default_rng([rig.seed, 3])
    lines = 360.0 * rig.encoder.pulses
    uneven = rig.encoder.line_error / 360.0 * chance.standard_normal(rig.encoder.pulses) * (lines > 0.0)
    runs = [rig.speeds_rpm] if rig.sweep_s else [(rpm, rpm) for rpm in rig.speeds_rpm]
    for number, (first, last) in enumerate(runs):
        course = _Course(rig, first, last, float(chance.random()))
        with h5py.File(folder / f"rec_{number:03d}.h5", "w", libver=("v110", "v110")) as file:
            file.attrs["rate_hz"] = rig.rate_hz
            for name, row in enumerate(_signal(rig, course, chance)):
                file.create_dataset(f"acc_{name}", data=row.astype(np.float32)).attrs["unit"] = "m/s2"
            times, line = _pulse_times(rig, course, uneven, chance)
            file.create_dataset("pulse_time", data=times).attrs["unit"] = "s"
            file.create_dataset("index_time", data=times[line == 0]).attrs["unit"] = "s"
    (folder / "run.toml").write_text(_manifest(rig), encoding="utf-8")


class _Course:
    """Mean angle [rev] as a square of the time, and the true one, which swings about it."""

    def __init__(self, rig: EncoderRig, first_rpm: float, last_rpm: float, start_rev: float) -> None:
        self.rig, self.start = rig, start_rev
        self.first, self.rise = first_rpm / 60.0, (last_rpm - first_rpm) / 60.0 / rig.duration_s
        self.rpm = first_rpm

    def mean(self, time_s: Floats) -> Floats:
        return np.asarray(self.start + self.first * time_s + 0.5 * self.rise * time_s**2)

    def speed(self, time_s: Floats) -> Floats:
        return np.asarray(self.first + self.rise * time_s)

    def swing(self, mean_rev: Floats) -> Floats:
        if self.rig.swing is None:
            return np.zeros_like(mean_rev)
        order, size, phase = self.rig.swing
        size *= (self.rig.speeds_rpm[0] / self.rpm) ** 2 / 360.0
        return np.asarray(size * np.sin(2.0 * np.pi * order * mean_rev + phase))

    def time_of_mean(self, mean_rev: Floats) -> Floats:
        ahead = mean_rev - self.start
        root = np.sqrt(np.maximum(self.first**2 + 2.0 * self.rise * ahead, 0.0))
        return np.asarray(2.0 * ahead / (self.first + root))


def _signal(rig: EncoderRig, course: _Course, chance: np.random.Generator) -> Floats:
    """Samples (channel, sample): the lines in the true angle, through the modes, with white noise."""
    n = round(rig.duration_s * rig.rate_hz)
    before = n // 2 if rig.modes else 0  # what begins and ends beside the recording has died away
    time_s = np.arange(-before, n + before) / rig.rate_hz
    mean = course.mean(time_s)
    angle = mean + course.swing(mean)
    total = np.zeros((rig.channels, len(time_s)))
    for order, size in rig.lines().items():
        grown = (60.0 * course.speed(time_s) / 1000.0) ** rig.exponent(order)
        total += (size[:, None] * grown * np.exp(2j * np.pi * order * angle)).real
    if rig.modes:
        at = np.fft.rfftfreq(len(time_s), 1.0 / rig.rate_hz)
        ends = np.minimum(1.0, np.minimum(np.arange(len(time_s)), np.arange(len(time_s))[::-1]) / (0.2 * before))
        total = np.fft.irfft(np.fft.rfft(total * ends) * rig.response(at), len(time_s))
    usable = total[:, before : before + n]
    return np.asarray(usable + rig.noise * chance.standard_normal(usable.shape))


def _pulse_times(
    rig: EncoderRig, course: _Course, uneven: Floats, chance: np.random.Generator
) -> tuple[Floats, NDArray[np.int64]]:
    """Times [s] of the pulses, as counts of a clock, and the line that each is."""
    ends = course.mean(np.array([0.0, rig.duration_s]))
    number = np.arange(np.ceil(ends[0] * rig.encoder.pulses) + 2, np.floor(ends[1] * rig.encoder.pulses) - 2)
    line = np.mod(number, rig.encoder.pulses).astype(np.int64)
    wanted = number / rig.encoder.pulses - uneven[line]
    angle = wanted.copy()
    for _ in range(INVERSIONS):
        angle = wanted - rig.encoder.error_rev(angle)
    mean = angle.copy()
    for _ in range(INVERSIONS):
        mean = angle - course.swing(mean)
    times = course.time_of_mean(mean)
    times += rig.encoder.jitter / 360.0 * chance.standard_normal(len(times)) / course.speed(times)
    order = np.argsort(times, kind="stable")
    return np.round(times[order] * CLOCK_HZ) / CLOCK_HZ, line[order]


def _manifest(rig: EncoderRig) -> str:
    lines = [
        "schema_version = 1", f'[test]\nname = "encoder {rig.seed}"\ncycle = "two-stroke"',
        '[recordings]\nfiles = ["rec_*.h5"]', f'[sampling]\ndomain = "time"\nrate_hz = {rig.rate_hz!r}',
    ]  # fmt: skip
    lines += [
        f'[[channels]]\nname = "C{n}"\nsource = "acc_{n}"\nquantity = "acceleration"\nunit = "m/s2"'
        for n in range(rig.channels)
    ]
    index = 'index = "index_time"\n' if rig.encoder.pulses > 1 else ""
    lines.append(
        f'[encoder]\nsource = "pulse_time"\nkind = "pulse_times"\npulses_per_rev = {rig.encoder.pulses}\n'
        f"{index}index_to_tdc_deg = 0.0"
    )
    return "\n".join(lines) + "\n"
