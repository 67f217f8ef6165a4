"""Orders asked for by name, followed through each recording by Vold–Kalman, and joined by speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from crankorder.errors import InputError
from crankorder.fft.decimation import sound_samples
from crankorder.fft.transforms import counted
from crankorder.orders.averages import POLES, SCALED, TRACKED, Readings, by_energy, by_phase, coherent_mean
from crankorder.orders.intervals import phases_compare
from crankorder.orders.method import frame_layout, is_by_angle
from crankorder.orders.swept_tracks import beyond_remark, filtered_tracks, not_tracked_flags, swept_tracks
from crankorder.orders.vold_kalman.bandwidth import level_dof
from crankorder.orders.vold_kalman.filter import FEWEST_SAMPLES, vold_kalman
from crankorder.quantities import Floats, Ints, described, flags_of, remark, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import SpeedCourse, angle_at, knots_of, smoothed_speed, speed_course, time_at

LEAST_USABLE = 0.5
"""Share of a frame's samples that must be usable for the filter to be read in its middle."""

SAME_ORDER = 1e-9
"""Orders closer than this are one."""


_OF_ORDER = ("amplitude", "standard_error", "degrees_of_freedom")


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

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle; ``settings.track_method`` says how: "vold_kalman"
    follows the orders jointly from sample to sample with ``settings.track_bandwidth`` and is read in the middle of the
    frames of the order map; "auto" follows these orders and those ``standing_out`` jointly where the speed is ``swept``
    (:func:`swept_tracks`), beside mains of ``mains_hz``. An order asked for twice is followed once. An empty dataset
    where orders are read off the map ("frames", or "auto" where nothing sweeps) or there are none to follow. The
    attribute ``swept`` says whether rows are those of a sweep, ``standing_out`` which orders stood out in it.
    """
    if settings.track_method == "auto" and swept:
        orders = _once([*settings.track_orders, *standing_out])
        if orders:
            return swept_tracks(band, shaft, orders, mains_hz=mains_hz).assign_attrs(standing_out=list(standing_out))
    if settings.track_method in ("frames", "auto") or not settings.track_orders:
        return xr.Dataset(attrs={"recording": band.attrs["recording"], "track_method": "frames", "swept": 0})
    return vold_kalman_tracks(band, shaft, settings=settings)


def _once(orders: Sequence[float]) -> list[float]:
    """``orders`` without those that were named before."""
    kept: list[float] = []
    for order in orders:
        if all(abs(order - other) > SAME_ORDER for other in kept):
            kept.append(order)
    return kept


def vold_kalman_tracks(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """Complex amplitudes (channel, order, frame) by the Vold–Kalman filter, in the middle of the order map's frames.

    ``band``, ``shaft`` and ``settings`` are those of :func:`followed_tracks`. ``speed`` is that in the middle of each
    frame, over a reciprocal bandwidth; ``crank_angle`` and ``revs`` (frame,) are where it begins and how long it is;
    ``bandwidth_rev`` (frame,) is the bandwidth in cycles per revolution, which says how much neighbouring frames have
    in common. NaN are orders beyond half the sample rate, channels with too few usable samples, and frames that are for
    the most part not usable. Raises InputError for a recording by crank angle of unknown speed, or where not one cycle
    was recorded, and RequestError where orders cannot be told apart within the bandwidth.
    """
    course = None if is_by_angle(band) else speed_course(shaft)
    rate, angle, speed = _of_samples(band, shaft, course)
    layout = frame_layout(band, shaft, settings=settings, course=course)
    known = np.flatnonzero(np.isfinite(angle))
    part = slice(int(known[0]), int(known[-1]) + 1)
    orders = np.asarray(_once(settings.track_orders), dtype=np.float64)
    carried = np.flatnonzero(orders * float(speed[part].max()) / 60.0 < 0.5 * rate)
    angle, speed = angle[part], speed[part]
    unit_hz = speed / 60.0 if settings.track_bandwidth_unit == "order" else np.ones(len(speed))
    width = settings.track_bandwidth * unit_hz
    signals = band["signal"].values[:, part]
    usable = sound_samples(band)[:, part]
    enough = np.flatnonzero(usable.sum(axis=1) >= FEWEST_SAMPLES)
    middle_rev = layout.begin_rev + 0.5 * layout.revs
    middle = np.searchsorted(angle, middle_rev)
    shape = (len(signals), len(orders), len(middle))
    amplitude, error = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
    notes: tuple[str, ...] = ()
    if len(carried) and len(enough):
        filtered = vold_kalman(
            signals[enough],
            orders[carried, None] * angle,
            rate_hz=rate,
            bandwidth_hz=np.tile(width, (len(carried), 1)),
            poles=POLES,
            usable=usable[enough],
            names=[f"order {order:g}" for order in orders[carried]],
        )
        at = np.ix_(enough, carried)
        amplitude[at], error[at] = filtered.amplitude[..., middle], filtered.error_at(middle)
        notes = filtered.notes
    first, last = (np.searchsorted(angle, edge) for edge in (layout.begin_rev, layout.begin_rev + layout.revs))
    seen = (counted(usable, first, last) >= LEAST_USABLE * (last - first))[:, None]
    amplitude, error = np.where(seen, amplitude, np.nan), np.where(seen, error, np.nan)
    freedom = level_dof(float(width.mean()) * len(width) / rate)
    tracks = filtered_tracks(band, shaft, orders, amplitude, error, freedom=freedom)
    if course is None:
        speed_rpm = speed[middle]
    else:
        speed_rpm = smoothed_speed(shaft, time_at(middle_rev, **knots_of(shaft)), 1.0 / width[middle])
    for name, given, units, text in (
        ("speed", speed_rpm, "min-1", "speed in the middle of the frame"),
        ("crank_angle", layout.begin_rev, "rev", "crank angle at the start"),
        ("revs", np.full(len(middle), float(layout.revs)), "rev", "length of the frame"),
        ("bandwidth_rev", width[middle] * 60.0 / speed_rpm, "rev-1", "bandwidth of the filter"),
    ):
        tracks.coords[name] = described("frame", given, units, text)
    recording, remarks = str(band.attrs["recording"]), [beyond_remark(order) for order in np.delete(orders, carried)]
    if len(enough) < len(signals):
        remarks.append(f"a channel has fewer than {FEWEST_SAMPLES} usable samples: its orders are not tracked")
    flags = [remark(recording, "vold_kalman", note) for note in notes] + not_tracked_flags(recording, remarks)
    return with_flags(tracks, [*flags_of(shaft), *flags])


def _of_samples(band: xr.Dataset, shaft: xr.Dataset, course: SpeedCourse | None) -> tuple[float, Floats, Floats]:
    """Sample rate [Hz], crank angle [rev] and speed [rpm] of every sample; NaN where they are not known.

    ``course`` is that of the speed, None for a recording by crank angle.
    """
    n = band["signal"].shape[1]
    if course is None:
        speed_rpm, per_rev = float(shaft["speed"].values.mean()), float(band.attrs["samples_per_rev"])
        if not math.isfinite(speed_rpm):
            raise InputError(
                "a Vold–Kalman track needs a speed",
                file=band.attrs["recording"],
                remedy='State the speed of the recording, or set track_method = "frames"',
            )
        angle = float(shaft["crank_angle"].values[0]) + np.arange(n) / per_rev
        return per_rev * speed_rpm / 60.0, angle, np.full(n, speed_rpm)
    rate = float(band.attrs["rate_hz"])
    time_s = float(band.attrs.get("start_s", 0.0)) + np.arange(n) / rate
    angle = angle_at(time_s, **knots_of(shaft))
    return rate, angle, np.interp(time_s, course.time_s, course.speed_rpm)


def with_followed(tracks: xr.Dataset, followed: list[xr.Dataset]) -> xr.Dataset:
    """OrderTracks ``tracks`` (changed in place) whose orders that ``followed`` hold are theirs.

    Frames of the recordings in ``followed`` are averaged at the nearest speed of ``tracks``, those that are much
    noisier than most count less: with their phases within a recording, and across recordings where all refer to one
    and the same mark; else the recordings are averaged by energy, without phase. The coordinate ``track_method`` says
    of each order how it was followed; flags of ``followed`` join.
    """
    items = [item for item in followed if "amplitude" in item and not item.attrs.get("swept", 0)]
    if not items:
        return tracks
    method = tracks["track_method"].values.copy()
    groups = _frames_of_speeds(tracks, items)
    owner = np.repeat(np.arange(len(items)), [item.sizes["frame"] for item in items])
    names = ("revs", "crank_angle", "bandwidth_rev")
    revs, begin, per_rev = (np.concatenate([item[name].values for item in items]) for name in names)
    for row, order in enumerate(tracks["order"].values):
        place = np.flatnonzero(np.abs(items[0]["order"].values - order) < SAME_ORDER)
        if not len(place):
            continue
        method[row] = items[0].attrs["track_method"]
        values, errors, dof = (
            np.concatenate([item[name].values[:, place[0]] for item in items], axis=1) for name in _OF_ORDER
        )
        readings = Readings(values, errors, dof, revs, owner, begin, per_rev)
        comparable = bool(phases_compare(items, np.array([order]))[0])
        for speed, group in enumerate(groups):
            _put_speed(tracks, row, speed, readings.of(group), comparable=comparable)
    tracks.coords["track_method"] = ("order", method, {"units": "1", "long_name": "how the order was followed"})
    known = flags_of(tracks)
    for flag in [flag for item in items for flag in flags_of(item)]:
        if flag not in known:
            known.append(flag)
    tracks.attrs.pop("quality", None)
    return with_flags(tracks, known)


def _frames_of_speeds(tracks: xr.Dataset, items: list[xr.Dataset]) -> list[Ints]:
    """Numbers of the frames of ``items`` that belong to each speed of ``tracks``.

    A frame belongs to the nearest speed, where it is no further off than the width of a group or the next frame; a
    speed that is nearest to none takes the nearest frame within the same reach.
    """
    rows = tracks["speed"].values
    speed = np.concatenate([item["speed"].values for item in items])
    steps = [np.abs(np.diff(own := item["speed"].values, prepend=own[:1], append=own[-1:])) for item in items]
    reach = np.concatenate([np.maximum(step[:-1], step[1:]) for step in steps])  # to the frame before or after
    reach = np.maximum(reach, float(tracks.attrs.get("speed_bin_rpm", 0.0)))
    apart = np.abs(speed[:, None] - rows)
    nearest = np.where(apart.min(axis=1) <= reach, apart.argmin(axis=1), -1)
    groups: list[Ints] = []
    for row in range(len(rows)):
        group = np.flatnonzero(nearest == row)
        if not len(group):
            within = np.where(apart[:, row] <= reach, apart[:, row], np.inf)
            group = np.flatnonzero(np.isfinite(within) & (within == within.min()))
        groups.append(group)
    return groups


def _put_speed(tracks: xr.Dataset, row: int, speed: int, readings: Readings, *, comparable: bool) -> None:
    """Put the average of ``readings`` into the ``row`` and ``speed`` of ``tracks``; NaN for channels without."""
    for name in TRACKED:
        tracks[name].values[:, row, speed] = 0.0 if name == "degrees_of_freedom" else np.nan
    seen = np.isfinite(readings.values.real) & np.isfinite(readings.errors)
    if not seen.any():
        return
    patterns, which = np.unique(seen, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        if not pattern.any():
            continue
        channels = np.flatnonzero(which.ravel() == number)
        part = readings.of(np.flatnonzero(pattern), channels)
        largest = np.maximum(np.abs(part.values.real), np.abs(part.values.imag)).max(axis=1)
        unit = np.ldexp(1.0, np.frexp(np.where(largest > 0.0, largest, 1.0))[1] - 1)
        part = replace(part, values=part.values / unit[:, None], errors=part.errors / unit[:, None])
        names = np.unique(part.owner)
        if comparable or len(names) == 1:
            made = by_phase(coherent_mean(part), with_phase=comparable)
        else:
            made = by_energy([coherent_mean(part.of(np.flatnonzero(part.owner == name))) for name in names])
        for name, values in made.items():
            scale = unit if name in SCALED else 1.0
            tracks[name].values[channels, row, speed] = scale * values
