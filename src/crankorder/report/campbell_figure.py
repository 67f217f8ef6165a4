"""The Campbell diagram of a channel: level over frequency and speed, with orders, natural frequencies and crossings."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from crankorder.report.cells import cells_with_gaps, gaps_between, pixel_maximum, speed_cells
from crankorder.report.labels import EdgeLabel, fitted, label_right, label_top
from crankorder.report.notation import frequency_text, is_number, is_tone, level_reference, nominal_order, order_text
from crankorder.report.sentences import strongest_sentence
from crankorder.report.style import (
    INK,
    LARGE,
    MAINS,
    MAINS_ON_MAP,
    MAP,
    MODE,
    MODE_ON_MAP,
    NOT_MEASURED,
    NOTE,
    SMALL,
    axes_at,
    drawable,
    house_style,
    new_figure,
    quality_note,
    shortened,
    title_lines,
    write,
)
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _RIGHT, _TOP = 0.95, 0.92, 1.75, 1.22  # margins of the diagram in inches
_LEAST_RANGE_DB = 20.0  # a colour scale spans at least this, so that noise alone looks like noise


def campbell_figure(
    campbell: xr.Dataset, channel: str, findings: dict[str, Any], *, settings: ReportSettings
) -> Figure:
    """Campbell diagram of one channel, ready for :func:`crankorder.report.figures.png_bytes`.

    Speed [rpm] upwards, frequency [Hz] to the right, level in dB (reference on the colour bar) as colour; steps of
    speed reach half-way to their neighbours. Found orders are thin lines labelled where they leave the diagram,
    natural frequencies dashed lines labelled at the top, mains dotted, excited crossings circles.

    ``campbell`` a CampbellMap; ``channel`` one of its channels; ``findings`` of the same test; ``settings`` of the
    report. Raises KeyError for an unknown channel.
    """
    with house_style():
        figure = new_figure(settings.width_in, settings.height_in)
        box = (_LEFT, _BOTTOM, settings.width_in - _LEFT - _RIGHT, settings.height_in - _BOTTOM - _TOP)
        axes = axes_at(figure, *box)
        one = campbell.sel(channel=channel).dropna("speed", how="all", subset=["amplitude"]).sortby("speed")
        _draw_map(axes, one, box, settings=settings)
        orders = orders_of(findings, channel, limit=settings.max_labelled_orders)
        modes = [mode for mode in findings.get("modes", []) if is_number(mode.get("frequency_hz"))]
        _draw_orders(axes, orders)
        _draw_modes(axes, modes)
        circles = _draw_crossings(axes, findings, channel)
        _label_edges(axes, box, orders, modes)
        _legend(figure, orders=bool(orders), modes=modes, circles=circles)
        _title(figure, findings, channel, settings=settings)
        return figure


def orders_of(findings: dict[str, Any], channel: str, *, limit: int) -> list[dict[str, Any]]:
    """Order records of a ``channel`` in ``findings``, the ``limit`` strongest, by order."""
    records = [record for record in findings.get("orders", []) if record.get("channel") == channel]
    records.sort(key=lambda record: -float(record.get("amplitude") or 0))
    return sorted(records[:limit], key=lambda record: float(record["order"]))


def _level_limits(one: xr.Dataset, *, settings: ReportSettings) -> tuple[float, float]:
    """Ends of the colour scale [dB]: the strongest line; the quietest twentieth of the map or the greatest range."""
    values = one["amplitude"].values
    values = values[np.isfinite(values) & (values > 0)]
    if not len(values):
        return 0.0, settings.dynamic_range_db
    reference, _ = level_reference(str(one["quantity"].item()), str(one["unit"].item()), settings=settings)
    ends = 5 * np.array(
        [np.floor(_level(np.quantile(values, 0.05), reference) / 5), np.ceil(_level(values.max(), reference) / 5)]
    )
    low = max(float(ends[0]), float(ends[1]) - settings.dynamic_range_db)
    return min(low, float(ends[1]) - _LEAST_RANGE_DB), float(ends[1])


def _level(values: Any, reference: float) -> Any:
    return 20 * np.log10(np.maximum(values / reference, 1e-300))


def _draw_map(axes: Axes, one: xr.Dataset, box: tuple[float, float, float, float], *, settings: ReportSettings) -> None:
    frequency, cells = one["frequency"].values, speed_cells(one["speed"].values)
    amplitude = np.nan_to_num(one["amplitude"].transpose("speed", "frequency").values)
    values, edges = cells_with_gaps(amplitude, cells)
    half = (frequency[1] - frequency[0]) / 2 if len(frequency) > 1 else 0.5
    bins = np.concatenate([frequency - half, [frequency[-1] + half]])
    left, right, low, high = (float(end) for end in (frequency[0], frequency[-1], edges[0], edges[-1]))
    columns, rows = round(box[2] * settings.dpi), round(box[3] * settings.dpi)
    pooled = pixel_maximum(values, bins, (left, right), n=min(columns, 4 * len(frequency)), axis=1)
    pooled = pixel_maximum(pooled, edges, (low, high), n=rows, axis=0)
    reference, unit = level_reference(str(one["quantity"].item()), str(one["unit"].item()), settings=settings)
    limits = _level_limits(one, settings=settings)
    level: Any = _level(pooled, reference).astype(np.float32)
    if np.any(pooled < 0):  # a mask doubles the time to draw
        level = np.ma.masked_where(pooled < 0, level)
    image = axes.imshow(
        level, extent=(left, right, low, high), origin="lower",
        aspect="auto", interpolation="nearest", cmap=MAP, vmin=limits[0], vmax=limits[1],
    )  # fmt: skip
    axes.set_facecolor(NOT_MEASURED)
    axes.set_xlabel("Frequency, Hz")
    axes.set_ylabel("Speed, rpm")
    axes.tick_params(length=3)
    axes.autoscale(False)
    for start, end in gaps_between(cells):
        if (end - start) * box[3] > 0.3 * (high - low):
            axes.text((left + right) / 2, (start + end) / 2, "not measured", **NOTE)
    if not np.any(pooled > 0):
        axes.text(0.5, 0.5, "no signal: every value is zero", transform=axes.transAxes, **NOTE)
    _colour_bar(axes, image, limits, unit, box)


def _colour_bar(
    axes: Axes, image: AxesImage, limits: tuple[float, float], unit: str, box: tuple[float, float, float, float]
) -> None:
    figure = axes.figure
    assert isinstance(figure, Figure)
    bar = figure.colorbar(image, cax=axes_at(figure, box[0] + box[2] + 0.62, box[1], 0.17, box[3]))
    bar.set_ticks(np.arange(10 * np.ceil(limits[0] / 10), limits[1] + 0.1, 10).tolist())
    bar.set_label(f"Level, {unit}", parse_math=False)
    bar.ax.tick_params(length=3)
    bar.outline.set_linewidth(0.5)


def _draw_orders(axes: Axes, orders: list[dict[str, Any]]) -> None:
    low, high = axes.get_ylim()
    for record in orders:
        order = float(record["order"])
        span = record.get("speed_range_rpm") or [low, high]
        seen = np.clip(np.array([span[0], span[1]], dtype=float), low, high)
        everywhere = np.array([low, high])
        look: dict[str, Any] = {"color": "white", "linewidth": 0.7, "gid": f"order-{order_text(nominal_order(record))}"}
        axes.plot(order * everywhere / 60, everywhere, alpha=0.22, **look)
        axes.plot(order * seen / 60, seen, alpha=0.45, **look)


def _draw_modes(axes: Axes, modes: list[dict[str, Any]]) -> None:
    for mode in modes:
        mains = is_tone(mode)
        axes.axvline(
            float(mode["frequency_hz"]), color=MAINS_ON_MAP if mains else MODE_ON_MAP, linewidth=0.8, alpha=0.75,
            linestyle=(0, (1, 2)) if mains else (0, (5, 4)), gid="tone" if mains else "mode",
        )  # fmt: skip


def _draw_crossings(axes: Axes, findings: dict[str, Any], channel: str) -> bool:
    places = [
        (float(crossing["mode_hz"]), float(crossing["rpm"]))
        for crossing in findings.get("crossings", [])
        if crossing.get("excited") and crossing.get("in_range") and channel in crossing.get("channels", [channel])
    ]
    if places:
        axes.plot(
            *zip(*places, strict=True), linestyle="none", marker="o", markersize=11, markerfacecolor="none",
            markeredgecolor="white", markeredgewidth=1.5, gid="crossings",
            path_effects=[withStroke(linewidth=3, foreground="#00000090")],
        )  # fmt: skip
    return bool(places)


def _label_edges(
    axes: Axes, box: tuple[float, float, float, float], orders: list[dict[str, Any]], modes: list[dict[str, Any]]
) -> None:
    """Orders where their lines leave the diagram, natural frequencies and tones in a tier above them."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    left, bottom, width, height = box
    top, side = _order_labels(axes, box, orders)
    f_low, f_high = axes.get_xlim()
    named = []
    for number, mode in enumerate(modes):
        frequency_hz = float(mode["frequency_hz"])
        if f_low <= frequency_hz <= f_high:
            place = left + width * (frequency_hz - f_low) / (f_high - f_low)
            text = f"{frequency_text(frequency_hz)} Hz"
            named.append(EdgeLabel(place, text, MAINS if is_tone(mode) else MODE, number))
    lines = label_top(figure, box, [fitted(top, width), fitted(named, width)])
    label_right(figure, box, side)
    look: dict[str, Any] = {"va": "bottom", "fontsize": SMALL, "color": INK}
    if top:
        write(figure, left - 0.3, lines[0], "order", ha="right", **look)
    if side:
        write(figure, left + width + 0.06, bottom + height + 0.14, "order", ha="left", **look)


