"""Processes that share one import: forked from this one when its modules are there, each working on its own.

A worker that dies (a crash inside a file library, a kill) takes one task with it and no more. Where the system has no
safe fork (Windows, macOS) the same calls run in threads.
"""

from __future__ import annotations

import contextlib
import gc
import mmap
import os
import pickle
import signal
import sys
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, Pipe, wait
from pathlib import Path
from typing import Any

from crankorder.batch.store import forget_locks
from crankorder.scratch import keep_freed_memory, scratch_folder

FORKS = sys.platform == "linux"
"""Whether workers are processes; the libraries used here survive a fork on Linux alone."""

_ours: list[Connection] = []
"""This process's ends of the lines to its workers: a worker closes them, so that it ends when this process does."""


class WorkerDiedError(Exception):
    """A worker ended without an answer; the text says by what signal or status."""


class TooLateError(WorkerDiedError):
    """A worker was ended because its task took too long; the text says how long it had."""


class RemoteTraceback(Exception):
    """Where in a worker an error was raised, as text: the cause of that error here."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


MOST_BYTES = 1 << 40
"""Addresses set aside for one direction of one worker; room is taken only as they are written."""

MEMORY_BYTES = 1 << 26
"""So much of them is memory; what lies behind is a file without a name, whose pages the system writes out as needed."""

CLAIMED_BYTES = 1 << 24
"""Room on the disk is claimed in pieces of this size, so that a full disk is told and kills nobody."""

LEAST_BYTES = 1 << 14
"""A smaller array goes through the pipe: pages of its own would cost more."""

ALIGNED = 64
"""Arrays begin at multiples of this, as the processor's caches and vectors like them."""

NO_RESERVE = 0x4000
"""``MAP_NORESERVE`` of Linux, which the module mmap does not name."""

Place = tuple[bool, int, int]
"""Whether an array lies in the file, its first byte there, and the byte after its last."""


