"""Run planned tests: each recording in a worker of its own, then maps, findings and the published results."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr

from crankorder.batch.calibrate import knowledge_of
from crankorder.batch.changed_gains import without_changed_gains
from crankorder.batch.outcome import Outcome
from crankorder.batch.plan import TestPlan
from crankorder.batch.reporting import ReportingProcess
from crankorder.batch.result_folder import TIMINGS, finished_with, publish, refuse_foreign, refuse_others, settle
from crankorder.batch.store import CHANGED, HashedFile, json_bytes, text_sha256
from crankorder.batch.unsought import unsought_findings
from crankorder.batch.workers import WorkerDiedError, each
from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import orders_made
from crankorder.errors import CrankorderError, EnvironmentFailure, InputError, NoUsableRecordingError, printable
from crankorder.identify.sources import Sources
from crankorder.ingest.manifest import Manifest
from crankorder.orders.true_angle import NAMES
from crankorder.quantities import QualityFlag, Severity
from crankorder.report.contradictions import contradiction_flags
from crankorder.settings import Settings, toml_table
from crankorder.shaft.tooth_errors import speed_swing
from crankorder.stages import RecordingResult, analyse_recording, analyse_test

Progress = Callable[[str, int, int], None]
"""Called with the name of the test, recordings done and recordings in all."""


def run_test(
    plan: TestPlan,
    *,
    reporting: ReportingProcess,
    jobs: int,
    fresh: bool,
    strict: bool,
    progress: Progress | None = None,
) -> Outcome:
    """Analyse the test of ``plan`` and publish its results; nothing is raised for a fault of the input.

    ``reporting`` has the hashes of its recordings and writes its files; ``jobs`` recordings are analysed at a time,
    each in a worker of its own; ``fresh`` recomputes even what is finished; ``strict`` turns "suspect" flags into
    faults;
    ``progress`` is told of every recording that is done.
    """
    outcome = Outcome(plan, faults=list(plan.faults))
    clock = _Clock(outcome.seconds)
    try:
        (code, versions), hashes = reporting.program(), reporting.hashes(plan)
        clock.lap("hash")
        provenance = _provenance(plan, code, versions, hashes)
        key = text_sha256(json.dumps(provenance, sort_keys=True, default=str), code, str(strict))
        settle(plan.out)
        refuse_foreign(plan.out)
        refuse_others(plan.out, plan.owner)
        if not fresh and not plan.faults and finished_with(plan.out, key):
            outcome.status, outcome.kept = "done", True
            outcome.findings = json.loads((plan.out / "findings.json").read_bytes())
            return outcome
        first_run = _load_kernels()
        results = _analyse(plan, hashes, jobs, outcome, progress, one_first=first_run)
        results = without_changed_gains(results, settings=plan.settings.ingest)
        clock.lap("recordings")
        outcome.faults += left_out_of(results, ("bad", "suspect") if strict else ("bad",))
        if not results:
            raise NoUsableRecordingError(
                "no recording could be used",
                file=plan.folder,
                remedy="Mend the faults listed above",
            )
        _finish(plan, results, provenance, key, outcome, reporting, clock)
    except CrankorderError as error:
        outcome.faults.append(error)
    except Exception as error:
        outcome.internal.append(error)
    return outcome


def _load_kernels() -> bool:
    """Load what numba needs before its first kernel runs: a third of a second, once and not in every worker.

    True where a kernel had to be compiled for it: then this is the first run, and the others must be compiled too.
    """
    from crankorder.ingest import channel_faults
    from crankorder.settings import load_settings
    from crankorder.shaft import pulses

    before = _compiled(pulses) + _compiled(channel_faults)
    trace = np.repeat(np.tile(np.array([0.0, 5.0], dtype=np.float32), 8), 4)
    channel_faults.survey(trace, size=16)
    shaft = load_settings().shaft
    pulses.find_pulses(trace, rate_hz=1.0, kind="square", edge="rising", pulses_per_rev=1, settings=shaft)
    return _compiled(pulses) + _compiled(channel_faults) > before


def _compiled(module: ModuleType) -> int:
    """How many kernels of ``module`` were not found compiled."""
    from numba.core.dispatcher import Dispatcher

    kernels = [kernel for kernel in vars(module).values() if isinstance(kernel, Dispatcher)]
    return sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels)


def _finish(
    plan: TestPlan,
    results: dict[Path, RecordingResult],
    provenance: dict[str, Any],
    key: str,
    outcome: Outcome,
    reporting: ReportingProcess,
    clock: _Clock,
) -> None:
    """Maps, findings, files and their publication."""
    sources = sources_of(plan.manifest, _engine(plan), plan.settings)
    groups, findings, left_out = results_of_test(
        results, test=plan.name, sources=sources, settings=plan.settings, flags=outcome.flags, faults=outcome.faults
    )
    outcome.faults += left_out
    clock.lap("test")
    outcome.accuracy = _accuracy_text(groups.get("order_map"))
    stated = {**provenance, "quality": findings["quality"]}
    files = reporting.files_of_test(groups, findings, stated, plan.settings.report)
    clock.lap("report")
    outcome.findings = findings
    outcome.status = "partial" if outcome.faults else "done"
    publish(
        plan.out,
        files,
        key=f"{key} with faults" if outcome.faults else key,
        owner=plan.owner,
        record=outcome.record,
        # timings are no result
        besides={TIMINGS: json_bytes({"seconds": outcome.seconds})},
    )
    clock.lap("publish")


def results_of_test(
    results: dict[Path, RecordingResult],
    *,
    test: str,
    sources: Sources,
    settings: Settings,
    flags: list[QualityFlag],
    faults: list[CrankorderError],
) -> tuple[dict[str, xr.Dataset], dict[str, Any], list[CrankorderError]]:
    """Datasets by group and findings of the ``test`` of that name, and faults of recordings that the maps leave out.

    ``results`` of its recordings by file; ``sources``: what the machine is made of; ``settings`` of all stages;
    ``flags`` and ``faults`` of the test so far, which the findings tell too.
    """
    made = analyse_test(list(results.values()), test=test, sources=sources, settings=settings)
    if made.findings is not None:
        findings = dict(made.findings)
    else:
        findings = unsought_findings(made.datasets, test=test, settings=settings)
    left_out: list[CrankorderError] = [
        InputError("left out of the order map", file=flag["recording"], found=flag["detail"])
        for flag in findings["quality"]
        if flag["flag"] == "frame_length_differs"
    ]
    told = [flag for result in results.values() for flag in result.flags if flag not in findings["quality"]]
    findings["quality"] = [*findings["quality"], *told, *flags, *_fault_flags([*faults, *left_out])]
    most_deg = settings.orders.largest_eccentricity_deg
    findings["speed_swing"] = _swing_records(results, findings["quality"], most_deg=most_deg)
    findings["quality"] += contradiction_flags(findings)
    return made.datasets, findings, left_out


class _Clock:
    """Seconds between laps, kept by name."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self._seconds, self._last = seconds, time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self._seconds[name] = round(now - self._last, 4)
        self._last = now


