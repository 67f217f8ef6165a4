"""Which orders prove a natural frequency, each by what it shows alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.order_responses import MOST_SCATTER, Block, Projected, as_real, jacobian
from crankorder.identify.modal.ringing import rings_into
from crankorder.identify.modal.surface_fit import Poles

WITHIN = 4.0
"""Half-power half widths within which a row belongs to a resonance."""

ROWS_OF_SWEEP = 5
"""Rows that a sweep through a whole resonance is worth at least: its filter smooths them into fewer."""

PROOF_CHANCE = 1e-4
"""Chance of so large a residue of one order without the mode, below which the order proves it."""

LOCATED = 0.5
"""Half-power half widths to which an order alone must know a frequency to say where the mode is."""

AGREES = 4.0
"""Standard errors within which that agrees with all the others."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Proof:
    """The ``orders`` that by themselves prove a mode, by amplitude and phase.

    ``most_rows`` is the largest number of rows of one of them within some widths of it, ``rows`` that of all of them,
    ``span_hz`` the lowest and highest frequency that they reached; ``located`` is how many of them find it at the same
    place, each alone, within a part of its width; ``passed`` are those that sweep through it: what is told from afar
    may be another mode. ``rung_by`` are other orders that passed it so shortly before one of these that it still rang.
    """

    orders: tuple[float, ...] = ()
    most_rows: int = 0
    rows: int = 0
    span_hz: tuple[float, float] = (0.0, 0.0)
    located: int = 0
    passed: tuple[float, ...] = ()
    rung_by: tuple[float, ...] = ()


@dataclass(frozen=True)
class OrderPole:
    """A pole that orders ask for: ``frequency_hz``, ``damping``, the ``channels`` that show it and its ``proof``."""

    frequency_hz: float
    damping: float
    channels: tuple[str, ...]
    proof: Proof


def named(blocks: Sequence[Block], projected: Sequence[Projected], poles: Poles, number: int) -> OrderPole:
    """Pole ``number`` of ``poles`` with the orders that prove it; ``blocks`` as ``projected`` with all poles."""
    f, zeta = float(poles.frequency_hz[number]), float(poles.damping[number])
    rows: dict[float, int] = {}
    ends: list[float] = []
    shown: list[str] = []
    located: set[float] = set()
    passed: set[float] = set()
    rung_by: set[float] = set()
    beside: dict[str, list[Block]] = {}
    for block in blocks:
        if block.passage is not None:
            beside.setdefault(block.recording, []).append(block)
    for block, part in zip(blocks, projected, strict=True):
        chances = residue_chances(block, part, number)
        if block.scatter > MOST_SCATTER or chances.min() > PROOF_CHANCE:
            continue
        shown += [name for name, chance in zip(block.channels, chances, strict=True) if chance <= PROOF_CHANCE]
        rows[block.order] = max(_rows_within(block, f, zeta), rows.get(block.order, 0))
        ends += [float(block.frequency_hz.min()), float(block.frequency_hz.max())]
        if (1.0 - WITHIN * zeta) * block.frequency_hz.min() <= f <= (1.0 + WITHIN * zeta) * block.frequency_hz.max():
            passed.add(block.order)
            rung_by |= {
                other.order
                for other in beside.get(block.recording, ())
                if other is not block and rings_into(block, other, f, zeta)
            }
            if _locates(block, part, poles, number):
                located.add(block.order)
    if not rows:
        return OrderPole(f, zeta, (), Proof())
    proof = Proof(
        tuple(sorted(rows)),
        max(rows.values()),
        sum(rows.values()),
        (min(ends), max(ends)),
        located=len(located),
        passed=tuple(sorted(passed)),
        rung_by=tuple(sorted(rung_by)),
    )
    return OrderPole(f, zeta, tuple(dict.fromkeys(shown)), proof)


def _locates(block: Block, part: Projected, poles: Poles, number: int) -> bool:
    """Whether ``block`` alone finds pole ``number`` where it is: one step from there is small, and its error too."""
    if part.freedom < 2 or number not in part.reached:
        return False
    slopes = jacobian(block, poles, part)[:, 2 * number : 2 * number + 2]
    information = slopes.T @ slopes
    if np.linalg.cond(information) > 1e12:
        return False
    inverse = np.linalg.inv(information)
    step = float((inverse @ slopes.T @ as_real(part.left, block))[0])
    error = float(np.sqrt(inverse[0, 0] * max(part.chi2 / part.freedom, 1.0)))
    return error <= LOCATED * float(poles.damping[number]) and abs(step) <= AGREES * error


def _rows_within(block: Block, f: float, zeta: float) -> int:
    """How many rows of ``block`` lie within some widths of a pole; a sweep through both its flanks has enough."""
    rows = int(np.count_nonzero(np.abs(block.frequency_hz / f - 1.0) <= WITHIN * zeta))
    low, high = block.frequency_hz.min(), block.frequency_hz.max()
    whole = block.passage is not None and low < f * (1.0 - WITHIN * zeta) and high > f * (1.0 + WITHIN * zeta)
    return max(rows, ROWS_OF_SWEEP) if whole else rows


def residue_chances(block: Block, part: Projected, number: int) -> Array:
    """Chances (C,) that the residue of pole ``number`` in ``block`` is so large without the mode (F test).

    ``part``: the block as projected.
    """
    from scipy.special import fdtrc

    place = np.flatnonzero(part.reached == number)
    if not len(place) or part.freedom < len(block.channels):
        return np.ones(len(block.channels))
    at = block.degree + 1 + block.columns_per_mode * int(place[0]) + np.arange(block.columns_per_mode)
    value, spread = part.linear[:, at], part.covariance[:, at[:, None], at]
    squared = np.einsum("ci,cij,cj->c", value.conj(), np.linalg.pinv(spread, hermitian=True), value).real
    scale = max(part.chi2 / part.freedom, 1.0)
    return np.asarray(fdtrc(2.0, part.freedom / len(block.channels), squared / 2.0 / scale))
