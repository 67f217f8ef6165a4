"""Order frames against analytic signals."""

import math

import numpy as np
import pytest
import xarray as xr

from crankorder.errors import InputError
from crankorder.orders.frames import order_frames
from crankorder.quantities import check_dataset, flags_of
from crankorder.settings import load_settings
from crankorder.shaft.decode import shaft_angle
from made.recordings import line, run_up, sampled, shaft, steady, total

SETTINGS = load_settings().orders


def test_amplitude_and_phase_from_top_dead_centre_are_exact_at_constant_speed():
    parts = {0.5: (0.1, 0.2), 1.0: (2.0, -2.5), 5.5: (0.03, 1.0), 10.0: (0.7, 3.0)}
    signal = total(*(line(order, *value) for order, value in parts.items()))
    for speed_rpm in (300.0, 1000.0, 2000.0):
        frames = order_frames(*steady([signal], speed_rpm=speed_rpm, duration_s=8.0, rate_hz=1785.0), settings=SETTINGS)
        check_dataset(frames, "order_frames")
        for order, (amplitude, phase) in parts.items():
            value = frames["spectrum"].sel(order=order, channel="A").values
            np.testing.assert_allclose(value, amplitude * np.exp(1j * phase), atol=3e-7)


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


@pytest.mark.cases(2)
@pytest.mark.parametrize("share_of_rate", [0.499, 0.3, 0.39, 0.45, 0.48, 0.42])
@pytest.mark.parametrize("speed_rpm", [300.0, 1000.0, 2000.0, 1487.0])
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
            if frames.attrs["revs_per_frame"] > 1:
                np.testing.assert_allclose(np.abs(frames["spectrum"].sel(order=2.0).values), 1.0, atol=1e-6)


@pytest.mark.cases(4)
@pytest.mark.parametrize("rise", [0.0, 1.5])
@pytest.mark.parametrize("encoder", ["speed", "square"])
def test_a_record_of_whole_turns_is_read_to_its_last_sample(encoder, rise):
    settings = SETTINGS.model_copy(update={"method": "nufft", "max_order": 4.0})  # this method reads up to both ends
    for turns in (*range(2, 36), 63, 64, 65, 200):
        for more in (-1, 0, 1):
            band = _whole_turns(turns, encoder, rise=rise, more=more)
            frames = order_frames(band, shaft_angle(band, settings=load_settings().shaft), settings=settings)
            assert frames.attrs["revs_per_frame"] + frames["crank_angle"].values[-1] > turns - 9
            np.testing.assert_allclose(np.abs(frames["spectrum"].sel(order=1.0).values), 1.0, atol=0.02)


def _whole_turns(turns: int, encoder: str, *, rise: float, more: int) -> xr.Dataset:
    """Recording of order 1, ``turns`` turns and ``more`` samples long, in which the speed rises by a share ``rise``."""
    rate_hz = 1000.0
    duration_s = round(turns / 17.3 / (1.0 + 0.5 * rise) * rate_hz) / rate_hz
    time_s = np.arange(round(duration_s * rate_hz) + 1 + more) / rate_hz
    first_hz = turns / duration_s / (1.0 + 0.5 * rise)
    angle = first_hz * (time_s + 0.5 * rise * time_s**2 / duration_s)
    band = steady(
        [lambda *_: np.cos(2 * np.pi * angle)], speed_rpm=1.0, duration_s=len(angle) / rate_hz, rate_hz=rate_hz
    )[0]
    band.attrs |= {"encoder_kind": encoder, "revs_per_cycle": 1, "missing_teeth": 0, "ratio": 1.0}
    if encoder == "speed":
        speed = 60.0 * first_hz * (1.0 + rise * time_s / duration_s)
        return band.assign(speed_signal=("time", speed, {"units": "min-1"}))
    edges = np.interp(np.arange(math.floor(angle[-1] * 60.0 + 1e-9) + 1) / 60.0, angle, time_s)
    band.attrs["pulses_per_rev"] = 60
    return band.assign(pulse_time=("pulse", edges, {"units": "s"}))


def test_orders_that_the_rate_cannot_carry_are_missing_not_wrong():
    band, angle = steady([line(1, 1)], speed_rpm=3000.0, duration_s=4.0, rate_hz=952.0)
    for method, share in (("resample", 0.4), ("nufft", 0.49)):
        frames = order_frames(band, angle, settings=SETTINGS.model_copy(update={"method": method}))
        limit = share * 952.0 / 50.0
        missing = np.isnan(frames["spectrum"].values[0, 0])
        assert missing[frames["order"].values > limit].all()
        assert not missing[frames["order"].values < limit].any()


def test_a_short_recording_gives_shorter_frames_and_says_so():
    frames = order_frames(*steady([line(2, 1)], speed_rpm=600.0, duration_s=0.95, rate_hz=5000.0), settings=SETTINGS)
    assert frames.attrs["revs_per_frame"] == 8
    assert [flag["flag"] for flag in flags_of(frames)] == ["short_recording"]
    np.testing.assert_allclose(np.abs(frames["spectrum"].sel(order=2.0).values), 1.0, atol=1e-6)


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
