"""The kinematics against 60-digit arithmetic and the derivatives of its own motion."""

from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.definition import Engine
from crankorder.engine.forces import two_masses
from crankorder.engine.slider_crank import (
    SliderCrank,
    acceleration_harmonics,
    dead_centres,
    even_harmonics,
    orders_for,
    peak_acceleration,
    piston_acceleration,
    piston_drop,
    piston_velocity,
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


def decimal_sine_cosine(angle):
    sums, term = [Decimal(0), Decimal(0)], Decimal(1)
    for k in range(1, 120):
        sums[(k - 1) % 2] += term * (-1) ** ((k - 1) // 2)
        term *= angle / k
    return sums[1], sums[0]


def decimal_motion(revolutions, mechanism):
    """Drop, velocity, acceleration, sine of the rod angle and its derivatives, straight from the definitions."""
    sine, cosine = decimal_sine_cosine(2 * PI * Decimal(revolutions))
    radius, rod, offset = (Decimal(x) for x in (mechanism.crank_radius_m, mechanism.rod_length_m, mechanism.offset_m))
    across, slope = radius * sine - offset, radius * cosine
    along, top = (rod * rod - across * across).sqrt(), (rod * rod - offset * offset).sqrt()
    return {
        "drop": radius + top - radius * cosine - along, "velocity": -radius * sine - across * slope / along,
        "rod_sine": across / rod, "rod_first": slope / along,
        "acceleration": radius * cosine + (slope**2 - across * radius * sine + (across * slope / along) ** 2) / along,
        "rod_second": -radius * sine / along + across * slope**2 / along**3,
    }  # fmt: skip


@pytest.mark.cases(6)
@pytest.mark.parametrize("slack", [0.7, 1e-6, 1e-12])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_motion_and_rod_angle_keep_their_digits_with_offset_and_however_short_the_rod(slack, share):
    mechanism = SliderCrank(crank_radius_m=1 - slack, rod_length_m=1.0, offset_m=share * slack)
    angles = np.concatenate([np.arange(1, 8) / 8, np.linspace(0, 1, 38)[1:-1], 0.25 + 1e-3 * np.linspace(-1, 1, 9)])
    exact = [decimal_motion(float(angle), mechanism) for angle in angles]
    psi, first, second = rod_angle(angles, mechanism)
    computed = {
        "drop": piston_drop(angles, mechanism), "velocity": piston_velocity(angles, mechanism), "rod_sine": np.sin(psi),
        "rod_first": first, "rod_second": second,
    }  # fmt: skip
    for name, values in computed.items():
        known = np.array([float(row[name]) for row in exact])
        sizes = np.where(np.abs(known) < 1e-40, 1.0, np.abs(known))  # an exact zero has no relative error
        assert np.abs((values - known) / sizes).max() < (2e-15 if share == 0 else 5e-15), name
    known = np.array([float(row["acceleration"]) for row in exact])
    assert np.abs(piston_acceleration(angles, mechanism) - known).max() <= 1e-15 * np.abs(known).max()


@given(SHAPES)
def test_the_piston_turns_at_its_dead_centres_a_stroke_apart(mechanism):
    turns = dead_centres(mechanism)
    there = np.array([turns.top_rev, turns.bottom_rev])
    assert np.abs(piston_velocity(there, mechanism)).max() < 1e-14 / mechanism.slack
    drop = piston_drop(there, mechanism)
    assert drop[1] - drop[0] == pytest.approx(turns.stroke_m, rel=1e-13)
    every = piston_drop(np.linspace(0, 1, 3601), mechanism)
    assert drop[0] <= every.min() + 1e-15
    assert every.max() <= drop[1] + 1e-15
    assert turns.stroke_m >= 2 * mechanism.crank_radius_m * (1 - 1e-15)


def test_a_whole_turn_changes_nothing():
    angles = np.arange(256) / 256
    assert np.array_equal(piston_acceleration(angles + 1000, THESIS), piston_acceleration(angles, THESIS))


def test_a_crank_that_cannot_turn_is_refused():
    impossible = [(0.1, 0.1, 0.0), (0.1, 0.15, 0.06), (-0.1, 0.3, 0.0), (float("nan"), 0.3, 0.0), (0.0, 0.3, 0.0)]
    for radius, rod, offset in impossible:
        with pytest.raises(RequestError, match="rod longer than radius and offset"):
            SliderCrank(crank_radius_m=radius, rod_length_m=rod, offset_m=offset)


# The rod in two masses, what two masses miss, and what balancing for a rod that was cut in two leaves.


LENGTH_M, MASS_KG = 0.152, 1.6738
SCALE_CENTRE_M = 0.4114 / MASS_KG * LENGTH_M


def engine(**rod):
    data = {"crank_radius_m": 0.0449, "rod_length_m": LENGTH_M, "reciprocating_mass_kg": 4.304}
    return Engine.model_validate({**data, "rod": {"mass_kg": MASS_KG, "centre_from_big_end_m": SCALE_CENTRE_M, **rod}})


def test_the_couple_has_the_sine_harmonics_of_the_truth_sheet(shared_truth):
    model = engine(inertia_kg_m2=0.0032226229333333334)
    missing = two_masses(model).missing_inertia_kg_m2
    omega_squared = (2000 * np.pi / 30) ** 2
    couple = missing * omega_squared * rod_acceleration_harmonics(model.mechanism, 40)
    for order, known in shared_truth["seed001"]["rod_inertia"]["sine_harmonics_at_44.9/152"].items():
        assert couple[int(order)] == pytest.approx(-1j * missing * omega_squared * float(known), rel=1e-12)


# Harmonics against the truth sheet's 25 digits and against the exact acceleration.


RATIOS = ["0.1", "0.25", "44.9/152", "15001.4/49822.3", "0.5", "0.9", "0.99", "0.999"]


def test_every_even_harmonic_the_peak_and_the_orders_that_a_tolerance_needs_are_those_of_the_truth_sheet(shared_truth):
    """Harmonics and the peak, at dead centre or at ninety degrees, have thirteen digits."""
    for ratio in RATIOS:
        known = shared_truth["seed000"]["harmonics"][ratio]
        mechanism = SliderCrank(crank_radius_m=float(known["lambda"]), rod_length_m=1.0)
        exact = np.array([float(value) for value in known["A"].values()])
        assert [f"A{2 * k}" for k in range(1, exact.size + 1)] == list(known["A"])
        assert np.abs(even_harmonics(exact.size, float(known["lambda"])) / exact - 1).max() <= 1e-13, ratio
        assert peak_acceleration(mechanism) == pytest.approx(float(known["peak_abs_acc"]), rel=1e-13)
        wanted = known["highest_order_needed_for_abs_error_over_peak"]
        assert {key: orders_for(float(key), mechanism) for key in wanted} == wanted, ratio


def decimal_harmonic(order, ratio):
    """A_order in 60 digits: the closed form of the truth sheet, its hypergeometric series summed term by term."""
    k, exact, half = order // 2, Decimal(ratio), Decimal("0.5")
    kappa = ((1 - exact) * (1 + exact)).sqrt()
    q = (exact / (1 + kappa)) ** 2
    binomial, n = half, 0
    for j in range(2, k + 1):
        binomial *= (j - 3 * half) / j
    total = term = Decimal(1)
    while abs(term) > Decimal("1e-40"):
        term *= (n - half) * (k - half + n) / ((k + 1 + n) * (n + Decimal(1))) * q * q
        total, n = total + term, n + 1
    return float(4 * k**2 / exact * (1 + kappa) * binomial * q**k * total)


@pytest.mark.parametrize("ratio", [1e-3, 0.9, 0.9997])
def test_harmonics_have_twelve_digits_up_to_order_2000_however_short_the_rod(ratio):
    every = {order: decimal_harmonic(order, ratio) for order in (2, 4, 40, 180, 344, 360, 800, 2000)}
    known = {order: size for order, size in every.items() if size > 1e-290}  # below no double has all digits
    found = even_harmonics(1000, ratio)
    assert np.abs(found[np.array(list(known)) // 2 - 1] / list(known.values()) - 1).max() < 1e-12
    assert np.isfinite(found).all()


def test_the_fourier_sums_beside_the_crank_angle_give_the_closed_form():
    # with a vanishing offset the even orders come from Fourier sums, yet must be those of the hypergeometric form
    for ratio, offset in ((0.1, 1e-14), (0.9, 1e-300), (0.99, 1e-14)):
        nearly = acceleration_harmonics(SliderCrank(crank_radius_m=ratio, rod_length_m=1.0, offset_m=offset), 200)
        plain = acceleration_harmonics(SliderCrank(crank_radius_m=ratio, rod_length_m=1.0), 200)
        assert np.abs(nearly[2::2] / plain[2::2] - 1).max() < 3e-13


@pytest.mark.parametrize(
    ("case", "radius_m", "rod_m"), [("r=44.9,l=152", 44.9, 152.0), ("r=47.3", 47.3, 47.3 * 49822.3 / 15001.4)]
)
def test_offset_harmonics_have_twelve_digits_each(shared_truth, case, radius_m, rod_m):
    known = next(value for key, value in shared_truth["seed001"]["offset_10mm"].items() if key.startswith(case))
    harmonics = acceleration_harmonics(SliderCrank(crank_radius_m=radius_m, rod_length_m=rod_m, offset_m=10.0), 12)
    for order in range(1, 13):
        assert abs(harmonics[order]) == pytest.approx(float(known["amplitude"][str(order)]), rel=1e-13)
        part, other, key = harmonics[order].real, harmonics[order].imag, "cos"
        if order % 2:
            part, other, key = -harmonics[order].imag, harmonics[order].real - (order == 1), "sin"
        assert part == pytest.approx(float(known[key][str(order)]), rel=1e-13)
        assert other == 0
    assert np.degrees(-np.angle(harmonics[1])) == pytest.approx(known["phase_first_order_deg"], rel=1e-12)
    assert abs(harmonics[3] / harmonics[4]) == pytest.approx(known["third_over_fourth"], rel=1e-12)


@pytest.mark.parametrize(("ratio", "share"), [(0.05, -0.7), (0.3, 0.0), (0.8, 0.7)])
def test_the_rods_harmonics_add_up_to_its_exact_acceleration(ratio, share):
    mechanism = SliderCrank(crank_radius_m=ratio, rod_length_m=1.0, offset_m=share * (1 - ratio))
    angles = np.arange(64) / 64
    _, _, second = rod_angle(angles, mechanism)
    harmonics = rod_acceleration_harmonics(mechanism, 300)
    summed = (harmonics[:, None] * np.exp(2j * np.pi * np.arange(301)[:, None] * angles)).real.sum(axis=0)
    assert np.abs(summed + second).max() < 1e-12 * np.abs(second).max()


@pytest.mark.parametrize("offset_m", [0.0, 1e-9, 0.01, -0.04])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-12])
def test_a_sum_of_the_orders_for_a_tolerance_meets_it(offset_m, tolerance):
    mechanism = SliderCrank(crank_radius_m=0.0449, rod_length_m=0.152, offset_m=offset_m)
    angles = np.linspace(0, 1, 721)
    exact = piston_acceleration(angles, mechanism) / mechanism.crank_radius_m
    harmonics = acceleration_harmonics(mechanism, orders_for(tolerance, mechanism))
    orders = np.arange(harmonics.size)[:, None]
    summed = (harmonics[:, None] * np.exp(2j * np.pi * orders * angles)).real.sum(axis=0)
    assert np.abs(summed - exact).max() < tolerance * np.abs(exact).max()


def test_what_cannot_be_asked_is_refused():
    mechanism = SliderCrank(crank_radius_m=0.3, rod_length_m=1.0)
    for ask in (
        lambda: even_harmonics(3, 1.0), lambda: even_harmonics(-1, 0.3), lambda: acceleration_harmonics(mechanism, 0),
        lambda: orders_for(0.0, mechanism), lambda: rod_acceleration_harmonics(mechanism, 0),
        lambda: orders_for(1e-6, SliderCrank(crank_radius_m=1 - 1e-9, rod_length_m=1.0)),
    ):  # fmt: skip
        with pytest.raises(RequestError):
            ask()
