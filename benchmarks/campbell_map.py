"""Campbell map and decimation: speed against error, beside what others use.

Usage: python benchmarks/campbell_map.py [--repeats N]
Writes `reports/speed-error/campbell-map.{json,md,png}`. One core, CPU time; machines are shared and noisy: read the
ratios. rota-order (GPL) and soxr take part where they are installed.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable

import numpy as np
import scipy.signal as ss
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from published import publish, table

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.fft.decimation import decimate
from crankorder.settings import CampbellSettings, load_settings

RATE_HZ, SAMPLES, CHANNELS, FRAME = 50_000.0, 750_000, 3, 2048
SPEEDS_RPM = np.arange(300.0, 2050.0, 50.0)
"""Of the thesis. With bins of 5/9 Hz order 1 lies half-way between two bins at 17 of the 35."""
FINE_HZ, FINE_RATE_HZ = 5.0 / 9.0, 5000.0
FACTOR, BAND_HZ = 16, 1250.0
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-9)
SCIPY_WINDOWS = {"hann": "hann", "flat-top": "flattop", "blackman-harris": "blackmanharris", "rectangular": "boxcar"}
Amplitudes = Callable[[np.ndarray, float, float, str, float], np.ndarray]
"""Peak amplitudes (channels, bins) from signals, rate, bin spacing, window and speed."""


def settings_for(rate_hz: float, bin_hz: float, window: str) -> CampbellSettings:
    changed = {"resolution_hz": bin_hz, "max_frequency_hz": 0.5 * rate_hz, "window": window}
    return load_settings().campbell.model_copy(update=changed)


def recording(signals: np.ndarray, rate_hz: float, speed_rpm: float) -> tuple[xr.Dataset, xr.Dataset]:
    """BandRecording and ShaftAngle at constant speed."""
    names = {key: ("channel", [key] * len(signals), {"units": "1"}) for key in ("channel", "unit", "quantity")}
    attrs = {"recording": "made", "domain": "time", "rate_hz": rate_hz}
    band = xr.Dataset({"signal": (("channel", "time"), signals)}, coords=names, attrs=attrs)
    time_s = np.linspace(0.0, signals.shape[1] / rate_hz, 9)
    knots = {"time": time_s, "crank_angle": time_s * speed_rpm / 60.0, "speed": np.full(9, speed_rpm)}
    return band, xr.Dataset({name: ("knot", values) for name, values in knots.items()})


def ours(signals: np.ndarray, rate_hz: float, bin_hz: float, window: str, speed_rpm: float) -> np.ndarray:
    band, shaft = recording(signals, rate_hz, speed_rpm)
    frames = frequency_frames(band, shaft, settings=settings_for(rate_hz, bin_hz, window))
    return campbell_map([frames], speed_bin_rpm=25.0)["amplitude"].values[:, 0]


def short_time_fft(signals: np.ndarray, rate_hz: float, bin_hz: float, window: str, speed_rpm: float) -> np.ndarray:
    values = ss.get_window(SCIPY_WINDOWS[window], round(rate_hz / bin_hz)).astype(signals.dtype)
    transform = ss.ShortTimeFFT(values, len(values) // 2, rate_hz, scale_to="magnitude")
    inside = slice(2, -2)  # frames that reach beyond the record are padded
    return 2.0 * np.sqrt(np.mean(np.abs(transform.stft(signals)[..., inside]) ** 2, axis=-1))


def welch(signals: np.ndarray, rate_hz: float, bin_hz: float, window: str, speed_rpm: float) -> np.ndarray:
    n, name = round(rate_hz / bin_hz), SCIPY_WINDOWS[window]
    return np.sqrt(2.0 * ss.welch(signals, rate_hz, window=name, nperseg=n, scaling="spectrum", detrend=False)[1])


def rota(signals: np.ndarray, rate_hz: float, bin_hz: float, window: str, speed_rpm: float) -> np.ndarray:
    maps = importlib.import_module("rota.maps")
    name = SCIPY_WINDOWS[window]
    made = [
        maps.rpm_frequency_map(x, rate_hz, speed_rpm, resolution=bin_hz, overlap=0.5, window=name, amplitude="peak")
        for x in signals
    ]
    values = np.stack([np.asarray(item.values) for item in made])
    return np.sqrt(np.mean(np.abs(values) ** 2, axis=1 if values.shape[-1] == round(rate_hz / bin_hz) // 2 + 1 else -1))


def present(module: str) -> bool:
    try:
        importlib.import_module(module)
    except ImportError:
        return False
    return True


def methods() -> dict[str, tuple[Amplitudes, str, type]]:
    """By name: how, with which window, in which precision."""
    both = {"float32": np.float32, "float64": np.float64}
    found: dict[str, tuple[Amplitudes, str, type]] = {
        f"crankorder, {window}, {name}": (ours, window, kind)
        for window in ("hann", "flat-top", "blackman-harris", "kaiser")
        for name, kind in both.items()
    }
    found |= {f"ShortTimeFFT, hann, {name}": (short_time_fft, "hann", kind) for name, kind in both.items()}
    found["ShortTimeFFT, flattop, float64"] = (short_time_fft, "flat-top", np.float64)
    found["welch, hann, float64"] = (welch, "hann", np.float64)
    found["FFT of the thesis, rectangular, float64"] = (short_time_fft, "rectangular", np.float64)
    if present("rota.maps"):
        found["rota-order, hann, float64"] = (rota, "hann", np.float64)
        found["rota-order, flattop, float64"] = (rota, "flat-top", np.float64)
    return found


def best_s(works: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Least CPU time of each of ``works`` in so many rounds, in turn: all meet the same neighbours."""
    best = dict.fromkeys(works, np.inf)
    for _ in range(repeats + 1):
        for name, work in works.items():
            start = time.thread_time()
            work()
            best[name] = min(best[name], time.thread_time() - start)
    return best


