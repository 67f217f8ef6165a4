"""Lines of a sweep that the frames of its map hold as one, read where they were followed jointly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.identify.found import OrderLine
from crankorder.identify.lines.zoom import NUMBERS as ZOOM
from crankorder.identify.lines.zoom import Course, course_of
from crankorder.quantities import Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "parted_lines")

SURE_FREEDOM = 1e6
"""Degrees of freedom of a number that a course tells: its errors are bounds."""

SAME_NUMBER = 1e-9
"""Numbers closer than this are one."""


@dataclass(frozen=True)
class Followed:
    """One line in one recording: its ``place`` among the orders of ``tracks`` (RecordingTracks), its ``number``, the
    ``variance`` of that, and how its phase runs from the order under which it was followed.

    ``course`` is None where noise hides it, or where the filter remembers so much that stretches are no witnesses of
    each other; ``by_phase`` says whether the phase told the number all the same.
    """

    tracks: xr.Dataset
    place: int
    number: float
    variance: float
    by_phase: bool
    course: Course | None

    @property
    def order(self) -> float:
        """The order under which it was followed."""
        return float(self.tracks["order"].values[self.place])

    @property
    def span_rev(self) -> float:
        """Revolutions over which it was followed."""
        return float(np.ptp(self.tracks["crank_angle"].values))

    @property
    def told(self) -> tuple[float, float, float]:
        """The number, its variance and degrees of freedom."""
        return self.number, self.variance, SURE_FREEDOM


def parted_lines(followed: Sequence[xr.Dataset], *, near: float, reach: float) -> list[list[Followed]]:
    """The close lines about the order ``near``, lowest first, each in all recordings that part them; [] if none does.

    Lines stand out in sweeps of ``followed`` (RecordingTracks) and are less than ``reach`` orders from the next;
    recordings that show fewer of them than others hold a mixture and are left out.
    """
    groups = [(item, _chain(item, near, reach)) for item in followed if item.attrs.get("swept", 0)]
    most = max((len(group) for _, group in groups), default=0)
    if most < 2:
        return []
    made: list[list[Followed]] = [[] for _ in range(most)]
    for item, group in groups:
        if len(group) != most:
            continue
        numbers = item["order"].values[group]
        for lines, place in zip(made, group, strict=True):
            apart = np.abs(numbers - item["order"].values[place])
            lines.append(_read(item, place, float(apart[apart > 0.0].min())))
    return made


def stands_out(followed: Sequence[xr.Dataset], *, near: float, reach: float) -> bool | None:
    """Whether a line within ``reach`` orders of ``near`` stands out in a sweep of ``followed`` (RecordingTracks).

    None where none of them says what stands out.
    """
    said = [item for item in followed if "standing_out" in item.attrs]
    if not said:
        return None
    return any(abs(float(item["order"].values[place]) - near) < reach for item in said for place in standing_out(item))


def standing_out(item: xr.Dataset) -> list[int]:
    """Places of the orders of ``item`` that stand out in it: others were asked for."""
    out = np.atleast_1d(np.asarray(item.attrs.get("standing_out", ()), dtype=np.float64))
    if not len(out) or not item.sizes.get("frame", 0):
        return []
    return [k for k, number in enumerate(item["order"].values) if np.abs(out - number).min() < SAME_NUMBER]


def _chain(item: xr.Dataset, near: float, reach: float) -> list[int]:
    """Places of orders standing out in ``item``, each less than ``reach`` from the next, one of them so to ``near``."""
    numbers, places = item["order"].values, standing_out(item)
    if not places:
        return []
    chains = np.split(np.array(places), np.flatnonzero(np.diff(numbers[places]) >= reach) + 1)
    distance, best = min((float(np.abs(numbers[chain] - near).min()), chain.tolist()) for chain in chains)
    return best if distance < reach else []


def _read(item: xr.Dataset, place: int, nearest: float) -> Followed:
    """The order number ``place`` of ``item``, which is ``nearest`` orders from the next line."""
    order, course = float(item["order"].values[place]), _course(item, place)
    unread = (NUMBERS.unread_share * nearest) ** 2
    if course is None:
        return Followed(item, place, order, unread, by_phase=False, course=None)
    span = float(np.ptp(item["crank_angle"].values))
    bandwidth = float(np.median(item["bandwidth_hz"].values[place] * 60.0 / item["speed"].values))
    variance = (course.half / ZOOM.sure_sigmas) ** 2
    if bandwidth * span < ZOOM.stretches:
        variance, course = variance + (ZOOM.swept_turns_rev / span) ** 2, replace(course, slopes=np.zeros(0))
    if variance > unread:
        return Followed(item, place, order, unread, by_phase=False, course=None)
    told = course if len(course.slopes) else None
    return Followed(item, place, order + course.offset, variance, by_phase=True, course=told)


def _course(item: xr.Dataset, place: int) -> Course | None:
    """How the phase of the order number ``place`` of ``item`` runs from that number."""
    values = item["amplitude"].values[:, place]
    noise = 2.0 * np.square(item["standard_error"].values[:, place])
    seen = np.isfinite(values) & np.isfinite(noise)
    channels = seen.any(axis=1)
    rows = channels.any() & seen[channels].all(axis=0)
    kept = np.ix_(channels, rows)
    return course_of(values[kept], item["crank_angle"].values[rows], noise[kept])


def lines_of(
    lines: Sequence[OrderLine], followed: Sequence[Followed], *, speed_rpm: Floats, order: float, order_error: float
) -> list[OrderLine]:
    """Those of ``lines`` (one of each channel) in which the tracks of ``followed`` stand out, with their amplitudes.

    Each speed of the map, ``speed_rpm`` (speeds,), holds the row that is nearest to it; the lines are of ``order`` with
    its standard ``order_error``.
    """
    made = []
    for line in lines:
        rows = [_rows(item, line.channel) for item in followed]
        speed, size, error, degrees_of_freedom = (np.concatenate(column) for column in zip(*rows, strict=True))
        clear = np.flatnonzero(size > NUMBERS.clear_sigmas * error)
        if not len(clear):
            continue
        apart = np.abs(speed_rpm[:, None] - speed[clear])
        inside = (speed_rpm >= speed[clear].min()) & (speed_rpm <= speed[clear].max())
        at = np.flatnonzero(inside) if inside.any() else np.array([int(np.nanargmin(apart.min(axis=1)))])
        row = clear[apart[at].argmin(axis=1)]
        read = line.read_again((order, order_error), at, speed[row], size[row], error[row], degrees_of_freedom[row])
        made.append(replace(read, evidence="follows the speed"))
    return made


def _rows(item: Followed, channel: str) -> tuple[Floats, Floats, Floats, Floats]:
    """Speeds, amplitudes, their errors and degrees of freedom, of the rows of ``item`` that know its ``channel``."""
    tracks = item.tracks.isel(order=item.place).sel(channel=channel)
    size, error = np.abs(tracks["amplitude"].values), tracks["standard_error"].values
    known = np.isfinite(size) & np.isfinite(error)
    degrees_of_freedom = tracks["degrees_of_freedom"].values.astype(np.float64)
    return tracks["speed"].values[known], size[known], error[known], degrees_of_freedom[known]
