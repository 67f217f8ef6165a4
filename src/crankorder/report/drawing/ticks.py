"""Where the ticks of an axis stand and what they say."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_FEW_DECADES = 2.0
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


def linear_ticks(low: float, high: float, *, most: int, whole: bool = False) -> NDArray[np.float64]:
    """Round places from ``low`` to ``high``, at most ``most`` + 1 of them, whole numbers where ``whole``."""
    raw = max((high - low) / max(most, 1), 1e-300)
    if whole:
        raw = max(raw, 1.0)
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(s for s in _STEPS if s * size >= raw * (1 - 1e-9) and not (whole and (s * size) % 1)) * size
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.asarray(np.arange(first, last + 1) * step, dtype=np.float64)


def linear_texts(places: NDArray[np.float64]) -> list[str]:
    """Texts of evenly spaced ``places``: decimals that tell them apart, powers of ten far off 1."""
    if not len(places):
        return []
    step = float(places[1] - places[0]) if len(places) > 1 else abs(float(places[0])) or 1.0
    largest = float(np.abs(places).max())
    if step >= 1e5 or largest < 1e-4:
        return [f"{value:.3g}".replace("-", "−") for value in places]
    decimals = next((n for n in range(8) if abs(step * 10**n - round(step * 10**n)) < 1e-6), 8)
    return [f"{value:.{decimals}f}".replace("-", "−") if value else f"{0:.{decimals}f}" for value in places]


def log_ticks(low: float, high: float, *, most: int) -> NDArray[np.float64]:
    """Decades from ``low`` to ``high``, at most ``most``; 2 and 5 between where they are few."""
    decades = np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    stride = max(1, math.ceil(math.log10(high / low) / most))
    subs = (1.0, 2.0, 5.0) if math.log10(high / low) < _FEW_DECADES else (1.0,)
    kept = decades[decades % stride == 0]
    places = np.sort(np.concatenate([sub * 10.0**kept for sub in subs]))
    return np.asarray(places[(places >= low * (1 - 1e-9)) & (places <= high * (1 + 1e-9))])
