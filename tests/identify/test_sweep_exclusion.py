"""What the spectra of sweeps exclude, against exact signals: the truth is never above it, and it is not infinite."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from crankorder.identify.found import SweepFits
from crankorder.identify.modes.exclusion import Hiding
from crankorder.identify.modes.sweep_poles import sweep_fits
from crankorder.settings import load_settings
from identify.test_sweep_poles import HALVES, a_machine, spectra_of
from machines.machine import Machine, Mode
from machines.truth import amplification

pytestmark = pytest.mark.slow

SETTINGS = load_settings().identify
UNIT = {"X": "m/s2", "Y": "m/s2"}
ORDERS = [2.0, 3.5]


def drawn(seed: int, *, hidden: float) -> Machine:
    """A sweep with a mode that stands out and one that makes ``hidden`` times as much as it would of the first."""
    rng = np.random.default_rng([seed, 71])
    clear = Mode(float(rng.uniform(60.0, 75.0)), 0.01, (0.02, -0.015), (1.0, 0.7), (0.0,))
    share = hidden * float(rng.uniform(0.5, 1.5))
    weak = Mode(
        float(rng.uniform(100.0, 130.0)),
        float(np.exp(rng.uniform(np.log(0.003), np.log(0.05)))),
        (0.02 * share, 0.01 * share),
        (float(rng.uniform(-1.0, 1.0)), 0.8),
        (0.0,),
    )
    seconds = float(rng.uniform(6.0, 16.0))
    ends = (1200.0, 4500.0) if rng.random() < 0.5 else (4500.0, 1200.0)
    made = a_machine(rpm=ends, seconds=seconds, noise=float(rng.uniform(3e-5, 1e-4)))
    return replace(made, seed=seed, modes=(clear, weak) if hidden else (clear,))


def told(machine: Machine) -> SweepFits:
    return sweep_fits(spectra_of(machine, ORDERS, machine.seed), others=HALVES, settings=SETTINGS)


def at(hidden: tuple[Hiding, ...], order: float, frequency_hz: float) -> float:
    """Largest amplification of ``order`` that is left open at ``frequency_hz``."""
    own = [item for item in hidden if item.order == order and item.frequency_hz[0] <= frequency_hz]
    own = [item for item in own if frequency_hz <= item.frequency_hz[-1]]
    matters = {"m/s2": 1e-6}
    return min(float(np.interp(frequency_hz, item.frequency_hz, item.amplification(UNIT, matters))) for item in own)


@pytest.mark.parametrize("seed", range(4))
def test_where_no_mode_is_a_sweep_excludes_most(seed: int) -> None:
    machine = drawn(seed, hidden=0.0)
    hidden = told(machine).hiding
    for order in ORDERS:
        left = [at(hidden, order, float(hz)) for hz in np.geomspace(90.0, 140.0, 25)]
        assert np.median(left) < SETTINGS.free_amplification  # more only about an antiresonance


@pytest.mark.parametrize("hidden", [0.01, 0.1, 1.0])
def test_what_a_mode_really_adds_is_never_excluded(hidden: float) -> None:
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
