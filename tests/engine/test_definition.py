"""Engine files: what is shipped loads, what is wrong is told all at once."""

import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from crankorder.engine.definition import load_engine
from crankorder.engine.shafts import GearTrain, ShaftPairParts
from crankorder.errors import ManyErrors, RequestError
from crankorder.settings import shipped

GOOD = "crank_radius_m = 0.05\nrod_length_m = 0.15\nreciprocating_mass_kg = 1.0\n"


CRANK_ENGINES = [name for name, text in shipped("engines").items() if "kind" not in tomllib.loads(text)]


@pytest.mark.parametrize("name", CRANK_ENGINES)
def test_every_shipped_engine_loads(name: str) -> None:
    engine = load_engine(name)
    assert engine.mechanism.crank_ratio == engine.crank_radius_m / engine.rod_length_m < 1


def test_a_users_engine_is_found_beside_the_manifest(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD)
    assert load_engine("mine.toml", tmp_path) == load_engine("mine", tmp_path)
    with pytest.raises(RequestError, match="no such engine"):
        load_engine("mine.toml")


def test_every_fault_of_an_engine_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(
        "crank_radius_m = -0.05\nreciprocating_mass_kg = '1'\noffest_m = 0.1\n"
        "[[bearings]]\nname = 'b'\nrolling_elements = 0\nball_over_pitch = 2.0\n"
    )
    with pytest.raises(ManyErrors) as caught:
        load_engine("bad.toml", tmp_path)
    text = str(caught.value)
    places = ("crank_radius_m", "rod_length_m", "reciprocating_mass_kg", "offest_m", "bearings.0.rolling_elements")
    assert all(f"bad.toml: {place}" in text for place in (*places, "bearings.0.ball_over_pitch"))
    assert len(caught.value.faults) == 6


def test_a_rod_too_short_to_turn_is_refused(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(GOOD.replace("0.15", "0.055") + "offset_m = 0.006\n")
    with pytest.raises(ManyErrors, match="could not turn"):
        load_engine("short.toml", tmp_path)


def test_a_table_for_balancing_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD + "[balance]\nanything = 1\n")
    assert load_engine("mine.toml", tmp_path).reciprocating_mass_kg == 1.0


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


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[rod]\nmass_kg = 1.0\ncentre_from_big_end_m = 0.2\n", "between the ends of the rod"),
        ("[rod]\nmass_kg = 4.0\ncentre_from_big_end_m = 0.1\n", "exceeds reciprocating_mass_kg"),
        ("main_bearings_m = [0.1, 0.2]\n", "between the first and the last main bearing"),
        ("[gas]\ncrank_angle_deg = [0.0, 720.0]\ntorque_n_m = [0.0, 1.0]\n", "less than one cycle, 720"),
        ("[gas]\ncrank_angle_deg = [0.0, 90.0]\npressure_pa = [1e5, 2e5]\n", "needs bore_m"),
        ("[gas]\ncrank_angle_deg = [0.0, 90.0]\ntorque_n_m = [1.0]\n", "one value for each of the 2"),
        ("[gas]\ncrank_angle_deg = [0.0, 90.0]\n", "either pressure_pa or torque_n_m"),
        ("cylinders = []\n", "at least 1"),
    ],
)
def test_parts_that_do_not_fit_are_refused(tmp_path: Path, text: str, fault: str) -> None:
    (tmp_path / "bad.toml").write_text(GOOD + text)
    with pytest.raises(ManyErrors, match=fault) as caught:
        load_engine("bad.toml", tmp_path)
    assert len(caught.value.faults) == 1


def places_and_problems(folder: Path, text: str) -> list[tuple[str, str]]:
    """Place and problem of every fault that is told of an engine file of this text."""
    (folder / "bad.toml").write_text(text)
    with pytest.raises(ManyErrors) as caught:
        load_engine("bad.toml", folder)
    return [(str(fault.place), fault.problem) for fault in caught.value.faults]


@pytest.mark.parametrize("offset", ["'far'", "inf", "[1]"])
def test_a_faulty_offset_does_not_hide_a_rod_too_short(tmp_path: Path, offset: str) -> None:
    told = places_and_problems(tmp_path, GOOD.replace("0.15", "0.05") + f"offset_m = {offset}\n")
    assert [place for place, _ in told] == ["offset_m", "rod_length_m"]
    assert "could not turn" in told[1][1]


def test_a_faulty_offset_is_all_that_is_told_of_a_sound_rod(tmp_path: Path) -> None:
    assert [place for place, _ in places_and_problems(tmp_path, GOOD + "offset_m = 'far'\n")] == ["offset_m"]


def test_a_fault_of_an_entry_is_told_once_and_not_of_its_list(tmp_path: Path) -> None:
    text = "[[cylinders]]\ncrank_deg = 'x'\n[gas]\ncrank_angle_deg = ['a', 90.0]\ntorque_n_m = [0.0, 1.0]\n"
    told = places_and_problems(tmp_path, GOOD + text)
    assert [place for place, _ in told] == ["cylinders.0.crank_deg", "gas.crank_angle_deg.0"]


@pytest.mark.parametrize("pressure", ["-1.0", "'low'", "nan"])
def test_faults_of_angles_and_surroundings_hide_neither_each_other_nor_a_missing_curve(
    tmp_path: Path, pressure: str
) -> None:
    gas = f"bore_m = 0.08\n[gas]\ncrank_angle_deg = [0.0, 0.0]\nsurroundings_pa = {pressure}\n"
    told = places_and_problems(tmp_path, GOOD + gas)
    assert [place for place, _ in told] == ["gas.crank_angle_deg", "gas.ideal", "gas.surroundings_pa"]
    told = places_and_problems(tmp_path, GOOD + gas + "pressure_pa = [1e5, 2e5]\n")
    assert [place for place, _ in told] == ["gas.crank_angle_deg", "gas.surroundings_pa"]


def test_a_gas_curve_of_one_angle_is_refused(tmp_path: Path) -> None:
    told = places_and_problems(tmp_path, GOOD + "[gas]\ncrank_angle_deg = [0.0]\ntorque_n_m = [0.0]\n")
    assert [place for place, _ in told] == ["gas.crank_angle_deg"]
    assert "at least 2" in told[0][1]


def test_a_fault_of_a_shafts_part_or_a_gear_is_told_once_and_an_empty_list_too() -> None:
    for kind, table, place in (
        (ShaftPairParts, {"order": 1, "parts": [{"name": "a", "design_mass_g": -1.0, "centroid_mm": 1.0}]}, "parts"),
        (ShaftPairParts, {"order": 1, "parts": []}, "parts"),
        (GearTrain, {"gears": [{"name": ""}]}, "gears"),
        (GearTrain, {"gears": []}, "gears"),
    ):
        with pytest.raises(ValidationError) as caught:
            kind.model_validate(table)
        told = [fault["loc"] for fault in caught.value.errors()]
        assert all(one[0] == place for one in told)
        assert ((place,) in told) == (not table[place])
