"""The hard cases of the order rooms, each with its error, its mark and a picture of it.

Usage: python benchmarks/hard_cases.py
Writes `reports/speed-error/hard-cases.{png,md,json}`. Their laws are held by `tests/{hard,orders,fft}`.
"""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from published import publish, table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from hard_case_list import CASES, HardCase

COLUMNS = 3
COLOURS = ("#1f77b4", "#d95f02", "#7570b3")


def draw(axes: Axes, name: str, case: HardCase) -> None:
    for number, (x, y, label) in enumerate(case.curves):
        truth = label == "truth" or label.endswith("(truth)")
        few = len(x) <= 6
        style = {"color": "black", "linewidth": 0.8, "linestyle": ":"} if truth else {"color": COLOURS[number % 3]}
        if few:
            style |= {"linestyle": "", "marker": "+" if truth else "o", "markersize": 9 if truth else 5}
        if case.logarithmic:
            y = np.where(y > 0, y, np.nan)
        axes.plot(x, y, label=label, **style)
    if case.logarithmic:
        axes.set_yscale("log")
    if case.wide:
        axes.set_xscale("log")
    met = case.error <= case.mark
    axes.set_title(
        "\n".join(textwrap.wrap(case.asked, 52)) + f"\nerror {case.error:.1e}, mark {case.mark:.0e}",
        fontsize=9,
        color="black" if met else "#b00020",
        loc="left",
    )
    axes.set_xlabel(case.x_label, fontsize=8)
    axes.set_ylabel(case.y_label, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.margins(y=0.25)
    axes.legend(fontsize=7, frameon=False, loc="upper right", ncols=3)
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    found = {name: case() for name, case in CASES.items()}
    rows = -(-len(found) // COLUMNS)
    figure = Figure(figsize=(15, 3.3 * rows), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, (name, case) in zip(panels, found.items(), strict=False):
        draw(axes, name, case)
    for axes in panels[len(found) :]:
        axes.set_axis_off()
    missed = [name for name, case in found.items() if not case.error <= case.mark]
    figure.suptitle(
        f"Hard cases: {len(found) - len(missed)} of {len(found)} within their marks", fontsize=13, fontweight="bold"
    )
    lines = [[name, case.asked, f"{case.error:.1e}", f"{case.mark:.0e}"] for name, case in found.items()]
    page = "\n".join(
        [
            "# Hard cases of order analysis",
            "",
            "Errors are relative to the amplitude asked for, against analytic truth.",
            "Made by `benchmarks/hard_cases.py`; the laws are held by `tests/hard`, `tests/orders` and `tests/fft`.",
            "",
            table(["case", "asked", "error", "mark"], lines),
            "",
            "![The cases](hard-cases.png)",
            "",
        ]
    )
    document = {name: {"asked": case.asked, "error": case.error, "mark": case.mark} for name, case in found.items()}
    publish("hard-cases", document, page, figure)


if __name__ == "__main__":
    main()
