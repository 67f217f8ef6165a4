"""Rows of orders that meet lines of one frequency: told apart by their beat, or left open by what the line is."""

import warnings

import numpy as np
import pytest

import crankorder as co
from crankorder import front_door
from crankorder.orders.fixed_lines import without_steady_lines
from crankorder.shaft.angle import speed_course
from made.recordings import sampled, shaft
from made.swept_machines import RATE_HZ

ORDERS = {1.0: 0.3, 2.0: 0.2, 3.0: 0.4, 5.0: 0.15}
MAINS_HZ, MAINS = 60.02, {1: 0.3, 5: 0.1}


def recordings(rng):
    """Recordings of 12 s from 1120 to 1280 rpm of ORDERS and of MAINS by multiple, each with its amplitude.

    Order 2 is larger at every other speed.
    """
    time, phases, made = np.arange(round(12.0 * RATE_HZ)) / RATE_HZ, rng.uniform(0.0, 6.0, len(ORDERS)), []
    for rpm in range(1120, 1281, 40):
        signal = 0.02 * rng.standard_normal(len(time))
        for (order, size), phase in zip(ORDERS.items(), phases, strict=True):
            size *= 1.0 + 0.6 * (order == 2.0) * (rpm % 80 == 0)  # follows no law of the speed
            signal += size * np.cos(2.0 * np.pi * order * rpm / 60.0 * time + phase)
        for multiple, size in MAINS.items():
            signal += size * np.cos(2.0 * np.pi * multiple * MAINS_HZ * time + rng.uniform(0.0, 7.0))
        teeth = np.arange(1, int(time[-1] * rpm))
        wheel = {"pulse_times_s": teeth[teeth % 60 < 58] / rpm, "pulses_per_rev": 60, "missing_teeth": 2}
        made.append(co.recording({"A": signal}, rate_hz=RATE_HZ, name=f"made {rpm}", **wheel))
    return made


@pytest.fixture(scope="module")
def analysed():
    """OrderTracks of channel A and findings, as JSON has them, of `recordings`."""
    settings = front_door._settings("findings", "order_tracks", recipe=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = recordings(np.random.default_rng(0))
        groups, told = front_door._analysed(made, settings, tables={}, engine=None, test="made")
    return groups["order_tracks"].sel(channel="A"), told.as_dict()


def test_an_order_is_not_told_with_the_mains_that_it_meets_and_multiples_are_of_the_supply_that_is_there(analysed):
    _, told = analysed
    (third,) = [one for one in told["orders"] if round(one["order"]) == 3]
    assert third["amplitude"] == pytest.approx(0.4, rel=0.01)
    assert "mains of 60.02 Hz meets it at 1200 rpm, where its own share is" in third["evidence"]
    assert [one["explained_by"] for one in told["modes"]] == ["mains", "5 x mains"]
    assert "5 times the mains frequency of 60 Hz" in told["modes"][1]["evidence"]


def test_the_largest_value_of_each_track_is_that_of_the_findings(analysed):
    tracks, told = analysed
    assert len(told["orders"]) == len(ORDERS)
    for record in told["orders"]:
        track = tracks.sel(order=record["tracked_order"], method="nearest")
        best = track.isel(speed=int(track["amplitude"].where(track["amplitude_low"] > 0.0).argmax("speed")))
        assert record["speed_rpm_at_max"] == pytest.approx(float(best["speed"]), rel=2e-7)
        if record["order"] == 2.0:  # others have the amplitude of the law that all speeds follow
            assert record["amplitude"] == pytest.approx(float(best["amplitude"]), rel=2e-7)
            assert record["phase_deg"] == pytest.approx(float(best["phase"]), abs=1e-4)


# Lines of one frequency in a sweep: taken out as they are, and nothing else with them.


SWEEP_HZ, SECONDS, NOISE = 2048.0, 20.0, 0.02
TIME = np.arange(round(SWEEP_HZ * SECONDS)) / SWEEP_HZ
ORDER = np.array([2.0])


def _sweep(rng):
    """Shaft of a run-up from 1000 rpm or so to twice that, and order 2 of amplitude 1 with noise (2, samples)."""
    first_hz = rng.uniform(15.0, 18.0)
    rate = first_hz * rng.uniform(0.9, 1.1) / SECONDS
    knots = np.linspace(0.0, SECONDS, 400)
    turned = shaft(knots, first_hz * knots + 0.5 * rate * knots**2, 60.0 * (first_hz + rate * knots))
    angle = first_hz * TIME + 0.5 * rate * TIME**2
    order = np.cos(2.0 * np.pi * 2.0 * angle + rng.uniform(0.0, 6.0, (2, 1)))
    return turned, order + NOISE * rng.standard_normal((2, len(TIME)))


def _band(signals):
    return sampled(signals, rate_hz=SWEEP_HZ, band_hz=800.0)


def test_mains_that_an_order_passes_are_taken_out_as_they_are():
    rng = np.random.default_rng(0)
    turned, signals = _sweep(rng)
    hertz = float(rng.choice([50.0, 60.0])) + rng.uniform(-0.1, 0.1)
    phasor = rng.uniform(0.1, 0.5, 2) * np.exp(2j * np.pi * rng.uniform(0.0, 1.0, 2))
    hum = (phasor[:, None] * np.exp(2j * np.pi * hertz * TIME)).real
    left, lines = without_steady_lines(_band(signals + hum), speed_course(turned), ORDER, mains_hz=(50.0, 60.0))
    assert [one.frequency_hz for one in lines] == [pytest.approx(hertz, abs=0.003)]
    assert np.abs(lines[0].amplitude - phasor) == pytest.approx(0.0, abs=0.02)
    assert np.sqrt(np.mean((left["signal"].values - signals) ** 2)) < 0.05 * np.sqrt(np.mean(hum**2))


def test_an_order_and_what_rings_after_it_are_left():
    rng = np.random.default_rng(100)
    turned, signals = _sweep(rng)
    since = np.maximum(TIME - rng.uniform(5.0, 12.0), 0.0)
    signals += np.where(since > 0.0, 2.0 * np.exp(-0.004 * 2.0 * np.pi * 60.0 * since), 0.0) * np.sin(
        2.0 * np.pi * 60.0 * since
    )
    left, lines = without_steady_lines(_band(signals), speed_course(turned), ORDER, mains_hz=(50.0, 60.0))
    assert not lines
    np.testing.assert_array_equal(left["signal"].values, signals)
