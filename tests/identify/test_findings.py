"""Findings of made tests whose truth is analytic."""

import numpy as np
import pytest

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.engine.machine_parts import Bearing
from crankorder.identify.findings import Measured, find
from crankorder.identify.machine_model import MachineModel
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.recordings import line, steady, total
from made.typed import as_dicts

find = as_dicts(find)

SETTINGS = load_settings()
SPEEDS_RPM = np.arange(600.0, 2001.0, 100.0)
MODES = {115.0: 0.012, 172.0: 0.01, 187.0: 0.01, 350.0: 0.008}
RATE_HZ = 2000.0


def shaken(seed: int):
    """White noise seen through the acceleration response of MODES."""

    def signal(time_s, _):
        rng = np.random.default_rng(seed)
        frequency = np.fft.rfftfreq(len(time_s), 1 / RATE_HZ)
        response = 1.0 + sum(
            -2 * z * frequency**2 / (f**2 - frequency**2 + 2j * z * f * frequency) for f, z in MODES.items()
        )
        return np.fft.irfft(np.fft.rfft(0.05 * rng.standard_normal(len(time_s))) * response, len(time_s))

    return signal


def findings_of(signals_at, *, speeds=SPEEDS_RPM, duration_s=12.0, bearings=(), **given):
    orders, frequencies = [], []
    for number, rpm in enumerate(speeds):
        recording = steady(signals_at(rpm, number), speed_rpm=rpm, duration_s=duration_s, rate_hz=RATE_HZ)
        orders.append(order_frames(*recording, settings=SETTINGS.orders))
        frequencies.append(frequency_frames(*recording, settings=SETTINGS.campbell))
    made_map = order_map(orders, settings=SETTINGS.orders)
    campbell = campbell_map(frequencies, speed_bin_rpm=25.0)
    sources = MachineModel(revs_per_cycle=2, bearings=tuple(bearings), **given)
    return find(Measured(made_map, campbell, orders), test="made", sources=sources, settings=SETTINGS)


@pytest.fixture(scope="module")
def reference():
    bearing = Bearing(name="jack shaft", shaft_ratio=0.5, rolling_elements=11)

    def signals(rpm, number):
        growing = (rpm / 1000) ** 2
        return [
            total(line(1.0, 0.2 * growing, 0.4), line(2.0, 0.1 * growing), line(5.5, 0.05), shaken(number)),
            total(line(5.5, 0.08, 1.0), shaken(1000 + number)),
        ]

    return findings_of(signals, bearings=[bearing], engine_orders=(1.0, 2.0))


def test_every_order_is_found_and_none_else_and_the_truth_lies_in_their_intervals(reference):
    truth = {("A", 1.0): (0.2, 2.0), ("A", 2.0): (0.1, 2.0), ("A", 5.5): (0.05, 0.0), ("B", 5.5): (0.08, 0.0)}
    assert [(record["channel"], round(record["order"], 2)) for record in reference["orders"]] == list(truth)
    for record in reference["orders"]:
        amplitude, exponent = truth[record["channel"], round(record["order"], 1)]
        expected = amplitude * (record["speed_rpm_at_max"] / 1000) ** exponent
        low, high = record["amplitude_ci95"]
        assert low <= expected <= high
        assert record["speed_exponent_ci95"][0] <= exponent <= record["speed_exponent_ci95"][1]
        assert abs(record["speed_exponent"] - exponent) < 0.06
        assert record["order_ci95"][0] <= round(record["order"], 1) <= record["order_ci95"][1]


def test_natural_frequencies_are_found_within_0_2_percent_with_their_damping_within_15(reference):
    assert len(reference["modes"]) == len(MODES)
    for record, (frequency, damping) in zip(reference["modes"], MODES.items(), strict=True):
        assert record["frequency_hz"] == pytest.approx(frequency, rel=0.002)
        assert record["damping_ratio"] == pytest.approx(damping, rel=0.15)
        assert record["explained_by"] == "mode"


def test_a_locked_bearing_line_is_said_to_be_as_likely_an_11_fold_part(reference):
    (record,) = reference["bearings"]
    assert (record["line"], record["order_expected"], record["channel"]) == ("N*fs", 5.5, "B")
    assert record["lock"] == "locked" and "11 x" in record["verdict"]
    causes = {r["explained_by"] for r in reference["orders"]}
    assert causes == {"engine kinematics", "bearing jack shaft N*fs or an 11-fold part of that shaft"}
    assert reference["unexplained_energy_fraction"] == 0.0


def test_one_speed_and_one_channel_are_enough_to_name_orders():
    made = findings_of(lambda rpm, k: [total(line(2.0, 1.0), shaken(k))], speeds=[1500.0])
    assert [round(record["order"], 2) for record in made["orders"]] == [2.0]
    assert made["orders"][0]["speed_exponent"] is None


def test_a_line_in_too_short_a_test_is_named_with_its_reservation():
    made = findings_of(
        lambda rpm, k: [total(line(2.0, 3.0), line(0.5, 1.0), shaken(k))], speeds=[1500.0], duration_s=0.75
    )
    assert [round(record["order"], 2) for record in made["orders"]] == [0.5, 2.0]
    assert all("too few revolutions" in record["evidence"] for record in made["orders"])


@pytest.mark.cases(1)
@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(10, 25), marks=pytest.mark.slow)])
@pytest.mark.parametrize("damping", [0.003, 0.01, 0.02])
def test_a_resonance_exactly_on_an_order_is_no_order_though_one_speed_was_run(damping, seeds):
    def ringing(seed):
        def signal(time_s, _):
            frequency = np.fft.rfftfreq(len(time_s), 1 / RATE_HZ)
            at = 100.0 / 3.0
            response = frequency**2 / (at**2 - frequency**2 + 2j * damping * at * frequency)
            noise = np.random.default_rng(seed).standard_normal(len(time_s))
            return np.fft.irfft(np.fft.rfft(0.05 * noise) * response, len(time_s))

        return signal

    made = [findings_of(lambda rpm, k, s=s: [ringing(s)], speeds=[1000.0], duration_s=15.0) for s in seeds]
    assert [item["orders"] for item in made] == [[]] * len(seeds)
