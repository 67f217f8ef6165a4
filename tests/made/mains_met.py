"""Rotors whose orders meet a line of fixed frequency, held or in sweeps, with or without a mode where they meet."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr

import crankorder as co
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
