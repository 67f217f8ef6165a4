"""Amplitude and phase of the orders against speed, one column of panels per channel."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator
from numpy.typing import NDArray

from crankorder.report.cells import gaps_between, speed_cells
from crankorder.report.labels import EdgeLabel, label_right
from crankorder.report.notation import nominal_order, order_text, unit_text
from crankorder.report.style import (
    BAND_FACTOR,
    FAINT,
    INK,
    NORMAL,
    NOTE,
    SMALL,
    axes_at,
    drawable,
    house_style,
    line_look,
    log_scale,
    new_figure,
    quality_note,
    quiet_frame,
    shortened,
    title_lines,
    write,
)
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _TOP, _GUTTER = 1.0, 0.92, 0.98, 0.95  # margins in inches; the gutter holds labels and the next axis
_COLUMNS = 4
_LOG_RATIO = 15.0  # orders whose largest amplitudes differ by more than this need a logarithmic axis
_CLEAR = 3.0  # standard errors above zero from which a line is drawn; its phase means nothing below
_WITHOUT_MARKERS = 60  # more speeds than this are a curve, not points
_PHASE_OF = {
    "tdc": "Phase from top dead centre, °",
    "index": "Phase from the index mark, °",
    "pulse": "Phase from the first pulse, °",
    "mixed": "Phase (references differ), °",
}


def orders_figure(tracks: xr.Dataset, findings: dict[str, Any], *, settings: ReportSettings) -> Figure:
    """Peak amplitude with its 95 % band, and phase, of the strongest orders against speed, for every channel.

    Each line is labelled with its order at its right end. The axis is logarithmic where the orders differ much;
    channels of one unit share it. ``tracks`` an OrderTracks; ``findings`` of the same test; ``settings`` of the report.
    """
    with house_style():
        channels = [str(name) for name in tracks["channel"].values]
        columns = min(len(channels), _COLUMNS)
        rows = -(-len(channels) // columns)
        block = settings.height_in - _BOTTOM - _TOP
        figure = new_figure(settings.width_in, _TOP + rows * (block + _BOTTOM))
        tracks = tracks.sortby("speed")
        orders = _strongest(tracks, limit=settings.max_labelled_orders)
        for number, channel in enumerate(channels):
            width = (settings.width_in - _LEFT - columns * _GUTTER + 0.25) / columns
            left = _LEFT + (number % columns) * (width + _GUTTER)
            bottom = _BOTTOM + (rows - 1 - number // columns) * (block + _BOTTOM)
            _draw_channel(figure, tracks, channel, orders, (left, bottom, width, block), settings=settings)
        title = f"{drawable(findings.get('test', ''), settings.max_name_characters)} · orders against speed"
        title_lines(figure, _LEFT, title, _subtitle(tracks, len(orders)))
        quality_note(figure, findings)
        return figure


def _strongest(tracks: xr.Dataset, *, limit: int) -> list[float]:
    """Orders by their largest amplitude relative to their channel's largest; the ``limit`` first, ascending."""
    peak = np.nanmax(
        np.nan_to_num(tracks["amplitude"].transpose("channel", "order", "speed").values), axis=2, initial=0.0
    )
    share = (peak / np.maximum(peak.max(axis=1, initial=0.0, keepdims=True), 1e-300)).max(axis=0, initial=0.0)
    kept = np.argsort(-share, kind="stable")[:limit]
    return sorted(float(order) for order in tracks["order"].values[kept])


def _subtitle(tracks: xr.Dataset, shown: int) -> str:
    many = f"The {shown} strongest of {tracks.sizes['order']} orders. " if shown < tracks.sizes["order"] else ""
    if not shown:
        return "No order was found."
    colour = " in the colours of their lines" if shown > 1 else ""
    return (
        f"{many}Peak amplitude with 95 % band, drawn where it exceeds 3 standard errors; orders at the right{colour}."
    )


def _draw_channel(
    figure: Figure,
    tracks: xr.Dataset,
    channel: str,
    orders: list[float],
    box: tuple[float, float, float, float],
    *,
    settings: ReportSettings,
) -> None:
    left, bottom, width, height = box
    phase_height = 0.3 * height
    upper_box = (left, bottom + phase_height + 0.22, width, height - phase_height - 0.22)
    upper, lower = axes_at(figure, *upper_box), axes_at(figure, left, bottom, width, phase_height)
    one = tracks.sel(channel=channel)
    unit = str(one["unit"].item())
    alike = tracks.isel(channel=np.flatnonzero(tracks["unit"].values == unit))
    with_phase = str(tracks.attrs.get("phase_reference", "none")) in _PHASE_OF
    for number, order in enumerate(orders):
        line = one.sel(order=order)
        _draw_line(upper, line, line_look(number), order)
        if with_phase:
            _draw_phase(lower, line, line_look(number))
    logarithmic = _scale(upper, alike.sel(order=orders))
    _speed_axes(upper, lower, one["speed"].values, width)
    _phase_axes(lower, str(tracks.attrs.get("phase_reference", "none")), first=left == _LEFT)
    name = shortened(drawable(channel, settings.max_name_characters), NORMAL + 1, width)
    write(figure, left, upper_box[1] + upper_box[3] + 0.07, name, fontsize=NORMAL + 1, fontweight="bold")
    if left == _LEFT or unit != str(tracks["unit"].values[0]):
        upper.set_ylabel(f"Amplitude (peak), {drawable(unit_text(unit), 24)}", parse_math=False)
    _label_lines(figure, upper, upper_box, one, orders, logarithmic=logarithmic)


