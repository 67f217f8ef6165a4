"""The folder that a test's results stand in: whole or not at all, of one input, and nobody else's.

New results are written into a folder beside, flushed, and renamed in the place of the old ones. ``done.json`` says
what they were made of, and what every file must be.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from crankorder.batch.store import file_sha256, flush_folder, json_bytes, write_flushed
from crankorder.errors import EnvironmentFailure, InputError, RequestError, printable
from crankorder.findings import SCHEMA_VERSION, Findings
from crankorder.records import Json

DONE, RESULTS, FINDINGS = "done.json", "results.nc", "findings.json"
TIMINGS = "timings.json"
"""Seconds of the stages: no result, and not the same in a second run."""

FORMER = "former.json"
"""Marker of the results that are being replaced, while files are moved in among those of others."""

BATCH, INDEX = "batch.json", "index.html"
"""What all tests of a folder gave, and its page."""

FOREIGN = "holds files that no earlier run wrote"
BATCH_VERSION = 1
"""Of ``batch.json``."""


@dataclass(frozen=True)
class Owner:
    """The input that results belong to: its folder, relative to that of all results, and the hash of its manifest."""

    folder: str
    manifest_sha256: str


@dataclass(frozen=True)
class Marker:
    """What ``done.json`` states: the ``key`` of the results, the hash of each file, their owner, what an index says."""

    key: str
    outputs_sha256: Mapping[str, str]
    input: Owner | None = None
    record: Mapping[str, Json] | None = None


def marker_of(folder: Path, name: str = DONE) -> Marker | None:
    """What ``done.json``, or another ``name``, in ``folder`` states; None where there is none that a run wrote."""
    try:
        stated = json.loads((folder / name).read_bytes())
        outputs, owner = dict(stated["outputs_sha256"]), None
        if not isinstance(stated["key"], str) or any(Path(name).name != name for name in outputs):
            return None
        with contextlib.suppress(KeyError, TypeError):
            owner = Owner(str(stated["input"]["folder"]), str(stated["input"]["manifest_sha256"]))
        return Marker(stated["key"], outputs, owner, stated.get("record"))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def finished_with(folder: Path, key: str) -> bool:
    """Whether ``folder`` holds results that were finished with ``key`` and whose files are still those written."""
    marker = marker_of(folder)
    if marker is None or marker.key != key:
        return False
    try:
        return all(file_sha256(folder / name) == digest for name, digest in marker.outputs_sha256.items())
    except OSError:
        return False


def foreign_in(folder: Path) -> list[str]:
    """Names of what lies in ``folder`` and no earlier run wrote; what editors and file managers leave is nobody's."""
    from crankorder.ingest.folder import is_leftover  # reads manifests too, which `balance` need not wait for

    try:
        names = {item.name for item in folder.iterdir()}
    except FileNotFoundError:
        return []
    except NotADirectoryError:
        return [folder.name]
    marker = marker_of(folder)
    ours = {*marker.outputs_sha256, DONE, TIMINGS} if marker else set()
    return sorted(name for name in names - ours if not is_leftover(name))


def refuse_foreign(folder: Path) -> None:
    """Refuse to replace a ``folder`` that holds what no earlier run wrote: RequestError names it."""
    found = foreign_in(folder)
    marker = marker_of(folder)
    if marker and "run.json" not in marker.outputs_sha256:
        found = sorted(marker.outputs_sha256)  # of a comparison or a balance
    if found:
        shown = ", ".join(printable(name, 60) for name in found[:5]) + (", …" if len(found) > 5 else "")
        allowed = "a folder that is missing, empty, or was made by `crankorder run`"
        remedy = "Move them away, or choose another --out or --name: nothing of yours is overwritten"
        raise RequestError(FOREIGN, file=folder, found=shown, allowed=allowed, remedy=remedy)


