"""Named orders of one recording, fitted jointly by least squares over frames of whole cycles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import InputError, RequestError
from crankorder.orders.intervals import amplitude_interval, phase_interval_deg
from crankorder.orders.least_squares import JointOrders, joint_orders
from crankorder.quantities import channel_coords, flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import angle_at, knots_of, time_at


def tracked_orders(
    band: xr.Dataset, shaft: xr.Dataset, orders: Sequence[float], *, settings: OrderSettings
) -> xr.Dataset:
    """Complex amplitude (channel, order, frame) of named orders of a recording, with 95 % intervals.

    Frames follow one another without overlap and take in all whole cycles that were recorded, so that nothing is
    lost; the noise beside each order gives the standard error. Orders that cannot be told apart are NaN, and the sum
    of the group stands in ``combined_amplitude``; orders beyond half the sample rate are NaN too.

    Parameters
    ----------
    band : BandRecording, by time or by crank angle; samples that its ``usable`` denies take no part
    shaft : its ShaftAngle
    orders : cycles per crank revolution, above 0; give close ones together
    settings : ``revs_per_frame`` is the least length of a frame, rounded down to whole cycles

    Raises
    ------
    RequestError for no order or one not above 0; InputError where not even one cycle was recorded.
    """
    named = np.asarray(orders, dtype=np.float64)
    if named.size == 0 or not (named > 0.0).all():
        raise RequestError("orders to track must be above 0", found=str(list(orders)), allowed="one or more")
    angles = _angle_of_samples(band, shaft)
    edges = frame_edges(angles, band, shaft, settings)
    fits = [_fit(band, angles, named, begin, end) for begin, end in itertools.pairwise(edges)]
    return _dataset(band, shaft, named, edges, fits)


def frame_edges(
    angle_rev: NDArray[np.float64], band: xr.Dataset, shaft: xr.Dataset, settings: OrderSettings
) -> NDArray[np.float64]:
    """Crank angles [rev] between frames of whole cycles, of ``settings.revs_per_frame`` or a little more each.

    They take in all whole cycles of ``angle_rev`` (samples,), that of the samples of ``band`` by its ``shaft``. Raises
    InputError where there is not even one.
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
    return np.asarray(first + cycle * np.round(np.linspace(0, cycles, count + 1)), dtype=np.float64)


def _angle_of_samples(band: xr.Dataset, shaft: xr.Dataset) -> NDArray[np.float64]:
    """Crank angle [rev] of every sample, NaN where it is not known."""
    n = band["signal"].shape[1]
    if band.attrs["domain"] == "crank_angle":
        return np.asarray(float(shaft["crank_angle"].values[0]) + np.arange(n) / float(band.attrs["samples_per_rev"]))
    time_s = float(band.attrs.get("start_s", 0.0)) + np.arange(n) / float(band.attrs["rate_hz"])
    return angle_at(time_s, **knots_of(shaft))


def _fit(
    band: xr.Dataset, angles: NDArray[np.float64], orders: NDArray[np.float64], begin: float, end: float
) -> list[JointOrders | None]:
    """Fit of each channel in the frame from ``begin`` to ``end`` [rev]; None where too little is usable.

    Every sample weighs as much crank angle as it stands for, cut off at the ends of the frame: whole cycles then hold
    nothing of the orders that are not named.
    """
    inside = np.flatnonzero((angles >= begin - 0.01) & (angles <= end + 0.01))
    step = np.gradient(angles[inside])
    low = np.clip(angles[inside] - 0.5 * step, begin, end)
    weight = np.clip(angles[inside] + 0.5 * step, begin, end) - low
    weight /= weight.max()
    signals = band["signal"].values[:, inside]
    highest = 0.5 / float(np.median(step))
    carried = orders < highest
    phases = np.outer(orders[carried], angles[inside] - begin)
    usable = np.isfinite(signals)
    if "usable" in band:
        usable &= band["usable"].values[:, inside]
    if usable.all():
        whole = joint_orders(signals, phases, weights=weight)
        return [_channel(whole, k) for k in range(len(signals))]
    fits: list[JointOrders | None] = []
    for values, mask in zip(signals, usable, strict=True):
        enough = mask.mean() > 0.5
        given = np.where(mask, values, 0.0)[None]
        fits.append(joint_orders(given, phases, weights=weight, usable=mask[None]) if enough else None)
    return fits


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
    edges: NDArray[np.float64],
    fits: list[list[JointOrders | None]],
) -> xr.Dataset:
    shape = (band.sizes["channel"], len(orders), len(fits))
    amplitude, combined = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan, dtype=complex)
    error, dof = np.full(shape, np.nan), np.zeros(shape)
    condition = np.full((shape[0], shape[2]), np.nan)
    groups: set[tuple[float, ...]] = set()
    for frame, channels in enumerate(fits):
        turned = np.exp(-2j * np.pi * orders * edges[frame])  # phases count from angle 0, not the frame's begin
        for k, fit in enumerate(channels):
            if fit is None:
                continue
            n = fit.amplitude.shape[1]
            amplitude[k, :n, frame] = fit.amplitude[0] * turned[:n]
            combined[k, :n, frame] = fit.combined_amplitude[0] * turned[:n]
            error[k, :n, frame], dof[k, :n, frame] = fit.standard_error[0], fit.degrees_of_freedom
            condition[k, frame] = fit.condition
            groups |= {tuple(float(orders[c]) for c in group) for group in fit.together}
    values = {
        "amplitude": amplitude,
        "combined_amplitude": combined,
        "standard_error": error,
        "degrees_of_freedom": dof,
    }
    made = tracks_in_frames(band, shaft, orders, edges, values, method="least_squares")
    made["condition"] = (("channel", "frame"), condition, {"units": "1", "long_name": "condition of the equations"})
    remarks = _remarks(orders, edges, groups, combined)
    name = str(band.attrs["recording"])
    return with_flags(
        made,
        flags_of(shaft)
        + [{"recording": name, "flag": "order_not_tracked", "severity": "suspect", "detail": text} for text in remarks],
    )


