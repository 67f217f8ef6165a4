"""Recordings analysed on an existing Dask cluster, one task each, into the store that a run here then finds filled."""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from crankorder.batch.frame_store import FrameStore, PackedResult
from crankorder.batch.store import CHANGED, HashedFile, code_sha256, library_versions
from crankorder.engine.definition import Engine
from crankorder.errors import CrankorderError, EnvironmentFailure, InputError, RequestError, printable
from crankorder.ingest.manifest import Manifest
from crankorder.settings import Settings
from crankorder.stages import analyse_recording

if TYPE_CHECKING:
    from distributed import Client, Future

WAITING_TASKS = 64
"""Tasks that wait beside those that run: so many results may come back at a time, and no more fill the memory."""

PATIENCE_S = 60.0
"""So long a cluster may have no worker."""

CONNECT_S = 10.0
LOOK_S = 2.0
"""Between two looks whether workers are left, where no task gets done."""

THREADS_OF_BLAS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
"""One of these is 1 where products are summed by one thread, as they are here: else the last bits differ."""


@dataclass(frozen=True)
class ClusterJob:
    """What all recordings of a test share: how they are analysed, by which program, and where their results are kept.

    ``probe`` is a file in the store, and what stands in it: a worker that reads it there shares the store.
    """

    manifest: Manifest
    settings: Settings
    engine: Engine | None
    made_by: tuple[str, dict[str, str]]
    store: FrameStore
    probe: tuple[Path, bytes]


@dataclass(frozen=True)
class ClusterTask:
    """One recording: its file, its name in errors, the key of its result, and the hash of each of its files."""

    source: Path
    name: str
    key: str
    sha256: dict[Path, str | None]


def analyse_there(packed_job: bytes, task: ClusterTask) -> bytes | CrankorderError | None:
    """Analyse the recording of ``task`` on a worker, as ``packed_job``, a pickled ClusterJob, says.

    Returns None where the result was put into the shared store, its bytes where the store is not shared. A fault of the
    recording (such as InputError) or of the worker (EnvironmentFailure) is returned, not raised.
    """
    job: ClusterJob = pickle.loads(packed_job)
    try:
        _check_worker(job)
        before = {path: HashedFile.of(path) for path in task.sha256}
        for path, found in before.items():
            if found.sha256 is None and task.sha256[path] is not None and found.fault != CHANGED:
                remedy = "Give a folder that all workers see at the same path"
                raise EnvironmentFailure("a worker cannot read it", file=path, found=found.fault, remedy=remedy)
            if found.sha256 != task.sha256[path]:
                raise InputError(CHANGED, file=path)
        made = PackedResult.of(analyse_recording(task.source, job.manifest, job.settings, job.engine))
        for path, found in before.items():
            if not found.is_still_at(path):
                raise InputError(CHANGED, file=path)
    except CrankorderError as error:
        return error
    if _shares_store(job):
        job.store.save(task.key, made)
        return None
    return made.bytes_of(0, None).tobytes()


def _check_worker(job: ClusterJob) -> None:
    """Raise EnvironmentFailure where this worker would not give the bytes that a run at home gives."""
    code, versions = job.made_by
    here = library_versions()
    differ = [f"{name} {here.get(name)}, not {version}" for name, version in versions.items() if here[name] != version]
    differ += [] if code_sha256() == code else ["another crankorder"]
    if differ:
        remedy = "Install the same versions on all workers"
        raise EnvironmentFailure("a worker has another program", found="; ".join(differ), remedy=remedy)
    if all(os.environ.get(name) != "1" for name in THREADS_OF_BLAS):
        remedy = f"Start workers with {THREADS_OF_BLAS[0]}=1"
        raise EnvironmentFailure("a worker sums products in several threads", remedy=remedy)


def _shares_store(job: ClusterJob) -> bool:
    path, content = job.probe
    with contextlib.suppress(OSError):
        return path.read_bytes() == content
    return False


