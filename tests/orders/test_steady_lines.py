"""Lines of one frequency in a sweep: taken out as they are, and nothing else with them."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from crankorder.orders.fixed_lines import without_steady_lines
from crankorder.shaft.angle import speed_course
from made.recordings import sampled, shaft

RATE_HZ, SECONDS, NOISE = 2048.0, 20.0, 0.02
TIME = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
ORDER = np.array([2.0])


def _sweep(rng: np.random.Generator) -> tuple[xr.Dataset, np.ndarray]:
    """Shaft of a run-up from 1000 rpm or so to twice that, and order 2 of amplitude 1 with noise (2, samples)."""
    first_hz = rng.uniform(15.0, 18.0)
    rate = first_hz * rng.uniform(0.9, 1.1) / SECONDS
    knots = np.linspace(0.0, SECONDS, 400)
    turned = shaft(knots, first_hz * knots + 0.5 * rate * knots**2, 60.0 * (first_hz + rate * knots))
    angle = first_hz * TIME + 0.5 * rate * TIME**2
    order = np.cos(2.0 * np.pi * 2.0 * angle + rng.uniform(0.0, 6.0, (2, 1)))
    return turned, order + NOISE * rng.standard_normal((2, len(TIME)))


def _band(signals: np.ndarray) -> xr.Dataset:
    return sampled(signals, rate_hz=RATE_HZ, band_hz=800.0)


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_mains_that_an_order_passes_are_taken_out_as_they_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turned, signals = _sweep(rng)
    hertz = float(rng.choice([50.0, 60.0])) + rng.uniform(-0.1, 0.1)
    phasor = rng.uniform(0.1, 0.5, 2) * np.exp(2j * np.pi * rng.uniform(0.0, 1.0, 2))
    hum = (phasor[:, None] * np.exp(2j * np.pi * hertz * TIME)).real
    left, lines = without_steady_lines(_band(signals + hum), speed_course(turned), ORDER, mains_hz=(50.0, 60.0))
    assert [one.frequency_hz for one in lines] == [pytest.approx(hertz, abs=0.003)]
    assert np.abs(lines[0].amplitude - phasor) == pytest.approx(0.0, abs=0.02)
    assert np.sqrt(np.mean((left["signal"].values - signals) ** 2)) < 0.05 * np.sqrt(np.mean(hum**2))


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_an_order_and_what_rings_after_it_are_left(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    turned, signals = _sweep(rng)
    since = np.maximum(TIME - rng.uniform(5.0, 12.0), 0.0)
    signals += np.where(since > 0.0, 2.0 * np.exp(-0.004 * 2.0 * np.pi * 60.0 * since), 0.0) * np.sin(
        2.0 * np.pi * 60.0 * since
    )
    left, lines = without_steady_lines(_band(signals), speed_course(turned), ORDER, mains_hz=(50.0, 60.0))
    assert not lines
    np.testing.assert_array_equal(left["signal"].values, signals)
