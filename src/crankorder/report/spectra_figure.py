"""Spectra of every channel: over all speeds with the natural frequencies, at the highest speed with the orders."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from crankorder.report.labels import EdgeLabel, fitted, label_top
from crankorder.report.notation import frequency_text, is_number, is_tone, nominal_order, order_text, unit_text
from crankorder.report.style import (
    INK,
    LINES,
    MAINS,
    MODE,
    NORMAL,
    NOTE,
    SMALL,
    axes_at,
    drawable,
    house_style,
    log_scale,
    new_figure,
    quality_note,
    quiet_frame,
    shortened,
    title_lines,
    write,
)
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _TOP, _BETWEEN, _RIGHT, _ROW_GAP = 1.0, 0.92, 1.06, 0.95, 0.3, 0.16  # inches
_LEAST_ROW = 1.2  # a row of panels is never lower than this
_DECADES = 7.0  # shown below the strongest line


def spectra_figure(campbell: xr.Dataset, findings: dict[str, Any], *, settings: ReportSettings) -> Figure:
    """Per channel the median power spectral density over all speeds, and the peak spectrum at the highest speed.

    Natural frequencies are marked and named over the left column, orders over the right one. ``campbell`` a
    CampbellMap; ``findings`` of the same test; ``settings`` of the report.
    """
    with house_style():
        campbell = campbell.sortby("speed")
        n = campbell.sizes["channel"]
        row = max((settings.height_in - _BOTTOM - _TOP - (n - 1) * _ROW_GAP) / n, _LEAST_ROW)
        figure = new_figure(settings.width_in, _TOP + _BOTTOM + n * row + (n - 1) * _ROW_GAP)
        width = (settings.width_in - _LEFT - _BETWEEN - _RIGHT) / 2
        boxes = [_BOTTOM + (n - 1 - k) * (row + _ROW_GAP) for k in range(n)]
        left = [axes_at(figure, _LEFT, bottom, width, row) for bottom in boxes]
        right = [axes_at(figure, _LEFT + width + _BETWEEN, bottom, width, row) for bottom in boxes]
        rpm = float(campbell["speed"].values[-1])
        draw_column(left, campbell, "frequency", _median_psd(campbell), "²/Hz", settings=settings)
        draw_column(
            right, campbell, "frequency", campbell["amplitude"].isel(speed=-1).values, " (peak)", settings=settings
        )
        modes = _mark_modes(left, findings)
        orders = _mark_orders(right, campbell, findings, rpm, limit=settings.max_labelled_orders)
        top = boxes[0], row
        label_column(figure, (_LEFT, top[0], width, top[1]), left[0], modes, "")
        label_column(figure, (_LEFT + width + _BETWEEN, top[0], width, top[1]), right[0], orders, "order")
        name = drawable(findings.get("test", ""), settings.max_name_characters)
        title_lines(figure, _LEFT, f"{name} · spectra", _subtitle(campbell.sizes["speed"], rpm))
        quality_note(figure, findings)
        return figure


def _subtitle(n_speeds: int, rpm: float) -> str:
    left = f"median over {n_speeds} speeds" if n_speeds > 1 else "the one speed"
    which = "highest speed" if n_speeds > 1 else "same speed"
    left = f"Left: power spectral density, {left}, with natural frequencies."
    return f"{left} Right: peak amplitude, {which}, {rpm:.0f} rpm, with orders."


def _median_psd(campbell: xr.Dataset) -> NDArray[np.float64]:
    """Median over speeds: lines that move with speed vanish, what stays put remains."""
    return np.asarray(np.median(campbell["psd"].transpose("channel", "speed", "frequency").values, axis=1), dtype=float)


def draw_column(
    panels: list[Axes],
    dataset: xr.Dataset,
    along: str,
    values: NDArray[Any],
    unit_tail: str,
    *,
    settings: ReportSettings,
) -> None:
    """Draw ``values`` (channels, bins) of ``dataset``, one of ``panels`` per channel, on logarithmic axes.

    ``along`` is the axis of the bins: "frequency" or "order"; ``unit_tail`` follows each channel's unit; ``settings``
    cut long names.
    """
    place, units = dataset[along].values, dataset["unit"].values.astype(str)
    height_in = float(panels[0].get_position().height * panels[0].figure.get_size_inches()[1])  # type: ignore[union-attr]
    for number, axes in enumerate(panels):
        quiet_frame(axes)
        own = values[number]
        alike = values[units == units[number]]
        axes.set_xlim(float(place[0]), float(place[-1]))
        _log_axis(axes, alike)
        if np.any(own > 0):
            axes.plot(place, np.where(own > 0, own, np.nan), color=INK, linewidth=0.8, gid="spectrum")
        else:
            axes.text(0.5, 0.5, "no signal", transform=axes.transAxes, **NOTE)
        axes.tick_params(labelbottom=axes is panels[-1])
        name = shortened(drawable(dataset["channel"].values[number], settings.max_name_characters), NORMAL, height_in)
        unit = drawable(unit_text(units[number]), 24)
        squared = f"({unit})" if "²/Hz" in unit_tail and "/" in unit else unit
        axes.set_ylabel(f"{name}\n{squared}{unit_tail}", parse_math=False, labelpad=3)
    panels[-1].set_xlabel("Frequency, Hz" if along == "frequency" else "Order (cycles per crank revolution)")


def _log_axis(axes: Axes, values: NDArray[Any]) -> None:
    positive = values[np.isfinite(values) & (values > 0)]
    if not len(positive):
        axes.set_yticks([])
        return
    top, quiet = float(positive.max()), float(np.quantile(positive, 0.01))
    log_scale(axes, max(quiet / 2, top * 10**-_DECADES), 2.5 * top, most_ticks=6)


def _mark_modes(panels: list[Axes], findings: dict[str, Any]) -> list[tuple[float, str, str]]:
    modes = [mode for mode in findings.get("modes", []) if is_number(mode.get("frequency_hz"))]
    for axes in panels:
        for mode in modes:
            look: dict[str, Any] = {
                "color": MAINS if is_tone(mode) else MODE,
                "linestyle": (0, (1, 2) if is_tone(mode) else (5, 4)),
            }
            axes.axvline(float(mode["frequency_hz"]), linewidth=0.8, alpha=0.7, zorder=0.8, **look)
    return [
        (
            float(mode["frequency_hz"]),
            f"{frequency_text(float(mode['frequency_hz']))} Hz",
            MAINS if is_tone(mode) else MODE,
        )
        for mode in modes
    ]


def _mark_orders(
    panels: list[Axes], campbell: xr.Dataset, findings: dict[str, Any], rpm: float, *, limit: int
) -> list[tuple[float, str, str]]:
    strength: dict[float, float] = {}
    found: set[tuple[str, float]] = set()
    for record in findings.get("orders", []):
        order = nominal_order(record)
        strength[order] = max(strength.get(order, 0.0), float(record.get("amplitude") or 0))
        found.add((str(record.get("channel")), order))
    kept = sorted(sorted(strength, key=lambda order: -strength[order])[:limit])
    for axes, channel in zip(panels, campbell["channel"].values.astype(str), strict=True):
        for order in kept:
            alpha = 0.55 if (channel, order) in found else 0.2
            axes.axvline(
                order * rpm / 60,
                color=LINES[1],
                linewidth=0.7,
                alpha=alpha,
                zorder=0.8,
                gid=f"order-{order_text(order)}",
            )
    return [(order * rpm / 60, order_text(order), LINES[1]) for order in kept]


def label_column(
    figure: Figure,
    box: tuple[float, float, float, float],
    axes: Axes,
    marks: list[tuple[float, str, str]],
    caption: str,
) -> None:
    """Write ``marks`` (place, text, colour) over the panel ``axes`` of ``figure``, which fills ``box`` (inches).

    ``caption`` stands before them: what the marks are.
    """
    low, high = axes.get_xlim()
    labels = [
        EdgeLabel(box[0] + box[2] * (place - low) / (high - low), text, color, number)
        for number, (place, text, color) in enumerate(marks)
        if low <= place <= high
    ]
    lines = label_top(figure, box, [fitted(labels, box[2])])
    if labels and caption:
        write(figure, box[0] - 0.25, lines[0], caption, ha="right", va="bottom", fontsize=SMALL, color=LINES[1])