def order_1_db(how: Amplitudes, window: str, kind: type) -> list[float]:
    """What order 1 of amplitude 1 reads at each speed."""
    at = np.arange(round(12.0 * FINE_RATE_HZ)) / FINE_RATE_HZ
    read = []
    for rpm in SPEEDS_RPM:
        signal = np.cos(2 * np.pi * rpm / 60.0 * at + 0.7)[None].astype(kind)
        read.append(20 * np.log10(float(how(signal, FINE_RATE_HZ, FINE_HZ, window, rpm).max())))
    return read


def floor_db(how: Amplitudes, window: str, kind: type) -> np.ndarray:
    """Spectrum beside a tone of amplitude 1 between two bins, with one 120 dB weaker 60 bins above, in dB."""
    at = np.arange(round(12.0 * FINE_RATE_HZ)) / FINE_RATE_HZ
    strong, weak = 1000.37 * FINE_HZ, 1060.21 * FINE_HZ
    signal = (np.cos(2 * np.pi * strong * at) + 1e-6 * np.cos(2 * np.pi * weak * at))[None].astype(kind)
    return 20 * np.log10(np.maximum(how(signal, FINE_RATE_HZ, FINE_HZ, window, 1000.0)[0, 960:1101], 1e-12))


def measured_maps(repeats: int) -> tuple[dict[str, dict], dict[str, list[float]], dict[str, list[float]]]:
    noise = np.random.default_rng(1).standard_normal((CHANNELS, SAMPLES))
    signals = {kind: noise.astype(kind) for kind in (np.float32, np.float64)}
    bin_hz = RATE_HZ / FRAME
    works = {
        name: (lambda how=how, window=window, kind=kind: how(signals[kind], RATE_HZ, bin_hz, window, 1000.0))
        for name, (how, window, kind) in methods().items()
    }
    seconds = best_s(works, repeats)
    order_1 = {name: order_1_db(*method) for name, method in methods().items()}
    floors = {name: floor_db(*method) for name, method in methods().items()}
    slow = seconds["ShortTimeFFT, hann, float64"]
    rows = {
        name: {
            "M channel-samples/s": round(CHANNELS * SAMPLES / seconds[name] / 1e6, 1),
            "times ShortTimeFFT": round(slow / seconds[name], 2),
            "worst reading of order 1 [dB]": float(f"{max(order_1[name], key=abs):.2g}"),
            "stripes: highest - lowest [dB]": float(f"{np.ptp(order_1[name]):.2g}"),
            "highest 80…100 bins off a tone [dB]": round(float(floors[name][120:].max()), 1),
            "tone at -120 dB reads [dB]": round(float(floors[name][98:103].max()), 1),
        }
        for name in works
    }
    return rows, order_1, {name: values.round(2).tolist() for name, values in floors.items()}


