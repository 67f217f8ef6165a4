"""What a run will do (tests, recordings, settings; every fault found before work starts), and what became of it."""

from __future__ import annotations

import json
import os
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

from crankorder.batch import result_folder
from crankorder.batch.store import json_bytes, locked, text_sha256, write_atomically
from crankorder.errors import CrankorderError, EnvironmentFailure, ManyErrors, RequestError, printable
from crankorder.ingest.folder import checksum_faults, natural_key, recordings_of
from crankorder.ingest.manifest import Manifest, load_manifest
from crankorder.records import Json
from crankorder.settings import Settings, load_settings

if TYPE_CHECKING:
    from crankorder.findings import Findings
    from crankorder.quantities import QualityFlag

LONGEST_NAME = 80

BESIDE_MESH = 1.5
"""Orders above a stated mesh of teeth that are looked at with it: its first sidebands."""

HIGHEST_STATED = 200.0
"""A stated mesh above this order is looked at only where a recipe asks for orders so high."""


@dataclass(frozen=True)
class CampaignPlan:
    """One test: its folder, manifest, settings, recordings and where its results go."""

    name: str
    folder: Path
    manifest: Manifest
    settings: Settings
    recordings: list[Path]
    out: Path
    owner: result_folder.Owner
    faults: list[CrankorderError] = field(default_factory=list)

    def files_of(self, recording: Path) -> list[Path]:
        """Files that make up the ``recording``: its own, and that of its pulses where it is another."""
        pulses = self.manifest.pulses_of(recording)
        return [recording] if pulses is None else [recording, pulses]

    def name_of(self, path: Path) -> str:
        """Name of the recording at ``path``: its path inside the folder, else the name of its file."""
        if path.is_relative_to(self.folder):
            return path.relative_to(self.folder).as_posix()
        return path.name if path.is_absolute() else path.as_posix()

    def without_altered(self, sha256: Mapping[Path, str | None]) -> tuple[CampaignPlan, list[CrankorderError]]:
        """This plan without recordings that differ from a list of checksums, and the faults of these.

        ``sha256`` are the hashes of its files, None where one could not be read.
        """
        faults = checksum_faults(self.folder, self.files, self.manifest.recordings.files, sha256_of=sha256.get)
        at_fault = {Path(fault.file) for fault in faults}
        kept = [path for path in self.recordings if not at_fault.intersection(self.files_of(path))]
        return replace(self, recordings=kept, faults=[*self.faults, *faults]), faults

    @property
    def files(self) -> list[Path]:
        """Files of all recordings, each once."""
        return list(dict.fromkeys(file for path in self.recordings for file in self.files_of(path)))


@dataclass
class Outcome:
    """Outcome of one test of a run."""

    plan: CampaignPlan
    status: str = "failed"
    faults: list[CrankorderError] = field(default_factory=list)
    internal: list[BaseException] = field(default_factory=list)
    flags: list[QualityFlag] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was left out of recordings that are used for the rest."""
    findings: Findings | None = None
    accuracy: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    reused: int = 0
    """Recordings whose results an earlier run had kept."""
    pictures: tuple[str, ...] = ()
    """Names of its files that show its Campbell diagrams, one by channel."""
    kept: bool = False
    """Whether what an earlier run finished was kept, for nothing had changed."""

    @property
    def exit_status(self) -> int:
        """Exit status of this test alone, as the command line defines it."""
        if self.internal:
            return 1
        if self.status == "failed":
            return next((f.exit_status for f in self.faults if f.exit_status in (2, 4, 5)), 4)
        return 3 if self.faults else 0

    @property
    def record(self) -> dict[str, Json]:
        """Its record in an index: name, status, folder, picture, facts, headline and failed recordings."""
        from crankorder.report.page import index_facts
        from crankorder.report.sentences.story import headline

        facts = {} if self.findings is None else index_facts(self.findings)
        folder = self.plan.out.name
        failed = [{"recording": self.plan.name_of(Path(fault.file)), "error": str(fault)} for fault in self.faults]
        internal = (f"internal fault: {type(error).__name__}: {printable(error)}" for error in self.internal)
        failed += [{"recording": "", "error": error} for error in internal]
        return {
            "name": self.plan.name,
            "status": self.status,
            "folder": folder,
            "link": None if self.status == "failed" else f"{folder}/report.html",
            "recordings": len(self.plan.recordings),
            "picture": f"{folder}/{self.pictures[-1]}" if self.pictures else None,
            "facts": facts,
            "headline": [] if self.findings is None else headline(self.findings),
            "failed": failed,
        }


@dataclass(frozen=True)
class Planned:
    """What a call asks for: the ``tests`` that can be run, and the faults of folders that are ``refused``."""

    tests: list[CampaignPlan]
    refused: list[CrankorderError]


def share_of(plan: CampaignPlan, shard: str) -> CampaignPlan:
    """The ``plan`` with a share of its recordings: of a ``shard`` "2/8" every eighth, from the second on.

    Raises RequestError where ``shard`` names no share.
    """
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", shard)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        allowed = "k/n with k from 1 to n, such as 2/8"
        raise RequestError("no share of the recordings", file="--shard", found=shard, allowed=allowed)
    return replace(plan, recordings=plan.recordings[int(found[1]) - 1 :: int(found[2])])


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How planned tests are run: ``jobs`` recordings at a time, each for ``timeout_s`` (seconds) at most.

    ``fresh`` recomputes kept results too; ``strict`` turns "suspect" flags into faults; with ``keep_only`` (a shard)
    the results of single recordings are kept, and none of the test are made. The Dask cluster at the address
    ``scheduler`` analyses recordings where given.
    """

    jobs: int
    fresh: bool = False
    strict: bool = False
    timeout_s: float | None = None
    keep_only: bool = False
    scheduler: str | None = None


