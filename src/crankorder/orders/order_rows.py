"""Amplitude, phase and intervals of one order in all channels, row by row."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from crankorder.quantities import Bools, Floats, Ints


@dataclass(frozen=True)
class OrderRows:
    """One order in all channels by row: peak amplitude, phase [degree], standard error, degrees of freedom, 95 % ends.

    Each (channels, rows), NaN (0 degrees of freedom) where nothing is known; the phase where there is no mark.
    """

    amplitude: Floats
    phase: Floats
    standard_error: Floats
    degrees_of_freedom: Floats
    amplitude_low: Floats
    amplitude_high: Floats
    phase_ci95: Floats

    @classmethod
    def nothing(cls, n_channels: int, n_rows: int) -> OrderRows:
        """Rows in which nothing is known: ``n_rows`` of them in ``n_channels`` channels."""
        given = [np.full((n_channels, n_rows), np.nan) for _ in fields(cls)]
        given[3] = np.zeros((n_channels, n_rows))
        return cls(*given)

    def of(self, which: Ints | Bools) -> OrderRows:
        """Those of the rows that ``which`` picks."""
        return OrderRows(*(getattr(self, item.name)[:, which] for item in fields(self)))

    def beside(self, other: OrderRows) -> OrderRows:
        """These rows, then those of ``other``."""
        names = [item.name for item in fields(self)]
        return OrderRows(*(np.concatenate([getattr(self, name), getattr(other, name)], axis=1) for name in names))
