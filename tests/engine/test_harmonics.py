"""Harmonics against the truth sheet's 25 digits and against the exact acceleration."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.harmonics import acceleration_harmonics, even_harmonics, orders_for
from crankorder.engine.slider_crank import SliderCrank, piston_acceleration
from crankorder.errors import RequestError

RATIOS = ["0.1", "0.25", "44.9/152", "15001.4/49822.3", "0.5", "0.9", "0.99", "0.999"]


@pytest.mark.parametrize("ratio", RATIOS)
def test_every_even_harmonic_has_thirteen_digits(truth: dict[str, Any], ratio: str) -> None:
    known = truth["seed000"]["harmonics"][ratio]
    exact = np.array([float(value) for value in known["A"].values()])
    assert [f"A{2 * k}" for k in range(1, exact.size + 1)] == list(known["A"])
    assert np.abs(even_harmonics(exact.size, float(known["lambda"])) / exact - 1).max() <= 1e-13


@pytest.mark.parametrize("ratio", RATIOS)
def test_the_orders_that_a_tolerance_needs_are_those_of_the_truth_sheet(truth: dict[str, Any], ratio: str) -> None:
    known = truth["seed000"]["harmonics"][ratio]
    mechanism = SliderCrank(crank_radius_m=float(known["lambda"]), rod_length_m=1.0)
    wanted = known["highest_order_needed_for_abs_error_over_peak"]
    assert {key: orders_for(float(key), mechanism) for key in wanted} == wanted


def test_the_sums_of_the_harmonics_are_known(truth: dict[str, Any]) -> None:
    for ratio in (0.01, 0.3, 0.7):
        even = even_harmonics(400, ratio)
        assert np.sum(even * (-1.0) ** np.arange(400)) == pytest.approx(ratio, rel=1e-14)
        assert np.sum(even) == pytest.approx(ratio / np.sqrt(1 - ratio**2), rel=1e-14)


@pytest.mark.parametrize(
    ("case", "radius_m", "rod_m"), [("r=44.9,l=152", 44.9, 152.0), ("r=47.3", 47.3, 47.3 * 49822.3 / 15001.4)]
)
def test_offset_harmonics_agree_with_the_truth_sheet(
    truth: dict[str, Any], case: str, radius_m: float, rod_m: float
) -> None:
    known = next(value for key, value in truth["seed001"]["offset_10mm"].items() if key.startswith(case))
    harmonics = acceleration_harmonics(SliderCrank(crank_radius_m=radius_m, rod_length_m=rod_m, offset_m=10.0), 12)
    exact = [float(known["cos"][str(k)]) - 1j * float(known["sin"][str(k)]) for k in range(1, 13)]
    assert np.abs(harmonics[1:] - exact).max() < 1e-15
    assert np.degrees(-np.angle(harmonics[1])) == pytest.approx(known["phase_first_order_deg"], abs=1e-12)


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


def test_a_vanishing_offset_leaves_the_harmonics_of_the_plain_crank() -> None:
    plain = acceleration_harmonics(SliderCrank(crank_radius_m=0.3, rod_length_m=1.0), 20)
    nearly = acceleration_harmonics(SliderCrank(crank_radius_m=0.3, rod_length_m=1.0, offset_m=1e-300), 20)
    assert np.abs(plain - nearly).max() < 1e-15
    assert not plain[3::2].any()


def test_the_other_side_of_the_offset_mirrors_the_odd_harmonics() -> None:
    one, other = (
        acceleration_harmonics(SliderCrank(crank_radius_m=0.3, rod_length_m=1.0, offset_m=sign * 0.1), 12)
        for sign in (1, -1)
    )
    assert np.abs(one - other.conj()).max() < 1e-15


def test_what_cannot_be_asked_is_refused() -> None:
    mechanism = SliderCrank(crank_radius_m=0.3, rod_length_m=1.0)
    for ask in (
        lambda: even_harmonics(3, 1.0),
        lambda: even_harmonics(-1, 0.3),
        lambda: acceleration_harmonics(mechanism, 0),
        lambda: orders_for(0.0, mechanism),
        lambda: orders_for(1e-6, SliderCrank(crank_radius_m=1 - 1e-9, rod_length_m=1.0)),
    ):
        with pytest.raises(RequestError):
            ask()
