"""A speed that no pulses tell, proven by orders that stand on multiples; never by orders of another shaft."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.lines.order_lock import proves_speed

ERROR = 3e-6


def _numbers(orders, share: float, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    return [(order * (1.0 + share + ERROR * rng.standard_normal()), order * ERROR, 50.0) for order in orders]


def test_orders_on_multiples_prove_the_speed_and_one_that_slips_does_not_disturb() -> None:
    rng = np.random.default_rng(0)
    assert proves_speed(_numbers((0.5, 4.5, 11.0), 0.0, rng), revs_per_cycle=2)
    assert proves_speed([*_numbers((2.0, 3.5), 0.0, rng), (5.4356, 1e-5, 50.0)], revs_per_cycle=2)


@pytest.mark.cases(1)
@pytest.mark.parametrize("share", [3e-4, -1e-3, 4e-3])
def test_a_speed_that_is_off_or_a_shaft_that_slips_proves_nothing(share: float) -> None:
    assert not proves_speed(_numbers((2.0, 3.5, 6.0), share, np.random.default_rng(1)), revs_per_cycle=2)


def test_one_order_or_coarse_numbers_prove_nothing() -> None:
    assert not proves_speed([(4.0, 4 * ERROR, 50.0)], revs_per_cycle=2)
    assert not proves_speed([(4.0, 1e-3, 50.0), (6.5, 1e-3, 50.0)], revs_per_cycle=2)


@pytest.mark.slow
def test_shafts_that_slip_behind_a_speed_that_errs_hardly_ever_prove_it() -> None:
    rng, proven = np.random.default_rng(2), 0
    for _ in range(3000):
        slip = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.001), np.log(0.05)))
        share = (1.0 + slip) * (1.0 + 0.002 * rng.standard_normal()) - 1.0
        proven += proves_speed(_numbers((2.0, 4.0), share, rng), revs_per_cycle=2)
    assert proven <= 6  # of these a tenth of all tests at most