def refuse_others(folder: Path, owner: Owner) -> None:
    """Refuse to replace results in ``folder`` that were made of another input than ``owner``: RequestError.

    Results that do not say what they were made of belong to everybody; data may have moved.
    """
    marker = marker_of(folder)
    recorded = None if marker is None else marker.input
    if recorded is None or recorded.folder == owner.folder:
        return
    there = folder.parent / recorded.folder
    with contextlib.suppress(OSError):
        if there.samefile(folder.parent / owner.folder):
            return
    if recorded.manifest_sha256 != owner.manifest_sha256 or there.is_dir():
        found = f"made of {printable(recorded.folder)}, not of {printable(owner.folder)}"
        remedy = "Give one of the two another name: --name NAME, or name = … under [test] in its run.toml"
        raise RequestError("holds the results of another test of this name", file=folder, found=found, remedy=remedy)


def publish(
    folder: Path,
    contents: Mapping[str, bytes],
    *,
    key: str,
    owner: Owner | None = None,
    record: Mapping[str, Json] | None = None,
    besides: Mapping[str, bytes] | None = None,
) -> None:
    """Make ``contents`` (name → bytes) the results in ``folder``, with a marker that holds their hashes and ``key``.

    ``owner`` is the input that they were made of, ``record`` their record in an index, ``besides`` are files that are
    no results and may change, such as timings. A reader of ``folder`` finds the old results or the new ones, or none
    for the moment between two renames. Foreign files stay. Raises EnvironmentFailure where the disk is full or the
    folder cannot be written: the old results stand then; RequestError where a file of others has the name of a result.
    """
    marker = {
        "key": key,
        "input": None if owner is None else asdict(owner),
        "record": record,
        "outputs_sha256": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(contents.items())},
    }
    marker = {name: value for name, value in marker.items() if value is not None}
    files = {**contents, **(besides or {}), DONE: json_bytes(marker)}
    folder = folder.parent.resolve() / folder.name if not folder.is_symlink() else folder.resolve()
    shared = sorted(set(foreign_in(folder)) & set(files))
    if shared:
        remedy = "Choose another --out: nothing of yours is overwritten"
        raise RequestError(FOREIGN, file=folder, found=", ".join(shared), remedy=remedy)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        settle(folder)
        if _replaceable(folder):
            _exchange(folder, files)
        else:
            _replace_files(folder, files)
    except OSError as error:
        with contextlib.suppress(OSError):
            settle(folder)
        problem = f"the results cannot be written ({error.strerror or error})"
        remedy = "Free space on the disk or choose another --out; what was there before is kept, or there is nothing"
        raise EnvironmentFailure(problem, file=error.filename or folder, remedy=remedy) from error


def settle(folder: Path) -> None:
    """Finish or undo an exchange of ``folder`` that was cut short, and clear away what it left.

    Raises OSError where that cannot be done.
    """
    new, old = _beside(folder)
    if not folder.exists():
        if (marker := marker_of(new)) and finished_with(new, marker.key):
            new.rename(folder)
        elif old.is_dir():
            old.rename(folder)
    for leftover in (new, old):
        if leftover.is_dir():
            shutil.rmtree(leftover)
    inside = folder / new.name
    if inside.is_dir():
        if marker_of(inside) and not (folder / DONE).exists():
            _move_in(folder, inside)
        shutil.rmtree(inside, ignore_errors=True)


def _beside(folder: Path) -> tuple[Path, Path]:
    """Folders of the new results, and of the old ones until the new ones have their place.

    Among files of others the new ones lie in a folder of the same name inside.
    """
    return folder.with_name(f".{folder.name}.crankorder-new"), folder.with_name(f".{folder.name}.crankorder-old")


def _replaceable(folder: Path) -> bool:
    """Whether a new folder may take the place of ``folder``: nothing of others in it, and nobody stands in it."""
    if not os.access(folder.parent, os.W_OK) or folder.is_mount():
        return False
    if not folder.exists():
        return True
    here = Path.cwd().resolve()
    return not foreign_in(folder) and here != folder and folder not in here.parents


def _exchange(folder: Path, files: Mapping[str, bytes]) -> None:
    new, old = _beside(folder)
    _write_all(new, files)
    if folder.exists():
        folder.rename(old)
    new.rename(folder)
    flush_folder(folder.parent)
    shutil.rmtree(old, ignore_errors=True)


