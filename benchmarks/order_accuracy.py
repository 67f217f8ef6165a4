"""Steady orders: error over the Cramér–Rao bound, and how often the truth lies in the stated 95 % intervals.

Usage: python benchmarks/order_accuracy.py [--draws N]
Writes `reports/speed-error/order-accuracy.{json,md,png}`. Everything is drawn anew from fixed seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from made.order_spectra import HIGHEST, REVS, SAMPLES_PER_REV, coloured, tracked

BATCH = 250
Line = tuple[float, float, float]
SNR_DB = (-35.0, -25.0, -20.0, -10.0, 10.0, 40.0)
ORDERS, PHASES = (5.0, 5.5, 6.0), (0.7, 2.0, -1.0)
BESIDE = (1.0, 0.3, 0.5)
OFF_BIN = 0.31
"""Records and frames by time hold no whole number of revolutions: the order lies this far off a bin of such frames."""
RATE_HZ = 640.0
ROTA_DRAWS = 100

CASES: dict[str, tuple[str, int, tuple[float, ...]]] = {
    "white noise": ("white", 36, ORDERS),
    "pink noise": ("pink", 36, ORDERS),
    "resonance beside (order 5.1, 2 %)": ("resonance", 36, ORDERS),
    "1 frame, white": ("white", 1, ORDERS),
    "2 frames, white": ("white", 2, ORDERS),
    "3 frames, white": ("white", 3, ORDERS),
    "5 frames, white": ("white", 5, ORDERS),
    "2 frames, resonance beside": ("resonance", 2, ORDERS),
    "3 frames, resonance beside": ("resonance", 3, ORDERS),
    "5 frames, resonance beside": ("resonance", 5, ORDERS),
    "5.5 beside 5.48, 150 revolutions": ("white", 18, (5.5, 5.48)),
}
NOISE_OF = {"white": 1.0, "pink": 0.4, "resonance": 0.5}


def made_lines(n_samples: int, given: list[Line], off: float = 0.0) -> np.ndarray:
    angle = (np.arange(n_samples) / SAMPLES_PER_REV) * (1.0 + off)
    return sum(a * np.cos(2 * np.pi * order * angle + phase) for order, a, phase in given)


def batches(colour: str, frames: int, draws: int, scale: float = 1.0) -> Iterator[np.ndarray]:
    for number in range(draws // BATCH):
        yield scale * coloured(np.random.default_rng([frames, number]), BATCH, revs=8 * (frames + 1), colour=colour)


def coverage(case: str, draws: int) -> dict[str, float]:
    """Share [%] of intervals that hold the truth; NaN for the phase of orders between bins, which have none."""
    colour, frames, orders = CASES[case]
    given = [(order, size, phase) for order, size, phase in zip(orders, (3.0, 1.5, 2.0), PHASES, strict=False)]
    hits = []
    for noise in batches(colour, frames, draws, NOISE_OF[colour]):
        line = tracked(noise + made_lines(noise.shape[1], given), orders).isel(order=0)
        inside = (line["amplitude_low"] <= 3.0) & (line["amplitude_high"] >= 3.0)
        off = (line["phase"] - np.degrees(PHASES[0]) + 180.0) % 360.0 - 180.0
        hits.append([inside, np.where(np.isfinite(off), np.abs(off) <= line["phase_ci95"], np.nan)])
    share = 100.0 * np.concatenate(hits, axis=1).mean(axis=1)
    return {"amplitude": float(share[0]), "phase": float(share[1])}


def by_short_time(signals: np.ndarray, n_frame: int) -> np.ndarray:
    """Spectra (draws, frames, bins), as peak amplitudes, of the whole frames of scipy's ShortTimeFFT."""
    from scipy.signal import ShortTimeFFT
    from scipy.signal.windows import hann

    transform = ShortTimeFFT(hann(n_frame, sym=False), n_frame // 2, 1.0, scale_to="magnitude", phase_shift=None)
    spectra = 2.0 * transform.stft(signals, p0=1, p1=signals.shape[1] // (n_frame // 2))
    return np.asarray(np.moveaxis(spectra, -1, 1))


def errors(snr_db: float, frames: int, draws: int) -> dict[str, float]:
    """Root mean square error of the amplitude of order 5.5 over the Cramér–Rao bound, by method.

    The plain FFT and the ShortTimeFFT are given the record by time at a speed at which it holds no whole number of
    revolutions, as measured records do; they read the magnitude of the nearest bin.
    """
    size = float(np.sqrt(2.0) * 10.0 ** (snr_db / 20.0))
    order, phase = 5.5, 2.0
    given = [(5.0, 3.3 * size, 0.7), (order, size, phase), (6.0, 1.7 * size, -1.0)]
    off = OFF_BIN / (order * REVS)
    found: dict[str, list[np.ndarray]] = {}
    for noise in batches("white", frames, draws):
        n = noise.shape[1]
        signals, drifting = noise + made_lines(n, given), noise + made_lines(n, given, off)
        nearest = round(order * (1.0 + off) * n / SAMPLES_PER_REV)
        plain = 2.0 / n * np.abs(np.fft.rfft(drifting)[:, nearest])
        n_frame = 16 * SAMPLES_PER_REV
        short = np.abs(by_short_time(drifting, n_frame)[..., round(order * 16)])
        for way, value in (
            ("crankorder", tracked(signals, (5.0, order, 6.0))["amplitude"].values[:, 1]),
            ("plain FFT of the thesis, nearest bin", plain),
            ("scipy ShortTimeFFT, mean magnitude", short.mean(axis=1)),
        ):
            found.setdefault(way, []).append(value - size)
        way = f"rota-order's order map, mean magnitude, {ROTA_DRAWS} draws"
        magnitude = by_rota(signals[:ROTA_DRAWS], order) if way not in found else None
        if magnitude is not None:
            found[way] = [magnitude - size]
    bound = np.sqrt(2.0 / (8 * (frames + 1) * SAMPLES_PER_REV))
    return {way: float(np.sqrt(np.mean(np.square(np.concatenate(e)))) / bound) for way, e in found.items()}


def by_rota(signals: np.ndarray, order: float) -> np.ndarray | None:
    """Mean over frames of the magnitude (draws,) in rota-order's order map; None where it is not installed."""
    try:
        from rota.maps import rpm_order_map
    except ImportError:
        return None
    asked = {"order_resolution": 1 / 16, "max_order": float(HIGHEST), "overlap": 0.5, "amplitude": "peak"}
    made = rpm_order_map(signals.T, RATE_HZ, RATE_HZ / SAMPLES_PER_REV * 60.0, **asked)
    values, axis = np.abs(made.values), np.asarray(made.axis)
    values = np.moveaxis(values, values.shape.index(len(axis)), 0)[np.argmin(np.abs(axis - order))]
    return np.asarray(np.nanmean(np.moveaxis(values, values.shape.index(len(signals)), 0), axis=1))


def measured(draws: int) -> dict[str, object]:
    by_snr = {f"{snr:g}": errors(snr, 36, draws) for snr in SNR_DB}
    by_length = {str(frames): errors(0.0, frames, draws) for frames in (1, 2, 3, 5, 8, 16, 36)}
    return {
        "what": f"{draws} draws each; orders 5, 5.5 and 6 together; frames of 16 revolutions, half overlapping",
        "draws": draws,
        "rms_over_bound_by_snr_db": by_snr,
        "rms_over_bound_by_frames": by_length,
        "rota_order": any("rota" in way for row in by_snr.values() for way in row),
        "coverage_percent": {case: coverage(case, draws) for case in CASES},
    }


COLOURS = ("C0", "C2", "C3", "C1", "C4")


def drawn(found: dict) -> Figure:
    """Error over the bound against signal-to-noise ratio and length; coverage by case."""
    figure = Figure(figsize=(17, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    by_snr, by_length, cover = figure.subplots(1, 3, width_ratios=(1, 1, 1.5))
    panels = (
        (by_snr, "rms_over_bound_by_snr_db", "power of order 5.5 over that of all noise [dB]", "296 revolutions"),
        (by_length, "rms_over_bound_by_frames", "frames of 16 revolutions, half overlapping", "0 dB"),
    )
    for axes, key, label, title in panels:
        rows = found[key]
        for number, way in enumerate(next(iter(rows.values()))):
            ours = way.startswith("crankorder")
            x, y = [float(k) for k in rows], [row[way] for row in rows.values()]
            axes.plot(x, y, "o-" if ours else "s--", color=COLOURS[number], label=way, lw=2 if ours else 1.2)
        axes.axhline(1.1, color="k", ls=":", lw=1)
        axes.text(0.98, 1.13, "1.1 × bound", transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=9)
        axes.set(xlabel=label, ylabel="rms error of the amplitude / Cramér–Rao bound", title=title, yscale="log")
        axes.set_ylim(0.7, None)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.grid(alpha=0.3)
    by_length.set_xscale("log")
    by_length.set_xticks([1, 2, 3, 5, 8, 16, 36], ["1", "2", "3", "5", "8", "16", "36"])
    by_length.minorticks_off()
    figure.legend(*by_snr.get_legend_handles_labels(), loc="outside lower left", ncols=3, frameon=False)
    _draw_coverage(cover, found["coverage_percent"])
    return figure


def _draw_coverage(axes, cases: dict) -> None:
    axes.axvspan(94.0, 96.0, color="0.9", label="95 ± 1 %")
    for kind, mark, face, off in (("amplitude", "o", "C0", -0.08), ("phase", "^", "none", 0.08)):
        rows = [row[kind] for row in cases.values()]
        axes.plot(rows, np.arange(len(rows)) + off, mark, color="C0", mfc=face, label=kind)
    axes.set_yticks(range(len(cases)), list(cases))
    axes.invert_yaxis()
    axes.set(xlabel="95 % intervals that hold the truth [%]", title="Coverage")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, frameon=False, fontsize=9)


def page(found: dict) -> str:
    ways = list(next(iter(found["rms_over_bound_by_snr_db"].values())))
    numbers = {
        key: {name: {way: f"{value:.3f}" for way, value in row.items()} for name, row in found[key].items()}
        for key in ("rms_over_bound_by_snr_db", "rms_over_bound_by_frames")
    }
    peer = "also gets it by crank angle" if found["rota_order"] else "was not installed in this run"
    cells = {
        case: {kind: "–" if np.isnan(share) else f"{share:.1f}" for kind, share in row.items()}
        for case, row in found["coverage_percent"].items()
    }
    sampling = 100.0 * np.sqrt(0.95 * 0.05 / found["draws"])
    lines = [
        "# Steady orders: error against the Cramér–Rao bound, and coverage of the 95 % intervals",
        "Made by `python benchmarks/order_accuracy.py`; do not edit.",
        "![error and coverage](order-accuracy.png)",
        f"{found['what']}. The plain FFT (by time, whole record, nearest bin) and scipy's `ShortTimeFFT` get the "
        "record as a time axis gives it, with no whole number of revolutions in it; crankorder gets it by crank angle. "
        f"rota-order {peer}.",
        "## rms error of the amplitude of order 5.5 over the bound, by signal-to-noise ratio [dB] (296 revolutions)",
        "The bound is that of an unbiased estimate with the frequency known, σ √(2/N) (Rife and Boorstyn 1974). Near "
        "the noise every magnitude is biased.",
        table(["dB", *ways], numbers["rms_over_bound_by_snr_db"]),
        "## The same at 0 dB, by number of frames",
        table(["frames", *ways], numbers["rms_over_bound_by_frames"]),
        "## Intervals that hold the truth [%]",
        f"A share of {found['draws']} draws is known to {sampling:.1f} (one standard deviation). With one or two "
        "frames only the bins beside can be asked, and a resonance narrower than a bin deceives; from three on the "
        "frames' own scatter at the line tells. An order between bins has no phase.",
        table(["case", *next(iter(cells.values()))], cells),
    ]
    return "\n\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=2500)
    options = parser.parse_args()
    found = measured(options.draws)
    publish("order-accuracy", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
