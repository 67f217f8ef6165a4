"""What the hinges ask for: weights, counterweights, the table against the hinge angle, the air spring's pressure."""

from typing import Any

import numpy as np
import pytest

from crankorder.engine.elastic_hinge import (
    Joint,
    Weight,
    air_spring,
    balanced_crank,
    hinge_guides,
    hinge_moment,
    hinge_table,
    reduced_inertia,
    shaking_force,
    side_force,
    strut_hinge_moment,
    vertical_counterweight,
    weight_moment,
    weight_without_side_force,
)
from crankorder.engine.hinge_sheet import hinge_sheet
from crankorder.engine.hinged_crank import (
    CrankTorque,
    GuideData,
    HingedCrank,
    TorqueBranch,
    load_hinged_engine,
    rod_motion,
)
from crankorder.errors import RequestError

ENGINE = load_hinged_engine("elastic-hinge")
CURVE = ENGINE.curve
CRANKS = {mechanism.name: mechanism.crank for mechanism in ENGINE.mechanisms}
HALF_DEGREES = np.arange(720) / 720
NO_TORQUE = CrankTorque(branches=(TorqueBranch(angle_deg=(0.0, 360.0), torque_nm=(0.0, 0.0)),))


def changed(crank: HingedCrank, **values: float) -> HingedCrank:
    """The mechanism with other weights or radii."""
    return HingedCrank.model_validate(crank.model_dump() | values)


FIGURE_4: list[tuple[str, Weight, str]] = [
    ("fig4_a", "rod_weight_n", "a: P2 given P3=79"),
    ("fig4_b", "piston_weight_n", "b: P3 given P2=10,P4=10,l0=0.1"),
]


@pytest.mark.slow
@pytest.mark.parametrize("weight", ["rod_counterweight_n", "rod_weight_n", "piston_weight_n"])
def test_a_weight_for_the_corrected_characteristic_brings_the_centre_of_mass_to_the_pin(weight: Weight) -> None:
    crank = changed(CRANKS["fig5_bcd"], rod_counterweight_n=200.0)
    found = weight_without_side_force(crank, CURVE, weight=weight, pin_hinge="potential")
    solved = changed(crank, **{weight: found})
    assert abs(solved.static_moment_nm) < 1e-13
    assert np.abs(side_force(HALF_DEGREES, solved, CURVE, pin_hinge="potential")).max() < 1e-12


def test_a_weight_that_would_be_negative_or_has_no_arm_is_refused() -> None:
    crank = CRANKS["fig3_ac"]
    for weight in ("rod_weight_n", "rod_counterweight_n"):
        with pytest.raises(RequestError, match="without side force"):
            weight_without_side_force(crank, CURVE, weight=weight, pin_hinge="potential")  # type: ignore[arg-type]


def test_equation_12_gives_the_printed_counterweights_with_the_radius_mended() -> None:
    a, b = CRANKS["fig5_a"], CRANKS["fig5_bcd"]
    assert vertical_counterweight(a) == pytest.approx(47.50, rel=1e-14)
    assert vertical_counterweight(changed(a, crank_counterweight_radius_m=0.1)) == pytest.approx(95.0, rel=1e-14)
    assert round(vertical_counterweight(b), 2) == 31.47
    assert vertical_counterweight(b) == pytest.approx(31.47058823529411764705882, rel=1e-14)
    for crank in (a, b):
        held = changed(crank, crank_counterweight_n=vertical_counterweight(crank))
        assert abs(weight_moment(held)) < 1e-14
        assert np.abs(shaking_force(HALF_DEGREES, held)[1]).max() < 1e-15


