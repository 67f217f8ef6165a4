"""What stays unbalanced in the thesis engines: leading terms, spacer and offset."""

import math
from typing import Any

import numpy as np
import pytest

from crankorder.engine.balance_data import leading_harmonics, offset_effects
from crankorder.engine.balancing import unbalance_force_n
from crankorder.engine.harmonics import acceleration_harmonics, even_harmonics
from crankorder.engine.slider_crank import SliderCrank
from crankorder.errors import RequestError

CONFIGURATIONS = {
    "r=44.9,l=152": SliderCrank(crank_radius_m=0.0449, rod_length_m=0.152),
    "r=47.3,lambda=15001.4/49822.3": SliderCrank(crank_radius_m=0.0473, rod_length_m=0.0473 * 49822.3 / 15001.4),
}


def offset_by_10_mm(name: str) -> SliderCrank:
    """A configuration with the offset of the thesis."""
    straight = CONFIGURATIONS[name]
    return SliderCrank(crank_radius_m=straight.crank_radius_m, rod_length_m=straight.rod_length_m, offset_m=0.01)


def test_analytic_leading_harmonics_are_the_limit_of_the_exact_ones() -> None:
    assert leading_harmonics(4, 0.5) == pytest.approx([0.5, 0.5**3 / 4, 9 * 0.5**5 / 128, 5 * 0.5**7 / 256], rel=1e-15)
    assert leading_harmonics(6, 1e-4) == pytest.approx(even_harmonics(6, 1e-4), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "ratio"), [(-1, 0.3), (3, 0.0), (3, 1.0), (3, math.nan)])
def test_leading_harmonics_outside_their_range_are_refused(count: int, ratio: float) -> None:
    with pytest.raises(RequestError, match="harmonics"):
        leading_harmonics(count, ratio)


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_the_spacer_leaves_the_forces_of_the_truth_sheet_at_all_speeds(name: str, shared_truth: dict[str, Any]) -> None:
    table = shared_truth["seed001"]["spacer_116g"][name]
    mechanism = CONFIGURATIONS[name]
    unbalance = 116e3 * mechanism.crank_radius_m * np.abs(acceleration_harmonics(mechanism, 4))
    force = unbalance_force_n(unbalance, np.array([[row["rpm"]] for row in table]))
    for order, key in ((1, "F1_N"), (2, "F2_exact_N"), (4, "F4_exact_N")):
        assert force[:, order] == pytest.approx([row[key] for row in table], rel=1e-12)
    leading = 116 * mechanism.crank_radius_m * 1e3 * leading_harmonics(1, mechanism.crank_ratio)[0]
    found = unbalance_force_n(leading, [row["rpm"] for row in table])
    assert found == pytest.approx([row["F2_leading_N"] for row in table], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_the_offset_does_what_the_truth_sheet_says(name: str, shared_truth: dict[str, Any]) -> None:
    known = shared_truth["seed001"]["offset_10mm"][name]
    effects = offset_effects(offset_by_10_mm(name))
    assert effects.quadrature_share == pytest.approx(float(known["sin"]["1"]), rel=1e-12)
    assert effects.amplitude_ratio == pytest.approx(float(known["amplitude"]["1"]), rel=1e-12)
    assert effects.rephasing_deg == pytest.approx(known["phase_first_order_deg"], rel=1e-12)
    assert effects.third_over_fourth == pytest.approx(known["third_over_fourth"], rel=1e-12)


def test_analytic_shafts_that_lag_by_the_rephasing_leave_no_first_order() -> None:
    effects = offset_effects(offset_by_10_mm("r=44.9,l=152"))
    angle = 2 * np.pi * np.arange(360) / 360
    first = np.cos(angle) + effects.quadrature_share * np.sin(angle)
    shafts = effects.amplitude_ratio * np.cos(angle - np.radians(effects.rephasing_deg))
    assert np.abs(first - shafts).max() < 1e-14
    assert round(effects.rephasing_deg, 1) == 3.9
