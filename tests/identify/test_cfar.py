"""Noise stands over the level as often as is stated, the floor's own error included."""

import numpy as np
import pytest

from crankorder.identify.lines.line_evidence import independent_bins, noise_floor, noise_level, reference_bins
from crankorder.identify.lines.order_lines import order_lines
from crankorder.identify.modes.floor import quiet_floor
from crankorder.identify.modes.search import search
from crankorder.orders.map import order_map
from made.floors import Made, campbell_of
from made.line_frames import PER_REV, frames_of, rung
from made.shipped import SETTINGS

AXIS = np.arange(321) / 16
BINS = reference_bins(AXIS, line_step=0.5, guard_bins=2, n_bins=16)


def noise_energy(rng, n_frames, shape):
    """Energies (1, 100, orders) of noise of the power ``shape`` in frames with the Hann window's neighbours alike."""
    size = (100, n_frames, len(AXIS) + 2)
    white = (rng.standard_normal(size) + 1j * rng.standard_normal(size)) * np.sqrt(np.pad(shape, 1, mode="edge") / 2)
    windowed = (white[..., 1:-1] - 0.5 * (white[..., 2:] + white[..., :-2])) / np.sqrt(1.5)
    return (np.abs(windowed) ** 2).mean(axis=1)[None]


def share_over(n_frames, shape, chance, repeats):
    """Share of noise at each order that stands over the level."""
    rng, over = np.random.default_rng(n_frames), np.zeros(len(AXIS))
    near = BINS[:, 5:11]
    levels = [noise_level(float(n_frames), independent_bins(bins), chance) for bins in (BINS, near)]
    for _ in range(repeats):
        energy = noise_energy(rng, n_frames, shape)
        floor, narrowed = noise_floor(energy, BINS, n_averages=np.full(100, float(n_frames)))
        over += (energy / floor > np.where(narrowed, levels[1], levels[0])).mean(axis=(0, 1))
    return over / repeats


@pytest.mark.parametrize("n_frames", [1, 20])
def test_white_noise_stands_over_the_level_no_more_often_than_stated(n_frames):
    share = share_over(n_frames, np.ones(len(AXIS)), 1e-3, repeats=20)[16:].mean()
    assert 0.4e-3 < share < 1.15e-3  # 2000 x 305 bins: 6e5 trials, of which 600 +- 40 are expected over it


def noise_only(seed):
    """Lines found in a test of ten speeds and two channels of noise, resonances included."""
    rng, frames = np.random.default_rng(seed), []
    mode_hz, damping = rng.uniform(20.0, 300.0), 10.0 ** rng.uniform(-2.5, -1.0)
    for rpm in np.arange(800.0, 1800.0, 100.0):
        noise = rng.standard_normal((2, 100 * PER_REV))
        frames.append(frames_of([rung(row, 60.0 * mode_hz / rpm, damping) for row in noise], speed_rpm=rpm))
    made = order_map(frames, settings=SETTINGS.orders)
    return len(order_lines(made, settings=SETTINGS.identify, orders=SETTINGS.orders, frames=frames))


def test_noise_through_resonances_makes_no_line_in_fifteen_tests():
    assert sum(noise_only(seed) for seed in range(15)) == 0


# What strong lines leak: no cell of the floor holds it, at however few speeds.


def _made(speeds, amplitude):
    return Made(
        natural_hz=(300.0,), damping=(0.02,), sensor=((0.0,),), drive=((0.0,),), speed_rpm=speeds,
        lines=((6.0, amplitude),), duration_s=6.0, noise=1e-3,
    )  # fmt: skip


@pytest.mark.parametrize("speeds", [(1113.5,), (573.0, 1541.0, 2475.0)])
def test_the_skirts_of_a_giant_line_are_no_floor_and_no_mode(speeds):
    """130 dB over the noise of a bin a Hann window leaks over sixty bins."""
    campbell = campbell_of(_made(speeds, 1000.0), 0)
    floor = quiet_floor(campbell, ((6.0, 1e-6),))
    level = np.nanmedian(floor.cells)
    assert np.nanmax(floor.cells) < 12.0 * level  # some noise of some six frames
    assert np.isfinite(floor.psd).mean() > 0.5
    _, fit, _ = search(floor, chance=1e-3)
    assert not len(fit.poles)


def test_a_line_leaks_though_the_frames_that_hold_it_are_taken_for_a_start():
    campbell = campbell_of(_made((1200.0, 2400.0), 300.0), 5)
    bins = np.flatnonzero(np.abs(campbell["frequency"].values - 120.0) < 4.0)
    none = np.full((1, 2, len(bins)), np.nan)
    moved = campbell.assign(
        settled_psd=(("channel", "speed", "settled_frequency"), none),
        settled_share=(("channel", "speed", "settled_frequency"), np.zeros(none.shape)),
    ).assign_coords(settled_frequency=campbell["frequency"].values[bins])
    floor = quiet_floor(moved, ((6.0, 1e-6),))
    beside = np.abs(floor.frequency_hz - 120.0) < 12.0
    assert not np.isfinite(floor.cells[0, 0, beside]).any()
