"""The kinematics against 60-digit arithmetic and the derivatives of its own motion."""

from decimal import Decimal, getcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.balance_data import load_balanced_engine, rod_balance
from crankorder.engine.balancing import unbalance_force_n
from crankorder.engine.definition import Engine
from crankorder.engine.forces import two_masses
from crankorder.engine.slider_crank import (
    SliderCrank,
    dead_centres,
    piston_acceleration,
    piston_drop,
    piston_velocity,
    plain_piston_acceleration,
    rod_acceleration_harmonics,
    rod_angle,
)
from crankorder.errors import RequestError

getcontext().prec = 60
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
THESIS = SliderCrank(crank_radius_m=0.0449, rod_length_m=0.152, offset_m=0.010)
SHAPES = st.builds(
    lambda ratio, share: SliderCrank(crank_radius_m=ratio, rod_length_m=1.0, offset_m=share * (1 - ratio)),
    st.floats(0.01, 0.9),
    st.floats(-0.8, 0.8),
)


def decimal_sine_cosine(angle: Decimal) -> tuple[Decimal, Decimal]:
    sums, term = [Decimal(0), Decimal(0)], Decimal(1)
    for k in range(1, 120):
        sums[(k - 1) % 2] += term * (-1) ** ((k - 1) // 2)
        term *= angle / k
    return sums[1], sums[0]


def decimal_acceleration(revolutions: float, mechanism: SliderCrank) -> Decimal:
    sine, cosine = decimal_sine_cosine(2 * PI * Decimal(revolutions))
    radius, rod, offset = (Decimal(x) for x in (mechanism.crank_radius_m, mechanism.rod_length_m, mechanism.offset_m))
    across, slope = radius * sine - offset, radius * cosine
    along = (rod * rod - across * across).sqrt()
    return radius * cosine + (slope**2 - across * radius * sine) / along + across**2 * slope**2 / along**3


@pytest.mark.parametrize("slack", [0.7, 1e-2, 1e-6, 1e-9, 1e-12])
def test_the_acceleration_keeps_its_digits_however_short_the_rod(slack: float) -> None:
    mechanism = SliderCrank(crank_radius_m=1 - slack, rod_length_m=1.0)
    kappa = np.sqrt(slack * (2 - slack))
    angles = np.concatenate([np.linspace(0, 1, 41), 0.25 + kappa * np.linspace(-1, 1, 21), [0.75 + 3 * kappa / 7]])
    exact = np.array([float(decimal_acceleration(float(angle), mechanism)) for angle in angles])
    peak = max(2 - slack, (1 - slack) / kappa)
    assert np.abs(piston_acceleration(angles, mechanism) - exact).max() <= 1e-15 * peak


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.01, -0.03])
def test_the_acceleration_with_offset_agrees_with_sixty_digits(offset: float) -> None:
    mechanism = SliderCrank(crank_radius_m=0.0449, rod_length_m=0.152, offset_m=offset)
    angles = np.linspace(-1, 2, 61)
    exact = np.array([float(decimal_acceleration(float(angle), mechanism)) for angle in angles])
    assert np.abs(piston_acceleration(angles, mechanism) - exact).max() <= 1e-15 * np.abs(exact).max()


def decimal_motion(revolutions: float, mechanism: SliderCrank) -> dict[str, Decimal]:
    """Drop, velocity, sine of the rod angle and its derivatives, straight from the definitions."""
    sine, cosine = decimal_sine_cosine(2 * PI * Decimal(revolutions))
    radius, rod, offset = (Decimal(x) for x in (mechanism.crank_radius_m, mechanism.rod_length_m, mechanism.offset_m))
    across, slope = radius * sine - offset, radius * cosine
    along, top = (rod * rod - across * across).sqrt(), (rod * rod - offset * offset).sqrt()
    return {
        "drop": radius + top - radius * cosine - along,
        "velocity": -radius * sine - across * slope / along,
        "rod_sine": across / rod,
        "rod_first": slope / along,
        "rod_second": -radius * sine / along + across * slope**2 / along**3,
    }


@pytest.mark.parametrize("slack", [0.7, 1e-2, 1e-6, 1e-12])
@pytest.mark.parametrize("share", [0.0, 0.5, -0.5])
def test_position_velocity_and_rod_angle_keep_their_own_digits_however_short_the_rod(
    slack: float, share: float
) -> None:
    mechanism = SliderCrank(crank_radius_m=1 - slack, rod_length_m=1.0, offset_m=share * slack)
    angles = np.concatenate([np.arange(1, 8) / 8, np.linspace(0, 1, 38)[1:-1], 0.25 + 1e-3 * np.linspace(-1, 1, 9)])
    exact = [decimal_motion(float(angle), mechanism) for angle in angles]
    psi, first, second = rod_angle(angles, mechanism)
    computed = {
        "drop": piston_drop(angles, mechanism),
        "velocity": piston_velocity(angles, mechanism),
        "rod_sine": np.sin(psi),
        "rod_first": first,
        "rod_second": second,
    }
    for name, values in computed.items():
        known = np.array([float(row[name]) for row in exact])
        sizes = np.where(np.abs(known) < 1e-40, 1.0, np.abs(known))  # an exact zero has no relative error
        assert np.abs((values - known) / sizes).max() < (2e-15 if share == 0 else 5e-15), name


