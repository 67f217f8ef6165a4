"""Pulse times smoothed no more than their own noise allows, with the variance that is left.

Teeth are evenly spaced in angle, so the noise of the pulse times is even too, and time as a function of tooth number is
smoothed by penalised least squares on the third difference: minimise sum w (z - t)^2 + penalty sum (third difference
of z)^2 (Whittaker 1923; Eilers 2003). Its gain at ``f`` cycles per tooth is 1 / (1 + (sin(pi f) / sin(pi cut_off))^6).
The cut-off follows from the pulse noise by the discrepancy principle (Morozov 1966): the residual may be no larger
than the noise explains, in the roughest block of the record. Jitter beyond the stated noise is told from motion by its
lack of correlation from tooth to tooth.
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
# Lags at which a residual is tested for being white.
WHITE_LAGS = 8
# Steps of the search: a cut-off is found within the fourth root of 2.
SEARCH_FACTOR = 2.0**0.25


def noise_from_differences(time_s: FloatArray) -> float:
    """Standard deviation of pulse times ``time_s`` (pulses,) [s] from their fourth differences, by the median."""
    if time_s.size < 8:
        return 0.0
    return float(np.median(np.abs(np.diff(time_s, n=4)))) / (0.6745 * math.sqrt(70.0))


def penalty_of(cut_off: float) -> float:
    """Penalty on squared third differences for a half-gain frequency of ``cut_off`` cycles per tooth."""
    return 1e-9 if cut_off > HIGHEST_CUT_OFF else float((2.0 * math.sin(math.pi * cut_off)) ** -6)


def _residual_moments(penalty: float) -> FloatArray:
    """Autocovariance at lags 0 to WHITE_LAGS of the residual that white noise of variance 1 leaves, ends apart."""
    frequency = (np.arange(1024) + 0.5) / 2048.0
    kept = 1.0 - 1.0 / (1.0 + penalty * (2.0 * np.sin(np.pi * frequency)) ** 6)
    lags = np.arange(WHITE_LAGS + 1)[:, None]
    moments: FloatArray = np.mean(kept**2 * np.cos(2.0 * np.pi * frequency * lags), axis=1)
    return moments


def cut_off_of(
    grid: FloatArray, weight: FloatArray, *, noise_s: float, floor: float, margin: float
) -> tuple[float, float]:
    """Cut-off [cycles per tooth] at which the residual of every block is noise, and the noise [s] of a pulse.

    A residual is noise when it is no larger than ``noise_s`` explains or, whatever its size, uncorrelated: then it is
    jitter of the pulses, whose measured size takes the place of ``noise_s``.

    Parameters
    ----------
    grid : (teeth,), s, pulse times by tooth
    weight : (teeth,), 1 where a tooth has a pulse, else 0
    noise_s : standard deviation of one pulse time, s
    floor : lowest cut-off to return, cycles per tooth; kept as it is where the residual there is noise
    margin : 1 or more, on a cut-off above the floor; bias falls with its sixth power, noise grows with its square root
    """
    n_blocks = min(MAX_BLOCKS, max(1, grid.size // BLOCK_TEETH))
    length = min(grid.size, BLOCK_TEETH)
    starts = np.linspace(0, grid.size - length, n_blocks).astype(int)
    cut_off, noise = floor, noise_s
    for start in starts:
        times, weights = grid[start : start + length] - grid[start], weight[start : start + length]
        count = weights.sum()
        while cut_off <= HIGHEST_CUT_OFF:
            penalty = penalty_of(cut_off)
            white = _residual_moments(penalty)
            residual = weights * (times - smoothed(times, weights, penalty))
            variance = float(residual @ residual) / (count * max(white[0], 1.0 / count))
            if variance <= noise_s**2 * (1.0 + 3.0 / np.sqrt(count)):
                break
            if _is_white(residual, white, count):
                noise = max(noise, float(np.sqrt(variance)))
                break
            cut_off *= SEARCH_FACTOR
    return (cut_off if cut_off == floor else margin * cut_off), noise


def _is_white(residual: FloatArray, white: FloatArray, count: float) -> bool:
    """Whether the correlation of ``residual`` at every lag is what white noise would leave, within three deviations."""
    lags = min(WHITE_LAGS, int(count) // 4)
    if lags < 3:
        return False
    total = float(residual @ residual)
    found = np.array([float(residual[:-lag] @ residual[lag:]) / total for lag in range(1, lags + 1)])
    return bool(np.max(np.abs(found - white[1 : lags + 1] / white[0])) < 3.0 / np.sqrt(count))


def smoothed(value: FloatArray, weight: FloatArray, penalty: float) -> FloatArray:
    """Solution z (teeth,) of (W + penalty D'D) z = W value, D the third difference; O(n).

    Parameters
    ----------
    value : (teeth,), s; where ``weight`` is 0, anything not far from its neighbours
    weight : (teeth,), 1 where a tooth has a pulse, else 0; at least three are 1
    penalty : above 0
    """
    result: FloatArray = _solved(value, penalty, *_factors(weight, penalty))
    return result


def leverage(weight: FloatArray, penalty: float) -> FloatArray:
    """Variance of each smoothed time over that of one pulse time: the diagonal of (W + penalty D'D)^-1; O(n).

    ``weight`` (teeth,) is 1 where a tooth has a pulse, else 0; ``penalty`` is above 0.
    """
    result: FloatArray = _inverse_diagonal(*_factors(weight, penalty))
    return result


@njit(cache=True, nogil=True)
def _factors(weight, penalty):  # type: ignore[no-untyped-def]
    """Factors of W + penalty D'D = L diag(d) L': d and the three bands of L below its unit diagonal.

    Away from ends and holes they settle, and are then copied.
    """
    n = weight.size
    d, a, b, c = np.empty(n), np.zeros(n), np.zeros(n), np.zeros(n)
    steady = 0
    for i in range(n):
        inside = 3 < i < n - 3
        if inside and steady > 3 and weight[i] == weight[i - 1]:
            d[i], a[i], b[i], c[i] = d[i - 1], a[i - 1], b[i - 1], c[i - 1]
            continue
        p0, p1, p2, p3 = (20.0, -15.0, 6.0, -1.0) if inside else _penalty_row(i, n)
        pivot, low1, low2, low3 = weight[i] + penalty * p0, penalty * p1, penalty * p2, penalty * p3
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
        same = i > 0 and weight[i] == weight[i - 1] and abs(d[i] - d[i - 1]) <= 2e-16 * d[i]
        steady = steady + 1 if same else 0
    return d, a, b, c


@njit(cache=True, nogil=True)
def _solved(value, penalty, d, a, b, c):  # type: ignore[no-untyped-def]
    """``value`` less the solution u of (W + penalty D'D) u = penalty D'D value, which is small: so is its round-off."""
    n = value.size
    z = np.zeros(n)
    for i in range(n - 3):
        third = penalty * ((value[i + 3] - value[i]) - 3.0 * (value[i + 2] - value[i + 1]))
        z[i] -= third
        z[i + 1] += 3.0 * third
        z[i + 2] -= 3.0 * third
        z[i + 3] += third
    z1 = z2 = z3 = a1 = b1 = b2 = c1 = c2 = c3 = 0.0
    for i in range(n):
        now = z[i] - a1 * z1 - b2 * z2 - c3 * z3
        z[i] = now
        z1, z2, z3 = now, z1, z2
        a1, b1, b2, c1, c2, c3 = a[i], b[i], b1, c[i], c1, c2
    z1 = z2 = z3 = 0.0
    for i in range(n - 1, -1, -1):
        now = z[i] / d[i] - a[i] * z1 - b[i] * z2 - c[i] * z3
        z1, z2, z3 = now, z1, z2
        z[i] = value[i] - now
    return z


@njit(cache=True, nogil=True)
def _inverse_diagonal(d, a, b, c):  # type: ignore[no-untyped-def]
    """Diagonal of (L diag(d) L')^-1 from the last row up (Takahashi, Fagan and Chin 1973)."""
    n = d.size
    out = np.empty(n)
    # the inverse at (i+1, i+1) ... (i+3, i+3)
    s11 = s12 = s13 = s22 = s23 = s33 = 0.0
    for i in range(n - 1, -1, -1):
        s01 = -(a[i] * s11 + b[i] * s12 + c[i] * s13)
        s02 = -(a[i] * s12 + b[i] * s22 + c[i] * s23)
        s03 = -(a[i] * s13 + b[i] * s23 + c[i] * s33)
        s00 = 1.0 / d[i] - (a[i] * s01 + b[i] * s02 + c[i] * s03)
        out[i] = s00
        s33, s23, s22, s13, s12, s11 = s22, s12, s11, s02, s01, s00
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
