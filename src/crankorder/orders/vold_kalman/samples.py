"""Envelopes at every sample, for bands too wide for knots: the Vold-Kalman equations as they stand, by blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.orders.vold_kalman.banded import factorise, inverse_band, solve
from crankorder.orders.vold_kalman.kernels import cos_sin
from crankorder.orders.vold_kalman.noise import local_level

BLOCK = 65_536
"""Samples solved for at a time, beside the margins that are thrown away."""

MARGIN_BANDWIDTHS = 48.0
"""Margin of a block, in reciprocal bandwidths: what the equations say of one sample has faded to 1e-16 there."""

HEAVIEST = 1e12
"""Largest eigenvalue 4^poles r² of the structure beyond which refinement does not restore the digits that are lost."""

LEAST_CONSTANT = 1e-6
"""Share of a constant that the orders must leave unexplained for it to be told from them."""

REFINEMENTS = 2
"""Steps of iterative refinement."""

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class SampleEnvelopes:
    """``values`` (channels + 1, samples, rows) of cosines and sines, the last channel for a signal of ones, and
    ``variance`` (samples, rows) per unit of white noise variance."""

    values: _Array
    variance: _Array


def envelopes_at_samples(
    signals: _Array, phase_rev: _Array, usable: NDArray[np.bool_], *, weight: _Array, poles: int, margin: int
) -> SampleEnvelopes:
    """Envelopes of all orders jointly, in blocks with ``margin`` samples on both sides.

    ``signals`` (channels, samples) finite, ``phase_rev`` (orders, samples), ``usable`` (samples,), ``weight`` (orders,
    samples) the structural weight r², ``poles`` of the filter. Raises RequestError where a block is not definite.
    """
    n_samples, rows = signals.shape[1], 2 * len(phase_rev)
    values = np.empty((len(signals) + 1, n_samples, rows))
    variance = np.empty((n_samples, rows))
    for begin in range(0, n_samples, BLOCK):
        end = min(n_samples, begin + BLOCK)
        low, high = max(0, begin - margin), min(n_samples, end + margin)
        near = slice(low, high)
        kept, inside = slice(begin, end), slice(begin - low, end - low)
        waves = np.empty((rows, high - low))
        for k, phase in enumerate(phase_rev):
            cos_sin(phase[near], waves[k], waves[len(phase_rev) + k])
        waves *= usable[near]
        found, diagonal = _solved(signals[:, near], waves, weight[:, near], poles)
        values[:, kept], variance[kept] = found[:, inside], diagonal[inside]
    return SampleEnvelopes(values, variance)


def _solved(signals: _Array, waves: _Array, weight: _Array, poles: int) -> tuple[_Array, _Array]:
    rows, n = waves.shape
    steps = np.zeros(poles + 1)
    steps[0] = 1.0
    for _ in range(poles):
        steps[1:] -= steps[:-1].copy()
    band = np.zeros((n * rows, rows * poles + 1))
    _assemble(waves, weight, steps, band)
    if factorise(band) >= 0:
        raise RequestError("the normal equations are not definite", remedy="two of the orders move together")
    # the solver works in place, which takes contiguous arrays
    wanted = np.ascontiguousarray(np.concatenate([signals, np.ones((1, n))])[:, :, None] * waves.T)
    found = wanted.copy()
    solve(band, found.reshape(len(found), -1))
    for _ in range(REFINEMENTS):
        step = np.ascontiguousarray(wanted - np.einsum("nr,cn->cnr", waves.T, np.einsum("cnr,rn->cn", found, waves)))
        rough = np.diff(found, poles, axis=1)
        for row in range(rows):
            pulled = weight[row % len(weight), poles:] * rough[:, :, row]
            for lag, factor in enumerate(steps):
                step[:, poles - lag : n - lag, row] -= factor * pulled
        solve(band, step.reshape(len(step), -1))
        found += step
    return found, inverse_band(band)[:, -1].reshape(n, rows)


def with_offset(
    values: _Array, signals: _Array, phase_rev: _Array, usable: NDArray[np.bool_]
) -> tuple[NDArray[np.complex128], _Array, _Array]:
    """Amplitudes (channels, orders, samples), residual (channels, samples) and constant part (channels,).

    ``values`` of SampleEnvelopes, the last for a signal of ones; ``signals``, ``phase_rev`` and ``usable`` as given to
    ``envelopes_at_samples``. The constant is fitted jointly: what of the ones the orders do not explain.
    """
    k = len(phase_rev)
    turn = np.exp(2j * np.pi * (phase_rev - np.floor(phase_rev)))
    envelopes = values[:, :, :k] - 1j * values[:, :, k:]
    lines = np.einsum("cnk,kn->cn", envelopes, turn).real
    unexplained = usable.sum() - float(lines[-1][usable].sum())
    offset = np.zeros(len(signals))
    if unexplained > LEAST_CONSTANT * usable.sum():
        offset = (signals - lines[:-1])[:, usable].sum(axis=1) / unexplained
    amplitude = (envelopes[:-1] - offset[:, None, None] * envelopes[-1:]).transpose(0, 2, 1)
    residual = signals - np.einsum("ckn,kn->cn", amplitude, turn).real
    return np.ascontiguousarray(amplitude), residual, offset


def sample_errors(
    remaining: _Array,
    phase_rev: _Array,
    usable: NDArray[np.bool_],
    variance: _Array,
    samples_per_bandwidth: _Array,
    poles: int,
) -> _Array:
    """Standard errors (channels, orders, samples) from the local residual spectrum beside each order.

    ``remaining`` (channels, samples) residual without constant, ``phase_rev`` (orders, samples), ``usable`` (samples,),
    ``variance`` (samples, rows) per unit of white noise, ``samples_per_bandwidth`` (orders,), ``poles`` of the filter.
    """
    n_orders, n_samples = phase_rev.shape
    at = np.arange(n_samples)
    found = np.empty((len(remaining), n_orders, n_samples))
    for k, phase in enumerate(phase_rev):
        others = np.gradient(np.delete(phase_rev, k, axis=0) - phase, axis=1)
        turned = np.where(usable, remaining, 0.0) * np.exp(-2j * np.pi * (phase - np.floor(phase)))
        places, level = local_level(
            turned,
            usable.astype(np.float64),
            others,
            sums_per_bandwidth=float(samples_per_bandwidth[k]),
            poles=poles,
            correlation=np.ones(1),
        )
        spread = 0.5 * (variance[:, k] + variance[:, n_orders + k])
        for channel in range(len(remaining)):
            found[channel, k] = np.sqrt(np.interp(at, places, level[channel]) * spread)
    return found


@njit(cache=True, nogil=True)
def _assemble(waves, weight, steps, band):  # type: ignore[no-untyped-def]
    """Fill ``band`` with the data's weight and the structural equation of every sample that has enough before it."""
    rows, n = waves.shape
    width, poles = band.shape[1] - 1, steps.shape[0] - 1
    for i in range(n):
        for row in range(rows):
            for other in range(row + 1):
                band[i * rows + row, width - row + other] += waves[row, i] * waves[other, i]
            if i >= poles:
                r2 = weight[row % weight.shape[0], i]
                for a in range(poles + 1):
                    for b in range(a, poles + 1):
                        band[(i - a) * rows + row, width - (b - a) * rows] += r2 * steps[a] * steps[b]
