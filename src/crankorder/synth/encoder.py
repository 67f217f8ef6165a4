"""The shaft encoder as a data-acquisition system samples it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def sampled_encoder(
    start_rev: float, speed_rpm: float, *, pulses_per_rev: int, high_v: float, rate_hz: float, n_samples: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Square wave of the encoder (V) and index mark (0 or 1) at constant speed, each of shape (n_samples,).

    A pulse rises at every whole 1/pulses_per_rev of a revolution and is high for the first half of it; the index is
    high for the first pulse period after top dead centre of the crank, once per revolution.

    ``start_rev``: crank angle of the first sample, ≥ 0. ``speed_rpm``: > 0. ``pulses_per_rev``: ≥ 1. ``high_v``:
    volts of the high level. ``rate_hz``: samples per second; each half pulse needs at least one sample.
    ``n_samples``: ≥ 1.
    """
    half_pulses_per_rev = 2 * pulses_per_rev
    per_sample = half_pulses_per_rev * speed_rpm / (60 * rate_hz)
    position = np.arange(n_samples, dtype=np.float64)
    position *= per_sample
    position += half_pulses_per_rev * start_rev
    half_pulse = position.astype(np.int32)
    encoder = np.float32(high_v) * (half_pulse & 1 == 0)
    index = (half_pulse % half_pulses_per_rev < 2).view(np.uint8)
    return encoder.astype(np.float32, copy=False), index
