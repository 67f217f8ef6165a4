"""The files of one test: NetCDF, JSON, pictures and page, as bytes, ready to be published."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from crankorder.batch.plan import folder_name
from crankorder.batch.store import json_bytes
from crankorder.report.figures import (
    campbell_figure,
    order_spectra_figure,
    orders_figure,
    png_bytes,
    spectra_figure,
)
from crankorder.report.netcdf import as_stored, findings_datasets, results_bytes
from crankorder.report.page import report_page
from crankorder.settings import ReportSettings


def pictures(
    groups: dict[str, xr.Dataset], findings: dict[str, Any], *, settings: ReportSettings
) -> dict[str, tuple[bytes, str]]:
    """PNG and caption of every picture by file name, from ``groups`` and ``findings``, drawn by ``settings``."""
    campbell, tracks = groups["campbell_map"], groups["order_tracks"]
    made: dict[str, tuple[bytes, str]] = {}
    taken: set[str] = set()
    if campbell.sizes["speed"]:
        for channel in campbell["channel"].values.tolist():
            figure = campbell_figure(campbell, channel, findings, settings=settings)
            name = f"campbell_{folder_name(channel, taken)}.png"
            made[name] = (png_bytes(figure, dpi=settings.dpi), f"Campbell diagram, {channel}")
    if tracks.sizes["order"] and np.isfinite(tracks["speed"].values).all():
        figure = orders_figure(tracks, findings, settings=settings)
        made["orders.png"] = (png_bytes(figure, dpi=settings.dpi), "Orders against speed: amplitude and phase")
    figure = order_spectra_figure(groups["order_map"], findings, settings=settings)
    made["order_spectra.png"] = (png_bytes(figure, dpi=settings.dpi), "Order spectra: what shakes, order by order")
    if campbell.sizes["speed"]:
        figure = spectra_figure(campbell, findings, settings=settings)
        made["spectra.png"] = (png_bytes(figure, dpi=settings.dpi), "Spectra: what stays and what moves with speed")
    return made


def files_of_test(
    groups: dict[str, xr.Dataset],
    findings: dict[str, Any],
    provenance: dict[str, Any],
    *,
    settings: ReportSettings,
) -> dict[str, bytes]:
    """All files of a test by name: results.nc, findings.json, pictures, report.html, run.json.

    ``groups`` are the datasets by group name, ``findings`` what they say, ``provenance`` what ``run.json`` states;
    ``settings`` shape pictures and page.
    """
    drawn = pictures(as_stored(groups), findings, settings=settings)
    captions = [(name, caption) for name, (_, caption) in drawn.items()]
    page = report_page(findings, pictures=captions, provenance=provenance, settings=settings)
    attrs = {"title": str(findings["test"]), "source": f"crankorder {provenance['versions']['crankorder']}"}
    return {
        "results.nc": results_bytes({**groups, **findings_datasets(findings)}, attrs=attrs),
        "findings.json": json_bytes(findings),
        **{name: png for name, (png, _) in drawn.items()},
        "report.html": page.encode("utf-8", "backslashreplace"),
        "run.json": json_bytes(provenance),
    }