def analyse_on_cluster(
    scheduler: str,
    tasks: list[ClusterTask],
    job: tuple[Manifest, Settings, Engine | None],
    *,
    made_by: tuple[str, dict[str, str]],
    store: FrameStore,
    progress: Callable[[int], object] = lambda done: None,
) -> dict[str, CrankorderError]:
    """Have a Dask cluster analyse ``tasks`` into ``store``; returns errors of those that end their workers, by key.

    Other faults of a recording are told when it is analysed locally, as no result of it is kept. A recording during
    whose task workers ended is tried once more, alone, and is at fault if they end again.

    Parameters
    ----------
    scheduler : address of the scheduler
    tasks : recordings to analyse
    job : manifest, settings, and the engine or None
    made_by : hash of the program and versions of libraries, which all workers must have
    store : store for the results
    progress : called with the number of recordings that are done

    Raises RequestError without the library, EnvironmentFailure where the cluster cannot be used or has no workers left.
    """
    folder = store.folder
    faults: dict[str, CrankorderError] = {}
    with _connected(scheduler) as client, _probe(folder) as probe:
        packed = pickle.dumps(ClusterJob(*job, made_by, store, probe))
        suspects, done = list[ClusterTask](), 0
        for task, future in _in_turn(client, packed, tasks):
            if _killed(future):
                suspects.append(task)
                continue
            _take(future, task, store)
            done += 1
            progress(done)
        for task in suspects:
            for _, future in _in_turn(client, packed, [task]):
                if _killed(future):
                    remedy = "Leave it out; if it is sound, workers with too little memory are the likely cause"
                    found = "the workers that analysed it ended, also when it was tried alone"
                    faults[task.key] = InputError("could not be analysed", file=task.name, found=found, remedy=remedy)
                else:
                    _take(future, task, store)
            done += 1
            progress(done)
    return faults


@contextlib.contextmanager
def _connected(scheduler: str) -> Iterator[Client]:
    """A client of the ``scheduler`` at that address, once it has a worker."""
    try:
        from distributed import Client
    except ImportError:
        remedy = "pip install 'crankorder[dist]'"
        raise RequestError("needs the library distributed", file="--scheduler", remedy=remedy) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what goes wrong is told here
    remedy = "Give the address that `dask scheduler` says, and start workers with `dask worker ADDRESS`"
    try:
        client = Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError, TypeError) as error:
        raise EnvironmentFailure("no Dask scheduler", file=scheduler, found=printable(error), remedy=remedy) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            raise EnvironmentFailure("the scheduler has no workers", file=scheduler, remedy=remedy) from None
        yield client


@contextlib.contextmanager
def _probe(folder: Path) -> Iterator[tuple[Path, bytes]]:
    """A file in ``folder`` and what stands in it, by which workers see whether they share the folder."""
    path, content = folder / f".{secrets.token_hex(8)}.probe", secrets.token_bytes(32)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        yield path, content
    except OSError as error:
        if isinstance(error, CrankorderError):
            raise
        raise EnvironmentFailure(f"cannot write ({error.strerror})", file=folder) from error
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def _in_turn(client: Client, job: bytes, tasks: list[ClusterTask]) -> Iterator[tuple[ClusterTask, Future[Any]]]:
    """Each of ``tasks`` with its future, once that is done; so many are submitted at a time as can be taken in."""
    from distributed import wait

    left, running = deque(tasks), dict[Any, ClusterTask]()
    seen = time.monotonic()
    while left or running:
        threads = sum(client.nthreads().values())
        while left and len(running) < threads + WAITING_TASKS:
            task = left.popleft()
            name = f"crankorder-{task.key}"
            running[client.submit(analyse_there, job, task, key=name, pure=False, retries=0)] = task
        with contextlib.suppress(TimeoutError):
            wait(list(running), timeout=LOOK_S, return_when="FIRST_COMPLETED")
        ready = [future for future in running if future.done()]
        if ready or threads:
            seen = time.monotonic()
        elif time.monotonic() - seen > PATIENCE_S:
            remedy = "Start workers and run the same command again: what they gave is kept"
            raise EnvironmentFailure("the cluster has no workers left", remedy=remedy)
        for future in ready:
            yield running.pop(future), future
            future.release()


def _killed(future: Future[Any]) -> bool:
    from distributed import KilledWorker

    return future.status == "error" and isinstance(future.exception(), KilledWorker)


def _take(future: Future[Any], task: ClusterTask, store: FrameStore) -> None:
    """Put what ``future`` gave of ``task`` into the ``store``. Raises EnvironmentFailure where the worker will not do.

    Where the task failed otherwise nothing is kept: its recording is analysed at home, where its error is told as ever.
    """
    given = future.result() if future.status == "finished" else None
    if isinstance(given, EnvironmentFailure):
        raise given
    if isinstance(given, bytes):
        data: NDArray[np.uint8] = np.frombuffer(given, dtype=np.uint8)
        store.save(task.key, PackedResult.checked(data))
