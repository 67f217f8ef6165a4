"""A mode that rings on: at which speeds it hides an order."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.found import Mode
from crankorder.identify.modes.order_responses import Block
from crankorder.identify.modes.passage import passage_of
from crankorder.identify.modes.ringing import hidden_speeds

pytestmark = pytest.mark.slow

LOW_RPM, HIGH_RPM = 900.0, 4500.0


def _swept(order: float, rate_rpm_s: float) -> Block:
    """A block of one channel whose speed rises, or falls where ``rate_rpm_s`` is below zero."""
    time = np.linspace(0.0, (HIGH_RPM - LOW_RPM) / abs(rate_rpm_s), 400)
    speed = np.linspace(LOW_RPM, HIGH_RPM, 400)[:: 1 if rate_rpm_s > 0.0 else -1]
    angle = np.cumsum(speed) / 60.0 * (time[1] - time[0])
    passage = passage_of(order, time, speed, angle, np.full(400, 8.0), poles=2)
    amplitude, error = np.ones((1, 400), dtype=complex), np.full((1, 400), 1e-3)
    hertz = order * speed / 60.0
    return Block(order, ("X",), hertz, speed, amplitude, error, HIGH_RPM, passage=passage, recording="a")


def _mode(frequency_hz: float, damping: float) -> Mode:
    return Mode(frequency_hz, 0.01, damping, 1e-4, ("X",), 0.0, "made")


def test_an_order_that_nobody_found_may_hide_where_a_light_mode_rings_and_nowhere_else() -> None:
    light, heavy = (
        hidden_speeds([_swept(6.0, 400.0)], [_mode(150.0, zeta)], revs_per_cycle=2, least_damping=0.002)
        for zeta in (0.002, 0.1)
    )
    at_rpm = 60.0 * 150.0 / 5.5  # half an order below, passed right after
    assert any(item.low_rpm < at_rpm < item.high_rpm and item.rung_by == 6.0 for item in light)
    assert all(item.low_rpm > 60.0 * 150.0 / 6.0 for item in light)  # none before, and none at the order itself
    assert heavy == ()
