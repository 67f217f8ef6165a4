"""Lines of one frequency, as mains are: taken out of sweeps, and told apart from the orders that meet them.

Where an order is so close to other lines that no frame parts them its rows are solved over whole recordings, as they
beat. The others are orders, of which nothing is known, and lines of one frequency, whose size is known from the other
speeds of the test, where no order is near. What is left of the doubt is part of the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.fft import fft, ifft, next_fast_len
from scipy.special import chdtri

from crankorder.fft.decimation import sound_samples
from crankorder.findings import Findings
from crankorder.orders.intervals import LARGEST_DOF, Z95, amplitude_interval, phase_interval_deg
from crankorder.orders.joint_lines import Band, HeldFrames, JointLines, Place, hann_lobe, joint_lines
from crankorder.orders.true_angle import UNKNOWN_DEG, AngleErrors, errors_of_rows
from crankorder.quantities import Bools, Complexes, Floats, QualityFlag, remark
from crankorder.settings import MethodNumbers
from crankorder.shaft.angle import SpeedCourse

NUMBERS = MethodNumbers("3-orders-lines.toml", "fixed_lines")

ALIKE_BEATS = 0.25
"""Lines that beat less often in the longest recording are one by two names: nothing could have told them apart."""

LEFT_RATIO = 4.0
"""Power left over that is so many times the noise beside is of a line whose phase wanders or whose number is wrong."""

DOUBT = 2.0
"""Standard errors by which the number of a line may be off."""

SPREADS, COURSE_CYCLES, MOST_COURSES = 2.5, 0.5, 20
"""Standard deviations of the frequency of a line over which its power is spread on each side of it, cycles over the
recording between the courses that hold it, and how many there are on each side at most."""


@dataclass(frozen=True, eq=False)
class FixedLine:
    """A line of one frequency of a test, with its standard error, both in Hz, its ``name`` and amplitude by channel.

    ``amplitude`` holds the peak and its standard error over those speeds at which no order was near.
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
    """The lines that stay at one frequency in ``findings``, with their amplitudes by channel."""
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


