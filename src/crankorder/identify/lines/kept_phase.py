"""Whether a line keeps its phase while its amplitude changes: noise and what it excites swell and turn alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from crankorder.identify.lines.line_evidence import LEAST_DAMPING

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]

LEAST_FRAMES = 3.0
"""Frames that must share the power of a line: one and its neighbour lie on one axis whatever they hold."""

REFINEMENTS = 3
"""Steps of least squares from the best of them to where the part across the axis is least."""

TRIALS_PER_SPAN = 8
"""Trial distances from the bin in which a line turns once over the recording."""


def keeps_its_phase(
    recordings: Sequence[tuple[Complex, Floats, float]],
    *,
    order: float,
    worth: float,
    slips: bool,
    false_alarm_probability: float,
) -> bool:
    """Whether a line keeps its phase in ``recordings`` as noise would only with ``false_alarm_probability``.

    Parameters
    ----------
    recordings : of each the phasors (frames,) of one bin, the middles of its frames [rev] and the hop between them
    order : of the bin
    worth : independent frames that each is worth, 0…1
    slips : whether it may turn away from its bin evenly; otherwise it is locked to the shaft
    """
    evidence = 0.0
    for phasors, centre, hop_rev in recordings:
        turn, offset, trials = centre - centre.mean(), 0.0, 1
        if slips:
            offset, trials = best_offset(phasors, turn, hop_rev=hop_rev)
        forgotten = 2.0 * np.pi * LEAST_DAMPING * order * float(np.ptp(turn))
        chance = log_chance_of_phase(phasors, turn, offset=offset, forgotten=forgotten, worth=worth, fitted=int(slips))
        evidence -= min(0.0, chance + float(np.log(trials)))
    return len(recordings) > 0 and bool(gammaincc(len(recordings), evidence) < false_alarm_probability)


def log_chance_of_phase(
    phasors: Complex, turn: Floats, *, offset: float, forgotten: float, worth: float, fitted: int = 0
) -> float:
    """Logarithm of the chance (at most) that noise keeps one phase over the frames as well as ``phasors`` do.

    A line whose amplitude changes stays on one axis of the complex plane, whatever the amplitude does. Of noise, and of
    a resonance that it excites, the part across any axis is as large as the part along it on average: of n independent
    frames the smaller share is below s with a chance of (4 s (1 - s))^((n - 1) / 2) (Mauchly 1940). Frames of a
    resonance remember each other, which leaves fewer: the part across tells how many, for a change of amplitude does
    not touch it. A line whose phase creeps by little seems to remember all; but even the least damped resonance walks
    across the axis at random: that its share stays below s has a chance of exp(-sqrt(K / (2 s))) at most, where it
    forgets itself with K over the recording and may stand high by chance. What excludes noise better of both counts.
    A blow that rings in few frames lies on one axis for nothing: only as many frames count as share the power.

    Parameters
    ----------
    phasors : (frames,), of one bin in one recording
    turn : (frames,), rev, middle of each frame
    offset : orders, distance of the line from its bin
    forgotten : K of the least damped resonance
    worth : independent frames of one of ``phasors``, 0…1
    fitted : how many of these the distance that was fitted takes
    """
    power = np.square(np.abs(phasors))
    filled = float(power.sum() ** 2 / max(len(power) * float(np.square(power).sum()), 1e-300))
    n, forgotten = worth * filled * len(phasors) - fitted, filled * forgotten
    if n < LEAST_FRAMES:
        return 0.0
    steady = phasors * np.exp(-2j * np.pi * offset * turn)
    axis = np.exp(0.5j * np.angle(np.square(steady).sum()))
    across = (steady * axis.conj()).imag
    share = float(np.square(across).sum() / max(float(power.sum()), 1e-300))
    spread = np.log(max(4.0 * share * (1.0 - share), 1e-300))
    memory = float(across[1:] @ across[:-1]) / max(float(across @ across), 1e-300)
    memory = float(np.sqrt(np.clip(memory**2 - 1.0 / len(across), 0.0, 1.0)))
    by_memory = 0.5 * max(0.0, n * (1.0 - memory) / (1.0 + memory) - 1.0) * spread
    walked = max(0.5 * (n - 1.0) * spread, -float(np.sqrt(forgotten / (2.0 * max(share, 1e-12)))))
    return float(min(by_memory, walked))


def best_offset(phasors: Complex, turn: Floats, *, hop_rev: float) -> tuple[float, int]:
    """Distance from the bin [orders] at which ``phasors`` (frames,) at ``turn`` [rev] keep to one axis best.

    And how many distances were tried; it is told up to half the reciprocal of ``hop_rev`` on each side.
    """
    reach = 0.5 / hop_rev
    count = 2 * int(np.ceil(TRIALS_PER_SPAN * reach * max(float(np.ptp(turn)), hop_rev))) + 1
    trial = np.linspace(-reach, reach, count)
    wave = np.exp(-2j * np.pi * np.outer(turn, trial))
    kept = np.abs(np.square(phasors) @ np.square(wave))
    # a phase that alternates from frame to frame is the same on one axis: the longer mean is the line
    mean = np.abs(phasors @ wave)
    offset = float(trial[int(np.argmax(kept * (1.0 + mean / max(float(np.abs(phasors).sum()), 1e-300))))])
    for _ in range(REFINEMENTS):
        steady = phasors * np.exp(-2j * np.pi * offset * turn)
        steady = steady * np.exp(-0.5j * np.angle(np.square(steady).sum()))
        along, weight = steady.real, np.square(steady.real)
        apart = turn - float(weight @ turn) / max(float(weight.sum()), 1e-300)
        spread = max(float(weight @ np.square(apart)), 1e-300)
        offset += float((along * apart) @ steady.imag) / spread / (2.0 * np.pi)
    return offset, count
