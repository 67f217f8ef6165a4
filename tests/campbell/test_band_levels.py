"""Overall levels in bands and one-third octaves, against analytic signals, Parseval and integration by others."""

import numpy as np
import pytest
from scipy import signal

from crankorder.campbell.levels import THIRD_OCTAVES_HZ, LevelBand, level_frames, limit_bands, nominal_hz, third_octaves
from crankorder.campbell.vibration_levels import vibration_levels
from crankorder.identify.levels import limit_verdicts
from crankorder.identify.machine_model import Limit, MachineModel
from crankorder.quantities import check_dataset
from made.recordings import accelerometer, held, shaft

RATE_HZ = 8192.0
WIDE = (LevelBand("velocity", 10.0, 1000.0), LevelBand("as measured", 10.0, 1000.0))


def levels(*recordings, bands=WIDE):
    items = []
    for one in recordings:
        angle = held(1500.0, one.sizes["time"] / one.attrs["rate_hz"])
        items.append(level_frames(one, angle, bands=bands, frame_s=0.5))
        check_dataset(items[-1], "level_frames")
    made = vibration_levels(items, speed_bin_rpm=25.0)
    check_dataset(made, "vibration_levels")
    return made.isel(speed=0)


def at_times(seconds, rate_hz=RATE_HZ):
    return np.arange(int(seconds * rate_hz)) / rate_hz


@pytest.mark.parametrize("seed", range(2))
def test_the_velocity_of_lines_is_the_analytic_one(seed):
    rng = np.random.default_rng(seed)
    hertz, size = rng.uniform(13.0, 850.0, 5), rng.uniform(0.1, 10.0, 5)
    phase, at = rng.uniform(0.0, 2 * np.pi, 5), at_times(20.0)
    outside = 50.0 * np.cos(2 * np.pi * rng.uniform(1300.0, 3500.0) * at) + rng.uniform(-20.0, 20.0)
    values = outside + sum(a * np.cos(2 * np.pi * f * at + p) for a, f, p in zip(size, hertz, phase, strict=True))
    made = levels(accelerometer(values, RATE_HZ))
    velocity = 1e3 * size / (2 * np.pi * hertz)
    assert float(made["rms"][0]) == pytest.approx(np.sqrt(0.5 * velocity @ velocity), rel=5e-3)
    assert float(made["rms"][1]) == pytest.approx(np.sqrt(0.5 * size @ size), rel=5e-3)
    assert made["unit"].values.tolist() == ["mm/s", "m/s2"]


def test_peak_and_crest_factor_of_a_sine_and_of_a_beat():
    at = at_times(20.0)
    sine = levels(accelerometer(3.0 * np.cos(2 * np.pi * 97.3 * at), RATE_HZ))
    assert float(sine["crest_factor"][1]) == pytest.approx(np.sqrt(2.0), rel=3e-3)
    assert [float(sine[key][1]) for key in ("peak", "largest_peak")] == pytest.approx([3.0, 3.0], rel=3e-3)
    assert float(sine["largest_peak"][0]) == pytest.approx(3e3 / (2 * np.pi * 97.3), rel=3e-3)
    beat = levels(accelerometer(np.cos(2 * np.pi * 96.0 * at) + np.cos(2 * np.pi * 104.0 * at), RATE_HZ))
    assert float(beat["crest_factor"][1]) == pytest.approx(2.0, rel=0.01)  # 2 / sqrt(2 / 2)


def test_one_third_octaves_hold_all_the_energy_between_their_ends():
    """Parseval: the squares of all octaves add up to that of the whole band."""
    rng, rate = np.random.default_rng(3), 51200.0
    low, high = THIRD_OCTAVES_HZ[3] / 10**0.05, THIRD_OCTAVES_HZ[30] * 10**0.05
    values = rng.standard_normal(int(20 * rate))
    made = levels(accelerometer(values, rate), bands=(LevelBand("as measured", low, high), *third_octaves()))
    octaves = made.isel(level=slice(4, 32))
    assert float(octaves["low_frequency"][0]) == pytest.approx(low)
    assert float(octaves["high_frequency"][-1]) == pytest.approx(high)
    assert float(np.sum(octaves["rms"] ** 2)) == pytest.approx(float(made["rms"][0]) ** 2, rel=1e-3)
    expected = np.sqrt(2.0 / rate * (octaves["high_frequency"] - octaves["low_frequency"]))
    assert np.abs(octaves["rms"] / expected - 1.0)[8:].max() < 0.06


