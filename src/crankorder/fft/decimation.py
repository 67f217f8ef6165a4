"""Low-pass filtering and decimation to the band that is asked for, without shifting time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba as nb
import numpy as np
from numpy.typing import NDArray

RIPPLE_DB = 120.0
"""Pass-band ripple and stop-band rejection of every stage: 1e-6, below the resolution of a 20-bit converter."""

DESIGN_DB = RIPPLE_DB + 12.0
"""More than is stated: passing a constant exactly moves the whole ripple to one side, and it grows at the edge."""

LARGEST_STAGE = 8
"""A stage of more would need a longer filter than two smaller ones together."""

SPARE_BAND = 1.25
"""The rate kept is at least 2 x 1.25 x the band: room for the filter's skirt and for the angle resampling kernel."""


@dataclass(frozen=True)
class DecimationStage:
    """One FIR low-pass of symmetric ``taps`` that keeps every ``factor``-th sample."""

    factor: int
    taps: NDArray[np.float64]


ON_GRID_SHARE = 0.7
"""A factor so much below the largest is taken where it makes the rate a multiple of the frequency resolution."""


def decimation_factor(rate_hz: float, band_hz: float, *, grid_hz: float | None = None) -> int:
    """Largest factor that leaves 2.5 times ``band_hz`` of the rate ``rate_hz`` and splits into stages of at most 8.

    A factor down to 0.7 of it is preferred where the rate left is then a multiple of ``grid_hz``, so that the bins of
    a transform fall on that grid.
    """
    most = max(1, int(rate_hz / (2.0 * SPARE_BAND * band_hz)))
    possible = [factor for factor in range(most, 0, -1) if _stage_factors(factor) is not None]
    if grid_hz is None:
        return possible[0]
    steps = {factor: rate_hz / factor / grid_hz for factor in possible if factor >= ON_GRID_SHARE * most}
    return next((f for f, n in steps.items() if abs(n - round(n)) < 1e-6), possible[0])


def _stage_factors(factor: int) -> list[int] | None:
    """Factors of at most 8, largest first, with the product ``factor``; None where a prime is larger."""
    factors: list[int] = []
    while factor > 1:
        divisor = next((d for d in range(min(LARGEST_STAGE, factor), 1, -1) if factor % d == 0), None)
        if divisor is None:
            return None
        factors.append(divisor)
        factor //= divisor
    return factors


@lru_cache(maxsize=64)
def decimation_stages(rate_hz: float, band_hz: float, factor: int) -> tuple[DecimationStage, ...]:
    """Stages that keep 0…``band_hz`` within 1e-6 while the rate falls from ``rate_hz`` by ``factor``.

    Each filter is a Kaiser-windowed sinc (Kaiser 1974): it passes the band and stops what would fold into it.
    """
    stages = []
    for divisor in _stage_factors(factor) or []:
        low_rate = rate_hz / divisor
        stop_hz = low_rate - band_hz
        width = 2.0 * np.pi * (stop_hz - band_hz) / rate_hz
        n_taps = int(np.ceil((DESIGN_DB - 7.95) / (2.285 * width))) | 1
        beta = 0.1102 * (DESIGN_DB - 8.7)
        k = np.arange(n_taps) - n_taps // 2
        cut = (band_hz + stop_hz) / rate_hz
        taps = cut * np.sinc(cut * k) * np.kaiser(n_taps, beta)
        stages.append(DecimationStage(divisor, taps / taps.sum()))
        rate_hz = low_rate
    return tuple(stages)


@nb.njit(cache=True, nogil=True, fastmath=True)
def _fir_decimate(signal, taps, factor, first, out):  # type: ignore[no-untyped-def]
    n_taps = len(taps)
    for k in range(out.shape[0]):
        start = first + k * factor
        segment = signal[start : start + n_taps]
        total = taps[0] * segment[0]
        for j in range(1, n_taps):
            total += taps[j] * segment[j]
        out[k] = total


def decimate(
    signals: NDArray[np.floating], *, rate_hz: float, band_hz: float, factor: int
) -> tuple[NDArray[np.float64], float, float]:
    """Signals without their mean, low-passed to ``band_hz`` and decimated by ``factor``; then rate and start.

    ``signals`` is (channels, samples) at ``rate_hz``. Returns (channels, fewer samples), the new rate in Hz and the
    time in s of its first sample after the first of ``signals``: only outputs whose filter lies wholly inside the
    record are given. The sums run in the precision of ``signals``.
    """
    stages = decimation_stages(rate_hz, band_hz, factor)
    current = signals - signals.mean(axis=1, keepdims=True, dtype=np.float64).astype(signals.dtype)
    start_s = 0.0
    for stage in stages:
        half = len(stage.taps) // 2
        skip = -(-half // stage.factor)
        n_out = max(0, (current.shape[1] - 1 - half) // stage.factor - skip + 1)
        reduced = np.empty((len(current), n_out), dtype=current.dtype)
        taps = stage.taps.astype(current.dtype)
        for signal, out in zip(current, reduced, strict=True):
            _fir_decimate(np.ascontiguousarray(signal), taps, stage.factor, skip * stage.factor - half, out)
        start_s += skip * stage.factor / rate_hz
        rate_hz /= stage.factor
        current = reduced
    return current.astype(np.float64), rate_hz, start_s
