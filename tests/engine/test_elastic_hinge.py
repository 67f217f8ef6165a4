"""The hinge at the crank pin: M12, its characteristics and the side force they leave, against the truth sheet."""

from itertools import product

import numpy as np
import pytest

from crankorder.engine import elastic_hinge, hinged_crank
from crankorder.errors import ManyErrors, RequestError

ENGINE = hinged_crank.load_hinged_engine("elastic-hinge")
CURVE = ENGINE.curve
CRANKS = {mechanism.name: mechanism.crank for mechanism in ENGINE.mechanisms}
HALF_DEGREES = np.arange(720) / 720  # the grid of the truth sheet's largest values
THIRTIES = np.arange(12) / 12
RPM = 30 / np.pi
HINGES: tuple[hinged_crank.PinHinge, ...] = ("full", "potential", "printed")


def changed(crank, **values):
    """The mechanism with other lengths, weights or inertias."""
    return hinged_crank.HingedCrank.model_validate(crank.model_dump() | values)


def test_m12_is_the_true_one(shared_truth):
    for name, crank in CRANKS.items():
        known = shared_truth["seed003"]["mechanisms"][name]["reference_M12_exact_w300_I2slender"]
        moment = hinged_crank.hinge_moment(THIRTIES, crank, CURVE, speed_rpm=300 * RPM)
        np.testing.assert_allclose(moment, [float(value) for value in known.values()], rtol=1e-12)


@pytest.mark.parametrize("pin_hinge", HINGES)
def test_work_is_the_closed_form_at_every_speed_and_nothing_over_the_hinge_angle_of_a_spring_alone(pin_hinge):
    for crank, omega in product(CRANKS.values(), (100.0, 500.0)):
        angle_rev, weight = hinged_crank.branch_quadrature(crank, CURVE)
        options = {"speed_rpm": omega * RPM, "pin_hinge": pin_hinge}
        moment = hinged_crank.hinge_moment(angle_rev, crank, CURVE, **options)
        strut = elastic_hinge.strut_hinge_moment(angle_rev, crank, CURVE, **options)
        over_hinge = 2 * np.pi * float(weight @ (moment * hinged_crank.rod_motion(angle_rev, crank).hinge_rate))
        scale = 1e-12 * np.abs(moment).max()
        assert over_hinge == pytest.approx(elastic_hinge.pin_hinge_work(crank, CURVE, pin_hinge=pin_hinge), abs=scale)
        work = 2 * np.pi * float(weight @ strut)
        closed = elastic_hinge.strut_hinge_work(crank, CURVE, pin_hinge=pin_hinge)
        assert work == pytest.approx(closed, abs=1e-13 * np.abs(strut).max() + 1e-11)
        if pin_hinge != "full":
            assert (abs(over_hinge) < scale) == (pin_hinge == "potential")
            assert (abs(2 * np.pi * float(weight @ moment)) < scale) == (pin_hinge == "printed")


def test_a_mean_over_the_revolution_is_exact_however_short_the_rod():
    for gap in (1.0, 1e-2, 1e-6, 1e-12):
        crank = changed(CRANKS["fig3_ac"], crank_radius_m=0.4 / (1 + gap))
        angle_rev, weight = hinged_crank.branch_quadrature(crank, CURVE)
        motion, mechanism = hinged_crank.rod_motion(angle_rev, crank), crank.mechanism
        # 1/(1+u) = (cos² ψ − λ cos φ cos ψ)/κ'², of which the second part is odd about 90°
        inverse = (1 - mechanism.crank_ratio**2 / 2) / (mechanism.margin * (2 - mechanism.margin))
        assert weight.sum() == pytest.approx(1, rel=1e-14)
        assert weight @ motion.rod_cosine == pytest.approx(hinged_crank.mean_rod_cosine(crank), rel=1e-14)
        assert weight @ (1 / motion.hinge_rate) == pytest.approx(inverse, rel=1e-13)
        assert weight @ motion.hinge_rate == pytest.approx(1, rel=1e-13)
        assert len(angle_rev) < 4000


