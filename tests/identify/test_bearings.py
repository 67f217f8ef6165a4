"""Bearing lines in orders and envelopes: named with slip and interval, told from what keeps step, and not made up."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.engine.machine_parts import Bearing, bearing_orders
from crankorder.identify.bearing_records import bearing_records, races_words
from crankorder.identify.order_changes import RunAmplitudes, run_amplitudes, trend_over
from crankorder.orders.envelope import envelope_map, recording_envelope
from made.found_lines import agreed, line
from made.shipped import SETTINGS
from made.strikes import recording, strikes
from made.typed import as_dicts

bearing_records = as_dicts(bearing_records)

NINE = Bearing(name="drive end", designation="6205-2RS")
JACK = Bearing(name="jack shaft", shaft_ratio=0.5, rolling_elements=11, ball_over_pitch=0.2)
ORDERS = bearing_orders(NINE)


def records(orders=(), envelope=None, *, bearings=(NINE,), revs_per_cycle=1):
    given = {"revs_per_cycle": revs_per_cycle, "settings": SETTINGS.identify}
    return bearing_records(tuple(orders), envelope, bearings=bearings, **given)


def map_of(*made):
    return envelope_map([recording_envelope(*one, settings=SETTINGS.orders) for one in made], speed_bin_rpm=25.0)


def struck(shown, *, slip_percent, seed, size, **more):
    order = shown * (1.0 - slip_percent / 100.0)
    return map_of(*(strikes(order=order, size=size, speed_rpm=rpm, seed=seed, **more) for rpm in (1500.0, 2000.0)))


@pytest.mark.parametrize(
    ("name", "times", "modulated_by"), [("BPFO", 1, None), ("BPFI", 1, 1.0), ("BSF", 2, 0.398), ("FTF", 1, None)]
)
def test_each_damaged_part_is_named_with_its_slip_inside_the_interval(name, times, modulated_by):
    made = struck(times * ORDERS[name], slip_percent=0.8, seed=times, size=8.0, modulated_by=modulated_by)
    first = records(envelope=made)[0]
    assert (first["line"], first["seen_in"]) == (name, "envelope")
    assert first["order_expected"] == pytest.approx(times * ORDERS[name])
    for key, value in (("slip_percent_ci95", 0.8), ("order_ci95", first["order"]), ("band_hz", 3200.0)):
        assert first[key][0] < value < first[key][1]
    assert first["harmonics"] >= 2 and "Damage of" in first["verdict"]
    assert modulated_by is None or first["sidebands"] == pytest.approx(modulated_by, abs=0.01)


def test_slip_beyond_the_allowed_range_is_not_called_that_bearing():
    inside, outside = (records(envelope=struck(ORDERS["BPFO"], slip_percent=s, seed=3, size=8.0)) for s in (1.8, 6.0))
    assert [record["line"] for record in inside] == ["BPFO"]
    assert outside == []


def test_sidebands_of_a_stronger_line_are_no_second_damage():
    # BPFI less one turn of the shaft and its like fall upon other places: none is a record of its own
    found = records(envelope=struck(ORDERS["BPFI"], slip_percent=0.2, seed=4, size=12.0, modulated_by=1.0))
    assert [record["line"] for record in found] == ["BPFI"]
    assert found[0]["lock"] == "slips"


def test_two_bearings_that_cannot_be_told_apart_are_both_named_and_say_so():
    twin = JACK.model_copy(update={"name": "distributor shaft"})
    made = struck(bearing_orders(JACK)["BPFO"], slip_percent=0.8, seed=5, size=8.0)
    found = records(envelope=made, bearings=(JACK, twin))
    assert {record["name"] for record in found} == {"jack shaft", "distributor shaft"}
    assert all("cannot be told from it" in record["verdict"] for record in found)


def test_a_nominal_speed_is_said_to_look_like_slip():
    made, angle = strikes(order=ORDERS["BPFO"] * 0.99, size=8.0, speed_rpm=1500.0, seed=6)
    made.attrs["encoder_kind"] = "constant"
    (record,) = records(envelope=map_of((made, angle)))
    assert "nominal" in record["verdict"]


def test_combustion_on_half_orders_raises_no_bearing_alarm():
    # bursts of high-frequency noise at the 11th half order, as strong as any damage
    rate, rpm = 12_800.0, 1500.0
    angle = np.arange(64_000) / rate * rpm / 60.0
    bursts = np.random.default_rng(7).standard_normal(64_000) * (1.0 + 5.0 * ((5.5 * angle) % 1.0 < 0.2))
    made = map_of(recording(bursts[None], rate_hz=rate, speed_rpm=rpm, revs_per_cycle=2))
    assert (made["amplitude"].values / made["floor"].values).max() ** 4 > 200.0
    assert records(envelope=made, bearings=(JACK,), revs_per_cycle=2) == []


def passage(lock, order=5.5, error=1e-4, needed=None):
    return replace(agreed(order, line(order), lock=lock, error=error), needed_revs=needed)


def test_a_line_at_n_fs_is_a_toothed_part_where_it_is_locked_and_the_bearing_where_it_slips():
    locked = ("Exactly locked: 11 x of the shaft that turns at 0.5 of the crank's speed", "no bearing alarm")
    for order, said in (
        (passage("locked"), locked),
        (passage("slips", 5.5 * 0.992), ("Slips (0.80 % slower than in pure rolling)",)),
        (passage("undecided", error=0.01, needed=640.0), ("640 revolutions would tell",)),
    ):
        (record,) = records([order], bearings=(JACK,), revs_per_cycle=2)
        assert (record["line"], record["seen_in"], record["lock"]) == ("N*fs", "vibration", order.lock)
        assert all(words in record["verdict"] for words in said)
        if order.lock == "slips":
            assert record["slip_percent"] == pytest.approx(0.8)
            assert record["slip_percent_ci95"][0] < 0.8 < record["slip_percent_ci95"][1]


def test_a_locked_order_is_no_race_even_where_slip_would_allow_it():
    # BPFO of this bearing at 2 % slip is order 2: an engine order, not an outer race
    near_two = Bearing(name="b", bpfo=2.03, rolling_elements=5)
    assert records([agreed(2.0, line(2.0))], bearings=(near_two,)) == []
    (record,) = records([agreed(2.02, line(2.02), lock="slips")], bearings=(near_two,))
    assert record["line"] == "BPFO"
    assert "outer race" in record["verdict"]


def test_without_bearings_orders_or_envelope_there_is_nothing():
    empty = recording_envelope(
        *recording(np.zeros((1, 400)), rate_hz=1000.0, speed_rpm=1500.0), settings=SETTINGS.orders
    )
    assert records() == []
    assert records(envelope=empty) == []
    assert records([passage("locked")], envelope=empty, bearings=()) == []


@pytest.mark.parametrize("off_percent", [0.0, 0.7])
def test_a_line_that_both_found_races_do_not_add_up_to_is_no_rolling_element_count(off_percent):
    races = [agreed(ORDERS[name] * 0.997, line(ORDERS[name] * 0.997), lock="slips") for name in ("BPFO", "BPFI")]
    count = 0.997 * (ORDERS["BPFO"] + ORDERS["BPFI"]) * (1.0 - off_percent / 100.0)
    found = {one["line"] for one in records([*races, agreed(count, line(count), lock="slips")])}
    assert found == {"BPFO", "BPFI"} | ({"N*fs"} if off_percent == 0.0 else set())
    # without the races nothing contradicts it
    assert {one["line"] for one in records([agreed(count, line(count), lock="slips")])} == {"N*fs"}


def test_a_count_of_rolling_elements_gives_no_all_clear_beside_a_line_of_the_envelope():
    assert races_words([], []) == "Neither of its races was found: no bearing alarm."
    assert races_words([], ["BSF", "FTF"]) == (
        "Neither of its races was found, but BSF and FTF were, in the envelope: see there."
    )
    assert races_words(["BPFO"], ["FTF"]) == "BPFO of the same bearing was found: see there."


# Growth from run to run: exact for two runs, honest about scatter, and undecided where nothing can be told.


def growth(amplitudes, errors):
    return trend_over(RunAmplitudes(np.array(amplitudes), np.array(errors)))


def undecided(growth):
    return growth.growth_per_run_ci95[0] < 0.0 < growth.growth_per_run_ci95[1]


def test_two_runs_are_compared_by_their_errors_alone():
    # ln 1.5 = 0.4055; its standard error is 0.05 sqrt 2
    rise = growth([1.0, 1.5], [0.05, 0.075])
    half = 1.959964 * 0.05 * np.sqrt(2.0)
    assert rise.growth_per_run == pytest.approx(0.5)
    assert rise.growth_per_run_ci95 == pytest.approx((1.5 * np.exp(-half) - 1.0, 1.5 * np.exp(half) - 1.0), rel=1e-6)
    assert undecided(growth([1.0, 1.05], [0.05, 0.05]))
    assert growth([1.5, 1.0], [0.05, 0.05]).growth_per_run_ci95[1] < 0.0


@pytest.mark.parametrize("n_runs", [2, 5])
def test_the_interval_covers_the_growth_and_steady_runs_are_rarely_called_growing(n_runs):
    chance = np.random.default_rng(n_runs)
    inside = growing = 0
    for _ in range(2000):
        amplitudes = 1.2 ** np.arange(n_runs) * np.exp(0.05 * chance.standard_normal(n_runs))
        low, high = growth(amplitudes, 0.05 * amplitudes).growth_per_run_ci95
        inside += low <= 0.2 <= high
        steady = np.exp(0.05 * chance.standard_normal(n_runs))
        growing += growth(steady, 0.05 * steady).growth_per_run_ci95[0] > 0.0
    assert inside / 2000 >= 0.93
    assert growing / 2000 <= 0.035


def test_runs_that_scatter_more_than_their_errors_say_widen_the_interval():
    amplitudes = np.array([1.0, 2.0, 0.9, 2.2])
    assert undecided(growth(amplitudes, 0.01 * amplitudes))


def test_damage_that_grows_by_half_a_run_is_followed_through_the_envelopes():
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
        found = bearing_records((), one, bearings=(JACK,), revs_per_cycle=2, settings=SETTINGS.identify)
        assert found[0]["line"] == "BPFO"
        assert found[0]["slip_percent_ci95"][0] < 0.8 < found[0]["slip_percent_ci95"][1]
    every = trend_over(run_amplitudes(runs, order=order))
    assert 0.0 < every.growth_per_run_ci95[0] < 0.5 < every.growth_per_run_ci95[1]
    ends = trend_over(run_amplitudes([runs[0], runs[3]], order=order))
    assert 0.0 < ends.growth_per_run_ci95[0] < 1.5**3 - 1.0 < ends.growth_per_run_ci95[1]
    assert undecided(trend_over(run_amplitudes([runs[2], runs[2]], order=order)))
    assert run_amplitudes(runs, order=7.37).amplitudes.size == 0
