"""Rows of two lines that no frame parts hold what each of them has, as often as their intervals say."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.track_rows import TrackReader
from crankorder.settings import load_settings
from made.recordings import line, steady, total

SETTINGS = load_settings().orders


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
