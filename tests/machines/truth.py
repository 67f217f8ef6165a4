"""What is so about a drawn machine: its dangerous speeds, its strongest order, what each recording held."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machines.folder import Take
from machines.machine import FloatArray, Machine

DANGEROUS_FACTOR = 3.0
"""A speed is dangerous where one mode makes an order more than so many times larger."""
REACH = 0.03
"""Share of the speed of a crossing within which its amplification is looked for."""
GRID = 601


@dataclass(frozen=True)
class Dangerous:
    """Speeds, rpm, at which one mode (``mode_hz``) makes one order more than three times larger; the worst of them."""

    order: float
    mode: int
    mode_hz: float
    low_rpm: float
    high_rpm: float
    worst_rpm: float
    factor: float


def amplification(machine: Machine, number: int, mode: int, rpm: FloatArray) -> FloatArray:
    """Largest amplitude over channels of order ``number`` at ``rpm`` (speed,), over that without the mode ``mode``."""
    whole = np.abs(machine.steady_response(number, rpm)).max(axis=0)
    without = np.abs(machine.steady_response(number, rpm, without=mode)).max(axis=0)
    return np.asarray(whole / np.maximum(without, 1e-12 * whole))


def on_a_flank(machine: Machine, number: int, mode: int, rpm: FloatArray) -> NDArray[np.bool_]:
    """Where, of ``rpm`` (speed,), the resonance with ``mode`` makes order ``number`` more than three times larger.

    Only as far as the mode itself is amplified so much: beyond, it carries the order without resonance.
    """
    x = machine.orders[number].order * np.maximum(rpm, 1e-9) / 60.0 / machine.modes[mode].frequency_hz
    near = (x**2 >= DANGEROUS_FACTOR / (DANGEROUS_FACTOR + 1.0)) & (x**2 <= DANGEROUS_FACTOR / (DANGEROUS_FACTOR - 1.0))
    over = np.zeros(rpm.size, dtype=np.bool_)
    if near.any():
        over[near] = amplification(machine, number, mode, rpm[near]) > DANGEROUS_FACTOR
    return over


def dangerous_near(machine: Machine, number: int, mode: int, low_rpm: float, high_rpm: float) -> Dangerous | None:
    """Where order ``number`` is dangerous near its crossing with ``mode``, from ``low_rpm`` to ``high_rpm``, if so."""
    order, hz = machine.orders[number].order, machine.modes[mode].frequency_hz
    crossing = 60.0 * hz / order
    rpm = crossing * np.linspace(1.0 - REACH, 1.0 + REACH, GRID)
    rpm = rpm[(rpm >= low_rpm) & (rpm <= high_rpm)]
    if not rpm.size:
        return None
    factor = amplification(machine, number, mode, rpm)
    over = np.nonzero(factor > DANGEROUS_FACTOR)[0]
    if not over.size:
        return None
    worst = over[np.argmax(factor[over])]
    return Dangerous(
        order, mode, hz, float(rpm[over[0]]), float(rpm[over[-1]]), float(rpm[worst]), float(factor[worst])
    )


def dangerous_speeds(machine: Machine) -> tuple[Dangerous, ...]:
    """Every dangerous speed of ``machine`` between its slowest and its fastest tested speed."""
    low, high = machine.tested_rpm[0], machine.tested_rpm[-1]
    found = [
        dangerous_near(machine, number, mode, max(low, 1.0), high)
        for number in range(len(machine.orders))
        for mode in range(len(machine.modes))
    ]
    return tuple(item for item in found if item is not None)


def recorded_maximum(machine: Machine, takes: tuple[Take, ...], number: int) -> FloatArray:
    """Largest amplitude, m/s², (channel,), that order ``number`` of ``machine`` really had in its recordings ``takes``.

    In a steady recording that is the mean over its length.
    """
    sizes = [np.abs(take.envelopes[number]) for take in takes]
    peaks = [size.mean(axis=1) if machine.steady else size.max(axis=1) for size in sizes]
    return np.asarray(np.max(peaks, axis=0))


def steady_maximum(machine: Machine, number: int) -> FloatArray:
    """Largest steady amplitude, m/s², (channel,), of order ``number``: at tested speeds, or over a sweep's range."""
    rpm = np.asarray(machine.tested_rpm)
    if not machine.steady:
        low, high = rpm[0], rpm[-1]
        near = [np.linspace(low, high, 2001)]
        for mode in machine.modes:
            crossing = 60.0 * mode.frequency_hz / machine.orders[number].order
            near.append(crossing * (1.0 + 4.0 * mode.damping_ratio * np.linspace(-1.0, 1.0, 201)))
        rpm = np.concatenate(near)
        rpm = rpm[(rpm >= low) & (rpm <= high)]
    return np.asarray(np.abs(machine.steady_response(number, rpm)).max(axis=1))
