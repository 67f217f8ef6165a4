"""Machines drawn at random, class by class: what the field's tests look like, and what makes them hard."""

from dataclasses import replace

import numpy as np

from machines.machine import Encoder, FloatArray, Machine, Mode, Order, Profile, Swing, Tone

CLASSES = (
    "stepped", "stepped few", "coarse steps", "one speed", "on resonance", "run-up", "run-down", "through zero",
    "step in sweep", "repeated sweep", "up and down, toothed wheel", "swing, held", "swing, swept", "one pulse",
    "two speeds", "twice mains",
)  # fmt: skip
"""A class draws the same machines as long as it keeps its place here."""
STEADY = (*CLASSES[:5], "swing, held", "twice mains")
FEW_SPEEDS = {
    "stepped": (25, 51), "stepped few": (3, 13), "coarse steps": (8, 21), "swing, held": (3, 13), "one pulse": (3, 13),
    "twice mains": (1, 6),
}  # fmt: skip
"""Least and most steady speeds (the last left out) of the classes that have some."""
LOWEST_MODE_HZ, HIGHEST_MODE_HZ = 25.0, 450.0
MOST_SAMPLES = 1_500_000
"""Of one channel over a whole test, so that a test takes seconds."""
CLOSEST_ORDERS, LONGEST_BEAT = 0.025, 1.5
"""Orders are at least so far apart, and a steady recording lasts so many beats of the two closest."""
SWINGING = ("swing, held", "swing, swept")
QUIET_CHANCE, QUIET = 0.5, 1e-6
"""How often noise is so much smaller than order 1 (120 dB) where the shaft swings."""
LEAST_SWING, MOST_SWING = 0.002, 0.1
"""Swing of the speed within the cycle at the slowest speed, as a share of it."""
SLIP = (0.008, 0.04)
"""Of machines on the mains: the mains' line and the order beside it beat at least once in each recording."""
GEAR_CHANCE, RING_CHANCE = 0.12, 0.15
RATES_HZ = (2000.0, 2560.0, 4096.0, 5000.0, 6400.0, 8192.0, 10240.0, 12800.0, 20000.0, 25600.0)


WHEELS = (
    ("360", 360, 0), ("60", 60, 0), ("60-2", 60, 2), ("1 per rev", 1, 0), ("speed", 0, 0), ("36-1", 36, 1),
    ("120", 120, 0),
)  # fmt: skip
"""Name, pulses per revolution and teeth that are missing; "speed": the output of a tachometer."""
ANY_WHEEL = (0.2, 0.25, 0.2, 0.15, 0.2, 0.0, 0.0)
WHEEL_CHANCES = {
    "up and down, toothed wheel": (0.0, 0.2, 0.3, 0.0, 0.0, 0.3, 0.2),
    "swing, held": (0.4, 0.2, 0.2, 0.0, 0.0, 0.1, 0.1),
    "swing, swept": (0.4, 0.2, 0.2, 0.0, 0.0, 0.1, 0.1),
    "one pulse": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
}


def draw_machine(class_name: str, seed: int) -> Machine:
    """The machine of ``class_name`` (one of CLASSES) that ``seed`` gives: the same on every computer."""
    rng = np.random.default_rng([seed, CLASSES.index(class_name)])
    n_channels = int(rng.integers(1, 4))
    teeth = int(rng.integers(21, 46)) if rng.random() < GEAR_CHANCE else 0
    numbers = _order_numbers(rng, teeth)
    if class_name in SWINGING:
        numbers = tuple(sorted({1.0, *(number for number in numbers if abs(number - 1.0) > CLOSEST_ORDERS)}))
    speeds = _speed_range(rng, class_name)
    mains_hz = float(rng.choice([50.0, 60.0]))
    has_mains = bool(rng.random() < 0.4)
    sources = int(rng.integers(1, 4)) if rng.random() < _broadband_chance(class_name) else 0
    modes = _modes(rng, class_name, numbers, speeds, n_channels, sources, mains_hz if has_mains else None)
    profiles = _profiles(rng, class_name, speeds, numbers, modes, mains_hz)
    fastest = max(rpm for profile in profiles for rpm in profile.rpm)
    needed_hz = 2.56 * max(1.1 * max(mode.frequency_hz for mode in modes), 1.02 * max(numbers) * fastest / 60.0)
    total_s = sum(profile.duration_s for profile in profiles)
    rate_hz, encoder = _sampling(rng, class_name, needed_hz, total_s, fastest)
    machine = Machine(
        class_name=class_name, seed=seed, rate_hz=rate_hz, channels=("X", "Y", "Z")[:n_channels], modes=modes,
        orders=tuple(_order(rng, number, n_channels, class_name) for number in numbers), tones=(), profiles=profiles,
        encoder=encoder, noise_density=(1.0,) * n_channels, force_density=(1.0,) * sources, mains_hz=mains_hz,
        steady=all(profile.rpm[0] == profile.rpm[-1] and len(profile.rpm) == 2 for profile in profiles),
        gear_teeth=teeth,
    )  # fmt: skip
    return _with_levels(rng, machine, has_mains)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _broadband_chance(class_name: str) -> float:
    return 0.25 if class_name in ("coarse steps", "on resonance") else 0.5


