"""Rows of one exact order against speed: one place for all who read an order's amplitudes.

Steady recordings are read in the order map and its frames, at like speed; a recording whose speed sweeps gives rows of
its own, as the order was followed through it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np
import xarray as xr

from crankorder.fft.windows import power_of_two
from crankorder.findings import Findings
from crankorder.orders.averages import HeldSizes, SizeRows, beside_bins, noise_beside, noise_under
from crankorder.orders.fixed_lines import (
    ALIKE_BEATS,
    FixedLine,
    OrderRows,
    PartedRow,
    Stretch,
    parted_rows,
    with_parted,
)
from crankorder.orders.intervals import (
    Z95,
    amplitude_interval,
    energy_interval,
    one_phase_reference,
    phase_interval_deg,
)
from crankorder.orders.joint_lines import HeldFrames, hann_lobe
from crankorder.orders.like_speed import common_frames
from crankorder.orders.swept_tracks import followed_error
from crankorder.orders.true_angle import GIVEN, AngleErrors
from crankorder.orders.vold_kalman import NOISE_BANDWIDTH
from crankorder.quantities import Bools, Complexes, Floats, Ints, flags_of, with_flags
from crankorder.settings import OrderSettings

ON_BIN = 1e-6
"""An order this close to a bin of the map stands on it."""

REACH_BINS = 2
"""Bins on each side of a line that are read: the main lobe of a Hann window."""

TOGETHER_BINS = 4.0
"""Lines closer than this are solved together: their main lobes touch."""

LEAST_APART_BINS = 0.4
"""Lines closer than this cannot be told apart in one frame: what is read is their sum."""

BEATING_BINS = 1.0
"""Lines closer than this are parted by their beat over the whole recording: a frame holds most of both in each bin."""

HANN_CORRELATION = (1.0, 2.0 / 3.0, 1.0 / 6.0)
"""Correlation of white noise in bins 0, 1, 2 apart of a Hann window whose phase counts from its middle."""

OF_BANDWIDTH = 0.2
"""A followed order this near, in bandwidths, is the order itself: the filter lets it pass with a phase that turns."""

MOST_LATE = 0.1
"""Reciprocal bandwidths by which a row may stand elsewhere than its speed says at most."""

LEAK_LEFT = 0.01
"""Share of what a line leaks into the bins beside that cannot be taken off."""


ON_BIN_NAMES = [f"coherent_{name}" if name.startswith("amplitude") else name for name in OrderRows._fields]
"""Variables of the map that stand for the fields of OrderRows."""

BAND_HELD = 0.5
"""Share of a band, or of a main lobe, that must hold numbers for its sum to say something."""

_VARIABLES = (
    ("amplitude", "see unit", "peak amplitude"),
    ("phase", "degree", "phase from top dead centre"),
    ("standard_error", "see unit", "standard error of amplitude"),
    ("degrees_of_freedom", "1", "degrees of freedom of standard_error"),
    ("amplitude_low", "see unit", "lower end of the 95 % interval of amplitude"),
    ("amplitude_high", "see unit", "upper end of the 95 % interval of amplitude"),
    ("phase_ci95", "degree", "half width of the 95 % interval of phase; 180: unknown"),
    ("band_rms", "see unit", "RMS within the band around the order"),
)


class TrackReader:
    """Reads any order of a test, row by row.

    ``speed_rpm`` (rows,): first the speeds of the map, then the rows of each recording that sweeps.
    """

    def __init__(
        self,
        order_map: xr.Dataset,
        *,
        frames: Sequence[xr.Dataset] = (),
        followed: Sequence[xr.Dataset] = (),
        fixed: Sequence[FixedLine] = (),
    ) -> None:
        """The rows of a test.

        ``order_map`` the OrderMap, ``frames`` the OrderFrames of its recordings (without them lines between bins are
        read off the energy of the map), ``followed`` their RecordingTracks (those of sweeps count), ``fixed`` lines of
        one frequency, from which orders that meet them are told apart.
        """
        self.order_map = order_map
        self.items = [item for item in followed if item.attrs.get("swept", 0) and item.sizes.get("frame", 0)]
        self._frames, self._fixed = list(frames), tuple(fixed)
        self._axis: Floats = order_map["order"].values
        self._step = float(self._axis[1] - self._axis[0])
        self.map_rpm: Floats = order_map["speed"].values
        self.speed_rpm: Floats = np.concatenate([self.map_rpm, *(item["speed"].values for item in self.items)])

    def rows(self, order: float, others: Sequence[float] = ()) -> OrderRows:
        """OrderRows of ``order`` (cycles per crank revolution, exact), told from ``others`` that are close to it."""
        places = [_place_in(item, order) for item in self.items]
        made = with_parted(self._of_map(order, others), self.map_rpm, self._parted(order, others))
        hidden = self._rows_of_sweeps([item for item, place in zip(self.items, places, strict=True) if place >= 0])
        swept = [_followed_rows(item, place, order) for item, place in zip(self.items, places, strict=True)]
        parts = zip(made.without(hidden), *swept, strict=True)
        return OrderRows(*(np.concatenate(values, axis=1) for values in parts))

    def met(self, order: float, others: Sequence[float] = ()) -> list[PartedRow]:
        """Rows of the map in which ``order``, told from ``others`` close to it, meets lines of one frequency."""
        return [row for row in self._parted(order, others) if row.lines]

    def follows(self, order: float) -> bool:
        """Whether ``order`` was followed through a sweep."""
        return any(_place_in(item, order) >= 0 for item in self.items)

    def worth(self, order: float) -> Floats:
        """Number (rows,) of independent values that each row of ``order`` is worth, 0 to 1.

        Rows of an order that was followed through a sweep lie closer together than its filter resolves.
        """
        parts = [np.ones(len(self.map_rpm))]
        for item in self.items:
            place, time = _place_in(item, order), item["time"].values
            share = np.ones(len(time))
            if place >= 0 and len(time) > 1:
                width = item["bandwidth_hz"].values[place]
                share = NOISE_BANDWIDTH * width * np.abs(np.gradient(time))
            parts.append(np.minimum(share, 1.0))
        return np.concatenate(parts)

    def nearest_row_of_map(self, rows: Ints) -> Ints:
        """Row (chosen,) of the map at the speed nearest to that of each of ``rows`` (chosen,); rows of the map stay."""
        known = np.flatnonzero(np.isfinite(self.map_rpm))
        if not len(known):
            return np.minimum(rows, max(len(self.map_rpm) - 1, 0))
        apart = np.abs(self.speed_rpm[rows][:, None] - self.map_rpm[known])
        nearest = known[np.where(np.isnan(apart), np.inf, apart).argmin(axis=1)]
        return np.asarray(np.where(rows < len(self.map_rpm), rows, nearest))

    def _rows_of_sweeps(self, followed: list[xr.Dataset]) -> Bools:
        """Rows of the map in which all frames are of recordings that ``followed`` holds: theirs are better."""
        names = {str(item.attrs["recording"]) for item in followed}
        if not names or not self._frames:
            return np.zeros(len(self.map_rpm), dtype=bool)
        swept, total = np.zeros((2, len(self.map_rpm)))
        for item, rows in zip(self._used, self._row_of_frames, strict=True):
            count = np.bincount(rows, minlength=len(self.map_rpm))
            total += count
            swept += count * (str(item.attrs["recording"]) in names)
        return np.asarray((swept > 0.0) & (swept == total))

    @cached_property
    def _used(self) -> list[xr.Dataset]:
        """Frames of one length, as the map was made of them."""
        return common_frames(self._frames)[0]

    @cached_property
    def _row_of_frames(self) -> list[Ints]:
        """Row of the map nearest in speed to each frame; those of unknown speed by recording, as the map has them."""
        known = np.flatnonzero(np.isfinite(self.map_rpm))
        unnamed = iter(np.flatnonzero(~np.isfinite(self.map_rpm)))
        rows = []
        for item in self._used:
            speed = item["speed"].values
            if np.isfinite(speed).all() and len(known):
                rows.append(known[np.abs(speed[:, None] - self.map_rpm[known]).argmin(axis=1)])
            else:
                rows.append(np.full(len(speed), next(unnamed, len(self.map_rpm) - 1)))
        return rows

    def _of_map(self, order: float, others: Sequence[float]) -> OrderRows:
        """Rows of the map: its coherent average on a bin, else the frames at the exact order, by energy."""
        nearest = round(order / self._step)
        if not 0 <= nearest < len(self._axis):
            return OrderRows.nothing(self.order_map.sizes["channel"], len(self.map_rpm))
        if self._is_on_bin(order):
            return OrderRows(*(self.order_map[name].values[..., nearest] for name in ON_BIN_NAMES))
        close = [other / self._step for other in self._close(order, others)[1]]
        return self._between_bins(order / self._step, close, nearest)

    def _is_on_bin(self, order: float) -> bool:
        """Whether ``order`` stands on a bin of the map."""
        return bool(np.abs(self._axis - order).min() < ON_BIN)

    def _close(self, order: float, others: Sequence[float]) -> tuple[list[float], list[float]]:
        """Those of ``others`` that ``order`` beats with over whole recordings, and those that its frames part from it.

        Of the former those beat often enough that they are two lines in the longest recording.
        """
        starts = [item["crank_angle"].values for item in self._used if item.sizes["frame"]] if self._frames else []
        span = max((float(np.ptp(start)) for start in starts), default=0.0) * self._step
        away = {other: abs(other - order) / self._step for other in others}
        beating = [other for other, bins in away.items() if bins < BEATING_BINS and bins * span > ALIKE_BEATS]
        parted = [other for other, bins in away.items() if LEAST_APART_BINS < bins < TOGETHER_BINS]
        return beating, [other for other in parted if other not in beating]

    def _parted(self, order: float, others: Sequence[float]) -> list[PartedRow]:
        """Rows of ``order`` by itself, where it is close to ``others`` or meets lines of one frequency."""
        beating, apart = self._close(order, others)
        if not self._frames or not (beating or self._fixed):
            return []
        lines = [order, *beating]
        exact = np.array([self._is_on_bin(line) for line in lines])
        stretches = self._stretches([*lines, *apart])
        return parted_rows(stretches, np.array(lines), exact, apart, self._fixed)

    def _stretches(self, lines: Sequence[float]) -> list[Stretch]:
        """Frames of each recording in each row that are whole about the orders ``lines``; the first is told."""
        order, top = lines[0], len(self._axis) - 1
        first, last = (round(bound / self._step) for bound in (min(lines), max(lines)))
        bins = slice(max(first - REACH_BINS, 0), min(last + REACH_BINS, top) + 1)
        nearest = min(round(order / self._step), top)
        power = (self.order_map["amplitude"].values / self._unit[..., None]) ** 2
        noise = np.nan_to_num(noise_beside(power, self._beside[0][nearest][None])[..., 0])
        stretches = []
        for item, rows in zip(self._used, self._row_of_frames, strict=True):
            spectrum, revs = item["spectrum"].values, float(item.attrs["revs_per_frame"])
            turn, speed = item["crank_angle"].values + 0.5 * revs, item["speed"].values
            speed = np.where(np.isfinite(speed), speed, 60.0)  # what goes with the shaft needs none
            whole = np.isfinite(spectrum[:, :, bins]).all(axis=(0, 2))
            for row in np.unique(rows[whole]).tolist():
                mine = whole & (rows == row)
                scaled = np.asarray(spectrum[:, mine] / self._unit[..., None], dtype=np.complex128)
                names = [str(name) for name in item["channel"].values]
                held = HeldFrames.of(scaled, turn[mine], speed[mine], revs=revs, channels=names)
                stretches.append(Stretch(item, row, held, noise[:, row], self._unit[:, 0]))
        return stretches

    def _between_bins(self, place: float, close: list[float], nearest: int) -> OrderRows:
        """Rows of a line ``place`` bins up, between two bins, solved with those ``close`` to it (in bins)."""
        power = (self.order_map["amplitude"].values / self._unit[..., None]) ** 2
        bins, worth = self._beside
        independent = self.order_map["n_independent"].values
        energy, share, held = self._energy(place, close)
        lobe = hann_lobe(np.arange(power.shape[-1], dtype=np.float64) - place)
        leaked = np.nan_to_num(energy)[..., None] * np.square(lobe)
        alone = np.maximum(power - leaked, LEAK_LEFT * leaked)
        noise = noise_beside(power, bins[nearest][None])[..., 0]
        noise, unknown = noise_under(noise, alone, np.sort(bins[nearest]), place, independent)
        bias, beat = share * noise, share * noise / independent
        scatter = (share * noise) ** 2 / independent + (share * unknown) ** 2
        dof = np.where(np.isnan(energy), 0.0, np.round(2.0 * worth[nearest] * independent))
        low, high = energy_interval(energy, noise=beat, bias=bias, noise_variance=scatter, dof=dof)
        line = np.sqrt(np.maximum(energy - bias, 0.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            error = np.sqrt(2.0 * line**2 * beat + scatter) / (2.0 * np.sqrt(energy))
        # without noise the error is 0; without energy nothing is known of it but the upper end
        error = np.where(np.isnan(energy) | (noise > 0.0), np.where(energy > 0.0, error, np.nan), 0.0)
        nothing = np.full(energy.shape, np.nan)
        sizes = SizeRows(line, error, dof, low, high)
        made = sizes.with_scatter(held, noise=share * noise, independent=np.full(len(self.map_rpm), worth[nearest]))
        unit = self._unit
        return OrderRows(unit * line, nothing, unit * made.error, made.dof, unit * made.low, unit * made.high, nothing)

    @cached_property
    def _beside(self) -> tuple[Ints, Floats]:
        """Bins beside each bin that hold noise, and how many independent ones they are worth."""
        return beside_bins(self._axis, line_step=1.0 / int(self.order_map.attrs["revs_per_cycle"]))

    @cached_property
    def _unit(self) -> Floats:
        """Power of two (channels, 1) by which amplitudes are divided before they are squared."""
        return power_of_two(self.order_map["amplitude"].values)[..., 0]

    def _energy(self, place: float, close: list[float]) -> tuple[Floats, float, list[HeldSizes]]:
        """Mean squared amplitude (channels, rows) of the line ``place`` bins up, and its share of a bin's noise power.

        Last, its amplitudes in the frames of each recording whose speed is held.

        Each frame is solved for the line and those ``close`` to it by generalised least squares over the bins of their
        main lobes; without frames the map's energy is taken for that of the line alone.
        """
        used, solve, share = self._lobe_fit(place, close)
        shape = (self.order_map.sizes["channel"], len(self.map_rpm))
        if not self._frames:
            squares = np.square(hann_lobe(used.astype(np.float64) - place))
            energy = np.square(self.order_map["amplitude"].values[..., used] / self._unit[..., None]) @ squares
            return np.asarray(energy / float(squares @ squares)), float(squares.sum() / (squares @ squares)), []
        held: list[HeldSizes] = []
        total, count = np.zeros(shape), np.zeros(shape)
        for item, rows in zip(self._used, self._row_of_frames, strict=True):
            # bins turned to the middles of the frames
            revs = float(item.attrs["revs_per_frame"])
            turn = np.exp(2j * np.pi * (np.outer(item["crank_angle"].values + 0.5 * revs, used) / revs % 1.0))
            squared = np.abs((item["spectrum"].values[:, :, used] * turn) @ solve / self._unit) ** 2
            seen = np.isfinite(squared)
            for row in [] if item.attrs.get("swept", 0) else np.unique(rows).tolist():
                own = squared[:, (rows == row) & seen.all(axis=0)]
                held += [HeldSizes(row, np.sqrt(own))] if own.shape[1] > 1 else []
            for channel in range(shape[0]):
                some = seen[channel]
                total[channel] += np.bincount(rows[some], squared[channel, some], minlength=shape[1])
                count[channel] += np.bincount(rows[some], minlength=shape[1])
        with np.errstate(invalid="ignore"):
            return total / count, share, held

    def _lobe_fit(self, place: float, close: list[float]) -> tuple[Ints, Floats, float]:
        """Bins (used,) about a line ``place`` bins up, their weights in its amplitude apart from lines ``close`` to it.

        Last, what share of a bin's noise power that amplitude holds.
        """
        lines = np.array([place, *close])
        middle = np.rint(lines).astype(int)
        used = np.arange(max(0, middle.min() - REACH_BINS), min(len(self._axis) - 1, middle.max() + REACH_BINS) + 1)
        lobes = hann_lobe(used[:, None] - lines)
        apart = np.abs(used[:, None] - used)
        noise = np.select([apart == k for k in range(3)], HANN_CORRELATION, 0.0)
        weighted = np.linalg.solve(noise, lobes)
        covariance = np.linalg.inv(lobes.T @ weighted)
        return used, (covariance @ weighted.T)[0], float(covariance[0, 0])


def _place_in(item: xr.Dataset, order: float) -> int:
    """Number of the order that the RecordingTracks ``item`` follow and that is ``order``; -1 where there is none."""
    orders = item["order"].values
    if not len(orders):
        return -1
    nearest = int(np.abs(orders - order).argmin())
    width = item["bandwidth_hz"].values[nearest] * 60.0 / item["speed"].values
    return nearest if abs(orders[nearest] - order) < OF_BANDWIDTH * float(width.min()) else -1


def _followed_rows(item: xr.Dataset, place: int, order: float) -> OrderRows:
    """Rows of the order number ``place`` of ``item`` (-1: nothing is known), its phase as that of ``order``.

    What the filter took of a narrow peak (``smoothing``) is put back and part of the error, as are the angle's and,
    where the order changes fast, that of the row's speed.
    """
    if place < 0:
        return OrderRows.nothing(item.sizes["channel"], item.sizes["frame"])
    value = item["amplitude"].values[:, place] + item["smoothing"].values[:, place]
    along, across = _misplaced(item, place, value)
    error = np.hypot(followed_error(item, place), along)
    dof = item["degrees_of_freedom"].values[:, place]
    magnitude, power = np.abs(value), 2.0 * error**2
    low, high = amplitude_interval(magnitude, power, dof)
    power = power + 2.0 * (across**2 - along**2)
    more = item["smoothing_more"].values[:, place]  # a filter lowers a peak: what it may have taken is no doubt below
    high, power = high + Z95 * more, power + 2.0 * more**2
    angle = AngleErrors(item["angle_scatter"].values, item["angle_error"].values)
    away = float(item["order"].values[place]) - order
    turned = value * np.exp(2j * np.pi * (away * item["crank_angle"].values % 1.0))
    phase, half = np.degrees(np.angle(turned)), phase_interval_deg(magnitude, power, dof)
    high, half = high / angle.kept(np.asarray(order)), angle.phase_half_deg(half, np.asarray(order))
    if GIVEN in item:
        given = item[GIVEN].values[:, place]
        low, high = np.maximum(low - given, 0.0), high + given
    if not one_phase_reference([item]):
        phase, half = np.full(phase.shape, np.nan), np.full(half.shape, np.nan)
    return OrderRows(magnitude, phase, error, dof, low, high, half)


def _misplaced(item: xr.Dataset, place: int, value: Complexes) -> tuple[Floats, Floats]:
    """By how much ``value`` (channels, frames) changes along and across itself as the speed of a row of ``item`` errs.

    Standard errors; ``place`` is that of the order. A row is at its time: no speed puts it further than a part of the
    filter's memory.
    """
    if item.sizes["frame"] < 2:
        return np.zeros(value.shape), np.zeros(value.shape)
    time, speed = item["time"].values, item["speed"].values
    late = item["speed_error"].values / np.maximum(np.abs(np.gradient(speed, time)), 1e-9)
    late = np.minimum(late, MOST_LATE / item["bandwidth_hz"].values[place])
    with np.errstate(invalid="ignore", divide="ignore"):
        moved = np.nan_to_num(np.gradient(value, time, axis=1) * late * value.conj() / np.abs(value))
    return np.abs(moved.real), np.abs(moved.imag)


def order_tracks(
    order_map: xr.Dataset,
    orders: list[float],
    *,
    settings: OrderSettings,
    frames: Sequence[xr.Dataset] = (),
    followed: Sequence[xr.Dataset] = (),
    fixed: Sequence[FixedLine] = (),
) -> xr.Dataset:
    """OrderTracks (channel, order, speed) of ``orders``, cycles per crank revolution, from the OrderMap ``order_map``.

    On a bin of the map, amplitude, phase and 95 % intervals are those of the coherent average; between bins the
    amplitude is that of the ``frames`` (OrderFrames, or of the map's energy without them) at the exact order, apart
    from lines close by, and the phase is NaN. An order that was ``followed`` through a sweep (RecordingTracks) has the
    rows of that, at speeds of their own. Where one meets ``fixed`` lines of the test it is separated from
    them as far as possible. ``band_rms`` is the RMS of everything within ``settings.band_width_orders``
    around the order, NaN where the map holds less than half of that. Orders above the map give NaN. The flags are
    those of the map and of what was followed. Speeds rise.
    """
    reader = TrackReader(order_map, frames=frames, followed=followed, fixed=fixed)
    axis, asked = order_map["order"].values, np.asarray(orders, dtype=float)
    resolution = float(axis[1] - axis[0])
    outside = asked > axis[-1] + 0.5 * resolution
    at = np.argsort(reader.speed_rpm, kind="stable")
    rows = [reader.rows(order, [other for other in orders if other != order]) for order in orders]
    values = {name: [getattr(one, name)[:, at] for one in rows] for name in OrderRows._fields}
    band = _band_rms(order_map, asked, settings.band_width_orders)
    nearest = reader.nearest_row_of_map(at)
    values["band_rms"] = [band[:, nearest, number] for number in range(len(orders))]
    used = np.any([np.isfinite(one) for one in values["amplitude"]], axis=(0, 1)) if orders else np.ones(len(at), bool)
    # rows of the map that only sweeps went through hold nothing once all orders are followed
    kept = np.flatnonzero(used | (at < len(reader.map_rpm)) & (not reader.items))
    tracks = xr.Dataset(coords={k: v for k, v in order_map.coords.items() if "speed" not in v.dims and k != "order"})
    tracks["order"] = ("order", asked, {"units": "1", "long_name": "order"})
    tracks["speed"] = ("speed", reader.speed_rpm[at][kept], order_map["speed"].attrs)
    for name, units, long_name in _VARIABLES:
        shape = (order_map.sizes["channel"], len(kept))
        given = np.array([one[:, kept] for one in values[name]]).reshape(len(orders), *shape)
        shown = np.where(outside[:, None, None], 0.0 if name == "degrees_of_freedom" else np.nan, given)
        words = {"units": units, "long_name": long_name}
        tracks[name] = (("channel", "order", "speed"), np.moveaxis(shown, 0, 1), words)
    method = np.array(["vold_kalman" if reader.follows(order) else "frames" for order in orders], dtype="<U16")
    tracks.coords["track_method"] = ("order", method, {"units": "1", "long_name": "how the order was followed"})
    carried = ("amplitude_scaling", "phase_reference", "cycle_known", "window")
    tracks.attrs = {key: order_map.attrs[key] for key in carried if key in order_map.attrs}
    tracks.attrs |= {"band_width_orders": settings.band_width_orders, "speed_bin_rpm": settings.speed_bin_rpm}
    flags = flags_of(order_map)
    return with_flags(tracks, flags + [flag for item in reader.items for flag in flags_of(item) if flag not in flags])


def _band_rms(order_map: xr.Dataset, orders: Floats, width_orders: float) -> Floats:
    """RMS (channels, speeds, orders) of everything within ``width_orders`` around each of ``orders``.

    Part bins count in part; NaN where less than :data:`BAND_HELD` of the width holds numbers.
    """
    level = order_map["amplitude"].values
    largest = np.nanmax(level, axis=(1, 2), keepdims=True, initial=0.0)
    unit = np.where(largest > 0.0, np.ldexp(1.0, np.frexp(largest)[1] - 1), 1.0)
    axis = order_map["order"].values
    resolution = float(axis[1] - axis[0])
    power, centre, width = (level / unit) ** 2, orders / resolution, width_orders / resolution
    known = ~np.isnan(power)
    held = np.full(1, width) if known.all() else _sum_around(known.astype(np.float64), centre, width)
    band = np.where(held < BAND_HELD * width, np.nan, _sum_around(power, centre, width))
    return np.asarray(unit * np.sqrt(band / (2.0 * float(order_map.attrs["enbw_bins"]))))


def followed_orders(findings: Findings, settings: OrderSettings) -> list[float]:
    """Orders to follow: those that ``findings`` name, where they were read, and those that ``settings`` ask for."""
    found = (one.order if one.tracked_order is None else one.tracked_order for one in findings.orders)
    return all_tracked(found, settings)


def all_tracked(found: Iterable[float], settings: OrderSettings) -> list[float]:
    """The orders ``found`` and those that ``settings`` ask for, each once, rising."""
    return sorted({round(float(order), 9) for order in settings.track_orders} | set(found))


def track_order(order: float, order_ci95: Sequence[float], lock: str | None, *, revs_per_cycle: int) -> float:
    """Order at which the track of a found ``order`` with the 95 % interval ``order_ci95`` (low, high) is read.

    An order that is locked to the shaft (``lock`` "locked"), or may be ("undecided" with a multiple of the order of the
    cycle, 1 / ``revs_per_cycle``, in its interval), is read on that multiple, where its phase is known; any other where
    it was found. An interval so wide that it would hold a multiple anywhere does not count.
    """
    multiple = round(order * revs_per_cycle) / revs_per_cycle
    low, high = order_ci95
    may_be = low <= multiple <= high and high - low < 0.5 / revs_per_cycle
    locked = lock == "locked" or (lock == "undecided" and may_be)
    return round(multiple if locked else order, 6)


def _sum_around(power: Floats, centre: Floats, width: float) -> Floats:
    filled = np.nan_to_num(power)
    cumulative = np.concatenate([np.zeros_like(filled[..., :1]), np.cumsum(filled, axis=-1)], axis=-1)

    def up_to(edge: Floats) -> Floats:
        edge = np.clip(edge + 0.5, 0.0, cumulative.shape[-1] - 1.0)
        low = np.minimum(edge.astype(int), cumulative.shape[-1] - 2)
        share = edge - low
        return np.asarray(cumulative[..., low] * (1.0 - share) + cumulative[..., low + 1] * share)

    return up_to(centre + 0.5 * width) - up_to(centre - 0.5 * width)
