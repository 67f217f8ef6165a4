"""Arrays of a notebook as the columns of a file, and what their caller says of them as the tables of a manifest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from crankorder.errors import RequestError
from crankorder.ingest.sampling import read_time_column
from crankorder.settings import IngestSettings

CALL = "crankorder.recording"
"""What errors call the arguments of a recording."""

INSIDE = 0.5
"""Share of the pulses, at least, that lies within the recording: others are counted in another unit."""

Signals = ArrayLike | Mapping[str, ArrayLike] | Sequence[Mapping[str, Any]]

DEFAULT_UNIT = "m/s2"
"""Unit of channels of which nobody says another."""


def columns_of(signals: Signals) -> dict[str, NDArray[Any]]:
    """Copies (samples,) of the channels of ``signals`` by name: later repairs do not touch the caller's arrays.

    ``signals`` is a mapping or table (DataFrame) of channels by name; an xarray DataArray (channel, any) or of one
    dimension; time series of SDyPy (SEP 5); or an array (samples,) or (channels, samples). Raises RequestError where it
    is none of these.
    """
    if is_timeseries(signals):
        return _by_name((series["name"], series["data"]) for series in signals)
    if isinstance(signals, xr.DataArray) and signals.ndim == 1:
        return _by_name([(signals.name or "signal", signals.values)])
    if isinstance(signals, xr.DataArray):
        if "channel" not in signals.dims or signals.ndim != 2:
            allowed = "one dimension, or two with one that is called channel"
            raise RequestError("the signals have the wrong dimensions", file=CALL, found=signals.dims, allowed=allowed)
        rows = signals.transpose("channel", ...)
        return _by_name(zip(rows["channel"].values, rows.values, strict=True))
    if hasattr(signals, "items") and hasattr(signals, "keys") and not hasattr(signals, "to_frame"):
        return _by_name(signals.items())
    allowed = "(samples,) or (channels, samples)"
    try:
        table = np.atleast_2d(signals if isinstance(signals, np.ma.MaskedArray) else np.asarray(signals))
    except ValueError as error:
        raise RequestError("the channels differ in length", file=CALL, found=error, allowed=allowed) from None
    if table.ndim != 2:
        raise RequestError("the signals have the wrong shape", file=CALL, found=table.shape, allowed=allowed)
    if len(table) > table.shape[1]:
        remedy = "Give signals.T where each column is a channel"
        raise RequestError("more channels than samples", file=CALL, found=table.shape, allowed=allowed, remedy=remedy)
    return _by_name((f"signal {place + 1}" if len(table) > 1 else "signal", row) for place, row in enumerate(table))


def _by_name(named: Iterable[tuple[object, ArrayLike]]) -> dict[str, NDArray[Any]]:
    """Copies of the rows by their names, which must differ, of ``named`` (name, row)."""
    rows = [(str(name), row) for name, row in named]
    if not rows:
        raise RequestError("no channel is given", file=CALL, place="signals")
    names = [name for name, _ in rows]
    if len(set(names)) < len(names):
        raise RequestError("two channels have one name", file=CALL, place="signals", found=", ".join(names))
    return {name: column(row, name) for name, row in rows}


def is_timeseries(signals: Any) -> TypeGuard[Sequence[Mapping[str, Any]]]:
    """Whether ``signals`` are time series as SDyPy exchanges them: dicts with ``data``, ``name``, ``unit_str``.

    Source: SDyPy Enhancement Proposal 5.
    """
    return (
        isinstance(signals, list | tuple)
        and bool(signals)
        and all(isinstance(one, Mapping) and {"data", "name", "unit_str"} <= set(one) for one in signals)
    )


def told_by_timeseries(
    signals: Signals, rate_hz: float | None, unit: str | Mapping[str, str], *, settings: IngestSettings
) -> tuple[float | None, str | Mapping[str, str]]:
    """Sampling rate [Hz] and units of ``signals`` that are time series of SDyPy; for others those of the caller.

    A ``unit`` of the caller replaces ``unit_str``; ``settings`` say how even times must be. Raises RequestError where
    no rate is stated, or where the rates of two series, or of one and ``rate_hz``, differ; InputError where times are
    uneven.
    """
    if not is_timeseries(signals):
        return rate_hz, unit
    rates = {} if rate_hz is None else {"rate_hz": number(rate_hz, "rate_hz")}
    for series in signals:
        name = str(series["name"])
        if series.get("fs") is not None:
            rates[f"fs of {name}"] = number(series["fs"], f"fs of {name}")
        if series.get("time") is not None:
            times = read_time_column(column(series["time"], f"time of {name}"), Path(CALL), settings=settings)
            rates[f"time of {name}"] = times.rate_hz
    if not rates:
        raise RequestError("state fs, or time", file=CALL, place="signals")
    origin, first = next(iter(rates.items()))
    for other, rate in rates.items():
        if abs(rate - first) > settings.rate_tolerance * first:
            raise RequestError(f"{origin} is {first:.12g} Hz, {other} says {rate:.12g} Hz", file=CALL, place="signals")
    if unit != DEFAULT_UNIT:
        return first, unit
    return first, {str(series["name"]): str(series["unit_str"]).strip() or DEFAULT_UNIT for series in signals}


def column(values: ArrayLike, name: str) -> NDArray[Any]:
    """A copy (samples,), float32 or float64, of ``values`` (samples,), called ``name``; masked values become NaN.

    Raises RequestError where ``values`` are not real numbers along one axis.
    """
    given: Any = values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    if given.ndim != 1 or given.dtype.kind not in "fiub":
        found = f"{given.dtype} of shape {given.shape}"
        raise RequestError("must be real numbers, one for each sample", file=CALL, place=name, found=found)
    dtype = np.float32 if given.dtype in (np.float32, np.float16) else np.float64
    return np.asarray(np.ma.filled(given.astype(dtype), np.nan))


def units_of(unit: str | Mapping[str, str], names: list[str]) -> dict[str, str]:
    """Unit of each of the channels ``names``: ``unit`` is that of all, or holds one by name.

    Raises RequestError where ``unit`` is neither, or where its names are not exactly ``names``.
    """
    if isinstance(unit, str):
        return dict.fromkeys(names, unit)
    if not isinstance(unit, Mapping):
        raise RequestError("must be a unit, or units by channel", file=CALL, place="unit", found=repr(unit))
    if set(unit) != set(names):
        found, allowed = ", ".join(map(str, unit)), ", ".join(names)
        problem = "each channel has a unit, and nothing else"
        raise RequestError(problem, file=CALL, place="unit", found=found, allowed=allowed)
    return {name: str(unit[name]) for name in names}


def number(value: Any, name: str) -> float:
    """``value`` of the argument ``name`` as a finite number; raises RequestError where it is none."""
    with suppress(TypeError, ValueError):
        if not isinstance(value, str) and np.isfinite(float(value)):
            return float(value)
    raise RequestError("must be a finite number", file=CALL, place=name, found=repr(value))


def count(value: Any, name: str) -> int:
    """``value`` of the argument ``name`` as an integer, of whatever type; raises RequestError where it is not whole."""
    whole = number(value, name)
    if whole != round(whole):
        raise RequestError("must be a whole number", file=CALL, place=name, found=repr(value))
    return round(whole)


def shaft_of(
    told: Mapping[str, Any], *, by_angle: bool, without: bool
) -> tuple[dict[str, str | float], dict[str, NDArray[Any]]]:
    """The manifest's ``[encoder]`` table and its columns (samples or pulses,) by role, of the argument that was given.

    ``told`` are the arguments by name, None where not given: pulse times [s], encoder trace, speed [rpm]. None of them
    is needed for samples ``by_angle``, nor ``without`` a shaft. Raises RequestError where more than one is given, none
    is but one is needed, or one is not numbers.
    """
    given = [key for key, value in told.items() if value is not None]
    if len(given) > 1:
        problem = "the shaft is told in more than one way"
        raise RequestError(problem, file=CALL, found=", ".join(given), allowed=f"one of {', '.join(told)}")
    if not given:
        if not by_angle and not without:
            remedy = 'State cycle="none" where nothing turns, or where frequencies are enough'
            raise RequestError(f"state one of {', '.join(told)}", file=CALL, remedy=remedy)
        return {"kind": "none"}, {}
    if given[0] == "speed_rpm" and np.ndim(told["speed_rpm"]) == 0:
        return {"kind": "constant", "speed_rpm": number(told["speed_rpm"], "speed_rpm")}, {}
    kind = {"pulse_times_s": "pulse_times", "encoder": "square", "speed_rpm": "speed"}[given[0]]
    return {"kind": kind}, {"source": column(told[given[0]], given[0])}


def check_times(times_s: NDArray[Any], start_s: float, seconds: float) -> None:
    """Refuse pulse times in another unit than seconds: most of these lie outside the recording.

    Raises RequestError where fewer than half of ``times_s`` (pulses,) [s] lie within the ``seconds`` of the recording,
    whose first sample is at ``start_s`` on the same clock.
    """
    inside = (times_s >= start_s) & (times_s <= start_s + seconds)
    if times_s.size and np.isfinite(times_s).all() and float(inside.mean()) < INSIDE:
        problem, place = "most pulses lie outside the recording", "pulse_times_s"
        found = f"{times_s.min():.6g} to {times_s.max():.6g} s"
        allowed = f"{start_s:.6g} to {start_s + seconds:.6g} s"
        remedy = "Give their times in seconds, on the clock of the samples (start_s)"
        raise RequestError(problem, file=CALL, place=place, found=found, allowed=allowed, remedy=remedy)
