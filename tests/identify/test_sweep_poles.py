"""Poles that the signals of sweeps tell, against the exact signals of ``tests/machines``."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.found import Mode as FoundMode
from crankorder.identify.modes import sweep_fit, sweep_poles
from crankorder.identify.modes.sweep_poles import sweep_fits
from crankorder.identify.modes.sweep_window import SweepSpectrum
from crankorder.orders.intervals import Z95, ratio_interval
from crankorder.settings import load_settings
from machines.machine import Encoder, Machine, Mode, Order, Profile, Tone
from machines.signals import recorded, sample_times

RATE_HZ = 1024.0
SETTINGS = load_settings().identify.model_copy(update={"false_alarm_probability": 1e-4, "max_damping_ratio": 0.2})
HALVES = [0.5 * number for number in range(1, 25)]


def a_machine(*modes, rpm, seconds, noise=0.002):
    """Orders 2 and 3.5 in two channels through ``modes`` (Hz, damping ratio), from ``rpm`` to ``rpm``."""
    made = tuple(Mode(f, zeta, (0.02, -0.015), (1.0, 0.7), (0.0,)) for f, zeta in modes)
    orders = (Order(2.0, 0.0, 0.5, 2.0, 30.0, 4.0, (0.02, 0.01)), Order(3.5, 0.2, 0.3, 1.6, -70.0, -6.0, (-0.01, 0.03)))
    profile = Profile((0.0, seconds), rpm, 0.3)
    encoder = Encoder("speed", "speed")
    density = (noise, noise)
    return Machine("run-up", 1, RATE_HZ, ("X", "Y"), made, orders, (), (profile,), encoder, density, (), 50.0, False)


def told(machine, seed=0):
    """Fits of the only sweep of ``machine``, whose orders 2 and 3.5 are followed."""
    (profile,) = machine.profiles
    samples, _ = recorded(machine, profile, np.random.default_rng([seed, 0]))
    n = 64 * (samples.shape[1] // 64)
    time_s, frequency = sample_times(machine, profile)[:n], np.arange(n // 2 + 1) * RATE_HZ / n
    band = (0.0, RATE_HZ, 0.4 * RATE_HZ, frequency, np.fft.rfft(samples[:, :n], axis=1))
    sweep = SweepSpectrum("0", ("X", "Y"), (2.0, 3.5), *band, profile.angle(time_s), profile.speed(time_s), 2)
    return sweep_fits([sweep], others=HALVES, settings=SETTINGS)


@pytest.mark.parametrize(("rpm_per_s", "damping"), [(10.0, 0.003), (-60.0, 0.02), (300.0, 0.02)])
def test_a_mode_is_told_to_a_part_of_its_width_whatever_the_rate(rpm_per_s, damping):
    seconds = min(1500.0 / abs(rpm_per_s), 20.0)
    middle = 60.0 * 81.3 / 2.7
    ends = middle - 0.5 * rpm_per_s * seconds, middle + 0.5 * rpm_per_s * seconds
    poles = told(a_machine((81.3, damping), rpm=ends, seconds=seconds)).poles
    near = [pole for pole in poles if abs(pole.frequency_hz - 81.3) < 1.0]
    if not any(min(ends) < 60.0 * 81.3 / order < max(ends) for order in (2, 3.5)):
        assert not near
        return
    assert len(near) == len(poles) == 1
    assert abs(near[0].frequency_hz - 81.3) < 0.1 * damping * 81.3  # of its half width
    assert abs(near[0].frequency_hz - 81.3) < 4.0 * near[0].frequency_error_hz
    assert near[0].damping == pytest.approx(damping, rel=0.15)


def test_places_told_in_parts_give_the_poles_of_all_at_once(monkeypatch):
    machine = a_machine((81.3, 0.02), rpm=(2000.0, 2900.0), seconds=8.0)
    (whole,) = told(machine).poles
    monkeypatch.setattr(sweep_fit, "MOST_VALUES", 1 << 12)
    (in_parts,) = told(machine).poles
    assert in_parts.frequency_hz == pytest.approx(whole.frequency_hz, rel=1e-9)
    assert in_parts.damping == pytest.approx(whole.damping, rel=1e-6)


def test_noise_alone_has_no_modes():
    for seed in range(3):
        machine = a_machine(rpm=(900.0, 3000.0), seconds=8.0, noise=0.1)
        assert told(machine, seed=seed).poles == ()


def test_two_modes_a_hertz_apart_are_two_and_mains_are_none():
    two = a_machine((96.0, 0.004), (97.0, 0.003), rpm=(1200.0, 3600.0), seconds=12.0)
    mains = (Tone(50.02, (0.3, 0.2), (0.4, 1.0)), Tone(100.04, (0.1, 0.2), (0.4, 1.0)))
    assert [round(pole.frequency_hz, 1) for pole in told(replace(two, tones=mains)).poles] == [96.0, 97.0]


def test_a_search_that_stops_at_its_bound_says_where_modes_may_be_missing(monkeypatch):
    machine = a_machine((81.3, 0.01), (120.0, 0.01), rpm=(900.0, 3000.0), seconds=8.0)
    whole = told(machine)
    assert whole.left_hz == () and len(whole.poles) == 2
    monkeypatch.setitem(vars(sweep_poles.NUMBERS), "most_starts", 1)
    few = told(machine)
    assert few.left_hz and all(low < high for low, high in few.left_hz)
    bounded = np.concatenate([hiding.frequency_hz for hiding in few.hiding])
    assert not any(((bounded > low) & (bounded < high)).any() for low, high in few.left_hz)


# What disagreeing orders add to the error of a pole, and how its interval carries an unknown damping.


def test_a_damping_ratio_errs_by_a_factor():
    low, high = ratio_interval(0.02, 0.01)
    assert low > 0.0
    assert low * high == pytest.approx(0.02**2)
    assert ratio_interval(0.02, 0.5, most=1.0)[1] == 1.0
    assert ratio_interval(0.02, 1e-4) == pytest.approx([0.02 - Z95 * 1e-4, 0.02 + Z95 * 1e-4], rel=1e-4)


def test_where_the_damping_is_not_known_the_error_of_the_frequency_is_not():
    known, unknown = (FoundMode(100.0, 0.1, 0.01, error, ("X",), 10.0, "") for error in (1e-4, 0.02))
    assert known.frequency_half_hz == pytest.approx(Z95 * 0.1, rel=1e-2)
    assert unknown.frequency_half_hz > 10.0 * 0.1