def _order_numbers(rng: np.random.Generator, teeth: int) -> tuple[float, ...]:
    """Two to five half orders up to 12, sometimes with one that slips or a close neighbour; the mesh of ``teeth``."""
    chosen = set(rng.choice(np.arange(1, 25), size=int(rng.integers(2, 6)), replace=False) / 2.0)
    if rng.random() < 0.3:
        base = float(rng.choice(np.arange(3, 24))) / 2.0
        slipping = round(base * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.003, 0.02)), 4)
        if min(abs(slipping - number) for number in chosen) >= CLOSEST_ORDERS:
            chosen.add(slipping)
    if rng.random() < 0.15:
        half = float(rng.choice([2.5, 3.5, 5.5, 7.5]))
        chosen |= {half, round(half * (1.0 - rng.uniform(0.005, 0.012)), 4)}
    if teeth:
        chosen.add(float(teeth))
    return tuple(float(number) for number in sorted(chosen))


def _speed_range(rng: np.random.Generator, class_name: str) -> tuple[float, float]:
    low = _log_uniform(rng, 500.0, 1500.0)
    return low, min(low * rng.uniform(1.8, 4.0), 5500.0)


def _modes(
    rng: np.random.Generator, class_name: str, numbers: tuple[float, ...], speeds: tuple[float, float], n_channels: int,
    sources: int, mains_hz: float | None,
) -> tuple[Mode, ...]:  # fmt: skip
    count = int(rng.integers(1, 9)) if class_name in ("stepped", "run-up", "run-down") else int(rng.integers(1, 6))
    light = class_name == "coarse steps"
    frequency: list[float] = []
    for _ in range(count):
        met = float(rng.choice(numbers)) * rng.uniform(*speeds) / 60.0
        free = _log_uniform(rng, LOWEST_MODE_HZ, HIGHEST_MODE_HZ)
        frequency.append(met if rng.random() < 0.7 and LOWEST_MODE_HZ < met < HIGHEST_MODE_HZ else free)
    damping = [_log_uniform(rng, 0.002, 0.01 if light else 0.1) for _ in frequency]
    if rng.random() < 0.2:  # a close pair, both light enough to be two
        frequency.append(frequency[0] + rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.5))
        damping[0] = _log_uniform(rng, 0.002, 0.008)
        damping.append(_log_uniform(rng, 0.002, 0.008))
    if mains_hz is not None and rng.random() < 0.4:  # beside the mains line
        frequency.append(mains_hz * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.003, 0.02)))
        damping.append(_log_uniform(rng, 0.002, 0.02))
    turned = rng.random() < 0.3
    return tuple(
        _mode(rng, f, z, n_channels, len(numbers), sources, turned)
        for f, z in sorted(zip(frequency, damping, strict=True))
    )


def _mode(
    rng: np.random.Generator, f: float, z: float, n_channels: int, n_orders: int, sources: int, turned: bool
) -> Mode:
    lean = rng.uniform(-0.4, 0.4, n_channels) if turned else np.zeros(n_channels)
    shape = 0.02 * rng.choice([-1.0, 1.0], n_channels) * rng.uniform(0.2, 1.5, n_channels) * np.exp(1j * lean)
    drive = rng.choice([-1.0, 1.0], n_orders) * rng.uniform(0.1, 1.5, n_orders)
    gains = rng.choice([-1.0, 1.0], sources) * rng.uniform(0.3, 1.5, sources)
    return Mode(
        float(f), float(z), tuple(complex(value) for value in shape), tuple(complex(value) for value in drive),
        tuple(float(value) for value in gains),
    )  # fmt: skip


