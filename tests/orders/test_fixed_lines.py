"""Rows of orders that meet lines of one frequency: told apart by their beat, or left open by what the line is."""

import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest
import xarray as xr

import crankorder as co
from crankorder import front_door
from crankorder.front_door import Diagnosis
from crankorder.orders.fixed_lines import without_steady_lines
from crankorder.shaft.angle import speed_course
from made.recordings import sampled, shaft
from made.swept_machines import RATE_HZ, acceleration

Kind = Literal["steps", "sweep"]


@dataclass(frozen=True)
class MainsMet:
    """What was put in: ``orders`` with ``size`` in the signal, ``mains_hz`` with multiples, a mode where they meet.

    Order ``meets`` is at ``multiple`` times ``mains_hz`` at the speed ``at_rpm``. ``mains`` holds the amplitude of each
    multiple, ``nominal_hz`` the supply that it belongs to. ``mode_hz`` 0: no mode.
    """

    kind: Kind
    orders: np.ndarray
    size: np.ndarray
    meets: float
    mains_hz: float
    nominal_hz: float
    multiple: int
    mains: dict[int, float]
    at_rpm: float
    speeds_rpm: np.ndarray
    duration_s: float
    noise: float
    mode_hz: float = 0.0
    damping: float = 0.01

    def amplitude(self, order: float, rpm: np.ndarray) -> np.ndarray:
        """What ``order`` is in the signal at held speeds ``rpm``."""
        size = float(self.size[self.orders == order][0])
        return size * np.abs(self.response(order * rpm / 60.0))

    def response(self, hertz: np.ndarray) -> np.ndarray:
        """What a steady force of 1 at ``hertz`` is in the signal."""
        if not self.mode_hz:
            return np.ones(np.shape(hertz))
        ratio = np.asarray(hertz) / self.mode_hz
        straight = np.sinc(np.asarray(hertz) / RATE_HZ) ** 2  # the force is straight between samples
        return 1.0 + 0.5 * straight * ratio**2 / (1.0 - ratio**2 + 2j * self.damping * ratio)


def drawn(rng: np.random.Generator, kind: Kind, *, with_mode: bool = False) -> MainsMet:
    """A rotor of three orders, one of which meets mains (of ``kind`` runs; ``with_mode``: beside a mode)."""
    orders = np.array([1.0, 2.0, 3.0, 4.0]) if kind == "steps" else np.array([1.0, 2.0, 3.0, 5.0])
    nominal = float(rng.choice([50.0, 60.0]))
    mains_hz = nominal * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 0.0008))
    multiple, meets = int(rng.integers(1, 3)), float(rng.choice(orders[1:]))
    at_rpm = 60.0 * mains_hz * multiple / meets
    size = np.exp(rng.uniform(np.log(0.1), np.log(1.0), len(orders)))
    own = float(size[orders == meets][0])
    mains = {multiple: own * float(np.exp(rng.uniform(np.log(0.05), np.log(2.0))))}
    for other in {1, 2, 3} - {multiple}:
        if rng.random() < 0.6:
            mains[other] = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))
    if kind == "steps":
        step = float(rng.choice([20.0, 50.0]))
        shift = 0.0 if rng.random() < 0.6 else float(rng.uniform(-6.0, 6.0))
        speeds = at_rpm + shift + step * np.arange(-5, 6)
        duration = float(rng.uniform(8.0, 16.0))
    else:
        speeds = at_rpm * np.array([rng.uniform(0.75, 0.9), rng.uniform(1.1, 1.3)])
        speeds = speeds if rng.random() < 0.7 else speeds[::-1]
        duration = float(rng.uniform(20.0, 60.0))
    mode = multiple * mains_hz * float(1.0 + rng.uniform(-0.01, 0.01)) if with_mode else 0.0
    damping = float(np.exp(rng.uniform(np.log(0.005), np.log(0.03))))
    noise = float(np.exp(rng.uniform(np.log(0.005), np.log(0.1))))
    return MainsMet(
        kind, orders, size, meets, mains_hz, nominal, multiple, mains, at_rpm, speeds, duration, noise, mode, damping
    )


