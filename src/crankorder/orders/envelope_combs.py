"""Combs of lines in envelope spectra: how unlikely noise alone is to make the first harmonics of a train of strikes."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from crankorder.orders.envelope_lines import middles

Array = NDArray[np.float64]

TEETH, SLOW_TEETH = 3, 6
"""First harmonics that are taken together, and those of a comb as slow as a cage's."""

SLOW_ORDER = 1.0
"""Order below which a comb is slow: its damage strikes once in more than a turn, with many harmonics."""

LEAST_TEETH = 2
"""A comb has so many lines or more off the multiples of the cycle; one line alone is no comb."""

TRIALS_PER_BIN = 2
"""Places of the first harmonic that are tried from one bin to the next."""

LEAST_NATS = 2.0
"""Of the first harmonic, as the logarithm of its chance, at least: strikes are seldom without it, other lines often."""

MOST_NATS = 14.0
"""Of one line, as the logarithm of its chance, at most: no line by itself makes a comb."""

SKIRT_BINS = 16
"""Bins of a piece of spectrum whose median is the skirt that other lines leave there, where it is above the floor."""

NEAR_TRIALS = 2.2
"""Independent values that the largest of a bin and of its two neighbours is worth, with a Hann window."""

SPARE_BINS = 4
"""Bins beside those of a comb's lines that are kept of a spectrum: for the places of its peaks and of sidebands."""

TABLE_STEP, TABLE_END = 0.004, 12.0
"""Steps and end of the table of chances, in the logarithm of the power ratio: nats are right to 1e-4 of themselves."""


class Comb(NamedTuple):
    """Strikes that are looked for: the first harmonic may be from order ``low`` to ``high``.

    They may come and go with the load: sidebands then stand ``spacing`` beside each harmonic (0: they do not).
    """

    low: float
    high: float
    spacing: float = 0.0

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


@lru_cache(maxsize=64)
def looked_at(combs: tuple[Comb, ...], *, step: float, n_orders: int) -> NDArray[np.int64]:
    """Bins (looks,) of a spectrum of ``n_orders`` bins ``step`` apart that tell whether one of ``combs`` is there.

    They are those of its harmonics, one more than are taken together, of their sidebands, of what a slow comb (a cage)
    makes beside them, and half way between harmonics that have the sidebands of a cage.
    """
    seen = np.zeros(n_orders, dtype=np.bool_)
    slow = [end for comb in combs if comb.is_slow for end in (comb.low, comb.high)]
    for comb in combs:
        beside = {0.0, comb.spacing, *(slow if not comb.is_slow else ())}
        spans = [
            (n * comb.low + side, n * comb.high + side)
            for n in range(1, comb.teeth + 2)
            for away in beside
            for side in (-away, away)
        ]
        if 0.0 < comb.spacing < SLOW_ORDER:
            half = 0.5 * comb.spacing
            spans += [((n - 0.5) * comb.low - half, (n - 0.5) * comb.high + half) for n in range(1, comb.teeth + 1)]
        for low, high in spans:
            first, last = int(low / step) - SPARE_BINS, int(high / step) + SPARE_BINS
            seen[max(first, 0) : max(last + 2, 0)] = True
    bins = np.flatnonzero(seen)
    bins.flags.writeable = False  # all who ask get the same
    return bins


def look_nats(
    ratio: NDArray[np.floating],
    bins: NDArray[np.int64],
    *,
    count: float,
    floor_worth: float,
    free: NDArray[np.bool_],
) -> Array:
    """Minus the logarithm of the chance (rows, looks) that noise makes a line of so high a ``ratio`` (rows, looks).

    The highest of each bin and its neighbours counts; each chance has a limit. The chance falls as the ratio grows, so
    that one table serves all bins.

    Parameters
    ----------
    ratio : power over the local floor at the ``bins`` (looks,), which increase
    count : independent spectra that it is the mean of
    floor_worth : independent bins that its floor is worth
    free : (looks,), bins off the multiples of the cycle's order: no other counts, nor as a neighbour
    """
    log_ratio, nats = _table(max(count, 1e-3), floor_worth)
    own = np.interp(np.log(np.maximum(ratio, 1.0)), log_ratio, nats)
    own *= np.where(free, np.minimum(ratio, 1.0), 0.0)
    beside = np.diff(bins) == 1
    high = own.copy()
    high[:, 1:] = np.maximum(high[:, 1:], np.where(beside, own[:, :-1], 0.0))
    high[:, :-1] = np.maximum(high[:, :-1], np.where(beside, own[:, 1:], 0.0))
    made: Array = np.clip(high - np.log(NEAR_TRIALS), 0.0, MOST_NATS)
    return made


