"""The file of an engine with elastic hinges: what is shipped loads, what is wrong is told all at once."""

from pathlib import Path
from typing import Any

import pytest

from crankorder.engine.hinged_crank import load_hinged_engine
from crankorder.errors import ManyErrors, RequestError

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


def load(folder: Path, text: str) -> Any:
    """The engine of a file with this text."""
    (folder / "mine.toml").write_text(text)
    return load_hinged_engine("mine", folder)


def test_the_shipped_file_holds_the_nodes_and_mechanisms_of_the_document(truth: dict[str, Any]) -> None:
    engine = load_hinged_engine("elastic-hinge")
    nodes = truth["seed003"]["nodes_deg_Nm"].values()
    ours = [list(map(list, zip(branch.angle_deg, branch.torque_nm, strict=True))) for branch in engine.curve.branches]
    assert ours == list(nodes)
    assert sorted(engine.cranks) == sorted(truth["seed003"]["mechanisms"])


def test_a_rod_without_inertia_is_taken_as_slender(tmp_path: Path) -> None:
    engine = load(tmp_path, GOOD)
    assert engine.cranks["one"].rod_inertia_kg_m2 == pytest.approx(12 / 9.81 * 0.3**2 / 12, rel=1e-15)
    assert load(tmp_path, GOOD + "rod_inertia_kg_m2 = 0.0\n").cranks["one"].rod_inertia_kg_m2 == 0
    assert engine.mechanisms[0].speeds_rpm == pytest.approx([954.9296585513721])


def test_every_fault_of_a_file_is_told(tmp_path: Path) -> None:
    wrong = GOOD.replace("rod_weight_n = 12.0", "rod_weight_n = -1.0\nrod_wieght_n = 1.0").replace("[0, 360]", "[0]")
    with pytest.raises(ManyErrors) as caught:
        load(tmp_path, wrong)
    text = str(caught.value)
    for place in ("mechanisms.0.rod_weight_n", "mechanisms.0.rod_wieght_n", "torque.0"):
        assert f"mine.toml: {place}" in text
    assert len(caught.value.faults) == 3


@pytest.mark.parametrize(
    ("before", "after", "what"),
    [
        ("rod_centre_to_piston_m = 0.2", "rod_centre_to_piston_m = 0.0", "rod longer"),
        ("[0, 360]", "[0, 180]", "without a gap"),
        ('"elastic-hinge"', '"crank"', "kind"),
        (GOOD[GOOD.index("[[mech") :], GOOD[GOOD.index("[[mech") :] * 2, "one name"),
        (GOOD, "mechanisms = []" + GOOD[: GOOD.index("[[mech")], "at least one"),
    ],
)
def test_data_that_cannot_turn_or_do_not_join_are_refused(tmp_path: Path, before: str, after: str, what: str) -> None:
    with pytest.raises(ManyErrors, match=what):
        load(tmp_path, GOOD.replace(before, after))


def test_a_file_that_does_not_exist_is_told() -> None:
    with pytest.raises(RequestError, match="no such engine"):
        load_hinged_engine("nowhere")


def places(folder: Path, text: str) -> list[str]:
    """Place of every fault that is told of a file of this text."""
    with pytest.raises(ManyErrors) as caught:
        load(folder, text)
    return [str(fault.place) for fault in caught.value.faults]


@pytest.mark.parametrize("key", ["rod_weight_n", "piston_weight_n"])
def test_a_negative_weight_does_not_hide_a_rod_too_short(tmp_path: Path, key: str) -> None:
    short = GOOD.replace("rod_centre_to_piston_m = 0.2", "rod_centre_to_piston_m = 0.0")
    told = places(tmp_path, short.replace(f"{key} = 1", f"{key} = -1"))
    assert told == ["mechanisms.0.rod_centre_to_piston_m", f"mechanisms.0.{key}"]


def test_a_faulty_mechanism_hides_no_gap_of_the_torque_curve_and_the_other_way_round(tmp_path: Path) -> None:
    gap = GOOD.replace("[0, 360]", "[0, 180]")
    assert places(tmp_path, gap.replace("piston_weight_n = 1", "piston_weight_n = -1")) == [
        "torque",
        "mechanisms.0.piston_weight_n",
    ]
    twice = gap + GOOD[GOOD.index("[[mech") :]
    assert places(tmp_path, twice) == ["torque", "mechanisms"]


def test_falling_angles_and_a_missing_torque_are_told_of_the_branch(tmp_path: Path) -> None:
    assert places(tmp_path, GOOD.replace("[0, 360]", "[360, 0]")) == ["torque.0.angle_deg"]
    assert places(tmp_path, GOOD.replace("[0, 0]", "[0]")) == ["torque.0.torque_nm"]
