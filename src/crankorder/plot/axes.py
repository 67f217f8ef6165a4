"""The axes of a picture: those given, else new ones of pyplot, with the look of the house and no setting changed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from crankorder.errors import RequestError
from crankorder.plot.palette import FAINT, GRID, INK, LARGE, NORMAL, SMALL, WHITE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
FEW_DECADES = 2.0
"""A logarithmic axis of less has ticks at 2 and 5 too."""
_LONGEST_NAME = 60  # characters of a channel in a title


def axes_for(ax: Axes | None, picture: str, *, height_in: float = 5.0, width_in: float = 9.0) -> Axes:
    """``ax``, or new axes on a figure of pyplot's, ``width_in`` by ``height_in`` inches.

    ``picture`` stands in the RequestError where ``ax`` is no axes.
    """
    if ax is None:
        import matplotlib.pyplot as plt  # the only place: so that a notebook shows the figure

        _, made = plt.subplots(figsize=(width_in, height_in), layout="constrained", facecolor=WHITE)
        return made
    if not all(hasattr(ax, name) for name in ("transData", "add_artist", "set_xlabel")):
        place, found = f"crankorder.plot.{picture}", type(ax).__name__
        raise RequestError("not axes", file=place, place="ax", found=found, allowed="axes of matplotlib, or None")
    return ax


def dress(axes: Axes, *, x: str, y: str, title: str, whole: bool = False, rows_above: int = 0, said: str = "") -> None:
    """Labels, title and frame of ``axes``: ``x`` and ``y`` name the axes, ``said`` follows the bold ``title``.

    ``whole``: a frame on all sides and no grid, as around maps. ``rows_above``: of labels between axes and title.
    """
    from crankorder.plot.artists import TIER_PT

    axes.set_facecolor(WHITE)
    axes.set_axisbelow(True)
    axes.set_xlabel(x, fontsize=NORMAL, color=INK, parse_math=False)
    axes.set_ylabel(y, fontsize=NORMAL, color=INK, parse_math=False)
    axes.tick_params(which="both", length=3, color=FAINT, labelcolor=INK, labelsize=8.5)
    for name, spine in axes.spines.items():
        spine.set(color=FAINT, linewidth=0.8, visible=whole or name in ("left", "bottom"))
    axes.grid(visible=False, which="both")
    if not whole:
        axes.grid(visible=True, color=GRID, linewidth=0.6)
    name = title if len(title) <= _LONGEST_NAME else f"{title[: _LONGEST_NAME - 1]}…"
    pad = 7.0 + TIER_PT * rows_above
    axes.set_title(name, loc="left", pad=pad, fontsize=LARGE, fontweight="bold", color=INK, parse_math=False)
    axes.set_title(said, loc="right", pad=pad, fontsize=SMALL + 0.5, color=FAINT, parse_math=False)


def log_scale(axes: Axes, values: Any, *, decades: float = 7.0) -> bool:
    """Logarithmic y axis of ``axes`` for the positive ``values``, at most ``decades``; False where there are none."""
    limits = log_limits(values, decades, room=2.0)
    if limits is None:
        axes.set_ylim(0.0, 1.0)
        axes.set_yticks([])
        return False
    log_axis(axes, *limits, most_ticks=9)
    return True


def log_limits(values: Any, decades: float, *, room: float) -> tuple[float, float] | None:
    """Ends of a logarithmic axis for the positive ``values``, at most ``decades`` and a factor ``room`` above them."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not len(positive):
        return None
    top, quiet = float(positive.max()), float(np.quantile(positive, 0.01))
    return max(quiet / 2, top * 10**-decades), min(room * top, 1e307)


def log_axis(axes: Axes, low: float, high: float, *, most_ticks: int) -> None:
    """Logarithmic y axis of ``axes`` from ``low`` to ``high``: decades, and 2 and 5 between where they are few.

    ``most_ticks`` labelled at most.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_yscale("log")
    axes.set_ylim(low, high)
    subs = (1.0, 2.0, 5.0) if np.log10(high / low) < FEW_DECADES else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=most_ticks))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: decade_text(value)))


def whole_ticks(axes: Axes) -> None:
    """Ticks of the x axis of ``axes`` at whole numbers alone, where it spans some."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(nbins=10, steps=[1, 2, 5, 10], integer=True))


def decade_text(value: float) -> str:
    """Tick text of a logarithmic axis: plain from 0.001 to 5000, else as 2·10⁻⁵; ``value`` > 0."""
    exponent = int(np.floor(np.log10(value) + 1e-9))
    if -3 <= exponent <= 3:
        return f"{value:g}"
    mantissa = f"{value / 10.0**exponent:.0f}·"
    return ("" if mantissa == "1·" else mantissa) + "10" + str(exponent).translate(_RAISED)


def note(axes: Axes, text: str, *, up: float = 0.5) -> None:
    """``text`` on a white ground in the middle of ``axes``, ``up`` a share of their height."""
    ground = {"facecolor": WHITE, "edgecolor": "none", "pad": 3}
    axes.text(
        0.5, up, text, transform=axes.transAxes, ha="center", va="center", color=FAINT, fontsize=NORMAL, bbox=ground,
        parse_math=False,
    )  # fmt: skip


def key_below(axes: Axes, handles: Sequence[Any]) -> None:
    """What the lines and marks of ``axes`` are, by their ``handles`` with labels, in a row below the axis."""
    from matplotlib.transforms import ScaledTranslation

    if not handles:
        return
    figure: Any = axes.get_figure()
    below = axes.transAxes + ScaledTranslation(0, -34 / 72, figure.dpi_scale_trans)
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.0, 0.0), bbox_transform=below, ncols=len(handles),
        frameon=False, fontsize=SMALL, labelcolor=INK, borderaxespad=0.0, handlelength=2.4, columnspacing=1.8,
    )  # fmt: skip
