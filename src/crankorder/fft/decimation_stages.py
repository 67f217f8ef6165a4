"""Design of the decimation to a band: stages, filter lengths and the error they leave, from band and tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

TOLERANCE = 1e-6
"""Default of the largest relative error: below the resolution of a 20-bit converter."""

LARGEST_STAGE = 8
"""A stage of more would need a longer filter than two smaller ones together."""

SPARE_BAND = 1.25
"""The rate kept is at least 2 x 1.25 x the band: room for the filter's skirt and for the angle resampling kernel."""

ON_GRID_SHARE = 0.7
"""A factor so much below the largest is taken where it makes the rate a multiple of the frequency resolution."""

SAMPLE_COST = {2: 12.0, 3: 14.0, 4: 6.0, 5: 8.0, 6: 14.0, 7: 14.0, 8: 14.0}
"""Cost of moving a sample into its phase, in multiplications, by factor (measured: 2…5 G samples/s, 24 G taps/s)."""

ROUNDING = 2e-15
"""Relative rounding error of the taps and sums in float64 (measured below 1e-15): no design reaches further."""

BETWEEN = 1.01
"""Errors between the frequencies looked at may be so many times larger (measured: 1.003)."""


@dataclass(frozen=True)
class DecimationStage:
    """One FIR low-pass of symmetric ``taps`` that keeps every ``factor``-th sample.

    ``ripple`` is its largest relative error from 0 to the band, ``alias`` its largest gain where it folds onto them.
    """

    factor: int
    taps: NDArray[np.float64]
    ripple: float
    alias: float

    @property
    def half(self) -> int:
        """Samples that the filter reaches to either side."""
        return len(self.taps) // 2


def decimation_factor(rate_hz: float, band_hz: float, *, grid_hz: float | None = None) -> int:
    """Largest factor that leaves 2.5 times ``band_hz`` of the rate ``rate_hz`` and splits into stages of at most 8.

    A factor down to 0.7 of it is preferred where the rate left is then a multiple of ``grid_hz``, so that the bins of
    a transform fall on that grid.
    """
    most = max(1, int(rate_hz / (2.0 * SPARE_BAND * band_hz)))
    possible = [factor for factor in range(most, 0, -1) if _splits(factor)]
    if grid_hz is None:
        return possible[0]
    steps = {factor: rate_hz / factor / grid_hz for factor in possible if factor >= ON_GRID_SHARE * most}
    return next((f for f, n in steps.items() if abs(n - round(n)) < 1e-6), possible[0])


def _splits(factor: int) -> bool:
    for prime in (2, 3, 5, 7):
        while factor % prime == 0:
            factor //= prime
    return factor == 1


def decimation_stages(
    rate_hz: float, band_hz: float, factor: int, tolerance: float = TOLERANCE
) -> tuple[DecimationStage, ...]:
    """Cheapest stages that keep 0…``band_hz`` within ``tolerance`` while the rate falls from ``rate_hz`` by ``factor``.

    What would fold onto the band is stopped to ``tolerance``; what lies between the band and half of the new rate may
    fold there. Each filter is the shortest Kaiser-windowed sinc (Kaiser 1974) whose computed response keeps this.
    """
    band = band_hz / rate_hz * factor
    # to the next hundredth of the new rate: recordings that differ little in band share a design
    return _stages(min(max(band, 0.5 / SPARE_BAND), math.ceil(100.0 * band) / 100.0), factor, tolerance)


@lru_cache(maxsize=256)
def _stages(band: float, factor: int, tolerance: float) -> tuple[DecimationStage, ...]:
    """Stages for a ``band`` that is a share of the last rate."""
    rate = float(factor)
    factors = _cheapest(rate, band, factor, tolerance)[1]
    share = max(tolerance, ROUNDING) / max(1, len(factors))
    stages = []
    for divisor in factors:
        stages.append(_shortest(band / rate, divisor, share))
        rate /= divisor
    return tuple(stages)


