"""Phasors of a line in frames of recordings and tracks of sweeps, and what their turn tells: its order and its lock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import exp1

from crankorder.findings import Lock
from crankorder.identify.found import Doubt, OrderLine
from crankorder.identify.lines.zoom import NUMBERS as ZOOM
from crankorder.identify.lines.zoom import Course, Frames, Zoomed, course_of, drift_turn_rev, zoomed
from crankorder.orders.intervals import half_width
from crankorder.orders.joint_lines import Band, HeldFrames, Place, hann_lobe, joint_lines
from crankorder.orders.like_speed import common_frames
from crankorder.quantities import Complexes, Floats, flags_of
from crankorder.settings import MethodNumbers

LOCK_NUMBERS = MethodNumbers("5-identify-lines.toml", "order_lock")


def nearest_multiple(order: float, *, revs_per_cycle: int) -> float:
    """The multiple of 1 / ``revs_per_cycle`` next to ``order`` and above zero."""
    return max(1, round(order * revs_per_cycle)) / revs_per_cycle


def is_half_order(order: float, order_error: float) -> bool:
    """Whether ``order`` is, within four times its standard ``order_error`` or 0.1 %, an odd multiple of one half."""
    odd = np.floor(order) + 0.5
    return bool(abs(order - odd) <= max(4.0 * order_error, LOCK_NUMBERS.least_slip * order))


def lock_of(
    order: float, order_error: float, degrees_of_freedom: float, *, revs_per_cycle: int, by_phase: bool
) -> Lock:
    """Whether ``order`` is an exact multiple of 1 / ``revs_per_cycle``: "locked", "slips" or "undecided".

    It slips where the 99.9 % interval leaves the multiple out, and that of the half revolution too: a rotor that
    rubs or is loose has exact half orders, though its cycle is one revolution. It is locked where that interval
    holds the multiple and no order that differs from it by ``least_slip`` or more. ``order_error`` is the standard
    error with its ``degrees_of_freedom``; only what was measured ``by_phase``, by the turn of the phase over a
    recording, can prove a lock.
    """
    multiple = nearest_multiple(order, revs_per_cycle=revs_per_cycle)
    half, distance = sure_half_width(order_error, degrees_of_freedom), abs(order - multiple)
    if distance > half:
        return "slips" if abs(order - nearest_multiple(order, revs_per_cycle=2)) > half else "undecided"
    return "locked" if by_phase and distance + half < LOCK_NUMBERS.least_slip * multiple else "undecided"


def sure_half_width(order_error: float, degrees_of_freedom: float) -> float:
    """Half width of the 99.9 % interval of an order whose standard ``order_error`` has these ``degrees_of_freedom``."""
    return half_width(degrees_of_freedom, level=LOCK_NUMBERS.sure_level) * order_error


def revs_to_decide(order: float, *, relative_error: float, span_rev: float, revs_per_frame: float) -> float:
    """Revolutions of one recording after which ``order`` is known to be an exact multiple, or not.

    The phase of a line whose amplitude errs by ``relative_error`` over ``span_rev`` tells its order with a standard
    error of relative_error sqrt(12) / (2 pi span) (Rife and Boorstyn 1974); it falls with the length to the power
    3/2. The 99.9 % interval must become half as wide as ``least_slip`` of the order, and two frames of
    ``revs_per_frame`` are needed anyway.
    """
    error = relative_error * np.sqrt(12.0) / (2.0 * np.pi * span_rev)
    wanted = 0.5 * LOCK_NUMBERS.least_slip * order / half_width(np.inf, level=LOCK_NUMBERS.sure_level)
    return float(max(span_rev * (error / wanted) ** (2.0 / 3.0), LOCK_NUMBERS.fewest_frames * revs_per_frame))


NO_PULSES = Doubt("no pulses", "no encoder pulses: the number is as good as the speed from which the crank angle comes")
"""Of an order whose speed was stated or read from something else than a shaft's pulses."""

SpeedSource = Literal["pulses", "stated", "vibration"]


