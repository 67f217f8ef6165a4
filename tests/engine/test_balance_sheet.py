"""The balance sheet: one JSON document for every shipped engine, with the keys asked for and true sentences."""

import copy
import tomllib

import numpy as np
import pytest

from crankorder.engine.balance_data import balanced_engine, load_balanced_engine
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.balancing import moments_of
from crankorder.engine.definition import BalanceShafts, Engine
from crankorder.engine.forces import DIRECTIONS, FRAME, crankcase_forces
from crankorder.errors import ManyErrors, RequestError
from crankorder.report.balance_sentences import balance_sentences
from crankorder.settings import shipped

CRANK_ENGINES = [name for name, text in shipped("engines").items() if "kind" not in tomllib.loads(text)]


def sheet_of(name, **options):
    """Sheet of a shipped engine with its sentences."""
    sheet = balance_sheet(load_balanced_engine(name), **options)
    return {**sheet, "sentences": balance_sentences(sheet)}


@pytest.mark.parametrize("name", CRANK_ENGINES)
def test_forces_of_the_sheet_are_those_of_the_crankcase_without_shafts(name):
    subject = load_balanced_engine(name)
    bare = subject.engine.model_copy(update={"shafts": BalanceShafts()})
    force = np.abs(crankcase_forces(bare, 2000.0, max_order=8))
    engine = subject.engine
    terms_kg_m = engine.reciprocating_mass_kg * engine.crank_radius_m + engine.rotating_unbalance_kg_m
    round_off_n = 1e-14 * len(engine.cylinders) * terms_kg_m * (2000 * np.pi / 30) ** 2
    sheet = balance_sheet(subject, speeds_rpm=[2000.0])
    for axis in ("Z", "X"):
        stated = sheet["force_n"]["2000"][axis] or {}
        known = force[DIRECTIONS.index(axis)]  # type: ignore[arg-type]
        assert [stated.get(str(k), 0.0) for k in range(1, 9)] == pytest.approx(known[1:], rel=1e-12, abs=round_off_n)


def test_literature_the_optical_engine_shows_table_1_and_what_is_left(shared_truth):
    sheet = sheet_of("msu-optical", speeds_rpm=[2000.0])
    for row in shared_truth["seed001"]["table1"]["rows_g_mm"]["optical"]:
        order = str(row["order"])
        assert sheet["force_g_mm"]["Z"][order] == pytest.approx(row["exact_Fourier"], rel=1e-12)
        assert sheet["leading_g_mm"][order] == pytest.approx(row["leading_term_recomputed"], rel=1e-12)
    assert sheet["force_g_mm"]["X"] is None
    assert sheet["strategies"]["d"] is None
    said = " ".join(sheet["sentences"])
    for fact in ("1299 g·mm (56.98 N", "11068 g·mm (485.5 N", "3338.4 g·mm (146.4 N", "(228.5 N", "(578.4 N", "3.90°"):
        assert fact in said


def test_an_engine_with_its_own_shafts_shows_what_these_leave():
    own = sheet_of("msu-optical-second", speeds_rpm=[2000.0])["shafts"]["own"]
    assert own["orders"] == [1, 2]
    assert own["residual_g_mm"]["Z"]["3"] == pytest.approx(193249.6 * 0.0071162976, rel=1e-7)
    assert sheet_of("msu-optical")["shafts"]["own"] is None


def test_several_cylinders_show_their_sum_and_no_strategies_of_one():
    """Two cylinders side by side with opposite pins."""
    cylinders = [{"crank_deg": 0.0, "position_m": -0.05}, {"crank_deg": 180.0, "position_m": 0.05}]
    table = {"crank_radius_m": 0.04, "rod_length_m": 0.14, "reciprocating_mass_kg": 0.5, "cylinders": cylinders}
    engine = balanced_engine(table, name="inline-2", source="inline-2.toml")
    sheet = balance_sheet(engine, speeds_rpm=[3000.0])
    assert "1" not in sheet["force_g_mm"]["Z"]
    assert sheet["force_g_mm"]["Z"]["2"] == pytest.approx(2 * 0.5e3 * 40 * sheet["harmonics"]["2"], rel=1e-12)
    assert sheet["strategies"] is None
    assert sheet["shafts"]["1"] is None
    assert sheet["moment_g_mm2"]["X"]["1"] == pytest.approx(500 * 40 * 100, rel=1e-12)
    couple_n_m = 500e-3 * 0.04 * 0.1 * (3000 * np.pi / 30) ** 2
    assert f"{couple_n_m:.4g} N·m of order 1" in " ".join(s for s in balance_sentences(sheet) if "rocking couple" in s)


def test_the_frame_is_right_handed_and_the_crank_turns_from_z_to_x():
    web = {"unbalance_g_mm": 1e4, "position_m": 0.3}
    shafts = {"single": [{"speed_ratio": 1, "x_m": 0.2, "z_m": 0.1, "weights": [web]}]}
    lengths = {"crank_radius_m": 0.04, "rod_length_m": 0.14, "reciprocating_mass_kg": 0.0}
    engine = Engine.model_validate({**lengths, "shafts": shafts})
    force = crankcase_forces(engine, 3000.0, max_order=1)[:, 1]
    at_top, later = ((force * turn).real / np.abs(force).max() for turn in (1, 1j))
    np.testing.assert_allclose([at_top, later, np.cross(at_top, later)], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    known = 1e7 * np.abs(np.cross([0.2, 0.3, 0.1], [-1j, 0, 1]))  # r × F
    assert [moments_of(engine, 1)[axis]["1"] for axis in DIRECTIONS] == pytest.approx(known)
    assert "right-handed, the crank turns from Z to X (positive about Y)" in FRAME.rotation


def test_a_sheet_without_orders_or_speeds_is_refused():
    for options in ({"max_order": 3}, {"speeds_rpm": []}, {"speeds_rpm": [0.0]}, {"speeds_rpm": [float("nan")]}):
        with pytest.raises(RequestError, match="balance sheet"):
            sheet_of("task5", **options)


# The table [balance] of engine files: bad ones name every fault at once.


def task5():
    """Content of the engine file of Task 5, to be spoilt."""
    return copy.deepcopy(tomllib.loads(shipped("engines")["task5"]))


def test_all_faults_of_engine_and_balance_are_named_at_once():
    table = task5()
    table["rod_length_m"] = 0.02
    table["reciprocating_mass_kg"] = -1.0
    table["balance"]["train"]["piston_mass_g"] = -180.0
    del table["balance"]["train"]["rod_mass_g"]
    table["balance"]["plaices"] = {}
    with pytest.raises(ManyErrors) as caught:
        balanced_engine(table, name="spoilt", source="spoilt.toml")
    text = str(caught.value)
    assert len(caught.value.faults) == 5
    lengths_and_masses = ("rod_length_m", "reciprocating_mass_kg", "train.piston_mass_g", "train.rod_mass_g")
    for place in (*lengths_and_masses, "balance.plaices"):
        assert place in text
    assert text.count("spoilt.toml") == 5


def test_parts_that_do_not_add_up_to_the_engine_are_refused():
    for key in ("crank_radius_m", "rod_length_m", "reciprocating_mass_kg", "rotating_unbalance_kg_m"):
        table = task5()
        table[key] *= 1.01
        with pytest.raises(ManyErrors, match="does not agree") as caught:
            balanced_engine(table, name="spoilt", source="spoilt.toml")
        assert key in str(caught.value)
