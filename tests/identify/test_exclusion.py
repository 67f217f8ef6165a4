"""What the orders exclude: a hidden mode that amplifies never, fine steps with small errors everything else."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.modes.order_responses import Block, with_best_law
from crankorder.identify.modes.responses import least_seen
from crankorder.identify.modes.surface_fit import NO_POLES
from made.drawn_orders import CHANNELS, blocks_from, drawn_machine
from made.shipped import IDENTIFY

UNIT = dict.fromkeys(CHANNELS, "m/s2")
FACTOR = IDENTIFY.free_amplification


def _bounds(blocks):
    told = [with_best_law(block, NO_POLES) for block in blocks]
    return least_seen(told, NO_POLES, unit=UNIT, settings=IDENTIFY)


def _planted(seed):
    """A machine with one mode somewhere between two of its speeds, and the speed at which its first order meets it."""
    random, one = np.random.default_rng((seed, 7)), {"n_modes": (1, 1), "n_orders": (1, 1)}
    machine = drawn_machine(seed, n_speeds=(8, 40), damping=(0.002, 0.02), span_rpm=(2000.0, 5000.0), **one)
    speed = machine.speed_rpm
    row = int(random.integers(1, len(speed) - 2))
    at = speed[row] + (speed[row + 1] - speed[row]) * random.uniform(0.1, 0.9)
    return replace(machine, natural_hz=np.array([machine.orders[0].order * at / 60.0])), float(at)


def test_a_mode_that_hides_between_two_speeds_and_amplifies_is_not_excluded():
    """Of an order that has 5 % of its largest amplitude there: what is smaller endangers nothing."""
    dangerous = 0
    for seed in range(60):
        machine, at = _planted(seed)
        amplified = float(machine.amplification(0, 0, np.array([at]))[0])
        there = float(np.abs(machine.amplitude(0, np.array([at]))).max())
        if amplified > FACTOR and there >= 0.05 * np.abs(machine.amplitude(0, machine.speed_rpm)).max():
            dangerous += 1
            (bound,) = _bounds(blocks_from(machine, seed))
            place = int(np.searchsorted(bound.speed_rpm, at))  # the speeds asked about on both sides
            assert bound.amplification[max(place - 1, 0) : place + 1].max() > FACTOR, seed
    assert dangerous > 20


def test_two_speeds_exclude_nothing_between_them():
    machine = drawn_machine(1, n_modes=(0, 0), n_orders=(1, 1), n_speeds=(2, 2))
    (bound,) = _bounds(blocks_from(machine, 1))
    assert np.all(bound.amplification[1:-1] > FACTOR)


def test_what_amplifies_an_order_of_no_account_is_nothing():
    """A bound is over the noise and over a small share of the largest amplitude of any order."""
    machine = drawn_machine(2, n_modes=(0, 0), n_orders=(2, 2), n_speeds=(40, 40), scatter=(0.0005,))
    loud, quiet = blocks_from(machine, 2)
    amplitude, error = 1e-5 * quiet.rows.amplitude, 1e-5 * quiet.rows.error
    quiet = Block.of(replace(quiet.rows, amplitude=amplitude, error=error))
    beside, alone = _bounds([loud, quiet])[1].amplification, _bounds([quiet])[0].amplification
    assert np.max(beside) == pytest.approx(1.0)
    assert np.all(beside <= alone) and np.max(alone) > 1.1
