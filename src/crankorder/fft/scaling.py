"""Powers of two to take out of signals whose squares would leave the range of numbers: nothing is rounded by them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LEAST, LARGEST = -1021, 1023
"""Exponents of two between which both the power and its inverse are normal numbers, or nearly so."""


def power_of_two(values: NDArray[Any]) -> NDArray[np.float64]:
    """Power of two (channels, 1, …) next above the largest magnitude of each channel, 2 where that is 0 or unknown.

    ``values`` (channels, …) real or complex, in any unit; NaN is left out.
    """
    axes = tuple(range(1, values.ndim))
    if np.iscomplexobj(values):
        largest = np.abs(np.nan_to_num(values)).max(axis=axes, keepdims=True, initial=0.0)
    else:
        high, low = (bound.reduce(values, axis=axes, keepdims=True, initial=0.0) for bound in (np.fmax, np.fmin))
        largest = np.maximum(high, -low)
    exponent = np.frexp(np.where(largest > 0.0, largest, 1.0))[1]
    return np.asarray(np.ldexp(1.0, np.clip(exponent, LEAST, LARGEST)))