def _analyse(
    plan: TestPlan,
    hashes: dict[Path, HashedFile],
    jobs: int,
    outcome: Outcome,
    progress: Progress | None,
    *,
    one_first: bool,
) -> dict[Path, RecordingResult]:
    """Results of the usable recordings in the order of the plan; the faults of the others join the outcome.

    With ``one_first`` the kernels are yet to be compiled: by one worker, not by all at once.
    """
    results: dict[Path, RecordingResult] = {}
    first_of: dict[str, Path] = {}
    # what cannot be read, and empty files, are no copies of each other: each gets its own error
    alike = {path: found.sha256 for path, found in hashes.items() if found.state is not None and found.state.size}
    wanted = [path for path in plan.recordings if first_of.setdefault(alike.get(path) or str(path), path) == path]
    outcome.flags += [
        {
            "recording": path.name,
            "flag": "duplicate_of",
            "severity": "info",
            "detail": f"the same bytes as {first_of[alike[path] or ''].name}: counted once",
        }
        for path in plan.recordings
        if path not in wanted
    ]
    knowledge, flags = knowledge_of(plan, _engine(plan), wanted, jobs)
    outcome.flags += flags

    def analyse(number: int) -> RecordingResult:
        return analyse_recording(wanted[number], plan.manifest, plan.settings, knowledge)

    for count, (number, made) in enumerate(each(analyse, len(wanted), jobs=jobs, one_first=one_first), start=1):
        _collect(made, wanted[number], hashes[wanted[number]], results, outcome)
        if progress is not None:
            progress(plan.name, count, len(wanted))
    place = {path.name: number for number, path in enumerate(plan.recordings)}
    outcome.faults.sort(key=lambda fault: place.get(Path(fault.file).name, -1))
    return {path: results[path] for path in wanted if path in results}


