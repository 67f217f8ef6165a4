"""Cross-check of natural frequencies by another program: pyOMA_2 on the same signals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import CrankorderError


def crosscheck_with_pyoma(
    signals: NDArray[np.float64], *, rate_hz: float, model_order: int = 40, block_rows: int = 40
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Natural frequencies in Hz and damping ratios of stable poles, each (poles,), as pyOMA_2 finds them.

    ``signals`` (channels, samples) sampled at ``rate_hz``, > 0; covariance-driven stochastic subspace identification
    with ``block_rows`` up to ``model_order`` (Peeters and De Roeck 1999). The signals must be free of order lines:
    harmonics come out as modes without damping. Raises CrankorderError where pyOMA_2 is not installed.
    """
    try:
        from pyoma2.algorithms import SSI
        from pyoma2.setup import SingleSetup
    except ImportError as error:
        raise CrankorderError(
            "pyOMA_2 is not installed: the cross-check of natural frequencies needs it",
            remedy="pip install 'crankorder[modal]'",
        ) from error
    setup = SingleSetup(np.ascontiguousarray(signals.T), fs=rate_hz)
    algorithm = SSI(name="SSI", method="cov", br=block_rows, ordmax=model_order)
    setup.add_algorithms(algorithm)
    setup.run_all()
    frequency, damping = algorithm.result.Fn_poles, algorithm.result.Xi_poles
    stable = (algorithm.result.Lab == 1) & np.isfinite(frequency)
    return np.asarray(frequency[stable]), np.asarray(damping[stable])
