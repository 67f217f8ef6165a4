"""Tracks of sweeps less what modes that other orders struck add to them, and poles that only such a rest asks for."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from crankorder.identify.found import Mode
from crankorder.identify.modes.order_modes import hidden_speeds, named, swings_of, without_swings
from crankorder.identify.modes.order_responses import Block, project
from crankorder.identify.modes.order_search import NO_PRIOR, Fitted
from crankorder.identify.modes.order_terms import Passage, passage_of
from crankorder.identify.modes.surface_fit import NO_POLES

pytestmark = pytest.mark.slow

LOW_RPM, HIGH_RPM, RATE, ROWS = 900.0, 4500.0, 600.0, 400
NOISE = 1e-3


def _passage(order: float) -> Passage:
    time = np.linspace(0.0, (HIGH_RPM - LOW_RPM) / RATE, ROWS)
    speed = LOW_RPM + RATE * time
    angle = (LOW_RPM * time + 0.5 * RATE * time**2) / 60.0
    return passage_of(order, time, speed, angle, np.full(ROWS, 6.0), poles=2)


def _block(passage: Passage, amplitude: np.ndarray) -> Block:
    speed = np.interp(passage.place, np.arange(len(passage.speed_rpm)), passage.speed_rpm)
    hertz, error = passage.order * speed / 60.0, np.full((1, ROWS), NOISE)
    return Block(passage.order, ("X",), hertz, speed, amplitude[None], error, HIGH_RPM, passage=passage, recording="a")


def _two(seed: int) -> tuple[list[Block], np.ndarray, float, float]:
    """Blocks of two orders of a run-up; what the lower one is without the mode that rings on; frequency, damping."""
    random = np.random.default_rng(seed)
    natural, damping = float(random.uniform(180.0, 260.0)), float(random.uniform(0.002, 0.005))
    upper, lower = _passage(8.5), _passage(8.0)
    strong, weak = random.uniform(10.0, 30.0), random.uniform(0.3, 1.0)
    grown = [(one.speed_rpm / HIGH_RPM).astype(complex) ** 2 for one in (upper, lower)]
    of_upper = strong * upper.response(grown[0], natural, damping)[0]
    own = weak * lower.response(grown[1], natural, damping)[0]
    swing = strong * lower.taken_from(upper, upper.left_over(grown[0], natural, damping), natural)
    noise = NOISE * (random.standard_normal((2, ROWS)) + 1j * random.standard_normal((2, ROWS)))
    return [_block(upper, of_upper + noise[0]), _block(lower, own + swing + noise[1])], own, natural, damping


@pytest.mark.parametrize("seed", range(4))
def test_a_track_less_the_swings_is_what_the_order_is(seed: int) -> None:
    blocks, own, natural, damping = _two(seed)
    state = Fitted.of(blocks, NO_POLES.with_pole(natural, damping), NO_PRIOR)
    swings = swings_of(state.blocks, state.projected, state.poles)
    assert [one.order for one in swings] == [8.0]
    tracks = xr.Dataset(
        {
            "amplitude": (("channel", "order", "frame"), np.stack([block.amplitude for block in blocks], axis=1)),
            "standard_error": (("channel", "order", "frame"), np.full((1, 2, ROWS), NOISE)),
            "time": ("frame", np.linspace(0.0, (HIGH_RPM - LOW_RPM) / RATE, ROWS)),
        },
        coords={"channel": ["X"], "order": [8.5, 8.0]},
        attrs={"recording": "a"},
    )
    (made,) = without_swings([tracks], swings)
    read, left = tracks["amplitude"].values[0, 1], made["amplitude"].values[0, 1]
    assert np.abs(read - own).max() > 2.0 * np.abs(own).max()
    wrong = np.abs(left - own) / made["standard_error"].values[0, 1]
    assert np.abs(left - own).max() < 0.05 * np.abs(read - own).max()
    assert np.quantile(wrong, 0.95) < 3.5
    assert np.array_equal(made["amplitude"].values[0, 0], tracks["amplitude"].values[0, 0])
    (other,) = without_swings([tracks.assign_attrs(recording="b")], swings)
    assert other.identical(tracks.assign_attrs(recording="b"))


@pytest.mark.parametrize("seed", range(6))
def test_a_rest_of_a_swing_proves_no_mode_and_a_mode_is_proven(seed: int) -> None:
    """What no model knows of a swing asks for a pole where it was: by chance alone in most, but it shows little."""
    random = np.random.default_rng(seed)
    blocks, own, natural, damping = _two(seed)
    rest = random.standard_normal(ROWS) + 1j * random.standard_normal(ROWS)
    near = np.exp(-0.5 * np.square((blocks[1].frequency_hz / (0.93 * natural) - 1.0) / 0.01))
    lower = replace(blocks[1], amplitude=(own + 0.3 * np.abs(own).max() * near * rest)[None])
    poles = NO_POLES.with_pole(natural, damping).with_pole(0.93 * natural, 0.003)
    both = [blocks[0], lower]
    none, mode = (named(both, [project(block, poles) for block in both], poles, number) for number in (0, 1))
    assert (none.frequency_hz, mode.frequency_hz) == (0.93 * natural, natural)
    assert mode.proof.passed == (8.0, 8.5)
    assert none.proof.passed == ()


# A mode that rings on: at which speeds it hides an order.


def _swept(order: float, rate_rpm_s: float) -> Block:
    """A block of one channel whose speed rises, or falls where ``rate_rpm_s`` is below zero."""
    time = np.linspace(0.0, (HIGH_RPM - LOW_RPM) / abs(rate_rpm_s), 400)
    speed = np.linspace(LOW_RPM, HIGH_RPM, 400)[:: 1 if rate_rpm_s > 0.0 else -1]
    angle = np.cumsum(speed) / 60.0 * (time[1] - time[0])
    passage = passage_of(order, time, speed, angle, np.full(400, 8.0), poles=2)
    amplitude, error = np.ones((1, 400), dtype=complex), np.full((1, 400), 1e-3)
    hertz = order * speed / 60.0
    return Block(order, ("X",), hertz, speed, amplitude, error, HIGH_RPM, passage=passage, recording="a")


def test_an_order_that_nobody_found_may_hide_where_a_light_mode_rings_and_nowhere_else() -> None:
    modes = [Mode(150.0, 0.01, zeta, 1e-4, ("X",), 0.0, "made") for zeta in (0.002, 0.1)]
    light, heavy = (
        hidden_speeds([_swept(6.0, 400.0)], [mode], revs_per_cycle=2, least_damping=0.002) for mode in modes
    )
    at_rpm = 60.0 * 150.0 / 5.5  # half an order below, passed right after
    assert any(item.low_rpm < at_rpm < item.high_rpm and item.rung_by == 6.0 for item in light)
    assert all(item.low_rpm > 60.0 * 150.0 / 6.0 for item in light)  # none before, and none at the order itself
    assert heavy == ()
