"""What lies between the forces on a structure and the file, as poles and residues: modes, filters, then the converter.

The response of the structure to steady tones, and first-order poles for any force; filters join its modes exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import STANDARD_GRAVITY_M_S2
from crankorder.synth.parts import Acquisition

POLES_APART = 1e-6
"""Smallest distance of two poles, relative to the larger: nearer ones would cost more than 6 of 16 digits, for the
residues of partial fractions grow as the inverse of the distance and then cancel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AnalogueFilter:
    """Transfer function direct + Σ residue / (s − pole), s in rad/s, every pole listed with its conjugate.

    ``pole_per_s`` and ``residue`` (pole,), both complex and in 1/s; ``direct``: gain at infinite frequency. Gains are
    exact to 1e-13 of 1, not of themselves: a filter that damps by 1e-20 gives round-off there.
    """

    pole_per_s: Complexes
    residue: Complexes
    direct: float

    def at(self, s_per_s: Complexes) -> Complexes:
        """Complex gain at points of the complex plane, shape of ``s_per_s`` (rad/s); none of them may be a pole."""
        s = np.asarray(s_per_s, dtype=np.complex128)
        gain: Complexes = np.full(s.shape, self.direct, dtype=np.complex128)
        for pole, residue in zip(self.pole_per_s, self.residue, strict=True):
            gain += residue / (s - pole)
        return gain

    def response(self, frequency_hz: Floats) -> Complexes:
        """Complex gain in the steady state, shape of ``frequency_hz`` (Hz, any sign)."""
        return self.at(np.asarray(2j * np.pi * np.asarray(frequency_hz), dtype=np.complex128))

    def folded_power(self, rate_hz: float, frequency_hz: Floats) -> Floats:
        """Σ |H(f + k · rate)|² over all whole k: power of white noise after filter and sampling, per power before.

        ``rate_hz``: samples per second, > 0. ``frequency_hz``: f in Hz, any shape, which is the result's. The error is
        1e-12 of 1. For a ``direct`` of 0 alone: else the sum would be infinite.
        Source: Poisson's sum over the autocovariance Σ residue · H(−pole) · exp(pole · |lag|).
        """
        half_turn = np.sin(np.pi * np.asarray(frequency_hz, dtype=np.float64) / rate_hz) ** 2
        weight = self.residue * self.at(-self.pole_per_s) / rate_hz
        power = np.zeros(half_turn.shape)
        for pole, share in zip(self.pole_per_s / rate_hz, weight, strict=True):
            if pole.imag >= 0:  # the conjugate adds the conjugate
                term = -share * np.expm1(2 * pole) / (np.expm1(pole) ** 2 + 4 * np.exp(pole) * half_turn)
                power += term.real if pole.imag == 0 else 2 * term.real
        return power


