"""The change of mass that would explain what changed: one factor of unbalance, its law with speed, and grams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from crankorder.identify.changes.order_changes import OrderChange, welch
from crankorder.identify.intervals import half_width
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-changes.toml", table="mass_change"):
    fit_chance: float
    clear_sigmas: float


NUMBERS = _Numbers.load()

_STEPS = 500


@dataclass(frozen=True, eq=False)
class Unbalance:
    """What became of an order's unbalance between two tests, in one channel.

    ``factor`` (complex) is the unbalance after over that before, whatever path leads from it to the sensor, because the
    path is the same in both tests; ``factor_error`` is the standard error of each of its parts with ``freedom``.
    ``factor_fits`` is the chance of a worse fit of one factor at all speeds, NaN for one speed. ``square_law`` is the
    change of the phasor at ``reference_rpm`` if it grows with the square of speed at one phase (a rigid path),
    ``square_law_error`` its standard error, ``square_law_fits`` as for the factor.
    """

    channel: str
    order: float
    unit: str
    speed_rpm: NDArray[np.float64]
    factor: complex
    factor_error: float
    freedom: float
    factor_fits: float
    reference_rpm: float
    square_law: complex
    square_law_error: float
    square_law_fits: float

    @property
    def size_ci95(self) -> tuple[float, float]:
        """95 % interval of the factor's size, from 0."""
        half = half_width(self.freedom) * self.factor_error
        return max(abs(self.factor) - half, 0.0), abs(self.factor) + half

    @property
    def turned_deg_ci95(self) -> float:
        """Half width of the 95 % interval of the factor's angle, degrees; 180 where it is unknown."""
        half = half_width(self.freedom) * self.factor_error
        return float(np.degrees(np.arcsin(half / abs(self.factor)))) if half < abs(self.factor) else 180.0

    @property
    def explains(self) -> bool:
        """Whether one factor fits at all speeds and is not 1 within its 95 % interval."""
        told = np.isnan(self.factor_fits) or self.factor_fits >= NUMBERS.fit_chance
        radius = float(np.sqrt(2.0 * _f_quantile(self.freedom))) * self.factor_error
        return bool(told and abs(self.factor - 1.0) > radius)


def _f_quantile(freedom: float) -> float:
    from scipy.special import fdtri

    return float(fdtri(2.0, freedom, 0.95))


def unbalance_change(change: OrderChange) -> Unbalance | None:
    """What became of the unbalance that ``change``, of an order locked to the shaft, shows.

    None where fewer than one speed has phases in both tests, or the first test does not show the order clearly.
    The factor is the maximum-likelihood slope of a line through the origin with errors in both phasors
    (Fuller 1987, Measurement Error Models, sec. 1.3).
    """
    before, after = change.base.vector, change.new.vector
    kept = np.isfinite(before) & np.isfinite(after) & (change.base.vector_error > 0) & (change.new.vector_error > 0)
    if not kept.any():
        return None
    before, after = before[kept], after[kept]
    error, error2 = change.base.vector_error[kept], change.new.vector_error[kept]
    if not np.sum(np.abs(before) ** 2 / error**2) > 2.0 * NUMBERS.clear_sigmas**2 * len(before):
        return None
    both, each_freedom = welch(error, change.base.freedom[kept], error2, change.new.freedom[kept])
    factor, misfit, variance = _slope(before, after, error, error2)
    speed = change.base_rpm[kept]
    reference = float(np.nanmax(speed)) if np.isfinite(speed).any() else 1.0
    law, law_misfit, law_variance = _law(after - before, both, (speed / reference) ** 2)
    freedom = float(np.sum(each_freedom))
    spare = 2.0 * (len(before) - 1)
    scatter = [max(1.0, chi2 / spare) if spare else 1.0 for chi2 in (misfit, law_misfit)]
    # an estimated variance makes a square over it larger on average, by freedom / (freedom − 2)
    fair = float(np.mean(np.maximum(each_freedom - 2.0, 0.5) / each_freedom))
    fits = [float(fdtrc(spare, freedom, fair * chi2 / spare)) if spare else np.nan for chi2 in (misfit, law_misfit)]
    return Unbalance(
        change.channel, change.order, change.unit, speed,
        complex(factor), float(np.sqrt(variance * scatter[0])), freedom, fits[0],
        reference, complex(law), float(np.sqrt(law_variance * scatter[1])), fits[1],
    )  # fmt: skip


def _slope(
    before: NDArray[np.complex128],
    after: NDArray[np.complex128],
    error: NDArray[np.float64],
    error2: NDArray[np.float64],
) -> tuple[complex, float, float]:
    """Factor, chi-square of its misfit, and variance of each of its parts."""
    factor = complex(np.sum(before.conj() * after / error2**2) / np.sum(np.abs(before) ** 2 / error2**2))
    true = before
    for _ in range(_STEPS):
        weight = 1.0 / error**2 + abs(factor) ** 2 / error2**2
        true = (before / error**2 + np.conj(factor) * after / error2**2) / weight
        better = complex(np.sum(true.conj() * after / error2**2) / np.sum(np.abs(true) ** 2 / error2**2))
        done = abs(better - factor) <= 1e-12 * abs(better)
        factor = better
        if done:
            break
    total = error2**2 + abs(factor) ** 2 * error**2
    misfit = float(np.sum(np.abs(after - factor * before) ** 2 / total))
    return factor, misfit, float(1.0 / np.sum(np.abs(true) ** 2 / total))


def _law(
    change: NDArray[np.complex128], error: NDArray[np.float64], square: NDArray[np.float64]
) -> tuple[complex, float, float]:
    """Phasor at the reference speed of a change that grows with ``square``, its misfit and its variance."""
    square = np.where(np.isfinite(square), square, 1.0)
    information = float(np.sum(square**2 / error**2))
    law = complex(np.sum(square * change / error**2) / information)
    return law, float(np.sum(np.abs(change - law * square) ** 2 / error**2)), 1.0 / information


@dataclass(frozen=True)
class Weighed:
    """Unbalance before and after a known change of mass, in the units of that mass; angles from where it was put.

    Standard error ``error`` of each part of both; ``per_unit`` the response to one unit of mass at each speed.
    """

    added: complex
    before: complex
    after: complex
    error: float
    freedom: float
    speed_rpm: NDArray[np.float64]
    per_unit: NDArray[np.complex128]
    per_unit_error: NDArray[np.float64]


def weighed(change: OrderChange, unbalance: Unbalance, added: complex) -> Weighed | None:
    """Unbalance before and after in grams, from a known ``added`` mass, by its influence on the order.

    Parameters
    ----------
    change : the order's change
    unbalance : what became of it, from :func:`unbalance_change`
    added : mass put on (g, or g·mm) times exp(i angle); not 0

    With U before and U + added after, seen through one path, factor = 1 + added / U (influence coefficients: Goodman
    1964, Trans. ASME B 86, 273). None where the factor cannot be told from 1.
    """
    apart = unbalance.factor - 1.0
    if abs(apart) <= NUMBERS.clear_sigmas * unbalance.factor_error:
        return None
    before = added / apart
    error, _ = welch(change.base.vector_error, change.base.freedom, change.new.vector_error, change.new.freedom)
    return Weighed(
        added=added,
        before=before,
        after=unbalance.factor * before,
        error=abs(added) * unbalance.factor_error / abs(apart) ** 2,
        freedom=unbalance.freedom,
        speed_rpm=change.base_rpm,
        per_unit=change.vector_change / added,
        per_unit_error=error / abs(added),
    )
