"""Rows, tables and picture of `campaign.py`."""

from __future__ import annotations

from typing import Any

import numpy as np
from amplitude_error import RULE
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from published import table
from whole_process import machine_words

MAPS, FULL, FINDINGS = "crankorder, recipe maps", "crankorder, recipe maps-full-band", "crankorder, with findings"
SCIPY, ROTA = "plain scipy", "rota-order 0.3"
WARM_MAPS, WARM = "crankorder, recipe maps, warm interpreter", "crankorder, with findings, warm interpreter"
FIRST, RUN_UP = "crankorder, with findings, first run", "crankorder, run-up of 60 s, with findings"
ON_THE_CAMPAIGN = (MAPS, FULL, FINDINGS, WARM_MAPS, WARM, FIRST)
WHAT = {
    MAPS: "order map (≤ 20), Campbell map (≤ 1.25 kHz), intervals, flags, SHA-256, NetCDF, pages",
    FULL: "the same to order 100 and 20 kHz",
    FINDINGS: "maps (≤ 500 Hz), orders, modes, crossings, bearings with intervals, NetCDF, pages",
    SCIPY: "order spectra, Welch spectra, one PNG per channel",
    ROTA: "order map (≤ 20), frequency map (≤ 1.25 kHz), one PNG per channel",
    WARM_MAPS: "the maps in an interpreter that has analysed the campaign; without its start; memory of all its runs",
    WARM: "the default run likewise",
    FIRST: "the default run with no compiled kernel, as after an installation, which compiles the modules",
    RUN_UP: "the default run of one recording of 60 s, 3 channels, 300 to 6000 rpm",
}
MARK_RATIO = {SCIPY: 10.0, ROTA: 40.0}
IDENTIFICATION_MARK_S = 3.0
"""Of one core, for the findings of the whole campaign."""
DEARER = 1.1
"""A row that costs so many times more than before, relative to plain scipy, is named."""
OURS_COLOUR, OTHERS_COLOUR = "#1f5a8a", "#808080"


def page(found: dict[str, Any], marks: str) -> str:
    """Markdown: the table of ``marks`` first, ratios, then seconds and where they go, then the errors."""
    rows = found["rows"]
    return f"""# The reference campaign as a whole process

Made by `make bench`; do not edit.

![time and error](campaign.png)

{found["what"]}; {found["megabytes"]} MB, {found["cores"]} cores. The programs take turns, up to {found["repeats"]}
each, and the median of each counts; the first run is measured once. {machine_words(found["machine"])}

Others may use the machine too: processor seconds tell what the work costs, seconds what a user waits. What remains of
the seconds beside the stages is the start: modules and compiled kernels. {_rota_words(found)}

{marks}

{_ratios(rows)}

Aims, most of them not reached: a number below its aim is work to do, not a slip of this run.

{_seconds(rows)}

{_stages(rows)}

Identification alone (orders, modes, bearings, crossings, balance, causes, from maps and frames to the findings):
{found["identification_s"]} s of one core (mark {IDENTIFICATION_MARK_S:g} s).

## Error beside time

{_error_table(found)}

{_error_words(found["error_of_amplitudes"])}
"""


def _rota_words(found: dict[str, Any]) -> str:
    if ROTA not in found["rows"]:
        return f"rota-order has no row: {found['rota_absent']}."
    count = found["rows"][ROTA]["scaled_from_recordings"]
    return (
        f"rota-order analysed {count} recordings, spread over the speeds; the time of its analysis is scaled to all of "
        "them, its start and its pictures are not."
    )


def _ratios(rows: dict[str, Any]) -> str:
    peers = [name for name in (SCIPY, ROTA) if name in rows]
    header = ["times faster than", *(f"{peer} (aim {MARK_RATIO[peer]:g})" for peer in peers)]
    header += [f"{peer}, in processor seconds" for peer in peers]
    keys = [(key, peer) for key in ("seconds_ratio", "processor_seconds_ratio") for peer in peers]
    return table(header, [[name, *(rows[name][key][peer] for key, peer in keys)] for name in ON_THE_CAMPAIGN])


