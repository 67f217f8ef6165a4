"""Levels of run-ups: windows that follow the sweep, with intervals that hold the level that was put in."""

import numpy as np
import pytest
import xarray as xr
from scipy import signal

from crankorder.campbell.band_levels import LevelBand, level_frames, limit_bands
from crankorder.campbell.vibration_levels import vibration_levels
from crankorder.identify.levels import limit_verdicts
from crankorder.identify.sources import Limit, Sources
from made.recordings import sampled, shaft

RATE_HZ = 5120.0
BAND = (LevelBand("as measured", 10.0, 1000.0),)


def swept(
    seed: int, *, seconds: float, size: float = 1.0, down: bool = False
) -> tuple[xr.Dataset, np.ndarray, np.ndarray]:
    """LevelFrames of a run-up through a resonance, and the speed and mean square (sample,) that was put in."""
    rng = np.random.default_rng(seed)
    at = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    first, last = rng.uniform(600.0, 1200.0), rng.uniform(2200.0, 3600.0)
    rpm = (np.geomspace if seed % 2 else np.linspace)(*((last, first) if down else (first, last)), at.size)
    turns = np.cumsum(rpm / 60.0) / RATE_HZ
    middle, width = rng.uniform(900.0, 3000.0), rng.uniform(150.0, 600.0)
    line = size * rng.uniform(0.3, 2.0) * (1.0 + 5.0 / (1.0 + ((rpm - middle) / width) ** 2))
    noise = size * rng.uniform(0.3, 1.5) * (rpm / 1500.0)
    ends = (15.0, 45.0) if seed % 3 else (30.0, 700.0)
    shape = signal.butter(4, ends, "band", fs=RATE_HZ, output="sos")
    hertz, gain = signal.sosfreqz(shape, 16384, fs=RATE_HZ)
    power = float(np.mean(np.abs(gain) ** 2 * ((hertz > 10.0) & (hertz < 1000.0))))
    shaped = signal.sosfilt(shape, rng.standard_normal(at.size))
    values = line * np.cos(2 * np.pi * 2.0 * turns + 1.0) + noise * shaped / np.sqrt(power)
    one = sampled(values[None], recording=f"{seed} {down}", rate_hz=RATE_HZ).assign(si_per_unit=("channel", [1.0]))
    knots = slice(None, None, 64)
    frames = level_frames(one, shaft(at[knots], turns[knots], rpm[knots]), bands=BAND, frame_s=0.5)
    return frames, rpm, 0.5 * line**2 + noise**2


def true_levels(made: xr.Dataset, rpm: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Root mean square that was put in about the mean speed of each row, over as long as its pieces."""
    speeds = made["speed"].values
    parts = np.split(square, np.searchsorted(rpm, 0.5 * (speeds[1:] + speeds[:-1])))
    return np.sqrt([part.mean() for part in parts])


@pytest.mark.parametrize(
    ("runs", "least", "most"), [(8, 0.87, 1.0), pytest.param(60, 0.92, 0.995, marks=pytest.mark.slow)]
)
def test_a_run_up_is_told_in_windows_along_it_whose_intervals_hold_the_level(
    runs: int, least: float, most: float
) -> None:
    hits, rows, wide = 0, 0, []
    for seed in range(runs):
        seconds = float(np.random.default_rng(seed).uniform(8.0, 30.0))
        frames, rpm, square = swept(seed, seconds=seconds)
        made = vibration_levels([frames], speed_bin_rpm=25.0)
        assert made.sizes["speed"] >= int((seconds - 1.0) / 1.2) - 1
        truth = true_levels(made, rpm, square)[1:-1]  # the first and the last reach to the ends, which are left out
        low, high = made["rms_ci95"].values[0, 1:-1].T
        hits, rows = hits + int(np.sum((low <= truth) & (truth <= high))), rows + len(truth)
        wide.append(float(np.median(high / low)))
    assert least < hits / rows <= most, hits / rows
    assert np.median(wide) < 1.5


@pytest.mark.slow
def test_where_run_ups_differ_the_interval_is_that_between_them() -> None:
    """A machine that is three times as loud on the way down: each row holds what both ways show."""
    held = 0
    for seed in range(12):
        up, down = (swept(seed, seconds=15.0, size=one, down=way)[0] for one, way in ((1.0, False), (3.0, True)))
        made = vibration_levels([up, down], speed_bin_rpm=25.0)
        alone = [vibration_levels([one], speed_bin_rpm=25.0) for one in (up, down)]
        low, high = made["rms_ci95"].values[0].T
        ways = [np.interp(made["speed"].values, one["speed"].values, one["rms"].values[0]) for one in alone]
        inside = [np.mean((low < way) & (way < high)) for way in ways]
        held += min(inside) > 0.8
    assert held >= 11


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 6), marks=pytest.mark.slow)])
def test_a_limit_that_the_end_of_a_window_passes_is_not_kept_by_its_mean(seeds: range) -> None:
    """A level that grows with the cube of speed: what is to be surely within is told at the louder end."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        at = np.arange(int(rng.uniform(6.0, 12.0) * RATE_HZ)) / RATE_HZ
        rpm = np.linspace(900.0, 3600.0, at.size)
        turns = np.cumsum(rpm / 60.0) / RATE_HZ
        line = (rpm / 1500.0) ** 3
        values = line * np.cos(2 * np.pi * 2.0 * turns) + 0.02 * rng.standard_normal(at.size)
        one = sampled(values[None], recording="a", rate_hz=RATE_HZ).assign(si_per_unit=("channel", [1.0]))
        knots = slice(None, None, 64)
        angle = shaft(at[knots], turns[knots], rpm[knots])
        frames = level_frames(one, angle, bands=limit_bands("acceleration", 10.0, 1000.0), frame_s=0.5)
        made = vibration_levels([frames], speed_bin_rpm=25.0)
        last_piece = np.sqrt(float(frames["mean_square"][0, -1]))  # what was there at the end
        loudest = float(made["rms"].values[0].max())
        assert last_piece > 1.04 * loudest
        sources = [Sources(1, limits=(Limit("acceleration", 10.0, 1000.0, one, "x", ()),)) for one in
                   (1.02 * loudest, 0.99 * last_piece, 1.2 * last_piece)]  # fmt: skip
        told = [limit_verdicts(made, None, one)[0] for one in sources]
        assert [one.verdict for one in told] == ["not decided", "not decided", "within"]
        assert "sweep more slowly" in told[0].evidence
        assert " rpm" in told[2].evidence
