"""Every track stands at the order that was found: amplitudes at exact orders, beside others, and through sweeps."""

import numpy as np
import pytest
from scipy.signal import lfilter

from crankorder.errors import InputError, RequestError
from crankorder.findings import nothing_sought
from crankorder.orders.followed import followed_tracks, with_followed
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.swept_tracks import swept_tracks
from crankorder.orders.track_rows import TrackReader, followed_orders, order_tracks
from crankorder.quantities import check_dataset, flags_of, with_flags
from crankorder.settings import load_settings
from crankorder.shaft.angle import knots_of, time_at
from made.recordings import line, run_up, steady, total

SETTINGS = load_settings().orders
NOISE = 0.05


def steady_test(parts, *, seed, noise=NOISE, speeds=(1180.0, 1440.0, 1900.0)):
    draw = np.random.default_rng(seed)
    frames = []
    for number, speed in enumerate(speeds):
        band, shaft = steady([total(*parts)], speed_rpm=speed, duration_s=12.0, rate_hz=2048.0)
        band["signal"].values[:] += noise * draw.normal(size=band["signal"].shape)
        band.attrs["recording"] = f"step {number}"
        frames.append(order_frames(band, shaft, settings=SETTINGS))
    return frames, order_map(frames, settings=SETTINGS)


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_a_line_between_bins_reads_its_amplitude_at_its_exact_order(seed):
    draw = np.random.default_rng(100 + seed)
    order, amplitude = draw.uniform(0.7, 18.0), draw.uniform(0.5, 5.0)
    order += 0.01 * (abs(order * 16 - round(order * 16)) < 0.1)
    frames, made = steady_test([line(order, amplitude, 1.0)], seed=seed)
    tracks = order_tracks(made, [order], settings=SETTINGS, frames=frames)
    value = tracks["amplitude"].values[0, 0]
    assert value == pytest.approx(amplitude, rel=0.01)
    low, high = tracks["amplitude_low"].values[0, 0], tracks["amplitude_high"].values[0, 0]
    assert np.mean((low <= amplitude) & (amplitude <= high)) > 0.5


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_a_line_beside_a_stronger_one_is_told_from_it(seed):
    draw = np.random.default_rng(200 + seed)
    locked = float(draw.integers(1, 10))
    order = locked + draw.choice([-1, 1]) * draw.uniform(0.045, 0.12)
    frames, made = steady_test([line(locked, 3.0), line(order, 1.0, 2.0)], seed=seed)
    tracks = order_tracks(made, [locked, order], settings=SETTINGS, frames=frames)
    value = tracks["amplitude"].sel(order=order).values[0]
    assert value == pytest.approx(1.0, rel=0.05)


def test_rows_of_a_sweep_stand_at_their_own_speeds_and_steps_keep_theirs():
    def law(time_s, angle):
        speed = np.gradient(angle, time_s) * 60.0
        return (1.0 + 4.0 / (1.0 + ((speed - 2000.0) / 60.0) ** 2)) * np.cos(2 * np.pi * 2.0 * angle + 0.5)

    band, shaft = run_up([law], from_rpm=1000.0, to_rpm=3000.0, duration_s=20.0, rate_hz=2048.0)
    band["signal"].values[:] += 0.01 * np.random.default_rng(0).normal(size=band["signal"].shape)
    band.attrs["recording"] = shaft.attrs["recording"] = "sweep"
    steps, _ = steady_test([line(2.0, 1.0, 0.5)], seed=0, noise=0.01, speeds=(700.0, 800.0))
    frames = [*steps, order_frames(band, shaft, settings=SETTINGS)]
    followed = [swept_tracks(band, shaft, [2.0])]
    reader = TrackReader(order_map(frames, settings=SETTINGS), frames=frames, followed=followed)
    rows = reader.rows(2.0)
    seen = np.isfinite(rows.amplitude[0])
    speed, amplitude = reader.speed_rpm[seen], rows.amplitude[0, seen]
    assert (np.abs(speed - 700.0) < 1.0).sum() == (np.abs(speed - 800.0) < 1.0).sum() == 1
    swept = speed > 900.0
    assert swept.sum() == followed[0].sizes["frame"]
    wanted = 1.0 + 4.0 / (1.0 + ((speed - 2000.0) / 60.0) ** 2)
    inner = swept & (speed > 1050.0) & (speed < 2950.0)
    np.testing.assert_allclose(amplitude[inner], wanted[inner], rtol=0.02)
    np.testing.assert_allclose(rows.phase[0, seen][inner], np.degrees(0.5), atol=1.0)
    tracks = order_tracks(reader.order_map, [2.0], settings=SETTINGS, frames=frames, followed=followed)
    assert float(tracks["amplitude"].max()) == pytest.approx(float(np.nanmax(rows.amplitude)), rel=1e-12)
    assert (np.diff(tracks["speed"].values) >= 0).all()


