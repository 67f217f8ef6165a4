"""Records of bearing rigs with drawn physics: strikes that wander, a load zone, a resonance, and what else is heard.

Sources: J. Antoni and R. B. Randall (2003), Journal of Vibration and Acoustics 125, p. 282 (strikes whose intervals are
random are no exact period); P. D. McFadden and J. D. Smith (1984), Journal of Sound and Vibration 96, p. 69 (the load
zone of Stribeck, through which a damage of the inner race or of a rolling element passes).
"""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.engine.machine_parts import Bearing
from machines.motor_rig import noise
from made.strikes import recording

Floats = NDArray[np.float64]

FAULTS = ("outer", "inner", "ball", "cage")
LINE_OF = {"outer": "BPFO", "inner": "BPFI", "ball": "BSF", "cage": "FTF"}
LOAD_EXPONENT = 1.5
"""Power of the deflection that the load of a ball has (Hertz)."""


@dataclass(frozen=True)
class BearingRig:
    """A shaft in a bearing that is ``fault``-y ("none": sound); rates in Hz, sizes as multiples of the noise's rms.

    ``size`` is the largest peak of a strike; ``slip`` how much slower than in pure rolling the cage turns, as a share;
    ``jitter`` the standard deviation of the way from one strike to the next, as a share of it; ``load_zone`` the
    load distribution factor of Stribeck; ``speed_error`` by how much the stated speed is above the true one.
    """

    seed: int
    fault: str
    size: float
    rate_hz: float
    duration_s: float
    speed_rpm: float
    speed_error: float
    elements: int
    ball_over_pitch: float
    slip: float
    jitter: float
    load_zone: float
    resonance_hz: float
    damping_ratio: float
    second_resonance: tuple[float, float]
    orders: tuple[tuple[float, float], ...]
    mains_hz: float
    mains: tuple[float, ...]
    mesh: tuple[int, float] | None
    colour: float
    swell: float
    shocks_per_s: float

    @property
    def cage(self) -> float:
        """Order of the cage, slip included."""
        return 0.5 * (1.0 - self.ball_over_pitch) * (1.0 - self.slip)

    @property
    def order(self) -> float:
        """Order at which the damage shows: that of the race, of the cage, or twice the turn of a rolling element."""
        spin = (1.0 - self.cage) * (1.0 - self.ball_over_pitch) / self.ball_over_pitch
        return {
            "outer": self.elements * self.cage, "inner": self.elements * (1.0 - self.cage), "ball": 2.0 * spin,
            "cage": self.cage, "none": 0.0,
        }[self.fault]  # fmt: skip

    @property
    def bearing(self) -> Bearing:
        """The bearing as a manifest states it."""
        return Bearing(name="rig", rolling_elements=self.elements, ball_over_pitch=self.ball_over_pitch)


def draw_rig(seed: int, fault: str | None = None, size: float | None = None) -> BearingRig:
    """A rig of that ``seed``; ``fault`` ("none": sound) and ``size`` are drawn where they are not given."""
    chance = np.random.default_rng([seed, 7141])
    fault_drawn = str(chance.choice(FAULTS))
    size_drawn = float(np.exp(chance.uniform(np.log(0.15), np.log(6.0))))
    rate = float(chance.choice([12_000.0, 20_480.0, 25_600.0, 48_828.0, 51_200.0, 100_000.0]))
    longest = min(20.0, 6e5 / rate)
    duration = float(np.exp(chance.uniform(0.0, np.log(longest))))
    slowest = 60.0 * 24.0 / duration
    speed = float(np.exp(chance.uniform(np.log(max(600.0, slowest)), np.log(3600.0))))
    elements = int(chance.integers(7, 17))
    orders = tuple((float(k), float(chance.lognormal(-0.5, 1.0) / k)) for k in range(1, 5))
    return BearingRig(
        seed=seed, fault=fault or fault_drawn, size=size if size is not None else size_drawn, rate_hz=rate,
        duration_s=duration, speed_rpm=speed, speed_error=0.0, elements=elements,
        ball_over_pitch=float(chance.uniform(0.14, min(0.32, 2.4 / elements))), slip=float(chance.uniform(0.0, 0.014)),
        jitter=float(chance.uniform(0.002, 0.015)), load_zone=float(chance.uniform(0.3, 0.7)),
        resonance_hz=float(chance.uniform(2000.0, min(6000.0, 0.4 * rate))),
        damping_ratio=float(chance.uniform(0.02, 0.08)),
        second_resonance=(float(chance.uniform(1500.0, 0.42 * rate)), float(chance.uniform(0.0, 0.5))), orders=orders,
        mains_hz=float(chance.choice([50.0, 60.0])),
        mains=tuple(float(chance.lognormal(-2.0, 1.0)) * (chance.random() < 0.6) for _ in range(12)),
        mesh=(int(chance.integers(17, 40)), float(chance.lognormal(-1.0, 0.7))) if chance.random() < 0.25 else None,
        colour=float(chance.choice([0.0, 0.5, 0.9])), swell=float(chance.uniform(0.0, 0.4)) * (chance.random() < 0.3),
        shocks_per_s=float(chance.uniform(0.0, 5.0)) * (chance.random() < 0.2),
    )  # fmt: skip