def _remarks(
    orders: NDArray[np.float64],
    edges: NDArray[np.float64],
    groups: set[tuple[float, ...]],
    combined: NDArray[np.complex128],
) -> list[str]:
    """What is to be said of ``groups`` that cannot be told apart and of orders that no frame carries."""
    remarks = [
        f"orders {' and '.join(f'{order:g}' for order in group)} cannot be told apart in frames of "
        f"{np.diff(edges).min():g} revolutions: only their sum is known"
        for group in sorted(groups)
    ]
    beyond = [order for k, order in enumerate(orders) if np.isnan(combined[:, k].real).all()]
    return remarks + [f"order {order:g} is beyond half the sample rate" for order in beyond]


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
    edges: NDArray[np.float64],
    values: dict[str, NDArray[Any]],
    *,
    method: str,
) -> xr.Dataset:
    """Tracks of ``orders`` in frames between the crank angles ``edges`` [rev], with the 95 % intervals of ``values``.

    ``values`` (channel, order, frame) hold amplitude, standard_error and degrees_of_freedom at least, found by
    ``method`` in the BandRecording ``band`` with its ShaftAngle ``shaft``.
    """
    made = xr.Dataset(coords={**channel_coords(band), "order": ("order", orders, {"units": "1", "long_name": "order"})})
    speed, time_s = _speed_and_time(shaft, edges)
    made.coords["speed"] = ("frame", speed, {"units": "min-1", "long_name": "mean speed of the frame"})
    made.coords["crank_angle"] = ("frame", edges[:-1], {"units": "rev", "long_name": "crank angle at the start"})
    made.coords["revs"] = ("frame", np.round(np.diff(edges)), {"units": "rev", "long_name": "length of the frame"})
    made.coords["time"] = ("frame", time_s, {"units": "s", "long_name": "time at the start of the frame"})
    made.attrs = {"recording": band.attrs["recording"], "amplitude_scaling": "peak", "track_method": method}
    made.attrs |= {key: shaft.attrs[key] for key in ("phase_reference", "cycle_known", "revs_per_cycle")}
    magnitude, power = np.abs(values["amplitude"]), 2.0 * values["standard_error"] ** 2
    low, high = amplitude_interval(magnitude, power, values["degrees_of_freedom"])
    half = phase_interval_deg(magnitude, power, values["degrees_of_freedom"])
    given = {**values, "amplitude_low": low, "amplitude_high": high, "phase_ci95": half}
    for name, units, said in _VARIABLES:
        if name in given:
            made[name] = (("channel", "order", "frame"), given[name], {"units": units, "long_name": said})
    return made


def _speed_and_time(shaft: xr.Dataset, edges: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean speed [rpm] and first time [s] of the frames of ``shaft`` between ``edges`` [rev]."""
    if shaft.attrs.get("domain", "time") == "crank_angle":
        n = len(edges) - 1
        return np.full(n, float(shaft["speed"].values.mean())), np.full(n, np.nan)
    time_s = time_at(edges, **knots_of(shaft))
    return 60.0 * np.diff(edges) / np.diff(time_s), time_s[:-1]
