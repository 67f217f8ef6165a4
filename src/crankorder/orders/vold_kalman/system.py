"""Envelopes of orders as splines: the Vold-Kalman equations of one record, solved."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crankorder.orders.vold_kalman.banded import inverse_band, normal_equations
from crankorder.orders.vold_kalman.bandwidth import POLES
from crankorder.quantities import Bools, Complexes, Floats, Ints

DEGREE = 5
"""Of the envelopes between knots: two poles leave two smooth derivatives, and two more."""

SPLINES = DEGREE + 1
"""Splines that are not zero in an interval."""

FEWEST_INTERVALS = 16
"""However narrow the band: the envelope may still bend in a record that is shorter than the filter's response."""

PASSES = 3
"""Solutions of the equations, each of what the one before it has left: two are enough unless orders are close."""

LEAST_CONSTANT = 1e-6
"""Share of a constant that the orders must leave unexplained for it to be told from them."""


def place_knots(spacing: Floats, n_samples: int) -> Ints:
    """First samples (intervals + 1,) of intervals whose length follows ``spacing`` [samples] (points,), and the end.

    The points are even across the ``n_samples`` of the record. Knots stand half a sample before these.
    """
    rate = 1.0 / spacing
    count = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])
    total = float(count[-1]) * n_samples / (len(rate) - 1)
    intervals = min(max(round(total), FEWEST_INTERVALS), n_samples)
    place = np.interp(np.arange(intervals + 1) / intervals, count / count[-1], np.linspace(0.0, n_samples, len(count)))
    return np.unique(np.round(place).astype(np.int64))


def middles(starts: Ints) -> Floats:
    """Middle [samples] of each interval of ``starts``, as of ``place_knots``."""
    return np.asarray(0.5 * (starts[1:] + starts[:-1] - 1.0))


def _knots(starts: Ints, degree: int) -> Floats:
    """Knots [samples] with the ends repeated, so that the first and last spline of ``degree`` are one at the ends."""
    return np.pad(starts - 0.5, degree, mode="edge")


def splines_at(starts: Ints, place: Floats | Ints, *, degree: int = DEGREE, derivative: int = 0) -> Floats:
    """Values (places, degree + 1) of the splines that are not zero at each ``place`` (places,) [samples].

    ``starts`` as of ``place_knots``, ``derivative`` of the splines, per sample.
    """
    from scipy.interpolate import BSpline  # with much that maps alone need not wait for

    # neighbours share no column: each of these is one spline at any place
    column = np.arange(len(starts) + degree - 1) % (degree + 1)
    values = BSpline(_knots(starts, degree), np.eye(degree + 1)[column], degree)(place, derivative)
    return np.take_along_axis(values, column[_near(starts, place, degree)], axis=1)


def _near(starts: Ints, place: Floats | Ints, degree: int = DEGREE) -> Ints:
    """Numbers (places, degree + 1) of the splines that are not zero at each ``place`` (places,) [samples]."""
    return np.searchsorted(starts - 0.5, place, side="right")[:, None] - 1 + np.arange(degree + 1)


def _pieces(starts: Ints) -> Floats:
    """Powers of u in (-1, 1) (intervals, splines, powers) of the splines in each interval of ``starts``."""
    node = np.cos(np.pi / SPLINES * (np.arange(SPLINES) + 0.5))
    place = middles(starts)[:, None] + 0.5 * np.diff(starts)[:, None] * node
    values = splines_at(starts, place.ravel()).reshape(-1, SPLINES, SPLINES)
    return np.ascontiguousarray(np.linalg.solve(np.vander(node, increasing=True), values).swapaxes(1, 2))


