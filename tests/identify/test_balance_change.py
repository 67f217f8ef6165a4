"""The change of mass from one closed balance and the ratio of an order covers the true one."""

import numpy as np
import pytest

from crankorder.identify.mass_change import Factor, balance_changes, factor_of
from made.typed import from_dicts

balance_changes = from_dicts(balance_changes)


def closed(key, value, error):
    half = 1.959964 * error
    return {"balance": {key: value, f"{key}_ci95": [value - half, value + half]}}


@pytest.mark.cases(1)
@pytest.mark.parametrize("sides", [(True, False), (False, True), (True, True)])
def test_the_interval_of_the_change_covers_it_in_95_of_100_cases(sides):
    rng, held = np.random.default_rng(7), []
    for _ in range(600):
        before, after = rng.uniform(50, 200), rng.uniform(50, 400)
        error = rng.uniform(0.01, 0.1, 3) * (before, after, after / before)
        found = [
            closed("along_g", mass + spread * rng.standard_normal(), spread) if has else {"balance": None}
            for mass, spread, has in zip((before, after), error, sides, strict=False)
        ]
        ratio = after / before + error[2] * complex(*rng.standard_normal(2))
        records = balance_changes(*found, [Factor(1.0, ratio, error[2], 1e6)])
        for record in records:  # one ratio in some thousands is taken for a turned one and refused
            low, high = record.change_ci95
            held.append(low <= after - before <= high)
    assert len(held) >= 597
    assert 0.93 <= np.mean(held) <= 0.97


def test_orders_that_disagree_are_no_one_mass():
    alike = [Factor(1.0, 1.86, 0.01, 1e6), Factor(2.0, 1.80, 0.05, 1e6)]
    assert factor_of(alike, (1.0, 2.0)).value == pytest.approx(1.86, abs=0.01)
    for other in (Factor(2.0, 1.4, 0.05, 1e6), Factor(2.0, 1.86 + 0.4j, 0.05, 1e6)):
        assert factor_of([alike[0], other], (1.0, 2.0)) is None
    assert factor_of([alike[0], Factor(1.0, 1.2, 0.01, 1e6)], (1.0,)) is None  # another way in another channel
    assert factor_of([Factor(1.0, 1.86 + 0.3j, 0.01, 1e6)], (1.0,)) is None  # turned: no mass along the cylinder alone


def test_without_a_ratio_two_closed_balances_are_subtracted():
    (record,) = balance_changes(closed("forward_gmm", 500.0, 10.0), closed("forward_gmm", 800.0, 10.0), [])
    assert record.change == 300.0 and record.changed and record.by_ratio_of_orders == ()
    assert balance_changes({"balance": None}, closed("forward_gmm", 800.0, 10.0), []) == ()
