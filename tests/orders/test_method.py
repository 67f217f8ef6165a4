"""The choice of a method by the accuracy asked for, and whether it is reached."""

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.fft.decimation import band_limited
from crankorder.orders.followed import followed_tracks
from crankorder.orders.frames import order_frames
from crankorder.orders.method import frame_layout, time_samples
from crankorder.orders.spectra import spectra
from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from made.recordings import line, run_up, shaft, steady, total

SETTINGS = load_settings().orders
PARTS = {0.5: (0.1, 0.2), 1.0: (2.0, -2.5), 5.5: (0.03, 1.0), 10.0: (0.7, 3.0), 19.5: (1.5, 0.4)}
SIGNAL = total(*(line(order, *value) for order, value in PARTS.items()))


def asked(**changes):
    return SETTINGS.model_copy(update=changes)


def worst_error(frames):
    """Largest complex error of a known order, as a share of the largest amplitude."""
    found = [frames["spectrum"].sel(order=order).values - a * np.exp(1j * p) for order, (a, p) in PARTS.items()]
    return float(np.abs(found).max()) / max(a for a, _ in PARTS.values())


@pytest.mark.parametrize("method", ["auto", "resample", "nufft"])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12])
def test_the_tolerance_asked_for_is_met(method, tolerance):
    recording = run_up([SIGNAL], from_rpm=1200, to_rpm=1500, duration_s=6.0, rate_hz=2000.0)
    frames = order_frames(*recording, settings=asked(method=method, tolerance=tolerance))
    # the neighbours that the ends of a recording lack are those of the first and the last frame
    inner = frames.isel(frame=slice(1, -1)) if method == "nufft" else frames
    angle_rounding = 2.0 * np.pi * 19.5 * np.spacing(float(recording[1]["crank_angle"].values[-1]))
    assert worst_error(inner) < max(tolerance, angle_rounding)


@pytest.mark.cases(1)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_predicted_and_achieved_error_stand_beside_the_choice(tolerance):
    frames = order_frames(
        *steady([SIGNAL], speed_rpm=1487.0, duration_s=6.0, rate_hz=2000.0), settings=asked(tolerance=tolerance)
    )
    assert frames.attrs["tolerance"] == tolerance
    assert frames.attrs["method"].startswith("resample (")
    assert 0.0 < frames.attrs["achieved_error"] <= frames.attrs["predicted_error"] <= tolerance
    assert worst_error(frames) < frames.attrs["predicted_error"]


def test_single_precision_samples_are_widened_where_the_tolerance_asks_for_more():
    band, angle = steady([SIGNAL], speed_rpm=1487.0, duration_s=6.0, rate_hz=2000.0)
    band["signal"] = band["signal"].astype(np.float32)
    loose, tight = (order_frames(band, angle, settings=asked(tolerance=t)) for t in (1e-4, 1e-9))
    assert worst_error(loose) < 1e-4
    # what is left is the rounding of the samples themselves
    assert worst_error(tight) < 1e-8
    assert tight.attrs["achieved_error"] < 1e-9


def test_a_method_that_cannot_do_what_is_asked_is_refused():
    band, angle = steady([SIGNAL], speed_rpm=1487.0, duration_s=6.0, rate_hz=2000.0)
    frames = order_frames(band, angle, settings=asked(method="resample", tolerance=1e-12))
    assert not [flag for flag in flags_of(frames) if flag["severity"] != "info"]
    with pytest.raises(RequestError, match="no interpolation kernel is as accurate as asked"):
        order_frames(band, angle, settings=SETTINGS.model_construct(**dict(asked(method="resample"), tolerance=1e-17)))


def test_frames_that_touch_a_gap_are_missing_and_others_are_untouched():
    for method in ("resample", "nufft"):
        band, angle = steady([SIGNAL, SIGNAL], speed_rpm=1500.0, duration_s=10.0, rate_hz=2000.0)
        whole = order_frames(band, angle, settings=asked(method=method))
        usable = np.ones(band["signal"].shape, dtype=bool)
        usable[1, 9000:9100] = False
        band["usable"] = (band["signal"].dims, usable, {"units": "1"})
        band["signal"].values[1, 9000:9100] = 1e6
        frames = order_frames(band, angle, settings=asked(method=method))
        missing = np.isnan(frames["spectrum"].values).all(axis=2)
        assert not missing[0].any()
        assert 2 <= missing[1].sum() <= 3
        kept = ~missing[1]
        np.testing.assert_allclose(
            frames["spectrum"].values[1, kept], whole["spectrum"].values[1, kept], atol=1e-6, rtol=0
        )
        np.testing.assert_allclose(frames["spectrum"].values[0], whole["spectrum"].values[0], atol=1e-12, rtol=0)


def test_a_long_run_up_is_done_in_pieces_that_leave_no_seam(monkeypatch):
    recording = run_up([SIGNAL], from_rpm=400, to_rpm=4000, duration_s=12.0, rate_hz=4000.0)
    whole = order_frames(*recording, settings=SETTINGS)
    monkeypatch.setattr("crankorder.orders.spectra.CHUNK_SAMPLES", 1 << 12)
    pieces = order_frames(*recording, settings=SETTINGS)
    assert worst_error(whole) < 1e-6
    np.testing.assert_allclose(pieces["spectrum"].values, whole["spectrum"].values, atol=5e-7, rtol=0)