def made_map(rate_hz=1000.0, noise=0.0):
    band, angle = steady([line(2.0, 1.0), line(2.0, 1.0)], speed_rpm=1200.0, duration_s=20.0, rate_hz=rate_hz)
    band["signal"].values[:] += np.random.default_rng(2).normal(0.0, 1.0, band["signal"].shape) * noise
    return order_map([order_frames(band, angle, settings=SETTINGS)], settings=SETTINGS)


def test_a_channel_that_holds_nothing_has_no_band_rms():
    made = made_map(noise=0.1)
    for name in ("amplitude", "coherent_amplitude"):
        made[name].values[1] = np.nan
    tracks = order_tracks(made, [2.0, 2.03], settings=SETTINGS)
    assert np.isfinite(tracks["band_rms"].values[0]).all()
    assert np.isnan(tracks["band_rms"].values[1]).all()
    assert np.isnan(tracks["amplitude"].values[1]).all()
    assert (tracks["degrees_of_freedom"].sel(order=2.03).values[1] == 0.0).all()


def test_beyond_what_the_sample_rate_carries_nothing_is_told_of_a_band():
    made = made_map(rate_hz=500.0, noise=0.1)  # 12.5 orders
    tracks = order_tracks(made, [11.0, 14.03], settings=SETTINGS.model_copy(update={"band_width_orders": 0.5}))
    assert np.isfinite(tracks["band_rms"].sel(order=11.0).values).all()
    assert np.isnan(tracks["band_rms"].sel(order=14.03).values).all()
    assert np.isnan(tracks["standard_error"].sel(order=14.03).values).all()


def test_where_nothing_is_seen_between_bins_the_error_is_not_infinite():
    made = made_map(noise=0.1)
    at = np.flatnonzero(np.abs(made["order"].values - 6.03) < 0.2)
    made["amplitude"].values[:, :, at] = 0.0
    track = order_tracks(made, [6.03], settings=SETTINGS)
    assert not np.isinf(track["standard_error"].values).any()
    assert np.isfinite(track["amplitude_high"].values).all()


def test_the_flags_of_the_map_are_those_of_its_tracks():
    flag = {"recording": "made", "flag": "lost_pulses", "severity": "info", "detail": "3"}
    made = with_flags(made_map(), [flag])
    assert flags_of(order_tracks(made, [2.0], settings=SETTINGS)) == flags_of(made)


