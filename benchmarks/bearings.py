"""Bearing damage against noise: how often it is found, and how often sound bearings raise an alarm, before and after.

Usage: python benchmarks/bearings.py [--damaged N] [--sound N] [--seed SEED] [--jobs N]
Every record is a bearing rig drawn from its seed (`tests/machines/bearing_rig.py`): strikes that wander, a load zone, a
resonance, shaft orders, mains, at times a mesh, swelling noise and single shocks; the damage strikes with peaks of 0.3
to 2 times the noise. "Single line" is the plain test that was here first, kept in this file: the largest first harmonic
in the squared envelope of the whole band. Writes `reports/speed-error/bearings.{json,md,png}`.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from published import publish, table
from scipy.signal import hilbert

from crankorder.identify.envelope_lines import Place, bearing_combs, bearing_places, line_chances, spectra_of
from crankorder.orders.envelope import envelope_map, recording_envelope
from crankorder.orders.envelope_combs import free_of_others
from crankorder.settings import load_settings

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from machines.bearing_rig import FAULTS, BearingRig, draw_rig, recorded

SETTINGS = load_settings()
SIZES = (0.3, 2.0)
"""Smallest and largest peak of the damage's strikes, as multiples of the noise's root mean square."""
EDGES = (0.3, 0.45, 0.7, 1.0, 1.4, 2.0)
RATES = (0.005, 0.01, 0.05, 0.1)
"""False-alarm rates at which both tests are compared."""
WHOLE = 1024
"""Samples of which the single-line test takes whole multiples, for quick transforms."""
SINGLE, COMBS = "single line, whole band", "crankorder"
COLOURS = {SINGLE: "#d1642c", COMBS: "#356e9e"}
NAMES = {"outer": "outer race", "inner": "inner race", "ball": "rolling element", "cage": "cage"}


class Judged(NamedTuple):
    """What both tests say of one record: their scores, processor time in s, and whether crankorder raises an alarm."""

    fault: str
    size: float
    score: dict[str, float]
    spent: dict[str, float]
    alarm: bool


def judged(job: tuple[int, str]) -> Judged:
    """Both tests on the record of a seed with a fault ("none": sound)."""
    seed, fault = job
    size = float(np.exp(np.random.default_rng([seed, 77]).uniform(*np.log(SIZES))))
    rig = draw_rig(seed, fault, size)
    record = recorded(rig)
    score, spent = {}, {}
    for name, test in ((SINGLE, single_line), (COMBS, combs)):
        start = time.thread_time()
        score[name] = test(rig, *record)
        spent[name] = time.thread_time() - start
    level = -math.log10(SETTINGS.identify.bearing_false_alarm_probability)
    return Judged(fault, size if fault != "none" else 0.0, score, spent, score[COMBS] >= level)


def _places(rig: BearingRig) -> list[Place]:
    return bearing_places((rig.bearing,), slip_percent=SETTINGS.identify.bearing_slip_percent)


def single_line(rig: BearingRig, recording: xr.Dataset, shaft: xr.Dataset) -> float:
    """Highest line over the median about it, as a logarithm, where a bearing line may be: whole band, one spectrum."""
    signal = recording["signal"].values[0].astype(np.float64)
    signal = signal[: len(signal) // WHOLE * WHOLE]
    turns_hz = float(shaft["speed"].values.mean()) / 60.0
    spectrum = np.fft.rfft(signal)
    hertz = np.fft.rfftfreq(len(signal), 1.0 / rig.rate_hz)
    above = np.where(hertz > SETTINGS.orders.max_order * turns_hz, spectrum, 0.0)
    squared = np.abs(hilbert(np.fft.irfft(above, len(signal)))) ** 2
    power = np.abs(np.fft.rfft((squared - squared.mean()) * np.hanning(len(squared)))) ** 2
    order = hertz / turns_hz
    revs = len(signal) / rig.rate_hz * turns_hz
    cell = 1.0 / min(revs, SETTINGS.orders.envelope_revs_per_frame)
    free = free_of_others(order, revs_per_cycle=1, speed_hz=turns_hz, cell=cell)
    best = 0.0
    for place in _places(rig):
        inside = (order > place.low) & (order < place.high) & free
        about = (order > place.low - 0.5) & (order < place.high + 0.5)
        if inside.any():
            best = max(best, float(power[inside].max() / np.median(power[about])))
    return math.log10(max(best, 1e-3))


def combs(rig: BearingRig, recording: xr.Dataset, shaft: xr.Dataset) -> float:
    """Minus the decimal logarithm of the chance that noise makes any line in the record, as crankorder has it."""
    named = bearing_combs((rig.bearing,), slip_percent=SETTINGS.identify.bearing_slip_percent)
    made = envelope_map(
        [recording_envelope(recording, shaft, settings=SETTINGS.orders, combs=named)],
        speed_bin_rpm=SETTINGS.orders.speed_bin_rpm,
    )
    if not made.sizes["order"]:
        return -math.inf
    spectra = spectra_of(made)
    step, end = spectra.order[1], spectra.order[-1]
    places = [place for place in _places(rig) if place.low > step and place.high < end]
    spans = [slice(math.ceil(one.low / step), math.floor(one.high / step) + 1) for one in places]
    bins = sum(int((place.high - place.low) / step) + 1 for place in places)
    chances = [line_chances(spectra, place, span, bins) for place, span in zip(places, spans, strict=True)]
    return -math.log10(max(min(min(one.min(), mean.min()) for one, mean in chances if one.size), 1e-300))


def threshold(scores: NDArray[np.float64], rate: float) -> float:
    """Score above which the share ``rate`` of the ``scores`` of sound records lies."""
    ordered = np.sort(scores)[::-1]
    return float(ordered[min(int(rate * len(ordered)), len(ordered) - 1)])


def limit(sizes: NDArray[np.float64], found: NDArray[np.bool_]) -> float:
    """Peak at which as many are found above as are missed below, sizes being drawn evenly by their logarithm."""
    return float(SIZES[1] * (SIZES[0] / SIZES[1]) ** found.mean()) if len(sizes) else math.nan


def compared(records: list[Judged]) -> dict[str, dict[str, dict[str, float]]]:
    """By false-alarm rate and test: share found and detection limit of all damage and of each kind."""
    sound = [one for one in records if one.fault == "none"]
    made: dict[str, dict[str, dict[str, float]]] = {}
    for rate in RATES:
        rows = made.setdefault(f"{100.0 * rate:g} %", {})
        for name in (SINGLE, COMBS):
            level = threshold(np.array([one.score[name] for one in sound]), rate)
            row = rows.setdefault(name, {})
            for fault in (*FAULTS, "all"):
                of = [one for one in records if one.fault == fault or (fault == "all" and one.fault != "none")]
                hit = np.array([one.score[name] > level for one in of])
                row[f"{fault} found"] = float(hit.mean())
                row[f"{fault} limit"] = limit(np.array([one.size for one in of]), hit)
    return made


def _figure(records: list[Judged]) -> Figure:
    figure = Figure(figsize=(11.0, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2).ravel()
    damaged = [one for one in records if one.fault != "none"]
    _receiver(panels[0], records, damaged)
    centres = [math.sqrt(low * high) for low, high in pairwise(EDGES)]
    for axis, faults in zip(panels[1:], (("outer",), ("inner",), ("ball", "cage")), strict=True):
        for name, colour in COLOURS.items():
            level = threshold(np.array([one.score[name] for one in records if one.fault == "none"]), 0.01)
            for fault, style in zip(faults, ("-o", "--s"), strict=False):
                shares = [
                    100.0 * np.mean([one.score[name] > level for one in damaged if one.fault == fault and _in(one, k)])
                    for k in range(len(centres))
                ]
                label = f"{NAMES[fault]}, {name}" if len(faults) > 1 else name
                axis.plot(centres, shares, style, color=colour, ms=4, lw=1.6, label=label)
        axis.set_xscale("log")
        axis.set_xticks(EDGES, [f"{edge:g}" for edge in EDGES])
        axis.minorticks_off()
        axis.set_ylim(-3.0, 103.0)
        axis.set_xlabel("largest peak of the strikes, times the noise's RMS", fontsize=9)
        axis.set_ylabel("found, %", fontsize=9)
        title = " and ".join(NAMES[fault] for fault in faults)
        axis.set_title(f"{title.capitalize()}: found at 1 % false alarms", fontsize=10, loc="left")
        axis.legend(fontsize=8, frameon=False, loc="upper left")
        axis.grid(alpha=0.25, lw=0.5)
    figure.suptitle(
        f"Bearing damage in noise: {len(damaged)} damaged and {len(records) - len(damaged)} sound drawn records",
        fontsize=12,
    )
    return figure


def _receiver(axis: Axes, records: list[Judged], damaged: list[Judged]) -> None:
    """Share found against rate of false alarms, of both tests, with the alarm as shipped."""
    sound = [one for one in records if one.fault == "none"]
    for name, colour in COLOURS.items():
        levels = np.sort([one.score[name] for one in sound])[::-1]
        hits = np.array([one.score[name] for one in damaged])
        rates = 100.0 * (np.arange(len(levels)) + 1) / len(levels)
        axis.step(rates, [100.0 * (hits >= level).mean() for level in levels], where="post", color=colour, label=name)
    alarms, found = (100.0 * np.mean([one.alarm for one in of]) for of in (sound, damaged))
    least = 100.0 / len(sound)
    axis.plot([max(alarms, least)], [found], "o", color=COLOURS[COMBS], ms=8, mfc="white", label="its alarm as shipped")
    axis.set_xscale("log")
    axis.set_xlim(0.8 * least, 100.0)
    axis.set_xticks([0.5, 1, 2, 5, 10, 20, 50, 100], ["0.5", "1", "2", "5", "10", "20", "50", "100"])
    axis.minorticks_off()
    axis.set_ylim(0.0, 103.0)
    axis.set_xlabel("sound records that raise an alarm, %", fontsize=9)
    axis.set_ylabel("damaged records found, %", fontsize=9)
    axis.set_title("All damage: receiver operating curve", fontsize=10, loc="left")
    axis.legend(fontsize=8, frameon=False, loc="upper left")
    axis.grid(alpha=0.25, lw=0.5)


def _in(one: Judged, k: int) -> bool:
    return EDGES[k] <= one.size < EDGES[k + 1]


def main() -> None:
    """Judge the records and publish."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--damaged", type=int, default=320)
    parser.add_argument("--sound", type=int, default=400)
    parser.add_argument("--seed", type=int, default=410_000)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    jobs = [(asked.seed + k, "none") for k in range(asked.sound)]
    jobs += [(asked.seed + asked.sound + k, FAULTS[k % len(FAULTS)]) for k in range(asked.damaged)]
    with multiprocessing.Pool(asked.jobs) as pool:
        records = list(pool.imap(judged, jobs, chunksize=4))
    alarms = sum(one.alarm for one in records if one.fault == "none")
    result = {
        "seed": asked.seed,
        "sound": asked.sound,
        "damaged": asked.damaged,
        "false_alarms": alarms,
        "compared": compared(records),
        "as_shipped": _as_shipped(records),
        "median_ms": {name: 1e3 * float(np.median([one.spent[name] for one in records])) for name in COLOURS},
    }
    publish("bearings", result, _page(result) + "\n", _figure(records))


