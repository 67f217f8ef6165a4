"""Exponent, law, largest and mean amplitude: intervals hold the truth as often as they say."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.found import OrderLine
from crankorder.identify.lines.growth import growth, largest, mean_level, visible_range_rpm

SPEEDS = np.linspace(300.0, 2000.0, 35)


def line_of(rng, true, *, speed=SPEEDS, relative=0.03, freedom=24.0):
    """A line of ``true`` amplitudes at ``speed``, measured with errors that are themselves measured."""
    error = relative * true * rng.uniform(0.5, 2.0, len(true))
    seen = np.abs(true + error * (rng.standard_normal(len(true)) + 1j * rng.standard_normal(len(true))))
    stated = error * np.sqrt(rng.chisquare(freedom, len(true)) / freedom)
    at, known, none = np.arange(len(true)), np.full(len(true), freedom), np.zeros(len(true))
    return OrderLine("A", 5.5, 1e-4, at, speed, seen, stated, known, none, "locked to the shaft", 20.0)


@pytest.mark.parametrize(("exponent", "count"), [(0.0, 35), (1.0, 4)])
def test_the_intervals_of_exponent_and_mean_level_hold_them_as_often_as_they_say(exponent, count):
    rng, speed, inside = np.random.default_rng(12), np.linspace(400.0, 2000.0, count), []
    for _ in range(250):
        line = line_of(rng, (speed / 1000.0) ** exponent, speed=speed)
        low, high = growth(line).ci95
        level = mean_level(line)
        inside.append((low <= exponent <= high, exponent != 0.0 or level.low <= 1.0 <= level.high))
    assert np.all(np.mean(inside, axis=0) >= 0.93) and np.mean(inside, axis=0)[0] <= 0.985


def test_laws_are_named_but_of_three_speeds_or_of_speeds_within_a_tenth():
    rng = np.random.default_rng(1)
    assert growth(line_of(rng, np.ones(35))).law == "keeps its size"
    assert growth(line_of(rng, (SPEEDS / 1000.0) ** 2)).law == "grows with speed^n"
    for exponent, speed in ((0.0, SPEEDS[:3]), (0.0, np.full(5, 900.0)), (2.0, np.linspace(2800.0, 3050.0, 12))):
        assert growth(line_of(rng, (speed / 2800.0) ** exponent, speed=speed, relative=0.002)) is None


def test_scatter_beyond_the_errors_is_not_called_steady():
    rng = np.random.default_rng(2)
    made = [growth(line_of(rng, np.exp(0.4 * rng.standard_normal(35)), relative=0.02)) for _ in range(40)]
    assert "keeps its size" not in {found.law for found in made}
    assert np.median([found.scatter for found in made]) == pytest.approx(0.4, abs=0.1)


def test_a_narrow_resonance_does_not_make_the_law_and_is_told():
    rng = np.random.default_rng(3)
    true = (SPEEDS / 1000.0) ** 2 * (1.0 + 6.0 * np.exp(-(((SPEEDS - 1300.0) / 60.0) ** 2)))
    found = growth(line_of(rng, true))
    assert found.law == "grows with speed^n"
    assert found.exponent == pytest.approx(2.0, abs=0.05)
    assert 1300.0 in found.deviating_rpm and set(found.deviating_rpm) <= set(SPEEDS[(SPEEDS > 1100) & (SPEEDS < 1500)])


def test_one_speed_has_students_interval_and_its_range():
    line = line_of(np.random.default_rng(5), np.ones(1), speed=np.array([900.0]))
    found = largest(line)
    assert found.high - found.low == pytest.approx(2 * 2.063899 * float(line.amplitude_error[0]), rel=1e-4)
    assert visible_range_rpm(line) == (900.0, 900.0)


def test_an_exact_amplitude_has_no_width_and_an_unknown_one_no_end():
    line = line_of(np.random.default_rng(6), np.ones(2), speed=np.array([900.0, 950.0]), relative=0.0)
    assert largest(line).low == largest(line).high == 1.0
    unknown = largest(replace(line, amplitude_error=np.full(2, np.inf)))
    assert (unknown.low, unknown.high) == (0.0, np.inf)
