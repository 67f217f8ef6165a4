"""The files of one test: NetCDF, JSON, pictures and page, as bytes, ready to be published; and drawn once more."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from crankorder.batch.plan import folder_name
from crankorder.batch.result_folder import TIMINGS, marker_of, publish, read_findings, settle
from crankorder.batch.store import json_bytes, locked
from crankorder.batch.workers import FORKS, each
from crankorder.errors import InputError
from crankorder.findings import Findings
from crankorder.report.netcdf import as_stored, findings_datasets, read_results, results_bytes, root_attrs
from crankorder.report.page import ShownPicture, report_page
from crankorder.settings import ReportSettings, load_settings

if TYPE_CHECKING:
    import xarray as xr

    from crankorder.report.pictures import Picture


def prepare(*, draws: bool) -> None:
    """Load what writes and, where it ``draws``, its fonts too: worth doing before there is anything to show."""
    from crankorder.report.page import index_page

    if draws:
        from crankorder.report import pictures

        pictures.prepare()
    index_page([])


def _draw(pages: list[Picture], *, jobs: int, meanwhile: Callable[[], object]) -> list[tuple[bytes, bytes]]:
    """Bytes of the file and of the PNG of each of ``pages``, ``jobs`` at a time in processes where that is several."""
    if jobs == 1 or not FORKS:
        meanwhile()
        return [page.drawn() for page in pages]
    last_first = pages[::-1]  # the spectra at the end take longest
    drawn = each(lambda number: last_first[number].drawn(), len(pages), jobs=jobs, meanwhile=meanwhile)
    made = {number: answer() for number, answer in drawn}
    return [made[number] for number in reversed(range(len(pages)))]


def files_of_test(
    groups: dict[str, xr.Dataset],
    findings: Findings,
    provenance: dict[str, object],
    *,
    settings: ReportSettings,
    jobs: int = 1,
) -> dict[str, bytes]:
    """All files of a test by name: results.nc, findings.json, pictures, report.html, run.json.

    ``groups`` are the datasets by group name, ``findings`` what they say, ``provenance`` what ``run.json`` states;
    ``settings`` shape pictures and page. With more ``jobs`` than one, so many pictures are drawn at a time, beside the
    writing of the other files; the page, which holds them, comes last.
    """
    from crankorder.report.pictures import pictures_of

    stored, taken, data = as_stored(groups), set[str](), dict[str, bytes]()
    planned = pictures_of(stored, findings, settings=settings, name_of=lambda channel: folder_name(channel, taken))

    def write() -> None:
        attrs = root_attrs(findings, groups)
        data["results.nc"] = results_bytes({**stored, **findings_datasets(findings)}, attrs=attrs)
        data["findings.json"] = json_bytes(findings.as_dict())
        data["run.json"] = json_bytes(provenance)

    drawn = dict(zip(planned, _draw(list(planned.values()), jobs=jobs, meanwhile=write), strict=True))
    shown = [ShownPicture(name, planned[name].caption, png) for name, (_, png) in drawn.items()]
    page = report_page(findings, pictures=shown, provenance=provenance, settings=settings, groups=stored)
    data["report.html"] = page.encode("utf-8", "backslashreplace")
    return data | {name: file for name, (file, _) in drawn.items()}


def redraw(result: Path, *, report: Mapping[str, object] | None = None) -> Path:
    """Path of the page that was made again from ``result``, a test's result folder or its ``results.nc``.

    Data and findings stay byte for byte what they were; pictures and page are drawn by today's program with the
    settings of the run, before which those of ``report`` go, by key.
    Raises InputError where the folder holds no finished results.
    """
    folder = (result if result.is_dir() or not result.suffix else result.parent).absolute()
    with locked(folder):
        settle(folder)
        marker = marker_of(folder)
        try:
            findings = read_findings(folder)
            provenance = json.loads((folder / "run.json").read_bytes())
            stated = load_settings().report.model_dump() | provenance["settings"]["report"] | dict(report or {})
            if marker is None:
                raise ValueError("no done.json")
            if any(not record.causes for record in findings.orders):
                raise ValueError("findings of a version that said causes in words alone")
        except (OSError, ValueError, KeyError, TypeError) as error:
            problem = "no finished results that this version reads"
            allowed = "a folder that `crankorder run` made"
            remedy = "Run the analysis again: unfinished results and findings of another version are never used"
            raise InputError(problem, file=folder, found=error, allowed=allowed, remedy=remedy) from error
        groups = {k: v for k, v in read_results(folder / "results.nc").items() if not k.startswith("findings")}
        # a key that is newer than the results has today's default
        settings = ReportSettings.model_validate(stated)
        files = files_of_test(groups, findings, provenance, settings=settings)
        kept = {name: (folder / name).read_bytes() for name in ("results.nc", "findings.json", "run.json")}
        timings = {TIMINGS: (folder / TIMINGS).read_bytes()} if (folder / TIMINGS).is_file() else {}
        publish(folder, files | kept, key=marker.key, owner=marker.input, record=marker.record, besides=timings)
        return folder / "report.html"
