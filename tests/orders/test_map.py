"""Order map and tracks: averages, floors and bands against analytic signals in known noise."""

import numpy as np
import pytest

from crankorder.orders.frames import order_frames
from crankorder.orders.intervals import amplitude_interval, is_seen
from crankorder.orders.like_speed import common_frames, reframed
from crankorder.orders.map import order_map
from crankorder.orders.track_rows import order_tracks
from crankorder.quantities import check_dataset, flags_of
from crankorder.shaft.speeds import held_speeds, speed_groups
from made.order_spectra import REVS, SAMPLES_PER_REV, angle_frames, coloured, lines
from made.recordings import line, run_up, steady, total
from made.shipped import ORDERS


def noise(seed, sigma):
    rng = np.random.default_rng(seed)
    return lambda time_s, _: sigma * rng.standard_normal(len(time_s))


def frames_of(*signals, speed_rpm=1200.0, duration_s=10.0, name="made", **given):
    made = order_frames(
        *steady(list(signals), speed_rpm=speed_rpm, duration_s=duration_s, rate_hz=2000.0, **given), settings=ORDERS
    )
    made.attrs["recording"] = name
    return made


def test_a_stepped_test_gives_one_row_per_speed_slowest_first():
    frames = [frames_of(line(2.0, rpm / 1000), speed_rpm=rpm) for rpm in (1500.0, 500.0, 1000.0)]
    made = order_map(frames, settings=ORDERS)
    check_dataset(made, "order_map")
    np.testing.assert_allclose(made["speed"].values, [500.0, 1000.0, 1500.0], rtol=1e-9)
    np.testing.assert_allclose(made["coherent_amplitude"].sel(order=2.0).values[0], [0.5, 1.0, 1.5], rtol=1e-6)
    np.testing.assert_allclose(made["phase"].sel(order=2.0).values, 0.0, atol=1e-4)


def test_a_slipping_line_stays_in_the_energy_average_and_leaves_the_coherent_one():
    made = order_map([frames_of(line(5.47, 1.0), duration_s=30.0)], settings=ORDERS)
    nearest = made.sel(order=5.5)
    assert nearest["amplitude"].item() > 0.8
    assert nearest["coherent_amplitude"].item() < 0.3


@pytest.mark.parametrize(("references", "stated"), [(("none", "none"), "none"), (("tdc", "index"), "mixed")])
def test_recordings_without_a_common_mark_are_averaged_by_power_not_against_each_other(references, stated):
    items = [frames_of(line(2.0, 1.0, phase)) for phase in (0.0, np.pi)]
    for item, reference in zip(items, references, strict=True):
        item.attrs["phase_reference"] = reference
    made = order_map(items, settings=ORDERS)
    assert made["coherent_amplitude"].sel(order=2.0).item() == pytest.approx(1.0, rel=1e-6)
    assert np.isnan(made["phase"].values).all()
    assert made.attrs["phase_reference"] == stated


def test_recordings_that_end_at_different_orders_are_averaged_on_those_they_share():
    long = frames_of(line(2.0, 1.0), name="long.h5")
    short = frames_of(line(2.0, 1.0), name="short.h5").isel(order=slice(100))
    made = order_map([long, short], settings=ORDERS)
    assert made.sizes["order"] == 100
    assert made["coherent_amplitude"].sel(order=2.0).item() == pytest.approx(1.0, rel=1e-6)
    cut = [flag for flag in flags_of(made) if flag["flag"] == "orders_cut"]
    assert [(flag["recording"], flag["severity"]) for flag in cut] == [("long.h5", "info")]


def test_half_orders_of_two_recordings_with_unknown_cycle_do_not_cancel():
    one, other = (frames_of(total(line(5.5, 1.0, phase), line(2.0, 1.0))) for phase in (0.0, np.pi))
    for item in (one, other):
        item.attrs["cycle_known"] = 0
    made = order_map([one, other], settings=ORDERS)
    assert made["coherent_amplitude"].sel(order=5.5).item() == pytest.approx(1.0, rel=1e-6)
    assert made["phase"].sel(order=2.0).item() == pytest.approx(0.0, abs=1e-4)


