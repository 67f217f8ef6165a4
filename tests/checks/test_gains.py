"""A channel whose gain changed between recordings at one speed is named; loads, sweeps and modes are not."""

from functools import partial
from itertools import product

import numpy as np
import pytest

from crankorder.checks.gains import RecordedLevel, level_jumps
from crankorder.quantities import WHICH_IS_RIGHT

NAMES = ("X", "Y", "Z")
jumps = partial(level_jumps, ratio=3.0, proven_ratio=1.4)


def recorded(speed, *rows, names=NAMES, name=""):
    """A recording at a ``speed`` with a value for each channel in each of ``rows`` (level, floor, blocks, lines)."""
    told = (dict(zip(names, row, strict=True)) for row in rows)
    return RecordedLevel(name or f"{speed:.1f}", (speed, speed * 1.001), *told)


def recordings(rng, n_speeds=6, n_each=3):
    made = []
    for speed in 500.0 * 1.1 ** np.arange(n_speeds):
        level = rng.lognormal(0.0, 1.0, 3)
        for number in range(n_each):
            made.append(recorded(speed, level * rng.lognormal(0.0, 0.1, 3), name=f"{speed:.0f}_{number}"))
    return made


def test_a_changed_gain_is_named_with_its_factor():
    for seed, factor in product(range(20), (10.0, 0.1, 6.0)):
        rng = np.random.default_rng(seed)
        levels = recordings(rng)
        chosen = levels[rng.integers(len(levels))]
        chosen.rms["Y"] *= factor
        [flag] = jumps(levels)
        assert (flag["recording"], flag["channel"], flag["severity"]) == (chosen.recording, "Y", "suspect")
        told = float(flag["detail"].split("its level is ")[1].split()[0])
        assert told == pytest.approx(factor, rel=0.6)


def test_where_no_majority_agrees_all_are_left_out_and_that_is_said():
    levels = recordings(np.random.default_rng(3), n_speeds=1, n_each=4)
    for one in levels[:2]:
        one.rms["Z"] *= 10.0
    flags = jumps(levels)
    assert {flag["recording"] for flag in flags} == {one.recording for one in levels}
    assert all(flag["left_out"] == "channel" and WHICH_IS_RIGHT in flag["detail"] for flag in flags)


def test_of_two_alike_those_next_in_speed_tell_which_is_wrong():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        levels = recordings(rng, n_speeds=6, n_each=2)
        for one in levels:
            one.floor.update({name: one.speed_rpm[0] * rng.lognormal(0.0, 0.05) for name in NAMES})
        chosen = levels[rng.integers(len(levels))]
        chosen.rms["Z"] *= 10.0
        chosen.floor["Z"] *= 10.0
        [flag] = jumps(levels)
        assert flag["recording"] == chosen.recording and WHICH_IS_RIGHT not in flag["detail"]


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_told_of_sound_levels_a_load_a_sweep_or_other_speeds(seed):
    rng = np.random.default_rng(seed)
    levels = recordings(rng)
    assert jumps(levels) == []
    first = levels[0]
    loaded = RecordedLevel(first.recording, first.speed_rpm, {name: 5.0 * rms for name, rms in first.rms.items()})
    assert jumps([loaded, *levels[1:]]) == []
    first.rms["X"] *= 10.0
    sweep = RecordedLevel(first.recording, (300.0, 900.0), first.rms)
    assert jumps([sweep, *levels[1:]]) == []
    assert jumps(recordings(rng, n_speeds=12, n_each=1)) == []


def stepped(rng, n_speeds=6):
    """One recording per speed: lines and modes make the level what they like, the floor grows with the speed."""
    made, first, growth = [], rng.lognormal(0.0, 1.0, 3), rng.uniform(0.0, 2.0, 3)
    for number, speed in enumerate(700.0 * 1.15 ** np.arange(n_speeds)):
        floor = first * 1.15 ** (number * growth) * rng.lognormal(0.0, 0.1, 3)
        made.append(recorded(speed, rng.lognormal(2.0, 1.0, 3), floor))
    return made


@pytest.mark.parametrize("seed", range(20))
def test_with_one_recording_per_speed_the_floor_tells_the_changed_gain_and_a_load_on_all_floors_is_none(seed):
    for factor, names in ((10.0, ("Y",)), (0.1, ("Y",)), (8.0, NAMES)):
        rng = np.random.default_rng(seed)
        levels = stepped(rng)
        assert jumps(levels) == []
        chosen = levels[rng.integers(len(levels))]
        for name in names:
            chosen.floor[name] *= factor
        told = [(flag["recording"], flag["channel"], flag["severity"]) for flag in jumps(levels)]
        assert told == ([] if names == NAMES else [(chosen.recording, "Y", "suspect")])


