"""Speeds of an induction motor under several loads that were recorded under one stated speed.

The rotor lags behind its field by a slip that grows with the load, so recordings of one stated speed do not turn alike.
Averaged as if they did, order 1 is smeared over its neighbours and what stands still, such as the mains, is taken for
orders. Each recording tells its own speed by the line of its shaft just below the field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.engine.motor import USUAL_SLIP, Motor
from crankorder.fft.windows import hann
from crankorder.shaft.pulses import FloatArray, Remark

STANDS_OUT = 20.0
"""A line is so many times as high as the middle of the spectrum about it: noise alone reaches 5."""
STRONGEST = 3.0
"""It is so many times as large as any other line between the slowest rotor and the field that is no line of mains."""
MAINS_BINS = 2.5
"""A line within so many bins of a multiple of the supply may be that: it tells no slip."""
LINE_ERROR_BINS = 0.05
"""Error of a line's place in some noise, or beside another line."""
SAME_SIGMAS = 5.0
"""Speeds further apart than so many of their errors are not one speed."""


@dataclass(frozen=True)
class ReadSpeed:
    """Speed in rpm of the crank that a recording's own lines tell, with its standard error."""

    rpm: float
    error_rpm: float


def slip_speed(signals: FloatArray, rate_hz: float, motor: Motor) -> ReadSpeed | None:
    """Speed of the crank by the line of the ``motor``'s shaft just below its field; None where nothing tells it.

    ``signals``: (channels, samples), ``rate_hz`` samples per second. The line must stand out of the noise and above all
    others that may be it in the channel that shows it best; where channels disagree, nothing is told.
    """
    if motor.supply_hz is None or motor.poles is None or signals.shape[1] < 64:
        return None
    bin_hz = rate_hz / signals.shape[1]
    field_hz = motor.synchronous_rpm(motor.supply_hz) / 60.0
    found = [_line_below(row, rate_hz, field_hz, motor.supply_hz) for row in signals]
    hertz = [one for one in found if one is not None]
    if not hertz or max(hertz) - min(hertz) > 2.0 * SAME_SIGMAS * LINE_ERROR_BINS * bin_hz:
        return None
    turn_rpm = 60.0 / motor.shaft_ratio
    return ReadSpeed(float(np.median(hertz)) * turn_rpm, float(LINE_ERROR_BINS * bin_hz * turn_rpm))


def speeds_under_load(
    stated_rpm: Mapping[str, float], read: Mapping[str, ReadSpeed]
) -> tuple[dict[str, float], list[tuple[str, Remark]]]:
    """Speeds in rpm of recordings whose one stated speed cannot be that of them all, and a remark on each.

    ``stated_rpm`` by the name of the recording, ``read`` what :func:`slip_speed` told of those that tell it. Where the
    recordings of one stated speed agree, or one of them tells nothing, the stated speed stays.
    """
    speeds: dict[str, float] = {}
    remarks: list[tuple[str, Remark]] = []
    for stated in sorted(set(stated_rpm.values())):
        names = [name for name, rpm in stated_rpm.items() if rpm == stated]
        told = [read[name] for name in names if name in read]
        if len(told) < len(names) or not _differ(told):
            continue
        for name in names:
            speeds[name] = read[name].rpm
            detail = (
                f"{stated:.5g} rpm is stated for {len(names)} recordings whose lines below the motor's field stand at "
                f"different frequencies: the speed that its own tells, {read[name].rpm:.6g} rpm, is used"
            )
            remarks.append((name, ("speed_read_from_slip", "suspect", detail)))
    return speeds, remarks


def _differ(told: Sequence[ReadSpeed]) -> bool:
    """Whether recordings cannot have turned at one speed."""
    slowest, fastest = (of(told, key=lambda one: one.rpm) for of in (min, max))
    error = float(np.hypot(slowest.error_rpm, fastest.error_rpm)) if told else np.inf
    return fastest.rpm - slowest.rpm > SAME_SIGMAS * error


def _line_below(row: FloatArray, rate_hz: float, field_hz: float, supply_hz: float) -> float | None:
    """Frequency in Hz of the one line of ``row`` (samples,) between the slowest rotor and the field; None: none, or
    several."""
    known = np.where(np.isfinite(row), row, 0.0)
    size = np.abs(np.fft.rfft((known - known.mean()) * hann(known.size).values))
    bin_hz = rate_hz / known.size
    low, high = ((1.0 - USUAL_SLIP) * field_hz / bin_hz, field_hz / bin_hz - 1.0)
    place = np.arange(int(np.ceil(low)), int(high) + 1)
    if place.size < 3 or place[-1] + 2 >= size.size:
        return None
    wide = size[max(place[0] - place.size, 1) : place[-1] + place.size]
    peaks = place[(size[place] >= size[place - 1]) & (size[place] > size[place + 1])]
    peaks = peaks[(size[peaks] > STANDS_OUT * np.median(wide)) & ~_of_mains(peaks, supply_hz / bin_hz)]
    if not peaks.size:
        return None
    best = int(peaks[np.argmax(size[peaks])])
    others = peaks[np.abs(peaks - best) > 2]
    if others.size and size[others].max() * STRONGEST > size[best]:
        return None
    # Grandke (1983), IEEE Transactions on Instrumentation and Measurement 32, p. 350: exact for a tone in a Hann window
    side = 1 if size[best + 1] >= size[best - 1] else -1
    ratio = size[best + side] / size[best]
    return float((best + side * (2.0 * ratio - 1.0) / (ratio + 1.0)) * bin_hz)


def _of_mains(place: NDArray[np.int64], supply: float) -> NDArray[np.bool_]:
    """Which bins ``place`` (n,) are those of a multiple of the ``supply``, in bins."""
    return np.abs(place - np.maximum(np.round(place / supply), 1.0) * supply) <= MAINS_BINS
