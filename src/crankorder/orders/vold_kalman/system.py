"""Envelopes of orders as splines: the Vold-Kalman equations of one record, solved and read at each sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.orders.vold_kalman.banded import add_moments, evaluate, factorise, inverse_band, product, solve
from crankorder.orders.vold_kalman.bandwidth import (
    DEGREE,
    FEWEST_INTERVALS,
    difference_slopes,
    local_differences,
    place_knots,
    roughness,
    spline_pieces,
    structural_weight,
)
from crankorder.quantities import Bools, Complexes, Floats

SPLINES = DEGREE + 1
"""Splines in an interval, and powers of u of each: a constant, so that the loops are unrolled."""


KNOTS_PER_BANDWIDTH = (64, 16, 16, 16)
"""Knots in the time 1/bandwidth, by poles. Envelopes inside the band are right to 1e-9; what lies further from the
order than 8 bandwidths (which the exact filter lets through 3e-5 of, with two poles) is rejected altogether. The gain
of one pole falls so slowly that more of what lies there belongs to the exact solution."""

REFINEMENTS = 3
"""Most steps of iterative refinement; one is enough unless orders are close."""

ENOUGH = 1e-10
"""Relative size of a step of refinement after which the next one would be below rounding."""

LEAST_SPACING = 2.0
"""Samples between knots at least, however wide the band: below, the equations are no longer definite."""

LEAST_CONSTANT = 1e-6
"""Share of a constant that the orders must leave unexplained for it to be told from them."""


def spline_products(pieces: Floats) -> Floats:
    """Products of two splines in powers of u, (runs, powers, pairs): pairs (a, b) with b up to a, in rows of a.

    ``pieces`` (runs, splines, powers) are the splines.
    """
    a, b = np.tril_indices(SPLINES)
    found = np.zeros((len(pieces), 2 * SPLINES - 1, len(a)))
    for q in range(SPLINES):
        for r in range(SPLINES):
            found[:, q + r] += pieces[:, a, q] * pieces[:, b, r]
    return found


@njit(cache=True, nogil=True, fastmath={"contract"})
def assemble_gram(gram, products, kind, band):  # type: ignore[no-untyped-def]
    """Add to ``band`` the data's weight ``gram`` (intervals, pairs of rows, powers) on ``products`` [``kind``]."""
    n_rows, width = band.shape[1] // SPLINES, band.shape[1] - 1
    local = np.empty(products.shape[2])
    for i in range(gram.shape[0]):
        pair = 0
        for row in range(n_rows):
            for other in range(row + 1):
                local[:] = 0.0
                for m in range(2 * SPLINES - 1):
                    moment, line = gram[i, pair, m], products[kind[i], m]
                    for ab in range(local.shape[0]):
                        local[ab] += moment * line[ab]
                pair += 1
                ab = 0
                for a in range(SPLINES):
                    for b in range(a + 1):
                        back = (a - b) * n_rows
                        band[(i + a) * n_rows + row, width - back - row + other] += local[ab]
                        if a > b and row != other:
                            band[(i + a) * n_rows + other, width - back + row - other] += local[ab]
                        ab += 1


@njit(cache=True, nogil=True)
def assemble_roughness(stiffness, kind, weight, band):  # type: ignore[no-untyped-def]
    """Add to ``band`` the forms ``stiffness`` [``kind``] (splines, splines) times ``weight`` (intervals, orders)."""
    n_orders = weight.shape[1]
    n_rows, width = 2 * n_orders, band.shape[1] - 1
    for i in range(kind.shape[0]):
        local = stiffness[kind[i]]
        for a in range(SPLINES):
            for b in range(a + 1):
                for row in range(n_rows):
                    band[(i + a) * n_rows + row, width - (a - b) * n_rows] += local[a, b] * weight[i, row % n_orders]


@njit(cache=True, nogil=True)
def apply_roughness(forms, kind, weight, slopes, values, result):  # type: ignore[no-untyped-def]
    """Add to ``result`` (columns, splines, rows) the structural equation applied to ``values`` of the same shape.

    ``slopes`` (poles, splines) turn differences of coefficients into those of the derivative; in turn, so that those of
    a constant vanish exactly. ``forms`` [``kind``] act on them, times ``weight`` (intervals, orders).
    """
    poles, n = slopes.shape[0], values.shape[1]
    near = forms.shape[1]
    for column in range(values.shape[0]):
        for row in range(values.shape[2]):
            steep = values[column, :, row].copy()
            for k in range(poles):
                for j in range(n - 1 - k):
                    steep[j] = (steep[j + 1] - steep[j]) * slopes[k, j]
            rough = np.zeros(n)
            for i in range(kind.shape[0]):
                local, r2 = forms[kind[i]], weight[i, row % weight.shape[1]]
                for a in range(near):
                    total = 0.0
                    for b in range(near):
                        total += local[a, b] * steep[i + b]
                    rough[i + a] += r2 * total
            for k in range(poles - 1, -1, -1):
                above = 0.0
                for j in range(n - 1 - k):
                    scaled = rough[j] * slopes[k, j]
                    rough[j] = above - scaled
                    above = scaled
                rough[n - 1 - k] = above
            for j in range(n):
                result[column, j, row] += rough[j]