def test_a_recording_far_shorter_than_the_others_is_left_out_and_named():
    frames = [frames_of(line(2.0, 1.0), duration_s=10.0) for _ in range(3)]
    made = order_map([*frames, frames_of(line(2.0, 9.0), duration_s=0.5, name="odd.h5")], settings=ORDERS)
    assert made["coherent_amplitude"].sel(order=2.0).values == pytest.approx(1.0, rel=1e-5)
    bad = [flag for flag in flags_of(made) if flag["severity"] == "bad"]
    assert [flag["recording"] for flag in bad] == ["odd.h5"]


def test_a_recording_far_longer_than_the_others_is_cut_to_their_frames_and_every_frame_counts_once():
    short = [frames_of(line(2.0, 1.0), duration_s=0.72) for _ in range(3)]
    long = frames_of(line(2.0, 9.0), duration_s=10.0, name="long.h5")
    made = order_map([*short, long], settings=ORDERS)
    count = made["n_frames"].item()
    assert count > 10  # 10 s hold more than ten frames of 0.72 s
    assert made["coherent_amplitude"].sel(order=2.0).values == pytest.approx((3 * 1.0 + (count - 3) * 9.0) / count)
    assert not [flag for flag in flags_of(made) if flag["severity"] == "bad"]


def test_a_run_up_falls_into_bins_of_the_stated_width():
    recording = run_up([line(2.0, 1.0)], from_rpm=500, to_rpm=1500, duration_s=60.0, rate_hz=2000.0)
    speed = order_map([order_frames(*recording, settings=ORDERS)], settings=ORDERS)["speed"].values
    assert np.diff(speed).min() > 10.0
    assert np.diff(speed).max() < 2 * ORDERS.speed_bin_rpm


def test_the_band_rms_holds_the_energy_of_tones_and_of_noise():
    quiet = order_map([frames_of(line(6.0, 0.8), duration_s=20.0)], settings=ORDERS)
    rms = order_tracks(quiet, [6.0], settings=ORDERS)["band_rms"].item()
    assert rms == pytest.approx(0.8 / np.sqrt(2), rel=2e-3)
    noisy = order_map([frames_of(noise(3, 1.0), duration_s=200.0)], settings=ORDERS)
    rms = order_tracks(noisy, [7.0], settings=ORDERS)["band_rms"].item()
    # white noise of variance 1 over 1000 Hz: half an order at 20 Hz is 10 Hz
    assert rms == pytest.approx(np.sqrt(10.0 / 1000.0), rel=0.05)


def test_recordings_of_a_low_rate_and_unlike_speeds_share_one_order_axis():
    frames = [
        order_frames(*steady([line(1.0, 1.0)], speed_rpm=rpm, duration_s=4.0, rate_hz=952.0), settings=ORDERS)
        for rpm in (1500.0, 3000.0, 5600.0)
    ]
    assert len({item.sizes["order"] for item in frames}) == 1
    made = order_map(frames, settings=ORDERS)
    np.testing.assert_allclose(made["coherent_amplitude"].sel(order=1.0).values[0], 1.0, atol=1e-5)


def test_amplitudes_from_1e_minus_300_to_1e300_survive_map_and_tracks():
    plain = frames_of(total(line(2.0, 1.0, 0.4), noise(5, 0.1)))
    for scale in (1e-300, 1e300):
        scaled = plain.copy(deep=True)
        scaled["spectrum"].values[:] *= scale
        one, other = order_map([plain], settings=ORDERS), order_map([scaled], settings=ORDERS)
        for name in ("amplitude", "coherent_amplitude", "standard_error", "coherent_amplitude_low"):
            np.testing.assert_allclose(other[name].values / scale, one[name].values, rtol=1e-9)
        np.testing.assert_allclose(other["phase"].values, one["phase"].values, atol=1e-9)
        np.testing.assert_allclose(other["spectral_kurtosis"].values, one["spectral_kurtosis"].values, rtol=1e-9)
        tracks = [order_tracks(item, [2.0, 3.13], settings=ORDERS) for item in (one, other)]
        for name in ("amplitude", "amplitude_high", "standard_error", "band_rms"):
            np.testing.assert_allclose(tracks[1][name].values / scale, tracks[0][name].values, rtol=1e-9)


