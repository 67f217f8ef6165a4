"""Order lines over a stated false-alarm level, with order and amplitudes; in one sweep, those worth following."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import comb

import numpy as np
import xarray as xr
from scipy.ndimage import maximum_filter1d
from scipy.special import chdtrc

from crankorder.identify.found import UNRESOLVED, Doubt, Evidence, OrderLine
from crankorder.identify.lines.growth import remark_on
from crankorder.identify.lines.line_evidence import (
    LOWEST_BINS,
    UNPROVEN,
    OverNoise,
    evidence_of,
    excess_over_noise,
    has_moved,
    is_unprovable,
    keeps_its_phase,
    keeps_one_order,
    noise_chance,
)
from crankorder.identify.lines.line_phasors import Bin, Phasors, Recording, any_swept, phasors_at, recordings_of, zooms
from crankorder.identify.lines.zoom import left_of_slow_waves
from crankorder.orders.averages import HeldSizes, SizeRows
from crankorder.orders.intervals import half_width
from crankorder.orders.joint_lines import hann_lobe
from crankorder.orders.like_speed import reframed
from crankorder.orders.map import order_map
from crankorder.quantities import Complexes, Floats, Ints
from crankorder.scratch import give_back
from crankorder.settings import IdentifySettings, MethodNumbers, OrderSettings, Settings

NUMBERS = MethodNumbers("5-identify-lines.toml", "order_lines")

ANYWHERE_BINS = float(np.sqrt(1.0 / 12.0))
"""Standard deviation, in bins, of the place of a line that may lie anywhere within one."""

SWELLS = Doubt("swells", "it swells and fades slowly: two lines closer than a recording can tell may stand here")

ONE_SPEED = Doubt("one speed", "at one speed a line of fixed frequency would look the same")


@dataclass(frozen=True)
class _Search:
    """What all channels' lines are looked for in: the map, what stands over the noise, and how often noise would."""

    order_map: xr.Dataset
    recordings: list[Recording]
    over: OverNoise
    false_alarm_probability: float

    @property
    def axis(self) -> Floats:
        return np.asarray(self.order_map.variables["order"].values)

    @property
    def speed(self) -> Floats:
        return np.asarray(self.order_map.variables["speed"].values)

    @property
    def bins(self) -> int:
        """Bins of all channels."""
        return self.over.excess[:, 0].size

    @cached_property
    def is_swept(self) -> bool:
        """Whether the speeds are those of a run-up or coast-down and not steps: by the frames, or as groups touch."""
        if self.recordings:
            return any_swept(self.recordings)
        speed = np.sort(self.speed)
        return len(speed) > 2 and bool(np.median(np.diff(speed)) < 1.5 * self.speed_bin_rpm)

    @property
    def speed_bin_rpm(self) -> float:
        """Width of a group of speeds."""
        return float(self.order_map.attrs.get("speed_bin_rpm", 25.0))

    def chances(self, channel: int, peak: int, speeds: Ints) -> Floats:
        """Chance that noise alone stands as high in the bin ``peak`` at each of the ``speeds`` (numbers)."""
        n, ratio = self.order_map.variables["n_independent"].values[speeds], self.over.ratio[channel, speeds, peak]
        cells = np.array([ratio, n, self.over.floor_worth[channel, speeds, peak]]).T
        return np.array([noise_chance(*cell) for cell in cells.tolist()])

    def phasors(self, channel: int, peak: int, speeds_rpm: Floats, *, bins: float) -> Iterable[Phasors]:
        """What the frames hold of the bin ``peak`` near ``speeds_rpm``, within so many ``bins`` of speed."""
        return phasors_at(self.recordings, Bin([channel], peak, speeds_rpm, bins * self.speed_bin_rpm)).values()


