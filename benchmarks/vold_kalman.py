"""Vold-Kalman filters: error and time against bandwidth, and time against the number of orders tracked jointly.

Usage: python benchmarks/vold_kalman.py [--repeats N]
Writes `reports/speed-error/vold-kalman.{json,md,png}`. One core; machines are shared and noisy: read the ratios.
rota-order and sdynpy are compared where they are installed.
"""

from __future__ import annotations

import argparse
import importlib
import os
import time
import warnings
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table
from scipy.linalg import solveh_banded

from crankorder.orders.filter_bandwidth import POLES
from crankorder.orders.vold_kalman import vold_kalman

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")  # sdynpy opens Qt on import

RATE_HZ, N_SAMPLES = 50_000.0, 500_000
TIME_S = np.arange(N_SAMPLES) / RATE_HZ
SPEED_HZ = 10.0 + 2.0 * TIME_S
SHAFT_REV = 10.0 * TIME_S + TIME_S**2
ROWS = np.arange(0, N_SAMPLES, 50)
"""Samples at which crankorder gives amplitudes; other programs give them at all."""
ORDER, TRUTH = 2.0, 1.7 * np.exp(0.4j)
RATIOS = (5e2, 2.5e3, 1e4, 5e4, 1.7e5, 5e5, 5e6)
"""Sample rate over bandwidth; r² of the textbook's form is 4e9 at the first, 3e20 at 5e5."""
ORDERS = (1, 2, 4, 8)
JOINT_RATIO = 1e4
WRONG = 0.1
"""Relative error from which a result counts as lost."""
OURS, BANDED, ROTA, SDYNPY = "crankorder", "normal equations, solveh_banded", "rota-order", "sdynpy"
STYLES = {OURS: ("C3", "*", 15), BANDED: ("C0", "o", 8), ROTA: ("C2", "s", 8), SDYNPY: ("C1", "^", 8)}
Filter = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def line(order: float, amplitude: complex) -> np.ndarray:
    turns = order * SHAFT_REV
    return np.real(amplitude * np.exp(2j * np.pi * (turns - np.floor(turns))))


def ours(signal: np.ndarray, orders: np.ndarray, bandwidth_hz: float) -> np.ndarray:
    phase, usable = orders[:, None] * SHAFT_REV, np.ones((1, N_SAMPLES), dtype=bool)
    settings = {
        "rate_hz": RATE_HZ,
        "bandwidth_hz": np.full((len(orders), 2), bandwidth_hz),
        "names": orders.astype(str),
    }
    return vold_kalman(signal[None], phase, ROWS, usable=usable, **settings)[0][0]


def banded(signal: np.ndarray, orders: np.ndarray, bandwidth_hz: float) -> np.ndarray:
    """The usual complex form of one order: pentadiagonal, real and imaginary part as two right-hand sides."""
    turned = signal * np.exp(-2j * np.pi * orders[0] * SHAFT_REV)
    r2 = (np.sqrt(2.0) - 1.0) / (2.0 * np.sin(0.5 * np.pi * bandwidth_hz / RATE_HZ)) ** 4
    band = np.empty((3, N_SAMPLES))
    band[0], band[1], band[2] = r2, -4.0 * r2, 6.0 * r2 + 1.0
    band[2, [0, -1]], band[2, [1, -2]] = r2 + 1.0, 5.0 * r2 + 1.0
    band[1, 1], band[1, -1] = -2.0 * r2, -2.0 * r2
    sides = np.stack([turned.real, turned.imag], axis=1)
    found = solveh_banded(band, sides, overwrite_ab=True, overwrite_b=True, check_finite=False)
    return 2.0 * (found[:, 0] + 1j * found[:, 1])[None]


def peers() -> dict[str, Filter]:
    """Other programs' filters, where they are installed. rota-order counts half the bandwidth."""
    found: dict[str, Filter] = {BANDED: banded}
    try:
        extract = importlib.import_module("rota.extract")

        def rota(signal: np.ndarray, orders: np.ndarray, bandwidth_hz: float) -> np.ndarray:
            joint = len(orders) > 1
            keywords = {"bandwidth": 0.5 * bandwidth_hz, "joint": joint, "return_components": True}
            result = extract.order_waveform(signal, RATE_HZ, 60.0 * SPEED_HZ, orders, **keywords)
            envelope = next(np.asarray(v) for v in vars(result).values() if np.iscomplexobj(v))
            return envelope.reshape(len(orders), -1) if envelope.shape[0] == len(orders) else envelope.T

        found[ROTA] = rota
    except ImportError:
        pass
    try:
        harmonic = importlib.import_module("sdynpy.signal_processing.sdynpy_harmonic")

        def sdynpy(signal: np.ndarray, orders: np.ndarray, bandwidth_hz: float) -> np.ndarray:
            argument = 2.0 * np.pi * orders[:, None] * SHAFT_REV
            keywords = {"filter_order": POLES, "bandwidth": np.array(bandwidth_hz), "method": "single"}
            _, amplitude, phase = harmonic.vold_kalman_filter(
                RATE_HZ, signal, argument, return_amp_phs=True, **keywords
            )
            return amplitude * np.exp(1j * phase)

        found[SDYNPY] = sdynpy
    except ImportError:
        pass
    return found


