"""Counterweights: Task 5 as printed, the exact forces of the truth sheet, and the laws behind the strategies."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.balance_data import load_balanced_engine, reduced_masses
from crankorder.engine.balancing import (
    CounterweightPlaces,
    ReducedMasses,
    balanced,
    counterweights,
    force_by_order,
    phasor,
    polar_diagram,
    rod_counterweight_couple,
)
from crankorder.engine.slider_crank import SliderCrank, plain_piston_acceleration
from crankorder.errors import RequestError

ANGLES = np.arange(720) / 720
TASK5 = load_balanced_engine("task5")
PLACES = TASK5.balance.places


@pytest.fixture
def masses() -> ReducedMasses:
    """Task 5 before balancing."""
    return reduced_masses(TASK5)


def test_literature_counterweights_are_those_printed(masses: ReducedMasses) -> None:
    strategies: tuple[Any, ...] = ("a", "b", "c", "d")
    added = {strategy: counterweights(masses, strategy, PLACES) for strategy in strategies}
    assert {key: one.crank_g for key, one in added.items()} == {"a": 962.5, "b": 562.5, "c": 762.5, "d": 1962.5}
    assert (added["d"].rod_g, added["d"].total_g) == (800, 2762.5)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["none", "a", "b", "c", "d"])
def test_residual_first_orders_are_those_of_the_truth_sheet(
    masses: ReducedMasses, strategy: Any, shared_truth: dict[str, Any]
) -> None:
    key = "unbalanced" if strategy == "none" else strategy
    x_g, y_g = shared_truth["seed000"]["residual_first_harmonic_over_l1w2"]["amplitudes_g"][key]
    first = force_by_order(balanced(masses, strategy), max_order=2)[0]
    assert abs(first.x_g_mm) == 25 * x_g
    assert abs(first.y_g_mm) == 25 * y_g


@pytest.mark.slow
def test_strategy_c_leaves_a_constant_force_that_turns_against_the_crank(masses: ReducedMasses) -> None:
    first = force_by_order(balanced(masses, "c"), max_order=1)[0]
    assert first.rotation == "against crank"
    assert np.abs(polar_diagram([first], ANGLES)) == pytest.approx(np.full(720, 160.0 * 25), rel=1e-14)
    assert [force_by_order(balanced(masses, name), max_order=1)[0].rotation for name in ("none", "a", "b", "d")] == [
        "with crank",
        "line",
        "line",
        "none",
    ]


def test_frame_forces_are_those_of_the_truth_sheet(masses: ReducedMasses, shared_truth: dict[str, Any]) -> None:
    table = shared_truth["seed000"]["Fx_Fy_reference_g_mm_at_omega_1_lambda_0.25_l1_25"]
    force = polar_diagram(force_by_order(masses, max_order=40), np.array([float(angle) for angle in table]) / 360)
    known = np.array([complex(float(x), float(y)) for x, y in table.values()])
    assert len(known) == 12
    assert np.abs(force - known).max() < 1e-12 * np.abs(known).max()


def test_analytic_orders_add_up_to_the_exact_force_with_offset_too(masses: ReducedMasses) -> None:
    offset = SliderCrank(crank_radius_m=0.025, rod_length_m=0.1, offset_m=0.007)
    for model in (masses, ReducedMasses(mechanism=offset, rotating_g=450 * np.exp(0.3j), reciprocating_g=320.0)):
        pin = model.crank_radius_mm * model.rotating_g * np.exp(2j * np.pi * ANGLES)
        exact = pin + 1e3 * model.reciprocating_g * plain_piston_acceleration(ANGLES, model.mechanism)
        assert np.abs(polar_diagram(force_by_order(model, max_order=40), ANGLES) - exact).max() < 1e-13 * 19250


def test_analytic_the_couple_of_strategy_d_is_the_rate_of_angular_momentum(masses: ReducedMasses) -> None:
    added = counterweights(masses, "d", PLACES)
    step = 1e-4
    angle = 2 * np.pi * ANGLES

    def place(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 25 * np.cos(phi) - 40 * np.sqrt(1 - (np.sin(phi) / 4) ** 2), (25 + 40 / 4) * np.sin(phi)

    (x, y), (x_on, y_on), (x_back, y_back) = place(angle), place(angle + step), place(angle - step)
    rate = x * (y_on - 2 * y + y_back) / step**2 - y * (x_on - 2 * x + x_back) / step**2
    couple = rod_counterweight_couple(masses, added, PLACES, ANGLES)
    assert np.abs(couple + 800 * rate).max() < 1e-6 * np.abs(couple).max()
    assert np.abs(couple).max() > 1e6


def test_strategy_d_without_a_place_on_the_rod_is_refused(masses: ReducedMasses) -> None:
    with pytest.raises(RequestError, match="rod_mm"):
        counterweights(masses, "d", CounterweightPlaces(crank_mm=20.0))


@pytest.mark.parametrize("strategy", ["c", "none", "a", "b", "d"])
@pytest.mark.parametrize("angle_deg", [37.0, 0.0, 90.0, 180.0, 217.0])
def test_analytic_counterweights_end_an_unbalance_at_any_angle(strategy: Any, angle_deg: float) -> None:
    turned = ReducedMasses(
        mechanism=TASK5.engine.mechanism, rotating_g=1000 * phasor(angle_deg), reciprocating_g=1000.0
    )
    added, meant = counterweights(turned, strategy, PLACES), balanced(turned, strategy)
    lever = PLACES.rod_mm / turned.rod_length_mm  # a mass beyond the pin weighs on it with more than itself
    on_crank = added.crank_g * PLACES.crank_mm / turned.crank_radius_mm * phasor(added.crank_deg)
    assert abs(turned.rotating_g + added.rod_g * (1 + lever) - on_crank - meant.rotating_g) < 1e-12 * 1000
    assert turned.reciprocating_g - added.rod_g * lever == pytest.approx(meant.reciprocating_g, abs=1e-12 * 1000)
