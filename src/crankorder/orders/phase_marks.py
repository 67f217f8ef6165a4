"""Whether recordings of a test tell phases from one and the same mark of the crank."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

LOCATED = ("tdc", "index", "pulse")
"""Phase references that stand for a place on the crank, the same in every recording; a pulse is one per revolution."""

WHOLE = 1e-6
"""An order this close to a whole number is one: a crank mark tells its phase, whichever turn of the cycle it is."""


def one_mark(used: Sequence[xr.Dataset]) -> bool:
    """Whether the recordings ``used`` have one and the same ``phase_reference``, and it is a place on the crank."""
    marks = {str(item.attrs["phase_reference"]) for item in used}
    return len(marks) == 1 and marks <= set(LOCATED)


def mark_of(used: Sequence[xr.Dataset]) -> str:
    """The ``phase_reference`` of the recordings ``used``; "mixed" where they differ."""
    marks = {str(item.attrs["phase_reference"]) for item in used}
    return marks.pop() if len(marks) == 1 else "mixed"


def phases_compare(used: Sequence[xr.Dataset], order: NDArray[np.float64]) -> NDArray[np.bool_]:
    """For each ``order``, whether all recordings ``used`` tell its phase from one mark and in one turn of the cycle."""
    order = np.asarray(order, dtype=np.float64)
    if not one_mark(used):
        return np.zeros(order.shape, dtype=np.bool_)
    whole = np.abs(order - np.round(order)) < WHOLE
    return np.asarray(whole | all(int(item.attrs["cycle_known"]) for item in used))