def speed_source(datasets: Sequence[xr.Dataset]) -> SpeedSource:
    """What the crank angle of ``datasets`` (frames, maps or tracks) comes from; one without a word on it has pulses.

    "vibration" where any comes from the very orders that are looked at, "stated" where any comes from a speed that was
    stated or recorded as a signal.
    """
    said = [flag["detail"] for dataset in datasets for flag in flags_of(dataset) if flag["flag"] == "no_index"]
    if any("taken from the vibration" in detail for detail in said):
        return "vibration"
    return "stated" if any("no encoder pulses" in detail for detail in said) else "pulses"


def proves_speed(numbers: Sequence[tuple[float, float, float]], *, revs_per_cycle: int) -> bool:
    """Whether orders prove that the speed is right by which they were told.

    A speed that is off moves all of them away from multiples of 1 / ``revs_per_cycle`` by one share. It is proven where
    two or more stand on multiples, none of them as far off as ``least_slip``, together so exactly that the slip of
    another shaft and an error of the speed would hardly make it up by chance.

    Parameters
    ----------
    numbers : of each order, told by its phase: the number, its standard error without that of the speed, its freedom
    revs_per_cycle : 1 or 2
    """
    off, half = [], []
    for order, error, freedom in numbers:
        multiple = nearest_multiple(order, revs_per_cycle=revs_per_cycle)
        share, reach = (order - multiple) / multiple, sure_half_width(error, freedom) / multiple
        if abs(share) <= reach and abs(share) + reach < LOCK_NUMBERS.least_slip:
            off.append(share)
            half.append(max(reach, 1e-12))
    if len(off) < LOCK_NUMBERS.fewest_orders:
        return False
    weight = 1.0 / np.square(half)
    together = 1.0 / np.sqrt(weight.sum())
    mean = abs(float(np.average(off, weights=weight)))
    if mean > together:
        return False
    # density, at no error at all, of what a slip and an error of the speed make together
    least, stated = LOCK_NUMBERS.least_slip, LOCK_NUMBERS.stated_speed_error
    slips = 0.5 * exp1(0.5 * (least / stated) ** 2) / np.log(LOCK_NUMBERS.largest_slip / least)
    density = float(slips / (np.sqrt(2.0 * np.pi) * stated))
    by_chance = LOCK_NUMBERS.other_shaft_chance ** len(off) * min(1.0, 2.0 * (mean + together) * density)
    return bool(by_chance < (1.0 - LOCK_NUMBERS.sure_level) * LOCK_NUMBERS.right_speed_share)


NUMBERS = MethodNumbers("5-identify-lines.toml", "line_phasors")

HANN_ENBW = 1.5
"""Noise bandwidth of a frame's bin [bins]."""

LEAST_APART_CYCLES = 0.25
"""Cycles over the recording below which two lines have run into one another."""


class Recording(NamedTuple):
    """Frames of a recording: ``spectrum`` (channels, frames, orders), the middle of each in rev, speeds in rpm.

    Frames are ``revs`` long and ``hop_rev`` apart.
    """

    spectrum: NDArray[np.complexfloating]
    centre_rev: Floats
    speed_rpm: Floats
    revs: float
    hop_rev: float

    @property
    def span_rev(self) -> float:
        """Revolutions that its frames cover; 0 without frames."""
        return float(np.ptp(self.centre_rev)) + self.revs if len(self.centre_rev) else 0.0


def any_swept(recordings: Sequence[Recording]) -> bool:
    """Whether the speed of any of ``recordings`` is that of a run-up or coast-down."""
    return any(is_swept(recording.speed_rpm) for recording in recordings)


def longest_rev(recordings: Sequence[Recording]) -> float:
    """Revolutions of the longest of ``recordings``; 0 where there is none."""
    return max((recording.span_rev for recording in recordings), default=0.0)


def recordings_of(frames: Sequence[xr.Dataset]) -> list[Recording]:
    """The recordings of ``frames`` (their OrderFrames) that can be taken together."""
    recordings = []
    for spectra in common_frames(frames)[0] if frames else ():
        revs, begin = float(spectra.attrs["revs_per_frame"]), spectra["crank_angle"].values.astype(np.float64)
        hop = max(float(np.median(np.diff(begin))) if len(begin) > 1 else revs, 1e-9)
        middle = begin + 0.5 * revs
        recordings.append(Recording(spectra["spectrum"].values, middle, spectra["speed"].values, revs, hop))
    return recordings


