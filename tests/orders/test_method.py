"""The choice of a method by the accuracy asked for, and whether it is reached."""

import math
from itertools import product

import numpy as np
import pytest

from crankorder.errors import InputError, RequestError
from crankorder.fft.decimation import band_limited
from crankorder.orders.frames import order_frames, spectra
from crankorder.orders.method import frame_layout, time_samples
from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.decode import shaft_angle
from made.recordings import line, run_up, sampled, shaft, steady, total

SETTINGS = load_settings().orders
PARTS = {0.5: (0.1, 0.2), 1.0: (2.0, -2.5), 5.5: (0.03, 1.0), 10.0: (0.7, 3.0), 19.5: (1.5, 0.4)}
SIGNAL = total(*(line(order, *value) for order, value in PARTS.items()))


def asked(**changes):
    return SETTINGS.model_copy(update=changes)


def worst_error(frames):
    """Largest complex error of a known order, as a share of the largest amplitude."""
    found = [frames["spectrum"].sel(order=order).values - a * np.exp(1j * p) for order, (a, p) in PARTS.items()]
    return float(np.abs(found).max()) / max(a for a, _ in PARTS.values())


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6, 1e-12])
def test_the_tolerance_asked_for_is_met(tolerance):
    recording = run_up([SIGNAL], from_rpm=1200, to_rpm=1500, duration_s=6.0, rate_hz=2000.0)
    frames = order_frames(*recording, settings=asked(tolerance=tolerance))
    angle_rounding = 2.0 * np.pi * 19.5 * np.spacing(float(recording[1]["crank_angle"].values[-1]))
    assert worst_error(frames) < max(tolerance, angle_rounding)


def test_predicted_and_achieved_error_stand_beside_the_choice():
    frames = order_frames(
        *steady([SIGNAL], speed_rpm=1487.0, duration_s=6.0, rate_hz=2000.0), settings=asked(tolerance=1e-3)
    )
    assert frames.attrs["tolerance"] == 1e-3
    assert frames.attrs["method"].startswith("resample (")
    assert 0.0 < frames.attrs["achieved_error"] <= frames.attrs["predicted_error"] <= 1e-3
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
    frames = order_frames(band, angle, settings=asked(tolerance=1e-12))
    assert not [flag for flag in flags_of(frames) if flag["severity"] != "info"]
    with pytest.raises(RequestError, match="no interpolation kernel is as accurate as asked"):
        order_frames(band, angle, settings=SETTINGS.model_construct(**dict(SETTINGS, tolerance=1e-17)))


def test_frames_that_touch_a_gap_are_missing_and_others_are_untouched():
    band, angle = steady([SIGNAL, SIGNAL], speed_rpm=1500.0, duration_s=10.0, rate_hz=2000.0)
    whole = order_frames(band, angle, settings=SETTINGS)["spectrum"].values
    usable = np.ones(band["signal"].shape, dtype=bool)
    usable[1, 9000:9100] = False
    band["usable"] = (band["signal"].dims, usable, {"units": "1"})
    band["signal"].values[1, 9000:9100] = 1e6
    found = order_frames(band, angle, settings=SETTINGS)["spectrum"].values
    missing = np.isnan(found).all(axis=2)
    assert not missing[0].any()
    assert 2 <= missing[1].sum() <= 3
    np.testing.assert_allclose(found[~missing], whole[~missing], atol=1e-6, rtol=0)


def test_a_long_run_up_is_done_in_pieces_that_leave_no_seam(monkeypatch):
    recording = run_up([SIGNAL], from_rpm=400, to_rpm=4000, duration_s=12.0, rate_hz=4000.0)
    whole = order_frames(*recording, settings=SETTINGS)
    monkeypatch.setattr("crankorder.orders.frames.CHUNK_SAMPLES", 1 << 12)
    pieces = order_frames(*recording, settings=SETTINGS)
    assert worst_error(whole) < 1e-6
    np.testing.assert_allclose(pieces["spectrum"].values, whole["spectrum"].values, atol=5e-7, rtol=0)