@pytest.mark.cases(2)
@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize(("share", "tolerance", "mark"), [(0.05, SETTINGS.tolerance, 1e-6), (0.4, 1e-5, 1e-5)])
def test_from_full_rate_samples_to_orders_the_error_is_within_the_mark(share, tolerance, mark, dtype):
    """Content up to 5 % of the sample rate to 1 ppm by default, up to 40 % to 1e-5 when asked: low-pass and all."""
    top = share * 50000.0 * 60.0 / 1500.0
    orders = {1.0: 0.5, 5.5: 0.3, top / 2: 0.7, top: 1.0}
    band, angle = steady(
        [total(*(line(order, value, 0.3 * order) for order, value in orders.items()))],
        speed_rpm=1500.0,
        duration_s=4.0,
        rate_hz=50000.0,
    )
    band["signal"] = band["signal"].astype(dtype)
    limited = band_limited(band, band_hz=share * 50000.0, grid_hz=0.5, tolerance=0.5 * tolerance)
    frames = order_frames(limited, angle, settings=asked(tolerance=tolerance, max_order=top))
    for order, value in orders.items():
        found = frames["spectrum"].sel(order=order).values
        assert np.abs(found - value * np.exp(0.3j * order)).max() < mark, order


@pytest.mark.cases(2)
@pytest.mark.parametrize(("scatter_rev", "denser"), [(0.0, False), (1e-7, False), (1e-5, True)])
def test_an_angle_that_scatters_from_tooth_to_tooth_is_sampled_more_densely(scatter_rev, denser):
    band, _ = steady([SIGNAL], speed_rpm=1800.0, duration_s=8.0, rate_hz=2000.0)
    angle = np.arange(240 * 60 + 1) / 60.0 - 0.3
    time = (angle + 0.3) / 30.0 + np.random.default_rng(2).normal(0.0, scatter_rev / 30.0, len(angle))
    time[[0, -1]] = 0.0, 8.0
    scattered = shaft(time, angle, 60.0 * np.gradient(angle, time))
    frames = order_frames(band, scattered, settings=SETTINGS)
    assert ("as dense" in frames.attrs["method"]) == denser
    assert frames.attrs["achieved_error"] <= SETTINGS.tolerance
    layout = frame_layout(band, scattered, settings=asked(tolerance=1e-11))
    samples = time_samples(band, tolerance=1e-11)
    truth = spectra(samples, scattered, layout, n_orders=321, max_order=20.0, density=16)
    # the kernels are of different lengths, and so the frames begin a few samples apart: the same orders, other noise
    found, expected = (
        np.abs(item[0, 1:-1, [8, 16, 88, 160, 312]]).mean(axis=1) for item in (frames["spectrum"].values, truth)
    )
    np.testing.assert_allclose(found, expected, atol=2.0 * (SETTINGS.tolerance + scatter_rev))


# Laws that hold for every way from samples to orders, and their agreement.


METHODS = ("resample", "nufft")
LOCKED = {0.5: (0.4, 0.2), 2.0: (2.0, -2.5), 5.5: (0.3, 1.0), 10.0: (0.7, 3.0)}
LOCKED_SIGNAL = total(*(line(order, *value) for order, value in LOCKED.items()))
TRUTH = np.array([a * np.exp(1j * p) for a, p in LOCKED.values()])


def noisy(seed=0, n_channels=1):
    band, angle = steady([LOCKED_SIGNAL] * n_channels, speed_rpm=1487.0, duration_s=8.0, rate_hz=2000.0)
    band["signal"].values[:] += np.random.default_rng(seed).normal(0.0, 1.0, band["signal"].shape)
    return band, angle


def spectrum(band, angle, method):
    return order_frames(band, angle, settings=asked(method=method))["spectrum"].values


@pytest.mark.parametrize("recording", ["steady", "run-up"])
def test_all_methods_agree_within_their_stated_errors(recording):
    if recording == "steady":
        band, angle = steady([LOCKED_SIGNAL], speed_rpm=1487.0, duration_s=20.0, rate_hz=2000.0)
    else:
        band, angle = run_up([LOCKED_SIGNAL], from_rpm=1200, to_rpm=2400, duration_s=20.0, rate_hz=2000.0)
    for method in METHODS:
        frames = order_frames(band, angle, settings=asked(method=method))
        found = frames["spectrum"].sel(order=list(LOCKED)).values[0, 1:-1]
        stated = frames.attrs["predicted_error"]
        assert np.abs(found - TRUTH).max() < 2.0 * stated  # of the largest amplitude, which is 2
    settings = asked(track_orders=tuple(LOCKED), track_method="vold_kalman", track_bandwidth=0.05)
    filtered = followed_tracks(band, angle, settings=settings)["amplitude"].values[0].T
    # at the ends of a run-up a filter has one side only
    np.testing.assert_allclose(filtered, np.broadcast_to(TRUTH, filtered.shape), atol=1e-6)


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
    band, angle = steady([LOCKED_SIGNAL], speed_rpm=1500.0, duration_s=60.0, rate_hz=1000.0)
    frames = order_frames(band, angle, settings=asked(max_order=18.0))
    power = (np.abs(frames["spectrum"].values[0]) ** 2).sum(axis=1).mean() / (2.0 * frames.attrs["enbw_bins"])
    assert power == pytest.approx(sum(a**2 for a, _ in LOCKED.values()) / 2.0, rel=1e-6)
