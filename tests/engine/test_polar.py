"""Forces by order as rotating parts: axes, ellipses, direction of rotation, and their sums."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.balancing import OrderForce, phasor, polar_diagram, sum_by_order

PARTS = st.complex_numbers(max_magnitude=1e6, allow_nan=False, allow_infinity=False)
ANGLES = np.arange(360) / 360


@given(x=PARTS, y=PARTS, order=st.integers(1, 6))
def test_analytic_rotating_parts_draw_the_curve_of_their_axes(x: complex, y: complex, order: int) -> None:
    force = OrderForce.of_axes(order=order, x_g_mm=x, y_g_mm=y)
    turn = np.exp(2j * np.pi * order * ANGLES)
    expected = (x * turn).real + 1j * (y * turn).real
    scale = abs(x) + abs(y) + 1e-300
    assert np.abs(polar_diagram([force], ANGLES) - expected).max() <= 1e-12 * scale
    assert abs(force.x_g_mm - x) + abs(force.y_g_mm - y) <= 1e-14 * scale


@pytest.mark.slow
def test_analytic_semi_axes_bound_the_curve() -> None:
    force = OrderForce.of_axes(order=1, x_g_mm=3 + 1j, y_g_mm=0.5 - 2j)
    size = np.abs(polar_diagram([force], np.arange(100_000) / 100_000))
    largest, smallest = force.semi_axes_g_mm
    assert size.max() == pytest.approx(largest, rel=1e-8)
    assert size.min() == pytest.approx(smallest, rel=1e-6)


def test_the_direction_of_rotation_is_that_of_the_drawn_curve() -> None:
    turning = {(2, -2j): "with crank", (2, 2j): "against crank", (5, -1j): "with crank"}
    for (x, y), rotation in (turning | {(2, 0): "line", (0, -3j): "line", (0, 0): "none"}).items():
        force = OrderForce.of_axes(order=1, x_g_mm=x, y_g_mm=y)
        assert force.rotation == rotation
        curve = polar_diagram([force], ANGLES)
        area = float(np.sum((curve.conj() * np.roll(curve, -1)).imag))
        assert np.sign(round(area, 9)) == {"with crank": 1, "against crank": -1}.get(rotation, 0)


@pytest.mark.slow
def test_what_cancels_to_round_off_is_zero_and_what_does_not_is_kept() -> None:
    third = OrderForce(order=1, direct_g_mm=1 / 3)
    total = sum_by_order(
        [third, third, third, OrderForce(order=1, direct_g_mm=-1.0), OrderForce(order=2, reverse_g_mm=1)]
    )
    assert [force.order for force in total] == [1, 2]
    assert total[0].direct_g_mm == 0
    kept = sum_by_order([OrderForce(order=1, direct_g_mm=1.0), OrderForce(order=1, direct_g_mm=-1.0 + 1e-12)])
    assert kept[0].direct_g_mm == pytest.approx(1e-12, rel=1e-3)


@pytest.mark.slow
def test_phasors_are_exact_at_quarter_turns() -> None:
    assert [phasor(angle) for angle in (0, 90, 180, 270, -90, 540)] == [1, 1j, -1, -1j, -1j, -1]
    assert phasor(30.0) == pytest.approx(complex(math.sqrt(3) / 2, 0.5), rel=1e-15)
