"""Crankcase forces against the truth sheet and against the sum over the moving masses."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import DIRECTIONS, crankcase_forces, crankcase_moments
from crankorder.engine.harmonics import orders_for
from crankorder.engine.slider_crank import piston_acceleration

Z, X = DIRECTIONS.index("Z"), DIRECTIONS.index("X")
OPTICAL = {"crank_radius_m": 0.0449, "rod_length_m": 0.152, "reciprocating_mass_kg": 4.304}


def engine(**differences: Any) -> Engine:
    return Engine.model_validate({**OPTICAL, **differences})


def test_the_spacer_forces_are_those_of_the_truth_sheet_at_all_speeds(truth: dict[str, Any]) -> None:
    table = truth["seed001"]["spacer_116g"]["r=44.9,l=152"]
    shafts = {"orders": [1, 2], "unbalanced_mass_kg": 0.116}
    forces = np.abs(crankcase_forces(engine(shafts=shafts), [row["rpm"] for row in table], max_order=4)[:, Z])
    assert len(table) == 35
    assert forces[:, 1] == pytest.approx([row["F1_N"] for row in table], rel=1e-12)
    assert forces[:, 2] == pytest.approx([row["F2_exact_N"] for row in table], rel=1e-12)


def test_orders_without_shafts_act_with_the_whole_reciprocating_mass(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["kinematic_force_optical_at_1725rpm_N"]
    shafts = {"orders": [1, 2], "unbalanced_mass_kg": 0.116}
    forces = np.abs(crankcase_forces(engine(shafts=shafts), 1725, max_order=10)[Z])
    for order in (4, 6, 8, 10):
        assert forces[order] == pytest.approx(known[str(order)], rel=1e-12)
    assert np.abs(crankcase_forces(engine(), 1725, max_order=2)[Z, 2]) == pytest.approx(known["2"], rel=1e-12)


def test_the_second_configuration_makes_a_third_order_by_its_offset() -> None:
    forces = np.abs(crankcase_forces(load_engine("msu-optical-second"), [300, 2000], max_order=4)[:, Z])
    assert forces[1, 3:] == pytest.approx([60.3, 60.6], abs=0.05)  # truth sheet 2.6
    assert forces[0, 1] == pytest.approx(5.140 * 1.002325, abs=0.001)  # 2.5 and 2.6
    assert np.abs(crankcase_forces(load_engine("msu-optical-first"), 2000, max_order=3)[Z, 3]) == 0


def test_shafts_timed_to_the_crank_leave_the_quadrature_of_the_offset(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["offset_quadrature_first_order"]["r=44.9,l=152"]["N_2000rpm_of_193249.6"]
    shafts = {"orders": [1, 2], "unbalanced_mass_kg": 0.0, "timed_to": "crank"}
    timed = crankcase_forces(engine(offset_m=0.01, shafts=shafts), 2000, max_order=2)[Z]
    assert abs(timed[1]) == pytest.approx(known, rel=1e-12)
    to_force = crankcase_forces(engine(offset_m=0.01, shafts=shafts | {"timed_to": "force"}), 2000, max_order=2)[Z]
    assert np.abs(to_force[1:]).max() == 0


def test_the_forces_of_task_5_are_those_of_the_truth_sheet_at_every_angle(truth: dict[str, Any]) -> None:
    known = truth["seed000"]["Fx_Fy_reference_g_mm_at_omega_1_lambda_0.25_l1_25"]
    model = Engine(
        crank_radius_m=0.025, rod_length_m=0.1, reciprocating_mass_kg=0.32, rotating_unbalance_kg_m=0.45 * 0.025
    )
    by_order = crankcase_forces(model, 30 / np.pi, max_order=orders_for(1e-16, model.mechanism)) * 1e6
    for degrees, (along, across) in known.items():
        phasors = np.exp(2j * np.pi * np.arange(by_order.shape[1]) * int(degrees) / 360)
        summed = (by_order * phasors).real.sum(axis=1)
        assert summed[Z] == pytest.approx(float(along), rel=1e-12)
        assert summed[X] == pytest.approx(float(across), rel=1e-12, abs=1e-8)


@pytest.mark.parametrize(("name", "mass_kg"), [("standard", 1.216), ("optical", 4.304)])
def test_table_1_of_the_thesis_has_its_exact_values(truth: dict[str, Any], name: str, mass_kg: float) -> None:
    model = engine(reciprocating_mass_kg=mass_kg)
    per_omega = np.abs(crankcase_forces(model, 30 / np.pi, max_order=8)[Z]) * 1e6
    in_newton = np.abs(crankcase_forces(model, 2000, max_order=8)[Z])
    for row in truth["seed001"]["table1"]["rows_g_mm"][name]:
        assert per_omega[row["order"]] == pytest.approx(row["exact_Fourier"], rel=1e-12)
    for order, known in truth["seed001"]["table1"]["force_N_at_2000rpm"][name].items():
        assert in_newton[int(order)] == pytest.approx(known, rel=1e-12)


@pytest.mark.parametrize(("radius_m", "rod_m", "row"), [(0.0449, 0.152, 0), (0.0473, 0.0473 * 49822.3 / 15001.4, 1)])
def test_the_forces_of_the_offset_engine_are_those_of_the_truth_sheet(
    truth: dict[str, Any], radius_m: float, rod_m: float, row: int
) -> None:
    known = list(truth["seed001"]["offset_10mm"].values())[row]["force_N_2000rpm_optical_4304g"]
    model = engine(crank_radius_m=radius_m, rod_length_m=rod_m, offset_m=0.01)
    forces = np.abs(crankcase_forces(model, 2000, max_order=12)[Z])
    assert forces[1:] == pytest.approx([known[str(order)] for order in range(1, 13)], rel=1e-12)


def test_the_inertia_of_the_rod_makes_a_moment_and_no_force() -> None:
    rod = {"mass_kg": 1.6738, "centre_from_big_end_m": 0.03736}
    plain, true = (engine(rod=rod | inertia) for inertia in ({}, {"inertia_kg_m2": 0.0032}))
    assert np.array_equal(crankcase_forces(plain, 2000, max_order=9), crankcase_forces(true, 2000, max_order=9))
    missed = np.abs(crankcase_moments(true, 2000, max_order=9) - crankcase_moments(plain, 2000, max_order=9))
    assert missed[DIRECTIONS.index("Y"), 1] > 10


def test_the_orders_add_up_to_mass_times_exact_acceleration() -> None:
    model = engine(offset_m=0.01, rotating_unbalance_kg_m=0.02, rotating_unbalance_deg=30.0)
    speed_rpm, angles = 1500.0, np.linspace(0, 1, 360)
    omega = speed_rpm * np.pi / 30
    by_order = crankcase_forces(model, speed_rpm, max_order=orders_for(1e-14, model.mechanism))
    phasors = np.exp(2j * np.pi * np.arange(by_order.shape[1])[:, None] * angles)
    force = (by_order[:, :, None] * phasors).real.sum(axis=1)
    crank = 2 * np.pi * angles + np.radians(30)
    along = 4.304 * omega**2 * piston_acceleration(angles, model.mechanism) + 0.02 * omega**2 * np.cos(crank)
    assert np.abs(force[Z] - along).max() < 1e-11 * np.abs(along).max()
    assert np.abs(force[X] - 0.02 * omega**2 * np.sin(crank)).max() < 1e-11 * np.abs(along).max()
    assert not force[DIRECTIONS.index("Y")].any()


def test_forces_grow_with_the_square_of_speed() -> None:
    slow, fast = crankcase_forces(engine(offset_m=0.01), [700.0, 2100.0], max_order=8)
    assert np.abs(fast - 9 * slow).max() < 1e-13 * np.abs(fast).max()
