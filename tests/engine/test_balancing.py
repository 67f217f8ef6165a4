"""Counterweights: Task 5 as printed, the exact forces of the truth sheet, and the laws behind the strategies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.balance_data import leading_harmonics, load_balanced_engine, reduced_masses
from crankorder.engine.balancing import (
    CounterweightPlaces,
    OrderForce,
    ReducedMasses,
    balanced,
    counterweights,
    force_by_order,
    phasor,
    polar_diagram,
    rod_counterweight_couple,
    sum_by_order,
)
from crankorder.engine.slider_crank import SliderCrank, even_harmonics, plain_piston_acceleration
from crankorder.errors import RequestError

ANGLES = np.arange(720) / 720
TASK5 = load_balanced_engine("task5")
PLACES = TASK5.balance.places


@pytest.fixture
def masses():
    """Task 5 before balancing."""
    return reduced_masses(TASK5)


def test_frame_forces_are_those_of_the_truth_sheet(masses, shared_truth):
    table = shared_truth["seed000"]["Fx_Fy_reference_g_mm_at_omega_1_lambda_0.25_l1_25"]
    force = polar_diagram(force_by_order(masses, max_order=40), np.array([float(angle) for angle in table]) / 360)
    known = np.array([complex(float(x), float(y)) for x, y in table.values()])
    assert len(known) == 12
    assert np.abs(force - known).max() < 1e-12 * np.abs(known).max()


def test_analytic_orders_add_up_to_the_exact_force_with_offset_too(masses):
    offset = SliderCrank(crank_radius_m=0.025, rod_length_m=0.1, offset_m=0.007)
    for model in (masses, ReducedMasses(mechanism=offset, rotating_g=450 * np.exp(0.3j), reciprocating_g=320.0)):
        pin = model.crank_radius_mm * model.rotating_g * np.exp(2j * np.pi * ANGLES)
        exact = pin + 1e3 * model.reciprocating_g * plain_piston_acceleration(ANGLES, model.mechanism)
        assert np.abs(polar_diagram(force_by_order(model, max_order=40), ANGLES) - exact).max() < 1e-13 * 19250


def test_analytic_the_couple_of_strategy_d_is_the_rate_of_angular_momentum(masses):
    added = counterweights(masses, "d", PLACES)
    step = 1e-4
    angle = 2 * np.pi * ANGLES

    def place(phi):
        return 25 * np.cos(phi) - 40 * np.sqrt(1 - (np.sin(phi) / 4) ** 2), (25 + 40 / 4) * np.sin(phi)

    (x, y), (x_on, y_on), (x_back, y_back) = place(angle), place(angle + step), place(angle - step)
    rate = x * (y_on - 2 * y + y_back) / step**2 - y * (x_on - 2 * x + x_back) / step**2
    couple = rod_counterweight_couple(masses, added, PLACES, ANGLES)
    assert np.abs(couple + 800 * rate).max() < 1e-6 * np.abs(couple).max()
    assert np.abs(couple).max() > 1e6


def test_strategy_d_without_a_place_on_the_rod_is_refused(masses):
    with pytest.raises(RequestError, match="rod_mm"):
        counterweights(masses, "d", CounterweightPlaces(crank_mm=20.0))


@pytest.mark.parametrize("strategy", ["c", "a", "b", "d"])
@pytest.mark.parametrize("angle_deg", [37.0, 0.0, 90.0, 180.0, 217.0])
def test_analytic_counterweights_end_an_unbalance_at_any_angle(strategy, angle_deg):
    turned = ReducedMasses(
        mechanism=TASK5.engine.mechanism, rotating_g=1000 * phasor(angle_deg), reciprocating_g=1000.0
    )
    added, meant = counterweights(turned, strategy, PLACES), balanced(turned, strategy)
    lever = PLACES.rod_mm / turned.rod_length_mm  # a mass beyond the pin weighs on it with more than itself
    on_crank = added.crank_g * PLACES.crank_mm / turned.crank_radius_mm * phasor(added.crank_deg)
    assert abs(turned.rotating_g + added.rod_g * (1 + lever) - on_crank - meant.rotating_g) < 1e-12 * 1000
    assert turned.reciprocating_g - added.rod_g * lever == pytest.approx(meant.reciprocating_g, abs=1e-12 * 1000)


# Forces by order as rotating parts: axes, ellipses, direction of rotation, and their sums.


PARTS = st.complex_numbers(max_magnitude=1e6, allow_nan=False, allow_infinity=False)
ANGLES_POLAR = np.arange(360) / 360


@given(x=PARTS, y=PARTS, order=st.integers(1, 6))
def test_analytic_rotating_parts_draw_the_curve_of_their_axes(x, y, order):
    force = OrderForce.of_axes(order=order, x_g_mm=x, y_g_mm=y)
    turn = np.exp(2j * np.pi * order * ANGLES_POLAR)
    expected = (x * turn).real + 1j * (y * turn).real
    scale = abs(x) + abs(y) + 1e-300
    assert np.abs(polar_diagram([force], ANGLES_POLAR) - expected).max() <= 1e-12 * scale
    assert abs(force.x_g_mm - x) + abs(force.y_g_mm - y) <= 1e-14 * scale


@pytest.mark.slow
def test_analytic_semi_axes_bound_the_curve():
    force = OrderForce.of_axes(order=1, x_g_mm=3 + 1j, y_g_mm=0.5 - 2j)
    size = np.abs(polar_diagram([force], np.arange(100_000) / 100_000))
    largest, smallest = force.semi_axes_g_mm
    assert size.max() == pytest.approx(largest, rel=1e-8)
    assert size.min() == pytest.approx(smallest, rel=1e-6)


def test_the_direction_of_rotation_is_that_of_the_drawn_curve():
    turning = {(2, -2j): "with crank", (2, 2j): "against crank", (5, -1j): "with crank"}
    for (x, y), rotation in (turning | {(2, 0): "line", (0, -3j): "line", (0, 0): "none"}).items():
        force = OrderForce.of_axes(order=1, x_g_mm=x, y_g_mm=y)
        assert force.rotation == rotation
        curve = polar_diagram([force], ANGLES_POLAR)
        area = float(np.sum((curve.conj() * np.roll(curve, -1)).imag))
        assert np.sign(round(area, 9)) == {"with crank": 1, "against crank": -1}.get(rotation, 0)


@pytest.mark.slow
def test_what_cancels_to_round_off_is_zero_and_what_does_not_is_kept():
    third = OrderForce(order=1, direct_g_mm=1 / 3)
    total = sum_by_order(
        [third, third, third, OrderForce(order=1, direct_g_mm=-1.0), OrderForce(order=2, reverse_g_mm=1)]
    )
    assert [force.order for force in total] == [1, 2]
    assert total[0].direct_g_mm == 0
    kept = sum_by_order([OrderForce(order=1, direct_g_mm=1.0), OrderForce(order=1, direct_g_mm=-1.0 + 1e-12)])
    assert kept[0].direct_g_mm == pytest.approx(1e-12, rel=1e-3)


# What stays unbalanced in the thesis engines: leading terms, spacer and offset.


def test_analytic_leading_harmonics_are_the_limit_of_the_exact_ones():
    assert leading_harmonics(4, 0.5) == pytest.approx([0.5, 0.5**3 / 4, 9 * 0.5**5 / 128, 5 * 0.5**7 / 256], rel=1e-15)
    assert leading_harmonics(6, 1e-4) == pytest.approx(even_harmonics(6, 1e-4), rel=1e-6)
