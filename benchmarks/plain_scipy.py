"""The reference campaign by plain scipy, as one writes it in an afternoon: the yardstick of `campaign.py`.

Usage: python benchmarks/plain_scipy.py RECORDINGS OUT
It reads the same files, makes order spectra (cubic spline onto the crank angle, FFT) and Campbell maps
(`scipy.signal.welch` over the full band) and draws one PNG per channel. It detects, flags and estimates nothing.
"""

from __future__ import annotations

import sys
from pathlib import Path

import h5py
import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline
from scipy.signal import welch

CHANNELS = ("acc_x", "acc_y", "acc_z")
PULSES_PER_REV, SAMPLES_PER_REV = 360, 256


def analyse(path: Path) -> tuple[float, list[np.ndarray], list[np.ndarray]]:
    """Speed, density spectra and order spectra of one recording."""
    with h5py.File(path) as file:
        rate = float(file.attrs["rate_hz"])
        signals = [file[name][:] for name in CHANNELS]
        encoder = file["encoder"][:]
    high = encoder > 2.5
    edges = np.flatnonzero(high[1:] & ~high[:-1]) / rate
    revs = np.arange(len(edges)) / PULSES_PER_REV
    whole = int(revs[-1] // 2) * 2
    at = np.interp(np.arange(whole * SAMPLES_PER_REV) / SAMPLES_PER_REV, revs, edges)
    time = np.arange(len(encoder)) / rate
    densities = [welch(signal, rate, nperseg=2 * int(rate))[1] for signal in signals]
    orders = [np.abs(np.fft.rfft(CubicSpline(time, signal)(at))) / len(at) for signal in signals]
    return 60 * revs[-1] / (edges[-1] - edges[0]), densities, orders


def main() -> None:
    recordings, out = Path(sys.argv[1]), Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    results = sorted((analyse(path) for path in recordings.glob("*.h5")), key=lambda item: item[0])
    speed = np.array([item[0] for item in results])
    for number, name in enumerate(CHANNELS):
        level = 10 * np.log10(np.array([item[1][number][:1000] for item in results]))
        figure = Figure(figsize=(11, 7))
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(np.arange(1000) / 2, speed, level, shading="nearest")
        figure.colorbar(mesh)
        figure.savefig(out / f"{name}.png", dpi=130)


if __name__ == "__main__":
    main()
