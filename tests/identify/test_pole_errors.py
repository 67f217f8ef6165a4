"""What disagreeing orders add to the error of a pole, and how its interval carries an unknown damping."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.found import Mode
from crankorder.identify.intervals import Z95, ratio_interval
from crankorder.identify.modes.pole_errors import Cell, disagreement

pytestmark = pytest.mark.slow


def _cells(values: list[float], weight: float = 1.0) -> tuple[list[Cell], np.ndarray, np.ndarray]:
    """Cells that ask for ``values`` of one parameter, as of their mean, with the same weight each."""
    off = np.array(values) - np.mean(values)
    cells = [Cell(np.full((1, 1), weight), np.full(1, weight * one)) for one in off]
    total = weight * len(values)
    return cells, np.full((1, 1), 1.0 / total), np.full(1, 1.0 / total)


def test_intervals_of_cells_that_differ_cover_their_mean() -> None:
    rng = np.random.default_rng(7)
    covered = 0
    for _ in range(2000):
        values = rng.normal(0.0, 4.0, 5).tolist()
        covered += abs(np.mean(values)) <= Z95 * np.sqrt(1.0 / 5.0) * disagreement(*_cells(values))[0]
    assert 0.92 < covered / 2000 < 0.98


def test_a_damping_ratio_errs_by_a_factor() -> None:
    low, high = ratio_interval(0.02, 0.01)
    assert low > 0.0
    assert low * high == pytest.approx(0.02**2)
    assert ratio_interval(0.02, 0.5, most=1.0)[1] == 1.0
    assert ratio_interval(0.02, 1e-4) == pytest.approx([0.02 - Z95 * 1e-4, 0.02 + Z95 * 1e-4], rel=1e-4)


def test_where_the_damping_is_not_known_the_error_of_the_frequency_is_not() -> None:
    known = Mode(100.0, 0.1, 0.01, 1e-4, ("X",), 10.0, "")
    unknown = Mode(100.0, 0.1, 0.01, 0.02, ("X",), 10.0, "")
    assert known.frequency_half_hz == pytest.approx(Z95 * 0.1, rel=1e-2)
    assert unknown.frequency_half_hz > 10.0 * 0.1
