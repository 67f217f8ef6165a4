"""What the pictures of a balance share: systems with their colours and names, and keys in those colours."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crankorder.plot.drawing import Box as Box
from crankorder.plot.painter import axes_at, quiet_frame, write
from crankorder.plot.palette import FAINT, GRID, INK, LINES, text_width_in
from crankorder.plot.reading import listed
from crankorder.report.balance.dataset import PLAIN, SYSTEMS

COUNTERWEIGHTS = ("none", "a", "b", "c", "d")
DESIGNS = ("webs", *(f"order {order}" for order in range(1, 13)))
"""Crank webs and shafts for several cylinders."""
SHAFT_SETS = ("none", "1", "2", "3", "4", "4+2", *DESIGNS, "own")
MEANING = {
    "none": "no counterweight, no shaft",
    "a": "order 1 along cancelled",
    "b": "order 1 across cancelled",
    "c": "equal along and across",
    "d": "counterweight on the rod too",
    "1": "pair at crank speed",
    "2": "pair at twice crank speed",
    "3": "both pairs",
    "4": "one, against the crank",
    "4+2": "one, and pair at twice speed",
    "webs": "weights on the crank",
    **{f"order {order}": "webs and shafts" for order in range(1, 13)},
    "own": "as the engine file has them",
}
"""What strategies of counterweights and possibilities of additional shafts are."""

MOMENT_TEXT = {"about_x": "about Z", "about_y": "about X", "about_crankshaft": "about Y, the crankshaft"}

NO_FORCE = 1e-9
"""A curve below this share of the largest is drawn as nothing."""

_KEY_SIZE = 8.0
_BOLD = 1.13  # text_width_in measures the regular weight


def axis_names(balance: xr.Dataset) -> tuple[str, str]:
    """What the axes x and y of ``balance`` are called: one cylinder has its own directions, several have Z and X."""
    return ("along Z", "along X") if "moment" in balance else ("along the cylinder", "across the cylinder")


def system_color(name: str) -> str:
    """Colour of the system ``name`` in every picture; the plain engine is ink, and no two of one engine are alike."""
    if name in ("none", "own"):
        return INK if name == "none" else LINES[-1]
    family = DESIGNS if name in DESIGNS else [system for system in SYSTEMS if system not in ("none", "own", *DESIGNS)]
    return LINES[family.index(name) % (len(LINES) - 1)]


def frame_around(largest: float) -> float:
    """Half the side of a frame around a curve that reaches ``largest``: a round number above it, 1 where that is 0."""
    if largest == 0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(largest))
    return next(step * decade for step in (1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12) if step * decade > 1.05 * largest)


def cross_hairs(axes: Axes, limit: float) -> None:
    """Scale ±``limit`` and a horizontal and vertical zero line for the ``axes`` of a polar diagram, without ticks."""
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_color(GRID)
    axes.axhline(0, color=GRID, linewidth=0.8)
    axes.axvline(0, color=GRID, linewidth=0.8)


def angle_axes(
    figure: Figure, box: Box, title: str, unit: str, *, limit: float, step: int = 90, pad: float = 16
) -> Axes:
    """Axes over ``box`` of ``figure`` for values of ±``limit`` in a ``unit`` against the crank angle of one turn.

    ``title`` stands ``pad`` points above; a tick every ``step`` degrees.
    """
    axes = axes_at(figure, *box)
    quiet_frame(axes)
    label = "crank angle from top dead centre, °"
    axes.set(xlim=(0, 360), ylim=(-limit, limit), xticks=range(0, 361, step), xlabel=label, ylabel=unit)
    axes.set_title(title, fontsize=9, color=INK, pad=pad)
    axes.axhline(0, color=FAINT, linewidth=0.8)
    return axes


def alike(curves: xr.DataArray) -> list[list[str]]:
    """Names of the systems whose ``curves`` (system, …) are the same, together, in their order."""
    limit = NO_FORCE * float(np.abs(curves.values).max())
    groups: list[list[str]] = []
    for name in map(str, curves["system"].values):
        values = curves.sel(system=name).values
        same = [group for group in groups if np.abs(values - curves.sel(system=group[0]).values).max() <= limit]
        if same:
            same[0].append(name)
        else:
            groups.append([name])
    return groups


def head_of(name: str, balance: xr.Dataset) -> str:
    """Label of the balancing system ``name`` of ``balance``."""
    return str(balance.attrs[PLAIN]) if name == "none" else SYSTEMS[name]


def meaning_of(name: str, balance: xr.Dataset) -> str:
    """Short description of the balancing system ``name`` of ``balance``."""
    stated = name == "none" and balance.attrs[PLAIN] != SYSTEMS["none"]
    return "counterweights of its file, no shaft" if stated else MEANING[name]


def called(names: list[str], balance: xr.Dataset) -> str:
    """``names`` of systems of ``balance``, what they have in common said once: ``"shafts 1 and 4"``."""
    kinds: dict[str, list[str]] = {}
    for name in sorted(names, key=list(SYSTEMS).index):
        kind, _, mark = head_of(name, balance).rpartition(" ")
        kinds.setdefault(kind, []).append(mark)
    return ", ".join(f"{kind} {listed(marks)}" for kind, marks in kinds.items())


def color_key(figure: Figure, box: Box, entries: list[tuple[str, str]]) -> None:
    """Names in their colours in one line above a panel, from its left edge, smaller where the line is full.

    ``figure`` to draw on; ``box`` of the panel in inches (left, bottom, width, height); ``entries`` text and colour.
    """
    left, bottom, width, height = box
    widths = [text_width_in(text, _KEY_SIZE) * _BOLD + 0.16 for text, _ in entries]
    shrink = min(1.0, width / max(sum(widths), 1e-9))
    look = {"fontsize": _KEY_SIZE * shrink, "fontweight": "bold", "va": "bottom"}
    for (text, color), wide in zip(entries, widths, strict=True):
        write(figure, left, bottom + height + 0.06, text, color=color, **look)
        left += wide * shrink
