"""Crank angle from a 360-pulse encoder: time of each step, and error of orders against what noise alone allows.

Usage: python benchmarks/shaft_angle.py [--repeats N] [--starts N]
Writes `reports/speed-error/shaft-angle.{json,md,png}`. One core; machines are shared and noisy: read the ratios.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table
from scipy.interpolate import CubicSpline

from crankorder.settings import load_settings
from crankorder.shaft.angle import AngleKnots, angle_at, angle_knots, time_at
from crankorder.shaft.pulses import find_pulses
from crankorder.shaft.smoother import Smoother, penalty_of
from crankorder.shaft.wheel import number_teeth

SETTINGS = load_settings().shaft
RATE_HZ, DURATION_S, TEETH = 50_000.0, 15.0, 360
N_SAMPLES = round(RATE_HZ * DURATION_S)
IN_STEP_RPM, FREE_RPM = (300.0, 1000.0, 2000.0), (303.7, 1013.7, 1987.3)
IRREGULARITY = {0.5: 0.005, 1.0: 0.005, 2.0: 0.005}
"""Share of the speed, by order: 1.5 % together."""
COUNTER_HZ = 1e7
ORDERS, PHASES_RAD = np.array([1.0, 2.0, 5.5, 10.0]), np.array([0.3, -1.1, 2.0, 0.7])
NOISE = 0.5 * 0.5**0.5
"""Standard deviation of the white noise over the amplitude of each line: half of the line's own rms."""
BOUND = NOISE * (2.0 / N_SAMPLES) ** 0.5
"""Cramer-Rao bound of an amplitude over the amplitude, and of a phase [rad], with the angle known (Rife 1974)."""
ALLOWED = (1.1**2 - 1.0) ** 0.5
"""What the encoder may add, in bounds, for a total of 1.1: its error and the noise are independent."""
MARK_SIZES = (4, 7, 11)
OURS = "crankorder: cubics between smoothed knots"


class Shaft:
    """A shaft of known angle: ``start_rev`` at time 0, ``speed_rpm`` on average, uneven by IRREGULARITY."""

    def __init__(self, speed_rpm: float, start_rev: float) -> None:
        self.revs_per_s, self.start_rev = speed_rpm / 60.0, start_rev

    def angle_rev(self, time_s: np.ndarray) -> np.ndarray:
        steady = self.revs_per_s * time_s
        swing = [a / (2 * np.pi * k) * np.sin(2 * np.pi * k * steady + k) for k, a in IRREGULARITY.items()]
        return self.start_rev + steady + sum(swing)

    def square(self) -> np.ndarray:
        return (self.angle_rev(np.arange(N_SAMPLES) / RATE_HZ) * TEETH % 1.0 < 0.5).astype(np.float32)

    def counter_times(self) -> np.ndarray:
        """Pulse times to the nearest count of COUNTER_HZ."""
        first, last = self.angle_rev(np.array([0.0, DURATION_S])) * TEETH
        angle = np.arange(np.ceil(first), np.floor(last) + 1) / TEETH
        times = (angle - self.start_rev) / self.revs_per_s
        for _ in range(30):
            times -= (self.angle_rev(times) - angle) / self.revs_per_s
        return np.round(times * COUNTER_HZ) / COUNTER_HZ


def edges(trace: np.ndarray) -> tuple[np.ndarray, float]:
    found = find_pulses(trace, rate_hz=RATE_HZ, kind="square", edge="rising", pulses_per_rev=TEETH, settings=SETTINGS)
    return found.time_s, found.noise_s


def knots_from(times: np.ndarray, tooth: np.ndarray, noise_s: float | None) -> AngleKnots:
    return angle_knots(times, tooth, teeth_per_rev=TEETH, noise_s=noise_s, settings=SETTINGS)


def columns(knots: AngleKnots) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return knots.time_s, knots.angle_rev, knots.speed_rpm