def _write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write ``files`` into the new ``folder`` and flush them; nothing of it stays where one cannot be written."""
    folder.mkdir()
    try:
        for name, data in files.items():
            write_flushed(folder / name, data)
        flush_folder(folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _replace_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Put ``files`` among those of others in ``folder``: all are written first, then moved, the marker last."""
    folder.mkdir(exist_ok=True)
    new = folder / _beside(folder)[0].name
    _write_all(new, files)
    if marker_of(folder):
        (folder / DONE).rename(new / FORMER)
    _move_in(folder, new)
    new.rmdir()


def _move_in(folder: Path, new: Path) -> None:
    """Move what is ``new`` into ``folder``, the marker last, and remove what only the results before had."""
    former, marker = marker_of(new, FORMER), marker_of(new)
    assert marker is not None  # written before
    for name in set(() if former is None else former.outputs_sha256) - set(marker.outputs_sha256):
        (folder / name).unlink(missing_ok=True)
    files = [path for path in new.iterdir() if path.name != FORMER]
    for path in sorted(files, key=lambda path: path.name == DONE):
        path.replace(folder / path.name)
    (new / FORMER).unlink(missing_ok=True)
    flush_folder(folder)


def finished_tests(out: Path) -> Iterator[tuple[Path, Marker]]:
    """Every folder in ``out`` with finished results, in the order of the names, and what its marker says."""
    for folder in sorted(out.iterdir()):
        if not folder.name.startswith(".") and (marker := marker_of(folder)):
            yield folder, marker


def result_folders(result: Path) -> list[Path]:
    """Folders with finished results at ``result``: a ``results.nc``, the folder of a test, or the ``--out`` of a run.

    Raises RequestError where there are none.
    """
    if result.name == RESULTS and result.is_file():
        return [result.parent]
    if (result / RESULTS).is_file():
        return [result]
    found = sorted(file.parent for file in result.glob(f"*/{RESULTS}") if (file.parent / DONE).is_file())
    if not found:
        allowed = f"a {RESULTS}, the folder of a test, or the --out of a run"
        raise RequestError("no finished results here", file=result, allowed=allowed)
    return found


def read_document(path: Path) -> dict[str, Any]:
    """The JSON document at ``path``, as a run wrote it, of the version that this program reads.

    Raises InputError where it cannot be read or is of another version.
    """
    remedy = "Run the analysis again"
    try:
        document = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError("results that cannot be read", file=path, found=error, remedy=remedy) from error
    stated = document.get("schema_version") if isinstance(document, dict) else None
    if stated != SCHEMA_VERSION or not isinstance(document, dict):
        problem, allowed = "results of another version of the program", f"schema_version {SCHEMA_VERSION}"
        found, remedy = f"schema_version {stated}", f"{remedy} with this version"
        raise InputError(problem, file=path, found=found, allowed=allowed, remedy=remedy)
    return document


def read_findings(folder: Path) -> Findings:
    """Findings of the results in ``folder``.

    Raises InputError where they cannot be read, naming file, place, the value found and what is allowed.
    """
    file = folder / FINDINGS
    return Findings.from_dict(read_document(file), file=file)


def refuse_foreign_index(out: Path) -> None:
    """Refuse a folder ``out`` of results whose batch.json or index.html no run wrote: RequestError."""
    ours = records_in(out) is not None
    found = [name for name in (BATCH, INDEX) if not ours and (out / name).exists()]
    if found:
        problem = "holds a file that no earlier run wrote, where the index of the results would stand"
        remedy = "Choose another --out: nothing of yours is overwritten"
        raise RequestError(problem, file=out, found=", ".join(found), remedy=remedy)


def records_in(out: Path) -> list[Mapping[str, Json]] | None:
    """Records of the tests that ``batch.json`` in ``out`` names; None where there is none that a run wrote."""
    try:
        document = json.loads((out / BATCH).read_bytes())
        records = document["tests"]
        known = document["schema_version"] == BATCH_VERSION and all(
            isinstance(record, Mapping) and {"name", "status", "folder"} <= set(record) for record in records
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return list(records) if known else None
