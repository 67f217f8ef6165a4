"""Counterweights and shafts of one cylinder: Task 5 as printed, the truth sheet, and the laws behind the strategies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.balance_data import CounterweightPlaces, load_balanced_engine
from crankorder.engine.balance_sheet import leading_harmonics
from crankorder.engine.balancing import (
    POSSIBILITIES,
    STRATEGIES,
    OrderForce,
    balanced,
    counterweights,
    forces_of,
    phasor,
    polar_diagram,
    rod_counterweight_couple,
    systems,
    with_shafts,
)
from crankorder.engine.definition import Engine
from crankorder.engine.slider_crank import even_harmonics, plain_piston_acceleration
from crankorder.errors import RequestError

ANGLES = np.arange(720) / 720
TASK5 = load_balanced_engine("task5")
ENGINE, PLACES = TASK5.engine, TASK5.balance.places


def turned(angle_deg=0.0, offset_m=0.0):
    """Task 5 with an unbalance at an angle from its pin, and with an offset."""
    changes = {"rotating_unbalance_deg": angle_deg, "offset_m": offset_m}
    return Engine.model_validate(ENGINE.model_dump() | changes)


def test_frame_forces_are_those_of_the_truth_sheet(shared_truth):
    table = shared_truth["seed000"]["Fx_Fy_reference_g_mm_at_omega_1_lambda_0.25_l1_25"]
    force = polar_diagram(forces_of(ENGINE, 40), np.array([float(angle) for angle in table]) / 360)
    known = np.array([complex(float(x), float(y)) for x, y in table.values()])
    assert len(known) == 12
    assert np.abs(force - known).max() < 1e-12 * np.abs(known).max()


@pytest.mark.parametrize("engine", [turned(), turned(17.0, 0.007)])
def test_analytic_orders_add_up_to_the_exact_force_with_offset_too(engine):
    pin = 11250 * phasor(engine.rotating_unbalance_deg) * np.exp(2j * np.pi * ANGLES)
    exact = pin + 320e3 * plain_piston_acceleration(ANGLES, engine.mechanism)
    assert np.abs(polar_diagram(forces_of(engine, 40), ANGLES) - exact).max() < 1e-12 * 19250


def test_analytic_the_couple_of_strategy_d_is_the_rate_of_angular_momentum():
    step = 1e-4
    angle = 2 * np.pi * ANGLES

    def place(phi):
        return 25 * np.cos(phi) - 40 * np.sqrt(1 - (np.sin(phi) / 4) ** 2), (25 + 40 / 4) * np.sin(phi)

    (x, y), (x_on, y_on), (x_back, y_back) = place(angle), place(angle + step), place(angle - step)
    rate = x * (y_on - 2 * y + y_back) / step**2 - y * (x_on - 2 * x + x_back) / step**2
    couple = rod_counterweight_couple(ENGINE, counterweights(ENGINE, "d", PLACES).rod_g, 40.0, ANGLES)
    assert np.abs(couple + 800 * rate).max() < 1e-6 * np.abs(couple).max()
    assert np.abs(couple).max() > 1e6


def test_strategy_d_without_a_place_on_the_rod_is_refused():
    with pytest.raises(RequestError, match="rod_mm"):
        counterweights(ENGINE, "d", CounterweightPlaces(crank_mm=20.0))


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("angle_deg", [37.0, 90.0, 180.0])
def test_analytic_counterweights_end_an_unbalance_at_any_angle(strategy, angle_deg):
    engine = turned(angle_deg)
    added, meant = counterweights(engine, strategy, PLACES), balanced(engine, strategy)
    lever = PLACES.rod_mm / 100  # a mass beyond the pin weighs on it with more than itself
    on_crank = added.crank_g * PLACES.crank_mm * phasor(added.crank_deg)
    before, after = (1e6 * one.rotating_unbalance_kg_m * phasor(one.rotating_unbalance_deg) for one in (engine, meant))
    assert abs(before + added.rod_g * (1 + lever) * 25 - on_crank - after) < 1e-11 * 11250
    assert 320 - added.rod_g * lever == pytest.approx(1e3 * meant.reciprocating_mass_kg, abs=1e-9)


@pytest.mark.parametrize(("possibility", "first_left"), [("1", 2), ("2", 1), ("3", 4), ("4", 2), ("4+2", 4)])
def test_literature_each_possibility_cancels_what_task_5_says(possibility, first_left):
    left = [force for force in forces_of(with_shafts(ENGINE, possibility), 8) if force.rotation != "none"]
    assert left[0].order == first_left
    assert all(force.across_g_mm == 0 for force in left)
    offset = {force.order: force for force in forces_of(with_shafts(turned(offset_m=0.006), "3"), 4)}
    assert offset[1].rotation == offset[2].rotation == "none"
    assert abs(offset[3].along_g_mm) > 1


def test_a_single_cylinder_has_every_strategy_and_possibility_whatever_way_it_leans():
    assert list(systems(TASK5)) == ["none", *STRATEGIES, *POSSIBILITIES]


# Forces by order as rotating parts: axes, ellipses, direction of rotation.


PARTS = st.complex_numbers(max_magnitude=1e6, allow_nan=False, allow_infinity=False)


@given(x=PARTS, y=PARTS, order=st.integers(1, 6))
def test_analytic_rotating_parts_draw_the_curve_of_their_axes_within_their_largest(x, y, order):
    force = OrderForce.of_axes(order=order, along_g_mm=x, across_g_mm=y)
    turn = np.exp(2j * np.pi * order * ANGLES)
    expected = (x * turn).real + 1j * (y * turn).real
    scale = abs(x) + abs(y) + 1e-300
    curve = polar_diagram([force], ANGLES)
    assert np.abs(curve - expected).max() <= 1e-12 * scale
    assert abs(force.along_g_mm - x) + abs(force.across_g_mm - y) <= 1e-14 * scale
    assert np.abs(curve).max() == pytest.approx(force.largest_g_mm, rel=1e-3, abs=1e-12 * scale)


def test_the_direction_of_rotation_is_that_of_the_drawn_curve():
    turning = {(2, -2j): "with crank", (2, 2j): "against crank", (5, -1j): "with crank"}
    for (x, y), rotation in (turning | {(2, 0): "line", (0, -3j): "line", (0, 0): "none"}).items():
        force = OrderForce.of_axes(order=1, along_g_mm=x, across_g_mm=y)
        assert force.rotation == rotation
        curve = polar_diagram([force], ANGLES)
        area = float(np.sum((curve.conj() * np.roll(curve, -1)).imag))
        assert np.sign(round(area, 9)) == {"with crank": 1, "against crank": -1}.get(rotation, 0)


def test_analytic_leading_harmonics_are_the_limit_of_the_exact_ones():
    assert leading_harmonics(4, 0.5) == pytest.approx([0.5, 0.5**3 / 4, 9 * 0.5**5 / 128, 5 * 0.5**7 / 256], rel=1e-15)
    assert leading_harmonics(6, 1e-4) == pytest.approx(even_harmonics(6, 1e-4), rel=1e-6)