def test_an_order_asked_for_twice_is_one_track():
    settings = SETTINGS.model_copy(update={"track_orders": (5.5, 5.5 + 1e-13, 2.0)})
    assert followed_orders(nothing_sought("", reason=""), settings) == [2.0, 5.5]


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_a_line_beside_a_resonance_of_the_noise_is_not_read_as_that(seed):
    """A small order between bins, while noise through a mode of 61 Hz passes under it from speed to speed."""
    draw = np.random.default_rng([seed, 300])
    order, amplitude, rate = 1.3125 + float(draw.uniform(-0.01, 0.01)), 0.1, 2048.0
    pole = 2.0 * np.pi * 61.0 * (-0.01 + 1j) / rate
    frames = []
    for number, speed in enumerate(np.linspace(1500.0, 3100.0, 9)):
        band, shaft = steady([line(order, amplitude, 1.0)], speed_rpm=float(speed), duration_s=12.0, rate_hz=rate)
        shaken = draw.normal(size=band["signal"].shape)
        rung = lfilter([1.0], [1.0, -2.0 * np.exp(pole).real, np.exp(2.0 * pole.real)], shaken, axis=-1)
        band["signal"].values[:] += 0.01 * shaken + 0.3 * rung / rung.std()
        band.attrs["recording"] = f"step {number}"
        frames.append(order_frames(band, shaft, settings=SETTINGS))
    tracks = order_tracks(order_map(frames, settings=SETTINGS), [order], settings=SETTINGS, frames=frames)
    low, high = tracks["amplitude_low"].values[0, 0], tracks["amplitude_high"].values[0, 0]
    assert np.mean((low <= amplitude) & (amplitude <= high)) >= 0.85


# Rows of two lines that no frame parts hold what each of them has, as often as their intervals say.


def drawn_pair(seed, *, off=0.0, highest=4.0, longest_s=20.0):
    """Reader, the two numbers as they are told (wrong by ``off`` cycles over the longest recording at most), amplitudes
    (2, rows), beats (rows,) of a locked order and a slipping one."""
    draw = np.random.default_rng(seed)
    locked = float(draw.integers(2, int(2 * highest) + 1)) / 2.0
    orders = [locked, locked * (1.0 + draw.choice([-1, 1]) * draw.uniform(0.004, 0.015))]
    speeds = np.linspace(900.0, 3000.0, int(draw.integers(3, 11)))
    duration = draw.uniform(5.0, longest_s)
    first = np.exp(draw.uniform(-1.0, 1.0, len(speeds)))
    sizes = np.array([first, first * 10.0 ** draw.uniform(-1.0, 1.0, len(speeds))])
    noise = 10.0 ** draw.uniform(-2.0, -0.5)
    frames = []
    for number, speed in enumerate(speeds):
        parts = [line(order, size[number], draw.uniform(0.0, 6.28)) for order, size in zip(orders, sizes, strict=True)]
        band, shaft = steady([total(*parts)], speed_rpm=speed, duration_s=duration, rate_hz=480.0)
        band["signal"].values[:] += noise * draw.normal(size=band["signal"].shape)
        band.attrs["recording"] = f"step {number}"
        frames.append(order_frames(band, shaft, settings=SETTINGS))
    beats = abs(orders[1] - orders[0]) * np.array([np.ptp(item["crank_angle"].values) for item in frames])
    told = [orders[0], orders[1] + off * draw.uniform(-1.0, 1.0) * abs(orders[1] - orders[0]) / beats.max()]
    return TrackReader(order_map(frames, settings=SETTINGS), frames=frames), told, sizes, beats


def missed(seeds, *, off=0.0):
    """Whether each row's interval misses its amplitude, how wide it is over the amplitude, and how often lines beat."""
    out, wide, beat = [], [], []
    for seed in seeds:
        reader, told, sizes, beats = drawn_pair(seed, off=off)
        for number in range(2):
            rows = reader.rows(told[number], [told[1 - number]])
            low, high = rows.amplitude_low[0], rows.amplitude_high[0]
            out.append((sizes[number] < low) | (sizes[number] > high))
            wide.append((high - low) / sizes[number])
            beat.append(beats)
    return np.concatenate(out), np.concatenate(wide), np.concatenate(beat)


@pytest.mark.slow
def test_intervals_of_drawn_pairs_cover_and_tell():
    out, wide, beats = missed(range(20))
    assert len(out) > 150
    assert out.mean() < 0.07
    assert np.median(wide[beats > 3.0]) < 0.2


@pytest.mark.slow
def test_a_wrong_number_widens_the_interval():
    out, _, beats = missed(range(100, 115), off=0.1)
    assert (beats > 1.5).mean() > 0.5
    assert out.mean() < 0.07


