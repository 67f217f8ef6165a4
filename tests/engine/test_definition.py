"""Engine files: what is wrong is told all at once."""

from pathlib import Path

import pytest

from crankorder.engine.definition import load_engine
from crankorder.errors import ManyErrors, RequestError

GOOD = "crank_radius_m = 0.05\nrod_length_m = 0.15\nreciprocating_mass_kg = 1.0\n"


def test_a_users_engine_is_found_beside_the_manifest(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD)
    assert load_engine("mine.toml", tmp_path) == load_engine("mine", tmp_path)
    with pytest.raises(RequestError, match="no such engine"):
        load_engine("mine.toml")


def test_a_rod_too_short_to_turn_is_refused(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(GOOD.replace("0.15", "0.055") + "offset_m = 0.006\n")
    with pytest.raises(ManyErrors, match="could not turn"):
        load_engine("short.toml", tmp_path)


def test_another_kind_of_engine_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "other.toml").write_text("kind = 'elastic-hinge'\n")
    with pytest.raises(RequestError, match=r"other.toml: kind: not an engine of cranks.*found elastic-hinge"):
        load_engine("other.toml", tmp_path)


def test_faults_of_lengths_masses_keys_and_parts_are_all_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(
        """
        crank_radius_m = 0.15
        rod_length_m = 0.15
        reciprocating_mass_kg = -1.0
        stroke = 3
        main_bearings_m = [0.1, 0.0]
        [[cylinders]]
        crank_deg = 0.0
        firing_deg = 90.0
        [gas]
        crank_angle_deg = [0.0, 90.0, 30.0]
        [[bearings]]
        name = "b"
        designation = "none such"
        """
    )
    with pytest.raises(ManyErrors) as caught:
        load_engine("bad.toml", tmp_path)
    told = {(fault.place, fault.problem.split(",")[0]) for fault in caught.value.faults}
    assert {place for place, _ in told} == {
        "rod_length_m",
        "reciprocating_mass_kg",
        "stroke",
        "main_bearings_m",
        "cylinders",
        "gas.crank_angle_deg",
        "gas.ideal",
        "bearings.0.designation",
    }


MISFITS = {
    "[rod]\nmass_kg = 1.0\ncentre_from_big_end_m = 0.2\n": "between the ends of the rod",
    "[rod]\nmass_kg = 4.0\ncentre_from_big_end_m = 0.1\n": "exceeds reciprocating_mass_kg",
    "main_bearings_m = [0.1, 0.2]\n": "between the first and the last main bearing",
    "[gas]\ncrank_angle_deg = [0.0, 720.0]\ntorque_n_m = [0.0, 1.0]\n": "less than one cycle, 720",
    "[gas]\ncrank_angle_deg = [0.0, 90.0]\npressure_pa = [1e5, 2e5]\n": "needs bore_m",
    "[gas]\ncrank_angle_deg = [0.0, 90.0]\ntorque_n_m = [1.0]\n": "one value for each of the 2",
    "[gas]\ncrank_angle_deg = [0.0, 90.0]\n": "either pressure_pa or torque_n_m",
    "cylinders = []\n": "at least 1",
}
"""Parts that do not fit an engine, and what is told of them."""


def test_parts_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    for text, fault in MISFITS.items():
        (tmp_path / "bad.toml").write_text(GOOD + text)
        with pytest.raises(ManyErrors, match=fault) as caught:
            load_engine("bad.toml", tmp_path)
        assert len(caught.value.faults) == 1
