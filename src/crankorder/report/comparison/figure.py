"""Pictures of a comparison: what changed order by order with intervals, and where the Campbell diagram changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.plot.cells import gaps_between, pooled, speed_cells, with_gaps
from crankorder.plot.drawing import Box, Drawing, Field, Words, pixels_of, title_lines
from crankorder.plot.labels import EdgeLabel, Key, draw_keys, fitted, label_right, label_top
from crankorder.plot.palette import FAINT, INK, LIGHT, LINES, NORMAL, NOT_MEASURED, SMALL, drawable, rgb_of, shortened
from crankorder.plot.panel import Panel
from crankorder.report.notation import order_text
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _TOP, _GUTTER = 0.85, 0.78, 1.0, 0.75
_COLUMNS = 3
_COLOURED = 6  # orders that the eye can follow
_LEAST_DB, _MOST_DB = 6.0, 60.0
_MAP_RIGHT, _MAP_TOP = 1.75, 1.22
_SAME = "#f3f5f7"
_FELL, _MIDDLE, _ROSE = (8, 64, 129), (243, 245, 247), (165, 15, 21)
_FELL_PALE, _ROSE_PALE = (158, 202, 225), (252, 174, 145)


def order_change_figure(changes: xr.Dataset, document: dict[str, Any], *, settings: ReportSettings) -> Drawing:
    """Second test over first [dB] with 95 % bands against speed, of the orders that changed; a panel per channel.

    Orders that did not change are light lines; dots are speeds at which a change is claimed.

    ``changes`` the dataset ``order_change`` of a comparison, ``document`` its ``comparison.json``; ``settings`` of the
    report.
    """
    channels = list(dict.fromkeys(changes["channel"].values.tolist()))
    columns = min(len(channels), _COLUMNS)
    rows = -(-len(channels) // columns)
    block = settings.height_in - _BOTTOM - _TOP if rows == 1 else 0.62 * settings.height_in
    drawing = Drawing(settings.width_in, _TOP + rows * block + (rows - 1) * 0.9 + _BOTTOM)
    colours, limits = _colours(document), _limits_db(changes)
    for number, channel in enumerate(channels):
        width = (settings.width_in - _LEFT - columns * _GUTTER + 0.2) / columns
        left = _LEFT + (number % columns) * (width + _GUTTER)
        box = (left, _BOTTOM + (rows - 1 - number // columns) * (block + 0.9), width, block)
        _draw_channel(drawing, changes, channel, box, colours, limits, first=number % columns == 0)
        name = shortened(drawable(channel, settings.max_name_characters), NORMAL + 1, width, bold=True)
        drawing.add(Words(left, box[1] + block + 0.09, name, NORMAL + 1, bold=True))
    title = f"Orders that changed · {_pair(document)}"
    said = document["headline"][0] if colours else "No order changed by more than chance alone would change it."
    title_lines(drawing, _LEFT, title, drawable(said, 300))
    keys = [
        Key("95 % band; dot: change claimed", LINES[0] if colours else INK, width=2.0),
        Key("order that did not change", LIGHT),
    ]
    draw_keys(drawing, _LEFT, keys)
    return drawing


def _pair(document: dict[str, Any]) -> str:
    return f"{drawable(document['base'], 40)} → {drawable(document['new'], 40)}"


def _changed(document: dict[str, Any]) -> list[dict[str, Any]]:
    return sorted((one for one in document["orders"] if one["changed"]), key=lambda one: float(one["p_value"]))


def _colours(document: dict[str, Any]) -> dict[float, str]:
    """Colour of each order that changed anywhere, the clearest first."""
    orders = list(dict.fromkeys(float(one["order"]) for one in _changed(document)))[:_COLOURED]
    return {order: LINES[number] for number, order in enumerate(sorted(orders))}


def _limits_db(changes: xr.Dataset) -> tuple[float, float]:
    """Ends of the axis: the claimed changes with most of their intervals, 0, and room."""
    says = changes["changed"].values.astype(bool)
    values, low, high = (changes[name].values[says] for name in ("ratio_db", "ratio_db_low", "ratio_db_high"))
    known = np.isfinite(values)
    if not known.any():
        return -_LEAST_DB, _LEAST_DB
    values, low, high = values[known], low[known], high[known]
    largest = float(np.abs(values).max())
    bottom = float(np.quantile(np.maximum(low, values - 0.5 * largest), 0.05))
    top = float(np.quantile(np.minimum(high, values + 0.5 * largest), 0.95))
    bottom, top = min(bottom, float(values.min())), max(top, float(values.max()))
    room = 0.08 * max(top - bottom, _LEAST_DB)
    return max(min(bottom, -0.3 * _LEAST_DB) - room, -_MOST_DB), min(max(top, 0.3 * _LEAST_DB) + room, _MOST_DB)


def _draw_channel(
    drawing: Drawing,
    changes: xr.Dataset,
    channel: str,
    box: Box,
    colours: dict[float, str],
    limits: tuple[float, float],
    *,
    first: bool,
) -> None:
    speed = changes["speed"].values
    low, high = (float(np.nanmin(speed)), float(np.nanmax(speed))) if np.isfinite(speed).any() else (0.0, 1.0)
    margin = 0.04 * (high - low) if high > low else max(0.05 * abs(low), 1.0)
    panel = Panel(drawing, box, (low - margin, high + margin), limits)
    panel.x_axis("Speed, rpm", most=int(np.clip(1.8 * box[2], 3, 10)), whole=True)
    panel.y_axis("Second test over first, dB" if first else "")
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.9, name="no change")
    labels = []
    rows = [n for n, name in enumerate(changes["channel"].values.tolist()) if name == channel]
    rows.sort(key=lambda n: float(changes["order"].values[n]) in colours)  # those that changed lie on top
    order_axis = np.argsort(speed, kind="stable")
    for row in rows:
        order = float(changes["order"].values[row])
        color = colours.get(order) if changes["changed"].values[row].any() else None
        last = _draw_line(panel, changes, row, order_axis, color)
        if color is not None and last is not None:
            labels.append(
                EdgeLabel(float(panel.at(0.0, float(np.clip(last, *limits)))[0, 1]), order_text(order), color, row)
            )
    panel.frame()
    label_right(drawing, box, labels)
    if labels:
        drawing.add(Words(box[0] + box[2] + 0.1, box[1] + box[3] + 0.09, "order", SMALL, FAINT))
    else:
        panel.note("no order changed", up=0.94)


def _draw_line(panel: Panel, changes: xr.Dataset, row: int, at: NDArray[np.intp], color: str | None) -> float | None:
    """Draw one order; returns its last value in dB, None where it is nowhere clear of the noise."""
    speed = changes["speed"].values[at]
    values, low, high = (changes[name].values[row][at] for name in ("ratio_db", "ratio_db_low", "ratio_db_high"))
    claimed = changes["changed"].values[row][at].astype(bool)
    known = np.isfinite(values) & np.isfinite(low) & np.isfinite(high) & (high - low < 2 * _MOST_DB) | claimed
    values = np.where(known, values, np.nan)
    if not np.isfinite(values).any():
        return None
    bottom, top = panel.y
    low, high = (
        np.where(known, np.clip(np.nan_to_num(end, nan=0.0), bottom - 50.0, top + 50.0), np.nan) for end in (low, high)
    )
    if color is None:
        panel.curve(speed, values, color=LIGHT, width=0.7, name="unchanged")
        return None
    if np.count_nonzero(known) <= 3:
        for x, one, two in zip(speed[known], low[known], high[known], strict=True):
            panel.curve(np.array([x, x]), np.array([one, two]), color=color, width=2.6, alpha=0.35, name="interval")
    else:
        panel.band(speed, low, high, color=color, alpha=0.2)
    name = f"order-{order_text(float(changes['order'].values[row]))}"
    panel.curve(speed, values, color=color, width=1.3, name=name)
    panel.dots(speed[claimed], values[claimed], color=color, radius=2.2)
    return float(values[np.isfinite(values)][-1])


def map_change_figure(
    changes: xr.Dataset, channel: str, document: dict[str, Any], *, settings: ReportSettings
) -> Drawing:
    """Campbell diagram of what changed in a channel [dB]: cells whose change is claimed in colour, all others pale.

    ``changes`` the dataset ``map_change`` of a comparison; ``channel`` one of its channels; ``document`` its
    ``comparison.json``; ``settings`` of the report. Raises KeyError for an unknown channel.
    """
    names = changes["channel"].values.tolist()
    if channel not in names:
        raise KeyError(channel)
    number, frequency = names.index(channel), changes["frequency"].values
    at = np.argsort(changes["speed"].values, kind="stable")
    speed = changes["speed"].values[at]
    says = changes["changed"].values[number][at].astype(bool)
    values = np.where(says, changes["difference_db"].values[number][at], 0.0)
    limit = float(np.clip(5 * np.ceil(np.quantile(np.abs(values[says]), 0.99) / 5), 5.0, 40.0)) if says.any() else 10.0
    drawing = Drawing(settings.width_in, settings.height_in)
    box = (
        _LEFT + 0.1,
        _BOTTOM + 0.14,
        settings.width_in - _LEFT - 0.1 - _MAP_RIGHT,
        settings.height_in - _BOTTOM - 0.14 - _MAP_TOP,
    )
    cells = speed_cells(speed) if np.isfinite(speed).all() else np.array([[0.0, 1.0]])
    panel = Panel(drawing, box, (float(frequency[0]), float(frequency[-1])), (float(cells[0, 0]), float(cells[-1, 1])))
    _draw_cells(panel, values, cells, frequency, limit, dpi=settings.dpi)
    _draw_scale(panel, limit)
    _draw_orders(panel, [float(order) for order in _colours_of(document, channel)])
    if not says.any():
        panel.note("no cell changed")
    title = f"Channel {drawable(channel, settings.max_name_characters)} · {_pair(document)}"
    compared = int(np.count_nonzero(np.isfinite(changes["p_value"].values[number])))
    chance = f"at most {100 * document['false_discovery_rate']:g} % of them by chance"
    said = f"{int(says.sum())} of {compared} cells changed; {chance}."
    title_lines(drawing, box[0], title, said)
    draw_keys(drawing, box[0], [Key("order that changed", INK, (5.0, 4.0))] if document["cause"]["orders"] else [])
    return drawing


def _colours_of(document: dict[str, Any], channel: str) -> list[float]:
    return sorted(float(one["order"]) for one in _changed(document)[: 4 * _COLOURED] if one["channel"] == channel)


def change_colours(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Red, green and blue of changes, of the shape of ``share`` and a last axis of 3: blue for −1, red for 1."""
    stops = np.array([-1.0, -0.35, 0.0, 0.35, 1.0])
    table = np.array([_FELL, _FELL_PALE, _MIDDLE, _ROSE_PALE, _ROSE], dtype=np.float64)
    inside = np.clip(share, -1.0, 1.0)
    return np.stack([np.interp(inside, stops, table[:, part]) for part in range(3)], axis=-1).astype(np.uint8)


