"""Crankcase forces against the truth sheet and against the sum over the moving masses."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.definition import Engine
from crankorder.engine.forces import DIRECTIONS, crankcase_forces, crankcase_moments
from crankorder.engine.harmonics import orders_for
from crankorder.engine.slider_crank import piston_acceleration

Z, X = DIRECTIONS.index("Z"), DIRECTIONS.index("X")
OPTICAL = {"crank_radius_m": 0.0449, "rod_length_m": 0.152, "reciprocating_mass_kg": 4.304}


def engine(**differences: Any) -> Engine:
    return Engine.model_validate({**OPTICAL, **differences})


def test_the_spacer_forces_are_those_of_the_truth_sheet_at_all_speeds(shared_truth: dict[str, Any]) -> None:
    table = shared_truth["seed001"]["spacer_116g"]["r=44.9,l=152"]
    shafts = {"orders": [1, 2], "unbalanced_mass_kg": 0.116}
    forces = np.abs(crankcase_forces(engine(shafts=shafts), [row["rpm"] for row in table], max_order=4)[:, Z])
    assert len(table) == 35
    assert forces[:, 1] == pytest.approx([row["F1_N"] for row in table], rel=1e-12)
    assert forces[:, 2] == pytest.approx([row["F2_exact_N"] for row in table], rel=1e-12)


def test_shafts_timed_to_the_crank_leave_the_quadrature_of_the_offset(shared_truth: dict[str, Any]) -> None:
    known = shared_truth["seed001"]["offset_quadrature_first_order"]["r=44.9,l=152"]["N_2000rpm_of_193249.6"]
    shafts = {"orders": [1, 2], "unbalanced_mass_kg": 0.0, "timed_to": "crank"}
    timed = crankcase_forces(engine(offset_m=0.01, shafts=shafts), 2000, max_order=2)[Z]
    assert abs(timed[1]) == pytest.approx(known, rel=1e-12)
    to_force = crankcase_forces(engine(offset_m=0.01, shafts=shafts | {"timed_to": "force"}), 2000, max_order=2)[Z]
    assert np.abs(to_force[1:]).max() == 0


@pytest.mark.parametrize(("name", "mass_kg"), [("standard", 1.216), ("optical", 4.304)])
def test_table_1_of_the_thesis_has_its_exact_values(shared_truth: dict[str, Any], name: str, mass_kg: float) -> None:
    model = engine(reciprocating_mass_kg=mass_kg)
    per_omega = np.abs(crankcase_forces(model, 30 / np.pi, max_order=8)[Z]) * 1e6
    in_newton = np.abs(crankcase_forces(model, 2000, max_order=8)[Z])
    for row in shared_truth["seed001"]["table1"]["rows_g_mm"][name]:
        assert per_omega[row["order"]] == pytest.approx(row["exact_Fourier"], rel=1e-12)
    for order, known in shared_truth["seed001"]["table1"]["force_N_at_2000rpm"][name].items():
        assert in_newton[int(order)] == pytest.approx(known, rel=1e-12)


@pytest.mark.parametrize(("radius_m", "rod_m", "row"), [(0.0449, 0.152, 0), (0.0473, 0.0473 * 49822.3 / 15001.4, 1)])
def test_the_forces_of_the_offset_engine_are_those_of_the_truth_sheet(
    shared_truth: dict[str, Any], radius_m: float, rod_m: float, row: int
) -> None:
    known = list(shared_truth["seed001"]["offset_10mm"].values())[row]["force_N_2000rpm_optical_4304g"]
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
