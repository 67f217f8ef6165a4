"""Orders followed by name through each recording, joined by speed."""

import numpy as np
import pytest

from crankorder.errors import InputError, RequestError
from crankorder.orders.followed import followed_tracks, with_followed
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.track_rows import order_tracks
from crankorder.quantities import check_dataset, flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import knots_of, time_at
from made.recordings import line, run_up, steady, total

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


def without_mark(recordings):
    for number, (_, angle) in enumerate(recordings):
        angle.attrs["phase_reference"] = "none"
        angle["crank_angle"].values[:] += 0.237 * number
    return recordings


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
        recordings = without_mark([noisy(one, generator, 1.0) for one in made])
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