def test_frames_in_a_gap_of_one_channel_are_left_out_and_counted():
    whole = frames_of(*(total(line(2.0, 1.0), noise(k, 0.1)) for k in range(2)))
    gappy = whole.copy(deep=True)
    gappy["spectrum"].values[1, [3, 4, 9]] = np.nan
    made, full = order_map([gappy], settings=ORDERS), order_map([whole], settings=ORDERS)
    frames = whole.sizes["frame"]
    assert made["frames_used"].values.tolist() == [[frames], [frames - 3]]
    assert made["n_frames"].values.tolist() == [frames - 3]
    np.testing.assert_allclose(made["coherent_amplitude"].values[0], full["coherent_amplitude"].values[0], rtol=1e-12)
    kept = np.delete(whole["spectrum"].values[1], [3, 4, 9], axis=0)
    np.testing.assert_allclose(made["coherent_amplitude"].values[1, 0], np.abs(kept.mean(axis=0)), rtol=1e-12)
    np.testing.assert_allclose(made["amplitude"].values[1, 0] ** 2, np.mean(np.abs(kept) ** 2, axis=0), rtol=1e-12)
    assert np.isfinite(made["standard_error"].values[..., 2:]).all()


def test_the_interval_of_a_track_between_two_bins_holds_the_truth():
    signals = [total(line(6.13, 0.8), noise(k, 0.5)) for k in range(26)]  # a line that slips, 26 draws as channels
    made = order_map([frames_of(*signals, duration_s=20.0)], settings=ORDERS)
    track = order_tracks(made, [6.13], settings=ORDERS).isel(order=0, speed=0)
    hits = (track["amplitude_low"] <= 0.8) & (track["amplitude_high"] >= 0.8)
    assert hits.mean() > 0.95 - 4 * np.sqrt(0.05 * 0.95 / 26)
    assert (track["amplitude_high"] - track["amplitude_low"]).mean() < 6 * np.std(track["amplitude"])
    assert np.isnan(track["phase"]).all()


COURSES = {
    "doubles halfway": lambda share: np.where(share < 0.5, 1.0, 2.0),
    "drifts": lambda share: 1.0 + share,
    "swells": lambda share: 1.5 + 0.5 * np.sin(2 * np.pi * share),
}


FRAMES = 20


def mapped(course, phase=lambda share: 0.3):
    noise = 0.05 * coloured(np.random.default_rng(0), 100, revs=8 * (FRAMES + 1), colour="white")
    share = np.linspace(0.0, 1.0, noise.shape[1])
    angle = np.arange(noise.shape[1]) / SAMPLES_PER_REV
    signal = noise + course(share) * np.cos(2 * np.pi * 2.0 * angle + phase(share))
    return order_map([angle_frames(signal)], settings=ORDERS).sel(order=2.0).isel(speed=0)


@pytest.mark.parametrize("name", COURSES)
def test_the_interval_covers_what_the_frames_held_and_the_mean_is_that_of_the_recording(name):
    course, line = COURSES[name], mapped(COURSES[name])
    window = np.hanning(REVS * SAMPLES_PER_REV)
    share = np.linspace(0.0, 1.0, 8 * (FRAMES + 1) * SAMPLES_PER_REV)
    begin = np.arange(FRAMES) * 8 * SAMPLES_PER_REV
    held = np.array([np.average(course(share[k : k + len(window)]), weights=window) for k in begin])
    low, high = line["coherent_amplitude_low"].values, line["coherent_amplitude_high"].values
    inside = (low[:, None] <= held) & (held <= high[:, None])
    assert inside.mean() > 0.93
    assert abs(line["coherent_amplitude"].values.mean() - held.mean()) < 0.01
    # and not more than that: at most a third beyond
    assert np.median(high - low) < 1.4 * np.ptp(held) + 0.1
    # the standard error stays that of the mean
    assert np.median(line["standard_error"].values) < 0.05
    # its phase was steady all the while
    assert np.median(line["phase_ci95"].values) < 3.0


def test_a_phase_that_turns_widens_the_interval_of_the_phase_and_not_of_the_amplitude():
    line = mapped(lambda share: 2.0, phase=lambda share: 0.6 * (share - 0.5))
    assert np.median(line["phase_ci95"].values) > 0.8 * np.degrees(0.3)
    # the mean of phasors that turn to 0.3 rad on both sides loses no more than its cosine
    lost = 2.0 * (1.0 - np.cos(0.3))
    assert np.median(line["coherent_amplitude_high"] - line["coherent_amplitude_low"]) < lost


