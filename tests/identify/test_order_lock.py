"""Locked, slipping or undecided, and how long one must measure to tell."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.lines.order_lock import is_half_order, lock_of, nearest_multiple, revs_to_decide


def lock(order: float, error: float, **given) -> str:
    return lock_of(order, error, 30.0, **({"revs_per_cycle": 2, "by_phase": True} | given))


def test_a_number_known_to_a_hundredth_of_a_percent_on_a_half_order_is_locked() -> None:
    assert lock(5.5002, 2e-4) == "locked"


def test_a_number_whose_interval_leaves_the_multiple_out_slips() -> None:
    assert lock(5.489, 2e-4) == "slips"
    assert lock(4.75, 2e-4) == "slips"


def test_a_wide_interval_decides_nothing() -> None:
    assert lock(5.498, 3e-3) == "undecided"


def test_without_the_phase_no_lock_is_proven() -> None:
    assert lock(5.5, 1e-5, by_phase=False) == "undecided"


def test_a_half_order_is_none_of_a_two_stroke_cycle() -> None:
    assert lock(5.5, 1e-4, revs_per_cycle=1) == "undecided"  # exact, as of what rubs or is loose, but no multiple
    assert lock(5.489, 1e-4, revs_per_cycle=1) == "slips"
    assert nearest_multiple(5.4, revs_per_cycle=1) == 5.0
    assert is_half_order(5.5, 1e-4) and not is_half_order(5.0, 1e-4) and not is_half_order(5.48, 1e-4)


@pytest.mark.parametrize(("relative", "span"), [(0.1, 16.0), (0.01, 16.0), (0.05, 100.0)])
def test_after_the_revolutions_needed_the_interval_is_narrow_enough(relative: float, span: float) -> None:
    needed = revs_to_decide(5.5, relative_error=relative, span_rev=span, revs_per_frame=16)
    then = relative * np.sqrt(span / needed) * np.sqrt(12.0) / (2 * np.pi * needed)  # noise averages with the length
    assert lock(5.5, then * 0.99) == "locked" or needed == 32.0