def recordings(met: MainsMet, rng: np.random.Generator) -> list[xr.Dataset]:
    """The recordings of ``met``: one for each held speed, or one sweep."""
    ends = met.speeds_rpm[None] if met.kind == "sweep" else np.stack([met.speeds_rpm, met.speeds_rpm], axis=1)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(met.orders))
    made = []
    for number, (first, last) in enumerate(ends.tolist()):
        before_s = 3.0  # so that a mode swings already when the recording begins
        time = np.arange(-round(before_s * RATE_HZ), round(met.duration_s * RATE_HZ)) / RATE_HZ
        held = np.clip(time, 0.0, None)
        turn = (first * time + 0.5 * (last - first) * held**2 / met.duration_s) / 60.0 + rng.uniform(0.0, 1.0)
        force = np.sum(met.size[:, None] * np.cos(2.0 * np.pi * met.orders[:, None] * turn + phases[:, None]), axis=0)
        signal = force - (0.5 * acceleration(force, met.mode_hz, met.damping) if met.mode_hz else 0.0)
        for multiple, size in met.mains.items():
            signal = signal + size * np.cos(2.0 * np.pi * multiple * met.mains_hz * time + rng.uniform(0.0, 7.0))
        signal = signal + met.noise * rng.standard_normal(len(time))
        kept = time >= 0.0
        knots = np.arange(int(turn[kept][0]) + 1.0, turn[kept][-1], 1.0 / 60.0)
        pulses = np.interp(knots, turn[kept], time[kept])
        made.append(
            co.recording(
                {"A": signal[kept]}, rate_hz=RATE_HZ, pulse_times_s=pulses, pulses_per_rev=60, name=f"made {number}"
            )
        )
    return made


CLOSE_HZ = 2.5
"""Distance of an order from a line within which one shows in the other."""


OF_MODEL = 4e-4
"""Share to which what is behind a mode is known: its force is straight between samples; rows far from mains show it."""


