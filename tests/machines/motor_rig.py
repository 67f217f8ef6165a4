"""Records of machines on the mains with drawn physics: induction motors, strays of the mains, tones that are neither.

Sources: A. H. Bonnett and G. C. Soukup (1992), IEEE Transactions on Industry Applications 28, p. 921 (rotor cages);
W. T. Thomson and A. Barbour (1998), IEEE Transactions on Energy Conversion 13, p. 347 (eccentricity); ISO 20958 (lines
of induction motors). Slip and its frequencies follow from the two field speeds alone and are reckoned here anew.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CLASSES = (
    "motor", "motor, several loads", "stray mains", "stray mains, run-up", "stray mains, steps",
    "stray mains, near speeds", "beside", "synchronous", "none", "tone", "drive",
)  # fmt: skip
"""A motor at one load or several; strays of the mains at one speed, many, or some that differ little; beside an order
of the shaft, and on one; no mains at all; a tone that is not mains; a motor on a converter, of no fixed supply."""

CONDITIONS = ("healthy", "broken bar", "static eccentricity", "dynamic eccentricity")
RATE_HZ = 8192.0


@dataclass(frozen=True)
class Line:
    """A sinusoid: ``size`` is its peak over the noise's rms; its frequency is ``hz`` plus ``order`` turns of the shaft.

    ``cause``: "mains" (``multiple`` times it), "shaft" (``multiple``), "tone", "bar pass", "bar pass sideband",
    "pole pass sideband of 1x" or "pole pass sideband of 2f". ``side``: -1 below its carrier, 1 above.
    """

    cause: str
    size: float
    hz: float = 0.0
    order: float = 0.0
    multiple: int = 1
    side: int = 0

    def at(self, rpm: float) -> float:
        """Frequency in Hz at a speed of ``rpm``."""
        return abs(self.hz + self.order * rpm / 60.0)


@dataclass(frozen=True)
class Take:
    """One recording: speed at its begin and its end, rpm, for so many seconds, and the ``lines`` in it."""

    rpm: tuple[float, float]
    duration_s: float
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class MotorRig:
    """A machine near the mains of ``supply_hz`` (nominal), which are off by the share ``grid``.

    ``poles`` and ``rotor_bars`` are those of its motor, ``slips`` those of its ``takes``, as shares of the synchronous
    speed; 0 poles: no motor. ``stated``: whether the manifest names the motor.
    """

    seed: int
    class_name: str
    condition: str
    supply_hz: float
    grid: float
    poles: int
    rotor_bars: int
    slips: tuple[float, ...]
    stated: bool
    takes: tuple[Take, ...]
    colour: float

    @property
    def mains_hz(self) -> float:
        """Frequency of the mains as they are."""
        return self.supply_hz * (1.0 + self.grid)


def draw_rig(seed: int, class_name: str | None = None) -> MotorRig:
    """A rig of that ``seed``; its class is drawn where ``class_name`` does not give it."""
    chance = np.random.default_rng([seed, 3301])
    class_name = class_name or str(chance.choice(CLASSES))
    supply = float(chance.choice([50.0, 60.0]))
    rig = MotorRig(
        seed=seed, class_name=class_name, condition=str(chance.choice(CONDITIONS)), supply_hz=supply,
        grid=float(chance.uniform(-2e-3, 2e-3)), poles=int(chance.choice([2, 4, 6, 8])),
        rotor_bars=int(chance.integers(22, 60)), slips=(), stated=class_name.startswith(("motor", "drive")), takes=(),
        colour=float(chance.choice([0.0, 0.5, 0.9])),
    )  # fmt: skip
    if class_name.startswith("motor"):
        return _motor(rig, chance)
    if class_name == "drive":
        return _drive(rig, chance)
    return _other(replace(rig, condition="healthy", poles=0, rotor_bars=0), chance)


def _motor(rig: MotorRig, chance: np.random.Generator) -> MotorRig:
    """The motor at one load, or at several, whose slips go from a fifth of the rated one to all of it."""
    rated = float(np.exp(chance.uniform(np.log(0.004), np.log(0.06))))
    count = 1 if rig.class_name == "motor" else int(chance.integers(3, 6))
    shares = [float(chance.uniform(0.5, 1.0))] if count == 1 else np.linspace(0.2, 1.0, count).tolist()
    slips = tuple(max(0.002, rated * share) for share in shares)
    own = _motor_lines(rig, chance)
    turns = [(2.0 * rig.mains_hz / rig.poles * (1.0 - slip)) * 60.0 for slip in slips]
    takes = tuple(
        Take((rpm, rpm), float(chance.uniform(30.0, 60.0)), _with_pole_pass(rig, own, slip, 0.4 + 0.6 * slip / rated))
        for rpm, slip in zip(turns, slips, strict=True)
    )
    return replace(rig, slips=slips, takes=takes)


def _motor_lines(rig: MotorRig, chance: np.random.Generator) -> list[Line]:
    f, bars = rig.mains_hz, rig.rotor_bars
    lines = [Line("shaft", float(chance.uniform(1.0, 4.0)) / k, order=float(k), multiple=k) for k in (1, 2, 3)]
    double = 3.0 if rig.condition == "static eccentricity" else 0.7
    lines.append(Line("mains", double * float(chance.uniform(0.5, 1.5)), hz=2.0 * f, multiple=2))
    if rig.condition in ("broken bar", "dynamic eccentricity") or chance.random() < 0.5:
        size = float(chance.uniform(0.2, 0.8))
        lines.append(Line("bar pass", size, order=float(bars)))
        for side in (-2.0, 2.0):
            share = float(chance.uniform(0.3, 0.7))
            lines.append(
                Line("bar pass sideband", share * size, order=float(bars), hz=side * f, side=int(np.sign(side)))
            )
    return lines


def _with_pole_pass(rig: MotorRig, lines: list[Line], slip: float, share: float) -> tuple[Line, ...]:
    """``lines`` with what the slip makes of them: the pole pass is poles times the rotor's lag, 2 x slip x supply."""
    pole_pass = 2.0 * slip * rig.mains_hz
    made = list(lines)
    for line in lines:
        cracked = rig.condition == "broken bar" and line.cause == "shaft" and line.multiple == 1
        eccentric = rig.condition == "dynamic eccentricity" and line.cause == "mains"
        if cracked or eccentric:
            name = "pole pass sideband of 1x" if cracked else "pole pass sideband of 2f"
            made += [
                Line(name, 0.3 * share * line.size, hz=line.hz + side * pole_pass, order=line.order, side=side)
                for side in (-1, 1)
            ]
    return tuple(made)


