"""Crank angle and speed on time knots from numbered pulses, with the standard error of the angle.

Teeth are evenly spaced in angle, so the noise of the pulse times is even too, and time as a function of tooth number is
smoothed by penalised least squares on the third difference: minimise sum w (z - t)^2 + penalty sum (third difference
of z)^2 (Whittaker 1923; Eilers 2003). Its gain at ``f`` cycles per tooth is 1 / (1 + (sin(pi f) / sin(pi cut_off))^6).
The cut-off follows from the pulse noise by the discrepancy principle (Morozov 1966): the residual may be no larger
than the noise explains, in the roughest block of the record.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import FloatArray
from crankorder.shaft.wheel import IntArray

# Teeth in a block on which the cut-off is sought, and the most blocks that are looked at.
BLOCK_TEETH, MAX_BLOCKS = 2048, 12
# Cut-offs, in cycles per tooth: below the first a record is too short or the normal equations too stiff to tell;
# above the second smoothing does nothing worth having and the pulses are interpolated.
LOWEST_CUT_OFF, HIGHEST_CUT_OFF = 0.003, 0.35
# Steps of the search: a cut-off is found within the sixth root of 2.
SEARCH_FACTOR = 2.0 ** (1.0 / 6.0)
# Interpolation between knots may err by this share of the standard error, or by ROUND_OFF_REV if that is more.
KNOT_ERROR_SHARE, ROUND_OFF_REV = 0.1, 1e-10
# Up to so many teeth the standard error is exact; above, its profile at the ends is that of an even record.
EXACT_ERROR_TEETH = 256


@dataclass(frozen=True)
class AngleKnots:
    """Knots (knots,) of crank angle: time [s], angle [rev], speed [rpm], standard error of the angle [rev].

    Between knots the angle is the cubic Hermite polynomial whose slopes are the speeds. ``cut_off_order`` is the order
    (cycles per crank revolution) above which motion is smoothed away; infinite where nothing is.
    """

    time_s: FloatArray
    angle_rev: FloatArray
    speed_rpm: FloatArray
    standard_error_rev: FloatArray
    cut_off_order: float


def angle_knots(
    time_s: FloatArray,
    tooth: IntArray,
    *,
    teeth_per_rev: float,
    noise_s: float | None,
    settings: ShaftSettings,
) -> AngleKnots:
    """Knots of the smoothed crank angle, 0 at tooth 0, from one tooth before the first pulse to one after the last.

    Parameters
    ----------
    time_s : (pulses,), s, increasing
    tooth : (pulses,), tooth numbers, increasing; holes are teeth without a pulse
    teeth_per_rev : teeth per crank revolution (of the full wheel, times encoder revolutions per crank revolution)
    noise_s : standard deviation of one pulse time, s; None where unknown: it is then taken from the fourth differences
    settings : ``kept_order`` is never smoothed away where the wheel carries it (more keeps more noise);
        ``smoothing_margin`` multiplies the cut-off that the noise asks for (bias falls with its sixth power)

    Returns
    -------
    AngleKnots, no more of them than cubic interpolation to a tenth of the standard error needs.
    """
    start = time_s[0]
    grid, weight = _on_grid(time_s - start, tooth)
    noise = _noise_from_differences(grid[weight > 0]) if noise_s is None else noise_s
    noise = max(noise, float(np.spacing(max(abs(start), grid[-1]))))
    floor = max(LOWEST_CUT_OFF, min(settings.kept_order / teeth_per_rev, 0.05))
    cut_off = _cut_off(grid, weight, noise, floor, settings.smoothing_margin)
    smooth = _smoothed(grid, weight, _penalty(cut_off))
    slope = _spline_slopes(smooth)
    error_s = noise * np.sqrt(_leverage(weight, cut_off))
    # one tooth more at either end, along the tangent
    smooth = np.concatenate(([smooth[0] - slope[0]], smooth, [smooth[-1] + slope[-1]]))
    slope = np.concatenate((slope[:1], slope, slope[-1:]))
    error_s = np.concatenate((2.0 * error_s[:1], error_s, 2.0 * error_s[-1:]))
    angle = np.arange(tooth[0] - 1, tooth[-1] + 2) / teeth_per_rev
    rate = _monotone(smooth, angle, 1.0 / (teeth_per_rev * slope))
    standard_error = error_s * rate
    at = _sparse(smooth, angle, rate, max(KNOT_ERROR_SHARE * float(np.median(standard_error)), ROUND_OFF_REV), cut_off)
    order = cut_off * teeth_per_rev if cut_off <= HIGHEST_CUT_OFF else float("inf")
    return AngleKnots(smooth[at] + start, angle[at], rate[at] * 60.0, standard_error[at], order)


def _on_grid(time_s: FloatArray, tooth: IntArray) -> tuple[FloatArray, FloatArray]:
    """Pulse times on the even grid of tooth numbers, and weights: 0 where a tooth has no pulse."""
    place = tooth - tooth[0]
    grid, weight = np.zeros(place[-1] + 1), np.zeros(place[-1] + 1)
    grid[place], weight[place] = time_s, 1.0
    return grid, weight


def _noise_from_differences(time_s: FloatArray) -> float:
    """Standard deviation of pulse times from their fourth differences (weights 1 4 6 4 1), by the median."""
    if time_s.size < 8:
        return 0.0
    return float(np.median(np.abs(np.diff(time_s, n=4)))) / (0.6745 * np.sqrt(70.0))


def _penalty(cut_off: float) -> float:
    """Penalty on squared third differences whose half-gain frequency is ``cut_off`` cycles per tooth; 0: interpolate."""
    return 1e-9 if cut_off > HIGHEST_CUT_OFF else float((2.0 * np.sin(np.pi * cut_off)) ** -6.0)


def _gain_moments(penalty: float) -> tuple[float, float]:
    """Mean over frequency of the smoother's gain and of its square: its leverages in an even record."""
    gain = 1.0 / (1.0 + penalty * (2.0 * np.sin(np.pi * (np.arange(4096) + 0.5) / 8192.0)) ** 6)
    return float(gain.mean()), float((gain**2).mean())


def _cut_off(grid: FloatArray, weight: FloatArray, noise_s: float, floor: float, margin: float) -> float:
    """Cut-off [cycles per tooth] at which the residual of every block is what the noise explains, times ``margin``."""
    n_blocks = min(MAX_BLOCKS, max(1, grid.size // BLOCK_TEETH))
    length = min(grid.size, BLOCK_TEETH)
    starts = np.linspace(0, grid.size - length, n_blocks).astype(int)
    cut_off = floor
    for start in starts:
        times, weights = grid[start : start + length] - grid[start], weight[start : start + length]
        count = weights.sum()
        allowed = noise_s**2 * (1.0 + 3.0 / np.sqrt(count))
        while cut_off <= HIGHEST_CUT_OFF:
            penalty = _penalty(cut_off)
            mean, square = _gain_moments(penalty)
            residual = weights * (times - _smoothed(times, weights, penalty))
            if float(residual @ residual) <= count * allowed * max(1.0 - 2.0 * mean + square, 1.0 / count):
                break
            cut_off *= SEARCH_FACTOR
    return cut_off if cut_off == floor else margin * cut_off


@njit(cache=True, nogil=True)
def _smoothed(value, weight, penalty):  # type: ignore[no-untyped-def]
    """Solution z of (W + penalty D'D) z = W value, D the third difference, by banded LDL'; O(n).

    The straight line through the ends is taken out first: D does not see it, and round-off then scales with what is left.
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