@njit(cache=True, nogil=True)
def gather(data, pieces, kind, values):  # type: ignore[no-untyped-def]
    """Add to ``values`` (channels, splines, rows) the moments ``data`` (intervals, channels, rows, powers).

    ``pieces`` [``kind``] are the splines of each interval.
    """
    for i in range(data.shape[0]):
        piece = pieces[kind[i]]
        for c in range(data.shape[1]):
            for a in range(SPLINES):
                for row in range(data.shape[2]):
                    total = 0.0
                    for q in range(SPLINES):
                        total += piece[a, q] * data[i, c, row, q]
                    values[c, i + a, row] += total


@njit(cache=True, nogil=True)
def scatter(values, pieces, kind, found):  # type: ignore[no-untyped-def]
    """Fill ``found`` (intervals, channels, rows, powers) with the envelopes in u of coefficients ``values``.

    ``pieces`` [``kind``] are the splines of each interval.
    """
    for i in range(found.shape[0]):
        piece = pieces[kind[i]]
        for c in range(found.shape[1]):
            for row in range(found.shape[2]):
                for q in range(SPLINES):
                    total = 0.0
                    for a in range(SPLINES):
                        total += piece[a, q] * values[c, i + a, row]
                    found[i, c, row, q] = total


@njit(cache=True, nogil=True)
def variance_at_middles(inverse, pieces, kind, n_rows):  # type: ignore[no-untyped-def]
    """Variance (intervals, rows) of each envelope in the middle of each interval, from the ``inverse`` band.

    ``pieces`` [``kind``] are the splines, ``n_rows`` the number of rows.
    """
    width = inverse.shape[1] - 1
    found = np.zeros((kind.shape[0], n_rows))
    for i in range(kind.shape[0]):
        middle = pieces[kind[i], :, 0]
        for row in range(n_rows):
            for a in range(middle.shape[0]):
                at = (i + a) * n_rows + row
                found[i, row] += middle[a] * middle[a] * inverse[at, width]
                for b in range(a):
                    found[i, row] += 2.0 * middle[a] * middle[b] * inverse[at, width - (a - b) * n_rows]
    return found


def integration(slopes: Floats, n_splines: int) -> Floats:
    """Coefficients (splines, splines) of splines from the first coefficient of each derivative and all of the last.

    ``slopes`` (poles, splines) as of ``difference_slopes``, ``n_splines`` the number of coefficients. In these unknowns
    the structural equation acts on the last derivative alone, so that no weight, however large, hides the data.
    """
    unknown = np.eye(n_splines)
    found = unknown[len(slopes) :]
    for k in range(len(slopes) - 1, -1, -1):
        steps = np.cumsum(found / slopes[k, : len(found), None], axis=0)
        found = np.concatenate([unknown[k : k + 1], unknown[k] + steps])
    return found


def solve_short(
    data_band: Floats, forms: Floats, weight: Floats, slopes: Floats, wanted: Floats
) -> tuple[Floats, Floats]:
    """Coefficients (columns, splines, rows) and their covariance (n, n) from white data noise of unit variance.

    ``data_band`` (n, width + 1) the data's weight, ``forms`` (intervals, splines, splines) and ``weight`` (intervals,
    orders) the structural equation on last derivatives, ``slopes`` as of ``difference_slopes``, ``wanted`` (columns,
    splines, rows) the right-hand sides. Raises LinAlgError where the equations are not definite.
    """
    n_splines, rows = wanted.shape[1:]
    turn = np.kron(integration(slopes, n_splines), np.eye(rows))
    data = _dense(data_band)
    matrix = turn.T @ data @ turn
    poles, near = len(slopes), forms.shape[1]
    for i in range(len(forms)):
        for row in range(rows):
            at = (poles + i + np.arange(near)) * rows + row
            matrix[np.ix_(at, at)] += weight[i, row % weight.shape[1]] * forms[i]
    scale = 1.0 / np.sqrt(np.diag(matrix))
    factor = np.linalg.cholesky(matrix * np.outer(scale, scale))
    inverse = np.linalg.solve(factor, np.diag(scale))
    sides = turn.T @ wanted.reshape(len(wanted), -1).T
    found = inverse.T @ (inverse @ sides)
    found += inverse.T @ (inverse @ (sides - matrix @ found))
    back = turn @ inverse.T
    spread = back.T @ data @ back
    return (turn @ found).T.reshape(wanted.shape), back @ spread @ back.T


