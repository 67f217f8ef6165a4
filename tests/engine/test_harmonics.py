"""Harmonics against the truth sheet's 25 digits and against the exact acceleration."""

from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.engine.slider_crank import (
    SliderCrank,
    acceleration_harmonics,
    even_harmonics,
    orders_for,
    peak_acceleration,
    piston_acceleration,
    rod_acceleration_harmonics,
    rod_angle,
)
from crankorder.errors import RequestError

RATIOS = ["0.1", "0.25", "44.9/152", "15001.4/49822.3", "0.5", "0.9", "0.99", "0.999"]


def test_every_even_harmonic_has_thirteen_digits(shared_truth: dict[str, Any]) -> None:
    for ratio in RATIOS:
        known = shared_truth["seed000"]["harmonics"][ratio]
        exact = np.array([float(value) for value in known["A"].values()])
        assert [f"A{2 * k}" for k in range(1, exact.size + 1)] == list(known["A"])
        assert np.abs(even_harmonics(exact.size, float(known["lambda"])) / exact - 1).max() <= 1e-13, ratio


def test_the_orders_that_a_tolerance_needs_are_those_of_the_truth_sheet(shared_truth: dict[str, Any]) -> None:
    for ratio in RATIOS:
        known = shared_truth["seed000"]["harmonics"][ratio]
        mechanism = SliderCrank(crank_radius_m=float(known["lambda"]), rod_length_m=1.0)
        wanted = known["highest_order_needed_for_abs_error_over_peak"]
        assert {key: orders_for(float(key), mechanism) for key in wanted} == wanted, ratio


def decimal_harmonic(order: int, ratio: float) -> float:
    """A_order in 60 digits: the closed form of the truth sheet, its hypergeometric series summed term by term."""
    with localcontext() as context:
        context.prec = 60
        k, exact = order // 2, Decimal(ratio)
        kappa = ((1 - exact) * (1 + exact)).sqrt()
        q = (exact / (1 + kappa)) ** 2
        binomial = Decimal("0.5")
        for j in range(2, k + 1):
            binomial *= (Decimal(j) - Decimal("1.5")) / j
        total = term = Decimal(1)
        for n in range(20000):
            term *= (n - Decimal("0.5")) * (k - Decimal("0.5") + n) / ((k + 1 + n) * (n + Decimal(1))) * q * q
            total += term
            if abs(term) < Decimal("1e-40"):
                break
        return float(4 * k**2 / exact * (1 + kappa) * binomial * q**k * total)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1e-3, 0.3, 0.9, 0.99, 0.999])
def test_harmonics_up_to_order_800_have_twelve_digits(ratio: float) -> None:
    every = {order: decimal_harmonic(order, ratio) for order in (2, 4, 10, 40, 180, 400, 600, 800)}
    orders = [order for order, size in every.items() if size > 1e-290]  # smaller ones have no double with all digits
    known = np.array([every[order] for order in orders])
    found = even_harmonics(400, ratio)[np.array(orders) // 2 - 1]
    assert np.abs(found / known - 1).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.99, 0.9997, 0.9999, 1 - 1e-6])
def test_harmonics_of_the_shortest_rods_have_twelve_digits_up_to_order_2000(ratio: float) -> None:
    orders = (2, 4, 300, 344, 360, 1000, 2000)
    known = np.array([decimal_harmonic(order, ratio) for order in orders])
    found = even_harmonics(1000, ratio)
    assert np.abs(found[np.array(orders) // 2 - 1] / known - 1).max() < 1e-12
    assert np.isfinite(found).all()
    assert (found > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("offset", [1e-14, 1e-300])
@pytest.mark.parametrize("ratio", [0.1, 0.3, 0.9, 0.99])
def test_the_fourier_sums_beside_the_crank_angle_give_the_closed_form(ratio: float, offset: float) -> None:
    # with a vanishing offset the even orders come from Fourier sums, yet must be those of the hypergeometric form
    nearly = acceleration_harmonics(SliderCrank(crank_radius_m=ratio, rod_length_m=1.0, offset_m=offset), 200)
    plain = acceleration_harmonics(SliderCrank(crank_radius_m=ratio, rod_length_m=1.0), 200)
    assert np.abs(nearly[2::2] / plain[2::2] - 1).max() < 3e-13


def test_the_peak_is_at_dead_centre_or_at_ninety_degrees(shared_truth: dict[str, Any]) -> None:
    for ratio in RATIOS:
        known = shared_truth["seed000"]["harmonics"][ratio]
        mechanism = SliderCrank(crank_radius_m=float(known["lambda"]), rod_length_m=1.0)
        assert peak_acceleration(mechanism) == pytest.approx(float(known["peak_abs_acc"]), rel=1e-13)


@pytest.mark.parametrize(
    ("case", "radius_m", "rod_m"), [("r=44.9,l=152", 44.9, 152.0), ("r=47.3", 47.3, 47.3 * 49822.3 / 15001.4)]
)
def test_offset_harmonics_have_twelve_digits_each(
    shared_truth: dict[str, Any], case: str, radius_m: float, rod_m: float
) -> None:
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


@given(st.floats(0.05, 0.8), st.floats(-0.7, 0.7))
def test_the_rods_harmonics_add_up_to_its_exact_acceleration(ratio: float, share: float) -> None:
    mechanism = SliderCrank(crank_radius_m=ratio, rod_length_m=1.0, offset_m=share * (1 - ratio))
    angles = np.arange(64) / 64
    _, _, second = rod_angle(angles, mechanism)
    harmonics = rod_acceleration_harmonics(mechanism, 300)
    summed = (harmonics[:, None] * np.exp(2j * np.pi * np.arange(301)[:, None] * angles)).real.sum(axis=0)
    assert np.abs(summed + second).max() < 1e-12 * np.abs(second).max()


@pytest.mark.parametrize("offset_m", [0.0, 1e-9, 0.01, -0.04])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-12])
def test_a_sum_of_the_orders_for_a_tolerance_meets_it(offset_m: float, tolerance: float) -> None:
    mechanism = SliderCrank(crank_radius_m=0.0449, rod_length_m=0.152, offset_m=offset_m)
    angles = np.linspace(0, 1, 721)
    exact = piston_acceleration(angles, mechanism) / mechanism.crank_radius_m
    harmonics = acceleration_harmonics(mechanism, orders_for(tolerance, mechanism))
    orders = np.arange(harmonics.size)[:, None]
    summed = (harmonics[:, None] * np.exp(2j * np.pi * orders * angles)).real.sum(axis=0)
    assert np.abs(summed - exact).max() < tolerance * np.abs(exact).max()


def test_what_cannot_be_asked_is_refused() -> None:
    mechanism = SliderCrank(crank_radius_m=0.3, rod_length_m=1.0)
    for ask in (
        lambda: even_harmonics(3, 1.0),
        lambda: even_harmonics(-1, 0.3),
        lambda: acceleration_harmonics(mechanism, 0),
        lambda: orders_for(0.0, mechanism),
        lambda: rod_acceleration_harmonics(mechanism, 0),
        lambda: orders_for(1e-6, SliderCrank(crank_radius_m=1 - 1e-9, rod_length_m=1.0)),
    ):
        with pytest.raises(RequestError):
            ask()