Phasors = tuple[Recording, Complexes, Floats, Floats]


class Bin(NamedTuple):
    """The bin ``at`` of some ``channels`` (numbers), from the least to the largest of ``speeds_rpm``.

    Give or take ``speed_bin_rpm``.
    """

    channels: list[int]
    at: int
    speeds_rpm: Floats
    speed_bin_rpm: float


def phasors_at(recordings: Sequence[Recording], place: Bin) -> dict[int, Phasors]:
    """Of each of ``recordings`` itself, the phasors (channels, frames) in the bin ``place``, frames' middles, speeds.

    Frames count whose speed is that of the bin and that are whole in all channels; recordings with fewer than two are
    left out.
    """
    picked: dict[int, Phasors] = {}
    channels, at = place.channels, place.at
    low, high = np.min(place.speeds_rpm) - place.speed_bin_rpm, np.max(place.speeds_rpm) + place.speed_bin_rpm
    for number, recording in enumerate(recordings):
        speed = recording.speed_rpm
        known = np.isfinite(low) and bool(np.isfinite(speed).all())
        at_speed = (speed >= low) & (speed <= high) if known else np.ones(len(speed), dtype=np.bool_)
        if np.count_nonzero(at_speed) < 2:
            continue
        phasors = np.asarray(recording.spectrum[channels, :, at], dtype=np.complex128)
        kept = at_speed & np.isfinite(phasors.real).all(axis=0)
        if np.count_nonzero(kept) >= 2:
            picked[number] = recording, phasors[:, kept], recording.centre_rev[kept], speed[kept]
    return picked


def zooms(recordings: Sequence[Recording], place: Bin, *, near: float, alone: bool = False) -> dict[int, Zoomed]:
    """The line in the bin ``place`` in each of ``recordings`` that shows it, by its number.

    ``near`` is the distance from the bin, in orders, that is expected; where ``alone`` no second line is looked for.
    """
    lines: dict[int, Zoomed] = {}
    for number, (recording, phasors, centre, speed) in phasors_at(recordings, place).items():
        swept = is_swept(speed)
        frames = Frames(centre, recording.revs, recording.hop_rev, swept, _drift(centre, speed))
        noise = _noise_beside(recording, place, centre) if swept else None
        line = zoomed(phasors, frames, noise=noise, near=near, alone=alone)
        if line is not None:
            lines[number] = _solved_together(line, recording, place, centre)
    return lines


def _solved_together(line: Zoomed, recording: Recording, place: Bin, centre_rev: Floats) -> Zoomed:
    """``line`` with its second one as the least squares of both say; as they are where these do not settle apart.

    From frame to frame the phase of a line tells its order but for multiples of the reciprocal hop; of these the second
    line has the one that leaves least in the bins beside.
    """
    second = line.second
    if second is None or line.swept:
        return line
    kept = np.isin(recording.centre_rev, centre_rev)
    frames = recording.spectrum[place.channels][:, kept], recording.centre_rev[kept]
    speed = np.nan_to_num(recording.speed_rpm[kept], nan=60.0)
    order, revs = place.at / recording.revs, recording.revs
    band = Band.about(HeldFrames.of(*frames, speed, revs=revs), order, order)
    if band is None:
        return line
    first = Place(turns=order + line.offset)
    starts = [Place(turns=order + second.offset + turns / recording.hop_rev) for turns in (-1, 0, 1)]
    fits = [joint_lines(band, [first, start]) for start in starts]
    best = int(np.argmin([float(fit.white.sum()) for fit in fits]))
    pair = joint_lines(band, [first, starts[best]], free=True)
    if abs(pair.orders[1] - pair.orders[0]) * line.span_rev < LEAST_APART_CYCLES:
        return line
    drift = (drift_turn_rev(_drift(frames[1], recording.speed_rpm[kept])) / line.span_rev) ** 2

    def solved(number: int, started: Zoomed) -> Zoomed:
        sighting = pair.sighting(number)
        offset, variance = sighting.order - order, sighting.order_error**2 + drift
        loss = float(hann_lobe(np.array(offset * revs)))
        size, error, snr = loss * sighting.phasor, abs(loss) * sighting.error, min(sighting.sigmas**2, 1e24)
        started = replace(started, offset=offset, variance=variance, dof=sighting.degrees_of_freedom)
        return replace(started, amplitude=size, error=error, snr=snr)

    # of what one bin holds of noise, two phasors and two numbers took three parts
    parts = HANN_ENBW * band.held.span_rev / revs
    left = np.square(np.abs(band.spectra(pair.left)[:, band.bins == place.at])).mean(axis=(0, 1)) * np.square(band.unit)
    left *= parts / max(parts - 3.0, 1.0)
    return replace(solved(0, line), second=solved(1, second), left=left)


