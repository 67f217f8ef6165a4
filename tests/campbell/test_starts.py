"""What rings when a recording begins takes no part in the floor, and noise alone loses nothing."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from crankorder.campbell.map import campbell_map, leading_frames

RATE_HZ, BINS = 1024, 400


def frames_of(signal: NDArray[np.float64], *, name: str, rpm: float = 1200.0) -> xr.Dataset:
    """FrequencyFrames of ``signal`` (channels, samples): Hann frames of 1 s, half overlapping."""
    starts = np.arange(0, signal.shape[1] - RATE_HZ + 1, RATE_HZ // 2)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(RATE_HZ) / RATE_HZ)
    pieces = np.stack([signal[:, at : at + RATE_HZ] * window for at in starts], axis=1)
    power = np.abs(np.fft.rfft(pieces, axis=2)[:, :, :BINS] * 4.0 / RATE_HZ) ** 2
    n_channels = len(signal)
    return xr.Dataset(
        {"power": (("channel", "frame", "frequency"), power)},
        coords={
            "channel": ("channel", [f"c{k}" for k in range(n_channels)]),
            "unit": ("channel", ["m/s2"] * n_channels),
            "quantity": ("channel", ["acceleration"] * n_channels),
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