class SharedPages:
    """What one process says to another, laid one behind the other; what is read there stays valid while it is held.

    The first of it lies in memory, all else in a file without a name: so a process may hold more than its memory.
    """

    def __init__(self) -> None:
        """Set the addresses aside; where the system refuses, all goes through the pipe."""
        self._used, self._claimed = {False: 0, True: 0}, 0
        self._pages: dict[bool, memoryview] = {}
        self._file = -1
        with contextlib.suppress(OSError, ValueError, OverflowError):
            flags = mmap.MAP_SHARED | mmap.MAP_ANONYMOUS | NO_RESERVE
            self._pages[False] = memoryview(mmap.mmap(-1, MEMORY_BYTES, flags=flags))
        with contextlib.suppress(OSError, ValueError, OverflowError):
            self._file, path = tempfile.mkstemp(dir=scratch_folder(), prefix="crankorder-")
            Path(path).unlink()
            os.truncate(self._file, MOST_BYTES)
            self._pages[True] = memoryview(mmap.mmap(self._file, MOST_BYTES, flags=mmap.MAP_SHARED | NO_RESERVE))

    def __del__(self) -> None:
        """Let go of the file; what was mapped of it stays while it is held."""
        if self._file >= 0:
            os.close(self._file)

    def put(self, value: Any) -> tuple[bytes, list[Place]]:
        """Pickle of ``value`` without its large arrays, and where each of these lies."""
        places: list[Place] = []

        def is_small(buffer: pickle.PickleBuffer) -> bool:
            raw = buffer.raw()
            place = None if raw.nbytes < LEAST_BYTES else self._room(raw.nbytes)
            if place is None:
                return True
            on_disk, begin, end = place
            self._pages[on_disk][begin:end] = raw
            places.append(place)
            return False

        return pickle.dumps(value, protocol=5, buffer_callback=is_small), places

    def _room(self, size: int) -> Place | None:
        """Room for ``size`` bytes, None where there is none."""
        for on_disk in self._pages:
            begin = -(-self._used[on_disk] // ALIGNED) * ALIGNED
            end = begin + size
            if end <= len(self._pages[on_disk]) and (not on_disk or self._claim(end)):
                self._used[on_disk] = end
                return on_disk, begin, end
        return None

    def _claim(self, end: int) -> bool:
        """Whether the disk has room for the file up to the byte ``end``."""
        if end > self._claimed:
            size = -(-(end - self._claimed) // CLAIMED_BYTES) * CLAIMED_BYTES
            try:
                os.posix_fallocate(self._file, self._claimed, size)
            except OSError:
                return False
            self._claimed += size
        return True

    def get(self, packed: tuple[bytes, list[Place]]) -> Any:
        """The value that was ``packed`` by :meth:`put` in the other process; its arrays lie where they were put."""
        data, places = packed
        return pickle.loads(data, buffers=[self._pages[on_disk][begin:end] for on_disk, begin, end in places])


class Worker:
    """A process that does ``task`` for each request, in the order in which they are asked."""

    def __init__(self, task: Callable[[Any], Any]) -> None:
        """Start a worker that does ``task``; it has all that this process has imported and made so far."""
        self._task = task
        self._waiting: list[Any] = []
        self._too_late = ""
        self.connection: Connection | None = None
        if FORKS:
            self._fork()

    def _fork(self) -> None:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
        ours, theirs = Pipe()
        self._requests, self._answers = SharedPages(), SharedPages()
        gc.freeze()  # what exists stays in pages that both share
        self.pid = os.fork()
        if self.pid == 0:
            ours.close()
            _serve(self._task, theirs, self._requests, self._answers)
        gc.unfreeze()
        theirs.close()
        self.connection = ours
        _ours.append(ours)

    def ask(self, request: Any) -> None:
        """Hand over one ``request``; its answer comes after those of earlier ones."""
        if self.connection is None:
            self._waiting.append(request)
            return
        with contextlib.suppress(OSError):  # its end is told by answer()
            self.connection.send(self._requests.put(request))

    def answer(self) -> Any:
        """Answer to the earliest request that has none yet.

        Raises what the task raised; WorkerDiedError where the worker is gone.
        """
        if self.connection is None:
            return self._task(self._waiting.pop(0))
        if self.dead:
            raise WorkerDiedError("its worker had ended before")
        try:
            packed = self.connection.recv()
        except (EOFError, ConnectionResetError):
            self._forget()
            code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
            how = f"ended with status {code}" if code >= 0 else f"was ended by {signal.Signals(-code).name}"
            late = self._too_late
            raise (TooLateError(late) if late else WorkerDiedError(f"its worker {how}")) from None
        done, value, where = self._answers.get(packed)
        if done:
            return value
        value.__cause__ = RemoteTraceback(where)
        raise value

    @property
    def dead(self) -> bool:
        """Whether the worker has ended."""
        return self.connection is not None and self.connection.closed

    def end_late(self, seconds: float) -> None:
        """End the worker because its task had ``seconds`` and did not get done; its answer says so."""
        self._too_late = f"it took longer than {seconds:g} s"
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)

    def _forget(self) -> None:
        assert self.connection is not None
        _ours.remove(self.connection)
        self.connection.close()

    def close(self) -> None:
        """End the worker, in the middle of its task if it has one."""
        if self.connection is None or self.dead:
            return
        self._forget()
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)


def _serve(task: Callable[[Any], Any], connection: Connection, requests: SharedPages, answers: SharedPages) -> None:
    """Answer requests until the other end closes; never return."""
    status = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal tells the whole group; the parent ends its workers
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        forget_locks()
        keep_freed_memory()
        while _ours:
            _ours.pop().close()
        _ours.append(connection)  # for the workers of this worker
        while True:
            connection.send(answers.put(_answer(task, requests.get(connection.recv()))))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        status = 0
    except BaseException:  # nothing may leave: this is a copy of a program that goes on elsewhere
        traceback.print_exc()
    finally:
        os._exit(status)


