"""What one command costs as a whole process with all that it starts, and the machine on which it was measured."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

CORE_NAMES = ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename", "openblas_get_corename")


def machine() -> dict[str, Any]:
    """Processor, cores, linear algebra, versions, and the load of the machine now (1, 5 and 15 minutes)."""
    library, kernel = linear_algebra()
    return {
        "processor": processor_name(),
        "cores": os.cpu_count(),
        "blas": library,
        "blas_kernel": kernel,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "load_average": [round(load, 2) for load in os.getloadavg()],
    }


def machine_words(of: dict[str, Any]) -> str:
    """One paragraph of a page that says what :func:`machine` found."""
    load = ", ".join(f"{value:g}" for value in of["load_average"])
    return (
        f"{of['processor']}, {of['cores']} cores; {of['blas']} (kernel {of['blas_kernel']}), numpy {of['numpy']}, "
        f"scipy {of['scipy']}, Python {of['python']}; load when the run began (1, 5, 15 minutes): {load}."
    )


def processor_name() -> str:
    """The name that the processor gives itself."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def linear_algebra() -> tuple[str, str]:
    """Name and version of numpy's BLAS, and the kernel that it chose for this processor ("unknown" if it is mute)."""
    if importlib.util.find_spec("threadpoolctl") is not None:
        from threadpoolctl import threadpool_info

        for library in threadpool_info():
            if library["user_api"] == "blas":
                name = f"{library['internal_api']} {library['version']}"
                return name, library.get("architecture") or "unknown"
    built = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return f"{built['name']} {built['version']}", _openblas_kernel()


def _openblas_kernel() -> str:
    """What the OpenBLAS in numpy's wheel says of itself: its build names another, the least that it supports."""
    package = Path(np.__file__).parent
    for path in (*package.with_name("numpy.libs").glob("*openblas*"), *(package / ".dylibs").glob("*openblas*")):
        library = ctypes.CDLL(str(path))
        for name in CORE_NAMES:
            if hasattr(library, name):
                say = getattr(library, name)
                say.restype = ctypes.c_char_p
                return str(say(), "ascii")
    return "unknown"


def user_environment(**more: str) -> dict[str, str]:
    """The environment as a user's shell has it: no numbers of threads, modules kept compiled; and ``more``."""
    ours = {"PYTHONDONTWRITEBYTECODE", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"}
    return {name: value for name, value in os.environ.items() if name not in ours} | more


def measured(command: list[str], **environment: str) -> tuple[float, float, float, str]:
    """Wall seconds, processor seconds of it and its processes, peak megabytes of the largest, output of ``command``."""
    with tempfile.TemporaryFile("w+") as said:
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=said, stderr=said, env=user_environment(**environment))
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        said.seek(0)
        text = said.read()
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}:\n{text}")
    return seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, text


@dataclass
class Watched:
    """Seconds of a command and the largest memory seen: of its first process, of any one, of all at one time [MB].

    Memory is what no file on a disk backs. ``together_mb`` counts shared memory once; ``mapped_mb`` is what the first
    process has mapped from files.
    """

    seconds: float = 0.0
    processor_seconds: float = 0.0
    first_mb: float = 0.0
    largest_mb: float = 0.0
    together_mb: float = 0.0
    mapped_mb: float = 0.0


def watched(
    command: list[str],
    *,
    tick_s: float = 0.2,
    together: bool = True,
    tell: Callable[[float, list[float]], None] | None = None,
) -> Watched:
    """Run ``command`` and look at the memory of its processes every ``tick_s`` (Linux).

    ``together=False`` leaves out the memory of all, which costs a walk through the pages of each. ``tell`` is called
    with the seconds and the megabytes of each process, that of the command first.
    """
    found, begun = Watched(), time.monotonic()
    process = subprocess.Popen(command, env=user_environment())
    while not (ended := os.wait4(process.pid, os.WNOHANG))[0]:
        pids = family(process.pid)
        now = [memory_mb(pid) for pid in pids]
        found.first_mb, found.mapped_mb = max(found.first_mb, now[0][0]), max(found.mapped_mb, now[0][1])
        found.largest_mb = max(found.largest_mb, *(own for own, _ in now))
        if together:
            now_together = sum(shared_memory_mb(pid) for pid in pids)
            found.together_mb = max(found.together_mb, found.largest_mb, now_together)  # read one after the other
        if tell is not None:
            tell(time.monotonic() - begun, [own for own, _ in now])
        time.sleep(tick_s)
    _, status, usage = ended
    found.seconds, found.processor_seconds = time.monotonic() - begun, usage.ru_utime + usage.ru_stime
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
    return found


def family(pid: int) -> list[int]:
    """``pid`` and all processes that it started, and they."""
    found = [pid]
    for known in found:
        for children in Path(f"/proc/{known}/task").glob("*/children"):
            try:
                found += [int(child) for child in children.read_text(encoding="ascii").split()]
            except OSError:  # it has ended
                continue
    return found


def memory_mb(pid: int) -> tuple[float, float]:
    """Memory of a process that no file backs, and what is mapped from files [MB]; zeros where it has ended."""
    of = _kilobytes(Path(f"/proc/{pid}/status"))
    return (of.get("RssAnon", 0) + of.get("RssShmem", 0)) / 1e3, of.get("RssFile", 0) / 1e3


def shared_memory_mb(pid: int) -> float:
    """Memory of a process that no file backs [MB], what it shares with others in equal parts: these may be added up."""
    of = _kilobytes(Path(f"/proc/{pid}/smaps_rollup"))
    return (of.get("Pss_Anon", 0) + of.get("Pss_Shmem", 0)) / 1e3


def _kilobytes(path: Path) -> Mapping[str, int]:
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except OSError:  # it has ended
        return {}
    return {
        line.split(":")[0]: int(line.split()[1]) for line in lines if line.startswith(("Rss", "Pss")) and " kB" in line
    }
