"""Order spectra of every channel: what shakes, order by order, whatever the speed."""

from __future__ import annotations

import warnings

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.findings import Findings
from crankorder.plot.drawing import Drawing, quality_note, title_lines
from crankorder.plot.palette import LINES
from crankorder.plot.typeface import drawable
from crankorder.report.notation import nominal_order, order_texts
from crankorder.report.spectra_figure import column_boxes, column_panels, draw_spectra, label_column
from crankorder.settings import ReportSettings

_LEFT, _RIGHT = 1.0, 0.3  # inches


def order_spectra_figure(order_map: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Per channel the largest peak amplitude that each order reaches at any speed, found orders named above.

    ``order_map`` an OrderMap, whose speeds may be unknown; ``findings`` of the same test; ``settings`` of the report.
    """
    drawing, heights = column_boxes(order_map.sizes["channel"], _LEFT, settings)
    width, largest = settings.width_in - _LEFT - _RIGHT, _largest(order_map)
    places = [(_LEFT, bottom, width, height) for bottom, height in heights]
    panels = column_panels(drawing, places, order_map, "order", largest, " (peak)", settings=settings)
    found = sorted({nominal_order(record) for record in findings.orders})
    for panel in panels:
        for order in found:
            panel.upright(order, color=LINES[1], width=0.7, alpha=0.5)
    draw_spectra(panels, order_map["order"].values, largest)
    label_column(
        panels[0], [(order, text, LINES[1]) for order, text in zip(found, order_texts(found), strict=True)], "order"
    )
    name = drawable(findings.test, settings.max_name_characters)
    speeds = order_map.sizes["speed"]
    said = f"Largest amplitude at any of {speeds} speeds." if speeds > 1 else "Amplitude by order."
    title_lines(drawing, _LEFT, f"{name} · order spectra", said)
    quality_note(drawing, findings)
    return drawing


def _largest(order_map: xr.Dataset) -> NDArray[np.float64]:
    """Largest amplitude (channels, orders) over the speeds; NaN where the rate carried the order at none."""
    amplitude = order_map["amplitude"].transpose("channel", "speed", "order").values
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an order that no speed carries has no largest amplitude
        return np.asarray(np.nanmax(amplitude, axis=1), dtype=np.float64)
