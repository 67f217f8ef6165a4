"""Exponent, law, largest and mean amplitude: intervals hold the truth as often as they say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from crankorder.identify.found import OrderLine
from crankorder.identify.lines.growth import growth, largest, mean_level, visible_range_rpm

SPEEDS = np.linspace(300.0, 2000.0, 35)


def line_of(rng: np.random.Generator, true: np.ndarray, *, speed=SPEEDS, relative: float = 0.03, freedom: float = 24.0):
    """A line of ``true`` amplitudes at ``speed``, measured with errors that are themselves measured."""
    error = relative * true * rng.uniform(0.5, 2.0, len(true))
    seen = np.abs(true + error * (rng.standard_normal(len(true)) + 1j * rng.standard_normal(len(true))))
    stated = error * np.sqrt(rng.chisquare(freedom, len(true)) / freedom)
    n = len(true)
    known = np.full(n, freedom)
    return OrderLine("A", 5.5, 1e-4, np.arange(n), speed, seen, stated, known, np.zeros(n), "locked to the shaft", 20.0)


def coverage(inside: Callable[[np.random.Generator], bool], n: int) -> float:
    rng = np.random.default_rng(12)
    return sum(inside(rng) for _ in range(n)) / n


@pytest.mark.cases(2)
@pytest.mark.parametrize(("exponent", "count"), [(0.0, 35), (2.0, 35), (2.0, 8), (1.0, 4)])
def test_the_interval_of_the_exponent_holds_it_as_often_as_it_says(exponent: float, count: int) -> None:
    speed = np.linspace(400.0, 2000.0, count)

    def inside(rng: np.random.Generator) -> bool:
        low, high = growth(line_of(rng, (speed / 1000.0) ** exponent, speed=speed)).ci95
        return low <= exponent <= high

    assert 0.93 <= coverage(inside, 400) <= 0.985


@pytest.mark.cases(1)
@pytest.mark.parametrize("exponent", [2.0, 0.5, 0.0])
def test_the_interval_of_the_largest_amplitude_holds_that_of_its_speed(exponent: float) -> None:
    true = (SPEEDS / 1000.0) ** exponent

    def inside(rng: np.random.Generator) -> bool:
        found = largest(line_of(rng, true))
        return found.low <= true[found.at] <= found.high

    assert 0.93 <= coverage(inside, 2000) <= 0.97


@pytest.mark.slow
def test_the_interval_of_the_mean_level_holds_it() -> None:
    def inside(rng: np.random.Generator) -> bool:
        found = mean_level(line_of(rng, np.ones(35)))
        return found.low <= 1.0 <= found.high

    assert 0.93 <= coverage(inside, 400) <= 0.985


def test_laws_are_named() -> None:
    rng = np.random.default_rng(1)
    assert growth(line_of(rng, np.ones(35))).law == "keeps its size"
    assert growth(line_of(rng, (SPEEDS / 1000.0) ** 2)).law == "grows with speed^n"


@pytest.mark.slow
def test_scatter_beyond_the_errors_is_not_called_steady() -> None:
    rng = np.random.default_rng(2)
    made = [growth(line_of(rng, np.exp(0.4 * rng.standard_normal(35)), relative=0.02)) for _ in range(40)]
    assert "keeps its size" not in {found.law for found in made}
    assert np.median([found.scatter for found in made]) == pytest.approx(0.4, abs=0.1)


def test_a_narrow_resonance_does_not_make_the_law_and_is_told() -> None:
    rng = np.random.default_rng(3)
    true = (SPEEDS / 1000.0) ** 2 * (1.0 + 6.0 * np.exp(-(((SPEEDS - 1300.0) / 60.0) ** 2)))
    found = growth(line_of(rng, true))
    assert found.law == "grows with speed^n"
    assert found.exponent == pytest.approx(2.0, abs=0.05)
    assert 1300.0 in found.deviating_rpm and set(found.deviating_rpm) <= set(SPEEDS[(SPEEDS > 1100) & (SPEEDS < 1500)])


def test_three_speeds_or_one_tell_no_law() -> None:
    rng = np.random.default_rng(4)
    assert growth(line_of(rng, np.ones(3), speed=SPEEDS[:3])) is None
    assert growth(line_of(rng, np.ones(5), speed=np.full(5, 900.0))) is None


def test_one_speed_has_students_interval_and_its_range() -> None:
    line = line_of(np.random.default_rng(5), np.ones(1), speed=np.array([900.0]))
    found = largest(line)
    assert found.high - found.low == pytest.approx(2 * 2.063899 * float(line.amplitude_error[0]), rel=1e-4)
    assert visible_range_rpm(line) == (900.0, 900.0)


@pytest.mark.slow
def test_an_exact_amplitude_has_no_width_and_an_unknown_one_no_end() -> None:
    line = line_of(np.random.default_rng(6), np.ones(2), speed=np.array([900.0, 950.0]), relative=0.0)
    assert largest(line).low == largest(line).high == 1.0
    line.amplitude_error[:] = np.inf
    assert (largest(line).low, largest(line).high) == (0.0, np.inf)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_speeds_within_a_tenth_are_one_and_tell_no_growth(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speed = np.linspace(2800.0, 2800.0 * rng.uniform(1.001, 1.09), 12)
    for exponent in (0.0, 2.0):
        assert growth(line_of(rng, (speed / 2800.0) ** exponent, speed=speed, relative=0.002)) is None
