"""The change of unbalance behind a change of order 1: its factor, and its law with speed."""

import numpy as np
import pytest

from crankorder.identify.mass_change import MassFactor, balance_changes, factor_of, unbalance_change
from crankorder.identify.order_changes import Line, OrderChange
from made.typed import from_dicts

SPEED_RPM = np.array([900.0, 1200.0, 1500.0, 1800.0, 2100.0])
BEFORE = 3.0 * np.exp(0.4j)  # grams at their radius
ADDED = 2.4 * np.exp(2.9j)


def path(rpm, *, natural_rpm):
    """Response per gram of a mass that turns: speed² over one mode."""
    x = rpm / natural_rpm
    return 4e-6 * rpm**2 / (1 - x**2 + 0.06j * x)


def measured(rng, true, error, *, freedom=12.0):
    noise = rng.standard_normal((2, len(true)))
    # an error that is itself estimated from so many degrees of freedom
    said = error * np.sqrt(rng.chisquare(freedom, len(true)) / freedom)
    vector = true + error * (noise[0] + 1j * noise[1])
    return Line(np.abs(vector), said, np.full(len(true), freedom), vector, said)


def made(rng, *, natural_rpm=2400.0, error=0.6, after=BEFORE + ADDED, moved=1.0):
    response = path(SPEED_RPM, natural_rpm=natural_rpm)
    other = path(SPEED_RPM, natural_rpm=natural_rpm * moved)
    lines = measured(rng, response * BEFORE, error), measured(rng, other * after, error)
    return unbalance_change(OrderChange(SPEED_RPM, SPEED_RPM, *lines, changed=True))


def test_one_factor_fits_through_any_path_and_its_interval_covers():
    rng, n, inside, fits = np.random.default_rng(1), 600, 0, 0
    true = abs((BEFORE + ADDED) / BEFORE)
    for _ in range(n):
        record, _ = made(rng)
        low, high = record.factor_ci95
        inside += low <= true <= high
        fits += record.one_factor_p > 0.05
    assert inside / n == pytest.approx(0.95, abs=0.025)
    assert fits / n == pytest.approx(0.95, abs=0.03)


def test_the_square_law_holds_on_a_stiff_path_and_not_beside_a_resonance():
    stiff, _ = made(np.random.default_rng(4), natural_rpm=1e6)
    assert stiff.square_law_p > 1e-3
    assert stiff.square_law_amplitude == pytest.approx(abs(ADDED) * 4e-6 * 2100.0**2, rel=0.15)
    near, _ = made(np.random.default_rng(5), natural_rpm=1600.0)
    assert near.square_law_p < 1e-6 and near.one_factor_p > 1e-3


def test_a_path_that_changed_is_not_taken_for_a_mass():
    record, _ = made(np.random.default_rng(6), after=BEFORE, moved=1.15)
    assert record.one_factor_p < 1e-6 and not record.explains


def test_the_same_unbalance_explains_nothing():
    explains = [made(np.random.default_rng(k), after=BEFORE)[0].explains for k in range(300)]
    assert np.mean(explains) == pytest.approx(0.05, abs=0.035)


def test_an_order_that_drowns_tells_no_factor():
    assert made(np.random.default_rng(7), error=1e3) is None


# The change of mass from one closed balance and the ratio of an order covers the true one.


balance_changes = from_dicts(balance_changes)


def closed(key, value, error):
    half = 1.959964 * error
    return {"balance": {key: value, f"{key}_ci95": [value - half, value + half]}}


def test_the_interval_of_the_change_covers_it_in_95_of_100_cases():
    rng, held = np.random.default_rng(7), []
    for _ in range(200):
        before, after = rng.uniform(50, 200), rng.uniform(50, 400)
        error = rng.uniform(0.01, 0.1, 3) * (before, after, after / before)
        known = closed("along_g", before + error[0] * rng.standard_normal(), error[0])
        ratio = after / before + error[2] * complex(*rng.standard_normal(2))
        records = balance_changes(known, {"balance": None}, [MassFactor(1.0, ratio, error[2], 1e6)])
        for record in records:  # one ratio in some thousands is taken for a turned one and refused
            low, high = record.change_ci95
            held.append(low <= after - before <= high)
    assert len(held) >= 198
    assert 0.93 <= np.mean(held) <= 0.97


def test_orders_that_disagree_are_no_one_mass():
    first, turned = MassFactor(1.0, 1.86, 0.01, 1e6), MassFactor(1.0, 1.86 + 0.3j, 0.01, 1e6)
    assert factor_of([first, MassFactor(2.0, 1.80, 0.05, 1e6)], (1.0, 2.0)).value == pytest.approx(1.86, abs=0.01)
    for order, value in ((2.0, 1.4), (2.0, 1.86 + 0.4j), (1.0, 1.2)):  # the last: another way in another channel
        assert factor_of([first, MassFactor(order, value, 0.05, 1e6)], sorted({1.0, order})) is None
    assert factor_of([turned], (1.0,)) is None  # no mass along the cylinder alone


def test_without_a_ratio_two_closed_balances_are_subtracted():
    (record,) = balance_changes(closed("forward_gmm", 500.0, 10.0), closed("forward_gmm", 800.0, 10.0), [])
    assert record.change == 300.0 and record.changed and record.by_ratio_of_orders == ()
    assert balance_changes({"balance": None}, closed("forward_gmm", 800.0, 10.0), []) == ()
