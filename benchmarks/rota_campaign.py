"""The reference campaign by rota-order (pip, GPL; a black box beside us): the second yardstick of `campaign.py`.

Usage: python benchmarks/rota_campaign.py RECORDINGS OUT [--only N]
It reads the same files, makes speed, order map (1/16 order, to order 20) and frequency map (0.5 Hz, to 1.25 kHz) of
every recording, averages each to one spectrum and draws one PNG per channel. It prints the seconds of the analysis.
OUT/orders.npz has the channels' names and of each recording (channel, order) the peak amplitudes of the mean order
spectrum, by steps of `ORDER_STEP` from 0.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import h5py
import numpy as np
from matplotlib.figure import Figure
from rota.maps import rpm_frequency_map, rpm_order_map
from rota.speed import tacho_to_rpm

CHANNELS = ("acc_x", "acc_y", "acc_z")
PULSES_PER_REV = 360
ORDER_STEP, MAX_ORDER = 1 / 16, 20.0


def analyse(path: Path) -> tuple[float, np.ndarray, np.ndarray]:
    """Speed, mean order spectra and mean frequency spectra (axis, channel) of one recording."""
    with h5py.File(path) as file:
        rate = float(file.attrs["rate_hz"])
        signals = np.stack([file[name][:] for name in CHANNELS], axis=1).astype(np.float64)
        encoder = file["encoder"][:]
    rpm = np.asarray(tacho_to_rpm(encoder, rate, ppr=PULSES_PER_REV))
    orders = rpm_order_map(signals, rate, rpm, order_resolution=ORDER_STEP, max_order=MAX_ORDER, overlap=0.5)
    frequencies = rpm_frequency_map(signals, rate, rpm, resolution=0.5, max_freq=1250.0, overlap=0.5)
    # energy, over the frames
    means = [np.sqrt(np.nanmean(np.abs(each.values) ** 2, axis=1)) for each in (orders, frequencies)]
    return float(np.nanmean(rpm)), *means


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", type=int, default=0, help="so many recordings, spread over the speeds; 0: all")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    paths = sorted(options.recordings.glob("*.h5"))
    if options.only:
        paths = paths[:: max(1, len(paths) // options.only)][: options.only]
    start = time.perf_counter()
    found = [analyse(path) for path in paths]
    print(f"analysis {time.perf_counter() - start:.3f} s of {len(paths)} recordings")
    # rota-order's maps are RMS values unless asked otherwise
    spectra = {path.stem: np.sqrt(2.0) * item[1].T for path, item in zip(paths, found, strict=True)}
    np.savez(options.out / "orders.npz", channels=CHANNELS, **spectra)
    results = sorted(found, key=lambda item: item[0])
    speed = np.array([item[0] for item in results])
    for number, name in enumerate(CHANNELS):
        level = 20 * np.log10(np.maximum(np.array([item[2][:, number] for item in results]), 1e-12))
        figure = Figure(figsize=(11, 7))
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(np.arange(level.shape[1]) / 2, speed, level, shading="nearest")
        figure.colorbar(mesh)
        figure.savefig(options.out / f"{name}.png", dpi=130)


if __name__ == "__main__":
    main()
