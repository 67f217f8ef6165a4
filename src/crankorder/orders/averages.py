"""Means of frames at like speed: the noise of one, and what the frames are worth for their memory.

Order map and operating shapes average here. The noise is that of the frames' own scatter; where they
are too few the bins beside a line help out.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import fdtri

from crankorder.orders.intervals import t_quantile
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("3-orders-lines.toml", "held_sizes")

LARGEST_SHARE = 6
"""Slow waves over the frames, of each sign, whose power is the noise: 24 degrees of freedom, near enough to the line
that a resonance does not change over them."""

FEW_CONTRASTS = 1.5
"""With fewer contrasts of the frames' own, as of one or two frames, the bins beside help out as if level."""

BESIDE_BINS = 10
"""Bins beside a line that hold neither its main lobe nor that of the next half order, in frames of sixteen
revolutions."""

NEAREST_BINS = 4
"""Of them those that help out where frames are few: two on each side, so that a resonance beside is seen as it is."""

SLOPE_RATIO = 3.0
"""Where one side holds so many times the noise of the other the noise slopes, and that of the larger side is taken."""

CHANCE_SIGMAS = 3.0
"""Standard errors of a logarithm by which the noise on either side of a line must differ to be no chance."""

CURVED_SHARE = 0.25
"""Share of half the step of the noise's logarithm across a line by which that under it is not known."""

LEAST_WIDTH = 0.5
"""Square of the half width, in bins, that a resonance has at least in a Hann window's spectrum."""

NOISE_RATIO = 8.0
"""A bin that holds so many times the median of those beside is a line's, not noise: one in 250 of noise does."""


class Contrasts(NamedTuple):
    """Sums over frames in which a line of steady amplitude cancels, and what is known of them beforehand.

    ``rows`` (contrasts, frames) are scaled such that the mean of their squares is the noise power of the mean of the
    frames; ``mean_variance`` is that power over the noise power of one frame, in noise whose spectrum is level over
    the bin; ``independent_powers`` how many independent power spectra the frames are worth, ``dof`` the degrees of
    freedom of the mean of squares.
    """

    rows: Floats
    mean_variance: float
    independent_powers: float
    dof: float


def whitening(begin_rev: Floats, *, revs_per_frame: float) -> Floats:
    """Matrix (frames, frames) that makes white noise independent again in overlapping Hann frames of a recording.

    It is the inverse of the Cholesky factor of the frames' correlation.

    Parameters
    ----------
    begin_rev : (frames,), rev, crank angle at which each frame begins
    revs_per_frame : length of a frame, rev, above 0
    """
    shared = _alike(np.abs(begin_rev[:, None] - begin_rev) / revs_per_frame, "hann")
    return np.asarray(np.linalg.inv(np.linalg.cholesky(shared + 1e-9 * np.eye(len(begin_rev)))))


def neighbour_correlation(begin_rev: Floats, recording: Ints, *, revs_per_frame: float, window: str) -> Floats:
    """Correlation (lags, frames), 0 to 1, of white noise in each frame with itself, the next and so on.

    There are as many lags as frames overlap; lag 0 is 1.

    Parameters
    ----------
    begin_rev : (frames,), rev, crank angle at which each frame begins, rising within a recording
    recording : (frames,), number of the recording of each; frames of different ones do not correlate
    revs_per_frame : length of a frame, rev
    window : "hann"; any other is taken for rectangular, which correlates more
    """
    made = [np.ones(len(begin_rev))]
    for lag in range(1, len(begin_rev)):
        beside = _alike((begin_rev[lag:] - begin_rev[:-lag]) / revs_per_frame, window)
        beside[(recording[lag:] != recording[:-lag]) | (begin_rev[lag:] - begin_rev[:-lag] >= revs_per_frame)] = 0.0
        if not beside.any():
            break
        made.append(np.pad(beside, (0, lag)))
    return np.stack(made)


