"""Lines whose amplitude changes while it is measured: the values that they held, and the words for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from crankorder.identify.intervals import half_width, half_widths

WIDER = 1.3
"""An interval that is so many times as wide as noise makes it is that of an amplitude that changes."""

CHANGE_CHANCE = 1e-4
"""Chance with which a steady line in noise seems to change …"""

LEAST_RATIO = 10.0
"""… by so many times the noise beside: a resonance beneath it makes less."""

Floats = NDArray[np.float64]


def remark_on(amplitude: Floats, error: Floats, freedom: Floats, ends: Floats) -> str:
    """What is said of a line whose amplitude changes at the speed at which it is largest; empty where it is steady.

    Parameters
    ----------
    amplitude : (speeds,), means over the recordings
    error : (speeds,), their standard errors
    freedom : (speeds,), degrees of freedom of these
    ends : (speeds, 2), of the 95 % intervals over all values that were held
    """
    at = int(np.argmax(amplitude))
    low, high = (float(end) for end in ends[at])
    reach = float(half_widths(freedom[at : at + 1])[0] * error[at])
    sides = float(amplitude[at]) - low, high - float(amplitude[at])
    if not np.isfinite(high) or not np.isfinite(reach) or max(sides) <= WIDER * reach or min(sides) <= 0.0:
        return ""
    if sides[1] > (1.0 + WIDER) * sides[0]:  # the factor by which recordings differ
        return ""
    return f"its amplitude changes within the recording, {low:.3g} to {high:.3g}"


@dataclass(frozen=True)
class HeldSizes:
    """What the frames of a line that is not locked held at one speed: ``means`` of each recording's amplitudes.

    ``ends`` are the least and the largest amplitude where these surely change within a recording, else None.
    """

    means: tuple[float, ...]
    ends: tuple[float, float] | None


def held_sizes(phasors: list[NDArray[np.complex128]], *, noise: float, worth: float) -> HeldSizes:
    """Amplitudes of a line that is not locked, by recording.

    Parameters
    ----------
    phasors : (frames,) of each recording at one speed
    noise : noise power of a frame
    worth : independent bins that it is told from
    """
    sizes = [np.abs(one[np.isfinite(one.real)]) for one in phasors]
    sizes = [one for one in sizes if len(one) > 1]
    means = tuple(float(np.sqrt(max(float(np.square(one).mean()) - noise, 0.0))) for one in sizes)
    freedom = float(sum(len(one) - 1 for one in sizes))
    if freedom < 2.0 or not noise > 0.0:
        return HeldSizes(means, None)
    scatter = sum(float(np.square(one - one.mean()).sum()) for one in sizes) / freedom
    surely = float(fdtri(freedom, 2.0 * worth * (freedom + 1.0), 1.0 - CHANGE_CHANCE))
    if 2.0 * scatter < noise * max(surely, LEAST_RATIO):
        return HeldSizes(means, None)
    every = np.concatenate(sizes)
    return HeldSizes(means, (float(every.min()), float(every.max())))


def between_of(held: HeldSizes, amplitude: float, error: float) -> tuple[float, float]:
    """Standard error of the mean ``amplitude`` and its degrees of freedom: of the frames or of the recordings.

    Whichever errs more; ``held`` is what the recordings held, ``error`` that of the frames, with endless freedom.
    """
    count = len(held.means)
    if count < 2 or not np.mean(held.means) > 0.0:
        return error, np.inf
    share = float(np.std(held.means, ddof=1) / np.mean(held.means) / np.sqrt(count))
    wider = half_width(count - 1.0) * share * amplitude > half_width(np.inf) * error
    return (share * amplitude, count - 1.0) if wider else (error, np.inf)


def ends_of(held: list[HeldSizes], amplitude: Floats, error: Floats, freedom: Floats, *, loss: float) -> Floats:
    """Ends (speeds, 2) of the 95 % intervals of amplitudes, over all values held.

    Parameters
    ----------
    held : of each speed
    amplitude : (speeds,)
    error : (speeds,), standard errors, with as many degrees of ``freedom``
    freedom : (speeds,)
    loss : share of the line that its bin shows, by which amplitudes are larger than those of frames
    """
    reach = half_widths(freedom) * error
    several = np.isfinite(freedom)  # recordings differ by a factor
    low = np.where(several, amplitude / (1.0 + reach / amplitude), np.maximum(amplitude - reach, 0.0))
    ends = np.stack([low, amplitude + reach], axis=1)
    for row, one in enumerate(held):
        if one.ends is not None:
            ends[row] = min(ends[row, 0], one.ends[0] / loss), max(ends[row, 1], one.ends[1] / loss)
    return ends