def _order(rng: np.random.Generator, number: float, n_channels: int, class_name: str) -> Order:
    """Force law and direct path; the size is set later, when the response is known."""
    through_zero = class_name == "through zero"  # a force that stays at standstill would be a weight
    return Order(
        order=number, constant=0.0 if through_zero else float(rng.uniform(0.0, 1.0)),
        growth=float(rng.uniform(0.2, 1.0)), exponent=float(rng.uniform(1.0, 2.5)),
        phase_deg=float(rng.uniform(-180.0, 180.0)), phase_deg_per_krpm=float(rng.uniform(-10.0, 10.0)),
        direct=tuple(complex(value) for value in 0.02 * rng.standard_normal(n_channels)),
    )  # fmt: skip


def _profiles(
    rng: np.random.Generator, class_name: str, speeds: tuple[float, float], numbers: tuple[float, ...],
    modes: tuple[Mode, ...], mains_hz: float,
) -> tuple[Profile, ...]:  # fmt: skip
    if class_name == "two speeds":
        return (_two_speeds(rng, speeds),)
    if class_name in STEADY or (class_name == "one pulse" and rng.random() < 0.5):
        means = _steady_speeds(rng, class_name, speeds, numbers, modes, mains_hz)
        shortest = rng.uniform(5.0, 15.0) if len(means) <= 3 else rng.uniform(2.0, 4.0)
        beat = LONGEST_BEAT / float(np.diff(numbers).min()) if len(numbers) > 1 else 0.0
        held = tuple(_steady(rng, rpm, max(shortest, max(40.0, beat) * 60.0 / rpm)) for rpm in means)
        return _swinging(rng, held) if class_name in SWINGING else held
    time_s, rpm = _sweep(rng, class_name, speeds)
    repeats = int(rng.integers(2, 5)) if class_name == "repeated sweep" else 1
    profiles = []
    for _ in range(repeats):
        stretch = 1.0 if repeats == 1 else rng.uniform(0.95, 1.05)
        knots = tuple(round(float(stretch * value), 3) for value in time_s)
        profiles.append(Profile(knots, tuple(float(value) for value in rpm), float(rng.uniform(0.0, 2.0))))
    if class_name == "up and down, toothed wheel":
        return _up_and_down(rng, profiles[0])
    return _swinging(rng, tuple(profiles)) if class_name in SWINGING else tuple(profiles)


def _two_speeds(rng: np.random.Generator, speeds: tuple[float, float]) -> Profile:
    """One recording that keeps one speed, changes it within seconds and keeps the other."""
    first, second, change = rng.uniform(4.0, 20.0), rng.uniform(4.0, 20.0), rng.uniform(0.5, 3.0)
    low, high = speeds
    pair = (low, rng.uniform(min(1.05 * low, high), high))
    knots = (0.0, *(round(float(end), 3) for end in np.cumsum([first, change, second])))
    one, other = (float(rpm) for rpm in (pair if rng.random() < 0.5 else pair[::-1]))
    return Profile(knots, (one, one, other, other), float(rng.uniform(0.0, 2.0)))


def _up_and_down(rng: np.random.Generator, up: Profile) -> tuple[Profile, ...]:
    """``up`` and the same way down: as a second recording, or in the same one after a while at the top."""
    slower = rng.uniform(0.6, 1.7)
    down = round(slower * up.duration_s, 3)
    if rng.random() < 0.5:
        return up, Profile((0.0, down), up.rpm[::-1], float(rng.uniform(0.0, 2.0)))
    still = round(float(rng.uniform(0.3, 3.0)), 3)
    knots = (0.0, up.duration_s, up.duration_s + still, up.duration_s + still + down)
    return (replace(up, time_s=knots, rpm=(*up.rpm, *up.rpm[::-1])),)


def _swinging(rng: np.random.Generator, profiles: tuple[Profile, ...]) -> tuple[Profile, ...]:
    """``profiles`` of a shaft that gas torque swings within the cycle, one to six times in two revolutions."""
    order = float(rng.integers(1, 7)) / 2.0
    slowest = min(rpm for profile in profiles for rpm in profile.rpm)
    size = _log_uniform(rng, LEAST_SWING, MOST_SWING) / (2.0 * np.pi * order)
    swing = Swing(order, float(size), slowest, float(rng.uniform(0.0, 2.0 * np.pi)))
    return tuple(replace(profile, swing=swing) for profile in profiles)


