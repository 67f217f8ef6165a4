"""Amplitude of the orders against speed, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.plot.axes import axes_for, dress, log_scale, note, whole_ticks
from crankorder.plot.cells import gaps_before, speed_cells
from crankorder.plot.given import channel_number, dataset_of, quantity_text, unit_of, values_of
from crankorder.plot.palette import FAINT, LIGHT, LINES
from crankorder.plot.records import called_order, order_texts
from crankorder.quantities import Bools, Floats, Ints

if TYPE_CHECKING:
    from matplotlib.axes import Axes


COLOURED = 6  # orders that the eye can follow; the others are there for comparison …
ALL_COLOURED = 8  # … but not for the sake of one or two
_MOST = 12  # orders drawn where none are asked for
LOG_RATIO = 15.0  # orders whose largest amplitudes differ by more than this need a logarithmic axis
CLEAR = 3.0  # standard errors above zero from which a line is drawn; its phase means nothing below
WITHOUT_MARKERS = 60  # more speeds than this are a curve, not points
_SAME_ORDER = 0.02  # an order asked for is the track this close to it


@dataclass(frozen=True)
class DrawnTracks:
    """Values (…, order, speed), slowest speed first; NaN where a line is not clear of the noise. ``rank`` 0: strongest.

    ``read`` is False at speeds at which only other orders have a row: those of a sweep stand at speeds of their own.
    """

    speed: Floats
    orders: Floats
    rank: Ints
    amplitude: Floats
    low: Floats
    high: Floats
    read: Bools
    texts: list[str]

    @property
    def coloured(self) -> Bools:
        """True for the orders that are drawn in a colour of their own."""
        return np.asarray(self.rank < (COLOURED if len(self.orders) > ALL_COLOURED else ALL_COLOURED))

    def color(self, number: int) -> str:
        """Colour of the order ``number``, the same in all channels; light where it is only there for comparison."""
        return LINES[int(self.coloured[:number].sum())] if self.coloured[number] else LIGHT


def orders(
    order_tracks: xr.Dataset,
    *,
    channel: str | None = None,
    orders: Sequence[float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Peak amplitude of orders against speed [rpm], each with its 95 % interval as a pale band; returns the axes.

    Parameters
    ----------
    order_tracks : OrderTracks of :func:`crankorder.order_tracks`
    channel : name of the channel; the first where not given
    orders : those to draw, each as a track within 0.02 of it; the twelve strongest of the channel where not given
    ax : axes to draw on; without them a new figure of pyplot's

    Each line is labelled with its order at its end; the strongest six of many are coloured. Lines are drawn where they
    stand clear of the noise. The axis is logarithmic where the orders differ much. At one speed alone there are points
    with error bars against the order. Raises RequestError for another dataset, channel or order.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> axes = co.plot.orders(co.order_tracks(made, orders=[1.0, 3.0]))
    >>> axes.get_ylabel()
    'Acceleration (peak), m/s²'
    """
    dataset = dataset_of(order_tracks, "order_tracks", "orders")
    number = channel_number(dataset, channel, "orders")
    shown = _tracks(dataset, number, orders)
    axes = axes_for(ax, "orders", height_in=4.6, width_in=8.0)
    one_speed = len(shown.speed) <= 1
    label = f"{quantity_text(dataset, number)}, {unit_of(dataset, number)}".removesuffix(", ")
    said = _said(shown, dataset.sizes["order"] if orders is None else 0) if len(shown.orders) else ""
    x = "Order (cycles per crank revolution)" if one_speed else "Speed, rpm"
    dress(axes, x=x, y=label, title=str(dataset["channel"].values[number]), rows_above=one_speed, said=said)
    _scale(axes, shown)
    if not np.isfinite(shown.amplitude).any():
        note(axes, "no order stands clear of the noise" if len(shown.orders) else "no order was found")
    if one_speed:
        _draw_points(axes, shown)
    else:
        _draw_lines(axes, shown)
    return axes


def _tracks(dataset: xr.Dataset, channel: int, asked: Sequence[float] | None) -> DrawnTracks:
    speed = np.asarray(dataset["speed"].values, dtype=float)
    known = np.isfinite(speed)
    at = np.argsort(speed, kind="stable")[: int(known.sum()) or min(len(speed), 1)]
    value = {
        name: values_of(dataset, name, "order", "speed", channel=channel)[:, at]
        for name in ("amplitude", "standard_error", "amplitude_low", "amplitude_high")
    }
    amplitude, low, high = value["amplitude"], np.maximum(value["amplitude_low"], 0.0), value["amplitude_high"]
    # an unknown error or interval counts as clear; an interval from 0 says that noise alone could be as large
    clear = (amplitude > 0) & ~(amplitude < CLEAR * value["standard_error"]) & ~(low <= 0)
    peak = np.max(np.nan_to_num(np.where(clear, amplitude, 0.0)), axis=1, initial=0.0)
    every = np.asarray(dataset["order"].values, dtype=float)
    kept = _kept(every, peak, asked)
    rank = np.argsort(np.argsort(-peak[kept], kind="stable"), kind="stable")
    shown, bottom, top = (np.where(clear, one, np.nan)[kept] for one in (amplitude, low, high))
    texts = order_texts([called_order(order) for order in every[kept].tolist()])
    return DrawnTracks(speed[at], every[kept], rank, shown, bottom, top, np.isfinite(amplitude)[kept], texts)


