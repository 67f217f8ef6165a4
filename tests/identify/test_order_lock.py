"""Locked, slipping or undecided, and how long one must measure to tell."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.lines.order_lock import lock_of, revs_to_decide


def lock(order: float, error: float, **given) -> str:
    return lock_of(order, error, 30.0, **({"revs_per_cycle": 2, "by_phase": True} | given))


def test_a_number_is_locked_slips_or_is_undecided_by_its_interval_its_phase_and_the_cycle() -> None:
    wanted = [
        (5.5002, 2e-4, {}, "locked"),
        (5.489, 2e-4, {}, "slips"),
        (4.75, 2e-4, {}, "slips"),
        (5.498, 3e-3, {}, "undecided"),
        (5.5, 1e-5, {"by_phase": False}, "undecided"),
        (5.5, 1e-4, {"revs_per_cycle": 1}, "undecided"),  # exact, as of what rubs or is loose, but no multiple
        (5.489, 1e-4, {"revs_per_cycle": 1}, "slips"),
    ]
    assert [row for row in wanted if lock(row[0], row[1], **row[2]) != row[3]] == []


@pytest.mark.parametrize(("relative", "span"), [(0.1, 16.0), (0.01, 16.0), (0.05, 100.0)])
def test_after_the_revolutions_needed_the_interval_is_narrow_enough(relative: float, span: float) -> None:
    needed = revs_to_decide(5.5, relative_error=relative, span_rev=span, revs_per_frame=16)
    then = relative * np.sqrt(span / needed) * np.sqrt(12.0) / (2 * np.pi * needed)  # noise averages with the length
    assert lock(5.5, then * 0.99) == "locked" or needed == 32.0
