"""Time-synchronous averages: what of a signal is locked to the shaft, what of that is regular, and what is neither."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError

ON_THE_COMB = 1e-6
"""An order this close to a multiple of 1 / revs_per_cycle is one."""


@dataclass(frozen=True)
class SynchronousParts:
    """A signal by crank angle split into what is locked to the shaft and what is not.

    ``average`` (channels, samples of a cycle) is the time-synchronous average, its first sample that of the signal,
    ``residual`` (channels, samples) the signal less the average of its place, NaN where it is not usable,
    ``regular`` and ``difference`` (channels, samples of a cycle) the average's regular components and what is left of
    it without them, ``n_cycles`` (channels,) the whole cycles averaged. A channel without one is NaN.
    """

    average: NDArray[np.float64]
    residual: NDArray[np.float64]
    regular: NDArray[np.float64]
    difference: NDArray[np.float64]
    n_cycles: NDArray[np.int64]


def synchronous_average(
    signals: NDArray[np.floating],
    *,
    samples_per_rev: int,
    revs_per_cycle: int,
    usable: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Time-synchronous average (channels, samples of a cycle) of signals, and the cycles (channels,) averaged.

    Parameters
    ----------
    signals : (channels, samples), any unit, evenly spaced in crank angle
    samples_per_rev : samples per crank revolution
    revs_per_cycle : crank revolutions per cycle: 2 keeps the half orders of a four-stroke engine, 1 averages them away
    usable : (channels, samples), None where all are: a cycle with one sample that is not takes no part

    Returns
    -------
    The average over whole cycles, counted from the first sample, and their number; a channel without a cycle is NaN.

    Source: McFadden 1987, a comb filter with as many zeros between its teeth as cycles less one, see
    :func:`comb_response`. The variance of noise that does not know the shaft falls as one over the cycles.
    """
    cycles = cycles_of(signals, samples_per_rev * revs_per_cycle)
    whole = None if usable is None else np.asarray(np.all(cycles_of(usable, samples_per_rev * revs_per_cycle), axis=2))
    return _mean_cycle(cycles, whole)


def cycles_of(values: NDArray, samples_per_cycle: int) -> NDArray:  # type: ignore[type-arg]  # of bool and of floats
    """Whole cycles (channels, cycles, samples_per_cycle) of ``values`` (channels, samples) from its first sample on."""
    count = values.shape[1] // samples_per_cycle
    return values[:, : count * samples_per_cycle].reshape(len(values), count, samples_per_cycle)


def _mean_cycle(
    cycles: NDArray[np.floating], whole: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Mean (channels, samples) of ``cycles`` (channels, cycles, samples), and how many are ``whole``."""
    if whole is None or whole.all():
        n_cycles = np.full(len(cycles), cycles.shape[1], dtype=np.int64)
        total = cycles.sum(axis=1, dtype=np.float64)
    else:
        n_cycles = np.count_nonzero(whole, axis=1)
        total = np.where(whole[..., None], cycles, 0.0).sum(axis=1, dtype=np.float64)
    mean = total / np.maximum(n_cycles, 1)[:, None]
    mean[n_cycles == 0] = np.nan
    return mean, n_cycles


def synchronous_parts(
    signals: NDArray[np.floating],
    *,
    samples_per_rev: int,
    revs_per_cycle: int,
    regular_orders: Sequence[float] | None = None,
    sidebands: int = 0,
    sideband_step_order: float = 1.0,
    usable: NDArray[np.bool_] | None = None,
) -> SynchronousParts:
    """Average, residual, regular and difference signals of ``signals``.

    The words are those of Vecer, Kreidl and Smid 2005 but for one: what they call residual is the difference without
    ``sidebands`` here, and ``residual`` is everything that is not locked to the shaft.

    Parameters
    ----------
    signals : (channels, samples), any unit, evenly spaced in crank angle
    samples_per_rev : samples per crank revolution
    revs_per_cycle : crank revolutions per cycle
    regular_orders : orders of the regular components, such as a gear mesh's and its multiples; None for all that the
        average holds, and then the difference is zero
    sidebands : pairs of sidebands that belong to each regular component
    sideband_step_order : their spacing in orders: the speed of the shaft that modulates, over the crank's
    usable : (channels, samples), None where all are

    Raises RequestError for an order that a cycle does not repeat, or that the samples do not carry.
    """
    period = samples_per_rev * revs_per_cycle
    average, n_cycles = synchronous_average(
        signals, samples_per_rev=samples_per_rev, revs_per_cycle=revs_per_cycle, usable=usable
    )
    place = np.arange(signals.shape[1]) % period
    residual = np.asarray(signals - average[:, place], dtype=np.float64)
    if usable is not None:
        residual[~usable] = np.nan
    if regular_orders is None:
        return SynchronousParts(average, residual, average.copy(), np.zeros_like(average), n_cycles)
    bins = _regular_bins(regular_orders, sidebands, sideband_step_order, revs_per_cycle, period)
    regular = _components(average, bins)
    return SynchronousParts(average, residual, regular, average - regular, n_cycles)


def _regular_bins(
    orders: Sequence[float], sidebands: int, step_order: float, revs_per_cycle: int, period: int
) -> NDArray[np.int64]:
    """Bins of a cycle's spectrum at ``orders`` and their ``sidebands``; sidebands beyond its ends are left out."""
    named = np.asarray(orders, dtype=np.float64)
    away = step_order * np.arange(-sidebands, sidebands + 1)
    wanted = (named[:, None] + away[None, :]) * revs_per_cycle
    off = np.abs(wanted - np.round(wanted)) > ON_THE_COMB * revs_per_cycle
    if off.any():
        raise RequestError(
            "an order that a cycle does not repeat is no part of its average",
            found=f"order {wanted[off][0] / revs_per_cycle:g}",
            allowed=f"multiples of {1 / revs_per_cycle:g}",
        )
    highest = period / 2 / revs_per_cycle
    if named.size and (named.min() < 0.0 or named.max() > highest):
        raise RequestError("an order that the samples do not carry", found=named, allowed=f"0…{highest:g}")
    bins = np.unique(np.round(wanted).astype(np.int64))
    return bins[(bins >= 0) & (bins <= period // 2)]


def _components(average: NDArray[np.float64], bins: NDArray[np.int64]) -> NDArray[np.float64]:
    """What of ``average`` (channels, samples) lies in the ``bins`` of its spectrum."""
    from scipy.fft import irfft, rfft

    spectrum = rfft(average, axis=1)
    kept = np.zeros_like(spectrum)
    kept[:, bins] = spectrum[:, bins]
    return np.asarray(irfft(kept, n=average.shape[1], axis=1))


def comb_response(order: NDArray[np.float64], *, n_cycles: int, revs_per_cycle: int) -> NDArray[np.float64]:
    """Share (orders,) of the amplitude of a line that an average over cycles keeps: 1 on its teeth, 0…1 between.

    ``order`` (orders,) of the line, ``n_cycles`` averaged, ``revs_per_cycle`` of one. A line that slips by 0.3 % at
    order 5.5 keeps a hundredth after about a thousand cycles of two revolutions, none wherever the cycles hold whole
    turns of the slip. Source: McFadden 1987, the magnitude of the comb filter.
    """
    turns = np.asarray(order, dtype=np.float64) * revs_per_cycle
    away = np.pi * (turns - np.round(turns))
    bottom = n_cycles * np.sin(away)
    on_tooth = np.abs(away) < 1e-12
    share = np.sin(n_cycles * away) / np.where(on_tooth, 1.0, bottom)
    return np.asarray(np.where(on_tooth, 1.0, np.abs(share)))
