"""Half widths of intervals: those of the tables, and of the normal distribution where freedom has no end."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from crankorder.identify.intervals import Z95, error_of, half_width, half_widths, interval, positive_interval
from crankorder.identify.speeds.crossings import crossings
from crankorder.settings import load_settings
from made.found_lines import agreed, fit, mode

SETTINGS = load_settings().identify


def test_half_widths_are_those_of_the_tables():
    # Student (1908) as in every table: 97.5 % points for 1, 2, 10 and 30 degrees of freedom, 99.95 % for 4
    known = {1.0: 12.7062, 2.0: 4.3027, 10.0: 2.2281, 30.0: 2.0423}
    for freedom, expected in known.items():
        assert half_width(freedom) == pytest.approx(expected, abs=5e-5)
    assert half_width(4.0, level=0.999) == pytest.approx(8.6103, abs=5e-5)
    np.testing.assert_allclose(half_widths(np.array(list(known))), list(known.values()), atol=5e-5)


def test_endless_freedom_is_normal_and_unknown_freedom_is_the_least():
    assert pytest.approx(1.959964, abs=1e-6) == Z95
    assert half_width(np.inf) == pytest.approx(Z95, rel=1e-5)
    assert half_width(np.nan) == half_width(0.0) == half_width(1.0)
    assert half_widths(np.array([np.inf, np.nan])).tolist() == [half_width(np.inf), half_width(1.0)]


def test_an_interval_cut_off_at_zero_still_tells_its_error():
    low, high = interval(0.001, 0.002)
    assert error_of(0.001, [low, high]) == pytest.approx(0.002, rel=1e-5)
    assert error_of(0.001, [max(0.0, low), high]) == pytest.approx(0.002, rel=1e-5)


def test_the_interval_of_a_positive_quantity_stays_above_zero():
    assert positive_interval(50.0, 2.0) == (48.0, 52.0)
    low, high = positive_interval(50.0, 70.0)
    assert 0.0 < low < 1e-12 and high == 120.0


@pytest.mark.parametrize("error_hz", [0.1, 30.0, 400.0])
def test_a_frequency_that_is_hardly_known_and_the_speeds_at_which_orders_meet_it_are_positive(error_hz):
    vague = dataclasses.replace(mode(40.0), frequency_error_hz=error_hz, damping_error=0.01)
    assert vague.frequency_ends[0] > 0.0
    met = crossings(
        (agreed(1.0, lock="slips", error=0.4),), fit(vague), speed_rpm=(600.0, 3000.0), stated=(3.0,), settings=SETTINGS
    )
    assert len(met) == 2
    assert all(one.rpm_ci95[0] > 0.0 and one.mode_hz_ci95[0] > 0.0 for one in met)
