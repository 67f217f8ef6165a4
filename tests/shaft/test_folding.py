"""What folds in a recording by crank angle is said beforehand and recognised afterwards."""

import numpy as np
import pytest

from crankorder.shaft.aliasing import aliased_lines, aliased_order, find_aliases

SPEEDS = np.array([800.0, 1000.0, 1500.0, 2000.0])
SOUGHT = {"samples_per_rev": 360, "order_error": 0.01, "shown_to_order": 20.0, "highest_hz": 50e3}
WIDELY = SOUGHT | {"shown_to_order": 180.0}


def test_a_sampled_line_and_its_fold_are_the_same_samples():
    for order in [0.0, 5.5, 180.0, 185.0, 353.5, 360.0, 366.5, 713.5, 1066.67]:
        angle = np.arange(3 * 360) / 360
        np.testing.assert_allclose(
            np.cos(2 * np.pi * order * angle), np.cos(2 * np.pi * aliased_order(order, 360) * angle), atol=1e-9
        )


def test_frequencies_fold_at_the_speeds_that_are_too_slow_for_them():
    mains, supply = aliased_lines(360, SPEEDS, frequencies_hz=(2500.0, 16_000.0))
    np.testing.assert_array_equal(mains.folds, [True, False, False, False])  # Nyquist: 2.4, 3, 4.5, 6 kHz
    np.testing.assert_allclose(mains.shown_order[0], 360 - 60 * 2500 / 800)
    np.testing.assert_allclose(supply.shown_order, [120.0, 120.0, 80.0, 120.0])
    assert supply.folds.all()
    assert "172.5 (800 rpm)" in str(mains)


def test_a_named_frequency_needs_fewer_speeds_than_an_unnamed_one():
    speed, order = np.repeat([900.0, 1300.0], 4), np.array([1.3, 13.333, 7.9, 4.4, 2.2, 18.4615, 11.2, 9.1])
    assert find_aliases(speed, order, **SOUGHT) == []
    (fold,) = find_aliases(speed, order, **SOUGHT, frequencies_hz=(16_000.0,))
    np.testing.assert_array_equal(fold.points, [1, 5])


def test_a_tone_is_found_among_lines_of_the_shaft_and_strays():
    rng = np.random.default_rng(5)
    rpm = np.arange(600.0, 2000.0, 170.0)
    shown = aliased_order(60.0 * 31_234.5 / rpm, 360)
    lines = [
        np.concatenate(([2.0, 4.0, 5.5, s], rng.uniform(0, 180, 6))) + 0.003 * rng.standard_normal(10) for s in shown
    ]
    (fold,) = find_aliases(np.repeat(rpm, 10), np.concatenate(lines), **WIDELY)
    assert fold.frequency_hz == pytest.approx(31_234.5, abs=0.2)
    np.testing.assert_array_equal(fold.points, 3 + 10 * np.flatnonzero(60.0 * 31_234.5 / rpm > 180.0))


def test_strays_alone_lines_of_the_shaft_and_no_lines_make_no_fold():
    rng = np.random.default_rng(6)
    rpm = np.repeat(np.arange(600.0, 2000.0, 170.0), 8)
    assert [find_aliases(rpm, rng.uniform(0, 180, rpm.size), **WIDELY) for _ in range(40)] == [[]] * 40
    assert find_aliases(np.repeat(SPEEDS, 4), np.tile([0.5, 2.0, 5.5, 11.0], SPEEDS.size), **SOUGHT) == []
    assert find_aliases(np.empty(0), np.empty(0), **SOUGHT) == []


def test_speeds_in_simple_ratios_leave_two_frequencies_and_both_are_named():
    rpm = np.array([1000.0, 1500.0, 2000.0, 3000.0])
    order = aliased_order(60.0 * 16_000.0 / rpm, 360)
    (fold,) = find_aliases(rpm, order, samples_per_rev=360, order_error=0.002, shown_to_order=180.0, highest_hz=30e3)
    assert {round(fold.frequency_hz), 36_000 - round(fold.frequency_hz)} == {16_000, 20_000}
    assert f"{36_000 - fold.frequency_hz:.5g} Hz would fold alike" in fold.evidence