def recorded(rig: BearingRig) -> tuple[xr.Dataset, xr.Dataset]:
    """Recording and ShaftAngle of ``rig``, the latter at the stated speed."""
    signal = samples(rig)
    stated = rig.speed_rpm * (1.0 + rig.speed_error)
    made, angle = recording(signal[None], rate_hz=rig.rate_hz, speed_rpm=stated)
    if rig.speed_error:
        made.attrs["encoder_kind"] = "constant"
    return made, angle


def samples(rig: BearingRig) -> Floats:
    """Acceleration (samples,) of ``rig``; its noise has a root mean square of 1."""
    chance = np.random.default_rng([rig.seed, 9])
    time_s = np.arange(round(rig.duration_s * rig.rate_hz)) / rig.rate_hz
    angle = time_s * rig.speed_rpm / 60.0
    signal = _noise(rig, time_s, angle, chance)
    for order, size in rig.orders:
        signal += size * np.cos(2.0 * np.pi * (order * angle + chance.random()))
    for k, size in enumerate(rig.mains, start=1):
        signal += size * np.cos(2.0 * np.pi * (k * rig.mains_hz * time_s + chance.random()))
    if rig.mesh is not None:
        teeth, size = rig.mesh
        wave = 1.0 + 0.3 * np.cos(2.0 * np.pi * (angle + chance.random()))
        signal += sum(size / k * wave * np.cos(2.0 * np.pi * (k * teeth * angle + chance.random())) for k in (1, 2))
    if rig.shocks_per_s:
        count = int(chance.poisson(rig.shocks_per_s * rig.duration_s))
        signal += _rung(rig, time_s, rig.duration_s * chance.random(count), 5.0 * chance.standard_normal(count))
    if rig.fault != "none":
        signal += _rung(rig, time_s, *_strikes(rig, chance))
    return signal


def _noise(rig: BearingRig, time_s: Floats, angle: Floats, chance: np.random.Generator) -> Floats:
    """White noise with a share of a coloured one, which swells once a turn of the shaft."""
    even = noise(chance, len(time_s), rig.rate_hz, colour=rig.colour, corner_hz=800.0)
    return np.asarray(even * (1.0 + rig.swell * np.cos(2.0 * np.pi * angle)))


def _strikes(rig: BearingRig, chance: np.random.Generator) -> tuple[Floats, Floats]:
    """Times [s] and heights of the strikes, the largest about ``size``."""
    period_s = 60.0 / rig.speed_rpm / rig.order
    steps = 1.0 + rig.jitter * chance.standard_normal(int(rig.duration_s / period_s) + 20)
    times = (np.cumsum(steps) - 10.0 * chance.random()) * period_s
    height = 1.0 + 0.15 * chance.standard_normal(len(times))
    turn = times * rig.speed_rpm / 60.0 + chance.random()
    if rig.fault == "inner":
        height *= _load(rig, turn)
    elif rig.fault == "ball":
        both = np.where(np.arange(len(times)) % 2, 1.0, chance.uniform(0.5, 1.0))
        height *= both * (0.15 + 0.85 * _load(rig, rig.cage * turn))
    return times, rig.size * height


def _load(rig: BearingRig, turn: Floats) -> Floats:
    """Load on an element at each ``turn`` beside the largest (Stribeck)."""
    depth = 1.0 - (1.0 - np.cos(2.0 * np.pi * turn)) / (2.0 * rig.load_zone)
    return np.asarray(np.maximum(depth, 0.0) ** LOAD_EXPONENT)


def _rung(rig: BearingRig, time_s: Floats, times: Floats, heights: Floats) -> Floats:
    """What the resonances make of strikes at ``times`` of ``heights``: damped waves, begun between the samples."""
    signal = np.zeros(len(time_s))
    second_hz, share = rig.second_resonance
    for frequency, size in ((rig.resonance_hz, 1.0), (second_hz, share)):
        decay = 2.0 * np.pi * frequency * rig.damping_ratio
        since = np.arange(int(8.0 / decay * rig.rate_hz) + 1) / rig.rate_hz
        for at, height in zip(times, heights, strict=True):
            first = int(np.ceil(at * rig.rate_hz))
            begin, end = max(first, 0), min(first + len(since), len(signal))
            if end > begin:
                after = since[begin - first : end - first] + first / rig.rate_hz - at
                signal[begin:end] += size * height * np.exp(-decay * after) * np.sin(2.0 * np.pi * frequency * after)
    return signal


def sound(rig: BearingRig) -> BearingRig:
    """``rig`` with no damage."""
    return replace(rig, fault="none")