def plan_tests(
    folders: list[Path],
    out: Path,
    *,
    manifest: Path | None = None,
    recipe: str | None = None,
    tolerance: float | None = None,
    max_memory_mb: int | None = None,
    name: str | None = None,
    report: Mapping[str, object] | None = None,
) -> Planned:
    """Plans of the tests in ``folders``, whose results go below ``out``, and the faults of other folders.

    Parameters
    ----------
    folders : folders of the tests
    out : folder below which results go
    manifest : a manifest that lies elsewhere than the data
    recipe : name or path, in place of the recipe that the manifest names
    tolerance : relative amplitude error, in place of that of the recipe
    max_memory_mb : megabytes of samples of one recording in memory, in place of those of the recipe
    name : name of the test, where there is only one, in place of that in its manifest
    report : settings of the report by key, in place of those of the recipe

    Raises RequestError where several tests are given one name. Where no folder can be run, or results would lie where
    they must not, raises the fault, or ManyErrors with those of all folders; nothing has been written then.
    """
    in_memory = {"in_memory_bytes": None if max_memory_mb is None else max_memory_mb * 1_000_000}
    asked = {"orders": {"tolerance": tolerance}, "report": report or {}, "ingest": in_memory}
    folders = list({folder.resolve(): folder for folder in folders}.values())
    if name is not None and len(folders) > 1:
        raise RequestError("one name for several tests", file="--name", found=name, remedy="Run each test by itself")
    result_folder.refuse_foreign_index(out)
    plans: list[CampaignPlan] = []
    faults: list[CrankorderError] = []
    places = _Places(out, folders)

    def plan_of(folder: Path) -> CampaignPlan:
        if not folder.is_dir():
            remedy = "Give the folder that holds run.toml and the recordings"
            raise RequestError("no such folder", file=folder, remedy=remedy)
        stated = load_manifest(folder, manifest)
        chosen = recipe if recipe is not None else stated.test.recipe
        beside = manifest.parent if manifest is not None else folder
        settings = settings_for(stated, load_settings(chosen, beside=beside if recipe is None else None, asked=asked))
        found = recordings_of(folder, stated)
        test = name or stated.test.name or folder.resolve().name
        content = text_sha256(json.dumps(stated.model_dump(mode="json"), sort_keys=True))
        owner = result_folder.Owner(_relative(folder, out), content)
        place = places.of(test, owner)
        return CampaignPlan(test, folder, stated, settings, list(found.paths), place, owner, list(found.faults))

    # a test's place must not depend on the order of the folders in the call
    for folder in sorted(folders, key=lambda folder: natural_key(folder.resolve())):
        try:
            plans.append(plan_of(folder))
        except ManyErrors as error:
            faults += error.faults
        except CrankorderError as error:
            faults.append(error)
    if not plans or places.refuse:
        raise faults[0] if len(faults) == 1 else ManyErrors(faults)
    return Planned(sorted(plans, key=lambda plan: folders.index(plan.folder)), faults)


