"""Tones of the map beside the recordings: mains, tones, or orders."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from crankorder.identify.explain import Beside, explained
from crankorder.identify.findings import going_with_speed
from crankorder.identify.found import Tone
from crankorder.identify.lines.line_evidence import UNPROVEN
from crankorder.identify.machine_model import MachineModel
from crankorder.identify.modes.floor import Floor
from crankorder.identify.modes.tones import kind_of, with_one_mains, without_absent_mains
from crankorder.report.sentences.of_lines import LIKE_UNBALANCE
from made.found_lines import agreed, fit, line
from made.line_frames import held_at
from made.shipped import IDENTIFY

RPM = 1777.0


def recorded(*lines, seed=0):
    """A recording at RPM with ``lines`` (Hz, amplitude) and order 1 in noise."""
    return held_at(np.random.default_rng(seed), RPM, [*lines, (RPM / 60.0, 1.0)])


def told(*tones):
    made = tuple(Tone(hertz, 0.005, "tone", {"A": (size, 0.01)}, "no damping") for hertz, size in tones)
    return replace(fit(), tones=made, frequency_hz=np.arange(1.0, 400.0, 0.5))


def test_a_high_multiple_of_the_mains_that_a_recording_lacks_is_a_tone():
    with_it, without = recorded((349.8, 0.5)), recorded((100.0, 1.0))
    modal = replace(told((349.8, 0.5)), tones=(Tone(349.8, 0.01, "mains", {"A": (0.5, 0.01)}, "7 times"),))
    (tone,) = without_absent_mains(modal, [*with_it, *without], settings=IDENTIFY).tones
    assert tone.kind == "tone" and "1 of 2 recordings" in tone.evidence
    assert without_absent_mains(modal, with_it, settings=IDENTIFY).tones == modal.tones
    for hertz, kind in ((250.2, "mains"), (250.3, "tone")):  # a weak multiple of a supply that is seen, where it fits
        tones = told((50.04, 1.0), (hertz, 0.5))
        mains = tuple(replace(one, kind="mains") for one in tones.tones)
        _, high = without_absent_mains(replace(tones, tones=mains), recorded((50.04, 1.0)), settings=IDENTIFY).tones
        assert high.kind == kind


def test_a_multiple_that_tells_another_frequency_than_one_told_better_is_no_mains():
    def kinds(*tones):
        made = [Tone(hertz, error, "mains", {"A": (1.0, 0.01)}, "no damping") for hertz, error in tones]
        return [tone.kind for tone in with_one_mains(made, settings=IDENTIFY)]

    assert kinds((59.792, 0.015), (119.978, 0.02)) == ["tone", "mains"]
    assert kinds((59.992, 0.015), (119.978, 0.02), (359.93, 0.01)) == ["mains"] * 3


# A line that stands only at speeds where it lies on an order of the cycle is no tone of its own.


FREQUENCY_HZ = np.arange(2.0, 300.0, 0.5)


def floor_with(line_hz, speed_rpm, size, seed):
    """Floor of noise at ``speed_rpm`` with a line at ``line_hz`` of the power ``size`` (speeds,)."""
    rng, averages = np.random.default_rng(seed), 20
    cells = rng.chisquare(2 * averages, size=(2, len(speed_rpm), FREQUENCY_HZ.size)) / (2 * averages)
    at = int(np.argmin(np.abs(FREQUENCY_HZ - line_hz)))
    cells[0, :, at] += size
    ones, made = np.ones((2, len(speed_rpm))), np.ones((2, FREQUENCY_HZ.size))
    seen = cast(Any, SimpleNamespace(bin_hz=0.5))
    return Floor(FREQUENCY_HZ, made, made, ones, cells, averages * ones, ("A", "B"), speed_rpm, seen, made, cells)


HELD, NO_SPEED, TWO_ALIKE = np.linspace(800.0, 2400.0, 5), np.full(3, np.nan), np.array([1777.0, 1777.5])
AT_1600 = 1e3 * (HELD == 1600.0)


@pytest.mark.cases(6)
@pytest.mark.parametrize(
    ("hertz", "speed", "size", "kind", "words"),
    [
        (80.0, HELD, AT_1600, "order", "seen only at speeds"),  # order 3, as a swing of the speed makes it
        (86.7, HELD, AT_1600, "tone", "at 1 of 5 speeds"),  # between two half orders
        (33.7, HELD, 300.0, "tone", "stays at all speeds"), (37.5, NO_SPEED, 300.0, "tone", None),
        (33.7, TWO_ALIKE, 300.0, "tone", None), (50.03, TWO_ALIKE, 300.0, "mains", None),
    ],
)  # fmt: skip
def test_a_line_at_all_speeds_is_a_tone_and_one_on_an_order_at_one_of_them_an_order(hertz, speed, size, kind, words):
    floor = floor_with(hertz, speed, np.broadcast_to(size, len(speed)), 1)
    told, said = kind_of(hertz, 0.01, floor, settings=IDENTIFY)
    assert told == kind
    assert "speeds" not in said if words is None else words in said


# Mains among the orders of a test at one speed: alone they are named, where an order stands too both are said.


ROTOR = MachineModel(revs_per_cycle=1)


def at_speed(order, rpm, *, lock="slips", error=1e-5):
    """An order that was seen at one speed."""
    return agreed(order, line(order, speed_rpm=[rpm]), lock=lock, error=error)


def said(*orders, longest_rev=np.inf):
    sources = {"sources": ROTOR, "quantity": {"A": "acceleration"}, "beside": Beside(longest_rev=longest_rev)}
    causes = explained(orders, fit(), [], settings=IDENTIFY, **sources)
    return [causes.orders["A", one.order].text for one in orders]


def at_1713(*hertz):
    return [at_speed(60.0 * one / 1713.0, 1713.0) for one in hertz]


NAMED = [
    *(
        (at_1713(multiple * mains * (1.0 + off)), [words])
        for mains in (50.0, 60.0)
        for multiple, words in ((1, "mains"), (2, "twice mains"))
        for off in (-0.004, 0.0, 0.004)
    ),
    *((at_1713(hertz), ["unexplained"]) for hertz in (49.2, 51.0, 58.9, 98.6, 121.5, 48.35, 150.06)),
    (at_1713(50.02, 150.06), ["mains", "3 x mains"]),
    (at_1713(50.0, 60.0), ["mains or another tone"] * 2),
    ([at_speed(2.0, 1500.0, lock="locked")], ["shaft harmonic or mains"]),
    ([at_speed(4.0, 1500.0, lock="locked")], ["shaft harmonic or twice mains"]),
    ([at_speed(1.0, 3000.0, lock="locked")], [f"{LIKE_UNBALANCE} or mains"]),
    ([agreed(2.0, line(2.0))], ["shaft harmonic"]),  # at many speeds
]


@pytest.mark.cases(len(NAMED))
@pytest.mark.parametrize(("orders", "words"), NAMED)
def test_a_line_at_the_mains_is_mains_alone_and_on_an_order_both(orders, words):
    assert said(*orders) == words


@pytest.mark.parametrize(("first", "words"), [(50.02, "mains or another tone"), (99.96, "twice mains or another tone")])
def test_of_two_lines_at_one_multiple_neither_is_mains_for_certain(first, words):
    rpm, apart = 1713.0, 0.05
    assert said(at_speed(60.0 * first / rpm, rpm), at_speed(60.0 * (first + apart) / rpm, rpm)) == [words] * 2
    # in two recordings the supply may have moved
    other = rpm * 1.02
    both = said(at_speed(60.0 * first / rpm, rpm), at_speed(60.0 * (first + apart) / other, other))
    assert both == [words.split(" or ")[0]] * 2


@pytest.mark.parametrize("away_hz", [-0.04, 0.03])
def test_two_lines_that_no_recording_parts_may_be_the_order_as_well(away_hz):
    """Twice mains beside 2 x 2999 rpm in 20 s: what is found lies between the two, and holds neither."""
    rpm = 60.0 * (50.0 + 0.5 * away_hz)
    between = at_speed(60.0 * (100.0 + 0.4 * away_hz) / rpm, rpm, lock="undecided", error=2e-5)
    assert said(between, longest_rev=1000.0) == ["twice mains or order 2"]
    assert said(between, longest_rev=1e6) == ["twice mains"]


def test_only_what_goes_with_the_speed_meets_natural_frequencies():
    rpm = 1713.0
    mains, tone = at_speed(6000.0 / rpm, rpm), at_speed(60.0 * 87.3 / rpm, rpm)
    second, doubtful = at_speed(2.0, rpm, lock="locked"), at_speed(60.0 * 41.0 / rpm, rpm, lock="undecided")
    swept = agreed(3.3, line(3.3), lock="slips")
    orders = (mains, tone, second, doubtful, swept)
    causes = explained(orders, fit(), [], sources=ROTOR, quantity={"A": "acceleration"}, settings=IDENTIFY)
    assert going_with_speed(orders, causes) == (second, swept)


def test_a_line_of_too_few_revolutions_on_the_mains_may_be_a_natural_frequency():
    """Noise rings a mode of 60 Hz: in half a second nothing tells it from mains."""
    made = at_speed(12.1125, 300.0, error=0.05)
    lines = tuple(replace(one, evidence=UNPROVEN) for one in made.lines)
    assert said(replace(made, lines=lines)) == ["mains or a natural frequency"]
    assert said(made) == ["mains"]
