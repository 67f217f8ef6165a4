"""Truncated series against the exact piston acceleration: error and time over crank ratio and number of orders.

Usage: python benchmarks/slider_crank.py [--repeats N]
Writes `reports/speed-error/slider-crank.{json,md,png}`. One core; machines are shared and noisy: read the ratios.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numba import njit
from published import publish, table

from crankorder.engine.compiled_slider_crank import fast_sine_cosine, fill_acceleration
from crankorder.engine.slider_crank import (
    SliderCrank,
    acceleration_harmonics,
    orders_for,
    peak_acceleration,
    piston_acceleration,
    plain_piston_acceleration,
)

RATIOS = (0.1, 0.25, 44.9 / 152, 0.5, 0.9, 0.99)
ORDERS = (1, 2, 4, 6, 8, 10, 12, 14, 16, 20, 24, 32, 48, 64, 96, 128, 192, 256)
TOLERANCES = (1e-2, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15)
N_ANGLES = 1_000_000
BLOCK = 512
ROUND_OFF = np.finfo(float).eps
SHOWN = 1e-15
"""Share of the peak within which the exact form stays, by 60-digit arithmetic (tests/engine/test_slider_crank.py)."""


@njit(cache=True, nogil=True, error_model="numpy")
def fill_series(crank_angle_rev, even, out):  # type: ignore[no-untyped-def]
    """cos φ plus the even harmonics, by Clenshaw's recurrence over blocks of angles: the cheapest form of the sum."""
    first, twice, after, this = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, crank_angle_rev.size, BLOCK):
        n = min(BLOCK, crank_angle_rev.size - start)
        for i in range(n):
            _, cosine = fast_sine_cosine(crank_angle_rev[start + i])
            first[i] = cosine
            twice[i] = 2.0 * (2.0 * cosine * cosine - 1.0)
            after[i] = 0.0
            this[i] = 0.0
        for k in range(even.size - 1, -1, -1):
            harmonic = even[k]
            for i in range(n):
                new = harmonic + twice[i] * this[i] - after[i]
                after[i] = this[i]
                this[i] = new
        for i in range(n):
            out[start + i] = first[i] + 0.5 * twice[i] * this[i] - after[i]


def best_nanoseconds(works: list[Callable[[], object]], repeats: int) -> list[float]:
    """Least time per angle of each of ``works`` in ``repeats`` rounds, in turn: all meet the same neighbours."""
    best = np.full(len(works), np.inf)
    for _ in range(repeats):
        for number, work in enumerate(works):
            start = time.perf_counter()
            work()
            best[number] = min(best[number], time.perf_counter() - start)
    return [float(seconds) for seconds in best / N_ANGLES * 1e9]


def errors(ratio: float) -> list[float]:
    """Largest error of the sum up to each of ``ORDERS`` over the peak acceleration, on angles dense about 90°."""
    mechanism = SliderCrank(crank_radius_m=ratio, rod_length_m=1.0)
    near = np.geomspace(1e-6, 0.25, 4000)
    angles = np.concatenate([np.linspace(0, 1, 20001), 0.25 + near, 0.25 - near])
    exact = piston_acceleration(angles, mechanism) / ratio
    harmonics = acceleration_harmonics(mechanism, ORDERS[-1]).real
    summed, found = np.empty_like(angles), []
    for order in ORDERS:
        fill_series(angles, harmonics[2 : order + 1 : 2], summed)
        found.append(float(np.abs(summed - exact).max() / peak_acceleration(mechanism)))
    return found


def measured(repeats: int) -> dict[str, object]:
    """Errors by crank ratio and order, times by order, and of the exact forms."""
    angles = np.random.default_rng(1).uniform(0, 100, N_ANGLES)
    out = np.empty_like(angles)
    mechanism = SliderCrank(crank_radius_m=44.9, rod_length_m=152)
    shapes = {f"{ratio:.4g}": SliderCrank(crank_radius_m=ratio, rod_length_m=1.0) for ratio in (*RATIOS, 0.999)}
    harmonics = acceleration_harmonics(mechanism, ORDERS[-1]).real
    sums = [lambda h=harmonics[2 : order + 1 : 2]: fill_series(angles, h, out) for order in ORDERS]
    lengths = (mechanism.crank_radius_m, mechanism.crank_ratio, mechanism.offset_ratio, mechanism.margin)
    kernel = lambda: fill_acceleration(angles, *lengths, out)  # noqa: E731  a call to be timed, as the sums are
    exact, *series = best_nanoseconds([kernel, *sums], repeats)
    whole, plain = best_nanoseconds(
        [lambda f=f: f(angles, mechanism) for f in (piston_acceleration, plain_piston_acceleration)], 10
    )
    return {
        "what": f"{N_ANGLES} crank angles a call into an array at hand, one core, float64; no time depends on λ",
        "orders": list(ORDERS),
        "error_over_peak": {f"{ratio:.4g}": errors(ratio) for ratio in RATIOS},
        "series_ns_per_angle": [round(value, 2) for value in series],
        "exact_ns_per_angle": round(exact, 2),
        "whole_call_ns_per_angle": round(whole, 2),
        "whole_call_million_angles_per_s": round(1e3 / whole),
        "plain_numpy_ns_per_angle": round(plain, 1),
        "orders_for": {
            name: {f"{tolerance:g}": orders_for(tolerance, shape) for tolerance in TOLERANCES}
            for name, shape in shapes.items()
        },
    }


