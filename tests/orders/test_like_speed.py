"""Frames of unequal length in one test: what the longer ones become, and what they may not lose."""

import numpy as np
import pytest

from crankorder.orders.frames import order_frames
from crankorder.orders.like_speed import common_frames, reframed
from crankorder.orders.map import order_map
from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.speed_groups import held_speeds, speed_groups
from made.order_spectra import angle_frames, coloured, lines
from made.recordings import line, run_up, steady, total

SETTINGS = load_settings().orders


def frames_of(recording, **changes):
    return order_frames(*recording, settings=SETTINGS.model_copy(update=changes))


def a_steady_one(seed, noise=0.0):
    draw = np.random.default_rng(seed)
    orders = draw.choice(np.arange(1, 30), 5, replace=False) * 0.5
    parts = [line(o, draw.uniform(0.1, 3.0), draw.uniform(-3, 3)) for o in orders]
    band, shaft = steady([total(*parts)] * 2, speed_rpm=draw.uniform(600, 3000), duration_s=8.0, rate_hz=4096.0)
    band["signal"].values[:] += noise * draw.normal(size=band["signal"].shape)
    return band, shaft


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("revs", [8, 4])
def test_frames_cut_from_longer_ones_are_those_that_the_samples_give(seed, revs):
    recording = a_steady_one(seed, noise=0.3)
    cut = reframed(frames_of(recording), revs)
    direct = frames_of(recording, revs_per_frame=revs, overlap=1.0 - 2.0 / revs)
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
    steady_one = frames_of(a_steady_one(1))
    swept = frames_of(run_up([line(2.0, 1.0)] * 2, from_rpm=600.0, to_rpm=5000.0, duration_s=6.0, rate_hz=4096.0))
    length = swept.attrs["revs_per_frame"]
    assert length < steady_one.attrs["revs_per_frame"]
    assert "frames_shortened" in {flag["flag"] for flag in flags_of(swept)}
    used, flags = common_frames([steady_one, swept])
    assert [item.attrs["revs_per_frame"] for item in used] == [length, length]
    assert [flag["flag"] for flag in flags] == ["frames_cut"]
    made = order_map([steady_one, swept], settings=SETTINGS)
    assert not [flag for flag in flags_of(made) if flag["severity"] == "bad"]
    at = np.abs(made["speed"].values - float(steady_one["speed"].values[0])).argmin()
    assert made["n_frames"].values[at] > 10


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("revs", [13, 15, 18])
def test_frames_of_nearly_the_common_length_are_shown_on_its_orders(seed, revs):
    draw = np.random.default_rng(100 + seed)
    parts = [
        (o, draw.uniform(0.1, 3.0), draw.uniform(-3, 3)) for o in draw.choice(np.arange(1, 30), 5, replace=False) * 0.5
    ]
    rpm = draw.uniform(600, 3000)
    rotor = {"speed_rpm": rpm, "duration_s": (revs + 0.6) * 60.0 / rpm, "rate_hz": 4096.0}
    short = frames_of(steady([total(*(line(*part) for part in parts))] * 2, **rotor), revs_per_frame=revs)
    assert short.attrs["revs_per_frame"] == revs - revs % 2  # whole cycles
    long = frames_of(a_steady_one(seed), revs_per_frame=16)
    used, flags = common_frames([long, long, short])
    own = used[2] if revs != 16 else short
    assert own.attrs["revs_per_frame"] == 16 and own.sizes["order"] == used[0].sizes["order"]
    assert {flag["flag"] for flag in flags} <= {"frames_on_common_orders", "orders_cut"}
    for order, amplitude, phase in parts:
        seen = own["spectrum"].sel(order=order).values
        np.testing.assert_allclose(seen, amplitude * np.exp(1j * phase), atol=0.01 * max(a for _, a, _ in parts))


def test_a_gap_in_a_long_frame_is_one_in_all_shorter_ones_that_touch_it():
    band, shaft = a_steady_one(2)
    usable = np.ones(band["signal"].shape, dtype=bool)
    usable[0, 12000:12100] = False
    band["usable"] = (("channel", "time"), usable, {"units": "1"})
    cut = reframed(frames_of((band, shaft)), 8)
    assert np.isnan(cut["spectrum"].values[0].real).any()
    assert np.isfinite(cut["spectrum"].values[1].real).all()
    assert np.isfinite(cut["spectrum"].values[0].real).any()


def held(rng, rpm: float, amplitude: float, phase: float = 0.3, *, order: float = 2.0, frames: int = 20, **attrs):
    """A recording of two channels at ``rpm`` with one line, and noise of a third."""
    noise = 0.3 * coloured(rng, 2, revs=8 * (frames + 1), colour="white")
    speed = rpm + 0.05 * rng.standard_normal(frames)
    made = angle_frames(noise + lines(noise.shape[1], [(order, amplitude, phase)]), speed=speed, name=str(rpm))
    made.attrs |= attrs
    return made


def rows(*recordings) -> list[float]:
    return [round(float(rpm)) for rpm in order_map(list(recordings), settings=SETTINGS)["speed"].values]


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(5))
def test_speeds_20_rpm_apart_share_a_row_where_all_agrees_and_else_have_their_own(seed):
    rng = np.random.default_rng(seed)
    first = held(rng, 1000.0, 1.0)
    assert rows(first, held(rng, 1020.0, 1.0)) == [1010]
    assert rows(first, held(rng, 1020.0, 0.15)) == [1000, 1020]
    assert rows(first, held(rng, 1020.0, 1.0, 1.3)) == [1000, 1020]
    # a line that slips has no phase; its energy tells
    slips = [held(rng, rpm, size, order=2.03) for rpm, size in ((1000.0, 1.0), (1020.0, 0.3))]
    assert rows(*slips) == [1000, 1020]


def test_without_a_common_phase_only_sizes_are_compared():
    rng = np.random.default_rng(3)
    given = [held(rng, rpm, 1.0, phase, phase_reference="none") for rpm, phase in ((1000.0, 0.0), (1020.0, 2.0))]
    assert rows(*given) == [1010]


def test_repeats_at_one_speed_share_a_row_whatever_they_show():
    rng = np.random.default_rng(4)
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
    made = order_map([angle_frames(noise + grown, speed=speed)], settings=SETTINGS)
    assert made.sizes["speed"] == len(speed_groups(speed, width_rpm=25.0))
