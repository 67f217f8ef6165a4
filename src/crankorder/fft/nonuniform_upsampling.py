"""Signals at a multiple of their rate, right up to the frequencies that are wanted: room for products of tones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba as nb
import numpy as np
from numpy.typing import NDArray

DESIGN_MARGIN_DB = 24.0
"""More than is asked for: four stages add up, short ones miss Kaiser's estimate, and passing a constant exactly moves
the whole ripple to one side. Measured: at most 0.9 of the tolerance."""


@dataclass(frozen=True)
class Upsampling:
    """Half-band stages that multiply the rate by ``factor``; ``taps`` (stages) give the value halfway between samples.

    ``reach`` is the number of samples that are used up at each end; content up to ``pass_share`` of the rate is right.
    """

    factor: int
    pass_share: float
    taps: tuple[NDArray[np.float64], ...]
    reach: int


@lru_cache(maxsize=128)
def upsampling(factor: int, *, pass_share: float, tolerance: float) -> Upsampling:
    """Stages by which content below ``pass_share`` (0 to 0.5) of the sample rate keeps its amplitude to ``tolerance``.

    ``factor`` is a power of two. Each stage is a Kaiser-windowed sinc (Kaiser 1974) of its transition band.
    """
    taps: list[NDArray[np.float64]] = []
    reach, at_factor, share = 0.0, 1, pass_share
    attenuation = max(60.0, -20.0 * np.log10(tolerance)) + DESIGN_MARGIN_DB
    beta = 0.1102 * (attenuation - 8.7)
    while at_factor < factor:
        half = int(np.ceil((attenuation - 7.95) / (2.285 * 2.0 * np.pi * (1.0 - 2.0 * share)) / 2.0)) + 1
        offset = np.arange(2 * half) - half + 0.5
        kernel = np.sinc(offset) * np.i0(beta * np.sqrt(1.0 - (offset / half) ** 2)) / np.i0(beta)
        taps.append(kernel / kernel.sum())
        reach += (half - 1) / at_factor
        at_factor *= 2
        share /= 2.0
    return Upsampling(factor, pass_share, tuple(taps), int(np.ceil(reach)))


@nb.njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz", "arcp"})
def _dot(segment, taps):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(taps.size):
        total += segment[j] * taps[j]
    return total


@nb.njit(cache=True, nogil=True)
def _doubled(signals, taps, out):  # type: ignore[no-untyped-def]
    half = taps.size // 2
    between = out.shape[1] // 2
    for c in range(signals.shape[0]):
        for i in range(between):
            out[c, 2 * i] = signals[c, half - 1 + i]
            out[c, 2 * i + 1] = _dot(signals[c, i : i + 2 * half], taps)
        out[c, 2 * between] = signals[c, half - 1 + between]


def upsampled(
    signals: NDArray[np.floating], plan: Upsampling, *, first: int, last: int
) -> tuple[NDArray[np.float64], int]:
    """Values (channels, many) ``plan.factor`` times as dense from sample ``first`` to ``last``, and where these begin.

    ``signals`` (channels, samples) hold ``plan.reach`` samples more at each end; the second result is the index of
    sample ``first`` among the values. The first result is float64.
    """
    current = signals[:, first - plan.reach : last + 1 + plan.reach].astype(np.float64)
    begin = plan.reach
    for taps in plan.taps:
        half = len(taps) // 2
        out = np.empty((len(current), 2 * (current.shape[1] - 2 * half + 1) + 1))
        _doubled(current, taps, out)
        current, begin = out, 2 * (begin - half + 1)
    return current, begin
