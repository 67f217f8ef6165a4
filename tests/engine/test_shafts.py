"""Balance shafts: possibilities of Task 5, table 3 of the thesis with its factor of four, and the squared ratio."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.balance_data import load_balanced_engine, reduced_masses
from crankorder.engine.balancing import ReducedMasses, polar_diagram, unbalance_force_n
from crankorder.engine.shafts import (
    Shaft,
    opposing_pair,
    pair_rounding_g_mm,
    pair_scenarios,
    parts_unbalance_g_mm,
    shaft_layout,
    shaft_unbalance_g_mm,
)
from crankorder.engine.slider_crank import SliderCrank
from crankorder.errors import RequestError

ANGLES = np.arange(360) / 360
PAIRS = {pair.order: pair for pair in load_balanced_engine("msu-shafts").balance.shaft_pairs}


def task5(crank_ratio: float = 0.25, offset_m: float = 0.0) -> ReducedMasses:
    mechanism = SliderCrank(crank_radius_m=0.025, rod_length_m=0.025 / crank_ratio, offset_m=offset_m)
    return ReducedMasses(mechanism=mechanism, rotating_g=450.0, reciprocating_g=320.0)


def test_shafts_of_task_5_carry_the_masses_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed000"]["recovered"]
    for shaft in shaft_layout(task5(), "1", max_order=4).shafts + shaft_layout(task5(), "4", max_order=4).shafts:
        assert shaft.unbalance_g_mm / 25 == known["mz1*lz1/l1_g (possibilities 1,3 each of two; 4 single)"]
    for name, second_g in known["mz2*lz2/l1_g at lambda"].items():
        numerator, _, denominator = name.partition("/")
        ratio = float(numerator) / float(denominator or 1)
        shafts = shaft_layout(task5(ratio), "2", max_order=4).shafts
        assert [shaft.unbalance_g_mm / 25 for shaft in shafts] == pytest.approx([second_g] * 2, rel=1e-12)
        assert [shaft.speed_ratio for shaft in shafts] == [2, -2]


@pytest.mark.parametrize(("possibility", "first_left"), [("1", 2), ("2", 1), ("3", 4), ("4", 2), ("4+2", 4)])
def test_literature_each_possibility_cancels_what_task_5_says(possibility: Any, first_left: int) -> None:
    layout = shaft_layout(task5(), possibility, max_order=8)
    left = [force for force in layout.residual if force.rotation != "none"]
    assert left[0].order == first_left
    assert all(force.y_g_mm == 0 for force in left)
    without = [force for force in layout.residual if force.rotation == "none"]
    assert sorted({force.order for force in without} | {force.order for force in left}) == [1, 2, 4, 6, 8]


def test_one_shaft_against_the_crank_does_the_work_of_a_pair_and_a_counterweight() -> None:
    four = shaft_layout(task5(), "4", max_order=6)
    assert (four.strategy, [shaft.speed_ratio for shaft in four.shafts]) == ("c", [-1])
    assert four.residual == shaft_layout(task5(), "1", max_order=6).residual


@given(k=st.floats(0.25, 8), phase=st.floats(-180, 180), size=st.floats(0.1, 1e5))
def test_analytic_a_pair_makes_its_unbalance_times_the_squared_speed_ratio(k: float, phase: float, size: float) -> None:
    pair = [Shaft(speed_ratio=sign * k, unbalance_g_mm=size, phase_deg=sign * phase) for sign in (1, -1)]
    angle = 2 * np.pi * ANGLES
    # each shaft as a point that turns: minus its second derivative by crank angle
    force = sum(k**2 * size * np.exp(1j * sign * (k * angle + np.radians(phase))) for sign in (1, -1))
    assert np.abs(polar_diagram([shaft.force for shaft in pair], ANGLES) - force).max() < 1e-12 * k**2 * size
    assert np.abs(force.imag).max() < 1e-12 * k**2 * size
    assert shaft_unbalance_g_mm(2 * k**2 * size, order=k) == pytest.approx(size, rel=1e-14)


@given(x=st.complex_numbers(min_magnitude=1, max_magnitude=1e6), order=st.integers(1, 6))
def test_analytic_an_opposing_pair_cancels_its_force_at_every_angle(x: complex, order: int) -> None:
    left = polar_diagram([shaft.force for shaft in opposing_pair(x, order=order)], ANGLES)
    left += (x * np.exp(2j * np.pi * order * ANGLES)).real
    assert np.abs(left).max() < 1e-12 * abs(x)


def test_shafts_timed_to_an_offset_engine_cancel_its_first_and_second_order_wholly() -> None:
    left = {force.order: force for force in shaft_layout(task5(offset_m=0.006), "3", max_order=4).residual}
    assert left[1].rotation == left[2].rotation == "none"
    assert abs(left[3].x_g_mm) > 1


@pytest.mark.parametrize(("order", "name"), [(1, "first"), (2, "second")])
def test_table_3_sums_are_those_of_the_truth_sheet(order: int, name: str, truth: dict[str, Any]) -> None:
    known, parts = truth["seed001"]["table3"][name], PAIRS[order].parts
    design = parts_unbalance_g_mm(parts, masses="design")
    measured = parts_unbalance_g_mm(parts, masses="measured")
    assert design == pytest.approx(known["one_shaft_cad"], rel=1e-12)
    assert measured == pytest.approx(known["one_shaft_measured"], rel=1e-12)
    assert 2 * design == pytest.approx(known["pair_cad"], rel=1e-12)
    assert 2 * measured == pytest.approx(known["pair_measured"], rel=1e-12)
    assert pair_rounding_g_mm(parts) == pytest.approx(known["pair_rounding_tolerance"], rel=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_literature_table_3_agrees_with_the_printed_pairs_within_its_rounding_and_no_better(order: int) -> None:
    pair = PAIRS[order]
    assert pair.printed_pair_g_mm is not None
    assert pair.printed_needed_g_mm is not None
    rounding = pair_rounding_g_mm(pair.parts)
    for kind in ("design", "measured"):
        assert abs(2 * parts_unbalance_g_mm(pair.parts, masses=kind) - pair.printed_pair_g_mm) < rounding
    quoted = pair.printed_needed_g_mm - pair.printed_pair_g_mm
    assert round(quoted, 1) == {1: 7.5, 2: 7.6}[order]
    assert rounding > 19 * quoted


def test_the_sum_of_amounts_of_one_first_order_shaft_is_no_reading_of_table_3(truth: dict[str, Any]) -> None:
    parts = [part.model_copy(update={"centroid_mm": abs(part.centroid_mm)}) for part in PAIRS[1].parts]
    amounts = parts_unbalance_g_mm(parts, masses="design")
    assert amounts == pytest.approx(truth["seed001"]["table3"]["first"]["sum_of_absolute_values_cad"], rel=1e-12)
    assert abs(amounts - 4 * 49822.3) > 1.4 * pair_rounding_g_mm(PAIRS[1].parts) / 2


def test_the_factor_of_four_read_literally_and_physically(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["table3"]["factor_of_four"]
    read = pair_scenarios(pair_unbalance_g_mm=14993.8, needed_force_g_mm=15001.4, order=2)
    literal, physical = read["literal"], read["physical"]
    assert literal.overbalance == pytest.approx(known["overbalance_ratio"], rel=1e-12)
    net = known["net_second_order_moment_at_crank_speed_equivalent_g_mm"]
    assert literal.residual_g_mm == pytest.approx(net, rel=1e-12)
    assert abs(literal.residual_g_mm) / 15001.4 == pytest.approx(known["net_over_unbalanced"], rel=1e-12)
    force_n = unbalance_force_n(abs(literal.residual_g_mm), 2000)
    assert force_n == pytest.approx(known["force_N_2000rpm_if_literal"], rel=1e-12)
    assert unbalance_force_n(15001.4, 2000) == pytest.approx(known["force_N_2000rpm_no_shafts"], rel=1e-12)
    # 15001.4 − 14993.8 loses four digits: the inputs carry one decimal
    assert physical.residual_g_mm == pytest.approx(7.6, rel=1e-9)
    left_n = unbalance_force_n(physical.residual_g_mm, 2000)
    assert left_n == pytest.approx(known["force_N_2000rpm_if_4_already_inside"], rel=1e-9)
    built_right = 2 * shaft_unbalance_g_mm(15001.4, order=2)
    assert built_right == pytest.approx(known["second_order_pair_moment_correct_for_2omega"], rel=1e-12)
    doubled = pair_scenarios(pair_unbalance_g_mm=2 * 14993.8, needed_force_g_mm=15001.4, order=2)["literal"]
    known_doubled = known["per_shaft_reading (two shafts, each 14993.8)"]
    assert doubled.overbalance == pytest.approx(known_doubled, rel=1e-12)
    half = parts_unbalance_g_mm(PAIRS[2].parts, masses="measured")
    single = pair_scenarios(pair_unbalance_g_mm=half, needed_force_g_mm=15001.4, order=2)["literal"]
    known_single = known["single_total_reading_one_shaft_only (7466 one shaft x4 /15001)"]
    assert single.overbalance == pytest.approx(known_single, rel=3e-4)


def test_at_crank_speed_both_readings_are_one() -> None:
    read = pair_scenarios(pair_unbalance_g_mm=49814.8, needed_force_g_mm=49822.3, order=1)
    assert read["literal"] == read["physical"]
    assert read["literal"].residual_g_mm == pytest.approx(7.5, rel=1e-9)


def test_shafts_built_for_the_crank_ratio_leave_the_shortfall_of_the_truth_sheet(truth: dict[str, Any]) -> None:
    known = truth["seed001"]["table3"]["factor_of_four"]
    masses = reduced_masses(load_balanced_engine("msu-shafts"))
    needed = abs({force.order: force for force in shaft_layout(masses, "1", max_order=2).residual}[2].x_g_mm)
    assert needed == pytest.approx(known["needed_second_order_exact_g_mm"], rel=1e-12)
    assert needed - 15001.4 == pytest.approx(
        known["residual_second_order_if_shaft_cancels_lambda_only_g_mm"], rel=1e-10
    )


def test_too_few_orders_for_a_residual_are_refused() -> None:
    with pytest.raises(RequestError, match="orders"):
        shaft_layout(task5(), "3", max_order=1)
