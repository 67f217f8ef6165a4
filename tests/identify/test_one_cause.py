"""What is found twice at one place is told once, or each with the other."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.causes.explain import Cause, Causes, with_neighbours_named, without_doubles
from crankorder.identify.found import Tone
from crankorder.identify.said import MAY_BE_ALL
from made.found_lines import agreed, fit, line, mode

GRID_HZ = np.arange(0.0, 200.0, 0.5)


def tone(hertz: float, kind: str, size: float = 1.0) -> Tone:
    return Tone(hertz, 0.005, kind, {"A": (size, 0.01)}, "")  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_tone_on_the_flank_of_a_stronger_one_is_not_told(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hertz, away = rng.uniform(60.0, 150.0), rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.9)
    strong, flank, apart = tone(hertz, "mains"), tone(hertz + away, "order", 0.7), tone(hertz + 3.0, "order", 0.7)
    other = tone(hertz - away, "tone", 0.7)
    found = without_doubles(fit(tones=(strong, flank, apart, other), frequency_hz=GRID_HZ))
    assert found.tones == (strong, apart, other)


def test_at_one_speed_it_names_the_order_that_stands_there() -> None:
    rpm = 1713.0
    one = agreed(3.0, line(3.0, speed_rpm=[rpm]))
    beside = fit(mode(3.0 * rpm / 60.0 + 0.01, undecided="at one speed its modulation looks the same"))
    causes = Causes({("A", 3.0): Cause("bearing pump BPFO", "")}, (), ())
    assert (
        "bearing pump BPFO at 85.65 Hz stands there" in with_neighbours_named(beside, (one,), causes).modes[0].undecided
    )
    swept = agreed(3.0)
    assert MAY_BE_ALL not in with_neighbours_named(beside, (swept,), causes).modes[0].undecided
