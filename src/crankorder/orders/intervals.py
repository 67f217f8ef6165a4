"""95 % intervals of amplitudes and phases from the noise power of their estimates and how well it is known."""

from __future__ import annotations

import functools

import numpy as np
from scipy.special import chndtr, ndtri, stdtrit

from crankorder.quantities import Bools, Floats

LEVEL = 0.95
NORMAL = float(ndtri(0.5 + 0.5 * LEVEL))

LARGEST_DOF = 400
"""Student's t is the normal distribution to 0.3 % beyond."""


def t_quantile(dof: Floats) -> Floats:
    """Half width of a 95 % interval in standard errors, of an estimate whose error has ``dof`` degrees of freedom."""
    dof = np.asarray(dof, dtype=np.float64)
    asked, where = np.unique(dof, return_inverse=True)
    with np.errstate(invalid="ignore"):
        found = np.where(asked > 0.0, stdtrit(np.minimum(asked, LARGEST_DOF), 0.5 + 0.5 * LEVEL), np.inf)
    return np.asarray(found[where].reshape(dof.shape))


def amplitude_interval(
    amplitude: Floats, noise_power: Floats, dof: Floats, *, seen: Bools | None = None
) -> tuple[Floats, Floats]:
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
    power: Floats, *, noise: Floats, bias: Floats, noise_variance: Floats, dof: Floats
) -> tuple[Floats, Floats]:
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


def phase_interval_deg(amplitude: Floats, noise_power: Floats, dof: Floats, *, seen: Bools | None = None) -> Floats:
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


def is_seen(amplitude: Floats, noise_power: Floats, dof: Floats) -> Bools:
    """Whether ``amplitude`` is more than noise of ``noise_power``, known with ``dof``, alone makes once in forty."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.square(amplitude) > noise_power * beyond_chance(dof, 0.5 * (1.0 - LEVEL)))


def beyond_chance(dof: Floats, chance: float) -> Floats:
    """Power over the noise power that noise alone exceeds with ``chance``: the F distribution with 2 and ``dof``."""
    dof = np.maximum(dof, 0.1)
    return np.asarray(0.5 * dof * np.expm1(-2.0 / dof * np.log(chance)))


def _rician_ends(ratio: Floats) -> tuple[Floats, Floats]:
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
def _rician_table() -> tuple[Floats, Floats, Floats]:
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
