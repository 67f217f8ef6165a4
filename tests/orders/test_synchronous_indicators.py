"""Condition indicators against their values for signals that are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.synchronous import synchronous_parts
from crankorder.orders.synchronous_indicators import crest_factor, fm0, fm4, kurtosis, m6a, na4

ANGLE = np.arange(1024) / 1024
SINE = np.cos(2 * np.pi * 8 * ANGLE)[None]


def test_a_sine_has_the_moments_of_a_sine():
    assert kurtosis(3.0 * SINE + 7.0).item() == pytest.approx(1.5, rel=1e-12)
    assert m6a(SINE).item() == pytest.approx(2.5, rel=1e-12)  # 5/16 over 1/8
    assert crest_factor(SINE).item() == pytest.approx(np.sqrt(2.0), rel=1e-12)
    assert fm0(2.0 * SINE, np.array([[2.0]])).item() == pytest.approx(2.0, rel=1e-12)


def test_noise_has_the_moments_of_a_normal_distribution():
    noise = np.random.default_rng(1).standard_normal((400, 4096))
    assert fm4(noise).mean() == pytest.approx(3.0, abs=0.02)
    assert m6a(noise).mean() == pytest.approx(15.0, abs=0.4)


def test_a_single_impact_among_a_thousand_samples_reads_about_a_thousand():
    one = np.zeros((1, 1000))
    one[0, 17] = 1.0
    # the kurtosis of a Bernoulli variable
    share = 1 / 1000
    expected = (1 - 3 * share + 3 * share**2) / (share * (1 - share))
    assert kurtosis(one).item() == pytest.approx(expected, rel=1e-12)


def test_one_damaged_tooth_raises_fm4_while_the_mesh_itself_does_not_count():
    teeth = 24
    angle = np.arange(2048 * 20) / 2048
    mesh = np.cos(2 * np.pi * teeth * angle) + 0.3 * np.cos(2 * np.pi * 2 * teeth * angle)
    noise = 0.01 * np.random.default_rng(3).standard_normal(len(angle))
    at = (angle % 1.0 - 0.4) * teeth
    tooth = 0.2 * np.exp(-(at**2)) * np.cos(2 * np.pi * 5 * teeth * angle)

    def found(signal: np.ndarray) -> float:
        options = {"samples_per_rev": 2048, "revs_per_cycle": 1, "regular_orders": [24.0, 48.0], "sidebands": 2}
        return fm4(synchronous_parts(signal[None], **options).difference).item()

    assert found(mesh + noise) == pytest.approx(3.0, abs=0.3)
    assert found(mesh + noise + tooth) > 15.0


def test_na4_is_the_kurtosis_where_no_record_differs_and_grows_with_the_amplitude_where_one_does():
    record = np.random.default_rng(4).standard_normal((1, 1, 5000))
    steady = np.repeat(record, 5, axis=0)
    assert na4(steady).item() == pytest.approx(kurtosis(record[0]).item(), rel=1e-12)
    grown = steady.copy()
    grown[-1] *= 2.0
    # 16 times the fourth moment over the square of (4 * 1 + 4) / 5
    assert na4(grown).item() == pytest.approx(kurtosis(record[0]).item() * 16 / 1.6**2, rel=1e-12)


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_the_amplitude_does_not_matter_even_where_its_square_is_no_number(size):
    noise = np.random.default_rng(5).standard_normal((1, 2000))
    for indicator in (kurtosis, m6a, crest_factor):
        assert indicator(size * noise).item() == pytest.approx(indicator(noise).item(), rel=1e-9)
    assert na4(size * noise[None]).item() == pytest.approx(na4(noise[None]).item(), rel=1e-9)
    assert fm0(size * noise, np.array([[size]])).item() == pytest.approx(fm0(noise, np.ones((1, 1))).item(), rel=1e-9)


def test_a_constant_has_no_moments():
    for indicator in (kurtosis, fm4, m6a):
        assert np.isnan(indicator(np.full((1, 100), 0.1)).item())
    assert np.isnan(crest_factor(np.zeros((1, 100))).item())
    assert np.isnan(na4(np.zeros((2, 1, 100))).item())