def _answer(task: Callable[[Any], Any], request: Any) -> tuple[bool, Any, str]:
    try:
        return True, task(request), ""
    except BaseException as error:
        where = traceback.format_exc()
        try:
            from multiprocessing.reduction import ForkingPickler

            ForkingPickler.loads(ForkingPickler.dumps(error))
        except Exception:
            error = RuntimeError(f"{type(error).__name__}: {error}")
        return False, error, where


AHEAD = 2
"""Tasks that a worker is given at a time: it begins the second while this process takes in the answer to the first."""


def each(
    task: Callable[[int], Any],
    count: int,
    *,
    jobs: int,
    meanwhile: Callable[[], object] | None = None,
    one_first: bool = False,
    timeout_s: float | None = None,
) -> Iterator[tuple[int, Callable[[], Any]]]:
    """Number and answer of ``task(0)`` … ``task(count - 1)``, ``jobs`` at a time, as they are done.

    The answer is a call that gives the value or raises what the task raised; WorkerDiedError where its process died:
    the others go on in a new one. ``meanwhile`` is done here once the workers have begun. With ``one_first`` a single
    worker begins, and the others after its first value: they find what it has left on disk, such as compiled kernels.
    A task that takes longer than ``timeout_s`` is ended with its process: TooLateError. Threads cannot be ended.
    """
    if not FORKS:
        yield from _each_in_threads(task, count, jobs, meanwhile)
        return
    left = deque(range(count))
    busy: dict[Any, tuple[Worker, deque[int]]] = {}
    begun: dict[Any, float] = {}

    def go_on(worker: Worker, asked: deque[int]) -> None:
        # as many as there are workers are kept back, so that none waits while another has two
        while left and (not asked or (len(asked) < AHEAD and len(left) >= jobs)):
            asked.append(left.popleft())
            worker.ask(asked[-1])
        if asked:
            busy[worker.connection] = (worker, asked)
            begun[worker.connection] = time.monotonic()
        else:
            worker.close()

    try:
        for _ in range(min(1 if one_first else jobs, count)):
            go_on(Worker(task), deque())
        if meanwhile is not None:
            meanwhile()
        while busy:
            for line in _ready(busy, begun, timeout_s):
                worker, asked = busy.pop(line)
                number, (done, answer) = asked.popleft(), _kept(worker)
                if worker.dead:
                    left.extendleft(reversed(asked))  # not begun, so not to blame
                    asked = deque()
                go_on(Worker(task) if worker.dead and left else worker, asked)
                if one_first and done:
                    one_first = False
                    for _ in range(min(jobs - 1, len(left))):
                        go_on(Worker(task), deque())
                yield number, answer
    finally:
        for worker, _ in busy.values():
            worker.close()


def _ready(busy: dict[Any, tuple[Worker, deque[int]]], begun: dict[Any, float], timeout_s: float | None) -> list[Any]:
    """Lines of those ``busy`` workers that have something to say; whose task has ``begun`` too long ago is ended."""
    if timeout_s is None:
        return wait(list(busy))
    while True:
        now = time.monotonic()
        for line in busy:
            if begun[line] + timeout_s <= now:
                busy[line][0].end_late(timeout_s)
        next_end = min((begun[line] + timeout_s - now for line in busy if begun[line] + timeout_s > now), default=None)
        ready = wait(list(busy), next_end)
        if ready:
            return ready


def _kept(worker: Worker) -> tuple[bool, Callable[[], Any]]:
    """Whether ``worker`` answers with a value, and a call that gives that value or raises what it raised."""
    try:
        value = worker.answer()
    except BaseException as error:
        raised = error  # the name ``error`` ends with this block

        def again() -> Any:
            raise raised

        return False, again
    return True, lambda: value


def _each_in_threads(
    task: Callable[[int], Any], count: int, jobs: int, meanwhile: Callable[[], object] | None
) -> Iterator[tuple[int, Callable[[], Any]]]:
    from concurrent.futures import ThreadPoolExecutor, as_completed

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        futures = {pool.submit(task, number): number for number in range(count)}
        try:
            if meanwhile is not None:
                meanwhile()
            for future in as_completed(futures):
                yield futures[future], future.result
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
