"""The Vold-Kalman filter: its laws, its bandwidth, and the solution of the equations as they stand."""

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.orders.vold_kalman import NOISE_BANDWIDTH, vold_kalman
from made.recordings import envelopes

RATE_HZ = 2000.0


def exact_envelope(signal, phase_rev, *, bandwidth_hz):
    """Envelope of one order by orthogonal transformation of the whole, dense problem: no normal equations.

    Rows of the structural equation are weighted by r, those of the data by one; a constant is an unknown more.
    """
    n = len(signal)
    r = np.sqrt((np.sqrt(2.0) - 1.0) / 2.0) / (2.0 * np.sin(0.5 * np.pi * bandwidth_hz / RATE_HZ)) ** 2
    structure = r * np.diff(np.eye(n), 2, axis=0)
    empty, column = np.zeros_like(structure), np.zeros((len(structure), 1))
    angle = 2 * np.pi * phase_rev
    data = np.hstack([np.diag(np.cos(angle)), np.diag(np.sin(angle)), np.ones((n, 1))])
    rows = np.vstack([np.hstack([structure, empty, column]), np.hstack([empty, structure, column]), data])
    q, upper = np.linalg.qr(rows)
    found = np.linalg.solve(upper, q.T @ np.concatenate([np.zeros(2 * len(structure)), signal]))
    return found[:n] - 1j * found[n : 2 * n]


def run_up(n, *, order=1.0):
    """Phase [rev] of an order on a run-up from 60 Hz on."""
    time_s = np.arange(n) / RATE_HZ
    return order * (60.0 * time_s + 25.0 * time_s**2)


def line(envelope, phase_rev):
    return np.real(envelope * np.exp(2j * np.pi * (phase_rev - np.floor(phase_rev))))


def test_the_noise_bandwidth_is_the_integral_of_the_squared_gain():
    x = np.linspace(-100.0, 100.0, 200_001)
    integral = np.sum((1.0 + (np.sqrt(2.0) - 1.0) * x**4) ** -2.0) * (x[1] - x[0]) / 2.0
    assert integral == pytest.approx(NOISE_BANDWIDTH, rel=1e-6)


def test_a_modulated_line_comes_out_half_as_strong_at_the_edge_of_the_band():
    time_s = np.arange(24_000) / RATE_HZ
    phase = 300.0 * time_s
    signal = np.cos(2 * np.pi * 304.0 * time_s)
    amplitude, _ = envelopes([signal], [phase], rate_hz=RATE_HZ, bandwidth_hz=8.0)
    middle = slice(8_000, 16_000)
    assert np.abs(amplitude[0, 0, middle]) == pytest.approx(np.sqrt(0.5), abs=3e-4)


def test_a_wide_band_is_that_of_the_dense_problem_on_knots_of_few_samples():
    phase, noise = run_up(400), np.random.default_rng(2).normal(size=400)
    truth = exact_envelope(noise + 2.0, phase, bandwidth_hz=40.0)
    amplitude, _ = envelopes([noise + 2.0], [phase], rate_hz=RATE_HZ, bandwidth_hz=40.0)
    wrong = np.sqrt(np.mean(np.abs(amplitude[0, 0] - truth) ** 2))
    assert wrong < 1e-3 * np.sqrt(np.mean(np.abs(truth) ** 2))


def test_on_knots_it_is_the_solution_of_the_dense_problem_but_for_what_is_far_from_the_order():
    """What the exact filter lets through from beyond 8 bandwidths is all that differs: of white noise of unit strength
    less than 1e-3 of what stays in the band."""
    rng = np.random.default_rng(2)
    phase, noise = run_up(500), rng.normal(size=500)
    for bandwidth_hz in (1e-2, 0.8, 4.0, 15.0):
        truth = exact_envelope(noise, phase, bandwidth_hz=bandwidth_hz)
        amplitude, _ = envelopes([noise], [phase], rate_hz=RATE_HZ, bandwidth_hz=bandwidth_hz)
        wrong = np.sqrt(np.mean(np.abs(amplitude[0, 0] - truth) ** 2))
        assert wrong < 1e-3 * np.sqrt(np.mean(np.abs(truth) ** 2))


