"""Run planned tests: each recording in a worker of its own, then maps, findings and the published results.

Recordings in memory are analysed as those of a folder are.
"""

from __future__ import annotations

import contextlib
import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from crankorder.batch import result_folder, run_log
from crankorder.batch.frame_store import FrameStore, PackedResult
from crankorder.batch.plan import CampaignPlan, Outcome, RunOptions, publish_index, settings_for
from crankorder.batch.publish import ReportingProcess
from crankorder.batch.store import CHANGED, HashedFile, json_bytes, locked, text_sha256
from crankorder.batch.workers import TooLateError, WorkerDiedError, each
from crankorder.checks.doubts import Doubts, RecordingResult
from crankorder.engine.definition import Engine, load_engine, with_gas_file
from crankorder.engine.forces import orders_made
from crankorder.errors import (
    CrankorderError,
    EnvironmentFailure,
    InputError,
    NoUsableRecordingError,
    RequestError,
    printable,
)
from crankorder.findings import Findings, quality_of
from crankorder.identify.machine_model import Limit, MachineModel, StatedPart, cycle_doubts
from crankorder.ingest import signal_faults
from crankorder.ingest.manifest import Manifest, manifest_head, manifest_of
from crankorder.quantities import QualityFlag, check_dataset, remark
from crankorder.settings import Settings, load_settings, toml_table
from crankorder.shaft import pulses
from crankorder.stages import analyse_recording, analyse_test, compare_recordings, frames_wanted

KINEMATIC_SHARE = 1e-3
"""An order with less than this share of the largest inertia force is not called engine kinematics."""

Progress = Callable[[str, int, int], None]
"""Called with the name of the test, recordings done and recordings in all."""

Analysed = tuple[RecordingResult, bool, float]
"""What a recording gave, whether an earlier run had kept it, and how long (s) that took."""


def run_plans(
    plans: list[CampaignPlan],
    out: Path,
    options: RunOptions,
    *,
    reporting: ReportingProcess,
    watched: Callable[[str], AbstractContextManager[Progress]],
    tell: Callable[[Outcome], None],
    wait: Callable[[str], object] = lambda text: None,
) -> list[Outcome]:
    """Outcome of each of ``plans``, run with ``options``; results and index are published in ``out``.

    ``reporting`` hashes their recordings and writes their files; ``watched`` gives, for the name of a test, the context
    in which its progress is shown; ``tell`` is called with each outcome, ``wait`` with a sentence while another process
    writes the same results.
    """
    outcomes = []
    for plan in plans:
        alone = contextlib.nullcontext() if options.keep_only else locked(plan.out, tell=wait)
        run_log.tell("test begun", test=plan.name, folder=plan.folder, out=plan.out, recordings=len(plan.recordings))
        with watched(plan.name) as progress, alone:
            outcome = run_test(plan, options, reporting=reporting, progress=progress)
        for fault in outcome.faults:
            recording = plan.name_of(Path(fault.file))
            run_log.tell("left out", level=logging.WARNING, test=plan.name, recording=recording, why=fault)
        for note in outcome.notes:
            run_log.tell("left out", level=logging.WARNING, test=plan.name, why=note)
        for error in outcome.internal:
            why = f"{type(error).__name__}: {error}"
            run_log.tell("internal fault", level=logging.ERROR, test=plan.name, why=why)
        counts = {"recordings": len(plan.recordings), "reused": outcome.reused}
        status = "unchanged" if outcome.kept else outcome.status
        run_log.tell("test ended", test=plan.name, status=status, **counts, seconds=dict(outcome.seconds))
        tell(outcome)
        outcomes.append(outcome)
    if not options.keep_only:
        publish_index(out, outcomes, page_of=reporting.index_page, tell=wait)
    return outcomes


def run_test(
    plan: CampaignPlan, options: RunOptions, *, reporting: ReportingProcess, progress: Progress | None = None
) -> Outcome:
    """Analyse the test of ``plan`` with ``options`` and publish its results; no fault of the input is raised.

    ``reporting`` has the hashes of its recordings and writes its files; ``progress`` is called for every recording that
    is done.
    """
    run = _TestRun(plan, options, reporting, progress)
    outcome = run.outcome
    try:
        run.go()
    except CrankorderError as error:
        outcome.faults.append(error)
        outcome.status, outcome.findings = "failed", None
    except Exception as error:
        outcome.internal.append(error)
        outcome.status, outcome.findings = "failed", None
    return outcome


