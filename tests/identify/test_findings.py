"""Findings of made tests whose truth is analytic."""

import numpy as np
import pytest

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
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


def shaken(seed):
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
@pytest.mark.parametrize("seeds", [range(5), pytest.param(range(5, 25), marks=pytest.mark.slow)])
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
