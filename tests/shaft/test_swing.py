"""Swing of the speed within the cycle, against the motion that was put in and a real engine."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from crankorder.shaft.tooth_errors import speed_swing


def swinging(
    lines: dict[float, float],
    *,
    rpm: float = 1500.0,
    per_rev: int = 30,
    seconds: float = 3.0,
    slope: float = 0.0,
    revs_per_cycle: int = 2,
    noise_rpm: float = 0.0,
) -> xr.Dataset:
    """ShaftAngle with a speed of ``rpm`` + ``slope`` t and ``lines`` (order: peak in rpm) by the angle, integrated."""
    rng = np.random.default_rng(4)
    phases = {order: rng.uniform(0, 2 * np.pi) for order in lines}

    def speed(time: float, angle: np.ndarray) -> np.ndarray:
        swing = sum(size * np.cos(2 * np.pi * k * angle + phases[k]) for k, size in lines.items())
        return rpm + slope * time + swing

    count = int(seconds * rpm / 60 * per_rev)
    time, angle = np.linspace(0.0, seconds, count), np.zeros(count)
    for n in range(1, count):
        at, step = time[n - 1], (time[n] - time[n - 1]) / 8
        value = angle[n - 1]
        for _ in range(8):
            middle = value + 0.5 * step * speed(at, value) / 60
            value = value + step * speed(at + 0.5 * step, middle) / 60
            at += step
        angle[n] = value
    known = np.array([float(speed(t, a)) for t, a in zip(time, angle, strict=True)])
    return xr.Dataset(
        {
            "time": ("knot", time),
            "crank_angle": ("knot", angle),
            "speed": ("knot", known + noise_rpm * rng.standard_normal(count)),
        },
        attrs={"n_pulses": 1000, "revs_per_cycle": revs_per_cycle},
    )


@pytest.mark.cases(2)
@pytest.mark.parametrize("seed", range(4))
def test_orders_and_amplitudes_are_those_that_were_put_in(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rpm = rng.uniform(600, 4000)
    lines = {order: rpm * rng.uniform(0.002, 0.02) for order in (0.5, 1.0, 2.0, 3.5)}
    swing = speed_swing(swinging(lines, rpm=rpm, seconds=60.0 / rpm * 40))
    assert swing is not None and swing.speed_rpm == pytest.approx(rpm, rel=5e-3)
    for order, size in lines.items():
        at = swing.orders.tolist().index(order)
        assert swing.told[at]
        # a speed of ripple r by time has second harmonics of r squared by angle, and the mean over the angle
        assert swing.amplitude_rpm[at] == pytest.approx(size, rel=0.02, abs=2e-4 * rpm)


def test_a_run_up_without_swing_has_none() -> None:
    swing = speed_swing(swinging({}, slope=200.0))
    assert swing is not None and not swing.told.any()


def test_noise_of_the_edges_is_no_swing() -> None:
    swing = speed_swing(swinging({}, noise_rpm=15.0, seconds=6.0))
    assert swing is not None and not swing.told.any()


def test_nothing_is_said_without_pulses_or_cycles_or_knots() -> None:
    shaft = swinging({0.5: 20.0}, seconds=1.0)
    shaft.attrs["n_pulses"] = 0
    assert speed_swing(shaft) is None
    assert speed_swing(swinging({0.5: 20.0}, seconds=0.1)) is None
    sparse = speed_swing(swinging({0.5: 20.0}, per_rev=1))
    assert sparse is None or sparse.orders.max() < 0.5
    reversed_ = swinging({}, seconds=1.0)
    reversed_["crank_angle"] = -reversed_["crank_angle"]
    assert speed_swing(reversed_) is None
