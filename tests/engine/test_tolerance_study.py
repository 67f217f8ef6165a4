"""What errors leave of a balanced engine, against closed forms of the same chances."""

import math

import numpy as np
import pytest

from crankorder.engine.definition import BalanceShafts, Engine, load_engine
from crankorder.engine.forces import Z, crankcase_forces
from crankorder.engine.shaft_design import designs
from crankorder.engine.tolerance_study import (
    BalanceTolerances,
    tolerance_sentences,
    tolerance_table,
    with_single_shafts,
)

RPM = 30 / math.pi
SINGLE = Engine(crank_radius_m=0.04, rod_length_m=0.14, reciprocating_mass_kg=0.5)


def test_shafts_that_are_all_late_leave_their_chord() -> None:
    engine = load_engine("inline-4-firing")
    bare = engine.model_copy(update={"shafts": BalanceShafts()})
    second = 1e6 * abs(crankcase_forces(bare, RPM, max_order=2)[Z, 2])
    table = tolerance_table(engine, BalanceTolerances(mistiming_deg=10.0), max_order=4)
    left = table["mistiming"]["force_g_mm"]
    assert left["2"] == pytest.approx(2 * second * math.sin(math.radians(5)), rel=1e-12)
    assert left["4"] == pytest.approx(1e6 * abs(crankcase_forces(bare, RPM, max_order=4)[Z, 4]), rel=1e-12)


@pytest.mark.parametrize("late_deg", [3.0, 12.0])
def test_a_shaft_against_a_couple_that_is_late_leaves_the_chord_of_its_couple(late_deg: float) -> None:
    engine = load_engine("inline-3")
    places = [one.position_m for one in engine.cylinders]
    balanced = designs(engine, orders=(1,), planes_m=(min(places), max(places)), max_order=1)[-1].on(engine)
    (shaft,) = balanced.shafts.single
    arm = sum(
        1e3 * one.position_m * one.unbalance_g_mm * np.exp(1j * math.radians(one.angle_deg)) for one in shaft.weights
    )
    table = tolerance_table(balanced, BalanceTolerances(mistiming_deg=late_deg), max_order=2)
    left = table["mistiming"]["couple_g_mm2"]["1"]
    assert left == pytest.approx(2 * abs(arm) * math.sin(math.radians(late_deg / 2)), rel=1e-9)
    newton_metres = 1e-9 * left * (3000.0 * math.pi / 30) ** 2
    assert f"a couple of {newton_metres:.4g} N·m of order 1 at 3000 rpm" in " ".join(tolerance_sentences(table, 3000.0))


@pytest.mark.slow
def test_a_series_without_errors_leaves_what_the_engine_leaves() -> None:
    engine = load_engine("v8-cross")
    balanced = designs(engine, orders=(1,), planes_m=(-0.2, 0.2), max_order=1)[-1].on(engine)
    table = tolerance_table(balanced, BalanceTolerances(samples=100), max_order=4)
    assert table["couple_g_mm2"]["1"]["97.5 %"] < 1e-12 * 1.6e7
    spread = table["force_g_mm"]["4"]
    assert spread["2.5 %"] == spread["97.5 %"] == pytest.approx(939.19, rel=1e-4)


@pytest.mark.slow
def test_pairs_as_single_shafts_make_the_same_force() -> None:
    engine = load_engine("msu-optical-second")
    single = with_single_shafts(engine, 4)
    apart = crankcase_forces(engine, RPM, max_order=4) - crankcase_forces(single, RPM, max_order=4)
    assert np.abs(apart).max() < 1e-13


@pytest.mark.slow
def test_the_same_seed_gives_the_same_numbers() -> None:
    drawn = [tolerance_table(SINGLE, BalanceTolerances(pin_deg=1.0, seed=seed), max_order=2) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]