class OrderRows(NamedTuple):
    """One order in all channels by row, each field (channels, rows); NaN (0 degrees of freedom) where it is not known.

    ``amplitude`` is the peak, ``phase`` in degrees is NaN where there is no mark either, ``standard_error`` that of the
    amplitude with its ``degrees_of_freedom``; ``amplitude_low`` and ``amplitude_high`` are the ends of the 95 %
    interval, ``phase_ci95`` in degrees the half width of that of the phase.
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
        """Rows (``n_channels``, ``n_rows``) in which nothing is known."""
        rows = np.full((len(cls._fields), n_channels, n_rows), np.nan)
        return cls(*rows)._replace(degrees_of_freedom=np.zeros((n_channels, n_rows)))

    def without(self, hidden: Bools) -> OrderRows:
        """These rows, of which nothing is known where they are ``hidden`` (rows,)."""
        nothing = OrderRows.nothing(*self.amplitude.shape)
        return OrderRows(*(np.where(hidden, none, values) for none, values in zip(nothing, self, strict=True)))


class Stretch(NamedTuple):
    """Frames of one recording (OrderFrames ``item``) in one ``row`` of the map.

    Spectra are in the ``unit`` (channels,); ``beside`` (channels,) is the noise power of a phasor by the bins beside.
    """

    item: xr.Dataset
    row: int
    held: HeldFrames
    beside: Floats
    unit: Floats


class PartedRow(NamedTuple):
    """One ``row`` of an ``order`` separated from the lines beside it, each array (channels,) unless stated.

    ``value`` is the complex amplitude with the phase at angle 0, ``power`` that of the noise with ``freedom`` degrees
    of freedom. ``slack`` (3, channels) is what the value may have taken from the lines beside, along and across it,
    where their numbers are wrong, and what no line explains; the latter belongs to the order where it ``wanders``.
    ``doubt`` is the most that other lines, the fixed ``lines`` among them, may add to an order that is not separated
    from them. ``beats`` says whether the order beats with close orders often enough to be separated, ``by_noise`` is
    the error of the mean of the frames from noise alone, ``angle`` the errors of the crank angle.
    """

    row: int
    order: float
    lines: tuple[FixedLine, ...]
    wanders: bool
    beats: bool
    value: Complexes
    power: Floats
    freedom: Floats
    slack: Floats
    doubt: Floats
    by_noise: Floats
    angle: AngleErrors

    @property
    def error(self) -> Floats:
        """Standard error (channels,) along one axis."""
        return np.asarray(np.sqrt(0.5 * self.power + np.square(self.slack[[0, 2]] / DOUBT).sum(axis=0)))

    @property
    def is_parted(self) -> Bools:
        """Where (channels,) the recordings told the order apart from the others."""
        return np.asarray(self.beats & (np.sqrt(2.0) * self.error < NUMBERS.parted_share * self.doubt))

    @property
    def matters(self) -> Bools:
        """Where (channels,) the others may add more than noise hides."""
        return np.asarray(self.doubt > Z95 * self.by_noise)


def parted_rows(
    stretches: Sequence[Stretch], orders: Floats, exact: Bools, apart: Sequence[float], fixed: Sequence[FixedLine]
) -> list[PartedRow]:
    """The first of ``orders`` in the ``stretches`` of a test, separated from the lines beside it, by row.

    All lines are solved together. How wrong the numbers of inexact lines may be follows from all stretches together,
    and from a single one where it surely says otherwise. Where only the first line is inexact, power that no line
    explains belongs to it.

    Parameters
    ----------
    stretches : frames of the recordings, by row of the map
    orders : (lines,), cycles per revolution: the order to read, then those close to it
    exact : (lines,), whether the number of each is exact
    apart : orders that a frame already separates from the first one
    fixed : lines of one frequency, of which those count that the order meets
    """
    solved = []
    for stretch in stretches:
        band = Band.about(stretch.held, float(orders.min()), float(orders.max()))
        lines, courses, power, most = _met(stretch, float(orders[0]), fixed)
        if band is not None and (lines or len(orders) > 1):
            places = [*(Place(turns=float(order)) for order in (*orders, *apart)), *courses]
            power = np.pad(power, ((len(places) - len(power), 0), (0, 0)), constant_values=np.inf)
            free = [number < len(orders) and not exact[number] for number in range(len(places))]
            fit = joint_lines(band, places, free=free, power=power if lines else None, settled=False)
            solved.append((stretch, lines, most, fit))
    if not solved:
        return []
    normal, score = (np.sum(each, axis=0) for each in zip(*(fit.information for *_, fit in solved), strict=True))
    off, error = _off(normal, score)
    parts: dict[int, list[PartedRow]] = {}
    for stretch, lines, most, fit in solved:
        part = _part(stretch, orders, fit, np.abs(off) + DOUBT * error)
        # a number that lines nearby may have moved parts nothing from them
        beats = part.beats and (bool(exact[0]) or not lines)
        part = part._replace(lines=lines, doubt=part.doubt + most * stretch.unit, beats=beats)
        parts.setdefault(stretch.row, []).append(part)
    wanders = bool(not exact[0] and exact[1:].all())
    return [_joined(of_row)._replace(wanders=wanders) for of_row in parts.values()]


def _met(
    stretch: Stretch, order: float, fixed: Sequence[FixedLine]
) -> tuple[tuple[FixedLine, ...], list[Place], Floats, Floats]:
    """Those of the ``fixed`` lines that an ``order`` meets, none as the speed sweeps; their courses, and their power.

    A line is of known power and unknown phase. Its frequency is known to an error and wanders, so that its power is
    spread over courses of frequencies about it (courses, channels). Last, the largest (channels,) that the lines may
    add to a phasor of the order.
    """
    held, lines, places, power = stretch.held, [], [], [np.zeros((0, len(stretch.unit)))]
    most = np.zeros(len(stretch.unit))
    for line in () if stretch.item.attrs.get("swept", 0) else fixed:
        away = (line.frequency_hz * held.pace_s - order) * held.revs
        if np.abs(away).min() >= NUMBERS.reach_bins:
            continue
        size, error = np.array([line.amplitude.get(name, (0.0, 0.0)) for name in held.channels]).T / stretch.unit
        spread = float(np.hypot(line.error_hz, NUMBERS.wander_hz))
        cycles = SPREADS * spread * held.span_rev * 60.0 / held.rpm
        half = min(int(np.ceil(cycles / COURSE_CYCLES)), MOST_COURSES)
        off = np.linspace(-SPREADS, SPREADS, 2 * half + 1)
        weight = np.exp(-0.5 * np.square(off))
        lines.append(line)
        places += [Place(line.frequency_hz + spread * step) for step in off.tolist()]
        power.append(np.outer(weight / weight.sum(), np.square(size) + np.square(error)))
        most += np.abs(hann_lobe(away)).max() * (size + Z95 * error)
    return tuple(lines), places, np.concatenate(power), most


def _off(normal: Floats, score: Floats) -> tuple[Floats, Floats]:
    """By how much numbers (lines,) are off, and the standard error of that; directions that nothing tells are left."""
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    return np.asarray(inverse @ score), np.sqrt(np.maximum(np.diag(inverse), 0.0))


def _part(stretch: Stretch, orders: Floats, fit: JointLines, doubt: Floats) -> PartedRow:
    """What the ``fit`` of one stretch says of the first of ``orders``, numbers being off by the ``doubt`` (free,)."""
    held, order, band, line = stretch.held, float(orders[0]), fit.band, fit.sighting(0)
    unit, n = band.unit * stretch.unit, len(held.turn)
    bins = np.abs(band.bins - order * held.revs)
    share = float(hann_lobe(bins.min()))
    close = fit.left + band.waves(fit.places[: len(orders)]) @ fit.phasor[: len(orders)]
    left, seen = (np.abs(band.spectra(part)[:, bins.argmin()]) * band.unit for part in (fit.left, close))
    unexplained = np.maximum(np.square(left).mean(axis=0) - LEFT_RATIO * stretch.beside, 0.0)
    both = seen.max(axis=0) / share + Z95 * np.sqrt(stretch.beside)
    off, known = _off(*fit.information)
    doubt = np.minimum(np.maximum(doubt, np.abs(off) - (1.0 + DOUBT) * known), 0.5 / held.span_rev)
    along, across = (np.sqrt(variance) * unit for variance in fit.doubt(0, np.diag(np.square(doubt))))
    slack = np.array([along, across, np.sqrt(unexplained) / share * stretch.unit])
    power, freedom = fit.own[0] * fit.noise(0)[0] * np.square(unit), np.full(len(unit), line.degrees_of_freedom)
    both, by_noise = both * stretch.unit * (len(orders) > 1), np.sqrt(0.5 * stretch.beside / n) * stretch.unit
    sizes = line.phasor * stretch.unit, power, freedom, slack, both, by_noise
    angle = errors_of_rows([stretch.item], np.zeros(n, dtype=np.int64), [np.arange(n)])
    beats = all(held.parts(order, float(other)) for other in orders[1:])
    return PartedRow(stretch.row, order, (), False, beats, *sizes, angle)


def _joined(parts: Sequence[PartedRow]) -> PartedRow:
    """The ``parts`` of one row, of several stretches, as one, each by its error: those that beat where some do."""
    used = [part for part in parts if part.beats] or list(parts)
    value, power, error = (np.array([getattr(part, name) for part in used]) for name in ("value", "power", "error"))
    weight = 1.0 / np.maximum(np.square(error), 1e-300)
    share = weight / weight.sum(axis=0)
    size, direction = (share * np.abs(value)).sum(axis=0), (share * value).sum(axis=0)
    scatter = (share * np.square(np.abs(value) - size)).sum(axis=0) / max(len(used) - 1, 1)
    power = (np.square(share) * power).sum(axis=0) + 2.0 * scatter
    freedom, by_noise = (np.min([getattr(part, name) for part in used], axis=0) for name in ("freedom", "by_noise"))
    slack, doubt = (np.max([getattr(part, name) for part in used], axis=0) for name in ("slack", "doubt"))
    angle = AngleErrors(*np.max([(part.angle.random, part.angle.mean) for part in used], axis=0))
    value = size * direction / np.maximum(np.abs(direction), 1e-300)
    lines = tuple(dict.fromkeys(line for part in used for line in part.lines))
    sizes = value, power, freedom, slack, doubt, by_noise
    return PartedRow(used[0].row, used[0].order, lines, False, used[0].beats, *sizes, angle)


def with_parted(rows: OrderRows, speed_rpm: Floats, parted: Sequence[PartedRow]) -> OrderRows:
    """``rows`` of an order at ``speed_rpm`` (rows,), with those in ``parted`` separated from the lines beside.

    Where the recordings tell the lines apart, a row holds the order by itself. Where they do not, the interval covers
    all that the lines may add or take; the amplitude is that of the neighbouring speeds if the lines explain the
    difference, and stays as it is where they are too small for that.
    """
    made = OrderRows(*map(np.copy, rows))
    is_open = np.zeros(made.amplitude.shape, dtype=bool)
    for row in parted:
        known = np.isfinite(rows.amplitude[:, row.row])
        for values, value in zip(made, _apart(rows, row), strict=True):
            values[known, row.row] = value[known]
        is_open[:, row.row] = row.matters & ~row.is_parted & bool(row.lines)
    for channel in np.flatnonzero(is_open.any(axis=1)):
        amplitude, gap = made.amplitude[channel], is_open[channel]
        clear = np.flatnonzero(np.isfinite(amplitude) & ~gap)
        clear = clear[np.argsort(speed_rpm[clear], kind="stable")]
        if len(clear):
            beside = np.interp(speed_rpm[gap], speed_rpm[clear], amplitude[clear])
            within = (made.amplitude_low[channel, gap] <= beside) & (beside <= made.amplitude_high[channel, gap])
            amplitude[gap] = np.where(within, beside, amplitude[gap])
    return made


def _apart(rows: OrderRows, parted: PartedRow) -> tuple[Floats, ...]:
    """Fields of OrderRows (channels,) of the row ``parted`` of ``rows``."""
    size, phase, error, _, low, high, half = (values[:, parted.row] for values in rows)
    own, power, order = np.abs(parted.value), parted.power, np.array(parted.order)
    along, across, beyond = parted.slack
    own_low, own_high = amplitude_interval(own, power, parted.freedom)
    own_low, own_high = own_low - along, (own_high + along + beyond) / parted.angle.kept(order)
    own_half = phase_interval_deg(own, power + 2.0 * np.square(across / DOUBT), parted.freedom)
    own_half, own_phase = parted.angle.phase_half_deg(own_half, order), np.degrees(np.angle(parted.value))
    low, high = np.maximum(low - parted.doubt, 0.0), high + parted.doubt
    agree = parted.is_parted & (np.maximum(own_low, low) <= np.minimum(own_high, high))
    low, high = np.where(agree, np.maximum(own_low, low), low), np.where(agree, np.minimum(own_high, high), high)
    own = np.hypot(own, beyond) if parted.wanders else own
    with np.errstate(divide="ignore", invalid="ignore"):
        half = half + np.degrees(np.arcsin(parted.doubt / size))
    half = np.where(half < UNKNOWN_DEG, half, UNKNOWN_DEG)
    size = np.clip(np.where(agree | (not parted.lines), own, size), low, high)
    error = np.where(agree, parted.error, np.fmax(0.5 * (high - low) / Z95, error))
    has_phase, freedom = np.isfinite(phase), np.where(agree, parted.freedom, LARGEST_DOF)
    pairs = ((own_phase, phase), (own_half, half))
    phase, half = (np.where(has_phase, np.where(agree, *pair), np.nan) for pair in pairs)
    return size, phase, error, freedom, low, high, half


STEADY = MethodNumbers("3-orders-lines.toml", "steady_lines")

PADDED = 8
"""Points of the spectrum of a line between its bins."""


class SteadyLine(NamedTuple):
    """A line Re(``amplitude`` exp(2πi ``frequency_hz`` t)), t [s] from the first sample; ``amplitude`` (channels,)."""

    frequency_hz: float
    amplitude: Complexes


def without_steady_lines(
    band: xr.Dataset, course: SpeedCourse, orders: Floats, *, mains_hz: Sequence[float] = ()
) -> tuple[xr.Dataset, tuple[SteadyLine, ...]]:
    """``band`` (BandRecording by time) without its steady lines, and these lines.

    ``course`` is the speed of its shaft; the stretches in which one of ``orders`` (orders,) passes a line tell nothing
    of it. Through all other stretches a line has one amplitude and one phase; a ringing mode, or an order that hardly
    moves, has not. Lines are looked for about multiples of ``mains_hz`` and at the highest peaks.
    """
    signals, rate = band["signal"].values, float(band.attrs["rate_hz"])
    time = float(band.attrs.get("start_s", 0.0)) + np.arange(signals.shape[1]) / rate
    usable = np.asarray(sound_samples(band).all(axis=0))
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
    """Quality flag on the ``lines`` that were taken out of a ``recording``."""
    named = ", ".join(f"{one.frequency_hz:.2f} Hz ({np.abs(one.amplitude).max():.3g})" for one in lines)
    detail = (
        f"lines of one frequency through the whole sweep are taken out before orders are followed: {named}, of the "
        "largest amplitude in any channel; where an order crosses one it would be taken for the order"
    )
    return remark(recording, "steady_lines_taken_out", detail)


class _Seen(NamedTuple):
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
        every = max(1, int(rate_hz / (2.0 * STEADY.looked_hz)))
        # a whole number of samples to each point of the narrow band, and room for what wraps around
        points = next_fast_len(-(-n // every) + 8)
        return cls(fft(signals, points * every, axis=1), usable[::every], rate_hz, band_hz, n / rate_hz, every, points)

    def candidates(self, mains_hz: Sequence[float]) -> list[tuple[float, float]]:
        """Ranges of frequency [Hz] in which a line may be: about multiples of ``mains_hz``, and about high peaks."""
        step = self.rate_hz / self.spectrum.shape[1]
        top = min(0.45 * self.rate_hz, self.band_hz) - STEADY.looked_hz
        low = self.spectrum[:, : int(top / step) if top > 0.0 else 0]
        windowed = low - 0.5 * (np.roll(low, 1, axis=-1) + np.roll(low, -1, axis=-1))  # as a Hann window had made it
        power = np.sum(np.abs(windowed) ** 2, axis=0)
        whole = power[: len(power) // STEADY.peak_bins * STEADY.peak_bins].reshape(-1, STEADY.peak_bins)
        level = np.repeat(np.median(whole, axis=1), STEADY.peak_bins)
        ratio = power[: len(level)] / np.maximum(level, np.finfo(float).tiny)
        ratio[: int(STEADY.looked_hz / step) + 1] = 0.0
        high = np.flatnonzero(ratio > STEADY.peak_ratio**2)
        best = high[np.argsort(-ratio[high], kind="stable")][: 4 * STEADY.most_peaks]
        peaks: list[int] = []
        for place in best.tolist():
            if all(abs(place - other) > 4 for other in peaks[: STEADY.most_peaks]):
                peaks.append(place)
        ranges = [(place * step, 2.0 / self.length_s) for place in peaks[: STEADY.most_peaks]]
        mains = [hz * k for hz in mains_hz for k in range(1, STEADY.most_multiples + 1)]
        ranges += [(hz, hz * STEADY.mains_share) for hz in mains if hz < top]
        return [(hz - reach, hz + reach) for hz, reach in ranges]

    def line(
        self, low_hz: float, high_hz: float, speed_rpm: Floats, rates: Floats, orders: Floats
    ) -> SteadyLine | None:
        """The steady line between ``low_hz`` and ``high_hz``; None where none stands out, or it is not steady.

        ``speed_rpm`` and ``rates`` [rpm/s] (points,) are those of the shaft, ``orders`` (orders,) what moves with it.
        """
        middle = 0.5 * (low_hz + high_hz)
        turning = speed_rpm[speed_rpm > 0.01 * speed_rpm.max()]
        if middle * (1.0 - float(turning.min() / turning.max())) * self.length_s < STEADY.least_moved:
            return None
        clear = _clear(middle, high_hz - low_hz, speed_rpm, rates, orders) * self.usable
        narrow = self._narrow(middle)[:, : len(clear)]
        dt = self.every / self.rate_hz
        window = clear * np.sin(np.pi * (np.arange(len(clear)) + 0.5) / len(clear)) ** 2
        if window.sum() < STEADY.fewest_pieces / STEADY.pieces * 0.5 * len(clear):
            return None
        size = next_fast_len(PADDED * len(clear))
        seen = np.abs(fft(narrow * window, size, axis=1)) ** 2
        offset = np.fft.fftfreq(size, dt)
        inside = np.abs(offset) < 0.4 / dt
        level = np.median(seen[:, inside], axis=1, keepdims=True) / np.log(2.0)
        total = np.sum(seen / np.maximum(level, np.finfo(float).tiny), axis=0)
        allowed = inside & (offset >= low_hz - middle) & (offset <= high_hz - middle)
        best = int(np.argmax(np.where(allowed, total, -1.0)))
        if 2.0 * total[best] < chdtri(2.0 * len(seen), STEADY.chance / max(1, int(allowed.sum()))):
            return None
        before, here, after = (float(total[(best + way) % size]) for way in (-1, 0, 1))
        bend = before - 2.0 * here + after
        finer = 0.5 * (before - after) / bend if bend < 0.0 else 0.0  # top of the parabola through the three
        off = float(offset[best] + finer * (offset[1] - offset[0]))
        turned = narrow * np.exp(-2j * np.pi * off * np.arange(narrow.shape[1]) * dt)
        amplitude = _steady_amplitude(turned, window, clear)
        return None if amplitude is None else SteadyLine(middle + off, amplitude)

    def _narrow(self, middle_hz: float) -> Complexes:
        """The signal (channels, points) within the rate of the narrow band about ``middle_hz``, turned back by that."""
        step = self.rate_hz / self.spectrum.shape[1]
        centre = round(middle_hz / step)
        bins = (centre + np.fft.fftfreq(self.points, 1.0 / self.points).astype(int)) % self.spectrum.shape[1]
        back = np.exp(2j * np.pi * (centre * step - middle_hz) * np.arange(self.points) * self.every / self.rate_hz)
        return np.asarray(2.0 / self.every * ifft(self.spectrum[:, bins], axis=1) * back)


def _clear(middle_hz: float, width_hz: float, speed_rpm: Floats, rates: Floats, orders: Floats) -> Floats:
    """Weight (points,) of the times at which none of ``orders`` is near ``middle_hz``, which is known to a width."""
    weight = np.ones(len(speed_rpm))
    for order in orders.tolist():
        apart = np.abs(order * speed_rpm / 60.0 - middle_hz) - 0.5 * width_hz
        reach = np.maximum(STEADY.clear_of * np.sqrt(order * rates / 60.0), STEADY.least_clear_hz)
        weight *= np.sin(0.5 * np.pi * np.clip(apart / reach - 1.0, 0.0, 1.0)) ** 2
    return weight


def _steady_amplitude(turned: Complexes, window: Floats, clear: Floats) -> Complexes | None:
    """Amplitude (channels,) of a line that is ``turned`` (channels, points) to 0 Hz; None where it is not steady.

    ``window`` and ``clear`` (points,) are the weights of the points, with and without a fade at both ends.
    """
    amplitude = (turned @ window) / window.sum()
    pieces = np.array_split(np.arange(len(clear)), STEADY.pieces)
    weights = np.array([clear[piece].sum() for piece in pieces])
    kept = weights > 0.5 * len(pieces[0])
    if np.count_nonzero(kept) < STEADY.fewest_pieces:
        return None
    means = np.array([turned[:, piece] @ clear[piece] for piece in pieces]).T[:, kept] / weights[kept]
    # within pieces, and in most of them: what rings in one would else hide that it does not in the others
    strays = np.array([np.abs(turned[:, piece]) ** 2 @ clear[piece] for piece in pieces]).T[:, kept] / weights[kept]
    noise = np.median(strays - np.abs(means) ** 2, axis=1) / (0.5 * weights[kept].min())
    scatter = np.mean(np.abs(means - amplitude[:, None]) ** 2, axis=1)
    size = np.abs(amplitude) ** 2
    best = int(np.argmax(size / np.maximum(noise, np.finfo(float).tiny)))
    if scatter[best] > STEADY.steady_share**2 * size[best] + 2.0 * noise[best]:
        return None
    return np.asarray(amplitude)