@pytest.mark.parametrize(
    ("share", "tolerance", "mark", "dtype"), [(0.05, SETTINGS.tolerance, 1e-6, "f4"), (0.4, 1e-5, 1e-5, "f8")]
)
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


@pytest.mark.parametrize(("scatter_rev", "denser"), [(1e-7, False), (1e-5, True)])
def test_an_angle_that_scatters_from_tooth_to_tooth_is_sampled_more_densely(scatter_rev, denser):
    band, _ = steady([SIGNAL], speed_rpm=1800.0, duration_s=8.0, rate_hz=2000.0)
    angle = np.arange(240 * 60 + 1) / 60.0 - 0.3
    time = (angle + 0.3) / 30.0 + np.random.default_rng(2).normal(0.0, scatter_rev / 30.0, len(angle))
    time[[0, -1]] = 0.0, 8.0
    scattered = shaft(time, angle, 60.0 * np.gradient(angle, time))
    frames = order_frames(band, scattered, settings=SETTINGS)
    assert ("as dense" in frames.attrs["method"]) == denser
    assert frames.attrs["achieved_error"] <= SETTINGS.tolerance
    layout = frame_layout(band, scattered, settings=asked(tolerance=1e-11))._replace(max_order=20.0)
    samples = time_samples(band, tolerance=1e-11)
    truth = spectra(samples, scattered, layout, density=16)
    # the kernels are of different lengths, and so the frames begin a few samples apart: the same orders, other noise
    found, expected = (
        np.abs(item[0, 1:-1, [8, 16, 88, 160, 312]]).mean(axis=1) for item in (frames["spectrum"].values, truth)
    )
    np.testing.assert_allclose(found, expected, atol=2.0 * (SETTINGS.tolerance + scatter_rev))


# Laws that hold on the way from samples to orders.


def test_a_turned_shaft_turns_every_phase_and_nothing_else():
    band, angle = steady([SIGNAL], speed_rpm=1487.0, duration_s=8.0, rate_hz=2000.0)
    band["signal"].values[:] += np.random.default_rng(0).normal(0.0, 1.0, band["signal"].shape)
    turned = angle.copy(deep=True)
    turned["crank_angle"].values[:] += 0.375
    frames, found = (order_frames(band, each, settings=SETTINGS) for each in (angle, turned))
    expected = frames["spectrum"].values * np.exp(-2j * np.pi * 0.375 * frames["order"].values)
    np.testing.assert_allclose(found["spectrum"].values, expected, atol=1e-9)


def test_the_energy_of_frames_is_that_of_the_signal():
    """Parseval: noise below the highest order, half of the sum of squared bins over the noise bandwidth."""
    band, angle = steady([SIGNAL], speed_rpm=1500.0, duration_s=60.0, rate_hz=2000.0)
    frames = order_frames(band, angle, settings=asked(max_order=24.0))
    power = (np.abs(frames["spectrum"].values[0]) ** 2).sum(axis=1).mean() / (2.0 * frames.attrs["enbw_bins"])
    assert power == pytest.approx(sum(a**2 for a, _ in PARTS.values()) / 2.0, rel=1e-6)


@pytest.mark.parametrize(("to_rpm", "told"), [(1050.0, False), (9000.0, True)])
def test_frames_within_which_the_speed_changes_much_are_told(to_rpm, told):
    recording = run_up([line(4.0, 1.0)], from_rpm=1000, to_rpm=to_rpm, duration_s=10.0, rate_hz=5000.0)
    frames = order_frames(*recording, settings=SETTINGS)
    assert ("frames_swept" in {flag["flag"] for flag in flags_of(frames)}) == told
    # v² grows by 2 a per revolution: from the first to the last revolution of a frame at constant acceleration a
    revs = frames.attrs["revs_per_frame"]
    assert (revs < SETTINGS.revs_per_frame) == told
    rate = (to_rpm / 1000.0 - 1.0) * 1000.0 / 60.0 / 10.0
    slowest = 1000.0 / 60.0
    grown = np.sqrt(slowest**2 + 2.0 * rate * (revs - 0.5)) - np.sqrt(slowest**2 + 2.0 * rate * 0.5)
    mean = revs / ((np.sqrt(slowest**2 + 2.0 * rate * revs) - slowest) / rate)
    assert frames.attrs["largest_sweep"] == pytest.approx(grown / mean, rel=0.02)