@pytest.mark.slow
def test_lines_that_hardly_beat_are_not_parted():
    out, reached = 0, 0
    for seed in range(200, 212):
        reader, told, sizes, beats = drawn_pair(seed, highest=1.5, longest_s=8.0)
        if beats.max() < 0.5:
            continue  # too near to be told as two by anyone
        unparted = beats < 1.5
        rows = reader.rows(told[1], [told[0]])
        assert (rows.amplitude_low[0, unparted] == 0.0).all()
        reached += int(unparted.sum())
        out += int((rows.amplitude_high[0, unparted] < sizes[1, unparted]).sum())
    assert reached > 20
    assert out <= 0.07 * reached


@pytest.mark.parametrize("seeds", [range(300, 303), pytest.param(range(303, 305), marks=pytest.mark.slow)])
def test_a_line_whose_slip_wanders_keeps_its_amplitude(seeds):
    for seed in seeds:
        draw = np.random.default_rng(seed)
        order, size, frames = 2.0 * (1.0 + draw.uniform(0.004, 0.015)), 10.0 ** draw.uniform(-1.0, 1.0), []
        for number, speed in enumerate((1500.0, 2400.0)):
            turn = 10.0 ** draw.uniform(0.0, 0.5) * np.sin(np.linspace(0.0, draw.uniform(2.0, 9.0), 5760))

            def slipping(_, angle, turn=turn, order=order, size=size):
                return size * np.cos(2.0 * np.pi * order * angle + turn)

            band, shaft = steady([total(line(2.0, 1.0), slipping)], speed_rpm=speed, duration_s=12.0, rate_hz=480.0)
            band["signal"].values[:] += 0.02 * draw.normal(size=band["signal"].shape)
            band.attrs["recording"] = f"step {number}"
            frames.append(order_frames(band, shaft, settings=SETTINGS))
        reader = TrackReader(order_map(frames, settings=SETTINGS), frames=frames)
        for told, other, wanted in ((order, 2.0, size), (2.0, order, 1.0)):
            rows = reader.rows(told, [other])
            assert ((rows.amplitude_low <= wanted) & (wanted <= rows.amplitude_high)).all()


# Orders followed by name through each recording, joined by speed.


ORDERS = (2.0, 5.48, 5.5)
TRUTH = np.array([1.0 * np.exp(0.4j), 0.3 * np.exp(1j), 0.5 * np.exp(-2j)])
SIGNAL = total(*(line(order, abs(value), np.angle(value)) for order, value in zip(ORDERS, TRUTH, strict=True)))


def asked(method, **changes):
    changes = {"track_orders": ORDERS, "track_method": method, "track_bandwidth": 0.01, **changes}
    return load_settings().orders.model_copy(update=changes)


def joined(recordings, settings):
    made = order_map([order_frames(*item, settings=settings) for item in recordings], settings=settings)
    tracks = order_tracks(made, [*ORDERS, 8.0], settings=settings)
    return with_followed(tracks, [followed_tracks(*item, settings=settings) for item in recordings])


def stepped():
    return [steady([SIGNAL], speed_rpm=speed, duration_s=40.0, rate_hz=1000.0) for speed in (900.0, 1200.0, 1500.0)]


def test_close_orders_are_followed_jointly_at_every_speed():
    settings = asked("vold_kalman", revs_per_frame=120)
    tracks = joined(stepped(), settings)
    check_dataset(tracks, "order_tracks")
    found = tracks["amplitude"].values[0, :3] * np.exp(1j * np.radians(tracks["phase"].values[0, :3]))
    np.testing.assert_allclose(found, np.repeat(TRUTH[:, None], 3, axis=1), atol=2e-6)
    assert tracks["track_method"].values.tolist() == ["vold_kalman"] * 3 + ["frames"]


@pytest.mark.cases(1)
@pytest.mark.parametrize("unit", ["order", "Hz"])
def test_a_run_up_is_followed_from_sample_to_sample(unit):
    recording = run_up([SIGNAL], from_rpm=1200, to_rpm=2400, duration_s=60.0, rate_hz=1000.0)
    width = {"order": 0.01, "Hz": 0.3}[unit]
    settings = asked("vold_kalman", track_bandwidth=width, track_bandwidth_unit=unit)
    tracks = followed_tracks(*recording, settings=settings)
    found = tracks["amplitude"].values[0]
    np.testing.assert_allclose(found, np.repeat(TRUTH[:, None], found.shape[1], axis=1), atol=1e-5)
    assert (np.diff(tracks["speed"].values) > 0).all()


