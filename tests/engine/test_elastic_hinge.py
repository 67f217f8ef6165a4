"""The hinge at the crank pin: M12, its characteristics and the side force they leave, against the truth sheet."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from crankorder.engine.elastic_hinge import (
    PinHinge,
    branch_quadrature,
    gas_moment,
    hinge_moment,
    mean_rod_cosine,
    pin_hinge_work,
    side_force,
)
from crankorder.engine.hinged_crank import HingedCrank, Kinematics, load_hinged_engine, potential_torque, rod_motion
from crankorder.errors import RequestError

ENGINE = load_hinged_engine("elastic-hinge")
CURVE = ENGINE.curve
NAMES = sorted(ENGINE.cranks)
HALF_DEGREES = np.arange(720) / 720  # the grid of the truth sheet's largest values
THIRTIES = np.arange(12) / 12
RPM = 30 / np.pi


def column(table: dict[str, Any]) -> np.ndarray:
    """Values of a table of the truth sheet against degrees."""
    return np.array([float(value) for value in table.values()])


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    """Each mechanism of the document's figures 3 to 5."""
    return str(request.param)


@pytest.fixture
def crank(name: str) -> HingedCrank:
    """Its data."""
    return ENGINE.cranks[name]


@pytest.fixture
def expected(shared_truth: dict[str, Any], name: str) -> dict[str, Any]:
    """Its numbers in the truth sheet."""
    numbers: dict[str, Any] = shared_truth["seed003"]["mechanisms"][name]
    return numbers


@pytest.mark.slow
def test_the_gas_moment_is_the_true_one_and_finite_at_the_dead_centres(
    crank: HingedCrank, expected: dict[str, Any]
) -> None:
    np.testing.assert_allclose(gas_moment(THIRTIES, crank, CURVE), column(expected["reference_Tgas"]), rtol=1e-12)
    assert np.isfinite(gas_moment([0, 0.25, 0.5, 0.75, 1], crank, CURVE)).all()


@pytest.mark.parametrize("kinematics", ["exact", "truncated"])
def test_m12_is_the_true_one(crank: HingedCrank, expected: dict[str, Any], kinematics: Kinematics) -> None:
    moment = hinge_moment(THIRTIES, crank, CURVE, speed_rpm=300 * RPM, kinematics=kinematics)
    reference = column(expected[f"reference_M12_{kinematics}_w300_I2slender"])
    np.testing.assert_allclose(moment, reference, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [100, 500])
def test_the_mean_of_m12_does_not_depend_on_speed(crank: HingedCrank, expected: dict[str, Any], speed: int) -> None:
    angle_rev, weight = branch_quadrature(crank, CURVE)
    moment = hinge_moment(angle_rev, crank, CURVE, speed_rpm=speed * RPM)
    mean = float(expected["mean_M12_exact_by_quadrature"][str(speed)])
    assert weight @ moment == pytest.approx(mean, abs=1e-14 * np.abs(moment).max() + 1e-12)


@pytest.mark.parametrize(("pin_hinge", "is_spring"), [("potential", True), ("printed", False)])
def test_only_the_corrected_characteristic_does_no_work_over_its_own_angle(
    crank: HingedCrank, pin_hinge: PinHinge, is_spring: bool
) -> None:
    angle_rev, weight = branch_quadrature(crank, CURVE)
    moment = hinge_moment(angle_rev, crank, CURVE, speed_rpm=100 * RPM, pin_hinge=pin_hinge)
    over_hinge = 2 * np.pi * float(weight @ (moment * rod_motion(angle_rev, crank).hinge_rate))
    over_crank = 2 * np.pi * float(weight @ moment)
    scale = 1e-12 * np.abs(moment).max()
    assert (abs(over_hinge) < scale) == is_spring
    assert (abs(over_crank) < scale) != is_spring
    assert over_hinge == pytest.approx(pin_hinge_work(crank, CURVE, pin_hinge=pin_hinge), abs=scale)


def test_with_the_centre_of_mass_at_the_pin_the_full_moment_is_a_springs_and_no_side_force_is_left() -> None:
    crank = ENGINE.cranks["fig3_bd"]
    assert crank.static_moment_nm == 0
    assert pin_hinge_work(crank, CURVE, pin_hinge="full") == 0
    assert np.abs(side_force(HALF_DEGREES, crank, CURVE, pin_hinge="potential")).max() == 0
    printed = side_force(HALF_DEGREES, crank, CURVE, pin_hinge="printed")
    assert np.abs(printed).max() == pytest.approx(114.9639526786055, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [1.0, 1e-2, 1e-6, 1e-12])
def test_a_mean_over_the_revolution_is_exact_however_short_the_rod(gap: float) -> None:
    crank = replace(ENGINE.cranks["fig3_ac"], crank_radius_m=0.4 / (1 + gap))
    angle_rev, weight = branch_quadrature(crank, CURVE)
    motion = rod_motion(angle_rev, crank)
    squared = crank.mechanism.crank_ratio**2
    kappa_squared = crank.mechanism.margin * (2 - crank.mechanism.margin)
    assert weight.sum() == pytest.approx(1, rel=1e-14)
    assert weight @ motion.rod_cosine == pytest.approx(mean_rod_cosine(crank), rel=1e-14)
    # 1/(1+u) = (cos² ψ − λ cos φ cos ψ)/κ'², of which the second part is odd about 90°
    assert weight @ (1 / motion.hinge_rate) == pytest.approx((1 - squared / 2) / kappa_squared, rel=1e-13)
    assert weight @ motion.hinge_rate == pytest.approx(1, rel=1e-13)
    assert len(angle_rev) < 4000


@pytest.mark.slow
@pytest.mark.parametrize("gap", [1e-2, 1e-6, 1e-12])
def test_the_gas_moment_keeps_its_digits_where_the_rod_is_hardly_longer_than_the_crank(gap: float) -> None:
    crank = HingedCrank(
        crank_radius_m=1.0,
        pin_to_rod_centre_m=0.5,
        rod_centre_to_piston_m=0.5 + gap,
        rod_weight_n=1.0,
        piston_weight_n=1.0,
        rod_inertia_kg_m2=1.0,
    )
    margin = crank.mechanism.margin
    for angle_deg in (89.0, 91.0, 120.0, 179.0):
        # 1/(1+u) = cos ψ (cos ψ − λ cos φ)/κ'², which does not cancel in the lower half
        cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        kappa_squared = margin * (2 - margin)
        rod_cosine = np.sqrt(cosine**2 + kappa_squared * sine**2)
        inverse = rod_cosine * (rod_cosine - (1 - margin) * cosine) / kappa_squared
        if cosine > 0:
            inverse = rod_cosine / (rod_cosine + (1 - margin) * cosine)
        potential = float(potential_torque(angle_deg / 360, CURVE))
        assert gas_moment(angle_deg / 360, crank, CURVE) == pytest.approx(potential * inverse, rel=1e-11)
    assert np.isfinite(hinge_moment(HALF_DEGREES, crank, CURVE, speed_rpm=1000.0)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [{"rod_weight_n": -1.0}, {"piston_weight_n": float("nan")}, {"gravity_m_s2": 0.0}, {"crank_radius_m": 0.4}],
)
def test_an_impossible_mechanism_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(RequestError):
        replace(ENGINE.cranks["fig3_ac"], **change)
