"""Poles that the signals of sweeps tell, against the exact signals of ``tests/machines``."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.found import Mode as FoundMode
from crankorder.identify.modes import sweep_poles
from crankorder.identify.modes.sweep_poles import sweep_fits
from crankorder.identify.modes.sweep_window import SweepSpectrum
from crankorder.orders.intervals import Z95, ratio_interval
from crankorder.settings import load_settings
from machines.machine import Encoder, Machine, Mode, Order, Profile, Swing, Tone
from machines.signals import as_read_by_angle, order_envelope, recorded, sample_times, swung_signal

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


def spectra_of(machine, orders, seed):
    made = []
    for number, profile in enumerate(machine.profiles):
        samples, _ = recorded(machine, profile, np.random.default_rng([seed, number]))
        n = 64 * (samples.shape[1] // 64)
        time_s = sample_times(machine, profile)[:n]
        frequency = np.arange(n // 2 + 1) * RATE_HZ / n
        spectrum = np.fft.rfft(samples[:, :n], axis=1)
        angle, speed = profile.angle(time_s), profile.speed(time_s)
        made.append(
            SweepSpectrum(
                str(number), machine.channels, tuple(orders), 0.0, RATE_HZ, 0.4 * RATE_HZ, frequency, spectrum, angle,
                speed, 2,
            )
        )  # fmt: skip
    return made


def told(machine, orders=None, seed=0):
    followed = [2.0, 3.5] if orders is None else orders
    return sweep_fits(spectra_of(machine, followed, seed), others=HALVES, settings=SETTINGS)


@pytest.mark.cases(2)
@pytest.mark.parametrize("rpm_per_s", [10.0, -60.0, 300.0])
@pytest.mark.parametrize("damping", [0.003, 0.02])
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


def test_noise_alone_has_no_modes():
    for seed in range(6):
        machine = a_machine(rpm=(900.0, 3000.0), seconds=8.0, noise=0.1)
        assert told(machine, seed=seed).poles == ()


MAINS = (Tone(50.02, (0.3, 0.2), (0.4, 1.0)), Tone(100.04, (0.1, 0.2), (0.4, 1.0)))
ONE = a_machine((81.3, 0.01), rpm=(900.0, 3000.0), seconds=8.0)
TWO = a_machine((96.0, 0.004), (97.0, 0.003), rpm=(1200.0, 3600.0), seconds=12.0)


@pytest.mark.cases(1)
@pytest.mark.parametrize(("machine", "wanted"), [(replace(ONE, tones=MAINS), [81.3]), (TWO, [96.0, 97.0])])
def test_two_modes_a_hertz_apart_are_two_and_mains_are_none(machine, wanted):
    assert [round(pole.frequency_hz, 1) for pole in told(machine).poles] == wanted


@pytest.mark.slow
def test_an_order_that_nobody_followed_is_no_mode():
    assert {round(pole.frequency_hz, 1) for pole in told(ONE, orders=[3.5]).poles} <= {81.3}


def test_a_search_that_stops_at_its_bound_says_where_modes_may_be_missing(monkeypatch):
    machine = a_machine((81.3, 0.01), (120.0, 0.01), rpm=(900.0, 3000.0), seconds=8.0)
    whole = told(machine)
    assert whole.left_hz == () and len(whole.poles) == 2
    used = next(n for n in range(1, 99) if not _bounded(machine, n, monkeypatch).left_hz)
    few = _bounded(machine, used // 2, monkeypatch)
    assert few.left_hz and all(low < high for low, high in few.left_hz)
    bounded = np.concatenate([hiding.frequency_hz for hiding in few.hiding])
    assert not any(((bounded > low) & (bounded < high)).any() for low, high in few.left_hz)
    assert _bounded(machine, used, monkeypatch).poles[0].frequency_hz == whole.poles[0].frequency_hz


def _bounded(machine, most_starts, monkeypatch):
    monkeypatch.setitem(vars(sweep_poles.NUMBERS), "most_starts", most_starts)
    return told(machine)


@pytest.mark.slow
def test_the_envelope_of_the_fit_has_the_peak_that_was_there():
    machine = a_machine((81.3, 0.005), rpm=(1100.0, 3500.0), seconds=6.0)
    profile = machine.profiles[0]
    (group,) = told(machine).groups
    for number, order in enumerate((2.0, 3.5)):
        true = order_envelope(machine, profile, number)[0]
        time_s = sample_times(machine, profile)
        at = int(np.argmax(np.abs(true).max(axis=0)))
        near = slice(at - 40, at + 40, 8)
        one = group.fit.solved[0]
        turn = one.window.turn(order, time_s[near], profile.angle(time_s[near]))
        value, variance = one.envelope(order, turn), one.envelope_variance(order, turn, group.covariance)
        plain = np.exp(2j * np.pi * np.outer(time_s[near] - one.window.sweep.start_s, one.window.frequency_hz))
        plain *= np.exp(-2j * np.pi * order * profile.angle(time_s[near]))[:, None] * one.window.taper
        assert np.abs(turn - plain * 2.0 / len(one.window.sweep.angle_rev)).max() < 1e-9 * np.abs(turn).max()
        largest = np.abs(true).max()
        assert np.abs(value.T - true[:, near]).max() < 0.02 * largest
        assert (np.abs(value.T - true[:, near]) < 5.0 * np.sqrt(variance.T) + 0.004 * largest).all()


def test_an_order_of_a_swinging_shaft_is_its_mean_over_cycles():
    machine = a_machine((81.3, 0.005), rpm=(1200.0, 3000.0), seconds=10.0)
    profile = replace(machine.profiles[0], swing=Swing(0.5, 0.03, 1400.0))
    machine = replace(machine, profiles=(profile,))
    (spectrum,), time_s = spectra_of(machine, [2.0, 3.5], 0), sample_times(machine, profile)
    assert 0.005 < spectrum.swing_rev < 0.03 / np.sqrt(2.0)
    true = [order_envelope(machine, profile, number)[0] for number in range(2)]
    means = np.abs(as_read_by_angle(machine, profile, true, swung_signal(machine, profile, true))[1])
    near = np.flatnonzero(np.abs(3.5 * profile.speed(time_s) / 60.0 / 81.3 - 1.0) < 0.03)[::20]
    value = np.abs(told(machine).groups[0].fit.solved[0].line(3.5, profile.angle(time_s[near])))
    off, swung = np.std(value.T - means[:, near]), np.std(np.abs(true[1][:, near]) - means[:, near])
    assert off < 0.75 * swung and swung > 0.04 * means[:, near].max()


# What disagreeing orders add to the error of a pole, and how its interval carries an unknown damping.


@pytest.mark.slow
def test_a_damping_ratio_errs_by_a_factor():
    low, high = ratio_interval(0.02, 0.01)
    assert low > 0.0
    assert low * high == pytest.approx(0.02**2)
    assert ratio_interval(0.02, 0.5, most=1.0)[1] == 1.0
    assert ratio_interval(0.02, 1e-4) == pytest.approx([0.02 - Z95 * 1e-4, 0.02 + Z95 * 1e-4], rel=1e-4)


@pytest.mark.slow
def test_where_the_damping_is_not_known_the_error_of_the_frequency_is_not():
    known, unknown = (FoundMode(100.0, 0.1, 0.01, error, ("X",), 10.0, "") for error in (1e-4, 0.02))
    assert known.frequency_half_hz == pytest.approx(Z95 * 0.1, rel=1e-2)
    assert unknown.frequency_half_hz > 10.0 * 0.1