def _steady(rng: np.random.Generator, rpm: float, duration_s: float) -> Profile:
    wander = rpm * _log_uniform(rng, 1e-5, 1e-3)
    length = round(duration_s, 2)
    return Profile(
        (0.0, length), (rpm, rpm), float(rng.uniform(0.0, 2.0)), wander, float(rng.uniform(0.1, 1.0)),
        float(rng.uniform(0.0, 2.0 * np.pi)),
    )  # fmt: skip


def _steady_speeds(
    rng: np.random.Generator, class_name: str, speeds: tuple[float, float], numbers: tuple[float, ...],
    modes: tuple[Mode, ...], mains_hz: float,
) -> list[float]:  # fmt: skip
    low, high = speeds
    if class_name == "one speed":
        return [float(rng.uniform(low, high))]
    if class_name == "on resonance":
        return _resonant_speeds(rng, numbers, modes)
    number = int(rng.integers(*FEW_SPEEDS[class_name]))
    if class_name == "twice mains" and rng.random() < 0.5:  # beside synchronous speed, as most machines on the mains
        synchronous = 60.0 * mains_hz / float(rng.integers(1, 4))
        return sorted(float(synchronous * (1.0 - rng.uniform(*SLIP))) for _ in range(number))
    if number == 1:
        return [float(rng.uniform(low, high))]
    if class_name == "coarse steps":
        high = min(low + number * rng.uniform(60.0, 200.0), 5500.0)
    even = np.linspace(low, high, number)
    step = even[1] - even[0]
    return [float(value) for value in even + 0.1 * step * rng.uniform(-1.0, 1.0, number)]


def _resonant_speeds(rng: np.random.Generator, numbers: tuple[float, ...], modes: tuple[Mode, ...]) -> list[float]:
    """One to three speeds, each within the half-power width of a mode that an order meets there."""
    met = [
        (60.0 * mode.frequency_hz / number, mode.damping_ratio)
        for mode in modes
        for number in numbers
        if 400.0 < 60.0 * mode.frequency_hz / number < 5500.0
    ]
    if not met:
        met = [(60.0 * modes[0].frequency_hz / numbers[0], modes[0].damping_ratio)]
    chosen = rng.choice(len(met), size=min(len(met), int(rng.integers(1, 4))), replace=False)
    return sorted(float(met[at][0] * (1.0 + 0.5 * met[at][1] * rng.uniform(-1.0, 1.0))) for at in chosen)


