"""Sweeps of every kind, with every encoder: rows and frames at the right speeds, no crash."""

import numpy as np
import pytest
from scipy.signal import fftconvolve

from crankorder.errors import InputError
from crankorder.fft.decimation import band_limited
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.swept_tracks import followed_tracks, swept_tracks
from crankorder.orders.track_rows import order_tracks
from crankorder.orders.vold_kalman import impulse_response, taken_in_truth
from crankorder.shaft.decode import shaft_angle
from made.recordings import sampled
from made.shipped import SETTINGS

RATE_HZ = 25_600.0
COURSES = {
    "run-up": ("360", (0, 20.0), (900, 2700)),
    "slow run-up": ("60 quantised", (0, 30.0), (1500, 1560)),
    "fast run-up": ("60-2 quantised", (0, 5.0), (900, 5500)),
    "run-down": ("1 per rev", (0, 10.0), (3000, 700)),
    "through zero": ("speed signal", (0, 8.0, 10.0, 18.0), (2500, 0, 0, 2500)),
    "from rest": ("60 quantised", (0, 1.0, 10.0), (0, 0, 3000)),
    "step": ("360", (0, 6.0, 6.5, 12.0), (1000, 1000, 1800, 1800)),
}
"""Encoder, and times [s] and speeds [rpm] of the corners between which the speed runs straight."""


def recording_of(course, amplitudes, *, seed=1, noise=0.01):
    """BandRecording (one channel), ShaftAngle, and time [s] and speed [rpm] of the samples of a ``course``.

    ``amplitudes``: by order. The corners are rounded over 0.1 s.
    """
    encoder, corner_s, corner_rpm = course
    at, n = np.arange(round(corner_s[-1] * RATE_HZ)) / RATE_HZ, round(0.1 * RATE_HZ) | 1
    kernel = np.hanning(n + 2)[1:-1]
    # the ends are straight lines: padded by their own point reflection
    padded = np.pad(np.interp(at, corner_s, corner_rpm), n // 2, mode="reflect", reflect_type="odd")
    speed = np.maximum(fftconvolve(padded, kernel / kernel.sum(), mode="valid"), 0.0)
    angle = 0.123 + np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) / 60.0 / RATE_HZ])
    signal = noise * np.random.default_rng(seed).normal(size=len(at))
    signal += sum(size * np.cos(2 * np.pi * order * angle) for order, size in amplitudes.items())
    variables, attrs = _encoder(encoder, at, angle, speed)
    attrs = {"recording": "sweep", "rate_hz": RATE_HZ, "missing_teeth": 0, "ratio": 1.0} | attrs
    recording = sampled(signal[None], **attrs).assign(variables)
    shaft = shaft_angle(recording, settings=SETTINGS.shaft)
    return band_limited(recording, band_hz=0.078 * RATE_HZ, grid_hz=0.5), shaft, at, speed


def _encoder(kind, at, angle, speed):
    if kind == "speed signal":
        return {"speed_signal": ("time", speed, {"units": "min-1"})}, {"encoder_kind": "speed"}
    teeth = {"360": 360, "60 quantised": 60, "60-2 quantised": 60, "1 per rev": 1}[kind]
    number = np.arange(np.ceil(angle[0] * teeth), np.floor(angle[-1] * teeth))
    rising = np.concatenate([[True], np.diff(angle) > 0])
    time, missing = np.interp(number / teeth, angle[rising], at[rising]), 2 * kind.startswith("60-2")
    time = time[number % teeth < teeth - missing]
    if "quantised" in kind:
        time = np.unique(np.ceil(time * RATE_HZ) / RATE_HZ)
    attrs = {"encoder_kind": "pulse_times", "pulses_per_rev": teeth, "missing_teeth": missing}
    return {"pulse_time": ("pulse", time, {"units": "s"})}, attrs


@pytest.mark.parametrize("course", COURSES.values(), ids=COURSES)
def test_rows_and_frames_stand_at_the_speeds_that_were_run(course):
    amplitudes = {1.0: 1.0, 2.5: 0.5, 4.0: 2.0}
    band, shaft, at, speed = recording_of(course, amplitudes)
    frames = order_frames(band, shaft, settings=SETTINGS.orders)
    assert frames.attrs["swept"] == 1
    middle = frames["crank_angle"].values + 0.5 * frames.attrs["revs_per_frame"]
    time_s = np.interp(middle, shaft["crank_angle"].values, shaft["time"].values)
    # a frame across a corner of the course has no one speed: that is allowed a twentieth
    error = np.abs(frames["speed"].values - np.interp(time_s, at, speed)) / frames["speed"].values
    assert np.quantile(error, 0.9) < 0.002
    assert error.max() < 0.05
    tracks = swept_tracks(band, shaft, list(amplitudes))
    true_rpm = np.interp(tracks["time"].values, at, speed)
    error = np.abs(tracks["speed"].values - true_rpm) / true_rpm
    assert np.quantile(error, 0.9) < 0.002
    assert error.max() < 0.1
    assert tracks["speed"].values.min() > 20.0


def test_the_rows_of_a_sweep_come_from_its_frames_where_these_are_asked_for():
    band, shaft, *_ = recording_of(COURSES["fast run-up"], {2.0: 1.0})
    settings = SETTINGS.orders.model_copy(update={"track_method": "frames", "track_orders": (2.0,)})
    frames = order_frames(band, shaft, settings=settings)
    followed = followed_tracks(band, shaft, settings=settings, swept=True)
    made = order_map([frames], settings=settings)
    tracks = order_tracks(made, [2.0], settings=settings, frames=[frames], followed=[followed])
    assert tracks["track_method"].values.tolist() == ["frames"]
    np.testing.assert_array_equal(tracks["speed"].values, np.sort(made["speed"].values))
    assert np.nanmedian(tracks["amplitude"].values) == pytest.approx(1.0, rel=0.05)


def test_a_shaft_that_hardly_turns_is_no_sweep_to_crash_in():
    for course in (("60 quantised", (0, 3.0), (0, 100)), ("60 quantised", (0, 2.0, 4.0), (300, 0, 0.0))):
        try:
            band, shaft = recording_of(course, {1.0: 1.0}, seed=3)[:2]
            frames = order_frames(band, shaft, settings=SETTINGS.orders)
        except InputError:
            continue  # less than a cycle, or not enough pulses: said, not crashed
        tracks = swept_tracks(band, shaft, [1.0, 2.0])
        assert frames.sizes["frame"] >= 1
        assert (tracks["speed"].values > 0.0).all()


def test_what_a_narrow_filter_takes_of_a_peak_is_told_by_what_it_takes_once_more():
    """The envelope of a mode that is passed, 1 / (1 + i t / τ), filtered once and twice by numerical convolution."""
    lag = np.linspace(-12.0, 12.0, 4801)  # reciprocal bandwidths
    step = lag[1] - lag[0]
    passed = 1.0 / (1.0 + 1j * np.pi * 0.3 * lag)  # its spectrum falls by e in so many half bandwidths
    kernel = impulse_response(lag)
    once = np.convolve(passed, kernel, mode="same") * step
    twice = np.convolve(once, kernel, mode="same") * step
    middle = len(lag) // 2
    share = abs(once[middle] - twice[middle]) / abs(once[middle])
    taken = 1.0 - abs(once[middle])
    told = taken_in_truth(np.array(share), np.array(10.0)) * share * abs(once[middle])
    assert told == pytest.approx(taken, rel=0.12)
