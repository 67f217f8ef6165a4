"""Trend of an order's amplitude with speed: a power law whose scatter the speeds themselves tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="order_trend"):
    least_relative_error: float
    most_relative_error: float


NUMBERS = _Numbers.load()

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PowerLaw:
    """log amplitude = ``level`` + ``exponent`` · log(speed / ``reference_rpm``), from speeds that scatter about it.

    ``covariance`` (2, 2) of (level, exponent), with ``freedom`` degrees of freedom; ``scatter`` is the variance of the
    logarithm beyond the amplitudes' own errors, ``scale`` by how much both are to be widened.
    """

    reference_rpm: float
    level: float
    exponent: float
    covariance: Floats
    scatter: float
    scale: float
    freedom: int

    def excess(self, speed_rpm: Floats, amplitude: Floats, amplitude_error: Floats) -> tuple[Floats, Floats]:
        """Logarithm of ``amplitude`` over the law at ``speed_rpm``, and its standard error: (speeds,) each.

        ``amplitude_error`` are the standard errors of the amplitudes, which took no part in the law.
        """
        x = np.log(speed_rpm / self.reference_rpm)
        own = _relative(amplitude, amplitude_error) ** 2 + self.scatter
        of_law = self.covariance[0, 0] + 2.0 * x * self.covariance[0, 1] + x**2 * self.covariance[1, 1]
        excess = np.log(amplitude) - self.level - self.exponent * x
        return excess, np.sqrt(of_law + self.scale * own)


def power_law(speed_rpm: Floats, amplitude: Floats, amplitude_error: Floats) -> PowerLaw | None:
    """Power law of ``amplitude`` against ``speed_rpm``; None for fewer than three speeds or for one speed only.

    All are (speeds,); ``amplitude_error`` are standard errors; speeds without either take no part. Speeds are weighted
    by their errors and by a scatter common to all (DerSimonian and Laird 1986); the covariance is that of the
    residuals, so that Student's t holds (Knapp and Hartung 2003).
    """
    known = (amplitude > 0.0) & np.isfinite(amplitude_error) & np.isfinite(speed_rpm)
    speed_rpm, amplitude, amplitude_error = speed_rpm[known], amplitude[known], amplitude_error[known]
    if len(speed_rpm) < 3 or np.ptp(speed_rpm) <= 1e-6 * float(np.mean(speed_rpm)):
        return None
    reference = float(np.exp(np.mean(np.log(speed_rpm))))
    design = np.stack([np.ones(len(speed_rpm)), np.log(speed_rpm / reference)], axis=1)
    y, own = np.log(amplitude), _relative(amplitude, amplitude_error) ** 2
    freedom = len(y) - 2
    _, inverse, cost = _weighted(design, y, 1.0 / own)
    weight = 1.0 / own
    spare = weight.sum() - np.trace(inverse @ (design * weight[:, None] ** 2).T @ design)
    scatter = max(0.0, (cost - freedom) / float(spare))
    solution, inverse, cost = _weighted(design, y, 1.0 / (own + scatter))
    scale = max(cost / freedom, 1e-12)
    return PowerLaw(reference, float(solution[0]), float(solution[1]), inverse * scale, scatter, scale, freedom)


def _relative(amplitude: Floats, error: Floats) -> Floats:
    return np.clip(error / amplitude, NUMBERS.least_relative_error, NUMBERS.most_relative_error)


def _weighted(design: Floats, y: Floats, weight: Floats) -> tuple[Floats, Floats, float]:
    """Weighted least squares: solution, inverse of the normal matrix, weighted sum of squares that is left."""
    normal = design.T @ (design * weight[:, None])
    inverse: Floats = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    solution = inverse @ (design.T @ (weight * y))
    residual = y - design @ solution
    return solution, inverse, float(np.sum(weight * residual**2))
