"""Engine files: what is shipped loads, what is wrong is told all at once."""

from pathlib import Path

import pytest

from crankorder.engine.definition import load_engine
from crankorder.errors import ManyErrors, RequestError
from crankorder.settings import shipped

GOOD = "crank_radius_m = 0.05\nrod_length_m = 0.15\nreciprocating_mass_kg = 1.0\n"


@pytest.mark.parametrize("name", list(shipped("engines")))
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
