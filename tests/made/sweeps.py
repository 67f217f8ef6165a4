"""Recordings of any course of the speed with any encoder, made from closed forms and independent of the scenes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.settings import load_settings
from crankorder.shaft.decode import shaft_angle
from made.recordings import sampled

RATE_HZ = 25_600.0
ENCODERS = ("360", "60 quantised", "60-2 quantised", "1 per rev", "speed signal")
Law = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Course:
    """Speed [rpm] over time: straight lines between corners, rounded over ``rounding_s``."""

    time_s: tuple[float, ...]
    speed_rpm: tuple[float, ...]
    rounding_s: float = 0.1

    @property
    def duration_s(self) -> float:
        return self.time_s[-1]

    def known(self, rate_hz: float = RATE_HZ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time [s], crank angle [rev] and speed [rpm] at each sample."""
        at = np.arange(round(self.duration_s * rate_hz)) / rate_hz
        speed = np.interp(at, self.time_s, self.speed_rpm)
        if self.rounding_s and len(self.time_s) > 2:
            n = max(3, round(self.rounding_s * rate_hz)) | 1
            kernel = np.hanning(n + 2)[1:-1]
            # the ends are straight lines: padded by their own point reflection
            padded = np.pad(speed, n // 2, mode="reflect", reflect_type="odd")
            from scipy.signal import fftconvolve

            speed = np.maximum(fftconvolve(padded, kernel / kernel.sum(), mode="valid"), 0.0)
        hz = speed / 60.0
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (hz[1:] + hz[:-1])) / rate_hz])
        return at, angle + 0.123, speed


def recording_of(
    course: Course,
    laws: dict[float, Law],
    *,
    encoder: str,
    seed: int,
    noise: float = 0.01,
    rate_hz: float = RATE_HZ,
    decimate: int = 5,
    name: str = "sweep",
) -> tuple[xr.Dataset, xr.Dataset]:
    """BandRecording (one channel) and ShaftAngle; ``laws`` are the complex amplitudes of orders over speed [rpm]."""
    at, angle, speed = course.known(rate_hz)
    signal = np.zeros(len(at))
    for order, law in laws.items():
        signal += (law(speed) * np.exp(2j * np.pi * order * angle)).real
    signal += noise * np.random.default_rng(seed).normal(size=len(at))
    variables, attrs = _encoder(encoder, at, angle, speed, rate_hz)
    attrs = {"recording": name, "rate_hz": rate_hz, "missing_teeth": 0, "ratio": 1.0} | attrs
    recording = sampled(signal[None], **attrs).assign(variables)
    shaft = shaft_angle(recording, settings=load_settings().shaft)
    from crankorder.fft.band import band_limited

    band = band_limited(recording, band_hz=0.39 * rate_hz / decimate, grid_hz=0.5)
    return band, shaft


def _encoder(kind: str, at: np.ndarray, angle: np.ndarray, speed: np.ndarray, rate_hz: float) -> tuple[dict, dict]:
    if kind == "speed signal":
        words = {"units": "min-1"}
        return {"speed_signal": ("time", speed, words)}, {"encoder_kind": "speed"}
    teeth = {"360": 360, "60 quantised": 60, "60-2 quantised": 60, "1 per rev": 1}[kind]
    number = np.arange(np.ceil(angle[0] * teeth), np.floor(angle[-1] * teeth))
    rising = np.concatenate([[True], np.diff(angle) > 0])
    time = np.interp(number / teeth, angle[rising], at[rising])
    missing = 2 if kind.startswith("60-2") else 0
    if missing:
        time = time[number % 60 < 58]
    if "quantised" in kind:
        time = np.unique(np.ceil(time * rate_hz) / rate_hz)
    made = {"pulse_time": ("pulse", time, {"units": "s"})}
    return made, {"encoder_kind": "pulse_times", "pulses_per_rev": teeth, "missing_teeth": missing}
