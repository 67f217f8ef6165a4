"""Constant false-alarm rate: the energy that noise alone reaches in a bin of the order map, as often as is stated."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import gammaincc, gammainccinv, gammaincinv

from crankorder.quantities import Bools, Floats, Ints
from crankorder.settings import IdentifySettings, MethodNumbers, OrderSettings

NUMBERS = MethodNumbers("5-identify-lines.toml", "cfar")

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
    bins = reference_bins(
        axis,
        line_step=1.0 / int(order_map.attrs["revs_per_cycle"]),
        guard_bins=orders.guard_bins,
        n_bins=orders.floor_bins,
    )
    by_phase = _log_chance_of_phase(order_map) < np.log(NUMBERS.by_phase_chance)
    floor, narrowed = noise_floor(energy, bins, n_averages=n_independent, level=by_phase)
    wide, near = independent_bins(bins), independent_bins(_nearest(bins))
    chance = settings.false_alarm_probability
    level = np.array([[noise_level(float(n), m, chance) for m in (wide, near)] for n in n_independent])
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.nan_to_num(np.where(floor > 0.0, energy / floor, 0.0), nan=0.0, posinf=0.0)
    over = ratio / np.where(narrowed, level[None, :, 1:], level[None, :, :1])
    excess = np.where(highest_of_three(energy) | by_phase, over, 0.0)
    if len(n_independent) == 1:
        excess = np.maximum(excess, _by_phase_alone(order_map, chance))
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
    first = max(0, (bins.shape[1] - NUMBERS.near_bins) // 2)
    return bins[:, first : first + NUMBERS.near_bins]


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
        np.stack([_nanmedian(power[:, row][..., beside]) for row in range(power.shape[1])], axis=1) / scale
        for beside in (bins, _nearest(bins))
    )
    few = independent_bins(_nearest(bins))
    sigma = np.sqrt(np.pi / 2.0 / n * (1.0 / few - 1.0 / max(independent_bins(bins), few + 1e-9)))
    with np.errstate(invalid="ignore", divide="ignore"):
        narrowed = np.log(near / wide) > NUMBERS.hump_sigmas * sigma
    if level is not None:
        narrowed &= ~level
    return np.where(narrowed, near, wide), narrowed


@functools.lru_cache(maxsize=4096)
def noise_level(n: float, bins: float, chance: float) -> float:
    """Energy over its floor that noise exceeds with ``chance``: mean of ``n`` spectra, floor of so many ``bins``."""
    low = np.log(gammainccinv(n, chance) / n)
    high, wanted = low + 1.0, np.log(chance)
    while noise_chance(np.exp(high), n, bins) > chance:
        low, high = high, high + 1.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        if np.log(max(float(noise_chance(np.exp(middle), n, bins)), 1e-300)) > wanted:
            low = middle
        else:
            high = middle
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


def _by_phase_alone(order_map: xr.Dataset, false_alarm_probability: float) -> Floats:
    """Excess over one where a line of the cycle's orders agrees in phase as noise of the whole map would so seldom.

    Two lines that nearly cancel, or one in noise that is loud at low frequencies, hide in the energy of their bin.
    """
    chance = _log_chance_of_phase(order_map)
    axis, cycle = order_map["order"].values, int(order_map.attrs["revs_per_cycle"])
    on_cycle = np.abs(axis * cycle - np.rint(axis * cycle)) < 1e-6
    return np.where(on_cycle, np.maximum(chance / np.log(false_alarm_probability / chance.size), 0.0), 0.0)


def _log_chance_of_phase(order_map: xr.Dataset) -> Floats:
    """Logarithm of the chance that frames of noise agree in phase as well as each bin's do; 0 where a bin beside does
    better, and in a map without phases."""
    energy = order_map["amplitude"].values ** 2
    if "coherent_amplitude" not in order_map:
        return np.zeros(energy.shape)
    coherent = order_map["coherent_amplitude"].values ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = np.nan_to_num(np.where(energy > 0.0, coherent / energy, 0.0))
    frames = np.maximum(1.0, order_map["n_coherent"].values)
    chance = (frames - 1.0) * np.log1p(-np.minimum(coherence, 1.0 - 1e-12))
    return np.where(highest_of_three(coherent), chance, 0.0)


def _nanmedian(values: Floats) -> Floats:
    """Median along the last axis without NaN; NaN where all are. Faster than numpy's, which warns besides."""
    ordered = np.sort(values, axis=-1)
    if not np.isnan(ordered[..., -1]).any():
        n = values.shape[-1]
        return np.asarray(0.5 * (ordered[..., (n - 1) // 2] + ordered[..., n // 2]))
    count = np.count_nonzero(~np.isnan(values), axis=-1)
    low = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[-1] - 1)[..., None], axis=-1)[..., 0]
    return np.asarray(0.5 * (low + high))
