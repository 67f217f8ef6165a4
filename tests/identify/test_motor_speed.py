"""The true speed of a motor whose speed was only stated is read off the lines of its shaft, or it is not known."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest
import xarray as xr

from crankorder.engine.motor import Motor
from crankorder.identify.explain import explained
from crankorder.identify.found import AgreedOrder
from crankorder.identify.lines.order_lock import NO_PULSES
from crankorder.identify.lines.order_lock import NUMBERS as ORDER_LOCK
from crankorder.identify.motor_speed import SpeedRead, explained_at, speed_read, with_speed_read
from crankorder.identify.said import LIKE_UNBALANCE
from crankorder.identify.sources import Sources
from crankorder.quantities import with_flags
from crankorder.settings import load_settings
from made.found_lines import agreed, fit

SETTINGS = load_settings().identify
STATED = with_flags(
    xr.Dataset(),
    [{"recording": "a", "flag": "no_index", "severity": "info", "detail": "no encoder pulses: a stated speed"}],
)


def at_speed(hertz: float, rpm: float, size: float = 1.0) -> AgreedOrder:
    """A line at ``hertz`` of a recording for which ``rpm`` was stated."""
    order = 60.0 * hertz / rpm
    made: AgreedOrder = agreed(order, lock="undecided", error=ORDER_LOCK.stated_speed_error * order)
    one = dataclasses.replace(
        made.lines[0],
        seen=np.array([0]),
        speed_rpm=np.array([rpm]),
        amplitude=np.array([size]),
        amplitude_error=np.array([0.01]),
        degrees_of_freedom=np.array([50.0]),
        phase_deg=np.array([0.0]),
    )
    return dataclasses.replace(made, lines=(one,), own_error=1e-5 * order, reservation=NO_PULSES)


def read(motor: Motor, *orders: AgreedOrder) -> SpeedRead | None:
    return speed_read(motor, orders, STATED, settings=SETTINGS)


def drawn(seed: int) -> tuple[Motor, float, float, list[AgreedOrder]]:
    """A motor, its true and stated speed, and its lines: three orders, twice mains, perhaps mains and sidebands."""
    chance = np.random.default_rng([seed, 5])
    poles, nominal = int(chance.choice([2, 4, 6])), float(chance.choice([50.0, 60.0]))
    supply = nominal * (1.0 + float(chance.uniform(-2e-3, 2e-3)))
    slip = float(chance.uniform(0.002, 0.06))
    true = 120.0 * supply / poles * (1.0 - slip)
    stated = (120.0 * nominal / poles, 1.01 * true, 0.99 * true, true)[seed % 4]
    size = float(chance.uniform(0.5, 3.0))
    places = [(k * true / 60.0, size / k) for k in (1, 2, 3)] + [(2.0 * supply, float(chance.uniform(0.3, 3.0)))]
    places += [(supply, float(chance.uniform(0.3, 3.0)))] if poles == 2 or chance.random() < 0.5 else []
    if chance.random() < 0.5:
        places += [(true / 60.0 + side * 2.0 * slip * supply, 0.3 * size) for side in (-1, 1)]
    return Motor(supply_hz=nominal, poles=poles), true, stated, [at_speed(f, stated, a) for f, a in sorted(places)]


@pytest.mark.parametrize("seed", range(24))
def test_the_lines_of_the_shaft_tell_its_speed_whatever_was_stated(seed: int) -> None:
    motor, true, stated, orders = drawn(seed)
    found = read(motor, *orders)
    assert found is not None and found.rpm == pytest.approx(true, rel=1e-4)
    assert found.agrees == (abs(true / stated - 1.0) < 2.0 * ORDER_LOCK.stated_speed_error)


@pytest.mark.parametrize("seed", range(24))
def test_at_the_speed_that_was_read_no_line_is_a_second_shaft_and_mains_are_mains(seed: int) -> None:
    motor, true, _, orders = drawn(seed)
    told, found = with_speed_read(motor, tuple(orders), STATED, settings=SETTINGS)
    sources = Sources(revs_per_cycle=1, motor=motor)

    given: dict[str, Any] = {"sources": sources, "quantity": {"A": "acceleration"}, "settings": SETTINGS}
    causes = explained_at(found, told, fit(), [], explain=partial(explained, **given))
    supply = found.supply[0] if found is not None and found.supply is not None else np.nan
    for one in told:
        hertz, text = one.order * one.lines[0].speed_rpm[0] / 60.0, causes.orders["A", one.order].text
        assert "second shaft" not in text
        turns = hertz * 60.0 / true
        if abs(turns - round(turns)) < 1e-6:
            assert text == (LIKE_UNBALANCE if round(turns) == 1 else "shaft harmonic")
            assert "the lines speak for" in one.reservation and one.lock == "undecided"
        elif min(abs(hertz - supply), abs(hertz - 2.0 * supply)) < 1e-3:
            assert "mains" in text


@pytest.mark.parametrize(
    "hertz",
    [
        (49.9,),  # mains a little low, or a shaft
        (50.0, 100.0),  # mains alone
        (48.0, 49.0),  # two of like size, neither with a multiple
        (44.0, 88.0),  # no motor that drives slips so much
    ],
)
def test_where_the_lines_may_be_something_else_no_speed_is_read(hertz: tuple[float, ...]) -> None:
    assert read(Motor(supply_hz=50.0, poles=2), *(at_speed(one, 3000.0) for one in hertz)) is None


def test_a_speed_that_pulses_tell_is_not_read_again() -> None:
    motor, _, _, orders = drawn(1)
    assert speed_read(motor, orders, xr.Dataset(), settings=SETTINGS) is None
