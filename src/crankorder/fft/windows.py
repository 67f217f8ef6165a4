"""Windows and what they do to a tone and to noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.quantities import Floats

TERMS = {
    "hann": (0.5, 0.5),
    "blackman-harris": (0.35875, 0.48829, 0.14128, 0.01168),
    "flat-top": (1.0, 1.96760033, 1.57983607, 0.81123644, 0.22583558, 0.02773848, 0.00090360),
    "rectangular": (1.0,),
}
"""Windows that are sums of cosines with alternating signs.

Blackman-Harris: side lobes below -92 dB (Harris 1978, table 1). Flat-top: HFT144D of Heinzel, Rüdiger and Schilling
(2002, appendix D), flat within 0.0021 dB, side lobes below -144 dB.
"""

WIDEST_LOBE_BINS = 16
"""Half width of main lobes that are looked at: a Kaiser window of beta 45 has one as wide."""

LEAST, LARGEST = -1021, 1023
"""Exponents of two between which both the power and its inverse are normal numbers, or nearly so."""


@dataclass(frozen=True)
class Window:
    """A window of ``values`` (samples,) with its ``name``; its sums give the scalings of a spectrum."""

    name: str
    values: Floats

    @property
    def tone_scale(self) -> float:
        """Factor that turns the magnitude of a one-sided spectrum into the peak amplitude of a tone on a bin."""
        return 2.0 / float(self.values.sum())

    @property
    def enbw_bins(self) -> float:
        """Equivalent noise bandwidth in bins (Harris 1978, eq. 11): 1.5 for a Hann window."""
        values = self.values
        return float(len(values) * (values @ values) / values.sum() ** 2)

    def response(self, offset_bins: Floats) -> Floats:
        """Share, 0 to 1, of a tone's amplitude in a bin from which the tone lies ``offset_bins`` (any shape) away."""
        n = len(self.values)
        centred = (np.arange(n) - 0.5 * n) / n
        turned = np.exp(-2j * np.pi * np.outer(np.asarray(offset_bins, dtype=np.float64), centred))
        return np.asarray(np.abs(turned @ self.values) / self.values.sum())

    @cached_property
    def tone_weights(self) -> tuple[float, float]:
        """Weight of a bin's power and of each of its neighbours' in the power of a tone.

        With these a tone within half a bin reads alike on the bin and between bins, and right in the middle of what
        remains: within 0.008 dB for a Hann window (from the energy of the three bins alone: 0.09 dB). A window that is
        flat within 0.005 dB needs no neighbours.
        """
        offset = np.linspace(0.0, 0.5, 17)
        near, left, right = (self.response(offset + shift) ** 2 for shift in (0.0, 1.0, -1.0))
        neighbours = 0.0
        if near[0] / near[-1] > 10.0**0.001:
            neighbours = float((near[0] - near[-1]) / (left[-1] + right[-1] - left[0] - right[0]))
        total = near + neighbours * (left + right)
        middle = float(np.sqrt(total.min() * total.max()))
        return 1.0 / middle, neighbours / middle

    def independent_frames(self, hop_samples: int, n_frames: int, *, power: bool) -> float:
        """Independent frames that ``n_frames`` overlapping ones, ``hop_samples`` apart, are worth in an average.

        ``power`` averages squares, which correlate by the square of the frames' correlation (Welch 1967, eq. 18);
        otherwise complex spectra are averaged.
        """
        energy = float(self.values @ self.values)
        factor = 1.0
        for lag in range(1, n_frames):
            shift = lag * hop_samples
            if shift >= len(self.values):
                break
            correlation = float(self.values[shift:] @ self.values[:-shift]) / energy
            factor += 2.0 * (1.0 - lag / n_frames) * (correlation**2 if power else correlation)
        return n_frames / factor


def hann(n_samples: int) -> Window:
    """Periodic Hann window of ``n_samples``: a tone on a bin reaches only its two neighbours."""
    return _cosines("hann", n_samples)


@lru_cache(maxsize=32)
def window_named(name: str, n_samples: int, *, kaiser_beta: float = 14.0) -> Window:
    """Periodic window ``name`` of ``n_samples``, one of TERMS or ``kaiser`` (Kaiser 1974), whose largest value is 1.

    ``kaiser_beta``, 0 or more and without unit, is the shape of ``kaiser``: more lowers its side lobes. Raises
    ValueError for another name.
    """
    if name == "kaiser":
        return Window("kaiser", np.kaiser(n_samples + 1, kaiser_beta)[:-1])
    if name not in TERMS:
        raise ValueError(f"no window is called {name!r}: {', '.join([*TERMS, 'kaiser'])}")
    return _cosines(name, n_samples)


def _cosines(name: str, n_samples: int) -> Window:
    phase = 2.0 * np.pi * np.arange(n_samples) / n_samples
    values = sum((-1) ** k * term * np.cos(k * phase) for k, term in enumerate(TERMS[name]))
    return Window(name, np.asarray(values / sum(TERMS[name])))


def power_of_two(values: NDArray[Any]) -> Floats:
    """Power of two (channels, 1, …) next above the largest magnitude of each channel, 2 where that is 0 or unknown.

    ``values`` (channels, …) are real or complex, in any unit; NaN is left out. The power has exponents from LEAST to
    LARGEST.
    """
    axes = tuple(range(1, values.ndim))
    if np.iscomplexobj(values):
        largest = np.abs(np.nan_to_num(values)).max(axis=axes, keepdims=True, initial=0.0)
    else:
        high, low = (bound.reduce(values, axis=axes, keepdims=True, initial=0.0) for bound in (np.fmax, np.fmin))
        largest = np.maximum(high, -low)
    exponent = np.frexp(np.where(largest > 0.0, largest, 1.0))[1]
    return np.asarray(np.ldexp(1.0, np.clip(exponent, LEAST, LARGEST)))
