"""Pictures and page once more, from results that exist."""

from __future__ import annotations

import json
from pathlib import Path

from crankorder.batch.publish import files_of_test
from crankorder.batch.store import DONE, publish
from crankorder.errors import InputError
from crankorder.report.netcdf import read_results
from crankorder.settings import ReportSettings, load_settings


def redraw(result: Path) -> Path:
    """Path of the page that was made again from ``result``, a test's result folder or its ``results.nc``.

    Data and findings stay byte for byte what they were; pictures and page are drawn by today's program with the
    settings of the run.
    Raises InputError where the folder holds no finished results.
    """
    folder = result if result.is_dir() else result.parent
    try:
        key = json.loads((folder / DONE).read_bytes())["key"]
        findings = json.loads((folder / "findings.json").read_bytes())
        provenance = json.loads((folder / "run.json").read_bytes())
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            "no finished results here",
            file=folder,
            found=error,
            allowed="a folder that `crankorder run` made",
            remedy="Run the analysis again; results without a done marker are never used",
        ) from error
    groups = {k: v for k, v in read_results(folder / "results.nc").items() if not k.startswith("findings")}
    # a key that is newer than the results has today's default
    stated = load_settings().report.model_dump() | provenance["settings"]["report"]
    settings = ReportSettings.model_validate(stated)
    files = files_of_test(groups, findings, provenance, settings=settings)
    kept = {name: (folder / name).read_bytes() for name in ("results.nc", "findings.json", "run.json")}
    publish(folder, files | kept, key=key)
    return folder / "report.html"
