"""Pictures and page once more, from results that exist."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crankorder.batch.locks import locked
from crankorder.batch.publish import files_of_test
from crankorder.batch.result_folder import TIMINGS, marker_of, owner_recorded, publish, read_findings, settle
from crankorder.errors import InputError
from crankorder.report.netcdf import read_results
from crankorder.settings import ReportSettings, load_settings


def redraw(result: Path, *, report: Mapping[str, Any] | None = None) -> Path:
    """Path of the page that was made again from ``result``, a test's result folder or its ``results.nc``.

    Data and findings stay byte for byte what they were; pictures and page are drawn by today's program with the
    settings of the run, before which those of ``report`` go, by key.
    Raises InputError where the folder holds no finished results.
    """
    folder = (result if result.is_dir() or not result.suffix else result.parent).absolute()
    with locked(folder):
        return _redrawn(folder, report or {})


def _redrawn(folder: Path, report: Mapping[str, Any]) -> Path:
    settle(folder)
    marker = marker_of(folder)
    try:
        findings = read_findings(folder)
        provenance = json.loads((folder / "run.json").read_bytes())
        stated = load_settings().report.model_dump() | provenance["settings"]["report"] | report
        key = marker["key"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            "no finished results here",
            file=folder,
            found=error,
            allowed="a folder that `crankorder run` made",
            remedy="Run the analysis again; results without a done marker are never used",
        ) from error
    groups = {k: v for k, v in read_results(folder / "results.nc").items() if not k.startswith("findings")}
    # a key that is newer than the results has today's default
    settings = ReportSettings.model_validate(stated)
    files = files_of_test(groups, findings, provenance, settings=settings)
    kept = {name: (folder / name).read_bytes() for name in ("results.nc", "findings.json", "run.json")}
    timings = {TIMINGS: (folder / TIMINGS).read_bytes()} if (folder / TIMINGS).is_file() else {}
    owner, record = owner_recorded(folder), marker.get("record")
    publish(folder, files | kept, key=key, owner=owner, record=record, besides=timings)
    return folder / "report.html"
