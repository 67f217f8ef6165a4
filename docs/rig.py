"""Recordings of a test rig as a data logger writes them, made from formulas: what the tutorial analyses.

A rotor on a frame, run at ten speeds: order 1 from unbalance (its force grows with the speed squared), order 2 from a
coupling, order 3.57 from a ball bearing; a natural frequency at 62 Hz with 2.5 % damping, which noise shakes too; a
tacho with one pulse per revolution. ``python rig.py FOLDER`` writes the CSV files.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

RATE_HZ, SECONDS = 2048, 20.0
NATURAL_HZ, DAMPING = 62.0, 0.025
SPEEDS_RPM = (900, 1100, 1300, 1500, 1700, 1860, 2000, 2200, 2500, 2800)


def response(hz: float | np.ndarray) -> complex | np.ndarray:
    """Acceleration per force of the frame at ``hz``, relative to that far above its natural frequency."""
    ratio = np.asarray(hz) / NATURAL_HZ
    return -(ratio**2) / (1.0 - ratio**2 + 2j * DAMPING * ratio)


def recording(rpm: float, seed: int) -> np.ndarray:
    """Columns time (s), vertical (m/s2), horizontal (m/s2), tacho (V) of 20 s at ``rpm``."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(RATE_HZ * SECONDS)) / RATE_HZ
    hz = rpm / 60.0
    noise = np.fft.rfft(rng.standard_normal(time.size))
    shaken = np.fft.irfft(noise * response(np.fft.rfftfreq(time.size, 1.0 / RATE_HZ)), time.size)
    vertical = 0.05 * shaken + 0.02 * rng.standard_normal(time.size)
    horizontal = 0.02 * shaken + 0.02 * rng.standard_normal(time.size)
    for order, force in ((1.0, 0.4 * (rpm / 1500.0) ** 2), (2.0, 0.25), (3.57, 0.06)):
        line = force * response(order * hz) * np.exp(2j * np.pi * order * hz * time)
        vertical += line.real
        horizontal += 0.5 * line.imag
    turn = (time * hz + 0.5) % 1.0 - 0.5
    tacho = 5.0 * np.clip((0.1 - np.abs(turn)) / 0.06, 0.0, 1.0)
    return np.column_stack((time, vertical, horizontal, tacho))


def main(folder: Path) -> None:
    """Write one CSV file for each speed into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, rpm in enumerate(SPEEDS_RPM):
        np.savetxt(
            folder / f"run{number + 1:02d}_{rpm}rpm.csv",
            recording(rpm, number),
            delimiter=",",
            fmt=("%.6f", "%.5f", "%.5f", "%.2f"),
            header="time (s),vertical (m/s2),horizontal (m/s2),tacho (V)",
            comments="",
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