def test_a_line_is_in_its_own_octave_alone_and_names_are_nominal():
    names = [nominal_hz(one) for one in THIRD_OCTAVES_HZ]
    assert names[:6] == [10.0, 12.5, 16.0, 20.0, 25.0, 31.5]
    assert names[-3:] == [12500.0, 16000.0, 20000.0]
    line = accelerometer(2.0 * np.cos(2 * np.pi * 250.0 * at_times(10.0)), RATE_HZ)
    made = levels(line, bands=(*WIDE, *third_octaves()))
    thirds = made.isel(level=slice(2, None))
    own = int(np.argmax(thirds["rms"].values))
    assert nominal_hz(float(np.sqrt(thirds["low_frequency"][own] * thirds["high_frequency"][own]))) == 250.0
    assert float(thirds["rms"][own]) == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert float(np.delete(thirds["rms"].values, own).max()) < 2e-3


@pytest.mark.parametrize("seed", range(100, 102))
def test_no_octave_that_holds_nothing_is_surely_told_beside_a_line(seed):
    rng = np.random.default_rng(seed)
    hertz, at = 10.0 ** rng.uniform(1.2, 3.4), at_times(rng.uniform(4.0, 25.0))
    line = accelerometer(np.cos(2 * np.pi * hertz * at + rng.uniform(0.0, 6.0)), RATE_HZ)
    made = levels(line, bands=(*WIDE, *third_octaves()))
    thirds = made.isel(level=slice(2, None))
    empty = (thirds["low_frequency"].values > 1.3 * hertz) | (thirds["high_frequency"].values < hertz / 1.3)
    assert not (thirds["rms_ci95"].values[empty, 0] > 0.0).any()
    # a line between two octaves is shared by both
    assert thirds["rms_ci95"].values[int(np.nanargmax(thirds["rms"].values)), 0] > 0.49


@pytest.mark.slow
def test_intervals_of_levels_cover_the_truth_behind_noise():
    rate, hits = 4096.0, np.zeros(2)
    bands = (LevelBand("as measured", 10.0, 1000.0), LevelBand("as measured", 178.0, 224.0))
    truth = np.sqrt([2.0 / rate * (band.high_hz - band.low_hz) for band in bands])  # of white noise
    for seed in range(400):
        values = np.random.default_rng(seed).standard_normal(int((4.0, 12.0)[seed % 2] * rate))
        low, high = levels(accelerometer(values, rate), bands=bands)["rms_ci95"].values[:2].T
        hits += (low <= truth) & (truth <= high)
    assert np.all((hits / 400 > 0.92) & (hits / 400 < 0.98)), hits


def test_a_band_beyond_the_recorder_says_where_it_ends_and_a_pressure_has_no_velocity():
    slow = levels(accelerometer(np.random.default_rng(0).standard_normal(9520), 952.0))
    assert slow["reached_frequency"].values.tolist() == pytest.approx([952.0 / 2.56] * 2)
    pressure = accelerometer(np.random.default_rng(0).standard_normal(40960), RATE_HZ)
    pressure["quantity"], pressure["unit"] = ("channel", np.array(["pressure"])), ("channel", np.array(["Pa"]))
    assert levels(pressure)["quantity"].values.tolist() == ["pressure"]


def test_missing_samples_take_no_part_and_short_recordings_have_no_level():
    at = at_times(10.0)
    values = np.cos(2 * np.pi * 50.0 * at)
    values[30_000:31_000] = np.nan
    assert float(levels(accelerometer(values, RATE_HZ))["rms"][1]) == pytest.approx(np.sqrt(0.5), rel=0.01)
    made = level_frames(accelerometer(values[:800], RATE_HZ), held(1500.0, 0.1), bands=WIDE, frame_s=0.5)
    assert made.sizes["frame"] == 0


def test_blocks_of_a_long_recording_meet_without_a_seam(monkeypatch):
    values = np.cumsum(np.random.default_rng(5).standard_normal(int(60 * 2560.0)))
    whole = levels(accelerometer(values, 2560.0), bands=(*WIDE, *third_octaves()))
    monkeypatch.setattr("crankorder.campbell.levels._STRETCH", 1 << 15)
    parts = levels(accelerometer(values, 2560.0), bands=(*WIDE, *third_octaves()))
    wide = slice(0, 2)
    assert parts["rms"].values[wide] == pytest.approx(whole["rms"].values[wide], rel=2e-3)
    assert parts["rms"].values == pytest.approx(whole["rms"].values, rel=0.03)


# Levels of run-ups: windows that follow the sweep, with intervals that hold the level that was put in.


SWEEP_HZ = 5120.0
BAND = (LevelBand("as measured", 10.0, 1000.0),)


