"""Windows and what they do to a tone and to noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Window:
    """A window of ``values`` (samples,) with its name; its sums give the scalings of a spectrum."""

    name: str
    values: NDArray[np.float64]

    @property
    def tone_scale(self) -> float:
        """Factor that turns the magnitude of a one-sided spectrum into the peak amplitude of a tone on a bin."""
        return 2.0 / float(self.values.sum())

    @property
    def enbw_bins(self) -> float:
        """Equivalent noise bandwidth in bins (Harris 1978, eq. 11): 1.5 for a Hann window."""
        values = self.values
        return float(len(values) * (values @ values) / values.sum() ** 2)

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
    return Window("hann", 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n_samples) / n_samples))
