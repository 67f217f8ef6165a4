"""Claims among many comparisons: the published procedure, and its promise where nothing or something differs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import false_discovery_control, norm

from crankorder.identify.intervals import adjusted, claimed, simes

# Benjamini, Hochberg (1995), section 4.1: fifteen p-values, four of which are claimed at 0.05
PUBLISHED = [
    0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0,
]  # fmt: skip
Q = 0.05


def test_the_published_example_claims_four():
    assert claimed(np.array(PUBLISHED[::-1]), q=Q)[::-1].tolist() == [True] * 4 + [False] * 11


def test_an_independent_program_adjusts_alike():
    values = np.random.default_rng(1).random((20, 30)) ** 3
    expected = false_discovery_control(values.ravel(), method="bh").reshape(values.shape)
    np.testing.assert_allclose(adjusted(values), expected, rtol=1e-12)


def test_what_was_not_compared_is_never_claimed_and_does_not_count():
    values = np.array([0.001, np.nan, 0.04, np.nan])
    assert claimed(values, q=Q).tolist() == [True, False, True, False]
    assert not claimed(np.full(3, np.nan), q=Q).any()
    assert np.isnan(simes(np.array([np.nan])))


def _neighbours(rng, shape):
    """Normal numbers that correlate as the bins of a Hann window do: 2/3 and 1/6 with the next two."""
    white = rng.standard_normal((*shape[:-1], shape[-1] + 2))
    return (white[..., :-2] * 0.5 + white[..., 1:-1] + white[..., 2:] * 0.5) / np.sqrt(1.5)


def test_where_nothing_differs_anything_is_claimed_as_rarely_as_stated():
    rng, n = np.random.default_rng(2), 4000
    p_values = 2 * norm.sf(np.abs(_neighbours(rng, (n, 200))))
    share = np.mean([claimed(row, q=Q).any() for row in p_values])
    assert share <= Q + 3 * np.sqrt(Q * (1 - Q) / n)
    assert share > 0.5 * Q  # nor is power given away
    chance = np.array([simes(row) for row in p_values])
    assert np.mean(chance <= Q) == pytest.approx(share)


@pytest.mark.slow
def test_of_the_claims_in_a_mixture_at_most_the_stated_share_is_false():
    rng, n = np.random.default_rng(3), 1500
    changed = np.arange(200) < 40
    values = _neighbours(rng, (n, 200)) + 3.5 * changed
    says = np.array([claimed(row, q=Q) for row in 2 * norm.sf(np.abs(values))])
    false = np.sum(says & ~changed, axis=1) / np.maximum(says.sum(axis=1), 1)
    assert np.mean(false) <= Q + 3 * np.std(false) / np.sqrt(n)
    assert np.mean(says[:, changed]) > 0.5