def _sure(line: xr.Dataset) -> NDArray[np.bool_]:
    """Where a line stands clear of its noise (an unknown error counts as clear)."""
    return np.asarray(
        (line["amplitude"].values > 0) & ~(line["amplitude"].values < _CLEAR * line["standard_error"].values)
    )


def _broken(speed: NDArray[np.float64], values: NDArray[np.float64], *, wrap: float = np.inf) -> NDArray[np.intp]:
    """Places before which a curve must break: gaps of the tested range, and jumps of more than ``wrap``."""
    starts = {high for _, high in gaps_between(speed_cells(speed))}
    gap = np.isin(speed_cells(speed)[1:, 0], sorted(starts))
    jump = np.array([abs(two - one) > wrap for one, two in pairwise(values)], dtype=bool)
    return np.asarray(np.flatnonzero(gap | jump) + 1)


def _draw_line(axes: Axes, line: xr.Dataset, look: dict[str, Any], order: float) -> None:
    speed = line["speed"].values
    amplitude = np.where(_sure(line), line["amplitude"].values, np.nan)
    reach = np.nan_to_num(BAND_FACTOR * line["standard_error"].values)
    size: dict[str, Any] = {"markersize": 2.4 if len(speed) <= _WITHOUT_MARKERS else 0}
    if len(speed) == 1:
        axes.errorbar(speed, amplitude, yerr=reach, color=look["color"], capsize=3, linewidth=1)
    breaks = _broken(speed, amplitude)
    speed, amplitude, reach = (np.insert(values, breaks, np.nan) for values in (speed, amplitude, reach))
    axes.fill_between(
        speed, np.maximum(amplitude - reach, 0), amplitude + reach, color=look["color"], alpha=0.22, linewidth=0
    )
    axes.plot(speed, amplitude, gid=f"order-{order_text(nominal_order(order))}", **look, **size)


def _draw_phase(axes: Axes, line: xr.Dataset, look: dict[str, Any]) -> None:
    """Phase where the line stands clear of its noise, broken where it wraps."""
    phase = (np.where(_sure(line), line["phase"].values, np.nan) + 180) % 360 - 180
    speed = line["speed"].values
    size: dict[str, Any] = {"markersize": 2.0 if len(speed) <= _WITHOUT_MARKERS else 0}
    breaks = _broken(speed, phase, wrap=180)
    axes.plot(np.insert(speed, breaks, np.nan), np.insert(phase, breaks, np.nan), **look | {"linewidth": 0.8}, **size)


def _scale(axes: Axes, alike: xr.Dataset) -> bool:
    """Set the amplitude axis from all channels of the unit; True where it became logarithmic."""
    clear = np.where(_sure(alike), alike["amplitude"].values, np.nan)
    if not np.any(np.isfinite(clear)):
        axes.set_ylim(0, 1)
        axes.set_yticks([])
        return False
    peaks = np.nanmax(np.nan_to_num(clear), axis=alike["amplitude"].dims.index("speed"))
    top = float(peaks.max())
    if top < _LOG_RATIO * float(peaks[peaks > 0].min()):
        axes.set_ylim(0, 1.08 * top)
        axes.yaxis.set_major_locator(MaxNLocator(6))
        return False
    log_scale(axes, max(float(np.nanquantile(clear, 0.005)) / 1.5, 1e-6 * top), 1.6 * top, most_ticks=8)
    return True


def _speed_axes(upper: Axes, lower: Axes, speed: NDArray[np.float64], width_in: float) -> None:
    low, high = float(speed[0]), float(speed[-1])
    margin = 0.03 * (high - low) if high > low else max(0.05 * abs(low), 1.0)
    for axes in (upper, lower):
        quiet_frame(axes)
        axes.set_xlim(low - margin, high + (0 if high > low else margin))
        axes.xaxis.set_major_locator(MaxNLocator(int(np.clip(1.5 * width_in, 3, 10)), integer=True))
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("Speed, rpm")


def _phase_axes(axes: Axes, reference: str, *, first: bool) -> None:
    axes.set_ylim(-190, 190)
    axes.yaxis.set_major_locator(FixedLocator([-180, -90, 0, 90, 180]))
    if first:
        axes.set_ylabel("\n".join(_PHASE_OF.get(reference, "Phase").replace(" from", "\nfrom").split("\n")), color=INK)
    if reference not in _PHASE_OF:
        axes.text(0.5, 0.5, "no phase reference", transform=axes.transAxes, **NOTE)


def _label_lines(
    figure: Figure,
    axes: Axes,
    box: tuple[float, float, float, float],
    one: xr.Dataset,
    orders: list[float],
    *,
    logarithmic: bool,
) -> None:
    low, high = axes.get_ylim()
    labels = []
    for number, order in enumerate(orders):
        line = one.sel(order=order)
        known = line["amplitude"].values[_sure(line)]
        if not len(known):
            continue
        value = float(np.clip(known[-1], low, high))
        share = np.log(value / low) / np.log(high / low) if logarithmic else (value - low) / (high - low)
        labels.append(
            EdgeLabel(
                box[1] + box[3] * float(share), order_text(nominal_order(order)), line_look(number)["color"], number
            )
        )
    label_right(figure, box, labels)
    if not labels:
        axes.text(0.5, 0.5, "no order stands clear\nof the noise", transform=axes.transAxes, **NOTE)
    else:
        write(figure, box[0] + box[2] + 0.1, box[1] + box[3] + 0.09, "order", fontsize=SMALL, color=FAINT)
