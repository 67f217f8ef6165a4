"""Which orders prove a natural frequency, each by what it shows alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.order_responses import MOST_SCATTER, Block, Projected, as_real, jacobian, project
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

SIDE_BY_SIDE = 0.03
"""Share of a frequency within which the next pole is a neighbour."""

FELT = 0.05
"""Share of an order's amplitude that a pole must account for somewhere: less is what no model is good for."""

FEWEST_BESIDE = 2
"""Rows of a sweep next to a pole that are looked at in any case."""

UNEXPLAINED = 0.25
"""Share of the power left by the other poles that one that is shown leaves at most: half of the amplitude."""

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
    located, passed, rung_by = set[float](), set[float](), set[float]()
    beside: dict[str, list[Block]] = {}
    for block in blocks:
        if block.passage is not None:
            beside.setdefault(block.recording, []).append(block)
    for block, part in zip(blocks, projected, strict=True):
        shows = residue_chances(block, part, number) <= PROOF_CHANCE
        if shows.any():
            shows &= _explains(block, part, poles, number)
        if block.scatter > MOST_SCATTER or not shows.any():
            continue
        shown += [name for name, yes in zip(block.channels, shows, strict=True) if yes]
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


def _explains(block: Block, part: Projected, poles: Poles, number: int) -> NDArray[np.bool_]:
    """Whether pole ``number``, with its neighbours, is what a sweep of ``block`` shows there, in each channel (C,).

    What the other poles leave there is felt, and with it most of that is gone, beyond the noise. Where the swing of
    another order was taken away, what that one's model does not know stays, and a pole that is none takes a part of it.
    """
    if block.passage is None:
        return np.ones(len(block.channels), dtype=np.bool_)
    f, zeta = float(poles.frequency_hz[number]), float(poles.damping[number])
    away = np.abs(block.frequency_hz / f - 1.0)
    reach = max(
        WITHIN * zeta, block.passage.blurred_hz / f, float(np.sort(away)[FEWEST_BESIDE - 1 : FEWEST_BESIDE].sum())
    )
    near = away <= reach
    weight = block.weight[:, near]
    used = weight > 0.0
    error = (block.error if block.as_read is None else block.as_read[1])[:, near]
    noise = np.where(used, 2.0 * np.square(block.noise * error), 0.0).sum(axis=1)
    size = np.where(used, np.square(block.size[:, near]), 0.0).sum(axis=1)
    beside = np.abs(np.log(poles.frequency_hz / f)) <= SIDE_BY_SIDE
    left, without = (
        np.where(used, np.abs(one.left[:, near]) ** 2 / np.where(used, weight, 1.0) ** 2, 0.0).sum(axis=1)
        for one in (part, project(block, poles.chosen(~beside)))
    )
    felt = without - left > FELT**2 * size * (4.0 if block.power else 1.0)
    return np.asarray(felt & (without - left >= (1.0 - UNEXPLAINED) * np.maximum(without - noise, noise)))


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