def test_a_channel_that_is_missing_at_a_speed_stays_missing():
    recordings = stepped()
    band = recordings[1][0]
    band["usable"] = (band["signal"].dims, np.zeros(band["signal"].shape, dtype=bool), {"units": "1"})
    tracks = joined(recordings, asked("vold_kalman", track_orders=(2.0,), track_bandwidth=0.1))
    assert np.isnan(tracks["amplitude"].sel(order=2.0).values[0]).tolist() == [False, True, False]


@pytest.mark.parametrize("references", [("none", "none"), ("tdc", "pulse")])
def test_recordings_without_a_common_mark_are_joined_by_energy(references):
    recordings = [steady([SIGNAL], speed_rpm=900.0, duration_s=40.0, rate_hz=1000.0) for _ in references]
    for (_, angle), reference in zip(recordings, references, strict=True):
        angle.attrs["phase_reference"] = reference
    recordings[1][1]["crank_angle"].values[:] += 0.25  # half a cycle of order 2: a mean with phase would be 0
    tracks = joined(recordings, asked("vold_kalman", revs_per_frame=120)).sel(order=2.0)
    np.testing.assert_allclose(tracks["amplitude"].values, 1.0, atol=1e-6)
    assert np.isnan(tracks["phase"].values).all()


def test_by_crank_angle_without_a_speed_a_filter_by_time_is_refused():
    band, angle = steady([SIGNAL], speed_rpm=1200.0, duration_s=20.0, rate_hz=1000.0)
    band = band.rename(time="crank_angle")
    band.attrs |= {"domain": "crank_angle", "samples_per_rev": 50}
    angle["speed"].values[:] = np.nan
    with pytest.raises(InputError, match="needs a speed"):
        followed_tracks(band, angle, settings=asked("vold_kalman"))


def noisy(recording, generator, deviation):
    recording[0]["signal"].values[:] += generator.normal(0.0, deviation, recording[0]["signal"].shape)
    return recording


@pytest.mark.slow
@pytest.mark.parametrize(
    "amplitude", [pytest.param(0.0, marks=pytest.mark.accuracy), 0.02, pytest.param(0.1, marks=pytest.mark.accuracy)]
)
def test_intervals_of_an_average_without_common_phase_hold_a_small_amplitude(amplitude):
    generator = np.random.default_rng(5)
    inside, squares = [], []
    for _ in range(30):
        made = [
            steady([line(2.0, amplitude)], speed_rpm=1200.0, duration_s=5.0, rate_hz=500.0, start_rev=0.1 * k)
            for k in range(6)
        ]
        recordings = [noisy(one, generator, 1.0) for one in made]
        for number, (_, angle) in enumerate(recordings):
            angle.attrs["phase_reference"] = "none"
            angle["crank_angle"].values[:] += 0.237 * number
        tracks = joined(recordings, asked("vold_kalman", track_orders=(2.0,))).sel(order=2.0)
        inside.append(tracks["amplitude_low"].item() <= amplitude <= tracks["amplitude_high"].item())
        squares.append(tracks["amplitude"].item() ** 2)
    # 30 draws at 95 %: fewer than 25 inside happens three times in a thousand
    assert sum(inside) >= 25
    # noise alone adds 4 deviation² / samples to the square in each recording, 0.0016; what is cut off at 0 is half of
    # its scatter over six recordings
    assert np.mean(squares) - amplitude**2 < 0.0016


