"""Claims of the MSU thesis (document 001) beside its tables, checked with the model: literature against analytic."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from crankorder.engine.balance_data import added_mass_force_n, leading_harmonics, load_balanced_engine, reduced_masses
from crankorder.engine.balancing import force_by_order, unbalance_force_n
from crankorder.engine.slider_crank import SliderCrank, piston_acceleration, rod_angle

OPTICAL = load_balanced_engine("msu-optical").engine.mechanism


def test_literature_highest_piston_speed_just_past_77_degrees_holds_for_two_terms_only(truth: dict[str, Any]) -> None:
    known = truth["seed000"]["max_piston_speed_angle_deg_lambda_0.25"]
    quarter = SliderCrank(crank_radius_m=0.25, rod_length_m=1.0)
    exact = 360 * brentq(lambda rev: float(piston_acceleration(rev, quarter)), 0.15, 0.25, xtol=1e-16, rtol=1e-15)
    assert exact == pytest.approx(float(known["exact"]), rel=1e-12)
    two_terms = math.degrees(brentq(lambda a: math.cos(a) + math.cos(2 * a) / 4, 1.2, 1.5, xtol=1e-16, rtol=1e-15))
    assert two_terms == pytest.approx(float(known["two_term"]), rel=1e-12)
    assert exact < 77 < two_terms < 77.05


def test_literature_forces_pull_the_same_way_at_top_dead_centre() -> None:
    # equations (4) and (10) print the second order with the other sign; the text, equation (2) and figure 7 are right
    forces = force_by_order(reduced_masses(load_balanced_engine("msu-optical")), max_order=2)
    first, second = (force.x_g_mm.real for force in forces)
    ratio = OPTICAL.crank_ratio
    assert second > 0
    assert piston_acceleration(0.0, OPTICAL) * 4304e3 == pytest.approx((1 + ratio) * first, rel=1e-14)
    assert first * leading_harmonics(1, ratio)[0] < second


def test_the_kinematic_forces_at_1725_rpm_cannot_make_orders_8_and_10(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["kinematic_force_optical_at_1725rpm_N"]
    forces = force_by_order(reduced_masses(load_balanced_engine("msu-optical")), max_order=10)
    for force in forces[1:]:
        found = unbalance_force_n(abs(force.x_g_mm), 1725)
        assert found == pytest.approx(known[f"{force.order:g}"], rel=1e-12)
        assert force.order < 8 or found < 0.03


def test_literature_order_frequencies_are_printed_truncated(truth: dict[str, Any]) -> None:
    for order, row in truth["seed001"]["order_frequency_2000rpm"].items():
        frequency_hz = float(order) * 2000 / 60
        assert frequency_hz == pytest.approx(row["exact"], rel=1e-12)
        assert math.floor(frequency_hz) == row["printed"]


def test_literature_accelerations_would_need_an_engine_of_twelve_thousand_tonnes(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["measured_ratios_Z_2000rpm"]
    force = added_mass_force_n(116.0, OPTICAL, 2000.0, max_order=2)
    assert force[1] / 1.95e-5 == pytest.approx(known["apparent_mass_kg_if_1.95e-5_were_m_s2"], rel=1e-12)
    share = known["force_ratio_second/first_exact_A2(44.9/152)"]
    assert force[2] / force[1] == pytest.approx(float(share), rel=1e-12)
    assert pytest.approx(known["config2_second/first"], rel=1e-12) == 0.0000174 / 0.0000195
    assert pytest.approx(known["config1_second/first"], rel=1e-12) == 0.0000648 / 0.0000846


def test_table_3_implies_a_light_engine_and_not_the_optical_one(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["table3"]["implied_geometry"]
    engine = load_balanced_engine("msu-shafts").engine
    assert engine.rod_length_m * 1e3 == pytest.approx(known["l_if_r_47.3 (Table 2 bob weight radius)"], rel=1e-12)
    mass_g = engine.reciprocating_mass_kg * 1e3
    assert mass_g == pytest.approx(known["m_recip_g_if_r_47.3"], rel=1e-12)
    ratio = float(truth["seed001"]["table3"]["lambda_implied_by_15001.4/49822.3"])
    assert engine.mechanism.crank_ratio == pytest.approx(ratio, rel=1e-12)
    assert mass_g < 1.1 * 1216 < 4304 / 3
    # were 15001.4 already a quarter of the force, the crank would be longer than the rod
    impossible = 4 * 15001.4 / 49822.3
    assert impossible == pytest.approx(
        truth["seed001"]["table3"]["factor_of_four"]["lambda_if_15001.4_were_already_divided_by_4"]
    )
    assert impossible > 1


def test_the_rod_angle_accelerates_with_the_odd_harmonics_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["rod_inertia"]["sine_harmonics_at_44.9/152"]
    n_angles = 256
    _, _, second = rod_angle(np.arange(n_angles) / n_angles, OPTICAL)
    sines = -2 / n_angles * np.fft.rfft(-second).imag
    for order, amplitude in known.items():
        assert sines[int(order)] == pytest.approx(float(amplitude), rel=1e-9, abs=1e-16)
    assert np.abs(sines[2:8:2]).max() < 1e-15