def _dense(band: Floats) -> Floats:
    n, width = len(band), band.shape[1] - 1
    found = np.zeros((n, n))
    for k in range(min(width, n - 1) + 1):
        found[np.arange(k, n), np.arange(n - k)] = band[k:, width - k]
    return found + np.tril(found, -1).T


def _scales(signals: NDArray[np.floating], usable: Bools) -> Floats:
    """Powers of two (channels,) that bring signals near one: squares then neither overflow nor vanish."""
    whole = bool(usable.all())
    known = [row if whole else row[usable] for row in signals]
    largest = np.array([max(float(row.max()), -float(row.min())) for row in known])
    return np.asarray(np.ldexp(1.0, np.clip(-np.frexp(largest)[1], -1000, 1000)))


@dataclass(frozen=True)
class Solution:
    """Envelopes of all channels: ``pieces`` (intervals, channels, rows, powers of u), ``offset`` (channels,) the
    constant part, ``variance`` (intervals, rows) per unit of white noise variance, in the middle of each interval."""

    pieces: Floats
    offset: Floats
    variance: Floats


class EnvelopeSystem:
    """Vold-Kalman equations of one record, whose memory grows with bandwidth times length: ``solve``, then ``read``."""

    def __init__(
        self,
        signals: NDArray[np.floating],
        phase_rev: Floats,
        usable: Bools,
        *,
        bandwidth_hz: Floats,
        rate_hz: float,
        poles: int,
        knots_per_bandwidth: int | None = None,
    ) -> None:
        """The equations of ``signals`` (channels, samples) at ``rate_hz``, where they are ``usable`` (samples,).

        ``phase_rev`` (orders, samples); ``bandwidth_hz`` (orders, points), the points even across the record with the
        first at its beginning and the last at its end; ``poles`` of the filter; ``knots_per_bandwidth`` as of
        ``KNOTS_PER_BANDWIDTH``, which holds without it.
        """
        self.signals, self.phase_rev, self.usable, self.poles = signals, phase_rev, usable, poles
        n_channels, n_samples = signals.shape
        self.scale = _scales(signals, usable)
        density = knots_per_bandwidth or KNOTS_PER_BANDWIDTH[poles - 1]
        spacing = np.maximum(rate_hz / (density * bandwidth_hz.max(axis=0)), LEAST_SPACING)
        self.knots = place_knots(spacing, n_samples, fewest=FEWEST_INTERVALS)
        places_hz = rate_hz * self.knots.intervals / n_samples
        self.sums_per_bandwidth = places_hz / np.median(bandwidth_hz, axis=1)
        intervals, rows = self.knots.intervals, 2 * len(phase_rev)
        middle = 0.5 * (self.knots.starts[1:] + self.knots.starts[:-1])
        points = np.linspace(0.0, n_samples, bandwidth_hz.shape[1])
        at_knots = np.array([np.interp(middle, points, of_order) for of_order in bandwidth_hz])
        self.weight = np.ascontiguousarray(structural_weight(at_knots, rate_hz=rate_hz, poles=poles).T)
        runs = self.knots.runs
        self.kind = np.searchsorted(runs, np.arange(intervals), side="right") - 1
        self.splines = spline_pieces(self.knots.extended, runs, DEGREE)
        self.forms, self.slopes = roughness(self.knots, runs, poles), difference_slopes(self.knots, poles)
        steep = local_differences(self.knots, runs, poles)
        self.stiffness = np.ascontiguousarray(steep.transpose(0, 2, 1) @ self.forms @ steep)
        self.gram = np.zeros((intervals, rows * (rows + 1) // 2, 2 * DEGREE + 1))
        self.data = np.zeros((intervals, n_channels + 1, rows, DEGREE + 1))
        self.residual_data = np.zeros((intervals, n_channels, rows, DEGREE + 1))
        self.totals = np.zeros(n_channels + 1)
        self.data_band = np.empty((0, 0))
        starts = self.knots.starts
        add_moments(signals, self.scale, phase_rev, usable, starts, self.gram, self.data, self.totals)

    def solve(self) -> Solution:
        """Envelopes of all channels, jointly over orders.

        Raises LinAlgError where orders cannot be told apart to working precision.
        """
        n_splines, rows = self.knots.intervals + DEGREE, 2 * len(self.phase_rev)
        self.data_band = np.zeros((n_splines * rows, rows * (DEGREE + 1)))
        assemble_gram(self.gram, spline_products(self.splines), self.kind, self.data_band)
        wanted = np.zeros((self.data.shape[1], n_splines, rows))
        gather(self.data, self.splines, self.kind, wanted)
        if self.knots.intervals <= FEWEST_INTERVALS:
            forms = self.forms[self.kind]
            solved, covariance = solve_short(self.data_band, forms, self.weight, self.slopes, wanted)
            # lower band of the full matrix, stored as the banded kernels do
            lags = range(self.data_band.shape[1] - 1, -1, -1)
            inverse = np.array([[row[max(i - k, 0)] for k in lags] for i, row in enumerate(covariance)])
        else:
            solved, inverse = self._solve_long(wanted)
        # constant part of each channel, jointly with the orders: the last channel is a signal of ones
        offset, n_usable = np.zeros(len(self.scale)), self.totals[-1]
        left = n_usable - float(np.sum(solved[-1] * wanted[-1]))
        if left > LEAST_CONSTANT * n_usable:
            offset = (self.totals[:-1] - np.einsum("csr,sr->c", solved[:-1], wanted[-1])) / left
        values = solved[:-1] - solved[-1] * offset[:, None, None]
        pieces = np.empty((self.knots.intervals, len(self.scale), rows, DEGREE + 1))
        scatter(values, self.splines, self.kind, pieces)
        return Solution(pieces, offset, variance_at_middles(inverse, self.splines, self.kind, rows))

    def _solve_long(self, wanted: Floats) -> tuple[Floats, Floats]:
        """Coefficients, and the band of their covariance from data noise.

        That noise is the same share 1 - 1/(2 poles) of the inverse everywhere: the noise bandwidth of the filter over
        that of its square root (measured: within 2 % at the ends as well). The rest is what envelopes may do unseen.
        """
        factor = self.data_band.copy()
        assemble_roughness(self.stiffness, self.kind, self.weight, factor)
        if factorise(factor) >= 0:
            raise np.linalg.LinAlgError("the normal equations are not definite")
        values = wanted.copy()
        solve(factor, values.reshape(len(values), -1))
        last = np.inf
        for _ in range(REFINEMENTS):
            # the normal equations applied, roughness by differences: exact where envelopes are smooth
            applied = np.zeros_like(values)
            product(self.data_band, values.reshape(len(values), -1), applied.reshape(len(values), -1))
            apply_roughness(self.forms, self.kind, self.weight, self.slopes, values, applied)
            step = wanted - applied
            solve(factor, step.reshape(len(step), -1))
            values += step
            change = float(np.abs(step).max()) / max(float(np.abs(values).max()), 1e-300)
            if change < ENOUGH or change > 0.5 * last:
                break
            last = change
        return values, inverse_band(factor) * (1.0 - 0.5 / self.poles)

    def read(self, solution: Solution) -> tuple[Complexes, Floats]:
        """Amplitudes (channels, orders, samples) and residual (channels, samples) of the ``solution`` of ``solve``.

        The residual is noted for the standard errors, thus it is to be read once.
        """
        n_channels, n = self.signals.shape
        amplitude = np.empty((n_channels, len(self.phase_rev), 2 * n))
        residual = np.empty((n_channels, n))
        where = (self.phase_rev, self.usable, self.knots.starts, solution.pieces)
        evaluate(self.signals, self.scale, solution.offset, *where, amplitude, residual, self.residual_data)
        return amplitude.view(np.complex128), residual

    def distances(self, order: int) -> Floats:
        """Distance of the other orders from number ``order`` (others, splines), in cycles per spline."""
        inner = self.phase_rev[:, self.knots.starts[:-1]]
        at_knots = np.column_stack([inner, 2.0 * self.phase_rev[:, -1] - self.phase_rev[:, -2]])
        apart = np.diff(at_knots - at_knots[order], axis=1)
        extra = (DEGREE - DEGREE // 2, DEGREE // 2)
        return np.pad(np.delete(apart, order, axis=0), ((0, 0), extra), mode="edge")

    def residual_sums(self) -> tuple[Complexes, Floats]:
        """What the residual holds about each order, by spline: sums (channels, orders, splines) and their weights.

        The sums are of residual · spline · exp(-2πi phase); for white noise of variance s² their mean square is s²
        times the weight (orders, splines).
        """
        k, n_splines = len(self.phase_rev), self.knots.intervals + DEGREE
        values = np.zeros((len(self.scale), n_splines, 2 * k))
        gather(self.residual_data, self.splines, self.kind, values)
        weight = self.data_band[:, -1].reshape(n_splines, 2 * k)
        sums = (values[:, :, :k] - 1j * values[:, :, k:]).transpose(0, 2, 1)
        return sums, (weight[:, :k] + weight[:, k:]).T
