"""Combs of lines in envelope spectra: how unlikely noise alone is to make the first harmonics of a train of strikes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.special import fdtrc, gammaincc

from crankorder.orders.envelope_lines import middles

Array = NDArray[np.float64]

TEETH, SLOW_TEETH = 3, 6
"""First harmonics that are taken together, and those of a comb as slow as a cage's."""

SLOW_ORDER = 1.0
"""Order below which a comb is slow: its damage strikes once in more than a turn, with many harmonics."""

LEAST_TEETH = 2
"""A comb has so many harmonics or more off the multiples of the cycle; one line alone is no comb."""

TRIALS_PER_BIN = 2
"""Places of the first harmonic that are tried from one bin to the next."""

LEAST_NATS = 2.0
"""Of the first harmonic, as the logarithm of its chance, at least: strikes are seldom without it, other lines often."""

MOST_NATS = 14.0
"""Of one harmonic, as the logarithm of its chance, at most: no line by itself makes a comb."""

SKIRT_BINS = 16
"""Bins of a piece of spectrum whose median is the skirt that other lines leave there, where it is above the floor."""

NEAR_TRIALS = 2.2
"""Independent values that the largest of a bin and of its two neighbours is worth, with a Hann window."""


class Comb(NamedTuple):
    """Strikes that are looked for: the first harmonic may be from order ``low`` to ``high``."""

    low: float
    high: float

    @property
    def is_slow(self) -> bool:
        """Whether it strikes less than once a turn."""
        return self.high < SLOW_ORDER

    @property
    def teeth(self) -> int:
        """Harmonics that are taken together."""
        return SLOW_TEETH if self.is_slow else TEETH

    def trials(self, step: float) -> Array:
        """Orders (trials,) of the first harmonic that are tried in a spectrum with bins ``step`` apart."""
        return np.arange(self.low, self.high + 0.5 * step / TRIALS_PER_BIN, step / TRIALS_PER_BIN)


def comb_chances(
    ratio: Array, comb: Comb, *, step: float, count: Array, floor_worth: Array, free: NDArray[np.bool_]
) -> Array:
    """Chance (rows, trials) that noise makes the harmonics of each trial of ``comb`` as high as they are together.

    The chances of the single harmonics are multiplied (Fisher's method), each with a limit; it is 1 where the first one
    of a comb that is not slow is missing.

    Parameters
    ----------
    ratio : (rows, orders), power over the local floor, from order 0 on in bins ``step`` apart
    count : (rows,), independent spectra that each row is the mean of
    floor_worth : (rows,), independent bins that its floor is worth
    free : (orders,) or (rows, orders), bins off the multiples of the cycle's order: no other counts
    """
    trials = comb.trials(step)
    n = np.maximum(count, 1e-3)[:, None]
    highest = maximum_filter1d(_over_skirts(ratio), 3, axis=1)
    total, teeth = np.zeros((len(ratio), len(trials))), np.zeros((len(ratio), len(trials)))
    allowed = np.broadcast_to(free, ratio.shape)
    first = np.ones(total.shape, dtype=np.bool_)
    for harmonic in range(1, comb.teeth + 1):
        at = np.round(harmonic * trials / step).astype(np.int64)
        inside = at < ratio.shape[1] - 1
        at = np.where(inside, at, 0)
        alone = np.minimum(fdtrc(2.0 * n, 2.0 * floor_worth[:, None] * n, highest[:, at]) * NEAR_TRIALS, 1.0)
        nats = np.minimum(-np.log(np.maximum(alone, 1e-300)), MOST_NATS)
        counts = inside & allowed[:, at]
        if harmonic == 1 and not comb.is_slow:
            first = counts & (nats > LEAST_NATS)
        total += np.where(counts, nats, 0.0)
        teeth += counts
    chance: Array = gammaincc(np.maximum(teeth, 1.0), total)
    return np.where((teeth >= LEAST_TEETH) & first, chance, 1.0)


def _over_skirts(ratio: Array) -> Array:
    """``ratio`` (rows, orders) over the median of the bins about each where that is higher: on a skirt no line is."""
    pieces = ratio.shape[1] // SKIRT_BINS
    middle = middles(ratio[:, : pieces * SKIRT_BINS].reshape(len(ratio), pieces, SKIRT_BINS))
    high = np.repeat(np.maximum(middle, 1.0), SKIRT_BINS, axis=1)
    rest = ratio.shape[1] - high.shape[1]
    made: Array = ratio / np.pad(high, ((0, 0), (0, rest)), mode="edge")
    return made
