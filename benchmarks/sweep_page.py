"""Tables and picture of `sweeps.py`."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from published import table
from sweep_peers import FRAMES, OURS, ROTA_FILTER, ROTA_MAP, SCIPY

STYLES = {OURS: ("C3", "*", 20), FRAMES: ("#e08080", "o", 11), SCIPY: ("0.35", "s", 10)}
STYLES |= {ROTA_MAP: ("C0", "^", 11), ROTA_FILTER: ("C2", "D", 10)}
NAMES = {"frequency": "natural frequency", "damping": "damping", "maximum": "largest amplitude of an order"}
ALSO = {"track maximum": "largest amplitude of its track", "maximum held": "amplitude were the speed held"}
SHOWN = 60
"""Misses in the page; all are in the JSON."""
STEPS = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
COLOURS = ("#2b83ba", "#7fbfd0", "#d9ecd3", "#fee3a8", "#f59053", "#c2282d")


def pooled(cells: dict, quantity: str) -> tuple[np.ndarray, int, int, int]:
    """Absolute errors of all cells, %, how many there could be, how many intervals cover, and of how many."""
    errors = [abs(100.0 * one) for cell in cells.values() for one in _errors(cell, quantity)]
    counts = [sum(cell[quantity][key] for cell in cells.values()) for key in ("could", "covered", "intervals")]
    return np.array(errors), *counts


def _errors(cell: dict, quantity: str) -> list[float]:
    return [float(one) for one in cell[quantity]["errors"].split()]


def ratio(cells: dict) -> np.ndarray:
    """Time over plain scipy's, of every test."""
    return np.array([one for cell in cells.values() for one in cell["ratios"]])


def page(found: dict) -> str:
    """Markdown: all cells together, then rates x damping, then what was missed."""
    cells = found["cells"]
    ours = cells[OURS]
    absent = "" if ROTA_MAP in cells else " rota-order was not installed in this run and is left out."
    parts = [
        "# Sweeps past a resonance: error and time",
        "Made by `python benchmarks/sweeps.py --run-up-ratio`; do not edit.",
        "![error and time](sweeps.png)",
        f"{found['what'][0].upper()}{found['what'][1:]}. {found['seeds']} drawn tests in each cell; the signals come "
        "from `tests/machines`, whose physics shares nothing with the program. One sweep passes all resonances; where "
        "it would last over a minute there is one of at most a minute around each. crankorder finds orders and mode "
        "itself (default recipe); the others are told the orders, the order maps have frames of 16 revolutions, and "
        "the Vold-Kalman filter a fifth of an order to each side; natural frequency and damping are read off their "
        "tops and half-power widths. rota-order is given the speed as a straight line through that between pulses."
        + absent,
        "## All cells",
        _summary_table(cells),
        "Errors are of what was told; what was not told counts in the column beside. Time is processor time of the "
        "analysis alone, in one thread, over that of plain scipy on the same test, in turns: median. The maximum is "
        "held against the largest amplitude that the recording really had.",
        "## crankorder's 95 % intervals",
        _coverage_table(ours),
        f"Modes that are said beside the only one there is: {len(found['others'])} in {len(ratio(ours))} tests.",
        _run_up(found["run_up"]),
    ]
    for quantity, name in (NAMES | ALSO).items():
        if not pooled(ours, quantity)[0].size:
            continue
        parts += [
            f"## crankorder, {name}: median error, %",
            "Behind it how many intervals hold the truth, of how many; “not told”: in no test.",
            _grid(ours, quantity, covered=True),
        ]
    for other in (SCIPY, FRAMES, ROTA_FILTER):
        if other in cells:
            grid = _grid_of_all(cells[other])
            parts += [f"## {other}: median error of frequency / damping / maximum, %", grid]
    told = found["misses"]
    parts.append(f"## Intervals of crankorder that do not hold the truth: {len(told)}")
    if told:
        some = _some(told)
        parts.append(f"{len(some)} of them, spread over the table; all are in `sweeps.json`.")
        parts.append("\n".join(f"* {words}" for words in some))
    if found["others"]:
        parts += ["## Modes said that are not there", "\n".join(f"* {words}" for words in _some(found["others"]))]
    return "\n\n".join(parts) + "\n"


