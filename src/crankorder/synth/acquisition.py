"""What a data-acquisition system makes of a signal: its clock, its converter and its number type."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.settings import STANDARD_GRAVITY_M_S2
from crankorder.synth.effects import Acquisition

INT16_BITS = 16


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
    clipped_share: NDArray[np.float64]


def true_rate_hz(acquisition: Acquisition, rate_hz: float) -> float:
    """Samples per true second of a clock that runs faster than its label by ``clock_error_ppm`` of ``acquisition``.

    ``rate_hz``: what the label says, > 0.
    """
    return rate_hz * (1 + acquisition.clock_error_ppm * 1e-6)


def recorded(
    signal: NDArray[np.float64], acquisition: Acquisition, *, stand_ins: Sequence[tuple[int, slice, float]] = ()
) -> Recorded:
    """``signal`` in the unit of the file, cut off at full scale, in steps of the converter, in the number type stored.

    The converter is mid-tread: codes −2^(bits − 1) … 2^(bits − 1) − 1 of full_scale / 2^(bits − 1) each, so that 0 is a
    code and full scale itself is one step out of reach. int16 stores the codes (16 bits where none are stated); float
    types store their values. NaN stays NaN; infinity is cut off like any other value, or stays where there is no range.

    ``signal``: m/s², shape (channel, n). ``acquisition``: sensitivity, full scale, bits and number type.
    ``stand_ins``: channel, samples, and the number in the unit of the file that a logger writes for those of the
    samples that are NaN; int16 holds the nearest that it can.
    Raises ValueError for NaN that int16 would have to store, for which it has no code.
    """
    sensitivity = acquisition.sensitivity_mv_per_g
    per_m_s2 = 1.0 if sensitivity is None else sensitivity * 1e-3 / STANDARD_GRAVITY_M_S2
    full_scale = math.inf if acquisition.full_scale is None else acquisition.full_scale
    bits = INT16_BITS if acquisition.bits is None and acquisition.stored_as == "int16" else acquisition.bits
    step = None if bits is None else full_scale / 2 ** (bits - 1)
    count_value = step if acquisition.stored_as == "int16" else None
    samples = np.empty(signal.shape, dtype=acquisition.stored_as)
    clipped_share = np.zeros(len(signal))
    for channel, row in enumerate(signal):
        values = np.multiply(row, per_m_s2, dtype=np.float64)
        clipped_share[channel] = _convert(values, full_scale, step) / max(1, values.size)
        if step is not None and count_value is None:
            values *= step
        for part, number in ((part, number) for where, part, number in stand_ins if where == channel):
            written = number if count_value is None else _nearest_int16(number / count_value)
            values[part][np.isnan(values[part])] = written
        if count_value is not None and np.isnan(values).any():
            raise ValueError("int16 has no code for a missing sample")
        samples[channel] = values
    return Recorded(
        samples=samples,
        scale=count_value,
        unit="m/s2" if sensitivity is None else "V",
        clipped_share=clipped_share,
    )


def _convert(values: NDArray[np.float64], full_scale: float, step: float | None) -> int:
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


def _nearest_int16(value: float) -> float:
    return float(round(min(max(value, -(2.0**15)), 2.0**15 - 1)))