def _collect(
    made: Callable[[], RecordingResult],
    path: Path,
    hashed: HashedFile,
    results: dict[Path, RecordingResult],
    outcome: Outcome,
) -> None:
    if hashed.fault == CHANGED or (hashed.state is not None and not hashed.is_still_at(path)):
        remedy = "Wait until it is written whole, then run again: nothing of it was kept"
        outcome.faults.append(InputError(CHANGED, file=path.name, remedy=remedy))
        return
    try:
        results[path] = made()
    except EnvironmentFailure:
        raise
    except CrankorderError as error:
        outcome.faults.append(error)
    except WorkerDiedError as error:
        remedy = "Leave it out; if it is sound, too little memory is the likely cause: try --jobs 1"
        outcome.faults.append(InputError("could not be analysed", file=path.name, found=error, remedy=remedy))
    except MemoryError:
        outcome.faults.append(InputError("not enough memory for this recording", file=path.name))
    except Exception as error:
        error.add_note(f"while analysing {printable(path.name)}")
        outcome.internal.append(error)


def left_out_of(results: dict[Path, RecordingResult], severities: tuple[Severity, ...]) -> list[CrankorderError]:
    """Faults of the recordings that leave ``results`` (changed in place): bad data take no part in averages.

    Those with a flag of one of ``severities`` leave; what a flag says was left out already, a channel or a stretch of
    it, does not take the recording along.
    """
    faults: list[CrankorderError] = []
    for path, result in list(results.items()):
        doubts = [
            flag
            for flag in result.flags
            if flag["severity"] in severities and ("suspect" in severities or "left_out" not in flag)
        ]
        if doubts:
            del results[path]
            found = "; ".join(f"{flag['flag']} ({flag['detail']})" for flag in doubts)
            problem = "left out of all averages" if severities == ("bad",) else "refused by --strict"
            faults.append(InputError(problem, file=path.name, found=found))
            continue
        faults += [
            InputError("one channel left out of all averages", file=path.name, place=place, found=found)
            for place, found in _channels_left_out(result.flags).items()
        ]
    return faults


def _channels_left_out(flags: list[QualityFlag]) -> dict[str, str]:
    """Why each channel was left out that was."""
    found: dict[str, str] = {}
    for flag in flags:
        if flag.get("left_out") == "channel" and flag["severity"] == "bad":
            name, said = flag["channel"], f"{flag['flag']} ({flag['detail']})"
            found[name] = f"{found[name]}; {said}" if name in found else said
    return found


KINEMATIC_SHARE = 1e-3
"""An order with less than this share of the largest inertia force is not called engine kinematics."""


def _engine(plan: TestPlan) -> Engine | None:
    """The engine that the manifest names, if any."""
    name = plan.manifest.test.engine
    return None if name is None else load_engine(name, beside=plan.folder)


