"""The files of one test: NetCDF, JSON, pictures and page, made by a process beside the analysis; drawn again; exported.

This module imports nothing heavy itself: that process loads what draws and writes, while this one loads the rest.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crankorder.batch import result_folder, store
from crankorder.batch.store import HashedFile, file_sha256, json_bytes
from crankorder.batch.workers import Worker, WorkerDiedError, each
from crankorder.errors import EnvironmentFailure, InputError, RequestError
from crankorder.findings import Findings
from crankorder.settings import ReportSettings, load_settings

if TYPE_CHECKING:
    import xarray as xr

    from crankorder.batch.plan import CampaignPlan


class ReportingProcess:
    """A process beside this one that hashes the inputs of ``plans``, then loads what writes, then writes when asked.

    Where it is killed another takes its place and does what was asked once more.
    """

    def __init__(self, plans: list[CampaignPlan], *, jobs: int) -> None:
        """Start hashing the recordings of ``plans``, ``jobs`` at a time, and loading what draws and writes."""
        self._plans, self._jobs = plans, jobs
        self._start()
        for request in ("hash", "load"):
            self._ask(request)

    def _start(self) -> None:
        self._worker, self._asked = Worker(self._do, daemon=False), list[str]()

    def _ask(self, request: str, *given: Any) -> None:
        self._asked.append(request)
        self._worker.ask((request, given))

    def _answer_to(self, request: str, *given: Any) -> Any:
        """Answer to ``request``, which was asked or is asked now; those that nobody waits for are passed over.

        Raises EnvironmentFailure where the process ended twice over it.
        """
        died = WorkerDiedError()
        for _ in range(2):
            try:
                if request not in self._asked:
                    self._ask(request, *given)
                while self._asked.pop(0) != request:
                    self._worker.answer()
                return self._worker.answer()
            except WorkerDiedError as error:
                died = error
                self._worker.close()  # it lives where one of its own workers died
                self._start()
        problem = "the process that hashes and writes ended twice"
        remedy = "Too little memory is the likely cause: try --jobs 1; the other tests go on"
        raise EnvironmentFailure(problem, file="crankorder", found=died, remedy=remedy) from died

    def _do(self, request: tuple[str, tuple[Any, ...]]) -> Any:
        name, given = request
        if name == "hash":
            paths = [path for plan in self._plans for path in plan.files]
            with ThreadPoolExecutor(max_workers=self._jobs) as pool:
                hashed = dict(zip(paths, pool.map(HashedFile.of, paths), strict=True))
            return (store.code_sha256(), store.library_versions()), hashed
        if name == "load":
            return prepare(draws=any(plan.settings.report.pictures for plan in self._plans))
        if name == "index":
            from crankorder.report.page import index_page

            return index_page(*given)
        return files_of_test(*given, jobs=self._jobs)

    @cached_property
    def _hashed(self) -> tuple[tuple[str, dict[str, str]], dict[Path, HashedFile]]:
        hashed: tuple[tuple[str, dict[str, str]], dict[Path, HashedFile]] = self._answer_to("hash")
        return hashed

    @property
    def program(self) -> tuple[str, dict[str, str]]:
        """SHA-256 of the program, and the versions of it and of the libraries that results may depend on."""
        return self._hashed[0]

    def hashes(self, plan: CampaignPlan) -> dict[Path, HashedFile]:
        """Every file of ``plan`` as it was hashed, or why it could not be."""
        return {path: self._hashed[1][path] for path in plan.files}

    def files_of_test(
        self,
        groups: dict[str, xr.Dataset],
        findings: Findings,
        provenance: Mapping[str, object],
        settings: ReportSettings,
    ) -> dict[str, bytes]:
        """Bytes of all files of a test by name, from its ``groups``, ``findings``, ``provenance`` and ``settings``.

        The datasets ``groups`` (dims of ``data_schema/``) and the rest are those of :func:`files_of_test` of this
        module. Raises EnvironmentFailure where the process ends meanwhile.
        """
        return dict(self._answer_to("write", groups, findings, provenance, settings))

    def index_page(self, tests: Sequence[Mapping[str, object]]) -> str:
        """HTML list of the ``tests`` of a run, as :func:`crankorder.report.page.index_page` makes it."""
        return str(self._answer_to("index", tests))

    def close(self) -> None:
        """End the process."""
        self._worker.close()


def prepare(*, draws: bool) -> None:
    """Load the libraries that write results, and where it ``draws`` those that draw, ahead of time."""
    from crankorder.report.page import index_page

    if draws:
        from crankorder.report import pictures

        pictures.prepare()
    index_page([])


def files_of_test(
    groups: dict[str, xr.Dataset],
    findings: Findings,
    provenance: Mapping[str, object],
    settings: ReportSettings,
    *,
    jobs: int = 1,
) -> dict[str, bytes]:
    """All files of a test by name: results.nc, findings.json, pictures, report.html, run.json.

    ``groups`` are the datasets (dims of ``data_schema/``) by group name, ``findings`` what they say, ``provenance``
    what ``run.json`` states; ``settings`` shape pictures and page. The data and each picture are made ``jobs`` at a
    time, in processes where that is more than one; the page, which holds the pictures, comes last.
    """
    from crankorder.batch.plan import folder_name
    from crankorder.report.netcdf import as_stored, findings_datasets, results_bytes, root_attrs
    from crankorder.report.page import ShownPicture, report_page
    from crankorder.report.pictures import pictures_of

    stored, taken = as_stored(groups), set[str]()
    planned = pictures_of(stored, findings, settings=settings, name_of=lambda channel: folder_name(channel, taken))
    last_first = list(planned.values())[::-1]  # the spectra at the end take longest

    def make(number: int) -> Any:
        """Files of the data where ``number`` is 0, else the bytes of file and PNG of a picture."""
        if number:
            return last_first[number - 1].drawn()
        results = results_bytes({**stored, **findings_datasets(findings)}, attrs=root_attrs(findings, groups))
        documents = {"findings.json": findings.as_dict(), "run.json": provenance}
        return {"results.nc": results, **{name: json_bytes(document) for name, document in documents.items()}}

    numbers = range(1 + len(planned))
    if jobs > 1 and planned:
        made = {number: answer.result() for number, answer in each(make, len(numbers), jobs=jobs)}
    else:
        made = {number: make(number) for number in numbers}
    drawn = dict(zip(planned, [made[number] for number in reversed(numbers[1:])], strict=True))
    shown = [ShownPicture(name, planned[name].caption, png) for name, (_, png) in drawn.items()]
    page = report_page(findings, pictures=shown, provenance=provenance, settings=settings, groups=stored)
    files: dict[str, bytes] = made[0] | {"report.html": page.encode("utf-8", "backslashreplace")}
    return files | {name: file for name, (file, _) in drawn.items()}


def redraw(result: Path, *, report: Mapping[str, object] | None = None) -> Path:
    """Path of the page that was made again from ``result``, a test's result folder or its ``results.nc``.

    Data and findings stay the same, byte for byte; pictures and page are drawn by the present program with the settings
    of the run, which those of ``report``, by key, replace. Raises InputError where the folder holds no finished results
    that this version reads, ValidationError where ``report`` is no such setting.
    """
    from crankorder.report.netcdf import read_results

    folder = (result if result.is_dir() or not result.suffix else result.parent).absolute()
    with store.locked(folder):
        result_folder.settle(folder)
        marker = result_folder.marker_of(folder)
        try:
            findings = result_folder.read_findings(folder)
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
        files = files_of_test(groups, findings, provenance, settings)
        kept = {name: (folder / name).read_bytes() for name in ("results.nc", "findings.json", "run.json")}
        timings = folder / result_folder.TIMINGS
        besides, kind = {timings.name: timings.read_bytes()} if timings.is_file() else {}, marker.record
        result_folder.publish(folder, files | kept, key=marker.key, owner=marker.input, record=kind, besides=besides)
        return folder / "report.html"


FORMATS = ("uff58", "csv", "parquet")


def export_results(result: Path, out: Path, *, to: str, binary: bool = False) -> list[Path]:
    """Paths of the files written into ``out``, a folder ``<test>-<format>`` for each test of ``result``.

    ``result`` is a ``results.nc``, the folder of a test, or the whole ``--out`` of a run. With ``to`` "uff58" it is
    ``results.uff`` (58b where ``binary``), with "csv" and "parquet" a file for each table (Parquet also of the maps).
    Raises RequestError where there are no results, where ``to`` is none of these or ``out`` holds results of a run;
    InputError where results are damaged.
    """
    from crankorder.batch.compare import refuse_results

    if to not in FORMATS:
        raise RequestError("no such format", file="export", place="to", found=to, allowed=", ".join(FORMATS))
    if binary and to != "uff58":
        raise RequestError("only universal files have a binary form", file="export", place="binary", found=to)
    folders = result_folder.result_folders(result)
    refuse_results(out, folders)
    written: list[Path] = []
    for folder in folders:
        files = _exported(folder, to, binary)
        key = store.text_sha256(version("crankorder"), to, str(binary), file_sha256(folder / "results.nc"))
        result_folder.publish(out / f"{folder.name}-{to}", files, key=key)
        written += [out / f"{folder.name}-{to}" / name for name in files]
    return written


def _exported(folder: Path, to: str, binary: bool) -> dict[str, bytes]:
    """Files by name of the results in ``folder``, in the format ``to``."""
    from crankorder.interchange.export import csv_bytes, parquet_bytes, tables_of, uff58_bytes
    from crankorder.report.netcdf import published, read_results

    test = str(result_folder.read_document(folder / "run.json").get("test", folder.name))
    groups = read_results(folder / "results.nc")
    if to == "uff58":
        if not {"order_tracks", "order_map", "campbell_map"} & set(groups):
            found = ", ".join(sorted(groups)) or "no group"
            raise RequestError("holds no orders and no map", file=folder / "results.nc", found=found)
        return {"results.uff": uff58_bytes(groups, test=test, binary=binary)}
    tables = tables_of({name: published(dataset) for name, dataset in groups.items()}, maps=to == "parquet")
    if not tables:
        raise RequestError("holds nothing to put into a table", file=folder / "results.nc")
    written = csv_bytes if to == "csv" else parquet_bytes
    return {f"{name}.{to}": written(columns) for name, columns in tables.items()}
