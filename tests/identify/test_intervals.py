"""Half widths of intervals: those of the tables, and of the normal distribution where freedom has no end."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import false_discovery_control, norm

from crankorder.identify.crossings import crossings
from crankorder.orders.intervals import Z95, adjusted, claimed, error_of, half_width, half_widths, interval, simes
from made.found_lines import agreed, fit, mode
from made.shipped import IDENTIFY


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


@pytest.mark.parametrize("error_hz", [0.1, 30.0, 400.0])
def test_a_frequency_that_is_hardly_known_and_the_speeds_at_which_orders_meet_it_are_positive(error_hz):
    vague = dataclasses.replace(mode(40.0), frequency_error_hz=error_hz, damping_error=0.01)
    assert vague.frequency_ends[0] > 0.0
    met = crossings(
        (agreed(1.0, lock="slips", error=0.4),), fit(vague), speed_rpm=(600.0, 3000.0), stated=(3.0,), settings=IDENTIFY
    )
    assert len(met) == 2
    assert all(crossing.ends_rpm[0] > 0.0 and crossing.finding.mode_hz_ci95[0] > 0.0 for crossing in met)


# Claims among many comparisons: the published procedure, and its promise where nothing or something differs.


# Benjamini, Hochberg (1995), section 4.1: fifteen p-values, four of which are claimed at 0.05
PUBLISHED = [
    0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0,
]  # fmt: skip
Q = 0.05


def test_the_published_example_claims_four():
    assert claimed(np.array(PUBLISHED[::-1]), q=Q)[::-1].tolist() == [True] * 4 + [False] * 11


def test_an_independent_program_adjusts_alike():
    values = np.random.default_rng(1).random((20, 30)) ** 3
    expected = false_discovery_control(values.ravel(), method="bh").reshape(values.shape)
    np.testing.assert_allclose(adjusted(values), expected, rtol=1e-12)


def test_what_was_not_compared_is_never_claimed_and_does_not_count():
    values = np.array([0.001, np.nan, 0.04, np.nan])
    assert claimed(values, q=Q).tolist() == [True, False, True, False]
    assert not claimed(np.full(3, np.nan), q=Q).any()
    assert np.isnan(simes(np.array([np.nan])))


def _neighbours(rng, shape):
    """Normal numbers that correlate as the bins of a Hann window do: 2/3 and 1/6 with the next two."""
    white = rng.standard_normal((*shape[:-1], shape[-1] + 2))
    return (white[..., :-2] * 0.5 + white[..., 1:-1] + white[..., 2:] * 0.5) / np.sqrt(1.5)


def test_where_nothing_differs_anything_is_claimed_as_rarely_as_stated():
    rng, n = np.random.default_rng(2), 4000
    p_values = 2 * norm.sf(np.abs(_neighbours(rng, (n, 200))))
    share = np.mean([claimed(row, q=Q).any() for row in p_values])
    assert share <= Q + 3 * np.sqrt(Q * (1 - Q) / n)
    assert share > 0.5 * Q  # nor is power given away
    chance = np.array([simes(row) for row in p_values])
    assert np.mean(chance <= Q) == pytest.approx(share)
