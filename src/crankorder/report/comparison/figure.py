"""Pictures of a comparison: what changed order by order, and how lines went from run to run, with intervals."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.plot.drawing import Box, Drawing, Words, title_lines
from crankorder.plot.labels import EdgeLabel, Key, draw_keys, label_right
from crankorder.plot.palette import FAINT, INK, LIGHT, LINES, NORMAL, SMALL, drawable, shortened
from crankorder.plot.panel import Panel
from crankorder.quantities import Floats
from crankorder.report.notation import order_text
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _TOP, _GUTTER = 0.85, 0.78, 1.0, 0.75
_COLUMNS = 3
_COLOURED = 6  # orders that the eye can follow
_LEAST_DB, _MOST_DB = 6.0, 60.0
_TREND_RIGHT, _TREND_TOP, _TREND_LEAST_DB = 2.6, 0.85, 3.0


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
    title = f"Orders that changed · {drawable(document['base'], 40)} → {drawable(document['new'], 40)}"
    said = document["headline"][0] if colours else "No order changed by more than chance alone would change it."
    title_lines(drawing, _LEFT, title, drawable(said, 300))
    claimed = Key("95 % band; dot: change claimed", LINES[0] if colours else INK, width=2.0)
    draw_keys(drawing, _LEFT, [claimed, Key("order that did not change", LIGHT)])
    return drawing


def _colours(document: dict[str, Any]) -> dict[float, str]:
    """Colour of each order that changed anywhere, the clearest first."""
    changed = sorted((one for one in document["orders"] if one["changed"]), key=lambda one: float(one["p_value"]))
    orders = list(dict.fromkeys(float(one["order"]) for one in changed))[:_COLOURED]
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
            height = float(panel.at(0.0, float(np.clip(last, *limits)))[0, 1])
            labels.append(EdgeLabel(height, order_text(order), color, row))
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


def trend_figure(document: dict[str, Any], *, settings: ReportSettings) -> Drawing:
    """Amplitude of each line over its own in the first run [dB] against the run, and what was fitted.

    Lines whose growth is claimed have a colour, 95 % intervals and their fitted growth; the others are light.

    ``document`` the ``comparison.json`` of three runs or more; ``settings`` of the report.
    """
    drawing = Drawing(settings.width_in, settings.height_in)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _TREND_RIGHT, settings.height_in - _BOTTOM - _TREND_TOP)
    claims = _told_apart([one for one in document["trend"] if one["changed"]])[:_COLOURED]
    runs = np.arange(1.0, len(document["runs"]) + 1.0)
    ends = [_over_first(one)[0] for one in document["trend"]]
    low, high = min(0.0, *(one.min() for one in ends)), max(_TREND_LEAST_DB, *(one.max() for one in ends))
    room = 0.12 * (high - low)
    panel = Panel(drawing, box, (0.8, runs[-1] + 0.2), (float(low - room), float(high + room)))
    panel.x_axis("Run", most=min(len(runs) + 1, 12), whole=True)
    panel.y_axis("Over the first run, dB")
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.9, name="first run")
    for one in document["trend"]:
        if not one["changed"]:
            panel.curve(runs, _over_first(one)[0], color=LIGHT, width=0.7, name="unchanged")
    labels = [_draw_trend(panel, runs, one, LINES[at], at) for at, one in enumerate(claims)]
    panel.frame()
    label_right(drawing, box, labels)
    if not claims:
        panel.note("no line grew", up=0.94)
    changed = sum(one["changed"] for one in document["trend"])
    of_all = f"{changed} of {len(document['trend'])} lines"
    said = f"{of_all} grow or shrink by more than chance; their change per run beside."
    title_lines(drawing, _LEFT, f"Trend over {len(runs)} runs", said)
    keys = [Key("fitted growth; bars: 95 % intervals", LINES[0] if claims else INK, width=1.3)]
    draw_keys(drawing, _LEFT, [*keys, Key("line without growth", LIGHT)])
    return drawing


def _told_apart(claims: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The lines with the smallest chance first; of lines at one order, which only their names tell apart, one."""
    kept: dict[tuple[str, str, float], dict[str, Any]] = {}
    for one in sorted(claims, key=lambda one: float(one["p_value"])):
        key = (one["kind"], one["channel"], round(float(one["order"]), 2))
        same = kept.setdefault(key, dict(one))
        if same["line"] != one["line"]:
            same["line"] = f"{same['line']} or {one['line']}"
    return list(kept.values())


def _over_first(one: dict[str, Any]) -> tuple[Floats, Floats]:
    """Amplitudes (runs,) and their intervals (runs, 2) over the amplitude of the first run, in dB."""
    size = np.array(one["amplitude"], dtype=np.float64)
    ends = np.maximum(np.array(one["amplitude_ci95"], dtype=np.float64), 1e-3 * size[:, None])
    return 20.0 * np.log10(size / size[0]), 20.0 * np.log10(ends / size[0])


def _draw_trend(panel: Panel, runs: Floats, one: dict[str, Any], color: str, number: int) -> EdgeLabel:
    """Draw one line with its intervals and its fitted growth; returns its label at the last run."""
    values, ends = _over_first(one)
    growth = 20.0 * np.log10(1.0 + one["growth_per_run"])
    fitted = float(np.mean(values - growth * runs)) + growth * runs
    panel.curve(runs, fitted, color=color, width=1.3, name=f"growth-{number}")
    for x, (low, high) in zip(runs, np.clip(ends, *panel.y), strict=True):
        panel.curve(np.array([x, x]), np.array([low, high]), color=color, width=2.6, alpha=0.35, name="interval")
    panel.dots(runs, values, color=color, radius=2.2)
    where = f", {one['channel']}" if one["channel"] else ""
    words = f"{100 * one['growth_per_run']:+.0f} % · {drawable(one['line'], 80)}{where}"
    text = shortened(words, SMALL, _TREND_RIGHT - 0.35)
    return EdgeLabel(float(panel.at(0.0, float(np.clip(values[-1], *panel.y)))[0, 1]), text, color, number)