def _order_labels(
    axes: Axes, box: tuple[float, float, float, float], orders: list[dict[str, Any]]
) -> tuple[list[EdgeLabel], list[EdgeLabel]]:
    """Labels of the order lines that leave at the top, and of those that leave at the right; the strongest is bold."""
    left, bottom, width, height = box
    (f_low, f_high), (low, high) = axes.get_xlim(), axes.get_ylim()
    loudest = max((float(record.get("amplitude") or 0) for record in orders), default=0.0)
    top, side = [], []
    for number, record in enumerate(orders):
        order, text = float(record["order"]), order_text(nominal_order(record))
        weight = "bold" if loudest > 0 and float(record.get("amplitude") or 0) == loudest else "normal"
        if f_low <= order * high / 60 <= f_high:
            place = left + width * (order * high / 60 - f_low) / (f_high - f_low)
            top.append(EdgeLabel(place, text, INK, number, weight))
        elif low < 60 * f_high / order < high:
            place = bottom + height * (60 * f_high / order - low) / (high - low)
            side.append(EdgeLabel(place, text, INK, number, weight))
    return top, side


def _legend(figure: Figure, *, orders: bool, modes: list[dict[str, Any]], circles: bool) -> None:
    handles = []
    dark: dict[str, Any] = {"linewidth": 1.2}
    if orders:
        handles.append(Line2D([], [], color=INK, label="order found (bold number: strongest)", **dark))
    if any(not is_tone(mode) for mode in modes):
        handles.append(Line2D([], [], color=MODE, linestyle=(0, (5, 3)), label="natural frequency", **dark))
    tones = {str(mode.get("explained_by")) for mode in modes if is_tone(mode)}
    if tones:
        label = "mains" if tones == {"mains"} else "fixed tone" if "mains" not in tones else "mains or fixed tone"
        handles.append(Line2D([], [], color=MAINS, linestyle=(0, (1, 1.5)), label=label, **dark))
    if circles:
        ring: dict[str, Any] = {"marker": "o", "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 1.4}
        handles.append(Line2D([], [], color=INK, linestyle="none", label="excited crossing", **ring))
    if handles:
        width, height = figure.get_size_inches()
        figure.legend(
            handles=handles, loc="lower left", bbox_to_anchor=(_LEFT / width, 0.12 / height), ncols=len(handles),
            frameon=False, fontsize=SMALL + 0.5, borderpad=0, borderaxespad=0, handlelength=2.6, columnspacing=2.2,
        )  # fmt: skip


def _title(figure: Figure, findings: dict[str, Any], channel: str, *, settings: ReportSettings) -> None:
    name = drawable(findings.get("test", ""), settings.max_name_characters)
    name = shortened(name, LARGE * 1.1, 0.62 * settings.width_in)
    title = f"{name} · channel {drawable(channel, settings.max_name_characters)}"
    title_lines(figure, _LEFT, title, drawable(strongest_sentence(findings, channel), 300))
    quality_note(figure, findings)
