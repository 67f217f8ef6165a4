"""Orders asked for by name, followed through each recording by a method of their own, and joined by speed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import InputError
from crankorder.orders.intervals import amplitude_interval, phase_interval_deg
from crankorder.orders.least_squares_tracks import frame_edges, tracked_orders, tracks_in_frames
from crankorder.orders.vold_kalman.filter import vold_kalman
from crankorder.quantities import flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import angle_at, knots_of

ENDLESS_DOF = 1000.0
"""Degrees of freedom from which on Student's t is a normal distribution."""


def followed_tracks(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """Complex amplitudes (channel, order, frame) of ``settings.track_orders`` in one recording, with 95 % intervals.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle; ``settings.track_method`` says how: "least_squares" fits
    frames of whole cycles jointly, "vold_kalman" follows the orders jointly from sample to sample with
    ``settings.track_bandwidth`` and is read in the middle of such frames. An empty dataset where orders are read off
    the map ("frames") or none are asked for.
    """
    if settings.track_method == "frames" or not settings.track_orders:
        return xr.Dataset(attrs={"recording": band.attrs["recording"]})
    if settings.track_method == "least_squares":
        return tracked_orders(band, shaft, settings.track_orders, settings=settings)
    return vold_kalman_tracks(band, shaft, settings=settings)


def vold_kalman_tracks(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """Complex amplitudes (channel, order, frame) by the Vold–Kalman filter, in the middle of frames of whole cycles.

    ``band``, ``shaft`` and ``settings`` are those of :func:`followed_tracks`. Orders beyond half the sample rate are
    NaN. Raises InputError for a recording by crank angle of unknown speed, or where not one cycle was recorded, and
    RequestError where orders cannot be told apart within the bandwidth.
    """
    rate, angle, speed = _of_samples(band, shaft)
    known = np.flatnonzero(np.isfinite(angle))
    edges = frame_edges(angle, band, shaft, settings)
    part = slice(int(known[0]), int(known[-1]) + 1)
    orders = np.asarray(settings.track_orders, dtype=np.float64)
    carried = np.flatnonzero(orders * float(np.nanmax(speed)) / 60.0 < 0.5 * rate)
    width = np.full(orders.shape, settings.track_bandwidth)[carried, None] * np.ones_like(speed[None, part])
    if settings.track_bandwidth_unit == "order":
        width = width * speed[None, part] / 60.0
    found = vold_kalman(
        band["signal"].values[:, part],
        orders[carried, None] * angle[None, part],
        rate_hz=rate,
        bandwidth_hz=width,
        usable=band["usable"].values[:, part] if "usable" in band else None,
    )
    middle = np.searchsorted(angle[part], 0.5 * (edges[1:] + edges[:-1]))
    shape = (band.sizes["channel"], len(orders), len(middle))
    amplitude, error = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
    amplitude[:, carried] = found.amplitude[..., middle]
    error[:, carried] = found.standard_error[..., middle]
    dof = np.where(np.isfinite(error), ENDLESS_DOF, 0.0)
    values = {"amplitude": amplitude, "standard_error": error, "degrees_of_freedom": dof}
    made = tracks_in_frames(band, shaft, orders, edges, values, method="vold_kalman")
    return with_flags(made, [*flags_of(shaft), *_note_flags(str(band.attrs["recording"]), found.notes)])


def _of_samples(band: xr.Dataset, shaft: xr.Dataset) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Sample rate [Hz], crank angle [rev] and speed [rpm] of every sample; NaN where they are not known."""
    n = band["signal"].shape[1]
    if band.attrs["domain"] == "crank_angle":
        speed_rpm, per_rev = float(shaft["speed"].values.mean()), float(band.attrs["samples_per_rev"])
        if not math.isfinite(speed_rpm):
            raise InputError(
                "a Vold–Kalman track needs a speed",
                file=band.attrs["recording"],
                remedy='State the speed of the recording, or set track_method = "least_squares"',
            )
        angle = float(shaft["crank_angle"].values[0]) + np.arange(n) / per_rev
        return per_rev * speed_rpm / 60.0, angle, np.full(n, speed_rpm)
    rate = float(band.attrs["rate_hz"])
    knots = knots_of(shaft)
    time_s = float(band.attrs.get("start_s", 0.0)) + np.arange(n) / rate
    angle = angle_at(time_s, **knots)
    speed = np.interp(time_s, knots["knot_time_s"], knots["knot_speed_rpm"])
    return rate, angle, np.maximum(speed, 1e-6)


def _note_flags(recording: str, notes: tuple[str, ...]) -> list[Any]:
    return [{"recording": recording, "flag": "vold_kalman", "severity": "info", "detail": note} for note in notes]


def with_followed(tracks: xr.Dataset, followed: list[xr.Dataset]) -> xr.Dataset:
    """OrderTracks ``tracks`` (changed in place) whose orders that ``followed`` hold are theirs.

    Frames of the recordings in ``followed`` are averaged, by their length, at the nearest speed of ``tracks``: with
    their phases where these refer to top dead centre in all, else by energy and without phase. The coordinate
    ``track_method`` says of each order how it was followed.
    """
    items = [item for item in followed if "amplitude" in item]
    method = np.full(tracks.sizes["order"], "frames", dtype="<U16")
    if items:
        frame_speed = np.concatenate([item["speed"].values for item in items])
        nearest = np.abs(frame_speed[:, None] - tracks["speed"].values[None, :]).argmin(axis=1)
        for row, order in enumerate(tracks["order"].values):
            place = np.flatnonzero(np.abs(items[0]["order"].values - order) < 1e-9)
            if len(place):
                method[row] = items[0].attrs["track_method"]
                _replace(tracks, row, items, int(place[0]), nearest)
    tracks.coords["track_method"] = ("order", method, {"units": "1", "long_name": "how the order was followed"})
    return tracks


def _replace(tracks: xr.Dataset, row: int, items: list[xr.Dataset], place: int, nearest: NDArray[np.int64]) -> None:
    """Put the order ``place`` of ``items`` into the ``row`` of ``tracks``, its frames at the ``nearest`` speeds."""
    complex_amplitude = np.concatenate([item["amplitude"].values[:, place] for item in items], axis=1)
    error = np.concatenate([item["standard_error"].values[:, place] for item in items], axis=1)
    dof = np.concatenate([item["degrees_of_freedom"].values[:, place] for item in items], axis=1)
    weight = np.concatenate([item["revs"].values for item in items])
    whole = abs(float(tracks["order"].values[row]) % 1.0) < 1e-9
    referenced = all(
        item.attrs["phase_reference"] != "none" and (whole or int(item.attrs["cycle_known"])) for item in items
    )
    comparable = referenced or len(items) == 1
    for speed in range(tracks.sizes["speed"]):
        group = nearest == speed
        known = np.isfinite(error[:, group])
        total = (known * weight[group]).sum(axis=1, keepdims=True)
        share = np.divide(known * weight[group], total, out=np.zeros(known.shape), where=total > 0.0)
        values, errors = (np.where(known, part[:, group], 0.0) for part in (complex_amplitude, error))
        if comparable:
            mean = (share * values).sum(axis=1)
        else:
            largest = np.maximum(np.abs(values).max(axis=1, initial=0.0), np.finfo(float).tiny)
            mean = largest * np.sqrt((share * np.abs(values / largest[:, None]) ** 2).sum(axis=1))
        freedom = np.where(known, dof[:, group], 0.0).sum(axis=1)
        missing = ~(total[:, 0] > 0.0)
        scatter = np.where(missing, np.nan, np.sqrt(((share * errors) ** 2).sum(axis=1)))
        _put_speed(tracks, row, speed, mean, scatter, freedom, missing, with_phase=referenced)


def _put_speed(
    tracks: xr.Dataset,
    row: int,
    speed: int,
    mean: NDArray[np.complex128],
    error: NDArray[np.float64],
    dof: NDArray[np.float64],
    missing: NDArray[np.bool_],
    *,
    with_phase: bool,
) -> None:
    low, high = amplitude_interval(np.abs(mean), 2.0 * error**2, dof)
    half = phase_interval_deg(np.abs(mean), 2.0 * error**2, dof)
    values = {
        "amplitude": np.abs(mean),
        "phase": np.degrees(np.angle(mean)) if with_phase else np.full(len(mean), np.nan),
        "standard_error": error,
        "degrees_of_freedom": dof,
        "amplitude_low": low,
        "amplitude_high": high,
        "phase_ci95": half,
    }
    for name, value in values.items():
        tracks[name].values[:, row, speed] = np.where(missing, 0.0 if name == "degrees_of_freedom" else np.nan, value)