@lru_cache(maxsize=512)
def _table(count: float, floor_worth: float) -> tuple[Array, Array]:
    """Logarithms of power ratios from 0 on and those, with a minus, of their chances in noise (F-distribution)."""
    log_ratio = np.arange(0.0, TABLE_END, TABLE_STEP)
    chance = fdtrc(2.0 * count, 2.0 * floor_worth * count, np.exp(log_ratio))
    return log_ratio, -np.log(np.maximum(chance, 1e-300))


def comb_nats(nats: Array, bins: NDArray[np.int64], comb: Comb, *, step: float, free: NDArray[np.bool_]) -> Array:
    """Minus the logarithm of the chance (rows, trials) that noise makes the lines of each trial of ``comb`` together.

    The chances of single lines are multiplied (Fisher's method), each with a limit: those of the first harmonics, more
    and more of them, with their sidebands and without. The best of these sets counts, less what their number costs. It
    is 0 where the first harmonic of a comb that is not slow is missing.

    Parameters
    ----------
    nats : (rows, looks), of the lines alone as :func:`look_nats` has them, at the ``bins`` (looks,) of spectra
    step : orders from one bin of the spectra to the next
    free : (looks,), bins off the multiples of the cycle's order: no other counts
    """
    trials = comb.trials(step) / step
    sets = _sets(nats, bins, free, comb, trials, spacing=0.0)
    if comb.spacing:
        sets += _sets(nats, bins, free, comb, trials, spacing=comb.spacing / step)
    made: Array = np.maximum(np.max(sets, axis=0) - np.log(len(sets)), 0.0)
    return made


def _sets(
    nats: Array, bins: NDArray[np.int64], free: NDArray[np.bool_], comb: Comb, trials: Array, *, spacing: float
) -> list[Array]:
    """Nats (rows, trials) of the first harmonics of ``comb`` that begin at ``trials``: of more and more of them."""
    total, lines = np.zeros((len(nats), len(trials))), np.zeros(len(trials), dtype=np.int64)
    first = np.ones(total.shape, dtype=np.bool_)
    made = []
    for harmonic in range(1, comb.teeth + 1):
        for side in (0.0, -spacing, spacing) if spacing else (0.0,):
            at = np.round(harmonic * trials + side).astype(np.int64)
            look = np.minimum(np.searchsorted(bins, at), len(bins) - 1)
            counts = (bins[look] == at) & free[look]
            own = np.where(counts, nats[:, look], 0.0)
            if harmonic == 1 and not side and not comb.is_slow:
                first = own > LEAST_NATS
            total += own
            lines += counts
        if spacing or harmonic in (LEAST_TEETH, comb.teeth):
            made.append(np.where((lines >= LEAST_TEETH) & first, _fisher(total, lines), 0.0))
    return made


def _fisher(total: Array, lines: NDArray[np.int64]) -> Array:
    """Minus the logarithm of the chance that so many ``lines`` of noise have ``total`` nats or more together.

    Each has an exponential distribution: their sum has Erlang's, the chance of which is a short series.
    """
    term, series = np.ones_like(total), np.ones_like(total)
    for k in range(1, int(lines.max(initial=1))):
        term = term * total / k
        series += np.where(k < lines, term, 0.0)
    made: Array = np.maximum(total - np.log(series), 0.0)
    return made


def over_skirts(ratio: Array) -> Array:
    """``ratio`` (rows, orders) over the median of the bins about each where that is higher: on a skirt no line is."""
    pieces = ratio.shape[1] // SKIRT_BINS
    middle = middles(ratio[:, : pieces * SKIRT_BINS].reshape(len(ratio), pieces, SKIRT_BINS))
    high = np.repeat(np.maximum(middle, 1.0), SKIRT_BINS, axis=1)
    rest = ratio.shape[1] - high.shape[1]
    made: Array = ratio / np.pad(high, ((0, 0), (0, rest)), mode="edge")
    return made