class _TestRun:
    """A test while it is run: what is asked of it, and in ``outcome`` what became of it so far."""

    def __init__(
        self, plan: CampaignPlan, options: RunOptions, reporting: ReportingProcess, progress: Progress | None
    ) -> None:
        self.outcome = Outcome(plan, faults=list(plan.faults))
        self._plan, self._options, self._reporting, self._progress = plan, options, reporting, progress
        self._last = time.perf_counter()

    def go(self) -> None:
        """Run the test, or find that nothing has changed since an earlier run finished it."""
        outcome, options = self.outcome, self._options
        self._made_by, self._hashes = self._reporting.program, self._reporting.hashes(self._plan)
        digests = {path: hashed.sha256 for path, hashed in self._hashes.items()}
        self._plan, altered = self._plan.without_altered(digests)
        plan = self._plan
        outcome.faults += altered
        self._lap("hash")
        code, versions = self._made_by
        provenance = _provenance(plan, code, versions, self._hashes)
        key = text_sha256(json.dumps(provenance, sort_keys=True, default=str), code, str(options.strict))
        if not options.keep_only:
            result_folder.settle(plan.out)
            result_folder.refuse_foreign(plan.out)
            result_folder.refuse_others(plan.out, plan.owner)
        if not options.fresh and not plan.faults and result_folder.finished_with(plan.out, key):
            outcome.status, outcome.kept = "done", True
            outcome.findings = result_folder.read_findings(plan.out)
            return
        results = self._analyse()
        if options.keep_only:
            outcome.status = "kept"
            return
        doubts = compare_recordings(results, strict=options.strict, settings=plan.settings)
        self._lap("recordings")
        outcome.faults += doubts.left_out.values()
        outcome.notes += doubts.channels_left_out
        if len(doubts.left_out) == len(results):
            remedy = "Mend the faults listed above"
            raise NoUsableRecordingError("no recording could be used", file=plan.folder, remedy=remedy)
        self._finish(results, doubts, provenance, key)

    def _lap(self, name: str) -> None:
        """Keep the seconds since the last lap under ``name``."""
        now = time.perf_counter()
        self.outcome.seconds[name] = round(now - self._last, 4)
        self._last = now

    def _analyse(self) -> list[RecordingResult]:
        """Results of the usable recordings in the order of the plan; the faults of the others join the outcome.

        What this program gave of a recording with these hashes before is taken as it was kept.
        """
        plan, options = self._plan, self._options
        wanted, copies = _each_once(plan, self._hashes)
        self.outcome.flags += copies
        self._engine, store = engine_of_test(plan), FrameStore.of(plan.out)
        hashed = {path: {file: self._hashes[file] for file in plan.files_of(path)} for path in wanted}
        program = text_sha256(self._made_by[0], json.dumps(self._made_by[1], sort_keys=True))
        keys = [text_sha256(program, *_recording_parts(plan, path, hashed[path], self._engine)) for path in wanted]
        blamed: dict[str, CrankorderError] = {}
        if options.scheduler is not None:
            if options.fresh:
                store.keep_only(())
            blamed = self._on_cluster(options.scheduler, dict(zip(keys, wanted, strict=True)), hashed, store)

        def analyse(number: int) -> Analysed:
            begun, path = time.perf_counter(), wanted[number]
            if keys[number] in blamed:
                raise blamed[keys[number]]
            kept = None if options.fresh and options.scheduler is None else store.load(keys[number])
            if kept is not None:
                return kept, True, time.perf_counter() - begun
            result = analyse_recording(path, plan.manifest, plan.settings, self._engine)
            _check_unchanged(hashed[path])
            return store.save(keys[number], PackedResult.of(result)), False, time.perf_counter() - begun

        load_kernels()
        results: dict[Path, RecordingResult] = {}
        # no name holds the iterator: where an error leaves this loop, its workers end at once
        for done, (number, answer) in enumerate(
            each(analyse, len(wanted), jobs=options.jobs, timeout_s=options.timeout_s), start=1
        ):
            path = wanted[number]
            result = self._collected(answer, path, hashed[path])
            results |= {} if result is None else {path: result}
            if self._progress is not None:
                self._progress(plan.name, done, len(wanted))
        if not options.keep_only:
            store.keep_only(keys)
        place = {plan.name_of(path): number for number, path in enumerate(plan.recordings)}
        self.outcome.faults.sort(key=lambda fault: place.get(plan.name_of(Path(fault.file)), -1))
        return [results[path] for path in wanted if path in results]

    def _on_cluster(
        self, scheduler: str, wanted: dict[str, Path], hashed: dict[Path, dict[Path, HashedFile]], store: FrameStore
    ) -> dict[str, CrankorderError]:
        """Have the cluster of the ``scheduler`` fill the ``store`` with the recordings ``wanted``; its faults, by key.

        What is kept already is not sent.
        """
        from crankorder.batch.cluster import ClusterTask, analyse_on_cluster

        plan, begun = self._plan, time.perf_counter()
        sha256 = {path: {file.resolve(): of.sha256 for file, of in files.items()} for path, files in hashed.items()}
        tasks = [
            ClusterTask(path.resolve(), plan.name_of(path), key, sha256[path])
            for key, path in wanted.items()
            if not store.path(key).exists()
        ]
        blamed = analyse_on_cluster(
            scheduler,
            tasks,
            (plan.manifest, plan.settings, self._engine),
            made_by=self._made_by,
            store=store,
            progress=lambda done: self._progress and self._progress(plan.name, done, len(tasks)),
        )
        seconds = round(time.perf_counter() - begun, 3)
        run_log.tell("cluster", test=plan.name, at=scheduler, tasks=len(tasks), faults=len(blamed), seconds=seconds)
        return blamed

    def _collected(
        self, answer: Future[Analysed], path: Path, hashed: dict[Path, HashedFile]
    ) -> RecordingResult | None:
        """Result of the recording at ``path``; None where there is none: its fault joins the outcome."""
        outcome, name = self.outcome, self._plan.name_of(path)
        try:
            _check_unchanged(hashed)
            result, reused, seconds = answer.result()
            outcome.reused += reused
            event = "recording reused" if reused else "recording computed"
            run_log.tell(event, test=self._plan.name, recording=name, seconds=round(seconds, 4))
            return result
        except EnvironmentFailure:
            raise
        except CrankorderError as error:
            outcome.faults.append(error)
        except WorkerDiedError as error:
            remedy = "Leave it out; if it is sound, too little memory is the likely cause: try --jobs 1"
            if isinstance(error, TooLateError):
                remedy = "Leave it out, or give it more time with --timeout"
            outcome.faults.append(InputError("could not be analysed", file=name, found=error, remedy=remedy))
        except MemoryError:
            outcome.faults.append(InputError("not enough memory for this recording", file=name))
        except Exception as error:
            error.add_note(f"while analysing {printable(name)}")
            outcome.internal.append(error)
        return None

    def _finish(
        self, results: list[RecordingResult], doubts: Doubts, provenance: Mapping[str, object], key: str
    ) -> None:
        """Make maps and findings of ``results`` and publish their files."""
        plan, outcome = self._plan, self.outcome
        sources = sources_of(plan.manifest, self._engine, plan.settings)
        groups, findings, left_out = results_of_test(
            results, doubts, test=plan.name, sources=sources, settings=plan.settings, flags=outcome.flags,
            faults=outcome.faults, name_of=plan.name_of,
        )  # fmt: skip
        outcome.faults += left_out
        self._lap("test")
        outcome.accuracy = _accuracy_text(groups.get("order_map"))
        stated = {**provenance, "quality": [flag.as_dict() for flag in findings.quality]}
        files = self._reporting.files_of_test(groups, findings, stated, plan.settings.report)
        self._lap("report")
        outcome.findings = findings
        outcome.pictures = tuple(name for name in files if name.startswith("campbell_") and not name.endswith(".pdf"))
        outcome.status = "partial" if outcome.faults else "done"
        key = f"{key} with faults" if outcome.faults else key
        timings = {result_folder.TIMINGS: json_bytes({"seconds": outcome.seconds})}  # no result
        result_folder.publish(plan.out, files, key=key, owner=plan.owner, record=outcome.record, besides=timings)
        self._lap("publish")


