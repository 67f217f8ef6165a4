"""Frames of like speed: what lets a stepped test and a run-up meet on one speed axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def speed_groups(speed_rpm: NDArray[np.float64], *, width_rpm: float) -> list[NDArray[np.int64]]:
    """Indices of ``speed_rpm`` (frames,) in groups that span at most ``width_rpm``, slowest group first.

    A group begins at the slowest frame that none has taken, so that the steps of a stepped test stay whole wherever
    they lie and a run-up falls into bins of ``width_rpm``. Frames of unknown speed (NaN) form one group, the last.
    """
    order = np.argsort(speed_rpm, kind="stable")
    known = order[: np.count_nonzero(~np.isnan(speed_rpm))]
    groups: list[NDArray[np.int64]] = []
    first = 0
    while first < len(known):
        limit = speed_rpm[known[first]] + width_rpm
        last = first + int(np.searchsorted(speed_rpm[known[first:]], limit, side="right"))
        groups.append(np.sort(known[first:last]))
        first = last
    unknown = order[len(known) :]
    return [*groups, np.sort(unknown)] if len(unknown) else groups
