"""Named orders of one recording, fitted jointly by least squares over frames of whole cycles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import InputError, RequestError
from crankorder.orders.intervals import amplitude_interval, phase_interval_deg
from crankorder.orders.least_squares import JointOrders, joint_orders
from crankorder.quantities import QualityFlag, channel_coords, flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import angle_at, knots_of, time_at
from crankorder.shaft.smoothed_speed import speed_at_angle

Spans = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Crank angles [rev] at which frames begin and end."""


def tracked_orders(
    band: xr.Dataset, shaft: xr.Dataset, orders: Sequence[float], *, settings: OrderSettings
) -> xr.Dataset:
    """Complex amplitude (channel, order, frame) of named orders of a recording, with 95 % intervals.

    Frames take in all whole cycles that were recorded, so that nothing is lost; where the speed changes they overlap as
    those of the order map do. The noise beside each order gives the standard error. Orders that cannot be told apart
    are NaN, and the sum of the group stands in ``combined_amplitude``; orders beyond half the sample rate are NaN too.

    Parameters
    ----------
    band : BandRecording, by time or by crank angle; samples that its ``usable`` denies take no part
    shaft : its ShaftAngle
    orders : cycles per crank revolution, above 0; give close ones together
    settings : ``revs_per_frame`` is the least length of a frame, rounded down to whole cycles; ``overlap``

    Raises
    ------
    RequestError for no order or one not above 0; InputError where not even one cycle was recorded.
    """
    named = np.asarray(orders, dtype=np.float64)
    if named.size == 0 or not (named > 0.0).all():
        raise RequestError("orders to track must be above 0", found=str(list(orders)), allowed="one or more")
    angles = _angle_of_samples(band, shaft)
    spans = frame_spans(angles, band, shaft, settings)
    known = np.flatnonzero(np.isfinite(angles))
    part = slice(int(known[0]), int(known[-1]) + 1)
    fits = [_fit(band, angles, part, named, begin, end) for begin, end in zip(*spans, strict=True)]
    return _dataset(band, shaft, named, spans, fits)