def results_of_test(
    results: list[RecordingResult],
    doubts: Doubts,
    *,
    test: str,
    sources: MachineModel,
    settings: Settings,
    faults: list[CrankorderError],
    flags: Sequence[QualityFlag] = (),
    name_of: Callable[[Path], str] = Path.as_posix,
) -> tuple[dict[str, xr.Dataset], Findings, list[CrankorderError]]:
    """Datasets by group and findings of a test, and faults of recordings that the maps leave out.

    The datasets have the dims of ``data_schema/``.

    Parameters
    ----------
    results : those of its recordings
    doubts : recordings and channels to leave out
    test : name of the test
    sources : what the machine is made of
    settings : those of all stages
    faults, flags : of the test so far, which the findings tell too
    name_of : gives the name of the recording in a file
    """
    made = analyse_test(results, doubts, test=test, sources=sources, settings=settings)
    uneven = [flag for flag in made.findings.quality if flag.flag == "frame_length_differs"]
    left_out: list[CrankorderError] = [
        InputError("left out of the order map", file=flag.recording, found=flag.detail) for flag in uneven
    ]
    not_used = [remark(name_of(Path(fault.file)), "not_used", str(fault), "bad") for fault in (*faults, *left_out)]
    highest, orders = settings.orders.max_order, made.findings.orders
    cycle = cycle_doubts(orders, two_stroke=sources.two_stroke, engine=sources.engine, max_order=highest)
    quality = (*made.findings.quality, *quality_of([*flags, *doubts.lengths, *not_used]), *cycle)
    return made.datasets, replace(made.findings, quality=quality), left_out