def sources_of(manifest: Manifest, engine: Engine | None, settings: Settings) -> Sources:
    """What ``manifest`` and ``engine`` say of the machine; less where ``settings`` ask for no findings that need it."""
    orders: tuple[float, ...] = ()
    bearings = manifest.bearings
    if engine is not None and "findings" in settings.report.results:
        orders = orders_made(engine, share=KINEMATIC_SHARE, max_order=int(settings.orders.max_order))
        named = {bearing.name for bearing in bearings}
        bearings += tuple(bearing for bearing in engine.bearings if bearing.name not in named)
    return Sources(
        revs_per_cycle=manifest.revs_per_cycle,
        engine_orders=orders,
        bearings=bearings,
        firing=engine is not None and engine.gas is not None,
        gears=tuple((gear.name, gear.mesh_order) for gear in manifest.gears),
        engine=engine,
        paths=manifest.transfer_paths,
        added=manifest.added_masses,
        motor=manifest.motor,
    )


def _provenance(plan: TestPlan, code: str, versions: dict[str, str], hashes: dict[Path, HashedFile]) -> dict[str, Any]:
    """What ``run.json`` states: inputs with hashes, versions, settings; nothing of the host or the time."""
    engine = None
    if plan.manifest.test.engine is not None:
        engine = toml_table(plan.manifest.test.engine, "engines", beside=plan.folder)[0]
    return {
        "schema_version": 1,
        "test": plan.name,
        "code_sha256": code,
        "versions": versions,
        "inputs": [
            {
                "name": printable(path.relative_to(plan.folder).as_posix()),
                "sha256": hashes[path].sha256,
                "bytes": _size(path, hashes[path]),
            }
            for path in plan.recordings
        ],
        "manifest": plan.manifest.model_dump(mode="json"),
        "engine": engine,
        "settings": plan.settings.model_dump(mode="json"),
    }


def _size(path: Path, hashed: HashedFile) -> int | None:
    """Bytes of the file at ``path`` as it was ``hashed``; as it is where it could not be, None where it is gone."""
    if hashed.state is not None:
        return hashed.state.size
    with contextlib.suppress(OSError):
        return path.stat().st_size
    return None


def _accuracy_text(order_map: xr.Dataset | None) -> str:
    """How the order spectra were made, and the errors asked, predicted and achieved; nothing without them."""
    if order_map is None or "method" not in order_map.attrs:
        return ""
    asked, predicted, achieved = (order_map.attrs[name] for name in ("tolerance", "predicted_error", "achieved_error"))
    measured = "not measured" if np.isnan(achieved) else f"{achieved:.1e} achieved"
    missed = " (missed)" if achieved > asked else ""
    return (
        f"order spectra by {order_map.attrs['method']}: amplitude error {predicted:.1e} predicted, {measured}, "
        f"{asked:g} asked{missed}"
    )


def _swing_records(
    results: dict[Path, RecordingResult], flags: list[QualityFlag], *, most_deg: float
) -> list[dict[str, Any]]:
    """Swing of the speed of every recording within its cycle, by order, the largest first; only what is certain.

    What ``flags`` say that the encoder itself makes is no motion of the shaft. An encoder that is off by ``most_deg``
    once per turn, by 1/k² of it at harmonic k, could show those that are no larger.
    """
    of_encoder = {order for order, name in NAMES.items() if any(flag["flag"] == f"encoder_{name}" for flag in flags)}
    records = []
    for path, result in results.items():
        swing = speed_swing(result.shaft)
        if swing is None:
            continue
        sure = swing.told & ~np.isin(swing.orders, list(of_encoder))
        for place in sorted(np.flatnonzero(sure).tolist(), key=lambda at: -swing.amplitude_rpm[at]):
            order, amplitude_rpm = float(swing.orders[place]), float(swing.amplitude_rpm[place])
            off_deg = np.degrees(amplitude_rpm / swing.speed_rpm / order)
            records.append(
                {
                    "recording": printable(path.name),
                    "speed_rpm": swing.speed_rpm,
                    "order": order,
                    "amplitude_rpm": amplitude_rpm,
                    "may_be_encoder": order in NAMES and bool(off_deg <= most_deg / order**2),
                    "steady_rpm": float(swing.steady_rpm[place]),
                }
            )
    return records


def _fault_flags(faults: list[CrankorderError]) -> list[QualityFlag]:
    return [
        {"recording": Path(fault.file).name, "flag": "not_used", "severity": "bad", "detail": str(fault)}
        for fault in faults
    ]
