"""The file of an engine with elastic hinges: what is wrong is told all at once."""

from pathlib import Path
from typing import Any

import pytest

from crankorder.engine.hinged_crank import load_hinged_engine
from crankorder.errors import ManyErrors

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


@pytest.mark.slow
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
