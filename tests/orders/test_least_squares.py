"""Joint least squares: close and crossing orders, conditioning, errors, gaps, scale."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.orders.least_squares import LARGEST_CONDITION, joint_orders


def signal(phases: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    return np.real(amplitude[:, None] * np.exp(2j * np.pi * phases)).sum(axis=0)


ANGLE = np.arange(3200) / 100.0
AMPLITUDE = np.array([1.0, 2.0, 3.0]) * np.exp(1j * np.array([0.1, 0.2, 0.3]))


def test_noise_free_orders_come_out_at_round_off_and_no_image_leaks_in():
    # 0.03 cycles in the record: a complex demodulation would see half of the image at the negative frequency
    phases = np.stack([0.003 * ANGLE[:1000], 2.5 * ANGLE[:1000], 30.25 * ANGLE[:1000]])
    made = joint_orders(signal(phases, AMPLITUDE)[None], phases)
    np.testing.assert_allclose(made.amplitude[0], AMPLITUDE, rtol=1e-8)
    phases = np.stack([0.75 * ANGLE, 2.5 * ANGLE, 30.25 * ANGLE])
    made = joint_orders(signal(phases, AMPLITUDE)[None], phases)
    # the made signal itself holds the round-off of its largest phase
    round_off = 2 * np.pi * phases.max() * np.finfo(float).eps
    np.testing.assert_allclose(made.amplitude[0], AMPLITUDE, rtol=round_off)


@pytest.mark.parametrize("apart", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_close_orders_are_told_apart_as_well_as_numbers_allow(apart):
    phases = np.stack([5.0 * ANGLE, (5.0 + apart) * ANGLE, 7.0 * ANGLE])
    made = joint_orders(signal(phases, AMPLITUDE)[None], phases)
    # round-off of the phases, 160 revolutions times 1e-16, grows by the condition
    assert np.abs(made.amplitude[0] - AMPLITUDE).max() < 3e-13 * made.condition
    assert made.together == ()


def test_components_that_cannot_be_told_apart_are_named_and_their_sum_is_given():
    phases = np.stack([5.0 * ANGLE, 5.0 * ANGLE, 7.0 * ANGLE])
    made = joint_orders(signal(phases, AMPLITUDE)[None], phases)
    assert made.together == ((0, 1),)
    assert made.condition > LARGEST_CONDITION
    assert np.isnan(made.amplitude[0, :2]).all()
    np.testing.assert_allclose(made.combined_amplitude[0, :2], AMPLITUDE[:2].sum(), rtol=1e-10)
    np.testing.assert_allclose(made.amplitude[0, 2], AMPLITUDE[2], rtol=1e-10)


def test_orders_of_two_shafts_that_cross_keep_their_amplitudes():
    time = np.linspace(0.0, 1.0, 20_000)
    phases = np.stack([200.0 * time + 100.0 * time**2, 300.0 * time, 500.0 * time - 100.0 * time**2])
    made = joint_orders(signal(phases, AMPLITUDE)[None], phases)
    np.testing.assert_allclose(made.amplitude[0], AMPLITUDE, rtol=1e-12)


def test_constant_offset_is_a_component_of_order_0_and_has_no_sine():
    phases = np.stack([0.0 * ANGLE, 5.0 * ANGLE])
    made = joint_orders((1e6 + np.cos(2 * np.pi * phases[1]))[None], phases)
    np.testing.assert_allclose(made.amplitude[0], [1e6, 1.0], atol=1e-8)


@pytest.mark.parametrize("scale", [1e-300, 1e300])
def test_very_small_and_very_large_signals_survive(scale):
    noise = np.random.default_rng(1).standard_normal(len(ANGLE))
    phases = np.stack([5.0 * ANGLE, 5.5 * ANGLE])
    values = signal(phases, AMPLITUDE[:2]) + 0.01 * noise
    plain, made = joint_orders(values[None], phases), joint_orders((scale * values)[None], phases)
    np.testing.assert_allclose(made.amplitude / scale, plain.amplitude, rtol=1e-12)
    np.testing.assert_allclose(made.standard_error / scale, plain.standard_error, rtol=1e-12)


def test_both_precisions_and_all_channels_agree():
    rng = np.random.default_rng(2)
    phases = np.stack([5.0 * ANGLE, 5.5 * ANGLE])
    values = np.stack([signal(phases, k * AMPLITUDE[:2]) for k in (1.0, 2.0)]) + rng.standard_normal((2, len(ANGLE)))
    both = joint_orders(values, phases)
    for k in range(2):
        alone = joint_orders(values[k], phases)
        np.testing.assert_allclose(both.amplitude[k], alone.amplitude[0], rtol=1e-12)
        np.testing.assert_allclose(both.standard_error[k], alone.standard_error[0], rtol=1e-9)
    single = joint_orders(values.astype(np.float32), phases)
    assert np.abs(single.amplitude - both.amplitude).max() < 1e-7 * np.abs(values).max()


def test_unusable_samples_take_no_part_channel_by_channel():
    phases = np.stack([5.0 * ANGLE, 5.48 * ANGLE])
    values = np.stack([signal(phases, AMPLITUDE[:2])] * 2)
    usable = np.ones(values.shape, dtype=bool)
    usable[1, 700:1500] = False
    values[1, 700:1500] = 1e9
    made = joint_orders(values, phases, usable=usable)
    np.testing.assert_allclose(made.amplitude, np.stack([AMPLITUDE[:2]] * 2), rtol=1e-9)


def test_too_few_samples_are_refused():
    with pytest.raises(RequestError, match="fewer usable samples"):
        joint_orders(np.zeros((1, 5)), np.zeros((3, 5)))
    with pytest.raises(RequestError, match="differ in length"):
        joint_orders(np.zeros((1, 5)), np.zeros((1, 6)))


def test_the_solution_is_that_of_an_independent_solver():
    rng = np.random.default_rng(5)
    phases = np.stack([1.0 * ANGLE, 1.005 * ANGLE, 3.3 * ANGLE])
    values, weights = rng.standard_normal(len(ANGLE)), rng.uniform(0.5, 2.0, len(ANGLE))
    columns = np.concatenate([np.cos(2 * np.pi * phases), np.sin(2 * np.pi * phases)]) * np.sqrt(weights)
    expected = np.linalg.lstsq(columns.T, values * np.sqrt(weights), rcond=None)[0]
    made = joint_orders(values[None], phases, weights=weights)
    np.testing.assert_allclose(made.amplitude[0], expected[:3] - 1j * expected[3:], rtol=1e-9)
