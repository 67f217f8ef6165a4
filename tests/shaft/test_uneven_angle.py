"""Angle on wheels whose teeth are few and uneven: no worse than a spline through the pulses, with an honest error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, angle_knots
from crankorder.shaft.pattern import pattern_of
from crankorder.shaft.wheel import number_teeth

SETTINGS = load_settings().shaft
REVS_PER_S = 15.0


def swinging_angle(time_s):
    """Crank angle [rev] at 900 rpm, uneven by 1 % in orders 0.5 and 1.5."""
    steady = 0.37 + REVS_PER_S * time_s
    return steady + sum(0.005 / (2 * np.pi * k) * np.sin(2 * np.pi * k * steady + k) for k in (0.5, 1.5))


def pulses_of(name, duration_s=4.0):
    places = np.array(pattern_of(name).angles_deg) / 360.0
    last = swinging_angle(duration_s)
    wanted = (np.arange(int(last) + 1)[:, None] + places).ravel()
    wanted = wanted[(wanted > swinging_angle(0.0)) & (wanted < last)]
    time_s = (wanted - 0.37) / REVS_PER_S
    for _ in range(50):
        time_s -= (swinging_angle(time_s) - wanted) / REVS_PER_S
    return time_s, wanted


def knots_and_error(name, noise_s, at):
    """Knots, the error of the angle at ``at``, and that of the cubic spline through the same pulses."""
    exact, place = pulses_of(name)
    pulse_s = exact + noise_s * np.random.default_rng(3).standard_normal(exact.size)
    angles = pattern_of(name).angles_deg
    teeth = number_teeth(pulse_s, pulses_per_rev=1, tooth_angles_deg=angles, settings=SETTINGS)
    knots = angle_knots(
        teeth.time_s, teeth.tooth, teeth_per_rev=teeth.teeth_per_rev, noise_s=max(noise_s, 1e-9), settings=SETTINGS
    )
    turned = pattern_of(name).repeats
    error = angle_at(at, knots.time_s, knots.angle_rev, knots.speed_rpm) - swinging_angle(at)
    error -= np.round(np.median(error) * teeth.teeth_per_rev * turned) / (teeth.teeth_per_rev * turned)
    return knots, error, CubicSpline(pulse_s, place)(at) - swinging_angle(at)


@pytest.mark.parametrize("noise_s", [0.0, 1e-6, 1e-5])
@pytest.mark.parametrize("name", ["12+1", "gm-7x", "gm-24x", "gm-24x-3", "subaru-6", "36-2-1", "36-1-1-1-1", "60-2"])
def test_between_the_teeth_of_any_wheel_the_angle_is_as_good_as_a_spline_and_its_error_is_stated(name, noise_s):
    at = np.linspace(0.5, 3.5, 30_011)
    knots, error, splined = knots_and_error(name, noise_s, at)
    assert np.std(error) < 1.02 * np.std(splined)
    stated = np.interp(at, knots.time_s, knots.standard_error_rev)
    assert np.quantile(np.abs(error) / stated, 0.95) < 2.3
    # stated for the teeth that have a pulse, and for the others by how the shaft moves, not by how it might
    assert knots.standard_error_rev.min() < 1.01 * max(noise_s, 1e-9) * REVS_PER_S * 1.01
    assert np.median(stated) < 2.0 * noise_s * REVS_PER_S + 1e-4


def test_exact_pulses_of_any_wheel_are_passed_through():
    for name in ["12+1", "gm-7x", "gm-24x", "36-2-1"]:
        exact, place = pulses_of(name)
        _, error, _ = knots_and_error(name, 0.0, exact[10:-10])
        assert place.size > 300
        np.testing.assert_allclose(error, 0.0, atol=2e-9)
