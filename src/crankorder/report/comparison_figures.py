"""Pictures of a comparison: what changed order by order, and how lines went from run to run."""

from __future__ import annotations

import numpy as np
import xarray as xr

from crankorder.comparison import Comparison, Trend
from crankorder.plot.drawing import Drawing, Panel, Words, title_lines
from crankorder.plot.labels import EdgeLabel, Key, draw_keys, label_right
from crankorder.plot.palette import FAINT, INK, LIGHT, LINES, NORMAL, SMALL, drawable, shortened
from crankorder.plot.reading import order_text
from crankorder.quantities import Floats, Ints
from crankorder.report.comparison import alike
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _TOP, _GUTTER = 0.85, 0.78, 1.0, 0.75
_COLUMNS = 3
_COLOURED = 6  # orders that the eye can follow
_LEAST_DB, _MOST_DB = 6.0, 60.0
_TREND_RIGHT, _TREND_TOP, _TREND_LEAST_DB = 2.6, 0.85, 3.0


def order_change_figure(changes: xr.Dataset, comparison: Comparison, *, settings: ReportSettings) -> Drawing:
    """Second test over first [dB] with 95 % bands against speed [rpm], of the orders that changed; a panel per channel.

    Orders that did not change are light lines; dots are speeds at which a change is claimed.

    ``changes`` is the dataset ``order_change`` (line, speed) of ``comparison``, a line being an order in a channel;
    ``settings`` are those of the report.
    """
    channels = list(dict.fromkeys(changes["channel"].values.tolist()))
    columns = min(len(channels), _COLUMNS)
    rows = -(-len(channels) // columns)
    block = settings.height_in - _BOTTOM - _TOP if rows == 1 else 0.62 * settings.height_in
    drawing = Drawing(settings.width_in, _TOP + rows * block + (rows - 1) * 0.9 + _BOTTOM)
    changed = sorted((record for record in comparison.orders if record.changed), key=lambda record: record.p_value)
    clearest = list(dict.fromkeys(record.order for record in changed))[:_COLOURED]
    colours = {order: LINES[number] for number, order in enumerate(sorted(clearest))}
    speed = changes["speed"].values
    low, high = (float(np.nanmin(speed)), float(np.nanmax(speed))) if np.isfinite(speed).any() else (0.0, 1.0)
    margin = 0.04 * (high - low) if high > low else max(0.05 * abs(low), 1.0)
    ends, limits = (low - margin, high + margin), _limits_db(changes)
    width = (settings.width_in - _LEFT - columns * _GUTTER + 0.2) / columns
    for number, channel in enumerate(channels):
        left = _LEFT + (number % columns) * (width + _GUTTER)
        box = (left, _BOTTOM + (rows - 1 - number // columns) * (block + 0.9), width, block)
        _draw_channel(Panel(drawing, box, ends, limits), changes, channel, colours, first=number % columns == 0)
        name = shortened(drawable(channel, settings.max_name_characters), NORMAL + 1, width, bold=True)
        drawing.add(Words(left, box[1] + block + 0.09, name, NORMAL + 1, bold=True))
    title = f"Orders that changed · {drawable(comparison.base, 40)} → {drawable(comparison.new, 40)}"
    subtitle = comparison.headline[0] if colours else "No order changed by more than chance alone would change it."
    title_lines(drawing, _LEFT, title, drawable(subtitle, 300))
    claimed = Key("95 % band; dot: change claimed", LINES[0] if colours else INK, width=2.0)
    draw_keys(drawing, _LEFT, [claimed, Key("order that did not change", LIGHT)])
    return drawing


def _limits_db(changes: xr.Dataset) -> tuple[float, float]:
    """Limits [dB] of the axis: significant changes with most of their intervals, zero, and a margin."""
    says = changes["changed"].values.astype(bool) & np.isfinite(changes["ratio_db"].values)
    if not says.any():
        return -_LEAST_DB, _LEAST_DB
    values, low, high = (changes[name].values[says] for name in ("ratio_db", "ratio_db_low", "ratio_db_high"))
    reach = 0.5 * float(np.abs(values).max())
    bottom = min(float(np.maximum(low, values - reach).min()), -0.3 * _LEAST_DB)
    top = max(float(np.minimum(high, values + reach).max()), 0.3 * _LEAST_DB)
    room = 0.08 * max(top - bottom, _LEAST_DB)
    return max(bottom - room, -_MOST_DB), min(top + room, _MOST_DB)


def _draw_channel(panel: Panel, changes: xr.Dataset, channel: str, colours: dict[float, str], *, first: bool) -> None:
    """Panel of one channel: what changed in ``colours``, the other orders light behind it."""
    left, bottom, width, height = panel.box
    panel.x_axis("Speed, rpm", most=int(np.clip(1.8 * width, 3, 10)), whole=True)
    panel.y_axis("Second test over first, dB" if first else "")
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.9, name="no change")
    labels, orders = [], changes["order"].values.tolist()
    by_speed = np.argsort(changes["speed"].values, kind="stable")
    rows = np.flatnonzero(changes["channel"].values == channel).tolist()
    for row in sorted(rows, key=lambda row: orders[row] in colours):  # those that changed lie on top
        color = colours.get(orders[row]) if changes["changed"].values[row].any() else None
        last = _draw_line(panel, changes, row, by_speed, color)
        if color is not None and last is not None:
            at = panel.height_at(float(np.clip(last, *panel.y)))
            labels.append(EdgeLabel(at, order_text(orders[row]), color, row))
    panel.frame()
    label_right(panel.drawing, panel.box, labels)
    if labels:
        panel.drawing.add(Words(left + width + 0.1, bottom + height + 0.09, "order", SMALL, FAINT))
    else:
        panel.note("no order changed", at_in=panel.box[1] + 0.94 * panel.box[3])


def _draw_line(panel: Panel, changes: xr.Dataset, row: int, at: Ints, color: str | None) -> float | None:
    """Last value [dB] of the curve of one order, which is drawn; None where it is nowhere above the noise."""
    speed = changes["speed"].values[at]
    values, low, high = (changes[name].values[row][at] for name in ("ratio_db", "ratio_db_low", "ratio_db_high"))
    claimed = changes["changed"].values[row][at].astype(bool)
    known = np.isfinite(values) & np.isfinite(low) & np.isfinite(high) & (high - low < 2 * _MOST_DB) | claimed
    values = np.where(known, values, np.nan)
    if not np.isfinite(values).any():
        return None
    if color is None:
        panel.curve(speed, values, color=LIGHT, width=0.7, name="unchanged")
        return None
    reach = (panel.y[0] - 50.0, panel.y[1] + 50.0)
    low, high = (np.where(known, np.clip(np.nan_to_num(end, nan=0.0), *reach), np.nan) for end in (low, high))
    _draw_interval(panel, speed, low, high, color)
    name = f"order-{order_text(float(changes['order'].values[row]))}"
    panel.curve(speed, values, color=color, width=1.3, name=name)
    panel.rings(speed[claimed], values[claimed], color=color, radius=2.2)
    return float(values[np.isfinite(values)][-1])


def trend_figure(comparison: Comparison, *, settings: ReportSettings) -> Drawing:
    """Amplitude of each line over its own in the first run [dB] against the run, and the fitted growth.

    Lines whose growth is claimed have a colour, 95 % intervals and their fitted growth; the others are light.
    ``comparison`` is that of two runs or more, ``settings`` are those of the report.
    """
    drawing = Drawing(settings.width_in, settings.height_in)
    box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _TREND_RIGHT, settings.height_in - _BOTTOM - _TREND_TOP)
    claimed = sorted((trend for trend in comparison.trend if trend.changed), key=lambda trend: trend.p_value)
    claims = alike(claimed)[:_COLOURED]
    runs = np.arange(1.0, len(comparison.runs) + 1.0)
    levels = np.array([_over_first(trend)[0] for trend in comparison.trend])
    low, high = min(0.0, levels.min()), max(_TREND_LEAST_DB, levels.max())
    room = 0.12 * (high - low)
    panel = Panel(drawing, box, (0.8, runs[-1] + 0.2), (float(low - room), float(high + room)))
    panel.x_axis("Run", most=min(len(runs) + 1, 12), whole=True)
    panel.y_axis("Over the first run, dB")
    panel.curve(np.array(panel.x), np.zeros(2), color=FAINT, width=0.9, name="first run")
    for trend, level in zip(comparison.trend, levels, strict=True):
        if not trend.changed:
            panel.curve(runs, level, color=LIGHT, width=0.7, name="unchanged")
    labels = [_draw_trend(panel, runs, lines, number) for number, lines in enumerate(claims)]
    panel.frame()
    label_right(drawing, box, labels)
    if not claims:
        panel.note("no line grew", at_in=box[1] + 0.94 * box[3])
    of_all = f"{len(claimed)} of {len(comparison.trend)} lines"
    subtitle = f"{of_all} grow or shrink by more than chance; their change per run beside."
    title_lines(drawing, _LEFT, f"Trend over {len(runs)} runs", subtitle)
    keys = [Key("fitted growth; band: 95 % intervals", LINES[0] if claims else INK, width=1.3)]
    draw_keys(drawing, _LEFT, [*keys, Key("line without growth", LIGHT)])
    return drawing


def _draw_interval(panel: Panel, x: Floats, low: Floats, high: Floats, color: str) -> None:
    """Band of an interval; over a single place it is a narrow one."""
    if np.count_nonzero(known := np.isfinite(low + high)) == 1:
        x = x[known] + 0.004 * (panel.x[1] - panel.x[0]) * np.array([-1.0, 1.0])
        low, high = np.repeat(low[known], 2), np.repeat(high[known], 2)
    panel.band(x, low, high, color=color, alpha=0.2)


def _over_first(trend: Trend) -> tuple[Floats, Floats]:
    """Amplitudes (runs,) and their intervals (runs, 2) over the amplitude of the first run, in dB."""
    size = np.array(trend.amplitude)
    ends = np.maximum(np.array(trend.amplitude_ci95, dtype=np.float64), 1e-3 * size[:, None])
    return 20.0 * np.log10(size / size[0]), 20.0 * np.log10(ends / size[0])


def _draw_trend(panel: Panel, runs: Floats, lines: list[Trend], number: int) -> EdgeLabel:
    """Label at the last run of a line that is drawn with its intervals and its fitted growth.

    ``lines`` are those that only their names tell from it, itself the first.
    """
    trend, color = lines[0], LINES[number]
    values, ends = _over_first(trend)
    growth = 20.0 * np.log10(1.0 + trend.growth_per_run)
    fitted = float(np.mean(values - growth * runs)) + growth * runs
    panel.curve(runs, fitted, color=color, width=1.3, name=f"growth-{number}")
    low, high = np.clip(ends, *panel.y).T
    _draw_interval(panel, runs, low, high, color)
    panel.rings(runs, values, color=color, radius=2.2)
    where = f", {trend.channel}" if trend.channel else ""
    names = " or ".join(dict.fromkeys(line.line for line in lines))
    text = shortened(f"{100 * trend.growth_per_run:+.0f} % · {drawable(names, 80)}{where}", SMALL, _TREND_RIGHT - 0.35)
    return EdgeLabel(panel.height_at(float(np.clip(values[-1], *panel.y))), text, color, number)
