"""What the orders exclude: a hidden mode that amplifies never, fine steps with small errors everything else."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.modes.order_responses import Block, with_best_law
from crankorder.identify.modes.responses import least_seen
from crankorder.identify.modes.surface_fit import NO_POLES
from crankorder.identify.modes.sweep_poles import sweep_fits
from crankorder.settings import load_settings
from identify.test_sweep_poles import HALVES, a_machine, spectra_of
from machines.machine import Mode
from machines.truth import amplification
from made.drawn_orders import CHANNELS, blocks_from, drawn_machine

pytestmark = pytest.mark.slow

SETTINGS = load_settings().identify
UNIT = dict.fromkeys(CHANNELS, "m/s2")
FACTOR = SETTINGS.free_amplification
LARGE = 0.05
"""Share of the largest amplitude of any order below which an amplitude endangers nothing."""


def _bounds(blocks):
    told = [with_best_law(block, NO_POLES) for block in blocks]
    return least_seen(told, NO_POLES, unit=UNIT, settings=SETTINGS)


def _planted(seed, *, rows):
    """A machine with one mode somewhere between two of its speeds, and the speed at which its first order meets it."""
    random, one = np.random.default_rng((seed, 7)), {"n_modes": (1, 1), "n_orders": (1, 1)}
    machine = drawn_machine(seed, n_speeds=rows, damping=(0.002, 0.02), span_rpm=(2000.0, 5000.0), **one)
    speed = machine.speed_rpm
    row = int(random.integers(1, len(speed) - 2))
    at = speed[row] + (speed[row + 1] - speed[row]) * random.uniform(0.1, 0.9)
    return replace(machine, natural_hz=np.array([machine.orders[0].order * at / 60.0])), float(at)


def _excluded(cases, *, large=LARGE):
    """How many modes of the cases (seed, machine, speed) endanger something there, and those that are excluded.

    ``large``: the share of the largest amplitude that the order must have at the speed.
    """
    dangerous, excluded = 0, []
    for seed, machine, at in cases:
        amplified = float(machine.amplification(0, 0, np.array([at]))[0])
        there = float(np.abs(machine.amplitude(0, np.array([at]))).max())
        if amplified > FACTOR and there >= large * np.abs(machine.amplitude(0, machine.speed_rpm)).max():
            dangerous += 1
            (bound,) = _bounds(blocks_from(machine, seed))
            place = int(np.searchsorted(bound.speed_rpm, at))  # the speeds asked about on both sides
            if bound.amplification[max(place - 1, 0) : place + 1].max() <= FACTOR:
                excluded.append((seed, amplified))
    return dangerous, excluded


@pytest.mark.parametrize(("rows", "seeds"), [((8, 14), range(150)), ((15, 40), range(150, 300))])
def test_a_mode_that_hides_between_two_speeds_and_amplifies_is_not_excluded(rows, seeds):
    dangerous, excluded = _excluded((seed, *_planted(seed, rows=rows)) for seed in seeds)
    assert dangerous > 50
    assert len(excluded) <= 0.01 * dangerous, excluded


@pytest.mark.parametrize("share", [0.12, 0.2])
def test_a_broad_mode_that_fills_a_narrow_range_is_not_excluded(share):
    """Over so few speeds the law of a force may take a mode in that is as wide as the range."""
    cases = []
    for seed in range(40):
        machine, at = _planted(seed, rows=(30, 40))
        speed = np.linspace(at * (1.0 - 0.5 * share), at * (1.0 + 0.5 * share), 40)
        damping = np.array([np.random.default_rng((seed, 3)).uniform(0.4, 0.7) * share])
        cases.append((seed, replace(machine, speed_rpm=speed, damping=damping), at))
    dangerous, excluded = _excluded(cases, large=0.0)
    assert dangerous > 10
    assert len(excluded) <= 0.05 * dangerous, excluded


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


# What the spectra of sweeps exclude, against exact signals: the truth is never above it, and it is not infinite.


ORDERS = [2.0, 3.5]


def drawn(seed, *, hidden):
    """A sweep with a mode that stands out and one that makes ``hidden`` times as much as it would of the first."""
    rng = np.random.default_rng([seed, 71])
    clear = Mode(float(rng.uniform(60.0, 75.0)), 0.01, (0.02, -0.015), (1.0, 0.7), (0.0,))
    share = hidden * float(rng.uniform(0.5, 1.5))
    weak_hz, damping = float(rng.uniform(100.0, 130.0)), float(np.exp(rng.uniform(np.log(0.003), np.log(0.05))))
    drive = (float(rng.uniform(-1.0, 1.0)), 0.8)
    weak = Mode(weak_hz, damping, (0.02 * share, 0.01 * share), drive, (0.0,))
    seconds = float(rng.uniform(6.0, 16.0))
    ends = (1200.0, 4500.0) if rng.random() < 0.5 else (4500.0, 1200.0)
    made = a_machine(rpm=ends, seconds=seconds, noise=float(rng.uniform(3e-5, 1e-4)))
    return replace(made, seed=seed, modes=(clear, weak) if hidden else (clear,))


def told(machine):
    return sweep_fits(spectra_of(machine, ORDERS, machine.seed), others=HALVES, settings=SETTINGS)


def at(hidden, order, frequency_hz):
    """Largest amplification of ``order`` that is left open at ``frequency_hz``."""
    own = [item for item in hidden if item.order == order]
    own = [item for item in own if item.frequency_hz[0] <= frequency_hz <= item.frequency_hz[-1]]
    rows = [(item.frequency_hz, item.amplification({"X": "m/s2", "Y": "m/s2"}, {"m/s2": 1e-6})) for item in own]
    return min(float(np.interp(frequency_hz, *row)) for row in rows)


@pytest.mark.parametrize("seed", range(4))
def test_where_no_mode_is_a_sweep_excludes_most(seed):
    machine = drawn(seed, hidden=0.0)
    hidden = told(machine).hiding
    for order in ORDERS:
        left = [at(hidden, order, float(hz)) for hz in np.geomspace(90.0, 140.0, 25)]
        assert np.median(left) < SETTINGS.free_amplification  # more only about an antiresonance


@pytest.mark.parametrize("hidden", [0.01, 0.1, 1.0])
def test_what_a_mode_really_adds_is_never_excluded(hidden):
    held = []
    for seed in range(8):
        machine = drawn(seed, hidden=hidden)
        fits = told(machine)
        weak = machine.modes[1].frequency_hz
        known = any(abs(pole.frequency_hz - weak) < 0.01 * weak for pole in fits.poles)
        for number, order in enumerate(ORDERS):
            truth = float(amplification(machine, number, 1, np.array([60.0 * weak / order]))[0])
            held.append(known or at(fits.hiding, order, weak) >= truth)
    assert np.mean(held) >= 0.95