def _seconds(rows: dict[str, Any]) -> str:
    header = ["", "s", "processor s, all processes", "peak MB of a process", "what it makes"]
    keys = ("seconds", "processor_seconds", "peak_resident_mb")
    return table(header, [[name, *(row[key] for key in keys), WHAT[name]] for name, row in rows.items()])


def _stages(rows: dict[str, Any]) -> str:
    parts = list(rows[MAPS]["stages"])
    staged = [(name, row["stages"]) for name, row in rows.items() if row["stages"]]
    return table(["s in", *parts], [[name, *(stages.get(part, "") for part in parts)] for name, stages in staged])


def _error_table(found: dict[str, Any]) -> str:
    rows, told = found["rows"], found["error_of_amplitudes"]
    own = told["programs_on_recordings_of_rota"]
    header = ["program", "s", "processor s", "largest error, %", "median, %", "amplitudes", "largest at"]
    header += ["on rota-order's recordings: largest, %", "median, %", "amplitudes"] if ROTA in rows else []
    body = []
    for name, error in told["programs"].items():
        cells = [name, rows[name]["seconds"], rows[name]["processor_seconds"], *_percent(error), error["lines"]]
        cells.append(error["worst"])
        if ROTA in rows:
            cells += [*_percent(own[name]), own[name]["lines"]]
        body.append(cells)
    return table(header, body)


def _percent(error: dict[str, Any]) -> list[str]:
    return [f"{100.0 * error[key]:.2g}" for key in ("largest", "median")]


def _error_words(told: dict[str, Any]) -> str:
    noise = told["noise"]
    orders = ", ".join(f"{order:g}" for order in told["orders"])
    return f"""Relative error of the peak amplitude of orders against the synthesiser's truth, the same amplitudes for
every program: {told["lines"]}, of orders {orders}. rota-order tells those of the recordings that it analysed; what the
others make of these stands beside it.

{RULE} Here that standard error has a median of {100.0 * noise["median"]:.1g} % and is at most
{100.0 * noise["largest"]:.1g} %. With its own noise the campaign's errors are those of the noise: see
[identification](identification.md).

crankorder's maps: the order map's amplitude, averaged by energy over frames of 16 revolutions. crankorder with
findings: its order tracks, and the order map where an order has no track. plain scipy: the bin of the order in one FFT
over all whole pairs of revolutions, without a window; it takes the edges of the encoder at whole samples, which swings
its angle and so makes its largest errors. rota-order: the mean by energy over its frames of 16 revolutions
(Hann window), its RMS values times √2.
"""


def costs_beside(old: dict[str, Any], rows: dict[str, Any]) -> str:
    """Processor seconds of every row over plain scipy's of the same run, before and now, and which became dearer."""
    body, dearer = [], []
    for name, row in rows.items():
        now = row["processor_seconds"] / rows[SCIPY]["processor_seconds"]
        if name not in old or SCIPY not in old:
            body.append([name, "", f"{now:.3f}", ""])
            continue
        was = old[name]["processor_seconds"] / old[SCIPY]["processor_seconds"]
        body.append([name, f"{was:.3f}", f"{now:.3f}", f"{100.0 * (now / was - 1.0):+.0f} %"])
        if now > DEARER * was and name not in (SCIPY, ROTA):
            dearer.append(name)
    header = ["processor seconds over plain scipy's", "before", "now", "change"]
    over = f"Rows that cost over {100.0 * (DEARER - 1.0):.0f} % more, relative to plain scipy, than before: "
    return f"{table(header, body)}\n\n{over}{'; '.join(dearer) or 'none'}."


def figure(found: dict[str, Any]) -> Figure:
    """Seconds of every row, and beside it the largest error of each program over its seconds."""
    rows = found["rows"]
    made = Figure(figsize=(13.5, 0.42 * len(rows) + 2.4), layout="constrained")
    FigureCanvasAgg(made)
    bars, errors = made.subplots(1, 2, width_ratios=(1.15, 1.0))
    _draw_seconds(bars, rows)
    _draw_errors(errors, found)
    return made


