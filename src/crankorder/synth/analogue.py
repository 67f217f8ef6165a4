"""What stands between sensor and file: filters as poles and residues, which join a structure's modes exactly; clock,
converter and number type.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.quantities import Complexes, Floats
from crankorder.settings import STANDARD_GRAVITY_M_S2
from crankorder.synth.parts import Acquisition

MAX_ORDER = 12
"""Of a Butterworth filter: its residues reach some hundred times the corner, which still costs 2 of 16 digits only."""

POLES_APART = 1e-6
"""Smallest distance of two poles, relative to the larger: nearer ones would cost more than 6 of 16 digits."""


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
        1e-12 of 1. Raises ValueError where ``direct`` is not 0: the sum would be infinite.
        Source: Poisson's sum over the autocovariance Σ residue · H(−pole) · exp(pole · |lag|).
        """
        if self.direct != 0.0:
            raise ValueError("a filter that lets the highest frequencies through folds an infinite power")
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

    ``order``: 1 … 12. ``corner_hz``: > 0. Raises ValueError for another order or corner.
    Source: S. Butterworth (1930); poles at exp(iπ(2k + n − 1)/2n), k = 1 … n, of the unit circle times the corner.
    """
    if not (1 <= order <= MAX_ORDER and corner_hz > 0):
        raise ValueError(f"a low-pass filter has an order of 1 … {MAX_ORDER} and a corner above 0")
    upper = np.exp(0.5j * np.pi * (2 * np.arange(1, order // 2 + 1) + order - 1) / order)
    pole: Complexes = np.concatenate([upper, [-1.0] if order % 2 else [], upper.conj()])
    apart = pole[:, None] - pole[None, :]
    np.fill_diagonal(apart, 1.0)
    residue = 1 / apart.prod(axis=1)
    corner = 2 * np.pi * corner_hz
    return AnalogueFilter(pole_per_s=corner * pole, residue=corner * residue, direct=0.0)


def high_pass(corner_hz: float) -> AnalogueFilter:
    """First-order high-pass filter, as AC coupling is: s / (s + corner), −3 dB at its corner.

    ``corner_hz``: > 0. Raises ValueError for another corner.
    """
    if not corner_hz > 0:
        raise ValueError("a high-pass filter has a corner above 0")
    pole = np.array([-2 * np.pi * corner_hz], dtype=np.complex128)
    return AnalogueFilter(pole_per_s=pole, residue=pole, direct=1.0)


def in_series(a: AnalogueFilter, b: AnalogueFilter) -> AnalogueFilter:
    """Filter ``a`` behind filter ``b``, again as poles and residues.

    Raises ValueError where a pole of one is a pole of the other: such a filter has no simple residues.
    """
    apart = np.abs(a.pole_per_s[:, None] - b.pole_per_s[None, :])
    larger = np.maximum(np.abs(a.pole_per_s)[:, None], np.abs(b.pole_per_s)[None, :])
    if np.any(apart < POLES_APART * larger):
        raise ValueError("filters in series may not share a pole")
    pole_per_s = np.concatenate([a.pole_per_s, b.pole_per_s])
    residue = np.concatenate([a.residue * b.at(a.pole_per_s), b.residue * a.at(b.pole_per_s)])
    return AnalogueFilter(pole_per_s=pole_per_s, residue=residue, direct=a.direct * b.direct)


def analogue_filter(acquisition: Acquisition | None) -> AnalogueFilter | None:
    """Filter of an acquisition: low-pass, AC coupling, or one behind the other; None where it has neither.

    ``acquisition``: its ``low_pass_hz``, ``low_pass_order`` and ``ac_coupling_hz`` count.
    Raises RequestError where the AC coupling is not below the low-pass: nothing would pass.
    """
    if acquisition is None:
        return None
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


INT16_BITS = 16
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
    types store their values. NaN stays NaN; infinity is cut off like any other value, or stays where there is no range.

    ``signal``: m/s², shape (channel, n). ``acquisition``: sensitivity, full scale, bits and number type.
    Raises ValueError for NaN that int16 would have to store, for which it has no code.
    """
    sensitivity = acquisition.sensitivity_mv_per_g
    per_m_s2 = 1.0 if sensitivity is None else sensitivity * 1e-3 / STANDARD_GRAVITY_M_S2
    full_scale = math.inf if acquisition.full_scale is None else acquisition.full_scale
    bits = INT16_BITS if acquisition.bits is None and acquisition.stored_as == "int16" else acquisition.bits
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
            if count_value is not None and np.isnan(values).any():
                raise ValueError("int16 has no code for a missing sample")
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
