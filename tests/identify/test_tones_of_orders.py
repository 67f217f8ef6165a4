"""A line that stands only at speeds where it lies on an order of the cycle is no tone of its own."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from crankorder.identify.modes.floor import Floor
from crankorder.identify.modes.tones import kind_of
from crankorder.settings import load_settings

pytestmark = pytest.mark.slow

SETTINGS = load_settings().identify
FREQUENCY_HZ = np.arange(2.0, 300.0, 0.5)


def floor_with(line_hz: float, speed_rpm: np.ndarray, size: np.ndarray, seed: int) -> Floor:
    """Floor of noise at ``speed_rpm`` with a line at ``line_hz`` of the power ``size`` (speeds,)."""
    rng, averages = np.random.default_rng(seed), 20
    cells = rng.chisquare(2 * averages, size=(2, len(speed_rpm), FREQUENCY_HZ.size)) / (2 * averages)
    at = int(np.argmin(np.abs(FREQUENCY_HZ - line_hz)))
    cells[0, :, at] += size
    ones, made = np.ones((2, len(speed_rpm))), np.ones((2, FREQUENCY_HZ.size))
    seen = cast(Any, SimpleNamespace(bin_hz=0.5))
    return Floor(
        FREQUENCY_HZ, made, made, ones, cells, averages * ones, ("A", "B"), speed_rpm, seen, made, ("", ""), cells
    )


@pytest.mark.parametrize("seed", range(12))
def test_what_a_swing_of_the_speed_makes_at_one_speed_is_an_order(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    speed = np.linspace(800, 2400, int(rng.integers(3, 7))) * rng.uniform(0.9, 1.1)
    at, order = int(rng.integers(len(speed))), 0.5 * int(rng.integers(3, 9))
    hertz = order * speed[at] / 60.0
    size = np.where(np.arange(len(speed)) == at, 10.0 ** rng.uniform(1.5, 4), 0.0)
    kind, words = kind_of(hertz, 0.01, floor_with(hertz, speed, size, seed), settings=SETTINGS)
    assert "order" in kind and "at all speeds" not in words


@pytest.mark.parametrize("seed", range(12))
def test_a_tone_that_is_there_at_all_speeds_stays_one(seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    speed = np.linspace(800, 2400, int(rng.integers(3, 7))) * rng.uniform(0.9, 1.1)
    hertz = float(rng.uniform(21.0, 47.0))
    floor = floor_with(hertz, speed, 10.0 ** rng.uniform(1.5, 3) * rng.uniform(0.5, 1.0, len(speed)), seed)
    kind, words = kind_of(hertz, 0.01, floor, settings=SETTINGS)
    assert kind == "tone" and "stays at all speeds" in words
    # seen at one speed alone, off every half order of it: a tone, and the page does not say that it stays
    alone = np.zeros(len(speed))
    alone[0] = 500.0
    between = (round(hertz / (speed[0] / 120.0)) + 0.5) * speed[0] / 120.0
    kind, words = kind_of(between, 0.01, floor_with(between, speed, alone, seed), settings=SETTINGS)
    assert (kind != "order" and f"at 1 of {len(speed)} speeds" in words) or kind == "mains"


def test_without_a_speed_every_narrow_line_is_a_tone() -> None:
    floor = floor_with(37.5, np.array([1500.0, 2000.0, 900.0]), np.array([900.0, 0.0, 0.0]), 1)
    still = replace(floor, speed_rpm=np.full(3, np.nan))
    assert kind_of(37.5, 0.01, still, settings=SETTINGS)[0] == "tone"


@pytest.mark.parametrize("hertz", [33.7, 50.03])
def test_at_one_speed_no_line_is_said_to_stay(hertz: float) -> None:
    speed = np.array([1777.0, 1777.5])
    kind, words = kind_of(hertz, 0.01, floor_with(hertz, speed, np.full(2, 300.0), 1), settings=SETTINGS)
    assert kind in ("tone", "mains") and "speeds" not in words
