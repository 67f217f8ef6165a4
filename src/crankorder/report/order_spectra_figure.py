"""Order spectra of every channel: what shakes, order by order, whatever the speed."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from crankorder.report.notation import nominal_order, order_text
from crankorder.report.spectra_figure import draw_column, label_column
from crankorder.report.style import LINES, axes_at, drawable, house_style, new_figure, quality_note, title_lines
from crankorder.settings import ReportSettings

_LEFT, _BOTTOM, _TOP, _RIGHT, _ROW_GAP = 1.0, 0.7, 1.06, 0.3, 0.16  # inches
_LEAST_ROW = 1.2  # a row of panels is never lower than this


def order_spectra_figure(order_map: xr.Dataset, findings: dict[str, Any], *, settings: ReportSettings) -> Figure:
    """Per channel the largest peak amplitude that each order reaches at any speed, found orders named above.

    ``order_map`` an OrderMap, whose speeds may be unknown; ``findings`` of the same test; ``settings`` of the report.
    """
    with house_style():
        n = order_map.sizes["channel"]
        row = max((settings.height_in - _BOTTOM - _TOP - (n - 1) * _ROW_GAP) / n, _LEAST_ROW)
        figure = new_figure(settings.width_in, _TOP + _BOTTOM + n * row + (n - 1) * _ROW_GAP)
        width = settings.width_in - _LEFT - _RIGHT
        boxes = [_BOTTOM + (n - 1 - k) * (row + _ROW_GAP) for k in range(n)]
        panels = [axes_at(figure, _LEFT, bottom, width, row) for bottom in boxes]
        draw_column(panels, order_map, "order", _largest(order_map), " (peak)", settings=settings)
        found = sorted({nominal_order(record) for record in findings.get("orders", [])})
        for axes in panels:
            for order in found:
                axes.axvline(order, color=LINES[1], linewidth=0.7, alpha=0.5, zorder=0.8)
        marks = [(order, order_text(order), LINES[1]) for order in found]
        label_column(figure, (_LEFT, boxes[0], width, row), panels[0], marks, "order")
        name = drawable(findings.get("test", ""), settings.max_name_characters)
        speeds = order_map.sizes["speed"]
        said = f"Largest amplitude at any of {speeds} speeds." if speeds > 1 else "Amplitude by order."
        title_lines(figure, _LEFT, f"{name} · order spectra", said)
        quality_note(figure, findings)
        return figure


def _largest(order_map: xr.Dataset) -> NDArray[np.float64]:
    """Largest amplitude (channels, orders) over the speeds; NaN where the rate carried the order at none."""
    amplitude = order_map["amplitude"].transpose("channel", "speed", "order").values
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an order that no speed carries has no largest amplitude
        return np.asarray(np.nanmax(amplitude, axis=1), dtype=np.float64)
