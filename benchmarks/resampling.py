"""Angle resampling: error against speed of every kernel and of what others use, content at 5, 20 and 40 % of the rate.

Usage: python benchmarks/resampling.py [--repeats N] [--samples N]
Writes `reports/speed-error/resampling.{json,md,png}`. CPU time of one core; machines are shared and noisy: read the
ratios. finufft and rota-order are compared where they are installed (`pip install finufft rota-order`).
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import matplotlib.ticker as mticker
import numpy as np
import pyfftw
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.ndimage import map_coordinates

from crankorder.fft.resampling import Kernel, cheapest_kernel, kernel_of, values_at

RATE_HZ, SPEED_RPM, SAMPLES_PER_REV = 50_000.0, 1500.0, 2048
CONTENTS = (0.05, 0.2, 0.4)
N_CHANNELS = 3
PHASES_RAD = np.array([0.3, -1.1, 2.0])[:, None]
EDGE = 300
OURS = (8, 16, 24, 32, 48, 64)
TOLERANCES = tuple(10.0**-k for k in range(2, 10))
FRAME = 16 * SAMPLES_PER_REV
ASKED = {0.05: 1e-6, 0.4: 1e-7}
REFERENCE_INTERP = 248.0
"""np.interp [10⁶/s] on the quiet machine on which the marks were set: a mark is compared as a ratio to it."""
Rows = list[dict]


def tones(content: float, at: np.ndarray) -> np.ndarray:
    """Unit tones (channels, n) of different phase at ``content`` of the rate."""
    return np.asarray(np.cos(2.0 * np.pi * content * at + PHASES_RAD))


def positions(n_samples: int) -> np.ndarray:
    """Places of even crank angles, in samples: 1.5 % of uneven speed, 2048 per revolution."""
    rev = np.arange(EDGE, int((n_samples / RATE_HZ * SPEED_RPM / 60.0) * SAMPLES_PER_REV) - EDGE) / SAMPLES_PER_REV
    swing = sum(0.005 / (2.0 * np.pi * k) * np.sin(2.0 * np.pi * k * rev + k) for k in (0.5, 1.0, 2.0))
    return (rev + swing) * 60.0 / SPEED_RPM * RATE_HZ


def spectrum_interpolation(eps: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Interpolation by the whole record's spectrum, read at uneven places by finufft (type 2)."""
    import finufft

    def interpolated(signals: np.ndarray, at: np.ndarray) -> np.ndarray:
        n = signals.shape[1]
        spectrum = np.fft.fftshift(np.fft.fft(signals, axis=1), axes=1) / n
        return np.real(finufft.nufft1d2(2.0 * np.pi / n * at, spectrum, eps=eps, isign=1, nthreads=1))

    return interpolated


def others() -> dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]]:
    """What others interpolate (channels, samples) at positions with."""
    n_of = {"count": 0, "at": np.empty(0)}

    def every(signals: np.ndarray) -> np.ndarray:
        if n_of["count"] != signals.shape[1]:
            n_of.update(count=signals.shape[1], at=np.arange(float(signals.shape[1])))
        return np.asarray(n_of["at"])

    ways: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
        "np.interp": lambda s, at: np.stack([np.interp(at, every(s), row) for row in s]),
        "scipy CubicSpline": lambda s, at: CubicSpline(every(s), s, axis=1)(at),
        "scipy make_interp_spline k=5": lambda s, at: make_interp_spline(every(s), s, k=5, axis=1)(at),
        "ndimage map_coordinates k=3": lambda s, at: np.stack([map_coordinates(row, at[None], order=3) for row in s]),
        "ndimage map_coordinates k=5": lambda s, at: np.stack([map_coordinates(row, at[None], order=5) for row in s]),
    }
    try:
        for eps in (1e-6, 1e-12):
            ways[f"finufft type 2, {eps:g}"] = spectrum_interpolation(eps)
    except ImportError:
        print("finufft is not installed: left out")
    return ways


def best_s(works: list[Callable[[], object]], repeats: int) -> list[float]:
    """Least CPU time of each of ``works`` in ``repeats`` rounds, in turn: all meet the same neighbours."""
    best = np.full(len(works), np.inf)
    for work in works:
        work()
    for _ in range(repeats):
        for number, work in enumerate(works):
            start = time.thread_time()
            work()
            best[number] = min(best[number], time.thread_time() - start)
    return [float(seconds) for seconds in best]


def error_of(values: np.ndarray, expected: np.ndarray) -> dict[str, float]:
    difference = np.abs(values - expected)
    return {"largest": float(difference.max()), "rms": float(np.sqrt(2.0 * np.mean(difference**2)))}


