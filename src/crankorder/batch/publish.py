"""The files of one test: NetCDF, JSON, pictures and page, as bytes, ready to be published."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import xarray as xr

from crankorder.batch.plan import folder_name
from crankorder.batch.store import json_bytes
from crankorder.batch.workers import FORKS, each
from crankorder.report.netcdf import as_stored, findings_datasets, results_bytes
from crankorder.report.page import report_page
from crankorder.settings import ReportSettings


def pictures(
    groups: dict[str, xr.Dataset], findings: dict[str, Any], settings: ReportSettings, *, jobs: int = 1
) -> dict[str, tuple[bytes, str]]:
    """PNG and caption of every picture by file name, from ``groups`` and ``findings``, drawn by ``settings``.

    ``jobs`` pictures are drawn at a time, each in a process of its own where there are more than one.
    """
    from crankorder.report.pictures import pictures_of

    taken: set[str] = set()
    planned = pictures_of(
        as_stored(groups), findings, settings=settings, name_of=lambda channel: folder_name(channel, taken)
    )
    pages = list(planned.values())
    if jobs == 1 or not FORKS:
        drawn = [page.png() for page in pages]
    else:
        made = {number: png() for number, png in each(lambda number: pages[number].png(), len(pages), jobs=jobs)}
        drawn = [made[number] for number in range(len(pages))]
    return {name: (png, page.caption) for (name, page), png in zip(planned.items(), drawn, strict=True)}


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
