"""Lines within one bin at a held speed: two are solved together, more are said to swell."""

import numpy as np
import pytest

from crankorder.identify.lines.growth import largest
from crankorder.identify.lines.order_lines import order_lines
from crankorder.orders.intervals import half_width
from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.line_frames import agreed_in, angle_of, frames_of, wave

SETTINGS = load_settings()


@pytest.mark.slow
def test_a_locked_line_that_the_energy_of_its_bin_hides_is_found_by_its_phase():
    hidden = 0
    for seed in range(6):
        rng, angle = np.random.default_rng([seed, 8]), angle_of(1100)
        signal = wave(angle, 1.0, 2.0) + wave(angle, 2.0, 0.055, 1.0) + rng.standard_normal(len(angle))
        frames = frames_of([signal])
        made = order_map([frames], settings=SETTINGS.orders)
        found = order_lines(made, settings=SETTINGS.identify, orders=SETTINGS.orders, frames=[frames])
        hidden += len(found) == 2 and abs(found[1].order - 2.0) < 0.1 and found[1].evidence == "locked to the shaft"
    assert hidden >= 5


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(4))
def test_a_line_whose_size_swings_stays_one(seed):
    rng, angle = np.random.default_rng([seed, 13]), angle_of(740)
    swell = 1.0 + 0.4 * np.cos(2.0 * np.pi * angle * rng.uniform(3.0, 6.0) / 740.0 + rng.uniform(0.0, 6.0))
    signal = swell * wave(angle, 3.0, 1.0) + 0.1 * rng.standard_normal(len(angle))
    found = agreed_in([frames_of([signal], speed_rpm=1482.0)])
    assert [one.order for one in found] == pytest.approx([3.0], abs=3e-4)


# Two lines closer than a frame resolves are solved together, with intervals that hold both.


def agreed(seed, *, revs, order, size, noise=0.5):
    """Orders found where one of ``order`` and ``size`` stands beside 5.5 of size 1, in two channels."""
    rng, angle = np.random.default_rng([seed, revs]), angle_of(revs)
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    signal = wave(angle, 5.5, 1.0, phases[0]) + wave(angle, order, size, phases[1])
    return agreed_in([frames_of([signal + noise * rng.standard_normal(len(angle)) for _ in range(2)])])


CASES = [
    (600, 5.467, 0.5), (200, 5.467, 0.5), (100, 5.467, 0.5), (200, 5.489, 0.5), (200, 5.467, 0.1), (200, 5.45, 0.5),
    (200, 5.41, 0.5),
]  # fmt: skip


@pytest.mark.cases(2)
@pytest.mark.parametrize(("revs", "order", "size"), CASES)
def test_both_lines_are_found_and_lie_in_their_intervals(revs, order, size):
    numbers, sizes = [], []
    for seed in range(12):
        found = agreed(seed, revs=revs, order=order, size=size)
        assert len(found) == 2 and found[0].lock != "locked"
        for item, true, amplitude in zip(found, (order, 5.5), (size, 1.0), strict=True):
            within = half_width(item.degrees_of_freedom) * item.order_error
            numbers.append(abs(item.order - true) <= within + 1e-12)
            ends = [largest(line) for line in item.lines]
            sizes += [one.low <= amplitude <= one.high for one in ends]
    # of 24 orders and 48 amplitudes fewer than 0.8 are inside with a chance of 1e-3 where it is 95 %
    assert np.mean(numbers) >= 0.8 and np.mean(sizes) >= 0.8


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_lines_that_a_recording_cannot_part_are_one_whose_intervals_hold_both_and_say_so(seed):
    (item,) = agreed(seed, revs=60, order=5.467, size=0.5)
    assert "swells" in [doubt.kind for doubt in item.doubts]
    within = half_width(item.degrees_of_freedom) * item.order_error
    assert abs(item.order - 5.5) < within and abs(item.order - 5.467) < within
    assert item.lock != "slips"
    for line in item.lines:
        assert "its amplitude changes within the recording" in line.remark
        assert largest(line).low <= 1.0 <= largest(line).high
