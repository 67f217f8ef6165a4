"""Whether speeds close to one another show the same numbers: only then do they share a row of the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.orders.grouped_frames import AllFrames, Frames
from crankorder.orders.intervals import (
    beyond_chance,
    contrasts,
    frame_correlation,
    helped_by_beside,
    noise_of_mean,
    steepest_noise_beside,
)
from crankorder.shaft.speed_groups import Indices, held_speeds, speed_groups

ALIKE_SHARE = 0.01
"""Amplitudes that differ by less than this share of the larger are alike: speeds half a percent apart make no less."""

DIFFER_CHANCE = 1e-3
"""Chance that noise alone makes two speeds differ in any bin of any channel."""

Columns = NDArray[np.float64]


@dataclass(frozen=True)
class Bins:
    """``beside`` (orders, several) the bins whose noise is that of each, ``worth`` (orders,) so many independent ones.

    ``with_phase`` (orders,) says which orders have phases that recordings share.
    """

    beside: NDArray[np.int64]
    worth: NDArray[np.float64]
    with_phase: NDArray[np.bool_]


@dataclass(frozen=True)
class AtSpeed:
    """What frames held at one speed show, each (channels, orders).

    ``coherent`` the complex mean of the frames, ``error`` its noise power, ``energy`` the mean power, ``noise`` the
    noise power of one frame, ``powers`` the independent power spectra behind ``energy``, ``freedom`` the degrees of
    freedom of both noise powers.
    """

    coherent: NDArray[np.complex128]
    error: Columns
    energy: Columns
    noise: Columns
    powers: Columns
    freedom: Columns


def rows(every: AllFrames, *, bins: Bins, revs_per_frame: float, window: str, speed_bin_rpm: float) -> list[Indices]:
    """Frames of ``every`` recording that share a row of the map, slowest first; those of unknown speed by recording.

    Frames of a sweep fall into bins of ``speed_bin_rpm``. Speeds that are held, as in a stepped test, share a row
    within that width only where all that they show agrees; nothing says that two of unknown speed ran alike.
    ``bins`` say what noise is told from; ``revs_per_frame`` and ``window`` are those of the frames.
    """
    speed, owner = every.speed_rpm, every.owner
    known = speed_groups(speed, width_rpm=speed_bin_rpm, owner=owner)
    unknown = known.pop() if known and np.isnan(speed[known[-1][0]]) else np.empty(0, dtype=np.int64)
    held = held_speeds(speed, owner, width_rpm=speed_bin_rpm)
    place = np.full(len(speed), -1)
    for number, part in enumerate(held):
        place[part] = number
    made: list[Indices] = []
    for group in known:
        steps = np.unique(place[group])
        if len(steps) < 2 or steps[0] < 0:
            made.append(group)
            continue
        shown = [(held[k], _at_speed(every.of(held[k]), bins, revs_per_frame, window)) for k in steps.tolist()]
        made += _agreeing(shown, bins)
    return [*made, *(unknown[owner[unknown] == name] for name in np.unique(owner[unknown]))]


def _agreeing(shown: list[tuple[Indices, AtSpeed]], bins: Bins) -> list[Indices]:
    """The speeds ``shown``, each joined to the next slower row if all speeds of that row agree with it."""
    joined = [[shown[0]]]
    for one in shown[1:]:
        if all(agree(other[1], one[1], with_phase=bins.with_phase) for other in joined[-1]):
            joined[-1].append(one)
        else:
            joined.append([one])
    return [np.sort(np.concatenate([part for part, _ in row])) for row in joined]


def _at_speed(frames: Frames, bins: Bins, revs_per_frame: float, window: str) -> AtSpeed:
    """What ``frames`` held at one speed show."""
    correlation = frame_correlation(frames.begin_rev, frames.owner, revs_per_frame=revs_per_frame, window=window)
    shape, spectrum = contrasts(correlation), frames.spectrum
    mean, energy = spectrum.mean(axis=1), np.square(np.abs(spectrum)).mean(axis=1)
    own = np.full(energy.shape, 0.5 * shape.dof)
    powers = np.full(energy.shape, shape.independent_powers)
    noise = np.nan_to_num(noise_of_mean(spectrum, shape) / shape.mean_variance)
    noise, own = helped_by_beside(noise, own, energy=energy, powers=powers, bins=bins.beside, worth=bins.worth)
    louder = np.maximum(noise, steepest_noise_beside(energy, bins.beside))
    return AtSpeed(mean, noise * shape.mean_variance, energy, louder, powers, 2.0 * own)


def agree(first: AtSpeed, second: AtSpeed, *, with_phase: NDArray[np.bool_]) -> bool:
    """Whether ``first`` and ``second`` differ nowhere by more than their noise, or by 1 % of the line.

    Lines that are locked are compared by amplitude and phase, by amplitude alone where not ``with_phase`` (orders,);
    lines that slip by their energy.
    """
    freedom = np.maximum(np.minimum(first.freedom, second.freedom), 1.0)
    chance = DIFFER_CHANCE / (2.0 * max(first.energy.size, 1))
    size = np.abs(first.coherent), np.abs(second.coherent)
    apart = np.where(with_phase, np.abs(first.coherent - second.coherent), np.abs(size[0] - size[1]))
    locked = (apart**2 > (first.error + second.error) * beyond_chance(freedom, chance)) & (
        apart > ALIKE_SHARE * np.maximum(*size)
    )
    root = np.sqrt(first.energy), np.sqrt(second.energy)
    shared = 2.0 * np.maximum(first.noise / first.powers, second.noise / second.powers)
    louder = (np.square(root[0] - root[1]) > shared * beyond_chance(freedom, chance)) & (
        np.abs(root[0] - root[1]) > ALIKE_SHARE * np.maximum(*root)
    )
    return not bool((locked | louder).any())
