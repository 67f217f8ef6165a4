"""What other packages load only because they might be asked for it, and nobody here asks: left out of this program.

Only the command line does this, before the packages load; a program that imports crankorder finds them whole.
"""

from __future__ import annotations

import sys
from types import ModuleType

UNUSED = ("pyfftw.interfaces", "numpy.f2py")
"""pyFFTW's stand-ins for numpy.fft and scipy.fft, which load both; a translator of Fortran, which scipy.special loads
with all that numpy has."""

UNUSED_BY_NUMBA = ("cffi", "scipy.linalg.cython_blas")
"""What numba looks for when its first kernel runs: no kernel here calls C functions by cffi, or BLAS."""


def leave_out_unused() -> None:
    """Have the packages of ``UNUSED`` load without the parts that nobody here uses."""
    import numpy as np

    for name in UNUSED:
        sys.modules.setdefault(name, ModuleType(name, "left out by crankorder.batch.lean"))
    np.f2py = sys.modules["numpy.f2py"]  # numpy looks for it as an attribute


def load_kernels() -> bool:
    """Load what numba needs before its first kernel runs: a third of a second, once and not in every worker.

    True where a kernel had to be compiled for it: then this is the first run, and the others must be compiled too.
    """
    import numpy as np

    from crankorder.ingest import signal_survey
    from crankorder.settings import load_settings
    from crankorder.shaft import pulses

    before = _compiled(pulses) + _compiled(signal_survey)
    absent = [name for name in UNUSED_BY_NUMBA if name not in sys.modules]
    sys.modules.update(dict.fromkeys(absent))  # type: ignore[arg-type]  # None: "cannot be imported", as documented
    try:
        trace = np.repeat(np.tile(np.array([0.0, 5.0], dtype=np.float32), 8), 4)
        shaft = load_settings().shaft
        signal_survey.survey(trace, size=16)
        pulses.find_pulses(trace, rate_hz=1.0, kind="square", edge="rising", pulses_per_rev=1, settings=shaft)
    finally:
        for name in absent:
            del sys.modules[name]
    return _compiled(pulses) + _compiled(signal_survey) > before


def _compiled(module: ModuleType) -> int:
    """How many kernels of ``module`` were not found compiled."""
    from numba.core.dispatcher import Dispatcher

    kernels = [kernel for kernel in vars(module).values() if isinstance(kernel, Dispatcher)]
    return sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels)
