"""How far an order stands, near a crossing, above the trend of the speeds beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from crankorder.identify.found import AgreedOrder, Mode, OrderLine
from crankorder.identify.intervals import half_width
from crankorder.quantities import Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "above_trend")


@dataclass(frozen=True)
class Seen:
    """What one channel says of one crossing: ``chance`` that an order without the mode looks like that.

    ``ratio`` with its interval is that of the amplitude at ``at_rpm`` to the trend beside; None where there is none.
    """

    channel: str
    chance: float
    at_rpm: float | None = None
    ratio: float | None = None
    ratio_low: float = 0.0
    ratio_high: float = np.inf


def width_rpm(rpm: float, mode: Mode, settings: IdentifySettings) -> float:
    """How far (rpm) from a crossing at ``rpm`` a speed still feels ``mode``.

    Its half-power width, and no less than ``settings.crossing_band_rpm``.
    """
    return max(2.0 * mode.damping_ratio * rpm, settings.crossing_band_rpm * (1.0 + 1e-6))


def in_range(rpm: float, speed_rpm: tuple[float, float], settings: IdentifySettings) -> bool:
    """Whether ``rpm`` is within the tested range ``speed_rpm`` (rpm), or ``settings.crossing_band_rpm`` beside it."""
    return bool(speed_rpm[0] - settings.crossing_band_rpm <= rpm <= speed_rpm[1] + settings.crossing_band_rpm)


def evidence_beside(
    agreed: AgreedOrder, rpm: float, mode: Mode, best: Seen | None, tested: Floats, settings: IdentifySettings
) -> str:
    """What the amplitudes of ``agreed`` around its crossing at ``rpm`` with ``mode``, inside the tested range, show.

    ``best`` is the channel that shows it best, None where no trend is known; ``tested`` (n,) are all speeds in rpm;
    ``settings`` say how near a speed counts.
    """
    near = width_rpm(rpm, mode, settings)
    near_tested = tested[np.abs(tested - rpm) <= near]
    if best is not None:
        said = (
            f"in {best.channel} {best.ratio:.2g} times the trend beside it at {best.at_rpm:.4g} rpm "
            f"({best.ratio_low:.2g} to {best.ratio_high:.2g})"
        )
        if np.abs(tested - rpm).min() > 2.0 * mode.damping_ratio * rpm:
            said += "; the tested speeds are further apart than the resonance is wide"
        return said
    if any(np.any(np.abs(line.speed_rpm - rpm) <= near) for line in agreed.lines):
        return "too few speeds beside it for a trend"
    if near_tested.size:
        return f"the order does not stand over the floor at {near_tested[0]:.4g} rpm"
    return "no speed near enough was tested"


def above_trend(line: OrderLine, rpm: float, near_rpm: float, others: list[tuple[float, float]]) -> list[Seen]:
    """How far the amplitude of ``line`` near ``rpm`` stands above the trend of the speeds beside; [] where unknown.

    Speeds within ``near_rpm`` are near; ``others`` are all crossings of the order (rpm, damping ratio).
    """
    speed = line.speed_rpm
    at = np.flatnonzero(np.abs(speed - rpm) <= near_rpm)
    law = _trend_beside(line, rpm, near_rpm, others)
    at = at[(line.amplitude[at] > 0.0) & np.isfinite(line.amplitude_error[at])]
    if not at.size or law is None:
        return []
    excess, error = law.excess(speed[at], line.amplitude[at], line.amplitude_error[at])
    best = int(np.argmax(excess / error))
    chance = min(1.0, at.size * float(stdtr(law.freedom, -excess[best] / error[best])))
    half = half_width(law.freedom, level=1.0 - 0.05 / at.size) * error[best]
    ratio = float(np.exp(excess[best]))
    with np.errstate(over="ignore"):
        low, high = ratio * np.exp(-half), ratio * np.exp(half)
    if not high < NUMBERS.meaningless_amplification:
        return []
    return [Seen(line.channel, chance, float(speed[at[best]]), ratio, float(low), float(high))]


def _trend_beside(line: OrderLine, rpm: float, near_rpm: float, others: list[tuple[float, float]]) -> PowerLaw | None:
    """Power law of ``line`` beside ``rpm``; the crossings with ``others`` (rpm, damping) are left out if it can be."""
    speed = line.speed_rpm
    damping = min(others, key=lambda item: abs(item[0] - rpm))[1]
    free = np.abs(speed - rpm) > max(near_rpm, NUMBERS.neighbourhood_dampings * damping * rpm)
    clear = free.copy()
    for other, its_damping in others:
        clear &= np.abs(speed - other) > max(0.5 * near_rpm, 2.0 * its_damping * other)
    close = np.abs(np.log(speed / rpm)) < NUMBERS.beside_log_ratio
    for chosen in (clear & close, clear, free & close, free):
        if np.count_nonzero(chosen) >= NUMBERS.enough_beside:
            return power_law(speed[chosen], line.amplitude[chosen], line.amplitude_error[chosen])
    if np.count_nonzero(free) < NUMBERS.least_beside:
        return None
    return power_law(speed[free], line.amplitude[free], line.amplitude_error[free])


def seen_all_around(line: OrderLine, rpm: float, tested: Floats) -> bool:
    """Whether ``line`` stands out at most of the speeds ``tested`` (n,) in rpm around ``rpm``.

    Where it hides in the floor, its trend is too high.
    """
    around = np.abs(np.log(tested / rpm)) < NUMBERS.beside_log_ratio
    seen = np.abs(np.log(line.speed_rpm / rpm)) < NUMBERS.beside_log_ratio
    return bool(np.count_nonzero(seen) >= NUMBERS.mostly_seen_share * np.count_nonzero(around))


LAW_NUMBERS = MethodNumbers("5-identify-explain.toml", "order_trend")


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
    return np.clip(error / amplitude, LAW_NUMBERS.least_relative_error, LAW_NUMBERS.most_relative_error)


def _weighted(design: Floats, y: Floats, weight: Floats) -> tuple[Floats, Floats, float]:
    """Weighted least squares: solution, inverse of the normal matrix, weighted sum of squares that is left."""
    inverse: Floats = np.asarray(np.linalg.inv(design.T @ (design * weight[:, None])), dtype=np.float64)
    solution = inverse @ (design.T @ (weight * y))
    residual = y - design @ solution
    return solution, inverse, float(np.sum(weight * residual**2))
