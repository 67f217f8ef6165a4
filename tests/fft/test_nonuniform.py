"""Order amplitudes from samples at uneven angles: the direct sum against a plain one, and the laws of a transform."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.fft.nonuniform import order_amplitudes_direct, phase_of_whole_revs
from crankorder.fft.nonuniform_windows import folding_error, hann_of_constant, hann_weights

ORDERS = np.array([0.0, 0.5, 1.0, 2.0, 5.5, 5.48, 10.0, 37.123])
RNG = np.random.default_rng(5)


def plain_sums(signals, weights, angle_rev, orders):
    """The definition, term by term, in extended precision."""
    turns = np.outer(np.asarray(orders, dtype=np.longdouble), np.asarray(angle_rev, dtype=np.longdouble))
    turns = 2 * np.pi * (turns - np.rint(turns)).astype(float)
    weighted = np.asarray(signals, dtype=float) * weights
    return weighted @ np.cos(turns).T - 1j * (weighted @ np.sin(turns).T)


def uneven(n: int, begin_rev: float = 0.137, rev_per_sample: float = 0.013):
    """An angle that grows unevenly, and its slope per sample."""
    at = np.arange(n)
    swing = 0.3 * rev_per_sample / 0.01
    slope = rev_per_sample + swing * 0.01 * np.cos(0.01 * at)
    return begin_rev + rev_per_sample * at + swing * np.sin(0.01 * at), slope


def noise(n_channels: int, n: int):
    return RNG.standard_normal((n_channels, n))


@pytest.mark.parametrize("n", [1, 2, 511, 512, 513, 4000])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_direct_sum_is_the_plain_sum(n, dtype):
    angle, slope = uneven(n)
    signals = noise(3, n).astype(dtype)
    found = order_amplitudes_direct(signals, slope, angle, orders=ORDERS)
    bound = np.abs(signals * slope).sum(axis=1).max()
    np.testing.assert_allclose(found, plain_sums(signals, slope, angle, ORDERS), atol=3e-15 * bound, rtol=0)


@pytest.mark.parametrize("begin_rev", [0.0, 1e4, 123456789.0, 1e8, -1e8])
def test_phases_stay_right_at_large_angles(begin_rev):
    # steps of 1/64 rev are exact at any of these angles, so all digits that count are there
    angle = begin_rev + np.arange(3000) / 64.0
    signals = noise(2, len(angle))
    weights = np.full(len(angle), 1.0 / len(angle))
    exact = [[Fraction(a) * Fraction(o) for o in ORDERS] for a in angle]
    turns = 2 * np.pi * np.array([[float(t - round(t)) for t in row] for row in exact])
    expected = (signals * weights) @ np.exp(-1j * turns)
    found = order_amplitudes_direct(signals, weights, angle, orders=ORDERS)
    np.testing.assert_allclose(found, expected, atol=3e-15, rtol=0)


def test_a_tone_keeps_its_amplitude_over_a_hundred_million_samples_worth_of_angle():
    """Angles from 0 to 1e8 rev in steps of 1000 rev and a bit, seen at order 0.1, whose product needs 60 bits."""
    angle = np.arange(100_000) * 1000.015625
    turns = np.array([float(Fraction(a) * Fraction(0.1) % 1) for a in angle])
    weights = np.full(len(angle), 2.0 / len(angle))
    found = order_amplitudes_direct(np.cos(2 * np.pi * turns + 0.4)[None], weights, angle, orders=[0.1])
    expected = np.sum(weights * np.cos(2 * np.pi * turns + 0.4) * np.exp(-2j * np.pi * turns))
    np.testing.assert_allclose(found[0, 0], expected, atol=1e-14)


def test_the_phase_of_whole_revolutions_is_exact():
    angles, orders = np.array([1.0, 3e7 + 0.5, -1e8, 2.0**49 + 1]), np.array([0.1, 5.48, 99.99, 1e-3])
    exact = [[Fraction(a) * Fraction(o) for o in orders] for a in angles]
    expected = np.exp(-2j * np.pi * np.array([[float(t - round(t)) for t in row] for row in exact]))
    np.testing.assert_allclose(phase_of_whole_revs(angles, orders), expected, atol=2e-15, rtol=0)


def test_it_is_linear_and_its_channels_do_not_know_of_each_other():
    angle, slope = uneven(3000)
    a, b = noise(1, 3000), noise(1, 3000)
    of = {name: order_amplitudes_direct(x, slope, angle, orders=ORDERS) for name, x in {"a": a, "b": b}.items()}
    both = order_amplitudes_direct(2.0 * a + 0.3 * b, slope, angle, orders=ORDERS)
    np.testing.assert_allclose(both, 2.0 * of["a"] + 0.3 * of["b"], atol=1e-13)
    np.testing.assert_array_equal(order_amplitudes_direct(2.0 * a, slope, angle, orders=ORDERS), 2.0 * of["a"])
    stacked = order_amplitudes_direct(np.vstack([1e9 * b, a, np.full_like(a, np.nan)]), slope, angle, orders=ORDERS)
    np.testing.assert_array_equal(stacked[1], of["a"][0])
    assert np.isnan(stacked[2]).all()


def test_turning_the_angle_turns_the_phase():
    angle, slope = uneven(3000)
    signals = noise(2, 3000)
    turned = order_amplitudes_direct(signals, slope, angle + 0.25, orders=ORDERS)
    expected = order_amplitudes_direct(signals, slope, angle, orders=ORDERS) * np.exp(-0.5j * np.pi * ORDERS)
    np.testing.assert_allclose(turned, expected, atol=2e-12)


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_very_small_and_very_large_amplitudes_survive(size):
    angle, slope = uneven(3000)
    signals = noise(2, 3000)
    found = order_amplitudes_direct(signals * size, slope * 1e-4, angle, orders=ORDERS) / size
    expected = order_amplitudes_direct(signals, slope * 1e-4, angle, orders=ORDERS)
    np.testing.assert_allclose(found, expected, atol=1e-19)


def test_float32_samples_cost_only_their_own_rounding():
    angle, slope = uneven(3000)
    signals = noise(2, 3000)
    single = signals.astype(np.float32)
    found = order_amplitudes_direct(single, slope, angle, orders=ORDERS)
    np.testing.assert_array_equal(found, order_amplitudes_direct(single.astype(float), slope, angle, orders=ORDERS))
    bound = 2.0**-24 * np.abs(signals * slope).sum(axis=1).max()
    np.testing.assert_allclose(found, order_amplitudes_direct(signals, slope, angle, orders=ORDERS), atol=bound)


def test_an_angle_in_single_precision_is_refused():
    angle, slope = uneven(100)
    with pytest.raises(RequestError, match="float64"):
        order_amplitudes_direct(noise(1, 100), slope, angle.astype(np.float32), orders=ORDERS)


@pytest.mark.parametrize("shapes", [((1, 9), 8, 8), ((1, 8), 9, 8)])
def test_samples_that_do_not_match_are_refused(shapes):
    with pytest.raises(RequestError, match="same samples"):
        order_amplitudes_direct(np.ones(shapes[0]), np.ones(shapes[1]), np.ones(shapes[2]), orders=[1.0])


@pytest.mark.parametrize("begin_rev", np.linspace(0.4, 0.41, 7))
@pytest.mark.parametrize("slope_given", [True, False])
def test_hann_weights_give_the_peak_of_a_tone_wherever_their_ends_lie_between_samples(begin_rev, slope_given):
    angle, slope = uneven(1000, rev_per_sample=0.003)
    weights = hann_weights(
        angle, begin_rev=begin_rev, end_rev=begin_rev + 2.0, rev_per_sample=slope if slope_given else None
    )
    signal = 3.0 * np.cos(2 * np.pi * 4.5 * angle + 0.7) + np.cos(2 * np.pi * 2 * angle)
    found = order_amplitudes_direct(signal[None], weights, angle, orders=[4.5, 2.0, 0.0])
    assert folding_error(2.0 / slope.max() * 0.9) < 4e-8
    np.testing.assert_allclose(found[0], [3.0 * np.exp(0.7j), 1.0, 0.0], atol=4e-8)
    assert np.count_nonzero(weights) == np.count_nonzero((angle > begin_rev) & (angle < begin_rev + 2.0))


def test_a_constant_is_seen_at_each_order_as_said():
    angle = np.arange(40_000) * 1e-4 - 0.33
    weights = hann_weights(angle, begin_rev=0.0, end_rev=3.0, rev_per_sample=1e-4)
    orders = np.array([0.0, 0.1, 1 / 3, 0.5, 2 / 3, 1.0, 1.7, 20.4])
    found = order_amplitudes_direct(np.ones((1, angle.size)), weights, angle, orders=orders)
    np.testing.assert_allclose(found[0], hann_of_constant(orders * 3.0), atol=1e-12)


def test_folding_is_as_large_as_said():
    """The samples take a tone for its two images, ``away`` and ``away`` + 12 bins off order 3."""
    revs, n = 2.0, 400.0
    angle = (np.arange(450) - 20.3) * revs / n
    for away in (10.3, 30.7, 100.4):
        order = (n - away) / revs - 3.0
        weights = hann_weights(angle, begin_rev=0.0, end_rev=revs, rev_per_sample=revs / n)
        tones = np.stack([np.cos(2 * np.pi * order * angle + phase) for phase in (0.0, 1.0, 2.0)])
        read = np.abs(order_amplitudes_direct(tones, weights, angle, orders=[3.0]))
        assert read.max() <= folding_error(away) + folding_error(away + 12.0)
        assert read.max() > 0.5 * folding_error(away)


@pytest.mark.parametrize("signals", [np.ones(8), np.ones((1, 8)) * 1j])
def test_signals_that_are_not_real_channels_are_refused(signals):
    with pytest.raises(RequestError, match="real"):
        order_amplitudes_direct(signals, np.ones(8), np.ones(8), orders=[1.0])


def test_a_window_without_length_is_refused():
    with pytest.raises(RequestError, match="end after it begins"):
        hann_weights(np.arange(20.0), begin_rev=3.0, end_rev=3.0)
    with pytest.raises(RequestError, match="slope"):
        hann_weights(np.arange(8.0), begin_rev=3.0, end_rev=4.0)