def roughness(starts: Ints, degree: int, derivative: int) -> Floats:
    """Quadratic forms (intervals, splines, splines) of the structural equation: of a ``derivative`` of the splines.

    ``starts`` as of ``place_knots``; splines of ``degree``. The sum of the squared difference becomes the integral of
    the squared derivative, less POLES/12 times that of the next one (what makes a difference over one sample smaller
    than the derivative), over all places where the difference fits into the record. In the first and last interval,
    which it does not fill, the integral could become negative and is left as it is.
    """
    intervals, nodes = np.arange(len(starts) - 1), DEGREE - POLES + 1
    low, high = starts[:-1] - 0.5, starts[1:] - 0.5
    low[0], high[-1] = min(low[0] + 0.5 * POLES, high[0]), max(high[-1] - 0.5 * POLES, low[-1])
    node, share = np.polynomial.legendre.leggauss(nodes)
    place = 0.5 * ((low + high)[:, None] + (high - low)[:, None] * node)
    part = 0.5 * (high - low)[:, None] * share
    inner = (intervals > 0) & (intervals < intervals[-1])
    form = np.zeros((len(intervals), degree + 1, degree + 1))
    for more, factor in ((0, part), (1, part * inner[:, None] * (-POLES / 12.0))):
        values = splines_at(starts, place.ravel(), degree=degree, derivative=derivative + more)
        values = values.reshape(len(intervals), nodes, -1)
        form += np.einsum("in,ina,inb->iab", factor, values, values)
    return form


