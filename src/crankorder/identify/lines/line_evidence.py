"""What tells a line of the shaft from noise, at a stated false-alarm rate, from a resonance, and from what folds."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.special import gammaincc, gammainccinv, gammaincinv, gammaln

from crankorder.identify.found import Evidence, OrderLine
from crankorder.identify.lines.zoom import Zoomed, turned_sums
from crankorder.orders.averages import median_of_known
from crankorder.quantities import Bools, Complexes, Floats, Ints, QualityFlag, remark
from crankorder.settings import IdentifySettings, MethodNumbers, OrderSettings, Settings
from crankorder.shaft.aliasing import Alias, AliasedLine, aliased_lines, find_aliases

CFAR_NUMBERS = MethodNumbers("5-identify-lines.toml", "cfar")

LOBE_BINS = 2
"""A line between two bins fills so many on each side: they take no part in its own floor."""

LOWEST_BINS = 2.5
"""Bins from order 0 below which no line is told: the main lobe of the mean, and of what drifts, lies there."""

ALIKE = (1.0, 4.0 / 9.0, 1.0 / 36.0)
"""Correlation of the powers of noise in Hann bins 0, 1 and 2 apart."""


class OverNoise(NamedTuple):
    """Energy over the level that noise alone reaches, over its floor, and the floor: (channel, speed, order) each.

    ``floor_worth`` of that shape: how many independent bins the floor is the median of.
    """

    excess: Floats
    ratio: Floats
    floor: Floats
    floor_worth: Floats


def excess_over_noise(order_map: xr.Dataset, *, settings: IdentifySettings, orders: OrderSettings) -> OverNoise:
    """How far ``order_map`` stands over its noise, in each bin of each channel at each speed.

    The ``excess`` is over one with the chance ``settings.false_alarm_probability`` in noise that is level, or slopes,
    over the bins beside; it allows for what the floor itself, a median of few bins, errs by. It is zero where a bin of
    ``order_map`` is not the highest of three, by energy or by what agrees in phase, and at its first bins. At one
    speed, which no other bears out, a line also stands over its noise by what agrees in phase alone. A resonance
    narrower than the bins beside is above the level too: what tells it from a line is not energy. ``orders`` give the
    floor's width (``floor_bins``) and distance from possible lines (``guard_bins``).
    """
    axis = order_map["order"].values
    energy = order_map["amplitude"].values ** 2
    n_independent = order_map["n_independent"].values.astype(np.float64)
    cycle = int(order_map.attrs["revs_per_cycle"])
    bins = reference_bins(axis, line_step=1.0 / cycle, guard_bins=orders.guard_bins, n_bins=orders.floor_bins)
    log_chance = np.zeros(energy.shape)
    if "coherent_amplitude" in order_map:  # 0 where a bin beside agrees better in phase
        highest = highest_of_three(order_map["coherent_amplitude"].values ** 2)
        log_chance = np.where(highest, _log_chance_of_coherence(order_map, ...), 0.0)
    by_phase = log_chance < np.log(CFAR_NUMBERS.by_phase_chance)
    floor, narrowed = noise_floor(energy, bins, n_averages=n_independent, level=by_phase)
    wide, near = independent_bins(bins), independent_bins(_nearest(bins))
    chance = settings.false_alarm_probability
    level = np.array([[noise_level(float(n), m, chance) for m in (wide, near)] for n in n_independent])
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.nan_to_num(np.where(floor > 0.0, energy / floor, 0.0), nan=0.0, posinf=0.0)
    over = ratio / np.where(narrowed, level[None, :, 1:], level[None, :, :1])
    excess = np.where(highest_of_three(energy) | by_phase, over, 0.0)
    if len(n_independent) == 1:
        # two lines that nearly cancel, or one in noise that is loud at low frequencies, hide in the energy of a bin:
        # on the cycle's orders the phase tells them where noise of the whole map would agree as well so seldom
        on_cycle = np.abs(axis * cycle - np.rint(axis * cycle)) < 1e-6
        alone = np.maximum(log_chance / np.log(chance / log_chance.size), 0.0)
        excess = np.maximum(excess, np.where(on_cycle, alone, 0.0))
    excess[..., axis < LOWEST_BINS * (axis[1] - axis[0])] = 0.0
    return OverNoise(excess, ratio, floor, np.where(narrowed, near, wide))


def reference_bins(order: Floats, *, line_step: float, guard_bins: int, n_bins: int) -> Ints:
    """Indices (orders, ``n_bins``), growing, of the nearest bins that hold noise, half of them on each side.

    ``order`` (orders,) is the axis. Bins within ``guard_bins`` of a multiple of ``line_step`` may hold lines and are
    left out, unless too few others are left; a bin's own LOBE_BINS neighbours always are.
    """
    resolution = order[1] - order[0]
    off = np.abs(order / line_step - np.round(order / line_step)) * line_step / resolution
    quiet = np.flatnonzero((off > guard_bins + 0.5) & (order >= line_step))
    if len(quiet) < n_bins + 2 * LOBE_BINS + 1:
        quiet = np.flatnonzero(order > 1.5 * resolution)
    n_bins = max(1, min(n_bins, len(quiet) - 2 * LOBE_BINS - 1))
    at = np.arange(len(order))
    below = np.searchsorted(quiet, at - LOBE_BINS)  # so many lie below, the others from `above` on
    above = np.searchsorted(quiet, at + LOBE_BINS, side="right")
    right = np.minimum(n_bins // 2, len(quiet) - above)
    left = np.minimum(n_bins - right, below)
    column = np.arange(n_bins)[None, :]
    rank = np.where(column < left[:, None], (below - left)[:, None] + column, (above - left)[:, None] + column)
    return np.asarray(quiet[rank])


def _nearest(bins: Ints) -> Ints:
    first = max(0, (bins.shape[1] - CFAR_NUMBERS.near_bins) // 2)
    return bins[:, first : first + CFAR_NUMBERS.near_bins]


def independent_bins(bins: Ints) -> float:
    """How many independent ones the median of ``bins`` (orders, several) is worth.

    What correlates in a median are the signs about it: 2/pi arcsin of the correlation of the powers.
    """
    apart = np.abs(bins[:, :, None] - bins[:, None])
    alike = sum(2.0 / np.pi * np.arcsin(value) * (apart == k) for k, value in enumerate(ALIKE))
    return float(np.round(np.median(bins.shape[1] ** 2 / np.asarray(alike).sum(axis=(1, 2))), 2))


def noise_floor(power: Floats, bins: Ints, *, n_averages: Floats, level: Bools | None = None) -> tuple[Floats, Bools]:
    """Expected noise power at each bin of ``power`` (channels, speeds, orders), and where it is that of few bins.

    The median of the ``bins`` (orders, several) on both sides, which a slope does not move; where those nearest stand
    surely higher the noise has a hump there, and their median is taken. ``n_averages`` (speeds,) is the number of
    independent spectra in each power: the median of their mean, a gamma variable, is below its mean. Where ``level``,
    of the shape of ``power``, all bins count whatever the hump: what stands there does so by its phase too.
    """
    n = np.maximum(n_averages, 1e-3)[None, :, None]
    scale = gammaincinv(n, 0.5) / n
    # speed by speed: the bins beside all of a long sweep fill the memory
    wide, near = (
        np.stack([median_of_known(row[:, beside], axis=-1) for row in power.swapaxes(0, 1)], axis=1) / scale
        for beside in (bins, _nearest(bins))
    )
    few = independent_bins(_nearest(bins))
    sigma = np.sqrt(np.pi / 2.0 / n * (1.0 / few - 1.0 / max(independent_bins(bins), few + 1e-9)))
    with np.errstate(invalid="ignore", divide="ignore"):
        narrowed = np.log(near / wide) > CFAR_NUMBERS.hump_sigmas * sigma
    if level is not None:
        narrowed &= ~level
    return np.where(narrowed, near, wide), narrowed


@functools.lru_cache(maxsize=4096)
def noise_level(n: float, bins: float, chance: float) -> float:
    """Energy over its floor that noise exceeds with ``chance``: mean of ``n`` spectra, floor of so many ``bins``."""
    low = np.log(gammainccinv(n, chance) / n)
    high = low + 1.0
    while noise_chance(np.exp(high), n, bins) > chance:
        low, high = high, high + 1.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if noise_chance(np.exp(middle), n, bins) > chance else (low, middle)
    return float(np.exp(0.5 * (low + high)))


def noise_chance(ratio: float, n: float, bins: float) -> float:
    """Chance that noise, the mean of ``n`` independent spectra, stands ``ratio`` over the median of so many ``bins``.

    The median of b independent gamma variables lies at a share of their distribution that is beta distributed with
    (b + 1)/2 and (b + 1)/2 (David and Nagaraja 2003, 2.1); the chance is the mean over that.
    """
    floor, weight = _median_distribution(n, bins)
    return float(weight @ gammaincc(n, n * ratio * floor))


@functools.lru_cache(maxsize=4096)
def _median_distribution(n: float, bins: float) -> tuple[Floats, Floats]:
    """Floors over the true one and the weight of each: the median of ``bins`` means of ``n`` spectra."""
    half = 0.5 * (bins + 1.0)
    logit = np.linspace(-1.0, 1.0, 81) * 9.0 * np.sqrt(2.0 / half) * (1.0 + 1.0 / half)
    share = 1.0 / (1.0 + np.exp(-logit))
    weight = np.exp(half * (np.log(share) + np.log1p(-share) + 2.0 * np.log(2.0)))
    return gammaincinv(n, share) / gammaincinv(n, 0.5), weight / weight.sum()


def highest_of_three(energy: Floats) -> Bools:
    """Where ``energy`` (…, orders) is not below either neighbour: a line that moves past a bin is no line at it."""
    filled = np.nan_to_num(energy)
    highest = np.ones(filled.shape, dtype=bool)
    highest[..., 1:] &= filled[..., 1:] >= filled[..., :-1]
    highest[..., :-1] &= filled[..., :-1] >= filled[..., 1:]
    return highest


def _log_chance_of_coherence(order_map: xr.Dataset, at: Any) -> Floats:
    """Logarithm of the chance that frames of noise agree in phase as well as those of the cells ``at`` do.

    The coherence g of n frames of noise exceeds its value with probability (1 - g)**(n - 1) (Goodman 1957).
    """
    energy, coherent = (order_map[name].values[at] ** 2 for name in ("amplitude", "coherent_amplitude"))
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = np.nan_to_num(np.where(energy > 0.0, coherent / energy, 0.0))
    frames = np.maximum(1.0, order_map["n_coherent"].values[at])
    return np.asarray((frames - 1.0) * np.log1p(-np.minimum(coherence, 1.0 - 1e-12)))


NUMBERS = MethodNumbers("5-identify-lines.toml", "line_evidence")

OVERLAP_ALIKE = 0.25
"""Length of the mean step of noise in frames that overlap by a half and so share a sixth, with what chance adds."""

UNPROVEN: Evidence = "stands out, too few revolutions for proof"
"""What is said of a high line on an order of the cycle in a test of fewer frames."""


def evidence_of(
    order_map: xr.Dataset, ratio: Floats, channel: int, peak: int, seen: Ints, false_alarm_probability: float
) -> Evidence | None:
    """What tells the line from a resonance that noise excites; None where nothing does.

    ``order_map`` is the OrderMap, ``ratio`` (speeds, orders) the energy of the ``channel`` over its floor, ``peak`` the
    line's bin, ``seen`` (n,) the speeds at which it stands above the level; noise agrees in phase as well as a line
    that is called locked with ``false_alarm_probability``.
    """
    # a resonance excited by noise may stand out as far as a line does, but its phase wanders
    if _are_seldom(_log_chance_of_coherence(order_map, (channel, seen, peak)), false_alarm_probability):
        return "locked to the shaft"
    if has_moved(order_map, peak, seen) and is_steady(order_map, channel, peak, seen, false_alarm_probability):
        return "steady, not locked"
    if _follows(order_map, ratio, peak, seen):
        return "follows the speed"
    # in a test too short to prove any lock a high line on an order of the cycle is named with its doubt: a resonance
    # that noise excites could be as high, but seldom there at every speed
    high = float(np.median(ratio[seen, peak])) > NUMBERS.standing_ratio and len(seen) == order_map.sizes["speed"]
    return UNPROVEN if high and is_unprovable(order_map, peak) else None


def is_unprovable(order_map: xr.Dataset, peak: int) -> bool:
    """Whether bin ``peak`` of ``order_map`` is an order of the cycle, with too few frames to prove a lock."""
    axis, step = order_map["order"].values, 1.0 / int(order_map.attrs["revs_per_cycle"])
    off = abs(axis[peak] - step * round(axis[peak] / step)) / (axis[1] - axis[0])
    provable = float(np.maximum(order_map["n_independent"].values - 1.0, 0.0).sum())
    return bool(off < 0.5 and provable < NUMBERS.provable_frames)


def _follows(order_map: xr.Dataset, ratio: Floats, peak: int, seen: Ints) -> bool:
    """Whether the line is a sharp ridge along its order over speeds at which a fixed frequency would have moved far.

    ``ratio`` (speeds, orders) is the energy over its floor. A resonance sweeps over all orders and raises neighbours
    alike; the logarithm of the energy of one frame of noise scatters by pi / sqrt(6) about its mean.
    """
    axis, speed = order_map["order"].values, order_map["speed"].values
    moved = axis[peak] * (speed[seen].max() / speed[seen].min() - 1.0) / (axis[1] - axis[0])
    if len(seen) < NUMBERS.followed_speeds or moved < NUMBERS.followed_bins:
        return False
    span = slice(int(seen[0]), int(seen[-1]) + 1)
    height = np.log(np.maximum(ratio[span], 1e-3)).mean(axis=0)
    below, above = range(max(0, peak - 6), peak - 2), range(peak + 3, min(peak + 7, len(axis)))
    if not below or not above:
        return False  # at an end of the map the flank of a resonance beyond looks like a ridge
    beside = [*below, *above]
    frames = float(order_map["n_frames"].values[span].sum())
    independent = frames * min(1.0, 2.0 * (1.0 - float(order_map.attrs["overlap"])))
    scatter = np.pi / np.sqrt(6.0 * independent)
    return bool(height[peak] - height[beside].mean() > NUMBERS.followed_sigmas * scatter)


def _are_seldom(log_chances: Floats | Sequence[float], false_alarm_probability: float) -> bool:
    """Whether several tests come out as noise has all of them with less than ``false_alarm_probability`` together.

    Minus the logarithms of their chances add up to a gamma variable (Fisher 1925).
    """
    return len(log_chances) > 0 and bool(gammaincc(len(log_chances), -np.sum(log_chances)) < false_alarm_probability)


def is_steady(order_map: xr.Dataset, channel: int, peak: int, seen: Ints, false_alarm_probability: float) -> bool:
    """Whether the amplitude is far steadier from frame to frame than noise: a line that slips, or whose speed drifts.

    Of bin ``peak`` of the ``channel`` of ``order_map`` at the speeds ``seen`` (n,), with ``false_alarm_probability``.
    Spectral kurtosis is 0 ± 2/sqrt(n) for n frames of noise and -1 for a line (Antoni 2006). Few frames cannot lie so
    many of these standard deviations below 0: for them the chance of so low a kurtosis itself tells.
    """
    frames = order_map["n_independent"].values[seen].astype(np.float64)
    kurtosis = order_map["spectral_kurtosis"].values[channel, seen, peak].astype(np.float64)
    known = np.isfinite(kurtosis) & (frames >= 2.0)
    if not known.any():
        return False
    mean = float(np.average(kurtosis[known], weights=frames[known]))
    if mean < -NUMBERS.steady_sigmas * 2.0 / float(np.sqrt(frames[known].sum())) and mean < NUMBERS.steady_kurtosis:
        return True
    if not _are_seldom(log_chance_of_kurtosis(kurtosis[known], frames[known]), false_alarm_probability):
        return False
    at = seen[known]
    if len(at) > 1 and has_moved(order_map, peak, at):
        return True
    return len(at) == 1 and _steadier_than_a_resonance(order_map, peak, int(at[0]), mean, false_alarm_probability)


def log_chance_of_kurtosis(kurtosis: Floats, frames: Floats) -> Floats:
    """Logarithm of the chance (at most) that ``frames`` independent ones of noise have so low a spectral ``kurtosis``.

    The frames' shares of their total power are uniform on a simplex (Greenwood 1946), of n - 1 dimensions; a kurtosis
    below its value is the ball of squared radius (1 + kurtosis) (n - 1) / (n (n + 1)) about its middle. The chance is
    the ball's volume over the simplex', exactly as long as the ball lies inside: 1 + kurtosis up to (n + 1)/(n - 1)^2.
    """
    m = frames - 1.0
    squared = np.maximum(1.0 + kurtosis, 1e-12) * m / (frames * (frames + 1.0))
    ball = 0.5 * m * np.log(np.pi * squared) - gammaln(0.5 * m + 1.0)
    return np.asarray(np.minimum(ball + gammaln(frames) - 0.5 * np.log(frames), 0.0))


def _steadier_than_a_resonance(order_map: xr.Dataset, peak: int, at: int, kurtosis: float, level: float) -> bool:
    """Whether even the least damped resonance, excited by noise, would swell more over the frames of the speed ``at``.

    Its phasor forgets itself with K = 2 pi damping f T over the time T. Its power over T, as long as that is short of
    the memory, is a random walk whose variance is below s with a chance of exp(-K / (2 s)) where the resonance stands
    at its mean, and exp(-K / (2 s e)) where it stands e times over it, which has the chance exp(-e): together
    exp(-sqrt(2 K / s)) at most. ``level`` is that of a false alarm.
    """
    hop = float(order_map.attrs["revs_per_frame"]) * (1.0 - float(order_map.attrs["overlap"]))
    turned = float(order_map["order"].values[peak]) * hop * max(float(order_map["n_frames"].values[at]) - 1.0, 0.0)
    forgotten = 2.0 * np.pi * NUMBERS.least_damping * turned
    return bool(np.exp(-np.sqrt(2.0 * forgotten / max(1.0 + kurtosis, 1e-12))) < level)


def has_moved(order_map: xr.Dataset, peak: int, seen: Ints) -> bool:
    """Whether a line of fixed frequency would have left its bin over the speeds ``seen`` (n,); True for a single speed.

    ``order_map`` is the OrderMap, ``peak`` the line's bin in it.
    """
    axis, speed = order_map["order"].values, order_map["speed"].values
    if len(speed) < 2 or not np.isfinite(speed).all():
        return True
    return bool(axis[peak] * (speed[seen].max() / speed[seen].min() - 1.0) > 2.0 * (axis[1] - axis[0]))


def keeps_one_order(zooms: Sequence[Zoomed], *, false_alarm_probability: float) -> bool:
    """Whether the phase of the line ``zooms`` in one recording or several turns as evenly as that of no noise.

    The power of n frames at their best frequency stands over that of waves a little slower and faster, which a
    resonance raises alike, by more than a ratio s with a chance of at most n (1 + s / f)^(-f/2), f being the degrees of
    freedom of the latter (Fisher 1929), and noise does so with less than ``false_alarm_probability``. In a run-up the
    steps of the phase from frame to frame are told from those of noise, whose mean phasor is as long as r with a chance
    of exp(-n r^2) (Rayleigh 1880).
    """
    chances = [
        min(0.0, float(np.log(max(line.frames, 2.0))) - 0.5 * line.dof * float(np.log1p(line.snr / line.dof)))
        if line.course is None
        else -line.course.steps * max(0.0, line.course.alike - OVERLAP_ALIKE) ** 2
        for line in zooms
    ]
    return _are_seldom(chances, false_alarm_probability)


REFINEMENTS = 3
"""Steps of least squares from the best of them to where the part across the axis is least."""

TRIALS_PER_SPAN = 8
"""Trial distances from the bin in which a line turns once over the recording."""


def keeps_its_phase(
    recordings: Sequence[tuple[Complexes, Floats, float]],
    order: float,
    independent_share: float,
    *,
    slips: bool,
    false_alarm_probability: float,
) -> bool:
    """Whether a line keeps its phase in ``recordings`` as noise would only with ``false_alarm_probability``.

    Parameters
    ----------
    recordings : of each the phasors (frames,) of one bin, the middles of its frames [rev] and the hop between them
    order : of the bin
    independent_share : independent frames that each is worth, 0…1
    slips : whether it may turn away from its bin evenly; otherwise it is locked to the shaft
    """
    chances = []
    for phasors, centre, hop_rev in recordings:
        turn, offset, trials = centre - centre.mean(), 0.0, 1
        if slips:
            offset, trials = best_offset(phasors, turn, hop_rev=hop_rev)
        forgotten = 2.0 * np.pi * NUMBERS.least_damping * order * float(np.ptp(turn))
        chance = log_chance_of_phase(
            phasors, turn, offset=offset, forgotten=forgotten, independent_share=independent_share, fitted=int(slips)
        )
        chances.append(min(0.0, chance + float(np.log(trials))))
    return _are_seldom(chances, false_alarm_probability)


def log_chance_of_phase(
    phasors: Complexes, turn: Floats, *, offset: float, forgotten: float, independent_share: float, fitted: int = 0
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
    independent_share : independent frames of one of ``phasors``, 0…1
    fitted : how many of these the distance that was fitted takes
    """
    power = np.square(np.abs(phasors))
    filled = float(power.sum() ** 2 / max(len(power) * float(np.square(power).sum()), 1e-300))
    n, forgotten = independent_share * filled * len(phasors) - fitted, filled * forgotten
    if n < NUMBERS.least_frames:
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


