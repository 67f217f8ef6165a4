"""Multiples of a mains frequency, and how far they wander."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crankorder.settings import IdentifySettings


def nearest_multiple(
    frequency_hz: NDArray[np.float64] | float, mains_hz: float, *, settings: IdentifySettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The multiple of ``mains_hz`` next to each ``frequency_hz`` (any shape, Hz), and how far (Hz) it may lie from it.

    ``settings``: how far the mains frequency wanders.
    """
    multiple = np.maximum(1.0, np.rint(np.asarray(frequency_hz, dtype=np.float64) / mains_hz))
    return multiple, settings.mains_tolerance_hz * np.sqrt(multiple)
