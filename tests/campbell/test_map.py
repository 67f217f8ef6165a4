"""The Campbell map: scalings, stripes, densities."""

import math

import numpy as np
import pytest
from scipy.signal import welch

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map, leading_frames
from crankorder.fft.decimation import band_limited
from crankorder.fft.windows import window_named
from crankorder.quantities import check_dataset, flags_of
from made.recordings import held, line, run_up, sampled, shaft, steady
from made.shipped import CAMPBELL


def mapped(*recording, **changed):
    """CampbellMap of one BandRecording and its ShaftAngle, with settings ``changed``."""
    settings = CAMPBELL.model_copy(update=changed)
    return campbell_map([frequency_frames(*recording, settings=settings)], speed_bin_rpm=25.0)


def map_of(*signals, duration_s=12.0, rate_hz=2000.0, **changed):
    return mapped(*steady(list(signals), speed_rpm=1200.0, duration_s=duration_s, rate_hz=rate_hz), **changed)


@pytest.mark.parametrize(("hertz", "rate_hz"), [(351.0, 2000.0), (480.4, 1785.0 + 5 / 7), (120.33, 3333.3)])
def test_a_tone_reads_its_peak_where_it_is_also_where_the_rate_is_no_multiple_of_the_resolution(hertz, rate_hz):
    made = map_of(lambda t, _: 0.3 * np.cos(2 * np.pi * hertz * t), rate_hz=rate_hz)
    check_dataset(made, "campbell_map")
    made = made.isel(channel=0, speed=0)
    assert abs(20 * np.log10(made["amplitude"].sel(frequency=slice(hertz - 5, hertz + 5)).max().item() / 0.3)) < 0.01
    size, at = np.sqrt(made["psd"].values), int(np.argmax(made["psd"].values))
    side = 1 if size[at + 1] > size[at - 1] else -1
    ratio = size[at + side] / size[at]
    # of a Hann window's line, from the two largest bins (Rife and Vincent 1970)
    place = made["frequency"].values[at] + side * (2.0 * ratio - 1.0) / (1.0 + ratio) * made.attrs["resolution_hz"]
    assert place == pytest.approx(hertz, abs=1e-3)


def test_a_record_shorter_than_the_resolution_lands_on_the_same_frequencies():
    long, short = (map_of(line(2.0, 1.0), duration_s=d, rate_hz=2000.0) for d in (10.0, 1.0))
    np.testing.assert_array_equal(long["frequency"], short["frequency"])
    assert short["amplitude"].max().item() == pytest.approx(1.0, rel=0.01)
    assert short.attrs["enbw_hz"] == pytest.approx(1.5, rel=1e-6)


def crank_angle_frames(speed_rpm):
    angle = np.arange(360 * 200) / 360
    attrs = {"samples_per_rev": 360, "speed_rpm": speed_rpm, "encoder_kind": "none"}
    band = sampled(np.cos(2 * np.pi * 3.0 * angle)[None], domain="crank_angle", **attrs)
    knots = shaft(np.array([0.0, 1.0]), np.array([0.0, 200.0]), np.full(2, speed_rpm))
    return frequency_frames(band, knots, settings=CAMPBELL)


def test_crank_angle_data_have_a_map_by_their_speeds_and_none_without():
    nothing = campbell_map([crank_angle_frames(math.nan)], speed_bin_rpm=25.0)
    check_dataset(nothing, "campbell_map")
    assert nothing.sizes["speed"] == 0
    made = campbell_map([crank_angle_frames(1000.0), crank_angle_frames(1507.0)], speed_bin_rpm=25.0)
    assert made["speed"].values.tolist() == [1000.0, 1507.0]
    assert made["frequency"].values[made["amplitude"].values[0, 0].argmax()] == pytest.approx(50.0, abs=0.5)
    assert made["frequency"].values[made["amplitude"].values[0, 1].argmax()] == pytest.approx(75.35, abs=0.5)


def test_a_slow_recording_that_ends_the_map_is_named():
    slow, fast = (
        frequency_frames(*steady([line(2.0, 1.0)], speed_rpm=rpm, duration_s=5.0, rate_hz=rate), settings=CAMPBELL)
        for rpm, rate in ((1000.0, 500.0), (1500.0, 2000.0))
    )
    slow.attrs["recording"] = "slow.h5"
    made = campbell_map([fast, slow], speed_bin_rpm=25.0)
    assert made["frequency"].values[-1] == 250.0
    assert [flag["recording"] for flag in flags_of(made) if flag["flag"] == "map_cut"] == ["slow.h5"]


RATE_HZ, BINS = 1024, 400