def decimators() -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Ways to reduce the rate by FACTOR; the errors are measured up to BAND_HZ and where that folds from."""
    asked = {"rate_hz": RATE_HZ, "band_hz": BAND_HZ, "factor": FACTOR}
    found: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        f"crankorder, {tolerance:.0e}": lambda x, tolerance=tolerance: decimate(x, **asked, tolerance=tolerance)[0]
        for tolerance in TOLERANCES
    }
    taps = ss.firwin(607, 0.5 / FACTOR, window=("kaiser", 11.8), fs=1.0)
    found |= {
        "scipy decimate (IIR)": lambda x: ss.decimate(x, FACTOR, axis=-1),
        "scipy decimate (FIR)": lambda x: ss.decimate(x, FACTOR, ftype="fir", axis=-1),
        "scipy resample_poly": lambda x: ss.resample_poly(x, 1, FACTOR, axis=-1),
        "scipy upfirdn, 607 taps": lambda x: ss.upfirdn(taps.astype(x.dtype), x, down=FACTOR),
    }
    if present("soxr"):
        soxr = importlib.import_module("soxr")
        for quality in ("MQ", "HQ", "VHQ"):
            found[f"soxr {quality}"] = lambda x, quality=quality: (
                soxr.resample(np.ascontiguousarray(x.T), RATE_HZ, RATE_HZ / FACTOR, quality).T
            )
    return found


def worst_error(way: Callable[[np.ndarray], np.ndarray], kind: type) -> float:
    """Largest error of tones in the band, or largest tone left of those that fold onto it, amplitudes 1."""
    at = np.arange(100_000) / RATE_HZ
    band = np.linspace(0.05, 1.0, 12) * BAND_HZ
    images = [k * RATE_HZ / FACTOR + sign * b for k in range(1, FACTOR // 2) for sign in (-1, 1) for b in band[-3:]]
    frequency = np.concatenate([band, images])
    made = way(np.cos(2 * np.pi * frequency[:, None] * at + 0.4).astype(kind))
    made = np.asarray(made, dtype=np.float64)[:, 1000:-1000]
    low_rate = RATE_HZ / FACTOR
    read = np.empty(len(frequency))
    for number, (row, tone_hz) in enumerate(zip(made, frequency, strict=True)):
        phase = 2 * np.pi * tone_hz / low_rate * np.arange(made.shape[1])
        waves = np.stack([np.cos(phase), np.sin(phase), np.ones_like(phase)], axis=1)  # crankorder takes the mean away
        read[number] = np.hypot(*np.linalg.lstsq(waves, row)[0][:2])
    return float(max(np.abs(read[: len(band)] - 1.0).max(), read[len(band) :].max()))


def measured_decimation(repeats: int) -> dict[str, dict[str, float]]:
    noise = np.random.default_rng(2).standard_normal((CHANNELS, SAMPLES))
    signals = {"float32": noise.astype(np.float32), "float64": noise}
    works = {
        f"{name}, {kind}": (lambda way=way, x=x: way(x))
        for name, way in decimators().items()
        for kind, x in signals.items()
    }
    seconds = best_s(works, repeats)
    slow = seconds["scipy resample_poly, float64"]
    return {
        f"{name}, {kind}": {
            "M samples/s": round(CHANNELS * SAMPLES / seconds[f"{name}, {kind}"] / 1e6, 1),
            "times resample_poly": round(slow / seconds[f"{name}, {kind}"], 1),
            "worst error to 1250 Hz": float(f"{worst_error(way, signals[kind].dtype.type):.2g}"),
        }
        for name, way in decimators().items()
        for kind in signals
    }


def drawn(found: dict) -> Figure:
    """Stripes, speed against error of the map, floor, and speed against error of decimation."""
    figure = Figure(figsize=(16, 11), layout="constrained")
    FigureCanvasAgg(figure)
    (stripes, against), (floor, decimation) = figure.subplots(2, 2)
    shown = {
        "FFT of the thesis, rectangular, float64": ("FFT of the thesis: rectangular window", "0.55"),
        "ShortTimeFFT, hann, float64": ("scipy ShortTimeFFT, Hann", "C0"),
        "crankorder, hann, float32": ("crankorder, Hann, float32", "C1"),
        "crankorder, flat-top, float32": ("crankorder, flat-top, float32", "C3"),
    }
    bins = np.arange(-40, 101)
    for name, (label, colour) in shown.items():
        thick = 2.0 if name.startswith("crank") else 1.2
        stripes.plot(SPEEDS_RPM, found["order_1_db"][name], "o-", ms=4, lw=thick, color=colour, label=label)
        floor.plot(bins, found["floor_db"][name], lw=thick, color=colour, label=label)
    double = "crankorder, flat-top, float64"
    floor.plot(bins, found["floor_db"][double], lw=1.2, color="k", ls="--", label=double)
    stripes.set(xlabel="speed [min⁻¹]", ylabel="order 1 of amplitude 1 reads [dB]", ylim=(-4.5, 1.2))
    stripes.set_title("Order 1 at the 35 speeds: stripes where it lies between two bins")
    stripes.legend(loc="upper right", ncols=2, frameon=False)
    floor.set(xlabel="bins from a tone of 0 dB", ylabel="amplitude [dB]", ylim=(-185, 8), xlim=(-40, 100))
    floor.set_title("Leakage of a tone, and a second one 120 dB weaker, 60 bins above")
    floor.legend(loc="upper right", frameon=False, fontsize=9)
    _draw_maps(against, found["maps"])
    _draw_decimation(decimation, found["decimation"])
    for axes in (stripes, against, floor, decimation):
        axes.grid(alpha=0.3)
    return figure


def _draw_maps(axes: Axes, rows: dict[str, dict]) -> None:
    colours = {"crankorder": "C3", "ShortTimeFFT": "C0", "welch": "C2", "rota-order": "C4", "FFT of the thesis": "0.55"}
    marks = {"hann": "o", "flat-top": "s", "flattop": "s", "blackman-harris": "^", "kaiser": "D", "rectangular": "X"}
    for name, row in rows.items():
        who, window, kind = name.split(", ")
        x, y = row["M channel-samples/s"], abs(row["worst reading of order 1 [dB]"])
        look = {"color": colours[who], "mfc": colours[who] if kind == "float32" else "white"}
        axes.plot(x, y, marks[window], ms=12 if who == "crankorder" else 9, **look)
    present_names = [name.split(", ")[0] for name in rows]
    who_keys = [Line2D([], [], ls="", marker="o", color=c, label=n) for n, c in colours.items() if n in present_names]
    window_keys = [
        Line2D([], [], ls="", marker=m, color="k", mfc="w", label=n) for n, m in marks.items() if n != "flattop"
    ]
    axes.add_artist(axes.legend(handles=who_keys, loc="lower left", frameon=False))
    axes.legend(handles=window_keys, loc="lower left", bbox_to_anchor=(0.22, 0.0), frameon=False)
    axes.set(
        xscale="log", yscale="log", xlabel="million channel-samples/s, one core", ylabel="worst error of order 1 [dB]"
    )
    axes.set(xlim=(8, 300), ylim=(1e-4, 10))
    _plain_ticks(axes, [10, 20, 50, 100, 200])
    axes.set_title("Campbell map, 2048 points, half overlap: down and right is better\nfilled: float32, open: float64")


def _plain_ticks(axes: Axes, ticks: list[float]) -> None:
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)


def _draw_decimation(axes: Axes, rows: dict[str, dict]) -> None:
    for kind, face in (("float32", None), ("float64", "white")):
        mine = [row for name, row in rows.items() if name.startswith("crank") and name.endswith(kind)]
        x, y = ([row[key] for row in mine] for key in ("M samples/s", "worst error to 1250 Hz"))
        axes.plot(x, y, "*-", color="C3", mfc=face or "C3", ms=15, lw=1, label=f"crankorder, {kind}")
    for number, (name, row) in enumerate((n, r) for n, r in rows.items() if n.endswith("float64") and "crank" not in n):
        who = name.removesuffix(", float64")
        x, y = row["M samples/s"], row["worst error to 1250 Hz"]
        fast = rows[f"{who}, float32"]
        axes.plot([x, fast["M samples/s"]], [y, fast["worst error to 1250 Hz"]], "-", color="0.6", lw=1)
        axes.plot(x, y, "o", color=f"C{number + 4}", mfc="white", ms=8)
        axes.plot(fast["M samples/s"], fast["worst error to 1250 Hz"], "o", color=f"C{number + 4}", ms=8, label=who)
    axes.set(
        xscale="log", yscale="log", xlabel="million input samples/s, one core", ylabel="worst error, band and aliases"
    )
    axes.legend(loc="lower left", frameon=False, fontsize=9)
    _plain_ticks(axes, [50, 100, 200, 500, 1000])
    axes.set_title(
        "Decimation 50 kHz / 16 for a band of 1250 Hz: down and right is better\nfilled: float32, open: float64"
    )


def page(found: dict) -> str:
    absent = [name for name, module in (("rota-order", "rota.maps"), ("soxr", "soxr")) if not present(module)]
    return (
        "\n\n".join(
            [
                "# Campbell map and decimation: speed and error",
                "Made by `python benchmarks/campbell_map.py`; do not edit.",
                "![speed against error](campbell-map.png)",
                f"{found['what']}. Error of order 1: bins of 5/9 Hz, speeds of the thesis (300, 350 … 2000 rpm), "
                "where it lies half-way between two bins at 17 of 35. crankorder's time is that of the whole way from "
                "signals to map.",
                f"Not installed for this run: {', '.join(absent) or 'nothing'}.",
                table(["map", *next(iter(found["maps"].values()))], found["maps"]),
                "## Decimation by 16",
                "Number after crankorder: the tolerance asked for. Worst error: of tones up to 1250 Hz, or what is "
                "left "
                "of tones that fold onto that band. float32 cannot hold errors below 6e-8 of a sample.",
                table(["way", *next(iter(found["decimation"].values()))], found["decimation"]),
            ]
        )
        + "\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    maps, order_1, floors = measured_maps(options.repeats)
    found = {
        "what": f"{CHANNELS} channels x {SAMPLES} samples at {RATE_HZ / 1e3:g} kHz, frames of {FRAME}, half overlap",
        "maps": maps,
        "speeds_rpm": SPEEDS_RPM.tolist(),
        "order_1_db": order_1,
        "floor_db": floors,
        "decimation": measured_decimation(options.repeats),
    }
    publish("campbell-map", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
