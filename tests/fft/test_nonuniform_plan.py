"""All orders at once by the non-uniform FFT: the tolerance asked for is met, and the laws of a transform hold."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.fft.nonuniform import order_amplitudes_direct
from crankorder.fft.nonuniform_plan import OrderTransform, order_spectrum_nufft
from crankorder.fft.nonuniform_upsampling import upsampled, upsampling
from crankorder.fft.nonuniform_windows import hann_of_constant, hann_weights

RNG = np.random.default_rng(6)
REVS, N_ORDERS = 8.0, 400
ORDERS = np.arange(N_ORDERS) / REVS


def frame(n: int = 3000):
    """Uneven angles over a little more than one frame from 41 rev on, and its Hann weights."""
    at = np.arange(n)
    mean = 8.4 / n
    angle = 41.0 - 0.2 + mean * at + 20.0 * mean * np.sin(0.01 * at)
    slope = mean + 0.2 * mean * np.cos(0.01 * at)
    return angle, hann_weights(angle, begin_rev=41.0, end_rev=41.0 + REVS, rev_per_sample=slope)


def spectrum(signals, tolerance=1e-9, angle_rev=None, **given):
    angle, weights = frame(np.shape(signals)[1])
    angle = angle if angle_rev is None else angle_rev
    made = {"orders_step": 1.0 / REVS, "n_orders": N_ORDERS, "tolerance": tolerance} | given
    return order_spectrum_nufft(signals, weights, angle, **made)


def kinds_of_signals(angle):
    tones = [np.cos(2 * np.pi * order * angle + 1.0) for order in (0.0, 1.0, 7.3, 30.125, 49.0, 133.0)]
    impulse = np.zeros_like(angle)
    impulse[1207] = 1.0
    return np.stack([*tones, impulse, RNG.standard_normal(angle.size)])


@pytest.mark.parametrize("tolerance", [10.0**-k for k in range(1, 13)])
def test_the_tolerance_asked_for_is_met(tolerance):
    angle, weights = frame()
    signals = kinds_of_signals(angle)
    error = np.abs(spectrum(signals, tolerance) - order_amplitudes_direct(signals, weights, angle, orders=ORDERS))
    assert (error.max(axis=1) <= tolerance * np.abs(signals * weights).sum(axis=1)).all()


def test_no_more_is_spent_than_is_asked_for():
    """An error within 1/1000 of the tolerance would have cost kernel points for nothing."""
    angle, weights = frame()
    signals = kinds_of_signals(angle)
    exact = order_amplitudes_direct(signals, weights, angle, orders=ORDERS)
    for tolerance in (1e-3, 1e-6, 1e-9):
        assert np.abs(spectrum(signals, tolerance) - exact).max() > 1e-3 * tolerance


@pytest.mark.parametrize("n_channels", [1, 2, 3, 4])
def test_channels_do_not_know_of_each_other(n_channels):
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


def test_it_is_linear_and_doubles_with_its_input():
    a, b = RNG.standard_normal((2, 1, 3000))
    np.testing.assert_array_equal(spectrum(2.0 * a), 2.0 * spectrum(a))
    np.testing.assert_allclose(spectrum(a + 0.3 * b), spectrum(a) + 0.3 * spectrum(b), atol=1e-14)


def test_turning_the_angle_turns_the_phase():
    signals = RNG.standard_normal((2, 3000))
    angle, _ = frame()
    for shift in (0.25, 1e6 + 0.25):
        turned = spectrum(signals, tolerance=1e-12, angle_rev=angle + shift)
        expected = spectrum(signals, tolerance=1e-12) * np.exp(-2j * np.pi * ORDERS * (shift % 8.0))
        np.testing.assert_allclose(turned, expected, atol=2e-12 + 2e-16 * shift * ORDERS[-1])


def test_single_precision_samples_are_analysed_and_single_precision_angles_refused():
    signals = RNG.standard_normal((2, 3000)).astype(np.float32)
    np.testing.assert_array_equal(spectrum(signals), spectrum(signals.astype(float)))
    with pytest.raises(RequestError, match="float64"):
        spectrum(signals, angle_rev=frame()[0].astype(np.float32))


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_very_small_and_very_large_amplitudes_survive(size):
    signals = RNG.standard_normal((3, 3000))
    np.testing.assert_allclose(spectrum(signals * size) / size, spectrum(signals), atol=1e-14)


def test_the_power_of_evenly_spaced_samples_is_that_of_their_orders():
    """Parseval, where it applies: uniform angles, a rectangular window and every order up to half the samples."""
    n = 2048
    signals = RNG.standard_normal((2, n))
    weights = np.full(n, 1.0 / n)
    found = order_spectrum_nufft(
        signals, weights, 3.0 + np.arange(n) / 256.0, orders_step=0.125, n_orders=n // 2 + 1, tolerance=1e-12
    )
    twice = np.full(n // 2 + 1, 2.0)
    twice[[0, -1]] = 1.0
    np.testing.assert_allclose(np.abs(found) ** 2 @ twice, np.mean(signals**2, axis=1), rtol=1e-11)


def test_a_plan_serves_frames_of_any_length_and_gives_the_same_bytes():
    plan = OrderTransform(n_orders=50, n_channels=2, tolerance=1e-6)
    signals = RNG.standard_normal((2, 4000))
    made = []
    for n in (1000, 1003, 1000):
        turns = (np.arange(n) + 0.5) / n
        weights = np.full(n, 1.0 / n)
        made.append(plan.spectra(signals, weights, turns, first=7))
        exact = order_amplitudes_direct(signals[:, 7 : 7 + n], weights, turns, orders=np.arange(50.0))
        np.testing.assert_allclose(made[-1], exact, atol=1e-6)
    np.testing.assert_array_equal(made[0], made[2])


def test_a_mean_a_million_times_the_signal_does_not_show():
    plan = OrderTransform(n_orders=50, n_channels=2, tolerance=1e-6)
    n = 4096
    turns = np.arange(n) / n
    weights = 2.0 * (1.0 - np.cos(2 * np.pi * turns)) / n
    of_mean = hann_of_constant(np.arange(50))
    signals = np.stack([1e6 + np.cos(2 * np.pi * 7 * turns + 0.3), np.cos(2 * np.pi * 3 * turns)])
    found = plan.spectra(signals, weights, turns, mean_spectrum=of_mean)
    np.testing.assert_allclose(found[:, [7, 3]], [[np.exp(0.3j), 0.0], [0.0, 1.0]], atol=1e-6)
    np.testing.assert_allclose(found[0, :2], [2e6, -1e6], rtol=1e-12)
    np.testing.assert_allclose(np.abs(found[0, 10:]), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    "given", [{"tolerance": 1e-13}, {"tolerance": 0.5}, {"orders_step": 0.0}, {"orders_step": np.nan}, {"n_orders": 0}]
)
def test_what_cannot_be_is_refused(given):
    with pytest.raises(RequestError):
        spectrum(np.ones((1, 3000)), **given)


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
