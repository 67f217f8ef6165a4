"""Which orders lie closest to each other, for the message that they cannot be told apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def closest(
    phase_rev: NDArray[np.float64],
    bandwidth_hz: NDArray[np.float64],
    *,
    rate_hz: float,
    names: Sequence[str] | None = None,
) -> tuple[str, float]:
    """Name of the two components that are closest for their bandwidth, and their median distance in Hz.

    ``phase_rev`` (orders, samples) at ``rate_hz``, ``bandwidth_hz`` (orders, points), ``names`` (orders,) for people,
    "component 0" and so on without. A component is also held against its own and the others' images at minus the
    frequency, and at the sample rate.
    """
    frequency = np.diff(phase_rev, axis=1) * rate_hz
    width = np.median(bandwidth_hz, axis=1)
    called = [f"component {k}" for k in range(len(frequency))] if names is None else list(names)
    found = []
    for i in range(len(frequency)):
        for j in range(i, len(frequency)):
            wide = float(width[i] * width[j]) ** 0.5
            if i != j:
                apart = _distance(frequency[i] - frequency[j], rate_hz)
                found.append(
                    (
                        apart / wide,
                        f"components {i} and {j}" if names is None else f"{called[i]} and {called[j]}",
                        apart,
                    )
                )
            apart = _distance(frequency[i] + frequency[j], rate_hz)
            image = "its own image" if i == j else f"the image of {called[j]}"
            found.append((apart / wide, f"{called[i]} and {image} at minus the frequency", apart))
    _, name, apart = min(found)
    return name, apart


def _distance(difference_hz: NDArray[np.float64], rate_hz: float) -> float:
    return float(np.median(np.abs(difference_hz - rate_hz * np.round(difference_hz / rate_hz))))
