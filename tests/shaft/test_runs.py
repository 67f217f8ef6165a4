"""A test that stops and starts again: both runs stand on one angle."""

from __future__ import annotations

import numpy as np

from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at, angle_knots
from crankorder.shaft.repair import running_parts
from crankorder.shaft.standstill import ShaftRun, joined


def test_the_angle_goes_on_rightly_after_a_standstill():
    for teeth, still_s in [(60, 0.5), (360, 1.5), (120, 0.8)]:
        rate, top_s = 5.0, 3.0  # rev/s^2 down to rest and up again
        turned = 0.5 * rate * top_s**2
        tooth = np.arange(int(2 * turned * teeth) + 1)
        angle = (tooth + 0.3) / teeth
        angle, tooth = angle[angle < 2 * turned], tooth[angle < 2 * turned]
        down = top_s - np.sqrt(2.0 * np.maximum(turned - angle, 0.0) / rate)
        up = top_s + still_s + np.sqrt(2.0 * np.maximum(angle - turned, 0.0) / rate)
        time_s = np.where(angle < turned, down, up)
        parts, flags = running_parts(time_s, pulses_per_rev=teeth, joined=True)
        assert len(parts) == 2
        assert "standstill" in {flag for flag, _, _ in flags}
        settings = load_settings().shaft
        runs = []
        for part in parts:
            own = time_s[part]
            knots = angle_knots(own, np.arange(own.size), teeth_per_rev=teeth, noise_s=None, settings=settings)
            runs.append(ShaftRun(knots, (float(own[0]), float(own[-1])), part.start, part.stop - 1, 0.0))
        both = joined(runs, float(teeth))
        assert (np.diff(both.time_s) > 0.0).all()
        assert (np.diff(both.angle_rev) > 0.0).all()
        found = angle_at(time_s, both.time_s, both.angle_rev, both.speed_rpm)
        fast = np.abs(angle - turned) > 1.0
        assert np.abs(found - tooth / teeth)[fast].max() < 0.3 / teeth


def test_a_stop_after_a_few_pulses_of_one_per_revolution_is_one() -> None:
    # four pulses slow down into the stop, thirteen speed up out of it, no interval as long as a standing shaft's
    step = [0.139, 0.181, 0.375, 0.903, 0.184, 0.141, 0.118, 0.104, 0.094, 0.087, 0.081, 0.076, 0.072, 0.068, 0.065]
    time_s = np.cumsum([0.05, *step, 0.062])
    parts, flags = running_parts(time_s, pulses_per_rev=1, joined=True)
    assert [(part.start, part.stop) for part in parts] == [(4, 17)]
    assert {name for name, _, _ in flags} == {"standstill", "encoder_part_unused"}
