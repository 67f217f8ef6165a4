"""Compiled kernels: where they are kept, and whether all of them were found."""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
from pathlib import Path
from types import ModuleType


def keep_compiled_kernels() -> None:
    """Give numba a folder for its compiled kernels where neither the package's nor the user's can be written.

    Kernels are pickles, which run what they hold: only a folder that is ours alone will do. Where there is none they
    are compiled again in each run.
    """
    package = Path(__file__).parents[1]
    if "NUMBA_CACHE_DIR" in os.environ or os.access(package, os.W_OK) or _user_cache_can_be_written():
        return
    chosen = Path(tempfile.gettempdir()) / f"crankorder-kernels-{os.getuid()}"
    try:
        chosen.mkdir(mode=0o700, exist_ok=True)
        found = chosen.lstat()
        private = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    except OSError:
        private = False
    if not private:
        chosen = Path(tempfile.mkdtemp(prefix="crankorder-kernels-"))
        atexit.register(shutil.rmtree, chosen, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(chosen)


def _user_cache_can_be_written() -> bool:
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~").expanduser() / ".cache")
        existing = next(folder for folder in (home, *home.parents) if folder.exists())
    except (RuntimeError, OSError, StopIteration):  # a user without a home
        return False
    return os.access(existing, os.W_OK)


def load_kernels() -> bool:
    """Load what numba needs before its first kernel runs: a third of a second, once and not in every worker.

    True where a kernel had to be compiled for it: then this is the first run, and the others must be compiled too.
    """
    import numpy as np

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