def is_swept(speed_rpm: Floats) -> bool:
    """Whether frames at ``speed_rpm`` (frames,) are those of a run-up or coast-down; False where speed is not known."""
    return bool(len(speed_rpm) > 1 and speed_rpm.max() > ZOOM.swept_ratio * speed_rpm.min())


def _drift(centre_rev: Floats, speed_rpm: Floats) -> float:
    """Share by which ``speed_rpm`` (frames,) drifts from the first to the last frame; 0 where it is not known."""
    if not np.isfinite(speed_rpm).all() or not np.ptp(centre_rev) > 0.0:
        return 0.0
    turn = centre_rev - centre_rev.mean()
    slope = float(turn @ np.log(speed_rpm)) / float(turn @ turn)
    return abs(slope) * float(np.ptp(centre_rev))


def _noise_beside(recording: Recording, place: Bin, centre_rev: Floats) -> Floats:
    """Noise power (channels, frames) from the bins on both sides of that at ``place`` beyond its lobe."""
    spectrum = recording.spectrum
    (first, last), away = NUMBERS.noise_bins, np.abs(np.arange(spectrum.shape[2]) - place.at)
    bins = np.flatnonzero((away >= first) & (away <= last))
    frames = np.flatnonzero(np.isin(recording.centre_rev, centre_rev))
    power = np.square(np.abs(spectrum[np.ix_(np.array(place.channels), frames, bins[bins > 1])].astype(np.complex128)))
    median = np.nanmedian(np.where(np.isfinite(power), power, np.nan), axis=2) / np.log(2.0)
    return np.asarray(np.nan_to_num(median))


PARTED_NUMBERS = MethodNumbers("5-identify-lines.toml", "parted_lines")

SURE_FREEDOM = 1e6
"""Degrees of freedom of a number that a course tells: its errors are bounds."""

SAME_NUMBER = 1e-9
"""Numbers closer than this are one."""


class Followed(NamedTuple):
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


def parted_lines(followed: Sequence[xr.Dataset], *, near: float, reach: float) -> list[list[Followed]]:
    """The close lines about the order ``near``, lowest first, each in all recordings that part them; [] if none does.

    Lines stand out in sweeps of ``followed`` (RecordingTracks) and are less than ``reach`` orders from the next;
    recordings that show fewer of them than others hold a mixture and are left out.
    """
    groups = [(tracks, _chain(tracks, near, reach)) for tracks in followed if tracks.attrs.get("swept", 0)]
    most = max((len(group) for _, group in groups), default=0)
    if most < 2:
        return []
    parted = []
    for tracks, group in groups:
        if len(group) == most:
            apart = np.diff(tracks["order"].values[group], prepend=-np.inf, append=np.inf)
            nearest = np.minimum(apart[1:], apart[:-1]).tolist()
            parted.append([_read(tracks, place, away) for place, away in zip(group, nearest, strict=True)])
    return [list(lines) for lines in zip(*parted, strict=True)]


def stands_out(followed: Sequence[xr.Dataset], *, near: float, reach: float) -> bool | None:
    """Whether a line within ``reach`` orders of ``near`` stands out in a sweep of ``followed`` (RecordingTracks).

    None where none of them says what stands out.
    """
    said = [item for item in followed if "standing_out" in item.attrs]
    if not said:
        return None
    return any(abs(float(item["order"].values[place]) - near) < reach for item in said for place in standing_out(item))