def our_rows(content: float, n_samples: int, repeats: int) -> Rows:
    """Every kernel made for ``content``, in both precisions, with 1 and 3 channels."""
    at, rows, works = positions(n_samples), [], []
    expected, signals = tones(content, at), tones(content, np.arange(float(n_samples)))
    for dtype in ("float64", "float32"):
        typed = signals.astype(dtype)
        for taps in OURS:
            kernel = kernel_of(taps, pass_band=content, double=dtype == "float64")
            error = error_of(values_at(typed, at, kernel=kernel), expected)
            rows.append({"way": kernel.name, "dtype": dtype, "predicted": kernel.predicted_error} | error)
            for channels in (1, N_CHANNELS):
                works.append(lambda s=typed[:channels], k=kernel: values_at(s, at, kernel=k))
    seconds = best_s(works, repeats)
    for row, one, three in zip(rows, seconds[::2], seconds[1::2], strict=True):
        row |= {"one_channel_m_per_s": len(at) / one / 1e6, "m_per_s": N_CHANNELS * len(at) / three / 1e6}
    return rows


def other_rows(content: float, n_samples: int, repeats: int) -> Rows:
    """The others, and a copy of the same bytes to compare machines by."""
    at, ways = positions(n_samples), others()
    expected, signals = tones(content, at), tones(content, np.arange(float(n_samples)))
    seconds = best_s([lambda way=way: way(signals, at) for way in ways.values()], min(repeats, 2))
    rows = [
        {"way": name, "dtype": "float64", "m_per_s": N_CHANNELS * len(at) / cost / 1e6}
        | error_of(way(signals, at), expected)
        for (name, way), cost in zip(ways.items(), seconds, strict=True)
    ]
    try:
        from rota.angle import angular_resample
    except ImportError:
        print("rota-order is not installed: left out")
        return rows
    rpm = np.full(n_samples, SPEED_RPM)
    for upsample in (1, 4):
        work = lambda up=upsample: angular_resample(  # noqa: E731
            signals.T, RATE_HZ, rpm, samples_per_rev=SAMPLES_PER_REV, max_order=900.0, upsample=up
        )
        (cost,) = best_s([work], 1)
        found = work()
        inside = slice(4 * SAMPLES_PER_REV, -4 * SAMPLES_PER_REV)
        error = error_of(found.x.T[:, inside], tones(content, found.t[inside] * RATE_HZ))
        speed = found.x.size / cost / 1e6
        rows.append({"way": f"rota.angular_resample, up {upsample}", "dtype": "float64", "m_per_s": speed} | error)
    return rows


