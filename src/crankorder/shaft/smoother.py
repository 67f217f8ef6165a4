"""Pulse times smoothed no more than their own noise allows, with the variance that is left.

Teeth are evenly spaced in angle, so the noise of the pulse times is even too, and time as a function of tooth number is
smoothed by penalised least squares on the third difference: minimise sum w (z - t)^2 + penalty sum (third difference
of z)^2 (Whittaker 1923; Eilers 2003). Its gain at ``f`` cycles per tooth is 1 / (1 + (sin(pi f) / sin(pi cut_off))^6).
The cut-off follows from the pulse noise by the discrepancy principle (Morozov 1966): the residual may be no larger
than the noise explains, in the roughest block of the record.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from crankorder.shaft.pulses import FloatArray

# Teeth in a block on which the cut-off is sought, and the most blocks that are looked at.
BLOCK_TEETH, MAX_BLOCKS = 2048, 12
# Cut-offs, in cycles per tooth: below the first the normal equations are too stiff; above the second smoothing does
# nothing worth having and the pulses are interpolated.
LOWEST_CUT_OFF, HIGHEST_CUT_OFF = 0.003, 0.35
# Steps of the search: a cut-off is found within the fourth root of 2.
SEARCH_FACTOR = 2.0**0.25
# Up to so many teeth the leverage is exact; above, its profile at the ends is that of an even record.
EXACT_TEETH = 192


def noise_from_differences(time_s: FloatArray) -> float:
    """Standard deviation of pulse times ``time_s`` (pulses,) [s] from their fourth differences, by the median."""
    if time_s.size < 8:
        return 0.0
    return float(np.median(np.abs(np.diff(time_s, n=4)))) / (0.6745 * np.sqrt(70.0))


def penalty_of(cut_off: float) -> float:
    """Penalty on squared third differences for a half-gain frequency of ``cut_off`` cycles per tooth."""
    return 1e-9 if cut_off > HIGHEST_CUT_OFF else (2.0 * math.sin(math.pi * cut_off)) ** -6.0


def _gain_moments(penalty: float) -> tuple[float, float]:
    """Mean over frequency of the smoother's gain and of its square: its leverages in an even record."""
    gain = 1.0 / (1.0 + penalty * (2.0 * np.sin(np.pi * (np.arange(4096) + 0.5) / 8192.0)) ** 6)
    return float(gain.mean()), float((gain**2).mean())