def moving_mean(times: np.ndarray, tooth: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Interval over a fixed window of a quarter revolution, then linear: what is done where no noise is asked for."""
    window = np.ones(TEETH // 4 + 1) / (TEETH // 4 + 1)
    return np.interp(wanted, np.convolve(tooth / TEETH, window, "valid"), np.convolve(times, window, "valid"))


def smoothed_spline(times: np.ndarray, tooth: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    smooth = Smoother(np.ones(times.size), penalty_of(SETTINGS.kept_order / TEETH)).smoothed(times)
    return CubicSpline(tooth / TEETH, smooth)(wanted)


def knots_then(
    between: Callable[[AngleKnots, np.ndarray], np.ndarray],
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    noise_s = 12.0**-0.5 / RATE_HZ
    return lambda times, tooth, wanted: between(knots_from(times, tooth, noise_s), wanted)


# times at which crank angles are passed, from pulse times, tooth numbers and the angles
METHODS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "linear between edges": lambda times, tooth, wanted: np.interp(wanted, tooth / TEETH, times),
    "spline through edges": lambda times, tooth, wanted: CubicSpline(tooth / TEETH, times)(wanted),
    "fixed window of 1/4 rev, linear": moving_mean,
    "linear between smoothed knots": knots_then(lambda knots, angle: np.interp(angle, knots.angle_rev, knots.time_s)),
    "spline through all smoothed edges": smoothed_spline,
    OURS: knots_then(lambda knots, angle: time_at(angle, *columns(knots))),
}


def whole_cycles(tooth: np.ndarray) -> np.ndarray:
    """As many even angles as there are samples, over the whole cycles that no method has to extrapolate."""
    first = np.ceil(tooth[0] / TEETH + 0.2)
    revs = (tooth[-1] / TEETH - 0.2 - first) // 2 * 2
    return first + np.arange(N_SAMPLES) * (revs / N_SAMPLES)


def order_errors(shaft: Shaft, wanted: np.ndarray, found_s: np.ndarray) -> tuple[np.ndarray, float]:
    """Error of each order in bounds (real: amplitude, imaginary: phase), and the rms error of the angle [deg].

    The record is free of noise, which would add its own error, independent of this one.
    """
    true_rev = shaft.angle_rev(found_s)
    signal = sum(np.cos(2 * np.pi * k * true_rev + phase) for k, phase in zip(ORDERS, PHASES_RAD, strict=True))
    read = [
        2 * np.mean(signal * np.exp(-1j * (2 * np.pi * k * wanted + p)))
        for k, p in zip(ORDERS, PHASES_RAD, strict=True)
    ]
    return (np.array(read) - 1.0) / BOUND, float(np.sqrt(np.mean((true_rev - wanted) ** 2))) * 360.0


def accuracy(speed_rpm: float, source: str, starts: int) -> dict[str, object]:
    """Bias and rms of the error of each order over ``starts`` start angles, in bounds; angle error and its estimate."""
    errors, angle_deg, stated_deg = [], [], []
    for start_rev in np.random.default_rng(1).uniform(0.0, 1.0, starts):
        shaft = Shaft(speed_rpm, start_rev)
        times, noise_s = edges(shaft.square()) if source == "square" else (shaft.counter_times(), None)
        tooth = np.round(shaft.angle_rev(times) * TEETH).astype(int)
        knots, wanted = knots_from(times, tooth, noise_s), whole_cycles(tooth)
        error, angle = order_errors(shaft, wanted, time_at(wanted, *columns(knots)))
        errors.append(error)
        angle_deg.append(angle)
        stated_deg.append(float(np.median(knots.standard_error_rev)) * 360.0)
    found = np.array(errors)
    return {
        "source": source,
        "speed_rpm": speed_rpm,
        "angle_rms_deg": float(np.mean(angle_deg)),
        "stated_deg": float(np.mean(stated_deg)),
        **{
            f"{name}_{what}": [round(float(value), 4) for value in statistic(part(found))]
            for name, part in (("amplitude", np.real), ("phase", np.imag))
            for what, statistic in (("bias", lambda e: e.mean(0)), ("rms", lambda e: np.sqrt((e**2).mean(0))))
        },
    }


def best_ms(works: list[Callable[[], object]], repeats: int) -> list[float]:
    """Least time of each of ``works`` in ``repeats`` rounds, in turn: all meet the same neighbours."""
    best = np.full(len(works), np.inf)
    for _ in range(repeats):
        for number, work in enumerate(works):
            start = time.perf_counter()
            work()
            best[number] = min(best[number], time.perf_counter() - start)
    return [round(float(seconds) * 1e3, 3) for seconds in best]


def timed(speed_rpm: float, repeats: int) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Time [ms] of each step at a speed; time, angle error and worst order error of every way to interpolate."""
    shaft = Shaft(speed_rpm, 0.3217)
    trace, at = shaft.square(), np.arange(N_SAMPLES) / RATE_HZ
    times, noise_s = edges(trace)
    tooth = np.round(shaft.angle_rev(times) * TEETH).astype(int)
    knots, wanted = knots_from(times, tooth, noise_s), whole_cycles(tooth)
    steps: dict[str, Callable[[], object]] = {
        "edges": lambda: edges(trace),
        "tooth numbers": lambda: number_teeth(times, pulses_per_rev=TEETH, settings=SETTINGS, noise_s=noise_s),
        "smoothed knots": lambda: knots_from(times, tooth, noise_s),
        "time of each angle": lambda: time_at(wanted, *columns(knots)),
        "angle of each time": lambda: angle_at(at, *columns(knots)),
    }
    ways = [lambda method=method: method(times, tooth, wanted) for method in METHODS.values()]
    each = best_ms([*steps.values(), *ways], repeats)
    step_ms = dict(zip(steps, each, strict=False))
    compared = {}
    for (name, method), cost in zip(METHODS.items(), each[len(steps) :], strict=True):
        error, angle = order_errors(shaft, wanted, method(times, tooth, wanted))
        worst = float(np.max(np.abs([error.real, error.imag])))
        compared[name] = {"ms": cost, "angle_rms_deg": angle, "worst_order_error": worst}
    return step_ms | {"edges to angles": round(sum(each[:4]), 3), "pulses": times.size}, compared


def measured(repeats: int, starts: int) -> dict[str, object]:
    """Times by step, error and time by method, and errors of orders by source and speed."""
    by_speed = {f"{speed:g}": timed(speed, repeats) for speed in FREE_RPM}
    rows = [("square", speed) for speed in (*IN_STEP_RPM, *FREE_RPM)] + [("counter", speed) for speed in IN_STEP_RPM]
    return {
        "what": f"{N_SAMPLES} samples at {RATE_HZ / 1e3:g} kHz, {TEETH} pulses per revolution, one core",
        "orders": ORDERS.tolist(),
        "noise_over_amplitude": NOISE,
        "bound_over_amplitude": BOUND,
        "starts": starts,
        "steps_ms": {name: steps for name, (steps, _) in by_speed.items()},
        "methods": {name: compared for name, (_, compared) in by_speed.items()},
        "accuracy": [accuracy(speed, source, starts) for source, speed in rows],
    }


def drawn(found: dict) -> Figure:
    """Angle error against time of the ways to interpolate; order errors of the same; errors by order and source."""
    figure = Figure(figsize=(16, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    angle, worst, by_order = figure.subplots(1, 3)
    for number, name in enumerate(METHODS):
        rows = [found["methods"][speed][name] for speed in found["methods"]]
        ours = name == OURS
        colour = "C3" if ours else f"C{number + (number > 2)}"
        for axes, key in ((angle, "angle_rms_deg"), (worst, "worst_order_error")):
            axes.plot([row["ms"] for row in rows], [row[key] for row in rows], "-", color=colour, lw=1)
            for row, size in zip(rows, MARK_SIZES, strict=True):
                shape = {"marker": "*", "ms": 1.7 * size, "mec": "k"} if ours else {"marker": "o", "ms": size}
                label = name if size == MARK_SIZES[1] and axes is angle else None
                axes.plot(row["ms"], row[key], ls="", color=colour, label=label, zorder=5 + ours, **shape)
    angle.set(ylabel="angle error, rms [deg]", title="Angle error against time: down and left is better")
    worst.set(ylabel="error added by the encoder / bound", title="Worst of orders 1, 2, 5.5, 10, same ways")
    _allowed_line(worst, 0.98, "right")
    for axes in (angle, worst):
        axes.set(yscale="log", xlim=(0, None), xlabel="time, pulses at hand → 750 000 times [ms], one core")
    _draw_orders(by_order, found)
    angle.set(ylim=(0.001, 0.1))
    worst.set(ylim=(0.01, 1))
    for axes in (angle, worst, by_order):
        axes.grid(alpha=0.3)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
    small, middle, large = found["methods"]
    title = f"small, middle, large marks: {small}, {middle}, {large} rpm"
    figure.legend(*angle.get_legend_handles_labels(), loc="outside lower left", ncols=3, title=title, frameon=False)
    return figure


def _allowed_line(axes: Axes, at: float, align: str) -> None:
    axes.axhline(ALLOWED, color="k", ls="--", lw=1)
    place = axes.get_yaxis_transform()
    axes.text(at, 1.05 * ALLOWED, "whole error 1.1 × bound", transform=place, ha=align, va="bottom", fontsize=9)


def _draw_orders(axes: Axes, found: dict) -> None:
    """What the encoder adds to the error of each order, amplitude and phase, by source and kind of speed."""
    kinds = (
        ("square wave, in step: 300, 1000, 2000 rpm", "C1", "square", IN_STEP_RPM),
        ("square wave, speeds as on the left", "C3", "square", FREE_RPM),
        ("10 MHz counter: 300, 1000, 2000 rpm", "C2", "counter", IN_STEP_RPM),
    )
    at = np.arange(len(ORDERS))
    for part, mark, shift in (("amplitude", "o", -0.05), ("phase", "^", 0.05)):
        for number, (name, colour, source, speeds) in enumerate(kinds):
            rows = [row for row in found["accuracy"] if row["source"] == source and row["speed_rpm"] in speeds]
            for row, size in zip(rows, MARK_SIZES, strict=True):
                label = name if (size, part) == (MARK_SIZES[1], "amplitude") else None
                x = at + 0.24 * (number - 1) + shift
                face = colour if part == "amplitude" else "none"
                axes.plot(x, row[f"{part}_rms"], mark, color=colour, mfc=face, ms=0.8 * size, label=label)
    _allowed_line(axes, 0.02, "left")
    axes.set_xticks(at, [f"order {order:g}" for order in ORDERS])
    axes.set(yscale="log", ylim=(5e-6, 1), ylabel="error added by the encoder, rms / bound")
    axes.legend(loc="lower left", title="filled dots: amplitude, open triangles: phase", frameon=False)
    axes.set_title("crankorder, by order and source of the pulses")


def page(found: dict) -> str:
    """The same numbers as a page of tables."""
    total = max(steps["edges to angles"] for steps in found["steps_ms"].values())
    ratio = f"{found['noise_over_amplitude']:.3g}"
    lines = [
        "# Crank angle from a 360-pulse encoder: time and error",
        "Made by `python benchmarks/shaft_angle.py`; do not edit.",
        "![error against time](shaft-angle.png)",
        f"{found['what']}; speed uneven by 1.5 % (orders 0.5, 1, 2). From the samples of the square wave to the times "
        f"of {N_SAMPLES} crank angles takes **{total:.1f} ms** at most.",
        "## Time [ms] by step",
        table(["rpm", *next(iter(found["steps_ms"].values()))], found["steps_ms"]),
        "## Ways to interpolate",
        "Time from pulse times to the times of the angles; error of the angle; error of the worst of orders "
        f"{', '.join(f'{order:g}' for order in ORDERS)} (amplitude or phase) in bounds (see below), one start angle. "
        "Noise that differs from edge to edge averages out of the orders, so even raw edges serve them; speed and "
        "standard error need the smooth angle. A fixed window loses true motion, which no averaging brings back.",
        table(
            ["way", *(f"{speed} rpm: {what}" for speed in found["methods"] for what in ("ms", "deg", "bounds"))],
            {
                name: {
                    f"{speed}{key}": f"{value:.3g}"
                    for speed, rows in found["methods"].items()
                    for key, value in rows[name].items()
                }
                for name in METHODS
            },
        ),
        "## Error that the encoder adds to each order, in bounds",
        f"Bound: Cramér–Rao with the angle known, {found['bound_over_amplitude']:.2e} of the amplitude (and rad of "
        f"phase) for white noise of {ratio} of the amplitude (half of the rms of the line) over {DURATION_S:g} s. "
        f"Below are bias / rms over {found['starts']} start angles of what the encoder adds; the whole error is "
        f"√(1 + rms²) bounds, so {ALLOWED:.2f} adds a tenth. With ten times less noise in the signal all numbers are "
        f"ten times larger. A bias is known to its rms / √{found['starts']}.",
        "At 300, 1000 and 2000 rpm a whole number of samples makes a revolution: the edges are rounded alike every "
        "time round, and the length of the record averages nothing out. At other speeds it does.",
        table(
            [
                "source",
                "rpm",
                "angle error, rms [deg]",
                "stated [deg]",
                *(f"{part} {order:g}" for part in ("amplitude", "phase") for order in ORDERS),
            ],
            {f"{row['source']} | {row['speed_rpm']:g}": _cells(row) for row in found["accuracy"]},
        ),
    ]
    return "\n\n".join(lines) + "\n"


def _cells(row: dict) -> dict[str, str]:
    cells = {"angle": f"{row['angle_rms_deg']:.2g}", "stated": f"{row['stated_deg']:.2g}"}
    for part in ("amplitude", "phase"):
        for order, bias, rms in zip(ORDERS, row[f"{part}_bias"], row[f"{part}_rms"], strict=True):
            cells[f"{part}{order}"] = f"{bias:+.3f} / {rms:.3f}"
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--starts", type=int, default=24)
    options = parser.parse_args()
    found = measured(options.repeats, options.starts)
    publish("shaft-angle", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
