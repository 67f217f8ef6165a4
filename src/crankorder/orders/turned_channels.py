"""Channels whose sign or place is another in one recording than in the others: a plug turned round, two plugs swapped.

At like speed the orders of a machine stand to one another, from channel to channel, as they did in another recording.
A reversed sensor turns its phase against every other channel, and against the mark of the crank, by half a turn at all
orders at once; nothing that the machine does, does that. Two swapped channels have each other's amplitudes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import xarray as xr

from crankorder.orders.averages import median_beside
from crankorder.orders.between_recordings import LOCATED, WHOLE
from crankorder.quantities import Bools, Complexes, Floats, Ints, QualityFlag
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="3-orders-recordings.toml", table="turned_channels"):
    like_speed: float
    most_peers: int
    stands_out: float
    beside_bins: int
    fewest_orders: int
    opposite_cos: float
    opposite_share: float
    alike_cos: float
    swap_odds: float
    least_scatter: float
    swap_share: float


NUMBERS = _Numbers.load()

MARK = "the mark of the crank"


@dataclass(frozen=True)
class RecordedPhases:
    """One recording at a held ``speed_rpm``: its name, the ``names`` of its channels and, where it has one, the mark.

    ``cross`` (names, names, orders) are unit phasors from one to another, NaN where one of the two does not stand out;
    ``size`` (names, orders) amplitudes, NaN likewise and for the mark.
    """

    recording: str
    speed_rpm: float
    names: tuple[str, ...]
    cross: Complexes
    size: Floats


def recorded_phases(frames: xr.Dataset, *, n_orders: int) -> RecordedPhases | None:
    """The first ``n_orders`` orders of the cycle in ``frames`` (OrderFrames); None where the speed is not held."""
    speed = frames["speed"].values
    if not np.isfinite(speed).any() or not np.nanmax(speed) <= np.nanmin(speed) * (1.0 + NUMBERS.like_speed):
        return None
    order, spectrum = frames["order"].values, frames["spectrum"].values
    if len(order) < 2 or len(order) <= 2 * NUMBERS.beside_bins:
        return None
    step = 1.0 / int(frames.attrs["revs_per_cycle"])
    at = np.rint(np.arange(1, n_orders + 1) * step / float(order[1] - order[0])).astype(np.int64)
    inside = at[at < len(order)]
    names = [str(name) for name in frames["channel"].values.tolist()]
    values = np.full((len(names) + 1, spectrum.shape[1], n_orders), np.nan, dtype=np.complex128)
    for number, channel in enumerate(spectrum):
        values[number, :, : len(inside)] = np.where(_stands_out(channel, inside), channel[:, inside], np.nan)
    if str(frames.attrs["phase_reference"]) in LOCATED:
        whole = np.abs((np.arange(1, n_orders + 1) * step + 0.5) % 1.0 - 0.5) < WHOLE
        values[-1, :, whole | bool(int(frames.attrs["cycle_known"]))] = 1.0
    cross = np.nansum(values[:, None] * values[None].conj(), axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        cross = np.where(np.abs(cross) > 0.0, cross / np.abs(cross), np.nan)
        power = np.nansum(np.square(np.abs(values)), axis=1) / np.isfinite(values).sum(axis=1)
    size = np.sqrt(np.where(power > 0.0, power, np.nan))
    size[-1] = np.nan
    return RecordedPhases(str(frames.attrs["recording"]), float(np.nanmean(speed)), (*names, MARK), cross, size)


def _stands_out(channel: Complexes, at: Ints) -> Bools:
    """Which of the bins ``at`` stand out of those beside them in a ``channel`` (frames, orders)."""
    half = NUMBERS.beside_bins
    known = np.isfinite(channel.real)
    power = np.where(known, np.square(np.abs(channel)), 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(power[at] > NUMBERS.stands_out * median_beside(power, half)[at])


def turned_channels(recordings: Sequence[RecordedPhases]) -> list[QualityFlag]:
    """Flags of the ``recordings`` in which a channel is reversed, or two are swapped, against the others.

    Each is held against those at like speed, where there are none against those next in speed: all of them must say so,
    and agree with one another. Where but one other is there nobody knows which of the two is wrong: both are named. A
    channel that is surely the reversed one is to be left out: in averages it would cancel the others.
    """
    steady = sorted(recordings, key=lambda one: one.speed_rpm)
    steady = [one for one in steady if one.names == steady[0].names]
    flags: list[QualityFlag] = []
    for row, one in enumerate(steady):
        others = _peers(steady, row)
        if not others:
            continue
        alone = len(others) == 1
        turned, by_mark = _reversed(one, others)
        if turned:
            flags.append(_flag(one, "polarity_doubt", _reversal(turned, by_mark=by_mark), alone))
            if len(turned) == 1 and not alone:
                flags[-1]["channel"], flags[-1]["left_out"] = turned[0], "channel"
            continue
        swapped = _swapped(one, others)
        if swapped is not None:
            what = f"channels {swapped[0]} and {swapped[1]} have each other's amplitudes: axes or plugs swapped?"
            flags.append(_flag(one, "channels_swapped", what, alone))
    return flags


def _flag(one: RecordedPhases, name: str, what: str, alone: bool) -> QualityFlag:
    beside = "the other recording" if alone else "the other recordings"
    which = "; nothing tells which of the two is wrong" if alone else ""
    detail = f"beside {beside} near {one.speed_rpm:.4g} rpm {what}{which}"
    return QualityFlag(recording=one.recording, flag=name, severity="suspect", detail=detail)


def _reversal(turned: tuple[str, ...], *, by_mark: bool) -> str:
    if by_mark and len(turned) > 1:
        return f"channels {', '.join(turned)} stand half a turn off {MARK} at all orders: polarity reversed?"
    return f"the phase of channel {' or '.join(turned)} is turned by half a turn at all orders: polarity reversed?"


def _peers(steady: Sequence[RecordedPhases], row: int) -> list[RecordedPhases]:
    """The nearest at like speed, else those next in speed: one on each side, at an end two on one."""
    speed, reach = steady[row].speed_rpm, NUMBERS.most_peers
    near = [
        steady[k]
        for k in sorted(range(max(row - reach, 0), min(row + reach + 1, len(steady))), key=lambda k: abs(k - row))
        if k != row and abs(steady[k].speed_rpm / speed - 1.0) <= NUMBERS.like_speed
    ]
    if near:
        return near[:reach]
    first = min(max(row - 1, 0), max(len(steady) - 3, 0))
    beside = [steady[k] for k in range(first, min(first + 3, len(steady))) if k != row]
    return beside if len(beside) == 2 else []


def _turns(one: RecordedPhases, other: RecordedPhases) -> Ints:
    """Whether phases from name to name (names, names) are as in the ``other``: 1, opposite: -1, nothing tells: 0."""
    made = np.zeros((len(one.names),) * 2, dtype=np.int64)
    for a, b in combinations(range(len(one.names)), 2):
        cos = (one.cross[a, b] * other.cross[a, b].conj()).real
        cos = cos[np.isfinite(cos)]
        if len(cos) < NUMBERS.fewest_orders:
            continue
        if np.mean(cos < -NUMBERS.opposite_cos) >= NUMBERS.opposite_share:
            made[a, b] = made[b, a] = -1
        elif np.mean(cos > NUMBERS.alike_cos) >= NUMBERS.opposite_share:
            made[a, b] = made[b, a] = 1
    return made


def _reversed(one: RecordedPhases, others: Sequence[RecordedPhases]) -> tuple[tuple[str, ...], bool]:
    """Names of the channels of ``one`` that are turned against all ``others``, and whether the mark tells so.

    Without the mark they are those that stand opposite to most: one of several, where none does more than another.
    """
    if any((_turns(*pair) < 0).any() for pair in combinations(others, 2)):
        return (), False  # they do not agree with one another
    opposite = np.all([_turns(one, other) < 0 for other in others], axis=0)
    by_mark, count = bool(opposite[-1].any()), opposite[:-1].sum(axis=1)
    turned = np.flatnonzero(opposite[:-1, -1] if by_mark else (count == count.max()) & (count > 0))
    return tuple(one.names[k] for k in turned.tolist()), by_mark


def _swapped(one: RecordedPhases, others: Sequence[RecordedPhases]) -> tuple[str, str] | None:
    """Names of two channels of ``one`` that have each other's amplitudes in all ``others``; None where none have."""
    sizes = np.log(one.size[:-1])
    those = [np.log(other.size[:-1]) for other in others]
    between = [np.abs(a - b) for a, b in combinations(those, 2)]
    known = np.concatenate([each[np.isfinite(each)] for each in between]) if between else np.empty(0)
    scatter = max(float(np.median(known)) if known.size else 0.0, NUMBERS.least_scatter)
    best: tuple[float, tuple[str, str]] | None = None
    for a, b in combinations(range(len(sizes)), 2):
        odds = min(_swap_odds(sizes, other, a, b, scatter) for other in those)
        if odds > math.log(NUMBERS.swap_odds) and (best is None or odds > best[0]):
            best = odds, (one.names[a], one.names[b])
    return None if best is None else best[1]


def _swap_odds(sizes: Floats, other: Floats, a: int, b: int, scatter: float) -> float:
    """Logarithm of how much better the amplitudes of channels ``a`` and ``b`` fit those of the ``other`` swapped."""
    own = np.abs(sizes[a] - other[a]) + np.abs(sizes[b] - other[b])
    swapped = np.abs(sizes[a] - other[b]) + np.abs(sizes[b] - other[a])
    known = np.isfinite(own) & np.isfinite(swapped)
    if np.count_nonzero(known) < NUMBERS.fewest_orders:
        return -math.inf
    own, swapped = own[known], swapped[known]
    if swapped.mean() > NUMBERS.swap_share * own.mean():
        return -math.inf
    return float(np.sum(own - swapped)) / scatter
