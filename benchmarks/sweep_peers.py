"""How `sweeps.py` draws its machines, and how crankorder, its plain map, plain scipy and rota-order read them.

A method gives what it says of the mode and of the largest value of each order. Whoever makes no estimates is read as an
engineer reads a picture: the top of each order, and its half-power width.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import h5py
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import get_window

from crankorder.batch.execute import engine_of_test, sources_of
from crankorder.batch.plan import CampaignPlan, plan_tests
from crankorder.settings import load_settings
from crankorder.stages import CampaignResult, analyse_recording, analyse_test

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from machines.folder import Take, write_folder
from machines.machine import Encoder, Machine, Mode, Order, Profile
from machines.truth import recorded_maximum, steady_maximum

OURS, FRAMES, SCIPY = "crankorder", "crankorder, plain map", "plain scipy"
ROTA_MAP, ROTA_FILTER = "rota-order, order map", "rota-order, Vold-Kalman"
REVS_PER_FRAME, OVERLAP, SAMPLES_PER_REV = 16, 0.75, 64
PULSES_PER_REV = 60
NEAR_MODE = 0.03
"""A mode farther away than this share of the true frequency is another one."""
NEAR_ORDER = 0.03
LONGEST_S, SHORTEST_S = 60.0, 3.0
NOISE_SHARE = 0.01
"""Sensor noise over the whole band, of the largest amplitude that the weakest order reaches."""


@dataclass(frozen=True)
class Value:
    """An estimate with its 95 % interval, where there is one."""

    value: float
    ci95: tuple[float, float] | None = None

    def covers(self, truth: float) -> bool | None:
        """Whether the interval holds ``truth``; None without one."""
        return None if self.ci95 is None else bool(self.ci95[0] <= truth <= self.ci95[1])


@dataclass(frozen=True)
class Said:
    """What a method says of a test: the mode, and by (order, channel) the largest value.

    crankorder also gives the largest value of each order track, and what the order would be were the speed held;
    ``others`` are natural frequencies, Hz, that it calls modes beside that one.
    """

    frequency_hz: Value | None = None
    damping_ratio: Value | None = None
    maxima: dict[tuple[int, int], Value] = field(default_factory=dict)
    tracks: dict[tuple[int, int], Value] = field(default_factory=dict)
    held: dict[tuple[int, int], Value] = field(default_factory=dict)
    others: tuple[float, ...] = ()


@dataclass(frozen=True)
class Cell:
    """Rate, rpm/s (negative: down), and damping ratio of one place in the table."""

    rate_rpm_s: float
    damping_ratio: float

    @property
    def row(self) -> str:
        """Name of its row."""
        return f"{abs(self.rate_rpm_s):g} {'up' if self.rate_rpm_s > 0 else 'down'}"


@dataclass(frozen=True)
class SweepTest:
    """One drawn test on disk, and what is so."""

    cell: Cell
    seed: int
    machine: Machine
    takes: tuple[Take, ...]
    folder: Path

    def truth(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest amplitudes that the recordings held, and steady ones, (order, channel)."""
        every = range(len(self.machine.orders))
        was = np.stack([recorded_maximum(self.machine, self.takes, number) for number in every])
        return was, np.stack([steady_maximum(self.machine, number) for number in every])


