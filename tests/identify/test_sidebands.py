"""Sidebands, meshes and shafts of their own: lines that other lines explain."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from crankorder.identify.causes.angle_swings import swing_sidebands
from crankorder.identify.causes.sidebands import meshes, sidebands
from crankorder.orders.true_angle import HALF_ORDERS, SHOWN
from made.found_lines import agreed, line


def modulated(carrier: float, spacing: float, depth: float) -> tuple[list[float], list[float]]:
    """Places and amplitudes of (1 + depth cos) · cos: the carrier and both sides at half the depth."""
    return [carrier - spacing, carrier, carrier + spacing], [depth / 2, 1.0, depth / 2]


def test_amplitude_modulation_by_the_shaft_makes_a_pair_about_its_carrier():
    places, amplitudes = modulated(3.317, 1.0, 0.6)
    found = sidebands(places, [1e-3] * 3, amplitudes, spacings={"shaft": 1.0}, highest=20.0)
    assert [(item.at, item.carrier, item.multiple, item.spacing_name) for item in found] == [
        (0, 1, -1, "shaft"),
        (2, 1, 1, "shaft"),
    ]
    assert [item.spacing for item in found] == pytest.approx([1.0, 1.0])


def test_a_line_alone_lines_stronger_than_their_carrier_and_lopsided_lines_are_no_sidebands():
    for places, amplitudes in (
        ([2.317, 3.317], [0.3, 1.0]),
        ([2.317, 3.317, 4.317], [2.0, 1.0, 2.0]),
        ([2.3, 3.317, 4.317], [0.3, 1.0, 0.3]),
    ):
        assert sidebands(places, [1e-3] * len(places), amplitudes, spacings={"shaft": 1.0}, highest=20.0) == []


def test_lines_that_lie_anywhere_are_seldom_called_sidebands():
    rng = np.random.default_rng(5)
    false = 0
    for _ in range(400):
        places, amplitudes = rng.uniform(0.5, 20.0, 6).tolist(), rng.uniform(0.1, 1.0, 6).tolist()
        false += bool(sidebands(places, [2e-3] * 6, amplitudes, spacings={"shaft": 1.0, "half": 0.5}, highest=20.0))
    assert false <= 24  # 3 % are seen; 6 % would be too many


def test_a_mesh_stands_over_its_neighbours_and_harmonics_of_a_shaft_do_not():
    gear = {1: 2.0, 2: 1.0, 21: 0.05, 22: 0.2, 23: 1.0, 24: 0.3, 25: 0.1}
    assert meshes(gear) == [23]
    assert meshes({k: 1.0 / k for k in range(1, 20)}) == []
    assert meshes(dict.fromkeys(range(1, 20), 1.0)) == []
    assert meshes({22: 0.2, 23: 1.0}) == []  # one side alone


@pytest.mark.parametrize("seed", range(8))
def test_what_a_swing_of_the_shaft_makes_through_a_mode_is_no_order_of_its_own(seed: int):
    rng = np.random.default_rng(seed)
    natural_hz, damping = rng.uniform(60.0, 200.0), rng.uniform(0.005, 0.05)
    number, half_orders = float(rng.integers(3, 9)), int(rng.integers(1, 5))
    rpm = np.linspace(600.0, 3000.0, 400) if seed % 2 else np.linspace(600.0, 3000.0, 6)
    swing_rev = rng.uniform(0.005, 0.03) / (np.pi * half_orders) * (600.0 / rpm) ** 2

    def response(order):
        x = order * rpm / 60.0 / natural_hz
        return (rpm / 1000.0) ** 2 / (1.0 - x**2 + 2j * damping * x)

    shown = np.zeros((rpm.size, 1 + HALF_ORDERS), dtype=complex)
    shown[:, 0], shown[:, half_orders] = rpm, swing_rev
    frames = xr.Dataset(coords={"order": [20.0]}, attrs={SHOWN: shown.view(float).ravel()})
    side = number + rng.choice([-0.5, 0.5]) * half_orders
    made = np.pi * number * swing_rev * np.abs(response(side) - response(number))
    strong = agreed(number, line(number, np.abs(response(number)), speed_rpm=rpm, error=0.0))
    told = [
        swing_sidebands([strong, agreed(side, line(side, amplitude, speed_rpm=rpm, error=0.0))], [frames])
        for amplitude in (made, 0.5 * np.abs(response(side)))
    ]
    assert [len(words) for words in told] == [1, 0]
