"""Every track stands at the order that was found: amplitudes at exact orders, beside others, and through sweeps."""

import numpy as np
import pytest

from crankorder.findings import nothing_sought
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.swept_tracks import swept_tracks
from crankorder.orders.track_rows import TrackReader, followed_orders, order_tracks
from crankorder.quantities import flags_of, with_flags
from crankorder.settings import load_settings
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


def test_a_line_between_bins_reads_its_amplitude_at_its_exact_order():
    draw = np.random.default_rng(100)
    order, amplitude = draw.uniform(0.7, 18.0), draw.uniform(0.5, 5.0)
    order += 0.01 * (abs(order * 16 - round(order * 16)) < 0.1)
    frames, made = steady_test([line(order, amplitude, 1.0)], seed=0)
    tracks = order_tracks(made, [order], settings=SETTINGS, frames=frames)
    value = tracks["amplitude"].values[0, 0]
    assert value == pytest.approx(amplitude, rel=0.01)
    low, high = tracks["amplitude_low"].values[0, 0], tracks["amplitude_high"].values[0, 0]
    assert np.mean((low <= amplitude) & (amplitude <= high)) > 0.5


def test_a_line_beside_a_stronger_one_is_told_from_it():
    draw = np.random.default_rng(200)
    locked = float(draw.integers(1, 10))
    order = locked + draw.choice([-1, 1]) * draw.uniform(0.045, 0.12)
    frames, made = steady_test([line(locked, 3.0), line(order, 1.0, 2.0)], seed=0)
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
    made = made_map(rate_hz=600.0, noise=0.1)  # 12 orders
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


# Close orders, named by the user: solved together in the frames of held speeds, followed together through sweeps.


ORDERS = (2.0, 5.48, 5.5)
TRUTH = np.array([1.0 * np.exp(0.4j), 0.3 * np.exp(1j), 0.5 * np.exp(-2j)])
SIGNAL = total(*(line(order, abs(value), np.angle(value)) for order, value in zip(ORDERS, TRUTH, strict=True)))


def swept_pair(*signals):
    return run_up(list(signals), from_rpm=1200, to_rpm=2400, duration_s=60.0, rate_hz=1000.0)


def test_close_orders_are_solved_together_at_every_held_speed():
    frames = [
        order_frames(*steady([SIGNAL], speed_rpm=speed, duration_s=40.0, rate_hz=1000.0), settings=SETTINGS)
        for speed in (900.0, 1200.0, 1500.0)
    ]
    tracks = order_tracks(order_map(frames, settings=SETTINGS), list(ORDERS), settings=SETTINGS, frames=frames)
    np.testing.assert_allclose(tracks["amplitude"].values[0], np.repeat(np.abs(TRUTH)[:, None], 3, axis=1), rtol=1e-3)
    assert set(tracks["track_method"].values.tolist()) == {"frames"}


def test_close_orders_are_followed_together_through_a_run_up_each_once():
    tracks = swept_tracks(*swept_pair(SIGNAL), [*ORDERS, 2.0 + 1e-13])
    found = tracks["amplitude"].values[0]
    np.testing.assert_allclose(found, np.repeat(TRUTH[:, None], found.shape[1], axis=1), atol=1e-5)
    assert (np.diff(tracks["speed"].values) > 0).all()


def test_orders_too_near_to_be_followed_with_others_are_said_to_be():
    tracks = swept_tracks(*swept_pair(SIGNAL), [2.0, 5.5, 5.4999])
    assert [flag["flag"] for flag in flags_of(tracks)] == ["order_not_tracked"]
    assert "differ too much; found 0.001 and" in flags_of(tracks)[0]["detail"]


def test_an_order_beyond_half_the_sample_rate_is_nothing_and_named():
    tracks = swept_tracks(*swept_pair(SIGNAL), [2.0, 50.0])
    assert np.isnan(tracks["amplitude"].values[0]).all(axis=1).tolist() == [False, True]
    assert [flag["flag"] for flag in flags_of(tracks)] == ["followed_in_sweep", "order_not_tracked"]


def test_where_a_channel_holds_nothing_its_rows_are_nothing_and_those_of_others_stay():
    band, shaft = swept_pair(*[line(2.0, 1.0)] * 3)
    band["signal"].values[:] += 0.01 * np.random.default_rng(1).normal(size=band["signal"].shape)
    usable = np.ones(band["signal"].shape, dtype=bool)
    usable[0, 20_000:35_000] = False
    usable[1] = False
    band["signal"].values[~usable] = 50.0
    band["usable"] = (band["signal"].dims, usable, {"units": "1"})
    tracks = swept_tracks(band, shaft, [2.0])
    lost, time_s = np.isnan(tracks["amplitude"].values[:, 0]), tracks["time"].values
    np.testing.assert_array_equal(lost[0], (time_s > 20.0) & (time_s < 35.0))
    assert lost[1].all() and not lost[2].any()
    np.testing.assert_allclose(np.abs(tracks["amplitude"].values[[0, 2], 0])[~lost[[0, 2]]], 1.0, atol=0.004)