def _found(met: MainsMet, rng: np.random.Generator) -> tuple[list[bool], Diagnosis]:
    """Whether the interval of each row where an order of ``met`` is close to mains holds it; and what is found."""
    settings = front_door._settings("findings", "order_tracks", recipe=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        groups, told = front_door._analysed(recordings(met, rng), settings, tables={}, engine=None, test="made")
    tracks, held = groups["order_tracks"].sel(channel="A"), []
    for order in met.orders.tolist():
        one = tracks.sel(order=order, method="nearest")
        true = met.amplitude(order, one["speed"].values)
        close = [abs(order * one["speed"].values / 60.0 - k * met.mains_hz) < CLOSE_HZ for k in met.mains]
        slack = 1e-9 if not met.mode_hz else OF_MODEL
        low, high = one["amplitude_low"].values * (1.0 - slack), one["amplitude_high"].values * (1.0 + slack)
        inside = (low <= true) & (true <= high)
        held += inside[np.any(close, axis=0) & np.isfinite(one["amplitude"].values)].tolist()
    return held, told


@pytest.mark.slow
@pytest.mark.parametrize("with_mode", [False, True])
def test_steps_past_mains_hold_what_the_orders_are(with_mode):
    held: list[bool] = []
    for seed in range(100, 103):
        rng = np.random.default_rng(seed)
        met = drawn(rng, "steps", with_mode=with_mode)
        inside, told = _found(met, rng)
        held += inside
        near = [one for one in told.as_dict()["modes"] if abs(one["frequency_hz"] - met.multiple * met.mains_hz) < 0.05]
        assert ("mains", "twice mains")[met.multiple - 1] in [one["explained_by"] for one in near]
    assert np.mean(held) >= 0.92, held


BESIDE = MainsMet(
    kind="steps", orders=np.array([1.0, 2.0, 3.0, 5.0]), size=np.array([0.3, 0.2, 0.4, 0.15]), meets=3.0,
    mains_hz=60.02, nominal_hz=60.0, multiple=1, mains={1: 0.3, 5: 0.1}, at_rpm=1200.4,
    speeds_rpm=np.arange(1000.0, 1501.0, 50.0), duration_s=12.0, noise=0.02,
)  # fmt: skip


def test_an_order_is_not_told_with_the_mains_that_it_meets_and_multiples_are_of_the_supply_that_is_there():
    held, told = _found(BESIDE, np.random.default_rng(1))
    assert np.mean(held) >= 0.92
    (third,) = [one for one in told.as_dict()["orders"] if round(one["order"]) == 3]
    assert third["amplitude"] == pytest.approx(0.4, rel=0.01)
    assert "mains of 60.02 Hz meets it at 1200 rpm, where its own share is" in third["evidence"]
    assert [one["explained_by"] for one in told.as_dict()["modes"]] == ["mains", "5 x mains"]
    assert "5 times the mains frequency of 60 Hz" in told.as_dict()["modes"][1]["evidence"]


# Lines of one frequency in a sweep: taken out as they are, and nothing else with them.


SWEEP_HZ, SECONDS, NOISE = 2048.0, 20.0, 0.02
TIME = np.arange(round(SWEEP_HZ * SECONDS)) / SWEEP_HZ
ORDER = np.array([2.0])


def _sweep(rng: np.random.Generator) -> tuple[xr.Dataset, np.ndarray]:
    """Shaft of a run-up from 1000 rpm or so to twice that, and order 2 of amplitude 1 with noise (2, samples)."""
    first_hz = rng.uniform(15.0, 18.0)
    rate = first_hz * rng.uniform(0.9, 1.1) / SECONDS
    knots = np.linspace(0.0, SECONDS, 400)
    turned = shaft(knots, first_hz * knots + 0.5 * rate * knots**2, 60.0 * (first_hz + rate * knots))
    angle = first_hz * TIME + 0.5 * rate * TIME**2
    order = np.cos(2.0 * np.pi * 2.0 * angle + rng.uniform(0.0, 6.0, (2, 1)))
    return turned, order + NOISE * rng.standard_normal((2, len(TIME)))


def _band(signals: np.ndarray) -> xr.Dataset:
    return sampled(signals, rate_hz=SWEEP_HZ, band_hz=800.0)


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_mains_that_an_order_passes_are_taken_out_as_they_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turned, signals = _sweep(rng)
    hertz = float(rng.choice([50.0, 60.0])) + rng.uniform(-0.1, 0.1)
    phasor = rng.uniform(0.1, 0.5, 2) * np.exp(2j * np.pi * rng.uniform(0.0, 1.0, 2))
    hum = (phasor[:, None] * np.exp(2j * np.pi * hertz * TIME)).real
    left, lines = without_steady_lines(_band(signals + hum), speed_course(turned), ORDER, mains_hz=(50.0, 60.0))
    assert [one.frequency_hz for one in lines] == [pytest.approx(hertz, abs=0.003)]
    assert np.abs(lines[0].amplitude - phasor) == pytest.approx(0.0, abs=0.02)
    assert np.sqrt(np.mean((left["signal"].values - signals) ** 2)) < 0.05 * np.sqrt(np.mean(hum**2))


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_an_order_and_what_rings_after_it_are_left(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    turned, signals = _sweep(rng)
    since = np.maximum(TIME - rng.uniform(5.0, 12.0), 0.0)
    signals += np.where(since > 0.0, 2.0 * np.exp(-0.004 * 2.0 * np.pi * 60.0 * since), 0.0) * np.sin(
        2.0 * np.pi * 60.0 * since
    )
    left, lines = without_steady_lines(_band(signals), speed_course(turned), ORDER, mains_hz=(50.0, 60.0))
    assert not lines
    np.testing.assert_array_equal(left["signal"].values, signals)
