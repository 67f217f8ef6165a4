"""Orders followed by name: the same truth by every method, joined by speed."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.orders.followed import followed_tracks, with_followed
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.tracks import order_tracks
from crankorder.quantities import check_dataset
from crankorder.settings import load_settings
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


@pytest.mark.parametrize("method", ["least_squares", "vold_kalman"])
def test_close_orders_are_followed_jointly_at_every_speed(method):
    settings = asked(method, revs_per_frame=120)
    tracks = joined(stepped(), settings)
    check_dataset(tracks, "order_tracks")
    found = tracks["amplitude"].values[0, :3] * np.exp(1j * np.radians(tracks["phase"].values[0, :3]))
    np.testing.assert_allclose(found, np.repeat(TRUTH[:, None], 3, axis=1), atol=2e-6)
    assert tracks["track_method"].values.tolist() == [method] * 3 + ["frames"]


def test_the_map_alone_mixes_them():
    tracks = joined(stepped(), asked("frames"))
    assert tracks["track_method"].values.tolist() == ["frames"] * 4
    assert np.abs(tracks["amplitude"].sel(order=5.48).values - 0.3).min() > 0.05


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
    tracks = joined(recordings, asked("least_squares", revs_per_frame=120))
    assert np.isnan(tracks["amplitude"].values[0, 0]).tolist() == [False, True, False]


def test_recordings_without_a_common_phase_are_joined_by_energy():
    recordings = [steady([SIGNAL], speed_rpm=900.0, duration_s=40.0, rate_hz=1000.0, start_rev=r) for r in (0.0, 0.3)]
    for _, angle in recordings:
        angle.attrs["phase_reference"] = "none"
        angle["crank_angle"].values[:] += 0.21 * len(angle.attrs)
    recordings[1][1]["crank_angle"].values[:] += 0.37
    tracks = joined(recordings, asked("least_squares", revs_per_frame=120))
    assert np.isnan(tracks["phase"].sel(order=2.0).values).all()
    np.testing.assert_allclose(tracks["amplitude"].sel(order=2.0).values, 1.0, atol=1e-6)


def test_intervals_of_followed_orders_hold_the_truth():
    generator = np.random.default_rng(3)
    inside = []
    for _ in range(30):
        band, angle = steady([SIGNAL], speed_rpm=1200.0, duration_s=20.0, rate_hz=1000.0)
        band["signal"].values[:] += generator.normal(0.0, 0.5, band["signal"].shape)
        tracks = joined([(band, angle)], asked("least_squares", revs_per_frame=100))
        low, high = (tracks[f"amplitude_{end}"].values[0, :3, 0] for end in ("low", "high"))
        inside.append((low <= np.abs(TRUTH)) & (np.abs(TRUTH) <= high))
    # 90 draws at 95 %: fewer than 79 inside happens once in a thousand
    assert np.sum(inside) >= 79


def test_by_crank_angle_without_a_speed_a_filter_by_time_is_refused():
    band, angle = steady([SIGNAL], speed_rpm=1200.0, duration_s=20.0, rate_hz=1000.0)
    band = band.rename(time="crank_angle")
    band.attrs |= {"domain": "crank_angle", "samples_per_rev": 50}
    angle["speed"].values[:] = np.nan
    with pytest.raises(InputError, match="needs a speed"):
        followed_tracks(band, angle, settings=asked("vold_kalman"))
