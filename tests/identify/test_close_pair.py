"""Two lines closer than a frame resolves are solved together, with intervals that hold both."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.intervals import half_width
from crankorder.identify.lines.growth import largest
from made.line_frames import agreed_in, angle_of, frames_of, wave


def agreed(seed: int, *, revs: int, order: float, size: float, noise: float = 0.5):
    """Orders found where one of ``order`` and ``size`` stands beside 5.5 of size 1, in two channels."""
    rng, angle = np.random.default_rng([seed, revs]), angle_of(revs)
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    signal = wave(angle, 5.5, 1.0, phases[0]) + wave(angle, order, size, phases[1])
    frames = frames_of([signal + noise * rng.standard_normal(len(angle)) for _ in range(2)])
    return agreed_in([frames])


CASES = [
    (600, 5.467, 0.5),
    (200, 5.467, 0.5),
    (100, 5.467, 0.5),
    (200, 5.489, 0.5),
    (200, 5.467, 0.1),
    (200, 5.45, 0.5),
    (200, 5.41, 0.5),
]


@pytest.mark.cases(2)
@pytest.mark.parametrize(
    ("n", "least"), [(12, 0.8), pytest.param(150, 0.92, marks=pytest.mark.accuracy)]
)  # of 24 orders and 48 amplitudes fewer than 0.8 are inside with a chance of 1e-3 where it is 95 %
@pytest.mark.parametrize(("revs", "order", "size"), CASES)
def test_both_lines_are_found_and_lie_in_their_intervals(revs, order, size, n, least) -> None:
    numbers, sizes = [], []
    for seed in range(n):
        found = agreed(seed, revs=revs, order=order, size=size)
        assert len(found) == 2
        assert "locked" not in (found[0].lock,)
        for item, true, amplitude in zip(found, (order, 5.5), (size, 1.0), strict=True):
            within = half_width(item.degrees_of_freedom) * item.order_error
            numbers.append(abs(item.order - true) <= within + 1e-12)
            ends = [largest(line) for line in item.lines]
            sizes += [one.low <= amplitude <= one.high for one in ends]
    assert np.mean(numbers) >= least
    assert np.mean(sizes) >= least


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_lines_that_a_recording_cannot_part_are_one_whose_intervals_hold_both_and_say_so(seed: int) -> None:
    (item,) = agreed(seed, revs=60, order=5.467, size=0.5)
    assert "two lines closer than a recording can tell may stand here" in item.reservation
    within = half_width(item.degrees_of_freedom) * item.order_error
    assert abs(item.order - 5.5) < within and abs(item.order - 5.467) < within
    assert item.lock != "slips"
    for line in item.lines:
        assert "its amplitude changes within the recording" in line.remark
        assert largest(line).low <= 1.0 <= largest(line).high
