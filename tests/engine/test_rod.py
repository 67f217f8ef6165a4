"""The rod in two masses, what two masses miss, and what balancing for a rod that was cut in two leaves."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.balance_data import load_balanced_engine
from crankorder.engine.balancing import ReducedMasses, force_by_order, unbalance_force_n
from crankorder.engine.definition import Engine
from crankorder.engine.harmonics import rod_acceleration_harmonics
from crankorder.engine.rod import cut_consequences, rod_couple, two_masses

LENGTH_M, MASS_KG = 0.152, 1.6738
SCALE_CENTRE_M = 0.4114 / MASS_KG * LENGTH_M
OPTICAL = load_balanced_engine("msu-optical")
SPLITS = OPTICAL.balance.rod_split
assert SPLITS is not None


def engine(**rod: float) -> Engine:
    data = {"crank_radius_m": 0.0449, "rod_length_m": LENGTH_M, "reciprocating_mass_kg": 4.304}
    return Engine.model_validate({**data, "rod": {"mass_kg": MASS_KG, "centre_from_big_end_m": SCALE_CENTRE_M, **rod}})


@pytest.mark.slow
def test_the_weighed_rod_splits_as_weighed() -> None:
    masses = two_masses(engine())
    assert masses.big_end_kg == pytest.approx(1.2624, rel=1e-14)
    assert masses.small_end_kg == pytest.approx(0.4114, rel=1e-14)
    assert masses.missing_inertia_kg_m2 == 0


def test_two_masses_have_the_inertia_of_the_truth_sheet(shared_truth: dict[str, Any]) -> None:
    known = shared_truth["seed001"]["rod_inertia"]
    of_two = known["two_mass_J_about_cg_kg_m2 (m a b, scale split, l=152)"]
    assert 1 - two_masses(engine(inertia_kg_m2=1.0)).missing_inertia_kg_m2 == pytest.approx(of_two, rel=1e-12)
    uniform = known["uniform_rod_m_l2/12"]
    assert uniform == pytest.approx(MASS_KG * LENGTH_M**2 / 12, rel=1e-14)
    missing = two_masses(engine(inertia_kg_m2=uniform)).missing_inertia_kg_m2
    assert missing == pytest.approx(uniform - of_two, rel=1e-12)


def test_the_couple_has_the_sine_harmonics_of_the_truth_sheet(shared_truth: dict[str, Any]) -> None:
    model = engine(inertia_kg_m2=0.0032226229333333334)
    missing = two_masses(model).missing_inertia_kg_m2
    omega_squared = (2000 * np.pi / 30) ** 2
    couple = missing * omega_squared * rod_acceleration_harmonics(model.mechanism, 40)
    for order, known in shared_truth["seed001"]["rod_inertia"]["sine_harmonics_at_44.9/152"].items():
        assert couple[int(order)] == pytest.approx(-1j * missing * omega_squared * float(known), rel=1e-12)
    angles = np.arange(64) / 64
    summed = (couple[:, None] * np.exp(2j * np.pi * np.arange(41)[:, None] * angles)).real.sum(axis=0)
    assert np.abs(summed - rod_couple(model, angles, 2000.0)).max() < 1e-13 * np.abs(summed).max()


@pytest.mark.slow
def test_a_rod_of_two_masses_misses_nothing() -> None:
    assert not rod_couple(engine(), np.linspace(0, 1, 7), 3000.0).any()
    bare = Engine(crank_radius_m=0.0449, rod_length_m=LENGTH_M, reciprocating_mass_kg=1.0)
    assert two_masses(bare).big_end_kg == two_masses(bare).small_end_kg == 0


@pytest.mark.slow
def test_what_the_cut_implies_is_that_of_the_truth_sheet(shared_truth: dict[str, Any]) -> None:
    known = shared_truth["seed001"]["rod_split"]
    left = cut_consequences(SPLITS, OPTICAL.engine.mechanism)
    assert SPLITS.cut.centroid_fraction == pytest.approx(known["implied_cg_from_big_end_fraction_cad"], rel=1e-12)
    assert SPLITS.scale.centroid_fraction == pytest.approx(known["implied_cg_from_big_end_fraction_scale"], rel=1e-12)
    assert left.centroid_shift_mm == pytest.approx(known["cg_shift_mm_if_l_152"], rel=1e-12)
    assert left.rotating_deficit_g == pytest.approx(known["rotating_deficit_g"], rel=1e-12)
    assert left.reciprocating_excess_g == pytest.approx(known["reciprocating_excess_g"], rel=1e-12)
    assert left.y_first_g_mm == pytest.approx(known["X_first_order_residual_g_mm(44.9)"], rel=1e-12)
    # a difference of 0.4 g between numbers near 250 g: 1e-12 of these
    assert left.x_first_g_mm == pytest.approx(known["Z_first_order_residual_g_mm(44.9)"], abs=1e-12 * 11068)
    assert left.x_second_g_mm == pytest.approx(known["Z_second_order_overbalance_g_mm(44.9,A2)"], rel=1e-12)
    assert unbalance_force_n(left.y_first_g_mm, 2000) == pytest.approx(
        known["X_first_order_N_2000rpm(44.9)"], rel=1e-12
    )
    second_n = unbalance_force_n(left.x_second_g_mm, 2000)
    assert second_n == pytest.approx(known["Z_second_order_N_2000rpm(44.9,A2)"], rel=1e-12)


def test_analytic_consequences_of_the_cut_are_the_difference_of_two_engines() -> None:
    mechanism = OPTICAL.engine.mechanism
    built = ReducedMasses(mechanism=mechanism, rotating_g=1015.9, reciprocating_g=657.5)
    real = ReducedMasses(mechanism=mechanism, rotating_g=1262.4, reciprocating_g=411.4)
    orders = zip(force_by_order(real, max_order=2), force_by_order(built, max_order=2), strict=True)
    first, second = ((true.x_g_mm - meant.x_g_mm, true.y_g_mm - meant.y_g_mm) for true, meant in orders)
    left = cut_consequences(SPLITS, mechanism)
    assert abs(first[0]) == pytest.approx(left.x_first_g_mm, abs=1e-9)
    assert abs(first[1]) == pytest.approx(left.y_first_g_mm, rel=1e-12)
    assert second[0].real == pytest.approx(-left.x_second_g_mm, rel=1e-12)
