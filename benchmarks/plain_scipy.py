"""The reference campaign by plain scipy, as one writes it in an afternoon: the yardstick of `campaign.py`.

Usage: python benchmarks/plain_scipy.py RECORDINGS OUT
It reads the same files, makes order spectra (cubic spline onto the crank angle, FFT) and Campbell maps
(`scipy.signal.welch` over the full band) and draws one PNG per channel. It detects, flags and estimates nothing.
OUT/orders.npz has the channels' names and of each recording (channel, bin) the peak amplitudes of the orders from 0 to
`MAX_ORDER`, evenly spaced.
"""

from __future__ import annotations

import sys
from pathlib import Path

import h5py
import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline
from scipy.signal import welch

PULSES_PER_REV, SAMPLES_PER_REV = 360, 256
MAX_ORDER = 20


def channels_of(path: Path) -> list[str]:
    """Names of the accelerometers in a file."""
    with h5py.File(path) as file:
        return sorted(name for name in file if name.startswith("acc"))


def analyse(path: Path, channels: list[str]) -> tuple[float, list[np.ndarray], list[np.ndarray]]:
    """Speed, density spectra and order spectra (peak amplitudes up to ``MAX_ORDER``) of one recording."""
    with h5py.File(path) as file:
        rate = float(file.attrs["rate_hz"])
        signals = [file[name][:] for name in channels]
        encoder = file["encoder"][:]
    return spectra(signals, encoder, rate)


def spectra(
    signals: list[np.ndarray], encoder: np.ndarray, rate: float
) -> tuple[float, list[np.ndarray], list[np.ndarray]]:
    """Speed, density spectra and order spectra of ``signals`` and ``encoder`` at ``rate`` samples a second."""
    high = encoder > 2.5
    edges = np.flatnonzero(high[1:] & ~high[:-1]) / rate
    revs = np.arange(len(edges)) / PULSES_PER_REV
    whole = int(revs[-1] // 2) * 2
    at = np.interp(np.arange(whole * SAMPLES_PER_REV) / SAMPLES_PER_REV, revs, edges)
    time = np.arange(len(encoder)) / rate
    densities = [welch(signal, rate, nperseg=2 * int(rate))[1] for signal in signals]
    orders = [2.0 * np.abs(np.fft.rfft(CubicSpline(time, signal)(at))) / len(at) for signal in signals]
    shown = [spectrum[: MAX_ORDER * whole + 1] for spectrum in orders]
    return 60 * revs[-1] / (edges[-1] - edges[0]), densities, shown


def main() -> None:
    recordings, out = Path(sys.argv[1]), Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    paths = sorted(recordings.glob("*.h5"))
    channels = channels_of(paths[0])
    found = [analyse(path, channels) for path in paths]
    spectra = {path.stem: np.array(item[2]) for path, item in zip(paths, found, strict=True)}
    np.savez(out / "orders.npz", channels=channels, **spectra)
    results = sorted(found, key=lambda item: item[0])
    speed = np.array([item[0] for item in results])
    for number, name in enumerate(channels):
        level = 10 * np.log10(np.array([item[1][number][:1000] for item in results]))
        figure = Figure(figsize=(11, 7))
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(np.arange(1000) / 2, speed, level, shading="nearest")
        figure.colorbar(mesh)
        figure.savefig(out / f"{name}.png", dpi=130)


if __name__ == "__main__":
    main()