def recordings(seed, *, ring):
    """FrequencyFrames, Hann frames of 1 s, of twelve recordings of noise of 4 s in two channels.

    A mode of 80 Hz and 0.5 % ``ring``s at first.
    """
    rng, made = np.random.default_rng(seed), []
    time_s = np.arange(4 * RATE_HZ) / RATE_HZ
    settings = CAMPBELL.model_copy(update={"resolution_hz": 1.0, "max_frequency_hz": BINS - 1.0})
    for number in range(12):
        signal = rng.standard_normal((2, time_s.size))
        decay = np.exp(-2.0 * np.pi * 0.005 * 80.0 * time_s)
        signal += ring * decay * np.cos(2.0 * np.pi * 80.0 * time_s + rng.uniform(0.0, 6.3))
        recording = sampled(signal, rate_hz=float(RATE_HZ), recording=str(number))
        made.append(frequency_frames(recording, held(1000.0 + 50.0 * number, 4.0), settings=settings))
    return made


def test_the_floor_without_the_start_is_that_of_noise_which_itself_loses_next_to_nothing():
    frames = recordings(0, ring=0.0)
    quiet, rung = (campbell_map(own, speed_bin_rpm=10.0) for own in (frames, recordings(0, ring=2.0)))
    level = float(quiet["psd"].mean())
    assert float(rung["psd"][:, :, 76:85].mean()) > 2.0 * level
    at = rung["settled_frequency"].values
    inside = (at >= 78) & (at <= 82)
    assert np.count_nonzero(inside) == 5
    total = (rung["settled_psd"] * rung["settled_share"]).sum("speed") / rung["settled_share"].sum("speed")
    assert float(total[:, inside].mean()) < 1.3 * level
    assert float(rung["settled_share"].min()) > 0.2
    assert len(at) < 0.1 * BINS
    # a chance of half a percent in each of two channels, and the bins beside
    lost = [leading_frames(own) for own in (frames, *(recordings(seed, ring=0.0) for seed in range(1, 4)))]
    assert sum(int((leading[0] > 0).sum()) for leading in lost if leading is not None) <= 0.05 * 4 * BINS


def test_what_does_not_turn_keeps_its_start():
    struck = recordings(1, ring=3.0)
    for item in struck:
        item["speed"] = ("frame", np.full(item.sizes["frame"], np.nan))
    assert leading_frames(struck) is None


# Frames by time and what they become on the map: precision, windows, gaps, sweeps, extremes.


def test_rms_is_the_peak_over_the_square_root_of_two():
    peak, root = (map_of(line(1.0, 0.3), amplitude_scaling=scaling) for scaling in ("peak", "rms"))
    assert (peak.attrs["amplitude_scaling"], root.attrs["amplitude_scaling"]) == ("peak", "rms")
    np.testing.assert_allclose(root["amplitude"] * 2**0.5, peak["amplitude"], rtol=1e-12)
    np.testing.assert_array_equal(root["psd"], peak["psd"])


def test_the_density_is_that_of_scipys_welch():
    rng = np.random.default_rng(5)
    band, knots = steady([lambda t, _: rng.standard_normal(len(t))], speed_rpm=1200.0, duration_s=20.0, rate_hz=2000.0)
    values = window_named("flat-top", 4000).values
    expected = welch(band["signal"].values, 2000.0, window=values, nperseg=4000, detrend=False)[1]
    for dtype, largest in ((np.float64, 1e-10), (np.float32, 1e-4)):
        band["signal"] = band["signal"].astype(dtype)
        made = mapped(band, knots, window="flat-top", max_frequency_hz=1000.0)
        np.testing.assert_allclose(made["psd"].values[0], expected, rtol=largest)


def test_a_floor_120_db_below_a_tone_is_seen_with_a_flat_top():
    frequency = [100.13, 130.31]  # between bins
    signal = [lambda t, _: np.cos(2 * np.pi * frequency[0] * t) + 1e-6 * np.cos(2 * np.pi * frequency[1] * t)]
    for dtype, floor in ((np.float64, 1e-7), (np.float32, 2e-7)):
        band, knots = steady(signal, speed_rpm=1200.0, duration_s=12.0, rate_hz=2000.0)
        band["signal"] = band["signal"].astype(dtype)
        amplitude = mapped(band, knots, window="flat-top")["amplitude"]
        weak = amplitude.sel(frequency=slice(129.0, 132.0)).max().item()
        assert weak == pytest.approx(1e-6, rel=0.01 if dtype == np.float64 else 0.2)
        assert amplitude.sel(frequency=slice(140.0, None)).max().item() < floor


@pytest.mark.parametrize(("size", "dtype"), [(1e-300, np.float64), (1e300, np.float64), (1e-30, np.float32)])
def test_the_smallest_and_largest_amplitudes_survive_beside_common_ones(size, dtype):
    band, knots = steady([line(2.0, size), line(2.0, 1.0)], speed_rpm=1200.0, duration_s=6.0, rate_hz=2000.0)
    band["signal"] = band["signal"].astype(dtype)
    frames = frequency_frames(band, knots, settings=CAMPBELL)
    check_dataset(frames, "frequency_frames")
    made = campbell_map([frames, frames], speed_bin_rpm=25.0)
    assert made["amplitude"][0].max().item() == pytest.approx(size, rel=1e-3)
    assert made["amplitude"][1].max().item() == pytest.approx(1.0, rel=1e-3)


