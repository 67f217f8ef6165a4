"""Growth from run to run: exact for two runs, honest about scatter, and undecided where nothing can be told."""

from __future__ import annotations

import math

import numpy as np
import pytest

from crankorder.engine.bearings import Bearing
from crankorder.errors import RequestError
from crankorder.identify.bearings.records import bearing_records
from crankorder.identify.changes.run_trends import kendall_p_value, run_amplitudes, trend
from crankorder.orders.envelope import envelope_map, recording_envelope
from crankorder.settings import load_settings
from made.strikes import strikes
from made.typed import as_dicts

bearing_records = as_dicts(bearing_records)

SETTINGS = load_settings()


def of(found, **more):
    return trend(found.amplitudes, found.errors, freedom=found.freedom, **more)


def test_two_runs_are_compared_by_their_errors_alone():
    # ln 1.5 = 0.4055; its standard error is 0.05 sqrt 2
    found = trend([1.0, 1.5], [0.05, 0.075])
    half = 1.959964 * 0.05 * math.sqrt(2.0)
    assert found.growth_per_run == pytest.approx(0.5)
    assert found.growth_ci95 == pytest.approx((1.5 * math.exp(-half) - 1.0, 1.5 * math.exp(half) - 1.0), rel=1e-6)
    assert found.change == "grows"
    assert "failing" in found.verdict
    assert trend([1.0, 1.05], [0.05, 0.05]).change == "not decided"
    assert trend([1.5, 1.0], [0.05, 0.05]).change == "shrinks"


def test_first_and_last_of_five_runs_give_the_growth_per_run():
    found = trend([1.0, 1.5**4], [0.01, 0.05], runs=[0, 4])
    assert found.growth_per_run == pytest.approx(0.5)
    assert found.change == "grows"


def test_growth_is_found_in_ranks_where_no_error_is_known():
    assert trend([1.0, 1.1, 1.3, 1.2, 1.5, 1.9]).change == "grows"
    assert trend([1.0, 1.1, 1.3]).change == "not decided"
    assert trend([1.0, 1.2]).p_value == 0.5
    assert trend([1.0]).change == "not decided"


@pytest.mark.slow
def test_what_the_ranks_say_and_their_interval_agree():
    # one outlier: a straight line through the logarithms would be anywhere from falling to rising
    found = trend([1.0, 1.01, 1.02, 1.03, 100.0])
    assert found.change == "grows" and found.growth_ci95[0] > 0.0
    chance = np.random.default_rng(5)
    inside = 0
    for _ in range(1000):
        amplitudes = 1.2 ** np.arange(6) * np.exp(0.3 * chance.standard_normal(6))
        found = trend(amplitudes)
        low, high = found.growth_ci95
        inside += low <= 0.2 <= high
        assert (found.change == "grows") == (low > 0.0) and (found.change == "shrinks") == (high < 0.0)
    assert inside / 1000 >= 0.95
    few = trend([1.0, 2.0, 4.0])
    assert few.growth_ci95 == (-1.0, math.inf) and "too few" in few.verdict


def test_the_chance_of_a_rising_sequence_is_one_over_its_permutations():
    assert kendall_p_value(np.arange(5.0)) == pytest.approx(1.0 / 120.0)
    assert kendall_p_value(np.arange(5.0)[::-1]) == pytest.approx(1.0)
    # of the six sequences of three, three rise in two or more pairs
    assert kendall_p_value(np.array([1.0, 3.0, 2.0])) == pytest.approx(0.5)


@pytest.mark.cases(1)
@pytest.mark.parametrize("n_runs", [2, 3, 5])
def test_the_interval_covers_the_growth_and_steady_runs_are_rarely_called_growing(n_runs):
    chance = np.random.default_rng(n_runs)
    inside = growing = 0
    for _ in range(2000):
        amplitudes = 1.2 ** np.arange(n_runs) * np.exp(0.05 * chance.standard_normal(n_runs))
        low, high = trend(amplitudes, 0.05 * amplitudes).growth_ci95
        inside += low <= 0.2 <= high
        steady = np.exp(0.05 * chance.standard_normal(n_runs))
        growing += trend(steady, 0.05 * steady).change == "grows"
    assert inside / 2000 >= 0.93
    assert growing / 2000 <= 0.035


def test_runs_that_scatter_more_than_their_errors_say_widen_the_interval():
    amplitudes = np.array([1.0, 2.0, 0.9, 2.2])
    assert trend(amplitudes, 0.01 * amplitudes).change == "not decided"


def test_amplitudes_that_are_none_are_refused():
    for asked in (([1.0, 0.0], [0.1, 0.1]), ([1.0, np.nan], None), ([1.0, 2.0], [0.1]), ([1.0, 2.0], [0.1, -0.1])):
        with pytest.raises(RequestError):
            trend(*asked)
    with pytest.raises(RequestError):
        trend([1.0, 2.0], [0.1, 0.1], runs=[1, 1])


def test_damage_that_grows_by_half_a_run_is_followed_through_the_envelopes():
    bearing = Bearing(name="jack shaft", shaft_ratio=0.5, rolling_elements=11, ball_over_pitch=0.2)
    order = 2.2 * 0.992
    runs = []
    for run in range(4):
        made = [
            strikes(order=order, size=4.0 * 1.5**run, speed_rpm=rpm, seed=10 * run + k, jitter=0.005)
            for k, rpm in enumerate((1500.0, 2000.0))
        ]
        items = [recording_envelope(*one, settings=SETTINGS.orders) for one in made]
        runs.append(envelope_map(items, speed_bin_rpm=25.0))
    for one in runs:
        found = bearing_records((), one, bearings=(bearing,), revs_per_cycle=2, settings=SETTINGS.identify)
        assert found[0]["line"] == "BPFO"
        assert found[0]["slip_percent_ci95"][0] < 0.8 < found[0]["slip_percent_ci95"][1]
    growth = of(run_amplitudes(runs, order=order))
    assert growth.change == "grows"
    assert growth.growth_ci95[0] < 0.5 < growth.growth_ci95[1]
    ends = of(run_amplitudes([runs[0], runs[3]], order=order), runs=[0, 3])
    assert ends.change == "grows"
    assert ends.growth_ci95[0] < 0.5 < ends.growth_ci95[1]
    again = of(run_amplitudes([runs[2], runs[2]], order=order))
    assert again.change == "not decided"
    assert run_amplitudes(runs, order=7.37).amplitudes.size == 0