def test_the_speed_of_a_frame_is_that_in_its_middle():
    band, angle = run_up([line(1.0, 1.0)], from_rpm=600, to_rpm=1200, duration_s=20.0, rate_hz=2000.0)
    frames = order_frames(band, angle, settings=SETTINGS)
    start = frames["crank_angle"].values
    middle = start + 0.5 * frames.attrs["revs_per_frame"]
    # speed grows by 30 rpm a second: v^2 = 10^2 + 2 * 0.5 * angle in revolutions and seconds
    np.testing.assert_allclose(frames["speed"].values, 60.0 * np.sqrt(100.0 + middle), rtol=1e-8)


@pytest.mark.parametrize(("share_of_rate", "speed_rpm"), [(0.499, 300.0), (0.42, 1487.0), (0.3, 2000.0)])
def test_content_above_the_orders_does_not_fold_onto_them(share_of_rate, speed_rpm):
    tone = share_of_rate * 1785.0 * 60.0 / speed_rpm
    signal = total(line(1.0, 1.0), lambda t, _: np.cos(2 * np.pi * share_of_rate * 1785.0 * t))
    frames = order_frames(*steady([signal], speed_rpm=speed_rpm, duration_s=8.0, rate_hz=1785.0), settings=SETTINGS)
    order = frames["order"]
    others = frames["spectrum"].where((abs(order - 1.0) > 0.2) & (abs(order - tone) > 4.0))
    assert np.nanmax(np.abs(others.values)) < 2e-5


def test_any_number_of_revolutions_is_analysed():
    """Frame lengths with large prime factors, such as 7 or 11 revolutions, are as good as others."""
    for revolutions in range(1, 31):
        band, angle = steady([line(2, 1)], speed_rpm=600.0, duration_s=(revolutions + 0.1) / 10, rate_hz=2000.0)
        for cycle in (1, 2):
            angle.attrs["revs_per_cycle"] = cycle
            if revolutions < cycle:
                with pytest.raises(InputError):
                    order_frames(band, angle, settings=SETTINGS)
                continue
            frames = order_frames(band, angle, settings=SETTINGS)
            assert frames.attrs["revs_per_frame"] == min(revolutions, 16) // cycle * cycle
            assert [flag["flag"] for flag in flags_of(frames)] == ["short_recording"] * (revolutions < 16)
            if frames.attrs["revs_per_frame"] > 1:
                np.testing.assert_allclose(np.abs(frames["spectrum"].sel(order=2.0).values), 1.0, atol=1e-6)


@pytest.mark.parametrize(("encoder", "rise"), [("speed", 1.5), ("square", 0.0)])
def test_a_record_of_whole_turns_is_read_to_its_last_sample(encoder, rise):
    """Of order 1, whole turns and a sample less or more long; the speed rises by a share ``rise``."""
    for turns, more in product((2, 3, 9, 16, 17, 31, 64, 65), (-1, 0, 1)):
        count = round(turns / 17.3 / (1.0 + 0.5 * rise) * 1000.0)
        time_s = np.arange(count + 1 + more) / 1000.0
        first_hz, share = 1000.0 * turns / count / (1.0 + 0.5 * rise), 1000.0 * time_s / count
        angle = first_hz * time_s * (1.0 + 0.5 * rise * share)
        attrs = {"encoder_kind": encoder, "rate_hz": 1000.0, "revs_per_cycle": 1, "missing_teeth": 0, "ratio": 1.0}
        band = sampled(np.cos(2 * np.pi * angle)[None], pulses_per_rev=60, **attrs)
        edges = np.interp(np.arange(math.floor(angle[-1] * 60.0 + 1e-9) + 1) / 60.0, angle, time_s)
        speed = ("time", 60.0 * first_hz * (1.0 + rise * share), {"units": "min-1"})
        told = {"speed_signal": speed} if encoder == "speed" else {"pulse_time": ("pulse", edges, {"units": "s"})}
        angles = shaft_angle(band.assign(told), settings=load_settings().shaft)
        frames = order_frames(band, angles, settings=asked(max_order=4.0))
        assert frames.attrs["revs_per_frame"] + frames["crank_angle"].values[-1] > turns - 9
        np.testing.assert_allclose(np.abs(frames["spectrum"].sel(order=1.0).values), 1.0, atol=0.02)