class OrderSpectra:
    """Order spectra of frames of 16 revolutions, by blocks that stay in the cache: resampling, window and FFT."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel = kernel
        real, complex_ = ("float64", "complex128") if kernel.double else ("float32", "complex64")
        self.window = (0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(FRAME) / FRAME)).astype(real)
        frames = pyfftw.empty_aligned((N_CHANNELS, FRAME), real)
        spectra = pyfftw.empty_aligned((N_CHANNELS, FRAME // 2 + 1), complex_)
        self.plan = pyfftw.FFTW(frames, spectra, axes=(1,), flags=("FFTW_ESTIMATE",))

    def __call__(self, signals: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Magnitude (frames, channels, bins) in peak amplitude."""
        n_frames = len(at) // FRAME
        found = np.empty((n_frames, N_CHANNELS, FRAME // 2 + 1), self.plan.output_array.dtype)
        for frame in range(n_frames):
            values = values_at(signals, at[frame * FRAME : (frame + 1) * FRAME], kernel=self.kernel)
            np.multiply(values, self.window, out=self.plan.input_array)
            self.plan.execute()
            found[frame] = self.plan.output_array
        return found


def spectrum_rows(n_samples: int, repeats: int) -> Rows:
    """Resampling and order spectrum together, content at 5 % of the rate, both precisions."""
    rev = np.arange(1, int(n_samples / RATE_HZ * SPEED_RPM / 60.0 / 16) * FRAME - FRAME // 8) / SAMPLES_PER_REV
    swing = sum(0.005 / (2.0 * np.pi * k) * np.sin(2.0 * np.pi * k * rev + k) for k in (0.5, 1.0, 2.0))
    at = (rev + 0.2 + swing) * 60.0 / SPEED_RPM * RATE_HZ
    order = 100.0
    # a tone locked to the shaft: at the sample times the angle is found by inverting the motion
    time_rev = np.arange(float(n_samples)) / RATE_HZ * SPEED_RPM / 60.0 - 0.2
    angle = time_rev.copy()
    for _ in range(40):
        angle = time_rev - sum(0.005 / (2.0 * np.pi * k) * np.sin(2.0 * np.pi * k * angle + k) for k in (0.5, 1.0, 2.0))
    signals = np.cos(2.0 * np.pi * order * angle + PHASES_RAD)
    rows, works = [], []
    for dtype in ("float64", "float32"):
        typed = signals.astype(dtype)
        kernel = cheapest_kernel(1e-6, content=0.0515, double=dtype == "float64")
        spectra = OrderSpectra(kernel)
        peak = np.abs(spectra(typed, at)[:, :, round(order * FRAME / SAMPLES_PER_REV)]) * (4.0 / FRAME)
        rows.append({"dtype": dtype, "kernel": kernel.name, "order_error_ppm": float(np.abs(peak - 1.0).max() * 1e6)})
        works.append(lambda s=spectra, t=typed: s(t, at))
    places = np.arange(float(n_samples))
    works.append(lambda: [np.interp(at, places, signal) for signal in signals])
    *costs, reference = best_s(works, 2 * repeats)
    n_frames = len(at) // FRAME
    for row, cost in zip(rows, costs, strict=True):
        row["m_per_s"] = N_CHANNELS * n_frames * FRAME / cost / 1e6
        row["ratio"] = row["m_per_s"] / (N_CHANNELS * len(at) / reference / 1e6)
    return rows


def chosen_rows() -> Rows:
    """What cheapest_kernel gives for tolerances and contents, and what it errs."""
    rows, samples = [], np.arange(2400.0)
    at = np.random.default_rng(2).uniform(700.0, 1700.0, 20_000)
    for content in (0.02, *CONTENTS):
        for tolerance in TOLERANCES:
            kernel = cheapest_kernel(tolerance, content=content)
            worst = max(
                error_of(values_at(tones(share * content, samples), at, kernel=kernel), tones(share * content, at))[
                    "largest"
                ]
                for share in (1.0, 0.97, 0.8, 0.4)
            )
            rows.append(
                {
                    "content": content,
                    "asked": tolerance,
                    "kernel": kernel.name,
                    "predicted": kernel.predicted_error,
                    "measured": worst,
                }
            )
    return rows


def measured(n_samples: int, repeats: int) -> dict:
    """Everything, with speeds also as ratio to np.interp in the same run."""
    by_content = {}
    for content in CONTENTS:
        rows = our_rows(content, n_samples, repeats) + other_rows(content, n_samples, repeats)
        reference = next(row["m_per_s"] for row in rows if row["way"] == "np.interp")
        by_content[f"{content:g}"] = [row | {"ratio": row["m_per_s"] / reference} for row in rows]
    block, target = np.ones(1 << 20), np.empty(1 << 20)
    (copy,) = best_s([lambda: np.copyto(target, block)], 20)
    return {
        "what": f"{N_CHANNELS} channels of {n_samples} samples, {SAMPLES_PER_REV} positions per revolution, one core",
        "copy_gb_per_s": 16.0 * len(block) / copy / 1e9,
        "by_content": by_content,
        "order_spectrum": spectrum_rows(n_samples, repeats),
        "chosen": chosen_rows(),
    }


OTHER_LOOKS = {
    "np.interp": ("k", "s"),
    "scipy CubicSpline": ("C2", "o"),
    "scipy make_interp_spline k=5": ("C2", "^"),
    "ndimage map_coordinates k=3": ("C4", "o"),
    "ndimage map_coordinates k=5": ("C4", "^"),
    "finufft type 2, 1e-06": ("C5", "v"),
    "finufft type 2, 1e-12": ("C5", "^"),
    "rota.angular_resample, up 1": ("C8", "P"),
    "rota.angular_resample, up 4": ("C8", "X"),
}
OUR_LOOKS = {
    ("kaiser", "float64"): ("C3", "-", "crankorder windowed sinc, taps as shown, float64"),
    ("kaiser", "float32"): ("C1", "-", "the same in float32"),
}


def drawn(found: dict) -> Figure:
    """Largest error against speed, one panel for each content."""
    figure = Figure(figsize=(16, 7), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, content in zip(figure.subplots(1, len(CONTENTS), sharex=True, sharey=True), CONTENTS, strict=True):
        _draw(axes, found["by_content"][f"{content:g}"])
        if content in ASKED:
            error = ASKED[content]
            axes.axhline(error, color="0.4", ls="--", lw=1)
            axes.text(0.25, 1.3 * error, f"asked: {error:.0e}", fontsize=9, color="0.3", va="bottom")
        axes.set(xscale="log", yscale="log", xlim=(0.2, 700), ylim=(3e-12, 3), xlabel="10⁶ values per second, one core")
        axes.set_title(f"content at {100 * content:g} % of the sample rate")
        axes.grid(alpha=0.3)
        axes.xaxis.set_major_formatter(mticker.FormatStrFormatter("%g"))
    first = figure.axes[0]
    first.set_ylabel("largest error / amplitude")
    figure.suptitle("Values between samples: down and right is better (3 channels, CPU time)")
    figure.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    return figure


def _draw(axes: Axes, rows: Rows) -> None:
    for (family, dtype), (colour, line, label) in OUR_LOOKS.items():
        ours = [row for row in rows if row["way"].startswith(family) and row["dtype"] == dtype]
        # a longer kernel that errs no less shows nothing
        ours = [
            row for number, row in enumerate(ours) if not number or row["largest"] < 0.5 * ours[number - 1]["largest"]
        ]
        speed, error = [row["m_per_s"] for row in ours], [row["largest"] for row in ours]
        axes.plot(
            speed, error, line or "none", marker="*", ms=12, color=colour, mec="k", mew=0.5, label=label, zorder=5
        )
        if dtype == "float64":
            for row in ours:
                taps = row["way"].rpartition("-")[2]
                place = (row["m_per_s"], row["largest"])
                axes.annotate(
                    taps, place, xytext=(-8, -3), textcoords="offset points", ha="right", fontsize=8, color=colour
                )
    for row in rows:
        if row["way"] in OTHER_LOOKS:
            colour, shape = OTHER_LOOKS[row["way"]]
            axes.plot(row["m_per_s"], row["largest"], shape, color=colour, ms=8, label=row["way"], zorder=4)


def page(found: dict) -> str:
    """The same numbers as a page of tables."""
    parts = [
        "# Angle resampling: error against speed",
        "Made by `python benchmarks/resampling.py`; do not edit.",
        "![error against speed](resampling.png)",
        f"{found['what']}. Speeds are 10⁶ values (channels × positions) per second of CPU time, and as a ratio to "
        f"np.interp in the same run; a copy of memory ran at {found['copy_gb_per_s']:.1f} GB/s. Errors are relative to "
        "the amplitude of the tone: predicted by the error model, largest, rms. kaiser-N are windowed sincs made "
        "for the content of the panel. A peer that is missing here was not installed.",
        f"Marks, on a quiet machine where np.interp makes {REFERENCE_INTERP:g}: 55 at 1e-7 for content at 40 % "
        f"({55 / REFERENCE_INTERP:.2f} × np.interp), and 100 with the spectrum at 1 ppm for content at 5 % "
        f"({100 / REFERENCE_INTERP:.2f} × np.interp). Below 1e-10 what is seen is the rounding of the positions, "
        "which float64 holds to 1e-16 of their size in samples.",
        "## Resampling and order spectrum together",
        "Frames of 16 revolutions, Hann window, real FFT (FFTW, planned by estimate); one order at 5 % of the sample "
        "rate, speed uneven by 1.5 %, kernel chosen for 1e-6.",
        table(
            ["numbers", "kernel", "10⁶ values/s", "× np.interp", "error of the order [ppm]"],
            [
                [r["dtype"], r["kernel"], f"{r['m_per_s']:.0f}", f"{r['ratio']:.2f}", f"{r['order_error_ppm']:.2g}"]
                for r in found["order_spectrum"]
            ],
        ),
    ]
    for content, rows in found["by_content"].items():
        parts += [f"## Content at {100 * float(content):g} % of the sample rate", table(HEADER, map(_cells, rows))]
    chosen = [
        [f"{100 * r['content']:g} %", f"{r['asked']:.0e}", r["kernel"], f"{r['predicted']:.1e}", f"{r['measured']:.1e}"]
        for r in found["chosen"]
    ]
    header = ["content", "asked", "kernel", "predicted", "measured"]
    parts += ["## The cheapest kernel for a tolerance (float64)", table(header, chosen)]
    return "\n\n".join(parts) + "\n"


HEADER = ["way", "numbers", "10⁶/s, 3 channels", "10⁶/s, 1 channel", "× np.interp", "predicted", "largest", "rms"]


def _cells(row: dict) -> list[str]:
    one = f"{row['one_channel_m_per_s']:.0f}" if "one_channel_m_per_s" in row else ""
    predicted = f"{row['predicted']:.1e}" if "predicted" in row else ""
    errors = [f"{row['largest']:.1e}", f"{row['rms']:.1e}"]
    return [row["way"], row["dtype"], f"{row['m_per_s']:.3g}", one, f"{row['ratio']:.2f}", predicted, *errors]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--samples", type=int, default=240_000)
    options = parser.parse_args()
    found = measured(options.samples, options.repeats)
    publish("resampling", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
