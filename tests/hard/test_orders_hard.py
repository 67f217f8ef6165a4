"""Every hard case of the order rooms is held to its mark (figure: reports/speed-error/hard-cases.png)."""

from __future__ import annotations

import pytest

from made.hard_cases import CASES


@pytest.mark.parametrize("name", CASES)
def test_the_hard_case_is_right(name):
    case = CASES[name]()
    assert case.error <= case.mark, f"{case.asked}: {case.error:.2g}"
