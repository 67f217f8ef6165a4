"""The hard cases of the order rooms: what is asked, what comes out, and what is drawn of it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.fft.decimation import band_limited
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.recordings import envelopes, line, sampled, shaft, steady, total

SETTINGS = load_settings().orders


@dataclass(frozen=True)
class HardCase:
    """One case: the largest relative error ``error`` against its ``mark``, and curves (x, y, label) to draw.

    A curve labelled as truth is drawn as a thin dark line; ``logarithmic`` is the scale of y, ``wide`` that of x too.
    """

    asked: str
    error: float
    curves: list[tuple[np.ndarray, np.ndarray, str]]
    mark: float = 1e-6
    x_label: str = "order"
    y_label: str = "amplitude"
    logarithmic: bool = False
    wide: bool = False


def limited_frames(band: xr.Dataset, angle: xr.Dataset, *, band_hz: float = 500.0) -> xr.Dataset:
    """OrderFrames of a recording that is limited to ``band_hz`` first."""
    return order_frames(band_limited(band, band_hz=band_hz, grid_hz=0.5), angle, settings=SETTINGS)


def close_orders() -> HardCase:
    """Order 5.5 beside 5.48, told apart by Vold–Kalman over 15 s."""
    rate, speed = 2000.0, 1000.0
    angle = np.arange(int(15 * rate)) / rate * speed / 60.0
    orders, amplitudes = np.array([5.48, 5.5]), np.array([0.3 * np.exp(1j), 1.0 * np.exp(-0.5j)])
    signal = sum((a * np.exp(2j * np.pi * o * angle)).real for o, a in zip(orders, amplitudes, strict=True))
    noise = np.random.default_rng(5).normal(0.0, 0.2, len(angle))
    both, phases = np.stack([signal, signal + noise]), orders[:, None] * angle
    found, noisy = envelopes(both, phases, rate_hz=rate, bandwidth_hz=0.1)[0]
    axis = np.linspace(5.4, 5.6, 801)
    window = np.hanning(len(angle)) * 2.0 / np.hanning(len(angle)).sum()
    spectrum = np.abs(np.exp(-2j * np.pi * np.outer(axis, angle)) @ (window * (signal + noise)))
    return HardCase(
        asked="order 5.5 beside 5.48 in 250 revolutions: both amplitudes",
        error=float(np.abs(found / amplitudes[:, None] - 1.0).max()),
        mark=1e-9,
        curves=[
            (axis, spectrum, "Hann spectrum"),
            (orders, np.abs(noisy[:, len(angle) // 2]), "Vold–Kalman, noise 0.2"),
            (orders, np.abs(amplitudes), "truth"),
        ],
    )


def crossing_shafts() -> HardCase:
    """Two shafts whose speeds differ by at most 0.5 % and cross in the middle, followed by Vold–Kalman together."""
    rate, length = 1000.0, 60.0
    time = np.arange(int(length * rate)) / rate
    phases = np.stack([25.0 * time, 25.0 * time + 25.0 * 0.005 * (time / length - 1.0) * time])
    amplitudes = np.stack([1.0 + 0.2 * time / length, np.full(len(time), 0.5)])
    signal = (amplitudes * np.cos(2.0 * np.pi * phases)).sum(axis=0)
    found = np.abs(envelopes(signal[None], phases, rate_hz=rate, bandwidth_hz=0.05)[0][0])
    inner = slice(int(2 * rate), int((length - 2) * rate))
    return HardCase(
        asked="two shafts 0.5 % apart that meet and part: both amplitudes",
        error=float((np.abs(found - amplitudes) / amplitudes)[:, inner].max()),
        mark=1e-3,
        x_label="time in s",
        curves=[(time[::50], row[::50], f"shaft {k + 1}") for k, row in enumerate(found)]
        + [joined(time[::50], amplitudes[:, ::50], "truth")],
    )


def fast_ramps() -> HardCase:
    """A minute of ramps between 600 and 10600 rpm at 10,000 rpm per second."""
    rate = 8000.0
    time = np.arange(int(60 * rate)) / rate
    knots = np.arange(0.0, 60.0 + 1e-9, 0.01)
    whole, rest = np.divmod(knots, 1.0)
    rising = whole % 2 == 0
    speed = np.where(rising, 600.0 + 1e4 * rest, 10600.0 - 1e4 * rest)
    within = np.where(rising, 600.0 * rest + 5e3 * rest**2, 10600.0 * rest - 5e3 * rest**2)
    angle_of = (whole * 5600.0 + within) / 60.0
    shaft_angle = shaft(knots, angle_of, speed)
    whole, rest = np.divmod(time, 1.0)
    within = np.where(whole % 2 == 0, 600.0 * rest + 5e3 * rest**2, 10600.0 * rest - 5e3 * rest**2)
    angle = (whole * 5600.0 + within) / 60.0
    signal = np.cos(2.0 * np.pi * 2.0 * angle + 0.4) + 0.1 * np.cos(2.0 * np.pi * 5.5 * angle)
    band = sampled(signal[None], rate_hz=rate, encoder_kind="none")
    frames = order_frames(band, shaft_angle, settings=SETTINGS)
    found = frames["spectrum"].sel(order=[2.0, 5.5]).values[0]
    truth = np.array([np.exp(0.4j), 0.1])
    return HardCase(
        asked="a minute of ramps of 10,000 rpm/s: orders 2 and 5.5 in every frame",
        error=float(np.abs(found - truth).max()),
        x_label="frame",
        y_label="error of the amplitude",
        curves=[
            (np.arange(len(found)), np.abs(found[:, k] - truth[k]), f"order {order}")
            for k, order in enumerate((2, 5.5))
        ],
        logarithmic=True,
    )


def two_revolutions() -> HardCase:
    """300 rpm, 2.01 revolutions, sampled at 50 kHz and limited to the band of the recipe."""
    band, angle = steady(
        [total(line(0.5, 0.3, 0.2), line(2, 1.0, 0.5), line(5.5, 0.1, -1.0))],
        speed_rpm=300.0,
        duration_s=0.402,
        rate_hz=50000.0,
    )
    frames = limited_frames(band, angle)
    spectrum = frames["spectrum"].values[0, 0]
    truth = {2.0: np.exp(0.5j), 5.5: 0.1 * np.exp(-1j)}
    return HardCase(
        asked="300 rpm with two revolutions: orders 2 and 5.5",
        error=max(abs(frames["spectrum"].sel(order=o).values[0, 0] - a) for o, a in truth.items()),
        curves=[
            (frames["order"].values, np.abs(spectrum), "found"),
            (np.array([0.5, 2.0, 5.5]), np.array([0.3, 1.0, 0.1]), "truth"),
        ],
    )


def bin_edge() -> HardCase:
    """An order half way between two bins of the map, read in frames twice as long."""
    order = 5.5 + 1.0 / 32.0
    signal = total(line(order, 1.0, 0.7))
    band, angle = steady([signal], speed_rpm=1000.0, duration_s=15.0, rate_hz=2000.0)
    longer = order_frames(band, angle, settings=SETTINGS.model_copy(update={"revs_per_frame": 32}))
    found = longer["spectrum"].sel(order=order).values[0]
    frames = order_frames(band, angle, settings=SETTINGS)
    shown = np.abs(frames["spectrum"].values[0]).mean(axis=0)
    near = np.abs(frames["order"].values - order) < 0.5
    return HardCase(
        asked="an order on the edge between two bins: its amplitude and phase",
        error=float(np.abs(found - np.exp(0.7j)).max()),
        curves=[
            (frames["order"].values[near], shown[near], "bins of a frame"),
            (np.array([order]), np.array([np.abs(found).mean()]), "read at the order"),
            (np.array([order]), np.array([1.0]), "truth"),
        ],
    )


def near_nyquist() -> HardCase:
    """Content at 0.8 of the Nyquist frequency, where orders end."""
    rate, speed = 2000.0, 2399.999
    signal = total(line(20.0, 1.0, 0.3), line(1.0, 1.0))
    band, angle = steady([signal], speed_rpm=speed, duration_s=10.0, rate_hz=rate)
    frames = order_frames(band, angle, settings=SETTINGS)
    found = frames["spectrum"].sel(order=20.0).values[0]
    error = np.abs(found - np.exp(0.3j))
    return HardCase(
        asked="order 20 at 0.8 of the Nyquist frequency, within the recording",
        error=float(error[1:-1].max()),
        x_label="frame",
        y_label="error of the amplitude",
        curves=[(np.arange(len(error)), error, frames.attrs["method"])],
        logarithmic=True,
    )


def large_offset() -> HardCase:
    """A constant of 10⁶ times the signal."""
    signal = total(line(0.5, 1.0, 0.2), line(5.5, 0.5, 1.0))
    band, angle = steady([signal], speed_rpm=1487.0, duration_s=10.0, rate_hz=20000.0)
    offset = band.copy(deep=True)
    offset["signal"] = offset["signal"] + 1e6
    plain, moved = (limited_frames(item, angle)["spectrum"].values[0] for item in (band, offset))
    axis = np.arange(plain.shape[1]) / 16
    return HardCase(
        asked="a constant of a million times the signal: half order and 5.5",
        error=float(np.abs(moved - plain)[:, 3:].max()),
        y_label="amplitude, mean of frames",
        curves=[
            (axis[1:], np.abs(moved[:, 1:]).mean(axis=0), "with the constant"),
            (axis[1:], np.abs(plain[:, 1:]).mean(axis=0), "without (truth)"),
        ],
        logarithmic=True,
    )


def range_of_24_bits() -> HardCase:
    """An order 120 dB below another, in samples rounded to 24 bits."""
    signal = total(line(1.0, 1.0, 0.2), line(5.5, 1e-6, 1.0))
    band, angle = steady([signal], speed_rpm=1487.0, duration_s=15.0, rate_hz=20000.0)
    step = 2.0**-23
    band["signal"] = (band["signal"] / step).round() * step
    frames = limited_frames(band, angle)
    found = frames["spectrum"].sel(order=5.5).values[0].mean()
    return HardCase(
        asked="order 5.5, 120 dB below order 1, in samples of 24 bits",
        error=float(abs(found / (1e-6 * np.exp(1j)) - 1.0)),
        mark=1e-2,
        y_label="amplitude, mean of frames",
        curves=[
            (frames["order"].values[1:], np.abs(frames["spectrum"].values[0].mean(axis=0))[1:], "found"),
            (np.array([1.0, 5.5]), np.array([1.0, 1e-6]), "truth"),
        ],
        logarithmic=True,
    )


def long_phase() -> HardCase:
    """The phase after 10⁸ samples: a recording that begins 10⁸ samples and 33,000 revolutions after angle 0."""
    rate, speed = 50000.0, 1000.0
    begin_s = 1e8 / rate
    n = int(10 * rate)
    time = begin_s + np.arange(n) / rate
    angle = time * speed / 60.0
    # the phase in exact arithmetic: revolutions and their share apart
    turns = (np.arange(n, dtype=np.int64) + 100_000_000) % 3000  # 3000 samples are one revolution
    signal = np.cos(2.0 * np.pi * 5.5 * ((np.arange(n) + 100_000_000) // 3000 % 2) + 2.0 * np.pi * 5.5 * turns / 3000.0)
    knots = begin_s + np.linspace(0.0, 10.0, 101)
    band = sampled(signal[None], rate_hz=rate, encoder_kind="none").assign_attrs(start_s=begin_s)
    frames = order_frames(band, shaft(knots, knots * speed / 60.0, np.full(101, speed)), settings=SETTINGS)
    found = frames["spectrum"].sel(order=5.5).values[0]
    return HardCase(
        asked="phase of order 5.5 after 10⁸ samples, by time from the first",
        error=float(np.abs(found - 1.0).max()),
        x_label="revolutions since the start",
        y_label="error of the amplitude",
        curves=[(frames["crank_angle"].values, np.abs(found - 1.0), f"angle up to {angle[-1]:.0f} rev")],
        logarithmic=True,
    )


def gaps() -> HardCase:
    """Samples that are not a number: frames that touch them are left out, all others are as if nothing were missing."""
    signal = total(line(2.0, 1.0, 0.4), line(5.5, 0.2, 1.0))
    band, angle = steady([signal], speed_rpm=1487.0, duration_s=20.0, rate_hz=20000.0)
    whole = limited_frames(band, angle)
    broken = band.copy(deep=True)
    for begin in (50_000, 200_000):
        broken["signal"].values[0, begin : begin + 2000] = np.nan
    frames = limited_frames(broken, angle)
    found, expected = (item["spectrum"].sel(order=[2.0, 5.5]).values[0] for item in (frames, whole))
    kept = np.isfinite(found).all(axis=1)
    assert 0 < kept.sum() < len(kept)
    return HardCase(
        asked=f"two gaps of 0.1 s: orders 2 and 5.5 in the {kept.sum()} frames of {len(kept)} that are left",
        error=float(np.abs(found - expected)[kept].max()),
        x_label="frame",
        curves=[
            *((np.arange(len(found)), np.abs(found[:, k]), f"order {o}") for k, o in enumerate((2, 5.5))),
            joined(np.arange(len(found)), np.tile([[1.0], [0.2]], len(found)), "truth"),
        ],
    )


def single_precision() -> HardCase:
    """Samples in float32: what they add to the error of float64."""
    signal = total(line(1.0, 1.0, 0.2), line(5.5, 0.01, 1.0), line(19.5, 0.3, -2.0))
    band, angle = steady([signal], speed_rpm=1487.0, duration_s=15.0, rate_hz=50000.0)
    single = band.copy()
    single["signal"] = band["signal"].astype(np.float32)
    found = [limited_frames(item, angle, band_hz=600.0)["spectrum"].values[0] for item in (single, band)]
    axis = np.arange(found[0].shape[1]) / 16
    truth = {1.0: np.exp(0.2j), 5.5: 0.01 * np.exp(1j), 19.5: 0.3 * np.exp(-2j)}
    return HardCase(
        asked="float32 samples: orders 1, 5.5 and 19.5",
        error=max(float(np.abs(found[0][:, round(16 * o)] - a).max()) for o, a in truth.items()),
        y_label="amplitude, mean of frames",
        curves=[
            (axis[1:], np.abs(item.mean(axis=0))[1:], name)
            for item, name in zip(found, ("float32", "float64"), strict=True)
        ],
        logarithmic=True,
    )


def extreme_amplitudes() -> HardCase:
    """Amplitudes of 1e-300 and 1e300 through filter, frames and map."""
    signal = total(line(2.0, 1.0, 0.4), line(5.5, 0.2, 1.0))
    band, angle = steady([signal], speed_rpm=1487.0, duration_s=10.0, rate_hz=20000.0)
    curves, worst = [], 0.0
    for scale in (1e-300, 1.0, 1e300):
        scaled = band.copy(deep=True)
        scaled["signal"] = scaled["signal"] * scale
        made = order_map([limited_frames(scaled, angle)], settings=SETTINGS)
        found = made["coherent_amplitude"].sel(order=[2.0, 5.5]).values[0, 0] / scale
        worst = max(worst, float(np.abs(found - [1.0, 0.2]).max()))
        curves.append((made["order"].values, made["coherent_amplitude"].values[0, 0] / scale, f"times {scale:g}"))
    return HardCase(
        asked="amplitudes of 1e-300 and 1e300 in the order map", error=worst, curves=curves,
        y_label="amplitude over scale", logarithmic=True,
    )  # fmt: skip


def heavy_smoothing() -> HardCase:
    """Vold–Kalman down to bandwidths where r² passes 1e20: an order of constant amplitude in a sweep."""
    rate = 50000.0
    time = np.arange(int(10 * rate)) / rate
    phase = 2.0 * (10.0 * time + time**2)
    signal = np.cos(2.0 * np.pi * phase + 0.3)
    shares = np.array([5e2, 5e3, 5e4, 5e5, 2e6])
    errors = []
    for share in shares:
        amplitude, _ = envelopes(signal[None], phase[None], rate_hz=rate, bandwidth_hz=rate / share)
        errors.append(float(np.abs(amplitude[0, 0] - np.exp(0.3j)).max()))
    return HardCase(
        asked="Vold–Kalman from rate/500 to rate/2,000,000 (r² 1e9…1e23): largest error",
        error=max(errors), x_label="sample rate over bandwidth", y_label="error of the amplitude",
        curves=[(shares, np.array(errors), "by knots or samples")], logarithmic=True, wide=True,
    )  # fmt: skip


CASES: dict[str, Callable[[], HardCase]] = {
    case.__name__: case
    for case in (
        close_orders, crossing_shafts, fast_ramps, two_revolutions, bin_edge, near_nyquist, large_offset,
        range_of_24_bits, long_phase, gaps, single_precision, extreme_amplitudes, heavy_smoothing,
    )
}  # fmt: skip


def joined(x: np.ndarray, rows: np.ndarray, label: str) -> tuple[np.ndarray, np.ndarray, str]:
    """One curve of several ``rows`` over ``x``, broken between them."""
    padded = np.hstack([rows, np.full((len(rows), 1), np.nan)])
    return np.tile(np.append(x, x[-1]), len(rows)), padded.ravel(), label
