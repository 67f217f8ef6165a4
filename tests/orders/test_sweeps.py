"""Sweeps of every kind, with every encoder: rows at the right speeds, amplitudes inside their intervals, no crash."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import fftconvolve, lfilter

from crankorder.errors import InputError
from crankorder.fft.decimation import band_limited
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.swept_tracks import followed_tracks, swept_tracks
from crankorder.orders.track_rows import TrackReader, order_tracks
from crankorder.orders.vold_kalman import impulse_response, taken_in_truth
from crankorder.quantities import flags_of
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
    def duration_s(self):
        return self.time_s[-1]

    def known(self, rate_hz=RATE_HZ):
        """Time [s], crank angle [rev] and speed [rpm] at each sample."""
        at = np.arange(round(self.duration_s * rate_hz)) / rate_hz
        speed = np.interp(at, self.time_s, self.speed_rpm)
        if self.rounding_s and len(self.time_s) > 2:
            n = max(3, round(self.rounding_s * rate_hz)) | 1
            kernel = np.hanning(n + 2)[1:-1]
            # the ends are straight lines: padded by their own point reflection
            padded = np.pad(speed, n // 2, mode="reflect", reflect_type="odd")
            speed = np.maximum(fftconvolve(padded, kernel / kernel.sum(), mode="valid"), 0.0)
        hz = speed / 60.0
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (hz[1:] + hz[:-1])) / rate_hz])
        return at, angle + 0.123, speed


def recording_of(course, laws, *, encoder, seed, noise=0.01, rate_hz=RATE_HZ, decimate=5, name="sweep"):
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
    band = band_limited(recording, band_hz=0.39 * rate_hz / decimate, grid_hz=0.5)
    return band, shaft


def _encoder(kind, at, angle, speed, rate_hz):
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


SETTINGS = load_settings().orders
COURSES = {
    "run-up": Course((0, 20.0), (900, 2700)),
    "slow run-up": Course((0, 30.0), (1500, 1560)),
    "fast run-up": Course((0, 5.0), (900, 5500)),
    "run-down": Course((0, 10.0), (3000, 700)),
    "through zero": Course((0, 8.0, 10.0, 18.0), (2500, 0, 0, 2500)),
    "from rest": Course((0, 1.0, 10.0), (0, 0, 3000)),
    "step": Course((0, 6.0, 6.5, 12.0), (1000, 1000, 1800, 1800)),
}


def resonance(at_rpm, width_rpm, height):
    return lambda speed: 1.0 + height / (1.0 + 1j * (speed - at_rpm) / width_rpm)


def drawn(seed):
    draw = np.random.default_rng(seed)
    orders = draw.choice([1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.5, 6.0], 3, replace=False)
    return {
        float(order): resonance(draw.uniform(1200, 2200), draw.uniform(150, 400), draw.uniform(0, 3))
        for order in orders
    }


@pytest.mark.parametrize("encoder", ENCODERS)
@pytest.mark.parametrize("course", COURSES)
def test_rows_and_frames_stand_at_the_speeds_that_were_run(course, encoder):
    laws = drawn(len(course) + len(encoder))
    band, shaft = recording_of(COURSES[course], laws, encoder=encoder, seed=1)
    at, _, speed = COURSES[course].known()
    frames = order_frames(band, shaft, settings=SETTINGS)
    assert frames.attrs["swept"] == 1
    middle = frames["crank_angle"].values + 0.5 * frames.attrs["revs_per_frame"]
    time_s = np.interp(middle, shaft["crank_angle"].values, shaft["time"].values)
    # a frame across a corner of the course has no one speed: that is allowed a twentieth
    error = np.abs(frames["speed"].values - np.interp(time_s, at, speed)) / frames["speed"].values
    assert np.quantile(error, 0.9) < 0.002
    assert error.max() < 0.05
    tracks = swept_tracks(band, shaft, list(laws))
    true_rpm = np.interp(tracks["time"].values, at, speed)
    error = np.abs(tracks["speed"].values - true_rpm) / true_rpm
    assert np.quantile(error, 0.9) < 0.002
    assert error.max() < 0.1
    assert tracks["speed"].values.min() > 20.0


@pytest.mark.cases(1)
@pytest.mark.parametrize("encoder", ENCODERS)
@pytest.mark.parametrize("course", ["run-up", "slow run-up", "run-down"])
def test_orders_named_by_the_user_are_followed_with_every_encoder(course, encoder):
    laws = drawn(7 * len(course) + len(encoder))
    band, shaft = recording_of(COURSES[course], laws, encoder=encoder, seed=2, noise=0.05)
    asked = SETTINGS.model_copy(update={"track_orders": tuple(laws)})
    tracks = followed_tracks(band, shaft, settings=asked, swept=True)
    inner = np.linspace(1000.0, 2400.0, 8) if course != "slow run-up" else np.linspace(1510.0, 1550.0, 8)
    at = np.abs(tracks["speed"].values - inner[:, None]).argmin(axis=1)
    for order, law in laws.items():
        truth, here = np.abs(law(inner)), np.abs(law(tracks["speed"].values[at]))
        row = tracks.sel(order=order).isel(channel=0, frame=at)
        # quantised edges turn phases at random: what that takes and gives is of all lines
        room = 0.02 * np.maximum(4.0, truth) + 5.0 * row["standard_error"].values
        assert (np.abs(np.abs(row["amplitude"].values) - here) < room).all(), order
    never = followed_tracks(band, shaft, settings=asked.model_copy(update={"track_method": "frames"}), swept=True)
    assert not never.sizes and never.attrs["swept"] == 0


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(12))
def test_amplitudes_through_a_sweep_lie_inside_their_intervals(seed):
    draw = np.random.default_rng(500 + seed)
    rate = 10.0 ** draw.uniform(0.3, 3.0)
    first, last = (1000.0, 2600.0) if draw.random() < 0.5 else (2600.0, 1000.0)
    duration = min(abs(last - first) / rate, 30.0)
    course = Course((0.0, duration), (first, first + np.sign(last - first) * rate * duration))
    laws = drawn(seed)
    band, shaft = recording_of(course, laws, encoder="360", seed=seed, noise=0.1)
    followed = swept_tracks(band, shaft, list(laws))
    frames = [order_frames(band, shaft, settings=SETTINGS)]
    reader = TrackReader(order_map(frames, settings=SETTINGS), frames=frames, followed=[followed])
    inside, error = [], []
    for order, law in laws.items():
        rows = reader.rows(order)
        seen = np.isfinite(rows.amplitude[0]) & (np.arange(len(reader.speed_rpm)) >= len(reader.map_rpm))
        truth = np.abs(law(reader.speed_rpm[seen]))
        low, high = rows.amplitude_low[0, seen], rows.amplitude_high[0, seen]
        inside += ((low <= truth) & (truth <= high)).tolist()
        error += ((rows.amplitude[0, seen] - truth) / truth.max()).tolist()
    assert np.mean(inside) > 0.88
    assert np.abs(np.median(error)) < 0.01


def test_the_noise_of_a_mode_under_an_order_is_in_its_error():
    """What noise excites of a mode peaks within the filter's band, where what stands beside the order is less."""
    course, near = Course((0.0, 24.0), (900.0, 2700.0)), []
    natural, damping = 2.0 * np.pi * 60.0, 0.02
    for seed in range(4):
        band, shaft = recording_of(course, {2.0: lambda speed: 0.1 + 0.0 * speed}, encoder="360", seed=seed, noise=1e-4)
        rate, white = band.attrs["rate_hz"], np.random.default_rng(seed).standard_normal(band.sizes["time"])
        radius = np.exp(-damping * natural / rate)
        rung = lfilter([1.0], [1.0, -2.0 * radius * np.cos(natural / rate), radius**2], white)
        found = swept_tracks(band.assign(signal=band["signal"] + 0.1 * rung / rung.std()), shaft, [2.0])
        off = np.abs(found["amplitude"].values[0, 0]) - 0.1
        rows = np.abs(found["speed"].values / 1800.0 - 1.0) < damping
        near += (off[rows] / found["standard_error"].values[0, 0, rows]).tolist()
    assert len(near) > 12 and 0.4 < np.std(near) < 1.6  # 3 and more by what stands beside


