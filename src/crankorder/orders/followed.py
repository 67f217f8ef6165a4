"""Orders asked for by name, followed through each recording by a method of their own, and joined by speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from crankorder.errors import InputError
from crankorder.orders.averages import POLES, Readings, by_energy, by_phase, coherent_mean
from crankorder.orders.between_recordings import phases_compare
from crankorder.orders.least_squares import (
    Spans,
    beyond_remark,
    frame_spans,
    not_tracked_flags,
    tracked_orders,
    tracks_in_frames,
)
from crankorder.orders.swept_tracks import swept_tracks
from crankorder.orders.vold_kalman.bandwidth import level_dof, student_factor
from crankorder.orders.vold_kalman.filter import FEWEST_SAMPLES, vold_kalman
from crankorder.quantities import Bools, Floats, Ints, QualityFlag, flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import angle_at, knots_of, smoothed_speed, speed_course, time_at

LEAST_USABLE = 0.5
"""Share of a frame's samples that must be usable for the filter to be read in its middle."""

SAME_ORDER = 1e-9
"""Orders closer than this are one."""


_SCALED = ("amplitude", "standard_error", "amplitude_low", "amplitude_high")

_PUT = (*_SCALED, "phase", "degrees_of_freedom", "phase_ci95")


def followed_tracks(
    band: xr.Dataset,
    shaft: xr.Dataset,
    *,
    settings: OrderSettings,
    swept: bool = False,
    standing_out: Sequence[float] = (),
    mains_hz: Sequence[float] = (),
) -> xr.Dataset:
    """Complex amplitudes (channel, order, frame) of ``settings.track_orders`` in one recording, with 95 % intervals.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle; ``settings.track_method`` says how: "least_squares" fits
    frames of whole cycles jointly, "vold_kalman" follows the orders jointly from sample to sample with
    ``settings.track_bandwidth`` and is read in the middle of such frames; "auto" follows these orders and those
    ``standing_out`` jointly where the speed is ``swept`` (:func:`swept_tracks`), beside mains of ``mains_hz``. An
    order asked for twice is followed once. An empty dataset where orders are read off the map ("frames", or "auto"
    where nothing sweeps) or there are none to follow. The attribute ``swept`` says whether rows are those of a sweep,
    ``standing_out`` which orders stood out in it.
    """
    if settings.track_method == "auto" and swept:
        orders = _once([*settings.track_orders, *standing_out])
        if orders:
            return swept_tracks(band, shaft, orders, mains_hz=mains_hz).assign_attrs(standing_out=list(standing_out))
    if settings.track_method in ("frames", "auto") or not settings.track_orders:
        return xr.Dataset(attrs={"recording": band.attrs["recording"], "track_method": "frames", "swept": 0})
    if settings.track_method == "least_squares":
        return tracked_orders(band, shaft, _once(settings.track_orders), settings=settings)
    return vold_kalman_tracks(band, shaft, settings=settings)


def _once(orders: Sequence[float]) -> list[float]:
    """``orders`` without those that were named before."""
    kept: list[float] = []
    for order in orders:
        if all(abs(order - other) > SAME_ORDER for other in kept):
            kept.append(order)
    return kept


