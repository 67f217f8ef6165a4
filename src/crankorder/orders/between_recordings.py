"""Recordings at one speed: whether their phases share a mark, and how much their means differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.orders.intervals import t_quantile
from crankorder.quantities import Bools, Complexes, Floats, Ints

LOCATED = ("tdc", "index", "pulse")
"""Phase references that stand for a place on the crank, the same in every recording; a pulse is one per revolution."""

WHOLE = 1e-6
"""An order this close to a whole number is one: a crank mark tells its phase, whichever turn of the cycle it is."""


def one_phase_reference(used: Sequence[xr.Dataset]) -> bool:
    """Whether the recordings ``used`` have one and the same ``phase_reference``, and it is a place on the crank.

    The zero of a count that no index sets is one in a single recording.
    """
    marks = {str(item.attrs["phase_reference"]) for item in used}
    return len(marks) == 1 and marks <= {*LOCATED, *(("count",) if len(used) == 1 else ())}


def phase_reference_of(used: Sequence[xr.Dataset]) -> str:
    """The ``phase_reference`` of the recordings ``used``; "mixed" where they differ."""
    marks = {str(item.attrs["phase_reference"]) for item in used}
    return marks.pop() if len(marks) == 1 else "mixed"


def phases_compare(used: Sequence[xr.Dataset], order: Floats) -> Bools:
    """For each ``order``, whether all recordings ``used`` tell its phase from one mark and in one turn of the cycle."""
    order = np.asarray(order, dtype=np.float64)
    if not one_phase_reference(used):
        return np.zeros(order.shape, dtype=np.bool_)
    whole = np.abs(order - np.round(order)) < WHOLE
    return np.asarray(whole | all(int(item.attrs["cycle_known"]) for item in used))


@dataclass(frozen=True)
class BetweenRecordings:
    """Scatter of the recordings' means about the mean of all frames; the first three are (channels, orders).

    ``along`` and ``across`` the mean, as powers of a circular noise with that part on each axis; ``recordings`` their
    number, below two where there is nothing between; ``share`` what of the scatter is the error of the mean, were the
    recordings all of it: the sum of squared weights over one less that sum, one over the recordings less one where
    all have as many frames.
    """

    along: Floats
    across: Floats
    recordings: Floats
    share: Floats

    @property
    def both(self) -> Floats:
        """Power of the scatter along and across."""
        return 0.5 * (self.along + self.across)


def between_recordings(spectrum: Complexes, owner: Ints, mean: Complexes) -> BetweenRecordings:
    """Scatter of recordings about the ``mean`` (channels, orders) of all frames.

    Parameters
    ----------
    spectrum : (channels, frames, orders); NaN takes no part
    owner : (frames,), the number of the recording of each
    mean : mean over the frames of ``spectrum``
    """
    names = np.unique(owner)
    zero = np.zeros(mean.shape)
    if len(names) < 2:
        return BetweenRecordings(zero, zero, zero + len(names), zero)
    length = np.abs(mean)
    back = np.where(length > 0.0, mean / np.where(length > 0.0, length, 1.0), 1.0).conj()
    counts, along, across = [], [], []
    for name in names:
        part = spectrum[:, owner == name]
        kept = np.isfinite(part.real)
        count = np.count_nonzero(kept, axis=1)
        apart = (np.where(kept, part, 0.0).sum(axis=1) / np.maximum(count, 1) - mean) * back
        counts.append(count)
        along.append(count * np.square(apart.real))
        across.append(count * np.square(apart.imag))
    weights, total = np.array(counts, dtype=np.float64), np.maximum(np.sum(counts, axis=0), 1)
    squares = np.square(weights / total).sum(axis=0)
    share = np.divide(squares, 1.0 - squares, out=np.zeros_like(squares), where=squares < 1.0)
    recordings = np.count_nonzero(weights, axis=0).astype(np.float64)
    return BetweenRecordings(
        2.0 * np.sum(along, axis=0) / total, 2.0 * np.sum(across, axis=0) / total, recordings, share
    )


def wider_of(
    power: Floats, dof: Floats, scatter: Floats, between: BetweenRecordings, *, parts: int = 1
) -> tuple[Floats, Floats]:
    """Noise power and its degrees of freedom: those of the frames or of the recordings, whichever errs more.

    Student's t of the recordings' means covers the truth whatever there is between them, even nothing; a pooled
    variance (Birge 1932, with the degrees of freedom of Satterthwaite 1946) covers 0.83 where two recordings differ.

    Parameters
    ----------
    power, dof : of the mean over the frames, by the frames' own scatter; NaN and 0 where they say nothing
    scatter : ``along``, ``across`` or ``both`` of ``between``
    between : of the recordings; nothing changes where they are fewer than two
    parts : real parts that ``scatter`` is of: 2 for ``both``
    """
    freedom = np.maximum(between.recordings - 1.0, 0.0)
    within = np.nan_to_num(power)
    # were the frames all of the scatter it would be (recordings - 1) power; with unlike weights only more than that
    # is of the recordings
    apart = np.maximum(within + between.share * (scatter - freedom * within), 0.0)
    own = dof > 0.0
    reach = np.where(own, np.sqrt(within) * t_quantile(np.where(own, dof, 1.0)), 0.0)
    several = np.sqrt(apart) * t_quantile(np.maximum(parts * freedom, 1.0))
    wider = (freedom > 0.0) & (several > reach)
    return np.where(wider, apart, power), np.where(wider, parts * freedom, dof)


def ends_between(
    ends: tuple[Floats, Floats], amplitude: Floats, *, within: tuple[Floats, Floats], wider: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Interval of an amplitude whose recordings scatter more than their frames.

    From one recording to the next an amplitude changes by a factor, and no line that is seen comes to nothing by it:
    Student's t is that of a factor, the interval reaches from the amplitude over it to the amplitude times it.

    Parameters
    ----------
    ends : lower and upper end by the frames alone
    amplitude : mean over the recordings
    within : noise power and degrees of freedom by the frames
    wider : the same as of :func:`wider_of`; where nothing is wider ``ends`` are given back
    """
    is_wider = (wider[0] != within[0]) & np.isfinite(wider[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = 1.0 + t_quantile(wider[1]) * np.sqrt(0.5 * wider[0]) / amplitude
        low, high = np.minimum(ends[0], amplitude / reach), np.maximum(ends[1], amplitude * reach)
    return np.where(is_wider, low, ends[0]), np.where(is_wider, high, ends[1])
