"""95 % intervals of amplitudes and phases: from the noise beside a line in the spectrum, with few frames or many."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr, ndtri, stdtrit

LEVEL = 0.95
NORMAL = float(ndtri(0.5 + 0.5 * LEVEL))

LARGEST_DOF = 400
"""Student's t is the normal distribution to 0.3 % beyond."""

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

NOISE_RATIO = 8.0
"""A bin that holds so many times the median of those beside is a line's, not noise: one in 250 of noise does."""


@dataclass(frozen=True)
class Contrasts:
    """Sums over frames in which a line of steady amplitude cancels, and what is known of them beforehand.

    ``rows`` (contrasts, frames) are scaled such that the mean of their squares is the noise power of the mean of the
    frames; ``mean_variance`` is that power over the noise power of one frame, in noise whose spectrum is level over
    the bin; ``independent_powers`` how many independent power spectra the frames are worth, ``dof`` the degrees of
    freedom of the mean of squares.
    """

    rows: NDArray[np.float64]
    mean_variance: float
    independent_powers: float
    dof: float


def frame_correlation(
    begin_rev: NDArray[np.float64], recording: NDArray[np.int64], *, revs_per_frame: float, window: str
) -> NDArray[np.float64]:
    """Correlation (frames, frames) of white noise in frames that overlap.

    Parameters
    ----------
    begin_rev : (frames,), rev, crank angle at which each frame begins
    recording : (frames,), number of the recording of each; frames of different ones do not correlate
    revs_per_frame : length of a frame, rev
    window : "hann"; any other is taken for rectangular, which correlates more
    """
    lag = np.minimum(np.abs(begin_rev[:, None] - begin_rev) / revs_per_frame, 1.0)
    if window == "hann":
        turn = 2.0 * np.pi * lag
        both = ((1.0 - lag) * (2.0 + np.cos(turn)) + 1.5 / np.pi * np.sin(turn)) / 3.0
    else:
        both = 1.0 - lag
    return np.asarray(np.where(recording[:, None] == recording, both, 0.0))