def _drive(rig: MotorRig, chance: np.random.Generator) -> MotorRig:
    """A motor on a converter at several speeds: nothing is at the mains, bars pass at a whole order."""
    rpm = np.linspace(900.0, float(chance.uniform(1800.0, 2700.0)), 6)
    lines = [Line("shaft", float(chance.uniform(1.0, 3.0)) / k, order=float(k), multiple=k) for k in (1, 2, 3)]
    lines.append(Line("bar pass", float(chance.uniform(0.3, 1.0)), order=float(rig.rotor_bars)))
    takes = tuple(Take((float(one), float(one)), 15.0, tuple(lines)) for one in rpm)
    return replace(rig, condition="healthy", takes=takes)


def _other(rig: MotorRig, chance: np.random.Generator) -> MotorRig:
    """A shaft of a speed of its own, with strays of the mains, a tone that is none, or neither."""
    f = rig.mains_hz
    rpm = float(chance.uniform(900.0, 3600.0))
    lines = [Line("shaft", float(chance.uniform(1.0, 4.0)) / k, order=float(k), multiple=k) for k in (1, 2, 3)]
    if rig.class_name in ("beside", "synchronous"):  # a generator on the grid: an order of the shaft is mains
        multiple, order = int(chance.integers(1, 3)), int(chance.integers(1, 4))
        rpm = 60.0 * multiple * f / order
        if rig.class_name == "beside":  # as 2990 rpm beside 50 Hz: an order 0.3 to 1.5 % from a multiple of the mains
            rpm *= 1.0 + float(chance.choice([-1, 1])) * float(chance.uniform(0.003, 0.015))
        lines.append(Line("mains", float(chance.uniform(0.3, 2.0)), hz=multiple * f, multiple=multiple))
    elif rig.class_name == "tone":
        base = f
        while any(abs(base - k * mains) < 0.012 * k * mains for mains in (50.0, 60.0) for k in (1, 2, 3, 4)):
            away = float(chance.choice([-1, 1])) * float(chance.uniform(0.012, 0.2))
            base = f * int(chance.integers(1, 3)) * (1.0 + away)
        lines.append(Line("tone", float(chance.uniform(0.3, 2.0)), hz=base))
    elif rig.class_name.startswith("stray"):
        for multiple in ((1,), (2,), (1, 2), (1, 2, 3))[int(chance.integers(0, 4))]:
            lines.append(Line("mains", float(chance.uniform(0.3, 2.0)), hz=multiple * f, multiple=multiple))
    return replace(rig, takes=_takes(rig, rpm, tuple(lines), chance))