def drawn(found: dict) -> Figure:
    """Error against order, time against order, and error against time, with the exact form in each."""
    figure = Figure(figsize=(15, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    error, cost, both = figure.subplots(1, 3)
    orders, series = np.array(found["orders"]), np.array(found["series_ns_per_angle"])
    exact, plain = found["exact_ns_per_angle"], found["plain_numpy_ns_per_angle"]
    for number, (name, values) in enumerate(found["error_over_peak"].items()):
        style = {"color": f"C{number}", "ms": 3.5, "label": f"λ = {name}"}
        above = 1 + np.argmax(np.append(np.array(values) < 3 * SHOWN, True))  # the first one at round-off ends the line
        error.plot(orders[:above], np.maximum(values[:above], ROUND_OFF), "o-", **style)
        both.plot(series[:above], np.maximum(values[:above], ROUND_OFF), "o-", **style)
    error.set(xlabel="highest order of the sum", title="A short rod needs many orders")
    error.text(orders[-1] / 1.1, 0.5 * SHOWN, "exact, every λ: below", fontsize=9, va="top", ha="right")
    error.legend(fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 0.12))

    cost.plot(orders, series, "o-", color="0.35", ms=3.5)
    cost.text(1.1, 1.6 * series[0], "sum (Clenshaw, compiled)", color="0.35", fontsize=9)
    cost.axhline(exact, color="C3", lw=2)
    cost.text(1.1, exact - 0.4, f"exact, compiled: {exact:.1f} ns", color="C3", fontsize=9, va="top")
    cost.text(0.03, 0.97, f"off the scale: exact in plain NumPy, {plain:.0f} ns", transform=cost.transAxes, va="top")
    cost.set(
        xlabel="highest order of the sum", ylabel="time per crank angle [ns], one core", ylim=(0, 1.15 * series.max())
    )
    cost.set_title("The exact form costs what a short sum costs")

    both.plot([exact], [ROUND_OFF], "*", color="C3", ms=20, mec="k", zorder=5)
    both.annotate("exact, every λ", (exact, ROUND_OFF), (2.5 * exact, 0.9 * ROUND_OFF), color="C3", va="center")
    both.set(xlabel="time per crank angle [ns], one core", xlim=(0, 1.05 * series.max()))
    both.set_title("Error against time: down and left is better")
    both.legend(fontsize=9, loc="upper right")
    for axes in (error, both):
        axes.set(yscale="log", ylim=(ROUND_OFF / 6, 3), ylabel="largest error / peak acceleration")
        axes.axhline(SHOWN, color="k", ls="--", lw=1)
    for axes in (error, cost):
        axes.set_xscale("log", base=2)
        axes.xaxis.set_major_formatter("{x:.0f}")
        axes.set_xlim(1, orders[-1])
    for axes in (error, cost, both):
        axes.grid(alpha=0.3)
    return figure


def page(found: dict) -> str:
    """The same numbers as a page of tables."""
    exact, plain = found["exact_ns_per_angle"], found["plain_numpy_ns_per_angle"]
    series = dict(zip(found["orders"], found["series_ns_per_angle"], strict=True))
    cheap = [order for order, value in series.items() if value <= 1.1 * exact]
    dearer = next((order for order in series if not cheap or order > cheap[-1]), None)
    lines = [
        "# Piston acceleration: truncated series against the exact form",
        "Made by `python benchmarks/slider_crank.py`; do not edit.",
        "![error and time](slider-crank.png)",
        f"{found['what'][0].upper()}{found['what'][1:]}.",
        f"The exact form takes **{exact:.1f} ns** an angle at round-off error for every crank ratio; one call of "
        f"`piston_acceleration` makes {found['whole_call_million_angles_per_s']} million a second, its new array "
        f"included, plain NumPy {1e3 / plain:.0f} million. "
        + (
            f"A sum costs more than a tenth more from order {dearer} on."
            if dearer
            else "No sum up to the last order costs more."
        ),
        "A sum of orders is still what order forces need: there the question is how many orders matter, not how fast a "
        "sum is.",
        "## Highest order that a tolerance needs (`orders_for`)",
        table(["λ", *(f"{tolerance:g}" for tolerance in TOLERANCES)], found["orders_for"]),
        "## Largest error over peak, by highest order",
        table(
            ["λ", *(str(order) for order in found["orders"])],
            {
                name: {str(k): f"{value:.0e}" for k, value in zip(found["orders"], values, strict=True)}
                for name, values in found["error_over_peak"].items()
            },
        ),
        "## Time of the sum [ns per angle], by highest order",
        table([str(order) for order in series], {str(series[1]): dict(list(series.items())[1:])}),
    ]
    return "\n\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    found = measured(parser.parse_args().repeats)
    publish("slider-crank", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
