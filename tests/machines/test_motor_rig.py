"""What is said of drawn motors and of the mains: every line named, none made up, both said where two are at one place.

Seeds are drawn afresh in the accuracy test; RIGS_SEED gives the same rigs again.
"""

import os
import secrets
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from machines.motor_judge import findings_of, judged, said_of
from machines.motor_rig import CLASSES, RATE_HZ, draw_rig, samples

LEAST_NAMED = 0.95
"""Share of the lines of the mains and of motors that are named."""


def short(rig):
    """``rig`` with recordings of 20 s."""
    return replace(rig, takes=tuple(replace(take, duration_s=20.0) for take in rig.takes))


def test_the_rig_has_its_lines_where_the_nameplate_puts_them():
    for seed in range(20):
        rig = draw_rig(seed, "motor")
        take = rig.takes[0]
        turns, slip = take.rpm[0] / 60.0, rig.slips[0]
        assert turns == pytest.approx(2.0 * rig.mains_hz / rig.poles * (1.0 - slip))
        for line in take.lines:
            away = 2.0 * slip * rig.mains_hz * line.side
            if line.cause == "pole pass sideband of 1x":
                assert line.at(take.rpm[0]) == pytest.approx(turns + away)
            elif line.cause == "pole pass sideband of 2f":
                assert line.at(take.rpm[0]) == pytest.approx(2.0 * rig.mains_hz + away)
            elif line.cause == "bar pass":
                assert line.at(take.rpm[0]) == pytest.approx(rig.rotor_bars * turns)


def test_the_signal_holds_a_line_as_large_as_it_was_put_in():
    rig = draw_rig(4, "stray mains")
    take = replace(rig.takes[0], duration_s=20.0)
    signal, _ = samples(rig, take, 0)
    time_s = np.arange(len(signal)) / RATE_HZ
    for line in take.lines:
        wave = np.exp(-2j * np.pi * line.at(take.rpm[0]) * time_s)
        assert 2.0 * abs(np.mean(signal * wave)) == pytest.approx(line.size, abs=0.03)


@pytest.mark.parametrize("class_name", ["motor", "beside", "synchronous"])
def test_a_drawn_rig_has_every_line_named_and_none_made_up(class_name, tmp_path):
    rig = short(draw_rig(14, class_name))
    verdicts = judged(rig, findings_of(rig, tmp_path))
    assert verdicts and not [one.words for one in verdicts if not one.good]


def test_a_pump_at_49_2_hz_is_not_mains(tmp_path):
    rig = short(draw_rig(3, "none"))
    take = rig.takes[0]
    pump = replace(take.lines[0], cause="tone", hz=49.2, order=0.0, size=1.0)
    said = said_of(findings_of(replace(rig, takes=(replace(take, lines=(*take.lines, pump)),)), tmp_path))
    at_pump = [text for text, hertz, _, _ in said if abs(hertz - 49.2) < 0.1]
    assert at_pump and not any("mains" in text or "shaft" in text for text in at_pump)


def test_a_motor_that_cannot_turn_so_has_no_line_named(tmp_path):
    rig = replace(short(draw_rig(5, "motor")), poles=6)
    rig = replace(rig, takes=tuple(replace(take, rpm=(1.4 * 40.0 * rig.supply_hz / 2,) * 2) for take in rig.takes))
    found = findings_of(rig, tmp_path)["motor"]
    assert "do not fit" in found["misfit"] and not found["lines"]


@pytest.mark.accuracy
def test_lines_of_mains_and_motors_are_named_none_is_made_up_and_both_are_said_where_mains_stand_on_an_order(tmp_path):
    """Verdicts on 220 rigs, the classes in turn."""
    first = int(os.environ.get("RIGS_SEED") or secrets.randbits(28))
    print(f"RIGS_SEED={first}")
    counts, missed = Counter[str](), Counter[str]()
    for number in range(220):
        rig = draw_rig(first + number, CLASSES[number % len(CLASSES)])
        for verdict in judged(rig, findings_of(rig, tmp_path / str(number))):
            counts[verdict.kind] += 1
            missed[verdict.kind] += not verdict.good
            print("" if verdict.good else verdict.words)
    assert counts["named"] >= 300 and missed["named"] <= (1.0 - LEAST_NAMED) * counts["named"]
    assert missed["nothing made up"] == missed["both said"] == 0 < counts["both said"]