def order_lines(
    order_map: xr.Dataset, *, settings: IdentifySettings, orders: OrderSettings, frames: Sequence[xr.Dataset] = ()
) -> list[OrderLine]:
    """Order lines of all channels of the OrderMap ``order_map``, by channel, then by order.

    A line stands above the level that noise alone reaches with ``settings.false_alarm_probability`` at enough speeds
    (``settings.min_speeds``, ``settings.min_speed_fraction``), is the largest within a quarter order, or within
    eight bins if these are less, and is no resonance that noise excites: its frames agree in phase (locked to the
    shaft), or in amplitude over speeds at which a fixed frequency would have left its bin (it slips), or at one speed
    more than the least damped resonance would; or it follows the speed far. In a test too short for such
    proof, a high line on an order of the cycle is named with that doubt; and so is one at too few speeds, where
    noise would make one like it somewhere in the map with less than ``settings.false_alarm_probability``.
    ``orders`` give the floor's width. With the ``frames`` (OrderFrames of all recordings) a line also counts that keeps
    one order, though no exact multiple of the shaft's, by the turn of its phase (a map alone shows that of long lines
    only); one that swells and fades slowly, as two do that are too close to be parted, is kept with that doubt.
    """
    over = excess_over_noise(order_map, settings=settings, orders=orders)
    search = _Search(order_map, recordings_of(frames), over, settings.false_alarm_probability)
    n_speeds = len(search.speed)
    needed = min(n_speeds, max(settings.min_speeds, round(settings.min_speed_fraction * n_speeds)))
    lines = []
    for channel in range(len(over.excess)):
        named, refused = [], []
        for peak in _peaks(over.excess[channel], search.axis).tolist():
            seen = np.flatnonzero(over.excess[channel, :, peak] > 1.0)
            line = _line_at(search, channel, peak, seen, needed)
            if line is None:
                refused.append((peak, seen))
            else:
                named.append(line)
        named += _stronger(search, channel, refused, named)
        lines += sorted(named, key=lambda line: line.order)
    return lines


def _stronger(
    search: _Search, channel: int, refused: list[tuple[int, Ints]], named: list[OrderLine]
) -> list[OrderLine]:
    """Lines, with a doubt, of ``refused`` peaks (bin, speeds) above all that is ``named`` in the channel.

    No rule tells what they are, but nothing weaker may pass for the strongest beside them: they stand far over the
    floor, and not at the same frequency at the speeds beside.
    """
    if len(search.speed) < 2 or not search.is_swept:
        return []  # at speeds that are held the rules tell lines
    # at the last bins skirts of others end
    last = len(search.axis) - NUMBERS.neighbour_bins
    largest = max((float(line.amplitude.max()) for line in named), default=0.0)
    amplitude = np.nan_to_num(search.order_map["amplitude"].values[channel])
    stronger = []
    for peak, seen in refused:
        far = peak < last and float(search.over.ratio[channel, seen, peak].max()) > NUMBERS.swelling_ratio
        if far and amplitude[seen, peak].max() > largest and not _has_fixed_frequency(search, channel, peak, seen):
            line = _line(search, channel, peak, seen, UNPROVEN, (UNRESOLVED,))
            # two lines in one bin may be nothing, or twice what it holds
            ends = line.amplitude[:, None] * np.array([0.0, 2.0])
            stronger.append(replace(line, amplitude_error=0.5 * line.amplitude, ends=ends))
    return stronger