def _as_shipped(records: list[Judged]) -> dict[str, dict[str, float]]:
    """Share in percent of each kind of damage that raises an alarm at the stated level, by peak of the strikes."""
    made: dict[str, dict[str, float]] = {}
    for fault in FAULTS:
        for k, (low, high) in enumerate(pairwise(EDGES)):
            of = [one.alarm for one in records if one.fault == fault and _in(one, k)]
            made.setdefault(NAMES[fault], {})[f"{low:g} to {high:g}"] = (
                round(100.0 * float(np.mean(of)), 1) if of else math.nan
            )
    return made


def _page(result: dict) -> str:
    rows = []
    for rate, tests in result["compared"].items():
        for name, row in tests.items():
            cells = [
                f"{100.0 * row[f'{fault} found']:.0f} % ({row[f'{fault} limit']:.2f})" for fault in (*FAULTS, "all")
            ]
            gain = 20.0 * math.log10(tests[SINGLE]["all limit"] / row["all limit"])
            rows.append([rate, name, *cells, "" if name == SINGLE else f"{gain:.1f} dB"])
    level = SETTINGS.identify.bearing_false_alarm_probability
    costs = ", ".join(f"{name} {spent:.0f} ms" for name, spent in result["median_ms"].items())
    header = ["false alarms", "test", *(NAMES[fault] for fault in FAULTS), "all", "limit lower by"]
    return "\n\n".join(
        [
            "# Bearing damage in noise: found, and made up",
            f"{result['damaged']} damaged and {result['sound']} sound rigs drawn from seeds (first one "
            f"{result['seed']}), one channel each, 1 to 20 s; the largest peak of the strikes is {SIZES[0]:g} to "
            f"{SIZES[1]:g} times the root mean square of the noise.",
            "Share found at the same rate of false alarms, and in brackets the detection limit: the peak at which as "
            "many are found below as are missed above.",
            table(header, rows),
            f"The alarm as shipped (stated level {level:g} for a whole test) was raised by {result['false_alarms']} of "
            f"{result['sound']} sound records, and by so many percent of the damaged ones, by the peak of the strikes:",
            table(["damage", *next(iter(result["as_shipped"].values()))], result["as_shipped"]),
            f"Cost of one record, median of processor time: {costs}.",
            "The single-line test leaves out the multiples of the shaft and of mains, as crankorder does; it knows "
            "neither bands nor harmonics, and tones that beat are lines to it.",
        ]
    )


if __name__ == "__main__":
    main()
