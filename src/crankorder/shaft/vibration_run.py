"""The likeliest run through a grid of speeds that changes no faster than it may, and how likely it is at each knot."""

from __future__ import annotations

import numpy as np

from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.repair import IntArray


def likeliest_run(log_odds: FloatArray, jump: int, cost: float) -> IntArray:
    """States (knots,) of the likeliest run through a grid (Viterbi 1967).

    ``log_odds``: (knots, states). ``jump``: most states between two knots. ``cost``: what a step of n states costs is n
    squared times that.
    """
    n, m = log_odds.shape
    came = np.zeros((n, m), dtype=np.int16)
    steps = np.arange(-jump, jump + 1)
    before = np.full(m + 2 * jump, -np.inf)
    before[jump : jump + m] = log_odds[0]
    from_states = np.lib.stride_tricks.sliding_window_view(before, m)
    price = -cost * steps[:, None] ** 2.0
    for i in range(1, n):
        reached = from_states + price
        best = np.argmax(reached, axis=0)
        came[i] = steps[best]
        before[jump : jump + m] = reached[best, np.arange(m)] + log_odds[i]
    path = np.empty(n, dtype=np.int64)
    path[-1] = np.argmax(before[jump : jump + m])
    for i in range(n - 1, 0, -1):
        path[i - 1] = path[i] + came[i, path[i]]
    return path


def run_probability(
    log_odds: FloatArray, path: IntArray, offsets: IntArray, jump: int, cost: float, near: int
) -> FloatArray:
    """Probability (knots,) that the state is that of a run, or beside it by an offset (Baum et al. 1970).

    ``log_odds``, ``jump``, ``cost``: as for :func:`likeliest_run`. ``path``: (knots,), the run. ``offsets``: states
    from it to others that count as the same. ``near``: states from each of them that do too.
    """
    n, m = log_odds.shape
    step = np.exp(-cost * np.arange(-jump, jump + 1.0) ** 2)
    step /= step.sum()
    ahead = np.empty((n, m), dtype=np.float32)
    now = np.full(m, 1.0 / m)
    for i in range(n):
        now = np.convolve(now, step)[jump : jump + m] * np.exp(log_odds[i] - log_odds[i].max())
        now /= now.sum()
        ahead[i] = now
    result = np.empty(n)
    behind = np.ones(m)
    wanted = (offsets[:, None] + np.arange(-near, near + 1)).ravel()
    for i in range(n - 1, -1, -1):
        both = ahead[i] * behind
        close = np.unique(path[i] + wanted)
        close = close[(close >= 0) & (close < m)]
        result[i] = both[close].sum() / max(float(both.sum()), 1e-300)
        behind = np.convolve(behind * np.exp(log_odds[i] - log_odds[i].max()), step)[jump : jump + m]
        behind /= behind.max()
    return np.minimum(result, 1.0)