def _alike(apart: Floats, window: str) -> Floats:
    """Correlation of white noise in frames whose begins lie ``apart``, in lengths of a frame."""
    lag = np.minimum(apart, 1.0)
    if window != "hann":
        return 1.0 - lag
    turn = 2.0 * np.pi * lag
    return np.asarray(((1.0 - lag) * (2.0 + np.cos(turn)) + 1.5 / np.pi * np.sin(turn)) / 3.0)


def contrasts(correlation: Floats, trend: Floats | None = None) -> Contrasts:
    """Contrasts by slow waves over the frames: they show the spectrum of the noise right beside a line.

    The mean of the frames is a spectrum of all of them at the line, far finer than that of one; a wave of j cycles
    over the frames is that spectrum j of its bins away, where a steady line shows nothing.

    Parameters
    ----------
    correlation : (lags, frames), that of :func:`neighbour_correlation`
    trend : (frames,), rpm, speed of the frames, whose linear influence is no noise; None where all are alike
    """
    n = correlation.shape[1]
    given = [np.ones(n)] if trend is None else [np.ones(n), trend - trend.mean()]
    waves = min(LARGEST_SHARE, max(2, n // 8))
    turns = 2.0 * np.pi * np.outer(np.arange(1, min(waves, n // 2) + 1), np.arange(n) + 0.5) / n
    rows = np.stack([np.cos(turns), np.sin(turns)], axis=1).reshape(-1, n)
    rows = rows[np.abs(rows).max(axis=1) > 1e-6]
    if trend is not None:
        unit, triangle = np.linalg.qr(np.concatenate([given, rows]).T)
        adds = np.abs(np.diag(triangle)) > 1e-6 * np.sqrt(n)
        rows = unit.T[len(given) :][adds[len(given) :]]
    later = [(rows[:, : n - lag] * shared[: n - lag]) @ rows[:, lag:].T for lag, shared in enumerate(correlation)]
    expected = later[0] + sum(lagged + lagged.T for lagged in later[1:])
    pairs = np.where(np.arange(len(correlation)) > 0, 2.0, 1.0)
    mean_variance = float(pairs @ correlation.sum(axis=1)) / n**2
    powers = n**2 / float(pairs @ np.square(correlation).sum(axis=1))
    if len(rows) == 0:
        return Contrasts(rows, mean_variance, powers, 0.0)
    scale = np.sqrt(mean_variance / np.diag(expected))
    expected = expected * np.outer(scale, scale)
    dof = 2.0 * float(np.trace(expected)) ** 2 / float(np.square(expected).sum())
    return Contrasts(rows * scale[:, None], mean_variance, powers, dof)


def noise_of_mean(spectrum: Complexes, shape: Contrasts) -> Floats:
    """Noise power (channels, orders) of the mean over the frames of ``spectrum`` (channels, frames, orders).

    ``shape`` says how the frames overlap. NaN where there are no contrasts.
    """
    if len(shape.rows) == 0:
        return np.full((len(spectrum), spectrum.shape[2]), np.nan)
    channels = (np.ascontiguousarray(of_channel, dtype=np.complex128).view(np.float64) for of_channel in spectrum)
    seen = np.stack([shape.rows @ parts for parts in channels])
    power = np.einsum("cko,cko->co", seen, seen).reshape(len(spectrum), -1, 2).sum(axis=-1)
    return np.asarray(power / len(shape.rows))


def independent_by_memory(scatter: Complexes, owner: Ints, count: Ints) -> Floats:
    """Number (channels, orders) of independent complex spectra that frames are worth, as neighbours correlate.

    The scatter of a frame correlates with that of the next one through their overlap and, where noise excites a
    resonance, its decay: (1 - r) / (1 + r) of all frames are independent for a first-order correlation r, from whose
    square the 1 / count that chance adds is subtracted.

    Parameters
    ----------
    scatter : (channels, frames, orders), frames less their mean; 0 where one takes no part
    owner : (frames,), the number of the recording of each: frames of different ones are no neighbours
    count : (channels, orders), frames that take part
    """
    n = np.maximum(count, 1)
    first, second = scatter[:, :-1], scatter[:, 1:]
    if owner[0] != owner[-1]:
        next_to = owner[1:] == owner[:-1]
        first, second = first[:, next_to], second[:, next_to]
    product = np.einsum("cko,cko->co", second, first.conj())
    parts = np.ascontiguousarray(scatter).view(np.float64)
    total = np.einsum("cko,cko->co", parts, parts).reshape(*product.shape, 2).sum(axis=-1)
    squared = (np.square(product.real) + np.square(product.imag)) / np.maximum(total**2, np.finfo(np.float64).tiny)
    memory = np.where(n < 3, 0.0, np.sqrt(np.clip(squared - 1.0 / n, 0.0, 1.0)))
    return np.asarray(count * (1.0 - memory) / (1.0 + memory))


def beside_bins(order: Floats, *, line_step: float, count: int = BESIDE_BINS) -> tuple[Ints, Floats]:
    """Indices (orders, count) of the nearest bins that hold noise, and how many independent ones (orders,) they are.

    ``order`` (orders,) is the axis, ``count`` the number of bins wanted; bins within one of a multiple of ``line_step``
    may hold lines and are left out where enough others are left, those within one of the bin itself and of zero always.
    """
    return _beside_bins(tuple(order.tolist()), line_step, count)


@lru_cache(maxsize=4)
def _beside_bins(axis: tuple[float, ...], line_step: float, count: int) -> tuple[Ints, Floats]:
    order, n = np.array(axis), len(axis)
    at = np.arange(n, dtype=np.int32)  # half of what int64 takes, of all pairs of bins
    distance = np.abs(at[:, None] - at)
    off = np.abs(order / line_step - np.round(order / line_step)) * line_step / (order[1] - order[0])
    cost = distance + np.where(off > 1.5, 0, 3 * n).astype(np.int32)
    cost[distance < 2] += 9 * n
    cost[:, :2] += 9 * n
    bins = np.sort(np.argpartition(cost, min(count, n) - 1, axis=1)[:, :count], axis=1)
    apart = np.minimum(np.abs(bins[:, :, None] - bins[:, None]), 3)
    worth = bins.shape[1] ** 2 / np.array([1.0, 4.0 / 9.0, 1.0 / 36.0, 0.0])[apart].sum(axis=(1, 2))
    bins.flags.writeable = worth.flags.writeable = False  # kept for the next map
    return bins, worth


def noise_beside(energy: Floats, bins: Ints) -> Floats:
    """Noise power (…, orders) of a frame from ``energy`` (…, orders) in ``bins`` (orders, several), lines left out."""
    beside, noise = _noise_bins(energy, bins)
    return np.asarray((beside * noise).sum(axis=-1) / noise.sum(axis=-1))


def median_of_known(values: Floats, *, axis: int) -> Floats:
    """Median of the known ``values`` (any shape) along ``axis``, which the result lacks; NaN where none is known."""
    ordered = np.sort(values, axis=axis)
    count = np.count_nonzero(~np.isnan(ordered), axis=axis)
    low = np.expand_dims(np.maximum(count - 1, 0) // 2, axis)
    high = np.expand_dims(np.minimum(count // 2, values.shape[axis] - 1), axis)
    both = [np.take_along_axis(ordered, at, axis=axis).squeeze(axis) for at in (low, high)]
    return np.asarray(0.5 * (both[0] + both[1]))


def cycle_bins(frames: xr.Dataset) -> Ints:
    """Bins (multiples,) of the multiples of the cycle's order in the OrderFrames ``frames``, without order 0.

    ``frames`` hold two orders or more.
    """
    order, step = frames["order"].values, 1.0 / int(frames.attrs["revs_per_cycle"])
    per_order = 1.0 / float(order[1] - order[0])
    return np.asarray(np.rint(np.arange(1.0, np.floor(order[-1] / step) + 1.0) * step * per_order).astype(np.int64))


def median_beside(power: Floats, half: int) -> Floats:
    """Median (bins,) of ``power`` (bins,) over each bin and ``half`` bins on each side; mirrored at the ends."""
    beside = np.lib.stride_tricks.sliding_window_view(np.pad(power, half, mode="reflect"), 2 * half + 1)
    return np.asarray(np.median(beside, axis=-1))


def noise_under(level: Floats, energy: Floats, bins: Ints, at: float, independent: Floats) -> tuple[Floats, Floats]:
    """Noise power (…,) under a line and its standard error (…,) from the unknown shape of the noise.

    Where the bins beside rise towards the line, or across it, by more than chance, the noise is that of the nearest
    ones, carried on as a parabola of its logarithm: the mean of all would take the noise of a resonance for the line's.

    Parameters
    ----------
    level : (…,), mean noise power of the ``bins``
    energy : (…, orders), mean power of the frames without what the line leaks
    bins : (several,), rising, bins that hold noise; fewer than two on one side give ``level`` and 0
    at : bin of the line, with fractions
    independent : (…,), independent frames that ``energy`` is the mean of
    """
    below, above = bins[bins < at], bins[bins > at]
    if min(len(below), len(above)) < 2:
        return level, np.zeros(level.shape)
    four = np.array([below[-2], below[-1], above[0], above[1]])
    with np.errstate(divide="ignore", invalid="ignore"):
        lowest, lower, upper, uppermost = np.moveaxis(np.log(energy[..., four]), -1, 0)
        near, far = 0.5 * (lower + upper), 0.5 * (lowest + uppermost)
        risen, step = near - far, 0.5 * np.abs(lower + lowest - upper - uppermost)
        chance = CHANCE_SIGMAS / np.sqrt(np.maximum(independent, 1.0))
        peaked, sloped = risen > chance, step > chance
        distances = np.square(0.5 * np.array([above[0] - below[-1], above[1] - below[-2]], dtype=np.float64))
        carried = np.where(peaked, risen, 0.0) * distances[0] / (distances[1] - distances[0])
        local = np.exp(near + carried + 0.5 / np.maximum(independent, 1.0))  # a mean logarithm of few is low
        squared = np.maximum((distances[1] - np.exp(risen) * distances[0]) / np.expm1(risen), LEAST_WIDTH)
        top = np.exp(near) * (distances[0] + squared) / squared  # of a resonance with these flanks
        spread = np.where(peaked, np.maximum(top - local, local * np.expm1(risen)), 0.0)
        spread += 0.5 * CURVED_SHARE * np.abs(upper - lower) * local
    used = (peaked | sloped) & np.isfinite(local) & np.isfinite(spread)
    return np.where(used, local, level), np.where(used, spread, 0.0)


def steepest_noise_beside(energy: Floats, bins: Ints) -> Floats:
    """Noise power (…, orders) as in :func:`noise_beside`, but of the larger side only where the noise slopes.

    ``energy`` (…, orders) is that of a frame, ``bins`` (orders, several) are rising. A line on the flank of a resonance
    lies in more noise than the mean of both sides.
    """
    beside, noise = _noise_bins(energy, bins)
    half = bins.shape[1] // 2
    held = beside * noise
    sides = [held[..., part].sum(axis=-1) / np.maximum(noise[..., part].sum(axis=-1), 1)
             for part in (slice(half), slice(half, None))]  # fmt: skip
    larger = np.maximum(*sides)
    level = held.sum(axis=-1) / noise.sum(axis=-1)
    return np.asarray(np.where(larger > SLOPE_RATIO * np.minimum(*sides), larger, level))


def _noise_bins(energy: Floats, bins: Ints) -> tuple[Floats, Bools]:
    """Energies (…, orders, several) of ``bins``, and which of them are noise and no line."""
    beside = energy[..., bins]
    middle = np.partition(beside, beside.shape[-1] // 2, axis=-1)[..., beside.shape[-1] // 2, None]
    return beside, (beside <= NOISE_RATIO * middle) | ~np.isfinite(beside)


def helped_by_beside(
    noise: Floats, own: Floats, energy: Floats, powers: Floats, *, bins: Ints, worth: Floats
) -> tuple[Floats, Floats]:
    """Noise power of a frame and its complex degrees of freedom, both (…, orders); few ``own`` ones join bins beside.

    Parameters
    ----------
    noise : (…, orders), by the frames' own scatter
    own : (…, orders), its complex degrees of freedom
    energy : (…, orders), mean power of the frames
    powers : (…, orders), independent power spectra behind ``energy``
    bins : (orders, several), as of :func:`beside_bins`
    worth : (orders,), how many independent bins these are
    """
    few = own < FEW_CONTRASTS
    if not few.any():
        return noise, own
    beside = steepest_noise_beside(energy, bins)
    more = np.where(np.isfinite(beside), worth * powers, 0.0)
    total = own + more
    mean = (own * np.nan_to_num(noise) + more * np.nan_to_num(beside)) / np.maximum(total, 1e-9)
    return np.where(few, mean, noise), np.where(few, total, own)


class HeldSizes(NamedTuple):
    """Amplitudes of a line in the frames of one recording whose speed is held.

    ``row`` is its row of the map, ``sizes`` (channels, frames) the amplitudes. The line keeps no phase, so that each
    frame tells its amplitude only.
    """

    row: int
    sizes: Floats

    def mean(self, noise: Floats) -> Floats:
        """Amplitude (channels,) of the line in the recording, without the ``noise`` power (channels,) of a frame."""
        return np.asarray(np.sqrt(np.maximum(np.square(self.sizes).mean(axis=1) - noise, 0.0)))


class SizeRows(NamedTuple):
    """Amplitudes of a line, each field (channels, rows): ``amplitude``, its standard ``error`` and ``dof``, interval.

    ``dof`` are the degrees of freedom of ``error``; ``low`` and ``high`` are the ends of the 95 % interval.
    """

    amplitude: Floats
    error: Floats
    dof: Floats
    low: Floats
    high: Floats

    def with_scatter(self, held: list[HeldSizes], *, noise: Floats, independent: Floats) -> SizeRows:
        """These rows with intervals wide enough for the differences of recordings and frames.

        Recordings of one row differ by a factor; its error has one degree of freedom less than there are recordings.
        Where the amplitude surely changes within recordings, the interval reaches over all values of the frames.

        Parameters
        ----------
        held : amplitudes of the frames by recording
        noise : (channels, rows), noise power of a frame
        independent : (rows,), independent bins from which ``noise`` is known
        """
        error, dof, low, high = (values.copy() for values in (self.error, self.dof, self.low, self.high))
        for row in sorted({part.row for part in held}):
            parts, size = [part for part in held if part.row == row], self.amplitude[:, row]
            means = np.array([part.mean(noise[:, row]) for part in parts])
            if len(parts) > 1:
                with np.errstate(invalid="ignore", divide="ignore"):
                    share = means.std(axis=0, ddof=1) / means.mean(axis=0) / np.sqrt(len(parts))
                    times = share * t_quantile(np.array(len(parts) - 1.0))
                    wider = times * size > high[:, row] - size
                low[wider, row], high[wider, row] = (size / (1.0 + times))[wider], (size * (1.0 + times))[wider]
                error[wider, row], dof[wider, row] = (share * size)[wider], len(parts) - 1.0
            free = float(sum(part.sizes.shape[1] - 1 for part in parts))
            if free >= 2.0:
                every = np.concatenate([part.sizes for part in parts], axis=1)
                scatter = sum(part.sizes.var(axis=1) * part.sizes.shape[1] for part in parts) / free
                surely = float(fdtri(free, 2.0 * independent[row] * (free + 1.0), 1.0 - NUMBERS.changing_chance))
                least = noise[:, row] * max(surely, NUMBERS.changing_over_noise)
                changes = (noise[:, row] > 0.0) & (2.0 * scatter >= least)
                low[changes, row] = np.minimum(low[:, row], every.min(axis=1))[changes]
                high[changes, row] = np.maximum(high[:, row], every.max(axis=1))[changes]
        return SizeRows(self.amplitude, error, dof, low, high)
