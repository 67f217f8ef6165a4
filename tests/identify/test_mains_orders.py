"""At one speed mains look like orders: multiples of one frequency are told from lines that are only near them."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.identify.mains_orders import mains_orders
from crankorder.settings import load_settings

SETTINGS = load_settings().identify
RPM = 1748.0


def at_hz(*frequencies: float, rpm: tuple[float, ...] = (RPM,)) -> tuple[AgreedOrder, ...]:
    """Orders whose lines stand at ``frequencies`` at the first speed of ``rpm``."""
    ones = np.ones(len(rpm))
    made = []
    for order in (60.0 * f / rpm[0] for f in frequencies):
        line = OrderLine(
            "A", order, 0.001, np.arange(len(rpm)), np.array(rpm), ones, 0.01 * ones, 9 * ones, np.nan * ones,
            "steady, not locked", 20.0,
        )  # fmt: skip
        made.append(AgreedOrder(order, 0.001, 9.0, "slips", None, (line,)))
    return tuple(made)


def named(orders: tuple[AgreedOrder, ...], rpm: float = RPM) -> list[float]:
    return sorted(round(order * rpm / 60.0, 2) for order in mains_orders(orders, settings=SETTINGS))


def test_a_line_near_a_multiple_that_the_mains_of_the_others_does_not_make_is_no_mains() -> None:
    # mains of 60.005 Hz; 600.35 Hz is a bearing's, 0.3 Hz off
    assert named(at_hz(120.01, 240.02, 360.03, 600.35, 720.06)) == [120.01, 240.02, 360.03, 720.06]


def test_mains_that_has_wandered_is_still_mains() -> None:
    assert named(at_hz(99.8, 199.6, 299.4)) == [99.8, 199.6, 299.4]


@pytest.mark.parametrize("frequencies", [(120.0,), (120.0, 240.0), (360.0, 420.0, 480.0)])
def test_few_multiples_or_none_of_the_first_are_no_proof(frequencies: tuple[float, ...]) -> None:
    assert named(at_hz(*frequencies)) == []


def test_what_moves_with_the_speed_is_no_mains() -> None:
    assert named(at_hz(120.0, 240.0, 360.0, rpm=(RPM, 1.2 * RPM))) == []
