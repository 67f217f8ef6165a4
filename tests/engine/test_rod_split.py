"""The rod divided by a cut and by a scale: printed masses, what they imply, and what balancing for the cut leaves."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.balance_data import load_balanced_engine
from crankorder.engine.balancing import ReducedMasses, force_by_order, unbalance_force_n
from crankorder.engine.rod import RodSplit, cut_consequences, split_by_scale, two_mass_inertia_g_mm2

OPTICAL = load_balanced_engine("msu-optical")
SPLITS = OPTICAL.balance.rod_split
assert SPLITS is not None


def test_literature_totals_of_both_methods_agree_within_a_gram() -> None:
    assert round(SPLITS.cut.total_g, 1) == 1673.4
    assert round(SPLITS.scale.total_g, 1) == 1673.8
    assert SPLITS.weighed_whole_g is not None
    assert round(SPLITS.scale.total_g - SPLITS.weighed_whole_g, 1) == 0.8


def test_what_the_cut_implies_is_that_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["rod_split"]
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


@given(mass=st.floats(1, 1e4), fraction=st.floats(0.01, 0.99))
def test_analytic_the_scale_keeps_mass_and_centre_of_gravity(mass: float, fraction: float) -> None:
    split = split_by_scale(rod_mass_g=mass, centroid_fraction=fraction)
    assert split.total_g == pytest.approx(mass, rel=1e-14)
    assert split.centroid_fraction == pytest.approx(fraction, rel=1e-13)


def test_two_masses_have_the_inertia_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["rod_inertia"]["two_mass_J_about_cg_kg_m2 (m a b, scale split, l=152)"]
    assert two_mass_inertia_g_mm2(SPLITS.scale, 152.0) * 1e-9 == pytest.approx(known, rel=1e-12)
    dumbbell = RodSplit(big_end_g=2.0, small_end_g=1.0)
    assert two_mass_inertia_g_mm2(dumbbell, 3.0) == pytest.approx(2 * 1**2 + 1 * 2**2)


def test_literature_the_fault_of_the_cut_exceeds_the_spacer() -> None:
    left = cut_consequences(SPLITS, OPTICAL.engine.mechanism)
    assert left.y_first_g_mm > 2 * 116 * 44.9
    assert np.isclose(left.x_first_g_mm, 17.96)
