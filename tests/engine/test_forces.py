"""Crankcase forces against the truth sheet and against the sum over the moving masses."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import DIRECTIONS, crankcase_forces, crankcase_moments, orders_made
from crankorder.engine.slider_crank import even_harmonics

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


def test_the_inertia_of_the_rod_makes_a_moment_and_no_force() -> None:
    rod = {"mass_kg": 1.6738, "centre_from_big_end_m": 0.03736}
    plain, true = (engine(rod=rod | inertia) for inertia in ({}, {"inertia_kg_m2": 0.0032}))
    assert np.array_equal(crankcase_forces(plain, 2000, max_order=9), crankcase_forces(true, 2000, max_order=9))
    missed = np.abs(crankcase_moments(true, 2000, max_order=9) - crankcase_moments(plain, 2000, max_order=9))
    assert missed[DIRECTIONS.index("Y"), 1] > 10


# Several cylinders: what textbooks say cancels does, and what remains has its textbook size.


X_SEVERAL, Y, Z_SEVERAL = (DIRECTIONS.index(name) for name in ("X", "Y", "Z"))
SPEED_RPM = 3000.0
RADIUS_M, ROD_M, MASS_KG, PITCH_M = 0.0449, 0.152, 1.216, 0.1
FIRST_N = MASS_KG * RADIUS_M * (SPEED_RPM * np.pi / 30) ** 2
A2, A4, A6 = even_harmonics(3, RADIUS_M / ROD_M)


def row(crank_deg: list[float], **differences: Any) -> Engine:
    """Cylinders side by side, 100 mm apart, about the middle of the engine."""
    places = PITCH_M * (np.arange(len(crank_deg)) - (len(crank_deg) - 1) / 2)
    cylinders = [
        {"crank_deg": angle, "position_m": float(place)} for angle, place in zip(crank_deg, places, strict=True)
    ]
    lengths = {"crank_radius_m": RADIUS_M, "rod_length_m": ROD_M, "reciprocating_mass_kg": MASS_KG}
    return Engine.model_validate({**lengths, "cylinders": cylinders, **differences})


@pytest.mark.slow
def test_the_shipped_examples_are_the_textbook_arrangements() -> None:
    for name, cranks in {"inline-2": [0, 180], "inline-3": [0, 120, 240], "inline-4": [0, 180, 180, 0]}.items():
        textbook, example = row([float(crank) for crank in cranks]), load_engine(name)
        shipped = crankcase_moments(example, SPEED_RPM, max_order=8)
        assert np.abs(shipped - crankcase_moments(textbook, SPEED_RPM, max_order=8)).max() < 1e-10 * FIRST_N
        assert [cylinder.crank_deg for cylinder in example.cylinders] == cranks


def test_a_counterweight_takes_the_whole_first_order_of_a_90_degree_v_twin() -> None:
    forces = np.abs(crankcase_forces(load_engine("v-twin"), SPEED_RPM, max_order=8)) / FIRST_N
    assert forces[:, 1].max() < 1e-7  # the shipped counterweight is rounded to 0.1 g·mm
    without = load_engine("v-twin").model_copy(update={"rotating_unbalance_kg_m": 0.0})
    first = crankcase_forces(without, SPEED_RPM, max_order=8)[:, 1] / FIRST_N
    assert first[Z_SEVERAL] == pytest.approx(1.0, rel=1e-12)
    assert first[X_SEVERAL] == pytest.approx(-1j, rel=1e-12)  # constant size, turning with the crank
    assert forces[X_SEVERAL, 2] == pytest.approx(np.sqrt(2) * A2, rel=1e-12)
    assert forces[Z_SEVERAL, 2] < 1e-15
    assert forces[Z_SEVERAL, 4] == pytest.approx(np.sqrt(2) * A4, rel=1e-12)


def test_shafts_take_the_second_order_of_an_inline_four() -> None:
    shafts = {"orders": [2], "unbalanced_mass_kg": 0.1}
    with_shafts, without = row([0.0, 180.0, 180.0, 0.0], shafts=shafts), row([0.0, 180.0, 180.0, 0.0])
    left = crankcase_forces(with_shafts, SPEED_RPM, max_order=6)[Z_SEVERAL]
    whole = crankcase_forces(without, SPEED_RPM, max_order=6)[Z_SEVERAL]
    assert left[2] == pytest.approx(whole[2] * 0.1 / MASS_KG, rel=1e-12)
    assert left[4] == whole[4]


def test_what_cancels_to_round_off_is_no_order_that_the_engine_makes() -> None:
    in_one_plane = [{"crank_deg": angle} for angle in (0.0, 120.0, 240.0)]
    engine = row([0.0]).model_copy(update={"cylinders": row([0.0] * 3, cylinders=in_one_plane).cylinders})
    assert orders_made(engine, share=1e-3, max_order=5) == ()
    assert orders_made(engine, share=1e-3, max_order=6) == (6.0,)
    assert orders_made(load_engine("inline-3"), share=1e-3, max_order=5) == (1.0, 2.0, 4.0)
