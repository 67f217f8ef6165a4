"""What a structure of modes makes of forces, and the exact sum of steady tones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

BLOCK_SAMPLES = 1024
"""Samples per block of :func:`tones`: a table of this length and one phasor per block replace a cosine per sample."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """Modes and rigid-body part between what acts on the crankcase (``parts.AXES``) and the accelerometers.

    ``frequency_hz`` and ``damping_ratio`` (mode); ``sensor_per_kg`` (mode, channel): motion of a sensor per unit of
    modal force, complex where the mode is; ``drive`` (mode, axis): share of a force (1) or moment (1/m) that works on a
    mode; ``rigid_body_per_kg`` (channel, axis). The residue of a mode from an axis to a channel is
    ``sensor_per_kg · drive`` (1/kg).
    """

    frequency_hz: NDArray[np.float64]
    damping_ratio: NDArray[np.float64]
    sensor_per_kg: NDArray[np.complex128]
    drive: NDArray[np.float64]
    rigid_body_per_kg: NDArray[np.float64]


def accelerance(structure: Structure, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
    """Complex acceleration per force (1/kg), shape (channel, axis, frequency): the exact steady state.

    ``structure``: modes and rigid-body part. ``frequency_hz``: any sign, shape (frequency,).
    The formula is that of :func:`transfer_function` at s = iω.
    """
    omega = 2 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    return transfer_function(structure, 1j * omega)


def transfer_function(structure: Structure, s_per_s: ArrayLike) -> NDArray[np.complex128]:
    """Acceleration per force (1/kg) at points of the complex plane, shape (channel, axis, point).

    ``structure``: modes and rigid-body part. ``s_per_s``: points (rad/s), shape (point,), none of them a pole.

    A real residue r gives r·s²/(s² + 2ζω_n·s + ω_n²). A residue r·e^{iψ} gives s² times the displacement
    r·[e^{iψ}/(s − λ) − e^{−iψ}/(s − λ*)]/(2iω_d), λ = −ζω_n + iω_d, less its part r·sin ψ·s/ω_d, which grows with
    frequency for ever: the modes of any body with mass cancel it among themselves (Σ r·sin ψ/ω_d = 0).
    Source: any text on modal analysis, for instance Ewins (2000), equations 2.67 and 2.86, with s² for acceleration.
    """
    s = np.asarray(s_per_s, dtype=np.complex128)
    response = np.zeros((*structure.rigid_body_per_kg.shape, s.size), dtype=np.complex128)
    response += structure.rigid_body_per_kg[:, :, None]
    for natural_hz, damping, sensor, drive in zip(
        structure.frequency_hz, structure.damping_ratio, structure.sensor_per_kg, structure.drive, strict=True
    ):
        x = s / (2 * np.pi * natural_hz)
        over = x / (1 + x * (x + 2 * damping))
        in_phase = x * over
        quadrature = -over * (1 + damping * x) / np.sqrt(1 - damping**2) if np.any(np.imag(sensor)) else over
        for channel, axis in np.argwhere(np.outer(sensor, drive)):
            residue = sensor[channel] * drive[axis]
            response[channel, axis] += residue.real * in_phase
            if residue.imag:
                response[channel, axis] += residue.imag * quadrature
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