def low_pass(order: int, corner_hz: float) -> AnalogueFilter:
    """Butterworth low-pass filter, −3 dB at its corner, falling by 6 dB per octave and order above.

    ``order``: 1 … 12. ``corner_hz``: > 0.
    Source: S. Butterworth (1930); poles at exp(iπ(2k + n − 1)/2n), k = 1 … n, of the unit circle times the corner.
    """
    upper = np.exp(0.5j * np.pi * (2 * np.arange(1, order // 2 + 1) + order - 1) / order)
    pole: Complexes = np.concatenate([upper, [-1.0] if order % 2 else [], upper.conj()])
    apart = pole[:, None] - pole[None, :]
    np.fill_diagonal(apart, 1.0)
    residue = 1 / apart.prod(axis=1)
    corner = 2 * np.pi * corner_hz
    return AnalogueFilter(pole_per_s=corner * pole, residue=corner * residue, direct=0.0)


def high_pass(corner_hz: float) -> AnalogueFilter:
    """First-order high-pass filter, as AC coupling is: s / (s + corner), −3 dB at its corner.

    ``corner_hz``: > 0.
    """
    pole = np.array([-2 * np.pi * corner_hz], dtype=np.complex128)
    return AnalogueFilter(pole_per_s=pole, residue=pole, direct=1.0)


def in_series(a: AnalogueFilter, b: AnalogueFilter) -> AnalogueFilter:
    """Filter ``a`` behind filter ``b``, again as poles and residues.

    They may not share a pole: such a filter has no simple residues.
    """
    pole_per_s = np.concatenate([a.pole_per_s, b.pole_per_s])
    residue = np.concatenate([a.residue * b.at(a.pole_per_s), b.residue * a.at(b.pole_per_s)])
    return AnalogueFilter(pole_per_s=pole_per_s, residue=residue, direct=a.direct * b.direct)


def analogue_filter(acquisition: Acquisition) -> AnalogueFilter | None:
    """Filter of an acquisition: low-pass, AC coupling, or one behind the other; None where it has neither.

    ``acquisition``: its ``low_pass_hz``, ``low_pass_order`` and ``ac_coupling_hz`` count.
    Raises RequestError where the AC coupling is not below the low-pass: nothing would pass.
    """
    low_hz, high_hz = acquisition.low_pass_hz, acquisition.ac_coupling_hz
    if low_hz is not None and high_hz is not None:
        if high_hz >= (1 - POLES_APART) * low_hz:
            problem = "the AC coupling leaves nothing of what the low-pass lets through"
            allowed = f"below low_pass_hz, {low_hz:g}"
            raise RequestError(problem, place="acquisition.ac_coupling_hz", found=high_hz, allowed=allowed)
        return in_series(low_pass(acquisition.low_pass_order, low_hz), high_pass(high_hz))
    if low_hz is not None:
        return low_pass(acquisition.low_pass_order, low_hz)
    return None if high_hz is None else high_pass(high_hz)


SAMPLES_AT_ONCE = 1 << 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Recorded:
    """Channels as a file holds them.

    ``samples`` (channel, sample), float32, float64 or int16; ``scale``: for int16 the value of one count in ``unit``
    (the ``scale_factor`` of the CF conventions), otherwise None; ``unit``: "m/s2" or "V"; ``clipped_share`` (channel,):
    part of the samples that were beyond the range, 0 … 1.
    """

    samples: NDArray[Any]
    scale: float | None
    unit: str
    clipped_share: Floats


def true_rate_hz(acquisition: Acquisition, rate_hz: float) -> float:
    """Samples per true second of a clock that runs faster than its label by ``clock_error_ppm`` of ``acquisition``.

    ``rate_hz``: what the label says, > 0.
    """
    return rate_hz * (1 + acquisition.clock_error_ppm * 1e-6)


def recorded(signal: Floats, acquisition: Acquisition) -> Recorded:
    """``signal`` in the unit of the file, cut off at full scale, in steps of the converter, in the number type stored.

    The converter is mid-tread: codes −2^(bits − 1) … 2^(bits − 1) − 1 of full_scale / 2^(bits − 1) each, so that 0 is a
    code and full scale itself is one step out of reach. int16 stores the codes (16 bits where none are stated); float
    types store their values, NaN too; infinity is cut off like any other value, or stays where there is no range.

    ``signal``: m/s², shape (channel, n). ``acquisition``: sensitivity, full scale, bits and number type.
    """
    sensitivity = acquisition.sensitivity_mv_per_g
    per_m_s2 = 1.0 if sensitivity is None else sensitivity * 1e-3 / STANDARD_GRAVITY_M_S2
    full_scale = math.inf if acquisition.full_scale is None else acquisition.full_scale
    bits = 16 if acquisition.bits is None and acquisition.stored_as == "int16" else acquisition.bits
    step = None if bits is None else full_scale / 2 ** (bits - 1)
    count_value = step if acquisition.stored_as == "int16" else None
    samples = np.empty(signal.shape, dtype=acquisition.stored_as)
    n_clipped = np.zeros(len(signal))
    for channel, row in enumerate(signal):
        for start in range(0, row.size, SAMPLES_AT_ONCE):
            values = np.multiply(row[start : start + SAMPLES_AT_ONCE], per_m_s2, dtype=np.float64)
            n_clipped[channel] += _convert(values, full_scale, step)
            if step is not None and count_value is None:
                values *= step
            samples[channel, start : start + values.size] = values
    unit = "m/s2" if sensitivity is None else "V"
    return Recorded(samples=samples, scale=count_value, unit=unit, clipped_share=n_clipped / max(1, signal.shape[1]))


def _convert(values: Floats, full_scale: float, step: float | None) -> int:
    """Cut ``values`` off and, where there is a ``step``, turn them into codes, in place; how many were out of range."""
    low, high = -full_scale, full_scale
    if step is not None:
        values /= step
        np.rint(values, out=values)
        low, high = low / step, high / step - 1
    n_clipped = int(np.count_nonzero(values < low) + np.count_nonzero(values > high))
    if n_clipped:
        np.clip(values, low, high, out=values)
    return n_clipped


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
    if np.any(apart < POLES_APART * np.abs(pole)):
        mode = int(np.argwhere(apart < POLES_APART * np.abs(pole))[0, 0])
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
    return np.asarray(0.5 * (acting / (s - apart) - acting.conj() / (s + apart)).sum(axis=1))
