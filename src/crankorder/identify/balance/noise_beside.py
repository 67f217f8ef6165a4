"""How the channels' noise goes together: covariance of the errors of some orders, from noise at like frequency."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-balance.toml", table="noise_beside"):
    most_bins: int
    fewest_per_channel: int
    furthest_hz: float
    furthest_share: float


NUMBERS = _Numbers.load()

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

ROUNDS = 6
"""Rounds of the estimate of shape."""
FILLING = 1e-9
"""Of the mean variance, added to the diagonal: no combination of channels is without noise."""


def noise_shape(noise: Complex, *, frequency_hz: Real, usable: NDArray[np.bool_], at_hz: Real) -> tuple[Complex, Real]:
    """Shapes (row, channel, channel), of unit mean diagonal, of the noise's covariance at ``at_hz`` (row,), and bins.

    ``noise`` (channel, speed, bin): complex amplitudes; ``usable`` (speed, bin) of those that hold noise alone, at
    ``frequency_hz`` (speed, bin). Every bin counts alike whatever its size, for speeds differ in how much is left of
    the noise and a line may hide in a few (Tyler 1987, Annals of Statistics 15). Shapes are NaN, and the number of
    bins (row,) 0, where too few tell them.
    """
    n_channels = len(noise)
    sound = usable & np.isfinite(noise).all(axis=0) & (np.abs(noise) > 0).all(axis=0)
    samples, places = noise[:, sound].T, frequency_hz[sound]
    sequence = np.argsort(places, kind="stable")
    samples, places = samples[sequence], places[sequence]
    shapes = np.full((at_hz.size, n_channels, n_channels), np.nan, dtype=np.complex128)
    counts = np.zeros(at_hz.size)
    for row, hertz in enumerate(at_hz):
        near = _nearest(places, float(hertz))
        if near.size >= NUMBERS.fewest_per_channel * n_channels:
            shapes[row], counts[row] = _tyler(samples[near]), near.size
    return shapes, counts


def whitening(noise: Complex, *, error: Real, missed: Real | None = None) -> Complex:
    """Combinations (row, combination, channel) of the channels in which real and imaginary errors are 1 and apart.

    ``noise`` (row, channel, channel): covariance of the complex errors. ``error`` (channel, row): ∞ where nothing was
    measured; there the combinations are 0. ``missed`` (channel, row) adds to the real and the imaginary errors.
    """
    known = np.isfinite(error).T
    both = known[:, :, None] & known[:, None, :]
    own = np.where(known, 0.0 if missed is None else np.transpose(missed) ** 2, 1.0)
    covariance = np.where(both, noise / 2, 0.0) + own[:, :, None] * np.eye(known.shape[1])
    return np.asarray(np.where(both, np.linalg.inv(np.linalg.cholesky(covariance)), 0.0))


def _nearest(places: Real, hertz: float) -> NDArray[np.int64]:
    reach = min(NUMBERS.furthest_hz, max(NUMBERS.furthest_share * hertz, 1.0))
    low, high = np.searchsorted(places, [hertz - reach, hertz + reach])
    found = np.arange(low, high)
    if found.size > NUMBERS.most_bins:
        away = np.abs(places[found] - hertz)
        found = found[np.argsort(away, kind="stable")[: NUMBERS.most_bins]]
    return found


def _tyler(samples: Complex) -> Complex:
    n_samples, n_channels = samples.shape
    shape: Complex = np.eye(n_channels, dtype=np.complex128)
    start = samples / np.sqrt((np.abs(samples) ** 2).mean(axis=0))
    size = np.sqrt((np.abs(samples) ** 2).mean(axis=0))
    for _ in range(ROUNDS):
        inner = np.einsum("nc,cd,nd->n", start.conj(), np.linalg.inv(shape), start).real
        shape = np.einsum("nc,nd->cd", start / inner[:, None], start.conj()) * (n_channels / n_samples)
        shape = shape / (np.trace(shape).real / n_channels) + FILLING * np.eye(n_channels)
    shape = shape * size[:, None] * size
    return np.asarray(shape / (np.trace(shape).real / n_channels))
