"""The change of unbalance behind a change of order 1: its factor, and its law with speed."""

import numpy as np
import pytest

from crankorder.identify.mass_change import unbalance_change
from crankorder.identify.order_changes import Line, OrderChange

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


@pytest.mark.slow
def test_the_square_law_holds_on_a_stiff_path_and_not_beside_a_resonance():
    stiff, _ = made(np.random.default_rng(4), natural_rpm=1e6)
    assert stiff.square_law_p > 1e-3
    assert stiff.square_law_amplitude == pytest.approx(abs(ADDED) * 4e-6 * 2100.0**2, rel=0.15)
    near, _ = made(np.random.default_rng(5), natural_rpm=1600.0)
    assert near.square_law_p < 1e-6 and near.one_factor_p > 1e-3


def test_a_path_that_changed_is_not_taken_for_a_mass():
    record, _ = made(np.random.default_rng(6), after=BEFORE, moved=1.15)
    assert record.one_factor_p < 1e-6 and not record.explains


@pytest.mark.slow
def test_the_same_unbalance_explains_nothing():
    explains = [made(np.random.default_rng(k), after=BEFORE)[0].explains for k in range(300)]
    assert np.mean(explains) == pytest.approx(0.05, abs=0.035)


@pytest.mark.slow
def test_an_order_that_drowns_tells_no_factor():
    assert made(np.random.default_rng(7), error=1e3) is None
