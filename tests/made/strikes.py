"""Recordings of strikes with a known order in noise, at constant speed: made by a sum of ringings, strike by strike."""

import numpy as np
import xarray as xr

from made.recordings import held, sampled


def strikes(
    *, order: float, size: float, speed_rpm: float, seed: int, rate_hz: float = 12_800.0, duration_s: float = 5.0,
    jitter: float = 0.0, modulated_by: float | None = None, n_channels: int = 1, revs_per_cycle: int = 1,
) -> tuple[xr.Dataset, xr.Dataset]:  # fmt: skip
    """Recording and ShaftAngle: ``size`` (0: none) at ``order`` strikes a revolution ring 3200 Hz in noise of 1 m/s2.

    ``jitter``: standard deviation of a period as its share; ``modulated_by``: order by which the size comes and goes.
    """
    chance = np.random.default_rng(seed)
    n_samples = round(duration_s * rate_hz)
    signal = chance.standard_normal((n_channels, n_samples))
    if size:
        period_s = 60.0 / speed_rpm / order
        steps = 1.0 + jitter * chance.standard_normal(int(duration_s / period_s) + 20)
        times = (np.cumsum(steps) - 10.0 * chance.random()) * period_s
        heights = np.ones(len(times))
        if modulated_by is not None:
            heights += 0.6 * np.cos(2.0 * np.pi * modulated_by * times * speed_rpm / 60.0)
        ring_s = np.arange(round(0.02 * rate_hz)) / rate_hz
        for time_s, height in zip(times, heights, strict=True):
            first = int(np.ceil(time_s * rate_hz))
            since = first / rate_hz - time_s + ring_s
            ring = np.exp(-0.04 * 2.0 * np.pi * 3200.0 * since) * np.sin(2.0 * np.pi * 3200.0 * since)
            begin, end = max(first, 0), min(first + len(ring), n_samples)
            if end > begin:
                signal[:, begin:end] += size * height * ring[begin - first : end - first]
    return recording(signal, rate_hz=rate_hz, speed_rpm=speed_rpm, revs_per_cycle=revs_per_cycle)


def recording(
    signal: np.ndarray, *, rate_hz: float, speed_rpm: float, revs_per_cycle: int = 1
) -> tuple[xr.Dataset, xr.Dataset]:
    """Recording (channel, time) of ``signal`` in single precision and the ShaftAngle of a constant speed."""
    name = f"made_{speed_rpm:g}"
    attrs = {"recording": name, "encoder_kind": "square", "revs_per_cycle": revs_per_cycle}
    made = sampled(signal.astype(np.float32), rate_hz=rate_hz, **attrs)
    return made, held(speed_rpm, (signal.shape[1] - 1) / rate_hz, revs_per_cycle=revs_per_cycle)