def _each_once(plan: CampaignPlan, hashes: dict[Path, HashedFile]) -> tuple[list[Path], list[QualityFlag]]:
    """The recordings of ``plan`` of which none is a copy of another, and flags that name the copies."""
    first_of: dict[str, Path] = {}
    wanted, flags = list[Path](), list[QualityFlag]()
    for path in plan.recordings:
        files = [hashes[file] for file in plan.files_of(path)]
        # what cannot be read, and empty files, are no copies of each other: each gets its own error
        content = " ".join(str(file.sha256) for file in files) if all(file.size for file in files) else str(path)
        first = first_of.setdefault(content, path)
        if first == path:
            wanted.append(path)
        else:
            detail = f"the same bytes as {plan.name_of(first)}: counted once"
            flags.append(remark(plan.name_of(path), "duplicate_of", detail))
    return wanted, flags


def _recording_parts(
    plan: CampaignPlan, path: Path, hashed: dict[Path, HashedFile], engine: Engine | None
) -> list[str]:
    """All that the result of the recording at ``path`` depends on beside the program."""
    stated = plan.manifest.model_dump(mode="json", exclude={"recordings": True, "test": {"name"}})
    asked = plan.settings.model_dump(mode="json", exclude={"report"})  # a recording gives the same on any page
    about = (stated, plan.manifest.speed_of(path), asked, [noun.__name__ for noun in frames_wanted(plan.settings)])
    exact = (json.dumps(part, sort_keys=True, default=_listed) for part in (*about, engine))
    return [*(str(one.sha256) for one in hashed.values()), plan.name_of(path), *exact]


