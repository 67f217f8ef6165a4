"""Motion of poles under sampled forces: exact for the poles, forces by a polynomial through the nearest samples.

Over a step h a pole z with ż = λz + u(t) goes to e^{λh}·z + ∫₀ʰ e^{λ(h−τ)}·u(τ) dτ. With u the polynomial through the
``stencil`` samples about the step the integral is a fixed sum of these samples, so that neither a stiff nor a lightly
damped pole asks for short steps: only the forces do (an exponential integrator; Hochbruck and Ostermann 2010, section
2). Several steps of a grid finer than the output are one sum over more samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.errors import RequestError

if TYPE_CHECKING:
    from crankorder.synth.poles import Poles

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
STENCILS = (2, 4, 6, 8, 10, 12)
MAX_SUBSTEPS = 64
BLOCK = 512
"""Output samples at once: what a pole needs of a block stays in the fastest cache."""


@dataclass(frozen=True)
class Integration:
    """How forces are taken: a polynomial through ``stencil`` samples (even), ``substeps`` samples for one of output."""

    stencil: int
    substeps: int

    @property
    def margin(self) -> int:
        """Samples of the forces that are needed before the first and behind the last step."""
        return self.stencil // 2


def interpolation_error(stencil: int, phase_per_sample_rad: float) -> float:
    """Largest error, over its amplitude, of a tone in the middle interval of the polynomial through its samples.

    (θ/2)^s · (s − 1)!!/s!!, for ``stencil`` s (even) and ``phase_per_sample_rad`` θ: a bound that the middle of the
    interval reaches for small θ. Relative to the response it is the error of the tone's own frequency.
    Source: remainder of polynomial interpolation, f^(s)/s! · Π(t − t_j), with the derivative's bound θ^s, which holds
    for complex f by the formula of Hermite and Genocchi (Davis, Interpolation and Approximation, 1963, section 3.1);
    Π is largest in the middle, ((s − 1)!!/2^{s/2})².
    """
    half = stencil // 2
    central = math.prod((2 * k - 1) / (2 * k) for k in range(1, half + 1))
    return float(central * (phase_per_sample_rad / 2) ** stencil)


def integration_for(highest_force_hz: float, rate_hz: float, tolerance: float) -> Integration:
    """The cheapest integration whose interpolation error stays within a tolerance up to the highest frequency.

    The forces at one more sample cost some ten times what one more sample in the sums costs (measured, see
    benchmarks/modal_integration.py): as few substeps as the widest stencil allows, then the narrowest stencil.

    ``highest_force_hz``: of the forces, ≥ 0; it may lie above half of ``rate_hz``, the rate of the output.
    ``tolerance``: largest error over amplitude, 1e-15 … 1. Raises RequestError outside of these ranges, and where more
    than 64 samples of the forces would be needed for each of the output.
    """
    if not (highest_force_hz >= 0 and rate_hz > 0 and 1e-15 <= tolerance <= 1):
        raise RequestError(
            "no integration for this",
            found=f"highest force {highest_force_hz:g} Hz, rate {rate_hz:g} Hz, tolerance {tolerance:g}",
            allowed="highest force ≥ 0, rate > 0, tolerance 1e-15 … 1",
        )
    phase = 2 * math.pi * highest_force_hz / rate_hz
    for substeps in range(1, MAX_SUBSTEPS + 1):
        for stencil in STENCILS:
            if interpolation_error(stencil, phase / substeps) <= tolerance:
                return Integration(stencil, substeps)
    raise RequestError(
        "the forces change too fast for the rate",
        found=f"{highest_force_hz:g} Hz at {rate_hz:g} samples per second",
        remedy="Raise the rate or lower the highest order or speed",
    )


def step_weights(pole_per_s: Complex, step_s: float, integration: Integration) -> tuple[Complex, Complex]:
    """What a step of the output makes of the state, e^{λΔ} − 1 (pole,), and of the samples of the input (pole, tap).

    ``pole_per_s``: λ. ``step_s``: between samples of the forces; Δ is ``substeps`` of them. ``integration``: its
    stencil and substeps. Tap 0 is the sample stencil/2 − 1 before the step. The difference from 1 keeps the damping of
    a lightly damped pole to full precision.
    """
    stencil, substeps = integration.stencil, integration.substeps
    nodes = np.arange(stencil) - (stencil // 2 - 1.0)
    decay = pole_per_s * step_s
    points, shares = unit_quadrature(float(np.max(np.abs(decay), initial=0.0)))
    lagrange = np.array(
        [np.prod([(points - other) / (node - other) for other in nodes if other != node], axis=0) for node in nodes]
    )
    one = step_s * (np.exp(decay[:, None] * (1 - points)) * shares) @ lagrange.T
    taps = np.zeros((pole_per_s.size, stencil + substeps - 1), dtype=np.complex128)
    for part in range(substeps):
        taps[:, part : part + stencil] += np.exp(decay * (substeps - 1 - part))[:, None] * one
    return np.expm1(decay * substeps), taps


def unit_quadrature(decay: float) -> tuple[Real, Real]:
    """Points and weights on 0 … 1 that integrate to round-off what a step integrates.

    ``decay``: largest |λ|·step of the poles. Source: Gauss and Legendre.
    """
    points, shares = np.polynomial.legendre.leggauss(32 + min(int(decay), 400))
    return 0.5 * (1 + points), 0.5 * shares


def advance(
    poles: Poles, force: Real, *, step_s: float, integration: Integration, state: Complex
) -> tuple[Real, Complex]:
    """Acceleration (channel, n) at the output samples, and the state (pole,) one output step behind the last.

    ``poles``: of structure and filter. ``force``: samples (axis, margin + n · substeps + margin), ``step_s`` apart; the
    one after the first margin falls on the first output sample. ``integration``: its margin, stencil and substeps.
    ``state`` (pole,): at the first output sample.
    """
    growth, taps = step_weights(poles.pole_per_s, step_s, integration)
    return advance_by(poles, force, growth=growth, taps=taps, integration=integration, state=state)


def advance_by(
    poles: Poles, force: Real, *, growth: Complex, taps: Complex, integration: Integration, state: Complex
) -> tuple[Real, Complex]:
    """The same with the ``growth`` and ``taps`` of :func:`step_weights` at hand.

    ``poles``, ``force``, ``integration``, ``state``: see :func:`advance`.
    """
    margin, substeps = integration.margin, integration.substeps
    n_out = (force.shape[1] - 2 * margin) // substeps
    signal = np.zeros((poles.output.shape[0], n_out))
    after = state.astype(np.complex128)
    odd = taps.shape[1] % 2  # the loop takes taps two by two
    fill_response(
        np.ascontiguousarray(force, dtype=np.float64),
        np.ascontiguousarray(poles.input, dtype=np.float64),
        np.ascontiguousarray(poles.output, dtype=np.complex128),
        np.ascontiguousarray(poles.direct, dtype=np.float64),
        growth,
        np.pad(taps, ((0, 0), (0, odd))),
        margin,
        substeps,
        after,
        signal,
    )
    return signal, after


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_response(force, inputs, output, direct, growth, taps, margin, substeps, state, signal):  # type: ignore[no-untyped-def]
    """Response to ``force`` added to ``signal`` (channel, n), ``state`` (pole,) moved on by n output samples.

    ``inputs`` (pole, axis), ``output`` (channel, pole), ``direct`` (channel, axis): of the poles. ``growth`` (pole,)
    and ``taps`` (pole, tap): of ``step_weights``, an even number of taps. ``margin`` and ``substeps``: of an
    ``Integration``.
    """
    n_channels, n_out = signal.shape
    behind = taps.shape[1] // substeps + 1
    acting = np.zeros((substeps, BLOCK + behind))
    re, im = np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, n_out, BLOCK):
        n = min(BLOCK, n_out - start)
        first = margin + start * substeps
        for channel in range(n_channels):
            for axis in range(force.shape[0]):
                gain = direct[channel, axis]
                if gain != 0.0:
                    for i in range(n):
                        signal[channel, start + i] += gain * force[axis, first + i * substeps]
        for p in range(inputs.shape[0]):
            _fill_acting(force, inputs[p], start * substeps + 1, n + behind, acting)
            _fill_pushes(acting, taps[p], n, re, im)
            z_re, z_im, g_re, g_im = state[p].real, state[p].imag, growth[p].real, growth[p].imag
            for i in range(n):
                push_re, push_im = re[i], im[i]
                re[i], im[i] = z_re, z_im
                z_re, z_im = (
                    (push_re + z_re) + (g_re * z_re - g_im * z_im),
                    (push_im + z_im) + (g_re * z_im + g_im * z_re),
                )
            state[p] = complex(z_re, z_im)
            for channel in range(n_channels):
                o_re, o_im = output[channel, p].real, output[channel, p].imag
                for i in range(n):
                    signal[channel, start + i] += o_re * re[i] - o_im * im[i]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fill_acting(force, share, first, n, acting):  # type: ignore[no-untyped-def]
    """The force on one pole from sample ``first`` on; row r of ``acting`` gets every substeps-th sample from r on."""
    substeps = acting.shape[0]
    for r in range(substeps):
        for i in range(acting.shape[1]):
            acting[r, i] = 0.0
        begin = first + r
        there = min(n, (force.shape[1] - begin + substeps - 1) // substeps)
        for axis in range(force.shape[0]):
            if share[axis] != 0.0:
                gain = share[axis]
                for i in range(there):
                    acting[r, i] += gain * force[axis, begin + i * substeps]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fill_pushes(acting, taps, n, re, im):  # type: ignore[no-untyped-def]
    """What every output step adds to one pole: the sum of ``taps`` over the samples of its force, two at a time."""
    substeps = acting.shape[0]
    for i in range(n):
        re[i], im[i] = 0.0, 0.0
    for tap in range(0, taps.size, 2):
        one = acting[tap % substeps, tap // substeps :]
        other = acting[(tap + 1) % substeps, (tap + 1) // substeps :]
        a_re, a_im, b_re, b_im = taps[tap].real, taps[tap].imag, taps[tap + 1].real, taps[tap + 1].imag
        for i in range(n):
            re[i] += a_re * one[i] + b_re * other[i]
            im[i] += a_im * one[i] + b_im * other[i]
