"""Each recording of a test in one row: its speed, the error of its angle; and its speed against that of its name."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import PurePath

import numpy as np
import xarray as xr

from crankorder.errors import printable
from crankorder.quantities import Floats
from crankorder.shaft.pulses import Remark

KNOTS = 500
"""Knots of a trace: two pixels each where it is drawn across a page."""

_UNITS = {
    "trace_time": ("s", "middle of the piece of time"),
    "speed_trace": ("min-1", "mean speed in the piece of time"),
    "speed_trace_low": ("min-1", "lowest speed in the piece of time"),
    "speed_trace_high": ("min-1", "highest speed in the piece of time"),
}


def speed_trace(time_s: Floats, speed_rpm: Floats) -> tuple[Floats, ...]:
    """Time, mean, lowest and highest speed of KNOTS equal pieces of time, NaN where a piece holds nothing.

    ``time_s`` ascending and ``speed_rpm``, both (n,). The mean is that over time (trapezes), so that knots that crowd
    in a fast part of a turn count no more than others. Recordings of fewer knots are kept as they are,
    with NaN behind them.
    """
    known = np.isfinite(time_s) & np.isfinite(speed_rpm)
    time, speed = np.asarray(time_s, dtype=float)[known], np.asarray(speed_rpm, dtype=float)[known]
    trace = np.full((4, KNOTS), np.nan)
    if len(time) <= KNOTS:
        trace[:, : len(time)] = time, speed, speed, speed
        return tuple(trace)
    ends = np.linspace(time[0], time[-1], KNOTS + 1)
    turned = np.concatenate([[0.0], np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)])
    trace[0] = (ends[:-1] + ends[1:]) / 2
    trace[1] = np.diff(np.interp(ends, time, turned)) / np.diff(ends)
    first = np.searchsorted(time, ends[:-1])
    held = np.diff(np.append(first, len(time))) > 0
    for row, extreme in ((2, np.minimum), (3, np.maximum)):
        trace[row] = np.where(held, extreme.reduceat(speed, np.minimum(first, len(speed) - 1)), trace[1])
    return tuple(trace)


def trace_variables(shafts: Sequence[xr.Dataset]) -> dict[str, xr.Variable]:
    """Variables (recording, knot) of the group ``shaft`` of the results: the traces of ``shafts``.

    ``trace_time`` [s], ``speed_trace``, ``speed_trace_low`` and ``speed_trace_high`` [rpm]; ``shafts`` are ShaftAngles
    in the order of the recordings.
    """
    traces = np.empty((len(_UNITS), len(shafts), KNOTS), dtype=np.float32)  # of thousands of recordings: held once
    for number, shaft in enumerate(shafts):
        traces[:, number] = speed_trace(shaft["time"].values, shaft["speed"].values)
    return {
        name: xr.Variable(("recording", "knot"), traces[number], {"units": unit, "long_name": text})
        for number, (name, (unit, text)) in enumerate(_UNITS.items())
    }


def shaft_summary(shafts: Sequence[xr.Dataset]) -> xr.Dataset:
    """Speed, pulses used, angle error and speed traces of every recording: one row each, in the order of ``shafts``.

    ``shafts`` are ShaftAngles; ``speed_mean``, ``speed_min``, ``speed_max`` [rpm], ``standard_error`` [rev] and
    ``n_pulses`` are (recording,), the traces of :func:`trace_variables` (recording, knot).
    """
    speeds, errors = ([shaft[name].values for shaft in shafts] for name in ("speed", "standard_error"))
    columns = {
        "speed_mean": (_known(np.mean, speeds), "min-1", "mean speed"),
        "speed_min": (_known(np.min, speeds), "min-1", "lowest speed"),
        "speed_max": (_known(np.max, speeds), "min-1", "highest speed"),
        "standard_error": (_known(np.mean, errors), "rev", "mean standard error of the crank angle"),
        "n_pulses": ([float(shaft.attrs["n_pulses"]) for shaft in shafts], "1", "encoder pulses used"),
    }
    variables = {
        name: xr.Variable("recording", values, {"units": unit, "long_name": text})
        for name, (values, unit, text) in columns.items()
    }
    names = [printable(shaft.attrs["recording"]) for shaft in shafts]
    named = {"recording": xr.Variable("recording", names, {"units": "1", "long_name": "file name"})}
    return xr.Dataset(variables | trace_variables(shafts), coords=named)


def _known(statistic: Callable[[Floats], float], recordings: list[Floats]) -> list[float]:
    """The ``statistic`` of those values of each of ``recordings`` that are numbers; NaN where none is."""
    known = [values[~np.isnan(values)] for values in recordings]
    return [float(statistic(values)) if values.size else np.nan for values in known]


_SPEED_IN_NAME = (
    re.compile(r"(?<![0-9.])(\d{2,6}(?:[.,]\d+)?)[ _-]?(?:rpm|u_?min|upm|min-?1|r_?min)", re.I),
    re.compile(r"(?:rpm|speed|drehzahl|(?<![a-z])n)[ _=-]?(\d{2,6}(?:\.\d+)?)(?![0-9])", re.I),
)
# A run-up from one speed to another.
_SPEED_RANGE = re.compile(r"(?<!\d)\d{3,5} ?(?:-|_?to_?|\.\.+) ?\d{3,5}[ _-]?(?:rpm|u_?min|upm|min-?1|r_?min)", re.I)
# Words that make a number a speed; "n12" may be the twelfth measurement.
_SPEED_WORD = re.compile(r"rpm|min|upm|speed|drehzahl", re.I)
# Names state nominal speeds, and a motor's slip or a governor's droop lies within this share of them.
_NOMINAL_SHARE = 0.2
# Share of the knots at either end of the speeds that may be those of a start or of noise.
_ENDS = 0.02


def speed_in_name(name: str) -> float | None:
    """Speed in rpm that the ``name`` of a file states, such as 800 in "800rpm" or "idle_n800"; None where none."""
    for sign in () if _SPEED_RANGE.search(name) else _SPEED_IN_NAME:
        match = sign.search(name)
        if match and float(match[1].replace(",", ".")) > 0:
            return float(match[1].replace(",", "."))
    return None


def named_speed_remarks(shaft: xr.Dataset) -> list[Remark]:
    """Remark where the name of the recording of the ShaftAngle ``shaft`` states a speed far from all that it shows."""
    named = speed_in_name(PurePath(str(shaft.attrs["recording"])).stem)
    speed = shaft["speed"].values[np.isfinite(shaft["speed"].values)]
    if named is None or not _SPEED_WORD.search(str(shaft.attrs["recording"])) or not speed.size:
        return []
    low, high = (float(value) for value in np.quantile(speed, (_ENDS, 1.0 - _ENDS)))
    if low * (1.0 - _NOMINAL_SHARE) <= named <= high * (1.0 + _NOMINAL_SHARE):
        return []
    seen = f"{low:.4g} rpm is" if high - low < 0.01 * high else f"{low:.4g} to {high:.4g} rpm are"
    detail = f"the name states {named:g} rpm, {seen} found: look at [encoder], its source, pulses_per_rev and ratio"
    return [("speed_not_as_named", "suspect", detail)]
