"""Crank angle from a speed signal: noise about standstill turns no shaft."""

from __future__ import annotations

import numpy as np

from crankorder.settings import load_settings
from crankorder.shaft.angle import integrated_speed

SETTINGS = load_settings().shaft
RATE_HZ = 2000.0


def _stopped(noise_rpm: float) -> tuple[np.ndarray, float]:
    """A speed that falls from 900 rpm to 0, stays for 2 s and rises again, and the revolutions it makes."""
    time = np.arange(0.0, 6.0, 1.0 / RATE_HZ)
    speed = np.interp(time, [0.0, 2.0, 4.0, 6.0], [900.0, 0.0, 0.0, 900.0])
    noise = noise_rpm * np.random.default_rng(5).standard_normal(len(time))
    return speed + noise, float(speed.sum() / RATE_HZ / 60.0)


def test_the_noise_of_a_shaft_that_stands_does_not_add_up() -> None:
    speed, revs = _stopped(5.0)
    knots, flags = integrated_speed(speed, rate_hz=RATE_HZ, settings=SETTINGS)
    # cut off at 0 it would have added 0.067 rev
    assert abs(knots.angle_rev[-1] - revs) < 0.02
    assert flags == [] and (np.diff(knots.angle_rev) > 0.0).all() and (np.diff(knots.time_s) > 0.0).all()


def test_a_shaft_that_turns_back_is_flagged_and_taken_to_stand() -> None:
    speed, revs = _stopped(0.5)
    speed[5000:6000] = -100.0
    knots, flags = integrated_speed(speed, rate_hz=RATE_HZ, settings=SETTINGS)
    assert [name for name, _, _ in flags] == ["speed_negative"]
    assert abs(knots.angle_rev[-1] - revs) < 0.05
