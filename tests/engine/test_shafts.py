"""Balance shafts: possibilities of Task 5, table 3 of the thesis, and the squared ratio."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.balance_data import load_balanced_engine
from crankorder.engine.balancing import ReducedMasses, polar_diagram
from crankorder.engine.shafts import (
    Shaft,
    opposing_pair,
    pair_rounding_g_mm,
    parts_unbalance_g_mm,
    shaft_layout,
    shaft_unbalance_g_mm,
)
from crankorder.engine.slider_crank import SliderCrank

ANGLES = np.arange(360) / 360
PAIRS = {pair.order: pair for pair in load_balanced_engine("msu-shafts").balance.shaft_pairs}


def task5(crank_ratio: float = 0.25, offset_m: float = 0.0) -> ReducedMasses:
    mechanism = SliderCrank(crank_radius_m=0.025, rod_length_m=0.025 / crank_ratio, offset_m=offset_m)
    return ReducedMasses(mechanism=mechanism, rotating_g=450.0, reciprocating_g=320.0)


@pytest.mark.slow
def test_shafts_of_task_5_carry_the_masses_of_the_truth_sheet(shared_truth: dict[str, Any]) -> None:
    known = shared_truth["seed000"]["recovered"]
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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize(("order", "name"), [(1, "first"), (2, "second")])
def test_table_3_sums_are_those_of_the_truth_sheet(order: int, name: str, shared_truth: dict[str, Any]) -> None:
    known, parts = shared_truth["seed001"]["table3"][name], PAIRS[order].parts
    design = parts_unbalance_g_mm(parts, masses="design")
    measured = parts_unbalance_g_mm(parts, masses="measured")
    assert design == pytest.approx(known["one_shaft_cad"], rel=1e-12)
    assert measured == pytest.approx(known["one_shaft_measured"], rel=1e-12)
    assert 2 * design == pytest.approx(known["pair_cad"], rel=1e-12)
    assert 2 * measured == pytest.approx(known["pair_measured"], rel=1e-12)
    assert pair_rounding_g_mm(parts) == pytest.approx(known["pair_rounding_tolerance"], rel=1e-12)