# The file of an engine with elastic hinges: what is wrong is told all at once.


GOOD = """
kind = "elastic-hinge"
[[torque]]
angle_deg = [0, 360]
torque_nm = [0, 0]
[[mechanisms]]
name = "one"
crank_radius_m = 0.1
pin_to_rod_centre_m = 0.1
rod_centre_to_piston_m = 0.2
rod_weight_n = 12.0
piston_weight_n = 1
speeds_rad_s = [100]
"""


def load(folder, text):
    """The engine of a file with this text."""
    (folder / "mine.toml").write_text(text)
    return hinged_crank.load_hinged_engine("mine", folder)


def test_a_rod_without_inertia_is_taken_as_slender(tmp_path):
    engine = load(tmp_path, GOOD)
    assert engine.mechanisms[0].crank.rod_inertia_kg_m2 == pytest.approx(12 / 9.81 * 0.3**2 / 12, rel=1e-15)
    assert load(tmp_path, GOOD + "rod_inertia_kg_m2 = 0.0\n").mechanisms[0].crank.rod_inertia_kg_m2 == 0
    assert engine.mechanisms[0].speeds_rpm == pytest.approx([954.9296585513721])


def test_every_fault_of_a_file_is_told(tmp_path):
    wrong = GOOD.replace("rod_weight_n = 12.0", "rod_weight_n = -1.0\nrod_wieght_n = 1.0").replace("[0, 360]", "[0]")
    with pytest.raises(ManyErrors) as caught:
        load(tmp_path, wrong)
    text = str(caught.value)
    for place in ("mechanisms.0.rod_weight_n", "mechanisms.0.rod_wieght_n", "torque.0"):
        assert f"mine.toml: {place}" in text
    assert len(caught.value.faults) == 3


def test_data_that_cannot_turn_or_do_not_join_are_refused(tmp_path):
    mechanism = GOOD[GOOD.index("[[mech") :]
    for before, after, what in (
        ("rod_centre_to_piston_m = 0.2", "rod_centre_to_piston_m = 0.0", "rod longer"),
        ("[0, 360]", "[0, 180]", "without a gap"), ('"elastic-hinge"', '"crank"', "kind"),
        (mechanism, mechanism * 2, "one name"), (GOOD, "mechanisms = []" + GOOD.replace(mechanism, ""), "at least one"),
    ):  # fmt: skip
        with pytest.raises(ManyErrors, match=what):
            load(tmp_path, GOOD.replace(before, after))


# The hinge at the strut: reduced inertia, work, and an independent Newton–Euler solution.