def vold_kalman_tracks(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """Complex amplitudes (channel, order, frame) by the Vold–Kalman filter, in the middle of frames of whole cycles.

    ``band``, ``shaft`` and ``settings`` are those of :func:`followed_tracks`. ``speed`` is that in the middle of each
    frame, over a reciprocal bandwidth; ``bandwidth_rev`` (frame,) is the bandwidth in cycles per revolution, which says
    how much neighbouring frames have in common. NaN are orders beyond half the sample rate, channels with too few
    usable samples, and frames that are for the most part not usable. Raises InputError for a recording by crank angle
    of unknown speed, or where not one cycle was recorded, and RequestError where orders cannot be told apart within the
    bandwidth.
    """
    rate, angle, speed = _of_samples(band, shaft)
    known = np.flatnonzero(np.isfinite(angle))
    spans = frame_spans(angle, band, shaft, settings)
    part = slice(int(known[0]), int(known[-1]) + 1)
    orders = np.asarray(_once(settings.track_orders), dtype=np.float64)
    carried = np.flatnonzero(orders * float(speed[part].max()) / 60.0 < 0.5 * rate)
    angle, speed = angle[part], speed[part]
    width = settings.track_bandwidth * (
        speed / 60.0 if settings.track_bandwidth_unit == "order" else np.ones(len(speed))
    )
    signals, usable = band["signal"].values[:, part], _usable(band, part)
    enough = np.flatnonzero(usable.sum(axis=1) >= FEWEST_SAMPLES)
    middle = np.searchsorted(angle, 0.5 * (spans[0] + spans[1]))
    shape = (len(signals), len(orders), len(middle))
    amplitude, error = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
    notes: tuple[str, ...] = ()
    if len(carried) and len(enough):
        found = vold_kalman(
            signals[enough],
            orders[carried, None] * angle,
            rate_hz=rate,
            bandwidth_hz=np.tile(width, (len(carried), 1)),
            poles=POLES,
            usable=usable[enough],
            names=[f"order {order:g}" for order in orders[carried]],
        )
        at = np.ix_(enough, carried)
        amplitude[at], error[at] = found.amplitude[..., middle], found.standard_error[..., middle]
        notes = found.notes
    seen = _mostly_usable(usable, angle, spans)[:, None]
    freedom = level_dof(float(width.mean()) * len(width) / rate)
    values = {
        "amplitude": np.where(seen, amplitude, np.nan),
        # the filter's errors are enlarged as Student's t asks for; the interval does that again
        "standard_error": np.where(seen, error, np.nan) / student_factor(np.array(freedom)),
        "degrees_of_freedom": np.where(seen & np.isfinite(error), freedom, 0.0),
    }
    made = tracks_in_frames(band, shaft, orders, spans, values, method="vold_kalman")
    _put_middles(made, _speeds_of_rows(shaft, spans, speed[middle], width[middle]), width[middle])
    beyond, some_short = np.delete(orders, carried), len(enough) < len(signals)
    return with_flags(made, [*flags_of(shaft), *_flags(str(band.attrs["recording"]), notes, beyond, some_short)])


def _speeds_of_rows(shaft: xr.Dataset, spans: Spans, speed_rpm: Floats, bandwidth_hz: Floats) -> Floats:
    """Speed [rpm] in the middle of ``spans`` by ``shaft``, over the time that the filter looks at.

    ``speed_rpm`` is that of a recording by crank angle, where nothing else is known.
    """
    if shaft.attrs.get("domain", "time") == "crank_angle":
        return speed_rpm
    middle = time_at(0.5 * (spans[0] + spans[1]), **knots_of(shaft))
    return smoothed_speed(shaft, middle, 1.0 / bandwidth_hz)


def _put_middles(made: xr.Dataset, speed_rpm: Floats, bandwidth_hz: Floats) -> None:
    """Speed and bandwidth of the filter in the middle of the frames of ``made``."""
    per_rev = bandwidth_hz * 60.0 / speed_rpm
    made.coords["speed"] = ("frame", speed_rpm, {"units": "min-1", "long_name": "speed in the middle of the frame"})
    made.coords["bandwidth_rev"] = ("frame", per_rev, {"units": "rev-1", "long_name": "bandwidth of the filter"})


def _usable(band: xr.Dataset, part: slice) -> Bools:
    """Which samples (channels, samples) of ``part`` count: finite ones that ``usable`` of ``band`` does not deny."""
    finite: Bools = np.isfinite(band["signal"].values[:, part])
    return np.asarray(finite & band["usable"].values[:, part]) if "usable" in band else finite


def _mostly_usable(usable: Bools, angle_rev: Floats, spans: Spans) -> Bools:
    """Whether most samples of each frame (channels, frames) of ``spans`` are ``usable`` (channels, samples)."""
    total = np.concatenate([np.zeros((len(usable), 1), dtype=np.int64), np.cumsum(usable, axis=1)], axis=1)
    first, last = (np.searchsorted(angle_rev, edge) for edge in spans)
    return np.asarray(total[:, last] - total[:, first] >= LEAST_USABLE * (last - first))


def _of_samples(band: xr.Dataset, shaft: xr.Dataset) -> tuple[float, Floats, Floats]:
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
    course = speed_course(shaft)
    return rate, angle, np.interp(time_s, course.time_s, course.speed_rpm)


def _flags(recording: str, notes: tuple[str, ...], beyond: Floats, some_short: bool) -> list[QualityFlag]:
    remarks = [f"{beyond_remark(order)} at the highest speed" for order in beyond]
    if some_short:
        remarks.append(f"a channel has fewer than {FEWEST_SAMPLES} usable samples: its orders are not tracked")
    said: list[QualityFlag] = [
        {"recording": recording, "flag": "vold_kalman", "severity": "info", "detail": note} for note in notes
    ]
    return said + not_tracked_flags(recording, remarks)


def with_followed(tracks: xr.Dataset, followed: list[xr.Dataset]) -> xr.Dataset:
    """OrderTracks ``tracks`` (changed in place) whose orders that ``followed`` hold are theirs.

    Frames of the recordings in ``followed`` are averaged at the nearest speed of ``tracks``, those that are much
    noisier than most count less: with their phases within a recording, and across recordings where all refer to one
    and the same mark; else the recordings are averaged by energy, without phase. A recording of unknown speed goes to
    its own row. The coordinate ``track_method`` says of each order how it was followed; flags of ``followed`` join.
    """
    items = [item for item in followed if "amplitude" in item and not item.attrs.get("swept", 0)]
    if not items:
        return tracks
    method = tracks["track_method"].values.copy()
    groups, remarks = _frames_of_speeds(tracks, items)
    for row, order in enumerate(tracks["order"].values):
        place = np.flatnonzero(np.abs(items[0]["order"].values - order) < SAME_ORDER)
        if not len(place):
            continue
        method[row] = items[0].attrs["track_method"]
        readings = _readings(items, int(place[0]))
        comparable = bool(phases_compare(items, np.array([order]))[0])
        for speed, group in enumerate(groups):
            _put_speed(tracks, row, speed, readings.of(group), comparable=comparable)
    tracks.coords["track_method"] = ("order", method, {"units": "1", "long_name": "how the order was followed"})
    known = flags_of(tracks)
    for flag in [flag for item in items for flag in flags_of(item)] + remarks:
        if flag not in known:
            known.append(flag)
    tracks.attrs.pop("quality", None)
    return with_flags(tracks, known)


def _readings(items: list[xr.Dataset], place: int) -> Readings:
    """Frames of the order number ``place`` of all ``items``."""
    names = ("amplitude", "standard_error", "degrees_of_freedom")
    values, errors, dof = (np.concatenate([item[name].values[:, place] for item in items], axis=1) for name in names)
    revs, begin = (np.concatenate([item[name].values for item in items]) for name in ("revs", "crank_angle"))
    nothing = [np.full(item.sizes["frame"], np.nan) for item in items]
    per_rev = [
        item["bandwidth_rev"].values if "bandwidth_rev" in item.coords else none
        for item, none in zip(items, nothing, strict=True)
    ]
    owner = np.repeat(np.arange(len(items)), [item.sizes["frame"] for item in items])
    return Readings(values, errors, dof, revs, owner, begin, np.concatenate(per_rev))


def _frames_of_speeds(tracks: xr.Dataset, items: list[xr.Dataset]) -> tuple[list[Ints], list[QualityFlag]]:
    """Numbers of the frames of ``items`` that belong to each speed of ``tracks``, and remarks on those that do not.

    A frame belongs to the nearest speed, where it is no further off than the width of a group or the next frame; a
    speed that is nearest to none takes the nearest frame within the same reach. Rows of unknown speed are the
    recordings of unknown speed in turn.
    """
    rows = tracks["speed"].values
    speed = np.concatenate([item["speed"].values for item in items])
    reach = np.concatenate([_reach(item["speed"].values) for item in items])
    reach = np.maximum(reach, float(tracks.attrs.get("speed_bin_rpm", 0.0)))
    owner = np.repeat(np.arange(len(items)), [item.sizes["frame"] for item in items])
    apart = np.abs(speed[:, None] - rows)
    apart = np.where(np.isnan(apart), np.inf, apart)
    nearest = np.where(apart.min(axis=1) <= reach, apart.argmin(axis=1), -1)
    groups: list[Ints] = []
    for row in range(len(rows)):
        group = np.flatnonzero(nearest == row)
        if not len(group) and np.isfinite(rows[row]):
            within = np.where(apart[:, row] <= reach, apart[:, row], np.inf)
            group = np.flatnonzero(np.isfinite(within) & (within == within.min()))
        groups.append(group)
    unnamed = np.flatnonzero(np.isnan(rows))
    unknown = [k for k, item in enumerate(items) if np.isnan(item["speed"].values).all()]
    remarks: list[str] = []
    if len(unnamed) == len(unknown):
        for place, item in zip(unnamed, unknown, strict=True):
            groups[int(place)] = np.flatnonzero(owner == item)
    elif unknown:
        remarks = ["recordings of unknown speed cannot be told from one another: their orders are left out"]
    return groups, not_tracked_flags(str(items[unknown[0]].attrs["recording"]) if unknown else "", remarks)


def _reach(speed_rpm: Floats) -> Floats:
    """How far the speed of each frame is from that of the frame before or after it, whichever is further."""
    step = np.abs(np.diff(speed_rpm, prepend=speed_rpm[:1], append=speed_rpm[-1:]))
    return np.nan_to_num(np.maximum(step[:-1], step[1:]))


def _put_speed(tracks: xr.Dataset, row: int, speed: int, readings: Readings, *, comparable: bool) -> None:
    """Put the average of ``readings`` into the ``row`` and ``speed`` of ``tracks``; NaN for channels without."""
    for name in _PUT:
        tracks[name].values[:, row, speed] = 0.0 if name == "degrees_of_freedom" else np.nan
    seen = np.isfinite(readings.values.real) & np.isfinite(readings.errors)
    if not seen.any():
        return
    patterns, which = np.unique(seen, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        if not pattern.any():
            continue
        channels = np.flatnonzero(which.ravel() == number)
        part = readings.of(np.flatnonzero(pattern)).channels(channels)
        largest = np.maximum(np.abs(part.values.real), np.abs(part.values.imag)).max(axis=1)
        unit = np.ldexp(1.0, np.frexp(np.where(largest > 0.0, largest, 1.0))[1] - 1)
        part = replace(part, values=part.values / unit[:, None], errors=part.errors / unit[:, None])
        names = np.unique(part.owner)
        if comparable or len(names) == 1:
            made = by_phase(coherent_mean(part), with_phase=comparable)
        else:
            made = by_energy([coherent_mean(part.of(np.flatnonzero(part.owner == name))) for name in names])
        for name, values in made.items():
            scale = unit if name in _SCALED else 1.0
            tracks[name].values[channels, row, speed] = scale * values
