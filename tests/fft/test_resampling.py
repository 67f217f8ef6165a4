"""Values between samples: laws, error against analytic tones, both precisions, bad input."""

from itertools import product

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.fft.resampling import LENGTHS, cheapest_kernel, kernel_of, margin, shifted, values_at

SHORT_KERNELS = (8, 10, 16, 48)
N_SAMPLES = 700


def tones(frequency, at, dtype="f8"):
    angle = 2.0 * np.pi * frequency * at + 0.7
    return np.stack([np.cos(angle), np.sin(angle)]).astype(dtype)


def places(n_samples, edge, count=3000, seed=5):
    return np.random.default_rng(seed).uniform(edge, n_samples - 1 - edge, count)


def noise(channels, seed=6):
    return np.random.default_rng(seed).standard_normal((channels, N_SAMPLES))


@pytest.mark.parametrize(("delay", "dtype", "within"), [(0.434, "f4", 3e-6), (3.0, "f8", 1e-7), (-7.25, "f8", 1e-7)])
def test_a_shifted_signal_is_the_signal_at_earlier_samples_and_nan_where_it_has_no_neighbours(delay, dtype, within):
    at = np.arange(400.0)
    given = tones(0.37, at, dtype)[0]
    given[200] = np.nan
    out = shifted(given, delay)
    known = np.isfinite(out)
    assert out.dtype == given.dtype
    assert np.abs(out - tones(0.37, at - delay)[0])[known].max() < within
    reach = 0 if delay == round(delay) else margin()
    sure = (at - delay >= reach) & (at - delay <= 399 - reach) & (np.abs(at - delay - 200) > reach)
    assert sure.any() and known[sure].all()
    assert np.isnan(shifted(given[:9], 0.5)).all()


def test_on_the_samples_the_samples_come_back_and_a_constant_is_passed_to_the_last_bits():
    inside = np.arange(60, N_SAMPLES - 60)
    for taps, dtype in product(SHORT_KERNELS, ("f4", "f8")):
        kernel, signals = kernel_of(taps, pass_band=0.3, double=dtype == "f8"), noise(2).astype(dtype)
        np.testing.assert_array_equal(values_at(signals, inside.astype(float), kernel=kernel), signals[:, inside])
        values = values_at(np.full((2, 200), 3.0, dtype), places(200, kernel.margin), kernel=kernel)
        assert np.abs(values / 3.0 - 1.0).max() < 4.0 * np.finfo(dtype).eps, taps


@pytest.mark.cases(2)
@pytest.mark.parametrize("taps", SHORT_KERNELS)
def test_values_are_linear_in_the_signals_and_move_and_turn_with_them(taps):
    kernel = kernel_of(taps, pass_band=0.2)
    a, b, at = noise(1, seed=1), noise(1, seed=2), places(N_SAMPLES, kernel.margin)
    both = values_at(3.0 * a - 0.25 * b, at, kernel=kernel)
    apart = 3.0 * values_at(a, at, kernel=kernel) - 0.25 * values_at(b, at, kernel=kernel)
    np.testing.assert_allclose(both, apart, rtol=0, atol=2e-14)
    np.testing.assert_array_equal(values_at(2.0 * a, at, kernel=kernel), 2.0 * values_at(a, at, kernel=kernel))
    # fractions that survive the addition of 37 without rounding
    at = np.floor(places(N_SAMPLES - 37, kernel.margin) * 1024) / 1024
    shifted = values_at(a[:, 37:], at, kernel=kernel)
    np.testing.assert_allclose(shifted, values_at(a, at + 37.0, kernel=kernel), rtol=0, atol=1e-14)
    backwards = values_at(a[:, ::-1], N_SAMPLES - 1 - at, kernel=kernel)
    # the cubics of a table do not lie symmetrically to the last bits, nor do the sums
    np.testing.assert_allclose(backwards, values_at(a, at, kernel=kernel), rtol=0, atol=1e-12)


def test_a_channel_has_the_same_values_alone_and_among_others():
    for dtype, channels in product(("f4", "f8"), (2, 3, 5)):
        kernel, signals = kernel_of(24, pass_band=0.3, double=dtype == "f8"), noise(channels).astype(dtype)
        at = places(N_SAMPLES, kernel.margin)
        values = values_at(signals, at, kernel=kernel)
        assert values.dtype == signals.dtype
        for channel in range(channels):
            alone = values_at(signals[channel : channel + 1], at, kernel=kernel)
            np.testing.assert_array_equal(values[channel], alone[0])


def test_far_amplitudes_survive_and_a_constant_a_million_times_the_signal_costs_only_its_own_rounding():
    for taps in SHORT_KERNELS:
        kernel = kernel_of(taps, pass_band=0.1)
        at = places(N_SAMPLES, kernel.margin)
        signals = tones(0.1, np.arange(float(N_SAMPLES)))
        for scale in (1e-300, 1.0, 1e300):
            values = values_at(scale * signals, at, kernel=kernel)
            assert np.abs(values / scale - tones(0.1, at)).max() < kernel.predicted_error + 1e-13
        values = values_at(1e6 + signals, at, kernel=kernel) - 1e6
        assert np.abs(values - tones(0.1, at)).max() < kernel.predicted_error + 8.0 * np.spacing(1e6)


def test_the_margin_is_enough_and_what_lies_further_out_is_refused():
    for taps in SHORT_KERNELS:
        kernel = kernel_of(taps, pass_band=0.2)
        last = N_SAMPLES - 1
        ends = np.array([kernel.margin, last - kernel.margin], dtype=float)
        expected = tones(0.1, ends)
        values = values_at(tones(0.1, np.arange(float(N_SAMPLES))), ends, kernel=kernel)
        assert np.abs(values - expected).max() < 1.1 * kernel.predicted_error
        for outside in (kernel.margin - 3.0, last - kernel.margin + 3.0):
            with pytest.raises(RequestError, match=r"positions must lie in .* at number 1"):
                values_at(noise(1), np.array([300.0, outside]), kernel=kernel)