def drawn_test(cell: Cell, seed: int, folder: Path) -> SweepTest:
    """The test of ``cell`` that ``seed`` gives, written to ``folder``: one mode that two or three orders pass."""
    place = [round(abs(cell.rate_rpm_s)), round(1e4 * cell.damping_ratio), int(cell.rate_rpm_s < 0)]
    rng = np.random.default_rng([seed, *place])
    hz = float(np.exp(rng.uniform(np.log(60.0), np.log(120.0))))
    channels, count = int(rng.integers(1, 4)), int(rng.integers(2, 4))
    numbers = float(rng.choice([5.0, 5.5, 6.0, 6.5, 7.0])) + 0.5 * np.arange(count)
    shape = tuple(complex(v) for v in 0.02 * rng.choice([-1.0, 1.0], channels) * rng.uniform(0.4, 1.5, channels))
    drive = tuple(complex(v) for v in rng.choice([-1.0, 1.0], count) * rng.uniform(0.5, 1.5, count))
    orders = tuple(
        Order(
            order=float(number),
            constant=float(rng.uniform(20.0, 60.0)),
            growth=float(rng.uniform(0.0, 10.0)),
            exponent=float(rng.uniform(1.0, 2.0)),
            phase_deg=float(rng.uniform(-180.0, 180.0)),
            phase_deg_per_krpm=0.0,
            direct=tuple(complex(v) for v in 0.006 * rng.standard_normal(channels)),
        )
        for number in numbers
    )
    profiles = _profiles(cell, hz, numbers, rng)
    fastest = max(max(profile.rpm) for profile in profiles)
    machine = Machine(
        class_name="sweep",
        seed=seed,
        rate_hz=max(2048.0, float(np.ceil(2.56 * numbers.max() * fastest / 60.0))),
        channels=("X", "Y", "Z")[:channels],
        modes=(Mode(hz, cell.damping_ratio, shape, drive, ()),),
        orders=orders,
        tones=(),
        profiles=profiles,
        encoder=Encoder("60", "times", PULSES_PER_REV, index=True, clock_hz=1e7),
        noise_density=(0.0,) * channels,
        force_density=(),
        mains_hz=50.0,
        steady=False,
    )
    rates_hz_s = numbers * abs(cell.rate_rpm_s) / 60.0
    # a fast passage reaches no more than about this share of the steady maximum (stationary phase)
    reached = np.minimum(1.0, cell.damping_ratio * 2.0 * np.pi * hz / np.sqrt(rates_hz_s))
    weakest = min(share * float(steady_maximum(machine, number).max()) for number, share in enumerate(reached))
    density = NOISE_SHARE * weakest / np.sqrt(0.5 * machine.rate_hz)
    machine = replace(machine, noise_density=(float(density),) * channels)
    return SweepTest(cell, seed, machine, write_folder(machine, folder), folder)


def _profiles(cell: Cell, hz: float, numbers: np.ndarray, rng: np.random.Generator) -> tuple[Profile, ...]:
    """One sweep past all resonances, or one sweep past each where a single one would last too long."""
    rate, damping = abs(cell.rate_rpm_s), cell.damping_ratio
    met = np.sort(60.0 * hz / numbers)
    share = max(0.12, 2.5 * damping)
    ringing_rpm = rate * 2.0 / (damping * 2.0 * np.pi * hz)
    low, high = met[0] * (1.0 - share), met[-1] * (1.0 + share)
    spans = [(low, high)]
    if high - low > LONGEST_S * rate:
        half = 0.5 * LONGEST_S * rate
        spans = [(max(rpm * (1.0 - share), rpm - half), min(rpm * (1.0 + share), rpm + half)) for rpm in met]
    made = []
    for low, high in spans:
        if cell.rate_rpm_s > 0:
            begin, end = low, max(high, low + rate * SHORTEST_S, met[-1] + ringing_rpm if len(spans) == 1 else high)
        else:
            end = max(0.25 * low, min(low, met[0] - ringing_rpm)) if len(spans) == 1 else low
            begin = max(high, end + rate * SHORTEST_S)
        length = round(abs(end - begin) / rate, 3)
        made.append(Profile((0.0, length), (float(begin), float(end)), float(rng.uniform(0.0, 2.0))))
    return tuple(made)


def _run(test: SweepTest, name: str, asked: dict[str, dict]) -> tuple[CampaignPlan, CampaignResult]:
    (plan,) = plan_tests([test.folder], test.folder.parent / name).tests
    settings = load_settings(asked=asked) if asked else plan.settings
    results = [analyse_recording(path, plan.manifest, settings) for path in plan.recordings]
    return plan, analyse_test(
        results,
        test=plan.name,
        sources=sources_of(plan.manifest, engine_of_test(plan), plan.settings),
        settings=settings,
    )