def best_offset(phasors: Complexes, turn: Floats, *, hop_rev: float) -> tuple[float, int]:
    """Distance from the bin [orders] at which ``phasors`` at ``turn`` [rev] (frames,) keep to one axis best.

    And how many distances were tried; it is told up to half the reciprocal of ``hop_rev`` on each side.
    """
    reach = 0.5 / hop_rev
    count = 2 * int(np.ceil(TRIALS_PER_SPAN * reach * max(float(np.ptp(turn)), hop_rev))) + 1
    trial = np.linspace(-reach, reach, count)
    kept = np.abs(turned_sums(np.square(phasors)[None], turn, trial, times=2)[0])
    # a phase that alternates from frame to frame is the same on one axis: the longer mean is the line
    mean = np.abs(turned_sums(phasors[None], turn, trial)[0])
    offset = float(trial[int(np.argmax(kept * (1.0 + mean / max(float(np.abs(phasors).sum()), 1e-300))))])
    for _ in range(REFINEMENTS):
        steady = phasors * np.exp(-2j * np.pi * offset * turn)
        steady = steady * np.exp(-0.5j * np.angle(np.square(steady).sum()))
        along, weight = steady.real, np.square(steady.real)
        apart = turn - float(weight @ turn) / max(float(weight.sum()), 1e-300)
        spread = max(float(weight @ np.square(apart)), 1e-300)
        offset += float((along * apart) @ steady.imag) / spread / (2.0 * np.pi)
    return offset, count


