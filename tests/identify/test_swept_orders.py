"""Run-ups and run-downs: no locked order is said to slip, no slip to be locked, and the strongest order is found."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from crankorder.orders.frames import order_frames
from crankorder.settings import load_settings
from made.line_frames import agreed_in
from made.swept_machines import drawn, recorded

SETTINGS = load_settings()
SWEEPS = {
    "up in 8 s": {},
    "down in 8 s": {"rpm": (6000.0, 600.0)},
    "down in 5 s past eight modes": {"modes": 8, "rpm": (6000.0, 800.0), "duration_s": 5.0},
    "up in 60 s": {"rpm": (600.0, 4000.0), "duration_s": 60.0},
    "up, 0.3 % slip": {"slip": 0.003, "duration_s": 20.0},
    "up past eight modes, 0.3 % slip": {"slip": 0.003, "modes": 8, "duration_s": 20.0},
    "up, 1 % slip": {"slip": 0.01},
    "down, 2 % slip": {"slip": 0.02, "rpm": (5000.0, 800.0), "duration_s": 20.0},
}


def judged(name: str, seed: int) -> tuple[Counter[tuple[str, str]], bool]:
    """What was said of the orders of one machine, by what they are, and whether its strongest one was found."""
    rng = np.random.default_rng([seed, *name.encode()])
    machine = drawn(rng, **SWEEPS[name])
    frames = order_frames(*recorded(machine, rng), settings=SETTINGS.orders)
    found = agreed_in([frames])
    true = machine.orders * (1.0 - machine.slip)
    said: Counter[tuple[str, str]] = Counter()
    for item in found:
        nearest = int(np.argmin(np.abs(true - item.order)))
        if abs(true[nearest] - item.order) < 0.1:
            said["slips" if machine.slip[nearest] else "locked", item.lock] += 1
        else:
            said["made up", item.lock] += 1
    size = [float(np.abs(frames["spectrum"].sel(order=order, method="nearest")).max()) for order in true]
    strongest = true[int(np.argmax(size))]
    return said, any(abs(item.order - strongest) < 0.05 for item in found)


def over_machines(name: str, n: int) -> tuple[Counter[tuple[str, str]], float]:
    said: Counter[tuple[str, str]] = Counter()
    strongest = 0
    for seed in range(n):
        one, hit = judged(name, seed)
        said += one
        strongest += hit
    return said, strongest / n


@pytest.mark.parametrize(("n", "decided"), [(3, 0.4), pytest.param(100, 0.7, marks=pytest.mark.accuracy)])
@pytest.mark.parametrize("name", SWEEPS)
def test_modes_that_are_crossed_turn_no_locked_order_into_a_slip_and_hide_no_slip(
    name: str, n: int, decided: float
) -> None:
    said, strongest = over_machines(name, n)
    assert said["locked", "slips"] == 0
    assert said["slips", "locked"] == 0
    assert said["made up", "slips"] + said["made up", "locked"] == 0
    assert strongest >= 0.95  # 98 % is wanted: an order 0.5 that rings at the end of 8 s is missed
    for kind, promised in (("locked", True), ("slips", "slip" in SWEEPS[name])):
        total = sum(count for (what, _), count in said.items() if what == kind)
        assert (total > 0) == promised
        assert said[kind, kind] >= decided * total  # silence is no answer
