"""Level over frequency or order and speed, with what was found in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from crankorder.findings import Findings
from crankorder.plot.axes import axes_for, dress, key_below, note, whole_ticks
from crankorder.plot.cells import LEAST_RANGE_DB, bin_edges, level_limits, level_of, speed_cells, with_gaps
from crankorder.plot.given import channel_number, dataset_of, findings_of, number_of, quantity_text, unit_of, values_of
from crankorder.plot.palette import (
    DOUBT_DASHES,
    FAINT,
    INK,
    MAINS,
    MAINS_ON_MAP,
    MODE,
    MODE_DASHES,
    MODE_ON_MAP,
    NORMAL,
    TONE_DASHES,
    WHITE,
)
from crankorder.plot.records import FixedLine, Found, FoundOrder, found_in
from crankorder.quantities import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from crankorder.plot.artists import EdgeLabel

_STRIP_IN, _HEIGHT_IN = 3.2, 5.6  # heights of a figure of one speed, and of several
_CURVE_POINTS = 200
_ORDER = "Order (cycles per crank revolution)"
_NOTED_GAP = 0.08  # of the height, from which a gap is said to be one
_RING_POINTS = 11.0
_BAR_POINTS, _GAP_POINTS, _LABEL_POINTS = 12.0, 10.0, 32.0  # width of the colour bar, and what is free before it


@dataclass(frozen=True)
class _Map:
    """Amplitudes (speed, bin) of one channel, slowest speed first; ``unknown`` spectra have no speed and no place."""

    channel: str
    place: Floats
    speed: Floats
    amplitude: Floats
    label: str
    unknown: int

    @property
    def timeless(self) -> bool:
        """True where no speed at all is known: spectra are stacked."""
        return not np.isfinite(self.speed).any()

    @property
    def cells(self) -> Floats:
        """Lower and upper edge of each spectrum, (speed, 2): in rpm, or by number where no speed is known."""
        if self.timeless:
            number = np.arange(max(len(self.speed), 1), dtype=float)
            return np.stack([number, number + 1.0], axis=1)
        return speed_cells(self.speed)

    def rpm(self, height: Any) -> Any:
        """Speed at a ``height`` of the picture: a strip of one speed has no other, however high it is drawn."""
        return self.speed[0] + 0.0 * height if len(self.speed) == 1 and not self.timeless else height


def campbell(
    campbell_map: xr.Dataset,
    findings: Findings | Mapping[str, Any] | None = None,
    *,
    channel: str | None = None,
    ax: Axes | None = None,
    dynamic_range_db: float = 60.0,
) -> Axes:
    """Campbell diagram: frequency [Hz] to the right, speed [rpm] upwards, level as colour; returns the axes.

    Parameters
    ----------
    campbell_map : CampbellMap of :func:`crankorder.campbell_map`; ``campbell_map.sel(frequency=slice(0, 200))`` is
        a part of it
    findings : what :func:`crankorder.diagnose` returns of the same recordings. Found orders are thin lines labelled
        where they leave the axes, the strongest bold; natural frequencies are dashed and named above, with "?" where
        they are not decided; tones of fixed frequency are dotted; excited crossings are circled
    channel : name of the channel; the first where not given
    ax : axes to draw on; without them a new figure of pyplot's
    dynamic_range_db : the colours reach at most so many dB below the strongest line; > 0

    The level is in dB re 1 unit of the channel. Cells of speed reach half-way to their neighbours, wider gaps stay
    blank. One speed alone is a strip. Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.campbell(co.campbell_map(made, max_frequency_hz=200.0))
    >>> axes.get_xlabel(), axes.get_ylabel()
    ('Frequency, Hz', 'Speed, rpm')
    """
    one = _map_of(dataset_of(campbell_map, "campbell_map", "campbell"), "frequency", channel, "campbell")
    found = found_in(findings_of(findings, "campbell"), one.channel)
    depth = number_of(dynamic_range_db, "dynamic_range_db", "campbell", above=0.0)
    axes = axes_for(ax, "campbell", height_in=_HEIGHT_IN if len(one.speed) > 1 else _STRIP_IN)
    rows = bool(found.orders) + bool(found.fixed)
    _draw_map(axes, one, "Frequency, Hz", depth, rows_above=rows, labels_beside=bool(found.orders))
    ends = np.array([one.cells[0, 0], one.cells[-1, 1]])
    if not one.timeless:
        for order in found.orders:
            _thin(axes, order.order * one.rpm(ends) / 60.0, ends, f"order {order.text}")
    for line in found.fixed:
        if not (one.timeless and line.slope):
            _fixed(axes, line, line.at(one.rpm(ends)), ends)
    _ring(axes, [(frequency, speed) for _, frequency, speed in found.crossings] if not one.timeless else [])
    _label(axes, one, found, _campbell_labels)
    return axes


def order_map(
    order_map: xr.Dataset,
    findings: Findings | Mapping[str, Any] | None = None,
    *,
    channel: str | None = None,
    ax: Axes | None = None,
    dynamic_range_db: float = 60.0,
) -> Axes:
    """Order map: order to the right, speed [rpm] upwards, level as colour; returns the axes.

    Parameters
    ----------
    order_map : OrderMap of :func:`crankorder.order_map`; ``order_map.sel(order=slice(0, 10))`` is a part of it
    findings : what :func:`crankorder.diagnose` returns of the same recordings. Found orders are thin lines labelled
        above, the strongest bold; natural frequencies are dashed curves, with "?" where they are not decided; tones of
        fixed frequency are dotted; excited crossings are circled
    channel : name of the channel; the first where not given
    ax : axes to draw on; without them a new figure of pyplot's
    dynamic_range_db : the colours reach at most so many dB below the strongest line; > 0

    The level is in dB re 1 unit of the channel. Cells of speed reach half-way to their neighbours, wider gaps stay
    blank. One speed alone, known or not, is a strip. Raises RequestError for another dataset, channel or axes.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.order_map(co.order_map(made))
    >>> axes.get_xlabel()
    'Order (cycles per crank revolution)'
    """
    one = _map_of(dataset_of(order_map, "order_map", "order_map"), "order", channel, "order_map")
    found = found_in(findings_of(findings, "order_map"), one.channel)
    depth = number_of(dynamic_range_db, "dynamic_range_db", "order_map", above=0.0)
    axes = axes_for(ax, "order_map", height_in=_HEIGHT_IN if len(one.speed) > 1 else _STRIP_IN)
    rows = bool(found.orders) + (bool(found.fixed) and not one.timeless)
    _draw_map(axes, one, _ORDER, depth, rows_above=rows)
    low, high = one.cells[0, 0], one.cells[-1, 1]
    for order in found.orders:
        _thin(axes, np.array([order.order] * 2), np.array([low, high]), f"order {order.text}")
    if not one.timeless:
        speed = np.linspace(max(low, 1e-3 * high), high, _CURVE_POINTS)
        for line in found.fixed:
            _fixed(axes, line, 60.0 * line.at(one.rpm(speed)) / one.rpm(speed), speed)
        _ring(axes, [(order, speed) for order, _, speed in found.crossings])
    _label(axes, one, found, _order_map_labels)
    return axes


def _map_of(dataset: xr.Dataset, along: str, channel: str | None, picture: str) -> _Map:
    number = channel_number(dataset, channel, picture)
    speed = np.asarray(dataset["speed"].values, dtype=float)
    amplitude = values_of(dataset, "amplitude", "speed", along, channel=number)
    measured = np.isfinite(amplitude).any(axis=1)
    known = measured & np.isfinite(speed)
    kept = np.flatnonzero(known if known.any() else measured)
    kept = kept[np.argsort(speed[kept], kind="stable")]
    label = f"{quantity_text(dataset, number)}, dB re 1 {unit_of(dataset, number)}".removesuffix(" ")
    unknown = int(np.sum(measured & ~np.isfinite(speed))) if known.any() else 0
    name = str(dataset["channel"].values[number])
    return _Map(name, np.asarray(dataset[along].values, dtype=float), speed[kept], amplitude[kept], label, unknown)


def _draw_map(
    axes: Axes, one: _Map, x_label: str, depth_db: float, *, rows_above: int, labels_beside: bool = False
) -> None:
    from crankorder.plot.artists import LevelImage

    cells, x = one.cells, bin_edges(one.place)
    ends = (one.place[0], one.place[-1]) if len(one.place) > 1 else (x[0], x[-1])
    axes.set(xlim=ends, ylim=(cells[0, 0], cells[-1, 1]))
    said = f"{one.unknown} of unknown speed not shown" if one.unknown else ""
    y_label = "Speed not known" if one.timeless else "Speed, rpm"
    dress(axes, x=x_label, y=y_label, title=one.channel, whole=True, rows_above=rows_above, said=said)
    if x_label == _ORDER:
        whole_ticks(axes)
    if one.timeless:
        axes.set_yticks([])
    elif len(one.speed) == 1:
        axes.set_yticks(one.speed, [f"{one.speed[0]:.0f}"])
    if not len(one.speed):
        note(axes, "nothing was measured")
        return
    rows, edges = with_gaps(one.amplitude, cells)
    silent = not np.any(one.amplitude > 0)
    limits = level_limits(one.amplitude, 1.0, range_db=depth_db, least_db=min(LEAST_RANGE_DB, depth_db))
    image = LevelImage(axes, level_of(rows, 1.0), (x, edges), (-depth_db, 0.0) if silent else limits)
    _colour_bar(axes, image, one.label, _LABEL_POINTS if labels_beside else _GAP_POINTS)
    share = (edges - edges[0]) / (edges[-1] - edges[0])
    for number in np.flatnonzero(np.isnan(rows).all(axis=1) & (np.diff(share) > _NOTED_GAP)):
        note(axes, "not measured", up=float(share[number] + share[number + 1]) / 2)
    if silent:
        note(axes, "no signal: every value is zero")


def _colour_bar(axes: Axes, image: Any, label: str, gap_pt: float) -> None:
    figure: Any = axes.get_figure()
    width_pt = max(axes.get_window_extent().width * 72 / figure.dpi, 1.0)
    share = _BAR_POINTS / width_pt
    bar = figure.colorbar(image, ax=axes, fraction=share, pad=gap_pt / width_pt, aspect=30)
    bar.set_label(label, fontsize=NORMAL, color=INK, parse_math=False)
    bar.ax.tick_params(length=3, color=FAINT, labelcolor=INK, labelsize=8.5)
    bar.outline.set(edgecolor=FAINT, linewidth=0.8)


def _thin(axes: Axes, x: Floats, y: Floats, name: str) -> None:
    axes.plot(x, y, color=WHITE, linewidth=0.8, alpha=0.6, gid=name, scalex=False, scaley=False)


def _fixed(axes: Axes, line: FixedLine, x: Floats, y: Floats) -> None:
    dashes = (0.0, TONE_DASHES if line.tone else DOUBT_DASHES if line.undecided else MODE_DASHES)
    axes.plot(
        x, y, color=MAINS_ON_MAP if line.tone else MODE_ON_MAP, linewidth=0.9, alpha=0.85 if line.here else 0.45,
        linestyle=dashes, gid=line.text, scalex=False, scaley=False,
    )  # fmt: skip


def _ring(axes: Axes, places: Sequence[tuple[float, float]]) -> None:
    if not places:
        return
    x, y = zip(*places, strict=True)
    for color, width, alpha in (("#000000", 3.0, 0.56), (WHITE, 1.5, 1.0)):
        axes.plot(
            x, y, linestyle="none", marker="o", markersize=_RING_POINTS, markerfacecolor="none", markeredgecolor=color,
            markeredgewidth=width, alpha=alpha, gid="crossings", scalex=False, scaley=False, zorder=3,
        )  # fmt: skip


def _label(axes: Axes, one: _Map, found: Found, labels: Any) -> None:
    """Names of orders and frequencies where they leave ``axes``, and what the lines are below."""
    from crankorder.plot.artists import EdgeLabels

    if not (found.orders or found.fixed):
        return

    def above(axes: Axes) -> list[list[EdgeLabel]]:
        return labels(axes, one, found)[0]  # type: ignore[no-any-return]

    def beside(axes: Axes) -> list[list[EdgeLabel]]:
        return [labels(axes, one, found)[1]]

    EdgeLabels(axes, above, side="top", caption="order" if found.orders else "")
    EdgeLabels(axes, beside, side="right", caption="order")
    key_below(axes, _keys(found))


def _keys(found: Found) -> list[Any]:
    from matplotlib.lines import Line2D

    looks: list[tuple[bool, str, str, Any]] = [
        (bool(found.orders), "order found (bold: strongest)", INK, "-"),
        (any(not one.tone and not one.undecided for one in found.fixed), "natural frequency", MODE, (0.0, MODE_DASHES)),
        (any(one.undecided for one in found.fixed), "not decided (?)", MODE, (0.0, DOUBT_DASHES)),
        (any(one.tone for one in found.fixed), "mains or fixed tone", MAINS, (0.0, TONE_DASHES)),
    ]
    made = [
        Line2D([], [], color=color, linewidth=1.1, linestyle=dashes, label=text)
        for there, text, color, dashes in looks
        if there
    ]
    if found.crossings:
        ring = {"marker": "o", "markersize": 8.0, "markerfacecolor": "none", "markeredgecolor": INK}
        made.append(Line2D([], [], linestyle="none", label="excited crossing", **ring))  # type: ignore[arg-type]
    return made


def _order_label(order: FoundOrder, found: Found, place: tuple[float, float]) -> EdgeLabel:
    """Label of an ``order`` of ``found`` at a ``place``; the strongest is bold."""
    from crankorder.plot.artists import EdgeLabel

    bold = 0 < order.amplitude == max(one.amplitude for one in found.orders)
    return EdgeLabel(place, order.text, INK, bold, order.amplitude)


def _fixed_labels(axes: Axes, lines: Sequence[FixedLine], places: Sequence[float]) -> list[EdgeLabel]:
    """Labels above ``axes`` of ``lines`` that reach their upper edge at ``places``."""
    from crankorder.plot.artists import EdgeLabel

    (left, right), high = sorted(axes.get_xlim()), max(axes.get_ylim())
    return [
        EdgeLabel((place, high), line.text, MAINS if line.tone else MODE, rank=float(line.here))
        for line, place in zip(lines, places, strict=True)
        if left <= place <= right
    ]


def _campbell_labels(axes: Axes, one: _Map, found: Found) -> tuple[list[list[EdgeLabel]], list[EdgeLabel]]:
    """Rows of labels above, and labels at the right, for the limits that ``axes`` have now."""
    (left, right), (low, high) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    top, side = [], []
    for order in [] if one.timeless else found.orders:
        place = float(order.order * one.rpm(high) / 60)
        if left <= place <= right:
            top.append(_order_label(order, found, (place, high)))
        elif len(one.speed) > 1 and order.order > 0 and low < 60 * right / order.order < high:
            side.append(_order_label(order, found, (right, 60 * right / order.order)))
    places = [line.frequency_hz if one.timeless else float(line.at(one.rpm(high))) for line in found.fixed]
    return [top, _fixed_labels(axes, found.fixed, places)], side


def _order_map_labels(axes: Axes, one: _Map, found: Found) -> tuple[list[list[EdgeLabel]], list[EdgeLabel]]:
    """Rows of labels above for the limits that ``axes`` have now; nothing leaves them at the right alone."""
    (left, right), high = sorted(axes.get_xlim()), max(axes.get_ylim())
    top = [_order_label(each, found, (each.order, high)) for each in found.orders if left <= each.order <= right]
    lines = [] if one.timeless else found.fixed
    places = [60.0 * float(line.at(one.rpm(high)) / one.rpm(high)) for line in lines]
    return [top, _fixed_labels(axes, lines, places)], []