@pytest.mark.parametrize("ratio", [5e1, 1e4, 1e8])
def test_a_steady_amplitude_is_exact_at_any_bandwidth(ratio):
    phase = run_up(20_000)
    truth = 1.7 * np.exp(0.4j)
    signal = line(truth, phase - np.floor(phase))
    amplitude, _ = envelopes([signal], [phase], rate_hz=RATE_HZ, bandwidth_hz=RATE_HZ / ratio)
    assert np.abs(amplitude - truth).max() < 1e-12


def test_it_is_linear_doubles_and_leaves_channels_apart():
    rng = np.random.default_rng(2)
    phase, signals = run_up(6_000)[None], rng.normal(size=(2, 6_000))

    def amplitude(values):
        return envelopes(values, phase, rate_hz=RATE_HZ, bandwidth_hz=2.0)[0]

    both = amplitude(signals)
    assert np.array_equal(amplitude(2.0 * signals), 2.0 * both)
    assert np.abs(amplitude(signals[:1] + 3.0 * signals[1:]) - both[:1] - 3.0 * both[1:]).max() < 1e-13
    assert np.abs(amplitude(signals[1:]) - both[1:]).max() < 1e-15


def test_a_shift_of_the_phase_reference_turns_the_amplitude():
    rng = np.random.default_rng(3)
    phase, signal = run_up(6_000)[None], rng.normal(size=(1, 6_000))
    plain, _ = envelopes(signal, phase, rate_hz=RATE_HZ, bandwidth_hz=3.0)
    moved, _ = envelopes(signal, phase + 0.3, rate_hz=RATE_HZ, bandwidth_hz=3.0)
    assert np.abs(moved * np.exp(0.6j * np.pi) - plain).max() < 1e-12


def test_a_bandwidth_that_varies_is_met_everywhere():
    rng = np.random.default_rng(6)
    n = 40_000
    phase = run_up(n)
    wide = np.linspace(1.0, 20.0, n)
    noise = rng.normal(size=(32, n))
    amplitude, _ = envelopes(noise, [phase], rate_hz=RATE_HZ, bandwidth_hz=wide[None])
    power = np.mean(np.abs(amplitude[:, 0]) ** 2, axis=0)
    for part in (slice(10_000, 20_000), slice(25_000, 35_000)):
        expected = 2.0 * 2.0 * NOISE_BANDWIDTH * wide[part].mean() / RATE_HZ
        assert power[part].mean() == pytest.approx(expected, rel=0.06)


def test_single_precision_agrees_to_its_own_rounding():
    rng = np.random.default_rng(7)
    phase = run_up(8_000)[None]
    signal = line(2.0 + 0.0j, phase) + 0.1 * rng.normal(size=(1, 8_000))
    double, _ = envelopes(signal, phase, rate_hz=RATE_HZ, bandwidth_hz=3.0)
    single, _ = envelopes(signal.astype(np.float32), phase, rate_hz=RATE_HZ, bandwidth_hz=3.0)
    assert np.abs(single - double).max() < 2.0 * 6e-8


def test_orders_that_move_together_are_refused_by_name():
    phase, noise = run_up(8_000), np.random.default_rng(8).normal(size=(1, 8_000))
    for near in (phase.copy(), phase * 1.0002):
        with pytest.raises(RequestError, match="component 0 and component 1 cannot be told apart"):
            envelopes(noise, [phase, near], rate_hz=RATE_HZ, bandwidth_hz=5.0)


def test_a_line_slower_than_its_band_is_refused_for_its_image():
    time_s = np.arange(20_000) / RATE_HZ
    with pytest.raises(RequestError, match="its own image at minus the frequency"):
        envelopes([np.cos(time_s)], [0.05 * time_s], rate_hz=RATE_HZ, bandwidth_hz=4.0)


def test_bandwidths_that_differ_too_much_are_refused():
    with pytest.raises(RequestError, match="differ too much"):
        vold_kalman(
            np.zeros((1, 500)), np.stack([run_up(500), run_up(500, order=2.0)]), np.arange(500),
            usable=np.ones((1, 500), dtype=bool), rate_hz=RATE_HZ, bandwidth_hz=np.array([[0.1] * 2, [21.0] * 2]),
            names=["1", "2"],
        )  # fmt: skip