def test_the_lower_end_leaves_zero_where_the_line_is_seen_and_grows_without_a_step():
    amplitude = np.linspace(0.0, 12.0, 5001)
    for dof in (2.0, 4.0, 8.0, 30.0, 400.0):
        low, high = amplitude_interval(amplitude, np.ones(5001), np.full(5001, dof))
        seen = is_seen(amplitude, np.ones(5001), np.full(5001, dof))
        assert ((low > 0.0) == seen)[1:].mean() > 0.999
        assert np.diff(low).min() >= -1e-9
        assert np.diff(low).max() < 0.3  # a root in the amplitude, no jump
        assert (high > low).all()


# Frames of unequal length in one test: what the longer ones become, and what they may not lose.


def frames_from(recording, **changes):
    return order_frames(*recording, settings=ORDERS.model_copy(update=changes))


PARTS = [(0.5, 1.2, -2.0), (2.0, 0.3, 1.0), (5.5, 2.9, 0.4), (11.0, 0.7, 3.0), (14.5, 1.8, -0.7)]


def a_steady_one(*, speed_rpm=1487.0, duration_s=8.0):
    """Two channels of the orders PARTS (order, amplitude, phase)."""
    signal = total(*(line(*part) for part in PARTS))
    return steady([signal] * 2, speed_rpm=speed_rpm, duration_s=duration_s, rate_hz=4096.0)


def test_frames_cut_from_longer_ones_are_those_that_the_samples_give():
    band, shaft = a_steady_one()
    band["signal"].values[:] += 0.3 * np.random.default_rng(1).normal(size=band["signal"].shape)
    recording = band, shaft
    cut = reframed(frames_from(recording), 8)
    direct = frames_from(recording, revs_per_frame=8, overlap=0.75)
    assert cut.sizes["order"] == direct.sizes["order"]
    both = np.intersect1d(np.round(cut["crank_angle"], 6), np.round(direct["crank_angle"], 6))
    assert len(both) > 0.9 * cut.sizes["frame"]
    a = cut.isel(frame=np.searchsorted(cut["crank_angle"].values, both - 1e-5))
    b = direct.isel(frame=np.searchsorted(direct["crank_angle"].values, both - 1e-5))
    inner = slice(2, -3)  # beyond the highest order nothing was kept: its share of the last bins is missing
    error = np.abs(a["spectrum"].values - b["spectrum"].values)[..., inner]
    assert error.max() < 2e-3 * np.abs(b["spectrum"].values).max()
    assert np.allclose(a["speed"], b["speed"], rtol=1e-9)


def test_a_fast_run_up_beside_steady_recordings_loses_no_recording():
    steady_one = frames_from(a_steady_one())
    swept = frames_from(run_up([line(2.0, 1.0)] * 2, from_rpm=600.0, to_rpm=5000.0, duration_s=6.0, rate_hz=4096.0))
    length = swept.attrs["revs_per_frame"]
    assert length < steady_one.attrs["revs_per_frame"]
    assert "frames_shortened" in {flag["flag"] for flag in flags_of(swept)}
    used, flags = common_frames([steady_one, swept])
    assert [item.attrs["revs_per_frame"] for item in used] == [length, length]
    assert [flag["flag"] for flag in flags] == ["frames_cut"]
    made = order_map([steady_one, swept], settings=ORDERS)
    assert not [flag for flag in flags_of(made) if flag["severity"] == "bad"]
    at = np.abs(made["speed"].values - float(steady_one["speed"].values[0])).argmin()
    assert made["n_frames"].values[at] > 10


def test_frames_of_nearly_the_common_length_are_shown_on_its_orders():
    short = frames_from(a_steady_one(speed_rpm=1200.0, duration_s=13.6 * 0.05), revs_per_frame=13)
    assert short.attrs["revs_per_frame"] == 12  # whole cycles
    long = frames_from(a_steady_one(), revs_per_frame=16)
    used, flags = common_frames([long, long, short])
    own = used[2]
    assert own.attrs["revs_per_frame"] == 16 and own.sizes["order"] == used[0].sizes["order"]
    assert {flag["flag"] for flag in flags} <= {"frames_on_common_orders", "orders_cut"}
    for order, amplitude, phase in PARTS:
        np.testing.assert_allclose(own["spectrum"].sel(order=order), amplitude * np.exp(1j * phase), atol=0.029)


