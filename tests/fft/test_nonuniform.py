"""Order spectra from samples at uneven angles: the tolerance asked for is met, and the laws of a transform hold."""

from fractions import Fraction

import numpy as np
import pytest

from crankorder.fft.nonuniform import (
    OrderTransform,
    folding_error,
    hann_of_constant,
    hann_of_turns,
    phase_of_whole_revs,
    upsampled,
    upsampling,
)

RNG = np.random.default_rng(6)
N_ORDERS = 400


def plain_sums(signals, weights, turns, orders):
    """The definition, term by term, in extended precision."""
    angle = np.outer(np.asarray(orders, dtype=np.longdouble), np.asarray(turns, dtype=np.longdouble))
    angle = 2 * np.pi * (angle - np.rint(angle)).astype(float)
    weighted = np.asarray(signals, dtype=float) * weights
    return weighted @ np.cos(angle).T - 1j * (weighted @ np.sin(angle).T)


def frame(n=3000):
    """Uneven turns over a little more than one frame, and its Hann weights."""
    at = np.arange(n)
    mean = 1.05 / n
    turns = -0.025 + mean * at + 2.5 * mean * np.sin(0.01 * at)
    slope = mean + 0.025 * mean * np.cos(0.01 * at)
    return turns, hann_of_turns(turns, slope)


def spectrum(signals, tolerance=1e-9, n_orders=N_ORDERS):
    turns, weights = frame(np.shape(signals)[1])
    plan = OrderTransform(n_orders=n_orders, n_channels=len(signals), tolerance=tolerance)
    return plan.spectra(signals, weights, turns)


def test_the_tolerance_asked_for_is_met():
    turns, weights = frame()
    tones = [np.cos(2 * np.pi * bins * turns + 1.0) for bins in (0.0, 8.0, 58.4, 241.0, 392.0, 1064.0)]
    impulse = np.zeros_like(turns)
    impulse[1207] = 1.0
    signals = np.stack([*tones, impulse, RNG.standard_normal(turns.size)])
    truth = plain_sums(signals, weights, turns, np.arange(N_ORDERS))
    size = np.abs(signals * weights).sum(axis=1)
    for tolerance in 10.0 ** -np.arange(1, 13):
        error = np.abs(spectrum(signals, tolerance) - truth)
        assert (error.max(axis=1) <= tolerance * size).all(), tolerance


def test_channels_do_not_know_of_each_other():
    for n_channels in (2, 3, 4):
        signals = RNG.standard_normal((n_channels, 3000))
        alone = np.concatenate([spectrum(signals[c : c + 1]) for c in range(n_channels)])
        scale = 10.0 ** (9.0 * np.arange(n_channels))[:, None]
        together = spectrum(signals * scale) / scale
        np.testing.assert_allclose(together, alone, atol=3e-15 * np.abs(signals).max(), rtol=0)


def test_a_sample_that_is_not_finite_takes_only_its_own_channel():
    signals = RNG.standard_normal((4, 3000))
    broken = signals.copy()
    broken[0, 1500], broken[3, 1600] = np.nan, np.inf
    found = spectrum(broken)
    assert np.isnan(found[[0, 3]]).all()
    np.testing.assert_allclose(found[[1, 2]], spectrum(signals)[[1, 2]], atol=1e-14)


def test_very_small_and_very_large_amplitudes_survive():
    signals = RNG.standard_normal((3, 3000))
    for size in (1e-300, 1e300):
        np.testing.assert_allclose(spectrum(signals * size) / size, spectrum(signals), atol=1e-14)


def test_a_plan_serves_frames_of_any_length_and_gives_the_same_bytes():
    plan = OrderTransform(n_orders=50, n_channels=2, tolerance=1e-6)
    signals = RNG.standard_normal((2, 4000))
    made = []
    for n in (1000, 1003, 1000):
        turns = (np.arange(n) + 0.5) / n
        weights = np.full(n, 1.0 / n)
        made.append(plan.spectra(signals, weights, turns, first=7))
        expected = plain_sums(signals[:, 7 : 7 + n], weights, turns, np.arange(50.0))
        np.testing.assert_allclose(made[-1], expected, atol=1e-6)
    np.testing.assert_array_equal(made[0], made[2])