FOLD_NUMBERS = MethodNumbers("5-identify-explain.toml", "folds")


class ShownAlias(NamedTuple):
    """A fold and where it shows: ``speed_rpm`` and ``order`` (points,), each order known within ``order_error``."""

    fold: Alias
    speed_rpm: Floats
    order: Floats
    order_error: float

    def is_line(self, line: OrderLine) -> bool:
        """Whether ``line`` is this fold, at more than half of the speeds at which it is seen."""
        reach = np.hypot(self.order_error / FOLD_NUMBERS.order_error_bins, 2.0 * line.order_error)
        near = np.abs(self.order - line.order) <= reach
        same = np.isin(np.round(line.speed_rpm, 6), np.round(self.speed_rpm[near], 6))
        return bool(np.mean(same) > FOLD_NUMBERS.of_line_share)


def shown_aliases(order_map: xr.Dataset, *, settings: Settings) -> tuple[ShownAlias, ...]:
    """What is found to fold in ``order_map``, the surest first; nothing where it was sampled by time or lacks a speed.

    ``settings``: those of identify (mains frequencies, highest frequency looked for) and of orders (the floor's width).
    """
    samples_per_rev = _samples_per_rev(order_map)
    if samples_per_rev is None:
        return ()
    speed, axis = order_map["speed"].values, order_map["order"].values
    excess = excess_over_noise(order_map, settings=settings.identify, orders=settings.orders).excess
    at_speed, at_order = np.nonzero((excess > 1.0).any(axis=0))
    order_error = FOLD_NUMBERS.order_error_bins * float(axis[1] - axis[0])
    folds = find_aliases(
        speed[at_speed],
        axis[at_order],
        samples_per_rev=samples_per_rev,
        order_error=order_error,
        shown_to_order=float(axis[-1]),
        highest_hz=settings.identify.fold_search_hz,
        frequencies_hz=[line.frequency_hz for line in _aliased_mains(order_map, samples_per_rev, settings)],
    )
    speed, order = speed[at_speed], axis[at_order]
    return tuple(ShownAlias(fold, speed[fold.points], order[fold.points], order_error) for fold in folds)


