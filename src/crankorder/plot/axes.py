"""Pictures in notebooks: what they are given, checked, and the axes that show them, with the look of the house.

What is wrong is a RequestError with what is there and what is allowed. No setting of matplotlib is changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from crankorder.channel_units import by_channel, unit_text
from crankorder.errors import InputError, RequestError, SchemaError
from crankorder.findings import SCHEMA_VERSION, Findings
from crankorder.plot.drawing import ORDER, Drawing, Panel, decade_text, log_steps
from crankorder.plot.labels import Key, draw_keys
from crankorder.plot.palette import FAINT, GRID, INK, LARGE, NORMAL, SMALL, WHITE
from crankorder.plot.reading import scaling_text
from crankorder.quantities import Floats, check_dataset
from crankorder.settings import load_settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NOUNS = {
    "recording": "a Recording",
    "shaft_angle": "a ShaftAngle, as crankorder.crank_angle makes it",
    "order_map": "an OrderMap, as crankorder.order_map makes it",
    "campbell_map": "a CampbellMap, as crankorder.campbell_map makes it",
    "order_tracks": "OrderTracks, as crankorder.order_tracks makes them",
    "envelope_map": "an EnvelopeMap, as crankorder.envelope makes it",
    "cycle_average": "a CycleAverage, as the recipe waveforms leaves it in results",
    "operating_shapes": "OperatingShapes, as the recipe waveforms leaves them in results",
}
_TREE: Any = getattr(xr, "DataTree", ())  # older xarray has none
_NOTHING: Mapping[str, object] = {
    "schema_version": SCHEMA_VERSION, "test": "", "unexplained_energy_fraction": None, "balance": None, "channels": [],
    "orders": [], "modes": [], "crossings": [], "bearings": [], "lines": [], "quality": [],
}  # fmt: skip
_LONGEST_NAME = 60  # characters of a channel in a title
_TIER_PT = 17.0  # height of a row of labels above the axes
_BAR_SHARE = 0.15  # of a map, which its bar and labels take where no layout makes room
_KEYS_IN = 0.76  # from the axes down to their keys


def dataset_of(given: object, noun: str, picture: str) -> xr.Dataset:
    """``given`` as a dataset of the ``noun`` that the ``picture`` shows; a branch of a results tree is one.

    Its dims are those of the schema of the ``noun`` in ``data_schema/``. Raises RequestError, which names what was
    given and what is wanted, where ``given`` does not meet it.
    """
    dataset = given.to_dataset() if isinstance(given, _TREE) else given
    wanted, place = _NOUNS[noun], f"crankorder.plot.{picture}"
    if not isinstance(dataset, xr.Dataset):
        raise RequestError("this is no dataset", file=place, found=type(given).__name__, allowed=wanted)
    dataset = by_channel(dataset)
    if (error := _misfit(dataset, noun)) is not None:
        known = next((text for other, text in _NOUNS.items() if _misfit(dataset, other) is None), "")
        given = known.partition(",")[0] or f"a dataset with {', '.join(map(str, dataset.variables)) or 'nothing in it'}"
        problem = f"not what this picture shows ({error.place}: {error.problem})"
        raise RequestError(problem, file=place, found=given, allowed=wanted) from error
    return dataset


def _misfit(dataset: xr.Dataset, noun: str) -> SchemaError | None:
    """Why ``dataset`` is not of the ``noun``; None where it is."""
    try:
        check_dataset(dataset, noun)
    except SchemaError as error:
        return error
    return None


def channel_of(given: object, noun: str, picture: str, channel: str | None) -> tuple[xr.Dataset, int]:
    """``given`` as a dataset (channel, …) of the ``noun``, and the index of ``channel`` in it; 0 where it is None.

    Raises RequestError, which names the ``picture`` and what is there, for another dataset or an unknown channel.
    """
    dataset = dataset_of(given, noun, picture)
    names = [str(name) for name in dataset["channel"].values]
    wanted = next(iter(names), "") if channel is None else str(channel)
    if wanted not in names:
        there = ", ".join(names) or "none"
        raise RequestError("no such channel", file=f"crankorder.plot.{picture}", found=channel or "", allowed=there)
    return dataset, names.index(wanted)


def findings_of(findings: object, picture: str) -> Findings:
    """``findings`` as crankorder.diagnose returns or findings.json holds them; empty ones for None.

    Raises RequestError, which names the ``picture``, where they are neither.
    """
    if isinstance(findings, Findings):
        return findings
    place, stated = f"crankorder.plot.{picture}", _NOTHING if findings is None else findings
    if not isinstance(stated, Mapping) or isinstance(stated, xr.Dataset | _TREE):
        wanted = "findings, as crankorder.diagnose returns it, or a dict, as findings.json holds it"
        raise RequestError("these are no findings", file=place, found=type(findings).__name__, allowed=wanted)
    try:
        return Findings.from_dict(stated)
    except InputError as error:
        problem = f"these are no findings: {error.problem}"
        raise RequestError(problem, file=place, place=error.place, found=error.found, allowed=error.allowed) from error


def positive(value: object, key: str, picture: str) -> float:
    """``value`` of the argument ``key`` of a ``picture``, a finite number > 0; else RequestError."""
    if not isinstance(value, int | float | np.number) or not np.isfinite(value) or not value > 0:
        place = f"crankorder.plot.{picture}"
        raise RequestError("not a number that can be", file=place, place=key, found=value, allowed="a number > 0")
    return float(value)


def values_of(dataset: xr.Dataset, name: str, *dims: str, channel: int) -> Floats:
    """Values of the variable ``name`` (channel, …) of ``dataset`` for channel number ``channel``, along ``dims``."""
    return np.asarray(dataset[name].isel(channel=channel).transpose(*dims).values, dtype=np.float64)


def y_label(dataset: xr.Dataset, channel: int, *, reference: str = "") -> str:
    """Axis label of a ``channel`` (its number) of a map or tracks ``dataset``: quantity, scaling and unit.

    "Acceleration (peak), m/s²"; ``reference`` stands before the unit where it is given: "dB re 1 ".
    """
    quantity = str(dataset["quantity"].values[channel]).replace("_", " ").strip()
    name = "amplitude" if quantity in ("", "1", "unknown", "none") else quantity
    unit = reference + unit_text(str(dataset["unit"].values[channel]))
    return f"{name[:1].upper()}{name[1:]} {scaling_text(dataset)}, {unit}".removesuffix(" ").removesuffix(",")


def axes_for(ax: Axes | None, picture: str, *, height_in: float = 5.0, width_in: float = 9.0) -> Axes:
    """Axes to draw on: ``ax``, or those of a new pyplot figure of ``width_in`` by ``height_in`` inches.

    ``picture`` stands in the RequestError where ``ax`` is no axes.
    """
    if ax is None:
        import matplotlib.pyplot as plt  # the only place: so that a notebook shows the figure

        return plt.subplots(figsize=(width_in, height_in), layout="constrained", facecolor=WHITE)[1]
    if not all(hasattr(ax, name) for name in ("transData", "add_artist", "set_xlabel")):
        place, given = f"crankorder.plot.{picture}", type(ax).__name__
        raise RequestError("not axes", file=place, place="ax", found=given, allowed="axes of matplotlib, or None")
    return ax


def dress(axes: Axes, *, x: str, y: str, title: str, whole: bool = False, rows_above: int = 0, note: str = "") -> None:
    """Axis labels ``x`` and ``y``, bold ``title``, ``note`` at its right, and frame of ``axes``.

    ``whole`` asks for a frame on all sides, no grid, and room for a bar, as around maps; ``rows_above`` is the number
    of rows of labels between axes and title.
    """
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
    elif axes.figure.get_layout_engine() is None:  # nothing else makes room for the bar
        left, bottom, width, height = axes.get_position().bounds
        axes.set_position((left, bottom, width * (1 - _BAR_SHARE), height))
    name = title if len(title) <= _LONGEST_NAME else f"{title[: _LONGEST_NAME - 1]}…"
    pad = 7.0 + _TIER_PT * rows_above
    axes.set_title(name, loc="left", pad=pad, fontsize=LARGE, fontweight="bold", color=INK, parse_math=False)
    axes.set_title(note, loc="right", pad=pad, fontsize=SMALL + 0.5, color=FAINT, parse_math=False)


def scale(axes: Axes, x: Sequence[float] | Floats, y: tuple[float, float] | None, *, log_y: bool = True) -> None:
    """Set the limits of ``axes``: first and last of ``x`` (points,), rising, and ``y``, logarithmic where ``log_y``.

    ``x`` and ``y`` are in the units of the axes; ``y`` is None where there are no data. An axis of orders has ticks at
    whole numbers only, where it spans some; a logarithmic one at decades, and at 2 and 5 between where these are few.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    if len(x) and x[-1] > x[0]:
        axes.set_xlim(x[0], x[-1])
    if axes.get_xlabel() == ORDER:
        axes.xaxis.set_major_locator(MaxNLocator(nbins=10, steps=[1, 2, 5, 10], integer=True))
    if y is None:
        axes.set(ylim=(0.0, 1.0), yticks=[])
    elif log_y:
        axes.set(yscale="log", ylim=y)
        axes.yaxis.set_major_locator(LogLocator(subs=log_steps(*y), numticks=9))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: decade_text(value)))
    else:
        axes.set_ylim(*y)


