"""What a structure of modes makes of forces, and the exact sum of steady tones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

BLOCK_SAMPLES = 1024
"""Samples per block of :func:`tones`: a table of this length and one phasor per block replace a cosine per sample."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """Modes and rigid-body part between forces in X, Y, Z at the crankcase and the accelerometers.

    ``frequency_hz`` and ``damping_ratio`` (mode); ``sensor_per_kg`` (mode, channel): motion of a sensor per unit of
    modal force; ``drive`` (mode, direction): share of a force that works on a mode; ``rigid_body_per_kg`` (channel,
    direction). The residue of a mode from a direction to a channel is ``sensor_per_kg · drive`` (1/kg).
    """

    frequency_hz: NDArray[np.float64]
    damping_ratio: NDArray[np.float64]
    sensor_per_kg: NDArray[np.float64]
    drive: NDArray[np.float64]
    rigid_body_per_kg: NDArray[np.float64]


def accelerance(structure: Structure, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
    """Complex acceleration per force (1/kg), shape (channel, direction, frequency).

    Σ residue · (−ω²) / (ωn² − ω² + 2iζωnω) + rigid-body part: the exact steady state at each frequency.

    ``structure``: modes and rigid-body part. ``frequency_hz``: ≥ 0, shape (frequency,).
    Source: any text on modal analysis, for instance Ewins (2000), equation 2.67 with ω² for acceleration.
    """
    frequency = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    response = np.zeros((*structure.rigid_body_per_kg.shape, frequency.size), dtype=np.complex128)
    response += structure.rigid_body_per_kg[:, :, None]
    for j, natural_hz in enumerate(structure.frequency_hz):
        ratio = frequency / natural_hz
        shape = -(ratio**2) / (1 - ratio**2 + 2j * structure.damping_ratio[j] * ratio)
        for channel, direction in np.argwhere(np.outer(structure.sensor_per_kg[j], structure.drive[j])):
            residue = structure.sensor_per_kg[j, channel] * structure.drive[j, direction]
            response[channel, direction] += residue * shape
    return response


def tones(
    amplitude: NDArray[np.complex128], frequency_hz: NDArray[np.float64], *, rate_hz: float, n_samples: int
) -> NDArray[np.float64]:
    """Sum of steady tones Re Σ amplitude · exp(2πi frequency t), t = sample / rate, shape (channel, n_samples).

    ``amplitude``: complex peak at the first sample, shape (channel, line). ``frequency_hz``: shape (line,), any sign.
    ``rate_hz``: samples per second, > 0. ``n_samples``: ≥ 1. The error is round-off (some 1e-11 of the peak after 10⁴
    periods), for each block starts from its own exactly reduced phase.
    """
    n_channels, n_lines = amplitude.shape
    n_blocks = -(-n_samples // BLOCK_SAMPLES)
    per_sample_rev = frequency_hz / rate_hz
    within = 2 * np.pi * per_sample_rev[:, None] * np.arange(BLOCK_SAMPLES)
    table = np.concatenate([np.cos(within), np.sin(within)])
    block_rev = per_sample_rev[:, None] * (np.arange(n_blocks) * float(BLOCK_SAMPLES))
    start = np.exp(2j * np.pi * (block_rev - np.rint(block_rev)))
    phasor = (amplitude[:, :, None] * start).transpose(0, 2, 1)
    weights = np.concatenate([phasor.real, -phasor.imag], axis=2).reshape(n_channels * n_blocks, 2 * n_lines)
    summed: NDArray[np.float64] = (weights @ table).reshape(n_channels, n_blocks * BLOCK_SAMPLES)
    return summed[:, :n_samples]