@pytest.mark.slow
@pytest.mark.parametrize("bandwidth", [0.01, 0.3])
def test_errors_of_a_mean_hold_where_the_filter_remembers_longer_than_a_frame(bandwidth):
    generator = np.random.default_rng(6)
    found, stated, inside = [], [], []
    for _ in range(40):
        recording = noisy(steady([line(2.0, 1.0)], speed_rpm=1200.0, duration_s=20.0, rate_hz=500.0), generator, 1.0)
        settings = asked("vold_kalman", track_orders=(2.0,), track_bandwidth=bandwidth)
        tracks = joined([recording], settings).sel(order=2.0)
        found.append(tracks["amplitude"].item())
        stated.append(tracks["standard_error"].item())
        inside.append(tracks["amplitude_low"].item() <= 1.0 <= tracks["amplitude_high"].item())
    # the scatter of 40 draws is right to 11 %
    assert 0.7 < np.std(found) / np.mean(stated) < 1.3
    assert sum(inside) >= 34
    assert 4.0 < tracks["degrees_of_freedom"].item() < 1000.0


def test_frames_of_a_filter_that_lie_in_a_gap_are_nan_and_do_not_count():
    band, angle = steady([line(2.0, 1.0), line(2.0, 1.0)], speed_rpm=1200.0, duration_s=20.0, rate_hz=500.0)
    noisy((band, angle), np.random.default_rng(1), 0.01)
    usable = np.ones(band["signal"].shape, dtype=bool)
    usable[0, 3100:6900] = False
    band["signal"].values[0, 3100:6900] = 50.0
    band["usable"] = (band["signal"].dims, usable, {"units": "1"})
    settings = asked("vold_kalman", track_orders=(2.0,), track_bandwidth=0.2)
    found = followed_tracks(band, angle, settings=settings)
    lost = np.isnan(found["amplitude"].values[:, 0])
    time_s = time_at(found["crank_angle"].values + 0.5 * found["revs"].values, **knots_of(angle))
    np.testing.assert_array_equal(lost[0], (time_s > 6.2) & (time_s < 13.8))
    assert not lost[1].any()
    tracks = joined([(band, angle)], settings).sel(order=2.0)
    np.testing.assert_allclose(tracks["amplitude"].values[:, 0], 1.0, atol=0.002)


def test_what_is_said_of_a_recording_and_of_its_orders_reaches_the_tracks():
    recording = steady([SIGNAL], speed_rpm=1200.0, duration_s=20.0, rate_hz=500.0)
    names = [flag["flag"] for flag in flags_of(joined([recording], asked("vold_kalman", track_orders=(2.0, 50.0))))]
    assert {"vold_kalman", "order_not_tracked"} <= set(names)
    assert len(names) == len(set(names))


def test_orders_beyond_half_the_sample_rate_alone_are_nan_for_a_filter():
    recording = steady([SIGNAL], speed_rpm=1200.0, duration_s=20.0, rate_hz=500.0)
    made = followed_tracks(*recording, settings=asked("vold_kalman", track_orders=(50.0, 60.0)))
    assert np.isnan(made["amplitude"].values).all()
    assert [flag["flag"] for flag in flags_of(made)] == ["order_not_tracked"] * 2


def test_a_filter_names_the_orders_that_it_cannot_tell_apart():
    recording = steady([SIGNAL], speed_rpm=1200.0, duration_s=10.0, rate_hz=500.0)
    settings = asked("vold_kalman", track_orders=(2.0, 5.5, 5.4999), track_bandwidth=0.3)
    with pytest.raises(RequestError, match=r"order 5\.5 and order 5\.4999 cannot be told apart"):
        followed_tracks(*recording, settings=settings)


def test_a_channel_without_usable_samples_is_nan_and_the_others_are_followed():
    band, angle = steady([line(2.0, 1.0), line(2.0, 3.0)], speed_rpm=1200.0, duration_s=10.0, rate_hz=500.0)
    band["signal"].values[0] = np.nan
    made = followed_tracks(band, angle, settings=asked("vold_kalman", track_orders=(2.0,), track_bandwidth=0.1))
    assert np.isnan(made["amplitude"].values[0]).all()
    np.testing.assert_allclose(np.abs(made["amplitude"].values[1]), 3.0, atol=1e-6)
    assert "usable samples" in flags_of(made)[-1]["detail"]
