"""The files of one test: NetCDF, JSON, pictures and page, as bytes, ready to be published."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from crankorder.batch.plan import folder_name
from crankorder.batch.store import json_bytes
from crankorder.batch.workers import FORKS, each
from crankorder.report.netcdf import as_stored, findings_datasets, results_bytes
from crankorder.report.page import report_page
from crankorder.settings import ReportSettings

Drawing = tuple[str, str, Callable[[], bytes]]
"""File name, caption, and the call that gives the PNG."""


def pictures(
    groups: dict[str, xr.Dataset], findings: dict[str, Any], settings: ReportSettings, *, jobs: int = 1
) -> dict[str, tuple[bytes, str]]:
    """PNG and caption of every picture by file name, from ``groups`` and ``findings``, drawn by ``settings``.

    ``jobs`` pictures are drawn at a time, each in a process of its own where there are more than one.
    """
    drawings = _drawings(as_stored(groups), findings, settings)
    if jobs == 1 or not FORKS:  # what draws is not safe in threads
        return {name: (draw(), caption) for name, caption, draw in drawings}
    drawn = {number: made() for number, made in each(lambda number: drawings[number][2](), len(drawings), jobs=jobs)}
    return {name: (drawn[number], caption) for number, (name, caption, _) in enumerate(drawings)}


def _drawings(groups: dict[str, xr.Dataset], findings: dict[str, Any], settings: ReportSettings) -> list[Drawing]:
    """What can be drawn of ``groups``, in the order of the page."""
    from crankorder.report import figures

    campbell, tracks, orders = (groups.get(name) for name in ("campbell_map", "order_tracks", "order_map"))

    def png(made: Callable[..., Any], *given: Any) -> Callable[[], bytes]:
        return lambda: figures.png_bytes(made(*given, findings, settings=settings), dpi=settings.dpi)

    drawings: list[Drawing] = []
    taken: set[str] = set()
    shown = campbell is not None and bool(campbell.sizes["speed"])
    if campbell is not None and shown:
        for channel in campbell["channel"].values.tolist():
            name = f"campbell_{folder_name(channel, taken)}.png"
            drawings.append((name, f"Campbell diagram, {channel}", png(figures.campbell_figure, campbell, channel)))
    if tracks is not None and tracks.sizes["order"] and np.isfinite(tracks["speed"].values).all():
        caption = "Orders against speed: amplitude and phase"
        drawings.append(("orders.png", caption, png(figures.orders_figure, tracks)))
    if orders is not None:
        caption = "Order spectra: what shakes, order by order"
        drawings.append(("order_spectra.png", caption, png(figures.order_spectra_figure, orders)))
    if shown:
        caption = "Spectra: what stays and what moves with speed"
        drawings.append(("spectra.png", caption, png(figures.spectra_figure, campbell)))
    return drawings


def files_of_test(
    groups: dict[str, xr.Dataset],
    findings: dict[str, Any],
    provenance: dict[str, Any],
    *,
    drawn: Callable[[], dict[str, tuple[bytes, str]]],
    settings: ReportSettings,
) -> dict[str, bytes]:
    """All files of a test by name: results.nc, findings.json, pictures, report.html, run.json.

    ``groups`` are the datasets by group name, ``findings`` what they say, ``provenance`` what ``run.json`` states;
    ``drawn`` gives the pictures when everything else is made (see :func:`pictures`); ``settings`` shape the page.
    """
    attrs = {"title": str(findings["test"]), "source": f"crankorder {provenance['versions']['crankorder']}"}
    data = {
        "results.nc": results_bytes({**groups, **findings_datasets(findings)}, attrs=attrs),
        "findings.json": json_bytes(findings),
    }
    run = json_bytes(provenance)
    made = drawn()
    captions = [(name, caption) for name, (_, caption) in made.items()]
    page = report_page(findings, pictures=captions, provenance=provenance, settings=settings)
    return {
        **data,
        **{name: png for name, (png, _) in made.items()},
        "report.html": page.encode("utf-8", "backslashreplace"),
        "run.json": run,
    }