def run(track: Filter, orders: np.ndarray, bandwidth_hz: float, repeats: int) -> dict[str, object]:
    """Least time [s per order and 1e6 samples] and largest relative error of the amplitude, or why there is none."""
    truth = np.array([TRUTH / (1 + k) for k in range(len(orders))])
    signal = np.sum([line(order, one) for order, one in zip(orders, truth, strict=True)], axis=0)
    best = np.inf
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for _ in range(repeats):
                start = time.process_time()
                found = track(signal, orders, bandwidth_hz)
                best = min(best, time.process_time() - start)
    except (ValueError, np.linalg.LinAlgError) as error:
        return {"s": None, "error": None, "inside": None, "failed": f"{type(error).__name__}: not definite"}
    except MemoryError:
        return {"s": None, "error": None, "inside": None, "failed": "MemoryError: refused"}
    # peers differ in the sign of the phase: amplitudes are compared
    off = np.abs(np.abs(found) - np.abs(truth)[:, None]) / np.abs(truth)[:, None]
    wrong, inside = float(off.max()), float(off[:, off.shape[1] // 5 : -off.shape[1] // 5].max())
    seconds = round(best / len(orders) / N_SAMPLES * 1e6, 4)
    known = {"error": wrong if np.isfinite(wrong) else None, "inside": inside if np.isfinite(inside) else None}
    return {"s": seconds, **known, "failed": None if inside < WRONG else "lost"}


def measured(repeats: int) -> dict[str, object]:
    """Error and time of every filter at each bandwidth; time of ours and rota-order by number of joint orders."""
    filters: dict[str, Filter] = {OURS: ours, **peers()}
    ours(line(ORDER, TRUTH), np.array([ORDER]), 100.0)  # compile
    one = np.array([ORDER])
    by_width = {
        f"{ratio:g}": {name: run(track, one, RATE_HZ / ratio, repeats) for name, track in filters.items()}
        for ratio in RATIOS
    }
    joint = {}
    for count in ORDERS:
        several = {name: track for name, track in filters.items() if name in (OURS, ROTA)}
        orders = 2.0 + 0.5 * np.arange(count)
        joint[str(count)] = {
            name: run(track, orders, RATE_HZ / JOINT_RATIO, repeats) for name, track in several.items()
        }
    absent = [name for name in (ROTA, SDYNPY) if name not in filters]
    return {
        "what": f"order 2 of a run-up from 10 to 30 Hz, {N_SAMPLES} samples at {RATE_HZ / 1e3:g} kHz, steady "
        "amplitude, no noise, two poles, one core",
        "absent": absent,
        "by_rate_over_bandwidth": by_width,
        "joint": joint,
    }


def drawn(found: dict) -> Figure:
    """Error against bandwidth with failures marked; time against bandwidth; time against the number of orders."""
    figure = Figure(figsize=(15, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    error, seconds, joint = figure.subplots(1, 3)
    rows = found["by_rate_over_bandwidth"]
    for name in next(iter(rows.values())):
        _draw_filter(error, seconds, name, rows)
    for name in next(iter(found["joint"].values())):
        colour, mark, size = STYLES[name]
        values = [row[name]["s"] or np.nan for row in found["joint"].values()]
        joint.plot([int(count) for count in found["joint"]], values, mark, ls="-", color=colour, ms=size, mec="k")
    error.axhspan(WRONG, 1e3, color="0.92", zorder=0)
    error.text(5e3, 250.0, "✕ not definite, or lost", ha="center", va="center", fontsize=10)
    error.set(yscale="log", ylim=(1e-16, 1e3), ylabel="largest relative error of the amplitude, ends apart")
    error.set_title("Error: only rounding should be left")
    for axes in (error, seconds):
        axes.set(xscale="log", xlabel="sample rate / bandwidth")
    seconds.set_title("Time of one order")
    joint.set(
        xscale="log", xlabel="orders tracked jointly", title=f"Time of several orders, rate / bandwidth {JOINT_RATIO:g}"
    )
    joint.set_xticks(ORDERS, [str(count) for count in ORDERS])
    joint.minorticks_off()
    for axes in (seconds, joint):
        axes.set(yscale="log", ylim=(0.01, 10), ylabel="s per order and 10⁶ samples")
        axes.axhline(0.05, color="k", ls="--", lw=1)
        axes.yaxis.set_major_formatter("{x:g}")
    seconds.text(RATIOS[-1], 0.053, "mark 0.05 s", ha="right", va="bottom", fontsize=9)
    for axes in (error, seconds, joint):
        axes.grid(alpha=0.3)
    figure.legend(*error.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw_filter(error: Axes, seconds: Axes, name: str, rows: dict) -> None:
    colour, mark, size = STYLES[name]
    at = [float(ratio) for ratio in rows]
    good = [(x, row[name]["inside"]) for x, row in zip(at, rows.values(), strict=True) if row[name]["failed"] is None]
    style = {"color": colour, "ms": size, "mec": "k", "zorder": 5 if name == OURS else 3}
    error.plot(*zip(*good, strict=True), mark, ls="-", label=name, **style) if good else None
    failed = [x for x, row in zip(at, rows.values(), strict=True) if row[name]["failed"]]
    level = 1.0 * 3.0 ** list(STYLES).index(name)
    error.plot(failed, [level] * len(failed), "x", color=colour, ms=9, mew=2.5)
    timed = [(x, row[name]["s"]) for x, row in zip(at, rows.values(), strict=True) if row[name]["failed"] is None]
    seconds.plot(*zip(*timed, strict=True), mark, ls="-", **style) if timed else None


def _cell(row: dict, key: str) -> str:
    if row["s"] is None:
        return row["failed"]
    if key == "s":
        return f"{row['s']:.3f}"
    return f"{row[key]:.1e}" if row[key] is not None else "lost (not a number)"


def page(found: dict) -> str:
    """The same numbers as a page of tables."""
    rows = found["by_rate_over_bandwidth"]
    names = list(next(iter(rows.values())))
    pairs = [row for row in rows.values() if row[BANDED]["s"] is not None]
    ratio = [row[BANDED]["s"] / row[OURS]["s"] for row in pairs]
    text = f"In this run crankorder is {min(ratio):.1f} to {max(ratio):.1f} times as fast as `solveh_banded`"
    if ROTA in names:
        times = [row[ROTA]["s"] / row[OURS]["s"] for row in rows.values() if row[ROTA]["s"] is not None]
        text += f" and {min(times):.0f} to {max(times):.0f} times as fast as rota-order"
    joint = {count: {name: _cell(row, "s") for name, row in one.items()} for count, one in found["joint"].items()}
    lines = [
        "# Vold-Kalman filters: error and time",
        "Made by `python benchmarks/vold_kalman.py`; do not edit.",
        "![error and time](vold-kalman.png)",
        f"{found['what'][0].upper()}{found['what'][1:]}. {text}. rota-order and crankorder solve the real form; the "
        "complex form of the other two leaks the image at minus the frequency, most of all at the ends. "
        "rota-order counts its bandwidth to one side; the same filters are compared.",
        "## Largest relative error of the amplitude in the middle three fifths of the record (drawn)",
        table(["rate / bandwidth", *names], {k: {n: _cell(r[n], "inside") for n in names} for k, r in rows.items()}),
        "## Largest relative error of the amplitude, ends included",
        table(["rate / bandwidth", *names], {k: {n: _cell(r[n], "error") for n in names} for k, r in rows.items()}),
        "## Time [s per order and 10⁶ samples]",
        table(["rate / bandwidth", *names], {k: {n: _cell(r[n], "s") for n in names} for k, r in rows.items()}),
        f"## Time [s per order and 10⁶ samples] of orders tracked jointly, rate / bandwidth {JOINT_RATIO:g}",
        table(["orders", *next(iter(joint.values()))], joint),
        "crankorder's time includes the standard errors; it gives amplitudes at every 50th sample, others at each.",
    ]
    if found["absent"]:
        lines.append(f"Not installed in this run, and left out: {', '.join(found['absent'])}.")
    return "\n\n".join(lines) + "\n"


def main() -> None:
    """Measure, then write tables and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=2, help="rounds of timing, of which the best counts")
    found = measured(parser.parse_args().repeats)
    publish("vold-kalman", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