BLOCKS, ORDERS = 16, 8


def proven(rng, n_channels=3, n_speeds=7):
    """A machine's floors by block and orders: both grow, orders scatter from channel to channel as modes make them."""
    names = "XYZW"[:n_channels]
    shape, growth = rng.lognormal(0.0, 1.0, (n_channels, BLOCKS)), rng.uniform(0.0, 2.0)
    size, force = rng.lognormal(2.0, 1.0, (n_channels, ORDERS)), rng.uniform(0.0, 2.0, ORDERS)
    made = []
    for speed in 700.0 * np.cumprod(rng.uniform(1.05, 1.3, n_speeds)):
        floor = shape * (speed / 1500.0) ** growth * rng.lognormal(0.0, 0.02, (n_channels, BLOCKS))
        lines = size * (speed / 1500.0) ** force * rng.lognormal(0.0, 0.07, (n_channels, ORDERS))
        lines *= rng.lognormal(0.0, 0.5, ORDERS)  # what a resonance does to all channels alike
        level = np.sqrt((lines**2).sum(axis=1))
        made.append(recorded(speed, level, np.median(floor, axis=1), floor, lines, names=names))
    return made


def with_gain(one, name, factor, *, only=()):
    for key in only or ("floor", "blocks", "lines"):
        getattr(one, key)[name] = factor * getattr(one, key)[name]


def told(levels):
    return {(flag["recording"], flag["channel"]) for flag in jumps(levels)}


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("factor", [1.5, 2.0, 0.5])
def test_floors_and_orders_together_prove_a_gain_that_no_level_shows(seed, factor):
    rng = np.random.default_rng([1, seed])
    levels = proven(rng, n_channels=int(rng.integers(2, 5)))
    assert told(levels) == set()
    chosen = levels[rng.integers(len(levels))]
    with_gain(chosen, "Y", factor)
    assert told(levels) == {(chosen.recording, "Y")}


def test_of_a_gain_that_was_switched_for_good_nobody_knows_which_was_meant():
    for seed in range(10):
        levels = proven(np.random.default_rng([2, seed]))
        for one in levels[5:]:
            with_gain(one, "X", 2.0)
        assert told(levels) == {(one.recording, "X") for one in levels}


@pytest.mark.parametrize("seed", range(20))
def test_what_is_no_gain_proves_none(seed):
    rng = np.random.default_rng([3, seed])
    alone, noisy, loaded, ringing = proven(rng, n_channels=1), proven(rng), proven(rng), proven(rng)
    with_gain(alone[3], "X", 2.0)
    with_gain(noisy[3], "X", 2.0, only=("floor", "blocks"))  # its orders stay: noise of the cable
    for name in "XYZ":
        with_gain(loaded[3], name, 2.0)
    ringing[3].blocks["X"][:6] *= 2.0  # a resonance raises a part of the spectrum
    with_gain(ringing[3], "X", 2.0, only=("lines",))
    assert [told(levels) for levels in (alone, noisy, loaded, ringing)] == 4 * [set()]


def test_a_recording_in_another_unit_is_asked_about():
    for seed, (factor, said), names in product(
        range(20), [(9.80665, "g beside m/s2"), (0.1, "sensitivity"), (1e-3, "V beside mV")], (NAMES, ("X",))
    ):
        rng = np.random.default_rng(seed)
        levels = []
        for number, one in enumerate(stepped(rng)):
            floor = {name: 1.1**number * rng.lognormal(0.0, 0.01) for name in names}
            levels.append(RecordedLevel(one.recording, one.speed_rpm, {name: one.rms[name] for name in names}, floor))
        assert "unit_doubt" not in {flag["flag"] for flag in jumps(levels)}
        chosen = levels[rng.integers(1, len(levels) - 1)]
        for name in names:
            chosen.floor[name] *= factor
        [flag] = [flag for flag in jumps(levels) if flag["flag"] == "unit_doubt"]
        assert (flag["recording"], flag["severity"]) == (chosen.recording, "suspect")
        assert "unit?" in flag["detail"] and said in flag["detail"] and "left_out" not in flag