def test_the_phase_of_whole_revolutions_is_exact():
    angles, orders = np.array([1.0, 3e7 + 0.5, -1e8, 2.0**49 + 1]), np.array([0.1, 5.48, 99.99, 1e-3])
    fractions = [[Fraction(a) * Fraction(o) for o in orders] for a in angles]
    expected = np.exp(-2j * np.pi * np.array([[float(t - round(t)) for t in row] for row in fractions]))
    np.testing.assert_allclose(phase_of_whole_revs(angles, orders), expected, atol=2e-15, rtol=0)


def test_hann_weights_give_the_peak_of_a_tone_wherever_their_ends_lie_between_samples():
    at = np.arange(1000)
    slope = 0.5 * (0.003 + 0.0009 * np.cos(0.01 * at))
    angle = 0.137 + 0.003 * at + 0.09 * np.sin(0.01 * at)
    assert folding_error(1.0 / slope.max() * 0.9) < 4e-8
    for begin in np.linspace(0.4, 0.41, 7):
        turns = (angle - begin) / 2.0
        weights = hann_of_turns(turns, slope)
        signal = 3.0 * np.cos(2 * np.pi * 9.0 * turns + 0.7) + np.cos(2 * np.pi * 4 * turns)
        found = plain_sums(signal[None], weights, turns, [9.0, 4.0, 0.0])
        np.testing.assert_allclose(found[0], [3.0 * np.exp(0.7j), 1.0, 0.0], atol=4e-8)
        assert np.count_nonzero(weights) == np.count_nonzero((turns > 0.0) & (turns < 1.0))


def test_a_constant_is_seen_at_each_order_as_said():
    turns = (np.arange(40_000) * 1e-4 - 0.33) / 3.0
    weights = hann_of_turns(turns, np.full(turns.size, 1e-4 / 3.0))
    bins = 3.0 * np.array([0.0, 0.1, 1 / 3, 0.5, 2 / 3, 1.0, 1.7, 20.4])
    found = plain_sums(np.ones((1, turns.size)), weights, turns, bins)
    np.testing.assert_allclose(found[0], hann_of_constant(bins), atol=1e-12)


def test_folding_is_as_large_as_said():
    """The samples take a tone for its two images, ``away`` and ``away`` + 12 bins off bin 6."""
    n = 400.0
    turns = (np.arange(450) - 20.3) / n
    weights = hann_of_turns(turns, np.full(turns.size, 1.0 / n))
    for away in (10.3, 30.7, 100.4):
        tones = np.stack([np.cos(2 * np.pi * (n - away - 6.0) * turns + phase) for phase in (0.0, 1.0, 2.0)])
        read = np.abs(plain_sums(tones, weights, turns, [6.0]))
        assert read.max() <= folding_error(away) + folding_error(away + 12.0)
        assert read.max() > 0.5 * folding_error(away)


@pytest.mark.cases(2)
@pytest.mark.parametrize("factor", [2, 4, 16])
@pytest.mark.parametrize("pass_share", [0.1, 0.4, 0.49])
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_denser_samples_are_right_up_to_the_share_and_without_images(factor, pass_share, tolerance):
    plan = upsampling(factor, pass_share=pass_share, tolerance=tolerance)
    n = 2 * plan.reach + 300
    for share in (0.0, 0.5 * pass_share, pass_share):
        signal = np.cos(2 * np.pi * share * np.arange(n) + 0.4)[None]
        values, begin = upsampled(signal, plan, first=plan.reach, last=n - 1 - plan.reach)
        at = plan.reach + (np.arange(values.shape[1]) - begin) / factor
        inside = (at >= plan.reach) & (at <= n - 1 - plan.reach)
        assert np.count_nonzero(inside) == 299 * factor + 1
        np.testing.assert_allclose(values[0], np.cos(2 * np.pi * share * at + 0.4), atol=tolerance)
