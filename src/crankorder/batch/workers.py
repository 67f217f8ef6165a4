"""Processes that share one import: forked from this one when its modules are there, each working on its own.

A worker that dies (a crash inside a file library, a kill) takes one task with it and no more. A pool of the standard
library is of no use for that: it does not say which task ended it, and it forks beside its own threads.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import pickle
import signal
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any

from crankorder.scratch import keep_freed_memory

LOOK_S = 0.05
"""Between two looks whether a task has taken too long."""

SIGNAL_OF_PARENT_DEATH = 1
"""``PR_SET_PDEATHSIG`` of Linux's prctl."""


class WorkerDiedError(Exception):
    """A worker ended without an answer; the text says by what signal or status."""


class TooLateError(WorkerDiedError):
    """A worker was ended because its task took too long; the text says how long it had."""


class Worker:
    """A process that does ``task`` for each request, in the order in which they are asked."""

    def __init__(self, task: Callable[[Any], Any], *, daemon: bool = True) -> None:
        """Start a worker that does ``task``; it has all that this process has imported and made so far.

        A ``daemon`` ends with this process and has no workers of its own; another must be closed.
        """
        self.connection, theirs = Pipe()
        self._process = get_context("fork").Process(target=_serve, args=(task, theirs), daemon=daemon)
        gc.freeze()  # what exists stays in pages that both share
        self._process.start()
        gc.unfreeze()
        theirs.close()
        self._too_late = ""

    def ask(self, request: Any) -> None:
        """Hand over one ``request``; its answer comes after those of earlier ones."""
        with contextlib.suppress(OSError):  # its end is told by answer()
            self.connection.send(request)

    def answer(self) -> Any:
        """Answer to the earliest request that has none yet.

        Raises what the task raised; WorkerDiedError where the worker is gone.
        """
        try:
            done, value = self.connection.recv()
        except (EOFError, OSError):
            self.close()
            code = self._process.exitcode or 0
            how = f"ended with status {code}" if code >= 0 else f"was ended by {signal.Signals(-code).name}"
            raise (TooLateError(self._too_late) if self._too_late else WorkerDiedError(f"its worker {how}")) from None
        if done:
            return value
        raise value

    def end_late(self, seconds: float) -> None:
        """End the worker because its task had ``seconds`` and did not get done; its answer says so."""
        self._too_late = f"it took longer than {seconds:g} s"
        self._process.kill()

    def close(self) -> None:
        """End the worker, in the middle of its task if it has one."""
        if not self.connection.closed:
            self._process.kill()
            self._process.join()
            self.connection.close()


def _serve(task: Callable[[Any], Any], connection: Connection) -> None:
    """Answer requests until the other process ends this one, or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal tells the whole group; the parent ends its workers
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(SIGNAL_OF_PARENT_DEATH, signal.SIGKILL)
    keep_freed_memory()
    parent = parent_process()
    with contextlib.suppress(EOFError, OSError):  # the other process has died just now
        while parent is not None and os.getppid() == parent.pid:
            connection.send(_answer(task, connection.recv()))


def _answer(task: Callable[[Any], Any], request: Any) -> tuple[bool, Any]:
    """Whether ``task`` gave a value, and that value or the error."""
    try:
        return True, task(request)
    except BaseException as error:
        with contextlib.suppress(Exception):  # an error that cannot be sent is told in words
            error.add_note(f"in a worker:\n{traceback.format_exc()}")
            pickle.loads(pickle.dumps(error))
            if isinstance(error, Exception):
                return False, error
        return False, RuntimeError(f"{type(error).__name__}: {error}")


def each(
    task: Callable[[int], Any], count: int, *, jobs: int, timeout_s: float | None = None
) -> Iterator[tuple[int, Future[Any]]]:
    """Number and answer of ``task(0)`` … ``task(count - 1)``, ``jobs`` at a time, as they are done.

    The answer is a future that is done: a value, what the task raised, or WorkerDiedError where its process died. The
    others then go on in a new one. A task that takes longer than ``timeout_s`` is ended with its process: TooLateError.
    """
    left = deque(range(count))
    busy: dict[Any, tuple[Worker, int, float]] = {}

    def begin(worker: Worker) -> None:
        number = left.popleft()
        worker.ask(number)
        busy[worker.connection] = worker, number, time.monotonic()

    try:
        for _ in range(min(jobs, count)):
            begin(Worker(task))
        while busy:
            for worker, _, begun in busy.values():
                if timeout_s is not None and begun + timeout_s <= time.monotonic() and not worker.connection.poll():
                    worker.end_late(timeout_s)
            for connection in wait(list(busy), None if timeout_s is None else LOOK_S):
                worker, number, _ = busy[connection]
                answer: Future[Any] = Future()
                try:
                    answer.set_result(worker.answer())
                except Exception as error:
                    answer.set_exception(error)
                del busy[connection]
                if left:
                    begin(Worker(task) if worker.connection.closed else worker)
                else:
                    worker.close()
                yield number, answer
    finally:
        for worker, _, _ in busy.values():
            worker.close()