def _takes(rig: MotorRig, rpm: float, lines: tuple[Line, ...], chance: np.random.Generator) -> tuple[Take, ...]:
    """One recording at ``rpm``, a run-up from there, steps, or speeds that differ by a few percent."""
    top = rpm * float(chance.uniform(1.4, 2.0))
    if rig.class_name.endswith("run-up"):
        return (Take((rpm, top), 60.0, lines),)
    if rig.class_name.endswith("steps"):
        return tuple(Take((float(n), float(n)), 15.0, lines) for n in np.linspace(rpm, top, 8))
    if rig.class_name.endswith("near speeds"):
        return tuple(Take((rpm * share, rpm * share), 25.0, lines) for share in (1.0, 1.013, 1.027))
    return (Take((rpm, rpm), float(chance.uniform(20.0, 60.0)), lines),)


def noise(chance: np.random.Generator, count: int, rate_hz: float, *, colour: float, corner_hz: float) -> Floats:
    """Noise (``count``,) of rms 1: white, with the share ``colour`` of one that falls above ``corner_hz``."""
    white = chance.standard_normal(count)
    if not colour:
        return white
    spectrum = np.fft.rfft(chance.standard_normal(count))
    coloured = np.fft.irfft(spectrum / np.hypot(1.0, np.fft.rfftfreq(count, 1.0 / rate_hz) / corner_hz), count)
    return np.asarray(np.sqrt(1.0 - colour**2) * white + colour * coloured / coloured.std())


def samples(rig: MotorRig, take: Take, number: int) -> tuple[Floats, Floats]:
    """Acceleration (samples,) of the ``take`` that is ``number`` of ``rig``, in noise of rms 1; crank angle in rev."""
    chance = np.random.default_rng([rig.seed, 11, number])
    time_s = np.arange(round(take.duration_s * RATE_HZ)) / RATE_HZ
    first, last = (rpm / 60.0 for rpm in take.rpm)
    angle = first * time_s + 0.5 * (last - first) * time_s**2 / take.duration_s
    signal = noise(chance, len(time_s), RATE_HZ, colour=rig.colour, corner_hz=200.0)
    for line in take.lines:
        signal += line.size * np.cos(2.0 * np.pi * (line.hz * time_s + line.order * angle + chance.random()))
    return signal, angle


def write_folder(rig: MotorRig, folder: Path) -> None:
    """Write the test of ``rig`` into the new ``folder``, with ``run.toml``."""
    folder.mkdir(parents=True)
    for number, take in enumerate(rig.takes):
        signal, angle = samples(rig, take, number)
        with h5py.File(folder / f"rec_{number:03d}.h5", "w") as file:
            file.create_dataset("acc", data=signal.astype(np.float32)).attrs["unit"] = "m/s2"
            time_s = np.arange(len(signal)) / RATE_HZ
            marks = np.arange(1, int(angle[-1]))
            file.create_dataset("mark", data=np.interp(marks, angle, time_s)).attrs["unit"] = "s"
    (folder / "run.toml").write_text(manifest(rig), encoding="utf-8")


def manifest(rig: MotorRig) -> str:
    """Text of ``run.toml`` for the test of ``rig``."""
    text = f"""schema_version = 1
[test]
name = "{rig.class_name} {rig.seed}"
cycle = "rotor"
[recordings]
files = ["rec_*.h5"]
[sampling]
rate_hz = {RATE_HZ!r}
[[channels]]
name = "Z"
source = "acc"
unit = "m/s2"
[encoder]
source = "mark"
kind = "pulse_times"
pulses_per_rev = 1
"""
    if not rig.stated:
        return text
    supply = "" if rig.class_name == "drive" else f"supply_hz = {rig.supply_hz}\n"
    return f"{text}[motor]\n{supply}poles = {rig.poles}\nrotor_bars = {rig.rotor_bars}\n"
