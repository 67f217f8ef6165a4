"""Means of the frames of a followed order: with phases, or by energy where recordings have none in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.orders.intervals import amplitude_interval, energy_interval, phase_interval_deg
from crankorder.orders.vold_kalman.bandwidth import FRAME_BANDWIDTHS, noise_correlation

POLES = 2
"""Of the Vold–Kalman filter that follows orders: 24 dB per octave beyond the band."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Readings:
    """Frames of all recordings of one order: values and errors (channels, frames), and what each frame is (frames,).

    ``per_rev`` is the bandwidth of the filter in cycles per revolution, NaN for frames that were fitted.
    """

    values: NDArray[np.complex128]
    errors: Array
    dof: Array
    revs: Array
    owner: NDArray[np.int64]
    begin_rev: Array
    per_rev: Array

    def of(self, which: NDArray[np.int64]) -> Readings:
        """Those of the frames that ``which`` picks."""
        frames = (self.revs[which], self.owner[which], self.begin_rev[which], self.per_rev[which])
        return Readings(self.values[:, which], self.errors[:, which], self.dof[:, which], *frames)

    def channels(self, which: NDArray[np.int64]) -> Readings:
        """Those of the channels that ``which`` picks."""
        frames = (self.revs, self.owner, self.begin_rev, self.per_rev)
        return Readings(self.values[which], self.errors[which], self.dof[which], *frames)

    def summed(self, weights: Array, *, of_noise: bool) -> Array:
        """Sum (channels,) of weight · weight · correlation over all pairs of frames, ``weights`` (channels, frames).

        The correlation is that of the errors, or (``of_noise``) that of what is known of the noise.
        """
        total = np.asarray(np.square(weights).sum(axis=1))
        for lag in range(1, len(self.revs)):
            alike = self._alike(lag, of_noise=of_noise)
            if not alike.any():
                break
            total += 2.0 * (weights[:, lag:] * weights[:, :-lag] * alike).sum(axis=1)
        return total

    def _alike(self, lag: int, *, of_noise: bool) -> Array:
        """Correlation (frames - lag,) of each frame with the one ``lag`` further on."""
        first, second = slice(None, -lag), slice(lag, None)
        same = self.owner[first] == self.owner[second]
        if np.isnan(self.per_rev).any():
            common = self.begin_rev[first] + self.revs[first] - self.begin_rev[second]
            share = np.clip(common / np.maximum(self.revs[first], self.revs[second]), 0.0, 1.0)
            return np.asarray(same * (share**2 if of_noise else share))
        middle = self.begin_rev + 0.5 * self.revs
        apart = (middle[second] - middle[first]) * np.sqrt(self.per_rev[first] * self.per_rev[second])
        if of_noise:
            return np.asarray(same * np.clip(1.0 - apart / FRAME_BANDWIDTHS, 0.0, 1.0))
        return np.asarray(same * noise_correlation(apart, POLES))


@dataclass(frozen=True)
class Mean:
    """Coherent mean (channels,) of frames, the standard error of its parts, what is known of that, and its length."""

    value: NDArray[np.complex128]
    error: Array
    dof: Array
    revs: float


def coherent_mean(part: Readings) -> Mean:
    """Coherent mean of the frames of ``part``.

    Frames weigh by their length; those with more noise power than most, by more than chance, less in proportion.
    """
    power = np.square(part.errors)
    chance = 1.0 + 3.0 * np.sqrt(2.0 / np.maximum(np.median(part.dof, axis=1, keepdims=True), 1.0))
    limit = chance * np.median(power, axis=1, keepdims=True)
    weight = part.revs * np.divide(limit, power, out=np.ones_like(power), where=power > limit)
    weight /= weight.sum(axis=1, keepdims=True)
    dof = (weight * part.dof).sum(axis=1) / part.summed(weight, of_noise=True)
    error = np.sqrt(np.maximum(part.summed(weight * part.errors, of_noise=False), 0.0))
    return Mean((weight * part.values).sum(axis=1), error, np.floor(dof + 0.5), float(part.revs.sum()))


def by_phase(mean: Mean, *, with_phase: bool) -> dict[str, Array]:
    """What a track says of the coherent ``mean``; of its phase only ``with_phase``."""
    amplitude, power = np.abs(mean.value), 2.0 * mean.error**2
    low, high = amplitude_interval(amplitude, power, mean.dof)
    nothing = np.full(amplitude.shape, np.nan)
    return {
        "amplitude": amplitude,
        "phase": np.degrees(np.angle(mean.value)) if with_phase else nothing,
        "standard_error": mean.error,
        "degrees_of_freedom": mean.dof,
        "amplitude_low": low,
        "amplitude_high": high,
        "phase_ci95": phase_interval_deg(amplitude, power, mean.dof) if with_phase else nothing,
    }


def by_energy(means: list[Mean]) -> dict[str, Array]:
    """What a track says of the ``means`` of recordings whose phases say nothing of each other.

    The noise is taken off their power, which the 95 % interval is of as well.
    """
    share = np.array([mean.revs for mean in means])[:, None] / sum(mean.revs for mean in means)
    noise = 2.0 * np.array([mean.error for mean in means]) ** 2
    power = (share * np.abs([mean.value for mean in means]) ** 2).sum(axis=0)
    bias, beat, variance = (
        (share * noise).sum(axis=0),
        (share**2 * noise).sum(axis=0),
        ((share * noise) ** 2).sum(axis=0),
    )
    dof = np.sum([mean.dof for mean in means], axis=0)
    low, high = energy_interval(power, noise=beat, bias=bias, noise_variance=variance, dof=dof)
    line = np.maximum(power - bias, 0.0)
    error = np.sqrt(2.0 * line * beat + variance) / (2.0 * np.sqrt(np.maximum(power, np.finfo(np.float64).tiny)))
    nothing = np.full(line.shape, np.nan)
    return {
        "amplitude": np.sqrt(line),
        "phase": nothing,
        "standard_error": error,
        "degrees_of_freedom": dof,
        "amplitude_low": low,
        "amplitude_high": high,
        "phase_ci95": nothing,
    }
