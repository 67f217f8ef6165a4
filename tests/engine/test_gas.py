"""Gas forces and torques: work, orders and superposition."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.definition import Engine
from crankorder.engine.gas import firing_angle_deg, gas_force, gas_torque, gas_torque_by_order
from crankorder.engine.slider_crank import piston_drop
from crankorder.errors import RequestError

DEGREES = [float(angle) for angle in range(-360, 360, 2)]
DATA = {"crank_radius_m": 0.0275, "rod_length_m": 0.0842, "reciprocating_mass_kg": 0.3, "bore_m": 0.0677}


def genset(**differences: Any) -> Engine:
    return Engine.model_validate({**DATA, **differences})


def closed_cycle() -> dict[str, Any]:
    """Adiabatic compression and expansion without combustion: a gas spring, whatever its exponent."""
    model = genset()
    swept = piston_drop(np.array(DEGREES) / 360, model.mechanism)
    clearance = swept.max() / 7.5
    pressure = 1e5 * ((clearance + swept.max()) / (clearance + swept)) ** 1.35
    pressure[np.abs(DEGREES) > 180] = 1e5
    return {"crank_angle_deg": DEGREES, "pressure_pa": pressure.tolist(), "surroundings_pa": 1e5}


def test_the_work_of_the_torque_is_the_area_of_the_indicator_diagram() -> None:
    curve = closed_cycle()
    burnt = np.array(curve["pressure_pa"]) * np.where((np.array(DEGREES) > 0) & (np.array(DEGREES) < 180), 1.5, 1.0)
    model = genset(gas=curve | {"pressure_pa": burnt.tolist()})
    angles = np.arange(1 << 17) / (1 << 16)
    volume = np.pi / 4 * 0.0677**2 * piston_drop(angles, model.mechanism)
    pressure = gas_force(model, angles) / (np.pi / 4 * 0.0677**2)
    area = np.sum(0.5 * (pressure + np.roll(pressure, -1)) * (np.roll(volume, -1) - volume))
    _, torque = gas_torque_by_order(model, 4)
    assert torque[0].imag == 0
    assert 4 * np.pi * torque[0].real == pytest.approx(area, rel=1e-6)
    assert area > 30


def test_a_gas_spring_makes_no_mean_torque() -> None:
    orders, torque = gas_torque_by_order(genset(gas=closed_cycle()), 3)
    assert orders.tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3]
    assert abs(torque[0]) < 1e-9 * np.abs(torque).max()
    assert np.abs(torque.real).max() < 1e-9 * np.abs(torque).max()  # odd about the dead centre: sines only


def test_a_torque_curve_is_taken_as_it_is() -> None:
    curve = {"crank_angle_deg": [-30.0, 0.0, 90.0, 300.0], "torque_n_m": [1.0, 4.0, -2.0, 0.5]}
    model = genset(gas=curve)
    assert gas_torque(model, np.array([0, 0.25, 2.25, -1 / 12, 45 / 360])) == pytest.approx([4, -2, -2, 1, 1])
    with pytest.raises(RequestError, match="no gas force"):
        gas_force(model, 0.1)


def test_the_orders_of_a_straight_line_curve_are_exact() -> None:
    # a triangle over the cycle: height 1 at dead centre, 8/pi^2 / n^2 at odd half orders
    model = genset(gas={"crank_angle_deg": [0.0, 360.0], "torque_n_m": [1.0, -1.0]})
    orders, torque = gas_torque_by_order(model, 5)
    known = np.where(np.arange(11) % 2, 8 / np.pi**2 / np.maximum(np.arange(11), 1) ** 2, 0)
    assert orders[1] == 0.5
    assert np.abs(torque - known).max() < 1e-8


def test_four_cylinders_leave_the_orders_that_they_share() -> None:
    curve = {"crank_angle_deg": [0.0, 20.0, 200.0, 500.0], "torque_n_m": [0.0, 50.0, -3.0, -10.0]}
    cylinders = [
        {"crank_deg": crank, "firing_deg": firing}
        for crank, firing in ((0.0, 0.0), (180.0, 540.0), (180.0, 180.0), (0.0, 360.0))
    ]
    orders, one = gas_torque_by_order(genset(gas=curve), 8)
    _, four = gas_torque_by_order(genset(gas=curve, cylinders=cylinders), 8)
    shared = np.mod(orders, 2) == 0
    assert four[shared] == pytest.approx(4 * one[shared])
    assert np.abs(four[~shared]).max() < 1e-12 * np.abs(one).max()


def test_a_single_cylinder_fires_where_it_stands() -> None:
    model = genset(cylinders=[{"crank_deg": 30.0, "bank_deg": 10.0}])
    assert firing_angle_deg(model, model.cylinders[0]) == 340
    two_stroke = genset(cycle="two-stroke", cylinders=[{}, {"crank_deg": 180.0}])
    assert firing_angle_deg(two_stroke, two_stroke.cylinders[1]) == 180


def test_without_gas_there_is_no_force() -> None:
    assert not gas_force(genset(), np.linspace(0, 2, 9)).any()
    assert not gas_torque(genset(), np.linspace(0, 2, 9)).any()
