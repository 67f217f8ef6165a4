"""A pulse lost anywhere on a wheel with a gap, its first and last turn included, leaves every number right."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.settings import load_settings
from crankorder.shaft.wheel import number_teeth

SETTINGS = load_settings().shaft


@pytest.mark.parametrize("start_rev", [0.3217, 0.93])
@pytest.mark.parametrize(("teeth", "missing"), [(60, 2), (36, 1)])
@pytest.mark.parametrize("irregularity", [{}, {0.5: 0.02, 2.0: 0.03}], ids=["even", "uneven"])
def test_a_pulse_lost_in_the_first_or_last_turn_leaves_every_number_right_and_is_flagged(
    known_shaft, teeth, missing, irregularity, start_rev
):
    shaft = known_shaft(1500.0, start_rev=start_rev, irregularity=irregularity, duration_s=0.13)
    pulse_s = shaft.pulse_time_s(teeth)
    true = np.round(shaft.angle_rev(pulse_s) * teeth).astype(int)
    on_wheel = true % teeth < teeth - missing
    pulse_s, true = pulse_s[on_wheel], true[on_wheel]
    turn, last = teeth - missing, pulse_s.size - 1
    for lost in sorted({*range(1, turn), *range(turn, last - turn, 3), *range(last - turn, last)}):
        left_s = np.delete(pulse_s, lost)
        found = number_teeth(left_s, pulses_per_rev=teeth, missing_teeth=missing, settings=SETTINGS)
        kept = np.searchsorted(left_s, found.time_s)
        assert set((found.tooth - np.delete(true, lost)[kept]) % teeth) == {0}, lost

        assert {"encoder_missing_pulse", "encoder_double_pulse"} & {flag for flag, _, _ in found.flags}, lost
        assert 1 <= found.n_repaired <= 3


def test_a_wide_gap_of_a_shaft_that_starts_turning_is_no_lost_pulse(known_shaft):
    time_s = np.linspace(0.0, 2.0, 400_001)
    angle = 0.21 + 2.0 * time_s + 8.0 * time_s**2 + 0.02 * np.sin(2 * np.pi * 2.0 * (2.0 * time_s + 8.0 * time_s**2))
    place = np.arange(np.ceil(angle[0] * 60), np.floor(angle[-1] * 60) + 1)
    place = place[place % 60 < 58]
    found = number_teeth(np.interp(place / 60, angle, time_s), pulses_per_rev=60, missing_teeth=2, settings=SETTINGS)
    assert found.n_repaired == 0
    assert set((found.tooth - place) % 60) == {0}


@pytest.mark.parametrize("share", [0.1, 1 / 3, 0.55, 0.95])
@pytest.mark.parametrize(("teeth", "missing"), [(60, 0), (60, 2), (36, 1), (24, 2)])
def test_a_false_pulse_anywhere_and_in_a_gap_is_removed_and_leaves_every_number_right(
    known_shaft, teeth, missing, share
):
    shaft = known_shaft(1500.0, duration_s=0.17)
    pulse_s = shaft.pulse_time_s(teeth)
    true = np.round(shaft.angle_rev(pulse_s) * teeth).astype(int)
    on_wheel = true % teeth < teeth - missing
    pulse_s, true = pulse_s[on_wheel], true[on_wheel]
    for before in range(2, pulse_s.size - 3):
        false_s = pulse_s[before] + share * (pulse_s[before + 1] - pulse_s[before])
        train_s = np.sort(np.append(pulse_s, false_s))
        found = number_teeth(train_s, pulses_per_rev=teeth, missing_teeth=missing, settings=SETTINGS)
        np.testing.assert_array_equal(found.time_s, pulse_s, err_msg=f"after pulse {before}")
        assert len(set((found.tooth - true) % teeth)) == 1, before
        assert missing == 0 or set((found.tooth - true) % teeth) == {0}, before
        assert [detail for flag, _, detail in found.flags if flag == "encoder_double_pulse"] == [
            f"1 false pulses removed, at {false_s:.6g} s"
        ]