def _sweep(rng: np.random.Generator, class_name: str, speeds: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Knots of time and speed of one sweep; the rate is log-uniform from 1 to 1000 rpm/s."""
    rate, length = _log_uniform(rng, 1.0, 1000.0), _log_uniform(rng, 4.0, 60.0)
    low, high = speeds
    if class_name == "through zero":
        rate = _log_uniform(rng, 50.0, 1000.0)
        down, up = low / rate, min(high, 2.0 * low) / rate
        still = rng.uniform(0.3, 1.5)
        knots = np.array([0.0, down, down + still, down + still + up])
        return knots, np.array([low, 0.0, 0.0, min(high, 2.0 * low)])
    span = min(rate * length, 4500.0)
    length = max(span / rate, 4.0)
    start = low if span > 1000.0 else rng.uniform(low, max(high - span, low + 1.0))
    time_s, rpm = np.array([0.0, length]), np.array([start, start + span])
    if class_name == "run-down" or (class_name == "repeated sweep" and rng.random() < 0.5):
        rpm = rpm[::-1]
    if class_name == "step in sweep":
        ramp, jump = rng.uniform(0.3, 1.0), rng.uniform(0.1, 0.3) * rng.choice([-1.0, 1.0])
        middle = start + 0.5 * span
        time_s = np.array([0.0, 0.5 * length, 0.5 * length + ramp, length + ramp])
        rpm = np.array([start, middle, middle * (1.0 + jump), middle * (1.0 + jump) + 0.5 * span])
    return time_s, rpm


def _sampling(
    rng: np.random.Generator, class_name: str, needed_hz: float, total_s: float, fastest: float
) -> tuple[float, Encoder]:
    """Sampling rate and encoder: a trace where it can be sampled, else pulse times."""
    name, pulses, missing = WHEELS[int(rng.choice(len(WHEELS), p=WHEEL_CHANCES.get(class_name, ANY_WHEEL)))]
    able = [rate for rate in RATES_HZ if rate >= needed_hz] or [float(np.ceil(needed_hz))]
    affordable = [rate for rate in able if rate * total_s <= MOST_SAMPLES] or able[:1]
    rate_hz = float(rng.choice(affordable[:4]))
    to_tdc = 0.0 if name == "speed" else float(np.round(rng.uniform(0.0, 350.0), 1))
    if name == "speed":
        return rate_hz, Encoder(name, "speed")
    sampled = [rate for rate in affordable if rate >= 4.0 * pulses * fastest / 60.0]
    indexed = pulses > 1 and not missing
    pitch_error = _log_uniform(rng, 5e-6, 3e-4) if class_name == "up and down, toothed wheel" else 0.0
    if sampled and rng.random() < 0.7:
        return sampled[0] if rate_hz not in sampled else rate_hz, Encoder(
            name, "trace", pulses, missing, indexed, to_tdc, 0.0, pitch_error
        )
    clock_hz = float(rng.choice([25600.0, 51200.0, 1e5])) if pulses <= 60 else 1e7
    if class_name in SWINGING:
        clock_hz = 1e7
    return rate_hz, Encoder(name, "times", pulses, missing, indexed, to_tdc, clock_hz, pitch_error)


def _with_levels(rng: np.random.Generator, machine: Machine, has_mains: bool) -> Machine:
    """``machine`` with the size of its forces, its noise and its mains lines set by what its orders make of them."""
    low, high = machine.tested_rpm[0], machine.tested_rpm[-1]
    grid = np.linspace(max(low, 0.2 * high), high, 200)
    orders, typical = [], []
    for number, order in enumerate(machine.orders):
        median = float(np.median(np.abs(machine.steady_response(number, grid)).max(axis=0)))
        wanted = _log_uniform(rng, 0.3, 10.0)
        orders.append(replace(order, constant=order.constant * wanted / median, growth=order.growth * wanted / median))
        typical.append(wanted)
    weakest, half_rate = min(typical), machine.rate_hz / 2.0
    noise = weakest * _log_uniform(rng, 0.02, 1.0) / np.sqrt(half_rate)
    density: tuple[float, ...] = ()
    if machine.force_density:
        frequency = np.arange(1.0, 600.0, 0.05)
        unit = replace(machine, noise_density=(0.0,) * len(machine.channels)).floor_psd(frequency)
        rms = np.sqrt(np.trace(unit, axis1=1, axis2=2).real.sum() * 0.05 / len(machine.channels))
        density = (weakest * _log_uniform(rng, 0.05, 1.0) / rms,) * len(machine.force_density)
    tones = _mains(rng, machine, weakest) if has_mains or machine.class_name == "twice mains" else ()
    ring: tuple[float, ...] = ()
    if rng.random() < RING_CHANCE:
        ring = tuple(float(value) for value in weakest * rng.uniform(0.1, 3.0, len(machine.modes)))
    if machine.class_name in SWINGING and rng.random() < QUIET_CHANCE:
        first = typical[[order.order for order in orders].index(1.0)]
        noise, density, tones, ring = QUIET * first / np.sqrt(2.0 * half_rate), (), (), ()
        # an amplitude that wanders with the speed is no one number at 120 dB
        machine = replace(machine, profiles=tuple(replace(profile, wander_rpm=0.0) for profile in machine.profiles))
    return replace(
        machine, orders=tuple(orders),
        noise_density=tuple(float(noise * rng.uniform(0.7, 1.4)) for _ in machine.channels),
        force_density=tuple(float(value) for value in density), tones=tones, ring=ring,
    )  # fmt: skip


def _mains(rng: np.random.Generator, machine: Machine, level: float) -> tuple[Tone, ...]:
    off = 1.0 + rng.uniform(-4e-4, 4e-4)
    return tuple(
        Tone(
            multiple * machine.mains_hz * off,
            tuple(float(value) for value in level * rng.uniform(0.05, 0.6, len(machine.channels))),
            tuple(float(value) for value in rng.uniform(0.0, 2.0 * np.pi, len(machine.channels))),
        )
        for multiple in ((2,) if machine.class_name == "twice mains" else range(1, int(rng.integers(2, 4))))
    )
