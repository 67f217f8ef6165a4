"""Named orders read off the order map."""

from __future__ import annotations

import numpy as np

from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.track_rows import followed_orders, order_tracks
from crankorder.quantities import flags_of, with_flags
from crankorder.settings import load_settings
from made.recordings import line, steady

SETTINGS = load_settings().orders


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
    assert followed_orders(made_map(), {"orders": []}, settings) == [2.0, 5.5]