def newton_euler(angle, crank, omega, hinge_nm, torque_nm):
    """Side force and strut moment from piston, rod and crank as free bodies, one after the other.

    Everything is written out from the positions: nothing of the package's kinematics is used. ``angle`` (angles,): rad,
    no dead centre (the gas force itself is formed here).
    """
    radius, rod, ratio = crank.crank_radius_m, crank.rod_length_m, crank.crank_radius_m / crank.rod_length_m
    c, s = np.cos(angle), np.sin(angle)
    psi = np.arcsin(ratio * s)
    rate = ratio * c / np.cos(psi)
    rate_rate = (np.sin(psi) * rate**2 - ratio * s) / np.cos(psi)

    def on_rod(distance):
        """Place from the crank pin and acceleration of a point of the rod's line."""
        along = -radius * c - distance * (np.cos(psi) * rate**2 + np.sin(psi) * rate_rate)
        across = -radius * s + distance * (np.sin(psi) * rate**2 - np.cos(psi) * rate_rate)
        return distance * np.array([np.cos(psi), -np.sin(psi)]), omega**2 * np.array([along, across])

    # gas: F dx = M dφ, positive towards the crankshaft; force of the piston pin on the rod along the cylinder
    end, piston_acceleration = on_rod(rod)
    gas = torque_nm / (radius * s * (1 + rate))
    along = -crank.piston_weight_n / crank.gravity_m_s2 * piston_acceleration[0] - gas
    # rod with its counterweight, about the crank pin with the hinge's moment
    loads, moment = 0.0, -crank.rod_inertia_kg_m2 * rate_rate * omega**2 - hinge_nm
    for weight, distance in (
        (crank.rod_weight_n, crank.pin_to_rod_centre_m), (crank.rod_counterweight_n, -crank.rod_counterweight_radius_m),
    ):  # fmt: skip
        place, acceleration = on_rod(distance)
        load = weight * (acceleration / crank.gravity_m_s2 + np.array([[0.0], [1.0]]))
        loads, moment = loads + load, moment + place[0] * load[1] - place[1] * load[0]
    across = (moment + end[1] * along) / end[0]
    # crank about its axis, at constant speed
    pin = loads - np.array([along, across])
    static_nm = crank.crank_weight_n * crank.crank_centre_radius_m
    static_nm -= crank.crank_counterweight_n * crank.crank_counterweight_radius_m
    return crank.piston_weight_n + across, hinge_nm + static_nm * c - radius * (s * pin[0] - c * pin[1])


@pytest.mark.parametrize("pin_hinge", HINGES)
def test_newtons_laws_give_the_same_side_force_and_strut_moment(pin_hinge):
    angles = np.array([0.011, 0.07, 0.19, 0.25, 0.31, 0.44, 0.487, 0.52, 0.61, 0.75, 0.83, 0.97])
    for crank, omega in product(CRANKS.values(), (0.0, 100.0, 300.0)):
        options = {"speed_rpm": omega * RPM, "pin_hinge": pin_hinge}
        hinge = hinged_crank.hinge_moment(angles, crank, CURVE, **options)
        side, strut = newton_euler(
            2 * np.pi * angles, crank, omega, hinge, hinged_crank.potential_torque(angles, CURVE)
        )
        scale = 1 + np.abs(hinge).max()
        ours = hinged_crank.side_force(angles, crank, CURVE, pin_hinge=pin_hinge)
        np.testing.assert_allclose(ours, side, rtol=1e-9, atol=1e-13 * scale / crank.rod_length_m)
        ours = elastic_hinge.strut_hinge_moment(angles, crank, CURVE, **options)
        np.testing.assert_allclose(ours, strut, rtol=1e-9, atol=1e-13 * scale)


@pytest.mark.parametrize("name", ["fig5_a", "fig5_bcd"])
def test_the_reduced_inertia_is_the_true_one(shared_truth, name):
    numbers, crank = shared_truth["seed003"]["M1"][name], CRANKS[name]
    expected = [float(value) for value in numbers["reference_Igiv_exact"].values()]
    np.testing.assert_allclose(elastic_hinge.reduced_inertia(THIRTIES, crank), expected, rtol=1e-14)
    grid = elastic_hinge.reduced_inertia(np.arange(360) / 360, crank)  # the grid of the truth sheet
    assert [grid.min(), grid.max()] == pytest.approx(numbers["Igiv_exact_min_max"], rel=1e-14)
    # the printed I_giv gives the counterweight of the rod no energy there
    exact, printed = (float(numbers["Igiv_at_90deg"][key]) for key in ("exact", "printed"))
    assert float(elastic_hinge.reduced_inertia(0.25, crank)) == pytest.approx(exact, rel=1e-14)
    assert abs(float(elastic_hinge.reduced_inertia(0.25, crank)) / printed - 1) > 0.1


# What the hinges ask for: weights, counterweights, the table against the hinge angle, the air spring's pressure.


NO_TORQUE = hinged_crank.CrankTorque(
    branches=(hinged_crank.TorqueBranch(angle_deg=(0.0, 360.0), torque_nm=(0.0, 0.0)),)
)