def test_equation_13_cancels_every_shaking_force(shared_truth: dict[str, Any]) -> None:
    balanced = {name: balanced_crank(CRANKS[name]) for name in ("fig5_a", "fig5_bcd")}
    for crank in balanced.values():
        along, across = shaking_force(HALF_DEGREES, crank)
        assert np.abs(along).max() < 1e-14
        assert np.abs(across).max() < 1e-14
        assert abs(crank.static_moment_nm) < 1e-13
        # with the centre of mass at the crank pin equations (12) and (13) ask for the same counterweight
        assert vertical_counterweight(crank) == pytest.approx(crank.crank_counterweight_n, rel=1e-14)
    numbers = shared_truth["seed003"]["eq13"]
    assert balanced["fig5_a"].rod_counterweight_n == pytest.approx(float(numbers["P4"]), rel=1e-14)
    assert balanced["fig5_a"].crank_counterweight_n == pytest.approx(float(numbers["P5"]), rel=1e-14)


@pytest.mark.cases(2)
@pytest.mark.parametrize("name", sorted(CRANKS))
@pytest.mark.parametrize("joint", ["pin", "strut"])
def test_a_table_closes_and_holds_the_moment_at_its_angles(name: str, joint: Joint) -> None:
    crank = CRANKS[name]
    table = hinge_table(crank, CURVE, joint=joint, speed_rpm=2000.0, n_steps=90)
    scale = np.abs(table.moment_nm).max()
    assert abs(table.work_j[-1]) < 1e-13 * scale
    needed = hinge_moment if joint == "pin" else strut_hinge_moment
    moment = needed(table.crank_angle_rev, crank, CURVE, speed_rpm=2000.0, pin_hinge="potential")
    np.testing.assert_allclose(table.moment_nm, moment, rtol=0, atol=1e-14 * scale)
    assert (np.diff(table.crank_angle_rev) > 0).all()
    assert table.crank_angle_rev[[0, 45, 90]].tolist() == [0, 0.5, 1]


@pytest.mark.slow
def test_where_inertia_alone_acts_the_pressure_goes_with_the_squared_speed() -> None:
    crank = balanced_crank(CRANKS["fig5_bcd"])
    cases: tuple[tuple[Joint, CrankTorque], ...] = (("pin", NO_TORQUE), ("strut", NO_TORQUE), ("strut", CURVE))
    for joint, torque in cases:
        change = air_spring(crank, torque, joint=joint, designed_speed_rpm=2000.0, speed_rpm=3000.0)
        # at the strut the gas torque is taken whole by the hinge at the pin
        assert change.pressure_ratio == pytest.approx(2.25, rel=1e-12)
        assert change.residual_share < 1e-12


@pytest.mark.slow
def test_no_other_pressure_leaves_less_and_what_is_left_is_told() -> None:
    crank = CRANKS["fig5_bcd"]
    change = air_spring(crank, CURVE, joint="pin", designed_speed_rpm=1000.0, speed_rpm=1200.0)
    before, after = (hinge_table(crank, CURVE, joint="pin", speed_rpm=rpm, n_steps=2880) for rpm in (1000.0, 1200.0))

    def rms(ratio: float) -> float:
        return float(np.sqrt(np.mean((after.moment_nm - ratio * before.moment_nm)[:-1] ** 2)))

    assert rms(change.pressure_ratio) < min(rms(change.pressure_ratio * 0.999), rms(change.pressure_ratio * 1.001))
    assert 1 < change.pressure_ratio < 1.44
    assert change.residual_share == pytest.approx(rms(change.pressure_ratio) / rms(0.0), rel=1e-3)
    swing = np.ptp(after.work_j - change.pressure_ratio * before.work_j)
    energy = np.mean(reduced_inertia(after.crank_angle_rev[:-1], crank)) * (1200.0 * np.pi / 30) ** 2
    assert change.speed_fluctuation == pytest.approx(swing / energy, rel=1e-3)


def test_a_spring_without_moment_is_refused() -> None:
    weightless = changed(CRANKS["fig3_ac"], rod_weight_n=0.0, piston_weight_n=0.0, rod_inertia_kg_m2=0.0)
    with pytest.raises(RequestError, match="without a moment"):
        air_spring(weightless, NO_TORQUE, joint="pin", designed_speed_rpm=1000.0, speed_rpm=2000.0)


SPRING = GuideData(
    free_length_m=0.3, least_compression_m=0.03, most_compression_m=0.13, middle_radius_m=0.22, roller_radius_m=0.012
)


