"""The comparison of results: two builds, or one build over time, as one document with pictures, page and NetCDF."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from crankorder.batch.result_folder import DONE, FINDINGS, INDEX, RESULTS, publish, read_document, read_findings
from crankorder.batch.store import file_sha256, json_bytes, text_sha256
from crankorder.comparison import SCHEMA_VERSION, BuildComparison, Comparison
from crankorder.errors import InputError, RequestError
from crankorder.identify.compared import compared
from crankorder.identify.order_changes import Tested
from crankorder.records import known
from crankorder.report.comparison import builds_headline, with_sentences
from crankorder.report.netcdf import read_results
from crankorder.settings import MethodNumbers, ReportSettings, load_settings

if TYPE_CHECKING:
    import xarray as xr

    from crankorder.plot.drawing import Drawing

NAME, BUILDS = "comparison.json", "builds.json"
NUMBERS = MethodNumbers("5-identify-changes.toml", "partners")

MAPS = ("order_map", "order_tracks", "envelope_map", "shaft")


class ComparedResults(NamedTuple):
    """The ``folders`` of the tests that were compared, the ``document`` of their comparison, and its ``datasets``.

    These go by name: ``order_change`` (line, speed), a line being an order in a channel, and others of
    ``data_schema/``.
    """

    folders: tuple[Path, ...]
    document: Comparison
    datasets: dict[str, xr.Dataset]


class ComparedBuilds(NamedTuple):
    """The ``document`` of the comparison of two builds of several tests, and what was compared, by test."""

    folders: tuple[Path, ...]
    document: BuildComparison
    tests: dict[str, ComparedResults]


def compare_results(base: Path, new: Sequence[Path], *, q: float) -> ComparedResults | ComparedBuilds:
    """Comparison of the results in ``base`` with the last of ``new``; of several, in time order, the trend over all.

    Each is a test's result folder, or the ``--out`` of a run of one test. Two ``--out`` of several tests are builds:
    each test is compared with its partner. ``q`` is the false-discovery rate of all claims, 0 to 1. Raises RequestError
    where a folder is not one test's results or is named twice, or no two tests are partners, InputError where results
    are unfinished or damaged, or hold nothing that can be compared.
    """
    held = [_tests_in(folder) for folder in (base, *new)]
    outs = [tests for folder, tests in zip((base, *new), held, strict=True) if tests and tests != [folder]]
    if len(held) == len(outs) == 2 and max(map(len, outs)) > 1:
        return _compare_builds((base, new[0]), outs, q=q)
    return _compare_tests([_only(folder, tests) for folder, tests in zip((base, *new), held, strict=True)], q=q)


def _compare_tests(folders: Sequence[Path], *, q: float) -> ComparedResults:
    """Comparison of the results of one test in each of ``folders``."""
    # a test beside itself could not differ, and a trend would count one run as two
    for folder, times in Counter(folder.resolve() for folder in folders).items():
        if times > 1:
            allowed = "each test once, in time order"
            remedy = "Name the folder of the other test; results of two runs need two --out folders"
            raise RequestError("the same results are named twice", file=folder, allowed=allowed, remedy=remedy)
    tests = [_tested(folder) for folder in folders]
    if not set.intersection(*(test.comparable for test in tests)):
        fewest = min(zip(folders, tests, strict=True), key=lambda pair: len(pair[1].comparable))[0]
        problem = "the results have nothing in common to compare"
        found = "; ".join(f"{test.name}: {' and '.join(sorted(test.comparable)) or 'neither'}" for test in tests)
        allowed = "orders (the group order_map) or modes (findings) in all of them"
        remedy = "Run the analyses again with one recipe, whose [report] results name order_map or findings"
        raise InputError(problem, file=fewest / "results.nc", found=found, allowed=allowed, remedy=remedy)
    names = [test.name for test in tests]
    parents = [folder.resolve().parent.name for folder in folders]
    # tests of one name get the folder of their run, or its number
    marks = parents if len(set(parents)) == len(parents) else [f"run {at}" for at in range(1, len(names) + 1)]
    marked = [f"{name} ({mark})" if names.count(name) > 1 else name for name, mark in zip(names, marks, strict=True)]
    document, datasets = compared([replace(test, name=name) for test, name in zip(tests, marked, strict=True)], q=q)
    return ComparedResults(tuple(folders), with_sentences(document), datasets)


def _tested(folder: Path) -> Tested:
    """The results of the test in ``folder``."""
    findings, run = read_findings(folder), read_document(folder / "run.json")
    if "orders" not in run.get("settings", {}) or "test" not in run:
        raise InputError("not the results of a run", file=folder, remedy="Run the analysis again")
    groups = read_results(folder / "results.nc")
    return Tested(str(run["test"]), findings, run, {key: groups[key] for key in MAPS if key in groups})


def _compare_builds(builds: tuple[Path, Path], tests: Sequence[Sequence[Path]], *, q: float) -> ComparedBuilds:
    """Comparison of each test of the first of ``builds`` with its partner in the second; ``tests`` by build."""
    pairs = partners(*([_kind(folder) for folder in folders] for folders in tests))
    if not pairs:
        names = "; ".join(", ".join(folder.name for folder in folders) for folders in tests)
        allowed = "tests of one name, or of like settings, number of recordings and speeds"
        remedy = "Name two tests, as OUT/TEST, to compare them"
        raise RequestError("no two tests are partners", file=builds[1], found=names, allowed=allowed, remedy=remedy)
    of_pairs = {tests[0][at].name: _compare_tests([tests[0][at], tests[1][to]], q=q) for at, to in pairs}
    alone = [
        f"{folder.name} ({build.name})"
        for side, (build, folders) in enumerate(zip(builds, tests, strict=True))
        for number, folder in enumerate(folders)
        if all(pair[side] != number for pair in pairs)
    ]
    documents = {name: results.document for name, results in of_pairs.items()}
    document = BuildComparison(
        schema_version=SCHEMA_VERSION, base=builds[0].name, new=builds[1].name,
        headline=tuple(builds_headline(documents, alone)), tests=tuple(documents.values()), alone=tuple(alone),
    )  # fmt: skip
    return ComparedBuilds(tuple(folder for folders in tests for folder in folders), document, of_pairs)


class KindOfTest(NamedTuple):
    """What tells which tests are partners: name, number of recordings, speeds [rpm], and settings of the analysis."""

    name: str
    recordings: int
    speeds_rpm: tuple[float, float]
    settings: object = None


def _kind(folder: Path) -> KindOfTest:
    run, ends = read_document(folder / "run.json"), known(read_findings(folder).speed_range_rpm)
    settings = [run.get("settings", {}).get(stage) for stage in ("orders", "campbell")]
    return KindOfTest(str(run.get("test")), len(run.get("inputs", [])), ends or (0.0, 0.0), settings)


def partners(base: Sequence[KindOfTest], new: Sequence[KindOfTest]) -> list[tuple[int, int]]:
    """Positions in ``base`` and ``new`` of the tests that are compared with one another, each used once.

    The likest are matched first. Tests of one name are partners; others are so where settings agree, and half of the
    speeds and recordings do.
    """

    def likeness(one: KindOfTest, other: KindOfTest) -> float:
        if one.name == other.name:
            return 2.0
        lows, highs = zip(one.speeds_rpm, other.speeds_rpm, strict=True)
        both, either = min(highs) - max(lows) + 1.0, max(highs) - min(lows) + 1.0  # a single speed is 1 rpm wide
        counts = sorted((one.recordings, other.recordings))
        return both / either * counts[0] / max(counts[1], 1) if one.settings == other.settings else 0.0

    likest = sorted(product(range(len(base)), range(len(new))), key=lambda at: -likeness(base[at[0]], new[at[1]]))
    taken: dict[int, int] = {}
    for at, to in likest:
        if likeness(base[at], new[to]) >= NUMBERS.least_like and at not in taken and to not in taken.values():
            taken[at] = to
    return sorted(taken.items())


def _tests_in(folder: Path) -> list[Path]:
    """Folders of the finished tests at ``folder``: itself, or those in it."""
    if not folder.is_dir():
        raise RequestError("no such folder", file=folder, remedy="Give a folder that `crankorder run` made")
    if (folder / DONE).is_file() and (folder / "results.nc").is_file():
        return [folder]
    return sorted(path.parent for path in folder.glob(f"*/{DONE}") if (path.parent / "results.nc").is_file())


def _only(folder: Path, inside: Sequence[Path]) -> Path:
    """The one test that ``folder`` holds, of those ``inside``."""
    if len(inside) == 1:
        return inside[0]
    if inside:
        listed = ", ".join(path.name for path in inside)
        remedy = f"Name one of them, as {folder / inside[0].name}, or two --out of several tests"
        raise RequestError(f"holds the results of {len(inside)} tests", file=folder, found=listed, remedy=remedy)
    allowed = "a folder that `crankorder run` made, or its --out"
    remedy = "Name the folder of the results"
    raise RequestError("no finished results here", file=folder, allowed=allowed, remedy=remedy)


def document_text(results: ComparedResults | ComparedBuilds) -> str:
    """The document of the compared ``results`` as JSON, as it is published."""
    return json_bytes(results.document.as_dict()).decode("utf-8")


def publish_comparison(
    results: ComparedResults | ComparedBuilds, out: Path, *, report: Mapping[str, object] | None = None
) -> list[Path]:
    """Paths of the files written into ``out``: comparison.json, comparison.nc, pictures, page; whole or not at all.

    Of builds, those of each test with its name in front, their builds.json and their page index.html. ``results`` are
    those of :func:`compare_results`, ``report`` has settings of the report by key, in place of the defaults. Raises
    RequestError where ``out`` holds results of a run, EnvironmentFailure where it cannot be written.
    """
    refuse_results(out, results.folders)
    settings = load_settings(asked={"report": report or {}}).report
    files = _files(results, settings) if isinstance(results, ComparedResults) else _files_of_builds(results, settings)
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


def _files_of_builds(results: ComparedBuilds, settings: ReportSettings) -> dict[str, bytes]:
    from crankorder.report.page import index_page

    files, records = {BUILDS: document_text(results).encode()}, []
    for name, test in results.tests.items():
        own = _files(test, settings, prefix=f"{name}-")
        picture = next((file for file in own if file.endswith((".png", ".svg"))), "")
        document = test.document
        changed = document.cause.cause != "nothing changed"
        status = "changed" if changed and document.comparable else "not comparable" if changed else "no change"
        records.append({
            "name": name, "status": status, "headline": document.headline, "link": f"{name}-comparison.html",
            "picture": picture,
        })  # fmt: skip
        files |= own
    title = f"{results.document.base} → {results.document.new}"
    files[INDEX] = index_page(records, title=title, lead=results.document.headline).encode("utf-8", "backslashreplace")
    return files


def _files(results: ComparedResults, settings: ReportSettings, *, prefix: str = "") -> dict[str, bytes]:
    from crankorder.plot.painter import picture_bytes
    from crankorder.report.comparison import comparison_page
    from crankorder.report.comparison_figures import order_change_figure, trend_figure
    from crankorder.report.netcdf import as_stored, results_bytes

    document, shown = results.document, as_stored(results.datasets)
    files: dict[str, bytes] = {f"{prefix}{NAME}": document_text(results).encode()}
    drawings: dict[str, tuple[str, Drawing]] = {}
    if any(trend.changed for trend in document.trend) and settings.pictures:  # without growth it would be empty
        caption = "How the lines went from run to run, with 95 % intervals and the fitted growth"
        drawings["trend"] = caption, trend_figure(document, settings=settings)
    if "order_change" in shown and settings.pictures:
        caption = "What changed, order by order: second test over first, with 95 % intervals"
        figure = order_change_figure(shown["order_change"], document, settings=settings)
        drawings["orders_change"] = caption, figure
    kind = settings.picture_format
    pictures = [(f"{prefix}{name}.{kind}", caption) for name, (caption, _) in drawings.items()]
    painted = [picture_bytes(drawing, dpi=settings.dpi, kind=kind) for _, drawing in drawings.values()]
    files |= {file: picture for (file, _), picture in zip(pictures, painted, strict=True)}
    attrs = {"title": f"{document.base} / {document.new}", "source": f"crankorder {version('crankorder')}"}
    files[f"{prefix}comparison.nc"] = results_bytes(results.datasets, attrs=attrs)
    page = comparison_page(document, pictures=pictures, settings=settings)
    files[f"{prefix}comparison.html"] = page.encode("utf-8", "backslashreplace")
    return files
