"""The weight of the structural equation of a Vold-Kalman filter, from its bandwidth."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

HALF_POWER = math.sqrt(2.0) - 1.0
"""What the structural equation weighs against the data where the gain is 1/sqrt(2)."""

FARTHEST_LAG = 16.0
"""Reciprocal bandwidths from which on noise counts as uncorrelated."""


def structural_weight(bandwidth_hz: NDArray[np.float64], *, rate_hz: float, poles: int) -> NDArray[np.float64]:
    """Weight r² of the squared structural equation (∇ to the power ``poles``) whose half-power bandwidth is exact.

    ``bandwidth_hz`` (any shape), from half-power point to half-power point, 0 < bandwidth < ``rate_hz``. A real line
    gives its cosine and sine envelope half a unit of data weight per sample each, thus the gain at f off the line is
    1/(1 + 2 r² (2 sin(π f/rate))^(2 poles)), and r² = (√2 - 1)/2 / (2 sin(π bandwidth/(2 rate)))^(2 poles). The sine
    of half the angle stands for the differences of cosines in the textbook's form, which cancel where r² passes 1e8.
    Source: Tuma 2005, "Setting the passband width in the Vold-Kalman order tracking filter" (his r² is twice ours,
    being for the complex form).
    """
    step = 2.0 * np.sin(0.5 * np.pi * np.asarray(bandwidth_hz) / rate_hz)
    return np.asarray(0.5 * HALF_POWER / step ** (2 * poles))


def noise_bandwidth_share(poles: int) -> float:
    """Noise bandwidth ∫|gain|² df over all offsets, as a share of the half-power bandwidth, far below the rate.

    ``poles`` is that of the filter. With gain 1/(1 + g x^(2n)), x = 1 at the half-power point, the integral is
    g^(-1/2n) · (1 - 1/2n) · (π/2n)/sin(π/2n).
    """
    power = 2.0 * poles
    shape = (1.0 - 1.0 / power) * (math.pi / power) / math.sin(math.pi / power)
    return float(HALF_POWER ** (-1.0 / power) * shape)


def noise_correlation(lag_bandwidths: NDArray[np.float64], poles: int) -> NDArray[np.float64]:
    """Correlation of the filter's noise at two times, ``lag_bandwidths`` (any shape) reciprocal bandwidths apart.

    The cosine transform of |gain|², ``poles`` as of the filter: lines that far apart share their error.
    """
    grid, table = _correlation_table(poles)
    return np.asarray(np.interp(np.abs(lag_bandwidths), grid, table))


def impulse_response(lag_bandwidths: NDArray[np.float64], poles: int) -> NDArray[np.float64]:
    """What the filter gives ``lag_bandwidths`` (any shape) reciprocal bandwidths after an impulse, far below the rate.

    The cosine transform of the gain, as of ``poles``; its integral over the lag is one.
    """
    grid, table = _response_table(poles)
    return np.asarray(np.interp(np.abs(lag_bandwidths), grid, table, right=0.0))


@functools.cache
def _response_table(poles: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lags in reciprocal bandwidths, and the response there."""
    x = np.linspace(0.0, 40.0, 8001)
    gain = 1.0 / (1.0 + HALF_POWER * x ** (2 * poles))
    gain[0] *= 0.5
    grid = np.linspace(0.0, FARTHEST_LAG, 1025)
    return grid, np.asarray(np.cos(np.pi * np.outer(grid, x)) @ gain) * float(x[1])


@functools.cache
def _correlation_table(poles: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lags in reciprocal bandwidths, and the correlation there."""
    x = np.linspace(0.0, 8.0, 801)
    power = 1.0 / (1.0 + HALF_POWER * x ** (2 * poles)) ** 2
    grid = np.linspace(0.0, FARTHEST_LAG, 513)
    table = np.cos(np.pi * np.outer(grid, x)) @ power / power.sum()
    table[-1] = 0.0
    return grid, table
