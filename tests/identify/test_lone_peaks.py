"""An order that towers over the speeds beside is a speed to avoid, though no natural frequency was found there."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.found import AvoidedSpeed
from crankorder.identify.speeds.speeds_to_avoid import lone_peaks
from identify.test_speeds_to_avoid import SPEEDS_RPM, agreed, fit, line, mode, resonant

UNIT = {"A": "m/s²", "B": "m/s²"}


def _peaks(sizes: np.ndarray, avoided: tuple[AvoidedSpeed, ...] = (), **channels: float) -> list[AvoidedSpeed]:
    lines = [line(4.0, share * sizes, channel=name) for name, share in (channels or {"A": 1.0}).items()]
    largest = {one.channel: float(one.amplitude.max()) for one in lines}
    return lone_peaks([agreed(4.0, *lines)], fit(), avoided, largest=largest, in_unit=largest, unit=UNIT, factor=3.0)


@pytest.mark.cases(1)
@pytest.mark.parametrize("times", [3.5, 30.0])
def test_one_speed_that_towers_over_its_neighbours_is_to_be_avoided(times: float) -> None:
    sizes = np.ones(len(SPEEDS_RPM))
    at = len(sizes) // 2
    sizes[at] = times
    (found,) = _peaks(sizes, A=1.0, B=2.0)
    assert found.rpm == SPEEDS_RPM[at] and found.channel == "B" and found.amplitude == pytest.approx(2.0 * times)
    assert SPEEDS_RPM[at - 1] < found.rpm_range[0] < found.rpm < found.rpm_range[1] < SPEEDS_RPM[at + 1]
    assert "may be a natural frequency" in found.reason
    assert not _peaks(sizes, (found,))


def test_a_resonance_that_the_speeds_resolve_is_one_peak() -> None:
    assert len(_peaks(resonant(4.0, SPEEDS_RPM, [mode(100.0, 0.01)]))) == 1
