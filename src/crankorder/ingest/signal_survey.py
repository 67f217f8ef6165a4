"""One look at all samples of a signal: mean, power and roughness of short blocks, from which faults are told."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from crankorder.ingest.rawfile import FloatArray

Floats = npt.NDArray[np.float64]

_BLOCKS_PER_S = 300.0
_LEAST_BLOCK, _MOST_BLOCK = 4, 128


@dataclass(frozen=True, slots=True)
class Survey:
    """What short blocks of a signal hold: arrays (block,), NaN where a sample is missing.

    ``size`` samples lie in each block; what is left over at the end takes no part. ``variances`` are about the mean of
    the block. A bend is how far a sample lies from the mean of its two neighbours: its mean square and fourth power.
    """

    size: int
    n_samples: int
    means: Floats
    variances: Floats
    bend_squares: Floats
    bend_fourths: Floats


def block_size(rate_hz: float) -> int:
    """Samples per block: a power of two, so few at ``rate_hz`` that the means show twice mains."""
    if not (math.isfinite(rate_hz) and rate_hz > 0.0):
        return 16
    wanted = 1 << math.floor(math.log2(max(rate_hz / _BLOCKS_PER_S, 1.0)))
    return min(max(wanted, _LEAST_BLOCK), _MOST_BLOCK)


def survey(signal: FloatArray, *, size: int) -> Survey:
    """Survey of ``signal`` (sample,) in blocks of ``size`` samples, each read once."""
    told = np.empty((4, signal.size // size))
    _look(signal, size, told)
    return Survey(size, signal.size, *told)


def grouped(values: Floats, group: int) -> Floats:
    """Means of ``group`` neighbours of ``values`` at a time; what is left over at the end takes no part."""
    whole = len(values) // group * group
    made: Floats = values[:whole].reshape(-1, group).mean(axis=1)
    return made


@nb.njit(cache=True, nogil=True, fastmath={"nsz", "reassoc", "contract"})
def _sums(piece):  # type: ignore[no-untyped-def]
    """Sums of what the samples lie above the first, and of its square."""
    first, total, square = piece[0], piece[0] * 0, piece[0] * 0
    for k in range(piece.shape[0]):
        apart = piece[k] - first
        total += apart
        square += apart * apart
    return total, square


@nb.njit(cache=True, nogil=True, fastmath={"nsz", "reassoc", "contract"})
def _bends(piece, half, least):  # type: ignore[no-untyped-def]
    """Sums of the second and the fourth power of the bend, in units of ``least`` so that no fourth power overflows."""
    square = fourth = piece[0] * 0
    for k in range(1, piece.shape[0] - 1):
        bend = (piece[k] - half * (piece[k - 1] + piece[k + 1])) * least
        bend = bend * bend
        square += bend
        fourth += bend * bend
    return square, fourth


@nb.njit(cache=True, nogil=True)
def _look(signal, size, told):  # type: ignore[no-untyped-def]
    half, n = signal.dtype.type(0.5), signal.shape[0]
    for number in range(told.shape[1]):
        start = number * size
        total, square = _sums(signal[start : start + size])
        mean = np.float64(total) / size
        told[0, number] = np.float64(signal[start]) + mean
        variance = np.float64(square) / size - mean * mean
        told[1, number] = variance if not variance < 0.0 else 0.0
        scale = 1.0 / np.sqrt(variance) if variance > 0.0 else 1.0
        square, fourth = _bends(signal[max(start - 1, 0) : min(start + size + 1, n)], half, signal.dtype.type(scale))
        told[2, number] = np.float64(square) / size / scale**2
        told[3, number] = np.float64(fourth) / size / scale**4
