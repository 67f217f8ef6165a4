"""Signals at a lower sampling rate, or at times between their samples, within the band that both rates carry."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, kaiserord, upfirdn

from crankorder.fft.resampling import cheapest_kernel, values_at
from crankorder.quantities import Floats
from crankorder.scratch import blocks, empty_like

PASS, STOP, REJECTION_DB = 0.46, 0.54, 100.0
"""Band of a signal that comes to a lower rate, where nothing is left (what folds stays above the band), as shares
of that rate, and how far."""

_KERNEL = cheapest_kernel(1e-6, content=0.45)


@lru_cache(maxsize=8)
def _low_pass(step: float) -> tuple[Floats, int]:
    """Taps of the low-pass before a rate ``step`` times lower, 1 or more, and of how many of its values one is made."""
    if step == 1.0:
        return np.ones(1), 1
    count, beta = kaiserord(REJECTION_DB, 2.0 * (STOP - PASS) / step)
    return firwin(count | 1, (PASS + STOP) / step, window=("kaiser", beta)), max(1, int(step / 2.0))


def reach_of(step: float) -> int:
    """Samples to either side from which :func:`resampled` makes a value at a rate ``step`` times lower."""
    taps, down = _low_pass(step)
    return taps.size // 2 + (_KERNEL.margin + 1) * down


def resampled(row: NDArray[Any], begin: float, step: float, n_samples: int) -> NDArray[Any]:
    """``n_samples`` values of ``row`` (samples,), float32 or float64, one every ``step`` samples from ``begin`` on.

    ``step`` is 1 or more. Needs :func:`reach_of` samples at either end; NaN where one that a value needs is missing.
    """
    taps, down = _low_pass(step)
    out = empty_like(row, (n_samples,), row.dtype)
    for part in blocks(n_samples):
        places = begin + step * np.arange(part.start, part.stop)
        low = max(0, math.floor(places[0]) - reach_of(step))
        piece = row[low : math.ceil(places[-1]) + reach_of(step) + 1].astype(np.float64)
        filtered, at = upfirdn(taps, piece, down=down), (places - low + taps.size // 2) / down
        out[part] = values_at(filtered[None], at, kernel=_KERNEL)[0]
    return out
