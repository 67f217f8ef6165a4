"""Healthy recordings of many kinds, drawn from seeds, and the faults that a logger or a sensor puts into one channel.

Knows nothing of the program: shapes of signals and of faults only. The faulty channel is number 0.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, cheby1, lfilter, sosfilt

Floats = NDArray[np.float64]
RATES = (5_000.0, 12_800.0, 25_600.0, 51_200.0)


@dataclass(frozen=True)
class Drawn:
    """Signals (channel, sample), their quantities and rate, the speed at the start, and how large a fault is."""

    signals: Floats
    quantities: tuple[str, ...]
    rate_hz: float
    shaft_hz: float
    kind: str
    size: float = 0.0
    begin_s: float = 0.0

    @property
    def time_s(self) -> Floats:
        return np.arange(self.signals.shape[1]) / self.rate_hz


def healthy(rng: np.random.Generator) -> Drawn:
    """A sound recording of a kind drawn at random."""
    kinds = (_engine, _gears, _bearing, _knock, _run_up, _pressure, _pickup, _coarse, _beats, _hammer, _displacement)
    return kinds[rng.integers(len(kinds))](rng)


def _axis(rng: np.random.Generator) -> tuple[float, Floats]:
    rate = float(rng.choice(RATES))
    return rate, np.arange(round(rate * rng.uniform(3.0, 8.0))) / rate


def _noise(rng: np.random.Generator, n: int) -> Floats:
    cut = rng.uniform(0.05, 0.95)
    noise = lfilter(*butter(int(rng.integers(1, 4)), cut), rng.normal(size=n + 500))[500:]
    return np.asarray(noise / noise.std())


def _rows(rng: np.random.Generator, angle: Floats, orders: Floats) -> Floats:
    """Lines at ``orders`` of ``angle`` [rev] in three channels, with sizes and phases of their own, and noise."""
    rows = np.empty((3, angle.size))
    for k in range(3):
        sizes, phases = rng.lognormal(0.0, 1.0, orders.size), rng.uniform(0.0, 2.0 * np.pi, orders.size)
        row = sum(a * np.cos(2.0 * np.pi * o * angle + p) for a, o, p in zip(sizes, orders, phases, strict=True))
        rows[k] = row + np.std(row) * 10.0 ** rng.uniform(-3.0, 0.0) * _noise(rng, angle.size)
    return rows * 10.0 ** rng.uniform(-1.0, 2.0)


def _steady_angle(rng: np.random.Generator, time: Floats, hz: float) -> Floats:
    wander = rng.uniform(0.0, 0.01) * hz
    rate = rng.uniform(0.1, 1.0)
    return hz * time + wander / (2.0 * np.pi * rate) * np.sin(2.0 * np.pi * rate * time)


def _acc(signals: Floats, rate: float, hz: float, kind: str) -> Drawn:
    return Drawn(signals, ("acceleration",) * len(signals), rate, hz, kind)


def _engine(rng: np.random.Generator) -> Drawn:
    rate, time = _axis(rng)
    hz = rng.uniform(8.0, 60.0)
    orders = 0.5 * rng.choice(np.arange(1, 25), int(rng.integers(1, 9)), replace=False)
    return _acc(_rows(rng, _steady_angle(rng, time, hz), orders), rate, hz, "engine")


def _gears(rng: np.random.Generator) -> Drawn:
    rate, time = _axis(rng)
    hz = rng.uniform(8.0, 30.0)
    mesh = rng.integers(11, 41) * min(1.0, rate / 8.0 / (41 * hz))
    orders = np.array([1.0, mesh - 1.0, mesh, mesh + 1.0, 2.0 * mesh])
    return _acc(_rows(rng, _steady_angle(rng, time, hz), orders), rate, hz, "gears")


def _ring(rng: np.random.Generator, starts: Floats, sizes: Floats, time: Floats, hz: float, damping: float) -> Floats:
    row, rate = np.zeros(time.size), 1.0 / time[1]
    for start, size in zip(starts, sizes, strict=True):
        first = int(np.ceil(start * rate))
        last = min(time.size, first + int(12.0 / (damping * 2.0 * np.pi * hz) * rate) + 2)
        after = time[first:last] - start
        row[first:last] += size * np.exp(-damping * 2.0 * np.pi * hz * after) * np.sin(2.0 * np.pi * hz * after)
    return row


def _bearing(rng: np.random.Generator) -> Drawn:
    rate, time = _axis(rng)
    hz = rng.uniform(8.0, 30.0)
    rows = _rows(rng, _steady_angle(rng, time, hz), np.array([1.0, 2.0]))
    gaps = rng.normal(1.0, 0.01, int(time[-1] * hz * 10)) / (hz * rng.uniform(2.5, 9.0))
    starts = np.cumsum(gaps)
    starts = starts[starts < time[-1]]
    sizes = rows.std() * rng.uniform(0.5, 15.0) * rng.lognormal(0.0, 0.3, starts.size)
    ring = _ring(rng, starts, sizes, time, rng.uniform(0.05, 0.42) * rate, rng.uniform(0.01, 0.12))
    return _acc(rows + ring * rng.uniform(0.1, 1.0, 3)[:, None], rate, hz, "bearing")


def _knock(rng: np.random.Generator) -> Drawn:
    drawn = _engine(rng)
    time = drawn.time_s
    starts = np.sort(rng.uniform(0.0, time[-1], int(rng.integers(1, 60))))
    sizes = drawn.signals.std() * rng.uniform(2.0, 25.0, starts.size)
    hz = min(rng.uniform(5_000.0, 8_000.0), 0.42 * drawn.rate_hz)
    ring = _ring(rng, starts, sizes, time, hz, rng.uniform(0.01, 0.06))
    return replace(drawn, signals=drawn.signals + ring * rng.uniform(0.2, 1.0, 3)[:, None], kind="knock")


def _run_up(rng: np.random.Generator) -> Drawn:
    rate, time = _axis(rng)
    low, high = rng.uniform(8.0, 15.0), rng.uniform(30.0, 60.0)
    hz = low + (high - low) * time / time[-1]
    angle = np.cumsum(hz) / rate
    rows = np.zeros((3, time.size))
    modes = rng.uniform(1.5, 3.0, 2) * rng.uniform(low, high, 2)
    for order in rng.choice(np.arange(1, 9), 4, replace=False) * 0.5:
        for mode in modes:
            ratio = order * hz / mode
            gain = ratio**2 / np.sqrt((1.0 - ratio**2) ** 2 + (2.0 * rng.uniform(0.01, 0.05) * ratio) ** 2)
            phase = np.arctan2(0.06 * ratio, 1.0 - ratio**2)
            rows += rng.normal(size=3)[:, None] * gain * np.cos(2.0 * np.pi * order * angle - phase)
    rows += 0.05 * rows.std() * np.stack([_noise(rng, time.size) for _ in range(3)])
    return _acc(rows, rate, low, "run-up")


def _pressure(rng: np.random.Generator) -> Drawn:
    rate, time = _axis(rng)
    hz = rng.uniform(8.0, 50.0)
    angle = 2.0 * np.pi * hz * time
    volume = 1.0 + 0.5 * (rng.uniform(8.0, 16.0) - 1.0) * (1.0 - np.cos(angle))
    trace = volume.max() ** 1.33 * volume**-1.33
    burn = np.maximum(np.cos(0.5 * angle - 0.1), 0.0) ** rng.uniform(20.0, 80.0)
    trace = trace * (1.0 + rng.uniform(0.0, 2.0) * burn)
    trace = trace + 10.0 ** rng.uniform(-4.0, -1.5) * np.ptp(trace) * _noise(rng, time.size)
    return Drawn(trace[None], ("pressure",), rate, hz, "pressure")


def _pickup(rng: np.random.Generator) -> Drawn:
    drawn = _engine(rng)
    teeth = rng.integers(1, 61)
    wave = np.cos(2.0 * np.pi * drawn.shaft_hz * teeth * drawn.time_s)
    pulse = 5.0 * (wave > np.cos(np.pi * rng.uniform(0.05, 0.5))) + 0.01 * rng.normal(size=wave.size)
    signals, quantities = np.vstack([pulse, drawn.signals]), ("voltage", *drawn.quantities)
    return replace(drawn, signals=signals, quantities=quantities, kind="pickup")


def _coarse(rng: np.random.Generator) -> Drawn:
    drawn = (_engine, _gears, _bearing)[rng.integers(3)](rng)
    step = np.abs(drawn.signals).max() * rng.uniform(1.1, 4.0) / 2.0 ** (rng.integers(8, 13) - 1)
    return replace(drawn, signals=np.round(drawn.signals / step) * step, kind="coarse converter")


def _beats(rng: np.random.Generator) -> Drawn:
    rate, time = _axis(rng)
    hz = rng.uniform(8.0, 60.0)
    orders = np.array([1.0, 1.0 + rng.uniform(0.2, 2.0) / hz, 2.0, 2.0 + rng.uniform(0.2, 2.0) / hz])
    return _acc(_rows(rng, hz * time, orders), rate, hz, "beats")


def _hammer(rng: np.random.Generator) -> Drawn:
    rate, time = _axis(rng)
    starts = np.arange(0.3, time[-1], rng.uniform(1.0, 2.0))
    width = rng.uniform(0.2e-3, 2e-3)
    force = sum(np.where(abs(time - s) < width, np.cos(0.5 * np.pi * (time - s) / width) ** 2, 0.0) for s in starts)
    answer = _ring(rng, starts, np.ones(starts.size), time, rng.uniform(30.0, 800.0), rng.uniform(0.003, 0.05))
    rows = np.vstack([100.0 * force, answer]) + 1e-3 * rng.normal(size=(2, time.size))
    return Drawn(rows, ("force", "acceleration"), rate, 0.0, "hammer")


def _displacement(rng: np.random.Generator) -> Drawn:
    drawn = _engine(rng)
    offset = drawn.signals.std() * rng.uniform(-50.0, 50.0)
    return replace(drawn, signals=drawn.signals + offset, quantities=("displacement",) * 3, kind="displacement")


def _vibration(rng: np.random.Generator) -> Drawn:
    return (_engine, _gears, _bearing, _knock, _run_up, _displacement)[rng.integers(6)](rng)


def _with(drawn: Drawn, row: Floats, kind: str, size: float, begin_s: float = 0.0) -> Drawn:
    signals = np.vstack([row, drawn.signals[1:]])
    return replace(drawn, signals=signals, kind=f"{kind}, {drawn.kind}", size=size, begin_s=begin_s)


def clipped(rng: np.random.Generator) -> Drawn:
    """Cut off at both ends, then filtered; ``size``: share of the samples that were cut off."""
    drawn = _vibration(rng)
    row = drawn.signals[0] - np.median(drawn.signals[0])
    share = 10.0 ** rng.uniform(-3.0, -0.4)
    limit = np.quantile(np.abs(row), 1.0 - share)
    row = np.clip(row, -limit, limit)
    if rng.random() < 0.5:
        row = sosfilt(butter(int(rng.integers(2, 9)), rng.uniform(0.3, 0.85), output="sos"), row)
    else:
        row = sosfilt(cheby1(6, 0.1, rng.uniform(0.4, 0.85), output="sos"), row)
    row = row + row.std() * 10.0 ** rng.uniform(-4.0, -2.5) * rng.normal(size=row.size)
    return _with(drawn, row, "clipped", share)


def spiked(rng: np.random.Generator) -> Drawn:
    """Spikes of one to three samples; ``size``: their height over the root mean square."""
    drawn = _vibration(rng)
    row = drawn.signals[0].copy()
    size = 10.0 ** rng.uniform(0.5, 2.0)
    for at in rng.choice(row.size - 4, int(rng.integers(1, 40)), replace=False):
        row[at : at + rng.integers(1, 4)] += rng.choice([-1.0, 1.0]) * size * row.std() * rng.uniform(1.0, 1.5)
    return _with(drawn, row, "spikes", size)


def overloaded(rng: np.random.Generator) -> Drawn:
    """A jump to a rail, some time there, and an exponential way back; ``size``: over the root mean square."""
    drawn = _vibration(rng)
    time, row = drawn.time_s, drawn.signals[0]
    begin, decay, held = rng.uniform(0.1, 0.6) * time[-1], 10.0 ** rng.uniform(-1.0, 0.3), rng.uniform(0.0, 0.2)
    size = 10.0 ** rng.uniform(0.3, 1.7)
    shape = np.where(time < begin, 0.0, np.exp(-np.maximum(time - begin - held, 0.0) / decay))
    return _with(drawn, row + rng.choice([-1.0, 1.0]) * size * row.std() * shape, "iepe_overload", size, begin)


def settling(rng: np.random.Generator) -> Drawn:
    """A decay from the first sample on; ``size``: over the root mean square."""
    drawn = _vibration(rng)
    time, row = drawn.time_s, drawn.signals[0]
    size, decay = 10.0 ** rng.uniform(0.0, 1.7), rng.uniform(0.05, 0.15) * time[-1]
    return _with(drawn, row + size * row.std() * np.exp(-time / decay), "start_transient", size)


def drifting(rng: np.random.Generator) -> Drawn:
    """A straight or bent rise of the mean; ``size``: over the root mean square."""
    drawn = _vibration(rng)
    place, row = drawn.time_s / drawn.time_s[-1], drawn.signals[0]
    size = 10.0 ** rng.uniform(-0.3, 1.5)
    return _with(drawn, row + size * row.std() * place ** rng.uniform(0.6, 2.0), "drift", size)


def dead(rng: np.random.Generator) -> Drawn:
    """Noise of the converter alone; ``size``: how far it lies below the others."""
    drawn = _vibration(rng)
    size = 10.0 ** rng.uniform(1.5, 5.0)
    row = rng.normal(size=drawn.signals.shape[1]) * np.median(drawn.signals[1:].std(axis=1)) / size
    step = row.std() * rng.uniform(0.1, 2.0)
    return _with(drawn, np.round(row / step) * step, "dead_sensor", size)


def copied(rng: np.random.Generator) -> Drawn:
    """Channel 0 holds the samples of channel 1."""
    drawn = _vibration(rng)
    return _with(drawn, drawn.signals[1], "copied_channel", 1.0)


def mains_only(rng: np.random.Generator) -> Drawn:
    """Mains, its multiples and noise; ``size``: the lines over the noise."""
    drawn = _vibration(rng)
    mains, size = rng.choice([50.0, 60.0]) * rng.uniform(0.9995, 1.0005), 10.0 ** rng.uniform(-0.3, 2.0)
    row = sum(a * np.cos(2 * np.pi * k * mains * drawn.time_s + k) for k, a in ((1, 1.0), (2, 0.2), (3, 0.4)))
    row = size * row / np.std(row) + rng.normal(size=row.size)
    return _with(drawn, row * drawn.signals[1].std() / row.std() * rng.uniform(0.05, 1.0), "mains_only", size)


def stepped(rng: np.random.Generator) -> Drawn:
    """A gain that changes for good at one moment; ``size``: the factor."""
    drawn = _vibration(rng)
    begin, size = rng.uniform(0.2, 0.8) * drawn.time_s[-1], 10.0 ** rng.uniform(0.15, 1.3)
    gain = np.where(drawn.time_s < begin, 1.0, size ** rng.choice([-1.0, 1.0]))
    return _with(drawn, drawn.signals[0] * gain, "level_step", size, begin)


FAULTS: dict[str, Callable[[np.random.Generator], Drawn]] = {
    "clipped": clipped, "spikes": spiked, "iepe_overload": overloaded, "start_transient": settling, "drift": drifting,
    "dead_sensor": dead, "copied_channel": copied, "mains_only": mains_only, "level_step": stepped,
}  # fmt: skip
"""How each fault is drawn, by the flag that it calls for."""