def _listed(value: Any) -> Any:
    """What JSON has no word for, exactly: arrays as lists, models as their tables."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return value.model_dump(mode="json") if hasattr(value, "model_dump") else repr(value)


def _check_unchanged(files: dict[Path, HashedFile]) -> None:
    """Refuse what was read of ``files`` where one is not that which was hashed. Raises InputError that names it."""
    for path, hashed in files.items():
        if hashed.fault == CHANGED or (hashed.state is not None and not hashed.is_still_at(path)):
            remedy = "Wait until it is written whole, then run again: nothing of it was kept"
            raise InputError(CHANGED, file=path, remedy=remedy)


def _provenance(
    plan: CampaignPlan, code: str, versions: dict[str, str], hashes: dict[Path, HashedFile]
) -> dict[str, object]:
    """What ``run.json`` states: inputs with hashes, versions, settings; nothing of the host or the time."""
    engine, name = None, plan.manifest.test.engine
    if name is not None:
        engine, _ = with_gas_file(toml_table(name, "engines", beside=plan.folder)[0], name, plan.folder)
    return {
        "schema_version": 1,
        "test": plan.name,
        "code_sha256": code,
        "versions": versions,
        "inputs": [
            {"name": printable(path.relative_to(plan.folder).as_posix()), "sha256": file.sha256, "bytes": file.size}
            for path, file in ((path, hashes[path]) for path in plan.files)
        ],
        "manifest": plan.manifest.model_dump(mode="json"),
        "engine": engine,
        "settings": plan.settings.model_dump(mode="json"),
    }


def _accuracy_text(order_map: xr.Dataset | None) -> str:
    """How the order spectra were made, and the errors asked, predicted and achieved; nothing without them."""
    if order_map is None or "method" not in order_map.attrs:
        return ""
    asked, predicted, achieved = (order_map.attrs[name] for name in ("tolerance", "predicted_error", "achieved_error"))
    measured = "not measured" if np.isnan(achieved) else f"{achieved:.1e} achieved"
    missed = " (missed)" if achieved > asked else ""
    made = f"order spectra by {order_map.attrs['method']}: amplitude error {predicted:.1e} predicted"
    return f"{made}, {measured}, {asked:g} asked{missed}"


def engine_of_test(plan: CampaignPlan) -> Engine | None:
    """The engine that the manifest of the ``plan`` names, if any."""
    name = plan.manifest.test.engine
    return None if name is None else load_engine(name, beside=plan.folder)


def sources_of(manifest: Manifest, engine: Engine | None, settings: Settings) -> MachineModel:
    """MachineModel from ``manifest`` and ``engine``; without the engine's where ``settings`` ask for no findings."""
    orders: tuple[float, ...] = ()
    bearings = manifest.bearings
    if engine is not None and "findings" in settings.report.results:
        orders = orders_made(engine, share=KINEMATIC_SHARE, max_order=int(settings.orders.max_order))
        named = {bearing.name for bearing in bearings}
        bearings += tuple(bearing for bearing in engine.bearings if bearing.name not in named)
    return MachineModel(
        revs_per_cycle=manifest.revs_per_cycle,
        engine_orders=orders,
        bearings=bearings,
        firing=engine is not None and engine.gas is not None,
        gears=tuple(
            StatedPart("gear mesh", gear.name, gear.mesh_order, gear.ratio_share * gear.mesh_order, gear.ratio)
            for gear in manifest.gears
        ),
        engine=engine,
        paths=manifest.transfer_paths,
        added=manifest.added_masses,
        motor=manifest.motor,
        limits=tuple(
            Limit(limit.quantity, *limit.band_hz, limit.value_si, limit.source, limit.channels)
            for limit in manifest.limits
        ),
        rotor_kg=None if manifest.rotor is None else manifest.rotor.mass_kg,
        service_rpm=None if manifest.rotor is None else manifest.rotor.service_rpm,
        two_stroke=manifest.test.cycle == "two-stroke",
    )


def load_kernels() -> None:
    """Load what numba needs before its first kernel runs: a third of a second, once and not in every worker."""
    trace = np.repeat(np.tile(np.array([0.0, 5.0], dtype=np.float32), 8), 4)
    signal_faults.survey(trace, size=16)
    shaft = load_settings().shaft
    pulses.find_pulses(trace, rate_hz=1.0, kind="square", edge="rising", pulses_per_rev=1, settings=shaft)


Recordings = xr.Dataset | Sequence[xr.Dataset]
"""One Recording, or several of one test."""


def engine_of(name: str | None) -> Engine | None:
    """The shipped engine ``name``, or that of a TOML file of this path; None without a name.

    Raises RequestError where there is neither.
    """
    if name is not None and not isinstance(name, str):
        raise RequestError("an engine is a shipped name or a path", file="engine", found=repr(name))
    return None if name is None else load_engine(name)