def _line_at(search: _Search, channel: int, peak: int, seen: Ints, needed: int) -> OrderLine | None:
    """The line in bin ``peak``; None where it is noise, a resonance or, at fewer speeds than ``needed``, doubtful."""
    chance, n_speeds, doubts = search.false_alarm_probability, len(search.speed), list[Doubt]()
    together = seen if len(seen) >= needed or search.is_swept else _seen_together(search, channel, peak)
    if len(together) >= needed and not (len(seen) < needed and _has_fixed_frequency(search, channel, peak, seen)):
        seen = together
    elif len(seen) < needed:
        if not _beyond_chance(search, channel, peak, seen) or _has_fixed_frequency(search, channel, peak, seen):
            return None
        chance /= search.over.excess[0].size
        doubts.append(Doubt("seldom seen", f"seen at {len(seen)} of {n_speeds} speeds only"))
    evidence = evidence_of(search.order_map, search.over.ratio[channel], channel, peak, seen, chance)
    if evidence is None and _keeps_one_order(search, channel, peak, seen, chance):
        steady: Evidence = "follows the speed" if search.is_swept else "steady, not locked"
        evidence = UNPROVEN if is_unprovable(search.order_map, peak) else steady
    if evidence is None:
        evidence = _by_its_phase(search, channel, peak, seen, chance)
    if evidence is None and _swells_slowly(search, channel, peak, seen):
        evidence = UNPROVEN
        doubts.append(SWELLS)
    few = 2 * len(seen) < n_speeds and evidence == "steady, not locked"
    if evidence is None or (few and _has_fixed_frequency(search, channel, peak, seen)):
        return None
    if evidence == "steady, not locked" and n_speeds == 1:
        doubts.append(ONE_SPEED)
    return _line(search, channel, peak, seen, evidence, tuple(doubts))