def ours(test: SweepTest) -> Said:
    """The findings and the order tracks, by the default recipe."""
    result = _run(test, "ours", {})[1]
    assert result.findings is not None
    findings = result.findings.as_dict()
    maxima, held = {}, {}
    for record in findings["orders"]:
        number = _order_at(test, record["order"])
        place = (number, test.machine.channels.index(record["channel"]))
        if number < 0 or (place in maxima and maxima[place].value > record["amplitude"]):
            continue
        maxima[place] = _value(record, "amplitude")
        if record.get("amplitude_held") is not None:
            held[place] = _value(record, "amplitude_held")
    true = test.machine.modes[0].frequency_hz
    near = [r for r in findings["modes"] if abs(r["frequency_hz"] / true - 1.0) <= NEAR_MODE]
    near.sort(key=lambda record: (record["damping_ratio"] is None, abs(record["frequency_hz"] - true)))
    own = near[0] if near else None
    modes = [r for r in findings["modes"] if r["damping_ratio"] is not None and r["explained_by"] == "mode"]
    others = tuple(float(record["frequency_hz"]) for record in modes if record is not own)
    return Said(
        frequency_hz=None if own is None else _value(own, "frequency_hz"),
        damping_ratio=None if own is None or own["damping_ratio"] is None else _value(own, "damping_ratio"),
        maxima=maxima,
        tracks=_of_tracks(test, result),
        held=held,
        others=others,
    )


def _order_at(test: SweepTest, found: float) -> int:
    """Number of the true order that ``found`` is; -1: none."""
    off = [abs(order.order - found) for order in test.machine.orders]
    return int(np.argmin(off)) if min(off) <= NEAR_ORDER else -1


def _of_tracks(test: SweepTest, result: CampaignResult) -> dict[tuple[int, int], Value]:
    """Largest value of each order track, with its interval."""
    made: dict[tuple[int, int], Value] = {}
    tracks = result.datasets["order_tracks"].transpose("order", "channel", "speed", ...)
    for at, found in enumerate(tracks["order"].values):
        number = _order_at(test, float(found))
        for channel, values in enumerate(np.nan_to_num(tracks["amplitude"].values[at])):
            top = int(np.argmax(values))
            if number < 0 or ((number, channel) in made and made[number, channel].value > values[top]):
                continue
            ends = [float(tracks[f"amplitude_{end}"].values[at, channel, top]) for end in ("low", "high")]
            made[number, channel] = Value(float(values[top]), (ends[0], ends[1]))
    return made


def _value(record: dict, key: str) -> Value:
    ends = record.get(f"{key}_ci95")
    known = ends is not None and None not in ends
    return Value(float(record[key]), (float(ends[0]), float(ends[1])) if known else None)


def by_frames(test: SweepTest) -> Said:
    """The order map of frames of 16 revolutions, read by hand."""
    asked = {"orders": {"track_method": "frames"}, "report": {"results": ["order_map"]}}
    made = _run(test, "frames", asked)[1].datasets["order_map"]
    amplitude = made["amplitude"].transpose("speed", "channel", "order").values
    return read_by_hand(test, made["speed"].values, made["order"].values, amplitude)


def _recordings(test: SweepTest) -> Iterable[tuple[np.ndarray, np.ndarray]]:
    """Signals (channel, sample) and pulse times of each recording, from its file."""
    for path in sorted(test.folder.glob("*.h5")):
        with h5py.File(path) as file:
            signals = np.stack([file[f"acc_{name.lower()}"][:] for name in test.machine.channels]).astype(float)
            yield signals, file["pulse_time"][:]


