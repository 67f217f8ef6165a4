"""Speeds to avoid, worst first, and the bands of speed that are free."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.crossings import crossings
from crankorder.identify.found import OrderResponse
from crankorder.identify.speeds_to_avoid import speeds_to_avoid
from crankorder.settings import load_settings
from made.found_lines import SPEEDS_RPM, agreed, fit, line, mode, resonant

SETTINGS = load_settings().identify
RANGE = (600.0, 2000.0)


def judged(orders, modal):
    records = crossings(tuple(orders), modal, speed_rpm=RANGE, settings=SETTINGS)
    return speeds_to_avoid(records, tuple(orders), modal, speed_rpm=RANGE, settings=SETTINGS)


def test_two_orders_that_meet_two_modes_at_one_speed_are_one_speed_to_avoid():
    modes = [mode(115.0, 0.016), mode(230.0, 0.014)]
    orders = [agreed(k, line(k, size * resonant(k, SPEEDS_RPM, modes))) for k, size in ((4.0, 1.0), (8.0, 0.1))]
    avoid, free = judged(orders, fit(*modes))
    at_1725 = [record for record in avoid if record["rpm_range"][0] < 1725.0 < record["rpm_range"][1]]
    assert len(at_1725) == 1 and at_1725[0]["rank"] == 1
    assert at_1725[0]["orders"] == [4.0, 8.0] and at_1725[0]["order"] == 4.0
    assert "order 4 meets 115 Hz and order 8 meets 230 Hz" in at_1725[0]["reason"]
    assert all(not (band["low_rpm"] < 1725.0 < band["high_rpm"]) for band in free)


def test_the_range_is_the_half_power_width_and_the_interval_of_the_speed():
    modes = [mode(100.0, 0.02)]
    avoid, free = judged([agreed(4.0, line(4.0, resonant(4.0, SPEEDS_RPM, modes)))], fit(*modes))
    (record,) = avoid
    interval = 1500.0 * np.hypot(0.02 / 100.0, 1e-4 / 4.0) * 1.96
    assert record["rpm_range"] == pytest.approx([1500 - 30 - interval, 1500 + 30 + interval], abs=0.01)
    assert [(band["low_rpm"], band["high_rpm"]) for band in free] == [
        (600.0, record["rpm_range"][0]),
        (record["rpm_range"][1], 2000.0),
    ]


def test_what_costs_most_against_the_loudest_of_its_channel_ranks_first():
    modes = [mode(60.0), mode(100.0)]
    shape = {k: resonant(k, SPEEDS_RPM, modes) for k in (3.0, 4.0)}
    orders = [
        agreed(3.0, line(3.0, 0.1 * shape[3.0])),
        agreed(4.0, line(4.0, shape[4.0])),
        agreed(1.0, line(1.0, 1000.0 * SPEEDS_RPM / 1000, channel="pressure")),
    ]
    avoid, _ = judged(orders, fit(*modes))
    assert [record["rank"] for record in avoid] == list(range(1, len(avoid) + 1))
    costs = [record["cost"] for record in avoid]
    assert costs == sorted(costs, reverse=True)
    assert avoid[0]["order"] == 4.0 and avoid[0]["channel"] == "A"


def test_the_peak_between_two_measured_speeds_is_that_of_the_fit():
    modal = fit(mode(105.0, 0.01))  # at 1575 rpm, between 1550 and 1600
    seen = line(4.0, resonant(4.0, SPEEDS_RPM, modal.modes, gain=-1.0))
    response = OrderResponse(4.0, "A", 2.0, 1000.0, 1.0 + 0j, np.array([1.0 + 0j]), True)
    avoid, _ = judged([agreed(4.0, seen)], fit(*modal.modes, responses=(response,)))
    assert avoid[0]["amplitude"] == pytest.approx(1.575**2 * np.hypot(1.0, 50.0), rel=1e-6)
    assert avoid[0]["amplitude"] > seen.amplitude.max()


def test_a_free_band_says_what_nobody_has_judged_in_it():
    orders = [agreed(4.0, line(4.0, (SPEEDS_RPM / 1000) ** 2))]
    avoid, free = judged(orders, fit(mode(105.0, 0.0005)))
    assert avoid == []
    assert [(band["low_rpm"], band["high_rpm"]) for band in free] == [RANGE]
    assert free[0]["remark"] == "not judged: order 4 with 105 Hz at 1575 rpm"


def test_a_free_band_names_the_crossings_of_a_mode_that_is_in_doubt():
    orders = [agreed(4.0, line(4.0, (SPEEDS_RPM / 1000) ** 2))]
    _, free = judged(orders, fit(mode(105.0, undecided="a tone or a mode")))
    assert free[0]["remark"] == "not judged: order 4 with 105 Hz at 1575 rpm"


def test_a_test_of_unknown_speed_has_neither():
    assert speeds_to_avoid([], (), fit(), speed_rpm=(np.nan, np.nan), settings=SETTINGS) == ([], [])
