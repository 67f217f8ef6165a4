"""What differs between two tests, order by order: amplitude and phasor at like speeds, each with a 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.special import fdtrc, stdtr

from crankorder.comparison import LineKind, SpeedPair, Trend
from crankorder.findings import Findings, OrderFinding
from crankorder.identify.envelope_lines import Spectra, spectra_of
from crankorder.orders import intervals
from crankorder.orders.fixed_lines import OrderRows
from crankorder.orders.track_rows import ON_BIN, ON_BIN_NAMES
from crankorder.orders.true_angle import UNKNOWN_DEG
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.records import Document, finite, known
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-changes.toml", "order_changes")
RUN_NUMBERS = MethodNumbers("5-identify-changes.toml", "run_trends")
TREND_NUMBERS = MethodNumbers("5-identify-bearings.toml", "trend")

ALWAYS = (1.0, 2.0)
"""Orders that are compared whether or not a test found them: where a change of mass shows."""

TO_DB = 20.0 / np.log(10.0)
"""Decibels of a ratio of amplitudes for each unit of its natural logarithm."""

EXACT = 1e-9
"""Relative size of a difference that is rounding."""


@dataclass(frozen=True, eq=False)
class Tested:
    """The results of one test: its name, findings, what ``run.json`` states, and its datasets by name."""

    name: str
    findings: Findings
    run: Document
    maps: Mapping[str, xr.Dataset]

    @cached_property
    def order_map(self) -> xr.Dataset:
        """OrderMap whose bins have the rows of the tracks on them, which know the lines of one frequency they meet.

        ``hidden`` (channel, speed, order) is True where such lines may add more than noise hides; a phase that they
        hide is NaN.
        """
        order_map, tracks = self.maps["order_map"].copy(), self.maps.get("order_tracks")
        dims = ("channel", "speed", "order")
        held = {name: order_map[name].transpose(*dims).values.copy() for name in ON_BIN_NAMES}
        hidden = np.zeros(held["phase"].shape, dtype=np.bool_)
        if tracks is not None and tracks["channel"].values.tolist() == order_map["channel"].values.tolist():
            slack = {"order": ON_BIN, "speed": EXACT * np.nanmax(np.append(order_map["speed"], 1.0))}
            bins, rows = (  # positions in both of the places that are one in both
                np.nonzero(np.abs(order_map[name].values[:, None] - tracks[name].values) <= within)
                for name, within in slack.items()
            )
            every = np.arange(len(hidden))
            inside, beside = np.ix_(every, rows[0], bins[0]), np.ix_(every, bins[1], rows[1])
            own = held["coherent_amplitude_high"][inside] - held["coherent_amplitude_low"][inside]
            for name, field in zip(ON_BIN_NAMES, OrderRows._fields, strict=True):
                held[name][inside] = tracks[field].values[beside].transpose(0, 2, 1)
            width = held["coherent_amplitude_high"][inside] - held["coherent_amplitude_low"][inside]
            hidden[inside] = width > 2.0 * own  # what they may add is more than the half width of noise
            unknown = hidden[inside] & (held["phase_ci95"][inside] >= UNKNOWN_DEG)
            held["phase"][inside] = np.where(unknown, np.nan, held["phase"][inside])
        return order_map.assign({name: (dims, values) for name, values in (*held.items(), ("hidden", hidden))})

    @property
    def comparable(self) -> set[str]:
        """What a comparison can take from these results: "orders" of an order map, "modes" where they were sought."""
        return ({"orders"} if "order_map" in self.maps else set()) | ({"modes"} & set(self.findings.looked_for))


def order_maps(tests: Sequence[Tested]) -> list[xr.Dataset]:
    """OrderMaps of the ``tests``; none where any of them has none."""
    return [test.order_map for test in tests] if all("orders" in test.comparable for test in tests) else []


@dataclass(frozen=True, eq=False)
class Line:
    """One order in one channel at some speeds: amplitude, its standard error and freedom, and its phasor (NaN: none).

    ``vector_error`` is the standard error of each part of the phasor, ``noise`` what of it adds to its length,
    ``hidden`` whether lines of one frequency, such as mains, may add more to it than noise hides.
    """

    amplitude: Floats
    error: Floats
    freedom: Floats
    vector: Complexes
    vector_error: Floats
    noise: Floats | float = 0.0
    hidden: Bools | bool = False

    @property
    def without_phasor(self) -> Line:
        """The same by its amplitude alone."""
        nothing = np.full(len(self.amplitude), np.nan)
        return replace(self, vector=nothing.astype(np.complex128), vector_error=nothing)

    @property
    def clear(self) -> Bools:
        """At which speeds it stands clear of its noise."""
        return np.asarray((self.amplitude > NUMBERS.clear_sigmas * self.error) & (self.amplitude > 0))

    @property
    def size(self) -> Floats:
        """Amplitude without what noise adds to the length of a phasor, which is ``noise``² / (2 amplitude)."""
        return np.asarray(np.sqrt(np.maximum(self.amplitude**2 - np.square(self.noise), 0.25 * self.amplitude**2)))


class MeanRatio(NamedTuple):
    """Weighted mean over the speeds of an order's ratio [dB], 95 % interval, p-values of "1" and of "alike at all"."""

    ratio_db: float
    ci95_db: tuple[float, float]
    p_value: float
    p_alike: float


