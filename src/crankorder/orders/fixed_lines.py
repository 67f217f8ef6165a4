"""Rows of an order beside lines of one frequency, as mains are: what of a row is the order's, and what may be not.

The size of such a line is known from the other speeds of the test, where no order is near. Where an order meets it the
two are told apart by their beat over a recording, as far as that is long enough; what is left of the doubt is part of
the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import xarray as xr
from scipy.fft import fft, ifft, next_fast_len

from crankorder.fft.decimation import sound_samples
from crankorder.findings import Findings
from crankorder.orders.close_rows import Stretch
from crankorder.orders.intervals import LARGEST_DOF, Z95, amplitude_interval, phase_interval_deg
from crankorder.orders.joint_lines import Band, Place, hann_lobe, joint_lines
from crankorder.orders.true_angle import UNKNOWN_DEG
from crankorder.quantities import Bools, Complexes, Floats, Ints, QualityFlag
from crankorder.settings import MethodNumbers
from crankorder.shaft.angle import SpeedCourse

NUMBERS = MethodNumbers("3-orders-lines.toml", "fixed_lines")

SPREADS, COURSE_CYCLES, MOST_COURSES = 2.5, 0.5, 20
"""Standard deviations of the frequency of a line over which its power is spread on each side of it, cycles over the
recording between the courses that hold it, and how many there are on each side at most."""

RIGHT_ANGLE_DEG = 90.0
"""By which a line as large as the order may turn it; beyond, its phase is not known."""


@dataclass(frozen=True)
class OrderRows:
    """One order in all channels by row: peak amplitude, phase [degree], standard error, degrees of freedom, 95 % ends.

    Each (channels, rows), NaN (0 degrees of freedom) where nothing is known; the phase where there is no mark.
    """

    amplitude: Floats
    phase: Floats
    standard_error: Floats
    degrees_of_freedom: Floats
    amplitude_low: Floats
    amplitude_high: Floats
    phase_ci95: Floats

    @classmethod
    def nothing(cls, n_channels: int, n_rows: int) -> OrderRows:
        """Rows in which nothing is known: ``n_rows`` of them in ``n_channels`` channels."""
        given = [np.full((n_channels, n_rows), np.nan) for _ in fields(cls)]
        given[3] = np.zeros((n_channels, n_rows))
        return cls(*given)

    def of(self, which: Ints | Bools) -> OrderRows:
        """Those of the rows that ``which`` picks."""
        return OrderRows(*(getattr(self, item.name)[:, which] for item in fields(self)))

    def beside(self, other: OrderRows) -> OrderRows:
        """These rows, then those of ``other``."""
        names = [item.name for item in fields(self)]
        return OrderRows(*(np.concatenate([getattr(self, name), getattr(other, name)], axis=1) for name in names))


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


@dataclass(frozen=True, eq=False)
class MetRow:
    """A row of an order that meets fixed ``lines``: (channels,) complex amplitude, noise power of its error, freedom.

    ``doubt`` (channels,) is the largest that the lines may add to what is not parted from them; ``is_parted``
    (channels,) where the recordings told the order apart from them, ``touched`` (channels,) where they add to it
    at all, and ``matters`` (channels,) where that is more than noise hides.
    """

    row: int
    lines: tuple[FixedLine, ...]
    value: Complexes
    power: Floats
    freedom: Floats
    doubt: Floats
    is_parted: Bools
    touched: Bools
    matters: Bools


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


def met_rows(
    stretches: Sequence[Stretch],
    order: float,
    lines: Sequence[FixedLine],
    *,
    close: Sequence[float] = (),
    is_coherent: bool,
) -> list[MetRow]:
    """What the ``stretches`` of a test hold of an ``order`` apart from the fixed ``lines`` that it meets, row by row.

    Orders ``close`` to it are solved with it. Where the order is not known so well that its frames have one phase
    (``is_coherent``) nothing is told apart.
    """
    parts: dict[int, list[_Met]] = {}
    for stretch in stretches:
        met = _met(stretch, order, lines, close)
        if met is not None:
            parts.setdefault(stretch.row, []).append(met)
    return [_met_row(row, of_row, is_coherent) for row, of_row in parts.items()]


@dataclass(frozen=True, eq=False)
class _Met:
    """Amplitude ``value`` (channels,) of an order in one stretch, apart from ``lines``, and the ``power`` of its error.

    ``most`` (channels,) is the largest amplitude that the lines may have in a phasor of the order, ``by_noise``
    (channels,) the error that noise alone leaves of the mean of the frames.
    """

    lines: tuple[FixedLine, ...]
    value: Complexes
    power: Floats
    freedom: Floats
    most: Floats
    by_noise: Floats


def _met(stretch: Stretch, order: float, lines: Sequence[FixedLine], close: Sequence[float]) -> _Met | None:
    """The ``order`` in one stretch, apart from those of the ``lines`` that show there; None where none does.

    A line is of known power and unknown phase. Its frequency is known to an error and wanders, so that its power is
    spread over courses of frequencies about it.
    """
    held = stretch.held
    away = [np.abs(line.frequency_hz * held.pace_s - order).min() * held.revs for line in lines]
    near = [line for line, bins in zip(lines, away, strict=True) if bins < NUMBERS.reach_bins]
    band = Band.about(held, order, order) if near else None
    if band is None or len(held.turn) < 2:
        return None
    places, power = [Place(turns=turns) for turns in (order, *close)], [np.full(len(held.channels), np.inf)]
    power *= len(places)
    most = np.zeros(len(held.channels))
    seconds = held.span_rev * 60.0 / held.rpm
    for line in near:
        size, error = np.array([line.amplitude.get(name, (0.0, 0.0)) for name in held.channels]).T
        spread = float(np.hypot(line.error_hz, NUMBERS.wander_hz))
        half = min(int(np.ceil(SPREADS * spread * seconds / COURSE_CYCLES)), MOST_COURSES)
        off = np.linspace(-SPREADS * spread, SPREADS * spread, 2 * half + 1)
        weight = np.exp(-0.5 * np.square(off / spread))
        places += [Place(line.frequency_hz + step) for step in off.tolist()]
        whole = np.square(size / stretch.unit) + np.square(error / stretch.unit)
        power += [share * whole for share in (weight / weight.sum()).tolist()]
        most += np.abs(hann_lobe((line.frequency_hz * held.pace_s - order) * held.revs)).max() * (size + Z95 * error)
    solved = joint_lines(band, places, power=np.array(power))
    noise, freedom = solved.noise(0)
    unit = band.unit * stretch.unit
    value, variance = solved.phasor[0] * unit, solved.own[0] * noise * np.square(unit)
    by_noise = np.sqrt(0.5 * stretch.beside / len(held.turn)) * stretch.unit
    return _Met(tuple(near), value, variance, np.full(len(value), freedom), most, by_noise)


def _met_row(row: int, parts: Sequence[_Met], is_coherent: bool) -> MetRow:
    """The ``parts`` of one ``row``, of several stretches, together."""
    value, power = (np.array([getattr(part, name) for part in parts]) for name in ("value", "power"))
    weight = 1.0 / np.maximum(power, 1e-300)
    share = weight / weight.sum(axis=0)
    direction = (share * value).sum(axis=0)
    size = (share * np.abs(value)).sum(axis=0)
    told = size * direction / np.maximum(np.abs(direction), 1e-300)
    scatter = (share * np.square(np.abs(value) - size)).sum(axis=0) / max(len(parts) - 1, 1)
    joined = 1.0 / weight.sum(axis=0) + 2.0 * scatter
    doubt, by_noise = np.max([part.most for part in parts], axis=0), np.min([part.by_noise for part in parts], axis=0)
    return MetRow(
        row=row,
        lines=tuple(dict.fromkeys(line for part in parts for line in part.lines)),
        value=told if is_coherent else np.full(told.shape, np.nan + 0j),
        power=joined,
        freedom=np.min([part.freedom for part in parts], axis=0),
        doubt=doubt,
        is_parted=(joined < NUMBERS.parted_share**2 * np.square(doubt)) & is_coherent,
        touched=doubt > NUMBERS.least_share * by_noise,
        matters=doubt > Z95 * by_noise,
    )


def beside_fixed(rows: OrderRows, speed_rpm: Floats, met: Sequence[MetRow]) -> OrderRows:
    """``rows`` of an order at ``speed_rpm`` (rows,), those that ``met`` lines of one frequency apart from these.

    Where the recordings tell them apart the row is what the order is by itself. Where they do not, the interval holds
    whatever the lines may add or take; the amplitude is that of the speeds beside if the lines explain the difference,
    and stays what it is where they are too small for that.
    """
    if not met:
        return rows
    made = OrderRows(**{item.name: getattr(rows, item.name).copy() for item in fields(OrderRows)})
    open_rows = np.zeros(made.amplitude.shape, dtype=bool)
    for one in met:
        _put(made, one, one.touched & np.isfinite(rows.amplitude[:, one.row]))
        open_rows[:, one.row] = one.matters & ~one.is_parted
    for channel, row in zip(*np.nonzero(open_rows), strict=True):
        beside = _beside(speed_rpm, made.amplitude[channel], open_rows[channel], int(row))
        if made.amplitude_low[channel, row] <= beside <= made.amplitude_high[channel, row]:
            made.amplitude[channel, row] = beside
    return made


def _put(made: OrderRows, one: MetRow, touched: Bools) -> None:
    """The row ``one`` into ``made``, in the channels that its lines ``touched``."""
    row = one.row
    low, high = np.maximum(made.amplitude_low[:, row] - one.doubt, 0.0), made.amplitude_high[:, row] + one.doubt
    size, phase = made.amplitude[:, row], made.phase[:, row]
    is_told = touched & one.is_parted
    own_low, own_high = amplitude_interval(np.abs(one.value), one.power, one.freedom)
    agree = is_told & (np.maximum(own_low, low) <= np.minimum(own_high, high))
    low, high = np.where(agree, np.maximum(own_low, low), low), np.where(agree, np.minimum(own_high, high), high)
    size = np.clip(np.where(agree, np.abs(one.value), size), low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = np.degrees(np.arcsin(np.minimum(one.doubt / made.amplitude[:, row], 1.0)))
    as_shown = np.where(turned < RIGHT_ANGLE_DEG, made.phase_ci95[:, row] + turned, UNKNOWN_DEG)
    half = np.where(agree, phase_interval_deg(np.abs(one.value), one.power, one.freedom), as_shown)
    error = np.where(agree, np.sqrt(0.5 * one.power), 0.5 * (high - low) / Z95)
    told = {
        "amplitude": size,
        "amplitude_low": low,
        "amplitude_high": high,
        "standard_error": np.maximum(error, np.where(agree, 0.0, np.nan_to_num(made.standard_error[:, row]))),
        "degrees_of_freedom": np.where(agree, one.freedom, LARGEST_DOF),
        "phase": np.where(agree & np.isfinite(phase), np.degrees(np.angle(one.value)), phase),
        "phase_ci95": np.where(np.isfinite(phase), np.minimum(half, UNKNOWN_DEG), made.phase_ci95[:, row]),
    }
    for name, value in told.items():
        array: Floats = getattr(made, name)
        array[touched, row] = value[touched]


def _beside(speed_rpm: Floats, amplitude: Floats, is_open: Bools, row: int) -> float:
    """Amplitude at ``row`` straight between the nearest rows on both sides that are not open; NaN where none is."""
    clear = np.flatnonzero(np.isfinite(amplitude[: len(speed_rpm)]) & ~is_open[: len(speed_rpm)])
    clear = clear[np.argsort(speed_rpm[clear], kind="stable")]
    return float(np.interp(speed_rpm[row], speed_rpm[clear], amplitude[clear])) if len(clear) else np.nan


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
