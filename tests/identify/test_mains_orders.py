"""Mains among the orders of a test at one speed: alone they are named, where an order stands too both are said."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from crankorder.identify.causes.explain import explained
from crankorder.identify.findings import going_with_speed
from crankorder.identify.found import AgreedOrder, Tone
from crankorder.identify.lines.line_evidence import UNPROVEN
from crankorder.identify.machine_model import MachineModel
from crankorder.identify.said import LIKE_UNBALANCE
from crankorder.settings import load_settings
from made.found_lines import agreed, fit, line

SETTINGS = load_settings().identify
ROTOR = MachineModel(revs_per_cycle=1)


def at_speed(order: float, rpm: float, *, lock: str = "slips", error: float = 1e-5) -> AgreedOrder:
    """An order that was seen at one speed."""
    return agreed(order, line(order, speed_rpm=[rpm]), lock=lock, error=error)


def said(*orders: AgreedOrder, longest_rev: float = np.inf, tones: tuple[Tone, ...] = ()) -> list[str]:
    sources = {"sources": ROTOR, "quantity": {"A": "acceleration"}, "longest_rev": longest_rev}
    causes = explained(orders, fit(tones=tones), [], settings=SETTINGS, **sources)
    return [causes.orders["A", one.order].text for one in orders]


@pytest.mark.cases(2)
@pytest.mark.parametrize("mains", [50.0, 60.0])
@pytest.mark.parametrize(("multiple", "words"), [(1, "mains"), (2, "twice mains")])
@pytest.mark.parametrize("off", [-0.004, 0.0, 0.004])
def test_one_line_at_the_mains_or_its_double_is_mains(mains: float, multiple: int, words: str, off: float) -> None:
    rpm = 1713.0
    assert said(at_speed(60.0 * multiple * mains * (1.0 + off) / rpm, rpm)) == [words]


@pytest.mark.cases(1)
@pytest.mark.parametrize("hertz", [49.2, 51.0, 58.9, 98.6, 121.5, 48.35])
def test_a_tone_beside_the_mains_is_none(hertz: float) -> None:
    assert said(at_speed(60.0 * hertz / 1713.0, 1713.0)) == ["unexplained"]


def test_a_third_multiple_alone_is_not_called_mains_and_beside_the_first_it_is() -> None:
    rpm = 1713.0
    third, first = at_speed(60.0 * 150.06 / rpm, rpm), at_speed(60.0 * 50.02 / rpm, rpm)
    assert said(third) == ["unexplained"]
    assert said(first, third) == ["mains", "3 x mains"]


def test_at_one_speed_an_order_on_the_mains_is_said_with_them() -> None:
    assert said(at_speed(2.0, 1500.0, lock="locked")) == ["shaft harmonic or mains"]
    assert said(at_speed(4.0, 1500.0, lock="locked")) == ["shaft harmonic or twice mains"]
    assert said(at_speed(1.0, 3000.0, lock="locked")) == [f"{LIKE_UNBALANCE} or mains"]


@pytest.mark.slow
def test_lines_on_two_mains_frequencies_are_said_to_be_one_or_a_tone() -> None:
    rpm = 1713.0
    assert said(at_speed(60.0 * 50.0 / rpm, rpm), at_speed(60.0 * 60.0 / rpm, rpm)) == ["mains or another tone"] * 2


def test_an_order_at_many_speeds_is_no_mains() -> None:
    assert said(agreed(2.0, line(2.0))) == ["shaft harmonic"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_of_two_lines_at_one_multiple_neither_is_mains_for_certain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rpm, multiple, apart = rng.uniform(1200.0, 2900.0), int(rng.integers(1, 3)), rng.uniform(0.03, 0.08)
    first = 50.0 * multiple + rng.uniform(-0.05, 0.05)
    words = f"{'twice mains' if multiple == 2 else 'mains'} or another tone"
    assert said(at_speed(60.0 * first / rpm, rpm), at_speed(60.0 * (first + apart) / rpm, rpm)) == [words] * 2
    # in two recordings the supply may have moved
    other = rpm * 1.02
    both = said(at_speed(60.0 * first / rpm, rpm), at_speed(60.0 * (first + apart) / other, other))
    assert both == [words.split(" or ")[0]] * 2


@pytest.mark.slow
@pytest.mark.parametrize("away_hz", [-0.04, 0.03])
def test_two_lines_that_no_recording_parts_may_be_the_order_as_well(away_hz: float) -> None:
    """Twice mains beside 2 x 2999 rpm in 20 s: what is found lies between the two, and holds neither."""
    rpm = 60.0 * (50.0 + 0.5 * away_hz)
    between = at_speed(60.0 * (100.0 + 0.4 * away_hz) / rpm, rpm, lock="undecided", error=2e-5)
    assert said(between, longest_rev=1000.0) == ["twice mains or order 2"]
    assert said(between, longest_rev=1e6) == ["twice mains"]


def test_only_what_goes_with_the_speed_meets_natural_frequencies() -> None:
    rpm = 1713.0
    mains, tone = at_speed(6000.0 / rpm, rpm), at_speed(60.0 * 87.3 / rpm, rpm)
    second, doubtful = at_speed(2.0, rpm, lock="locked"), at_speed(60.0 * 41.0 / rpm, rpm, lock="undecided")
    swept = agreed(3.3, line(3.3), lock="slips")
    orders = (mains, tone, second, doubtful, swept)
    causes = explained(orders, fit(), [], sources=ROTOR, quantity={"A": "acceleration"}, settings=SETTINGS)
    assert going_with_speed(orders, causes) == (second, swept)


@pytest.mark.slow
def test_a_line_of_too_few_revolutions_on_the_mains_may_be_a_natural_frequency() -> None:
    """Noise rings a mode of 60 Hz: in half a second nothing tells it from mains."""
    made = at_speed(12.1125, 300.0, error=0.05)
    lines = tuple(dataclasses.replace(one, evidence=UNPROVEN) for one in made.lines)
    assert said(dataclasses.replace(made, lines=lines)) == ["mains or a natural frequency"]
    assert said(made) == ["mains"]