def test_frames_that_a_gap_touches_are_left_out_of_their_channel_only():
    parts = [line(2.0, 1.0), line(2.0, 0.5)]
    whole, knots = steady(parts, speed_rpm=1200.0, duration_s=20.0, rate_hz=20_000.0)
    holed = whole.copy(deep=True)
    holed["signal"][0, 90_000:95_000] = np.nan
    plain, marked = (mapped(band_limited(item, band_hz=500.0, grid_hz=0.5), knots) for item in (whole, holed))
    check_dataset(marked, "campbell_map")
    assert "n_frames_used" not in plain
    assert plain["n_frames"].item() == marked["n_frames"].item() == 18
    assert marked["n_frames_used"].values.tolist() == [[16], [18]]  # 4.5 s to 4.75 s lie in two frames of 2 s
    np.testing.assert_allclose(marked["amplitude"][0], plain["amplitude"][0], atol=1e-4)
    np.testing.assert_allclose(marked["amplitude"][1], plain["amplitude"][1], atol=1e-12)


def test_a_channel_without_a_usable_frame_is_unknown_and_the_others_are_not():
    band, knots = steady([line(2.0, 1.0), line(2.0, 0.5)], speed_rpm=1200.0, duration_s=6.0, rate_hz=2000.0)
    usable = np.ones((2, band.sizes["time"]), dtype=np.bool_)
    usable[0, ::1000] = False
    band["usable"] = (("channel", "time"), usable, {"units": "1"})
    made = mapped(band, knots)
    assert np.isnan(made["amplitude"][0]).all() and np.isnan(made["psd"][0]).all()
    assert made["amplitude"][1].max().item() == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(("rate_rpm_per_s", "seconds"), [(28.0, 20.0), (10_000.0, 3.0)])
def test_in_a_run_up_the_frames_are_short_enough_for_a_line_to_stay_one(rate_rpm_per_s, seconds):
    to_rpm = 1000.0 + rate_rpm_per_s * seconds
    recording = run_up([line(4.0, 1.0)], from_rpm=1000.0, to_rpm=to_rpm, duration_s=seconds, rate_hz=8000.0)
    frames = frequency_frames(*recording, settings=CAMPBELL.model_copy(update={"max_frequency_hz": 3000.0}))
    enbw_hz = frames.attrs["enbw_bins"] * frames.attrs["resolution_hz"]
    assert 0.5 * enbw_hz < frames.attrs["sweep_hz_per_order"] * 4.0 < 1.6 * enbw_hz
    assert float(frames["speed_change"].max()) == pytest.approx(60.0 * frames.attrs["sweep_hz_per_order"])
    made = campbell_map([frames], speed_bin_rpm=25.0)
    assert made.attrs["enbw_hz"] == pytest.approx(enbw_hz)
    # the line is found at four times the speed, at an amplitude that a sweep over one noise bandwidth leaves
    at = made["frequency"].values[made["amplitude"].values[0].argmax(axis=1)]
    known = 4.0 * made["speed"].values / 60.0 < 2900.0
    assert np.abs(at - 4.0 * made["speed"].values / 60.0)[known].max() < enbw_hz
    assert made["amplitude"].max("frequency").values[0, known].min() > 0.75


def test_a_sweep_that_no_frame_can_hold_still_is_named():
    band, knots = run_up([line(1.0, 1.0)], from_rpm=1000.0, to_rpm=1000.1, duration_s=10.0, rate_hz=2000.0)
    # one frame in twenty sweeps a hundred times faster than the others, and they set the length
    jump = np.where(knots["time"].values > 9.0, 3000.0 * (knots["time"].values - 9.0) ** 2 / 60.0, 0.0)
    knots["crank_angle"] = knots["crank_angle"] + jump
    frames = frequency_frames(band, knots, settings=CAMPBELL.model_copy(update={"resolution_hz": 4.0}))
    assert "swept_lines" in [flag["flag"] for flag in flags_of(frames)]


def test_a_steady_speed_with_uneven_running_keeps_the_resolution():
    band, _ = steady([line(1.0, 1.0)], speed_rpm=1200.0, duration_s=10.0, rate_hz=2000.0)
    time_s = np.linspace(0.0, 10.0, 4000)
    uneven = shaft(time_s, 20.0 * time_s + 0.002 * np.sin(2 * np.pi * 20.0 * time_s), np.full(4000, 1200.0))
    frames = frequency_frames(band, uneven, settings=CAMPBELL)
    assert frames.attrs["resolution_hz"] == CAMPBELL.resolution_hz
    assert frames.attrs["enbw_bins"] == pytest.approx(1.5)
    assert flags_of(frames) == []


def test_a_band_wider_than_the_map_is_decimated_before_it_is_transformed():
    signals = [lambda t, _: np.cos(2 * np.pi * 100.25 * t) + np.cos(2 * np.pi * 7100.0 * t)]
    amplitude = map_of(*signals, rate_hz=20_000.0)["amplitude"]
    assert amplitude.max().item() == pytest.approx(1.0, rel=2e-3)
    assert amplitude.sel(frequency=slice(200.0, None)).max().item() < 2e-6
