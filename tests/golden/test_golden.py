"""Findings and results of six scenes are what they were: that something moved, not that it is wrong.

``python tests/golden/make.py`` says what moved and keeps it.
"""

import pytest

from golden.make import SCENES, SUMMARIES, kept
from golden.summary import differences, summary_of

QUICK = ("thesis-second-motoring",)


@pytest.mark.cases(len(SCENES))
@pytest.mark.parametrize(
    "scene", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SCENES]
)
def test_a_run_gives_what_it_gave(scene, tmp_path):
    assert differences(kept(scene), summary_of(scene, tmp_path)) == []


def test_summaries_are_small():
    assert sum(file.stat().st_size for file in SUMMARIES.iterdir()) < 500_000


def test_what_moved_is_told_and_what_lies_within_its_tolerance_is_not():
    before = {"a": [[10.0, 9.0, 11.0], [1.0, None, None]], "b": [100.0, 1.0], "c": ["locked", None]}
    within = {"a": [[10.1, 9.1, 11.1], [1.005, None, None]], "b": [100.09, 1.09], "c": ["locked", None]}
    assert differences(before, within) == []
    beyond = {"a": [[10.0, 9.0, 11.3], [1.0, None, None]], "b": [100.0, 1.2], "c": ["slips", None]}
    assert [line.partition(",")[0] for line in differences(before, beyond)] == [
        f"{name}: 1 of 2 moved" for name in "abc"
    ]
    assert differences(before, {"a": before["a"], "b": [1.0], "d": []}) == [
        "c: gone",
        "d: new",
        "b: 1 values, there were 2",
    ]