def analysed(
    recordings: Recordings,
    settings: Settings,
    *,
    tables: Mapping[str, Any],
    engine: str | None = None,
    test: str = "test",
    strict: bool = False,
) -> tuple[dict[str, xr.Dataset], Findings, list[CrankorderError | str]]:
    """Groups and findings of ``recordings``, as a run makes them of files, and what was left out and why.

    The groups are datasets by name with the dims of ``data_schema/``. ``settings`` are those of all stages, ``tables``
    those of the manifest that say what the machine is made of; ``engine`` is its name or path, ``test`` the name of the
    test; ``strict`` also leaves out recordings with "suspect" flags. Raises RequestError or ManyErrors where the
    request is wrong, InputError where no recording can be used.
    """
    given = _each(recordings)
    # manifest of the recordings given with the tables that say what the machine is made of
    first = next(iter(given.values()))
    with_shaft = "four-stroke" if int(first.attrs["revs_per_cycle"]) == 2 else "rotor"
    cycle = with_shaft if first.attrs.get("has_shaft", 1) else "none"
    columns = (first[key].values.tolist() for key in ("channel", "unit"))
    channels = [dict(zip(("name", "unit"), row, strict=True)) for row in zip(*columns, strict=True)]
    stated = {key: dict(table) if isinstance(table, Mapping) else list(table) for key, table in tables.items() if table}
    manifest = manifest_of({**manifest_head(test, cycle, channels), **stated}, Path("machine"))
    settings, known = settings_for(manifest, settings), engine_of(engine)
    faults, results = list[CrankorderError](), list[RecordingResult]()
    for recording in given.values():
        try:
            results.append(analyse_recording(recording, manifest, settings, known))
        except InputError as error:
            faults.append(error)
    doubts = compare_recordings(results, strict=strict, settings=settings)
    faults += doubts.left_out.values()
    if len(doubts.left_out) == len(results):
        raise faults[0] if len(faults) == 1 else NoUsableRecordingError("no recording could be used", found=faults[0])
    sources = sources_of(manifest, known, settings)
    groups, findings, left_out = results_of_test(
        results, doubts, test=test, sources=sources, settings=settings, faults=faults
    )
    return groups, findings, [*faults, *left_out, *doubts.channels_left_out]


def _each(recordings: Recordings) -> dict[str, xr.Dataset]:
    """Recordings by names of their own, their channels in one order; those with other channels are refused."""
    given = list(recordings) if isinstance(recordings, list | tuple) else [recordings]
    if not given:
        raise RequestError("no recording is given", file="recordings", allowed="a Recording, or several of one test")
    named: dict[str, xr.Dataset] = {}
    for recording in given:
        if not isinstance(recording, xr.Dataset):
            raise RequestError("not a Recording", file="recordings", found=type(recording).__name__)
        check_dataset(recording, "recording")
        stem = str(recording.attrs["recording"])
        numbered = chain([stem], (f"{stem} ({number})" for number in count(2)))
        name = next(name for name in numbered if name not in named)
        named[name] = recording.assign_attrs(recording=name)
    first_name, first = next(iter(named.items()))
    order = first["channel"].values.astype(str).tolist()
    for name, recording in named.items():
        if _channels(recording) != _channels(first):
            problem = "the recordings of one test have the same channels, units and cycle"
            allowed = f"as {first_name}: {_channels(first)}"
            raise RequestError(problem, file=name, found=_channels(recording), allowed=allowed)
        channels = recording["channel"].values.astype(str).tolist()
        if channels != order:
            named[name] = recording.isel(channel=[channels.index(channel) for channel in order])
    return named


def _channels(recording: xr.Dataset) -> str:
    """Channels of a recording with their units, and its cycle, in words."""
    rows = zip(recording["channel"].values.astype(str), recording["unit"].values.astype(str), strict=True)
    listed = ", ".join(f"{name} [{unit}]" for name, unit in sorted(rows))
    return f"{listed}; {recording.attrs['revs_per_cycle']} revolutions per cycle"
