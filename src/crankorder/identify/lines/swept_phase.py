"""The order of a line in a run-up, whose phase the modes turn that it crosses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STRETCHES = 10
"""Parts of a run-up whose turns are compared: a mode turns the phase in a few of them, a slip evenly in all."""

DENSEST_SHARE = 0.4
"""Share of the stretches that turn most alike: between modes the phase stands still, or runs as the slip says."""

MODE_TAILS = 0.03
"""Turn [rev] of a stretch that the tails of modes leave where none is crossed."""

LARGEST_SCATTER = 0.06
"""Steps from frame to frame whose turn [rev] noise moves by more tell nothing."""

FEWEST_STEPS = 6
"""Steps from frame to frame from which on stretches can be compared."""

SURE_SIGMAS = 3.3
"""Standard deviations within which noise stays 999 times in 1000."""

LEAST_TURNS = 2.0
"""A slip turns the phase so often over the whole run-up: eight modes crossed one way make four at most …"""

EVEN_SHARE = 0.35
"""… but not evenly: the stretches that turn most alike scatter by less than this share of their turn …"""

ONE_WAY_SHARE = 0.8
"""… and so many of all stretches turn the same way."""

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """How the phase of a line runs over a recording: at ``offset`` orders from its bin, surely within ``half`` orders.

    ``slopes`` (stretches,) are those of its stretches, each known within ``reach``; they cover ``span_rev``.
    ``alike`` is the length of the mean of the unit phasors of its ``steps`` from frame to frame: 1 where all are alike.
    """

    offset: float
    half: float
    slopes: Floats
    reach: float
    span_rev: float
    alike: float
    steps: int

    def slips_from(self, offset: float) -> bool:
        """Whether the phase runs away from that of a line ``offset`` orders from the bin as modes cannot make it."""
        slope = self.slopes - offset
        mean = self.offset - offset
        if abs(mean) * self.span_rev < LEAST_TURNS or self.half > EVEN_SHARE * abs(mean):
            return False
        return float(np.mean(slope * np.sign(mean) > self.reach)) >= ONE_WAY_SHARE


def course_of(phasors: Complex, turn: Floats, noise: Floats) -> Course | None:
    """How the phase of the line in ``phasors`` runs over a run-up; None where too few frames show it.

    Its turn per revolution is that at which most stretches of the run-up agree: a mode adds up to half a turn where it
    is crossed, several add up, but between them a locked line stands still. A slip turns all stretches alike.

    Parameters
    ----------
    phasors : (channels, frames), complex amplitudes in one bin whose phase is that from crank angle 0
    turn : (frames,), rev, crank angle of the middle of each frame
    noise : (channels, frames), noise power of each
    """
    scaled = phasors / np.sqrt(np.maximum(noise, 1e-300))
    product = (scaled[:, 1:] * scaled[:, :-1].conj()).sum(axis=0)
    power = np.square(np.abs(scaled)).sum(axis=0)
    size = np.maximum(np.abs(product), 1e-300)
    scatter = np.sqrt(0.5 * (power[1:] + power[:-1]) + len(phasors)) / size / (2.0 * np.pi)
    step, hop = np.angle(product) / (2.0 * np.pi), np.diff(turn)
    kept = scatter < LARGEST_SCATTER
    if np.count_nonzero(kept) < FEWEST_STEPS:
        return None
    step, hop, scatter = step[kept], hop[kept], scatter[kept]
    width = max(1, len(step) // STRETCHES)
    path = np.concatenate([[0.0], np.cumsum(step)])
    along = np.concatenate([[0.0], np.cumsum(hop)])
    length = along[width:] - along[:-width]
    slopes = (path[width:] - path[:-width]) / length
    noise_of_slope = float(np.sqrt(2.0) * np.median(scatter)) / float(np.median(length))
    ordered, count = np.sort(slopes), max(2, int(np.ceil(DENSEST_SHARE * len(slopes))))
    spans = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    first = int(np.argmin(spans))
    offset = float(np.median(ordered[first : first + count]))
    tails = MODE_TAILS / float(np.median(length))
    independent = max(1.0, count / width)
    alike = float(np.abs(np.exp(2j * np.pi * step).mean()))
    half = 0.5 * float(spans[first]) + SURE_SIGMAS * noise_of_slope / float(np.sqrt(independent)) + tails
    return Course(offset, half, slopes, SURE_SIGMAS * noise_of_slope + tails, float(along[-1]), alike, len(step))
