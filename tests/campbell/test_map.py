"""The Campbell map: scalings, stripes, densities."""

import math

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map, leading_frames
from crankorder.quantities import check_dataset, flags_of
from crankorder.settings import load_settings
from made.recordings import line, named, sampled, shaft, steady

SETTINGS = load_settings().campbell


def map_of(*signals, speed_rpm=1200.0, duration_s=12.0, rate_hz=2000.0):
    recording = steady(list(signals), speed_rpm=speed_rpm, duration_s=duration_s, rate_hz=rate_hz)
    return campbell_map([frequency_frames(*recording, settings=SETTINGS)], speed_bin_rpm=25.0)


@pytest.mark.cases(2)
@pytest.mark.parametrize("rate_hz", [2000.0, 1785.0 + 5 / 7], ids=["bins on the grid", "bins beside the grid"])
@pytest.mark.parametrize("near_hz", [100.0, 480.0])
@pytest.mark.parametrize("offset_bins", [0.0, 0.25, 0.5, 0.8])
def test_a_tone_reads_its_peak_wherever_it_lies(offset_bins, near_hz, rate_hz):
    frequency = near_hz + 0.5 * offset_bins
    made = map_of(lambda t, _: 0.3 * np.cos(2 * np.pi * frequency * t), rate_hz=rate_hz)
    check_dataset(made, "campbell_map")
    peak = made["amplitude"].sel(frequency=slice(near_hz - 5, near_hz + 5)).max().item()
    assert abs(20 * np.log10(peak / 0.3)) < 0.01


@pytest.mark.cases(2)
@pytest.mark.parametrize("rate_hz", [2000.0, 4096.0 / 3.0, 5000.0 / 3.0, 3333.3])
@pytest.mark.parametrize("hertz", [351.0, 351.2, 120.33])
def test_a_tone_stands_where_it_is_also_where_the_rate_is_no_multiple_of_the_resolution(hertz, rate_hz):
    made = map_of(lambda t, _: np.cos(2 * np.pi * hertz * t), rate_hz=rate_hz).isel(channel=0, speed=0)
    size, at = np.sqrt(made["psd"].values), int(np.argmax(made["psd"].values))
    side = 1 if size[at + 1] > size[at - 1] else -1
    ratio = size[at + side] / size[at]
    # of a Hann window's line, from the two largest bins (Rife and Vincent 1970)
    place = made["frequency"].values[at] + side * (2.0 * ratio - 1.0) / (1.0 + ratio) * made.attrs["resolution_hz"]
    assert place == pytest.approx(hertz, abs=1e-3)


def test_a_record_shorter_than_the_resolution_lands_on_the_same_frequencies():
    long, short = (map_of(line(2.0, 1.0), duration_s=d, rate_hz=2000.0) for d in (10.0, 1.0))
    np.testing.assert_array_equal(long["frequency"], short["frequency"])
    assert short["amplitude"].max().item() == pytest.approx(1.0, rel=0.01)
    assert short.attrs["enbw_hz"] == pytest.approx(1.5, rel=1e-6)


def crank_angle_frames(speed_rpm: float) -> xr.Dataset:
    angle = np.arange(360 * 200) / 360
    attrs = {"samples_per_rev": 360, "speed_rpm": speed_rpm, "encoder_kind": "none"}
    band = sampled(np.cos(2 * np.pi * 3.0 * angle)[None], domain="crank_angle", **attrs)
    knots = shaft(np.array([0.0, 1.0]), np.array([0.0, 200.0]), np.full(2, speed_rpm))
    return frequency_frames(band, knots, settings=SETTINGS)


def test_crank_angle_data_have_a_map_by_their_speeds_and_none_without():
    nothing = campbell_map([crank_angle_frames(math.nan)], speed_bin_rpm=25.0)
    check_dataset(nothing, "campbell_map")
    assert nothing.sizes["speed"] == 0
    made = campbell_map([crank_angle_frames(1000.0), crank_angle_frames(1507.0)], speed_bin_rpm=25.0)
    assert made["speed"].values.tolist() == [1000.0, 1507.0]
    assert made["frequency"].values[made["amplitude"].values[0, 0].argmax()] == pytest.approx(50.0, abs=0.5)
    assert made["frequency"].values[made["amplitude"].values[0, 1].argmax()] == pytest.approx(75.35, abs=0.5)