def whole_picture(figure: Callable[..., Drawing], given: object, findings: object, noun: str, picture: str) -> Figure:
    """The ``picture`` of all channels as in a report, by its ``figure``, on a new figure of pyplot's.

    ``given`` is a dataset of the ``noun`` as :func:`dataset_of` takes it, ``findings`` are as :func:`findings_of` does.
    """
    import matplotlib.pyplot as plt

    from crankorder.plot.painter import Painted

    shown_by = load_settings(None).report
    drawing = figure(dataset_of(given, noun, picture), findings_of(findings, picture), settings=shown_by)
    shown = plt.figure(figsize=(drawing.width_in, drawing.height_in), facecolor=WHITE)
    shown.add_artist(Painted(drawing))
    return shown


def painted(axes: Axes, content: Callable[[Panel], object]) -> Axes:
    """``axes`` with the drawing of ``content`` on them."""
    from crankorder.plot.painter import PaintedPanel

    PaintedPanel(axes, content)
    return axes


def keys_below(panel: Panel, keys: list[Key]) -> None:
    """Legend of ``keys`` below the x axis label of ``panel``."""
    left, bottom, width, _ = panel.box
    draw_keys(panel.drawing, left, keys, room_in=width, base_in=bottom - _KEYS_IN, most=len(keys))