def swept(seed, *, seconds, size=1.0, down=False):
    """LevelFrames of a run-up through a resonance, and the speed and mean square (sample,) that was put in."""
    rng, n_samples = np.random.default_rng(seed), int(seconds * SWEEP_HZ)
    first, last = rng.uniform(600.0, 1200.0), rng.uniform(2200.0, 3600.0)
    rpm = np.linspace(*((last, first) if down else (first, last)), n_samples)
    turns = np.cumsum(rpm / 60.0) / SWEEP_HZ
    middle, width = rng.uniform(900.0, 3000.0), rng.uniform(150.0, 600.0)
    line = size * rng.uniform(0.3, 2.0) * (1.0 + 5.0 / (1.0 + ((rpm - middle) / width) ** 2))
    noise = size * rng.uniform(0.3, 1.5) * (rpm / 1500.0)
    shape = signal.butter(4, (15.0, 45.0) if seed % 3 else (30.0, 700.0), "band", fs=SWEEP_HZ, output="sos")
    shaped = signal.sosfilt(shape, rng.standard_normal(n_samples))
    values = line * np.cos(2 * np.pi * 2.0 * turns + 1.0) + noise * shaped / np.std(shaped)
    return frames_along(values, rpm, turns, BAND, f"{seed} {down}"), rpm, 0.5 * line**2 + noise**2


def frames_along(values, rpm, turns, bands, name="a"):
    """LevelFrames of ``values`` of a shaft that turns ``rpm`` and is at ``turns``, at each sample."""
    at, knots = np.arange(rpm.size) / SWEEP_HZ, slice(None, None, 64)
    angle = shaft(at[knots], turns[knots], rpm[knots])
    return level_frames(accelerometer(values, SWEEP_HZ, name), angle, bands=bands, frame_s=0.5)


@pytest.mark.slow
def test_a_run_up_is_told_in_windows_along_it_whose_intervals_hold_the_level():
    hits, rows, wide = 0, 0, []
    for seed in range(60):
        seconds = float(np.random.default_rng(seed).uniform(8.0, 30.0))
        frames, rpm, square = swept(seed, seconds=seconds)
        made = vibration_levels([frames], speed_bin_rpm=25.0)
        assert made.sizes["speed"] >= int((seconds - 1.0) / 1.2) - 1
        # what was put in about the mean speed of each row; the first and the last reach to ends that are left out
        speeds, (low, high) = made["speed"].values, made["rms_ci95"].values[0, 1:-1].T
        pieces = np.split(square, np.searchsorted(rpm, 0.5 * (speeds[1:] + speeds[:-1])))[1:-1]
        truth = np.sqrt([piece.mean() for piece in pieces])
        hits, rows = hits + int(np.sum((low <= truth) & (truth <= high))), rows + len(truth)
        wide.append(float(np.median(high / low)))
    assert 0.92 < hits / rows <= 0.995, hits / rows
    assert np.median(wide) < 1.5


def test_where_run_ups_differ_the_interval_is_that_between_them():
    """A machine that is three times as loud on the way down: each row holds what both ways show."""
    for seed in range(3):
        up, down = (swept(seed, seconds=15.0, size=one, down=way)[0] for one, way in ((1.0, False), (3.0, True)))
        made, *alone = (vibration_levels(frames, speed_bin_rpm=25.0) for frames in ([up, down], [up], [down]))
        low, high = made["rms_ci95"].values[0].T
        for one in alone:
            way = np.interp(made["speed"].values, one["speed"].values, one["rms"].values[0])
            assert np.mean((low < way) & (way < high)) > 0.8


def test_a_limit_that_the_end_of_a_window_passes_is_not_kept_by_its_mean():
    """A level that grows with the cube of speed: what is to be surely within is told at the louder end."""
    rpm = np.linspace(900.0, 3600.0, int(9.0 * SWEEP_HZ))
    turns = np.cumsum(rpm / 60.0) / SWEEP_HZ
    values = (rpm / 1500.0) ** 3 * np.cos(2 * np.pi * 2.0 * turns)
    values += 0.02 * np.random.default_rng(0).standard_normal(rpm.size)
    frames = frames_along(values, rpm, turns, limit_bands("acceleration", 10.0, 1000.0))
    made = vibration_levels([frames], speed_bin_rpm=25.0)
    last_piece = np.sqrt(float(frames["mean_square"][0, -1]))  # what was there at the end
    loudest = float(made["rms"].values[0].max())
    assert last_piece > 1.04 * loudest
    sources = [MachineModel(1, limits=(Limit("acceleration", 10.0, 1000.0, one, "x", ()),)) for one in
               (1.02 * loudest, 0.99 * last_piece, 1.2 * last_piece)]  # fmt: skip
    told = [limit_verdicts(made, None, one)[0] for one in sources]
    assert [one.verdict for one in told] == ["not decided", "not decided", "within"]
    assert "sweep more slowly" in told[0].evidence
    assert " rpm" in told[2].evidence
