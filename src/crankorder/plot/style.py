"""The look of the pictures that matplotlib draws: type, margins, and text that stays text."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from math import log10
from typing import TYPE_CHECKING, Any

import matplotlib

from crankorder.findings import Findings
from crankorder.plot.drawing import FEW_DECADES, decade_text, quality_text
from crankorder.plot.palette import FAINT, GRID, INK, LARGE, MAINS, NORMAL, SMALL, drawable, shortened

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

_LOCK = threading.RLock()  # rc settings are global to matplotlib, and tests are analysed in threads
_HOUSE: Mapping[str, object] = {
    "font.family": ["DejaVu Sans"], "font.size": NORMAL, "axes.edgecolor": FAINT, "axes.labelcolor": INK,
    "axes.linewidth": 0.8, "axes.titlelocation": "left", "axes.axisbelow": True, "grid.color": GRID,
    "grid.linewidth": 0.6, "text.color": INK, "text.parse_math": False, "text.usetex": False, "text.hinting": "default",
    "xtick.color": FAINT, "ytick.color": FAINT, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5, "ytick.labelsize": 8.5,
    "lines.linewidth": 1.3, "figure.facecolor": "white", "axes.facecolor": "white", "savefig.facecolor": "white",
    "svg.hashsalt": "crankorder",
    "axes.unicode_minus": True, "axes.formatter.use_mathtext": False, "path.simplify": True,
}  # fmt: skip
_NOT_LOOK = ("backend", "interactive", "toolbar", "timezone", "tk.", "webagg.", "keymap.", "docstring.", "_internal")


@cache
def _look() -> Mapping[str, object]:
    """Every rc setting that shapes a picture: matplotlib's defaults (not the user's file) with the house's on top."""
    defaults = {str(key): value for key, value in matplotlib.rcParamsDefault.items() if not key.startswith(_NOT_LOOK)}
    return {**defaults, **_HOUSE}


@contextmanager
def house_style() -> Iterator[None]:
    """The house's settings for the time of a ``with`` block, whatever matplotlibrc says; one thread at a time."""
    with _LOCK, matplotlib.rc_context(_look()):  # type: ignore[arg-type]  # its keys are a Literal of every setting
        yield


def title_lines(figure: Figure, left_in: float, title: str, sentence: str) -> None:
    """Bold ``title`` and a ``sentence`` under it, from ``left_in`` inches at the top of ``figure``, cut to fit."""
    width, height = figure.get_size_inches()
    room = width - left_in - 0.2
    write(figure, left_in, height - 0.34, shortened(title, LARGE, room, bold=True), fontsize=LARGE, fontweight="bold")
    if sentence:
        write(figure, left_in, height - 0.56, shortened(sentence, NORMAL, room), color=FAINT)


def head_of_test(figure: Figure, left_in: float, findings: Findings, what: str, sentence: str, *, longest: int) -> None:
    """Title of ``figure``: the test of ``findings`` and ``what`` is shown of it, a ``sentence`` below, their doubts.

    From ``left_in`` inches; the name of the test is cut at ``longest`` characters. The doubts stand at the foot.
    """
    title_lines(figure, left_in, f"{drawable(findings.test, longest)} · {what}", sentence)
    text = quality_text(findings)
    if text:
        place = figure.get_size_inches()[0] - 0.2
        write(figure, place, 0.14, text, ha="right", color=MAINS, fontsize=SMALL + 0.5)


def new_figure(width_in: float, height_in: float) -> Figure:
    """Empty figure on the Agg canvas, ``width_in`` by ``height_in`` inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    return figure


def axes_at(figure: Figure, left_in: float, bottom_in: float, width_in: float, height_in: float) -> Axes:
    """Axes at a place given in inches: ``left_in``, ``bottom_in``, ``width_in``, ``height_in`` on ``figure``."""
    width, height = figure.get_size_inches()
    return figure.add_axes((left_in / width, bottom_in / height, width_in / width, height_in / height))


def write(figure: Figure, x_in: float, y_in: float, text: str, **look: Any) -> Text:
    """``text``, taken literally, at (``x_in``, ``y_in``) inches on ``figure``; ``look``: matplotlib text properties."""
    width, height = figure.get_size_inches()
    return figure.text(x_in / width, y_in / height, text, parse_math=False, **look)


def note(axes: Axes, text: str, place: tuple[float, float] = (0.5, 0.5), **look: Any) -> None:
    """``text`` on a white ground at a ``place`` (shares) of ``axes``, in the middle; ``look``: text properties."""
    ground = {"facecolor": "white", "edgecolor": "none", "pad": 2}
    look = {"ha": "center", "va": "center", "color": FAINT, "bbox": ground} | look
    axes.text(*place, text, transform=axes.transAxes, **look)


def quiet_frame(axes: Axes) -> None:
    """Left and bottom spines and a faint grid for ``axes``; no other spine."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True)
    axes.tick_params(length=3)


def log_axis(axes: Axes, low: float, high: float, *, most_ticks: int) -> None:
    """Logarithmic y axis of ``axes`` from ``low`` to ``high``: decades, and 2 and 5 between where they are few.

    ``most_ticks`` labelled at most.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_yscale("log")
    axes.set_ylim(low, high)
    subs = (1.0, 2.0, 5.0) if log10(high / low) < FEW_DECADES else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=most_ticks))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: decade_text(value)))