def alias_flags(order_map: xr.Dataset, *, settings: Settings, folds: tuple[ShownAlias, ...]) -> list[QualityFlag]:
    """What may fold at the speeds of ``order_map``, and fixed frequencies above half the rate that show as lines in it.

    Nothing where the map is of recordings sampled by time, or of unknown speed. ``settings``: those of identify (mains
    frequencies, highest frequency looked for) and of orders (the floor's width). ``folds``: those of
    :func:`shown_aliases`.
    """
    samples_per_rev = _samples_per_rev(order_map)
    if samples_per_rev is None:
        return []
    speed = order_map["speed"].values
    low_hz, high_hz = samples_per_rev / 120 * speed.min(), samples_per_rev / 120 * speed.max()
    mains = _aliased_mains(order_map, samples_per_rev, settings)
    said = (
        f"sampled {samples_per_rev:g} times a revolution: unless a filter kept it out, what lies above "
        f"{low_hz:.4g} to {high_hz:.4g} Hz (by speed) shows at |order - {samples_per_rev:g} k|"
    )
    text = "; mains, ".join([said, *map(str, mains)])
    found = [remark("all", "folded_frequency", shown.fold.evidence, "suspect") for shown in folds]
    return [remark("all", "lines_may_fold", text), *found]


def _samples_per_rev(order_map: xr.Dataset) -> float | None:
    """Samples per revolution of a test sampled by crank angle whose speeds are known; else None."""
    samples_per_rev = float(order_map.attrs.get("samples_per_rev", 0.0))
    return samples_per_rev if samples_per_rev and np.isfinite(order_map["speed"].values).all() else None


def _aliased_mains(order_map: xr.Dataset, samples_per_rev: float, settings: Settings) -> list[AliasedLine]:
    """Multiples of mains that fold into the orders of the map."""
    multiples = np.multiply.outer(settings.identify.mains_hz, np.arange(1, FOLD_NUMBERS.mains_harmonics + 1))
    hertz = np.unique(multiples[multiples <= settings.identify.fold_search_hz]).tolist()
    speed, last = order_map["speed"].values, float(order_map["order"].values[-1])
    return aliased_lines(samples_per_rev, speed, frequencies_hz=hertz, shown_to_order=last)
