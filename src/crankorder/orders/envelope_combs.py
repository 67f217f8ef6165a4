"""Combs of lines in envelope spectra: how unlikely noise alone is to make the first harmonics of a train of strikes."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import fdtrc

from crankorder.orders.envelope_band import Bands, middles
from crankorder.quantities import Bools, Floats, Ints, Variables, described

FLOOR_ORDERS = 1.0
"""Width in orders of the pieces of a spectrum whose medians are the floor: wide against any line and its skirts."""

FLOOR_WORTH = 0.4
"""Independent powers per cell of resolution that a floor of medians is worth: of a Hann window two thirds are, and a
median is worth 0.6 of their mean."""

CYCLE_CELLS = 1.5
"""Cells beside a multiple of the cycle's order where no strikes can be told from what the engine itself does."""

MAINS_HZ, MAINS_SHARE, MAINS_CELLS = (50.0, 60.0), 0.002, 1.5
"""Multiples of the mains beat with each other in every band that holds two of them, as strikes at such a rate would:
frequencies, by how much these wander as a share, and cells of resolution beside in which nothing is told."""

LOWEST_ORDER = 0.25
"""Order below which nothing is chosen by: slow changes of load and speed are there."""

CLEAR_RATIO, WIDER_SHARE = 100.0, 0.5
"""Power ratio from which a line is clear, and share of it that a wider band must show to be taken instead."""


TEETH, SLOW_TEETH = 3, 6
"""First harmonics that are taken together, and those of a comb as slow as a cage's."""

SLOW_ORDER = 1.0
"""Order below which a comb is slow: its damage strikes once in more than a turn, with many harmonics."""

LEAST_TEETH = 2
"""A comb has so many lines or more off the multiples of the cycle; one line alone is no comb."""

TRIALS_PER_BIN = 2
"""Places of the first harmonic that are tried from one bin to the next."""

LEAST_NATS = 2.0
"""Of the first harmonic, as the logarithm of its chance, at least: strikes are seldom without it, other lines often."""

MOST_NATS = 14.0
"""Of one line, as the logarithm of its chance, at most: no line by itself makes a comb."""

SKIRT_BINS = 16
"""Bins of a piece of spectrum whose median is the skirt that other lines leave there, where it is above the floor."""

NEAR_TRIALS = 2.2
"""Independent values that the largest of a bin and of its two neighbours is worth, with a Hann window."""

SPARE_BINS = 4
"""Bins beside those of a comb's lines that are kept of a spectrum: for the places of its peaks and of sidebands."""

TABLE_STEP, TABLE_END = 0.004, 1.6e5
"""Steps of the table of chances in the logarithm of the power ratio, and the ratio at its end: nats are right to 1e-4
of themselves."""

WIDER_EVIDENCE = 0.9
"""Share of the best band's evidence, in logarithms, that a wider band must show to be taken instead."""

_UNITS = {"ratio": "1", "level": "1", "floor": "see unit"}
"""Units of what is kept of a spectrum: power over the skirts of other lines, that over the floor, root of the floor."""

_OF_COMB = {"units": "1", "long_name": "strikes that are looked for"}


def best_band(height: Floats) -> int:
    """Index of the band in whose envelope a line stands out most; bands come widest first.

    ``height`` (bands,) is the power of the highest line over its floor in each band. Where a line stands out clearly a
    wider band is taken that shows it half as well: it holds more of the resonance, and the amplitude depends less on
    the noise.
    """
    best = int(np.argmax(height))
    if height[best] < CLEAR_RATIO:
        return best
    return int(np.flatnonzero(height >= WIDER_SHARE * height[best])[0])


def off_mains(order: Floats, *, speed_hz: float, cell: float) -> Bools:
    """Which of ``order`` (orders,) are none at which multiples of the mains frequency beat, at ``speed_hz``.

    ``speed_hz`` is in revolutions per second, ``cell`` the resolution in orders.
    """
    made = np.ones(len(order), dtype=np.bool_)
    for mains_hz in MAINS_HZ:
        spacing = mains_hz / speed_hz
        beside = np.abs(order - spacing * np.maximum(np.round(order / spacing), 1.0))
        made &= beside > MAINS_CELLS * cell + MAINS_SHARE * order
    return made


