"""Joint least squares: close and crossing orders, conditioning, errors, gaps, scale."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.errors import InputError, RequestError
from crankorder.orders.least_squares import LARGEST_CONDITION, joint_orders, tracked_orders
from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from made.recordings import line, run_up, steady, total


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


SETTINGS = load_settings().orders


def made_from(*parts, duration_s=20.0, **given):
    return steady([total(*parts)], speed_rpm=1237.0, duration_s=duration_s, rate_hz=2000.0, **given)


def test_close_orders_of_a_recording_come_out_with_amplitude_and_phase_from_top_dead_centre():
    recording = made_from(line(5.5, 1.0, 0.4), line(5.48, 0.3, -1.0), line(2.0, 5.0))
    made = tracked_orders(*recording, [5.5, 5.48, 2.0], settings=SETTINGS)
    for order, truth in ((5.5, np.exp(0.4j)), (5.48, 0.3 * np.exp(-1j)), (2.0, 5.0)):
        np.testing.assert_allclose(made["amplitude"].sel(order=order).values, truth, atol=1e-8)


def test_orders_that_are_not_named_do_not_leak_into_whole_cycles():
    recording = made_from(line(5.5, 0.01), line(2.0, 5.0), line(6.0, 3.0, 1.0), lambda t, _: 7.0 + 0.0 * t)
    made = tracked_orders(*recording, [5.5], settings=SETTINGS)
    np.testing.assert_allclose(np.abs(made["amplitude"].values), 0.01, rtol=0.02)


def test_frames_are_whole_cycles_and_lose_none():
    made = tracked_orders(*made_from(line(2.0, 1.0)), [2.0], settings=SETTINGS)
    revs = made["revs"].values
    assert (revs % 2 == 0).all()
    assert (revs >= SETTINGS.revs_per_frame).all()
    # from -0.3 revolutions on: from the first to the last whole one, 412 in whole cycles
    assert revs.sum() == np.floor(20.0 * 1237.0 / 60.0 - 0.3) // 2 * 2


def test_a_run_up_keeps_its_amplitude_and_its_speeds():
    recording = run_up([line(3.0, 2.0, 0.5)], from_rpm=500, to_rpm=3000, duration_s=20.0, rate_hz=2000.0)
    made = tracked_orders(*recording, [3.0], settings=SETTINGS)
    np.testing.assert_allclose(made["amplitude"].values.ravel(), 2.0 * np.exp(0.5j), rtol=1e-7)
    assert (np.diff(made["speed"].values) > 0).all()


def test_what_cannot_be_told_apart_or_carried_is_said():
    recording = made_from(line(5.5, 1.0))
    made = tracked_orders(*recording, [5.5, 5.5 + 1e-13, 60.0], settings=SETTINGS)
    np.testing.assert_allclose(made["combined_amplitude"].sel(order=5.5).values[0], 1.0, atol=1e-6)
    assert np.isnan(made["amplitude"].values).all()
    told = " ".join(flag["detail"] for flag in flags_of(made))
    assert "cannot be told apart" in told
    assert "60 is beyond" in told


def test_a_gap_in_one_channel_leaves_the_other_alone():
    band, shaft = steady([line(2.0, 1.0), line(2.0, 3.0)], speed_rpm=1200.0, duration_s=4.0, rate_hz=2000.0)
    band["signal"].values[1, 1000:1400] = np.nan
    made = tracked_orders(band, shaft, [2.0], settings=SETTINGS)
    np.testing.assert_allclose(np.abs(made["amplitude"].values[:, 0]).T, [[1.0, 3.0]] * made.sizes["frame"], atol=1e-8)


def test_requests_that_make_no_sense_are_refused():
    recording = made_from(line(2.0, 1.0))
    for orders in ([], [0.0], [-1.0]):
        with pytest.raises(RequestError, match="above 0"):
            tracked_orders(*recording, orders, settings=SETTINGS)
    with pytest.raises(InputError, match="less than one engine cycle"):
        tracked_orders(*made_from(line(2.0, 1.0), duration_s=0.08), [2.0], settings=SETTINGS)


def test_an_order_that_is_not_carried_leaves_the_rows_of_the_others_alone():
    recording = steady([total(line(2.0, 1.5, 0.4), line(3.0, 0.5))], speed_rpm=6000.0, duration_s=3.0, rate_hz=2000.0)
    made = tracked_orders(*recording, [12.0, 2.0, 3.0, 3.0 + 1e-13], settings=SETTINGS)
    assert np.isnan(made["amplitude"].sel(order=12.0).values).all()
    np.testing.assert_allclose(made["amplitude"].sel(order=2.0).values, 1.5 * np.exp(0.4j), atol=1e-8)
    np.testing.assert_allclose(made["combined_amplitude"].values[0, 2], 0.5, atol=1e-6)
    told = [flag["detail"] for flag in flags_of(made)]
    assert any("orders 3 and 3 cannot be told apart" in one for one in told)
    assert "order 12 is beyond half the sample rate" in told


def test_an_order_beyond_half_the_sample_rate_alone_is_nan_and_said():
    made = tracked_orders(*made_from(line(2.0, 1.0)), [60.0], settings=SETTINGS)
    assert np.isnan(made["amplitude"].values).all()
    assert "60 is beyond" in flags_of(made)[-1]["detail"]


def test_frames_overlap_where_the_speed_changes_and_take_in_all_cycles_still():
    recording = run_up([line(3.0, 2.0)], from_rpm=600, to_rpm=3000, duration_s=20.0, rate_hz=2000.0)
    made = tracked_orders(*recording, [3.0], settings=SETTINGS)
    begin, revs = made["crank_angle"].values, made["revs"].values
    assert (np.diff(begin) < 0.6 * revs[:-1]).all()
    assert (revs >= SETTINGS.revs_per_frame).all()
    assert begin[-1] + revs[-1] - begin[0] == 20.0 * 1800.0 / 60.0 // 2 * 2 - 2  # the last sample is short of the last
