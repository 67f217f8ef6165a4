"""Lines of one frequency, as mains are: those of a test that orders meet, and those taken out of sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.fft import fft, ifft, next_fast_len

from crankorder.fft.decimation import sound_samples
from crankorder.findings import Findings
from crankorder.orders.intervals import Z95
from crankorder.quantities import Bools, Complexes, Floats, QualityFlag
from crankorder.settings import MethodNumbers
from crankorder.shaft.angle import SpeedCourse


@dataclass(frozen=True, eq=False)
class FixedLine:
    """A line of one frequency of a test, and its standard error, Hz: what it is called, and its amplitude by channel.

    ``amplitude`` holds peak and standard error, over the speeds, where no order was near.
    """

    frequency_hz: float
    error_hz: float
    name: str
    amplitude: dict[str, tuple[float, float]]

    @property
    def text(self) -> str:
        """The line in a sentence."""
        return f"{self.name} of {self.frequency_hz:.5g} Hz"


def lines_of_findings(findings: Findings) -> tuple[FixedLine, ...]:
    """The lines of one frequency that ``findings`` name, with their amplitudes in all channels."""
    found: dict[float, FixedLine] = {}
    for one in findings.lines:
        ends, size = one.frequency_hz_ci95, one.amplitude_ci95
        if one.frequency_hz is None or ends is None or size is None or one.amplitude is None:
            continue
        hertz, high = ends[1], size[1]
        if "order" in one.kinds or hertz is None or high is None:
            continue
        error = (hertz - one.frequency_hz) / Z95
        line = found.setdefault(one.frequency_hz, FixedLine(one.frequency_hz, error, str(one.explained_by), {}))
        line.amplitude[one.channel] = one.amplitude, (high - one.amplitude) / Z95
    return tuple(found.values())


STEADY_NUMBERS = MethodNumbers("3-orders-lines.toml", "steady_lines")

PADDED = 8
"""Points of the spectrum of a line between its bins."""


@dataclass(frozen=True)
class SteadyLine:
    """A line Re(``amplitude`` exp(2πi ``frequency_hz`` t)) (channels,), t from the first sample."""

    frequency_hz: float
    amplitude: Complexes


def without_steady_lines(
    band: xr.Dataset, course: SpeedCourse, orders: Floats, *, mains_hz: Sequence[float] = ()
) -> tuple[xr.Dataset, tuple[SteadyLine, ...]]:
    """``band`` (BandRecording by time) less its steady lines, and these.

    ``course`` is the speed of its shaft; the stretches in which one of ``orders`` (orders,) passes a line tell nothing
    of it. A line has one amplitude and one phase through all others; what a mode rings, or an order that hardly moves,
    does not. Lines are looked for about multiples of ``mains_hz`` and at the highest peaks.
    """
    signals, rate = band["signal"].values, float(band.attrs["rate_hz"])
    time = float(band.attrs.get("start_s", 0.0)) + np.arange(signals.shape[1]) / rate
    usable: Bools = np.asarray(sound_samples(band).all(axis=0))
    if not usable.any():
        return band, ()
    seen = _Seen.of(np.where(usable, signals, 0.0), usable, rate, float(band.attrs.get("band_hz", 0.4 * rate)))
    speed = np.interp(time[:: seen.every], course.time_s, course.speed_rpm)
    turns = np.interp(time[:: seen.every], course.time_s, course.rate_rpm_per_s)
    found: list[SteadyLine] = []
    for low, high in seen.candidates(mains_hz):
        line = seen.line(low, high, speed, turns, orders)
        if line is not None and all(abs(line.frequency_hz - one.frequency_hz) > 2.0 / seen.length_s for one in found):
            found.append(line)
    if not found:
        return band, ()
    less = signals.copy()
    for line in found:
        phase = 2.0 * np.pi * (line.frequency_hz * np.arange(len(time)) / rate % 1.0)
        for signal, amplitude in zip(less, line.amplitude, strict=True):
            signal -= (np.abs(amplitude) * np.cos(phase + np.angle(amplitude))).astype(less.dtype)
    return band.assign(signal=(band["signal"].dims, less, band["signal"].attrs)), tuple(found)


def steady_flag(recording: str, lines: tuple[SteadyLine, ...]) -> QualityFlag:
    """What is said of the ``lines`` that were taken out of a ``recording``."""
    named = ", ".join(f"{one.frequency_hz:.2f} Hz ({np.abs(one.amplitude).max():.3g})" for one in lines)
    detail = (
        f"lines of one frequency through the whole sweep are taken out before orders are followed: {named}, of the "
        "largest amplitude in any channel; where an order crosses one it would be taken for the order"
    )
    return {"recording": recording, "flag": "steady_lines_taken_out", "severity": "info", "detail": detail}


@dataclass(frozen=True, eq=False)
class _Seen:
    """Transform (channels, bins) of a recording, at ``rate_hz``; ``usable`` one sample in ``every``, ``band_hz``."""

    spectrum: Complexes
    usable: Bools
    rate_hz: float
    band_hz: float
    length_s: float
    every: int
    points: int

    @classmethod
    def of(cls, signals: Floats, usable: Bools, rate_hz: float, band_hz: float) -> _Seen:
        """The transform of ``signals`` (channels, samples), 0 where not ``usable``, of ``band_hz`` at ``rate_hz``."""
        n = signals.shape[1]
        every = max(1, int(rate_hz / (2.0 * STEADY_NUMBERS.looked_hz)))
        # a whole number of samples to each point of the narrow band, and room for what wraps around
        points = next_fast_len(-(-n // every) + 8)
        return cls(fft(signals, points * every, axis=1), usable[::every], rate_hz, band_hz, n / rate_hz, every, points)

    def candidates(self, mains_hz: Sequence[float]) -> list[tuple[float, float]]:
        """Ranges of frequency [Hz] in which a line may be: about multiples of ``mains_hz``, and about high peaks."""
        step = self.rate_hz / self.spectrum.shape[1]
        top = min(0.45 * self.rate_hz, self.band_hz) - STEADY_NUMBERS.looked_hz
        mains = [hz * k for hz in mains_hz for k in range(1, STEADY_NUMBERS.most_multiples + 1)]
        power = np.sum(np.abs(_hann(self.spectrum[:, : int(top / step) if top > 0.0 else 0])) ** 2, axis=0)
        whole = power[: len(power) // STEADY_NUMBERS.peak_bins * STEADY_NUMBERS.peak_bins].reshape(
            -1, STEADY_NUMBERS.peak_bins
        )
        level = np.repeat(np.median(whole, axis=1), STEADY_NUMBERS.peak_bins)
        ratio = power[: len(level)] / np.maximum(level, np.finfo(float).tiny)
        high = np.flatnonzero(
            (ratio > STEADY_NUMBERS.peak_ratio**2) & (np.arange(len(ratio)) * step > STEADY_NUMBERS.looked_hz)
        )
        best = high[np.argsort(-ratio[high], kind="stable")][: 4 * STEADY_NUMBERS.most_peaks]
        peaks: list[float] = []
        for place in best.tolist():
            if len(peaks) < STEADY_NUMBERS.most_peaks and all(
                abs(place * step - other) > 4.0 * step for other in peaks
            ):
                peaks.append(place * step)
        ranges = [(hz - 2.0 / self.length_s, hz + 2.0 / self.length_s) for hz in peaks]
        return [
            *ranges,
            *(
                (hz * (1.0 - STEADY_NUMBERS.mains_share), hz * (1.0 + STEADY_NUMBERS.mains_share))
                for hz in mains
                if hz < top
            ),
        ]

    def line(
        self, low_hz: float, high_hz: float, speed_rpm: Floats, rates: Floats, orders: Floats
    ) -> SteadyLine | None:
        """The steady line between ``low_hz`` and ``high_hz``; None where none stands out, or it is not steady.

        ``speed_rpm`` and ``rates`` [rpm/s] (points,) are those of the shaft, ``orders`` (orders,) what moves with it.
        """
        middle = 0.5 * (low_hz + high_hz)
        turning = speed_rpm[speed_rpm > 0.01 * speed_rpm.max()]
        if middle * (1.0 - float(turning.min() / turning.max())) * self.length_s < STEADY_NUMBERS.least_moved:
            return None
        clear = _clear(middle, high_hz - low_hz, speed_rpm, rates, orders) * self.usable
        narrow = self._narrow(middle)[:, : len(clear)]
        dt = self.every / self.rate_hz
        window = clear * np.sin(np.pi * (np.arange(len(clear)) + 0.5) / len(clear)) ** 2
        if window.sum() < STEADY_NUMBERS.fewest_pieces / STEADY_NUMBERS.pieces * 0.5 * len(clear):
            return None
        size = next_fast_len(PADDED * len(clear))
        seen = np.abs(fft(narrow * window, size, axis=1)) ** 2
        offset = np.fft.fftfreq(size, dt)
        inside = np.abs(offset) < 0.4 / dt
        level = np.median(seen[:, inside], axis=1, keepdims=True) / np.log(2.0)
        total = np.sum(seen / np.maximum(level, np.finfo(float).tiny), axis=0)
        allowed = inside & (offset >= low_hz - middle) & (offset <= high_hz - middle)
        best = int(np.argmax(np.where(allowed, total, -1.0)))
        from scipy.special import chdtri

        if 2.0 * total[best] < chdtri(2.0 * len(seen), STEADY_NUMBERS.chance / max(1, int(allowed.sum()))):
            return None
        return _steady_line(
            narrow, window, clear, middle, float(_finer(total, best) * (offset[1] - offset[0])), dt, offset[best]
        )

    def _narrow(self, middle_hz: float) -> Complexes:
        """The signal (channels, points) within the rate of the narrow band about ``middle_hz``, turned back by that."""
        step = self.rate_hz / self.spectrum.shape[1]
        centre = round(middle_hz / step)
        bins = (centre + np.fft.fftfreq(self.points, 1.0 / self.points).astype(int)) % self.spectrum.shape[1]
        back = np.exp(2j * np.pi * (centre * step - middle_hz) * np.arange(self.points) * self.every / self.rate_hz)
        return np.asarray(2.0 / self.every * ifft(self.spectrum[:, bins], axis=1) * back)


def _hann(spectrum: Complexes) -> Complexes:
    """``spectrum`` (…, bins) as a Hann window would have made it."""
    return np.asarray(spectrum - 0.5 * (np.roll(spectrum, 1, axis=-1) + np.roll(spectrum, -1, axis=-1)))


def _finer(power: Floats, best: int) -> float:
    """How far the top of ``power`` lies from its place ``best``, by the parabola of the three about it."""
    before, here, after = (float(power[(best + way) % len(power)]) for way in (-1, 0, 1))
    bend = before - 2.0 * here + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0


def _clear(middle_hz: float, width_hz: float, speed_rpm: Floats, rates: Floats, orders: Floats) -> Floats:
    """Weight (points,) of the times at which none of ``orders`` is near ``middle_hz``, which is known to a width."""
    weight = np.ones(len(speed_rpm))
    for order in orders.tolist():
        apart = np.abs(order * speed_rpm / 60.0 - middle_hz) - 0.5 * width_hz
        reach = np.maximum(STEADY_NUMBERS.clear_of * np.sqrt(order * rates / 60.0), STEADY_NUMBERS.least_clear_hz)
        weight *= np.sin(0.5 * np.pi * np.clip(apart / reach - 1.0, 0.0, 1.0)) ** 2
    return weight


def _steady_line(
    narrow: Complexes, window: Floats, clear: Floats, middle_hz: float, finer_hz: float, dt: float, offset_hz: float
) -> SteadyLine | None:
    """The line ``offset_hz`` + ``finer_hz`` beside ``middle_hz`` of ``narrow`` (channels, points), if it is steady."""
    off = float(offset_hz) + finer_hz
    turned = narrow * np.exp(-2j * np.pi * off * np.arange(narrow.shape[1]) * dt)
    amplitude = (turned @ window) / window.sum()
    pieces = np.array_split(np.arange(len(clear)), STEADY_NUMBERS.pieces)
    weights = np.array([clear[piece].sum() for piece in pieces])
    kept = weights > 0.5 * len(pieces[0])
    if np.count_nonzero(kept) < STEADY_NUMBERS.fewest_pieces:
        return None
    means = np.array([turned[:, piece] @ clear[piece] for piece in pieces]).T[:, kept] / weights[kept]
    # within pieces, and in most of them: what rings in one would else hide that it does not in the others
    strays = np.array([np.abs(turned[:, piece]) ** 2 @ clear[piece] for piece in pieces]).T[:, kept] / weights[kept]
    noise = np.median(strays - np.abs(means) ** 2, axis=1) / (0.5 * weights[kept].min())
    scatter = np.mean(np.abs(means - amplitude[:, None]) ** 2, axis=1)
    size = np.abs(amplitude) ** 2
    best = int(np.argmax(size / np.maximum(noise, np.finfo(float).tiny)))
    if scatter[best] > STEADY_NUMBERS.steady_share**2 * size[best] + 2.0 * noise[best]:
        return None
    return SteadyLine(middle_hz + off, amplitude)