def test_nothing_is_shown_beyond_half_the_sample_rate():
    made = map_of(line(2.0, 1.0), rate_hz=800.3)
    assert made["frequency"].values[-1] <= 400.15
    assert made["psd"].sel(frequency=slice(300, None)).values.max() < 1e-6


def test_a_slow_recording_that_ends_the_map_is_named():
    slow, fast = (
        frequency_frames(*steady([line(2.0, 1.0)], speed_rpm=rpm, duration_s=5.0, rate_hz=rate), settings=SETTINGS)
        for rpm, rate in ((1000.0, 500.0), (1500.0, 2000.0))
    )
    slow.attrs["recording"] = "slow.h5"
    made = campbell_map([fast, slow], speed_bin_rpm=25.0)
    assert made["frequency"].values[-1] == 250.0
    assert [flag["recording"] for flag in flags_of(made) if flag["flag"] == "map_cut"] == ["slow.h5"]


RATE_HZ, BINS = 1024, 400


def frames_of(signal: NDArray[np.float64], *, name: str, rpm: float = 1200.0) -> xr.Dataset:
    """FrequencyFrames of ``signal`` (channels, samples): Hann frames of 1 s, half overlapping."""
    starts = np.arange(0, signal.shape[1] - RATE_HZ + 1, RATE_HZ // 2)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(RATE_HZ) / RATE_HZ)
    pieces = np.stack([signal[:, at : at + RATE_HZ] * window for at in starts], axis=1)
    power = np.abs(np.fft.rfft(pieces, axis=2)[:, :, :BINS] * 4.0 / RATE_HZ) ** 2
    return xr.Dataset(
        {"power": (("channel", "frame", "frequency"), power)},
        coords={
            **named(len(signal)),
            "frequency": ("frequency", np.arange(BINS, dtype=np.float64), {"units": "Hz"}),
            "speed": ("frame", np.full(len(starts), rpm)),
        },
        attrs={
            "recording": name, "resolution_hz": 1.0, "grid_hz": 1.0, "highest_hz": BINS - 1.0, "rate_hz": RATE_HZ,
            "window": "hann", "enbw_bins": 1.5, "overlap": 0.5, "amplitude_scaling": "peak", "tone_weight": 1.0,
            "tone_neighbour_weight": 0.0, "tone_spacing_bins": 1, "sweep_hz_per_order": 0.0, "quality": "[]",
        },
    )  # fmt: skip


def recordings(seed: int, *, ring: float) -> list[xr.Dataset]:
    """Twelve recordings of noise of 4 s in two channels, with a mode of 80 Hz and 0.5 % that ``ring``s at first."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(4 * RATE_HZ) / RATE_HZ
    made = []
    for number in range(12):
        signal = rng.standard_normal((2, time_s.size))
        decay = np.exp(-2.0 * np.pi * 0.005 * 80.0 * time_s)
        signal += ring * decay * np.cos(2.0 * np.pi * 80.0 * time_s + rng.uniform(0.0, 6.3))
        made.append(frames_of(signal, name=str(number), rpm=1000.0 + 50.0 * number))
    return made


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(5))
def test_the_floor_without_the_start_is_that_of_noise(seed: int) -> None:
    quiet = campbell_map(recordings(seed, ring=0.0), speed_bin_rpm=10.0)
    rung = campbell_map(recordings(seed, ring=2.0), speed_bin_rpm=10.0)
    near = slice(76, 85)
    level = float(quiet["psd"].mean())
    assert float(rung["psd"][:, :, near].mean()) > 2.0 * level
    at = rung["settled_frequency"].values
    inside = (at >= 78) & (at <= 82)
    assert np.count_nonzero(inside) == 5
    total = (rung["settled_psd"] * rung["settled_share"]).sum("speed") / rung["settled_share"].sum("speed")
    assert float(total[:, inside].mean()) < 1.3 * level
    assert float(rung["settled_share"].min()) > 0.2
    assert len(at) < 0.1 * BINS


@pytest.mark.slow
def test_noise_loses_next_to_nothing() -> None:
    lost = 0
    for seed in range(20):
        leading = leading_frames(recordings(seed, ring=0.0))
        lost += 0 if leading is None else int((leading[0] > 0).sum())
    assert lost <= 400  # of 8000 bins: a chance of half a percent in each of two channels, and the bins beside


def test_what_does_not_turn_keeps_its_start() -> None:
    struck = recordings(1, ring=3.0)
    for item in struck:
        item["speed"] = ("frame", np.full(item.sizes["frame"], np.nan))
    assert leading_frames(struck) is None
