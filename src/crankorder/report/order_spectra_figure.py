"""Order spectra of every channel: what stands out, order by order, whatever the speed."""

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
_AROUND = 0.5  # orders to each side: further than a line leaks, nearer than the next whole order


def order_spectra_figure(order_map: xr.Dataset, findings: Findings, *, settings: ReportSettings) -> Drawing:
    """Per channel how far each order stands above what surrounds it, in the mean over the speeds; found ones named.

    The largest amplitude over the speeds would bury a steady order under the natural frequencies that sweep past it.

    ``order_map`` an OrderMap, whose speeds may be unknown; ``findings`` of the same test; ``settings`` of the report.
    """
    drawing, heights = column_boxes(order_map.sizes["channel"], _LEFT, settings)
    width, above = settings.width_in - _LEFT - _RIGHT, _above_floor(order_map)
    places = [(_LEFT, bottom, width, height) for bottom, height in heights]
    times = order_map.assign(unit=("channel", ["times its floor"] * order_map.sizes["channel"]))
    panels = column_panels(drawing, places, times, "order", above, "", settings=settings)
    found = sorted({nominal_order(record) for record in findings.orders})
    for panel in panels:
        for order in found:
            panel.upright(order, color=LINES[1], width=0.7, alpha=0.5)
    draw_spectra(panels, order_map["order"].values, above)
    label_column(
        panels[0], [(order, text, LINES[1]) for order, text in zip(found, order_texts(found), strict=True)], "order"
    )
    name = drawable(findings.test, settings.max_name_characters)
    speeds = order_map.sizes["speed"]
    where = f", its mean level over {speeds} speeds" if speeds > 1 else ""
    said = f"Amplitude over the median of the orders around it{where}."
    title_lines(drawing, _LEFT, f"{name} · order spectra", said)
    quality_note(drawing, findings)
    return drawing


def _above_floor(order_map: xr.Dataset) -> NDArray[np.float64]:
    """Ratio (channels, orders) of an amplitude to the median of those around it, its mean level over the speeds.

    NaN where the rate carried the order at no speed, or nothing lies around it. The mean tells a small line that
    stands at every speed from noise, which the largest over many speeds does not.
    """
    amplitude = order_map["amplitude"].transpose("channel", "speed", "order").values.astype(np.float64)
    order = order_map["order"].values
    step = float(order[1] - order[0]) if len(order) > 1 else 1.0
    reach = max(round(_AROUND / step), 1)
    beside = np.pad(amplitude, ((0, 0), (0, 0), (reach, reach)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(beside, 2 * reach + 1, axis=-1)
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # orders that no speed carries have no median
        level = np.log(amplitude / np.nanmedian(windows, axis=-1))
        mean = np.nanmean(np.where(np.isfinite(level), level, np.nan), axis=1)
        return np.asarray(np.exp(mean), dtype=np.float64)