def test_repeated_run_ups_and_steps_of_one_test_all_take_part():
    laws = {2.0: resonance(1500.0, 200.0, 2.0), 4.0: resonance(1900.0, 200.0, 1.0)}
    pairs = [
        recording_of(COURSES[name], laws, encoder="360", seed=k, name=name)
        for k, name in enumerate(("run-up", "fast run-up", "run-down"))
    ]
    pairs.append(recording_of(Course((0, 8.0), (1234, 1234)), laws, encoder="360", seed=9, name="steady"))
    frames = [order_frames(*pair, settings=SETTINGS) for pair in pairs]
    assert len({item.attrs["revs_per_frame"] for item in frames}) > 1
    assert [item.attrs["swept"] for item in frames] == [1, 1, 1, 0]
    followed = [
        followed_tracks(*pair, settings=SETTINGS, swept=bool(item.attrs["swept"]), standing_out=list(laws))
        for pair, item in zip(pairs, frames, strict=True)
    ]
    made = order_map(frames, settings=SETTINGS)
    assert not [flag for flag in flags_of(made) if flag["severity"] == "bad"]
    tracks = order_tracks(made, list(laws), settings=SETTINGS, frames=frames, followed=followed)
    speed = tracks["speed"].values
    for order, law in laws.items():
        value = tracks["amplitude"].sel(order=order).values[0]
        seen = np.isfinite(value)
        assert seen.sum() >= sum(item.sizes["frame"] for item in followed if item.sizes)
        truth = np.abs(law(speed[seen]))
        assert np.quantile(np.abs(value[seen] - truth) / truth.max(), 0.95) < 0.05