def _draw_cells(
    panel: Panel,
    values: NDArray[np.float64],
    cells: NDArray[np.float64],
    frequency: NDArray[np.float64],
    limit: float,
    *,
    dpi: int,
) -> None:
    rows, columns = pixels_of(panel.box, dpi)
    half = (frequency[1] - frequency[0]) / 2 if len(frequency) > 1 else 0.5
    bins = np.concatenate([frequency - half, [frequency[-1] + half]])
    shown = []
    for sign in (1.0, -1.0):
        rows_of, edges = with_gaps(np.maximum(sign * values, 0.0), cells, empty=-1.0)
        across = pooled(rows_of, bins, np.linspace(float(frequency[0]), float(frequency[-1]), columns + 1), axis=1)
        shown.append(pooled(across, edges, np.linspace(float(edges[0]), float(edges[-1]), rows + 1), axis=0))
    rise, fall = (_wider(one) for one in shown)
    share = np.where(rise >= fall, rise, -fall) / limit
    # what is claimed is seen, however small it is
    rgb = change_colours(np.where(share == 0, 0.0, np.sign(share) * np.maximum(np.abs(share), 0.3)))
    rgb[rise < 0] = rgb_of(NOT_MEASURED)
    panel.drawing.add(Field(rgb[::-1], panel.box))
    panel.frame(whole=True)
    panel.x_axis("Frequency, Hz", grid=False)
    panel.y_axis("Speed, rpm", grid=False)
    for start, end in gaps_between(cells):
        if (end - start) * panel.box[3] > 0.3 * (panel.y[1] - panel.y[0]):
            panel.note("not measured in both", up=float(panel.share((start + end) / 2)))