def frame_spans(angle_rev: NDArray[np.float64], band: xr.Dataset, shaft: xr.Dataset, settings: OrderSettings) -> Spans:
    """Frames of whole cycles, of ``settings.revs_per_frame`` or a little more each: where they begin and end [rev].

    They take in all whole cycles of ``angle_rev`` (samples,), that of the samples of ``band`` by its ``shaft``. Where
    the speed changes by more than ``settings.speed_bin_rpm`` they overlap by about ``settings.overlap``, so that as
    many speeds are read as by the order map. Raises InputError where there is not even one cycle.
    """
    cycle = int(shaft.attrs["revs_per_cycle"])
    known = angle_rev[np.isfinite(angle_rev)]
    first = known[0] if known.size else 0.0
    cycles = math.floor((known[-1] - first + 1e-9) / cycle) if known.size else 0
    if cycles < 1:
        raise InputError(
            "the recording holds less than one engine cycle", file=band.attrs["recording"], allowed=f"at least {cycle}"
        )
    count = max(1, cycles // max(1, settings.revs_per_frame // cycle))
    edges = np.asarray(first + cycle * np.round(np.linspace(0, cycles, count + 1)), dtype=np.float64)
    speed = _speed_and_time(shaft, (edges[:-1], edges[1:]))[0]
    if not np.ptp(speed) > settings.speed_bin_rpm:  # nor where it is not known
        return edges[:-1], edges[1:]
    parts = max(1, min(cycles // count, round(1.0 / (1.0 - settings.overlap))))
    edges = np.asarray(first + cycle * np.round(np.linspace(0, cycles, count * parts + 1)), dtype=np.float64)
    return edges[:-parts], edges[parts:]


def _angle_of_samples(band: xr.Dataset, shaft: xr.Dataset) -> NDArray[np.float64]:
    """Crank angle [rev] of every sample, NaN where it is not known."""
    n = band["signal"].shape[1]
    if band.attrs["domain"] == "crank_angle":
        return np.asarray(float(shaft["crank_angle"].values[0]) + np.arange(n) / float(band.attrs["samples_per_rev"]))
    time_s = float(band.attrs.get("start_s", 0.0)) + np.arange(n) / float(band.attrs["rate_hz"])
    return angle_at(time_s, **knots_of(shaft))


def _fit(
    band: xr.Dataset,
    angles: NDArray[np.float64],
    part: slice,
    orders: NDArray[np.float64],
    begin: float,
    end: float,
) -> tuple[NDArray[np.int64], list[JointOrders | None]]:
    """Numbers of the orders carried in the frame from ``begin`` to ``end`` [rev], and the fit of each channel.

    ``part`` are the samples whose angle is known. The fit is None where too little is usable. Every sample weighs as
    much crank angle as it stands for, cut off at the ends of the frame: whole cycles then hold nothing of the orders
    that are not named.
    """
    first, last = part.start + np.searchsorted(angles[part], (begin - 0.01, end + 0.01))
    inside = slice(int(first), int(last))
    step = np.gradient(angles[inside])
    low = np.clip(angles[inside] - 0.5 * step, begin, end)
    weight = np.clip(angles[inside] + 0.5 * step, begin, end) - low
    weight /= weight.max()
    signals = band["signal"].values[:, inside]
    highest = 0.5 / float(np.median(step))
    carried = np.flatnonzero(orders < highest)
    if not len(carried):
        return carried, [None] * band.sizes["channel"]
    phases = np.outer(orders[carried], angles[inside] - begin)
    usable = np.isfinite(signals)
    if "usable" in band:
        usable &= band["usable"].values[:, inside]
    if usable.all():
        whole = joint_orders(signals, phases, weights=weight)
        return carried, [_channel(whole, k) for k in range(len(signals))]
    fits: list[JointOrders | None] = []
    for values, mask in zip(signals, usable, strict=True):
        enough = mask.mean() > 0.5
        given = np.where(mask, values, 0.0)[None]
        fits.append(joint_orders(given, phases, weights=weight, usable=mask[None]) if enough else None)
    return carried, fits


def _channel(whole: JointOrders, k: int) -> JointOrders:
    one = slice(k, k + 1)
    return JointOrders(
        whole.amplitude[one],
        whole.combined_amplitude[one],
        whole.coefficients[one],
        whole.standard_error[one],
        whole.degrees_of_freedom,
        whole.covariance,
        whole.condition,
        whole.together,
        whole.method,
        whole.residual_rms[one],
    )


def _dataset(
    band: xr.Dataset,
    shaft: xr.Dataset,
    orders: NDArray[np.float64],
    spans: Spans,
    fits: list[tuple[NDArray[np.int64], list[JointOrders | None]]],
) -> xr.Dataset:
    shape = (band.sizes["channel"], len(orders), len(fits))
    amplitude, combined = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan, dtype=complex)
    error, dof = np.full(shape, np.nan), np.zeros(shape)
    condition = np.full((shape[0], shape[2]), np.nan)
    groups: set[tuple[float, ...]] = set()
    for frame, (carried, channels) in enumerate(fits):
        # phases count from angle 0, not the frame's begin
        turned = np.exp(-2j * np.pi * (orders[carried] * spans[0][frame] % 1.0))
        for k, fit in enumerate(channels):
            if fit is None:
                continue
            amplitude[k, carried, frame] = fit.amplitude[0] * turned
            combined[k, carried, frame] = fit.combined_amplitude[0] * turned
            error[k, carried, frame], dof[k, carried, frame] = fit.standard_error[0], fit.degrees_of_freedom
            condition[k, frame] = fit.condition
            groups |= {tuple(float(orders[carried[c]]) for c in group) for group in fit.together}
    values = {
        "amplitude": amplitude,
        "combined_amplitude": combined,
        "standard_error": error,
        "degrees_of_freedom": dof,
    }
    made = tracks_in_frames(band, shaft, orders, spans, values, method="least_squares")
    made["condition"] = (("channel", "frame"), condition, {"units": "1", "long_name": "condition of the equations"})
    seen = {int(k) for carried, _ in fits for k in carried}
    beyond = [float(order) for k, order in enumerate(orders) if k not in seen]
    remarks = _remarks(beyond, float(np.min(spans[1] - spans[0])), groups)
    return with_flags(made, flags_of(shaft) + not_tracked_flags(str(band.attrs["recording"]), remarks))


def not_tracked_flags(recording: str, remarks: Sequence[str]) -> list[QualityFlag]:
    """Flags that say of orders of ``recording`` why they were not tracked, one for each of ``remarks``."""
    return [
        {"recording": recording, "flag": "order_not_tracked", "severity": "suspect", "detail": text} for text in remarks
    ]


def beyond_remark(order: float) -> str:
    """What is said of an ``order`` that no frame carries."""
    return f"order {order:g} is beyond half the sample rate"


def _remarks(beyond: list[float], shortest_rev: float, groups: set[tuple[float, ...]]) -> list[str]:
    """What is to be said of ``groups`` that cannot be told apart and of orders ``beyond`` what frames carry."""
    remarks = [
        f"orders {' and '.join(f'{order:g}' for order in group)} cannot be told apart in frames of "
        f"{shortest_rev:g} revolutions: only their sum is known"
        for group in sorted(groups)
    ]
    return remarks + [beyond_remark(order) for order in beyond]


_VARIABLES = (
    ("amplitude", "see unit", "complex peak amplitude about top dead centre"),
    ("combined_amplitude", "see unit", "sum of the orders that cannot be told apart"),
    ("standard_error", "see unit", "standard error of the magnitude of amplitude"),
    ("degrees_of_freedom", "1", "degrees of freedom of standard_error"),
    ("amplitude_low", "see unit", "lower end of the 95 % interval of the magnitude"),
    ("amplitude_high", "see unit", "upper end of the 95 % interval of the magnitude"),
    ("phase_ci95", "degree", "half width of the 95 % interval of the phase; 180: unknown"),
)


def tracks_in_frames(
    band: xr.Dataset,
    shaft: xr.Dataset,
    orders: NDArray[np.float64],
    spans: Spans,
    values: dict[str, NDArray[Any]],
    *,
    method: str,
) -> xr.Dataset:
    """Tracks of ``orders`` in frames of ``spans`` (begin and end, rev), with the 95 % intervals of ``values``.

    ``values`` (channel, order, frame) hold amplitude, standard_error and degrees_of_freedom at least, found by
    ``method`` in the BandRecording ``band`` with its ShaftAngle ``shaft``.
    """
    begin, end = spans
    made = xr.Dataset(coords={**channel_coords(band), "order": ("order", orders, {"units": "1", "long_name": "order"})})
    speed, time_s = _speed_and_time(shaft, spans)
    made.coords["speed"] = ("frame", speed, {"units": "min-1", "long_name": "speed in the middle of the frame"})
    made.coords["crank_angle"] = ("frame", begin, {"units": "rev", "long_name": "crank angle at the start"})
    made.coords["revs"] = ("frame", np.round(end - begin), {"units": "rev", "long_name": "length of the frame"})
    made.coords["time"] = ("frame", time_s, {"units": "s", "long_name": "time at the start of the frame"})
    made.attrs = {"recording": band.attrs["recording"], "amplitude_scaling": "peak", "track_method": method}
    made.attrs |= {key: shaft.attrs[key] for key in ("phase_reference", "cycle_known", "revs_per_cycle")}
    put_track_values(made, values)
    return made


def put_track_values(made: xr.Dataset, values: dict[str, NDArray[Any]]) -> None:
    """Put ``values`` (channel, order, frame), as of :func:`tracks_in_frames`, and their intervals into ``made``."""
    magnitude, power = np.abs(values["amplitude"]), 2.0 * values["standard_error"] ** 2
    low, high = amplitude_interval(magnitude, power, values["degrees_of_freedom"])
    half = phase_interval_deg(magnitude, power, values["degrees_of_freedom"])
    given = {**values, "amplitude_low": low, "amplitude_high": high, "phase_ci95": half}
    for name, units, said in _VARIABLES:
        if name in given:
            made[name] = (("channel", "order", "frame"), given[name], {"units": units, "long_name": said})


def _speed_and_time(shaft: xr.Dataset, spans: Spans) -> Spans:
    """Speed in the middle [rpm] and first time [s] of the frames of ``spans`` by ``shaft``."""
    begin, end = spans
    if shaft.attrs.get("domain", "time") == "crank_angle":
        return np.full(len(begin), float(shaft["speed"].values.mean())), np.full(len(begin), np.nan)
    return speed_at_angle(shaft, 0.5 * (begin + end), end - begin), time_at(begin, **knots_of(shaft))