def by_scipy(test: SweepTest) -> Said:
    """Cubic spline onto the angle, Hann frames of 16 revolutions, read by hand."""
    speed, rows = [], []
    frame = REVS_PER_FRAME * SAMPLES_PER_REV
    window = get_window("hann", frame)
    for signals, pulses in _recordings(test):
        revs = np.arange(len(pulses)) / PULSES_PER_REV
        at = np.interp(np.arange(int(revs[-1] * SAMPLES_PER_REV)) / SAMPLES_PER_REV, revs, pulses)
        even = CubicSpline(np.arange(signals.shape[1]) / test.machine.rate_hz, signals, axis=1)(at)
        for begin in range(0, len(at) - frame, round((1.0 - OVERLAP) * frame)):
            spectrum = np.abs(np.fft.rfft(window * even[:, begin : begin + frame])) * 2.0 / window.sum()
            speed.append(60.0 * REVS_PER_FRAME / (at[begin + frame] - at[begin]))
            rows.append(spectrum)
    if not rows:
        return Said()
    orders = np.arange(frame // 2 + 1) / REVS_PER_FRAME
    return read_by_hand(test, np.array(speed), orders, np.array(rows))


def _rpm(test: SweepTest, signals: np.ndarray, pulses: np.ndarray) -> np.ndarray:
    """Speed at each sample, between the pulses."""
    middle, rpm = 0.5 * (pulses[1:] + pulses[:-1]), 60.0 / PULSES_PER_REV / np.diff(pulses)
    time_s = np.arange(signals.shape[1]) / test.machine.rate_hz
    return np.polynomial.Polynomial.fit(middle, rpm, 1)(time_s)


def by_rota_map(test: SweepTest) -> Said:
    """rota-order's order map with frames of 16 revolutions, read by hand."""
    maps = importlib.import_module("rota.maps")
    speed, rows = [], []
    for signals, pulses in _recordings(test):
        keywords = {"order_resolution": 1.0 / REVS_PER_FRAME, "max_order": 20.0, "amplitude": "peak"}
        rpm = _rpm(test, signals, pulses)
        # beyond half the sampling rate it refuses
        keywords["max_order"] = min(20.0, 0.49 * test.machine.rate_hz * 60.0 / float(rpm.max()))
        found = maps.rpm_order_map(signals.T, test.machine.rate_hz, rpm, overlap=OVERLAP, **keywords)
        speed.append(found.rpm)
        rows.append(np.abs(found.values).transpose(1, 2, 0))
        axis = found.axis
    return read_by_hand(test, np.concatenate(speed), axis, np.concatenate(rows))


def by_rota_filter(test: SweepTest) -> Said:
    """rota-order's Vold-Kalman filter with a fifth of an order to each side, read by hand."""
    extract = importlib.import_module("rota.extract")
    numbers = [order.order for order in test.machine.orders]
    speed, rows = [], []
    for signals, pulses in _recordings(test):
        rpm = _rpm(test, signals, pulses)
        width = 0.2 * float(rpm.mean()) / 60.0
        found = extract.order_waveform(signals.T, test.machine.rate_hz, rpm, numbers, bandwidth=width)
        speed.append(rpm)
        rows.append(np.abs(found.envelopes.reshape(len(rpm), len(numbers), -1)).transpose(0, 2, 1))
    return read_by_hand(test, np.concatenate(speed), np.array(numbers), np.concatenate(rows))


def read_by_hand(test: SweepTest, speed: np.ndarray, orders: np.ndarray, amplitude: np.ndarray) -> Said:
    """Top of each order and half-power width of its strongest channel; ``amplitude``: (row, channel, order).

    Natural frequency and damping are the medians over the orders; an order without both half-power points says nothing.
    """
    known = np.isfinite(speed)
    by_speed = np.argsort(speed[known])
    speed, amplitude = speed[known][by_speed], amplitude[known][by_speed]
    frequency, damping, maxima = [], [], {}
    for number, order in enumerate(test.machine.orders):
        track = np.nan_to_num(amplitude[:, :, int(np.argmin(np.abs(orders - order.order)))])
        for channel in range(track.shape[1]):
            maxima[number, channel] = Value(float(track[:, channel].max()))
        width = half_power(speed, track[:, int(np.argmax(track.max(axis=0)))])
        if width is not None:
            frequency.append(order.order * width[0] / 60.0)
            damping.append(width[1])
    if not frequency:
        return Said(maxima=maxima)
    return Said(Value(float(np.median(frequency))), Value(float(np.median(damping))), maxima)


def half_power(speed: np.ndarray, amplitude: np.ndarray) -> tuple[float, float] | None:
    """Speed of the top and half the half-power width over it; None where a half-power point is not in the range."""
    top = int(np.argmax(amplitude))
    level = amplitude[top] / np.sqrt(2.0)
    below = np.flatnonzero(amplitude[:top] < level)
    above = np.flatnonzero(amplitude[top:] < level)
    if not below.size or not above.size:
        return None
    left, right = int(below[-1]), top + int(above[0])
    low = np.interp(level, amplitude[[left, left + 1]], speed[[left, left + 1]])
    high = np.interp(level, amplitude[[right, right - 1]], speed[[right, right - 1]])
    return float(speed[top]), float((high - low) / (2.0 * speed[top]))


@cache
def methods() -> dict[str, Callable[[SweepTest], Said]]:
    """Every method that can run here, plain scipy first."""
    found: dict[str, Callable[[SweepTest], Said]] = {SCIPY: by_scipy, FRAMES: by_frames, OURS: ours}
    try:
        importlib.import_module("rota.extract")
        found |= {ROTA_MAP: by_rota_map, ROTA_FILTER: by_rota_filter}
    except ImportError:
        pass
    return found
