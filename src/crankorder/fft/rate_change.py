"""Signals at a lower sampling rate, or at times between their samples, within the band that both rates carry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, kaiserord, upfirdn

from crankorder.fft.resampling import Kernel, cheapest_kernel, values_at
from crankorder.quantities import Floats
from crankorder.scratch import blocks, empty_like

PASS, STOP, REJECTION_DB = 0.46, 0.54, 100.0
"""Band of a signal that comes to a lower rate, where nothing of it is left (what folds stays above the band), as shares of
that rate, and how far."""


@dataclass(frozen=True)
class RateChange:
    """How samples come to a rate ``step`` times lower: ``taps`` of a low-pass, of which one in ``down`` is made."""

    step: float
    taps: Floats
    down: int
    kernel: Kernel

    @classmethod
    @lru_cache(maxsize=8)
    def by(cls, step: float) -> RateChange:
        """To a rate ``step`` times lower, 1 or more; of 1 nothing is filtered, for times between the samples."""
        taps, down = np.ones(1), max(1, int(step / 2.0))
        if step > 1.0 + 1e-9:
            count, beta = kaiserord(REJECTION_DB, 2.0 * (STOP - PASS) / step)
            taps = firwin(count | 1, (PASS + STOP) / step, window=("kaiser", beta))
        return cls(step, taps, down, cheapest_kernel(1e-6, content=0.45))

    @property
    def reach(self) -> int:
        """Samples to either side that a value is made from."""
        return self.taps.size // 2 + (self.kernel.margin + 1) * self.down

    def of(self, row: NDArray[np.floating], begin: float, n_samples: int) -> NDArray[np.floating]:
        """``n_samples`` values of ``row`` from its place ``begin`` on; NaN where one that they need is missing."""
        out = empty_like(row, (n_samples,), row.dtype)
        for part in blocks(n_samples):
            places = begin + self.step * np.arange(part.start, part.stop)
            low = math.floor(places[0]) - self.reach + 1
            piece = row[max(low, 0) : math.ceil(places[-1]) + self.reach].astype(np.float64)
            low_passed = upfirdn(self.taps, piece, down=self.down)
            at = (places - max(low, 0) + self.taps.size // 2) / self.down
            out[part] = values_at(low_passed[None], at, kernel=self.kernel)[0]
        return out