def _wider(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels (rows, columns) with each of a claimed cell one wider on both sides, so that a thin cell is seen."""
    padded = np.pad(values, ((0, 0), (1, 1)), mode="edge")
    return np.asarray(np.maximum(np.maximum(padded[:, :-2], padded[:, 2:]), values))


def _draw_scale(panel: Panel, limit: float) -> None:
    box = panel.box
    bar = Panel(panel.drawing, (box[0] + box[2] + 0.62, box[1], 0.17, box[3]), (0.0, 1.0), (-limit, limit))
    ramp = change_colours(np.linspace(1.0, -1.0, 255))
    panel.drawing.add(Field(np.repeat(ramp[:, None], 2, axis=1), bar.box))
    bar.frame(whole=True)
    bar.y_axis("Level, second less first, dB", grid=False, right=True)


def _draw_orders(panel: Panel, orders: list[float]) -> None:
    """Lines of the orders that changed, labelled where they leave the diagram."""
    low, high = panel.y
    top, side = [], []
    for number, order in enumerate(orders):
        panel.curve(
            order * np.array([low, high]) / 60,
            np.array([low, high]),
            color=INK,
            width=0.6,
            alpha=0.5,
            dashes=(5.0, 4.0),
            name=f"order-{order_text(order)}",
        )
        if panel.x[0] <= order * high / 60 <= panel.x[1]:
            top.append(EdgeLabel(float(panel.at(order * high / 60, high)[0, 0]), order_text(order), INK, number))
        elif low < 60 * panel.x[1] / order < high:
            side.append(
                EdgeLabel(float(panel.at(panel.x[1], 60 * panel.x[1] / order)[0, 1]), order_text(order), INK, number)
            )
    lines = label_top(panel.drawing, panel.box, [fitted(top, panel.box[2])])
    label_right(panel.drawing, panel.box, side)
    if top:
        panel.drawing.add(Words(panel.box[0] - 0.3, lines[0], "order", SMALL, INK, along="right"))
