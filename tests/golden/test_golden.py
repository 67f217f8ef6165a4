"""Results, findings, text and stages are what they were: made anew on purpose by ``python tests/golden/make.py``."""

from __future__ import annotations

from pathlib import Path

import pytest

from golden.cases import QUICK, SHARED, all_cases
from golden.make import kept
from golden.runs import summary_of
from golden.summary import differences

CASES = [
    pytest.param(case, id=case.name, marks=[] if case.name in QUICK else [pytest.mark.slow]) for case in all_cases()
]


@pytest.mark.parametrize("case", CASES)
def test_a_run_gives_what_it_gave(case, tmp_path: Path) -> None:
    if case.is_real and not SHARED.exists():
        pytest.skip("../shared/data is absent: it lies beside the project, never inside")
    before = kept(case.name)
    assert before is not None, "make it by python tests/golden/make.py"
    folder = tmp_path / "run"
    folder.mkdir()
    assert differences(before, summary_of(case, folder)) == []


def test_a_moved_number_is_told() -> None:
    def of(value: float) -> dict[str, object]:
        column = {"type": "float64", "shape": [2], "missing": 0, "min": 1.0, "max": 4.0, "rms": 2.9}
        return {"results": {"a": {**column, "samples": [1.0, value]}}, "findings": {}, "stages": [], "text": []}

    assert differences(of(4.0), of(4.0 + 3e-9)) == []
    assert differences(of(4.0), of(4.0 + 5e-9)) == ["results: a: by 5e-09 of 4 (1.3e-09)"]