@dataclass(frozen=True, eq=False)
class OrderChange:
    """One order in one channel in two tests at like speeds; every interval (speeds, 2) holds 95 %.

    ``changed`` and ``changed_at`` are claims at the false-discovery rate that was asked for; ``phase_only`` is True
    where ``changed`` is claimed of the phasors, and would not be of the amplitudes.
    """

    base_rpm: Floats
    new_rpm: Floats
    base: Line
    new: Line
    channel: str = ""
    order: float = 1.0
    unit: str = ""
    locked: bool = True
    changed_at: Bools | tuple[()] = ()
    changed: bool = False
    phase_only: bool = False

    @property
    def difference(self) -> Floats:
        """Amplitude of the second test less that of the first (speeds,)."""
        return np.asarray(self.new.amplitude - self.base.amplitude)

    @property
    def difference_ci95(self) -> Floats:
        """Its interval."""
        error, freedom = welch(self.base.error, self.base.freedom, self.new.error, self.new.freedom)
        return self.difference[:, None] + (intervals.half_widths(freedom) * error)[:, None] * (-1.0, 1.0)

    @property
    def undecided_at(self) -> Bools:
        """Speeds (speeds,) without a claim at which lines of one frequency may hide a change."""
        return np.asarray((self.base.hidden | self.new.hidden) & ~np.asarray(self.changed_at, dtype=np.bool_))

    @property
    def vector_change(self) -> Complexes:
        """Phasor of the second test less that of the first; NaN where their phases cannot be compared."""
        return np.asarray(self.new.vector - self.base.vector)

    @property
    def ratio_db(self) -> Floats:
        """Amplitude of the second test over that of the first (speeds,), dB."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(20.0 * np.log10(self.new.amplitude / self.base.amplitude))

    @property
    def ratio_db_ci95(self) -> Floats:
        """Its interval: by the logarithm's error where both are clear, else from both intervals at 97.5 %."""
        base, new = self.base, self.new
        with np.errstate(divide="ignore", invalid="ignore"):
            error, freedom = welch(base.error / base.amplitude, base.freedom, new.error / new.amplitude, new.freedom)
            near = self.ratio_db[:, None] + TO_DB * (intervals.half_widths(freedom) * error)[:, None] * (-1.0, 1.0)
            reach, new_reach = (intervals.half_widths(line.freedom, level=0.975) * line.error for line in (base, new))
            low = np.maximum(new.amplitude - new_reach, 0.0) / (base.amplitude + reach)
            high = (new.amplitude + new_reach) / np.maximum(base.amplitude - reach, 0.0)
            far = TO_DB * np.log(np.stack([low, high], axis=1))
        return np.asarray(np.where((base.clear & new.clear)[:, None], near, far))

    @cached_property
    def p_value(self) -> Floats:
        """Chance of so large a difference where nothing changed: of phasors where there are any, else of amplitudes."""
        base, new = self.base, self.new
        apart, difference = np.abs(self.vector_change), np.abs(self.difference)
        error, freedom = welch(base.error, base.freedom, new.error, new.freedom)
        spread, vector_freedom = welch(base.vector_error, base.freedom, new.vector_error, new.freedom)
        size = np.maximum(base.amplitude, new.amplitude)
        with np.errstate(divide="ignore", invalid="ignore"):
            by_vector = fdtrc(2.0, vector_freedom, apart**2 / (2.0 * spread**2))
            by_amplitude = 2.0 * stdtr(freedom, -difference / error)
        by_vector = np.where(apart <= EXACT * size, 1.0, by_vector)
        by_amplitude = np.where(difference <= EXACT * size, 1.0, by_amplitude)
        return np.asarray(np.where(np.isfinite(apart), by_vector, by_amplitude))

    @cached_property
    def mean(self) -> MeanRatio:
        """Mean ratio over the speeds at which both lines are clear of their noise; NaN without such.

        The speeds are these and no sample of others: the error is that of the measurement alone, corrected for weights
        that are estimated (Meier 1953, Biometrics 9, 59).
        """
        kept = self.base.clear & self.new.clear
        if not kept.any():
            return MeanRatio(np.nan, (np.nan, np.nan), np.nan, np.nan)
        (size, relative, of_base), (new_size, new_relative, of_new) = (
            (line.size[kept], line.error[kept] / line.amplitude[kept], line.freedom[kept])
            for line in (self.base, self.new)
        )
        error, freedom = welch(relative, of_base, new_relative, of_new)
        values = np.log(new_size / size)
        values = np.where(np.abs(values) <= EXACT, 0.0, values)
        weight = 1.0 / np.maximum(error, 1e-12) ** 2
        share = weight / weight.sum()
        mean = float(np.sum(share * values))
        error_of_mean = float(np.sqrt((1.0 + 4.0 * np.sum(share * (1.0 - share) / freedom)) / weight.sum()))
        degrees = 1.0 / float(np.sum(share**2 / freedom))
        low, high = intervals.interval(mean * TO_DB, error_of_mean * TO_DB, freedom=degrees)
        spare = len(values) - 1
        alike = chance_of(float(np.sum(weight * (values - mean) ** 2)) / spare, spare, freedom) if spare else np.nan
        return MeanRatio(mean * TO_DB, (low, high), float(2.0 * stdtr(degrees, -abs(mean) / error_of_mean)), alike)

    @property
    def p_all(self) -> float:
        """Chance of so large a difference at all speeds together where nothing changed."""
        return float(np.nanmin([1.0, 2.0 * self.mean.p_value, 2.0 * intervals.simes(self.p_value)]))


