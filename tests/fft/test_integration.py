"""Integration in the frequency domain, against analytic signals and a trapezoidal integral."""

import numpy as np
import pytest

from crankorder.fft.transforms import integrated

RATE_HZ = 4096.0


@pytest.mark.parametrize(("times", "seed"), [(1, 0), (2, 4)])
def test_lines_are_integrated_in_size_and_phase(times, seed):
    rng = np.random.default_rng(seed)
    at = np.arange(int(30 * RATE_HZ)) / RATE_HZ
    hertz, phase = rng.uniform(5.0, 1500.0, 4), rng.uniform(0, 2 * np.pi, 4)
    size = 2 * np.pi * hertz  # like velocities
    values = sum(a * np.cos(2 * np.pi * f * at + p) for a, f, p in zip(size, hertz, phase, strict=True))
    truth = sum(
        (2 * np.pi * f) ** (1 - times) * np.cos(2 * np.pi * f * at + p - times * np.pi / 2)
        for f, p in zip(hertz, phase, strict=True)
    )
    made = integrated(values + 30.0, RATE_HZ, times=times, highpass_hz=2.0, half_octaves=0.5)
    inside = slice(int(3 * RATE_HZ), -int(3 * RATE_HZ))
    assert np.abs(made - truth)[inside].max() < 2e-3 * np.std(truth)
    assert np.nanmax(np.abs(made - truth)) < 0.1 * np.std(truth)
    assert np.isnan(made[: int(0.5 * RATE_HZ)]).all()


def test_missing_samples_stay_missing_and_blocks_have_no_seam(monkeypatch):
    values = np.random.default_rng(1).standard_normal(200_000).astype(np.float32)
    values[5000:5010] = np.nan
    whole = integrated(values, RATE_HZ, times=1, highpass_hz=2.0, half_octaves=0.5)
    assert np.flatnonzero(np.isnan(whole)).tolist() == [*range(2048), *range(5000, 5010), *range(197_952, 200_000)]
    assert whole.dtype == np.float32
    monkeypatch.setattr("crankorder.fft.transforms._TOGETHER", 1 << 15)
    parts = integrated(values, RATE_HZ, times=1, highpass_hz=2.0, half_octaves=0.5)
    assert np.nanmax(np.abs(parts - whole)) < 0.01 * np.nanstd(whole)