def contrasts(correlation: NDArray[np.float64], trend: NDArray[np.float64] | None = None) -> Contrasts:
    """Slow waves over frames: what they show of a line's bin is the spectrum of the noise right beside the line.

    The mean of the frames is a spectrum of all of them at the line, far finer than that of one; a wave of j cycles
    over the frames is that spectrum j of its bins away, where a steady line shows nothing.

    Parameters
    ----------
    correlation : (frames, frames), of white noise in the frames
    trend : (frames,), speed of the frames, whose linear influence is no noise; None where all are alike
    """
    n = len(correlation)
    given = [np.ones(n)] if trend is None else [np.ones(n), trend - trend.mean()]
    waves = min(LARGEST_SHARE, max(2, n // 8))
    turns = 2.0 * np.pi * np.outer(np.arange(1, min(waves, n // 2) + 1), np.arange(n) + 0.5) / n
    rows = np.stack([np.cos(turns), np.sin(turns)], axis=1).reshape(-1, n)
    rows = rows[np.abs(rows).max(axis=1) > 1e-6]
    if trend is not None:
        unit, triangle = np.linalg.qr(np.concatenate([given, rows]).T)
        adds = np.abs(np.diag(triangle)) > 1e-6 * np.sqrt(n)
        rows = unit.T[len(given) :][adds[len(given) :]]
    expected = rows @ correlation @ rows.T
    mean_variance = float(correlation.sum()) / n**2
    powers = n**2 / float(np.square(correlation).sum())
    if len(rows) == 0:
        return Contrasts(rows, mean_variance, powers, 0.0)
    scale = np.sqrt(mean_variance / np.diag(expected))
    expected = expected * np.outer(scale, scale)
    dof = 2.0 * float(np.trace(expected)) ** 2 / float(np.square(expected).sum())
    return Contrasts(rows * scale[:, None], mean_variance, powers, dof)


def noise_of_mean(spectrum: NDArray[np.complex128], shape: Contrasts) -> NDArray[np.float64]:
    """Noise power (channels, orders) of the mean over the frames of ``spectrum`` (channels, frames, orders).

    ``shape`` says how the frames overlap. NaN where there are no contrasts.
    """
    if len(shape.rows) == 0:
        return np.full((len(spectrum), spectrum.shape[2]), np.nan)
    parts = np.ascontiguousarray(spectrum, dtype=np.complex128).view(np.float64)
    seen = np.matmul(shape.rows, parts)
    power = np.einsum("cko,cko->co", seen, seen).reshape(len(spectrum), -1, 2).sum(axis=-1)
    return np.asarray(power / len(shape.rows))


def beside_bins(
    order: NDArray[np.float64], *, line_step: float, count: int = BESIDE_BINS
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices (orders, ``count``) of the nearest bins that hold noise, and how many independent ones they are worth.

    ``order`` (orders,) is the axis; bins within one of a multiple of ``line_step`` may hold lines and are left out
    where enough others are left, those within one of the bin itself and of zero always.
    """
    n = len(order)
    distance = np.abs(np.arange(n)[:, None] - np.arange(n))
    off = np.abs(order / line_step - np.round(order / line_step)) * line_step / (order[1] - order[0])
    cost = distance + np.where(off > 1.5, 0, 3 * n) + np.where(distance < 2, 9 * n, 0)
    cost[:, :2] += 9 * n
    bins = np.sort(np.argpartition(cost, min(count, n) - 1, axis=1)[:, :count], axis=1)
    apart = np.abs(bins[:, :, None] - bins[:, None])
    alike = np.where(apart == 0, 1.0, np.where(apart == 1, 4.0 / 9.0, np.where(apart == 2, 1.0 / 36.0, 0.0)))
    return bins, bins.shape[1] ** 2 / alike.sum(axis=(1, 2))


def noise_beside(energy: NDArray[np.float64], bins: NDArray[np.int64]) -> NDArray[np.float64]:
    """Noise power (…, orders) of a frame from ``energy`` (…, orders) in ``bins`` (orders, several), lines left out."""
    beside, noise = _noise_bins(energy, bins)
    return np.asarray((beside * noise).sum(axis=-1) / noise.sum(axis=-1))


def steepest_noise_beside(energy: NDArray[np.float64], bins: NDArray[np.int64]) -> NDArray[np.float64]:
    """Noise power (…, orders) as of :func:`noise_beside`, of the larger side alone where the noise slopes.

    ``energy`` (…, orders) of a frame in ``bins`` (orders, several) that grow. A line on the flank of a resonance lies
    in more noise than the mean of both sides.
    """
    beside, noise = _noise_bins(energy, bins)
    half = bins.shape[1] // 2
    held = beside * noise
    sides = [held[..., part].sum(axis=-1) / np.maximum(noise[..., part].sum(axis=-1), 1)
             for part in (slice(half), slice(half, None))]  # fmt: skip
    larger = np.maximum(*sides)
    level = held.sum(axis=-1) / noise.sum(axis=-1)
    return np.asarray(np.where(larger > SLOPE_RATIO * np.minimum(*sides), larger, level))


def helped_by_beside(
    noise: NDArray[np.float64],
    own: NDArray[np.float64],
    *,
    energy: NDArray[np.float64],
    powers: NDArray[np.float64],
    bins: NDArray[np.int64],
    worth: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``noise`` power of a frame and its complex degrees of freedom; where ``own`` are few, with the bins beside.

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
    helping = np.where(few & np.isfinite(beside), worth * powers, 0.0)
    both = own + helping
    pooled = own * noise + helping * np.nan_to_num(beside)
    return np.where(few, pooled / np.maximum(both, 1e-9), noise), both


def _noise_bins(energy: NDArray[np.float64], bins: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Energies (…, orders, several) of ``bins``, and which of them are noise and no line."""
    beside = energy[..., bins]
    middle = np.partition(beside, beside.shape[-1] // 2, axis=-1)[..., beside.shape[-1] // 2, None]
    return beside, (beside <= NOISE_RATIO * middle) | ~np.isfinite(beside)


def t_quantile(dof: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half width of a 95 % interval in standard errors, of an estimate whose error has ``dof`` degrees of freedom."""
    dof = np.asarray(dof, dtype=np.float64)
    asked, where = np.unique(dof, return_inverse=True)
    with np.errstate(invalid="ignore"):
        found = np.where(asked > 0.0, stdtrit(np.minimum(asked, LARGEST_DOF), 0.5 + 0.5 * LEVEL), np.inf)
    return np.asarray(found[where].reshape(dof.shape))


def amplitude_interval(
    amplitude: NDArray[np.float64],
    noise_power: NDArray[np.float64],
    dof: NDArray[np.float64],
    *,
    seen: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper end of the 95 % interval of the amplitude of a line in complex Gaussian noise.

    Far above the noise it is Student's t about the amplitude without what noise adds to it; near the noise the
    Rician distribution is inverted. The lower end leaves 0 exactly where the line is seen (:func:`is_seen`), and grows
    from there as the Rician distribution averaged over the noise powers that ``noise_power`` and ``dof`` allow (within
    0.1 standard errors from 4 degrees of freedom on); the upper end is at least what noise alone can hide.

    Parameters
    ----------
    amplitude : magnitude of the complex estimate
    noise_power : mean square of its complex error; the standard error of the amplitude is the root of half of it
    dof : degrees of freedom of ``noise_power``; all three broadcast, and 0 or NaN gives 0 and infinity
    seen : where False the lower end is 0 though ``noise_power`` alone would not say so; None asks nothing more
    """
    amplitude, noise_power, dof = np.broadcast_arrays(amplitude, noise_power, dof)
    tail = 0.5 * (1.0 - LEVEL)
    with np.errstate(invalid="ignore", divide="ignore"):
        stretch = t_quantile(dof) / NORMAL
        widened = np.sqrt(noise_power) * stretch
        ratio = amplitude / widened
        least = beyond_chance(dof, tail) / stretch**2  # square of the ratio from which the line is seen
        shift = (least + np.log(tail)) * least / ratio**2
        low = _rician_ends(np.sqrt(np.maximum(ratio**2 - shift, 0.0)))[0]
        low = np.where(ratio**2 > least, low * widened, 0.0)
        high = _rician_ends(ratio)[1] * widened
    low = low if seen is None else np.where(seen, low, 0.0)
    exact = noise_power == 0.0
    low, high = np.where(exact, amplitude, low), np.where(exact, amplitude, high)
    unknown = ~(dof > 0.0) | ~np.isfinite(noise_power)
    low, high = np.where(unknown, 0.0, low), np.where(unknown, np.inf, high)
    missing = np.isnan(amplitude)
    return np.where(missing, np.nan, low), np.where(missing, np.nan, high)


def energy_interval(
    power: NDArray[np.float64],
    *,
    noise: NDArray[np.float64],
    bias: NDArray[np.float64],
    noise_variance: NDArray[np.float64],
    dof: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper end of the 95 % interval of an amplitude whose square was averaged without phase.

    Parameters
    ----------
    power : squared amplitude, with noise
    noise : noise power with which the line beats: the variance of ``power`` is 2 line noise + noise_variance
    bias : what noise adds to ``power`` on average
    noise_variance : variance of ``power`` without a line
    dof : degrees of freedom of the noise power behind all three
    """
    line = np.maximum(power - bias, 0.0)
    reach = t_quantile(dof) * np.sqrt(2.0 * line * noise + noise_variance)
    return np.sqrt(np.maximum(line - reach, 0.0)), np.sqrt(line + reach)


def phase_interval_deg(
    amplitude: NDArray[np.float64],
    noise_power: NDArray[np.float64],
    dof: NDArray[np.float64],
    *,
    seen: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Half width [degree] of the 95 % interval of the phase; 180, unknown, where noise alone could be as large.

    The part of the error across the line is normal whatever the amplitude (Fieller 1954): the true phase is within
    arcsin(t standard_error / amplitude).

    Parameters
    ----------
    amplitude : magnitude of the complex estimate
    noise_power : mean square of its complex error
    dof : degrees of freedom of ``noise_power``
    seen : as of :func:`is_seen`, where more is known of the noise than ``noise_power`` and ``dof`` say
    """
    amplitude, noise_power, dof = np.broadcast_arrays(amplitude, noise_power, dof)
    clear = is_seen(amplitude, noise_power, dof) if seen is None else seen
    with np.errstate(invalid="ignore", divide="ignore"):
        share = t_quantile(dof) * np.sqrt(0.5 * noise_power) / amplitude
        half = np.where(clear & (share < 1.0), np.degrees(np.arcsin(np.minimum(share, 1.0))), 180.0)
    return np.where(np.isnan(amplitude), np.nan, half)


def is_seen(
    amplitude: NDArray[np.float64], noise_power: NDArray[np.float64], dof: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether ``amplitude`` is more than noise of ``noise_power``, known with ``dof``, alone makes once in forty."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.square(amplitude) > noise_power * beyond_chance(dof, 0.5 * (1.0 - LEVEL)))


def beyond_chance(dof: NDArray[np.float64], chance: float) -> NDArray[np.float64]:
    """Power over the noise power that noise alone exceeds with ``chance``: the F distribution with 2 and ``dof``."""
    dof = np.maximum(dof, 0.1)
    return np.asarray(0.5 * dof * np.expm1(-2.0 / dof * np.log(chance)))


def _rician_ends(ratio: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ends of the interval of a line whose noisy amplitude is ``ratio``, both over the root of the noise power."""
    known, low, high = _rician_table()
    far = np.sqrt(np.maximum(ratio**2 - 0.5, 0.0))
    half = NORMAL / np.sqrt(2.0)
    near = ratio < known[-1]
    return (
        np.where(near, np.interp(ratio, known, low), far - half),
        np.where(near, np.interp(ratio, known, high), far + half),
    )


@functools.cache
def _rician_table() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Noisy amplitudes and the true ones above and below which they are 1 in 40, all over the root noise power.

    Twice the square of the ratio is a noncentral chi-square variable with two degrees of freedom.
    """
    true = np.linspace(0.0, 10.0, 201)
    seen = np.linspace(0.0, 8.0, 161)
    below = chndtr(2.0 * seen[:, None] ** 2, 2.0, 2.0 * true**2)
    tail = 0.5 * (1.0 - LEVEL)
    low = np.array([np.interp(-(1.0 - tail), -row, true, left=0.0) for row in below])
    high = np.array([np.interp(-tail, -row, true, left=0.0) for row in below])
    return seen, low, np.maximum(high, NORMAL / np.sqrt(2.0))
