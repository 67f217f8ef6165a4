"""Numbers by which a synchronous average tells a damaged gear: none has a unit, none changes with the amplitude.

Each takes signals of whole cycles (channels, samples) as :func:`crankorder.orders.synchronous.synchronous_parts` makes
them, and gives (channels,). They are NaN for a signal that is constant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-13
"""A signal that varies by less than this share of its largest value is constant."""


def kurtosis(signals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fourth moment about the mean of ``signals`` (channels, samples) over the squared variance.

    3 for Gaussian noise, 1.5 for a sine, many for a single impact. Of the average it is called kurtosis, of the
    difference signal FM4 (Stewart 1977). Biased by what samples do to moments, as both are defined.
    """
    return _moment(signals, 4)


def fm4(difference: NDArray[np.float64]) -> NDArray[np.float64]:
    """FM4 of the ``difference`` signal (channels, samples): its kurtosis, which a fault of one or two teeth raises.

    Source: Stewart 1977; Vecer, Kreidl and Smid 2005.
    """
    return _moment(difference, 4)


def m6a(difference: NDArray[np.float64]) -> NDArray[np.float64]:
    """M6A of the ``difference`` signal (channels, samples): the sixth moment over the variance cubed; 15 for noise.

    Source: Martin 1989; Vecer, Kreidl and Smid 2005.
    """
    return _moment(difference, 6)


def crest_factor(signals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest magnitude of ``signals`` (channels, samples) over their RMS: the square root of 2 for a sine."""
    unit, size = _unit_rms(signals)
    return np.where(size > 0.0, np.abs(unit).max(axis=1), np.nan)


def fm0(average: NDArray[np.float64], mesh_amplitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """FM0 of the ``average`` (channels, samples): peak to peak over the sum of the peak amplitudes of the gear mesh.

    ``mesh_amplitude`` (channels, harmonics) of the mesh orders, in the unit of the average. 2 for one mesh order and
    nothing else; large where a tooth stands out of the mesh, or the mesh is weak. Source: Stewart 1977.
    """
    total = mesh_amplitude.sum(axis=1)
    span = average.max(axis=1) - average.min(axis=1)
    return np.asarray(np.divide(span, total, out=np.full(len(average), np.nan), where=total > 0.0))


def na4(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """NA4 (channels,) of the last of ``differences`` (records, channels, samples), in the order in which they came.

    The fourth moment of the last record over the squared mean variance of all records so far: it goes on growing as
    damage spreads, where a kurtosis falls back to 3. The signals are differences without sidebands, which Vecer,
    Kreidl and Smid 2005 call residual. Source: Zakrajsek, Townsend and Decker 1993.
    """
    size = np.abs(differences).max(axis=(0, 2), initial=0.0)
    scaled = differences / np.where(size > 0.0, size, 1.0)[None, :, None]
    about_mean = scaled - scaled.mean(axis=2, keepdims=True)
    variance = (about_mean**2).mean(axis=2).mean(axis=0)
    fourth = (about_mean[-1] ** 4).mean(axis=1)
    return np.asarray(np.divide(fourth, variance**2, out=np.full(len(size), np.nan), where=variance > 0.0))


def _moment(signals: NDArray[np.float64], power: int) -> NDArray[np.float64]:
    """Central moment of ``power``, in standard deviations; NaN where all that varies is rounding."""
    unit, size = _unit_rms(signals - signals.mean(axis=1, keepdims=True))
    varies = size > ROUNDING * np.abs(signals).max(axis=1, initial=0.0)
    return np.where(varies, (unit**power).mean(axis=1), np.nan)


def _unit_rms(signals: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``signals`` brought to an RMS of 1, and their largest magnitudes; squares of these may not exist as numbers."""
    size = np.abs(signals).max(axis=1, initial=0.0)
    scaled = signals / np.where(size > 0.0, size, 1.0)[:, None]
    rms = np.sqrt((scaled**2).mean(axis=1))
    return scaled / np.where(rms > 0.0, rms, 1.0)[:, None], size