def test_a_weight_for_the_corrected_characteristic_brings_the_centre_of_mass_to_the_pin():
    crank = changed(CRANKS["fig5_bcd"], rod_counterweight_n=200.0)
    for weight in ("rod_counterweight_n", "rod_weight_n", "piston_weight_n"):
        found = elastic_hinge.weight_without_side_force(crank, CURVE, weight=weight, pin_hinge="potential")
        solved = changed(crank, **{weight: found})
        assert abs(solved.static_moment_nm) < 1e-13
        assert np.abs(hinged_crank.side_force(HALF_DEGREES, solved, CURVE, pin_hinge="potential")).max() < 1e-12


def test_a_weight_that_would_be_negative_or_has_no_arm_is_refused():
    crank = CRANKS["fig3_ac"]
    for weight in ("rod_weight_n", "rod_counterweight_n"):
        with pytest.raises(RequestError, match="without side force"):
            elastic_hinge.weight_without_side_force(crank, CURVE, weight=weight, pin_hinge="potential")  # type: ignore[arg-type]


def test_equation_13_cancels_every_shaking_force(shared_truth):
    balanced = {name: elastic_hinge.balanced_crank(CRANKS[name]) for name in ("fig5_a", "fig5_bcd")}
    for crank in balanced.values():
        along, across = elastic_hinge.shaking_force(HALF_DEGREES, crank)
        assert np.abs(along).max() < 1e-14
        assert np.abs(across).max() < 1e-14
        assert abs(crank.static_moment_nm) < 1e-13
        # with the centre of mass at the crank pin equations (12) and (13) ask for the same counterweight
        assert elastic_hinge.vertical_counterweight(crank) == pytest.approx(crank.crank_counterweight_n, rel=1e-14)
    numbers = shared_truth["seed003"]["eq13"]
    assert balanced["fig5_a"].rod_counterweight_n == pytest.approx(float(numbers["P4"]), rel=1e-14)
    assert balanced["fig5_a"].crank_counterweight_n == pytest.approx(float(numbers["P5"]), rel=1e-14)


@pytest.mark.parametrize(("name", "joint"), [("fig3_ac", "pin"), ("fig5_bcd", "strut")])
def test_a_table_closes_and_holds_the_moment_at_its_angles(name, joint):
    crank = CRANKS[name]
    table = elastic_hinge.hinge_table(crank, CURVE, joint=joint, speed_rpm=2000.0, n_steps=90)
    scale = np.abs(table.moment_nm).max()
    assert abs(table.work_j[-1]) < 1e-13 * scale
    needed = hinged_crank.hinge_moment if joint == "pin" else elastic_hinge.strut_hinge_moment
    moment = needed(table.crank_angle_rev, crank, CURVE, speed_rpm=2000.0, pin_hinge="potential")
    np.testing.assert_allclose(table.moment_nm, moment, rtol=0, atol=1e-14 * scale)
    assert (np.diff(table.crank_angle_rev) > 0).all()
    assert table.crank_angle_rev[[0, 45, 90]].tolist() == [0, 0.5, 1]


def test_where_inertia_alone_acts_the_pressure_goes_with_the_squared_speed():
    crank = elastic_hinge.balanced_crank(CRANKS["fig5_bcd"])
    for joint, torque in (("pin", NO_TORQUE), ("strut", NO_TORQUE), ("strut", CURVE)):
        change = elastic_hinge.air_spring(crank, torque, joint=joint, designed_speed_rpm=2000.0, speed_rpm=3000.0)
        # at the strut the gas torque is taken whole by the hinge at the pin
        assert change["pressure_ratio"] == pytest.approx(2.25, rel=1e-12)
        assert change["residual_share"] < 1e-12


