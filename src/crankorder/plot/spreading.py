"""Labels along an edge, spread so that none lies on another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def spread(targets: Sequence[float], widths: Sequence[float], *, low: float, high: float) -> NDArray[np.float64]:
    """Centres nearest to their targets (least squares) with no overlap, in the same order, inside low…high.

    ``targets`` wanted centres, ascending; ``widths`` room that each needs; ``low`` and ``high`` ends of the edge, all
    in one unit. Where the room does not suffice, all are set at equal shares of the edge. Source: isotonic regression
    by pooling adjacent violators (Ayer et al. 1955).
    """
    width = np.asarray(widths, dtype=float)
    if width.sum() >= high - low:
        shares = np.cumsum(width) - width / 2
        return np.asarray(low + shares * (high - low) / max(float(width.sum()), 1e-12))
    offset = np.cumsum(width) - width / 2
    blocks: list[tuple[float, int]] = []
    for value in np.asarray(targets, dtype=float) - offset:
        mean, count = float(value), 1
        while blocks and blocks[-1][0] > mean:
            before, n = blocks.pop()
            mean, count = (before * n + mean * count) / (n + count), n + count
        blocks.append((mean, count))
    starts = np.repeat([mean for mean, _ in blocks], [count for _, count in blocks]) if blocks else np.empty(0)
    return np.asarray(np.clip(starts, low, high - width.sum()) + offset)
