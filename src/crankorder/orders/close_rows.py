"""Rows of an order so close to other lines that no frame parts them: solved over whole recordings, as they beat.

The others are orders, of which nothing is known, and lines of one frequency, as mains are, whose size is known from the
other speeds of the test, where no order is near. What is left of the doubt is part of the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import xarray as xr

from crankorder.orders.fixed_lines import FixedLine
from crankorder.orders.intervals import LARGEST_DOF, Z95, amplitude_interval, phase_interval_deg
from crankorder.orders.joint_lines import Band, HeldFrames, JointLines, Place, hann_lobe, joint_lines
from crankorder.orders.true_angle import UNKNOWN_DEG, AngleErrors, errors_of_rows
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import MethodNumbers

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


@dataclass(frozen=True)
class Stretch:
    """Frames of one recording (OrderFrames ``item``) in one ``row`` of the map.

    Spectra are in the ``unit`` (channels,); ``beside`` (channels,) is the noise power of a phasor by the bins beside.
    """

    item: xr.Dataset
    row: int
    held: HeldFrames
    beside: Floats
    unit: Floats


@dataclass(frozen=True, eq=False)
class PartedRow:
    """One ``row`` of an ``order`` by itself, (channels,) each: complex amplitude ``value`` about angle 0, and errors.

    ``power`` is that of the noise, of ``freedom`` degrees; ``slack`` (3, channels) what the value may have taken of the
    lines beside, along and across it, as numbers are off, and what none of them explains, which is the order's own
    where it ``wanders``. ``doubt`` is the largest that the others, among them the fixed ``lines``, may add to what is
    not parted from them; ``beats``: as often with close orders as parts them; ``by_noise`` the error of the mean of the
    frames by noise alone; ``angle`` the errors of the crank angle.
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
    """What the ``stretches`` of a test hold of the first of ``orders`` (lines,), by row.

    The other orders are close to it; those so far ``apart`` that a frame parts them, and the ``fixed`` lines that it
    meets, are solved with them. By how much numbers that are not ``exact`` (lines,) may be off is told by all stretches
    together, and by each where it surely says otherwise. Where the first line alone is not exact, power which none
    explains is its own.
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
        part = replace(part, lines=lines, doubt=part.doubt + most * stretch.unit, beats=beats)
        parts.setdefault(stretch.row, []).append(part)
    wanders = bool(not exact[0] and exact[1:].all())
    return [replace(_joined(of_row), wanders=wanders) for of_row in parts.values()]


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
    """``rows`` of an order at ``speed_rpm`` (rows,), those that are ``parted`` from lines beside apart from these.

    Where the recordings tell them apart the row is what the order is by itself. Where they do not, the interval holds
    whatever the lines may add or take; the amplitude is that of the speeds beside if the lines explain the difference,
    and stays what it is where they are too small for that.
    """
    made = OrderRows(*(getattr(rows, item.name).copy() for item in fields(OrderRows)))
    is_open = np.zeros(made.amplitude.shape, dtype=bool)
    for row in parted:
        known = np.isfinite(rows.amplitude[:, row.row])
        for item, value in zip(fields(OrderRows), _apart(rows, row), strict=True):
            getattr(made, item.name)[known, row.row] = value[known]
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
    size, phase, error, _, low, high, half = (getattr(rows, item.name)[:, parted.row] for item in fields(OrderRows))
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
    phase, half = (
        np.where(has_phase, np.where(agree, *pair), np.nan) for pair in ((own_phase, phase), (own_half, half))
    )
    return size, phase, error, freedom, low, high, half
