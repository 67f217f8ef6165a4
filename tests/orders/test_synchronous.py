"""Time-synchronous averages against the laws of a comb filter (McFadden 1987) and analytic signals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.errors import RequestError
from crankorder.orders.synchronous import comb_response, synchronous_average, synchronous_parts

PER_REV = 96


def angles(revs: float) -> np.ndarray:
    return np.arange(round(revs * PER_REV)) / PER_REV


def line(order: float, amplitude: float, phase: float, angle: np.ndarray) -> np.ndarray:
    return amplitude * np.cos(2 * np.pi * order * angle + phase)


def locked(angle: np.ndarray) -> np.ndarray:
    return line(0.5, 0.2, 0.3, angle) + line(1.0, 2.0, -1.0, angle) + line(5.5, 0.7, 2.0, angle) + 0.4


def parts_of(signals: np.ndarray, **options):
    return synchronous_parts(signals, samples_per_rev=PER_REV, **{"revs_per_cycle": 2, **options})


def test_the_average_of_a_locked_signal_is_the_signal_and_its_residual_is_nothing():
    angle = angles(41.3)
    parts = parts_of(locked(angle)[None])
    np.testing.assert_allclose(parts.average[0], locked(angle[: 2 * PER_REV]), atol=2e-13)
    assert np.abs(parts.residual).max() < 4e-13
    assert parts.n_cycles.tolist() == [20]


def test_average_and_residual_add_up_to_the_signal_even_in_the_broken_cycle_at_the_end():
    angle = angles(17.7)
    signal = locked(angle) + np.random.default_rng(1).standard_normal(len(angle))
    parts = parts_of(signal[None])
    tiled = np.resize(parts.average[0], len(signal))
    np.testing.assert_allclose(tiled + parts.residual[0], signal, rtol=0, atol=1e-14)


@pytest.mark.parametrize("sidebands", [0, 1, 3])
def test_regular_and_difference_add_up_to_the_average_and_hold_what_their_orders_say(sidebands):
    angle = angles(40)
    mesh = line(12.0, 3.0, 0.1, angle) + line(24.0, 1.0, 0.2, angle)
    beside = line(11.0, 0.5, 0.3, angle) + line(14.0, 0.25, 0.4, angle)
    parts = parts_of((mesh + beside)[None], regular_orders=[12.0, 24.0], sidebands=sidebands)
    np.testing.assert_allclose(parts.regular + parts.difference, parts.average, rtol=0, atol=1e-14)
    kept = (
        mesh
        + (line(11.0, 0.5, 0.3, angle) if sidebands else 0.0)
        + (line(14.0, 0.25, 0.4, angle) if sidebands > 1 else 0.0)
    )
    np.testing.assert_allclose(parts.regular[0], kept[: 2 * PER_REV], atol=1e-12)


def test_sidebands_of_a_half_speed_shaft_lie_half_an_order_away():
    angle = angles(40)
    signal = line(12.0, 3.0, 0.1, angle) + line(11.5, 0.5, 0.3, angle) + line(11.0, 0.25, 0.3, angle)
    parts = parts_of(signal[None], regular_orders=[12.0], sidebands=1, sideband_step_order=0.5)
    np.testing.assert_allclose(parts.difference[0], line(11.0, 0.25, 0.3, angle)[: 2 * PER_REV], atol=1e-12)


def test_without_named_orders_all_of_the_average_is_regular():
    parts = parts_of(np.random.default_rng(2).standard_normal((2, 10 * PER_REV)))
    np.testing.assert_array_equal(parts.regular, parts.average)
    assert not parts.difference.any()


def test_orders_that_no_cycle_repeats_or_no_sample_carries_are_refused():
    signal = np.ones((1, 10 * PER_REV))
    with pytest.raises(RequestError, match=r"order 5\.48.*multiples of 0\.5"):
        parts_of(signal, regular_orders=[5.48])
    with pytest.raises(RequestError, match="do not carry"):
        parts_of(signal, regular_orders=[PER_REV])
    with pytest.raises(RequestError, match=r"order 5\.5.*multiples of 1"):
        parts_of(signal, regular_orders=[5.5], revs_per_cycle=1)


def test_half_orders_survive_the_average_of_a_four_stroke_cycle_and_cancel_in_that_of_one_revolution():
    angle = angles(40)
    half, whole = line(5.5, 1.0, 0.3, angle), line(2.0, 0.5, 1.0, angle)
    four_stroke = parts_of((half + whole)[None])
    np.testing.assert_allclose(four_stroke.average[0], (half + whole)[: 2 * PER_REV], atol=1e-12)
    rotor = parts_of((half + whole)[None], revs_per_cycle=1)
    np.testing.assert_allclose(rotor.average[0], whole[:PER_REV], atol=1e-12)
    np.testing.assert_allclose(rotor.residual[0], half, atol=1e-12)


def test_a_line_that_slips_by_three_per_mille_ends_in_the_residual_with_its_full_energy():
    order, n_cycles = 5.0 * 1.003, 100  # 0.03 turns a cycle: three whole turns of slip
    angle = angles(2 * n_cycles)
    slipping = line(order, 0.8, 0.4, angle)
    parts = parts_of((locked(angle) + slipping)[None])
    np.testing.assert_allclose(parts.average[0], locked(angle[: 2 * PER_REV]), atol=1e-12)
    np.testing.assert_allclose(parts.residual[0], slipping, atol=1e-12)
    assert np.mean(parts.residual**2) == pytest.approx(0.8**2 / 2, rel=1e-12)


@pytest.mark.parametrize("n_cycles", [7, 33, 250])
@pytest.mark.parametrize("order", [5.515, 5.48, 7.02, 3.0, 0.25])
def test_what_the_average_keeps_of_a_line_is_the_response_of_the_comb(order, n_cycles):
    angle = angles(2 * n_cycles)
    parts = parts_of(line(order, 1.0, 0.7, angle)[None])
    # a line between the teeth keeps its own frequency within the cycle, at the amplitude of the comb
    within = angle[: 2 * PER_REV]
    fit = np.stack([np.cos(2 * np.pi * order * within), np.sin(2 * np.pi * order * within)], axis=1)
    found, *_ = np.linalg.lstsq(fit, parts.average[0], rcond=None)
    kept = comb_response(np.array([order]), n_cycles=n_cycles, revs_per_cycle=2)[0]
    assert np.hypot(*found) == pytest.approx(kept, abs=1e-12)
    np.testing.assert_allclose(fit @ found, parts.average[0], atol=1e-12)


def test_the_variance_of_noise_that_does_not_know_the_shaft_falls_as_one_over_the_cycles():
    rng = np.random.default_rng(5)
    for n_cycles in (4, 25, 100):
        noise = rng.standard_normal((200, n_cycles * 2 * PER_REV))
        average, _ = synchronous_average(noise, samples_per_rev=PER_REV, revs_per_cycle=2)
        # 38,400 samples know a variance to 0.7 %
        assert np.mean(average**2) * n_cycles == pytest.approx(1.0, abs=0.03)


@given(gain=st.floats(-1e3, 1e3), other=st.floats(-1e3, 1e3), seed=st.integers(0, 1000))
def test_the_parts_of_a_sum_are_the_sums_of_the_parts(gain, other, seed):
    one, two = np.random.default_rng(seed).standard_normal((2, 1, 9 * PER_REV))
    options = {"regular_orders": [1.0, 5.5], "sidebands": 1}
    mixed, first, second = (parts_of(signal, **options) for signal in (gain * one + other * two, one, two))
    size = max(1.0, abs(gain) + abs(other))
    for name in ("average", "residual", "regular", "difference"):
        expected = gain * getattr(first, name) + other * getattr(second, name)
        np.testing.assert_allclose(getattr(mixed, name), expected, rtol=0, atol=2e-14 * size)


@given(shift=st.integers(0, 2 * PER_REV - 1))
def test_a_shift_of_the_signal_turns_its_average(shift):
    signal = np.random.default_rng(7).standard_normal((1, 12 * PER_REV))
    whole = parts_of(signal).average[0]
    turned = parts_of(np.roll(signal, -shift, axis=1)).average[0]
    np.testing.assert_allclose(turned, np.roll(whole, -shift), rtol=0, atol=1e-14)


@pytest.mark.parametrize("size", [1e-300, 1.0, 1e300])
def test_amplitudes_from_the_least_to_the_largest_come_through(size):
    angle = angles(40)
    parts = parts_of(size * locked(angle)[None], regular_orders=[1.0])
    np.testing.assert_allclose(parts.average[0] / size, locked(angle[: 2 * PER_REV]), atol=1e-12)
    np.testing.assert_allclose(parts.regular[0] / size, line(1.0, 2.0, -1.0, angle)[: 2 * PER_REV], atol=1e-12)


def test_a_cycle_with_an_unusable_sample_takes_no_part_in_its_channel_only():
    angle = angles(40)
    signal = np.tile(locked(angle), (2, 1))
    usable = np.ones(signal.shape, dtype=bool)
    spoilt = 3 * 2 * PER_REV + 5
    signal[0, spoilt], usable[0, spoilt] = 1e9, False
    parts = parts_of(signal, usable=usable)
    assert parts.n_cycles.tolist() == [19, 20]
    np.testing.assert_allclose(parts.average[0], parts.average[1], atol=1e-12)
    assert np.flatnonzero(np.isnan(parts.residual[0])).tolist() == [spoilt]
    assert np.nanmax(np.abs(parts.residual)) < 1e-12


def test_a_channel_without_one_whole_cycle_is_missing_not_zero():
    usable = np.ones((2, 4 * PER_REV), dtype=bool)
    usable[1, :: 2 * PER_REV] = False
    parts = parts_of(np.ones((2, 4 * PER_REV)), usable=usable, regular_orders=[1.0])
    assert parts.n_cycles.tolist() == [2, 0]
    assert np.isnan(parts.average[1]).all()
    assert np.isnan(parts.residual[1]).all()
    short, count = synchronous_average(np.ones((1, PER_REV)), samples_per_rev=PER_REV, revs_per_cycle=2)
    assert count.tolist() == [0]
    assert np.isnan(short).all()


def test_single_precision_in_gives_the_average_of_its_samples_in_double():
    signal = (1e3 + locked(angles(2000))[None]).astype(np.float32)
    both = [parts_of(values).average for values in (signal, signal.astype(np.float64))]
    np.testing.assert_allclose(both[0], both[1], rtol=0, atol=1e-12)
