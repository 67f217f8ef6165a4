"""The comparison of results: two builds, or one build over time, as one document with pictures, page and NetCDF."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from crankorder.batch.result_folder import DONE, FINDINGS, RESULTS, publish, read_document, read_findings
from crankorder.batch.store import file_sha256, json_bytes, text_sha256
from crankorder.comparison import Comparison
from crankorder.errors import InputError, RequestError
from crankorder.identify.compared import compared
from crankorder.identify.order_changes import Tested
from crankorder.report.comparison import with_sentences
from crankorder.report.netcdf import read_results
from crankorder.settings import ReportSettings, load_settings

if TYPE_CHECKING:
    import xarray as xr

    from crankorder.plot.drawing import Drawing

NAME = "comparison.json"
MAPS = ("order_map", "order_tracks", "envelope_map", "shaft")


class ComparedResults(NamedTuple):
    """The ``folders`` of the tests that were compared, the ``document`` of their comparison, and its ``datasets``.

    These go by name: ``order_change`` (line, speed), a line being an order in a channel, and others of
    ``data_schema/``.
    """

    folders: tuple[Path, ...]
    document: Comparison
    datasets: dict[str, xr.Dataset]


def compare_results(base: Path, new: Sequence[Path], *, q: float) -> ComparedResults:
    """Comparison of the results in ``base`` with the last of ``new``; of several, in time order, the trend over all.

    Each is a test's result folder, or the ``--out`` of a run of one test. ``q`` is the false-discovery rate of all
    claims, 0 to 1. Raises RequestError where a folder is not one test's results or is named twice, InputError where
    results are unfinished or damaged, or hold nothing that can be compared.
    """
    folders = tuple(_test_folder(folder) for folder in (base, *new))
    # a test beside itself could not differ, and a trend would count one run as two
    for folder, times in Counter(folder.resolve() for folder in folders).items():
        if times > 1:
            allowed = "each test once, in time order"
            remedy = "Name the folder of the other test; results of two runs need two --out folders"
            raise RequestError("the same results are named twice", file=folder, allowed=allowed, remedy=remedy)
    tests = []
    for folder in folders:
        findings, run = read_findings(folder), read_document(folder / "run.json")
        if "orders" not in run.get("settings", {}) or "test" not in run:
            raise InputError("not the results of a run", file=folder, remedy="Run the analysis again")
        groups = read_results(folder / "results.nc")
        maps = {key: groups[key] for key in MAPS if key in groups}
        tests.append(Tested(str(run["test"]), findings, run, maps))
    if not set.intersection(*(test.comparable for test in tests)):
        fewest = min(zip(folders, tests, strict=True), key=lambda pair: len(pair[1].comparable))[0]
        problem = "the results have nothing in common to compare"
        found = "; ".join(f"{test.name}: {' and '.join(sorted(test.comparable)) or 'neither'}" for test in tests)
        allowed = "orders (the group order_map) or modes (findings) in all of them"
        remedy = "Run the analyses again with one recipe, whose [report] results name order_map or findings"
        raise InputError(problem, file=fewest / "results.nc", found=found, allowed=allowed, remedy=remedy)
    names = [test.name for test in tests]
    # tests of one name get the number of their run
    numbered = [f"{name} (run {at})" if names.count(name) > 1 else name for at, name in enumerate(names, start=1)]
    document, datasets = compared([replace(test, name=name) for test, name in zip(tests, numbered, strict=True)], q=q)
    return ComparedResults(folders, with_sentences(document), datasets)


def _test_folder(folder: Path) -> Path:
    """The folder with the results of the one test that ``folder`` holds."""
    if not folder.is_dir():
        raise RequestError("no such folder", file=folder, remedy="Give a folder that `crankorder run` made")
    if (folder / DONE).is_file() and (folder / "results.nc").is_file():
        return folder
    inside = sorted(path.parent for path in folder.glob(f"*/{DONE}") if (path.parent / "results.nc").is_file())
    if len(inside) == 1:
        return inside[0]
    if inside:
        listed = ", ".join(path.name for path in inside)
        remedy = f"Name one of them, as {folder / inside[0].name}"
        raise RequestError(f"holds the results of {len(inside)} tests", file=folder, found=listed, remedy=remedy)
    allowed = "a folder that `crankorder run` made, or its --out of one test"
    remedy = "Run the analysis again; results without a done marker are never used"
    raise RequestError("no finished results here", file=folder, allowed=allowed, remedy=remedy)


def document_text(results: ComparedResults) -> str:
    """The document of the compared ``results`` as JSON, as it is published."""
    return json_bytes(results.document.as_dict()).decode("utf-8")


def publish_comparison(
    results: ComparedResults, out: Path, *, report: Mapping[str, object] | None = None
) -> list[Path]:
    """Paths of the files written into ``out``: comparison.json, comparison.nc, pictures, page; whole or not at all.

    ``results`` are those of :func:`compare_results`, ``report`` has settings of the report by key, in place of the
    defaults. Raises RequestError where ``out`` holds results of a run, EnvironmentFailure where it cannot be written.
    """
    refuse_results(out, results.folders)
    files = _files(results, load_settings(asked={"report": report or {}}).report)
    marks = [file_sha256(folder / name) for folder in results.folders for name in (RESULTS, FINDINGS)]
    publish(out, files, key=text_sha256(version("crankorder"), document_text(results), *marks))
    return [out / name for name in files]


def refuse_results(out: Path, folders: Sequence[Path]) -> None:
    """Refuse a folder ``out`` that holds results, is one of ``folders`` or lies inside one.

    Raises RequestError then: results are never replaced by others.
    """
    where = out.resolve()
    if out.exists() and not out.is_dir():
        raise RequestError("is a file, not a folder", file=out, remedy="Choose another --out")
    held = [folder.resolve() for folder in folders]
    held += [folder.parent for folder in held if (folder.parent / "batch.json").is_file()]
    inside = any(folder in (where, *where.parents) for folder in held)
    if inside or (out / "results.nc").exists() or (out / "batch.json").exists():
        allowed = "a new folder, or one that the same command made"
        remedy = "Choose another --out"
        raise RequestError("would lie among the results of a run", file=out, allowed=allowed, remedy=remedy)


def _files(results: ComparedResults, settings: ReportSettings) -> dict[str, bytes]:
    from crankorder.plot.painter import picture_bytes
    from crankorder.report.comparison import comparison_page
    from crankorder.report.comparison_figures import order_change_figure, trend_figure
    from crankorder.report.netcdf import as_stored, results_bytes

    document, shown = results.document, as_stored(results.datasets)
    pictures: list[tuple[str, str]] = []
    files: dict[str, bytes] = {NAME: document_text(results).encode()}

    def draw(name: str, caption: str, figure: Callable[[], Drawing]) -> None:
        file = f"{name}.{settings.picture_format}"
        files[file] = picture_bytes(figure(), dpi=settings.dpi, kind=settings.picture_format)
        pictures.append((file, caption))

    if any(trend.changed for trend in document.trend) and settings.pictures:  # without growth it would be empty
        caption = "How the lines went from run to run, with 95 % intervals and the fitted growth"
        draw("trend", caption, partial(trend_figure, document, settings=settings))
    if "order_change" in shown and settings.pictures:
        caption = "What changed, order by order: second test over first, with 95 % intervals"
        draw("orders_change", caption, partial(order_change_figure, shown["order_change"], document, settings=settings))
    attrs = {"title": f"{document.base} / {document.new}", "source": f"crankorder {version('crankorder')}"}
    files["comparison.nc"] = results_bytes(results.datasets, attrs=attrs)
    page = comparison_page(document, pictures=pictures, settings=settings)
    files["comparison.html"] = page.encode("utf-8", "backslashreplace")
    return files