def cut_off_of(grid: FloatArray, weight: FloatArray, *, noise_s: float, floor: float, margin: float) -> float:
    """Cut-off [cycles per tooth] at which the residual of every block is what the noise explains, times ``margin``.

    Parameters
    ----------
    grid : (teeth,), s, pulse times by tooth
    weight : (teeth,), 1 where a tooth has a pulse, else 0
    noise_s : standard deviation of one pulse time, s
    floor : lowest cut-off to return, cycles per tooth; kept as it is where the noise explains the residual there
    margin : 1 or more; bias falls with its sixth power, noise grows with its square root
    """
    n_blocks = min(MAX_BLOCKS, max(1, grid.size // BLOCK_TEETH))
    length = min(grid.size, BLOCK_TEETH)
    starts = np.linspace(0, grid.size - length, n_blocks).astype(int)
    cut_off = floor
    for start in starts:
        times, weights = grid[start : start + length] - grid[start], weight[start : start + length]
        count = weights.sum()
        allowed = noise_s**2 * (1.0 + 3.0 / np.sqrt(count))
        while cut_off <= HIGHEST_CUT_OFF:
            penalty = penalty_of(cut_off)
            mean, square = _gain_moments(penalty)
            residual = weights * (times - smoothed(times, weights, penalty))
            if float(residual @ residual) <= count * allowed * max(1.0 - 2.0 * mean + square, 1.0 / count):
                break
            cut_off *= SEARCH_FACTOR
    return cut_off if cut_off == floor else margin * cut_off


def leverage(weight: FloatArray, cut_off: float) -> FloatArray:
    """Variance of each smoothed time over the variance of one pulse time: the diagonal of (W + penalty D'D)^-1.

    ``weight`` (teeth,) is 1 where a tooth has a pulse, ``cut_off`` in cycles per tooth. Exact up to EXACT_TEETH teeth;
    above, the ends have the profile of an even record, which scales with the cut-off, and holes are not seen.
    """
    if weight.size <= EXACT_TEETH:
        return _exact_leverage(weight, penalty_of(cut_off))
    inner = _gain_moments(penalty_of(cut_off))[0]
    scale = max(cut_off, 0.02)
    profile = _exact_leverage(np.ones(EXACT_TEETH), penalty_of(scale))[: EXACT_TEETH // 2]
    reach = np.arange(profile.size) * scale / min(cut_off, 0.5)
    end = inner * profile / profile[-1]
    out = np.interp(np.arange(weight.size), reach, end, right=inner)
    both: FloatArray = np.maximum(out, out[::-1])
    return both


def _exact_leverage(weight: FloatArray, penalty: float) -> FloatArray:
    size = weight.size
    system = np.diag(weight)
    if size > 3:
        third = np.diff(np.eye(size), n=3, axis=0)
        system += penalty * (third.T @ third)
    return np.diag(np.linalg.inv(system)).copy()


@njit(cache=True, nogil=True)
def smoothed(value, weight, penalty):  # type: ignore[no-untyped-def]
    """Solution z of (W + penalty D'D) z = W value, D the third difference, by banded LDL'; O(n).

    ``value`` (teeth,) [s], ``weight`` (teeth,), ``penalty`` > 0. The line through the ends is taken out first: D does
    not see it, and round-off then scales with what is left. Away from ends and holes the factors repeat.
    """
    n = value.size
    out = np.empty(n)
    first, last = 0, n - 1
    slope = (value[last] - value[first]) / max(1, last - first)
    d, a, b, c, z = np.empty(n), np.zeros(n), np.zeros(n), np.zeros(n), np.empty(n)
    steady = 0
    for i in range(n):
        # row i of D'D: bands of the products of (-1, 3, -3, 1) that fit into the record
        inside = 3 <= i < n - 3
        if inside:
            p0, p1, p2, p3 = 20.0, -15.0, 6.0, -1.0
        else:
            p0, p1, p2, p3 = _penalty_row(i, n)
        w = weight[i]
        z[i] = w * (value[i] - value[first] - slope * i)
        if inside and steady > 4 and w == weight[i - 1] and i > 9:
            d[i], a[i], b[i], c[i] = d[i - 1], a[i - 1], b[i - 1], c[i - 1]
        else:
            # a[i] = L[i+1, i], b[i] = L[i+2, i], c[i] = L[i+3, i]
            pivot, low1, low2, low3 = w + penalty * p0, penalty * p1, penalty * p2, penalty * p3
            if i >= 1:
                pivot -= a[i - 1] ** 2 * d[i - 1]
                low1 -= a[i - 1] * b[i - 1] * d[i - 1]
                low2 -= a[i - 1] * c[i - 1] * d[i - 1]
            if i >= 2:
                pivot -= b[i - 2] ** 2 * d[i - 2]
                low1 -= b[i - 2] * c[i - 2] * d[i - 2]
            if i >= 3:
                pivot -= c[i - 3] ** 2 * d[i - 3]
            d[i], a[i], b[i], c[i] = pivot, low1 / pivot, low2 / pivot, low3 / pivot
            same = i > 0 and abs(d[i] - d[i - 1]) <= 1e-15 * d[i] and w == weight[i - 1]
            steady = steady + 1 if same else 0
        if i >= 1:
            z[i] -= a[i - 1] * z[i - 1]
        if i >= 2:
            z[i] -= b[i - 2] * z[i - 2]
        if i >= 3:
            z[i] -= c[i - 3] * z[i - 3]
    for i in range(n - 1, -1, -1):
        total = z[i] / d[i]
        if i + 1 < n:
            total -= a[i] * z[i + 1]
        if i + 2 < n:
            total -= b[i] * z[i + 2]
        if i + 3 < n:
            total -= c[i] * z[i + 3]
        z[i] = total
        out[i] = total + value[first] + slope * i
    return out


@njit(cache=True, nogil=True)
def _penalty_row(i, n):  # type: ignore[no-untyped-def]
    """Entries (i, i) to (i, i + 3) of D'D for the third difference of ``n`` values."""
    stencil = (-1.0, 3.0, -3.0, 1.0)
    row = np.zeros(4)
    for first in range(max(0, i - 3), min(i, n - 4) + 1):
        for k in range(4):
            j = i + k - first
            if j < 4:
                row[k] += stencil[i - first] * stencil[j]
    return row[0], row[1], row[2], row[3]
