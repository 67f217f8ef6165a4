"""Laws that hold for every way from samples to orders, and their agreement."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.cycle_average import cycle_average
from crankorder.orders.followed import followed_tracks
from crankorder.orders.frames import order_frames
from crankorder.settings import load_settings
from made.recordings import line, run_up, steady, total

SETTINGS = load_settings().orders
METHODS = ("resample", "nufft")
PARTS = {0.5: (0.4, 0.2), 2.0: (2.0, -2.5), 5.5: (0.3, 1.0), 10.0: (0.7, 3.0)}
SIGNAL = total(*(line(order, *value) for order, value in PARTS.items()))
TRUTH = np.array([a * np.exp(1j * p) for a, p in PARTS.values()])


def asked(**changes):
    return SETTINGS.model_copy(update=changes)


def noisy(seed=0, n_channels=1):
    band, angle = steady([SIGNAL] * n_channels, speed_rpm=1487.0, duration_s=8.0, rate_hz=2000.0)
    band["signal"].values[:] += np.random.default_rng(seed).normal(0.0, 1.0, band["signal"].shape)
    return band, angle


def spectrum(band, angle, method):
    return order_frames(band, angle, settings=asked(method=method))["spectrum"].values


@pytest.mark.parametrize("recording", ["steady", "run-up"])
def test_all_methods_agree_within_their_stated_errors(recording):
    if recording == "steady":
        band, angle = steady([SIGNAL], speed_rpm=1487.0, duration_s=20.0, rate_hz=2000.0)
    else:
        band, angle = run_up([SIGNAL], from_rpm=1200, to_rpm=2400, duration_s=20.0, rate_hz=2000.0)
    for method in METHODS:
        frames = order_frames(band, angle, settings=asked(method=method))
        found = frames["spectrum"].sel(order=list(PARTS)).values[0, 1:-1]
        stated = frames.attrs["predicted_error"]
        assert np.abs(found - TRUTH).max() < 2.0 * stated  # of the largest amplitude, which is 2
    settings = asked(track_orders=tuple(PARTS), track_method="vold_kalman", track_bandwidth=0.05)
    filtered = followed_tracks(band, angle, settings=settings)["amplitude"].values[0].T
    # at the ends of a run-up a filter has one side only
    np.testing.assert_allclose(filtered, np.broadcast_to(TRUTH, filtered.shape), atol=1e-6)


def test_the_mean_cycle_holds_the_same_orders():
    band, angle = steady([SIGNAL], speed_rpm=1487.0, duration_s=20.0, rate_hz=2000.0)
    made = cycle_average(band, angle, settings=SETTINGS)
    cycle = made["mean"].values.reshape(-1, made.sizes["cycle_angle"])[0]
    turns = made["cycle_angle"].values / (360.0 if made["cycle_angle"].attrs["units"] == "degree" else 1.0)
    for order, value in zip(PARTS, TRUTH, strict=True):
        found = 2.0 * np.mean(cycle * np.exp(-2j * np.pi * order * turns))
        assert abs(found - value) < 2e-6, order


def test_linear():
    for method in METHODS:
        (a, angle), (b, _) = noisy(1), noisy(2)
        both = a.copy(data={**a.data_vars, "signal": 2.0 * a["signal"] - 3.0 * b["signal"]})
        expected = 2.0 * spectrum(a, angle, method) - 3.0 * spectrum(b, angle, method)
        np.testing.assert_allclose(spectrum(both, angle, method), expected, atol=1e-9)


def test_twice_the_signal_is_twice_the_amplitude_to_the_last_bit():
    for method in METHODS:
        band, angle = noisy()
        twice = band.copy(data={**band.data_vars, "signal": 2.0 * band["signal"]})
        np.testing.assert_array_equal(spectrum(twice, angle, method), 2.0 * spectrum(band, angle, method))


def test_channels_do_not_touch_each_other():
    for method in METHODS:
        band, angle = noisy(n_channels=3)
        together = spectrum(band, angle, method)
        for k in range(3):
            alone = spectrum(band.isel(channel=[k]), angle, method)
            np.testing.assert_allclose(together[k : k + 1], alone, atol=1e-9)


def test_a_turned_shaft_turns_every_phase_and_nothing_else():
    for method in METHODS:
        band, angle = noisy()
        turned = angle.copy(deep=True)
        turned["crank_angle"].values[:] += 0.375
        frames = order_frames(band, angle, settings=asked(method=method))
        expected = frames["spectrum"].values * np.exp(-2j * np.pi * 0.375 * frames["order"].values)
        np.testing.assert_allclose(spectrum(band, turned, method), expected, atol=1e-9)


def test_the_energy_of_frames_is_that_of_the_signal():
    """Parseval: noise below the highest order, half of the sum of squared bins over the noise bandwidth."""
    band, angle = steady([SIGNAL], speed_rpm=1500.0, duration_s=60.0, rate_hz=1000.0)
    frames = order_frames(band, angle, settings=asked(max_order=18.0))
    power = (np.abs(frames["spectrum"].values[0]) ** 2).sum(axis=1).mean() / (2.0 * frames.attrs["enbw_bins"])
    assert power == pytest.approx(sum(a**2 for a, _ in PARTS.values()) / 2.0, rel=1e-6)


def test_both_precisions_agree():
    for method in METHODS:
        band, angle = noisy()
        single = band.copy(data={**band.data_vars, "signal": band["signal"].astype(np.float32)})
        difference = np.abs(spectrum(single, angle, method) - spectrum(band, angle, method)).max()
        assert difference < 1e-6 * np.abs(band["signal"].values).max()
