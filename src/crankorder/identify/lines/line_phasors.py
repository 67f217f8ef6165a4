"""Phasors of a line in the frames of all recordings, and what their turn tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.lines.zoom import NUMBERS as ZOOM
from crankorder.identify.lines.zoom import PAIR_NUMBERS as CLOSE_PAIR
from crankorder.identify.lines.zoom import Zoomed, unaliased, zoomed
from crankorder.orders.like_speed import common_frames
from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-lines.toml", "line_phasors")


@dataclass(frozen=True)
class Recording:
    """Frames of a recording: ``spectrum`` (channels, frames, orders), the middle of each in rev, speeds in rpm.

    Frames are ``revs`` long and ``hop_rev`` apart.
    """

    spectrum: NDArray[np.complexfloating]
    centre_rev: Floats
    speed_rpm: Floats
    revs: float
    hop_rev: float


def recordings_of(frames: Sequence[xr.Dataset]) -> list[Recording]:
    """The recordings of ``frames`` (their OrderFrames) that can be taken together."""
    return [_recording(item) for item in (common_frames(frames)[0] if frames else [])]


def _recording(item: xr.Dataset) -> Recording:
    revs = float(item.attrs["revs_per_frame"])
    begin = item["crank_angle"].values.astype(np.float64)
    hop = float(np.median(np.diff(begin))) if len(begin) > 1 else revs
    return Recording(item["spectrum"].values, begin + 0.5 * revs, item["speed"].values, revs, max(hop, 1e-9))


Phasors = tuple[Recording, Complexes, Floats, Floats]


def phasors_at(
    recordings: Sequence[Recording], *, channels: list[int], at: int, speeds_rpm: Floats, speed_bin_rpm: float
) -> dict[int, Phasors]:
    """Of each of ``recordings`` itself, the phasors (channels, frames) in the bin ``at``, the frames' middles, speeds.

    Frames of ``channels`` count whose speed is between the least and the largest of ``speeds_rpm``, give or take
    ``speed_bin_rpm``, and that are whole in all channels; recordings with fewer than two are left out.
    """
    found: dict[int, Phasors] = {}
    low, high = float(np.min(speeds_rpm)) - speed_bin_rpm, float(np.max(speeds_rpm)) + speed_bin_rpm
    for number, item in enumerate(recordings):
        speed = item.speed_rpm
        known = np.isfinite(low) and bool(np.isfinite(speed).all())
        at_speed = (speed >= low) & (speed <= high) if known else np.ones(len(speed), dtype=np.bool_)
        if np.count_nonzero(at_speed) < 2:
            continue
        phasors = np.asarray(item.spectrum[channels, :, at], dtype=np.complex128)
        kept = at_speed & np.isfinite(phasors.real).all(axis=0)
        if np.count_nonzero(kept) >= 2:
            found[number] = item, phasors[:, kept], item.centre_rev[kept], speed[kept]
    return found


def zooms(
    recordings: Sequence[Recording],
    *,
    channels: list[int],
    at: int,
    speeds_rpm: Floats,
    speed_bin_rpm: float,
    near: float,
    alone: bool = False,
) -> dict[int, Zoomed]:
    """The line in the bin ``at`` of the ``channels`` in each of ``recordings`` that shows it, by its number.

    ``speeds_rpm`` and ``speed_bin_rpm`` pick frames as in :func:`phasors_at`; ``near`` is the distance from the bin, in
    orders, that is expected; where ``alone`` no second line is looked for.
    """
    picked = phasors_at(recordings, channels=channels, at=at, speeds_rpm=speeds_rpm, speed_bin_rpm=speed_bin_rpm)
    found: dict[int, Zoomed] = {}
    for number, (item, phasors, centre, speed) in picked.items():
        swept = is_swept(speed)
        line = zoomed(
            phasors,
            centre,
            revs=item.revs,
            hop_rev=item.hop_rev,
            swept=swept,
            drift=_drift(centre, speed),
            noise=_noise_beside(item, channels, at, centre) if swept else None,
            near=near,
            alone=alone,
        )
        if line is not None:
            found[number] = _unaliased(line, item, channels, at, centre)
    return found


def _unaliased(line: Zoomed, item: Recording, channels: list[int], at: int, centre_rev: Floats) -> Zoomed:
    """``line`` with its second one where the bins beside say that it is."""
    bins = np.arange(at - CLOSE_PAIR.side_bins, at + CLOSE_PAIR.side_bins + 1)
    if line.second is None or bins[0] < 1 or bins[-1] >= item.spectrum.shape[2]:
        return line
    frames = np.isin(item.centre_rev, centre_rev)
    phasors = np.moveaxis(item.spectrum[channels][:, frames][:, :, bins], 1, 2).astype(np.complex128)
    turn = centre_rev - 0.5 * (centre_rev[0] + centre_rev[-1])
    offsets = line.offset, line.second.offset
    offset = unaliased(np.nan_to_num(phasors), turn, offsets=offsets, resolution=1.0 / item.revs, hop_rev=item.hop_rev)
    return replace(line, second=replace(line.second, offset=offset))


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


def _noise_beside(item: Recording, channels: list[int], at: int, centre_rev: Floats) -> Floats:
    """Noise power (channels, frames) from the bins on both sides of ``at`` beyond its lobe."""
    n_orders = item.spectrum.shape[2]
    first, last = NUMBERS.noise_bins
    beside = [*range(at - last, at - first + 1), *range(at + first, at + last + 1)]
    bins = [k for k in beside if 1 < k < n_orders]
    frames = np.flatnonzero(np.isin(item.centre_rev, centre_rev))
    power = np.square(np.abs(item.spectrum[np.ix_(np.array(channels), frames, np.array(bins))].astype(np.complex128)))
    median = np.nanmedian(np.where(np.isfinite(power), power, np.nan), axis=2) / np.log(2.0)
    return np.asarray(np.nan_to_num(median))
