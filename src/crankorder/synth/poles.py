"""A structure of modes and the filter behind it: its response to steady tones, and first-order poles for any force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError
from crankorder.quantities import Bools, Complexes, Floats

if TYPE_CHECKING:
    from crankorder.synth.analogue import AnalogueFilter


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

    frequency_hz: Floats
    damping_ratio: Floats
    sensor_per_kg: Complexes
    drive: Floats
    rigid_body_per_kg: Floats


def accelerance(structure: Structure, frequency_hz: ArrayLike) -> Complexes:
    """Complex acceleration per force (1/kg), shape (channel, axis, frequency): the exact steady state.

    ``structure``: modes and rigid-body part. ``frequency_hz``: any sign, shape (frequency,).
    The formula is that of :func:`transfer_function` at s = iω.
    """
    omega = 2 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    return transfer_function(structure, 1j * omega)


def transfer_function(structure: Structure, s_per_s: ArrayLike) -> Complexes:
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


def tones(amplitude: Complexes, frequency_hz: Floats, *, rate_hz: float, n_samples: int) -> Floats:
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
    summed: Floats = (weights @ table).reshape(n_channels, n_blocks * BLOCK_SAMPLES)
    return summed[:, :n_samples]


CLOSEST = 1e-6
"""Distance of a mode from a pole of the filter, as a share of either, below which partial fractions lose their digits:
residues grow as the inverse of the distance and then cancel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Poles:
    """Acceleration a = Re Σ output · z + direct · f under forces f, where each ż = pole · z + Σ input · f.

    ``pole_per_s`` (pole,), 1/s, one of each conjugate pair; ``input`` (pole, axis); ``output`` (channel, pole);
    ``direct`` (channel, axis): what follows the force at once.
    """

    pole_per_s: Complexes
    input: Floats
    output: Complexes
    direct: Floats

    @property
    def decay_s(self) -> float:
        """Time (s) in which the slowest pole falls to 1/e; 0 where there is no pole."""
        return float(np.max(-1 / self.pole_per_s.real, initial=0.0))

    def seen_by(self, channels: NDArray[np.intp]) -> Poles:
        """The poles as some ``channels`` (channel,), numbers from 0, see them."""
        output = np.ascontiguousarray(self.output[channels])
        return Poles(pole_per_s=self.pole_per_s, input=self.input, output=output, direct=self.direct[channels])

    def driven_on(self, axes: Bools) -> Poles:
        """The poles that forces on some ``axes`` (axis,) move, all others left out."""
        moved = self.input[:, axes].any(axis=1)
        output = np.ascontiguousarray(self.output[:, moved])
        return Poles(pole_per_s=self.pole_per_s[moved], input=self.input[moved], output=output, direct=self.direct)


def poles_of(structure: Structure, filter: AnalogueFilter | None = None) -> Poles:
    """Poles between the forces on ``structure`` and its accelerometers, behind an analogue ``filter`` if there is one.

    The modes come first, in their sequence; then each pole of the filter once for every axis that moves a sensor.
    Raises RequestError where a mode and the filter have the same pole. Source: partial fractions; for complex residues
    see :func:`crankorder.synth.poles.transfer_function`.
    """
    natural, damping = 2 * np.pi * structure.frequency_hz, structure.damping_ratio
    damped = natural * np.sqrt(1 - damping**2)
    pole = -damping * natural + 1j * damped
    sensor = np.asarray(structure.sensor_per_kg, dtype=np.complex128)
    output = sensor * (pole**2 / (1j * damped))[:, None]
    at_once = sensor.real - sensor.imag * (damping * natural / damped)[:, None]
    direct = structure.rigid_body_per_kg + at_once.T @ structure.drive
    modes = Poles(pole_per_s=pole, input=structure.drive.astype(np.float64), output=output.T.copy(), direct=direct)
    return modes if filter is None else _behind(modes, structure, filter)


def _behind(modes: Poles, structure: Structure, filter: AnalogueFilter) -> Poles:
    """Modes with the filter in series: each pole's residue times what the other system is there."""
    pole, residue = filter.pole_per_s, filter.residue
    apart = np.abs(modes.pole_per_s[:, None] - pole)
    if np.any(apart < CLOSEST * np.abs(pole)):
        mode = int(np.argwhere(apart < CLOSEST * np.abs(pole))[0, 0])
        found = f"{structure.frequency_hz[mode]:g} Hz with damping ratio {structure.damping_ratio[mode]:g}"
        remedy = "Shift the mode or the corner of the filter by a millionth or more"
        raise RequestError("a mode and the analogue filter have the same pole", found=found, remedy=remedy)
    upper = pole.imag >= 0
    both = np.where(pole[upper].imag > 0, 2.0, 1.0)  # a pair counts twice its real part, a real pole once
    gain = transfer_function(structure, pole[upper]) * (both * residue[upper])
    axes = np.flatnonzero(gain.any(axis=(0, 2)))
    identity = np.eye(modes.input.shape[1])
    return Poles(
        pole_per_s=np.concatenate([modes.pole_per_s, np.tile(pole[upper], axes.size)]),
        input=np.concatenate([modes.input, np.repeat(identity[axes], np.count_nonzero(upper), axis=0)]),
        output=np.concatenate(
            [modes.output * filter.at(modes.pole_per_s), gain[:, axes].reshape(gain.shape[0], -1)], axis=1
        ),
        direct=modes.direct * filter.direct,
    )


def steady_state(poles: Poles, force: Complexes, frequency_hz: Floats) -> Complexes:
    """State (pole,) at t = 0 of the steady response of ``poles`` to Re Σ force · exp(2πi frequency t).

    ``force``: complex peak, shape (axis, line). ``frequency_hz``: shape (line,), any sign; 0 is a constant force.
    """
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    acting = poles.input @ force
    apart = poles.pole_per_s[:, None]
    state: Complexes = 0.5 * (acting / (s - apart) - acting.conj() / (s + apart)).sum(axis=1)
    return state
