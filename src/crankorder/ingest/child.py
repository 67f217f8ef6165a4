"""A parser of others in a process of its own, with limits on memory and time: a bomb harms nobody else."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import pickle
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import IO, Any, NoReturn, TypeVar

from crankorder.errors import CrankorderError, EnvironmentFailure, InputError, UnsafeInputError, located, printable

T = TypeVar("T")

MEMORY_BYTES = 500_000_000
"""That a parser may take beside what the samples themselves take."""
LEAST_SECONDS, BYTES_PER_SECOND = 10.0, 5e6
"""That a parser may take: at least so long, and so long for its bytes."""


def package(name: str, kind: str, remedy: str) -> Any:
    """The package ``name`` that reads files of a ``kind``, loaded before a child needs it.

    Raises EnvironmentFailure with the ``remedy`` where it is missing.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise EnvironmentFailure(f"reading {kind} needs the package {name}", remedy=remedy) from None


def in_child(task: Callable[[], T], path: Path, *, n_bytes: int) -> T:
    """Result of ``task``, which parses the file at ``path``, run in a process of its own where the system forks.

    ``n_bytes`` is the size of the samples that it returns, beside which it has bounded memory and time. Raises the
    CrankorderError that the task raises, UnsafeInputError where it exceeds its limits, InputError where it fails in
    another way.
    """
    if not hasattr(os, "fork"):
        with located(path):
            return _by_itself(task)
    seconds = LEAST_SECONDS + (path.stat().st_size + n_bytes) / BYTES_PER_SECOND
    with located(path), tempfile.TemporaryFile() as answer:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
        alive, end = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(alive)
            _serve(task, answer, MEMORY_BYTES + 4 * n_bytes, seconds)
        os.close(end)
        try:
            status = _wait(pid, alive, seconds)
        finally:
            os.close(alive)
        answer.seek(0)
        value: T = _answer(answer, status)
    return value


def _wait(pid: int, alive: int, seconds: float) -> int | None:
    """Status of the process ``pid`` when it ends, None where it had to be ended after ``seconds``."""
    deadline = time.monotonic() + seconds
    select.select([alive], [], [], seconds)  # its end of the pipe closes with it
    late = time.monotonic() >= deadline
    if late:
        os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    return None if late else status


def _serve(task: Callable[[], Any], answer: IO[bytes], most_bytes: int, seconds: float) -> NoReturn:
    """Do ``task`` within the limits, leave its value or error in ``answer``, and end this process."""
    status = 1
    try:
        _limit(most_bytes, seconds)
        faulthandler.disable()  # a crash is told by the exit status
        with Path(os.devnull).open("w") as nowhere:  # parsers print and log what nobody asked for
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        try:
            outcome: tuple[str, Any] = "value", _by_itself(task)
        except CrankorderError as error:
            outcome = "error", error
        except MemoryError:
            outcome = "memory", None
        pickle.dump(outcome, answer, protocol=5)
        answer.flush()
        status = 0
    finally:
        os._exit(status)


def _limit(most_bytes: int, seconds: float) -> None:
    import resource

    with contextlib.suppress(OSError, ValueError):
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (taken + most_bytes, taken + most_bytes))
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _by_itself(task: Callable[[], T]) -> T:
    """What ``task`` gives; whatever a foreign parser raises becomes an InputError."""
    try:
        return task()
    except (CrankorderError, MemoryError):
        raise
    except Exception as error:
        found = printable(f"{type(error).__name__}: {error}".split("\n")[0], 160)
        raise InputError("damaged: cannot be parsed", found=found, remedy="Export the file again") from None


def _answer(answer: IO[bytes], status: int | None) -> Any:
    if status is None:
        raise UnsafeInputError("takes too long to parse", remedy="Export it again, or leave it out")
    try:
        kind, value = pickle.load(answer)  # written by our own child
    except (EOFError, pickle.UnpicklingError):
        kind, value = "ended", None
    if kind == "value":
        return value
    if kind == "error":
        raise value
    remedy = "Split the recording, export it again, or leave it out"
    if kind == "ended" and os.WIFSIGNALED(status):
        died = f"its parser died ({signal.Signals(os.WTERMSIG(status)).name}): damaged, or takes too much memory"
        raise UnsafeInputError(died, remedy=remedy)
    raise UnsafeInputError("takes too much memory to parse", remedy=remedy)