def test_no_other_pressure_leaves_less_and_what_is_left_is_told():
    crank = CRANKS["fig5_bcd"]
    change = elastic_hinge.air_spring(crank, CURVE, joint="pin", designed_speed_rpm=1000.0, speed_rpm=1200.0)
    before, after = (
        elastic_hinge.hinge_table(crank, CURVE, joint="pin", speed_rpm=rpm, n_steps=2880) for rpm in (1000.0, 1200.0)
    )

    def rms(ratio):
        return float(np.sqrt(np.mean((after.moment_nm - ratio * before.moment_nm)[:-1] ** 2)))

    ratio = change["pressure_ratio"]
    assert rms(ratio) < min(rms(ratio * 0.999), rms(ratio * 1.001))
    assert 1 < ratio < 1.44
    assert change["residual_share"] == pytest.approx(rms(ratio) / rms(0.0), rel=1e-3)
    swing = np.ptp(after.work_j - ratio * before.work_j)
    energy = np.mean(elastic_hinge.reduced_inertia(after.crank_angle_rev[:-1], crank)) * (1200.0 * np.pi / 30) ** 2
    assert change["speed_fluctuation"] == pytest.approx(swing / energy, rel=1e-3)


def test_a_spring_without_moment_is_refused():
    weightless = changed(CRANKS["fig3_ac"], rod_weight_n=0.0, piston_weight_n=0.0, rod_inertia_kg_m2=0.0)
    with pytest.raises(RequestError, match="without a moment"):
        elastic_hinge.air_spring(weightless, NO_TORQUE, joint="pin", designed_speed_rpm=1000.0, speed_rpm=2000.0)


SPRING = hinged_crank.GuideData(
    free_length_m=0.3, least_compression_m=0.03, most_compression_m=0.13, middle_radius_m=0.22, roller_radius_m=0.012
)


@pytest.mark.parametrize(("name", "joint"), [("fig3_bd", "pin"), ("fig5_bcd", "strut")])
def test_analytic_the_spring_between_its_guides_makes_the_moment_of_the_hinge(name, joint):
    table = elastic_hinge.hinge_table(CRANKS[name], CURVE, joint=joint, speed_rpm=3000.0, n_steps=7200)
    guides = elastic_hinge.hinge_guides(table, SPRING)
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


def test_a_roller_larger_than_the_bends_of_its_guide_is_told_and_a_spring_that_cannot_be_is_refused():
    table = elastic_hinge.hinge_table(CRANKS["fig5_bcd"], CURVE, joint="pin", speed_rpm=3000.0, n_steps=720)
    assert not elastic_hinge.hinge_guides(table, SPRING).undercut
    assert elastic_hinge.hinge_guides(table, SPRING.model_copy(update={"roller_radius_m": 0.2})).undercut
    for key, value in (("most_compression_m", 0.02), ("middle_radius_m", 0.1)):
        with pytest.raises(ValueError, match=key):
            hinged_crank.GuideData(**(SPRING.model_dump() | {key: value}))


def test_the_sheet_has_the_curves_of_figure_3():
    found = {one["name"]: one for one in elastic_hinge.hinge_sheet(ENGINE, max_order=4)["mechanisms"]}
    crank = CRANKS["fig3_ac"]
    for speed, curves in found["fig3_ac"]["curves"].items():
        angles = np.array(curves["crank_angle_deg"]) / 360
        full = hinged_crank.hinge_moment(angles, crank, CURVE, speed_rpm=float(speed))
        assert curves["m12_full_nm"] == pytest.approx(full.tolist(), rel=1e-6)
        withheld = np.array(curves["m12_full_nm"]) - curves["m12_printed_nm"]
        # equations (6) and (7): what the hinge leaves out is what the cylinder wall takes
        cosine = hinged_crank.rod_motion(angles, crank).rod_cosine
        assert withheld == pytest.approx(np.array(curves["r43_printed_n"]) * crank.rod_length_m * cosine, rel=1e-6)
