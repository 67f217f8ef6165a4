"""The table [balance] of engine files: bad ones name every fault at once."""

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest

from crankorder.engine.balance_data import balanced_engine, load_balanced_engine, reduced_masses
from crankorder.errors import ManyErrors, RequestError
from crankorder.settings import shipped

CRANK_ENGINES = [name for name, text in shipped("engines").items() if "kind" not in tomllib.loads(text)]


def task5() -> dict[str, Any]:
    """Content of the engine file of Task 5, to be spoilt."""
    return copy.deepcopy(tomllib.loads(shipped("engines")["task5"]))


def test_all_faults_of_engine_and_balance_are_named_at_once() -> None:
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
    for place in (
        "rod_length_m",
        "reciprocating_mass_kg",
        "train.piston_mass_g",
        "train.rod_mass_g",
        "balance.plaices",
    ):
        assert place in text
    assert text.count("spoilt.toml") == 5


def test_parts_that_do_not_add_up_to_the_engine_are_refused() -> None:
    for key in ("crank_radius_m", "rod_length_m", "reciprocating_mass_kg", "rotating_unbalance_kg_m"):
        table = task5()
        table[key] *= 1.01
        with pytest.raises(ManyErrors, match="does not agree") as caught:
            balanced_engine(table, name="spoilt", source="spoilt.toml")
        assert key in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"counterweights": ["Counterweight 1", "Counterweight 3"]}, "Counterweight 3"),
        ({"counterweights": ["Counterweight 1", "Balance Hole 1"]}, "one plane"),
        ({"sections": []}, "crankshaft.sections"),
    ],
)
def test_a_crankshaft_without_two_planes_is_refused(table: dict[str, Any], message: str) -> None:
    content = tomllib.loads(shipped("engines")["msu-shafts"])
    content["balance"]["crankshaft"] |= table
    with pytest.raises(ManyErrors, match=message):
        balanced_engine(content, name="spoilt", source="spoilt.toml")


def test_a_users_file_is_found_beside_its_folder(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        "crank_radius_m = 0.04\nrod_length_m = 0.14\nreciprocating_mass_kg = 0.5\n"
        "rotating_unbalance_kg_m = 0.01\nrotating_unbalance_deg = 90.0\n",
        encoding="utf-8",
    )
    subject = load_balanced_engine("mine.toml", beside=tmp_path)
    assert subject.name == "mine"
    assert reduced_masses(subject).rotating_g == pytest.approx(250j, rel=1e-12)


def test_an_engine_of_another_kind_is_refused_by_name() -> None:
    others = [name for name in shipped("engines") if name not in CRANK_ENGINES]
    for name in [*others, "nowhere"]:
        with pytest.raises(RequestError) as caught:
            load_balanced_engine(name)
        assert name in str(caught.value)
        assert caught.value.exit_status == 2