def _seen_together(search: _Search, channel: int, peak: int) -> Ints:
    """Speeds at which a line stands that all of them together show, though each alone does not; none where noise would.

    The chances of all speeds are joined (Fisher 1925) and counted over every bin and channel of the map. The half of
    the speeds that shows least must speak for it too: an order that meets resonances stands high at some, not at these.
    """
    chances = search.chances(channel, peak, np.arange(len(search.speed)))
    shown = search.bins * _joined_chance(chances) < search.false_alarm_probability
    least = np.sort(chances)[len(chances) // 2 :]
    if not shown or _joined_chance(least) > NUMBERS.weak_chance:
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(chances < NUMBERS.weak_chance)


def _joined_chance(chances: Floats) -> float:
    """Chance that noise alone makes ``chances`` as small as these together (Fisher 1925)."""
    return float(chdtrc(2.0 * len(chances), -2.0 * np.sum(np.log(np.maximum(chances, 1e-300)))))


def _keeps_one_order(search: _Search, channel: int, peak: int, seen: Ints, chance: float) -> bool:
    """Whether the frames show that the line keeps one order, over speeds that no line of fixed frequency allows."""
    if not search.recordings or not has_moved(search.order_map, peak, seen):
        return False
    floor = float(np.median(search.over.floor[channel, seen, peak]))
    for alone in (True, False):  # two lines that beat hide each other's steadiness
        place = Bin([channel], peak, search.speed[seen], search.speed_bin_rpm)
        by_recording = zooms(search.recordings, place, near=0.0, alone=alone)
        lines = [
            line
            for line in by_recording.values()  # a resonance that noise excites leaves far more than two lines do
            if alone or (line.left is not None and float(np.median(line.left)) < NUMBERS.left_ratio * floor)
        ]
        if keeps_one_order(lines, false_alarm_probability=chance):
            return True
    return False


def _by_its_phase(search: _Search, channel: int, peak: int, seen: Ints, chance: float) -> Evidence | None:
    """What the phase tells of a line whose amplitude changes: whether it keeps that of its bin, or turns evenly."""
    if not search.recordings or search.is_swept:
        return None
    order_map, order = search.order_map, float(search.axis[peak])
    shown = search.phasors(channel, peak, search.speed[seen], bins=0.5)
    lines = [(phasors[0], centre, recording.hop_rev) for recording, phasors, centre, _ in shown]
    share = float(np.mean(order_map["n_independent"].values / np.maximum(order_map["n_frames"].values, 1)))
    kept = partial(keeps_its_phase, lines, order, min(1.0, share), false_alarm_probability=chance)
    if kept(slips=False):
        return "locked to the shaft"
    return "steady, not locked" if has_moved(order_map, peak, seen) and kept(slips=True) else None


def _swells_slowly(search: _Search, channel: int, peak: int, seen: Ints) -> bool:
    """Whether the frames hold nothing but slow waves and the noise of the floor, and the line stands far over that."""
    if float(np.median(search.over.ratio[channel, seen, peak])) < NUMBERS.swelling_ratio:
        return False
    floor = float(np.median(search.over.floor[channel, seen, peak]))
    at_speeds = [search.speed[seen]] if not np.isfinite(search.speed[seen]).all() else search.speed[seen][:, None]
    left = [  # each speed by itself: between those seen there is none of the line
        left_of_slow_waves(phasors[0], centre - centre.mean(), hop_rev=recording.hop_rev)
        for speeds in at_speeds
        for recording, phasors, centre, _ in search.phasors(channel, peak, speeds, bins=1.0)
    ]
    known = [value for value in left if np.isfinite(value)]
    return len(known) > 0 and float(np.median(known)) < NUMBERS.left_ratio * floor


def _beyond_chance(search: _Search, channel: int, peak: int, seen: Ints) -> bool:
    """Whether noise would stand as high at as many speeds, in any bin of any channel, with less than the level.

    With p the chance at the weakest of the speeds seen, k of n speeds are that high with at most C(n, k) p^k.
    """
    highest, k = float(search.chances(channel, peak, seen).max()), len(seen)
    return bool(search.bins * comb(len(search.speed), k) * highest**k < search.false_alarm_probability)


def _has_fixed_frequency(search: _Search, channel: int, peak: int, seen: Ints) -> bool:
    """Whether what is seen at the speeds ``seen`` stands at the same frequency at the speeds beside them too."""
    axis, speed = search.axis, search.speed
    if not np.isfinite(speed).all():
        return False
    found = []
    for s in sorted(set(range(len(speed))) - set(seen.tolist())):
        nearest = min(seen.tolist(), key=lambda k: abs(k - s))
        at = round(axis[peak] * speed[nearest] / speed[s] / (axis[1] - axis[0]))
        away = abs(at - peak)
        if away > 1 and (away <= NUMBERS.bins_beside or abs(s - nearest) <= 2) and 1 <= at < len(axis) - 1:
            found.append(bool((search.over.excess[channel, s, at - 1 : at + 2] > 1.0).any()))
    return len(found) > 0 and float(np.mean(found)) >= NUMBERS.fixed_share


def _peaks(excess: Floats, axis: Floats) -> Ints:
    """Bins that are above the level at a speed or more and the largest within a quarter order, or 8 bins if fewer."""
    score = np.log(np.maximum(excess, 1.0)).sum(axis=0)
    reach = min(NUMBERS.neighbour_bins, max(1, round(NUMBERS.neighbour_orders / (axis[1] - axis[0]))))
    return np.flatnonzero((score > 0.0) & (score >= maximum_filter1d(score, 2 * reach + 1, mode="constant", cval=-1.0)))


def _line(
    search: _Search, channel: int, peak: int, seen: Ints, evidence: Evidence, doubts: tuple[Doubt, ...]
) -> OrderLine:
    order_map, axis = search.order_map, search.axis
    resolution = float(axis[1] - axis[0])
    beside = np.clip([peak - 1, peak, peak + 1], 0, len(axis) - 1)
    noise = search.over.floor[channel, seen, peak]
    n_frames = order_map["n_independent"].values[seen]
    lobe = np.nan_to_num(order_map["amplitude"].values[channel][np.ix_(seen, beside)]) ** 2 - noise[:, None]
    distance, distance_error = _refined(np.sqrt(np.maximum(lobe, 0.0)), noise / n_frames)
    if evidence == "locked to the shaft":
        names = "coherent_amplitude", "standard_error", "degrees_of_freedom", "phase_ci95"
        of_ends = "coherent_amplitude_low", "coherent_amplitude_high"
        values = [order_map[name].values[channel, seen, peak] for name in (*names, *of_ends)]
        amplitude, error, dof, half = values[0], values[1], values[2].astype(np.float64), values[3]
        ends: Floats | None = np.stack(values[4:], axis=1)
    else:
        amplitude, error, dof, ends = _by_energy(search, channel, peak, seen, distance)
        half = None
    return OrderLine(
        channel=str(order_map["channel"].values[channel]),
        order=float(axis[peak]) + resolution * distance,
        order_error=resolution
        * float(np.hypot(distance_error, NUMBERS.swept_bins if search.is_swept else NUMBERS.least_bins)),
        seen=seen,
        speed_rpm=order_map["speed"].values[seen],
        amplitude=amplitude,
        amplitude_error=error,
        degrees_of_freedom=dof,
        phase_deg=order_map["phase"].values[channel, seen, peak],
        evidence=evidence,
        level_over_floor_db=float(10.0 * np.log10(search.over.ratio[channel, seen, peak].max())),
        doubts=doubts,
        ends=ends,
        phase_ci95_deg=half,
        remark="" if ends is None else remark_on(amplitude, error, dof, ends),
    )


def _by_energy(
    search: _Search, channel: int, peak: int, seen: Ints, distance: float
) -> tuple[Floats, Floats, Floats, Floats | None]:
    """Amplitudes, errors, degrees of freedom and ends of a line that is not locked, ``distance`` bins from ``peak``.

    The power of a line A in noise N varies by 2 A^2 N + N^2 from frame to frame.
    """
    energy = search.order_map["amplitude"].values[channel, seen, peak] ** 2
    noise = search.over.floor[channel, seen, peak]
    n_frames = search.order_map.variables["n_independent"].values[seen]
    loss = float(np.sinc(distance) / (1.0 - distance**2))  # between two bins a window shows less of a line
    amplitude = np.sqrt(np.maximum(energy - noise, 1e-3 * energy))
    varies = np.maximum(2.0 * noise * energy - noise**2, noise**2)
    error = np.sqrt(varies / n_frames) / (2.0 * amplitude) / loss
    amplitude, dof = amplitude / loss, np.full(len(seen), np.inf)  # the floor is the median of many bins
    if not search.recordings or search.is_swept or not np.isfinite(search.speed[seen]).all():
        return amplitude, error, dof, None
    half, held = half_width(np.inf) * error, list[HeldSizes]()
    for row, speed in enumerate(search.speed[seen]):
        shown = search.phasors(channel, peak, np.array([speed]), bins=0.5)
        sizes = [np.abs(phasors[:1, np.isfinite(phasors[0].real)]) / loss for _, phasors, _, _ in shown]
        held += [HeldSizes(row, size) for size in sizes if size.shape[1] > 1]
    columns = amplitude, error, dof, np.maximum(amplitude - half, 0.0), amplitude + half
    rows, worth = SizeRows(*(values[None] for values in columns)), search.over.floor_worth[channel, seen, peak]
    rows = rows.with_scatter(held, noise=noise[None] / loss**2, independent=worth)
    return amplitude, rows.error[0], rows.dof[0], np.stack([rows.low[0], rows.high[0]], axis=1)


def _refined(lobe: Floats, noise: Floats) -> tuple[float, float]:
    """Distance of a line from its bin, in bins, and its standard error, from the three bins of its main lobe.

    ``lobe`` is (speeds, 3) amplitudes, ``noise`` (speeds,) the noise power in each. Both neighbours of the Hann
    window's main lobe tell the distance, (2 r - 1) / (1 + r) on the right and (1 - 2 l) / (1 + l) on the left (Rife
    and Vincent 1970); their mean has no bias from noise and errs by 0.61 / sqrt(signal-to-noise ratio). Speeds count
    by that ratio. Where both sides disagree by more than noise makes them the shape is not that of one steady line:
    half of what they differ by is in the error too. A line that its phase alone shows lies somewhere within its bin.
    """
    lobe, noise = lobe[lobe[:, 1] > 0.0], noise[lobe[:, 1] > 0.0]
    if not len(lobe):
        return 0.0, ANYWHERE_BINS
    left, right = lobe[:, 0] / lobe[:, 1], lobe[:, 2] / lobe[:, 1]
    by_right, by_left = (2.0 * right - 1.0) / (1.0 + right), (1.0 - 2.0 * left) / (1.0 + left)
    offset = 0.5 * (by_right + by_left)
    weight = lobe[:, 1] ** 2 / np.maximum(noise, 1e-12 * lobe[:, 1] ** 2)
    mean = float(np.average(offset, weights=weight))
    spread = float(np.sqrt(weight / weight.sum() @ (offset - mean) ** 2 / max(1, len(offset) - 1)))
    apart = 0.5 * abs(float(np.average(by_right - by_left, weights=weight)))
    return mean, max(spread, apart, 0.61 / float(np.sqrt(weight.sum())))


SWEPT_NUMBERS = MethodNumbers("5-identify-lines.toml", "swept_orders")


def longer_frames(revs: float, span_rev: float) -> list[float]:
    """Lengths [rev] from ``revs`` on, each twice the one before, that a recording of ``span_rev`` holds."""
    frames = [revs]
    while (
        2.0 * frames[-1] <= SWEPT_NUMBERS.longest_revs and span_rev >= SWEPT_NUMBERS.fewest_lengths * 2.0 * frames[-1]
    ):
        frames.append(2.0 * frames[-1])
    return frames


SETTLING_STEPS = 3
"""Rounds in which numbers of close lines settle: each leaves a tenth of what the one before left."""

TRIALS_PER_TURN = 4
"""Frequencies that are tried in the width in which their phase runs apart by a turn from frame to frame."""

LARGEST_MOVE = 0.5
"""Share of the distance of two lines by which a number moves at most."""

WIDTH_BINS = 0.01
"""Step by which the shape of a line that swells or bends is differenced."""


def company_of(order: float, frames: xr.Dataset, others: Sequence[float] = ()) -> float:
    """Order of a line close to ``order`` in the OrderFrames ``frames`` of a sweep; NaN where there is none.

    Each frame is solved for the line, whose amplitude may run as a parabola, those of ``others`` (orders) in reach, and
    one more at every distance in turn; it is there where it lowers what the median frame leaves of the bins in reach by
    more than ``least_gain``.
    """
    revs = float(frames.attrs["revs_per_frame"])
    place = order * revs
    used = _bins_about(place, frames)
    seen = _turned(frames, used).reshape(-1, len(used))
    seen = seen[np.isfinite(seen).all(axis=1) & (seen != 0.0).any(axis=1)]
    if len(seen) < SWEPT_NUMBERS.fewest_frames or len(used) < SWEPT_NUMBERS.reach_bins:
        return float("nan")
    near = [other * revs for other in others if 0.0 < abs(other * revs - place) < 2.0 * SWEPT_NUMBERS.reach_bins]
    known = [_changing_lobe(used - place), *(_changing_lobe(used - other)[:2] for other in near)]
    base = np.linalg.qr(np.concatenate(known).T)[0]
    left = seen - (seen @ base) @ base.T
    energy = np.maximum((np.abs(left) ** 2).sum(axis=1), np.finfo(float).tiny)
    beside: Floats = np.arange(SWEPT_NUMBERS.nearest_bins, SWEPT_NUMBERS.reach_bins - 1.0, SWEPT_NUMBERS.step_bins)
    apart = np.concatenate([-beside[::-1], beside])
    lobes = hann_lobe(used - place - apart[:, None])
    lobes -= (lobes @ base) @ base.T
    lobes /= np.linalg.norm(lobes, axis=1, keepdims=True)
    share = np.median(1.0 - np.abs(left @ lobes.T) ** 2 / energy[:, None], axis=0)
    best = int(share.argmin())
    return order + float(apart[best]) / revs if share[best] * SWEPT_NUMBERS.least_gain < 1.0 else float("nan")


def settled(orders: Sequence[float], frames: xr.Dataset, others: Sequence[float] = ()) -> list[float] | None:
    """Numbers of the close lines ``orders`` by how their phases run over the OrderFrames ``frames`` of a sweep.

    Each frame is solved for all of them and those of ``others`` (orders) in reach; what most steps from frame to frame
    turn a line by is how far it is off. None where one moves by more than LARGEST_MOVE of their distance, or keeps a
    frequency rather than an order: then they are no two lines that keep their numbers, but one and what it rings.
    """
    revs = float(frames.attrs["revs_per_frame"])
    middle, apart = float(np.mean(orders)), float(np.diff(sorted(orders)).min())
    used = _bins_about(middle * revs, frames)
    centre: Floats = frames["crank_angle"].values + 0.5 * revs
    turned = _turned(frames, used)
    close = [other for other in others if abs(other - middle) * revs < 2.0 * SWEPT_NUMBERS.reach_bins]
    near = [_changing_lobe(used - other * revs)[:2] for other in close]
    numbers: Floats = np.array(orders, dtype=np.float64)
    for _ in range(SETTLING_STEPS):
        lobes = np.concatenate([hann_lobe(used - numbers[:, None] * revs), *near])
        phasors = turned @ np.linalg.pinv(lobes)[:, : len(numbers)]
        steady = phasors * np.exp(-2j * np.pi * (np.outer(centre, numbers) % 1.0))
        steps = np.nansum(steady[:, 1:] * steady[:, :-1].conj(), axis=0)
        unit = steps / np.maximum(np.abs(steps), np.finfo(float).tiny)
        mean = np.exp(1j * np.angle(unit.sum(axis=0)))  # about which the median turn [rev] is taken
        turn = (np.angle(mean) + np.median(np.angle(unit / mean), axis=0)) / (2.0 * np.pi)
        numbers = numbers + turn / float(np.median(np.diff(centre)))
    moved = np.abs(numbers - np.asarray(orders)).max()
    rings = any(_keeps_frequency(step, number, frames) for step, number in zip(steps.T, numbers, strict=True))
    return None if rings or moved > LARGEST_MOVE * apart else numbers.tolist()


def _keeps_frequency(steps: Complexes, order: float, frames: xr.Dataset) -> bool:
    """Whether ``steps`` (frames - 1,) from frame to frame turn as those of one frequency near ``order``, rather than as
    those of one order: a lightly damped mode rings on at its own."""
    speed = frames["speed"].values
    minutes = np.diff(frames["crank_angle"].values) / (0.5 * (speed[1:] + speed[:-1]))
    unit = steps / np.maximum(np.abs(steps), np.finfo(float).tiny)
    trials = 2 + int(TRIALS_PER_TURN * order * float(np.ptp(speed) * np.median(minutes)))
    turns = np.outer(order * np.linspace(speed.min(), speed.max(), trials), minutes)
    return bool(np.abs(np.exp(-2j * np.pi * turns) @ unit).max() >= np.abs(unit.sum()))


def _bins_about(place: float, frames: xr.Dataset) -> Floats:
    """Numbers of the bins in reach of ``place`` (in bins)."""
    first, last = round(place) - SWEPT_NUMBERS.reach_bins, round(place) + SWEPT_NUMBERS.reach_bins + 1
    return np.arange(max(1, first), min(frames.sizes["order"], last), dtype=np.float64)


def _turned(frames: xr.Dataset, used: Floats) -> Complexes:
    """Spectra (channels, frames, bins) in the bins ``used``, phases counted from the middle of each frame."""
    revs = float(frames.attrs["revs_per_frame"])
    centre = frames["crank_angle"].values + 0.5 * revs
    turn = np.exp(2j * np.pi * (np.outer(centre, used) / revs % 1.0))
    return np.asarray(frames["spectrum"].values[:, :, used.astype(int)] * turn)


def _changing_lobe(off_bins: Floats) -> Floats:
    """Lobe (3, bins) of a line that is steady, that grows, and that bends."""
    before, here, after = (hann_lobe(off_bins + side * WIDTH_BINS) for side in (-1.0, 0.0, 1.0))
    return np.array([here, after - before, before + after - 2.0 * here])


def swept_orders(frames: xr.Dataset, *, settings: Settings) -> list[float]:
    """Orders (cycles per crank revolution, rising) that stand out in the OrderFrames ``frames`` of one recording.

    In any channel, locked or not; ``settings`` of identify say what stands out, those of orders how frames are
    averaged. They are looked for in frames of several lengths, for the sweep asks for short ones, which blur lines
    that are close; a line so close that it does not stand out by itself is found by what the other one leaves. Lines
    that frames cannot tell from a multiple of the cycle's frequency, or from one seen in longer frames, or from a
    stronger one, are one with that; of more than twenty the strongest are taken.
    """
    if not frames["spectrum"].notnull().any():
        return []
    cycle = int(frames.attrs["revs_per_cycle"])
    kept: list[tuple[float, float]] = []
    for item in _lengthened(frames):
        step = 1.0 / float(item.attrs["revs_per_frame"])
        for line in sorted(_lines(item, settings), key=lambda line: -line.level_over_floor_db):
            order = _on_multiple(line.order, cycle, step)
            if order > 0.0 and all(abs(order - other) > step for other, _ in kept):
                kept.append((order, line.level_over_floor_db))
        del item  # before the next is made
    for item in _lengthened(frames):
        step = 1.0 / float(item.attrs["revs_per_frame"])
        lowest = LOWEST_BINS * step  # below it is the mean
        for order, level in list(kept):
            others = [other for other, _ in kept]
            company = company_of(order, item, others)
            if company > lowest and all(abs(company - other) > 0.5 * abs(company - order) for other in others):
                numbers = settled((order, company), item, [other for other in others if other != order])
                if numbers is None or min(numbers) < lowest:
                    continue
                placed = [_on_multiple(number, cycle, step) for number in numbers]
                kept.remove((order, level))
                kept += [(number, level) for number in (placed if placed[0] != placed[1] else numbers)]
        del item
    strongest = sorted(kept, key=lambda candidate: -candidate[1])[: SWEPT_NUMBERS.most_followed]
    return sorted(order for order, _ in strongest)


def _on_multiple(order: float, cycle: int, step: float) -> float:
    """``order``, or the multiple of 1 / ``cycle`` that bins of ``step`` orders do not tell from it."""
    multiple = round(order * cycle) / cycle
    return multiple if abs(order - multiple) < SWEPT_NUMBERS.same_bins * step else order


def _lines(frames: xr.Dataset, settings: Settings) -> list[OrderLine]:
    found = order_map([frames], settings=settings.orders)
    lines = order_lines(found, settings=settings.identify, orders=settings.orders, frames=[frames])
    return [line for line in lines if UNRESOLVED not in line.doubts]  # no number to follow


def _lengthened(frames: xr.Dataset) -> Iterator[xr.Dataset]:
    """``frames`` and those of twice, four times … their length that the recording holds, the longest first.

    Each is made when it is asked for: those of a long recording fill the memory.
    """
    begin, length = frames["crank_angle"].values, int(frames.attrs["revs_per_frame"])
    held = float(np.ptp(begin)) + length
    for revs in longer_frames(length, held)[:0:-1]:
        item = reframed(frames, round(revs))
        if item is not None and item.sizes["frame"]:
            yield item
        del item
        give_back()
    yield frames
