"""What rings on of one order in the filter of the next: in a fast sweep a mode still swings when that one passes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
import xarray as xr

from crankorder.identify.found import HiddenSpeeds, Mode, Swing
from crankorder.identify.modes.order_responses import Block, Projected
from crankorder.identify.modes.order_terms import force
from crankorder.identify.modes.passage import Passage
from crankorder.identify.modes.surface_fit import Poles
from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="ringing"):
    rings_share: float
    hides_share: float
    near_share: float


NUMBERS = _Numbers.load()

MOST_KEPT = 256
"""Passages that are kept."""


def without_ringing(blocks: Sequence[Block], parts: Sequence[Projected], poles: Poles) -> tuple[Block, ...]:
    """``blocks`` less what the other orders of the same recording leave in their filters behind ``poles``.

    ``parts`` are the blocks as projected with them. A mode that one order has passed rings on at its own frequency,
    where a lower order finds it later (a higher one where the speed falls). What is taken away is known as well as the
    residue of the other order, and by as much as that one scatters: the errors of the rows grow by it.
    """
    made = list(blocks)
    swept = [number for number, block in enumerate(blocks) if block.passage is not None]
    swept.sort(key=lambda number: blocks[number].recording)
    for _, group in groupby(swept, key=lambda number: blocks[number].recording):
        together = list(group)
        for number in together:
            others = [(blocks[other], parts[other]) for other in together if other != number]
            made[number] = _without(blocks[number], others, poles)
    return tuple(made)


def swings_of(blocks: Sequence[Block], parts: Sequence[Projected], poles: Poles) -> tuple[Swing, ...]:
    """What the orders of ``blocks`` leave in one another's filters behind ``poles``, all along their recordings.

    ``parts`` are the blocks as projected with the poles. Empty for orders that hold nothing of others.
    """
    made = []
    for block in blocks:
        if block.passage is None or block.as_read is None:
            continue
        along = replace(
            block, passage=replace(block.passage, place=np.arange(len(block.passage.time_s), dtype=np.float64))
        )
        others = [
            (other, part)
            for other, part in zip(blocks, parts, strict=True)
            if other is not block and other.passage is not None and other.recording == block.recording
        ]
        total, variance = _rung(along, others, poles)
        made += [
            Swing(block.order, name, block.recording, block.passage.time_s, taken, np.sqrt(spread))
            for name, taken, spread in zip(block.channels, total, variance, strict=True)
        ]
    return tuple(made)


def without_swings(followed: Sequence[xr.Dataset], swings: Sequence[Swing]) -> tuple[xr.Dataset, ...]:
    """``followed`` (RecordingTracks) less the ``swings`` of their orders, whose errors theirs grow by."""
    made = []
    for item in followed:
        own = [swing for swing in swings if swing.recording == item.attrs.get("recording")]
        if own:
            item = item.copy(deep=True)
        for swing in own:
            names = item["order"].values
            row = int(np.argmin(np.abs(names - swing.order)))
            channel = item["channel"].values.tolist().index(swing.channel)
            time = item["time"].values
            taken, error = (np.interp(time, swing.time_s, values) for values in (swing.taken, swing.error))
            item["amplitude"].values[channel, row] -= taken
            item["standard_error"].values[channel, row] = np.hypot(item["standard_error"].values[channel, row], error)
        made.append(item)
    return tuple(made)


def _without(block: Block, others: Sequence[tuple[Block, Projected]], poles: Poles) -> Block:
    """``block`` as it was measured, less what the ``others`` leave of ``poles``."""
    total, variance = _rung(block, others, poles)
    amplitude, error = block.as_read or (block.amplitude, block.error)
    if not total.any():
        return block if block.as_read is None else replace(block, amplitude=amplitude, error=error, as_read=None)
    return replace(
        block, amplitude=amplitude - total, error=np.hypot(error, np.sqrt(variance)), as_read=(amplitude, error)
    )


def _rung(block: Block, others: Sequence[tuple[Block, Projected]], poles: Poles) -> tuple[Complexes, Floats]:
    """What the ``others`` leave of ``poles`` in ``block``, and its variance (C, K), at the places of its passage."""
    rows = 0 if block.passage is None else len(block.passage.place)
    total, variance = np.zeros((len(block.channels), rows), dtype=np.complex128), np.zeros((len(block.channels), rows))
    for other, part in others:
        shared = [block.channels.index(name) for name in other.channels if name in block.channels]
        from_rows = [other.channels.index(block.channels[row]) for row in shared]
        for place, pole in enumerate(part.reached.tolist()):
            f, zeta = float(poles.frequency_hz[pole]), float(poles.damping[pole])
            if not shared or not rings_into(block, other, f, zeta):
                continue
            took = _taken(block, other, f, zeta)
            column = other.degree + 1 + place
            residue = part.linear[from_rows, column]
            spread = part.covariance[from_rows, column, column].real * max(
                1.0, part.chi2 / max(part.degrees_of_freedom, 1)
            )
            total[shared] += residue[:, None] * took
            variance[shared] += (spread + np.square(other.scatter * np.abs(residue)))[:, None] * np.abs(took) ** 2
    return total, variance


def rings_into(block: Block, other: Block, natural_hz: float, damping: float) -> bool:
    """Whether a mode that the ``other`` order has passed still rings when ``block`` passes it.

    ``natural_hz`` and ``damping``: of the mode.
    """
    if not block.ends_hz[0] < natural_hz < block.ends_hz[1]:
        return False
    return _rings(other, block.order, natural_hz, damping, NUMBERS.rings_share)


def _rings(block: Block, later: float, natural_hz: float, damping: float, share: float) -> bool:
    """Whether more than a ``share`` of what ``block`` left of a mode still rings when the order ``later`` passes it."""
    passage = block.passage
    assert passage is not None
    if not passage.ends_hz[0] < natural_hz < passage.ends_hz[1]:
        return False
    slowest, fastest = passage.rates_rpm_per_s
    if (slowest > 0.0 and block.order < later) or (fastest < 0.0 and block.order > later):
        return False
    rate = max(abs(slowest), abs(fastest)) / 60.0
    delay = natural_hz * abs(1.0 / later - 1.0 / block.order) / max(rate, 1e-12)
    return bool(2.0 * np.pi * damping * natural_hz * delay < -np.log(share))


def hidden_speeds(
    blocks: Sequence[Block],
    modes: Sequence[Mode],
    *,
    revs_per_cycle: int,
    least_damping: float,
    looked_hz: Sequence[tuple[float, float]] = (),
) -> tuple[HiddenSpeeds, ...]:
    """Speeds at which orders that nobody found could meet ``modes`` that still ring from the orders of ``blocks``.

    Every multiple of the cycle's frequency (``revs_per_cycle`` 1 or 2) may be such an order, if it is none of
    ``blocks``. No mode is taken to be damped by less than ``least_damping``. At ``looked_hz``, from … to, all of them
    were looked for beside what rings.
    """
    swept = [block for block in blocks if block.passage is not None]
    if not swept:
        return ()
    have = np.array(sorted({block.order for block in swept}))
    multiples = np.arange(1, int(revs_per_cycle * (have.max() + 1.0)) + 1) / revs_per_cycle
    unknown = multiples[np.abs(multiples[:, None] - have).min(axis=1) > 0.25 / revs_per_cycle]
    found: list[HiddenSpeeds] = []
    for mode in modes:
        f, zeta = mode.frequency_hz, max(mode.damping_ratio, least_damping)
        if any(low <= f <= high for low, high in looked_hz):
            continue
        reach = mode.frequency_half_hz + NUMBERS.near_share * f
        for number in unknown.tolist():
            rung = [block for block in swept if _rings(block, number, f, zeta, NUMBERS.hides_share)]
            if rung:
                loudest = max(rung, key=lambda block: float(block.size.max()))
                ends = 60.0 * (f - reach) / number, 60.0 * (f + reach) / number
                found.append(HiddenSpeeds(ends[0], ends[1], f, loudest.order))
    return tuple(found)


def _taken(block: Block, other: Block, natural_hz: float, damping: float) -> Complexes:
    """What the filter of ``block`` takes (K,) of a mode behind the force of the ``other``, of unit residue."""
    assert block.passage is not None
    key = (block.order, len(block.passage.place), natural_hz, damping, other.exponent, other.law)
    if key not in other.rung:
        passage: Passage | None = other.passage
        assert passage is not None
        grown = force(passage.speed_rpm, other.span_rpm, other.reference_rpm, other.exponent, other.law)
        if len(other.rung) >= MOST_KEPT:
            other.rung.pop(next(iter(other.rung)))
        left = passage.left_over(grown, natural_hz, damping)
        other.rung[key] = block.passage.taken_from(passage, left, natural_hz)
    return other.rung[key]