def test_what_cannot_be_is_refused_and_no_position_is_no_fault():
    for position in (3.0, 296.0, -1.0, -0.0, np.nan, np.inf, -np.inf, 1e300):
        with pytest.raises(ValueError, match="positions must lie in"):
            values_at(np.zeros((1, 300)), np.array([position]))
    for shape, positions, words in (
        ((1, 20), [10.0], "too short"), ((300,), [150.0], "channels, samples"),
        ((1, 300), [[150.0]], "positions are one row"),
    ):  # fmt: skip
        with pytest.raises(RequestError, match=words):
            values_at(np.zeros(shape), np.array(positions))
    assert values_at(np.zeros((3, 20)), np.empty(0)).shape == (3, 0)
    assert values_at(np.zeros((0, 100)), np.array([50.0])).shape == (0, 1)


def test_any_memory_layout_and_order_of_positions_gives_the_same_values():
    signals, at = noise(3), places(N_SAMPLES, margin())
    expected = values_at(signals, at)
    np.testing.assert_array_equal(values_at(signals, at[::-1])[:, ::-1], expected)
    wide = np.zeros((6, N_SAMPLES + 9))
    wide[1::2, 4:-5] = signals
    frozen = signals.copy()
    frozen.flags.writeable = False
    swapped = signals.astype(">f8")
    for same in (np.asfortranarray(signals), wide[1::2, 4:-5], frozen, swapped, wide[5::-2, 4:-5][::-1]):
        np.testing.assert_array_equal(values_at(same, at), expected)
    np.testing.assert_array_equal(values_at(np.broadcast_to(signals[:1], (3, N_SAMPLES)), at)[2], expected[0])
    whole = np.arange(300).reshape(1, 300)
    np.testing.assert_allclose(values_at(whole, np.array([150.5])), 150.5, rtol=1e-6)


@pytest.mark.parametrize("taps", LENGTHS)
def test_the_gain_beyond_the_pass_band_never_makes_noise_stronger(taps):
    kernel = kernel_of(taps, pass_band=0.1)
    size = 4000
    at = places(size, kernel.margin, 4000)
    white = np.random.default_rng(8).standard_normal((1, size))
    assert values_at(white, at, kernel=kernel).std() < 1.05


# Stated errors of kernels are the errors measured, and the shortest that meets a tolerance is found.


POSITION_ROUNDING = 1e-12
"""A position near 500 is rounded to 6e-14, which turns a tone at 0.4 of the rate by 1.5e-13."""


def measured_error(kernel, content):
    """Worst error of unit tones up to ``content`` at random places."""
    samples, worst = np.arange(2.0 * kernel.margin + 200.0), 0.0
    generator = np.random.default_rng(11)
    for share in (1.0, 0.995, 0.97, 0.9, 0.75, 0.5, 0.1, 0.0):
        at = generator.uniform(kernel.margin, len(samples) - 1 - kernel.margin, 4000)
        turn, phase = 2.0 * np.pi * share * content, generator.uniform(0.0, 2.0 * np.pi)
        signals = np.stack([np.cos(turn * samples + phase), np.sin(turn * samples + phase)])
        values = values_at(signals.astype("f8" if kernel.double else "f4"), at, kernel=kernel).astype("f8")
        worst = max(worst, float(np.abs(values[0] + 1j * values[1] - np.exp(1j * (turn * at + phase))).max()))
    return worst


@pytest.mark.parametrize(
    ("taps", "content", "double"), [(8, 0.02, True), (16, 0.4, False), (32, 0.2, True), (48, 0.49, True)]
)
def test_the_error_of_every_kernel_is_predicted(taps, content, double):
    kernel = kernel_of(taps, pass_band=content, double=double)
    measured = measured_error(kernel, content)
    assert measured <= kernel.predicted_error + (POSITION_ROUNDING if double else 0.0)
    assert kernel.predicted_error <= 5.0 * measured


def test_what_is_asked_for_is_met_and_no_shorter_kernel_meets_it():
    for tolerance, content in product((1e-2, 1e-5, 1e-9), (0.05, 0.2, 0.4)):
        kernel = cheapest_kernel(tolerance, content=content)
        assert kernel.pass_band == content and kernel.double
        assert kernel.predicted_error <= tolerance
        for taps in LENGTHS[: LENGTHS.index(kernel.taps)]:
            assert kernel_of(taps, pass_band=content).predicted_error > tolerance
    with pytest.raises(RequestError, match="float64"):
        cheapest_kernel(1e-7, content=0.2, double=False)


def test_what_no_kernel_reaches_is_refused_with_what_is_reached():
    for tolerance, content in ((1e-9, 0.495), (1e-17, 0.05)):
        with pytest.raises(RequestError) as refused:
            cheapest_kernel(tolerance, content=content)
        reached = float(refused.value.allowed.removeprefix("at least "))
        assert cheapest_kernel(1.06 * reached, content=content).predicted_error <= 1.06 * reached


def test_content_that_no_sampling_carries_and_a_tolerance_that_is_no_error_are_refused():
    for content in (0.0, 0.5, -0.1, np.nan, np.inf):
        for make in (lambda share: cheapest_kernel(1e-3, content=share), lambda share: kernel_of(8, pass_band=share)):
            with pytest.raises(RequestError, match="share of the sample rate"):
                make(content)
    for tolerance in (0.0, -1e-6, np.nan):
        with pytest.raises(RequestError, match="above 0"):
            cheapest_kernel(tolerance, content=0.1)
