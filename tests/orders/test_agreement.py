"""Rows of the map: speeds that are held share one only where their numbers agree; run-ups fall into bins."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from crankorder.shaft.speed_groups import held_speeds, speed_groups
from made.order_spectra import angle_frames, coloured, lines

SETTINGS = load_settings().orders


def held(rng, rpm: float, amplitude: float, phase: float = 0.3, *, order: float = 2.0, frames: int = 20, **attrs):
    """A recording of two channels at ``rpm`` with one line, and noise of a third."""
    noise = 0.3 * coloured(rng, 2, revs=8 * (frames + 1), colour="white")
    speed = rpm + 0.05 * rng.standard_normal(frames)
    made = angle_frames(noise + lines(noise.shape[1], [(order, amplitude, phase)]), speed=speed, name=str(rpm))
    made.attrs |= attrs
    return made


def rows(*recordings) -> list[float]:
    return [round(float(rpm)) for rpm in order_map(list(recordings), settings=SETTINGS)["speed"].values]


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