def test_a_gap_in_a_long_frame_is_one_in_all_shorter_ones_that_touch_it():
    band, shaft = a_steady_one()
    usable = np.ones(band["signal"].shape, dtype=bool)
    usable[0, 12000:12100] = False
    band["usable"] = (("channel", "time"), usable, {"units": "1"})
    cut = reframed(frames_from((band, shaft)), 8)
    assert np.isnan(cut["spectrum"].values[0].real).any()
    assert np.isfinite(cut["spectrum"].values[1].real).all()
    assert np.isfinite(cut["spectrum"].values[0].real).any()


def held(rng, rpm, amplitude, phase=0.3, *, order=2.0, frames=20, **attrs):
    """A recording of two channels at ``rpm`` with one line, and noise of a third."""
    noise = 0.3 * coloured(rng, 2, revs=8 * (frames + 1), colour="white")
    speed = rpm + 0.05 * rng.standard_normal(frames)
    made = angle_frames(noise + lines(noise.shape[1], [(order, amplitude, phase)]), speed=speed, name=str(rpm))
    made.attrs |= attrs
    return made


def rows(*recordings):
    return [round(float(rpm)) for rpm in order_map(list(recordings), settings=ORDERS)["speed"].values]


def test_speeds_20_rpm_apart_share_a_row_where_all_agrees_and_else_have_their_own():
    rng = np.random.default_rng(0)
    first = held(rng, 1000.0, 1.0)
    assert rows(first, held(rng, 1020.0, 1.0)) == [1010]
    assert rows(first, held(rng, 1020.0, 0.15)) == [1000, 1020]
    assert rows(first, held(rng, 1020.0, 1.0, 1.3)) == [1000, 1020]
    # a line that slips has no phase; its energy tells
    slips = [held(rng, rpm, size, order=2.03) for rpm, size in ((1000.0, 1.0), (1020.0, 0.3))]
    assert rows(*slips) == [1000, 1020]
    # without a common phase only sizes are compared
    given = [held(rng, rpm, 1.0, phase, phase_reference="none") for rpm, phase in ((1000.0, 0.0), (1020.0, 2.0))]
    assert rows(*given) == [1010]
    # repeats at one speed share a row whatever they show
    assert rows(held(rng, 1000.0, 1.0), held(rng, 1000.5, 0.5)) == [1000]


def test_a_held_speed_is_not_parted_by_others_just_below():
    rng = np.random.default_rng(5)
    speeds = (980.0, 1004.5, 1005.5, 1006.0)
    owner = np.repeat(np.arange(4), 10)
    speed = np.concatenate([rpm + 0.4 * rng.standard_normal(10) for rpm in speeds])
    parts = speed_groups(speed, width_rpm=25.0, owner=owner)
    for k in range(4):
        assert sum((owner[part] == k).any() for part in parts) == 1


def test_steps_of_one_recording_are_told_from_a_sweep():
    rng = np.random.default_rng(6)
    steps = np.concatenate([rpm + 0.05 * rng.standard_normal(12) for rpm in (1000.0, 1020.0)])
    assert [len(part) for part in held_speeds(steps, np.zeros(24, dtype=int), width_rpm=25.0)] == [12, 12]
    sweep = np.linspace(900.0, 1400.0, 60)
    assert held_speeds(sweep, np.zeros(60, dtype=int), width_rpm=25.0) == []


def test_a_run_up_keeps_its_bins_though_a_line_grows_in_them():
    frames = 100
    noise = 0.01 * coloured(np.random.default_rng(7), 1, revs=8 * (frames + 1), colour="white")
    grown = np.linspace(1.0, 9.0, noise.shape[1]) * lines(noise.shape[1], [(2.0, 1.0, 0.3)])
    speed = np.linspace(900.0, 1900.0, frames)
    made = order_map([angle_frames(noise + grown, speed=speed)], settings=ORDERS)
    assert made.sizes["speed"] == len(speed_groups(speed, width_rpm=25.0))
