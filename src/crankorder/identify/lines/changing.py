"""Lines whose amplitude changes while it is measured: the values that they held, and the words for it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from crankorder.identify.intervals import half_widths

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


def held_sizes(phasors: list[NDArray[np.complex128]], *, noise: float, worth: float) -> tuple[float, float] | None:
    """Least and largest amplitude of a line that is not locked where it surely changes; None where it is steady.

    Parameters
    ----------
    phasors : (frames,) of each recording at one speed
    noise : noise power of a frame
    worth : independent bins that it is told from
    """
    sizes = [np.abs(one[np.isfinite(one.real)]) for one in phasors]
    freedom = float(sum(len(one) - 1 for one in sizes if len(one) > 1))
    if freedom < 2.0 or not noise > 0.0:
        return None
    scatter = sum(float(np.square(one - one.mean()).sum()) for one in sizes if len(one) > 1) / freedom
    surely = float(fdtri(freedom, 2.0 * worth * (freedom + 1.0), 1.0 - CHANGE_CHANCE))
    if 2.0 * scatter < noise * max(surely, LEAST_RATIO):
        return None
    every = np.concatenate(sizes)
    return float(every.min()), float(every.max())
