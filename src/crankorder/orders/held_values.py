"""Whether a line keeps its amplitude and phase while it is measured, and the values that it holds where it does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from crankorder.orders.intervals import Contrasts

BESIDE_WORTH = 2.0
"""Independent bins that the bins beside are worth."""

LEAST_POWER = 4.0
"""A line is looked at whose power is so many times the noise power of its mean."""

CHANGE_CHANCE = 0.002
"""Chance with which the noise of a steady line looks like a change of its amplitude, or of its phase."""

BOTH_RATIO, BOTH_CHANCE = 30.0, 1e-6
"""Slow waves so many times the noise beside, which it makes with such a chance, change amplitude and phase at once:
two lines too close to be parted do. A resonance within a bin seldom stands so far over the bins beside."""

MOST_BLOCKS = 8
"""Stretches of a recording whose means are the values that it held."""

Columns = NDArray[np.float64]


@dataclass(frozen=True)
class Held:
    """Noise power of the mean without what the line itself does, and the values that it held.

    ``least`` and ``most`` amplitude of it, NaN where that is steady; ``turned`` its largest distance [rad] from the
    mean phase, 0 where that is steady; each (channels, orders).
    """

    noise: Columns
    least: Columns
    most: Columns
    turned: Columns


def held_values(
    spectrum: NDArray[np.complex128],
    owner: NDArray[np.int64],
    *,
    mean: NDArray[np.complex128],
    noise: Columns,
    shape: Contrasts,
    beside: Columns | None = None,
) -> Held:
    """Values that lines held within the recordings where these surely differ, and the ``noise`` without them.

    Noise turns a line as much as it lengthens it. Slow waves along a line that are far larger than those across it
    are therefore changes of its amplitude, and the other way round of its phase.

    Parameters
    ----------
    spectrum : (channels, frames, orders)
    owner : (frames,), number of the recording of each
    mean : (channels, orders), mean over the frames
    noise : (channels, orders), noise power of ``mean`` as of :func:`~crankorder.orders.intervals.noise_of_mean`
    shape : contrasts of the frames
    beside : (channels, orders), noise power of a frame by the bins beside; None where it is not known
    """
    nothing = np.full(mean.shape, np.nan)
    held = Held(noise.copy(), nothing, nothing.copy(), np.zeros(mean.shape))
    owners = np.unique(owner)
    freedom = 0.5 * shape.dof - (len(owners) - 1.0)
    if freedom < 1.0:
        return held
    with np.errstate(invalid="ignore"):
        channel, order = np.nonzero(np.square(np.abs(mean)) > LEAST_POWER * noise)
    if not len(channel):
        return held
    centre = mean[channel, order]
    size = np.abs(centre)
    apart = spectrum[channel, :, order] * (centre.conj() / size)[:, None]
    for name in owners:
        mine = owner == name
        apart[:, mine] -= apart[:, mine].mean(axis=1, keepdims=True)
    waves = apart @ shape.rows.T
    along, across = np.square(waves.real).sum(axis=1), np.square(waves.imag).sum(axis=1)
    surely = float(fdtri(freedom, freedom, 1.0 - CHANGE_CHANCE))
    swells, turns = along > surely * across, across > surely * along
    both = _changes_both(along + across, channel, order, beside=beside, shape=shape)
    low, high, turn = _extremes(spectrum[channel, :, order] * (centre.conj() / size)[:, None], owner)
    longer, turned = swells | both, turns | both
    held.least[channel[longer], order[longer]] = low[longer]
    held.most[channel[longer], order[longer]] = high[longer]
    held.turned[channel[turned], order[turned]] = turn[turned]
    alone = 2.0 * np.minimum(along, across) / len(shape.rows) * (0.5 * shape.dof / freedom)
    held.noise[channel, order] = np.where(swells | turns, alone, noise[channel, order])
    return held


def _changes_both(
    waves: NDArray[np.float64],
    channel: NDArray[np.int64],
    order: NDArray[np.int64],
    *,
    beside: Columns | None,
    shape: Contrasts,
) -> NDArray[np.bool_]:
    """Where the power of slow ``waves`` (lines,) is far more than the noise ``beside`` makes."""
    if beside is None:
        return np.zeros(len(waves), dtype=np.bool_)
    ratio = waves / len(shape.rows) / np.maximum(beside[channel, order] * shape.mean_variance, 1e-300)
    surely = float(fdtri(shape.dof, 2.0 * shape.independent_powers * BESIDE_WORTH, 1.0 - BOTH_CHANCE))
    return np.asarray(ratio > max(BOTH_RATIO, surely))


def _extremes(
    turned_back: NDArray[np.complex128], owner: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest amplitude and largest turn [rad] of stretches of ``turned_back`` (lines, frames)."""
    means = []
    for name in np.unique(owner):
        mine = np.flatnonzero(owner == name)
        means += [turned_back[:, part].mean(axis=1) for part in np.array_split(mine, min(MOST_BLOCKS, len(mine)))]
    values = np.stack(means, axis=1)
    size = np.abs(values)
    least, most, turn = size.min(axis=1), size.max(axis=1), np.abs(np.angle(values)).max(axis=1)
    beyond = (most - least) / (2.0 * len(means))  # a ramp goes on for half a stretch
    return np.maximum(least - beyond, 0.5 * least), most + beyond, turn * (1.0 + 1.0 / len(means))
