"""Balance shafts: possibilities of Task 5, table 3 of the thesis, and the squared ratio."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from crankorder.engine.balance_data import (
    BalanceData,
    BalancedEngine,
    BalanceTolerances,
    Gear,
    GearTolerances,
    GearTrain,
    load_balanced_engine,
)
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.balancing import designs, moments_of
from crankorder.engine.definition import BalanceShafts, Engine, load_engine
from crankorder.engine.forces import DIRECTIONS, crankcase_forces, crankcase_moments
from crankorder.engine.shafts import (
    gear_errors_deg,
    series_residuals,
    tolerance_study,
    weighted_wheels,
    with_single_shafts,
)
from crankorder.errors import RequestError
from crankorder.report.balance_sentences import tolerance_sentences

# Balance shafts of stated unbalance, as the thesis prints them, and the firing engine that it gives no numbers for.


X, Y, Z = (DIRECTIONS.index(name) for name in ("X", "Y", "Z"))
RPM = 30 / math.pi
SINGLE = {"crank_radius_m": 0.0449, "rod_length_m": 0.152, "reciprocating_mass_kg": 4.304}
INLINE_4 = [{"crank_deg": angle, "position_m": 0.1 * n} for n, angle in enumerate((0.0, 180.0, 180.0, 0.0))]


def along_g_mm(engine, max_order=4):
    return crankcase_forces(engine, RPM, max_order=max_order)[Z] * 1e6


def stated(*pairs, **differences):
    listed = [{"order": order, "unbalance_g_mm": size} for order, size in pairs]
    timed_to = differences.pop("timed_to", "force")
    return Engine.model_validate({**SINGLE, **differences, "shafts": {"pairs": listed, "timed_to": timed_to}})


def test_a_stated_pair_between_cylinders_stands_against_the_sum_and_makes_a_moment():
    second = abs(along_g_mm(stated())[2])
    pair = {"pairs": [{"order": 2, "unbalance_g_mm": second}], "position_m": 0.15}  # 4 · second is the force of all
    model = Engine.model_validate({**SINGLE, "cylinders": INLINE_4, "shafts": pair})
    assert abs(along_g_mm(model)[2]) < 1e-9 * second
    assert abs(crankcase_moments(model, 2000, max_order=2)[X, 2]) < 1e-9
    aside = model.model_copy(update={"shafts": model.shafts.model_copy(update={"position_m": 0.25})})
    moment = crankcase_moments(aside, RPM, max_order=2)[X, 2]
    assert moment * 1e6 == pytest.approx(-0.1 * 4 * second)


def test_a_pair_with_nothing_to_stand_against_is_refused():
    for shafts, place in (({"orders": [1]}, "shafts"), ({"pairs": [{"order": 1, "unbalance_g_mm": 100.0}]}, "pairs")):
        model = Engine.model_validate({**SINGLE, "cylinders": INLINE_4, "shafts": shafts})
        with pytest.raises(RequestError, match=rf"{place}.*the pistons make no force along Z.*found order 1"):
            crankcase_forces(model, 1000, max_order=2)
    with pytest.raises(RequestError, match="order 3"):
        crankcase_forces(stated((3, 1.0)), 1000, max_order=4)
    assert np.isfinite(crankcase_forces(stated((3, 1.0)), 1000, max_order=2)).all()  # above what is asked for


def test_cancelled_orders_and_stated_pairs_stand_side_by_side():
    shafts = {"orders": [1], "unbalanced_mass_kg": 0.116, "pairs": [{"order": 2, "unbalance_g_mm": 5000.0}]}
    both = Engine.model_validate({**SINGLE, "shafts": shafts})
    left, bare = along_g_mm(both), along_g_mm(stated())
    assert left[1].real == pytest.approx(116 * 44.9)
    assert left[2] == pytest.approx(bare[2] - 4 * 5000)
    assert both.shafts.every_order == (1, 2)
    sheet = balance_sheet(BalancedEngine(name="it", engine=both, balance=BalanceData()), max_order=4)
    assert sheet["shafts"]["own"]["orders"] == [1, 2]


# What errors leave of a balanced engine, against closed forms of the same chances.


def test_shafts_that_are_all_late_leave_their_chord():
    engine = load_engine("inline-4-firing")
    bare = engine.model_copy(update={"shafts": BalanceShafts()})
    second = 1e6 * abs(crankcase_forces(bare, RPM, max_order=2)[Z, 2])
    table = series_residuals(engine, BalanceTolerances(mistiming_deg=10.0), max_order=4)
    left = table["mistiming"]["force_g_mm"]
    assert left["2"] == pytest.approx(2 * second * math.sin(math.radians(5)), rel=1e-12)
    assert left["4"] == pytest.approx(1e6 * abs(crankcase_forces(bare, RPM, max_order=4)[Z, 4]), rel=1e-12)


@pytest.mark.parametrize("late_deg", [3.0, 12.0])
def test_a_shaft_against_a_couple_that_is_late_leaves_the_chord_of_its_couple(late_deg):
    engine = load_engine("inline-3")
    places = [one.position_m for one in engine.cylinders]
    balanced = designs(engine, orders=(1,), planes_m=(min(places), max(places)))["order 1"]
    (shaft,) = balanced.shafts.single
    arm = sum(
        1e3 * one.position_m * one.unbalance_g_mm * np.exp(1j * math.radians(one.angle_deg)) for one in shaft.weights
    )
    table = series_residuals(balanced, BalanceTolerances(mistiming_deg=late_deg), max_order=2)
    left = table["mistiming"]["couple_g_mm2"]["1"]
    assert left == pytest.approx(2 * abs(arm) * math.sin(math.radians(late_deg / 2)), rel=1e-9)
    newton_metres = 1e-9 * left * (3000.0 * math.pi / 30) ** 2
    assert f"a couple of {newton_metres:.4g} N·m of order 1 at 3000 rpm" in " ".join(tolerance_sentences(table, 3000.0))


def test_a_series_without_errors_leaves_what_the_engine_leaves_and_one_seed_the_same_numbers():
    engine = load_engine("v8-cross")
    balanced = designs(engine, orders=(1,), planes_m=(-0.2, 0.2))["webs"]
    table = series_residuals(balanced, BalanceTolerances(samples=100), max_order=4)
    drawn = [series_residuals(engine, BalanceTolerances(pin_deg=1.0, seed=seed), max_order=2) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert table["couple_g_mm2"]["1"]["97.5 %"] < 1e-12 * 1.6e7
    spread = table["force_g_mm"]["4"]
    assert spread["2.5 %"] == spread["97.5 %"] == pytest.approx(939.19, rel=1e-4)


def test_pairs_as_single_shafts_make_the_same_force():
    engine = load_engine("msu-optical-second")
    single = with_single_shafts(engine, 4)
    apart = crankcase_forces(engine, RPM, max_order=4) - crankcase_forces(single, RPM, max_order=4)
    assert np.abs(apart).max() < 1e-13


# Direct and reverse cranks: gear sense, conditions of balance, exact residuals, and what faulty gears leave.


SUBJECT = load_balanced_engine("reverse-cranks")
TRAIN = SUBJECT.balance.gears
assert TRAIN is not None
ENGINE = SUBJECT.engine
FIRST = ENGINE.sliding_g_mm


def errors(**sizes):
    """Tolerances with only the named errors."""
    perfect = {"mesh_deg": 0.0, "position_mm": 0.0, "weight_fraction": 0.0, "samples": 20_000, "seed": 7}
    return GearTolerances.model_validate(perfect | sizes)


def turning(wheels):
    """An engine without pistons that has the wheels as its shafts."""
    lengths = {"crank_radius_m": 0.05, "rod_length_m": 0.2, "reciprocating_mass_kg": 0.0}
    return Engine(**lengths, shafts=BalanceShafts(single=tuple(wheels.values())))


@pytest.mark.parametrize("second", ["exact", "leading"])
def test_the_wheels_act_along_the_cylinder_alone(second):
    force = 1e6 * crankcase_forces(turning(weighted_wheels(TRAIN, ENGINE, second=second)), RPM, max_order=2)
    assert np.abs(force[X]).max() <= 1e-13 * FIRST
    assert force[Z, 1] == pytest.approx(-FIRST)


def test_wheels_that_straddle_the_cylinder_make_no_couple_and_others_do():
    assert moments_of(turning(weighted_wheels(TRAIN, ENGINE)), 2)["Y"] is None
    leaning = TRAIN.model_copy(
        update={"gears": tuple(g.model_copy(update={"y_mm": g.y_mm + 2}) if g.name in "DE" else g for g in TRAIN.gears)}
    )
    # the pair's force of size FIRST then acts 2 mm beside the cylinder axis
    couple = moments_of(turning(weighted_wheels(leaning, ENGINE)), 2)["Y"]
    assert couple == {"1": pytest.approx(2 * FIRST, rel=1e-12)}


@pytest.mark.parametrize("tooth_deg", [360 / 20, 360 / 40, 0.3])
def test_analytic_a_wheel_off_by_an_angle_leaves_twice_its_force_times_the_sine_of_half(tooth_deg):
    wheels, wrong_deg, wrong = weighted_wheels(TRAIN, ENGINE), gear_errors_deg(TRAIN, {"E": tooth_deg}), {}
    for name in "DE":
        (weight,) = wheels[name].weights
        moved = weight.model_copy(update={"angle_deg": weight.angle_deg + wrong_deg[name]})
        wrong[name] = wheels[name].model_copy(update={"weights": (moved,)})
    left = 1e6 * crankcase_forces(turning(wrong), RPM, max_order=1)[:, 1] + [0, 0, FIRST]
    assert np.sqrt(np.sum(np.abs(left) ** 2) / 2) == pytest.approx(FIRST * np.sin(np.radians(tooth_deg) / 2), rel=1e-9)


def test_errors_travel_through_the_train_by_its_ratios():
    found = gear_errors_deg(TRAIN, {"B": 1.0, "G": 0.25})
    assert found == {"A": 0.0, "B": 1.0, "D": 1.0, "E": -1.0, "H": -2.0, "G": 2.25}


def test_analytic_the_tolerance_study_has_the_variance_of_its_errors():
    sigma = np.radians(0.2)
    study = tolerance_study(TRAIN, ENGINE, errors(mesh_deg=0.2))
    # E stands wrong by −e_B + e_E against D by e_B, so the wheels' axis of symmetry leans by e_E / 2 alone
    across = np.sqrt(np.mean(study["across_g_mm"]["1"] ** 2)) / FIRST
    assert across == pytest.approx(sigma / 2, rel=0.02)
    along = np.sqrt(np.mean(study["along_g_mm"]["1"] ** 2)) / FIRST
    assert along == pytest.approx(sigma * np.sqrt(1 + 1 / 4), rel=0.02)
    weights = tolerance_study(TRAIN, ENGINE, errors(weight_fraction=0.005))
    for table in (weights["along_g_mm"], weights["across_g_mm"]):
        assert np.sqrt(np.mean(table["1"] ** 2)) / FIRST == pytest.approx(0.005 / np.sqrt(2), rel=0.02)
    shifted = tolerance_study(TRAIN, ENGINE, errors(position_mm=0.05))
    assert not shifted["along_g_mm"]["1"].any()
    # two wheels of half the force; dx works with the sine, dy with the cosine of the crank angle
    assert np.sqrt(np.mean(shifted["couple_g_mm2"]["1"] ** 2)) / FIRST == pytest.approx(0.05, rel=0.02)


def test_wheels_that_do_not_go_in_pairs_are_refused():
    lame = [gear for gear in TRAIN.gears if gear.name != "G"]
    slow = [gear.model_copy(update={"teeth": 11}) if gear.name == "H" else gear for gear in TRAIN.gears]
    for gears in (lame, slow):
        with pytest.raises(RequestError, match="pairs"):
            weighted_wheels(TRAIN.model_copy(update={"gears": tuple(gears)}), ENGINE)


def test_a_train_that_motion_does_not_reach_is_refused():
    first = Gear(name="A", teeth=10)
    for gears in (
        [Gear(name="A", teeth=10, driven_by="B")], [first, Gear(name="B", teeth=10)],
        [first, Gear(name="B", teeth=10, driven_by="C")], [first, Gear(name="A", teeth=10, driven_by="A")],
        [first, Gear(name="B", teeth=10, driven_by="A", fixed_to="A")],
    ):  # fmt: skip
        with pytest.raises(ValidationError, match="gear"):
            GearTrain(gears=tuple(gears))