class EnvelopeSystem:
    """Vold-Kalman equations of one record; an unknown is number (spline · rows + row), rows cosines and sines."""

    def __init__(self, signals: Floats, phase_rev: Floats, usable: Bools, starts: Ints, weight: Floats) -> None:
        """The equations of ``signals`` (channels, samples), finite, where they are ``usable`` (samples,).

        ``phase_rev`` (orders, samples), ``starts`` as of ``place_knots``; ``weight`` (intervals, orders) of the
        structural equation. The solution counts all channels and, as the last one, a signal of ones.
        """
        turned = 2.0 * np.pi * (phase_rev - np.floor(phase_rev))
        waves = np.concatenate([np.cos(turned), np.sin(turned)]) * usable
        known = np.vstack([signals, np.ones(len(usable))]) * usable
        self.starts, self.rows, self.weight = starts, len(waves), np.tile(weight, 2)
        self.totals = known.sum(axis=1)
        # lower band by rows, the diagonal last: its transpose is LAPACK's upper band
        self.data = np.zeros(((len(starts) - 1 + DEGREE) * self.rows, SPLINES * self.rows))
        self.wanted = np.zeros((len(known), len(self.data)))
        normal_equations(known, waves, _pieces(starts), starts, self.data, self.wanted)

    def _pairs(self, band: Floats) -> Iterator[tuple[int, int, Floats]]:
        """Splines a and b <= a of an interval, and the entries (intervals, rows) of ``band`` for these in each."""
        blocks, intervals = band.reshape(-1, self.rows, band.shape[1]), len(self.weight)
        for a, b in zip(*np.tril_indices(SPLINES), strict=True):
            yield int(a), int(b), blocks[a : a + intervals, :, -1 - (a - b) * self.rows]

    def solve(self) -> tuple[Floats, Floats, Floats]:
        """Coefficients (channels, unknowns), constant part (channels,) and variance (orders, intervals) of envelopes.

        The variance is that in the middle of intervals, of white noise of variance one. Raises LinAlgError where orders
        cannot be told apart to working precision.
        """
        from scipy.linalg import cho_solve_banded, cholesky_banded  # with much that maps alone need not wait for

        rough = np.zeros_like(self.data)
        stiffness = roughness(self.starts, DEGREE, POLES)
        for a, b, entries in self._pairs(rough):
            entries += stiffness[:, a, b, None] * self.weight
        factor, heavier = (cholesky_banded((self.data + k * rough).T, check_finite=False) for k in (1.0, 2.0))
        forms = roughness(self.starts, DEGREE - POLES, 0)
        values = np.zeros_like(self.wanted)
        for _ in range(PASSES):
            left = self.wanted - self.applied(values) - self._structure(values, forms)
            values += cho_solve_banded((factor, False), left.T, check_finite=False).T
        # constant part of each channel, jointly with the orders
        offset, n_usable = np.zeros(len(values) - 1), self.totals[-1]
        left = n_usable - float(values[-1] @ self.wanted[-1])
        if left > LEAST_CONSTANT * n_usable:
            offset = (self.totals[:-1] - values[:-1] @ self.wanted[-1]) / left
        variance, less = self._inverse_at_middles(factor), self._inverse_at_middles(heavier)
        # of data noise: what of the inverse does not fall as the structural equation gains weight; far from ends and
        # gaps that is the noise bandwidth of the filter over that of its square root, and where orders are not seen the
        # rest of it is what envelopes may do there
        variance *= np.maximum(1.0 + np.log2(less / variance), 1.0 - 0.5 / POLES)
        variance = variance.reshape(len(variance), 2, -1).mean(axis=1).T
        return values[:-1] - values[-1] * offset[:, None], offset, variance

    def applied(self, values: Floats) -> Floats:
        """The data's weight times ``values`` (channels, unknowns)."""
        from scipy.linalg.blas import dsbmv

        return np.array([dsbmv(self.data.shape[1] - 1, 1.0, self.data.T, row) for row in values])

    def residual_sums(self, values: Floats, offset: Floats) -> tuple[Complexes, Floats]:
        """What the residual holds about each order, by spline: sums (channels, orders, splines) and their weights.

        ``values`` and ``offset`` as of ``solve``. The sums are of residual · spline · exp(-2πi phase); for white noise
        of variance s² their mean square is s² times the weight (orders, splines).
        """
        left = self.wanted[:-1] - self.applied(values) - offset[:, None] * self.wanted[-1]
        cosine, sine = np.split(left.reshape(len(left), -1, self.rows).transpose(0, 2, 1), 2, axis=1)
        weight = self.data[:, -1].reshape(-1, 2, self.rows // 2).sum(axis=1)
        return cosine - 1j * sine, weight.T

    def _structure(self, values: Floats, forms: Floats) -> Floats:
        """The structural equation applied to ``values`` (channels, unknowns).

        ``forms`` act on the coefficients of derivatives, which come by differences: those of a constant vanish exactly.
        """
        knots, intervals = _knots(self.starts, DEGREE)[:, None], len(self.weight)
        slopes = [(DEGREE - k) / (knots[SPLINES : len(knots) - k - 1] - knots[k + 1 : -SPLINES]) for k in range(POLES)]
        steep = values.reshape(len(values), -1, self.rows)
        for slope in slopes:
            steep = np.diff(steep, axis=1) * slope
        rough = np.zeros_like(steep)
        for a, b in np.ndindex(forms.shape[1:]):
            rough[:, a : a + intervals] += forms[:, a, b, None] * self.weight * steep[:, b : b + intervals]
        for slope in slopes[::-1]:
            rough = -np.diff(rough * slope, axis=1, prepend=0.0, append=0.0)
        return rough.reshape(values.shape)

    def _inverse_at_middles(self, factor: Floats) -> Floats:
        """Inverse (intervals, rows) for the envelopes in the middle of each interval, from LAPACK's ``factor``."""
        middle = splines_at(self.starts, middles(self.starts))
        inverse = np.zeros_like(self.weight)
        for a, b, entries in self._pairs(inverse_band(factor.T)):
            inverse += (1.0 + (a != b)) * (middle[:, a] * middle[:, b])[:, None] * entries
        return inverse

    def amplitude_at(self, values: Floats, place: Ints) -> Complexes:
        """Complex amplitudes (channels, orders, places) of ``values`` (channels, unknowns) at the samples ``place``."""
        of_places = values.reshape(len(values), -1, self.rows)[:, _near(self.starts, place)]
        cosine, sine = np.split(np.einsum("pa,cpar->crp", splines_at(self.starts, place), of_places), 2, axis=1)
        return np.asarray(cosine - 1j * sine)