def _draw_seconds(axes: Axes, rows: dict[str, Any]) -> None:
    names = list(rows)[::-1]
    for place, name in enumerate(names):
        seconds = rows[name]["seconds"]
        axes.plot(seconds, place, "o", color=OTHERS_COLOUR if name in (SCIPY, ROTA) else OURS_COLOUR, markersize=9)
        ratio = "" if name == MAPS else f"  ({seconds / rows[MAPS]['seconds']:.1f} × maps)"
        axes.text(seconds * 1.17, place, f"{seconds:.1f} s{ratio}", va="center", fontsize=9)
    axes.set_yticks(range(len(names)), names, fontsize=9)
    axes.set_ylim(-0.6, len(names) - 0.4)
    taken = [row["seconds"] for row in rows.values()]
    log_axis(axes, min(taken) / 2, max(taken) * 8, "seconds")
    axes.set_title("From the shell to the results", loc="left")


def _draw_errors(axes: Axes, found: dict[str, Any]) -> None:
    """One point per program; the labels stand in rows above, the leftmost highest, so that no line crosses a label."""
    rows, told = found["rows"], found["error_of_amplitudes"]
    programs, own = told["programs"], told["programs_on_recordings_of_rota"] if ROTA in rows else {}
    names = sorted(programs, key=lambda name: rows[name]["seconds"])
    every = [100.0 * of[name]["largest"] for of in (programs, own) for name in of]
    low, high, share = 0.6 * min(every), 1.8 * max(every), 0.5  # share of the height for the points
    top = low * (high / low) ** (1.0 / share)
    for number, name in enumerate(names):
        seconds, colour = rows[name]["seconds"], OTHERS_COLOUR if name in (SCIPY, ROTA) else OURS_COLOUR
        largest = 100.0 * programs[name]["largest"]
        at = low * (top / low) ** (0.96 - (0.96 - share) * number / max(1, len(names) - 1))
        axes.plot([seconds, seconds], [largest, at], color="#bbbbbb", linewidth=0.8, zorder=1)
        if name != ROTA:
            axes.plot(seconds, largest, "o", color=colour, markersize=9)
        if name in own:
            axes.plot(seconds, 100.0 * own[name]["largest"], "o", color=colour, markerfacecolor="white", markersize=7)
        words = f" {name}: {seconds:.1f} s, {largest:.2g} %"
        axes.text(seconds, at, words, fontsize=9, va="center", ha="left", color=colour)
    if own:
        count = rows[ROTA]["scaled_from_recordings"]
        words = f"● all recordings\n○ the {count} that rota-order analysed"
        axes.text(0.99, 0.02, words, transform=axes.transAxes, ha="right", va="bottom", fontsize=9, color="#444444")
    axes.set_yscale("log")
    axes.set_ylim(low, top)
    decades = np.log10(high / low)
    steps = [step * 10.0**power for power in range(-8, 5) for step in ((1, 2, 5) if decades < 2.0 else (1,))]
    axes.set_yticks([step for step in steps if low <= step <= high])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} %"))
    taken = [rows[name]["seconds"] for name in names]
    log_axis(axes, min(taken) / 1.6, max(taken) * 12, "seconds of the whole process")
    axes.set_ylabel("largest relative error (logarithmic)", y=share / 2)
    axes.grid(axis="y", color="#dddddd")
    axes.set_title("Time and largest error of the order amplitudes", loc="left")


def log_axis(axes: Axes, first: float, last: float, what: str) -> None:
    """A logarithmic abscissa whose numbers stand at 1, 2 and 5."""
    axes.set_xscale("log")
    axes.set_xlim(first, last)
    steps = np.array([step * 10.0**power for power in range(-3, 7) for step in (1, 2, 5)])
    axes.set_xticks(steps[(steps >= first) & (steps <= last)])
    axes.minorticks_off()
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel(f"{what} (logarithmic)")
    axes.grid(axis="x", color="#dddddd")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