def standing_out(tracks: xr.Dataset) -> list[int]:
    """Places of the orders of ``tracks`` that stand out in it: others were asked for."""
    out = np.atleast_1d(np.asarray(tracks.attrs.get("standing_out", ()), dtype=np.float64))
    if not len(out) or not tracks.sizes.get("frame", 0):
        return []
    return [k for k, number in enumerate(tracks["order"].values) if np.abs(out - number).min() < SAME_NUMBER]


def _chain(tracks: xr.Dataset, near: float, reach: float) -> list[int]:
    """Places of orders standing out in ``tracks``, each less than ``reach`` from the next, one so near to ``near``."""
    numbers, places = tracks["order"].values, standing_out(tracks)
    if not places:
        return []
    chains = np.split(np.array(places), np.flatnonzero(np.diff(numbers[places]) >= reach) + 1)
    distance, best = min((float(np.abs(numbers[chain] - near).min()), chain.tolist()) for chain in chains)
    return best if distance < reach else []


def _read(tracks: xr.Dataset, place: int, nearest: float) -> Followed:
    """The order number ``place`` of ``tracks``, which is ``nearest`` orders from the next line."""
    order, angle = float(tracks["order"].values[place]), tracks["crank_angle"].values
    values = tracks["amplitude"].values[:, place]
    noise = 2.0 * np.square(tracks["standard_error"].values[:, place])
    seen = np.isfinite(values) & np.isfinite(noise)
    channels = seen.any(axis=1)
    rows = channels.any() & seen[channels].all(axis=0)
    kept = np.ix_(channels, rows)
    course = course_of(values[kept], angle[rows], noise[kept])
    unread, span = (PARTED_NUMBERS.unread_share * nearest) ** 2, float(np.ptp(angle))
    bandwidth = float(np.median(tracks["bandwidth_hz"].values[place] * 60.0 / tracks["speed"].values))
    remembers = bandwidth * span < ZOOM.stretches
    variance = np.inf if course is None else (course.half / ZOOM.sure_sigmas) ** 2
    variance += (ZOOM.swept_turns_rev / span) ** 2 if remembers else 0.0
    if course is None or variance > unread:
        return Followed(tracks, place, order, unread, by_phase=False, course=None)
    witness = None if remembers or not len(course.slopes) else course
    return Followed(tracks, place, order + course.offset, variance, by_phase=True, course=witness)


def lines_of(
    lines: Sequence[OrderLine], followed: Sequence[Followed], *, speed_rpm: Floats, order: float, order_error: float
) -> list[OrderLine]:
    """Those of ``lines`` (one of each channel) in which the tracks of ``followed`` stand out, with their amplitudes.

    Each speed of the map, ``speed_rpm`` (speeds,), holds the row that is nearest to it; the lines are of ``order`` with
    its standard ``order_error``.
    """
    shown = []
    for line in lines:
        tracks = [track.tracks.isel(order=track.place).sel(channel=line.channel) for track in followed]
        speed, size, error, degrees_of_freedom = (
            np.concatenate([track[name].values for track in tracks])
            for name in ("speed", "amplitude", "standard_error", "degrees_of_freedom")
        )
        size, degrees_of_freedom = np.abs(size), degrees_of_freedom.astype(np.float64)
        clear = np.flatnonzero(np.isfinite(size) & np.isfinite(error) & (size > PARTED_NUMBERS.clear_sigmas * error))
        if not len(clear):
            continue
        apart = np.abs(speed_rpm[:, None] - speed[clear])
        inside = (speed_rpm >= speed[clear].min()) & (speed_rpm <= speed[clear].max())
        at = np.flatnonzero(inside) if inside.any() else np.array([int(np.nanargmin(apart.min(axis=1)))])
        row = clear[apart[at].argmin(axis=1)]
        read = line.read_again((order, order_error), at, speed[row], size[row], error[row], degrees_of_freedom[row])
        shown.append(replace(read, evidence="follows the speed"))
    return shown
