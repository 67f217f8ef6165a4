"""Knots of the envelopes of a Vold-Kalman filter, as close as its bandwidth asks for, and splines on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

DEGREE = 5
"""Of the envelopes between knots. Those of a filter of n poles have 2n - 2 smooth derivatives."""

FEWEST_INTERVALS = 16
"""However narrow the band: the envelope may still bend in a record that is shorter than the filter's response."""

SPLINE_CORRELATION = np.array([15724248, 9738114, 2203488, 152637, 2036, 1]) / 15724248.0
"""Correlation of white noise between quintic splines that are 0 … 5 knots apart: splines of degree 11 at the knots."""

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Knots:
    """Knots half a sample before the samples ``starts`` (intervals + 1,), the last one after the end."""

    starts: NDArray[np.int64]

    @property
    def middles(self) -> _Array:
        """Middle of each interval [samples]."""
        return np.asarray(0.5 * (self.starts[1:] + self.starts[:-1] - 1.0), dtype=np.float64)

    @property
    def intervals(self) -> int:
        """Number of intervals between knots."""
        return len(self.starts) - 1

    @cached_property
    def extended(self) -> _Array:
        """Knots [samples] with the ends repeated, so that the first and last spline are one at the ends."""
        inner = self.starts - 0.5
        return np.concatenate([np.full(DEGREE, inner[0]), inner, np.full(DEGREE, inner[-1])])

    @cached_property
    def runs(self) -> NDArray[np.int64]:
        """First interval of each run of intervals (runs,) between whose neighbours nothing changes."""
        lengths = np.diff(self.starts)
        changed = np.flatnonzero(np.diff(lengths)) + 1
        changed = np.concatenate([[0], changed, [self.intervals]])
        near = np.clip(changed[:, None] + np.arange(-DEGREE, DEGREE + 1), 0, self.intervals - 1)
        return np.unique(near)


def place_knots(spacing: _Array, n_samples: int, *, fewest: int = FEWEST_INTERVALS) -> Knots:
    """Knots across ``n_samples`` whose distance follows ``spacing`` [samples] (points,), even across the record.

    At least ``fewest`` intervals, none shorter than a sample. Where the spacing does not change, all intervals hold
    equally many samples, or the last ones one more.
    """
    spacing = np.asarray(spacing, dtype=np.float64)
    if np.all(spacing == spacing[0]):
        step = max(1, min(int(spacing[0]), n_samples // fewest))
        intervals = n_samples // step
        lengths = np.full(intervals + 1, n_samples // intervals)
        lengths[0] = 0
        lengths[intervals + 1 - n_samples % intervals :] += 1
        return Knots(np.cumsum(lengths))
    rate = 1.0 / spacing
    count = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])
    total = float(count[-1]) * n_samples / (len(rate) - 1)
    intervals = min(max(round(total), fewest), n_samples)
    place = np.interp(np.arange(intervals + 1) / intervals, count / count[-1], np.linspace(0.0, n_samples, len(count)))
    return Knots(np.unique(np.round(place).astype(np.int64)))


def spline_pieces(knots: _Array, at: NDArray[np.int64], degree: int) -> _Array:
    """Powers of u in (-1, 1) (intervals, degree + 1 splines, degree + 1 powers) of B-splines in the intervals ``at``.

    ``knots`` hold ``degree`` repeated ends before and after the intervals. Source: de Boor 1972, recursion.
    """
    left, right = knots[degree + at], knots[degree + 1 + at]
    middle, half = 0.5 * (left + right), 0.5 * (right - left)
    found = np.zeros((len(at), degree + 1, degree + 1))
    found[:, degree, 0] = 1.0
    for k in range(1, degree + 1):
        new = np.zeros_like(found)
        for place in range(degree - k, degree + 1):
            # spline number at + place of degree k rises over the first and falls over the second support
            j = at + place
            for source, zero, one in ((place, knots[j], knots[j + k]), (place + 1, knots[j + k + 1], knots[j + 1])):
                if source > degree:
                    continue
                span = np.where(one == zero, 1.0, one - zero)
                constant = np.where(one == zero, 0.0, (middle - zero) / span)
                slope = np.where(one == zero, 0.0, half / span)
                new[:, place] += constant[:, None] * found[:, source]
                new[:, place, 1:] += slope[:, None] * found[:, source, :-1]
        found = new
    return found


def difference_slopes(knots: Knots, poles: int) -> _Array:
    """Factors (poles, splines) that turn differences of coefficients on ``knots`` into those of derivatives [1/sample].

    Row k, for the step from derivative k to k + 1 of ``poles``, holds one factor less than the row before it.
    """
    found = np.zeros((poles, knots.intervals + DEGREE))
    for k in range(poles):
        inner = knots.extended[k + 1 : len(knots.extended) - k - 1]
        span = inner[DEGREE - k :] - inner[: len(inner) - DEGREE + k]
        found[k, : len(span)] = (DEGREE - k) / span
    return found


def local_differences(knots: Knots, at: NDArray[np.int64], poles: int) -> _Array:
    """Matrices (intervals, splines - poles, splines) that take coefficients on ``knots`` to those of a derivative.

    ``at`` are the intervals, ``poles`` the order of the derivative.
    """
    found = np.broadcast_to(np.eye(DEGREE + 1), (len(at), DEGREE + 1, DEGREE + 1))
    for k, slopes in enumerate(difference_slopes(knots, poles)):
        found = (found[:, 1:] - found[:, :-1]) * slopes[at[:, None] + np.arange(DEGREE - k)][:, :, None]
    return found


def roughness(knots: Knots, at: NDArray[np.int64], poles: int) -> _Array:
    """Quadratic forms (intervals, splines, splines) of the structural equation in the intervals ``at`` of ``knots``.

    They act on the coefficients of the derivative of order ``poles``. The sum of the squared difference becomes the
    integral of the squared derivative, less poles/12 times that of the next one (what makes a difference over one
    sample smaller than the derivative), over all places where the difference fits into the record. In the
    first and last interval, which it does not fill, the integral could become negative and is left as it is.
    """
    degree = DEGREE - poles
    pieces = spline_pieces(knots.extended[poles : len(knots.extended) - poles], at, degree)
    half = 0.5 * np.diff(knots.starts)[at]
    low = np.where(at == 0, np.minimum(0.5 * poles / half, 1.0) - 1.0, -1.0)
    high = np.where(at == knots.intervals - 1, 1.0 - np.minimum(0.5 * poles / half, 1.0), 1.0)
    shrink = np.where((at == 0) | (at == knots.intervals - 1), 0.0, poles / 12.0)
    slope = pieces[:, :, 1:] * np.arange(1, degree + 1) / half[:, None, None]
    found = np.zeros((len(at), degree + 1, degree + 1))
    for node, share in zip(*np.polynomial.legendre.leggauss(degree + 1), strict=True):
        u = (0.5 * (low + high) + 0.5 * (high - low) * node)[:, None] ** np.arange(degree + 1)
        part = (half * 0.5 * (high - low) * share)[:, None, None]
        value = np.einsum("isp,ip->is", pieces, u)
        steep = np.einsum("isp,ip->is", slope, u[:, :degree])
        found += part * value[:, :, None] * value[:, None, :]
        found -= part * shrink[:, None, None] * steep[:, :, None] * steep[:, None, :]
    return found
