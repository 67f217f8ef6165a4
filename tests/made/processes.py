"""Processes that end with the block that started them, whatever happens in it."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_HEARS_SIGINT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""
_PER_SECOND = os.sysconf("SC_CLK_TCK")

PATIENCE_S = 120.0
"""How long one waits for what does end: no measure of speed."""


@contextmanager
def started(*arguments: object, **given: object) -> Iterator[subprocess.Popen[bytes]]:
    """A Python process with a group of its own; SIGINT reaches it even where this one was started to ignore it."""
    line = [sys.executable, "-S", "-c", _HEARS_SIGINT, *map(str, arguments)]
    with subprocess.Popen(line, start_new_session=True, **given) as process:  # type: ignore[call-overload]
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def children_of(pid: int) -> list[int]:
    """Processes that ``pid`` started and that are there, in the order in which they were started."""
    try:
        found = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    except OSError:
        return []
    return [int(child) for child in found]


def processor_s(*pids: int) -> float:
    """Processor seconds of processes that are there, and of their children that are not there any more."""
    rows = [Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split() for pid in pids]
    return sum(int(ticks) for row in rows for ticks in row[11:15]) / _PER_SECOND
