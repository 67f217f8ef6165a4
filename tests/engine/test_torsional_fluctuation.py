"""The crank turns within its cycle as its torques and its flywheel say."""

import math

import numpy as np
import pytest

from crankorder.engine.definition import Cylinder, Engine, GasCurve
from crankorder.engine.forces import gas_torque_by_order, inertia_torque_by_order
from crankorder.engine.torsional_fluctuation import Lag, lag_from_torque
from crankorder.errors import RequestError
from crankorder.synth.motion import Motion

GAS = GasCurve(crank_angle_deg=(0.0, 20.0, 90.0, 180.0, 540.0, 700.0), torque_n_m=(0.0, 300.0, 90.0, 0.0, 0.0, -70.0))


def _engine(*cylinders, gas=True):
    lengths = {"crank_radius_m": 0.045, "rod_length_m": 0.15, "reciprocating_mass_kg": 1.2}
    return Engine(**lengths, gas=GAS if gas else None, cylinders=cylinders or (Cylinder(),))


TWIN = (Cylinder(crank_deg=0.0, firing_deg=0.0), Cylinder(crank_deg=180.0, position_m=0.1, firing_deg=180.0))


def _torque(engine, angle, omega, highest, with_gas):
    """Torque (N·m) of masses and gas less its mean on the crank at each angle, cylinder by cylinder."""
    masses = inertia_torque_by_order(engine, highest)
    total = np.zeros_like(angle)
    for cylinder in engine.cylinders:
        own = angle + (cylinder.crank_deg - cylinder.bank_deg) / 360
        total += omega**2 * (masses * np.exp(2j * np.pi * np.outer(own, np.arange(highest + 1)))).sum(axis=1).real
    if with_gas:
        orders, torque = gas_torque_by_order(engine, highest)
        total += (torque * np.exp(2j * np.pi * np.outer(angle, orders)))[:, 1:].sum(axis=1).real
    return total


@pytest.mark.parametrize(
    ("cylinders", "with_gas", "inertia", "rpm"),
    [(TWIN[:1], True, 0.05, 900.0), (TWIN, True, 0.5, 1600.0), (TWIN, False, 0.5, 900.0)],
)
def test_flywheel_times_acceleration_is_the_torque(cylinders, with_gas, inertia, rpm):
    engine = _engine(*cylinders)
    lag = lag_from_torque(engine, flywheel_inertia_kg_m2=inertia, speed_rpm=rpm, highest_order=12, with_gas=with_gas)
    motion = Motion(start_rev=0.13, corners=((0.0, rpm),), lag=lag)
    angle, speed, acceleration = motion.at(np.linspace(0, 2 * 60 / rpm, 801))
    torque = _torque(engine, angle, rpm * math.pi / 30, 12, with_gas)
    np.testing.assert_allclose(inertia * acceleration * math.pi / 30, torque, atol=1e-11 * np.abs(torque).max())
    assert angle[-1] - angle[0] == pytest.approx(2, abs=1e-14)
    assert speed[-1] == pytest.approx(speed[0], rel=1e-13)
    assert speed.max() - speed.min() > 1


def test_half_orders_come_with_gas_only():
    kinds = {"speed_rpm": 900.0, "flywheel_inertia_kg_m2": 0.5, "highest_order": 8}
    assert lag_from_torque(_engine(), with_gas=False, **kinds).step == 1.0
    assert lag_from_torque(_engine(), with_gas=True, **kinds).step == 0.5


def test_a_flywheel_too_small_is_refused():
    for with_gas in (True, False):
        small = {"flywheel_inertia_kg_m2": 1e-4, "speed_rpm": 900.0, "highest_order": 10, "with_gas": with_gas}
        with pytest.raises(RequestError, match="stop within the cycle"):
            lag_from_torque(_engine(), **small)


def test_gas_of_an_engine_without_any_and_orders_that_do_not_ascend_from_zero_are_refused():
    kinds = {"flywheel_inertia_kg_m2": 1.0, "speed_rpm": 900.0, "highest_order": 10}
    with pytest.raises(RequestError, match="no gas"):
        lag_from_torque(_engine(gas=False), **kinds, with_gas=True)
    for orders in ((-1.0, 2.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0, 3.0)):
        with pytest.raises(RequestError, match="lag"):
            Lag(order=np.array(orders), inertia=np.zeros(2, dtype=complex), gas=np.zeros(2, dtype=complex))


def test_the_slowest_speed_is_where_the_lag_falls_as_fast_as_the_angle_grows():
    order = np.array([0.5, 2.0, 3.0])
    lag = Lag(order=order, inertia=0.01j / order, gas=0.03 / order * np.exp(1j * order), reference_rpm=700.0)
    turned = 2j * np.pi * order * np.exp(2j * np.pi * np.linspace(0, 2, 100_001)[:, None] * order)
    falls = [float((1 + (turned @ lag.by_order(rpm)).real).min()) for rpm in (lag.slowest_rpm, 1.02 * lag.slowest_rpm)]
    assert abs(falls[0]) < 5e-3
    assert falls[1] > 0.01
