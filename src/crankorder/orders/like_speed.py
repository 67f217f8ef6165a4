"""Frames of a test at like speed: those of one length on one axis of orders, and the groups that share an average."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from crankorder.fft.windows import hann
from crankorder.orders.averages import (
    NEAREST_BINS,
    Contrasts,
    beside_bins,
    contrasts,
    helped_by_beside,
    neighbour_correlation,
    noise_of_mean,
    steepest_noise_beside,
)
from crankorder.orders.intervals import beyond_chance, phases_compare
from crankorder.quantities import Bools, Complexes, Floats, Ints, QualityFlag, Variables, remark, with_flags
from crankorder.shaft.speeds import Indices, held_speeds, speed_groups

LEAST_WINDOW = 0.1
"""Sum of the windows at an angle below which the signal is not regained there: its noise would be ten times as high."""

MOST_VALUES = 1 << 18
"""Samples of frames that are transformed back at a time: the memory does not grow with the recording."""

CUT_OVERLAP = 0.5
"""Share of a shorter frame, cut from longer ones, that the next one repeats."""

NEARLY = 0.75
"""Frames of this share of the common length and more are shown on its orders: their lines are that much wider."""

SWEPT_SHARE = 0.1
"""Share of a speed bin from which frames in it are taken to differ in speed."""

ALIKE_SHARE = 0.01
"""Amplitudes that differ by less than this share of the larger are alike: speeds half a percent apart make no less."""

DIFFER_CHANCE = 1e-3
"""Chance that noise alone makes two speeds differ in any bin of any channel."""


def common_frames(frames: Sequence[xr.Dataset]) -> tuple[list[xr.Dataset], list[QualityFlag]]:
    """Those of ``frames`` (OrderFrames) of one length, on the orders that all hold, and what was left out.

    The length is that of most, the longer one where two are as common; where a recording's own sweep asked for shorter
    frames it is the shortest of these. Longer frames are cut into such (:func:`reframed`), those of nearly that length
    are shown on its orders (:func:`at_orders_of`), both of which is "info". Those of any other length are left out,
    which is "bad". Recordings by crank angle of fewer samples per revolution end at a lower order: the others are cut
    there, and the remark is "info".
    """
    lengths = [int(item.attrs["revs_per_frame"]) for item in frames]
    swept = [int(item.attrs["revs_per_frame"]) for item in frames if item.attrs.get("frame_length_by") == "sweep"]
    common = min(swept) if swept else max(set(lengths), key=lambda length: (lengths.count(length), length))
    used, flags = [], []
    for item, length in zip(frames, lengths, strict=True):
        if length == common:
            used.append(item)
            continue
        made, flag = _at_length(item, common, by_sweep=bool(swept))
        used += [] if made is None else [made]
        flags.append(flag)
    fewest = min(item.sizes["order"] for item in used)
    for item in used:
        if item.sizes["order"] > fewest:
            ends = f"orders from {item['order'].values[fewest]:g} to {item['order'].values[-1]:g} left out"
            detail = f"{ends}: another recording of the test ends there"
            flags.append(remark(item.attrs["recording"], "orders_cut", detail))
    return [item if item.sizes["order"] == fewest else item.isel(order=slice(fewest)) for item in used], flags


def _at_length(item: xr.Dataset, revs: int, *, by_sweep: bool) -> tuple[xr.Dataset | None, QualityFlag]:
    """OrderFrames ``item`` as frames of ``revs`` revolutions, None where it cannot be, and what is told of it."""
    length = int(item.attrs["revs_per_frame"])
    if length > revs and length % revs == 0 and (cut := reframed(item, revs)) is not None:
        why = "the fastest sweep of the test asks for" if by_sweep else "most others have"
        detail = f"frames of {length} revolutions are cut into {revs}, as {why}"
        return cut, remark(item.attrs["recording"], "frames_cut", detail)
    if not by_sweep and NEARLY <= length / revs <= 1.0 / NEARLY and item.attrs["window"] == "hann":
        detail = f"frames of {length} revolutions are shown on the orders of {revs}, which most others have"
        return at_orders_of(item, revs), remark(item.attrs["recording"], "frames_on_common_orders", detail)
    detail = f"frames of {length} revolutions where most others have {revs}: left out"
    return None, remark(item.attrs["recording"], "frame_length_differs", detail, "bad")


def at_orders_of(item: xr.Dataset, revs: int) -> xr.Dataset:
    """OrderFrames ``item`` (channel, frame, order) at the orders of frames of ``revs`` revolutions.

    ``revs`` is nearly the length of its own frames. Each frame is transformed back and evaluated at those orders (the
    discrete-time Fourier transform of the same windowed samples): a line locked to the shaft keeps its amplitude and
    phase, and is as wide as the frames of ``item`` make it.
    """
    length, begin = int(item.attrs["revs_per_frame"]), item["crank_angle"].values
    per_rev = 2 * math.ceil((item.sizes["order"] - 1) / length) + 4
    pieces, window, limit = _pieces(item["spectrum"].values, begin, length, per_rev)
    order = np.arange((item.sizes["order"] - 1) * revs // length + 1) / revs
    turn = np.exp(-2j * np.pi * (np.outer(np.arange(pieces.shape[2]) / per_rev, order) % 1.0))
    made = (pieces @ turn) * (2.0 / window.sum()) * np.exp(-2j * np.pi * (np.outer(begin, order) % 1.0))
    made[:, order > limit[:, None] + 1e-9] = np.nan
    return _dataset(item, made, begin, item["speed"].values, revs, float(item.attrs["overlap"]))


def reframed(item: xr.Dataset, revs: int) -> xr.Dataset | None:
    """OrderFrames (channel, frame, order) of ``revs`` revolutions made of ``item`` of another length; None if none fit.

    Overlapping Hann windows add up to a smooth sum, so that the frames, transformed back, give the signal by crank
    angle up to the highest order. New frames of it are as if made from the recording, except at its two ends, where
    the only window is near 0.
    """
    length = int(item.attrs["revs_per_frame"])
    begin = item["crank_angle"].values
    n_orders = (item.sizes["order"] - 1) * revs // length + 1
    if item.attrs["window"] != "hann" or not len(begin):
        return None
    per_rev = 2 * math.ceil((item.sizes["order"] - 1) / length) + 4
    hop = max(1, round(revs * (1.0 - CUT_OVERLAP)))
    spectra, starts, speeds = [], [], []
    for run in np.split(np.arange(len(begin)), np.flatnonzero(np.diff(begin) >= length) + 1):
        spectrum = item["spectrum"].values[:, run[0] : run[-1] + 1]
        made, angle = _cut(spectrum, begin[run], (length, revs), hop, per_rev, n_orders)
        spectra.append(made)
        starts.append(angle)
        # beyond the ends the speed goes on as there
        known, speed = begin[run] + 0.5 * length, item["speed"].values[run]
        at = np.clip(np.searchsorted(known, angle + 0.5 * revs), 1, max(len(known) - 1, 1))
        slope = (speed[at] - speed[at - 1]) / (known[at] - known[at - 1]) if len(known) > 1 else 0.0
        speeds.append(speed[at - 1] + slope * (angle + 0.5 * revs - known[at - 1]))
    place = np.concatenate(starts)
    joined = spectra[0] if len(spectra) == 1 else np.concatenate(spectra, axis=1)
    return _dataset(item, joined, place, np.concatenate(speeds), revs) if len(place) else None


def _regained(spectrum: Complexes, begin_rev: Floats, place: Ints, length: int, per_rev: int) -> tuple[Floats, Floats]:
    """Signals (channels, samples) ``per_rev`` times in a revolution from the first frame on, and their limits.

    ``spectrum`` (channels, frames, orders) of frames of ``length`` revolutions from ``begin_rev`` (frames,) on, which
    are the samples from ``place`` (frames,) on. NaN are frames of a channel that a gap touches; the limits (samples,)
    are the orders up to which a frame there is known.
    """
    n = length * per_rev
    signal, weight = np.zeros((len(spectrum), place[-1] + n)), np.zeros(place[-1] + n)
    top = np.full(place[-1] + n, np.inf)
    for some in np.array_split(np.arange(len(place)), 1 + len(place) * n // MOST_VALUES):
        pieces, window, limit = _pieces(spectrum[:, some], begin_rev[some], length, per_rev)
        for frame, first in enumerate(place[some]):
            part = slice(first, first + n)
            signal[:, part] += pieces[:, frame]
            weight[part] += window
            top[part] = np.minimum(top[part], limit[frame])
    return signal / np.maximum(weight, LEAST_WINDOW), top


def _pieces(spectrum: Complexes, begin_rev: Floats, length: int, per_rev: int) -> tuple[Floats, Floats, Floats]:
    """Windowed frames (channels, frames, samples) of ``spectrum``, the window, and the order up to which each is known.

    Arguments as of :func:`_regained`.
    """
    n = length * per_rev
    axis = np.arange(spectrum.shape[2]) / length
    known = np.isfinite(spectrum.real)
    turned = np.where(known, spectrum, 0.0) * np.exp(2j * np.pi * (np.outer(begin_rev, axis) % 1.0))
    window = hann(n).values
    bins = np.zeros((*spectrum.shape[:2], n // 2 + 1), dtype=np.complex128)
    bins[..., : spectrum.shape[2]] = turned * (0.5 * window.sum())
    pieces = np.fft.irfft(bins, n, axis=2)
    pieces[~known[:, :, 0]] = np.nan
    return pieces, window, np.where(known.any(axis=0), axis, 0.0).max(axis=1)


def _cut(
    spectrum: Complexes, begin_rev: Floats, revs: tuple[int, int], hop: int, per_rev: int, n_orders: int
) -> tuple[Complexes, Floats]:
    """Spectra (channels, frames, ``n_orders``) of frames every ``hop`` revolutions, and where [rev] they begin.

    Made of the ``spectrum`` of frames without a hole between them from ``begin_rev`` on; ``revs``: the lengths of these
    and of those made. Some are made at a time: the signal between is larger than the spectra of a long recording.
    """
    known, n = revs[0] * per_rev, revs[1] * per_rev
    place = np.round((begin_rev - begin_rev[0]) * per_rev).astype(int)
    weight, window = np.zeros(place[-1] + known), hann(known).values
    for at in place:
        weight[at : at + known] += window
    seen = np.flatnonzero(weight >= LEAST_WINDOW)[[0, -1]]
    first = np.arange(math.ceil(seen[0] / per_rev) * per_rev, seen[1] + 2 - n, hop * per_rev)
    angle, axis, window = begin_rev[0] + first / per_rev, np.arange(n_orders) / revs[1], hann(n).values
    made = np.empty((len(spectrum), len(first), n_orders), dtype=np.complex128)
    for some in np.array_split(np.arange(len(first)), 1 + len(first) * n // MOST_VALUES) if len(first) else ():
        used = slice(*np.searchsorted(place, [first[some[0]] - known, first[some[-1]] + n], side="right"))
        near = place[used] - place[used][0]
        signal, top = _regained(spectrum[:, used], begin_rev[used], near, revs[0], per_rev)
        begin = first[some] - place[used][0]
        cut = np.fft.rfft(sliding_window_view(signal, n, axis=1)[:, begin] * window, axis=2)[..., :n_orders]
        cut *= 2.0 / window.sum()
        cut[:, axis > sliding_window_view(top, n)[begin].min(axis=1)[:, None] + 1e-9] = np.nan
        made[:, some] = cut * np.exp(-2j * np.pi * (np.outer(angle[some], axis) % 1.0))
    return made, angle


def _dataset(
    item: xr.Dataset, spectrum: Complexes, begin_rev: Floats, speed_rpm: Floats, revs: int, overlap: float = CUT_OVERLAP
) -> xr.Dataset:
    order = np.arange(spectrum.shape[2]) / revs
    variables = {"spectrum": (("channel", "frame", "order"), spectrum, item["spectrum"].attrs)}
    axes = {"order": ("order", order), "speed": ("frame", speed_rpm), "crank_angle": ("frame", begin_rev)}
    kept = {name: item[name] for name in item.coords if item[name].dims == ("channel",)}
    known: Variables = {name: (*axis, item[name].attrs) for name, axis in axes.items()}
    made = xr.Dataset(variables, coords=kept, attrs=item.attrs | {"revs_per_frame": revs, "overlap": overlap})
    return with_flags(made.assign_coords(known), [])


class Frames(NamedTuple):
    """Frames to average: ``spectrum`` (channels, frames, orders); the other fields are (frames,).

    ``owner`` is the number of the recording, ``begin_rev`` the crank angle [rev] at which the frame begins,
    ``speed_rpm`` its mean speed.
    """

    spectrum: Complexes
    owner: Ints
    begin_rev: Floats
    speed_rpm: Floats

    def of(self, which: Bools) -> Frames:
        """The frames where ``which`` (frames,) is true."""
        return Frames(self.spectrum[:, which], self.owner[which], self.begin_rev[which], self.speed_rpm[which])


class AllFrames(NamedTuple):
    """Frames of all recordings, whose spectra are joined only where a group needs those of several.

    ``spectra`` (channels, frames, orders) of each recording; ``owner``, ``begin_rev``, ``speed_rpm`` (frames,) of all
    frames, as in :class:`Frames`; ``exponent`` (channels,) of the power of two that is taken out of each channel.
    """

    spectra: list[NDArray[np.complexfloating]]
    owner: Ints
    begin_rev: Floats
    speed_rpm: Floats
    exponent: Ints

    @property
    def unit(self) -> Floats:
        """Factor (channels, 1, 1) that is taken out of each channel, a power of two."""
        return np.ldexp(1.0, self.exponent)[:, None, None]

    def of(self, which: Ints) -> Frames:
        """The frames numbered ``which`` (picked,), rising; a view where they are neighbours."""
        owner, first = self.owner[which], np.searchsorted(self.owner, np.arange(len(self.spectra)))
        parts = []
        for name in np.unique(owner):
            rows = which[owner == name] - first[name]
            near = rows[-1] - rows[0] == len(rows) - 1
            parts.append(self.spectra[name][:, slice(int(rows[0]), int(rows[-1]) + 1) if near else rows])
        joined = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        spectrum = np.asarray(joined, dtype=np.complex128)
        if self.exponent.any():
            half = self.exponent // 2  # the power of two itself may not be a number
            factors = np.ldexp(1.0, -half), np.ldexp(1.0, half - self.exponent)
            spectrum = spectrum * factors[0][:, None, None] * factors[1][:, None, None]
        return Frames(spectrum, owner, self.begin_rev[which], self.speed_rpm[which])


def all_frames(used: Sequence[xr.Dataset]) -> AllFrames:
    """Frames of all recordings: ``used`` are their OrderFrames (channel, frame, order), with frames of equal length.

    A power of two is taken out only where squares would leave the range of floating-point numbers.
    """
    largest = np.max([_largest(item["spectrum"].values) for item in used], axis=0)
    exponent = np.where(np.isfinite(largest) & (largest > 0.0), np.frexp(largest)[1], 0)
    return AllFrames(
        [item["spectrum"].values for item in used],
        np.concatenate([np.full(item.sizes["frame"], k) for k, item in enumerate(used)]),
        np.concatenate([item["crank_angle"].values for item in used]),
        np.concatenate([item["speed"].values for item in used]),
        np.where(np.abs(exponent) > 64, exponent, 0),
    )


def _largest(spectrum: Complexes) -> Floats:
    """Largest real or imaginary part of each channel, NaN left out."""
    parts = np.ascontiguousarray(spectrum).reshape(len(spectrum), -1)
    parts = parts.view(parts.real.dtype)
    return np.asarray(np.fmax(np.fmax.reduce(parts, axis=1), -np.fmin.reduce(parts, axis=1)), dtype=np.float64)


class Framing(NamedTuple):
    """How frames lie and what their noise is told from.

    ``revs`` is their length, ``window`` its name; speeds that differ by over ``swept_rpm`` may change amplitudes.
    ``with_phase`` (orders,) says which orders have phases that recordings share, ``beside`` (orders, several) the bins
    whose noise is that of each, ``worth`` (orders,) how many independent bins these are; empty where orders are no
    neighbours.
    """

    revs: float
    window: str
    swept_rpm: float
    with_phase: Bools
    beside: Ints
    worth: Floats

    def contrasts_of(self, frames: Frames) -> Contrasts:
        """Contrasts of ``frames`` by their overlap, along their speeds too where these are swept."""
        begin, owner = frames.begin_rev, frames.owner
        correlation = neighbour_correlation(begin, owner, revs_per_frame=self.revs, window=self.window)
        swept = float(np.ptp(frames.speed_rpm)) > self.swept_rpm  # False where unknown
        return contrasts(correlation, frames.speed_rpm if swept else None)


class AtSpeed(NamedTuple):
    """What frames held at one speed show, each field (channels, orders).

    ``coherent`` is the complex mean of the frames, ``error`` its noise power, ``energy`` the mean power, ``noise`` the
    noise power of one frame, ``powers`` the number of independent power spectra behind ``energy``, ``freedom`` the
    degrees of freedom of both noise powers.
    """

    coherent: Complexes
    error: Floats
    energy: Floats
    noise: Floats
    powers: Floats
    freedom: Floats


class LikeSpeedFrames(NamedTuple):
    """Frames of a test and the rows of like speed that they are averaged in.

    ``used`` are the OrderFrames taken, ``remarks`` say what was left out, ``every`` has their frames, ``framing`` how
    these lie, ``groups`` the indices (frames of the row,) of the frames of each row, slowest first.
    """

    used: list[xr.Dataset]
    remarks: list[QualityFlag]
    every: AllFrames
    framing: Framing
    groups: list[Indices]

    @property
    def speed_rpm(self) -> Floats:
        """Mean speed (rows,) of the frames of each row."""
        return np.array([np.mean(self.every.speed_rpm[group]) for group in self.groups])

    def at_columns(self, columns: Ints) -> LikeSpeedFrames:
        """The frames at the orders numbered ``columns`` (chosen,), rising; their phases are taken to be shared."""
        every = self.every._replace(spectra=[spectrum[:, :, columns] for spectrum in self.every.spectra])
        beside = np.minimum(np.searchsorted(columns, self.framing.beside[columns]), len(columns) - 1)
        shared, worth = np.ones(len(columns), dtype=np.bool_), self.framing.worth[columns]
        return self._replace(every=every, framing=self.framing._replace(with_phase=shared, beside=beside, worth=worth))


def like_speed_frames(frames: list[xr.Dataset], *, speed_bin_rpm: float) -> LikeSpeedFrames:
    """All ``frames`` (OrderFrames) that :func:`common_frames` takes, in rows of like speed.

    Frames of a sweep fall into bins of ``speed_bin_rpm``. Speeds that are held, as in a stepped test, share a row
    within that width only where their spectra agree. Each recording of unknown speed has a row of its own, as nothing
    says that two of them ran alike.
    """
    used, remarks = common_frames(frames)
    every, attrs, order = all_frames(used), used[0].attrs, used[0]["order"].values
    beside = beside_bins(order, line_step=1.0 / int(attrs["revs_per_cycle"]), count=NEAREST_BINS)
    revs, swept_rpm = float(attrs["revs_per_frame"]), SWEPT_SHARE * speed_bin_rpm
    framing = Framing(revs, str(attrs["window"]), swept_rpm, phases_compare(used, order), *beside)
    speed, owner = every.speed_rpm, every.owner
    groups = speed_groups(speed, width_rpm=speed_bin_rpm, owner=owner)
    if groups and np.isnan(speed[groups[-1][0]]):
        unknown = groups.pop()
        groups += [unknown[owner[unknown] == name] for name in np.unique(owner[unknown])]
    held = held_speeds(speed, owner, width_rpm=speed_bin_rpm)
    place = np.full(len(speed), -1)
    for number, part in enumerate(held):
        place[part] = number
    rows: list[Indices] = []
    for group in groups:
        steps = np.unique(place[group])
        if len(steps) < 2 or steps[0] < 0:
            rows.append(group)
            continue
        joined: list[list[tuple[Indices, AtSpeed]]] = []
        for k in steps.tolist():
            at_speed = _at_speed(every.of(held[k]), framing)
            # it joins the next slower row if all speeds of that row agree with it
            if not joined or not all(agree(other, at_speed, with_phase=framing.with_phase) for _, other in joined[-1]):
                joined.append([])
            joined[-1].append((held[k], at_speed))
        rows += [np.sort(np.concatenate([part for part, _ in row])) for row in joined]
    return LikeSpeedFrames(used, remarks, every, framing, rows)


def _at_speed(frames: Frames, framing: Framing) -> AtSpeed:
    """What ``frames`` held at one speed show."""
    shape, spectrum = framing._replace(swept_rpm=np.inf).contrasts_of(frames), frames.spectrum
    mean, energy = spectrum.mean(axis=1), np.square(np.abs(spectrum)).mean(axis=1)
    own = np.full(energy.shape, 0.5 * shape.dof)
    powers = np.full(energy.shape, shape.independent_powers)
    noise = np.nan_to_num(noise_of_mean(spectrum, shape) / shape.mean_variance)
    noise, own = helped_by_beside(noise, own, energy, powers, bins=framing.beside, worth=framing.worth)
    louder = np.maximum(noise, steepest_noise_beside(energy, framing.beside))
    return AtSpeed(mean, noise * shape.mean_variance, energy, louder, powers, 2.0 * own)


def agree(first: AtSpeed, second: AtSpeed, *, with_phase: Bools) -> bool:
    """Whether ``first`` and ``second`` differ nowhere by more than their noise, or by 1 % of the line.

    Locked lines are compared by amplitude and phase, or by amplitude only where ``with_phase`` (orders,) is False;
    lines that slip are compared by energy.
    """
    freedom = np.maximum(np.minimum(first.freedom, second.freedom), 1.0)
    chance = DIFFER_CHANCE / (2.0 * max(first.energy.size, 1))
    size = np.abs(first.coherent), np.abs(second.coherent)
    apart = np.where(with_phase, np.abs(first.coherent - second.coherent), np.abs(size[0] - size[1]))
    beyond = beyond_chance(freedom, chance)
    locked = (apart**2 > (first.error + second.error) * beyond) & (apart > ALIKE_SHARE * np.maximum(*size))
    root = np.sqrt(first.energy), np.sqrt(second.energy)
    shared = 2.0 * np.maximum(first.noise / first.powers, second.noise / second.powers)
    more = np.abs(root[0] - root[1])
    louder = (np.square(more) > shared * beyond) & (more > ALIKE_SHARE * np.maximum(*root))
    return not bool((locked | louder).any())
