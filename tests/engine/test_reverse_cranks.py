"""Direct and reverse cranks: gear sense, conditions of balance, exact residuals, and what faulty gears leave."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from crankorder.engine.balance_data import load_balanced_engine, reduced_masses
from crankorder.engine.balancing import ReducedMasses, sum_by_order
from crankorder.engine.shafts import (
    Gear,
    GearTolerances,
    GearTrain,
    Shaft,
    gear_errors_deg,
    gear_speed_ratios,
    residual_along,
    tolerance_study,
    weight_moments,
    weighted_wheels,
    wheels_couple,
    wheels_force,
)
from crankorder.engine.slider_crank import SliderCrank
from crankorder.errors import RequestError

ANGLES = np.arange(720) / 720
SUBJECT = load_balanced_engine("reverse-cranks")
TRAIN = SUBJECT.balance.gears
assert TRAIN is not None
MASSES = reduced_masses(SUBJECT)
FIRST = MASSES.crank_radius_mm * MASSES.reciprocating_g


def errors(**sizes: Any) -> GearTolerances:
    """Tolerances with only the named errors."""
    perfect = {"mesh_deg": 0.0, "position_mm": 0.0, "weight_fraction": 0.0, "samples": 20_000, "seed": 7}
    return GearTolerances.model_validate(perfect | sizes)


def test_literature_gears_turn_as_document_002_says() -> None:
    assert gear_speed_ratios(TRAIN) == {"A": 1, "B": -1, "D": -1, "E": 1, "H": 2, "G": -2}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ratio"), [("1/4", 0.25), ("44.9/152", 44.9 / 152)])
def test_conditions_and_residuals_are_those_of_the_truth_sheet(
    name: str, ratio: float, shared_truth: dict[str, Any]
) -> None:
    known = shared_truth["seed002"]["residual_after_both"][name]
    mechanism = SliderCrank(crank_radius_m=0.05, rod_length_m=0.05 / ratio)
    masses = ReducedMasses(mechanism=mechanism, rotating_g=0.0, reciprocating_g=1000.0)
    for series, moment, residual in (
        ("leading", "leading W2 r2/(R r) = lambda/4", "max_residual/(R r w^2/g) with leading"),
        ("exact", "exact W2 r2/(R r) = A2/4", "max_residual with exact A2"),
    ):
        moments = weight_moments(masses, second=series)  # type: ignore[arg-type]
        assert moments[2] / moments[1] == pytest.approx(float(known[moment]), rel=1e-12)
        wheels = weighted_wheels(TRAIN, masses, second=series)  # type: ignore[arg-type]
        left = np.abs(residual_along(masses, wheels, ANGLES)) / FIRST
        # a difference of forces 240 times as large: 1e-12 of these, and 1e-9 of itself
        assert left.max() == pytest.approx(float(known[residual]), rel=1e-9, abs=1e-12)
        assert ANGLES[left.argmax()] in (0.25, 0.75)


def test_the_transverse_sum_is_zero_at_every_angle() -> None:
    angles = np.random.default_rng(3).uniform(-50, 50, 20_000)
    kinds: tuple[Any, ...] = ("exact", "leading")
    for second in kinds:
        force = wheels_force(weighted_wheels(TRAIN, MASSES, second=second), angles)
        assert np.abs(force.imag).max() <= 1e-13 * FIRST
        assert np.abs(force.real).max() > FIRST
        orders = sum_by_order(wheel.force for wheel in weighted_wheels(TRAIN, MASSES, second=second).values())
        assert [force.y_g_mm for force in orders] == [0, 0]


@pytest.mark.slow
def test_wheels_that_straddle_the_cylinder_make_no_couple_and_others_do() -> None:
    couples = wheels_couple(weighted_wheels(TRAIN, MASSES))
    assert {order: abs(couple) for order, couple in couples.items()} == {1: 0, 2: 0}
    leaning = TRAIN.model_copy(
        update={"gears": tuple(g.model_copy(update={"y_mm": g.y_mm + 2}) if g.name in "DE" else g for g in TRAIN.gears)}
    )
    # the pair's force of size FIRST then acts 2 mm beside the cylinder axis
    assert abs(wheels_couple(weighted_wheels(leaning, MASSES))[1]) == pytest.approx(2 * FIRST, rel=1e-14)


def mistimed(wheels: dict[str, Shaft], mesh_errors_deg: dict[str, float]) -> dict[str, Shaft]:
    """The wheels as they stand with errors in the meshes."""
    wrong_deg = gear_errors_deg(TRAIN, mesh_errors_deg)
    return {name: replace(wheel, phase_deg=wheel.phase_deg + wrong_deg[name]) for name, wheel in wheels.items()}


def test_analytic_a_couple_is_place_times_force_at_every_angle() -> None:
    wheels = weighted_wheels(TRAIN, MASSES)
    moved = mistimed(wheels, {"E": 1.5, "B": -0.7, "G": 3.0})
    angle = 2 * np.pi * ANGLES
    direct = np.zeros(ANGLES.size)
    for name, wheel in moved.items():
        force = wheels_force({name: wheel}, ANGLES)
        direct += wheel.x_mm * force.imag - wheel.y_mm * force.real
    by_order = sum((couple * np.exp(1j * order * angle)).real for order, couple in wheels_couple(moved).items())
    assert np.abs(direct - by_order).max() < 1e-12 * np.abs(direct).max()


@pytest.mark.slow
def test_errors_travel_through_the_train_by_its_ratios() -> None:
    found = gear_errors_deg(TRAIN, {"B": 1.0, "G": 0.25})
    assert found == {"A": 0.0, "B": 1.0, "D": 1.0, "E": -1.0, "H": -2.0, "G": 2.25}


def test_analytic_a_wheel_off_by_an_angle_leaves_twice_its_force_times_the_sine_of_half() -> None:
    wheels = weighted_wheels(TRAIN, MASSES)
    for tooth_deg in (360 / 20, 360 / 40, 0.3):
        wrong = mistimed({name: wheels[name] for name in "DE"}, {"E": tooth_deg})
        left = wheels_force(wrong, ANGLES) + FIRST * np.cos(2 * np.pi * ANGLES)
        assert np.abs(left) == pytest.approx(np.full(720, FIRST * np.sin(np.radians(tooth_deg) / 2)), rel=1e-9)


@pytest.mark.slow
def test_analytic_the_tolerance_study_has_the_variance_of_its_errors() -> None:
    sigma = np.radians(0.2)
    study = tolerance_study(TRAIN, MASSES, errors(mesh_deg=0.2))
    # E stands wrong by −e_B + e_E against D by e_B, so the wheels' axis of symmetry leans by e_E / 2 alone
    across = np.sqrt(np.mean(study.across_g_mm[:, 0] ** 2)) / FIRST
    assert across == pytest.approx(sigma / 2, rel=0.02)
    along = np.sqrt(np.mean(study.along_g_mm[:, 0] ** 2)) / FIRST
    assert along == pytest.approx(sigma * np.sqrt(1 + 1 / 4), rel=0.02)
    weights = tolerance_study(TRAIN, MASSES, errors(weight_fraction=0.005))
    for table in (weights.along_g_mm, weights.across_g_mm):
        assert np.sqrt(np.mean(table[:, 0] ** 2)) / FIRST == pytest.approx(0.005 / np.sqrt(2), rel=0.02)
    shifted = tolerance_study(TRAIN, MASSES, errors(position_mm=0.05))
    assert not shifted.along_g_mm.any()
    # two wheels of half the force; dx works with the sine, dy with the cosine of the crank angle
    assert np.sqrt(np.mean(shifted.couple_g_mm2[:, 0] ** 2)) / FIRST == pytest.approx(0.05, rel=0.02)


@pytest.mark.slow
def test_wheels_that_do_not_go_in_pairs_are_refused() -> None:
    lame = TRAIN.model_copy(update={"gears": tuple(gear for gear in TRAIN.gears if gear.name != "G")})
    with pytest.raises(RequestError, match="pairs"):
        weighted_wheels(lame, MASSES)
    slow = TRAIN.model_copy(
        update={"gears": tuple(g.model_copy(update={"teeth": 11}) if g.name == "H" else g for g in TRAIN.gears)}
    )
    with pytest.raises(RequestError, match="pairs"):
        weighted_wheels(slow, MASSES)


@pytest.mark.slow
@pytest.mark.parametrize(
    "gears",
    [
        [Gear(name="A", teeth=10, driven_by="B")],
        [Gear(name="A", teeth=10), Gear(name="B", teeth=10)],
        [Gear(name="A", teeth=10), Gear(name="B", teeth=10, driven_by="C")],
        [Gear(name="A", teeth=10), Gear(name="A", teeth=10, driven_by="A")],
        [Gear(name="A", teeth=10), Gear(name="B", teeth=10, driven_by="A", fixed_to="A")],
    ],
)
def test_a_train_that_motion_does_not_reach_is_refused(gears: list[Gear]) -> None:
    with pytest.raises(ValidationError, match="gear"):
        GearTrain(gears=tuple(gears))
