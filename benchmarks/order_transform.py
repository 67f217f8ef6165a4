"""Order amplitudes from samples in time: throughput against the worst amplitude error, ours beside other ways.

Usage: python benchmarks/order_transform.py [--repeats N]
Writes `reports/speed-error/order-transform.{json,md,png}`. One core; machines are shared and noisy: read the ratios.
rota-order (pip, GPL; a black box beside us) is measured where it is installed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import scipy.fft
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table
from scipy.signal import ShortTimeFFT

from crankorder.fft.resampling import cheapest_kernel, values_at
from crankorder.shaft.angle import time_at

RATE_HZ, N_SAMPLES, SPEED_HZ = 50_000.0, 750_000, 1500.0 / 60.0
ORDERS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 5.5, 10.0, 12.0])
AMPLITUDES = np.array([0.3, 1.0, 0.2, 0.8, 0.1, 0.5, 0.15, 0.25])
BEGIN_REV, REVS, FRAME_REVS, SAMPLES_PER_REV = 4.0, 360.0, 16, 2048
TOLERANCES = (1e-3, 1e-6, 1e-12)
NUMPY = "numpy exp + BLAS"
FLOOR = 1e-16
Work = Callable[[], np.ndarray]


class Run:
    """Three channels of eight orders on an uneven shaft (1 %), known exactly."""

    def __init__(self) -> None:
        self.time_s = np.arange(N_SAMPLES) / RATE_HZ
        self.angle_rev = self.angle_at(self.time_s)
        phases = np.random.default_rng(1).uniform(-np.pi, np.pi, (3, len(ORDERS)))
        signals = np.zeros((3, N_SAMPLES))
        for k, order in enumerate(ORDERS):
            turn = 2.0 * np.pi * (order * self.angle_rev % 1.0)
            signals += AMPLITUDES[k] * np.cos(turn + phases[:, k, None])
        self.signals = {"float64": signals, "float32": signals.astype(np.float32)}
        slope = SPEED_HZ * (1.0 + 0.01 * np.cos(2.0 * np.pi * SPEED_HZ * self.time_s)) / RATE_HZ
        turns = (self.angle_rev - BEGIN_REV) / REVS
        self.weights = (
            2.0 * np.where((turns > 0.0) & (turns < 1.0), 1.0 - np.cos(2.0 * np.pi * turns), 0.0) * slope / REVS
        )
        knots = np.arange(0.0, self.time_s[-1] + 0.001, 0.0005)
        speed = 60.0 * SPEED_HZ * (1.0 + 0.01 * np.cos(2.0 * np.pi * SPEED_HZ * knots))
        self.knots = {"knot_time_s": knots, "knot_angle_rev": self.angle_at(knots), "knot_speed_rpm": speed}
        wanted = BEGIN_REV + np.arange(int(REVS) * SAMPLES_PER_REV) / SAMPLES_PER_REV
        self.positions = time_at(wanted, **self.knots) * RATE_HZ

    @staticmethod
    def angle_at(time_s: np.ndarray) -> np.ndarray:
        return SPEED_HZ * time_s + 0.01 / (2.0 * np.pi) * np.sin(2.0 * np.pi * SPEED_HZ * time_s)


def plain(run: Run) -> np.ndarray:
    return (run.signals["float64"] * run.weights) @ np.exp(-2j * np.pi * np.outer(run.angle_rev, ORDERS))


def resampled(run: Run, precision: str, tolerance: float | None) -> np.ndarray:
    double = precision == "float64"
    kernel = None if tolerance is None else cheapest_kernel(tolerance, content=0.05, double=double)
    values = values_at(run.signals[precision], run.positions, kernel=kernel)
    n = values.shape[1]
    window = (1.0 - np.cos(2.0 * np.pi * np.arange(n) / n)).astype(values.dtype)
    spectrum = scipy.fft.rfft(values * window, axis=1)
    return spectrum[:, np.rint(ORDERS * REVS).astype(int)] * (2.0 / n)


def time_fft(run: Run) -> np.ndarray:
    """One spectrum of the whole record, each order at its nearest frequency, as in the thesis."""
    spectrum = np.abs(np.fft.rfft(run.signals["float64"], axis=1)) * (2.0 / N_SAMPLES)
    return spectrum[:, np.rint(ORDERS * SPEED_HZ * N_SAMPLES / RATE_HZ).astype(int)]


def short_time_fft(run: Run) -> np.ndarray:
    window = np.hanning(32_769)[:-1]
    transform = ShortTimeFFT(window, hop=16_384, fs=RATE_HZ, scale_to="magnitude")
    made = np.abs(transform.stft(run.signals["float64"]))[..., 2:-2].mean(axis=2) * 2.0
    return made[:, np.rint(ORDERS * SPEED_HZ / transform.delta_f).astype(int)]


def rota_order(run: Run) -> Work | None:
    try:
        from rota.maps import rpm_order_map
    except ImportError:
        return None
    rpm = 60.0 * SPEED_HZ * (1.0 + 0.01 * np.cos(2.0 * np.pi * SPEED_HZ * run.time_s))

    def work() -> np.ndarray:
        signals = run.signals["float64"].T
        asked = {"order_resolution": 1 / FRAME_REVS, "max_order": 13.0, "overlap": 0.0, "amplitude": "peak"}
        made = rpm_order_map(signals, RATE_HZ, rpm, **asked)
        values = np.asarray(made.values)
        axis = values.shape.index(3)
        level = np.nanmean(np.moveaxis(values, axis, 0), axis=-1)
        return level[:, np.rint(ORDERS * FRAME_REVS).astype(int)]

    return work


def ways(run: Run) -> dict[str, tuple[str, Work]]:
    """Name to family and work; each work gives amplitudes (channels, orders), complex or not."""
    made: dict[str, tuple[str, Work]] = {NUMPY: ("plain", lambda: plain(run))}
    made["resampled, default kernel, float64"] = ("resampled", lambda: resampled(run, "float64", None))
    for tolerance in TOLERANCES:
        name = f"resampled, cheapest for {tolerance:g}, float64"
        made[name] = ("resampled", lambda tolerance=tolerance: resampled(run, "float64", tolerance))
    made["resampled, cheapest for 1e-6, float32"] = ("resampled", lambda: resampled(run, "float32", 1e-6))
    made["FFT of the record in time, nearest bin"] = ("time", lambda: time_fft(run))
    made["scipy ShortTimeFFT, nearest bin"] = ("short", lambda: short_time_fft(run))
    rota = rota_order(run)
    if rota is not None:
        made["rota-order rpm_order_map"] = ("rota", rota)
    return made


def measured(repeats: int) -> dict:
    """Error and best CPU time of each way; slow ones are run once."""
    run = Run()
    works = ways(run)
    rows: dict[str, dict] = {}
    for name, (family, work) in works.items():
        found = np.abs(work())
        error = float(np.max(np.abs(found / AMPLITUDES - 1.0)))
        rows[name] = {"family": family, "worst_error": max(error, FLOOR), "seconds": np.inf}
    for turn in range(repeats):
        for name, (_, work) in works.items():
            if turn and rows[name]["seconds"] > 1.0:
                continue
            start = time.process_time()
            work()
            rows[name]["seconds"] = min(rows[name]["seconds"], time.process_time() - start)
    for row in rows.values():
        row["samples_per_s"] = 3 * N_SAMPLES / row["seconds"]
        row["ratio"] = rows[NUMPY]["seconds"] / row["seconds"]
    return {"orders": ORDERS.tolist(), "channels": 3, "samples": N_SAMPLES, "rows": rows}


MARKS = {
    "plain": ("k", "s", "numpy exp + BLAS, eight orders"),
    "resampled": ("C0", "o", "crankorder: resampled by angle + FFT, all orders"),
    "time": ("C1", "X", "FFT in time, nearest bin"),
    "short": ("C5", "P", "scipy ShortTimeFFT, nearest bin"),
    "rota": ("C7", "h", "rota-order rpm_order_map"),
}
LABELS = {
    NUMPY: ("numpy", -9, -4, "right"),
    "resampled, default kernel, float64": ("48 taps", -9, -4, "right"),
    **{f"resampled, cheapest for {each:g}, float64": (f"asked: {each:g}", 9, -14, "left") for each in TOLERANCES},
    "resampled, cheapest for 1e-6, float32": ("asked: 1e-6, float32", 9, 4, "left"),
}
"""Text, its offset in points and alignment."""


def drawn(found: dict) -> Figure:
    """Worst error against throughput over numpy's."""
    figure = Figure(figsize=(11, 6.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for family, (colour, mark, name) in MARKS.items():
        rows = {key: row for key, row in found["rows"].items() if row["family"] == family}
        if not rows:
            continue
        ratio, error = ([row[key] for row in rows.values()] for key in ("ratio", "worst_error"))
        size = 15 if mark == "*" else 9
        axes.plot(ratio, error, mark, ls="", color=colour, ms=size, mec="k", mew=0.6, label=name, zorder=3)
        for key, x, y in zip(rows, ratio, error, strict=True):
            if key in LABELS:
                text, right, up, align = LABELS[key]
                axes.annotate(text, (x, y), (right, up), textcoords="offset points", ha=align, fontsize=9)
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(0.05, 50.0),
        ylim=(1e-15, 3.0),
        xlabel=f"throughput over that of {NUMPY} (one core)",
    )
    axes.set(ylabel="worst relative amplitude error of eight orders")
    axes.set_title("Order amplitudes of 3 × 750 000 samples: down and right is better")
    axes.xaxis.set_major_formatter("{x:g}×")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", frameon=False)
    return figure


def page(found: dict) -> str:
    rows = found["rows"]
    cells = [
        [name, f"{row['samples_per_s'] / 1e6:.1f}", f"{row['ratio']:.2g}", f"{row['worst_error']:.1e}"]
        for name, row in rows.items()
    ]
    ours = rows["resampled, cheapest for 1e-06, float64"]
    missing = "" if any(row["family"] == "rota" for row in rows.values()) else " rota-order was not installed."
    lines = [
        "# Order amplitudes of samples in time: throughput and error",
        "Made by `python benchmarks/order_transform.py`; do not edit.",
        "![error against throughput](order-transform.png)",
        f"Three channels of {N_SAMPLES} samples at 50 kHz, 1500 rpm uneven by 1 %, orders "
        f"{', '.join(f'{order:g}' for order in ORDERS)}, free of noise, angle known exactly. Error: the worst "
        f"amplitude over its own size. The kernel asked for 1e-6 gives all {round(12 * REVS) + 1} orders "
        f"to 12 at once, **{ours['ratio']:.1f} times as fast as {NUMPY} gives eight**, its error "
        f"{ours['worst_error'] * 1e6:.1g} ppm. "
        "Channel-samples per second of CPU time, best of several rounds in turn." + missing,
        table(["way", "10⁶ channel-samples/s", "over numpy", "worst error"], cells),
        "numpy finds angle, window and weights made, over 360 revolutions at once; resampling finds its positions "
        "made, 2048 to a revolution. "
        "rota-order is given the exact speed. An FFT in time reads an order at the nearest frequency: an uneven speed, "
        "or one between bins, is its error.",
    ]
    return "\n\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    found = measured(parser.parse_args().repeats)
    publish("order-transform", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