@given(SHAPES, st.floats(-1e4, 1e4))
def test_the_compiled_acceleration_is_that_of_plain_numpy(mechanism: SliderCrank, start: float) -> None:
    angles = start + np.linspace(0, 1.5, 997)
    plain = plain_piston_acceleration(angles, mechanism)
    assert np.abs(piston_acceleration(angles, mechanism) - plain).max() <= 2e-15 * np.abs(plain).max()


@given(SHAPES)
def test_the_piston_turns_at_its_dead_centres_a_stroke_apart(mechanism: SliderCrank) -> None:
    turns = dead_centres(mechanism)
    there = np.array([turns.top_rev, turns.bottom_rev])
    assert np.abs(piston_velocity(there, mechanism)).max() < 1e-14 / mechanism.slack
    drop = piston_drop(there, mechanism)
    assert drop[1] - drop[0] == pytest.approx(turns.stroke_m, rel=1e-13)
    every = piston_drop(np.linspace(0, 1, 3601), mechanism)
    assert drop[0] <= every.min() + 1e-15
    assert every.max() <= drop[1] + 1e-15
    assert turns.stroke_m >= 2 * mechanism.crank_radius_m * (1 - 1e-15)


def test_a_whole_turn_changes_nothing() -> None:
    angles = np.arange(256) / 256
    assert np.array_equal(piston_acceleration(angles + 1000, THESIS), piston_acceleration(angles, THESIS))


def test_a_crank_that_cannot_turn_is_refused() -> None:
    impossible = [(0.1, 0.1, 0.0), (0.1, 0.15, 0.06), (-0.1, 0.3, 0.0), (float("nan"), 0.3, 0.0), (0.0, 0.3, 0.0)]
    for radius, rod, offset in impossible:
        with pytest.raises(RequestError, match="rod longer than radius and offset"):
            SliderCrank(crank_radius_m=radius, rod_length_m=rod, offset_m=offset)


# The rod in two masses, what two masses miss, and what balancing for a rod that was cut in two leaves.


LENGTH_M, MASS_KG = 0.152, 1.6738
SCALE_CENTRE_M = 0.4114 / MASS_KG * LENGTH_M
OPTICAL = load_balanced_engine("msu-optical")
SPLITS = OPTICAL.balance.rod_split
assert SPLITS is not None


def engine(**rod: float) -> Engine:
    data = {"crank_radius_m": 0.0449, "rod_length_m": LENGTH_M, "reciprocating_mass_kg": 4.304}
    return Engine.model_validate({**data, "rod": {"mass_kg": MASS_KG, "centre_from_big_end_m": SCALE_CENTRE_M, **rod}})


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
    exact = -missing * omega_squared * rod_angle(angles, model.mechanism)[2]
    assert np.abs(summed - exact).max() < 1e-13 * np.abs(summed).max()


def test_what_the_cut_implies_is_that_of_the_truth_sheet(shared_truth: dict[str, Any]) -> None:
    known = shared_truth["seed001"]["rod_split"]
    left = rod_balance(OPTICAL, [2000.0])
    assert SPLITS.cut.centroid_fraction == pytest.approx(known["implied_cg_from_big_end_fraction_cad"], rel=1e-12)
    assert SPLITS.scale.centroid_fraction == pytest.approx(known["implied_cg_from_big_end_fraction_scale"], rel=1e-12)
    assert left.centroid_shift_mm == pytest.approx(known["cg_shift_mm_if_l_152"], rel=1e-12)
    assert left.rotating_deficit_g == pytest.approx(known["rotating_deficit_g"], rel=1e-12)
    assert left.reciprocating_excess_g == pytest.approx(known["reciprocating_excess_g"], rel=1e-12)
    assert left.residual_y_g_mm["1"] == pytest.approx(known["X_first_order_residual_g_mm(44.9)"], rel=1e-12)
    # a difference of 0.4 g between numbers near 250 g: 1e-12 of these
    assert left.residual_x_g_mm["1"] == pytest.approx(known["Z_first_order_residual_g_mm(44.9)"], abs=1e-12 * 11068)
    assert left.residual_x_g_mm["2"] == pytest.approx(known["Z_second_order_overbalance_g_mm(44.9,A2)"], rel=1e-12)
    assert unbalance_force_n(left.residual_y_g_mm["1"], 2000) == pytest.approx(
        known["X_first_order_N_2000rpm(44.9)"], rel=1e-12
    )
    second_n = unbalance_force_n(left.residual_x_g_mm["2"], 2000)
    assert second_n == pytest.approx(known["Z_second_order_N_2000rpm(44.9,A2)"], rel=1e-12)