def free_of_others(order: Floats, *, revs_per_cycle: int, speed_hz: float, cell: float) -> Bools:
    """At which ``order`` (orders,) strikes can be told from lines locked to the engine's cycle and from mains.

    ``revs_per_cycle`` are the revolutions per engine cycle, 1 or 2; ``speed_hz`` is in revolutions per second, ``cell``
    the resolution in orders.
    """
    off_cycle = np.abs(order * revs_per_cycle - np.round(order * revs_per_cycle)) / revs_per_cycle
    return np.asarray(off_cycle > CYCLE_CELLS * cell) & off_mains(order, speed_hz=speed_hz, cell=cell)


def floor_worth(step: float, cell: float) -> float:
    """Independent bins that the floor of a spectrum is worth.

    ``step`` is the distance of the bins and ``cell`` the resolution, both in orders.
    """
    return max(round(FLOOR_ORDERS / step), 8) * FLOOR_WORTH * step / cell


def line_floor(power: NDArray[np.floating], order: Floats, n_independent: float) -> Floats:
    """Local mean power of the noise (bands, orders): medians of pieces one order wide, joined by straight lines.

    ``power`` (bands, orders) at each ``order``, of which the spacing is even, is the mean of ``n_independent`` spectra.
    """
    from scipy.special import gammaincinv

    width = max(round(FLOOR_ORDERS / float(order[1])), 8)
    count = max(power.shape[1] // width, 1)
    pieces = power[:, : count * width].reshape(len(power), count, -1)
    shape = max(n_independent, 1.0)
    middle = middles(pieces) * shape / float(gammaincinv(shape, 0.5))
    at = np.clip((np.arange(power.shape[1]) + 0.0) / pieces.shape[2] - 0.5, 0.0, count - 1.0)
    before = np.minimum(at.astype(np.int64), max(count - 2, 0))
    after = np.minimum(before + 1, count - 1)
    share = (at - before).astype(power.dtype)
    return np.asarray(middle[:, before] * (1.0 - share) + middle[:, after] * share)


class Comb(NamedTuple):
    """Strikes that are looked for: the first harmonic may be from order ``low`` to ``high``.

    They may come and go with the load: sidebands then stand ``spacing`` beside each harmonic (0: they do not).
    """

    low: float
    high: float
    spacing: float = 0.0

    @property
    def is_slow(self) -> bool:
        """Whether it strikes less than once per revolution."""
        return self.high < SLOW_ORDER

    @property
    def teeth(self) -> int:
        """Harmonics that are taken together."""
        return SLOW_TEETH if self.is_slow else TEETH

    def trials(self, step: float) -> Floats:
        """Orders (trials,) of the first harmonic that are tried in a spectrum with bins ``step`` apart."""
        return np.arange(self.low, self.high + 0.5 * step / TRIALS_PER_BIN, step / TRIALS_PER_BIN)


Combs = tuple[Comb, ...]


@lru_cache(maxsize=64)
def looked_at(combs: Combs, *, step: float, n_orders: int) -> Ints:
    """Bins (looks,) of a spectrum of ``n_orders`` bins ``step`` apart that tell whether one of ``combs`` is there.

    They are those of its harmonics, one more than are taken together, of their sidebands, of what a slow comb (a cage)
    makes beside them, and half way between harmonics that have the sidebands of a cage.
    """
    seen = np.zeros(n_orders, dtype=np.bool_)
    slow = [end for comb in combs if comb.is_slow for end in (comb.low, comb.high)]
    for comb in combs:
        beside = {0.0, comb.spacing, *(slow if not comb.is_slow else ())}
        sides, teeth = [side for away in beside for side in (-away, away)], range(1, comb.teeth + 2)
        spans = [(n * comb.low + side, n * comb.high + side) for n in teeth for side in sides]
        if 0.0 < comb.spacing < SLOW_ORDER:
            half = 0.5 * comb.spacing
            spans += [((n - 0.5) * comb.low - half, (n - 0.5) * comb.high + half) for n in range(1, comb.teeth + 1)]
        for low, high in spans:
            first, last = int(low / step) - SPARE_BINS, int(high / step) + SPARE_BINS
            seen[max(first, 0) : max(last + 2, 0)] = True
    bins = np.flatnonzero(seen)
    bins.flags.writeable = False  # all who ask get the same
    return bins


def look_nats(ratio: NDArray[np.floating], bins: Ints, *, count: float, floor_worth: float, free: Bools) -> Floats:
    """Minus the logarithm of the chance (rows, looks) that noise makes a line of so high a ``ratio`` (rows, looks).

    The highest of each bin and its neighbours counts; each chance has a limit. The chance falls as the ratio grows, so
    that one table serves all bins.

    Parameters
    ----------
    ratio : power over the local floor at the ``bins`` (looks,), which increase
    count : independent spectra that it is the mean of
    floor_worth : independent bins that its floor is worth
    free : (looks,), bins off the multiples of the cycle's order: no other counts, nor as a neighbour
    """
    nats, rise = _table(max(count, 1e-3), floor_worth)
    place = np.log(np.fmin(np.fmax(ratio, 1.0), TABLE_END)) / TABLE_STEP
    below = np.floor(place)
    at = below.astype(np.int64)
    own = nats[at] + (place - below) * rise[at]
    own *= np.where(free, np.minimum(ratio, 1.0), 0.0)
    beside = np.diff(bins) == 1
    high = own.copy()
    high[:, 1:] = np.maximum(high[:, 1:], np.where(beside, own[:, :-1], 0.0))
    high[:, :-1] = np.maximum(high[:, :-1], np.where(beside, own[:, 1:], 0.0))
    return np.asarray(np.clip(high - math.log(NEAR_TRIALS), 0.0, MOST_NATS))


@lru_cache(maxsize=512)
def _table(count: float, floor_worth: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Logarithms of power ratios' chances in noise (F-distribution), with a minus, and how they rise in a step."""
    log_ratio = np.arange(0.0, np.log(TABLE_END) + 3.0 * TABLE_STEP, TABLE_STEP)
    nats = -np.log(np.maximum(fdtrc(2.0 * count, 2.0 * floor_worth * count, np.exp(log_ratio)), 1e-300))
    return nats[:-1].astype(np.float32), np.diff(nats).astype(np.float32)


def comb_nats(nats: Floats, bins: Ints, comb: Comb, *, step: float, free: Bools) -> Floats:
    """Minus the logarithm of the chance (rows, trials) that noise makes the lines of each trial of ``comb`` together.

    The chances of single lines are multiplied (Fisher's method), each with a limit: those of the first harmonics, more
    and more of them, with their sidebands and without. The best of these sets counts, less what their number costs. It
    is 0 where the first harmonic of a comb that is not slow is missing.

    Parameters
    ----------
    nats : (rows, looks), of the lines alone as :func:`look_nats` has them, at the ``bins`` (looks,) of spectra
    step : orders from one bin of the spectra to the next
    free : (looks,), bins off the multiples of the cycle's order: no other counts
    """
    trials, spacing = comb.trials(step) / step, comb.spacing / step
    teeth = np.arange(1, comb.teeth + 1)
    sides = np.array([0.0, -spacing, spacing] if spacing else [0.0])
    at = np.round(teeth[:, None, None] * trials + sides[:, None]).astype(np.int64)
    look = np.minimum(bins.searchsorted(at), len(bins) - 1)
    counts = (bins[look] == at) & free[look]
    own = nats[:, look] * counts
    first = (own[:, :1, 0] > LEAST_NATS) | comb.is_slow
    shown = []
    for n_sides, kept in ((1, [LEAST_TEETH - 1, comb.teeth - 1]), (3, slice(None)))[: 1 + bool(spacing)]:
        total = own[:, :, :n_sides].sum(axis=2).cumsum(axis=1)[:, kept]
        lines = counts[:, :n_sides].sum(axis=1).cumsum(axis=0)[kept]
        shown.append(np.where((lines >= LEAST_TEETH) & first, _fisher(total, lines), 0.0))
    best = np.max([nats_of_set.max(axis=1) for nats_of_set in shown], axis=0)
    return np.asarray(np.maximum(best - math.log(sum(nats_of_set.shape[1] for nats_of_set in shown)), 0.0))


def _fisher(total: Floats, lines: Ints) -> Floats:
    """Minus the logarithm of the chance that so many ``lines`` of noise have ``total`` nats or more together.

    Each has an exponential distribution: their sum has Erlang's, the chance of which is a short series.
    """
    term, series = np.ones_like(total), np.ones_like(total)
    for k in range(1, int(lines.max(initial=1))):
        term = term * total / k
        series += np.where(k < lines, term, 0.0)
    return np.asarray(np.maximum(total - np.log(series), 0.0))


def over_skirts(ratio: NDArray[np.floating]) -> Floats:
    """``ratio`` (rows, orders), divided by the median of the bins about each where that is above 1.

    The skirt of a strong line thus shows no lines of its own.
    """
    pieces = ratio.shape[1] // SKIRT_BINS
    middle = middles(ratio[:, : pieces * SKIRT_BINS].reshape(len(ratio), pieces, SKIRT_BINS))
    high = np.repeat(np.maximum(middle, 1.0), SKIRT_BINS, axis=1)
    rest = ratio.shape[1] - high.shape[1]
    return np.asarray(ratio / np.pad(high, ((0, 0), (0, rest)), mode="edge"))


def looks_of(combs: Combs, bands: Bands, *, order: Floats, looks: NDArray[np.float32]) -> Variables:
    """Variables of a RecordingEnvelope: what each of ``bands`` shows where lines of ``combs`` may be.

    ``looks`` (channel, 3, bands, looks): the power over the skirts of other lines, that over the local floor, and the
    root of this floor; ``order`` (orders,) is that of a whole spectrum.
    """
    bins = looked_at(combs, step=float(order[1]), n_orders=len(order))
    made = comb_variables(combs) | {
        "look": (("look",), order[bins], {"units": "1", "long_name": "order of the envelope"}),
        "look_band_low": (("speed", "band"), np.array([[band.low_hz for band in bands]]), {"units": "Hz"}),
        "look_band_high": (("speed", "band"), np.array([[band.high_hz for band in bands]]), {"units": "Hz"}),
    }
    for number, (name, units) in enumerate(_UNITS.items()):
        dims = ("channel", "speed", "band", "look")
        made[f"look_{name}"] = (dims, looks[:, number][:, None], {"units": units})
    return made


def comb_variables(combs: Combs) -> Variables:
    """``combs`` as variables ``comb_…`` (comb,) of a dataset."""
    columns = np.array(combs, dtype=np.float64).reshape(-1, len(Comb._fields)).T
    return {f"comb_{name}": (("comb",), column, _OF_COMB) for name, column in zip(Comb._fields, columns, strict=True)}


def combs_in(dataset: xr.Dataset) -> Combs:
    """Combs that ``dataset``, a RecordingEnvelope or EnvelopeMap (``comb_…`` by comb), holds; empty where none."""
    if "comb_low" not in dataset:
        return ()
    columns = [dataset.variables[f"comb_{name}"].values.tolist() for name in Comb._fields]
    return tuple(Comb(*row) for row in zip(*columns, strict=True))


def joined_looks(groups: list[list[xr.Dataset]]) -> Variables:
    """Variables (comb, channel, speed, look) of an EnvelopeMap: the lines of each comb in the band that serves it best.

    The band is one for the whole test. ``groups`` are lists of RecordingEnvelopes (channel, speed, order) of like
    speed. The result is empty where one of them was made without combs, or with others. In other recordings the bands
    nearest to those of the first recording with most bands are taken.
    """
    items = [item for group in groups for item in group]
    combs = combs_in(items[0])
    if not combs or any(combs_in(item) != combs for item in items):
        return {}
    looks = [item.variables["look"].values for item in items]
    if not all(np.array_equal(own, looks[0]) for own in looks):
        return {}
    like = max(items, key=lambda item: item.sizes["band"])
    kept = np.stack([_averaged(group, like) for group in groups], axis=2)
    chosen = _bands_of(kept[0], groups, combs, items[0])
    variables = comb_variables(combs) | {"look": (("look",), looks[0], dict(items[0]["look"].attrs))}
    for number, (name, units) in enumerate(_UNITS.items()):
        values = np.stack([kept[number][:, :, at] for at in chosen])
        variables[f"comb_{name}"] = (("comb", "channel", "speed", "look"), values, {"units": units})
    for end in ("low", "high"):
        places = [(group[0].variables[f"look_band_{end}"].values[0], _nearest(group[0], like)) for group in groups]
        edges = np.array([of_group[near] for of_group, near in places])[:, chosen].T
        variables[f"comb_band_{end}"] = described(("comb", "speed"), edges, "Hz", f"{end} end of the band")
    return variables


def _nearest(item: xr.Dataset, like: xr.Dataset) -> Ints:
    """Which band of ``item`` is nearest to each of the bands of ``like``, by both ends in Hz."""
    away = np.zeros((like.sizes["band"], item.sizes["band"]))
    for end in ("look_band_low", "look_band_high"):
        away += np.abs(like[end].values[0][:, None] - item[end].values[0])
    return np.asarray(np.argmin(away, axis=1), dtype=np.int64)


def _averaged(group: list[xr.Dataset], like: xr.Dataset) -> NDArray[np.float32]:
    """Means (3, channel, band, look) of what is kept of the recordings of a ``group``, as often as each counts."""
    total, made = np.full(1, 1e-9, dtype=np.float32), np.zeros(1, dtype=np.float32)
    for item in group:
        count = np.nan_to_num(item.variables["n_independent"].values[:, 0]).astype(np.float32)[:, None, None]
        at = _nearest(item, like)
        kept = np.stack([item.variables[f"look_{name}"].values[:, 0][:, at] for name in _UNITS])
        made = made + np.where(count > 0.0, count * kept, np.float32(0.0))
        total = total + count
    return np.asarray(made / total)


def _bands_of(ratio: NDArray[np.float32], groups: list[list[xr.Dataset]], combs: Combs, first: xr.Dataset) -> list[int]:
    """For each comb the band of ``ratio`` (channel, speed, band, look) that serves it best: in a spectrum or in all."""
    order = first.variables["order"].values
    step, bins = float(order[1]), np.round(first.variables["look"].values / order[1]).astype(np.int64)
    worth_of = [[np.nan_to_num(item.variables["n_independent"].values[:, 0]) for item in group] for group in groups]
    count = np.array([sum(of_group) for of_group in worth_of]).T
    revs = [min(int(item.variables["revs_per_frame"].values[0]) for item in group) for group in groups]
    speed_hz = [float(np.mean([item.variables["speed"].values[0] for item in group])) / 60.0 for group in groups]
    cycle = int(first.attrs["revs_per_cycle"])
    cells = zip(speed_hz, revs, strict=True)
    free = np.array([free_of_others(order, revs_per_cycle=cycle, speed_hz=hz, cell=1.0 / each) for hz, each in cells])
    best = np.zeros((len(combs), ratio.shape[2]))
    several = np.log(max(count.size, 1))
    if count.size > 1:
        weight = (count[:, :, None] * free[None][:, :, bins]).astype(np.float32)
        own = weight.sum(axis=(0, 1))
        mean = np.einsum("csl,csbl->bl", weight, ratio) / np.maximum(own, 1e-9)
        counts = np.zeros(len(order), dtype=np.bool_)
        counts[bins] = own >= 0.5 * count.sum()
        worth = floor_worth(step, 1.0 / max(revs))
        total = np.array([float(count.sum())])
        best = served(mean[None], combs, bins, step=step, count=total, worth=worth, free=counts)[:, 0]
    for speed in range(ratio.shape[1]):
        worth = floor_worth(step, 1.0 / revs[speed])
        shown = served(ratio[:, speed], combs, bins, step=step, count=count[:, speed], worth=worth, free=free[speed])
        best = np.maximum(best, shown.max(axis=1) - several)
    # bands come widest first, level by level: a wider one that shows it as well holds more of the resonance
    return [int(np.flatnonzero(each >= WIDER_EVIDENCE * each.max())[0]) for each in best]


def served(
    ratio: NDArray[np.floating], combs: Combs, bins: Ints, *, step: float, count: Floats, worth: float, free: Bools
) -> Floats:
    """Nats (combs, rows, bands) of the best trial of each of ``combs`` in each of ``ratio`` (rows, bands, looks).

    Parameters
    ----------
    ratio : power over the floor at the ``bins`` (looks,) of spectra with bins ``step`` orders apart
    count : (rows,), independent spectra that each is the mean of
    worth : independent bins that its floor is worth
    free : (orders,), bins off the multiples of the cycle's order and of mains
    """
    rows = zip(ratio, count.tolist(), strict=True)
    nats = np.concatenate([look_nats(row, bins, count=own, floor_worth=worth, free=free[bins]) for row, own in rows])
    best = [comb_nats(nats, bins, comb, step=step, free=free[bins]).max(axis=1, initial=0.0) for comb in combs]
    return np.array(best).reshape(len(combs), *ratio.shape[:2])
