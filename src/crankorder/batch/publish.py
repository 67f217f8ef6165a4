"""The files of one test: NetCDF, JSON, pictures and page, as bytes, ready to be published."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from crankorder.batch.plan import folder_name
from crankorder.batch.store import json_bytes
from crankorder.batch.workers import FORKS, each
from crankorder.findings import Findings
from crankorder.report.netcdf import as_stored, results_bytes
from crankorder.report.page import ShownPicture, report_page
from crankorder.report.published import findings_datasets, root_attrs
from crankorder.settings import ReportSettings

if TYPE_CHECKING:
    import xarray as xr

    from crankorder.report.pictures import Picture


def prepare() -> None:
    """Load what draws and writes, with its fonts and templates: worth doing before there is anything to show."""
    from crankorder.report.page import index_page
    from crankorder.report.pictures import prepare

    prepare()
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
    provenance: dict[str, Any],
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