class _Places:
    """Where results may go: below ``out``, each test of a call at a place of its own, away from all its ``folders``."""

    def __init__(self, out: Path, folders: list[Path]) -> None:
        self._out, self._folders = out, folders
        self._taken = {result_folder.BATCH, result_folder.INDEX}
        self.refuse = False
        """Whether a place was refused: then nothing of the call is written."""
        self._of_call = {_relative(folder, out) for folder in folders}
        finished = result_folder.finished_tests(out) if out.is_dir() else ()
        self._owners = {folder.name: marker.input for folder, marker in finished}

    def of(self, test: str, owner: result_folder.Owner) -> Path:
        """Folder for the results of ``test``: that which holds those of ``owner``, else the first that is free.

        Tests of one name in one call get numbers behind it. Raises RequestError where results would replace what is
        no result of this test.
        """
        first = _plain_name(test)
        numbered = re.compile(rf"{re.escape(first)}(-[0-9]+)?", re.IGNORECASE)
        own = [name for name, found in self._owners.items() if found is not None and found.folder == owner.folder]
        own = [name for name in own if numbered.fullmatch(name) and name.lower() not in self._taken]
        chosen = min(own, key=len, default="") or _numbered(first, self._is_taken)
        self._taken.add(chosen.lower())
        place = self._out / chosen
        try:
            for folder in self._folders:
                inside, outside = folder.resolve(), place.resolve()
                if outside == inside or inside in outside.parents or outside in inside.parents:
                    problem = "the results would lie in the folder of the recordings, or around it"
                    remedy = "Choose another --out: recordings are never touched"
                    raise RequestError(problem, file=place, allowed="any folder outside the recordings", remedy=remedy)
            result_folder.refuse_foreign(place)
            result_folder.refuse_others(place, owner)
        except RequestError:
            self.refuse = True
            raise
        return place

    def _is_taken(self, name: str) -> bool:
        """Whether a test of this very call has this ``name``, or has its results there."""
        found = self._owners.get(name)
        return name.lower() in self._taken or (found is not None and found.folder in self._of_call)


def _relative(folder: Path, out: Path) -> str:
    return Path(os.path.relpath(folder.resolve(), out.resolve())).as_posix()


def settings_for(stated: Manifest, settings: Settings) -> Settings:
    """``settings`` adapted to a test by its manifest ``stated``.

    The highest order is raised to hold the lines of its gears and motor. A recording of the shaft alone has no
    vibration, so that nothing is asked of it.
    """
    if stated.of_shaft_alone:
        return settings.model_copy(update={"report": settings.report.model_copy(update={"results": ()})})
    meshes = [gear.mesh_order for gear in stated.gears]
    if stated.motor is not None:
        meshes.append(stated.motor.highest_order)
    top = max((mesh + BESIDE_MESH for mesh in meshes if mesh <= HIGHEST_STATED), default=0.0)
    if top <= settings.orders.max_order:
        return settings
    return settings.model_copy(update={"orders": settings.orders.model_copy(update={"max_order": top})})


def folder_name(name: str, taken: set[str]) -> str:
    """File name made of the letters, digits, ``-``, ``_``, ``.`` of ``name``, not yet in ``taken`` (which it joins)."""
    unique = _numbered(_plain_name(name), lambda name: name.lower() in taken)
    taken.add(unique.lower())
    return unique


def _numbered(first: str, is_taken: Callable[[str], bool]) -> str:
    """``first``, with the lowest number from 2 on behind it where it is taken."""
    numbered = (f"{first}-{number}" for number in count(2))
    return next(name for name in chain([first], numbered) if not is_taken(name))


def _plain_name(name: str) -> str:
    plain = unicodedata.normalize("NFKD", printable(name)).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip("-.")[:LONGEST_NAME] or "test"


def index_document(records: Sequence[Mapping[str, Json]]) -> dict[str, Json]:
    """Document of ``batch.json`` and ``--json``: name, status, folder, headline and failed recordings of each test.

    ``records`` are those of the outcomes.
    """
    return {"schema_version": result_folder.BATCH_VERSION, "tests": records}


def publish_index(
    out: Path,
    outcomes: list[Outcome],
    *,
    page_of: Callable[[Sequence[Mapping[str, Json]]], str],
    tell: Callable[[str], object] = lambda text: None,
) -> None:
    """Write ``batch.json`` and ``index.html`` of all tests in ``out``: those of ``outcomes`` and those of other runs.

    Finished tests are found by their own folders; a test that failed stays named until it is done. ``page_of`` makes
    the page of the records; ``tell`` is called with a sentence while another process is waited for. Raises
    EnvironmentFailure where the files cannot be written.
    """
    with locked(out / result_folder.BATCH, tell=tell):
        try:
            now = {outcome.plan.out.name: outcome.record for outcome in outcomes if outcome.status == "failed"}
            done = {outcome.plan.out.name for outcome in outcomes} - set(now)
            finished = result_folder.finished_tests(out)
            records = {folder.name: marker.record for folder, marker in finished if marker.record}
            failed = [record for record in result_folder.records_in(out) or [] if record["status"] == "failed"]
            records |= {str(record["folder"]): record for record in failed if record["folder"] not in done} | now
            tests = [records[name] for name in sorted(records, key=lambda name: natural_key(Path(name)))]
            write_atomically(out / result_folder.BATCH, json_bytes(index_document(tests)))
            write_atomically(out / result_folder.INDEX, page_of(tests).encode("utf-8", "backslashreplace"))
        except OSError as error:
            if isinstance(error, EnvironmentFailure):
                raise
            raise EnvironmentFailure(f"cannot write ({error.strerror})", file=error.filename or out) from error
