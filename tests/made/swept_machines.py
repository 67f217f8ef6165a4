"""Machines of random modes and orders that run up or down: the structure answers forces of the shaft exactly."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.signal import lfilter

from made.recordings import sampled, shaft

RATE_HZ = 4096.0


@dataclass(frozen=True)
class SweptMachine:
    """What was put in: ``orders`` with the ``size`` of their forces and the ``slip`` of each (0: locked).

    Modes of ``natural_hz`` and ``damping`` with the ``shares`` (channels, modes) of their responses.
    """

    orders: np.ndarray
    size: np.ndarray
    slip: np.ndarray
    natural_hz: np.ndarray
    damping: np.ndarray
    shares: np.ndarray
    rpm: tuple[float, float]
    duration_s: float
    noise: float


def drawn(
    rng: np.random.Generator, *, rpm: tuple[float, float] = (600.0, 6000.0), duration_s: float = 8.0, slip: float = 0.0,
    modes: int | None = None,
) -> SweptMachine:  # fmt: skip
    """A machine of 1 to 6 modes and three to five orders; one of these slips by the share ``slip`` if that is not 0."""
    n_modes = int(rng.integers(1, 7)) if modes is None else modes
    numbers = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 3.5, 4.0, 5.5, 6.0, 8.0, 9.0])
    orders = np.sort(rng.choice(numbers, rng.integers(3, 6), False))
    slips = np.zeros(len(orders))
    if slip:
        slips[int(rng.choice(np.flatnonzero(orders >= 2.0)))] = slip
    return SweptMachine(
        orders=orders, size=np.exp(rng.uniform(np.log(0.1), 0.0, len(orders))), slip=slips,
        natural_hz=np.sort(np.exp(rng.uniform(np.log(25.0), np.log(500.0), n_modes))),
        damping=np.exp(rng.uniform(np.log(0.003), np.log(0.08), n_modes)), shares=rng.normal(size=(3, n_modes)),
        rpm=rpm, duration_s=duration_s, noise=0.02,
    )  # fmt: skip


def recorded(machine: SweptMachine, rng: np.random.Generator) -> tuple[xr.Dataset, xr.Dataset]:
    """BandRecording and ShaftAngle of ``machine``."""
    time = np.arange(round(machine.duration_s * RATE_HZ)) / RATE_HZ
    first, last = machine.rpm

    def angle(t: np.ndarray) -> np.ndarray:
        return 0.37 + (first * t + 0.5 * (last - first) * t**2 / machine.duration_s) / 60.0

    turn = angle(time)
    force = np.zeros(len(time))
    speed = first + (last - first) * time / machine.duration_s
    for order, size, slip in zip(machine.orders, machine.size, machine.slip, strict=True):
        growth = (speed / max(first, last)) ** 2 if order < 4 else 1.0
        force += size * growth * np.cos(2 * np.pi * order * (1.0 - slip) * turn + rng.uniform(0, 2 * np.pi))
    response = 0.3 * force[None] * rng.normal(size=(3, 1))
    for f, zeta, share in zip(machine.natural_hz, machine.damping, machine.shares.T, strict=True):
        response = response + share[:, None] * acceleration(force, f, zeta)[None]
    values = response + machine.noise * rng.standard_normal(response.shape)
    knots = np.linspace(0.0, machine.duration_s, 400)
    band = sampled(values, rate_hz=RATE_HZ)
    return band, shaft(knots, angle(knots), first + (last - first) * knots / machine.duration_s)


def acceleration(force: np.ndarray, natural_hz: float, damping: float) -> np.ndarray:
    """Acceleration of one mode of unit mass under a ``force`` that is straight between samples (ramp invariant)."""
    w, step = 2 * np.pi * natural_hz, 1.0 / RATE_HZ
    pole = w * (-damping + 1j * np.sqrt(1 - damping**2))
    e = np.exp(pole * step)
    # x' = pole x + force: exact for a force that is straight between samples
    a1 = (e - 1.0 - pole * step) / (pole**2 * step)
    a0 = (e * (pole * step - 1.0) + 1.0) / (pole**2 * step)
    state = lfilter([a1, a0], [1.0, -e], force.astype(complex))
    # the displacement is Im(state) / w_d: acceleration is force - 2 zeta w velocity - w^2 displacement
    damped = w * np.sqrt(1 - damping**2)
    velocity = (pole * state).imag / damped
    return force - 2 * damping * w * velocity - w**2 * state.imag / damped
