"""A mode that an order sweeps through: the exact response of a swept oscillator, seen as a tracking filter sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.resonance import resonance
from crankorder.orders.vold_kalman.bandwidth import structural_weight

MOST_TURN = 0.005
"""Largest product of the rate of the angular frequency and the square of a step: the response is exact to 1e-3 of it."""

STEPS_PER_ROW = 4
"""Steps of the grid from row to row at least."""

STEPS_PER_BANDWIDTH = 8.0
"""Steps of the grid in a reciprocal bandwidth of the filter at least."""

MOST_STEPS = 200_000
"""Steps of the grid at most."""

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class Passage:
    """How one order passed through the frequencies of one recording, and by what filter it was followed.

    ``step_s`` is that of an even grid of times, on which ``frequency_hz`` and ``speed_rpm`` (T,) are those of the order
    and of the shaft; ``place`` (K,) says at which step of it each row stands; ``bandwidth_hz`` (T,) is that of the
    Vold–Kalman filter of ``poles``.
    """

    step_s: float
    frequency_hz: Array
    speed_rpm: Array
    place: Array
    bandwidth_hz: Array
    poles: int

    def response(self, growth: Complex, natural_hz: Array, damping: Array) -> Complex:
        """Acceleration (K, M) of modes of unit residue behind a force of this order that is ``growth`` (T,) large.

        ``natural_hz`` and ``damping`` (M,): of the modes. The envelope a of the response relative to the order's phase
        obeys a' = (λ − iω(t)) a + growth, whose steps are solved as if ω were steady within each (Lewis 1932 has the
        solution for a steady rate); the counter-rotating part is that of steady running. It is then smoothed as the
        tracking filter smooths it.
        """
        omega = 2.0 * np.pi * self.frequency_hz
        made = np.empty((len(omega), len(natural_hz)), dtype=np.complex128)
        for number, (f, zeta) in enumerate(zip(natural_hz.tolist(), damping.tolist(), strict=True)):
            natural = 2.0 * np.pi * f
            damped = natural * np.sqrt(max(1.0 - zeta**2, 1e-12))
            pole = complex(-zeta * natural, damped)
            weight = -(pole**2) / (2j * damped)
            own = _envelope(self.step_s, omega, growth, pole)
            made[:, number] = growth - weight * own - np.conj(weight) * growth / (1j * omega - np.conj(pole))
        return self.smoothed(made)

    def steady(self, growth: Complex, natural_hz: Array, damping: Array) -> Complex:
        """As :meth:`response`, as if every speed were held: ``growth`` (T,), ``natural_hz`` and ``damping`` (M,)."""
        return self.smoothed(growth[:, None] * resonance(self.frequency_hz, natural_hz, damping))

    def smoothed(self, envelope: Complex) -> Complex:
        """``envelope`` (T, M) of the grid as the filter lets it through, at the rows (K, M)."""
        from scipy.linalg import solveh_banded

        rate = 1.0 / self.step_s
        weight = 2.0 * structural_weight(np.minimum(self.bandwidth_hz, 0.9 * rate), rate_hz=rate, poles=self.poles)
        through = solveh_banded(_normal_band(weight, self.poles), envelope, lower=True)
        low = np.clip(np.floor(self.place).astype(np.int64), 0, len(through) - 2)
        share = (self.place - low)[:, None]
        return np.asarray((1.0 - share) * through[low] + share * through[low + 1])


def passage_of(order: float, time_s: Array, speed_rpm: Array, bandwidth_hz: Array, *, poles: int) -> Passage:
    """Passage of ``order`` through a recording whose rows stand at ``time_s`` (K,), rising.

    ``speed_rpm`` and ``bandwidth_hz`` (K,): of the shaft and of the filter there; ``poles``: of the filter. The grid
    between is so fine that the response of any mode follows.
    """
    from scipy.interpolate import PchipInterpolator

    rate = float(np.abs(np.gradient(speed_rpm, time_s)).max()) * order / 60.0 * 2.0 * np.pi
    spacing = float(np.median(np.diff(time_s)))
    fine = 1.0 / (STEPS_PER_BANDWIDTH * float(bandwidth_hz.max()))
    step = min(spacing / STEPS_PER_ROW, float(np.sqrt(MOST_TURN / max(rate, 1e-9))), fine)
    span = float(time_s[-1] - time_s[0])
    count = int(min(max(np.ceil(span / step), 8), MOST_STEPS))
    at = np.linspace(time_s[0], time_s[-1], count + 1)
    speed = np.asarray(PchipInterpolator(time_s, speed_rpm)(at))
    step = span / count
    place = (time_s - time_s[0]) / step
    return Passage(step, order * speed / 60.0, speed, place, np.interp(at, time_s, bandwidth_hz), poles)


def _envelope(step_s: float, omega: Array, growth: Complex, pole: complex) -> Complex:
    """Solution (T,) of a' = (λ − iω) a + growth from a steady start; λ is ``pole``, ``omega`` in rad/s."""
    from scipy.linalg import solve_banded

    middle = pole - 0.5j * (omega[1:] + omega[:-1])
    z = middle * step_s
    grown = np.exp(z)
    over = np.expm1(z) / z
    # the force is linear within a step: exact for a steady frequency
    slope = (over - 1.0) / z
    pushed = step_s * (growth[:-1] * over + (growth[1:] - growth[:-1]) * slope)
    band = np.ones((2, len(omega)), dtype=np.complex128)
    band[1, :-1] = -grown
    band[1, -1] = 0.0
    start = growth[0] / (1j * omega[0] - pole)
    return np.asarray(solve_banded((1, 0), band, np.concatenate([[start], pushed]), check_finite=False))


def _normal_band(weight: Array, poles: int) -> Array:
    """Lower band (poles + 1, T) of 1 + Dᵀ r² D for differences of ``poles``, ``weight`` (T,) being r²."""
    steps = np.array([1.0])
    for _ in range(poles):
        steps = np.convolve(steps, [1.0, -1.0])
    n = len(weight)
    band = np.zeros((poles + 1, n))
    band[0] = 1.0
    pulled = weight[poles // 2 : n - (poles - poles // 2)]
    for lag in range(poles + 1):
        for k in range(poles + 1 - lag):
            band[lag, k : n - poles + k] += steps[k] * steps[k + lag] * pulled
    return band
