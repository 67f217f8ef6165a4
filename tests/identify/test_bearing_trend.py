"""Growth from run to run: exact for two runs, honest about scatter, and undecided where nothing can be told."""

import numpy as np
import pytest

from crankorder.engine.machine_parts import Bearing
from crankorder.identify.bearing_records import bearing_records
from crankorder.identify.order_changes import RunAmplitudes, growth_over, run_amplitudes
from crankorder.orders.envelope import envelope_map, recording_envelope
from crankorder.settings import load_settings
from made.strikes import strikes
from made.typed import as_dicts

bearing_records = as_dicts(bearing_records)

SETTINGS = load_settings()


def growth(amplitudes, errors):
    return growth_over(RunAmplitudes(np.array(amplitudes), np.array(errors)))


def undecided(growth):
    return growth.ci95[0] < 0.0 < growth.ci95[1]


def test_two_runs_are_compared_by_their_errors_alone():
    # ln 1.5 = 0.4055; its standard error is 0.05 sqrt 2
    rise = growth([1.0, 1.5], [0.05, 0.075])
    half = 1.959964 * 0.05 * np.sqrt(2.0)
    assert rise.per_run == pytest.approx(0.5)
    assert rise.ci95 == pytest.approx((1.5 * np.exp(-half) - 1.0, 1.5 * np.exp(half) - 1.0), rel=1e-6)
    assert undecided(growth([1.0, 1.05], [0.05, 0.05]))
    assert growth([1.5, 1.0], [0.05, 0.05]).ci95[1] < 0.0


@pytest.mark.cases(1)
@pytest.mark.parametrize("n_runs", [2, 3, 5])
def test_the_interval_covers_the_growth_and_steady_runs_are_rarely_called_growing(n_runs):
    chance = np.random.default_rng(n_runs)
    inside = growing = 0
    for _ in range(2000):
        amplitudes = 1.2 ** np.arange(n_runs) * np.exp(0.05 * chance.standard_normal(n_runs))
        low, high = growth(amplitudes, 0.05 * amplitudes).ci95
        inside += low <= 0.2 <= high
        steady = np.exp(0.05 * chance.standard_normal(n_runs))
        growing += growth(steady, 0.05 * steady).ci95[0] > 0.0
    assert inside / 2000 >= 0.93
    assert growing / 2000 <= 0.035


def test_runs_that_scatter_more_than_their_errors_say_widen_the_interval():
    amplitudes = np.array([1.0, 2.0, 0.9, 2.2])
    assert undecided(growth(amplitudes, 0.01 * amplitudes))


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
    every = growth_over(run_amplitudes(runs, order=order))
    assert 0.0 < every.ci95[0] < 0.5 < every.ci95[1]
    ends = growth_over(run_amplitudes([runs[0], runs[3]], order=order))
    assert 0.0 < ends.ci95[0] < 1.5**3 - 1.0 < ends.ci95[1]
    assert undecided(growth_over(run_amplitudes([runs[2], runs[2]], order=order)))
    assert run_amplitudes(runs, order=7.37).amplitudes.size == 0