@lru_cache(maxsize=256)
def decimation_error(rate_hz: float, band_hz: float, factor: int, tolerance: float = TOLERANCE) -> float:
    """Predicted largest relative error of a tone in the band: its own gain, or what folds onto it; 0 for factor 1.

    ``rate_hz``, ``band_hz``, ``factor`` and ``tolerance`` are those of :func:`decimation_stages`, whose responses are
    computed. Rounding comes on top: 6e-8 of a sample for float32 (see ``decimation.SINGLE_SUMS``).
    """
    stages = decimation_stages(rate_hz, band_hz, factor, tolerance)
    if not stages:
        return 0.0
    frequency = np.linspace(0.0, band_hz, 512)
    gain, worst = np.ones_like(frequency), 0.0
    for stage in stages:
        gain *= _response(stage.taps, frequency / rate_hz)
        image = np.minimum(rate_hz / stage.factor + np.concatenate([-frequency, frequency]), 0.5 * rate_hz)
        worst = max(worst, float(np.abs(_response(stage.taps, image / rate_hz)).max()))
        rate_hz /= stage.factor
    return BETWEEN * max(float(np.abs(gain - 1.0).max()), worst)


@lru_cache(maxsize=1024)
def _cheapest(rate_hz: float, band_hz: float, factor: int, tolerance: float) -> tuple[float, tuple[int, ...]]:
    """Cost per sample and factors of the stages, first to last, of the cheapest way to decimate by ``factor``."""
    if factor == 1:
        return 0.0, ()
    best: tuple[float, tuple[int, ...]] = (math.inf, (factor,))
    for divisor in range(2, min(LARGEST_STAGE, factor) + 1):
        if factor % divisor == 0 and _splits(factor // divisor):
            rest, after = _cheapest(rate_hz / divisor, band_hz, factor // divisor, tolerance)
            here = SAMPLE_COST[divisor] + _estimated_taps(rate_hz, band_hz, divisor, tolerance) / divisor
            best = min(best, (here + rest / divisor, (divisor, *after)))
    return best


def _transition(rate_hz: float, band_hz: float, divisor: int) -> float:
    """Width in rad per sample between the band and the first frequency that folds onto it."""
    return 2.0 * np.pi * (rate_hz / divisor - 2.0 * band_hz) / rate_hz


def _estimated_taps(rate_hz: float, band_hz: float, divisor: int, tolerance: float) -> float:
    rejection_db = -20.0 * np.log10(max(tolerance, ROUNDING))
    return max(3.0, float((rejection_db - 7.95) / (2.285 * _transition(rate_hz, band_hz, divisor)) + 1.0))


def _shortest(band: float, divisor: int, tolerance: float) -> DecimationStage:
    """Shortest stage whose computed ripple and alias for a ``band`` (share of its rate) are below ``tolerance``."""
    n_taps = int(_estimated_taps(1.0, band, divisor, tolerance)) | 1
    # closest where both are largest: at the edges of the band and of its first image
    pass_band = band * np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, 24))
    stop_band = np.concatenate([1.0 / divisor - pass_band, 1.0 / divisor + pass_band[::4]])
    both = np.concatenate([pass_band, np.minimum(stop_band, 0.5)])
    while True:
        # the window that fills the whole transition: its attenuation follows from the length
        taps = _taps(n_taps, divisor, 7.95 + 2.285 * (n_taps - 1) * _transition(1.0, band, divisor))
        gain = _response(taps, both)
        ripple = float(np.abs(gain[: len(pass_band)] - 1.0).max())
        alias = float(np.abs(gain[len(pass_band) :]).max())
        if max(ripple, alias) * BETWEEN <= 0.99 * tolerance:
            return DecimationStage(divisor, taps, ripple, alias)
        n_taps += 2


def _taps(n_taps: int, divisor: int, rejection_db: float) -> NDArray[np.float64]:
    """Sinc that cuts at half of the reduced rate, in the Kaiser window for ``rejection_db``; its sum is 1."""
    k = np.arange(n_taps) - n_taps // 2
    taps: NDArray[np.float64] = np.sinc(k / divisor) * np.kaiser(n_taps, max(0.0, 0.1102 * (rejection_db - 8.7)))
    taps /= taps.sum()
    return taps


def _response(taps: NDArray[np.float64], share_of_rate: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gain of symmetric ``taps`` at frequencies given as a share of the sample rate."""
    k = np.arange(1, len(taps) // 2 + 1)
    side = taps[len(taps) // 2 + 1 :]
    return np.asarray(taps[len(taps) // 2] + 2.0 * (np.cos(2.0 * np.pi * np.outer(share_of_rate, k)) @ side))