def _some(told: list[str]) -> list[str]:
    """At most so many of ``told`` as are shown, spread over all."""
    return [told[at] for at in np.unique(np.linspace(0, len(told) - 1, min(SHOWN, len(told))).astype(int))]


def _run_up(found: dict | None) -> str:
    if found is None:
        return "The run-up of 60 s was not timed in this run (`--run-up-ratio`)."
    return (
        f"A run-up of 60 s × 3 channels (scene `run-up`, default recipe, whole process) takes {found['ratio']:g} of "
        f"the time of `plain_scipy.py` on the reference campaign (mark: at most {found['mark']:g}); in processor time "
        f"{found['processor_ratio']:g}."
    )


def _percent(value: float) -> str:
    return f"{value:.2g}" if abs(value) < 10.0 else f"{value:.0f}"


def _summary_table(cells: dict) -> str:
    header = ["", *(f"{name}: median, 90 % of errors under, %" for name in NAMES.values())]
    rows = []
    for name, own in cells.items():
        row = [name]
        for quantity in NAMES:
            errors, could, *_ = pooled(own, quantity)
            middle = "–" if not errors.size else " · ".join(_percent(v) for v in np.percentile(errors, [50, 90]))
            row.append(f"{middle} (told {errors.size} of {could})")
        rows.append([*row, f"{np.median(ratio(own)):.2g}"])
    return table([*header, "time over plain scipy's"], rows)


def _coverage_table(ours: dict) -> str:
    rows = []
    for quantity, name in (NAMES | ALSO).items():
        row: list[object] = [name]
        for word in ("up", "down"):
            part = {key: cell for key, cell in ours.items() if f" {word}," in key}
            _, _, covered, of = pooled(part, quantity)
            row.append(f"{covered} of {of} ({covered / of:.0%})" if of else "none given")
        rows.append(row)
    return table(["", "run-ups", "run-downs"], rows)


def _axes_of(cells: dict) -> tuple[list[str], list[str]]:
    """Names of the rows (rates) and columns (damping)."""
    split = [key.split(", ") for key in cells]
    return list(dict.fromkeys(one[0] for one in split)), list(dict.fromkeys(one[1] for one in split))


def _middle(cell: dict, quantity: str) -> float:
    errors = _errors(cell, quantity)
    return float(100.0 * np.median(errors)) if errors else np.nan


def _grid(cells: dict, quantity: str, *, covered: bool) -> str:
    rows, columns = _axes_of(cells)

    def text(cell: dict) -> str:
        value, own = _middle(cell, quantity), cell[quantity]
        if np.isnan(value):
            return "not told"
        return f"{value:+.2g}" + (f" ({own['covered']} of {own['intervals']})" if covered else "")

    return table(
        ["rpm/s \\ damping", *columns], [[row, *(text(cells[f"{row}, {each}"]) for each in columns)] for row in rows]
    )


def _grid_of_all(cells: dict) -> str:
    rows, columns = _axes_of(cells)

    def text(cell: dict) -> str:
        values = [_middle(cell, quantity) for quantity in NAMES]
        return " / ".join("–" if np.isnan(value) else f"{value:+.2g}" for value in values)

    return table(
        ["rpm/s \\ damping", *columns], [[row, *(text(cells[f"{row}, {each}"]) for each in columns)] for row in rows]
    )


