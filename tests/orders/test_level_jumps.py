"""A channel whose gain changed between recordings at one speed is named; loads, sweeps and modes are not."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.level_jumps import RecordedLevel, level_jumps
from crankorder.quantities import WHICH_IS_RIGHT

NAMES = ("X", "Y", "Z")


def recordings(rng: np.random.Generator, n_speeds: int = 6, n_each: int = 3) -> list[RecordedLevel]:
    made = []
    for speed in 500.0 * 1.1 ** np.arange(n_speeds):
        level = rng.lognormal(0.0, 1.0, 3)
        for number in range(n_each):
            rms = dict(zip(NAMES, level * rng.lognormal(0.0, 0.1, 3), strict=True))
            made.append(RecordedLevel(f"{speed:.0f}_{number}", (speed, speed * 1.002), rms))
    return made


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("factor", [10.0, 0.1, 6.0])
def test_a_changed_gain_is_named_with_its_factor(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    levels = recordings(rng)
    chosen = levels[rng.integers(len(levels))]
    chosen.rms["Y"] *= factor
    [flag] = level_jumps(levels, ratio=3.0)
    assert (flag["recording"], flag["channel"], flag["severity"]) == (chosen.recording, "Y", "suspect")
    told = float(flag["detail"].split("its level is ")[1].split()[0])
    assert told == pytest.approx(factor, rel=0.6)


@pytest.mark.parametrize("seed", range(20))
def test_of_two_recordings_both_are_named(seed: int) -> None:
    levels = recordings(np.random.default_rng(seed), n_speeds=2, n_each=2)
    levels[0].rms["Z"] *= 10.0
    assert {flag["recording"] for flag in level_jumps(levels, ratio=3.0)} == {one.recording for one in levels[:2]}


def test_where_no_majority_agrees_all_are_left_out_and_that_is_said() -> None:
    levels = recordings(np.random.default_rng(3), n_speeds=1, n_each=4)
    for one in levels[:2]:
        one.rms["Z"] *= 10.0
    flags = level_jumps(levels, ratio=3.0)
    assert {flag["recording"] for flag in flags} == {one.recording for one in levels}
    assert all(flag["left_out"] == "channel" and WHICH_IS_RIGHT in flag["detail"] for flag in flags)


@pytest.mark.parametrize("seed", range(10))
def test_of_two_alike_those_next_in_speed_tell_which_is_wrong(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = recordings(rng, n_speeds=6, n_each=2)
    for one in levels:
        one.floor.update({name: one.speed_rpm[0] * rng.lognormal(0.0, 0.05) for name in NAMES})
    chosen = levels[rng.integers(len(levels))]
    chosen.rms["Z"] *= 10.0
    chosen.floor["Z"] *= 10.0
    [flag] = level_jumps(levels, ratio=3.0)
    assert flag["recording"] == chosen.recording and WHICH_IS_RIGHT not in flag["detail"]


@pytest.mark.parametrize("seed", range(50))
def test_nothing_is_told_of_sound_levels_a_load_a_sweep_or_other_speeds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = recordings(rng)
    assert level_jumps(levels, ratio=3.0) == []
    loaded = [
        RecordedLevel(one.recording, one.speed_rpm, {name: 5.0 * level for name, level in one.rms.items()})
        for one in levels[:1]
    ]
    assert level_jumps([*loaded, *levels[1:]], ratio=3.0) == []
    levels[0].rms["X"] *= 10.0
    sweep = RecordedLevel(levels[0].recording, (300.0, 900.0), levels[0].rms)
    assert level_jumps([sweep, *levels[1:]], ratio=3.0) == []
    assert level_jumps(recordings(rng, n_speeds=12, n_each=1), ratio=3.0) == []


def stepped(rng: np.random.Generator, n_speeds: int = 6) -> list[RecordedLevel]:
    """One recording per speed: lines and modes make the level what they like, the floor grows with the speed."""
    made, first, growth = [], rng.lognormal(0.0, 1.0, 3), rng.uniform(0.0, 2.0, 3)
    for number, speed in enumerate(700.0 * 1.15 ** np.arange(n_speeds)):
        floor = first * 1.15 ** (number * growth) * rng.lognormal(0.0, 0.1, 3)
        level = dict(zip(NAMES, rng.lognormal(2.0, 1.0, 3), strict=True))
        named = dict(zip(NAMES, floor, strict=True))
        made.append(RecordedLevel(f"{speed:.0f}", (speed, speed * 1.001), level, named))
    return made


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_with_one_recording_per_speed_the_floor_tells_the_changed_gain(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    levels = stepped(rng)
    assert level_jumps(levels, ratio=3.0) == []
    chosen = levels[rng.integers(len(levels))]
    chosen.floor["Y"] *= factor
    [flag] = level_jumps(levels, ratio=3.0)
    assert (flag["recording"], flag["channel"], flag["severity"]) == (chosen.recording, "Y", "suspect")


@pytest.mark.parametrize("seed", range(10))
def test_a_load_that_raises_all_floors_is_no_gain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = stepped(rng)
    chosen = levels[rng.integers(len(levels))]
    for name in NAMES:
        chosen.floor[name] *= 8.0
    assert level_jumps(levels, ratio=3.0) == []
