"""Every hard case of the order rooms is held to its mark (figure: reports/speed-error/hard-cases.png)."""

import pytest

from made.hard_cases import CASES

LONG = ("close_orders", "crossing_shafts", "fast_ramps", "heavy_smoothing")


def test_the_hard_cases_are_right():
    made = [CASES[name]() for name in CASES if name not in LONG]
    assert not [f"{case.asked}: {case.error:.2g}" for case in made if not case.error <= case.mark]


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_the_long_hard_case_is_right(name):
    case = CASES[name]()
    assert case.error <= case.mark, f"{case.asked}: {case.error:.2g}"
