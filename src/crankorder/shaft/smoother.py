"""Pulse times smoothed no more than their own noise allows, with the variance that is left.

Teeth are evenly spaced in angle, so the noise of the pulse times is even too, and time as a function of tooth number is
smoothed by penalised least squares on the third difference: minimise sum w (z - t)^2 + penalty sum (third difference
of z)^2 (Whittaker 1923; Eilers 2003). Its gain at ``f`` cycles per tooth is 1 / (1 + (sin(pi f) / sin(pi cut_off))^6).
Where only one in ``spacing`` teeth has a pulse, that holds per pulse, with spacing^5 times the penalty. The cut-off
follows from the pulse noise by the discrepancy principle (Morozov 1966): the residual may be no larger than the noise
explains, in the roughest block of the record. Jitter beyond the stated noise is told from motion by its lack of
correlation from tooth to tooth.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view

from crankorder.quantities import Floats, Ints

# Pulses in a block on which the cut-off is sought, and the most blocks that are looked at.
BLOCK_PULSES, MAX_BLOCKS = 2048, 12
# Cut-offs: below the first, in cycles per tooth, the normal equations are too stiff; above the second, in cycles per
# pulse, smoothing does nothing worth having and the pulses are interpolated.
LOWEST_CUT_OFF, HIGHEST_CUT_OFF = 0.003, 0.35
# Lags at which a residual is tested for being white.
WHITE_LAGS = 8
# Factors have settled when their rows change by no more than this, in weights of one pulse, and by this share of
# themselves; variances, when they change by no more than this share.
SETTLED, SETTLED_SHARE, SETTLED_VARIANCE = 1e-4, 1e-11, 1e-11
# Steps of the search: a cut-off is found within the fourth root of 2.
SEARCH_FACTOR = 2.0**0.25


def noise_from_differences(time_s: Floats, tooth: Ints) -> float:
    """Standard deviation [s] of pulse times, by the median of their fourth divided differences over the tooth number.

    ``time_s`` (pulses,) [s] are the times of the teeth numbered ``tooth`` (pulses,), rising. A few blocks of a long
    train are enough.
    """
    if time_s.size < 8:
        return 0.0
    if time_s.size > MAX_BLOCKS * BLOCK_PULSES:
        starts = np.linspace(0, time_s.size - BLOCK_PULSES, MAX_BLOCKS).astype(int)
        some = starts[:, None] + np.arange(BLOCK_PULSES)
        time_s, tooth = time_s[some], tooth[some]
    times, teeth = (sliding_window_view(values, 5, axis=-1) for values in (time_s, tooth))
    apart = (teeth[..., :, None] - teeth[..., None, :]).astype(np.float64)
    weight = 1.0 / np.prod(apart + np.eye(5), axis=-1)
    change = np.sum(weight * (times - times[..., :1]), axis=-1)
    return float(np.median(np.abs(change) / np.sqrt(np.sum(weight**2, axis=-1)))) / 0.6745


def penalty_of(cut_off: float, spacing: float = 1.0) -> float:
    """Penalty on squared third differences for a half-gain frequency of ``cut_off`` cycles per pulse.

    ``spacing`` is the number of teeth per pulse, 1 where every tooth has one.
    """
    return spacing**5 * (1e-9 if cut_off > HIGHEST_CUT_OFF else (2.0 * math.sin(math.pi * cut_off)) ** -6)


@functools.lru_cache(maxsize=64)
def _residual_moments(penalty: float) -> Floats:
    """Autocovariance at lags 0 to WHITE_LAGS of the residual that white noise of variance 1 leaves, ends apart."""
    frequency = (np.arange(1024) + 0.5) / 2048.0
    kept = 1.0 - 1.0 / (1.0 + penalty * (2.0 * np.sin(np.pi * frequency)) ** 6)
    lags = np.arange(WHITE_LAGS + 1)[:, None]
    return np.asarray(np.mean(kept**2 * np.cos(2.0 * np.pi * frequency * lags), axis=1))


def cut_off_of(grid: Floats, weight: Floats, *, noise_s: float, floor: float, margin: float) -> tuple[float, float]:
    """Cut-off [cycles per pulse] at which the residual of every block is noise, and the noise [s] of a pulse.

    A residual is noise when it is no larger than ``noise_s`` explains or, whatever its size, uncorrelated: then it is
    jitter of the pulses, whose measured size takes the place of ``noise_s``.

    Parameters
    ----------
    grid : (teeth,), s, pulse times by tooth
    weight : (teeth,), 1 where a tooth has a pulse, else 0
    noise_s : standard deviation of one pulse time, s
    floor : lowest cut-off to return, cycles per pulse; kept as it is where the residual there is noise
    margin : factor of 1 or more on a cut-off above the floor; bias falls with its sixth power, noise grows with its
        square root
    """
    spacing = float(weight.size / weight.sum())
    n_blocks = min(MAX_BLOCKS, max(1, int(grid.size / (BLOCK_PULSES * spacing))))
    length = min(grid.size, round(BLOCK_PULSES * spacing))
    starts = np.linspace(0, grid.size - length, n_blocks).astype(int)
    cut_off, noise = floor, noise_s
    smoother: Smoother | None = None
    for start in starts:
        times, weights = grid[start : start + length] - grid[start], weight[start : start + length]
        count, pulse = weights.sum(), weights > 0.0
        while cut_off <= HIGHEST_CUT_OFF:
            penalty, white = penalty_of(cut_off, spacing), _residual_moments(penalty_of(cut_off))
            if smoother is None or smoother.penalty != penalty or not np.array_equal(weights, smoother.weight):
                smoother = Smoother(weights, penalty)
            residual = (times - smoother.smoothed(times))[pulse]
            variance = float(residual @ residual) / (count * max(white[0], 1.0 / count))
            if variance <= noise_s**2 * (1.0 + 3.0 / np.sqrt(count)):
                break
            if _is_white(residual, white, count):
                noise = max(noise, float(np.sqrt(variance)))
                break
            cut_off *= SEARCH_FACTOR
    return (cut_off if cut_off == floor else margin * cut_off), noise


def _is_white(residual: Floats, white: Floats, count: float) -> bool:
    """Whether the correlation of ``residual`` at every lag is what white noise would leave, within three deviations."""
    lags = min(WHITE_LAGS, int(count) // 4)
    if lags < 3:
        return False
    total = float(residual @ residual)
    correlation = np.array([float(residual[:-lag] @ residual[lag:]) / total for lag in range(1, lags + 1)])
    return bool(np.max(np.abs(correlation - white[1 : lags + 1] / white[0])) < 3.0 / np.sqrt(count))


class Smoother:
    """W + penalty D'D for given teeth, factored once as L diag(d) L'.

    Away from ends and holes the rows of the factors settle; only those that differ are kept, in ``table`` (rows, 4) of
    d and the three bands of L below its unit diagonal; ``row`` (teeth,) says which of them a tooth has.
    """

    def __init__(self, weight: Floats, penalty: float) -> None:
        """For ``weight`` (teeth,), 1 where a tooth has a pulse (three at least), else 0, and a ``penalty`` above 0."""
        self.weight, self.penalty = weight, penalty
        table, self.row = np.empty((weight.size, 4)), np.empty(weight.size, dtype=np.int32)
        settled = max(2e-16, min(SETTLED_SHARE, SETTLED / penalty))
        used = _factors(weight, penalty, _penalty_rows(min(weight.size, 8)), settled, table, self.row)
        self.table = table[:used]

    def smoothed(self, value: Floats) -> Floats:
        """Solution z (teeth,) of (W + penalty D'D) z = W ``value``, D the third difference; O(n).

        ``value`` (teeth,), s; where the weight is 0, anything not far from its neighbours.
        """
        result = np.empty(value.size)
        _solve(value, self.penalty, self.table, self.row, result)
        return result

    def leverage(self) -> Floats:
        """Variance of each smoothed time over that of one pulse time: the diagonal of (W + penalty D'D)^-1; O(n)."""
        result = np.empty(self.row.size)
        _inverse_diagonal(self.table, self.row, result)
        return result


@functools.cache
def _penalty_rows(n: int) -> Floats:
    """Entries (i, i) to (i, i + 3) of each row i of D'D for the third difference of ``n`` values, 0 beyond its edge."""
    third = np.diff(np.eye(n), n=3, axis=0)
    product = np.pad(third.T @ third, ((0, 0), (0, 3)))
    return np.array([product[i, i : i + 4] for i in range(n)])


@njit(cache=True, nogil=True, error_model="numpy")
def _factors(weight, penalty, rows, settled, table, row):  # type: ignore[no-untyped-def]
    """Fill ``table`` with rows d, a, b, c of the factors of W + penalty D'D, settled ones once; how many there are.

    ``row`` takes the row of each tooth; ``rows`` holds those of D'D for 8 teeth, or all if there are fewer.
    """
    n, used, steady = weight.size, 0, 0
    d1 = d2 = d3 = a1 = b1 = b2 = c1 = c2 = c3 = 0.0
    for i in range(n):
        inside = 3 < i < n - 3
        if inside and steady > 3 and weight[i] == weight[i - 1]:
            row[i] = used - 1
            continue
        p = 3 if inside else (i if i < 4 else i - n + rows.shape[0])
        pivot = weight[i] + penalty * rows[p, 0] - a1 * a1 * d1 - b2 * b2 * d2 - c3 * c3 * d3
        low1 = penalty * rows[p, 1] - a1 * b1 * d1 - b2 * c2 * d2
        low2 = penalty * rows[p, 2] - a1 * c1 * d1
        low3 = penalty * rows[p, 3]
        same = i > 0 and weight[i] == weight[i - 1] and abs(pivot - d1) <= settled * pivot
        steady = steady + 1 if same else 0
        d3, c3 = d2, c2
        d2, b2, c2 = d1, b1, c1
        d1, a1, b1, c1 = pivot, low1 / pivot, low2 / pivot, low3 / pivot
        table[used, 0], table[used, 1], table[used, 2], table[used, 3] = d1, a1, b1, c1
        row[i] = used
        used += 1
        if steady > 3:
            # the rows that follow find these above them
            d2 = d3 = d1
            b2, c2, c3 = b1, c1, c1
    return used


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _solve(value, penalty, table, row, z):  # type: ignore[no-untyped-def]
    """Fill ``z`` with ``value`` less the solution u of (W + penalty D'D) u = penalty D'D value.

    That is small, and so is its round-off.
    """
    n = value.size
    z1 = z2 = z3 = a1 = b1 = b2 = c1 = c2 = c3 = t1 = t2 = t3 = 0.0
    for i in range(n):
        t0 = 0.0
        if i + 3 < n:
            t0 = penalty * ((value[i + 3] - value[i]) - 3.0 * (value[i + 2] - value[i + 1]))
        now = (((3.0 * (t1 - t2) + (t3 - t0)) - c3 * z3) - b2 * z2) - a1 * z1
        z[i] = now
        k = row[i]
        t1, t2, t3 = t0, t1, t2
        z1, z2, z3 = now, z1, z2
        a1, b1, b2, c1, c2, c3 = table[k, 1], table[k, 2], b1, table[k, 3], c1, c2
    z1 = z2 = z3 = 0.0
    for i in range(n - 1, -1, -1):
        k = row[i]
        now = ((z[i] / table[k, 0] - table[k, 3] * z3) - table[k, 2] * z2) - table[k, 1] * z1
        z1, z2, z3 = now, z1, z2
        z[i] = value[i] - now


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse_diagonal(table, row, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` with the diagonal of (L diag(d) L')^-1 from the last row up; settled rows are copied.

    Source: Takahashi, Fagan and Chin 1973.
    """
    n = row.size
    # the inverse at (i+1, i+1) ... (i+3, i+3)
    s11 = s12 = s13 = s22 = s23 = s33 = 0.0
    steady = 0
    for i in range(n - 1, -1, -1):
        k = row[i]
        same = i + 1 < n and k == row[i + 1]
        if same and steady > 3:
            out[i] = s11
            continue
        a, b, c = table[k, 1], table[k, 2], table[k, 3]
        s01 = -(a * s11 + b * s12 + c * s13)
        s02 = -(a * s12 + b * s22 + c * s23)
        s03 = -(a * s13 + b * s23 + c * s33)
        s00 = 1.0 / table[k, 0] - (a * s01 + b * s02 + c * s03)
        steady = steady + 1 if same and abs(s00 - s11) <= SETTLED_VARIANCE * s00 else 0
        out[i] = s00
        s33, s23, s22, s13, s12, s11 = s22, s12, s11, s02, s01, s00