def test_orders_that_the_rate_cannot_carry_are_missing_not_wrong():
    band, angle = steady([line(1, 1)], speed_rpm=3000.0, duration_s=4.0, rate_hz=952.0)
    frames = order_frames(band, angle, settings=SETTINGS)
    missing = np.isnan(frames["spectrum"].values[0, 0])
    np.testing.assert_array_equal(missing, frames["order"].values > 0.4 * 952.0 / 50.0)


def test_less_than_one_cycle_is_refused_with_both_numbers():
    with pytest.raises(InputError, match=r"less than one engine cycle.*found 2.00 revolutions.*at least 2"):
        order_frames(*steady([line(2, 1)], speed_rpm=600.0, duration_s=0.1999, rate_hz=5000.0), settings=SETTINGS)


def test_crank_angle_samples_give_order_spectra_straight():
    for start_deg in (90.0, 0.0, -180.0, -0.4, 0.3, 17.25):
        angle = np.arange(360 * 40) / 360 + start_deg / 360
        signal = 0.4 * np.cos(2 * np.pi * 5.5 * angle + 0.8)
        attrs = {"samples_per_rev": 360, "start_deg": start_deg, "encoder_kind": "none"}
        band = sampled(signal[None], domain="crank_angle", **attrs)
        ends = np.array([start_deg / 360, start_deg / 360 + 40])
        angles = shaft(np.array([0.0, math.nan]), ends, np.array([math.nan, math.nan]))
        angles.attrs["domain"] = "crank_angle"
        frames = order_frames(band, angles, settings=SETTINGS)
        np.testing.assert_allclose(frames["spectrum"].sel(order=5.5).values, 0.4 * np.exp(0.8j), atol=1e-11)
        assert np.isnan(frames["speed"].values).all()


def test_an_order_120_db_below_another_is_read_from_samples_of_24_bits():
    signal = total(line(1.0, 1.0, 0.2), line(5.5, 1e-6, 1.0))
    band, angle = steady([signal], speed_rpm=1487.0, duration_s=15.0, rate_hz=20000.0)
    band["signal"] = (band["signal"] * 2.0**23).round() / 2.0**23
    frames = order_frames(band_limited(band, band_hz=500.0, grid_hz=0.5), angle, settings=SETTINGS)
    assert abs(frames["spectrum"].sel(order=5.5).values[0].mean() / (1e-6 * np.exp(1j)) - 1.0) < 1e-2


def test_the_phase_is_kept_in_a_recording_that_begins_100_million_samples_after_angle_zero():
    rate, at = 50000.0, np.arange(500_000) + 100_000_000  # 3000 samples are one revolution: the phase is exact
    signal = np.cos(2.0 * np.pi * 5.5 * (at // 3000 % 2) + 2.0 * np.pi * 5.5 * (at % 3000) / 3000.0)
    knots = at[0] / rate + np.linspace(0.0, 10.0, 101)
    band = sampled(signal[None], rate_hz=rate).assign_attrs(start_s=at[0] / rate)
    frames = order_frames(band, shaft(knots, knots * 1000.0 / 60.0, np.full(101, 1000.0)), settings=SETTINGS)
    np.testing.assert_allclose(frames["spectrum"].sel(order=5.5).values[0], 1.0, atol=1e-6)


def test_a_mean_a_million_times_the_signal_does_not_leak():
    band, angle = steady([SIGNAL], speed_rpm=1487.0, duration_s=6.0, rate_hz=2000.0)
    quiet = order_frames(band, angle, settings=SETTINGS)["spectrum"].values
    moved = order_frames(band.assign(signal=band["signal"] + 1e6), angle, settings=SETTINGS)["spectrum"].values
    np.testing.assert_allclose(moved[:, :, 3:], quiet[:, :, 3:], atol=1e-6)
