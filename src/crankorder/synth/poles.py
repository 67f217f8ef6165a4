"""A structure and the filter behind it as first-order poles, whose motion under any force is known exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.synth.response import Structure, transfer_function

if TYPE_CHECKING:
    from crankorder.synth.analogue import AnalogueFilter

Complex = NDArray[np.complex128]
CLOSEST = 1e-6
"""Distance of a mode from a pole of the filter, as a share of either, below which partial fractions lose their digits:
residues grow as the inverse of the distance and then cancel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Poles:
    """Acceleration a = Re Σ output · z + direct · f under forces f, where each ż = pole · z + Σ input · f.

    ``pole_per_s`` (pole,), 1/s, one of each conjugate pair; ``input`` (pole, axis); ``output`` (channel, pole);
    ``direct`` (channel, axis): what follows the force at once.
    """

    pole_per_s: Complex
    input: NDArray[np.float64]
    output: Complex
    direct: NDArray[np.float64]

    @property
    def decay_s(self) -> float:
        """Time (s) in which the slowest pole falls to 1/e; 0 where there is no pole."""
        return float(np.max(-1 / self.pole_per_s.real, initial=0.0))

    def seen_by(self, channels: NDArray[np.intp]) -> Poles:
        """The poles as some ``channels`` (channel,), numbers from 0, see them."""
        return Poles(
            pole_per_s=self.pole_per_s,
            input=self.input,
            output=np.ascontiguousarray(self.output[channels]),
            direct=self.direct[channels],
        )

    def driven_on(self, axes: NDArray[np.bool_]) -> Poles:
        """The poles that forces on some ``axes`` (axis,) move, all others left out."""
        moved = self.input[:, axes].any(axis=1)
        return Poles(
            pole_per_s=self.pole_per_s[moved],
            input=self.input[moved],
            output=np.ascontiguousarray(self.output[:, moved]),
            direct=self.direct,
        )


def poles_of(structure: Structure, filter: AnalogueFilter | None = None) -> Poles:
    """Poles between the forces on ``structure`` and its accelerometers, behind an analogue ``filter`` if there is one.

    The modes come first, in their sequence; then each pole of the filter once for every axis that moves a sensor.
    Raises RequestError where a mode and the filter have the same pole. Source: partial fractions; for complex residues
    see :func:`crankorder.synth.response.transfer_function`.
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
        raise RequestError(
            "a mode and the analogue filter have the same pole",
            found=f"{structure.frequency_hz[mode]:g} Hz with damping ratio {structure.damping_ratio[mode]:g}",
            remedy="Shift the mode or the corner of the filter by a millionth or more",
        )
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


def steady_state(poles: Poles, force: Complex, frequency_hz: NDArray[np.float64]) -> Complex:
    """State (pole,) at t = 0 of the steady response of ``poles`` to Re Σ force · exp(2πi frequency t).

    ``force``: complex peak, shape (axis, line). ``frequency_hz``: shape (line,), any sign; 0 is a constant force.
    """
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    acting = poles.input @ force
    apart = poles.pole_per_s[:, None]
    state: Complex = 0.5 * (acting / (s - apart) - acting.conj() / (s + apart)).sum(axis=1)
    return state