def figure(found: dict) -> Figure:
    """Above: error against cost of every method. Below: crankorder's error over rates and damping."""
    made = Figure(figsize=(15, 11.5), layout="constrained")
    FigureCanvasAgg(made)
    above, below = made.subfigures(2, 1, height_ratios=(1.0, 1.3), hspace=0.04)
    panels = above.subplots(1, len(NAMES))
    for axes, quantity in zip(panels, NAMES, strict=True):
        _draw_cost(axes, found["cells"], quantity)
    above.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False, fontsize=11
    )
    above.suptitle("Sweeps of 1 to 1000 rpm/s past a resonance of 0.2 to 10 % damping: error against time")
    drawn = [*NAMES, "track maximum"]
    panels = below.subplots(1, len(drawn), sharey=True)
    norm, colours = BoundaryNorm([*STEPS, 1e6], len(STEPS)), ListedColormap([*COLOURS, "#5a0f12"])
    for axes, quantity in zip(panels, drawn, strict=True):
        shown = _draw_grid(axes, found["cells"][OURS], quantity, colours, norm)
    panels[0].set_ylabel("rpm/s")
    bar = below.colorbar(shown, ax=panels, location="bottom", fraction=0.05, aspect=60, ticks=STEPS)
    bar.set_label("median absolute error of a cell, %")
    bar.ax.set_xticklabels([f"{step:g}" for step in STEPS])
    below.suptitle(
        "crankorder by rate and damping   (●: fewer than nine in ten of the 95 % intervals hold the truth; –: not told)"
    )
    return made


def _draw_cost(axes: Axes, cells: dict, quantity: str) -> None:
    for name, own in cells.items():
        colour, mark, size = STYLES[name]
        errors, could, *_ = pooled(own, quantity)
        if not errors.size:
            continue
        at, (low, middle, high) = float(np.median(ratio(own))), np.percentile(errors, [10, 50, 90])
        axes.plot([at, at], [max(low, 1e-3), high], color=colour, lw=2.5, alpha=0.6, zorder=2)
        axes.plot(at, middle, mark, color=colour, ms=size, mec="k", label=name, ls="", zorder=3)
        left = name in (SCIPY, FRAMES, ROTA_MAP)  # to their right stand others
        side = {"ha": "right" if left else "left", "va": "center", "textcoords": "offset points"}
        place = ((-1 if left else 1) * (0.55 * size + 3), -9 if name == FRAMES else 0)
        axes.annotate(f"{errors.size / could:.0%}", (at, middle), place, color=colour, fontsize=9, **side)
    axes.set(xscale="log", yscale="log", xlabel="time over plain scipy's, median")
    axes.set_ylabel("error, %: median, and 10 to 90 % of tests")
    axes.set_title(f"{NAMES[quantity][0].upper()}{NAMES[quantity][1:]}", fontsize=11)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.margins(x=0.2, y=0.12)
    axes.text(0.99, 0.99, "beside a mark: share told", transform=axes.transAxes, ha="right", va="top", fontsize=9)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_grid(axes: Axes, cells: dict, quantity: str, colours: ListedColormap, norm: BoundaryNorm) -> AxesImage:
    rows, columns = _axes_of(cells)
    own = [[cells[f"{row}, {column}"][quantity] for column in columns] for row in rows]
    values = np.array([[_size(_errors(cells[f"{row}, {column}"], quantity)) for column in columns] for row in rows])
    shown = axes.imshow(np.ma.masked_invalid(values), cmap=colours, norm=norm, aspect="auto")
    axes.set_facecolor("#eeeeee")
    for (y, x), value in np.ndenumerate(values):
        bad = own[y][x]["intervals"] and own[y][x]["covered"] < 0.9 * own[y][x]["intervals"]
        words = "–" if np.isnan(value) else (_percent(value) if value >= 0.01 else "<.01") + ("●" if bad else "")
        dark = value >= STEPS[5] or value < STEPS[1]
        axes.text(x, y, words, ha="center", va="center", fontsize=9, color="white" if dark else "black")
    axes.set_xticks(range(len(columns)), columns)
    axes.set_yticks(range(len(rows)), rows)
    axes.set_xlabel("damping of the mode")
    name = (NAMES | ALSO)[quantity]
    axes.set_title(f"{name[0].upper()}{name[1:]}", fontsize=11)
    axes.tick_params(length=0)
    return shown


def _size(errors: list[float]) -> float:
    """Median absolute error, %; NaN where nothing was told."""
    return float(100.0 * np.median(np.abs(errors))) if errors else np.nan