def like_speeds(base_rpm: Floats, new_rpm: Floats, *, within_rpm: float) -> tuple[Ints, Ints]:
    """Positions in both lists of the speeds that are compared with one another: nearest first, each used once.

    Parameters
    ----------
    base_rpm, new_rpm : (speeds,), min-1; NaN (speed unknown) is like a single NaN of the other test, and nothing else
    within_rpm : largest difference of two like speeds, min-1; nothing is interpolated
    """
    if len(base_rpm) == len(new_rpm) == 1 and np.isnan(base_rpm[0]) and np.isnan(new_rpm[0]):
        return np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
    apart = np.abs(base_rpm[:, None] - new_rpm[None, :])
    taken: dict[int, int] = {}
    for at in np.argsort(apart, axis=None, kind="stable"):
        in_base, in_new = map(int, np.unravel_index(at, apart.shape))
        if apart[in_base, in_new] <= within_rpm and in_base not in taken and in_new not in taken.values():
            taken[in_base] = in_new
    pairs = np.array(sorted(taken.items()), dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def orders_to_compare(
    base: Sequence[OrderFinding], new: Sequence[OrderFinding], highest: float
) -> list[tuple[float, bool]]:
    """Orders that either test found and orders 1 and 2, ascending, each with whether it is locked to the shaft.

    ``base`` and ``new`` are the ``orders`` of both findings; ``highest`` is the last order of the maps. Records within
    their intervals of one another are one order, called by the half order that they agree with.
    """
    groups: dict[float, bool] = {}
    for record in [*base, *new]:
        order, ends = record.order, known(record.order_ci95) or (record.order, record.order)
        half = round(2 * order) / 2
        named = half if ends[0] <= half <= ends[1] or abs(order - half) < NUMBERS.same_order else order
        same = next((called for called in groups if abs(called - named) < NUMBERS.same_order), named)
        groups[same] = groups.get(same, True) and record.lock != "slips"
    missing = [order for order in ALWAYS if all(abs(order - called) >= NUMBERS.same_order for called in groups)]
    groups |= dict.fromkeys(missing, True)
    return sorted((order, locked) for order, locked in groups.items() if 0 < order <= highest + NUMBERS.same_order)


def line_of(order_map: xr.Dataset, channel: str, order: float, at: Ints, *, locked: bool, phases: bool) -> Line:
    """Amplitude and phasor of an order in one channel, at some speeds.

    Parameters
    ----------
    order_map : OrderMap
    channel : name of the channel
    order : cycles per revolution; the nearest bin is read, and of a slipping line those beside it too
    at : positions of the speeds
    locked : True reads the coherent average; False the energy, whose error is that of the frames' own scatter
    phases : whether to give the phasor
    """
    number = order_map["channel"].values.tolist().index(channel)
    peak = int(np.argmin(np.abs(order_map["order"].values - order)))

    def values(name: str, bins: Any = peak) -> Floats:
        table = order_map[name].transpose("channel", "speed", "order").values[number][at]
        return np.asarray(table[:, bins], dtype=np.float64)

    if not locked or not np.isfinite(values("coherent_amplitude")).any():
        return _by_energy(order_map, values, peak, at)
    amplitude, error = values("coherent_amplitude"), values("standard_error")
    freedom = np.maximum(np.nan_to_num(values("degrees_of_freedom"), nan=1.0), 1.0)
    half = np.radians(values("phase_ci95"))
    across = np.where(half < np.pi / 2, amplitude * half / intervals.half_widths(freedom), 0.0)
    vector = np.asarray(amplitude * np.exp(1j * np.radians(values("phase"))), dtype=np.complex128)
    hidden = values("hidden") > 0.0
    line = Line(amplitude, error, freedom, vector, np.maximum(error, np.nan_to_num(across)), error, hidden)
    return line if phases else line.without_phasor


def _by_energy(order_map: xr.Dataset, values: Any, peak: int, at: Ints) -> Line:
    """Amplitude from the energy of the bin and its neighbours, so that a line between two bins loses nothing."""
    bins = slice(max(peak - 1, 0), peak + 2)
    lost = float(order_map.attrs.get("enbw_bins", 1.5))
    amplitude = np.sqrt(np.sum(values("amplitude", bins) ** 2, axis=1) / lost)
    frames = np.maximum(order_map["n_independent"].values[at].astype(np.float64), 1.0)
    # variance of a frame's energy over its square; noise has 1, a steady line 0; never trusted below one in frames
    spread = np.clip(np.nan_to_num(values("spectral_kurtosis"), nan=0.0) + 1.0, 1.0 / frames, None)
    error = 0.5 * amplitude * np.sqrt(spread / frames)
    beside = [k for k in (*range(peak - 6, peak - 2), *range(peak + 3, peak + 7)) if 0 < k < order_map.sizes["order"]]
    level = np.nan_to_num(np.nanmedian(values("amplitude", beside), axis=1)) if beside else np.zeros(len(at))
    noise = level * np.sqrt(bins.stop - bins.start) / np.sqrt(lost)
    return Line(amplitude, error, np.maximum(frames - 1.0, 1.0), amplitude + 0j, error, noise).without_phasor


def order_changes(
    base: Tested, new: Tested, channels: Sequence[str], *, within_rpm: float, q: float, phases: bool
) -> tuple[tuple[SpeedPair, ...], list[tuple[float, bool]], list[OrderChange]]:
    """Speeds and orders that are compared, and the change of each order in each channel, with claims.

    Nothing is compared where either test has no OrderMap.

    Parameters
    ----------
    base, new : the two tests
    channels : names of channels that both have in the same unit
    within_rpm : largest difference of speeds that are compared, min-1
    q : false-discovery rate of the claims, 0 to 1: over orders and channels, and over all their speeds
    phases : False where the marks from which phases count are not the same place in both tests
    """
    maps = order_maps((base, new))
    if not maps:
        return (), [], []
    at = like_speeds(maps[0]["speed"].values, maps[1]["speed"].values, within_rpm=within_rpm)
    rpm = [order_map["speed"].values[rows] for order_map, rows in zip(maps, at, strict=True)]
    speeds = tuple(SpeedPair(base_rpm=finite(a), new_rpm=finite(b)) for a, b in zip(*rpm, strict=True))
    highest = min(float(order_map["order"].values[-1]) for order_map in maps)
    orders = orders_to_compare(base.findings.orders, new.findings.orders, highest)
    unit = dict(zip(maps[0]["channel"].values.tolist(), maps[0]["unit"].values.tolist(), strict=True))
    changes: list[OrderChange] = []
    for channel in channels if speeds else ():
        for order, locked in orders:
            with_phases = phases and locked and bool(intervals.phases_compare(maps, np.array(order)))
            read = partial(line_of, channel=channel, order=order, locked=locked, phases=with_phases)
            before, after = (read(order_map, at=rows) for order_map, rows in zip(maps, at, strict=True))
            if np.isfinite(before.amplitude).any() and np.isfinite(after.amplitude).any():
                after = _for_speed(maps[0], at[0], np.abs(rpm[1] - rpm[0]), after, read)
                changes.append(OrderChange(rpm[0], rpm[1], before, after, channel, order, str(unit[channel]), locked))
    if not changes:
        return speeds, orders, changes
    of_amplitude = [replace(c, base=c.base.without_phasor, new=c.new.without_phasor) for c in changes]
    whole, size = (intervals.claimed(np.array([c.p_all for c in each]), q=q) for each in (changes, of_amplitude))
    by_speed = intervals.claimed(np.stack([c.p_value for c in changes]), q=q)
    # a mark that was moved turns an order at every speed; at a few of them the marks of single recordings may err
    whole &= size | (np.mean(by_speed, axis=1) >= NUMBERS.turned_share)
    return speeds, orders, [
        replace(c, changed=bool(claim), changed_at=claims, phase_only=bool(claim and not by_size))
        for c, claim, by_size, claims in zip(changes, whole, size, by_speed, strict=True)
    ]  # fmt: skip


def _for_speed(base: xr.Dataset, at: Ints, apart: Floats, new: Line, read: Callable[..., Line]) -> Line:
    """The line ``new`` with errors that hold what like speeds that are ``apart`` may make, by the slope in ``base``.

    ``read`` gives the line of that order and channel in a map (:func:`line_of`).
    """
    speed = base["speed"].values
    known = np.argsort(speed, kind="stable")[: np.count_nonzero(np.isfinite(speed))]
    if len(known) < 2 or not np.any(apart > 0):
        return new
    whole, slopes, added = read(base, at=known), np.zeros(len(speed)), []
    for values in (whole.amplitude, whole.vector):
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.abs(np.diff(values)) / np.diff(speed[known])
        steps = np.where(np.isfinite(steps), steps, 0.0)
        slopes[known] = np.maximum(np.append(steps, 0.0), np.insert(steps, 0, 0.0))
        added.append(slopes[at] * apart)
    return replace(new, error=np.hypot(new.error, added[0]), vector_error=np.hypot(new.vector_error, added[1]))


def welch(error: Floats, freedom: Floats, error2: Floats, freedom2: Floats) -> tuple[Floats, Floats]:
    """Standard error of a difference and its degrees of freedom, of the shape of the arguments.

    ``error`` and ``error2`` are the standard errors of both sides, ``freedom`` and ``freedom2`` theirs (≥ 1).
    Source: Welch (1947), Biometrika 34, 28; Satterthwaite (1946), Biometrics Bull. 2, 110.
    """
    both = error**2 + error2**2
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(both > 0, error**2 / both, 0.5)
    effective = 1.0 / (share**2 / freedom + (1.0 - share) ** 2 / freedom2)
    return np.sqrt(both), np.maximum(effective, 1.0)


def chance_of(mean_square: float, spare: float, freedom: Floats) -> float:
    """Chance of a larger ``mean_square`` of ``spare`` residuals over variances, each estimated with its ``freedom``."""
    # an estimated variance makes a square over it larger on average, by freedom / (freedom − 2)
    fair = float(np.mean(np.maximum(freedom - 2.0, 0.5) / freedom))
    return float(fdtrc(spare, float(np.sum(freedom)), fair * mean_square))


class RunAmplitudes(NamedTuple):
    """Amplitudes (runs,) of one line in repeated runs, their standard errors and the degrees of freedom of these.

    They are NaN where a run does not show the line.
    """

    amplitudes: Floats
    errors: Floats
    freedom: float = math.inf


def run_trends(
    tests: Sequence[Tested], orders: Sequence[tuple[float, bool]], channels: Sequence[str], *, within_rpm: float
) -> list[Trend]:
    """How each line grows from run to run, no claim made yet; of two runs the bearing lines alone.

    Parameters
    ----------
    tests : the runs, in time order; orders are followed where all have an OrderMap
    orders : orders with whether they are locked
    channels : names that all runs have in the same unit
    within_rpm : largest difference of speeds that are compared, min-1
    """
    trends: list[Trend | None] = []
    maps = order_maps(tests) if len(tests) >= RUN_NUMBERS.least_runs else []
    speeds = [order_map["speed"].values for order_map in maps]
    matches = [like_speeds(speeds[0], rpm, within_rpm=within_rpm) for rpm in speeds]
    to_run = [dict(zip(here.tolist(), there.tolist(), strict=True)) for here, there in matches]
    together = sorted(set(to_run[0]).intersection(*to_run)) if maps else []
    at = [np.array([positions[k] for k in together], dtype=np.int64) for positions in to_run]
    for channel in channels if together else ():
        for order, locked in orders:
            lines = [line_of(m, channel, order, k, locked=locked, phases=False) for m, k in zip(maps, at, strict=True)]
            clear = np.all([line.amplitude > 2.0 * line.error for line in lines], axis=0)
            if clear.any():  # geometric means over the speeds
                sizes, errors = np.array([(line.size[clear], line.error[clear]) for line in lines]).swapaxes(0, 1)
                means = np.exp(np.log(sizes).mean(axis=1))
                spread = np.sqrt(np.square(errors / sizes).sum(axis=1)) / sizes.shape[1]
                freedom = float(np.sum([line.freedom[clear].sum() for line in lines]) / len(lines))
                runs = RunAmplitudes(means, means * spread, max(freedom, 1.0))
                trends.append(trend_over(runs, line=f"order {order:g}", channel=channel, order=order))
    return [trend for trend in (*trends, *_bearing_trends(tests, channels)) if trend]


def trend_over(
    runs: RunAmplitudes, *, line: str = "", kind: LineKind = "order", channel: str = "", order: float = 1.0
) -> Trend | None:
    """Trend over the ``runs`` of one test, two or more, by their errors; None where one of them does not show the line.

    A straight line through the logarithms, weighted by their errors; from three runs on these are widened where the
    runs scatter more than they say, and the interval is Student's.
    ``line``, ``kind``, ``channel`` and ``order`` name it in the record.
    Source: MSU thesis: re-run the same test, growth means failing.
    """
    sizes, errors, freedom = runs
    if not (len(sizes) and np.all(sizes > 0) and np.all(errors >= 0)):
        return None
    half = intervals.half_width(freedom)
    ends = tuple(intervals.positive_interval(float(a), half * float(e)) for a, e in zip(sizes, errors, strict=True))
    logs, run = np.log(sizes), np.arange(len(sizes), dtype=np.float64)
    weight = np.maximum(errors / sizes, 1e-9) ** -2.0
    beside = run - (weight * run).sum() / weight.sum()
    variance = 1.0 / float((weight * beside**2).sum())
    slope = float((weight * beside * logs).sum()) * variance
    if len(run) > 2:
        rest = logs - (weight * logs).sum() / weight.sum() - slope * beside
        scatter = float((weight * rest**2).sum()) / (len(run) - 2)
        if scatter > 1.0:
            variance, freedom = variance * scatter, len(run) - 2.0
    error = math.sqrt(variance)
    half = error * intervals.half_width(freedom, level=1.0 - TREND_NUMBERS.no_change_chance)
    growth, low, high = (math.expm1(min(value, 700.0)) for value in (slope, slope - half, slope + half))
    return Trend(
        line=line, kind=kind, channel=channel, order=order, amplitude=tuple(sizes.tolist()), amplitude_ci95=ends,
        growth_per_run=growth, growth_per_run_ci95=(low, high),
        p_value=float(2.0 * stdtr(intervals.known_freedom(freedom), -abs(slope) / error)),
    )  # fmt: skip


_LineKey = tuple[str, str, str, str]
"""Name of the bearing, line, where it is seen, channel."""


def _bearing_trends(tests: Sequence[Tested], channels: Sequence[str]) -> Iterator[Trend | None]:
    """Bearing lines that any run names: from the envelope maps where all runs have one, else from the findings."""
    lines: dict[_LineKey, float] = {}
    recorded: list[dict[_LineKey, tuple[float, float]]] = []
    for test in tests:
        recorded.append({})
        for record in test.findings.bearings:
            if record.channel is not None and record.channel in channels:
                key: _LineKey = record.name, record.line, record.seen_in or "vibration", record.channel
                lines.setdefault(key, record.order)
                if ends := known(record.amplitude_ci95):
                    recorded[-1].setdefault(key, (record.size, intervals.error_of(record.size, ends)))
    maps = [test.maps["envelope_map"] for test in tests if "envelope_map" in test.maps]
    followed = set()
    for key, order in lines.items():
        name, line, seen_in, channel = key
        add = partial(trend_over, line=f"{name} {line}", order=order)
        if seen_in != "envelope":
            sizes, errors = np.array([of_run.get(key, (np.nan, np.nan)) for of_run in recorded]).T
            yield add(RunAmplitudes(sizes, errors), kind="bearing", channel=channel)
        elif len(maps) == len(tests) and (name, line) not in followed:
            followed.add((name, line))
            yield add(run_amplitudes(maps, order=order), kind="bearing, envelope")


def run_amplitudes(envelopes: Sequence[xr.Dataset], *, order: float) -> RunAmplitudes:
    """Amplitudes of the line at ``order`` in the EnvelopeMaps of repeated runs, as shares of their mean.

    They are taken over all channels and speeds that all ``envelopes`` hold and in which the line stands clear in at
    least one run; none where there is no such. The amplitude of a run without the line is that of half its noise.
    Errors are those of the noise, widened where speeds disagree on how the runs compare, for strikes vary by
    themselves, and where the bands of demodulation differ from run to run.
    """
    none = RunAmplitudes(np.zeros(0), np.zeros(0))
    spectra = [spectra_of(envelope) for envelope in envelopes if envelope.sizes["order"] > 1]
    if len(spectra) < len(envelopes) or not spectra or any(s.count.shape != spectra[0].count.shape for s in spectra):
        return none
    ratio, power, count = (np.array(values) for values in zip(*(_at(of_run, order) for of_run in spectra), strict=True))
    clear = ratio.max(axis=0) >= TREND_NUMBERS.least_ratio
    if not clear.any():
        return none
    low, high = (np.array([envelope[end].values for envelope in envelopes]) for end in ("band_low", "band_high"))
    other = (np.abs(low - low[0]) > 0.02 * high) | (np.abs(high - high[0]) > 0.02 * high)
    own = np.maximum(ratio - 1.0, 0.5)
    logs = 0.25 * np.log(power / ratio * own)
    variance = (2.0 * ratio + 1.0) / (np.maximum(count, 1.0) * (4.0 * own) ** 2)
    variance += TREND_NUMBERS.band_change_share**2 * other
    # cells differ in level: each is taken beside its own mean over the runs
    beside = logs - logs.mean(axis=0)
    weight = np.where(clear, 1.0 / variance.mean(axis=0), 0.0)
    mean = (beside * weight).sum(axis=(1, 2)) / weight.sum()
    error = np.sqrt((variance * weight**2).sum(axis=(1, 2))) / weight.sum()
    spread, freedom = _disagreement(beside, weight, mean)
    widened = error * math.sqrt(max(spread, 1.0))
    return RunAmplitudes(np.exp(mean), np.exp(mean) * widened, freedom if spread > 1.0 else math.inf)


def _disagreement(beside: Floats, weight: Floats, mean: Floats) -> tuple[float, float]:
    """By how much more than their noise the speeds disagree on the runs (ratio of variances), and degrees of freedom.

    ``beside`` (run, channel, speed) are logarithms beside their means over the runs, ``mean`` (runs,) those over the
    rest; channels of one speed see the same strikes and count as one.
    """
    of_speed = weight.sum(axis=0)
    seen = of_speed > 0.0
    freedom = (int(seen.sum()) - 1) * (len(mean) - 1)
    if freedom < 1:
        return 1.0, math.inf
    by_speed = (beside * weight).sum(axis=1)[:, seen] / of_speed[seen]
    return float((of_speed[seen] * (by_speed - mean[:, None]) ** 2).sum()) / freedom, float(freedom)


def _at(spectra: Spectra, order: float) -> tuple[Floats, Floats, Floats]:
    """Power ratio, power of the line near ``order`` and independent spectra, each (channel, speed)."""
    near = spectra.near(order)
    at = spectra.ratio[:, :, near].argmax(axis=2)[:, :, None]
    ratio, size = (np.take_along_axis(of[:, :, near], at, axis=2)[:, :, 0] for of in (spectra.ratio, spectra.amplitude))
    return np.maximum(ratio, 1e-9), np.maximum(np.nan_to_num(size**4), 1e-300), spectra.count