@pytest.mark.cases(1)
@pytest.mark.parametrize("joint", ["pin", "strut"])
@pytest.mark.parametrize("name", ["fig3_bd", "fig4_a", "fig5_bcd"])
def test_analytic_the_spring_between_its_guides_makes_the_moment_of_the_hinge(name: str, joint: Joint) -> None:
    table = hinge_table(CRANKS[name], CURVE, joint=joint, speed_rpm=3000.0, n_steps=7200)
    guides = hinge_guides(table, SPRING)
    compression = SPRING.free_length_m - guides.length_m
    assert compression.min() == pytest.approx(0.03, rel=1e-9)
    assert compression.max() == pytest.approx(0.13, rel=1e-9)
    # by the contacts: the force along the common normal of roller and guide, whose share along the spring is k c
    step = 2 * np.pi / 7200
    moment = np.zeros(7200)
    for sign, surface in ((1, guides.outer_m), (-1, guides.inner_m)):
        centre = (0.22 + sign * guides.length_m / 2) * np.exp(2j * np.pi * table.hinge_angle_rev)
        tangent = (np.roll(centre[:-1], -1) - np.roll(centre[:-1], 1)) / (2 * step)
        normal = -1j * tangent / np.abs(tangent)
        along = centre[:-1] / np.abs(centre[:-1])
        force = -sign * guides.stiffness_n_per_m * compression[:-1] / (normal * along.conj()).real  # of guide on roller
        moment += (centre[:-1].conj() * force * normal).imag
        # the surface touches the roller and no more
        assert np.abs(np.abs(surface - centre) - 0.012).max() < 1e-12
        nearest = np.abs(surface[:, None] - centre[None, ::600]).min(axis=0)
        assert nearest == pytest.approx(0.012, abs=1e-9)
    # what the guides do to the spring turns it on: work that the hinge gives
    assert np.abs(moment - table.moment_nm[:-1]).max() < 2e-3 * np.abs(table.moment_nm).max()


def test_a_roller_larger_than_the_bends_of_its_guide_is_told() -> None:
    table = hinge_table(CRANKS["fig5_bcd"], CURVE, joint="pin", speed_rpm=3000.0, n_steps=720)
    assert not hinge_guides(table, SPRING).undercut
    assert hinge_guides(table, SPRING.model_copy(update={"roller_radius_m": 0.2})).undercut


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "key"),
    [({"most_compression_m": 0.02}, "most_compression_m"), ({"middle_radius_m": 0.1}, "middle_radius_m")],
)
def test_a_spring_that_cannot_be_is_refused(change: dict[str, float], key: str) -> None:
    with pytest.raises(ValueError, match=key):
        GuideData(**(SPRING.model_dump() | change))


def test_the_sheet_has_the_truncated_weights_of_figure_4_and_the_curves_of_figure_3(
    shared_truth: dict[str, Any],
) -> None:
    found = {one["name"]: one for one in hinge_sheet(ENGINE, max_order=4).as_dict()["mechanisms"]}
    known = shared_truth["seed003"]["fig4_solutions"]
    for name, weight, key in FIGURE_4:
        kinds = found[name]["solutions"]["weight_without_side_force"][weight]
        assert kinds["printed_truncated"] == pytest.approx(float(known[key]["truncated"]), rel=1e-12)
        assert kinds["printed"] == pytest.approx(float(known[key]["exact"]), rel=1e-12)
    crank = CRANKS["fig3_ac"]
    for speed, curves in found["fig3_ac"]["curves"].items():
        angles = np.array(curves["crank_angle_deg"]) / 360
        full = hinge_moment(angles, crank, CURVE, speed_rpm=float(speed))
        assert curves["m12_full_nm"] == pytest.approx(full.tolist(), rel=1e-6)
        withheld = np.array(curves["m12_full_nm"]) - curves["m12_printed_nm"]
        # equations (6) and (7): what the hinge leaves out is what the cylinder wall takes
        cosine = rod_motion(angles, crank).rod_cosine
        assert withheld == pytest.approx(np.array(curves["r43_printed_n"]) * crank.rod_length_m * cosine, rel=1e-6)