def _kept(every: Floats, peak: Floats, asked: Sequence[float] | None) -> NDArray[np.intp]:
    """Places of the orders to draw, ascending: those ``asked`` for, else the strongest."""
    if asked is None:
        return np.sort(np.argsort(-peak, kind="stable")[:_MOST])
    places = []
    for order in asked:
        apart = np.abs(every - float(order))
        if not len(every) or not apart.min() <= _SAME_ORDER:
            there = ", ".join(f"{one:.4g}" for one in every) or "none"
            raise RequestError("no such order", file="crankorder.plot.orders", found=order, allowed=there)
        places.append(int(apart.argmin()))
    return np.unique(np.array(places, dtype=np.intp))


def _said(shown: DrawnTracks, there: int) -> str:
    """Speed where it is the only one, and how many of the orders that are ``there`` are drawn; 0 of those asked for."""
    many = f"{len(shown.orders)} strongest of {there} orders, " if len(shown.orders) < there else ""
    at = ""
    if len(shown.speed) == 1:
        at = f"{shown.speed[0]:.0f} rpm, " if np.isfinite(shown.speed[0]) else "speed not known, "
    return f"{at}{many}with 95 % intervals"


def _scale(axes: Axes, shown: DrawnTracks) -> None:
    """Linear from zero; logarithmic where orders differ much."""
    peaks = np.max(np.nan_to_num(shown.amplitude), axis=1, initial=0.0)
    if not np.any(peaks > 0):
        axes.set(ylim=(0.0, 1.0), yticks=[])
        return
    if peaks.max() < LOG_RATIO * peaks[peaks > 0].min():
        highest = np.nanmax(np.where(np.isfinite(shown.high), shown.high, shown.amplitude))
        axes.set_ylim(0.0, min(1.08 * float(min(highest, 2.0 * peaks.max())), 1e307))
        return
    log_scale(axes, shown.amplitude, decades=6.0)


def _draw_lines(axes: Axes, shown: DrawnTracks) -> None:
    from crankorder.plot.artists import label_ends

    for number in np.argsort(-shown.rank):  # the strongest lies on top
        _draw_line(axes, shown, int(number))
    low, high = float(shown.speed[0]), float(shown.speed[-1])
    spare = 0.015 * (high - low) or 1.0
    axes.set_xlim(low - spare, high + spare)
    colors = [FAINT if shown.color(number) == LIGHT else shown.color(number) for number in range(len(shown.texts))]
    lines = zip(shown.amplitude, shown.texts, colors, shown.rank, strict=True)
    ends = [(shown.speed, amplitude, text, color, -float(rank)) for amplitude, text, color, rank in lines]
    label_ends(axes, ends, caption="order")


def _draw_line(axes: Axes, shown: DrawnTracks, number: int) -> None:
    read = shown.read[number]
    if not read.any():
        return
    speed, color = shown.speed[read], shown.color(number)
    gap = np.flatnonzero(gaps_before(speed_cells(speed)))
    speed, amplitude, low, high = (
        np.insert(one, gap, np.nan)
        for one in (speed, shown.amplitude[number][read], shown.low[number][read], shown.high[number][read])
    )
    coloured = color != LIGHT
    if coloured:
        axes.fill_between(speed, low, high, color=color, alpha=0.2, linewidth=0, gid=f"band {shown.texts[number]}")
    marked = len(speed) <= WITHOUT_MARKERS
    axes.plot(
        speed, amplitude, color=color, linewidth=1.4 if coloured else 0.9, gid=f"order {shown.texts[number]}",
        marker="o" if marked else "none", markersize=3.0 if coloured else 2.0, solid_capstyle="butt",
    )  # fmt: skip


def _draw_points(axes: Axes, shown: DrawnTracks) -> None:
    """Points with error bars against the order, each named above."""
    from crankorder.plot.artists import label_orders

    for number, order in enumerate(shown.orders):
        amplitude = shown.amplitude[number]
        if not np.isfinite(amplitude).any():
            continue
        axes.axvline(order, color=LINES[0], linewidth=0.7, alpha=0.3, zorder=1)
        reach = np.nan_to_num([[amplitude[0] - shown.low[number, 0]], [shown.high[number, 0] - amplitude[0]]])
        axes.errorbar(
            [order], amplitude, yerr=np.maximum(reach, 0.0), fmt="o", color=LINES[0], markersize=4.0, elinewidth=1.2,
            capsize=2.5, gid=f"order {shown.texts[number]}",
        )  # fmt: skip
    if len(shown.orders):
        axes.set_xlim(0.0, 1.06 * float(shown.orders[-1]) or 1.0)
        whole_ticks(axes)
    points = zip(shown.orders.tolist(), shown.texts, shown.rank, shown.amplitude, strict=True)
    marks = [(order, text, -float(rank)) for order, text, rank, value in points if np.isfinite(value).any()]
    label_orders(axes, marks, LINES[0])
