"""Loads inside the engine against the laws that they must obey: action and reaction, work, angular momentum."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.definition import Engine
from crankorder.engine.forces import (
    DIRECTIONS,
    crankcase_forces,
    crankcase_moments,
    cylinder_loads,
    inertia_torque_by_order,
    main_bearing_loads,
)
from crankorder.engine.gas import gas_torque
from crankorder.engine.slider_crank import rod_angle
from crankorder.errors import RequestError

X, Y, Z = (DIRECTIONS.index(name) for name in ("X", "Y", "Z"))
SPEED_RPM = 1500.0
OMEGA = SPEED_RPM * np.pi / 30
ANGLES = np.linspace(0, 2, 361)
DATA = {
    "crank_radius_m": 0.0449,
    "rod_length_m": 0.152,
    "reciprocating_mass_kg": 1.2,
    "rotating_unbalance_kg_m": 0.02,
    "rotating_unbalance_deg": 30.0,
    "rod": {"mass_kg": 1.6, "centre_from_big_end_m": 0.04, "inertia_kg_m2": 0.004},
    "bore_m": 0.09,
    "gas": {"crank_angle_deg": [0.0, 20.0, 90.0, 360.0, 600.0], "pressure_pa": [3e6, 5e6, 4e5, 1e5, 1.5e5]},
}


def engine(**differences: Any) -> Engine:
    return Engine.model_validate({**DATA, **differences})


def summed(by_order: np.ndarray, angles: np.ndarray = ANGLES) -> np.ndarray:
    phasors = np.exp(2j * np.pi * np.arange(by_order.shape[-1])[:, None] * angles)
    return (by_order[..., None] * phasors).real.sum(axis=-2)


@pytest.mark.parametrize("offset_m", [0.0, 0.01, -0.02])
def test_what_the_parts_put_on_the_crankcase_is_its_inertia_force(offset_m: float) -> None:
    model = engine(offset_m=offset_m)
    loads = cylinder_loads(model, ANGLES, SPEED_RPM)
    forces = summed(crankcase_forces(model, SPEED_RPM, max_order=70))
    scale = np.abs(loads.main_n).max()
    assert np.abs(loads.main_n[0] + loads.head_n - forces[Z]).max() < 1e-13 * scale
    assert np.abs(loads.main_n[1] + loads.side_thrust_n - forces[X]).max() < 1e-13 * scale


@pytest.mark.parametrize("offset_m", [0.0, 0.01, -0.02])
def test_the_rolling_moment_is_side_thrust_on_its_lever_and_gas_on_its_offset(offset_m: float) -> None:
    model = engine(offset_m=offset_m)
    loads = cylinder_loads(model, ANGLES, SPEED_RPM)
    psi, _, _ = rod_angle(ANGLES, model.mechanism)
    height = model.crank_radius_m * np.cos(2 * np.pi * ANGLES) + model.rod_length_m * np.cos(psi)
    moment = height * loads.side_thrust_n - offset_m * loads.head_n
    inertia = summed(crankcase_moments(model, SPEED_RPM, max_order=70))[Y]
    assert np.abs(moment - (inertia - gas_torque(model, ANGLES))).max() < 1e-12 * np.abs(moment).max()


@pytest.mark.parametrize("offset_m", [0.0, 0.01])
def test_the_torque_of_the_rod_is_the_work_of_gas_and_inertia(offset_m: float) -> None:
    model = engine(offset_m=offset_m)
    torque = cylinder_loads(model, ANGLES, SPEED_RPM).torque_n_m
    inertia = summed(inertia_torque_by_order(model, 70) * OMEGA**2)
    assert np.abs(torque - gas_torque(model, ANGLES) - inertia).max() < 1e-12 * np.abs(torque).max()


def test_the_main_bearings_together_carry_throws_of_their_own_masses_and_webs_in_force_and_moment() -> None:
    cylinders = [
        {"crank_deg": 0.0, "bank_deg": -30.0, "position_m": -0.09, "firing_deg": 330.0, "reciprocating_mass_kg": 0.9},
        {"crank_deg": 90.0, "bank_deg": 45.0, "position_m": 0.02, "firing_deg": 315.0, "rotating_unbalance_kg_m": 0.02},
        {"crank_deg": 180.0, "bank_deg": 0.0, "position_m": 0.1, "firing_deg": 540.0, "offset_m": 0.01},
    ]
    places = [-0.1, 0.0, 0.1]
    webs = [{"unbalance_g_mm": 2e4, "angle_deg": 70.0, "position_m": 0.12}]
    model = engine(cylinders=cylinders, webs=webs, main_bearings_m=places)
    loads = [cylinder_loads(model, ANGLES, SPEED_RPM, cylinder=number) for number in range(len(cylinders))]
    bearings = main_bearing_loads(model, ANGLES, SPEED_RPM, loads)
    assert bearings.shape == (3, 3, ANGLES.size)
    turned = 2 * np.pi * ANGLES + np.radians(70.0)
    force = 2e4 * 1e-6 * OMEGA**2 * np.stack([np.sin(turned), 0 * turned, np.cos(turned)])
    moment = 0.12 * force
    for cylinder_load, cylinder in zip(loads, model.cylinders, strict=True):
        along, across = cylinder_load.main_n
        lean = np.radians(cylinder.bank_deg)
        load = np.stack(
            [along * np.sin(lean) + across * np.cos(lean), 0 * along, along * np.cos(lean) - across * np.sin(lean)]
        )
        force += load
        moment += cylinder.position_m * load
    scale = np.abs(bearings).max()
    assert np.abs(bearings.sum(axis=0) - force).max() < 1e-13 * scale
    assert np.abs(np.einsum("b,bdt->dt", places, bearings) - moment).max() < 1e-13 * scale


@pytest.mark.slow
def test_cylinders_of_one_engine_carry_the_same_loads_at_other_angles() -> None:
    cylinders = [{"firing_deg": 0.0}, {"crank_deg": 180.0, "bank_deg": 45.0, "firing_deg": 585.0}]
    model = engine(cylinders=cylinders)
    one = cylinder_loads(model, ANGLES, SPEED_RPM)
    other = cylinder_loads(model, ANGLES + 585 / 360, SPEED_RPM, cylinder=1)
    for name in ("side_thrust_n", "piston_pin_n", "crank_pin_n", "main_n", "head_n", "torque_n_m"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-9, abs=1e-7), name


@pytest.mark.slow
def test_what_is_missing_for_loads_is_named() -> None:
    torque_only = {"crank_angle_deg": [0.0, 90.0], "torque_n_m": [0.0, 10.0]}
    for model, fault in (
        (engine(gas=torque_only, main_bearings_m=[-0.1, 0.1]), "at the dead centres any force makes no torque"),
        (engine(cylinders=[{}, {"crank_deg": 180.0}], main_bearings_m=[-0.1, 0.1]), "which revolution"),
    ):
        with pytest.raises(RequestError, match=fault):
            cylinder_loads(model, ANGLES, SPEED_RPM)


@pytest.mark.slow
@pytest.mark.parametrize("offset_m", [0.0, 1e-11, -1e-11])
def test_a_rod_that_almost_lies_flat_keeps_the_digits_of_its_loads(offset_m: float) -> None:
    # at 90° cos ψ = √((1 − λ + ε)(1 + λ − ε)): thrust and torque follow from the lengths alone
    radius, rod = 0.045 * (1 - 1e-9), 0.045
    bare = {"rod": None, "crank_radius_m": radius, "rod_length_m": rod, "offset_m": offset_m}
    model = engine(**bare)
    loads = cylinder_loads(model, np.array([0.25]), 0.0)
    gas = float(loads.head_n[0])
    across, short = radius - offset_m, rod - radius + offset_m
    assert loads.side_thrust_n[0] == pytest.approx(-gas * across / np.sqrt(short * (rod + across)), rel=1e-13)
    assert loads.torque_n_m[0] == pytest.approx(gas * radius, rel=1e-14)