def test_a_shaft_that_hardly_turns_is_no_sweep_to_crash_in():
    for course in (Course((0, 3.0), (0, 100)), Course((0, 2.0, 4.0), (300, 0, 0.0))):
        try:
            band, shaft = recording_of(course, {1.0: lambda speed: 0 * speed + 1.0}, encoder="60 quantised", seed=3)
            frames = order_frames(band, shaft, settings=SETTINGS)
        except InputError:
            continue  # less than a cycle, or not enough pulses: said, not crashed
        tracks = swept_tracks(band, shaft, [1.0, 2.0])
        assert frames.sizes["frame"] >= 1
        assert (tracks["speed"].values > 0.0).all()


@pytest.mark.cases(1)
@pytest.mark.parametrize("width", [0.3, 1.0, 2.0, 5.0])
def test_what_a_narrow_filter_takes_of_a_peak_is_told_by_what_it_takes_once_more(width):
    """The envelope of a mode that is passed, 1 / (1 + i t / τ), filtered once and twice by numerical convolution."""
    lag = np.linspace(-12.0, 12.0, 4801)  # reciprocal bandwidths
    step = lag[1] - lag[0]
    passed = 1.0 / (1.0 + 1j * np.pi * width * lag)  # its spectrum falls by e in so many half bandwidths
    kernel = impulse_response(lag)
    once = np.convolve(passed, kernel, mode="same") * step
    twice = np.convolve(once, kernel, mode="same") * step
    middle = len(lag) // 2
    share = abs(once[middle] - twice[middle]) / abs(once[middle])
    taken = 1.0 - abs(once[middle])
    told = taken_in_truth(np.array(share), np.array(10.0)) * share * abs(once[middle])
    assert told == pytest.approx(taken, rel=0.12)
